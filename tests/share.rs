//! One trace, several processes: the same photons, whoever does what, and whoever is killed on the way.

mod common;

use common::{PICTURE, bin, bin_path, copy_store, counts, digest, fails, furnished, ok, stdout};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const FLAGS: [&str; 6] = ["--photons-per-light", "20k", "--queue-block", "500", "--epoch", "0.05"];

/// Partitioned into many tiles, and with structures.
fn tiles(dir: &Path) -> PathBuf {
    let scene = furnished(dir);
    let store = dir.join("b.enf");
    let cut = ["--tile-triangles", "120", "--quiet"];
    ok(bin("enf-partition").arg(&scene).arg("-o").arg(&store).args(cut));
    ok(bin("enf-grid").arg(&store).arg("--quiet"));
    store
}

fn copy(store: &Path, name: &str) -> PathBuf {
    let to = store.with_file_name(name);
    copy_store(store, &to, &[]);
    to
}

fn sharer(store: &Path, share: &str) -> Command {
    let mut command = Command::new(bin_path("enf-trace"));
    command.arg(store).args(FLAGS).args(["--share", share, "--threads", "1", "--quiet"]);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn start(store: &Path, share: &str) -> Child {
    sharer(store, share).spawn().unwrap()
}

fn end(child: Child) -> String {
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// What is left of a trace for later stages: photons, counts, the lights of each room by the picture made with them.
fn outcome(store: &Path) -> (String, [u64; 4], Vec<u8>) {
    ok(bin("enfilade").arg("inspect").arg(store).arg("--verify"));
    let counts = counts(store);
    assert_eq!(counts[0], counts[1] + counts[2]);
    ok(bin("enf-kdtree").arg(store).arg("--quiet"));
    let picture = store.with_extension("png");
    ok(bin("enf-render").arg(store).args(PICTURE).args(["--quiet", "-o"]).arg(&picture));
    (digest(store, "photons"), counts, std::fs::read(picture).unwrap())
}

#[test]
fn two_and_three_processes_store_what_one_stores() {
    let dir = tempfile::tempdir().unwrap();
    let store = tiles(dir.path());
    let alone = copy(&store, "alone.enf");
    let ids = stdout(&ok(bin("enf-trace").arg(&alone).args(FLAGS).arg("--quiet")));
    let expected = outcome(&alone);

    for shares in [&["0/2", "1/2"][..], &["2/3", "0/3", "1/3"]] {
        let shared = copy(&store, "shared.enf");
        let children: Vec<Child> = shares.iter().map(|share| start(&shared, share)).collect();
        for child in children {
            assert_eq!(end(child), ids, "everybody prints the rooms when all is sealed");
        }
        // Everybody had something to do.
        for share in 0..shares.len() {
            let data = shared.join(format!("trace.{share:03}.000.dat"));
            assert!(std::fs::metadata(data).unwrap().len() > 100_000, "process {share}");
        }
        assert!(outcome(&shared) == expected, "{shares:?}");
        // Finished is finished, for whoever asks.
        assert_eq!(stdout(&ok(&mut sharer(&shared, "1/2"))), ids);
        std::fs::remove_dir_all(&shared).unwrap();
    }
}

#[test]
fn a_process_that_is_killed_is_waited_for_and_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let store = tiles(dir.path());
    let alone = copy(&store, "alone.enf");
    ok(bin("enf-trace").arg(&alone).args(FLAGS).arg("--quiet"));
    let expected = outcome(&alone);

    let shared = copy(&store, "shared.enf");
    let first = start(&shared, "0/2");
    let (mut killed, mut delay) = (0, Duration::from_millis(15));
    loop {
        let mut second = start(&shared, "1/2");
        let until = Instant::now() + delay;
        while Instant::now() < until && second.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        if second.try_wait().unwrap().is_some() {
            end(second);
            break;
        }
        second.kill().unwrap();
        second.wait().unwrap();
        killed += 1;
        delay = delay * 5 / 4;
    }
    end(first);
    assert!(killed > 2, "killed {killed} times");
    assert!(outcome(&shared) == expected);
}

#[test]
fn what_was_shared_can_be_finished_alone_or_by_others() {
    let dir = tempfile::tempdir().unwrap();
    let store = tiles(dir.path());
    let alone = copy(&store, "alone.enf");
    ok(bin("enf-trace").arg(&alone).args(FLAGS).arg("--quiet"));
    let expected = outcome(&alone);

    for then in [&["0/1"][..], &["0/3", "1/3", "2/3"]] {
        let shared = copy(&store, "shared.enf");
        // Two begin, and both are killed when both have committed something.
        let mut children = ["0/2", "1/2"].map(|share| start(&shared, share));
        let data = |process: u32| shared.join(format!("trace.{process:03}.000.dat"));
        let until = Instant::now() + Duration::from_secs(60);
        let begun = |p: u32| std::fs::metadata(data(p)).is_ok_and(|m| m.len() > 50_000);
        while !(begun(0) && begun(1)) && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(2));
        }
        for child in &mut children {
            child.kill().unwrap();
            child.wait().unwrap();
        }
        let children: Vec<Child> = then.iter().map(|share| start(&shared, share)).collect();
        for child in children {
            end(child);
        }
        assert!(outcome(&shared) == expected, "{then:?}");
        std::fs::remove_dir_all(&shared).unwrap();
    }
}

