//! What exporters do to models: duplicated and flat faces, wrong normals, vertices nobody uses, numbers
//! that are none. And what nobody does: damaged files of every kind.

use enf_scene::{LoadOptions, Scene, Spool, load};
use proptest::prelude::*;
use std::{f64::consts::PI, fs, path::Path};

fn scene(files: &[(&str, &str)]) -> Scene {
    let dir = tempfile::tempdir().unwrap();
    for (name, text) in files {
        fs::write(dir.path().join(name), text).unwrap();
    }
    load(&dir.path().join(files[0].0), &LoadOptions::default()).unwrap_or_else(|e| panic!("{e}"))
}

fn triangles(scene: &Scene) -> Vec<[[f32; 3]; 3]> {
    let mut out = Vec::new();
    scene.for_each_triangle(|t| out.push(t.corners)).unwrap();
    out
}

const LAMP: &str = "newmtl lamp\nKe 10 10 10\nnewmtl wall\nKd .5 .5 .5\n";

#[test]
fn a_face_that_is_there_twice_emits_once() {
    // The same triangle three times: as it was, from another corner, and by vertices of its own.
    let obj = "mtllib a.mtl\nv 0 0 3\nv 0 1 3\nv 1 0 3\nv 0 0 3\nv 0 1 3\nv 1 0 3\no lamp\n\
               usemtl lamp\nf 1 2 3\nf 2 3 1\nf 6 4 5\n";
    let lit = scene(&[("a.obj", obj), ("a.mtl", LAMP)]);
    // All stay in the stream: a ray takes the one with the lowest index.
    assert_eq!(triangles(&lit).len(), 3);
    let lights = lit.lights().unwrap();
    assert_eq!((lights.records.len(), lights.emitters.len()), (1, 1));
    assert_eq!(lights.emitters[0].triangle, 0);
    assert_eq!(lights.records[0].area_m2, 0.5);
    assert!((f64::from(lights.records[0].flux_w[0]) - PI * 0.5 * 10.0).abs() < 1e-5);
    assert!(lit.warnings.iter().any(|w| w.contains("2 emitting faces are there twice")));
    // Back to back they are a lamp with two sides.
    let lit = scene(&[("a.obj", &obj.replace("f 2 3 1\nf 6 4 5", "f 3 2 1")), ("a.mtl", LAMP)]);
    assert_eq!(lit.lights().unwrap().records[0].area_m2, 1.0);
    assert_eq!(lit.warnings, Vec::<String>::new());
    // A flux that is given is not divided by an area that is not there.
    let toml = "[[mesh]]\nfile = \"a.obj\"\n[[material]]\nname = \"lamp\"\nwatts = 7\n";
    let lit = scene(&[("a.toml", toml), ("a.obj", obj), ("a.mtl", LAMP)]);
    let emission = lit.materials[0].record.emission[0];
    assert!((f64::from(emission) - 7.0 / (PI * 0.5)).abs() < 1e-5, "{emission}");
}

#[test]
fn normals_of_the_file_mean_nothing() {
    let plain = "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n";
    let flipped =
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nvn 0 0 -1\nvn nan nan nan\nvn bad\nf 1//1 2//2 3//3\n";
    assert_eq!(triangles(&scene(&[("a.obj", plain)])), triangles(&scene(&[("a.obj", flipped)])));
}

#[test]
fn vertices_that_no_face_uses_are_nowhere() {
    let used = "v 0 0 0\nv 1 0 0\nv 1 1 0\n";
    for unused in ["v 1e7 -1e7 3\n", "v 1e30 0 0\n", "v nan inf -inf\n", "v 1e300 0 0\n"] {
        let s = scene(&[("a.obj", &format!("{used}{unused}f 1 2 3\n"))]);
        assert_eq!(s.bounds, ([0.0; 3], [1.0, 1.0, 0.0]), "{unused}");
        assert_eq!(s.origin, [0.0; 3], "{unused}");
    }
}

#[test]
fn strict_refuses_what_is_left_out_otherwise() {
    let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
    let good = format!("mtllib a.mtl\n{square}vn 0 0 1\nusemtl wall\nf 1 2 3\n");
    for (extra, place, word) in [
        ("", "", ""),
        // Nobody uses it: no harm.
        ("v nan 0 0\n", "", ""),
        ("v nan 0 0\nf 1 2 5\n", "a.obj:9: ", "uses vertex 5, which is not finite"),
        ("v 0 0 0\nv 0 1.#INF 0\nf 1 5 6\n", "a.obj:10: ", "vertex 6"),
        ("f 1 2\n", "a.obj:9: ", "fewer than three corners"),
        ("curv 0 1 2\n", "a.obj:9: ", "free-form"),
        ("vertex 0 1 2\n", "a.obj:9: ", "\"vertex\" is no statement"),
        ("usemtl nothing\nf 1 2 3\n", "a.obj: ", "no definition of material \"nothing\""),
        ("usemtl\nf 1 2 3\n", "a.obj: ", "faces have no material"),
        ("mtllib b.mtl\n", "a.obj:9: ", "\"b.mtl\" is missing"),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.obj");
        fs::write(&path, format!("{good}{extra}")).unwrap();
        fs::write(dir.path().join("a.mtl"), LAMP).unwrap();
        let lenient = load(&path, &LoadOptions::default()).unwrap();
        let strict = load(&path, &LoadOptions { strict: true, ..LoadOptions::default() });
        if word.is_empty() {
            assert!(strict.is_ok(), "{extra}");
            continue;
        }
        assert!(!lenient.warnings.is_empty(), "{extra}");
        let error = strict.unwrap_err().to_string();
        assert!(error.contains(place) && error.contains(word), "{extra}\n{error}");
    }
}

