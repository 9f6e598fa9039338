//! The L-shape is what it says: the paper's counts, solid walls, nothing in anybody's way.

use enf_building::furnish::{Footprint, Stance, clearances, leaves};
use enf_building::mesh::{Mesh, is_closed};
use enf_building::palette::{self, PANEL};
use enf_building::plan::{Filling, STOREY};
use enf_building::{Building, Kind, Request, design, generate, write};
use glam::DVec3;
use std::collections::BTreeMap;

fn building(seed: u64) -> Building {
    design(&Request { kind: Kind::LShape, floors: None, seed }).unwrap()
}

fn within(got: f64, expected: f64, share: f64) {
    assert!((got - expected).abs() <= share * expected, "{got} is not near {expected}");
}

/// Triangles by room; walls and windows count where they face, the rest is outside.
fn by_room(b: &Building) -> Vec<u64> {
    let mut rooms = vec![0; b.plan.rooms.len() + 1];
    b.for_each_triangle(|_, _, t| {
        let c = (t[0] + t[1] + t[2]) / 3.0;
        let n = (t[1] - t[0]).cross(t[2] - t[0]).normalize_or_zero() * 0.01;
        let room = b.plan.room_at(c).or(b.plan.room_at(c + n)).or(b.plan.room_at(c - n));
        rooms[room.unwrap_or(b.plan.rooms.len())] += 1;
    });
    rooms
}

#[test]
fn counts_are_the_papers() {
    // Tables 1 and 2 of the paper.
    let b = building(1);
    let s = b.summary();
    assert_eq!((s.rooms, s.lights), (27, 24));
    assert_eq!(s.views.len(), 3);
    within(s.triangles as f64, 336_500.0, 0.05);
    let rooms = by_room(&b);
    let inside = &rooms[..27];
    within(inside.iter().sum::<u64>() as f64 / 27.0, 12_020.0, 0.05);
    within(*inside.iter().max().unwrap() as f64, 68_400.0, 0.05);
    assert!(inside.iter().all(|&n| n > 1000), "{inside:?}");
    for seed in [2, 77, u64::MAX] {
        within(building(seed).triangles() as f64, 336_500.0, 0.05);
    }
}

#[test]
fn other_heights_have_thirteen_rooms_a_floor_and_the_stairs() {
    for floors in [1, 3, 5] {
        let b = design(&Request { kind: Kind::LShape, floors: Some(floors), seed: 1 }).unwrap();
        assert_eq!(b.plan.rooms.len() as u32, 13 * floors + 1);
    }
    for floors in [0, 101] {
        assert!(design(&Request { kind: Kind::LShape, floors: Some(floors), seed: 1 }).is_err());
    }
}

#[test]
fn a_seed_fixes_every_byte_and_another_moves_things() {
    let text = |b: &Building| {
        let mut all = write::scene(b, "x.meshes");
        for p in &b.parts {
            all.push_str(&write::obj(&p.name, &p.mesh));
        }
        all
    };
    let (one, again, other) = (text(&building(1)), text(&building(1)), text(&building(2)));
    assert!(one == again);
    assert!(one != other);
    // The house stays the house.
    assert!(building(1).parts[0] == building(2).parts[0]);
    assert!(building(1).plan == building(2).plan);
}

/// FNV-1a of some text, going on from `hash`.
fn fnv(hash: u64, text: &str) -> u64 {
    text.bytes().fold(hash, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01b3))
}

#[test]
fn the_house_with_seed_1_stays_as_it_is() {
    // Its figures are quoted in documents and its pictures compared with older ones.
    let b = building(1);
    let mut hash = fnv(0xcbf2_9ce4_8422_2325, &write::scene(&b, "x.meshes"));
    hash = fnv(hash, &write::mtl(Kind::LShape));
    for p in &b.parts {
        hash = fnv(hash, &write::obj(&p.name, &p.mesh));
    }
    assert_eq!((b.triangles(), hash), (337_262, 0x1983_c2ef_212a_a900));
}

