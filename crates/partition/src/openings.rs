//! Daylight: one light of the sky, and one of the sun, for every opening between the outside and a room.

use enf_daylight::{Grid, Sky};
use enf_layout::light::{EmitterRecord, LIGHT_SKY, LIGHT_SUN, LightRecord};
use enf_layout::room::TileRecord;
use enf_layout::sky::SkyRecord;
use enf_layout::{NONE, room::PortalPieceRecord};
use enf_rooms::Tables;
use enf_transport::sky::{self, Shell};
use glam::{DVec3, Vec3};

use crate::build::World;

/// Smaller openings are cracks, m2: their light comes with that of no opening.
const LEAST_OPENING: f64 = 0.01;
/// Triangles with less area have no normal to speak of, m2.
const LEAST_TRIANGLE: f64 = 1e-8;
/// Pieces whose normals agree to this lie in one light.
const SAME_PLANE: f64 = 0.9999;

/// What was found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Found {
    /// Openings, each plane of them counted.
    pub(crate) openings: usize,
    /// Their area, m2.
    pub(crate) area: f64,
}

/// Pieces of one portal that lie in one plane, or in parallel ones.
struct Opening {
    /// Sum of normals times area; points into the room.
    normal: DVec3,
    triangles: Vec<([[f32; 3]; 3], f64)>,
    area: f64,
}

/// Adds the lights. Openings come in the order of the portals; the sky and the sun that come through none come last.
pub(crate) fn let_in(
    world: &mut World,
    tables: &Tables,
    record: &SkyRecord,
    shell: &Shell,
) -> Found {
    let sky = Sky::new(record);
    let grid = Grid::new(&sky);
    let mut found = Found::default();
    let mut of_room = (NONE, 0);
    for portal in tables.portals.iter().filter(|p| Some(p.other) == tables.outside) {
        let pieces =
            portal.first_piece as usize..(portal.first_piece + portal.piece_count) as usize;
        for opening in openings(&tables.pieces[pieces]) {
            if opening.area < LEAST_OPENING {
                continue;
            }
            of_room = if of_room.0 == portal.room {
                (portal.room, of_room.1 + 1)
            } else {
                (portal.room, 1)
            };
            found.openings += 1;
            found.area += opening.area;
            add(
                world,
                &opening,
                &sky,
                &grid,
                &format!("opening {} of room {}", of_room.1, portal.room),
            );
        }
    }
    let (centre, radius) = ((shell.min + shell.max) / 2.0, (shell.max - shell.min).length() / 2.0);
    let mut everywhere = |kind, name: &str| {
        let flux = sky::shell_flux(kind, &sky, &grid, shell);
        world.lights.push(LightRecord {
            kind,
            flux_w: flux.as_vec3().to_array(),
            position: centre.as_vec3().to_array(),
            radius: radius as f32,
            ..LightRecord::DARK
        });
        world.light_names.push(name.into());
    };
    everywhere(LIGHT_SKY, "sky");
    if sky.has_sun() {
        everywhere(LIGHT_SUN, "sun");
    }
    found
}

/// The pieces of a portal, plane by plane.
fn openings(pieces: &[PortalPieceRecord]) -> Vec<Opening> {
    let mut out: Vec<Opening> = Vec::new();
    for piece in pieces {
        let corners = &piece.corners[..(piece.count as usize).clamp(3, piece.corners.len())];
        for i in 1..corners.len() - 1 {
            let triangle = [corners[0], corners[i], corners[i + 1]];
            let [a, b, c] = triangle.map(|p| Vec3::from(p).as_dvec3());
            let normal = (b - a).cross(c - a) / 2.0;
            let area = normal.length();
            if area < LEAST_TRIANGLE {
                continue;
            }
            let same =
                |o: &&mut Opening| o.normal.dot(normal) > SAME_PLANE * o.normal.length() * area;
            match out.iter_mut().find(same) {
                Some(opening) => {
                    opening.normal += normal;
                    opening.area += area;
                    opening.triangles.push((triangle, area));
                }
                None => out.push(Opening { normal, area, triangles: vec![(triangle, area)] }),
            }
        }
    }
    out
}

