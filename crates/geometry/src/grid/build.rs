//! Choosing the cells, and putting triangles into them.

use enf_layout::sections::{self, Transform};
use glam::DVec3;
use zerocopy::IntoBytes;

use super::{BRICK, BrickRecord, FINER, GridHeader, LARGEST, MAX_BRICKS};
use crate::mesh::TileMesh;

/// Bytes that a grid may take for its table and header and a few bricks.
const FIXED_BYTES: u64 = 4096;
/// Bytes that it may take per triangle.
const BYTES_PER_TRIANGLE: u64 = 64;
/// What one triangle test costs, in cell steps. Measured.
const TEST_COST: f64 = 2.5;
/// What walking through the parts of a divided cell costs, in cell steps. Measured.
const DIVISION_COST: f64 = 40.0;
/// Shorter lists are not worth a thought.
const CROWD: usize = 20;
/// Cells are at least this many tolerances wide, so that inflating them hardly matters.
const MIN_CELL_DELTAS: f64 = 64.0;
/// Most cells along an axis.
const MAX_RESOLUTION: f64 = 4096.0;
/// Rounding allowance of the overlap test, in cells.
const SLACK: f64 = 1.0 / (1u64 << 30) as f64;

/// Bytes that [`build_grid`] never exceeds for a mesh of so many triangles: lowering the resolution
/// keeps it below. Most grids take about half.
pub fn grid_bytes_estimate(triangles: u64) -> u64 {
    FIXED_BYTES.saturating_add(triangles.saturating_mul(BYTES_PER_TRIANGLE))
}

/// Bytes that [`build_grid`] touches at its peak, its result included: the blob, as much again for the
/// lists before they are sorted, and a word per triangle. It reserves once per attempt, and exactly.
pub fn grid_build_bytes(triangles: u64) -> u64 {
    grid_bytes_estimate(triangles).saturating_mul(5) / 2
}

/// Builds the grid of a mesh: a [`sections`] blob for [`super::GridView`]. The bytes depend on the
/// mesh and `delta` (m) alone.
pub fn build_grid(mesh: &TileMesh, delta: f32) -> Vec<u8> {
    let delta = if delta.is_finite() { delta.max(0.0) } else { 0.0 };
    let limit = grid_bytes_estimate(mesh.triangles.len() as u64);
    let plan = Plan::new(mesh, delta);
    let mut cell = plan.best_cell(limit);
    loop {
        let lattice = plan.lattice(cell);
        if let Some(blob) = fill(mesh, &plan, &lattice, limit) {
            return blob;
        }
        // The forecast is an expectation; this mesh was unlucky.
        cell *= 1.25;
    }
}

/// What the mesh looks like from far away.
struct Plan {
    /// The tolerance that the grid is for, m.
    tolerance: f32,
    /// The one that cells are moved out for: with one near the largest number, no cell would be wide enough, and the walk
    /// does not rely on them.
    delta: f32,
    min: [f32; 3],
    max: [f32; 3],
    extent: [f64; 3],
    triangles: f64,
    /// Sum over triangles of their boxes' three edges, m.
    edges: f64,
    /// Sum over triangles of the areas of their three axis projections, m².
    areas: f64,
}

/// Where the cells are.
struct Lattice {
    cell: f32,
    bricks: [u32; 3],
}

impl Plan {
    fn new(mesh: &TileMesh, tolerance: f32) -> Self {
        let delta = if tolerance <= LARGEST { tolerance } else { 0.0 };
        let bounds = mesh.bounds();
        let (mut min, mut max) = ([0.0; 3], [0.0; 3]);
        if !mesh.is_empty() {
            let margin = 4.0 * f64::from(delta);
            let out = |x: f64| x.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32;
            let clamp = |x: f32| x.clamp(f32::MIN, f32::MAX);
            min = bounds.min.to_array().map(|x| clamp(out(f64::from(x) - margin).next_down()));
            max = bounds.max.to_array().map(|x| clamp(out(f64::from(x) + margin).next_up()));
        }
        let extent = std::array::from_fn(|i| f64::from(max[i]) - f64::from(min[i]));
        let (mut edges, mut areas) = (0.0, 0.0);
        for i in 0..mesh.len() {
            let [a, b, c] = mesh.corners(i).map(|p| p.as_dvec3());
            edges += (a.max(b).max(c) - a.min(b).min(c)).element_sum();
            areas += 0.5 * (b - a).cross(c - a).abs().element_sum();
        }
        Self { tolerance, delta, min, max, extent, triangles: mesh.len().into(), edges, areas }
    }