/// The connected pieces of a mesh, welded at the precision of the files.
fn pieces(mesh: &Mesh) -> Vec<Mesh> {
    let key = |p: DVec3| p.to_array().map(|c| (c * 1e5).round() as i64);
    let mut ids = BTreeMap::new();
    let weld: Vec<usize> = mesh
        .points
        .iter()
        .map(|&p| {
            let n = ids.len();
            *ids.entry(key(p)).or_insert(n)
        })
        .collect();
    let mut parent: Vec<usize> = (0..ids.len()).collect();
    fn root(parent: &mut [usize], mut i: usize) -> usize {
        while parent[i] != i {
            parent[i] = parent[parent[i]];
            i = parent[i];
        }
        i
    }
    for t in &mesh.triangles {
        let a = root(&mut parent, weld[t.corners[0] as usize]);
        for c in &t.corners[1..] {
            let b = root(&mut parent, weld[*c as usize]);
            parent[b] = a;
        }
    }
    let mut out: BTreeMap<usize, Mesh> = BTreeMap::new();
    for t in &mesh.triangles {
        let r = root(&mut parent, weld[t.corners[0] as usize]);
        let m = out.entry(r).or_insert_with(|| Mesh { points: mesh.points.clone(), ..Mesh::new() });
        m.triangles.push(*t);
    }
    out.into_values().collect()
}

#[test]
fn solids_are_closed_and_outward_and_only_sheets_are_open() {
    // Sheets, on purpose: glass, mirrors, luminous panels, leaves, cloth on hangers, paint strokes.
    let sheet = |paint: &str| {
        ["glass.pane", "mirror", PANEL, "paper"].contains(&paint)
            || ["leaf.", "fabric.", "book.", "lacquer."].iter().any(|p| paint.starts_with(p))
    };
    for part in &building(1).parts {
        // A large mesh would be copied for each of its pieces.
        if part.mesh.triangles.len() > 8000 {
            assert!(is_closed(&part.mesh) || part.name == "windows", "{}", part.name);
            continue;
        }
        for piece in pieces(&part.mesh) {
            let paint = piece.triangles[0].paint;
            if is_closed(&piece) {
                let v = piece.volume();
                assert!(v > 0.0, "{}: {} inside out, {v} m3", part.name, paint);
            } else {
                assert!(sheet(paint), "{}: {} is open", part.name, paint);
            }
        }
        for (i, _) in part.mesh.triangles.iter().enumerate() {
            let [a, b, c] = part.mesh.corners(i);
            assert!(a.is_finite() && b.is_finite() && c.is_finite(), "{}", part.name);
        }
    }
}

#[test]
fn no_triangle_loses_its_area_in_the_files() {
    for part in &building(1).parts {
        for i in 0..part.mesh.triangles.len() {
            let [a, b, c] = part.mesh.corners(i).map(|p| (p * 1e5).round() / 1e5);
            let area = (b - a).cross(c - a).length() / 2.0;
            assert!(area > 1e-10, "{}: triangle {i} at {a}", part.name);
        }
    }
}

#[test]
fn every_paint_is_in_the_shop() {
    for part in &building(1).parts {
        for t in &part.mesh.triangles {
            assert!(t.paint == PANEL || palette::kind(t.paint).is_some(), "{}", t.paint);
        }
    }
}

