//! Flux in four bytes: three mantissas and a shared exponent (Ward 1991), rounded stochastically.
//!
//! Rounding to nearest, or down, biases a light whose photons all carry the same flux; here each
//! mantissa is rounded up with probability equal to its fraction, so the mean is exact.

/// Encodes a non-negative RGB; `dither` are three numbers in `[0, 1)` from the photon's own counter.
#[inline]
pub fn encode(rgb: [f32; 3], dither: [f32; 3]) -> [u8; 4] {
    let largest = rgb[0].max(rgb[1]).max(rgb[2]);
    if largest.is_nan() || largest <= 1e-37 {
        return [0; 4];
    }
    // frexp: largest = m * 2^e, m in [0.5, 1)
    let mut exponent = ((largest.to_bits() >> 23) & 0xff) as i32 - 126;
    loop {
        let scale = exp2i(8 - exponent);
        let mantissa = [0, 1, 2].map(|i| (rgb[i] * scale + dither[i]).floor() as i32);
        // Rounding up may reach 256: take the next exponent, with the same dither.
        if mantissa.iter().all(|&m| m < 256) {
            let e = exponent + 128;
            if e <= 0 {
                return [0; 4];
            }
            let [r, g, b] = mantissa.map(|m| m.max(0) as u8);
            return [r, g, b, e.min(255) as u8];
        }
        exponent += 1;
    }
}

/// The whole part of a number from 0 to 2^22: what a cast gives, in instructions that vectors have as well.
#[inline(always)]
pub fn whole(x: f32) -> u32 {
    const SHIFT: f32 = 8_388_608.0;
    let nearest = x + SHIFT;
    (nearest.to_bits() & 0x7f_ffff) - u32::from(nearest - SHIFT > x)
}

/// The RGB of a code (the mean of [`encode`] over its dither is the original).
pub fn decode(code: [u8; 4]) -> [f32; 3] {
    if code[3] == 0 {
        return [0.0; 3];
    }
    let scale = exp2i(i32::from(code[3]) - 128 - 8);
    [0, 1, 2].map(|i| f32::from(code[i]) * scale)
}

/// `2^e`, exact, flushed to zero below the smallest normal.
fn exp2i(e: i32) -> f32 {
    match e {
        ..-126 => f32::from_bits(if e >= -149 { 1 << (e + 149) } else { 0 }),
        -126..=127 => f32::from_bits(((e + 127) as u32) << 23),
        _ => f32::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_mean_over_the_dither_is_the_value() {
        let rgb = [0.73219f32, 0.0123, 0.40001];
        let n = 4096;
        let mut sum = [0.0f64; 3];
        for i in 0..n {
            let d = (i as f32 + 0.5) / n as f32;
            let back = decode(encode(rgb, [d; 3]));
            for c in 0..3 {
                sum[c] += f64::from(back[c]);
            }
        }
        for c in 0..3 {
            let mean = sum[c] / f64::from(n);
            assert!((mean - f64::from(rgb[c])).abs() < 2e-6, "{c}: {mean} for {}", rgb[c]);
        }
    }

    #[test]
    fn whole_parts() {
        for i in 0..1u32 << 20 {
            let below = ((i + 1) as f32).next_down();
            for x in [i as f32, i as f32 + 0.25, i as f32 + 0.5, i as f32 + 0.75, below] {
                assert_eq!(whole(x), x as u32, "{x}");
            }
        }
    }

    proptest! {
        #[test]
        fn error_is_below_one_step(r in 0.0f32..1e6, g in 0.0f32..1e6, b in 0.0f32..1e6, d in 0.0f32..0.9999) {
            let back = decode(encode([r, g, b], [d; 3]));
            let step = r.max(g).max(b) / 128.0 * 1.0001;
            prop_assert!((back[0]-r).abs() <= step && (back[1]-g).abs() <= step && (back[2]-b).abs() <= step);
        }
    }
}
