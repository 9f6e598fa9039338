//! A ray's flight across tiles against brute force: whatever the rooms and tiles, the first hit is the nearest of
//! all triangles of the scene, to the bit, slivers and grazing rays included.

use enf_geometry::{Query, Ray, Structure, StructureKind, TileMesh, nearest_by_force};
use enf_layout::NONE;
use enf_layout::transit::TransitRecord;
use enf_rooms::{Bsp, Options, RoomCount, Tables, TileLimit, partition};
use enf_transport::flight::{Flight, Resident, fly};
use enf_transport::rng::{self, Purpose};
use enf_transport::vector;
use glam::Vec3;

type Triangle = [[f32; 3]; 3];

/// Numbers for one test scene.
struct Dice(u32, u32);

impl Dice {
    fn next(&mut self) -> [f32; 4] {
        self.1 += 1;
        rng::uniforms(77, Purpose::Probe, self.0, self.1, 0, 0)
    }

    fn point(&mut self, scale: f32) -> Vec3 {
        let [x, y, z, _] = self.next();
        Vec3::new(x, y, z) * scale
    }
}

/// Walls in planes that the partition will split along, two-sheet walls with a doorway, random triangles, and needles:
/// long slivers that f32 intersection gets wrong by metres.
fn scene(seed: u32) -> (Vec<Triangle>, Dice) {
    let mut dice = Dice(seed, 0);
    let mut triangles: Vec<Triangle> = Vec::new();
    let mut quad = |a: [f32; 3], b: [f32; 3], c: [f32; 3], d: [f32; 3]| {
        triangles.push([a, b, c]);
        triangles.push([a, c, d]);
    };
    for x in [0.0f32, 4.0, 4.2, 8.0] {
        let gap = x == 4.0 || x == 4.2;
        let end = if gap { 1.5 } else { 4.0 };
        quad([x, 0., 0.], [x, end, 0.], [x, end, 3.], [x, 0., 3.]);
        if gap {
            quad([x, 2.4, 0.], [x, 4., 0.], [x, 4., 3.], [x, 2.4, 3.]);
        }
    }
    for y in [0.0f32, 4.0] {
        quad([0., y, 0.], [8., y, 0.], [8., y, 3.], [0., y, 3.]);
    }
    for z in [0.0f32, 3.0] {
        quad([0., 0., z], [8., 0., z], [8., 4., z], [0., 4., z]);
    }
    for _ in 0..60 {
        let p = dice.point(1.0) * Vec3::new(8.0, 4.0, 3.0);
        let (a, b) = (dice.point(1.0) - 0.5, dice.point(1.0) - 0.5);
        triangles.push([p, p + a * 0.7, p + b * 0.7].map(|v| v.to_array()));
    }
    for _ in 0..30 {
        let p = dice.point(1.0) * Vec3::new(8.0, 4.0, 3.0);
        let along = (dice.point(1.0) - 0.5) * 5.0;
        let across = (dice.point(1.0) - 0.5) * 1e-4;
        triangles.push([p, p + along, p + along * 0.5 + across].map(|v| v.to_array()));
    }
    (triangles, dice)
}

/// A scene cut into tiles, each with its mesh and grid.
struct Cut {
    tables: Tables,
    tiles: Vec<(Vec<u8>, StructureKind, Vec<u8>)>,
    delta: f32,
}

fn cut(triangles: &[Triangle], rooms: RoomCount, limit: TileLimit) -> Cut {
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for corner in triangles.iter().flatten() {
        for c in 0..3 {
            min[c] = min[c].min(corner[c]);
            max[c] = max[c].max(corner[c]);
        }
    }
    let delta = 16.0 * 2f32.powi(-19);
    let options = Options { delta, bounds_min: min, bounds_max: max, rooms, hints: Vec::new() };
    let mut parts = partition(triangles, &|_| true, &options).expect("a sound scene");
    parts.cut_tiles(triangles, limit).expect("it can be cut");
    let tables = parts.finish(triangles);
    let tiles = (0..tables.tiles.len())
        .map(|tile| {
            let list = tables.tile_offsets[tile] as usize..tables.tile_offsets[tile + 1] as usize;
            let mesh = TileMesh::build_blob(
                tables.tile_triangles[list].iter().map(|&g| (g, 0, triangles[g as usize])),
            );
            // Every other tile has the other structure: to a ray they are the same.
            let view = TileMesh::from_blob(&mesh).expect("a mesh");
            let kind = if tile % 2 == 0 { StructureKind::Bvh } else { StructureKind::Grid };
            let mut blob = kind.build(&view, delta);
            kind.complete(&mut blob, &view).expect("of this mesh");
            (mesh, kind, blob)
        })
        .collect();
    Cut { tables, tiles, delta }
}

