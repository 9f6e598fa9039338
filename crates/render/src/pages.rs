//! Photon maps that are larger than the budget: pieces come and go.
//!
//! A large room's map lies in the store in pieces, each a part of the room ([`enf_illumination::photon_map::divide`]). Where not all of them fit
//! in memory, a job holds as many as its share allows. A ray's point is asked for before anything is added to the picture; if that needs
//! a piece that is not there, the ray waits until it is, and when there is no room left for another, until the job has gone through all others and begins again
//! with an empty share. An estimate is made when all that it needs is there, hence it is the same as from the whole map.

use std::cell::{Cell, OnceCell, RefCell};

use enf_illumination::{IrradianceCache, Outline, PhotonMap, Places};
use enf_layout::photon::PhotonRecord;
use enf_layout::sections::Malformed;
use enf_layout::transit::TransitRecord;
use enf_store::{BudgetError, Extent, Mapped, MemoryBudget, Reservation, StageReader, StoreError};
use parking_lot::{Condvar, Mutex};

/// A mapped extent takes whole pages.
const PAGES: u64 = 8 << 10;
/// Pieces that a share has room for, at least: as many as may meet at a point.
const AT_LEAST: u64 = 8;

/// Bytes of a piece while it is in memory.
fn bytes_of(piece: &Extent) -> u64 {
    piece.raw_bytes + PAGES
}

/// How a room's map is kept in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Plan {
    /// All of it, so many bytes.
    Whole(u64),
    /// As many shares of so many bytes: each for one job.
    Shares(u64, u64),
}

impl Plan {
    /// For a map of these pieces, of which `most` bytes may be in memory, and jobs of so many threads.
    pub(crate) fn of(pieces: &[Extent], most: u64, threads: u64) -> Self {
        let all: u64 = pieces.iter().map(bytes_of).sum();
        if all <= most || pieces.len() < 2 {
            return Self::Whole(all);
        }
        let largest = pieces.iter().map(bytes_of).max().unwrap_or(0);
        let least = largest * AT_LEAST.min(pieces.len() as u64);
        let shares = (most / least.max(1)).clamp(1, threads.max(1));
        Self::Shares(shares, (most / shares).max(least))
    }

    /// All bytes.
    pub(crate) fn bytes(self) -> u64 {
        match self {
            Self::Whole(bytes) => bytes,
            Self::Shares(shares, bytes) => shares * bytes,
        }
    }
}

/// The pieces of a map that is not in memory as a whole.
pub(crate) struct Pages {
    pieces: Vec<Extent>,
    outlines: Vec<Outline>,
    /// Bytes of a share.
    share: u64,
    /// The budget of which all shares are a part.
    budget: MemoryBudget,
    /// All shares together: already reserved, as a budget of its own.
    purse: MemoryBudget,
    _reservation: Reservation,
    /// Shares that no job has, with what they hold.
    shares: Mutex<Vec<Vec<(u32, Mapped)>>>,
    returned: Condvar,
}

impl Pages {
    /// Looks at all pieces, one after the other.
    ///
    /// # Errors
    /// Pieces that are damaged; a budget without room for the shares.
    pub(crate) fn new(
        maps: &StageReader,
        pieces: &[Extent],
        shares: u64,
        share: u64,
        budget: &MemoryBudget,
    ) -> Result<Self, StoreError> {
        let reservation = budget.reserve(shares * share, "pieces of a photon map")?;
        let purse = MemoryBudget::new(shares * share);
        let mut outlines = Vec::with_capacity(pieces.len());
        for piece in pieces {
            outlines.push(Outline::of(&maps.map(piece, &purse, "piece of a photon map")?)?);
        }
        Ok(Self {
            pieces: pieces.to_vec(),
            outlines,
            share,
            budget: budget.clone(),
            purse,
            _reservation: reservation,
            shares: Mutex::new((0..shares).map(|_| Vec::new()).collect()),
            returned: Condvar::new(),
        })
    }

    /// An empty cache of irradiance at the photons.
    ///
    /// # Errors
    /// Pieces that are damaged.
    pub(crate) fn cache(&self, maps: &StageReader) -> Result<IrradianceCache, StoreError> {
        let photons = self.outlines.iter().map(Outline::photons).sum();
        let mut places = Places::of(photons);
        self.each_photon(maps, |number, photon| places.add(number, &photon))?;
        Ok(IrradianceCache::at_places(places))
    }

    /// All photons with their numbers, piece by piece.
    ///
    /// # Errors
    /// Pieces that are damaged.
    pub(crate) fn each_photon(
        &self,
        maps: &StageReader,
        mut each: impl FnMut(u32, PhotonRecord),
    ) -> Result<(), StoreError> {
        for (number, piece) in (0..).zip(&self.pieces) {
            let blob = maps.map(piece, &self.purse, "piece of a photon map")?;
            let mut map = PhotonMap::from_outlines(&self.outlines)?;
            map.bring(number, &blob)?;
            map.photons().for_each(|(number, photon)| each(number, photon));
        }
        Ok(())
    }

    /// How far the map's estimates reach, m.
    ///
    /// # Errors
    /// Pieces that are not of one map.
    pub(crate) fn radius(&self) -> Result<f32, Malformed> {
        Ok(PhotonMap::from_outlines(&self.outlines)?.radius())
    }

    /// A share for a job; waits for one.
    pub(crate) fn take_share(&self) -> Share<'_> {
        let mut shares = self.shares.lock();
        let held = loop {
            match shares.pop() {
                Some(held) => break held,
                None => self.returned.wait(&mut shares),
            }
        };
        drop(shares);
        let share = Share {
            pages: self,
            places: (0..self.pieces.len()).map(|_| OnceCell::new()).collect(),
            bytes: Cell::new(0),
        };
        for (number, piece) in held {
            share.put(number, piece);
        }
        share
    }
}

