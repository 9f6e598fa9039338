//! Several processes that trace one store.
//!
//! Each process owns some tiles: it alone emits there, and takes up what waits there. What it parks at the tiles of others lies in its own
//! log, where they find it once it is committed; that they have consumed it stands in theirs. So nobody writes into
//! another's files, nobody waits for a lock, and a process that is killed is missed only by those who run out of work.
//!
//! The trace has ended when nothing is in transit in what all have committed, and all emission is done. It does not matter that the journals are
//! read one after the other: a photon that flies or waits somewhere always has an ancestor that was committed and is not yet consumed.

use std::collections::{BTreeMap, BTreeSet};
use std::str::FromStr;
use std::time::{Duration, Instant};

use enf_layout::segment::ExtentKind;
use enf_store::{Buffer, Extent, MemoryBudget, Peer, PeerEvent, StageWriter, StoreError};

/// `--share I/N`: which of the processes that trace a store this one is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Share {
    /// This one, from 0.
    pub process: u32,
    /// All of them.
    pub of: u32,
}

impl Default for Share {
    fn default() -> Self {
        Self { process: 0, of: 1 }
    }
}

impl Share {
    /// Whether the process owns a tile. Neighbouring tiles go round, so that each gets of everything.
    pub fn owns(&self, tile: u32) -> bool {
        tile % self.of == self.process
    }

    /// What this process waits for that has nothing to do: the owner of the tile where light is `late`, or those who took
    /// photons up. `running` are the other processes at work.
    pub(crate) fn waits_for(&self, late: Option<u32>, running: &[u32]) -> String {
        let of = self.of;
        let missing: Vec<String> = (0..of)
            .filter(|i| *i != self.process && !running.contains(i))
            .map(|i| format!("--share {i}/{of}"))
            .collect();
        let mut text = match late {
            Some(tile) => format!("waiting for --share {}/{of}", tile % of),
            None => "waiting for photons that other processes have taken up".into(),
        };
        if !missing.is_empty() {
            text += &format!("; running: {}", self.process);
            running.iter().for_each(|i| text += &format!(", {i}"));
            text += &format!("; not running: {}", missing.join(", "));
        }
        text
    }
}

impl FromStr for Share {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers =
            text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match numbers {
            Some((process, of)) if process < of && of <= 1000 => Ok(Self { process, of }),
            _ => Err("I/N is wanted, with I from 0 to N - 1 and N up to 1000, such as 0/2 and 1/2"
                .into()),
        }
    }
}

/// What others have committed, as far as it concerns this process.
#[derive(Default)]
pub(crate) struct News {
    /// Photons that wait at own tiles.
    pub(crate) waiting: Vec<Extent>,
    /// Own extents that were consumed.
    pub(crate) consumed: Vec<Extent>,
    /// How far emission is at which tile.
    pub(crate) cursors: Vec<(u32, u64)>,
}

/// The other processes of a trace, those of earlier runs included.
pub(crate) struct Others {
    share: Share,
    peers: Vec<Peer>,
    /// Photons in transit that others have written, as (process, offset), and nobody is known to have consumed.
    open: BTreeSet<(u32, u64)>,
    /// Consumed, and not yet known to have been written.
    early: BTreeSet<(u32, u64)>,
    /// Among how many each process last said that it shares the trace.
    shares: BTreeMap<u32, u64>,
    /// Since when one that is alive says something else than this one.
    at_odds: Option<Instant>,
    polled_at: Option<Instant>,
}

/// Journals of others are looked at about this often.
pub(crate) const POLL_EVERY: Duration = Duration::from_millis(200);
/// Who is waited for is said this often.
pub(crate) const SAY_EVERY: Duration = Duration::from_secs(10);
/// Who begins may wait so long for others to share the trace alike; who is at work waits longer.
pub(crate) const FIRST_PATIENCE: Duration = Duration::from_secs(2);
const PATIENCE: Duration = Duration::from_secs(6);

impl Others {
    pub(crate) fn new(share: Share) -> Self {
        Self {
            share,
            peers: Vec::new(),
            open: BTreeSet::new(),
            early: BTreeSet::new(),
            shares: BTreeMap::new(),
            at_odds: None,
            polled_at: None,
        }
    }

    /// Whether there are any, or will be.
    pub(crate) fn any(&self) -> bool {
        self.share.of > 1 || !self.peers.is_empty()
    }

    /// Whether it is time to look again.
    pub(crate) fn due(&self) -> bool {
        self.share.of > 1 && self.polled_at.is_none_or(|at| at.elapsed() >= POLL_EVERY)
    }

    /// Those that have committed something.
    pub(crate) fn peers(&self) -> &[Peer] {
        &self.peers
    }

