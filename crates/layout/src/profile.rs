//! Luminaires as they were measured: luminous intensity over two angles, and the sums that let a photon's
//! direction be drawn from it.
//!
//! Between its samples a profile is *bilinear in the two angles*, as the standards for photometric files say.
//! So everything that is asked of it has a closed form: the integral over a band between two polar angles,
//! the share of an azimuth, and the intensity itself. Shadow rays and photons see one and the same function.

use core::f64::consts::{PI, TAU};

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::sections::Malformed;

/// One profile: where its values are, and how its azimuths go round.
///
/// Polar angles are counted from a light's `axis`, azimuths from its `tangent` towards `tangent x axis`:
/// counter-clockwise from above for a lamp that points down.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct ProfileRecord {
    /// First of its values in the `ProfileValues` extent. They are: `rows` polar angles, `columns` azimuths,
    /// `rows * columns` intensities and as many sums along the azimuth, both by polar angle, and `rows - 1` sums of bands.
    pub first_value: u32,
    /// Number of polar angles, at least 2.
    pub rows: u32,
    /// Number of azimuths; 1: the same all round.
    pub columns: u32,
    /// 1: azimuths as they are, 2: mirrored at the plane of `origin`, 4: and at the one square to it.
    pub folds: u32,
    /// From where azimuths are counted, radians.
    pub origin: f32,
    /// Largest intensity of a light of 1 W, W/sr.
    pub peak: f32,
    /// Luminous flux of the luminaire as its file has it, lm.
    pub lumens: f32,
    /// Zero.
    pub reserved: u32,
}
const _: () = assert!(size_of::<ProfileRecord>() == 32);

/// Most angles of a kind that a profile may have.
pub const MAX_ANGLES: usize = 1 << 14;

/// A profile over its stored values.
#[derive(Clone, Copy, Debug)]
pub struct Profile<'a> {
    /// Polar angles, radians, ascending; it is dark beyond them.
    pub polar: &'a [f32],
    /// Azimuths from `origin` on, radians, ascending from 0; it is dark beyond them.
    pub azimuth: &'a [f32],
    /// Intensities of a light of 1 W, W/sr, by polar angle, then azimuth.
    pub intensity: &'a [f32],
    /// Integrals of those along the azimuth, from the first one on, W/sr times radians.
    pub along: &'a [f32],
    /// Share of the flux up to the end of each band between polar angles; the last is 1.
    pub bands: &'a [f32],
    /// As [`ProfileRecord::folds`].
    pub folds: u32,
    /// As [`ProfileRecord::origin`].
    pub origin: f64,
}

impl<'a> Profile<'a> {
    /// The profile of a record.
    ///
    /// # Errors
    /// Its values are not all there.
    pub fn new(record: &ProfileRecord, values: &'a [f32]) -> Result<Self, Malformed> {
        let (rows, columns) = (record.rows as usize, record.columns as usize);
        let bad = || Malformed("a luminaire's profile is damaged".into());
        if !(2..=MAX_ANGLES).contains(&rows)
            || !(1..=MAX_ANGLES).contains(&columns)
            || !matches!(record.folds, 1 | 2 | 4)
        {
            return Err(bad());
        }
        let rest = values.get(record.first_value as usize..).ok_or_else(bad)?;
        let (polar, rest) = rest.split_at_checked(rows).ok_or_else(bad)?;
        let (azimuth, rest) = rest.split_at_checked(columns).ok_or_else(bad)?;
        let (intensity, rest) = rest.split_at_checked(rows * columns).ok_or_else(bad)?;
        let (along, rest) = rest.split_at_checked(rows * columns).ok_or_else(bad)?;
        let bands = rest.get(..rows - 1).ok_or_else(bad)?;
        let (folds, origin) = (record.folds, f64::from(record.origin));
        Ok(Self { polar, azimuth, intensity, along, bands, folds, origin })
    }

