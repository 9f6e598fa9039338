//! `tools/ifc_to_scene.py`: a small building written here, and a real one against its truth file. Needs
//! Python 3 with `ifcopenshell` (and `zstandard`); says so and passes without.

use enf_scene::{LoadOptions, Scene, load};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};
use tempfile::TempDir;

fn tool() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/ifc_to_scene.py")
}

fn installed() -> bool {
    let check =
        Command::new("python3").args(["-c", "import ifcopenshell, numpy, zstandard"]).output();
    let there = check.is_ok_and(|o| o.status.success());
    if !there {
        eprintln!("SKIPPED: needs python3 with ifcopenshell and zstandard (pip install)");
    }
    there
}

fn convert(ifc: &Path, out: &Path, flags: &[&str]) -> Output {
    Command::new("python3").arg(tool()).arg(ifc).arg("-o").arg(out).args(flags).output().unwrap()
}

fn converted(ifc: &Path, out: &Path, flags: &[&str]) -> (Scene, String) {
    let output = convert(ifc, out, flags);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    (load(out, &LoadOptions::default()).unwrap_or_else(|e| panic!("{e}")), said)
}

/// A slab, a door, a lamp and two spaces, in millimetres: an L of 4 x 3 m less 2 x 2 m, and a box.
fn building() -> String {
    let mut text = String::from(
        "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\nFILE_NAME('','',(''),(''),'','','');\n\
         FILE_SCHEMA(('IFC4'));\nENDSEC;\nDATA;\n\
         #1=IFCPROJECT('0000000000000000000001',$,'p',$,$,$,$,(#10),#5);\n\
         #5=IFCUNITASSIGNMENT((#6));\n#6=IFCSIUNIT(*,.LENGTHUNIT.,.MILLI.,.METRE.);\n\
         #10=IFCGEOMETRICREPRESENTATIONCONTEXT($,'Model',3,1.E-05,#11,$);\n\
         #11=IFCAXIS2PLACEMENT3D(#12,$,$);\n#12=IFCCARTESIANPOINT((0.,0.,0.));\n\
         #13=IFCLOCALPLACEMENT($,#11);\n#14=IFCDIRECTION((0.,0.,1.));\n\
         #20=IFCBUILDING('0000000000000000000002',$,'b',$,$,#13,$,$,.ELEMENT.,$,$,$);\n\
         #21=IFCBUILDINGSTOREY('0000000000000000000003',$,'Level 0',$,$,#13,$,$,.ELEMENT.,0.);\n\
         #22=IFCRELAGGREGATES('0000000000000000000004',$,$,$,#1,(#20));\n\
         #23=IFCRELAGGREGATES('0000000000000000000005',$,$,$,#20,(#21));\n\
         #24=IFCRELCONTAINEDINSPATIALSTRUCTURE('0000000000000000000006',$,$,$,(#302,#402,#502),#21);\n\
         #30=IFCSTYLEDITEM(#306,(#31),$);\n#31=IFCSURFACESTYLE('paint',.BOTH.,(#32));\n\
         #32=IFCSURFACESTYLERENDERING(#33,0.25,$,$,$,$,$,$,.FLAT.);\n\
         #33=IFCCOLOURRGB($,0.5,0.25,1.);\n",
    );
    let shape = |id: u32, low: f64, height: f64, corners: &[[f64; 2]]| {
        let mut out = String::new();
        let mut points = Vec::new();
        for (i, [x, y]) in corners.iter().chain(corners.first()).enumerate() {
            let point = id + 20 + i as u32;
            out += &format!("#{point}=IFCCARTESIANPOINT(({x:?},{y:?}));\n");
            points.push(format!("#{point}"));
        }
        out += &format!(
            "#{}=IFCCARTESIANPOINT((0.,0.,{low:?}));\n#{}=IFCAXIS2PLACEMENT3D(#{},$,$);\n\
             #{}=IFCPOLYLINE(({}));\n#{}=IFCARBITRARYCLOSEDPROFILEDEF(.AREA.,$,#{});\n\
             #{}=IFCEXTRUDEDAREASOLID(#{},#{},#14,{height:?});\n\
             #{}=IFCSHAPEREPRESENTATION(#10,'Body','SweptSolid',(#{}));\n\
             #{}=IFCPRODUCTDEFINITIONSHAPE($,$,(#{}));\n",
            id + 9,
            id + 8,
            id + 9,
            id + 10,
            points.join(","),
            id + 7,
            id + 10,
            id + 6,
            id + 7,
            id + 8,
            id + 4,
            id + 6,
            id + 3,
            id + 4,
        );
        out
    };
    let square = |a: f64, b: f64, s: f64| [[a, b], [a + s, b], [a + s, b + s], [a, b + s]];
    let l = [[0., 0.], [4000., 0.], [4000., 1000.], [2000., 1000.], [2000., 3000.], [0., 3000.]];
    text += &shape(100, 0.0, 2500.0, &l);
    text += "#102=IFCSPACE('0000000000000000000102',$,'1',$,$,#13,#103,'Corner \"office\"',.ELEMENT.,.INTERNAL.,$);\n";
    text += &shape(200, 0.0, 2500.0, &square(2100., 1100., 1900.));
    text +=
        "#202=IFCSPACE('0000000000000000000202',$,'2',$,$,#13,#203,$,.ELEMENT.,.INTERNAL.,$);\n";
    text += &shape(300, -200.0, 200.0, &square(0., 0., 4000.));
    text += "#302=IFCSLAB('0000000000000000000302',$,'the floor',$,$,#13,#303,$,$);\n";
    text +=
        &shape(400, 0.0, 2000.0, &[[900., 1000.], [1800., 1000.], [1800., 1040.], [900., 1040.]]);
    text += "#402=IFCDOOR('0000000000000000000402',$,'D1',$,$,#13,#403,$,2000.,900.,$,$,$);\n";
    text += &shape(500, 2400.0, 50.0, &square(1000., 500., 200.));
    text += "#502=IFCLIGHTFIXTURE('0000000000000000000502',$,'L1',$,$,#13,#503,$,$);\n";
    text + "ENDSEC;\nEND-ISO-10303-21;\n"
}

