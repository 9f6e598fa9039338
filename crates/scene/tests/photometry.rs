//! Luminaires: IES files of every edition and symmetry, their flux in closed form, and spot and IES lights of scene files.

use enf_layout::light::{LIGHT_PROFILE, LIGHT_SPOT, LightRecord};
use enf_layout::profile::Profile;
use enf_scene::photometry::{PhotometricType, Photometry, parse};
use enf_scene::{LoadOptions, Scene, load};
use glam::{DVec3, Vec3};
use proptest::prelude::*;
use std::{f64::consts::PI, fmt::Write as _, fs, path::Path};
use tempfile::TempDir;

fn read(text: &str) -> Photometry {
    parse(Path::new("lamp.ies"), text.as_bytes()).unwrap_or_else(|e| panic!("{e}\n{text}"))
}

fn error(text: &str) -> String {
    parse(Path::new("lamp.ies"), text.as_bytes()).expect_err("must fail").to_string()
}

fn list(values: impl IntoIterator<Item = f64>) -> String {
    values.into_iter().map(|v| format!("{v} ")).collect()
}

/// A file of this photometric type (1 C, 2 B, 3 A) with intensities by vertical, then horizontal angle.
fn file(kind: u32, v: &[f64], h: &[f64], candela: impl Fn(f64, f64) -> f64) -> String {
    let mut text = format!(
        "IESNA:LM-63-2002\n[TEST] none\nTILT=NONE\n1 1000 1 {} {} {kind} 2 0 0 0\n1 1 10\n{}\n{}\n",
        v.len(),
        h.len(),
        list(v.iter().copied()),
        list(h.iter().copied())
    );
    for &h in h {
        writeln!(text, "{}", list(v.iter().map(|&v| candela(v, h)))).unwrap();
    }
    text
}

fn every(step: f64, to: f64) -> Vec<f64> {
    (0..=(to / step).round() as usize).map(|i| i as f64 * step).collect()
}

fn from(first: f64, step: f64, last: f64) -> Vec<f64> {
    every(step, last - first).iter().map(|a| first + a).collect()
}

/// Candela that a luminaire sends towards `to`, in a room with z up.
fn towards(lamp: &Photometry, down: DVec3, zero: DVec3, to: DVec3) -> f64 {
    let mut values = Vec::new();
    let record = lamp.samples().store(&mut values).unwrap();
    let profile = Profile::new(&record, &values).unwrap();
    profile.check().unwrap();
    let (axis, tangent) = lamp.frame(down, zero);
    let square = tangent.cross(axis);
    let polar = to.dot(axis).clamp(-1.0, 1.0).acos();
    profile.at(polar, to.dot(square).atan2(to.dot(tangent))) * lamp.lumens()
}

#[test]
fn a_lambertian_file_has_pi_lumens_a_candela() {
    let lamp = read(&file(1, &every(1.0, 90.0), &[0.0], |v, _| 1000.0 * v.to_radians().cos()));
    // Chords lie below the cosine, by 1/12 of the square of a degree on average.
    let expected = 1000.0 * PI * (1.0 - 1f64.to_radians().powi(2) / 12.0);
    assert!((lamp.lumens() / expected - 1.0).abs() < 1e-6, "{}", lamp.lumens());
    assert_eq!((lamp.edition, lamp.kind, lamp.lamps), (2002, PhotometricType::C, 1.0));
    assert_eq!((lamp.lamp_lumens, lamp.input_watts), (Some(1000.0), 10.0));
}

/// One distribution, written with every symmetry that it has, is one distribution.
#[test]
fn symmetries_of_type_c() {
    let candela = |v: f64, h: f64| {
        let (v, h) = (v.to_radians(), h.to_radians());
        100.0 * (1.0 + v.cos()) * (1.5 + (2.0 * h).cos())
    };
    let v = every(5.0, 180.0);
    let whole = read(&file(1, &v, &every(5.0, 360.0), candela));
    let others = [every(5.0, 90.0), every(5.0, 180.0), from(90.0, 5.0, 270.0), every(5.0, 355.0)];
    for h in &others {
        let lamp = read(&file(1, &v, h, candela));
        assert!((lamp.lumens() / whole.lumens() - 1.0).abs() < 1e-12, "{h:?}");
        for i in 0..200 {
            let (z, a) = (1.0 - f64::from(i) / 100.0 - 0.003, 2.4 * f64::from(i));
            let r = (1.0 - z * z).max(0.0).sqrt();
            let to = DVec3::new(r * a.cos(), r * a.sin(), z);
            let [a, b] = [&lamp, &whole].map(|l| towards(l, DVec3::NEG_Z, DVec3::X, to));
            assert!((a - b).abs() < 1e-3, "{h:?}: {a} for {b}");
        }
    }
    // Half of 1.5 lies in cos 2h: 4 pi 150 and nothing of the cosine of v.
    assert!((whole.lumens() / (4.0 * PI * 150.0) - 1.0).abs() < 1e-3, "{}", whole.lumens());
}

