//! Where pixels come from: a slice, or an owner that hands out rows one band at a time.

use std::error::Error;
use std::path::Path;

use enf_layout::film::PixelRecord;

use crate::ImageError;

/// Rows that are read, converted and written together (an OpenEXR ZIP block).
pub(crate) const BAND_ROWS: u32 = 16;

/// What the owner of some rows may fail with.
pub type RowsError = Box<dyn Error + Send + Sync>;

/// A picture that need not be in memory: its rows are asked for in bands, top to bottom. Writers
/// make one pass; [`crate::falsecolour_png_from`] without a maximum makes two.
pub trait Rows {
    /// Width, pixels.
    fn width(&self) -> u32;
    /// Height, pixels.
    fn height(&self) -> u32;
    /// Fills `out` (a whole number of rows) with the rows from `first_row` on; row 0 is the top.
    fn read(&mut self, first_row: u32, out: &mut [PixelRecord]) -> Result<(), RowsError>;
}

/// A finished picture in memory: rows from the top, pixels from the left.
#[derive(Clone, Copy, Debug)]
pub struct Picture<'a> {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// `width * height` pixels.
    pub pixels: &'a [PixelRecord],
}

impl Picture<'_> {
    /// The picture, if its size fits its pixels.
    pub(crate) fn checked(self, path: &Path) -> Result<Self, ImageError> {
        let (width, height, pixels) = (self.width, self.height, self.pixels.len());
        if (width as usize).checked_mul(height as usize) != Some(pixels) || pixels == 0 {
            return Err(ImageError::Size { path: path.to_owned(), width, height, pixels });
        }
        Ok(self)
    }
}

impl Rows for Picture<'_> {
    fn width(&self) -> u32 {
        self.width
    }

    fn height(&self) -> u32 {
        self.height
    }

    fn read(&mut self, first_row: u32, out: &mut [PixelRecord]) -> Result<(), RowsError> {
        let start = first_row as usize * self.width as usize;
        let rows = self.pixels.get(start..).and_then(|rest| rest.get(..out.len()));
        out.copy_from_slice(rows.ok_or("fewer pixels than width times height")?);
        Ok(())
    }
}

/// Bytes of memory that any writer takes for a picture of this width, whatever its height, for the
/// caller's budget: one band of records, its encoded form, and the compressor's state.
pub fn scratch_bytes(width: u32) -> usize {
    let pixels = width as usize * BAND_ROWS as usize;
    // Records; EXR planes before, while and after they are compressed; deflate's own tables.
    pixels * (size_of::<PixelRecord>() + 4 * crate::openexr::BYTES_PER_PIXEL) + (2 << 20)
}

/// Calls `each` with every band of the picture, top to bottom: its first row and its pixels.
pub(crate) fn for_each_band(
    path: &Path,
    rows: &mut dyn Rows,
    mut each: impl FnMut(u32, &[PixelRecord]) -> Result<(), ImageError>,
) -> Result<(), ImageError> {
    let (width, height) = size(path, rows)?;
    let mut band = vec![PixelRecord::default(); width as usize * BAND_ROWS.min(height) as usize];
    for first_row in (0..height).step_by(BAND_ROWS as usize) {
        let count = BAND_ROWS.min(height - first_row) as usize * width as usize;
        rows.read(first_row, &mut band[..count]).map_err(|source| ImageError::Rows {
            path: path.to_owned(),
            first_row,
            source,
        })?;
        each(first_row, &band[..count])?;
    }
    Ok(())
}

/// Width and height, both at least 1 and small enough for every format.
pub(crate) fn size(path: &Path, rows: &dyn Rows) -> Result<(u32, u32), ImageError> {
    let (width, height) = (rows.width(), rows.height());
    let most = 1 << 24;
    if width == 0 || height == 0 || width > most || height > most {
        let pixels = (u64::from(width) * u64::from(height)).try_into().unwrap_or(usize::MAX);
        return Err(ImageError::Size { path: path.to_owned(), width, height, pixels });
    }
    Ok((width, height))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Pixels like those of a noisy interior; the same every time.
    pub(crate) fn noise(count: u32) -> Vec<PixelRecord> {
        let mut state = 7u64;
        let mut next = move || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        (0..count)
            .map(|i| PixelRecord {
                direct: [next() * 3.0, next() * 2.0, next()],
                indirect: [next(), next(), next() * 0.1],
                albedo: [next(), next(), next()],
                normal: [next() - 0.5, next() - 0.5, next() - 0.5],
                depth: 1.0 + next() * 9.0,
                room: (i % 5) as f32,
            })
            .collect()
    }

    /// A picture of 50 x 50 pixels whose rows from `at` on cannot be read.
    pub(crate) struct Failing {
        pub(crate) at: u32,
    }

    impl Rows for Failing {
        fn width(&self) -> u32 {
            50
        }

        fn height(&self) -> u32 {
            50
        }

        fn read(&mut self, first_row: u32, out: &mut [PixelRecord]) -> Result<(), RowsError> {
            out.fill(PixelRecord::default());
            if first_row >= self.at { Err("the band is damaged".into()) } else { Ok(()) }
        }
    }

    #[test]
    fn bands_cover_every_row_once() {
        let pixels = noise(3 * 37);
        let mut picture = Picture { width: 3, height: 37, pixels: &pixels };
        let mut all = Vec::new();
        for_each_band(Path::new("p"), &mut picture, |first, band| {
            assert_eq!(first as usize * 3, all.len());
            all.extend_from_slice(band);
            Ok(())
        })
        .unwrap();
        assert_eq!(all, pixels);
    }
}
