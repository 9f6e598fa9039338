//! Writing a stage: append, commit, seal.
//!
//! A commit is two syncs: the data first, then the journal that names it. Whatever a kill or a
//! power cut leaves behind the last commit is cut off when the stage is opened again.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use enf_layout::journal::{JournalKind, JournalRecord};
use enf_layout::segment::{Codec, ExtentKind, StageKind};
use rustix::fs::{FallocateFlags, fallocate};
use rustix::io::Errno;
use xxhash_rust::xxh3::Xxh3;
use zerocopy::IntoBytes;

use crate::encode::{Encoded, Encoder};
use crate::files::{self, HEADER, Named, Role, WINDOW, hash128};
use crate::load::{self, Extent, ExtentReader};
use crate::peer::Peer;
use crate::reader;
use crate::replay::{self, Key, Ranges, State, Tail, blank, finish, key, record_of};
use crate::seal::{self, SealedFile};
use crate::{Buffer, Identity, MemoryBudget, StoreDir, StoreError};

/// What a live extent or a pending record takes in memory, rounded up.
const ENTRY: u64 = 160;

/// File systems free space in blocks of this size, or smaller.
const BLOCK: u64 = 64 << 10;

/// The one writer of one process's files of one stage.
///
/// Dropping it without a commit loses what was appended since the last one, and nothing else.
pub struct StageWriter {
    log: Log,
    encoder: Encoder,
    resumed: bool,
}

/// The data file, the journal, and the table of what is live.
struct Log {
    data: ExtentReader,
    journal: Named,
    state: State,
    /// Records appended since the last commit.
    pending: Vec<JournalRecord>,
    /// Where the extents lie that were consumed since the last commit.
    dying: Vec<(u64, u64)>,
    /// What was released already.
    released: Ranges,
    /// Appended and not yet written; an extent is in here whole, or not at all.
    buffer: Vec<u8>,
    /// Where `buffer` goes.
    flushed: u64,
    /// Data was written since the last sync.
    unsynced: bool,
    /// Running hash of the data file; `None` when its bytes have to be read again.
    hash: Option<Box<Xxh3>>,
    /// A sync failed: what is on the disk is unknown until the journal is replayed.
    failed: bool,
}

impl StageWriter {
    /// Opens a stage for writing.
    ///
    /// - Nothing committed yet: makes the files; the identity is the first extent and the first commit.
    /// - Begun with the same identity: resumes after the last commit.
    ///
    /// The journal is locked until the writer is dropped.
    ///
    /// # Errors
    /// [`StoreError::Different`] when it was begun with another identity, [`StoreError::Sealed`] when it is
    /// finished with the same one, [`StoreError::Busy`] when a live process is writing it,
    /// [`StoreError::Corrupt`] when more than a torn end is wrong with it.
    pub fn open(
        store: &StoreDir,
        stage: StageKind,
        process: u32,
        identity: &Identity,
    ) -> Result<Self, StoreError> {
        let path = || store.path().to_path_buf();
        let refuse_other = |found: &Identity| match identity.differences(found) {
            same if same.is_empty() => Ok(()),
            differences => Err(StoreError::Different { stage, path: path(), differences }),
        };
        if seal::read(store, stage)?.is_some() {
            if let Some(found) = store.identity(stage)? {
                refuse_other(&found)?;
            }
            return Err(StoreError::Sealed { stage, path: path() });
        }
        // Another process of this stage may have been begun with something else.
        if let Some(found) = store.identity(stage)? {
            refuse_other(&found)?;
        }
        let journal = lock_journal(store, stage, process)?;
        if seal::read(store, stage)?.is_some() {
            return Err(StoreError::Sealed { stage, path: path() });
        }
        let (log, resumed) = match Log::recover(store, stage, process, journal)? {
            Ok((log, found)) => {
                refuse_other(&found)?;
                (log, true)
            }
            Err(journal) => (Log::begin(store, stage, process, journal, identity)?, false),
        };
        let encoder = Encoder::new(&MemoryBudget::new(u64::MAX));
        Ok(Self { log, encoder, resumed })
    }

    /// Bytes of the buffer.
    pub const BUFFER_BYTES: u64 = WINDOW as u64;

    /// What the writer holds: its buffer, and a line for each live extent and each record that is not committed.
    pub fn memory_bytes(&self) -> u64 {
        let entries = self.log.state.live.len() + self.log.pending.len();
        Self::BUFFER_BYTES + entries as u64 * ENTRY
    }

