//! Where pictures are taken from: the scene's views, a file's, a room's, or viewpoints found by looking around.

use std::cell::RefCell;

use enf_layout::bsp::LEAF_OUTSIDE;
use enf_layout::room::ViewRecord;
use enf_layout::segment::ExtentKind;
use enf_layout::transit::TransitRecord;
use enf_rooms::Bsp;
use enf_scene::{DEFAULT_HEIGHT, DEFAULT_WIDTH, Frame, Projection, Up};
use enf_stage::resident::{TileData, TileReader};
use enf_stage::tables::Tables;
use enf_stage::{Failure, Result};
use enf_store::StageReader;
use enf_transport::flight::{self, Flight, Resident};
use enf_transport::vector;
use glam::Vec3;

use crate::RenderArgs;

/// Vertical field of view of viewpoints that were found, degrees.
const FOUND_FOV: f32 = 58.0;
/// A plan is cut at this height above the floor, m: below the heads of doors.
const CUT_M: f32 = 1.9;
/// What a plan shows about the rooms, m.
const MARGIN_M: f32 = 0.6;
/// How many viewpoints `--view auto` finds.
const AUTO_VIEWS: usize = 3;

/// A picture to be taken.
#[derive(Clone, Debug)]
pub struct View {
    /// Name, also of the picture's file.
    pub name: String,
    /// Where the camera stands; width and height are not 0.
    pub camera: Camera,
}

/// Where a picture's rays start, and where they go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Eye, m; of a plan, the picture's middle.
    pub eye: Vec3,
    projection: Projection,
    forward: Vec3,
    /// To the right: half the picture's width, at distance 1 in perspective and in m of a plan; length 1 of a panorama.
    right: Vec3,
    /// Downwards, likewise.
    down: Vec3,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
}

impl Camera {
    /// The camera of a view record.
    ///
    /// # Errors
    /// A view that looks nowhere, or straight along its up direction.
    pub fn new(
        record: &ViewRecord,
        projection: Projection,
    ) -> std::result::Result<Self, &'static str> {
        let (eye, target) = (Vec3::from(record.eye), Vec3::from(record.target));
        let forward = (target - eye).normalize_or_zero();
        let right = forward.cross(Vec3::from(record.up)).normalize_or_zero();
        if forward == Vec3::ZERO {
            return Err("eye and target are the same point");
        }
        if right == Vec3::ZERO {
            return Err("the view looks straight along its up direction; give another up");
        }
        // Whatever a panorama looks at, its horizon is level.
        let forward = match projection {
            Projection::Panorama => Vec3::from(record.up).cross(right).normalize_or_zero(),
            _ => forward,
        };
        let half = match projection {
            Projection::Perspective => {
                if !(record.fov_degrees > 0.0 && record.fov_degrees < 180.0) {
                    return Err("the field of view is not between 0 and 180 degrees");
                }
                libm::tanf(record.fov_degrees.to_radians() * 0.5)
            }
            Projection::Panorama => 1.0,
            Projection::Plan => {
                if !(record.fov_degrees > 0.0 && record.fov_degrees.is_finite()) {
                    return Err("a plan's height is not a positive number of metres");
                }
                record.fov_degrees * 0.5
            }
        };
        let aspect = match projection {
            Projection::Panorama => 1.0,
            _ => record.width as f32 / record.height as f32,
        };
        Ok(Self {
            eye,
            projection,
            forward,
            right: right * (half * aspect),
            down: forward.cross(right) * half,
            width: record.width,
            height: record.height,
        })
    }

    /// Origin (m) and unit direction of the ray through a pixel at a place in it, both from `[0, 1)`.
    pub fn ray(&self, pixel: u32, dx: f32, dy: f32) -> (Vec3, Vec3) {
        let (x, y) = (pixel % self.width, pixel / self.width);
        let u = (x as f32 + dx) / self.width as f32 * 2.0 - 1.0;
        let v = (y as f32 + dy) / self.height as f32 * 2.0 - 1.0;
        match self.projection {
            Projection::Perspective => {
                (self.eye, (self.forward + self.right * u + self.down * v).normalize())
            }
            Projection::Panorama => {
                let (sin, cos) = libm::sincosf(u * core::f32::consts::PI);
                let (below, flat) = libm::sincosf(v * core::f32::consts::FRAC_PI_2);
                let level = self.forward * cos + self.right * sin;
                (self.eye, (level * flat + self.down * below).normalize())
            }
            Projection::Plan => (self.eye + self.right * u + self.down * v, self.forward),
        }
    }

    /// Whether it is a plan, whose rays start anywhere.
    pub fn is_plan(&self) -> bool {
        self.projection == Projection::Plan
    }

    /// Pixels of the picture.
    pub fn pixels(&self) -> u32 {
        self.width * self.height
    }
}

