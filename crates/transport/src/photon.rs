//! Photon tracing in one tile (the paper, section 4.2): a photon flies, is stored where it lands, scatters,
//! and is parked when it leaves the tile.

use enf_geometry::{Hit, Query};
use enf_layout::octahedral;
use enf_layout::photon::{PHOTON_BACK_SIDE, PHOTON_CAUSTIC, PHOTON_DIRECT, PhotonRecord};
use enf_layout::rgbe;
use enf_layout::transit::{
    TRANSIT_ACROSS, TRANSIT_AIMED, TRANSIT_ALONG, TRANSIT_MIRRORED, TRANSIT_PROBE,
    TRANSIT_UNSCATTERED, TransitRecord,
};
use glam::Vec3;

use crate::flight::{self, Flight, Resident, Surface};
use crate::rng::{self, Purpose};
use crate::scatter::{self, Event};

/// Receives what photons do (the *deposit* and *cross* seams).
pub trait Sink {
    /// An impact in `room` of a photon of `light`.
    fn impact(&mut self, room: u32, light: u32, photon: PhotonRecord);
    /// The photon waits at another tile.
    fn park(&mut self, tile: u32, record: TransitRecord);
    /// A change of room in mid-flight.
    fn passage(&mut self, from: u32, to: u32, record: &TransitRecord);
    /// Flux lost at an interaction in `room` (W; negative when a survivor was re-weighted upwards).
    fn absorb(&mut self, room: u32, flux: Vec3);
    /// The path ended on a surface of `room` after `impacts` impacts.
    fn ended(&mut self, room: u32, impacts: u32);
    /// The path left the scene from `room`.
    fn escaped(&mut self, room: u32, impacts: u32, flux: Vec3);
    /// Flux left the scene from `room` with a photon that is not counted.
    fn strayed(&mut self, room: u32, flux: Vec3);
    /// A visibility probe of `light` ended on a surface of `room`.
    fn probed(&mut self, light: u32, room: u32);
    /// A photon was reflected in `room`: `reflected` W diffusely, and goes on as `event` says. The sink may send some of that flux
    /// on its own way.
    fn reflected(
        &mut self,
        _room: u32,
        _record: &TransitRecord,
        _surface: &Surface,
        _reflected: Vec3,
        _event: &Event,
    ) -> Taken {
        Taken::default()
    }
}

/// What a sink did about a reflection.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Taken {
    /// Flux that it sent on its own way, W.
    pub flux: Vec3,
    /// The photon ends here: what it would have carried is among that flux.
    pub ends: bool,
}

/// Photons that are traced together, and what is asked of them: room for the caller to keep.
#[derive(Default)]
pub struct Group {
    records: Vec<TransitRecord>,
    queries: Vec<Query>,
    hits: Vec<Option<Hit>>,
}

impl Group {
    /// How many photons are under way together: enough to keep a batch of rays busy, few enough for the caches.
    pub const SIZE: usize = 1024;
    /// Bytes of a group.
    pub const BYTES: u64 = (Self::SIZE
        * (size_of::<TransitRecord>() + size_of::<Query>() + size_of::<Option<Hit>>()))
        as u64;
}

/// Traces photons and probes until each has ended or left the tile. `next` gives one after the other; it may be asked again
/// after it had none.
pub fn trace_all<S: Sink>(
    tile: &Resident<'_>,
    seed: u64,
    group: &mut Group,
    sink: &mut S,
    mut next: impl FnMut(&mut S) -> Option<TransitRecord>,
) {
    let Group { records, queries, hits } = group;
    records.clear();
    loop {
        // Asked again after the last one: a sink may have made more meanwhile.
        while records.len() < Group::SIZE
            && let Some(record) = next(sink)
        {
            records.push(record);
        }
        if records.is_empty() {
            return;
        }
        queries.clear();
        queries.extend(records.iter().map(|record| flight::query(record, f32::INFINITY)));
        hits.clear();
        hits.resize(queries.len(), None);
        tile.structure.nearest_batch(queries, hits);
        let mut hits = hits.iter();
        records.retain_mut(|record| step(tile, seed, record, hits.next().copied().flatten(), sink));
    }
}

