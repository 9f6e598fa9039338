//! Asking: the `k` nearest photons that agree with a point, and the irradiance that they make (Jensen
//! 2001, sections 7.1 to 7.3).
//!
//! A photon counts if it
//!
//! 1. is within the radius,
//! 2. lies in the tangent plane, nearly: not on the shelf below or the next step of the stairs,
//! 3. hit a surface that faces the same way: not the other side of the wall, not round the edge,
//! 4. came from the front, and
//! 5. if it is a neighbour's, can be reached through an opening.

use enf_layout::map::{BLOCK_PHOTONS, MapBlock};
use enf_layout::photon::{PHOTON_CAUSTIC, PHOTON_HALO};
use glam::Vec3;

use super::lanes::{Instructions, Level, ways};
use super::map::PhotonMap;
use super::portals::{Opening, PortalSet};
use super::search::{Anything, Filter, Notes, Search, Stack};
use super::thing::{FEWEST, Thing};

/// Least cosine between a photon's surface and the query's. Surfaces that meet at 45 degrees, as in an
/// octagonal room, do not share photons.
pub const NORMAL_COSINE: f32 = 0.75;
/// A photon may rise above or lie below the tangent plane by this much of its distance from the point...
pub const SLAB_SLOPE: f32 = 0.25;
/// ... or by this much of the radius,
pub const SLAB_FLOOR_RADII: f32 = 0.02;
/// but the latter by no more than this, m.
pub const SLAB_FLOOR_M: f32 = 0.01;
/// Fewest photons that end the disc where they end, when there are not as many as were looked for: fewer might be close to
/// each other by chance, and too bright.
pub const ENDING_PHOTONS: usize = 8;
/// The disc that flux is divided by has at least this radius, as a part of the largest,
pub const SMALLEST_DISC_RADII: f32 = 1e-3;
/// or this one, m, if that is smaller: photons in one spot are no infinity.
pub const SMALLEST_DISC_M: f32 = 1e-3;

/// How a photon's weight falls with its distance. All are normalised: a uniform field gives the same
/// irradiance with each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kernel {
    /// All alike (as in Fradin et al. 2005).
    #[default]
    Constant,
    /// `1 - d/r` (Jensen 2001, section 7.3.1, with k = 1).
    Cone,
    /// `1 - (d/r)^2`.
    Epanechnikov,
}

/// What to gather.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gather {
    /// How many photons, `k`. The farthest of them only says how large the disc is, so at least 2
    /// (fewer count as 2).
    pub photons: u32,
    /// How far away at most, m. No farther than the map is complete for ([`PhotonMap::radius`]).
    pub radius: f32,
    /// Weighting.
    pub kernel: Kernel,
}

/// What was gathered.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Irradiance {
    /// Irradiance, W/m², linear Rec.709.
    pub rgb: [f32; 3],
    /// Photons found, `k` at most.
    pub photons: u32,
    /// Radius of the disc that they fill, m; 0 if there are none.
    pub radius: f32,
    /// Whether the disc says little about the point: it has hardly a photon, or is mostly not there, or its photons crowd in
    /// the middle or about it. So it is on things that are smaller than the disc, on bars and slats, and where light ends.
    pub vague: bool,
    /// Whether it is vague and how large the thing is cannot be told either: too few photons lie on it. Never where there are caustics.
    pub few: bool,
}

/// Working memory of one thread that gathers; use it again and again.
#[derive(Clone, Debug)]
pub struct GatherScratch {
    notes: Notes,
    stack: Box<Stack>,
    openings: Vec<Opening>,
    thing: Thing,
    instructions: Instructions,
    /// Where the last search was that found all that it looked for, and how far it had to look, m.
    last: Option<(Vec3, f32)>,
}

impl GatherScratch {
    /// Room for gathers of up to this many photons. (A larger gather makes it grow, once.)
    pub fn new(photons: u32) -> Self {
        Self {
            notes: Notes::with_capacity(photons as usize),
            stack: Box::default(),
            openings: Vec::new(),
            thing: Thing::with_capacity((photons as usize).min(1 << 20)),
            instructions: Instructions::default(),
            last: None,
        }
    }

    /// Uses no more than these instructions. Results do not change.
    pub fn with_instructions(mut self, instructions: Instructions) -> Self {
        self.instructions = instructions;
        self
    }

