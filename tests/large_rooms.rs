//! A room with more photons than a piece of a map has: built in a small budget, the same bytes in any.

mod common;

use common::{bin, copy_store, digest, fails, furnished, json, light, number, ok};
use enf_layout::segment::{ExtentKind, StageKind};
use enf_store::{StageReader, StoreDir};
use std::path::{Path, PathBuf};

/// All rooms as one, and its photons: 3 lamps of 220,000 make some 800,000 indirect ones, two pieces at least.
fn traced(dir: &Path) -> PathBuf {
    let scene = furnished(dir);
    let store = dir.join("b.enf");
    ok(bin("enf-partition").arg(&scene).arg("-o").arg(&store).args(["--rooms", "1", "--quiet"]));
    ok(bin("enf-grid").arg(&store).arg("--quiet"));
    ok(bin("enf-trace").arg(&store).args(["--quiet", "--photons-per-light", "220k"]));
    store
}

#[test]
fn a_map_in_pieces_is_the_same_for_any_budget_and_threads() {
    let dir = tempfile::tempdir().unwrap();
    let whole = traced(dir.path());
    let mut digests = Vec::new();
    let mut pictures = Vec::new();
    for (memory, threads) in [("56M", "1"), ("64M", "2"), ("1G", "2")] {
        let stats = dir.path().join("stats.json");
        let store = dir.path().join(format!("{memory}.enf"));
        copy_store(&whole, &store, &[]);
        ok(bin("enf-kdtree")
            .arg(&store)
            .args(["--quiet", "--memory", memory, "--threads", threads, "--stats"])
            .arg(&stats));
        let stats = json(&stats);
        let photons = number(&stats, "map_photons");
        assert!(photons > 600_000.0, "{photons} photons are one piece");
        let peak = number(&stats, "memory.peak_resident_bytes");
        let budget = number(&stats, "memory.budget_bytes");
        assert!(peak <= budget, "{peak} of {budget} bytes");
        digests.push(digest(&store, "maps"));
        let picture = dir.path().join(format!("{memory}.hdr"));
        ok(bin("enf-render")
            .arg(&store)
            .args(["--view", "door", "--width", "64", "--height", "40", "--samples", "1"])
            .args(["--quiet", "--memory", "128M", "--threads", threads, "-o"])
            .arg(&picture));
        pictures.push(std::fs::read(&picture).unwrap());
    }
    assert!(digests.iter().all(|d| *d == digests[0]), "{digests:?}");
    assert!(pictures.iter().all(|p| *p == pictures[0]), "another picture");
}

/// Rooms with doorways, whose maps are cut into dozens of small pieces: with all of them in memory, or eight at a time for each job,
/// the same pictures, seen directly and by final gathering, with one thread and with several.
#[test]
fn maps_in_part_answer_as_whole_ones_do() {
    let dir = tempfile::tempdir().unwrap();
    let store = light(&furnished(dir.path()), "30k", &[], &["--piece-photons", "2000"]);
    let reader = StageReader::open(&StoreDir::open(&store).unwrap(), StageKind::Kdtree).unwrap();
    let pieces = |room| reader.find(ExtentKind::Map, room).len();
    let most = (0..3).map(pieces).max().unwrap();
    assert!(most >= 12, "{most} pieces");
    for indirect in ["photon-map", "final-gather"] {
        let mut pictures = Vec::new();
        for (memory, threads) in
            [(None, "2"), (Some("1K"), "1"), (Some("1K"), "3"), (Some("600K"), "2")]
        {
            let stats = dir.path().join("stats.json");
            let picture = dir.path().join("door.exr");
            let mut command = bin("enf-render");
            command.arg(&store).args(["--view", "door", "--width", "48", "--height", "32"]);
            // Few photons for an estimate: it reaches into few pieces, as it does where these are of half a million.
            command.args(["--samples", "2", "--gather-photons", "16"]);
            command.args(["--indirect", indirect, "--threads", threads]);
            command.args(["--quiet", "--force", "--stats"]).arg(&stats).arg("-o").arg(&picture);
            if let Some(memory) = memory {
                command.args(["--map-memory", memory]);
            }
            ok(&mut command);
            let in_part = number(&json(&stats), "maps_in_part");
            assert_eq!(in_part > 0.0, memory.is_some(), "{in_part} maps in part with {memory:?}");
            pictures.push(std::fs::read(&picture).unwrap());
        }
        assert!(pictures.iter().all(|p| *p == pictures[0]), "{indirect}: another picture");
    }
}

