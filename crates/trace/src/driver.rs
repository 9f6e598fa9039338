//! The main thread of a trace: chooses tiles, has them loaded ahead, hands out jobs, commits.
//!
//! Several tiles are visited at a time, so that no thread waits for the last job of a visit; tiles are loaded meanwhile. Before a
//! commit all visits come to an end: what is in the journal is whole.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use std::vec::IntoIter;

use crossbeam::channel::{Receiver, Sender, bounded, select};
use enf_stage::resident::{TileCache, TileData};
use enf_stage::{
    CommonArgs, Failure, Lane, Neighbours, Progress, Result, Scheduler, Sweep, interrupt, say,
};
use enf_store::{Buffer, Extent, Reservation, StoreError};

use crate::recorder::{Message, Status, Taken};
use crate::share::{self, Share};
use crate::tracer::{Context, Job, PROBES_PER_LIGHT, Waiting, Work};

/// Photons of one job: long enough to make its overhead small, short enough to share among threads.
pub(crate) const JOB_PHOTONS: u64 = 4096;
/// Photons of one visit, after which the scheduler may think again.
const VISIT_PHOTONS: u64 = 1 << 20;
/// A kill loses at most these bytes of work, or the time that `--epoch` says.
const EPOCH_BYTES: u64 = 256 << 20;
/// With fewer tiles in memory, no part of a building is there as a whole.
const FEW_TILES: usize = 13;

/// What a tracing thread says when a job is done: the tile, and what went wrong.
pub(crate) type Done = (u32, Result<()>);

/// A tile that is being visited.
struct Visit {
    data: Arc<TileData>,
    /// What the scheduler knew to wait here.
    pending: u64,
    /// Records of which the part from the given one on has still to be handed out.
    open: Option<(Arc<Waiting>, usize)>,
    extents: IntoIter<Extent>,
    consumed: Vec<Extent>,
    /// The light that is next, and its first photon; how far emission is.
    light: usize,
    photon: u64,
    cursor: u64,
    handed: u64,
    /// Jobs that are not done.
    flying: u64,
    /// Nothing more will be handed out.
    closed: bool,
}

/// What a visit hands out next.
enum Next {
    Job(Work),
    /// An extent has to be read back first.
    Extent(Extent),
    Nothing,
}

/// Ways to the other threads.
pub(crate) struct Channels {
    pub(crate) jobs: Sender<Job>,
    pub(crate) finished: Receiver<Done>,
    pub(crate) messages: Sender<Message>,
}

/// How the work is cut up and when it is committed.
pub(crate) struct Manner {
    /// Records per job that is read back, at most.
    pub(crate) block: usize,
    /// Time between commits.
    pub(crate) epoch: Duration,
    /// Jobs that are handed out and not done, at most.
    pub(crate) jobs: u64,
    /// Tiles that are fetched ahead.
    pub(crate) ahead: usize,
    pub(crate) share: Share,
}

/// See the module.
pub(crate) struct Driver<'a> {
    common: &'a CommonArgs,
    context: &'a Context<'a>,
    cache: TileCache<'a>,
    channels: Channels,
    manner: Manner,
    cursors: BTreeMap<u32, u64>,
    scheduler: Scheduler,
    neighbours: Neighbours,
    sweep: Sweep,
    lane: Lane,
    visits: BTreeMap<u32, Visit>,
    /// Visits that have something to hand out, the oldest first.
    open: VecDeque<u32>,
    flying: u64,
    progress: Progress,
    /// Flux of all lights over all channels, W.
    all_w: f64,
    commit_due: bool,
    committed_at: Instant,
    /// The recorder has failed: nothing more is to be begun.
    failed: Arc<AtomicBool>,
    /// For what grows with the trace.
    tables: Reservation,
}

