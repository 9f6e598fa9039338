//! Where things are: units, up axis, scene origin, and the placements of instances.

use glam::DVec3;
use serde::{
    Deserialize, Deserializer,
    de::{Error as _, SeqAccess, Visitor},
};
use std::fmt;

/// Which axis of the input points up. The store's is always z.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Up {
    /// y points up, as in most modelling programs: `(x, y, z)` becomes `(x, -z, y)`.
    Y,
    /// z points up, as in CAD and BIM.
    #[default]
    Z,
}

impl Up {
    /// Turns a vector of the input so that z points up.
    pub fn turn(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Z => [x, y, z],
            Self::Y => [x, -z, y],
        }
    }
}

/// How the input's coordinates become the store's: turn up, scale to metres, subtract the origin (all
/// in `f64`), then round once to `f32`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields)]
pub struct Frame {
    /// Metres per unit of the input.
    pub units: f64,
    /// Up axis of the input.
    pub up: Up,
    /// Subtracted last, m.
    pub origin: [f64; 3],
}

impl Frame {
    /// A point of the input in store coordinates, m.
    pub fn point(&self, p: [f64; 3]) -> [f32; 3] {
        let p = self.up.turn(p);
        std::array::from_fn(|c| round(p[c] * self.units - self.origin[c]))
    }

    /// A direction of the input in store coordinates, of length 1; `None` if it has no length.
    pub fn direction(&self, d: [f64; 3]) -> Option<[f32; 3]> {
        let d = DVec3::from_array(self.up.turn(d));
        let length = (d / d.abs().max_element()).length() * d.abs().max_element();
        (length > 0.0 && length.is_finite()).then(|| (d / length).to_array().map(round))
    }

    /// The matrix of a placement in this frame, in metres, without the origin.
    pub(crate) fn matrix(&self, placement: &[f64]) -> Matrix {
        let m = local_matrix(placement, self.up);
        let row = |r: usize, sign: f64| -> [f64; 4] {
            std::array::from_fn(|c| m[4 * r + c] * (sign * self.units))
        };
        let rows = match self.up {
            Up::Z => [row(0, 1.0), row(1, 1.0), row(2, 1.0)],
            Up::Y => [row(0, 1.0), row(2, -1.0), row(1, 1.0)],
        };
        let mut out = Matrix { rows, origin: self.origin, flips: false };
        out.flips = out.determinant() < 0.0;
        out
    }
}

/// To `f32`, with one zero only.
#[allow(clippy::identity_op)]
fn round(v: f64) -> f32 {
    v as f32 + 0.0
}

/// An instance's transform into store coordinates.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Matrix {
    rows: [[f64; 4]; 3],
    origin: [f64; 3],
    /// It mirrors: triangles must be turned over to stay counter-clockwise.
    pub(crate) flips: bool,
}

impl Matrix {
    pub(crate) fn determinant(&self) -> f64 {
        let [a, b, c] = self.rows.map(|r| DVec3::new(r[0], r[1], r[2]));
        a.dot(b.cross(c))
    }

    /// The point in metres, before the origin is subtracted.
    pub(crate) fn world(&self, p: DVec3) -> DVec3 {
        let at = |r: &[f64; 4]| r[0] * p.x + r[1] * p.y + r[2] * p.z + r[3];
        DVec3::new(at(&self.rows[0]), at(&self.rows[1]), at(&self.rows[2]))
    }

    /// The point in store coordinates.
    pub(crate) fn store(&self, p: DVec3) -> [f32; 3] {
        let w = self.world(p);
        [round(w.x - self.origin[0]), round(w.y - self.origin[1]), round(w.z - self.origin[2])]
    }
}

/// Sine and cosine of an angle in degrees, exact at the quarter turns.
pub(crate) fn sin_cos_degrees(degrees: f64) -> (f64, f64) {
    let turn = degrees % 360.0;
    let turn = if turn < 0.0 { turn + 360.0 } else { turn };
    if turn == 0.0 || turn == 360.0 {
        (0.0, 1.0)
    } else if turn == 90.0 {
        (1.0, 0.0)
    } else if turn == 180.0 {
        (0.0, -1.0)
    } else if turn == 270.0 {
        (-1.0, 0.0)
    } else {
        libm::sincos(turn.to_radians())
    }
}

