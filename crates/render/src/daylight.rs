//! Direct daylight at a shading point.
//!
//! Inside, light of the sky is asked for opening by opening: a point on the opening, and on through it to the scene's
//! bound. Only rays that leave through that opening first count for it, so that each is counted once. Outside, and through
//! cracks that are no openings, directions are drawn from the sky itself. The sun is asked for directly, whatever
//! opening it shines through: a direction to its disc says it all.

use enf_layout::NONE;
use enf_layout::light::{EmitterRecord, LIGHT_SUN, LightRecord};
use enf_stage::tables::Tables;
use enf_transport::emission;
use enf_transport::flight::Surface;
use enf_transport::sky::Daylight;
use glam::Vec3;

use crate::shade::Sample;

/// Inside, what comes through no opening is worth this much of what it would be outside.
const THROUGH_CRACKS: f32 = 0.02;

/// Whether daylight comes from everywhere in a room: the outside, or the one room that everything is in.
pub(crate) fn outdoors(tables: &Tables, room: u32) -> bool {
    tables.scene.outside == NONE || tables.scene.outside == room
}

/// Sums of the lights' powers, normalised to 1, for the share of shadow rays that goes to any light. Light of the sky
/// through no opening counts at most as much as all others together: there is always more of it than
/// anybody sees.
pub(crate) fn power(lights: &[LightRecord]) -> Vec<f64> {
    let flux = |l: &LightRecord| l.flux_w.iter().map(|&c| f64::from(c)).sum::<f64>();
    // The sun is asked for once, not opening by opening.
    let asked = |l: &LightRecord| l.kind != LIGHT_SUN || Daylight::is_everywhere(l);
    let own = |l: &LightRecord| asked(l) && !Daylight::is_everywhere(l);
    let others: f64 = lights.iter().filter(|l| own(l)).map(flux).sum();
    let weight = |l: &LightRecord| match Daylight::is_everywhere(l) {
        true if others > 0.0 => flux(l).min(others),
        _ if asked(l) => flux(l),
        _ => 0.0,
    };
    let total = lights.iter().map(weight).sum::<f64>().max(f64::MIN_POSITIVE);
    let mut sum = 0.0;
    lights
        .iter()
        .map(|l| {
            sum += weight(l) / total;
            sum
        })
        .collect()
}

/// Turns a room's set of lights (ascending ids with shares) into what its points ask: the sun of any opening becomes
/// the sun; outside, sky and sun are always there.
pub(crate) fn adapt(lights: &mut Vec<(u32, f32)>, tables: &Tables, room: u32) {
    let all = tables.lights();
    let everywhere: Vec<u32> = (0..all.len() as u32)
        .rev()
        .take(2)
        .filter(|&id| Daylight::is_everywhere(&all[id as usize]))
        .collect();
    if everywhere.is_empty() {
        return;
    }
    let outdoors = outdoors(tables, room);
    let mut sun_share = 0.0f32;
    lights.retain(|&(id, share)| {
        let light = &all[id as usize];
        if light.kind == LIGHT_SUN {
            sun_share = sun_share.max(share);
        }
        // The light of an opening is that of its room, not of the outside.
        light.kind != LIGHT_SUN
            && !(outdoors && Daylight::is_daylight(light) && light.emitter_count > 0)
    });
    for &id in everywhere.iter().rev() {
        let sun = all[id as usize].kind == LIGHT_SUN;
        let share = match (outdoors, sun) {
            (true, _) => 1.0,
            (false, true) => sun_share,
            (false, false) => continue,
        };
        if share > 0.0 {
            match lights.binary_search_by_key(&id, |l| l.0) {
                Ok(at) => lights[at].1 = share,
                Err(at) => lights.insert(at, (id, share)),
            }
        }
    }
}

/// Importance of a light at a surface, where daylight has its own: in the unit of lights that have a place, flux over
/// distance squared (pi times the irradiance of a source straight above). `None` for others.
pub(crate) fn importance(
    daylight: &Daylight,
    light: &LightRecord,
    normal: Vec3,
    outdoors: bool,
) -> Option<f32> {
    if Daylight::is_everywhere(light) {
        let guess = core::f32::consts::PI * daylight.guess(light, normal);
        let cracks = !outdoors && light.kind != LIGHT_SUN;
        return Some(if cracks { guess * THROUGH_CRACKS } else { guess });
    }
    (light.kind == LIGHT_SUN || (Daylight::is_daylight(light) && outdoors)).then_some(0.0)
}

/// A direction to a daylight light from three uniform numbers; `None` where nothing arrives, or what does is another
/// light's.
pub(crate) fn sample(
    daylight: &Daylight,
    light: &LightRecord,
    emitters: &[EmitterRecord],
    surface: &Surface,
    v: [f32; 3],
    outdoors: bool,
) -> Option<Sample> {
    let far = |direction: Vec3, irradiance: Vec3| {
        Some(Sample { direction, distance: f32::INFINITY, irradiance, triangle: NONE })
    };
    if !Daylight::is_everywhere(light) {
        if light.kind == LIGHT_SUN || outdoors {
            return None;
        }
        let point = emission::point_on(light, emitters, v);
        let to = point.position - surface.origin;
        let square = to.length_squared();
        let distance = square.sqrt();
        let direction = (to / distance).normalize_or_zero();
        let (cos, cos_opening) = (direction.dot(surface.normal), -direction.dot(point.normal));
        if !(cos > 0.0 && cos_opening > 0.0 && distance > 0.0 && distance.is_finite())
            || daylight.leaves_before(surface.origin, direction, distance)
        {
            return None;
        }
        let solid = light.area_m2 * cos_opening / square;
        return far(direction, daylight.radiance(direction) * (cos * solid));
    }
    if light.kind == LIGHT_SUN {
        let direction = daylight.sample_sun([v[0], v[1]]);
        let cos = direction.dot(surface.normal);
        return if cos > 0.0 { far(direction, daylight.sun_irradiance() * cos) } else { None };
    }
    let (direction, density) = daylight.sample(v);
    let cos = direction.dot(surface.normal);
    if !(cos > 0.0 && density > 0.0)
        || (!outdoors && daylight.leaves_before(surface.origin, direction, f32::INFINITY))
    {
        return None;
    }
    far(direction, daylight.radiance(direction) * (cos / density))
}
