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

use enf_layout::photon::{PHOTON_AXIS_MASK, PHOTON_HALO, PhotonRecord};
use glam::Vec3;

use super::map::PhotonMap;
use super::order::stored_cmp;
use super::portals::{Opening, PortalSet};

/// Least cosine between a photon's surface and the query's. Surfaces that meet at 45 degrees, as in an
/// octagonal room, do not share photons.
pub const NORMAL_COSINE: f32 = 0.75;
/// A photon may rise above or lie below the tangent plane by this much of its distance from the point...
pub const SLAB_SLOPE: f32 = 0.25;
/// ... or by this much of the radius,
pub const SLAB_FLOOR_RADII: f32 = 0.02;
/// but the latter by no more than this, m.
pub const SLAB_FLOOR_M: f32 = 0.01;
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
}

/// A photon that counts: the bits of its squared distance, then its index. Squared distances are never
/// negative, hence their bits order as they do.
type Found = u64;

/// A node on the way down, with how far the point is from what lies beyond it, per axis.
#[derive(Clone, Copy, Debug, Default)]
struct Postponed {
    node: u32,
    beyond: [f32; 3],
}

/// Deepest path in a tree of 2^32 photons.
const DEPTH: usize = 33;

/// Levels at the bottom of the tree that are cheaper to look through than to search.
const BOTTOM_LEVELS: u32 = 3;

/// Working memory of one thread that gathers; use it again and again.
#[derive(Clone, Debug)]
pub struct GatherScratch {
    /// A max-heap once it is full.
    found: Vec<Found>,
    postponed: [Postponed; DEPTH],
    openings: Vec<Opening>,
}

impl GatherScratch {
    /// Room for gathers of up to this many photons. (A larger gather makes it grow, once.)
    pub fn new(photons: u32) -> Self {
        Self {
            found: Vec::with_capacity(photons as usize),
            postponed: [Postponed::default(); DEPTH],
            openings: Vec::new(),
        }
    }

    /// Bytes that it occupies now.
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.found.capacity() * size_of::<Found>()
            + self.openings.capacity() * size_of::<Opening>()
    }
}

impl PhotonMap<'_> {
    /// Irradiance on the front of a surface at `point` (m) with unit `normal`, from the nearest photons
    /// that count (see above).
    ///
    /// If `k` photons are found within the radius, the farthest gives the disc and the others the flux
    /// (this form is unbiased in a uniform field); if fewer, all count and the disc has the full
    /// radius. No photon, no light: all zero. So it is for points, normals or radii that are no numbers.
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
        let GatherScratch { found, postponed, openings } = scratch;
        found.clear();
        found.reserve(k);
        let mut search = Search {
            tree: self.tree(),
            point,
            normal,
            radius,
            floor2: squared(SLAB_FLOOR_M.min(SLAB_FLOOR_RADII * radius)),
            k,
            farthest2: squared(radius),
            found,
            dropped: None,
            portals,
            openings,
            openings_known: false,
        };
        search.run::<false>(postponed);
        if search.is_tied() {
            search.found.clear();
            search.run::<true>(postponed);
        }
        estimate(self.tree(), search.found, k, radius, gather.kernel)
    }
}

fn squared(x: f32) -> f32 {
    x * x
}

struct Search<'a> {
    tree: &'a [PhotonRecord],
    point: Vec3,
    normal: Vec3,
    radius: f32,
    floor2: f32,
    k: usize,
    /// Photons farther than this (squared) need not be looked at.
    farthest2: f32,
    found: &'a mut Vec<Found>,
    /// The squared distance at which a photon was last dropped that was no farther than one kept.
    dropped: Option<f32>,
    portals: &'a PortalSet<'a>,
    openings: &'a mut Vec<Opening>,
    openings_known: bool,
}