    /// The smallest lattice of such cells that covers the box.
    fn lattice(&self, cell: f64) -> Lattice {
        // Rounded up, so that the count below does cover.
        let cell = (cell.min(f64::from(f32::MAX)) as f32).next_up().min(f32::MAX);
        let brick = f64::from(cell) * f64::from(BRICK);
        // One more in a million, as the sum min + n * brick is rounded as well.
        let bricks = self.extent.map(|e| (e / brick * (1.0 + 1e-6)).ceil().max(1.0) as u32);
        Lattice { cell, bricks }
    }

    /// References that cells of this size will hold. A triangle with a random offset touches
    /// `volume(triangle + cube) / volume(cube)` cells, a Minkowski sum that has three terms.
    fn references(&self, cell: f64) -> f64 {
        let wide = cell + 8.0 * f64::from(self.delta);
        (self.triangles * wide * wide * wide + self.edges * wide * wide + self.areas * wide)
            / (cell * cell * cell)
    }

    /// The cell with the lowest expected cost per metre of ray, among those whose grid fits in
    /// `limit` bytes: a step per cell and a test per reference, both seen without occlusion.
    fn best_cell(&self, limit: u64) -> f64 {
        let longest = self.extent.iter().copied().fold(0.0, f64::max);
        if longest <= 0.0 {
            return 1.0;
        }
        let smallest = (MIN_CELL_DELTAS * f64::from(self.delta)).max(longest / MAX_RESOLUTION);
        let mut best = (f64::INFINITY, longest);
        let mut cell = longest;
        while cell >= smallest {
            let counts = self.extent.map(|e| (e / cell).ceil().max(1.0));
            let cells = counts[0] * counts[1] * counts[2];
            let bricks = counts.iter().map(|&c| (c / f64::from(BRICK)).ceil()).product::<f64>();
            let references = self.references(cell);
            let bytes = 512.0 + 12.0 * bricks + 4.0 * references + 4.0 * references.min(cells);
            let cost = (1.0 + TEST_COST * references / cells) / cell;
            if bricks <= MAX_BRICKS as f64 && bytes <= limit as f64 && cost < best.0 {
                best = (cost, cell);
            }
            cell *= 0.917;
        }
        best.1
    }
}

