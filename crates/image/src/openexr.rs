//! OpenEXR: everything that is known about each pixel, as 32-bit floats, losslessly compressed.
//!
//! | channels | meaning |
//! |---|---|
//! | `R` `G` `B` | radiance, W/m²/sr, linear Rec.709: direct + indirect |
//! | `direct.R` ... | its part that came straight from lights |
//! | `indirect.R` ... | its part that came by way of the photon maps |
//! | `albedo.R` ... | diffuse albedo of what is seen |
//! | `normal.X` `.Y` `.Z` | normal of what is seen, world space |
//! | `depth.Z` | distance to what is seen, m; 0 where nothing is |
//! | `room.ID` | number of the room that is seen by the pixel's first sample; -1 where nothing is |
//! | `room.mixed` | 1 where the pixel's samples see several rooms, or one and nothing; else 0 |
//!
//! The header says that the primaries are Rec.709 and that white of radiance 1 is 179 cd/m², so
//! that a viewer can show luminance. It says nothing about when, where or how the file was made.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader};
use std::path::Path;

use enf_layout::film::PixelRecord;
use exr::block::writer::ChunksWriter;
use exr::block::{BlockIndex, UncompressedBlock};
use exr::compression::Compression;
use exr::error::Error;
use exr::image::FlatSamples;
use exr::math::Vec2;
use exr::meta::BlockDescription;
use exr::meta::attribute::{ChannelDescription, Chromaticities, LineOrder, SampleType, Text};
use exr::meta::header::{Header, LayerAttributes};
use exr::prelude::{ReadChannels, ReadLayers};

use crate::aside::Aside;
use crate::rows::{self, BAND_ROWS};
use crate::{ImageError, LUMENS_PER_WATT, Picture, Rows};

type Channel = (&'static str, fn(&PixelRecord) -> f32);

/// Every channel, in the order of the file (by ASCII).
const CHANNELS: [Channel; 18] = [
    ("B", |p| p.direct[2] + p.indirect[2]),
    ("G", |p| p.direct[1] + p.indirect[1]),
    ("R", |p| p.direct[0] + p.indirect[0]),
    ("albedo.B", |p| p.albedo[2]),
    ("albedo.G", |p| p.albedo[1]),
    ("albedo.R", |p| p.albedo[0]),
    ("depth.Z", |p| p.depth),
    ("direct.B", |p| p.direct[2]),
    ("direct.G", |p| p.direct[1]),
    ("direct.R", |p| p.direct[0]),
    ("indirect.B", |p| p.indirect[2]),
    ("indirect.G", |p| p.indirect[1]),
    ("indirect.R", |p| p.indirect[0]),
    ("normal.X", |p| p.normal[0]),
    ("normal.Y", |p| p.normal[1]),
    ("normal.Z", |p| p.normal[2]),
    ("room.ID", |p| p.room.abs() - 1.0),
    ("room.mixed", |p| f32::from(u8::from(p.room.is_sign_negative()))),
];

/// Bytes of a pixel in all channels.
pub(crate) const BYTES_PER_PIXEL: usize = CHANNELS.len() * size_of::<f32>();

/// Writes a picture as OpenEXR with the layers of the module's table. Equal pixels give equal
/// bytes. The file appears complete or not at all; fails with [`ImageError`] otherwise.
pub fn write_exr(path: &Path, picture: &Picture) -> Result<(), ImageError> {
    write_exr_from(path, &mut picture.checked(path)?)
}

/// [`write_exr`] for a picture that is read row by row; [`crate::scratch_bytes`] of memory.
pub fn write_exr_from(path: &Path, rows: &mut dyn Rows) -> Result<(), ImageError> {
    let (width, height) = rows::size(path, rows)?;
    let mut aside = Aside::create(path)?;
    let header = header(width as usize, height as usize);
    // What stopped the rows, while the encoder only knows that it was told to stop.
    let mut stopped = None;
    let written = exr::block::write(&mut aside, vec![header].into(), true, |meta, chunks| {
        let each = rows::for_each_band(path, rows, |first_row, band| {
            let mut data = Vec::with_capacity(band.len() * BYTES_PER_PIXEL);
            for row in band.chunks_exact(width as usize) {
                for (_, value) in CHANNELS {
                    data.extend(row.iter().flat_map(|p| value(p).to_ne_bytes()));
                }
            }
            let index = BlockIndex {
                layer: 0,
                pixel_position: Vec2(0, first_row as usize),
                pixel_size: Vec2(width as usize, band.len() / width as usize),
                level: Vec2(0, 0),
            };
            UncompressedBlock { index, data }
                .compress_to_chunk(&meta.headers)
                .and_then(|chunk| chunks.write_chunk((first_row / BAND_ROWS) as usize, chunk))
                .map_err(|e| failed(path, e))
        });
        each.map_err(|error| {
            stopped = Some(error);
            Error::Aborted
        })
    });
    match (stopped, written) {
        (Some(error), _) => Err(error),
        (None, Err(error)) => Err(failed(path, error)),
        (None, Ok(())) => aside.finish(),
    }
}

fn header(width: usize, height: usize) -> Header {
    let channels =
        CHANNELS.iter().map(|(name, _)| ChannelDescription::named(*name, SampleType::F32));
    let mut header = Header::new(Text::from(""), (width, height), channels.collect())
        .with_encoding(Compression::ZIP16, BlockDescription::ScanLines, LineOrder::Increasing)
        .with_attributes(LayerAttributes {
            white_luminance: Some(LUMENS_PER_WATT),
            ..LayerAttributes::default()
        });
    header.shared_attributes.chromaticities = Some(Chromaticities {
        red: Vec2(0.64, 0.33),
        green: Vec2(0.3, 0.6),
        blue: Vec2(0.15, 0.06),
        white: Vec2(0.3127, 0.329),
    });
    header
}

fn failed(path: &Path, error: Error) -> ImageError {
    match error {
        Error::Io(source) => ImageError::write(path, source),
        other => ImageError::Encode { path: path.to_owned(), reason: other.to_string() },
    }
}

/// An OpenEXR picture in memory, channel by channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Loaded {
    /// What messages call it: the path that it was read from.
    pub name: String,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Values by channel name (`R`, `direct.R`, ...), rows from the top; `width * height` each.
    pub channels: BTreeMap<String, Vec<f32>>,
}

