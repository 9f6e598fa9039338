//! Gathering, against brute force and against what can be worked out on paper.

use std::f32::consts::PI;

use enf_layout::octahedral;
use enf_layout::photon::{PHOTON_CAUSTIC, PHOTON_HALO, PhotonRecord};
use glam::Vec3;
use proptest::prelude::*;
use zerocopy::IntoBytes;

use super::tests_support::{Random, coarse_photon, door, impact, shuffled};
use super::*;

fn blob(photons: &[PhotonRecord], radius: f32) -> Vec<u8> {
    let blob = PhotonMap::build_blob(photons, radius);
    PhotonMap::from_blob(&blob).unwrap().check().unwrap();
    blob
}

fn ask(blob: &[u8], point: Vec3, normal: Vec3, gather: &Gather, portals: &PortalSet) -> Irradiance {
    let map = PhotonMap::from_blob(blob).unwrap();
    map.irradiance(point, normal, gather, portals, &mut GatherScratch::new(4))
}

fn bits(e: &Irradiance) -> ([u32; 3], u32, u32) {
    (e.rgb.map(f32::to_bits), e.photons, e.radius.to_bits())
}

/// Every photon tested, those that count sorted, the first k summed one by one in floating point.
fn brute_force(
    photons: &[PhotonRecord],
    x: Vec3,
    n: Vec3,
    gather: &Gather,
    portals: &PortalSet,
    vague: bool,
) -> ([f64; 3], u32, f32) {
    let floor = SLAB_FLOOR_M.min(SLAB_FLOOR_RADII * gather.radius);
    let mut found: Vec<(u32, Vec<u8>, &PhotonRecord)> = Vec::new();
    for p in photons {
        let way = Vec3::from(p.position()) - x;
        let d2 = way.length_squared();
        let height = way.dot(n);
        let counts = d2 <= gather.radius * gather.radius
            && height * height <= (SLAB_SLOPE * SLAB_SLOPE * d2).max(floor * floor)
            && Vec3::from(p.normal()).dot(n) > NORMAL_COSINE
            && Vec3::from(p.direction()).dot(n) < 0.0
            && (p.flags & PHOTON_HALO == 0 || portals.crosses(x, Vec3::from(p.position())));
        if counts {
            let mut stored = *p;
            stored.flags &= !PHOTON_HALO;
            found.push((d2.to_bits(), stored.as_bytes().to_vec(), p));
        }
    }
    found.sort_by(|a, b| (a.0, &a.1).cmp(&(b.0, &b.1)));
    let k = gather.photons as usize;
    found.truncate(k);
    if found.is_empty() {
        return ([0.0; 3], 0, 0.0);
    }
    let number = found.len() as u32;
    let (mut radius, smallest) = (gather.radius, SMALLEST_DISC_M.min(1e-3 * gather.radius));
    if found.len() == k || found.len() >= ENDING_PHOTONS {
        let farthest = f32::from_bits(found[found.len() - 1].0).sqrt();
        radius = farthest.max(smallest);
        if farthest >= smallest {
            found.pop();
        }
    }
    let r = f64::from(radius);
    let mut rgb = [0.0; 3];
    let mut part = part_of_disc(&found, x, n, r, gather.kernel);
    let closer = vague || part_of_disc(&found, x, n, r, Kernel::Constant) < 0.7;
    if closer
        && radius > smallest
        && let Some((area, on_it)) = small_thing(&found, x, n, r, floor)
    {
        found = on_it;
        let weight = |d2: f64| match gather.kernel {
            Kernel::Constant => 1.0,
            Kernel::Cone => 3.0 * (1.0 - d2.sqrt() / r),
            Kernel::Epanechnikov => 2.0 * (1.0 - d2 / r / r),
        };
        let sum: f64 = found.iter().map(|f| weight(f64::from(f32::from_bits(f.0)))).sum();
        let share = area / (std::f64::consts::PI * r * r);
        part = share.clamp(0.01, 1.0) * sum / found.len() as f64;
    }
    for (d2, _, p) in &found {
        let d = f64::from(f32::from_bits(*d2)).sqrt();
        let (weight, volume) = match gather.kernel {
            Kernel::Constant => (1.0, 1.0),
            Kernel::Cone => (1.0 - d / r, 1.0 / 3.0),
            Kernel::Epanechnikov => (1.0 - d * d / r / r, 0.5),
        };
        for (sum, flux) in rgb.iter_mut().zip(p.flux_w()) {
            *sum += f64::from(flux) * f64::max(weight, 0.0)
                / (std::f64::consts::PI * r * r * volume * part);
        }
    }
    (rgb, number, radius)
}

/// A photon that was found: squared distance, order, record.
type Found<'a> = (u32, Vec<u8>, &'a PhotonRecord);

