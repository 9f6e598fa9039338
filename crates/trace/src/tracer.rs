//! What a tracing thread does with a job: a few thousand photons in one tile, and what came of them.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use enf_layout::bsp::LeafRecord;
use enf_layout::journal::LedgerRecord;
use enf_layout::light::{
    EmitterRecord, LIGHT_AREA, LIGHT_POINT_LAMBERT, LIGHT_PROFILE, LIGHT_SKY, LIGHT_SPOT,
    LIGHT_SUN, LightRecord,
};
use enf_layout::photon::{PHOTON_DIRECT, PhotonRecord};
use enf_layout::profile::Profile;
use enf_layout::sections::Malformed;
use enf_layout::transit::{TRANSIT_AIMED, TRANSIT_PROBE, TRANSIT_UNSCATTERED, TransitRecord};
use enf_rooms::Bsp;
use enf_stage::resident::TileData;
use enf_stage::tables::Tables;
use enf_store::Buffer;
use enf_transport::emission::{self, Start};
use enf_transport::flight::{Resident, Surface};
use enf_transport::photon::{self, Sink, Taken};
use enf_transport::rng::{self, Purpose};
use enf_transport::scatter::Event;
use enf_transport::sky::Daylight;
use enf_transport::texture::{Coordinates, Texturing};
use enf_transport::vector;
use glam::Vec3;

use crate::counts::Counts;

/// Visibility probes per light, aimed at the portals of the rooms that the light is in (the paper, section 6).
pub(crate) const PROBES_PER_LIGHT: u64 = 512;

/// Records that wait at a tile: in memory, or read back from the log.
pub(crate) enum Waiting {
    Memory(Vec<TransitRecord>),
    Log(Buffer),
}

impl Waiting {
    pub(crate) fn records(&self) -> &[TransitRecord] {
        match self {
            Self::Memory(records) => records,
            // The store checked the extent's length against its count.
            Self::Log(buffer) => buffer.as_slice_of::<TransitRecord>().unwrap_or(&[]),
        }
    }
}

/// What a job is made of.
pub(crate) enum Work {
    /// Photons of `light` with these indices that start in the tile; past the photons come the probes.
    Emission { light: u32, indices: Range<u64> },
    /// Photons that came through a portal.
    Waiting { records: Arc<Waiting>, range: Range<usize> },
}

/// A piece of a visit.
pub(crate) struct Job {
    pub(crate) tile: Arc<TileData>,
    pub(crate) work: Work,
}

/// Sums of one job.
#[derive(Default)]
pub(crate) struct Tally {
    /// One line a room, in the order in which rooms came up: a job sees few of them.
    pub(crate) rooms: Vec<LedgerRecord>,
    pub(crate) passages: BTreeMap<(u32, u32), (u64, f64)>,
    /// (room, light) pairs that see each other, with the direct photons of the light that landed in the room.
    pub(crate) sees: BTreeMap<(u32, u32), u64>,
    /// Photons traced (each time one is taken up counts).
    pub(crate) traced: u64,
}

impl Tally {
    fn room(&mut self, room: u32) -> &mut LedgerRecord {
        let index = self.rooms.iter().position(|line| line.room == room).unwrap_or_else(|| {
            self.rooms.push(empty_ledger(room));
            self.rooms.len() - 1
        });
        &mut self.rooms[index]
    }
}

/// Sums of many jobs.
#[derive(Default)]
pub(crate) struct Epoch {
    pub(crate) rooms: BTreeMap<u32, LedgerRecord>,
    pub(crate) passages: BTreeMap<(u32, u32), (u64, f64)>,
    pub(crate) sees: BTreeMap<(u32, u32), u64>,
    /// Photons whose path has ended, and their flux over all channels, W.
    pub(crate) finished: u64,
    pub(crate) finished_w: f64,
    /// Flux of those that were emitted, the same.
    pub(crate) emitted_w: f64,
}

impl Epoch {
    /// Adds a line of a room's ledger.
    pub(crate) fn room(&mut self, line: &LedgerRecord) {
        let sum = self.rooms.entry(line.room).or_insert_with(|| empty_ledger(line.room));
        add_ledger(sum, line);
        self.finished += line.absorbed + line.escaped;
        self.finished_w += line.absorbed_w.iter().chain(&line.escaped_w).sum::<f64>();
        self.emitted_w += line.emitted_w.iter().sum::<f64>();
    }