/// A view that is to be taken, its size still open.
type Found = (String, Projection, ViewRecord);

/// Views that the command line asks for by names that the scene itself must have.
///
/// # Errors
/// Exit 4 for a bad view file.
pub(crate) fn named(args: &RenderArgs) -> Result<Vec<String>> {
    let mut own = Vec::new();
    if let Some(path) = &args.views {
        // Names are the same in any frame.
        let frame = Frame { units: 1.0, up: Up::Z, origin: [0.0; 3] };
        let file =
            enf_scene::load_views(path, &frame).map_err(|e| Failure::input(e.to_string()))?;
        own.extend(file.into_iter().map(|v| v.name));
    }
    let found = |name: &&String| {
        let of_a_room = ["room:", "panorama:", "plan:"].iter().any(|p| name.starts_with(p));
        of_a_room || ["auto", "all"].contains(&name.as_str()) || own.contains(*name)
    };
    Ok(args.view.iter().filter(|n| !found(n)).cloned().collect())
}

/// Resolves what the command line asks for.
///
/// # Errors
/// Exit 2 for an unknown view or room, exit 4 for a bad view file.
pub(crate) fn views(
    args: &RenderArgs,
    tables: &Tables,
    reader: &TileReader<'_>,
    maps: &StageReader,
) -> Result<Vec<View>> {
    let bsp = tables.bsp()?;
    let finder = Finder { tables, bsp: &bsp, reader, last: RefCell::new(None) };
    let mut found: Vec<Found> = Vec::new();
    let projections = tables.names.projections.iter().map(|p| Projection::of(p));
    let projections = projections.map(Option::unwrap_or_default);
    let projections = projections.chain(std::iter::repeat(Projection::default()));
    let mut known: Vec<Found> = tables
        .names
        .views
        .iter()
        .zip(projections)
        .zip(tables.views())
        .map(|((name, projection), record)| (name.clone(), projection, *record))
        .collect();
    let frame = Frame {
        units: tables.names.units,
        up: if tables.names.y_up { Up::Y } else { Up::Z },
        origin: tables.scene.origin,
    };
    if let Some(path) = &args.views {
        let file =
            enf_scene::load_views(path, &frame).map_err(|e| Failure::input(e.to_string()))?;
        let file: Vec<_> = file.into_iter().map(|v| (v.name, v.projection, v.record)).collect();
        if args.view.is_empty() {
            found.extend(file.iter().cloned());
        }
        known.extend(file);
    }
    if let Some(camera) = args.camera()? {
        let record = camera
            .record(&frame)
            .map_err(|(what, remedy)| Failure::usage(format!("--eye: {what}")).with_hint(remedy))?;
        found.push(("camera".into(), camera.projection, record));
    }
    let auto = ["auto".to_string()];
    let wanted: &[String] =
        if args.view.is_empty() && found.is_empty() { &auto } else { &args.view };
    for name in wanted {
        if name == "auto" {
            for room in finder.telling_rooms(maps)? {
                let record = finder.look_around(room)?;
                found.push((format!("room-{room}"), Projection::Perspective, record));
            }
        } else if name == "all" {
            found.extend(known.iter().cloned());
        } else if let Some(view) = known.iter().find(|v| &v.0 == name) {
            found.push(view.clone());
        } else if let Some((kind, room)) = name.split_once(':')
            && ["room", "panorama", "plan"].contains(&kind)
        {
            let room = room.parse().ok().filter(|&r: &u32| (r as usize) < tables.rooms().len());
            let room = room.ok_or_else(|| {
                Failure::usage(format!(
                    "--view {name}: the store has rooms 0 to {}",
                    tables.rooms().len() - 1
                ))
            })?;
            let view = match kind {
                "plan" => (Projection::Plan, finder.storey(room)),
                "panorama" => (Projection::Panorama, finder.panorama(room)?),
                _ => (Projection::Perspective, finder.stand_in(room)?),
            };
            found.push((format!("{kind}-{room}"), view.0, view.1));
        } else {
            let names: Vec<&str> = known.iter().map(|v| v.0.as_str()).collect();
            return Err(enf_stage::failure::no_view(name, &names));
        }
    }
    if found.is_empty() {
        return Err(Failure::usage("no view to render").with_hint("--view auto finds three"));
    }
    let mut views: Vec<View> = Vec::new();
    for (name, projection, mut record) in found {
        let whole = projection == Projection::Plan && record.fov_degrees == 0.0;
        let shown = whole.then(|| finder.shown(&mut record));
        let (width, height) = sides(args, projection, &record, shown);
        (record.width, record.height) = (width, height);
        if let Some(shown) = shown {
            record.fov_degrees = shown[1].max(shown[0] * height as f32 / width as f32);
        }
        let camera = Camera::new(&record, projection)
            .map_err(|e| Failure::input(format!("view {name}: {e}")))?;
        // The same picture twice is one; another one gets another name.
        if !views.iter().any(|v| v.camera == camera && v.name == name) {
            let name = unused(&name, |name| views.iter().any(|v| v.name == name));
            views.push(View { name, camera });
        }
    }
    let pixels: u64 = views
        .iter()
        .map(|v| u64::from(v.camera.width) * u64::from(v.camera.height))
        .fold(0, u64::saturating_add);
    if pixels > u64::from(u32::MAX) {
        return Err(Failure::usage("the pictures have more than 4294967295 pixels together"));
    }
    Ok(views)
}