    /// Bytes that it occupies now.
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + size_of::<Stack>()
            + self.notes.bytes()
            + self.openings.capacity() * size_of::<Opening>()
            + self.thing.bytes()
    }

    /// A piece that searches since the last call needed, of a map that has pieces which are not in memory
    /// ([`PhotonMap::from_outlines`]). What was found since then is to be asked for again, with that piece.
    pub fn missing(&mut self) -> Option<u32> {
        self.notes.take_missing()
    }

    /// Whether a piece is missing, which stays so.
    pub(super) fn is_missing(&self) -> bool {
        self.notes.is_missing()
    }

    /// The square of a radius that probably holds what is looked for: queries that follow each other are often neighbours.
    fn guess2(&self, point: Vec3) -> f32 {
        self.last.map_or(f32::INFINITY, |(at, radius)| {
            squared((radius + (point - at).length()) * (1.0 + 1e-5))
        })
    }

    fn remember(&mut self, point: Vec3) {
        let farthest = self.notes.distances2().first().map_or(0.0, |&d| f32::from_bits(d).sqrt());
        self.last = self.notes.is_full().then_some((point, farthest));
    }
}

/// The nearest photons, the farthest of them first, the others in no order.
#[derive(Clone, Copy, Debug)]
pub struct Nearest<'a> {
    notes: &'a Notes,
}

impl<'a> Nearest<'a> {
    /// How many were found.
    pub fn len(&self) -> usize {
        self.notes.photons().len()
    }

    /// Whether nothing was found.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Numbers ([`PhotonMap::photon`]) and squared distances, m².
    pub fn iter(&self) -> impl Iterator<Item = (u32, f32)> + use<'a> {
        let notes = self.notes;
        notes.photons().iter().copied().zip(notes.distances2().iter().map(|&d| f32::from_bits(d)))
    }
}

impl PhotonMap<'_> {
    /// The nearest `photons` within `radius` (m) of a point, whatever surface they are on; among those at the farthest
    /// distance the first in the order of their bytes.
    pub fn nearest<'s>(
        &self,
        point: Vec3,
        photons: u32,
        radius: f32,
        scratch: &'s mut GatherScratch,
    ) -> Nearest<'s> {
        let guess2 = scratch.guess2(point);
        let search = Search {
            map: self,
            point: point.to_array(),
            radius2: if radius > 0.0 { squared(radius) } else { -1.0 },
            guess2,
            k: (photons as usize).min(self.len().saturating_add(1)),
            notes: &mut scratch.notes,
            stack: &mut scratch.stack,
            filter: Anything,
        };
        scratch.instructions.run(search);
        scratch.remember(point);
        Nearest { notes: &scratch.notes }
    }

    /// Irradiance on the front of a surface at `point` (m) with unit `normal`, from the nearest photons
    /// that count (see above).
    ///
    /// The farthest of the photons that are found gives the disc and the others the flux (this form is unbiased in a uniform
    /// field, whether the `k`-th or the last within the radius is the farthest); if they are fewer than `k` and
    /// than [`ENDING_PHOTONS`], all count and the disc has the full radius. No photon, no light: all zero. So it is for
    /// points, normals or radii that are no numbers.
    ///
    /// `portals` are all openings of the map's room. The result's bits depend on the room's photons,
    /// not on the tree, nor on which of the photons are halo as long as they are visible.
    pub fn irradiance(
        &self,
        point: Vec3,
        normal: Vec3,
        gather: &Gather,
        portals: &PortalSet,
        scratch: &mut GatherScratch,
    ) -> Irradiance {
        // Written so that a radius that is no number is no radius.
        let searchable = gather.radius > 0.0 && !self.is_empty();
        if !searchable {
            return Irradiance::default();
        }
        let radius = gather.radius.min(self.radius());
        let k = (gather.photons.max(2) as usize).min(self.len().saturating_add(1));
        let guess2 = scratch.guess2(point);
        let floor2 = squared(SLAB_FLOOR_M.min(SLAB_FLOOR_RADII * radius));
        let GatherScratch { notes, stack, openings, .. } = scratch;
        let filter = Facing { point, normal, radius, floor2, portals, openings, known: false };
        let search = Search {
            map: self,
            point: point.to_array(),
            radius2: squared(radius),
            guess2,
            k,
            notes,
            stack,
            filter,
        };
        scratch.instructions.run(search);
        scratch.remember(point);
        let GatherScratch { notes, thing, .. } = scratch;
        estimate(self, notes, thing, normal, point, radius, gather.kernel)
    }
}

