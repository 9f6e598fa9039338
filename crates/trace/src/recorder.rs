//! The one owner of everything that a trace writes: the table of incoming photons (the paper's `TP`), the
//! photon rows, the logs and the journal. Tracers send it blocks through a channel; nobody locks anything.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use crossbeam::channel::{Receiver, Sender};
use enf_layout::journal::{LedgerRecord, LightPairRecord, PassageRecord};
use enf_layout::photon::PhotonRecord;
use enf_layout::segment::{Codec, ExtentKind};
use enf_layout::transit::TransitRecord;
use enf_stage::rowtable::RowTable;
use enf_store::{Buffer, Extent, MemoryBudget, StageReader, StageWriter, StoreError};
use zerocopy::{FromBytes, IntoBytes};

use crate::shares::Shares;
use crate::tracer::{Products, Tally, add_ledger, empty_ledger};

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
    /// Records newly parked, by tile.
    pub(crate) parked: BTreeMap<u32, u64>,
    /// Photons whose path has ended, since the start of the trace.
    pub(crate) finished: u64,
    /// Flux of them, W over all channels.
    pub(crate) finished_w: f64,
    /// Bytes written since the last commit.
    pub(crate) uncommitted: u64,
    /// When that was.
    pub(crate) committed_at: Instant,
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
    budget: MemoryBudget,
    transit: RowTable<TransitRecord>,
    photons: RowTable<PhotonRecord>,
    waiting: BTreeMap<u32, Vec<Extent>>,
    parked: BTreeMap<u32, u64>,
    ledger: BTreeMap<u32, LedgerRecord>,
    passages: BTreeMap<(u32, u32), (u64, f64)>,
    sees: BTreeMap<(u32, u32), u64>,
    shares: Arc<Shares>,
    /// What came since the last commit.
    epoch: Tally,
    uncommitted: u64,
    committed_at: Instant,
    failure: Option<StoreError>,
    traced: u64,
    spilled_blocks: u64,
    spilled_records: u64,
}

impl Recorder {
    /// Takes up where the journal ends.
    pub(crate) fn new(
        writer: StageWriter,
        budget: &MemoryBudget,
        transit: RowTable<TransitRecord>,
        photons: RowTable<PhotonRecord>,
        shares: Arc<Shares>,
    ) -> Result<Self, StoreError> {
        let mut recorder = Self {
            writer,
            budget: budget.clone(),
            transit,
            photons,
            waiting: BTreeMap::new(),
            parked: BTreeMap::new(),
            ledger: BTreeMap::new(),
            passages: BTreeMap::new(),
            sees: BTreeMap::new(),
            shares,
            epoch: Tally::default(),
            uncommitted: 0,
            committed_at: Instant::now(),
            failure: None,
            traced: 0,
            spilled_blocks: 0,
            spilled_records: 0,
        };
        let extents: Vec<Extent> = recorder.writer.extents().copied().collect();
        for extent in extents {
            match extent.kind {
                ExtentKind::Transit => {
                    recorder.waiting.entry(extent.id).or_default().push(extent);
                }
                ExtentKind::Ledger => {
                    for record in recorder.records::<LedgerRecord>(&extent)? {
                        let sum = recorder
                            .ledger
                            .entry(record.room)
                            .or_insert_with(|| empty_ledger(record.room));
                        add_ledger(sum, &record);
                    }
                }
                ExtentKind::Passages => {
                    for record in recorder.records::<PassageRecord>(&extent)? {
                        let sum = recorder.passages.entry((record.from, record.to)).or_default();
                        sum.0 += record.photons;
                        sum.1 += record.flux_w;
                    }
                }
                ExtentKind::LightPairs => {
                    for pair in recorder.records::<LightPairRecord>(&extent)? {
                        *recorder.sees.entry((pair.room, pair.light)).or_default() += pair.photons;
                    }
                }
                _ => {}
            }
        }
        Ok(recorder)
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
        let cursors = self
            .writer
            .cursors()
            .filter(|c| c.0 == ExtentKind::Transit)
            .map(|(_, tile, value)| (tile, value))
            .collect();
        (waiting, cursors)
    }

