//! Grid and hierarchy against testing every triangle, to the bit.

mod common;

use common::{Blobs, Corners, KINDS, Random, anything, bits, blob, delta, spelt};
use enf_geometry::{
    BvhView, GridView, NONE, Query, Ray, Structure, StructureKind, TileMesh, build_grid,
    bvh_bytes_estimate, grid_bytes_estimate, nearest_by_force, structure_bytes_estimate,
};
use enf_layout::bvh::{
    BvhHeader, BvhNode, CHILD_INNER, DEPTH, LEAF_TRIANGLES, LeafBlock, SECTION_NODES, SECTIONS,
    WIDTH,
};
use enf_layout::codec;
use enf_layout::grid::{BrickRecord, SECTION_BRICKS};
use enf_layout::sections::{self, Transform};
use glam::Vec3;
use proptest::prelude::*;
use zerocopy::{FromZeros, IntoBytes};

fn compare(
    triangles: &[Corners],
    rays: impl IntoIterator<Item = Ray>,
    delta: f32,
    seed: u64,
) -> usize {
    let mut random = Random(seed);
    let blobs = Blobs::new(triangles, delta);
    let n = triangles.len() as u64;
    let [grid, bvh] = blobs.structures.each_ref().map(|blob| blob.len() as u64);
    assert!(grid <= grid_bytes_estimate(n) && bvh <= bvh_bytes_estimate(n), "{grid} {bvh}");
    assert!(grid.max(bvh) <= structure_bytes_estimate(n));
    let tile = blobs.tile();
    let (mut queries, mut truths) = (Vec::new(), Vec::new());
    let mut hits = 0;
    for ray in rays {
        let (mut t_min, mut t_max, mut exclude) = (0.0, f32::INFINITY, NONE);
        // Walk through everything on the way, as transport does, with a few odd intervals.
        for round in 0..6 {
            let query = Query { ray, t_min, t_max, exclude };
            let truth = tile.by_force(&query);
            tile.check(&query, truth);
            queries.push(query);
            truths.push(truth);
            match truth {
                Some(hit) => {
                    hits += 1;
                    exclude = hit.global;
                    t_min = if random.below(3) == 0 { hit.t.next_up() } else { hit.t };
                    if round == 2 {
                        t_max = t_min + 10.0 * random.unit();
                    }
                }
                None => {
                    (t_min, t_max, exclude) = (f32::NEG_INFINITY, f32::INFINITY, NONE);
                    if random.below(2) == 0 {
                        t_max = 10.0 * random.unit();
                    }
                }
            }
        }
    }
    tile.check_batch(&queries, &truths);
    hits
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]
    #[test]
    fn nearest_is_what_brute_force_finds(seed in any::<u64>(), count in 1usize..300, scale in -3i32..8) {
        let mut random = Random(seed);
        let size = 2f32.powi(scale) * (1.0 + random.unit());
        let triangles = common::zoo(&mut random, count, size);
        let rays: Vec<_> = (0..120).map(|_| common::ray(&mut random, &triangles, size)).collect();
        compare(&triangles, rays, delta(size), seed);
    }

    /// Vertices, origins and directions on a lattice: everything coincides with everything.
    #[test]
    fn nearest_survives_coincidences(seed in any::<u64>(), count in 1usize..200) {
        let mut random = Random(seed);
        let lattice = |random: &mut Random| {
            Vec3::new(random.below(9) as f32, random.below(9) as f32, random.below(9) as f32)
        };
        let triangles: Vec<Corners> = (0..count)
            .map(|_| [lattice(&mut random), lattice(&mut random), lattice(&mut random)])
            .collect();
        let rays: Vec<_> = (0..120)
            .map(|_| {
                let origin = lattice(&mut random);
                let d = (lattice(&mut random) - 4.0).try_normalize().unwrap_or(Vec3::NEG_Y);
                Ray { origin: origin - 16.0 * random.below(2) as f32 * d, direction: d }
            })
            .collect();
        compare(&triangles, rays, delta(8.0), seed);
    }
}

