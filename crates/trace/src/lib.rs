//! `enf-trace`: photons from the lights into every room (the paper, sections 4 and 5).
//!
//! One tile is visited at a time. Tracing threads fly the photons that start or wait there; a recorder thread
//! owns the table of incoming photons, the logs and the journal; a loader thread fetches the next tile
//! meanwhile. Nothing that a user sees depends on the order of visits.
#![forbid(unsafe_code)]

mod recorder;
mod tracer;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use crossbeam::channel::{Receiver, Sender, bounded, unbounded};
use enf_layout::photon::PhotonRecord;
use enf_layout::segment::StageKind;
use enf_layout::transit::TransitRecord;
use enf_stage::resident::{STRUCTURES, TileCache, TileData, TileReader};
use enf_stage::session::{self, Begin, Session};
use enf_stage::tables::Tables;
use enf_stage::{
    CommonArgs, Failure, IdSink, IdSource, Progress, Result, RowTable, Schedule, Scheduler,
    Selection, interrupt, parse_count, say,
};
use enf_store::{Buffer, Extent, MemoryBudget, Reservation, StageReader, StoreDir, StoreError};
use enf_transport::photon::Group;
use enf_transport::sky::{Daylight, MOST_AIMED, Shell};

pub use recorder::Totals;
use recorder::{Message, Recorder, Status, Taken};
pub use tracer::add_ledger;
use tracer::{Context, Job, PROBES_PER_LIGHT, Waiting, Work};

/// Photons of one job: long enough to make its overhead small, short enough to share among threads.
const JOB_PHOTONS: u64 = 4096;
/// Photons of one visit, after which the scheduler may think again and a commit is possible.
const VISIT_PHOTONS: u64 = 1 << 20;
/// A kill loses at most these bytes of work, or the time that `--epoch` says.
const EPOCH_BYTES: u64 = 256 << 20;
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
    /// Photons that every light emits.
    pub fn photons(&self) -> u64 {
        self.photons_per_light.unwrap_or(20_000)
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
    let grid = session::complete(&store, StageKind::Grid, &tables, &STRUCTURES, |room| {
        session::tiles_of(&tables, room)
    })?;
    if tables.lights().is_empty() {
        return Err(Failure::input(format!("{} has no light", cli.store.display()))
            .with_hint("partition it again with --ceiling-lights 500lx, or give a material Ke"));
    }
    if cli.trace.photons() == 0 || cli.trace.photons() > u64::from(u32::MAX) {
        return Err(Failure::usage("--photons-per-light takes 1 to 4294967295"));
    }

    let mut identity = session::inherit(&store, StageKind::Partition)?;
    identity.push("seed", common.seed);
    identity.push("photons-per-light", cli.trace.photons());
    let rooms = tables.rooms().len() as u32;
    // Refused before anything is begun.
    let plan = || Queues::reserve(cli, &session.budget, &tables, &grid);
    let queues =
        if session::may_work(&store, StageKind::Trace, cli.force) { Some(plan()?) } else { None };
    match session::begin(&store, StageKind::Trace, common.process, &identity, cli.force)? {
        Begin::Finished => {
            say(common, "nothing to do, every photon is stored already");
            let reader = StageReader::open(&store, StageKind::Trace)?;
            let totals = Totals::read(&reader, &session.budget)?;
            report(cli, &mut session, &tables, &totals);
        }
        Begin::Work(writer) => {
            let queues = match queues {
                Some(queues) => queues,
                None => plan()?,
            };
            let totals = trace(cli, &mut session, &tables, &grid, *writer, &queues)?;
            report(cli, &mut session, &tables, &totals);
        }
    }
    let stats = session.finish(common, "trace", &store)?;
    for room in 0..rooms {
        out.print(room)?;
    }
    Ok(Some(stats))
}

/// Rows and records per row that fit a share of the budget; explicit flags are taken as they are.
pub fn queue_shape(queue: &QueueArgs, budget: u64, record: usize) -> (usize, usize) {
    let rows = queue.queue_rows.map_or(QUEUE_ROWS, |r| r as usize);
    let fits = (budget as usize / 8) / record / rows;
    let block = queue.queue_block.map_or(QUEUE_BLOCK.min(fits.max(64)), |b| (b as usize).max(1));
    (rows, block)
}