#[test]
fn a_small_building() {
    if !installed() {
        return;
    }
    let dir = TempDir::new().unwrap();
    let (ifc, out) = (dir.path().join("b.ifc"), dir.path().join("s.toml"));
    fs::write(&ifc, building()).unwrap();
    let (scene, said) = converted(&ifc, &out, &[]);
    let names: Vec<String> = (0..scene.object_count()).map(|o| scene.object_name(o)).collect();
    assert_eq!(
        names,
        [
            "IfcSlab/0000000000000000000302/the_floor",
            "IfcDoor/0000000000000000000402/D1",
            "IfcLightFixture/0000000000000000000502/L1"
        ]
    );
    assert_eq!((scene.triangle_count(), scene.door_objects()), (36, vec![1]));
    assert_eq!(scene.bounds, ([0., 0., -0.2], [4., 4., 2.45]));
    let paint = scene.materials.iter().find(|m| m.name == "paint").unwrap().record;
    // White is 0.9; a quarter passes.
    assert_eq!((paint.transmission, paint.diffuse), ([0.25; 3], [0.375, 0.1875, 0.675]));
    assert_eq!(scene.hints.len(), 2);
    assert_eq!(scene.hints[0].name, "1 Corner \"office\"");
    assert_eq!((scene.hints[0].min, scene.hints[0].max), ([0.; 3], [4., 3., 2.5]));
    let mut corners = scene.hints[0].polygon.clone();
    corners.sort_by(|a, b| a.partial_cmp(b).unwrap());
    assert_eq!(corners, [[0., 0.], [0., 3.], [2., 1.], [2., 3.], [4., 0.], [4., 1.]]);
    assert_eq!((scene.hints[1].name.as_str(), scene.hints[1].polygon.len()), ("2", 0));
    assert_eq!((scene.hints[1].min, scene.hints[1].max), ([2.1, 1.1, 0.], [4., 3., 2.5]));
    assert!(
        scene.lights().unwrap().records.is_empty() && said.contains("--ceiling-lights"),
        "{said}"
    );

    let flags = [
        "--doors",
        "open",
        "--no-hints",
        "--lamp-lumens",
        "1790",
        "--per-storey",
        "--threads",
        "1",
    ];
    let (scene, said) = converted(&ifc, &out, &flags);
    assert_eq!((scene.triangle_count(), scene.hints.len()), (24, 0), "{said}");
    assert!(dir.path().join("s.meshes/Level_0.obj").is_file());
    let lights = scene.lights().unwrap();
    assert_eq!(lights.records.len(), 1);
    let [r, g, b] = lights.records[0].flux_w.map(f64::from);
    assert!((0.2126 * r + 0.7152 * g + 0.0722 * b - 10.0).abs() < 1e-4);
}

