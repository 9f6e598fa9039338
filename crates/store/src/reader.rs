//! Reading what a stage wrote.
//!
//! Opening checks the seal, every file's length and the whole journal; reading checks the extent. So
//! nothing is ever used unchecked, and nothing is checked that is not used ([`verify`] does that).

use std::collections::BTreeMap;
use std::sync::Arc;

use enf_layout::sections::Malformed;
use enf_layout::segment::{Codec, ExtentKind, StageKind};

use crate::files::{self, Named, Role};
use crate::load::{self, Extent, ExtentReader};
use crate::map::{self, Mapped};
use crate::replay::{self, Ranges, State, Tail};
use crate::seal::{self, Seal, SealedFile};
use crate::{Buffer, Identity, MemoryBudget, Reservation, StoreDir, StoreError};

const COPY_AGAIN: &str = "the store is incomplete; copy it again with all its files";

/// The extents of one stage, for any number of threads: all reads are positioned, nothing is shared but
/// the open files.
#[derive(Debug)]
pub struct StageReader {
    store: StoreDir,
    stage: StageKind,
    sealed: bool,
    identity: Identity,
    /// By kind, id, process, offset.
    extents: Vec<Extent>,
    cursors: Vec<(ExtentKind, u32, u64)>,
    /// Ascending by process.
    files: Vec<ExtentReader>,
    table: Option<Reservation>,
}

impl StageReader {
    /// Opens a finished stage. Checks the seal, the length of every file, and the journals to the last byte.
    ///
    /// # Errors
    /// [`StoreError::Missing`] when nothing of the stage, or not all of its files, is there,
    /// [`StoreError::Unfinished`] when it is not sealed, [`StoreError::Corrupt`] naming file and offset.
    pub fn open(store: &StoreDir, stage: StageKind) -> Result<Self, StoreError> {
        let seal = match seal::read(store, stage)? {
            Some(seal) => seal,
            None if store.identity(stage)?.is_some() => {
                return Err(StoreError::Unfinished {
                    stage,
                    path: store.path().into(),
                    detail: "it is not sealed".into(),
                });
            }
            None => return Err(missing(store, stage)),
        };
        let mut states = Vec::new();
        for (process, journal, data) in seal.processes() {
            states.push(open_sealed(store, stage, &seal, process, journal, data)?);
        }
        Self::new(store, stage, true, states)
    }

    /// Opens what the last commits left of a stage, sealed or not.
    ///
    /// Extents that a live writer consumes and releases meanwhile read as corrupt.
    ///
    /// # Errors
    /// [`StoreError::Missing`] when nothing is committed, [`StoreError::Corrupt`] naming file and offset.
    pub fn open_unsealed(store: &StoreDir, stage: StageKind) -> Result<Self, StoreError> {
        if seal::read(store, stage)?.is_some() {
            return Self::open(store, stage);
        }
        let mut states = Vec::new();
        for process in store.processes(stage)? {
            let role = Role::Journal { process };
            let journal = Named::open(store.file(stage, role), COPY_AGAIN)?;
            let replayed =
                replay::replay(&journal, stage, process, Tail::MayBeTorn, store.stats())?;
            if let Some(state) = replayed {
                let data = ExtentReader::open(store, stage, process)?;
                check_data(store, &data, &state)?;
                states.push((data, state));
            }
        }
        Self::new(store, stage, false, states)
    }

    fn new(
        store: &StoreDir,
        stage: StageKind,
        sealed: bool,
        states: Vec<(ExtentReader, State)>,
    ) -> Result<Self, StoreError> {
        let mut reader = Self {
            store: store.clone(),
            stage,
            sealed,
            identity: Identity::new(),
            extents: Vec::with_capacity(states.iter().map(|s| s.1.live.len()).sum()),
            cursors: Vec::new(),
            files: Vec::new(),
            table: None,
        };
        let mut consumed: BTreeMap<u32, Ranges> = BTreeMap::new();
        for (_, state) in &states {
            for (&process, ranges) in &state.consumed {
                let all = consumed.entry(process).or_default();
                for (start, end) in ranges.iter() {
                    all.add(start, end);
                }
            }
        }
        for (data, state) in states {
            let first = state.live.values().find(|e| e.kind == ExtentKind::Identity);
            let first = first.ok_or_else(|| data.data.corrupt(files::HEADER, "no identity"))?;
            let identity = replay::identity(&data, first, state.made_from)?;
            if !reader.files.is_empty() && identity != reader.identity {
                let detail = "this process wrote for other inputs or flags than the first one";
                return Err(data.data.corrupt(first.offset, detail));
            }
            reader.identity = identity;
            let others = consumed.get(&data.process);
            let live = |e: &&Extent| others.is_none_or(|c| !c.covers(e.offset, e.end()));
            reader.extents.extend(state.live.values().filter(live));
            reader.cursors.extend(state.cursors.iter().map(|(&(kind, id), &n)| (kind, id, n)));
            reader.files.push(data);
        }
        if reader.files.is_empty() {
            return Err(missing(store, stage));
        }
        reader.extents.sort_unstable_by_key(|e| (e.kind, e.id, e.process, e.offset));
        Ok(reader)
    }

