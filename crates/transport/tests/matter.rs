//! Gloss and glass through the real photon tracer: light that can be computed by hand.
//!
//! Seeds are fixed, so that no test is flaky. Bounds are at least 4 standard deviations: after a change of the random
//! numbers a sound program fails one of the comparisons with a probability below 1e-4 each.

use enf_geometry::{Instructions, Structure, StructureKind, TileMesh};
use enf_layout::material::{MATERIAL_GLOSS, MATERIAL_SEE_THROUGH, MATERIAL_SOLID, MaterialRecord};
use enf_layout::photon::{PHOTON_CAUSTIC, PHOTON_DIRECT, PhotonRecord};
use enf_layout::transit::{TRANSIT_UNSCATTERED, TransitRecord};
use enf_layout::{NONE, rgbe};
use enf_rooms::{Bsp, Options, RoomCount, Tables, partition};
use enf_transport::flight::Resident;
use enf_transport::photon::{Group, Sink, trace_all};
use enf_transport::rng::{self, Purpose};
use enf_transport::vector;
use glam::Vec3;
use zerocopy::IntoBytes;

type Triangle = [[f32; 3]; 3];

/// Triangles with their materials.
#[derive(Default)]
struct Model {
    triangles: Vec<Triangle>,
    materials: Vec<u32>,
}

impl Model {
    fn triangle(&mut self, corners: [Vec3; 3], material: u32) {
        self.triangles.push(corners.map(|c| c.to_array()));
        self.materials.push(material);
    }

    /// A box; its fronts face outwards, or inwards.
    fn cuboid(&mut self, min: [f32; 3], max: [f32; 3], inwards: bool, material: u32) {
        let at = |bits: usize| {
            Vec3::from([0, 1, 2].map(|k| if bits >> k & 1 == 0 { min[k] } else { max[k] }))
        };
        let faces =
            [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        for mut face in faces {
            if inwards {
                face.reverse();
            }
            let [a, b, c, d] = face.map(at);
            self.triangle([a, b, c], material);
            self.triangle([a, c, d], material);
        }
    }

    /// A sphere of 8 x 4^level triangles, fronts outwards.
    fn sphere(&mut self, centre: Vec3, radius: f32, level: u32, material: u32) {
        fn cut(model: &mut Model, t: [Vec3; 3], level: u32, put: &dyn Fn(Vec3) -> Vec3, m: u32) {
            if level == 0 {
                return model.triangle(t.map(put), m);
            }
            let [a, b, c] = t;
            let (d, e, f) = ((a + b).normalize(), (b + c).normalize(), (c + a).normalize());
            for part in [[a, d, f], [d, b, e], [f, e, c], [d, e, f]] {
                cut(model, part, level - 1, put, m);
            }
        }
        for i in 0..8u32 {
            let sign = |bit: u32| if i & bit == 0 { 1.0 } else { -1.0 };
            let (x, y, z) = (Vec3::X * sign(1), Vec3::Y * sign(2), Vec3::Z * sign(4));
            let flip = i.count_ones() % 2 == 1;
            let t = if flip { [x, z, y] } else { [x, y, z] };
            cut(self, t, level, &|p| centre + p * radius, material);
        }
    }
}

/// A model in one tile, ready to be traced.
struct World {
    tables: Tables,
    mesh: Vec<u8>,
    blob: Vec<u8>,
    materials: Vec<MaterialRecord>,
    delta: f32,
}

impl World {
    fn new(model: &Model, materials: Vec<MaterialRecord>) -> Self {
        let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for corner in model.triangles.iter().flatten() {
            for c in 0..3 {
                min[c] = min[c].min(corner[c]);
                max[c] = max[c].max(corner[c]);
            }
        }
        let delta = 4.0 * 2f32.powi(-19);
        let rooms = RoomCount::Exactly(1);
        let options = Options { delta, bounds_min: min, bounds_max: max, rooms, hints: Vec::new() };
        let parts = partition(&model.triangles, &|_| true, &options).expect("a sound scene");
        let tables = parts.finish(&model.triangles);
        let all = model.triangles.iter().zip(&model.materials).enumerate();
        let mesh = TileMesh::build_blob(all.map(|(i, (&t, &m))| (i as u32, m, t)));
        let view = TileMesh::from_blob(&mesh).expect("a mesh");
        let mut blob = StructureKind::Bvh.build(&view, delta);
        StructureKind::Bvh.complete(&mut blob, &view).expect("of this mesh");
        Self { tables, mesh, blob, materials, delta }
    }

    /// Traces photons that `start` gives (origin, direction, triangle), 1 W each.
    fn trace(&self, count: u32, start: impl Fn(u32) -> (Vec3, Vec3, u32)) -> Found {
        self.trace_in(Group::default(), count, start)
    }

