//! Counter-based random numbers: Philox4x32-10 (Salmon et al. 2011, "Parallel Random Numbers: As Easy
//! as 1, 2, 3").

/// What a block of numbers is for; part of the counter, so that purposes never share numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Purpose {
    /// Start of a photon.
    Emission = 0,
    /// One interaction of a photon.
    Scatter = 1,
    /// Stochastic rounding of a stored photon.
    Dither = 2,
    /// A visibility probe from a light.
    Probe = 3,
    /// A camera sample's place in its pixel.
    Camera = 4,
    /// Choice of lights and points on them for a shading point.
    Shadow = 5,
    /// One interaction of a camera path.
    CameraScatter = 6,
    /// Directions of the gather rays that a surface sends out.
    Gather = 7,
    /// One interaction of a gather ray.
    GatherScatter = 8,
    /// Photons that are aimed at openings from outside.
    Aim = 9,
    /// Choice of lights and points on them where a gather ray has ended.
    GatherShadow = 10,
}

/// Four numbers for (`seed`, `purpose`, `a`, `b`, `bounce`, `block`): for photons `a` is the light and `b`
/// the photon, for camera rays the pixel and the sample.
#[inline(always)]
pub fn block(seed: u64, purpose: Purpose, a: u32, b: u32, bounce: u16, block: u8) -> [u32; 4] {
    let word = u32::from(bounce) | (purpose as u32) << 16 | u32::from(block) << 24;
    philox([b, a, word, 0], [seed as u32, (seed >> 32) as u32])
}

/// Four uniform numbers in `[0, 1)`, as [`block`].
#[inline(always)]
pub fn uniforms(seed: u64, purpose: Purpose, a: u32, b: u32, bounce: u16, index: u8) -> [f32; 4] {
    block(seed, purpose, a, b, bounce, index).map(unit)
}

/// The top 24 bits as a number in `[0, 1)`.
#[inline(always)]
pub fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// A number in `[0, 1)` of 53 bits, from two words.
pub fn fine(high: u32, low: u32) -> f64 {
    (u64::from(high) << 21 | u64::from(low) >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
}

#[inline(always)]
fn philox(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    const M0: u32 = 0xD251_1F53;
    const M1: u32 = 0xCD9E_8D57;
    for _ in 0..10 {
        let p0 = u64::from(M0) * u64::from(counter[0]);
        let p1 = u64::from(M1) * u64::from(counter[2]);
        counter = [
            (p1 >> 32) as u32 ^ counter[1] ^ key[0],
            p1 as u32,
            (p0 >> 32) as u32 ^ counter[3] ^ key[1],
            p0 as u32,
        ];
        key = [key[0].wrapping_add(0x9E37_79B9), key[1].wrapping_add(0xBB67_AE85)];
    }
    counter
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers of the authors' Random123 distribution (kat_vectors, philox4x32-10).
    #[test]
    fn philox_known_answers() {
        assert_eq!(philox([0; 4], [0; 2]), [0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8]);
        assert_eq!(
            philox([u32::MAX; 4], [u32::MAX; 2]),
            [0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd]
        );
        assert_eq!(
            philox([0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344], [0xa4093822, 0x299f31d0]),
            [0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1]
        );
    }

    #[test]
    fn uniforms_are_below_one_and_purposes_differ() {
        assert!(unit(u32::MAX) < 1.0);
        assert!(fine(u32::MAX, u32::MAX) < 1.0);
        assert_eq!((fine(0, 0), fine(1 << 31, 0), fine(0, 1 << 31)), (0.0, 0.5, 0.5f64.powi(33)));
        let a = block(1, Purpose::Emission, 2, 3, 0, 0);
        assert_ne!(a, block(1, Purpose::Probe, 2, 3, 0, 0));
        assert_ne!(a, block(1, Purpose::Emission, 2, 3, 1, 0));
        assert_ne!(a, block(1, Purpose::Emission, 2, 3, 0, 1));
        assert_ne!(a, block(2, Purpose::Emission, 2, 3, 0, 0));
    }
}
