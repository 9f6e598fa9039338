//! Rays per second in a furnished room, each structure and way of asking in turn: `ray_bench [triangles] [rays] [bust]`.
//!
//! The room is 20 x 15 x 4 m, its walls tessellated, its furniture boxes and spheres of all sizes. Of its triangles, `bust` (0 to 1, otherwise 0)
//! are in one ball of 20 cm in the middle.
//! Rays are incoherent: diffuse bounces from random places, one after the other, as photons are.

#[path = "../tests/common/mod.rs"]
mod common;

use std::time::Instant;

use common::Random;
use enf_geometry::{
    BvhView, GridView, Hit, NONE, Query, Ray, TileMesh, build_bvh, build_grid, complete_bvh,
    grid_bytes_estimate,
};
use enf_layout::codec;
use glam::Vec3;

/// An `n` x `n` patch of quadrilaterals.
fn patch(out: &mut Vec<[[f32; 3]; 3]>, n: usize, at: impl Fn(f32, f32) -> Vec3) {
    let p = |i: usize, j: usize| at(i as f32 / n as f32, j as f32 / n as f32).to_array();
    for i in 0..n {
        for j in 0..n {
            let (a, b, c, d) = (p(i, j), p(i + 1, j), p(i + 1, j + 1), p(i, j + 1));
            out.push([a, b, c]);
            out.push([a, c, d]);
        }
    }
}

fn cuboid(out: &mut Vec<[[f32; 3]; 3]>, n: usize, min: Vec3, size: Vec3) {
    let (x, y, z) = (Vec3::X * size, Vec3::Y * size, Vec3::Z * size);
    for (a, b, c) in [(x, y, z), (y, z, x), (z, x, y)] {
        patch(out, n, |s, t| min + s * b + t * a);
        patch(out, n, |s, t| min + c + s * a + t * b);
    }
}

fn room(all: usize, bust: f64, random: &mut Random) -> Vec<[[f32; 3]; 3]> {
    let size = Vec3::new(20.0, 15.0, 4.0);
    let mut out = Vec::new();
    let ball = |at: Vec3, scale: f32| {
        move |s: f32, t: f32| {
            let (a, b) = (s * std::f32::consts::TAU, t * std::f32::consts::PI);
            let (a, b) = (sin_cos(a), sin_cos(b));
            at + scale + scale * Vec3::new(a.1 * b.0, a.0 * b.0, b.1)
        }
    };
    let of_bust = all as f64 * bust.clamp(0.0, 1.0);
    patch(&mut out, (of_bust / 2.0).sqrt() as usize, ball(size / 2.0, 0.2));
    let in_bust = out.len();
    let target = all - in_bust;
    cuboid(&mut out, ((target / 60) as f32).sqrt() as usize + 1, Vec3::ZERO, size);
    while out.len() < all {
        let scale = 0.05 + random.unit() * random.unit();
        let mut at = random.in_box(size - 2.0 * scale);
        at.z *= random.unit() * 0.5;
        if random.unit() < 0.6 {
            cuboid(&mut out, 1 + (random.unit() * 3.0) as usize, at, random.in_box(size) * 0.1);
        } else {
            patch(&mut out, 12 + (random.unit() * 12.0) as usize, ball(at, scale));
        }
    }
    out.truncate(all);
    out
}

fn sin_cos(x: f32) -> (f32, f32) {
    (libm::sinf(x), libm::cosf(x))
}

