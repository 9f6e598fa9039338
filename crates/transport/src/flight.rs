//! A ray's flight through one resident tile: leaf by leaf, until it hits something or leaves the tile.

use enf_geometry::{Hit, Query, Ray, Structure};
use enf_layout::material::MaterialRecord;
use enf_layout::transit::TransitRecord;
use enf_rooms::Bsp;
use glam::{DVec3, Vec3};

use crate::emission::OFFSET_PER_DELTA;
use crate::scatter::{Met, Swings};
use crate::texture::Texturing;
use crate::vector;

/// A tile in memory, and the tables that say where it lies.
#[derive(Clone, Copy)]
pub struct Resident<'a> {
    /// This tile.
    pub tile: u32,
    /// Where everything lies.
    pub bsp: &'a Bsp<'a>,
    /// The tile's triangles, and what keeps most of them apart from a ray.
    pub structure: &'a Structure<'a>,
    /// All materials of the scene.
    pub materials: &'a [MaterialRecord],
    /// Its textures, and where the tile's triangles lie on them.
    pub texturing: Texturing<'a>,
    /// The scene's tolerance, m.
    pub delta: f32,
}

/// How a flight through the tile ended.
#[derive(Clone, Copy, Debug)]
pub enum Flight {
    /// A surface was hit while the ray was in `leaf`.
    Hit {
        /// Where.
        hit: Hit,
        /// The leaf that the ray had reached.
        leaf: u32,
    },
    /// The ray enters `leaf` of another tile at distance `t`.
    Leaves {
        /// Leaf of the other tile.
        leaf: u32,
        /// Distance at which it enters, m.
        t: f32,
    },
    /// The end of the flight was reached before anything was hit.
    Reached,
    /// The ray left the scene's bound out of a leaf.
    Escapes {
        /// Its last leaf.
        leaf: u32,
    },
}

/// A point on a surface as later rays need it.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// The point, m: on the triangle to rounding, delta/4 off its edges.
    pub position: Vec3,
    /// Unit geometric normal on the side that was hit.
    pub normal: Vec3,
    /// The counter-clockwise (front) side was hit.
    pub front: bool,
    /// `position` lifted off the surface by delta/4: rays start here, and the leaf that holds it says which
    /// room the point belongs to.
    pub origin: Vec3,
    /// Global index of the triangle.
    pub triangle: u32,
    /// Its material.
    pub material: u32,
}

/// Flies `record` from (`record.leaf`, `record.t`) on, at most to distance `end`. `crossed(from, to)` is told of every change of leaf, the
/// last one (out of the tile) included.
pub fn fly(
    tile: &Resident<'_>,
    record: &TransitRecord,
    end: f32,
    crossed: impl FnMut(u32, u32),
) -> Flight {
    follow(tile, record, end, tile.structure.nearest(&query(record, end)), crossed)
}

/// [`fly`], when what [`query`] asks has been answered.
///
/// The nearest hit in the tile's triangles is asked for once; the walk then decides whether the ray gets that
/// far inside this tile. Accepting hits up to `t_accept` (the leaf grown by delta) keeps a wall that lies in a
/// splitting plane on this side of it; that never changes *which* hit is nearest (see `enf_rooms::walk`).
pub fn follow(
    tile: &Resident<'_>,
    record: &TransitRecord,
    end: f32,
    hit: Option<Hit>,
    mut crossed: impl FnMut(u32, u32),
) -> Flight {
    let origin: DVec3 = Vec3::from(record.origin).as_dvec3();
    let direction = Vec3::from(record.direction).as_dvec3();
    let reach = hit.map_or(f32::INFINITY, |h| h.t);
    let (mut leaf, mut t) = (record.leaf, record.t);
    loop {
        if let Some(hit) = hit
            && tile.bsp.accepts(leaf, origin, direction, reach)
        {
            return Flight::Hit { hit, leaf };
        }
        let exit = tile.bsp.exit(leaf, origin, direction, t);
        if let Some(hit) = hit
            && reach < exit.t_accept
        {
            return Flight::Hit { hit, leaf };
        }
        if exit.t_exit == f32::INFINITY {
            return Flight::Escapes { leaf };
        }
        if exit.t_exit >= end {
            return Flight::Reached;
        }
        t = exit.t_exit;
        let Some(next) = tile.bsp.cross(exit.face, origin, direction, t) else {
            return Flight::Escapes { leaf };
        };
        crossed(leaf, next);
        leaf = next;
        if tile.bsp.leaves[leaf as usize].tile != tile.tile {
            return Flight::Leaves { leaf, t };
        }
    }
}

/// What a flight asks of a tile's structure.
pub fn query(record: &TransitRecord, end: f32) -> Query {
    Query {
        ray: Ray { origin: Vec3::from(record.origin), direction: Vec3::from(record.direction) },
        t_min: record.t,
        t_max: end,
        exclude: record.last_triangle,
    }
}

impl Surface {
    /// Where a ray along `direction` meets the triangle of `corners`, m, at the barycentric coordinates `[u, v]`; `lift` is how far
    /// rays start above it, m. Triangle and material are left 0.
    pub fn at(corners: [Vec3; 3], [u, v]: [f32; 2], direction: Vec3, lift: f32) -> Self {
        let [a, b, c] = corners.map(|p| p.as_dvec3());
        let (u, v) = (f64::from(u), f64::from(v));
        let position = vector::off_edges([a, b, c], u, v, f64::from(lift)).as_vec3();
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let front = normal.dot(direction.as_dvec3()) < 0.0;
        let normal = (if front { normal } else { -normal }).as_vec3();
        let origin = position + normal * lift;
        Self { position, normal, front, origin, triangle: 0, material: 0 }
    }

    /// Where a ray starts that goes on beyond the surface, m: as far below it as `origin` is above.
    pub fn beyond(&self) -> Vec3 {
        self.position - (self.origin - self.position)
    }
}

/// The surface at a hit. It depends on the ray and the triangle alone.
pub fn surface(tile: &Resident<'_>, hit: &Hit, direction: Vec3) -> Surface {
    let corners = tile.structure.corners(hit.slot);
    Surface {
        triangle: hit.global,
        material: tile.structure.material(hit.slot),
        ..Surface::at(corners, [hit.u, hit.v], direction, lift(tile))
    }
}

/// How far a ray starts above the surface from which it goes, m.
pub fn lift(tile: &Resident<'_>) -> f32 {
    tile.delta * OFFSET_PER_DELTA
}

/// How a ray meets the surface at its hit: what [`crate::scatter::lobes`] asks.
pub fn met(tile: &Resident<'_>, record: &TransitRecord, hit: &Hit, surface: &Surface) -> Met {
    let texture = tile.materials[surface.material as usize].texture;
    Met {
        cos: -surface.normal.dot(Vec3::from(record.direction)),
        front: surface.front,
        length: hit.t,
        texel: tile.texturing.colour(texture, hit.global, hit.u, hit.v),
        swings: Swings::of(record.flags),
    }
}

/// The next representable distance: where a ray goes on behind a pane at `t`.
pub fn just_after(t: f32) -> f32 {
    t.next_up()
}
