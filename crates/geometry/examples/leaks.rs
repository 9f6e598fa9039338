//! Rays inside closed surfaces, as many as one likes: none may get out.
//!
//! ```text
//! cargo run --release -p enf-geometry --example leaks -- 1e9 [seed]
//! ```
//!
//! All cores, all surfaces of the leak test in turn. Most rays go through the hierarchy in batches; some one by one, as
//! shadow rays, or through the grid; one batch in 64 in all ways, with all sets of instructions. Which rays they are depends on the seed and on how many batches there are,
//! not on threads. A ray that gets out is printed in bits, and the exit code is 1; bad arguments give 2.

#[path = "../tests/common/mod.rs"]
mod common;

use std::io::Write;
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use common::closed::{Closed, surfaces};
use common::{Blobs, Random, Tile, anything, spelt};
use enf_geometry::Query;

const BATCH: u64 = 8192;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, otherwise: f64| match arguments.get(i) {
        None => Some(otherwise),
        Some(text) => text.parse().ok().filter(|n: &f64| (0.0..=1e15).contains(n)),
    };
    let (Some(rays), Some(seed), true) = (number(0, 1e7), number(1, 1.0), arguments.len() < 3)
    else {
        eprintln!(
            "leaks: how many rays (1e7), and a seed (1); numbers up to 1e15, not {arguments:?}"
        );
        return ExitCode::from(2);
    };
    let batches = (rays as u64).div_ceil(BATCH);
    let seed = Random(seed as u64).bits();

    let surfaces = surfaces();
    let blobs: Vec<Blobs> = surfaces.iter().map(|s| Blobs::new(&s.triangles, s.delta)).collect();
    let places: Vec<(&Closed, Tile<'_>)> =
        surfaces.iter().zip(blobs.iter().map(Blobs::tile)).collect();

    let start = Instant::now();
    let (next, done) = (AtomicU64::new(0), AtomicU64::new(0));
    let stop = AtomicBool::new(false);
    let misses: Mutex<Vec<String>> = Mutex::new(Vec::new());
    let work = || {
        while !stop.load(Ordering::Relaxed) {
            let batch = next.fetch_add(1, Ordering::Relaxed);
            if batch >= batches {
                break;
            }
            let (surface, tile) = &places[(batch % places.len() as u64) as usize];
            let mut random = Random(seed ^ batch.wrapping_mul(0xA076_1D64_78BD_642F));
            let queries: Vec<Query> =
                (0..BATCH).map(|_| anything(surface.ray(&mut random))).collect();
            let lost = lost(tile, &queries, batch / places.len() as u64);
            if !lost.is_empty() {
                stop.store(true, Ordering::Relaxed);
                let lines = lost.iter().map(|(way, query)| {
                    format!("lost in batch {batch}, {}, by {way}: {}", surface.name, spelt(query))
                });
                if let Ok(mut all) = misses.lock() {
                    all.extend(lines);
                }
            }
            done.fetch_add(BATCH, Ordering::Relaxed);
        }
    };
    std::thread::scope(|scope| {
        let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        let mut last = Instant::now();
        while workers.iter().any(|w| !w.is_finished()) {
            std::thread::sleep(Duration::from_millis(20));
            if last.elapsed() > Duration::from_secs(2) {
                last = Instant::now();
                let (done, s) =
                    (done.load(Ordering::Relaxed) as f64, start.elapsed().as_secs_f64());
                eprint!("\r{:.3e} of {:.3e} rays, {:.2} M/s ", done, rays, done / s / 1e6);
                let _ = std::io::stderr().flush();
            }
        }
    });
    eprintln!();
    let misses = misses.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
    let rays = done.load(Ordering::Relaxed);
    println!(
        "{rays} rays in {} closed surfaces, {} lost, {:.1} s",
        places.len(),
        misses.len(),
        start.elapsed().as_secs_f64()
    );
    for line in &misses {
        println!("{line}");
    }
    ExitCode::from(u8::from(!misses.is_empty()))
}

/// The rays that hit nothing, asked in one way or another; one batch in 64 in all.
fn lost(tile: &Tile<'_>, queries: &[Query], round: u64) -> Vec<(&'static str, Query)> {
    match round % 64 {
        0 => queries
            .iter()
            .flat_map(|query| {
                let hits = tile.ways(query).into_iter().map(|(way, hit)| (way, hit.is_some()));
                let ways = hits.chain(tile.shadows(query));
                ways.filter(|&(_, hit)| !hit).map(|(way, _)| (way, *query))
            })
            .collect(),
        16 => {
            let missed = |query: &&Query| tile.grid.nearest(query).is_none();
            queries.iter().filter(missed).map(|query| ("grid", *query)).collect()
        }
        32 => {
            let missed = |query: &&Query| tile.bvh.nearest(query).is_none();
            queries.iter().filter(missed).map(|query| ("hierarchy", *query)).collect()
        }
        48 => {
            let mut hit = vec![false; queries.len()];
            tile.bvh.occluded_batch(queries, &mut hit);
            let missed = queries.iter().zip(hit).filter(|(_, hit)| !hit);
            missed.map(|(query, _)| ("batch of shadow rays", *query)).collect()
        }
        _ => {
            let answers = tile.batch(queries);
            let missed = queries.iter().zip(answers).filter(|(_, hit)| hit.is_none());
            missed.map(|(query, _)| ("batch", *query)).collect()
        }
    }
}
