//! From scene radiance to what a screen shows.

/// Lumens per watt of white light: what turns W/m²/sr into cd/m² (the constant of Radiance).
pub const LUMENS_PER_WATT: f32 = 179.0;

/// Luminance of linear Rec.709, in the unit of its channels.
pub fn luminance(rgb: [f32; 3]) -> f32 {
    0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]
}

/// Exposed luminance that becomes display white.
const WHITE: f32 = 6.25;

/// The filmic curve of Hable (2010, "Filmic Tonemapping for Real-time Rendering"), scaled so that
/// mid grey stays mid grey, and [`WHITE`] becomes 1.
fn filmic(x: f32) -> f32 {
    let hable = |x: f32| {
        let (a, b, c, d, e, f) = (0.15, 0.5, 0.1, 0.2, 0.02, 0.3);
        (x * (a * x + c * b) + d * e) / (x * (a * x + b) + d * f) - e / f
    };
    const SPEED: f32 = 3.2;
    let x = if x > 0.0 { x.min(WHITE) } else { 0.0 };
    (hable(SPEED * x) / hable(SPEED * WHITE)).clamp(0.0, 1.0)
}

/// How radiance becomes display values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tone {
    /// [`tone_map`]: highlights roll off, hues stay.
    #[default]
    Filmic,
    /// As it is; what is too bright for the screen is cut off, channel by channel.
    Linear,
}

impl Tone {
    /// Radiance times `exposure` as linear display values in `[0, 1]`.
    pub fn map(self, rgb: [f32; 3], exposure: f32) -> [f32; 3] {
        match self {
            Self::Filmic => tone_map(rgb, exposure),
            Self::Linear => rgb.map(|c| {
                let c = c * exposure;
                // What is no number is black.
                if c > 0.0 { c.min(1.0) } else { 0.0 }
            }),
        }
    }
}

/// The exposure of an exposure value (EV at ISO 100): 1.2 times 2 to its power, in cd/m², is display white (ISO 12232,
/// saturation-based speed, without the lens).
pub fn exposure_of_ev(ev: f32) -> f32 {
    LUMENS_PER_WATT / (1.2 * libm::exp2f(ev))
}

/// Radiance times `exposure`, through the filmic curve, as linear display values in `[0, 1]`.
///
/// The curve works on luminance, so hues do not turn; what is too bright and too saturated for a
/// screen goes straight towards the grey of its own luminance, white at last. What is not finite
/// or negative counts as 0.
pub fn tone_map(rgb: [f32; 3], exposure: f32) -> [f32; 3] {
    // Far beyond white everything is white; the bound keeps ratios finite.
    let rgb = rgb.map(|c| {
        let c = c * exposure;
        if c > 0.0 { c.min(1e30) } else { 0.0 }
    });
    let before = luminance(rgb);
    if before <= 1e-30 {
        return [0.0; 3];
    }
    let after = filmic(before);
    let mapped = rgb.map(|c| c / before * after);
    let largest = mapped[0].max(mapped[1]).max(mapped[2]);
    // How much saturation a screen could show, and a smooth minimum of that and all of it.
    let room = (1.0 - after) / (largest - after).max(1e-6);
    let keep = room / (1.0 + room * room * room * room).sqrt().sqrt();
    mapped.map(|c| (after + (c - after) * keep).clamp(0.0, 1.0))
}

/// The sRGB transfer function (IEC 61966-2-1): linear `[0, 1]` to encoded `[0, 1]`.
pub fn encode_srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 {
        12.92 * linear.max(0.0)
    } else if linear >= 1.0 {
        1.0
    } else {
        (1.055 * libm::powf(linear, 1.0 / 2.4) - 0.055).min(1.0)
    }
}

/// Thresholds of an 8 x 8 ordered dither (Bayer 1973), in `(0, 1)`, mean one half.
pub(crate) fn dither(x: usize, y: usize) -> f32 {
    let (x, y) = (x as u32 & 7, y as u32 & 7);
    let mut v = 0;
    for bit in 0..3 {
        let (bx, by) = (x >> bit & 1, y >> bit & 1);
        v |= ((bx ^ by) << 1 | by) << (2 * (2 - bit));
    }
    (v as f32 + 0.5) / 64.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_is_linear_up_to_white() {
        assert_eq!(Tone::Linear.map([0.1, 0.5, 3.0], 0.5), [0.05, 0.25, 1.0]);
        assert_eq!(Tone::Linear.map([-1.0, f32::NAN, f32::INFINITY], 1.0), [0.0, 0.0, 1.0]);
        assert_eq!(Tone::Filmic.map([0.1, 0.5, 3.0], 0.5), tone_map([0.1, 0.5, 3.0], 0.5));
        // EV 7: white at 153.6 cd/m2; a step is a factor of two.
        assert!((exposure_of_ev(7.0) * 153.6 / LUMENS_PER_WATT - 1.0).abs() < 1e-6);
        assert_eq!(exposure_of_ev(6.0), 2.0 * exposure_of_ev(7.0));
    }
    use proptest::prelude::*;

    #[test]
    fn mid_grey_stays_and_white_is_white() {
        assert!((filmic(0.18) - 0.18).abs() < 0.01, "{}", filmic(0.18));
        assert_eq!(tone_map([WHITE; 3], 1.0), [1.0; 3]);
        assert_eq!(tone_map([0.0; 3], 1.0), [0.0; 3]);
        assert_eq!(tone_map([f32::NAN, -1.0, 0.0], 1.0), [0.0; 3]);
        let mut last = -1.0;
        for i in 0..2000 {
            let y = filmic(i as f32 * 0.004);
            assert!(y >= last);
            last = y;
        }
    }

    #[test]
    fn srgb_agrees_with_the_standard() {
        assert_eq!(encode_srgb(0.0), 0.0);
        assert_eq!(encode_srgb(1.0), 1.0);
        assert!((encode_srgb(0.214_041_14) - 0.5).abs() < 1e-5);
        assert!((encode_srgb(0.003_130_8) - 0.040_449_9).abs() < 1e-5);
    }

    #[test]
    fn every_dither_threshold_comes_once() {
        let mut seen = [0; 64];
        for y in 0..8 {
            for x in 0..8 {
                seen[(dither(x, y) * 64.0) as usize] += 1;
            }
        }
        assert_eq!(seen, [1; 64]);
    }

    proptest! {
        #[test]
        fn hue_and_order_of_channels_survive(r in 0.0f32..50.0, g in 0.0f32..50.0, b in 0.0f32..50.0) {
            let out = tone_map([r, g, b], 0.7);
            prop_assert!(out.iter().all(|c| (0.0..=1.0).contains(c)));
            let (a, z) = ([r, g, b], out);
            for (i, j) in [(0, 1), (1, 2), (0, 2)] {
                prop_assert!((a[i] >= a[j]) == (z[i] >= z[j]) || (z[i] - z[j]).abs() < 1e-5);
            }
            // The hue: ratio of channel differences.
            let (da, db) = (r - g, b - g);
            let (za, zb) = (out[0] - out[1], out[2] - out[1]);
            prop_assert!((da * zb - db * za).abs() < 1e-4 * (1.0 + da.abs() + db.abs()));
        }
    }
}
