//! Automatic exposure: a light meter for interiors.
//!
//! A meter that looks at luminance alone makes a white room and a dark room the same grey. This one
//! is half a reflected-light meter and half an incident-light meter: the target grey follows the
//! square root of what the surfaces reflect. Lamps, sky and anything six stops above the median do
//! not count, nor does what is lost in the dark. All sums are over a histogram, so neither the
//! order of pixels nor the size of bands matters.

use enf_layout::film::PixelRecord;

use crate::{ImageError, Picture, Rows, luminance, rows};
use std::path::Path;

/// Buckets per octave of luminance.
const PER_OCTAVE: usize = 16;
/// Buckets: one for each exponent and leading four bits of a positive `f32`.
const BUCKETS: usize = 256 * PER_OCTAVE;

/// Counts luminances, band by band.
pub struct ExposureMeter {
    /// Pixels per bucket of log luminance, W/m²/sr.
    counts: Vec<u64>,
    /// Pixels per bucket of log albedo.
    albedo: Vec<u64>,
}

impl Default for ExposureMeter {
    fn default() -> Self {
        Self::new()
    }
}

impl ExposureMeter {
    /// A meter that has seen nothing; 64 KiB.
    pub fn new() -> Self {
        Self { counts: vec![0; BUCKETS], albedo: vec![0; BUCKETS] }
    }

    /// Takes in some pixels.
    pub fn add(&mut self, pixels: &[PixelRecord]) {
        for pixel in pixels {
            // Sky through a window, or nothing at all.
            if pixel.depth <= 0.0 || pixel.depth.is_nan() {
                continue;
            }
            let y = luminance(beauty(pixel));
            if let Some(bucket) = bucket(y) {
                self.counts[bucket] += 1;
                if let Some(bucket) = self::bucket(luminance(pixel.albedo)) {
                    self.albedo[bucket] += 1;
                }
            }
        }
    }

    /// The factor that radiance is to be multiplied with before [`crate::tone_map`]; 1 if there is
    /// nothing to be seen.
    pub fn exposure(&self) -> f32 {
        let Some(median) = percentile(&self.counts, 0.5) else { return 1.0 };
        let low = median.saturating_sub(8 * PER_OCTAVE);
        let high = (median + 6 * PER_OCTAVE).min(BUCKETS - 1);
        let mut lit = vec![0; BUCKETS];
        lit[low..=high].copy_from_slice(&self.counts[low..=high]);
        let Some(key) = mean_log2(&lit) else { return 1.0 };
        let albedo = mean_log2(&self.albedo).unwrap_or(-1.0).clamp(-4.0, 0.0);
        let mid_grey = -2.474; // log2 of 0.18
        let target = mid_grey + 0.5 * (albedo - mid_grey);
        let mut stops = target - key;
        // Bright surfaces shall stay on the curve's shoulder: give up at most two stops for them.
        if let Some(bright) = percentile(&lit, 0.95) {
            let over = log2_of(bright) + stops - 1.3;
            stops -= over.clamp(0.0, 2.0);
        }
        libm::exp2(stops.clamp(-120.0, 120.0)) as f32
    }
}

/// Exposure for a picture in memory: the factor for [`crate::write_png`] that makes an interior
/// neither black nor burnt. Depends on the pixels alone.
pub fn exposure(picture: &Picture) -> f32 {
    let mut meter = ExposureMeter::new();
    meter.add(picture.pixels);
    meter.exposure()
}

/// [`exposure`] for a picture that is read row by row; `path` is for error messages.
pub fn exposure_from(path: &Path, rows: &mut dyn Rows) -> Result<f32, ImageError> {
    let mut meter = ExposureMeter::new();
    rows::for_each_band(path, rows, |_, band| {
        meter.add(band);
        Ok(())
    })?;
    Ok(meter.exposure())
}

/// What the eye or camera receives, W/m²/sr.
pub(crate) fn beauty(pixel: &PixelRecord) -> [f32; 3] {
    [0, 1, 2].map(|c| pixel.direct[c] + pixel.indirect[c])
}

fn bucket(value: f32) -> Option<usize> {
    (value > f32::MIN_POSITIVE && value.is_finite()).then(|| (value.to_bits() >> 19) as usize)
}

/// Log2 of the middle of a bucket.
fn log2_of(bucket: usize) -> f64 {
    libm::log2(f64::from(f32::from_bits((bucket as u32) << 19 | 1 << 18)))
}

