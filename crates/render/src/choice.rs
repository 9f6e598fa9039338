//! What a room's points choose from when they ask for direct light: the lights that reach it, and the parts of such lights.
//!
//! The panels along a corridor are one light: one object of one material. But a point is lit by the two above it. So what lies apart is
//! chosen apart, by its own place and flux; that decides which samples are taken, and each still knows the density with which the
//! whole light would have given it.

use enf_layout::light::{EmitterRecord, LIGHT_AREA, LightRecord};
use enf_stage::tables::Tables;
use glam::Vec3;

use crate::sight;

/// Emitters are of one part up to this gap, m; twice that, and so on, where a light would have too many parts.
const GAP_M: f32 = 0.02;
/// Parts of a light at most.
const PARTS: usize = 32;
/// Lights of a room that are divided into parts at most: those that light most of it. Choosing takes time for each.
const DIVIDED: usize = 32;

/// Bytes of a choice at most, with what it is seen through.
pub(crate) const BYTES: u64 = size_of::<Choice>() as u64 + sight::BYTES;

/// A light, or a part of one.
#[derive(Clone, Debug)]
pub(crate) struct Choice {
    /// The light's id.
    pub(crate) light: u32,
    /// How much of the room the light lights: a factor of its importance.
    pub(crate) share: f32,
    /// The light, or one that is as large, where and as bright as the part.
    pub(crate) part: LightRecord,
    /// Which of the numbers that choose an emitter (see [`EmitterRecord::cumulative`]) fall on the part: from, and until.
    pub(crate) range: [f32; 2],
}

impl Choice {
    /// How much of the light it is.
    pub(crate) fn width(&self) -> f32 {
        self.range[1] - self.range[0]
    }

    /// The number that chooses an emitter of the light, from one in `[0, 1)` that chooses one of the part.
    pub(crate) fn of_part(&self, u: f32) -> f32 {
        (self.range[0] + u * self.width()).min(self.range[1].next_down())
    }
}

/// The choices that a room's lights (ascending ids, shares) are: in the same order, parts by their ranges.
pub(crate) fn choices(lights: &[(u32, f32)], tables: &Tables) -> Vec<Choice> {
    let mut most: Vec<(f32, u32)> = lights.iter().map(|&(id, share)| (share, id)).collect();
    most.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    most.truncate(DIVIDED);
    let mut choices = Vec::with_capacity(lights.len());
    for &(id, share) in lights {
        let light = &tables.lights()[id as usize];
        let whole = Choice { light: id, share, part: *light, range: [0.0, 1.0] };
        if !most.contains(&(share, id)) {
            choices.push(whole);
            continue;
        }
        let parts = parts(light, tables.emitters_of(light));
        choices.extend(parts.map(|(part, range)| Choice { part, range, ..whole.clone() }));
    }
    choices
}

/// How many parts any light of the scene has, at most.
pub(crate) fn most_parts(lights: &[LightRecord]) -> u64 {
    let areas = lights.iter().filter(|l| l.kind == LIGHT_AREA);
    areas.map(|l| u64::from(l.emitter_count)).max().unwrap_or(1).clamp(1, PARTS as u64)
}

/// How many choices so many lights are, at most, where each has `parts` at most.
pub(crate) fn most(lights: u64, parts: u64) -> u64 {
    lights + lights.min(DIVIDED as u64) * (parts - 1)
}

/// The choice that a number which chooses an emitter of a light falls on.
pub(crate) fn of(choices: &[Choice], light: u32, u: f32) -> Option<usize> {
    let after = choices.partition_point(|c| (c.light, c.range[0]) <= (light, u));
    let at = after.checked_sub(1)?;
    (choices[at].light == light).then_some(at)
}

/// A box that grows.
#[derive(Clone, Copy)]
struct Bounds([Vec3; 2]);

impl Bounds {
    fn of(emitter: &EmitterRecord) -> Self {
        let [a, b, c] = emitter.corners.map(Vec3::from);
        Self([a.min(b).min(c), a.max(b).max(c)])
    }

    fn and(self, other: Self) -> Self {
        Self([self.0[0].min(other.0[0]), self.0[1].max(other.0[1])])
    }

    fn gap(self, other: Self) -> f32 {
        (other.0[0] - self.0[1]).max(self.0[0] - other.0[1]).max(Vec3::ZERO).length()
    }
}

/// Runs of a light's emitters that lie apart from each other, each as a light of its own.
fn parts<'a>(
    light: &'a LightRecord,
    emitters: &'a [EmitterRecord],
) -> impl Iterator<Item = (LightRecord, [f32; 2])> + 'a {
    let mut starts = vec![0];
    let mut gap = GAP_M;
    while light.kind == LIGHT_AREA && gap < light.radius {
        starts.truncate(1);
        let mut bounds = emitters.first().map(Bounds::of);
        for (at, emitter) in emitters.iter().enumerate() {
            let own = Bounds::of(emitter);
            bounds = match bounds.filter(|b| b.gap(own) <= gap) {
                Some(bounds) => Some(bounds.and(own)),
                None => {
                    starts.push(at);
                    Some(own)
                }
            };
            if starts.len() > PARTS {
                break;
            }
        }
        if starts.len() <= PARTS {
            break;
        }
        starts.truncate(1);
        gap *= 2.0;
    }
    let whole = starts.len() == 1;
    let ends = starts.clone().into_iter().skip(1).chain([emitters.len()]);
    starts.into_iter().zip(ends).filter_map(move |(first, end)| {
        if whole {
            return Some((*light, [0.0, 1.0]));
        }
        let before = |at: usize| if at == 0 { 0.0 } else { emitters[at - 1].cumulative };
        let range = [before(first), before(end)];
        let share = range[1] - range[0];
        // Rounded away: as if it was not there for choosing, and still found by its light.
        (share > 0.0).then(|| (part(light, &emitters[first..end], share), range))
    })
}