#[test]
fn panels_look_down_and_nothing_hangs_below_them() {
    let b = building(1);
    // Panels in world space with their rooms.
    let mut panels: Vec<(DVec3, DVec3)> = Vec::new();
    for part in &b.parts {
        for copy in part.copies.iter().filter(|c| c.is_lamp) {
            let room = &b.plan.rooms[copy.room.unwrap()];
            for (i, t) in part.mesh.triangles.iter().enumerate() {
                if t.paint == PANEL {
                    let [p, q, r] = part.mesh.corners(i).map(|p| copy.apply(p));
                    let n = (q - p).cross(r - p);
                    assert!(n.z < 0.0 && n.z.abs() > 0.999 * n.length());
                    assert!(room.holds((p + q + r) / 3.0, 0.0), "{}", room.name);
                    let gap = room.shafts.last().map_or(room.height.1, |s| s.2) - p.z;
                    assert!((0.03..0.1).contains(&gap), "{}: {gap}", room.name);
                    panels.push((p.min(q).min(r), p.max(q).max(r)));
                }
            }
        }
    }
    assert!(!panels.is_empty());
    b.for_each_triangle(|part, _, t| {
        let (low, high) = (t[0].min(t[1]).min(t[2]), t[0].max(t[1]).max(t[2]));
        for (a, z) in &panels {
            let beneath = low.z < a.z - 1e-6 && high.z > a.z - 0.5;
            let beside = high.x < a.x || low.x > z.x || high.y < a.y || low.y > z.y;
            assert!(!beneath || beside, "{} hangs below a panel at {a}", b.parts[part].name);
        }
    });
}

#[test]
fn lamps_suit_their_rooms() {
    let b = building(1);
    for room in &b.plan.rooms {
        if let Some(lamp) = &room.lamp {
            let each = lamp.lumens / lamp.points.len() as f64;
            assert!((1500.0..7000.0).contains(&each), "{}: {each} lm a panel", room.name);
            assert!(lamp.colour.iter().all(|&c| c > 0.0 && c <= 1.0));
        }
    }
    let dark: Vec<_> =
        b.plan.rooms.iter().filter(|r| r.lamp.is_none()).map(|r| r.name.as_str()).collect();
    assert_eq!(dark, ["ground/archive", "ground/store", "upper/dressing"]);
}

#[test]
fn furniture_keeps_to_its_room_and_out_of_the_way() {
    for seed in [1, 2, 3, 12345] {
        let b = building(seed);
        let (zones, open) = (clearances(&b.plan), leaves(&b.plan));
        let mut placed: Vec<(usize, &str, Footprint)> = Vec::new();
        for part in &b.parts {
            for copy in &part.copies {
                let Some(room) = copy.room else { continue };
                let f = Footprint::of(&part.mesh, copy);
                if f.stance == Stance::Built {
                    continue;
                }
                let (name, r) = (part.name.as_str(), &b.plan.rooms[room]);
                for c in f.corners() {
                    assert!(
                        r.rects.iter().any(|r| r.holds(c.x, c.y, 1e-4)),
                        "{name} leaves {}",
                        r.name
                    );
                }
                let (floor, ceiling) = (r.height.0, r.height.0 + STOREY - 0.3);
                assert!(f.height.0 > floor, "{name} is {} in the floor", floor - f.height.0);
                assert!(f.height.1 < ceiling, "{name} is in the ceiling");
                if f.stance != Stance::Flat {
                    assert!(!zones.iter().any(|z| z.overlaps(&f, 0.0)), "{name} in a doorway");
                    assert!(!open.iter().any(|z| z.conflicts(&f)), "{name} in a door's way");
                }
                for (other, their, g) in &placed {
                    assert!(
                        *other != room || !f.conflicts(g),
                        "{name} and {their} clash in {} (seed {seed})",
                        r.name
                    );
                }
                placed.push((room, name, f));
            }
        }
        for view in &b.plan.views {
            let room = b.plan.room_at(view.eye).expect("a view's eye is in a room");
            assert!(b.plan.rooms[room].holds(view.eye, 0.3), "{} is at a wall", view.name);
            for (_, name, f) in &placed {
                assert!(!f.holds(view.eye, 0.15), "{} stands in {name}", view.name);
            }
        }
    }
}

