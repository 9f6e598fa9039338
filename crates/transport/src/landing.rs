//! Where photons land, for many of them at once: the point and its normal, the random numbers, and what bare matter makes of
//! them. Loops over arrays, lane by lane without a branch, which a compiler turns into vector instructions; what they find is what
//! [`Surface::at`], [`rng::uniforms`], [`crate::scatter::scatter`], [`octahedral::encode`] and [`rgbe::encode`] say for
//! one photon, bit for bit.

// Indices say which lane, in every array of a loop.
#![allow(clippy::needless_range_loop)]

use enf_geometry::Instructions;
use enf_layout::{octahedral, rgbe};
use glam::Vec3;
use pulp::{Arch, NullaryFnOnce};

use crate::flight::Surface;
use crate::rng::{self, Purpose};
use crate::scatter::{Event, MAX_SURVIVAL};
use crate::vector;

/// What these instructions, or the best lesser ones that there are, are called by `pulp`.
pub(crate) fn arch(instructions: Instructions) -> Arch {
    #[cfg(target_arch = "x86_64")]
    if instructions == Instructions::Avx2
        && let Some(level) = pulp::x86::V3::try_new()
    {
        return Arch::V3(level);
    }
    match instructions {
        Instructions::Avx512 => Arch::new(),
        _ => Arch::Scalar,
    }
}

/// Photons that are worked at together.
pub(crate) const LANES: usize = 32;

type Lanes<T> = [T; LANES];
/// Three coordinates or channels.
type Lanes3<T> = [Lanes<T>; 3];

/// What is asked, and what is found. Lanes that nobody uses hold anything.
#[derive(Clone)]
pub(crate) struct Landing {
    /// Corners of the triangle: corner, axis, lane.
    corners: [Lanes3<f32>; 3],
    u: Lanes<f32>,
    v: Lanes<f32>,
    direction: Lanes3<f32>,
    flux: Lanes3<f32>,
    /// Lambert reflectance.
    diffuse: Lanes3<f32>,
    light: Lanes<u32>,
    photon: Lanes<u32>,
    bounce: Lanes<u32>,
    triangle: Lanes<u32>,
    material: Lanes<u32>,

    position: Lanes3<f32>,
    normal: Lanes3<f32>,
    origin: Lanes3<f32>,
    front: Lanes<u32>,
    uniforms: [Lanes<f32>; 4],
    dither: Lanes3<f32>,
    survives: Lanes<u32>,
    onward: Lanes3<f32>,
    after: Lanes3<f32>,
    /// What is stored: flux, direction and normal.
    codes: Lanes<u32>,
    directions: [Lanes<u32>; 2],
}

/// A photon where it lands.
pub(crate) struct Asked {
    pub(crate) corners: [Vec3; 3],
    pub(crate) u: f32,
    pub(crate) v: f32,
    pub(crate) direction: Vec3,
    pub(crate) flux: Vec3,
    /// Lambert reflectance of bare matter; anything else is found by the caller.
    pub(crate) diffuse: Vec3,
    pub(crate) light: u32,
    pub(crate) photon: u32,
    pub(crate) bounce: u16,
    pub(crate) triangle: u32,
    pub(crate) material: u32,
}

#[inline(always)]
fn put(lanes: &mut Lanes3<f32>, lane: usize, v: Vec3) {
    for (axis, x) in lanes.iter_mut().zip(v.to_array()) {
        axis[lane] = x;
    }
}

#[inline(always)]
fn get(lanes: &Lanes3<f32>, lane: usize) -> Vec3 {
    Vec3::new(lanes[0][lane], lanes[1][lane], lanes[2][lane])
}