/// The tables' shapes, and their memory.
struct Queues {
    rows: usize,
    block: usize,
    photon_rows: usize,
    photon_block: usize,
    _reservations: [Reservation; 3],
}

impl Queues {
    /// Reserves them, if the largest tile fits beside them.
    fn reserve(
        cli: &Cli,
        budget: &MemoryBudget,
        tables: &Tables,
        grid: &StageReader,
    ) -> Result<Self> {
        let (common, rooms) = (&cli.common, tables.rooms().len());
        let (rows, block) =
            queue_shape(&cli.trace.queue, common.memory, size_of::<TransitRecord>());
        let photon_rows = rows.min(rooms).clamp(1, 48);
        let photon_block = (common.memory as usize / 12 / size_of::<PhotonRecord>() / photon_rows)
            .clamp(64, 10_000);
        // Products of the jobs in flight: some impacts per photon, all parked at worst.
        let per_job = JOB_PHOTONS
            * (size_of::<PhotonRecord>() as u64 * 8 + size_of::<TransitRecord>() as u64);
        let transit = RowTable::<TransitRecord>::memory_bytes(rows, block);
        let photons = RowTable::<PhotonRecord>::memory_bytes(photon_rows, photon_block);
        let threads = common.threads as u64;
        let jobs = per_job * (threads + 4) + Group::BYTES * threads;
        let queues = Self {
            rows,
            block,
            photon_rows,
            photon_block,
            _reservations: [
                budget.reserve(transit, "table of incoming photons")?,
                budget.reserve(photons, "rows of stored photons")?,
                budget.reserve(jobs, "photons in flight")?,
            ],
        };
        let reader =
            TileReader { partition: &tables.partition, grid, budget, delta: tables.scene.delta };
        session::refuse_large_tiles(tables, &reader, budget, common.memory)?;
        Ok(queues)
    }
}

fn trace(
    cli: &Cli,
    session: &mut Session,
    tables: &Tables,
    grid: &StageReader,
    writer: enf_store::StageWriter,
    shapes: &Queues,
) -> Result<Totals> {
    let (common, queue) = (&cli.common, &cli.trace.queue);
    let budget = session.budget.clone();
    let Queues { rows, block, photon_rows, photon_block, .. } = *shapes;

    let (daylight, _daylight) = daylight(tables, &budget)?;
    let aimed = if daylight.is_some() { Group::SIZE * MOST_AIMED } else { 0 };
    let aimed = aimed * size_of::<TransitRecord>() * common.threads;
    let _aimed = budget.reserve(aimed as u64, "photons aimed at openings")?;
    let resumed = writer.resumed();
    let recorder = Recorder::new(
        writer,
        &budget,
        RowTable::new(rows, block),
        RowTable::new(photon_rows, photon_block),
    )?;
    let (waiting, cursors) = recorder.resume_state();
    if resumed {
        say(common, "going on where the last run stopped");
    }

    let context = Context {
        tables,
        bsp: tables.bsp()?,
        seed: common.seed,
        photons_per_light: cli.trace.photons(),
        daylight,
    };
    let reader = TileReader {
        partition: &tables.partition,
        grid,
        budget: &budget,
        delta: tables.scene.delta,
    };
    let (jobs, take_job) = bounded::<Job>(common.threads * 2);
    let (done, finished) = unbounded::<std::result::Result<(), Failure>>();
    let (messages, mailbox) = bounded::<Message>(common.threads * 2 + 2);
    let timeline = &session.timeline;
    // Blocks read back: one for each job that may be under way, and what the loader holds for a moment.
    let margin = (block * size_of::<TransitRecord>() * (common.threads * 3 + 2)) as u64 + (2 << 20);
    let (cache, load) = TileCache::new(reader, queue.resident_rooms.0, margin, timeline);

    let (recorder, driven) = std::thread::scope(|scope| {
        let loader = scope.spawn(load);
        let recording = scope.spawn(|| recorder.serve(&mailbox));
        for thread in 0..common.threads {
            let (take_job, done, messages) = (take_job.clone(), done.clone(), messages.clone());
            let context = &context;
            scope.spawn(move || {
                let lane = timeline.lane(&format!("tracer {thread}"));
                let mut group = Group::default();
                for job in take_job {
                    let span = lane.span("trace", job.tile.tile);
                    let ran = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                        context.run(&job, &mut group)
                    }));
                    drop(span);
                    drop(job);
                    let result = match ran {
                        Ok(Ok(products)) => messages
                            .send(Message::Products(Box::new(products)))
                            .map_err(|_| Failure::internal("the recorder has stopped")),
                        Ok(Err(malformed)) => Err(StoreError::from(malformed).into()),
                        Err(_) => Err(Failure::internal("a tracing thread failed")),
                    };
                    if done.send(result).is_err() {
                        break;
                    }
                }
            });
        }
        drop((take_job, done));
        let mut driver = Driver {
            common,
            context: &context,
            cache,
            jobs,
            finished,
            messages,
            block,
            epoch: cli.trace.epoch,
            cursors,
            scheduler: Scheduler::new(queue.schedule, tables.tiles().len() as u32, block as u64),
            lane: timeline.lane("schedule"),
        };
        let driven = driver.drive(&waiting);
        let loads = driver.cache.loads().clone();
        // Dropping the driver closes all channels; the threads end.
        drop(driver);
        let recorder = recording.join().map_err(|_| Failure::internal("the recorder failed"));
        let _ = loader.join();
        (recorder, driven.map(|()| loads))
    });
    let recorder = recorder?;
    let loads = driven?;
    let totals = recorder.seal(tables.rooms().len() as u32)?;
    record_loads(session, tables, &loads);
    Ok(totals)
}