    /// Whether an earlier run had begun this stage.
    pub fn resumed(&self) -> bool {
        self.resumed
    }

    /// Appends an extent of `count` records; it becomes durable and visible with the next commit.
    ///
    /// Nothing changes when it fails.
    ///
    /// # Errors
    /// [`StoreError::Io`], [`StoreError::Budget`], [`StoreError::Malformed`] when `codec` is
    /// [`Codec::ZstdPlanes`] and the bytes are no sections blob.
    pub fn append(
        &mut self,
        kind: ExtentKind,
        id: u32,
        count: u64,
        bytes: &[u8],
        codec: Codec,
    ) -> Result<Extent, StoreError> {
        let Self { log, encoder, .. } = self;
        let raw_bytes = bytes.len() as u64;
        encoder.pack(bytes, codec, |stored| log.append(kind, id, count, stored, raw_bytes, codec))
    }

    /// Appends an extent that another thread has packed.
    ///
    /// # Errors
    /// [`StoreError::Io`], [`StoreError::Budget`].
    pub fn append_encoded(
        &mut self,
        kind: ExtentKind,
        id: u32,
        count: u64,
        encoded: &Encoded,
    ) -> Result<Extent, StoreError> {
        self.log.append(kind, id, count, &encoded.stored, encoded.raw_bytes, encoded.codec)
    }

    /// Takes an extent off the live ones with the next commit, be it this process's own or another's. One that is not live is left
    /// alone, so twice is as good as once. What another has written must be [made durable](Peer::sync) before that commit.
    pub fn consume(&mut self, extent: &Extent) {
        let log = &mut self.log;
        if extent.process != log.data.process {
            let consumed = log.state.consumed.entry(extent.process).or_default();
            if !consumed.covers(extent.offset, extent.end()) {
                consumed.add(extent.offset, extent.end());
                log.pending.push(record_of(log.sequence(), JournalKind::Consumed, extent));
            }
            return;
        }
        if log.state.live.get(&key(extent)) == Some(extent) {
            log.state.live.remove(&key(extent));
            log.pending.push(record_of(log.sequence(), JournalKind::Consumed, extent));
            log.dying.push((extent.offset, extent.end()));
        }
    }

    /// Records with the next commit how far the work on (`kind`, `id`) is.
    pub fn cursor(&mut self, kind: ExtentKind, id: u32, value: u64) {
        let log = &mut self.log;
        let record = blank(log.sequence(), JournalKind::Cursor);
        log.pending.push(finish(JournalRecord {
            extent_kind: kind as u32,
            id,
            count: value,
            ..record
        }));
        log.state.cursors.insert((kind, id), value);
    }

    /// Makes all that is pending durable and visible, all of it or none. Does nothing when nothing is.
    ///
    /// # Errors
    /// [`StoreError::Io`]. After a full disk it may be tried again; after a failed sync the writer is of no more use,
    /// and the stage resumes from the commit before.
    pub fn commit(&mut self) -> Result<(), StoreError> {
        self.log.commit()
    }

    /// Whether this process has consumed an extent of another.
    pub fn has_consumed(&self, extent: &Extent) -> bool {
        let consumed = self.log.state.consumed.get(&extent.process);
        consumed.is_some_and(|c| c.covers(extent.offset, extent.end()))
    }

    /// The number of the process that this writer is.
    pub fn process(&self) -> u32 {
        self.log.data.process
    }