#[test]
fn angles_of_type_c_go_counter_clockwise() {
    let lamp = read(&file(1, &[0.0, 90.0, 180.0], &every(90.0, 360.0), |v, h| {
        if v == 90.0 { 1.0 + h % 360.0 / 90.0 } else { 0.5 }
    }));
    let there = [DVec3::X, DVec3::Y, DVec3::NEG_X, DVec3::NEG_Y, DVec3::NEG_Z];
    for (to, expected) in there.into_iter().zip([1.0, 2.0, 3.0, 4.0, 0.5]) {
        let found = towards(&lamp, DVec3::NEG_Z, DVec3::X, to);
        assert!((found - expected).abs() < 1e-5, "{to}: {found}");
    }
}

/// LM-63-2002, section 3: photometric zero, straight down, is (H 0, V 0) of types B and C and (H 0, V -90) of type A;
/// photometric horizontal is V 90 of B and C and V 0 of A; horizontal angles of A and B go clockwise.
#[test]
fn types_a_and_b() {
    let (down, zero) = (DVec3::NEG_Z, DVec3::X);
    // Numbers that name the sample: 1000 + v + h / 1000.
    let named = |v: f64, h: f64| 1000.0 + v + h / 1000.0;
    let a = read(&file(3, &from(-90.0, 10.0, 90.0), &from(-90.0, 10.0, 90.0), named));
    let b = read(&file(2, &from(-90.0, 10.0, 90.0), &from(-90.0, 10.0, 90.0), named));
    let there = |lamp: &Photometry, to: DVec3| towards(lamp, down, zero, to.normalize());
    for (to, in_a, in_b) in [
        (DVec3::NEG_Z, named(-90.0, 0.0), named(0.0, 0.0)),
        (DVec3::X, named(0.0, 0.0), named(90.0, 0.0)),
        // Clockwise from x, seen from above, is -y.
        (DVec3::NEG_Y, named(0.0, 90.0), named(0.0, 90.0)),
        (DVec3::new(1.0, -1.0, 0.0), named(0.0, 45.0), named(90.0, 45.0)),
        (DVec3::new(1.0, 0.0, -1.0), named(-45.0, 0.0), named(45.0, 0.0)),
        (DVec3::new(1.0, 1.0, 0.0), named(0.0, -45.0), named(90.0, -45.0)),
    ] {
        let found = there(&a, to);
        // At its poles a table has no horizontal angle.
        assert!((found - in_a).abs() < 0.1, "A towards {to}: {found} for {in_a}");
        if to == DVec3::NEG_Y {
            continue;
        }
        let found = there(&b, to);
        assert!((found - in_b).abs() < 0.02, "B towards {to}: {found} for {in_b}");
    }
    // Above the horizontal, B has no samples behind V 90; A has none behind H 90.
    assert_eq!(there(&a, DVec3::new(-1.0, 0.0, 0.1)), 0.0);
    assert!(
        there(&b, DVec3::new(0.3, 0.0, 1.0)) == 0.0 && there(&b, DVec3::new(-1.0, 0.0, -0.2)) > 0.0
    );
    // Half the sphere at one candela is 2 pi lumens, whatever the poles, mirrored or not.
    for kind in [2, 3] {
        for h in [from(-90.0, 15.0, 90.0), every(15.0, 90.0)] {
            let lamp = read(&file(kind, &from(-90.0, 15.0, 90.0), &h, |_, _| 1.0));
            assert!((lamp.lumens() - 2.0 * PI).abs() < 1e-9, "{kind} {h:?}: {}", lamp.lumens());
        }
        // Mirrored is written out.
        let shape = |v: f64, h: f64| (2.0 + v.to_radians().sin()) * (1.0 + h.abs());
        let half = read(&file(kind, &from(-90.0, 15.0, 90.0), &every(15.0, 90.0), shape));
        let full = read(&file(kind, &from(-90.0, 15.0, 90.0), &from(-90.0, 15.0, 90.0), shape));
        assert!((half.lumens() / full.lumens() - 1.0).abs() < 1e-12);
        for i in 0..40 {
            let t = f64::from(i) * 0.16;
            let to = DVec3::new(0.7 + t.cos(), t.sin(), (3.0 * t).cos());
            assert!(
                (there(&half, to) / there(&full, to).max(1e-9) - 1.0).abs() < 1e-5
                    || there(&full, to) == 0.0
            );
        }
    }
}

