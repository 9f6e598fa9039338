//! Radiance HDR (RGBE, Ward 1991) with run-length encoded scan lines, as Radiance 2 and later
//! write them. Mantissas are cut down, not rounded: Radiance's readers add half a step back.

use std::io::Write;
use std::path::Path;

use crate::aside::Aside;
use crate::exposure::beauty;
use crate::{ImageError, Picture, Rows, rows};

/// Shortest repetition worth a run.
const MIN_RUN: usize = 4;
/// Widths whose scan lines can be run-length encoded.
const RLE_WIDTHS: std::ops::RangeInclusive<u32> = 8..=0x7fff;

/// Writes a picture's radiance (direct + indirect, W/m²/sr) as Radiance HDR. What is negative or
/// no number becomes 0; each channel is within 1/256 of the largest of its pixel as Radiance reads it. The file appears
/// complete or not at all.
pub fn write_hdr(path: &Path, picture: &Picture) -> Result<(), ImageError> {
    write_hdr_from(path, &mut picture.checked(path)?)
}

/// [`write_hdr`] for a picture that is read row by row; [`crate::scratch_bytes`] of memory.
pub fn write_hdr_from(path: &Path, rows: &mut dyn Rows) -> Result<(), ImageError> {
    let (width, height) = rows::size(path, rows)?;
    let mut aside = Aside::create(path)?;
    let head = format!(
        "#?RADIANCE\n\
         SOFTWARE=Enfilade\n\
         PRIMARIES= 0.6400 0.3300 0.3000 0.6000 0.1500 0.0600 0.3127 0.3290\n\
         FORMAT=32-bit_rle_rgbe\n\n\
         -Y {height} +X {width}\n"
    );
    let fail = |e| ImageError::write(path, e);
    aside.write_all(head.as_bytes()).map_err(fail)?;
    let mut line = Vec::with_capacity(width as usize);
    let mut bytes = Vec::with_capacity(width as usize * 5);
    rows::for_each_band(path, rows, |_, band| {
        for row in band.chunks_exact(width as usize) {
            line.clear();
            line.extend(row.iter().map(|p| encode(beauty(p))));
            bytes.clear();
            scan_line(&line, &mut bytes);
            aside.write_all(&bytes).map_err(fail)?;
        }
        Ok(())
    })?;
    aside.finish()
}

/// Four bytes for a colour: mantissas in units of 2^(e - 136).
fn encode(rgb: [f32; 3]) -> [u8; 4] {
    let rgb = rgb.map(|c| if c > 0.0 { c.min(1.7e38) } else { 0.0 });
    let largest = rgb[0].max(rgb[1]).max(rgb[2]);
    if largest < 1e-32 {
        return [0; 4];
    }
    // largest = m 2^exponent with m in [0.5, 1).
    let exponent = (largest.to_bits() >> 23) as i32 - 126;
    let scale = libm::scalbn(1.0, 8 - exponent);
    let [r, g, b] = rgb.map(|c| (f64::from(c) * scale) as u8);
    [r, g, b, (exponent + 128) as u8]
}