impl Search<'_> {
    /// Nearer child first; the node itself and what lies beyond it when that comes back, if it is still
    /// near enough. The bound is exact in floating point too: `beyond` is no larger than a photon's own
    /// offset along each axis, and rounding is monotone.
    ///
    /// `TIES`: go by the photons' bytes among equal distances. That is seldom needed, so a search is
    /// made without first, which takes note if it was.
    fn run<const TIES: bool>(&mut self, postponed: &mut [Postponed; DEPTH]) {
        let tree = self.tree;
        let point = self.point.to_array();
        // The first of the subtrees that are looked through without asking further.
        let bottom = (tree.len() + 1).div_ceil(1 << BOTTOM_LEVELS) - 1;
        let (mut node, mut beyond, mut depth) = (0usize, [0.0f32; 3], 0usize);
        loop {
            while node < bottom {
                let photon = &tree[node];
                let (axis, offset) = offset(photon, &point);
                let mut far = beyond;
                far[axis] = offset;
                postponed[depth] = Postponed { node: node as u32, beyond: far };
                depth += 1;
                node = 2 * node + 1 + usize::from(offset > 0.0);
            }
            let (mut first, mut width) = (node, 1);
            while let Some(row) = tree.get(first..tree.len().min(first + width)) {
                for (i, photon) in row.iter().enumerate() {
                    self.consider::<TIES>(first + i, photon);
                }
                first = 2 * first + 1;
                width *= 2;
            }
            loop {
                if depth == 0 {
                    return;
                }
                depth -= 1;
                let next = &postponed[depth];
                let [x, y, z] = next.beyond;
                if (x * x + y * y) + z * z <= self.farthest2 {
                    let here = next.node as usize;
                    beyond = next.beyond;
                    let photon = &tree[here];
                    self.consider::<TIES>(here, photon);
                    let (_, offset) = offset(photon, &point);
                    node = 2 * here + 2 - usize::from(offset > 0.0);
                    break;
                }
            }
        }
    }

    #[inline]
    fn consider<const TIES: bool>(&mut self, index: usize, photon: &PhotonRecord) {
        let way = position(photon) - self.point;
        let d2 = way.length_squared();
        if d2 <= self.farthest2 && self.counts(photon, way, d2) {
            self.keep::<TIES>((u64::from(d2.to_bits()) << 32) | index as u64);
        }
    }

    /// Whether several photons are at exactly the k-th distance: then it matters which of them is the
    /// k-th, and which were dropped.
    fn is_tied(&self) -> bool {
        let ties = |f: &Found| distance2(*f) == self.farthest2;
        self.found.len() == self.k
            && (self.dropped == Some(self.farthest2) || self.found.iter().skip(1).take(2).any(ties))
    }

    /// Whether the photon counts, its distance apart.
    #[inline]
    fn counts(&mut self, photon: &PhotonRecord, way: Vec3, d2: f32) -> bool {
        // Comparisons with a number that is none are false, and then the photon does not count.
        let height = way.dot(self.normal);
        let in_slab = height * height <= (SLAB_SLOPE * SLAB_SLOPE * d2).max(self.floor2);
        if !in_slab {
            return false;
        }
        let [d0, d1, d2, n0, n1, n2] = photon.directions;
        let surface = direction(n0, n1, n2);
        let cosine = surface.dot(self.normal);
        let least = NORMAL_COSINE * NORMAL_COSINE * surface.length_squared();
        let faces_alike = cosine > 0.0 && cosine * cosine > least;
        let from_the_front = direction(d0, d1, d2).dot(self.normal) < 0.0;
        if !(faces_alike && from_the_front) {
            return false;
        }
        photon.flags & PHOTON_HALO == 0 || self.reachable(photon)
    }

    /// Whether the straight way to the photon passes an opening.
    fn reachable(&mut self, photon: &PhotonRecord) -> bool {
        if !self.openings_known {
            self.portals.collect(self.point, self.radius, self.openings);
            self.openings_known = true;
        }
        let (from, to) = (self.point.as_dvec3(), position(photon).as_dvec3());
        self.openings.iter().any(|o| o.passes(from, to))
    }

    /// Keeps the `k` nearest; among equals, with `TIES`, the first in the order of the photons' bytes.
    #[inline]
    fn keep<const TIES: bool>(&mut self, new: Found) {
        let Some(&farthest) = self.found.first().filter(|_| self.found.len() == self.k) else {
            self.found.push(new);
            if self.found.len() == self.k {
                for root in (0..self.k / 2).rev() {
                    self.sift::<TIES>(root);
                }
                self.farthest2 = distance2(self.found[0]);
            }
            return;
        };
        if TIES {
            if !self.farther::<TIES>(farthest, new) {
                return;
            }
        } else if distance2(new) == distance2(farthest) {
            self.dropped = Some(self.farthest2);
            return;
        }
        self.found[0] = new;
        self.sift::<TIES>(0);
        self.farthest2 = distance2(self.found[0]);
        if !TIES && self.farthest2 == distance2(farthest) {
            self.dropped = Some(self.farthest2);
        }
    }

    #[inline]
    fn farther<const TIES: bool>(&self, a: Found, b: Found) -> bool {
        if TIES && a >> 32 == b >> 32 {
            return stored_cmp(photon(self.tree, a), photon(self.tree, b)).is_gt();
        }
        a > b
    }

    /// Restores the heap below `root`.
    #[inline]
    fn sift<const TIES: bool>(&mut self, mut root: usize) {
        let moving = self.found[root];
        let mut child = 2 * root + 1;
        while child < self.found.len() {
            let sibling = (child + 1).min(self.found.len() - 1);
            let farther = self.farther::<TIES>(self.found[sibling], self.found[child]);
            child = if farther { sibling } else { child };
            if !self.farther::<TIES>(self.found[child], moving) {
                break;
            }
            self.found[root] = self.found[child];
            root = child;
            child = 2 * root + 1;
        }
        self.found[root] = moving;
    }
}