#[test]
fn factors_of_every_edition() {
    let body = "TILT=NONE\n2 1000 3 2 1 1 1 2 1 -0.5\n0.5 0.8 40\n0 180\n0\n10 10\n";
    for (head, edition, factor) in [
        ("", 1986, 1.2),
        ("ACME LAMP CO\nA REPORT OF 1987\n", 1986, 1.2),
        ("IESNA91\n[TEST] 1\n", 1991, 1.2),
        ("IESNA:LM-63-1995\n", 1995, 1.2),
        ("IESNA95\n", 1995, 1.2),
        ("IESNA:LM-63-2002\r\n[TEST] x\r\n", 2002, 1.5),
        ("IES:LM-63-2019\n", 2019, 1.5),
        ("\u{feff}IES:LM-63-19\n", 2019, 1.5),
    ] {
        let lamp = read(&format!("{head}{body}"));
        assert_eq!(lamp.edition, edition, "{head}");
        assert!((lamp.candela[0] - 10.0 * factor).abs() < 1e-12, "{head}: {}", lamp.candela[0]);
        assert!((lamp.lumens() - 4.0 * PI * 10.0 * factor).abs() < 1e-9);
        let size = [2.0, 1.0, -0.5].map(|s| s * 0.3048);
        assert_eq!((lamp.opening_m, lamp.feet, lamp.lamps), (size, true, 2.0));
    }
    // Absolute photometry: the lumens of a lamp are -1, the candela count as they are.
    let lamp = read(&body.replace("1000", "-1").replace(" 1 1 2 1", " 1 2 2 1"));
    assert_eq!((lamp.lamp_lumens, lamp.feet, lamp.opening_m[0]), (None, false, 2.0));
}

/// What is found in the wild.
#[test]
fn odd_but_sound() {
    let plain = read("IESNA91\nTILT=NONE\n1 800 1 3 1 1 2 0 0 0\n1 1 8\n0 45 90\n0\n100 50 0\n");
    let odd = [
        "IESNA91\r\n[MANUFAC] caf\u{e9}\r\nTILT=NONE\r\n1 800 1 3 1 1 2 0 0 0\r\n1 1 8\r\n0 45 90\r\n0\r\n100 50 0\r\n",
        "IESNA91\rTILT=NONE\r1 800 1 3 1 1 2 0 0 0\r1 1 8\r0 45 90\r0\r100 50 0\r",
        "IESNA91\n\n  tilt = none  \n1\n800\n1\n3 1 1 2\n0 0\n0 1\n1 8 0\n45 90 0 100\n50\n0",
        "IESNA91\nTILT=NONE\n1,800,1,3,1,1,2,0,0,0\n1, 1, 8\n0, 45, 90,\n0\n1e2, 5.0E+01, .0\n",
        "IESNA91\nTILT=NONE\n1.0 800. +1 3.0 1 1 2 0 0 0\n1 1 8\n0.0 45 90\n0\n100 50 -0\n\n[END] and words\n\u{1a}",
        "IESNA91\n[OTHER] TILT=INCLUDE is not here\nTILT=\"NONE\"\n1 800 1 3 1 1 2 0 0 0 1 1 8 0 45 90 0 100 50 0",
    ];
    for text in odd {
        // Latin-1, as old programs write it.
        let bytes: Vec<u8> = text.chars().map(|c| c as u8).collect();
        let lamp = parse(Path::new("x.ies"), &bytes).unwrap_or_else(|e| panic!("{e}\n{text}"));
        assert_eq!(lamp, plain, "{text}");
    }
    let more = read("TILT=NONE\n1 800 1 3 1 1 2 0 0 0 1 1 8\n0 45 80\n0\n100 50 9\n7 7\n");
    assert_eq!(more.warnings.len(), 2, "{:?}", more.warnings);
    assert!(more.warnings[0].contains("line 6") && more.warnings[1].contains("angle 80"));
}

