//! `enf-partition`: a building file becomes rooms, portals and tiles in a store.
//!
//! The scene streams past three times at most: its large triangles show where the walls are
//! (`survey`), all of them are sorted to the rooms that they touch (`route`, `bins`), and each room's are
//! cut into tiles and written (`tiles`). So the scene may be larger than memory.
#![forbid(unsafe_code)]

mod args;
mod bins;
mod build;
mod luminaires;
mod openings;
mod route;
mod survey;
mod textures;
mod tiles;

use std::path::{Path, PathBuf};

use enf_layout::light::LIGHT_SKY;
use enf_layout::segment::StageKind;
use enf_rooms::RoomCount;
use enf_scene::{LoadOptions, Scene, Spool, Up};
use enf_stage::session::{self, Begin, Session};
use enf_stage::{Failure, IdSink, Result, interrupt, say, warn};
use enf_store::{Identity, StageWriter, StoreDir};

pub use args::{Cli, DoorsArg, HintsArg, PartitionArgs, Rooms, UpArg};
pub use luminaires::parse_lux;

/// Lists what a scene is made of, for [`session::begin`].
fn identity(scene: &Scene, args: &PartitionArgs) -> Identity {
    let mut identity = Identity::default();
    for (i, input) in scene.inputs.iter().enumerate() {
        let name = input.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into());
        identity.push(format!("input-{i}"), format!("{name} {:032x}", input.hash));
    }
    let frame = scene.frame();
    identity.push("units", frame.units);
    identity.push("up", if frame.up == Up::Y { "y" } else { "z" });
    identity.push("doors", if args.doors == DoorsArg::Open { "open" } else { "as-modelled" });
    identity.push("hints", if args.hints == HintsArg::Use { "use" } else { "ignore" });
    identity.push(
        "rooms",
        match args.rooms.0 {
            RoomCount::Auto => "auto".to_string(),
            RoomCount::Exactly(n) => n.to_string(),
        },
    );
    identity
        .push("ceiling-lights", args.ceiling_lights.map_or("none".into(), |l| format!("{l} lx")));
    if !scene.textures.is_empty() {
        identity.push("texture-memory", args.texture_memory);
    }
    identity
}

/// Runs the stage.
///
/// # Errors
/// As in the table of exit codes.
pub fn run(cli: &Cli, out: &IdSink) -> Result<serde_json::Value> {
    let (common, args) = (&cli.common, &cli.partition);
    let mut session = Session::open(common)?;
    let options = LoadOptions {
        units: args.units,
        up: args.up.map(Up::from),
        doors: args.doors.into(),
        spool: Some(Spool { folder: place_for(&cli.output), above: common.memory / LARGE_MESH }),
        strict: args.strict,
    };
    let lane = session.timeline.lane("partition");
    let scene = {
        let _dense = interrupt::nothing_to_lose()?;
        let _span = lane.span("read scene", 0u32);
        enf_scene::load(&cli.scene, &options).map_err(build::lost)?
    };
    if let Some(unknown) = cli.views.iter().find(|v| !scene.views.iter().any(|s| s.name == **v)) {
        let known: Vec<&str> = scene.views.iter().map(|v| v.name.as_str()).collect();
        return Err(enf_stage::failure::no_view(unknown, &known));
    }
    let identity = identity(&scene, args);
    let store = create(&cli.output)?;
    let finished =
        match session::begin(&store, StageKind::Partition, common.process, &identity, cli.force)? {
            Begin::Finished => true,
            Begin::Work(writer) => {
                for warning in &scene.warnings {
                    warn(common, warning);
                }
                let writer = if writer.resumed() {
                    // Half a partition is worth nothing: it is made again from the same input.
                    drop(writer);
                    store.discard_from(StageKind::Partition)?;
                    Box::new(StageWriter::open(
                        &store,
                        StageKind::Partition,
                        common.process,
                        &identity,
                    )?)
                } else {
                    writer
                };
                if let Err(e) = build::build(cli, &mut session, &scene, &store, *writer) {
                    // Nor is it worth its place on the disk.
                    let _ = store.discard_from(StageKind::Partition);
                    return Err(e);
                }
                false
            }
        };
    drop(scene);
    let tables = enf_stage::tables::Tables::open(&store, &session.budget).map_err(|e| {
        // Its own output is damaged: it can make it again.
        if e.hint.is_none() { e.with_hint(session::MAKE_AGAIN) } else { e }
    })?;
    if finished {
        say(common, "nothing to do, the rooms are there already");
    }
    report(cli, &mut session, &tables);
    let stats = session.finish(common, "partition", &store)?;
    for room in 0..tables.rooms().len() as u32 {
        out.print(room)?;
    }
    Ok(stats)
}

/// A mesh that would take more than one of so many parts of the budget is read from disk on each pass.
const LARGE_MESH: u64 = 8;

/// Where the store is going to be: the file system that has room for it has room for a large mesh.
fn place_for(store: &Path) -> PathBuf {
    let existing = store.ancestors().skip(1).find(|p| p.is_dir());
    existing.map_or_else(|| PathBuf::from("."), Path::to_path_buf)
}

fn create(path: &Path) -> Result<StoreDir> {
    if path.exists() && !path.is_dir() {
        return Err(Failure::usage(format!("{} exists and is no store", path.display()))
            .with_hint("choose another name for -o; a store is a folder NAME.enf"));
    }
    Ok(StoreDir::create(path)?)
}

fn report(cli: &Cli, session: &mut Session, tables: &enf_stage::tables::Tables) {
    let rooms = tables.rooms_without_outside();
    let outside = tables.scene.outside;
    let own = tables.rooms().iter().enumerate().filter(|(i, _)| *i as u32 != outside);
    let triangles: Vec<u64> = own.map(|(_, r)| r.triangles).collect();
    let portals: Vec<_> = tables.portals().iter().filter(|p| p.room < p.other).collect();
    // An empty sum of floats is -0.
    let area = portals.iter().fold(0.0, |sum, p| sum + f64::from(p.area_m2));
    let stats = &mut session.stats;
    stats.set("rooms", rooms);
    stats.set("portals", portals.len());
    stats.set("portal_area_m2", area);
    stats.set("triangles", tables.scene.triangles);
    stats.set("room_triangles_mean", triangles.iter().sum::<u64>() as f64 / rooms.max(1) as f64);
    stats.set("room_triangles_max", triangles.iter().max().copied().unwrap_or(0));
    stats.set("stored_triangles", tables.scene.stored_triangles);
    stats.set("tiles", tables.tiles().len());
    stats.set("leaves", tables.leaves().len());
    stats.set("lights", tables.lights().len());
    let sky = tables.lights().iter().filter(|l| l.kind == LIGHT_SKY && l.emitter_count > 0);
    stats.set("sky_openings", sky.count());
    say(
        &cli.common,
        format!(
            "{} triangles, {rooms} rooms in {} tiles, {} portals ({area:.1} m2), {} lights",
            tables.scene.triangles,
            tables.tiles().len(),
            portals.len(),
            tables.lights().len()
        ),
    );
}
