//! One run of one stage: its budget, its timeline, and the answer to "was this done already?".

use std::ops::Range;
use std::time::{Duration, Instant};

use enf_layout::segment::{ExtentKind, StageKind};
use enf_store::{
    Identity, MemoryBudget, Reservation, StageReader, StageState, StageWriter, StoreDir, StoreError,
};

use parking_lot::Mutex;

use crate::args::CommonArgs;
use crate::failure::{Failure, Result};
use crate::ids::{IdSink, Selection};
use crate::interrupt;
use crate::ordered::Continue;
use crate::resident::TileReader;
use crate::stats::Stats;
use crate::tables::Tables;
use crate::timeline::Timeline;

/// One run of one stage.
pub struct Session {
    /// The only source of large bytes.
    pub budget: MemoryBudget,
    /// Where `--trace` goes.
    pub timeline: Timeline,
    /// When the stage began.
    pub started: Instant,
    /// What it will report.
    pub stats: Stats,
    /// The process itself: code, stacks, allocator.
    _process: Reservation,
}

/// The timeline that all sessions of this process draw on, when one command runs several stages.
static SHARED: Mutex<Option<Timeline>> = Mutex::new(None);

/// Opens one timeline for all stages that this process is about to run.
///
/// # Errors
/// Exit 5 when the file cannot be written.
pub fn share_timeline(common: &CommonArgs) -> Result<()> {
    *SHARED.lock() = Some(Timeline::new(common.trace.clone())?);
    Ok(())
}

/// Completes the shared timeline.
///
/// # Errors
/// Exit 5 when the file cannot be written.
pub fn end_timeline() -> Result<()> {
    match SHARED.lock().take() {
        Some(timeline) => timeline.finish(),
        None => Ok(()),
    }
}

impl Session {
    /// Opens the session of a stage. The process's own code and stacks are in the budget as well.
    ///
    /// # Errors
    /// Exit 3 when the process alone is over the budget; exit 5 when a report could not be written later.
    pub fn open(common: &CommonArgs) -> Result<Self> {
        // What an earlier stage of this process has freed is not this one's.
        enf_store::give_back_free_memory();
        let stats = Stats::begin(common)?;
        let (budget, process) = crate::memory_budget(common)?;
        Ok(Self {
            budget,
            timeline: match &*SHARED.lock() {
                Some(shared) => shared.clone(),
                None => Timeline::new(common.trace.clone())?,
            },
            started: Instant::now(),
            stats,
            _process: process,
        })
    }

    /// Ends the session: completes and writes the report, and returns it.
    ///
    /// # Errors
    /// Exit 5 when the report or the timeline cannot be written.
    pub fn finish(
        mut self,
        common: &CommonArgs,
        stage: &str,
        store: &StoreDir,
    ) -> Result<serde_json::Value> {
        self.stats.set_budget(&self.budget);
        self.stats.set_io(store.io(), enf_store::IoCounters::default());
        if SHARED.lock().is_none() {
            self.timeline.finish()?;
        }
        self.stats.finish(common, stage, self.started)
    }
}

/// What helps against damaged output.
pub const MAKE_AGAIN: &str = "--force discards it and everything made from it, and makes it again";

/// How what is in the store relates to what is about to be made.
enum Standing {
    /// There is nothing, or the beginning of the same.
    New,
    /// The same, finished.
    Finished,
    /// Something else; one line for each difference.
    Different(Vec<String>),
}

fn standing(
    store: &StoreDir,
    stage: StageKind,
    identity: &Identity,
    force: bool,
) -> std::result::Result<Standing, StoreError> {
    let state = store.stage_state(stage)?;
    if state == StageState::Absent {
        return Ok(Standing::New);
    }
    let Some(found) = store.identity(stage)? else { return Ok(Standing::New) };
    let differences = identity.differences(&found);
    if !differences.is_empty() {
        return Ok(Standing::Different(differences));
    }
    if state != StageState::Sealed {
        if force {
            StageReader::open_unsealed(store, stage)?;
        }
        return Ok(Standing::New);
    }
    if force {
        enf_store::verify(store, stage)?;
    } else {
        // Journals and lengths.
        StageReader::open(store, stage)?;
    }
    Ok(Standing::Finished)
}

