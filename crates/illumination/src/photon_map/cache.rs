//! Irradiance kept at photons, so that a picture need not gather at every sample (Christensen 1999, "Faster
//! Photon Map Global Illumination", Journal of Graphics Tools 4(3)): a gather looks at a hundred photons or more,
//! the nearest few places where it was done already are found in a tenth of the time.
//!
//! Every fourth photon of the map is such a place. Its irradiance is computed when it is first asked for and
//! depends on the map alone, so it does not matter who asked, or when. A query takes the mean of the nearest
//! places, weighted down to zero at the farthest of them: the result is continuous across the surface.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use enf_layout::photon::{PHOTON_HALO, PhotonRecord};
use glam::Vec3;

use super::gather::{Gather, GatherScratch, Irradiance, direction};
use super::map::PhotonMap;
use super::portals::PortalSet;

/// One photon in so many is a place.
const STRIDE: usize = 4;
/// Places that a query looks for; the farthest has no weight.
const PLACES: usize = 6;
/// Least cosine between the normals of a query and of a place.
const NORMAL_COSINE: f32 = 0.95;
/// A place lies in the surface's plane to this slope, or to this height, m.
const SLAB_SLOPE: f32 = 0.1;
const SLAB_FLOOR_M: f32 = 0.004;

/// One place's irradiance; the high word of `blue` is its radius, with the sign set when it is there, and the lowest bits
/// where it is vague and of few photons.
#[derive(Default)]
struct Value {
    red: AtomicU32,
    green: AtomicU32,
    blue: AtomicU64,
}

const THERE: u64 = 1 << 63;
const VAGUE: u64 = 1 << 32;
const FEW: u64 = 1 << 33;

/// Where a place is. Places whose normals have the same largest axis make a kd-tree of their own: a query
/// never looks at the table's legs to find the table's top.
#[derive(Clone, Copy)]
struct Place {
    position: [f32; 3],
    /// Octahedral normal, and the node's axis above it.
    normal_axis: u32,
    /// The photon in the map.
    photon: u32,
}

/// Irradiance at every fourth photon of one map.
pub struct IrradianceCache {
    /// The trees one after the other: the middle of a range is its root.
    places: Vec<Place>,
    values: Vec<Value>,
    /// Where the six trees begin, and the end.
    trees: [u32; 7],
}

/// The places of a cache, from the photons of a map that is seen piece by piece.
pub struct Places {
    places: Vec<Place>,
    seen: usize,
}

impl Places {
    /// None yet, of a map with so many photons.
    pub fn of(photons: usize) -> Self {
        Self { places: Vec::with_capacity(photons.div_ceil(STRIDE)), seen: 0 }
    }

    /// The map's next photon ([`PhotonMap::photons`]).
    pub fn add(&mut self, number: u32, photon: &PhotonRecord) {
        let chosen = self.seen.is_multiple_of(STRIDE);
        self.seen += 1;
        // A cache never has more places than were reserved.
        let free = self.places.len() < self.places.capacity();
        if chosen && free && photon.flags & PHOTON_HALO == 0 {
            let [.., n0, n1, n2] = photon.directions;
            let bin = bin_of(direction(n0, n1, n2)) as u8;
            self.places.push(Place {
                position: photon.position(),
                // The tree's number, until it is planted.
                normal_axis: u32::from_le_bytes([n0, n1, n2, bin]),
                photon: number,
            });
        }
    }
}

/// A place that was found: squared distance, then index.
#[derive(Clone, Copy)]
struct Near {
    d2: f32,
    index: u32,
}

impl IrradianceCache {
    /// Bytes of a cache for a map of this many photons.
    pub fn bytes(photons: usize) -> u64 {
        (photons.div_ceil(STRIDE) * (size_of::<Place>() + size_of::<Value>())) as u64
    }

    /// An empty cache for a map; the caller has the memory reserved.
    pub fn new(map: &PhotonMap<'_>) -> Self {
        let mut places = Places::of(map.len());
        map.photons().for_each(|(number, photon)| places.add(number, &photon));
        Self::at_places(places)
    }

    /// An empty cache at these places.
    pub fn at_places(places: Places) -> Self {
        let mut places = places.places;
        places.sort_unstable_by_key(|place| (place.axis(), place.photon));
        let trees =
            [0, 1, 2, 3, 4, 5, 6].map(|bin| places.partition_point(|p| p.axis() < bin) as u32);
        for place in &mut places {
            place.normal_axis &= 0x00ff_ffff;
        }
        for range in trees.windows(2) {
            plant(&mut places[range[0] as usize..range[1] as usize]);
        }
        let mut values = Vec::new();
        values.resize_with(places.len(), Value::default);
        Self { places, values, trees }
    }

