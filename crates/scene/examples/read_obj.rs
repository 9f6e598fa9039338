//! How fast a scene is read and streamed, and what it keeps:
//! `cargo run --release -p enf-scene --example read_obj -- FILE [spool above, MiB]`.

use enf_scene::{LoadOptions, Spool, load};
use std::{path::PathBuf, time::Instant};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args_os().skip(1);
    let Some(path) = args.next().map(PathBuf::from) else {
        return Err("give a scene".into());
    };
    let above = match args.next() {
        Some(mib) => Some(mib.to_string_lossy().parse::<u64>()? << 20),
        None => None,
    };
    let spool = above.map(|above| Spool { folder: std::env::temp_dir(), above });
    let size = std::fs::metadata(&path)?.len() as f64 / 1e6;
    let begin = Instant::now();
    let scene = load(&path, &LoadOptions { spool, ..LoadOptions::default() })?;
    let read = begin.elapsed().as_secs_f64();
    let begin = Instant::now();
    let mut sum = 0.0;
    scene.for_each_triangle(|t| sum += f64::from(t.corners[0][0]))?;
    let streamed = begin.elapsed().as_secs_f64();
    let n = scene.triangle_count();
    println!(
        "{size:.0} MB, {n} triangles ({sum:.3}): read in {read:.2} s = {:.0} MB/s",
        size / read
    );
    println!("streamed in {streamed:.2} s = {:.1} M triangles/s", n as f64 / streamed / 1e6);
    println!("keeps {:.1} MB", scene.resident_bytes() as f64 / 1e6);
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    println!("{}", status.lines().find(|l| l.starts_with("VmHWM")).unwrap_or_default());
    Ok(())
}
