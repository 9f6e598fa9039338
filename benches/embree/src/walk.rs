//! The rays: walks of photons, written down once, so that everybody is asked the same questions.
//!
//! A photon leaves a light, cosine-distributed, and is reflected diffusely until Russian roulette ends its walk; it
//! survives with probability [`SURVIVAL`]. So nearly four of five rays start on a triangle, in a direction
//! that has nothing to do with the one before: what tracing photons in a room is.

use glam::{DVec3, Vec3};

use crate::random::{Random, mix};
use crate::scene::Scene;

/// Probability that a photon survives a reflection: 3.78 impacts a photon.
pub const SURVIVAL: f64 = 0.7354;

/// How far Embree's rays start above the triangle that they leave, m. (Ours start delta / 4 above it, as the
/// project's photons do, and leave that triangle out by its index.)
pub const LIFT: f32 = 1e-4;

/// No triangle.
pub const NONE: u32 = u32::MAX;

/// One question, as either side asks it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flight {
    /// Where our ray starts, m.
    pub from: Vec3,
    /// Where Embree's starts, m.
    pub lifted: Vec3,
    /// Unit direction of both.
    pub direction: Vec3,
    /// The triangle that the ray leaves, or [`NONE`].
    pub left: u32,
    /// Where it ends, m: infinite, or just before the light.
    pub far: f32,
}

/// Where a flight ends.
#[derive(Clone, Copy, Debug)]
pub struct Landing {
    /// The triangle.
    pub triangle: u32,
    /// Barycentric weight of its corner 1.
    pub u: f32,
    /// Barycentric weight of its corner 2.
    pub v: f32,
}

/// Rays in the order of the walks that they belong to.
#[derive(Debug, Default)]
pub struct Walks {
    /// Bounces (and emissions).
    pub flights: Vec<Flight>,
    /// From impacts to a random point of the nearest light, where each sees the other's front.
    pub shadows: Vec<Flight>,
    /// Photons that made the flights; the last one's walk may be cut short.
    pub photons: usize,
    /// Flights that hit nothing.
    pub escaped: usize,
}

impl Walks {
    /// Follows photons until there are `count` flights and, where lights are seen at all, as many shadow rays.
    /// `nearest` says where a flight lands.
    pub fn record(
        scene: &Scene,
        count: usize,
        seed: u64,
        mut nearest: impl FnMut(&Flight) -> Option<Landing>,
    ) -> Self {
        let mut walks = Self::default();
        let delta = scene.delta();
        walks.flights.reserve_exact(count);
        walks.shadows.reserve_exact(count);
        let start = |point: DVec3, normal: Vec3, direction: Vec3, left: u32, far: f32| {
            let point = point.as_vec3();
            let (from, lifted) = (point + 0.25 * delta * normal, point + LIFT * normal);
            Flight { from, lifted, direction, left, far }
        };
        for photon in 0..100 * count as u64 {
            if walks.flights.len() == count && walks.shadows.len() == count {
                break;
            }
            let recording = walks.flights.len() < count;
            walks.photons += usize::from(recording);
            let mut random = Random::new(mix(seed) ^ photon);
            let light = &scene.lights[photon as usize % scene.lights.len()];
            let normal = light.normal();
            let point = light.at(random.unit(), random.unit());
            let mut flight =
                start(point.as_dvec3(), normal, cosine(normal, &mut random), NONE, f32::INFINITY);
            loop {
                if walks.flights.len() < count {
                    walks.flights.push(flight);
                }
                let Some(landing) = nearest(&flight) else {
                    walks.escaped += usize::from(recording);
                    break;
                };
                let (point, normal) = surface(scene, &landing, flight.direction);
                if walks.shadows.len() < count
                    && let Some((direction, far)) = towards_light(scene, point, normal, &mut random)
                {
                    walks.shadows.push(start(point, normal, direction, landing.triangle, far));
                }
                if random.unit() >= SURVIVAL {
                    break;
                }
                let direction = cosine(normal, &mut random);
                flight = start(point, normal, direction, landing.triangle, f32::INFINITY);
            }
        }
        walks
    }
}

