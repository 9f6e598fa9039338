//! Falsecolour: numbers as colours, with a legend.
//!
//! The colours are viridis (van der Walt and Smith 2015): equal steps look equal, also without
//! colour vision and in print. The scale is linear from 0; black is "nothing there".

use std::path::Path;

use crate::exposure::{beauty, bright_luminance};
use crate::font::{self, ADVANCE, HEIGHT};
use crate::portable::{Canvas, write_rgb};
use crate::{ExposureMeter, ImageError, LUMENS_PER_WATT, Picture, Rows, luminance, rows};

/// viridis at equal steps, sRGB.
#[rustfmt::skip]
const VIRIDIS: [[u8; 3]; 33] = [
    [68, 1, 84], [70, 12, 95], [71, 24, 106], [72, 34, 115], [71, 44, 123], [69, 54, 129],
    [66, 64, 133], [62, 73, 137], [58, 82, 139], [54, 90, 140], [50, 98, 141], [47, 106, 141],
    [44, 114, 142], [40, 122, 142], [38, 129, 142], [35, 137, 141], [32, 144, 140], [30, 152, 138],
    [30, 159, 136], [33, 167, 132], [40, 174, 127], [50, 181, 122], [62, 188, 115], [77, 194, 107],
    [94, 201, 97], [112, 206, 86], [131, 211, 75], [151, 216, 62], [173, 220, 48], [194, 223, 34],
    [215, 226, 25], [236, 228, 26], [253, 231, 36],
];

/// The colour of a share of the scale, clamped to `[0, 1]`.
fn viridis(share: f32) -> [u8; 3] {
    let at = share.clamp(0.0, 1.0) * (VIRIDIS.len() - 1) as f32;
    let below = (at as usize).min(VIRIDIS.len() - 2);
    let (a, b) = (VIRIDIS[below], VIRIDIS[below + 1]);
    let weight = at - below as f32;
    [0, 1, 2].map(|c| {
        let (a, b) = (f32::from(a[c]), f32::from(b[c]));
        (a + (b - a) * weight + 0.5) as u8
    })
}

/// Writes a picture's luminance in cd/m² (179 lm/W) as falsecolour PNG, a legend on its right.
/// Without `max_cd_m2` the scale ends at a round number that at most one pixel in twenty exceeds, lamps
/// left out. The file appears complete or not at all.
pub fn falsecolour_png(
    path: &Path,
    picture: &Picture,
    max_cd_m2: Option<f32>,
) -> Result<(), ImageError> {
    falsecolour_png_from(path, &mut picture.checked(path)?, max_cd_m2)
}

/// [`falsecolour_png`] for a picture that is read row by row, twice if `max_cd_m2` is `None`;
/// [`crate::scratch_bytes`] of memory.
pub fn falsecolour_png_from(
    path: &Path,
    rows: &mut dyn Rows,
    max_cd_m2: Option<f32>,
) -> Result<(), ImageError> {
    let (width, height) = rows::size(path, rows)?;
    let max = match usable(max_cd_m2) {
        Some(max) => max,
        None => {
            let mut meter = ExposureMeter::new();
            rows::for_each_band(path, rows, |_, band| {
                meter.add(band);
                Ok(())
            })?;
            round_up(bright_luminance(&meter, 0.05).unwrap_or(1.0) * LUMENS_PER_WATT)
        }
    };
    let chart = Chart::new(width, height, max, "cd/m²");
    write_rgb(path, chart.width(), chart.height, |canvas| {
        let mut values = vec![0.0; width as usize];
        rows::for_each_band(path, rows, |first_row, band| {
            for (y, row) in band.chunks_exact(width as usize).enumerate() {
                for (value, pixel) in values.iter_mut().zip(row) {
                    let y = luminance(beauty(pixel)) * LUMENS_PER_WATT;
                    *value = if pixel.depth > 0.0 || y > 0.0 { y } else { f32::NAN };
                }
                chart.row(canvas, first_row + y as u32, &values)?;
            }
            Ok(())
        })?;
        chart.rest(canvas)
    })
}