#[test]
fn errors_name_line_and_remedy() {
    let head = "IESNA91\nTILT=NONE\n1 800 1 ";
    let tail = " 0 0 0\n1 1 8\n";
    for (text, words) in [
        ("IESNA91\n[TEST]\n".to_string(), &["lamp.ies: has no line TILT=", "LM-63"][..]),
        ("T\0I\0".into(), &["no plain text", "UTF-16"]),
        (
            format!("{head}3 1 1 2{tail}0 90 45\n0\n1 1 1\n"),
            &["lamp.ies:5:", "vertical angle 45 comes behind 90", "ascend"],
        ),
        (format!("{head}3 1 1 2{tail}0 45 45\n0\n1 1 1\n"), &[":5:", "45 comes behind 45"]),
        (
            format!("{head}3 2 1 2{tail}0 45 90\n0 45\n1 1 1 1 1 1\n"),
            &[":6:", "horizontal angles from 0 to 45", "90, 180 or 360"],
        ),
        (
            format!("{head}3 1 1 2{tail}0 45 90\n0\n1 1\n"),
            &[":7:", "ends where an intensity is wanted", "cut short"],
        ),
        (format!("{head}3 1 1 2{tail}0 45 90\n0\n1 lm 1\n"), &[":7:", "\"lm\" where an intensity"]),
        (
            format!("{head}3 1 1 2{tail}0 45 90\n0\n1 -2 1\n"),
            &[":7:", "intensity -2 at vertical 45, horizontal 0"],
        ),
        (
            format!("{head}3 1 1 2{tail}-90 0 90\n0\n1 2 1\n"),
            &[":5:", "vertical angles from -90 to 90, of photometric type C"],
        ),
        (
            format!("{head}1 1 1 2{tail}0\n0\n1\n"),
            &[":3:", "number of vertical angles is 1", "from 2"],
        ),
        (format!("{head}3 0 1 2{tail}0\n0\n1\n"), &[":3:", "number of horizontal angles is 0"]),
        (format!("{head}3.5 1 1 2{tail}"), &[":3:", "3.5", "whole number"]),
        (format!("{head}3 1 4 2{tail}"), &[":3:", "photometric type is 4", "1, 2, 3"]),
        (format!("{head}3 1 1 3{tail}"), &[":3:", "type of units is 3"]),
        (format!("{head}3 1 2 2{tail}0 45 90\n0\n1 2 1\n"), &[":6:", "photometric type B"]),
        (format!("{head}1e9 1 1 2{tail}"), &[":3:", "number of vertical angles"]),
        ("A\nTILT=lamp.til\n1".into(), &[":2:", "another file, \"lamp.til\"", "INCLUDE"]),
        ("A\nTILT=INCLUDE\n4\n2\n0 90\n1 1\n".into(), &[":3:", "geometry is 4"]),
        ("A\nTILT=INCLUDE\n1\n2\n90 0\n1 1\n".into(), &[":5:", "tilt angle 0 comes behind 90"]),
    ] {
        let said = error(&text);
        assert!(words.iter().all(|w| said.contains(w)), "{said}\n{text}");
    }
}

#[test]
fn tilt_factors() {
    let text = "IESNA:LM-63-1995\nTILT=INCLUDE\n1\n3\n0 45 90\n1.0 0.9 .6\n1 800 1 2 1 1 2 0 0 0\n1 1 8\n0 180\n0\n10 10\n";
    let lamp = read(text);
    let tilt = lamp.tilt.as_ref().unwrap();
    assert_eq!((tilt.geometry, tilt.factors.len()), (1, 3));
    for (angle, factor) in
        [(0.0, 1.0), (22.5, 0.95), (45.0, 0.9), (75.0, 0.7), (90.0, 0.6), (150.0, 0.6)]
    {
        assert!((lamp.tilt_factor(angle) - factor).abs() < 1e-12, "{angle}");
    }
}

