//! Nothing is lost and nothing is believed: for every file of a store, damage is either found and the file named, or
//! it lay in what a stage does not read and the result is exactly right. Never a panic, never another digest.

mod common;

use common::{
    bin, bin_path, copy_store, digest, fails, files_of, furnished, ok, shell, stage_name, stderr,
};
use rustix::process::{Pid, Signal, kill_process};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const PICTURE: [&str; 8] = ["--view", "door", "--width", "16", "--height", "12", "--samples", "1"];
const PHOTONS: [&str; 2] = ["--photons-per-light", "300"];

/// A finished store and what is right.
struct Whole {
    dir: tempfile::TempDir,
    store: PathBuf,
    grids: Vec<u8>,
    photons: String,
    maps: String,
    picture: Vec<u8>,
}

/// Runs a stage on a store; its picture, if it makes one, goes beside it.
fn stage(name: &str, store: &Path) -> Command {
    let mut command = bin(name);
    match name {
        "enf-partition" => {
            let scene = store.parent().unwrap().join("rooms.toml");
            command.arg(scene).arg("-o").arg(store);
        }
        "enf-trace" => {
            command.arg(store).args(PHOTONS);
        }
        "enf-render" => {
            command.arg(store).args(PICTURE).arg("-o").arg(store.with_extension("exr"));
        }
        _ => {
            command.arg(store);
        }
    }
    command.arg("--quiet");
    command
}

fn whole() -> Whole {
    let dir = tempfile::tempdir().unwrap();
    furnished(dir.path());
    let store = dir.path().join("whole.enf");
    for name in common::STAGES {
        ok(&mut stage(name, &store));
    }
    Whole {
        grids: std::fs::read(store.join("grid.000.000.dat")).unwrap(),
        photons: digest(&store, "photons"),
        maps: digest(&store, "maps"),
        picture: std::fs::read(store.with_extension("exr")).unwrap(),
        dir,
        store,
    }
}

impl Whole {
    /// Whether what a stage made in `store` is exactly what it makes of a sound store.
    fn is_right(&self, name: &str, store: &Path) -> bool {
        match name {
            "enf-partition" => digest(store, "geometry") == digest(&self.store, "geometry"),
            "enf-grid" => std::fs::read(store.join("grid.000.000.dat")).unwrap() == self.grids,
            "enf-trace" => digest(store, "photons") == self.photons,
            "enf-kdtree" => digest(store, "maps") == self.maps,
            _ => std::fs::read(store.with_extension("exr")).unwrap() == self.picture,
        }
    }
}

/// One way to damage a file.
#[derive(Clone, Copy, Debug)]
enum Damage {
    Flip(usize),
    Truncate(usize),
    Append,
    Delete,
}

impl Damage {
    fn apply(self, file: &Path) {
        let mut bytes = std::fs::read(file).unwrap();
        match self {
            Damage::Flip(at) => bytes[at] ^= 1 << (at % 8),
            Damage::Truncate(to) => bytes.truncate(to),
            Damage::Append => bytes.push(0),
            Damage::Delete => return std::fs::remove_file(file).unwrap(),
        }
        std::fs::write(file, bytes).unwrap();
    }
}

/// `count` flips: the first bytes, the last ones, the middle, and anywhere; always the same for one length.
fn flips(len: usize, count: usize) -> Vec<Damage> {
    let mut places = vec![0, len - 1, len / 2, 8, 20, 40, 64, 72, 96, len.saturating_sub(17)];
    let mut state = len as u64;
    while places.len() < count * 2 {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        places.push((state >> 33) as usize % len);
    }
    places.retain(|&p| p < len);
    // Few flips: some of the first, some from anywhere.
    let step = if count < 12 { 2 } else { 1 };
    let mut places: Vec<usize> = places.into_iter().step_by(step).take(count).collect();
    places.sort_unstable();
    places.dedup();
    places.into_iter().map(Damage::Flip).collect()
}

fn truncations(len: usize) -> Vec<Damage> {
    let mut to = vec![0, 1, 63, 64, len / 2, len - 1];
    to.retain(|&t| t < len);
    to.dedup();
    to.into_iter().map(Damage::Truncate).collect()
}

fn length(file: &Path) -> usize {
    std::fs::metadata(file).unwrap().len() as usize
}

