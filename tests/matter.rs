//! Gloss, glass and textures through the real binaries.

mod common;

use common::{Model, bin, digest, json, number, ok};
use std::path::{Path, PathBuf};

/// A furnace: walls of radiance 2 and reflectance 0.4, with things in it that lose nothing. Light is the same everywhere,
/// so the picture shows 2 / 0.6 on whatever it shows: emission, direct light on gloss by shadow rays and by the rays that
/// go on, indirect light, and what glass passes on add up once.
///
/// Some 6,000 photons make the indirect 40 % of what a white thing reflects, and 25,000 shadow rays the rest: a deviation
/// of 0.6 %, of which the bound is 4.
#[test]
fn lossless_things_vanish_in_a_furnace() {
    let dir = tempfile::tempdir().unwrap();
    for (name, table) in [
        ("rough", "kd = 1\nks = 0.5\nroughness = 0.5"),
        ("shiny", "kd = 1\nks = 0.3\nroughness = 0.15"),
        ("varnish", "kd = 1\nks = 0.04\nroughness = 0"),
        ("glass", "solid = true\nindex = 1.5"),
    ] {
        let scene = dir.path().join(format!("{name}.toml"));
        let mut model = Model::default();
        model.object("box");
        model.material("glow");
        model.cuboid([0.0; 3], [4.0, 4.0, 4.0], true);
        model.object("thing");
        model.material("thing");
        model.turned([2.9, 2.0, 2.0], [0.6, 0.6, 0.6], 4.0);
        let mtl = "newmtl glow\nKd 0.4 0.4 0.4\nKe 2 2 2\nnewmtl thing\n";
        model.write(&dir.path().join("box.obj"), mtl);
        std::fs::write(
            &scene,
            format!(
                "[[mesh]]\nfile = \"box.obj\"\n[[material]]\nname = \"thing\"\n{table}\n\
                 [[view]]\nname = \"in\"\neye = [1, 2.1, 2.1]\ntarget = [2.9, 2, 2]\nfov = 70\n"
            ),
        )
        .unwrap();
        let out = dir.path().join(name);
        ok(bin("enfilade").arg("run").arg(&scene).arg("-o").arg(&out).args([
            "--quiet",
            "--photons-per-light",
            "1000k",
            "--view",
            "in",
            "--samples",
            "64",
            "--width",
            "40",
            "--height",
            "40",
        ]));
        let picture = enf_image::read_exr(&out.join("in.exr")).unwrap();
        let green = picture.channel("G").unwrap();
        // The middle of the picture shows the thing only.
        let middle: Vec<f64> = (0..40 * 40)
            .filter(|i| (10..30).contains(&(i % 40)) && (10..30).contains(&(i / 40)))
            .map(|i| f64::from(green[i]))
            .collect();
        let mean = middle.iter().sum::<f64>() / middle.len() as f64;
        let expected = 2.0 / 0.6;
        assert!((mean / expected - 1.0).abs() < 0.025, "{name}: {mean} for {expected}");
    }
}