    /// Other processes that have begun, or wanted to begin, this stage.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub fn others(&self) -> Result<Vec<u32>, StoreError> {
        let mut processes = self.log.data.store.processes(self.log.data.stage)?;
        processes.retain(|&process| process != self.log.data.process);
        Ok(processes)
    }

    /// What another process commits to this stage; `None` as long as it has not committed anything.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] when it writes for other inputs or flags, [`StoreError::Io`].
    pub fn peer(&self, process: u32) -> Result<Option<Peer>, StoreError> {
        let log = &self.log;
        Peer::open(&log.data.store, log.data.stage, process, log.state.made_from)
    }

    /// The live extents, pending ones included, by kind, id and offset.
    pub fn extents(&self) -> impl Iterator<Item = &Extent> {
        self.log.state.live.values()
    }

    /// The live extents of a kind with this id, pending ones included, by offset.
    pub fn find(&self, kind: ExtentKind, id: u32) -> impl Iterator<Item = &Extent> {
        self.log.state.live.range::<Key, _>((kind, id, 0)..=(kind, id, u64::MAX)).map(|e| e.1)
    }

    /// The last value of each cursor, pending ones included.
    pub fn cursors(&self) -> impl Iterator<Item = (ExtentKind, u32, u64)> {
        self.log.state.cursors.iter().map(|(&(kind, id), &value)| (kind, id, value))
    }

    /// Reads an extent, committed or not, into a buffer reserved for `what`: checksum verified, inflated.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] naming file and offset, [`StoreError::Budget`], [`StoreError::Io`].
    pub fn read(
        &self,
        extent: &Extent,
        budget: &MemoryBudget,
        what: &'static str,
    ) -> Result<Buffer, StoreError> {
        let log = &self.log;
        let owner = (extent.stage, extent.process) == (log.data.stage, log.data.process);
        let in_buffer = extent
            .offset
            .checked_sub(log.flushed)
            .and_then(|at| log.buffer.get(at as usize..)?.get(..extent.padded_bytes() as usize));
        match in_buffer {
            Some(bytes) if owner => load::unpack(&log.data.data, extent, budget, what, |buffer| {
                load::check(&log.data.data, extent, hash128(bytes))?;
                buffer.padded_mut().copy_from_slice(bytes);
                Ok(())
            }),
            _ => log.data.read(extent, budget, what),
        }
    }

    /// Hands what is buffered to the system, so that [`reader`](Self::reader) sees it. It is not durable by that.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub fn flush(&mut self) -> Result<(), StoreError> {
        self.log.flush()
    }

    /// A handle that reads flushed extents from other threads while this one goes on writing.
    pub fn reader(&self) -> ExtentReader {
        self.log.data.clone()
    }

    /// Bytes of extents whose consumption is committed, and which [`release_consumed`](Self::release_consumed) would give back.
    pub fn consumed_bytes(&self) -> u64 {
        self.log.state.dead.iter().map(|(start, end)| end - start).sum()
    }

    /// Gives the disk space of extents whose consumption is committed back to the file system, and returns the
    /// bytes that they had. Does nothing on a file system that cannot.
    ///
    /// # Errors
    /// [`StoreError::Io`].
    pub fn release_consumed(&mut self) -> Result<u64, StoreError> {
        self.log.release()
    }

    /// Commits, and seals the whole stage: from now on it is finished and never changes.
    ///
    /// Other processes' files of the same stage are sealed with it; whoever calls this knows that they are done.
    ///
    /// # Errors
    /// [`StoreError::Busy`] when another process is still writing the stage, [`StoreError::Corrupt`] when
    /// bytes that have to be read again are not what was written, [`StoreError::Io`].
    pub fn seal(mut self) -> Result<(), StoreError> {
        self.try_seal()
    }

    /// [`seal`](Self::seal), to be tried again while other processes still write the stage.
    ///
    /// # Errors
    /// As `seal`.
    pub fn try_seal(&mut self) -> Result<(), StoreError> {
        let log = &mut self.log;
        log.commit()?;
        let (store, stage) = (log.data.store.clone(), log.data.stage);
        let mut list = Vec::new();
        for process in store.processes(stage)? {
            if process == log.data.process {
                list.extend(log.sealed_files()?);
                continue;
            }
            let journal = lock_journal(&store, stage, process)?;
            if let Ok((mut other, _)) = Log::recover(&store, stage, process, journal)? {
                if other.state.made_from != log.state.made_from {
                    let detail = "this process wrote for other inputs or flags";
                    return Err(other.journal.corrupt(32, detail));
                }
                other.data.data.sync()?;
                other.journal.sync()?;
                list.extend(other.sealed_files()?);
            }
        }
        seal::write(&store, stage, log.state.made_from, &list)
    }
}

impl fmt::Debug for StageWriter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (live, pending) = (self.log.state.live.len(), self.log.pending.len());
        write!(
            f,
            "StageWriter({}, {live} live, {pending} pending)",
            self.log.journal.path.display()
        )
    }
}

