//! How eight boxes are asked, with the instructions that a machine has.

use arrayvec::ArrayVec;
use enf_layout::bvh::{BvhNode, CHILD_INNER, DEPTH, WIDTH};
#[cfg(target_arch = "x86_64")]
use pulp::{
    cast,
    x86::{V3, V4},
};
#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::{__m128, __m256, __m256i};

use crate::ray::PreparedRay;

/// Directions have at least this component: it keeps products finite, and moves the ray by nothing.
const LEAST: f32 = 1e-25;

/// In an entry: an inner node, whose index has the lower bits. Others are leaves: their triangles less one
/// from bit 29 on, and their block.
pub(super) const INNER: u32 = 1 << 31;
/// In an entry of a leaf: where the number of triangles less one is.
pub(super) const COUNT_SHIFT: u32 = 29;
/// In an entry of a leaf: the bits of its block.
pub(super) const BLOCK: u32 = (1 << COUNT_SHIFT) - 1;
/// No entry: the inner node that no hierarchy has.
pub(super) const NOTHING: u32 = u32::MAX;
/// Entries of a stack that is always large enough.
pub(super) const STACK: usize = DEPTH * (WIDTH - 1) + 2 * WIDTH;

/// Sets of instructions, the least first. Hits do not depend on them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instructions {
    /// What every machine has.
    Portable,
    /// AVX2 and FMA (x86-64-v3).
    Avx2,
    /// AVX-512 F, BW, CD, DQ and VL (x86-64-v4).
    Avx512,
}

impl Instructions {
    /// All sets.
    pub const ALL: [Self; 3] = [Self::Portable, Self::Avx2, Self::Avx512];

    /// Whether this machine has them. Where it does not, lesser ones are used.
    pub fn available(self) -> bool {
        match (self, self.token()) {
            (Self::Portable, _) => true,
            (_, Token::Portable(_)) => false,
            #[cfg(target_arch = "x86_64")]
            (Self::Avx2, _) => true,
            #[cfg(target_arch = "x86_64")]
            (Self::Avx512, token) => matches!(token, Token::Avx512(_)),
        }
    }

    /// The best that there are.
    #[inline(always)]
    pub fn best() -> Self {
        Self::Avx512
    }

    #[inline(always)]
    pub(super) fn token(self) -> Token {
        #[cfg(target_arch = "x86_64")]
        {
            if self == Self::Avx512
                && let Some(level) = V4::try_new()
            {
                return Token::Avx512(level);
            }
            if self != Self::Portable
                && let Some(level) = V3::try_new()
            {
                return Token::Avx2(level);
            }
        }
        Token::Portable(Portable)
    }
}

/// The proof that a machine has certain instructions.
#[derive(Clone, Copy)]
pub(super) enum Token {
    #[cfg(target_arch = "x86_64")]
    Avx512(V4),
    #[cfg(target_arch = "x86_64")]
    Avx2(V3),
    Portable(Portable),
}

/// What is still to be visited: where it is entered, and what it is. At the bottom lie seven entries that are never
/// taken and one that always is and ends the walk, so that eight can be looked at, always.
pub(super) struct Stack {
    enter: ArrayVec<f32, STACK>,
    what: ArrayVec<u32, STACK>,
}

const BOTTOM: [f32; WIDTH] = {
    let mut bottom = [f32::INFINITY; WIDTH];
    bottom[WIDTH - 1] = f32::NEG_INFINITY;
    bottom
};

impl Stack {
    #[inline(always)]
    pub(super) fn new() -> Self {
        let mut stack = Self { enter: ArrayVec::new(), what: ArrayVec::new() };
        stack.push(BOTTOM, [NOTHING; WIDTH], WIDTH);
        stack
    }

    /// The first `count` of eight entries.
    #[inline(always)]
    fn push(&mut self, enter: [f32; WIDTH], what: [u32; WIDTH], count: usize) {
        // Hierarchies are checked to be no deeper than the stack has room for.
        let len = self.enter.len() + count;
        if self.enter.try_extend_from_slice(&enter).is_ok()
            && self.what.try_extend_from_slice(&what).is_ok()
        {
            self.enter.truncate(len);
            self.what.truncate(len);
        }
    }

    /// The last eight distances.
    #[inline(always)]
    fn top(&self) -> [f32; WIDTH] {
        *self.enter.last_chunk().unwrap_or(&BOTTOM)
    }

    /// Takes so many entries away; the last of them is the answer.
    #[inline(always)]
    fn take(&mut self, count: usize) -> u32 {
        let len = self.enter.len() - count;
        let what = self.what[len];
        self.enter.truncate(len);
        self.what.truncate(len);
        what
    }
}

/// A ray as boxes see it, and eight boxes at once.
pub(super) trait Level: Copy {
    /// What the slab test needs of a ray.
    type Ray: Copy;

