//! Files: Wavefront OBJ for the meshes, one MTL for other programs, and the scene file.
//!
//! Coordinates are written to a hundredth of a millimetre, the same bytes on every machine. Each
//! mesh is a file, however often it stands in the building; where it stands many times, the
//! places are a text file beside it. [`expanded`] writes one OBJ for programs that know no scenes.

use crate::error::BuildingError;
use crate::furnish::Placement;
use crate::mesh::Mesh;
use crate::palette::{self, Kind};
use crate::{Building, Part};
use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

pub mod expanded;

/// More places than these go to a file of their own.
const INLINE: usize = 24;

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

/// The MTL text of all paints of a kind of building, for programs that do not read the scene file.
pub fn mtl(kind: crate::Kind) -> String {
    let mut out = String::from("# linear Rec.709 reflectance\n");
    let polished = if kind == crate::Kind::LShape { &[][..] } else { palette::POLISHED };
    for (name, kind) in palette::PAINTS.iter().chain(polished) {
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
    for (name, kind) in palette::all().filter(|(name, _)| used.contains(name)) {
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
    let mut known = std::collections::BTreeSet::new();
    for lamp in building.plan.rooms.iter().filter_map(|r| r.lamp.as_ref()) {
        let name = panel_name(lamp.lumens, lamp.colour);
        if known.insert(name.clone()) {
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

/// One `[[mesh]]` table of a part: its name, the material of its panels, and its copies.
struct Group<'a> {
    name: String,
    panel: Option<String>,
    copies: Vec<&'a Placement>,
}

impl Group<'_> {
    /// Whether the copies are listed in a file of their own.
    fn apart(&self, building: &Building) -> bool {
        building.request.kind != crate::Kind::LShape && self.copies.len() > INLINE
    }
}

/// The copies of a part by the brightness of its luminaires.
fn groups<'a>(building: &'a Building, part: &'a Part) -> Vec<Group<'a>> {
    let mut groups: Vec<Group<'a>> = Vec::new();
    for copy in &part.copies {
        let panel = panel_of(building, copy);
        match groups.iter_mut().find(|g| g.panel == panel) {
            Some(group) => group.copies.push(copy),
            None => {
                let k = groups.len();
                let name =
                    if k == 0 { part.name.clone() } else { format!("{}-{}", part.name, k + 1) };
                groups.push(Group { name, panel, copies: vec![copy] });
            }
        }
    }
    groups
}

/// The name of the emitting material of a luminaire; `None` for what is none.
fn panel_of(building: &Building, copy: &Placement) -> Option<String> {
    let room = copy.room.filter(|_| copy.is_lamp)?;
    building.plan.rooms[room].lamp.as_ref().map(|l| panel_name(l.lumens, l.colour))
}

/// The `[[mesh]]` tables of a part.
fn mesh_tables(building: &Building, part: &Part, folder: &str, out: &mut String) {
    for group in groups(building, part) {
        let name = &group.name;
        let _ =
            writeln!(out, "\n[[mesh]]\nname = \"{name}\"\nfile = \"{folder}/{}.obj\"", part.name);
        if part.door {
            out.push_str("door = true\n");
        }
        if let Some(panel) = &group.panel {
            let _ = writeln!(out, "materials = {{ {} = \"{panel}\" }}", palette::PANEL);
        }
        if group.apart(building) {
            let _ = writeln!(out, "instances_file = \"{folder}/{name}.txt\"");
            continue;
        }
        let rows: Vec<String> = group
            .copies
            .iter()
            .map(|c| list(&[c.position.x, c.position.y, c.position.z, c.turn, c.scale]))
            .collect();
        let _ = writeln!(out, "instances = [\n  {},\n]", rows.join(",\n  "));
    }
}

/// The text of an instances file: a copy a line.
fn places(group: &Group<'_>) -> String {
    let mut out = String::with_capacity(group.copies.len() * 40 + 64);
    out.push_str("# x y z degrees scale\n");
    for c in &group.copies {
        let p = c.position;
        let row = [p.x, p.y, p.z, c.turn, c.scale].map(number);
        let _ = writeln!(out, "{}", row.join(" "));
    }
    out
}

/// How many files a building is written to.
pub fn files(building: &Building) -> u32 {
    let apart = |p: &Part| groups(building, p).iter().filter(|g| g.apart(building)).count();
    building.parts.iter().map(|p| 1 + apart(p) as u32).sum::<u32>() + 2
}

fn failed(path: &Path, doing: &'static str) -> impl FnOnce(std::io::Error) -> BuildingError {
    let path = path.to_owned();
    move |source| BuildingError::Io { path, doing, source }
}

/// Writes `bytes` aside, syncs and renames.
fn put(path: &Path, bytes: &[u8]) -> Result<(), BuildingError> {
    put_with(path, |file| file.write_all(bytes))
}

/// Writes a file aside, syncs and renames.
fn put_with(
    path: &Path,
    write: impl FnOnce(&mut std::io::BufWriter<&fs::File>) -> std::io::Result<()>,
) -> Result<(), BuildingError> {
    let mut aside = path.as_os_str().to_owned();
    aside.push(".part");
    let aside = PathBuf::from(aside);
    let file = fs::File::create(&aside).map_err(failed(&aside, "creating"))?;
    let mut buffer = std::io::BufWriter::with_capacity(1 << 18, &file);
    let done = write(&mut buffer).and_then(|()| buffer.flush()).and_then(|()| file.sync_all());
    drop(buffer);
    drop(file);
    if let Err(error) = done {
        let _ = fs::remove_file(&aside);
        return Err(failed(&aside, "writing")(error));
    }
    fs::rename(&aside, path).map_err(failed(path, "renaming to"))
}

/// The stem of an output file, if it names one.
fn stem(path: &Path) -> Result<&str, BuildingError> {
    let bad = || BuildingError::Path(path.to_owned());
    let stem = path.file_stem().and_then(|s| s.to_str()).ok_or_else(bad)?;
    if path.is_dir() || stem.contains(['"', '\\', '\n']) {
        return Err(bad());
    }
    Ok(stem)
}

/// Writes the scene file and its meshes, the scene file last.
///
/// # Errors
/// [`BuildingError::Path`] or [`BuildingError::Io`].
pub fn write(building: &Building, scene_toml: &Path) -> Result<(), BuildingError> {
    let folder_name = format!("{}.meshes", stem(scene_toml)?);
    let folder = scene_toml.with_file_name(&folder_name);
    fs::create_dir_all(&folder).map_err(failed(&folder, "creating the folder"))?;
    put(&folder.join("materials.mtl"), mtl(building.request.kind).as_bytes())?;
    for part in &building.parts {
        let path = folder.join(format!("{}.obj", part.name));
        put(&path, obj(&part.name, &part.mesh).as_bytes())?;
        for group in groups(building, part).iter().filter(|g| g.apart(building)) {
            put(&folder.join(format!("{}.txt", group.name)), places(group).as_bytes())?;
        }
    }
    put(scene_toml, scene(building, &folder_name).as_bytes())
}