impl Default for Landing {
    fn default() -> Self {
        const F: Lanes<f32> = [0.0; LANES];
        const U: Lanes<u32> = [0; LANES];
        Self {
            corners: [[F; 3]; 3],
            u: F,
            v: F,
            direction: [F; 3],
            // Lanes that were never used are no extremes.
            flux: [[1.0; LANES]; 3],
            diffuse: [F; 3],
            light: U,
            photon: U,
            bounce: U,
            triangle: U,
            material: U,
            position: [F; 3],
            normal: [F; 3],
            origin: [F; 3],
            front: U,
            uniforms: [F; 4],
            dither: [F; 3],
            survives: U,
            onward: [F; 3],
            after: [F; 3],
            codes: U,
            directions: [U; 2],
        }
    }
}

impl Landing {
    #[inline(always)]
    pub(crate) fn ask(&mut self, lane: usize, asked: &Asked) {
        let lane = lane % LANES;
        for (corner, &p) in self.corners.iter_mut().zip(&asked.corners) {
            put(corner, lane, p);
        }
        (self.u[lane], self.v[lane]) = (asked.u, asked.v);
        put(&mut self.direction, lane, asked.direction);
        put(&mut self.flux, lane, asked.flux);
        put(&mut self.diffuse, lane, asked.diffuse);
        self.light[lane] = asked.light;
        self.photon[lane] = asked.photon;
        self.bounce[lane] = u32::from(asked.bounce);
        (self.triangle[lane], self.material[lane]) = (asked.triangle, asked.material);
    }

    /// Finds everything: for `seed` and a ray's lift off its surface (m).
    pub(crate) fn find(&mut self, arch: Arch, seed: u64, lift: f32) {
        arch.dispatch(Find { landing: self, seed, lift });
    }

    #[inline(always)]
    pub(crate) fn surface(&self, lane: usize) -> Surface {
        let lane = lane % LANES;
        Surface {
            position: get(&self.position, lane),
            normal: get(&self.normal, lane),
            front: self.front[lane] != 0,
            origin: get(&self.origin, lane),
            triangle: self.triangle[lane],
            material: self.material[lane],
        }
    }

    /// Numbers of the interaction.
    #[inline(always)]
    pub(crate) fn uniforms(&self, lane: usize) -> [f32; 4] {
        let lane = lane % LANES;
        [0, 1, 2, 3].map(|i| self.uniforms[i][lane])
    }

    /// Numbers for the rounding of what is stored.
    #[inline(always)]
    pub(crate) fn dither(&self, lane: usize) -> [f32; 3] {
        let lane = lane % LANES;
        [0, 1, 2].map(|i| self.dither[i][lane])
    }

    /// What bare matter makes of the photon, and the flux that goes on.
    #[inline(always)]
    pub(crate) fn event(&self, lane: usize) -> (Event, Vec3) {
        let lane = lane % LANES;
        match self.survives[lane] {
            0 => (Event::Absorbed, Vec3::ZERO),
            _ => (Event::Diffuse(get(&self.onward, lane)), get(&self.after, lane)),
        }
    }

    /// The flux times the Lambert reflectance.
    #[inline(always)]
    pub(crate) fn weakened(&self, lane: usize) -> Vec3 {
        let lane = lane % LANES;
        get(&self.flux, lane) * get(&self.diffuse, lane)
    }

    /// Code of the photon's flux, as it arrives.
    #[inline(always)]
    pub(crate) fn flux_code(&self, lane: usize) -> [u8; 4] {
        self.codes[lane % LANES].to_le_bytes()
    }

    /// Codes of the photon's direction and of the normal.
    #[inline(always)]
    pub(crate) fn codes(&self, lane: usize) -> [u32; 2] {
        let lane = lane % LANES;
        [0, 1].map(|i| self.directions[i][lane])
    }
}

struct Find<'a> {
    landing: &'a mut Landing,
    seed: u64,
    lift: f32,
}

impl NullaryFnOnce for Find<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { landing, seed, lift } = self;
        surfaces(landing, lift);
        numbers(landing, seed);
        reflect(landing);
        codes(landing);
        fluxes(landing);
    }
}