/// The name, or the first of `name-2`, `name-3` and so on that is not `used`.
pub(crate) fn unused(name: &str, used: impl Fn(&str) -> bool) -> String {
    let numbered = (2u32..).map(|n| format!("{name}-{n}"));
    std::iter::once(name.to_owned()).chain(numbered).find(|name| !used(name)).unwrap_or_default()
}

/// Width and height of a picture: what the flags say, else the view, else what fits. `shown` is what a plan of a whole
/// storey shows, m.
fn sides(
    args: &RenderArgs,
    projection: Projection,
    record: &ViewRecord,
    shown: Option<[f32; 2]>,
) -> (u32, u32) {
    let said = |flag: Option<u32>, view: u32| flag.or((view > 0).then_some(view));
    let (width, height) = (said(args.width, record.width), said(args.height, record.height));
    // Width over height.
    let shape = match (projection, shown) {
        (Projection::Panorama, _) => 2.0,
        (Projection::Plan, Some([x, y])) if x > 0.0 && y > 0.0 => x / y,
        _ => return (width.unwrap_or(DEFAULT_WIDTH), height.unwrap_or(DEFAULT_HEIGHT)),
    };
    let of = |side: f32| (side.round() as u32).clamp(1, 65_536);
    match (width, height) {
        (Some(width), Some(height)) => (width, height),
        (Some(width), None) => (width, of(width as f32 / shape)),
        (None, Some(height)) => (of(height as f32 * shape), height),
        (None, None) if shape >= 1.0 => (DEFAULT_WIDTH, of(DEFAULT_WIDTH as f32 / shape)),
        (None, None) => (of(DEFAULT_WIDTH as f32 * shape), DEFAULT_WIDTH),
    }
}