#[test]
fn rooms_do_not_touch_and_every_room_can_be_reached() {
    let b = building(1);
    let boxes: Vec<_> = b
        .plan
        .rooms
        .iter()
        .enumerate()
        .flat_map(|(i, r)| {
            let own = r.rects.iter().map(|&q| (q, r.height.0, r.height.1));
            own.chain(r.shafts.iter().copied()).map(move |q| (i, q)).collect::<Vec<_>>()
        })
        .collect();
    for (i, (r, a, b)) in &boxes {
        for (j, (q, c, d)) in &boxes {
            let apart = r.x1.min(q.x1) - r.x0.max(q.x0) < -0.11
                || r.y1.min(q.y1) - r.y0.max(q.y0) < -0.11
                || b.min(*d) - a.max(*c) < -0.11;
            assert!(i == j || apart, "rooms {i} and {j} share a wall thinner than 0.12 m");
        }
    }
    // Walk from room to room through the doorways.
    let mut seen = vec![false; b.plan.rooms.len()];
    let mut todo = vec![0];
    while let Some(room) = todo.pop() {
        if std::mem::replace(&mut seen[room], true) {
            continue;
        }
        for o in b.plan.openings.iter().filter(|o| matches!(o.filling, Filling::Doorway(_))) {
            let r = o.rect();
            let (x, y) = ((r.x0 + r.x1) / 2.0, (r.y0 + r.y1) / 2.0);
            let z = o.height.0 + 1.0;
            let (dx, dy) = if o.along_x { (0.0, 0.2) } else { (0.2, 0.0) };
            let sides = [DVec3::new(x + dx, y + dy, z), DVec3::new(x - dx, y - dy, z)]
                .map(|p| b.plan.room_at(p).expect("a doorway has a room on each side"));
            assert!((o.height.1 - o.height.0 - 2.1).abs() < 1e-9);
            if sides.contains(&room) {
                todo.extend(sides);
            }
        }
    }
    assert!(seen.iter().all(|&s| s), "{seen:?}");
}

#[test]
fn files_are_complete_and_name_only_what_exists() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("house.toml");
    let request = Request { kind: Kind::LShape, floors: None, seed: 1 };
    let summary = generate(&request, &path).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    let scene: toml::Table = text.parse().unwrap();
    let list = |key: &str| scene[key].as_array().unwrap().clone();
    let materials: Vec<String> =
        list("material").iter().map(|m| m["name"].as_str().unwrap().to_owned()).collect();
    let (mut triangles, mut files, mut lamps) = (0, BTreeMap::new(), 0);
    for mesh in list("mesh") {
        let file = mesh["file"].as_str().unwrap();
        assert!(file.starts_with("house.meshes/"));
        let faces = *files.entry(file.to_owned()).or_insert_with(|| {
            let obj = std::fs::read_to_string(folder.path().join(file)).unwrap();
            for paint in obj.lines().filter_map(|l| l.strip_prefix("usemtl ")) {
                assert!(paint == PANEL || materials.iter().any(|m| m == paint), "{paint}");
            }
            obj.lines().filter(|l| l.starts_with("f ")).count()
        });
        let copies = mesh["instances"].as_array().unwrap().len();
        triangles += faces * copies;
        if let Some(remap) = mesh.get("materials") {
            assert!(materials.iter().any(|m| Some(m.as_str()) == remap[PANEL].as_str()));
            lamps += copies;
        }
    }
    assert_eq!(triangles as u64, summary.triangles);
    assert_eq!(lamps as u32, summary.lights);
    assert_eq!(list("view").len(), 3);
    // Parts, the scene file and materials.mtl; nothing half-written is left.
    let names: Vec<_> = std::fs::read_dir(folder.path().join("house.meshes"))
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    assert_eq!(names.len() as u32 + 1, summary.files);
    assert!(names.iter().all(|n| !n.ends_with(".part")));
}

#[test]
fn a_path_that_is_no_file_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let request = Request { kind: Kind::LShape, floors: Some(1), seed: 1 };
    let error = generate(&request, folder.path()).unwrap_err().to_string();
    assert!(error.contains("not a file name"), "{error}");
    let blocked = folder.path().join("scene.meshes");
    std::fs::write(&blocked, "in the way").unwrap();
    let error = generate(&request, &folder.path().join("scene.toml")).unwrap_err().to_string();
    assert!(error.contains("scene.meshes"), "{error}");
}
