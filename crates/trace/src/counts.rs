//! How many photons each light emits.

use enf_layout::light::LightRecord;
use enf_transport::sky::Daylight;

/// What was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhotonCount {
    /// So many from every light.
    PerLight(u64),
    /// So many in all, shared by power: every photon carries the same flux, but for the rounding of counts to
    /// whole photons. (Those of daylight that comes through no opening may carry more: it counts at most as all other lights together.)
    Total(u64),
}

/// Photons by light.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Counts {
    /// Of every light, where `by_light` is empty.
    each: u64,
    by_light: Vec<u32>,
}

impl Counts {
    /// Bytes that the counts of so many lights take, while they are made.
    pub fn bytes(count: PhotonCount, lights: usize) -> u64 {
        let each = size_of::<u32>() + size_of::<(f64, u32)>() + size_of::<(f64, u32)>();
        if let PhotonCount::Total(_) = count { (lights * each) as u64 } else { 0 }
    }

    /// Counts photons among lights, whose power is the scalar of their flux.
    ///
    /// # Errors
    /// More photons of a light than can be numbered, or fewer in all than there are lights: in words.
    pub fn new(count: PhotonCount, lights: &[LightRecord]) -> Result<Self, String> {
        match count {
            PhotonCount::PerLight(each) if each == 0 || each > u64::from(u32::MAX) => {
                Err("--photons-per-light takes 1 to 4294967295".into())
            }
            PhotonCount::PerLight(each) => Ok(Self { each, by_light: Vec::new() }),
            PhotonCount::Total(total) => {
                let flux = |l: &LightRecord| {
                    let [r, g, b] = l.flux_w.map(f64::from);
                    0.2126 * r + 0.7152 * g + 0.0722 * b
                };
                // Daylight that comes through no opening is more than all else, and hardly anybody sees it.
                let everywhere = Daylight::is_everywhere;
                let others: f64 = lights.iter().filter(|l| !everywhere(l)).map(flux).sum();
                let power = |l: &LightRecord| match everywhere(l) && others > 0.0 {
                    true => flux(l).min(others),
                    false => flux(l),
                };
                Ok(Self { each: 0, by_light: by_power(total, lights.iter().map(power))? })
            }
        }
    }

    /// Photons that a light emits.
    pub fn of(&self, light: u32) -> u64 {
        self.by_light.get(light as usize).map_or(self.each, |&n| u64::from(n))
    }

    /// Where start number `cursor` is when lights take turns, each with its photons and `more` starts: which of them,
    /// and which of its starts. Behind the last: their number, and 0.
    pub fn place(&self, lights: &[u32], more: u64, cursor: u64) -> (usize, u64) {
        let mut first = cursor;
        for (at, &light) in lights.iter().enumerate() {
            let length = self.of(light) + more;
            if first < length {
                return (at, first);
            }
            first -= length;
        }
        (lights.len(), 0)
    }

    /// Photons that so many lights emit, all of them.
    pub fn total(&self, lights: usize) -> u64 {
        match &self.by_light[..] {
            [] => lights as u64 * self.each,
            counts => counts.iter().map(|&n| u64::from(n)).sum(),
        }
    }
}