/// Looks around in rooms.
struct Finder<'a> {
    tables: &'a Tables,
    bsp: &'a Bsp<'a>,
    reader: &'a TileReader<'a>,
    /// The tile looked through last.
    last: RefCell<Option<TileData>>,
}

/// Directions in which a viewpoint looks around.
const AROUND: usize = 24;

impl Finder<'_> {
    /// Rooms with much to see: lit, furnished, large. Canonical: ties go to the lower id.
    fn telling_rooms(&self, maps: &StageReader) -> Result<Vec<u32>> {
        let mut scores: Vec<(f64, u32)> = Vec::new();
        for (id, room) in self.tables.rooms().iter().enumerate() {
            if room.flags & LEAF_OUTSIDE != 0 {
                continue;
            }
            let photons: u64 = maps.find(ExtentKind::Map, id as u32).iter().map(|e| e.count).sum();
            let score = libm::log(1.0 + photons as f64)
                * libm::log(2.0 + room.triangles as f64)
                * libm::sqrt(f64::from(room.floor_area_m2.clamp(0.0, 80.0)));
            scores.push((score, id as u32));
        }
        if scores.is_empty() {
            scores.push((0.0, 0));
        }
        scores.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        Ok(scores.into_iter().take(AUTO_VIEWS).map(|s| s.1).collect())
    }

    /// All about a point in a room, the longest free way in the middle.
    fn panorama(&self, room: u32) -> Result<ViewRecord> {
        let eye = Vec3::from(self.tables.rooms()[room as usize].inside);
        let (farthest, _) = self.around(eye)?;
        Ok(record(eye, eye + farthest))
    }

    /// A plan of the storey that a room is on, cut where doorways are open still.
    fn storey(&self, room: u32) -> ViewRecord {
        let room = &self.tables.rooms()[room as usize];
        let inside = Vec3::from(room.inside);
        let height = (0.85 * (room.max[2] - room.min[2])).min(CUT_M);
        let eye = inside.with_z(room.min[2] + height);
        let down = record(eye, eye - Vec3::Z);
        ViewRecord { up: [0.0, 1.0, 0.0], fov_degrees: 0.0, ..down }
    }

    /// Width and height of the storey that a plan shows, m, without regard to the picture's shape; moves the plan to its
    /// middle.
    fn shown(&self, record: &mut ViewRecord) -> [f32; 2] {
        let eye = Vec3::from(record.eye);
        let forward = (Vec3::from(record.target) - eye).normalize_or_zero();
        let right = forward.cross(Vec3::from(record.up)).normalize_or_zero();
        let down = forward.cross(right);
        let (mut min, mut max) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for room in self.tables.rooms() {
            let outside = room.flags & LEAF_OUTSIDE != 0;
            if outside || eye.z < room.min[2] || eye.z > room.max[2] {
                continue;
            }
            for corner in 0..8usize {
                let at = |axis: usize| [room.min, room.max][corner >> axis & 1][axis];
                let way = Vec3::new(at(0), at(1), at(2)) - eye;
                for (axis, side) in [right, down].into_iter().enumerate() {
                    min[axis] = min[axis].min(way.dot(side));
                    max[axis] = max[axis].max(way.dot(side));
                }
            }
        }
        if min[0] > max[0] {
            // Above or below everything: as much as an ordinary storey.
            return [32.0, 20.0];
        }
        let middle = right * ((min[0] + max[0]) * 0.5) + down * ((min[1] + max[1]) * 0.5);
        record.eye = (eye + middle).to_array();
        record.target = (eye + middle + forward).to_array();
        // The walls about the rooms, and some paper.
        [max[0] - min[0] + 2.0 * MARGIN_M, max[1] - min[1] + 2.0 * MARGIN_M]
    }

    fn stand_in(&self, room: u32) -> Result<ViewRecord> {
        let eye = Vec3::from(self.tables.rooms()[room as usize].inside);
        let (farthest, _) = self.around(eye)?;
        Ok(record(eye, eye + farthest))
    }

    /// A viewpoint near the end of the longest free line through the room, looking along it.
    fn look_around(&self, room: u32) -> Result<ViewRecord> {
        let inside = Vec3::from(self.tables.rooms()[room as usize].inside);
        let (farthest, free) = self.around(inside)?;
        // Step back from the far end as far as there is room, but not into the wall.
        let heading = farthest.normalize_or_zero();
        let back = free
            .iter()
            .filter(|way| way.normalize_or_zero().dot(heading) < -0.85)
            .map(|way| way.length())
            .fold(0.0f32, f32::max);
        let eye = inside - heading * (back - 0.5).clamp(0.0, 3.5);
        Ok(record(eye, eye + heading * 3.0 - Vec3::Z * 0.35))
    }

    /// Free ways about a point at its height, and the longest.
    fn around(&self, eye: Vec3) -> Result<(Vec3, Vec<Vec3>)> {
        let mut ways = Vec::with_capacity(AROUND);
        for i in 0..AROUND {
            let angle = core::f32::consts::TAU * (i as f32 + 0.5) / AROUND as f32;
            let (sin, cos) = libm::sincosf(angle);
            let direction = Vec3::new(cos, sin, 0.0);
            ways.push(direction * self.free(eye, direction)?.min(30.0));
        }
        let longest = ways
            .iter()
            .copied()
            .fold(Vec3::X * 1e-3, |a, b| if b.length() > a.length() { b } else { a });
        Ok((longest, ways))
    }

    /// Distance to the first surface, or to the opening through which the way leaves the room. Tiles are passed
    /// through: a viewpoint must not depend on them.
    fn free(&self, eye: Vec3, direction: Vec3) -> Result<f32> {
        let mut leaf = self.bsp.locate_towards(eye.as_dvec3(), direction.as_dvec3());
        let room = self.bsp.leaves[leaf as usize].room;
        let mut at = 0.0;
        let mut last = self.last.borrow_mut();
        loop {
            let tile = self.bsp.leaves[leaf as usize].tile;
            let data = match last.take() {
                Some(data) if data.tile == tile => data,
                other => {
                    drop(other);
                    self.reader.load(tile)?
                }
            };
            let data = last.insert(data);
            let structure = data.structure().map_err(store)?;
            let resident = Resident {
                tile,
                bsp: self.bsp,
                structure: &structure,
                materials: self.tables.materials(),
                texturing: Default::default(),
                delta: self.tables.scene.delta,
            };
            let ray = TransitRecord {
                origin: eye.to_array(),
                direction: direction.to_array(),
                leaf,
                t: at,
                last_triangle: enf_layout::NONE,
                ..TransitRecord::default()
            };
            let end = flight::fly(&resident, &ray, f32::INFINITY, |_, _| {});
            match end {
                Flight::Hit { hit, .. } => return Ok(hit.t),
                Flight::Leaves { leaf: next, t } => {
                    if self.bsp.leaves[next as usize].room != room {
                        return Ok(t);
                    }
                    (leaf, at) = (next, t);
                }
                Flight::Escapes { .. } | Flight::Reached => return Ok(0.0),
            }
        }
    }
}