    /// Serves messages until all senders are gone.
    pub(crate) fn serve(mut self, messages: &Receiver<Message>) -> Self {
        for message in messages {
            // A reply that nobody waits for means that the main thread is gone already: nothing to do.
            match message {
                Message::Products(products) => {
                    if self.failure.is_none()
                        && let Err(error) = self.accept(*products)
                    {
                        self.failure = Some(error);
                    }
                }
                Message::Take { tile, reply } => {
                    let memory = self.transit.take(tile).collect();
                    let extents = self.waiting.remove(&tile).unwrap_or_default();
                    let _ = reply.send(Taken { memory, extents });
                }
                Message::Read { extent, reply } => {
                    let read = self.writer.read(&extent, &self.budget, "incoming photons");
                    let _ = reply.send(read.and_then(|buffer| {
                        buffer.as_slice_of::<TransitRecord>()?;
                        Ok(buffer)
                    }));
                }
                Message::Visited { consumed, unused, cursor, reply } => {
                    for extent in &consumed {
                        self.writer.consume(extent);
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
                Message::Commit { reply } => {
                    let _ = reply.send(match self.failure.take() {
                        Some(error) => Err(error),
                        None => self.commit(),
                    });
                }
            }
        }
        self
    }

    fn status(&mut self) -> Status {
        let ledger = self.ledger.values();
        let (mut finished, mut finished_w) = (0, 0.0);
        for line in ledger {
            finished += line.absorbed + line.escaped;
            finished_w += line.absorbed_w.iter().chain(&line.escaped_w).sum::<f64>();
        }
        Status {
            parked: std::mem::take(&mut self.parked),
            finished,
            finished_w,
            uncommitted: self.uncommitted,
            committed_at: self.committed_at,
            failure: self.failure.take(),
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
            *self.parked.entry(*tile).or_default() += block.len() as u64;
            transit.push(*tile, block, &mut |tile, records: &[TransitRecord]| {
                *uncommitted += size_of_val(records) as u64;
                self.spilled_blocks += 1;
                self.spilled_records += records.len() as u64;
                let bytes = records.as_bytes();
                let count = records.len() as u64;
                let extent = writer.append(ExtentKind::Transit, tile, count, bytes, Codec::Raw)?;
                waiting.entry(tile).or_default().push(extent);
                Ok::<(), StoreError>(())
            })?;
        }
        let tally = products.tally;
        for (&room, line) in &tally.rooms {
            add_ledger(self.ledger.entry(room).or_insert_with(|| empty_ledger(room)), line);
        }
        for (&pair, &(count, flux)) in &tally.passages {
            let sum = self.passages.entry(pair).or_default();
            sum.0 += count;
            sum.1 += flux;
        }
        for (&pair, &photons) in &tally.sees {
            *self.sees.entry(pair).or_default() += photons;
        }
        self.traced += tally.traced;
        self.epoch.merge(&tally);
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
            self.spilled_records += records.len() as u64;
            let count = records.len() as u64;
            let extent =
                writer.append(ExtentKind::Transit, tile, count, records.as_bytes(), Codec::Raw)?;
            waiting.entry(tile).or_default().push(extent);
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
                emitted: self.shares.of(light),
            })
            .collect();
        append(writer, ExtentKind::Ledger, 0, &ledger)?;
        append(writer, ExtentKind::Passages, 0, &passages)?;
        append(writer, ExtentKind::LightPairs, 0, &pairs)?;
        writer.commit()?;
        self.uncommitted = 0;
        self.committed_at = Instant::now();
        Ok(())
    }

    /// Writes the light sets and seals the stage.
    pub(crate) fn seal(mut self, rooms: u32) -> Result<Totals, StoreError> {
        if let Some(error) = self.failure.take() {
            return Err(error);
        }
        self.commit()?;
        for room in 0..rooms {
            let lights: Vec<LightPairRecord> = self
                .sees
                .range((room, 0)..=(room, u32::MAX))
                .map(|(&(room, light), &photons)| LightPairRecord {
                    room,
                    light,
                    photons,
                    emitted: self.shares.of(light),
                })
                .collect();
            append(&mut self.writer, ExtentKind::LightSet, room, &lights)?;
        }
        let totals = Totals {
            ledger: self.ledger,
            passages: self.passages,
            evictions: self.transit.evictions(),
            spilled_blocks: self.spilled_blocks,
            spilled_records: self.spilled_records,
            traced: self.traced,
        };
        self.writer.seal()?;
        Ok(totals)
    }
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