    fn boxes(self, ray: &PreparedRay) -> Self::Ray;

    /// All children whose boxes overlap `[from, to]` on the ray: where they are entered, what they are, and how many,
    /// in the order of the ray's signs, the first one last.
    fn open_all(
        self,
        node: &BvhNode,
        ray: &Self::Ray,
        from: f32,
        to: f32,
    ) -> ([f32; WIDTH], [u32; WIDTH], u32);

    /// Which of eight distances are not beyond `to`, a bit each.
    fn begun(self, enter: &[f32; WIDTH], to: f32) -> u32;

    /// The first of the children that [`Level::open_all`] finds, or [`NOTHING`]; the others go to the stack.
    #[inline(always)]
    fn open(self, node: &BvhNode, ray: &Self::Ray, from: f32, to: f32, stack: &mut Stack) -> u32 {
        let (enter, what, count) = self.open_all(node, ray, from, to);
        if count == 0 {
            return NOTHING;
        }
        let first = count as usize - 1;
        stack.push(enter, what, first);
        what[first & (WIDTH - 1)]
    }

    /// Takes the last entry that begins at `to` or before; those after it go with it.
    #[inline(always)]
    fn pop(self, stack: &mut Stack, to: f32) -> u32 {
        loop {
            let open = self.begun(&stack.top(), to);
            // The topmost is the highest bit.
            if open != 0 {
                return stack.take((open << 24).leading_zeros() as usize + 1);
            }
            stack.take(WIDTH);
        }
    }
}

/// A child as an entry.
#[inline(always)]
fn entry(node: &BvhNode, slot: usize) -> u32 {
    let child = u32::from(node.child[slot]);
    let base = if child & u32::from(CHILD_INNER) != 0 { node.nodes } else { node.blocks };
    (child << 24 & 0xe000_0000) + (child & 7) + base
}

#[inline(always)]
fn inverse(ray: &PreparedRay) -> [f32; 3] {
    let [x, y, z] = ray.direction;
    [one_over(x), one_over(y), one_over(z)]
}

#[inline(always)]
fn one_over(d: f32) -> f32 {
    1.0 / if d.abs() < LEAST { LEAST.copysign(d) } else { d }
}

/// In plain Rust.
#[derive(Clone, Copy)]
pub(super) struct Portable;

#[derive(Clone, Copy)]
pub(super) struct PortableRay {
    origin: [f32; 3],
    inverse: [f32; 3],
    /// Where the bounds are that come first along each axis.
    near: [usize; 3],
    /// The axes along which the direction is negative, a bit each.
    signs: usize,
}

impl Level for Portable {
    type Ray = PortableRay;

    fn boxes(self, ray: &PreparedRay) -> PortableRay {
        let inverse = inverse(ray);
        let near = inverse.map(|i| if i < 0.0 { WIDTH } else { 0 });
        let signs = (near[0] + 2 * near[1] + 4 * near[2]) / WIDTH;
        PortableRay { origin: ray.origin, inverse, near, signs }
    }

    #[inline(always)]
    fn open_all(
        self,
        node: &BvhNode,
        ray: &PortableRay,
        from: f32,
        to: f32,
    ) -> ([f32; WIDTH], [u32; WIDTH], u32) {
        let (mut near_ends, mut far_ends) = ([from; WIDTH], [to; WIDTH]);
        for axis in 0..3 {
            let pace = node.step[axis] * ray.inverse[axis];
            let base = (node.origin[axis] - ray.origin[axis]) * ray.inverse[axis];
            let near = ray.near[axis];
            for i in 0..WIDTH {
                let at = |q: u8| f32::from(q) * pace + base;
                let a = at(node.bounds[axis][i + near]);
                let b = at(node.bounds[axis][i + (WIDTH - near)]);
                // As the machine's instructions: the second operand where either is NaN.
                near_ends[i] = if a > near_ends[i] { a } else { near_ends[i] };
                far_ends[i] = if b < far_ends[i] { b } else { far_ends[i] };
            }
        }
        let mut mask = 0;
        for i in 0..WIDTH {
            mask |= u32::from(near_ends[i] <= far_ends[i]) << i;
        }
        mask &= node.used;
        let (mut enter, mut what, mut count) = ([from; WIDTH], [NOTHING; WIDTH], 0);
        for i in (0..WIDTH).rev() {
            let slot = i ^ ray.signs;
            if mask >> slot & 1 != 0 {
                enter[count] = near_ends[slot];
                what[count] = entry(node, slot);
                count += 1;
            }
        }
        (enter, what, count as u32)
    }

    #[inline(always)]
    fn begun(self, enter: &[f32; WIDTH], to: f32) -> u32 {
        let mut mask = 0;
        for (i, e) in enter.iter().enumerate() {
            mask |= u32::from(*e <= to) << i;
        }
        mask
    }
}