impl<'a> Driver<'a> {
    #[allow(clippy::too_many_arguments)]
    pub(crate) fn new(
        common: &'a CommonArgs,
        context: &'a Context<'a>,
        cache: TileCache<'a>,
        channels: Channels,
        manner: Manner,
        cursors: BTreeMap<u32, u64>,
        scheduler: Scheduler,
        lane: Lane,
        failed: Arc<AtomicBool>,
        tables: Reservation,
    ) -> Self {
        let lights = context.tables.lights();
        let total = context.counts.total(lights.len());
        // Of several processes each knows its own part only, and not how large that is.
        let known = (manner.share.of == 1).then_some(total);
        let progress = Progress::new(common, "trace", known, "photons");
        let neighbours = Neighbours::new(context.tables);
        Self {
            common,
            context,
            cache,
            channels,
            manner,
            cursors,
            scheduler,
            sweep: Sweep::new(context.tables, &neighbours),
            neighbours,
            lane,
            visits: BTreeMap::new(),
            open: VecDeque::new(),
            flying: 0,
            progress,
            all_w: lights.iter().flat_map(|l| l.flux_w.map(f64::from)).sum(),
            commit_due: false,
            committed_at: Instant::now(),
            failed,
            tables,
        }
    }

    /// Traces until nothing waits anywhere; `waiting` is what an earlier run has left at each tile. Returns the loads of each tile.
    ///
    /// # Errors
    /// The first thing that went wrong; an interruption, after a commit.
    pub(crate) fn drive(mut self, waiting: &BTreeMap<u32, u64>) -> Result<BTreeMap<u32, u32>> {
        let tiles = self.context.tables.tiles().len() as u32;
        for tile in (0..tiles).filter(|&tile| self.manner.share.owns(tile)) {
            let left = self.starts(tile) - self.cursors.get(&tile).copied().unwrap_or(0);
            self.scheduler.add(tile, left + waiting.get(&tile).copied().unwrap_or(0));
        }
        if self.manner.share.of == 1 {
            // Nobody has news: this only asks how far things are.
            let status = self.ask(|reply| Message::Poll { now: false, reply })??;
            self.progress.resume(status.finished, self.share_of_flux(status.finished_w));
        }
        let driven = self.work();
        // Every job that was handed out must come back, whatever went wrong.
        while self.flying > 0 && self.channels.finished.recv().is_ok() {
            self.flying -= 1;
        }
        driven?;
        if self.manner.share.of == 1 {
            // Sums of flux round.
            let lights = self.context.tables.lights().len();
            self.progress.at(self.context.counts.total(lights), 1.0);
        }
        self.progress.finish();
        Ok(self.cache.loads().clone())
    }

    fn work(&mut self) -> Result<()> {
        loop {
            let signal = interrupt::interrupted();
            let failed = self.failed.load(Ordering::Relaxed);
            let stop = self.commit_due || failed || signal.is_some();
            self.hand_out(stop)?;
            if !stop {
                self.load_ahead()?;
            }
            if self.visits.is_empty() {
                if stop {
                    self.commit()?;
                    match signal {
                        Some(signal) => return Err(Failure::interrupted(signal)),
                        None => continue,
                    }
                }
                if self.cache.in_flight() == 0 {
                    match self.next_load(&|_| false) {
                        // It did not fit beside what is kept in memory.
                        Some(tile) => drop(self.cache.get(tile)?),
                        None if self.manner.share.of == 1 || self.wait_for_others()? => {
                            return Ok(());
                        }
                        None => {}
                    }
                    continue;
                }
            }
            select! {
                recv(self.channels.finished) -> done => self.done(done.map_err(|_| tracers_stopped())?)?,
                recv(self.cache.arrivals()) -> arrival => {
                    self.cache.arrived(arrival.map_err(|_| Failure::io("the loader threads have stopped"))?)?;
                }
            }
            while let Ok(done) = self.channels.finished.try_recv() {
                self.done(done)?;
            }
        }
    }

    /// Starts of a tile: every light that may start there, all its photons and probes.
    fn starts(&self, tile: u32) -> u64 {
        self.context.tables.lights_of(tile).iter().map(|&light| self.starts_of(light)).sum()
    }

