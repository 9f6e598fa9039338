//! Any building, in the budget: what the kernel says is resident stays below `--memory`, and what cannot work is
//! refused before work begins, with a sentence that says what would do.

mod common;

use common::{
    PICTURE, bin, bin_path, copy_store, digest, fails, furnished, json, number, ok, stderr,
};
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

const MIB: f64 = 1024.0 * 1024.0;

/// Runs a stage and watches from outside how much of it the kernel calls resident, in MiB. The figure only grows, so
/// that the last look before the end misses next to nothing.
fn watched(command: &mut Command) -> (Output, f64) {
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut peak: f64 = 0.0;
    loop {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let now = text
            .lines()
            .find_map(|l| l.strip_prefix("VmHWM:"))
            .and_then(|rest| rest.trim().trim_end_matches("kB").trim().parse::<f64>().ok());
        peak = peak.max(now.unwrap_or(0.0) / 1024.0);
        if child.try_wait().unwrap().is_some() {
            break;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{command:?}: {}", stderr(&output));
    (output, peak)
}

#[test]
fn every_stage_stays_resident_below_64_mib() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let store = dir.path().join("b.enf");
    for name in common::STAGES {
        let stats = dir.path().join("stats.json");
        let mut command = Command::new(bin_path(name));
        match name {
            "enf-partition" => command.arg(&scene).arg("-o").arg(&store),
            _ => command.arg(&store),
        };
        match name {
            // Ten times what the budget could hold at once, if it were all kept.
            "enf-trace" => {
                command.args(["--photons-per-light", "150k"]);
            }
            "enf-render" => {
                command.args([
                    "--view",
                    "all",
                    "--width",
                    "640",
                    "--height",
                    "480",
                    "--samples",
                    "1",
                    "-o",
                ]);
                command.arg(dir.path().join("pictures"));
            }
            _ => {}
        }
        command.args(["--memory", "64M", "--quiet", "--stats"]).arg(&stats);
        let (_, seen) = watched(&mut command);
        let stats = json(&stats);
        let said = number(&stats, "memory.peak_resident_bytes") / MIB;
        let reserved = number(&stats, "memory.peak_reserved_bytes") / MIB;
        assert_eq!(number(&stats, "memory.budget_bytes"), 64.0 * MIB);
        assert!(seen <= 64.0 && said <= 64.0, "{name}: {seen:.1} MiB seen, {said:.1} said");
        assert!(seen <= said + 4.0, "{name}: {seen:.1} MiB seen from outside, {said:.1} reported");
        assert!(reserved <= 64.0, "{name}: {reserved:.1} MiB reserved");
    }
}

#[test]
fn one_process_for_everything_stays_below_64_mib() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let out = dir.path().join("out");
    let mut command = Command::new(bin_path("enfilade"));
    command.arg("run").arg(&scene).arg("-o").arg(&out).args([
        "--memory",
        "64M",
        "--quiet",
        "--photons-per-light",
        "60k",
        "--view",
        "all",
        "--width",
        "320",
        "--height",
        "200",
        "--samples",
        "2",
    ]);
    let (_, seen) = watched(&mut command);
    let stats = json(&out.join("stats.json"));
    let said = number(&stats, "memory.peak_resident_bytes") / MIB;
    assert!(seen <= 64.0 && said <= 64.0, "{seen:.1} MiB seen, {said:.1} said");
    assert_eq!(stats["stages"].as_array().unwrap().len(), 5);
}

