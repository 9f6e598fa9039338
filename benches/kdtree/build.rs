//! Compiles the few lines of C++ beside nanoflann, if its header is found (`NANOFLANN_INCLUDE`, or where Debian's
//! libnanoflann-dev puts it). Without it the bench does without.

use std::path::Path;

fn main() {
    println!("cargo::rustc-check-cfg=cfg(nanoflann)");
    println!("cargo::rerun-if-env-changed=NANOFLANN_INCLUDE");
    println!("cargo::rerun-if-changed=src/nanoflann.cpp");
    let folder = std::env::var("NANOFLANN_INCLUDE").unwrap_or_else(|_| "/usr/include".into());
    if !Path::new(&folder).join("nanoflann.hpp").exists() {
        println!(
            "cargo::warning=no nanoflann.hpp in {folder}: set NANOFLANN_INCLUDE, or apt install libnanoflann-dev"
        );
        return;
    }
    let mut build = cc::Build::new();
    build.cpp(true).std("c++17").opt_level(3).include(folder).file("src/nanoflann.cpp");
    // As a user would who compiles for the machine at hand; our own code chooses its instructions when it runs.
    build.flag_if_supported("-march=native");
    if build.try_compile("bench_nanoflann").is_ok() {
        println!("cargo::rustc-cfg=nanoflann");
    } else {
        println!("cargo::warning=nanoflann does not compile here");
    }
}
