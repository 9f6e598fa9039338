//! A disk that is full, and a file that may not grow: every stage stops with exit 5, says which file and what to do,
//! and the same command goes on to the same digests once there is room.

mod common;

use std::path::Path;
use std::process::{Command, Output, Stdio};

use common::{bin, digest, furnished, ok, shell, stderr, stdout};

const TRACE: [&str; 8] =
    ["--photons-per-light", "30k", "--queue-rows", "2", "--queue-block", "100", "--epoch", "0.05"];
const RENDER: [&str; 8] = ["--view", "all", "--width", "96", "--height", "64", "--samples", "2"];
const KINDS: [&str; 3] = ["geometry", "photons", "maps"];
const PICTURES: [&str; 4] = ["door.exr", "door.png", "hall.exr", "hall.png"];

/// The same commands with all the room there is: digests and pictures.
fn reference(dir: &Path) -> (Vec<String>, Vec<Vec<u8>>) {
    let scene = furnished(dir);
    let store = dir.join("whole.enf");
    ok(bin("enf-partition").arg(&scene).arg("-o").arg(&store).arg("--quiet"));
    ok(bin("enf-grid").arg(&store).arg("--quiet"));
    ok(bin("enf-trace").arg(&store).args(TRACE).arg("--quiet"));
    ok(bin("enf-kdtree").arg(&store).arg("--quiet"));
    let pictures = dir.join("whole");
    ok(bin("enf-render").arg(&store).args(RENDER).arg("--quiet").arg("-o").arg(&pictures));
    let read = |name: &str| std::fs::read(pictures.join(name)).unwrap();
    (KINDS.iter().map(|kind| digest(&store, kind)).collect(), PICTURES.map(read).to_vec())
}

/// Mounts a small file system of its own, and runs each stage with ever more room in it: "NAME KB CODE" on a line, then what was said.
const SCRIPT: &str = r#"
mkdir small && mount -t tmpfs -o size=48M none small || exit 99
cp furnished.obj furnished.mtl rooms.toml small/ && cd small || exit 99
step() {
    name=$1 rooms=$2; shift 2
    for free in $rooms all; do
        if [ $free != all ]; then
            left=$(df -k . | awk 'END { print $4 }')
            head -c $(((left - free) * 1024)) /dev/zero >ballast
        fi
        "$@" >../ids 2>../said; code=$?
        rm -f ballast
        echo "== $name $free $code"; cat ../said
        [ $code = 0 ] && break
    done
}
step partition "0 4 12 40 60" "$PARTITION" rooms.toml -o b.enf
step grid "0 4" "$GRID" b.enf
step trace "0 4 12 40 300 1000 3000 3001" "$TRACE" b.enf $TRACE_FLAGS
step kdtree "0 4 12 1000 3000" "$KDTREE" b.enf
step render "0 4 12 100 800 40 100 300 400" "$RENDER" b.enf $RENDER_FLAGS -o pictures
step report "0" "$GRID" b.enf --stats grid.json
step again "0" "$KDTREE" b.enf
step run "0 4 100 2000" "$ENFILADE" run rooms.toml -o out --photons-per-light 10k --view door --width 32 --height 24 --samples 1
for kind in geometry photons maps; do "$ENFILADE" inspect b.enf --digest $kind; done >../digests
"$ENFILADE" inspect b.enf --verify >&2 || exit 98
cp -r pictures ../pictures
"#;

/// Whether this system lets users mount file systems of their own.
fn namespaces() -> bool {
    let mut probe = Command::new("unshare");
    probe.args(["-rm", "sh", "-c", "mount -t tmpfs none /tmp"]);
    probe.stdout(Stdio::null()).stderr(Stdio::null());
    probe.status().is_ok_and(|status| status.success())
}