    /// Irradiance at `point` (m) with unit `normal`, W/m²: the mean of the nearest places, or, where none is near, a
    /// gather of its own; with the mean radius of the discs that it comes from: what is nearer than that is
    /// blurred. It is vague, or of few, if one of them is. `photons` counts those of a gather of its own, else 0. `gather`, `portals` and the map must be the same at every
    /// call.
    pub fn estimate(
        &self,
        map: &PhotonMap<'_>,
        point: Vec3,
        normal: Vec3,
        gather: &Gather,
        portals: &PortalSet<'_>,
        scratch: &mut GatherScratch,
    ) -> Irradiance {
        // Places as far away as a gather may reach say nothing about here.
        let reach = gather.radius.min(map.radius()) * 0.5;
        let mut search = Search {
            places: &self.places,
            point,
            normal,
            near: [Near { d2: reach * reach, index: u32::MAX }; PLACES],
        };
        let bin = bin_of(normal);
        search.range(self.trees[bin] as usize, self.trees[bin + 1] as usize, [0.0; 3]);
        let near = &search.near;
        let found = near.iter().take_while(|n| n.index != u32::MAX).count();
        let farthest = near[PLACES - 1].d2;
        if found < 2 || near[0].d2 >= farthest {
            return map.irradiance(point, normal, gather, portals, scratch);
        }
        let (mut sum, mut radius, mut total) = (Vec3::ZERO, 0.0f32, 0.0f32);
        let (mut vague, mut few) = (false, false);
        for place in &near[..found] {
            let weight = 1.0 - place.d2 / farthest;
            if weight > 0.0 {
                let at = self.at(map, place.index as usize, gather, portals, scratch);
                sum += Vec3::from(at.rgb) * weight;
                radius += at.radius * weight;
                vague |= at.vague;
                few |= at.few;
                total += weight;
            }
        }
        Irradiance { rgb: (sum / total).to_array(), photons: 0, radius: radius / total, vague, few }
    }

    /// Irradiance at a place.
    fn at(
        &self,
        map: &PhotonMap<'_>,
        index: usize,
        gather: &Gather,
        portals: &PortalSet<'_>,
        scratch: &mut GatherScratch,
    ) -> Irradiance {
        let value = &self.values[index];
        let mut blue = value.blue.load(Ordering::Acquire);
        if blue & THERE == 0 {
            let place = &self.places[index];
            let normal = place.normal().normalize();
            let point = Vec3::from(place.position);
            let found = map.irradiance(point, normal, gather, portals, scratch);
            if scratch.is_missing() {
                return Irradiance::default();
            }
            // Two threads may both have computed it; they write the same bits.
            let [red, green, low] = found.rgb.map(f32::to_bits);
            value.red.store(red, Ordering::Relaxed);
            value.green.store(green, Ordering::Relaxed);
            let radius = u64::from(found.radius.to_bits()) << 32 & !(VAGUE | FEW);
            let marks = if found.vague { VAGUE } else { 0 } | if found.few { FEW } else { 0 };
            blue = THERE | radius | marks | u64::from(low);
            value.blue.store(blue, Ordering::Release);
        }
        let (red, green) = (&value.red, &value.green);
        Irradiance {
            rgb: [
                f32::from_bits(red.load(Ordering::Relaxed)),
                f32::from_bits(green.load(Ordering::Relaxed)),
                f32::from_bits(blue as u32),
            ],
            photons: 0,
            radius: f32::from_bits(((blue & !(THERE | VAGUE | FEW)) >> 32) as u32),
            vague: blue & VAGUE != 0,
            few: blue & FEW != 0,
        }
    }
}

impl Place {
    fn normal(&self) -> Vec3 {
        let [n0, n1, n2, _] = self.normal_axis.to_le_bytes();
        direction(n0, n1, n2)
    }

    fn axis(&self) -> usize {
        (self.normal_axis >> 24) as usize
    }
}

/// The axis along which a direction points most, twice, plus 1 if it points backwards.
fn bin_of(direction: Vec3) -> usize {
    let size = direction.abs();
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    2 * axis + usize::from(direction[axis] < 0.0)
}

/// Makes a kd-tree of a range: its middle is the root, split along its box's longest side.
fn plant(places: &mut [Place]) {
    if places.len() < 2 {
        return;
    }
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for place in places.iter() {
        for c in 0..3 {
            min[c] = min[c].min(place.position[c]);
            max[c] = max[c].max(place.position[c]);
        }
    }
    let size = [0, 1, 2].map(|c| max[c] - min[c]);
    let axis = (0..3).fold(0, |best, c| if size[c] > size[best] { c } else { best });
    let middle = places.len() / 2;
    places.select_nth_unstable_by(middle, |a, b| {
        a.position[axis].total_cmp(&b.position[axis]).then(a.photon.cmp(&b.photon))
    });
    places[middle].normal_axis |= (axis as u32) << 24;
    let (before, after) = places.split_at_mut(middle);
    plant(before);
    plant(&mut after[1..]);
}

struct Search<'a> {
    places: &'a [Place],
    point: Vec3,
    normal: Vec3,
    near: [Near; PLACES],
}

