//! Room ids on pipes: the stages as filters, and what they do when a neighbour says little, nonsense or nothing.

mod common;

use common::{
    bin, bin_path, copy_store, digest, fails, furnished, ids, ok, room_count, shell, stdout,
};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

const PHOTONS: &str = "--photons-per-light 2k";
const PICTURE: &str = "--view door --width 40 --height 30 --samples 2";

/// A store in `dir`, up to the stage before `until`.
fn store(dir: &Path, until: &str) -> PathBuf {
    let scene = furnished(dir);
    let store = dir.join("b.enf");
    ok(bin("enf-partition").arg(&scene).arg("-o").arg(&store).arg("--quiet"));
    for (stage, flags) in
        [("enf-grid", ""), ("enf-trace", PHOTONS), ("enf-kdtree", ""), ("enf-render", "")]
    {
        if stage == until {
            return store;
        }
        ok(bin(stage).arg(&store).arg("--quiet").args(flags.split_whitespace()));
    }
    store
}

#[test]
fn five_stages_in_one_pipe_are_run() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let piped = ok(&mut shell(
        dir.path(),
        &format!(
            "\"$PARTITION\" rooms.toml -o b.enf | \"$GRID\" b.enf | \"$TRACE\" b.enf {PHOTONS} | \
             \"$KDTREE\" b.enf | \"$RENDER\" b.enf {PICTURE} -o door.exr"
        ),
    ));
    assert_eq!(
        stdout(&piped).trim(),
        "door.exr",
        "the picture's path is all that is left on stdout"
    );
    let out = dir.path().join("out");
    let run = ok(bin("enfilade")
        .arg("run")
        .arg(&scene)
        .arg("-o")
        .arg(&out)
        .args(PHOTONS.split_whitespace())
        .args(PICTURE.split_whitespace()));
    assert!(stdout(&run).lines().any(|l| l.ends_with("door.exr")), "{}", stdout(&run));
    for kind in ["geometry", "photons", "maps"] {
        let (pipe, run) = (dir.path().join("b.enf"), out.join("rooms.enf"));
        assert_eq!(digest(&pipe, kind), digest(&run, kind), "{kind}");
    }
    let picture = |path: PathBuf| std::fs::read(path).unwrap();
    assert!(picture(dir.path().join("door.exr")) == picture(out.join("door.exr")));
}

#[test]
fn the_driver_is_the_stages() {
    let dir = tempfile::tempdir().unwrap();
    furnished(dir.path());
    ok(&mut shell(
        dir.path(),
        &format!(
            "\"$ENFILADE\" partition rooms.toml -o b.enf | \"$ENFILADE\" grid b.enf | \
             \"$ENFILADE\" trace b.enf {PHOTONS} | \"$ENFILADE\" kdtree b.enf > ids"
        ),
    ));
    let alone = tempfile::tempdir().unwrap();
    let alone = store(alone.path(), "enf-render");
    let driven = dir.path().join("b.enf");
    for kind in ["geometry", "photons", "maps"] {
        assert_eq!(digest(&driven, kind), digest(&alone, kind));
    }
    let last = std::fs::read_to_string(dir.path().join("ids")).unwrap();
    assert_eq!(last.lines().count() as u32, room_count(&driven));
}

#[test]
fn every_stage_prints_every_id_once() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let store = dir.path().join("b.enf");
    let partition = ids(&ok(bin("enf-partition").arg(&scene).arg("-o").arg(&store)));
    let all: Vec<u32> = (0..room_count(&store)).collect();
    assert_eq!(partition, all);
    assert!(all.len() >= 3);
    for (stage, flags) in [("enf-grid", ""), ("enf-trace", PHOTONS), ("enf-kdtree", "")] {
        let mut printed = ids(&ok(bin(stage).arg(&store).args(flags.split_whitespace())));
        printed.sort_unstable();
        assert_eq!(printed, all, "{stage}");
    }
}

