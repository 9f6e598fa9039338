//! glTF files made here, against the same scenes as OBJ, bit by bit; against the crate `gltf`; and damaged.

use enf_layout::light::{LIGHT_POINT, LIGHT_SPOT};
use enf_layout::material::{MATERIAL_GLOSS, MATERIAL_SEE_THROUGH, MATERIAL_SOLID};
use enf_scene::{LoadOptions, Scene, SceneTriangle, Spool, Up, load};
use proptest::prelude::*;
use serde_json::{Value, json};
use std::{collections::BTreeMap, f64::consts::PI, fs, path::Path};
use tempfile::TempDir;

/// A glTF file under construction.
struct Model {
    json: Value,
    bin: Vec<u8>,
}

impl Model {
    fn new() -> Self {
        let json = json!({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}], "nodes": [],
            "meshes": [], "accessors": [], "bufferViews": [], "materials": [], "cameras": [],
        });
        Self { json, bin: Vec::new() }
    }

    fn push(&mut self, list: &str, item: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(item);
        list.len() - 1
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        while !self.bin.len().is_multiple_of(4) {
            self.bin.push(0);
        }
        let at = self.bin.len();
        self.bin.extend_from_slice(bytes);
        self.push("bufferViews", json!({"buffer": 0, "byteOffset": at, "byteLength": bytes.len()}))
    }

    fn positions(&mut self, points: &[[f32; 3]]) -> usize {
        let bytes: Vec<u8> = points.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
        let view = self.view(&bytes);
        let far = |pick: fn(f32, f32) -> f32| -> Vec<f32> {
            (0..3).map(|c| points.iter().map(|p| p[c]).reduce(pick).unwrap()).collect()
        };
        let (min, max) = (far(f32::min), far(f32::max));
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": 5126, "count": points.len(),
                   "type": "VEC3", "min": min, "max": max}),
        )
    }

    /// Indices of 1, 2 or 4 bytes.
    fn indices(&mut self, bytes: usize, list: &[u32]) -> usize {
        let packed: Vec<u8> = list.iter().flat_map(|v| v.to_le_bytes()[..bytes].to_vec()).collect();
        let view = self.view(&packed);
        let kind = [0, 5121, 5123, 0, 5125][bytes];
        self.push(
            "accessors",
            json!({"bufferView": view, "componentType": kind, "count": list.len(),
                   "type": "SCALAR"}),
        )
    }

    fn mesh(&mut self, primitives: Value) -> usize {
        self.push("meshes", json!({"primitives": primitives}))
    }

    /// A node at the top.
    fn node(&mut self, node: Value) -> usize {
        let id = self.push("nodes", node);
        self.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(json!(id));
        id
    }

    /// As `.glb`, or as `.gltf` with `.bin` or with a data URI.
    fn save(&self, folder: &Path, name: &str) -> std::path::PathBuf {
        let mut json = self.json.clone();
        let mut buffer = json!({"byteLength": self.bin.len()});
        let path = folder.join(name);
        if name.ends_with(".glb") {
            json["buffers"] = json!([buffer]);
            fs::write(&path, glb(&json, &self.bin)).unwrap();
        } else {
            if name.starts_with("data") {
                let uri = format!("data:application/octet-stream;base64,{}", base64(&self.bin));
                buffer["uri"] = json!(uri);
            } else {
                fs::write(folder.join("its buffer.bin"), &self.bin).unwrap();
                buffer["uri"] = json!("its%20buffer.bin");
            }
            json["buffers"] = json!([buffer]);
            fs::write(&path, serde_json::to_string_pretty(&json).unwrap()).unwrap();
        }
        path
    }
}

