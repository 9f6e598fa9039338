//! Unit vectors in 24 bits: the octahedral map (Cigolle et al. 2014, "A Survey of Efficient
//! Representations for Independent Unit Vectors", JCGT 3(2)), 12 bits a coordinate.

/// Quantisation steps on either side of zero.
const STEPS: f32 = 2047.0;

#[inline(always)]
fn sign(x: f32) -> f32 {
    if x >= 0.0 { 1.0 } else { -1.0 }
}

/// The 24-bit code of a unit vector (angular error below 0.1 degree).
#[inline(always)]
pub fn encode(v: [f32; 3]) -> u32 {
    let sum = v[0].abs() + v[1].abs() + v[2].abs();
    let (mut x, mut y) = (v[0] / sum, v[1] / sum);
    if v[2] < 0.0 {
        (x, y) = ((1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y));
    }
    let q = |c: f32| crate::rgbe::whole(c * STEPS + STEPS + 0.5) & 0xfff;
    q(x) | q(y) << 12
}

/// The unit vector of a 24-bit code.
pub fn decode(code: u32) -> [f32; 3] {
    let c = |q: u32| (q & 0xfff) as f32 / STEPS - 1.0;
    let (mut x, mut y) = (c(code), c(code >> 12));
    let z = 1.0 - x.abs() - y.abs();
    if z < 0.0 {
        (x, y) = ((1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y));
    }
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, y / length, z / length]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn angular_error_is_below_a_tenth_of_a_degree(z in -1.0f64..1.0, phi in 0.0f64..core::f64::consts::TAU) {
            let r = (1.0 - z * z).sqrt();
            let v = [(r * libm::cos(phi)) as f32, (r * libm::sin(phi)) as f32, z as f32];
            let w = decode(encode(v));
            let cross = [v[1]*w[2]-v[2]*w[1], v[2]*w[0]-v[0]*w[2], v[0]*w[1]-v[1]*w[0]];
            let sine = (cross.iter().map(|c| f64::from(*c) * f64::from(*c)).sum::<f64>()).sqrt();
            prop_assert!(sine < 0.1f64.to_radians(), "{v:?} -> {w:?}");
        }
    }

    #[test]
    fn axes_are_exact() {
        for v in
            [[1., 0., 0.], [-1., 0., 0.], [0., 1., 0.], [0., -1., 0.], [0., 0., 1.], [0., 0., -1.]]
        {
            assert_eq!(decode(encode(v)), v);
        }
    }
}
