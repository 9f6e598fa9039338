//! Textures from OBJ and glTF files: the right picture at the right corners.

use enf_layout::NONE;
use enf_layout::texture::{TEXTURE_CLAMP_X, TEXTURE_MIRROR_Y};
use enf_scene::{LoadOptions, Scene, Spool, load};
use std::{fs, fs::File, path::Path};
use tempfile::TempDir;

/// 32 x 16, the left half (200, 40, 30), the right half (20, 60, 220).
const JPEG: &str = "\
/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDAAIBAQEBAQIBAQECAgICAgQDAgICAgUEBAMEBgUGBgYFBgYGBwkIBgcJBwYGCAsICQoKCgoKBggLDA\
sKDAkKCgr/2wBDAQICAgICAgUDAwUKBwYHCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgoKCgr/wAARCAAQ\
ACADAREAAhEBAxEB/8QAHwAAAQUBAQEBAQEAAAAAAAAAAAECAwQFBgcICQoL/8QAtRAAAgEDAwIEAwUFBAQAAAF9AQIDAAQRBRIhMUEGE1FhBy\
JxFDKBkaEII0KxwRVS0fAkM2JyggkKFhcYGRolJicoKSo0NTY3ODk6Q0RFRkdISUpTVFVWV1hZWmNkZWZnaGlqc3R1dnd4eXqDhIWGh4iJipKT\
lJWWl5iZmqKjpKWmp6ipqrKztLW2t7i5usLDxMXGx8jJytLT1NXW19jZ2uHi4+Tl5ufo6erx8vP09fb3+Pn6/8QAHwEAAwEBAQEBAQEBAQAAAA\
AAAAECAwQFBgcICQoL/8QAtREAAgECBAQDBAcFBAQAAQJ3AAECAxEEBSExBhJBUQdhcRMiMoEIFEKRobHBCSMzUvAVYnLRChYkNOEl8RcYGRom\
JygpKjU2Nzg5OkNERUZHSElKU1RVVldYWVpjZGVmZ2hpanN0dXZ3eHl6goOEhYaHiImKkpOUlZaXmJmaoqOkpaanqKmqsrO0tba3uLm6wsPExc\
bHyMnK0tPU1dbX2Nna4uPk5ebn6Onq8vP09fb3+Pn6/9oADAMBAAIRAxEAPwD5br+fz/UQKAPK6/3cP8NwoA9Ur/CM/wByAoA8rr/dw/w3CgD/\
2Q==\
";

fn jpeg() -> Vec<u8> {
    let code = |c: u8| match c {
        b'A'..=b'Z' => c - b'A',
        b'a'..=b'z' => c - b'a' + 26,
        b'0'..=b'9' => c - b'0' + 52,
        b'+' => 62,
        _ => 63,
    };
    let mut out = Vec::new();
    let (mut bits, mut count) = (0u32, 0);
    for c in JPEG.bytes().filter(|&c| c != b'=') {
        bits = bits << 6 | u32::from(code(c));
        count += 6;
        if count >= 8 {
            count -= 8;
            out.push((bits >> count) as u8);
        }
    }
    out
}

