//! What is written comes back: every codec, every size around the windows, by every way of reading.

use std::fs;
use std::os::unix::fs::MetadataExt;

use enf_layout::segment::{Codec, ExtentKind, StageKind};
use enf_store::{
    Encoder, MemoryBudget, StageReader, StageState, StageWriter, StoreDir, StoreError, encode,
    verify,
};

use crate::{STAGE, blob, budget, bytes, identity, tempdir};

const KIND: ExtentKind = ExtentKind::Photons;

#[test]
fn every_codec_and_size_comes_back_by_every_way() {
    let dir = tempdir();
    let store = StoreDir::create(dir.path().join("deep/er.enf")).unwrap();
    let mut writer = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
    let memory = MemoryBudget::new(40 << 20);
    let empty = writer.memory_bytes();
    let mib = 1 << 20;
    let sizes = [0, 1, 63, 64, 65, 5000, mib - 64, mib, mib + 1, 3 * mib + 7];
    let mut wanted = Vec::new();
    for (id, &size) in sizes.iter().enumerate() {
        let id = id as u32;
        let plain = bytes(id.into(), size);
        let planes = blob(id.into(), size / 16);
        wanted.push(plain.clone());
        writer.append(KIND, id, 1, &plain, Codec::Raw).unwrap();
        writer.append(ExtentKind::Ledger, id, 2, &plain, Codec::Zstd).unwrap();
        writer.append(ExtentKind::Map, id, 3, &planes, Codec::ZstdPlanes).unwrap();
        let encoded = encode(&planes, Codec::ZstdPlanes).unwrap();
        assert!(encoded.stored_bytes() <= encoded.raw_bytes() + 100);
        writer.append_encoded(ExtentKind::Grid, id, 4, &encoded).unwrap();
        let encoded = Encoder::new(&memory).encode(&plain, Codec::Raw).unwrap();
        writer.append_encoded(ExtentKind::Film, id, 5, &encoded).unwrap();
    }
    let check = |id: u32, kind: ExtentKind, got: &[u8]| {
        let plain = &wanted[id as usize];
        if matches!(kind, ExtentKind::Map | ExtentKind::Grid) {
            assert!(got == blob(id.into(), plain.len() / 16), "{kind:?} {id}");
        } else {
            assert!(got == plain, "{kind:?} {id}");
        }
    };
    let count = writer.extents().count();
    assert!(writer.memory_bytes() > empty);
    assert_eq!(count, 5 * sizes.len() + 1);
    for pass in ["pending", "committed"] {
        for e in writer.extents().filter(|e| e.kind != ExtentKind::Identity) {
            assert_eq!(e.offset % 64, 0);
            check(e.id, e.kind, &writer.read(e, &budget(), pass).unwrap());
        }
        writer.commit().unwrap();
    }
    let shared = writer.reader();
    let first = *writer.find(KIND, 5).next().unwrap();
    check(5, KIND, &shared.read(&first, &budget(), "other thread").unwrap());
    assert_eq!(store.stage_state(STAGE).unwrap(), StageState::Unsealed);
    writer.seal().unwrap();
    assert_eq!(memory.reserved(), 0);
    assert_eq!(store.stage_state(STAGE).unwrap(), StageState::Sealed);

    let memory = budget();
    let reader = StageReader::open(&store, STAGE).unwrap().with_budget(&memory).unwrap();
    let table = memory.reserved();
    assert!(table > 0);
    assert_eq!(*reader.identity(), identity());
    assert_eq!(store.identity(STAGE).unwrap(), Some(identity()));
    for kind in [KIND, ExtentKind::Ledger, ExtentKind::Map, ExtentKind::Grid, ExtentKind::Film] {
        assert_eq!(reader.extents(kind).len(), sizes.len());
        for (id, e) in reader.extents(kind).iter().enumerate() {
            assert_eq!(reader.single(kind, id as u32).unwrap(), e);
            reader.prefetch(e);
            let enough = MemoryBudget::new(e.read_peak_bytes());
            check(e.id, kind, &reader.read(e, &enough, "room").unwrap());
            match reader.map(e, &memory, "room") {
                Ok(mapped) => {
                    assert_eq!(e.codec, Codec::Raw);
                    assert_eq!(mapped.as_ptr() as usize % 64, 0);
                    assert!(memory.reserved() >= table + e.stored_bytes);
                    check(e.id, kind, &mapped);
                    assert_eq!(mapped.as_slice_of::<[u8; 5]>().is_ok(), mapped.len() % 5 == 0);
                }
                Err(StoreError::Malformed(_)) => assert_ne!(e.codec, Codec::Raw),
                Err(e) => panic!("{e}"),
            }
        }
    }
    assert_eq!(memory.reserved(), table);
    let missing = reader.single(ExtentKind::Scene, 0).unwrap_err();
    assert_eq!(missing.exit_code(), 4);
    let io = store.io();
    assert!(io.read_bytes > 10 << 20 && io.written_bytes > 5 << 20 && io.inflated_bytes > 10 << 20);
    let verified = verify(&store, STAGE).unwrap();
    let on_disk: u64 =
        fs::read_dir(store.path()).unwrap().map(|e| e.unwrap().metadata().unwrap().len()).sum();
    assert_eq!((verified.files, verified.bytes), (3, on_disk));
}

