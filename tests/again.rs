//! Running again: nothing to do, something else, or the rest of what was interrupted.

mod common;

use common::{
    PICTURE, bin, bin_path, copy_store, counts, digest, fails, files_of, furnished, ids, ok,
    room_count, stderr,
};
use rustix::process::{Pid, Signal, kill_process};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Partitioned and with grids.
fn grids(dir: &Path) -> PathBuf {
    let scene = furnished(dir);
    let store = dir.join("b.enf");
    ok(bin("enf-partition").arg(&scene).arg("-o").arg(&store).arg("--quiet"));
    ok(bin("enf-grid").arg(&store).arg("--quiet"));
    store
}

/// Every stage's command line.
fn stages(dir: &Path, store: &Path) -> Vec<Command> {
    common::STAGES
        .iter()
        .map(|&stage| {
            let mut command = bin(stage);
            match stage {
                "enf-partition" => {
                    command.arg(dir.join("rooms.toml")).arg("-o").arg(store);
                }
                _ => {
                    command.arg(store);
                }
            }
            match stage {
                "enf-trace" => {
                    command.args(["--photons-per-light", "1k"]);
                }
                "enf-render" => {
                    command.args(PICTURE).arg("-o").arg(dir.join("door.png"));
                }
                _ => {}
            }
            command
        })
        .collect()
}

/// Every byte of a store.
fn bytes_of(store: &Path) -> Vec<(String, Vec<u8>)> {
    files_of(store)
        .into_iter()
        .map(|f| (f.clone(), std::fs::read(store.join(f)).unwrap()))
        .collect()
}

#[test]
fn twice_is_nothing_to_do() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let store = dir.path().join("b.enf");
    let first: Vec<_> = stages(dir.path(), &store).iter_mut().map(ok).collect();
    let before = bytes_of(&store);
    let picture = std::fs::read(dir.path().join("door.png")).unwrap();
    for (mut command, first) in stages(dir.path(), &store).into_iter().zip(&first) {
        // Flags that change no result are no difference.
        let again = ok(command.args(["--threads", "1", "--memory", "12M", "--progress", "always"]));
        assert!(stderr(&again).contains("nothing to do"), "{command:?}: {}", stderr(&again));
        let mut lines: Vec<_> = common::stdout(&again).lines().map(String::from).collect();
        let mut wanted: Vec<_> = common::stdout(first).lines().map(String::from).collect();
        lines.sort();
        wanted.sort();
        assert_eq!(lines, wanted, "{command:?} prints what it printed");
    }
    assert!(bytes_of(&store) == before, "the store is untouched");
    assert!(std::fs::read(dir.path().join("door.png")).unwrap() == picture);

    // The driver as a whole.
    let out = dir.path().join("out");
    let run = || {
        ok(bin("enfilade")
            .arg("run")
            .arg(&scene)
            .arg("-o")
            .arg(&out)
            .args(["--photons-per-light", "1k"])
            .args(PICTURE))
    };
    let first = run();
    let before = bytes_of(&out.join("rooms.enf"));
    let again = run();
    assert_eq!(common::stdout(&first), common::stdout(&again));
    assert!(stderr(&again).matches("nothing to do").count() >= 5, "{}", stderr(&again));
    assert!(bytes_of(&out.join("rooms.enf")) == before);
}

