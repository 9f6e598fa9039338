//! Grid and hierarchy against testing every triangle, to the bit.

mod common;

use common::{Corners, Random, blob, delta};
use enf_geometry::{
    BvhView, GridView, NONE, PreparedRay, Ray, Structure, StructureKind, TileMesh, build_bvh,
    build_grid, bvh_bytes_estimate, grid_bytes_estimate, nearest_by_force,
};
use enf_layout::codec;
use glam::Vec3;
use proptest::prelude::*;

const KINDS: [StructureKind; 2] = [StructureKind::Grid, StructureKind::Bvh];

fn compare(
    triangles: &[Corners],
    rays: impl IntoIterator<Item = Ray>,
    delta: f32,
    seed: u64,
) -> usize {
    let mut random = Random(seed);
    let mesh_blob = blob(triangles);
    let mesh = TileMesh::from_blob(&mesh_blob).unwrap();
    let grid_blob = build_grid(&mesh, delta);
    assert!(grid_blob.len() as u64 <= grid_bytes_estimate(triangles.len() as u64));
    let grid = GridView::from_blob(&grid_blob, mesh.len()).unwrap();
    let bvh_blob = build_bvh(&mesh, delta);
    assert!(bvh_blob.len() as u64 <= bvh_bytes_estimate(triangles.len() as u64));
    let bvh = BvhView::from_blob(&bvh_blob, mesh.len()).unwrap();
    let mut hits = 0;
    for ray in rays {
        let prepared = PreparedRay::new(&ray);
        let (mut from, mut to, mut exclude) = (0.0, f32::INFINITY, NONE);
        // Walk through everything on the way, as transport does, with a few odd intervals.
        for round in 0..6 {
            let truth = nearest_by_force(&mesh, &prepared, from, to, exclude, delta);
            let found = grid.nearest(&mesh, &prepared, from, to, exclude, delta);
            assert_eq!(found, truth, "{ray:?} in [{from}, {to}) without {exclude}");
            let by_bvh = bvh.nearest(&mesh, &prepared, from, to, exclude, delta);
            assert_eq!(by_bvh, truth, "{ray:?} in [{from}, {to}) without {exclude}");
            let portable = bvh.nearest_portable(&mesh, &prepared, from, to, exclude, delta);
            assert_eq!(portable, truth, "{ray:?} in [{from}, {to}) without {exclude}");
            match found {
                Some(hit) => {
                    hits += 1;
                    exclude = hit.global;
                    from = if random.below(3) == 0 { hit.t.next_up() } else { hit.t };
                    if round == 2 {
                        to = from + 10.0 * random.unit();
                    }
                }
                None => {
                    (from, to, exclude) = (f32::NEG_INFINITY, f32::INFINITY, NONE);
                    if random.below(2) == 0 {
                        to = 10.0 * random.unit();
                    }
                }
            }
        }
    }
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

#[test]
fn ties_go_to_the_smaller_global_index() {
    let wall = [Vec3::ZERO, 4.0 * Vec3::X, 4.0 * Vec3::Y];
    let turned = [wall[1], wall[2], wall[0]];
    let mesh_blob = blob(&[turned, wall, wall, turned]);
    let mesh = TileMesh::from_blob(&mesh_blob).unwrap();
    let delta = delta(4.0);
    let ray = Ray { origin: Vec3::new(1.0, 1.0, 2.0), direction: Vec3::NEG_Z };
    let ray = PreparedRay::new(&ray);
    for kind in KINDS {
        let blob = kind.build(&mesh, delta);
        let structure = Structure::from_blob(kind, &blob, 4).unwrap();
        let nearest = |exclude| structure.nearest(&mesh, &ray, 0.0, 9.0, exclude, delta).unwrap();
        assert_eq!((nearest(NONE).global, nearest(NONE).t), (1, 2.0));
        assert_eq!(nearest(1).global, 4);
        // The interval is half open.
        assert!(structure.nearest(&mesh, &ray, 0.0, 2.0, NONE, delta).is_none());
        assert!(structure.nearest(&mesh, &ray, 2.0, 9.0, NONE, delta).is_some());
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
        let mesh = TileMesh::from_blob(mesh_blob).unwrap();
        for delta in [0.0, 1e-4, f32::NAN, f32::MAX] {
            let blobs = KINDS.map(|kind| kind.build(&mesh, delta));
            let [grid, bvh] =
                [0, 1].map(|k| Structure::from_blob(KINDS[k], &blobs[k], mesh.len()).unwrap());
            for i in 0..512 {
                let pick = |k: usize| x[(i >> (3 * k)) & 7];
                let d = Vec3::new(pick(0), pick(1), pick(2));
                let o = Vec3::new(pick(2), 0.5, pick(1));
                for direction in [d, -d] {
                    let ray = PreparedRay::new(&Ray { origin: o, direction });
                    for (from, to) in
                        [(0.0, 1.0), (f32::NEG_INFINITY, f32::INFINITY), (f32::NAN, f32::NAN)]
                    {
                        let truth = nearest_by_force(&mesh, &ray, from, to, NONE, delta);
                        assert_eq!(grid.nearest(&mesh, &ray, from, to, NONE, delta), truth);
                        assert_eq!(bvh.nearest(&mesh, &ray, from, to, NONE, delta), truth);
                    }
                }
            }
        }
    }
    assert!(empty.is_empty());
}

/// Every byte of a blob, flipped: rejected, or walked without leaving it.
#[test]
fn a_corrupt_structure_is_rejected_or_harmless() {
    let mut random = Random(21);
    let triangles = common::zoo(&mut random, 12, 4.0);
    let mesh_blob = blob(&triangles);
    let mesh = TileMesh::from_blob(&mesh_blob).unwrap();
    let rays: Vec<_> =
        (0..8).map(|_| PreparedRay::new(&common::ray(&mut random, &triangles, 4.0))).collect();
    for kind in KINDS {
        let good = kind.build(&mesh, delta(4.0));
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 1 << random.below(8);
            if let Ok(structure) = Structure::from_blob(kind, &bad, mesh.len()) {
                for ray in &rays {
                    structure.nearest(&mesh, ray, 0.0, f32::INFINITY, NONE, delta(4.0));
                }
            }
        }
        // The last 63 bytes may be padding.
        for length in 0..good.len() - 63 {
            assert!(Structure::from_blob(kind, &good[..length], mesh.len()).is_err());
        }
        assert!(Structure::from_blob(kind, &good, mesh.len() + 1).is_err());
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
