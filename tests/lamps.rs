//! Spot lights and luminaires, through the real binaries: their photons and their shadow rays against the
//! intensity that they are said to have; and photons shared by power.
//!
//! Seeds are fixed. Numbers of photons are compared to five standard deviations, some 400 of them in all, so that
//! other random numbers would fail a test with a probability below 1e-3.

mod common;

use std::f64::consts::PI;
use std::path::{Path, PathBuf};

use common::{Model, bin, digest, fails, json, number, ok, photons, traced, watts};
use enf_layout::photon::PHOTON_DIRECT;
use serde_json::Value;

const PHOTONS: f64 = 400_000.0;
const FLOOR: f64 = 0.5;

/// A room of 8 x 8 x 3 m whose floor reflects half and whose walls are black, one light, and a view from the ceiling.
fn room(dir: &Path, light: &str) -> PathBuf {
    let mut model = Model::default();
    model.object("walls");
    model.material("black");
    model.cuboid([-4.0, -4.0, 0.0], [4.0, 4.0, 3.0], true);
    model.object("floor");
    model.material("floor");
    model.quad([[-4.0, -4.0, 0.001], [4.0, -4.0, 0.001], [4.0, 4.0, 0.001], [-4.0, 4.0, 0.001]]);
    model.write(
        &dir.join("room.obj"),
        &format!("newmtl black\nKd 0 0 0\nnewmtl floor\nKd {FLOOR} {FLOOR} {FLOOR}\n"),
    );
    let scene = dir.join("room.toml");
    let view = "[[view]]\nname = \"plan\"\neye = [0, 0, 2.9]\ntarget = [0, 0, 0]\nup = [0, 1, 0]\nfov = 90\n";
    std::fs::write(&scene, format!("[[mesh]]\nfile = \"room.obj\"\n{light}{view}")).unwrap();
    scene
}

/// Runs everything on a scene with one light.
fn run(scene: &Path, out: &Path) -> Value {
    ok(bin("enfilade").arg("run").arg(scene).arg("-o").arg(out).args([
        "--quiet",
        "--photons",
        "400k",
        "--view",
        "plan",
        "--indirect",
        "none",
        "--samples",
        "16",
        "--width",
        "48",
        "--height",
        "48",
    ]));
    json(&out.join("stats.json"))
}

/// Holds the floor's direct light, by photons and by shadow rays, against `lux`.
fn compare(name: &str, out: &Path, lumens: f64, lux: impl Fn(f64, f64) -> f64) {
    // Photons in cells of 0.8 m, against E by the midpoint rule.
    let all = photons(&out.join("room.enf"));
    let mut found = [[0.0; 10]; 10];
    for photon in all.iter().filter(|p| p.flags & PHOTON_DIRECT != 0) {
        let [x, y, z] = photon.position().map(f64::from);
        if (z - 0.001).abs() < 1e-4 {
            let cell = |v: f64| (((v + 4.0) / 0.8) as usize).min(9);
            found[cell(y)][cell(x)] += 179.0 * watts(photon);
        }
    }
    for (j, row) in found.iter().enumerate() {
        for (i, &found) in row.iter().enumerate() {
            const FINE: usize = 24;
            let at = |i: usize, k: usize| -4.0 + 0.8 * (i as f64 + (k as f64 + 0.5) / FINE as f64);
            let mut expected = 0.0;
            for k in 0..FINE * FINE {
                expected += lux(at(i, k % FINE), at(j, k / FINE)) * 0.64 / (FINE * FINE) as f64;
            }
            let count = PHOTONS * expected / lumens;
            // Edges of beams are coarse in the midpoint rule; flux is stored to a part in 256, without bias.
            let bound = (5.0 * count.sqrt() + 0.003 * count + 5.0) * lumens / PHOTONS;
            assert!(
                (found - expected).abs() < bound,
                "{name}: {found} lm in cell {i}, {j}, not {expected}, {count:.0} photons"
            );
        }
    }
    // Shadow rays: 90 degrees from 2.899 m see 2.899 m to each side.
    let picture = enf_image::read_exr(&out.join("plan.exr")).unwrap();
    let green = picture.channel("G").unwrap();
    assert_eq!(green.len(), 48 * 48);
    let most = (0..2304).map(|p| lux_of(p, &lux)).fold(0.0, f64::max);
    let (mut sum, mut expected_sum) = (0.0, 0.0);
    for (pixel, &radiance) in green.iter().enumerate() {
        let found = f64::from(radiance) * PI / FLOOR * 179.0;
        let expected = lux_of(pixel, &lux);
        sum += found;
        expected_sum += expected;
        assert!(
            (found - expected).abs() < 0.05 * most,
            "{name}: {found} lx in pixel {pixel} for {expected}"
        );
    }
    assert!((sum / expected_sum - 1.0).abs() < 2e-3, "{name}: {sum} for {expected_sum}");
}