/// What a stage finds in the store before it starts.
pub enum Begin {
    /// The same work is finished.
    Finished,
    /// A writer: new, or resumed.
    Work(Box<StageWriter>),
}

/// Opens a stage for writing. Finished with the same identity is [`Begin::Finished`]; unfinished is resumed;
/// another identity is refused, or discarded (with all later stages) under `force`. So is, under `force`, a stage
/// whose files are damaged; to know that, it is read once.
///
/// # Errors
/// Exit 2 when another run's output is in the way, naming the differences; exit 4 when what is there is damaged;
/// exit 5 when another process owns it.
pub fn begin(
    store: &StoreDir,
    stage: StageKind,
    process: u32,
    identity: &Identity,
    force: bool,
) -> Result<Begin> {
    let standing = standing(store, stage, identity, force);
    match standing {
        Ok(Standing::New) => {}
        Ok(Standing::Finished) => return Ok(Begin::Finished),
        Ok(Standing::Different(_))
        | Err(StoreError::Corrupt { .. } | StoreError::Missing { .. })
            if force =>
        {
            store.discard_from(stage)?;
        }
        Ok(Standing::Different(differences)) => {
            return Err(Failure::usage(format!(
                "{} holds another {} run: {}",
                store.path().display(),
                stage.name(),
                differences.join("; ")
            ))
            .with_hint(
                "--force discards it and everything made from it, or choose another output",
            ));
        }
        Err(error) => {
            let damaged = matches!(error, StoreError::Corrupt { .. });
            let failure = Failure::from(error);
            return Err(if damaged { failure.with_hint(MAKE_AGAIN) } else { failure });
        }
    }
    match StageWriter::open(store, stage, process, identity) {
        Ok(writer) => {
            // A new beginning makes what later stages hold meaningless.
            if !writer.resumed()
                && let Some(next) = StageKind::ALL.into_iter().find(|&s| s > stage)
            {
                store.discard_from(next)?;
            }
            Ok(Begin::Work(Box::new(writer)))
        }
        Err(StoreError::Sealed { .. }) => Ok(Begin::Finished),
        Err(error) => Err(error.into()),
    }
}

/// Whether [`begin`] may answer with work. What that needs is then reserved before anything is begun or discarded, so
/// that a refusal leaves the store as it was; and a finished stage needs nothing.
pub fn may_work(store: &StoreDir, stage: StageKind, force: bool) -> bool {
    force || !matches!(store.stage_state(stage), Ok(StageState::Sealed))
}

/// The identity that a stage inherits from the one before: it changes whenever that one's does.
///
/// # Errors
/// Exit 4 when the stage before is missing or unfinished.
pub fn inherit(store: &StoreDir, from: StageKind) -> Result<Identity> {
    let mut identity = Identity::default();
    if let Some(before) = store.identity(from)? {
        let hash: String = before.hash().iter().map(|b| format!("{b:02x}")).collect();
        identity.push(from.name(), hash);
    }
    Ok(identity)
}

/// Opens the stage before, which must have done every room: an extent of one of `kinds` for each of the ids that `of` gives
/// to a room.
///
/// # Errors
/// Exit 4 when it is missing, damaged or unfinished; then the first room that it lacks is named. Exit 3 when its table of extents does
/// not fit.
pub fn complete(
    store: &StoreDir,
    stage: StageKind,
    budget: &MemoryBudget,
    tables: &Tables,
    kinds: &[ExtentKind],
    of: impl Fn(u32) -> Range<u32>,
) -> Result<StageReader> {
    let name = stage.name();
    match StageReader::open(store, stage) {
        Err(StoreError::Unfinished { .. }) => {
            let reader = StageReader::open_unsealed(store, stage)?;
            let lacks = |room: &u32| {
                of(*room).any(|id| kinds.iter().all(|&kind| reader.find(kind, id).is_empty()))
            };
            let path = store.path().display();
            let lacking = (0..tables.rooms().len() as u32).find(lacks);
            Err(Failure::input(match lacking {
                Some(room) => format!("room {room} of {path} has not been through enf-{name} yet"),
                None => format!("{name} in {path} is unfinished"),
            })
            .with_hint(format!("run enf-{name} again, it goes on where it stopped")))
        }
        other => Ok(other?.with_budget(budget)?),
    }
}

