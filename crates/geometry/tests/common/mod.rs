//! Scenes and rays that are out to get us.
#![allow(dead_code, missing_docs, unreachable_pub)]

pub mod closed;
pub mod hard;

use enf_geometry::{
    BvhView, GridView, Hit, Instructions, NONE, Query, Ray, Structure, StructureKind, TileMesh,
    nearest_by_force,
};
use glam::Vec3;

pub const KINDS: [StructureKind; 2] = [StructureKind::Grid, StructureKind::Bvh];

/// A query with an open interval.
pub fn anything(ray: Ray) -> Query {
    Query { ray, t_min: 0.0, t_max: f32::INFINITY, exclude: NONE }
}

/// A structure, ready to be asked.
pub fn complete(kind: StructureKind, mesh: &TileMesh<'_>, delta: f32) -> Vec<u8> {
    let mut blob = kind.build(mesh, delta);
    kind.complete(&mut blob, mesh).unwrap();
    blob
}

/// A mesh and its structures, as bytes.
pub struct Blobs {
    pub mesh: Vec<u8>,
    pub structures: [Vec<u8>; 2],
    pub delta: f32,
}

impl Blobs {
    pub fn new(triangles: &[Corners], delta: f32) -> Self {
        Self::of_mesh(blob(triangles), delta)
    }

    pub fn of_mesh(mesh: Vec<u8>, delta: f32) -> Self {
        let view = TileMesh::from_blob(&mesh).unwrap();
        let structures = KINDS.map(|kind| complete(kind, &view, delta));
        Self { mesh, structures, delta }
    }

    pub fn tile(&self) -> Tile<'_> {
        self.tile_for(self.delta)
    }

    /// For a tolerance not above that of the structures, m.
    pub fn tile_for(&self, delta: f32) -> Tile<'_> {
        let mesh = TileMesh::from_blob(&self.mesh).unwrap();
        let [grid, bvh] = &self.structures;
        Tile {
            mesh,
            delta,
            grid: GridView::from_blob(grid, mesh, delta).unwrap(),
            bvh: BvhView::from_blob(bvh, &mesh, delta).unwrap(),
        }
    }
}

/// A mesh and everybody who can be asked about it.
#[derive(Clone, Copy)]
pub struct Tile<'a> {
    pub mesh: TileMesh<'a>,
    pub delta: f32,
    pub grid: GridView<'a>,
    pub bvh: BvhView<'a>,
}

/// All that counts of a hit, in bits. Two zeros are two answers.
pub fn bits(hit: Option<Hit>) -> Option<[u32; 4]> {
    hit.map(|h| [h.t.to_bits(), h.global, h.u.to_bits(), h.v.to_bits()])
}