    /// A light's photons, then its probes.
    fn starts_of(&self, light: u32) -> u64 {
        self.context.counts.of(light) + PROBES_PER_LIGHT
    }

    fn ask<T>(&self, message: impl FnOnce(Sender<T>) -> Message) -> Result<T> {
        let (reply, answer) = bounded(1);
        self.channels
            .messages
            .send(message(reply))
            .ok()
            .and_then(|()| answer.recv().ok())
            .ok_or_else(|| Failure::internal("the recorder has stopped"))
    }

    fn share_of_flux(&self, watts: f64) -> f64 {
        (watts / self.all_w.max(f64::MIN_POSITIVE)).max(0.0)
    }

    fn commit(&mut self) -> Result<()> {
        let _span = self.lane.io("commit", 0u32);
        self.ask(|reply| Message::Commit { reply })??;
        self.commit_due = false;
        self.committed_at = Instant::now();
        Ok(())
    }

    /// Keeps the tracing threads in jobs. If all is to `stop`, only what cannot be put back is handed out.
    fn hand_out(&mut self, stop: bool) -> Result<()> {
        while self.flying < self.manner.jobs {
            let Some(&tile) = self.open.front() else {
                if stop {
                    return Ok(());
                }
                let visits = &self.visits;
                let busy = |t: u32| visits.contains_key(&t);
                match self.scheduler.next_visit(self.cache.residents(), &busy) {
                    Some(tile) => self.begin(tile)?,
                    None => return Ok(()),
                }
                continue;
            };
            match self.next(tile, stop) {
                Next::Job(work) => {
                    let Some(visit) = self.visits.get_mut(&tile) else { continue };
                    visit.flying += 1;
                    let job = Job { tile: Arc::clone(&visit.data), work };
                    self.channels.jobs.send(job).map_err(|_| tracers_stopped())?;
                    self.flying += 1;
                }
                Next::Extent(extent) => {
                    let buffer = self.read_back(extent)?;
                    let Some(visit) = self.visits.get_mut(&tile) else { continue };
                    visit.open = Some((Arc::new(Waiting::Log(buffer)), 0));
                    visit.consumed.push(extent);
                }
                Next::Nothing => {
                    self.open.pop_front();
                    let Some(visit) = self.visits.get_mut(&tile) else { continue };
                    visit.closed = true;
                    if visit.flying == 0 {
                        self.end(tile)?;
                    }
                }
            }
        }
        Ok(())
    }

    /// Begins a visit of a tile that is resident.
    fn begin(&mut self, tile: u32) -> Result<()> {
        let data = self.cache.get(tile)?;
        let pending = self.scheduler.take(tile);
        let Taken { memory, extents } = self.ask(|reply| Message::Take { tile, reply })?;
        let cursor = self.cursors.get(&tile).copied().unwrap_or(0);
        let lights = self.context.tables.lights_of(tile);
        let (light, photon) = self.context.counts.place(lights, PROBES_PER_LIGHT, cursor);
        let visit = Visit {
            data,
            pending,
            handed: memory.len() as u64,
            open: Some((Arc::new(Waiting::Memory(memory)), 0)),
            extents: extents.into_iter(),
            consumed: Vec::new(),
            light,
            photon,
            cursor,
            flying: 0,
            closed: false,
        };
        self.visits.insert(tile, visit);
        self.open.push_back(tile);
        Ok(())
    }