/// The tiles of a room.
pub fn tiles_of(tables: &Tables, room: u32) -> Range<u32> {
    let room = &tables.rooms()[room as usize];
    room.first_tile..room.first_tile + room.tile_count
}

/// The rooms that a selection names, in its order; an id that the store does not have is bad input.
///
/// # Errors
/// Exit 4 for an unknown room.
pub fn rooms_of(selection: &Selection, rooms: usize) -> Result<Vec<u32>> {
    match selection {
        Selection::All => Ok((0..rooms as u32).collect()),
        Selection::Ids(ids) => {
            if let Some(id) = ids.iter().find(|&&id| id as usize >= rooms) {
                return Err(Failure::input(format!(
                    "there is no room {id}: the store has rooms 0 to {}",
                    rooms.saturating_sub(1)
                )));
            }
            Ok(ids.clone())
        }
    }
}

/// Refuses a budget in which some tile would not fit beside what is reserved already.
///
/// # Errors
/// Exit 3, naming the room of the first such tile; exit 4 when a tile is missing.
pub fn refuse_large_tiles(
    tables: &Tables,
    reader: &TileReader<'_>,
    budget: &MemoryBudget,
    memory: u64,
) -> Result<()> {
    for tile in 0..tables.tiles().len() as u32 {
        let needs = reader.peak_bytes(tile)?;
        if needs > budget.available() {
            return Err(too_small(tables, tile, needs, budget, memory));
        }
    }
    Ok(())
}

/// The refusal that names the room, what it needs, and what would do.
pub fn too_small(
    tables: &Tables,
    tile: u32,
    needs: u64,
    budget: &MemoryBudget,
    memory: u64,
) -> Failure {
    let mib = |bytes: u64| bytes.div_ceil(1 << 20);
    let room = tables.tiles()[tile as usize].room;
    let held: Vec<String> =
        budget.holders().iter().map(|(what, bytes)| format!("{what} {}", mib(*bytes))).collect();
    Failure::budget(format!(
        "room {room} needs {} MiB of {}: mesh and grid {}, {}",
        mib(needs + budget.reserved()),
        memory >> 20,
        mib(needs),
        held.join(", ")
    ))
    .with_hint(format!(
        "--memory {}M would do, or cut it into smaller tiles: enf-partition --memory {}M",
        mib(needs * 2 + budget.reserved()),
        memory >> 20
    ))
}

/// Rooms are announced, and work is durable, about this often.
const ANNOUNCE_EVERY: Duration = Duration::from_millis(400);

/// Prints room ids in the order in which they were asked for, each after a commit that covers it.
pub struct Announcer<'a> {
    rooms: &'a [u32],
    out: &'a IdSink,
    announced: usize,
    last: Instant,
}

impl<'a> Announcer<'a> {
    /// An announcer of these rooms.
    pub fn new(rooms: &'a [u32], out: &'a IdSink) -> Self {
        Self { rooms, out, announced: 0, last: Instant::now() }
    }

    /// To be called when something was appended: commits and announces now and then, and ends the work when
    /// someone interrupts it or stops listening.
    ///
    /// # Errors
    /// Exit 5 when the commit fails; exit 130 or 143 when interrupted.
    pub fn step(
        &mut self,
        writer: &mut StageWriter,
        done: &dyn Fn(u32) -> bool,
    ) -> Result<Continue> {
        let signal = interrupt::interrupted();
        if self.last.elapsed() > ANNOUNCE_EVERY || signal.is_some() || self.out.closed() {
            self.end(writer, done)?;
        }
        match signal {
            Some(signal) => Err(Failure::interrupted(signal)),
            None if self.out.closed() => Ok(Continue::No),
            None => Ok(Continue::Yes),
        }
    }

    /// Commits, and announces what is done.
    ///
    /// # Errors
    /// Exit 5 when the commit fails.
    pub fn end(&mut self, writer: &mut StageWriter, done: &dyn Fn(u32) -> bool) -> Result<()> {
        writer.commit()?;
        self.last = Instant::now();
        while let Some(&room) = self.rooms.get(self.announced)
            && done(room)
            && !self.out.closed()
        {
            self.out.print(room)?;
            self.announced += 1;
        }
        Ok(())
    }
}