#[test]
fn a_big_tessellated_room_agrees_too() {
    let mut random = Random(11);
    let mut triangles = Vec::new();
    let n = 24;
    for side in 0..6 {
        let axis = side / 2;
        for i in 0..n {
            for j in 0..n {
                let p = |i: usize, j: usize| {
                    let mut p = Vec3::ZERO;
                    p[axis] = 12.0 * (side % 2) as f32;
                    p[(axis + 1) % 3] = 12.0 * i as f32 / n as f32;
                    p[(axis + 2) % 3] = 12.0 * j as f32 / n as f32;
                    p
                };
                triangles.push([p(i, j), p(i + 1, j), p(i + 1, j + 1)]);
                triangles.push([p(i, j), p(i + 1, j + 1), p(i, j + 1)]);
            }
        }
    }
    triangles.extend(common::zoo(&mut random, 600, 3.0).into_iter().map(|t| t.map(|p| p + 6.0)));
    let rays: Vec<_> = (0..3000)
        .map(|_| Ray { origin: 6.0 + 5.9 * random.cube(), direction: random.direction() })
        .collect();
    let hits = compare(&triangles, rays, delta(12.0), 5);
    assert!(hits > 3000);
}

/// A few big triangles, and hundreds in a hand's breadth: cells are divided there, and rays meet them as well through
/// divided cells as anywhere.
#[test]
fn a_crowd_in_an_empty_hall_agrees_too() {
    let mut random = Random(12);
    let (hall, at) = (40.0, Vec3::new(3.3, -7.1, 5.2));
    let mut triangles = common::zoo(&mut random, 30, hall);
    let crowd: Vec<_> =
        common::zoo(&mut random, 900, 0.4).into_iter().map(|t| t.map(|p| p + at)).collect();
    triangles.extend(&crowd);
    let rays: Vec<_> = (0..1500)
        .map(|i| match i % 3 {
            0 => common::ray(&mut random, &triangles, hall),
            // At the crowd from afar, and out of it.
            1 => {
                let origin = hall * random.cube();
                Ray { origin, direction: at + 0.4 * random.cube() - origin }
            }
            _ => Ray { origin: at + 0.4 * random.cube(), direction: random.direction() },
        })
        .collect();
    let hits = compare(&triangles, rays, delta(hall), 6);
    assert!(hits > 1500, "{hits}");

    let blobs = Blobs::new(&triangles, delta(hall));
    let bricks = |triangles: &[Corners]| -> (usize, usize) {
        let mesh = blob(triangles);
        let mesh = TileMesh::from_blob(&mesh).unwrap();
        let grid = build_grid(&mesh, blobs.delta);
        let header = *GridView::from_blob(&grid, mesh, blobs.delta).unwrap().header();
        let all: &[BrickRecord] = sections::section(&grid, SECTION_BRICKS).unwrap();
        (header.bricks.iter().product::<u32>() as usize, all.len())
    };
    let (outer, all) = bricks(&triangles);
    assert!(all > outer, "no cell is divided");
    let (outer, all) = bricks(&triangles[..30]);
    assert_eq!(all, outer, "a cell is divided for nothing");
}

#[test]
fn ties_go_to_the_smaller_global_index() {
    let wall = [Vec3::ZERO, 4.0 * Vec3::X, 4.0 * Vec3::Y];
    let turned = [wall[1], wall[2], wall[0]];
    let blobs = Blobs::new(&[turned, wall, wall, turned], delta(4.0));
    let mesh = TileMesh::from_blob(&blobs.mesh).unwrap();
    let ray = Ray { origin: Vec3::new(1.0, 1.0, 2.0), direction: Vec3::NEG_Z };
    for (kind, blob) in KINDS.into_iter().zip(&blobs.structures) {
        let structure = Structure::from_blob(kind, blob, mesh, blobs.delta).unwrap();
        let ask = |t_min, t_max, exclude| structure.nearest(&Query { ray, t_min, t_max, exclude });
        let nearest = |exclude| ask(0.0, 9.0, exclude).unwrap();
        assert_eq!((nearest(NONE).global, nearest(NONE).t), (1, 2.0));
        assert_eq!(nearest(1).global, 4);
        // The interval is half open.
        assert!(ask(0.0, 2.0, NONE).is_none());
        assert!(ask(2.0, 9.0, NONE).is_some());
    }
}

