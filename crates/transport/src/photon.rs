//! Photon tracing in one tile (the paper, section 4.2): a photon flies, is stored where it lands, scatters,
//! and is parked when it leaves the tile.

use arrayvec::ArrayVec;
use enf_geometry::{Hit, Instructions, Query};
use enf_layout::photon::{PHOTON_BACK_SIDE, PHOTON_CAUSTIC, PHOTON_DIRECT, PhotonRecord};
use enf_layout::rgbe;
use enf_layout::transit::{
    TRANSIT_ACROSS, TRANSIT_AIMED, TRANSIT_ALONG, TRANSIT_MIRRORED, TRANSIT_PROBE,
    TRANSIT_UNSCATTERED, TransitRecord,
};
use enf_rooms::Cells;
use glam::Vec3;
use pulp::{Arch, Simd, WithSimd};

use crate::flight::{self, Flight, Resident, Surface};
use crate::landing::{self, Asked, LANES, Landing};
use crate::scatter::{self, Event, Lobes};

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
pub struct Group {
    records: Vec<TransitRecord>,
    queries: Vec<Query>,
    hits: Vec<Option<Hit>>,
    /// Which records go on.
    onward: Vec<bool>,
    /// Records that land in the leaf in which their rays are; and those of which that is not plain.
    landed: Vec<u32>,
    others: Vec<u32>,
    cells: Cells,
    landing: Box<Landing>,
    lobes: Vec<Lobes>,
    instructions: Instructions,
    arch: Arch,
}

impl Default for Group {
    fn default() -> Self {
        Self::with_instructions(Instructions::best())
    }
}

impl Group {
    /// A group that is traced with no more than these instructions. What is found does not depend on them.
    pub fn with_instructions(instructions: Instructions) -> Self {
        Self {
            records: Vec::new(),
            queries: Vec::new(),
            hits: Vec::new(),
            onward: Vec::new(),
            landed: Vec::new(),
            others: Vec::new(),
            cells: Cells::default(),
            landing: Box::default(),
            lobes: Vec::new(),
            instructions,
            arch: landing::arch(instructions),
        }
    }

    /// How many photons are under way together: enough to keep a batch of rays busy, few enough for the caches.
    pub const SIZE: usize = 1024;
    /// Bytes of a group.
    pub const BYTES: u64 = (Self::SIZE
        * (size_of::<TransitRecord>()
            + size_of::<Query>()
            + size_of::<Option<Hit>>()
            + size_of::<bool>()
            + 2 * size_of::<u32>())
        + size_of::<Landing>()
        + LANES * size_of::<Lobes>()) as u64
        + Cells::BYTES;
}

/// Traces photons and probes until each has ended or left the tile. `next` gives one after the other; it may be asked again
/// after it had none.
///
/// A group of photons goes through each step together: all rays, all surfaces, and so on. What becomes of a photon does not
/// depend on its company; the order in which `sink` hears of them does.
pub fn trace_all<S: Sink>(
    tile: &Resident<'_>,
    seed: u64,
    group: &mut Group,
    sink: &mut S,
    mut next: impl FnMut(&mut S) -> Option<TransitRecord>,
) {
    group.records.clear();
    group.cells.clear();
    loop {
        let (arch, instructions) = (group.arch, group.instructions);
        let Group { records, queries, hits, onward, landed, others, cells, .. } = group;
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
        tile.structure.nearest_batch_with(instructions, queries, hits);

        onward.clear();
        onward.resize(records.len(), false);
        landed.clear();
        others.clear();
        arch.dispatch(Arrive { tile, records, hits, cells, landed, others });
        for &index in others.iter() {
            let i = index as usize;
            if let Some(hit) = flies(tile, &mut records[i], hits[i], sink) {
                hits[i] = Some(hit);
                landed.push(index);
            }
        }
        for from in (0..group.landed.len()).step_by(LANES) {
            land(tile, seed, arch, group, from, sink);
        }
        let mut onward = group.onward.iter();
        group.records.retain(|_| onward.next().copied().unwrap_or(false));
    }
}

/// Parts the records that plainly land in the leaf in which they are from the others.
struct Arrive<'a, 't> {
    tile: &'a Resident<'t>,
    records: &'a [TransitRecord],
    hits: &'a [Option<Hit>],
    cells: &'a mut Cells,
    landed: &'a mut Vec<u32>,
    others: &'a mut Vec<u32>,
}

