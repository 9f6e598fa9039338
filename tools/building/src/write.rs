//! Files: Wavefront OBJ for the meshes, one MTL for other programs, and the scene file.
//!
//! Coordinates are written to a hundredth of a millimetre, the same bytes on every machine.

use crate::error::BuildingError;
use crate::mesh::Mesh;
use crate::palette::{self, Kind};
use crate::{Building, Part};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

/// `value` to five decimals without trailing zeros, never `-0`.
fn number(value: f64) -> String {
    let text = format!("{value:.5}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

fn list(values: &[f64]) -> String {
    let inner: Vec<_> = values.iter().map(|&v| number(v)).collect();
    format!("[{}]", inner.join(", "))
}

/// The OBJ text of a mesh. `name` is the object of what has none.
pub fn obj(name: &str, mesh: &Mesh) -> String {
    let mut out = String::with_capacity(mesh.points.len() * 28 + mesh.triangles.len() * 20);
    out.push_str("# metres, z up\nmtllib materials.mtl\n");
    for p in &mesh.points {
        let _ = writeln!(out, "v {} {} {}", number(p.x), number(p.y), number(p.z));
    }
    let (mut object, mut paint) = (None, "");
    for t in &mesh.triangles {
        if object != Some(t.object) {
            let label = mesh.objects.get(t.object as usize).map_or(name, String::as_str);
            let _ = writeln!(out, "o {label}");
            object = Some(t.object);
            paint = "";
        }
        if paint != t.paint {
            paint = t.paint;
            let _ = writeln!(out, "usemtl {paint}");
        }
        let [a, b, c] = t.corners.map(|c| c + 1);
        let _ = writeln!(out, "f {a} {b} {c}");
    }
    out
}

/// The MTL text of all paints, for programs that do not read the scene file.
pub fn mtl() -> String {
    let mut out = String::from("# linear Rec.709 reflectance\n");
    for (name, kind) in palette::PAINTS {
        let triple = |c: &[f64; 3]| c.map(number).join(" ");
        let _ = writeln!(out, "newmtl {name}");
        let _ = match kind {
            Kind::Matt(c) => writeln!(out, "Kd {}\nillum 1", triple(c)),
            Kind::Mirror(c) => writeln!(out, "Kd 0 0 0\nKs {}\nillum 3", triple(c)),
            Kind::Glass(c, ni) => {
                writeln!(out, "Kd 0 0 0\nTf {}\nd 0.1\nNi {}\nillum 4", triple(c), number(*ni))
            }
            Kind::Gloss(c, ks) => {
                writeln!(out, "Kd {}\nKs {}\nNs 60\nillum 2", triple(c), triple(ks))
            }
        };
    }
    let _ = writeln!(out, "newmtl {}\nKd 0.78 0.78 0.77\nKe 6 5.5 4.8\nillum 1", palette::PANEL);
    out
}

/// The scene file's text; `folder` is where the meshes are, relative to the scene file.
pub fn scene(building: &Building, folder: &str) -> String {
    let request = &building.request;
    let mut out = String::new();
    let _ = writeln!(
        out,
        "# enfilade building {} --floors {} --seed {}\n\nname = \"{}\"\nunits = \"m\"\nup = \"z\"",
        request.kind.name(),
        building.plan.storeys,
        request.seed,
        building.plan.name,
    );
    for view in &building.plan.views {
        let _ = writeln!(
            out,
            "\n[[view]]\nname = \"{}\"\neye = {}\ntarget = {}\nfov = {}\nwidth = {}\nheight = {}",
            view.name,
            list(&view.eye.to_array()),
            list(&view.target.to_array()),
            number(view.fov),
            view.size.0,
            view.size.1
        );
    }
    let used: std::collections::BTreeSet<_> =
        building.parts.iter().flat_map(|p| p.mesh.triangles.iter().map(|t| t.paint)).collect();
    for (name, kind) in palette::PAINTS.iter().filter(|(name, _)| used.contains(name)) {
        let _ = writeln!(out, "\n[[material]]\nname = \"{name}\"");
        let _ = match kind {
            Kind::Matt(c) => writeln!(out, "kd = {}", list(c)),
            Kind::Mirror(c) => writeln!(out, "mirror = {}", list(c)),
            Kind::Glass(c, ni) => {
                writeln!(out, "glass = true\ntf = {}\nni = {}", list(c), number(*ni))
            }
            Kind::Gloss(c, ks) => writeln!(out, "kd = {}\nks = {}", list(c), list(ks)),
        };
    }
    // One emitting material per brightness and colour.
    let mut panels: Vec<(String, f64, [f64; 3])> = Vec::new();
    for lamp in building.plan.rooms.iter().filter_map(|r| r.lamp.as_ref()) {
        let name = panel_name(lamp.lumens, lamp.colour);
        if panels.iter().all(|(other, ..)| *other != name) {
            panels.push((name, lamp.lumens, lamp.colour));
        }
    }
    for (name, lumens, colour) in &panels {
        let _ = writeln!(
            out,
            "\n[[material]]\nname = \"{name}\"\nkd = [0.78, 0.78, 0.77]\nlumens = {}\ncolor = {}",
            number(*lumens),
            list(colour)
        );
    }
    for part in &building.parts {
        mesh_tables(building, part, folder, &mut out);
    }
    out
}

/// The name of the emitting material of a lamp.
fn panel_name(lumens: f64, colour: [f64; 3]) -> String {
    let warm = if colour[2] < 0.75 { "warm" } else { "neutral" };
    format!("panel.{}.{warm}", number(lumens))
}

/// One `[[mesh]]` table per part, or per brightness of a luminaire.
fn mesh_tables(building: &Building, part: &Part, folder: &str, out: &mut String) {
    let mut groups: Vec<(Option<String>, Vec<String>)> = Vec::new();
    for copy in &part.copies {
        let panel = copy.room.filter(|_| copy.is_lamp).and_then(|room| {
            building.plan.rooms[room].lamp.as_ref().map(|l| panel_name(l.lumens, l.colour))
        });
        let p = copy.position;
        let row = list(&[p.x, p.y, p.z, copy.turn, copy.scale]);
        match groups.iter_mut().find(|(key, _)| *key == panel) {
            Some((_, rows)) => rows.push(row),
            None => groups.push((panel, vec![row])),
        }
    }
    for (k, (panel, rows)) in groups.iter().enumerate() {
        let name = if k == 0 { part.name.clone() } else { format!("{}-{}", part.name, k + 1) };
        let _ =
            writeln!(out, "\n[[mesh]]\nname = \"{name}\"\nfile = \"{folder}/{}.obj\"", part.name);
        if part.door {
            out.push_str("door = true\n");
        }
        if let Some(panel) = panel {
            let _ = writeln!(out, "materials = {{ {} = \"{panel}\" }}", palette::PANEL);
        }
        let _ = writeln!(out, "instances = [\n  {},\n]", rows.join(",\n  "));
    }
}

fn failed(path: &Path, doing: &'static str) -> impl FnOnce(std::io::Error) -> BuildingError {
    let path = path.to_owned();
    move |source| BuildingError::Io { path, doing, source }
}

/// Writes `bytes` aside, syncs and renames.
fn put(path: &Path, bytes: &[u8]) -> Result<(), BuildingError> {
    use std::io::Write as _;
    let mut aside = path.as_os_str().to_owned();
    aside.push(".part");
    let aside = PathBuf::from(aside);
    let mut file = fs::File::create(&aside).map_err(failed(&aside, "creating"))?;
    let done = file.write_all(bytes).and_then(|()| file.sync_all());
    drop(file);
    if let Err(error) = done {
        let _ = fs::remove_file(&aside);
        return Err(failed(&aside, "writing")(error));
    }
    fs::rename(&aside, path).map_err(failed(path, "renaming to"))
}

/// Writes the scene file and its meshes, the scene file last.
///
/// # Errors
/// [`BuildingError::Path`] or [`BuildingError::Io`].
pub fn write(building: &Building, scene_toml: &Path) -> Result<(), BuildingError> {
    let bad = || BuildingError::Path(scene_toml.to_owned());
    let stem = scene_toml.file_stem().and_then(|s| s.to_str()).ok_or_else(bad)?;
    if scene_toml.is_dir() || stem.contains(['"', '\\', '\n']) {
        return Err(bad());
    }
    let folder_name = format!("{stem}.meshes");
    let folder = scene_toml.with_file_name(&folder_name);
    fs::create_dir_all(&folder).map_err(failed(&folder, "creating the folder"))?;
    put(&folder.join("materials.mtl"), mtl().as_bytes())?;
    for part in &building.parts {
        let path = folder.join(format!("{}.obj", part.name));
        put(&path, obj(&part.name, &part.mesh).as_bytes())?;
    }
    put(scene_toml, scene(building, &folder_name).as_bytes())
}
