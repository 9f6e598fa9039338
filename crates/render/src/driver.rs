//! The main thread of a picture: chooses tiles, has them and their rooms loaded ahead, hands out jobs, owns the table of incoming rays.
//!
//! Rays of all tiles in memory are in work at a time, so that no thread waits for the last job of a tile, and loads go on meanwhile.
//! A tile is ready when its mesh is in memory, and the photon map of its room too if camera or gather rays wait there: shadow rays need none.
//! Camera rays are sent off when little else waits, so that the table holds what they come to; far tiles are loaded last, for the rays of
//! all bands under way.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crossbeam::channel::{Receiver, Sender, select};
use enf_layout::film::PixelRecord;
use enf_layout::segment::{Codec, ExtentKind};
use enf_layout::transit::TransitRecord;
use enf_stage::resident::{Cache, TileCache, TileData};
use enf_stage::{
    CommonArgs, ExitStatus, Failure, Lane, Neighbours, Progress, Result, RowTable, Scheduler,
    interrupt,
};
use enf_store::{Buffer, Extent, MemoryBudget, Reservation, StageWriter, StoreError};
use zerocopy::IntoBytes;

use crate::bands::{After, Bands, Exposed};
use crate::rooms::RoomReader;
use crate::shade::{Context, Found, Job, Products, RoomLight, Waiting, Work};
use crate::smooth::{self, Smoothing};
use crate::{BAND_PIXELS, RenderArgs};

/// Jobs of one visit, after which the schedule may think again.
const VISIT_JOBS: u32 = 64;

/// What a rendering thread is given.
pub(crate) enum Task {
    /// Rays.
    Rays(Job),
    /// A band that comes to those whose gathered light is averaged.
    Smooth(Box<Smoothing>),
}

/// What comes back.
pub(crate) enum Done {
    Rays(Products),
    Smoothed(Vec<smooth::Smoothed>),
}

/// Counts for the report.
#[derive(Default)]
pub(crate) struct Shown {
    pub(crate) camera: u64,
    pub(crate) shadow: u64,
    pub(crate) gathers: u64,
    pub(crate) found: Found,
    pub(crate) evictions: u64,
    pub(crate) spilled_blocks: u64,
    pub(crate) spilled_records: u64,
    /// Loads of rooms' maps and lights.
    pub(crate) room_loads: u64,
    /// Rooms whose maps were in memory in part only.
    pub(crate) rooms_in_part: u64,
    /// Contributions that were no numbers, and are left out.
    pub(crate) not_finite: u64,
}

/// Ways to the other threads.
pub(crate) struct Channels {
    pub(crate) tasks: Sender<Task>,
    pub(crate) finished: Receiver<Result<Done>>,
}

/// How much is in work at a time.
pub(crate) struct Manner {
    /// Jobs that are handed out and not done, at most.
    pub(crate) jobs: u64,
    /// Tiles that are fetched ahead.
    pub(crate) ahead: usize,
    /// Bands under way at most.
    pub(crate) bands: u32,
    /// Bytes that are left to blocks of rays that are read back.
    pub(crate) margin: u64,
}

/// A tile whose rays are handed out.
struct Visit {
    tile: u32,
    data: Arc<TileData>,
    light: Arc<RoomLight>,
    /// Whether the light is the room's, for camera and gather rays.
    lit: bool,
    /// Whether camera rays are sent off, and nothing else.
    launches: bool,
    /// Records of which the part from the given one on has still to be handed out.
    open: Option<(Arc<Waiting>, usize)>,
    jobs: u32,
}

/// See the module.
pub(crate) struct Driver<'a> {
    pub(crate) common: &'a CommonArgs,
    pub(crate) args: &'a RenderArgs,
    pub(crate) context: &'a Context<'a>,
    pub(crate) budget: MemoryBudget,
    pub(crate) tiles: TileCache<'a>,
    pub(crate) rooms: Cache<RoomReader<'a>>,
    pub(crate) channels: Channels,
    pub(crate) manner: Manner,
    pub(crate) writer: StageWriter,
    pub(crate) rows: RowTable<TransitRecord>,
    /// Rays that the table holds at most.
    pub(crate) capacity: u64,
    pub(crate) scheduler: Scheduler,
    pub(crate) neighbours: Neighbours,
    pub(crate) lane: Lane,
    pub(crate) state: State,
}