/// Mean illuminance in a pixel.
fn lux_of(pixel: usize, lux: &impl Fn(f64, f64) -> f64) -> f64 {
    let place = |p: usize, k: usize| 2.899 * ((p as f64 + (k as f64 + 0.5) / 4.0) / 24.0 - 1.0);
    (0..16).map(|k| lux(place(pixel % 48, k % 4), -place(pixel / 48, k / 4))).sum::<f64>() / 16.0
}

/// `I cos / d^2` on the floor below a lamp.
fn floor(lamp: [f64; 3], candela: impl Fn([f64; 3]) -> f64) -> impl Fn(f64, f64) -> f64 {
    move |x, y| {
        let to = [x - lamp[0], y - lamp[1], 0.001 - lamp[2]];
        let d = to.iter().map(|v| v * v).sum::<f64>().sqrt();
        candela(to.map(|v| v / d)) * -to[2] / (d * d * d)
    }
}

/// A file of photometric type C.
fn ies(path: &Path, v: &[f64], h: &[f64], candela: impl Fn(f64, f64) -> f64) {
    let list =
        |values: &mut dyn Iterator<Item = f64>| values.map(|v| format!("{v} ")).collect::<String>();
    let mut text = format!(
        "IESNA:LM-63-2002\r\nTILT=NONE\r\n1 -1 1 {} {} 1 2 0 0 0\r\n1 1 50\r\n",
        v.len(),
        h.len()
    );
    text += &list(&mut v.iter().copied());
    text += "\r\n";
    text += &list(&mut h.iter().copied());
    for &h in h {
        text += "\r\n";
        text += &list(&mut v.iter().map(|&v| candela(v, h)));
    }
    std::fs::write(path, text).unwrap();
}

fn every(step: f64, to: f64) -> Vec<f64> {
    (0..=(to / step).round() as usize).map(|i| i as f64 * step).collect()
}

/// glTF's KHR_lights_punctual: 1 within 20 degrees, the square of the cosine's way from there to 40.
#[test]
fn a_spot_light() {
    let dir = tempfile::tempdir().unwrap();
    let scene = room(
        dir.path(),
        "[[light]]\nkind = \"spot\"\nposition = [0.5, -0.5, 2.5]\ndirection = [-0.3, 0.4, -1]\n\
         candela = 2000\ninner = 20\nouter = 40\n",
    );
    let out = dir.path().join("out");
    let stats = run(&scene, &out);
    let (ci, co) = (20f64.to_radians().cos(), 40f64.to_radians().cos());
    let lumens = 2000.0 * 2.0 * PI * (1.0 - ci + (ci - co) / 3.0);
    let trace = &stats["stages"][2];
    assert_eq!(trace["stage"], "trace");
    assert!((number(trace, "flux_emitted_w") * 179.0 / lumens - 1.0).abs() < 1e-5);
    assert_eq!(number(trace, "photons_emitted"), PHOTONS);
    let length = (0.09f64 + 0.16 + 1.0).sqrt();
    let lux = floor([0.5, -0.5, 2.5], |to| {
        let c = (-0.3 * to[0] + 0.4 * to[1] - to[2]) / length;
        let t = ((c - co) / (ci - co)).clamp(0.0, 1.0);
        2000.0 * t * t
    });
    compare("spot", &out, lumens, lux);
}

