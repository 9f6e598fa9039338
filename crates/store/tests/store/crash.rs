//! A kill at any moment: what the last commit left is there, nothing else is, and going on from there
//! ends in the same files, to the byte.

use std::fs;

use enf_store::{StageWriter, StoreDir, StoreError};
use proptest::prelude::*;

use crate::{STAGE, Shown, epoch, files, identity, put_files, sealed, shown, tempdir};

const EPOCHS: u32 = 8;
const DATA: &str = "trace.000.000.dat";
const JOURNAL: &str = "trace.000.journal";

struct Run {
    /// After each commit, the identity's included: file lengths and what the writer shows.
    commits: Vec<(u64, u64, Shown)>,
    data: Vec<u8>,
    journal: Vec<u8>,
    /// All files of the finished, uninterrupted run.
    finished: Vec<(String, Vec<u8>)>,
}

fn run() -> &'static Run {
    static RUN: std::sync::OnceLock<Run> = std::sync::OnceLock::new();
    RUN.get_or_init(|| {
        let dir = tempdir();
        let store = StoreDir::create(dir.path()).unwrap();
        let mut writer = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
        let len = |name| fs::metadata(dir.path().join(name)).unwrap().len();
        let mut commits = vec![(len(DATA), len(JOURNAL), shown(&writer))];
        for n in 0..EPOCHS {
            epoch(&mut writer, n);
            let before = shown(&writer);
            writer.commit().unwrap();
            writer.commit().unwrap();
            assert_eq!(shown(&writer), before, "a commit changes nothing that is shown");
            commits.push((len(DATA), len(JOURNAL), before));
        }
        drop(writer);
        let read = |name| fs::read(dir.path().join(name)).unwrap();
        let (data, journal) = (read(DATA), read(JOURNAL));
        let whole = tempdir();
        sealed(whole.path(), EPOCHS);
        Run { commits, data, journal, finished: files(whole.path()) }
    })
}

/// Opens what a crash left, compares it with commit `at`, and goes on to the end.
fn resumes_at(data: &[u8], journal: &[u8], at: Option<usize>) {
    let run = run();
    let dir = tempdir();
    put_files(dir.path(), &[(DATA.into(), data.into()), (JOURNAL.into(), journal.into())]);
    fs::write(dir.path().join("trace.seal.new"), b"half a seal").unwrap();
    let store = StoreDir::open(dir.path()).unwrap();
    let mut writer = StageWriter::open(&store, STAGE, 0, &identity()).unwrap();
    assert_eq!(writer.resumed(), at.is_some());
    let at = at.unwrap_or(0);
    assert_eq!(shown(&writer), run.commits[at].2);
    for n in at as u32..EPOCHS {
        epoch(&mut writer, n);
        writer.commit().unwrap();
    }
    writer.seal().unwrap();
    assert!(files(dir.path()) == run.finished, "the finished files differ");
}

/// The last commit that fits in a journal of this length.
fn last_commit(journal: u64) -> Option<usize> {
    run().commits.iter().rposition(|c| c.1 <= journal)
}

#[test]
fn every_cut_of_the_journal_resumes() {
    let run = run();
    // All lengths around the ends of records, and some within them.
    let telling = |len: &usize| matches!((len + 32) % 96, 0 | 1 | 2 | 47 | 94 | 95);
    for len in (0..=run.journal.len()).filter(telling) {
        resumes_at(&run.data, &run.journal[..len], last_commit(len as u64));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Torn anywhere: bytes missing, and bytes that reached the disk as garbage.
    #[test]
    fn torn_tails_resume(
        journal_len in 0usize..4000,
        data_extra in 0usize..3000,
        data_garbage in proptest::collection::vec(any::<u8>(), 0..200),
        journal_garbage in proptest::collection::vec(any::<u8>(), 0..300),
    ) {
        let run = run();
        let len = journal_len % (run.journal.len() + 1);
        let at = last_commit(len as u64);
        let data_end = at.map_or(0, |at| run.commits[at].0 as usize);
        let mut data = run.data[..(data_end + data_extra).min(run.data.len())].to_vec();
        data.extend_from_slice(&data_garbage);
        let mut journal = run.journal[..len].to_vec();
        if len >= 64 + 2 * 96 || journal_garbage.len() + len <= 64 + 2 * 96 {
            journal.extend_from_slice(&journal_garbage);
        }
        resumes_at(&data, &journal, at);
    }

    /// The pages of the last batch may reach the disk in any order.
    #[test]
    fn a_batch_whose_beginning_never_arrived_is_torn(at in 2usize..9, holes in 1usize..4) {
        let run = run();
        let (from, to) = (run.commits[at - 1].1 as usize, run.commits[at].1 as usize);
        let mut journal = run.journal[..to].to_vec();
        let n = (holes * 96).min(to - from);
        journal[from..from + n].fill(0);
        resumes_at(&run.data, &journal, Some(at - 1));
    }
}

#[test]
fn data_that_was_synced_and_is_gone_is_corrupt() {
    let run = run();
    let dir = tempdir();
    for (len, _, _) in &run.commits {
        let data = &run.data[..*len as usize - 1];
        put_files(dir.path(), &[(DATA.into(), data.into()), (JOURNAL.into(), run.journal.clone())]);
        let store = StoreDir::open(dir.path()).unwrap();
        match StageWriter::open(&store, STAGE, 0, &identity()) {
            Err(StoreError::Corrupt { file, offset, .. }) => {
                assert!(file.ends_with(DATA));
                // The identity itself is cut in the first case, and noticed earlier.
                assert!(offset == len - 1, "{offset} of {len}");
            }
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_flipped_bit_in_an_unsealed_journal_is_found_or_harmless() {
    let run = run();
    let dir = tempdir();
    let before_last = run.commits[EPOCHS as usize - 1].1 as usize;
    put_files(dir.path(), &[(DATA.into(), run.data.clone())]);
    for at in 0..run.journal.len() {
        let mut journal = run.journal.clone();
        journal[at] ^= 1 << (at % 8);
        fs::write(dir.path().join(JOURNAL), &journal).unwrap();
        fs::write(dir.path().join(DATA), &run.data).unwrap();
        let store = StoreDir::open(dir.path()).unwrap();
        match StageWriter::open(&store, STAGE, 0, &identity()) {
            Err(StoreError::Corrupt { file, offset, .. }) => {
                assert!(file.ends_with(JOURNAL));
                assert!(offset as usize <= at);
                assert!(at < before_last);
            }
            Ok(writer) => {
                assert!(at >= before_last, "byte {at} was not noticed");
                assert_eq!(shown(&writer), run.commits[EPOCHS as usize - 1].2);
            }
            Err(e) => panic!("{e}"),
        }
    }
}

#[test]
fn a_sealed_stage_is_never_opened_for_writing() {
    let dir = tempdir();
    let store = sealed(dir.path(), 3);
    let before = files(dir.path());
    for process in [0, 1] {
        let refused = StageWriter::open(&store, STAGE, process, &identity());
        assert!(matches!(refused, Err(StoreError::Sealed { .. })));
    }
    assert!(files(dir.path()) == before);
}
