//! What the end-to-end tests share: small scenes made of boxes, and the real binaries.
#![allow(dead_code, missing_docs, unreachable_pub)]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use enf_layout::photon::PhotonRecord;
use enf_layout::segment::{ExtentKind, StageKind};
use enf_store::{MemoryBudget, StageReader, StoreDir};
use serde_json::Value;

/// Where a binary of this package is.
pub fn bin_path(name: &str) -> &'static str {
    match name {
        "enfilade" => env!("CARGO_BIN_EXE_enfilade"),
        "enf-partition" => env!("CARGO_BIN_EXE_enf-partition"),
        "enf-grid" => env!("CARGO_BIN_EXE_enf-grid"),
        "enf-trace" => env!("CARGO_BIN_EXE_enf-trace"),
        "enf-kdtree" => env!("CARGO_BIN_EXE_enf-kdtree"),
        "enf-render" => env!("CARGO_BIN_EXE_enf-render"),
        other => panic!("no binary {other}"),
    }
}

/// A binary of this package, without anything on its standard input: all rooms.
pub fn bin(name: &str) -> Command {
    let mut command = Command::new(bin_path(name));
    command.stdin(Stdio::null());
    command
}

/// A shell script in a folder, in which `$PARTITION`, `$GRID`, `$TRACE`, `$KDTREE`, `$RENDER` and `$ENFILADE` are
/// the binaries.
pub fn shell(dir: &Path, script: &str) -> Command {
    let mut command = Command::new("sh");
    command.arg("-c").arg(script).current_dir(dir).stdin(Stdio::null());
    for name in STAGES {
        command.env(name.trim_start_matches("enf-").to_uppercase(), bin_path(name));
    }
    command.env("ENFILADE", bin_path("enfilade"));
    command
}

/// The stages' binaries, in order.
pub const STAGES: [&str; 5] =
    ["enf-partition", "enf-grid", "enf-trace", "enf-kdtree", "enf-render"];

/// A small picture of [`furnished`].
pub const PICTURE: [&str; 8] =
    ["--view", "door", "--width", "32", "--height", "24", "--samples", "2"];

/// The first word of a stage's files in a store.
pub fn stage_name(binary: &str) -> &str {
    binary.trim_start_matches("enf-")
}

/// Runs and expects success.
pub fn ok(command: &mut Command) -> Output {
    let output = command.output().expect("the binary starts");
    assert!(
        output.status.success(),
        "{command:?} ended with {}\n{}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    output
}

/// Runs and expects this exit code and a clean message; returns standard error.
pub fn fails(command: &mut Command, code: i32) -> String {
    let output = command.output().expect("the binary starts");
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{command:?}\n{text}");
    assert!(!text.trim().is_empty(), "a failure says why");
    text
}

/// What was said; never a panic, whatever happened.
pub fn stderr(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!text.contains("panicked") && !text.contains("internal error"), "{text}");
    text
}

pub fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// An OBJ being written.
#[derive(Default)]
pub struct Model {
    text: String,
    vertices: usize,
}

impl Model {
    pub fn object(&mut self, name: &str) {
        let _ = writeln!(self.text, "o {name}");
    }

    pub fn material(&mut self, name: &str) {
        let _ = writeln!(self.text, "usemtl {name}");
    }

    /// A quadrilateral, counter-clockwise from its front.
    pub fn quad(&mut self, corners: [[f64; 3]; 4]) {
        for [x, y, z] in corners {
            let _ = writeln!(self.text, "v {x} {y} {z}");
        }
        let v = self.vertices;
        let _ = writeln!(self.text, "f {} {} {} {}", v + 1, v + 2, v + 3, v + 4);
        self.vertices += 4;
    }

    /// A triangle, counter-clockwise from its front.
    pub fn triangle(&mut self, corners: [[f64; 3]; 3]) {
        for [x, y, z] in corners {
            let _ = writeln!(self.text, "v {x} {y} {z}");
        }
        let v = self.vertices;
        let _ = writeln!(self.text, "f {} {} {}", v + 1, v + 2, v + 3);
        self.vertices += 3;
    }