/// As [`Surface::at`], step by step: short loops are those that become vector instructions.
#[inline(always)]
fn surfaces(l: &mut Landing, lift: f32) {
    const F: Lanes<f64> = [0.0; LANES];
    let (mut edge, mut other, mut normal) = ([F; 3], [F; 3], [F; 3]);
    for k in 0..3 {
        for i in 0..LANES {
            let (a, b, c) = (l.corners[0][k][i], l.corners[1][k][i], l.corners[2][k][i]);
            let (a, b, c) = (f64::from(a), f64::from(b), f64::from(c));
            let (u, v) = (f64::from(l.u[i]), f64::from(l.v[i]));
            edge[k][i] = b - a;
            other[k][i] = c - a;
            l.position[k][i] = (a * (1.0 - u - v) + b * u + c * v) as f32;
        }
    }
    let [[ex, ey, ez], [fx, fy, fz]] = [&edge, &other];
    for i in 0..LANES {
        normal[0][i] = ey[i] * fz[i] - fy[i] * ez[i];
        normal[1][i] = ez[i] * fx[i] - fz[i] * ex[i];
        normal[2][i] = ex[i] * fy[i] - fx[i] * ey[i];
    }
    let mut doubtful = [false; LANES];
    let [nx, ny, nz] = &normal;
    for i in 0..LANES {
        let square = |x: f64, y: f64, z: f64| x * x + y * y + z * z;
        let longest = square(ex[i], ey[i], ez[i]).max(square(fx[i], fy[i], fz[i])).max(square(
            fx[i] - ex[i],
            fy[i] - ey[i],
            fz[i] - ez[i],
        ));
        let (u, v) = (f64::from(l.u[i]), f64::from(l.v[i]));
        let least = (1.0 - u - v).min(u).min(v).max(0.0);
        // A little more than what counts: this rounds otherwise.
        let needed = f64::from(lift) * f64::from(lift) * 1.01;
        let clear = least * least * square(nx[i], ny[i], nz[i]) >= needed * longest;
        doubtful[i] = !clear;
    }
    if doubtful.contains(&true) {
        stay_off_edges(l, &doubtful, lift);
    }
    let mut scale = F;
    for i in 0..LANES {
        scale[i] = 1.0 / (nx[i] * nx[i] + ny[i] * ny[i] + nz[i] * nz[i]).sqrt();
    }
    for axis in &mut normal {
        for i in 0..LANES {
            let some = (scale[i] < f64::INFINITY) & (scale[i] > 0.0);
            let n = axis[i] * scale[i];
            axis[i] = if some { n } else { 0.0 };
        }
    }
    let [nx, ny, nz] = &normal;
    let [dx, dy, dz] = &l.direction;
    for i in 0..LANES {
        let (dx, dy, dz) = (f64::from(dx[i]), f64::from(dy[i]), f64::from(dz[i]));
        let along = nx[i] * dx + ny[i] * dy + nz[i] * dz;
        l.front[i] = u32::from(along < 0.0);
    }
    for k in 0..3 {
        for i in 0..LANES {
            let n = normal[k][i] as f32;
            let n = if l.front[i] != 0 { n } else { -n };
            l.normal[k][i] = n;
            l.origin[k][i] = l.position[k][i] + n * lift;
        }
    }
}

/// Points that may be too near to an edge.
#[cold]
#[inline(never)]
fn stay_off_edges(l: &mut Landing, doubtful: &Lanes<bool>, lift: f32) {
    for i in (0..LANES).filter(|&i| doubtful[i]) {
        let corners = [0, 1, 2].map(|k| get(&l.corners[k], i).as_dvec3());
        let (u, v) = (f64::from(l.u[i]), f64::from(l.v[i]));
        put(&mut l.position, i, vector::off_edges(corners, u, v, f64::from(lift)).as_vec3());
    }
}