#[test]
fn odd_rays_and_meshes_are_harmless() {
    let empty_blob = blob(&[]);
    let empty = TileMesh::from_blob(&empty_blob).unwrap();
    let huge = 3.0e38;
    let giant = [Vec3::splat(-huge), Vec3::new(huge, -huge, 0.0), Vec3::splat(huge)];
    let meshes = [
        empty_blob.clone(),
        blob(&[[Vec3::ONE; 3]]),
        blob(&[giant]),
        blob(&[[Vec3::splat(1e-40), Vec3::splat(2e-40), Vec3::X * 1e-40]]),
    ];
    let x = [0.0, -0.0, 1.0, 1e-45, -1e-30, f32::NAN, f32::INFINITY, f32::MAX];
    for mesh_blob in &meshes {
        for delta in [0.0, 1e-4, f32::NAN, f32::MAX] {
            let mesh = TileMesh::from_blob(mesh_blob).unwrap();
            if delta.is_nan() {
                for kind in KINDS {
                    let blob = common::complete(kind, &mesh, delta);
                    assert!(Structure::from_blob(kind, &blob, mesh, delta).is_err());
                    assert!(Structure::from_blob(kind, &blob, mesh, 1e-45).is_err());
                    assert!(Structure::from_blob(kind, &blob, mesh, 0.0).is_ok());
                }
                continue;
            }
            let blobs = Blobs::of_mesh(mesh_blob.clone(), delta);
            let tile = blobs.tile();
            let (mut queries, mut truths) = (Vec::new(), Vec::new());
            for i in 0..512 {
                let pick = |k: usize| x[(i >> (3 * k)) & 7];
                let d = Vec3::new(pick(0), pick(1), pick(2));
                let origin = Vec3::new(pick(2), 0.5, pick(1));
                for direction in [d, -d] {
                    let ray = Ray { origin, direction };
                    for (t_min, t_max) in
                        [(0.0, 1.0), (f32::NEG_INFINITY, f32::INFINITY), (f32::NAN, f32::NAN)]
                    {
                        let query = Query { ray, t_min, t_max, exclude: NONE };
                        let truth = tile.by_force(&query);
                        tile.check(&query, truth);
                        queries.push(query);
                        truths.push(truth);
                    }
                }
            }
            tile.check_batch(&queries, &truths);
        }
    }
    assert!(empty.is_empty());
}