    /// That the values are a profile: angles ascend, nothing is below zero, sums grow.
    ///
    /// # Errors
    /// They are not.
    pub fn check(&self) -> Result<(), Malformed> {
        let ascends = |v: &[f32]| v.windows(2).all(|w| w[0] < w[1]);
        let grows = |v: &[f32]| v.windows(2).all(|w| w[0] <= w[1]);
        let sane = ascends(self.polar)
            && ascends(self.azimuth)
            && self.polar[0] >= 0.0
            && self.azimuth[0] == 0.0
            && self.origin.is_finite()
            && [self.polar, self.azimuth].iter().all(|v| v.iter().all(|a| (0.0..7.0).contains(a)))
            && self.intensity.iter().all(|i| i.is_finite() && *i >= 0.0)
            && self.along.iter().all(|i| i.is_finite() && *i >= 0.0)
            && self.along.chunks(self.azimuth.len()).all(grows)
            && grows(self.bands)
            && self.bands.last() == Some(&1.0);
        if sane { Ok(()) } else { Err(Malformed("a luminaire's profile is damaged".into())) }
    }

    /// Integral of the intensity over all azimuths at the polar angle `row`, W/sr times radians.
    pub fn around(&self, row: usize) -> f64 {
        match self.azimuth.len() {
            1 => TAU * f64::from(self.intensity[row]),
            n => f64::from(self.folds) * f64::from(self.along[row * n + n - 1]),
        }
    }

    /// Flux between the polar angles `row` and `row + 1` of a light of 1 W, W.
    pub fn band(&self, row: usize) -> f64 {
        let at = |i: usize| f64::from(self.polar[i]);
        band(self.around(row), self.around(row + 1), at(row), at(row + 1))
    }

    /// Intensity of a light of 1 W, W/sr, at a polar angle and an azimuth (any, radians).
    pub fn at(&self, polar: f64, azimuth: f64) -> f64 {
        let Some((i, s)) = place(self.polar, polar) else { return 0.0 };
        let n = self.azimuth.len();
        let (here, next) = (&self.intensity[i * n..][..n], &self.intensity[(i + 1) * n..][..n]);
        if n == 1 {
            return mix(here[0], next[0], s);
        }
        let mut x = (azimuth - self.origin).rem_euclid(TAU);
        if self.folds > 1 && x > PI {
            x = TAU - x;
        }
        if self.folds > 2 && x > 0.5 * PI {
            x = PI - x;
        }
        let Some((j, r)) = place(self.azimuth, x) else { return 0.0 };
        mix(here[j], here[j + 1], r) * (1.0 - s) + mix(next[j], next[j + 1], r) * s
    }
}

/// Between `a` and `b`.
fn mix(a: f32, b: f32, s: f64) -> f64 {
    f64::from(a) * (1.0 - s) + f64::from(b) * s
}

/// Between which two of `angles` an angle lies, and where between them; none outside.
fn place(angles: &[f32], x: f64) -> Option<(usize, f64)> {
    let (first, last) = (f64::from(*angles.first()?), f64::from(*angles.last()?));
    // Not the negation of "outside": NaN is outside.
    if !(first <= x && x <= last) || angles.len() < 2 {
        return None;
    }
    let i = angles.partition_point(|&a| f64::from(a) <= x).clamp(1, angles.len() - 1) - 1;
    let (a, b) = (f64::from(angles[i]), f64::from(angles[i + 1]));
    Some((i, (x - a) / (b - a)))
}

/// Integral of `f(t) sin(t)` from `t0` to `t1`, radians, where `f` goes straight from `f0` to `f1`.
pub fn band(f0: f64, f1: f64, t0: f64, t1: f64) -> f64 {
    let ((s0, c0), (s1, c1)) = (libm::sincos(t0), libm::sincos(t1));
    (f0 * c0 - f1 * c1 + (f1 - f0) / (t1 - t0) * (s1 - s0)).max(0.0)
}

/// Measured intensities on their way into a store, in candela.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples {
    /// Polar angles, radians, ascending within 0 to pi.
    pub polar: Vec<f64>,
    /// Azimuths from `origin` on, radians, ascending from 0; one: the same all round.
    pub azimuth: Vec<f64>,
    /// As [`ProfileRecord::folds`].
    pub folds: u32,
    /// As [`ProfileRecord::origin`].
    pub origin: f64,
    /// By polar angle, then azimuth, cd; none below zero.
    pub candela: Vec<f64>,
}

impl Samples {
    /// Luminous flux, lm: the integral of the bilinear function over the sphere, exactly.
    pub fn lumens(&self) -> f64 {
        let n = self.azimuth.len();
        let around = |row: &[f64]| match n {
            1 => TAU * row[0],
            _ => f64::from(self.folds) * sums(row, &self.azimuth).last().copied().unwrap_or(0.0),
        };
        let rows: Vec<f64> = self.candela.chunks(n.max(1)).map(around).collect();
        let pairs = rows.windows(2).zip(self.polar.windows(2));
        pairs.map(|(f, t)| band(f[0], f[1], t[0], t[1])).sum()
    }

