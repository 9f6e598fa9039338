//! Z-building, octagon and tower are what the paper's tables say, stand up, and can be walked
//! through.

use enf_building::assemble::Drawing;
use enf_building::carcass::{Carcass, Wells};
use enf_building::furnish::auto::{clearances, inside, leaves};
use enf_building::furnish::{Footprint, Stance};
use enf_building::mesh::is_closed;
use enf_building::palette::{self, PANEL};
use enf_building::plan::Filling;
use enf_building::storey::{CEILING, HEIGHT};
use enf_building::{Building, Kind, Request, design, octagon, tower, write, zbuilding};
use glam::{DVec2, DVec3};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::OnceLock;

fn building(kind: Kind, floors: Option<u32>, seed: u64) -> Building {
    design(&Request { kind, floors, seed }).unwrap()
}

/// The paper's building with seed 1 (of the tower one floor), made once for all tests.
fn usual(kind: Kind) -> &'static Building {
    static MADE: [OnceLock<Building>; 3] = [const { OnceLock::new() }; 3];
    let (k, floors) = match kind {
        Kind::ZBuilding => (0, 1),
        Kind::Octagon => (1, 3),
        _ => (2, 1),
    };
    MADE[k].get_or_init(|| building(kind, Some(floors), 1))
}

fn drawings() -> [(Kind, Drawing); 3] {
    [
        (Kind::ZBuilding, zbuilding::drawing()),
        (Kind::Octagon, octagon::drawing()),
        (Kind::Tower, tower::drawing()),
    ]
}

fn within(what: &str, got: f64, expected: f64, share: f64) {
    let off = got / expected - 1.0;
    assert!(off.abs() <= share, "{what}: {got} is {:.1} % off {expected}", 100.0 * off);
}

/// Mean and maximum of the triangles in rooms.
fn per_room(b: &Building) -> (f64, f64) {
    let rooms = b.triangles_by_room();
    let rooms = &rooms[..rooms.len() - 1];
    let sum: u64 = rooms.iter().sum();
    (sum as f64 / rooms.len() as f64, *rooms.iter().max().unwrap() as f64)
}

#[test]
fn the_z_building_is_the_papers() {
    let b = usual(Kind::ZBuilding);
    assert_eq!(Kind::ZBuilding.floors(), 1);
    let s = b.summary();
    assert_eq!((s.rooms, s.lights, b.plan.storeys, s.views.len()), (22, 15, 1, 3));
    within("triangles", s.triangles as f64, 1_074_000.0, 0.05);
    let (mean, max) = per_room(b);
    within("mean", mean, 48_816.0, 0.05);
    within("max", max, 217_429.0, 0.05);
    // Other seeds, and the variants of Table 3: copies of the floor.
    within("seed 7", building(Kind::ZBuilding, None, 7).triangles() as f64, 1_074_000.0, 0.05);
    for floors in [21, 101] {
        let tall = building(Kind::ZBuilding, Some(floors), 1).summary();
        assert_eq!((tall.rooms, tall.lights), (22 * floors, 15 * floors));
        let expected = 1_074_000.0 * f64::from(floors);
        within("storeys", tall.triangles as f64, expected, 0.05);
    }
}

#[test]
fn the_octagon_is_the_papers() {
    let b = usual(Kind::Octagon);
    assert_eq!(Kind::Octagon.floors(), 3);
    let s = b.summary();
    assert_eq!((s.rooms, s.lights, b.plan.storeys, s.views.len()), (232, 155, 3, 3));
    within("triangles", s.triangles as f64, 5_250_000.0, 0.05);
    let (mean, max) = per_room(b);
    within("mean", mean, 22_621.0, 0.05);
    within("max", max, 451_606.0, 0.05);
    within("seed 7", building(Kind::Octagon, None, 7).triangles() as f64, 5_250_000.0, 0.05);
}

#[test]
fn the_tower_is_the_papers() {
    // All of it where that is quick; ten furnishings are what a hundred floors have.
    let floors = if cfg!(debug_assertions) { 10 } else { 100 };
    let b = building(Kind::Tower, Some(floors), 1);
    let s = b.summary();
    assert_eq!((s.rooms, s.lights), (178 * floors, 610 * floors));
    within("triangles", s.triangles as f64, 10.74e6 * f64::from(floors), 0.05);
    let copies: usize = b.parts.iter().map(|p| p.copies.len()).sum();
    assert!(copies < 5000 * floors as usize, "{copies} instances");
    let bytes: usize =
        b.parts.iter().map(|p| 12 * (p.mesh.points.len() + p.mesh.triangles.len())).sum();
    assert!(bytes < 60_000_000 && s.files < 400, "{bytes} bytes in {} files", s.files);
    let (mean, max) = per_room(usual(Kind::Tower));
    within("mean", mean, 60_134.0, 0.05);
    within("max", max, 172_772.0, 0.05);
    if floors == 100 {
        within("all", s.triangles as f64, 1.074e9, 0.05);
        let first = building(Kind::Tower, Some(24), 1).triangles();
        within("24 floors", first as f64, 257_385_000.0, 0.05);
    }
}