/// CIE 171:2006, 5.2: a file of a Lambertian source is the Lambertian point light. Both are mounted in the very plane of the
/// ceiling, and shine from below it.
#[test]
fn a_lambertian_luminaire() {
    let dir = tempfile::tempdir().unwrap();
    ies(&dir.path().join("lambert.ies"), &every(1.0, 90.0), &[0.0], |v, _| {
        1000.0 * v.to_radians().cos()
    });
    let place = "position = [0, 0, 3]\n";
    let scene =
        room(dir.path(), &format!("[[light]]\nkind = \"ies\"\nfile = \"lambert.ies\"\n{place}"));
    let out = dir.path().join("out");
    run(&scene, &out);
    compare("lambert", &out, 1000.0 * PI, floor([0.0, 0.0, 3.0], |to| -1000.0 * to[2]));
    // The same with a point light that is Lambertian by formula: the same pixels, to what chords of the cosine differ.
    std::fs::create_dir(dir.path().join("b")).unwrap();
    let scene = room(
        &dir.path().join("b"),
        &format!("[[light]]\nkind = \"lambert-point\"\ncandela = 1000\n{place}"),
    );
    let other = dir.path().join("other");
    run(&scene, &other);
    let [a, b] = [&out, &other].map(|o| enf_image::read_exr(&o.join("plan.exr")).unwrap());
    for (a, b) in a.channel("G").unwrap().iter().zip(b.channel("G").unwrap()) {
        assert!((a / b - 1.0).abs() < 1e-4, "{a} for {b}");
    }
}

/// A luminaire that is different on every side, bilinear in its angles by itself: turned, and tilted upwards.
#[test]
fn a_luminaire_with_planes() {
    let dir = tempfile::tempdir().unwrap();
    let candela = |v: f64, h: f64| {
        let side = (h % 360.0 - 180.0).abs() / 180.0;
        (120.0 - v).max(0.0) * (0.4 + side) * 10.0
    };
    ies(&dir.path().join("a.ies"), &[0.0, 20.0, 75.0, 120.0, 180.0], &every(45.0, 360.0), candela);
    // The flux in closed form: 0.9 on average about the axis, 10 (120 - v) sin v from 0 to 120 degrees.
    let w = 120f64.to_radians();
    let lumens = 2.0 * PI * 0.9 * 10.0 * 180.0 / PI * (w - w.sin());
    for (name, aim, down, turn) in [
        ("turned", "", [0.0, 0.0, -1.0], 30.0f64),
        ("tilted", "direction = [0, 0.6, -0.8]\n", [0.0, 0.6, -0.8], 0.0),
    ] {
        let folder = dir.path().join(name);
        std::fs::create_dir(&folder).unwrap();
        let scene = room(
            &folder,
            &format!(
                "[[light]]\nkind = \"ies\"\nfile = \"../a.ies\"\nposition = [0.4, 0.2, 2.6]\n{aim}turn = {turn}\n"
            ),
        );
        let out = folder.join("out");
        let stats = run(&scene, &out);
        let emitted = number(&stats["stages"][2], "flux_emitted_w") * 179.0;
        assert!((emitted / lumens - 1.0).abs() < 1e-5, "{emitted} lm for {lumens}");
        // C0 is x, turned from above counter-clockwise; tilted about x it stays there, and C90 goes up.
        let (s, c) = turn.to_radians().sin_cos();
        let zero = [c, s, 0.0];
        let ninety = [-s * -down[2], c * -down[2], down[1]];
        let lux = floor([0.4, 0.2, 2.6], |to| {
            let dot = |a: [f64; 3]| a.iter().zip(to).map(|(a, b)| a * b).sum::<f64>();
            let v = dot(down).clamp(-1.0, 1.0).acos().to_degrees();
            let h = dot(ninety).atan2(dot(zero)).to_degrees();
            candela(v, h.rem_euclid(360.0))
        });
        compare(name, &out, lumens, lux);
    }
    // What the store says about it.
    let store = dir.path().join("tilted/out/room.enf");
    let text = common::stdout(&ok(bin("enfilade")
        .arg("inspect")
        .arg(&store)
        .args(["--lights", "--json"])));
    let said: Value = serde_json::from_str(&text).unwrap();
    let light = &said["lights"][0];
    assert_eq!((&light["kind"], &light["profile"]), (&"ies".into(), &"a.ies".into()));
    assert!((number(light, "lumens") / lumens - 1.0).abs() < 1e-5);
}