/// Files of real manufacturers, if they are there.
#[test]
fn real_files() {
    let Some(data) = std::env::var_os("ENFILADE_DATA") else {
        eprintln!("SKIPPED: set ENFILADE_DATA to a folder with ies/ies_facts.json");
        return;
    };
    let folder = Path::new(&data).join("ies");
    let facts = fs::read_to_string(folder.join("ies_facts.json")).unwrap();
    let facts: Vec<serde_json::Value> = serde_json::from_str(&facts).unwrap();
    assert!(!facts.is_empty());
    for fact in facts {
        let name = fact["file"].as_str().unwrap();
        let number = |key: &str| fact[key].as_f64().unwrap_or_else(|| panic!("{name}: {key}"));
        let (lamp, _) = enf_scene::photometry::read(&folder.join(name)).unwrap();
        assert_eq!(lamp.warnings, [""; 0], "{name}");
        assert_eq!(lamp.lamps, number("lamps"));
        assert_eq!(lamp.lamp_lumens.unwrap_or(-1.0), number("lumens_per_lamp"));
        assert_eq!(
            (lamp.multiplier, lamp.ballast_factor),
            (number("multiplier"), number("ballast_factor"))
        );
        assert_eq!(lamp.vertical.len() as f64, number("vertical_angles"));
        assert_eq!(lamp.horizontal.len() as f64, number("horizontal_angles"));
        assert_eq!(format!("{:?}", lamp.kind), fact["photometric_type"].as_str().unwrap());
        assert_eq!(lamp.feet, fact["units"] == "feet");
        assert_eq!(lamp.input_watts, number("watts"));
        for (size, key) in lamp.opening_m.iter().zip(["width", "length", "height"]) {
            assert!((size - number(key) * if lamp.feet { 0.3048 } else { 1.0 }).abs() < 1e-12);
        }
        for (angles, key) in [(&lamp.vertical, "v_range"), (&lamp.horizontal, "h_range")] {
            let range = [angles[0], angles[angles.len() - 1]];
            assert_eq!(serde_json::json!(range), fact[key], "{name}");
        }
        let most = lamp.candela.iter().fold(0.0, |m: f64, &c| m.max(c));
        assert!((most - number("candela_max")).abs() < 1e-9, "{name}: {most}");
        // The facts are integrated by the trapezoid rule, which errs by the square of the step.
        let step = lamp.vertical.windows(2).fold(0.0, |m: f64, w| m.max(w[1] - w[0])).to_radians();
        let (own, theirs) = (lamp.lumens(), number("flux_lm_trapezoid"));
        assert!(
            (own / theirs - 1.0).abs() < 0.02 * step + step * step / 4.0,
            "{name}: {own} lm for {theirs}"
        );
        println!("{name}: {own:.1} lm, by the trapezoid rule {theirs:.1}");
    }
}

const ROOM: &str = "v 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nf 1 2 3 4\n";

struct Files(TempDir);

impl Files {
    fn new(lights: &str) -> Self {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("a.obj"), ROOM).unwrap();
        let lamp =
            file(1, &every(5.0, 90.0), &every(45.0, 360.0), |v, h| (90.0 - v) * (1.0 + h % 360.0));
        fs::create_dir(dir.path().join("lamps")).unwrap();
        fs::write(dir.path().join("lamps/a.ies"), lamp).unwrap();
        let b = file(3, &from(-90.0, 5.0, 90.0), &from(-90.0, 5.0, 90.0), |v, _| 90.0 - v.abs());
        fs::write(dir.path().join("b.ies"), b).unwrap();
        let dark = file(1, &[0.0, 90.0], &[0.0], |_, _| 0.0);
        fs::write(dir.path().join("dark.ies"), dark).unwrap();
        let tilt = "TILT=INCLUDE 1 2 0 90 1 .5\n1 1 1 2 1 1 2 0 0 0 1 1 1\n0 180\n0\n10 10\n"
            .replace("INCLUDE ", "INCLUDE\n");
        fs::write(dir.path().join("tilt.ies"), tilt).unwrap();
        fs::write(dir.path().join("s.toml"), format!("[[mesh]]\nfile = \"a.obj\"\n{lights}"))
            .unwrap();
        Self(dir)
    }
    fn scene(&self) -> Scene {
        load(&self.0.path().join("s.toml"), &LoadOptions::default())
            .unwrap_or_else(|e| panic!("{e}"))
    }
    fn error(&self) -> String {
        let error =
            load(&self.0.path().join("s.toml"), &LoadOptions::default()).expect_err("must fail");
        assert_eq!(error.exit_code(), 4);
        error.to_string()
    }
}

