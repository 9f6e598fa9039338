//! What a hierarchy costs: `bvh_build RAYS SCENE...`, where `SCENE.vtx` holds vertices (three `f32` each) and
//! `SCENE.idx` triangles (three `u32` each).
//!
//! For every scene: triangles built a second, bytes a triangle in memory and on disk, resident bytes made a second from what
//! was on disk, and rays a second (the walks of photons, one after the other and in batches of ten thousand).

#[path = "../tests/common/mod.rs"]
mod common;

use std::time::Instant;

use common::Random;
use enf_geometry::{
    BvhView, NONE, Query, Ray, TileMesh, build_bvh, bvh_bytes_estimate, complete_bvh,
};
use enf_layout::codec;

/// The triangles of a scene.
fn read(scene: &str) -> std::io::Result<Vec<[[f32; 3]; 3]>> {
    let words = |file: &str| -> std::io::Result<Vec<[u8; 4]>> {
        let bytes = std::fs::read(format!("{scene}.{file}"))?;
        Ok(bytes.as_chunks::<4>().0.to_vec())
    };
    let vertices: Vec<f32> = words("vtx")?.into_iter().map(f32::from_le_bytes).collect();
    let indices: Vec<u32> = words("idx")?.into_iter().map(u32::from_le_bytes).collect();
    let vertices = vertices.as_chunks::<3>().0;
    Ok(indices.as_chunks::<3>().0.iter().map(|t| t.map(|i| vertices[i as usize])).collect())
}

/// Processor time of this thread, s (in steps of some milliseconds), so that other work on the machine disturbs less; where
/// the system does not tell, time that has gone by since `start`.
fn now(start: &Instant) -> f64 {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = told.and_then(|s| s.split(' ').next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(|| start.elapsed().as_secs_f64(), |n| n * 1e-9)
}

/// What something takes, s: the median of five times, each long enough to be measured.
fn time(mut what: impl FnMut()) -> f64 {
    let mut times: Vec<f64> = (0..5)
        .map(|_| {
            let first = Instant::now();
            let (start, mut rounds) = (now(&first), 0);
            loop {
                what();
                rounds += 1;
                let gone = now(&first) - start;
                if gone > 0.1 {
                    return gone / f64::from(rounds);
                }
            }
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[2]
}

/// Walks of photons through a room: each query begins where the one before ended.
fn walks(mesh: &TileMesh, bvh: &BvhView, rays: usize) -> Vec<Query> {
    let mut random = Random(7);
    let bounds = mesh.bounds();
    let middle = bounds.center();
    let (mut origin, mut exclude) = (middle, NONE);
    let mut queries = Vec::with_capacity(rays);
    for i in 0..rays {
        let mut direction = random.direction();
        if exclude != NONE {
            let normal = mesh.geometric_normal(exclude);
            if normal.dot(direction) * normal.dot(origin - middle) > 0.0 {
                direction = -direction;
            }
        }
        let ray = Ray { origin, direction };
        let query = Query { ray, t_min: 0.0, t_max: f32::INFINITY, exclude };
        queries.push(query);
        match bvh.nearest(&query) {
            Some(hit) if i % 17 != 0 => {
                origin = ray.at(hit.t);
                exclude = hit.global;
            }
            _ => {
                origin = bounds.min + random.in_box(bounds.max - bounds.min);
                exclude = NONE;
            }
        }
    }
    queries
}

fn measure(scene: &str, rays: usize) -> Result<(), Box<dyn std::error::Error>> {
    let soup = read(scene)?;
    let triangles = soup.len() as f64;
    let mesh_blob = TileMesh::build_blob(soup.iter().enumerate().map(|(i, &t)| (i as u32, 0, t)));
    let mesh = TileMesh::from_blob(&mesh_blob)?;
    let delta = 32.0 / (1 << 19) as f32;
    let mut blob = Vec::new();
    let building = time(|| blob = build_bvh(&mesh, delta));
    let mut coded = vec![0; blob.len()];
    codec::forward(&blob, &mut coded)?;
    let disk = zstd::bulk::compress(&coded, 3)?;
    let sections: Vec<String> = enf_layout::sections::table(&blob)?
        .iter()
        .map(|r| {
            let bytes = &coded[r.offset as usize..(r.offset + r.bytes) as usize];
            let packed = zstd::bulk::compress(bytes, 3).map_or(0, |p| p.len());
            format!("{:.2}", packed as f64 / triangles)
        })
        .collect();
    let mesh_disk = {
        let mut coded = vec![0; mesh_blob.len()];
        codec::forward(&mesh_blob, &mut coded)?;
        zstd::bulk::compress(&coded, 3)?.len()
    };
    // From compressed bytes to what rays walk through, in three steps.
    let mut scratch = vec![0; codec::scratch_bytes(&coded)?];
    let mut inflater = zstd::bulk::Decompressor::new()?;
    let mut step = |steps: usize| {
        let _ = inflater.decompress_to_buffer(&disk, &mut blob[..]);
        if steps > 1 {
            let _ = codec::inverse(&mut blob, &mut scratch);
        }
        if steps > 2 {
            let _ = complete_bvh(&mut blob, &mesh);
        }
    };
    let [one, two, three] = [1, 2, 3].map(|steps| time(|| step(steps)));
    let bvh = BvhView::from_blob(&blob, &mesh, delta)?;
    let size = blob.len() as f64;
    println!("{scene}: {triangles} triangles");
    println!(
        "  built: {:.2} M triangles/s, {:.0}% of the bytes promised, {:.2} triangles a block, {:.2} blocks a node",
        triangles / building / 1e6,
        100.0 * size / bvh_bytes_estimate(soup.len() as u64) as f64,
        triangles / bvh.block_count() as f64,
        bvh.block_count() as f64 / bvh.node_count() as f64,
    );
    println!(
        "  bytes a triangle: {:.1} in memory, {:.2} on disk (sections {}); mesh on disk {:.2}",
        size / triangles,
        disk.len() as f64 / triangles,
        sections.join(" + "),
        mesh_disk as f64 / triangles,
    );
    println!(
        "  ready: {:.2} GB/s of resident bytes (inflating {:.1}, transform {:.1}, completing {:.2} GB/s)",
        size / three / 1e9,
        size / one / 1e9,
        size / (two - one) / 1e9,
        size / (three - two) / 1e9,
    );
    if rays > 0 {
        let queries = walks(&mesh, &bvh, rays);
        let mut answers = vec![None; rays];
        let mut length = 0.0;
        let single = time(|| {
            length = 0.0;
            for query in &queries {
                length += bvh.nearest(query).map_or(0.0, |hit| f64::from(hit.t));
            }
        });
        let batch = time(|| {
            for (q, a) in queries.chunks(10_000).zip(answers.chunks_mut(10_000)) {
                bvh.nearest_batch(q, a);
            }
        });
        println!(
            "  rays: {:.2} M/s single, {:.2} M/s in batches (lengths add up to {length})",
            rays as f64 / single / 1e6,
            rays as f64 / batch / 1e6,
        );
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let rays = arguments.next().and_then(|a| a.parse().ok()).unwrap_or(0);
    for scene in arguments {
        measure(&scene, rays)?;
    }
    Ok(())
}
