//! `enf-kdtree`: every room's photons become a photon map, halo included (the paper, sections 3 and 8).
#![forbid(unsafe_code)]

use std::collections::BTreeSet;
use std::path::PathBuf;

use clap::Args;
use enf_illumination::photon_map::{self, PortalSet, build_tree, wants_halo};
use enf_layout::photon::{PHOTON_DIRECT, PHOTON_HALO, PhotonRecord};
use enf_layout::segment::{Codec, ExtentKind, StageKind};
use enf_stage::ordered::ordered;
use enf_stage::session::{self, Announcer, Begin, Session};
use enf_stage::tables::Tables;
use enf_stage::{CommonArgs, Failure, IdSink, IdSource, Progress, Result, Selection, say};
use enf_store::{Array, Buffer, MemoryBudget, StageReader, StageWriter, StoreDir};
use serde_json::Value;
use zerocopy::{FromBytes, IntoBytes};

/// What decides about the maps.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Photon map options")]
pub struct KdtreeArgs {
    /// Largest radius that irradiance will be gathered from, and width of the halo, m
    #[arg(long, value_name = "METRES", default_value_t = 0.6, value_parser = parse_radius)]
    pub gather_radius: f32,
}

fn parse_radius(text: &str) -> std::result::Result<f32, String> {
    match text.parse::<f32>() {
        Ok(r) if r.is_finite() && r > 0.0 => Ok(r),
        _ => Err("a positive number of metres".into()),
    }
}

/// `enf-kdtree`: the command line.
#[derive(clap::Parser, Clone, Debug)]
#[command(name = "enf-kdtree", version, about = "Build the photon map of every room")]
pub struct Cli {
    /// The store
    #[arg(value_name = "NAME.enf")]
    pub store: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub kdtree: KdtreeArgs,
    /// Do not read ids from standard input: all rooms
    #[arg(long)]
    pub all_rooms: bool,
    /// Discard another run's maps, and what was made with them
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
    let photons = StageReader::open(&store, StageKind::Trace)?;
    let rooms = session::rooms_of(&selection, tables.rooms().len())?;

    let mut identity = session::inherit(&store, StageKind::Trace)?;
    identity.push("gather-radius", cli.kdtree.gather_radius);
    match session::begin(&store, StageKind::Kdtree, common.process, &identity, cli.force)? {
        Begin::Finished => {
            say(common, "nothing to do, every map is there already");
            for &room in &rooms {
                out.print(room)?;
            }
        }
        Begin::Work(writer) => build(cli, &mut session, &tables, &photons, *writer, &rooms, out)?,
    }
    session.stats.set("rooms", tables.rooms_without_outside());
    Ok(Some(session.finish(common, "kdtree", &store)?))
}

/// Photons that a room's extents hold.
fn stored(photons: &StageReader, room: u32) -> u64 {
    photons.find(ExtentKind::Photons, room).iter().map(|e| e.count).sum()
}

fn build(
    cli: &Cli,
    session: &mut Session,
    tables: &Tables,
    photons: &StageReader,
    mut writer: StageWriter,
    rooms: &[u32],
    out: &IdSink,
) -> Result<()> {
    let (common, budget) = (&cli.common, session.budget.clone());
    let made: BTreeSet<u32> =
        writer.extents().filter(|e| e.kind == ExtentKind::Map).map(|e| e.id).collect();
    let todo: Vec<u32> = rooms.iter().copied().filter(|r| !made.contains(r)).collect();
    // The gathered list, and the blob in which the tree is built.
    let record = size_of::<PhotonRecord>() as u64;
    let needs = |room: u32| stored(photons, room) * record * 2 + (1 << 20);
    let largest = todo.iter().copied().map(needs).max().unwrap_or(0);
    // Two rooms at once where both fit with room for their halos, else all threads on one tree.
    let at_once = if largest * 5 / 2 < budget.available() / common.threads as u64 {
        common.threads
    } else {
        1
    };
    let threads_each = common.threads / at_once;

    let radius = cli.kdtree.gather_radius;
    let total: u64 = todo.iter().map(|&r| stored(photons, r)).sum();
    let progress = Progress::new(common, "photon maps", Some(total), "photons");
    let names: Vec<_> = (0..at_once).map(|t| format!("kdtree {t}")).collect();
    let timeline = &session.timeline;
    let mut announcer = Announcer::new(rooms, out);
    let (mut sum, mut halo_sum, mut done) = (0, 0, 0);
    let mut finished = made;
    ordered(
        at_once,
        todo.len(),
        |worker, i| {
            let lane = timeline.lane(&names[worker]);
            let _span = lane.span("build map", todo[i]);
            map_of(tables, photons, &budget, todo[i], radius, threads_each)
        },
        |i, map| {
            writer.append(ExtentKind::Map, todo[i], map.photons, &map.blob, Codec::Raw)?;
            sum += map.photons;
            halo_sum += map.halo;
            done += stored(photons, todo[i]);
            progress.set(done);
            finished.insert(todo[i]);
            announcer.step(&mut writer, &|room| finished.contains(&room))
        },
    )?;
    announcer.end(&mut writer, &|room| finished.contains(&room))?;
    progress.finish();
    session.stats.set("map_photons", sum);
    session.stats.set("map_halo_photons", halo_sum);
    if finished.len() == tables.rooms().len() {
        writer.seal()?;
        say(common, format!("{sum} indirect photons in the maps, {halo_sum} of them halo"));
    }
    Ok(())
}

