//! `enf-grid`: an acceleration structure for every tile: a wide bounding volume hierarchy, or the paper's uniform
//! grid (section 4.1).
#![forbid(unsafe_code)]

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use enf_geometry::{StructureKind, TileMesh};
use enf_layout::segment::{Codec, ExtentKind, StageKind};
use enf_stage::ordered::ordered;
use enf_stage::session::{self, Announcer, Begin, Session};
use enf_stage::tables::Tables;
use enf_stage::{CommonArgs, IdSink, IdSource, Progress, Result, Selection, say};
use enf_store::{StageWriter, StoreDir, StoreError, encode};
use serde_json::Value;

/// `--structure`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum StructureArg {
    /// What measures best: the hierarchy, in rooms of every size so far.
    #[default]
    Auto,
    /// The paper's uniform grid, in bricks of 4 x 4 x 4 cells.
    Grid,
    /// A bounding volume hierarchy, eight children wide.
    Bvh,
}

/// What decides about the structures. No photon and no picture depends on it.
#[derive(Args, Clone, Debug, Default)]
pub struct GridArgs {
    /// What keeps rays from most triangles
    #[arg(long, value_enum, default_value_t)]
    pub structure: StructureArg,
}

impl GridArgs {
    fn kind(&self) -> StructureKind {
        match self.structure {
            StructureArg::Grid => StructureKind::Grid,
            StructureArg::Auto | StructureArg::Bvh => StructureKind::Bvh,
        }
    }
}

/// `enf-grid`: the command line.
#[derive(clap::Parser, Clone, Debug)]
#[command(name = "enf-grid", version, about = "Build the acceleration structure of every room")]
pub struct Cli {
    /// The store
    #[arg(value_name = "NAME.enf")]
    pub store: PathBuf,
    /// Do not read ids from standard input: all rooms
    #[arg(long)]
    pub all_rooms: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub grid: GridArgs,
    /// Discard another run's grids, and what was made with them
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub common: CommonArgs,
}

/// Runs the stage for the rooms that are asked for. When the last room is done the stage is sealed.
///
/// # Errors
/// As in the table of exit codes; rooms that were announced stay done.
pub fn run(cli: &Cli, ids: IdSource, out: &IdSink) -> Result<Option<Value>> {
    let common = &cli.common;
    let selection = ids.into_selection()?;
    if selection == Selection::Ids(Vec::new()) {
        return Ok(None);
    }
    let store = StoreDir::open(&cli.store)?;
    let mut session = Session::open(common)?;
    let tables = Tables::open(&store, &session.budget)?;
    let rooms = session::rooms_of(&selection, tables.rooms().len())?;

    let mut identity = session::inherit(&store, StageKind::Partition)?;
    let kind = cli.grid.kind();
    identity.push("structure", if kind == StructureKind::Bvh { "bvh" } else { "grid" });
    if session::may_work(&store, StageKind::Grid, cli.force) {
        let tiles = rooms.iter().flat_map(|&r| session::tiles_of(&tables, r));
        if let Some(tile) = tiles.max_by_key(|&t| needs(&tables, t, kind))
            && needs(&tables, tile, kind) > session.budget.available()
        {
            let (needs, memory) = (needs(&tables, tile, kind), common.memory);
            return Err(session::too_small(&tables, tile, needs, &session.budget, memory));
        }
    }
    match session::begin(&store, StageKind::Grid, common.process, &identity, cli.force)? {
        Begin::Finished => {
            say(common, "nothing to do, every structure is there already");
            for &room in &rooms {
                out.print(room)?;
            }
        }
        Begin::Work(writer) => build(cli, &mut session, &tables, *writer, &rooms, out)?,
    }
    let stats = &mut session.stats;
    stats.set("rooms", tables.rooms_without_outside());
    stats.set("tiles", tables.tiles().len());
    stats.set("triangles", tables.scene.triangles);
    stats.set("stored_triangles", tables.scene.stored_triangles);
    Ok(Some(session.finish(common, "grid", &store)?))
}

/// Bytes for building the structure of a tile: mesh, structure while it is built, and its encoding.
fn needs(tables: &Tables, tile: u32, kind: StructureKind) -> u64 {
    let record = &tables.tiles()[tile as usize];
    record.mesh_bytes * 2 + kind.build_bytes(record.triangles)
}

fn build(
    cli: &Cli,
    session: &mut Session,
    tables: &Tables,
    mut writer: StageWriter,
    rooms: &[u32],
    out: &IdSink,
) -> Result<()> {
    let common = &cli.common;
    let kind = cli.grid.kind();
    let extents = match kind {
        StructureKind::Grid => ExtentKind::Grid,
        StructureKind::Bvh => ExtentKind::Bvh,
    };
    let budget = session.budget.clone();
    let made: BTreeSet<u32> =
        writer.extents().filter(|e| e.kind == extents).map(|e| e.id).collect();
    let tiles_of = |room: u32| session::tiles_of(tables, room);
    let todo: Vec<u32> =
        rooms.iter().flat_map(|&r| tiles_of(r)).filter(|t| !made.contains(t)).collect();

    let needs = |tile: u32| needs(tables, tile, kind);
    let largest = todo.iter().copied().max_by_key(|&t| needs(t));
    let threads = match largest {
        Some(tile) => common.threads.min((budget.available() / needs(tile).max(1)) as usize).max(1),
        None => 1,
    };
    let _work = budget.reserve(
        largest.map_or(0, |t| needs(t) - tables.tiles()[t as usize].mesh_bytes * 2)
            * threads as u64,
        "structures being built",
    )?;

    let progress = Progress::new(common, "grid", Some(todo.len() as u64), "tiles");
    let place: BTreeMap<u32, usize> = todo.iter().enumerate().map(|(i, &t)| (t, i)).collect();
    let lanes: Vec<_> = (0..threads).map(|t| format!("grid {t}")).collect();
    let timeline = &session.timeline;
    let mut announcer = Announcer::new(rooms, out);
    ordered(
        threads,
        todo.len(),
        |worker, i| {
            let lane = timeline.lane(&lanes[worker]);
            let _span = lane.span("build structure", todo[i]);
            let extent = tables.partition.single(ExtentKind::Geometry, todo[i])?;
            let blob = tables.partition.read(extent, &budget, "mesh of a tile")?;
            let mesh = TileMesh::from_blob(&blob).map_err(StoreError::from)?;
            Ok(encode(&kind.build(&mesh, tables.scene.delta), Codec::ZstdPlanes)?)
        },
        |i, encoded| {
            let triangles = tables.tiles()[todo[i] as usize].triangles;
            writer.append_encoded(extents, todo[i], triangles, &encoded)?;
            progress.set(i as u64 + 1);
            announcer.step(&mut writer, &|room| {
                tiles_of(room).all(|t| place.get(&t).is_none_or(|&at| at <= i))
            })
        },
    )?;
    announcer.end(&mut writer, &|_| true)?;
    progress.finish();
    let made = writer.extents().filter(|e| e.kind == extents).count();
    if made == tables.tiles().len() {
        writer.seal()?;
    }
    Ok(())
}
