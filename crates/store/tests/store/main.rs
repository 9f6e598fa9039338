//! The store from outside: what is written comes back, whatever happens in between.

mod corruption;
mod crash;
mod golden;
mod peers;
mod roundtrip;

use std::fs;
use std::path::Path;

use enf_layout::sections::{self, Transform};
use enf_layout::segment::{Codec, ExtentKind, StageKind};
use enf_store::{Identity, MemoryBudget, StageWriter, StoreDir};

const STAGE: StageKind = StageKind::Trace;

/// A directory that goes away; in memory where there is such a place, because thousands of syncs take long.
fn tempdir() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}

fn budget() -> MemoryBudget {
    MemoryBudget::new(64 << 20)
}

fn identity() -> Identity {
    let mut identity = Identity::new();
    identity.push("scene", "0123456789abcdef").push("seed", 1).push("photons-per-light", 20_000);
    identity
}

/// Bytes that zstd can do something with, different for each `seed`.
fn bytes(seed: u64, n: usize) -> Vec<u8> {
    (0..n as u64).map(|i| (i / 3).wrapping_mul(seed | 1).to_le_bytes()[(i % 3) as usize]).collect()
}

/// A sections blob.
fn blob(seed: u64, words: usize) -> Vec<u8> {
    sections::build(&[
        (&bytes(seed, 4 * words), Transform::Delta, 1),
        (&bytes(seed + 1, 12 * words), Transform::Xor, 3),
        (&bytes(seed + 2, 5), Transform::None, 0),
    ])
}

/// All files of a store by name.
fn files(dir: &Path) -> Vec<(String, Vec<u8>)> {
    let mut list: Vec<_> = fs::read_dir(dir)
        .unwrap()
        .map(|e| e.unwrap())
        .map(|e| (e.file_name().into_string().unwrap(), fs::read(e.path()).unwrap()))
        .collect();
    list.sort();
    list
}

fn put_files(dir: &Path, list: &[(String, Vec<u8>)]) {
    fs::create_dir_all(dir).unwrap();
    for (name, contents) in list {
        fs::write(dir.join(name), contents).unwrap();
    }
}

/// One epoch of a small run: extents in all codecs, a cursor, and the consumption of what an earlier epoch wrote.
fn epoch(writer: &mut StageWriter, n: u32) {
    let seed = u64::from(n) * 10;
    let waiting: Vec<_> = writer.find(ExtentKind::Transit, n / 2).copied().collect();
    let size = 64 * (n as usize % 3);
    writer.append(ExtentKind::Transit, n, 1, &bytes(seed, size), Codec::Raw).unwrap();
    writer.append(ExtentKind::Photons, n % 2, 3, &bytes(seed + 1, 72), Codec::Raw).unwrap();
    if n % 2 == 1 {
        writer.append(ExtentKind::Ledger, 0, 1, &bytes(seed + 2, 200), Codec::Zstd).unwrap();
    }
    if n % 3 == 2 {
        writer.append(ExtentKind::Map, n, 9, &blob(seed, 9), Codec::ZstdPlanes).unwrap();
    }
    for extent in waiting {
        writer.consume(&extent);
    }
    writer.cursor(ExtentKind::Transit, n % 2, u64::from(n));
}

/// What a writer shows: cursors, and every live extent with its contents.
type Shown = (Vec<(ExtentKind, u32, u64)>, Vec<(ExtentKind, u32, u64, Vec<u8>)>);

fn shown(writer: &StageWriter) -> Shown {
    let budget = budget();
    let read = |e: &enf_store::Extent| {
        (e.kind, e.id, e.count, writer.read(e, &budget, "test").unwrap().to_vec())
    };
    (writer.cursors().collect(), writer.extents().map(read).collect())
}

fn sealed(dir: &Path, epochs: u32) -> StoreDir {
    let store = StoreDir::create(dir).unwrap();
    let mut writer = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
    for n in 0..epochs {
        epoch(&mut writer, n);
        writer.commit().unwrap();
    }
    writer.seal().unwrap();
    store
}
