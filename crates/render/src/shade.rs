//! What a rendering thread does: camera rays look, shadow rays ask, and the film adds up.
//!
//! Radiance at a diffuse surface is emitted + direct (shadow rays to lights chosen by importance) + indirect
//! (the photon map of the point's room: Jensen 2001, chapter 7; the paper, section 6; or gather rays, see
//! [`crate::gather`]). Mirrors, gloss, panes and solid glass send the camera ray on.

use std::ops::Range;
use std::sync::Arc;

use enf_geometry::{Hit, Query, Structure};
use enf_illumination::{Gather, GatherScratch, IrradianceCache, PhotonMap, PortalSet};
use enf_image::Film;
use enf_layout::NONE;
use enf_layout::bsp::LEAF_SOLID;
use enf_layout::light::{LIGHT_AREA, LIGHT_PROFILE, LIGHT_SPOT, LIGHT_SUN, LightRecord};
use enf_layout::material::MaterialRecord;
use enf_layout::sections::Malformed;
use enf_layout::transit::{TRANSIT_CAMERA, TRANSIT_GATHER, TRANSIT_SHADOW, TransitRecord};
use enf_rooms::Bsp;
use enf_stage::resident::TileData;
use enf_stage::tables::Tables;
use enf_store::{Buffer, Mapped, Reservation, StageReader, StoreError};
use enf_transport::emission;
use enf_transport::flight::{self, Flight, Resident, Surface};
use enf_transport::lamp;
use enf_transport::rng::{self, Purpose};
use enf_transport::scatter::{self, Lobes};
use enf_transport::sky::Daylight;
use enf_transport::texture::{Coordinates, Texturing};
use enf_transport::vector;
use glam::Vec3;

use crate::Indirect;
use crate::bands::{self, Films, Lives};
use crate::camera::{self, View};
use crate::caustics::Caustics;
use crate::choice::{self, Choice};
use crate::daylight;
use crate::pages::{Pages, Paging, Share};
use crate::sight::Sights;

/// Share of shadow rays that go to lights outside the room's set, so that no light has probability zero.
const GLOBAL_SHARE: f32 = 0.02;

/// Where so many photons lie within reach of a point, on whatever surface, there is light.
const SOME_PHOTONS: u32 = 10;

/// Nothing is nearer than this, m, when the mean distance to what is around is asked for.
const NEAREST_M: f32 = 1e-3;

/// A shadow ray of a sample of the second half ([`Context::half`]) ...
const MARK_SECOND_HALF: u16 = 1;
/// ... or of neither.
const MARK_NO_HALF: u16 = 2;
/// A gather ray's shadow ray, whose path began at what is seen after a bounce.
const MARK_LATER: u16 = 4;
/// A shadow ray to a light outside the room's set.
const MARK_OUTSIDE: u16 = 8;

/// Of all importance at a point: a light with less is not worth looking through openings for.
const LEAST_IMPORTANCE: f32 = 1.0 / 256.0;

/// Steps of the five-dimensional Kronecker sequence (Roberts 2018: powers of 1/1.13472...), as 32-bit fractions.
const KRONECKER: [u32; 5] = [0xE19B_01AB, 0xC6D1_D6C9, 0xAF36_D01F, 0x9A69_443F, 0x8814_03B9];

/// What a room answers with: its photon map, and the lights that it sees.
#[derive(Default)]
pub(crate) struct RoomLight {
    pub(crate) map: Option<RoomMap>,
    /// Lights and parts of lights, by ids and ranges.
    pub(crate) lights: Vec<Choice>,
    /// What those of them that are in other rooms are seen through.
    pub(crate) sights: Sights,
    /// Whether the sun shines in: then each point asks for it, beside those.
    pub(crate) sun: bool,
    /// Of the lights; none where there are none.
    pub(crate) _reservation: Option<Reservation>,
}

/// How a photon map is in memory.
pub(crate) enum MapMemory {
    /// All its pieces.
    Whole(Vec<Mapped>),
    /// Some of them at a time.
    Pages(Pages),
}

/// A photon map, and the irradiance that was gathered from it so far.
pub(crate) struct RoomMap {
    pub(crate) map: MapMemory,
    pub(crate) cache: IrradianceCache,
    /// For final gathering, where there are any.
    pub(crate) caustics: Option<Caustics>,
    pub(crate) _reservation: Reservation,
}

/// Rays that wait, in memory or read back.
pub(crate) enum Waiting {
    Memory(Vec<TransitRecord>),
    Log(Buffer),
}

impl Waiting {
    pub(crate) fn records(&self) -> &[TransitRecord] {
        match self {
            Self::Memory(records) => records,
            Self::Log(buffer) => buffer.as_slice_of::<TransitRecord>().unwrap_or(&[]),
        }
    }
}

/// What a job is made of.
pub(crate) enum Work {
    /// New camera rays of a pass over a band, which begins with `first_pixel`: samples `indices`, pixel by pixel.
    Camera { first_pixel: u32, pass: Pass, indices: Range<u64> },
    /// Rays that came from another tile.
    Waiting { records: Arc<Waiting>, range: Range<usize> },
}

/// A piece of a visit.
pub(crate) struct Job {
    pub(crate) tile: Arc<TileData>,
    pub(crate) light: Arc<RoomLight>,
    /// Of all bands whose rays there are.
    pub(crate) films: Arc<Films>,
    pub(crate) work: Work,
}

/// A pass over a band: all pixels get the same samples first, then some of them more.
#[derive(Clone)]
pub(crate) enum Pass {
    /// So many samples of each pixel.
    All,
    /// Further samples: how many the pixels before have together, for each pixel and for the end.
    More(Arc<Vec<u64>>),
}

/// Rays on their way to another tile.
pub(crate) struct Parked {
    pub(crate) tile: u32,
    pub(crate) records: Vec<TransitRecord>,
    /// Whether some are no shadow rays: they will ask the room.
    pub(crate) lit: bool,
}