fn squared(x: f32) -> f32 {
    x * x
}

/// Photons that light the surface at a point: see the top of this file.
struct Facing<'a> {
    point: Vec3,
    normal: Vec3,
    radius: f32,
    floor2: f32,
    portals: &'a PortalSet<'a>,
    openings: &'a mut Vec<Opening>,
    /// Whether the openings about the point are known.
    known: bool,
}

impl Filter for Facing<'_> {
    #[inline(always)]
    fn pass<L: Level>(
        &mut self,
        level: L,
        block: &MapBlock,
        d2: &[f32; BLOCK_PHOTONS],
        mask: u32,
    ) -> u32 {
        let counts =
            facing(block, &self.point.to_array(), &self.normal.to_array(), self.floor2, d2);
        let mut mask = mask & level.nonzero16(&counts);
        let mut halo = mask;
        while halo != 0 {
            let i = halo.trailing_zeros() as usize & (BLOCK_PHOTONS - 1);
            halo &= halo - 1;
            if block.direction_flags[i] & HALO != 0 && !self.reachable(block, i) {
                mask &= !(1 << i);
            }
        }
        mask
    }
}

/// [`PHOTON_HALO`] where a block has it.
const HALO: u32 = (PHOTON_HALO as u32) << 24;

/// All ones for each of sixteen photons that lies in the tangent plane, faces alike and came from the front.
#[inline(always)]
fn facing(
    block: &MapBlock,
    point: &[f32; 3],
    normal: &[f32; 3],
    floor2: f32,
    d2: &[f32; BLOCK_PHOTONS],
) -> [u32; BLOCK_PHOTONS] {
    let (x, y, z) = (ways(block, point, 0), ways(block, point, 1), ways(block, point, 2));
    let mut out = [0; BLOCK_PHOTONS];
    for i in 0..BLOCK_PHOTONS {
        // Comparisons with a number that is none are false, and then the photon does not count.
        let height = x[i] * normal[0] + y[i] * normal[1] + z[i] * normal[2];
        let slope = SLAB_SLOPE * SLAB_SLOPE * d2[i];
        let most = if slope > floor2 { slope } else { floor2 };
        let [u, v, w] = along(block.normal_flags[i]);
        let cosine = u * normal[0] + v * normal[1] + w * normal[2];
        let least = NORMAL_COSINE * NORMAL_COSINE * (u * u + v * v + w * w);
        let [a, b, c] = along(block.direction_flags[i]);
        let towards = a * normal[0] + b * normal[1] + c * normal[2];
        let counts = (height * height <= most)
            & (cosine > 0.0)
            & (cosine * cosine > least)
            & (towards < 0.0);
        out[i] = if counts { u32::MAX } else { 0 };
    }
    out
}

impl Facing<'_> {
    /// Whether the straight way to the photon passes an opening.
    #[cold]
    #[inline(never)]
    fn reachable(&mut self, block: &MapBlock, i: usize) -> bool {
        if !self.known {
            self.portals.collect(self.point, self.radius, self.openings);
            self.known = true;
        }
        let to = Vec3::from(block.position_bits.map(|axis| f32::from_bits(axis[i]))).as_dvec3();
        let from = self.point.as_dvec3();
        self.openings.iter().any(|o| o.passes(from, to))
    }
}

/// An octahedral code ([`enf_layout::octahedral`], lowest byte first) as a vector along it, not of unit length: integers
/// up to 2047, exact, without a division or a root.
#[inline]
pub(super) fn direction(b0: u8, b1: u8, b2: u8) -> Vec3 {
    Vec3::from(along(u32::from_le_bytes([b0, b1, b2, 0])))
}

/// The same of the lower 24 bits of a word.
#[inline(always)]
fn along(code: u32) -> [f32; 3] {
    const STEPS: i32 = 2047;
    let (x, y) = ((code & 0xfff) as i32 - STEPS, (code >> 12 & 0xfff) as i32 - STEPS);
    let z = STEPS - x.abs() - y.abs();
    let fold = if z < 0 { -z } else { 0 };
    let x = if x >= 0 { x - fold } else { x + fold };
    let y = if y >= 0 { y - fold } else { y + fold };
    [x as f32, y as f32, z as f32]
}

