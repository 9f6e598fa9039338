//! Scenes written here, read back: every number in closed form.

use enf_layout::light::{LIGHT_AREA, LIGHT_POINT, LIGHT_POINT_LAMBERT};
use enf_layout::material::MATERIAL_SEE_THROUGH;
use enf_scene::{Doors, Frame, LoadOptions, Scene, SceneTriangle, Spool, Up, load, load_views};
use std::{collections::BTreeMap, f64::consts::PI, fs, path::PathBuf};
use tempfile::TempDir;

/// A folder with files in it.
struct Folder(TempDir);

impl Folder {
    fn new(files: &[(&str, &str)]) -> Self {
        let dir = tempfile::tempdir().unwrap();
        for (name, text) in files {
            fs::write(dir.path().join(name), text).unwrap();
        }
        Self(dir)
    }
    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
    fn load(&self, name: &str) -> Scene {
        self.load_with(name, LoadOptions::default())
    }
    /// Loads twice, in memory and spooled, which must not make a difference.
    fn load_with(&self, name: &str, options: LoadOptions) -> Scene {
        let scene = load(&self.path(name), &options).unwrap_or_else(|e| panic!("{e}"));
        let spool = Spool { folder: std::env::temp_dir(), above: 0 };
        let options = LoadOptions { spool: Some(spool), ..options };
        let spooled = load(&self.path(name), &options).unwrap_or_else(|e| panic!("{e}"));
        assert_same(&scene, &spooled);
        scene
    }
    fn error(&self, name: &str) -> String {
        let error = load(&self.path(name), &LoadOptions::default()).expect_err("must fail");
        assert_eq!(error.exit_code(), 4);
        error.to_string()
    }
}

/// Everything that a scene says is the same.
fn assert_same(a: &Scene, b: &Scene) {
    assert_eq!(a.warnings, b.warnings);
    assert_eq!((a.bounds, a.delta, a.origin), (b.bounds, b.delta, b.origin));
    assert_eq!((&a.name, &a.inputs), (&b.name, &b.inputs));
    assert_eq!((&a.views, &a.hints), (&b.views, &b.hints));
    assert_eq!(a.skipped_triangles(), b.skipped_triangles());
    assert_eq!(a.materials, b.materials);
    assert_eq!(triangles(a), triangles(b));
    assert_eq!(a.lights().unwrap(), b.lights().unwrap());
    assert_eq!(a.door_objects(), b.door_objects());
    let names = |s: &Scene| (0..s.object_count()).map(|o| s.object_name(o)).collect::<Vec<_>>();
    assert_eq!(names(a), names(b));
}

fn triangles(scene: &Scene) -> Vec<SceneTriangle> {
    let mut all = Vec::new();
    scene.for_each_triangle(|t| all.push(t)).unwrap();
    assert_eq!(all.len() as u64, scene.triangle_count());
    assert!(all.iter().enumerate().all(|(i, t)| t.index as usize == i));
    assert!(all.iter().all(|t| t.object < scene.object_count()));
    assert!(all.iter().all(|t| (t.material as usize) < scene.materials.len()));
    all
}

fn near(a: f32, b: f64) -> bool {
    (f64::from(a) - b).abs() <= 1e-6 * b.abs().max(1.0)
}

/// A unit square in z = 0 facing up, as vertices 1 to 4.
const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

#[test]
fn a_plain_obj_streams_in_file_order() {
    let f = Folder::new(&[
        (
            "room.obj",
            &format!(
                "\u{feff}# comment\nmtllib room.mtl\n{SQUARE}o floor\nusemtl wood\nf 1/1 2/2/2 3//3 \
                 4\no lid\nusemtl white paint\nf -4 -3 \\\n -2\n"
            ),
        ),
        ("room.mtl", "newmtl white paint\nKd .5 .5 .5\nnewmtl unused\nnewmtl wood\nKd .25 .2 .1\n"),
    ]);
    let scene = f.load("room.obj");
    let all = triangles(&scene);
    assert_eq!(scene.name, "room");
    assert_eq!(scene.warnings, Vec::<String>::new());
    let names: Vec<_> = scene.materials.iter().map(|m| m.name.as_str()).collect();
    assert_eq!(names, ["wood", "white paint"]);
    assert_eq!(scene.materials[0].record.diffuse, [0.25, 0.2, 0.1]);
    assert_eq!(all.len(), 3);
    assert_eq!(all[0].corners, [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.]]);
    assert_eq!(all[1].corners, [[0., 0., 0.], [1., 1., 0.], [0., 1., 0.]]);
    assert_eq!([all[1].material, all[1].object, all[2].material, all[2].object], [0, 0, 1, 1]);
    assert_eq!([scene.object_name(0), scene.object_name(1)], ["floor", "lid"]);
    assert_eq!(scene.bounds, ([0.; 3], [1., 1., 0.]));
    assert_eq!(scene.origin, [0.; 3]);
    assert_eq!(scene.delta, 2.0 / 524288.0);
    let read: Vec<_> = scene.inputs.iter().map(|i| i.path.clone()).collect();
    assert_eq!(read, [f.path("room.obj"), f.path("room.mtl")]);
    let bytes = fs::read(f.path("room.mtl")).unwrap();
    assert_eq!(scene.inputs[1].hash, xxhash_rust::xxh3::xxh3_128(&bytes));
}