/// What a job holds of a map.
pub(crate) struct Share<'a> {
    pages: &'a Pages,
    places: Vec<OnceCell<Mapped>>,
    bytes: Cell<u64>,
}

impl Share<'_> {
    /// The map, as far as it is here.
    ///
    /// # Errors
    /// Pieces that are not of one map.
    pub(crate) fn map(&self) -> Result<PhotonMap<'_>, Malformed> {
        let mut map = PhotonMap::from_outlines(&self.pages.outlines)?;
        for (number, place) in (0..).zip(&self.places) {
            if let Some(piece) = place.get() {
                map.bring(number, piece)?;
            }
        }
        Ok(map)
    }

    /// A piece that was not here; `None` when there is no room for it.
    ///
    /// # Errors
    /// It is damaged.
    pub(crate) fn piece(
        &self,
        number: u32,
        maps: &StageReader,
    ) -> Result<Option<&[u8]>, StoreError> {
        let (Some(extent), Some(place)) =
            (self.pages.pieces.get(number as usize), self.places.get(number as usize))
        else {
            return Ok(None);
        };
        if place.get().is_none() {
            if self.bytes.get() + bytes_of(extent) > self.pages.share {
                return Ok(None);
            }
            self.put(number, maps.map(extent, &self.pages.purse, "piece of a photon map")?);
        }
        Ok(place.get().map(|piece| &piece[..]))
    }

    /// A share that does not hold what a single point needs.
    pub(crate) fn too_small(&self) -> BudgetError {
        let Pages { pieces, purse, budget, share, .. } = self.pages;
        let largest = pieces.iter().map(bytes_of).max().unwrap_or(0);
        // Each job is to have room for one piece more.
        let shares = purse.limit() / (*share).max(1);
        BudgetError {
            what: "a point where many pieces of a photon map meet",
            needed: purse.limit() + shares * largest,
            available: purse.limit(),
            limit: budget.limit(),
            holders: budget.holders(),
        }
    }

    fn put(&self, number: u32, piece: Mapped) {
        let bytes = self.pages.pieces.get(number as usize).map_or(0, bytes_of);
        if let Some(place) = self.places.get(number as usize)
            && place.set(piece).is_ok()
        {
            self.bytes.set(self.bytes.get() + bytes);
        }
    }

    /// Lets all pieces go.
    pub(crate) fn clear(&mut self) {
        self.places.iter_mut().for_each(|place| drop(place.take()));
        self.bytes.set(0);
    }
}

impl Drop for Share<'_> {
    fn drop(&mut self) {
        let held = (0..).zip(&mut self.places).filter_map(|(n, place)| Some((n, place.take()?)));
        self.pages.shares.lock().push(held.collect());
        self.pages.returned.notify_one();
    }
}

/// A job's way through a map in pieces.
pub(crate) struct Paging<'a> {
    pub(crate) share: &'a Share<'a>,
    /// A piece that some ray waits for.
    pub(crate) wanted: Cell<Option<u32>>,
    /// Whether there is room for no other piece.
    pub(crate) full: Cell<bool>,
    /// Rays whose points were answered.
    pub(crate) answered: Cell<u64>,
    /// Rays that wait for pieces for which there is no room.
    pub(crate) later: RefCell<Vec<TransitRecord>>,
}

impl<'a> Paging<'a> {
    pub(crate) fn new(share: &'a Share<'a>) -> Self {
        Self {
            share,
            wanted: Cell::new(None),
            full: Cell::new(false),
            answered: Cell::new(0),
            later: RefCell::new(Vec::new()),
        }
    }

    /// A ray waits for a piece; false if there is no room for any other, and it waits until there is.
    pub(crate) fn wait_for(&self, piece: u32, ray: TransitRecord) -> bool {
        if self.full.get() {
            self.later.borrow_mut().push(ray);
            return false;
        }
        // One at a time: what the first ray needs is not to be crowded out by what others need.
        if self.wanted.get().is_none() {
            self.wanted.set(Some(piece));
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use enf_layout::segment::{Codec, ExtentKind, StageKind};

    #[test]
    fn a_map_is_in_part_only_if_it_has_to_be() {
        let piece = |raw_bytes: u64| Extent {
            kind: ExtentKind::Map,
            id: 0,
            stage: StageKind::Kdtree,
            process: 0,
            segment: 0,
            offset: 0,
            stored_bytes: raw_bytes,
            raw_bytes,
            count: 0,
            codec: Codec::Raw,
            checksum: [0; 16],
        };
        let one = 1_000_000 - PAGES;
        let pieces = vec![piece(one); 40];
        assert_eq!(Plan::of(&pieces, 40_000_000, 2), Plan::Whole(40_000_000));
        // A share for each thread, of all that there is; fewer where that is little, and never too small a one.
        assert_eq!(Plan::of(&pieces, 39_999_998, 2), Plan::Shares(2, 19_999_999));
        assert_eq!(Plan::of(&pieces, 20_000_000, 4), Plan::Shares(2, 10_000_000));
        assert_eq!(Plan::of(&pieces, 9_000_000, 4), Plan::Shares(1, 9_000_000));
        assert_eq!(Plan::of(&pieces, 0, 4), Plan::Shares(1, AT_LEAST * 1_000_000));
        assert_eq!(Plan::of(&pieces, 0, 4).bytes(), 8_000_000);
        assert_eq!(Plan::of(&pieces[..3], 0, 4).bytes(), 3_000_000, "no more than there are");
        assert_eq!(Plan::of(&pieces[..1], 0, 4), Plan::Whole(1_000_000));
    }
}