/// Largest remainders: as many as `total`, in proportion to the powers, but at least one from each that has any.
fn by_power(total: u64, powers: impl Iterator<Item = f64>) -> Result<Vec<u32>, String> {
    let mut counts = Vec::new();
    let mut lit: Vec<(f64, u32)> = Vec::new();
    for (id, power) in powers.enumerate() {
        counts.push(0u32);
        if power > 0.0 {
            lit.push((power, id as u32));
        }
    }
    let wanted = lit.len() as u64;
    if total < wanted {
        return Err(format!(
            "--photons {total} are fewer than the {wanted} lights: give one for each at least"
        ));
    }
    // From the weakest on: whoever would get less than one gets one, and the others share the rest.
    lit.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut stronger: Vec<f64> = lit.iter().map(|l| l.0).collect();
    for i in (1..stronger.len()).rev() {
        stronger[i - 1] += stronger[i];
    }
    let mut left = total;
    let mut first = 0;
    while first < lit.len() && lit[first].0 * left as f64 / stronger[first] < 1.0 {
        counts[lit[first].1 as usize] = 1;
        left -= 1;
        first += 1;
    }
    let Some(&power) = stronger.get(first) else { return Ok(counts) };
    let mut given = 0;
    // What is left of a photon, and whose: in place of the power.
    for light in &mut lit[first..] {
        let ideal = light.0 * left as f64 / power;
        let whole = ideal.floor().max(1.0);
        if whole > f64::from(u32::MAX) {
            return Err(format!(
                "--photons {total} makes one light emit {whole:.0}: at most 4294967295 can be numbered"
            ));
        }
        counts[light.1 as usize] = whole as u32;
        given += whole as u64;
        light.0 = ideal - whole;
    }
    let lit = &mut lit[first..];
    lit.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    for &(_, id) in lit.iter().cycle().take(left.saturating_sub(given) as usize) {
        counts[id as usize] = counts[id as usize].saturating_add(1);
    }
    // Sums of many powers are rounded: now and then a photon too many was given.
    let mut over = given.saturating_sub(left);
    while over > 0 {
        for &(_, id) in lit.iter().rev() {
            if over > 0 && counts[id as usize] > 1 {
                counts[id as usize] -= 1;
                over -= 1;
            }
        }
    }
    Ok(counts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use enf_transport::rng::{self, Purpose};

    fn shared(total: u64, powers: &[f64]) -> Vec<u32> {
        by_power(total, powers.iter().copied()).unwrap()
    }

    #[test]
    fn in_proportion() {
        assert_eq!(shared(1000, &[1.0, 2.0, 7.0]), [100, 200, 700]);
        // Halves go to the first.
        assert_eq!(shared(3, &[1.0, 1.0]), [2, 1]);
        // 10 / 7 = 1.43, 2.86, 5.71: remainders .43, .86, .71.
        assert_eq!(shared(10, &[1.0, 2.0, 4.0]), [1, 3, 6]);
        // Weak ones get one, dark ones none; the rest is shared by the others.
        assert_eq!(shared(100, &[1e-9, 0.0, 3.0, 1e-12, 1.0]), [1, 0, 74, 1, 24]);
        assert_eq!(shared(3, &[1.0, 1e6, 1.0]), [1, 1, 1]);
        assert_eq!(shared(0, &[]), [0; 0]);
    }

    #[test]
    fn starts_are_counted_light_by_light() {
        let counts = Counts { each: 0, by_light: vec![5, 0, 3, 1] };
        let mut seen = Vec::new();
        for cursor in 0..100 {
            let (at, first) = counts.place(&[0, 1, 3], 2, cursor);
            if at == 3 {
                assert_eq!((first, cursor), (0, 12));
                break;
            }
            seen.push((at, first));
        }
        let expected: Vec<_> =
            [7, 2, 3].iter().enumerate().flat_map(|(i, &n)| (0..n).map(move |k| (i, k))).collect();
        assert_eq!(seen, expected);
        let each = Counts { each: 4, by_light: Vec::new() };
        assert_eq!(each.place(&[9, 8], 1, 7), (1, 2));
        assert_eq!(each.place(&[], 1, 0), (0, 0));
    }

    #[test]
    fn refusals_say_why() {
        let error = by_power(2, [1.0, 0.0, 1.0, 5.0].into_iter()).unwrap_err();
        assert!(error.contains("the 3 lights"), "{error}");
        let error = by_power(u64::MAX / 2, [1.0].into_iter()).unwrap_err();
        assert!(error.contains("4294967295"), "{error}");
        let lights = [LightRecord { flux_w: [1.0; 3], ..LightRecord::DARK }; 2];
        assert!(Counts::new(PhotonCount::PerLight(0), &lights).is_err());
        assert!(Counts::new(PhotonCount::PerLight(1 << 32), &lights).is_err());
        let each = Counts::new(PhotonCount::PerLight(7), &lights).unwrap();
        assert_eq!((each.of(1), each.total(2)), (7, 14));
        let all = Counts::new(PhotonCount::Total(7), &lights).unwrap();
        assert_eq!((all.of(0), all.of(1), all.total(2)), (4, 3, 7));
    }

    /// The sum is exact, every light that shines has a photon, and those that have more have them in proportion.
    #[test]
    fn the_sum_is_exact() {
        for case in 0..500 {
            let word = |i: u32| rng::block(9, Purpose::Camera, case, i, 0, 0);
            let [n, more, spread, _] = word(u32::MAX);
            // Spread over up to thirteen powers of ten; one of eight is dark.
            let power = |i: u32| {
                let [a, b, c, _] = word(i);
                let scale = 10f64.powi((b % (1 + spread % 13)) as i32);
                if c % 8 == 0 { 0.0 } else { scale * f64::from(1 + a % 1000) }
            };
            let powers: Vec<f64> = (0..1 + n % 200).map(power).collect();
            let lit = powers.iter().filter(|p| **p > 0.0).count() as u64;
            let total = if lit > 0 { lit + u64::from(more % 100_000) } else { 0 };
            let counts = shared(total, &powers);
            assert_eq!(counts.iter().map(|&s| u64::from(s)).sum::<u64>(), total);
            for (share, power) in counts.iter().zip(&powers) {
                assert_eq!(*share > 0, *power > 0.0);
            }
            // Photons of two lights that have several differ in flux by what rounding to whole photons makes of it.
            let several: Vec<usize> = (0..counts.len()).filter(|&i| counts[i] > 1).collect();
            for pair in several.windows(2) {
                let [(p, n), (q, m)] =
                    [0, 1].map(|k| (powers[pair[k]], f64::from(counts[pair[k]])));
                assert!(p / (n + 1.0) <= q / (m - 1.0) && q / (m + 1.0) <= p / (n - 1.0));
            }
        }
    }
}