/// What came of a job.
#[derive(Default)]
pub(crate) struct Products {
    /// The job's tile.
    pub(crate) tile: u32,
    pub(crate) parked: Vec<Parked>,
    /// Rays of each band that are more, or fewer, than before.
    pub(crate) lives: Lives,
    pub(crate) camera: u64,
    pub(crate) shadow: u64,
    /// Gather rays; without final gathering, estimates.
    pub(crate) gathers: u64,
    pub(crate) found: Found,
}

/// Light that shadow rays have found, for the report: sums of luminance in steps of 2^-20 W/m²/sr, so that no order matters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Found {
    /// All of it.
    pub(crate) all: u128,
    /// From lights outside the set of the room that it falls on.
    pub(crate) outside: u128,
}

impl Found {
    fn add(&mut self, luminance: f32, outside: bool) {
        // What is no number is none.
        let steps = (f64::from(luminance) * f64::from(1 << 20)).round() as u128;
        self.all += steps;
        self.outside += if outside { steps } else { 0 };
    }

    /// Adds what others have found.
    pub(crate) fn add_all(&mut self, other: Self) {
        self.all += other.all;
        self.outside += other.outside;
    }

    /// The share from outside the sets.
    pub(crate) fn share(&self) -> f64 {
        self.outside as f64 / self.all.max(1) as f64
    }
}

impl Products {
    fn park(&mut self, tile: u32, record: TransitRecord) {
        let lit = record.flags & TRANSIT_SHADOW == 0;
        match self.parked.iter_mut().rfind(|lane| lane.tile == tile) {
            Some(lane) => {
                lane.records.push(record);
                lane.lit |= lit;
            }
            None => self.parked.push(Parked { tile, records: vec![record], lit }),
        }
    }
}

/// What every job needs to know.
pub(crate) struct Context<'a> {
    pub(crate) tables: &'a Tables,
    /// Where maps come from, piece by piece.
    pub(crate) maps: &'a StageReader,
    pub(crate) bsp: Bsp<'a>,
    pub(crate) views: &'a [View],
    /// First pixel of each view, and the end.
    pub(crate) first_pixels: &'a [u32],
    pub(crate) seed: u64,
    pub(crate) samples: u32,
    pub(crate) light_samples: u32,
    /// Rays of one job.
    pub(crate) job_rays: u64,
    pub(crate) gather: Gather,
    pub(crate) indirect: Indirect,
    /// Gather rays of a pixel.
    pub(crate) gather_rays: u32,
    /// Sums of the lights' powers, normalised to 1.
    pub(crate) power: &'a [f64],
    /// The sky, if there is one.
    pub(crate) daylight: Option<&'a Daylight>,
}

/// One thread's working memory.
pub(crate) struct Scratch {
    pub(crate) gather: GatherScratch,
    weights: Vec<f32>,
    /// Importance of the room's choices.
    importance: Vec<f32>,
    /// Rays that are followed together.
    group: Vec<TransitRecord>,
    /// Shadow and gather rays that will be.
    asking: Vec<TransitRecord>,
    queries: Vec<Query>,
    hits: Vec<Option<Hit>>,
}

impl Scratch {
    /// Rays that are followed together.
    const GROUP: usize = 512;

    /// Bytes of the rays that are followed together, when each comes with so many others that ask for light, and of an estimate of so
    /// many photons.
    pub(crate) fn bytes(asking: u32, photons: u32) -> u64 {
        let asked = size_of::<TransitRecord>() + size_of::<Query>() + size_of::<Option<Hit>>();
        // Vectors that grow by doubling.
        let asking = 2 * asking as usize * size_of::<TransitRecord>();
        (Self::GROUP * (asked + asking) + GatherScratch::new(photons).bytes()) as u64
    }

    pub(crate) fn new(photons: u32) -> Self {
        Self {
            gather: GatherScratch::new(photons),
            weights: Vec::new(),
            importance: Vec::new(),
            group: Vec::new(),
            asking: Vec::new(),
            queries: Vec::new(),
            hits: Vec::new(),
        }
    }
}

/// Light that may arrive at a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sample {
    /// Unit vector to where it comes from.
    pub(crate) direction: Vec3,
    /// How far that is, m; infinite for the sky.
    pub(crate) distance: f32,
    /// Cosine between that and the normal of an area light; 1 of others.
    pub(crate) cos_light: f32,
    /// Irradiance over its density if nothing is in the way, W/m2.
    pub(crate) irradiance: Vec3,
    /// Global index of the triangle that it comes from, or [`NONE`].
    pub(crate) triangle: u32,
}

/// A job at work.
pub(crate) struct Shader<'a> {
    pub(crate) context: &'a Context<'a>,
    pub(crate) tile: Resident<'a>,
    room: u32,
    pub(crate) map: Option<(PhotonMap<'a>, &'a IrradianceCache)>,
    pub(crate) caustics: Option<PhotonMap<'a>>,
    pub(crate) portals: PortalSet<'a>,
    lights: &'a [Choice],
    sights: &'a Sights,
    sun: bool,
    films: &'a Films,
    /// Where the map is not whole.
    paging: Option<Paging<'a>>,
}

