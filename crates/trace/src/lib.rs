//! `enf-trace`: photons from the lights into every room (the paper, sections 4 and 5).
//!
//! Tracing threads fly the photons that start or wait in the tiles that are visited; a recorder thread owns the
//! table of incoming photons, the logs and the journal; loader threads fetch the next tiles meanwhile. Nothing
//! that a user sees depends on the order of visits.
#![forbid(unsafe_code)]

mod counts;
mod driver;
mod recorder;
mod share;
mod tracer;

use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use clap::Args;
use crossbeam::channel::{bounded, unbounded};
use enf_layout::photon::PhotonRecord;
use enf_layout::segment::StageKind;
use enf_layout::transit::TransitRecord;
use enf_stage::resident::{STRUCTURES, TileCache, TileReader};
use enf_stage::session::{self, Begin, Session};
use enf_stage::tables::Tables;
use enf_stage::{
    CommonArgs, Failure, IdSink, IdSource, Neighbours, Result, RowTable, Schedule, Scheduler,
    Selection, Sweep, parse_count, say,
};
use enf_store::{
    Identity, MemoryBudget, Peer, Reservation, StageReader, StageWriter, StoreDir, StoreError,
};
use enf_transport::photon::Group;
use enf_transport::sky::{Daylight, MOST_AIMED, Shell};

pub use counts::{Counts, PhotonCount};
use driver::{Channels, Driver, Manner};
pub use recorder::Totals;
use recorder::{Message, Recorder};
pub use share::Share;
pub use tracer::add_ledger;
use tracer::{Context, Job, Products};

/// Blocks for what the loaders hold for a moment, beside those of the jobs.
const LOADING_BLOCKS: usize = 2;
/// Messages to the recorder that may wait.
const MESSAGES: usize = 2;
/// Most time between commits when others wait for them.
const SHARED_EPOCH: Duration = Duration::from_secs(1);
/// Default rows and records per row of the table of incoming photons (the paper, section 7.2).
const QUEUE_ROWS: usize = 64;
const QUEUE_BLOCK: usize = 10_000;

/// Flags that decide how work is queued, for tracer and renderer; none changes a result.
#[derive(Args, Clone, Debug, Default)]
#[command(next_help_heading = "Queue options (never change a result)")]
pub struct QueueArgs {
    /// Rows of the table of incoming photons or rays: one per tile, least recently used first out [default: 64]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub queue_rows: Option<u64>,
    /// Records per row; a full row is written in one go [default: 10k, less in small budgets]
    #[arg(long, value_name = "N", value_parser = parse_count)]
    pub queue_block: Option<u64>,
    /// Tiles kept in memory: a number, or auto for as many as the budget holds
    #[arg(long, value_name = "N|auto", default_value = "auto", value_parser = parse_resident)]
    pub resident_rooms: Resident,
    /// Which tile is visited next
    #[arg(long, value_enum, default_value_t)]
    pub schedule: Schedule,
}

/// `--resident-rooms`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Resident(
    /// At most this many; 0 is auto.
    pub usize,
);

fn parse_resident(text: &str) -> std::result::Result<Resident, String> {
    match text {
        "auto" => Ok(Resident(0)),
        _ => match text.parse() {
            Ok(n) if n > 0 => Ok(Resident(n)),
            _ => Err("a number from 1, or auto".into()),
        },
    }
}

/// `enf-trace`'s arguments.
#[derive(Args, Clone, Debug)]
pub struct TraceArgs {
    /// Photons that every light emits (k, M, G: powers of 1000) [default: 20k; demo: 50k]
    #[arg(long, value_name = "N", value_parser = parse_count)]
    pub photons_per_light: Option<u64>,
    /// Photons of all lights together, shared by power: each carries the same flux
    #[arg(long, value_name = "N", value_parser = parse_count, conflicts_with = "photons_per_light")]
    pub photons: Option<u64>,
    /// Seconds between commits: a kill loses at most this much work (never changes a result)
    #[arg(long, value_name = "SECONDS", default_value = "10", value_parser = parse_epoch)]
    pub epoch: Duration,
    /// Flags of the queue.
    #[command(flatten)]
    pub queue: QueueArgs,
}