    /// Counts the table of extents in a budget from now on.
    ///
    /// # Errors
    /// [`StoreError::Budget`] when it has no place for it.
    pub fn with_budget(mut self, budget: &MemoryBudget) -> Result<Self, StoreError> {
        let bytes = (self.extents.len() * size_of::<Extent>()) as u64;
        self.table = Some(budget.reserve(bytes, "table of extents")?);
        Ok(self)
    }

    /// The store that it reads from.
    pub fn store(&self) -> &StoreDir {
        &self.store
    }

    /// The stage that it reads.
    pub fn stage(&self) -> StageKind {
        self.stage
    }

    /// What the stage was made from.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// The live extents of a kind, by id, then process and offset.
    pub fn extents(&self, kind: ExtentKind) -> &[Extent] {
        self.between(|e| e.kind.cmp(&kind))
    }

    /// The live extents of a kind with this id, by process and offset.
    pub fn find(&self, kind: ExtentKind, id: u32) -> &[Extent] {
        self.between(|e| (e.kind, e.id).cmp(&(kind, id)))
    }

    fn between(&self, order: impl Fn(&Extent) -> std::cmp::Ordering) -> &[Extent] {
        let from = self.extents.partition_point(|e| order(e).is_lt());
        let count = self.extents[from..].partition_point(|e| order(e).is_eq());
        &self.extents[from..from + count]
    }

    /// The one live extent of a kind with this id.
    ///
    /// # Errors
    /// When there is none, or several: [`StoreError::Corrupt`] in a sealed stage,
    /// [`StoreError::Unfinished`] in one that is not.
    pub fn single(&self, kind: ExtentKind, id: u32) -> Result<&Extent, StoreError> {
        let found = self.find(kind, id);
        if let [extent] = found {
            return Ok(extent);
        }
        let name = format!("{kind:?} of {id}").to_lowercase();
        let detail = format!("there are {} extents '{name}', and one is expected", found.len());
        if self.sealed {
            let journal = Role::Journal { process: self.files[0].process };
            return Err(StoreError::corrupt(&self.store.file(self.stage, journal), 0, detail));
        }
        let path = self.store.path().to_path_buf();
        Err(StoreError::Unfinished { stage: self.stage, path, detail })
    }

    /// The last value of each cursor, process by process.
    pub fn cursors(&self) -> impl Iterator<Item = (ExtentKind, u32, u64)> {
        self.cursors.iter().copied()
    }

    /// Reads an extent into a buffer reserved for `what`: checksum verified, inflated.
    ///
    /// Of a compressed extent the stored bytes are reserved as well while it inflates; see
    /// [`Extent::read_peak_bytes`].
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] naming file and offset, [`StoreError::Budget`], [`StoreError::Io`].
    pub fn read(
        &self,
        extent: &Extent,
        budget: &MemoryBudget,
        what: &'static str,
    ) -> Result<Buffer, StoreError> {
        self.file(extent)?.read(extent, budget, what)
    }

    /// Maps an uncompressed extent of a sealed stage: resident, counted in the budget, verified.
    ///
    /// # Errors
    /// [`StoreError::Unfinished`] for a stage that is not sealed, [`StoreError::Malformed`] for a compressed
    /// extent, else as [`read`](Self::read).
    pub fn map(
        &self,
        extent: &Extent,
        budget: &MemoryBudget,
        what: &'static str,
    ) -> Result<Mapped, StoreError> {
        let file = self.file(extent)?;
        if !self.sealed {
            return Err(StoreError::Unfinished {
                stage: self.stage,
                path: self.store.path().into(),
                detail: "only sealed stages are mapped".into(),
            });
        }
        if extent.codec != Codec::Raw {
            let name = extent.name();
            return Err(Malformed(format!("{name} is compressed and cannot be mapped")).into());
        }
        map::map(&file.data, extent, budget, what, self.store.stats())
    }

    /// Asks the system to bring an extent's bytes into the page cache, without waiting for them.
    pub fn prefetch(&self, extent: &Extent) {
        if let Ok(file) = self.file(extent) {
            file.prefetch(extent);
        }
    }

    fn file(&self, extent: &Extent) -> Result<&ExtentReader, StoreError> {
        self.files
            .iter()
            .find(|f| f.process == extent.process && extent.stage == self.stage)
            .ok_or_else(|| load::foreign(extent, self.stage))
    }
}

