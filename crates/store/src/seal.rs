//! The seal: the one small file whose appearance makes a stage finished and immutable.
//!
//! ```text
//! FileHeader                 64 bytes, magic "ENFSEAL\n", made_from = hash of the identity
//! SealRecord                 64 bytes for each file of the stage, in order of process, journal first
//! XXH3-128                   16 bytes, of everything before
//! ```
//!
//! It is written aside, synced and renamed; so it is there whole, or not at all.

use std::fs;

pub use enf_layout::segment::SealRecord;

use enf_layout::segment::StageKind;
use xxhash_rust::xxh3::Xxh3;
use zerocopy::{FromBytes, IntoBytes};

use crate::dir::IoStats;
use crate::files::{self, HEADER, Named, Role, WINDOW};
use crate::load;
use crate::replay::State;
use crate::{Extent, StoreDir, StoreError};

/// A seal longer than this is no seal.
const MAX_BYTES: u64 = 1 << 20;

/// A sealed file, as the seal has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SealedFile {
    pub(crate) role: Role,
    pub(crate) length: u64,
    pub(crate) hash: [u8; 16],
}

/// What a seal says.
#[derive(Debug)]
pub(crate) struct Seal {
    pub(crate) made_from: [u8; 16],
    pub(crate) files: Vec<SealedFile>,
    /// Bytes of the seal itself.
    pub(crate) bytes: u64,
}

impl Seal {
    /// The sealed processes with their journal and data file, ascending.
    pub(crate) fn processes(&self) -> impl Iterator<Item = (u32, &SealedFile, &SealedFile)> {
        self.files.chunks_exact(2).filter_map(|pair| match (pair[0].role, pair[1].role) {
            (Role::Journal { process }, Role::Data { .. }) => Some((process, &pair[0], &pair[1])),
            _ => None,
        })
    }
}

/// Reads and checks a stage's seal; `None` when it is not sealed.
pub(crate) fn read(store: &StoreDir, stage: StageKind) -> Result<Option<Seal>, StoreError> {
    let named = match Named::open(store.file(stage, Role::Seal), "") {
        Err(StoreError::Missing { .. }) => return Ok(None),
        other => other?,
    };
    let len = named.len()?;
    if !(HEADER + 16..=MAX_BYTES).contains(&len) {
        return Err(named.corrupt(len.min(MAX_BYTES), format!("{len} bytes are no seal's length")));
    }
    let mut bytes = vec![0; len as usize];
    named.read(0, &mut bytes, store.stats())?;
    let (contents, trailer) = bytes.split_at(bytes.len() - 16);
    let header = files::parse_header(&named, contents, stage, Role::Seal)?;
    if files::hash128(contents) != *trailer {
        return Err(named.corrupt(HEADER, "the seal does not match its own checksum"));
    }
    let bad = |detail: &str| named.corrupt(HEADER, detail);
    let records = <[SealRecord]>::ref_from_bytes(&contents[HEADER as usize..])
        .map_err(|_| bad("the seal is no whole number of records"))?;
    let mut list = Vec::with_capacity(records.len());
    for record in records {
        let name = record.name.split(|&b| b == 0).next().unwrap_or(&[]);
        let role = std::str::from_utf8(name)
            .ok()
            .and_then(Role::parse)
            .filter(|parsed| parsed.0 == stage)
            .ok_or_else(|| bad("the seal names a file that cannot be the stage's"))?;
        list.push(SealedFile { role: role.1, length: record.length, hash: record.hash });
    }
    let seal = Seal { made_from: header.made_from, files: list, bytes: len };
    let paired = |(process, _, data): (u32, &SealedFile, &SealedFile)| {
        data.role == Role::Data { process, segment: 0 }
    };
    if seal.files.is_empty() || seal.processes().filter(|&p| paired(p)).count() * 2 != records.len()
    {
        return Err(bad("the seal does not name a journal and a data file for each process"));
    }
    Ok(Some(seal))
}

/// Writes a stage's seal: aside, synced, renamed.
pub(crate) fn write(
    store: &StoreDir,
    stage: StageKind,
    made_from: [u8; 16],
    list: &[SealedFile],
) -> Result<(), StoreError> {
    let mut bytes = files::header(stage, Role::Seal, made_from).as_bytes().to_vec();
    for file in list {
        let mut record = SealRecord { name: [0; 40], length: file.length, hash: file.hash };
        let name = file.role.name(stage);
        record.name[..name.len()].copy_from_slice(name.as_bytes());
        bytes.extend_from_slice(record.as_bytes());
    }
    let hash = files::hash128(&bytes);
    bytes.extend_from_slice(&hash);
    let aside = Named::open_or_create(store.file(stage, Role::NewSeal))?;
    aside.set_len(0)?;
    aside.write(0, &bytes, store.stats())?;
    aside.sync()?;
    let path = store.file(stage, Role::Seal);
    fs::rename(&aside.path, &path).map_err(StoreError::io("rename to", &path))?;
    files::sync_dir(store.path())
}

/// XXH3-128 of the first `len` bytes of a file.
pub(crate) fn hash_file(file: &Named, len: u64, io: &IoStats) -> Result<[u8; 16], StoreError> {
    scan(file, len, &[], io)
}

/// XXH3-128 of the first `len` bytes of a data file, each live extent checked on the way.
pub(crate) fn hash_data(
    data: &Named,
    len: u64,
    state: &State,
    io: &IoStats,
) -> Result<[u8; 16], StoreError> {
    let mut extents: Vec<&Extent> = state.live.values().collect();
    extents.sort_by_key(|e| e.offset);
    scan(data, len, &extents, io)
}

fn scan(file: &Named, len: u64, extents: &[&Extent], io: &IoStats) -> Result<[u8; 16], StoreError> {
    let mut window = vec![0; WINDOW.min(len as usize)];
    let (mut whole, mut one) = (Xxh3::new(), Xxh3::new());
    let mut extents = extents.iter().peekable();
    let mut at = 0;
    while at < len {
        let n = (len - at).min(WINDOW as u64);
        let window = &mut window[..n as usize];
        file.read(at, window, io)?;
        whole.update(window);
        while let Some(extent) = extents.peek().filter(|e| e.offset < at + n) {
            let from = extent.offset.max(at) - at;
            let to = (extent.end() - at).min(n);
            one.update(&window[from as usize..to as usize]);
            if extent.end() > at + n {
                break;
            }
            load::check(file, extent, one.digest128().to_le_bytes())?;
            one.reset();
            extents.next();
        }
        at += n;
    }
    Ok(whole.digest128().to_le_bytes())
}

/// The first byte of a data file that no live extent covers, or the end of its header.
pub(crate) fn first_gap(state: &State) -> u64 {
    let mut extents: Vec<&Extent> = state.live.values().collect();
    extents.sort_by_key(|e| e.offset);
    extents.iter().fold(HEADER, |at, e| if e.offset == at { e.end() } else { at })
}
