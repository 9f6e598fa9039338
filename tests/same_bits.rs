//! The same bits every time: for any threads, budget, tiling, queue, cache and schedule. Photons are the same over any
//! partition at all; maps and pictures over everything that leaves the rooms alone.

mod common;

use common::{bin, digest, furnished, json, number, ok};
use serde_json::Value;
use std::path::{Path, PathBuf};

const VIEWS: [&str; 6] = ["--view", "all", "--view", "auto", "--view", "room:0"];

/// What a variant of a run takes.
#[derive(Clone, Copy, Default)]
struct Variant<'a> {
    partition: &'a [&'a str],
    /// For all stages after it.
    later: &'a [&'a str],
    /// For the two stages in which something flies.
    queue: &'a [&'a str],
}

struct Made {
    store: PathBuf,
    partition: Value,
    trace: Value,
    render: Value,
    photons: String,
}

fn make(scene: &Path, dir: &Path, name: &str, variant: Variant<'_>) -> Made {
    let store = dir.join(format!("{name}.enf"));
    let stats = |stage: &str| dir.join(format!("{name}-{stage}.json"));
    ok(bin("enf-partition")
        .arg(scene)
        .arg("-o")
        .arg(&store)
        .args(["--quiet", "--stats"])
        .arg(stats("partition"))
        .args(variant.partition));
    ok(bin("enf-grid").arg(&store).arg("--quiet").args(variant.later));
    ok(bin("enf-trace")
        .arg(&store)
        .args(["--quiet", "--photons-per-light", "3k", "--stats"])
        .arg(stats("trace"))
        .args(variant.later)
        .args(variant.queue));
    Made {
        photons: digest(&store, "photons"),
        partition: json(&stats("partition")),
        trace: json(&stats("trace")),
        render: Value::Null,
        store,
    }
}

/// Maps and pictures of a traced store: the digest, and the bytes of every picture.
fn finish(made: &mut Made, variant: Variant<'_>) -> (String, Vec<(String, Vec<u8>)>) {
    let folder = made.store.with_extension("pictures");
    let stats = made.store.with_extension("render.json");
    ok(bin("enf-kdtree").arg(&made.store).arg("--quiet").args(variant.later));
    ok(bin("enf-render")
        .arg(&made.store)
        .args(["--quiet", "--width", "48", "--height", "36", "--samples", "2"])
        .args(VIEWS)
        .arg("-o")
        .arg(&folder)
        .arg("--stats")
        .arg(&stats)
        .args(variant.later)
        .args(variant.queue));
    made.render = json(&stats);
    let pictures: Vec<(String, Vec<u8>)> = common::files_of(&folder)
        .into_iter()
        .map(|name| (name.clone(), std::fs::read(folder.join(name)).unwrap()))
        .collect();
    assert!(pictures.len() >= 10, "at least five views, PNG and EXR");
    (digest(&made.store, "maps"), pictures)
}

fn ledger_closes(made: &Made) {
    let n = |key: &str| number(&made.trace, key);
    assert_eq!(n("photons_emitted"), 9000.0);
    assert_eq!(n("photons_emitted"), n("photons_absorbed") + n("photons_escaped"));
}

fn same_pictures(a: &[(String, Vec<u8>)], b: &[(String, Vec<u8>)], what: &str) {
    for ((name, one), (_, other)) in a.iter().zip(b) {
        assert!(one == other, "{what}: {name} differs");
    }
}

#[test]
fn threads_memory_and_tiles_change_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let base = Variant::default();
    let mut first = make(&scene, dir.path(), "base", base);
    let (maps, pictures) = finish(&mut first, base);
    ledger_closes(&first);
    let rooms = number(&first.partition, "rooms");
    assert!(rooms >= 3.0);

    let v = |partition, later, queue| Variant { partition, later, queue };
    let variants = [
        ("one-thread", v(&["--threads", "1"], &["--threads", "1"], &[])),
        ("five-threads", v(&["--threads", "5"], &["--threads", "5"], &[])),
        ("small", v(&["--memory", "64M"], &["--memory", "64M"], &[])),
        ("large", v(&["--memory", "2G"], &["--memory", "2G"], &[])),
        ("nine-tiles", v(&["--random-tiles", "9"], &[], &[])),
        ("forty-tiles", v(&["--random-tiles", "40", "--seed", "5"], &["--threads", "2"], &[])),
        ("tile-size", v(&["--tile-triangles", "200"], &[], &["--schedule", "most-work"])),
        ("most-work", v(&[], &[], &["--schedule", "most-work"])),
    ];
    for (name, variant) in variants {
        let mut made = make(&scene, dir.path(), name, variant);
        ledger_closes(&made);
        assert_eq!(made.photons, first.photons, "{name}");
        assert_eq!(number(&made.partition, "rooms"), rooms, "{name}");
        let (its_maps, its_pictures) = finish(&mut made, variant);
        assert_eq!(its_maps, maps, "{name}");
        same_pictures(&its_pictures, &pictures, name);
        let tiles = number(&made.partition, "tiles");
        match name {
            "nine-tiles" => assert!(tiles >= 9.0),
            "forty-tiles" => assert!(tiles >= 40.0),
            "tile-size" => assert!(tiles > number(&first.partition, "tiles")),
            _ => {}
        }
        std::fs::remove_dir_all(&made.store).unwrap();
    }
}