/// The area of the thing on which the nearest photons lie, and its photons, by definition: everybody within a hop, again and
/// again; a side of the hull has nobody on its right.
fn small_thing<'a>(
    found: &[Found<'a>],
    x: Vec3,
    n: Vec3,
    r: f64,
    floor: f32,
) -> Option<(f64, Vec<Found<'a>>)> {
    let (u, v) = tangents(n);
    let way = |f: &Found| Vec3::from(f.2.position()) - x;
    let seen = |f: &Found| Vec3::new(way(f).dot(u), way(f).dot(v), way(f).dot(n));
    let flat = |f: &&Found| way(f).dot(n).abs() <= floor && f.2.flags & PHOTON_CAUSTIC == 0;
    let mut all: Vec<Found> = found.iter().filter(flat).cloned().collect();
    if all.len() < 10 {
        return None;
    }
    let hull = |all: &[Found]| {
        let mut points: Vec<_> = all.iter().map(|f| seen(f).as_dvec3().truncate()).collect();
        points.sort_by(|a, b| (a.x, a.y).partial_cmp(&(b.x, b.y)).unwrap());
        points.dedup();
        let (mut corners, mut area) = (0, 0.0);
        for &a in &points {
            for &b in points.iter().filter(|b| **b != a) {
                let within = |&c: &glam::DVec2| {
                    let turn = (b - a).perp_dot(c - a);
                    turn > 0.0 || (turn == 0.0 && (a - c).dot(b - c) <= 0.0)
                };
                if points.iter().all(within) {
                    corners += 1;
                    area += 0.5 * (a - points[0]).perp_dot(b - points[0]);
                }
            }
        }
        let outside = corners.min(all.len()) as f64 / (all.len() + 1) as f64;
        area * (1.0 / (1.0 - outside)).min(3.0)
    };
    loop {
        let area = hull(&all);
        let count = all.len() as f32;
        let hop = ((area as f32 / count).sqrt() * 1.6).max(16.0 * r as f32 / count);
        let nearest = all.iter().map(|f| f.0).min().unwrap();
        let mut on_it: Vec<bool> = all.iter().map(|f| f.0 == nearest).collect();
        for _ in 0..all.len() {
            for i in 0..all.len() {
                on_it[i] |= (0..all.len()).any(|j| {
                    on_it[j] && (seen(&all[j]) - seen(&all[i])).length_squared() <= hop * hop
                });
            }
        }
        let near = on_it.iter().filter(|on| **on).count();
        if near < 10 || near == all.len() {
            return Some((area, all));
        }
        let mut on_it = on_it.into_iter();
        all.retain(|_| on_it.next().unwrap());
    }
}

/// How much of the disc is lit, by angles.
fn part_of_disc(
    found: &[(u32, Vec<u8>, &PhotonRecord)],
    x: Vec3,
    n: Vec3,
    r: f64,
    kernel: Kernel,
) -> f64 {
    let sectors = match found.len() {
        0..28 => return 1.0,
        28..56 => 4,
        56..112 => 8,
        112..224 => 16,
        _ => 32,
    };
    let (u, v) = tangents(n);
    let mut list = vec![(0.0f64, 0.0f64); sectors];
    for (d2, _, p) in found {
        let way = (Vec3::from(p.position()) - x).as_dvec3();
        let angle = way.dot(v.as_dvec3()).atan2(way.dot(u.as_dvec3())) / std::f64::consts::TAU;
        let sector = ((angle + 1.0).fract() * sectors as f64) as usize % sectors;
        list[sector].0 += 1.0;
        list[sector].1 = list[sector].1.max(f64::from(f32::from_bits(*d2)));
    }
    // What the farthest of m tells about where m photons end, power by power.
    let part = |&(m, d2): &(f64, f64)| {
        let x = d2 / (r * r);
        let term = |p: f64| if m == 0.0 { 0.0 } else { x.powf(p) * (m + p) / m };
        match kernel {
            Kernel::Constant => term(1.0),
            Kernel::Cone => 3.0 * term(1.0) - 2.0 * term(1.5),
            Kernel::Epanechnikov => 2.0 * term(1.0) - term(2.0),
        }
    };
    (list.iter().map(part).sum::<f64>() / sectors as f64).max(0.25)
}

/// Any two tangents would do for what is asked; these are the ones that there are.
fn tangents(n: Vec3) -> (Vec3, Vec3) {
    let sign = 1.0f32.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (
        Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        Vec3::new(b, sign + n.y * n.y * a, -n.y),
    )
}

fn any_gather() -> impl Strategy<Value = Gather> {
    let kernels = prop::sample::select(vec![Kernel::Constant, Kernel::Cone, Kernel::Epanechnikov]);
    (2u32..20, 0.05f32..2.0, kernels).prop_map(|(photons, radius, kernel)| Gather {
        photons,
        radius,
        kernel,
    })
}