fn lock_journal(store: &StoreDir, stage: StageKind, process: u32) -> Result<Named, StoreError> {
    // Another process may be looking whether somebody is alive here, which takes a lock for a moment.
    let mut patience = 10;
    loop {
        let journal = Named::open_or_create(store.file(stage, Role::Journal { process }))?;
        match journal.lock() {
            Ok(true) => return Ok(journal),
            Ok(false) => {}
            Err(StoreError::Busy { .. }) if patience > 0 => {
                patience -= 1;
                std::thread::sleep(Duration::from_millis(10));
            }
            Err(error) => return Err(error),
        }
    }
}

impl Log {
    fn new(data: ExtentReader, journal: Named, state: State) -> Self {
        Self {
            flushed: state.data_end,
            data,
            journal,
            state,
            pending: Vec::new(),
            dying: Vec::new(),
            released: Ranges::default(),
            buffer: Vec::new(),
            unsynced: false,
            hash: None,
            failed: false,
        }
    }

    /// Starts both files afresh.
    fn begin(
        store: &StoreDir,
        stage: StageKind,
        process: u32,
        journal: Named,
        identity: &Identity,
    ) -> Result<Self, StoreError> {
        let role = Role::Data { process, segment: 0 };
        let data = Named::open_or_create(store.file(stage, role))?;
        let made_from = identity.hash();
        let header = files::header(stage, role, made_from);
        journal.set_len(0)?;
        data.set_len(0)?;
        data.write(0, header.as_bytes(), store.stats())?;
        let mut hash = Box::new(Xxh3::new());
        hash.update(header.as_bytes());
        let header = files::header(stage, Role::Journal { process }, made_from);
        journal.write(0, header.as_bytes(), store.stats())?;
        files::sync_dir(store.path())?;
        let data = ExtentReader { store: store.clone(), data: Arc::new(data), stage, process };
        let state = State { data_end: HEADER, made_from, ..Default::default() };
        let mut log = Self { hash: Some(hash), unsynced: true, ..Self::new(data, journal, state) };
        let (text, count) = (identity.to_text(), identity.entries().len() as u64);
        let bytes = text.as_bytes();
        log.append(ExtentKind::Identity, 0, count, bytes, bytes.len() as u64, Codec::Raw)?;
        log.commit()?;
        Ok(log)
    }

    /// Goes back to the last commit; gives the journal back when there is none.
    #[allow(clippy::type_complexity)]
    fn recover(
        store: &StoreDir,
        stage: StageKind,
        process: u32,
        journal: Named,
    ) -> Result<Result<(Self, Identity), Named>, StoreError> {
        let Some(state) = replay::replay(&journal, stage, process, Tail::MayBeTorn, store.stats())?
        else {
            return Ok(Err(journal));
        };
        let data = Named::open_or_create(store.file(stage, Role::Data { process, segment: 0 }))?;
        let data = ExtentReader { store: store.clone(), data: Arc::new(data), stage, process };
        reader::check_data(store, &data, &state)?;
        let first = state.live.values().find(|e| e.kind == ExtentKind::Identity);
        let first = first.ok_or_else(|| journal.corrupt(HEADER, "it names no identity"))?;
        let identity = replay::identity(&data, first, state.made_from)?;
        data.data.set_len(state.data_end)?;
        journal.set_len(state.journal_end())?;
        Ok(Ok((Self::new(data, journal, state), identity)))
    }

    /// Sequence number of the next record.
    fn sequence(&self) -> u64 {
        self.state.records + self.pending.len() as u64
    }

    fn check_usable(&self) -> Result<(), StoreError> {
        if !self.failed {
            return Ok(());
        }
        let source = std::io::Error::other("an earlier sync failed; run the same command again");
        Err(StoreError::io("write", &self.journal.path)(source))
    }