fn png(path: &Path, width: u32, rgb: &[u8]) {
    let height = rgb.len() as u32 / 3 / width;
    let mut encoder = png::Encoder::new(File::create(path).unwrap(), width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().unwrap().write_image_data(rgb).unwrap();
}

fn open(path: &Path) -> Scene {
    load(path, &LoadOptions::default()).unwrap()
}

type Corners = [[f32; 2]; 3];

fn coordinates(scene: &Scene) -> Vec<Option<Corners>> {
    let mut out = Vec::new();
    scene.for_each_triangle(|t| out.push(t.coordinates)).unwrap();
    out
}

const OBJ: &str = "mtllib a.mtl\nvt 9 9\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 2 0\nvt 2 1\nvt 0 1\n\
    usemtl wall\nf 1/2 2/3 3/4 4/5\nf 1/-4/1 2/-3/1 3/-2/1\nf 1 2 3\nf 1//1 2//1 3//1\nf 1/2 2/99 3/4\n\
    usemtl plain\nf 1/2 2/3 3/4\n";

#[test]
fn obj_corners_have_their_coordinates() {
    let dir = TempDir::new().unwrap();
    png(&dir.path().join("a b.png"), 2, &[255, 0, 0, 0, 0, 255]);
    let mtl = "newmtl wall\nKd 0.5 0.5 0.5\nmap_Kd -clamp on a b.png\nnewmtl plain\nKd 0.5 0.5 0.5\n\
               newmtl black\nKd 0 0 0\nmap_Kd a b.png\n";
    fs::write(dir.path().join("a.mtl"), mtl).unwrap();
    let path = dir.path().join("a.obj");
    fs::write(&path, OBJ).unwrap();
    let scene = open(&path);
    let first = Some([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]]);
    let second = Some([[0.0, 0.0], [2.0, 1.0], [0.0, 1.0]]);
    assert_eq!(coordinates(&scene), [first, second, first, None, None, None, None]);
    let wall = scene.materials.iter().find(|m| m.name == "wall").unwrap().record;
    assert_eq!((wall.texture, wall.diffuse), (0, [0.5; 3]));
    let plain = scene.materials.iter().find(|m| m.name == "plain").unwrap().record;
    assert_eq!(plain.texture, NONE);
    let texture = &scene.textures[0];
    assert_eq!((texture.size(), texture.flags & TEXTURE_CLAMP_X), ([2, 1], TEXTURE_CLAMP_X));
    // v points up in OBJ.
    assert_eq!(texture.place, [[1.0, 0.0, 0.0], [0.0, -1.0, 1.0]]);
    assert!(scene.inputs.iter().any(|i| i.path.ends_with("a b.png")), "a picture is an input");
    assert!(scene.warnings.iter().all(|w| !w.contains("texture")), "{:?}", scene.warnings);

    // Spooled, it is the same.
    let spool = Some(Spool { folder: dir.path().into(), above: 0 });
    let spooled = load(&path, &LoadOptions { spool, ..LoadOptions::default() }).unwrap();
    assert_eq!(coordinates(&spooled), coordinates(&scene));

    // A mirrored instance is turned over: its corners are in another order, and so are their coordinates.
    let toml = dir.path().join("a.toml");
    let text = "[[mesh]]\nfile = \"a.obj\"\ninstances = [[0, 0, 0, 0, -1, 1, 1]]\n\
                [[material]]\nname = \"plain\"\nkd = 0.1\n";
    fs::write(&toml, text).unwrap();
    let mirrored = open(&toml);
    assert_eq!(coordinates(&mirrored)[0], Some([[0.0, 0.0], [2.0, 1.0], [2.0, 0.0]]));

    // A black Kd below a picture means the picture.
    fs::write(&path, OBJ.replace("usemtl wall", "usemtl black")).unwrap();
    assert_eq!(open(&path).materials[0].record.diffuse, [1.0; 3]);
}

#[test]
fn pictures_that_are_not_there_or_not_read_are_said() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.obj");
    fs::write(&path, OBJ).unwrap();
    fs::write(dir.path().join("old.bmp"), b"BM............").unwrap();
    for picture in ["gone.png", "old.bmp"] {
        let mtl =
            format!("newmtl wall\nKd 0.5 0.5 0.5\nmap_Kd {picture}\nnewmtl plain\nKd 1 1 1\n");
        fs::write(dir.path().join("a.mtl"), mtl).unwrap();
        let scene = open(&path);
        assert!(scene.textures.is_empty());
        assert_eq!(
            (scene.materials[0].record.texture, scene.materials[0].record.diffuse[0]),
            (NONE, 0.5)
        );
        let text = scene.warnings.join("\n");
        assert!(text.contains(picture) && text.contains("1 textures"), "{text}");
        let error =
            load(&path, &LoadOptions { strict: true, ..LoadOptions::default() }).unwrap_err();
        assert!(error.to_string().contains(picture), "{error}");
    }
    // A damaged one is no reason to go on.
    fs::write(dir.path().join("a.mtl"), "newmtl wall\nmap_Kd cut.png\n").unwrap();
    fs::write(dir.path().join("cut.png"), b"\x89PNG\r\n\x1a\n1234").unwrap();
    let error = load(&path, &LoadOptions::default()).unwrap_err();
    assert!(error.exit_code() == 4 && error.to_string().contains("cut.png"), "{error}");
    fs::write(dir.path().join("a.mtl"), "newmtl wall\nmap_Kd -s 1 2\n").unwrap();
    let error = load(&path, &LoadOptions::default()).unwrap_err();
    assert!(error.to_string().contains("a.mtl:2"), "{error}");
}

