//! Following what another process commits to the stage that one writes oneself.
//!
//! Each process has its own data file and journal, and nobody writes into another's: what a process does with the extents of another
//! stands in its own journal. So all that is needed is to read journals as they grow, commit by commit.

use std::path::Path;

use enf_layout::journal::{JournalKind, JournalRecord};
use enf_layout::segment::{ExtentKind, StageKind};
use zerocopy::FromBytes;

use crate::files::{self, HEADER, Named, Role};
use crate::load::{Extent, ExtentReader};
use crate::replay::{self, BATCH, RECORD, extent_of, finish};
use crate::{StoreDir, StoreError};

/// What another process committed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PeerEvent {
    /// It wrote an extent.
    Produced(Extent),
    /// It consumed an extent, of its own or of any other process.
    Consumed(Extent),
    /// It has got so far with the work on (kind, id).
    Cursor(ExtentKind, u32, u64),
}

/// The commits of another process, in order.
pub struct Peer {
    journal: Named,
    data: ExtentReader,
    /// Records that were read, up to and with a commit.
    records: u64,
    data_end: u64,
    /// Something was read that may not be durable yet.
    unsynced: bool,
}

impl Peer {
    /// Bytes that [`Peer::poll`] takes for a while, but for a commit of more records than this holds.
    pub const BYTES: u64 = 2 * BATCH * RECORD;

    pub(crate) fn open(
        store: &StoreDir,
        stage: StageKind,
        process: u32,
        made_from: [u8; 16],
    ) -> Result<Option<Self>, StoreError> {
        let role = Role::Journal { process };
        let journal = match Named::open(store.file(stage, role), "") {
            Err(StoreError::Missing { .. }) => return Ok(None),
            other => other?,
        };
        if replay::first_extent(store, stage, process)?.is_none() {
            return Ok(None);
        }
        let header = files::read_header(&journal, stage, role, store.stats())?;
        if header.made_from != made_from {
            let detail = "this process writes for other inputs or flags";
            return Err(journal.corrupt(32, detail));
        }
        let data = ExtentReader::open(store, stage, process)?;
        Ok(Some(Self { journal, data, records: 0, data_end: HEADER, unsynced: false }))
    }

    /// Its number.
    pub fn process(&self) -> u32 {
        self.data.process
    }

    /// Its journal.
    pub fn path(&self) -> &Path {
        &self.journal.path
    }

    /// Tells `event` of everything that was committed since the last time.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] when its journal is damaged, or shorter than it was; [`StoreError::Io`].
    pub fn poll(&mut self, mut event: impl FnMut(PeerEvent)) -> Result<(), StoreError> {
        let (stage, process) = (self.data.stage, self.data.process);
        let place = |i: u64| HEADER + i * RECORD;
        let length = self.journal.len()?;
        if length < place(self.records) {
            let detail = "the journal ends before what was committed to it a moment ago";
            return Err(self.journal.corrupt(length, detail));
        }
        let total = (length - HEADER) / RECORD;
        let mut batch: Vec<JournalRecord> = Vec::new();
        let mut window = vec![0; ((total - self.records).min(BATCH) * RECORD) as usize];
        for first in (self.records..total).step_by(BATCH as usize) {
            let window = &mut window[..((total - first).min(BATCH) * RECORD) as usize];
            self.journal.read(place(first), window, self.data.store.stats())?;
            for (i, bytes) in (first..).zip(window.chunks_exact(RECORD as usize)) {
                let Ok(record) = JournalRecord::read_from_bytes(bytes) else { return Ok(()) };
                // It is being written, or was when a kill came.
                if record != finish(record) || record.sequence != i {
                    return Ok(());
                }
                batch.push(record);
                if record.kind != JournalKind::Commit as u32 {
                    continue;
                }
                let bad = |detail: String| {
                    self.journal.corrupt(place(i), format!("before journal record {i}: {detail}"))
                };
                if record.count != batch.len() as u64 - 1 {
                    return Err(bad("a commit miscounts its records".into()));
                }
                for record in batch.drain(..) {
                    match JournalKind::from_u32(record.kind) {
                        Some(JournalKind::Extent) => {
                            let extent = extent_of(&record, stage).map_err(bad)?;
                            self.data_end =
                                replay::follows(&extent, process, self.data_end).map_err(bad)?;
                            event(PeerEvent::Produced(extent));
                        }
                        Some(JournalKind::Consumed) => {
                            event(PeerEvent::Consumed(extent_of(&record, stage).map_err(bad)?));
                        }
                        Some(JournalKind::Cursor) => {
                            let kind = ExtentKind::from_u32(record.extent_kind)
                                .ok_or_else(|| bad("unknown extent kind".into()))?;
                            event(PeerEvent::Cursor(kind, record.id, record.count));
                        }
                        Some(JournalKind::Commit) => {}
                        None => return Err(bad(format!("unknown record kind {}", record.kind))),
                    }
                }
                self.records = i + 1;
                self.unsynced = true;
            }
        }
        Ok(())
    }

    /// A handle that reads its extents.
    pub fn reader(&self) -> &ExtentReader {
        &self.data
    }

    /// Makes durable what [`poll`](Self::poll) has told of: a commit can be seen a moment before it is on the disk, and what is made from
    /// it must not get there first.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub fn sync(&mut self) -> Result<(), StoreError> {
        if self.unsynced {
            self.data.data.sync()?;
            self.journal.sync()?;
            self.unsynced = false;
        }
        Ok(())
    }

    /// Whether the process is running (on this machine, or wherever the file system's locks reach).
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub fn is_live(&self) -> Result<bool, StoreError> {
        let path = self.journal.path.clone();
        // A network file system locks exclusively only what may be written.
        match Named::open_to_lock(path)?.lock() {
            Ok(_) => Ok(false),
            Err(StoreError::Busy { .. }) => Ok(true),
            Err(error) => Err(error),
        }
    }
}

impl std::fmt::Debug for Peer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Peer({}, {} records)", self.journal.path.display(), self.records)
    }
}
