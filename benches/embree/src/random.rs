//! Random numbers that are the same everywhere: SplitMix64 (Steele, Lea and Flood 2014, Fast Splittable
//! Pseudorandom Number Generators), one stream per key.

/// A stream of random numbers.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// The stream of a key.
    pub fn new(key: u64) -> Self {
        Self(mix(key.wrapping_add(0x9E37_79B9_7F4A_7C15)))
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        mix(self.0)
    }

    /// Uniform in `[0, 1)`.
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in `[low, high)`.
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Puts a list in random order (Durstenfeld 1964).
    pub fn shuffle<T>(&mut self, list: &mut [T]) {
        for i in (1..list.len()).rev() {
            let j = ((u128::from(self.bits()) * (i as u128 + 1)) >> 64) as usize;
            list.swap(i, j);
        }
    }
}

/// A bijection of 64 bits that leaves no pattern.
pub fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uniform_and_shuffled() {
        let mut random = Random::new(3);
        let mean = (0..100_000).map(|_| random.unit()).sum::<f64>() / 1e5;
        // Four standard deviations of the mean of 1e5 uniform numbers.
        assert!((mean - 0.5).abs() < 4.0 * (1.0f64 / 12.0 / 1e5).sqrt(), "{mean}");
        let mut list: Vec<u32> = (0..1000).collect();
        random.shuffle(&mut list);
        assert!(list.iter().enumerate().filter(|&(i, &x)| i as u32 == x).count() < 10);
        list.sort_unstable();
        assert!(list.iter().enumerate().all(|(i, &x)| i as u32 == x));
    }
}
