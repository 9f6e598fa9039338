//! Direct daylight at a shading point.
//!
//! Inside, light of the sky is asked for opening by opening: a point on the opening, and on through it to the scene's
//! bound. Only rays that leave through that opening first count for it, so that each is counted once. Outside, and through
//! cracks that are no openings, directions are drawn from the sky itself. The sun is asked for directly, whatever
//! opening it shines through: a direction to its disc says it all.

use enf_layout::NONE;
use enf_layout::light::{EmitterRecord, LIGHT_SUN, LightRecord};
use enf_stage::tables::Tables;
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

/// Turns a room's set of lights (ascending ids with shares) into what its points choose from, and says whether they ask for the
/// sun besides: where it shines through any opening, and outside.
pub(crate) fn adapt(lights: &mut Vec<(u32, f32)>, tables: &Tables, room: u32) -> bool {
    let all = tables.lights();
    let outdoors = outdoors(tables, room);
    let mut sun = false;
    lights.retain(|&(id, _)| {
        let light = &all[id as usize];
        sun |= light.kind == LIGHT_SUN;
        // The light of an opening is that of its room, not of the outside.
        light.kind != LIGHT_SUN && !(outdoors && Daylight::is_daylight(light))
    });
    if outdoors {
        // Sky and sun that come through no opening are the last of all lights.
        let last = all.len().saturating_sub(2)..all.len();
        for id in last.filter(|&id| Daylight::is_everywhere(&all[id])) {
            if all[id].kind == LIGHT_SUN {
                sun = true;
            } else {
                lights.push((id as u32, 1.0));
            }
        }
    }
    sun
}

/// Importance of a light at a surface, where daylight has its own: in the unit of lights that have a place, flux over
/// distance squared (pi times the irradiance). `None` for others.
pub(crate) fn importance(
    daylight: &Daylight,
    light: &LightRecord,
    normal: Vec3,
    outdoors: bool,
) -> Option<f32> {
    if light.kind == LIGHT_SUN || (outdoors && !Daylight::is_everywhere(light)) {
        return Daylight::is_daylight(light).then_some(0.0);
    }
    if !Daylight::is_everywhere(light) {
        return None;
    }
    let guess = core::f32::consts::PI * daylight.guess(normal);
    Some(if outdoors { guess } else { guess * THROUGH_CRACKS })
}

/// What a shading point asks for anyway.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Asked {
    /// It lies outside.
    pub(crate) outdoors: bool,
    /// It asks for the sun on its own.
    pub(crate) sun: bool,
}

fn far(direction: Vec3, irradiance: Vec3) -> Option<Sample> {
    Some(Sample { direction, distance: f32::INFINITY, cos_light: 1.0, irradiance, triangle: NONE })
}

/// A direction to the sun's disc from two uniform numbers; `None` where it cannot arrive.
pub(crate) fn sun(daylight: &Daylight, surface: &Surface, u: [f32; 2]) -> Option<Sample> {
    let direction = daylight.sample_sun(u);
    let cos = direction.dot(surface.normal);
    if cos > 0.0 { far(direction, daylight.sun_irradiance() * cos) } else { None }
}

/// A direction to a daylight light from three uniform numbers; `None` where nothing arrives, or what does is another
/// light's.
pub(crate) fn sample(
    daylight: &Daylight,
    light: &LightRecord,
    emitters: &[EmitterRecord],
    surface: &Surface,
    v: [f32; 3],
    Asked { outdoors, sun }: Asked,
) -> Option<Sample> {
    if light.kind == LIGHT_SUN && (sun || !Daylight::is_everywhere(light)) {
        return None;
    }
    if !Daylight::is_everywhere(light) {
        if outdoors {
            return None;
        }
        let (direction, distance, density) =
            daylight.sample_opening(light, emitters, surface.origin, v)?;
        let cos = direction.dot(surface.normal);
        if cos <= 0.0 || daylight.leaves_before(surface.origin, direction, distance) {
            return None;
        }
        return far(direction, daylight.radiance(direction) * (cos / density));
    }
    if light.kind == LIGHT_SUN {
        return self::sun(daylight, surface, [v[0], v[1]]);
    }
    let (direction, density) = daylight.sample(surface.normal, v);
    let cos = direction.dot(surface.normal);
    if !(cos > 0.0 && density > 0.0)
        || (!outdoors && daylight.leaves_before(surface.origin, direction, f32::INFINITY))
    {
        return None;
    }
    far(direction, daylight.radiance(direction) * (cos / density))
}
