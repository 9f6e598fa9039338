//! Daylight: photons of sky and sun, aimed at the openings through which they enter, and what a shading point sees.
//!
//! Light from far away travels on straight lines that cross the scene's bound. Each line has one owner among the
//! lights, so that nothing is counted twice however many windows it passes:
//!
//! - for **photons**, the first opening that the line passes inwards, seen from the sky; the light without an opening has
//!   the lines that pass none. A photon starts where its line meets the bound, so that overhangs and the house across
//!   the street stop and scatter it like any other. One whose line has another owner is emitted without flux and
//!   escapes at once: counts stay exact, and the owner's own photons carry that light.
//! - for a **shading point**, the last opening, which is the first that a ray from the point leaves through. It is nearly
//!   always a window of the point's own room, which is in its set of lights; the first one, seen from the sky, may be anywhere.
//!
//! Either rule gives each line once; the two need not agree, for photons and shadow rays are never added up: direct light
//! comes from one of them alone.
//!
//! What the outside reflects is aimed as well: a photon of the light without an opening carries a share of the whole
//! scene's sky, far too much to enter a room in one piece. Where such a photon is reflected outside, smaller ones are sent
//! towards openings ([`Daylight::aim`]), and it ends should it set out for one itself ([`Daylight::is_aimed`]).
//!
//! Directions are drawn from a table of radiance times cosine, cells of equal solid angle, and weighted with the exact
//! radiance over the exact density. So the table may be coarse, and no weight is far from 1.

use core::f64::consts::{PI, TAU};

use enf_daylight::{Grid, Sky};
use enf_layout::NONE;
use enf_layout::light::{EmitterRecord, LIGHT_SKY, LIGHT_SUN, LightRecord};
use enf_layout::sky::SkyRecord;
use glam::{DVec3, Vec3};

use crate::emission::{self, Start};
use crate::flight::Surface;
use crate::rng::{self, Purpose};
use crate::{spherical, vector};

/// Rings of a [`Table`], from the nadir to the zenith.
const ROWS: usize = 48;
/// Cells of a ring.
const COLUMNS: usize = 96;
/// Cells of a [`Table`].
const CELLS: usize = ROWS * COLUMNS;
/// Densities are whole multiples of this: the numbers that choose a cell have 24 bits.
const STEPS: u32 = 1 << 24;
/// Cells are smaller than twice this, as an angle (the sine of it).
const CELL_SINE: f64 = 0.3;
/// Axes that agree to this share a table.
const SAME_AXIS: f64 = 0.9999;
/// Openings of more triangles are drawn by area.
const MOST_SPHERICAL: usize = 16;
/// Openings that are seen under a smaller solid angle are drawn by area, sr.
const LEAST_SPHERICAL: f64 = 1e-3;
/// Openings that are tried for a photon that is aimed.
const CANDIDATES: usize = 8;
/// Most photons that one is split into.
pub const MOST_AIMED: usize = 16;
/// Light is aimed at openings until chance would send so many times more of it there.
const BY_CHANCE: f64 = 8.0;
/// Surfaces face along an axis within some 2.5 degrees.
const ALONG_AXIS: f32 = 0.999;
/// Start points lie this share of the root box's margin outside the scene's bounds.
const OUT: f64 = 0.75;

/// Where lines of daylight start: a box around all geometry, within the BSP's root box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shell {
    /// Lower corner, m.
    pub min: DVec3,
    /// Upper corner, m.
    pub max: DVec3,
}

impl Shell {
    /// Of a scene with these bounds, m ([`enf_layout::room::SceneRecord`]).
    pub fn new(bounds_min: [f64; 3], bounds_max: [f64; 3]) -> Self {
        let (min, max) = (DVec3::from_array(bounds_min), DVec3::from_array(bounds_max));
        let margin = OUT * (0.02 * (max - min).length()).max(1.0);
        Self { min: min - margin, max: max + margin }
    }

    /// Outward normal and area of a side, 0 to 5.
    fn side(&self, side: usize) -> (DVec3, f64) {
        let (axis, up) = (side / 2, side % 2 == 1);
        let mut normal = DVec3::ZERO;
        normal[axis] = if up { 1.0 } else { -1.0 };
        let size = self.max - self.min;
        (normal, size[(axis + 1) % 3] * size[(axis + 2) % 3])
    }

    /// A point of a side.
    fn point(&self, side: usize, u: f64, v: f64) -> DVec3 {
        let axis = side / 2;
        let (next, other) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut point = if side % 2 == 1 { self.max } else { self.min };
        point[next] = self.min[next] + u * (self.max[next] - self.min[next]);
        point[other] = self.min[other] + v * (self.max[other] - self.min[other]);
        point
    }

    /// How far a ray from a point inside gets before it leaves, m.
    fn exit(&self, from: DVec3, towards: DVec3) -> f64 {
        let mut reach = f64::INFINITY;
        for axis in 0..3 {
            let d = towards[axis];
            if d != 0.0 {
                let end = if d > 0.0 { self.max[axis] } else { self.min[axis] };
                reach = reach.min(((end - from[axis]) / d).max(0.0));
            }
        }
        if reach.is_finite() { reach } else { 0.0 }
    }
}

/// Flux, W, that sky and ground (not the sun) send through an opening of `area` m2 whose normal `inwards` points into the room.
pub fn sky_flux(grid: &Grid, inwards: DVec3, area: f64) -> DVec3 {
    grid.irradiance(-inwards) * area
}

/// Flux, W, that the sun sends through such an opening; zero when it stands behind it, or so low above its plane that only part
/// of its disc does not.
pub fn sun_flux(sky: &Sky, inwards: DVec3, area: f64) -> DVec3 {
    let cos = -inwards.dot(sky.sun());
    let half = libm::sqrt((1.0 - sky.sun_cos() * sky.sun_cos()).max(0.0));
    if cos <= -half { DVec3::ZERO } else { sky.sun_irradiance() * (area * cos.max(half)) }
}

