//! Where pictures are taken from: the scene's views, a file's, a room's, or viewpoints found by looking around.

use std::cell::RefCell;

use enf_layout::bsp::LEAF_OUTSIDE;
use enf_layout::room::ViewRecord;
use enf_layout::segment::ExtentKind;
use enf_layout::transit::TransitRecord;
use enf_rooms::Bsp;
use enf_scene::{Frame, Up};
use enf_stage::resident::{TileData, TileReader};
use enf_stage::tables::Tables;
use enf_stage::{Failure, Result};
use enf_store::StageReader;
use enf_transport::flight::{self, Flight, Resident};
use enf_transport::vector;
use glam::Vec3;

use crate::RenderArgs;

/// Picture size when neither the view nor a flag says one.
pub(crate) const DEFAULT_WIDTH: u32 = 960;
/// See [`DEFAULT_WIDTH`].
pub(crate) const DEFAULT_HEIGHT: u32 = 600;
/// Vertical field of view of viewpoints that were found, degrees.
const FOUND_FOV: f32 = 58.0;
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

/// A pinhole camera.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    /// Eye, m.
    pub eye: Vec3,
    forward: Vec3,
    /// Half the picture's width and height at distance 1.
    right: Vec3,
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
    pub fn new(record: &ViewRecord) -> std::result::Result<Self, &'static str> {
        let (eye, target) = (Vec3::from(record.eye), Vec3::from(record.target));
        let forward = (target - eye).normalize_or_zero();
        let right = forward.cross(Vec3::from(record.up)).normalize_or_zero();
        if forward == Vec3::ZERO {
            return Err("eye and target are the same point");
        }
        if right == Vec3::ZERO {
            return Err("the view looks straight along its up direction; give another up");
        }
        if !(record.fov_degrees > 0.0 && record.fov_degrees < 180.0) {
            return Err("the field of view is not between 0 and 180 degrees");
        }
        let half = libm::tanf(record.fov_degrees.to_radians() * 0.5);
        let aspect = record.width as f32 / record.height as f32;
        Ok(Self {
            eye,
            forward,
            right: right * (half * aspect),
            down: forward.cross(right) * half,
            width: record.width,
            height: record.height,
        })
    }

    /// Unit direction through a pixel at a place in it, both from `[0, 1)`.
    pub fn direction(&self, pixel: u32, dx: f32, dy: f32) -> Vec3 {
        let (x, y) = (pixel % self.width, pixel / self.width);
        let u = (x as f32 + dx) / self.width as f32 * 2.0 - 1.0;
        let v = (y as f32 + dy) / self.height as f32 * 2.0 - 1.0;
        (self.forward + self.right * u + self.down * v).normalize()
    }

    /// Pixels of the picture.
    pub fn pixels(&self) -> u32 {
        self.width * self.height
    }
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
    let mut found: Vec<(String, ViewRecord)> = Vec::new();
    let mut known: Vec<(String, ViewRecord)> =
        tables.names.views.iter().cloned().zip(tables.views().iter().copied()).collect();
    if let Some(path) = &args.views {
        let frame = Frame {
            units: tables.names.units,
            up: if tables.names.y_up { Up::Y } else { Up::Z },
            origin: tables.scene.origin,
        };
        let file =
            enf_scene::load_views(path, &frame).map_err(|e| Failure::input(e.to_string()))?;
        let file: Vec<_> = file.into_iter().map(|v| (v.name, v.record)).collect();
        if args.view.is_empty() {
            found.extend(file.iter().cloned());
        }
        known.extend(file);
    }
    let auto = ["auto".to_string()];
    let wanted: &[String] =
        if args.view.is_empty() && args.views.is_none() { &auto } else { &args.view };
    for name in wanted {
        if name == "auto" {
            for room in finder.telling_rooms(maps)? {
                found.push((format!("room-{room}"), finder.look_around(room)?));
            }
        } else if name == "all" {
            found.extend(known.iter().cloned());
        } else if let Some(room) = name.strip_prefix("room:") {
            let room = room.parse().ok().filter(|&r: &u32| (r as usize) < tables.rooms().len());
            let room = room.ok_or_else(|| {
                Failure::usage(format!(
                    "--view {name}: the store has rooms 0 to {}",
                    tables.rooms().len() - 1
                ))
            })?;
            found.push((format!("room-{room}"), finder.stand_in(room)?));
        } else if let Some(view) = known.iter().find(|v| &v.0 == name) {
            found.push(view.clone());
        } else {
            let names: Vec<&str> = known.iter().map(|v| v.0.as_str()).collect();
            return Err(Failure::usage(format!("there is no view {name}")).with_hint(format!(
                "views of this scene: {}; also auto, all and room:ID",
                if names.is_empty() { "none".into() } else { names.join(", ") }
            )));
        }
    }
    if found.is_empty() {
        return Err(Failure::usage("no view to render").with_hint("--view auto finds three"));
    }
    let mut views: Vec<View> = Vec::new();
    for (name, mut record) in found {
        record.width =
            args.width.unwrap_or(if record.width > 0 { record.width } else { DEFAULT_WIDTH });
        record.height =
            args.height.unwrap_or(if record.height > 0 { record.height } else { DEFAULT_HEIGHT });
        let camera =
            Camera::new(&record).map_err(|e| Failure::input(format!("view {name}: {e}")))?;
        if !views.iter().any(|v| v.name == name) {
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