impl Context<'_> {
    /// View and pixel in it of a pixel over all views.
    pub(crate) fn pixel(&self, pixel: u32) -> (&View, u32) {
        let view = self.first_pixels.partition_point(|&first| first <= pixel) - 1;
        (&self.views[view], pixel - self.first_pixels[view])
    }

    /// Calls `each` with the pixels of a band (of `count` from `first_pixel` on) that are at most `reach` rows and
    /// columns away from one of them in the same picture, itself included, and with their squared distance.
    pub(crate) fn neighbours(
        &self,
        first_pixel: u32,
        count: usize,
        pixel: usize,
        reach: u32,
        mut each: impl FnMut(usize, u32),
    ) {
        let (view, local) = self.pixel(first_pixel + pixel as u32);
        let (width, height) = (view.camera.width, view.camera.height);
        let (x, y) = (local % width, local / width);
        // The picture's first pixel, counted as the band's are.
        let origin = i64::from(first_pixel) + pixel as i64 - i64::from(local);
        for row in y.saturating_sub(reach)..=(y + reach).min(height - 1) {
            for column in x.saturating_sub(reach)..=(x + reach).min(width - 1) {
                let at = origin + i64::from(row) * i64::from(width) + i64::from(column)
                    - i64::from(first_pixel);
                if (0..count as i64).contains(&at) {
                    let (dx, dy) = (column.abs_diff(x), row.abs_diff(y));
                    each(at as usize, dx * dx + dy * dy);
                }
            }
        }
    }

    /// A camera ray of a job.
    fn seen(&self, first_pixel: u32, pass: &Pass, index: u64) -> TransitRecord {
        let (pixel, sample) = match pass {
            Pass::All => {
                let samples = u64::from(self.samples);
                ((index / samples) as u32, (index % samples) as u32)
            }
            Pass::More(before) => {
                let pixel = before.partition_point(|&b| b <= index) - 1;
                (pixel as u32, self.samples + (index - before[pixel]) as u32)
            }
        };
        let pixel = first_pixel + pixel;
        let (view, local) = self.pixel(pixel);
        let u = rng::uniforms(self.seed, Purpose::Camera, local, 0, 0, 0);
        let (dx, dy) = camera::place(sample, [u[0], u[1]]);
        let (origin, direction) = view.camera.ray(local, dx, dy);
        TransitRecord {
            origin: origin.to_array(),
            direction: direction.to_array(),
            flux: [1.0; 3],
            t: 0.0,
            leaf: self.bsp.locate_towards(origin.as_dvec3(), direction.as_dvec3()),
            light: pixel,
            photon: sample,
            bounce: 0,
            flags: TRANSIT_CAMERA,
            last_triangle: NONE,
            impacts: 0,
        }
    }

    /// Whether a camera ray starts inside a wall that a plan cuts: it stays black there, as walls are drawn.
    fn is_cut(&self, record: &TransitRecord) -> bool {
        self.bsp.leaves[record.leaf as usize].flags & LEAF_SOLID != 0
            && self.pixel(record.light).0.camera.is_plan()
    }

    /// Which half of the pixel's first samples one belongs to, as a sign; 0 where it is in neither.
    fn half(&self, sample: u32) -> f32 {
        if sample >= self.samples & !1 {
            0.0
        } else if sample & 1 == 0 {
            1.0
        } else {
            -1.0
        }
    }

    pub(crate) fn run(&self, job: &Job, scratch: &mut Scratch) -> Result<Products, StoreError> {
        let mut products = Products { tile: job.tile.tile, ..Products::default() };
        match &job.work {
            Work::Waiting { records, range } => {
                products.lives.add_all(&records.records()[range.clone()], -1);
            }
            Work::Camera { first_pixel, indices, .. } => {
                let rays = (indices.end - indices.start) as i64;
                products.lives.add(bands::band_of(*first_pixel), -rays);
            }
        }
        let pages = match job.light.map.as_ref().map(|room| &room.map) {
            Some(MapMemory::Pages(pages)) => Some(pages),
            _ => None,
        };
        let mut share = pages.map(Pages::take_share);
        let structure = job.tile.structure()?;
        // Rays that wait for pieces of the map for which there was no room.
        let mut left = None;
        loop {
            let shader = self.shader(job, &structure, share.as_ref())?;
            let Some(paging) = shader.follow_job(job, left.as_deref(), scratch, &mut products)?
            else {
                break;
            };
            let later = paging.later.into_inner();
            if later.is_empty() {
                break;
            }
            if left.is_some() && paging.answered.get() == 0 {
                return Err(paging.share.too_small().into());
            }
            left = Some(later);
            if let Some(share) = &mut share {
                share.clear();
            }
        }
        let Products { parked, lives, .. } = &mut products;
        parked.iter().for_each(|lane| lives.add_all(&lane.records, 1));
        Ok(products)
    }

    /// Everything that a job's rays ask.
    fn shader<'s>(
        &'s self,
        job: &'s Job,
        structure: &'s Structure<'s>,
        share: Option<&'s Share<'s>>,
    ) -> Result<Shader<'s>, StoreError> {
        let texturing = Texturing {
            textures: self.tables.textures(),
            texels: self.tables.texels(),
            coordinates: Coordinates::from_blob(job.tile.coordinates())?,
        };
        let room = self.tables.tiles()[job.tile.tile as usize].room;
        Ok(Shader {
            context: self,
            tile: Resident {
                tile: job.tile.tile,
                bsp: &self.bsp,
                structure,
                materials: self.tables.materials(),
                texturing,
                delta: self.tables.scene.delta,
            },
            room,
            map: match (&job.light.map, share) {
                (Some(room), Some(share)) => Some((share.map()?, &room.cache)),
                (Some(RoomMap { map: MapMemory::Whole(map), cache, .. }), None) => {
                    Some((PhotonMap::from_pieces(map.iter().map(|m| &m[..]))?, cache))
                }
                _ => None,
            },
            caustics: match job.light.map.as_ref().and_then(|room| room.caustics.as_ref()) {
                Some(caustics) => Some(caustics.map()?),
                None => None,
            },
            portals: PortalSet::new(self.tables.portals_of(room), self.tables.pieces()),
            lights: &job.light.lights,
            sights: &job.light.sights,
            sun: job.light.sun,
            films: &job.films,
            paging: share.map(Paging::new),
        })
    }
}