/// Loads whatever it is; what comes out must be usable, and the same from temporary files.
fn survives(path: &Path) {
    for strict in [false, true] {
        let spool = Some(Spool { folder: std::env::temp_dir(), above: 0 });
        let spooled = load(path, &LoadOptions { strict, spool, ..LoadOptions::default() });
        let scene = match (load(path, &LoadOptions { strict, ..LoadOptions::default() }), &spooled)
        {
            (Ok(scene), Ok(spooled)) => {
                assert_eq!(triangles(&scene), triangles(spooled));
                assert_eq!(scene.warnings, spooled.warnings);
                assert_eq!(scene.lights().unwrap(), spooled.lights().unwrap());
                scene
            }
            (Err(a), Err(b)) => {
                assert_eq!(a.to_string(), b.to_string());
                continue;
            }
            (a, b) => panic!("{a:?}\n{b:?}"),
        };
        let all = triangles(&scene);
        assert!(all.as_flattened().as_flattened().iter().all(|v| v.is_finite()));
        assert_eq!(all.len() as u64, scene.triangle_count());
        let lights = scene.lights().unwrap();
        assert!(lights.records.iter().all(|l| l.flux_w.iter().all(|w| w.is_finite())));
        assert!(scene.delta.is_finite() && scene.delta > 0.0);
        for hint in &scene.hints {
            assert!((0..3).all(|c| hint.min[c] < hint.max[c]), "{hint:?}");
        }
    }
}

const OBJ: &str = "mtllib a.mtl\no table\nv 0 0 0\nv 1 0 0\nv 1 1 0.5\nv 0 1 0\nvn 0 0 1\n\
    usemtl lamp\nf 1//1 2//1 3//1 4//1\ng leg\nusemtl wall\nf -4 -3 \\\n -1\ns off\nl 1 2\n";
const MTL: &str = "newmtl lamp\nKd 0.5 0.5 0.5\nKe 10 9 8\nillum 2\nd 1\nnewmtl wall\nTf 0.9 .9 .9\n\
    Ni 1.5\nTr 0.5\nmap_Kd a.png\n";
const TOML: &str = "name = \"x\"\nunits = \"cm\"\nup = \"y\"\n[[mesh]]\nfile = \"a.obj\"\n\
    instances = [[0, 0, 0], [1, 2, 3, 45, 2]]\nmaterials = { wall = \"lamp\" }\n[[material]]\n\
    name = \"lamp\"\nlumens = 100\n[[light]]\nkind = \"point\"\nposition = [0, 0, 1]\nwatts = [1, 2, 3]\n\
    [[room]]\nmin = [0, 0, 0]\nmax = [1, 1, 1]\n[[room]]\npolygon = [[0, 0], [2, 0], [0, 2]]\n\
    z = [0, 2.5]\n[[view]]\neye = [0, 0, 0]\ntarget = [1, 0, 0]\n";

/// One change to a file: what, where (as a share of its length), and with what.
type Change = (u8, f64, Vec<u8>);

fn changed(text: &[u8], changes: &[Change]) -> Vec<u8> {
    let mut out = text.to_vec();
    for (kind, place, with) in changes {
        let at = (place * out.len() as f64) as usize;
        let end = (at + with.len()).min(out.len());
        match kind % 5 {
            0 => drop(out.splice(at..end, with.iter().copied())),
            1 => drop(out.splice(at..at, with.iter().copied())),
            2 => drop(out.drain(at..end)),
            3 => out.truncate(at),
            _ => {
                let copy = out[at..end].to_vec();
                out.splice(at..at, copy);
            }
        }
    }
    out
}

fn change() -> impl Strategy<Value = Change> {
    let with = prop_oneof![
        proptest::collection::vec(any::<u8>(), 1..8),
        "[-0-9.eE /]{1,12}".prop_map(String::into_bytes),
        proptest::sample::select(vec![
            "nan",
            "1e39",
            "-1",
            "99999999999",
            "\n",
            "[",
            "\"",
            "{}",
            "\\\n"
        ])
        .prop_map(|t| t.as_bytes().to_vec()),
    ];
    (any::<u8>(), 0.0..1.0f64, with)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..Default::default() })]
    #[test]
    fn damaged_text_never_panics(changes in proptest::collection::vec(change(), 1..6), which in 0..3usize) {
        let dir = tempfile::tempdir().unwrap();
        for (i, (name, text)) in [("a.obj", OBJ), ("a.mtl", MTL), ("a.toml", TOML)].into_iter().enumerate() {
            let bytes = if i == which { changed(text.as_bytes(), &changes) } else { text.into() };
            fs::write(dir.path().join(name), bytes).unwrap();
        }
        survives(&dir.path().join(if which == 2 { "a.toml" } else { "a.obj" }));
    }
}
