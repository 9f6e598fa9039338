//! `--ceiling-lights`: a luminaire in every room, for the many models that have none.

use enf_layout::bsp::LEAF_OUTSIDE;
use enf_layout::light::{EmitterRecord, LIGHT_AREA, LightRecord};
use enf_layout::material::MaterialRecord;
use enf_rooms::{Partition, Scratch};
use glam::Vec3;

use crate::bins::Record;
use crate::build::World;

/// Half the side of the square panel, m.
const HALF_SIDE: f32 = 0.3;
/// How far below the lowest thing above it the panel hangs, m.
const GAP: f32 = 0.03;
/// Share of a luminaire's flux that arrives on the working plane: the lumen method's utilance for an ordinary
/// light-coloured room.
const UTILANCE: f64 = 0.6;
/// Luminous efficacy of radiation, lm/W.
const LUMENS_PER_WATT: f64 = 179.0;

/// Reads `500lx`, `500 lx` or `500`.
///
/// # Errors
/// Anything but a positive number of lux.
pub fn parse_lux(text: &str) -> Result<f64, String> {
    let number = text.trim().trim_end_matches("lux").trim_end_matches("lx").trim();
    match number.parse::<f64>() {
        Ok(lux) if lux.is_finite() && lux > 0.0 => Ok(lux),
        _ => Err("an illuminance such as 500lx".into()),
    }
}

/// Adds a panel to each room that has a floor and a ceiling; returns how many. `walls` are the large
/// triangles of the scene; the panels' own are numbered from `next` on.
pub(crate) fn hang(
    world: &mut World,
    partition: &Partition,
    walls: &[[[f32; 3]; 3]],
    next: u32,
    lux: f64,
) -> usize {
    // Which walls each room sees; pieces are rooms as long as nothing is cut.
    let mut near: Vec<(u32, u32)> = Vec::new();
    let mut scratch = Scratch::default();
    for (i, wall) in walls.iter().enumerate() {
        let start = partition.start([f32::MIN; 3], [f32::MAX; 3]);
        partition.route(start, wall, &mut scratch, |room| near.push((room, i as u32)));
    }
    near.sort_unstable();
    let mut hung = 0;
    for (id, room) in partition.rooms().iter().enumerate() {
        if room.flags & LEAF_OUTSIDE != 0 || room.floor_area_m2 < 0.5 {
            continue;
        }
        let first = near.partition_point(|n| (n.0 as usize) < id);
        let end = near.partition_point(|n| n.0 as usize <= id);
        let own = || near[first..end].iter().map(|n| &walls[n.1 as usize]);
        let at = Vec3::from(room.inside);
        let mut half =
            HALF_SIDE.min((room.max[0] - room.min[0]).min(room.max[1] - room.min[1]) / 4.0);
        // The panel must be free at its corners and centre; a smaller one fits into more places.
        let mut ceiling = None;
        while half > 0.04 {
            // The ceiling may lie above the room's own cells, over a gap that no wall closes.
            let height = |&p: &Vec3| above(own(), p).or_else(|| above(walls.iter(), p));
            let heights: Option<Vec<f32>> = probes(at, half).iter().map(height).collect();
            if let Some(heights) = heights {
                let (low, high) =
                    heights.iter().fold((f32::INFINITY, 0.0f32), |(l, h), &z| (l.min(z), h.max(z)));
                if high - low < 0.3 || half < 0.1 {
                    ceiling = Some(low);
                    break;
                }
            }
            half *= 0.6;
        }
        let Some(z) = ceiling else { continue };
        let z = (z - GAP).max(at.z + 0.05);
        let lumens = lux * f64::from(room.floor_area_m2) / UTILANCE;
        let area = 4.0 * f64::from(half) * f64::from(half);
        let watts = (lumens / LUMENS_PER_WATT) as f32;
        let radiance = (lumens / LUMENS_PER_WATT / (area * core::f64::consts::PI)) as f32;
        let corner = |x: f32, y: f32| [at.x + x * half, at.y + y * half, z];
        // Counter-clockwise seen from below.
        let quad = [corner(-1., -1.), corner(-1., 1.), corner(1., 1.), corner(1., -1.)];
        let material = world.materials.len() as u32;
        let first = next + world.added.len() as u32;
        let triangles = [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]];
        for (i, corners) in triangles.into_iter().enumerate() {
            world.added.push(Record { corners, index: first + i as u32, material });
        }
        world.materials.push(MaterialRecord {
            diffuse: [0.5; 3],
            emission: [radiance; 3],
            ..MaterialRecord::BLACK
        });
        world.material_names.push(format!("ceiling-light-{id}"));
        world.lights.push(LightRecord {
            kind: LIGHT_AREA,
            material,
            first_emitter: world.emitters.len() as u32,
            emitter_count: 2,
            flux_w: [watts; 3],
            area_m2: area as f32,
            position: [at.x, at.y, z],
            radius: half * core::f32::consts::SQRT_2,
            axis: [0.0, 0.0, -1.0],
            ..LightRecord::DARK
        });
        world.light_names.push(format!("ceiling light of room {id}"));
        for (i, corners) in triangles.into_iter().enumerate() {
            world.emitters.push(EmitterRecord {
                corners,
                triangle: first + i as u32,
                cumulative: if i == 0 { 0.5 } else { 1.0 },
                reserved: 0,
            });
        }
        hung += 1;
    }
    hung
}

fn probes(at: Vec3, half: f32) -> [Vec3; 5] {
    [(0., 0.), (1., 1.), (1., -1.), (-1., 1.), (-1., -1.)]
        .map(|(x, y)| at + Vec3::new(x * half, y * half, 0.0))
}

/// Height of the lowest triangle above a point.
fn above<'a>(walls: impl Iterator<Item = &'a [[f32; 3]; 3]>, p: Vec3) -> Option<f32> {
    let mut lowest: Option<f32> = None;
    for triangle in walls {
        let [a, b, c] = triangle.map(|v| [f64::from(v[0]), f64::from(v[1]), f64::from(v[2])]);
        let (x, y) = (f64::from(p.x), f64::from(p.y));
        let side =
            |u: [f64; 3], v: [f64; 3]| (v[0] - u[0]) * (y - u[1]) - (v[1] - u[1]) * (x - u[0]);
        let (u, v, w) = (side(b, c), side(c, a), side(a, b));
        let sum = u + v + w;
        let inside = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
        if sum == 0.0 || !inside {
            continue;
        }
        let z = ((u * a[2] + v * b[2] + w * c[2]) / sum) as f32;
        if z > p.z && lowest.is_none_or(|l| z < l) {
            lowest = Some(z);
        }
    }
    lowest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lux_are_read() {
        assert_eq!(parse_lux("500lx"), Ok(500.0));
        assert_eq!(parse_lux("300"), Ok(300.0));
        assert_eq!(parse_lux("12.5 lux"), Ok(12.5));
        assert!(parse_lux("-3lx").is_err() && parse_lux("bright").is_err());
    }

    #[test]
    fn the_lowest_triangle_above_counts() {
        let sheet = |z: f32| [[-1.0, -1.0, z], [1.0, -1.0, z], [0.0, 2.0, z]];
        let scene = [sheet(3.0), sheet(2.5), sheet(0.0)];
        assert_eq!(above(scene.iter(), Vec3::new(0.0, 0.0, 1.0)), Some(2.5));
        assert_eq!(above(scene.iter(), Vec3::new(5.0, 0.0, 1.0)), None);
    }
}
