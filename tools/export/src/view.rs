//! Views as both renderers want them: which, and how large.

use enf_layout::room::ViewRecord;
use enf_scene::{DEFAULT_HEIGHT, DEFAULT_WIDTH, Projection, View};
use enf_stage::{Failure, Result};

/// The views that are asked for by name, or all; with sizes.
///
/// # Errors
/// Exit 2 for a name that no view has.
pub fn chosen(
    all: &[View],
    names: &[String],
    width: Option<u32>,
    height: Option<u32>,
) -> Result<Vec<View>> {
    let mut views = Vec::new();
    for name in names.iter().filter(|n| *n != "all") {
        let Some(view) = all.iter().find(|v| &v.name == name) else {
            let known: Vec<&str> = all.iter().map(|v| v.name.as_str()).collect();
            let known = if known.is_empty() { "none".into() } else { known.join(", ") };
            return Err(Failure::usage(format!("there is no view {name}"))
                .with_hint(format!("views of this scene: {known}; or all")));
        };
        views.push(view.clone());
    }
    if names.is_empty() || names.iter().any(|n| n == "all") {
        views = all.to_vec();
    }
    for view in &mut views {
        let ViewRecord { width: w, height: h, .. } = view.record;
        view.record.width = width.unwrap_or(if w > 0 { w } else { DEFAULT_WIDTH });
        view.record.height = height.unwrap_or(if h > 0 { h } else { DEFAULT_HEIGHT });
    }
    Ok(views)
}

/// What a view shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Shown {
    /// Vertical field of view, degrees.
    Perspective(f32),
    /// Width and height, m.
    Plan([f32; 2]),
}

/// What a view shows; or why no other renderer can be told so.
pub(crate) fn shown(view: &View) -> std::result::Result<Shown, &'static str> {
    let record = &view.record;
    match view.projection {
        Projection::Perspective => Ok(Shown::Perspective(record.fov_degrees)),
        Projection::Plan if record.fov_degrees > 0.0 => {
            let height = record.fov_degrees;
            Ok(Shown::Plan([height * record.width as f32 / record.height as f32, height]))
        }
        Projection::Plan => Err("left out: a plan of a whole storey; give it a size"),
        Projection::Panorama => Err("left out: there is no panorama"),
    }
}
