//! What rooms answer with: photon maps and the lights that reach them, loaded like tiles, by loaders of their own.

use std::collections::BTreeMap;

use enf_illumination::{IrradianceCache, PhotonMap};
use enf_layout::journal::LightPairRecord;
use enf_layout::photon::PhotonRecord;
use enf_layout::sections::Malformed;
use enf_layout::segment::ExtentKind;
use enf_rooms::Bsp;
use enf_stage::Result;
use enf_stage::resident::Load;
use enf_stage::tables::Tables;
use enf_store::{MemoryBudget, StageReader, StoreError};

use crate::caustics::Caustics;
use crate::pages::{Pages, Plan};
use crate::shade::{MapMemory, RoomLight, RoomMap};
use crate::sight::Sights;
use crate::{Indirect, choice, daylight};

/// Loads rooms.
#[derive(Clone, Copy)]
pub(crate) struct RoomReader<'a> {
    pub(crate) tables: &'a Tables,
    /// For the lights that reach a room.
    pub(crate) trace: &'a StageReader,
    pub(crate) maps: &'a StageReader,
    /// Which room a light is in.
    pub(crate) bsp: &'a Bsp<'a>,
    pub(crate) budget: &'a MemoryBudget,
    pub(crate) indirect: Indirect,
    /// Bytes that what a room answers with may take; a larger map is in memory in part.
    pub(crate) most: u64,
    /// Parts of a light of the scene, at most.
    pub(crate) parts: u64,
    /// Caustic photons in the maps of rooms that have any.
    pub(crate) caustics: &'a BTreeMap<u32, u64>,
    /// Threads that ask.
    pub(crate) threads: u64,
}

impl RoomReader<'_> {
    /// Bytes of what a room answers with, at most: its lights; where a map is asked, that, as far as it is in memory, the irradiance that is
    /// kept at its photons, and its caustic photons while they are sorted out.
    pub(crate) fn bytes(&self, room: u32) -> u64 {
        if self.indirect == Indirect::None {
            return self.light_bytes(room);
        }
        let (plan, beside) = self.plan(room);
        plan.bytes() + beside
    }

    /// As [`RoomReader::bytes`], of a map with as little of it in memory as will do.
    pub(crate) fn least_bytes(&self, room: u32) -> u64 {
        if self.indirect == Indirect::None {
            return self.light_bytes(room);
        }
        let least = if self.tables.portals_of(room).is_empty() { u64::MAX } else { 0 };
        Plan::of(self.maps.find(ExtentKind::Map, room), least, 1).bytes() + self.plan(room).1
    }

    fn light_bytes(&self, room: u32) -> u64 {
        let lights = self.trace.find(ExtentKind::LightSet, room).iter().map(|e| e.count);
        choice::most(lights.sum(), self.parts) * choice::BYTES
    }

    /// Whether a room's map is too large to be in memory as a whole.
    pub(crate) fn is_in_part(&self, room: u32) -> bool {
        self.indirect != Indirect::None && matches!(self.plan(room).0, Plan::Shares(..))
    }

    /// How a room's map is kept, and the bytes of all else that the room answers with.
    fn plan(&self, room: u32) -> (Plan, u64) {
        let pieces = self.maps.find(ExtentKind::Map, room);
        let mut beside = self.light_bytes(room) + self.cache_bytes(room);
        if self.indirect == Indirect::FinalGather {
            beside += Caustics::bytes(self.caustics.get(&room).copied().unwrap_or(0));
        }
        // In a room without openings an estimate reaches as far as it must, which may be through all of the map.
        let most = match self.tables.portals_of(room).is_empty() {
            true => u64::MAX,
            false => self.most.saturating_sub(beside),
        };
        (Plan::of(pieces, most, self.threads), beside)
    }

    /// Bytes of the irradiance at a map's photons.
    fn cache_bytes(&self, room: u32) -> u64 {
        let pieces = self.maps.find(ExtentKind::Map, room);
        IrradianceCache::bytes(pieces.iter().map(|e| e.count as usize).sum())
    }

    /// Lights that reach a room, ascending, and how much of the room each lights: a factor of its importance.
    fn lights(&self, room: u32) -> std::result::Result<Vec<(u32, f32)>, StoreError> {
        let mut lights = Vec::new();
        for extent in self.trace.find(ExtentKind::LightSet, room) {
            let set = self.trace.read(extent, self.budget, "light set")?;
            let set = set.as_slice_of::<LightPairRecord>()?;
            // Of all that the light emits: lights may emit different numbers.
            let part = |p: &LightPairRecord| p.photons as f32 / p.emitted.max(1) as f32;
            let most = set.iter().map(part).fold(f32::MIN_POSITIVE, f32::max);
            // A light of which much arrives has its full importance; one that shines in through a door counts
            // less, for it is hidden from most of the room, but never less than a quarter: where it does shine it would be a
            // grain otherwise.
            lights.extend(set.iter().map(|p| {
                let share = (10.0 * part(p) / most).min(1.0);
                (p.light, 0.25 + 0.75 * share)
            }));
        }
        if lights.iter().any(|l| l.0 as usize >= self.tables.lights().len()) {
            return Err(Malformed(format!("the light set of room {room} names no light")).into());
        }
        Ok(lights)
    }
}