proptest! {
    /// The same set, whatever ties and duplicates there are: the same number, radius and sum; and the
    /// same bits for any permutation.
    #[test]
    fn gather_is_brute_force(
        photons in proptest::collection::vec((coarse_photon(), any::<bool>()), 0..150),
        x in prop::array::uniform3(prop::sample::select(vec![-0.5f32, 0.0, 0.1, 0.5, 0.77])),
        gather in any_gather(),
    ) {
        // A portal that cuts the cloud of points in two, at x = 0.4.
        let (portals, mut pieces) = door();
        for corner in &mut pieces[0].corners {
            *corner = [0.4, corner[1] - 1.5, corner[2] - 1.0];
        }
        let portals = PortalSet::new(&portals, &pieces);
        let photons: Vec<PhotonRecord> = photons
            .into_iter()
            .map(|(mut p, halo)| { p.flags |= if halo { PHOTON_HALO } else { 0 }; p })
            .collect();
        let (point, normal) = (Vec3::from(x), Vec3::Z);
        let got = ask(&blob(&photons, 10.0), point, normal, &gather, &portals);
        let (rgb, number, radius) = brute_force(&photons, point, normal, &gather, &portals, got.vague);
        prop_assert_eq!((got.photons, got.radius.to_bits()), (number, radius.to_bits()));
        for (got, expected) in got.rgb.into_iter().zip(rgb) {
            prop_assert!((f64::from(got) - expected).abs() <= 1e-6 * expected + 1e-9, "{got} for {expected}");
        }
        let back: Vec<_> = photons.iter().rev().copied().collect();
        let again = ask(&blob(&back, 10.0), point, normal, &gather, &portals);
        prop_assert_eq!(bits(&again), bits(&got));
        // Every photon stored on this side instead: those that were visible are still the same bits.
        if photons.iter().all(|p| p.flags & PHOTON_HALO == 0 || portals.crosses(point, Vec3::from(p.position()))) {
            let mut own = photons;
            own.iter_mut().for_each(|p| p.flags &= !PHOTON_HALO);
            prop_assert_eq!(bits(&ask(&blob(&own, 10.0), point, normal, &gather, &portals)), bits(&got));
        }
    }

    /// The quick octahedral decoder points where the layout's points.
    #[test]
    fn directions_agree_with_the_layout(a in 0u32..1 << 24, b in 0u32..1 << 24) {
        let p = PhotonRecord { directions: PhotonRecord::pack_directions(a, b), ..Default::default() };
        let [x, y, z, ..] = p.directions;
        let quick = super::gather::direction(x, y, z).normalize();
        prop_assert!((quick - Vec3::from(octahedral::decode(a))).length() < 1e-6);
    }
}

#[test]
fn a_large_random_room_agrees_with_brute_force() {
    let photons = shuffled(5_000, 11);
    let blob = blob(&photons, 1.0);
    let queries = shuffled(60, 12);
    for (i, q) in queries.iter().enumerate() {
        let kernel = [Kernel::Constant, Kernel::Cone, Kernel::Epanechnikov][i % 3];
        let gather = Gather { photons: 2 + i as u32 * 3, radius: 0.1 + 0.01 * i as f32, kernel };
        let (x, n) = (Vec3::from(q.position()), Vec3::from(q.normal()));
        let got = ask(&blob, x, n, &gather, &PortalSet::none());
        let (rgb, number, radius) =
            brute_force(&photons, x, n, &gather, &PortalSet::none(), got.vague);
        assert_eq!((got.photons, got.radius), (number, radius));
        assert!(number > 0);
        for (got, expected) in got.rgb.into_iter().zip(rgb) {
            assert!((f64::from(got) - expected).abs() <= 1e-5 * expected, "{got} for {expected}");
        }
        // Sets of instructions, and what was asked before, make no difference.
        let map = PhotonMap::from_blob(&blob).unwrap();
        for instructions in Instructions::ALL {
            let mut scratch = GatherScratch::new(4).with_instructions(instructions);
            for shift in [0.001, 1.0, 0.0] {
                let x = x + n.cross(Vec3::new(0.3, 0.5, 0.7)) * shift;
                let e = map.irradiance(x, n, &gather, &PortalSet::none(), &mut scratch);
                let fresh = ask(&blob, x, n, &gather, &PortalSet::none());
                assert_eq!(bits(&e), bits(&fresh), "{instructions:?}");
            }
        }
    }
}