#[test]
fn zstd_gives_the_same_scene_and_hashes_the_file_as_it_lies() {
    let text = format!("mtllib a.mtl\n{SQUARE}usemtl m\nf 1 2 3 4\n");
    let f = Folder::new(&[("a.obj", &text), ("a.mtl", "newmtl m\nKd .5 .5 .5\n")]);
    let packed = zstd::encode_all(text.as_bytes(), 3).unwrap();
    fs::write(f.path("a.obj.zst"), &packed).unwrap();
    let (plain, zst) = (f.load("a.obj"), f.load("a.obj.zst"));
    assert_eq!(triangles(&plain), triangles(&zst));
    assert_eq!(plain.materials, zst.materials);
    assert_eq!(zst.name, "a");
    assert_eq!(zst.inputs[0].hash, xxhash_rust::xxh3::xxh3_128(&packed));
    fs::write(f.path("a.obj.zst"), &packed[..packed.len() - 5]).unwrap();
    let error = f.error("a.obj.zst");
    assert!(error.contains("a.obj.zst") && error.contains("damaged"), "{error}");
    fs::write(f.path("a.obj.zst"), text).unwrap();
    assert!(f.error("a.obj.zst").contains("no zstd file"));
}

#[test]
fn units_up_and_winding() {
    let obj = format!("{SQUARE}f 1 2 3\n");
    let toml = "units = \"mm\"\nup = \"y\"\n[[mesh]]\nfile = \"a.obj\"\n\
                instances = [[0, 0, 0], [1000, 0, 0, 0, -2000, 2000, 2000]]\n";
    let f = Folder::new(&[("a.obj", &obj), ("s.toml", toml)]);
    let all = triangles(&f.load("s.toml"));
    assert_eq!(all[0].corners, [[0., 0., 0.], [0.001, 0., 0.], [0.001, 0., 0.001]]);
    // The second mirrors: its corners are in the other order, its front still faces the same way.
    assert_eq!(all[1].corners, [[1., 0., 0.], [-1., 0., 2.], [-1., 0., 0.]]);
    // The command line has the last word.
    let options = LoadOptions { units: Some(1.0), up: Some(Up::Z), ..LoadOptions::default() };
    let all = triangles(&f.load_with("s.toml", options));
    assert_eq!(all[0].corners, [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.]]);
    for (units, metres) in [("\"ft\"", 0.3048f32), ("\"in\"", 0.0254), ("0.5", 0.5), ("2", 2.0)] {
        let toml = format!("units = {units}\n[[mesh]]\nfile = \"a.obj\"\n");
        let f = Folder::new(&[("a.obj", &obj), ("s.toml", &toml)]);
        assert_eq!(f.load("s.toml").bounds.1[0], metres);
    }
}

#[test]
fn instances_are_objects_in_listed_order() {
    let toml = "[[mesh]]\nfile = \"chair.obj\"\ninstances = [[0, 0, 0], [10, 0, 0, 90]]\n\
                [[mesh]]\nfile = \"./chair.obj\"\nname = \"stool\"\nmaterials = { seat = \"red\" }\n\
                instances_file = \"stools.txt\"\n\
                [[mesh]]\nfile = \"chair.obj\"\n[[material]]\nname = \"red\"\nkd = [0.5, 0, 0]\n";
    let chair = format!("{SQUARE}o back\nusemtl seat\nf 1 2 3\no leg\nusemtl wood\nf 1 3 4\n");
    let f = Folder::new(&[
        ("s.toml", toml),
        ("chair.obj", &chair),
        ("stools.txt", "# x y z\n\n0, 20, 0 # first\n1 20 0 0 2\n2 20 0\n"),
    ]);
    let scene = f.load("s.toml");
    let all = triangles(&scene);
    assert_eq!(all.len(), 12);
    let objects: Vec<u32> = all.iter().map(|t| t.object).collect();
    assert_eq!(objects, [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 6]);
    let names: Vec<String> = (0..7).map(|o| scene.object_name(o)).collect();
    assert_eq!(names, ["chair/0", "chair/1", "stool/0", "stool/1", "stool/2", "back", "leg"]);
    assert_eq!(all[2].corners, [[10., 0., 0.], [10., 1., 0.], [9., 1., 0.]]);
    assert_eq!(all[6].corners[1], [3., 20., 0.]);
    let material = |i: usize| scene.materials[all[i].material as usize].name.as_str();
    assert_eq!(
        [material(0), material(1), material(4), material(5)],
        ["seat", "wood", "red", "wood"]
    );
    // The mesh was read once.
    assert_eq!(scene.inputs.len(), 3);
    // Ranges agree with the whole, wherever they begin and end.
    for begin in 0..13 {
        for end in begin..14 {
            let mut part = Vec::new();
            scene.for_each_triangle_in(begin..end, |t| part.push(t)).unwrap();
            let end = (end as usize).min(12);
            assert_eq!(part, all[(begin as usize).min(end)..end], "{begin}..{end}");
        }
    }
    let mut seen = 0;
    let stopped: Result<(), Box<dyn std::error::Error>> = scene.try_for_each_triangle(|t| {
        seen += 1;
        if t.index == 4 { Err("enough".into()) } else { Ok(()) }
    });
    assert_eq!((stopped.unwrap_err().to_string().as_str(), seen), ("enough", 5));
}

#[test]
fn a_hundred_thousand_instances_cost_numbers_only() {
    let lines: String = (0..100_000).map(|i| format!("{} {} 0 {i}\n", i % 300, i / 300)).collect();
    let toml = "[[mesh]]\nfile = \"a.obj\"\ninstances_file = \"a.txt\"\n";
    let f = Folder::new(&[
        ("s.toml", toml),
        ("a.txt", &lines),
        ("a.obj", &format!("{SQUARE}f 1 2 3 4\n")),
    ]);
    let scene = f.load("s.toml");
    assert_eq!(scene.triangle_count(), 200_000);
    assert!(scene.resident_bytes() < 42 * 100_000, "{}", scene.resident_bytes());
    let mut area = 0.0f64;
    scene
        .for_each_triangle(|t| {
            let [a, b, c] = t.corners.map(|p| glam::Vec3::from_array(p).as_dvec3());
            area += 0.5 * (b - a).cross(c - a).length();
        })
        .unwrap();
    assert!((area - 100_000.0).abs() < 0.1, "{area}");
}

