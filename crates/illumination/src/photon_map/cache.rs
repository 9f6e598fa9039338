//! Irradiance kept at photons, so that a picture need not gather at every sample (Christensen 1999, "Faster
//! Photon Map Global Illumination", Journal of Graphics Tools 4(3)): a gather looks at a hundred photons or more,
//! the nearest few places where it was done already are found in a tenth of the time.
//!
//! Every fourth photon of the tree is such a place. Its irradiance is computed when it is first asked for and
//! depends on the map alone, so it does not matter who asked, or when. A query takes the mean of the nearest
//! places, weighted down to zero at the farthest of them: the result is continuous across the surface.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use enf_layout::photon::{PHOTON_AXIS_MASK, PHOTON_HALO, PhotonRecord};
use glam::Vec3;

use super::gather::{Gather, GatherScratch, direction};
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

/// One place's irradiance; `blue` has its high word set when it is there.
#[derive(Default)]
struct Place {
    red: AtomicU32,
    green: AtomicU32,
    blue: AtomicU64,
}

const THERE: u64 = 1 << 32;

/// Irradiance at every fourth photon of one map.
pub struct IrradianceCache {
    places: Vec<Place>,
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
        (photons.div_ceil(STRIDE) * size_of::<Place>()) as u64
    }

    /// An empty cache for a map of this many photons; the caller has the memory reserved.
    pub fn new(photons: usize) -> Self {
        let mut places = Vec::new();
        places.resize_with(photons.div_ceil(STRIDE), Place::default);
        Self { places }
    }

    /// Irradiance at `point` (m) with unit `normal`, W/m²: the mean of the nearest places, or, where none is near, a
    /// gather of its own. `gather`, `portals` and the map must be the same at every call.
    pub fn irradiance(
        &self,
        map: &PhotonMap<'_>,
        point: Vec3,
        normal: Vec3,
        gather: &Gather,
        portals: &PortalSet<'_>,
        scratch: &mut GatherScratch,
    ) -> [f32; 3] {
        let tree = map.tree();
        let mut near = [Near { d2: f32::INFINITY, index: u32::MAX }; PLACES];
        // Places as far away as a gather may reach say nothing about here.
        let reach = gather.radius.min(map.radius()) * 0.5;
        near[PLACES - 1].d2 = reach * reach;
        search(tree, 0, point, normal, &mut near);
        let found = near.iter().take_while(|n| n.index != u32::MAX).count();
        if found < 2 || near[0].d2 >= near[found - 1].d2 {
            return map.irradiance(point, normal, gather, portals, scratch).rgb;
        }
        let farthest = if found == PLACES { near[PLACES - 1].d2 } else { reach * reach };
        let (mut sum, mut total) = (Vec3::ZERO, 0.0f32);
        for place in &near[..found] {
            let weight = 1.0 - place.d2 / farthest;
            if weight > 0.0 {
                sum += self.at(map, place.index as usize, gather, portals, scratch) * weight;
                total += weight;
            }
        }
        (sum / total).to_array()
    }

    fn at(
        &self,
        map: &PhotonMap<'_>,
        index: usize,
        gather: &Gather,
        portals: &PortalSet<'_>,
        scratch: &mut GatherScratch,
    ) -> Vec3 {
        let place = &self.places[index / STRIDE];
        let blue = place.blue.load(Ordering::Acquire);
        if blue & THERE != 0 {
            return Vec3::new(
                f32::from_bits(place.red.load(Ordering::Relaxed)),
                f32::from_bits(place.green.load(Ordering::Relaxed)),
                f32::from_bits(blue as u32),
            );
        }
        let photon = &map.tree()[index];
        let [.., n0, n1, n2] = photon.directions;
        let normal = direction(n0, n1, n2).normalize();
        let rgb = map.irradiance(position(photon), normal, gather, portals, scratch).rgb;
        // Two threads may both have computed it; they write the same bits.
        place.red.store(rgb[0].to_bits(), Ordering::Relaxed);
        place.green.store(rgb[1].to_bits(), Ordering::Relaxed);
        place.blue.store(THERE | u64::from(rgb[2].to_bits()), Ordering::Release);
        Vec3::from(rgb)
    }
}

