//! Our OBJ reader against `tobj`, and against models whose counts are known.

use enf_scene::{Doors, LoadOptions, Scene, Spool, load};
use proptest::prelude::*;
use std::{
    collections::BTreeMap,
    fmt::Write,
    fs,
    path::{Path, PathBuf},
};

/// What `tobj` makes of an OBJ of triangles: corners and object names, without degenerate ones.
fn reference(path: &Path) -> Vec<([[f32; 3]; 3], String)> {
    let options = tobj::LoadOptions { triangulate: true, ..Default::default() };
    let (models, _) = tobj::load_obj(path, &options).unwrap();
    let mut out = Vec::new();
    for m in models {
        for t in m.mesh.indices.chunks_exact(3) {
            let corner = |i: u32| -> [f32; 3] {
                std::array::from_fn(|c| m.mesh.positions[3 * i as usize + c] as f32)
            };
            let corners = [corner(t[0]), corner(t[1]), corner(t[2])];
            let [a, b, c] = corners.map(|p| glam::Vec3::from_array(p).as_dvec3());
            if (b - a).cross(c - a) != glam::DVec3::ZERO {
                out.push((corners, m.name.clone()));
            }
        }
    }
    out
}

fn ours(scene: &Scene) -> Vec<([[f32; 3]; 3], String)> {
    let mut out = Vec::new();
    scene.for_each_triangle(|t| out.push((t.corners, scene.object_name(t.object)))).unwrap();
    out
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..Default::default() })]
    #[test]
    fn agrees_with_tobj(
        steps in proptest::collection::vec(
            (0..6u8, proptest::array::uniform3(-100.0..100.0f64), any::<[u16; 4]>()), 1..200),
    ) {
        let mut text = String::from("v 0 0 0\nv 1 0 0\nv 0 1 0\no start\n");
        let mut n = 3u32;
        for (i, (kind, p, r)) in steps.into_iter().enumerate() {
            let r = r.map(u32::from);
            let index = |k: usize, relative: bool| {
                let v = r[k] % n;
                if relative { (i64::from(v) - i64::from(n)).to_string() } else { (v + 1).to_string() }
            };
            match kind {
                0..=2 => {
                    writeln!(text, "v  {} {:.4} {:e}\t", p[0], p[1], p[2]).unwrap();
                    n += 1;
                }
                3 => writeln!(text, "f {} {}/ {}//", index(0, false), index(1, true), index(2, false))
                    .unwrap(),
                4 => writeln!(text, "o object {i}").unwrap(),
                _ => writeln!(text, "usemtl m{}\nf {} {} {}", r[3] % 3, index(0, true), index(1, true), index(2, true))
                    .unwrap(),
            }
        }
        text += "f 1 2 3\n";
        // tobj does not know "v/" and "v//" without numbers: plain there.
        let dir = tempfile::tempdir().unwrap();
        let (a, b) = (dir.path().join("a.obj"), dir.path().join("b.obj"));
        fs::write(&a, &text).unwrap();
        fs::write(&b, text.replace("// ", " ").replace("/ ", " ").replace("//\n", "\n")).unwrap();
        let scene = load(&a, &LoadOptions::default()).unwrap();
        prop_assert_eq!(ours(&scene), reference(&b));
    }

    #[test]
    fn no_bytes_make_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300), kind in 0..4usize) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(["a.obj", "a.obj.zst", "a.toml", "a.mtl"][kind]);
        fs::write(&path, &bytes).unwrap();
        if kind == 3 {
            let obj = dir.path().join("a.obj");
            fs::write(&obj, "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl x\nf 1 2 3\n").unwrap();
            let _ = load(&obj, &LoadOptions::default());
        } else {
            let _ = load(&path, &LoadOptions::default());
        }
    }

    #[test]
    fn no_text_of_the_right_words_makes_it_panic(
        words in proptest::collection::vec(
            proptest::sample::select(vec![
                "v", "f", "o", "g", "usemtl", "mtllib", "\n", "\n", "\n", "1", "2", "3", "-1", "0",
                "1e308", "-1e308", "nan", "1/2/3", "a.mtl", "\\\n", "newmtl", "Kd", "d", "illum",
                "4", "Ke", "Tf", "99999999999", "v 1 2 3\n", "v 0 0 1\n", "v 3 0 1\n", "f 1 2 3 1 2\n",
            ]), 0..200),
    ) {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("a.obj"), words.join(" ")).unwrap();
        fs::write(dir.path().join("a.mtl"), words.join(" ")).unwrap();
        if let Ok(scene) = load(&dir.path().join("a.obj"), &LoadOptions::default()) {
            let lights = scene.lights().unwrap();
            prop_assert!(lights.records.iter().all(|l| l.flux_w.iter().all(|w| w.is_finite())));
            prop_assert!(scene.delta.is_finite() && scene.delta > 0.0);
        }
    }
}

