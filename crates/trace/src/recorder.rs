//! The one owner of everything that a trace writes: the table of incoming photons (the paper's `TP`), the
//! photon rows, the logs and the journal. Tracers send it blocks through a channel; nobody locks anything. What other
//! processes do with the same trace comes in here as well.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crossbeam::channel::{Receiver, Sender};
use enf_layout::journal::{LedgerRecord, LightPairRecord, PassageRecord};
use enf_layout::photon::PhotonRecord;
use enf_layout::segment::StageKind;
use enf_layout::segment::{Codec, ExtentKind};
use enf_layout::transit::TransitRecord;
use enf_stage::rowtable::RowTable;
use enf_stage::{Failure, Lane, interrupt};
use enf_store::{
    Buffer, Extent, Identity, MemoryBudget, Peer, StageReader, StageWriter, StoreDir, StoreError,
};
use zerocopy::{FromBytes, IntoBytes};

use crate::counts::Counts;
use crate::share::{FIRST_PATIENCE, Others, POLL_EVERY, SAY_EVERY, Share};
use crate::tracer::{Epoch, Products, add_ledger, empty_ledger};

/// Photons in transit that were consumed are given back to the file system when they have so many bytes. It is not done for less: what has
/// holes is read once more when it is sealed.
const RELEASE_BYTES: u64 = 256 << 20;

/// What the recorder is asked to do.
pub(crate) enum Message {
    /// Blocks of one job.
    Products(Box<Products>),
    /// What waits at a tile; the extents are marked as consumed when the visit ends.
    Take { tile: u32, reply: Sender<Taken> },
    /// An extent's records.
    Read { extent: Extent, reply: Sender<Result<Buffer, StoreError>> },
    /// All jobs of a visit are done: these extents are consumed, emission has got this far.
    Visited {
        consumed: Vec<Extent>,
        unused: (u32, Vec<Extent>),
        cursor: Option<(u32, u64)>,
        reply: Sender<Status>,
    },
    /// What other processes have committed, if it is time to look.
    Poll { now: bool, reply: Sender<Result<Status, StoreError>> },
    /// Make everything durable.
    Commit { reply: Sender<Result<(), StoreError>> },
}

/// What waited at a tile.
pub(crate) struct Taken {
    pub(crate) memory: Vec<TransitRecord>,
    pub(crate) extents: Vec<Extent>,
}

/// What a visit changed, for the scheduler.
pub(crate) struct Status {
    /// Records newly parked at own tiles, by tile.
    pub(crate) parked: BTreeMap<u32, u64>,
    /// How far others are with the emission at their tiles, as far as that is new.
    pub(crate) cursors: Vec<(u32, u64)>,
    /// Something that is committed is in transit, here or in another process.
    pub(crate) in_transit: bool,
    /// Other processes that are at work, for who waits for them.
    pub(crate) running: Vec<u32>,
    /// Photons whose path has ended, since the start of the trace.
    pub(crate) finished: u64,
    /// Flux of them, W over all channels.
    pub(crate) finished_w: f64,
    /// Flux of all that were emitted, the same.
    pub(crate) emitted_w: f64,
    /// Bytes written since the last commit.
    pub(crate) uncommitted: u64,
    /// Bytes of the tables that grow with the trace.
    pub(crate) tables: u64,
    /// The first thing that went wrong.
    pub(crate) failure: Option<StoreError>,
}

/// Totals of a trace.
pub struct Totals {
    /// By room.
    pub ledger: BTreeMap<u32, LedgerRecord>,
    /// By (from, to): photons and scalar flux, W.
    pub passages: BTreeMap<(u32, u32), (u64, f64)>,
    /// Rows that made way for others.
    pub evictions: u64,
    /// Blocks written to the transit log.
    pub spilled_blocks: u64,
    /// Records in them.
    pub spilled_records: u64,
    /// Photon visits: each time a photon was taken up.
    pub traced: u64,
}

impl Totals {
    /// What the ledger of a trace says, finished or not; what only the run itself knew is 0.
    ///
    /// # Errors
    /// A damaged ledger.
    pub fn read(reader: &StageReader, budget: &MemoryBudget) -> Result<Self, StoreError> {
        let mut totals = Self {
            ledger: BTreeMap::new(),
            passages: BTreeMap::new(),
            evictions: 0,
            spilled_blocks: 0,
            spilled_records: 0,
            traced: 0,
        };
        for extent in reader.extents(ExtentKind::Ledger) {
            let block = reader.read(extent, budget, "ledger")?;
            for line in block.as_slice_of::<LedgerRecord>()? {
                let sum = totals.ledger.entry(line.room).or_insert_with(|| empty_ledger(line.room));
                add_ledger(sum, line);
            }
        }
        for extent in reader.extents(ExtentKind::Passages) {
            let block = reader.read(extent, budget, "ledger")?;
            for passage in block.as_slice_of::<PassageRecord>()? {
                let sum = totals.passages.entry((passage.from, passage.to)).or_default();
                sum.0 += passage.photons;
                sum.1 += passage.flux_w;
            }
        }
        Ok(totals)
    }
}

