//! One OBJ with everything in world space, for programs that know no scene files.
//!
//! The triangles are those of the scene file: each corner is the mesh file's, placed as its
//! instance says, to a hundredth of a millimetre. Each instance is an object `NAME/K`; meshes
//! that stand once and name their objects keep those names. Panels have the radiance that gives
//! their luminaire its lumens.

use super::{groups, number, palette, put_with, stem};
use crate::error::BuildingError;
use crate::fittings::panel_area;
use crate::furnish::Placement;
use crate::{Building, Part};
use glam::DVec3;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;

/// The most triangles that are written to one OBJ.
pub const MOST: u64 = 20_000_000;

/// Lumens per watt of the scalar flux.
const LUMENS_PER_WATT: f64 = 179.0;

/// An emitting material: radiance in W/m2/sr by name.
type Panels = BTreeMap<String, [f64; 3]>;

/// The first line of the OBJ: the command that made it.
pub fn title(building: &Building) -> String {
    let r = &building.request;
    format!(
        "# enfilade building {} --floors {} --seed {} --format obj\n",
        r.kind.name(),
        building.plan.storeys,
        r.seed
    )
}

/// Writes the building as `path` with its materials beside it, the OBJ last.
///
/// # Errors
/// [`BuildingError::Large`], [`BuildingError::Path`] or [`BuildingError::Io`].
pub fn write(building: &Building, path: &Path) -> Result<(), BuildingError> {
    let triangles = building.triangles();
    if triangles > MOST {
        return Err(BuildingError::Large { triangles, most: MOST });
    }
    let name = format!("{}.mtl", stem(path)?);
    let panels = panels(building);
    put_with(&path.with_file_name(&name), |out| {
        out.write_all(super::mtl(building.request.kind).as_bytes())?;
        for (panel, ke) in &panels {
            writeln!(
                out,
                "newmtl {panel}\nKd 0.78 0.78 0.77\nKe {}\nillum 1",
                ke.map(number).join(" ")
            )?;
        }
        Ok(())
    })?;
    put_with(path, |out| {
        write!(out, "{}# metres, z up\nmtllib {name}\n", title(building))?;
        let mut first = 1;
        for part in &building.parts {
            body(building, part, &mut first, out)?;
        }
        Ok(())
    })
}

/// The emitting material of a copy of a part.
fn panel(building: &Building, part: &Part, copy: &Placement) -> Option<String> {
    super::panel_of(building, copy).map(|name| format!("{name}.{}", part.name))
}

fn panels(building: &Building) -> Panels {
    let mut out = Panels::new();
    for part in &building.parts {
        let area = panel_area(&part.mesh);
        for copy in part.copies.iter().filter(|c| c.is_lamp) {
            let (Some(name), Some(room)) = (panel(building, part, copy), copy.room) else {
                continue;
            };
            if let Some(lamp) = &building.plan.rooms[room].lamp {
                let c = lamp.colour;
                let y = 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
                let area = area * copy.scale * copy.scale;
                let scale = lamp.lumens / (LUMENS_PER_WATT * std::f64::consts::PI * area * y);
                out.insert(name, c.map(|c| c * scale));
            }
        }
    }
    out
}

/// A coordinate as the mesh files have it.
fn filed(p: DVec3) -> DVec3 {
    let digits = |c: f64| libm::round(c * 1e5) / 1e5;
    DVec3::new(digits(p.x), digits(p.y), digits(p.z))
}

fn body(building: &Building, part: &Part, first: &mut u64, out: &mut impl Write) -> io::Result<()> {
    for group in groups(building, part) {
        for (k, copy) in group.copies.iter().enumerate() {
            for &p in &part.mesh.points {
                let q = copy.apply(filed(p));
                writeln!(out, "v {} {} {}", number(q.x), number(q.y), number(q.z))?;
            }
            let glow = panel(building, part, copy);
            let (mut object, mut paint) = (None, "");
            for t in &part.mesh.triangles {
                if object != Some(t.object) {
                    match part.mesh.objects.get(t.object as usize) {
                        Some(label) if part.copies.len() == 1 => writeln!(out, "o {label}")?,
                        _ if object.is_none() => writeln!(out, "o {}/{k}", group.name)?,
                        _ => {}
                    }
                    object = Some(t.object);
                    paint = "";
                }
                if paint != t.paint {
                    paint = t.paint;
                    let name = glow.as_deref().filter(|_| paint == palette::PANEL);
                    writeln!(out, "usemtl {}", name.unwrap_or(paint))?;
                }
                let [a, b, c] = t.corners.map(|c| u64::from(c) + *first);
                writeln!(out, "f {a} {b} {c}")?;
            }
            *first += part.mesh.points.len() as u64;
        }
    }
    Ok(())
}
