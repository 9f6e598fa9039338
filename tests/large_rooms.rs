//! A room with more photons than a piece of a map has: built in a small budget, the same bytes in any.

mod common;

use common::{bin, copy_store, digest, fails, furnished, json, number, ok};

/// 3 lamps of 220,000 photons make some 800,000 indirect ones: two pieces at least.
#[test]
fn a_map_in_pieces_is_the_same_for_any_budget_and_threads() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let store = dir.path().join("b.enf");
    ok(bin("enf-partition").arg(&scene).arg("-o").arg(&store).args(["--rooms", "1", "--quiet"]));
    ok(bin("enf-grid").arg(&store).arg("--quiet"));
    ok(bin("enf-trace").arg(&store).args(["--quiet", "--photons-per-light", "220k"]));
    let mut digests = Vec::new();
    let mut pictures = Vec::new();
    for (memory, threads) in [("56M", "1"), ("64M", "2"), ("1G", "2")] {
        let stats = dir.path().join("stats.json");
        let traced = &store;
        let store = dir.path().join(format!("{memory}.enf"));
        copy_store(traced, &store, &[]);
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

/// Some three million photons are six pieces; in a budget where no room is left for all of them, they come and go: the same picture. In
/// one that does not hold what is needed at once, the answer says how much would.
#[test]
fn a_map_that_does_not_fit_is_seen_piece_by_piece() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let store = dir.path().join("b.enf");
    ok(bin("enf-partition").arg(&scene).arg("-o").arg(&store).args(["--rooms", "1", "--quiet"]));
    ok(bin("enf-grid").arg(&store).arg("--quiet"));
    ok(bin("enf-trace").arg(&store).args(["--quiet", "--photons-per-light", "900k"]));
    ok(bin("enf-kdtree").arg(&store).args(["--quiet", "--memory", "1G"]));
    let render = |memory: &str, threads: &str, flags: &[&str], to: &str| {
        // What is finished is not made again.
        for file in common::files_of(&store).iter().filter(|f| f.starts_with("render.")) {
            std::fs::remove_file(store.join(file)).unwrap();
        }
        let mut command = bin("enf-render");
        command.arg(&store).args(["--all-rooms", "--quiet", "--view", "door"]);
        command.args(["--width", "64", "--height", "40", "--samples", "2", "--memory", memory]);
        command.args(["--threads", threads, "--stats"]).arg(dir.path().join("stats.json"));
        command.args(flags).arg("-o").arg(dir.path().join(to));
        command
    };
    let gather = ["--indirect", "final-gather", "--gather-rays", "2"];
    for (kind, flags) in [&[][..], &gather[..]].into_iter().enumerate() {
        let mut pictures = Vec::new();
        for (memory, threads, paged) in
            [("1G", "2", false), ("144M", "1", true), ("144M", "2", true)]
        {
            let name = format!("{kind}-{memory}-{threads}.exr");
            ok(&mut render(memory, threads, flags, &name));
            let stats = json(&dir.path().join("stats.json"));
            assert_eq!(number(&stats, "maps_in_part") > 0.0, paged, "{memory}");
            let peak = number(&stats, "memory.peak_resident_bytes");
            let budget = number(&stats, "memory.budget_bytes");
            assert!(peak <= budget, "{peak} of {budget} bytes");
            pictures.push(std::fs::read(dir.path().join(name)).unwrap());
        }
        assert!(pictures.iter().all(|p| *p == pictures[0]), "another picture");
    }
    let said = fails(&mut render("72M", "1", &[], "small.exr"), 3);
    assert!(said.contains("photon map") && said.contains("would do"), "{said}");
    // And it does.
    let memory =
        said.split("--memory ").nth(1).and_then(|rest| rest.split(' ').next()).map(str::to_owned);
    ok(&mut render(&memory.unwrap(), "1", &[], "small.exr"));
    let [small, whole] = ["small.exr", "0-1G-2.exr"].map(|f| std::fs::read(dir.path().join(f)));
    assert!(small.unwrap() == whole.unwrap(), "another picture");
}