/// The bits of a whole scene, in order.
fn bits(scene: &Scene) -> (u64, u128) {
    let mut hash = xxhash_rust::xxh3::Xxh3::new();
    let mut n = 0;
    scene
        .for_each_triangle(|t| {
            n += 1;
            for v in t.corners.as_flattened() {
                hash.update(&v.to_bits().to_le_bytes());
            }
            for v in [t.index, t.material, t.object] {
                hash.update(&v.to_le_bytes());
            }
        })
        .unwrap();
    (n, hash.digest128())
}

#[test]
fn fixtures_and_real_models_are_the_same_spooled() {
    let mut all: Vec<PathBuf> = Vec::new();
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes");
    for name in [
        "box.toml",
        "hall.toml",
        "gallery.toml",
        "washers.toml",
        "two-rooms.toml",
        "box.obj",
        "hall.obj",
        "stool.obj",
    ] {
        all.push(fixtures.join(name));
    }
    match std::env::var_os("ENFILADE_DATA") {
        Some(data) => {
            for model in [
                "bim/duplex",
                "bim/whale_large",
                "bim/clinic",
                "gi/cornell_box",
                "gi/pandora",
                "gi/kitchen",
                "city/delft",
            ] {
                let name = model.split('/').nth(1).unwrap();
                all.push(Path::new(&data).join(model).join(format!("{name}.obj.zst")));
            }
        }
        None => eprintln!("SKIPPED: set ENFILADE_DATA to the folder of test models for those"),
    }
    let both = [Doors::AsModelled, Doors::Open];
    for (path, doors) in all.iter().flat_map(|p| both.map(|d| (p, d))) {
        let plain = load(path, &LoadOptions { doors, ..LoadOptions::default() }).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let spool = Some(Spool { folder: folder.path().into(), above: 0 });
        let options = LoadOptions { spool, doors, ..LoadOptions::default() };
        let spooled = load(path, &options).unwrap();
        assert_eq!(bits(&plain), bits(&spooled), "{}", path.display());
        assert_eq!(plain.lights().unwrap(), spooled.lights().unwrap());
        assert_eq!(plain.warnings, spooled.warnings);
        assert_eq!(plain.materials, spooled.materials);
        assert_eq!(plain.door_objects(), spooled.door_objects());
        // Any range, whatever was noted on the way.
        let n = plain.triangle_count() as u32;
        for range in [0..1, n / 3..n / 3 + 1000, n / 2..n / 2 + 70_000, n - 1..n, n..n + 1] {
            let list = |s: &Scene| {
                let mut out = Vec::new();
                s.for_each_triangle_in(range.clone(), |t| out.push(t)).unwrap();
                out
            };
            let (a, b) = (list(&plain), list(&spooled));
            assert_eq!(a.len(), range.end.min(n).saturating_sub(range.start.min(n)) as usize);
            assert_eq!(a.first().map(|t| t.index), (range.start < n).then_some(range.start));
            assert_eq!(a, b);
        }
        eprintln!(
            "{}: {} bytes in memory, {} spooled",
            path.display(),
            plain.resident_bytes(),
            spooled.resident_bytes()
        );
    }
}