#[test]
fn ids_select_rooms_and_the_rest_can_follow() {
    let dir = tempfile::tempdir().unwrap();
    let store = store(dir.path(), "enf-kdtree");
    let whole = dir.path().join("whole.enf");
    copy_store(&store, &whole, &[]);
    ok(bin("enf-kdtree").arg(&whole));
    let rooms = room_count(&store);

    let some = ok(&mut shell(dir.path(), "seq 1 2 | \"$KDTREE\" b.enf --quiet"));
    assert_eq!(ids(&some), [1, 2]);
    // An unfinished stage is not one that the next may use, and it names the first room that lacks.
    let said =
        fails(bin("enf-render").arg(&store).args(["--view", "door", "-o"]).arg(dir.path()), 4);
    assert!(said.contains("room 0") && said.contains("enf-kdtree"), "{said}");
    let said = fails(bin("enfilade").arg("inspect").arg(&store).args(["--digest", "maps"]), 4);
    assert!(said.contains("unfinished"), "{said}");

    // Ids come back in the order in which they were asked for, doubles once, done ones as well.
    let last = rooms - 1;
    let rest = format!("printf '{last}\\n\\n  1 \\n{last}\\n0' | \"$KDTREE\" b.enf --quiet");
    assert_eq!(ids(&ok(&mut shell(dir.path(), &rest))), [last, 1, 0]);
    let rest = format!("seq 0 {last} > ids; \"$KDTREE\" b.enf < ids");
    let mut printed = ids(&ok(&mut shell(dir.path(), &rest)));
    printed.sort_unstable();
    assert_eq!(printed, (0..rooms).collect::<Vec<_>>());
    assert_eq!(digest(&store, "maps"), digest(&whole, "maps"));
}

#[test]
fn a_reader_that_leaves_is_no_failure() {
    let dir = tempfile::tempdir().unwrap();
    let store = store(dir.path(), "enf-grid");
    let whole = dir.path().join("whole.enf");
    copy_store(&store, &whole, &[]);
    for (stage, flags) in [("GRID", ""), ("TRACE", PHOTONS), ("KDTREE", "")] {
        let script = format!(
            "{{ \"${stage}\" b.enf {flags} --quiet; echo $? > code; }} | head -n 1; \
             {{ \"${stage}\" b.enf {flags} --quiet; echo $? >> code; }} | true; \
             \"${stage}\" b.enf {flags} --quiet > ids; cat code; wc -l < ids"
        );
        let said = stdout(&ok(&mut shell(dir.path(), &script)));
        let rooms = room_count(&store).to_string();
        let words: Vec<&str> = said.split_whitespace().collect();
        assert_eq!(
            words,
            ["0", "0", "0", &rooms],
            "{stage}: the first id, two exit codes, all ids"
        );
    }
    for (stage, flags) in [("enf-grid", ""), ("enf-trace", PHOTONS), ("enf-kdtree", "")] {
        ok(bin(stage).arg(&whole).args(flags.split_whitespace()));
    }
    for kind in ["photons", "maps"] {
        assert_eq!(digest(&store, kind), digest(&whole, kind), "{kind}");
    }
    // A closed standard output from the start, and the listing commands.
    ok(&mut shell(dir.path(), "\"$KDTREE\" b.enf --quiet >&-"));
    let code = "{ \"$ENFILADE\" inspect b.enf --portals; echo $? > code; } | true; cat code";
    assert_eq!(stdout(&ok(&mut shell(dir.path(), code))).trim(), "0");
    let code = "{ \"$RENDER\" b.enf --view door --width 8 --height 8 -o p.png; echo $? > code; } | true; cat code";
    assert_eq!(stdout(&ok(&mut shell(dir.path(), code))).trim(), "0");
}