/// Every byte of a blob, flipped in the store or in memory: rejected, or walked without leaving it.
#[test]
fn a_corrupt_structure_is_rejected_or_harmless() {
    let mut random = Random(21);
    let mut triangles = common::zoo(&mut random, 12, 4.0);
    // A crowd, so that the grid divides a cell.
    triangles.extend(common::zoo(&mut random, 40, 0.05));
    let tolerance = delta(4.0);
    let mesh_blob = blob(&triangles);
    let mesh = TileMesh::from_blob(&mesh_blob).unwrap();
    let queries: Vec<_> =
        (0..8).map(|_| anything(common::ray(&mut random, &triangles, 4.0))).collect();
    let walk = |kind, blob: &[u8]| {
        let Ok(structure) = Structure::from_blob(kind, blob, mesh, tolerance) else { return false };
        for query in &queries {
            structure.nearest(query);
            structure.occluded(query);
        }
        if let Structure::Bvh(bvh) = structure {
            common::exercise(&bvh, &queries);
        }
        true
    };
    for kind in KINDS {
        let stored = kind.build(&mesh, tolerance);
        let mut good = stored.clone();
        kind.complete(&mut good, &mesh).unwrap();
        assert!(walk(kind, &good));
        if kind == StructureKind::Bvh {
            assert!(!walk(kind, &stored), "a hierarchy without its triangles");
        }
        let (mut refused, mut completed) = ([0, 0], 0);
        for at in 0..good.len() {
            let bit = 1 << random.below(8);
            // Flipped where it was stored: loading completes it, if it can.
            let mut bad = stored.clone();
            bad[at] ^= bit;
            if kind.complete(&mut bad, &mesh).is_ok() {
                completed += 1;
                refused[0] += usize::from(!walk(kind, &bad));
            } else {
                assert!(!walk(kind, &bad), "byte {at}: accepted, though it could not be completed");
            }
            // Flipped afterwards.
            let mut bad = good.clone();
            bad[at] ^= bit;
            refused[1] += usize::from(!walk(kind, &bad));
        }
        assert!(completed > good.len() / 2 && refused[0] > 0 && refused[1] > good.len() / 8);
        // The last 63 bytes may be padding.
        for length in 0..good.len() - 63 {
            let mut short = stored[..length].to_vec();
            // Whether or not it finds its places, it must not be taken for whole.
            let _ = kind.complete(&mut short, &mesh);
            assert!(!walk(kind, &short), "{length} bytes of {}", good.len());
            assert!(!walk(kind, &good[..length]), "{length} bytes of {}", good.len());
        }
        // Of another mesh, or for another tolerance.
        let mut others = triangles.clone();
        others.push([Vec3::ZERO, Vec3::X, Vec3::Y]);
        let more = blob(&others);
        let more = TileMesh::from_blob(&more).unwrap();
        assert!(Structure::from_blob(kind, &good, more, tolerance).is_err());
        let fewer = blob(&triangles[1..]);
        let fewer = TileMesh::from_blob(&fewer).unwrap();
        assert!(Structure::from_blob(kind, &good, fewer, tolerance).is_err());
        if kind == StructureKind::Bvh {
            assert!(kind.complete(&mut stored.clone(), &fewer).is_err());
        }
        for wrong in [tolerance.next_up(), f32::INFINITY, f32::NAN] {
            assert!(Structure::from_blob(kind, &good, mesh, wrong).is_err(), "{wrong}");
        }
        assert!(Structure::from_blob(kind, &good, mesh, 0.5 * tolerance).is_ok());
    }
}

/// A hierarchy holds copies of the triangles: those of another mesh of the same size must not pass for them.
#[test]
fn a_hierarchy_of_a_mesh_that_has_changed_is_refused() {
    let mut random = Random(22);
    let triangles = common::zoo(&mut random, 40, 4.0);
    let blobs = Blobs::new(&triangles, delta(4.0));
    let good = &blobs.structures[1];
    for i in 0..triangles.len() {
        let mut moved = triangles.clone();
        moved[i][random.below(3)].x += 0.5;
        let flat = |[a, b, c]: Corners| (b - a).cross(c - a) == Vec3::ZERO;
        if flat(triangles[i]) || flat(moved[i]) {
            continue;
        }
        let mesh = blob(&moved);
        let mesh = TileMesh::from_blob(&mesh).unwrap();
        let opened = Structure::from_blob(StructureKind::Bvh, good, mesh, blobs.delta);
        assert!(opened.is_err(), "triangle {i}");
        // Completed from what it is asked about, it is a hierarchy of that mesh.
        let mut again = good.clone();
        StructureKind::Bvh.complete(&mut again, &mesh).unwrap();
        let bvh = BvhView::from_blob(&again, &mesh, blobs.delta).unwrap();
        for _ in 0..50 {
            let query = anything(common::ray(&mut random, &moved, 4.0));
            let truth = nearest_by_force(&mesh, blobs.delta, &query);
            assert_eq!(bits(bvh.nearest(&query)), bits(truth), "{}", spelt(&query));
        }
    }
}