/// Of a smaller part of a disc it is worth while to look more closely how much there is.
const CLOSER_PART: f64 = 0.7;
/// Bits behind the point of the sum of weights.
const WEIGHT_BITS: i32 = 30;
/// A small thing is no less than this part of its disc.
const SMALLEST_PART: f64 = 0.01;
/// Bits behind the point of the flux sum, below the largest photon's step.
const FRACTION_BITS: i32 = 40;

/// Flux over area. The sum is in fixed point at a scale that the largest photon sets: no order of
/// summation, no rounding that depends on one.
fn estimate(
    map: &PhotonMap<'_>,
    notes: &Notes,
    thing: &mut Thing,
    normal: Vec3,
    point: Vec3,
    largest_radius: f32,
    kernel: Kernel,
) -> Irradiance {
    let (found, distances) = (notes.photons(), notes.distances2());
    if found.is_empty() {
        return Irradiance { vague: true, few: true, ..Irradiance::default() };
    }
    let smallest = SMALLEST_DISC_M.min(SMALLEST_DISC_RADII * largest_radius);
    let (mut radius, mut skipped) = (largest_radius, 0);
    if notes.is_full() || found.len() >= ENDING_PHOTONS {
        // The first is the farthest photon: it gives the disc, unless the disc has a size anyway.
        let farthest = f32::from_bits(distances[0]).sqrt();
        radius = farthest.max(smallest);
        skipped = usize::from(farthest >= smallest);
    }
    let (found, distances) = (&found[skipped..], &distances[skipped..]);
    let (r, r2) = (f64::from(radius), f64::from(radius) * f64::from(radius));
    // Photons in one spot have no edges.
    let enough = if radius > smallest { found.len() } else { 0 };
    let mut lit = Lit::new(enough, normal, r2);
    let (mut exponent, mut caustics) = (0, false);
    for (&number, &d2) in found.iter().zip(distances) {
        let (block, i) = map.place(number);
        exponent = exponent.max(block.flux[i][3]);
        caustics |= block.direction_flags[i] & CAUSTIC != 0;
        if lit.sectors > 0 && block.direction_flags[i] & CAUSTIC == 0 {
            lit.add(Vec3::from(block.position_bits.map(|a| f32::from_bits(a[i]))) - point, d2);
        }
    }
    let few = !notes.is_full() && found.len() < FEWEST_TELLING;
    let vague = few || lit.is_vague(r2);
    // What is vague is looked at more closely, where there is no caustic, which has an end of its own.
    let mut small = None;
    thing.clear();
    let part = lit.share(r2, Kernel::Constant);
    if (vague || part < CLOSER_PART) && radius > smallest && found.len() >= FEWEST {
        let axes = [lit.tangents[0], lit.tangents[1], normal];
        // Behind a slat there is another.
        let flat = SLAB_FLOOR_M.min(SLAB_FLOOR_RADII * largest_radius);
        for (which, (&number, &d2)) in found.iter().zip(distances).enumerate() {
            let (block, i) = map.place(number);
            if block.direction_flags[i] & CAUSTIC == 0 {
                let way = Vec3::from(block.position_bits.map(|a| f32::from_bits(a[i]))) - point;
                if way.dot(normal).abs() <= flat {
                    thing.add(way, axes, d2, which);
                }
            }
        }
        small = thing.measure(radius);
    }
    let few = vague && small.is_none() && !caustics;
    let mut sum = [0u128; 3];
    let mut weights = 0u64;
    let mut add = |which: usize| {
        let (number, d2) = (found[which], distances[which]);
        let (block, i) = map.place(number);
        let [red, green, blue, e] = block.flux[i];
        let d2 = f64::from(f32::from_bits(d2));
        let weight = match kernel {
            Kernel::Constant => 1.0,
            Kernel::Cone => 1.0 - d2.sqrt() / r,
            Kernel::Epanechnikov => 1.0 - d2 / r2,
        };
        let weight = f64::max(weight, 0.0);
        weights += (weight * power_of_two(WEIGHT_BITS)) as u64;
        if e == 0 {
            return;
        }
        let below = i32::from(exponent - e);
        for (sum, mantissa) in sum.iter_mut().zip([red, green, blue]) {
            *sum += match kernel {
                Kernel::Constant => {
                    u128::from((u64::from(mantissa) << FRACTION_BITS) >> below.min(63))
                }
                _ => {
                    let scale = weight * power_of_two(FRACTION_BITS - below);
                    u128::from((f64::from(mantissa) * scale) as u64)
                }
            };
        }
    };
    let disc = std::f64::consts::PI * r2;
    let area = match small {
        Some((area, members)) => {
            let mut count = 0u64;
            for which in members {
                add(which);
                count += 1;
            }
            // The mean weight on the thing, as photons tell it.
            let mean = weights as f64 * power_of_two(-WEIGHT_BITS) / count as f64;
            area.clamp(SMALLEST_PART * disc, disc) * mean
        }
        None => {
            (0..found.len()).for_each(&mut add);
            disc * kernel.volume() * lit.share(r2, kernel)
        }
    };
    let unit = power_of_two(i32::from(exponent) - 128 - 8 - FRACTION_BITS);
    Irradiance {
        rgb: sum.map(|s| (s as f64 * unit / area) as f32),
        photons: notes.photons().len() as u32,
        radius,
        vague,
        few,
    }
}