/// Writes any grid of values (illuminance in lux on a work plane, say) as falsecolour PNG, rows
/// from the top; NaN is "no value" and black. `unit` stands above the legend. Without `max` the
/// scale ends at a round number that at most one value in fifty exceeds.
pub fn falsecolour_map_png(
    path: &Path,
    width: u32,
    height: u32,
    values: &[f32],
    unit: &str,
    max: Option<f32>,
) -> Result<(), ImageError> {
    let pixels = values.len();
    if (width as usize).checked_mul(height as usize) != Some(pixels) || pixels == 0 {
        return Err(ImageError::Size { path: path.to_owned(), width, height, pixels });
    }
    let max = usable(max).unwrap_or_else(|| {
        let mut sorted: Vec<f32> = values.iter().copied().filter(|v| v.is_finite()).collect();
        sorted.sort_unstable_by(f32::total_cmp);
        let rank = (sorted.len() as f64 * 0.98) as usize;
        round_up(sorted.get(rank).copied().unwrap_or(1.0))
    });
    let chart = Chart::new(width, height, max, unit);
    write_rgb(path, chart.width(), chart.height, |canvas| {
        for (y, row) in values.chunks_exact(width as usize).enumerate() {
            chart.row(canvas, y as u32, row)?;
        }
        chart.rest(canvas)
    })
}

/// An end of scale that makes sense.
fn usable(max: Option<f32>) -> Option<f32> {
    max.filter(|m| m.is_finite() && *m > 0.0)
}

/// The next number of 1, 2, 5, 10, ... that is not below; 1 for what is no positive number.
fn round_up(value: f32) -> f32 {
    if !(1e-30..=1e30).contains(&value) {
        return 1.0;
    }
    let value = f64::from(value) * (1.0 - 1e-6);
    let mut decade = 1.0;
    while decade > value {
        decade /= 10.0;
    }
    while decade * 10.0 <= value {
        decade *= 10.0;
    }
    let step = [1.0, 2.0, 5.0].into_iter().find(|s| s * decade >= value).unwrap_or(10.0);
    (step * decade) as f32
}

/// Three significant digits, without needless zeros.
fn label(value: f32) -> String {
    if value == 0.0 {
        return "0".into();
    }
    if !(1e-3..1e6).contains(&value) {
        return format!("{value:.1e}").replace(".0e", "e");
    }
    let digits = if value >= 100.0 {
        0
    } else if value >= 10.0 {
        1
    } else if value >= 1.0 {
        2
    } else {
        4
    };
    let text = format!("{value:.digits$}");
    if digits == 0 { text } else { text.trim_end_matches('0').trim_end_matches('.').into() }
}

const PAPER: [u8; 3] = [24, 24, 24];
const INK: [u8; 3] = [235, 235, 235];
/// Layout of the legend in dots: margin, width of the bar, length of a tick, top of the bar.
const MARGIN: usize = 6;
const BAR: usize = 12;
const TICK: usize = 3;
const TOP: usize = MARGIN + HEIGHT + MARGIN + HEIGHT / 2;

/// A picture with its legend.
struct Chart {
    picture_width: usize,
    picture_height: u32,
    /// Height of picture and legend, whichever is more.
    height: u32,
    max: f32,
    unit: String,
    /// Labels from the bottom (0) to the top.
    labels: Vec<String>,
    /// Pixels per dot of the legend.
    scale: usize,
}

impl Chart {
    fn new(picture_width: u32, picture_height: u32, max: f32, unit: &str) -> Self {
        let scale = (picture_height as usize / 360).clamp(1, 8);
        let steps = if picture_height as usize / scale >= 200 { 10 } else { 5 };
        let least = TOP + 5 * (HEIGHT + 3) + HEIGHT / 2 + MARGIN;
        Self {
            picture_width: picture_width as usize,
            picture_height,
            height: picture_height.max(least as u32),
            max,
            unit: unit.into(),
            labels: (0..=steps).map(|i| label(max * i as f32 / steps as f32)).collect(),
            scale,
        }
    }

    /// Width of the legend, pixels.
    fn legend(&self) -> usize {
        let longest =
            |texts: &[String]| texts.iter().map(|t| t.chars().count()).max().unwrap_or(0) * ADVANCE;
        let below = BAR + TICK + 2 + longest(&self.labels);
        self.scale * (MARGIN + below.max(longest(std::slice::from_ref(&self.unit))) + MARGIN)
    }

    fn width(&self) -> u32 {
        (self.picture_width + self.legend()) as u32
    }

    /// The legend's colour at a pixel.
    fn legend_pixel(&self, x: usize, y: usize) -> [u8; 3] {
        let (x, y) = (x / self.scale, y / self.scale);
        let last = (self.height as usize / self.scale).saturating_sub(1 + MARGIN + HEIGHT / 2);
        let bar = last.saturating_sub(TOP).max(1);
        let Some(x) = x.checked_sub(MARGIN) else { return PAPER };
        if y >= MARGIN && font::dot(&self.unit, x, y - MARGIN) {
            return INK;
        }
        if x < BAR {
            let inside = (TOP..=last).contains(&y);
            return if inside { viridis((last - y) as f32 / bar as f32) } else { PAPER };
        }
        let steps = self.labels.len() - 1;
        for (i, text) in self.labels.iter().enumerate() {
            let middle = last - bar * i / steps;
            let tick = y == middle && x < BAR + TICK;
            let top = middle - HEIGHT / 2;
            let text_x = x.checked_sub(BAR + TICK + 2);
            if tick || (y >= top && text_x.is_some_and(|x| font::dot(text, x, y - top))) {
                return INK;
            }
        }
        PAPER
    }