impl WithSimd for Arrive<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { tile, records, hits, cells, landed, others } = self;
        for (index, (record, hit)) in records.iter().zip(hits).enumerate() {
            let origin = Vec3::from(record.origin).as_dvec3();
            let direction = Vec3::from(record.direction).as_dvec3();
            let lands = hit.is_some_and(|hit| {
                cells.accepts(simd, tile.bsp, record.leaf, origin, direction, hit.t)
            });
            if lands { landed.push(index as u32) } else { others.push(index as u32) }
        }
    }
}

/// The flight of a photon or probe whose ray meets `hit` next: the hit, if it is reached in this tile. Otherwise, that was the last
/// of it here.
fn flies<S: Sink>(
    tile: &Resident<'_>,
    record: &mut TransitRecord,
    hit: Option<Hit>,
    sink: &mut S,
) -> Option<Hit> {
    let leaves = tile.bsp.leaves;
    let room_of = |leaf: u32| leaves[leaf as usize].room;
    let probe = record.flags & TRANSIT_PROBE != 0;
    let end = flight::follow(tile, record, f32::INFINITY, hit, |from, to| {
        let (from, to) = (room_of(from), room_of(to));
        if from != to && !probe {
            sink.passage(from, to, record);
        }
    });
    match end {
        Flight::Leaves { leaf, t } => {
            record.leaf = leaf;
            record.t = t;
            sink.park(leaves[leaf as usize].tile, *record);
            None
        }
        Flight::Escapes { leaf } => {
            let flux = Vec3::from(record.flux);
            if record.flags & TRANSIT_AIMED != 0 {
                sink.strayed(room_of(leaf), flux);
            } else if !probe {
                sink.escaped(room_of(leaf), record.impacts, flux);
            }
            None
        }
        // There is no end to reach.
        Flight::Reached => None,
        Flight::Hit { hit, leaf } => {
            record.leaf = leaf;
            Some(hit)
        }
    }
}

/// What becomes of a probe at its hit: whether it goes on. It sees through panes and ends at anything else, in a room that
/// sees the light.
fn probes<S: Sink>(
    tile: &Resident<'_>,
    record: &mut TransitRecord,
    hit: &Hit,
    sink: &mut S,
) -> bool {
    let surface = flight::surface(tile, hit, Vec3::from(record.direction));
    let material = &tile.materials[surface.material as usize];
    let lobes = scatter::lobes(material, &flight::met(tile, record, hit, &surface));
    if lobes.transmitted.max_element() <= 0.0 {
        let leaf = tile.bsp.locate(surface.origin.as_dvec3());
        sink.probed(record.light, tile.bsp.leaves[leaf as usize].room);
        return false;
    }
    record.t = flight::just_after(hit.t);
    record.last_triangle = hit.global;
    true
}

/// One photon of those that land together.
#[derive(Clone, Copy)]
struct Lane {
    /// Among the group's records.
    index: usize,
    hit: Hit,
    event: Event,
    after: Vec3,
    /// Its lobes, where it is not bare matter.
    lobes: Option<usize>,
    /// It is plain that it goes on in the leaf in which it came.
    stays: bool,
}

/// What becomes of a group's photons that have landed, from the given one on, as many as there are lanes.
fn land<S: Sink>(
    tile: &Resident<'_>,
    seed: u64,
    arch: Arch,
    group: &mut Group,
    from: usize,
    sink: &mut S,
) {
    let Group { records, hits, onward, landed, cells, landing, lobes, .. } = group;
    let mut lanes: ArrayVec<Lane, LANES> = ArrayVec::new();
    lobes.clear();
    for &index in landed[from..].iter().take(LANES) {
        let index = index as usize;
        let (record, Some(hit)) = (&mut records[index], hits[index]) else { continue };
        if record.flags & TRANSIT_PROBE != 0 {
            onward[index] = probes(tile, record, &hit, sink);
            continue;
        }
        let number = tile.structure.material(hit.slot);
        let material = &tile.materials[number as usize];
        let texel = tile.texturing.colour(material.texture, hit.global, hit.u, hit.v);
        let asked = Asked {
            corners: tile.structure.corners(hit.slot),
            u: hit.u,
            v: hit.v,
            direction: Vec3::from(record.direction),
            flux: Vec3::from(record.flux),
            diffuse: Vec3::from(material.diffuse) * texel,
            light: record.light,
            photon: record.photon,
            bounce: record.bounce,
            triangle: hit.global,
            material: number,
        };
        landing.ask(lanes.len(), &asked);
        let (event, after) = (Event::Absorbed, Vec3::ZERO);
        let special = (!scatter::is_bare(material)).then_some(usize::MAX);
        lanes.push(Lane { index, hit, event, after, lobes: special, stays: false });
    }
    landing.find(arch, seed, flight::lift(tile));
    for (i, lane) in lanes.iter_mut().enumerate() {
        let Some(special) = &mut lane.lobes else {
            (lane.event, lane.after) = landing.event(i);
            continue;
        };
        let (record, surface, u) = (&records[lane.index], landing.surface(i), landing.uniforms(i));
        let (direction, flux) = (Vec3::from(record.direction), Vec3::from(record.flux));
        let material = &tile.materials[surface.material as usize];
        let met = flight::met(tile, record, &lane.hit, &surface);
        let own = scatter::lobes(material, &met);
        (lane.event, lane.after) =
            scatter::scatter(&own, direction, surface.normal, flux, [u[0], u[1], u[2]]);
        *special = lobes.len();
        lobes.push(own);
    }
    arch.dispatch(Stay { tile, records, cells, landing, lanes: &mut lanes });
    for (i, lane) in lanes.iter().enumerate() {
        let own = lane.lobes.and_then(|place| lobes.get(place));
        onward[lane.index] = settle(tile, &mut records[lane.index], lane, own, (landing, i), sink);
    }
}