fn missing(store: &StoreDir, stage: StageKind) -> StoreError {
    let path = store.file(stage, Role::Seal);
    StoreError::Missing { path, remedy: format!("run enf-{} on this store first", stage.name()) }
}

/// Opens a file that must be as long as the seal says.
fn open_as_long(named: Named, sealed: &SealedFile) -> Result<Named, StoreError> {
    let (len, wanted) = (named.len()?, sealed.length);
    if len == wanted {
        return Ok(named);
    }
    let detail = format!("the file has {len} bytes, the seal says {wanted}");
    Err(named.corrupt(len.min(wanted), detail))
}

fn open_sealed(
    store: &StoreDir,
    stage: StageKind,
    seal: &Seal,
    process: u32,
    journal: &SealedFile,
    data: &SealedFile,
) -> Result<(ExtentReader, State), StoreError> {
    let io = store.stats();
    let named = Named::open(store.file(stage, journal.role), COPY_AGAIN)?;
    let named = open_as_long(named, journal)?;
    let state = replay::replay(&named, stage, process, Tail::Whole, io)?
        .ok_or_else(|| named.corrupt(0, "the journal holds nothing"))?;
    if state.made_from != seal.made_from {
        return Err(named.corrupt(0, "the journal belongs to another run than the seal"));
    }
    if seal::hash_file(&named, journal.length, io)? != journal.hash {
        return Err(named.corrupt(0, "the journal is not the one that was sealed"));
    }
    let mut reader = ExtentReader::open(store, stage, process)?;
    let file = Arc::into_inner(reader.data)
        .ok_or_else(|| missing(store, stage))
        .and_then(|file| open_as_long(file, data))?;
    reader.data = Arc::new(file);
    check_data(store, &reader, &state)?;
    if state.data_end != data.length {
        let detail = format!("the file goes on here, the journal ends at {}", state.data_end);
        return Err(reader.data.corrupt(state.data_end, detail));
    }
    Ok((reader, state))
}

/// Checks a data file's header and that it holds all that its journal names.
pub(crate) fn check_data(
    store: &StoreDir,
    data: &ExtentReader,
    state: &State,
) -> Result<(), StoreError> {
    let role = Role::Data { process: data.process, segment: 0 };
    let header = files::read_header(&data.data, data.stage, role, store.stats())?;
    if header.made_from != state.made_from {
        return Err(data.data.corrupt(32, "the file belongs to another run than its journal"));
    }
    let len = data.data.len()?;
    if len < state.data_end {
        let detail = format!("the file ends here, the journal names {} bytes", state.data_end);
        return Err(data.data.corrupt(len, detail));
    }
    Ok(())
}

/// What [`verify`] went through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Verified {
    /// Files, the seal included.
    pub files: u64,
    /// Their bytes.
    pub bytes: u64,
}

/// Compares every byte of a finished stage with its seal.
///
/// # Errors
/// As [`StageReader::open`]; [`StoreError::Corrupt`] names the file and the beginning of the header, extent or
/// journal record in which the first difference lies.
pub fn verify(store: &StoreDir, stage: StageKind) -> Result<Verified, StoreError> {
    let reader = StageReader::open(store, stage)?;
    let seal = seal::read(store, stage)?.ok_or_else(|| missing(store, stage))?;
    let mut verified = Verified { files: 1, bytes: seal.bytes };
    for (process, journal, data) in seal.processes() {
        // The journals were compared when they were opened.
        let (file, state) = open_sealed(store, stage, &seal, process, journal, data)?;
        if seal::hash_data(&file.data, data.length, &state, store.stats())? != data.hash {
            let detail =
                "bytes that no live extent uses, from here on, are not those that were sealed";
            return Err(file.data.corrupt(seal::first_gap(&state), detail));
        }
        verified.files += 2;
        verified.bytes += journal.length + data.length;
    }
    drop(reader);
    Ok(verified)
}