#[test]
fn a_read_that_does_not_fit_is_a_budget_error_and_takes_nothing() {
    let dir = tempdir();
    let store = StoreDir::create(dir.path()).unwrap();
    let mut writer = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
    let plain = bytes(1, 100_000);
    let raw = writer.append(KIND, 0, 1, &plain, Codec::Raw).unwrap();
    let packed = writer.append(KIND, 1, 1, &plain, Codec::Zstd).unwrap();
    writer.seal().unwrap();
    let reader = StageReader::open(&store, STAGE).unwrap();
    for extent in [raw, packed] {
        let small = MemoryBudget::new(99_999);
        let error = reader.read(&extent, &small, "photons of room 3").unwrap_err();
        assert_eq!(error.exit_code(), 3);
        assert!(error.to_string().starts_with("photons of room 3 needs "), "{error}");
        assert_eq!(small.reserved(), 0);
    }
    let small = MemoryBudget::new(99_999);
    assert_eq!(reader.map(&raw, &small, "photons").unwrap_err().exit_code(), 3);
    let none = MemoryBudget::new(1);
    assert_eq!(reader.with_budget(&none).unwrap_err().exit_code(), 3);
}

#[test]
fn planes_of_what_is_no_blob_are_refused() {
    let dir = tempdir();
    let store = StoreDir::create(dir.path()).unwrap();
    let mut writer = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
    let error = writer.append(KIND, 0, 1, b"no sections here", Codec::ZstdPlanes).unwrap_err();
    assert!(matches!(error, StoreError::Malformed(_)), "{error}");
    assert_eq!(writer.extents().count(), 1, "only the identity");
}