/// The blob, unless it would be larger than `limit`.
fn fill(mesh: &TileMesh, plan: &Plan, lattice: &Lattice, limit: u64) -> Option<Vec<u8>> {
    let Lattice { cell, bricks: [nx, ny, nz] } = *lattice;
    let brick_count = [nx, ny, nz].iter().map(|&n| u64::from(n)).product::<u64>();
    let room = limit.saturating_sub(512 + 12 * brick_count) / 4;
    if brick_count > MAX_BRICKS {
        return None;
    }
    let mut bricks = vec![0u64; brick_count as usize];

    // Cells touched by each triangle, as brick * 64 + bit. The capacity is the limit: it never grows, and
    // what is not used is never touched.
    let mut keys: Vec<u32> = Vec::with_capacity(room as usize);
    let mut overflow = false;
    let mut ends: Vec<u32> = Vec::with_capacity(mesh.triangles.len());
    let raster = Raster {
        min: DVec3::from_array(plan.min.map(f64::from)),
        cell: f64::from(cell),
        margin: 4.0 * f64::from(plan.delta) / f64::from(cell) + SLACK,
        counts: [nx * BRICK, ny * BRICK, nz * BRICK],
    };
    for i in 0..mesh.len() {
        raster.cells(mesh.corners(i).map(|p| p.as_dvec3()), |x, y, z| {
            let brick = (z / BRICK * ny + y / BRICK) * nx + x / BRICK;
            let bit = x % BRICK + BRICK * (y % BRICK) + BRICK * BRICK * (z % BRICK);
            bricks[brick as usize] |= 1 << bit;
            overflow |= keys.len() as u64 >= room;
            if !overflow {
                keys.push(brick * 64 + bit);
            }
        });
        if overflow {
            return None;
        }
        ends.push(keys.len() as u32);
    }

    let mut lists = Lists::sorted(&bricks, keys, &ends);
    drop(bricks);
    drop(ends);
    let finer = lists.refine(mesh, &raster, [nx, ny, nz], f64::from(plan.delta), limit);
    let outer_references = lists.references.len() as u32;
    lists.starts.pop();
    lists.starts.extend(finer.starts.iter().map(|start| start + outer_references));

    let header = GridHeader {
        min: plan.min,
        max: plan.max,
        cell,
        delta: plan.tolerance,
        bricks: [nx, ny, nz],
        triangles: mesh.len(),
        cells: lists.starts.len() as u32 - 1,
        references: outer_references + finer.references.len() as u32,
    };

    let sections: [([&[u8]; 2], Transform, u32); 4] = [
        ([header.as_bytes(), &[]], Transform::None, 0),
        ([lists.records.as_bytes(), finer.records.as_bytes()], Transform::Xor, 3),
        ([lists.starts.as_bytes(), &[]], Transform::Delta, 1),
        ([lists.references.as_bytes(), finer.references.as_bytes()], Transform::Delta, 1),
    ];
    let lengths = sections.map(|([a, b], ..)| a.len() + b.len());
    let bytes = sections::blob_bytes(&lengths);
    if bytes as u64 > limit {
        return None;
    }
    let mut blob = vec![0; bytes];
    let table: [_; 4] = std::array::from_fn(|i| (lengths[i], sections[i].1, sections[i].2));
    for (range, ([a, b], ..)) in sections::write_table(&mut blob, &table).into_iter().zip(sections)
    {
        let (head, tail) = blob[range].split_at_mut(a.len());
        head.copy_from_slice(a);
        tail.copy_from_slice(b);
    }
    Some(blob)
}

/// Bricks, and the lists of their cells.
struct Lists {
    records: Vec<BrickRecord>,
    /// First reference of each occupied cell, and the end.
    starts: Vec<u32>,
    references: Vec<u32>,
}

impl Lists {
    /// From the cells (brick * 64 + bit) of each triangle, where the next triangle's begin in `ends`.
    fn sorted(bricks: &[u64], mut keys: Vec<u32>, ends: &[u32]) -> Self {
        let mut cells = 0;
        let records: Vec<BrickRecord> =
            bricks.iter().map(|&mask| record(mask, &mut cells)).collect();
        // Counting sort: ends first, then filled from the back, which leaves the beginnings.
        let ordinal = |key: u32| {
            let record = records[(key / 64) as usize];
            record.first + (record.mask() & ((1 << (key % 64)) - 1)).count_ones()
        };
        let mut starts = vec![0; cells as usize + 1];
        for key in &mut keys {
            *key = ordinal(*key);
            starts[*key as usize] += 1;
        }
        let mut total = 0;
        for start in starts.iter_mut() {
            total += *start;
            *start = total;
        }
        let mut references = vec![0; keys.len()];
        for triangle in (0..ends.len()).rev() {
            let begin = if triangle > 0 { ends[triangle - 1] as usize } else { 0 };
            for &key in &keys[begin..ends[triangle] as usize] {
                starts[key as usize] -= 1;
                references[starts[key as usize] as usize] = triangle as u32;
            }
        }
        Self { records, starts, references }
    }