    /// A box with its fronts outwards (or inwards: a room seen from inside).
    pub fn cuboid(&mut self, min: [f64; 3], max: [f64; 3], inwards: bool) {
        let c = |i: usize| [0, 1, 2].map(|a| if i >> a & 1 == 0 { min[a] } else { max[a] });
        let faces =
            [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        for face in faces {
            let mut corners = face.map(c);
            if inwards {
                corners.reverse();
            }
            self.quad(corners);
        }
    }

    /// The same box turned about its vertical axis by `degrees`: nothing in it is parallel to a wall.
    pub fn turned(&mut self, centre: [f64; 3], half: [f64; 3], degrees: f64) {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let c = |i: usize| {
            let s = [0, 1, 2].map(|a| if i >> a & 1 == 0 { -half[a] } else { half[a] });
            [
                centre[0] + s[0] * cos - s[1] * sin,
                centre[1] + s[0] * sin + s[1] * cos,
                centre[2] + s[2],
            ]
        };
        let faces =
            [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        for face in faces {
            self.quad(face.map(c));
        }
    }

    pub fn write(&self, path: &Path, mtl: &str) {
        let library = path.with_extension("mtl");
        std::fs::write(&library, mtl).expect("the test folder is writable");
        let name = library.file_name().expect("a name").to_string_lossy().into_owned();
        std::fs::write(path, format!("mtllib {name}\n{}", self.text)).expect("writable");
    }
}

pub const MATERIALS: &str = "\
newmtl white\nKd 0.75 0.75 0.75\n
newmtl red\nKd 0.7 0.2 0.15\n
newmtl mirror\nKd 0 0 0\nKs 0.9 0.9 0.9\nillum 3\n
newmtl glass\nKd 0 0 0\nd 0.05\nNi 1.5\nillum 4\n
newmtl lamp\nKd 0.5 0.5 0.5\nKe 20 18 15\n";

/// Two rooms of 5 x 4 x 2.8 m behind walls of 0.2 m, joined by a doorway, furnished with turned boxes, a mirror and
/// a pane; one lamp in the first room and one in the second.
pub fn two_rooms(path: &Path) {
    let mut m = Model::default();
    m.object("slabs");
    m.material("white");
    m.cuboid([-0.2, -0.2, -0.2], [10.4, 4.2, 0.0], false);
    m.cuboid([-0.2, -0.2, 2.8], [10.4, 4.2, 3.0], false);
    m.object("walls");
    m.cuboid([-0.2, -0.2, 0.0], [10.4, 0.0, 2.8], false);
    m.cuboid([-0.2, 4.0, 0.0], [10.4, 4.2, 2.8], false);
    m.cuboid([-0.2, 0.0, 0.0], [0.0, 4.0, 2.8], false);
    m.material("red");
    m.cuboid([10.2, 0.0, 0.0], [10.4, 4.0, 2.8], false);
    m.material("white");
    // The wall between them, with a doorway of 0.9 x 2.1 m.
    m.cuboid([5.0, 0.0, 0.0], [5.2, 1.5, 2.8], false);
    m.cuboid([5.0, 2.4, 0.0], [5.2, 4.0, 2.8], false);
    m.cuboid([5.0, 1.5, 2.1], [5.2, 2.4, 2.8], false);
    m.object("table");
    m.material("red");
    m.turned([1.7, 1.3, 0.36], [0.6, 0.4, 0.36], 17.0);
    m.object("cupboard");
    m.turned([8.3, 3.2, 0.9], [0.5, 0.3, 0.9], -8.0);
    m.object("chair");
    m.turned([3.2, 2.9, 0.25], [0.25, 0.22, 0.25], 40.0);
    m.object("mirror");
    m.material("mirror");
    m.quad([[2.0, 3.99, 1.0], [2.0, 3.99, 2.0], [1.0, 3.99, 2.0], [1.0, 3.99, 1.0]]);
    m.object("screen");
    m.material("glass");
    m.quad([[6.5, 0.4, 0.0], [6.5, 1.6, 0.0], [6.5, 1.6, 1.9], [6.5, 0.4, 1.9]]);
    for (name, x) in [("lamp-a", 2.2), ("lamp-b", 7.6)] {
        m.object(name);
        m.material("lamp");
        m.quad([[x, 1.7, 2.75], [x, 2.3, 2.75], [x + 0.6, 2.3, 2.75], [x + 0.6, 1.7, 2.75]]);
    }
    m.write(path, MATERIALS);
}

/// A closed cube of 4 m that glows with radiance 2 and reflects `reflectance` everywhere, with a view `in` it: radiance is
/// 2 / (1 - reflectance) wherever one looks.
pub fn furnace(dir: &Path, reflectance: f32) -> PathBuf {
    let scene = dir.join("furnace.toml");
    let mut model = Model::default();
    model.object("box");
    model.material("glow");
    model.cuboid([0.0; 3], [4.0, 4.0, 4.0], true);
    let r = reflectance;
    model.write(&dir.join("box.obj"), &format!("newmtl glow\nKd {r} {r} {r}\nKe 2 2 2\n"));
    std::fs::write(
        &scene,
        "[[mesh]]\nfile = \"box.obj\"\n[[view]]\nname = \"in\"\neye = [2, 2, 2]\ntarget = [3.9, 2, 2]\nfov = 40\n",
    )
    .unwrap();
    scene
}

/// Everything but the pictures: the store of a scene, made anew, with flags for the partitioner and for the maps.
pub fn light(scene: &Path, photons: &str, partition: &[&str], maps: &[&str]) -> PathBuf {
    let store = scene.with_extension("enf");
    let _ = std::fs::remove_dir_all(&store);
    ok(bin("enf-partition").arg(scene).arg("-o").arg(&store).arg("--quiet").args(partition));
    ok(bin("enf-grid").arg(&store).arg("--quiet"));
    ok(bin("enf-trace").arg(&store).args(["--quiet", "--photons-per-light", photons]));
    ok(bin("enf-kdtree").arg(&store).arg("--quiet").args(maps));
    store
}

/// [`two_rooms`] with a third room, more furniture (about 1200 triangles) and, in `rooms.toml`, two views; returns
/// that scene file.
pub fn furnished(dir: &Path) -> PathBuf {
    let mut m = Model::default();
    m.object("slabs");
    m.material("white");
    m.cuboid([-0.2, -0.2, -0.2], [10.4, 8.4, 0.0], false);
    m.cuboid([-0.2, -0.2, 2.8], [10.4, 8.4, 3.0], false);
    m.object("walls");
    m.cuboid([-0.2, -0.2, 0.0], [10.4, 0.0, 2.8], false);
    m.cuboid([-0.2, 8.2, 0.0], [10.4, 8.4, 2.8], false);
    m.cuboid([-0.2, 0.0, 0.0], [0.0, 8.2, 2.8], false);
    m.material("red");
    m.cuboid([10.2, 0.0, 0.0], [10.4, 8.2, 2.8], false);
    m.material("white");
    // Doorways of 0.9 x 2.1 m from the first room to the other two.
    m.cuboid([5.0, 0.0, 0.0], [5.2, 1.5, 2.8], false);
    m.cuboid([5.0, 2.4, 0.0], [5.2, 4.0, 2.8], false);
    m.cuboid([5.0, 1.5, 2.1], [5.2, 2.4, 2.8], false);
    m.cuboid([0.0, 4.0, 0.0], [3.0, 4.2, 2.8], false);
    m.cuboid([3.9, 4.0, 0.0], [10.2, 4.2, 2.8], false);
    m.cuboid([3.0, 4.0, 2.1], [3.9, 4.2, 2.8], false);
    let mut state = 12345u32;
    let mut random = |from: f64, to: f64| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        from + (to - from) * f64::from(state >> 8) / f64::from(1u32 << 24)
    };
    for i in 0..80 {
        m.object(&format!("thing-{i}"));
        m.material(["white", "red"][i % 2]);
        let (x0, y0, x1, y1) =
            [(0.6, 0.6, 4.4, 3.4), (5.8, 0.6, 9.6, 3.4), (0.6, 4.8, 9.6, 7.6)][i % 3];
        let half = [random(0.05, 0.3), random(0.05, 0.3), random(0.05, 0.4)];
        let centre = [random(x0, x1), random(y0, y1), half[2] + random(0.0, 0.3)];
        m.turned(centre, half, random(-45.0, 45.0));
    }
    m.object("mirror");
    m.material("mirror");
    m.quad([[2.0, 3.99, 1.0], [2.0, 3.99, 2.0], [1.0, 3.99, 2.0], [1.0, 3.99, 1.0]]);
    m.object("screen");
    m.material("glass");
    m.quad([[6.5, 0.4, 0.0], [6.5, 1.6, 0.0], [6.5, 1.6, 1.9], [6.5, 0.4, 1.9]]);
    for (name, x, y) in [("lamp-a", 2.2, 1.7), ("lamp-b", 7.6, 1.7), ("lamp-c", 5.0, 6.0)] {
        m.object(name);
        m.material("lamp");
        let (x1, y1) = (x + 0.6, y + 0.6);
        m.quad([[x, y, 2.75], [x, y1, 2.75], [x1, y1, 2.75], [x1, y, 2.75]]);
    }
    m.write(&dir.join("furnished.obj"), MATERIALS);
    let scene = dir.join("rooms.toml");
    std::fs::write(
        &scene,
        "[[mesh]]\nfile = \"furnished.obj\"\n\
         [[view]]\nname = \"door\"\neye = [0.4, 0.5, 1.7]\ntarget = [6.0, 2.2, 1.0]\nfov = 60\n\
         [[view]]\nname = \"hall\"\neye = [9.7, 7.7, 1.6]\ntarget = [3.0, 4.0, 1.1]\nfov = 70\n",
    )
    .expect("writable");
    scene
}

/// A copy of a store. `without` names stages (by their binaries) whose files are left out.
pub fn copy_store(from: &Path, to: &Path, without: &[&str]) {
    let _ = std::fs::remove_dir_all(to);
    std::fs::create_dir_all(to).expect("writable");
    for name in files_of(from) {
        let stage = name.split('.').next().unwrap_or("");
        if !without.iter().any(|w| stage_name(w) == stage) {
            std::fs::copy(from.join(&name), to.join(&name)).expect("readable");
        }
    }
}

/// The names of the files in a store, sorted.
pub fn files_of(store: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(store)
        .expect("a store")
        .map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// The lines of standard output as room ids.
pub fn ids(output: &Output) -> Vec<u32> {
    stdout(output).lines().map(|l| l.parse().expect("an id on every line")).collect()
}

/// Rooms of a store, the outside included: the ids that stages print.
pub fn room_count(store: &Path) -> u32 {
    let text = stdout(&ok(bin("enfilade").arg("inspect").arg(store).args(["--rooms", "--json"])));
    let value: Value = serde_json::from_str(&text).expect("JSON");
    value["rooms"].as_array().expect("a list").len() as u32
}

/// All five stages of a small scene with the driver; returns the store.
pub fn run_all(scene: &Path, out: &Path, extra: &[&str]) -> PathBuf {
    let mut command = bin("enfilade");
    command.arg("run").arg(scene).arg("-o").arg(out);
    command.args([
        "--photons-per-light",
        "3k",
        "--samples",
        "2",
        "--width",
        "64",
        "--height",
        "48",
    ]);
    command.args(["--quiet"]).args(extra);
    ok(&mut command);
    let stem = scene.file_stem().expect("a name").to_string_lossy().into_owned();
    out.join(format!("{stem}.enf"))
}

/// Photons of a trace that were emitted, absorbed, escaped, and stored, by its ledger.
pub fn counts(store: &Path) -> [u64; 4] {
    let text = stdout(&ok(bin("enfilade").arg("inspect").arg(store).args(["--ledger", "--json"])));
    let value: Value = serde_json::from_str(&text).expect("JSON");
    let all = value["ledger"].as_array().and_then(|l| l.last()).expect("a ledger");
    ["emitted", "absorbed", "escaped", "stored"].map(|key| all[key].as_u64().expect("a count"))
}

pub fn digest(store: &Path, kind: &str) -> String {
    stdout(&ok(bin("enfilade").arg("inspect").arg(store).args(["--digest", kind])))
        .trim()
        .to_string()
}

pub fn json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).expect("the report is there")).expect("it is JSON")
}