#[test]
fn errors_are_sentences() {
    if !installed() {
        return;
    }
    let dir = TempDir::new().unwrap();
    let out = dir.path().join("s.toml");
    let file = |name: &str, bytes: &[u8]| {
        let path = dir.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    };
    let in_a_file = dir.path().join("a.ifc/s.toml").to_string_lossy().into_owned();
    let whole = building();
    let no_geometry =
        whole.replace("#303,$,$", "$,$,$").replace("#403,$", "$,$").replace("#503,$", "$,$");
    for (ifc, flags, code, word) in [
        (dir.path().join("none.ifc"), &[][..], 4, "cannot be read"),
        (file("a.ifc", b"hello"), &[], 4, "no IFC file"),
        (file("b.ifc", &whole.as_bytes()[..900]), &[], 4, "cut short"),
        (file("c.ifc.zst", b"hello"), &[], 4, "no zstd file"),
        (file("d.ifc", no_geometry.as_bytes()), &[], 4, "no element with geometry"),
        (file("e.ifc", whole.as_bytes()), &["--lamp-lumens", "-1"], 2, "above 0"),
        (file("f.ifc", whole.as_bytes()), &["--threads", "0"], 2, "1 or more"),
        (file("g.ifc", whole.as_bytes()), &["-o", "s.obj"], 2, "ends in .toml"),
        (file("h.ifc", whole.as_bytes()), &["-o", &in_a_file], 5, "cannot be written"),
    ] {
        let output = convert(&ifc, &out, flags);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{said}");
        assert!(said.contains(word) && !said.contains("Traceback"), "{said}");
    }
}

#[test]
fn a_real_building_against_its_truth() {
    let Some(data) = std::env::var_os("ENFILADE_DATA").map(PathBuf::from) else {
        eprintln!("SKIPPED: set ENFILADE_DATA to the folder of test models to convert one");
        return;
    };
    if !installed() {
        return;
    }
    let dir = TempDir::new().unwrap();
    let out = dir.path().join("duplex.toml");
    let (scene, said) = converted(&data.join("ifc/Duplex_A_20110907.ifc.zst"), &out, &[]);
    let truth = fs::read(data.join("bim/duplex/duplex.truth.json")).unwrap();
    let truth: serde_json::Value = serde_json::from_slice(&truth).unwrap();
    // Triangles by class; the model of the truth file has ducts and lamps of other files as well.
    let mut by_class: BTreeMap<String, (u64, BTreeMap<u32, ()>)> = BTreeMap::new();
    scene
        .for_each_triangle(|t| {
            let class = scene.object_name(t.object).split('/').next().unwrap().to_string();
            let of = by_class.entry(class).or_default();
            of.0 += 1;
            of.1.insert(t.object, ());
        })
        .unwrap();
    assert!(by_class.len() >= 12, "{by_class:?}");
    let mut all = 0;
    for (class, (triangles, objects)) in &by_class {
        let of = &truth["elements_by_type"][class];
        assert_eq!(Some(objects.len() as u64), of["count"].as_u64(), "{class}");
        // A few have no area after rounding.
        let expected = of["triangles"].as_u64().unwrap();
        assert!(*triangles <= expected && expected - triangles <= 4, "{class}: {triangles}");
        all += expected;
    }
    assert_eq!(scene.triangle_count() + scene.skipped_triangles(), all);
    // Footprints and volumes of the rooms.
    let text = fs::read_to_string(&out).unwrap();
    let guids: Vec<&str> = text.lines().filter_map(|l| l.strip_prefix("[[room]]  # ")).collect();
    assert_eq!((guids.len(), scene.hints.len()), (21, 21), "{said}");
    for (guid, hint) in guids.iter().zip(&scene.hints) {
        let spaces = truth["spaces"].as_array().unwrap();
        let space = spaces.iter().find(|s| s["guid"] == **guid).unwrap();
        let side = |c: usize| f64::from(hint.max[c]) - f64::from(hint.min[c]);
        let area = if hint.polygon.is_empty() {
            side(0) * side(1)
        } else {
            let p = &hint.polygon;
            let wide = |i: usize| p[i % p.len()].map(f64::from);
            (0..p.len())
                .map(|i| {
                    let ([a, b], [c, d]) = (wide(i), wide(i + 1));
                    0.5 * (a * d - c * b)
                })
                .sum()
        };
        let expected = space["floor_area_mesh_m2"].as_f64().unwrap();
        assert!((area / expected - 1.0).abs() < 2e-3, "{}: {area} m2, not {expected}", hint.name);
        let volume = space["volume_mesh_m3"].as_f64().unwrap();
        assert!(area * side(2) > 0.99 * volume, "{}: {volume} m3", hint.name);
    }
}