fn parse_epoch(text: &str) -> std::result::Result<Duration, String> {
    let seconds = text.parse().ok().filter(|s: &f64| *s >= 0.0);
    seconds
        .and_then(|s| Duration::try_from_secs_f64(s).ok())
        .ok_or_else(|| "a number of seconds from 0 is wanted".into())
}

impl TraceArgs {
    /// How many photons are asked for.
    pub fn count(&self) -> PhotonCount {
        match self.photons {
            Some(total) => PhotonCount::Total(total),
            None => PhotonCount::PerLight(self.photons_per_light.unwrap_or(20_000)),
        }
    }
}

/// `enf-trace`: the command line.
#[derive(clap::Parser, Clone, Debug)]
#[command(
    name = "enf-trace",
    version,
    about = "Trace photons room by room, inside a memory budget"
)]
pub struct Cli {
    /// The store
    #[arg(value_name = "NAME.enf")]
    pub store: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub trace: TraceArgs,
    /// This is process I, from 0, of N that trace the store together, on one machine or on several that share the file system; start all N
    /// (never changes a result)
    #[arg(long, value_name = "I/N", default_value = "0/1")]
    pub share: Share,
    /// Do not read ids from standard input: all rooms
    #[arg(long)]
    pub all_rooms: bool,
    /// Discard another run's photons, and what was made from them
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub common: CommonArgs,
}

/// Runs the stage: waits for the ids of the stage before, then traces every photon to its end.
///
/// # Errors
/// As in the table of exit codes; everything committed is kept, and the same command goes on.
pub fn run(cli: &Cli, ids: IdSource, out: &IdSink) -> Result<Option<serde_json::Value>> {
    let common = &cli.common;
    let selection = ids.into_selection()?;
    if selection == Selection::Ids(Vec::new()) {
        return Ok(None);
    }
    let store = StoreDir::open(&cli.store)?;
    let mut session = Session::open(common)?;
    let tables = Tables::open(&store, &session.budget)?;
    session::rooms_of(&selection, tables.rooms().len())?;
    let grid = session::complete(
        &store,
        StageKind::Grid,
        &session.budget,
        &tables,
        &STRUCTURES,
        |room| session::tiles_of(&tables, room),
    )?;
    if tables.lights().is_empty() {
        return Err(Failure::input(format!("{} has no light", cli.store.display()))
            .with_hint("partition it again with --ceiling-lights 500lx, or give a material Ke"));
    }
    let count = cli.trace.count();
    let bytes = Counts::bytes(count, tables.lights().len());
    let _counts = session.budget.reserve(bytes, "photons of each light")?;
    let counts = Arc::new(Counts::new(count, tables.lights()).map_err(Failure::usage)?);

    if common.process != 0 {
        return Err(Failure::usage("enf-trace takes --share I/N in the place of --process"));
    }

    let mut identity = session::inherit(&store, StageKind::Partition)?;
    identity.push("seed", common.seed);
    match count {
        PhotonCount::PerLight(each) => identity.push("photons-per-light", each),
        PhotonCount::Total(total) => identity.push("photons", total),
    };
    let rooms = tables.rooms().len() as u32;
    let share = cli.share;
    // Refused before anything is begun.
    let plan = || Plan::make(cli, &session.budget, &tables, &grid);
    let planned =
        if session::may_work(&store, StageKind::Trace, cli.force) { Some(plan()?) } else { None };
    match session::begin(&store, StageKind::Trace, share.process, &identity, cli.force)? {
        Begin::Finished => {
            say(common, "nothing to do, every photon is stored already");
            let reader = StageReader::open(&store, StageKind::Trace)?;
            let totals = Totals::read(&reader, &session.budget)?;
            report(cli, &mut session, &tables, &totals);
        }
        Begin::Work(writer) => {
            let plan = match planned {
                Some(plan) => plan,
                None => plan()?,
            };
            let totals =
                trace(cli, &mut session, &tables, &grid, (*writer, &identity), plan, &counts)?;
            report(cli, &mut session, &tables, &totals);
        }
    }
    let stats = session.finish(common, "trace", &store)?;
    for room in 0..rooms {
        out.print(room)?;
    }
    Ok(Some(stats))
}

