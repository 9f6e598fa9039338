use std::collections::BTreeMap;
use std::path::PathBuf;

use enf_layout::light::LightRecord;
use enf_scene::LoadOptions;
use roxmltree::{Document, Node};

use super::*;

fn fixture(name: &str) -> Building {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes").join(name);
    Building::read(&path, &LoadOptions::default()).unwrap()
}

/// The value of an element's child of that name.
fn value<'a>(node: Node<'a, '_>, name: &str) -> &'a str {
    let child = node.children().find(|c| c.attribute("name") == Some(name));
    child.and_then(|c| c.attribute("value")).unwrap_or_else(|| panic!("{name} in {node:?}"))
}

fn numbers(text: &str) -> Vec<f64> {
    text.split([' ', ',']).filter(|t| !t.is_empty()).map(|n| n.parse().unwrap()).collect()
}

fn material(diffuse: [f32; 3], specular: [f32; 3]) -> MaterialRecord {
    MaterialRecord { diffuse, specular, ..MaterialRecord::BLACK }
}

/// The scene of a bsdf, and how much was said about it.
fn written(record: &MaterialRecord) -> (String, usize) {
    let mut said = Vec::new();
    let xml = bsdf(record, &Reflectance::Colour(record.diffuse), &mut said);
    Document::parse(&xml).unwrap();
    (xml, said.len())
}

#[test]
fn everything_parses_and_every_reference_is_there() {
    for name in ["box.toml", "two-rooms.toml", "gallery.toml", "washers.toml", "studio.toml"] {
        let folder = tempfile::tempdir().unwrap();
        let mut building = fixture(name);
        building.materials[0].0 = "a -- \"b\" <c> & d --> ".into();
        write(&building, &building.views, folder.path()).unwrap();
        let text = std::fs::read_to_string(folder.path().join("scene.xml")).unwrap();
        let scene = Document::parse(&text).unwrap();
        let ids: Vec<&str> = scene.descendants().filter_map(|n| n.attribute("id")).collect();
        for node in scene.descendants() {
            if node.has_tag_name("ref") {
                assert!(ids.iter().filter(|id| Some(**id) == node.attribute("id")).count() > 1);
            }
            if node.attribute("name") == Some("filename") {
                let file = folder.path().join(node.attribute("value").unwrap());
                assert!(file.exists(), "{file:?}");
            }
        }
        let triangles: usize = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|e| e.unwrap().path())
            .filter(|p| p.extension().is_some_and(|e| e == "ply"))
            .map(|p| faces(&std::fs::read(p).unwrap()))
            .sum();
        assert_eq!(triangles, building.triangles.len());
        for view in building.views.iter().filter(|v| shown(v).is_ok()) {
            let text = std::fs::read_to_string(folder.path().join(format!("{}.xml", view.name)));
            let text = text.unwrap();
            let view = Document::parse(&text).unwrap();
            assert_eq!(view.descendants().filter(|n| n.has_tag_name("sensor")).count(), 1);
        }
    }
}

fn faces(ply: &[u8]) -> usize {
    let head = String::from_utf8_lossy(&ply[..300.min(ply.len())]).into_owned();
    let line = head.lines().find(|l| l.starts_with("element face")).unwrap();
    line.rsplit(' ').next().unwrap().parse().unwrap()
}

#[test]
fn an_area_light_has_the_flux_that_the_scene_says() {
    let building = fixture("two-rooms.toml");
    let mut notes = Notes::default();
    let folder = tempfile::tempdir().unwrap();
    let text = scene(&building, folder.path(), &mut notes).unwrap();
    assert!(notes.0.is_empty(), "{notes:?}");
    let xml = Document::parse(&text).unwrap();
    let emitters: Vec<Node> = xml.descendants().filter(|n| n.has_tag_name("emitter")).collect();
    assert_eq!(emitters.len(), 1);
    assert_eq!(emitters[0].attribute("type"), Some("area"));
    let radiance = numbers(value(emitters[0], "radiance"));
    let luminance = 0.2126 * radiance[0] + 0.7152 * radiance[1] + 0.0722 * radiance[2];
    // 0.6 x 0.6 m of it, 3600 lm.
    let lumens = luminance * core::f64::consts::PI * 0.36 * 179.0;
    assert!((lumens - 3600.0).abs() < 0.05, "{lumens}");
}

