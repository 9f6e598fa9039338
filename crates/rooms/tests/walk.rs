//! The walk finds the nearest triangle of all, whatever the partition.

use enf_rooms::{
    Bsp, Cells, Hint, Options, Partition, RoomCount, Scratch, Tables, TileLimit, partition,
};
use glam::DVec3;
use proptest::prelude::*;
use pulp::{Arch, Scalar, Simd, WithSimd};

type Triangle = [[f32; 3]; 3];

const DELTA: f32 = 16.0 / 524_288.0;

fn options() -> Options {
    Options {
        delta: DELTA,
        bounds_min: [0.0; 3],
        bounds_max: [10.0; 3],
        rooms: RoomCount::Auto,
        hints: Vec::new(),
    }
}

fn point(p: [f32; 3]) -> DVec3 {
    DVec3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2]))
}

/// Moeller and Trumbore 1997 in f64, accepted only within the tolerance of the triangle.
fn meet(t: &Triangle, o: DVec3, d: DVec3) -> Option<f32> {
    let [a, b, c] = t.map(point);
    let (e1, e2) = (b - a, c - a);
    let p = d.cross(e2);
    let det = e1.dot(p);
    if det == 0.0 {
        return None;
    }
    let s = o - a;
    let u = s.dot(p) / det;
    let q = s.cross(e1);
    let v = d.dot(q) / det;
    let t = e2.dot(q) / det;
    if !(u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 1e-3) {
        return None;
    }
    let t = t as f32;
    let on = a + e1 * u + e2 * v;
    ((o + d * f64::from(t)) - on).length().le(&f64::from(DELTA)).then_some(t)
}

/// Nearest among `list` with `t < limit`; ties go to the lowest index.
fn nearest(
    triangles: &[Triangle],
    list: impl Iterator<Item = u32>,
    o: DVec3,
    d: DVec3,
    limit: f32,
) -> Option<(f32, u32)> {
    let mut best: Option<(f32, u32)> = None;
    for i in list {
        if let Some(t) = meet(&triangles[i as usize], o, d)
            && t < limit
            && best.is_none_or(|b| (t, i) < b)
        {
            best = Some((t, i));
        }
    }
    best
}

fn walk(
    bsp: &Bsp<'_>,
    tables: &Tables,
    triangles: &[Triangle],
    o: DVec3,
    d: DVec3,
) -> Option<(f32, u32)> {
    let mut leaf = bsp.locate_towards(o, d);
    let mut t_in = 0.0;
    for _ in 0..=bsp.nodes.len() {
        let exit = bsp.exit(leaf, o, d, t_in);
        assert!(exit.t_exit >= t_in);
        let tile = bsp.leaves[leaf as usize].tile as usize;
        let list = &tables.tile_triangles
            [tables.tile_offsets[tile] as usize..tables.tile_offsets[tile + 1] as usize];
        if let Some(hit) = nearest(triangles, list.iter().copied(), o, d, exit.t_accept) {
            return Some(hit);
        }
        leaf = bsp.cross(exit.face, o, d, exit.t_exit)?;
        t_in = exit.t_exit;
    }
    panic!("the walk does not end");
}

fn check(triangles: &[Triangle], tables: &Tables, rays: &[(DVec3, DVec3)]) {
    let bsp =
        Bsp::new(&tables.planes, &tables.nodes, &tables.leaves, &tables.faces, f64::from(DELTA))
            .unwrap();
    let all = triangles.len() as u32;
    for &(o, d) in rays {
        let expected = nearest(triangles, 0..all, o, d, f32::INFINITY);
        assert_eq!(walk(&bsp, tables, triangles, o, d), expected, "from {o} along {d}");
    }
    let mut cells = Cells::default();
    for &(o, d) in rays {
        shortcuts(&bsp, &mut cells, o, d);
    }
    // No triangle is lost, and each is in the tile of its own points.
    let mut seen = vec![false; triangles.len()];
    for &i in &tables.tile_triangles {
        seen[i as usize] = true;
    }
    assert!(seen.iter().all(|&s| s));
    for (i, t) in triangles.iter().enumerate() {
        for p in t {
            let tile = bsp.leaves[bsp.locate(point(*p)) as usize].tile as usize;
            let list = &tables.tile_triangles
                [tables.tile_offsets[tile] as usize..tables.tile_offsets[tile + 1] as usize];
            assert!(list.binary_search(&(i as u32)).is_ok());
        }
    }
    assert_eq!(tables.rooms.iter().map(|r| r.triangles).sum::<u64>(), triangles.len() as u64);
    for pair in tables.tiles.windows(2) {
        assert!(pair[0].room <= pair[1].room);
    }
    for (i, room) in tables.rooms.iter().enumerate() {
        assert!(room.tile_count > 0);
        for tile in room.first_tile..room.first_tile + room.tile_count {
            assert_eq!(tables.tiles[tile as usize].room, i as u32);
        }
    }
    for leaf in &tables.leaves {
        assert_eq!(tables.tiles[leaf.tile as usize].room, leaf.room);
    }
}

