//! Eight boxes and sixteen photons at once, with the instructions that a machine has.
//!
//! The arithmetic is written once, in plain loops over arrays that the compiler turns into vectors inside
//! [`Instructions::run`]; nothing is fused, so that every set of instructions finds the same bits. Only what a
//! compiler is bad at, masks, is spelled out.
#![expect(clippy::needless_range_loop, reason = "several arrays, lane by lane")]

use enf_layout::map::{BLOCK_PHOTONS, MapBlock, MapNode, NODE_CHILDREN};
use pulp::NullaryFnOnce;
#[cfg(target_arch = "x86_64")]
use pulp::{
    cast,
    x86::{V3, V4},
};

/// Sets of instructions, the least first. Results do not depend on them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Instructions {
    /// What every machine has.
    Portable,
    /// AVX2 (x86-64-v3).
    Avx2,
    /// AVX-512 F, BW, CD, DQ and VL (x86-64-v4); the best of the others where a machine has not got it.
    #[default]
    Avx512,
}

/// Work that is done with a level.
pub(super) trait Task {
    type Output;
    fn with<L: Level>(self, level: L) -> Self::Output;
}

#[cfg(target_arch = "x86_64")]
struct With<T, L>(T, L);

#[cfg(target_arch = "x86_64")]
impl<T: Task, L: Level> NullaryFnOnce for With<T, L> {
    type Output = T::Output;

    #[inline(always)]
    fn call(self) -> T::Output {
        self.0.with(self.1)
    }
}

impl Instructions {
    /// All sets.
    pub const ALL: [Self; 3] = [Self::Portable, Self::Avx2, Self::Avx512];

    /// Does it with these instructions, or with the best lesser ones that there are.
    #[inline(always)]
    pub(super) fn run<T: Task>(self, task: T) -> T::Output {
        #[cfg(target_arch = "x86_64")]
        {
            if self == Self::Avx512
                && let Some(level) = V4::try_new()
            {
                return level.vectorize(With(task, level));
            }
            if self != Self::Portable
                && let Some(level) = V3::try_new()
            {
                return level.vectorize(With(task, level));
            }
        }
        task.with(Portable)
    }
}

/// What a set of instructions does in its own way.
pub(super) trait Level: Copy {
    /// Which of eight numbers are no greater than `bound`, a bit each; none that is no number is.
    fn within8(self, of: &[f32; NODE_CHILDREN], bound: f32) -> u32;

    /// The same of sixteen.
    fn within16(self, of: &[f32; BLOCK_PHOTONS], bound: f32) -> u32;

    /// Which of sixteen words are not zero.
    fn nonzero16(self, of: &[u32; BLOCK_PHOTONS]) -> u32;

    /// The lanes whose bits are set, moved to the front; what comes after them is anything.
    fn front(self, lanes: &[u32; BLOCK_PHOTONS], mask: u32) -> [u32; BLOCK_PHOTONS];
}

/// In plain Rust.
#[derive(Clone, Copy)]
pub(super) struct Portable;

impl Level for Portable {
    #[inline(always)]
    fn within8(self, of: &[f32; NODE_CHILDREN], bound: f32) -> u32 {
        let mut mask = 0;
        for (i, x) in of.iter().enumerate() {
            mask |= u32::from(*x <= bound) << i;
        }
        mask
    }

    #[inline(always)]
    fn within16(self, of: &[f32; BLOCK_PHOTONS], bound: f32) -> u32 {
        let mut mask = 0;
        for (i, x) in of.iter().enumerate() {
            mask |= u32::from(*x <= bound) << i;
        }
        mask
    }

    #[inline(always)]
    fn nonzero16(self, of: &[u32; BLOCK_PHOTONS]) -> u32 {
        let mut mask = 0;
        for (i, x) in of.iter().enumerate() {
            mask |= u32::from(*x != 0) << i;
        }
        mask
    }

    #[inline(always)]
    fn front(self, lanes: &[u32; BLOCK_PHOTONS], mask: u32) -> [u32; BLOCK_PHOTONS] {
        let mut out = [0; BLOCK_PHOTONS];
        let mut n = 0;
        for (i, lane) in lanes.iter().enumerate() {
            out[n & (BLOCK_PHOTONS - 1)] = *lane;
            n += (mask >> i & 1) as usize;
        }
        out
    }
}

