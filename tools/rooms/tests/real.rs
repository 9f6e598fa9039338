//! Real buildings, if they are there: `ENFILADE_DATA` names the folder with `bim/NAME/NAME.obj.zst`.

use enf_layout::material::MATERIAL_SEE_THROUGH;
use enf_rooms::{Bsp, Options, RoomCount};
use enf_rooms_truth::found::Partitioned;
use enf_rooms_truth::score::{Score, score};
use enf_rooms_truth::{hints::hints, truth};
use std::path::PathBuf;

fn compare(model: &str, degrees: f64, hinted: bool) -> Option<(truth::Truth, Score)> {
    let Some(data) = std::env::var_os("ENFILADE_DATA") else {
        eprintln!("SKIPPED: ENFILADE_DATA is not set, so {model} was not compared");
        return None;
    };
    let file =
        |end: &str| PathBuf::from(&data).join("bim").join(model).join(format!("{model}.{end}"));
    let solids = file("spaces.obj.zst");
    let truth = truth::load(&file("truth.json"), Some(&solids)).unwrap();
    let scene = enf_scene::load(&file("obj.zst"), &enf_scene::LoadOptions::default()).unwrap();
    let turn = degrees.to_radians();
    let (sin, cos) = (libm::sin(turn), libm::cos(turn));
    let (mut triangles, mut clear) = (Vec::new(), Vec::new());
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    let streamed = scene.for_each_triangle(|t| {
        let corners = t.corners.map(|p| {
            let (x, y) = (f64::from(p[0]), f64::from(p[1]));
            [(x * cos - y * sin) as f32, (x * sin + y * cos) as f32, p[2]]
        });
        for p in corners {
            for k in 0..3 {
                (min[k], max[k]) = (min[k].min(p[k]), max[k].max(p[k]));
            }
        }
        triangles.push(corners);
        clear.push(scene.materials[t.material as usize].record.flags & MATERIAL_SEE_THROUGH != 0);
    });
    streamed.unwrap();
    let options = Options {
        delta: scene.delta,
        bounds_min: min,
        bounds_max: max,
        rooms: RoomCount::Auto,
        hints: if hinted { hints(&truth, scene.origin, turn) } else { Vec::new() },
    };
    let tables =
        enf_rooms::partition(&triangles, &|i| !clear[i], &options).unwrap().finish(&triangles);
    let delta = f64::from(scene.delta);
    let found = Partitioned {
        bsp: Bsp::new(&tables.planes, &tables.nodes, &tables.leaves, &tables.faces, delta).unwrap(),
        portals: &tables.portals,
        outside: tables.outside,
        origin: scene.origin,
        turn,
    };
    let score = score(&truth, &found);
    Some((truth, score))
}

#[test]
fn walls_make_rooms_and_doors_whichever_way_the_building_stands() {
    for (model, degrees) in
        [("duplex", 0.0), ("duplex", 30.0), ("whale_large", 0.0), ("whale_large", 45.0)]
    {
        let Some((truth, score)) = compare(model, degrees, false) else { return };
        let text = enf_rooms_truth::table::text(&truth, &score, true);
        assert!(score.matched_of_divided().percent() >= 90.0, "{model} by {degrees}:\n{text}");
        assert!(score.doors(&truth, false).percent() >= 90.0, "{model} by {degrees}:\n{text}");
        assert!(score.doors(&truth, true).percent() >= 90.0, "{model} by {degrees}:\n{text}");
    }
}

#[test]
fn with_hints_nearly_every_space_is_a_room() {
    for model in ["duplex", "whale_large"] {
        let Some((truth, score)) = compare(model, 30.0, true) else { return };
        let text = enf_rooms_truth::table::text(&truth, &score, true);
        assert!(score.matched().percent() >= 95.0, "{model}:\n{text}");
    }
}