/// Flux, W, that sky and ground, or the sun, send into the shell from all sides.
pub fn shell_flux(kind: u32, sky: &Sky, grid: &Grid, shell: &Shell) -> DVec3 {
    let mut sum = DVec3::ZERO;
    for side in 0..6 {
        let (normal, area) = shell.side(side);
        sum += match kind {
            LIGHT_SUN => sky.sun_irradiance() * (normal.dot(sky.sun()).max(0.0) * area),
            _ => sky_flux(grid, -normal, area),
        };
    }
    sum
}

/// Directions with a density near radiance times cosine: cells of equal solid angle with a probability each.
#[derive(Clone, Debug)]
struct Table {
    /// Sums of the cells' probabilities up to and including each, in units of 2^-24.
    cumulative: Vec<u32>,
}

impl Table {
    const BYTES: u64 = CELLS as u64 * 4;

    /// For a surface that faces `normal`; without one, of radiance alone.
    fn new(grid: &Grid, ground: f64, normal: Option<DVec3>) -> Self {
        let mut values = vec![0.0f64; CELLS];
        let mut lit = vec![false; CELLS];
        let lift = |d: DVec3| normal.map_or(1.0, |n| n.dot(d));
        let half = ROWS / 2;
        let (down, across) = (Grid::ROWS / half, Grid::COLUMNS / COLUMNS);
        for row in 0..ROWS {
            for column in 0..COLUMNS {
                let mut sum = 0.0;
                for i in 0..down * across {
                    let c = column * across + i % across;
                    if row >= half {
                        let r = (row - half) * down + i / across;
                        sum += grid.value(r, c) * lift(grid.direction(r, c)).max(0.0);
                    } else {
                        let r = (half - 1 - row) * down + i / across;
                        let up = grid.direction(r, c);
                        sum += ground * lift(DVec3::new(up.x, up.y, -up.z)).max(0.0);
                    }
                }
                let cell = row * COLUMNS + column;
                values[cell] = sum / (down * across) as f64;
                let bright = row >= half || ground > 0.0;
                lit[cell] = bright && lift(middle(row, column)) > -CELL_SINE;
            }
        }
        let mean = values.iter().sum::<f64>() / CELLS as f64;
        // Whatever can be positive anywhere in a cell has a probability.
        let floor = if mean > 0.0 { mean * 1e-3 } else { 1.0 };
        for (value, &lit) in values.iter_mut().zip(&lit) {
            *value = if lit { value.max(floor) } else { 0.0 };
        }
        let total = values.iter().sum::<f64>();
        let possible = lit.iter().filter(|&&l| l).count() as u32;
        // Each possible cell gets one unit, and its share of the others; rounding goes by the running sum.
        let shared = f64::from(STEPS - possible);
        let (mut sum, mut units) = (0.0, 0);
        let mut cumulative: Vec<u32> = Vec::with_capacity(CELLS);
        for (&value, &lit) in values.iter().zip(&lit) {
            sum += value;
            units += u32::from(lit);
            let share = if total > 0.0 { (sum / total * shared) as u32 } else { 0 };
            cumulative.push(units + share.min(STEPS - possible));
        }
        // Rounding leaves the last units to the last possible cell.
        if let Some(last) = lit.iter().rposition(|&l| l) {
            cumulative[last..].fill(STEPS);
        }
        Self { cumulative }
    }

    /// A unit vector and its density, 1/sr, from three uniform numbers.
    fn sample(&self, u: [f32; 3]) -> (DVec3, f64) {
        let place = (f64::from(u[0]) * f64::from(STEPS)) as u32;
        let cell = self.cumulative.partition_point(|&c| c <= place).min(CELLS - 1);
        let before = if cell == 0 { 0 } else { self.cumulative[cell - 1] };
        let units = self.cumulative[cell] - before;
        let (row, column) = (cell / COLUMNS, cell % COLUMNS);
        let z = 2.0 * (row as f64 + f64::from(u[1])) / ROWS as f64 - 1.0;
        let level = libm::sqrt((1.0 - z * z).max(0.0));
        let (sin, cos) = libm::sincos(TAU * (column as f64 + f64::from(u[2])) / COLUMNS as f64);
        let density = f64::from(units) / f64::from(STEPS) * CELLS as f64 / (4.0 * PI);
        (DVec3::new(cos * level, sin * level, z), density)
    }
}

/// Unit vector to the middle of a table's cell.
fn middle(row: usize, column: usize) -> DVec3 {
    let z = 2.0 * (row as f64 + 0.5) / ROWS as f64 - 1.0;
    let level = libm::sqrt(1.0 - z * z);
    let (sin, cos) = libm::sincos(TAU * (column as f64 + 0.5) / COLUMNS as f64);
    DVec3::new(cos * level, sin * level, z)
}

/// All openings' triangles, each facing the room that light enters, under a tree of boxes.
#[derive(Clone, Debug, Default)]
struct Openings {
    triangles: Vec<[DVec3; 3]>,
    nodes: Vec<OpeningNode>,
}

/// A box of the triangles `begin..end`; its halves are the next node and the node `right`, or it has none (`right` 0).
#[derive(Clone, Copy, Debug)]
struct OpeningNode {
    min: DVec3,
    max: DVec3,
    /// Of the triangles in it, m2.
    area: f64,
    begin: u32,
    end: u32,
    right: u32,
}

impl Openings {
    const LEAF: usize = 4;

    fn new(mut triangles: Vec<[DVec3; 3]>) -> Self {
        let mut nodes = Vec::new();
        if !triangles.is_empty() {
            let count = triangles.len();
            build(&mut triangles, 0, count, &mut nodes);
        }
        Self { triangles, nodes }
    }

