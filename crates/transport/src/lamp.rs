//! Lamps that are points: spot lights, and luminaires by their measured intensities.
//!
//! A photon's direction is drawn from the very function that [`spot`] and [`measured`] give to shadow rays, by
//! inverting its integrals: no table is resampled, and nothing is rejected. Inside everything is `f64`, since
//! the cosine of a narrow cone leaves an `f32` few digits.

use core::f64::consts::{FRAC_1_PI, PI, TAU};

use enf_layout::light::{LightRecord, cone_steradians};
use enf_layout::profile::Profile;
use glam::{DVec3, Vec3};

/// Radiant intensity of a spot light of 1 W towards `to`, W/sr.
pub fn spot(light: &LightRecord, to: Vec3) -> f64 {
    let (axis, to) = (unit(light.axis), to.as_dvec3().normalize_or_zero());
    let whole = cone_steradians(light.cone);
    if whole > 0.0 && to != DVec3::ZERO {
        falloff(light.cone, from_cosine(axis, to)) / whole
    } else {
        0.0
    }
}

/// A direction from a spot light: two uniform numbers in `[0, 1)`.
pub fn from_spot(light: &LightRecord, u: [f64; 2]) -> Vec3 {
    let [inner, outer] = light.cone.map(|c| 1.0 - f64::from(c));
    // Of 1 - cos: `inner` at full intensity, and a third of the way on, for its square is integrated.
    let at = u[0] * (inner + (outer - inner) / 3.0);
    let x = if at < inner {
        at
    } else {
        let left = 3.0 * (inner - at) / (outer - inner).max(f64::MIN_POSITIVE) + 1.0;
        outer - (outer - inner) * libm::cbrt(left.clamp(0.0, 1.0))
    };
    let axis = unit(light.axis);
    let (t, b) = crate::vector::frame(axis.as_vec3());
    let (t, b) = upright(axis, t.as_dvec3(), b.as_dvec3());
    let (sin, cos) = libm::sincos(TAU * u[1]);
    let radius = (x * (2.0 - x)).max(0.0).sqrt();
    (t * (radius * cos) + b * (radius * sin) + axis * (1.0 - x)).normalize().as_vec3()
}

/// Radiant intensity of a luminaire of 1 W towards `to`, W/sr.
pub fn measured(light: &LightRecord, profile: &Profile<'_>, to: Vec3) -> f64 {
    let (axis, t, b) = frame(light);
    let to = to.as_dvec3();
    let (x, y, z) = (to.dot(t), to.dot(b), to.dot(axis));
    let polar = libm::atan2((x * x + y * y).sqrt(), z);
    let azimuth = if profile.azimuth.len() > 1 { libm::atan2(y, x) } else { 0.0 };
    profile.at(polar, azimuth)
}

/// A direction from a luminaire: four uniform numbers in `[0, 1)`.
pub fn from_measured(light: &LightRecord, profile: &Profile<'_>, u: [f64; 4]) -> Vec3 {
    let (axis, t, b) = frame(light);
    let (polar, azimuth) = draw(profile, u);
    let (s, c) = libm::sincos(polar);
    let (sin, cos) = libm::sincos(azimuth);
    (t * (s * cos) + b * (s * sin) + axis * c).normalize_or(axis).as_vec3()
}