/// [`PHOTON_CAUSTIC`] where a block has it.
const CAUSTIC: u32 = (PHOTON_CAUSTIC as u32) << 24;

impl Kernel {
    /// Mean of the weights over a disc.
    fn volume(self) -> f64 {
        match self {
            Self::Constant => 1.0,
            Self::Cone => 1.0 / 3.0,
            Self::Epanechnikov => 0.5,
        }
    }

    /// How much of the weights lies in a sector, as a part of what a whole one has, where the farthest of `m` photons is
    /// at `x` of the squared radius.
    ///
    /// Weights integrate to `x`, `3 x - 2 x^(3/2)` and `2 x - x^2`. If a sector ends at `x`, the farthest photon's `p`-th power
    /// is on average `m / (m + p)` of its; the factors take that back term by term, so that the mean is exact.
    fn part(self, x: f64, m: f64) -> f64 {
        let power = |value: f64, p: f64| value * (m + p) / m;
        match self {
            Self::Constant => power(x, 1.0),
            Self::Cone => 3.0 * power(x, 1.0) - 2.0 * power(x * x.sqrt(), 1.5),
            Self::Epanechnikov => 2.0 * power(x, 1.0) - power(x * x, 2.0),
        }
    }
}

/// Fewer photons than these, when there are no more within the radius, are too few to tell anything.
const FEWEST_TELLING: usize = 4 * SECTOR_PHOTONS;
/// A smaller part of a disc is vague: less than is there at a straight edge, by what it may vary.
const VAGUE_PART: f64 = 0.4;
/// Photons crowd if their numbers in cells vary by more than chance and edges explain: by so many standard deviations of chance,
const UNEVEN_DEVIATIONS: f64 = 4.0;
/// and by more than if a good fifth of the area had none: by this, over the mean, when squared.
const UNEVEN_AREA: f64 = 0.3;

/// How much of a disc there is: at the edge of a table, or where the floor meets the wall, a disc goes on and the surface
/// does not, and flux over the disc's area is too little.
///
/// The disc is looked at in sectors. Of `m` photons, spread evenly as far as some distance, the farthest is on average at
/// `m / (m + 1)` of that distance squared; so `(m + 1) / m` of its squared distance says how far the surface goes on
/// in the sector, without a bias, and with little variance. It is an estimate of the same kind as the k-th
/// photon's for the whole disc, and unlike a convex hull (Jensen 2001, section 7.4) it is right in the middle of a
/// surface. Light that varies moves the photons and not where they end. Caustics do end, so their photons are not asked.
struct Lit {
    /// 0 where there are too few photons to tell.
    sectors: usize,
    tangents: [Vec3; 2],
    /// Photons, and the bits of the farthest one's squared distance, m².
    sector: [(u32, u32); MOST_SECTORS],
    /// Cells of equal area: parts of [`RINGS`] rings.
    cells: [u16; MOST_CELLS],
    /// Rings over the squared radius.
    rings: f64,
}

/// Sectors of a disc at most.
const MOST_SECTORS: usize = 32;
/// Rings about the point, each of a quarter of the disc's area.
const RINGS: usize = 4;
/// Cells at most: a ring has half as many as there are sectors.
const MOST_CELLS: usize = MOST_SECTORS / 2 * RINGS;
/// Fewest photons of a sector, on average.
const SECTOR_PHOTONS: usize = 7;
/// No less than this part of a disc is there: as much as in the corner of a box.
const LEAST_PART: f64 = 0.25;