/// The bucket below which this share of all counts lies.
fn percentile(counts: &[u64], share: f64) -> Option<usize> {
    let total: u64 = counts.iter().sum();
    let rank = (total as f64 * share) as u64;
    let mut seen = 0;
    counts.iter().position(|&n| {
        seen += n;
        seen > rank
    })
}

fn mean_log2(counts: &[u64]) -> Option<f64> {
    let total: u64 = counts.iter().sum();
    let sum: f64 =
        counts.iter().enumerate().filter(|c| *c.1 > 0).map(|(b, &n)| log2_of(b) * n as f64).sum();
    (total > 0).then(|| sum / total as f64)
}

/// The luminance (W/m²/sr) that all but `share` of the seen pixels stay below, lamps left out.
pub(crate) fn bright_luminance(meter: &ExposureMeter, share: f64) -> Option<f32> {
    let median = percentile(&meter.counts, 0.5)?;
    let high = (median + 6 * PER_OCTAVE).min(BUCKETS - 1);
    let bucket = percentile(&meter.counts[..=high], 1.0 - share)?;
    Some(f32::from_bits((bucket as u32 + 1) << 19))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tone_map;

    fn wall(y: f32, albedo: f32) -> PixelRecord {
        PixelRecord {
            direct: [y * 0.75; 3],
            indirect: [y * 0.25; 3],
            albedo: [albedo; 3],
            depth: 3.0,
            room: 1.0,
            ..Default::default()
        }
    }

    fn meter(pixels: &[PixelRecord]) -> f32 {
        exposure(&Picture { width: pixels.len() as u32, height: 1, pixels })
    }

    #[test]
    fn brightness_of_the_lamps_does_not_matter() {
        let room: Vec<_> = (0..1000).map(|i| wall(0.1 + 0.001 * i as f32, 0.6)).collect();
        for power in [1e-6f32, 1.0, 1e5] {
            let scaled: Vec<_> = room
                .iter()
                .map(|p| PixelRecord {
                    direct: p.direct.map(|c| c * power),
                    indirect: p.indirect.map(|c| c * power),
                    ..*p
                })
                .collect();
            let ratio = meter(&scaled) * power / meter(&room);
            assert!((0.9..1.1).contains(&ratio), "{power}: {ratio}");
        }
    }

    #[test]
    fn lamps_and_sky_and_darkness_do_not_pull_the_exposure() {
        let mut pixels: Vec<_> = (0..1000).map(|i| wall(0.2 + 0.0004 * i as f32, 0.5)).collect();
        let plain = meter(&pixels);
        pixels.extend((0..100).map(|_| wall(5000.0, 0.8)));
        pixels.extend((0..100).map(|_| wall(1e-7, 0.5)));
        pixels.extend((0..900).map(|_| PixelRecord { direct: [30.0; 3], ..Default::default() }));
        let with = meter(&pixels);
        assert!((0.8..1.25).contains(&(with / plain)), "{with} against {plain}");
    }

    #[test]
    fn interiors_are_neither_black_nor_burnt() {
        // Ten to one across the room, a lit ceiling corner, a dark doorway.
        for albedo in [0.15f32, 0.5, 0.85] {
            let pixels: Vec<_> = (0..1000)
                .map(|i| {
                    let e = match i {
                        ..40 => 0.01,
                        40..950 => 1.0 + 9.0 * (i as f32 / 1000.0),
                        _ => 60.0,
                    };
                    wall(e * albedo / std::f32::consts::PI, albedo)
                })
                .collect();
            let factor = meter(&pixels);
            let mut shown: Vec<f32> =
                pixels.iter().map(|p| crate::encode_srgb(tone_map(beauty(p), factor)[0])).collect();
            shown.sort_by(f32::total_cmp);
            assert!((0.35..0.75).contains(&shown[500]), "albedo {albedo}: median {}", shown[500]);
            assert!(shown[900] < 0.93, "albedo {albedo}: bright {}", shown[900]);
            assert!(shown[100] > 0.2, "albedo {albedo}: dark {}", shown[100]);
        }
        // A white room looks lighter than a black one.
        let look = |a: f32| {
            let pixels = vec![wall(a, a); 50];
            tone_map(beauty(&pixels[0]), meter(&pixels))[0]
        };
        assert!(look(0.85) > 1.5 * look(0.15));
    }

    #[test]
    fn nothing_to_see_is_exposure_one() {
        assert_eq!(meter(&[]), 1.0);
        assert_eq!(meter(&[PixelRecord::default(); 9]), 1.0);
        let bad = PixelRecord { direct: [f32::NAN; 3], depth: 1.0, ..Default::default() };
        assert_eq!(meter(&[bad; 9]), 1.0);
    }
}