/// Mitsuba's normals without vertex normals are (b - a) x (c - a), and `area` emits along them: as our fronts.
#[test]
fn only_the_front_of_the_lights_own_triangles_emits() {
    let building = crate::building::samples::lamp();
    let folder = tempfile::tempdir().unwrap();
    let text = scene(&building, folder.path(), &mut Notes::default()).unwrap();
    let xml = Document::parse(&text).unwrap();
    let shapes: Vec<Node> = xml.descendants().filter(|n| n.has_tag_name("shape")).collect();
    assert_eq!(shapes.len(), 2);
    for shape in shapes {
        assert_eq!(value(shape, "face_normals"), "true");
        let lit = shape.children().find(|c| c.has_tag_name("emitter"));
        let file = value(shape, "filename");
        assert_eq!(lit.is_some(), file == "m0-l0.ply");
        if let Some(lit) = lit {
            assert_eq!(numbers(value(lit, "radiance")), [5.0, 4.0, 3.0]);
        }
        let ply = std::fs::read(folder.path().join(file)).unwrap();
        let start = ply.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let read: Vec<f32> = ply[start..start + 36]
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
            .collect();
        let point = |i: usize| Vec3::from_slice(&read[3 * i..]);
        let normal = (point(1) - point(0)).cross(point(2) - point(0));
        assert!(normal.z < 0.0, "the lamp shines down: {normal}");
        assert_eq!(ply[start + 36], 3);
    }
}

fn lamp_of(record: LightRecord) -> Light {
    Light { name: "p".into(), record, emitters: Vec::new(), profile: None }
}

#[test]
fn points_and_spots_keep_their_flux() {
    let folder = tempfile::tempdir().unwrap();
    let mut notes = Notes::default();
    let flux = [4.0f32, 2.0, 1.0];
    let base = LightRecord { flux_w: flux, axis: [0.6, 0.0, -0.8], ..LightRecord::DARK };
    let mut emitted = |record| {
        let text = emitter(0, &lamp_of(record), folder.path(), &mut notes).unwrap();
        (text, notes.0.len())
    };
    let (text, said) = emitted(LightRecord { kind: LIGHT_POINT, ..base });
    let xml = Document::parse(&text).unwrap();
    let intensity = numbers(value(xml.root_element(), "intensity"));
    for c in 0..3 {
        assert!((intensity[c] * 4.0 * core::f64::consts::PI - f64::from(flux[c])).abs() < 1e-5);
    }
    assert_eq!(said, 0);

    let (text, said) = emitted(LightRecord { kind: LIGHT_POINT_LAMBERT, ..base });
    let xml = Document::parse(&text).unwrap();
    let radiance = xml.descendants().find(|n| n.attribute("name") == Some("radiance")).unwrap();
    let radiance = numbers(radiance.attribute("value").unwrap());
    let area = core::f64::consts::PI * 1e-6;
    assert!((radiance[0] * core::f64::consts::PI * area - 4.0).abs() < 1e-4);
    assert_eq!(said, 1);

    // A hard edge needs no texture: intensity times solid angle.
    let (text, _) = emitted(LightRecord { kind: LIGHT_SPOT, cone: [0.5, 0.5], ..base });
    let xml = Document::parse(&text).unwrap();
    let intensity = numbers(value(xml.root_element(), "intensity"));
    assert!((intensity[1] * core::f64::consts::PI - 2.0).abs() < 1e-5);
    assert!(
        (value(xml.root_element(), "cutoff_angle").parse::<f64>().unwrap() - 60.0).abs() < 1e-4
    );
    assert!(!text.contains("texture"));

    // A fading one: the texture, summed over the plane at distance 1 (solid angle = area cos^3), has the flux.
    let cone = [0.95, 0.8];
    let (text, said) = emitted(LightRecord { kind: LIGHT_SPOT, cone, ..base });
    assert_eq!(said, 1, "nothing more to say");
    let xml = Document::parse(&text).unwrap();
    let axial = numbers(value(xml.root_element(), "intensity"))[0];
    let pfm = std::fs::read(folder.path().join("l0.pfm")).unwrap();
    let side = INTENSITY_TEXELS as usize;
    let texels = &pfm[pfm.len() - side * side * 12..];
    let tan = (1.0f64 / 0.64 - 1.0).sqrt();
    let mut sum = 0.0;
    for (i, texel) in texels.chunks_exact(12).enumerate() {
        let at = |i: usize| (2.0 * (i as f64 + 0.5) / side as f64 - 1.0) * tan;
        let (x, y) = (at(i % side), at(i / side));
        let cos = 1.0 / (1.0 + x * x + y * y).sqrt();
        let texel = f64::from(f32::from_le_bytes(texel[..4].try_into().unwrap()));
        assert!(texel <= 1.0 + 1e-6);
        sum += texel * cos * cos * cos;
    }
    let steradians = sum * (2.0 * tan / side as f64).powi(2);
    assert!((steradians * axial / 4.0 - 1.0).abs() < 1e-3, "{}", steradians * axial);
}