impl Tile<'_> {
    pub fn by_force(&self, query: &Query) -> Option<Hit> {
        nearest_by_force(&self.mesh, self.delta, query)
    }

    /// Every way of asking for the nearest hit.
    pub fn ways(&self, query: &Query) -> Vec<(&'static str, Option<Hit>)> {
        let mut ways = vec![
            ("grid", self.grid.nearest(query)),
            ("grid, by its kind", self.structure(StructureKind::Grid).nearest(query)),
            ("hierarchy", self.bvh.nearest(query)),
            ("hierarchy, by its kind", self.structure(StructureKind::Bvh).nearest(query)),
        ];
        ways.extend(levels().map(|(name, level)| (name, self.bvh.nearest_with(level, query))));
        ways
    }

    /// Every way of asking whether there is one.
    pub fn shadows(&self, query: &Query) -> Vec<(&'static str, bool)> {
        let mut ways = vec![
            ("grid", self.grid.occluded(query)),
            ("grid, by its kind", self.structure(StructureKind::Grid).occluded(query)),
            ("hierarchy", self.bvh.occluded(query)),
            ("hierarchy, by its kind", self.structure(StructureKind::Bvh).occluded(query)),
        ];
        ways.extend(levels().map(|(name, level)| (name, self.bvh.occluded_with(level, query))));
        ways
    }

    pub fn structure(&self, kind: StructureKind) -> Structure<'_> {
        match kind {
            StructureKind::Grid => Structure::Grid(self.grid),
            StructureKind::Bvh => Structure::Bvh(self.bvh),
        }
    }

    pub fn batch(&self, queries: &[Query]) -> Vec<Option<Hit>> {
        let mut answers = vec![None; queries.len()];
        self.bvh.nearest_batch(queries, &mut answers);
        answers
    }

    /// Every way of asking must give this answer, to the bit, and know where it keeps the triangle.
    pub fn check(&self, query: &Query, truth: Option<Hit>) {
        for (way, found) in self.ways(query) {
            assert_eq!(bits(found), bits(truth), "{way}: {}", spelt(query));
            let Some(hit) = found else { continue };
            let i = self.mesh.global.binary_search(&hit.global).unwrap();
            let (corners, material) = if way.starts_with("grid") {
                (self.grid.corners(hit.slot), self.grid.material(hit.slot))
            } else {
                (self.bvh.corners(hit.slot), self.bvh.material(hit.slot))
            };
            assert_eq!(corners, self.mesh.corners(i as u32), "{way}: {}", spelt(query));
            assert_eq!(material, self.mesh.materials[i], "{way}: {}", spelt(query));
        }
        for (way, found) in self.shadows(query) {
            assert_eq!(found, truth.is_some(), "shadow, {way}: {}", spelt(query));
        }
    }

    /// All at once must give these answers.
    pub fn check_batch(&self, queries: &[Query], truths: &[Option<Hit>]) {
        assert_eq!(queries.len(), truths.len());
        // What was in the answers before is not to matter.
        let old = Some(Hit { t: 1.0, global: 77, u: 0.0, v: 0.0, slot: 0 });
        let check = |way: &str, ask: &dyn Fn(&mut [Option<Hit>]), shadow: &dyn Fn(&mut [bool])| {
            let mut found = vec![old; queries.len()];
            ask(&mut found);
            let mut dark: Vec<bool> = truths.iter().map(Option::is_none).collect();
            shadow(&mut dark);
            for (i, query) in queries.iter().enumerate() {
                assert_eq!(bits(found[i]), bits(truths[i]), "batch, {way}: {}", spelt(query));
                assert_eq!(dark[i], truths[i].is_some(), "batch, {way}: {}", spelt(query));
            }
        };
        for (name, level) in levels() {
            let ask = |out: &mut [Option<Hit>]| self.bvh.nearest_batch_with(level, queries, out);
            let shadow = |out: &mut [bool]| self.bvh.occluded_batch_with(level, queries, out);
            check(name, &ask, &shadow);
        }
        for kind in KINDS {
            let structure = self.structure(kind);
            let ask = |out: &mut [Option<Hit>]| structure.nearest_batch(queries, out);
            let shadow = |out: &mut [bool]| structure.occluded_batch(queries, out);
            check(structure_name(kind), &ask, &shadow);
        }
    }
}

/// The sets of instructions that this machine has.
pub fn levels() -> impl Iterator<Item = (&'static str, Instructions)> {
    let name = |level| match level {
        Instructions::Portable => ("hierarchy, portable", level),
        Instructions::Avx2 => ("hierarchy, AVX2", level),
        Instructions::Avx512 => ("hierarchy, AVX-512", level),
    };
    Instructions::ALL.into_iter().filter(|level| level.available()).map(name)
}

fn structure_name(kind: StructureKind) -> &'static str {
    match kind {
        StructureKind::Grid => "grid, by its kind",
        StructureKind::Bvh => "hierarchy, by its kind",
    }
}

/// Asks a hierarchy in all ways, whatever comes of it.
pub fn exercise(bvh: &BvhView<'_>, queries: &[Query]) {
    for (_, level) in levels() {
        for query in queries {
            bvh.nearest_with(level, query);
            bvh.occluded_with(level, query);
        }
        bvh.nearest_batch_with(level, queries, &mut vec![None; queries.len()]);
        bvh.occluded_batch_with(level, queries, &mut vec![false; queries.len()]);
    }
}

/// A query that can be typed in again.
pub fn spelt(query: &Query) -> String {
    let hex = |p: Vec3| p.to_array().map(|x| format!("{:#010x}", x.to_bits())).join(", ");
    let Query { ray, t_min, t_max, exclude } = query;
    format!(
        "origin {} ({}), direction {} ({}), t from {t_min} ({:#010x}) to {t_max} ({:#010x}), not {exclude}",
        ray.origin,
        hex(ray.origin),
        ray.direction,
        hex(ray.direction),
        t_min.to_bits(),
        t_max.to_bits()
    )
}