/// What [`Cells`] say.
struct Held<'a, 'b> {
    cells: &'a mut Cells,
    bsp: &'a Bsp<'b>,
    leaf: u32,
    point: DVec3,
    direction: DVec3,
    t: f32,
}

impl WithSimd for Held<'_, '_> {
    type Output = [bool; 2];

    fn with_simd<S: Simd>(self, simd: S) -> [bool; 2] {
        let Self { cells, bsp, leaf, point, direction, t } = self;
        [
            cells.keeps(simd, bsp, leaf, point, direction),
            cells.accepts(simd, bsp, leaf, point, direction, t),
        ]
    }
}

/// What [`Bsp::keeps`] and [`Bsp::accepts`] say goes for every leaf and for points as near to planes as photons start. Returns how
/// often the first said yes.
fn shortcuts(bsp: &Bsp<'_>, cells: &mut Cells, o: DVec3, d: DVec3) -> usize {
    let d = d.normalize();
    let lift = f64::from(DELTA) / 4.0;
    let mut kept = 0;
    cells.clear();
    for step in [DVec3::ZERO, DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z] {
        let p = o + step * lift;
        for leaf in 0..bsp.leaves.len() as u32 {
            if bsp.keeps(leaf, p, d) {
                kept += 1;
                assert_eq!(bsp.locate(p), leaf, "{p}");
                assert_eq!(bsp.locate_towards(p, d), leaf, "{p} along {d}");
            }
            let exit = bsp.exit(leaf, p, d, 0.0);
            for t in [exit.t_accept.next_down(), exit.t_accept, exit.t_exit, 1.0] {
                if bsp.accepts(leaf, p, d, t) {
                    // The same but for the rounding of a division.
                    assert!(t <= exit.t_accept.next_up(), "{t} {exit:?}");
                }
            }
            // One of them is enough.
            if step != DVec3::Y {
                continue;
            }
            let t = exit.t_accept;
            let both = [bsp.keeps(leaf, p, d), bsp.accepts(leaf, p, d, t)];
            let (point, direction) = (p, d);
            let held = Held { cells, bsp, leaf, point, direction, t };
            assert_eq!(Arch::new().dispatch(held), both, "{p} along {d} to {t}");
            #[cfg(target_arch = "x86_64")]
            if let Some(avx2) = pulp::x86::V3::try_new() {
                let held = Held { cells, bsp, leaf, point, direction, t };
                assert_eq!(Simd::vectorize(avx2, held), both, "{p} along {d} to {t}");
            }
            let held = Held { cells, bsp, leaf, point, direction, t };
            assert_eq!(held.with_simd(Scalar), both, "{p} along {d} to {t}");
        }
    }
    kept
}

#[test]
fn a_photon_off_a_wall_mostly_stays_in_its_leaf() {
    let wall = [[5.0, 0.0, 0.0], [5.0, 10.0, 0.0], [5.0, 10.0, 10.0]];
    let mut options = options();
    options.hints.push(Hint { min: [5.0, 0.0, 0.0], max: [10.0; 3], polygon: Vec::new() });
    let tables = partition(&[wall], &|_| true, &options).unwrap().finish(&[wall]);
    let bsp =
        Bsp::new(&tables.planes, &tables.nodes, &tables.leaves, &tables.faces, f64::from(DELTA))
            .unwrap();
    let at = |lift: f64| DVec3::new(5.0 + lift, 4.0, 4.0);
    let lift = f64::from(DELTA) / 4.0;
    let towards = |x: f64| DVec3::new(x, 0.6, 0.1).normalize();
    assert!(shortcuts(&bsp, &mut Cells::default(), at(lift), towards(1.0)) > 0);
    // Along the wall, or on the plane, it has to be looked for.
    let leaf = bsp.locate(at(lift));
    assert!(bsp.keeps(leaf, at(lift), towards(1.0)) && bsp.keeps(leaf, at(1.0), towards(-1.0)));
    assert!(!bsp.keeps(leaf, at(lift), towards(0.1)) && !bsp.keeps(leaf, at(0.0), towards(1.0)));
}

