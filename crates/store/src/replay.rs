//! Replaying a journal: from records back to the state that the last commit left.

use std::collections::BTreeMap;

use enf_layout::journal::{JournalKind, JournalRecord};
use enf_layout::segment::{Codec, EXTENT_ALIGNMENT, ExtentKind, FileHeader, StageKind};
use xxhash_rust::xxh3::xxh3_64;
use zerocopy::{FromBytes, IntoBytes};

use crate::dir::IoStats;
use crate::files::{self, HEADER, Named, Role};
use crate::{Extent, ExtentReader, Identity, MemoryBudget, StoreDir, StoreError};

pub(crate) const RECORD: u64 = size_of::<JournalRecord>() as u64;

/// Records that are read in one go.
pub(crate) const BATCH: u64 = 4096;

/// An identity longer than this is no identity.
const MAX_IDENTITY: u64 = 1 << 20;

/// Order of the table of live extents.
pub(crate) type Key = (ExtentKind, u32, u64);

pub(crate) fn key(extent: &Extent) -> Key {
    (extent.kind, extent.id, extent.offset)
}

/// Disjoint byte ranges; neighbours are merged.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Ranges(BTreeMap<u64, u64>);

impl Ranges {
    /// Adds `start..end` and returns the merged range that it is part of.
    pub(crate) fn add(&mut self, mut start: u64, mut end: u64) -> (u64, u64) {
        while let Some((&s, &e)) = self.0.range(..=end).next_back() {
            if e < start {
                break;
            }
            self.0.remove(&s);
            (start, end) = (start.min(s), end.max(e));
        }
        self.0.insert(start, end);
        (start, end)
    }

    /// Whether all of `start..end` was added.
    pub(crate) fn covers(&self, start: u64, end: u64) -> bool {
        self.0.range(..=start).next_back().is_some_and(|(_, &e)| e >= end)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (u64, u64)> {
        self.0.iter().map(|(&start, &end)| (start, end))
    }
}

/// What the last commit left.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct State {
    /// Produced and not consumed.
    pub(crate) live: BTreeMap<Key, Extent>,
    /// Last value of each cursor.
    pub(crate) cursors: BTreeMap<(ExtentKind, u32), u64>,
    /// Where consumed extents lay, in the data file.
    pub(crate) dead: Ranges,
    /// The same of what it consumed of other processes, in their data files.
    pub(crate) consumed: BTreeMap<u32, Ranges>,
    /// End of the last extent, in the data file.
    pub(crate) data_end: u64,
    /// Records up to and with the last commit.
    pub(crate) records: u64,
    /// [`FileHeader::made_from`].
    pub(crate) made_from: [u8; 16],
}

impl State {
    pub(crate) fn journal_end(&self) -> u64 {
        HEADER + self.records * RECORD
    }
}

/// What may stand at a journal's end.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Tail {
    /// A kill may have cut it: what follows the last commit counts for nothing.
    MayBeTorn,
    /// It is sealed: every byte counts.
    Whole,
}

/// A record with its checksum.
pub(crate) fn finish(mut record: JournalRecord) -> JournalRecord {
    record.checksum = xxh3_64(&record.as_bytes()[..88]);
    record
}

/// A record of `kind` about nothing; `finish` it.
pub(crate) fn blank(sequence: u64, kind: JournalKind) -> JournalRecord {
    JournalRecord {
        sequence,
        kind: kind as u32,
        extent_kind: 0,
        id: 0,
        segment: 0,
        codec: 0,
        process: 0,
        offset: 0,
        stored_bytes: 0,
        raw_bytes: 0,
        count: 0,
        data_checksum: [0; 16],
        reserved2: 0,
        checksum: 0,
    }
}

/// A record that names an extent.
pub(crate) fn record_of(sequence: u64, kind: JournalKind, extent: &Extent) -> JournalRecord {
    finish(JournalRecord {
        extent_kind: extent.kind as u32,
        id: extent.id,
        segment: extent.segment,
        codec: extent.codec as u32,
        process: extent.process,
        offset: extent.offset,
        stored_bytes: extent.stored_bytes,
        raw_bytes: extent.raw_bytes,
        count: extent.count,
        data_checksum: extent.checksum,
        ..blank(sequence, kind)
    })
}