    /// Adds a job's.
    pub(crate) fn add(&mut self, job: &Tally) {
        for line in &job.rooms {
            self.room(line);
        }
        for (&pair, &(photons, flux)) in &job.passages {
            let entry = self.passages.entry(pair).or_default();
            entry.0 += photons;
            entry.1 += flux;
        }
        for (&pair, &photons) in &job.sees {
            *self.sees.entry(pair).or_default() += photons;
        }
    }
}

/// A ledger line in which nothing has happened.
pub(crate) fn empty_ledger(room: u32) -> LedgerRecord {
    LedgerRecord { room, reflections_min: u64::MAX, ..LedgerRecord::default() }
}

/// Adds `more` to `sum`.
pub fn add_ledger(sum: &mut LedgerRecord, more: &LedgerRecord) {
    sum.emitted += more.emitted;
    sum.absorbed += more.absorbed;
    sum.escaped += more.escaped;
    sum.stored += more.stored;
    for c in 0..3 {
        sum.emitted_w[c] += more.emitted_w[c];
        sum.absorbed_w[c] += more.absorbed_w[c];
        sum.escaped_w[c] += more.escaped_w[c];
    }
    sum.reflections_sum += more.reflections_sum;
    sum.reflections_min = sum.reflections_min.min(more.reflections_min);
    sum.reflections_max = sum.reflections_max.max(more.reflections_max);
}

/// What a job produced, in blocks per destination.
#[derive(Default)]
pub(crate) struct Products {
    pub(crate) impacts: Vec<(u32, Vec<PhotonRecord>)>,
    pub(crate) parked: Vec<(u32, Vec<TransitRecord>)>,
    pub(crate) tally: Tally,
    /// Bytes of all records.
    bytes: u64,
}

impl Products {
    /// Photons of the sky and of white rooms come to much; a job sends its products in parts of so many bytes. Most jobs have one part.
    const PART_BYTES: u64 = 512 << 10;
    /// What a part takes at most: vectors double.
    pub(crate) const MOST_BYTES: u64 = 2 * Self::PART_BYTES;
}

fn lane<T>(lanes: &mut Vec<(u32, Vec<T>)>, id: u32) -> &mut Vec<T> {
    // Few destinations, the last one most likely: look from the end.
    let index = match lanes.iter().rposition(|lane| lane.0 == id) {
        Some(index) => index,
        None => {
            lanes.push((id, Vec::new()));
            lanes.len() - 1
        }
    };
    &mut lanes[index].1
}

fn add3(sum: &mut [f64; 3], flux: Vec3) {
    for (s, f) in sum.iter_mut().zip(flux.to_array()) {
        *s += f64::from(f);
    }
}

impl Sink for Products {
    fn impact(&mut self, room: u32, light: u32, photon: PhotonRecord) {
        if photon.flags & PHOTON_DIRECT != 0 {
            *self.tally.sees.entry((room, light)).or_default() += 1;
        }
        self.tally.room(room).stored += 1;
        self.bytes += size_of::<PhotonRecord>() as u64;
        lane(&mut self.impacts, room).push(photon);
    }

    fn park(&mut self, tile: u32, record: TransitRecord) {
        self.bytes += size_of::<TransitRecord>() as u64;
        lane(&mut self.parked, tile).push(record);
    }

    fn passage(&mut self, from: u32, to: u32, record: &TransitRecord) {
        let entry = self.tally.passages.entry((from, to)).or_default();
        // Aimed photons are in no count: what enters a room as a photon ends there as one, or leaves.
        entry.0 += u64::from(record.flags & TRANSIT_AIMED == 0);
        entry.1 += f64::from(vector::luminance(Vec3::from(record.flux)));
    }

    fn absorb(&mut self, room: u32, flux: Vec3) {
        add3(&mut self.tally.room(room).absorbed_w, flux);
    }

    fn ended(&mut self, room: u32, impacts: u32) {
        let ledger = self.tally.room(room);
        ledger.absorbed += 1;
        reflections(ledger, impacts);
    }