fn store(malformed: enf_layout::sections::Malformed) -> Failure {
    enf_store::StoreError::from(malformed).into()
}

fn record(eye: Vec3, target: Vec3) -> ViewRecord {
    ViewRecord {
        eye: eye.to_array(),
        target: target.to_array(),
        up: [0.0, 0.0, 1.0],
        fov_degrees: FOUND_FOV,
        width: 0,
        height: 0,
    }
}

/// A place in a pixel for sample `index` of `count`: the R2 sequence (Roberts 2018), shifted per pixel.
pub(crate) fn place(index: u32, shift: [f32; 2]) -> (f32, f32) {
    // The plastic number's powers, as 32-bit fractions: exact arithmetic, whatever the index.
    let x = index.wrapping_mul(3_242_174_889);
    let y = index.wrapping_mul(2_447_445_414);
    let fraction = |bits: u32, shift: f32| {
        let v = vector::fraction(bits) + shift;
        if v >= 1.0 { v - 1.0 } else { v }
    };
    (fraction(x, shift[0]), fraction(y, shift[1]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(projection: Projection, fov: f32, target: [f32; 3]) -> Camera {
        let record = ViewRecord {
            eye: [1.0, 2.0, 3.0],
            target,
            up: if projection == Projection::Plan { [0.0, 1.0, 0.0] } else { [0.0, 0.0, 1.0] },
            fov_degrees: fov,
            width: 40,
            height: 20,
        };
        Camera::new(&record, projection).unwrap()
    }

    fn close(a: Vec3, b: Vec3) -> bool {
        (a - b).length() < 1e-5
    }

    #[test]
    fn perspective_spans_its_field_of_view() {
        let camera = camera(Projection::Perspective, 90.0, [1.0, 5.0, 3.0]);
        let corner = 20 * 10 * 2 + 20;
        let (eye, ahead) = camera.ray(corner, 0.0, 0.0);
        assert!(eye == camera.eye && close(ahead, Vec3::Y), "{ahead}");
        // Up by 45 degrees, and twice as far to the left.
        let (_, first) = camera.ray(0, 0.0, 0.0);
        assert!(close(first, Vec3::new(-2.0, 1.0, 1.0).normalize()), "{first}");
    }

    #[test]
    fn a_panorama_is_all_directions_once_and_level() {
        // Looking up does not tilt the horizon.
        let camera = camera(Projection::Panorama, 60.0, [1.0, 5.0, 7.0]);
        let at = |x: u32, y: u32, dx, dy| camera.ray(y * 40 + x, dx, dy).1;
        assert!(close(at(20, 10, 0.0, 0.0), Vec3::Y));
        assert!(close(at(30, 10, 0.0, 0.0), Vec3::X));
        assert!(close(at(10, 10, 0.0, 0.0), -Vec3::X));
        assert!(close(at(0, 10, 0.0, 0.0), -Vec3::Y));
        assert!(close(at(7, 0, 0.3, 0.0), Vec3::Z));
        // Weighted with the solid angle, directions cancel.
        let mut sum = Vec3::ZERO;
        for pixel in 0..800 {
            let latitude = ((pixel / 40) as f32 + 0.5) / 20.0 * core::f32::consts::PI;
            sum += camera.ray(pixel, 0.5, 0.5).1 * latitude.sin();
        }
        assert!(sum.length() < 1e-3, "{sum}");
    }

    #[test]
    fn a_plan_has_north_up_and_parallel_rays() {
        let camera = camera(Projection::Plan, 4.0, [1.0, 2.0, 0.0]);
        let (origin, direction) = camera.ray(0, 0.0, 0.0);
        assert!(close(origin, Vec3::new(1.0 - 4.0, 2.0 + 2.0, 3.0)), "{origin}");
        assert!(close(direction, -Vec3::Z));
        assert_eq!(camera.ray(799, 0.5, 0.5).1, direction);
    }

    #[test]
    fn views_that_cannot_be() {
        let record = |target, fov_degrees| ViewRecord {
            eye: [0.0; 3],
            target,
            up: [0.0, 0.0, 1.0],
            fov_degrees,
            width: 4,
            height: 3,
        };
        for (target, fov, projection) in [
            ([0.0; 3], 60.0, Projection::Perspective),
            ([0.0, 0.0, 1.0], 60.0, Projection::Panorama),
            ([1.0, 0.0, 0.0], 180.0, Projection::Perspective),
            ([1.0, 0.0, 0.0], f32::NAN, Projection::Perspective),
            ([1.0, 0.0, 0.0], 0.0, Projection::Plan),
        ] {
            assert!(Camera::new(&record(target, fov), projection).is_err(), "{target:?} {fov}");
        }
    }
}
