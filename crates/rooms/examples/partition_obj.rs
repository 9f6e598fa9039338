//! Divides an OBJ (metres, z up) into rooms and prints them:
//! `cargo run --release --example partition_obj -- building.obj [--no OBJECT_PREFIX]... [--rooms N] [--tiles N]`
//!
//! Materials with `d` below 1 are see-through. `--no IfcDoor` leaves out objects by name.

use enf_rooms::{Bsp, Options, RoomCount, TileLimit, partition};
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut path, mut without, mut rooms, mut limit) = (None, Vec::new(), RoomCount::Auto, None);
    let mut verbose = false;
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--no" => without.extend(args.next()),
            "--rooms" => rooms = RoomCount::Exactly(args.next().unwrap_or_default().parse()?),
            "--tiles" => limit = Some(args.next().unwrap_or_default().parse()?),
            "-v" => verbose = true,
            _ => path = Some(arg),
        }
    }
    let path = path.ok_or("an OBJ file is needed")?;
    let load = tobj::LoadOptions { triangulate: true, ..Default::default() };
    let (models, materials) = tobj::load_obj(&path, &load)?;
    let materials = materials.unwrap_or_default();
    let (mut triangles, mut opaque) = (Vec::new(), Vec::new());
    for model in &models {
        if without.iter().any(|w| model.name.starts_with(w.as_str())) {
            continue;
        }
        let clear = model.mesh.material_id.and_then(|m| materials.get(m)).and_then(|m| m.dissolve);
        for t in model.mesh.indices.chunks_exact(3) {
            triangles
                .push([0, 1, 2].map(|k| {
                    [0, 1, 2].map(|c| model.mesh.positions[t[k] as usize * 3 + c] as f32)
                }));
            opaque.push(clear.unwrap_or(1.0) >= 1.0);
        }
    }
    let mut min = [f32::INFINITY; 3];
    let mut max = [f32::NEG_INFINITY; 3];
    for p in triangles.iter().flatten() {
        for k in 0..3 {
            min[k] = min[k].min(p[k]);
            max[k] = max[k].max(p[k]);
        }
    }
    let extent = (0..3).map(|k| (max[k] - min[k]).powi(2)).sum::<f32>().sqrt();
    let reach = (0..3).fold(extent, |m, k| m.max(min[k].abs()).max(max[k].abs()));
    let delta = (reach as u32).next_power_of_two() as f32 / 524_288.0;
    let options = Options { delta, bounds_min: min, bounds_max: max, rooms, hints: Vec::new() };
    let start = Instant::now();
    let mut parted = partition(&triangles, &|i| opaque[i], &options)?;
    println!("{} triangles, partition {:.2} s", triangles.len(), start.elapsed().as_secs_f64());
    if let Some(limit) = limit {
        let start = Instant::now();
        parted.cut_tiles(&triangles, TileLimit::Triangles(limit))?;
        println!(
            "tiles {:.2} s, oversized {:?}",
            start.elapsed().as_secs_f64(),
            parted.oversized()
        );
    }
    let count = parted.room_count_without_outside();
    let start = Instant::now();
    let tables = parted.finish(&triangles);
    println!("tables {:.2} s", start.elapsed().as_secs_f64());
    Bsp::new(&tables.planes, &tables.nodes, &tables.leaves, &tables.faces, f64::from(delta))?;
    let solid = tables.leaves.iter().filter(|l| l.flags & 1 != 0).count();
    println!(
        "{count} rooms, outside {:?}, {} leaves ({solid} solid), {} faces, {} portals, {} tiles, {} stored",
        tables.outside,
        tables.leaves.len(),
        tables.faces.len(),
        tables.portals.len() / 2,
        tables.tiles.len(),
        tables.tile_triangles.len()
    );
    for (i, r) in tables.rooms.iter().enumerate() {
        println!(
            "{i:4} {:7.2} m2 {:8.2} m3  {:?} .. {:?}  inside {:?}  {} triangles, {} portals, {} tiles",
            r.floor_area_m2,
            r.volume_m3,
            r.min,
            r.max,
            r.inside,
            r.triangles,
            r.portal_count,
            r.tile_count
        );
        if verbose {
            let first = r.first_portal as usize;
            for p in &tables.portals[first..first + r.portal_count as usize] {
                println!("       -> {} {:.3} m2 at {:?}", p.other, p.area_m2, p.centre);
            }
        }
    }
    Ok(())
}