/// The nearest photons, whatever they are on: against sorting all of them, with ties, for every set of instructions, in one
/// piece and in many.
#[test]
fn nearest_is_brute_force_in_one_piece_or_many() {
    let mut photons = shuffled(6_000, 21);
    // A grid, where distances are equal, and copies.
    for (i, p) in photons.iter_mut().enumerate().take(2_000) {
        let [x, y, z] = [i % 10, i / 10 % 10, i / 100 % 10].map(|c| 1.0 + 0.125 * c as f32);
        p.position_bits = [x, y, z].map(f32::to_bits);
    }
    let copies: Vec<_> = photons[1_000..1_500].to_vec();
    photons.extend(copies);
    let one = blob(&photons, 1.0);
    let mut cube = Cube::default();
    photons.iter().for_each(|p| cube.add(p));
    let ranges = divide(60, |see| {
        photons.iter().for_each(|p| see(cube.number(p)));
        Ok::<(), ()>(())
    })
    .unwrap();
    assert!(ranges.len() > 64, "two levels above the pieces");
    let blobs: Vec<Vec<u8>> = ranges
        .iter()
        .enumerate()
        .map(|(i, range)| {
            let inside = |p: &&PhotonRecord| range.numbers.contains(&cube.number(p));
            let list: Vec<_> = photons.iter().filter(inside).copied().collect();
            let mut blob = vec![0; blob_bytes(list.len())];
            build_map(&list, &mut blob, 1.0, [i as u32, ranges.len() as u32], 1);
            blob
        })
        .collect();
    let whole = PhotonMap::from_blob(&one).unwrap();
    let many = PhotonMap::from_pieces(blobs.iter().map(|b| &b[..])).unwrap();
    many.check().unwrap();
    pieces_come_when_they_are_asked_for(&many, &blobs, &photons);
    assert_eq!(many.len(), whole.len());
    let mut scratches: Vec<_> =
        Instructions::ALL.map(|i| GatherScratch::new(8).with_instructions(i)).into();
    for (i, q) in photons.iter().step_by(17).enumerate() {
        let x = Vec3::from(q.position());
        let mut all: Vec<_> = photons
            .iter()
            .map(|p| ((Vec3::from(p.position()) - x).length_squared(), *p))
            .filter(|(d2, _)| *d2 <= 0.49)
            .collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.as_bytes().cmp(b.1.as_bytes())));
        let k = [0, 1, 2, 7, 50, 100, 1000][i % 7];
        all.truncate(k);
        for (map, scratch) in [&whole, &many].into_iter().flat_map(|m| (0..3).map(move |s| (m, s)))
        {
            let near = map.nearest(x, k as u32, 0.7, &mut scratches[scratch]);
            let mut found: Vec<_> = near.iter().map(|(n, d2)| (d2, map.photon(n))).collect();
            if found.len() == k && k > 0 {
                assert_eq!(found[0].0, all[k - 1].0, "the farthest is the first");
            }
            found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.as_bytes().cmp(b.1.as_bytes())));
            assert!(found == all, "{k} about {x}");
        }
        // And with the tests of a gather, to the bit.
        let n = Vec3::from(q.normal());
        let kernel = [Kernel::Constant, Kernel::Cone, Kernel::Epanechnikov][i % 3];
        let gather = Gather { photons: k as u32, radius: 0.5, kernel };
        let none = PortalSet::none();
        let a = whole.irradiance(x, n, &gather, &none, &mut scratches[0]);
        let b = many.irradiance(x, n, &gather, &none, &mut scratches[1]);
        assert_eq!(bits(&a), bits(&b));
    }
}

/// A point of a uniform random field: `n` photons of 1 W in `sides` m from the origin.
fn field(n: usize, sides: [f32; 2], r: &mut Random) -> Vec<PhotonRecord> {
    (0..n)
        .map(|_| {
            let at = Vec3::new(r.next() * sides[0], r.next() * sides[1], 0.0);
            impact(at, -Vec3::Z, Vec3::Z, [1.0; 3])
        })
        .collect()
}

/// Each kernel has the mean of the field, over many independent fields.
#[test]
fn kernels_are_normalised() {
    let mut r = Random(99);
    let runs = 1_500;
    for (k, limit) in [(12u32, 0.05), (60, 0.02), (130, 0.02)] {
        let mut means = [0.0f64; 3];
        for _ in 0..runs {
            let n = 4 * k as usize;
            let blob = blob(&field(n, [2.0, 2.0], &mut r), 2.0);
            for (i, mean) in means.iter_mut().enumerate() {
                let kernel = [Kernel::Constant, Kernel::Cone, Kernel::Epanechnikov][i];
                let gather = Gather { photons: k, radius: 2.0, kernel };
                let e = ask(&blob, Vec3::new(1.0, 1.0, 0.0), Vec3::Z, &gather, &PortalSet::none());
                *mean += f64::from(e.rgb[0]) / (n as f64 / 4.0) / f64::from(runs);
            }
        }
        // One estimate varies by 1.23 / sqrt(k - 2) at most (a cone's), so a mean by less than a quarter of the limit: false
        // alarms are rarer than 1 of 10,000. The limit leaves 0.7 % for sectors in which there is no photon.
        for mean in means {
            assert!((mean - 1.0).abs() < limit, "k = {k}: {means:?}");
        }
    }
}

/// At the edge of a plate and in its corner the irradiance is that of the middle, nearly; flux over the whole disc
/// would be a half and a quarter. The same in the corner of a box, where walls stand at the edges.
#[test]
fn edges_and_corners_are_not_dark() {
    let mut r = Random(123);
    let runs = 400;
    for boxed in [false, true] {
        // Distances of the point from two edges, in radii of a full disc; the part of a disc that is there; what is asked.
        for (away, naive, limits) in [
            ([9.0, 0.0], 0.5, (0.84, 1.02)),
            ([9.0, 0.25], 0.66, (0.92, 1.05)),
            ([9.0, 0.6], 0.87, (0.94, 1.05)),
            ([0.0, 0.0], 0.25, (0.88, 1.06)),
            ([0.3, 0.3], 0.45, (0.84, 1.06)),
        ] {
            let mut means = [0.0f64; 3];
            for _ in 0..runs {
                let (k, n) = (120u32, 1_200);
                let radius = (k as f32 / n as f32 * 4.0 / PI).sqrt();
                let mut photons = field(n, [2.0, 2.0], &mut r);
                if boxed {
                    for p in field(2 * n, [2.0, 4.0], &mut r) {
                        let [u, v, _] = p.position();
                        let (at, n) = match v > 2.0 {
                            true => (Vec3::new(0.0, u, v - 2.0), Vec3::X),
                            false => (Vec3::new(u, 0.0, v), Vec3::Y),
                        };
                        photons.push(impact(at, -n, n, [1.0; 3]));
                    }
                }
                let blob = blob(&photons, 2.0);
                let at = Vec3::new((away[0] * radius).min(1.0), away[1] * radius, 0.0);
                for (i, mean) in means.iter_mut().enumerate() {
                    let kernel = [Kernel::Constant, Kernel::Cone, Kernel::Epanechnikov][i];
                    let gather = Gather { photons: k, radius: 2.0, kernel };
                    let e = ask(&blob, at, Vec3::Z, &gather, &PortalSet::none());
                    *mean += f64::from(e.rgb[0]) / (n as f64 / 4.0) / f64::from(runs);
                }
            }
            // One estimate varies by 0.15 at most, a mean by 0.008.
            for mean in means {
                assert!(
                    mean > limits.0 && mean < limits.1,
                    "{away:?}, {naive} of a disc: {means:?}"
                );
                assert!((mean - 1.0).abs() < 0.5 * (1.0 - naive), "{away:?}: {means:?}");
            }
        }
    }
}