#[test]
fn a_full_file_system_stops_every_stage_and_the_same_commands_go_on() {
    if !namespaces() {
        eprintln!("SKIPPED: no user namespaces here, so no file system can be filled up");
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let (digests, pictures) = reference(dir.path());
    // As `shell` runs it, with a namespace around it.
    let plain = shell(dir.path(), SCRIPT);
    let mut command = Command::new("unshare");
    command.args(["-rm", "sh", "-c", SCRIPT]).current_dir(dir.path()).stdin(Stdio::null());
    command.envs(plain.get_envs().filter_map(|(key, value)| Some((key, value?))));
    command.env("TRACE_FLAGS", TRACE.join(" ")).env("RENDER_FLAGS", RENDER.join(" "));
    let output = ok(&mut command);
    stderr(&output);
    let text = stdout(&output);
    assert!(!text.contains("panicked") && !text.contains("internal error"), "{text}");
    let mut stopped = std::collections::BTreeMap::<String, u32>::new();
    for part in text.split("== ").skip(1) {
        let (head, said) = part.split_once('\n').unwrap();
        let words: Vec<&str> = head.split(' ').collect();
        let [name, _, code] = words[..] else { panic!("{head}") };
        if code == "0" {
            continue;
        }
        assert_eq!(code, "5", "{part}");
        // The file, the system's word, the way out.
        let file = ["b.enf/", "out/", "pictures/", "grid.json"].iter().any(|f| said.contains(f))
            || said.contains("cannot create pictures");
        assert!(file && said.contains("No space left on device"), "{part}");
        assert!(said.contains("free some space"), "{part}");
        *stopped.entry(name.to_string()).or_default() += 1;
    }
    for (name, least) in
        [("partition", 3), ("grid", 2), ("trace", 6), ("kdtree", 4), ("render", 5), ("run", 3)]
    {
        let times = stopped.get(name).copied().unwrap_or(0);
        assert!(times >= least, "{name} met a full disk {times} times\n{text}");
    }
    assert!(!stopped.contains_key("again"), "a finished stage needs no room");
    let found = std::fs::read_to_string(dir.path().join("digests")).unwrap();
    assert_eq!(found.lines().collect::<Vec<_>>(), digests);
    for (name, wanted) in PICTURES.iter().zip(pictures) {
        assert!(std::fs::read(dir.path().join("pictures").join(name)).unwrap() == wanted, "{name}");
    }
    let names = common::files_of(&dir.path().join("pictures"));
    assert_eq!(names, PICTURES, "and nothing half written beside them");
}

/// Under `ulimit -f`: no signal ends the process (SIGXFSZ would), the message says what lacks, and without the limit the same command goes
/// on.
#[test]
fn a_file_that_may_not_grow_is_an_error_and_no_signal() {
    let dir = tempfile::tempdir().unwrap();
    let (digests, pictures) = reference(dir.path());
    // In units of 512 bytes.
    let limited = |blocks: u32, command: &str| -> Output {
        let script = format!("ulimit -f {blocks} && exec {command}");
        shell(dir.path(), &script).output().unwrap()
    };
    let trace = format!("\"$TRACE\" b.enf {}", TRACE.join(" "));
    let render = format!("\"$RENDER\" b.enf {} -o pictures", RENDER.join(" "));
    for (command, limits, file) in [
        ("\"$PARTITION\" rooms.toml -o b.enf", &[0, 1, 15][..], "b.enf/"),
        ("\"$GRID\" b.enf", &[0, 1], "b.enf/grid."),
        (&trace, &[0, 1, 100, 1000, 8000], "b.enf/trace."),
        ("\"$KDTREE\" b.enf", &[0, 1, 3000, 6000], "b.enf/kdtree."),
        (&render, &[0, 1, 100, 500], "b.enf/render."),
    ] {
        for &blocks in limits {
            let output = limited(blocks, command);
            let said = stderr(&output);
            assert_eq!(output.status.code(), Some(5), "{blocks}: {command}\n{said}");
            assert!(said.contains(file) && said.contains("ulimit -f"), "{said}");
        }
        ok(&mut shell(dir.path(), command));
    }
    let store = dir.path().join("b.enf");
    let found: Vec<String> = KINDS.iter().map(|kind| digest(&store, kind)).collect();
    assert_eq!(found, digests);
    for (name, wanted) in PICTURES.iter().zip(pictures) {
        assert!(std::fs::read(dir.path().join("pictures").join(name)).unwrap() == wanted, "{name}");
    }
}
