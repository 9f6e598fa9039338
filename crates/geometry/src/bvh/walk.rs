//! A ray through the hierarchy, nearest box first.

use arrayvec::ArrayVec;
use enf_layout::bvh::{BvhNode, CHILD_INNER, DEPTH, WIDTH};
use pulp::NullaryFnOnce;
#[cfg(target_arch = "x86_64")]
use pulp::{cast, x86::V3};

use super::BvhView;
use crate::mesh::TileMesh;
use crate::query::{Query, nearest_by_force};
use crate::ray::{Hit, PreparedRay};

/// Origins farther out than this many tolerances are beyond what the slab test in `f32` can vouch for: four scenes.
const FAR: f64 = (1u64 << 21) as f64;
/// Directions have at least this component: it keeps products finite, and moves the ray by nothing.
const LEAST: f32 = 1e-25;

/// What the slab test needs of a ray.
#[derive(Clone, Copy)]
struct Slabs {
    origin: [f32; 3],
    inverse: [f32; 3],
    /// Which of the bounds of a node come first along each axis.
    near: [usize; 3],
    far: [usize; 3],
}

impl Slabs {
    #[inline(always)]
    fn new(ray: &PreparedRay) -> Self {
        let d = ray.direction64.map(|x| x as f32);
        let inverse = d.map(|d| 1.0 / if d.abs() < LEAST { LEAST.copysign(d) } else { d });
        let near = [0, 1, 2].map(|i| if inverse[i] < 0.0 { i + 3 } else { i });
        let far = [0, 1, 2].map(|i| if inverse[i] < 0.0 { i } else { i + 3 });
        Self { origin: ray.origin, inverse, near, far }
    }
}

/// How eight boxes are asked.
trait Lanes: Copy {
    /// Which children's boxes overlap `[from, to]` on the ray, and where each is entered.
    fn enter(self, node: &BvhNode, ray: &Slabs, from: f32, to: f32) -> (u32, [f32; WIDTH]);
}

/// In plain Rust.
#[derive(Clone, Copy)]
struct Portable;

#[inline(always)]
fn step(exponent: u8) -> f32 {
    f32::from_bits(u32::from(exponent) << 23)
}

impl Lanes for Portable {
    #[inline(always)]
    fn enter(self, node: &BvhNode, ray: &Slabs, from: f32, to: f32) -> (u32, [f32; WIDTH]) {
        let (mut enter, mut leave) = ([from; WIDTH], [to; WIDTH]);
        for axis in 0..3 {
            let pace = step(node.exponent[axis]) * ray.inverse[axis];
            let base = (node.origin[axis] - ray.origin[axis]) * ray.inverse[axis];
            let (near, far) = (&node.bounds[ray.near[axis]], &node.bounds[ray.far[axis]]);
            for i in 0..WIDTH {
                let (a, b) = (f32::from(near[i]) * pace + base, f32::from(far[i]) * pace + base);
                // As the machine's instructions: the second operand where either is NaN.
                enter[i] = if a > enter[i] { a } else { enter[i] };
                leave[i] = if b < leave[i] { b } else { leave[i] };
            }
        }
        let mut mask = 0;
        for i in 0..WIDTH {
            mask |= u32::from(enter[i] <= leave[i]) << i;
        }
        (mask, enter)
    }
}

#[cfg(target_arch = "x86_64")]
impl Lanes for V3 {
    #[inline(always)]
    fn enter(self, node: &BvhNode, ray: &Slabs, from: f32, to: f32) -> (u32, [f32; WIDTH]) {
        let (avx, avx2, sse2) = (self.avx, self.avx2, self.sse2);
        let mut enter = avx._mm256_set1_ps(from);
        let mut leave = avx._mm256_set1_ps(to);
        for axis in 0..3 {
            let pace = avx._mm256_set1_ps(step(node.exponent[axis]) * ray.inverse[axis]);
            let base = (node.origin[axis] - ray.origin[axis]) * ray.inverse[axis];
            let base = avx._mm256_set1_ps(base);
            let at = |bounds: &[u8; WIDTH]| {
                let bytes = sse2._mm_set_epi64x(0, i64::from_le_bytes(*bounds));
                let floats = avx._mm256_cvtepi32_ps(avx2._mm256_cvtepu8_epi32(bytes));
                avx._mm256_add_ps(avx._mm256_mul_ps(floats, pace), base)
            };
            enter = avx._mm256_max_ps(at(&node.bounds[ray.near[axis]]), enter);
            leave = avx._mm256_min_ps(at(&node.bounds[ray.far[axis]]), leave);
        }
        // 18: less or equal, quiet, false for NaN.
        let mask = avx._mm256_movemask_ps(avx._mm256_cmp_ps::<18>(enter, leave));
        (mask as u32, cast(enter))
    }
}

/// What is still to be visited: where it is entered, and what it is. A leaf has [`LEAF`], its triangles less one
/// from bit 29 on, and its first reference.
#[derive(Clone, Copy)]
struct Entry {
    enter: f32,
    what: u32,
}

const LEAF: u32 = 1 << 31;
const STACK: usize = DEPTH * (WIDTH - 1) + 1;

struct Walk<'q, 'm, L> {
    lanes: L,
    bvh: &'q BvhView<'q>,
    query: Query<'m>,
    ray: &'q PreparedRay,
}