#[test]
fn another_flag_is_refused_until_forced() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let store = dir.path().join("b.enf");
    for mut command in stages(dir.path(), &store) {
        ok(&mut command);
    }
    let before = bytes_of(&store);
    let photons = digest(&store, "photons");
    let partition = |extra: &[&str]| {
        let mut command = bin("enf-partition");
        command.arg(&scene).arg("-o").arg(&store).args(extra);
        command
    };
    let on_store = |stage: &str, extra: &[&str]| {
        let mut command = bin(stage);
        command.arg(&store).args(extra);
        command
    };
    let mut refused = [
        (partition(&["--rooms", "2"]), "rooms"),
        (partition(&["--doors", "open"]), "doors"),
        (partition(&["--units", "2"]), "units"),
        (partition(&["--up", "y"]), "up"),
        (partition(&["--hints", "ignore"]), "hints"),
        (partition(&["--ceiling-lights", "500lx"]), "ceiling-lights"),
        (on_store("enf-trace", &["--photons-per-light", "2k"]), "photons-per-light"),
        (on_store("enf-trace", &["--photons-per-light", "1k", "--seed", "9"]), "seed"),
        (on_store("enf-kdtree", &["--gather-radius", "0.3"]), "gather-radius"),
    ];
    for (command, difference) in &mut refused {
        let said = fails(command, 2);
        assert!(said.contains(*difference) && said.contains("--force"), "{said}");
    }
    let picture = dir.path().join("door.png");
    let mut other = on_store("enf-render", &["--view", "hall", "--samples", "1", "-o"]);
    let said = fails(other.arg(&picture), 2);
    assert!(said.contains("--force"), "{said}");
    assert!(bytes_of(&store) == before, "a refusal changes nothing");

    // The scene's own bytes are part of the question.
    let model = dir.path().join("furnished.obj");
    let text = std::fs::read_to_string(&model).unwrap();
    std::fs::write(&model, format!("{text}# a comment\n")).unwrap();
    let said = fails(&mut partition(&[]), 2);
    assert!(said.contains("furnished.obj") && said.contains("--force"), "{said}");
    std::fs::write(&model, text).unwrap();

    // Forced: this stage and later ones go, earlier ones stay.
    ok(&mut on_store("enf-trace", &["--photons-per-light", "2k", "--force", "--quiet"]));
    let stages_left: Vec<String> =
        files_of(&store).iter().filter(|f| f.ends_with(".seal")).cloned().collect();
    assert_eq!(stages_left, ["grid.seal", "partition.seal", "trace.seal"]);
    assert_ne!(digest(&store, "photons"), photons);
    fails(bin("enfilade").arg("inspect").arg(&store).args(["--digest", "maps"]), 4);
    ok(&mut on_store("enf-trace", &["--photons-per-light", "1k", "--force", "--quiet"]));
    assert_eq!(digest(&store, "photons"), photons);
    ok(&mut partition(&["--rooms", "2", "--force", "--quiet"]));
    assert!(files_of(&store).iter().all(|f| f.starts_with("partition.")), "{:?}", files_of(&store));

    // And with the driver.
    let out = dir.path().join("out");
    let run = |extra: &[&str]| {
        let mut command = bin("enfilade");
        command.arg("run").arg(&scene).arg("-o").arg(&out).args(PICTURE).args(extra);
        command
    };
    ok(&mut run(&["--photons-per-light", "500"]));
    let said = fails(&mut run(&["--photons-per-light", "600"]), 2);
    assert!(said.contains("photons-per-light") && said.contains("--force"), "{said}");
    ok(&mut run(&["--photons-per-light", "600", "--force"]));
}

#[test]
fn a_store_can_be_moved() {
    let dir = tempfile::tempdir().unwrap();
    furnished(dir.path());
    let store = dir.path().join("b.enf");
    let mut commands = stages(dir.path(), &store);
    for command in &mut commands[..3] {
        ok(command);
    }
    let photons = digest(&store, "photons");
    let elsewhere = dir.path().join("far").join("away.enf");
    std::fs::create_dir(dir.path().join("far")).unwrap();
    std::fs::rename(&store, &elsewhere).unwrap();
    // It needs nothing outside itself.
    std::fs::remove_file(dir.path().join("furnished.obj")).unwrap();
    std::fs::remove_file(dir.path().join("rooms.toml")).unwrap();
    assert_eq!(digest(&elsewhere, "photons"), photons);
    let mut commands = stages(dir.path(), &elsewhere);
    let again = ok(&mut commands[2]);
    assert!(stderr(&again).contains("nothing to do"));
    ok(&mut commands[3]);
    ok(&mut commands[4]);
    ok(bin("enfilade").arg("inspect").arg(&elsewhere).arg("--verify"));
}

/// Starts a stage with its output out of the way.
fn start(stage: &str, store: &Path, flags: &[&str]) -> Child {
    Command::new(bin_path(stage))
        .arg(store)
        .args(flags)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn signal(child: &Child, signal: Signal) {
    let pid = Pid::from_raw(i32::try_from(child.id()).unwrap()).unwrap();
    kill_process(pid, signal).unwrap();
}

/// Delays that are the same parts of the time that a `whole` run takes in every run of the test: the first one is shorter than that.
fn delays(seed: u64, whole: Duration) -> impl Iterator<Item = Duration> {
    let mut state = seed;
    std::iter::repeat_with(move || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        whole * (25 + (state >> 33) as u32 % 725) / 1000
    })
}