/// From hopeless to ample, for every stage: a budget is kept by the kernel's own figure, or refused before anything
/// is begun, with the number that would do.
#[test]
fn small_budgets_are_kept_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let store = dir.path().join("b.enf");
    let stats = dir.path().join("stats.json");
    for name in common::STAGES {
        let mut worked = 0;
        for memory in ["0", "1", "100K", "2M", "4M", "6M", "8M", "12M", "16M", "24M", "48M"] {
            let before = if store.exists() { common::files_of(&store) } else { Vec::new() };
            let mut command = bin(name);
            match name {
                "enf-partition" => command.arg(&scene).arg("-o").arg(&store),
                _ => command.arg(&store),
            };
            match name {
                "enf-trace" => {
                    command.args(["--photons-per-light", "2k"]);
                }
                "enf-render" => {
                    command.args(["--view", "door", "--width", "48", "--height", "32", "-o"]);
                    command.arg(dir.path().join("door.png"));
                }
                _ => {}
            }
            let _ = std::fs::remove_file(&stats);
            let output =
                command.args(["--memory", memory, "--stats"]).arg(&stats).output().unwrap();
            let said = stderr(&output);
            match output.status.code() {
                Some(0) => {
                    worked += 1;
                    let report = json(&stats);
                    let (peak, budget) = (
                        number(&report, "memory.peak_resident_bytes"),
                        number(&report, "memory.budget_bytes"),
                    );
                    assert!(peak <= budget, "{name} {memory}: {:.2} MiB resident", peak / MIB);
                }
                Some(3) => {
                    assert_eq!(worked, 0, "{name} {memory}: less was enough; {said}");
                    assert!(
                        said.contains(" needs ") || said.contains(" takes "),
                        "{name} {memory}: {said}"
                    );
                    assert!(
                        said.contains("64M") || said.contains("--memory "),
                        "{name} {memory}: {said}"
                    );
                    if name == "enf-partition" {
                        assert!(!store.exists() || common::files_of(&store).is_empty());
                    } else {
                        assert_eq!(
                            common::files_of(&store),
                            before,
                            "{name} {memory} began nothing"
                        );
                    }
                }
                code => panic!("{name} {memory}: {code:?} {said}"),
            }
            // Once done, there is nothing to do with more memory.
            if worked > 0 && name != "enf-partition" {
                break;
            }
        }
        assert!(worked > 0, "{name} worked with none");
    }
}

/// Whoever follows the advice of refusals arrives, and soon.
#[test]
fn refusals_lead_to_a_budget_that_works() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let out = dir.path().join("out");
    let mut memory = String::from("8M");
    for _ in 0..6 {
        let output = bin("enfilade")
            .arg("run")
            .arg(&scene)
            .arg("-o")
            .arg(&out)
            .args(["--photons-per-light", "1k"])
            .args(PICTURE)
            .args(["--memory", &memory])
            .output()
            .unwrap();
        let said = stderr(&output);
        match output.status.code() {
            Some(0) => return,
            Some(3) => {
                let advice =
                    said.split("--memory ").nth(1).and_then(|s| s.split_whitespace().next());
                let advice = advice.unwrap_or_else(|| panic!("no advice in: {said}"));
                assert_ne!(advice, memory, "{said}");
                memory = advice.to_string();
            }
            code => panic!("{memory}: {code:?} {said}"),
        }
    }
    panic!("six refusals; the last advice was {memory}");
}

/// A refusal says what would have been enough, and that is enough.
#[test]
fn the_advice_of_a_refusal_is_good() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let store = dir.path().join("b.enf");
    ok(bin("enf-partition").arg(&scene).arg("-o").arg(&store).args(["--rooms", "1", "--quiet"]));
    ok(bin("enf-grid").arg(&store).arg("--quiet"));
    ok(bin("enf-trace").arg(&store).args(["--quiet", "--photons-per-light", "150k"]));
    let said = fails(bin("enf-kdtree").arg(&store).args(["--memory", "24M"]), 3);
    assert!(said.contains("room 0") || said.contains("room 1"), "{said}");
    let advice = said.split("--memory ").nth(1).and_then(|s| s.split('M').next()).unwrap_or("");
    let advised: u64 = advice.parse().unwrap_or_else(|_| panic!("no advice in: {said}"));
    assert!((25..200).contains(&advised), "{advised} MiB for a few MiB of photons");
    let stats = dir.path().join("stats.json");
    let memory = format!("{advised}M");
    ok(bin("enf-kdtree").arg(&store).args(["--memory", &memory, "--stats"]).arg(&stats));
    let peak = number(&json(&stats), "memory.peak_resident_bytes") / MIB;
    assert!(peak <= advised as f64, "{peak:.1} of {advised} MiB");
}