/// The extent that a record names, every number bounded; `Err` says what is wrong.
pub(crate) fn extent_of(r: &JournalRecord, stage: StageKind) -> Result<Extent, String> {
    let kind = ExtentKind::from_u32(r.extent_kind)
        .ok_or_else(|| format!("unknown extent kind {}", r.extent_kind))?;
    let codec = Codec::from_u32(r.codec).ok_or_else(|| format!("unknown codec {}", r.codec))?;
    // A zstd block of 128 KiB takes at least four bytes; nothing honest inflates further.
    let most = match codec {
        Codec::Raw => r.stored_bytes,
        _ => r.stored_bytes.saturating_mul(1 << 15),
    };
    let ends = files::padded(r.stored_bytes).and_then(|n| r.offset.checked_add(n));
    if r.segment != 0
        || !r.offset.is_multiple_of(EXTENT_ALIGNMENT)
        || ends.is_none_or(|e| e > 1 << 60)
    {
        return Err(format!(
            "an extent at {} with {} bytes, segment {}, cannot be",
            r.offset, r.stored_bytes, r.segment
        ));
    }
    if r.raw_bytes > most || (codec == Codec::Raw && r.raw_bytes != most) {
        return Err(format!("{} stored bytes cannot make {} bytes", r.stored_bytes, r.raw_bytes));
    }
    Ok(Extent {
        kind,
        id: r.id,
        stage,
        process: r.process,
        segment: r.segment,
        offset: r.offset,
        stored_bytes: r.stored_bytes,
        raw_bytes: r.raw_bytes,
        count: r.count,
        codec,
        checksum: r.data_checksum,
    })
}

impl State {
    fn apply(&mut self, r: &JournalRecord, stage: StageKind, process: u32) -> Result<(), String> {
        match JournalKind::from_u32(r.kind) {
            Some(JournalKind::Extent) => {
                let extent = extent_of(r, stage)?;
                self.data_end = follows(&extent, process, self.data_end)?;
                self.live.insert(key(&extent), extent);
            }
            Some(JournalKind::Consumed) => {
                let extent = extent_of(r, stage)?;
                if extent.process != process {
                    let consumed = self.consumed.entry(extent.process).or_default();
                    consumed.add(extent.offset, extent.end());
                    return Ok(());
                }
                if self.live.remove(&key(&extent)) != Some(extent) {
                    return Err(format!("it consumes {}, which is not there", extent.name()));
                }
                self.dead.add(extent.offset, extent.end());
            }
            Some(JournalKind::Cursor) => {
                let kind = ExtentKind::from_u32(r.extent_kind)
                    .ok_or_else(|| format!("unknown extent kind {}", r.extent_kind))?;
                self.cursors.insert((kind, r.id), r.count);
            }
            Some(JournalKind::Commit) => {
                if r.offset != self.data_end {
                    let (said, end) = (r.offset, self.data_end);
                    return Err(format!("a commit at {said} where the data ended at {end}"));
                }
            }
            None => return Err(format!("unknown record kind {}", r.kind)),
        }
        Ok(())
    }
}

/// Where the data of `process` end with an extent that must begin where they ended before.
pub(crate) fn follows(extent: &Extent, process: u32, data_end: u64) -> Result<u64, String> {
    if (extent.process, extent.offset) != (process, data_end) {
        let (of, at) = (extent.process, extent.offset);
        return Err(format!(
            "an extent of process {of} at {at} where the data ended at {data_end}"
        ));
    }
    Ok(extent.end())
}

/// Replays the journal of one process. `None`: nothing was ever committed (only when it may be torn).
///
/// A torn tail and a flipped bit are told apart by what follows: a batch of records is written only
/// after the commit before it was synced, so a bad record with a later batch behind it was good once.
/// Only in the very last batch the two look alike; it is then done again, with the same results.
pub(crate) fn replay(
    journal: &Named,
    stage: StageKind,
    process: u32,
    tail: Tail,
    io: &IoStats,
) -> Result<Option<State>, StoreError> {
    let len = journal.len()?;
    let torn = tail == Tail::MayBeTorn;
    // The first batch is the identity and its commit; until then even the header may be torn.
    if torn && len < HEADER {
        return Ok(None);
    }
    let header = match files::read_header(journal, stage, Role::Journal { process }, io) {
        Err(StoreError::Corrupt { .. }) if torn && len <= HEADER + 2 * RECORD => return Ok(None),
        other => other?,
    };
    if !torn && !(len - HEADER).is_multiple_of(RECORD) {
        return Err(journal.corrupt(len, "the file ends within a record"));
    }
    let total = (len - HEADER) / RECORD;
    let mut state = State { data_end: HEADER, made_from: header.made_from, ..Default::default() };
    let mut batch: Vec<JournalRecord> = Vec::new();
    let mut bad: Option<u64> = None;
    let mut commit_after_bad = false;
    let mut window = vec![0; (total.min(BATCH) * RECORD) as usize];
    let place = |i: u64| HEADER + i * RECORD;
    for first in (0..total).step_by(BATCH as usize) {
        let window = &mut window[..((total - first).min(BATCH) * RECORD) as usize];
        journal.read(place(first), window, io)?;
        for (i, bytes) in (first..).zip(window.chunks_exact(RECORD as usize)) {
            let record = JournalRecord::read_from_bytes(bytes)
                .map_err(|_| journal.corrupt(place(i), "the file ends within a record"))?;
            let sound = record == finish(record) && record.sequence == i;
            let is_commit = record.kind == JournalKind::Commit as u32;
            if let Some(bad) = bad {
                let later_batch = is_commit && i.saturating_sub(record.count) > bad;
                if sound && (commit_after_bad || later_batch) {
                    return Err(bad_record(journal, bad));
                }
                commit_after_bad |= sound && is_commit;
            } else if !sound {
                if !torn {
                    return Err(bad_record(journal, i));
                }
                bad = Some(i);
            } else {
                batch.push(record);
                if is_commit {
                    if record.count != batch.len() as u64 - 1 {
                        return Err(journal.corrupt(place(i), "a commit miscounts its records"));
                    }
                    for (r, at) in batch.drain(..).zip(state.records..) {
                        state.apply(&r, stage, process).map_err(|detail| {
                            journal.corrupt(place(at), format!("journal record {at}: {detail}"))
                        })?;
                    }
                    state.records = i + 1;
                }
            }
        }
    }
    if state.records == 0 && torn {
        return Ok(None);
    }
    if state.records == 0 || (!torn && state.records != total) {
        return Err(journal.corrupt(place(state.records), "no commit ends the journal"));
    }
    Ok(Some(state))
}