#[test]
fn spills_evictions_and_reloads_change_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let base = Variant::default();
    let mut first = make(&scene, dir.path(), "base", base);
    let (maps, pictures) = finish(&mut first, base);
    let tight: &[&str] = &["--queue-rows", "4", "--queue-block", "64", "--resident-rooms", "1"];
    let tightest: &[&str] = &[
        "--queue-rows",
        "1",
        "--queue-block",
        "3",
        "--resident-rooms",
        "1",
        "--schedule",
        "most-work",
    ];
    for (name, queue) in [("tight", tight), ("tightest", tightest)] {
        let variant =
            Variant { partition: &["--random-tiles", "20"], later: &["--threads", "2"], queue };
        let mut made = make(&scene, dir.path(), name, variant);
        ledger_closes(&made);
        assert_eq!(made.photons, first.photons, "{name}");
        let (its_maps, its_pictures) = finish(&mut made, variant);
        assert_eq!(its_maps, maps, "{name}");
        same_pictures(&its_pictures, &pictures, name);
        for (stage, stats) in [("trace", &made.trace), ("render", &made.render)] {
            let n = |key: &str| number(stats, key);
            // Rays from two eyes need few rows at once.
            if stage == "trace" || name == "tightest" {
                assert!(
                    n("table.evictions") > 0.0,
                    "{name} {stage}: no row had to make way: {stats:#}"
                );
            }
            assert!(n("table.spilled_blocks") > 0.0, "{name} {stage}: nothing was spilled");
            assert!(n("io.spilled_records") >= n("table.spilled_blocks"));
            let loaded = number(&made.partition, "tiles") - n("io.rooms_never_loaded");
            assert!(n("io.room_loads") > loaded, "{name} {stage}: no tile was loaded twice");
        }
    }
}

#[test]
fn photons_are_the_same_over_any_rooms() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let first = make(&scene, dir.path(), "auto", Variant::default());
    let variants: [(&str, &[&str]); 6] = [
        ("1", &["--rooms", "1"]),
        ("2", &["--rooms", "2"]),
        ("5", &["--rooms", "5"]),
        ("12", &["--rooms", "12"]),
        ("1-tiled", &["--rooms", "1", "--random-tiles", "13"]),
        ("12-tiled", &["--rooms", "12", "--random-tiles", "30", "--seed", "3"]),
    ];
    for (name, flags) in variants {
        let made =
            make(&scene, dir.path(), name, Variant { partition: flags, ..Variant::default() });
        ledger_closes(&made);
        assert_eq!(made.photons, first.photons, "--rooms {name}");
        let rooms: f64 = name.split('-').next().unwrap().parse().unwrap();
        assert_eq!(number(&made.partition, "rooms"), rooms);
        let totals = |m: &Made| {
            ["photons_stored", "photons_absorbed", "photons_escaped", "reflections_max"]
                .map(|key| number(&m.trace, key))
        };
        assert_eq!(totals(&made), totals(&first), "--rooms {name}");
        let flux = |m: &Made, key: &str| number(&m.trace, key);
        for key in ["flux_emitted_w", "flux_absorbed_w", "flux_escaped_w"] {
            let (a, b) = (flux(&made, key), flux(&first, key));
            assert!((a - b).abs() <= 1e-9 * flux(&first, "flux_emitted_w"), "{key}: {a} and {b}");
        }
    }
}

#[test]
fn another_seed_is_another_result() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let one = make(&scene, dir.path(), "one", Variant::default());
    let two =
        make(&scene, dir.path(), "two", Variant { later: &["--seed", "2"], ..Variant::default() });
    assert_ne!(one.photons, two.photons);
    assert_eq!(digest(&one.store, "geometry"), digest(&two.store, "geometry"));
}