    fn escaped(&mut self, room: u32, impacts: u32, flux: Vec3) {
        let ledger = self.tally.room(room);
        ledger.escaped += 1;
        add3(&mut ledger.escaped_w, flux);
        reflections(ledger, impacts);
    }

    fn strayed(&mut self, room: u32, flux: Vec3) {
        add3(&mut self.tally.room(room).escaped_w, flux);
    }

    fn probed(&mut self, light: u32, room: u32) {
        self.tally.sees.entry((room, light)).or_default();
    }
}

/// The products of a job, and photons of the sky that are aimed at windows where they are reflected outside.
struct Aiming<'a, 'b> {
    context: &'a Context<'b>,
    tile: u32,
    products: Products,
    /// Takes a part of the products.
    send: &'a dyn Fn(Products),
    /// Photons that were aimed and start in this tile.
    aimed: Vec<TransitRecord>,
    /// Where the last photon started: the next one is likely to start there as well.
    near: u32,
}

impl Aiming<'_, '_> {
    #[inline]
    fn send_if_full(&mut self) {
        if self.products.bytes >= Products::PART_BYTES {
            (self.send)(std::mem::take(&mut self.products));
        }
    }
}

impl Sink for Aiming<'_, '_> {
    fn impact(&mut self, room: u32, light: u32, photon: PhotonRecord) {
        self.products.impact(room, light, photon);
        self.send_if_full();
    }

    fn park(&mut self, tile: u32, record: TransitRecord) {
        self.products.park(tile, record);
        self.send_if_full();
    }

    fn passage(&mut self, from: u32, to: u32, record: &TransitRecord) {
        self.products.passage(from, to, record);
    }

    fn absorb(&mut self, room: u32, flux: Vec3) {
        self.products.absorb(room, flux);
    }

    fn ended(&mut self, room: u32, impacts: u32) {
        self.products.ended(room, impacts);
    }

    fn escaped(&mut self, room: u32, impacts: u32, flux: Vec3) {
        self.products.escaped(room, impacts, flux);
    }

    fn strayed(&mut self, room: u32, flux: Vec3) {
        self.products.strayed(room, flux);
    }

    fn probed(&mut self, light: u32, room: u32) {
        self.products.probed(light, room);
    }

    fn reflected(
        &mut self,
        room: u32,
        record: &TransitRecord,
        surface: &Surface,
        reflected: Vec3,
        event: &Event,
    ) -> Taken {
        let (context, mut taken) = (self.context, Taken::default());
        let Some(daylight) = &context.daylight else { return taken };
        if room != context.tables.scene.outside
            || record.flags & TRANSIT_AIMED != 0
            || reflected == Vec3::ZERO
            || !context
                .tables
                .lights()
                .get(record.light as usize)
                .is_some_and(Daylight::is_everywhere)
        {
            return taken;
        }
        let key = (record.light, record.photon, record.bounce);
        let count = context.counts.of(record.light);
        daylight.aim(context.seed, key, surface, reflected, count, |direction, flux, photon| {
            taken.flux += flux;
            let leaf = context.bsp.locate_towards(surface.origin.as_dvec3(), direction.as_dvec3());
            let aimed = TransitRecord {
                origin: surface.origin.to_array(),
                direction: direction.to_array(),
                flux: flux.to_array(),
                t: 0.0,
                leaf,
                light: record.light,
                photon,
                bounce: record.bounce.wrapping_add(1),
                flags: TRANSIT_AIMED,
                last_triangle: surface.triangle,
                impacts: 0,
            };
            let tile = context.leaf(leaf).tile;
            if tile == self.tile {
                self.aimed.push(aimed);
            } else {
                self.park(tile, aimed);
            }
        });
        if let Event::Diffuse(direction) = event {
            taken.ends = daylight.is_aimed(surface.origin, *direction);
        }
        taken
    }
}

fn reflections(ledger: &mut LedgerRecord, impacts: u32) {
    let impacts = u64::from(impacts);
    ledger.reflections_sum += impacts;
    ledger.reflections_min = ledger.reflections_min.min(impacts);
    ledger.reflections_max = ledger.reflections_max.max(impacts);
}

/// A light as those who send off its photons need it.
struct Source<'a> {
    id: u32,
    light: &'a LightRecord,
    emitters: &'a [EmitterRecord],
    profile: Option<Profile<'a>>,
    /// How many photons it sends off.
    count: u64,
}