struct Map {
    blob: Buffer,
    photons: u64,
    halo: u64,
}

/// The map of one room: its own indirect photons, and its neighbours' within reach of a shared portal.
fn map_of(
    tables: &Tables,
    photons: &StageReader,
    budget: &MemoryBudget,
    room: u32,
    radius: f32,
    threads: usize,
) -> Result<Map> {
    let too_small = |_| {
        let own = stored(photons, room);
        Failure::budget(format!(
            "room {room} needs {} MiB for the map of its {own} photons, {} of {} MiB are free",
            (own * 48).div_ceil(1 << 20),
            budget.available() >> 20,
            budget.limit() >> 20
        ))
        .with_hint(format!("--memory {}M would do", ((own * 64 + budget.reserved()) >> 20) + 16))
    };
    let mut list: Array<PhotonRecord> =
        Array::with_capacity(budget, stored(photons, room) as usize, "photons of a room")
            .map_err(too_small)?;
    collect(photons, budget, room, &mut |photon| add(&mut list, *photon).map_err(too_small))?;
    let own = list.len();
    let portals = tables.portals_of(room);
    for group in portals.chunk_by(|a, b| a.other == b.other) {
        let openings = PortalSet::new(group, tables.pieces());
        collect(photons, budget, group[0].other, &mut |photon| {
            if wants_halo(&openings, photon, radius) {
                let mut photon = *photon;
                photon.flags |= PHOTON_HALO;
                add(&mut list, photon).map_err(too_small)?;
            }
            Ok(())
        })?;
    }
    let count = list.len();
    let header = photon_map::write_header(count as u64, (count - own) as u64, radius);
    let mut blob = Buffer::zeroed(budget, photon_map::blob_bytes(count), "tree of a room")
        .map_err(too_small)?;
    blob[..header.len()].copy_from_slice(&header);
    let bytes = count * size_of::<PhotonRecord>();
    let tree = &mut blob[header.len()..header.len() + bytes];
    tree.copy_from_slice(list.as_bytes());
    let tree =
        <[PhotonRecord]>::mut_from_bytes(tree).map_err(|e| Failure::internal(e.to_string()))?;
    build_tree(tree, &mut list, threads);
    Ok(Map { blob, photons: count as u64, halo: (count - own) as u64 })
}

/// Appends, growing by a quarter when the halo is more than was thought.
fn add(
    list: &mut Array<PhotonRecord>,
    photon: PhotonRecord,
) -> std::result::Result<(), enf_store::BudgetError> {
    if let Err(photon) = list.push(photon) {
        list.resize_capacity(list.capacity() + list.capacity() / 4 + 1024)?;
        // There is room now.
        let _ = list.push(photon);
    }
    Ok(())
}

/// Every indirect photon of a room. Direct light is computed with shadow rays; its photons stay in the log.
fn collect(
    photons: &StageReader,
    budget: &MemoryBudget,
    room: u32,
    each: &mut dyn FnMut(&PhotonRecord) -> Result<()>,
) -> Result<()> {
    for extent in photons.find(ExtentKind::Photons, room) {
        let block = photons.read(extent, budget, "block of photons")?;
        let records = block.as_slice_of::<PhotonRecord>().map_err(enf_store::StoreError::from)?;
        for photon in records.iter().filter(|p| p.flags & PHOTON_DIRECT == 0) {
            each(photon)?;
        }
    }
    Ok(())
}