    /// Divides crowded cells of the bricks, `counts` of them along the axes, where that saves a ray work, as long as all of
    /// it stays below `limit` bytes. What they are divided into is returned, the end of its last list included.
    fn refine(
        &mut self,
        mesh: &TileMesh,
        outer: &Raster,
        counts: [u32; 3],
        delta: f64,
        limit: u64,
    ) -> Self {
        let bytes = 12 * self.records.len() + 4 * (self.starts.len() + self.references.len());
        let mut left = (limit / 2).min(limit.saturating_sub(512 + bytes as u64));
        let mut finer = Self {
            records: Vec::new(),
            starts: Vec::new(),
            // What is not used is never touched.
            references: Vec::with_capacity(left as usize / 4),
        };
        let width = outer.cell / f64::from(BRICK);
        if width < MIN_CELL_DELTAS * delta {
            left = 0;
        }
        let mut crowd = Crowd::default();
        // Lists move to the front as others before them shrink.
        let (mut read, mut write) = (0, 0);
        let mut cell = 0;
        let mut cells = self.starts.len() as u32 - 1;
        for (index, brick) in (0u32..).zip(&self.records) {
            let [nx, ny, _] = counts;
            let at = [index % nx, index / nx % ny, index / nx / ny];
            let mut mask = brick.mask();
            while mask != 0 {
                let bit = mask.trailing_zeros();
                mask &= mask - 1;
                let list = read..self.starts[cell + 1] as usize;
                self.starts[cell] = write as u32;
                cell += 1;
                read = list.end;
                if left > 0 && (CROWD..1 << Crowd::INDEX_BITS).contains(&list.len()) {
                    let inside = [bit % BRICK, bit / BRICK % BRICK, bit / BRICK / BRICK];
                    let corner = std::array::from_fn(|i| f64::from(at[i] * BRICK + inside[i]));
                    let raster = Raster {
                        min: outer.min + DVec3::from_array(corner) * outer.cell,
                        cell: width,
                        margin: 4.0 * delta / width + SLACK,
                        counts: [BRICK; 3],
                    };
                    let triangles = &self.references[list.clone()];
                    let mask = crowd.divide(mesh, &raster, triangles);
                    let own = u64::from(mask.count_ones()) + crowd.keys.len() as u64 + 1;
                    if crowd.pays && 12 + 4 * own <= left {
                        left -= 12 + 4 * own;
                        crowd.lists(triangles, &mut finer);
                        self.references[write] =
                            FINER | (self.records.len() + finer.records.len()) as u32;
                        write += 1;
                        finer.records.push(record(mask, &mut cells));
                        continue;
                    }
                }
                self.references.copy_within(list.clone(), write);
                write += list.len();
            }
        }
        self.references.truncate(write);
        finer.starts.push(finer.references.len() as u32);
        finer
    }
}

/// A brick's record, when `cells` are occupied before it; they become those before the next.
fn record(mask: u64, cells: &mut u32) -> BrickRecord {
    let first = *cells;
    *cells += mask.count_ones();
    BrickRecord { mask: [mask as u32, (mask >> 32) as u32], first }
}

/// A crowded cell that is tried in 4 x 4 x 4 parts.
#[derive(Default)]
struct Crowd {
    /// The part, and the place in the cell's list, of each reference.
    keys: Vec<u32>,
    /// A ray has less to do in the parts.
    pays: bool,
}

impl Crowd {
    const INDEX_BITS: u32 = 26;

    /// Finds the references of the parts; returns which are occupied.
    ///
    /// A ray through a convex body meets a convex part of it as often as their surfaces are to each other. So a triangle
    /// is tested as often as the box of its parts says, and not once for all rays through the cell.
    fn divide(&mut self, mesh: &TileMesh, raster: &Raster, triangles: &[u32]) -> u64 {
        self.keys.clear();
        let (mut mask, mut tests) = (0u64, 0u32);
        for (index, &triangle) in (0u32..).zip(triangles) {
            let (mut low, mut high) = ([BRICK; 3], [0; 3]);
            raster.cells(mesh.corners(triangle).map(|p| p.as_dvec3()), |x, y, z| {
                let part = x + BRICK * (y + BRICK * z);
                mask |= 1 << part;
                self.keys.push(part << Self::INDEX_BITS | index);
                for (i, at) in [x, y, z].into_iter().enumerate() {
                    low[i] = low[i].min(at);
                    high[i] = high[i].max(at + 1);
                }
            });
            let [a, b, c] = std::array::from_fn(|i| high[i].saturating_sub(low[i]));
            tests += a * b + b * c + c * a;
        }
        let tests = f64::from(tests) / f64::from(3 * BRICK * BRICK);
        self.pays =
            mask != 0 && DIVISION_COST + TEST_COST * tests < TEST_COST * triangles.len() as f64;
        mask
    }