/// What changes while it works.
pub(crate) struct State {
    /// Rays in the log, by tile.
    waiting: BTreeMap<u32, Vec<Extent>>,
    /// Tiles where camera or gather rays wait.
    lit: BTreeSet<u32>,
    /// Camera rays to be sent off, by tile; the schedule counts them too.
    launches: BTreeMap<u32, u64>,
    /// For visits of shadow rays alone.
    unlit: Arc<RoomLight>,
    bands: Bands,
    /// Bands to be made, in order, and whether they are to be written; those before `begun` are begun.
    plan: Vec<(u32, bool)>,
    begun: usize,
    /// Finished bands that wait for those before them, when neighbours are averaged.
    exposed: BTreeMap<u32, Exposed>,
    /// Bands, in the plan, that have been handed over to be averaged.
    pushed: usize,
    visit: Option<Visit>,
    /// Tasks that are handed out and not done.
    flying: u64,
    /// Whether one of them averages a band.
    smoothing: bool,
    /// Whether something that was asked for has found no room, and nothing has come back since.
    refused: bool,
    /// Bands written, and those not to be made.
    written_rays: u64,
    pub(crate) shown: Shown,
}

impl Default for State {
    fn default() -> Self {
        Self {
            waiting: BTreeMap::new(),
            lit: BTreeSet::new(),
            launches: BTreeMap::new(),
            unlit: Arc::new(RoomLight::default()),
            bands: Bands::new(),
            plan: Vec::new(),
            begun: 0,
            exposed: BTreeMap::new(),
            pushed: 0,
            visit: None,
            flying: 0,
            smoothing: false,
            refused: false,
            written_rays: 0,
            shown: Shown::default(),
        }
    }
}