    /// Appends the profile to a table of values; none if it is dark. Its lumens are those of the samples.
    pub fn store(&self, values: &mut Vec<f32>) -> Option<ProfileRecord> {
        let lumens = self.lumens();
        if !(lumens > 0.0 && lumens.is_finite()) {
            return None;
        }
        // What is stored is rounded first; the sums are those of what is stored.
        let polar: Vec<f32> = self.polar.iter().map(|&a| a as f32).collect();
        let azimuth: Vec<f32> = self.azimuth.iter().map(|&a| a as f32).collect();
        let intensity: Vec<f32> = self.candela.iter().map(|&c| (c / lumens) as f32).collect();
        let wide = |v: &[f32]| v.iter().map(|&a| f64::from(a)).collect::<Vec<f64>>();
        let (rows, columns) = (polar.len(), azimuth.len());
        let mut along = Vec::with_capacity(intensity.len());
        for row in intensity.chunks(columns.max(1)) {
            along.extend(sums(&wide(row), &wide(&azimuth)).iter().map(|&s| s as f32));
        }
        let peak = intensity.iter().fold(0.0, |m: f32, &i| m.max(i));
        let record = ProfileRecord {
            first_value: values.len() as u32,
            rows: rows as u32,
            columns: columns as u32,
            folds: self.folds,
            origin: self.origin as f32,
            peak,
            lumens: lumens as f32,
            reserved: 0,
        };
        let mut own = polar;
        own.extend(azimuth);
        own.extend(intensity);
        own.extend(along);
        own.extend(std::iter::repeat_n(1.0f32, rows.saturating_sub(1)));
        let here = ProfileRecord { first_value: 0, ..record };
        let shares: Vec<f64> = {
            let profile = Profile::new(&here, &own).ok()?;
            (0..rows - 1).map(|row| profile.band(row)).collect()
        };
        let total: f64 = shares.iter().sum();
        let mut sum = 0.0;
        let last = shares.iter().rposition(|&s| s > 0.0)?;
        let first = own.len() - shares.len();
        for (i, share) in shares.iter().enumerate() {
            sum += share;
            own[first + i] = if i >= last { 1.0 } else { ((sum / total) as f32).min(1.0) };
        }
        if u32::try_from(values.len() + own.len()).is_err() {
            return None;
        }
        values.append(&mut own);
        Some(record)
    }
}

