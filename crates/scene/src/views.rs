//! Cameras of scene and view files, checked and put into store coordinates.

use crate::{
    Frame, SceneError, View,
    file::{self, Parsed, ViewTable, ViewsFile},
    gltf,
};
use enf_layout::room::ViewRecord;
use glam::DVec3;
use std::path::Path;
use toml::Spanned;

/// Picture width, pixels, where neither the view nor a flag says one.
pub const DEFAULT_WIDTH: u32 = 960;
/// Picture height, pixels, likewise.
pub const DEFAULT_HEIGHT: u32 = 600;

/// Vertical field of view of a view that gives none, degrees.
const DEFAULT_FOV: f64 = 60.0;
/// Largest picture side, pixels.
const LARGEST_SIDE: u32 = 65_536;

/// What kind of picture a view is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Projection {
    /// As a camera sees.
    #[default]
    Perspective,
    /// Everything about a point: longitude across, latitude down, what is looked at in the middle.
    Panorama,
    /// Parallel rays from a plane: a storey, its ceiling cut away.
    Plan,
}

impl Projection {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Perspective, Self::Panorama, Self::Plan];

    /// What scene files, flags and stores call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Perspective => "perspective",
            Self::Panorama => "panorama",
            Self::Plan => "plan",
        }
    }

    /// The one of that name.
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|p| p.name() == name)
    }
}

/// A camera as scene files, view files and flags describe it, in the input's coordinates.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Camera {
    /// What kind of picture.
    pub projection: Projection,
    /// Where it is taken from. Of a plan: the middle of the picture, at the height of the cut.
    pub eye: [f64; 3],
    /// What is looked at; a panorama looks along y without, a plan down.
    pub target: Option<[f64; 3]>,
    /// What points up in the picture; the vertical without, of plans y.
    pub up: Option<[f64; 3]>,
    /// Vertical field of view, degrees; 60 without. For perspective only.
    pub fov: Option<f64>,
    /// Height of what a plan shows, units of the input; all of the building without.
    pub size: Option<f64>,
    /// Picture width, pixels.
    pub width: Option<u32>,
    /// Picture height, pixels.
    pub height: Option<u32>,
}

impl Camera {
    /// The camera in store coordinates.
    ///
    /// # Errors
    /// What is wrong with it, and what to do.
    pub fn record(&self, frame: &Frame) -> Result<ViewRecord, (String, &'static str)> {
        let fail = |what: &str, remedy| Err((what.to_string(), remedy));
        let plan = self.projection == Projection::Plan;
        if self.fov.is_some() && self.projection != Projection::Perspective {
            return fail("fov is for perspective", "leave it out; a plan has a size");
        }
        if self.size.is_some() && !plan {
            return fail("size is for plans", "leave it out; perspective has fov");
        }
        let fov = self.fov.unwrap_or(DEFAULT_FOV);
        if !(0.1..=175.0).contains(&fov) {
            let what = format!("fov = {fov}");
            return fail(&what, "fov is vertical, in degrees, from 0.1 to 175");
        }
        let size = self.size.unwrap_or(0.0) * frame.units;
        if self.size.is_some() && !(size > 0.0 && (size as f32).is_finite()) {
            return fail("size is no length", "give the height of what the plan shows, above 0");
        }
        for (key, side) in [("width", self.width), ("height", self.height)] {
            if side.is_some_and(|s| s == 0 || s > LARGEST_SIDE) {
                return fail(&format!("{key} is out of range"), "give 1 to 65536 pixels");
            }
        }
        let wide = |p: [f32; 3]| DVec3::from_array(p.map(f64::from));
        let eye = frame.point(self.eye);
        let target = match (self.target, self.projection) {
            (Some(target), _) => frame.point(target),
            (None, Projection::Plan) => [eye[0], eye[1], eye[2] - 1.0],
            (None, Projection::Panorama) => [eye[0], eye[1] + 1.0, eye[2]],
            (None, Projection::Perspective) => {
                return fail("it has no target", "give the point that it looks at");
            }
        };
        if !(wide(eye).is_finite() && wide(target).is_finite()) {
            return fail("eye or target is not finite", "give finite coordinates");
        }
        let Some(ahead) = (wide(target) - wide(eye)).try_normalize() else {
            return fail("eye and target are one point", "move one of them");
        };
        // A panorama has a level horizon: straight up or down it looks nowhere in particular, and begins where y points.
        let straight = self.up.is_none() && ahead.z.abs() >= 0.999_999;
        let (target, ahead) = match straight && self.projection == Projection::Panorama {
            true => ([eye[0], eye[1] + 1.0, eye[2]], DVec3::Y),
            false => (target, ahead),
        };
        let up = match self.up {
            None if ahead.z.abs() < 0.999_999 => [0.0, 0.0, 1.0],
            // Straight up or down: the picture's top is where y points.
            None => [0.0, 1.0, 0.0],
            Some(up) => match frame.direction(up) {
                Some(up) if ahead.cross(wide(up)).length() > 1e-6 => up,
                _ => {
                    return fail(
                        "up is zero or points along the view",
                        "leave it out or give another direction",
                    );
                }
            },
        };
        Ok(ViewRecord {
            eye,
            target,
            up,
            fov_degrees: if plan { size as f32 } else { fov as f32 },
            width: self.width.unwrap_or(0),
            height: self.height.unwrap_or(0),
        })
    }
}