impl<'a> Source<'a> {
    fn new(context: &'a Context<'_>, id: u32) -> Self {
        let tables = context.tables;
        let light = &tables.lights()[id as usize];
        let (emitters, profile) = (tables.emitters_of(light), tables.profile_of(light));
        Self { id, light, emitters, profile, count: context.counts.of(id) }
    }
}

/// What every job needs to know.
pub(crate) struct Context<'a> {
    pub(crate) tables: &'a Tables,
    pub(crate) bsp: Bsp<'a>,
    pub(crate) seed: u64,
    pub(crate) counts: Arc<Counts>,
    pub(crate) daylight: Option<Daylight>,
}

impl Context<'_> {
    /// Runs one job. What comes of it is returned, but for parts of it that are sent on the way.
    pub(crate) fn run(
        &self,
        job: &Job,
        group: &mut photon::Group,
        send: &dyn Fn(Products),
    ) -> Result<Products, Malformed> {
        let structure = job.tile.structure()?;
        let texturing = Texturing {
            textures: self.tables.textures(),
            texels: self.tables.texels(),
            coordinates: Coordinates::from_blob(job.tile.coordinates())?,
        };
        let tile = Resident {
            tile: job.tile.tile,
            bsp: &self.bsp,
            structure: &structure,
            materials: self.tables.materials(),
            texturing,
            delta: self.tables.scene.delta,
        };
        let mut sink = Aiming {
            context: self,
            tile: tile.tile,
            products: Products::default(),
            send,
            aimed: Vec::new(),
            near: 0,
        };
        match &job.work {
            Work::Waiting { records, range } => {
                let mut waiting = records.records()[range.clone()].iter();
                photon::trace_all(&tile, self.seed, group, &mut sink, |sink| {
                    sink.aimed.pop().or_else(|| {
                        let record = waiting.next()?;
                        sink.products.tally.traced += 1;
                        Some(*record)
                    })
                });
            }
            Work::Emission { light, indices } => {
                let mut indices = indices.clone();
                let source = Source::new(self, *light);
                photon::trace_all(&tile, self.seed, group, &mut sink, |sink| {
                    let (products, near) = (&mut sink.products, &mut sink.near);
                    sink.aimed.pop().or_else(|| {
                        indices.find_map(|index| match index.checked_sub(source.count) {
                            None => self.emit(&tile, &source, index as u32, products, near),
                            Some(probe) => self.probe(&tile, *light, probe as u32),
                        })
                    })
                });
            }
        }
        Ok(sink.products)
    }

    fn leaf(&self, leaf: u32) -> &LeafRecord {
        &self.bsp.leaves[leaf as usize]
    }

    /// A photon that starts in the tile.
    fn emit(
        &self,
        tile: &Resident<'_>,
        source: &Source<'_>,
        photon: u32,
        products: &mut Products,
        near: &mut u32,
    ) -> Option<TransitRecord> {
        let &Source { id, light, emitters, profile, count } = source;
        if let Some(daylight) = &self.daylight
            && Daylight::is_daylight(light)
        {
            let arrival = daylight.emit(self.seed, id, light, emitters, photon);
            let flux = arrival.flux / count as f32;
            let owned = || flux != Vec3::ZERO && daylight.owns(&arrival);
            return self.launch(tile, id, photon, &arrival.start, flux, owned, products, near);
        }
        let start = emission::start(self.seed, id, light, emitters, profile, photon, tile.delta);
        let flux = Vec3::from(light.flux_w) / count as f32;
        self.launch(tile, id, photon, &start, flux, || true, products, near)
    }

    /// Enters a photon that starts in the tile into the ledger. One whose light is another photon's (it is not `owned`)
    /// escapes at once, without flux.
    #[allow(clippy::too_many_arguments)]
    fn launch(
        &self,
        tile: &Resident<'_>,
        id: u32,
        photon: u32,
        start: &Start,
        flux: Vec3,
        owned: impl FnOnce() -> bool,
        products: &mut Products,
        near: &mut u32,
    ) -> Option<TransitRecord> {
        let (origin, direction) = (start.origin.as_dvec3(), start.direction.as_dvec3());
        let plain = self.bsp.keeps(*near, origin, direction);
        let leaf = if plain { *near } else { self.bsp.locate_towards(origin, direction) };
        *near = leaf;
        if self.leaf(leaf).tile != tile.tile {
            return None;
        }
        let room = self.leaf(if plain { leaf } else { self.bsp.locate(origin) }).room;
        products.tally.room(room).emitted += 1;
        products.tally.traced += 1;
        if !owned() {
            products.escaped(room, 0, Vec3::ZERO);
            return None;
        }
        add3(&mut products.tally.room(room).emitted_w, flux);
        let record = TransitRecord {
            origin: start.origin.to_array(),
            direction: start.direction.to_array(),
            flux: flux.to_array(),
            t: 0.0,
            leaf,
            light: id,
            photon,
            bounce: 0,
            flags: TRANSIT_UNSCATTERED,
            last_triangle: start.triangle,
            impacts: 0,
        };
        let towards = self.leaf(leaf).room;
        if towards != room {
            products.passage(room, towards, &record);
        }
        Some(record)
    }

    /// A probe goes from a point on the light to a point of a portal of the room in which it starts.
    fn probe(&self, tile: &Resident<'_>, id: u32, probe: u32) -> Option<TransitRecord> {
        let light = &self.tables.lights()[id as usize];
        let emitters = self.tables.emitters_of(light);
        if light.kind == LIGHT_SUN || Daylight::is_everywhere(light) {
            // The sun shines in one direction, and what comes through no opening is nobody's in particular.
            return None;
        }
        let u = rng::uniforms(self.seed, Purpose::Probe, id, probe, 0, 0);
        let v = rng::uniforms(self.seed, Purpose::Probe, id, probe, 0, 1);
        let lift = if !emitters.is_empty() { tile.delta * emission::OFFSET_PER_DELTA } else { 0.0 };
        let point = emission::point_on(light, emitters, [u[0], u[1], u[2]], lift);
        let origin = point.position + point.normal * lift;
        let room = self.leaf(self.bsp.locate(origin.as_dvec3())).room;
        let portals = self.tables.portals_of(room);
        if portals.is_empty() {
            return None;
        }
        let portal = &portals[((u[3] * portals.len() as f32) as usize).min(portals.len() - 1)];
        let first = portal.first_piece as usize;
        let pieces = &self.tables.pieces()[first..first + portal.piece_count as usize];
        if pieces.is_empty() {
            return None;
        }
        // A piece by area, a triangle of its fan by v[1], a point on it by v[2] and v[3].
        let mut pick = v[0] * portal.area_m2;
        let piece = pieces
            .iter()
            .find(|p| {
                pick -= p.area_m2;
                pick < 0.0
            })
            .unwrap_or(&pieces[pieces.len() - 1]);
        let corners = piece.count.clamp(3, piece.corners.len() as u32) as usize;
        let fan = ((v[1] * (corners - 2) as f32) as usize).min(corners - 3);
        let [a, b, c] = [0, fan + 1, fan + 2].map(|i| Vec3::from(piece.corners[i]));
        let (s, t) = vector::triangle(v[2], v[3]);
        let target = a * (1.0 - s - t) + b * s + c * t;
        let direction = (target - origin).normalize_or_zero();
        let one_sided = matches!(light.kind, LIGHT_AREA | LIGHT_POINT_LAMBERT | LIGHT_SKY);
        if direction == Vec3::ZERO || (one_sided && direction.dot(point.normal) <= 0.0) {
            return None;
        }
        // A lamp with a beam is not seen from beside it.
        if let LIGHT_SPOT | LIGHT_PROFILE = light.kind
            && emission::point_intensity(light, self.tables.profile_of(light), direction) <= 0.0
        {
            return None;
        }
        let leaf = self.bsp.locate_towards(origin.as_dvec3(), direction.as_dvec3());
        if self.leaf(leaf).tile != tile.tile {
            return None;
        }
        Some(TransitRecord {
            origin: origin.to_array(),
            direction: direction.to_array(),
            t: 0.0,
            leaf,
            light: id,
            photon: probe,
            flags: TRANSIT_PROBE,
            last_triangle: point.triangle,
            ..TransitRecord::default()
        })
    }
}
