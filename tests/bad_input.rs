//! Whatever comes in, the answer is a sentence and an exit code: 2 for what was typed, 4 for what was read, 5 for
//! what could not be written. Never a panic.

mod common;

use common::{MATERIALS, Model, bin, fails, furnished, ok, stderr, two_rooms};
use std::path::{Path, PathBuf};

/// `enf-partition SCENE -o b.enf` ends with 4 and says these words; nothing is left behind that is in the way.
fn refused(dir: &Path, scene: &Path, words: &[&str]) {
    let store = dir.join("b.enf");
    let said = fails(bin("enf-partition").arg(scene).arg("-o").arg(&store), 4);
    for word in words {
        assert!(said.contains(word), "{word:?} is not in: {said}");
    }
    let out = dir.join("out");
    let said = fails(bin("enfilade").arg("run").arg(scene).arg("-o").arg(&out), 4);
    for word in words {
        assert!(said.contains(word), "{word:?} is not in: {said}");
    }
    let _ = std::fs::remove_dir_all(store);
    let _ = std::fs::remove_dir_all(out);
}

fn write(dir: &Path, name: &str, text: &str) -> PathBuf {
    let path = dir.join(name);
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn a_scene_that_is_not_there() {
    let dir = tempfile::tempdir().unwrap();
    refused(dir.path(), &dir.path().join("nowhere.obj"), &["nowhere.obj"]);
    refused(dir.path(), &dir.path().join("nowhere.toml"), &["nowhere.toml"]);
    refused(dir.path(), dir.path(), &[&dir.path().display().to_string()]);
    let scene = write(dir.path(), "scene.toml", "[[mesh]]\nfile = \"missing.obj\"\n");
    refused(dir.path(), &scene, &["missing.obj"]);
}

#[test]
fn a_model_without_triangles() {
    let dir = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("empty.obj", ""),
        ("words.obj", "# nothing but words\n"),
        ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
        ("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"),
    ] {
        let scene = write(dir.path(), name, text);
        refused(dir.path(), &scene, &[name]);
    }
}

#[test]
fn numbers_that_are_none() {
    let dir = tempfile::tempdir().unwrap();
    for (name, vertex) in
        [("nan.obj", "nan"), ("inf.obj", "inf"), ("huge.obj", "1e39"), ("word.obj", "seven")]
    {
        let text = format!("v 0 0 0\nv 1 {vertex} 0\nv 0 1 0\nf 1 2 3\n");
        let scene = write(dir.path(), name, &text);
        refused(dir.path(), &scene, &[name]);
    }
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n";
    refused(dir.path(), &write(dir.path(), "index.obj", text), &["index.obj", "4"]);
    let text = "v 0 0 0\nv 1 0\n";
    refused(dir.path(), &write(dir.path(), "short.obj", text), &["short.obj", "2"]);
}

#[test]
fn a_scene_without_any_light() {
    let dir = tempfile::tempdir().unwrap();
    let mut model = Model::default();
    model.object("room");
    model.material("white");
    model.cuboid([0.0; 3], [4.0, 3.0, 2.5], true);
    let scene = dir.path().join("dark.obj");
    model.write(&scene, MATERIALS);
    refused(dir.path(), &scene, &["dark.obj", "no light", "--ceiling-lights"]);
    // And the advice is good.
    let store = dir.path().join("lit.enf");
    ok(bin("enf-partition").arg(&scene).arg("-o").arg(&store).args(["--ceiling-lights", "500lx"]));
    ok(bin("enf-grid").arg(&store));
    ok(bin("enf-trace").arg(&store).args(["--photons-per-light", "100"]));
    for nonsense in ["bright", "-5", "nan"] {
        let flag = format!("--ceiling-lights={nonsense}");
        fails(bin("enf-partition").arg(&scene).args(["-o", "x.enf", &flag]), 2);
    }
}

