//! PNG: eight bits of sRGB, tone-mapped, lightly dithered so that smooth walls show no bands.

use std::io::Write;
use std::path::Path;

use png::{BitDepth, ColorType, Encoder, EncodingError, SrgbRenderingIntent};

use crate::aside::Aside;
use crate::exposure::beauty;
use crate::tone::{self, Tone, encode_srgb};
use crate::{ImageError, Picture, Rows, rows};

/// Writes a picture as 8-bit sRGB PNG: radiance times `exposure` (see [`crate::exposure`]) through
/// [`tone_map`]. The file holds no time and no text; it appears complete or not at all.
pub fn write_png(path: &Path, picture: &Picture, exposure: f32) -> Result<(), ImageError> {
    write_png_from(path, &mut picture.checked(path)?, exposure)
}

/// [`write_png`] for a picture that is read row by row; [`crate::scratch_bytes`] of memory.
pub fn write_png_from(path: &Path, rows: &mut dyn Rows, exposure: f32) -> Result<(), ImageError> {
    write_png_toned(path, rows, exposure, Tone::Filmic)
}

/// [`write_png_from`] with a choice of tone mapping.
pub fn write_png_toned(
    path: &Path,
    rows: &mut dyn Rows,
    exposure: f32,
    tone: Tone,
) -> Result<(), ImageError> {
    let (width, height) = rows::size(path, rows)?;
    write_rgb(path, width, height, |canvas| {
        let mut bytes = Vec::with_capacity(3 * width as usize);
        rows::for_each_band(path, rows, |first_row, band| {
            for (y, row) in band.chunks_exact(width as usize).enumerate() {
                bytes.clear();
                for (x, pixel) in row.iter().enumerate() {
                    let threshold = tone::dither(x, first_row as usize + y);
                    bytes.extend(
                        tone.map(beauty(pixel), exposure)
                            .map(|c| (encode_srgb(c) * 255.0 + threshold) as u8),
                    );
                }
                canvas.row(&bytes)?;
            }
            Ok(())
        })
    })
}

/// An 8-bit RGB PNG on its way, row by row.
pub(crate) struct Canvas<'a> {
    path: &'a Path,
    stream: &'a mut dyn Write,
}

impl Canvas<'_> {
    /// Appends one row of sRGB bytes.
    pub(crate) fn row(&mut self, bytes: &[u8]) -> Result<(), ImageError> {
        self.stream.write_all(bytes).map_err(|e| ImageError::write(self.path, e))
    }
}

/// Writes a PNG whose rows `paint` appends, all of them.
pub(crate) fn write_rgb(
    path: &Path,
    width: u32,
    height: u32,
    paint: impl FnOnce(&mut Canvas) -> Result<(), ImageError>,
) -> Result<(), ImageError> {
    let failed = |e| failed(path, e);
    let mut aside = Aside::create(path)?;
    let mut encoder = Encoder::new(&mut aside, width, height);
    encoder.set_color(ColorType::Rgb);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_source_srgb(SrgbRenderingIntent::Perceptual);
    let mut writer = encoder.write_header().map_err(failed)?;
    let mut stream = writer.stream_writer_with_size(1 << 16).map_err(failed)?;
    paint(&mut Canvas { path, stream: &mut stream })?;
    stream.finish().map_err(failed)?;
    writer.finish().map_err(failed)?;
    aside.finish()
}

fn failed(path: &Path, error: EncodingError) -> ImageError {
    match error {
        EncodingError::IoError(source) => ImageError::write(path, source),
        other => ImageError::Encode { path: path.to_owned(), reason: other.to_string() },
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::rows::tests::{Failing, noise};
    use crate::tone::tone_map;
    use enf_layout::film::PixelRecord;

    /// Width, height and RGB bytes of a PNG.
    pub(crate) fn decode(path: &Path) -> (u32, u32, Vec<u8>) {
        let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
        let mut reader = png::Decoder::new(file).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        assert_eq!((info.color_type, info.bit_depth), (ColorType::Rgb, BitDepth::Eight));
        (info.width, info.height, bytes)
    }

    #[test]
    fn a_decoded_picture_is_the_tone_mapped_one() {
        let folder = tempfile::tempdir().unwrap();
        let pixels = noise(37 * 53);
        let picture = Picture { width: 37, height: 53, pixels: &pixels };
        let [a, b] = ["a.png", "b.png"].map(|n| folder.path().join(n));
        write_png(&a, &picture, 0.4).unwrap();
        write_png(&b, &picture, 0.4).unwrap();
        assert_eq!(std::fs::read(&a).unwrap(), std::fs::read(&b).unwrap());
        let (width, height, bytes) = decode(&a);
        assert_eq!((width, height), (37, 53));
        for (pixel, shown) in pixels.iter().zip(bytes.chunks_exact(3)) {
            for (want, &got) in tone_map(beauty(pixel), 0.4).iter().zip(shown) {
                assert!((encode_srgb(*want) * 255.0 - f32::from(got)).abs() < 1.0);
            }
        }
    }

    #[test]
    fn dithering_keeps_the_mean_and_leaves_black_and_white_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let shown = |y: f32| {
            let grey = PixelRecord { direct: [y; 3], ..Default::default() };
            write_png(&path, &Picture { width: 32, height: 32, pixels: &[grey; 1024] }, 1.0)
                .unwrap();
            decode(&path).2
        };
        assert!(shown(0.0).iter().all(|&b| b == 0));
        assert!(shown(1e9).iter().all(|&b| b == 255));
        assert!(shown(f32::NAN).iter().all(|&b| b == 0));
        let grey = shown(0.1234);
        let mean = grey.iter().map(|&b| f64::from(b)).sum::<f64>() / grey.len() as f64;
        let want = f64::from(encode_srgb(tone_map([0.1234; 3], 1.0)[0]) * 255.0);
        assert!((mean - want).abs() < 0.02, "{mean} for {want}");
    }

    #[test]
    fn errors_leave_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let error = write_png_from(&path, &mut Failing { at: 16 }, 1.0).unwrap_err();
        assert!(matches!(error, ImageError::Rows { first_row: 16, .. }), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        let pixels = noise(4);
        let picture = Picture { width: 2, height: 2, pixels: &pixels };
        let path = folder.path().join("no").join("a.png");
        let error = write_png(&path, &picture, 1.0).unwrap_err();
        assert_eq!(error.exit_code(), 5);
        assert!(error.to_string().contains("a.png"), "{error}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_an_error() {
        let pixels = noise(64 * 64);
        let picture = Picture { width: 64, height: 64, pixels: &pixels };
        let full = Path::new("/dev/full");
        for error in [
            write_png(full, &picture, 1.0).unwrap_err(),
            crate::write_exr(full, &picture).unwrap_err(),
            crate::write_hdr(full, &picture).unwrap_err(),
        ] {
            assert!(matches!(error, ImageError::Write { .. }), "{error}");
            assert!(error.to_string().contains("free some space"), "{error}");
        }
    }
}