/// Things smaller than the disc that would hold `k` photons: their own photons end the disc. A leg, and slats with gaps
/// between them, are vague; so is what has next to no photon, and the edge of a bright spot; a plain floor, its edge and a gradient
/// are not.
#[test]
fn small_things_have_their_irradiance_or_are_vague() {
    let mut r = Random(321);
    let asked = |photons: &[PhotonRecord], at: [f32; 2], k: u32| {
        let gather = Gather { photons: k, radius: 0.6, kernel: Kernel::Constant };
        let at = Vec3::new(at[0], at[1], 0.0);
        ask(&blob(photons, 0.6), at, Vec3::Z, &gather, &PortalSet::none())
    };
    let runs = 300;
    // A square of 10 cm, seen at its middle, near its edge and in its corner; the whole disc is 113 times as large.
    for (at, limits) in
        [([0.05, 0.05], (0.85, 1.1)), ([0.05, 0.01], (0.8, 1.1)), ([0.0, 0.0], (0.6, 1.1))]
    {
        let mut mean = 0.0;
        for _ in 0..runs {
            let e = asked(&field(60, [0.1, 0.1], &mut r), at, 120);
            assert!(e.radius < 0.142, "{}", e.radius);
            mean += e.rgb[0] / 6_000.0 / runs as f32;
        }
        // One varies by a fifth: 4 deviations of the mean are 0.05.
        assert!(mean > limits.0 && mean < limits.1, "at {at:?}: {mean}");
    }
    let vague = |at: [f32; 2], k: u32, photons: &mut dyn FnMut() -> Vec<PhotonRecord>| {
        let count = (0..runs).filter(|_| asked(&photons(), at, k).vague).count();
        count as f32 / runs as f32
    };
    let moved = |mut photons: Vec<PhotonRecord>, by: [f32; 2]| {
        for p in &mut photons {
            let [x, y, z] = p.position();
            p.position_bits = [x + by[0], y + by[1], z].map(f32::to_bits);
        }
        photons
    };
    let mut r = Random(322);
    assert_eq!(vague([0.02, 0.4], 120, &mut || field(150, [0.04, 0.8], &mut r)), 1.0);
    assert_eq!(vague([0.5, 0.5], 120, &mut || field(10, [1.0, 1.0], &mut r)), 1.0);
    let mut spot = || {
        let mut all = field(400, [2.0, 2.0], &mut r);
        all.extend(moved(field(60, [0.1, 0.1], &mut r), [0.95, 0.95]));
        all
    };
    assert!(vague([1.0, 1.0], 120, &mut spot) > 0.9);
    let mut slats = || {
        (0..5)
            .flat_map(|i| moved(field(300, [0.1, 2.0], &mut r), [0.6 + 0.3 * i as f32, 0.0]))
            .collect()
    };
    assert!(vague([1.25, 1.0], 120, &mut slats) > 0.8);
    let mut swarm = || {
        (0..36)
            .flat_map(|i| {
                let by = [0.24 * (i % 6) as f32, 0.24 * (i / 6) as f32];
                moved(field(30, [0.12, 0.1], &mut r), by)
            })
            .collect()
    };
    assert!(vague([0.75, 0.75], 120, &mut swarm) > 0.7);
    for (name, at) in [("floor", [1.0, 1.0]), ("floor's edge", [1.0, 0.0]), ("near it", [1.0, 0.1])]
    {
        for k in [30, 120, 500] {
            let share = vague(at, k, &mut || field(5_000, [2.0, 2.0], &mut r));
            assert!(share < 0.01, "{name}, k = {k}: {share}");
        }
    }
    let mut gradient = || {
        let all = field(4_000, [2.0, 2.0], &mut r);
        all.into_iter().filter(|p| p.position()[0] > 2.0 * r.next()).collect()
    };
    assert!(vague([1.0, 1.0], 120, &mut gradient) < 0.01);
}