    /// What a visit hands out next.
    fn next(&mut self, tile: u32, stop: bool) -> Next {
        let lights = self.context.tables.lights_of(tile);
        let Some(visit) = self.visits.get_mut(&tile) else { return Next::Nothing };
        if let Some((records, next)) = &mut visit.open {
            let (first, count) = (*next, records.records().len());
            if first < count {
                let step = (JOB_PHOTONS as usize).min(self.manner.block.max(256));
                *next = (first + step).min(count);
                let records = Arc::clone(records);
                return Next::Job(Work::Waiting { records, range: first..*next });
            }
            visit.open = None;
        }
        if stop || visit.handed >= VISIT_PHOTONS {
            return Next::Nothing;
        }
        if let Some(extent) = visit.extents.next() {
            visit.handed += extent.count;
            return Next::Extent(extent);
        }
        let Some(&light) = lights.get(visit.light) else { return Next::Nothing };
        let starts = self.context.counts.of(light) + PROBES_PER_LIGHT;
        let indices = visit.photon..(visit.photon + JOB_PHOTONS).min(starts);
        let count = indices.end - indices.start;
        visit.cursor += count;
        visit.handed += count;
        visit.photon = indices.end;
        if indices.end >= starts {
            (visit.light, visit.photon) = (visit.light + 1, 0);
        }
        Next::Job(Work::Emission { light, indices })
    }

    /// A job is done.
    fn done(&mut self, (tile, result): Done) -> Result<()> {
        self.flying -= 1;
        result?;
        let Some(visit) = self.visits.get_mut(&tile) else { return Ok(()) };
        visit.flying -= 1;
        self.commit_due |= self.committed_at.elapsed() > self.manner.epoch;
        match visit.closed && visit.flying == 0 {
            true => self.end(tile),
            false => Ok(()),
        }
    }

    /// All jobs of a visit are done: what it consumed is consumed, what it left waits again.
    fn end(&mut self, tile: u32) -> Result<()> {
        let Some(visit) = self.visits.remove(&tile) else { return Ok(()) };
        let Visit { data, pending, extents, consumed, cursor, .. } = visit;
        drop(data);
        let unused: Vec<Extent> = extents.collect();
        let starts = self.starts(tile);
        let left = starts - cursor + unused.iter().map(|e| e.count).sum::<u64>();
        self.cursors.insert(tile, cursor);
        let cursor = (starts > 0).then_some((tile, cursor));
        let unused = (tile, unused);
        let mut status = self.ask(|reply| Message::Visited { consumed, unused, cursor, reply })?;
        self.commit_due |= status.uncommitted > EPOCH_BYTES;
        self.make_room_for_tables(status.tables)?;
        let (finished_w, emitted_w) = (status.finished_w, status.emitted_w);
        self.progress.at(status.finished, self.share_of_flux(finished_w));
        self.progress.message(&format!(
            "room {}, {:.1} % of the flux in transit, {:.1} % not sent off",
            self.context.tables.tiles()[tile as usize].room,
            100.0 * self.share_of_flux(emitted_w - finished_w),
            100.0 * self.share_of_flux(self.all_w - emitted_w),
        ));
        self.take_note(&mut status)?;
        self.scheduler.add(tile, left.min(pending));
        if self.manner.share.of > 1 {
            self.take_news(false)?;
        }
        Ok(())
    }

    /// What grows with the trace takes the place of tiles.
    fn make_room_for_tables(&mut self, bytes: u64) -> Result<()> {
        // Not a little each time.
        let bytes = bytes.next_multiple_of(256 << 10);
        loop {
            if bytes <= self.tables.bytes() {
                return Ok(());
            }
            match self.tables.resize(bytes) {
                Err(_) if self.cache.make_way()? => {}
                Err(_) if self.flying > 0 => {
                    let done = self.channels.finished.recv().map_err(|_| tracers_stopped())?;
                    self.done(done)?;
                }
                other => return Ok(other?),
            }
        }
    }

    /// Puts what was parked into the schedule.
    fn take_note(&mut self, status: &mut Status) -> Result<()> {
        if let Some(error) = status.failure.take() {
            return Err(error.into());
        }
        for (&to, &count) in &status.parked {
            self.scheduler.add(to, count);
        }
        for &(tile, value) in &status.cursors {
            let known = self.cursors.entry(tile).or_default();
            *known = value.max(*known);
        }
        Ok(())
    }

