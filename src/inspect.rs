//! `enfilade inspect`: what is in a store, and whether it is sound.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use enf_layout::bsp::LEAF_OUTSIDE;
use enf_layout::journal::LedgerRecord;
use enf_layout::light::{
    LIGHT_AREA, LIGHT_POINT, LIGHT_POINT_LAMBERT, LIGHT_PROFILE, LIGHT_SKY, LIGHT_SPOT, LIGHT_SUN,
};
use enf_layout::photon::PhotonRecord;
use enf_layout::segment::{ExtentKind, StageKind};
use enf_stage::tables::Tables;
use enf_stage::{Failure, IoContext, Result};
use enf_store::{MemoryBudget, StageReader, StageState, StoreDir, StoreError, verify};
use serde_json::{Value, json};
use xxhash_rust::xxh3::xxh3_128;
use zerocopy::IntoBytes;

/// What is hashed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum DigestKind {
    /// The scene's triangles, once each.
    Geometry,
    /// The stored photons, once each, whatever rooms and tiles they lie in.
    Photons,
    /// The photon maps, room by room: records and structure.
    Maps,
}

/// `enfilade inspect`.
#[derive(Args, Debug)]
pub(crate) struct InspectArgs {
    /// The store
    #[arg(value_name = "NAME.enf")]
    store: PathBuf,
    /// List the rooms
    #[arg(long)]
    rooms: bool,
    /// List the portals
    #[arg(long)]
    portals: bool,
    /// List the lights: kind, luminous flux, place, the file of a luminaire
    #[arg(long)]
    lights: bool,
    /// Check every byte against the seals
    #[arg(long)]
    verify: bool,
    /// List what was emitted, absorbed, escaped and passed on, per room
    #[arg(long)]
    ledger: bool,
    /// Draw the floor plans, storey by storey, as a picture for a browser or a printer
    #[arg(long, value_name = "FILE.svg")]
    plan: Option<PathBuf>,
    /// Print JSON instead of text
    #[arg(long)]
    json: bool,
    /// Print a hash that does not depend on budget, threads or order
    #[arg(long, value_name = "WHAT", value_enum)]
    digest: Option<DigestKind>,
}

/// Lumens per watt of the scalar flux.
const LUMENS_PER_WATT: f64 = 179.0;

/// What reading a store may hold in memory.
const BUDGET: u64 = 1 << 30;

/// Prints a line; a reader that is gone is no error.
fn print(line: &str) -> Result<bool> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{line}").and_then(|()| out.flush()) {
        Ok(()) => Ok(true),
        Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(false),
        Err(e) => Err(Failure::io(format!("cannot print: {e}"))),
    }
}

/// Runs the subcommand.
pub(crate) fn run(args: &InspectArgs) -> Result<()> {
    let store = StoreDir::open(&args.store)?;
    if args.verify {
        return verify_all(&store, args.json);
    }
    let budget = MemoryBudget::new(BUDGET);
    if let Some(kind) = args.digest {
        let digest = digest(&store, &budget, kind)?;
        return print(&digest).map(drop);
    }
    let tables = Tables::open(&store, &budget)?;
    if let Some(path) = &args.plan {
        let svg = crate::plan::draw(&tables)?;
        return std::fs::write(path, svg).at("write", path);
    }
    let mut answer = serde_json::Map::new();
    if args.rooms {
        answer.insert("rooms".into(), rooms(&tables));
    }
    if args.portals {
        answer.insert("portals".into(), portals(&tables));
    }
    if args.lights {
        answer.insert("lights".into(), lights(&tables));
    }
    if args.ledger {
        answer.insert("ledger".into(), ledger(&store, &budget)?);
    }
    if answer.is_empty() {
        answer.insert("store".into(), overview(&store, &tables)?);
    }
    if args.json {
        let text = serde_json::to_string_pretty(&answer).map_err(Failure::internal)?;
        return print(&text).map(drop);
    }
    for value in answer.values() {
        let lines: Vec<String> = match value {
            Value::Array(rows) => table(rows),
            Value::Object(fields) => {
                fields.iter().map(|(k, v)| format!("{k:<20} {}", plain(v))).collect()
            }
            other => vec![plain(other)],
        };
        for line in lines {
            if !print(&line)? {
                return Ok(());
            }
        }
    }
    Ok(())
}