/// Distance and global index of the first hit, flying from tile to tile.
fn first_hit(cut: &Cut, ray: &Ray) -> Option<(u32, u32)> {
    let t = &cut.tables;
    let bsp =
        Bsp::new(&t.planes, &t.nodes, &t.leaves, &t.faces, f64::from(cut.delta)).expect("a tree");
    let mut record = TransitRecord {
        origin: ray.origin.to_array(),
        direction: ray.direction.to_array(),
        leaf: bsp.locate_towards(ray.origin.as_dvec3(), ray.direction.as_dvec3()),
        last_triangle: NONE,
        ..TransitRecord::default()
    };
    for _ in 0..10_000 {
        let tile = bsp.leaves[record.leaf as usize].tile;
        let (mesh, kind, blob) = &cut.tiles[tile as usize];
        let mesh = TileMesh::from_blob(mesh).expect("a mesh");
        let structure = Structure::from_blob(*kind, blob, mesh, cut.delta).expect("a structure");
        let resident = Resident {
            tile,
            bsp: &bsp,
            structure: &structure,
            materials: &[],
            texturing: Default::default(),
            delta: cut.delta,
        };
        match fly(&resident, &record, f32::INFINITY, |_, _| {}) {
            Flight::Hit { hit, .. } => return Some((hit.t.to_bits(), hit.global)),
            Flight::Leaves { leaf, t } => {
                record.leaf = leaf;
                record.t = t;
            }
            Flight::Escapes { .. } | Flight::Reached => return None,
        }
    }
    panic!("a ray must not walk for ever");
}

#[test]
fn the_first_hit_is_the_nearest_whatever_the_tiles() {
    for seed in 0..6 {
        let (triangles, mut dice) = scene(seed);
        let blob =
            TileMesh::build_blob(triangles.iter().enumerate().map(|(i, &t)| (i as u32, 0, t)));
        let whole = TileMesh::from_blob(&blob).expect("a mesh");
        let cuts = [
            cut(&triangles, RoomCount::Exactly(1), TileLimit::Triangles(1 << 30)),
            cut(&triangles, RoomCount::Auto, TileLimit::Triangles(40)),
            cut(
                &triangles,
                RoomCount::Auto,
                TileLimit::Random { tiles: 25, seed: u64::from(seed) },
            ),
        ];
        let mut hits = 0;
        for i in 0..1500u32 {
            let origin = dice.point(1.0) * Vec3::new(8.0, 4.0, 3.0);
            let [u, v, s, t] = dice.next();
            let target = match i % 4 {
                // At a corner, an edge, or along a triangle's plane: where rounding decides.
                0 => Vec3::from(triangles[(s * triangles.len() as f32) as usize][0]),
                1 => {
                    let [a, b, _] =
                        triangles[(s * triangles.len() as f32) as usize].map(Vec3::from);
                    a.lerp(b, t)
                }
                _ => origin + vector::sphere(u, v),
            };
            let mut direction = (target - origin).normalize_or_zero();
            if i % 7 == 0 {
                direction = [Vec3::X, -Vec3::Y, Vec3::Z][(i % 3) as usize];
            }
            if direction == Vec3::ZERO {
                continue;
            }
            let ray = Ray { origin, direction };
            let delta = cuts[0].delta;
            let expected = nearest_by_force(
                &whole,
                delta,
                &Query { ray, t_min: 0.0, t_max: f32::INFINITY, exclude: NONE },
            )
            .map(|h| (h.t.to_bits(), h.global));
            hits += u32::from(expected.is_some());
            for (c, cut) in cuts.iter().enumerate() {
                assert_eq!(
                    first_hit(cut, &ray),
                    expected,
                    "scene {seed}, cut {c}, ray {i}: {ray:?}"
                );
            }
        }
        assert!(hits > 1000, "most rays of a closed building hit something");
    }
}
