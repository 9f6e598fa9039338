//! Where photons start. A start depends on (seed, light, index) alone.

use enf_layout::NONE;
use enf_layout::light::{
    EmitterRecord, LIGHT_AREA, LIGHT_POINT, LIGHT_PROFILE, LIGHT_SPOT, LightRecord,
};
use enf_layout::profile::Profile;
use glam::Vec3;

use crate::lamp;
use crate::rng::{self, Purpose};
use crate::vector;

/// How far a scattered or emitted ray starts above its surface, as a share of delta: more than the
/// rounding of a point on a triangle, less than anything that is modelled (ARCHITECTURE.md, "Margins").
pub const OFFSET_PER_DELTA: f32 = 0.25;

/// A photon (or probe, or light sample) at its start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Point, already lifted off the surface, m.
    pub origin: Vec3,
    /// Unit direction.
    pub direction: Vec3,
    /// Global index of the emitting triangle, or [`NONE`].
    pub triangle: u32,
}

/// A point on a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightPoint {
    /// Point on the surface, m.
    pub position: Vec3,
    /// Unit normal of the emitting side; the axis of a point light.
    pub normal: Vec3,
    /// Global index of the emitting triangle, or [`NONE`].
    pub triangle: u32,
}

/// A uniform point on a light from three uniform numbers. `emitters` are this light's own. Points of an area keep `margin`, m, off
/// the edges of its triangles: rays that start there need it (see [`vector::off_edges`]), others say 0.
pub fn point_on(
    light: &LightRecord,
    emitters: &[EmitterRecord],
    u: [f32; 3],
    margin: f32,
) -> LightPoint {
    if emitters.is_empty() {
        return LightPoint {
            position: Vec3::from(light.position),
            normal: Vec3::from(light.axis),
            triangle: NONE,
        };
    }
    let index = emitters.partition_point(|e| e.cumulative <= u[0]).min(emitters.len() - 1);
    let emitter = &emitters[index];
    let [a, b, c] = emitter.corners.map(|p| Vec3::from(p).as_dvec3());
    let (v, w) = vector::triangle(u[1], u[2]);
    let (v, w) = (f64::from(v), f64::from(w));
    LightPoint {
        position: vector::off_edges([a, b, c], v, w, f64::from(margin)).as_vec3(),
        normal: (b - a).cross(c - a).normalize_or_zero().as_vec3(),
        triangle: emitter.triangle,
    }
}

/// The start of photon `photon` of light number `id`; `emitters` and `profile` are the light's own.
pub fn start(
    seed: u64,
    id: u32,
    light: &LightRecord,
    emitters: &[EmitterRecord],
    profile: Option<Profile<'_>>,
    photon: u32,
    delta: f32,
) -> Start {
    if let LIGHT_SPOT | LIGHT_PROFILE = light.kind {
        let u = rng::block(seed, Purpose::Emission, id, photon, 0, 0);
        let v = rng::block(seed, Purpose::Emission, id, photon, 0, 1);
        let w: [f64; 4] = std::array::from_fn(|i| rng::fine(u[i], v[i]));
        let direction = match profile {
            Some(profile) if light.kind == LIGHT_PROFILE => lamp::from_measured(light, &profile, w),
            _ => lamp::from_spot(light, [w[0], w[1]]),
        };
        return Start { origin: Vec3::from(light.position), direction, triangle: NONE };
    }
    let u = rng::uniforms(seed, Purpose::Emission, id, photon, 0, 0);
    let v = rng::uniforms(seed, Purpose::Emission, id, photon, 0, 1);
    let lift = delta * OFFSET_PER_DELTA;
    let point = point_on(light, emitters, [u[0], u[1], u[2]], lift);
    match light.kind {
        LIGHT_AREA => Start {
            origin: point.position + point.normal * lift,
            direction: vector::cosine(point.normal, v[0], v[1]),
            triangle: point.triangle,
        },
        LIGHT_POINT => {
            Start { origin: point.position, direction: vector::sphere(v[0], v[1]), triangle: NONE }
        }
        _ => Start {
            origin: point.position,
            direction: vector::cosine(point.normal, v[0], v[1]),
            triangle: NONE,
        },
    }
}

/// Radiant intensity per flux of a point light towards `to`, 1/sr: 1/4pi, cos(theta)/pi about the axis, or what its
/// cone or `profile` says. `to` has length 1.
pub fn point_intensity(light: &LightRecord, profile: Option<Profile<'_>>, to: Vec3) -> f32 {
    match light.kind {
        LIGHT_POINT => core::f32::consts::FRAC_1_PI * 0.25,
        LIGHT_SPOT => lamp::spot(light, to) as f32,
        LIGHT_PROFILE => profile.map_or(0.0, |p| lamp::measured(light, &p, to) as f32),
        _ => Vec3::from(light.axis).dot(to).max(0.0) * core::f32::consts::FRAC_1_PI,
    }
}