/// The 3 x 4 row-major matrix of a placement in the input's own coordinates.
pub(crate) fn local_matrix(placement: &[f64], up: Up) -> [f64; 12] {
    if let &[a, b, c, d, e, f, g, h, i, j, k, l] = placement {
        return [a, b, c, d, e, f, g, h, i, j, k, l];
    }
    let at = |i: usize, missing: f64| placement.get(i).copied().unwrap_or(missing);
    let (x, y, z) = (at(0, 0.0), at(1, 0.0), at(2, 0.0));
    let (s, c) = sin_cos_degrees(at(3, 0.0));
    let sx = at(4, 1.0);
    let (sy, sz) = (at(5, sx), at(6, sx));
    match up {
        Up::Z => [c * sx, -s * sy, 0.0, x, s * sx, c * sy, 0.0, y, 0.0, 0.0, sz, z],
        Up::Y => [c * sx, 0.0, s * sz, x, 0.0, sy, 0.0, y, -s * sx, 0.0, c * sz, z],
    }
}

/// Placements of one mesh, kept as the numbers that the scene file has: 3, 4, 5, 7 or 12 each.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Placements {
    numbers: Vec<f64>,
    ends: Vec<u32>,
}

impl Placements {
    pub(crate) fn identity() -> Self {
        Self { numbers: vec![0.0; 3], ends: vec![3] }
    }

    pub(crate) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Adds one, or says what is wrong with it.
    pub(crate) fn push(&mut self, numbers: &[f64]) -> Result<(), String> {
        check(numbers)?;
        let end = u32::try_from(self.numbers.len() + numbers.len())
            .map_err(|_| "one mesh has too many instances; list it twice".to_string())?;
        self.numbers.extend(numbers);
        self.ends.push(end);
        Ok(())
    }

    pub(crate) fn get(&self, i: usize) -> &[f64] {
        let start = if i == 0 { 0 } else { self.ends[i - 1] as usize };
        &self.numbers[start..self.ends[i] as usize]
    }

    pub(crate) fn shrink(&mut self) {
        self.numbers.shrink_to_fit();
        self.ends.shrink_to_fit();
    }

    pub(crate) fn bytes(&self) -> u64 {
        (self.numbers.capacity() * 8 + self.ends.capacity() * 4) as u64
    }
}

/// What is wrong with the numbers of a placement.
fn check(numbers: &[f64]) -> Result<(), String> {
    if !matches!(numbers.len(), 3 | 4 | 5 | 7 | 12) {
        return Err(format!(
            "an instance has {} numbers; give [x, y, z], [x, y, z, degrees], [x, y, z, degrees, \
             scale], [x, y, z, degrees, sx, sy, sz] or a 3 x 4 matrix row by row",
            numbers.len()
        ));
    }
    if let Some(bad) = numbers.iter().find(|v| !v.is_finite() || v.abs() > 1e30) {
        return Err(format!("an instance has the number {bad}; give finite numbers"));
    }
    let unit = Frame { units: 1.0, up: Up::Z, origin: [0.0; 3] };
    let size = unit.matrix(numbers).determinant();
    if size == 0.0 || !size.is_finite() {
        return Err("an instance is scaled to nothing; give a scale other than 0".into());
    }
    Ok(())
}

/// One placement on its way from TOML, without a heap allocation each.
struct Numbers([f64; 13], usize);

impl<'de> Deserialize<'de> for Numbers {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct V;
        impl<'de> Visitor<'de> for V {
            type Value = Numbers;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an instance such as [x, y, z, degrees, scale]")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Numbers, A::Error> {
                let mut out = Numbers([0.0; 13], 0);
                while let Some(v) = seq.next_element()? {
                    out.0[out.1.min(12)] = v;
                    out.1 = (out.1 + 1).min(13);
                }
                // Checked here already, where the error still knows its line.
                check(&out.0[..out.1]).map_err(A::Error::custom)?;
                Ok(out)
            }
        }
        deserializer.deserialize_seq(V)
    }
}