/// See the module.
pub(crate) struct Recorder {
    writer: StageWriter,
    share: Share,
    others: Others,
    /// Since the last commit, photons of others were consumed, or others have consumed photons of ours.
    built_on_others: bool,
    /// How far others are with emission, by tile.
    foreign_cursors: BTreeMap<u32, u64>,
    budget: MemoryBudget,
    transit: RowTable<TransitRecord>,
    photons: RowTable<PhotonRecord>,
    waiting: BTreeMap<u32, Vec<Extent>>,
    parked: BTreeMap<u32, u64>,
    counts: Arc<Counts>,
    /// The sums since the start of the trace, and since the last commit.
    all: Epoch,
    epoch: Epoch,
    uncommitted: u64,
    failure: Option<StoreError>,
    /// Tells the main thread of a failure before it asks.
    failed: Arc<AtomicBool>,
    traced: u64,
}

impl Recorder {
    /// Takes up where the journal ends.
    pub(crate) fn new(
        writer: StageWriter,
        share: Share,
        budget: &MemoryBudget,
        transit: RowTable<TransitRecord>,
        photons: RowTable<PhotonRecord>,
        counts: Arc<Counts>,
    ) -> Result<Self, StoreError> {
        let mut recorder = Self {
            writer,
            share,
            others: Others::new(share),
            built_on_others: false,
            foreign_cursors: BTreeMap::new(),
            budget: budget.clone(),
            transit,
            photons,
            waiting: BTreeMap::new(),
            parked: BTreeMap::new(),
            counts,
            all: Epoch::default(),
            epoch: Epoch::default(),
            uncommitted: 0,
            failure: None,
            failed: Arc::default(),
            traced: 0,
        };
        let extents: Vec<Extent> = recorder.writer.extents().copied().collect();
        for extent in extents {
            match extent.kind {
                ExtentKind::Transit if share.owns(extent.id) => {
                    recorder.waiting.entry(extent.id).or_default().push(extent);
                }
                ExtentKind::Ledger => {
                    for record in recorder.records::<LedgerRecord>(&extent)? {
                        recorder.all.room(&record);
                    }
                }
                ExtentKind::Passages => {
                    for record in recorder.records::<PassageRecord>(&extent)? {
                        let sum =
                            recorder.all.passages.entry((record.from, record.to)).or_default();
                        sum.0 += record.photons;
                        sum.1 += record.flux_w;
                    }
                }
                ExtentKind::LightPairs => {
                    for pair in recorder.records::<LightPairRecord>(&extent)? {
                        *recorder.all.sees.entry((pair.room, pair.light)).or_default() +=
                            pair.photons;
                    }
                }
                _ => {}
            }
        }
        // Others are told how the trace is shared before anything is done: one that begins later must hear it from a process that is alone, too.
        recorder.writer.cursor(ExtentKind::Identity, 0, u64::from(share.of));
        recorder.writer.commit()?;
        recorder.poll()?;
        while !recorder.others.agree(FIRST_PATIENCE)? {
            std::thread::sleep(POLL_EVERY / 4);
            recorder.poll()?;
        }
        recorder.parked.clear();
        Ok(recorder)
    }

    /// Takes note of what others have committed; returns how far they are with emission.
    fn poll(&mut self) -> Result<Vec<(u32, u64)>, StoreError> {
        let news = self.others.poll(&self.writer)?;
        // What is written down as consumed may be released: it must not outlive the commit that consumed it.
        self.built_on_others |= !news.consumed.is_empty();
        for extent in &news.consumed {
            self.writer.consume(extent);
            if let Some(list) = self.waiting.get_mut(&extent.id) {
                list.retain(|e| e != extent);
            }
        }
        for extent in news.waiting {
            *self.parked.entry(extent.id).or_default() += extent.count;
            self.waiting.entry(extent.id).or_default().push(extent);
        }
        for &(tile, value) in &news.cursors {
            let known = self.foreign_cursors.entry(tile).or_default();
            *known = value.max(*known);
        }
        Ok(news.cursors)
    }