    /// The tile to load next. A sweep pays where what belongs together is in memory together; if that is much less, light that goes to
    /// and fro between neighbours comes first.
    fn next_load(&self, excluded: &dyn Fn(u32) -> bool) -> Option<u32> {
        let here = self.cache.residents().count();
        let full = || self.cache.loads().values().sum::<u32>() as usize > here;
        if here < FEW_TILES && full() {
            return self.scheduler.next_load(self.cache.recent(), &self.neighbours, excluded);
        }
        self.scheduler.next_of_sweep(&self.sweep, excluded)
    }

    /// Asks for tiles that are worth it, as far as there is room, until enough wait for their visit.
    fn load_ahead(&mut self) -> Result<()> {
        loop {
            let (scheduler, visits) = (&self.scheduler, &self.visits);
            let waits = |tile: u32| scheduler.pending(tile) > 0 && !visits.contains_key(&tile);
            // The paper's schedule cares for what is resident only when its turn comes.
            let stays = |tile: u32| scheduler.prefers_residents() && waits(tile);
            let ready = self.cache.residents().filter(|&tile| stays(tile)).count();
            if ready + self.cache.in_flight() >= self.manner.ahead {
                return Ok(());
            }
            let cache = &self.cache;
            let under_way = |tile: u32| cache.is_in_flight(tile) || visits.contains_key(&tile);
            if scheduler.waits_for_resident(&|tile| cache.is_resident(tile), &under_way) {
                return Ok(());
            }
            let excluded = |tile: u32| cache.is_resident(tile) || under_way(tile);
            let next = self.next_load(&excluded);
            let Some(tile) = next else { return Ok(()) };
            if !self.cache.ask(tile, &|t| !stays(t))? {
                return Ok(());
            }
        }
    }

    /// Photons from the log. Tiles that nobody needs make way for them, and then the jobs that are under way.
    fn read_back(&mut self, extent: Extent) -> Result<Buffer> {
        loop {
            match self.ask(|reply| Message::Read { extent, reply })? {
                Err(StoreError::Budget(_)) if self.cache.make_way()? => {}
                Err(StoreError::Budget(_)) if self.flying > 0 => {
                    let done = self.channels.finished.recv().map_err(|_| tracers_stopped())?;
                    self.done(done)?;
                }
                other => return Ok(other?),
            }
        }
    }

    /// What others have parked here and how far they are, at once or when it is time to look. What is left of that: whether anything
    /// is in transit anywhere, and who is running.
    fn take_news(&mut self, now: bool) -> Result<Status> {
        let mut status = self.ask(|reply| Message::Poll { now, reply })??;
        self.take_note(&mut status)?;
        Ok(status)
    }

    /// Nothing is left to do here: shows others what was done, and waits until there is something again (false) or the trace has
    /// ended everywhere (true).
    fn wait_for_others(&mut self) -> Result<bool> {
        self.commit()?;
        let (mut pause, mut said) = (Duration::from_millis(5), Instant::now());
        loop {
            let Status { in_transit, running, .. } = self.take_news(true)?;
            if self.scheduler.total() > 0 {
                return Ok(false);
            }
            let done =
                |tile: &u32| self.cursors.get(tile).copied().unwrap_or(0) == self.starts(*tile);
            let late = (0..self.context.tables.tiles().len() as u32).find(|tile| !done(tile));
            if late.is_none() && !in_transit {
                return Ok(true);
            }
            if let Some(signal) = interrupt::interrupted() {
                self.commit()?;
                return Err(Failure::interrupted(signal));
            }
            if said.elapsed() > share::SAY_EVERY {
                said = Instant::now();
                say(self.common, self.manner.share.waits_for(late, &running));
            }
            let span = self.lane.io("wait for other processes", 0u32);
            std::thread::sleep(pause);
            drop(span);
            pause = (2 * pause).min(share::POLL_EVERY);
        }
    }
}

fn tracers_stopped() -> Failure {
    Failure::internal("the tracing threads have stopped")
}
