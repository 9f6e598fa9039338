//! Photons balanced and gathers answered per second, on one thread, in a furnished box.
//!
//! `cargo bench -p enf-illumination --bench photon_map [-- PHOTONS THREADS]`

use std::time::Instant;

use enf_illumination::photon_map::*;
use enf_layout::octahedral;
use enf_layout::photon::PhotonRecord;
use enf_layout::rgbe;
use glam::Vec3;

#[path = "../tests/random/mod.rs"]
mod random;
use random::Random;

/// Impacts on the inside of a room of 6 x 5 x 3 m and on the outside of 20 boxes in it.
fn impacts(n: usize) -> Vec<PhotonRecord> {
    let mut r = Random(1);
    let mut boxes = vec![(Vec3::ZERO, Vec3::new(6.0, 5.0, 3.0), 1.0)];
    for _ in 0..20 {
        let low = Vec3::new(r.next() * 5.0, r.next() * 4.0, r.next() * 0.5);
        boxes.push((low, Vec3::new(r.next(), r.next(), r.next()) * 0.9 + 0.1, -1.0));
    }
    (0..n)
        .map(|_| {
            let number = (r.next() * 40.0) as usize;
            let (low, size, inward) = boxes[if number < boxes.len() { number } else { 0 }];
            let mut at = Vec3::new(r.next(), r.next(), r.next());
            let side = (r.next() * 6.0) as usize;
            let mut normal = Vec3::ZERO;
            at[side % 3] = if side >= 3 { 1.0 } else { 0.0 };
            normal[side % 3] = if side >= 3 { -inward } else { inward };
            let spread = Vec3::new(r.next() - 0.5, r.next() - 0.5, r.next() - 0.5);
            let flux = rgbe::encode([r.next(), r.next(), r.next()], [0.5; 3]);
            PhotonRecord {
                position_bits: (low + at * size).to_array().map(f32::to_bits),
                flux,
                directions: PhotonRecord::pack_directions(
                    octahedral::encode((spread - normal).normalize().to_array()),
                    octahedral::encode(normal.to_array()),
                ),
                flags: 0,
            }
        })
        .collect()
}

/// Seconds that this thread was on a processor, where the kernel tells; other work does not count.
fn busy() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split_whitespace().next()?.parse::<f64>().ok()? * 1e-9)
}

/// Seconds of work: of this thread, or by the clock when several share it.
fn seconds(threads: usize, work: impl FnOnce()) -> f64 {
    let (clock, start) = (Instant::now(), busy());
    work();
    match (start, busy()) {
        (Some(start), Some(end)) if threads == 1 => end - start,
        _ => clock.elapsed().as_secs_f64(),
    }
}

fn main() {
    let numbers: Vec<usize> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let n = numbers.first().copied().unwrap_or(100_000);
    let threads = numbers.get(1).copied().unwrap_or(1);
    let photons = impacts(n);
    let mut best = f64::INFINITY;
    let mut blob = vec![0; blob_bytes(n)];
    for _ in 0..3 {
        blob.fill(0);
        let build = || build_map(&photons, &mut blob, 1.0, [0, 1], threads);
        best = best.min(seconds(threads, build));
    }
    println!(
        "build_map       {n} photons, {threads} threads: {:.2} M photons/s",
        n as f64 / best / 1e6
    );
    let map = PhotonMap::from_blob(&blob).expect("the map was just built");
    let mut queries = photons;
    queries.truncate(20_000);
    let shuffled = queries.clone();
    let ordered: Vec<_> = map.photons().map(|(_, p)| p).take(20_000).collect();
    for k in [50u32, 200] {
        for kernel in [Kernel::Constant, Kernel::Cone] {
            for (name, queries) in [("random", &shuffled), ("in order", &ordered)] {
                let gather = Gather { photons: k, radius: 0.5, kernel };
                let mut scratch = GatherScratch::new(k);
                let mut found = 0u64;
                let mut t = f64::INFINITY;
                for _ in 0..5 {
                    found = 0;
                    let run = seconds(1, || {
                        for q in queries {
                            let (x, n) = (Vec3::from(q.position()), Vec3::from(q.normal()));
                            let e = map.irradiance(x, n, &gather, &PortalSet::none(), &mut scratch);
                            found += u64::from(e.photons);
                        }
                    });
                    t = t.min(run);
                }
                let rate = queries.len() as f64 / t / 1e3;
                let mean = found as f64 / queries.len() as f64;
                println!(
                    "irradiance      k = {k}, {kernel:?}, {name}: {rate:.0} K/s ({mean:.0} found)"
                );
            }
        }
    }
}