#[test]
fn verify_names_the_file_of_every_damage() {
    let whole = whole();
    let sound = ok(bin("enfilade").arg("inspect").arg(&whole.store).arg("--verify"));
    assert_eq!(common::stdout(&sound).matches("sound").count(), 5);
    let names = files_of(&whole.store);
    assert_eq!(names.len(), 15, "a seal, a journal and a data file for each stage: {names:?}");
    for name in &names {
        let file = whole.store.join(name);
        let bytes = std::fs::read(&file).unwrap();
        let mut damages = flips(bytes.len(), 20);
        damages.extend(truncations(bytes.len()));
        damages.push(Damage::Append);
        if !name.ends_with(".seal") {
            damages.push(Damage::Delete);
        }
        for damage in damages {
            damage.apply(&file);
            let said = fails(bin("enfilade").arg("inspect").arg(&whole.store).arg("--verify"), 4);
            assert!(said.contains(name.as_str()), "{name} {damage:?}: {said}");
            std::fs::write(&file, &bytes).unwrap();
        }
    }
    ok(bin("enfilade").arg("inspect").arg(&whole.store).arg("--verify"));
}

/// Each stage against damage in each file of the stages before it.
#[test]
fn later_stages_refuse_or_are_right() {
    let whole = whole();
    let store = whole.dir.path().join("tried.enf");
    let (mut refused, mut right) = (0, 0);
    for (s, &made) in common::STAGES[..4].iter().enumerate() {
        let prefix = format!("{}.", stage_name(made));
        for name in files_of(&whole.store).iter().filter(|f| f.starts_with(&prefix)) {
            let len = length(&whole.store.join(name));
            let mut damages = flips(len, 7);
            damages.push(Damage::Truncate(len / 2));
            damages.push(Damage::Append);
            for (t, &reads) in common::STAGES.iter().enumerate().skip(s + 1) {
                for &damage in &damages {
                    copy_store(&whole.store, &store, &common::STAGES[t..]);
                    damage.apply(&store.join(name));
                    let output = stage(reads, &store).output().unwrap();
                    let said = stderr(&output);
                    match output.status.code() {
                        Some(0) => {
                            assert!(whole.is_right(reads, &store), "{reads}, {name} {damage:?}");
                            right += 1;
                        }
                        Some(4) => {
                            assert!(
                                said.contains(name.as_str()),
                                "{reads}, {name} {damage:?}: {said}"
                            );
                            refused += 1;
                        }
                        code => panic!("{reads} after {damage:?} of {name}: {code:?} {said}"),
                    }
                }
            }
        }
    }
    assert!(refused > 100 && right > 10, "{refused} refused, {right} right");
}

/// A stage that is run again on its own damaged output; `--force` makes it again.
#[test]
fn own_damage_is_refused_and_force_heals_it() {
    let whole = whole();
    furnished(whole.dir.path());
    let store = whole.dir.path().join("tried.enf");
    for name in files_of(&whole.store) {
        let made = common::STAGES
            .into_iter()
            .find(|s| name.starts_with(&format!("{}.", stage_name(s))))
            .unwrap();
        let len = length(&whole.store.join(&name));
        for damage in [
            Damage::Flip(len / 2),
            Damage::Flip(3),
            Damage::Truncate(len / 3),
            Damage::Flip(len - 3),
        ] {
            copy_store(&whole.store, &store, &[]);
            std::fs::write(store.with_extension("exr"), &whole.picture).unwrap();
            damage.apply(&store.join(&name));
            let output = stage(made, &store).output().unwrap();
            let said = stderr(&output);
            match output.status.code() {
                // It has nothing to do, and does not read what it would not use.
                Some(0) => assert!(!matches!(damage, Damage::Truncate(_)) || made == "enf-render"),
                Some(4) => {
                    assert!(said.contains(name.as_str()), "{name} {damage:?}: {said}");
                    assert!(said.contains("--force") || made == "enf-render", "{said}");
                }
                code => panic!("{made} after {damage:?} of {name}: {code:?} {said}"),
            }
            ok(stage(made, &store).arg("--force"));
            assert!(whole.is_right(made, &store), "{name} {damage:?} healed");
            ok(bin("enfilade").arg("inspect").arg(&store).arg("--verify"));
        }
    }
}