    /// Paints row `y`: the picture's values, then the legend.
    fn row(&self, canvas: &mut Canvas, y: u32, values: &[f32]) -> Result<(), ImageError> {
        let mut bytes = Vec::with_capacity(3 * self.width() as usize);
        bytes.extend(
            values.iter().flat_map(
                |&value| {
                    if value.is_nan() { [0; 3] } else { viridis(value / self.max) }
                },
            ),
        );
        bytes.resize(3 * self.picture_width, 0);
        bytes.extend((0..self.legend()).flat_map(|x| self.legend_pixel(x, y as usize)));
        canvas.row(&bytes)
    }

    /// The rows below a picture that is lower than its legend.
    fn rest(&self, canvas: &mut Canvas) -> Result<(), ImageError> {
        (self.picture_height..self.height).try_for_each(|y| self.row(canvas, y, &[]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::portable::tests::decode;
    use crate::rows::tests::noise;
    use enf_layout::film::PixelRecord;

    #[test]
    fn scales_end_at_round_numbers() {
        for (value, want) in [
            (0.0011, 0.002),
            (0.3, 0.5),
            (1.0, 1.0),
            (1.01, 2.0),
            (430.0, 500.0),
            (5001.0, 10_000.0),
            (0.0, 1.0),
            (f32::NAN, 1.0),
            (f32::INFINITY, 1.0),
        ] {
            assert_eq!(round_up(value), want, "{value}");
        }
        let labels = [0.0, 0.05, 0.5, 1.25, 12.5, 200.0, 20_000.0, 2e7, 1e-5].map(label);
        assert_eq!(labels, ["0", "0.05", "0.5", "1.25", "12.5", "200", "20000", "2e7", "1e-5"]);
    }

    #[test]
    fn colours_and_black_are_where_they_belong() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let values = [0.0, 250.0, 500.0, 9000.0, f32::NAN, -1.0];
        falsecolour_map_png(&path, 3, 2, &values, "lux", Some(500.0)).unwrap();
        let (width, height, bytes) = decode(&path);
        let at = |x: usize, y: usize| -> [u8; 3] {
            bytes[3 * (y * width as usize + x)..][..3].try_into().unwrap()
        };
        assert_eq!((at(0, 0), at(1, 0)), (VIRIDIS[0], VIRIDIS[16]));
        assert_eq!((at(2, 0), at(0, 1)), (VIRIDIS[32], VIRIDIS[32]));
        assert_eq!((at(1, 1), at(2, 1)), ([0; 3], VIRIDIS[0]));
        assert!(height >= 70 && width > 40);
        // The whole colour bar is there.
        let bar: Vec<_> = (0..height as usize).map(|y| at(3 + MARGIN + 2, y)).collect();
        assert!(bar.contains(&VIRIDIS[0]) && bar.contains(&VIRIDIS[32]));
        assert!(bytes.chunks(3).filter(|p| *p == INK).count() > 100, "labels are drawn");
    }

    #[test]
    fn luminance_is_179_lumens_per_watt() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        // 1 W/m²/sr of white in the middle of a scale that ends at 358 cd/m².
        let pixels = vec![PixelRecord { indirect: [1.0; 3], depth: 1.0, ..Default::default() }; 4];
        falsecolour_png(&path, &Picture { width: 2, height: 2, pixels: &pixels }, Some(358.0))
            .unwrap();
        assert_eq!(decode(&path).2[..3], VIRIDIS[16]);
        let pixels = noise(40 * 30);
        let picture = Picture { width: 40, height: 30, pixels: &pixels };
        for max in [None, Some(f32::NAN), Some(-1.0), Some(0.0)] {
            falsecolour_png(&path, &picture, max).unwrap();
        }
        let black = vec![PixelRecord::default(); 4];
        falsecolour_png(&path, &Picture { width: 2, height: 2, pixels: &black }, None).unwrap();
        assert_eq!(decode(&path).2[..6], [0; 6]);
        assert!(falsecolour_map_png(&path, 3, 3, &[1.0], "lux", None).is_err());
    }
}
