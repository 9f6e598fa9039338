//! Which photon goes to which piece of a map that is too large to be built at once.
//!
//! A room's box is divided in steps, and a photon's number interleaves the bits of its steps along the three axes: a
//! range of numbers is a box, or some boxes side by side. Ranges with too many photons are halved. All that is needed
//! is to look at the photons again and again, one at a time; where they are cut depends on the set alone.

use std::ops::RangeInclusive;

use enf_layout::photon::PhotonRecord;

/// Bits of a step along an axis.
const STEP_BITS: u32 = 21;
/// Bits of a photon's number.
const NUMBER_BITS: u32 = 3 * STEP_BITS;
/// Bits of a number that one look at the photons can tell apart.
const LOOK_BITS: u32 = 15;

/// The box about photons that are seen one at a time, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cube {
    min: [f32; 3],
    max: [f32; 3],
}

impl Default for Cube {
    fn default() -> Self {
        Self { min: [f32::MAX; 3], max: [f32::MIN; 3] }
    }
}

impl Cube {
    /// Grows around a photon.
    pub fn add(&mut self, photon: &PhotonRecord) {
        for (axis, at) in photon.position().into_iter().enumerate() {
            self.min[axis] = if at < self.min[axis] { at } else { self.min[axis] };
            self.max[axis] = if at > self.max[axis] { at } else { self.max[axis] };
        }
    }

    /// The number of a photon in it.
    pub fn number(&self, photon: &PhotonRecord) -> u64 {
        let side = (0..3).fold(0.0f32, |most, axis| most.max(self.max[axis] - self.min[axis]));
        let scale = (1u32 << STEP_BITS) as f32 / side;
        let at = photon.position();
        (0..3).fold(0, |number, axis| {
            // What is no number is at the first step.
            let step = ((at[axis] - self.min[axis]) * scale) as u64;
            number | spread(step.min((1 << STEP_BITS) - 1)) << axis
        })
    }
}

/// The bits of a step, two zeros before each but the lowest.
fn spread(step: u64) -> u64 {
    let mut bits = step;
    for (shift, mask) in [
        (32, 0x001f_0000_0000_ffff),
        (16, 0x001f_0000_ff00_00ff),
        (8, 0x100f_00f0_0f00_f00f),
        (4, 0x10c3_0c30_c30c_30c3),
        (2, 0x1249_2492_4924_9249),
    ] {
        bits = (bits | bits << shift) & mask;
    }
    bits
}

/// A piece that will be: the numbers of its photons, and how many there are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PieceRange {
    /// Their numbers ([`Cube::number`]).
    pub numbers: RangeInclusive<u64>,
    /// Photons with such a number.
    pub photons: u64,
}

/// Bytes that [`divide`] takes.
pub const DIVIDE_BYTES: u64 = 8 << LOOK_BITS;

/// Cuts photons into pieces of up to `most`, in ascending order; more than that in a piece only if they cannot be told apart.
/// `look` shows the numbers of all photons, in any order; it is called at least once.
///
/// # Errors
/// What `look` fails with.
pub fn divide<E>(
    most: u64,
    mut look: impl FnMut(&mut dyn FnMut(u64)) -> Result<(), E>,
) -> Result<Vec<PieceRange>, E> {
    let mut pieces = Vec::new();
    let mut counts = vec![0u64; 1 << LOOK_BITS];
    // Ranges of 2^bits numbers that are not known well enough.
    let mut unknown = vec![(0u64, NUMBER_BITS)];
    while let Some((first, bits)) = unknown.pop() {
        let fine = bits.saturating_sub(LOOK_BITS);
        counts.fill(0);
        look(&mut |number| {
            if number.wrapping_sub(first) >> bits == 0
                && let Some(count) = counts.get_mut((number.wrapping_sub(first) >> fine) as usize)
            {
                *count += 1;
            }
        })?;
        let mut ranges = vec![(0usize, 1usize << (bits - fine))];
        while let Some((from, end)) = ranges.pop() {
            let photons: u64 = counts[from..end].iter().sum();
            let start = first + ((from as u64) << fine);
            if photons == 0 {
                continue;
            }
            if photons > most && end - from > 1 {
                let middle = from + (end - from) / 2;
                ranges.extend([(from, middle), (middle, end)]);
            } else if photons > most && fine > 0 {
                unknown.push((start, fine));
            } else {
                let last = start + (((end - from) as u64) << fine) - 1;
                pieces.push(PieceRange { numbers: start..=last, photons });
            }
        }
    }
    pieces.sort_by_key(|piece| *piece.numbers.start());
    Ok(pieces)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photon_map::tests_support::shuffled;

    #[test]
    fn bits_are_spread() {
        for step in [0, 1, 5, 0x1f_ffff, 0x10_0001] {
            let slow = (0..21).fold(0u64, |n, bit| n | (step >> bit & 1) << (3 * bit));
            assert_eq!(spread(step), slow);
        }
    }

    #[test]
    fn every_photon_is_in_one_piece_and_none_is_too_large() {
        let mut photons = shuffled(20_000, 3);
        // A third in one spot, and half of the rest within a millimetre.
        for (i, p) in photons.iter_mut().enumerate() {
            match i % 3 {
                0 => p.position_bits = [1.0f32; 3].map(f32::to_bits),
                1 => {
                    let [x, y, z] = p.position().map(|c| 2.0 + c * 1e-4);
                    p.position_bits = [x, y, z].map(f32::to_bits);
                }
                _ => {}
            }
        }
        let mut cube = Cube::default();
        photons.iter().for_each(|p| cube.add(p));
        let mut looks = 0;
        let pieces = divide(500, |see| {
            looks += 1;
            photons.iter().for_each(|p| see(cube.number(p)));
            Ok::<(), ()>(())
        })
        .unwrap();
        assert!(looks > 1);
        assert_eq!(pieces.iter().map(|p| p.photons).sum::<u64>(), 20_000);
        let mut spots = 0;
        for (i, piece) in pieces.iter().enumerate() {
            let inside = photons.iter().filter(|p| piece.numbers.contains(&cube.number(p)));
            assert_eq!(inside.count() as u64, piece.photons);
            assert!(i == 0 || pieces[i - 1].numbers.end() < piece.numbers.start());
            spots += u32::from(piece.photons > 500);
        }
        assert_eq!(spots, 1, "only photons in one spot may be too many");
        // All in one.
        let one = divide(20_000, |see| {
            photons.iter().for_each(|p| see(cube.number(p)));
            Ok::<(), ()>(())
        });
        assert_eq!(one.unwrap().len(), 1);
        assert_eq!(divide(5, |_| Ok::<(), ()>(())), Ok(Vec::new()));
        let flat = Cube::default();
        assert_eq!(flat.number(&photons[0]), flat.number(&photons[0]));
    }
}