/// Point, m, and unit normal towards where the ray came from.
fn surface(scene: &Scene, landing: &Landing, direction: Vec3) -> (DVec3, Vec3) {
    let vertices = scene.vertices.list();
    let [a, b, c] = scene.triangles[landing.triangle as usize]
        .map(|v| Vec3::from_array(vertices[v as usize]).as_dvec3());
    let point = a + f64::from(landing.u) * (b - a) + f64::from(landing.v) * (c - a);
    let normal = scene.normal(landing.triangle);
    (point, if normal.dot(direction) < 0.0 { normal } else { -normal })
}

/// Unit direction to a random point of the nearest light, and how far to look, m.
fn towards_light(
    scene: &Scene,
    point: DVec3,
    normal: Vec3,
    random: &mut Random,
) -> Option<(Vec3, f32)> {
    let square = |l: &crate::scene::Light| (l.at(0.5, 0.5).as_dvec3() - point).length_squared();
    let light = scene.lights.iter().min_by(|a, b| square(a).total_cmp(&square(b)))?;
    let way = light.at(random.unit(), random.unit()).as_dvec3() - point;
    let distance = way.length();
    let direction = (way / distance).as_vec3();
    (distance > 1e-3 && direction.dot(normal) > 0.0 && direction.dot(light.normal()) < 0.0)
        .then_some((direction, 0.999 * distance as f32))
}

/// A direction about a normal, its density proportional to the cosine between them.
fn cosine(normal: Vec3, random: &mut Random) -> Vec3 {
    let (u, turn) = (random.unit(), std::f64::consts::TAU * random.unit());
    let (x, y) = normal.as_dvec3().any_orthonormal_pair();
    let side = x * libm::cos(turn) + y * libm::sin(turn);
    (normal.as_dvec3() * (1.0 - u).sqrt() + side * u.sqrt()).normalize().as_vec3()
}

/// The same flights in random order.
pub fn shuffled(flights: &[Flight], seed: u64) -> Vec<Flight> {
    let mut flights = flights.to_vec();
    Random::new(mix(seed) ^ 0x5AFF1E).shuffle(&mut flights);
    flights
}

/// The same flights by cell of 1/32 of the scene, octant of the direction, and place in the cell (Morton order).
pub fn sorted(flights: &[Flight], (min, max): (Vec3, Vec3)) -> Vec<Flight> {
    let scale = 1023.99 / (max - min).max_element().max(f32::MIN_POSITIVE);
    let key = |flight: &Flight| {
        let cell = ((flight.from - min) * scale).clamp(Vec3::ZERO, Vec3::splat(1023.0));
        let [x, y, z] = cell.to_array().map(|c| u64::from(spread(c as u32)));
        let morton = x | y << 1 | z << 2;
        let octant = u64::from(flight.direction.is_negative_bitmask());
        (morton >> 15) << 18 | octant << 15 | morton & 0x7FFF
    };
    let mut flights = flights.to_vec();
    flights.sort_by_cached_key(key);
    flights
}