fn position(photon: &PhotonRecord) -> Vec3 {
    Vec3::from(photon.position_bits.map(f32::from_bits))
}

/// The nearest places of the subtree at `node`, nearer child first; equal distances go by index.
fn search(
    tree: &[PhotonRecord],
    node: usize,
    point: Vec3,
    normal: Vec3,
    near: &mut [Near; PLACES],
) {
    let Some(photon) = tree.get(node) else { return };
    let axis = usize::from(photon.flags & PHOTON_AXIS_MASK).min(2);
    let offset = point[axis] - f32::from_bits(photon.position_bits[axis]);
    let nearer = 2 * node + 1 + usize::from(offset > 0.0);
    search(tree, nearer, point, normal, near);
    if node.is_multiple_of(STRIDE) && photon.flags & PHOTON_HALO == 0 {
        consider(photon, node as u32, point, normal, near);
    }
    if offset * offset <= near[PLACES - 1].d2 {
        search(tree, 4 * node + 3 - nearer, point, normal, near);
    }
}

fn consider(
    photon: &PhotonRecord,
    index: u32,
    point: Vec3,
    normal: Vec3,
    near: &mut [Near; PLACES],
) {
    let way = position(photon) - point;
    let d2 = way.length_squared();
    if d2 > near[PLACES - 1].d2 || d2.is_nan() {
        return;
    }
    let height = way.dot(normal);
    if height * height > (SLAB_SLOPE * SLAB_SLOPE * d2).max(SLAB_FLOOR_M * SLAB_FLOOR_M) {
        return;
    }
    let [.., n0, n1, n2] = photon.directions;
    let surface = direction(n0, n1, n2);
    let cosine = surface.dot(normal);
    if cosine <= 0.0 || cosine * cosine < NORMAL_COSINE * NORMAL_COSINE * surface.length_squared() {
        return;
    }
    let mut at = PLACES - 1;
    if d2 == near[at].d2 && index > near[at].index {
        return;
    }
    while at > 0 && (d2, index) < (near[at - 1].d2, near[at - 1].index) {
        near[at] = near[at - 1];
        at -= 1;
    }
    near[at] = Near { d2, index };
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photon_map::{Kernel, build_tree};
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
        let mut photons = plane(20_000);
        let mut scratch = photons.clone();
        build_tree(&mut photons, &mut scratch, 1);
        let blob = PhotonMap::build_blob(&photons, 0, 0.5);
        let map = PhotonMap::from_blob(&blob).unwrap();
        let cache = IrradianceCache::new(map.len());
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
                    cache.irradiance(&map, p, normal, &gather, &PortalSet::none(), &mut scratch)[0],
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
        let mut photons = plane(3_000);
        let mut scratch = photons.clone();
        build_tree(&mut photons, &mut scratch, 1);
        let blob = PhotonMap::build_blob(&photons, 0, 0.5);
        let map = PhotonMap::from_blob(&blob).unwrap();
        let gather = Gather { photons: 50, radius: 0.5, kernel: Kernel::Constant };
        let mut scratch = GatherScratch::new(50);
        let points: Vec<Vec3> = (0..100)
            .map(|i| Vec3::new(i as f32 / 100.0, (i * 37 % 100) as f32 / 100.0, 0.0))
            .collect();
        let mut all = |order: &mut dyn Iterator<Item = usize>| {
            let cache = IrradianceCache::new(map.len());
            let mut out = vec![[0.0; 3]; points.len()];
            for i in order {
                out[i] = cache.irradiance(
                    &map,
                    points[i],
                    Vec3::Z,
                    &gather,
                    &PortalSet::none(),
                    &mut scratch,
                );
            }
            out
        };
        assert_eq!(all(&mut (0..100)), all(&mut (0..100).rev()));
    }
}