#[test]
fn a_scene_file_with_mistakes() {
    let dir = tempfile::tempdir().unwrap();
    two_rooms(&dir.path().join("rooms.obj"));
    let mesh = "[[mesh]]\nfile = \"rooms.obj\"\n";
    for (name, text, words) in [
        ("key.toml", format!("colour = \"red\"\n{mesh}"), &["key.toml", "colour"][..]),
        (
            "light.toml",
            format!("{mesh}[[light]]\nkind = \"point\"\nbrigtness = 3\n"),
            &["brigtness"],
        ),
        ("kind.toml", format!("{mesh}[[light]]\nname = \"l\"\nkind = \"laser\"\n"), &["laser"]),
        ("syntax.toml", format!("{mesh}[[view\n"), &["syntax.toml"]),
        ("none.toml", String::new(), &["none.toml"]),
        ("bytes.toml", "\u{0}\u{1}".into(), &["bytes.toml"]),
        ("units.toml", format!("units = \"parsec\"\n{mesh}"), &["parsec"]),
        (
            "view.toml",
            format!("{mesh}[[view]]\nname = \"v\"\neye = [1, 1]\ntarget = [2, 2, 1]\n"),
            &["view.toml"],
        ),
    ] {
        let scene = write(dir.path(), name, &text);
        refused(dir.path(), &scene, words);
    }
    let scene = dir.path().join("latin.toml");
    std::fs::write(&scene, [b'n', b'=', b'"', 0xe9, b'"']).unwrap();
    refused(dir.path(), &scene, &["latin.toml"]);
}

#[test]
fn a_compressed_model_that_is_cut_short() {
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes) in [
        ("noise.obj.zst", vec![7u8; 300]),
        ("empty.obj.zst", Vec::new()),
        // The frame's magic number and nothing more.
        ("cut.obj.zst", vec![0x28, 0xb5, 0x2f, 0xfd, 0x04]),
    ] {
        let scene = dir.path().join(name);
        std::fs::write(&scene, bytes).unwrap();
        refused(dir.path(), &scene, &[name]);
    }
    let scene = write(dir.path(), "model.skp", "what is this");
    refused(dir.path(), &scene, &["model.skp"]);
}

/// Everything traced, for questions to the renderer.
fn ready(dir: &Path) -> PathBuf {
    let scene = furnished(dir);
    let store = dir.join("b.enf");
    ok(bin("enf-partition").arg(&scene).arg("-o").arg(&store));
    ok(bin("enf-grid").arg(&store));
    ok(bin("enf-trace").arg(&store).args(["--photons-per-light", "200"]));
    ok(bin("enf-kdtree").arg(&store));
    store
}

#[test]
fn a_view_that_is_not_there() {
    let dir = tempfile::tempdir().unwrap();
    let store = ready(dir.path());
    let render = |flags: &[&str]| {
        let mut command = bin("enf-render");
        command.arg(&store).args(["--width", "16", "--height", "12", "--samples", "1"]).args(flags);
        command.arg("-o").arg(dir.path().join("pictures"));
        command
    };
    let said = fails(&mut render(&["--view", "lobby"]), 2);
    assert!(said.contains("lobby") && said.contains("door") && said.contains("hall"), "{said}");
    let said = fails(&mut render(&["--view", "room:9999"]), 2);
    assert!(said.contains("room:9999"), "{said}");
    fails(&mut render(&["--view", "room:one"]), 2);
    fails(&mut render(&["--view", ""]), 2);
    let missing = dir.path().join("missing.toml").display().to_string();
    let said = fails(&mut render(&["--views", &missing]), 4);
    assert!(said.contains("missing.toml"), "{said}");
    let blind = write(
        dir.path(),
        "blind.toml",
        "[[view]]\nname = \"b\"\neye = [1, 1, 1]\ntarget = [1, 1, 1]\n",
    );
    let said = fails(&mut render(&["--views", &blind.display().to_string()]), 4);
    assert!(said.contains("blind.toml") || said.contains("view b"), "{said}");
    let empty = write(dir.path(), "empty.toml", "");
    let output = render(&["--views", &empty.display().to_string()]).output().unwrap();
    assert!(matches!(output.status.code(), Some(2 | 4)), "{}", stderr(&output));
    // Several views and one file.
    let mut command = bin("enf-render");
    command.arg(&store).args(["--view", "all", "-o"]).arg(dir.path().join("one.png"));
    let said = fails(&mut command, 2);
    assert!(said.contains("folder"), "{said}");
    // Pictures that cannot be numbered.
    for flags in [
        &["--view", "all", "--width", "65536", "--height", "65536"][..],
        &["--view", "door", "--width", "65536", "--height", "65536"],
        &["--view", "door", "--width", "0"],
        &["--view", "door", "--samples", "0"],
        &["--view", "door", "--exposure", "bright"],
    ] {
        let mut command = bin("enf-render");
        fails(command.arg(&store).args(flags).arg("-o").arg(dir.path().join("p")), 2);
    }
}