#[test]
fn every_opening_opens_and_the_stack_is_one_closed_solid() {
    for (kind, d) in drawings() {
        let carcass = Carcass::new(&d.footprint, &d.storeys);
        for s in &d.storeys {
            let blind: Vec<_> = carcass.blind(s).iter().map(|&g| s.gaps[g].frame).collect();
            assert!(blind.is_empty(), "{}: {blind:?}", kind.name());
        }
        let floors = 3;
        let mut all = carcass.base();
        let mut hollow = 0.0;
        for k in 0..floors {
            let s = &d.storeys[k.min(d.storeys.len() - 1)];
            let wells = Wells { below: k > 0, above: k + 1 < floors };
            all.add(carcass.storey(s, wells).at(0.0, 0.0, HEIGHT * k as f64));
            hollow += s.spaces.iter().map(|r| r.area() * CEILING).sum::<f64>();
            let open = s.gaps.iter().map(|g| g.width * g.thick * (g.height.1 - g.height.0));
            hollow += open.sum::<f64>();
            if wells.above {
                let well = s.spaces.iter().filter_map(|r| r.well.map(|k| r.pieces[k].area()));
                hollow += well.sum::<f64>() * (HEIGHT - CEILING);
            }
        }
        let mut roof = carcass.roof();
        let parapet = roof.volume();
        roof = roof.at(0.0, 0.0, HEIGHT * floors as f64);
        all.add(roof);
        assert!(is_closed(&all), "{}", kind.name());
        let area: f64 = d.footprint.iter().map(|c| c.area()).sum();
        let solid = area * (HEIGHT * floors as f64 + 0.45) - hollow + parapet;
        within(kind.name(), all.volume(), solid, 1e-6);
    }
}

#[test]
fn rooms_keep_apart_and_each_can_be_reached() {
    for (kind, d) in drawings() {
        for s in &d.storeys {
            // Walls are at least 0.14 m thick: no corner of a room is nearer to another room.
            for (i, a) in s.spaces.iter().enumerate() {
                for p in a.pieces.iter().flat_map(|c| &c.0) {
                    let near = s.spaces.iter().position(|b| b.name != a.name && b.holds(*p, 0.1));
                    assert!(near.is_none(), "{}: {} touches another room", kind.name(), a.name);
                }
                let own = d.footprint.iter().any(|f| f.holds(a.pieces[0].middle(), -0.2));
                assert!(own || d.footprint.len() > 1, "room {i} is outside");
            }
            let at = |p: DVec2| s.spaces.iter().position(|r| r.holds(p, 0.0));
            let mut doors = Vec::new();
            for g in s.gaps.iter().filter(|g| g.is_passage()) {
                let beyond = g.thick / 2.0 + 0.2;
                let (a, b) = (at(g.frame.point(0.0, beyond)), at(g.frame.point(0.0, -beyond)));
                if g.filling == Filling::Entrance {
                    assert!(a.is_some() != b.is_some());
                    continue;
                }
                assert!((g.height.1 - g.height.0 - 2.1).abs() < 1e-9 && g.width >= 0.9);
                doors.push((a.unwrap(), b.unwrap(), matches!(g.filling, Filling::Doorway(_))));
            }
            // Most doorways are open, and open ones lead everywhere.
            let shut = doors.iter().filter(|d| !d.2).count();
            assert!(shut > 0 || kind == Kind::Octagon);
            assert!(shut * 4 < doors.len(), "{}", kind.name());
            let mut seen = BTreeSet::from([0]);
            let mut todo = vec![0];
            while let Some(room) = todo.pop() {
                for &(a, b, _) in &doors {
                    let next = if a == room { b } else { a };
                    if (a == room || b == room) && seen.insert(next) {
                        todo.push(next);
                    }
                }
            }
            let lost: Vec<_> = (0..s.spaces.len())
                .filter(|r| !seen.contains(r))
                .map(|r| &s.spaces[r].name)
                .collect();
            assert!(lost.is_empty(), "{}: {lost:?}", kind.name());
        }
    }
}

