//! Prints what a building is made of, and what is wrong with it.
//!
//! `cargo run -p enf-building --example audit [-- KIND [SEED [FLOORS [FILE]]]]`; with a file, a
//! scene or an OBJ by its ending, it is built and nothing printed but the summary.

use enf_building::carcass::Carcass;
use enf_building::furnish::{Footprint, Stance, clearances, leaves};
use enf_building::mesh::is_closed;
use enf_building::{Kind, Request, assemble, design, octagon, tower, zbuilding};
use std::error::Error;

fn drawing(kind: Kind) -> Option<assemble::Drawing> {
    match kind {
        Kind::ZBuilding => Some(zbuilding::drawing()),
        Kind::Octagon => Some(octagon::drawing()),
        Kind::Tower => Some(tower::drawing()),
        _ => None,
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let argument = |n: usize| std::env::args().nth(n);
    let kind: Kind = argument(1).as_deref().unwrap_or("l-shape").parse()?;
    let seed = argument(2).and_then(|s| s.parse().ok()).unwrap_or(1);
    let floors = argument(3).and_then(|s| s.parse().ok());
    let b = design(&Request { kind, floors, seed })?;
    println!("{:?}", b.summary());
    if let Some(file) = argument(4) {
        let path = std::path::Path::new(&file);
        if file.ends_with(".obj") {
            enf_building::write::expanded::write(&b, path)?;
        } else {
            enf_building::write::write(&b, path)?;
        }
        return Ok(());
    }
    let resident: usize =
        b.parts.iter().map(|p| p.mesh.triangles.len() * 12 + p.mesh.points.len() * 12).sum();
    let copies: usize = b.parts.iter().map(|p| p.copies.len()).sum();
    println!("{} parts, {} copies, meshes {:.1} MB", b.parts.len(), copies, resident as f64 / 1e6);
    let rooms = b.triangles_by_room();
    let inside = &rooms[..rooms.len() - 1];
    println!(
        "per room: mean {}, max {}; outside {}",
        inside.iter().sum::<u64>() / inside.len() as u64,
        inside.iter().max().unwrap_or(&0),
        rooms[inside.len()]
    );
    for (r, room) in b.plan.rooms.iter().enumerate().take(240) {
        println!("{:>7}  {:28} {:5.1} m2", rooms[r], room.name, room.area());
    }
    if let Some(d) = drawing(kind) {
        let carcass = Carcass::new(&d.footprint, &d.storeys);
        for s in &d.storeys {
            for g in carcass.blind(s) {
                println!("BLIND {:?} in {}", s.gaps[g], d.name);
            }
        }
    }
    for p in &b.parts {
        let mut flags = String::new();
        if !is_closed(&p.mesh) {
            flags.push_str("open ");
        }
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
            "{:>9} = {:>6} x {:<5} {:24} {:?} {flags}",
            p.mesh.triangles.len() * p.copies.len(),
            p.mesh.triangles.len(),
            p.copies.len(),
            p.name,
            (high - low).to_array().map(|c| (c * 100.0).round() / 100.0)
        );
    }
    if kind != Kind::LShape {
        return Ok(());
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