/// The partition was cut for more memory than a later stage is given.
#[test]
fn a_tile_that_does_not_fit_is_named() {
    let dir = tempfile::tempdir().unwrap();
    // One room full of small things: 180,000 triangles in one tile.
    let mut model = common::Model::default();
    model.object("box");
    model.material("white");
    model.cuboid([0.0; 3], [8.0, 8.0, 3.0], true);
    model.object("things");
    for i in 0..15_000 {
        let [x, y, z] = [7919, 104_729, 1_299_709].map(|p| f64::from(i * p % 10_007) / 10_007.0);
        model.turned([0.4 + 7.2 * x, 0.4 + 7.2 * y, 0.1 + 2.5 * z], [0.02, 0.03, 0.04], 360.0 * x);
    }
    model.object("lamp");
    model.material("lamp");
    model.quad([[3.0, 3.0, 2.9], [3.0, 5.0, 2.9], [5.0, 5.0, 2.9], [5.0, 3.0, 2.9]]);
    let scene = dir.path().join("things.obj");
    model.write(&scene, common::MATERIALS);
    let (big, small) = (dir.path().join("big.enf"), dir.path().join("small.enf"));
    ok(bin("enf-partition").arg(&scene).arg("-o").arg(&big).args(["--memory", "1G", "--quiet"]));
    let untouched = dir.path().join("untouched.enf");
    copy_store(&big, &untouched, &[]);
    let said = fails(bin("enf-grid").arg(&big).args(["--memory", "16M"]), 3);
    assert!(said.contains("room ") && said.contains("enf-partition --memory"), "{said}");
    ok(bin("enf-grid").arg(&big).args(["--memory", "1G", "--quiet"]));
    let trace = ["--photons-per-light", "2k", "--quiet"];
    let said = fails(bin("enf-trace").arg(&big).args(trace).args(["--memory", "16M"]), 3);
    assert!(said.contains("room ") && said.contains("enf-partition --memory"), "{said}");
    ok(bin("enf-trace").arg(&big).args(trace));
    // Cut small enough, the small budget does it, with the same photons.
    let tiles = ["--tile-triangles", "4000", "--quiet"];
    ok(bin("enf-partition").arg(&scene).arg("-o").arg(&small).args(tiles));
    ok(bin("enf-grid").arg(&small).args(["--memory", "24M", "--quiet"]));
    ok(bin("enf-trace").arg(&small).args(trace).args(["--memory", "24M"]));
    assert_eq!(digest(&small, "photons"), digest(&big, "photons"));
}

#[test]
fn memory_that_is_no_size_is_a_usage_error() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    for nonsense in ["nonsense", "-1", "12Q", "", "1e9", "380MB", "99999999999999999999G"] {
        let flag = format!("--memory={nonsense}");
        let said = fails(bin("enf-partition").arg(&scene).args(["-o", "x.enf", &flag]), 2);
        assert!(said.contains("--memory"), "{said}");
        let run = |command: &mut Command| fails(command.arg(&flag), 2);
        run(bin("enfilade").arg("run").arg(&scene).args(["-o", "x"]));
        run(bin("enf-trace").arg("x.enf"));
    }
    assert!(!Path::new("x.enf").exists());
}

/// Pictures are written when all else is done: a budget in which that could not be is refused before anything is begun.
#[test]
fn a_picture_too_wide_to_be_written_is_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let store = common::light(&furnished(dir.path()), "1k", &[], &[]);
    let render = |memory: &str| {
        let mut command = bin("enf-render");
        command.arg(&store).args(["--view", "door", "--width", "24000", "--height", "1"]);
        command.args(["--samples", "1", "--quiet", "--memory", memory]);
        command.arg("-o").arg(dir.path().join("wide.png"));
        command
    };
    let said = fails(&mut render("100M"), 3);
    assert!(said.contains("would do") && said.contains("--width"), "{said}");
    assert!(!common::files_of(&store).iter().any(|f| f.starts_with("render.")), "nothing is begun");
    let memory = said.split("--memory ").nth(1).and_then(|rest| rest.split(' ').next());
    ok(&mut render(memory.unwrap()));

    // Where a film of something else is finished, which would make way for it, as well.
    let seal = || std::fs::read(store.join("render.seal")).unwrap();
    let (before, door) = (seal(), dir.path().join("door.png"));
    let mut other = bin("enf-render");
    other.arg(&store).args(["--view", "hall", "--memory", "16M", "--quiet", "-o"]).arg(&door);
    let said = fails(&mut other, 3);
    assert!(said.contains("would do"), "{said}");
    assert_eq!(seal(), before, "it is still there");
}