#[test]
fn furniture_keeps_to_its_room_and_out_of_the_way() {
    for (kind, d) in drawings() {
        let seeds: &[u64] = if kind == Kind::ZBuilding { &[1, 2, 12345] } else { &[1] };
        for &seed in seeds {
            let floors = d.storeys.len() as u32;
            let b = building(kind, Some(floors), seed);
            let mut by_room: BTreeMap<usize, Vec<(&str, Footprint)>> = BTreeMap::new();
            for part in &b.parts {
                let bounds = part.mesh.bounds();
                for copy in part.copies.iter().filter(|c| c.stance != Stance::Built) {
                    let f = Footprint::of_bounds(bounds, copy);
                    by_room.entry(copy.room.unwrap()).or_default().push((&part.name, f));
                }
            }
            let mut room = 0;
            for (k, s) in d.storeys.iter().enumerate() {
                let lift = HEIGHT * k as f64;
                let mut zones = clearances(s);
                zones.extend(leaves(s));
                for space in &s.spaces {
                    let walls = space.walls();
                    let placed = by_room.remove(&room).unwrap_or_default();
                    let name = &b.plan.rooms[room].name;
                    for (i, (what, f)) in placed.iter().enumerate() {
                        assert!(inside(space, &walls, f), "{what} leaves {name}");
                        for c in f.corners() {
                            assert!(space.holds(c, 1e-4), "{what} is not in {name}");
                        }
                        let (low, high) = (f.height.0 - lift, f.height.1 - lift);
                        assert!(low > 0.0 && high < CEILING, "{what}: {low} to {high} in {name}");
                        let here = Footprint { height: (low, high), ..*f };
                        assert!(
                            zones.iter().all(|z| !z.overlaps(&here, 0.013)),
                            "{what} is in a doorway of {name}"
                        );
                        for (other, g) in &placed[..i] {
                            assert!(!f.conflicts(g), "{what} and {other} clash in {name}");
                        }
                        for view in &b.plan.views {
                            assert!(!f.holds(view.eye, 0.15), "{} stands in {what}", view.name);
                        }
                    }
                    room += 1;
                }
            }
            assert!(by_room.is_empty());
            for view in &b.plan.views {
                let at = b.plan.room_at(view.eye).expect("a view's eye is in a room");
                assert!(b.plan.rooms[at].pieces.len() > 1 || b.plan.rooms[at].holds(view.eye, 0.3));
            }
        }
    }
}

#[test]
fn luminaires_hang_in_their_rooms() {
    for (kind, d) in drawings() {
        let b = usual(kind);
        assert_eq!(b.plan.storeys as usize, d.storeys.len());
        let mut found = vec![0; b.plan.rooms.len()];
        for part in &b.parts {
            for copy in part.copies.iter().filter(|c| c.is_lamp) {
                let room = copy.room.unwrap();
                found[room] += 1;
                for (i, t) in part.mesh.triangles.iter().enumerate() {
                    if t.paint == PANEL {
                        let [p, q, r] = part.mesh.corners(i).map(|p| copy.apply(p));
                        let n = (q - p).cross(r - p);
                        assert!(n.z < 0.0 && n.z.abs() > 0.999 * n.length());
                        let name = &b.plan.rooms[room].name;
                        assert!(b.plan.rooms[room].holds((p + q + r) / 3.0, 0.0), "{name}");
                    }
                }
            }
        }
        for (room, n) in b.plan.rooms.iter().zip(found) {
            assert_eq!(room.lamp.as_ref().map_or(0, |l| l.count), n, "{}", room.name);
            if let Some(lamp) = &room.lamp {
                let panels = lamp.points.len() as f64 / f64::from(lamp.count);
                let each = lamp.lumens / panels;
                assert!((400.0..12_000.0).contains(&each), "{}: {each} lm a panel", room.name);
            }
        }
    }
}

#[test]
fn meshes_have_area_paint_and_finite_corners() {
    for kind in [Kind::ZBuilding, Kind::Octagon, Kind::Tower] {
        for part in &usual(kind).parts {
            for (i, t) in part.mesh.triangles.iter().enumerate() {
                let known = t.paint == PANEL || palette::kind(t.paint).is_some();
                assert!(known, "{}: {}", part.name, t.paint);
                let [a, b, c] = part.mesh.corners(i).map(|p| (p * 1e5).round() / 1e5);
                let area = (b - a).cross(c - a).length() / 2.0;
                assert!(area > 1e-10, "{}: triangle {i} at {a}", part.name);
            }
        }
    }
}

/// Every file that a building is written to.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut out = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            out.extend(files(&path));
        } else {
            let name = path.file_name().unwrap().to_str().unwrap().to_owned();
            out.insert(name, std::fs::read(&path).unwrap());
        }
    }
    out
}