fn add(world: &mut World, opening: &Opening, sky: &Sky, grid: &Grid, name: &str) {
    let axis = opening.normal.normalize_or_zero();
    let first = world.emitters.len() as u32;
    let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let mut sum = 0.0;
    for (corners, area) in &opening.triangles {
        sum += area;
        for corner in corners.map(Vec3::from) {
            (min, max) = (min.min(corner), max.max(corner));
        }
        world.emitters.push(EmitterRecord {
            corners: *corners,
            triangle: NONE,
            cumulative: (sum / opening.area) as f32,
            reserved: 0,
        });
    }
    if let Some(last) = world.emitters.last_mut() {
        last.cumulative = 1.0;
    }
    let mut light = |kind, flux: DVec3, what: &str| {
        // An opening without sky of its own may still see what the outside reflects.
        if kind == LIGHT_SUN && flux.max_element() <= 0.0 {
            return;
        }
        world.lights.push(LightRecord {
            kind,
            first_emitter: first,
            emitter_count: opening.triangles.len() as u32,
            flux_w: flux.as_vec3().to_array(),
            area_m2: opening.area as f32,
            position: ((min + max) / 2.0).to_array(),
            radius: (max - min).length() / 2.0,
            axis: axis.as_vec3().to_array(),
            ..LightRecord::DARK
        });
        world.light_names.push(format!("{what} through {name}"));
    };
    light(LIGHT_SKY, sky::sky_flux(grid, axis, opening.area), "sky");
    light(LIGHT_SUN, sky::sun_flux(sky, axis, opening.area), "sun");
}

/// Tiles in which photons of a daylight light may start, and probes: those that reach out of the scene's bounds, and those
/// that touch the light's own opening, which its emitters make up.
pub(crate) fn tiles(
    emitters: &[EmitterRecord],
    tiles: &[TileRecord],
    bounds: ([f32; 3], [f32; 3]),
    mut found: impl FnMut(u32),
) {
    let (low, high) = (Vec3::from(bounds.0).as_dvec3(), Vec3::from(bounds.1).as_dvec3());
    // Photons start three quarters of the margin outside, tiles at the bound end with it.
    let margin = Shell::new(low.to_array(), high.to_array());
    let (low, high) = ((low + 2.0 * margin.min) / 3.0, (high + 2.0 * margin.max) / 3.0);
    let (mut near, mut far) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for corner in emitters.iter().flat_map(|e| e.corners).map(Vec3::from) {
        (near, far) = (near.min(corner - 0.01), far.max(corner + 0.01));
    }
    for (id, tile) in tiles.iter().enumerate() {
        let (min, max) = (Vec3::from(tile.min), Vec3::from(tile.max));
        let out = min.as_dvec3().cmplt(low).any() || max.as_dvec3().cmpgt(high).any();
        if out || (near.cmple(max).all() && far.cmpge(min).all()) {
            found(id as u32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use enf_layout::room::PIECE_CORNERS;

    fn piece(corners: &[[f32; 3]]) -> PortalPieceRecord {
        let mut all = [[0.0; 3]; PIECE_CORNERS];
        all[..corners.len()].copy_from_slice(corners);
        PortalPieceRecord {
            corners: all,
            count: corners.len() as u32,
            area_m2: 0.0,
            reserved: [0; 2],
        }
    }

    /// Two pieces in one plane are one light, a third one across the corner is another.
    #[test]
    fn planes_apart() {
        let front = |x: f32| piece(&[[x, 0., 0.], [x, 0., 2.], [x + 1., 0., 2.], [x + 1., 0., 0.]]);
        let side = piece(&[[2., 0., 0.], [2., 1., 0.], [2., 1., 2.], [2., 0., 2.]]);
        let found = openings(&[front(0.0), side, front(1.0)]);
        assert_eq!(found.len(), 2);
        assert!((found[0].area - 4.0).abs() < 1e-6 && (found[1].area - 2.0).abs() < 1e-6);
        assert_eq!(found[0].normal.normalize(), DVec3::Y);
        assert_eq!(found[0].triangles.len(), 4);
    }

    #[test]
    fn tiles_at_the_bound() {
        let tile = |min: [f32; 3], max: [f32; 3]| TileRecord {
            room: 0,
            first_light: 0,
            light_count: 0,
            reserved: 0,
            triangles: 0,
            mesh_bytes: 0,
            min,
            max,
        };
        let all = [
            tile([0.0; 3], [4.0; 3]),
            tile([-1.0; 3], [4.0; 3]),
            tile([0.0; 3], [2.0; 3]),
            tile([0.0, 0.0, -0.01], [2.0; 3]),
        ];
        let emitter = EmitterRecord {
            corners: [[3.0; 3], [3.0, 3.5, 3.0], [3.0, 3.0, 3.5]],
            triangle: NONE,
            cumulative: 1.0,
            reserved: 0,
        };
        let mut found = Vec::new();
        tiles(&[emitter], &all, ([0.0; 3], [4.0; 3]), |t| found.push(t));
        assert_eq!(found, [0, 1]);
    }
}