/// The driver knows before it works that a view will not be found.
#[test]
fn run_refuses_an_unknown_view() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let out = dir.path().join("out");
    let flags = ["--photons-per-light", "100", "--view", "lobby"];
    let said = fails(bin("enfilade").arg("run").arg(&scene).arg("-o").arg(&out).args(flags), 2);
    assert!(said.contains("lobby"), "{said}");
}

/// What a picture is called and what is asked for with `--formats` must not differ in silence.
#[test]
fn a_picture_whose_name_is_no_wanted_format() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let out = dir.path().join("out");
    let flags =
        ["--photons-per-light", "100", "--view", "room:0", "--width", "16", "--height", "12"];
    ok(bin("enfilade").arg("run").arg(&scene).arg("-o").arg(&out).args(flags));
    let store = std::fs::read_dir(&out)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .find(|path| path.extension().is_some_and(|e| e == "enf"))
        .unwrap();
    let picture = |name: &str, formats: &str| {
        let mut render = bin("enf-render");
        render.arg(&store).args(["--view", "room:0", "--width", "16", "--height", "12"]);
        render.arg("-o").arg(dir.path().join(name)).args(["--formats", formats, "--force"]);
        render
    };
    let said = fails(&mut picture("x.png", "falsecolour"), 2);
    assert!(said.contains("x.png") && said.contains("--formats"), "{said}");
    assert!(!dir.path().join("x.png").exists());
    ok(&mut picture("x.png", "hdr,png"));
    assert!(dir.path().join("x.png").exists());
}

#[test]
fn output_that_cannot_be_written() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let file = write(dir.path(), "file", "a regular file");
    let below = file.join("below");

    // Below a regular file nothing can be made.
    let said = fails(bin("enf-partition").arg(&scene).arg("-o").arg(&below), 5);
    assert!(said.contains("below"), "{said}");
    let said = fails(bin("enfilade").arg("run").arg(&scene).arg("-o").arg(&below), 5);
    assert!(said.contains("below"), "{said}");
    let store = dir.path().join("b.enf");
    let mut partition = bin("enf-partition");
    let said = fails(partition.arg(&scene).arg("-o").arg(&store).arg("--stats").arg(&below), 5);
    assert!(said.contains("below"), "{said}");
    let mut partition = bin("enf-partition");
    let said = fails(partition.arg(&scene).arg("-o").arg(&store).arg("--trace").arg(&below), 5);
    assert!(said.contains("below"), "{said}");
    let said =
        fails(bin("enfilade").args(["building", "l-shape", "-o"]).arg(below.join("scene.toml")), 5);
    assert!(said.contains("below"), "{said}");

    // A file where a folder is wanted: another run's output, or the user's own, is in the way.
    let said = fails(bin("enf-partition").arg(&scene).arg("-o").arg(&file), 2);
    assert!(said.contains("file") && said.contains("-o"), "{said}");
    let output = bin("enfilade").arg("run").arg(&scene).arg("-o").arg(&file).output().unwrap();
    assert!(matches!(output.status.code(), Some(2 | 5)), "{}", stderr(&output));
    assert!(stderr(&output).contains("file"));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "a regular file");

    let store = ready(dir.path());
    let view = ["--view", "door", "--width", "16", "--height", "12", "--samples", "1", "-o"];
    let said = fails(bin("enf-render").arg(&store).args(view).arg(&below), 5);
    assert!(said.contains("below"), "{said}");
    let said = fails(bin("enf-render").arg(&store).args(view).arg(below.join("p.png")), 5);
    assert!(said.contains("below"), "{said}");
    let output = bin("enf-render").arg(&store).args(view).arg(&file).output().unwrap();
    assert!(matches!(output.status.code(), Some(2 | 5)), "{}", stderr(&output));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "a regular file");
}

