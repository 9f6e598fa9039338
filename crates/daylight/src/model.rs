//! Relative patterns of the sky.
//!
//! CIE S 011/E:2003 (ISO 15469:2004), "Spatial distribution of daylight: CIE standard general sky", has fifteen
//! skies, made of six gradations and six indicatrices, and a sixteenth, the traditional overcast sky. Perez, Seals and
//! Michalsky 1993, "All-weather model for sky luminance distribution: preliminary configuration and validation" (Solar
//! Energy 50(3), with the erratum in 51(5)), draws both functions from how bright and how clear a sky is.

use core::f64::consts::{FRAC_PI_2, PI};

/// Solar irradiance outside the atmosphere at the mean distance, W/m2 (the value of Perez et al. 1990).
pub const SOLAR_CONSTANT: f64 = 1367.0;

/// Which sky.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// A CIE standard general sky, 1 to 15, or 16, the traditional overcast sky.
    Cie(u8),
    /// The same radiance everywhere.
    Uniform,
    /// Perez's all-weather sky.
    Perez,
}

impl Model {
    /// Reads `cie-1` to `cie-16`, `uniform` or `perez`.
    pub fn parse(text: &str) -> Option<Self> {
        match text {
            "uniform" => return Some(Self::Uniform),
            "perez" => return Some(Self::Perez),
            _ => {}
        }
        let number = text.strip_prefix("cie-")?;
        // No sign, no leading zero.
        let digits = number.bytes().all(|b| b.is_ascii_digit()) && !number.starts_with('0');
        let number: u8 = number.parse().ok().filter(|n| (1..=16).contains(n))?;
        digits.then_some(Self::Cie(number))
    }

    /// Whether its pattern depends on where the sun stands.
    pub fn needs_sun(self) -> bool {
        !matches!(self, Self::Uniform | Self::Cie(1 | 3 | 5 | 16))
    }
}

/// A relative pattern: gradation times indicatrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pattern {
    /// `a`, `b`, `g` of `1 + a exp(b / z) + g z`; see [`enf_layout::sky::SkyRecord`].
    pub gradation: [f64; 3],
    /// `k`, `c`, `d`, `e` of `k + c exp(d x) + e cos^2 x`.
    pub indicatrix: [f64; 4],
}

/// Gradations I to VI: `a`, `b`.
const GRADATIONS: [[f64; 2]; 6] =
    [[4.0, -0.70], [1.1, -0.8], [0.0, -1.0], [-1.0, -0.55], [-1.0, -0.32], [-1.0, -0.15]];
/// Indicatrices 1 to 6: `c`, `d`, `e`.
const INDICATRICES: [[f64; 3]; 6] = [
    [0.0, -1.0, 0.0],
    [2.0, -1.5, 0.15],
    [5.0, -2.5, 0.30],
    [10.0, -3.0, 0.45],
    [16.0, -3.0, 0.30],
    [24.0, -2.8, 0.15],
];
/// Gradation and indicatrix of each of the fifteen skies.
const TYPES: [[usize; 2]; 15] = [
    [1, 1],
    [1, 2],
    [2, 1],
    [2, 2],
    [3, 1],
    [3, 2],
    [3, 3],
    [3, 4],
    [4, 2],
    [4, 3],
    [4, 4],
    [5, 4],
    [5, 5],
    [6, 5],
    [6, 6],
];

impl Pattern {
    /// One radiance everywhere.
    pub const UNIFORM: Self =
        Self { gradation: [0.0, -1.0, 0.0], indicatrix: [1.0, 0.0, -1.0, 0.0] };

    /// A CIE sky, 1 to 16; other numbers are taken for the nearest of these.
    pub fn cie(number: u8) -> Self {
        if number >= 16 {
            // (1 + 2 cos Z) / 3, but for the factor.
            return Self { gradation: [0.0, -1.0, 2.0], ..Self::UNIFORM };
        }
        let [gradation, indicatrix] = TYPES[usize::from(number.max(1)) - 1];
        let [a, b] = GRADATIONS[gradation - 1];
        let [c, d, e] = INDICATRICES[indicatrix - 1];
        Self { gradation: [a, b, 0.0], indicatrix: [1.0 - c * libm::exp(d * FRAC_PI_2), c, d, e] }
    }