impl<'de> Deserialize<'de> for Placements {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct V;
        impl<'de> Visitor<'de> for V {
            type Value = Placements;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of instances such as [[x, y, z], [x, y, z, degrees]]")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Placements, A::Error> {
                let mut out = Placements::default();
                while let Some(Numbers(numbers, n)) = seq.next_element()? {
                    out.push(&numbers[..n]).map_err(A::Error::custom)?;
                }
                Ok(out)
            }
        }
        deserializer.deserialize_seq(V)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn frame(units: f64, up: Up) -> Frame {
        Frame { units, up, origin: [0.0; 3] }
    }

    #[test]
    fn placements_in_closed_form() {
        let f = frame(1.0, Up::Z);
        let p = DVec3::new(1.0, 2.0, 3.0);
        assert_eq!(f.matrix(&[10., 20., 30.]).store(p), [11., 22., 33.]);
        assert_eq!(f.matrix(&[0., 0., 0., 90.]).store(p), [-2., 1., 3.]);
        assert_eq!(f.matrix(&[0., 0., 0., -90.]).store(p), [2., -1., 3.]);
        assert_eq!(f.matrix(&[0., 0., 0., 540.]).store(p), [-1., -2., 3.]);
        assert_eq!(f.matrix(&[1., 0., 0., 90., 2.]).store(p), [-3., 2., 6.]);
        assert_eq!(f.matrix(&[0., 0., 0., 0., 1., 2., -1.]).store(p), [1., 4., -3.]);
        assert!(f.matrix(&[0., 0., 0., 0., 1., 2., -1.]).flips);
        let m = [0., 0., 1., 5., 1., 0., 0., 6., 0., 1., 0., 7.];
        assert_eq!(f.matrix(&m).store(p), [8., 7., 9.]);
        assert!(!f.matrix(&m).flips);
        let r = f.matrix(&[0., 0., 0., 30.]).store(DVec3::X);
        assert!((r[0] - 0.75f32.sqrt()).abs() < 1e-7 && (r[1] - 0.5).abs() < 1e-7);
    }

    #[test]
    fn y_up_turns_instances_about_the_vertical() {
        let f = frame(0.001, Up::Y);
        // A point 1000 mm in front (+z) and 2000 mm up becomes 1 m towards -y, 2 m up.
        assert_eq!(f.matrix(&[0.; 3]).store(DVec3::new(0., 2000., 1000.)), [0., -1., 2.]);
        assert_eq!(f.point([0., 2000., 1000.]), [0., -1., 2.]);
        // Turning by 90 degrees, seen from above, takes +x to "north", away from the viewer (-z).
        assert_eq!(f.matrix(&[0., 0., 0., 90.]).store(DVec3::X * 1000.), [0., 1., 0.]);
        assert!(!f.matrix(&[0., 0., 0., 33.]).flips);
        assert_eq!(f.direction([0., 3., 0.]), Some([0., 0., 1.]));
        assert_eq!(f.direction([0.; 3]), None);
    }

    #[test]
    fn large_coordinates_are_rounded_after_the_origin_is_gone() {
        let f = Frame { units: 1.0, up: Up::Z, origin: [500_000.0, 4_000_000.0, 0.0] };
        let p = f.matrix(&[500_000., 4_000_000., 0.]).store(DVec3::new(0.1, -0.1, 7.7));
        for (got, want) in p.into_iter().zip([0.1f32, -0.1, 7.7]) {
            assert!((got - want).abs() < 1e-8, "{got} {want}");
        }
    }

    #[test]
    fn there_is_only_one_zero() {
        let bits = frame(1.0, Up::Y).matrix(&[0.; 3]).store(DVec3::new(-0.0, 0.0, 0.0));
        assert_eq!(bits.map(f32::to_bits), [0; 3]);
        assert_eq!(frame(1.0, Up::Y).point([-0.0, -0.0, 0.0]).map(f32::to_bits), [0; 3]);
        assert_eq!(round(-1e-60).to_bits(), 0);
    }

    #[test]
    fn bad_placements_are_refused() {
        let mut p = Placements::default();
        assert!(p.push(&[1.0; 6]).unwrap_err().contains("6 numbers"));
        assert!(p.push(&[1.0, 2.0, f64::NAN]).unwrap_err().contains("NaN"));
        assert!(p.push(&[0.0, 0.0, 0.0, 0.0, 0.0]).unwrap_err().contains("scale"));
        assert_eq!(p.len(), 0);
    }

    proptest! {
        #[test]
        fn a_turned_instance_keeps_lengths_and_an_identity_keeps_bits(
            p in proptest::array::uniform3(-100.0..100.0f64),
            angle in -720.0..720.0f64,
        ) {
            let f = frame(1.0, Up::Z);
            prop_assert_eq!(f.matrix(&[0.; 3]).store(DVec3::from_array(p)), p.map(round));
            let q = f.matrix(&[0., 0., 0., angle]).world(DVec3::from_array(p));
            prop_assert!((q.length() - DVec3::from_array(p).length()).abs() < 1e-10);
        }
    }
}