#[inline]
fn distance2(found: Found) -> f32 {
    f32::from_bits((found >> 32) as u32)
}

#[inline]
fn photon(tree: &[PhotonRecord], found: Found) -> &PhotonRecord {
    &tree[(found & 0xffff_ffff) as usize]
}

/// [`PhotonRecord::position`], here so that it is inlined: every photon that is looked at comes by.
#[inline]
fn position(photon: &PhotonRecord) -> Vec3 {
    let [x, y, z] = photon.position_bits;
    Vec3::new(f32::from_bits(x), f32::from_bits(y), f32::from_bits(z))
}

/// The node's axis, and how far the point is in front of it along that axis.
#[inline]
fn offset(photon: &PhotonRecord, point: &[f32; 3]) -> (usize, f32) {
    let axis = usize::from(photon.flags & PHOTON_AXIS_MASK).min(2);
    (axis, point[axis] - f32::from_bits(photon.position_bits[axis]))
}

/// An octahedral code ([`enf_layout::octahedral`]) as a vector along it, not of unit length: integers
/// up to 2047, exact, without a division or a root.
#[inline]
pub(super) fn direction(b0: u8, b1: u8, b2: u8) -> Vec3 {
    const STEPS: i32 = 2047;
    let code = i32::from(b0) | i32::from(b1) << 8 | i32::from(b2) << 16;
    let (x, y) = ((code & 0xfff) - STEPS, (code >> 12) - STEPS);
    let z = STEPS - x.abs() - y.abs();
    let fold = (-z).max(0);
    let x = if x >= 0 { x - fold } else { x + fold };
    let y = if y >= 0 { y - fold } else { y + fold };
    Vec3::new(x as f32, y as f32, z as f32)
}

/// Bits behind the point of the flux sum, below the largest photon's step.
const FRACTION_BITS: i32 = 40;

/// Flux over area. The sum is in fixed point at a scale that the largest photon sets: no order of
/// summation, no rounding that depends on one.
fn estimate(
    tree: &[PhotonRecord],
    found: &[Found],
    k: usize,
    largest_radius: f32,
    kernel: Kernel,
) -> Irradiance {
    if found.is_empty() {
        return Irradiance::default();
    }
    let smallest = SMALLEST_DISC_M.min(SMALLEST_DISC_RADII * largest_radius);
    let (mut radius, mut counted) = (largest_radius, found);
    if found.len() == k {
        // The heap's root is the farthest photon: it gives the disc, unless the disc has a size anyway.
        let farthest = distance2(found[0]).sqrt();
        radius = farthest.max(smallest);
        if farthest >= smallest {
            counted = &found[1..];
        }
    }
    let exponent = counted.iter().map(|&f| photon(tree, f).flux[3]).max().unwrap_or(0);
    let (r, r2) = (f64::from(radius), f64::from(radius) * f64::from(radius));
    let mut sum = [0u128; 3];
    for &f in counted {
        let d2 = f64::from(distance2(f));
        let weight = match kernel {
            Kernel::Constant => 1.0,
            Kernel::Cone => 1.0 - d2.sqrt() / r,
            Kernel::Epanechnikov => 1.0 - d2 / r2,
        };
        let [red, green, blue, e] = photon(tree, f).flux;
        if e == 0 {
            continue;
        }
        let scale = weight.max(0.0) * power_of_two(FRACTION_BITS - i32::from(exponent - e));
        for (sum, mantissa) in sum.iter_mut().zip([red, green, blue]) {
            *sum += u128::from((f64::from(mantissa) * scale) as u64);
        }
    }
    let volume = match kernel {
        Kernel::Constant => 1.0,
        Kernel::Cone => 1.0 / 3.0,
        Kernel::Epanechnikov => 0.5,
    };
    let unit = power_of_two(i32::from(exponent) - 128 - 8 - FRACTION_BITS);
    let area = std::f64::consts::PI * r2 * volume;
    Irradiance {
        rgb: sum.map(|s| (s as f64 * unit / area) as f32),
        photons: found.len() as u32,
        radius,
    }
}

/// `2^e` for the exponents of normal numbers.
fn power_of_two(e: i32) -> f64 {
    f64::from_bits(((e + 1023) as u64) << 52)
}