fn main() {
    let mut arguments = std::env::args().skip(1).filter_map(|a| a.parse::<f64>().ok());
    let triangles = arguments.next().unwrap_or(60_000.0) as usize;
    let rays = arguments.next().unwrap_or(2e6) as usize;
    let bust = arguments.next().unwrap_or(0.0);
    let mut random = Random(7);
    let soup = room(triangles, bust, &mut random);
    let start = Instant::now();
    let blob = TileMesh::build_blob(soup.iter().enumerate().map(|(i, &t)| (i as u32, 0, t)));
    println!("mesh: {} triangles, {} bytes, {:?}", soup.len(), blob.len(), start.elapsed());
    let mesh = TileMesh::from_blob(&blob).expect("a mesh that was just built");

    let delta = 32.0 / (1 << 19) as f32;
    let start = Instant::now();
    let grid_blob = build_grid(&mesh, delta);
    let built = start.elapsed();
    let start = Instant::now();
    let grid = GridView::from_blob(&grid_blob, mesh, delta).expect("a grid that was just built");
    println!(
        "grid: {} bytes ({:.0}% of the estimate), built in {built:?}, checked in {:?}",
        grid_blob.len(),
        100.0 * grid_blob.len() as f64 / grid_bytes_estimate(mesh.triangles.len() as u64) as f64,
        start.elapsed()
    );
    println!("{:?}", grid.header());

    let start = Instant::now();
    let stored_bvh = build_bvh(&mesh, delta);
    let built = start.elapsed();
    let mut bvh_blob = stored_bvh.clone();
    complete_bvh(&mut bvh_blob, &mesh).expect("a hierarchy that was just built");
    let start = Instant::now();
    let bvh = BvhView::from_blob(&bvh_blob, &mesh, delta).expect("a hierarchy that was just built");
    println!(
        "hierarchy: {} bytes ({:.1} a triangle), {} nodes, {} blocks, built in {built:?}, checked in {:?}",
        bvh_blob.len(),
        bvh_blob.len() as f64 / mesh.len() as f64,
        bvh.node_count(),
        bvh.block_count(),
        start.elapsed()
    );

    let stored = |blob: &[u8]| {
        let mut coded = vec![0; blob.len()];
        codec::forward(blob, &mut coded).expect("a blob that was just built");
        zstd::bulk::compress(&coded, 3).expect("zstd").len() as f64 / mesh.len() as f64
    };
    println!(
        "on disk, bytes a triangle: mesh {:.2}, grid {:.2}, hierarchy {:.2}",
        stored(&blob),
        stored(&grid_blob),
        stored(&stored_bvh)
    );

    // Walks of photons, written down.
    let mut walks: Vec<Query> = Vec::with_capacity(rays);
    let mut origin = Vec3::new(10.0, 7.5, 2.0);
    let mut last: Option<Hit> = None;
    let directions: Vec<Vec3> = (0..1 << 16).map(|_| random.direction()).collect();
    for i in 0..rays {
        let mut direction = directions[i & 0xFFFF];
        if let Some(hit) = last {
            let [a, b, c] = bvh.corners(hit.slot);
            let normal = (b - a).cross(c - a);
            if normal.dot(direction) * normal.dot(Vec3::new(10.0, 7.5, 2.0) - origin) < 0.0 {
                direction = -direction;
            }
        }
        let exclude = last.map_or(NONE, |hit| hit.global);
        let query =
            Query { ray: Ray { origin, direction }, t_min: 0.0, t_max: f32::INFINITY, exclude };
        walks.push(query);
        last = bvh.nearest(&query).filter(|_| i % 17 != 0);
        origin = match last {
            Some(hit) => query.ray.at(hit.t),
            None => random.in_box(Vec3::new(20.0, 15.0, 4.0)),
        };
    }
    type Ask<'a> = &'a dyn Fn(&[Query], &mut [Option<Hit>]);
    let one_by_one =
        |nearest: &dyn Fn(&Query) -> Option<Hit>, q: &[Query], a: &mut [Option<Hit>]| {
            for (query, answer) in q.iter().zip(a) {
                *answer = nearest(query);
            }
        };
    let ways: [(&str, Ask<'_>); 4] = [
        ("grid", &|q, a| one_by_one(&|query| grid.nearest(query), q, a)),
        ("hierarchy", &|q, a| one_by_one(&|query| bvh.nearest(query), q, a)),
        ("hierarchy, portable", &|q, a| {
            one_by_one(&|query| bvh.nearest_with(enf_geometry::Instructions::Portable, query), q, a)
        }),
        ("hierarchy, batches", &|q, a| bvh.nearest_batch(q, a)),
    ];
    // In turn, so that what else the machine does falls on all of them; medians.
    let mut times = [const { Vec::new() }; 4];
    let mut answers = vec![vec![None; rays]; 4];
    for _ in 0..5 {
        for (k, (_, ask)) in ways.iter().enumerate() {
            let start = Instant::now();
            for (q, a) in walks.chunks(4096).zip(answers[k].chunks_mut(4096)) {
                ask(q, a);
            }
            times[k].push(start.elapsed().as_secs_f64());
        }
    }
    assert!(answers.iter().all(|a| *a == answers[0]), "not the same hits");
    for ((name, _), times) in ways.iter().zip(&mut times) {
        times.sort_by(f64::total_cmp);
        let median = times[times.len() / 2];
        println!(
            "{name}: {:.2} M rays/s, {:.1} ns each (median of {})",
            rays as f64 / median / 1e6,
            median / rays as f64 * 1e9,
            times.len()
        );
    }
}