#[test]
fn flags_that_make_no_sense() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let scene = scene.display().to_string();
    let store = ready(dir.path()).display().to_string();
    for (stage, flags) in [
        ("enf-partition", &[scene.as_str(), "-o", "x.enf", "--rooms", "0"][..]),
        ("enf-partition", &[&scene, "-o", "x.enf", "--rooms", "many"]),
        ("enf-partition", &[&scene, "-o", "x.enf", "--doors", "ajar"]),
        ("enf-partition", &[&scene, "-o", "x.enf", "--units", "-1"]),
        ("enf-partition", &[&scene, "-o", "x.enf", "--units", "nan"]),
        ("enf-partition", &[&scene, "-o", "x.enf", "--units", "0"]),
        ("enf-partition", &[&scene]),
        ("enf-partition", &[]),
        ("enf-grid", &[&store, "--threads", "0"]),
        ("enf-grid", &[&store, "--threads", "100000"]),
        ("enf-trace", &[&store, "--photons-per-light", "0", "--force"]),
        ("enf-trace", &[&store, "--photons-per-light", "5G", "--force"]),
        ("enf-trace", &[&store, "--photons-per-light", "-1"]),
        ("enf-trace", &[&store, "--queue-rows", "0"]),
        ("enf-trace", &[&store, "--epoch", "-1"]),
        ("enf-trace", &[&store, "--epoch", "nan"]),
        ("enf-trace", &[&store, "--seed", "x"]),
        ("enf-kdtree", &[&store, "--gather-radius", "0"]),
        ("enf-kdtree", &[&store, "--gather-radius", "nan"]),
        ("enf-kdtree", &[&store, "--no-such-flag"]),
        ("enfilade", &["no-such-command"]),
        ("enfilade", &[]),
        ("enfilade", &["building", "pyramid", "-o", "x.toml"]),
        ("enfilade", &["inspect", &store, "--digest", "smells"]),
    ] {
        fails(bin(stage).args(flags).current_dir(dir.path()), 2);
    }
    // None of them cost anything.
    ok(bin("enfilade").args(["inspect", &store, "--verify"]));
    ok(bin("enf-kdtree").arg(&store));
    assert!(!dir.path().join("x.enf").exists());
    for name in common::STAGES {
        for flag in ["--help", "--version"] {
            let output = ok(bin(name).arg(flag));
            assert!(
                !common::stdout(&output).is_empty() && stderr(&output).is_empty(),
                "{name} {flag}"
            );
        }
    }
}

/// Numbers beyond all measure are refused, or are no more than a request.
#[test]
fn numbers_that_are_too_large() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let store = dir.path().join("b.enf");
    for flags in [["--rooms", "4000000000"], ["--random-tiles", "4000000000"], ["--units", "1e300"]]
    {
        let output =
            bin("enf-partition").arg(&scene).arg("-o").arg(&store).args(flags).output().unwrap();
        let code = output.status.code();
        assert!(matches!(code, Some(2 | 4)), "{flags:?} {code:?}: {}", stderr(&output));
    }
    for tiles in ["0", "1", "3"] {
        let mut partition = bin("enf-partition");
        let flags = ["--tile-triangles", tiles, "--force"];
        let output = partition.arg(&scene).arg("-o").arg(&store).args(flags).output().unwrap();
        assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
    }
    ok(bin("enf-partition").arg(&scene).arg("-o").arg(&store).arg("--force"));
    ok(bin("enf-grid").arg(&store));
    let queue = ["--queue-rows", "1000000", "--queue-block", "1G"];
    let said = fails(bin("enf-trace").arg(&store).args(queue), 3);
    assert!(said.contains("table of incoming photons"), "{said}");
}