/// Polar angle and azimuth, radians.
fn draw(profile: &Profile<'_>, u: [f64; 4]) -> (f64, f64) {
    // A band between two polar angles by its flux.
    let row = profile.bands.partition_point(|&b| f64::from(b) <= u[0]).min(profile.polar.len() - 2);
    let (t0, t1) = (f64::from(profile.polar[row]), f64::from(profile.polar[row + 1]));
    let polar = in_band(profile.around(row), profile.around(row + 1), t0, t1, u[1]);
    let n = profile.azimuth.len();
    if n == 1 {
        return (polar, TAU * u[2]);
    }
    // The azimuth at that polar angle: its sums are as bilinear as the intensities.
    let s = (polar - t0) / (t1 - t0);
    let between = |values: &[f32], j: usize| {
        f64::from(values[row * n + j]) * (1.0 - s) + f64::from(values[(row + 1) * n + j]) * s
    };
    let target = u[2] * between(profile.along, n - 1);
    let (mut low, mut high) = (0, n - 1);
    while high - low > 1 {
        let middle = (low + high) / 2;
        if between(profile.along, middle) <= target { low = middle } else { high = middle }
    }
    let (a0, a1) = (f64::from(profile.azimuth[low]), f64::from(profile.azimuth[low + 1]));
    let (f0, f1) = (between(profile.intensity, low), between(profile.intensity, low + 1));
    let x = a0 + on_line(f0, f1, a1 - a0, target - between(profile.along, low));
    let fold = (u[3] * f64::from(profile.folds)) as u32;
    let azimuth = match (profile.folds, fold) {
        (1, _) | (_, 0) => x,
        (2, _) | (_, 3) => TAU - x,
        (_, 1) => PI - x,
        _ => PI + x,
    };
    (polar, profile.origin + azimuth)
}

/// The polar angle between `t0` and `t1` below which the share `u` of the band lies, where the integral over the
/// azimuth goes straight from `f0` to `f1`.
fn in_band(f0: f64, f1: f64, t0: f64, t1: f64, u: f64) -> f64 {
    let (width, rise) = (t1 - t0, (f1 - f0) / (t1 - t0));
    let (s0, c0) = libm::sincos(t0);
    let (s1, c1) = libm::sincos(t1);
    // As profile::band, with what is the same on every step looked up once.
    let within = |f: f64, s: f64, c: f64| f0 * c0 - f * c + rise * (s - s0);
    let target = u * within(f1, s1, c1).max(0.0);
    // As if the sine were straight as well: a good first guess for Newton's method, which a bracket guards.
    let (d0, d1) = (f0 * s0, f1 * s1);
    let mut t = t0 + on_line(d0, d1, width, u * 0.5 * (d0 + d1) * width);
    let (mut low, mut high) = (t0, t1);
    for _ in 0..60 {
        let (s, c) = libm::sincos(t);
        let f = f0 + rise * (t - t0);
        let excess = within(f, s, c) - target;
        if excess > 0.0 {
            high = t
        } else {
            low = t
        }
        let newton = t - excess / (f * s);
        let next = if newton >= low && newton <= high { newton } else { 0.5 * (low + high) };
        let step = (next - t).abs();
        t = next;
        // The next step would be the square of this one.
        if step <= 1e-10 * width {
            break;
        }
    }
    t.clamp(t0, t1)
}

/// Where the integral of what goes straight from `f0` to `f1` over `width` reaches `target`.
fn on_line(f0: f64, f1: f64, width: f64, target: f64) -> f64 {
    let root = (f0 * f0 + 2.0 * (f1 - f0) / width * target).max(0.0).sqrt();
    let x = 2.0 * target / (f0 + root);
    if x.is_finite() { x.clamp(0.0, width) } else { 0.0 }
}

/// Intensity relative to the axis, `x` being 1 - cosine.
fn falloff(cone: [f32; 2], x: f64) -> f64 {
    let [inner, outer] = cone.map(|c| 1.0 - f64::from(c));
    if x <= inner {
        1.0
    } else if x >= outer {
        0.0
    } else {
        let t = (outer - x) / (outer - inner);
        t * t
    }
}

/// 1 - cosine of the angle between unit vectors, exact for small ones too.
fn from_cosine(a: DVec3, b: DVec3) -> f64 {
    let cos = a.dot(b);
    if cos > 0.5 { a.cross(b).length_squared() / (1.0 + cos) } else { 1.0 - cos }
}

fn unit(v: [f32; 3]) -> DVec3 {
    Vec3::from(v).as_dvec3().normalize_or(DVec3::NEG_Z)
}

/// `t` and `b` made square to `axis` and to each other.
fn upright(axis: DVec3, t: DVec3, b: DVec3) -> (DVec3, DVec3) {
    let t = (t - axis * axis.dot(t)).normalize_or(axis.any_orthonormal_vector());
    let square = axis.cross(t);
    (t, if square.dot(b) < 0.0 { -square } else { square })
}