#[cfg(target_arch = "x86_64")]
impl Level for V3 {
    #[inline(always)]
    fn within8(self, of: &[f32; NODE_CHILDREN], bound: f32) -> u32 {
        let mask = self.cmp_le_f32x8(cast(*of), self.splat_f32x8(bound));
        self.avx._mm256_movemask_ps(cast(mask)) as u32
    }

    #[inline(always)]
    fn within16(self, of: &[f32; BLOCK_PHOTONS], bound: f32) -> u32 {
        let halves: [[f32; 8]; 2] = cast(*of);
        self.within8(&halves[0], bound) | self.within8(&halves[1], bound) << 8
    }

    #[inline(always)]
    fn nonzero16(self, of: &[u32; BLOCK_PHOTONS]) -> u32 {
        // Words are 0 or all ones, or at least have their highest bit set where they are not 0.
        let halves: [[f32; 8]; 2] = cast(*of);
        let half = |i: usize| self.avx._mm256_movemask_ps(cast(halves[i])) as u32;
        half(0) | half(1) << 8
    }

    #[inline(always)]
    fn front(self, lanes: &[u32; BLOCK_PHOTONS], mask: u32) -> [u32; BLOCK_PHOTONS] {
        Portable.front(lanes, mask)
    }
}

#[cfg(target_arch = "x86_64")]
impl Level for V4 {
    #[inline(always)]
    fn within8(self, of: &[f32; NODE_CHILDREN], bound: f32) -> u32 {
        u32::from(self.cmp_le_f32x8(cast(*of), self.splat_f32x8(bound)).0)
    }

    #[inline(always)]
    fn within16(self, of: &[f32; BLOCK_PHOTONS], bound: f32) -> u32 {
        u32::from(self.cmp_le_f32x16(cast(*of), self.splat_f32x16(bound)).0)
    }

    #[inline(always)]
    fn nonzero16(self, of: &[u32; BLOCK_PHOTONS]) -> u32 {
        u32::from(self.cmp_lt_u32x16(self.splat_u32x16(0), cast(*of)).0)
    }

    #[inline(always)]
    fn front(self, lanes: &[u32; BLOCK_PHOTONS], mask: u32) -> [u32; BLOCK_PHOTONS] {
        cast(self.avx512f._mm512_maskz_compress_epi32(mask as u16, cast(*lanes)))
    }
}

/// Squared distances from a point to eight boxes, m². Never more than to any photon in the box as
/// [`photon_distances`] has it: rounding is monotone, and the operations are the same.
#[inline(always)]
pub(super) fn box_distances(node: &MapNode, point: &[f32; 3]) -> [f32; NODE_CHILDREN] {
    let mut square = [[0.0f32; NODE_CHILDREN]; 3];
    for axis in 0..3 {
        for i in 0..NODE_CHILDREN {
            let below = node.min[axis][i] - point[axis];
            let above = point[axis] - node.max[axis][i];
            let away = if below > above { below } else { above };
            let away = if 0.0 > away { 0.0 } else { away };
            square[axis][i] = away * away;
        }
    }
    let mut out = [0.0; NODE_CHILDREN];
    for i in 0..NODE_CHILDREN {
        out[i] = square[0][i] + square[1][i] + square[2][i];
    }
    out
}

/// Ways from a point to sixteen photons, along an axis.
#[inline(always)]
pub(super) fn ways(block: &MapBlock, point: &[f32; 3], axis: usize) -> [f32; BLOCK_PHOTONS] {
    let mut way = [0.0; BLOCK_PHOTONS];
    for i in 0..BLOCK_PHOTONS {
        way[i] = f32::from_bits(block.position_bits[axis][i]) - point[axis];
    }
    way
}

/// Squared distances from a point to sixteen photons, m².
#[inline(always)]
pub(super) fn photon_distances(block: &MapBlock, point: &[f32; 3]) -> [f32; BLOCK_PHOTONS] {
    let (x, y, z) = (ways(block, point, 0), ways(block, point, 1), ways(block, point, 2));
    let mut out = [0.0; BLOCK_PHOTONS];
    for i in 0..BLOCK_PHOTONS {
        out[i] = x[i] * x[i] + y[i] * y[i] + z[i] * z[i];
    }
    out
}