impl<L: Lanes> Walk<'_, '_, L> {
    #[inline(always)]
    fn along<const Z: usize>(self) -> Option<Hit> {
        let Self { lanes, bvh, mut query, ray } = self;
        let slabs = Slabs::new(ray);
        let mut stack = ArrayVec::<Entry, STACK>::new();
        let mut at = Entry { enter: query.t_min, what: 0 };
        loop {
            if at.what & LEAF != 0 {
                let first = (at.what & 0x1fff_ffff) as usize;
                let last = first + ((at.what >> 29) & 3) as usize;
                for &triangle in &bvh.references[first..=last] {
                    query.test::<Z>(ray, triangle);
                }
            } else {
                let node = &bvh.nodes[at.what as usize];
                let (mut mask, enter) = lanes.enter(node, &slabs, query.t_min, query.best.t);
                // What is nothing has no box to miss where nothing can be computed.
                mask &= u32::from(node.used);
                let entry = |i: usize| {
                    let child = u32::from(node.child[i]);
                    let what = if child & u32::from(CHILD_INNER) != 0 {
                        node.nodes + (child & 7)
                    } else {
                        LEAF | (child >> 5) << 29 | (node.references + (child & 31))
                    };
                    Entry { enter: enter[i], what }
                };
                if mask != 0 {
                    // The nearest is next; the others wait, nearest on top.
                    let floor = stack.len();
                    let mut next = entry(mask.trailing_zeros() as usize);
                    mask &= mask - 1;
                    while mask != 0 {
                        let mut other = entry(mask.trailing_zeros() as usize);
                        mask &= mask - 1;
                        if other.enter < next.enter {
                            std::mem::swap(&mut next, &mut other);
                        }
                        let mut place = stack.len();
                        stack.push(other);
                        while place > floor && stack[place - 1].enter < other.enter {
                            stack[place] = stack[place - 1];
                            place -= 1;
                        }
                        stack[place] = other;
                    }
                    at = next;
                    continue;
                }
            }
            loop {
                let Some(entry) = stack.pop() else { return query.answer() };
                at = entry;
                // At the best distance there may be a smaller index.
                if at.enter <= query.best.t {
                    break;
                }
            }
        }
    }
}

impl<L: Lanes> NullaryFnOnce for Walk<'_, '_, L> {
    type Output = Option<Hit>;

    #[inline(always)]
    fn call(self) -> Option<Hit> {
        match self.ray.axis {
            0 => self.along::<0>(),
            1 => self.along::<1>(),
            _ => self.along::<2>(),
        }
    }
}

impl BvhView<'_> {
    /// The canonical hit with the smallest `(t, global)` among those with `t_min <= t < t_max` (m) on
    /// triangles other than `exclude` (global index, or [`crate::NONE`]).
    ///
    /// `mesh` and `delta` are those that the hierarchy was built for. The result is exactly that of
    /// [`nearest_by_force`], on every machine; it takes over for a foreign mesh, a larger `delta`, and origins
    /// beyond four scenes.
    pub fn nearest(
        &self,
        mesh: &TileMesh,
        ray: &PreparedRay,
        t_min: f32,
        t_max: f32,
        exclude: u32,
        delta: f32,
    ) -> Option<Hit> {
        let query = Query::new(mesh, t_min, t_max, exclude, delta);
        match self.asks(&query, ray) {
            Some(false) => nearest_by_force(mesh, ray, t_min, t_max, exclude, delta),
            Some(true) => best_walk(self, query, ray),
            None => None,
        }
    }

    /// [`BvhView::nearest`] without vector instructions beyond the machine's least: for tests, as it must
    /// agree with every other way.
    pub fn nearest_portable(
        &self,
        mesh: &TileMesh,
        ray: &PreparedRay,
        t_min: f32,
        t_max: f32,
        exclude: u32,
        delta: f32,
    ) -> Option<Hit> {
        let query = Query::new(mesh, t_min, t_max, exclude, delta);
        match self.asks(&query, ray) {
            Some(false) => nearest_by_force(mesh, ray, t_min, t_max, exclude, delta),
            Some(true) => Walk { lanes: Portable, bvh: self, query, ray }.call(),
            None => None,
        }
    }

    /// Whether the hierarchy can vouch for its answer to a query; `None` for a ray that hits nothing anyway.
    #[inline(always)]
    fn asks(&self, query: &Query<'_>, ray: &PreparedRay) -> Option<bool> {
        let far = FAR * f64::from(self.header.delta);
        ray.valid.then(|| {
            query.mesh.len() == self.header.triangles
                && query.delta <= self.header.delta
                && ray.origin64.iter().all(|x| x.abs() <= far)
        })
    }
}

/// Walks with the best instructions that the machine has.
#[cfg(target_arch = "x86_64")]
fn best_walk(bvh: &BvhView<'_>, query: Query<'_>, ray: &PreparedRay) -> Option<Hit> {
    match V3::try_new() {
        Some(lanes) => lanes.vectorize(Walk { lanes, bvh, query, ray }),
        None => Walk { lanes: Portable, bvh, query, ray }.call(),
    }
}

/// Walks with the best instructions that the machine has.
#[cfg(not(target_arch = "x86_64"))]
fn best_walk(bvh: &BvhView<'_>, query: Query<'_>, ray: &PreparedRay) -> Option<Hit> {
    Walk { lanes: Portable, bvh, query, ray }.call()
}