/// Jobs that are handed out and not done, at most: each thread has one at hand while it works at one, and the main thread one to give.
pub fn jobs_at_once(common: &CommonArgs) -> usize {
    common.threads * 3
}

/// Rows and records per row that fit a share of the budget, together with the blocks that are read back for jobs; explicit flags are
/// taken as they are.
pub fn queue_shape(queue: &QueueArgs, common: &CommonArgs, record: usize) -> (usize, usize) {
    let rows = queue.queue_rows.map_or(QUEUE_ROWS, |r| r as usize);
    let blocks = rows + jobs_at_once(common) + LOADING_BLOCKS;
    let fits = (common.memory as usize / 8) / record / blocks;
    let block = queue.queue_block.map_or(QUEUE_BLOCK.min(fits.max(64)), |b| (b as usize).max(1));
    (rows, block)
}

/// What a trace needs beside its tiles: the tables' shapes, the daylight, and the memory of all.
struct Plan {
    rows: usize,
    block: usize,
    photon_rows: usize,
    photon_block: usize,
    daylight: Option<Daylight>,
    /// For what grows with the trace.
    tables: Reservation,
    _reservations: Vec<Reservation>,
}

impl Plan {
    /// Reserves it all, if the largest tile fits beside it.
    fn make(cli: &Cli, budget: &MemoryBudget, tables: &Tables, grid: &StageReader) -> Result<Self> {
        let (common, rooms) = (&cli.common, tables.rooms().len());
        let (rows, block) = queue_shape(&cli.trace.queue, common, size_of::<TransitRecord>());
        let photon_rows = rows.min(rooms).clamp(1, 48);
        let photon_block = (common.memory as usize / 12 / size_of::<PhotonRecord>() / photon_rows)
            .clamp(64, 10_000);
        let transit = RowTable::<TransitRecord>::memory_bytes(rows, block);
        let photons = RowTable::<PhotonRecord>::memory_bytes(photon_rows, photon_block);
        let threads = common.threads as u64;
        // Of each thread, those that wait for the recorder, and those at which it works.
        let products = Products::MOST_BYTES * (threads + MESSAGES as u64 + 1);
        let others = if cli.share.of > 1 { Peer::BYTES } else { 0 };
        let (daylight, sky) = daylight(tables, budget)?;
        let tiles = tables.tiles().len() as u32;
        let aimed = if daylight.is_some() { Group::SIZE * MOST_AIMED } else { 0 };
        let aimed = (aimed * size_of::<TransitRecord>()) as u64 * threads;
        let mut reservations = vec![
            budget.reserve(transit, "table of incoming photons")?,
            budget.reserve(photons, "rows of stored photons")?,
            budget.reserve(products + Group::BYTES * threads, "photons in flight")?,
            budget.reserve(others, "journals of other processes")?,
            budget.reserve(aimed, "photons aimed at openings")?,
            budget.reserve(
                Neighbours::bytes(tables) + Sweep::bytes(tables) + Scheduler::memory_bytes(tiles),
                "neighbours of tiles",
            )?,
        ];
        reservations.extend(sky);
        let plan = Self {
            rows,
            block,
            photon_rows,
            photon_block,
            daylight,
            tables: budget.reserve(StageWriter::BUFFER_BYTES, "tables of the trace")?,
            _reservations: reservations,
        };
        // A block that is read back.
        let _block =
            budget.reserve((block * size_of::<TransitRecord>()) as u64, "incoming photons")?;
        let reader =
            TileReader { partition: &tables.partition, grid, budget, delta: tables.scene.delta };
        session::refuse_large_tiles(tables, &reader, budget, common.memory)?;
        Ok(plan)
    }
}