#[inline(always)]
fn numbers(l: &mut Landing, seed: u64) {
    for i in 0..LANES {
        let (light, photon, bounce) = (l.light[i], l.photon[i], l.bounce[i] as u16);
        let u = rng::uniforms(seed, Purpose::Scatter, light, photon, bounce, 0);
        l.uniforms[0][i] = u[0];
        l.uniforms[1][i] = u[1];
        l.uniforms[2][i] = u[2];
        l.uniforms[3][i] = u[3];
    }
    for i in 0..LANES {
        let (light, photon, bounce) = (l.light[i], l.photon[i], l.bounce[i] as u16);
        let u = rng::uniforms(seed, Purpose::Dither, light, photon, bounce, 0);
        l.dither[0][i] = u[0];
        l.dither[1][i] = u[1];
        l.dither[2][i] = u[2];
    }
}

/// As [`crate::scatter::scatter`] where a Lambert lobe is all that there is.
#[inline(always)]
fn reflect(l: &mut Landing) {
    for i in 0..LANES {
        let flux = [l.flux[0][i], l.flux[1][i], l.flux[2][i]];
        let weak =
            [flux[0] * l.diffuse[0][i], flux[1] * l.diffuse[1][i], flux[2] * l.diffuse[2][i]];
        let total = flux[0] + flux[1] + flux[2];
        let sum = (weak[0] + weak[1] + weak[2]) / total;
        let scale = if sum > MAX_SURVIVAL { MAX_SURVIVAL / sum } else { 1.0 };
        let survival = sum * scale;
        let survives = (total > 0.0) & (sum > 0.0) & (l.uniforms[0][i] < survival);
        l.survives[i] = u32::from(survives);
        l.after[0][i] = weak[0] / survival;
        l.after[1][i] = weak[1] / survival;
        l.after[2][i] = weak[2] / survival;
    }
    for i in 0..LANES {
        let n = Vec3::new(l.normal[0][i], l.normal[1][i], l.normal[2][i]);
        let (u1, u2) = (l.uniforms[1][i], l.uniforms[2][i]);
        let [x, y, z] = vector::cosine_by(n, u1, vector::around(u2)).to_array();
        l.onward[0][i] = x;
        l.onward[1][i] = y;
        l.onward[2][i] = z;
    }
}

#[inline(always)]
fn codes(l: &mut Landing) {
    for (vectors, codes) in [&l.direction, &l.normal].into_iter().zip(&mut l.directions) {
        let [x, y, z] = vectors;
        for i in 0..LANES {
            codes[i] = octahedral::encode([x[i], y[i], z[i]]);
        }
    }
}