/// Real models: `ENFILADE_DATA` is a folder with `*/*/NAME.obj.zst` and `NAME.truth.json`.
#[test]
fn real_models_have_the_triangles_that_they_should() {
    let Some(data) = std::env::var_os("ENFILADE_DATA") else {
        eprintln!("SKIPPED: set ENFILADE_DATA to the folder of test models to read them");
        return;
    };
    for model in ["bim/duplex", "bim/whale_large", "gi/cornell_box", "gi/pandora", "city/delft"] {
        let folder = Path::new(&data).join(model);
        let name = folder.file_name().unwrap().to_str().unwrap().to_string();
        let truth = fs::read(folder.join(format!("{name}.truth.json"))).unwrap();
        let truth: serde_json::Value = serde_json::from_slice(&truth).unwrap();
        let stats = &truth["stats"];
        let scene = load(&folder.join(format!("{name}.obj.zst")), &LoadOptions::default()).unwrap();
        let all = scene.triangle_count() + scene.skipped_triangles();
        assert_eq!(Some(all), stats["triangles"].as_u64(), "{model}");
        assert_eq!(Some(scene.materials.len() as u64), stats["materials_used"].as_u64(), "{model}");
        assert_eq!(Some(u64::from(scene.object_count())), stats["objects"].as_u64(), "{model}");
        assert_eq!(scene.name, name);
        let mut area = 0.0;
        scene
            .for_each_triangle(|t| {
                let [a, b, c] = t.corners.map(|p| glam::Vec3::from_array(p).as_dvec3());
                area += 0.5 * (b - a).cross(c - a).length();
            })
            .unwrap();
        let expected = stats["surface_area_m2"].as_f64().unwrap();
        assert!((area / expected - 1.0).abs() < 1e-4, "{model}: {area} m2, not {expected}");
        for c in 0..3 {
            let lo = stats["bbox_min"][c].as_f64().unwrap();
            let hi = stats["bbox_max"][c].as_f64().unwrap();
            assert!((f64::from(scene.bounds.0[c]) - lo).abs() < 2e-3, "{model}");
            assert!((f64::from(scene.bounds.1[c]) - hi).abs() < 2e-3, "{model}");
        }
        let mut types: BTreeMap<String, u64> = BTreeMap::new();
        for door in scene.door_objects() {
            let kind = scene.object_name(door).split('/').next().unwrap().to_string();
            *types.entry(kind).or_default() += 1;
        }
        if let Some(by_type) = truth.get("elements_by_type") {
            let doors = by_type["IfcDoor"]["count"].as_u64();
            assert_eq!(types.get("IfcDoor").copied(), doors, "{model}: {types:?}");
        }
        eprintln!(
            "{model}: {} triangles, {} lights, {} bytes, {:?}",
            scene.triangle_count(),
            scene.lights().unwrap().records.len(),
            scene.resident_bytes(),
            scene.warnings
        );
    }
}

/// The rooms' solids of real buildings, as their truth files measure them.
#[test]
fn solids_of_rooms_are_hints() {
    let Some(data) = std::env::var_os("ENFILADE_DATA").map(PathBuf::from) else {
        eprintln!("SKIPPED: set ENFILADE_DATA to the folder of test models to read their rooms");
        return;
    };
    for name in ["duplex", "whale_large"] {
        let folder = data.join("bim").join(name);
        let dir = tempfile::tempdir().unwrap();
        let toml = format!(
            "[[mesh]]\nfile = {:?}\n[[room]]\nfile = {:?}\n",
            folder.join(format!("{name}.obj.zst")),
            folder.join(format!("{name}.spaces.obj.zst"))
        );
        fs::write(dir.path().join("s.toml"), toml).unwrap();
        let scene = load(&dir.path().join("s.toml"), &LoadOptions::default()).unwrap();
        let truth = fs::read(folder.join(format!("{name}.truth.json"))).unwrap();
        let truth: serde_json::Value = serde_json::from_slice(&truth).unwrap();
        let spaces = truth["spaces"].as_array().unwrap();
        let mut matched = 0;
        for hint in &scene.hints {
            let name = hint.name.split('/').nth(2).unwrap();
            let mut named = spaces.iter().filter(|s| s["name"].as_str() == Some(name));
            // One of the file has two solids and is one space.
            let (Some(space), None) = (named.next(), named.next()) else { continue };
            if scene.hints.iter().filter(|h| h.name.ends_with(&format!("/{name}"))).count() > 1 {
                continue;
            }
            matched += 1;
            let side = |c: usize| f64::from(hint.max[c]) - f64::from(hint.min[c]);
            let p = &hint.polygon;
            let area = if p.is_empty() {
                side(0) * side(1)
            } else {
                (0..p.len())
                    .map(|i| {
                        let ([a, b], [c, d]) = (p[i], p[(i + 1) % p.len()]);
                        0.5 * (f64::from(a) * f64::from(d) - f64::from(c) * f64::from(b))
                    })
                    .sum()
            };
            let expected = space["floor_area_mesh_m2"].as_f64().unwrap();
            assert!((area / expected - 1.0).abs() < 2e-3, "{}: {area} {expected}", hint.name);
        }
        assert!(matched + 1 >= spaces.len(), "{matched} of {}", spaces.len());
        let shaped = scene.hints.iter().filter(|h| !h.polygon.is_empty()).count();
        eprintln!("{name}: {} rooms, {shaped} of them no boxes", scene.hints.len());
    }
}