fn lumens(light: &LightRecord) -> f64 {
    let [r, g, b] = light.flux_w.map(f64::from);
    179.0 * (0.2126 * r + 0.7152 * g + 0.0722 * b)
}

fn near(a: [f32; 3], b: [f32; 3]) -> bool {
    (Vec3::from(a) - Vec3::from(b)).length() < 1e-6
}

#[test]
fn spot_lights_of_a_scene_file() {
    let files = Files::new(
        "[[light]]\nkind = \"spot\"\nposition = [1, 1, 3]\ncandela = 179\ninner = 20\nouter = 60\n\
         [[light]]\nkind = \"spot\"\nposition = [1, 1, 3]\nlumens = 400\naxis = [3, 0, 0]\n\
         [[light]]\nkind = \"spot\"\nposition = [1, 1, 3]\nwatts = [1, 2, 3]\ntarget = [1, 4, 3]\nouter = 180\n",
    );
    let lights = files.scene().lights().unwrap();
    let r = &lights.records;
    assert!(r.iter().all(|r| r.kind == LIGHT_SPOT && r.profile == enf_layout::NONE));
    let cos = |d: f64| d.to_radians().cos();
    let sr = 2.0 * PI * (1.0 - cos(20.0) + (cos(20.0) - 0.5) / 3.0);
    assert!((f64::from(r[0].flux_w[1]) / sr - 1.0).abs() < 1e-6, "{:?}", r[0].flux_w);
    assert_eq!((r[0].axis, r[0].cone), ([0., 0., -1.], [cos(20.0) as f32, cos(60.0) as f32]));
    assert!((lumens(&r[1]) - 400.0).abs() < 1e-3);
    assert_eq!((r[1].axis, r[1].cone), ([1., 0., 0.], [1.0, cos(45.0) as f32]));
    assert_eq!((r[2].axis, r[2].flux_w, r[2].cone[1]), ([0., 1., 0.], [1., 2., 3.], -1.0));
}

#[test]
fn luminaires_of_a_scene_file() {
    let files = Files::new(
        "[[light]]\nname = \"down\"\nkind = \"ies\"\nfile = \"lamps/a.ies\"\nposition = [1, 1, 3]\n\
         [[light]]\nkind = \"ies\"\nfile = \"lamps/../lamps/a.ies\"\nposition = [1, 2, 3]\nturn = 90\nlumens = 500\n\
         color = [1, 0.5, 0.25]\n\
         [[light]]\nkind = \"ies\"\nfile = \"lamps/a.ies\"\nposition = [2, 1, 3]\nscale = 0.5\naim = [1, 0, 0]\n\
         [[light]]\nkind = \"ies\"\nfile = \"b.ies\"\nposition = [2, 1, 3]\ntarget = [2, 1, 4]\nwatts = 3\n\
         [[light]]\nkind = \"ies\"\nfile = \"tilt.ies\"\nposition = [2, 1, 3]\ndirection = [0, 1, -1]\n",
    );
    let scene = files.scene();
    let lights = scene.lights().unwrap();
    let r = &lights.records;
    assert!(r.iter().all(|r| r.kind == LIGHT_PROFILE));
    let ids: Vec<u32> = r.iter().map(|r| r.profile).collect();
    assert_eq!(ids, [0, 0, 0, 1, 2]);
    assert_eq!(lights.profiles.names, ["a.ies", "b.ies", "tilt.ies"]);
    assert_eq!(scene.inputs.len(), 5, "each file once: {:?}", scene.inputs);
    for record in &lights.profiles.records {
        Profile::new(record, &lights.profiles.values).unwrap().check().unwrap();
    }
    let own = f64::from(lights.profiles.records[0].lumens);
    assert!((lumens(&r[0]) / own - 1.0).abs() < 1e-6);
    assert!((lumens(&r[1]) - 500.0).abs() < 1e-3 && r[1].flux_w[0] == 4.0 * r[1].flux_w[2]);
    assert!((lumens(&r[2]) / own - 0.5).abs() < 1e-6);
    assert!((lumens(&r[3]) - 3.0 * 179.0).abs() < 1e-3);
    // Tilted by 45 degrees: a factor of 0.75.
    assert!((lumens(&r[4]) / (40.0 * PI) - 0.75).abs() < 1e-6);
    // A quarter of the tolerance ahead, so that nobody shines from within a ceiling.
    assert_eq!(r[0].position, [1., 1., 3. - 0.25 * scene.delta]);
    assert_eq!(r[2].position, [2. + 0.25 * scene.delta, 1., 3.]);
    // Down with C0 along x; turned, along y; tilted towards x, C0 goes up.
    assert!(near(r[0].axis, [0., 0., -1.]) && near(r[0].tangent, [1., 0., 0.]));
    assert!(near(r[1].axis, [0., 0., -1.]) && near(r[1].tangent, [0., 1., 0.]));
    assert!(near(r[2].axis, [1., 0., 0.]) && near(r[2].tangent, [0., 0., 1.]), "{:?}", r[2]);
    // Type A upside down: its axis is what was up.
    assert!(near(r[3].axis, [0., 0., -1.]) && near(r[3].tangent, [1., 0., 0.]), "{:?}", r[3]);
}