fn trace(
    cli: &Cli,
    session: &mut Session,
    tables: &Tables,
    grid: &StageReader,
    (writer, identity): (StageWriter, &Identity),
    plan: Plan,
    counts: &Arc<Counts>,
) -> Result<Totals> {
    let share = cli.share;
    let (common, queue) = (&cli.common, &cli.trace.queue);
    let budget = session.budget.clone();
    let Plan { rows, block, photon_rows, photon_block, daylight, tables: growing, _reservations } =
        plan;
    let resumed = writer.resumed();
    let recorder = Recorder::new(
        writer,
        share,
        &budget,
        RowTable::new(rows, block),
        RowTable::new(photon_rows, photon_block),
        Arc::clone(counts),
    )?;
    let (waiting, cursors) = recorder.resume_state();
    if resumed {
        say(common, "going on where the last run stopped");
    }

    let context = Context {
        tables,
        bsp: tables.bsp()?,
        seed: common.seed,
        counts: Arc::clone(counts),
        daylight,
    };
    let reader = TileReader {
        partition: &tables.partition,
        grid,
        budget: &budget,
        delta: tables.scene.delta,
    };
    let at_once = jobs_at_once(common);
    let (jobs, take_job) = bounded::<Job>(at_once);
    let (done, finished) = unbounded::<driver::Done>();
    let (messages, mailbox) = bounded::<Message>(MESSAGES);
    let timeline = &session.timeline;
    // Blocks read back: one for each job that may be under way, and what the loaders hold for a moment.
    let margin =
        (block * size_of::<TransitRecord>() * (at_once + LOADING_BLOCKS)) as u64 + (2 << 20);
    let (cache, load) = TileCache::new(reader, queue.resident_rooms.0, margin, timeline);

    let failed = recorder.failed();
    let (waited, began) = (AtomicU64::new(0), Instant::now());
    let (recorder, driven) = std::thread::scope(|scope| {
        let loaders: Vec<_> = (0..common.threads).map(|_| scope.spawn(load.clone())).collect();
        drop(load);
        let recording = scope.spawn(|| recorder.serve(&mailbox, &timeline.lane("recorder")));
        for thread in 0..common.threads {
            let (take_job, done, messages) = (take_job.clone(), done.clone(), messages.clone());
            let (context, waited) = (&context, &waited);
            scope.spawn(move || {
                let lane = timeline.lane(&format!("tracer {thread}"));
                let mut group = Group::default();
                let waiting = Waits::default();
                let send = |products: Products| {
                    let products = Message::Products(Box::new(products));
                    waiting
                        .during(&lane, "wait for the recorder", || messages.send(products))
                        .map_err(|_| Failure::internal("the recorder has stopped"))
                };
                while let Ok(job) = waiting.during(&lane, "wait for work", || take_job.recv()) {
                    let tile = job.tile.tile;
                    let span = lane.span("trace", tile);
                    let ran = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                        // What cannot be sent here cannot be sent at the end either, and that is told.
                        context.run(&job, &mut group, &|products| drop(send(products)))
                    }));
                    drop(span);
                    drop(job);
                    let result = match ran {
                        Ok(Ok(products)) => send(products),
                        Ok(Err(malformed)) => Err(StoreError::from(malformed).into()),
                        Err(_) => Err(Failure::internal("a tracing thread failed")),
                    };
                    if done.send((tile, result)).is_err() {
                        break;
                    }
                }
                waited.fetch_add(waiting.0.get().as_nanos() as u64, Ordering::Relaxed);
            });
        }
        drop((take_job, done));
        let driver = Driver::new(
            common,
            &context,
            cache,
            Channels { jobs, finished, messages },
            Manner {
                block,
                // Others wait for what they can see only when it is committed.
                epoch: if share.of > 1 {
                    cli.trace.epoch.min(SHARED_EPOCH)
                } else {
                    cli.trace.epoch
                },
                jobs: at_once as u64,
                ahead: common.threads + 1,
                share,
            },
            cursors,
            Scheduler::new(queue.schedule, tables.tiles().len() as u32),
            timeline.lane("schedule"),
            failed,
            growing,
        );
        // It closes all channels when it ends; then the threads end.
        let driven = driver.drive(&waiting);
        let recorder = recording.join().map_err(|_| Failure::internal("the recorder failed"));
        loaders.into_iter().for_each(|loader| drop(loader.join()));
        (recorder, driven)
    });
    let tracers_s = began.elapsed().as_secs_f64() * common.threads as f64;
    let waited_s = waited.into_inner() as f64 / 1e9;
    session.stats.set("tracers_waited_s", waited_s);
    session.stats.set("tracers_waited_share", waited_s / tracers_s.max(f64::MIN_POSITIVE));
    let recorder = recorder?;
    let loads = driven?;
    let store = tables.partition.store();
    let rooms = tables.rooms().len() as u32;
    let totals = recorder.seal(store, identity, rooms, |text| say(common, text))?;
    record_loads(session, tables, &loads);
    Ok(totals)
}