#[test]
fn large_coordinates_get_an_origin() {
    let obj = "v 500000.25 4000000 10\nv 500002.25 4000000 10\nv 500000.25 4000001 11\nf 1 2 3\n";
    let toml = "[[mesh]]\nfile = \"a.obj\"\n[[view]]\neye = [500001, 4000000, 12]\n\
                target = [500001, 4000001, 12]\n[[room]]\nmin = [500000, 4000000, 10]\n\
                max = [500002, 4000001, 11]\n[[light]]\nkind = \"point\"\nlumens = 179\n\
                position = [500001, 4000000, 20]\n";
    let f = Folder::new(&[("a.obj", obj), ("s.toml", toml)]);
    let scene = f.load("s.toml");
    // Centre (500001.25, 4000000.5, 10.5), rounded to whole metres.
    assert_eq!(scene.origin, [500001., 4000001., 11.]);
    assert_eq!(
        triangles(&scene)[0].corners,
        [[-0.75, -1., -1.], [1.25, -1., -1.], [-0.75, 0., 0.]]
    );
    assert_eq!(scene.views[0].record.eye, [0., -1., 1.]);
    assert_eq!(scene.hints[0].min, [-1., -1., -1.]);
    assert_eq!(scene.bounds.1, [1.25, 0., 9.]);
    assert_eq!(scene.lights().unwrap().records[0].position, [0., -1., 9.]);
    // A mesh whose own coordinates are large, placed near zero, needs none.
    let toml = "[[mesh]]\nfile = \"a.obj\"\ninstances = [[-500000, -4000000, 0]]\n";
    let f = Folder::new(&[("a.obj", obj), ("s.toml", toml)]);
    let scene = f.load("s.toml");
    assert_eq!(scene.origin, [0.; 3]);
    assert_eq!(triangles(&scene)[0].corners[0], [0.25, 0., 10.]);
}

#[test]
fn what_has_no_area_is_counted_and_named() {
    let obj = format!(
        "{SQUARE}v nan 0 0\nv 1.#INF 0 0\nv 1e300 0 0\nv 1e-30 1e-30 0\no good\nf 1 2 3\n\
         o thin wire\nf 1 1 2\nf 1 2 2\no bad\nf 1 2 5\nf 1 2 6\nf 1 2 7\nf 1 2\nf 1 2 8\no last\n\
         f 1 3 4\n"
    );
    let f = Folder::new(&[("a.obj", &obj)]);
    let scene = f.load("a.obj");
    let all = triangles(&scene);
    // 1e-30 is a number that f32 has: the sliver stays.
    assert_eq!(all.len(), 3);
    assert_eq!(scene.skipped_triangles(), 5);
    assert_eq!(scene.object_name(all[2].object), "last");
    let text = scene.warnings.join("\n");
    assert!(text.contains("a.obj:5: 3 vertices are not finite"), "{text}");
    assert!(
        text.contains("2 triangles without area are left out (first in \"thin wire\""),
        "{text}"
    );
    assert!(
        text.contains(
            "3 triangles with vertices that are not finite are left out (first in \"bad\")"
        ),
        "{text}"
    );
    assert!(text.contains("a.obj:18: 1 faces with fewer than three corners"), "{text}");
}

#[test]
fn missing_materials_are_grey_and_named() {
    let obj = format!(
        "mtllib nowhere.mtl\n{SQUARE}f 1 2 3\nusemtl plaster\nf 1 3 4\nusemtl known\nf 1 2 4\n"
    );
    let f = Folder::new(&[("a.obj", &obj)]);
    let scene = f.load("a.obj");
    assert!(scene.materials.iter().all(|m| m.record.diffuse == [0.7; 3]));
    let text = scene.warnings.join("\n");
    assert!(text.contains("a.obj:1: the material library \"nowhere.mtl\" is missing"), "{text}");
    assert!(text.contains("no definition of material \"plaster\", \"known\"; grey 0.7"), "{text}");
    assert!(text.contains("some faces have no material"), "{text}");
    // A scene file can complete them.
    fs::write(
        f.path("s.toml"),
        "[[mesh]]\nfile = \"a.obj\"\n[[material]]\nname = \"plaster\"\nkd = 0.5\n\
         [[material]]\nname = \"unnamed\"\nkd = 0.25\n[[material]]\nname = \"spare\"\n",
    )
    .unwrap();
    let scene = f.load("s.toml");
    let diffuse: Vec<f32> = scene.materials.iter().map(|m| m.record.diffuse[0]).collect();
    assert_eq!(diffuse, [0.25, 0.5, 0.7]);
    let text = scene.warnings.join("\n");
    assert!(text.contains("no mesh uses the material \"spare\""), "{text}");
}

#[test]
fn material_libraries_are_found_the_way_exporters_mean_them() {
    let mtl = "newmtl m\nKd .5 .5 .5\n";
    for line in ["a b.mtl", "C:\\models\\a b.mtl", "textures/a b.mtl", "none.mtl c.mtl", "./c.mtl"]
    {
        let obj = format!("mtllib {line}\n{SQUARE}usemtl m\nf 1 2 3\n");
        let f = Folder::new(&[("x.obj", &obj), ("a b.mtl", mtl), ("c.mtl", mtl)]);
        let scene = f.load("x.obj");
        assert_eq!(scene.materials[0].record.diffuse, [0.5; 3], "{line}");
        assert_eq!(scene.warnings, Vec::<String>::new(), "{line}");
    }
}