    /// The first triangle (and its distance) that a ray passes before `reach`, in the direction that it faces (`inwards`) or
    /// against it; with `any`, some triangle.
    fn passed(
        &self,
        origin: DVec3,
        direction: DVec3,
        mut reach: f64,
        inwards: bool,
        any: bool,
    ) -> Option<(usize, f64)> {
        let mut found = None;
        if self.nodes.is_empty() {
            return found;
        }
        let inverse = direction.recip();
        let mut stack = [0u32; 64];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let at = stack[depth];
            let node = &self.nodes[at as usize];
            if !node.hit(origin, inverse, reach) {
                continue;
            }
            if node.right != 0 {
                // Halves of halves: 32 levels hold any number of triangles.
                stack[depth] = node.right;
                stack[depth + 1] = at + 1;
                depth += 2;
                continue;
            }
            for i in node.begin as usize..node.end as usize {
                if let Some(t) = passes(&self.triangles[i], origin, direction, reach, inwards) {
                    (found, reach) = (Some((i, t)), t);
                    if any {
                        return found;
                    }
                }
            }
        }
        found
    }

    /// A triangle for a point, and its probability, from a uniform number: near and large ones are likelier (a tree of
    /// lights after Conty and Kulla 2018, "Importance sampling of many lights with adaptive tree splitting", by area and
    /// distance alone).
    fn pick(&self, point: DVec3, mut u: f64) -> Option<(usize, f64)> {
        let mut at = 0;
        let mut probability = 1.0;
        let mut node = self.nodes.first()?;
        while node.right != 0 {
            let left = self.left_share(at, point);
            if u < left {
                (at, probability, u) = (at + 1, probability * left, u / left);
            } else {
                u = (u - left) / (1.0 - left);
                (at, probability) = (node.right as usize, probability * (1.0 - left));
            }
            node = &self.nodes[at];
        }
        let mut place = u * node.area;
        let mut own = node.begin as usize..node.end as usize;
        let last = own.end - 1;
        let within = |&i: &usize| {
            place -= area(&self.triangles[i]);
            place < 0.0
        };
        let chosen = own.find(within).unwrap_or(last);
        Some((chosen, probability * area(&self.triangles[chosen]) / node.area))
    }

    /// The probability with which [`Openings::pick`] chooses a triangle.
    fn probability(&self, point: DVec3, triangle: usize) -> f64 {
        let mut at = 0;
        let mut probability = 1.0;
        let Some(mut node) = self.nodes.first() else { return 0.0 };
        while node.right != 0 {
            let left = self.left_share(at, point);
            if triangle < self.nodes[at + 1].end as usize {
                (at, probability) = (at + 1, probability * left);
            } else {
                (at, probability) = (node.right as usize, probability * (1.0 - left));
            }
            node = &self.nodes[at];
        }
        probability * area(&self.triangles[triangle]) / node.area
    }

    fn left_share(&self, at: usize, point: DVec3) -> f64 {
        let weight = |node: &OpeningNode| {
            let half = (node.max - node.min).length_squared() / 4.0;
            let square = (point - (node.min + node.max) / 2.0).length_squared();
            node.area / square.max(half).max(f64::MIN_POSITIVE)
        };
        let (left, right) =
            (weight(&self.nodes[at + 1]), weight(&self.nodes[self.nodes[at].right as usize]));
        left / (left + right)
    }
}

fn area([a, b, c]: &[DVec3; 3]) -> f64 {
    (*b - *a).cross(*c - *a).length() / 2.0
}

fn build(all: &mut [[DVec3; 3]], begin: usize, end: usize, nodes: &mut Vec<OpeningNode>) {
    let own = &mut all[begin..end];
    let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for corner in own.iter().flatten() {
        (min, max) = (min.min(*corner), max.max(*corner));
    }
    let at = nodes.len();
    let sum = own.iter().map(area).sum();
    nodes.push(OpeningNode { min, max, area: sum, begin: begin as u32, end: end as u32, right: 0 });
    if own.len() <= Openings::LEAF {
        return;
    }
    let size = max - min;
    let axis =
        if size.x >= size.y && size.x >= size.z { 0 } else { 1 + usize::from(size.z > size.y) };
    // A stable sort: the tree is a property of the list.
    own.sort_by(|a, b| {
        let place = |t: &[DVec3; 3]| t[0][axis] + t[1][axis] + t[2][axis];
        place(a).total_cmp(&place(b))
    });
    let half = begin + (end - begin) / 2;
    build(all, begin, half, nodes);
    nodes[at].right = nodes.len() as u32;
    build(all, half, end, nodes);
}

impl OpeningNode {
    fn hit(&self, origin: DVec3, inverse: DVec3, reach: f64) -> bool {
        let (mut near, mut far) = (0.0f64, reach);
        for axis in 0..3 {
            let a = (self.min[axis] - origin[axis]) * inverse[axis];
            let b = (self.max[axis] - origin[axis]) * inverse[axis];
            // A ray in a side of the box gives NaN there, which max and min pass over.
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        // Boxes of axis-parallel openings are flat.
        near <= far + 1e-9 * far.abs()
    }
}

fn passes(
    [a, b, c]: &[DVec3; 3],
    origin: DVec3,
    direction: DVec3,
    reach: f64,
    inwards: bool,
) -> Option<f64> {
    let (e1, e2) = (*b - *a, *c - *a);
    let normal = e1.cross(e2);
    let along = normal.dot(direction);
    if along == 0.0 || (along > 0.0) != inwards {
        return None;
    }
    let from = *a - origin;
    let t = normal.dot(from) / along;
    if !(t > 0.0 && t < reach) {
        return None;
    }
    let across = direction.cross(from);
    let (u, v) = (-e2.dot(across) / along, e1.dot(across) / along);
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0).then_some(t)
}

/// A photon of daylight where it enters the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arrival {
    /// Its start.
    pub start: Start,
    /// Flux, W, times the number of photons of the light.
    pub flux: Vec3,
    /// How far it is to the opening that it was aimed at, m; infinite without one.
    reach: f64,
}