    /// Appends the lists of the parts.
    fn lists(&mut self, triangles: &[u32], to: &mut Lists) {
        self.keys.sort_unstable();
        for part in self.keys.chunk_by(|a, b| a >> Self::INDEX_BITS == b >> Self::INDEX_BITS) {
            to.starts.push(to.references.len() as u32);
            let index = |key: &u32| (key & ((1 << Self::INDEX_BITS) - 1)) as usize;
            to.references.extend(part.iter().map(|key| triangles[index(key)]));
        }
    }
}

/// Conservative rasterisation: the separating-axis test of a triangle against inflated cells (Schwarz and
/// Seidel 2010, Fast Parallel Surface and Solid Voxelization), solved for `x` along each row.
struct Raster {
    min: DVec3,
    cell: f64,
    /// How far cells are inflated, in cells.
    margin: f64,
    counts: [u32; 3],
}

/// `x * gain + offset >= 0` for the lower corner `x` of a cell, in two other coordinates.
#[derive(Clone, Copy)]
struct HalfPlane {
    a: f64,
    b: f64,
    offset: f64,
}

impl Raster {
    /// Calls `visit(x, y, z)` once for each cell that, inflated, touches the triangle.
    fn cells(&self, corners: [DVec3; 3], mut visit: impl FnMut(u32, u32, u32)) {
        let p = corners.map(|c| (c - self.min) / self.cell);
        let low = p[0].min(p[1]).min(p[2]).to_array();
        let high = p[0].max(p[1]).max(p[2]).to_array();
        let first: [u32; 3] = std::array::from_fn(|i| self.clamp(low[i] - self.margin, i));
        let last: [u32; 3] = std::array::from_fn(|i| self.clamp(high[i] + self.margin, i));
        if first == last {
            return visit(first[0], first[1], first[2]);
        }
        let edges = [p[1] - p[0], p[2] - p[1], p[0] - p[2]];
        let normal = edges[0].cross(edges[1]);

        // For each pair of axes: the three edges' inner half-planes, moved out to the cells' lower
        // corners.
        let side = 1.0 + 2.0 * self.margin;
        let planes = |i: usize, j: usize, facing: f64| -> [HalfPlane; 3] {
            let sign = if facing < 0.0 { -1.0 } else { 1.0 };
            std::array::from_fn(|k| {
                let (a, b) = (-sign * edges[k][j], sign * edges[k][i]);
                let at = a * (p[k][i] + self.margin) + b * (p[k][j] + self.margin);
                HalfPlane { a, b, offset: side * (a.max(0.0) + b.max(0.0)) - at }
            })
        };
        let xy = planes(0, 1, normal.z);
        let yz = planes(1, 2, normal.x);
        let zx = planes(2, 0, normal.y);

        // The triangle's own plane, with what rounding may have done to the normal of a needle.
        let reach = edges[0].abs().max(edges[1].abs()).max(edges[2].abs()).max_element();
        let noise = reach * reach * reach / (1u64 << 46) as f64;
        let base = normal.dot(p[0]) + self.margin * normal.element_sum();
        let far = side * normal.max(DVec3::ZERO).element_sum() - base + noise;
        let near = side * normal.min(DVec3::ZERO).element_sum() - base - noise;

        for z in first[2]..=last[2] {
            let fz = f64::from(z);
            for y in first[1]..=last[1] {
                let fy = f64::from(y);
                if yz.iter().any(|h| h.a * fy + h.b * fz + h.offset < 0.0) {
                    continue;
                }
                let (mut from, mut to) = (f64::from(first[0]), f64::from(last[0]));
                // Keeps the x with gain * x + rest >= 0.
                let mut keep = |gain: f64, rest: f64| {
                    if gain > 0.0 {
                        from = from.max(-rest / gain);
                    } else if gain < 0.0 {
                        to = to.min(-rest / gain);
                    } else if rest < 0.0 {
                        to = f64::NEG_INFINITY;
                    }
                };
                for h in xy {
                    keep(h.a, h.b * fy + h.offset);
                }
                for h in zx {
                    keep(h.b, h.a * fz + h.offset);
                }
                let across = normal.y * fy + normal.z * fz;
                keep(normal.x, across + far);
                keep(-normal.x, -(across + near));
                if from <= to {
                    for x in from.ceil() as u32..=to as u32 {
                        visit(x, y, z);
                    }
                }
            }
        }
    }