/// What becomes of a photon or probe whose ray meets `hit` next; false when that was the last of it here.
fn step<S: Sink>(
    tile: &Resident<'_>,
    seed: u64,
    record: &mut TransitRecord,
    hit: Option<Hit>,
    sink: &mut S,
) -> bool {
    let leaves = tile.bsp.leaves;
    let room_of = |leaf: u32| leaves[leaf as usize].room;
    let probe = record.flags & TRANSIT_PROBE != 0;
    let end = flight::follow(tile, record, f32::INFINITY, hit, |from, to| {
        let (from, to) = (room_of(from), room_of(to));
        if from != to && !probe {
            sink.passage(from, to, record);
        }
    });
    let hit = match end {
        Flight::Leaves { leaf, t } => {
            record.leaf = leaf;
            record.t = t;
            sink.park(leaves[leaf as usize].tile, *record);
            return false;
        }
        Flight::Escapes { leaf } => {
            let flux = Vec3::from(record.flux);
            if record.flags & TRANSIT_AIMED != 0 {
                sink.strayed(room_of(leaf), flux);
            } else if !probe {
                sink.escaped(room_of(leaf), record.impacts, flux);
            }
            return false;
        }
        // There is no end to reach.
        Flight::Reached => return false,
        Flight::Hit { hit, leaf } => {
            record.leaf = leaf;
            hit
        }
    };

    let direction = Vec3::from(record.direction);
    let surface = flight::surface(tile, &hit, direction);
    let material = &tile.materials[surface.material as usize];
    let lobes = scatter::lobes(material, &flight::met(tile, record, &hit, &surface));
    if probe {
        // Probes see through panes and end at anything else, in a room that sees the light.
        if lobes.transmitted.max_element() <= 0.0 {
            let room = room_of(tile.bsp.locate(surface.origin.as_dvec3()));
            sink.probed(record.light, room);
            return false;
        }
        record.t = flight::just_after(hit.t);
        record.last_triangle = hit.global;
        return true;
    }

    let flux = Vec3::from(record.flux);
    let point = surface.origin.as_dvec3();
    let u = rng::uniforms(seed, Purpose::Scatter, record.light, record.photon, record.bounce, 0);
    let (event, after) =
        scatter::scatter(&lobes, direction, surface.normal, flux, [u[0], u[1], u[2]]);
    // Mostly the photon goes on in the leaf in which it came, off a wall that bounds it.
    let onward = match event {
        Event::Diffuse(new) | Event::Mirror(new) => new,
        _ => surface.normal,
    };
    let stays = tile.bsp.keeps(record.leaf, point, onward.as_dvec3());
    let room = room_of(if stays { record.leaf } else { tile.bsp.locate(point) });
    // Within a rounding of a portal, the point that is lit may lie in the room next door: a passage, or rooms would not balance.
    let pass = |sink: &mut S, record: &TransitRecord, from: u32, to: u32| {
        if from != to {
            sink.passage(from, to, record);
        }
    };
    pass(sink, record, room_of(record.leaf), room);
    if scatter::stores_impacts(material) {
        // Below gloss, what counts is how much of the light the gloss lets through.
        let cos = -surface.normal.dot(direction);
        let admitted = lobes.coat.map_or(flux, |coat| flux * coat.admits(cos));
        sink.impact(room, record.light, stored(seed, record, &surface, admitted));
        record.impacts = record.impacts.saturating_add(1);
    }
    // What lies below gloss is no Lambertian: photons that it reflects find the openings themselves.
    let lambert = if lobes.coat.is_some() { Vec3::ZERO } else { flux * lobes.diffuse };
    let taken = sink.reflected(room, record, &surface, lambert, &event);
    let (event, after) = if taken.ends { (Event::Absorbed, Vec3::ZERO) } else { (event, after) };
    sink.absorb(room, flux - after - taken.flux);
    record.flux = after.to_array();
    record.bounce = record.bounce.wrapping_add(1);
    record.last_triangle = hit.global;
    let mut start = surface.origin;
    match event {
        Event::Absorbed => {
            if record.flags & TRANSIT_AIMED == 0 {
                sink.ended(room, record.impacts);
            }
            return false;
        }
        Event::Transmitted => {
            // The same ray goes on: origin, direction and leaf stay, t moves.
            record.t = flight::just_after(hit.t);
            pass(sink, record, room, room_of(record.leaf));
            return true;
        }
        Event::Diffuse(new) => {
            record.flags &=
                !(TRANSIT_UNSCATTERED | TRANSIT_MIRRORED | TRANSIT_ACROSS | TRANSIT_ALONG);
            record.direction = new.to_array();
        }
        Event::Mirror(new) => {
            record.flags |= TRANSIT_MIRRORED;
            record.direction = new.to_array();
        }
        Event::Refracted(new) => {
            record.flags = lobes.swung(record.flags | TRANSIT_MIRRORED, u[3]);
            record.direction = new.to_array();
            start = surface.beyond();
        }
    }
    record.origin = start.to_array();
    record.t = 0.0;
    if stays && matches!(event, Event::Diffuse(_) | Event::Mirror(_)) {
        return true;
    }
    let direction = Vec3::from(record.direction);
    record.leaf = tile.bsp.locate_towards(start.as_dvec3(), direction.as_dvec3());
    pass(sink, record, room, room_of(record.leaf));
    let next = leaves[record.leaf as usize].tile;
    if next != tile.tile {
        sink.park(next, *record);
        return false;
    }
    true
}

fn stored(
    seed: u64,
    record: &TransitRecord,
    surface: &flight::Surface,
    flux: Vec3,
) -> PhotonRecord {
    let dither =
        rng::uniforms(seed, Purpose::Dither, record.light, record.photon, record.bounce, 0);
    let mut flags = 0;
    if record.flags & TRANSIT_UNSCATTERED != 0 {
        flags |= if record.flags & TRANSIT_MIRRORED == 0 { PHOTON_DIRECT } else { PHOTON_CAUSTIC };
    }
    if !surface.front {
        flags |= PHOTON_BACK_SIDE;
    }
    PhotonRecord {
        position_bits: surface.position.to_array().map(f32::to_bits),
        flux: rgbe::encode(flux.to_array(), [dither[0], dither[1], dither[2]]),
        directions: PhotonRecord::pack_directions(
            octahedral::encode(record.direction),
            octahedral::encode(surface.normal.to_array()),
        ),
        flags,
    }
}