    fn append(
        &mut self,
        kind: ExtentKind,
        id: u32,
        count: u64,
        stored: &[u8],
        raw_bytes: u64,
        codec: Codec,
    ) -> Result<Extent, StoreError> {
        self.check_usable()?;
        let stored_bytes = stored.len() as u64;
        // A slice is shorter than 2^63 bytes: this cannot overflow.
        let padding =
            &[0; 64][..(stored_bytes.max(1).next_multiple_of(64) - stored_bytes) as usize];
        let n = stored.len() + padding.len();
        if self.buffer.len() + n > WINDOW {
            self.flush()?;
        }
        let mut hash = Xxh3::new();
        hash.update(stored);
        hash.update(padding);
        let extent = Extent {
            kind,
            id,
            stage: self.data.stage,
            process: self.data.process,
            segment: 0,
            offset: self.flushed + self.buffer.len() as u64,
            stored_bytes,
            raw_bytes,
            count,
            codec,
            checksum: hash.digest128().to_le_bytes(),
        };
        if n > WINDOW {
            let (file, stats) = (&self.data.data, self.data.store.stats());
            self.unsynced = true;
            file.write(extent.offset, stored, stats)?;
            file.write(extent.offset + stored_bytes, padding, stats)?;
            if let Some(hash) = &mut self.hash {
                hash.update(stored);
                hash.update(padding);
            }
            self.flushed += n as u64;
        } else {
            self.buffer.reserve_exact(if self.buffer.capacity() == 0 { WINDOW } else { 0 });
            self.buffer.extend_from_slice(stored);
            self.buffer.extend_from_slice(padding);
        }
        self.pending.push(record_of(self.sequence(), JournalKind::Extent, &extent));
        self.state.live.insert(key(&extent), extent);
        Ok(extent)
    }

    fn flush(&mut self) -> Result<(), StoreError> {
        if !self.buffer.is_empty() {
            self.unsynced = true;
            self.data.data.write(self.flushed, &self.buffer, self.data.store.stats())?;
            if let Some(hash) = &mut self.hash {
                hash.update(&self.buffer);
            }
            self.flushed += self.buffer.len() as u64;
            self.buffer.clear();
        }
        Ok(())
    }

    fn commit(&mut self) -> Result<(), StoreError> {
        self.check_usable()?;
        if self.pending.is_empty() {
            return Ok(());
        }
        self.flush()?;
        if self.unsynced {
            self.sync(&Arc::clone(&self.data.data))?;
            self.unsynced = false;
        }
        let record = JournalRecord {
            offset: self.flushed,
            count: self.pending.len() as u64,
            ..blank(self.sequence(), JournalKind::Commit)
        };
        self.pending.push(finish(record));
        let (at, stats) = (self.state.journal_end(), self.data.store.stats());
        let written = self.journal.write(at, self.pending.as_bytes(), stats);
        let synced = written.and_then(|()| {
            let synced = self.journal.sync();
            self.failed |= synced.is_err();
            synced
        });
        if let Err(e) = synced {
            self.pending.pop();
            return Err(e);
        }
        self.state.records += self.pending.len() as u64;
        self.state.data_end = self.flushed;
        self.pending.clear();
        for (start, end) in self.dying.drain(..) {
            self.state.dead.add(start, end);
        }
        Ok(())
    }

    fn sync(&mut self, file: &Named) -> Result<(), StoreError> {
        let synced = file.sync();
        // The kernel may have dropped the pages: a second sync would succeed and mean nothing.
        self.failed |= synced.is_err();
        synced
    }

    fn release(&mut self) -> Result<u64, StoreError> {
        self.check_usable()?;
        let mut bytes = 0;
        for (start, end) in std::mem::take(&mut self.state.dead).iter() {
            self.hash = None;
            // A block goes when all of it is punched at once: take the neighbours along that went before.
            let (first, last) = self.released.add(start, end);
            let (first, last) = (first.max(start.saturating_sub(BLOCK)), last.min(end + BLOCK));
            let flags = FallocateFlags::PUNCH_HOLE | FallocateFlags::KEEP_SIZE;
            match fallocate(&self.data.data.file, flags, first, last - first) {
                Ok(()) => bytes += end - start,
                Err(Errno::OPNOTSUPP | Errno::NOSYS) => return Ok(bytes),
                Err(e) => {
                    return Err(StoreError::io("release space in", &self.data.data.path)(e.into()));
                }
            }
        }
        Ok(bytes)
    }

    /// Lengths and hashes of both files; everything is committed.
    fn sealed_files(&mut self) -> Result<[SealedFile; 2], StoreError> {
        let (process, stats) = (self.data.process, self.data.store.stats());
        let journal_end = self.state.journal_end();
        let data_hash = match &self.hash {
            Some(hash) => hash.digest128().to_le_bytes(),
            None => seal::hash_data(&self.data.data, self.state.data_end, &self.state, stats)?,
        };
        Ok([
            SealedFile {
                role: Role::Journal { process },
                length: journal_end,
                hash: seal::hash_file(&self.journal, journal_end, stats)?,
            },
            SealedFile {
                role: Role::Data { process, segment: 0 },
                length: self.state.data_end,
                hash: data_hash,
            },
        ])
    }
}