#[test]
fn a_stage_is_begun_once_finished_once_and_discarded_with_what_follows() {
    let dir = tempdir();
    let path = dir.path().join("b.enf");
    assert!(matches!(StoreDir::open(&path), Err(StoreError::Missing { .. })));
    let store = StoreDir::create(&path).unwrap();
    assert!(matches!(StageReader::open(&store, STAGE), Err(StoreError::Missing { .. })));
    assert!(matches!(StageReader::open_unsealed(&store, STAGE), Err(StoreError::Missing { .. })));
    assert!(matches!(verify(&store, STAGE), Err(StoreError::Missing { .. })));
    assert_eq!(store.stage_state(STAGE).unwrap(), StageState::Absent);
    assert_eq!(store.identity(STAGE).unwrap(), None);

    let writer = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
    assert!(!writer.resumed());
    let busy = StageWriter::open(&store, STAGE, 0, &identity()).unwrap_err();
    assert!(matches!(busy, StoreError::Busy { .. }) && busy.exit_code() == 5, "{busy}");
    assert!(matches!(store.discard_from(StageKind::Grid), Err(StoreError::Busy { .. })));
    drop(writer);
    let unfinished = StageReader::open(&store, STAGE).unwrap_err();
    assert!(matches!(unfinished, StoreError::Unfinished { .. }) && unfinished.exit_code() == 4);
    assert!(unfinished.to_string().contains("run enf-trace again"), "{unfinished}");
    let mut other = identity();
    other.push("sky", "clear");
    for process in [0, 1] {
        let different = StageWriter::open(&store, STAGE, process, &other).unwrap_err();
        assert_eq!(different.exit_code(), 2);
        assert!(different.to_string().contains("sky: nothing there, clear here"), "{different}");
    }
    assert_eq!(crate::files(&path).len(), 2, "a refusal leaves nothing behind");
    let writer = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
    assert!(writer.resumed());
    writer.seal().unwrap();
    let sealed = StageWriter::open(&store, STAGE, 0, &identity()).unwrap_err();
    assert!(matches!(sealed, StoreError::Sealed { .. }), "{sealed}");
    let different = StageWriter::open(&store, STAGE, 0, &other).unwrap_err();
    assert!(matches!(different, StoreError::Different { .. }), "{different}");

    for stage in [StageKind::Partition, StageKind::Kdtree] {
        StageWriter::open(&store, stage, 0, &identity()).unwrap().seal().unwrap();
    }
    fs::write(path.join("notes.txt"), "mine").unwrap();
    fs::write(path.join("kdtree.seal.new"), "torn").unwrap();
    store.discard_from(STAGE).unwrap();
    let left: Vec<String> = crate::files(&path).into_iter().map(|f| f.0).collect();
    let partition = ["partition.000.000.dat", "partition.000.journal", "partition.seal"];
    assert_eq!(left, [&["notes.txt"][..], &partition].concat());
    assert!(!StageWriter::open(&store, STAGE, 0, &other).unwrap().resumed());
}

#[test]
fn several_processes_write_one_stage_and_the_last_one_seals() {
    let dir = tempdir();
    let store = StoreDir::create(dir.path()).unwrap();
    let mut writers: Vec<_> =
        (0..3).map(|p| StageWriter::open(&store, STAGE, p, &identity()).unwrap()).collect();
    for (p, writer) in writers.iter_mut().enumerate() {
        for id in [7, p as u32] {
            writer.append(KIND, id, 1, &bytes(p as u64, 100 + p), Codec::Raw).unwrap();
        }
        writer.commit().unwrap();
        writer.append(KIND, 9, 1, b"never committed", Codec::Raw).unwrap();
    }
    let last = writers.pop().unwrap();
    assert!(matches!(last.seal(), Err(StoreError::Busy { .. })), "two are still at work");
    drop(writers);
    StageWriter::open(&store, STAGE, 1, &identity()).unwrap().seal().unwrap();
    assert_eq!(verify(&store, STAGE).unwrap().files, 7);
    let reader = StageReader::open(&store, STAGE).unwrap();
    let found: Vec<_> = reader.find(KIND, 7).iter().map(|e| (e.process, e.stored_bytes)).collect();
    assert_eq!(found, [(0, 100), (1, 101), (2, 102)]);
    for e in reader.extents(KIND).iter().filter(|e| e.id != 9) {
        let got = reader.read(e, &budget(), "test").unwrap();
        assert!(*got == bytes(e.process.into(), got.len()));
    }
    // Process 2 had something pending when it sealed, and committed it; the others lost theirs.
    assert_eq!(reader.find(KIND, 9).len(), 1);
    fs::remove_file(store.path().join("trace.002.journal")).unwrap();
    let error = StageReader::open(&store, STAGE).unwrap_err();
    assert!(matches!(error, StoreError::Missing { .. }), "{error}");
    assert!(error.to_string().contains("trace.002.journal"), "{error}");
}