/// Kills a stage at many moments; it must come to its end all the same, and to the same one.
fn survives(
    stage: &str,
    store: &Path,
    flags: &[&str],
    how: Signal,
    (seed, whole): (u64, Duration),
) -> (u32, u32) {
    let (mut killed, mut resumed) = (0, 0);
    let mut delays = delays(seed, whole);
    // Ever more patient, so that it ends however slow the machine is.
    for attempt in 0u32..60 {
        let mut child = start(stage, store, flags);
        let until = Instant::now() + delays.next().unwrap() * (1 + attempt / 4);
        while Instant::now() < until && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_micros(500));
        }
        if child.try_wait().unwrap().is_none() {
            signal(&child, how);
        }
        let output = child.wait_with_output().unwrap();
        let said = stderr(&output);
        resumed += u32::from(said.contains("going on where"));
        match output.status.code() {
            Some(0) => return (killed, resumed),
            None => {}
            Some(130) => assert!(said.contains("goes on from here"), "{said}"),
            Some(code) => panic!("{stage} ended with {code}: {said}"),
        }
        killed += 1;
    }
    panic!("{stage} was killed {killed} times and never came to an end");
}

#[test]
fn a_killed_trace_goes_on_to_the_same_photons() {
    let dir = tempfile::tempdir().unwrap();
    let store = grids(dir.path());
    let flags = [
        "--photons-per-light",
        "30k",
        "--queue-rows",
        "4",
        "--queue-block",
        "300",
        "--epoch",
        "0.01",
    ];
    let whole = dir.path().join("whole.enf");
    copy_store(&store, &whole, &[]);
    let began = Instant::now();
    ok(bin("enf-trace").arg(&whole).args(flags));
    let takes = began.elapsed();
    let photons = digest(&whole, "photons");
    let mut resumed = 0;
    for seed in 1..4 {
        let tried = dir.path().join("tried.enf");
        copy_store(&store, &tried, &[]);
        let (killed, went_on) = survives("enf-trace", &tried, &flags, Signal::KILL, (seed, takes));
        assert!(killed > 0, "not killed at all");
        resumed += went_on;
        assert_eq!(digest(&tried, "photons"), photons, "seed {seed}");
        ok(bin("enfilade").arg("inspect").arg(&tried).arg("--verify"));
        // What was counted over all the runs is what one run counts.
        assert_eq!(counts(&tried), counts(&whole));
    }
    assert!(resumed > 2, "some runs had something to go on from: {resumed}");
}

#[test]
fn an_interrupted_trace_says_how_to_go_on() {
    let dir = tempfile::tempdir().unwrap();
    let store = grids(dir.path());
    let whole = dir.path().join("whole.enf");
    copy_store(&store, &whole, &[]);
    let flags = ["--photons-per-light", "100k", "--threads", "1"];
    ok(bin("enf-trace").arg(&whole).args(flags));
    let mut child = start("enf-trace", &store, &flags);
    // Until it works: the journal has been begun.
    while !store.join("trace.000.000.dat").exists() {
        assert!(child.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(1));
    }
    std::thread::sleep(Duration::from_millis(30));
    signal(&child, Signal::INT);
    let output = child.wait_with_output().unwrap();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(130), "{said}");
    assert!(said.contains("interrupted") && said.contains("the same command goes on"), "{said}");
    let said = fails(bin("enf-kdtree").arg(&store), 4);
    assert!(said.contains("enf-trace") && said.contains("unfinished"), "{said}");

    let mut child = start("enf-trace", &store, &flags);
    std::thread::sleep(Duration::from_millis(40));
    if child.try_wait().unwrap().is_none() {
        signal(&child, Signal::TERM);
    }
    let code = child.wait_with_output().unwrap().status.code();
    assert!(matches!(code, Some(143 | 0)), "{code:?}");
    ok(bin("enf-trace").arg(&store).args(flags));
    assert_eq!(digest(&store, "photons"), digest(&whole, "photons"));
}