impl Load for RoomReader<'_> {
    type Item = RoomLight;
    const SPAN: &'static str = "load room";

    fn budget(&self) -> &MemoryBudget {
        self.budget
    }

    fn peak_bytes(&self, room: u32) -> Result<u64> {
        Ok(self.bytes(room))
    }

    fn load(&self, room: u32) -> std::result::Result<RoomLight, StoreError> {
        let mut held = self.budget.reserve(self.light_bytes(room), "lights of a room")?;
        let mut lights = self.lights(room)?;
        let sun = daylight::adapt(&mut lights, self.tables, room);
        let lights = choice::choices(&lights, self.tables);
        let sights = Sights::new(
            room,
            &lights,
            self.tables.portals_of(room),
            self.tables.pieces(),
            self.bsp,
        );
        held.resize(lights.len() as u64 * choice::BYTES)?;
        let held = Some(held);
        if self.indirect == Indirect::None {
            return Ok(RoomLight { map: None, lights, sights, sun, _reservation: held });
        }
        let pieces = self.maps.find(ExtentKind::Map, room);
        let (plan, _) = self.plan(room);
        let reservation = self.budget.reserve(self.cache_bytes(room), "irradiance at photons")?;
        let gathers = self.indirect == Indirect::FinalGather;
        let (map, cache, caustics) = match plan {
            Plan::Whole(_) => {
                let map: Vec<_> = pieces
                    .iter()
                    .map(|e| self.maps.map(e, self.budget, "photon map"))
                    .collect::<std::result::Result<_, _>>()?;
                let photons = PhotonMap::from_pieces(map.iter().map(|m| &m[..]))?;
                let cache = IrradianceCache::new(&photons);
                let look = |each: &mut dyn FnMut(PhotonRecord)| {
                    photons.photons().for_each(|(_, photon)| each(photon));
                    Ok(())
                };
                let caustics = match gathers {
                    true => Caustics::of(look, photons.radius(), self.budget)?,
                    false => None,
                };
                (MapMemory::Whole(map), cache, caustics)
            }
            Plan::Shares(shares, share) => {
                let pages = Pages::new(self.maps, pieces, shares, share, self.budget)?;
                let cache = pages.cache(self.maps)?;
                let look = |each: &mut dyn FnMut(PhotonRecord)| {
                    pages.each_photon(self.maps, |_, photon| each(photon))
                };
                let caustics = match gathers {
                    true => Caustics::of(look, pages.radius()?, self.budget)?,
                    false => None,
                };
                (MapMemory::Pages(pages), cache, caustics)
            }
        };
        let map = RoomMap { map, cache, caustics, _reservation: reservation };
        Ok(RoomLight { map: Some(map), lights, sights, sun, _reservation: held })
    }
}