    /// Perez's sky for a sun at zenith distance `zenith` (radians) and the broadband irradiances of a weather record:
    /// diffuse on the horizontal, and direct square to the sun's rays, both W/m2. `day` is the day of the year, 1 to 366.
    ///
    /// # Errors
    /// When the sun is at or below the horizon, or there is no diffuse light.
    pub fn perez(
        zenith: f64,
        diffuse: f64,
        direct: f64,
        day: Option<u32>,
    ) -> Result<Self, PerezError> {
        if !(0.0..FRAC_PI_2).contains(&zenith) {
            return Err(PerezError::Night);
        }
        if !(diffuse > 0.0 && diffuse.is_finite() && direct >= 0.0 && direct.is_finite()) {
            return Err(PerezError::NoDiffuse);
        }
        let clearness = clearness(zenith, diffuse, direct);
        let brightness = brightness(zenith, diffuse, day);
        Ok(Self::perez_of(zenith, clearness, brightness))
    }

    /// Perez's sky by its own parameters: clearness (1 is overcast, above 6.2 is clear) and brightness.
    pub fn perez_of(zenith: f64, clearness: f64, brightness: f64) -> Self {
        let bin = PEREZ_BINS.iter().position(|&upper| clearness < upper).unwrap_or(7);
        // The model was fitted up to 0.6; below 0.2 bins 2 to 5 leave what was measured and turn negative.
        let least = if (1..=4).contains(&bin) { 0.2 } else { 0.01 };
        let delta = brightness.clamp(least, 0.6);
        let x = &PEREZ[bin];
        let linear = |i: usize| x[i][0] + x[i][1] * zenith + delta * (x[i][2] + x[i][3] * zenith);
        let (mut c, mut d) = (linear(2), linear(3));
        if bin == 0 {
            let base = (delta * (x[2][0] + x[2][1] * zenith)).max(0.0);
            c = libm::exp(libm::pow(base, x[2][2])) - x[2][3];
            d = -libm::exp(delta * (x[3][0] + x[3][1] * zenith)) + x[3][2] + delta * x[3][3];
        }
        Self { gradation: [linear(0), linear(1), 0.0], indicatrix: [1.0, c, d, linear(4)] }
    }

    /// Relative radiance at height sine `z` (0 to 1) and cosine `cos` of the angle to the sun; never negative.
    pub fn at(&self, z: f64, cos: f64) -> f64 {
        let [a, b, g] = self.gradation;
        let [k, c, d, e] = self.indicatrix;
        let z = z.max(0.01);
        let mut gradation = 1.0 + g * z;
        if a != 0.0 {
            gradation += a * libm::exp(b / z);
        }
        let mut indicatrix = k;
        if c != 0.0 || e != 0.0 {
            let cos = cos.clamp(-1.0, 1.0);
            indicatrix += c * libm::exp(d * libm::acos(cos)) + e * cos * cos;
        }
        (gradation * indicatrix).max(0.0)
    }
}

/// Why there is no Perez sky.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PerezError {
    /// The sun is not above the horizon.
    #[error("Perez's sky needs a sun above the horizon")]
    Night,
    /// No diffuse irradiance.
    #[error("Perez's sky needs a diffuse irradiance above 0")]
    NoDiffuse,
}

/// Sky clearness (Perez et al. 1990, equation 1).
pub fn clearness(zenith: f64, diffuse: f64, direct: f64) -> f64 {
    let cube = 1.041 * zenith * zenith * zenith;
    ((diffuse + direct) / diffuse + cube) / (1.0 + cube)
}