/// A grid of photons, one every `step` metres, on the plane z = `height`, over [-2, 2]².
fn plane(step: f32, height: f32, normal: Vec3, flux: [f32; 3]) -> Vec<PhotonRecord> {
    let n = (2.0 / step) as i32;
    (-n..=n)
        .flat_map(|i| (-n..=n).map(move |j| (i, j)))
        .map(|(i, j)| {
            let at = Vec3::new(i as f32 * step, j as f32 * step, height);
            impact(at, -normal, normal, flux)
        })
        .collect()
}

#[test]
fn uniform_field_gives_its_irradiance() {
    // 64 photons of 2^-6 W per unit area at random: 1 W/m² is 1 to within 3 standard deviations.
    let mut r = Random(5);
    let (n, flux) = (40_000, [1.0 / 1024.0, 0.5 / 1024.0, 0.0]);
    let photons: Vec<_> = (0..n)
        .map(|_| {
            let at = Vec3::new(r.next() * 4.0 - 2.0, r.next() * 4.0 - 2.0, 1.0);
            impact(at, Vec3::new(0.3, 0.2, -1.0), Vec3::Z, flux)
        })
        .collect();
    let truth = n as f32 / 16.0 / 1024.0;
    let blob = blob(&photons, 1.0);
    for kernel in [Kernel::Constant, Kernel::Cone, Kernel::Epanechnikov] {
        for k in [50, 200, 1000] {
            let gather = Gather { photons: k, radius: 1.0, kernel };
            let (mut sum, queries) = (0.0, 400);
            for _ in 0..queries {
                let x = Vec3::new(r.next() * 2.0 - 1.0, r.next() * 2.0 - 1.0, 1.0);
                let e = ask(&blob, x, Vec3::Z, &gather, &PortalSet::none());
                assert_eq!(e.photons, k);
                assert!((e.rgb[1] - 0.5 * e.rgb[0]).abs() < 1e-6 && e.rgb[2] == 0.0);
                // A cone has 1.5 times the variance of a disc, a paraboloid 4/3: 5 sigma for one.
                assert!((e.rgb[0] / truth - 1.0).abs() < 6.2 / (k as f32).sqrt());
                sum += e.rgb[0];
            }
            // The plane has some 12,000 photons within reach: that bounds how good the mean can be.
            let mean = sum / queries as f32 / truth;
            assert!((mean - 1.0).abs() < 3.0 / 12_000f32.sqrt(), "{kernel:?} {k}: {mean}");
            let e = ask(&blob, Vec3::new(0.1, 0.2, 1.0), Vec3::Z, &gather, &PortalSet::none());
            assert!((e.rgb[0] / truth - 1.0).abs() < 3.0 / (k as f32).sqrt(), "{kernel:?} {k}");
        }
    }
}

#[test]
fn one_photon_by_hand() {
    let photon = impact(Vec3::new(0.3, 0.0, 0.0), -Vec3::Z, Vec3::Z, [1.0, 0.5, 0.25]);
    let blob = blob(&[photon], 2.0);
    let e = |radius, kernel| {
        let gather = Gather { photons: 50, radius, kernel };
        ask(&blob, Vec3::ZERO, Vec3::Z, &gather, &PortalSet::none())
    };
    let nothing = Irradiance { vague: true, few: true, ..Irradiance::default() };
    assert_eq!(e(0.2, Kernel::Constant), nothing);
    let near = |a: [f32; 3], b: f32| {
        assert!((a[0] / b - 1.0).abs() < 1e-6, "{a:?} {b}");
        assert_eq!([a[1], a[2]], [a[0] * 0.5, a[0] * 0.25]);
    };
    near(e(0.5, Kernel::Constant).rgb, 1.0 / (PI * 0.25));
    near(e(0.5, Kernel::Cone).rgb, 3.0 * (1.0 - 0.6) / (PI * 0.25));
    near(e(0.5, Kernel::Epanechnikov).rgb, 2.0 * (1.0 - 0.36) / (PI * 0.25));
    assert_eq!((e(0.5, Kernel::Cone).photons, e(0.5, Kernel::Cone).radius), (1, 0.5));
    // Not beyond what the map is complete for.
    assert_eq!(e(5.0, Kernel::Constant).radius, 2.0);
    for bad in [0.0, -1.0, f32::NAN] {
        assert_eq!(e(bad, Kernel::Constant), Irradiance::default());
    }
}

/// Photons on a circle are all the k-th nearest at once: which of them gives the disc, and which are
/// left out, goes by their bytes, whether any was left out or not.
#[test]
fn ties_at_the_kth_distance_go_by_the_bytes() {
    let around = [[0.3, 0.4], [0.4, 0.3], [-0.3, 0.4], [0.4, -0.3], [-0.4, -0.3], [-0.3, -0.4]];
    let mut photons: Vec<_> = around
        .iter()
        .enumerate()
        .map(|(i, xy)| {
            let flux = [(1 << i) as f32, 0.0, 1.0];
            impact(Vec3::new(xy[0], xy[1], 0.0), -Vec3::Z, Vec3::Z, flux)
        })
        .collect();
    let same = |photons: &[PhotonRecord], k| {
        let gather = Gather { photons: k, radius: 1.0, kernel: Kernel::Constant };
        let e = ask(&blob(photons, 1.0), Vec3::ZERO, Vec3::Z, &gather, &PortalSet::none());
        let (rgb, number, radius) =
            brute_force(photons, Vec3::ZERO, Vec3::Z, &gather, &PortalSet::none(), false);
        assert_eq!((e.photons, e.radius), (number, radius));
        assert!((f64::from(e.rgb[0]) - rgb[0]).abs() <= 1e-6 * rgb[0], "{k}: {e:?} {rgb:?}");
    };
    for k in 2..8 {
        same(&photons, k);
    }
    // And with some that are nearer.
    for i in 0..4 {
        photons.push(impact(Vec3::new(0.01 * i as f32, 0.0, 0.0), -Vec3::Z, Vec3::Z, [0.5; 3]));
        for k in 2..12 {
            same(&photons, k);
        }
    }
}

