//! Frozen bytes: a store of this format version, written once and kept, reads back, and is written again
//! to the byte. `ENF_BLESS=1` writes the fixtures anew, which only a new format version justifies.

use std::fs;
use std::path::PathBuf;

use enf_layout::segment::{Codec, ExtentKind};
use enf_store::{StageReader, StageWriter, StoreDir, verify};

use crate::{STAGE, blob, budget, bytes, files, identity, tempdir};

fn fixture(name: &str) -> PathBuf {
    let dir = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(name);
    if std::env::var_os("ENF_BLESS").is_some() {
        let _ = fs::remove_dir_all(&dir);
        write(&dir, name == "packed");
    }
    dir
}

fn write(dir: &std::path::Path, packed: bool) {
    let store = StoreDir::create(dir).unwrap();
    let mut writer = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
    let waiting = writer.append(ExtentKind::Transit, 5, 2, &bytes(1, 128), Codec::Raw).unwrap();
    writer.append(ExtentKind::Photons, 3, 5, &bytes(2, 120), Codec::Raw).unwrap();
    writer.cursor(ExtentKind::Transit, 5, 1000);
    writer.commit().unwrap();
    writer.consume(&waiting);
    writer.append(ExtentKind::Passages, 0, 0, &[], Codec::Raw).unwrap();
    if packed {
        writer.append(ExtentKind::Ledger, 0, 2, &bytes(3, 272), Codec::Zstd).unwrap();
        writer.append(ExtentKind::Map, 3, 20, &blob(4, 20), Codec::ZstdPlanes).unwrap();
    }
    writer.seal().unwrap();
}

#[test]
fn the_format_is_written_as_it_was() {
    let dir = tempdir();
    write(dir.path(), false);
    // Compressed bytes depend on zstd's version; these do not.
    assert_eq!(files(dir.path()), files(&fixture("raw")));
}

#[test]
fn the_format_is_read_as_it_was() {
    let store = StoreDir::open(fixture("packed")).unwrap();
    assert_eq!(verify(&store, STAGE).unwrap().files, 3);
    let reader = StageReader::open(&store, STAGE).unwrap();
    assert_eq!(*reader.identity(), identity());
    let read = |kind, id| {
        let extent = reader.single(kind, id).unwrap();
        (extent.count, reader.read(extent, &budget(), "test").unwrap().to_vec())
    };
    assert_eq!(read(ExtentKind::Photons, 3), (5, bytes(2, 120)));
    assert_eq!(read(ExtentKind::Passages, 0), (0, vec![]));
    assert_eq!(read(ExtentKind::Ledger, 0), (2, bytes(3, 272)));
    assert_eq!(read(ExtentKind::Map, 3), (20, blob(4, 20)));
    assert!(reader.extents(ExtentKind::Transit).is_empty());
    assert_eq!(reader.cursors().collect::<Vec<_>>(), [(ExtentKind::Transit, 5, 1000)]);
}