pub fn number(value: &Value, key: &str) -> f64 {
    key.split('.')
        .try_fold(value, |v, k| v.get(k))
        .and_then(Value::as_f64)
        .unwrap_or_else(|| panic!("no number {key} in {value:#}"))
}

/// Every stored photon of a traced store.
pub fn photons(store: &Path) -> Vec<PhotonRecord> {
    let store = StoreDir::open(store).expect("a store");
    let reader = StageReader::open(&store, StageKind::Trace).expect("traced");
    let budget = MemoryBudget::new(1 << 32);
    let mut all = Vec::new();
    for extent in reader.extents(ExtentKind::Photons) {
        let block = reader.read(extent, &budget, "photons").expect("sound");
        all.extend_from_slice(block.as_slice_of::<PhotonRecord>().expect("whole records"));
    }
    all
}

/// Partition, grid and trace with more flags for the first and the last of them; the trace's report.
pub fn traced(scene: &Path, store: &Path, partition: &[&str], trace: &[&str]) -> Value {
    let stats = store.with_extension("json");
    ok(bin("enf-partition").arg(scene).arg("-o").arg(store).arg("--quiet").args(partition));
    ok(bin("enf-grid").arg(store).arg("--quiet"));
    ok(bin("enf-trace").arg(store).arg("--quiet").args(trace).arg("--stats").arg(&stats));
    json(&stats)
}

/// The scalar flux of a stored photon, W.
pub fn watts(photon: &PhotonRecord) -> f64 {
    let [r, g, b] = photon.flux_w().map(f64::from);
    0.2126 * r + 0.7152 * g + 0.0722 * b
}