/// Everything about daylight that tracing and rendering ask for.
#[derive(Clone, Debug)]
pub struct Daylight {
    sky: Sky,
    shell: Shell,
    tables: Vec<Table>,
    /// Table of each light; [`NONE`] for others than the sky's.
    table_of: Vec<u32>,
    /// Probabilities of the shell's sides, summed up: of the sky's light and of the sun's.
    sides: [[f64; 6]; 2],
    openings: Openings,
    /// What lies nearer together than this is one opening, m.
    tolerance: f64,
    /// Irradiance of a surface that looks up, and of one that looks down (scalar, without the sun), W/m2.
    level: [f32; 2],
    /// Mean flux (scalar, W) of the lights that come through openings.
    usual: f32,
}

impl Daylight {
    /// Table of all directions by radiance alone, after the six sides'.
    const DOME: usize = 6;

    /// Heap bytes at most, for so many lights and emitting triangles of which `openings` lights are the sky's.
    pub fn bytes(lights: usize, emitters: usize, openings: usize) -> u64 {
        let tables = (openings as u64 + 7) * (Table::BYTES + 32);
        lights as u64 * 4 + emitters as u64 * (72 + 128) + tables + Grid::BYTES
    }

    /// From the tables of a store. `delta` is the scene's tolerance, m.
    pub fn new(
        record: &SkyRecord,
        shell: Shell,
        delta: f32,
        lights: &[LightRecord],
        emitters: &[EmitterRecord],
    ) -> Self {
        let sky = Sky::new(record);
        let grid = Grid::new(&sky);
        let ground = f64::from(vector::luminance(sky.ground().as_vec3()));
        let mut tables = Vec::new();
        let mut sides = [[0.0; 6]; 2];
        let [by_sky, by_sun] = &mut sides;
        for (side, (by_sky, by_sun)) in by_sky.iter_mut().zip(by_sun).enumerate() {
            let (normal, area) = shell.side(side);
            tables.push(Table::new(&grid, ground, Some(normal)));
            let sky_side = vector::luminance(sky_flux(&grid, -normal, area).as_vec3());
            *by_sky = f64::from(sky_side);
            *by_sun = normal.dot(sky.sun()).max(0.0) * area;
        }
        for of in &mut sides {
            let total = of.iter().sum::<f64>().max(f64::MIN_POSITIVE);
            let mut sum = 0.0;
            for side in of {
                sum += *side / total;
                *side = sum;
            }
        }
        tables.push(Table::new(&grid, ground, None));
        let mut axes: Vec<DVec3> = Vec::new();
        let mut table_of = vec![NONE; lights.len()];
        let mut triangles = Vec::new();
        let (mut last, mut aimed, mut aiming) = (None, 0.0, 0.0f64);
        for (light, table) in lights.iter().zip(&mut table_of) {
            if !Self::is_daylight(light) || light.emitter_count == 0 {
                continue;
            }
            let first = light.first_emitter as usize;
            let own = emitters.get(first..first + light.emitter_count as usize).unwrap_or(&[]);
            // Sky and sun of one opening share its triangles, and follow each other.
            if last != Some(first) {
                triangles.extend(own.iter().map(|e| e.corners.map(|c| Vec3::from(c).as_dvec3())));
            }
            last = Some(first);
            aimed += f64::from(vector::luminance(Vec3::from(light.flux_w)));
            aiming += 1.0;
            if light.kind == LIGHT_SUN {
                continue;
            }
            let outwards = -Vec3::from(light.axis).as_dvec3();
            let known = axes.iter().position(|a| a.dot(outwards) > SAME_AXIS);
            let index = known.unwrap_or_else(|| {
                axes.push(outwards);
                tables.push(Table::new(&grid, ground, Some(outwards)));
                axes.len() - 1
            });
            *table = (Self::DOME + 1 + index) as u32;
        }
        let luminance = |c: DVec3| vector::luminance(c.as_vec3());
        let level =
            [luminance(grid.irradiance(DVec3::Z)), luminance(grid.irradiance(DVec3::NEG_Z))];
        let tolerance = 4.0 * f64::from(delta);
        Self {
            sky,
            shell,
            tables,
            table_of,
            sides,
            openings: Openings::new(triangles),
            tolerance,
            level,
            usual: (aimed / aiming.max(1.0)) as f32,
        }
    }

    /// Whether a light is daylight's.
    pub fn is_daylight(light: &LightRecord) -> bool {
        light.kind == LIGHT_SKY || light.kind == LIGHT_SUN
    }

    /// Whether a light is all the daylight that comes through no opening, and not that of one.
    pub fn is_everywhere(light: &LightRecord) -> bool {
        Self::is_daylight(light) && light.emitter_count == 0
    }