/// Integrals from the first angle to each, of what goes straight from value to value.
fn sums(values: &[f64], angles: &[f64]) -> Vec<f64> {
    let mut sum = 0.0;
    let mut out = Vec::with_capacity(values.len());
    out.push(0.0);
    for (v, a) in values.windows(2).zip(angles.windows(2)) {
        sum += 0.5 * (v[0] + v[1]) * (a[1] - a[0]);
        out.push(sum);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stored(samples: &Samples) -> (ProfileRecord, Vec<f32>) {
        let mut values = vec![7.0; 3];
        let record = samples.store(&mut values).unwrap();
        (record, values)
    }

    fn degrees(list: impl IntoIterator<Item = f64>) -> Vec<f64> {
        list.into_iter().map(f64::to_radians).collect()
    }

    /// The same intensity everywhere: 4 pi lumens a candela, 1 / 4 pi per watt.
    #[test]
    fn isotropic() {
        let samples = Samples {
            polar: degrees([0.0, 30.0, 90.0, 180.0]),
            azimuth: vec![0.0],
            folds: 1,
            origin: 0.0,
            candela: vec![80.0; 4],
        };
        assert!((samples.lumens() - 80.0 * 4.0 * PI).abs() < 1e-9);
        let (record, values) = stored(&samples);
        let profile = Profile::new(&record, &values).unwrap();
        profile.check().unwrap();
        assert!((profile.at(1.0, 2.0) - 0.25 / PI).abs() < 1e-8);
        // cos 30 deg, half the sphere.
        let share = 0.5 * (1.0 - 30f64.to_radians().cos());
        assert!((f64::from(profile.bands[0]) - share).abs() < 1e-7);
        assert_eq!(&profile.bands[1..], [0.5, 1.0]);
    }

    /// A straight line in the polar angle: the integral of (1 - 2t/pi) sin t is 1 - 2/pi.
    #[test]
    fn linear_in_the_polar_angle() {
        let samples = Samples {
            polar: degrees([0.0, 90.0]),
            azimuth: vec![0.0],
            folds: 1,
            origin: 0.0,
            candela: vec![1.0, 0.0],
        };
        assert!((samples.lumens() - TAU * (1.0 - 2.0 / PI)).abs() < 1e-12);
        let split = Samples {
            polar: degrees([0.0, 10.0, 45.0, 90.0]),
            candela: vec![1.0, 80.0 / 90.0, 0.5, 0.0],
            ..samples.clone()
        };
        assert!((split.lumens() - samples.lumens()).abs() < 1e-12);
    }

    /// What is folded is what is written out.
    #[test]
    fn folds_unfold() {
        let quadrant = |x: f64| 1.0 + x / 90.0;
        let folded = Samples {
            polar: degrees([0.0, 60.0, 120.0]),
            azimuth: degrees([0.0, 30.0, 90.0]),
            folds: 4,
            origin: 0.0,
            candela: [0.5, 1.0, 0.25]
                .iter()
                .flat_map(|a| [0.0, 30.0, 90.0].map(|x| a * quadrant(x)))
                .collect(),
        };
        let whole = [0.0, 30.0, 90.0, 150.0, 180.0, 210.0, 270.0, 330.0, 360.0];
        let unfold = |x: f64| {
            let x = if x > 180.0 { 360.0 - x } else { x };
            if x > 90.0 { 180.0 - x } else { x }
        };
        let written = Samples {
            azimuth: degrees(whole),
            folds: 1,
            candela: [0.5, 1.0, 0.25]
                .iter()
                .flat_map(|a| whole.map(|x| a * quadrant(unfold(x))))
                .collect(),
            ..folded.clone()
        };
        // Mirrored at the plane of 90 degrees: counted from there.
        let lateral = Samples {
            azimuth: degrees([0.0, 60.0, 90.0, 120.0, 180.0]),
            folds: 2,
            origin: 0.5 * PI,
            candela: [0.5, 1.0, 0.25]
                .iter()
                .flat_map(|a| [90.0, 30.0, 0.0, 30.0, 90.0].map(|x| a * quadrant(x)))
                .collect(),
            ..folded.clone()
        };
        assert!((folded.lumens() - written.lumens()).abs() < 1e-12);
        assert!((folded.lumens() - lateral.lumens()).abs() < 1e-12);
        let tables = [stored(&folded), stored(&written), stored(&lateral)];
        let profiles: Vec<_> = tables.iter().map(|(r, v)| Profile::new(r, v).unwrap()).collect();
        for i in 0..50 {
            for j in -40..80 {
                let (t, p) = (f64::from(i) * 0.04 + 0.003, f64::from(j) * 0.09 + 0.001);
                let values = profiles.iter().map(|x| x.at(t, p)).collect::<Vec<f64>>();
                assert!(values.iter().all(|v| (v - values[0]).abs() < 1e-6), "{t} {p}: {values:?}");
            }
        }
        assert_eq!(profiles[0].at(2.1, 0.0), 0.0);
    }

    #[test]
    fn damage_is_seen() {
        let samples = Samples {
            polar: degrees([0.0, 90.0]),
            azimuth: degrees([0.0, 90.0]),
            folds: 4,
            origin: 0.0,
            candela: vec![1.0, 1.0, 0.0, 2.0],
        };
        let (record, mut values) = stored(&samples);
        Profile::new(&record, &values).unwrap().check().unwrap();
        assert!(Profile::new(&record, &values[..values.len() - 1]).is_err());
        assert!(Profile::new(&ProfileRecord { folds: 3, ..record }, &values).is_err());
        assert!(Profile::new(&ProfileRecord { rows: 1, ..record }, &values).is_err());
        assert!(Profile::new(&ProfileRecord { rows: u32::MAX, ..record }, &values).is_err());
        assert!(Profile::new(&ProfileRecord { first_value: 9, ..record }, &values).is_err());
        values[4] = f32::NAN;
        assert!(Profile::new(&record, &values).unwrap().check().is_err());
        let dark = Samples { candela: vec![0.0; 4], ..samples };
        assert_eq!(dark.store(&mut Vec::new()), None);
    }
}