fn coordinate() -> impl Strategy<Value = f32> {
    // Half of all coordinates on a coarse grid, so that walls lie in each other's planes.
    prop_oneof![(0u32..=10).prop_map(|i| i as f32), 0.0f32..10.0]
}

fn corner() -> impl Strategy<Value = [f32; 3]> {
    [coordinate(), coordinate(), coordinate()]
}

fn triangle() -> impl Strategy<Value = Triangle> {
    prop_oneof![
        [corner(), corner(), corner()],
        // A sheet of a wall.
        (0usize..3, 0u32..=10, [corner(), corner(), corner()]).prop_map(|(axis, at, mut t)| {
            for p in &mut t {
                p[axis] = at as f32;
            }
            t
        }),
    ]
}

fn rays(triangles: &[Triangle], seeds: &[([f32; 3], [f32; 3], u32)]) -> Vec<(DVec3, DVec3)> {
    let mut rays = Vec::new();
    for &(a, b, k) in seeds {
        let (a, b) = (point(a), point(b));
        let t = triangles[k as usize % triangles.len()].map(point);
        // A free ray; one along an edge; one that grazes a triangle; one that starts on it.
        let middle = (t[0] + t[1] + t[2]) / 3.0;
        let along = t[1] - t[0];
        let normal = along.cross(t[2] - t[0]);
        let graze = along + normal * 1e-6;
        rays.push((a, b - a));
        rays.push((t[0] - along * 0.3, along));
        rays.push((middle - graze, graze));
        rays.push((middle, b - middle));
        rays.push((a, t[0] - a));
        rays.push((a, (t[0] + t[1]) * 0.5 - a));
    }
    rays.retain(|(o, d)| {
        d.length() > 1e-3 && o.cmpge(DVec3::ZERO).all() && o.cmple(DVec3::splat(10.0)).all()
    });
    rays.iter().map(|&(o, d)| (o, d / d.length())).collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    #[test]
    fn first_accepted_is_nearest_of_all(
        triangles in prop::collection::vec(triangle(), 1..60),
        seeds in prop::collection::vec((corner(), corner(), any::<u32>()), 12),
        tiles in 1u32..24,
        seed in any::<u64>(),
        opaque in any::<bool>(),
        hint in prop::option::of((corner(), corner())),
    ) {
        let mut options = options();
        if let Some((a, b)) = hint {
            let min = [0, 1, 2].map(|k| a[k].min(b[k]));
            let max = [0, 1, 2].map(|k| a[k].max(b[k]) + 0.5);
            // The box, or half of it.
            let corners = [[min[0], min[1]], [max[0], min[1]], [min[0], max[1]]];
            let polygon = if seed % 2 == 0 { Vec::new() } else { corners.to_vec() };
            options.hints.push(Hint { min, max, polygon });
        }
        let rays = rays(&triangles, &seeds);
        let whole = partition(&triangles, &|_| opaque, &options).unwrap();
        let mut cut = partition(&triangles, &|_| opaque, &options).unwrap();
        let tiles = tiles.max(whole.rooms().len() as u32);
        cut.cut_tiles(&triangles, TileLimit::Random { tiles, seed }).unwrap();
        let (whole, cut) = (whole.finish(&triangles), cut.finish(&triangles));
        check(&triangles, &whole, &rays);
        check(&triangles, &cut, &rays);
        prop_assert_eq!(cut.tiles.len(), tiles as usize);
        // Rooms know nothing of tiles.
        for (a, b) in whole.rooms.iter().zip(&cut.rooms) {
            let b = enf_layout::room::RoomRecord {
                first_tile: a.first_tile,
                tile_count: a.tile_count,
                ..*b
            };
            prop_assert_eq!(*a, b);
        }
        prop_assert_eq!(whole.portals, cut.portals);
    }

    #[test]
    fn a_scene_that_streams_past_is_divided_as_well(
        triangles in prop::collection::vec(triangle(), 12..120),
        seeds in prop::collection::vec((corner(), corner(), any::<u32>()), 12),
        limit in 3u64..30,
        near in 1usize..9,
        weight in 1u32..4,
    ) {
        // Rooms from some of the triangles, cuts from a sample of each room's.
        let survey: Vec<Triangle> = triangles.iter().step_by(3).copied().collect();
        let mut parted = partition(&survey, &|_| true, &options()).unwrap();
        let lists = |parted: &Partition| {
            let mut lists: Vec<Vec<u32>> = Vec::new();
            let mut owned = vec![0u64; parted.rooms().len()];
            let mut scratch = Scratch::default();
            for (k, group) in triangles.chunks(near).enumerate() {
                let corners = || group.iter().flatten();
                let fold = |f: fn(f32, f32) -> f32, from: f32| {
                    [0, 1, 2].map(|a| corners().fold(from, |m, c| f(m, c[a])))
                };
                let start =
                    parted.start(fold(f32::min, f32::INFINITY), fold(f32::max, f32::NEG_INFINITY));
                for (i, t) in group.iter().enumerate() {
                    owned[parted.owner(start, t) as usize] += 1;
                    parted.route(start, t, &mut scratch, |piece| {
                        lists.resize(lists.len().max(piece as usize + 1), Vec::new());
                        lists[piece as usize].push((k * near + i) as u32);
                    });
                }
            }
            lists.resize(lists.len().max(4096), Vec::new());
            (lists, owned)
        };
        let (before, _) = lists(&parted);
        let mut order = Vec::new();
        for piece in parted.pieces() {
            let mine = &before[piece.number() as usize];
            let sample: Vec<Triangle> =
                mine.iter().step_by(weight as usize).map(|&i| triangles[i as usize]).collect();
            let parts = parted.cut_piece(piece, &sample, f64::from(weight), limit);
            order.extend(parts.iter().map(|p| p.number()));
        }
        let (after, owned) = lists(&parted);
        let mut tables = parted.tables(&order);
        tables.tile_offsets.push(0);
        for &piece in &order {
            tables.tile_triangles.extend(&after[piece as usize]);
            tables.tile_offsets.push(tables.tile_triangles.len() as u64);
        }
        for (room, n) in tables.rooms.iter_mut().zip(owned) {
            room.triangles = n;
        }
        prop_assert_eq!(tables.tiles.len(), order.len());
        check(&triangles, &tables, &rays(&triangles, &seeds));
    }

    #[test]
    fn tables_that_are_damaged_are_refused_or_walked(
        triangles in prop::collection::vec(triangle(), 8..30),
        which in 0usize..4,
        at in any::<prop::sample::Index>(),
        value in prop_oneof![0u32..40, any::<u32>(), (0u32..40).prop_map(|x| x | 1 << 31)],
        ray in (corner(), corner()),
    ) {
        let mut parted = partition(&triangles, &|_| true, &options()).unwrap();
        let tiles = 12.max(parted.rooms().len() as u32);
        parted.cut_tiles(&triangles, TileLimit::Random { tiles, seed: 7 }).unwrap();
        let mut t = parted.finish(&triangles);
        match which {
            0 => { let i = at.index(t.nodes.len()); t.nodes[i].front = value; }
            1 => { let i = at.index(t.nodes.len()); t.nodes[i].plane = value; }
            2 => { let i = at.index(t.leaves.len()); t.leaves[i].first_face = value; }
            _ => { let i = at.index(t.faces.len()); t.faces[i].beyond = value; }
        }
        if let Ok(bsp) = Bsp::new(&t.planes, &t.nodes, &t.leaves, &t.faces, f64::from(DELTA)) {
            let (o, d) = (point(ray.0), point(ray.1) - point(ray.0));
            let mut leaf = bsp.locate_towards(o, d);
            let mut t_in = 0.0;
            let mut steps = 0;
            loop {
                let exit = bsp.exit(leaf, o, d, t_in);
                let Some(next) = bsp.cross(exit.face, o, d, exit.t_exit) else { break };
                (leaf, t_in) = (next, exit.t_exit);
                steps += 1;
                prop_assert!(steps <= 4 * bsp.nodes.len() + 4, "the walk does not end");
            }
        }
    }
}