/// Damage in a stage that some rooms have been through.
#[test]
fn an_unfinished_map_stage_refuses_or_is_right() {
    let whole = whole();
    let half = whole.dir.path().join("half.enf");
    copy_store(&whole.store, &half, &["enf-kdtree", "enf-render"]);
    ok(&mut shell(whole.dir.path(), "seq 0 1 | \"$KDTREE\" half.enf --quiet"));
    unfinished(&whole, &half, "enf-kdtree", &[], |store| digest(store, "maps") == whole.maps);
}

/// The same for photons, at whatever moment the kill came.
#[test]
fn an_unfinished_trace_refuses_or_is_right() {
    let whole = whole();
    let flags =
        ["--photons-per-light", "10k", "--epoch", "0", "--queue-rows", "2", "--queue-block", "100"];
    let (all, half) = (whole.dir.path().join("all.enf"), whole.dir.path().join("half.enf"));
    for store in [&all, &half] {
        copy_store(&whole.store, store, &["enf-trace", "enf-kdtree", "enf-render"]);
    }
    ok(bin("enf-trace").arg(&all).args(flags));
    let photons = digest(&all, "photons");
    let mut child = Command::new(bin_path("enf-trace"))
        .arg(&half)
        .args(flags)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let journal = half.join("trace.000.journal");
    let begun = Instant::now();
    while std::fs::metadata(&journal).map_or(0, |m| m.len()) < 6000
        && child.try_wait().unwrap().is_none()
    {
        assert!(begun.elapsed() < Duration::from_secs(20));
        std::thread::sleep(Duration::from_micros(200));
    }
    if child.try_wait().unwrap().is_none() {
        let pid = Pid::from_raw(i32::try_from(child.id()).unwrap()).unwrap();
        kill_process(pid, Signal::KILL).unwrap();
    }
    child.wait().unwrap();
    assert!(!half.join("trace.seal").exists(), "it was killed before its end");
    unfinished(&whole, &half, "enf-trace", &flags, |store| digest(store, "photons") == photons);
}

fn unfinished(
    whole: &Whole,
    half: &Path,
    name: &str,
    flags: &[&str],
    right: impl Fn(&Path) -> bool,
) {
    let store = whole.dir.path().join("tried.enf");
    let prefix = format!("{}.", stage_name(name));
    let (mut refused, mut went_on) = (0, 0);
    for file in files_of(half).iter().filter(|f| f.starts_with(&prefix)) {
        let len = length(&half.join(file));
        let mut damages = flips(len, 12);
        damages.extend(truncations(len));
        damages.push(Damage::Append);
        for damage in damages {
            copy_store(half, &store, &[]);
            damage.apply(&store.join(file));
            let output = bin(name).arg(&store).args(flags).arg("--quiet").output().unwrap();
            let said = stderr(&output);
            match output.status.code() {
                Some(0) => {
                    assert!(right(&store), "{name}, {file} {damage:?}");
                    ok(bin("enfilade").arg("inspect").arg(&store).arg("--verify"));
                    went_on += 1;
                }
                Some(4) => {
                    // The journal and its data file are checked against each other.
                    assert!(said.contains(&prefix), "{name}, {file} {damage:?}: {said}");
                    refused += 1;
                }
                code => panic!("{name} after {damage:?} of {file}: {code:?} {said}"),
            }
        }
    }
    assert!(refused > 5 && went_on > 1, "{refused} refused, {went_on} went on");
    ok(bin(name).arg(half).args(flags).arg("--quiet"));
    assert!(right(half), "undamaged it goes on");
}

#[test]
fn what_is_no_store_is_said_to_be_none() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("empty.enf");
    std::fs::create_dir(&folder).unwrap();
    let file = dir.path().join("file.enf");
    std::fs::write(&file, "not a store").unwrap();
    for store in [&folder, &file] {
        for flag in [&["--verify"][..], &["--rooms"], &["--digest", "photons"], &[]] {
            let said = fails(bin("enfilade").arg("inspect").arg(store).args(flag), 4);
            assert!(said.contains(".enf"), "{said}");
        }
        for name in ["enf-grid", "enf-trace", "enf-kdtree", "enf-render"] {
            fails(bin(name).arg(store), 4);
        }
    }
    // Files that are not the store's do not matter to it.
    let whole = whole();
    std::fs::write(whole.store.join("README"), "hello").unwrap();
    std::fs::write(whole.store.join("trace.seal.new"), "half").unwrap();
    ok(bin("enfilade").arg("inspect").arg(&whole.store).arg("--verify"));
    ok(&mut stage("enf-trace", &whole.store));
}