impl Driver<'_> {
    /// Makes all bands that are not there yet.
    ///
    /// # Errors
    /// The first thing that went wrong, an interruption among them; bands that are written stay.
    pub(crate) fn drive(&mut self) -> Result<()> {
        self.forget_lost_rays();
        let total = *self.context.first_pixels.last().unwrap_or(&0);
        let bands = total.div_ceil(BAND_PIXELS);
        let done: BTreeSet<u32> =
            self.writer.extents().filter(|e| e.kind == ExtentKind::Film).map(|e| e.id).collect();
        let samples = u64::from(self.context.samples);
        let rays = u64::from(total) * samples;
        let progress = Progress::new(self.common, "render", Some(rays), "rays");
        let share = done.len() as f64 / f64::from(bands.max(1));
        progress.resume((share * rays as f64) as u64, share);
        let smoothed = self.args.smooths();
        let widest = self.context.views.iter().map(|v| v.camera.width).max().unwrap_or(0);
        // Pixels wait for those about them.
        let _reservation = match smoothed {
            true => Some(self.reserve(smooth::bytes(total.min(BAND_PIXELS), widest), "film")?),
            false => None,
        };
        let window = smooth::Window::new(widest, total, self.args);
        let about = if smoothed { smooth::bands_before(widest) } else { 0 };
        for band in 0..bands {
            let write = !done.contains(&band);
            // What comes after a band is smoothed across its edge: the same samples make the same bits once more.
            let before = (band + 1..bands.min(band + 1 + about)).any(|b| !done.contains(&b));
            match write || before {
                true => self.state.plan.push((band, write)),
                false => self.state.written_rays += self.rays_of(band, total),
            }
        }
        let worked = self.work(total, &window, &progress);
        // Every job that was handed out must come back, whatever went wrong.
        while self.state.flying > 0 && self.channels.finished.recv().is_ok() {
            self.state.flying -= 1;
        }
        worked?;
        self.state.shown.evictions = self.rows.evictions();
        progress.finish();
        Ok(())
    }

    /// Rays that an earlier run has left in the log: their bands are begun again.
    fn forget_lost_rays(&mut self) {
        let lost: Vec<Extent> =
            self.writer.extents().filter(|e| e.kind == ExtentKind::Transit).copied().collect();
        lost.iter().for_each(|extent| self.writer.consume(extent));
    }

    fn rays_of(&self, band: u32, total: u32) -> u64 {
        let pixels = BAND_PIXELS.min(total - band * BAND_PIXELS);
        u64::from(pixels) * u64::from(self.context.samples)
    }

    fn work(&mut self, total: u32, window: &smooth::Window, progress: &Progress) -> Result<()> {
        loop {
            // A band that is interrupted is begun again: nothing is gained by coming to the end of anything.
            interrupt::check()?;
            self.end_passes(total, window)?;
            self.begin_bands(total)?;
            self.hand_out()?;
            self.load_ahead()?;
            let samples = u64::from(self.context.samples);
            progress.set(self.state.written_rays + self.state.bands.sent(samples));
            let loading = self.tiles.in_flight() + self.rooms.in_flight() > 0;
            if self.state.flying == 0 && !loading {
                // Bands that wait for those before them are no reason not to go on with these.
                let next = self.state.plan.get(self.state.pushed);
                let pushable = next.is_some_and(|(band, _)| self.state.exposed.contains_key(band));
                if self.state.bands.over().is_some() || pushable {
                    continue;
                }
                if self.scheduler.total() > 0 {
                    if self.pick().is_none() {
                        self.force()?;
                    }
                    continue;
                }
                if self.state.bands.is_empty() && self.state.begun == self.state.plan.len() {
                    return Ok(());
                }
                return Err(Failure::internal("rays of a band are lost"));
            }
            let channels = &self.channels;
            select! {
                recv(channels.finished) -> done => {
                    self.receive(done.unwrap_or_else(|_| Err(threads_stopped())), progress)?;
                }
                recv(self.tiles.arrivals()) -> arrival => {
                    let found_room = self.tiles.arrived(arrival.map_err(|_| loaders_stopped())?)?;
                    self.state.refused |= !found_room;
                }
                recv(self.rooms.arrivals()) -> arrival => {
                    let found_room = self.rooms.arrived(arrival.map_err(|_| loaders_stopped())?)?;
                    self.state.refused |= !found_room;
                }
            }
            while let Ok(done) = self.channels.finished.try_recv() {
                self.receive(done, progress)?;
            }
        }
    }

    /// Begins further bands while there is room for them, and few rays wait.
    fn begin_bands(&mut self, total: u32) -> Result<()> {
        loop {
            let state = &self.state;
            let Some(&(band, _)) = state.plan.get(state.begun) else { return Ok(()) };
            let behind = state.bands.len() + state.exposed.len();
            let launching: u64 = state.launches.values().sum();
            let parked = self.all_parked();
            if behind > 0 {
                let enough = launching > 0 && self.is_any_launch_ready();
                if behind >= self.manner.bands as usize || enough || parked > self.capacity / 2 {
                    return Ok(());
                }
            }
            let pixels = BAND_PIXELS.min(total - band * BAND_PIXELS);
            let begun = self.state.bands.begin(band, pixels, self.context, &self.budget);
            match begun {
                Ok(()) => {}
                Err(_) if self.make_way()? => continue,
                // It will fit when another is done.
                Err(_) if behind > 0 => return Ok(()),
                Err(error) => return Err(StoreError::from(error).into()),
            }
            self.state.begun += 1;
            self.note_launches(band);
        }
    }

    /// The rays that a pass of a band begins with come into the schedule.
    fn note_launches(&mut self, band: u32) {
        for (tile, rays) in self.state.bands.launches(band) {
            self.scheduler.add(tile, rays);
            *self.state.launches.entry(tile).or_default() += rays;
            self.state.lit.insert(tile);
        }
    }

    /// What bands without a ray lead to: another pass, or pixels.
    fn end_passes(&mut self, total: u32, window: &smooth::Window) -> Result<()> {
        while let Some(band) = self.state.bands.over() {
            let span = self.lane.span("develop", band);
            let after = self.state.bands.end_pass(band, self.context, self.args);
            drop(span);
            match after {
                Some(After::Pass) => self.note_launches(band),
                Some(After::Done(exposed)) => {
                    self.state.written_rays += self.rays_of(band, total);
                    self.state.shown.not_finite += exposed.not_finite;
                    match self.args.smooths() {
                        true => drop(self.state.exposed.insert(band, exposed)),
                        false => self.put(band, &exposed.records)?,
                    }
                }
                None => {}
            }
        }
        self.push_exposed(window)
    }

    /// Hands the band whose turn it is to the threads; one at a time is averaged with those before.
    fn push_exposed(&mut self, window: &smooth::Window) -> Result<()> {
        let next = self.state.plan.get(self.state.pushed).copied();
        if let (Some((band, write)), false) = (next, self.state.smoothing)
            && let Some(exposed) = self.state.exposed.remove(&band)
        {
            self.state.pushed += 1;
            let Exposed { records, gathered, reservation, .. } = exposed;
            drop(reservation);
            self.smooth(window.push(smooth::Exposed { band, write, records, gathered }))?;
        }
        Ok(())
    }

    fn smooth(&mut self, smoothing: Smoothing) -> Result<()> {
        let task = Task::Smooth(Box::new(smoothing));
        self.channels.tasks.send(task).map_err(|_| threads_stopped())?;
        self.state.flying += 1;
        self.state.smoothing = true;
        Ok(())
    }

    /// Writes a band.
    fn put(&mut self, band: u32, records: &[PixelRecord]) -> Result<()> {
        let _span = self.lane.io("write", band);
        let count = records.len() as u64;
        self.writer.append(ExtentKind::Film, band, count, records.as_bytes(), Codec::Raw)?;
        self.writer.commit()?;
        self.writer.release_consumed()?;
        Ok(())
    }

    /// Whether a tile's rays can be handed out: its mesh, and its room's map if it needs that, are in memory.
    fn is_ready(&self, tile: u32) -> bool {
        self.tiles.is_resident(tile)
            && (!self.state.lit.contains(&tile) || self.rooms.is_resident(self.room_of(tile)))
    }

    fn room_of(&self, tile: u32) -> u32 {
        self.context.tables.tiles()[tile as usize].room
    }

    fn is_any_launch_ready(&self) -> bool {
        self.state.launches.keys().any(|&tile| self.is_ready(tile))
    }

    /// Rays that wait anywhere, those to be sent off apart.
    fn all_parked(&self) -> u64 {
        self.scheduler.total() - self.state.launches.values().sum::<u64>()
    }

    /// Whether more is ready than the threads are given at a time.
    fn is_busy(&self) -> bool {
        let enough = self.manner.jobs * self.context.job_rays;
        let ready = self.tiles.residents().filter(|&tile| self.is_ready(tile));
        let mut rays = 0;
        ready.map(|tile| self.scheduler.pending(tile)).any(|pending| {
            rays += pending;
            rays > enough
        })
    }

    /// Rays that wait at a tile, those to be sent off apart.
    fn parked(&self, tile: u32) -> u64 {
        self.scheduler.pending(tile) - self.state.launches.get(&tile).copied().unwrap_or(0)
    }

    /// Keeps the threads in jobs.
    fn hand_out(&mut self) -> Result<()> {
        while self.state.flying < self.manner.jobs {
            let visit = match self.state.visit.take() {
                Some(visit) => Some(visit),
                None => self.pick().and_then(|(tile, launches)| self.visit(tile, launches)),
            };
            let Some(mut visit) = visit else { return Ok(()) };
            let Some(job) = self.next(&mut visit)? else { continue };
            visit.jobs += 1;
            // Whatever has left the table is handed out.
            if visit.jobs < VISIT_JOBS || visit.open.is_some() {
                self.state.visit = Some(visit);
            }
            self.channels.tasks.send(Task::Rays(job)).map_err(|_| threads_stopped())?;
            self.state.flying += 1;
        }
        Ok(())
    }

    /// The tile whose rays are handed out next, of those that are ready, and whether it sends off camera rays: where enough waits for
    /// a job, or the table is full, the one with the most rays; else a tile that sends off; else whatever waits.
    fn pick(&self) -> Option<(u32, bool)> {
        let ready = || self.tiles.residents().filter(|&tile| self.is_ready(tile));
        if !self.scheduler.prefers_residents() {
            let tile = self.scheduler.next_visit(ready(), &|_| false)?;
            return Some((tile, self.parked(tile) == 0));
        }
        let busiest = ready()
            .map(|tile| (self.parked(tile), tile))
            .filter(|&(rays, _)| rays > 0)
            .max_by(|a, b| a.0.cmp(&b.0).then(b.1.cmp(&a.1)));
        let launch = self.state.launches.keys().copied().find(|&tile| self.is_ready(tile));
        let full = self.all_parked() > self.capacity / 2;
        match (busiest, launch) {
            (Some((rays, tile)), Some(_)) if full || rays >= self.context.job_rays => {
                Some((tile, false))
            }
            (_, Some(tile)) => Some((tile, true)),
            (busiest, None) => busiest.map(|(_, tile)| (tile, false)),
        }
    }

    /// A visit of a tile that is ready.
    fn visit(&mut self, tile: u32, launches: bool) -> Option<Visit> {
        let lit = self.state.lit.contains(&tile);
        let data = self.tiles.resident(tile)?;
        let light = match lit {
            true => self.rooms.resident(self.room_of(tile))?,
            false => Arc::clone(&self.state.unlit),
        };
        Some(Visit { tile, data, light, lit, launches, open: None, jobs: 0 })
    }

    /// The next job of a visit; `None` when it has come to its end.
    fn next(&mut self, visit: &mut Visit) -> Result<Option<Job>> {
        let job_rays = self.context.job_rays;
        let tile = visit.tile;
        let work = if visit.launches {
            let state = &mut self.state;
            let Some((_, first_pixel, pass, indices)) =
                state.bands.launch(job_rays, |at| at == tile)
            else {
                return Ok(None);
            };
            let sent = indices.end - indices.start;
            if let Some(left) = state.launches.get_mut(&tile) {
                *left -= sent.min(*left);
                if *left == 0 {
                    state.launches.remove(&tile);
                }
            }
            self.sent_off(tile, sent);
            // One job at a time: what comes of it may be more urgent.
            visit.jobs = VISIT_JOBS;
            Work::Camera { first_pixel, pass, indices }
        } else {
            loop {
                if let Some((records, next)) = &mut visit.open {
                    let (first, count) = (*next, records.records().len());
                    if first < count {
                        *next = (first + job_rays as usize).min(count);
                        let (records, range) = (Arc::clone(records), first..*next);
                        if *next == count {
                            visit.open = None;
                        }
                        break Work::Waiting { records, range };
                    }
                    visit.open = None;
                }
                // What has come meanwhile may ask for more than was loaded for this visit.
                let unlit = !visit.lit && self.state.lit.contains(&tile);
                if unlit || visit.jobs >= VISIT_JOBS {
                    return Ok(None);
                }
                let memory: Vec<TransitRecord> = self.rows.take(tile).collect();
                let waiting = if memory.is_empty() {
                    let extents = self.state.waiting.get_mut(&tile);
                    let Some(extent) = extents.and_then(Vec::pop) else {
                        self.state.waiting.remove(&tile);
                        if self.scheduler.pending(tile) == 0 {
                            self.state.lit.remove(&tile);
                        }
                        return Ok(None);
                    };
                    self.writer.consume(&extent);
                    Waiting::Log(self.read_back(&extent)?)
                } else {
                    Waiting::Memory(memory)
                };
                self.sent_off(tile, waiting.records().len() as u64);
                visit.open = Some((Arc::new(waiting), 0));
            }
        };
        Ok(Some(Job {
            tile: Arc::clone(&visit.data),
            light: Arc::clone(&visit.light),
            films: self.state.bands.films(),
            work,
        }))
    }

    /// So many rays do not wait at a tile any more.
    fn sent_off(&mut self, tile: u32, rays: u64) {
        let waited = self.scheduler.take(tile);
        self.scheduler.add(tile, waited - rays.min(waited));
    }

    /// Rays from the log. Maps and tiles that nobody needs make way for them, and then the jobs that are under way.
    fn read_back(&mut self, extent: &Extent) -> Result<Buffer> {
        loop {
            match self.writer.read(extent, &self.budget, "incoming rays") {
                Err(StoreError::Budget(_)) if self.make_way()? => {}
                Err(StoreError::Budget(_)) if self.state.flying > 0 => {
                    let done = self.channels.finished.recv();
                    self.take_in(done.unwrap_or_else(|_| Err(threads_stopped())))?;
                }
                other => return Ok(other?),
            }
        }
    }

    /// Asks for tiles and rooms that are worth it, as far as there is room, until enough wait for their visit.
    fn load_ahead(&mut self) -> Result<()> {
        while !self.state.refused {
            // The paper's schedule cares for what is resident only when its turn comes.
            let stays = self.scheduler.prefers_residents();
            let waits = |tile: u32| stays && self.scheduler.pending(tile) > 0;
            let ready = self.tiles.residents().filter(|&t| waits(t) && self.is_ready(t)).count();
            if ready + self.tiles.in_flight() + self.rooms.in_flight() >= self.manner.ahead {
                return Ok(());
            }
            let comes = |tile: u32| {
                let room = self.room_of(tile);
                (self.tiles.is_resident(tile) || self.tiles.is_in_flight(tile))
                    && (!self.state.lit.contains(&tile)
                        || self.rooms.is_resident(room)
                        || self.rooms.is_in_flight(room))
            };
            let next = self.scheduler.next_load(self.tiles.recent(), &self.neighbours, &comes);
            let Some(tile) = next else { return Ok(()) };
            // As long as there is enough to do, a tile where little waits is left for more to come there.
            if stays && self.scheduler.pending(tile) < self.context.job_rays && self.is_busy() {
                break;
            }
            if !self.ask(tile)? {
                break;
            }
        }
        Ok(())
    }

    /// Asks for what a tile lacks, if it fits beside all that is in use or waited for.
    fn ask(&mut self, tile: u32) -> Result<bool> {
        let room = self.room_of(tile);
        let (tile_bytes, room_bytes) = self.lacks(tile)?;
        let coming = self.tiles.coming() + self.rooms.coming() + self.manner.margin;
        let busy: BTreeSet<u32> = self
            .tiles
            .residents()
            .filter(|&t| t == tile || self.scheduler.pending(t) > 0)
            .collect();
        let busy_rooms: BTreeSet<u32> = busy
            .iter()
            .filter(|t| self.state.lit.contains(t))
            .map(|&t| self.room_of(t))
            .chain([room])
            .collect();
        let idle = |t: u32| !busy.contains(&t);
        let idle_room = |r: u32| !busy_rooms.contains(&r);
        while self.budget.available() < coming + tile_bytes + room_bytes {
            let (a, b) = (self.tiles.oldest(&idle), self.rooms.oldest(&idle_room));
            let gone = match (a, b) {
                (Some(a), Some(b)) if a < b => self.tiles.evict(&idle),
                (_, Some(_)) => self.rooms.evict(&idle_room),
                (Some(_), None) => self.tiles.evict(&idle),
                (None, None) => false,
            };
            if !gone {
                return Ok(false);
            }
        }
        if tile_bytes > 0 && !self.tiles.ask(tile, &idle)? {
            return Ok(false);
        }
        Ok(room_bytes == 0 || self.rooms.ask(room, &idle_room)?)
    }

    /// Bytes of what a tile lacks for its rays: mesh, and map of its room.
    fn lacks(&self, tile: u32) -> Result<(u64, u64)> {
        let room = self.room_of(tile);
        let here = self.tiles.is_resident(tile) || self.tiles.is_in_flight(tile);
        let lit = !self.state.lit.contains(&tile)
            || self.rooms.is_resident(room)
            || self.rooms.is_in_flight(room);
        let mesh = if here { 0 } else { self.tiles.needs(tile)? };
        // A room without a map has lights still.
        let map = if lit { 0 } else { self.rooms.needs(room)?.max(1) };
        Ok((mesh, map))
    }

    /// Nothing flies, comes or is ready: what is next takes the place of all others.
    fn force(&mut self) -> Result<()> {
        let next = self.scheduler.next_load(self.tiles.recent(), &self.neighbours, &|_| false);
        let Some(tile) = next else { return Ok(()) };
        let data = self.tile(tile)?;
        let lit = self.state.lit.contains(&tile);
        let light = match lit {
            true => self.room(self.room_of(tile))?,
            false => Arc::clone(&self.state.unlit),
        };
        self.state.refused = false;
        let launches = self.parked(tile) == 0;
        let open = None;
        self.state.visit = Some(Visit { tile, data, light, lit, launches, open, jobs: 0 });
        Ok(())
    }

    /// The tile; maps of rooms that are not in use make way if the budget has no room.
    fn tile(&mut self, tile: u32) -> Result<Arc<TileData>> {
        loop {
            match self.tiles.get(tile) {
                Err(error) if error.code == ExitStatus::Budget && self.rooms.make_way()? => {}
                other => return other,
            }
        }
    }

    /// The room; tiles that are not in use make way if the budget has no room.
    fn room(&mut self, room: u32) -> Result<Arc<RoomLight>> {
        loop {
            match self.rooms.get(room) {
                Err(error) if error.code == ExitStatus::Budget && self.tiles.make_way()? => {}
                other => return other,
            }
        }
    }

    /// Frees a map or a tile that is not in use; false when there is none.
    fn make_way(&mut self) -> Result<bool> {
        let any = |_: u32| true;
        match (self.tiles.oldest(&any), self.rooms.oldest(&any)) {
            (Some(a), Some(b)) if a < b => Ok(self.tiles.evict(&any)),
            (_, Some(_)) => Ok(self.rooms.evict(&any)),
            _ => Ok(self.tiles.make_way()? || self.rooms.make_way()?),
        }
    }

    /// Reserves memory; maps and tiles that are not in use make way.
    fn reserve(&mut self, bytes: u64, what: &'static str) -> Result<Reservation> {
        loop {
            match self.budget.reserve(bytes, what) {
                Err(_) if self.make_way()? => {}
                other => return Ok(other?),
            }
        }
    }

    fn receive(&mut self, done: Result<Done>, progress: &Progress) -> Result<()> {
        if let Some(tile) = self.take_in(done)? {
            progress.message(&format!("room {}", self.room_of(tile)));
        }
        Ok(())
    }

    /// Takes in what has come back; says of which tile it was.
    fn take_in(&mut self, done: Result<Done>) -> Result<Option<u32>> {
        self.state.flying -= 1;
        self.state.refused = false;
        let products = match done? {
            Done::Rays(products) => products,
            Done::Smoothed(bands) => {
                self.state.smoothing = false;
                for (band, records) in bands {
                    self.put(band, &records)?;
                }
                return Ok(None);
            }
        };
        let Self { rows, writer, state, scheduler, .. } = self;
        let State { waiting, shown, lit, bands, .. } = state;
        shown.camera += products.camera;
        shown.shadow += products.shadow;
        shown.gathers += products.gathers;
        shown.found.add_all(products.found);
        for lane in &products.parked {
            scheduler.add(lane.tile, lane.records.len() as u64);
            if lane.lit {
                lit.insert(lane.tile);
            }
            rows.push(lane.tile, &lane.records, &mut |tile, records: &[TransitRecord]| {
                shown.spilled_blocks += 1;
                shown.spilled_records += records.len() as u64;
                let (kind, count) = (ExtentKind::Transit, records.len() as u64);
                let extent = writer.append(kind, tile, count, records.as_bytes(), Codec::Raw)?;
                waiting.entry(tile).or_default().push(extent);
                Ok::<(), StoreError>(())
            })?;
        }
        bands.count(&products.lives);
        Ok(Some(products.tile))
    }
}

pub(crate) fn threads_stopped() -> Failure {
    Failure::internal("the rendering threads have stopped")
}

fn loaders_stopped() -> Failure {
    Failure::io("the loader threads have stopped")
}