/// Puts nodes into a hierarchy as they are, whatever they say.
fn put_nodes(blob: &mut [u8], nodes: &[BvhNode]) {
    let [_, place, ..] = sections::split_mut::<SECTIONS>(blob).unwrap();
    place.copy_from_slice(nodes.as_bytes());
}

/// Nodes with any frame, any bounds: boxes that are nowhere, or everywhere, or numbers that overflow on the way. Whatever
/// is accepted is walked without leaving it.
#[test]
fn a_hierarchy_with_mad_boxes_is_harmless() {
    let mut random = Random(24);
    let triangles = common::zoo(&mut random, 60, 4.0);
    let blobs = Blobs::new(&triangles, delta(4.0));
    let mesh = TileMesh::from_blob(&blobs.mesh).unwrap();
    let good = &blobs.structures[1];
    let nodes: &[BvhNode] = sections::section(good, SECTION_NODES).unwrap();
    let exponents = [-126, -125, -60, -20, -14, -9, -5, -2, 0, 2, 4, 20, 90, 120, 126, 127];
    let origins = [0.0, -0.0, 1e-45, -1e-38, 1.0, -4.0, 31.0, -64.0, 1e15, -1e30, 3e38, f32::MIN];
    let (mut accepted, mut refused) = (0, 0);
    for round in 0..4000 {
        let mut nodes = nodes.to_vec();
        for _ in 0..1 + random.below(8) {
            let at = random.below(nodes.len());
            let node = &mut nodes[at];
            let axis = random.below(3);
            match random.below(4) {
                0 => node.origin[axis] = origins[random.below(origins.len())],
                1 => node.step[axis] = 2f32.powi(exponents[random.below(exponents.len())]),
                _ => {
                    let slot = random.below(WIDTH);
                    if node.used >> slot & 1 != 0 || round % 16 == 0 {
                        node.bounds[axis][slot] = random.below(256) as u8;
                        node.bounds[axis][slot + WIDTH] = random.below(256) as u8;
                    }
                }
            }
        }
        let mut bad = good.clone();
        put_nodes(&mut bad, &nodes);
        let Ok(bvh) = BvhView::from_blob(&bad, &mesh, blobs.delta) else {
            refused += 1;
            continue;
        };
        accepted += 1;
        let queries: Vec<Query> = (0..24)
            .map(|_| {
                let mut ray = common::ray(&mut random, &triangles, 4.0);
                if random.below(3) == 0 {
                    ray.direction[random.below(3)] *= [0.0, -0.0, 1e-30, -1e-45][random.below(4)];
                }
                let t_max = [f32::INFINITY, f32::MAX, 3.0][random.below(3)];
                Query { t_max, ..anything(ray) }
            })
            .collect();
        common::exercise(&bvh, &queries);
    }
    assert!(accepted > 1000 && refused > 1000, "{accepted} accepted, {refused} refused");
}