impl Search<'_> {
    /// Looks through a range, nearer half first; `beyond` is how far its box is from the point, per axis.
    fn range(&mut self, first: usize, end: usize, beyond: [f32; 3]) {
        if first >= end {
            return;
        }
        let middle = first + (end - first) / 2;
        let place = self.places[middle];
        let axis = place.axis();
        let offset = self.point[axis] - place.position[axis];
        let (nearer, farther) = if offset > 0.0 {
            ((middle + 1, end), (first, middle))
        } else {
            ((first, middle), (middle + 1, end))
        };
        self.range(nearer.0, nearer.1, beyond);
        self.consider(&place, middle as u32);
        let mut far = beyond;
        far[axis] = offset;
        if far[0] * far[0] + far[1] * far[1] + far[2] * far[2] <= self.near[PLACES - 1].d2 {
            self.range(farther.0, farther.1, far);
        }
    }

    fn consider(&mut self, place: &Place, index: u32) {
        let way = Vec3::from(place.position) - self.point;
        let d2 = way.length_squared();
        let near = &mut self.near;
        if (d2, index) >= (near[PLACES - 1].d2, near[PLACES - 1].index) || d2.is_nan() {
            return;
        }
        let height = way.dot(self.normal);
        if height * height > (SLAB_SLOPE * SLAB_SLOPE * d2).max(SLAB_FLOOR_M * SLAB_FLOOR_M) {
            return;
        }
        let surface = place.normal();
        let cosine = surface.dot(self.normal);
        let least = NORMAL_COSINE * NORMAL_COSINE * surface.length_squared();
        if cosine <= 0.0 || cosine * cosine < least {
            return;
        }
        let mut at = PLACES - 1;
        while at > 0 && (d2, index) < (near[at - 1].d2, near[at - 1].index) {
            near[at] = near[at - 1];
            at -= 1;
        }
        near[at] = Near { d2, index };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photon_map::Kernel;
    use enf_layout::photon::PhotonRecord;
    use enf_layout::{octahedral, rgbe};

    /// A unit square at z = 0 with photons from above, and one just below it that faces down.
    fn plane(n: usize) -> Vec<PhotonRecord> {
        let mut state = 1u64;
        let mut next = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        (0..n)
            .map(|i| {
                let up = i % 2 == 0;
                let z = if up { 0.0f32 } else { -0.02 };
                let n = if up { 1.0 } else { -1.0 };
                PhotonRecord {
                    position_bits: [next(), next(), z].map(f32::to_bits),
                    flux: rgbe::encode([if up { 2.0 } else { 20.0 } / n_of(i) as f32; 3], [0.5; 3]),
                    directions: PhotonRecord::pack_directions(
                        octahedral::encode([0.0, 0.0, -n]),
                        octahedral::encode([0.0, 0.0, n]),
                    ),
                    flags: 0,
                }
            })
            .collect()
    }

    fn n_of(_: usize) -> usize {
        20_000
    }

    #[test]
    fn a_uniform_plane_has_its_irradiance_and_the_other_side_its_own() {
        let photons = plane(20_000);
        let blob = PhotonMap::build_blob(&photons, 0.5);
        let map = PhotonMap::from_blob(&blob).unwrap();
        let cache = IrradianceCache::new(&map);
        let gather = Gather { photons: 200, radius: 0.5, kernel: Kernel::Constant };
        let mut scratch = GatherScratch::new(200);
        let mut sums = [0.0f64; 2];
        let n = 400;
        for i in 0..n {
            let p = Vec3::new(
                0.25 + 0.5 * (i % 20) as f32 / 20.0,
                0.25 + 0.5 * (i / 20) as f32 / 20.0,
                0.0,
            );
            let mut ask = |p, normal| {
                f64::from(
                    cache.estimate(&map, p, normal, &gather, &PortalSet::none(), &mut scratch).rgb
                        [0],
                )
            };
            sums[0] += ask(p, Vec3::Z) / f64::from(n);
            sums[1] += ask(p - Vec3::Z * 0.02, -Vec3::Z) / f64::from(n);
        }
        // 10,000 photons of 2/20,000 W on 1 m2; some thousand of them are in the middle: 4 sigma is 7 %.
        assert!((sums[0] - 1.0).abs() < 0.07, "{}", sums[0]);
        assert!((sums[1] - 10.0).abs() < 0.7, "{}", sums[1]);
    }

    #[test]
    fn it_does_not_matter_what_was_asked_before() {
        let photons = plane(3_000);
        let blob = PhotonMap::build_blob(&photons, 0.5);
        let map = PhotonMap::from_blob(&blob).unwrap();
        let gather = Gather { photons: 50, radius: 0.5, kernel: Kernel::Constant };
        let mut scratch = GatherScratch::new(50);
        let points: Vec<Vec3> = (0..100)
            .map(|i| Vec3::new(i as f32 / 100.0, (i * 37 % 100) as f32 / 100.0, 0.0))
            .collect();
        let mut all = |order: &mut dyn Iterator<Item = usize>| {
            let cache = IrradianceCache::new(&map);
            let mut out = vec![[0.0; 3]; points.len()];
            for i in order {
                out[i] = cache
                    .estimate(&map, points[i], Vec3::Z, &gather, &PortalSet::none(), &mut scratch)
                    .rgb;
            }
            out
        };
        assert_eq!(all(&mut (0..100)), all(&mut (0..100).rev()));
    }
}