fn plain(value: &Value) -> String {
    match value {
        Value::String(s) => s.clone(),
        Value::Number(n) if n.is_f64() => {
            let x = n.as_f64().unwrap_or(0.0);
            if x != 0.0 && x.abs() < 0.01 { format!("{x:.3e}") } else { format!("{x:.3}") }
        }
        Value::Array(items) => items.iter().map(plain).collect::<Vec<_>>().join(" "),
        other => other.to_string(),
    }
}

/// Aligned columns with a heading.
fn table(rows: &[Value]) -> Vec<String> {
    let Some(Value::Object(first)) = rows.first() else { return Vec::new() };
    let keys: Vec<&String> = first.keys().collect();
    let mut cells: Vec<Vec<String>> = vec![keys.iter().map(|k| (*k).clone()).collect()];
    for row in rows {
        cells.push(keys.iter().map(|k| plain(&row[k.as_str()])).collect());
    }
    let widths: Vec<usize> =
        (0..keys.len()).map(|c| cells.iter().map(|r| r[c].len()).max().unwrap_or(0)).collect();
    let line = |row: &Vec<String>| {
        let columns: Vec<String> =
            row.iter().zip(&widths).map(|(cell, &w)| format!("{cell:>w$}")).collect();
        columns.join("  ").trim_end().to_string()
    };
    cells.iter().map(line).collect()
}

fn rooms(tables: &Tables) -> Value {
    tables
        .rooms()
        .iter()
        .enumerate()
        .map(|(id, room)| {
            json!({
                "room": id,
                "name": tables.names.rooms.get(id).filter(|n| !n.is_empty()),
                "kind": if room.flags & LEAF_OUTSIDE != 0 { "outside" } else { "room" },
                "floor_area_m2": room.floor_area_m2,
                "volume_m3": room.volume_m3,
                "triangles": room.triangles,
                "tiles": room.tile_count,
                "portals": room.portal_count,
                "inside": room.inside,
                "min": room.min,
                "max": room.max,
            })
        })
        .collect()
}

fn portals(tables: &Tables) -> Value {
    tables
        .portals()
        .iter()
        .filter(|p| p.room < p.other)
        .map(|p| {
            json!({
                "room": p.room,
                "other": p.other,
                "area_m2": p.area_m2,
                "centre": p.centre,
                "pieces": p.piece_count,
            })
        })
        .collect()
}

fn lights(tables: &Tables) -> Value {
    let names = &tables.names;
    tables
        .lights()
        .iter()
        .enumerate()
        .map(|(id, light)| {
            let kind = match light.kind {
                LIGHT_AREA => "area",
                LIGHT_POINT => "point",
                LIGHT_POINT_LAMBERT => "lambert-point",
                LIGHT_SPOT => "spot",
                LIGHT_PROFILE => "ies",
                LIGHT_SKY => "sky",
                LIGHT_SUN => "sun",
                _ => "other",
            };
            let [r, g, b] = light.flux_w.map(f64::from);
            // From the axis, to where a spot light is dark.
            let outer = (light.kind == LIGHT_SPOT)
                .then(|| f64::from(light.cone[1].clamp(-1.0, 1.0)).acos().to_degrees());
            json!({
                "light": id,
                "name": names.lights.get(id),
                "kind": kind,
                "lumens": LUMENS_PER_WATT * (0.2126 * r + 0.7152 * g + 0.0722 * b),
                "flux_w": light.flux_w,
                "position": light.position,
                "axis": light.axis,
                "area_m2": light.area_m2,
                "outer_degrees": outer,
                "profile": (light.kind == LIGHT_PROFILE)
                    .then(|| names.profiles.get(light.profile as usize)),
            })
        })
        .collect()
}

