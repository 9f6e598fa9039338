//! Corners far from the origin: what starts on a wall, however near another one, starts on the inner side of both.

use enf_geometry::{Query, Ray, Structure, StructureKind, TileMesh};
use enf_layout::NONE;
use enf_layout::bsp::LeafRecord;
use enf_layout::material::MaterialRecord;
use enf_rooms::Bsp;
use enf_transport::flight::{self, Resident};
use enf_transport::rng::{self, Purpose};
use enf_transport::vector;
use glam::{Quat, Vec3};

/// Twelve triangles of a cube of 4 m that is 60 m away and turned, and its corners.
fn cube(turn: Quat) -> ([Vec3; 8], Vec<[[f32; 3]; 3]>) {
    let corner = |i: usize| {
        let p = [i & 1, i >> 1 & 1, i >> 2].map(|bit| if bit == 1 { 2.0f32 } else { -2.0 });
        turn * Vec3::from(p) + Vec3::new(60.0, 41.0, -30.0)
    };
    let corners: [Vec3; 8] = std::array::from_fn(corner);
    let faces =
        [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]);
    (corners, triangles.map(|t| t.map(|i| corners[i].to_array())).collect())
}

#[test]
fn nothing_leaves_a_cube_at_its_edges() {
    let delta = 64.0 * 2f32.powi(-19);
    let turns = [
        Quat::IDENTITY,
        Quat::from_rotation_z(0.5),
        Quat::from_euler(glam::EulerRot::XYZ, 0.3, 0.8, 1.9),
    ];
    for (which, turn) in turns.into_iter().enumerate() {
        let (corners, triangles) = cube(turn);
        let mesh =
            TileMesh::build_blob(triangles.iter().enumerate().map(|(i, &t)| (i as u32, 0, t)));
        let view = TileMesh::from_blob(&mesh).expect("a mesh");
        let mut blob = StructureKind::Bvh.build(&view, delta);
        StructureKind::Bvh.complete(&mut blob, &view).expect("of this mesh");
        let structure =
            Structure::from_blob(StructureKind::Bvh, &blob, view, delta).expect("a structure");
        let leaves =
            [LeafRecord { room: 0, tile: 0, first_face: 0, face_count: 0, flags: 0, reserved: 0 }];
        let bsp = Bsp::new(&[], &[], &leaves, &[], f64::from(delta)).expect("one leaf");
        let tile = Resident {
            tile: 0,
            bsp: &bsp,
            structure: &structure,
            materials: &[MaterialRecord::BLACK],
            texturing: Default::default(),
            delta,
        };
        let centre = Vec3::new(60.0, 41.0, -30.0);
        let mut starts = 0;
        for i in 0..200_000u32 {
            let u = rng::uniforms(5, Purpose::Probe, which as u32, i, 0, 0);
            let v = rng::uniforms(5, Purpose::Probe, which as u32, i, 0, 1);
            // At a point of an edge or a corner, give or take a few micrometres.
            let from = (u[0] * 8.0) as usize;
            let to = from ^ (1 << (u[1] * 3.0) as usize);
            let along = if i % 8 == 0 { 0.0 } else { u[2] };
            let off = (Vec3::new(v[0], v[1], v[2]) - 0.5) * if i % 2 == 0 { 0.0 } else { 2e-5 };
            let target = corners[from].lerp(corners[to], along) + off;
            let direction = (target - centre).normalize();
            let ask = |origin, direction, exclude| Query {
                ray: Ray { origin, direction },
                t_min: 0.0,
                t_max: f32::INFINITY,
                exclude,
            };
            let hit = structure.nearest(&ask(centre, direction, NONE)).expect("the cube is closed");
            let surface = flight::surface(&tile, &hit, direction);
            let inside = turn.inverse().as_dquat() * (surface.origin - centre).as_dvec3();
            let clear = 2.0 - inside.abs().max_element();
            assert!(clear > f64::from(delta) / 16.0, "{inside} is {clear} inside");
            for j in 0..4 {
                let w = rng::uniforms(5, Purpose::Scatter, which as u32, i, j, 0);
                let onward = vector::cosine(surface.normal, w[0], w[1]);
                let next = structure.nearest(&ask(surface.origin, onward, hit.global));
                assert!(next.is_some(), "lost from {} along {onward}", surface.origin);
                starts += 1;
            }
        }
        assert_eq!(starts, 800_000);
    }
}
