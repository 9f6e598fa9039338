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

/// Vertical field of view of a view that gives none, degrees.
const DEFAULT_FOV: f64 = 60.0;
/// Largest picture side, pixels.
const LARGEST_SIDE: u32 = 65_536;

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
        let fov = table.fov.unwrap_or(DEFAULT_FOV);
        if !(0.1..=175.0).contains(&fov) {
            return fail(format!("fov = {fov}"), "fov is vertical, in degrees, from 0.1 to 175");
        }
        for (key, side) in [("width", table.width), ("height", table.height)] {
            if side.is_some_and(|s| s == 0 || s > LARGEST_SIDE) {
                return fail(format!("{key} is out of range"), "give 1 to 65536 pixels");
            }
        }
        let (eye, target) = (frame.point(table.eye), frame.point(table.target));
        let wide = |p: [f32; 3]| DVec3::from_array(p.map(f64::from));
        if !(wide(eye).is_finite() && wide(target).is_finite()) {
            return fail("eye or target is not finite".into(), "give finite coordinates");
        }
        let Some(ahead) = (wide(target) - wide(eye)).try_normalize() else {
            return fail("eye and target are one point".into(), "move one of them");
        };
        let up = match table.up {
            None if ahead.z.abs() < 0.999_999 => [0.0, 0.0, 1.0],
            // Straight up or down: the picture's top is where y points.
            None => [0.0, 1.0, 0.0],
            Some(up) => match frame.direction(up) {
                Some(up) if ahead.cross(wide(up)).length() > 1e-6 => up,
                _ => {
                    return fail(
                        "up is zero or points along the view".into(),
                        "leave it out or give another direction",
                    );
                }
            },
        };
        views.push(View {
            name,
            record: ViewRecord {
                eye,
                target,
                up,
                fov_degrees: fov as f32,
                width: table.width.unwrap_or(0),
                height: table.height.unwrap_or(0),
            },
        });
    }
    Ok(views)
}