/// The light that some of its emitters would be.
fn part(light: &LightRecord, emitters: &[EmitterRecord], share: f32) -> LightRecord {
    let mut bounds = Bounds([light.position.into(); 2]);
    let (mut normals, mut area) = (Vec3::ZERO, 0.0f32);
    for (at, emitter) in emitters.iter().enumerate() {
        let own = Bounds::of(emitter);
        bounds = if at == 0 { own } else { bounds.and(own) };
        let [a, b, c] = emitter.corners.map(Vec3::from);
        let normal = (b - a).cross(c - a);
        normals += normal;
        area += normal.length();
    }
    let [min, max] = bounds.0;
    LightRecord {
        flux_w: light.flux_w.map(|w| w * share),
        area_m2: light.area_m2 * share,
        position: ((min + max) * 0.5).to_array(),
        radius: (max - min).length() * 0.5,
        axis: (normals / area.max(f32::MIN_POSITIVE)).to_array(),
        ..*light
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Panels of two triangles, 1 m by 1 m, that shine downwards, beginning at these x.
    fn panels(places: &[f32]) -> (LightRecord, Vec<EmitterRecord>) {
        let mut emitters = Vec::new();
        for &x in places {
            let corner = |dx: f32, y: f32| [x + dx, y, 2.0];
            for corners in [
                [corner(0.0, 0.0), corner(1.0, 1.0), corner(1.0, 0.0)],
                [corner(0.0, 0.0), corner(0.0, 1.0), corner(1.0, 1.0)],
            ] {
                let cumulative = (emitters.len() + 1) as f32 / (2 * places.len()) as f32;
                let triangle = emitters.len() as u32;
                emitters.push(EmitterRecord { corners, triangle, cumulative, reserved: 0 });
            }
        }
        let light = LightRecord {
            kind: LIGHT_AREA,
            flux_w: [8.0; 3],
            area_m2: places.len() as f32,
            radius: 100.0,
            ..LightRecord::DARK
        };
        (light, emitters)
    }

    #[test]
    fn panels_that_lie_apart_are_parts() {
        // The second and the third touch.
        let (light, emitters) = panels(&[0.0, 3.0, 4.0, 9.0]);
        let found: Vec<_> = parts(&light, &emitters).collect();
        let ranges: Vec<_> = found.iter().map(|p| p.1).collect();
        assert_eq!(ranges, [[0.0, 0.25], [0.25, 0.75], [0.75, 1.0]]);
        let middle = &found[1].0;
        assert_eq!((middle.flux_w[0], middle.area_m2), (4.0, 2.0));
        assert_eq!((middle.position, middle.axis), ([4.0, 0.5, 2.0], [0.0, 0.0, -1.0]));
        assert!((middle.radius - 0.5 * 5f32.sqrt()).abs() < 1e-6);
        // One panel, and what is no area, are whole.
        let (one, emitters) = panels(&[5.0]);
        assert_eq!(parts(&one, &emitters).collect::<Vec<_>>(), [(one, [0.0, 1.0])]);
        let point = LightRecord { kind: enf_layout::light::LIGHT_POINT, ..light };
        assert_eq!(parts(&point, &[]).collect::<Vec<_>>(), [(point, [0.0, 1.0])]);
    }

    #[test]
    fn many_parts_run_together() {
        // Pairs 0.3 m apart, 5 m from each other: 100 panels would be too many parts.
        let places: Vec<f32> =
            (0..50).map(|i| (i % 25) as f32 * 5.0 + if i < 25 { 0.0 } else { 1.3 }).collect();
        let mut sorted = places;
        sorted.sort_by(f32::total_cmp);
        let (light, emitters) = panels(&sorted);
        let found: Vec<_> = parts(&light, &emitters).collect();
        assert_eq!(found.len(), 25);
        let flux: f32 = found.iter().map(|p| p.0.flux_w[0]).sum();
        assert!((flux - 8.0).abs() < 1e-4);
    }

    /// Whatever number chooses an emitter falls on the part that has it; a part's own numbers fall on it.
    #[test]
    fn numbers_and_parts_agree() {
        let (light, emitters) = panels(&[0.0, 3.0, 6.0]);
        let mut choices = Vec::new();
        for id in [2, 5] {
            let parts = parts(&light, &emitters);
            choices.extend(parts.map(|(part, range)| Choice {
                light: id,
                share: 1.0,
                part,
                range,
            }));
        }
        for (at, choice) in choices.iter().enumerate() {
            for u in [0.0, 0.3, 1.0f32.next_down()] {
                let place = choice.of_part(u);
                assert_eq!(of(&choices, choice.light, place), Some(at));
                let emitter = emitters.partition_point(|e| e.cumulative <= place);
                assert_eq!(emitter / 2, at % 3);
            }
        }
        assert_eq!(of(&choices, 0, 0.5), None);
        assert_eq!(of(&choices, 3, 0.5), None);
        assert_eq!(of(&choices, 7, 0.5), None);
    }
}
