//! Any byte of a finished store: flipped, cut off or added, it is found, and the right file is named.

use std::fs;

use enf_layout::FORMAT_VERSION;
use enf_layout::journal::{JournalKind, JournalRecord};
use enf_layout::segment::{Codec, ExtentKind};
use enf_store::{StageReader, StageWriter, StoreDir, StoreError, verify};
use xxhash_rust::xxh3::xxh3_64;
use zerocopy::{FromBytes, IntoBytes};

use crate::{STAGE, budget, files, identity, put_files, sealed, tempdir};

const JOURNAL: &str = "trace.000.journal";

/// Opens the store and reads all of it, by both ways.
fn read_all(store: &StoreDir) -> Result<Vec<Vec<u8>>, StoreError> {
    let reader = StageReader::open(store, STAGE)?;
    let mut all = Vec::new();
    for kind in (1..).map_while(ExtentKind::from_u32) {
        for extent in reader.extents(kind) {
            let read = reader.read(extent, &budget(), "test")?.to_vec();
            if extent.codec == Codec::Raw {
                assert!(*reader.map(extent, &budget(), "test")? == read);
            }
            all.push(read);
        }
    }
    Ok(all)
}

#[test]
fn every_flipped_byte_is_found_and_its_file_named() {
    let dir = tempdir();
    let store = sealed(dir.path(), 4);
    let wanted = read_all(&store).unwrap();
    for (name, contents) in files(dir.path()) {
        let path = dir.path().join(&name);
        for at in 0..contents.len() {
            let mut bad = contents.clone();
            bad[at] ^= 1 << (at % 8);
            fs::write(&path, &bad).unwrap();
            match verify(&store, STAGE) {
                Err(StoreError::Corrupt { file, offset, .. }) => {
                    assert_eq!(file, path, "byte {at} of {name}");
                    assert!(offset as usize <= at, "byte {at} of {name} reported at {offset}");
                }
                other => panic!("byte {at} of {name}: {other:?}"),
            }
            // What verify does not look at may be bad; what is read is right, or refused.
            match read_all(&store) {
                Ok(all) => assert!(all == wanted, "byte {at} of {name}"),
                Err(e) => {
                    assert!(matches!(&e, StoreError::Corrupt { file, .. } if *file == path), "{e}");
                    assert_eq!(e.exit_code(), 4);
                }
            }
        }
        fs::write(&path, &contents).unwrap();
    }
    verify(&store, STAGE).unwrap();
}

#[test]
fn every_other_length_is_found_and_its_file_named() {
    let dir = tempdir();
    let store = sealed(dir.path(), 2);
    for (name, contents) in files(dir.path()) {
        let path = dir.path().join(&name);
        for len in (0..contents.len()).chain([contents.len() + 1, contents.len() + 96]) {
            let mut bad = contents.clone();
            bad.resize(len, 0);
            fs::write(&path, &bad).unwrap();
            for result in [verify(&store, STAGE).map(drop), read_all(&store).map(drop)] {
                match result {
                    Err(StoreError::Corrupt { file, .. }) => assert_eq!(file, path, "{len}"),
                    other => panic!("{name} with {len} bytes: {other:?}"),
                }
            }
        }
        fs::write(&path, &contents).unwrap();
    }
}

#[test]
fn a_file_of_another_run_is_found() {
    let (dir, other) = (tempdir(), tempdir());
    let store = sealed(dir.path(), 2);
    let elsewhere = StoreDir::create(other.path()).unwrap();
    let mut id = identity();
    id.push("sky", "clear");
    StageWriter::open(&elsewhere, STAGE, 0, &id).unwrap().seal().unwrap();
    let (mine, theirs) = (files(dir.path()), files(other.path()));
    for (name, contents) in theirs {
        fs::write(dir.path().join(&name), contents).unwrap();
        let error = verify(&store, STAGE).unwrap_err();
        assert!(matches!(error, StoreError::Corrupt { .. }), "{error}");
        put_files(dir.path(), &mine);
    }
}