#[test]
fn duplicates_in_one_spot_are_finite() {
    let photon = impact(Vec3::splat(1.0), -Vec3::Z, Vec3::Z, [1.0; 3]);
    let blob = blob(&[photon; 100], 1.0);
    let gather = Gather { photons: 50, radius: 1.0, kernel: Kernel::Constant };
    let e = ask(&blob, Vec3::splat(1.0), Vec3::Z, &gather, &PortalSet::none());
    let expected = 50.0 / (PI * SMALLEST_DISC_M * SMALLEST_DISC_M);
    assert!((e.rgb[0] / expected - 1.0).abs() < 1e-5, "{e:?}");
    assert_eq!((e.photons, e.radius), (50, SMALLEST_DISC_M));
}

#[test]
fn no_light_through_a_thin_wall_nor_from_a_shelf_nor_round_an_edge() {
    let gather = Gather { photons: 100, radius: 0.5, kernel: Kernel::Constant };
    let e = |photons: &[PhotonRecord], n: Vec3| {
        ask(&blob(photons, 0.5), Vec3::new(0.013, 0.007, 0.0), n, &gather, &PortalSet::none())
    };
    let lit = plane(0.05, 0.0, Vec3::Z, [1.0; 3]);
    assert!(e(&lit, Vec3::Z).rgb[0] > 300.0);
    // The same sheet from behind, the other side of a wall of 1 mm, of 5 cm.
    assert_eq!(e(&lit, -Vec3::Z).photons, 0);
    assert_eq!(e(&plane(0.05, 0.001, -Vec3::Z, [1.0; 3]), Vec3::Z).photons, 0);
    assert_eq!(e(&plane(0.05, -0.05, -Vec3::Z, [1.0; 3]), Vec3::Z).photons, 0);
    // The next shelf, 25 cm up: farther than the slab allows anywhere within the radius.
    assert_eq!(e(&plane(0.05, 0.25, Vec3::Z, [1.0; 3]), Vec3::Z).photons, 0);
    // The side of a box, at a right angle and at 45 degrees.
    let tilted: Vec<_> = lit
        .iter()
        .map(|p| impact(Vec3::from(p.position()), -Vec3::Z, Vec3::new(1.0, 0.0, 1.0), [1.0; 3]))
        .collect();
    assert_eq!(e(&tilted, Vec3::Z).photons, 0);
    assert_eq!(e(&tilted, Vec3::X).photons, 0);
    // A photon that came from behind its own surface (a bent normal) does not count.
    let behind = impact(Vec3::ZERO, Vec3::Z, Vec3::Z, [1.0; 3]);
    assert_eq!(e(&[behind], Vec3::Z).photons, 0);
    // A little relief does: 5 mm.
    assert!(e(&plane(0.05, 0.005, Vec3::Z, [1.0; 3]), Vec3::Z).photons == 100);
}

/// Two rooms with the wall x = 2 between them, and its door; the floor is z = 0.
#[test]
fn a_doorway_makes_no_difference() {
    let (portals, pieces) = door();
    let portals = PortalSet::new(&portals, &pieces);
    let mut r = Random(77);
    let floor: Vec<_> = (0..30_000)
        .map(|_| {
            let at = Vec3::new(r.next() * 4.0, r.next() * 3.0, 0.0);
            let flux = [0.001 * r.next(), 0.002 * r.next(), 0.003];
            impact(at, Vec3::new(r.next() - 0.5, r.next() - 0.5, -0.4), Vec3::Z, flux)
        })
        .collect();
    let whole = blob(&floor, 0.4);
    let gather = |k| Gather { photons: k, radius: 0.4, kernel: Kernel::Epanechnikov };
    let mut halo = 0;
    let mut split = Vec::new();
    for p in &floor {
        let mut p = *p;
        if p.position()[0] >= 2.0 {
            if !Halo::new(&portals, 0.4).wants(&p) {
                continue;
            }
            p.flags |= PHOTON_HALO;
            halo += 1;
        }
        split.push(p);
    }
    // 1 m of door and two quarter discs of 0.4 m beyond it, 2500 photons a square metre.
    let expected = 2500.0 * (0.4 + PI * 0.16 / 2.0);
    assert!((halo as f32 / expected - 1.0).abs() < 0.1, "{halo} for {expected}");
    let split = blob(&split, 0.4);
    let mut beyond = 0;
    for i in 0..500 {
        // Within sight of nothing but the door: 100 photons reach 0.113 m.
        let x = Vec3::new(2.0 - 0.2 * r.next(), 1.2 + 0.6 * r.next(), 0.0);
        let x = if i == 0 { Vec3::new(2.0, 1.5, 0.0) } else { x };
        let a = ask(&whole, x, Vec3::Z, &gather(100), &PortalSet::none());
        let b = ask(&split, x, Vec3::Z, &gather(100), &portals);
        assert_eq!(bits(&a), bits(&b), "at {x}");
        beyond += u32::from(x.x + a.radius > 2.0);
    }
    assert!(beyond > 150, "the test must look through the door: {beyond}");
    // Behind the wall beside the door the neighbour's floor is near, and does not count.
    let x = Vec3::new(1.99, 0.7, 0.0);
    let own: Vec<_> = floor.iter().filter(|p| p.position()[0] < 2.0).copied().collect();
    let alone = ask(&blob(&own, 0.4), x, Vec3::Z, &gather(100), &PortalSet::none());
    assert_eq!(bits(&ask(&split, x, Vec3::Z, &gather(100), &portals)), bits(&alone));
}