fn bad_record(journal: &Named, i: u64) -> StoreError {
    journal.corrupt(HEADER + i * RECORD, format!("journal record {i} does not match its checksum"))
}

/// The identity extent of a process's journal, without replaying the rest; `None` when nothing was committed.
pub(crate) fn first_extent(
    store: &StoreDir,
    stage: StageKind,
    process: u32,
) -> Result<Option<(Extent, FileHeader)>, StoreError> {
    let role = Role::Journal { process };
    let journal = Named::open(store.file(stage, role), "it was there a moment ago")?;
    if journal.len()? < HEADER + 2 * RECORD {
        return Ok(None);
    }
    let mut bytes = [0; (HEADER + 2 * RECORD) as usize];
    journal.read(0, &mut bytes, store.stats())?;
    let Ok(header) = files::parse_header(&journal, &bytes, stage, role) else {
        return Ok(None);
    };
    let record = |i: u64| {
        JournalRecord::read_from_bytes(&bytes[(HEADER + i * RECORD) as usize..][..RECORD as usize])
            .ok()
            .filter(|&r| r == finish(r) && r.sequence == i)
    };
    let (Some(extent), Some(commit)) = (record(0), record(1)) else {
        return Ok(None);
    };
    if commit.kind != JournalKind::Commit as u32 {
        return Ok(None);
    }
    let extent = extent_of(&extent, stage)
        .map_err(|detail| journal.corrupt(HEADER, format!("journal record 0: {detail}")))?;
    Ok(Some((extent, header)))
}

/// Reads an identity and checks it against a header made from it.
pub(crate) fn identity(
    data: &ExtentReader,
    extent: &Extent,
    made_from: [u8; 16],
) -> Result<Identity, StoreError> {
    let bad = |detail: &str| data.data.corrupt(extent.offset, detail);
    if extent.kind != ExtentKind::Identity || extent.raw_bytes > MAX_IDENTITY {
        return Err(bad("the first extent is no identity"));
    }
    let text = data.read(extent, &MemoryBudget::new(4 * MAX_IDENTITY), "identity")?;
    let text = std::str::from_utf8(&text).map_err(|_| bad("the identity is no text"))?;
    let identity = Identity::from_text(text).map_err(|e| bad(&e.0))?;
    if identity.hash() != made_from {
        return Err(bad("the identity does not match the hash in the journal's header"));
    }
    Ok(identity)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn ranges_merge_like_a_set_of_bytes(list in proptest::collection::vec((0u64..60, 1u64..8), 0..20)) {
            let (mut ranges, mut set) = (Ranges::default(), [false; 80]);
            for (start, n) in list {
                let (from, to) = ranges.add(start, start + n);
                set[start as usize..(start + n) as usize].fill(true);
                prop_assert!(set[from as usize..to as usize].iter().all(|&b| b));
                prop_assert!(from == 0 || !set[from as usize - 1]);
                prop_assert!(!set[to as usize]);
            }
            let mut again = [false; 80];
            for (start, end) in ranges.iter() {
                again[start as usize..end as usize].fill(true);
            }
            prop_assert_eq!(again, set);
        }
    }
}