    /// Reads what was committed since the last time.
    ///
    /// # Errors
    /// [`StoreError::Busy`] when a process has been at work for some time that shares the trace in another way; a damaged journal.
    pub(crate) fn poll(&mut self, writer: &StageWriter) -> Result<News, StoreError> {
        for process in writer.others()? {
            if self.peers.iter().all(|p| p.process() != process) {
                self.peers.extend(writer.peer(process)?);
            }
        }
        self.peers.sort_unstable_by_key(Peer::process);
        let mut news = News::default();
        let mut produced = Vec::new();
        let Self { share, peers, open, early, shares, polled_at, .. } = self;
        *polled_at = Some(Instant::now());
        for peer in peers {
            let me = peer.process();
            peer.poll(|event| match event {
                PeerEvent::Produced(extent) if extent.kind == ExtentKind::Transit => {
                    let key = (extent.process, extent.offset);
                    if !early.remove(&key) && !writer.has_consumed(&extent) {
                        open.insert(key);
                        if share.owns(extent.id) {
                            produced.push(extent);
                        }
                    }
                }
                PeerEvent::Consumed(extent) if extent.kind == ExtentKind::Transit => {
                    let key = (extent.process, extent.offset);
                    if extent.process == writer.process() {
                        news.consumed.push(extent);
                    } else if !open.remove(&key) && extent.process != me {
                        // Of a third process, which has yet to be read so far; or which has written down meanwhile that it is gone.
                        early.insert(key);
                    }
                }
                PeerEvent::Cursor(ExtentKind::Transit, tile, value) => {
                    news.cursors.push((tile, value))
                }
                PeerEvent::Cursor(ExtentKind::Identity, _, of) => {
                    shares.insert(me, of);
                }
                _ => {}
            })?;
        }
        // What an earlier run of another share has consumed may have come to light after it.
        produced.retain(|e| open.contains(&(e.process, e.offset)));
        news.waiting = produced;
        self.agree(PATIENCE)?;
        Ok(news)
    }

    /// Whether all who are alive share the trace alike. One that has just begun may not have said so yet, or may be about to be refused: it has
    /// some time for that.
    ///
    /// # Errors
    /// [`StoreError::Busy`] after that time.
    pub(crate) fn agree(&mut self, patience: Duration) -> Result<bool, StoreError> {
        for peer in &self.peers {
            let says = self.shares.get(&peer.process());
            if says != Some(&u64::from(self.share.of)) && peer.is_live()? {
                if self.at_odds.get_or_insert_with(Instant::now).elapsed() > patience {
                    return Err(StoreError::Busy { path: peer.path().to_path_buf() });
                }
                return Ok(false);
            }
        }
        self.at_odds = None;
        Ok(true)
    }

    /// This process has consumed an extent.
    pub(crate) fn consumed(&mut self, extent: &Extent) {
        self.open.remove(&(extent.process, extent.offset));
    }

    /// Whether photons that others have written wait somewhere.
    pub(crate) fn in_transit(&self) -> bool {
        !self.open.is_empty()
    }

    /// An extent of another process.
    pub(crate) fn read(
        &self,
        extent: &Extent,
        budget: &MemoryBudget,
        what: &'static str,
    ) -> Option<Result<Buffer, StoreError>> {
        let peer = self.peers.iter().find(|p| p.process() == extent.process)?;
        Some(peer.reader().read(extent, budget, what))
    }

    /// Makes durable what has been read of others; before a commit that builds on it.
    pub(crate) fn sync(&mut self) -> Result<(), StoreError> {
        self.peers.iter_mut().try_for_each(Peer::sync)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_is_missing_is_named() {
        let share: Share = "1/3".parse().unwrap();
        assert_eq!(share.waits_for(Some(6), &[0, 2]), "waiting for --share 0/3");
        assert_eq!(
            share.waits_for(Some(5), &[0]),
            "waiting for --share 2/3; running: 1, 0; not running: --share 2/3"
        );
        let taken = share.waits_for(None, &[]);
        assert!(taken.ends_with("running: 1; not running: --share 0/3, --share 2/3"), "{taken}");
    }

    #[test]
    fn every_tile_has_one_owner() {
        for of in 1..5 {
            for tile in 0..20 {
                let owners = (0..of).filter(|&process| Share { process, of }.owns(tile)).count();
                assert_eq!(owners, 1);
            }
        }
    }

    #[test]
    fn a_share_is_spelt_with_a_slash() {
        assert_eq!("1/2".parse(), Ok(Share { process: 1, of: 2 }));
        assert_eq!("0/1".parse(), Ok(Share::default()));
        for bad in ["2/2", "0/0", "1", "a/2", "-1/2", "0/1001", "1/2/3", ""] {
            assert!(bad.parse::<Share>().is_err(), "{bad}");
        }
    }
}