    fn records<T>(&self, extent: &Extent) -> Result<Vec<T>, StoreError>
    where
        T: FromBytes + IntoBytes + zerocopy::Immutable + zerocopy::KnownLayout + Copy,
    {
        let buffer = self.writer.read(extent, &self.budget, "ledger")?;
        Ok(buffer.as_slice_of::<T>()?.to_vec())
    }

    /// How much waits at each tile, and how far each tile's emission is.
    pub(crate) fn resume_state(&self) -> (BTreeMap<u32, u64>, BTreeMap<u32, u64>) {
        let waiting =
            self.waiting.iter().map(|(&t, e)| (t, e.iter().map(|e| e.count).sum())).collect();
        // A tile may have had another owner in an earlier run.
        let mut cursors = self.foreign_cursors.clone();
        for (kind, tile, value) in self.writer.cursors() {
            if kind == ExtentKind::Transit {
                let known = cursors.entry(tile).or_default();
                *known = value.max(*known);
            }
        }
        (waiting, cursors)
    }

    /// Is set as soon as something has gone wrong.
    pub(crate) fn failed(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.failed)
    }

    /// Bytes of the journal's tables, of the photons that wait on disk, and of the sums: all that grows with the length of the trace.
    pub(crate) fn table_bytes(&self) -> u64 {
        // An entry of a B-tree whose nodes are two thirds full.
        const PAIR: usize = 40;
        let pairs = |sums: &Epoch| sums.passages.len() + sums.sees.len();
        let waiting: usize = self.waiting.values().map(Vec::capacity).sum();
        self.writer.memory_bytes()
            + ((pairs(&self.all) + pairs(&self.epoch)) * PAIR + waiting * size_of::<Extent>())
                as u64
    }

    /// Serves messages until all senders are gone.
    pub(crate) fn serve(mut self, messages: &Receiver<Message>, lane: &Lane) -> Self {
        for message in messages {
            let _span = match message {
                Message::Products(_) => lane.span("store and park", 0u32),
                Message::Read { .. } => lane.io("read back", 0u32),
                Message::Commit { .. } => lane.io("commit", 0u32),
                Message::Poll { .. } => lane.io("look at others", 0u32),
                Message::Take { .. } | Message::Visited { .. } => lane.span("visit", 0u32),
            };
            // A reply that nobody waits for means that the main thread is gone already: nothing to do.
            match message {
                Message::Products(products) => {
                    if self.failure.is_none()
                        && let Err(error) = self.accept(*products)
                    {
                        self.give_back(&error);
                        self.failure = Some(error);
                        self.failed.store(true, Ordering::Relaxed);
                    }
                }
                Message::Take { tile, reply } => {
                    let memory = self.transit.take(tile).collect();
                    let extents = self.waiting.remove(&tile).unwrap_or_default();
                    let _ = reply.send(Taken { memory, extents });
                }
                Message::Read { extent, reply } => {
                    const WHAT: &str = "incoming photons";
                    let read = self
                        .others
                        .read(&extent, &self.budget, WHAT)
                        .unwrap_or_else(|| self.writer.read(&extent, &self.budget, WHAT));
                    let _ = reply.send(read.and_then(|buffer| {
                        buffer.as_slice_of::<TransitRecord>()?;
                        Ok(buffer)
                    }));
                }
                Message::Visited { consumed, unused, cursor, reply } => {
                    for extent in &consumed {
                        self.writer.consume(extent);
                        self.others.consumed(extent);
                        self.built_on_others |= extent.process != self.writer.process();
                    }
                    if !unused.1.is_empty() {
                        let list = self.waiting.entry(unused.0).or_default();
                        let new = std::mem::replace(list, unused.1);
                        list.extend(new);
                    }
                    if let Some((tile, value)) = cursor {
                        self.writer.cursor(ExtentKind::Transit, tile, value);
                    }
                    let _ = reply.send(self.status());
                }
                Message::Poll { now, reply } => {
                    let _ = reply.send(match now || self.others.due() {
                        true => self.poll().map(|cursors| {
                            // Looked for only by who has nothing else to do.
                            let in_transit = !now
                                || self.others.in_transit()
                                || self.writer.extents().any(|e| e.kind == ExtentKind::Transit);
                            let live = |p: &&Peer| now && p.is_live().unwrap_or(false);
                            let running = self.others.peers().iter().filter(live);
                            let running = running.map(Peer::process).collect();
                            Status { cursors, in_transit, running, ..self.status() }
                        }),
                        false => Ok(self.status()),
                    });
                }
                Message::Commit { reply } => {
                    let _ = reply.send(match self.failure.take() {
                        Some(error) => Err(error),
                        None => self.commit().inspect_err(|error| self.give_back(error)),
                    });
                }
            }
        }
        self
    }

    fn status(&mut self) -> Status {
        Status {
            parked: std::mem::take(&mut self.parked),
            cursors: Vec::new(),
            in_transit: true,
            running: Vec::new(),
            finished: self.all.finished,
            finished_w: self.all.finished_w,
            emitted_w: self.all.emitted_w,
            uncommitted: self.uncommitted,
            tables: self.table_bytes(),
            failure: self.failure.take(),
        }
    }

    /// On a full disk the room of photons that were consumed is not kept for later. This is a favour; what went wrong is told all the same.
    fn give_back(&mut self, error: &StoreError) {
        if error.is_full() {
            let _ = self.writer.release_consumed();
        }
    }

    fn accept(&mut self, products: Products) -> Result<(), StoreError> {
        let Self { writer, photons, transit, waiting, uncommitted, .. } = self;
        for (room, block) in &products.impacts {
            photons.push(*room, block, &mut |room, records: &[PhotonRecord]| {
                *uncommitted += size_of_val(records) as u64;
                let bytes = records.as_bytes();
                writer
                    .append(ExtentKind::Photons, room, records.len() as u64, bytes, Codec::Raw)
                    .map(|_| ())
            })?;
        }
        for (tile, block) in &products.parked {
            if self.share.owns(*tile) {
                *self.parked.entry(*tile).or_default() += block.len() as u64;
            }
            transit.push(*tile, block, &mut |tile, records: &[TransitRecord]| {
                *uncommitted += size_of_val(records) as u64;
                let bytes = records.as_bytes();
                let count = records.len() as u64;
                let extent = writer.append(ExtentKind::Transit, tile, count, bytes, Codec::Raw)?;
                if self.share.owns(tile) {
                    waiting.entry(tile).or_default().push(extent);
                }
                Ok::<(), StoreError>(())
            })?;
        }
        self.traced += products.tally.traced;
        self.all.add(&products.tally);
        self.epoch.add(&products.tally);
        self.uncommitted += 1;
        Ok(())
    }

    /// Flushes the rows, writes the ledger's change, and commits.
    fn commit(&mut self) -> Result<(), StoreError> {
        let Self { writer, photons, transit, waiting, .. } = self;
        photons.flush_all(&mut |room, records: &[PhotonRecord]| {
            let count = records.len() as u64;
            writer
                .append(ExtentKind::Photons, room, count, records.as_bytes(), Codec::Raw)
                .map(|_| ())
        })?;
        transit.flush_all(&mut |tile, records: &[TransitRecord]| {
            let count = records.len() as u64;
            let extent =
                writer.append(ExtentKind::Transit, tile, count, records.as_bytes(), Codec::Raw)?;
            if self.share.owns(tile) {
                waiting.entry(tile).or_default().push(extent);
            }
            Ok::<(), StoreError>(())
        })?;
        let epoch = std::mem::take(&mut self.epoch);
        let ledger: Vec<LedgerRecord> = epoch.rooms.into_values().collect();
        let passages: Vec<PassageRecord> = epoch
            .passages
            .into_iter()
            .map(|((from, to), (photons, flux_w))| PassageRecord { from, to, photons, flux_w })
            .collect();
        let pairs: Vec<LightPairRecord> = epoch
            .sees
            .into_iter()
            .map(|((room, light), photons)| LightPairRecord {
                room,
                light,
                photons,
                emitted: self.counts.of(light),
            })
            .collect();
        append(writer, ExtentKind::Ledger, 0, &ledger)?;
        append(writer, ExtentKind::Passages, 0, &passages)?;
        append(writer, ExtentKind::LightPairs, 0, &pairs)?;
        if std::mem::take(&mut self.built_on_others) {
            self.others.sync()?;
        }
        writer.commit()?;
        if writer.consumed_bytes() >= RELEASE_BYTES {
            writer.release_consumed()?;
        }
        self.uncommitted = 0;
        Ok(())
    }

    /// Writes the light sets and seals the stage. Of several processes the lowest that is alive does that, when the others have
    /// come to the end as well; they wait for it, and `say` for whom.
    pub(crate) fn seal(
        mut self,
        store: &StoreDir,
        identity: &Identity,
        rooms: u32,
        say: impl Fn(String),
    ) -> Result<Totals, Failure> {
        if let Some(error) = self.failure.take() {
            return Err(error.into());
        }
        self.commit()?;
        let Self { writer, others, counts, budget, all, .. } = self;
        let Epoch { rooms: mut ledger, mut passages, mut sees, .. } = all;
        let process = writer.process();
        let mut writer = Some(writer);
        let (mut written, mut said) = (false, Instant::now());
        loop {
            if let Some(signal) = interrupt::interrupted() {
                return Err(Failure::interrupted(signal));
            }
            let mut lower = others.peers().iter().filter(|p| p.process() < process);
            if lower.try_fold(false, |live, p| Ok::<_, StoreError>(live || p.is_live()?))? {
                // It seals what nobody writes.
                (writer, written) = (None, false);
            } else {
                let again = || StageWriter::open(store, StageKind::Trace, process, identity);
                match writer.take().map_or_else(again, Ok) {
                    Ok(mut own) => {
                        if !written {
                            if others.any() {
                                let reader = StageReader::open_unsealed(store, StageKind::Trace)?;
                                sees = light_pairs(&reader, &budget)?;
                                let old = reader.extents(ExtentKind::LightSet).to_vec();
                                old.iter().for_each(|extent| own.consume(extent));
                            }
                            write_light_sets(&mut own, &sees, &counts, rooms)?;
                            written = true;
                        }
                        match own.try_seal() {
                            Ok(()) => break,
                            Err(StoreError::Busy { .. }) => writer = Some(own),
                            Err(error) => return Err(error.into()),
                        }
                    }
                    Err(StoreError::Sealed { .. }) => break,
                    Err(StoreError::Busy { .. }) => {}
                    Err(error) => return Err(error.into()),
                }
            }
            if said.elapsed() > SAY_EVERY {
                said = Instant::now();
                let live = others.peers().iter().filter(|p| p.is_live().unwrap_or(false));
                let live: Vec<_> = live.map(|p| p.process().to_string()).collect();
                say(format!(
                    "every photon is traced; waiting for other processes to end: {}",
                    live.join(", ")
                ));
            }
            std::thread::sleep(POLL_EVERY / 8);
        }
        if others.any() {
            let reader = StageReader::open(store, StageKind::Trace)?;
            let all = Totals::read(&reader, &budget)?;
            (ledger, passages) = (all.ledger, all.passages);
        }
        Ok(Totals {
            ledger,
            passages,
            evictions: self.transit.evictions(),
            spilled_blocks: self.transit.spilled_blocks(),
            spilled_records: self.transit.spilled_records(),
            traced: self.traced,
        })
    }
}