/// A budget that does not hold what is needed of a map at once is refused before anything is begun, and the answer says which one would
/// do. (In a room without openings that is all of the map: an estimate reaches as far as it must.)
#[test]
fn a_map_that_does_not_fit_is_refused_with_what_would_do() {
    let dir = tempfile::tempdir().unwrap();
    let store = traced(dir.path());
    ok(bin("enf-kdtree").arg(&store).arg("--quiet"));
    let render = |memory: &str| {
        let mut command = bin("enf-render");
        command.arg(&store).args(["--all-rooms", "--quiet", "--view", "door"]);
        command.args(["--width", "64", "--height", "40", "--samples", "1", "--memory", memory]);
        command.args(["--threads", "1", "--stats"]).arg(dir.path().join("stats.json"));
        command.arg("-o").arg(dir.path().join("door.png"));
        command
    };
    let said = fails(&mut render("40M"), 3);
    assert!(said.contains("photon map") && said.contains("would do"), "{said}");
    assert!(!common::files_of(&store).iter().any(|f| f.starts_with("render.")), "nothing is begun");
    let memory = said.split("--memory ").nth(1).and_then(|rest| rest.split(' ').next());
    ok(&mut render(memory.unwrap()));
    let stats = json(&dir.path().join("stats.json"));
    let peak = number(&stats, "memory.peak_resident_bytes");
    let budget = number(&stats, "memory.budget_bytes");
    assert!(peak <= budget, "{peak} of {budget} bytes");
}

/// The room whose map does not fit is the one with the largest tile: it is seen in part, in what is free beside all else.
#[test]
fn a_map_that_fits_in_part_is_not_refused() {
    let dir = tempfile::tempdir().unwrap();
    let store = light(&furnished(dir.path()), "400k", &[], &["--piece-photons", "20000"]);
    for indirect in ["photon-map", "final-gather"] {
        let (stats, picture) = (dir.path().join("stats.json"), dir.path().join("door.exr"));
        let render = |memory: &str| {
            let mut command = bin("enf-render");
            command.arg(&store).args(["--view", "door", "--width", "48", "--height", "32"]);
            command.args(["--samples", "1", "--gather-photons", "16", "--indirect", indirect]);
            command.args(["--quiet", "--force", "--threads", "1", "--memory", memory, "--stats"]);
            command.arg(&stats).arg("-o").arg(&picture);
            command
        };
        ok(&mut render("1G"));
        assert_eq!(number(&json(&stats), "maps_in_part"), 0.0);
        let whole = std::fs::read(&picture).unwrap();
        let said = fails(&mut render("24M"), 3);
        let needs = said.split("needs ").nth(1).and_then(|s| s.split(' ').next()).unwrap();
        let needs: u64 = needs.parse().unwrap_or_else(|_| panic!("{said}"));
        ok(&mut render(&format!("{}M", needs + 1)));
        assert!(number(&json(&stats), "maps_in_part") > 0.0, "{indirect}: {needs} MiB hold it all");
        assert!(std::fs::read(&picture).unwrap() == whole, "{indirect}: another picture");
    }
}

/// Pieces so small that an estimate reaches into more of them than a job has room for: that is said, with what may help, and nothing is written.
#[test]
fn where_too_many_pieces_meet_it_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let store = light(&furnished(dir.path()), "5k", &[], &["--piece-photons", "20"]);
    let picture = dir.path().join("door.png");
    let mut render = bin("enf-render");
    render.arg(&store).args([
        "--view",
        "door",
        "--width",
        "24",
        "--height",
        "16",
        "--samples",
        "1",
    ]);
    render.args(["--gather-photons", "400", "--map-memory", "1K", "-o"]).arg(&picture);
    let said = fails(&mut render, 3);
    assert!(said.contains("many pieces") && said.contains("try --memory "), "{said}");
    assert!(!picture.exists());
}