#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
pub(super) struct VectorRay {
    origin: __m128,
    inverse: __m128,
    /// Which bytes of an axis' bounds become the near ends, and which the far ends; children in the order of the ray's
    /// signs, the first one last.
    order: &'static Order,
}

#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn vector_ray(simd: V3, ray: &PreparedRay) -> VectorRay {
    let [x, y, z] = ray.origin;
    let [u, v, w] = inverse(ray);
    let backward = [u < 0.0, v < 0.0, w < 0.0];
    let signs =
        usize::from(backward[0]) | usize::from(backward[1]) << 1 | usize::from(backward[2]) << 2;
    VectorRay {
        origin: simd.sse._mm_setr_ps(x, y, z, 0.0),
        inverse: simd.sse._mm_setr_ps(u, v, w, 0.0),
        order: &ORDERS[signs],
    }
}

/// The order in which rays with certain signs see the slots of a node, as arguments of shuffles.
#[cfg(target_arch = "x86_64")]
#[repr(C, align(32))]
struct Order {
    near: [[u8; 32]; 3],
    far: [[u8; 32]; 3],
    child: [u8; 16],
}

/// For rays whose direction is negative along the axes whose bits are set. The lane of slot `s` is `7 - (s ^ signs)`: the
/// slot that is reached first is in the last lane.
#[cfg(target_arch = "x86_64")]
static ORDERS: [Order; 8] = {
    // 128 makes a zero byte.
    const NONE: Order = Order { near: [[128; 32]; 3], far: [[128; 32]; 3], child: [128; 16] };
    let mut orders = [NONE; 8];
    let mut signs = 0;
    while signs < 8 {
        let mut lane = 0;
        while lane < 8 {
            let slot = (7 - lane) ^ signs;
            let mut axis = 0;
            while axis < 3 {
                let (low, high) = (slot as u8, (slot + WIDTH) as u8);
                let backward = signs >> axis & 1 != 0;
                orders[signs].near[axis][4 * lane] = if backward { high } else { low };
                orders[signs].far[axis][4 * lane] = if backward { low } else { high };
                axis += 1;
            }
            orders[signs].child[lane] = slot as u8;
            lane += 1;
        }
        signs += 1;
    }
    orders
};

/// The ends of eight boxes along an axis as distances.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn ends(simd: V3, bytes: __m256i, which: __m256i, pace: __m256, base: __m256) -> __m256 {
    let q = simd.avx._mm256_cvtepi32_ps(simd.avx2._mm256_shuffle_epi8(bytes, which));
    // Fused or not is all the same to boxes: they are generous.
    simd.fma._mm256_fmadd_ps(q, pace, base)
}

/// Where the eight boxes are entered, where they are left.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn slabs(simd: V3, node: &BvhNode, ray: &VectorRay, from: f32, to: f32) -> (__m256, __m256) {
    let (avx, avx2, sse) = (simd.avx, simd.avx2, simd.sse);
    let ([x, y, z], [u, v, w]) = (node.origin, node.step);
    let pace = sse._mm_mul_ps(sse._mm_setr_ps(u, v, w, 0.0), ray.inverse);
    let base = sse._mm_sub_ps(sse._mm_setr_ps(x, y, z, 0.0), ray.origin);
    let base = sse._mm_mul_ps(base, ray.inverse);
    let bytes = |axis: usize| avx2._mm256_broadcastsi128_si256(cast(node.bounds[axis]));
    let (px, bx) = (lane::<0x00>(simd, pace), lane::<0x00>(simd, base));
    let (py, by) = (lane::<0x55>(simd, pace), lane::<0x55>(simd, base));
    let (pz, bz) = (lane::<0xaa>(simd, pace), lane::<0xaa>(simd, base));
    let q = bytes(0);
    let (near_x, far_x) = (
        ends(simd, q, cast(ray.order.near[0]), px, bx),
        ends(simd, q, cast(ray.order.far[0]), px, bx),
    );
    let q = bytes(1);
    let (near_y, far_y) = (
        ends(simd, q, cast(ray.order.near[1]), py, by),
        ends(simd, q, cast(ray.order.far[1]), py, by),
    );
    let q = bytes(2);
    let (near_z, far_z) = (
        ends(simd, q, cast(ray.order.near[2]), pz, bz),
        ends(simd, q, cast(ray.order.far[2]), pz, bz),
    );
    // The second operand where either is NaN.
    let (from, to) = (avx._mm256_set1_ps(from), avx._mm256_set1_ps(to));
    let (enter_x, leave_x) = (avx._mm256_max_ps(near_x, from), avx._mm256_min_ps(far_x, to));
    let (enter_y, leave_y) = (avx._mm256_max_ps(near_y, from), avx._mm256_min_ps(far_y, to));
    let (enter_z, leave_z) = (avx._mm256_max_ps(near_z, from), avx._mm256_min_ps(far_z, to));
    let enter = avx._mm256_max_ps(avx._mm256_max_ps(enter_x, enter_y), enter_z);
    let leave = avx._mm256_min_ps(avx._mm256_min_ps(leave_x, leave_y), leave_z);
    (enter, leave)
}