#[test]
fn scratch_is_reused_and_does_not_grow() {
    let photons = shuffled(2_000, 1);
    let blob = blob(&photons, 1.0);
    let map = PhotonMap::from_blob(&blob).unwrap();
    let gather = Gather { photons: 50, radius: 1.0, kernel: Kernel::Constant };
    let mut scratch = GatherScratch::new(50);
    let before = scratch.bytes();
    for q in &photons {
        let (x, n) = (Vec3::from(q.position()), Vec3::from(q.normal()));
        let e = map.irradiance(x, n, &gather, &PortalSet::none(), &mut scratch);
        assert!(e.photons > 15);
        let fresh = ask(&blob, x, n, &gather, &PortalSet::none());
        assert_eq!(bits(&e), bits(&fresh));
    }
    assert_eq!(scratch.bytes(), before);
}

#[test]
fn broken_trees_and_questions_do_not_panic() {
    let mut r = Random(9);
    let mut photons = shuffled(300, 2);
    for p in &mut photons {
        p.flags = (r.next() * 65536.0) as u16;
        if r.next() < 0.1 {
            p.position_bits = [0x7fc0_0000, 0x7f80_0000, 0xff80_0000];
        }
    }
    let blob = PhotonMap::build_blob(&photons, f32::INFINITY);
    for x in [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY, Vec3::splat(f32::MAX)] {
        for n in [Vec3::Z, Vec3::NAN, Vec3::ZERO] {
            for radius in [1.0, f32::INFINITY, f32::MAX, 1e-40] {
                for photons in [0, 1, 50, u32::MAX] {
                    let gather = Gather { photons, radius, kernel: Kernel::Cone };
                    let e = ask(&blob, x, n, &gather, &PortalSet::none());
                    assert!(e.rgb.iter().all(|c| *c >= 0.0), "{e:?}");
                }
            }
        }
    }
}

/// A map of outlines names the pieces that a search needs, one after the other; with these, and no others, it says what the whole
/// map does. Irradiance that lacks a piece is not kept.
fn pieces_come_when_they_are_asked_for(
    whole: &PhotonMap<'_>,
    blobs: &[Vec<u8>],
    photons: &[PhotonRecord],
) {
    let outlines: Vec<_> = blobs.iter().map(|b| Outline::of(b).unwrap()).collect();
    assert!(PhotonMap::from_outlines(&outlines[1..]).is_err());
    let gather = Gather { photons: 40, radius: 0.6, kernel: Kernel::Cone };
    let (mut scratch, mut other) = (GatherScratch::new(40), GatherScratch::new(40));
    let cache = IrradianceCache::new(whole);
    let mut places = Places::of(whole.len());
    for (number, blob) in (0..).zip(blobs) {
        let mut map = PhotonMap::from_outlines(&outlines).unwrap();
        assert_eq!(
            (map.len(), map.places(), map.halo()),
            (whole.len(), whole.places(), whole.halo())
        );
        assert!(map.bring(number + 1, blob).is_err());
        map.bring(number, blob).unwrap();
        map.photons().for_each(|(number, photon)| places.add(number, &photon));
    }
    let partial = IrradianceCache::at_places(places);
    for photon in photons.iter().step_by(97) {
        let point = Vec3::from(photon.position());
        let normal = Vec3::from(photon.normal());
        let none = PortalSet::none();
        let mut map = PhotonMap::from_outlines(&outlines).unwrap();
        let mut brought = 0;
        let found = loop {
            let found = map.irradiance(point, normal, &gather, &none, &mut scratch);
            let kept = partial.estimate(&map, point, normal, &gather, &none, &mut scratch);
            match scratch.missing() {
                Some(piece) => map.bring(piece, &blobs[piece as usize]).unwrap(),
                None => break (found, kept),
            }
            brought += 1;
        };
        assert!(brought > 0 && brought < blobs.len(), "{brought} of {} pieces", blobs.len());
        let all = whole.irradiance(point, normal, &gather, &none, &mut other);
        let kept = cache.estimate(whole, point, normal, &gather, &none, &mut other);
        assert_eq!(found, (all, kept));
        assert_eq!(other.missing(), None);
    }
}
