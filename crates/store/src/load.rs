//! Reading one extent: plain reads in windows, the checksum always, then inflating.

use std::fmt;
use std::sync::Arc;

use enf_layout::codec;
use enf_layout::segment::{Codec, ExtentKind, StageKind};
use xxhash_rust::xxh3::Xxh3;
use zstd::bulk::Decompressor;
use zstd::zstd_safe::get_frame_content_size;

use crate::files::{Named, Role, WINDOW, padded};
use crate::{Buffer, MemoryBudget, StoreDir, StoreError};

/// Where an extent lies and what it holds: one immutable run of bytes in a data file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// What it holds.
    pub kind: ExtentKind,
    /// Room, tile or band; 0 for tables.
    pub id: u32,
    /// Stage that wrote it.
    pub stage: StageKind,
    /// Process that wrote it.
    pub process: u32,
    /// Data file among the process's.
    pub segment: u32,
    /// First byte in the data file, a multiple of 64.
    pub offset: u64,
    /// Bytes in the file, without padding.
    pub stored_bytes: u64,
    /// Bytes after inflating.
    pub raw_bytes: u64,
    /// Records in it, as the writer said; the store does not know their size and never uses it.
    pub count: u64,
    /// How the bytes are stored.
    pub codec: Codec,
    /// XXH3-128 of the stored bytes and their padding.
    pub checksum: [u8; 16],
}

impl Extent {
    /// Bytes in the file, padding included. (Bounded when the extent is made or replayed.)
    pub(crate) fn padded_bytes(&self) -> u64 {
        padded(self.stored_bytes).unwrap_or(u64::MAX)
    }

    /// One past its last byte of padding.
    pub(crate) fn end(&self) -> u64 {
        self.offset.saturating_add(self.padded_bytes())
    }

    /// Most bytes that reading it reserves at any moment, the returned buffer included.
    pub fn read_peak_bytes(&self) -> u64 {
        let inflating = self.stored_bytes.saturating_add(DECOMPRESSOR);
        match self.codec {
            Codec::Raw => self.raw_bytes,
            Codec::Zstd => self.raw_bytes.saturating_add(inflating),
            // The longest section is taken aside to undo its transform.
            Codec::ZstdPlanes => self.raw_bytes.saturating_add(inflating.max(self.raw_bytes)),
        }
    }

    /// Name for messages: "geometry of 12".
    pub(crate) fn name(&self) -> String {
        format!("{:?} of {}", self.kind, self.id).to_lowercase()
    }
}

/// What a zstd decompression context takes, rounded up.
const DECOMPRESSOR: u64 = 192 << 10;

/// A handle that reads the extents of one data file, from any thread.
///
/// It reads what has reached the file: of a stage that is still being written, what was appended
/// before the last commit or [`flush`](crate::StageWriter::flush).
#[derive(Clone)]
pub struct ExtentReader {
    pub(crate) store: StoreDir,
    pub(crate) data: Arc<Named>,
    pub(crate) stage: StageKind,
    pub(crate) process: u32,
}

impl ExtentReader {
    /// The data file of one process, for reading.
    pub(crate) fn open(
        store: &StoreDir,
        stage: StageKind,
        process: u32,
    ) -> Result<Self, StoreError> {
        let path = store.file(stage, Role::Data { process, segment: 0 });
        let data = Named::open(path, "the store is incomplete; copy it again with all its files")?;
        Ok(Self { store: store.clone(), data: Arc::new(data), stage, process })
    }

    /// Reads an extent into a buffer reserved for `what`: checksum verified, inflated.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] naming file and offset; [`StoreError::Budget`]; [`StoreError::Io`];
    /// [`StoreError::Malformed`] for an extent of another file.
    pub fn read(
        &self,
        extent: &Extent,
        budget: &MemoryBudget,
        what: &'static str,
    ) -> Result<Buffer, StoreError> {
        self.check_owner(extent)?;
        let stats = self.store.stats();
        let fetch = |buffer: &mut Buffer| {
            let out = buffer.padded_mut();
            let mut hash = Xxh3::new();
            for (i, window) in out.chunks_mut(WINDOW).enumerate() {
                self.data.read(extent.offset + (i * WINDOW) as u64, window, stats)?;
                hash.update(window);
            }
            check(&self.data, extent, hash.digest128().to_le_bytes())
        };
        let bytes = unpack(&self.data, extent, budget, what, fetch)?;
        if extent.codec != Codec::Raw {
            stats.inflated(extent.raw_bytes);
        }
        Ok(bytes)
    }

