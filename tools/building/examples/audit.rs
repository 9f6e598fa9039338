//! Prints what a building is made of, and what is wrong with it.
//!
//! `cargo run -p enf-building --example audit [-- SEED [SCENE.toml]]`; with a file it is built.

use enf_building::furnish::{Footprint, Stance, clearances, leaves};
use enf_building::mesh::is_closed;
use enf_building::{Kind, Request, design};

fn main() -> Result<(), enf_building::BuildingError> {
    let seed = std::env::args().nth(1).and_then(|s| s.parse().ok()).unwrap_or(1);
    let request = Request { kind: Kind::LShape, floors: None, seed };
    if let Some(path) = std::env::args().nth(2) {
        enf_building::generate(&request, std::path::Path::new(&path))?;
    }
    let b = design(&request)?;
    println!("{:?}", b.summary());
    let mut rooms = vec![0usize; b.plan.rooms.len() + 1];
    let mut shares = std::collections::BTreeMap::new();
    b.for_each_triangle(|part, _, t| {
        let c = (t[0] + t[1] + t[2]) / 3.0;
        // Walls belong to the room they face.
        let n = (t[1] - t[0]).cross(t[2] - t[0]).normalize_or_zero() * 0.01;
        let room = b.plan.room_at(c).or(b.plan.room_at(c + n)).or(b.plan.room_at(c - n));
        rooms[room.unwrap_or(b.plan.rooms.len())] += 1;
        *shares.entry((room, part)).or_insert(0usize) += 1;
    });
    for (r, room) in b.plan.rooms.iter().enumerate() {
        println!("{:>7}  {:20} {:5.1} m2", rooms[r], room.name, room.area());
        let mut list: Vec<_> = shares.iter().filter(|((q, _), _)| *q == Some(r)).collect();
        list.sort_by_key(|(_, n)| std::cmp::Reverse(**n));
        let text: Vec<_> =
            list.iter().map(|((_, p), n)| format!("{} {n}", b.parts[*p].name)).collect();
        println!("           {}", text.join(", "));
    }
    let inside: usize = rooms[..b.plan.rooms.len()].iter().sum();
    println!(
        "{:>7}  elsewhere; mean in rooms {}",
        rooms[b.plan.rooms.len()],
        inside / b.plan.rooms.len()
    );
    let mut parts: Vec<_> = b.parts.iter().collect();
    parts.sort_by_key(|p| std::cmp::Reverse(p.mesh.triangles.len() * p.copies.len()));
    for p in parts {
        let flags = match (is_closed(&p.mesh), p.mesh.volume() > 0.0) {
            (true, true) => "",
            (true, false) => "INWARD",
            (false, _) => "open",
        };
        let flat = (0..p.mesh.triangles.len())
            .filter(|&i| {
                let [a, b, c] = p.mesh.corners(i).map(|p| (p * 1e5).round() / 1e5);
                (b - a).cross(c - a).length() < 2e-10
            })
            .collect::<Vec<_>>();
        if let Some(&i) = flat.first() {
            let t = p.mesh.triangles[i];
            println!("FLAT {} {}: {} at {:?}", p.name, flat.len(), t.paint, p.mesh.corners(i));
        }
        let (low, high) = p.mesh.bounds();
        println!(
            "{:>7} = {:>6} x {:<3} {:24} {:?} {flags}",
            p.mesh.triangles.len() * p.copies.len(),
            p.mesh.triangles.len(),
            p.copies.len(),
            p.name,
            (high - low).to_array().map(|c| (c * 100.0).round() / 100.0)
        );
    }
    let zones = clearances(&b.plan);
    let open = leaves(&b.plan);
    let mut all: Vec<(String, usize, Footprint)> = Vec::new();
    for p in &b.parts {
        for c in p.copies.iter().filter(|c| c.room.is_some()) {
            let f = Footprint::of(&p.mesh, c);
            let room = c.room.unwrap_or(0);
            let name = format!("{} in {}", p.name, b.plan.rooms[room].name);
            let inside = f
                .corners()
                .iter()
                .all(|q| b.plan.rooms[room].rects.iter().any(|r| r.holds(q.x, q.y, 1e-6)));
            if !inside && f.stance != Stance::Built {
                println!("OUT {name} {f:?}");
            }
            if f.stance != Stance::Flat && zones.iter().any(|z| z.overlaps(&f, 0.0)) {
                println!("DOORWAY {name} {:?}", f.corners());
            }
            if open.iter().any(|z| z.conflicts(&f)) {
                println!("LEAF {name} {:?}", f.corners());
            }
            for (other, r, g) in &all {
                if *r == room && f.conflicts(g) {
                    println!("CLASH {name} with {other}");
                }
            }
            for v in &b.plan.views {
                if f.holds(v.eye, 0.1) {
                    println!("EYE {} in {name}", v.name);
                }
            }
            all.push((name, room, f));
        }
    }
    Ok(())
}