#[test]
fn one_name_in_two_libraries_is_two_materials_unless_equal() {
    let obj = |lib: &str| format!("mtllib {lib}\n{SQUARE}usemtl m\nf 1 2 3\nusemtl n\nf 1 3 4\n");
    let f = Folder::new(&[
        ("a.obj", &obj("a.mtl")),
        ("b.obj", &obj("b.mtl")),
        ("a.mtl", "newmtl m\nKd .5 .5 .5\nnewmtl n\nKd .1 .1 .1\n"),
        ("b.mtl", "newmtl m\nKd .2 .2 .2\nnewmtl n\nKd .1 .1 .1\n"),
        ("s.toml", "[[mesh]]\nfile = \"a.obj\"\n[[mesh]]\nfile = \"b.obj\"\n"),
    ]);
    let scene = f.load("s.toml");
    let names: Vec<_> = scene.materials.iter().map(|m| m.name.as_str()).collect();
    assert_eq!(names, ["m", "n", "m (b)"]);
    let materials: Vec<u32> = triangles(&scene).iter().map(|t| t.material).collect();
    assert_eq!(materials, [0, 1, 2, 1]);
}

#[test]
fn scene_file_materials_complete_and_override() {
    let obj = format!(
        "mtllib a.mtl\n{SQUARE}usemtl wall\nf 1 2 3\nusemtl pane\nf 1 3 4\nusemtl mirror\nf 1 2 4\n\
         usemtl tint\nf 2 3 4\nusemtl opaque\nf 1 2 3\n"
    );
    let toml = "[[mesh]]\nfile = \"a.obj\"\n\
        [[material]]\nname = \"wall\"\nkd = [0.5, 0.25, 0.125]\nke = 3\n\
        [[material]]\nname = \"pane\"\nglass = true\nni = 1.25\n\
        [[material]]\nname = \"mirror\"\nmirror = [0.9, 0.9, 0.9]\n\
        [[material]]\nname = \"tint\"\ntf = [0.5, 0.75, 0.5]\nkd = 0.125\n\
        [[material]]\nname = \"opaque\"\nglass = false\n";
    let mtl = "newmtl wall\nKd 0 0 1\nKe 1 1 1\nnewmtl opaque\nKd .5 .5 .5\nd .1\n";
    let f = Folder::new(&[("a.obj", &obj), ("a.mtl", mtl), ("s.toml", toml)]);
    let scene = f.load("s.toml");
    let of: BTreeMap<_, _> = scene.materials.iter().map(|m| (m.name.as_str(), m.record)).collect();
    assert_eq!(of["wall"].diffuse, [0.5, 0.25, 0.125]);
    assert_eq!(of["wall"].emission, [3.0; 3]);
    assert_eq!((of["pane"].transmission, of["pane"].diffuse), ([1.0; 3], [0.0; 3]));
    assert_eq!((of["pane"].index, of["pane"].flags), (1.25, MATERIAL_SEE_THROUGH));
    assert_eq!((of["mirror"].specular, of["mirror"].diffuse), ([0.9; 3], [0.0; 3]));
    assert_eq!(of["tint"].transmission, [0.5, 0.75, 0.5]);
    assert_eq!((of["tint"].diffuse, of["tint"].index), ([0.125; 3], 1.5));
    assert_eq!((of["opaque"].diffuse, of["opaque"].flags), ([0.5; 3], 0));
}

#[test]
fn an_area_light_in_closed_form() {
    // 2 x 1 m facing down in z = 3, two objects; and one whose normals cancel.
    let obj = "mtllib a.mtl\nv 0 0 3\nv 0 1 3\nv 2 1 3\nv 2 0 3\nusemtl lamp\n\
        o second\nf 1 2 3\no first\nf 1 2 3 4\nusemtl dark\nf 1 3 2\n\
        o folded\nusemtl lamp\nf 1 2 3\nf 1 3 2\n";
    let f = Folder::new(&[
        ("a.obj", obj),
        ("a.mtl", "newmtl lamp\nKd 0 0 0\nKe 10 5 1\nnewmtl dark\n"),
    ]);
    let scene = f.load("a.obj");
    let lights = scene.lights().unwrap();
    assert_eq!(lights.names, ["second lamp", "first lamp", "folded lamp"]);
    let (small, large) = (lights.records[0], lights.records[1]);
    assert_eq!(
        (large.kind, large.material, large.first_emitter, large.emitter_count),
        (LIGHT_AREA, 0, 1, 2)
    );
    assert_eq!(large.area_m2, 2.0);
    for (flux, ke) in large.flux_w.into_iter().zip([10., 5., 1.]) {
        assert!(near(flux, PI * 2.0 * ke), "{flux}");
    }
    assert!(near(small.flux_w[0], PI * 10.0));
    assert_eq!((large.position, large.axis), ([1., 0.5, 3.], [0., 0., -1.]));
    assert!(near(large.radius, 1.25f64.sqrt()) && f64::from(large.radius) >= 1.25f64.sqrt());
    assert_eq!(lights.records[2].axis, [0.; 3]);
    assert_eq!(lights.emitters.len(), 5);
    let cumulative: Vec<f32> = lights.emitters.iter().map(|e| e.cumulative).collect();
    assert_eq!(cumulative, [1.0, 0.5, 1.0, 0.5, 1.0]);
    let all = triangles(&scene);
    for e in &lights.emitters {
        assert_eq!(all[e.triangle as usize].corners, e.corners);
        assert_eq!(all[e.triangle as usize].material, 0);
    }
}