fn glb(json: &Value, bin: &[u8]) -> Vec<u8> {
    let mut text = serde_json::to_vec(json).unwrap();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bin = bin.to_vec();
    bin.resize(bin.len().next_multiple_of(4), 0);
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend((28 + text.len() as u32 + bin.len() as u32).to_le_bytes());
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(b"JSON");
    out.extend(text);
    out.extend((bin.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(bin);
    out
}

fn base64(bytes: &[u8]) -> String {
    let set = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::new();
    for chunk in bytes.chunks(3) {
        let mut n = [0u8; 3];
        n[..chunk.len()].copy_from_slice(chunk);
        let bits = u32::from_be_bytes([0, n[0], n[1], n[2]]);
        for i in 0..4 {
            let six = (bits >> (18 - 6 * i) & 63) as usize;
            out.push(if i <= chunk.len() { char::from(set[six]) } else { '=' });
        }
    }
    out
}

fn triangles(scene: &Scene) -> Vec<SceneTriangle> {
    let mut out = Vec::new();
    scene.for_each_triangle(|t| out.push(t)).unwrap();
    assert_eq!(out.len() as u64, scene.triangle_count());
    out
}

fn open(path: &Path) -> Scene {
    let scene = load(path, &LoadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
    let spool = Some(Spool { folder: std::env::temp_dir(), above: 0 });
    let spooled = load(path, &LoadOptions { spool, ..LoadOptions::default() }).unwrap();
    assert_eq!(triangles(&scene), triangles(&spooled));
    assert_eq!(scene.lights().unwrap(), spooled.lights().unwrap());
    assert_eq!(scene.warnings, spooled.warnings);
    scene
}

fn error(path: &Path) -> String {
    let error = load(path, &LoadOptions::default()).expect_err("must fail");
    assert_eq!(error.exit_code(), 4);
    error.to_string()
}

const QUAD: [[f32; 3]; 4] = [[0., 0., 0.], [1.5, 0., 0.], [1.5, 2.25, 0.], [0., 2.25, 0.125]];

/// A scene of every kind of primitive, node and packing, and what it is as OBJ.
fn everything() -> (Model, String, String, String) {
    let mut m = Model::new();
    let paint = m.push(
        "materials",
        json!({"name": "paint", "doubleSided": true, "pbrMetallicRoughness": {
            "baseColorFactor": [0.5, 0.25, 0.125, 1.0], "metallicFactor": 0.0}}),
    );
    let lamp = m.push(
        "materials",
        json!({"name": "lamp", "emissiveFactor": [1.0, 0.5, 0.25], "pbrMetallicRoughness": {
            "baseColorFactor": [0.0, 0.0, 0.0, 1.0]},
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 1790.0}}}),
    );
    let quad = m.positions(&QUAD);
    let (short, byte, long) = (
        m.indices(2, &[0, 1, 2, 0, 2, 3]),
        m.indices(1, &[0, 1, 2, 3]),
        m.indices(4, &[0, 1, 2, 3]),
    );
    let list =
        m.mesh(json!([{"attributes": {"POSITION": quad}, "indices": short, "material": paint}]));
    let cut = m.mesh(json!([
        {"attributes": {"POSITION": quad}, "indices": byte, "mode": 5, "material": lamp},
        {"attributes": {"POSITION": quad}, "indices": long, "mode": 6, "material": paint},
        {"attributes": {"POSITION": quad}, "mode": 5, "material": paint},
        {"attributes": {"POSITION": quad}, "mode": 1},
    ]));
    m.node(json!({"name": "first", "mesh": list}));
    let child = m.push(
        "nodes",
        json!({"name": "child", "mesh": list, "matrix": [0., 0., -1., 0., 0., 1., 0., 0., 1., 0., 0., 0.,
               0.5, 0.25, 4., 1.]}),
    );
    m.node(
        json!({"name": "parent", "mesh": cut, "children": [child], "translation": [10.0, 0.0, -3.0],
                  "scale": [-2.0, 2.0, 2.0]}),
    );
    m.node(json!({"name": "Door 7", "mesh": list, "translation": [0.0, 0.0, 9.5]}));
    let vertices: String = QUAD.iter().map(|[x, y, z]| format!("v {x} {y} {z}\n")).collect();
    let list = format!("mtllib a.mtl\n{vertices}usemtl paint\nf 1 2 3\nf 1 3 4\n");
    let cut = format!(
        "mtllib a.mtl\n{vertices}usemtl lamp\nf 1 2 3\nf 2 4 3\nusemtl paint\nf 2 3 1\nf 3 4 1\n\
         f 1 2 3\nf 2 4 3\n"
    );
    // child: x' = z, z' = -x of a quarter turn, then the parent's (-2, 2, 2) and (10, 0, -3).
    let toml = "up = \"y\"\n[[mesh]]\nfile = \"list.obj\"\nname = \"first\"\ninstances = [[0, 0, 0]]\n\
        [[mesh]]\nfile = \"cut.obj\"\nname = \"parent\"\n\
        instances = [[-2, 0, 0, 10,  0, 2, 0, 0,  0, 0, 2, -3]]\n\
        [[mesh]]\nfile = \"list.obj\"\nname = \"child\"\n\
        instances = [[0, 0, -2, 9,  0, 2, 0, 0.5,  -2, 0, 0, 5]]\n\
        [[mesh]]\nfile = \"list.obj\"\nname = \"Door 7\"\ninstances = [[0, 0, 9.5]]\n\
        [[material]]\nname = \"lamp\"\nke = [10, 5, 2.5]\n";
    (m, list, cut, toml.into())
}

#[test]
fn the_same_scene_as_obj_bit_by_bit() {
    let (model, list, cut, toml) = everything();
    let dir = TempDir::new().unwrap();
    for (name, text) in [
        ("list.obj", list.as_str()),
        ("cut.obj", &cut),
        ("s.toml", &toml),
        ("a.mtl", "newmtl paint\nKd 0.5 0.25 0.125\nnewmtl lamp\nKd 0 0 0\n"),
    ] {
        fs::write(dir.path().join(name), text).unwrap();
    }
    let expected = open(&dir.path().join("s.toml"));
    let mut inputs = Vec::new();
    for name in ["a.glb", "a.gltf", "data.gltf"] {
        let scene = open(&model.save(dir.path(), name));
        let (a, b) = (triangles(&scene), triangles(&expected));
        assert_eq!(a.len(), 12);
        for (a, b) in a.iter().zip(&b) {
            assert_eq!(
                a.corners.map(|p| p.map(f32::to_bits)),
                b.corners.map(|p| p.map(f32::to_bits))
            );
        }
        assert_eq!(a, b, "{name}");
        assert_eq!(scene.bounds, expected.bounds);
        let names = |s: &Scene| (0..s.object_count()).map(|o| s.object_name(o)).collect::<Vec<_>>();
        assert_eq!(names(&scene), ["first", "parent", "child", "Door 7"]);
        assert_eq!(names(&scene), names(&expected));
        assert_eq!((scene.door_objects(), expected.door_objects()), (vec![3], vec![3]));
        let records = |s: &Scene| s.materials.iter().map(|m| m.record).collect::<Vec<_>>();
        assert_eq!(records(&scene), records(&expected));
        assert_eq!(scene.lights().unwrap(), expected.lights().unwrap());
        assert_eq!(scene.name, name.split('.').next().unwrap());
        assert_eq!(scene.warnings.len(), 1, "{:?}", scene.warnings);
        assert!(scene.warnings[0].contains("1 primitives are points or lines"));
        inputs.push(scene.inputs.len());
    }
    assert_eq!(inputs, [1, 2, 1]);
    // One mesh, however many nodes; up is known, units may be corrected.
    let options = LoadOptions { up: Some(Up::Z), units: Some(0.5), ..LoadOptions::default() };
    let half = load(&dir.path().join("a.glb"), &options).unwrap();
    assert!(half.warnings.iter().any(|w| w.contains("--up is ignored")), "{:?}", half.warnings);
    assert_eq!(half.bounds.1[0], expected.bounds.1[0] * 0.5);
}

#[test]
fn in_a_scene_file_it_is_turned_to_the_scenes_axes() {
    let (model, ..) = everything();
    let dir = TempDir::new().unwrap();
    let alone = open(&model.save(dir.path(), "a.glb"));
    for head in ["", "units = \"cm\"\n", "up = \"y\"\n", "up = \"y\"\nunits = \"mm\"\n"] {
        let toml = format!("{head}[[mesh]]\nfile = \"a.glb\"\n");
        fs::write(dir.path().join("s.toml"), toml).unwrap();
        let scene = open(&dir.path().join("s.toml"));
        for (a, b) in triangles(&scene).iter().zip(triangles(&alone)) {
            assert_eq!((a.object, a.material), (b.object, b.material));
            for (p, q) in a.corners.as_flattened().iter().zip(b.corners.as_flattened()) {
                assert!((p - q).abs() < 1e-5, "{head}: {a:?} {b:?}");
            }
        }
        assert_eq!(scene.object_name(2), "child");
    }
    let toml = "[[mesh]]\nfile = \"a.glb\"\nname = \"twin\"\ninstances = [[0, 0, 0], [0, 0, 7]]\n\
                materials = { paint = \"lamp\" }\n";
    fs::write(dir.path().join("s.toml"), toml).unwrap();
    let scene = open(&dir.path().join("s.toml"));
    assert_eq!(scene.triangle_count(), 24);
    assert_eq!(scene.object_name(3), "twin/parent/1");
    assert_eq!(scene.materials.len(), 1);
    let (a, b) = (triangles(&scene), triangles(&alone));
    assert_eq!(a[2].corners[0][2], b[0].corners[0][2] + 7.0);
}

#[test]
fn it_agrees_with_the_crate_gltf() {
    let (model, ..) = everything();
    let dir = TempDir::new().unwrap();
    let path = model.save(dir.path(), "a.glb");
    let theirs = gltf::Gltf::open(&path).unwrap();
    let blob = theirs.blob.clone().unwrap();
    let scene = open(&path);
    let ours = triangles(&scene);
    let mut n = 0;
    let mut stack: Vec<(gltf::Node<'_>, glam::Mat4)> =
        theirs.default_scene().unwrap().nodes().map(|n| (n, glam::Mat4::IDENTITY)).collect();
    stack.reverse();
    while let Some((node, above)) = stack.pop() {
        let world = above * glam::Mat4::from_cols_array_2d(&node.transform().matrix());
        for primitive in node.mesh().iter().flat_map(|m| m.primitives()) {
            if primitive.mode() != gltf::mesh::Mode::Triangles {
                n += if primitive.mode() == gltf::mesh::Mode::Lines { 0 } else { 2 };
                continue;
            }
            let reader = primitive.reader(|_| Some(&blob));
            let points: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
            let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
            for t in indices.chunks_exact(3) {
                // The child is mirrored, hence turned over.
                let order = if world.determinant() < 0.0 { [0, 2, 1] } else { [0, 1, 2] };
                for (corner, k) in ours[n].corners.iter().zip(order) {
                    let p = world.transform_point3(glam::Vec3::from_array(points[t[k] as usize]));
                    assert_eq!(*corner, [p.x, -p.z + 0.0, p.y]);
                }
                n += 1;
            }
        }
        let mut children: Vec<_> = node.children().map(|c| (c, world)).collect();
        children.reverse();
        stack.extend(children);
    }
    assert_eq!(n, ours.len());
}

#[test]
fn strided_sparse_and_quantised_positions() {
    let dir = TempDir::new().unwrap();
    // Strided: 20 bytes a vertex, the last one without its padding.
    let mut m = Model::new();
    let mut bytes = Vec::new();
    for (i, p) in QUAD[..3].iter().enumerate() {
        bytes.extend(p.iter().flat_map(|v| v.to_le_bytes()));
        if i < 2 {
            bytes.extend([0xff; 8]);
        }
    }
    let view = m.view(&bytes);
    m.json["bufferViews"][view]["byteStride"] = json!(20);
    let a = m.push(
        "accessors",
        json!({"bufferView": view, "componentType": 5126, "count": 3, "type": "VEC3"}),
    );
    let mesh = m.mesh(json!([{"attributes": {"POSITION": a}}]));
    m.node(json!({"mesh": mesh}));
    // Sparse: nothing but zeros, of which two are replaced.
    let at = m.view(&[1, 2]);
    let values: Vec<u8> =
        [1.0f32, 0., 0., 0., 1., 0.].iter().flat_map(|v| v.to_le_bytes()).collect();
    let values = m.view(&values);
    let a = m.push(
        "accessors",
        json!({"componentType": 5126, "count": 3, "type": "VEC3", "sparse": {"count": 2,
            "indices": {"bufferView": at, "componentType": 5121}, "values": {"bufferView": values}}}),
    );
    let mesh = m.mesh(json!([{"attributes": {"POSITION": a}}]));
    m.node(json!({"mesh": mesh}));
    // Quantised: i16 normalised, u8 plain.
    let shorts: Vec<u8> =
        [0i16, 0, 0, 32767, 0, 0, 0, -32768, 0].iter().flat_map(|v| v.to_le_bytes()).collect();
    let view = m.view(&shorts);
    let a = m.push(
        "accessors",
        json!({"bufferView": view, "componentType": 5122, "normalized": true, "count": 3,
               "type": "VEC3"}),
    );
    let mesh = m.mesh(json!([{"attributes": {"POSITION": a}}]));
    m.node(json!({"mesh": mesh}));
    let view = m.view(&[0, 0, 0, 0, 255, 0, 0, 0, 0, 0, 7, 0]);
    m.json["bufferViews"][view]["byteStride"] = json!(4);
    let a = m.push(
        "accessors",
        json!({"bufferView": view, "componentType": 5121, "count": 3, "type": "VEC3"}),
    );
    let mesh = m.mesh(json!([{"attributes": {"POSITION": a}}]));
    m.node(json!({"mesh": mesh}));
    m.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    let all = triangles(&open(&m.save(dir.path(), "a.glb")));
    let turned = |p: [f32; 3]| [p[0], -p[2] + 0.0, p[1]];
    assert_eq!(all[0].corners, [QUAD[0], QUAD[1], QUAD[2]].map(turned));
    assert_eq!(all[1].corners, [[0.; 3], [1., 0., 0.], [0., 0., 1.]]);
    assert_eq!(all[2].corners, [[0.; 3], [1., 0., 0.], [0., 0., -1.]]);
    assert_eq!(all[3].corners, [[0.; 3], [255., 0., 0.], [0., -7., 0.]]);
}

#[test]
fn materials_as_photons_see_them() {
    let mut m = Model::new();
    for (name, material) in [
        (
            "plain",
            json!({"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.4, 0.3, 0.5], "metallicFactor": 0}}),
        ),
        (
            "mirror",
            json!({"pbrMetallicRoughness": {"baseColorFactor": [0.9, 0.8, 0.7, 1], "roughnessFactor": 0.05}}),
        ),
        (
            "brushed",
            json!({"pbrMetallicRoughness": {"baseColorFactor": [0.9, 0.8, 0.7, 1], "roughnessFactor": 0.4}}),
        ),
        (
            "pane",
            json!({"alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 0.25]}}),
        ),
        (
            "glass",
            json!({"pbrMetallicRoughness": {"baseColorFactor": [0.75, 1, 1, 1]},
            "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1.0}, "KHR_materials_ior": {"ior": 1.25}}}),
        ),
        (
            "picture",
            json!({"pbrMetallicRoughness": {"metallicFactor": 0, "baseColorTexture": {"index": 0}}}),
        ),
        (
            "glow",
            json!({"emissiveFactor": [1, 0.5, 0], "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1]}}),
        ),
        ("plain", json!({"pbrMetallicRoughness": {"baseColorFactor": [0.25, 0.25, 0.25, 1]}})),
        (
            "plastic",
            json!({"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 0.5, 1], "metallicFactor": 0, "roughnessFactor": 0.5}}),
        ),
        (
            "solid",
            json!({"extensions": {"KHR_materials_transmission": {"transmissionFactor": 1.0},
            "KHR_materials_volume": {"thicknessFactor": 0.1, "attenuationDistance": 0.1, "attenuationColor": [0.5, 1, 1]}}}),
        ),
    ] {
        let mut material = material;
        material["name"] = json!(name);
        m.push("materials", material);
    }
    let quad = m.positions(&QUAD);
    let primitives: Vec<Value> = (0..10)
        .map(|i| json!({"attributes": {"POSITION": quad}, "mode": 6, "material": i}))
        .chain([json!({"attributes": {"POSITION": quad}, "mode": 6})])
        .collect();
    let mesh = m.mesh(json!(primitives));
    m.node(json!({"name": "all", "mesh": mesh}));
    let dir = TempDir::new().unwrap();
    let scene = open(&m.save(dir.path(), "a.gltf"));
    let of: BTreeMap<_, _> = scene.materials.iter().map(|m| (m.name.as_str(), m.record)).collect();
    assert_eq!(of["plain"].diffuse, [0.5, 0.4, 0.3]);
    assert_eq!((of["mirror"].specular, of["mirror"].diffuse), ([0.9, 0.8, 0.7], [0.0; 3]));
    assert_eq!((of["mirror"].roughness, of["mirror"].flags), (0.0025, MATERIAL_GLOSS));
    assert_eq!((of["brushed"].specular, of["brushed"].diffuse), ([0.9, 0.8, 0.7], [0.0; 3]));
    assert_eq!((of["brushed"].roughness, of["brushed"].flags), (0.16, MATERIAL_GLOSS));
    let plastic = of["plastic"];
    assert_eq!((plastic.specular, plastic.diffuse), ([0.04; 3], [0.5, 0.25, 0.5]));
    let solid = of["solid"];
    assert_eq!(solid.flags, MATERIAL_SOLID | MATERIAL_SEE_THROUGH);
    assert_eq!((solid.transmission, solid.index), ([1.0; 3], 1.5));
    assert!((solid.absorption[0] - 10.0 * 2f32.ln()).abs() < 1e-5, "{:?}", solid.absorption);
    assert_eq!(solid.absorption[1], 0.0);
    assert_eq!((of["pane"].diffuse, of["pane"].transmission), ([0.125; 3], [0.75; 3]));
    assert_eq!((of["pane"].index, of["pane"].flags), (1.5, MATERIAL_SEE_THROUGH));
    assert_eq!((of["glass"].transmission, of["glass"].index), ([0.75, 1., 1.], 1.25));
    assert_eq!(of["glass"].diffuse, [0.0; 3]);
    assert_eq!(of["picture"].diffuse, [0.5; 3]);
    let glow = of["glow"].emission.map(f64::from);
    assert!((glow[0] - 1.0 / 179.0).abs() < 1e-9 && (glow[1] * 2.0 - glow[0]).abs() < 1e-9);
    assert_eq!(of["plain (7)"].diffuse, [0.25; 3]);
    assert_eq!(of["unnamed"].diffuse, [0.7; 3]);
    let text = scene.warnings.join("\n");
    assert!(text.contains("1 textures are missing"), "{text}");
    assert!(text.contains("some faces have no material"), "{text}");
    let strict = LoadOptions { strict: true, ..LoadOptions::default() };
    assert!(load(&dir.path().join("a.gltf"), &strict).is_err());
    // One nit of luminance is one lumen per square metre and steradian: pi times area lumens a light.
    let lights = scene.lights().unwrap();
    let [r, g, b] = lights.records[0].flux_w.map(f64::from);
    let lumens = 179.0 * (0.2126 * r + 0.7152 * g + 0.0722 * b);
    let expected = PI * f64::from(lights.records[0].area_m2) * (0.2126 + 0.7152 * 0.5);
    assert!((lumens / expected - 1.0).abs() < 1e-6, "{lumens} {expected}");
}

#[test]
fn lights_cameras_and_rooms() {
    let mut m = Model::new();
    let quad = m.positions(&QUAD);
    let mesh = m.mesh(json!([{"attributes": {"POSITION": quad}, "mode": 6}]));
    let cube: Vec<[f32; 3]> =
        (0..8).map(|i| [(i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2 & 1) as f32]).collect();
    let cube = m.positions(&cube);
    let cube = m.mesh(json!([{"attributes": {"POSITION": cube}}]));
    m.json["extensions"] = json!({"KHR_lights_punctual": {"lights": [
        {"type": "point", "name": "bulb", "intensity": 179.0, "color": [1.0, 0.5, 0.25]},
        {"type": "spot", "name": "stage", "intensity": 179.0, "spot": {"innerConeAngle": 0.5, "outerConeAngle": 1.0}},
        {"type": "spot", "name": "plain", "intensity": 358.0, "spot": {}},
        {"type": "directional", "intensity": 3.0},
        {"type": "point", "intensity": 0.0},
    ]}});
    let light = |i: usize| json!({"KHR_lights_punctual": {"light": i}});
    m.node(json!({"name": "wall", "mesh": mesh}));
    m.node(json!({"name": "lamp", "translation": [1.0, 2.0, 3.0], "extensions": light(0)}));
    // Turned by -90 degrees about x, and stretched: it points down, along -y.
    let half = 0.5f64.sqrt();
    m.node(json!({"name": "spotty", "translation": [0.0, 3.0, 0.0], "rotation": [-half, 0.0, 0.0, half],
        "scale": [1.0, 2.0, 3.0], "extensions": light(1)}));
    m.node(json!({"name": "along -z", "extensions": light(2)}));
    m.node(json!({"name": "sun", "extensions": light(3)}));
    m.node(json!({"name": "off", "extensions": light(4)}));
    let camera = m.push(
        "cameras",
        json!({"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}),
    );
    let flat = m.push(
        "cameras",
        json!({"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "zfar": 9, "znear": 0}}),
    );
    m.node(json!({"name": "eye", "camera": camera, "translation": [0.0, 1.5, 4.0]}));
    // Looking down, along its -z turned by -90 degrees about x.
    m.node(json!({"name": "a/b", "camera": camera, "rotation": [-half, 0.0, 0.0, half]}));
    m.node(json!({"name": "a/b", "camera": camera}));
    m.node(json!({"name": "plan", "camera": flat}));
    m.node(json!({"name": "Room: Hall", "mesh": cube, "scale": [4.0, 2.5, 3.0], "translation": [1.0, 0.0, 0.0]}));
    m.node(json!({"name": "zone", "mesh": cube, "extras": {"room": "Bath"}}));
    m.node(json!({"name": "IfcSpace/1/empty"}));
    let dir = TempDir::new().unwrap();
    let scene = open(&m.save(dir.path(), "a.glb"));
    // Rooms are no geometry.
    assert_eq!((scene.triangle_count(), scene.object_count()), (2, 1));
    let hints: Vec<_> = scene.hints.iter().map(|h| (h.name.as_str(), h.min, h.max)).collect();
    assert_eq!(
        hints,
        [("Hall", [1., -3., 0.], [5., 0., 2.5]), ("Bath", [0., -1., 0.], [1., 0., 1.])]
    );
    let lights = scene.lights().unwrap();
    assert_eq!(lights.names, ["bulb", "stage", "plain"]);
    let stage = lights.records[1];
    assert_eq!((stage.kind, stage.position[0]), (LIGHT_SPOT, 0.));
    // A hair below: it points down.
    assert!((2.9999..3.0).contains(&stage.position[2]), "{:?}", stage.position);
    let (inner, outer) = (0.5f64.cos(), 1f64.cos());
    assert_eq!(stage.cone, [inner as f32, outer as f32]);
    assert!(stage.axis[2] < -0.999_999, "{:?}", stage.axis);
    let sr = 2.0 * PI * (1.0 - inner + (inner - outer) / 3.0);
    assert!(stage.flux_w.iter().all(|&w| (f64::from(w) / sr - 1.0).abs() < 1e-6));
    let plain = lights.records[2];
    // glTF's -z is y here; 0 and 45 degrees.
    assert_eq!((plain.axis, plain.cone), ([0., 1., 0.], [1.0, 0.5f64.sqrt() as f32]));
    assert!((f64::from(plain.flux_w[0]) - 4.0 * PI * (1.0 - 0.5f64.sqrt()) / 3.0).abs() < 1e-6);
    assert_eq!((lights.records[0].kind, lights.records[0].position), (LIGHT_POINT, [1., -3., 2.]));
    for (w, share) in lights.records[0].flux_w.into_iter().zip([1.0, 0.5, 0.25]) {
        assert!((f64::from(w) - 4.0 * PI * share).abs() < 1e-5, "{w}");
    }
    let names: Vec<_> = scene.views.iter().map(|v| v.name.as_str()).collect();
    assert_eq!(names, ["eye", "a_b", "a_b-2"]);
    let eye = scene.views[0].record;
    assert_eq!((eye.eye, eye.target, eye.up), ([0., -4., 1.5], [0., -3., 1.5], [0., 0., 1.]));
    assert!((f64::from(eye.fov_degrees) - 1f64.to_degrees()).abs() < 1e-5);
    let down = scene.views[1].record;
    assert!(down.target[2] < -0.999_999 && down.up[1] > 0.999_999, "{down:?}");
    let text = scene.warnings.join("\n");
    for word in ["directional light \"sun\"", "camera \"plan\"", "\"IfcSpace/1/empty\" has no mesh"]
    {
        assert!(text.contains(word), "{word}: {text}");
    }
}

#[test]
fn rooms_with_footprints_in_a_scene_file() {
    let dir = TempDir::new().unwrap();
    fs::write(dir.path().join("a.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let head = "[[mesh]]\nfile = \"a.obj\"\n[[room]]\n";
    let path = dir.path().join("s.toml");
    fs::write(&path, format!("{head}name = \"L\"\npolygon = [[0, 0], [0, 2], [1, 2], [1, 1], [2, 1], [2, 0]]\nz = [0, 2.5]\n")).unwrap();
    let scene = open(&path);
    assert_eq!(scene.hints[0].name, "L");
    assert_eq!((scene.hints[0].min, scene.hints[0].max), ([0.; 3], [2., 2., 2.5]));
    assert_eq!(
        scene.hints[0].polygon,
        [[2., 0.], [2., 1.], [1., 1.], [1., 2.], [0., 2.], [0., 0.]]
    );
    // Solids of an OBJ file: a box, and nothing.
    let cube = "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nv 0 0 3\nv 2 0 3\nv 2 1 3\nv 0 1 3\no cell\n\
                f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\no flat\nf 1 2 3\n";
    fs::write(dir.path().join("rooms.obj"), cube).unwrap();
    fs::write(&path, format!("{head}file = \"rooms.obj\"\n")).unwrap();
    let scene = open(&path);
    assert_eq!((scene.hints.len(), scene.triangle_count(), scene.inputs.len()), (1, 1, 3));
    assert_eq!((scene.hints[0].name.as_str(), scene.hints[0].max), ("cell", [2., 1., 3.]));
    assert!(scene.warnings.iter().any(|w| w.contains("\"flat\" has no volume")));
    for (room, word) in [
        ("file = \"rooms.obj\"\nname = \"x\"\n", "give the file alone"),
        ("file = \"rooms.glb\"\n", "no OBJ"),
        ("file = \"a.obj\"\n", "without rooms"),
        ("min = [0, 0, 0]\n", "neither a box nor a footprint"),
        ("polygon = [[0, 0], [1, 0], [0, 1]]\n", "neither a box nor a footprint"),
        ("polygon = [[0, 0], [1, 0]]\nz = [0, 1]\n", "three corners"),
        ("polygon = [[0, 0], [1, 1], [1, 0], [0, 1.5]]\nz = [0, 1]\n", "crosses itself"),
    ] {
        fs::write(&path, format!("{head}{room}")).unwrap();
        let error = error(&path);
        assert!(error.contains("s.toml:3: ") && error.contains(word), "{error}");
    }
}

#[test]
fn bad_files_say_what_is_wrong() {
    let dir = TempDir::new().unwrap();
    let (good, ..) = everything();
    let path = good.save(dir.path(), "a.glb");
    let bytes = fs::read(&path).unwrap();
    for (change, word) in [
        (bytes[..bytes.len() - 8].to_vec(), "its header says"),
        ([&bytes[..4], &[1][..], &bytes[5..]].concat(), "GLB version 1"),
        ([&bytes[..8], &[0, 0, 0, 0], &bytes[12..]].concat(), "no JSON chunk"),
        ([&bytes[..12], &[255; 4], &bytes[16..]].concat(), "a chunk at byte 12"),
        (b"glTF".to_vec(), "a.glb: its JSON"),
    ] {
        fs::write(&path, change).unwrap();
        let error = error(&path);
        assert!(
            error.contains(word) || (word.contains("JSON") && error.contains(":1:")),
            "{error}"
        );
    }
    let with = |edit: &dyn Fn(&mut Value)| {
        let (mut m, ..) = everything();
        edit(&mut m.json);
        error(&m.save(dir.path(), "b.gltf"))
    };
    let huge: u64 = 1 << 60;
    type Edit<'a> = &'a dyn Fn(&mut Value);
    let cases: [(Edit<'_>, &str); 16] = [
        (&|j| j["asset"]["version"] = json!("1.0"), "version \"1.0\""),
        (&|j| j["accessors"][0]["count"] = json!(huge), "mesh 0 uses"),
        (&|j| j["accessors"][0]["count"] = json!(5), "accessor 0 has 5 elements beyond"),
        (&|j| j["accessors"][1]["byteOffset"] = json!(u64::MAX), "accessor 1"),
        (&|j| j["accessors"][0]["bufferView"] = json!(99), "accessor 0"),
        (&|j| j["bufferViews"][0]["byteLength"] = json!(u64::MAX), "accessor 0"),
        (&|j| j["bufferViews"][0]["byteStride"] = json!(1), "accessor 0"),
        (&|j| j["accessors"][0]["componentType"] = json!(1), "component type 1"),
        (&|j| j["accessors"][0]["type"] = json!("MAT4"), "\"MAT4\""),
        (&|j| j["meshes"][0]["primitives"][0]["attributes"] = json!({}), "no POSITION"),
        (
            &|j| j["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(77),
            "no accessor 77",
        ),
        (&|j| j["meshes"][0]["primitives"][0]["material"] = json!(9), "uses material 9"),
        (&|j| j["nodes"][0]["children"] = json!([0]), "node 0 is placed twice"),
        (&|j| j["nodes"][0]["mesh"] = json!(5), "no mesh 5"),
        (&|j| j["nodes"][0]["rotation"] = json!([0, 0, 0, 0]), "node 0 is not finite"),
        (&|j| j["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]), "draco"),
    ];
    for (edit, word) in cases {
        let error = with(edit);
        assert!(error.contains("b.gltf") && error.contains(word), "{word}: {error}");
    }
    // A list of indices that reaches too far, and sparse zeros that no file could hold.
    let error = with(&|j| {
        j["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(4);
        let view = j["accessors"][0]["bufferView"].clone();
        let few = json!({"bufferView": view, "componentType": 5126, "count": 2, "type": "VEC3"});
        j["accessors"].as_array_mut().unwrap().push(few);
    });
    assert!(error.contains("mesh 0, primitive 0 uses vertex 2 of 2"), "{error}");
    let error = with(&|j| {
        let sparse = json!({"count": 1, "indices": {"bufferView": 1, "componentType": 5121}, "values": {"bufferView": 0}});
        j["accessors"][0] =
            json!({"componentType": 5126, "count": 20_000, "type": "VEC3", "sparse": sparse});
    });
    assert!(error.contains("beyond its buffer"), "{error}");
    // 48 million triangles from 20,000 vertices: no file is meant like that.
    let mut m = Model::new();
    let quad = m.positions(&[QUAD[1]; 20_000]);
    let one = json!({"attributes": {"POSITION": quad}, "mode": 6});
    let mesh = m.mesh(json!(vec![one; 2400]));
    m.node(json!({"mesh": mesh}));
    m.save(dir.path(), "d.glb");
    let error = error_of(&dir, "d.glb");
    assert!(error.contains("mesh 0 uses the same elements over and over"), "{error}");
    fs::write(dir.path().join("c.gltf"), "{\n\"asset\": {\"version\": 2.0}\n}").unwrap();
    assert!(error_of(&dir, "c.gltf").contains("c.gltf:2: "));
    fs::remove_file(dir.path().join("its buffer.bin")).unwrap();
    assert!(error_of(&dir, "b.gltf").contains("\"its%20buffer.bin\" is missing"));
}

fn error_of(dir: &TempDir, name: &str) -> String {
    error(&dir.path().join(name))
}

/// Reads whatever it is.
fn survives(path: &Path) {
    if let Ok(scene) = load(path, &LoadOptions::default()) {
        let mut n = 0;
        scene
            .for_each_triangle(|t| {
                assert!(t.corners.as_flattened().iter().all(|v| v.is_finite()));
                n += 1;
            })
            .unwrap();
        assert_eq!(n, scene.triangle_count());
        scene.lights().unwrap();
    }
}

/// Numbers that files should not have, in the place of the `n`th one.
fn with_number(value: &mut Value, n: &mut usize, with: &Value) {
    match value {
        Value::Array(list) => list.iter_mut().for_each(|v| with_number(v, n, with)),
        Value::Object(map) => map.values_mut().for_each(|v| with_number(v, n, with)),
        Value::Number(_) | Value::String(_) => {
            if *n == 0 {
                *value = with.clone();
            }
            *n = n.wrapping_sub(1);
        }
        _ => {}
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, failure_persistence: None, ..Default::default() })]

    #[test]
    fn damaged_bytes_never_panic(
        changes in proptest::collection::vec((0.0..1.0f64, any::<u8>()), 1..8),
        cut in proptest::option::of(0.0..1.0f64),
        binary in any::<bool>(),
    ) {
        let dir = TempDir::new().unwrap();
        let (model, ..) = everything();
        let path = model.save(dir.path(), if binary { "a.glb" } else { "data.gltf" });
        let mut bytes = fs::read(&path).unwrap();
        for (place, with) in changes {
            let at = (place * bytes.len() as f64) as usize;
            bytes[at] = with;
        }
        if let Some(cut) = cut {
            bytes.truncate((cut * bytes.len() as f64) as usize);
        }
        fs::write(&path, bytes).unwrap();
        survives(&path);
    }

    #[test]
    fn wrong_numbers_never_panic(
        changes in proptest::collection::vec((0..120usize, 0..14usize), 1..4),
    ) {
        let wrong = [
            json!(0), json!(1), json!(2), json!(3), json!(7), json!(255), json!(-1), json!(1e300), json!(0.5),
            json!(u64::MAX), json!(u32::MAX), json!(5121), json!("x"), json!([]),
        ];
        let (mut model, ..) = everything();
        for (n, with) in changes {
            with_number(&mut model.json, &mut { n }, &wrong[with]);
        }
        let dir = TempDir::new().unwrap();
        survives(&model.save(dir.path(), "a.glb"));
    }
}