/// As deep as hierarchies may be; with boxes that fit, and with boxes that every ray enters, so that each node leaves
/// seven for later: no stack overflows, and nothing is forgotten.
#[test]
fn a_hierarchy_as_deep_as_may_be() {
    let mut random = Random(25);
    let count = (WIDTH - 1) * DEPTH + 1;
    let triangles: Vec<Corners> = (0..count)
        .map(|_| {
            let a = 2.0 * random.cube();
            [a, a + random.cube(), a + random.cube()]
        })
        .collect();
    let mesh_blob = blob(&triangles);
    let mesh = TileMesh::from_blob(&mesh_blob).unwrap();
    let tolerance = delta(4.0);
    let header =
        BvhHeader { min: [-3.5; 3], max: [3.5; 3], delta: tolerance, triangles: mesh.len() };
    // One triangle to each block, the next one: a difference of one, in zigzag.
    let blocks: Vec<LeafBlock> = (0..count)
        .map(|i| LeafBlock {
            corners: [[[0.0; LEAF_TRIANGLES]; 3]; 3],
            global: [if i == 0 { 0 } else { 2 }, 0, 0, 0],
            material: [0; LEAF_TRIANGLES],
        })
        .collect();
    let rays: Vec<Ray> = (0..300)
        .map(|_| {
            let origin = 3.0 * random.cube();
            let target = triangles[random.below(count)][random.below(3)];
            Ray { origin, direction: (target - origin).normalize() }
        })
        .collect();
    // The inner child comes first for rays of one octant, last for those of the opposite one.
    for (slot, wide) in (0..WIDTH).flat_map(|slot| [(slot, false), (slot, true)]) {
        let nodes: Vec<BvhNode> = (0..DEPTH)
            .map(|depth| {
                let mut node = BvhNode {
                    origin: [-4.0; 3],
                    step: [0.03125; 3],
                    nodes: depth as u32 + 1,
                    blocks: (depth * (WIDTH - 1)) as u32,
                    child: std::array::from_fn(|i| (i - usize::from(i > slot)) as u8),
                    bounds: [[0, 0, 0, 0, 0, 0, 0, 0, 255, 255, 255, 255, 255, 255, 255, 255]; 3],
                    used: 255,
                    reserved: 0,
                };
                // The last node has a leaf there.
                node.child[slot] = if depth + 1 < DEPTH { CHILD_INNER } else { WIDTH as u8 - 1 };
                node
            })
            .collect();
        let stored: Vec<BvhNode> = nodes
            .iter()
            .map(|node| BvhNode { child: node.child.map(|c| c & !7), ..BvhNode::new_zeroed() })
            .collect();
        let mut blob = sections::build(&[
            (header.as_bytes(), Transform::None, 1),
            (stored.as_bytes(), Transform::None, 1),
            (blocks.as_bytes(), Transform::None, 1),
        ]);
        StructureKind::Bvh.complete(&mut blob, &mesh).unwrap();
        if wide {
            put_nodes(&mut blob, &nodes);
        }
        let bvh = BvhView::from_blob(&blob, &mesh, tolerance).unwrap();
        let queries: Vec<Query> = rays.iter().map(|&ray| anything(ray)).collect();
        let truths: Vec<_> =
            queries.iter().map(|query| nearest_by_force(&mesh, tolerance, query)).collect();
        for (name, level) in common::levels() {
            let mut batch = vec![None; queries.len()];
            bvh.nearest_batch_with(level, &queries, &mut batch);
            let mut shadows = vec![false; queries.len()];
            bvh.occluded_batch_with(level, &queries, &mut shadows);
            for (i, query) in queries.iter().enumerate() {
                let truth = truths[i];
                let say = || format!("{name}, child {slot}: {}", spelt(query));
                assert_eq!(bits(bvh.nearest_with(level, query)), bits(truth), "{}", say());
                assert_eq!(bits(batch[i]), bits(truth), "batch, {}", say());
                assert_eq!(bvh.occluded_with(level, query), truth.is_some(), "{}", say());
                assert_eq!(shadows[i], truth.is_some(), "batch, {}", say());
            }
        }
    }
}

/// A structure answers for any tolerance up to its own, also where that is too small for its coordinates.
#[test]
fn a_structure_answers_for_smaller_tolerances() {
    let mut random = Random(26);
    let triangles = common::zoo(&mut random, 150, 4.0);
    let blobs = Blobs::new(&triangles, delta(4.0));
    for part in [1.0, 0.9, 0.5, 0.25, 1e-3, 1e-9, 0.0] {
        let tile = blobs.tile_for(part * blobs.delta);
        let (mut queries, mut truths) = (Vec::new(), Vec::new());
        for _ in 0..1000 {
            let query = anything(common::ray(&mut random, &triangles, 4.0));
            let truth = tile.by_force(&query);
            tile.check(&query, truth);
            queries.push(query);
            truths.push(truth);
        }
        tile.check_batch(&queries, &truths);
        // No f32 is near enough where the tolerance is less than its rounding.
        assert!(truths.iter().flatten().count() > 300 || part < 0.2);
    }
}