#[test]
fn a_full_disk_behind_stdout_is_exit_5() {
    if !Path::new("/dev/full").exists() {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let store = store(dir.path(), "enf-grid");
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let said = fails(bin("enf-grid").arg(&store).stdout(full), 5);
    assert!(said.contains("cannot print"), "{said}");
    ok(bin("enf-grid").arg(&store));
}

#[test]
fn no_ids_mean_no_rooms() {
    let dir = tempfile::tempdir().unwrap();
    // The store is opened after the first id, so that it need not be there.
    for stage in ["GRID", "TRACE", "KDTREE", "RENDER"] {
        for input in [": |", "printf '\\n \\n' |"] {
            let script = format!("{input} \"${stage}\" nowhere.enf");
            assert_eq!(stdout(&ok(&mut shell(dir.path(), &script))), "", "{stage}");
        }
        let script = format!(": > empty; \"${stage}\" nowhere.enf < empty");
        assert_eq!(stdout(&ok(&mut shell(dir.path(), &script))), "", "{stage}");
    }
    assert!(!dir.path().join("nowhere.enf").exists());
    let store = store(dir.path(), "enf-grid");
    let before = common::files_of(&store);
    ok(&mut shell(dir.path(), ": | \"$GRID\" b.enf"));
    assert_eq!(common::files_of(&store), before, "nothing was begun");
}

#[test]
fn what_is_no_pipe_means_all_rooms() {
    let dir = tempfile::tempdir().unwrap();
    let store = store(dir.path(), "enf-grid");
    let rooms = room_count(&store) as usize;
    assert_eq!(ids(&ok(bin("enf-grid").arg(&store).stdin(Stdio::null()))).len(), rooms);
    assert_eq!(ids(&ok(&mut shell(dir.path(), "\"$GRID\" b.enf <&-"))).len(), rooms);
    let flag = "printf 'not an id' | \"$GRID\" b.enf --all-rooms";
    assert_eq!(ids(&ok(&mut shell(dir.path(), flag))).len(), rooms);
}

#[test]
fn a_line_that_is_no_id_is_exit_4() {
    let dir = tempfile::tempdir().unwrap();
    let store = store(dir.path(), "enf-grid");
    let before = common::files_of(&store);
    for (input, stage, says) in [
        ("lobby", "GRID", "lobby"),
        ("0\\n-1", "GRID", "line 2"),
        ("1.5", "TRACE", "1.5"),
        ("99999999999999999999", "GRID", "line 1"),
        ("0 1", "KDTREE", "line 1"),
        ("99999", "GRID", "99999"),
    ] {
        let said =
            fails(&mut shell(dir.path(), &format!("printf '{input}\\n' | \"${stage}\" b.enf")), 4);
        assert!(said.contains(says), "{input}: {said}");
    }
    assert_eq!(common::files_of(&store), before, "nothing was begun");
    // The same where only the ids are read, not used.
    ok(bin("enf-grid").arg(&store));
    let said = fails(&mut shell(dir.path(), "echo 99999 | \"$TRACE\" b.enf"), 4);
    assert!(said.contains("99999"), "{said}");
}

#[test]
fn a_stage_names_the_room_that_the_stage_before_lacks() {
    let dir = tempfile::tempdir().unwrap();
    let store = store(dir.path(), "enf-grid");
    let said = fails(bin("enf-trace").arg(&store), 4);
    assert!(said.contains("enf-grid"), "{said}");
    ok(&mut shell(dir.path(), "seq 0 1 | \"$GRID\" b.enf"));
    let said = fails(bin("enf-trace").arg(&store), 4);
    assert!(said.contains("room 2") && said.contains("enf-grid"), "{said}");
    ok(bin("enf-grid").arg(&store));
    let said = fails(bin("enf-kdtree").arg(&store), 4);
    assert!(said.contains("enf-trace"), "{said}");
    for stage in ["enf-grid", "enf-trace", "enf-kdtree", "enf-render"] {
        let said = fails(bin(stage).arg(dir.path().join("none.enf")), 4);
        assert!(said.contains("none.enf") && said.contains("enf-partition"), "{said}");
    }
}

#[test]
fn a_silent_pipe_is_explained() {
    let dir = tempfile::tempdir().unwrap();
    let mut child = std::process::Command::new(bin_path("enf-grid"))
        .arg("nowhere.enf")
        .current_dir(dir.path())
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let started = Instant::now();
    let stdin = child.stdin.take().unwrap();
    let mut said = child.stderr.take().unwrap();
    let reader = std::thread::spawn(move || {
        let mut text = [0; 400];
        let n = std::io::Read::read(&mut said, &mut text).unwrap();
        String::from_utf8_lossy(&text[..n]).into_owned()
    });
    let said = reader.join().unwrap();
    assert!(said.contains("waiting for room ids") && said.contains("--all-rooms"), "{said}");
    assert!(started.elapsed() > Duration::from_secs(4), "not at once");
    drop(stdin);
    assert!(child.wait().unwrap().success());
}