/// splitmix64
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }

    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Between the origin and `size`.
    pub fn in_box(&mut self, size: Vec3) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit()) * size
    }

    /// In `[-1, 1)` cubed.
    pub fn cube(&mut self) -> Vec3 {
        2.0 * Vec3::new(self.unit(), self.unit(), self.unit()) - 1.0
    }

    pub fn direction(&mut self) -> Vec3 {
        loop {
            let p = self.cube();
            let square = p.length_squared();
            if square > 1e-3 && square < 1.0 {
                return p / square.sqrt();
            }
        }
    }
}

pub type Corners = [Vec3; 3];

pub fn blob(triangles: &[Corners]) -> Vec<u8> {
    TileMesh::build_blob(
        triangles
            .iter()
            .enumerate()
            .map(|(i, t)| (3 * i as u32 + 1, i as u32 % 5, t.map(|p| p.to_array()))),
    )
}

/// Triangles in a box of +-`size`: ordinary, tiny, slivers, needles, axis-parallel, coplanar twins, without
/// area.
pub fn zoo(random: &mut Random, count: usize, size: f32) -> Vec<Corners> {
    let mut out: Vec<Corners> = Vec::new();
    while out.len() < count {
        let a = size * random.cube();
        let triangle = match random.below(9) {
            0 => [a, size * random.cube(), size * random.cube()],
            1 => [a, a + 0.01 * size * random.cube(), a + 0.01 * size * random.cube()],
            2 => {
                let b = size * random.cube();
                [a, b, 0.5 * (a + b) + 1e-5 * size * random.cube()]
            }
            3 => {
                let b = size * random.cube();
                [a, b, b + 1e-6 * size * random.cube()]
            }
            4 => {
                let (mut b, mut c) =
                    (a + 0.2 * size * random.cube(), a + 0.2 * size * random.cube());
                let axis = random.below(3);
                b[axis] = a[axis];
                c[axis] = a[axis];
                [a, b, c]
            }
            5 if !out.is_empty() => out[random.below(out.len())],
            6 if !out.is_empty() => {
                // Shares an edge with another.
                let [p, q, _] = out[random.below(out.len())];
                [q, p, p + 0.3 * size * random.cube()]
            }
            7 => [a, a, size * random.cube()],
            _ => [a, a + 0.2 * size * random.cube(), a + 0.2 * size * random.cube()],
        };
        out.push(triangle);
    }
    out
}

/// A ray: anywhere, axis-parallel, aimed at a vertex, an edge or along a triangle's plane, from inside or
/// outside.
pub fn ray(random: &mut Random, triangles: &[Corners], size: f32) -> Ray {
    let reach = if random.below(4) == 0 { 4.0 } else { 1.0 };
    let mut origin = reach * size * random.cube();
    let [a, b, c] = triangles[random.below(triangles.len())];
    let s = random.unit();
    let edge = a + s * (b - a);
    let toward = |p: Vec3, o: Vec3| (p - o).try_normalize().unwrap_or(Vec3::X);
    let direction = match random.below(7) {
        0 => toward(a, origin),
        1 => toward(edge, origin),
        2 => {
            // In the plane, or nearly so.
            origin = edge + 2.0 * (c - b) + 1e-6 * size * random.cube();
            toward(c + random.unit() * (a - c), origin)
        }
        3 => {
            let mut d = Vec3::ZERO;
            d[random.below(3)] = if random.below(2) == 0 { 1.0 } else { -1.0 };
            let target = if random.below(2) == 0 { a } else { edge };
            for i in 0..3 {
                if d[i] == 0.0 {
                    origin[i] = target[i];
                }
            }
            d
        }
        4 => {
            let mut d = random.direction();
            d[random.below(3)] = if random.below(2) == 0 { 0.0 } else { 1e-30 };
            d.normalize()
        }
        5 => {
            origin = edge;
            random.direction()
        }
        _ => random.direction(),
    };
    Ray { origin, direction }
}

/// `2^-19` of the next power of two.
pub fn delta(size: f32) -> f32 {
    let mut m = 1.0;
    while m < 3.5 * size {
        m *= 2.0;
    }
    while m > 7.0 * size {
        m *= 0.5;
    }
    m / (1 << 19) as f32
}