/// Finds which photons go on in the leaf in which they came.
struct Stay<'a, 't> {
    tile: &'a Resident<'t>,
    records: &'a [TransitRecord],
    cells: &'a mut Cells,
    landing: &'a Landing,
    lanes: &'a mut [Lane],
}

impl WithSimd for Stay<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { tile, records, cells, landing, lanes } = self;
        for (i, lane) in lanes.iter_mut().enumerate() {
            let surface = landing.surface(i);
            // Mostly the photon goes on off a wall that bounds its leaf.
            let onward = match lane.event {
                Event::Diffuse(new) | Event::Mirror(new) => new,
                _ => surface.normal,
            };
            let (leaf, point) = (records[lane.index].leaf, surface.origin.as_dvec3());
            lane.stays = cells.keeps(simd, tile.bsp, leaf, point, onward.as_dvec3());
        }
    }
}

/// Tells the sink of an impact, and sends the photon on: whether it does go on in this tile. `own` are its lobes where it is
/// not bare matter that it met.
fn settle<S: Sink>(
    tile: &Resident<'_>,
    record: &mut TransitRecord,
    lane: &Lane,
    own: Option<&Lobes>,
    (landing, place): (&Landing, usize),
    sink: &mut S,
) -> bool {
    let leaves = tile.bsp.leaves;
    let room_of = |leaf: u32| leaves[leaf as usize].room;
    let &Lane { hit, event, after, stays, .. } = lane;
    let surface = landing.surface(place);
    let direction = Vec3::from(record.direction);
    let flux = Vec3::from(record.flux);
    let room =
        room_of(if stays { record.leaf } else { tile.bsp.locate(surface.origin.as_dvec3()) });
    // Within a rounding of a portal, the point that is lit may lie in the room next door: a passage, or rooms would not balance.
    let pass = |sink: &mut S, record: &TransitRecord, from: u32, to: u32| {
        if from != to {
            sink.passage(from, to, record);
        }
    };
    pass(sink, record, room_of(record.leaf), room);
    let coat = own.and_then(|lobes| lobes.coat.as_ref());
    if own.is_none() || scatter::stores_impacts(&tile.materials[surface.material as usize]) {
        // Below gloss, what counts is how much of the light the gloss lets through.
        let code = coat.map_or(landing.flux_code(place), |coat| {
            let admitted = flux * coat.admits(-surface.normal.dot(direction));
            rgbe::encode(admitted.to_array(), landing.dither(place))
        });
        let [direction, normal] = landing.codes(place);
        let photon = PhotonRecord {
            position_bits: surface.position.to_array().map(f32::to_bits),
            flux: code,
            directions: PhotonRecord::pack_directions(direction, normal),
            flags: stored_flags(record.flags, surface.front),
        };
        sink.impact(room, record.light, photon);
        record.impacts = record.impacts.saturating_add(1);
    }
    // What lies below gloss is no Lambertian: photons that it reflects find the openings themselves.
    let lambert = match own {
        None => landing.weakened(place),
        Some(lobes) if lobes.coat.is_none() => flux * lobes.diffuse,
        Some(_) => Vec3::ZERO,
    };
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
            let flags = record.flags | TRANSIT_MIRRORED;
            record.flags = own.map_or(flags, |l| l.swung(flags, landing.uniforms(place)[3]));
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

fn stored_flags(transit: u16, front: bool) -> u16 {
    let mut flags = 0;
    if transit & TRANSIT_UNSCATTERED != 0 {
        flags |= if transit & TRANSIT_MIRRORED == 0 { PHOTON_DIRECT } else { PHOTON_CAUSTIC };
    }
    if !front {
        flags |= PHOTON_BACK_SIDE;
    }
    flags
}