/// Reads a file of `[[view]]` tables, the same as in a scene file, whose coordinates are those of the
/// scene's input: `frame` is [`crate::Scene::frame`] of the scene that they look at.
///
/// Errors: the file is missing or no TOML, has another key, names a view twice, or a view looks
/// nowhere.
pub fn load_views(path: &Path, frame: &Frame) -> Result<Vec<View>, SceneError> {
    let (parsed, _) = file::parse::<ViewsFile>(path)?;
    let views = build(&parsed, &parsed.value.view, frame)?;
    if views.is_empty() {
        return Err(SceneError::whole(path, "no [[view]] in it", "add one, or use --view auto"));
    }
    Ok(views)
}

/// Adds a camera of a glTF file, under a name that is free and fit for a file.
pub(crate) fn add_camera(views: &mut Vec<View>, camera: &gltf::Camera, frame: &Frame) {
    let eye = frame.point(camera.eye.to_array());
    let ahead = DVec3::from_array(frame.up.turn(camera.ahead.to_array()));
    let target = DVec3::from_array(eye.map(f64::from)) + ahead;
    let Some(up) = frame.direction(camera.up.to_array()) else { return };
    if eye.iter().any(|v| !v.is_finite()) {
        return;
    }
    let plain: String = camera
        .name
        .chars()
        .map(|c| if file::name_problem(&format!("a{c}")).is_some() { '_' } else { c })
        .take(60)
        .collect();
    let plain = if file::name_problem(&plain).is_some() { "camera".to_string() } else { plain };
    let mut name = plain.clone();
    let mut number = 2;
    while views.iter().any(|v| v.name == name) {
        name = format!("{plain}-{number}");
        number += 1;
    }
    views.push(View {
        name,
        projection: Projection::Perspective,
        record: ViewRecord {
            eye,
            target: target.to_array().map(|v| v as f32),
            up,
            fov_degrees: camera.fov as f32,
            width: 0,
            height: 0,
        },
    });
}

pub(crate) fn build<T>(
    parsed: &Parsed<T>,
    tables: &[Spanned<ViewTable>],
    frame: &Frame,
) -> Result<Vec<View>, SceneError> {
    let mut views: Vec<View> = Vec::with_capacity(tables.len());
    for (i, at) in tables.iter().enumerate() {
        let table = at.get_ref();
        let name = table.name.clone().unwrap_or_else(|| format!("view-{}", i + 1));
        let fail = |what: String, remedy: &str| {
            Err(parsed.error(at, format!("view \"{name}\": {what}"), remedy))
        };
        if let Some(problem) = file::name_problem(&name) {
            return fail(problem, "pictures are named after their view: use letters and digits");
        }
        if views.iter().any(|v| v.name == name) {
            return fail("the name is taken".into(), "give every view its own name");
        }
        let projection = match &table.kind {
            None => Projection::Perspective,
            Some(kind) => match Projection::of(kind) {
                Some(projection) => projection,
                None => {
                    return fail(
                        format!("kind = \"{kind}\""),
                        "kinds are perspective, panorama and plan",
                    );
                }
            },
        };
        let camera = Camera {
            projection,
            eye: table.eye,
            target: table.target,
            up: table.up,
            fov: table.fov,
            size: table.size,
            width: table.width,
            height: table.height,
        };
        match camera.record(frame) {
            Ok(record) => views.push(View { name, projection, record }),
            Err((what, remedy)) => return fail(what, remedy),
        }
    }
    Ok(views)
}