#[test]
fn without_objects_each_connected_component_is_a_light() {
    // Three squares: two share an edge by position only (other vertices), one lies apart.
    let mut obj = String::from("mtllib a.mtl\nusemtl lamp\n");
    for x in [0., 1., 5.] {
        obj += &format!("v {x} 0 0\nv {} 0 0\nv {} 1 0\nv {x} 1 0\n", x + 1.0, x + 1.0);
    }
    // Faces in mixed order, with an unlit one between.
    obj += "f 9 10 11\nf 1 2 3\nusemtl dark\nf 1 2 4\nusemtl lamp\nf 5 6 7\nf 9 11 12\nf 1 3 4\nf 5 7 8\n";
    let f = Folder::new(&[("a.obj", &obj), ("a.mtl", "newmtl lamp\nKe 1 1 1\nnewmtl dark\n")]);
    let scene = f.load("a.obj");
    let lights = scene.lights().unwrap();
    let areas: Vec<f32> = lights.records.iter().map(|l| l.area_m2).collect();
    assert_eq!(areas, [1.0, 2.0]);
    let first: Vec<u32> = lights.emitters.iter().map(|e| e.triangle).collect();
    assert_eq!(first, [0, 4, 1, 3, 5, 6]);
    assert_eq!(lights.names, ["lamp 1 lamp", "lamp 2 lamp"]);
    assert_eq!(triangles(&scene).len(), 7);
    // Named groups are objects where there is no "o"; Maya's default group is none.
    let obj = obj.replace("usemtl lamp\nf 5", "usemtl lamp\ng lamps\nf 5").replacen(
        "v",
        "g default\nv",
        1,
    );
    let f = Folder::new(&[("a.obj", &obj), ("a.mtl", "newmtl lamp\nKe 1 1 1\nnewmtl dark\n")]);
    let lights = f.load("a.obj").lights().unwrap();
    let areas: Vec<f32> = lights.records.iter().map(|l| l.area_m2).collect();
    assert_eq!(areas.iter().sum::<f32>(), 3.0);
    assert!(lights.names.contains(&"lamps lamp".to_string()));
}

#[test]
fn an_instance_is_one_light_and_power_is_per_light() {
    let lamp = "v 0 0 0\nv 0 1 0\nv 1 1 0\nv 1 0 0\nv 9 9 0\nv 9 10 0\nv 10 10 0\nusemtl glow\n\
                o left\nf 1 2 3 4\no right\nf 5 6 7\n";
    let toml = "[[mesh]]\nfile = \"lamp.obj\"\n\
        instances = [[0, 0, 5], [20, 0, 5, 33], [40, 0, 5, 0, 2], [60, 0, 5, 71]]\n\
        [[material]]\nname = \"glow\"\nlumens = 3580\ncolor = [1.0, 0.5, 0.25]\n";
    let f = Folder::new(&[("lamp.obj", lamp), ("s.toml", toml)]);
    let scene = f.load("s.toml");
    let lights = scene.lights().unwrap();
    assert_eq!(
        lights.names,
        ["lamp/0 glow", "lamp/1 glow", "lamp/2 glow 6.000000 m2", "lamp/3 glow"]
    );
    // 3580 lm / 179 = 20 W of scalar flux each, whatever the area; the colour's ratios stay.
    for light in &lights.records {
        let [r, g, b] = light.flux_w.map(f64::from);
        assert!((0.2126 * r + 0.7152 * g + 0.0722 * b - 20.0).abs() < 1e-4);
        assert!((g / r - 0.5).abs() < 1e-6 && (b / r - 0.25).abs() < 1e-6);
    }
    assert!(near(lights.records[2].area_m2, 6.0) && near(lights.records[0].area_m2, 1.5));
    // Turned instances share the material; the scaled one has a copy with a quarter of the radiance.
    let ids: Vec<u32> = lights.records.iter().map(|l| l.material).collect();
    assert_eq!(ids, [0, 0, 1, 0]);
    let le = |i: usize| f64::from(scene.materials[i].record.emission[0]);
    assert!((le(0) / le(1) - 4.0).abs() < 1e-4);
    let all = triangles(&scene);
    assert_eq!(
        all.iter().map(|t| t.material).collect::<Vec<_>>(),
        [0, 0, 0, 0, 0, 0, 1, 1, 1, 0, 0, 0]
    );

    // candela is along the normal of a Lambertian emitter: pi lumens each; watts is the scalar itself.
    for (key, watts) in [("candela = 179", PI), ("watts = 7", 7.0)] {
        let toml = format!(
            "[[mesh]]\nfile = \"lamp.obj\"\ninstances = [[0, 0, 5]]\n[[material]]\nname = \"glow\"\n{key}\n"
        );
        fs::write(f.path("s.toml"), toml).unwrap();
        let lights = f.load("s.toml").lights().unwrap();
        assert_eq!(lights.records.len(), 1);
        assert!(lights.records[0].flux_w.iter().all(|&w| near(w, watts)), "{key}");
    }
}

#[test]
fn a_light_without_area_is_dropped_and_said() {
    let obj =
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl lamp\no wire\nf 1 2 2\no good\nf 1 2 3\n";
    let f = Folder::new(&[("a.obj", obj), ("a.mtl", "newmtl lamp\nKe 1 1 1\n")]);
    let scene = f.load("a.obj");
    assert_eq!(scene.lights().unwrap().names, ["good lamp"]);
    assert!(
        scene.warnings.iter().any(|w| w.contains("1 lights without area")),
        "{:?}",
        scene.warnings
    );
}

#[test]
fn point_lights() {
    let toml = "units = \"cm\"\n[[mesh]]\nfile = \"a.obj\"\n\
        [[light]]\nname = \"p1\"\nkind = \"point\"\nposition = [100, 200, 300]\ncandela = 179\n\
        [[light]]\nkind = \"lambert-point\"\nposition = [0, 0, 300]\ndirection = [0, 0, -5]\n\
        watts = [1, 2, 3]\n\
        [[light]]\nkind = \"lambert-point\"\nposition = [0, 0, 300]\ncandela = 179\n";
    let f = Folder::new(&[("a.obj", &format!("{SQUARE}f 1 2 3\n")), ("s.toml", toml)]);
    let scene = f.load("s.toml");
    let lights = scene.lights().unwrap();
    assert_eq!(lights.names, ["p1", "light-2", "light-3"]);
    let r = &lights.records;
    assert_eq!((r[0].kind, r[0].position), (LIGHT_POINT, [1., 2., 3.]));
    assert!(near(r[0].flux_w[0], 4.0 * PI));
    assert_eq!(
        (r[1].kind, r[1].axis, r[1].flux_w),
        (LIGHT_POINT_LAMBERT, [0., 0., -1.], [1., 2., 3.])
    );
    assert!(near(r[2].flux_w[1], PI));
    assert_eq!((r[0].material, r[0].emitter_count), (enf_layout::NONE, 0));
    assert_eq!(scene.bounds.1, [1., 2., 3.]);
}