impl Loaded {
    /// What [`write_exr`] followed by [`read_exr`] would give.
    pub fn from_picture(picture: &Picture) -> Self {
        let values = |f: fn(&PixelRecord) -> f32| picture.pixels.iter().map(f).collect();
        Self {
            name: "the picture in memory".into(),
            width: picture.width,
            height: picture.height,
            channels: CHANNELS.iter().map(|&(name, f)| (name.to_owned(), values(f))).collect(),
        }
    }

    /// The channel of that name, if there is one.
    pub fn channel(&self, name: &str) -> Option<&[f32]> {
        self.channels.get(name).map(Vec::as_slice)
    }
}

/// Reads an OpenEXR file of any maker (scan lines or tiles, all compressions but deep data), for
/// tools and tests; channels of named parts are called `part.channel`. Half floats and integers
/// become floats. Fails with [`ImageError::Read`] or [`ImageError::Malformed`].
pub fn read_exr(path: &Path) -> Result<Loaded, ImageError> {
    let read = |source: io::Error| ImageError::Read { path: path.to_owned(), source };
    let malformed = |reason: String| ImageError::Malformed { path: path.to_owned(), reason };
    let failed = |error| match error {
        Error::Io(source) if source.kind() != io::ErrorKind::UnexpectedEof => read(source),
        other => malformed(other.to_string()),
    };
    let file = File::open(path).map_err(read)?;
    let length = file.metadata().map_err(read)?.len();
    let chunks = exr::block::read(BufReader::new(file), false).map_err(failed)?;
    // A damaged size must not ask for terabytes: no compression gets beyond a factor of 2048.
    let most = length.saturating_mul(2048);
    for header in chunks.headers() {
        let (size, pixel) = (header.layer_size, header.channels.bytes_per_pixel);
        let bytes =
            [size.width(), size.height(), pixel].map(|n| n as u128).iter().product::<u128>();
        let block = match header.blocks {
            BlockDescription::ScanLines => 0,
            BlockDescription::Tiles(tiles) => {
                let tile = tiles.tile_size;
                [tile.width(), tile.height(), pixel].map(|n| n as u128).iter().product()
            }
        };
        if bytes.max(block) > u128::from(most).max(1 << 24) {
            return Err(malformed(format!(
                "its header claims {} x {} pixels in a file of {length} bytes",
                size.width(),
                size.height()
            )));
        }
    }
    let image = exr::image::read::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .non_parallel()
        .from_chunks(chunks)
        .map_err(failed)?;
    let Some(first) = image.layer_data.first() else {
        return Err(malformed("it has no layer".into()));
    };
    let size = first.size;
    let parts = image.layer_data.len();
    let mut channels = BTreeMap::new();
    for layer in image.layer_data.iter().filter(|l| l.size == size) {
        let part = layer.attributes.layer_name.as_ref().filter(|_| parts > 1);
        for channel in &layer.channel_data.list {
            let values: Vec<f32> = match &channel.sample_data {
                FlatSamples::F16(v) => v.iter().map(|x| x.to_f32()).collect(),
                FlatSamples::F32(v) => v.clone(),
                FlatSamples::U32(v) => v.iter().map(|&x| x as f32).collect(),
            };
            if values.len() != size.area() {
                return Err(malformed(format!("channel {} is subsampled", channel.name)));
            }
            let name = match part {
                Some(part) => format!("{part}.{}", channel.name),
                None => channel.name.to_string(),
            };
            channels.insert(name, values);
        }
    }
    Ok(Loaded {
        name: path.display().to_string(),
        width: size.width() as u32,
        height: size.height() as u32,
        channels,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::tests::{Failing, noise};

    #[test]
    fn the_channels_are_sorted_as_the_format_wants() {
        assert!(CHANNELS.is_sorted_by(|a, b| a.0 < b.0));
    }

    #[test]
    fn a_round_trip_keeps_every_bit() {
        let folder = tempfile::tempdir().unwrap();
        for (width, height) in [(1, 1), (7, 15), (33, 16), (20, 49)] {
            let mut pixels = noise(width * height);
            pixels[0].direct = [f32::MAX, f32::MIN_POSITIVE / 4.0, -0.0];
            pixels[0].indirect = [0.0, 0.0, -0.0];
            let picture = Picture { width, height, pixels: &pixels };
            let path = folder.path().join("a.exr");
            write_exr(&path, &picture).unwrap();
            let back = read_exr(&path).unwrap();
            let here = Loaded::from_picture(&picture);
            assert_eq!((back.width, back.height), (width, height));
            assert_eq!(back.channels.len(), CHANNELS.len());
            for (name, values) in &here.channels {
                let bits = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
                assert_eq!(bits(values), bits(back.channel(name).unwrap()), "{name}");
            }
        }
    }

    #[test]
    fn equal_pixels_are_equal_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let pixels = noise(40 * 30);
        let picture = Picture { width: 40, height: 30, pixels: &pixels };
        let [a, b] = ["a.exr", "another name.exr"].map(|n| folder.path().join(n));
        write_exr(&a, &picture).unwrap();
        write_exr(&b, &picture).unwrap();
        let bytes = std::fs::read(&a).unwrap();
        assert_eq!(bytes, std::fs::read(&b).unwrap());
        assert_eq!(bytes[..4], [0x76, 0x2f, 0x31, 0x01]);
        // Lossless, and smaller than the floats where the picture is smooth.
        let smooth = vec![pixels[0]; 40 * 30];
        write_exr(&a, &Picture { pixels: &smooth, ..picture }).unwrap();
        assert!(std::fs::metadata(&a).unwrap().len() < 4000);
    }

    #[test]
    fn bad_pictures_and_bad_files_are_errors_that_name_them() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        for (width, height) in [(3, 4), (0, 10), (u32::MAX, u32::MAX)] {
            let pixels = noise(10);
            let error = write_exr(&path, &Picture { width, height, pixels: &pixels }).unwrap_err();
            assert!(matches!(error, ImageError::Size { .. }), "{error}");
        }
        let error = write_exr_from(&path, &mut Failing { at: 32 }).unwrap_err();
        assert!(error.to_string().contains("rows 32"), "{error}");
        assert!(error.to_string().contains("a.exr"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);

        assert_eq!(read_exr(&path).unwrap_err().exit_code(), 4);
        let pixels = noise(64 * 64);
        write_exr(&path, &Picture { width: 64, height: 64, pixels: &pixels }).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for cut in [0, 3, 8, 100, 500, 700, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..cut]).unwrap();
            let error = read_exr(&path).unwrap_err();
            assert!(matches!(error, ImageError::Malformed { .. }), "{cut}: {error}");
            assert!(error.to_string().contains("a.exr"), "{error}");
        }
    }

    #[test]
    fn a_flipped_byte_is_an_error_or_another_picture_but_no_panic() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let pixels = noise(9 * 20);
        write_exr(&path, &Picture { width: 9, height: 20, pixels: &pixels }).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for at in (0..1200).step_by(5).chain((1200..bytes.len()).step_by(197)) {
            for flip in [0x01, 0x80, 0xff] {
                let mut bad = bytes.clone();
                bad[at] ^= flip;
                std::fs::write(&path, &bad).unwrap();
                if let Err(error) = read_exr(&path) {
                    assert_eq!(error.exit_code(), 4, "{at}: {error}");
                }
            }
        }
    }
}