#[test]
fn jpeg_within_glb() {
    let mut bin: Vec<u8> = Vec::new();
    let points = [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    bin.extend(points.as_flattened().iter().flat_map(|v| v.to_le_bytes()));
    // Normalised shorts.
    let places: [[u16; 2]; 4] = [[0, 65535], [65535, 65535], [65535, 0], [0, 0]];
    bin.extend(places.as_flattened().iter().flat_map(|v| v.to_le_bytes()));
    let picture = jpeg();
    bin.extend(&picture);
    while !bin.len().is_multiple_of(4) {
        bin.push(0);
    }
    let json = serde_json::json!({
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": bin.len()}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 16},
            {"buffer": 0, "byteOffset": 64, "byteLength": picture.len()}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 4, "type": "VEC2", "normalized": true}],
        "images": [{"bufferView": 2, "mimeType": "image/jpeg"}],
        "samplers": [{"wrapS": 33071, "wrapT": 33648}],
        "textures": [{"source": 0, "sampler": 0}],
        "materials": [{"name": "wall", "pbrMetallicRoughness": {"metallicFactor": 0,
            "baseColorFactor": [0.5, 1, 1, 1], "baseColorTexture": {"index": 0, "extensions":
                {"KHR_texture_transform": {"scale": [2, 3], "offset": [0.25, 0.5]}}}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "mode": 6,
            "material": 0}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    });
    let mut text = serde_json::to_vec(&json).unwrap();
    while !text.len().is_multiple_of(4) {
        text.push(b' ');
    }
    let mut glb = b"glTF\x02\0\0\0".to_vec();
    glb.extend(((28 + text.len() + bin.len()) as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &bin)] {
        glb.extend((chunk.len() as u32).to_le_bytes());
        glb.extend(kind);
        glb.extend(chunk);
    }
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.glb");
    fs::write(&path, glb).unwrap();
    let scene = open(&path);
    assert_eq!(scene.materials[0].record.diffuse, [0.5, 1.0, 1.0]);
    let all = coordinates(&scene);
    assert_eq!(all.len(), 2);
    assert!(all.iter().flatten().flatten().any(|c| *c == [1.0, 0.0]), "{all:?}");
    let texture = &scene.textures[0];
    assert_eq!(texture.flags, TEXTURE_CLAMP_X | TEXTURE_MIRROR_Y);
    assert_eq!(texture.place, [[2.0, 0.0, 0.25], [0.0, 3.0, 0.5]]);
    assert_eq!(texture.size(), [32, 16]);
    let whole = texture.decode(0).unwrap();
    let near = |a: [u8; 3], b: [u8; 3]| a.iter().zip(b).all(|(a, b)| a.abs_diff(b) <= 4);
    assert!(near(whole.texels[2 * 32 + 3], [200, 40, 30]), "{:?}", whole.texels[2 * 32 + 3]);
    assert!(near(whole.texels[9 * 32 + 28], [20, 60, 220]), "{:?}", whole.texels[9 * 32 + 28]);
    let small = texture.decode(4).unwrap();
    assert_eq!((small.width, small.height), (2, 1));
    assert!(near(small.texels[0], [200, 40, 30]) && near(small.texels[1], [20, 60, 220]));
}