/// A room with a textured wall, a gloss, a slab of glass and a lamp.
fn painted(dir: &Path) -> PathBuf {
    let mut model = Model::default();
    model.object("box");
    model.material("white");
    model.cuboid([0.0; 3], [4.0, 3.0, 2.5], true);
    model.object("lamp");
    model.material("lamp");
    model.quad([[1.0, 1.0, 2.45], [1.0, 2.0, 2.45], [2.0, 2.0, 2.45], [2.0, 1.0, 2.45]]);
    model.object("slab");
    model.material("glass");
    model.turned([2.0, 0.7, 0.5], [0.4, 0.01, 0.4], 20.0);
    model.object("plinth");
    model.material("gloss");
    model.turned([3.0, 1.0, 0.3], [0.3, 0.3, 0.3], 10.0);
    let mtl = "newmtl white\nKd 0.7 0.7 0.7\nnewmtl lamp\nKd 0 0 0\nKe 9 9 9\nnewmtl glass\n\
               newmtl gloss\nKd 0.3 0.1 0.1\nKs 0.04 0.04 0.04\nNs 200\n";
    model.write(&dir.join("room.obj"), mtl);
    // Cut into 16 x 10 squares, so that tiles share it out.
    let mut wall = String::from("mtllib wall.mtl\no painting\nusemtl painting\n");
    for i in 0..=16 {
        for j in 0..=10 {
            let (u, v) = (f64::from(i) / 16.0, f64::from(j) / 10.0);
            wall += &format!("v {} 2.9 {}\nvt {} {v}\n", 0.4 + 3.2 * u, 0.3 + 2.0 * v, 2.0 * u);
        }
    }
    for i in 0..16 {
        for j in 0..10 {
            let at = |i: i32, j: i32| i * 11 + j + 1;
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            wall += &format!("f {a}/{a} {b}/{b} {c}/{c} {d}/{d}\n");
        }
    }
    std::fs::write(dir.join("wall.obj"), wall).unwrap();
    std::fs::write(dir.join("wall.mtl"), "newmtl painting\nKd 0.5 1 1\nmap_Kd p.png\n").unwrap();
    // Left half dark red, right half white, as sRGB codes; 32 x 32.
    let mut rgb = Vec::new();
    for i in 0..32 * 32 {
        rgb.extend(if i % 32 < 16 { [128u8, 0, 0] } else { [255; 3] });
    }
    let file = std::fs::File::create(dir.join("p.png")).unwrap();
    let mut encoder = png::Encoder::new(file, 32, 32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().unwrap().write_image_data(&rgb).unwrap();
    let scene = dir.join("room.toml");
    std::fs::write(
        &scene,
        "[[mesh]]\nfile = \"room.obj\"\n[[mesh]]\nfile = \"wall.obj\"\n\
         [[material]]\nname = \"glass\"\nsolid = true\nabsorption = 5\n\
         [[view]]\nname = \"in\"\neye = [2, 0.2, 1.3]\ntarget = [2, 3, 1.3]\nfov = 60\n\
         width = 60\nheight = 40\n",
    )
    .unwrap();
    scene
}

/// Photons and pictures are the same for any tiles, threads and budget, and a texture has its colours where they belong.
#[test]
fn the_same_bits_with_textures_gloss_and_glass() {
    let dir = tempfile::tempdir().unwrap();
    let scene = painted(dir.path());
    let mut made: Vec<(String, Vec<u8>)> = Vec::new();
    for (name, partition, later) in [
        ("one", vec![], vec!["--threads", "1"]),
        ("tiles", vec!["--random-tiles", "12"], vec!["--threads", "2", "--memory", "64M"]),
        ("small", vec!["--tile-triangles", "60", "--memory", "64M"], vec!["--resident-rooms", "1"]),
    ] {
        let store = dir.path().join(format!("{name}.enf"));
        ok(bin("enf-partition").arg(&scene).arg("-o").arg(&store).arg("--quiet").args(&partition));
        let grid = if name == "small" { vec![] } else { later.clone() };
        ok(bin("enf-grid").arg(&store).arg("--quiet").args(&grid));
        let stats = dir.path().join("trace.json");
        ok(bin("enf-trace")
            .arg(&store)
            .args(["--quiet", "--photons-per-light", "30k", "--stats"])
            .arg(&stats)
            .args(&later));
        let stats = json(&stats);
        assert_eq!(number(&stats, "photons_emitted"), number(&stats, "photons_absorbed"));
        let balance = number(&stats, "flux_emitted_w") - number(&stats, "flux_absorbed_w");
        assert!(balance.abs() < 1e-5 * number(&stats, "flux_emitted_w"));
        ok(bin("enf-kdtree").arg(&store).arg("--quiet"));
        let picture = dir.path().join(format!("{name}.exr"));
        ok(bin("enf-render")
            .arg(&store)
            .args(["--quiet", "--view", "in", "--samples", "8", "-o"])
            .arg(&picture)
            .args(&later));
        made.push((digest(&store, "photons"), std::fs::read(&picture).unwrap()));
    }
    assert!(made.iter().all(|m| m == &made[0]), "the same whatever the tiles");

    let picture = enf_image::read_exr(&dir.path().join("one.exr")).unwrap();
    let channel = |name: &str| picture.channel(name).unwrap_or_else(|| panic!("no {name}"));
    let albedo = ["albedo.R", "albedo.G"].map(channel);
    // Looking along +y, x runs to the right: on the wall from 0.4 to 3.6 the picture is there twice, dark red first.
    // In the row through the eye's height, at 2.7 m: a pixel is 2 x 2.7 tan 30 / 40 = 0.078 m.
    for (x, red, green) in
        [(0.8, 0.5 * 0.2159, 0.0), (1.6, 0.5, 1.0), (2.4, 0.5 * 0.2159, 0.0), (3.2, 0.5, 1.0)]
    {
        let column = (30.0f64 + (x - 2.0) / 0.07794) as usize;
        let at = 20 * 60 + column;
        let found = [albedo[0][at], albedo[1][at]];
        assert!(
            (found[0] - red as f32).abs() < 0.002 && (found[1] - green as f32).abs() < 0.002,
            "at x = {x}: {found:?} for {red}, {green}"
        );
    }
}