/// Photons shared by power, more of them than one visit traces: the sum is exact, each carries the same flux, and nothing depends on rooms or threads.
#[test]
fn photons_by_power() {
    let dir = tempfile::tempdir().unwrap();
    let light = |name: &str, x: f64, lumens: f64| {
        format!(
            "[[light]]\nname = \"{name}\"\nkind = \"point\"\nposition = [{x}, 0.5, 2.0]\nlumens = {lumens}\n"
        )
    };
    let lights =
        light("weak", -3.0, 10.0) + &light("middle", 0.3, 300.0) + &light("strong", 3.0, 690.0);
    let scene = room(dir.path(), &lights);
    let store = dir.path().join("a.enf");
    let stats = traced(&scene, &store, &[], &["--photons", "1200k"]);
    assert_eq!(number(&stats, "photons_emitted"), 1_200_000.0);
    assert_eq!(number(&stats, "photons_absorbed") + number(&stats, "photons_escaped"), 1_200_000.0);
    assert!((number(&stats, "flux_emitted_w") * 179.0 - 1000.0).abs() < 0.01);
    let each = 1000.0 / 1_200_000.0;
    let all = photons(&store);
    let direct: Vec<_> = all.iter().filter(|p| p.flags & PHOTON_DIRECT != 0).collect();
    assert_eq!(direct.len(), 1_200_000);
    for photon in direct {
        let lumens = 179.0 * watts(photon);
        assert!((lumens / each - 1.0).abs() < 0.01, "{lumens} lm for {each}");
    }
    let expected = digest(&store, "photons");
    let cut: &[&[&str]] = &[&["--rooms", "4"], &["--tile-triangles", "4"]];
    for (i, partition) in cut.iter().enumerate() {
        let other = dir.path().join(format!("{i}.enf"));
        let more =
            ["--photons", "1200000", "--threads", "1", "--queue-rows", "2", "--queue-block", "100"];
        traced(&scene, &other, partition, &more);
        assert_eq!(digest(&other, "photons"), expected, "{partition:?}");
    }
    // The same again is done; other numbers are another run.
    ok(bin("enf-trace").arg(&store).args(["--quiet", "--photons", "1200k"]));
    let said = fails(bin("enf-trace").arg(&store).args(["--photons", "40k"]), 2);
    assert!(
        said.contains("photons: 1200000 there, 40000 here") && said.contains("--force"),
        "{said}"
    );
    let said = fails(bin("enf-trace").arg(&store).args(["--photons-per-light", "50k"]), 2);
    assert!(said.contains("photons-per-light"), "{said}");
    let said =
        fails(bin("enf-trace").arg(&store).args(["--photons-per-light", "5", "--photons", "5"]), 2);
    assert!(said.contains("cannot be used with"), "{said}");
    let said = fails(bin("enf-trace").arg(&store).args(["--force", "--photons", "2"]), 2);
    assert!(said.contains("3 lights"), "{said}");
}