#[test]
fn released_extents_give_their_blocks_back_and_the_rest_stays() {
    let dir = tempdir();
    let store = StoreDir::create(dir.path()).unwrap();
    let mut writer = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
    let list: Vec<_> = (0..400u32)
        .map(|i| writer.append(KIND, i, 1, &bytes(i.into(), 10_000), Codec::Raw).unwrap())
        .collect();
    writer.commit().unwrap();
    let kept = |i: usize| (100..110).contains(&i) || i == 399;
    for (i, extent) in list.iter().enumerate().filter(|e| !kept(e.0)) {
        writer.consume(extent);
        writer.consume(extent);
        if i % 50 == 0 {
            assert_eq!(writer.find(KIND, i as u32).count(), 0);
            writer.commit().unwrap();
            writer.release_consumed().unwrap();
        }
    }
    assert_eq!(writer.release_consumed().unwrap(), 0, "nothing before its commit");
    writer.commit().unwrap();
    assert!(writer.release_consumed().unwrap() > 0);
    let blocks = fs::metadata(store.path().join("trace.000.000.dat")).unwrap().blocks() * 512;
    assert!(blocks < 11 * 10_048 + 8 * 4096, "{blocks} bytes are still allocated");
    let writer = match writer.resumed() {
        false => {
            drop(writer);
            StageWriter::open(&store, STAGE, 0, &identity()).unwrap()
        }
        true => unreachable!(),
    };
    assert_eq!(writer.extents().count(), 12);
    writer.seal().unwrap();
    verify(&store, STAGE).unwrap();
    let reader = StageReader::open(&store, STAGE).unwrap();
    for e in reader.extents(KIND) {
        assert!(*reader.read(e, &budget(), "test").unwrap() == bytes(e.id.into(), 10_000));
    }
}

#[test]
fn an_extent_of_another_stage_is_not_looked_up() {
    let dir = tempdir();
    let store = StoreDir::create(dir.path()).unwrap();
    let mut grid = StageWriter::open(&store, StageKind::Grid, 0, &identity()).unwrap();
    let foreign = grid.append(ExtentKind::Grid, 0, 1, b"grid", Codec::Raw).unwrap();
    let mut writer = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
    writer.append(KIND, 0, 1, b"photons", Codec::Raw).unwrap();
    assert!(matches!(writer.read(&foreign, &budget(), "x"), Err(StoreError::Malformed(_))));
    writer.consume(&foreign);
    assert_eq!(writer.extents().count(), 2);
    writer.seal().unwrap();
    let reader = StageReader::open(&store, STAGE).unwrap();
    assert!(matches!(reader.read(&foreign, &budget(), "x"), Err(StoreError::Malformed(_))));
}

#[test]
fn an_unsealed_stage_shows_its_last_commit_while_it_is_written() {
    let dir = tempdir();
    let store = StoreDir::create(dir.path()).unwrap();
    let mut writer = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
    let first = writer.append(KIND, 0, 1, b"first", Codec::Raw).unwrap();
    writer.cursor(KIND, 4, 44);
    writer.commit().unwrap();
    writer.append(KIND, 1, 1, b"second", Codec::Raw).unwrap();
    writer.consume(&first);
    writer.cursor(KIND, 4, 45);
    writer.flush().unwrap();
    let reader = StageReader::open_unsealed(&store, STAGE).unwrap();
    assert_eq!(reader.extents(KIND), [first]);
    assert_eq!(reader.cursors().collect::<Vec<_>>(), [(KIND, 4, 44)]);
    assert_eq!(&*reader.read(&first, &budget(), "x").unwrap(), b"first");
    assert!(matches!(reader.map(&first, &budget(), "x"), Err(StoreError::Unfinished { .. })));
    assert!(matches!(reader.single(KIND, 1), Err(StoreError::Unfinished { .. })));
}