/// The main thread: chooses tiles, hands out jobs, commits.
struct Driver<'a> {
    common: &'a CommonArgs,
    context: &'a Context<'a>,
    cache: TileCache,
    jobs: Sender<Job>,
    finished: Receiver<std::result::Result<(), Failure>>,
    messages: Sender<Message>,
    block: usize,
    epoch: Duration,
    cursors: BTreeMap<u32, u64>,
    scheduler: Scheduler,
    lane: enf_stage::Lane,
}

impl Driver<'_> {
    /// Starts of a tile: every light that may start there, all its photons and probes.
    fn starts(&self, tile: u32) -> u64 {
        let lights = self.context.tables.lights_of(tile).len() as u64;
        lights * (self.context.photons_per_light + PROBES_PER_LIGHT)
    }

    fn ask<T>(&self, message: impl FnOnce(Sender<T>) -> Message) -> Result<T> {
        let (reply, answer) = bounded(1);
        self.messages
            .send(message(reply))
            .ok()
            .and_then(|()| answer.recv().ok())
            .ok_or_else(|| Failure::internal("the recorder has stopped"))
    }

    fn drive(&mut self, waiting: &BTreeMap<u32, u64>) -> Result<()> {
        let tables = self.context.tables;
        for tile in 0..tables.tiles().len() as u32 {
            let left = self.starts(tile) - self.cursors.get(&tile).copied().unwrap_or(0);
            let pending = left + waiting.get(&tile).copied().unwrap_or(0);
            if pending > 0 {
                self.scheduler.add(tile, pending);
            }
        }
        let emitted_w: f64 = tables
            .lights()
            .iter()
            .map(|l| l.flux_w.iter().map(|&c| f64::from(c)).sum::<f64>())
            .sum();
        let total = tables.lights().len() as u64 * self.context.photons_per_light;
        let progress = Progress::new(self.common, "trace", Some(total), "photons");
        loop {
            let cache = &self.cache;
            let Some(tile) = self.scheduler.next(&|t| cache.is_resident(t)) else { break };
            if let Some(signal) = interrupt::interrupted() {
                self.ask(|reply| Message::Commit { reply })??;
                return Err(Failure::interrupted(signal));
            }
            let pending = self.scheduler.take(tile);
            let data = self.cache.get(tile)?;
            let cache = &self.cache;
            if let Some(next) = self.scheduler.next(&|t| cache.is_resident(t)) {
                self.cache.prefetch(next)?;
            }
            let visited = self.visit(tile, &data);
            drop(data);
            let (status, left) = visited?;
            if let Some(error) = status.failure {
                return Err(error.into());
            }
            for (&to, &count) in &status.parked {
                self.scheduler.add(to, count);
            }
            if left > 0 {
                self.scheduler.add(tile, left.min(pending));
            }
            progress.set(status.finished);
            progress.message(&format!(
                "room {} ({:.1} % of the flux absorbed)",
                tables.tiles()[tile as usize].room,
                100.0 * status.finished_w / emitted_w.max(f64::MIN_POSITIVE)
            ));
            if status.uncommitted > EPOCH_BYTES
                || (status.uncommitted > 0 && status.committed_at.elapsed() > self.epoch)
            {
                let _span = self.lane.io("commit", 0u32);
                self.ask(|reply| Message::Commit { reply })??;
            }
        }
        progress.finish();
        Ok(())
    }

    /// Hands out what waits at the tile and what starts there, at most [`VISIT_PHOTONS`]; returns what is left.
    fn visit(&mut self, tile: u32, data: &Arc<TileData>) -> Result<(Status, u64)> {
        let Taken { memory, extents } = self.ask(|reply| Message::Take { tile, reply })?;
        let mut flying = 0;
        let mut handed = memory.len() as u64;
        let mut outcome = Ok(());
        if !memory.is_empty() {
            outcome = self.hand_out(data, Waiting::Memory(memory), &mut flying);
        }
        let mut extents = extents.into_iter();
        let mut consumed: Vec<Extent> = Vec::new();
        while outcome.is_ok() && handed < VISIT_PHOTONS {
            let Some(extent) = extents.next() else { break };
            handed += extent.count;
            outcome = self
                .read_back(extent, &mut flying)
                .and_then(|buffer| self.hand_out(data, Waiting::Log(buffer), &mut flying));
            consumed.push(extent);
        }
        let unused: Vec<Extent> = extents.collect();
        let starts = self.starts(tile);
        let mut cursor = self.cursors.get(&tile).copied().unwrap_or(0);
        let per_light = self.context.photons_per_light + PROBES_PER_LIGHT;
        while outcome.is_ok() && cursor < starts && handed < VISIT_PHOTONS {
            let lights = self.context.tables.lights_of(tile);
            let light = lights[(cursor / per_light) as usize];
            let first = cursor % per_light;
            let count = JOB_PHOTONS.min(per_light - first);
            let work = Work::Emission { light, indices: first..first + count };
            outcome = self.send(Job { tile: Arc::clone(data), work }, &mut flying);
            cursor += count;
            handed += count;
        }
        self.cursors.insert(tile, cursor);
        // Every job that was handed out must come back, whatever went wrong.
        while flying > 0 {
            let result = self
                .finished
                .recv()
                .unwrap_or_else(|_| Err(Failure::internal("the tracing threads have stopped")));
            flying -= 1;
            outcome = outcome.and(result);
        }
        outcome?;
        let left = starts - cursor + unused.iter().map(|e| e.count).sum::<u64>();
        let cursor = (starts > 0).then_some((tile, cursor));
        let unused = (tile, unused);
        let status = self.ask(|reply| Message::Visited { consumed, unused, cursor, reply })?;
        Ok((status, left))
    }

    /// Photons from the log. Tiles that nobody needs make way for them, and then the jobs that are under way.
    fn read_back(&mut self, extent: Extent, flying: &mut u64) -> Result<Buffer> {
        loop {
            match self.ask(|reply| Message::Read { extent, reply })? {
                Err(StoreError::Budget(_)) if self.cache.make_way()? => {}
                Err(StoreError::Budget(_)) if *flying > 0 => {
                    *flying -= 1;
                    let stopped = |_| Err(Failure::internal("the tracing threads have stopped"));
                    self.finished.recv().unwrap_or_else(stopped)?;
                }
                other => return Ok(other?),
            }
        }
    }

    fn hand_out(&self, data: &Arc<TileData>, records: Waiting, flying: &mut u64) -> Result<()> {
        let records = Arc::new(records);
        let count = records.records().len();
        let step = (JOB_PHOTONS as usize).min(self.block.max(256));
        for first in (0..count).step_by(step) {
            let range = first..(first + step).min(count);
            let work = Work::Waiting { records: Arc::clone(&records), range };
            self.send(Job { tile: Arc::clone(data), work }, flying)?;
        }
        Ok(())
    }

    fn send(&self, job: Job, flying: &mut u64) -> Result<()> {
        self.jobs.send(job).map_err(|_| Failure::internal("the tracing threads have stopped"))?;
        *flying += 1;
        Ok(())
    }
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
    let openings = lights.iter().filter(|l| Daylight::is_daylight(l)).count();
    let bytes = Daylight::bytes(lights.len(), emitters.len(), openings);
    let reservation = budget.reserve(bytes, "the sky and its openings")?;
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