/// How long a tracing thread has waited.
#[derive(Default)]
struct Waits(Cell<Duration>);

impl Waits {
    /// Waits for something, on the timeline as well.
    fn during<T>(&self, lane: &enf_stage::Lane, why: &'static str, wait: impl FnOnce() -> T) -> T {
        let (_span, since) = (lane.io(why, 0u32), Instant::now());
        let result = wait();
        self.0.set(self.0.get() + since.elapsed());
        result
    }
}

/// The memory that [`daylight`] takes, bytes.
pub fn daylight_bytes(tables: &Tables) -> u64 {
    if tables.sky.is_none() {
        return 0;
    }
    let (lights, emitters) = (tables.lights(), tables.emitters());
    let openings = lights.iter().filter(|l| Daylight::is_daylight(l)).count();
    Daylight::bytes(lights.len(), emitters.len(), openings)
}

/// The daylight of a scene that has a sky, and the memory that it takes.
///
/// # Errors
/// Exit 3 when it does not fit.
pub fn daylight(
    tables: &Tables,
    budget: &MemoryBudget,
) -> Result<(Option<Daylight>, Option<Reservation>)> {
    let Some(sky) = &tables.sky else { return Ok((None, None)) };
    let (lights, emitters) = (tables.lights(), tables.emitters());
    let reservation = budget.reserve(daylight_bytes(tables), "the sky and its openings")?;
    let scene = &tables.scene;
    let shell = Shell::new(scene.bounds_min, scene.bounds_max);
    let daylight = Daylight::new(sky, shell, scene.delta, lights, emitters);
    Ok((Some(daylight), Some(reservation)))
}

/// Puts the loads per tile into a report.
pub fn record_loads(session: &mut Session, tables: &Tables, loads: &BTreeMap<u32, u32>) {
    let total: u64 = loads.values().map(|&n| u64::from(n)).sum();
    let tiles = tables.tiles().len() as u64;
    let stats = &mut session.stats;
    stats.set("io.room_loads", total);
    stats.set("io.room_load_mean", total as f64 / tiles.max(1) as f64);
    stats.set("io.room_load_max", loads.values().copied().max().unwrap_or(0));
    stats.set("io.rooms_never_loaded", tiles - loads.len() as u64);
}

fn report(cli: &Cli, session: &mut Session, tables: &Tables, totals: &Totals) {
    let mut sum = tracer::empty_ledger(0);
    for line in totals.ledger.values() {
        add_ledger(&mut sum, line);
    }
    let scalar = |rgb: [f64; 3]| 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
    let ended = sum.absorbed + sum.escaped;
    let passages: u64 = totals.passages.values().map(|p| p.0).sum();
    let stats = &mut session.stats;
    stats.set("photons_emitted", sum.emitted);
    stats.set("photons_stored", sum.stored);
    stats.set("photons_absorbed", sum.absorbed);
    stats.set("photons_escaped", sum.escaped);
    stats.set("photons_through_portals", passages);
    stats.set("reflections_min", if ended > 0 { sum.reflections_min } else { 0 });
    stats.set("reflections_mean", sum.reflections_sum as f64 / ended.max(1) as f64);
    stats.set("reflections_max", sum.reflections_max);
    stats.set("flux_emitted_w", scalar(sum.emitted_w));
    stats.set("flux_absorbed_w", scalar(sum.absorbed_w));
    stats.set("flux_escaped_w", scalar(sum.escaped_w));
    stats.set("flux_in_transit_w", 0.0);
    stats.set("table.evictions", totals.evictions);
    stats.set("table.spilled_blocks", totals.spilled_blocks);
    stats.set("io.spilled_records", totals.spilled_records);
    stats.set("photon_visits", totals.traced);
    stats.set("lights", tables.lights().len());
    say(
        &cli.common,
        format!(
            "{} photons emitted = {} absorbed + {} escaped; {} impacts stored, {:.2} reflections a photon",
            sum.emitted,
            sum.absorbed,
            sum.escaped,
            sum.stored,
            sum.reflections_sum as f64 / ended.max(1) as f64
        ),
    );
}