#[test]
fn killed_anywhere_the_whole_chain_comes_to_the_same_picture() {
    let dir = tempfile::tempdir().unwrap();
    let whole = dir.path().join("whole");
    std::fs::create_dir(&whole).unwrap();
    let scene = furnished(dir.path());
    let flags = [
        "--photons-per-light",
        "10k",
        "--epoch",
        "0.01",
        "--view",
        "all",
        "--width",
        "64",
        "--height",
        "48",
        "--samples",
        "2",
    ];
    let run = |out: &Path| {
        let mut command = Command::new(bin_path("enfilade"));
        command.arg("run").arg(&scene).arg("-o").arg(out).args(flags);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        command
    };
    let began = Instant::now();
    ok(&mut run(&whole));
    let takes = began.elapsed();
    let tried = dir.path().join("tried");
    let mut killed = 0;
    let mut delays = delays(7, takes);
    loop {
        let mut child = run(&tried).spawn().unwrap();
        let until = Instant::now() + delays.next().unwrap() * (1 + killed / 2);
        while Instant::now() < until && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        if child.try_wait().unwrap().is_none() {
            signal(&child, if killed % 3 == 2 { Signal::TERM } else { Signal::KILL });
        }
        let output = child.wait_with_output().unwrap();
        let said = stderr(&output);
        match output.status.code() {
            Some(0) => break,
            None | Some(143) => killed += 1,
            Some(code) => panic!("exit {code}: {said}"),
        }
        assert!(killed < 60, "it never came to an end");
    }
    assert!(killed > 0);
    for file in ["door.exr", "door.png", "hall.exr", "hall.png"] {
        let same =
            std::fs::read(tried.join(file)).unwrap() == std::fs::read(whole.join(file)).unwrap();
        assert!(same, "{file} after {killed} kills");
    }
    for kind in ["photons", "maps"] {
        assert_eq!(digest(&tried.join("rooms.enf"), kind), digest(&whole.join("rooms.enf"), kind));
    }
}

#[test]
fn a_store_that_is_being_written_is_busy() {
    let dir = tempfile::tempdir().unwrap();
    let store = grids(dir.path());
    let flags = ["--photons-per-light", "1M", "--threads", "1"];
    let mut child = start("enf-trace", &store, &flags);
    while !store.join("trace.000.000.dat").exists() {
        assert!(child.try_wait().unwrap().is_none());
        std::thread::sleep(Duration::from_millis(1));
    }
    std::thread::sleep(Duration::from_millis(50));
    let said = fails(bin("enf-trace").arg(&store).args(flags), 5);
    assert!(said.contains("another running process"), "{said}");
    // Force takes nothing from under the hands of a live process.
    let said = fails(bin("enf-trace").arg(&store).args(["--photons-per-light", "7", "--force"]), 5);
    assert!(said.contains("another running process"), "{said}");
    child.kill().unwrap();
    child.wait().unwrap();
    ok(bin("enf-trace").arg(&store).args(["--photons-per-light", "7", "--force"]));
    assert_eq!(ids(&ok(bin("enf-kdtree").arg(&store))).len() as u32, room_count(&store));
}

/// Finding rooms is dense work with nothing to save: a signal ends it at once, and nothing is in the way afterwards.
#[test]
fn an_interrupted_partition_ends_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let store = dir.path().join("b.enf");
    let partition = |rooms: &str| {
        let mut command = Command::new(bin_path("enf-partition"));
        command.arg(&scene).arg("-o").arg(&store).args(["--rooms", rooms]);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        command
    };
    for (how, code) in [(Signal::TERM, 143), (Signal::INT, 130)] {
        let mut child = partition("60000").spawn().unwrap();
        std::thread::sleep(Duration::from_millis(300));
        assert!(child.try_wait().unwrap().is_none(), "60000 rooms take longer than that");
        signal(&child, how);
        let asked = Instant::now();
        let output = child.wait_with_output().unwrap();
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{said}");
        assert!(said.contains("interrupted"), "{said}");
        assert!(asked.elapsed() < Duration::from_secs(5), "{:?}", asked.elapsed());
    }
    ok(partition("auto").arg("--force"));
}