    /// Photon `photon` of light number `id`, which is daylight's, where it enters the scene. It carries its flux if
    /// [`Daylight::owns`] says so, else none.
    pub fn emit(
        &self,
        seed: u64,
        id: u32,
        light: &LightRecord,
        emitters: &[EmitterRecord],
        photon: u32,
    ) -> Arrival {
        let u = rng::uniforms(seed, Purpose::Emission, id, photon, 0, 0);
        let v = rng::uniforms(seed, Purpose::Emission, id, photon, 0, 1);
        let sun = light.kind == LIGHT_SUN;
        // Where the line passes, which way out is there, the area over its probability, and the table for its direction.
        let (point, outwards, area, table) = if emitters.is_empty() {
            let sides = &self.sides[usize::from(sun)];
            let side = sides.partition_point(|&s| s <= f64::from(u[0])).min(5);
            let before = if side == 0 { 0.0 } else { sides[side - 1] };
            let (normal, area) = self.shell.side(side);
            let point = self.shell.point(side, f64::from(u[1]), f64::from(u[2]));
            (point, normal, area / (sides[side] - before).max(f64::MIN_POSITIVE), side)
        } else {
            let point = emission::point_on(light, emitters, [u[0], u[1], u[2]], 0.0);
            let table = self.table_of.get(id as usize).copied().unwrap_or(NONE);
            let table = if table == NONE { Self::DOME } else { table as usize };
            let out = -point.normal.as_dvec3();
            (point.position.as_dvec3(), out, f64::from(light.area_m2), table)
        };
        let (towards, flux) = if sun {
            let towards = self.in_disc([v[0], v[1]]);
            (towards, self.sky.sun_irradiance() * (area * outwards.dot(towards).max(0.0)))
        } else {
            let (towards, density) = self.tables[table].sample([v[0], v[1], v[2]]);
            let cos = outwards.dot(towards).max(0.0);
            let weight = if density > 0.0 { area * cos / density } else { 0.0 };
            (towards, self.sky.radiance(towards) * weight)
        };
        let aimed = !emitters.is_empty();
        let reach = if aimed { self.shell.exit(point, towards) } else { 0.0 };
        Arrival {
            start: Start {
                origin: (point + towards * reach).as_vec3(),
                direction: (-towards).as_vec3().normalize(),
                triangle: NONE,
            },
            flux: flux.as_vec3(),
            reach: if aimed { reach } else { f64::INFINITY },
        }
    }

    /// Whether a photon's line belongs to the light that emitted it: no other opening comes before its own.
    pub fn owns(&self, arrival: &Arrival) -> bool {
        let Start { origin, direction, .. } = arrival.start;
        let reach = arrival.reach - self.tolerance;
        self.openings.passed(origin.as_dvec3(), direction.as_dvec3(), reach, true, true).is_none()
    }

    /// Photons that a surface outside sends through openings, of light that it reflects diffusely (`reflected`, W): `found` gets the
    /// direction and the flux of each, and the key of its random numbers. `key` is light, photon and bounce of the one that
    /// was reflected, `count` the number of photons of a light: there will be as many as
    /// bring their fluxes near that of photons that come through openings by themselves, up to [`MOST_AIMED`].
    ///
    /// Candidates are drawn from the openings' triangles, near ones likelier, and some of them chosen by what they are worth
    /// (Talbot, Cline and Egbert 2005, "Importance resampling for global illumination").
    /// Directions that are likelier to be met by chance than by aim are left to chance: [`Daylight::is_aimed`].
    pub fn aim(
        &self,
        seed: u64,
        key: (u32, u32, u16),
        surface: &Surface,
        reflected: Vec3,
        count: u64,
        mut found: impl FnMut(Vec3, Vec3, u32),
    ) {
        let (light, photon, bounce) = key;
        let (point, normal) = (surface.origin.as_dvec3(), surface.normal.as_dvec3());
        let numbers = |index| rng::block(seed, Purpose::Aim, light, photon, bounce, index);
        let mut candidates = [(DVec3::ZERO, 0.0f64, 0.0f64); CANDIDATES];
        let mut total = 0.0;
        for (i, candidate) in candidates.iter_mut().enumerate() {
            let [a, b, c, d] = numbers(i as u8);
            // 56 bits: a tree may be deep.
            let u = (f64::from(a) + f64::from(b >> 8) / 16_777_216.0) / 4_294_967_296.0;
            let Some((triangle, probability)) = self.openings.pick(point, u) else { return };
            let (v, w) = vector::triangle(rng::unit(c), rng::unit(d));
            let [p, q, r] = self.openings.triangles[triangle];
            let to = p + (q - p) * f64::from(v) + (r - p) * f64::from(w) - point;
            let distance = to.length();
            let towards = to / distance;
            let cos = towards.dot(normal);
            let share = self.share(triangle, towards, distance, probability);
            if cos > 0.0 && share > 0.0 && share <= BY_CHANCE {
                *candidate = (towards, cos * share, distance);
                total += cos * share;
            }
        }
        if total <= 0.0 {
            return;
        }
        let flux = reflected * (total / CANDIDATES as f64) as f32;
        let wanted = vector::luminance(flux) * count as f32 / self.usual.max(f32::MIN_POSITIVE);
        let last = numbers(CANDIDATES as u8);
        let (times, flux) = if wanted >= 1.0 {
            let times = wanted.ceil().min(MOST_AIMED as f32);
            (times as u32, flux / times)
        } else {
            // Photons that would carry too little are bundled.
            let survival = wanted.max(0.05);
            if rng::unit(last[0]) >= survival {
                return;
            }
            (1, flux / survival)
        };
        for i in 0..times {
            let numbers = numbers((CANDIDATES + 1) as u8 + i as u8);
            let mut place = f64::from(rng::unit(numbers[0])) * total;
            let chosen = candidates.iter().find(|c| {
                place -= c.1;
                place < 0.0
            });
            let Some(&(towards, _, distance)) = chosen.or(candidates.iter().rfind(|c| c.1 > 0.0))
            else {
                continue;
            };
            // A line belongs to the first opening on it.
            let reach = distance - self.tolerance;
            if self.openings.passed(point, towards, reach, true, true).is_none() {
                found(towards.as_vec3().normalize(), flux, numbers[1]);
            }
        }
    }

    /// Whether light that a surface outside reflects from `origin` towards a direction is carried by photons that
    /// [`Daylight::aim`] sends: its first opening is not too near to be aimed at.
    pub fn is_aimed(&self, origin: Vec3, direction: Vec3) -> bool {
        let (origin, direction) = (origin.as_dvec3(), direction.as_dvec3());
        let first = self.openings.passed(origin, direction, f64::INFINITY, true, false);
        first.is_some_and(|(triangle, t)| {
            let probability = self.openings.probability(origin, triangle);
            self.share(triangle, direction, t, probability) <= BY_CHANCE
        })
    }