/// Ten bits, three places apart.
fn spread(x: u32) -> u32 {
    let x = (x | x << 16) & 0x0300_00FF;
    let x = (x | x << 8) & 0x0300_F00F;
    let x = (x | x << 4) & 0x030C_30C3;
    (x | x << 2) & 0x0924_9249
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Light;

    /// A closed box of 2 x 2 x 2 m around the origin, and where a ray from inside meets it, in closed form.
    fn cube() -> (Scene, impl Fn(&Flight) -> Option<Landing>) {
        let mut soup = Vec::new();
        for axis in 0..3 {
            for side in [-1.0f32, 1.0] {
                let corner = |s: f32, t: f32| {
                    let mut p = [side; 3];
                    (p[(axis + 1) % 3], p[(axis + 2) % 3]) = (s, t);
                    p
                };
                let (a, b, c) = (corner(-1.0, -1.0), corner(1.0, -1.0), corner(-1.0, 1.0));
                soup.extend([[a, b, c], [corner(1.0, 1.0), c, b]]);
            }
        }
        let light =
            Light { corner: Vec3::new(-0.1, -0.1, 0.9), u: 0.2 * Vec3::Y, v: 0.2 * Vec3::X };
        let scene = Scene::weld("cube", &soup, vec![light], Vec::new());
        let nearest = |flight: &Flight| {
            let (o, d) = (flight.from.as_dvec3(), flight.direction.as_dvec3());
            let wall = |axis: usize| (1.0f64.copysign(d[axis]) - o[axis]) / d[axis];
            let axis = (0..3).min_by(|&a, &b| wall(a).total_cmp(&wall(b))).unwrap();
            let p = o + wall(axis) * d;
            let (s, t) = ((p[(axis + 1) % 3] + 1.0) / 2.0, (p[(axis + 2) % 3] + 1.0) / 2.0);
            let face = 4 * axis as u32 + if d[axis] > 0.0 { 2 } else { 0 };
            Some(if s + t <= 1.0 {
                Landing { triangle: face, u: s as f32, v: t as f32 }
            } else {
                // Corner 1 of the other half is at s = -1, corner 2 at t = -1.
                Landing { triangle: face + 1, u: (1.0 - s) as f32, v: (1.0 - t) as f32 }
            })
        };
        (scene, nearest)
    }

    #[test]
    fn photons_are_absorbed_as_often_as_they_should() {
        let (scene, nearest) = cube();
        let walks = Walks::record(&scene, 200_000, 7, nearest);
        assert_eq!((walks.flights.len(), walks.shadows.len()), (200_000, 200_000));
        assert_eq!(walks.escaped, 0);
        // Lengths are geometric: mean 1 / (1 - s), variance s / (1 - s)^2. Four standard deviations.
        let n = walks.photons as f64;
        let (mean, expected) = (200_000.0 / n, 1.0 / (1.0 - SURVIVAL));
        let bound = 4.0 * SURVIVAL.sqrt() / (1.0 - SURVIVAL) / n.sqrt();
        assert!((mean - expected).abs() < bound, "{mean}, not {expected}");
        let emitted = walks.flights.iter().filter(|f| f.left == NONE).count();
        assert_eq!(emitted, walks.photons);
    }

    #[test]
    fn bounces_follow_the_cosine_and_stay_inside() {
        let (scene, nearest) = cube();
        let walks = Walks::record(&scene, 100_000, 1, nearest);
        let mut sum = 0.0;
        let mut count = 0.0;
        for flight in &walks.flights {
            assert!((flight.direction.length() - 1.0).abs() < 1e-6);
            assert!(flight.lifted.abs().max_element() <= 1.0, "{flight:?}");
            if flight.left != NONE {
                // Faces towards the inside, wherever its triangle's normal points.
                let cosine = -scene.normal(flight.left).dot(flight.direction)
                    * scene.normal(flight.left).dot(flight.from).signum();
                assert!(cosine > -1e-6, "{flight:?}");
                sum += f64::from(cosine);
                count += 1.0;
            }
        }
        // The cosine's mean is 2/3, its variance 1/2 - 4/9.
        let bound = 4.0 * (1.0f64 / 18.0 / count).sqrt();
        assert!((sum / count - 2.0 / 3.0).abs() < bound, "{}", sum / count);
    }

    #[test]
    fn shadow_rays_end_at_the_light() {
        let (scene, nearest) = cube();
        for flight in Walks::record(&scene, 1000, 1, nearest).shadows {
            let end = flight.lifted + flight.far / 0.999 * flight.direction;
            assert!(
                (end.z - 0.9).abs() < 2e-4 && end.truncate().abs().max_element() < 0.1002,
                "{end}"
            );
            assert!(flight.direction.z > 0.0);
        }
    }

    #[test]
    fn orders_hold_the_same_flights() {
        let (scene, nearest) = cube();
        let flights = Walks::record(&scene, 5000, 1, nearest).flights;
        let bits = |f: &Flight| {
            (f.from.to_array().map(f32::to_bits), f.direction.to_array().map(f32::to_bits))
        };
        let set = |list: &[Flight]| {
            let mut set: Vec<_> = list.iter().map(bits).collect();
            set.sort_unstable();
            set
        };
        let (random, neat) = (shuffled(&flights, 1), sorted(&flights, scene.bounds()));
        assert_eq!(set(&random), set(&flights));
        assert_eq!(set(&neat), set(&flights));
        let changes = |list: &[Flight]| {
            let octant = |f: &Flight| f.direction.is_negative_bitmask();
            list.windows(2).filter(|w| octant(&w[0]) != octant(&w[1])).count()
        };
        assert!(changes(&random) > 3000 && changes(&neat) < 4000, "{}", changes(&neat));
        let step = |list: &[Flight]| {
            list.windows(2).map(|w| f64::from(w[0].from.distance(w[1].from))).sum::<f64>()
        };
        assert!(step(&neat) < 0.2 * step(&random));
        assert_eq!(spread(0x3FF), 0x0924_9249);
    }
}