#[test]
fn what_a_light_may_not_say() {
    for (table, words) in [
        ("kind = \"spot\"", &["\"lumens\", \"candela\" or \"watts\""][..]),
        ("kind = \"spot\"\ncandela = 1\nouter = 0", &["\"outer\" is 0"]),
        ("kind = \"spot\"\ncandela = 1\nouter = 200", &["\"outer\" is 200"]),
        ("kind = \"spot\"\ncandela = 1\ninner = 50", &["\"inner\" is 50", "which is 45"]),
        (
            "kind = \"point\"\ncandela = 1\ninner = 50",
            &["\"inner\" is for lights of kind \"spot\""],
        ),
        ("kind = \"spot\"\ncandela = 1\nfile = \"a\"", &["\"file\" is for lights of kind \"ies\""]),
        (
            "kind = \"spot\"\ncandela = 1\naxis = [0, 0, 1]\ntarget = [0, 0, 0]",
            &["\"direction\" and \"target\""],
        ),
        ("kind = \"spot\"\ncandela = 1\ntarget = [1, 1, 1]", &["target is where it is"]),
        ("kind = \"spot\"\ncandela = 1\naxis = [0, 0, 0]", &["no length"]),
        ("kind = \"ies\"", &["no \"file\"", "s.toml:3"]),
        ("kind = \"ies\"\nfile = \"none.ies\"", &["none.ies", "cannot be read"]),
        ("kind = \"ies\"\nfile = \"dark.ies\"", &["dark.ies", "0 lm", "multiplier"]),
        ("kind = \"ies\"\nfile = \"b.ies\"\ncandela = 5", &["\"candela\"", "\"scale\""]),
        ("kind = \"ies\"\nfile = \"b.ies\"\nlumens = 5\nscale = 2", &["only one of"]),
        ("kind = \"ies\"\nfile = \"b.ies\"\nscale = -2", &["out of range"]),
        ("kind = \"ies\"\nfile = \"a.obj\"", &["a.obj: has no line TILT="]),
        ("kind = \"ies\"\nfile = \"b.ies\"\nturn = nan", &["\"turn\" is NaN"]),
        ("kind = \"spott\"\ncandela = 1", &["s.toml:4", "unknown variant"]),
    ] {
        let said = Files::new(&format!("[[light]]\n{table}\nposition = [1, 1, 1]\n")).error();
        assert!(words.iter().all(|w| said.contains(w)), "{said}\n{table}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// No file makes the reader panic, and what it accepts can be stored.
    #[test]
    fn damaged_files_are_refused_or_sound(
        at in 0usize..400, with in "[ -~\n]{0,6}", cut in 0usize..400, kind in 1u32..4,
    ) {
        let (v, h) = if kind == 1 {
            (every(30.0, 180.0), every(45.0, 180.0))
        } else {
            (from(-90.0, 30.0, 90.0), from(-90.0, 45.0, 90.0))
        };
        let mut text = file(kind, &v, &h, |v, h| 100.0 + v + h).into_bytes();
        let at = at.min(text.len());
        text.splice(at..(at + with.len()).min(text.len()), with.bytes());
        if cut % 4 == 0 {
            text.truncate(cut);
        }
        if let Ok(lamp) = parse(Path::new("x.ies"), &text) {
            let mut values = Vec::new();
            if let Some(record) = lamp.samples().store(&mut values) {
                let profile = Profile::new(&record, &values).unwrap();
                profile.check().unwrap();
                prop_assert!((profile.bands.last(), record.peak.is_finite()) == (Some(&1.0), true));
            }
        }
    }
}