#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn lane<const CONTROL: i32>(simd: V3, of: __m128) -> __m256 {
    simd.avx2._mm256_broadcastss_ps(simd.sse._mm_shuffle_ps::<CONTROL>(of, of))
}

/// All children as entries, in the ray's order.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn entries(simd: V3, node: &BvhNode, ray: &VectorRay) -> __m256i {
    let (avx, avx2) = (simd.avx, simd.avx2);
    let child = simd.sse2._mm_set_epi64x(0, i64::from_le_bytes(node.child));
    let child = simd.ssse3._mm_shuffle_epi8(child, cast(ray.order.child));
    let child = avx2._mm256_cvtepu8_epi32(child);
    let top = avx2._mm256_slli_epi32::<24>(child);
    let nodes = avx._mm256_set1_epi32(node.nodes as i32);
    let blocks = avx._mm256_set1_epi32(node.blocks as i32);
    let base: __m256i = cast(avx._mm256_blendv_ps(cast(blocks), cast(nodes), cast(top)));
    let kind = avx2._mm256_and_si256(top, avx._mm256_set1_epi32(0xe000_0000_u32 as i32));
    let low = avx2._mm256_and_si256(child, avx._mm256_set1_epi32(7));
    avx2._mm256_add_epi32(avx2._mm256_or_si256(kind, low), base)
}

/// What AVX2 and AVX-512 do each in their own way.
#[cfg(target_arch = "x86_64")]
trait Vector: Copy {
    fn v3(self) -> V3;

    /// The lanes whose bits are set, moved to the front.
    fn keep(self, mask: u32, lanes: __m256i) -> [u32; WIDTH];
}

#[cfg(target_arch = "x86_64")]
impl Vector for V4 {
    #[inline(always)]
    fn v3(self) -> V3 {
        *self
    }

    #[inline(always)]
    fn keep(self, mask: u32, lanes: __m256i) -> [u32; WIDTH] {
        cast(self.avx512f._mm256_maskz_compress_epi32(mask as u8, lanes))
    }
}

/// For each mask, which lanes it keeps, in order.
#[cfg(target_arch = "x86_64")]
static KEPT: [u64; 256] = {
    let mut table = [0; 256];
    let mut mask = 0;
    while mask < 256 {
        let (mut lane, mut at) = (0, 0);
        while lane < 8 {
            if mask >> lane & 1 != 0 {
                table[mask] |= (lane as u64) << (8 * at);
                at += 1;
            }
            lane += 1;
        }
        mask += 1;
    }
    table
};

#[cfg(target_arch = "x86_64")]
impl Vector for V3 {
    #[inline(always)]
    fn v3(self) -> V3 {
        self
    }

    #[inline(always)]
    fn keep(self, mask: u32, lanes: __m256i) -> [u32; WIDTH] {
        let kept = self.sse2._mm_set_epi64x(0, KEPT[(mask & 255) as usize] as i64);
        let kept = self.avx2._mm256_cvtepu8_epi32(kept);
        cast(self.avx2._mm256_permutevar8x32_epi32(lanes, kept))
    }
}

#[cfg(target_arch = "x86_64")]
impl<V: Vector> Level for V {
    type Ray = VectorRay;

    #[inline(always)]
    fn boxes(self, ray: &PreparedRay) -> VectorRay {
        vector_ray(self.v3(), ray)
    }

    #[inline(always)]
    fn open_all(
        self,
        node: &BvhNode,
        ray: &VectorRay,
        from: f32,
        to: f32,
    ) -> ([f32; WIDTH], [u32; WIDTH], u32) {
        let simd = self.v3();
        let (enter, leave) = slabs(simd, node, ray, from, to);
        // 18: less or equal, quiet, false for NaN.
        let overlap = simd.avx._mm256_cmp_ps::<18>(enter, leave);
        let mask = simd.avx._mm256_movemask_ps(overlap) as u32;
        let enter: [u32; WIDTH] = self.keep(mask, cast(enter));
        (cast(enter), self.keep(mask, entries(simd, node, ray)), mask.count_ones())
    }

    #[inline(always)]
    fn begun(self, enter: &[f32; WIDTH], to: f32) -> u32 {
        let avx = self.v3().avx;
        let begun = avx._mm256_cmp_ps::<18>(cast(*enter), avx._mm256_set1_ps(to));
        avx._mm256_movemask_ps(begun) as u32
    }
}