#[test]
fn reflectances_are_kept() {
    let (xml, said) = written(&material([0.25, 0.5, 0.75], [0.0; 3]));
    assert!(xml.contains("type=\"twosided\"") && xml.contains("value=\"0.25 0.5 0.75\""), "{xml}");
    assert_eq!(said, 0);
    let (xml, said) = written(&material([0.0; 3], [0.5; 3]));
    assert!(
        xml.contains("\"conductor\"") && xml.contains("\"none\"") && xml.contains("0.5 0.5 0.5")
    );
    assert_eq!(said, 0);

    // What is blended, times its share, is what was asked for.
    let (kd, ks) = ([0.5, 0.25, 0.125], [0.125, 0.25, 0.375]);
    let (xml, said) = written(&material(kd, ks));
    assert_eq!(said, 0);
    let document = Document::parse(&xml).unwrap();
    let find = |name: &str| {
        let node = document.descendants().find(|n| n.attribute("name") == Some(name)).unwrap();
        numbers(node.attribute("value").unwrap())
    };
    let weight = find("weight")[0];
    let (diffuse, mirror) = (find("reflectance"), find("specular_reflectance"));
    for c in 0..3 {
        assert!((diffuse[c] * (1.0 - weight) - f64::from(kd[c])).abs() < 1e-6);
        assert!((mirror[c] * weight - f64::from(ks[c])).abs() < 1e-6);
        assert!(diffuse[c] <= 1.0 && mirror[c] <= 1.0);
    }
    // Red matter behind a blue mirror: no blend of two is both.
    assert_eq!(written(&material([0.9, 0.0, 0.0], [0.0, 0.0, 0.9])).1, 1);
}

#[test]
fn glass_and_gloss() {
    let f0 = |index: f64| ((index - 1.0) / (index + 1.0)).powi(2);
    let values = |xml: &str| -> BTreeMap<String, Vec<f64>> {
        let document = Document::parse(xml).unwrap();
        document
            .descendants()
            .filter(|n| n.has_tag_name("float") || n.has_tag_name("rgb"))
            .map(|n| {
                let of = |name| n.attribute(name).unwrap();
                (of("name").to_string(), numbers(of("value")))
            })
            .collect()
    };
    // One interface of index 1.5 reflects 0.04; two with what goes to and fro, as much.
    let pane =
        MaterialRecord { transmission: [0.9, 0.8, 0.7], index: 1.5, ..MaterialRecord::BLACK };
    let (xml, said) = written(&pane);
    assert!(xml.contains("\"thindielectric\"") && said == 1, "{xml}");
    let r = f0(values(&xml)["int_ior"][0]);
    assert!((2.0 * r / (1.0 + r) - 0.04).abs() < 1e-6);
    // A tint alone is exact.
    let (xml, said) = written(&MaterialRecord { index: 1.0, ..pane });
    assert_eq!((values(&xml)["int_ior"][0], said), (1.0, 0));

    let solid = MaterialRecord { flags: MATERIAL_SOLID, transmission: [1.0; 3], ..pane };
    let (xml, said) = written(&solid);
    assert!(xml.contains("type=\"dielectric\"") && !xml.contains("twosided") && said == 0, "{xml}");
    assert_eq!(values(&xml)["ext_ior"][0], 1.0);
    assert_eq!(written(&MaterialRecord { absorption: [1.0; 3], ..solid }).1, 1);

    let gloss =
        MaterialRecord { flags: MATERIAL_GLOSS, roughness: 0.25, ..material([0.5; 3], [0.04; 3]) };
    let (xml, said) = written(&gloss);
    assert!(xml.contains("\"roughplastic\"") && xml.contains("\"ggx\"") && said == 1, "{xml}");
    assert!((f0(values(&xml)["int_ior"][0]) - 0.04).abs() < 1e-6);
    let metal = MaterialRecord { diffuse: [0.0; 3], specular: [0.9, 0.6, 0.3], ..gloss };
    let eta = values(&written(&metal).0)["eta"].clone();
    for (eta, wanted) in eta.into_iter().zip([0.9, 0.6, 0.3]) {
        assert!((f0(eta) - wanted).abs() < 1e-5);
    }
    assert!(written(&MaterialRecord { roughness: 0.0, ..metal }).0.contains("\"conductor\""));
}

#[test]
fn a_view_is_the_same_picture() {
    let building = fixture("two-rooms.toml");
    let view = &crate::view::chosen(&building.views, &["east".into()], Some(256), None).unwrap()[0];
    let text = camera(view, shown(view).unwrap());
    let xml = Document::parse(&text).unwrap();
    let sensor = xml.descendants().find(|n| n.has_tag_name("sensor")).unwrap();
    assert_eq!(value(sensor, "fov_axis"), "y");
    assert_eq!(value(sensor, "fov"), "70");
    let film = xml.descendants().find(|n| n.has_tag_name("film")).unwrap();
    assert_eq!((value(film, "width"), value(film, "height")), ("256", "360"));
    let filter = film.children().find(|n| n.has_tag_name("rfilter")).unwrap();
    assert_eq!(filter.attribute("type"), Some("box"));
    assert!(crate::view::chosen(&building.views, &["nowhere".into()], None, None).is_err());
}