fn ledger(store: &StoreDir, budget: &MemoryBudget) -> Result<Value> {
    let reader = StageReader::open_unsealed(store, StageKind::Trace)?;
    let totals = enf_trace::Totals::read(&reader, budget)?;
    // Photons that entered and left each room.
    let mut passed: BTreeMap<u32, (u64, u64)> = BTreeMap::new();
    for (&(from, to), &(photons, _)) in &totals.passages {
        passed.entry(from).or_default().1 += photons;
        passed.entry(to).or_default().0 += photons;
    }
    let scalar = |rgb: [f64; 3]| 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
    let row = |room: Value, l: &LedgerRecord, (entered, left): (u64, u64)| {
        json!({
            "room": room,
            "emitted": l.emitted,
            "entered": entered,
            "left": left,
            "absorbed": l.absorbed,
            "escaped": l.escaped,
            "stored": l.stored,
            "emitted_w": scalar(l.emitted_w),
            "absorbed_w": scalar(l.absorbed_w),
            "escaped_w": scalar(l.escaped_w),
        })
    };
    let mut sum = LedgerRecord { reflections_min: u64::MAX, ..LedgerRecord::default() };
    let mut through = (0, 0);
    let mut rows: Vec<Value> = Vec::new();
    for (room, line) in &totals.ledger {
        enf_trace::add_ledger(&mut sum, line);
        let passed = passed.get(room).copied().unwrap_or_default();
        through.0 += passed.0;
        through.1 += passed.1;
        rows.push(row(json!(room), line, passed));
    }
    rows.push(row(json!("all"), &sum, through));
    Ok(Value::Array(rows))
}

fn overview(store: &StoreDir, tables: &Tables) -> Result<Value> {
    let mut stages = Vec::new();
    for stage in StageKind::ALL {
        let state = match store.stage_state(stage)? {
            StageState::Sealed => "finished",
            StageState::Unsealed => "unfinished",
            StageState::Absent => continue,
        };
        stages.push(Value::String(format!("{}: {state}", stage.name())));
    }
    Ok(json!({
        "scene": tables.names.scene,
        "triangles": tables.scene.triangles,
        "stored_triangles": tables.scene.stored_triangles,
        "rooms": tables.rooms_without_outside(),
        "tiles": tables.tiles().len(),
        "leaves": tables.leaves().len(),
        "portals": tables.portals().iter().filter(|p| p.room < p.other).count(),
        "lights": tables.lights().len(),
        "materials": tables.materials().len(),
        "views": tables.names.views,
        "delta_m": tables.scene.delta,
        "origin_m": tables.scene.origin,
        "stages": stages,
    }))
}

/// Count and sum modulo 2^128 of a hash per item, in hexadecimal.
fn digest(store: &StoreDir, budget: &MemoryBudget, kind: DigestKind) -> Result<String> {
    let (mut count, mut sum) = (0u64, 0u128);
    match kind {
        DigestKind::Geometry => {
            let tables = Tables::open(store, budget)?;
            count = tables.scene.triangles;
            sum = u128::from_le_bytes(tables.scene.geometry_digest);
        }
        DigestKind::Photons => {
            let reader = StageReader::open(store, StageKind::Trace)?;
            for extent in reader.extents(ExtentKind::Photons) {
                let block = reader.read(extent, budget, "block of photons")?;
                let records = block.as_slice_of::<PhotonRecord>().map_err(StoreError::from)?;
                count += records.len() as u64;
                for record in records {
                    sum = sum.wrapping_add(xxh3_128(record.as_bytes()));
                }
            }
        }
        DigestKind::Maps => {
            let reader = StageReader::open(store, StageKind::Kdtree)?;
            for extent in reader.extents(ExtentKind::Map) {
                let map = reader.read(extent, budget, "photon map")?;
                let mut item = extent.id.to_le_bytes().to_vec();
                item.extend_from_slice(&xxh3_128(&map).to_le_bytes());
                count += extent.count;
                sum = sum.wrapping_add(xxh3_128(&item));
            }
        }
    }
    Ok(format!("{count:016x}{sum:032x}"))
}

fn verify_all(store: &StoreDir, as_json: bool) -> Result<()> {
    let mut rows = Vec::new();
    for stage in StageKind::ALL {
        match store.stage_state(stage)? {
            StageState::Absent => {}
            StageState::Unsealed => eprintln!(
                "enfilade: {}: {} is unfinished; the same command goes on with it",
                store.path().display(),
                stage.name()
            ),
            StageState::Sealed => {
                let verified = verify(store, stage)?;
                rows.push(json!({
                    "stage": stage.name(),
                    "files": verified.files,
                    "bytes": verified.bytes,
                    "state": "sound",
                }));
            }
        }
    }
    if rows.is_empty() {
        return Err(Failure::input(format!("{} holds no finished stage", store.path().display())));
    }
    if as_json {
        let text = serde_json::to_string_pretty(&rows).map_err(Failure::internal)?;
        return print(&text).map(drop);
    }
    for line in table(&rows) {
        if !print(&line)? {
            break;
        }
    }
    Ok(())
}