#[test]
fn a_seed_fixes_every_byte_and_another_moves_things() {
    for kind in [Kind::ZBuilding, Kind::Tower] {
        let written = |seed: u64| {
            let folder = tempfile::tempdir().unwrap();
            let b = building(kind, Some(2), seed);
            write::write(&b, &folder.path().join("x.toml")).unwrap();
            let files = files(folder.path());
            assert_eq!(files.len() as u32, b.summary().files);
            files
        };
        let (one, again, other) = (written(1), written(1), written(2));
        assert!(one == again);
        let walls = |f: &BTreeMap<String, Vec<u8>>| f["shell-1-first.obj"].clone();
        assert!(walls(&one) == walls(&other) && one != other);
    }
}

/// The triangles of an OBJ text with their materials.
fn triangles(text: &str) -> Vec<([DVec3; 3], String)> {
    let (mut points, mut out, mut material) = (Vec::new(), Vec::new(), String::new());
    for line in text.lines() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let c: Vec<f64> = words.map(|w| w.parse().unwrap()).collect();
                points.push(DVec3::new(c[0], c[1], c[2]));
            }
            Some("usemtl") => material = words.next().unwrap().to_owned(),
            Some("f") => {
                let c: Vec<usize> = words.map(|w| w.parse().unwrap()).collect();
                out.push(([c[0], c[1], c[2]].map(|k| points[k - 1]), material.clone()));
            }
            _ => {}
        }
    }
    out
}

#[test]
fn one_obj_has_the_triangles_of_the_scene() {
    for kind in [Kind::LShape, Kind::ZBuilding] {
        let folder = tempfile::tempdir().unwrap();
        let b = building(kind, Some(1), 1);
        write::write(&b, &folder.path().join("h.toml")).unwrap();
        write::expanded::write(&b, &folder.path().join("h.obj")).unwrap();
        let text = std::fs::read_to_string(folder.path().join("h.obj")).unwrap();
        let flat = triangles(&text);
        assert_eq!(flat.len() as u64, b.triangles());
        let mtl = std::fs::read_to_string(folder.path().join("h.mtl")).unwrap();
        let known: BTreeSet<&str> = mtl.lines().filter_map(|l| l.strip_prefix("newmtl ")).collect();
        // The scene, placed by the rules of its format.
        let scene: toml::Table =
            std::fs::read_to_string(folder.path().join("h.toml")).unwrap().parse().unwrap();
        let number = |v: &toml::Value| v.as_float().or(v.as_integer().map(|i| i as f64)).unwrap();
        let mut k = 0;
        for mesh in scene["mesh"].as_array().unwrap() {
            let file = folder.path().join(mesh["file"].as_str().unwrap());
            let own = triangles(&std::fs::read_to_string(file).unwrap());
            let rows: Vec<Vec<f64>> = match mesh.get("instances_file") {
                Some(list) => {
                    let path = folder.path().join(list.as_str().unwrap());
                    let text = std::fs::read_to_string(path).unwrap();
                    let lines = text.lines().filter(|l| !l.starts_with('#'));
                    lines.map(|l| l.split(' ').map(|w| w.parse().unwrap()).collect()).collect()
                }
                None => {
                    let rows = mesh["instances"].as_array().unwrap().iter();
                    rows.map(|r| r.as_array().unwrap().iter().map(number).collect()).collect()
                }
            };
            for row in rows {
                let (s, c) = row[3].to_radians().sin_cos();
                for (corners, material) in &own {
                    let (got, name) = &flat[k];
                    for (p, q) in corners.iter().zip(got) {
                        let p = *p * row[4];
                        let (x, y) = (c * p.x - s * p.y + row[0], s * p.x + c * p.y + row[1]);
                        let p = DVec3::new(x, y, p.z + row[2]);
                        assert!(p.distance(*q) < 2e-5, "triangle {k}: {p} and {q}");
                    }
                    assert!(known.contains(name.as_str()), "{name}");
                    assert!(name == material || material == PANEL && name.starts_with("panel."));
                    k += 1;
                }
            }
        }
        assert_eq!(k, flat.len());
    }
}

#[test]
fn a_tower_is_too_large_for_one_obj() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tower.obj");
    let b = building(Kind::Tower, Some(2), 1);
    let error = write::expanded::write(&b, &path).unwrap_err().to_string();
    assert!(error.contains("--floors") && error.contains("20000000"), "{error}");
    assert!(!path.exists());
}

#[test]
fn floors_have_limits() {
    for kind in Kind::ALL {
        for floors in [0, kind.most_floors() + 1] {
            let error = design(&Request { kind: *kind, floors: Some(floors), seed: 1 });
            assert!(error.unwrap_err().to_string().contains("--floors"));
        }
        assert_eq!(kind.name().parse::<Kind>().unwrap(), *kind);
    }
    assert!("castle".parse::<Kind>().unwrap_err().to_string().contains("octagon"));
}