impl<'a> Shader<'a> {
    /// Follows the rays of a job, or those that are `left` of it; returns those that wait for pieces of a map for which there is no room.
    fn follow_job(
        mut self,
        job: &Job,
        left: Option<&[TransitRecord]>,
        scratch: &mut Scratch,
        products: &mut Products,
    ) -> Result<Option<Paging<'a>>, StoreError> {
        let waiting = match (left, &job.work) {
            (Some(left), _) => Some(left),
            (None, Work::Waiting { records, range }) => Some(&records.records()[range.clone()]),
            (None, Work::Camera { .. }) => None,
        };
        if let Some(records) = waiting {
            let mut waiting = records.iter();
            self.follow_all(scratch, products, |_| waiting.next().copied())?;
        } else if let Work::Camera { first_pixel, pass, indices } = &job.work {
            let mut indices = indices.clone();
            let (context, here) = (self.context, self.tile.tile);
            self.follow_all(scratch, products, |products| {
                // An eye in a doorway, and a plan, have rays that start elsewhere.
                indices.by_ref().find_map(|index| {
                    let record = context.seen(*first_pixel, pass, index);
                    products.camera += 1;
                    let tile = context.bsp.leaves[record.leaf as usize].tile;
                    if context.is_cut(&record) {
                        return None;
                    }
                    if tile == here {
                        return Some(record);
                    }
                    products.park(tile, record);
                    None
                })
            })?;
        }
        Ok(self.paging)
    }

    /// Brings the piece of the map that a ray waits for, if there is room.
    fn bring_piece(&mut self) -> Result<(), StoreError> {
        let (Some(paging), Some((map, _))) = (&self.paging, &mut self.map) else { return Ok(()) };
        let Some(number) = paging.wanted.take() else { return Ok(()) };
        let share: &'a Share<'a> = paging.share;
        match share.piece(number, self.context.maps)? {
            Some(piece) => map.bring(number, piece)?,
            None => paging.full.set(true),
        }
        Ok(())
    }

    /// A piece of the map that the light at a point asks for and that is not in memory.
    fn missing(
        &self,
        record: &TransitRecord,
        surface: &Surface,
        scratch: &mut Scratch,
    ) -> Option<u32> {
        let (map, cache) = self.map.as_ref()?;
        let gather = record.flags & TRANSIT_GATHER != 0;
        if !gather && self.context.indirect != Indirect::PhotonMap {
            return None;
        }
        // What is found on the way is kept in the cache: the estimate that follows is quick.
        if gather {
            let (point, normal, asked) = (surface.position, surface.normal, &self.context.gather);
            cache.estimate(map, point, normal, asked, &self.portals, &mut scratch.gather);
        } else {
            self.map_at(map, cache, surface, scratch);
        }
        scratch.gather.missing()
    }

    /// Irradiance at a point, W/m², by the photon map; nothing where that cannot know, on a thing so small that it has hardly a photon although
    /// some lie about.
    fn map_at(
        &self,
        map: &PhotonMap<'_>,
        cache: &IrradianceCache,
        surface: &Surface,
        scratch: &mut Scratch,
    ) -> Option<[f32; 3]> {
        let (point, normal, asked) = (surface.position, surface.normal, &self.context.gather);
        let scratch = &mut scratch.gather;
        let found = cache.estimate(map, point, normal, asked, &self.portals, scratch);
        let small = found.few && {
            let reach = asked.radius.min(map.radius());
            map.nearest(point, SOME_PHOTONS, reach, scratch).len() >= SOME_PHOTONS as usize
        };
        (!small).then_some(found.rgb)
    }

    /// The film that a ray's light is for, and the pixel there.
    #[inline]
    pub(crate) fn film_of(&self, record: &TransitRecord) -> (&Film, u32) {
        self.films.of(record.light)
    }

    /// Adds radiance that came straight from a light.
    fn add_direct(&self, record: &TransitRecord, radiance: Vec3) {
        let (film, pixel) = self.film_of(record);
        film.add_direct(pixel, radiance.to_array());
        film.add_noise(pixel, self.sign(record) * vector::luminance(radiance));
    }

    /// Adds radiance that came over other surfaces.
    pub(crate) fn add_indirect(&self, record: &TransitRecord, radiance: Vec3) {
        let (film, pixel) = self.film_of(record);
        if self.is_gathered_first(record) {
            film.add_gathered(pixel, radiance.to_array());
        } else {
            film.add_indirect(pixel, radiance.to_array());
            film.add_noise(pixel, self.sign(record) * vector::luminance(radiance));
        }
    }

    /// Whether it is a gather ray, or a shadow ray of one, from what the eye sees first.
    pub(crate) fn is_gathered_first(&self, record: &TransitRecord) -> bool {
        let shadow = record.flags & TRANSIT_SHADOW != 0;
        let later = if shadow { record.bounce & MARK_LATER } else { record.bounce & 0xff00 };
        record.flags & TRANSIT_GATHER != 0 && later == 0
    }

    /// What a shadow ray has in place of bounces: for whom it asks.
    fn marks(&self, record: &TransitRecord) -> u16 {
        let sign = self.sign(record);
        let half = if sign > 0.0 {
            0
        } else if sign < 0.0 {
            MARK_SECOND_HALF
        } else {
            MARK_NO_HALF
        };
        let gather = record.flags & TRANSIT_GATHER != 0;
        half | if gather && !self.is_gathered_first(record) { MARK_LATER } else { 0 }
    }

    /// See [`Context::half`].
    fn sign(&self, record: &TransitRecord) -> f32 {
        if record.flags & TRANSIT_SHADOW != 0 {
            return match record.bounce & (MARK_SECOND_HALF | MARK_NO_HALF) {
                0 => 1.0,
                MARK_SECOND_HALF => -1.0,
                _ => 0.0,
            };
        }
        // Gather rays that count are one to a sample, see there.
        self.context.half(record.photon)
    }

    pub(crate) fn tile_of(&self, leaf: u32) -> u32 {
        self.tile.bsp.leaves[leaf as usize].tile
    }

    /// Follows camera, shadow and gather rays, those that `next` gives and those that come of them, until each has ended or left
    /// the tile.
    fn follow_all(
        &mut self,
        scratch: &mut Scratch,
        products: &mut Products,
        mut next: impl FnMut(&mut Products) -> Option<TransitRecord>,
    ) -> Result<(), StoreError> {
        let mut group = std::mem::take(&mut scratch.group);
        let mut more = true;
        loop {
            // What is under way goes first: it cannot become much more.
            while group.len() < Scratch::GROUP
                && let Some(record) = scratch.asking.pop()
            {
                group.push(record);
            }
            while more && group.len() < Scratch::GROUP {
                match next(products) {
                    Some(record) => group.push(record),
                    None => more = false,
                }
            }
            if group.is_empty() {
                break;
            }
            scratch.queries.clear();
            scratch.queries.extend(group.iter().map(|r| flight::query(r, self.end(r))));
            scratch.hits.clear();
            scratch.hits.resize(group.len(), None);
            self.tile.structure.nearest_batch(&scratch.queries, &mut scratch.hits);
            let mut at = 0;
            group.retain_mut(|record| {
                let hit = scratch.hits[at];
                at += 1;
                if record.flags & TRANSIT_SHADOW != 0 {
                    self.shadow(record, hit, products)
                } else {
                    self.camera(record, hit, scratch, products)
                }
            });
            if self.paging.is_some() {
                if scratch.gather.missing().is_some() {
                    let what = "a point asks for more of its photon map than it waited for";
                    return Err(Malformed(what.into()).into());
                }
                self.bring_piece()?;
            }
        }
        scratch.group = group;
        Ok(())
    }

    /// How far a ray goes, m.
    fn end(&self, record: &TransitRecord) -> f32 {
        if record.flags & TRANSIT_SHADOW == 0 {
            return f32::INFINITY;
        }
        // Whatever lies within the tolerance of the light is part of it.
        f32::from_bits(record.photon) - 2.0 * self.tile.delta
    }

    /// What becomes of a camera or gather ray that meets `hit` next; false when that was the last of it here.
    fn camera(
        &self,
        record: &mut TransitRecord,
        hit: Option<Hit>,
        scratch: &mut Scratch,
        products: &mut Products,
    ) -> bool {
        let bsp = self.tile.bsp;
        let before = *record;
        let hit = match flight::follow(&self.tile, record, f32::INFINITY, hit, |_, _| {}) {
            Flight::Leaves { leaf, t } => {
                record.leaf = leaf;
                record.t = t;
                products.park(self.tile_of(leaf), *record);
                return false;
            }
            // Light that a gather ray finds where it began is counted elsewhere, see there.
            Flight::Escapes { .. } if record.flags & TRANSIT_GATHER != 0 => return false,
            Flight::Escapes { .. } => {
                if record.bounce == 0 {
                    let (film, pixel) = self.film_of(record);
                    film.add_room(pixel, 0);
                }
                if let Some(daylight) = self.context.daylight {
                    let direction = Vec3::from(record.direction);
                    // After a gloss the sun is found by shadow rays, for its disc is hardly ever met.
                    let gloss = f32::from_bits(record.impacts) > 0.0;
                    let seen =
                        if gloss { daylight.radiance(direction) } else { daylight.seen(direction) };
                    self.add_direct(record, Vec3::from(record.flux) * seen);
                }
                return false;
            }
            Flight::Reached => return false,
            Flight::Hit { hit, leaf } => {
                record.leaf = leaf;
                hit
            }
        };
        let direction = Vec3::from(record.direction);
        let surface = flight::surface(&self.tile, &hit, direction);
        let leaf = bsp.locate(surface.origin.as_dvec3());
        if bsp.leaves[leaf as usize].room != self.room {
            // The point belongs to a neighbour, whose photons and lights are elsewhere: met again there.
            record.leaf = leaf;
            record.t = hit.t;
            products.park(self.tile_of(leaf), *record);
            return false;
        }
        if let Some(paging) = &self.paging {
            if let Some(piece) = self.missing(record, &surface, scratch) {
                // Once more from the beginning, with that piece.
                *record = before;
                return paging.wait_for(piece, before);
            }
            paging.answered.set(paging.answered.get() + 1);
        }
        let throughput = Vec3::from(record.flux);
        let material = &self.tile.materials[surface.material as usize];
        let lobes = scatter::lobes(material, &flight::met(&self.tile, record, &hit, &surface));
        if record.flags & TRANSIT_GATHER != 0 {
            if record.bounce == 0 {
                let (film, pixel) = self.film_of(record);
                film.add_nearness(pixel, 1.0 / hit.t.max(NEAREST_M));
            }
            if lobes.diffuse != Vec3::ZERO {
                self.gathered(record, &surface, &lobes, hit.t, scratch, products);
            }
            return self.go_on_here(record, &surface, &lobes, hit.t, scratch, products);
        }
        if record.bounce == 0 {
            let (film, pixel) = self.film_of(record);
            let albedo = lobes.diffuse.to_array();
            film.add_surface(pixel, albedo, surface.normal.to_array(), hit.t);
            film.add_room(pixel, self.room + 1);
            if record.photon == 0 {
                film.set_room(pixel, self.room + 1);
            }
        }
        if surface.front {
            let emitted = throughput * Vec3::from(material.emission);
            let emitted = emitted * self.share_of_gloss(record, &surface, material, hit.t);
            if emitted != Vec3::ZERO {
                self.add_direct(record, emitted);
            }
        }
        if lobes.diffuse != Vec3::ZERO || lobes.gloss().is_some() {
            self.reflect(record, &surface, throughput, &lobes, scratch, products);
        }
        self.go_on_here(record, &surface, &lobes, hit.t, scratch, products)
    }

    /// [`Shader::go_on`]; false also when the ray goes on in another tile.
    fn go_on_here(
        &self,
        record: &mut TransitRecord,
        surface: &Surface,
        lobes: &Lobes,
        t: f32,
        scratch: &mut Scratch,
        products: &mut Products,
    ) -> bool {
        let mut lobes = *lobes;
        self.split(record, surface, &mut lobes, scratch, products);
        if !self.go_on(record, surface, &lobes, t) {
            return false;
        }
        if record.t == 0.0 {
            let direction = Vec3::from(record.direction);
            let bsp = self.tile.bsp;
            record.leaf = bsp.locate_towards(surface.origin.as_dvec3(), direction.as_dvec3());
            let next = self.tile_of(record.leaf);
            if next != self.tile.tile {
                products.park(next, *record);
                return false;
            }
        }
        true
    }

    /// Where the eye looks at glass, it sees what is mirrored and what is behind: a ray goes both ways, for one of them by
    /// chance would be a grain in the picture.
    fn split(
        &self,
        record: &TransitRecord,
        surface: &Surface,
        lobes: &mut Lobes,
        scratch: &mut Scratch,
        products: &mut Products,
    ) {
        let beyond = lobes.transmitted + lobes.refracted;
        let first = record.flags & TRANSIT_GATHER == 0 && record.bounce == 0;
        if !first || lobes.gloss().is_some() || beyond == Vec3::ZERO {
            return;
        }
        let direction = Vec3::from(record.direction);
        if let Some(reflected) = lobes.reflect(direction, surface.normal, [0.0; 2]) {
            let origin = surface.origin;
            let direction = reflected.direction;
            let flux = Vec3::from(record.flux) * reflected.weight;
            let mirrored = TransitRecord {
                origin: origin.to_array(),
                direction: direction.to_array(),
                flux: flux.to_array(),
                t: 0.0,
                leaf: self.tile.bsp.locate_towards(origin.as_dvec3(), direction.as_dvec3()),
                bounce: 1,
                last_triangle: surface.triangle,
                ..*record
            };
            self.send(mirrored, scratch, products);
            lobes.mirror = Vec3::ZERO;
        }
    }

    /// Mirror or gloss, straight on, or refracted: one of them by chance; false when the path ends.
    fn go_on(&self, record: &mut TransitRecord, surface: &Surface, lobes: &Lobes, t: f32) -> bool {
        let throughput = Vec3::from(record.flux);
        let gloss = lobes.gloss().is_some();
        if !gloss && lobes.mirror + lobes.transmitted + lobes.refracted == Vec3::ZERO {
            return false;
        }
        let (_, local) = self.context.pixel(record.light);
        let gather = record.flags & TRANSIT_GATHER != 0;
        let u = rng::uniforms(
            self.context.seed,
            if gather { Purpose::GatherScatter } else { Purpose::CameraScatter },
            local,
            record.photon,
            record.bounce,
            0,
        );
        let direction = Vec3::from(record.direction);
        let reflected = lobes.reflect(direction, surface.normal, [u[2], u[3]]);
        let mirror = reflected.map_or(Vec3::ZERO, |r| r.weight);
        // Radiance is denser in glass by the square of the index.
        let refracted = lobes.refracted * (lobes.eta * lobes.eta);
        let mean = |c: Vec3| (throughput * c).dot(Vec3::ONE);
        let (m, p, r) = (mean(mirror), mean(lobes.transmitted), mean(refracted));
        let (sum, total) = (m + p + r, throughput.dot(Vec3::ONE));
        if sum <= 0.0 || total <= 0.0 {
            return false;
        }
        // The first interactions always go on: roulette would only add noise where the eye is sharpest. A gloss is
        // blurred anyway, and so is what gather rays find.
        let certain = !gather && record.bounce < if gloss { 1 } else { 4 };
        let survival = if certain { 1.0 } else { (sum / total).min(scatter::MAX_SURVIVAL) };
        if u[0] >= survival {
            return false;
        }
        record.bounce = record.bounce.saturating_add(1);
        record.last_triangle = surface.triangle;
        let pick = u[1] * sum;
        let after = |colour: Vec3, share: f32| {
            (throughput * colour * (sum / (share * survival))).to_array()
        };
        match reflected {
            Some(reflected) if pick < m => {
                record.flux = after(mirror, m);
                record.impacts = reflected.density.to_bits();
                record.direction = reflected.direction.to_array();
                record.origin = surface.origin.to_array();
                record.t = 0.0;
            }
            _ if pick < m + p || r <= 0.0 => {
                // The same ray: how its direction was drawn is known still.
                record.flux = after(lobes.transmitted, p);
                record.t = flight::just_after(t);
            }
            _ => {
                record.flux = after(refracted, r);
                record.impacts = 0;
                record.flags = lobes.swung(record.flags, u[2]);
                record.direction = lobes.refract(direction, surface.normal).to_array();
                record.origin = surface.beyond().to_array();
                record.t = 0.0;
            }
        }
        true
    }

    /// How much of an emitter's radiance counts that a ray has met after a gloss: what the shadow rays to it leave (see
    /// [`light_share`]); all of it after a mirror, or straight from the eye.
    fn share_of_gloss(
        &self,
        record: &TransitRecord,
        surface: &Surface,
        material: &MaterialRecord,
        distance: f32,
    ) -> f32 {
        let density = f32::from_bits(record.impacts);
        if density <= 0.0 {
            return 1.0;
        }
        let cos = -surface.normal.dot(Vec3::from(record.direction));
        1.0 - self.light_share(material, density, distance * distance, cos)
    }

    /// Light that a gloss reflects is found in two ways, by shadow rays to the lights and by the rays that the gloss sends
    /// on; the two are weighted so that together they count once (Veach 1997, "Robust Monte Carlo Methods for Light
    /// Transport Simulation", section 9.2, the power heuristic). This is the weight of the shadow rays.
    ///
    /// Weights may be any that both ways know: the gloss's `density` (1/sr) of the direction, and that of a shadow ray to a
    /// light of the mean size of its material's, one of few.
    fn light_share(&self, material: &MaterialRecord, density: f32, square: f32, cos: f32) -> f32 {
        if material.light_area_m2 <= 0.0 {
            return 0.0;
        }
        let chosen = 0.5 * self.context.light_samples as f32;
        let light = chosen * square / (material.light_area_m2 * cos.max(1e-6));
        let (light, gloss) = (light * light, density * density);
        // Infinite only where the other vanishes.
        if light.is_finite() { light / (light + gloss) } else { 1.0 }
    }

    /// Light reflected by matter and gloss: indirect from the map (the gloss's comes with the ray that goes on), direct by
    /// shadow rays.
    fn reflect(
        &self,
        record: &TransitRecord,
        surface: &Surface,
        throughput: Vec3,
        lobes: &Lobes,
        scratch: &mut Scratch,
        products: &mut Products,
    ) {
        let reflected = throughput * lobes.diffuse * core::f32::consts::FRAC_1_PI;
        if self.context.indirect == Indirect::FinalGather && reflected != Vec3::ZERO {
            self.spread(record, surface, throughput, lobes, scratch, products);
        } else if reflected != Vec3::ZERO
            && let Some((map, cache)) = &self.map
        {
            products.gathers += 1;
            match self.map_at(map, cache, surface, scratch) {
                Some(found) => self.add_indirect(record, reflected * Vec3::from(found)),
                None => self.look_about(record, surface, throughput, lobes, scratch, products),
            }
        }
        self.direct(record, surface, throughput, lobes, scratch, products);
    }

    /// An upper guess of a light's irradiance at a surface, up to a common factor: flux over distance squared,
    /// with the cosines at its nearest and best.
    fn importance(&self, light: &LightRecord, surface: &Surface) -> f32 {
        if let Some(daylight) = self.context.daylight
            && let Some(known) =
                daylight::importance(daylight, light, surface.normal, self.outdoors())
        {
            return known;
        }
        let to = Vec3::from(light.position) - surface.position;
        let reach = light.radius + 0.05;
        let above = to.dot(surface.normal) + reach;
        if above <= 0.0 {
            return 0.0;
        }
        let square = to.length_squared() + reach * reach;
        let distance = square.sqrt();
        let lift = (above / distance).clamp(0.0, 1.0);
        let intensity = match light.kind {
            LIGHT_SPOT => Some(lamp::spot(light, -to)),
            LIGHT_PROFILE => {
                self.context.tables.profile_of(light).map(|p| lamp::measured(light, &p, -to))
            }
            _ => None,
        };
        if let Some(intensity) = intensity {
            let flux = vector::luminance(Vec3::from(light.flux_w));
            return flux * lift * lamp::guess(intensity) / square;
        }
        let axis = Vec3::from(light.axis);
        let directed =
            if light.kind == enf_layout::light::LIGHT_POINT { 0.0 } else { axis.length() };
        let faces = ((-to.dot(axis) + reach * directed) / distance).clamp(0.0, 1.0);
        let emitted = 1.0 - directed + faces;
        vector::luminance(Vec3::from(light.flux_w)) * lift * emitted / square
    }

    /// What one of the room's choices, by its place there, counts at a surface when lights are chosen. Where its importance is below
    /// `least` it is not asked what it is seen through.
    fn weight(&self, at: usize, importance: f32, least: f32, surface: &Surface) -> f32 {
        match importance > 0.0 {
            true => {
                let choice = &self.lights[at];
                let asked = (importance >= least).then_some(surface.position);
                importance * self.sights.share(at, choice.share, asked)
            }
            false => 0.0,
        }
    }

    /// Direct light by shadow rays to lights chosen from the room's set by importance, with a small share to all
    /// lights of the scene: every light has a probability, so nothing is biased. Where a gather ray has ended there is one
    /// ray, and none for what gloss reflects.
    pub(crate) fn direct(
        &self,
        record: &TransitRecord,
        surface: &Surface,
        throughput: Vec3,
        lobes: &Lobes,
        scratch: &mut Scratch,
        products: &mut Products,
    ) {
        let context = self.context;
        let gather = record.flags & TRANSIT_GATHER != 0;
        let matter = throughput * lobes.diffuse * core::f32::consts::FRAC_1_PI;
        let eye = -Vec3::from(record.direction);
        // What matter and gloss reflect of light from a direction; of the gloss, the share that is not found by rays that it sends on.
        let reflected = |direction: Vec3, share: &dyn Fn(f32) -> f32| match &lobes.coat {
            None => matter,
            Some(coat) if gather => matter * coat.admits(direction.dot(surface.normal)),
            Some(coat) => {
                let (lobe, density) = coat.evaluate(surface.normal, eye, direction);
                matter * coat.admits(direction.dot(surface.normal))
                    + throughput * lobe * share(density)
            }
        };
        let all = context.tables.lights();
        scratch.weights.clear();
        let mut all_of_them = 0.0f32;
        scratch.importance.clear();
        for choice in self.lights {
            let importance = self.importance(&choice.part, surface);
            all_of_them += importance;
            scratch.importance.push(importance);
        }
        let least = all_of_them * LEAST_IMPORTANCE;
        let mut total = 0.0f32;
        for (at, &importance) in scratch.importance.iter().enumerate() {
            total += self.weight(at, importance, least, surface);
            scratch.weights.push(total);
        }
        let global = if total > 0.0 { GLOBAL_SHARE } else { 1.0 };
        let count = if gather { 1 } else { context.light_samples };
        let (_, local) = context.pixel(record.light);
        // A low-discrepancy sequence over all samples of the pixel, shifted at random per pixel and bounce.
        let purpose = if gather { Purpose::GatherShadow } else { Purpose::Shadow };
        let shift = |block| rng::block(context.seed, purpose, local, 0, record.bounce, block);
        let (s, t) = (shift(0), shift(1));
        for sample in 0..count {
            let index = record.photon.wrapping_mul(count).wrapping_add(sample);
            let place = |dimension: usize, shift: u32| {
                rng::unit(index.wrapping_mul(KRONECKER[dimension]).wrapping_add(shift))
            };
            let u = [place(0, s[0]), place(1, s[1])];
            let mut v = [place(2, t[0]), place(3, t[1]), place(4, t[2])];
            let (chosen, known) = if u[0] >= global {
                let place = u[1] * total;
                let at = scratch.weights.partition_point(|&w| w <= place);
                let at = at.min(self.lights.len() - 1);
                v[0] = self.lights[at].of_part(v[0]);
                (self.lights[at].light, Some(at))
            } else {
                let place = f64::from(u[1]);
                let at = context.power.partition_point(|&p| p <= place);
                let chosen = at.min(all.len() - 1) as u32;
                (chosen, choice::of(self.lights, chosen, v[0]))
            };
            let light = &all[chosen as usize];
            let mut probability = global * power_of(context.power, chosen as usize);
            if total > 0.0
                && let Some(at) = known
            {
                // Of a point of the part, beside one of the whole light.
                let dense = 1.0 / self.lights[at].width();
                let weight = self.weight(at, scratch.importance[at], least, surface);
                probability += (1.0 - global) * dense * weight / total;
            }
            if probability <= 0.0 {
                continue;
            }
            let sample = match context.daylight {
                Some(daylight) if Daylight::is_daylight(light) => {
                    let emitters = context.tables.emitters_of(light);
                    let asked = daylight::Asked { outdoors: self.outdoors(), sun: self.sun };
                    daylight::sample(daylight, light, emitters, surface, v, asked)
                }
                _ => self.sample(light, surface, v),
            };
            let Some(sample) = sample else {
                continue;
            };
            let irradiance = sample.irradiance / (probability * count as f32);
            let sample = Sample { irradiance, ..sample };
            let emitter = self.tile.materials.get(light.material as usize);
            let share = |density: f32| match emitter.filter(|_| light.kind == LIGHT_AREA) {
                Some(emitter) => {
                    let square = sample.distance * sample.distance;
                    self.light_share(emitter, density, square, sample.cos_light)
                }
                // A ray never meets a point, and the sky only in its own way.
                None if Daylight::is_daylight(light) && light.kind != LIGHT_SUN => 0.0,
                None => 1.0,
            };
            let reflected = reflected(sample.direction, &share);
            let mark = if known.is_none() { MARK_OUTSIDE } else { 0 };
            self.ask(record, surface, reflected, &sample, mark, scratch, products);
        }
        if let (Some(daylight), true) = (context.daylight, self.sun) {
            // The sun is in one place: it is asked for on its own, for little else is seen beside it otherwise.
            let index = record.photon;
            let place = |dimension: usize, shift: u32| {
                rng::unit(index.wrapping_mul(KRONECKER[dimension]).wrapping_add(shift))
            };
            let at = [place(0, s[2]), place(1, s[3])];
            if let Some(sample) = daylight::sun(daylight, surface, at) {
                let reflected = reflected(sample.direction, &|_| 1.0);
                self.ask(record, surface, reflected, &sample, 0, scratch, products);
            }
        }
    }

    /// Sends a shadow ray after a sample.
    #[expect(clippy::too_many_arguments)]
    fn ask(
        &self,
        record: &TransitRecord,
        surface: &Surface,
        reflected: Vec3,
        sample: &Sample,
        mark: u16,
        scratch: &mut Scratch,
        products: &mut Products,
    ) {
        let radiance = reflected * sample.irradiance;
        if radiance == Vec3::ZERO {
            return;
        }
        let (origin, direction) = (surface.origin, sample.direction);
        let shadow = TransitRecord {
            origin: origin.to_array(),
            direction: direction.to_array(),
            flux: radiance.to_array(),
            t: 0.0,
            leaf: self.tile.bsp.locate_towards(origin.as_dvec3(), direction.as_dvec3()),
            light: record.light,
            photon: sample.distance.to_bits(),
            bounce: self.marks(record) | mark,
            flags: TRANSIT_SHADOW | record.flags & TRANSIT_GATHER,
            last_triangle: surface.triangle,
            impacts: sample.triangle,
        };
        products.shadow += 1;
        self.send(shadow, scratch, products);
    }

    /// A new ray, that starts here or in another tile.
    pub(crate) fn send(
        &self,
        record: TransitRecord,
        scratch: &mut Scratch,
        products: &mut Products,
    ) {
        let next = self.tile_of(record.leaf);
        if next == self.tile.tile {
            scratch.asking.push(record);
        } else {
            products.park(next, record);
        }
    }

    /// A point on a light, seen from a surface, from three uniform numbers; `None` where nothing can arrive from it.
    fn sample(&self, light: &LightRecord, surface: &Surface, v: [f32; 3]) -> Option<Sample> {
        let emitters = self.context.tables.emitters_of(light);
        let point = emission::point_on(light, emitters, v, 0.0);
        let to = point.position - surface.origin;
        let square = to.length_squared();
        let distance = square.sqrt();
        let direction = to / distance;
        let cos = direction.dot(surface.normal);
        if cos <= 0.0 || !distance.is_finite() || distance <= 0.0 {
            return None;
        }
        let flux = Vec3::from(light.flux_w);
        // Irradiance of this sample if nothing is in the way.
        let cos_light = if light.kind == LIGHT_AREA { -direction.dot(point.normal) } else { 1.0 };
        let irradiance = if light.kind == LIGHT_AREA {
            if cos_light <= 0.0 {
                return None;
            }
            // Le = flux / (pi A); density of the point is 1/A.
            flux * (core::f32::consts::FRAC_1_PI * cos * cos_light / square)
        } else {
            flux * (emission::point_intensity(
                light,
                self.context.tables.profile_of(light),
                -direction,
            ) * cos
                / square)
        };
        Some(Sample { direction, distance, cos_light, irradiance, triangle: point.triangle })
    }

    /// Whether the room is the outside, where daylight comes from everywhere.
    fn outdoors(&self) -> bool {
        daylight::outdoors(self.context.tables, self.room)
    }

    /// What becomes of a shadow ray that meets `hit` next: what it carries reaches the film unless something opaque is in
    /// the way. False when that was the last of it here.
    fn shadow(
        &self,
        record: &mut TransitRecord,
        hit: Option<Hit>,
        products: &mut Products,
    ) -> bool {
        let target = record.impacts;
        match flight::follow(&self.tile, record, self.end(record), hit, |_, _| {}) {
            Flight::Leaves { leaf, t } => {
                record.leaf = leaf;
                record.t = t;
                products.park(self.tile_of(leaf), *record);
                return false;
            }
            Flight::Reached | Flight::Escapes { .. } => {}
            Flight::Hit { hit, .. } if hit.global == target => {}
            Flight::Hit { hit, leaf } => {
                let direction = Vec3::from(record.direction);
                let surface = flight::surface(&self.tile, &hit, direction);
                let material = &self.tile.materials[surface.material as usize];
                let lobes =
                    scatter::lobes(material, &flight::met(&self.tile, record, &hit, &surface));
                let flux = Vec3::from(record.flux) * lobes.transmitted;
                record.flux = flux.to_array();
                record.leaf = leaf;
                record.t = flight::just_after(hit.t);
                record.last_triangle = hit.global;
                return flux != Vec3::ZERO;
            }
        }
        let flux = Vec3::from(record.flux);
        products.found.add(vector::luminance(flux), record.bounce & MARK_OUTSIDE != 0);
        if record.flags & TRANSIT_GATHER == 0 {
            self.add_direct(record, flux);
        } else {
            self.add_indirect(record, flux);
        }
        false
    }
}

fn power_of(cumulative: &[f64], light: usize) -> f32 {
    let before = if light == 0 { 0.0 } else { cumulative[light - 1] };
    (cumulative[light] - before) as f32
}
