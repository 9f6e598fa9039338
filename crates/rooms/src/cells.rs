//! Cells of the BSP as a thread has them at hand: a leaf's half-spaces side by side, so that a point is held against eight of
//! them at once. The answers are those of [`Bsp::accepts`] and [`Bsp::keeps`].

use glam::DVec3;
use pulp::Simd;

use crate::walk::Bsp;

/// Half-spaces that a cell has room for; a leaf with more of them is asked one by one.
const FACES: usize = 16;
/// They are asked so many at a time. Scalar and vector widths divide it.
const WIDE: usize = 8;
/// Cells at hand; a photon meets few.
const CELLS: usize = 64;
/// No leaf.
const NOBODY: u32 = u32::MAX;

/// The outward half-spaces of a leaf. Those behind the last one hold everything.
#[derive(Clone)]
struct Cell {
    leaf: u32,
    /// Faces in use, rounded up to whole groups; more than [`FACES`] if there is no room for them.
    faces: u32,
    normal: [[f64; FACES]; 3],
    offset: [f64; FACES],
}

impl Cell {
    const EMPTY: Self =
        Self { leaf: NOBODY, faces: 0, normal: [[0.0; FACES]; 3], offset: [f64::MAX; FACES] };

    #[cold]
    #[inline(never)]
    fn fill(&mut self, bsp: &Bsp<'_>, leaf: u32) {
        *self = Self { leaf, ..Self::EMPTY };
        for (i, (normal, offset)) in bsp.outward(leaf).enumerate() {
            self.faces = (i + 1).next_multiple_of(WIDE) as u32;
            if i >= FACES {
                return;
            }
            for (axis, n) in self.normal.iter_mut().zip(normal.to_array()) {
                axis[i] = n;
            }
            self.offset[i] = offset;
        }
    }

    /// The largest over all half-spaces of what `of` makes of normal and offset, from minus infinity on.
    #[inline(always)]
    fn largest<S: Simd>(&self, simd: S, of: impl Fn([S::f64s; 3], S::f64s) -> S::f64s) -> f64 {
        let mut largest = simd.splat_f64s(f64::NEG_INFINITY);
        let [x, y, z] = &self.normal;
        for group in 0..(self.faces as usize).min(FACES) / WIDE {
            let part = group * WIDE..(group + 1) * WIDE;
            let (x, _) = S::as_simd_f64s(&x[part.clone()]);
            let (y, _) = S::as_simd_f64s(&y[part.clone()]);
            let (z, _) = S::as_simd_f64s(&z[part.clone()]);
            let (offset, _) = S::as_simd_f64s(&self.offset[part]);
            for (((&x, &y), &z), &offset) in x.iter().zip(y).zip(z).zip(offset) {
                largest = simd.max_f64s(largest, of([x, y, z], offset));
            }
        }
        simd.reduce_max_f64s(largest)
    }
}

#[inline(always)]
fn dot<S: Simd>(simd: S, a: [S::f64s; 3], b: [S::f64s; 3]) -> S::f64s {
    let xy = simd.add_f64s(simd.mul_f64s(a[0], b[0]), simd.mul_f64s(a[1], b[1]));
    simd.add_f64s(xy, simd.mul_f64s(a[2], b[2]))
}

#[inline(always)]
fn splat<S: Simd>(simd: S, v: DVec3) -> [S::f64s; 3] {
    [simd.splat_f64s(v.x), simd.splat_f64s(v.y), simd.splat_f64s(v.z)]
}

/// Cells that were asked lately. What is kept of one BSP means nothing in another: see [`Cells::clear`].
#[derive(Clone)]
pub struct Cells {
    cells: Vec<Cell>,
}

impl Default for Cells {
    fn default() -> Self {
        Self { cells: vec![Cell::EMPTY; CELLS] }
    }
}

impl Cells {
    /// Bytes that they take.
    pub const BYTES: u64 = (CELLS * size_of::<Cell>()) as u64;

    /// Forgets everything, before another BSP is asked.
    pub fn clear(&mut self) {
        self.cells.iter_mut().for_each(|cell| cell.leaf = NOBODY);
    }

    #[inline(always)]
    fn of(&mut self, bsp: &Bsp<'_>, leaf: u32) -> &Cell {
        let cell = &mut self.cells[leaf as usize % CELLS];
        if cell.leaf != leaf {
            cell.fill(bsp, leaf);
        }
        cell
    }

    /// [`Bsp::accepts`].
    #[inline(always)]
    pub fn accepts<S: Simd>(
        &mut self,
        simd: S,
        bsp: &Bsp<'_>,
        leaf: u32,
        origin: DVec3,
        direction: DVec3,
        t: f32,
    ) -> bool {
        let cell = self.of(bsp, leaf);
        if cell.faces as usize > FACES {
            return bsp.accepts(leaf, origin, direction, t);
        }
        let (o, d) = (splat(simd, origin), splat(simd, direction));
        let (zero, t) = (simd.splat_f64s(0.0), simd.splat_f64s(f64::from(t)));
        let inside = simd.splat_f64s(f64::NEG_INFINITY);
        let farthest = cell.largest(simd, |normal, offset| {
            let sd = dot(simd, normal, d);
            let s = simd.sub_f64s(dot(simd, normal, o), offset);
            let s = simd.add_f64s(s, simd.mul_f64s(t, sd));
            simd.select_f64s(simd.less_than_or_equal_f64s(sd, zero), inside, s)
        });
        farthest < bsp.delta
    }

    /// [`Bsp::keeps`].
    #[inline(always)]
    pub fn keeps<S: Simd>(
        &mut self,
        simd: S,
        bsp: &Bsp<'_>,
        leaf: u32,
        point: DVec3,
        direction: DVec3,
    ) -> bool {
        let cell = self.of(bsp, leaf);
        if cell.faces as usize > FACES {
            return bsp.keeps(leaf, point, direction);
        }
        let (clearly, far) = bsp.kept();
        let (p, d) = (splat(simd, point), splat(simd, direction));
        let (far, away) = (simd.splat_f64s(far), simd.splat_f64s(crate::walk::AWAY));
        let inside = simd.splat_f64s(f64::NEG_INFINITY);
        let outside = simd.splat_f64s(f64::INFINITY);
        let farthest = cell.largest(simd, |normal, offset| {
            let s = simd.sub_f64s(dot(simd, normal, p), offset);
            let leads_away = simd.less_than_f64s(dot(simd, normal, d), away);
            let near = simd.select_f64s(leads_away, s, outside);
            simd.select_f64s(simd.less_than_f64s(s, far), inside, near)
        });
        farthest < clearly
    }
}
