//! Processes that work on one stage, each through what the others have committed.

use enf_layout::segment::{Codec, ExtentKind};
use enf_store::{Extent, Peer, PeerEvent, StageReader, StageWriter, StoreDir, StoreError};

use super::{STAGE, budget, bytes, identity, tempdir};

const KIND: ExtentKind = ExtentKind::Transit;

fn news(peer: &mut Peer) -> Vec<PeerEvent> {
    let mut list = Vec::new();
    peer.poll(|event| list.push(event)).unwrap();
    list
}

fn produced(events: &[PeerEvent]) -> Vec<Extent> {
    let extent = |e: &PeerEvent| match e {
        PeerEvent::Produced(extent) if extent.kind == KIND => Some(*extent),
        _ => None,
    };
    events.iter().filter_map(extent).collect()
}

fn live(store: &StoreDir) -> Vec<(u32, u32)> {
    let reader = StageReader::open_unsealed(store, STAGE).unwrap();
    reader.extents(KIND).iter().map(|e| (e.process, e.id)).collect()
}

#[test]
fn what_one_commits_another_reads_and_consumes() {
    let dir = tempdir();
    let store = StoreDir::create(dir.path()).unwrap();
    let mut a = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
    assert!(a.peer(1).unwrap().is_none() && a.others().unwrap().is_empty());
    let mut b = StageWriter::open(&store, STAGE, 1, &identity()).unwrap();
    assert_eq!((a.others().unwrap(), b.others().unwrap()), (vec![1], vec![0]));
    let mut from_a = b.peer(0).unwrap().unwrap();
    assert!(produced(&news(&mut from_a)).is_empty());

    let first = a.append(KIND, 7, 3, &bytes(1, 300), Codec::Raw).unwrap();
    assert!(news(&mut from_a).is_empty(), "it is not committed");
    a.cursor(KIND, 4, 99);
    a.commit().unwrap();
    let expected = [PeerEvent::Produced(first), PeerEvent::Cursor(KIND, 4, 99)];
    assert_eq!(news(&mut from_a), expected);
    assert!(news(&mut from_a).is_empty(), "it was told once");
    assert_eq!(from_a.reader().read(&first, &budget(), "test").unwrap()[..], bytes(1, 300)[..]);
    assert!(b.read(&first, &budget(), "test").is_err(), "it is in another file");

    // Consumed with what is made of it, in b's journal; a is told.
    let second = b.append(KIND, 8, 1, &bytes(2, 64), Codec::Raw).unwrap();
    b.consume(&first);
    b.consume(&first);
    from_a.sync().unwrap();
    assert_eq!(live(&store), [(0, 7)], "not before the commit");
    b.commit().unwrap();
    assert_eq!(live(&store), [(1, 8)]);
    let mut from_b = a.peer(1).unwrap().unwrap();
    let told = news(&mut from_b);
    assert_eq!(told[told.len() - 2..], [PeerEvent::Produced(second), PeerEvent::Consumed(first)]);
    a.consume(&first);
    a.commit().unwrap();
    assert_eq!(live(&store), [(1, 8)]);

    // Killed and begun again, b knows what it had consumed, and a goes on where it was.
    assert!(from_b.is_live().unwrap());
    let lost = b.append(KIND, 9, 1, b"never committed", Codec::Raw).unwrap();
    drop(b);
    assert!(!from_b.is_live().unwrap());
    let mut b = StageWriter::open(&store, STAGE, 1, &identity()).unwrap();
    assert!(b.resumed());
    b.consume(&first);
    let third = b.append(KIND, 9, 1, &bytes(3, 15), Codec::Raw).unwrap();
    assert_eq!(third.offset, lost.offset);
    b.commit().unwrap();
    assert_eq!(news(&mut from_b), [PeerEvent::Produced(third)]);
    assert_eq!(from_b.reader().read(&third, &budget(), "test").unwrap()[..], bytes(3, 15)[..]);

    drop(b);
    a.seal().unwrap();
    let reader = StageReader::open(&store, STAGE).unwrap();
    let left: Vec<_> = reader.extents(KIND).iter().map(|e| (e.process, e.id)).collect();
    assert_eq!(left, [(1, 8), (1, 9)]);
    enf_store::verify(&store, STAGE).unwrap();
}

#[test]
fn a_damaged_or_shortened_journal_of_another_is_named() {
    let dir = tempdir();
    let store = StoreDir::create(dir.path()).unwrap();
    let a = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
    let mut b = StageWriter::open(&store, STAGE, 1, &identity()).unwrap();
    for id in 0..5 {
        b.append(KIND, id, 1, &bytes(9, 100), Codec::Raw).unwrap();
        b.commit().unwrap();
    }
    let mut peer = a.peer(1).unwrap().unwrap();
    assert_eq!(produced(&news(&mut peer)).len(), 5);
    drop(b);
    let path = dir.path().join("trace.001.journal");
    let whole = std::fs::read(&path).unwrap();

    // A half-written batch is no news yet.
    let mut peer = a.peer(1).unwrap().unwrap();
    std::fs::write(&path, &whole[..whole.len() - 50]).unwrap();
    assert_eq!(produced(&news(&mut peer)).len(), 4);
    std::fs::write(&path, &whole).unwrap();
    assert_eq!(produced(&news(&mut peer)).len(), 1);

    std::fs::write(&path, &whole[..whole.len() - 400]).unwrap();
    let shorter = peer.poll(|_| ());
    assert!(matches!(shorter, Err(StoreError::Corrupt { .. })), "{shorter:?}");

    // Of other inputs.
    let elsewhere = tempdir();
    let other = StoreDir::create(elsewhere.path()).unwrap();
    let mut different = identity();
    different.push("sky", "clear");
    drop(StageWriter::open(&other, STAGE, 1, &different).unwrap());
    std::fs::copy(elsewhere.path().join("trace.001.journal"), &path).unwrap();
    let refused = a.peer(1);
    assert!(matches!(refused, Err(StoreError::Corrupt { .. })), "{refused:?}");
}