    fn clamp(&self, x: f64, axis: usize) -> u32 {
        // The cast saturates.
        (x as u32).min(self.counts[axis] - 1)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    const DELTA: f64 = 1.0 / 1024.0;

    fn raster(margin: f64) -> Raster {
        Raster { min: DVec3::ZERO, cell: 1.0, margin, counts: [16, 16, 12] }
    }

    fn cells(raster: &Raster, corners: [DVec3; 3]) -> BTreeSet<[u32; 3]> {
        let mut out = BTreeSet::new();
        raster.cells(corners, |x, y, z| assert!(out.insert([x, y, z]), "visited twice"));
        out
    }

    /// Coordinates that like to be on, or a hair beside, the planes between cells.
    fn coordinate() -> impl Strategy<Value = f64> {
        let hair = prop_oneof![Just(0.0), Just(DELTA), Just(-DELTA), Just(1e-9), Just(-1e-9)];
        prop_oneof![0.0..12.0f64, (1u32..12, hair).prop_map(|(k, h)| f64::from(k) + h)]
    }

    fn corner() -> impl Strategy<Value = DVec3> {
        (coordinate(), coordinate(), coordinate()).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    proptest! {
        /// What the walk relies on: any point within delta of the triangle lies in a cell that lists it.
        #[test]
        fn points_near_a_triangle_are_in_its_cells(
            a in corner(), b in corner(), c in corner(), flat in 0usize..6, thin in 0usize..3,
            points in proptest::collection::vec(
                (0.0..1.0f64, 0.0..1.0f64, -1i32..2, -1i32..2, -1i32..2), 40),
        ) {
            let (mut b, mut c) = (b, c);
            if flat < 3 {
                b[flat] = a[flat];
                c[flat] = a[flat];
            }
            if thin == 0 {
                c = a + 0.7 * (b - a) + DVec3::splat(1e-7);
            }
            let found = cells(&raster(4.0 * DELTA), [a, b, c]);
            for (s, t, x, y, z) in points {
                let (s, t) = if s + t > 1.0 { (1.0 - s, 1.0 - t) } else { (s, t) };
                let offset = DVec3::new(f64::from(x), f64::from(y), f64::from(z));
                let p = a + s * (b - a) + t * (c - a) + DELTA * offset;
                let cell = [p.x.max(0.0) as u32, p.y.max(0.0) as u32, p.z.max(0.0) as u32];
                prop_assert!(found.contains(&cell.map(|i| i.min(15)))
                    || found.contains(&[cell[0].min(15), cell[1].min(15), cell[2].min(11)]),
                    "{p} in {cell:?}");
            }
        }

        /// No cell is listed for nothing: the expected number is that of the Minkowski sum.
        #[test]
        fn cells_are_as_many_as_the_minkowski_sum_says(
            e in corner(), f in corner(),
        ) {
            let (e, f) = ((e - 6.0) * 0.6, (f - 6.0) * 0.6);
            let mut count = 0;
            // Places of a low-discrepancy sequence (Roberts 2018): a regular lattice would beat with thin triangles.
            // Counts vary by a third at most, so the bound is above 6 standard deviations even of random places.
            let n = 1500;
            for i in 0..n {
                let place = DVec3::new(0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_3);
                let a = DVec3::new(7.5, 7.5, 5.5) + (place * f64::from(i)).fract();
                count += cells(&raster(0.0), [a, a + e, a + f]).len();
            }
            let low = e.min(f).min(DVec3::ZERO);
            let high = e.max(f).max(DVec3::ZERO);
            let area = 0.5 * e.cross(f).abs().element_sum();
            let expected = 1.0 + (high - low).element_sum() + area;
            let mean = f64::from(count as u32) / f64::from(n);
            prop_assert!((mean / expected - 1.0).abs() < 0.06, "{mean} {expected}");
        }
    }
}