/// As [`rgbe::encode`] where neither flux nor code is extreme; what is not is found by itself.
#[inline(always)]
fn fluxes(l: &mut Landing) {
    let ([r, g, b], [s, t, u]) = (&l.flux, &l.dither);
    let mut extreme = 0u32;
    for i in 0..LANES {
        let (largest, least) = (r[i].max(g[i]).max(b[i]), r[i].min(g[i]).min(b[i]));
        let exponent = largest.to_bits() >> 23;
        extreme |= u32::from((exponent.wrapping_sub(64) > 128) | (least < 0.0));
        // 2^(8 - e), with e the exponent of frexp, which is that of the bits less 126.
        let once = f32::from_bits(261u32.wrapping_sub(exponent) << 23);
        let fits = |scale: f32| {
            (r[i] * scale + s[i] < 256.0)
                & (g[i] * scale + t[i] < 256.0)
                & (b[i] * scale + u[i] < 256.0)
        };
        let (scale, exponent) =
            if fits(once) { (once, exponent) } else { (once * 0.5, exponent + 1) };
        let [r, g, b] = [
            rgbe::whole(r[i] * scale + s[i]),
            rgbe::whole(g[i] * scale + t[i]),
            rgbe::whole(b[i] * scale + u[i]),
        ];
        l.codes[i] = r | g << 8 | b << 16 | (exponent + 2) << 24;
    }
    if extreme != 0 {
        for i in 0..LANES {
            l.codes[i] = u32::from_le_bytes(rgbe::encode([r[i], g[i], b[i]], [s[i], t[i], u[i]]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scatter::{self, Lobes};

    const SEED: u64 = 7;
    const LIFT: f32 = 1e-5;

    /// Photons on triangles of all sizes and attitudes, some of them as black, as white, as weak or as strong as can be.
    fn asked(lane: usize, round: u32) -> Asked {
        let number = |i: u32| rng::uniforms(round.into(), Purpose::Camera, lane as u32, i, 0, 0);
        let vector = |i: u32| Vec3::from_slice(&number(i)) * 2.0 - Vec3::ONE;
        let size = [1.0, 100.0, 1e-4][round as usize % 3];
        let corners = [0, 1, 2].map(|i| vector(3) * 10.0 + vector(i) * size);
        let [u, v, share, power] = number(4);
        // Some on an edge, or next to one.
        let u = if lane.is_multiple_of(7) { u * 1e-6 * (lane % 2) as f32 } else { u };
        let direction = match round % 8 {
            0 => Vec3::AXES[lane % 3],
            _ => vector(5).normalize(),
        };
        let strength = [1.0, 1e-30, 1e-3, 1e30, 0.0][if power < 0.1 { lane % 5 } else { 0 }];
        let [r, g, b, _] = number(6);
        let diffuse = [Vec3::ZERO, Vec3::ONE, Vec3::new(r, g, b)][(share * 9.0).min(2.0) as usize];
        Asked {
            corners,
            u: u * (1.0 - v),
            v,
            direction,
            flux: Vec3::from_slice(&number(7)) * strength,
            diffuse,
            light: round,
            photon: lane as u32 * 77,
            bounce: round as u16 % 50,
            triangle: 5,
            material: 6,
        }
    }

    #[test]
    fn lanes_find_what_one_photon_finds() {
        let (mut survivors, mut dead) = (0, 0);
        for round in 0..300 {
            let all: Vec<Asked> = (0..LANES).map(|lane| asked(lane, round)).collect();
            let mut landing = Landing::default();
            for (lane, asked) in all.iter().enumerate() {
                landing.ask(lane, asked);
            }
            let found = Instructions::ALL.map(|instructions| {
                let mut landing = landing.clone();
                landing.find(arch(instructions), SEED, LIFT);
                landing
            });
            for (lane, asked) in all.iter().enumerate() {
                let (at, direction) = ([asked.u, asked.v], asked.direction);
                let at = Surface::at(asked.corners, at, direction, LIFT);
                let surface = Surface { triangle: 5, material: 6, ..at };
                let (light, photon, bounce) = (asked.light, asked.photon, asked.bounce);
                let u = rng::uniforms(SEED, Purpose::Scatter, light, photon, bounce, 0);
                let d = rng::uniforms(SEED, Purpose::Dither, light, photon, bounce, 0);
                let lobes = Lobes { diffuse: asked.diffuse, ..Lobes::BLACK };
                let normal = surface.normal;
                let expected =
                    scatter::scatter(&lobes, direction, normal, asked.flux, [u[0], u[1], u[2]]);
                match expected.0 {
                    Event::Absorbed => dead += 1,
                    _ => survivors += 1,
                }
                let flux = rgbe::encode(asked.flux.to_array(), [d[0], d[1], d[2]]);
                let codes = [direction, normal].map(|v| octahedral::encode(v.to_array()));
                for found in &found {
                    let here = found.surface(lane);
                    assert_eq!(format!("{here:?}"), format!("{surface:?}"));
                    assert_eq!(found.uniforms(lane), u);
                    assert_eq!(found.dither(lane), [d[0], d[1], d[2]]);
                    assert_eq!(found.event(lane), expected, "{:?} {lobes:?}", asked.flux);
                    assert_eq!(found.flux_code(lane), flux, "{:?}", asked.flux);
                    assert_eq!(found.codes(lane), codes);
                    assert_eq!(found.weakened(lane), asked.flux * asked.diffuse);
                }
            }
        }
        assert!(survivors > 1000 && dead > 1000, "{survivors} {dead}");
    }
}
