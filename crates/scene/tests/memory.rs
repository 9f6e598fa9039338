//! A model larger than what it may take is read and streamed in a few MiB, as the kernel counts them.

use enf_scene::{LoadOptions, Spool, load};
use std::{
    fmt::Write as _,
    fs::File,
    io::{BufWriter, Write as _},
    path::Path,
    process::Command,
};

/// Tells the child process which file to read.
const FILE: &str = "ENF_SCENE_MEMORY_TEST";

/// Peak resident set of this process, KiB.
fn peak() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|l| l.starts_with("VmHWM:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

/// A wavy floor of quads, row by row, in objects of 50 rows.
fn write_model(path: &Path, n: usize) {
    let mut out = BufWriter::new(File::create(path).unwrap());
    let mut text = String::new();
    for y in 0..n {
        text.clear();
        if y % 50 == 0 {
            writeln!(text, "o strip {y}\nusemtl m{}", y % 3).unwrap();
        }
        for x in 0..n {
            let h = libm::sin(x as f64 * 0.7) * libm::cos(y as f64 * 0.3);
            writeln!(text, "v {:.6} {:.6} {h:.6}", x as f64 * 0.013, y as f64 * 0.013).unwrap();
        }
        for x in 0..if y == 0 { 0 } else { n - 1 } {
            let a = (y - 1) * n + x + 1;
            writeln!(text, "f {a} {} {} {}", a + 1, a + n + 1, a + n).unwrap();
        }
        out.write_all(text.as_bytes()).unwrap();
    }
    out.flush().unwrap();
}

/// What the child process does: reads, streams, looks for lights.
#[test]
fn child() {
    let Some(path) = std::env::var_os(FILE) else { return };
    let before = peak();
    let spool = Spool { folder: std::env::temp_dir(), above: 1 << 20 };
    let options = LoadOptions { spool: Some(spool), ..LoadOptions::default() };
    let scene = load(Path::new(&path), &options).unwrap();
    let mut n = 0;
    scene.for_each_triangle(|_| n += 1).unwrap();
    assert_eq!(n, scene.triangle_count());
    assert!(scene.lights().unwrap().records.is_empty());
    println!("PEAK {} {} {}", peak() - before, n, scene.resident_bytes());
}

#[test]
fn a_large_model_is_read_in_a_few_mebibytes() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("large.obj");
    // 640,000 vertices and 1,276,802 triangles: 30 MB in memory, 50 MB of text.
    write_model(&path, 800);
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "child", "--nocapture", "--test-threads", "1"])
        .env(FILE, &path)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{said}");
    let line = said.lines().find_map(|l| l.split_once("PEAK ")).expect("a figure").1;
    let figures: Vec<u64> = line.split_whitespace().map(|w| w.parse().unwrap()).collect();
    assert_eq!(figures[1], 2 * 799 * 799);
    assert!(figures[0] < 14 << 10, "{} KiB more than before", figures[0]);
    assert!(figures[2] < 64 << 10, "it says that it keeps {} bytes", figures[2]);
}