#[test]
fn open_doors_are_left_out_and_still_reported() {
    let obj = format!(
        "{SQUARE}o IfcWall/1/w\nf 1 2 3\no IfcDoor/2/d\nf 1 3 4\no IfcWall/3/with door\nf 1 2 4\n\
         o house\ng Door_7\nf 2 3 4\ng door frame\nf 1 2 3\n"
    );
    let toml = "[[mesh]]\nfile = \"a.obj\"\n[[mesh]]\nfile = \"leaf.obj\"\ndoor = true\n\
        instances = [[0, 0, 1], [0, 0, 2]]\n[[mesh]]\nfile = \"leaf.obj\"\nname = \"door 3\"\n\
        instances = [[0, 0, 3]]\n[[mesh]]\nfile = \"leaf.obj\"\nname = \"door that stays\"\ndoor = false\n\
        instances = [[0, 0, 4]]\n";
    let leaf = format!("{SQUARE}f 1 2 3\n");
    let f = Folder::new(&[("a.obj", &obj), ("leaf.obj", &leaf), ("s.toml", toml)]);
    let shut = f.load("s.toml");
    let open = f.load_with("s.toml", LoadOptions { doors: Doors::Open, ..LoadOptions::default() });
    assert_eq!(shut.triangle_count(), 9);
    let doors = shut.door_objects();
    let names: Vec<String> = doors.iter().map(|&d| shut.object_name(d)).collect();
    assert_eq!(names, ["IfcDoor/2/d", "house", "leaf/0", "leaf/1", "door 3"]);
    assert_eq!(open.door_objects(), doors);
    let left: Vec<String> = triangles(&open).iter().map(|t| open.object_name(t.object)).collect();
    assert_eq!(left, ["IfcWall/1/w", "IfcWall/3/with door", "house", "door that stays"]);
    // Faces in no object or group go by the material's name.
    let obj = format!("{SQUARE}usemtl wall\nf 1 2 3\nusemtl door_paint\nf 1 3 4\n");
    let f = Folder::new(&[("a.obj", &obj)]);
    let open = f.load_with("a.obj", LoadOptions { doors: Doors::Open, ..LoadOptions::default() });
    assert_eq!(open.triangle_count(), 1);
}

#[test]
fn views_in_a_scene_and_in_a_file_of_their_own() {
    let view = "[[view]]\nname = \"lobby\"\neye = [0, 1.6, 0]\ntarget = [0, 1.6, -5]\nfov = 50\n\
                width = 960\nheight = 600\n[[view]]\neye = [0, 3, 0]\ntarget = [0, 0, 0]\n\
                [[view]]\nkind = \"panorama\"\neye = [0, 3, 0]\ntarget = [0, 5, 0]\n";
    let toml = format!("up = \"y\"\nname = \"villa\"\n[[mesh]]\nfile = \"a.obj\"\n{view}");
    let f = Folder::new(&[
        ("a.obj", &format!("{SQUARE}f 1 2 3\n")),
        ("s.toml", &toml),
        ("views.toml", view),
        ("empty.toml", ""),
        ("wrong.toml", "[[mesh]]\nfile = \"a.obj\"\n"),
    ]);
    let scene = f.load("s.toml");
    assert_eq!(scene.name, "villa");
    let v = &scene.views[0];
    assert_eq!(v.name, "lobby");
    assert_eq!(
        (v.record.eye, v.record.target, v.record.up),
        ([0., 0., 1.6], [0., 5., 1.6], [0., 0., 1.])
    );
    assert_eq!((v.record.fov_degrees, v.record.width, v.record.height), (50., 960, 600));
    // Straight down: some other up.
    let down = &scene.views[1];
    assert_eq!(
        (down.name.as_str(), down.record.up, down.record.width),
        ("view-2", [0., 1., 0.], 0)
    );
    // A panorama's horizon is level, whatever it looks at.
    let up = &scene.views[2].record;
    assert_eq!((up.target, up.up), ([0., 1., 3.], [0., 0., 1.]));
    assert_eq!(load_views(&f.path("views.toml"), &scene.frame()).unwrap(), scene.views);
    let moved = Frame { origin: [0., 100., 0.], ..scene.frame() };
    assert_eq!(load_views(&f.path("views.toml"), &moved).unwrap()[0].record.eye, [0., -100., 1.6]);
    let error = load_views(&f.path("empty.toml"), &moved).unwrap_err().to_string();
    assert!(error.contains("no [[view]]"), "{error}");
    let error = load_views(&f.path("wrong.toml"), &moved).unwrap_err().to_string();
    assert!(error.contains("wrong.toml:1") && error.contains("mesh"), "{error}");
}