impl Lit {
    fn new(photons: usize, normal: Vec3, r2: f64) -> Self {
        let mut sectors = MOST_SECTORS;
        while sectors >= 4 && photons < sectors * SECTOR_PHOTONS {
            sectors /= 2;
        }
        let sectors = if sectors < 4 { 0 } else { sectors };
        // Duff et al. 2017, "Building an Orthonormal Basis, Revisited".
        let sign = 1.0f32.copysign(normal.z);
        let a = -1.0 / (sign + normal.z);
        let b = normal.x * normal.y * a;
        let tangents = [
            Vec3::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
            Vec3::new(b, sign + normal.y * normal.y * a, -normal.y),
        ];
        Self {
            sectors,
            tangents,
            sector: [(0, 0); MOST_SECTORS],
            cells: [0; MOST_CELLS],
            rings: RINGS as f64 / r2,
        }
    }

    #[inline]
    fn add(&mut self, way: Vec3, d2: u32) {
        let (x, y) = (way.dot(self.tangents[0]), way.dot(self.tangents[1]));
        let (a, b) = (x.abs(), y.abs());
        let (long, short) = if a > b { (a, b) } else { (b, a) };
        // Quarters, eighths, then parts of these by the tangents of pi/8, pi/16 and 3 pi/16.
        let mut sector = usize::from(x < 0.0) | usize::from(y < 0.0) << 1;
        if self.sectors > 4 {
            sector |= usize::from(a > b) << 2;
        }
        if self.sectors > 8 {
            let high = short > long * 0.414_213_56;
            sector |= usize::from(high) << 3;
            if self.sectors > 16 {
                let middle = if high { 0.668_178_6 } else { 0.198_912_37 };
                sector |= usize::from(short > long * middle) << 4;
            }
        }
        let (photons, farthest) = &mut self.sector[sector];
        *photons += 1;
        *farthest = d2.max(*farthest);
        let ring = ((f64::from(f32::from_bits(d2)) * self.rings) as usize).min(RINGS - 1);
        let cell = &mut self.cells[ring * MOST_SECTORS / 2 + (sector & (self.sectors / 2 - 1))];
        *cell = cell.saturating_add(1);
    }

    /// Photons, if they are enough to tell.
    fn told(&self) -> Option<u32> {
        let told = self.sector.iter().map(|s| s.0).sum();
        (self.sectors > 0 && told as usize >= self.sectors * SECTOR_PHOTONS).then_some(told)
    }

    /// Whether most of the disc is not there, or photons crowd in parts of what is there: it lies over several small things, or
    /// one and what is about it. In even light their numbers are Poisson's: the squares of what they differ from their
    /// means by are, on average, the means.
    fn is_vague(&self, r2: f64) -> bool {
        let Some(told) = self.told() else { return false };
        let columns = self.sectors / 2;
        // How much of each cell is there: a column is two sectors.
        let mut there = [0.0f64; MOST_CELLS];
        for (i, &(photons, farthest)) in self.sector[..self.sectors].iter().enumerate() {
            let photons = f64::from(photons.max(1));
            let end = Kernel::Constant.part(f64::from(f32::from_bits(farthest)) / r2, photons);
            for ring in 0..RINGS {
                let cell = ring * MOST_SECTORS / 2 + (i & (columns - 1));
                there[cell] += 0.5 * (end * RINGS as f64 - ring as f64).clamp(0.0, 1.0);
            }
        }
        let area: f64 = there.iter().sum();
        let density = f64::from(told) / area;
        let off = |(&n, &part): (&u16, &f64)| (f64::from(n) - density * part).powi(2);
        let excess = self.cells.iter().zip(&there).map(off).sum::<f64>() / f64::from(told) - 1.0;
        let chance = UNEVEN_DEVIATIONS * (2.0 / area).sqrt();
        area < VAGUE_PART * (columns * RINGS) as f64 || excess > chance.max(UNEVEN_AREA * density)
    }

    /// The part of the disc, weighted with the kernel.
    fn share(&self, r2: f64, kernel: Kernel) -> f64 {
        if self.told().is_none() {
            return 1.0;
        }
        let part = |&(photons, farthest): &(u32, u32)| {
            kernel.part(f64::from(f32::from_bits(farthest)) / r2, f64::from(photons.max(1)))
        };
        let sum: f64 = self.sector[..self.sectors].iter().map(part).sum();
        (sum / self.sectors as f64).max(LEAST_PART)
    }
}

/// `2^e` for the exponents of normal numbers.
fn power_of_two(e: i32) -> f64 {
    f64::from_bits(((e + 1023) as u64) << 52)
}