/// Completing twice is completing once: what is loaded may have been complete already.
#[test]
fn completing_depends_on_the_mesh_alone() {
    let triangles = common::zoo(&mut Random(23), 200, 4.0);
    let blobs = Blobs::new(&triangles, delta(4.0));
    let mesh = TileMesh::from_blob(&blobs.mesh).unwrap();
    for (kind, blob) in KINDS.into_iter().zip(&blobs.structures) {
        let mut again = blob.clone();
        kind.complete(&mut again, &mesh).unwrap();
        assert_eq!(&again, blob);
        assert_eq!(kind.build(&mesh, blobs.delta), kind.build(&mesh, blobs.delta));
    }
}

#[test]
fn blobs_survive_the_codec_and_do_not_depend_on_order() {
    let mut random = Random(31);
    let triangles = common::zoo(&mut random, 500, 8.0);
    let mesh_blob = blob(&triangles);
    let items: Vec<_> = triangles
        .iter()
        .enumerate()
        .map(|(i, t)| (3 * i as u32 + 1, i as u32 % 5, t.map(|p| p.to_array())))
        .collect();
    assert_eq!(TileMesh::build_blob(items.iter().rev().copied()), mesh_blob);
    let mesh = TileMesh::from_blob(&mesh_blob).unwrap();
    assert!(mesh.vertices.len() < 3 * mesh.triangles.len());
    for (i, t) in triangles.iter().enumerate() {
        assert_eq!(mesh.corners(i as u32), *t);
        assert_eq!((mesh.global[i], mesh.materials[i]), (3 * i as u32 + 1, i as u32 % 5));
    }
    let [grid, bvh] = KINDS.map(|kind| kind.build(&mesh, delta(8.0)));
    for original in [mesh_blob.clone(), grid, bvh] {
        let mut coded = vec![0; original.len()];
        codec::forward(&original, &mut coded).unwrap();
        let mut scratch = vec![0; codec::scratch_bytes(&coded).unwrap()];
        codec::inverse(&mut coded, &mut scratch).unwrap();
        assert_eq!(coded, original);
    }
}

#[test]
fn a_malformed_mesh_is_named() {
    let good = blob(&[[Vec3::ZERO, Vec3::X, Vec3::Y]]);
    assert!(TileMesh::from_blob(&good).is_ok());
    let says = |blob: &[u8], words: &str| {
        let message = TileMesh::from_blob(blob).unwrap_err().0;
        assert!(message.contains(words), "{message}");
    };
    says(&blob(&[[Vec3::ZERO, Vec3::X, Vec3::splat(f32::NAN)]]), "vertex 2 is not finite");
    let twice = TileMesh::build_blob([(7, 0, [[0.0; 3]; 3]), (7, 0, [[0.0; 3]; 3])].into_iter());
    says(&twice, "do not ascend after triangle 0");
    let mut far = good.clone();
    let at = far.windows(12).position(|w| w == [0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]).unwrap();
    far[at + 8] = 3;
    says(&far, "triangle 0 has corners [0, 1, 3] of 3 vertices");
    says(&good[..100], "");
}

#[test]
fn normals_are_unit_and_face_the_counter_clockwise_side() {
    let tiny = 1e-20;
    let mesh_blob = blob(&[
        [Vec3::ZERO, Vec3::X, Vec3::Y],
        [Vec3::ZERO, tiny * Vec3::Y, tiny * Vec3::X],
        [Vec3::ZERO, Vec3::X, 2.0 * Vec3::X],
    ]);
    let mesh = TileMesh::from_blob(&mesh_blob).unwrap();
    assert_eq!(mesh.geometric_normal(0), Vec3::Z);
    assert_eq!(mesh.geometric_normal(1), Vec3::NEG_Z);
    assert_eq!(mesh.geometric_normal(2), Vec3::ZERO);
    assert_eq!(mesh.area(0), 0.5);
}