/// Axis, direction of azimuth 0, direction of azimuth 90 degrees.
fn frame(light: &LightRecord) -> (DVec3, DVec3, DVec3) {
    let axis = unit(light.axis);
    let t = Vec3::from(light.tangent).as_dvec3();
    let (t, b) = upright(axis, t, t.cross(axis));
    (axis, t, b)
}

/// An upper guess of a lamp's intensity for 1 W, 1/pi being 1: what [`spot`] and [`measured`] say, and a little for
/// the rounding of the direction, so that no point that is lit counts as dark.
pub fn guess(intensity: f64) -> f32 {
    (intensity / FRAC_1_PI + 0.01) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{self, Purpose};
    use enf_layout::light::{LIGHT_PROFILE, LIGHT_SPOT};
    use enf_layout::profile::{self, ProfileRecord, Samples};

    const DRAWS: u32 = 400_000;

    /// Uniform numbers as photons get them.
    fn numbers(index: u32) -> [f64; 4] {
        let word = |block| rng::block(7, Purpose::Emission, 3, index, 0, block);
        let (a, b) = (word(0), word(1));
        std::array::from_fn(|i| rng::fine(a[i], b[i]))
    }

    fn lamp(axis: Vec3, tangent: Vec3) -> LightRecord {
        LightRecord {
            kind: LIGHT_PROFILE,
            profile: 0,
            axis: axis.to_array(),
            tangent: tangent.to_array(),
            ..LightRecord::DARK
        }
    }

    fn cone(inner: f64, outer: f64) -> LightRecord {
        let cos = |d: f64| d.to_radians().cos() as f32;
        LightRecord {
            kind: LIGHT_SPOT,
            axis: [0.36, -0.48, -0.8],
            cone: [cos(inner), cos(outer)],
            ..LightRecord::DARK
        }
    }

    /// The integral of a spot light's intensity over the sphere is 1, by the midpoint rule in 1 - cos.
    #[test]
    fn a_spot_of_one_watt_emits_one_watt() {
        for (inner, outer) in
            [(0.0, 45.0), (20.0, 30.0), (0.0, 90.0), (1.0, 1.5), (30.0, 30.0), (0.0, 180.0)]
        {
            let light = cone(inner, outer);
            let x1 = 1.0 - f64::from(light.cone[1]);
            let steps = 100_000;
            let mut sum = 0.0;
            for i in 0..steps {
                let x = x1 * (f64::from(i) + 0.5) / f64::from(steps);
                sum += falloff(light.cone, x) * TAU * x1 / f64::from(steps);
            }
            let whole = cone_steradians(light.cone);
            assert!((sum / whole - 1.0).abs() < 1e-4, "{inner} {outer}: {sum} {whole}");
        }
    }

    /// glTF's KHR_lights_punctual: angularAttenuation squared, by its own formula.
    #[test]
    fn a_spot_falls_off_as_in_gltf() {
        let light = cone(20.0, 40.0);
        let axis = unit(light.axis);
        let (t, _) = crate::vector::frame(axis.as_vec3());
        let i0 = spot(&light, axis.as_vec3());
        for degrees in [0.0f64, 10.0, 19.9, 25.0, 30.0, 38.0, 39.9, 40.1, 90.0, 170.0] {
            let angle = degrees.to_radians();
            let to = axis * angle.cos() + t.as_dvec3() * angle.sin();
            let (ci, co) = (20f64.to_radians().cos(), 40f64.to_radians().cos());
            let scale = 1.0 / (ci - co).max(0.001);
            let attenuation = (angle.cos() * scale - co * scale).clamp(0.0, 1.0);
            let found = spot(&light, to.as_vec3()) / i0;
            assert!((found - attenuation * attenuation).abs() < 1e-5, "{degrees}: {found}");
        }
    }

    /// Chi-square of the angle in 64 rings of equal flux (63 degrees of freedom: mean 63, deviation 11.2). The bound
    /// lies 5.3 deviations up, which chance reaches with a probability below 1e-5. Azimuths by their first moments.
    #[test]
    fn spots_emit_what_they_say() {
        for (inner, outer) in [(0.0, 45.0), (20.0, 30.0), (2.0, 3.0), (25.0, 25.0)] {
            let light = cone(inner, outer);
            let axis = unit(light.axis);
            let [xi, xo] = light.cone.map(|c| 1.0 - f64::from(c));
            // The share of flux within 1 - cos = x.
            let within = |x: f64| {
                let full = xi + (xo - xi) / 3.0;
                let rest = if x > xi {
                    (xo - xi) * (1.0 - ((xo - x) / (xo - xi)).powi(3)) / 3.0
                } else {
                    0.0
                };
                (x.min(xi) + rest) / full
            };
            let mut rings = [0u32; 64];
            let mut mean = DVec3::ZERO;
            for i in 0..DRAWS {
                let u = numbers(i);
                let d = from_spot(&light, [u[0], u[1]]).as_dvec3();
                assert!((d.length() - 1.0).abs() < 1e-6);
                let x = from_cosine(axis, d.normalize());
                assert!(x <= xo * (1.0 + 1e-3), "{x} beyond {xo}");
                rings[((within(x.min(xo)) * 64.0) as usize).min(63)] += 1;
                mean += (d - axis * d.dot(axis)) / f64::from(DRAWS);
            }
            let expected = f64::from(DRAWS) / 64.0;
            let chi: f64 =
                rings.iter().map(|&n| (f64::from(n) - expected).powi(2) / expected).sum();
            assert!(chi < 122.0, "{inner} {outer}: chi-square {chi}");
            assert!(mean.length() < 5.0 * (2.0 * xo / f64::from(DRAWS)).sqrt(), "{mean}");
        }
    }

    fn degrees(list: impl IntoIterator<Item = f64>) -> Vec<f64> {
        list.into_iter().map(f64::to_radians).collect()
    }

    /// A hash of two numbers in 0 to 1.
    fn any(i: usize, j: usize) -> f64 {
        f64::from(rng::unit(rng::block(1, Purpose::Probe, i as u32, j as u32, 0, 0)[0]))
    }

    /// Profiles of every symmetry, uneven angles, dark rows and columns among them.
    fn profiles() -> Vec<(&'static str, ProfileRecord, Vec<f32>)> {
        let mut out = Vec::new();
        let mut add = |name, polar: &[f64], azimuth: &[f64], folds, origin: f64| {
            let candela = (0..polar.len())
                .flat_map(|i| (0..azimuth.len()).map(move |j| (i, j)))
                .map(|(i, j)| {
                    let seam = if folds == 1 && j + 1 == azimuth.len() { 0 } else { j };
                    if (i + 2 * j) % 7 == 3 { 0.0 } else { 1000.0 * any(i, seam).powi(3) }
                })
                .collect();
            let samples = Samples {
                polar: degrees(polar.iter().copied()),
                azimuth: degrees(azimuth.iter().copied()),
                folds,
                origin: origin.to_radians(),
                candela,
            };
            let mut values = vec![1.0; 5];
            let record = samples.store(&mut values).unwrap();
            out.push((name, record, values));
        };
        let whole: Vec<f64> = (0..=36).map(|i| 5.0 * f64::from(i)).collect();
        add("round", &whole, &[0.0], 1, 0.0);
        add("coarse round", &[0.0, 90.0, 180.0], &[0.0], 1, 0.0);
        add("quadrant", &[0.0, 3.0, 10.0, 40.0, 85.0, 90.0], &[0.0, 22.5, 45.0, 90.0], 4, 0.0);
        add("bilateral", &whole[..19], &[0.0, 10.0, 90.0, 100.0, 180.0], 2, 0.0);
        add("lateral", &whole[18..], &[0.0, 45.0, 90.0, 135.0, 180.0], 2, 90.0);
        add("full", &whole, &[0.0, 45.0, 60.0, 180.0, 200.0, 300.0, 360.0], 1, 0.0);
        add("half", &whole[2..30], &[0.0, 20.0, 70.0, 160.0, 180.0], 1, -90.0);
        out
    }

    /// Photons against the table: chi-square over cells of polar angle and azimuth whose expected numbers are integrals
    /// of the intensity by the midpoint rule, in 60 bands of equal cosine by 16 sectors. Cells that expect fewer than 10 are put together. The bound, 6 deviations above the
    /// mean, is reached by chance with a probability below 1e-6.
    #[test]
    fn photons_follow_the_profile() {
        let axis = Vec3::new(0.36, -0.48, -0.8);
        let light = lamp(axis, axis.any_orthonormal_vector());
        let (a, t, b) = frame(&light);
        const BANDS: usize = 60;
        const SECTORS: usize = 16;
        const FINE: usize = 24;
        for (name, record, values) in profiles() {
            let profile = Profile::new(&record, &values).unwrap();
            profile.check().unwrap();
            let mut expected = vec![0.0; BANDS * SECTORS];
            let mut sum = 0.0;
            for i in 0..BANDS * FINE {
                for j in 0..SECTORS * FINE {
                    let z = 1.0 - 2.0 * (i as f64 + 0.5) / (BANDS * FINE) as f64;
                    let azimuth = TAU * (j as f64 + 0.5) / (SECTORS * FINE) as f64;
                    let flux = profile.at(z.acos(), azimuth) * 2.0 * TAU
                        / (BANDS * FINE * SECTORS * FINE) as f64;
                    expected[i / FINE * SECTORS + j / FINE] += flux;
                    sum += flux;
                }
            }
            assert!((sum - 1.0).abs() < 2e-3, "{name}: the profile integrates to {sum}");
            let mut found = vec![0u32; BANDS * SECTORS];
            for i in 0..DRAWS {
                let d = from_measured(&light, &profile, numbers(i)).as_dvec3();
                let (x, y, z) = (d.dot(t), d.dot(b), d.dot(a));
                let band = ((0.5 * (1.0 - z) * BANDS as f64) as usize).min(BANDS - 1);
                let sector = (y.atan2(x).rem_euclid(TAU) / TAU * SECTORS as f64) as usize;
                found[band * SECTORS + sector.min(SECTORS - 1)] += 1;
            }
            let (mut chi, mut cells) = (0.0, 0);
            let (mut few, mut few_found) = (0.0, 0.0);
            for (e, n) in expected.iter().zip(&found) {
                let (e, n) = (e / sum * f64::from(DRAWS), f64::from(*n));
                few += e;
                few_found += n;
                if few >= 10.0 {
                    chi += (few_found - few) * (few_found - few) / few;
                    cells += 1;
                    (few, few_found) = (0.0, 0.0);
                }
            }
            let freedom = f64::from(cells - 1);
            assert!(
                chi < freedom + 6.0 * (2.0 * freedom).sqrt(),
                "{name}: chi-square {chi:.1} of {cells} cells"
            );
            assert!(few_found < 40.0, "{name}: {few_found} photons where {few:.2} are expected");
        }
    }

    /// The shares within polar angles, to the last photon drawn: the inverse is exact, not only likely.
    #[test]
    fn the_inverse_inverts() {
        for (name, record, values) in profiles() {
            let profile = Profile::new(&record, &values).unwrap();
            for row in 0..profile.polar.len() - 1 {
                let (f0, f1) = (profile.around(row), profile.around(row + 1));
                let (t0, t1) = (f64::from(profile.polar[row]), f64::from(profile.polar[row + 1]));
                let whole = profile::band(f0, f1, t0, t1);
                if whole < 1e-9 {
                    continue;
                }
                for u in [0.0, 1e-9, 0.01, 0.3, 0.5, 0.9, 0.999, 1.0 - 1e-9] {
                    let t = in_band(f0, f1, t0, t1, u);
                    let f = f0 + (f1 - f0) * (t - t0) / (t1 - t0);
                    let back = if t > t0 { profile::band(f0, f, t0, t) / whole } else { 0.0 };
                    assert!((back - u).abs() < 1e-9, "{name} row {row}: {u} came back as {back}");
                }
            }
        }
    }

    /// A profile I0 cos(theta), sampled every degree, is the Lambertian point light.
    #[test]
    fn a_lambertian_profile() {
        let samples = Samples {
            polar: degrees((0..=90).map(f64::from)),
            azimuth: vec![0.0],
            folds: 1,
            origin: 0.0,
            candela: (0..=90).map(|d| f64::from(d).to_radians().cos().max(0.0) * 1000.0).collect(),
        };
        let mut values = Vec::new();
        let record = samples.store(&mut values).unwrap();
        // Chords of the cosine lie below it by 1/8 of a degree squared at most.
        assert!((samples.lumens() / (1000.0 * PI) - 1.0).abs() < 4e-5);
        let profile = Profile::new(&record, &values).unwrap();
        let light = lamp(Vec3::NEG_Z, Vec3::X);
        // CIE 171:2006, 5.2: the illuminance of a floor 3 m below.
        for (away, lux) in [(0.0f64, 111.11), (0.5, 105.19), (1.0, 90.00), (1.5, 71.11)] {
            let d2 = 9.0 + away * away;
            let to = Vec3::new(away as f32, 0.0, -3.0);
            let e = samples.lumens() * measured(&light, &profile, to) * 3.0 / d2.sqrt() / d2;
            assert!((e - 1000.0 * 9.0 / (d2 * d2)).abs() < 5e-5 * e, "{away} m: {e} lx");
            assert!((e - lux).abs() < 0.01, "{away} m: {e} lx for {lux}");
        }
        assert_eq!(measured(&light, &profile, Vec3::Z), 0.0);
        // Moments of the cosine: 2/3 and 1/2, each with a deviation below 0.29.
        let (mut m1, mut m2) = (0.0, 0.0);
        for i in 0..DRAWS {
            let c = -f64::from(from_measured(&light, &profile, numbers(i)).z);
            m1 += c / f64::from(DRAWS);
            m2 += c * c / f64::from(DRAWS);
        }
        let bound = 5.0 * 0.29 / f64::from(DRAWS).sqrt();
        assert!((m1 - 2.0 / 3.0).abs() < bound && (m2 - 0.5).abs() < bound, "{m1} {m2}");
    }

    /// Azimuths go from the tangent counter-clockwise as seen from above.
    #[test]
    fn azimuths_turn_the_right_way() {
        let samples = Samples {
            polar: degrees([0.0, 90.0]),
            azimuth: degrees([0.0, 90.0, 180.0, 270.0, 360.0]),
            folds: 1,
            origin: 0.0,
            candela: vec![1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 2.0, 3.0, 4.0, 1.0],
        };
        let mut values = Vec::new();
        let record = samples.store(&mut values).unwrap();
        let profile = Profile::new(&record, &values).unwrap();
        let light = lamp(Vec3::NEG_Z, Vec3::X);
        let towards = |to: Vec3| measured(&light, &profile, to) * samples.lumens();
        for (to, candela) in
            [(Vec3::X, 1.0), (Vec3::Y, 2.0), (Vec3::NEG_X, 3.0), (Vec3::NEG_Y, 4.0)]
        {
            assert!((towards(to) - candela).abs() < 1e-5, "{to}: {}", towards(to));
        }
    }

    #[test]
    fn damaged_lights_are_dark_or_finite() {
        let light =
            LightRecord { kind: LIGHT_SPOT, cone: [1.0; 2], axis: [0.0; 3], ..LightRecord::DARK };
        assert_eq!(spot(&light, Vec3::X), 0.0);
        assert!(from_spot(&light, [0.5, 0.5]).is_finite());
        let (_, record, values) = profiles().remove(0);
        let profile = Profile::new(&record, &values).unwrap();
        let light = lamp(Vec3::ZERO, Vec3::ZERO);
        assert!(measured(&light, &profile, Vec3::ZERO).is_finite());
        assert!(from_measured(&light, &profile, [0.5; 4]).is_finite());
        assert!(from_measured(&light, &profile, [0.0; 4]).is_finite());
        assert!(from_measured(&light, &profile, [1.0 - 1e-16; 4]).is_finite());
    }
}