/// Sky brightness (Perez et al. 1990, equation 2), with the air mass of Kasten and Young 1989 and, if the day is
/// given, the eccentricity of the earth's orbit (Spencer 1971).
pub fn brightness(zenith: f64, diffuse: f64, day: Option<u32>) -> f64 {
    let height = 90.0 - zenith.to_degrees();
    let mass = 1.0 / (libm::cos(zenith) + 0.50572 * libm::pow(height + 6.07995, -1.6364));
    let eccentricity = day.map_or(1.0, |day| {
        let angle = 2.0 * PI * (f64::from(day) - 1.0) / 365.0;
        1.00011
            + 0.034221 * libm::cos(angle)
            + 0.00128 * libm::sin(angle)
            + 0.000719 * libm::cos(2.0 * angle)
            + 0.000077 * libm::sin(2.0 * angle)
    });
    diffuse * mass / (SOLAR_CONSTANT * eccentricity)
}

/// Upper ends of the bins of clearness.
const PEREZ_BINS: [f64; 8] = [1.065, 1.230, 1.500, 1.950, 2.800, 4.500, 6.200, f64::INFINITY];
/// Table 1 of Perez et al. 1993: `a` to `e` of each bin, four coefficients each.
#[rustfmt::skip]
const PEREZ: [[[f64; 4]; 5]; 8] = [
    [[1.3525, -0.2576, -0.2690, -1.4366], [-0.7670, 0.0007, 1.2734, -0.1233], [2.8000, 0.6004, 1.2375, 1.0000],
     [1.8734, 0.6297, 0.9738, 0.2809], [0.0356, -0.1246, -0.5718, 0.9938]],
    [[-1.2219, -0.7730, 1.4148, 1.1016], [-0.2054, 0.0367, -3.9128, 0.9156], [6.9750, 0.1774, 6.4477, -0.1239],
     [-1.5798, -0.5081, -1.7812, 0.1080], [0.2624, 0.0672, -0.2190, -0.4285]],
    [[-1.1000, -0.2515, 0.8952, 0.0156], [0.2782, -0.1812, -4.5000, 1.1766], [24.7219, -13.0812, -37.7000, 34.8438],
     [-5.0000, 1.5218, 3.9229, -2.6204], [-0.0156, 0.1597, 0.4199, -0.5562]],
    [[-0.5484, -0.6654, -0.2672, 0.7117], [0.7234, -0.6219, -5.6812, 2.6297], [33.3389, -18.3000, -62.2500, 52.0781],
     [-3.5000, 0.0016, 1.1477, 0.1062], [0.4659, -0.3296, -0.0876, -0.0329]],
    [[-0.6000, -0.3566, -2.5000, 2.3250], [0.2937, 0.0496, -5.6812, 1.8415], [21.0000, -4.7656, -21.5906, 7.2492],
     [-3.5000, -0.1554, 1.4062, 0.3988], [0.0032, 0.0766, -0.0656, -0.1294]],
    [[-1.0156, -0.3670, 1.0078, 1.4051], [0.2875, -0.5328, -3.8500, 3.3750], [14.0000, -0.9999, -7.1406, 7.5469],
     [-3.4000, -0.1078, -1.0750, 1.5702], [-0.0672, 0.4016, 0.3017, -0.4844]],
    [[-1.0000, 0.0211, 0.5025, -0.5119], [-0.3000, 0.1922, 0.7023, -1.6317], [19.0000, -5.0000, 1.2438, -1.9094],
     [-4.0000, 0.0250, 0.3844, 0.2656], [1.0468, -0.3788, -2.4517, 1.4656]],
    [[-1.0500, 0.0289, 0.4260, 0.3590], [-0.3250, 0.1156, 0.7781, 0.0025], [31.0625, -14.5000, -46.1148, 55.3750],
     [-7.2312, 0.4050, 13.3500, 0.6234], [1.5000, -0.6426, 1.8564, 0.5636]],
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names() {
        assert_eq!(Model::parse("cie-1"), Some(Model::Cie(1)));
        assert_eq!(Model::parse("cie-16"), Some(Model::Cie(16)));
        assert_eq!(Model::parse("perez"), Some(Model::Perez));
        for bad in ["cie-0", "cie-17", "cie-", "cie-+1", "cie-01", "clear", "CIE-1"] {
            assert_eq!(Model::parse(bad), None, "{bad}");
        }
    }

    /// The standard's own limiting cases: type 5 is uniform; type 1 falls from the zenith to the horizon about as 3 to 1,
    /// as the traditional overcast sky does exactly.
    #[test]
    fn cie_skies_at_zenith_and_horizon() {
        let ratio = |n: u8| {
            let p = Pattern::cie(n);
            p.at(0.0, 0.0) / p.at(1.0, 0.0)
        };
        assert_eq!(ratio(5), 1.0);
        // z is 0.01 at the horizon.
        assert!((ratio(16) - 1.02 / 3.0).abs() < 1e-12);
        assert!((ratio(1) - 1.0 / (1.0 + 4.0 * (-0.7f64).exp())).abs() < 1e-12);
        // Clear skies are darker at the zenith.
        for n in 9..=15 {
            assert!(ratio(n) > 1.0, "{n}");
        }
        // At 90 degrees from the sun every indicatrix is 1, its second term being 0.
        for n in 1..=15 {
            let p = Pattern { gradation: [0.0, -1.0, 0.0], ..Pattern::cie(n) };
            assert!((p.at(0.5, 0.0) - 1.0).abs() < 1e-12, "{n}");
            assert!(p.at(0.5, 1.0) >= 1.0);
        }
    }

    /// Computed by hand from the paper's formulas: an overcast and a clear hour.
    #[test]
    fn perez_of_two_hours() {
        let zenith = 45f64.to_radians();
        // No direct light: clearness 1, the first bin.
        let p = Pattern::perez(zenith, 150.0, 0.0, None).unwrap();
        let delta = brightness(zenith, 150.0, None);
        assert!((delta - 150.0 * 1.413 / 1367.0).abs() < 1e-3, "{delta}");
        let a = 1.3525 - 0.2576 * zenith + delta * (-0.2690 - 1.4366 * zenith);
        assert!((p.gradation[0] - a).abs() < 1e-12);
        let c = ((delta * (2.8 + 0.6004 * zenith)).powf(1.2375)).exp() - 1.0;
        assert!((p.indicatrix[1] - c).abs() < 1e-12);
        // 800 W/m2 direct, 80 diffuse: (11 + k) / (1 + k), k = 1.041 z^3 = 0.504: clearness 7.65, the last bin.
        assert!((clearness(zenith, 80.0, 800.0) - 11.5043 / 1.5043).abs() < 2e-3);
        let p = Pattern::perez(zenith, 80.0, 800.0, None).unwrap();
        let delta = brightness(zenith, 80.0, None);
        let e = 1.5 - 0.6426 * zenith + delta * (1.8564 + 0.5636 * zenith);
        assert!((p.indicatrix[3] - e).abs() < 1e-12);
        // Bright about the sun.
        assert!(p.at(0.7, 1.0) > 5.0 * p.at(0.7, 0.0));
    }

    #[test]
    fn perez_is_finite_wherever_it_is_defined() {
        for zenith in [0.0, 30.0, 60.0, 80.0, 89.9f64] {
            for clearness in [1.0, 1.1, 1.3, 1.7, 2.0, 3.0, 5.0, 7.0, 40.0] {
                for brightness in [0.0, 0.05, 0.2, 0.5, 3.0] {
                    let p = Pattern::perez_of(zenith.to_radians(), clearness, brightness);
                    for z in [0.0, 0.02, 0.3, 1.0] {
                        for cos in [-1.0, 0.0, 0.9, 1.0] {
                            let v = p.at(z, cos);
                            assert!(
                                v.is_finite() && v >= 0.0,
                                "{zenith} {clearness} {brightness} {z}"
                            );
                        }
                    }
                }
            }
        }
        assert_eq!(Pattern::perez(1.6, 10.0, 0.0, None), Err(PerezError::Night));
        assert_eq!(Pattern::perez(1.0, 0.0, 0.0, None), Err(PerezError::NoDiffuse));
    }
}