fn scan_line(line: &[[u8; 4]], out: &mut Vec<u8>) {
    let width = line.len() as u32;
    if !RLE_WIDTHS.contains(&width) {
        // Flat. No pixel looks like a run or a line's head to an old reader (mantissas 1 1 1, or
        // 2 2 and a small one): the largest mantissa is always 128 or more.
        out.extend(line.iter().flatten());
        return;
    }
    out.extend([2, 2, (width >> 8) as u8, width as u8]);
    for channel in 0..4 {
        let at = |i: usize| line[i][channel];
        let mut start = 0;
        while start < line.len() {
            // The next run, and how much lies before it.
            let (mut run, mut length) = (start, 0);
            while run < line.len() {
                length = 1;
                while length < 127 && run + length < line.len() && at(run + length) == at(run) {
                    length += 1;
                }
                if length >= MIN_RUN {
                    break;
                }
                run += length;
                length = 0;
            }
            while start < run {
                let count = (run - start).min(128);
                out.push(count as u8);
                out.extend((start..start + count).map(at));
                start += count;
            }
            if length > 0 {
                out.extend([128 + length as u8, at(run)]);
                start = run + length;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::tests::noise;
    use enf_layout::film::PixelRecord;
    use proptest::prelude::*;

    fn decode(code: [u8; 4]) -> [f32; 3] {
        if code[3] == 0 {
            return [0.0; 3];
        }
        let scale = 2f64.powi(i32::from(code[3]) - 136);
        [0, 1, 2].map(|c| ((f64::from(code[c]) + 0.5) * scale) as f32)
    }

    /// A reader as Radiance has it (`freadcolrs`).
    fn read(bytes: &[u8]) -> (usize, usize, Vec<[u8; 4]>) {
        let head = bytes.windows(2).position(|w| w == b"\n\n").unwrap();
        let text = std::str::from_utf8(&bytes[..head]).unwrap();
        assert!(text.starts_with("#?RADIANCE\n") && text.ends_with("FORMAT=32-bit_rle_rgbe"));
        let end = head + 2 + bytes[head + 2..].iter().position(|&b| b == b'\n').unwrap();
        let size: Vec<&str> =
            std::str::from_utf8(&bytes[head + 2..end]).unwrap().split(' ').collect();
        assert_eq!((size[0], size[2]), ("-Y", "+X"));
        let (height, width): (usize, usize) = (size[1].parse().unwrap(), size[3].parse().unwrap());
        let mut data = bytes[end + 1..].iter().copied();
        let mut next = || data.next().unwrap();
        let mut pixels = Vec::new();
        for _ in 0..height {
            let mut line = vec![[0; 4]; width];
            if RLE_WIDTHS.contains(&(width as u32)) {
                assert_eq!([next(), next()], [2, 2]);
                assert_eq!(usize::from(next()) << 8 | usize::from(next()), width);
                for c in 0..4 {
                    let mut x = 0;
                    while x < width {
                        let code = usize::from(next());
                        if code > 128 {
                            let value = next();
                            line[x..x + (code & 127)].iter_mut().for_each(|p| p[c] = value);
                            x += code & 127;
                        } else {
                            assert!(code > 0);
                            line[x..x + code].iter_mut().for_each(|p| p[c] = next());
                            x += code;
                        }
                    }
                }
            } else {
                line.iter_mut().for_each(|p| *p = [next(), next(), next(), next()]);
            }
            pixels.extend(line);
        }
        assert_eq!(data.next(), None);
        (width, height, pixels)
    }

    #[test]
    fn a_round_trip_is_within_one_step() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.hdr");
        for (width, height) in [(1, 1), (7, 3), (8, 2), (300, 20), (40_000, 1)] {
            let mut pixels = noise(width * height);
            // Long runs as well.
            let flat = pixels[0];
            pixels.iter_mut().skip(100).step_by(2).take(60).for_each(|p| *p = flat);
            pixels.iter_mut().skip(300).take(1000).for_each(|p| *p = flat);
            write_hdr(&path, &Picture { width, height, pixels: &pixels }).unwrap();
            let (w, h, codes) = read(&std::fs::read(&path).unwrap());
            assert_eq!((w as u32, h as u32), (width, height));
            for (pixel, code) in pixels.iter().zip(codes) {
                let (want, got) = (beauty(pixel), decode(code));
                let largest = want[0].max(want[1]).max(want[2]);
                for c in 0..3 {
                    assert!((want[c] - got[c]).abs() <= largest / 256.0 * 1.0001);
                }
            }
        }
    }

    #[test]
    fn runs_make_flat_pictures_small() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.hdr");
        let pixels = vec![PixelRecord { direct: [1.0, 2.0, 3.0], ..Default::default() }; 1000 * 10];
        write_hdr(&path, &Picture { width: 1000, height: 10, pixels: &pixels }).unwrap();
        assert!(std::fs::metadata(&path).unwrap().len() < 1100);
    }

    proptest! {
        #[test]
        fn any_colour_is_within_one_step(
            m in prop::array::uniform3(0.0f32..1.0),
            e in -90i32..120,
        ) {
            let rgb = m.map(|c| c * 2f32.powi(e));
            let back = decode(encode(rgb));
            let largest = rgb[0].max(rgb[1]).max(rgb[2]);
            for c in 0..3 {
                prop_assert!((back[c] - rgb[c]).abs() <= largest / 256.0 * 1.0001);
            }
        }

        #[test]
        fn any_line_survives(bytes in prop::collection::vec(0u8..3, 8..700)) {
            let line: Vec<[u8; 4]> = bytes.iter().map(|&b| [b, b / 2, 7, 128]).collect();
            let mut file = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n".to_vec();
            file.extend(format!("-Y 1 +X {}\n", line.len()).bytes());
            scan_line(&line, &mut file);
            prop_assert_eq!(read(&file).2, line);
        }
    }

    #[test]
    fn odd_values_do_no_harm() {
        assert_eq!(encode([f32::NAN, -1.0, 0.0]), [0; 4]);
        assert_eq!(encode([f32::INFINITY, 0.0, 0.0])[3], 255);
        assert_eq!(encode([1.0; 3]), [128, 128, 128, 129]);
        assert_eq!(encode([1e-40; 3]), [0; 4]);
    }
}
