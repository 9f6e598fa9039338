//! Random numbers that are the same everywhere: SplitMix64, keyed by a seed and a label.
//!
//! Steele, Lea and Flood 2014, *Fast Splittable Pseudorandom Number Generators*. Each room and
//! each piece of furniture has a stream of its own, so that a new chair in one room moves nothing
//! in another.

/// A stream of random numbers.
#[derive(Clone, Debug)]
pub struct Rng(u64);

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Rng {
    /// The stream of `seed` for the purpose named by `label`.
    pub fn new(seed: u64, label: &str) -> Self {
        let mut state = mix(seed ^ 0x6a09_e667_f3bc_c909);
        for byte in label.bytes() {
            state = mix(state ^ u64::from(byte).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        }
        Self(state)
    }

    /// Sixty-four random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.0)
    }

    /// Uniform in `[0, 1)`.
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in `[low, high)`.
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Uniform in `[-spread, spread)`.
    pub fn around(&mut self, spread: f64) -> f64 {
        self.range(-spread, spread)
    }

    /// Uniform in `0..count`; 0 when `count` is 0.
    pub fn below(&mut self, count: usize) -> usize {
        ((self.unit() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// One of `items`, which must not be empty.
    pub fn pick<T: Copy>(&mut self, items: &[T]) -> T {
        items[self.below(items.len())]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_are_fixed_and_apart() {
        let first: Vec<u64> = (0..4)
            .map({
                let mut r = Rng::new(1, "a");
                move |_| r.bits()
            })
            .collect();
        let again: Vec<u64> = (0..4)
            .map({
                let mut r = Rng::new(1, "a");
                move |_| r.bits()
            })
            .collect();
        assert_eq!(first, again);
        assert_ne!(first[0], Rng::new(2, "a").bits());
        assert_ne!(first[0], Rng::new(1, "b").bits());
    }

    #[test]
    fn units_fill_their_interval() {
        let mut r = Rng::new(7, "units");
        let mean = (0..10_000).map(|_| r.unit()).sum::<f64>() / 10_000.0;
        assert!((mean - 0.5).abs() < 0.02);
        assert!((0..1000).all(|_| r.below(3) < 3));
    }
}