    /// Asks the system to bring an extent's bytes into the page cache, without waiting for them.
    pub fn prefetch(&self, extent: &Extent) {
        if self.check_owner(extent).is_ok() {
            let (advice, len) = (rustix::fs::Advice::WillNeed, extent.padded_bytes());
            // Only a hint: a refusal costs nothing but time.
            let _ =
                rustix::fs::fadvise(&self.data.file, extent.offset, len.try_into().ok(), advice);
        }
    }

    fn check_owner(&self, extent: &Extent) -> Result<(), StoreError> {
        if (extent.stage, extent.process) == (self.stage, self.process) {
            return Ok(());
        }
        Err(foreign(extent, self.stage))
    }
}

impl fmt::Debug for ExtentReader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ExtentReader({})", self.data.path.display())
    }
}

pub(crate) fn foreign(extent: &Extent, stage: StageKind) -> StoreError {
    let (name, stage) = (extent.name(), stage.name());
    enf_layout::sections::Malformed(format!(
        "{name}, written by process {} of {}, was looked for among {stage}'s extents",
        extent.process,
        extent.stage.name()
    ))
    .into()
}

/// Compares an extent's bytes with its checksum.
pub(crate) fn check(data: &Named, extent: &Extent, found: [u8; 16]) -> Result<(), StoreError> {
    if found == extent.checksum {
        return Ok(());
    }
    let (name, bytes) = (extent.name(), extent.padded_bytes());
    Err(data.corrupt(
        extent.offset,
        format!("the extent here, {name}, {bytes} bytes long, does not match its checksum"),
    ))
}

/// Turns an extent's stored bytes, brought and checked by `fetch` into the padded part of a buffer, into its raw ones.
pub(crate) fn unpack(
    data: &Named,
    extent: &Extent,
    budget: &MemoryBudget,
    what: &'static str,
    fetch: impl FnOnce(&mut Buffer) -> Result<(), StoreError>,
) -> Result<Buffer, StoreError> {
    let bad = |detail: String| data.corrupt(extent.offset, format!("{}: {detail}", extent.name()));
    let length = |bytes: u64| {
        usize::try_from(bytes).map_err(|_| bad(format!("{bytes} bytes do not fit in memory")))
    };
    let mut stored = Buffer::to_fill(budget, length(extent.stored_bytes)?, what)?;
    fetch(&mut stored)?;
    if extent.codec == Codec::Raw {
        return Ok(stored);
    }
    if get_frame_content_size(&stored).ok().flatten() != Some(extent.raw_bytes) {
        return Err(bad("the compressed frame and the journal disagree about its length".into()));
    }
    let mut raw = Buffer::to_fill(budget, length(extent.raw_bytes)?, what)?;
    {
        let _context = budget.reserve(DECOMPRESSOR, "decompressor")?;
        let inflated = Decompressor::new()
            .and_then(|mut d| d.decompress_to_buffer(&stored, &mut raw[..]))
            .map_err(|e| bad(format!("it does not inflate: {e}")))?;
        if inflated as u64 != extent.raw_bytes {
            return Err(bad(format!("it inflates to {inflated} bytes of {}", extent.raw_bytes)));
        }
    }
    drop(stored);
    if extent.codec == Codec::ZstdPlanes {
        let scratch = codec::scratch_bytes(&raw).map_err(|e| bad(e.0))?;
        let mut scratch = Buffer::to_fill(budget, scratch, what)?;
        codec::inverse(&mut raw, &mut scratch).map_err(|e| bad(e.0))?;
    }
    Ok(raw)
}