/// Rewrites the last extent record before the last commit, checksums and all.
fn forged(change: impl Fn(&mut JournalRecord)) -> StoreError {
    let dir = tempdir();
    let store = StoreDir::create(dir.path()).unwrap();
    let mut writer = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
    writer.append(ExtentKind::Ledger, 3, 5, &[7; 500], Codec::Zstd).unwrap();
    writer.commit().unwrap();
    drop(writer);
    let path = dir.path().join(JOURNAL);
    let mut journal = fs::read(&path).unwrap();
    let at = journal.len() - 2 * 96;
    let mut record = JournalRecord::read_from_bytes(&journal[at..at + 96]).unwrap();
    assert_eq!((record.kind, record.count), (JournalKind::Extent as u32, 5));
    change(&mut record);
    record.checksum = xxh3_64(&record.as_bytes()[..88]);
    journal[at..at + 96].copy_from_slice(record.as_bytes());
    fs::write(&path, journal).unwrap();
    let opened = StageWriter::open(&store, STAGE, 0, &identity()).map(drop);
    let read = StageReader::open_unsealed(&store, STAGE)
        .and_then(|r| r.read(r.single(ExtentKind::Ledger, 3)?, &budget(), "test").map(drop));
    let error = read.unwrap_err();
    if let Err(e) = opened {
        assert_eq!(e.to_string(), error.to_string());
    }
    error
}

#[test]
fn forged_records_are_corrupt_and_never_an_allocation() {
    type Change = Box<dyn Fn(&mut JournalRecord)>;
    let changes: Vec<(&str, Change)> = vec![
        ("cannot make", Box::new(|r| r.raw_bytes = 1 << 60)),
        ("cannot make", Box::new(|r| r.raw_bytes = u64::MAX)),
        ("disagree", Box::new(|r| r.raw_bytes = 400)),
        ("disagree", Box::new(|r| r.raw_bytes = 100_000)),
        ("cannot be", Box::new(|r| r.stored_bytes = u64::MAX)),
        ("cannot be", Box::new(|r| r.stored_bytes = 1 << 62)),
        ("commit", Box::new(|r| r.stored_bytes = 1 << 40)),
        ("cannot be", Box::new(|r| r.offset += 1)),
        ("cannot be", Box::new(|r| r.offset = u64::MAX - 63)),
        ("where the data ended", Box::new(|r| r.offset += 64)),
        ("cannot be", Box::new(|r| r.segment = 1)),
        ("unknown extent kind 99", Box::new(|r| r.extent_kind = 99)),
        ("unknown record kind 9", Box::new(|r| r.kind = 9)),
        ("unknown codec 3", Box::new(|r| r.codec = 3)),
        ("cannot make", Box::new(|r| r.codec = Codec::Raw as u32)),
        ("no section", Box::new(|r| r.codec = Codec::ZstdPlanes as u32)),
        ("consumes", Box::new(|r| r.kind = JournalKind::Consumed as u32)),
        ("commit", Box::new(|r| r.kind = JournalKind::Commit as u32)),
        ("commit", Box::new(|r| r.kind = JournalKind::Cursor as u32)),
        ("checksum", Box::new(|r| r.data_checksum[0] ^= 1)),
    ];
    for (i, (wanted, change)) in changes.iter().enumerate() {
        let error = forged(change);
        assert!(matches!(error, StoreError::Corrupt { .. }), "{i}: {error:?}");
        let text = error.to_string();
        let found = text.contains(wanted) || (*wanted == "no section" && text.contains("section"));
        assert!(found, "{i}: '{error}' should speak of '{wanted}'");
    }
}

#[test]
fn a_newer_format_is_named() {
    let dir = tempdir();
    let store = sealed(dir.path(), 1);
    let path = dir.path().join(JOURNAL);
    let mut journal = fs::read(&path).unwrap();
    let newer = FORMAT_VERSION + 1;
    journal[8..12].copy_from_slice(&newer.to_le_bytes());
    let checksum = xxh3_64(&journal[..56]).to_le_bytes();
    journal[56..64].copy_from_slice(&checksum);
    fs::write(&path, journal).unwrap();
    let error = StageReader::open(&store, STAGE).unwrap_err().to_string();
    let words = format!("format version {newer}, this program reads version {FORMAT_VERSION}");
    assert!(error.contains(&words), "{error}");
}
