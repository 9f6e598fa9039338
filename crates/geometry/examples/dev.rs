//! Rays per second in a furnished room, grid and hierarchy in turn: `ray_bench [triangles] [rays]`.
//!
//! The room is 20 x 15 x 4 m, its walls tessellated, its furniture boxes and spheres of all sizes.
//! Rays are incoherent: diffuse bounces from random places, one after the other, as photons are.

use std::time::Instant;

use enf_geometry::{
    BvhView, GridView, NONE, Query, Ray, TileMesh, build_bvh, build_grid, complete_bvh,
    grid_bytes_estimate,
};
use enf_layout::codec;
use glam::Vec3;

struct Random(u64);

impl Random {
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 24) as f32
    }

    fn in_box(&mut self, size: Vec3) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit()) * size
    }

    fn direction(&mut self) -> Vec3 {
        loop {
            let p = 2.0 * self.in_box(Vec3::ONE) - Vec3::ONE;
            let square = p.length_squared();
            if square > 1e-4 && square <= 1.0 {
                return p / square.sqrt();
            }
        }
    }
}

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

fn room(target: usize, random: &mut Random) -> Vec<[[f32; 3]; 3]> {
    let size = Vec3::new(20.0, 15.0, 4.0);
    let mut out = Vec::new();
    cuboid(&mut out, ((target / 60) as f32).sqrt() as usize + 1, Vec3::ZERO, size);
    while out.len() < target {
        let scale = 0.05 + random.unit() * random.unit();
        let mut at = random.in_box(size - 2.0 * scale);
        at.z *= random.unit() * 0.5;
        if random.unit() < 0.6 {
            cuboid(&mut out, 1 + (random.unit() * 3.0) as usize, at, random.in_box(size) * 0.1);
        } else {
            let sphere = |s: f32, t: f32| {
                let (a, b) = (s * std::f32::consts::TAU, t * std::f32::consts::PI);
                let (a, b) = (sin_cos(a), sin_cos(b));
                at + scale + scale * Vec3::new(a.1 * b.0, a.0 * b.0, b.1)
            };
            patch(&mut out, 12 + (random.unit() * 12.0) as usize, sphere);
        }
    }
    out.truncate(target);
    out
}

fn sin_cos(x: f32) -> (f32, f32) {
    (libm::sinf(x), libm::cosf(x))
}

fn scene() -> Vec<[[f32; 3]; 3]> {
    let p = std::env::var("SCENE").unwrap();
    let v = std::fs::read(format!("{p}.vtx")).unwrap();
    let i = std::fs::read(format!("{p}.idx")).unwrap();
    let f = |k: usize| f32::from_le_bytes(v[4 * k..4 * k + 4].try_into().unwrap());
    i.chunks_exact(12)
        .map(|t| {
            [0, 1, 2].map(|c| {
                let k = u32::from_le_bytes(t[4 * c..4 * c + 4].try_into().unwrap()) as usize;
                [f(3 * k), f(3 * k + 1), f(3 * k + 2)]
            })
        })
        .collect()
}

fn main() {
    let mut arguments = std::env::args().skip(1).filter_map(|a| a.parse().ok());
    let triangles: usize = arguments.next().unwrap_or(60_000);
    let rays: usize = arguments.next().unwrap_or(2_000_000);
    let mut random = Random(7);
    let soup = scene();
    let _ = triangles;
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
    let mut bvh_blob = build_bvh(&mesh, delta);
    let built = start.elapsed();
    let stored_bvh = bvh_blob.clone();
    complete_bvh(&mut bvh_blob, &mesh).unwrap();
    let start = Instant::now();
    let bvh = BvhView::from_blob(&bvh_blob, &mesh, delta).expect("a hierarchy that was just built");
    println!(
        "hierarchy: {} bytes ({:.1} a triangle), {} nodes, built in {built:?}, checked in {:?}",
        bvh_blob.len(),
        bvh_blob.len() as f64 / mesh.len() as f64,
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
    let mut walks: Vec<(Ray, u32)> = Vec::with_capacity(rays);
    let bb = mesh.bounds();
    let mid = 0.5 * (bb.min + bb.max);
    let mut origin = mid;
    let mut last = NONE;
    let directions: Vec<Vec3> = (0..1 << 16).map(|_| random.direction()).collect();
    for i in 0..rays {
        let mut direction = directions[i & 0xFFFF];
        if last != NONE {
            let normal = mesh.geometric_normal(last);
            if normal.dot(direction) * normal.dot(origin - mid) > 0.0 {
                direction = -direction;
            }
        }
        let ray = Ray { origin, direction };
        walks.push((ray, last));
        match bvh.nearest(&Query { ray, t_min: 0.0, t_max: f32::INFINITY, exclude: last }) {
            Some(hit) if i % 17 != 0 => {
                origin = ray.at(hit.t);
                last = hit.global;
            }
            _ => {
                origin = bb.min + random.in_box(bb.max - bb.min);
                last = NONE;
            }
        }
    }
    type Nearest<'a> = &'a dyn Fn(&Query) -> Option<enf_geometry::Hit>;
    let ways: [(&str, Nearest<'_>); 3] = [
        ("grid", &|q| grid.nearest(q)),
        ("hierarchy", &|q| bvh.nearest(q)),
        ("hierarchy, portable", &|q| bvh.nearest_portable(q)),
    ];
    let queries: Vec<Query> = walks
        .iter()
        .map(|(r, l)| Query { ray: *r, t_min: 0.0, t_max: f32::INFINITY, exclude: *l })
        .collect();
    if std::env::var("M4").is_ok() {
        return;
    }
    let mut answers = vec![None; queries.len()];
    for n in [1usize, 4, 16, 64, 256, 1024, 16384] {
        let some: Vec<Query> = queries.iter().skip(1000).cycle().take(n).cloned().collect();
        let s = Instant::now();
        let mut c = 0;
        for _ in 0..200000 / n {
            for q in &some {
                c += bvh.nearest(q).is_some() as usize;
            }
        }
        println!("same {n}: {:.1} ns", s.elapsed().as_secs_f64() * 1e9 / c as f64);
    }
    let mut bt = vec![];
    for _ in 0..9 {
        let s = Instant::now();
        for (q, a) in queries.chunks(10000).zip(answers.chunks_mut(10000)) {
            bvh.nearest_batch(q, a);
        }
        bt.push(s.elapsed().as_secs_f64());
    }
    bt.sort_by(f64::total_cmp);
    println!(
        "batch: {:.2} M rays/s, {:.1} ns, best {:.2}",
        rays as f64 / bt[4] / 1e6,
        bt[4] / rays as f64 * 1e9,
        rays as f64 / bt[0] / 1e6
    );
    for (q, a) in queries.iter().zip(&answers) {
        assert_eq!(bvh.nearest(q), *a);
    }
    // In turn, so that what else the machine does falls on all of them; medians.
    let mut times = [const { Vec::new() }; 3];
    let mut sums = [0.0f64; 3];
    for _ in 0..5 {
        for (k, (_, nearest)) in ways.iter().enumerate() {
            let start = Instant::now();
            let mut length = 0.0;
            for (ray, last) in &walks {
                if let Some(hit) =
                    nearest(&Query { ray: *ray, t_min: 0.0, t_max: f32::INFINITY, exclude: *last })
                {
                    length += f64::from(hit.t);
                }
            }
            sums[k] = length;
            times[k].push(start.elapsed().as_secs_f64());
        }
    }
    assert!(sums[0] == sums[1] && sums[1] == sums[2], "not the same hits: {sums:?}");
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