/// Who waits says for whom, after ten seconds.
#[test]
fn a_sharer_that_was_never_started_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let store = tiles(dir.path());
    let mut command = bin("enf-trace");
    command.arg(&store).args(FLAGS).args(["--share", "0/3"]).stderr(Stdio::piped());
    let mut child = command.stdout(Stdio::null()).spawn().unwrap();
    let lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let line = lines.map_while(Result::ok).find(|line| line.contains("waiting")).unwrap();
    assert!(line.ends_with("; running: 0; not running: --share 1/3, --share 2/3"), "{line}");
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_store_is_shared_in_one_way_at_a_time() {
    let dir = tempfile::tempdir().unwrap();
    let store = tiles(dir.path());
    for bad in ["2/2", "1", "0/0"] {
        fails(bin("enf-trace").arg(&store).args(["--share", bad]), 2);
    }
    // It waits for the other half.
    let mut first = start(&store, "0/2");
    let journal = store.join("trace.000.journal");
    while !journal.exists() {
        std::thread::sleep(Duration::from_millis(5));
    }
    for other in ["0/2", "1/3"] {
        let said = fails(&mut sharer(&store, other), 5);
        assert!(said.contains("trace.000.journal"), "{said}");
    }
    // That did not disturb it.
    assert!(first.try_wait().unwrap().is_none());
    let second = start(&store, "1/2");
    end(second);
    end(first);
    outcome(&store);
}

/// A process that is alone says so: one that comes with a share is refused, also where the first one goes on with what was shared before.
#[test]
fn nobody_joins_who_is_alone() {
    let dir = tempfile::tempdir().unwrap();
    let store = tiles(dir.path());
    let trace = |share: &[&str]| {
        let mut command = Command::new(bin_path("enf-trace"));
        command.arg(&store).args(["--photons-per-light", "20M", "--epoch", "0.05", "--quiet"]);
        command.args(["--threads", "1"]).args(share);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    };
    let wait_for = |name: &str| {
        while !store.join(name).exists() {
            std::thread::sleep(Duration::from_millis(5));
        }
    };
    let stop = |mut child: Child| {
        assert!(child.try_wait().unwrap().is_none(), "20M photons a light take longer than that");
        child.kill().unwrap();
        child.wait().unwrap();
    };
    let alone = trace(&[]).spawn().unwrap();
    wait_for("trace.000.000.dat");
    let said = fails(&mut trace(&["--share", "1/2"]), 5);
    assert!(said.contains("trace.000.journal"), "{said}");
    stop(alone);

    // What process 0 of 2 has begun, one process goes on with; nobody may be the other half of the two then.
    let half = trace(&["--share", "0/2"]).spawn().unwrap();
    std::thread::sleep(Duration::from_millis(300));
    stop(half);
    let alone = trace(&[]).spawn().unwrap();
    std::thread::sleep(Duration::from_millis(300));
    let said = fails(&mut trace(&["--share", "1/2"]), 5);
    assert!(said.contains("trace.000.journal"), "{said}");
    stop(alone);
    // And the other way round.
    let half = trace(&["--share", "1/2"]).spawn().unwrap();
    wait_for("trace.001.000.dat");
    std::thread::sleep(Duration::from_millis(300));
    let said = fails(&mut trace(&[]), 5);
    assert!(said.contains("trace.001.journal"), "{said}");
    stop(half);
}