    fn trace_in(
        &self,
        mut group: Group,
        count: u32,
        start: impl Fn(u32) -> (Vec3, Vec3, u32),
    ) -> Found {
        let t = &self.tables;
        let bsp = Bsp::new(&t.planes, &t.nodes, &t.leaves, &t.faces, f64::from(self.delta))
            .expect("a tree");
        let mesh = TileMesh::from_blob(&self.mesh).expect("a mesh");
        let structure = Structure::from_blob(StructureKind::Bvh, &self.blob, mesh, self.delta)
            .expect("a structure");
        let tile = bsp.leaves[0].tile;
        let resident = Resident {
            tile,
            bsp: &bsp,
            structure: &structure,
            materials: &self.materials,
            texturing: Default::default(),
            delta: self.delta,
        };
        let mut found = Found::default();
        let mut next = 0;
        trace_all(&resident, 5, &mut group, &mut found, |_| {
            (next < count).then(|| {
                let (origin, direction, triangle) = start(next);
                next += 1;
                TransitRecord {
                    origin: origin.to_array(),
                    direction: direction.to_array(),
                    flux: [1.0; 3],
                    leaf: bsp.locate_towards(origin.as_dvec3(), direction.as_dvec3()),
                    photon: next - 1,
                    flags: TRANSIT_UNSCATTERED,
                    last_triangle: triangle,
                    ..TransitRecord::default()
                }
            })
        });
        assert_eq!(found.ended, u64::from(count), "nothing escapes from a closed box");
        found
    }
}

#[derive(Default)]
struct Found {
    impacts: Vec<PhotonRecord>,
    ended: u64,
    absorbed: f64,
}

impl Found {
    fn flux(&self, keep: impl Fn(&PhotonRecord) -> bool) -> f64 {
        let kept = self.impacts.iter().filter(|p| keep(p));
        kept.map(|p| f64::from(rgbe::decode(p.flux)[1])).sum()
    }
}

impl Sink for Found {
    fn impact(&mut self, _: u32, _: u32, photon: PhotonRecord) {
        self.impacts.push(photon);
    }
    fn park(&mut self, _: u32, _: TransitRecord) {
        panic!("there is one tile");
    }
    fn passage(&mut self, _: u32, _: u32, _: &TransitRecord) {}
    fn absorb(&mut self, _: u32, flux: Vec3) {
        self.absorbed += f64::from(flux.y);
    }
    fn ended(&mut self, _: u32, _: u32) {
        self.ended += 1;
    }
    fn escaped(&mut self, _: u32, _: u32, _: Vec3) {
        panic!("there is no way out");
    }
    fn strayed(&mut self, _: u32, _: Vec3) {
        panic!("nothing is aimed");
    }
    fn probed(&mut self, _: u32, _: u32) {}
}

fn glass(index: f32, absorption: f32) -> MaterialRecord {
    MaterialRecord {
        transmission: [1.0; 3],
        absorption: [absorption; 3],
        index,
        flags: MATERIAL_SOLID | MATERIAL_SEE_THROUGH,
        ..MaterialRecord::BLACK
    }
}

/// Transmittance of a slab for unpolarised light, inter-reflections summed (Airy's sum without phases) for each way that
/// light swings.
fn slab(theta: f64, n: f64, k: f64, thick: f64) -> f64 {
    let (c, s) = (theta.cos(), theta.sin());
    let inner = (1.0 - s * s / (n * n)).sqrt();
    let a = (-k * thick / inner).exp();
    let along = ((n * c - inner) / (n * c + inner)).powi(2);
    let across = ((c - n * inner) / (c + n * inner)).powi(2);
    let through = |r: f64| (1.0 - r).powi(2) * a / (1.0 - r * r * a * a);
    0.5 * (through(along) + through(across))
}

/// CIE 171:2006, 5.5: clear glass of 6 mm, n = 1.52, 7 /m: transmittance by angle within 1 %. Photons are 100,000 an
/// angle: one deviation is 0.12 % of T at 0 degrees and 0.38 % at 80, where 1 % is 2.6 of them (1 in 100).
#[test]
fn a_slab_of_clear_glass() {
    let mut model = Model::default();
    model.cuboid([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0], true, 0);
    model.cuboid([-0.8, -0.8, 0.0], [0.8, 0.8, 0.006], false, 1);
    let world = World::new(&model, vec![MaterialRecord::BLACK, glass(1.52, 7.0)]);
    let table = [1.0, 1.0, 0.998, 0.995, 0.986, 0.964, 0.909, 0.777, 0.481];
    let straight = slab(0.0, 1.52, 7.0, 0.006);
    assert!((straight - 0.880).abs() < 0.001);
    let count = 100_000u32;
    let mut first = 0.0;
    for (i, published) in table.into_iter().enumerate() {
        let theta = (10.0 * i as f64).to_radians();
        let expected = slab(theta, 1.52, 7.0, 0.006);
        assert!((expected / straight - published).abs() < 0.002, "{expected} {published}");
        let direction = Vec3::new(theta.sin() as f32, 0.0, -theta.cos() as f32);
        let from = Vec3::new(0.0, 0.0, 0.006) - direction * 0.1;
        let found = world.trace(count, |_| (from, direction, NONE));
        let t = found.flux(|p| p.position()[2] < 0.0) / f64::from(count);
        let deviation = (expected * (1.0 - expected) * 1.05 / f64::from(count)).sqrt();
        assert!((t - expected).abs() < 4.5 * deviation, "{i}0 degrees: {t} for {expected}");
        assert!((t - expected).abs() < 0.01 * expected, "{i}0 degrees: {t} for {expected}");
        first = if i == 0 { t } else { first };
        assert!((t / first - published).abs() < 0.012, "{i}0 degrees: {t} of {first}");
        // All that came through is marked as such, and nothing as direct.
        let behind = |p: &PhotonRecord| p.position()[2] < 0.0;
        assert_eq!(found.flux(|p| behind(p) && p.flags & PHOTON_CAUSTIC == 0), 0.0);
        assert_eq!(found.flux(|p| behind(p) && p.flags & PHOTON_DIRECT != 0), 0.0);
    }
}

/// A box of side 2 that glows and reflects half, with something in it that loses nothing: the light is the same
/// everywhere, and on the walls 1/(1 - rho) of what it would be without reflections. Returns irradiance on the walls and
/// on the thing (within `radius` of the middle), in units of that.
fn furnace(thing: impl Fn(&mut Model), material: MaterialRecord, area: f64) -> (f64, f64) {
    let mut model = Model::default();
    model.cuboid([-1.0; 3], [1.0; 3], true, 0);
    let walls = model.triangles.clone();
    thing(&mut model);
    let wall = MaterialRecord { diffuse: [0.5; 3], ..MaterialRecord::BLACK };
    let world = World::new(&model, vec![wall, material]);
    let count = 100_000;
    let found = world.trace(count, |photon| {
        let u = rng::uniforms(9, Purpose::Emission, 0, photon, 0, 0);
        let v = rng::uniforms(9, Purpose::Emission, 0, photon, 0, 1);
        let index = ((u[0] * walls.len() as f32) as usize).min(walls.len() - 1);
        let [a, b, c] = walls[index].map(Vec3::from);
        let normal = (b - a).cross(c - a).normalize();
        let (s, t) = vector::triangle(u[1], u[2]);
        let at = a * (1.0 - s - t) + b * s + c * t + normal * (world.delta * 0.25);
        (at, vector::cosine(normal, v[0], v[1]), index as u32)
    });
    let expected = f64::from(count) / 24.0 / (1.0 - 0.5);
    let at_wall = |p: &PhotonRecord| p.position().iter().any(|x| x.abs() > 0.999);
    let wall = found.flux(at_wall) / 24.0 / expected;
    let thing = found.flux(|p| !at_wall(p)) / area / expected;
    let balance = found.absorbed / f64::from(count) - 1.0;
    assert!(balance.abs() < 1e-6, "what is emitted is absorbed: {balance}");
    (wall, thing)
}

/// Impacts of a photon are geometric: deviation sqrt(rho) of the mean 2, divided by the root of the count.
const WALLS: f64 = 0.71 / 316.2;

#[test]
fn furnace_with_a_sphere_of_glass() {
    for index in [1.0, 1.5, 2.4] {
        let ball = |model: &mut Model| model.sphere(Vec3::ZERO, 0.6, 3, 1);
        let (wall, _) = furnace(ball, glass(index, 0.0), 1.0);
        assert!((wall - 1.0).abs() < 4.5 * WALLS, "index {index}: {wall}");
    }
    // Glass that absorbs takes light away.
    let ball = |model: &mut Model| model.sphere(Vec3::ZERO, 0.6, 3, 1);
    let (wall, _) = furnace(ball, glass(1.5, 2.0), 1.0);
    assert!(wall < 0.8, "{wall}");
}

/// White matter below a gloss reflects all there is, from any side: as if it was not there. Rough gloss loses up to the
/// safety of its table.
#[test]
fn furnace_with_a_glossy_thing() {
    for (alpha, lost) in [(0.0, 0.0), (0.05, 0.004), (0.3, 0.006), (0.8, 0.006)] {
        for f0 in [0.04, 0.6] {
            let gloss = MaterialRecord {
                diffuse: [1.0; 3],
                specular: [f0; 3],
                roughness: alpha,
                flags: MATERIAL_GLOSS,
                ..MaterialRecord::BLACK
            };
            let cube = |model: &mut Model| model.cuboid([-0.4; 3], [0.4; 3], false, 1);
            let (wall, thing) = furnace(cube, gloss, 6.0 * 0.64);
            let place = format!("alpha {alpha}, f0 {f0}: walls {wall}, thing {thing}");
            assert!(wall < 1.0 + 4.5 * WALLS && wall > 1.0 - lost - 4.5 * WALLS, "{place}");
            // 32,000 impacts and more of varied flux.
            assert!((thing - 1.0).abs() < 0.03 + lost, "{place}");
        }
    }
}

/// Everything a photon does, over walls of many leaves, with each set of instructions that the machine has: the same impacts,
/// bit for bit, and the same that is absorbed.
#[test]
fn photons_do_not_depend_on_instructions() {
    let mut model = Model::default();
    model.cuboid([-1.0; 3], [1.0; 3], true, 0);
    // Walls that reach through half of the room, so that there are several leaves.
    model.cuboid([-0.02, -1.0, -1.0], [0.02, 0.2, 1.0], false, 1);
    model.cuboid([0.02, 0.18, -1.0], [0.6, 0.2, 0.5], false, 2);
    model.sphere(Vec3::new(-0.5, 0.5, -0.4), 0.3, 3, 3);
    model.cuboid([0.3, -0.8, -1.0], [0.7, -0.4, -0.3], false, 4);
    let matter = |diffuse| MaterialRecord { diffuse, ..MaterialRecord::BLACK };
    let gloss = MaterialRecord {
        specular: [0.3; 3],
        roughness: 0.2,
        flags: MATERIAL_GLOSS,
        ..matter([0.5, 0.4, 0.2])
    };
    let mirror = MaterialRecord { specular: [0.8, 0.9, 0.7], ..MaterialRecord::BLACK };
    let materials =
        vec![matter([0.8, 0.7, 0.6]), matter([0.9, 0.1, 0.5]), gloss, glass(1.5, 1.0), mirror];
    let world = World::new(&model, materials);
    let count = 20_000;
    let mut first: Option<Found> = None;
    for instructions in Instructions::ALL.into_iter().filter(|level| level.available()) {
        let mut found = world.trace_in(Group::with_instructions(instructions), count, |photon| {
            let u = rng::uniforms(9, Purpose::Emission, 0, photon, 0, 0);
            (Vec3::new(0.9, -0.9, 0.9), vector::sphere(u[0], u[1]), NONE)
        });
        let bytes = |p: &PhotonRecord| <[u8; 24]>::try_from(p.as_bytes()).expect("24 bytes");
        found.impacts.sort_unstable_by_key(bytes);
        assert!(found.impacts.len() > 2 * count as usize, "{}", found.impacts.len());
        let Some(first) = &first else {
            first = Some(found);
            continue;
        };
        assert_eq!(found.impacts.len(), first.impacts.len(), "{instructions:?}");
        let mut pairs = found.impacts.iter().zip(&first.impacts);
        assert!(pairs.all(|(a, b)| a.as_bytes() == b.as_bytes()), "{instructions:?}");
        assert_eq!(found.ended, first.ended);
        // A sum in another order of arrival may round differently.
        assert!((found.absorbed / first.absorbed - 1.0).abs() < 1e-12, "{instructions:?}");
    }
}

/// A ray into a sphere leaves it where Snell's law says.
#[test]
fn a_sphere_bends_light() {
    let mut model = Model::default();
    model.cuboid([-1.0; 3], [1.0; 3], true, 0);
    model.sphere(Vec3::ZERO, 0.5, 6, 1);
    let world = World::new(&model, vec![MaterialRecord::BLACK, glass(1.5, 0.0)]);
    for height in [0.1f32, 0.25, 0.4] {
        let found = world.trace(400, |_| (Vec3::new(0.0, height, 0.9), Vec3::NEG_Z, NONE));
        // The angle of incidence a, inside b; turned by 2 (a - b).
        let a = f64::from(height / 0.5).asin();
        let b = (a.sin() / 1.5).asin();
        let turn = 2.0 * (a - b);
        let (at_y, at_z) = (0.5 * (a - turn).sin(), -0.5 * (a - turn).cos());
        let expected = at_y - (1.0 + at_z) * turn.tan();
        let through: Vec<f64> = found
            .impacts
            .iter()
            .filter(|p| p.position()[2] < -0.999 && p.position()[0].abs() < 0.05)
            .map(|p| f64::from(p.position()[1]))
            .collect();
        assert!(through.len() > 300, "{}", through.len());
        // Facets of a fine sphere: a few degrees.
        let near = through.iter().filter(|y| (*y - expected).abs() < 0.03).count();
        assert!(near * 10 > through.len() * 9, "{height}: {expected}, {:?}", &through[..5]);
    }
}