/// The pairs of rooms and lights that see each other, of all epochs and processes.
fn light_pairs(
    reader: &StageReader,
    budget: &MemoryBudget,
) -> Result<BTreeMap<(u32, u32), u64>, StoreError> {
    let mut sees = BTreeMap::new();
    for extent in reader.extents(ExtentKind::LightPairs) {
        let block = reader.read(extent, budget, "ledger")?;
        for pair in block.as_slice_of::<LightPairRecord>()? {
            *sees.entry((pair.room, pair.light)).or_default() += pair.photons;
        }
    }
    Ok(sees)
}

/// Writes each room's set of lights, in the place of any that a run wrote which did not get to the seal.
fn write_light_sets(
    writer: &mut StageWriter,
    sees: &BTreeMap<(u32, u32), u64>,
    counts: &Counts,
    rooms: u32,
) -> Result<(), StoreError> {
    let old = |e: &&Extent| e.kind == ExtentKind::LightSet;
    let old: Vec<Extent> = writer.extents().filter(old).copied().collect();
    old.iter().for_each(|extent| writer.consume(extent));
    for room in 0..rooms {
        let lights: Vec<LightPairRecord> = sees
            .range((room, 0)..=(room, u32::MAX))
            .map(|(&(room, light), &photons)| LightPairRecord {
                room,
                light,
                photons,
                emitted: counts.of(light),
            })
            .collect();
        append(writer, ExtentKind::LightSet, room, &lights)?;
    }
    Ok(())
}

fn append<T: IntoBytes + zerocopy::Immutable>(
    writer: &mut StageWriter,
    kind: ExtentKind,
    id: u32,
    records: &[T],
) -> Result<(), StoreError> {
    if records.is_empty() {
        return Ok(());
    }
    writer.append(kind, id, records.len() as u64, records.as_bytes(), Codec::Raw)?;
    Ok(())
}