#[test]
fn bad_objs_name_the_line() {
    for (text, line, word) in [
        ("v 0 0 0\nv 1 x 0\n", 2, "three numbers"),
        ("v 0 0\n", 1, "three numbers"),
        ("v 0 0 0\n\nf 1 2 3\n", 3, "uses vertex 3, but the file has 1"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 -4\n", 4, "vertex -4"),
        ("v 0 0 0\nf 0 1 2\n", 2, "vertex 0"),
        ("v 0 0 0\nf 1 2 q\n", 2, "\"q\" is no vertex"),
        ("v 0 0 0 \\\n\nf 1 2 99999999999999999999\n", 3, "no vertex"),
        ("f 1 2 3\n", 1, "the file has 0"),
    ] {
        let f = Folder::new(&[("a.obj", text)]);
        let error = f.error("a.obj");
        assert!(error.contains(&format!("a.obj:{line}: ")) && error.contains(word), "{error}");
    }
    let f =
        Folder::new(&[("a.obj", "o nothing\n"), ("b.obj", "v 0 0 0\nf 1 1 1\n"), ("c.stl", "")]);
    assert!(f.error("a.obj").contains("no triangle in it"));
    assert!(f.error("b.obj").contains("none of its 1 triangles has an area"));
    assert!(f.error("c.stl").contains("give a .obj"));
    assert!(f.error("none.obj").contains("cannot be read"));
    assert!(load(f.0.path(), &LoadOptions::default()).is_err());
    fs::create_dir(f.path("d.obj")).unwrap();
    assert!(f.error("d.obj").contains("cannot be read"));
    // An MTL that is no MTL.
    for (mtl, line, word) in [
        ("newmtl m\nKd .5 .5\n", 2, "Kd needs one or three numbers"),
        ("newmtl\n", 1, "without a name"),
        ("newmtl m\nd\n", 2, "d needs a number"),
        ("newmtl m\nKe nan 0 0\n", 2, "Ke"),
        ("newmtl m\nillum -3\n", 2, "illumination model"),
    ] {
        let obj = format!("mtllib m.mtl\n{SQUARE}usemtl m\nf 1 2 3\n");
        let f = Folder::new(&[("a.obj", &obj), ("m.mtl", mtl)]);
        let error = f.error("a.obj");
        assert!(error.contains(&format!("m.mtl:{line}: ")) && error.contains(word), "{error}");
    }
}

#[test]
fn bad_scene_files_name_the_line_and_the_key() {
    let obj = format!("{SQUARE}usemtl m\nf 1 2 3\n");
    let mesh = "[[mesh]]\nfile = \"a.obj\"\n";
    for (toml, line, word) in [
        (format!("{mesh}instnces = []\n"), 3, "unknown field `instnces`"),
        (format!("colour = 3\n{mesh}"), 1, "unknown field `colour`"),
        (format!("{mesh}instances = [[1, 2, 3],\n [1, 2]]\n"), 4, "an instance has 2 numbers"),
        (format!("{mesh}instances = [[0, 0, 0, 0, 0]]\n"), 3, "scaled to nothing"),
        (format!("{mesh}instances = [[0, 0, \"x\"]]\n"), 3, "invalid type"),
        (format!("{mesh}instances = [[0, 0, nan]]\n"), 3, "NaN"),
        (format!("{mesh}instances = []\ninstances_file = \"x\"\n"), 1, "both"),
        ("[[mesh]]\nname = \"x\"\n".into(), 1, "missing field `file`"),
        ("[[mesh]]\nfile = \"b.obj\"\n".into(), 1, "b.obj\" is missing"),
        ("[[mesh]]\nfile = \"b.stl\"\n".into(), 1, "no OBJ"),
        (format!("units = \"parsec\"\n{mesh}"), 1, "parsec"),
        (format!("units = -1\n{mesh}"), 1, "units"),
        (format!("up = \"x\"\n{mesh}"), 1, "up"),
        (format!("name = \"a/b\"\n{mesh}"), 1, "file name"),
        (format!("name = \"a\n{mesh}"), 1, ""),
        (format!("{mesh}[[material]]\nname = \"m\"\nlumens = 1\nwatts = 1\n"), 3, "only one of"),
        (format!("{mesh}[[material]]\nname = \"m\"\nlumens = 1\nke = 1\n"), 3, "exclude"),
        (format!("{mesh}[[material]]\nname = \"m\"\nlumens = 1\ncolor = [0, 0, 0]\n"), 3, "black"),
        (format!("{mesh}[[material]]\nname = \"m\"\nlumens = -1\n"), 3, "out of range"),
        (format!("{mesh}[[material]]\nname = \"m\"\nkd = [1, 2]\n"), 5, "invalid length 2"),
        (format!("{mesh}[[material]]\nname = \"m\"\nkd = [1, 2, -3]\n"), 5, "-3"),
        (format!("{mesh}[[material]]\nname = \"m\"\n[[material]]\nname = \"m\"\n"), 5, "twice"),
        (format!("{mesh}[[material]]\nname = \"m\"\ncolor = 1\n"), 3, "color"),
        (format!("{mesh}[[light]]\nkind = \"torch\"\nposition = [0, 0, 0]\n"), 4, "torch"),
        (format!("{mesh}[[light]]\nkind = \"point\"\nposition = [0, 0, 0]\n"), 3, "needs"),
        (format!("{mesh}[[room]]\nmin = [0, 0, 0]\nmax = [1, 1, 0]\n"), 3, "empty"),
        (format!("{mesh}[[view]]\neye = [0, 0, 0]\ntarget = [0, 0, 0]\n"), 3, "one point"),
        (format!("{mesh}[[view]]\neye = [0, 0, 0]\ntarget = [1, 0, 0]\nfov = 180\n"), 3, "fov"),
        (format!("{mesh}[[view]]\neye = [0, 0, 0]\ntarget = [1, 0, 0]\nup = [2, 0, 0]\n"), 3, "up"),
        (
            format!("{mesh}[[view]]\nname = \"../x\"\neye = [0, 0, 0]\ntarget = [1, 0, 0]\n"),
            3,
            "file name",
        ),
        (format!("{mesh}[[view]]\neye = [0, 0, 0]\ntarget = [1, 0, 0]\nwidth = 0\n"), 3, "width"),
    ] {
        let f = Folder::new(&[("a.obj", &obj), ("s.toml", &toml)]);
        let error = f.error("s.toml");
        assert!(
            error.contains(&format!("s.toml:{line}: ")) && error.contains(word),
            "{toml}\n{error}"
        );
    }
    let f = Folder::new(&[
        ("a.obj", &obj),
        ("s.toml", "name = \"x\"\n"),
        ("t.toml", ""),
        ("i.txt", "0 0 0\n1 2 z\n"),
    ]);
    assert!(f.error("s.toml").contains("no [[mesh]]"));
    fs::write(f.path("s.toml"), format!("{mesh}instances_file = \"i.txt\"\n")).unwrap();
    assert!(f.error("s.toml").contains("i.txt:2: \"z\""));
    fs::write(f.path("s.toml"), b"name = \"x\"\n\n# \xff\n").unwrap();
    assert!(f.error("s.toml").contains("s.toml:3: the text is not UTF-8"));
}

#[test]
fn a_scene_in_the_wrong_units_is_refused_with_the_remedy() {
    let f = Folder::new(&[
        ("a.obj", "v 0 0 0\nv 2e6 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("b.obj", "v 0 0 0\nv 2e4 0 0\nv 0 1e4 0\nf 1 2 3\n"),
    ]);
    assert!(f.error("a.obj").contains("--units mm"));
    assert!(f.load("b.obj").warnings.iter().any(|w| w.contains("--units")));
    let options = LoadOptions { units: Some(0.001), ..LoadOptions::default() };
    assert_eq!(f.load_with("b.obj", options).bounds.1, [20., 10., 0.]);
    let options = LoadOptions { units: Some(f64::NAN), ..LoadOptions::default() };
    assert!(load(&f.path("b.obj"), &options).is_err());
}

/// `[sky]`: what is said is what arrives, and what is wrong is said with its line.
#[test]
fn skies() {
    let obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    let with = |sky: &str| {
        Folder::new(&[
            ("a.obj", obj),
            ("s.toml", &format!("[[mesh]]\nfile = \"a.obj\"\n\n[sky]\n{sky}\n")),
        ])
    };
    let sky = |text: &str| with(text).load("s.toml").sky.unwrap();
    let overcast = sky("model = \"cie-16\"\ndiffuse_horizontal_lux = 17900\nground = 0.3");
    // 100 W/m2: zenith 9 E / (7 pi), horizon a third of it; the ground reflects 0.3 of it.
    let zenith = overcast.scale * 3.0;
    assert!((zenith - 900.0 / (7.0 * PI)).abs() < 0.01, "{zenith}");
    assert!((overcast.ground[1] - 30.0 / PI).abs() < 1e-9);
    assert_eq!((overcast.sun, overcast.sun_irradiance), ([0.0; 3], [0.0; 3]));

    let clear =
        sky("model = \"cie-12\"\ndiffuse_horizontal = 80\ndirect_normal = 400\nefficacy = 89.5\n\
         sun = [180, 30]\nnorth = 90\nsun_color = [1, 0.9, 0.7]");
    // True north is +x, so the south is -x.
    let level = 30f64.to_radians().cos();
    assert!((clear.sun[0] + level).abs() < 1e-12 && (clear.sun[2] - 0.5).abs() < 1e-12);
    let luminance = enf_scene::luminance(clear.sun_irradiance);
    assert!((luminance - 200.0).abs() < 1e-9, "half of the watts are seen");
    assert!(clear.sun_irradiance[0] > clear.sun_irradiance[2]);

    // The same moment as TOML's own date and time, and as text (NREL/TP-560-34302: 50.11 degrees from the zenith).
    let place = "latitude = 39.742476\nlongitude = -105.1786\ntimezone = -7\n";
    let perez = "model = \"perez\"\ndiffuse_horizontal = 100\ndirect_normal = 700\n";
    let a = sky(&format!("{perez}date = 2003-10-17\ntime = 12:30:30\n{place}"));
    let b = sky(&format!("{perez}date = \"2003-10-17\"\ntime = \"12:30:30\"\n{place}"));
    assert_eq!(a, b);
    assert!((a.sun[2].acos().to_degrees() - 50.11).abs() < 0.05);

    let error = |text: &str, says: &str| {
        let message = with(text).error("s.toml");
        assert!(message.contains(says) && message.contains("s.toml:4"), "{message}");
    };
    let lux = "diffuse_horizontal_lux = 10000\n";
    error(&format!("model = \"cie-17\"\n{lux}"), "no model \"cie-17\"");
    error("model = \"cie-1\"", "diffuse_horizontal");
    error(&format!("model = \"cie-1\"\ndiffuse_horizontal = 3\n{lux}"), "both");
    error(&format!("model = \"cie-12\"\n{lux}"), "where the sun stands");
    error(&format!("model = \"cie-1\"\n{lux}direct_normal = 3"), "where the sun stands");
    error(&format!("model = \"perez\"\n{lux}sun = [0, -3.5]"), "3.5 degrees below");
    error(&format!("model = \"cie-12\"\n{lux}sun = [0, 95]"), "out of range");
    error(
        &format!("model = \"cie-12\"\n{lux}sun = [0, 5]\ntime = 10:00:00"),
        "both \"sun\" and \"time\"",
    );
    error(&format!("model = \"cie-12\"\n{lux}date = 2026-06-21\ntime = 10:00:00\n"), "latitude");
    error(
        &format!("model = \"cie-12\"\n{lux}date = \"2026-02-30\"\ntime = 10:00:00\n{place}"),
        "is no date",
    );
    error("model = \"cie-1\"\ndiffuse_horizontal = 0", "dark");
    error(&format!("model = \"cie-1\"\n{lux}ground = 1.5"), "ground");
    let unknown = with("model = \"cie-1\"\nturbidity = 2").error("s.toml");
    assert!(unknown.contains("turbidity"), "{unknown}");
}