    /// Cosine at the opening over pi, distance squared and density: by how much a direction is likelier by chance (by the
    /// cosine at the surface) than by aim; not positive from behind.
    fn share(&self, triangle: usize, towards: DVec3, distance: f64, probability: f64) -> f64 {
        let [a, b, c] = self.openings.triangles[triangle];
        // Twice the area times the normal.
        let normal = (b - a).cross(c - a);
        normal.dot(towards) / (2.0 * PI * distance * distance * probability)
    }

    /// Whether a ray from a shading point passes an opening outwards before distance `reach` (m; what lies within the tolerance
    /// of `reach` does not count). Infinite: anywhere on its way.
    pub fn leaves_before(&self, origin: Vec3, direction: Vec3, reach: f32) -> bool {
        let reach = f64::from(reach) - self.tolerance;
        self.openings.passed(origin.as_dvec3(), direction.as_dvec3(), reach, false, true).is_some()
    }

    /// A direction from a point through an opening, how far it is to the opening (m), and the density of the direction (1/sr), from
    /// three uniform numbers. `None` from behind. Openings of few triangles are drawn by solid angle, so that a point right beside a large window
    /// sees it without noise; others by area.
    pub fn sample_opening(
        &self,
        light: &LightRecord,
        emitters: &[EmitterRecord],
        from: Vec3,
        u: [f32; 3],
    ) -> Option<(Vec3, f32, f32)> {
        let origin = from.as_dvec3();
        let corners = |e: &EmitterRecord| e.corners.map(|c| Vec3::from(c).as_dvec3());
        let facing = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).dot(origin - a);
        if emitters.len() <= MOST_SPHERICAL {
            let mut seen = [(0.0, spherical::Triangle::default()); MOST_SPHERICAL];
            let mut total = 0.0;
            for (emitter, seen) in emitters.iter().zip(&mut seen) {
                let triangle = corners(emitter);
                if facing(triangle) > 0.0 {
                    *seen = (total, spherical::Triangle::new(triangle.map(|c| c - origin)));
                    total += seen.1.solid_angle();
                }
            }
            // A sliver is left to its area: the angles of very small triangles are rounding.
            if total > LEAST_SPHERICAL {
                let place = f64::from(u[0]) * total;
                let lit = |s: &(usize, &(f64, spherical::Triangle))| {
                    s.1.1.solid_angle() > 0.0 && s.1.0 <= place
                };
                let (index, (_, triangle)) = seen.iter().enumerate().rfind(lit)?;
                let direction = triangle.sample(f64::from(u[1]), f64::from(u[2]));
                let [a, b, c] = corners(emitters.get(index)?);
                let normal = (b - a).cross(c - a);
                let distance = normal.dot(a - origin) / normal.dot(direction);
                return (distance > 0.0 && distance.is_finite())
                    .then(|| (direction.as_vec3(), distance as f32, (1.0 / total) as f32));
            }
        }
        let point = emission::point_on(light, emitters, u, 0.0);
        let to = point.position.as_dvec3() - origin;
        let square = to.length_squared();
        let distance = square.sqrt();
        let direction = to / distance;
        let cos = -direction.dot(point.normal.as_dvec3());
        let density = square / (cos * f64::from(light.area_m2));
        (cos > 0.0 && density.is_finite() && density > 0.0)
            .then(|| (direction.as_vec3(), distance as f32, density as f32))
    }

    /// What a ray that leaves the scene sees, the sun's disc included, W/m2/sr.
    pub fn seen(&self, towards: Vec3) -> Vec3 {
        let towards = towards.as_dvec3().normalize_or_zero();
        (self.sky.radiance(towards) + self.sky.sun_radiance(towards)).as_vec3()
    }

    /// Radiance of sky or ground, without the sun's disc, W/m2/sr.
    pub fn radiance(&self, towards: Vec3) -> Vec3 {
        self.sky.radiance(towards.as_dvec3().normalize_or_zero()).as_vec3()
    }

    /// A direction with a density (1/sr) near the radiance of sky and ground, times the cosine where a surface faces along an
    /// axis, as most do, from three uniform numbers.
    pub fn sample(&self, normal: Vec3, u: [f32; 3]) -> (Vec3, f32) {
        // A table has a density for all that is less than its cells' size behind its plane.
        let axis = (0..3).find(|&a| normal[a].abs() > ALONG_AXIS);
        let table = axis.map_or(Self::DOME, |a| 2 * a + usize::from(normal[a] > 0.0));
        let (towards, density) = self.tables[table].sample(u);
        (towards.as_vec3(), density as f32)
    }

    /// A direction to the sun's disc from two uniform numbers. Together they give [`Daylight::sun_irradiance`].
    pub fn sample_sun(&self, u: [f32; 2]) -> Vec3 {
        self.in_disc(u).as_vec3()
    }

    fn in_disc(&self, u: [f32; 2]) -> DVec3 {
        let cos = 1.0 - f64::from(u[0]) * (1.0 - self.sky.sun_cos());
        let sin = libm::sqrt((1.0 - cos * cos).max(0.0));
        let (s, c) = libm::sincos(TAU * f64::from(u[1]));
        let sun = self.sky.sun();
        let (t, b) = vector::frame(sun.as_vec3());
        (sun * cos + t.as_dvec3() * (sin * c) + b.as_dvec3() * (sin * s)).normalize_or_zero()
    }

    /// Irradiance by the sun square to its rays, W/m2.
    pub fn sun_irradiance(&self) -> Vec3 {
        self.sky.sun_irradiance().as_vec3()
    }

    /// A guess of the irradiance (scalar, W/m2) that sky and ground give a surface with this normal, were nothing in the
    /// way.
    pub fn guess(&self, normal: Vec3) -> f32 {
        let up = 0.5 + 0.5 * normal.z;
        self.level[0] * up + self.level[1] * (1.0 - up)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use enf_daylight::{Amount, Pattern, record};

    fn sky(number: u8) -> SkyRecord {
        let amount = Amount {
            diffuse: 100.0,
            direct: 300.0,
            ground: [0.1, 0.2, 0.3],
            color: [0.8, 1.0, 1.3],
            sun_color: [1.0; 3],
        };
        record(&Pattern::cie(number), DVec3::new(0.48, -0.6, 0.64), &amount)
    }

    /// An opening of 1 x 1 m in the plane x = `x`, from y and z on; light goes towards +x (or -x).
    fn window(x: f32, y: f32, z: f32, forth: bool) -> [[[f32; 3]; 3]; 2] {
        let (a, b, c, d) = ([x, y, z], [x, y + 1.0, z], [x, y + 1.0, z + 1.0], [x, y, z + 1.0]);
        if forth { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] }
    }

    /// Daylight through such openings, and their lights: sky, then sun, of each.
    fn daylight(
        record: &SkyRecord,
        windows: &[[[[f32; 3]; 3]; 2]],
    ) -> (Daylight, Vec<LightRecord>, Vec<EmitterRecord>) {
        let (sky, mut lights, mut emitters) = (Sky::new(record), Vec::new(), Vec::new());
        let grid = Grid::new(&sky);
        for triangles in windows {
            let [a, b, c] = triangles[0].map(|p| Vec3::from(p).as_dvec3());
            let axis = (b - a).cross(c - a).normalize();
            let flux = [sky_flux(&grid, axis, 1.0), sun_flux(&sky, axis, 1.0)];
            for (kind, flux) in [(LIGHT_SKY, flux[0]), (LIGHT_SUN, flux[1])] {
                lights.push(LightRecord {
                    kind,
                    first_emitter: emitters.len() as u32,
                    emitter_count: 2,
                    flux_w: flux.as_vec3().to_array(),
                    area_m2: 1.0,
                    axis: axis.as_vec3().to_array(),
                    ..LightRecord::DARK
                });
            }
            for (i, &corners) in triangles.iter().enumerate() {
                let cumulative = 0.5 * (i + 1) as f32;
                emitters.push(EmitterRecord { corners, triangle: NONE, cumulative, reserved: 0 });
            }
        }
        for kind in [LIGHT_SKY, LIGHT_SUN] {
            let shell = Shell::new([-5.0; 3], [9.0; 3]);
            let flux = shell_flux(kind, &sky, &grid, &shell).as_vec3().to_array();
            lights.push(LightRecord { kind, flux_w: flux, ..LightRecord::DARK });
        }
        let all = Daylight::new(record, Shell::new([-5.0; 3], [9.0; 3]), 1e-4, &lights, &emitters);
        (all, lights, emitters)
    }

    /// Each light's photons carry its flux, start on the shell, and go where they were aimed. 20,000 photons: the bound is
    /// 4 standard deviations of the mean as measured, and no photon carries much more than another.
    #[test]
    fn photons_carry_the_flux_of_their_light() {
        for number in [1, 5, 12, 15] {
            let (all, lights, emitters) = daylight(
                &sky(number),
                &[window(0.0, 0.0, 1.0, false), window(2.0, 3.0, 0.0, true)],
            );
            for (id, light) in lights.iter().enumerate() {
                if light.flux_w == [0.0; 3] {
                    continue;
                }
                let own = light.first_emitter as usize
                    ..(light.first_emitter + light.emitter_count) as usize;
                let (mut sum, mut squares, mut most, count) = (0.0, 0.0, 0.0f64, 20_000);
                for photon in 0..count {
                    let arrival = all.emit(7, id as u32, light, &emitters[own.clone()], photon);
                    let flux = f64::from(arrival.flux.y);
                    (sum, squares, most) = (sum + flux, squares + flux * flux, most.max(flux));
                    let Start { origin, direction, .. } = arrival.start;
                    assert!((direction.length() - 1.0).abs() < 1e-6);
                    let shell =
                        (origin.as_dvec3() - all.shell.min).min(all.shell.max - origin.as_dvec3());
                    assert!(shell.min_element().abs() < 1e-4, "{origin}");
                    if light.emitter_count > 0 {
                        let x = origin + direction * arrival.reach as f32;
                        assert!((x.x - emitters[own.start].corners[0][0]).abs() < 1e-4);
                        assert!(flux == 0.0 || direction.dot(Vec3::from(light.axis)) > 0.0);
                    }
                }
                let n = f64::from(count);
                let mean = sum / n;
                let sigma = ((squares / n - mean * mean) / n).max(0.0).sqrt();
                let expected = f64::from(light.flux_w[1]);
                assert!(
                    (mean - expected).abs() < 4.0 * sigma + 2e-3 * expected,
                    "sky {number}, light {id}: {mean} for {expected}, sigma {sigma}"
                );
                assert!(most < 4.0 * mean, "sky {number}, light {id}: {most} of {mean}");
            }
        }
    }

    /// The density of a table is what it says: it integrates to 1 where it is positive, and covers all that is lit.
    #[test]
    fn densities_integrate_to_one() {
        let sky = Sky::new(&sky(12));
        let grid = Grid::new(&sky);
        for normal in [None, Some(DVec3::Z), Some(DVec3::new(0.6, 0.0, -0.8)), Some(DVec3::NEG_Z)] {
            let table = Table::new(&grid, 1.0, normal);
            assert_eq!(table.cumulative[CELLS - 1], STEPS);
            assert!(table.cumulative.is_sorted());
            // 1/density over samples is the solid angle of the cells that can be drawn.
            let mut state = 1u32;
            let mut random = || {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                rng::unit(state)
            };
            let count = 40_000;
            let mut irradiance = 0.0;
            for _ in 0..count {
                let (to, density) = table.sample([random(), random(), random()]);
                let lift = normal.map_or(1.0, |n| n.dot(to).max(0.0));
                irradiance += if to.z < 0.0 { 1.0 } else { sky.brightness(to) } * lift / density;
            }
            if let Some(n) = normal {
                let ground = PI * (1.0 - n.z) / 2.0;
                let expected = grid.sky_irradiance(n) + ground;
                let found = irradiance / f64::from(count);
                assert!((found / expected - 1.0).abs() < 0.01, "{found} for {expected}");
            }
        }
        // Nothing shines at all: something is drawn all the same.
        let dark = Sky::new(&SkyRecord { scale: 0.0, ..self::sky(5) });
        let table = Table::new(&Grid::new(&dark), 0.0, Some(DVec3::Z));
        assert!(table.sample([0.5; 3]).1 > 0.0);
    }

    /// A line through two windows belongs to the first, and to no light without an opening.
    #[test]
    fn lines_have_one_owner() {
        let (all, ..) =
            daylight(&sky(5), &[window(0.0, 0.0, 0.0, true), window(4.0, 0.0, 0.0, true)]);
        let line = |y: f32, reach: f64| Arrival {
            start: Start { origin: Vec3::new(-5.5, y, 0.5), direction: Vec3::X, triangle: NONE },
            flux: Vec3::ONE,
            reach,
        };
        assert!(all.owns(&line(0.3, 5.5)));
        assert!(!all.owns(&line(0.3, 9.5)));
        assert!(!all.owns(&line(0.3, f64::INFINITY)));
        assert!(all.owns(&line(1.5, f64::INFINITY)));
        // Seen from inside, the other way round.
        let inside = Vec3::new(6.0, 0.3, 0.5);
        assert!(!all.leaves_before(inside, Vec3::NEG_X, 2.0));
        assert!(all.leaves_before(inside, Vec3::NEG_X, 6.0));
        assert!(!all.leaves_before(Vec3::new(-2.0, 0.3, 0.5), Vec3::X, f32::INFINITY));
    }

    fn many_windows() -> Vec<[[[f32; 3]; 3]; 2]> {
        let place = |i: u32| ((i % 5) as f32 * 1.5 - 4.0, (i / 5) as f32 * 1.2 - 3.0);
        (0..25).map(|i| window(6.0, place(i).0, place(i).1, i % 7 != 3)).collect()
    }

    #[test]
    fn the_tree_knows_its_probabilities() {
        let (all, ..) = daylight(&sky(5), &many_windows());
        let openings = &all.openings;
        assert_eq!(openings.triangles.len(), 50);
        for point in [DVec3::ZERO, DVec3::new(5.5, 1.0, 2.0), DVec3::new(6.0, -3.9, -2.9)] {
            let sum: f64 = (0..50).map(|t| openings.probability(point, t)).sum();
            assert!((sum - 1.0).abs() < 1e-12);
            for i in 0..200 {
                let (triangle, p) = openings.pick(point, (f64::from(i) + 0.5) / 200.0).unwrap();
                assert!((p - openings.probability(point, triangle)).abs() < 1e-12);
            }
        }
    }

    /// What is aimed at windows, and what is left to chance, is together what they get: the configuration factor, by
    /// quadrature. 4,000 photons from a point far away, and from one close to the windows, where some is left to chance; the
    /// bound is 4 standard deviations as measured.
    #[test]
    fn aim_and_chance_share_all() {
        let windows = many_windows();
        let (all, ..) = daylight(&sky(5), &windows);
        let (far, near) = (Vec3::new(-2.0, 0.1, -3.5), Vec3::new(5.8, -3.5, -2.5));
        for (position, some_by_chance) in [(far, false), (near, true)] {
            let surface = Surface {
                position,
                normal: Vec3::new(0.6, 0.0, 0.8),
                front: true,
                origin: position,
                triangle: NONE,
                material: 0,
            };
            let (point, normal) = (surface.origin.as_dvec3(), surface.normal.as_dvec3());
            let mut expected = 0.0;
            let steps = 60;
            // Those that light passes towards -x get nothing from here.
            for triangles in (0..25).filter(|i| i % 7 != 3).map(|i| &windows[i]) {
                let [a, b, _] = triangles[0].map(|p| Vec3::from(p).as_dvec3());
                let d = Vec3::from(triangles[1][2]).as_dvec3();
                for i in 0..steps * steps {
                    let at = |k: u32| (f64::from(k) + 0.5) / f64::from(steps);
                    let to = a + (b - a) * at(i % steps) + (d - a) * at(i / steps) - point;
                    let square = to.length_squared();
                    let cos = to.dot(normal).max(0.0) / square.sqrt();
                    expected +=
                        cos * to.x / square.sqrt() / (PI * square) / f64::from(steps * steps);
                }
            }
            let count = 4000u32;
            let (mut sum, mut squares, mut chance) = (0.0, 0.0, 0);
            for photon in 0..count {
                let mut own = 0.0;
                // So many photons of a light that splitting and bundling both happen.
                all.aim(3, (0, photon, 0), &surface, Vec3::ONE, 1000, |_, flux, _| {
                    own += f64::from(flux.y);
                });
                let u = rng::uniforms(3, Purpose::Scatter, 0, photon, 0, 0);
                let direction = vector::cosine(surface.normal, u[0], u[1]);
                let hits =
                    all.openings.passed(point, direction.as_dvec3(), f64::INFINITY, true, true);
                if hits.is_some() && !all.is_aimed(surface.origin, direction) {
                    own += 1.0;
                    chance += 1;
                }
                (sum, squares) = (sum + own, squares + own * own);
            }
            let n = f64::from(count);
            let mean = sum / n;
            let sigma = ((squares / n - mean * mean) / n).sqrt();
            assert!(
                (mean - expected).abs() < 4.0 * sigma && sigma < 0.05 * expected,
                "{mean} for {expected}, sigma {sigma}"
            );
            assert_eq!(chance > 0, some_by_chance, "{chance}");
        }
    }
}
