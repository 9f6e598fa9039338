//! Wavefront OBJ: vertices, polygons, objects, groups, material names.
//!
//! A reader of our own, because a building needs what general ones drop: the names of materials that
//! no MTL defines (a scene file may), `o` told apart from `g` (a light is an *object* times a
//! material), line numbers in messages, and a file of any size, zstd or not, read line by line into
//! 24 bytes a vertex and 12 a triangle. (The tests hold it against `tobj`.)
//!
//! Normals, texture coordinates, lines, points, smoothing groups and free-form surfaces are read past.

use crate::{
    InputFile, SceneError,
    doors::is_door,
    input::{Lines, keyword, name, number, words},
    polygon,
};
use glam::DVec3;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// A run of triangles of one object and one material.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Part {
    /// One past its last triangle.
    pub(crate) end: u32,
    /// Object, an index into [`Mesh::objects`].
    pub(crate) object: u32,
    /// Material, an index into [`Mesh::materials`].
    pub(crate) material: u32,
    /// Named like a door.
    pub(crate) door: bool,
}

/// One OBJ file.
#[derive(Debug, Default)]
pub(crate) struct Mesh {
    pub(crate) file: PathBuf,
    pub(crate) positions: Vec<DVec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
    pub(crate) parts: Vec<Part>,
    /// Names of objects; `None`: faces outside every `o` and every named `g`.
    pub(crate) objects: Vec<Option<String>>,
    /// Names of materials; `None`: faces before the first `usemtl`.
    pub(crate) materials: Vec<Option<String>>,
    /// What follows `mtllib`, with the line.
    pub(crate) libraries: Vec<(String, usize)>,
    /// Lower and upper corner of the vertices that faces use and `f32` can hold.
    pub(crate) bounds: Option<(DVec3, DVec3)>,
    pub(crate) warnings: Vec<String>,
}

impl Mesh {
    pub(crate) fn bytes(&self) -> u64 {
        let names: usize =
            self.objects.iter().chain(&self.materials).flatten().map(|n| n.capacity() + 24).sum();
        (self.positions.capacity() * 24
            + self.triangles.capacity() * 12
            + self.parts.capacity() * size_of::<Part>()
            + names) as u64
    }
}

/// Where faces go: which object and material are in force.
#[derive(Default)]
struct State {
    object: Option<u32>,
    object_name: Option<String>,
    group: Option<String>,
    groups: BTreeMap<String, u32>,
    unnamed: Option<u32>,
    material: Option<u32>,
    material_ids: BTreeMap<Option<String>, u32>,
    current_material: Option<String>,
    /// What the next face belongs to, once known.
    part: Option<Part>,
}

impl State {
    fn part(&mut self, mesh: &mut Mesh) -> Part {
        if let Some(part) = self.part {
            return part;
        }
        let add = |objects: &mut Vec<Option<String>>, name: Option<String>| {
            objects.push(name);
            objects.len() as u32 - 1
        };
        let object = match (&self.object_name, &self.group) {
            (Some(o), _) => {
                *self.object.get_or_insert_with(|| add(&mut mesh.objects, Some(o.clone())))
            }
            (None, Some(g)) => *self
                .groups
                .entry(g.clone())
                .or_insert_with(|| add(&mut mesh.objects, Some(g.clone()))),
            (None, None) => *self.unnamed.get_or_insert_with(|| add(&mut mesh.objects, None)),
        };
        let material = *self.material.get_or_insert_with(|| {
            *self.material_ids.entry(self.current_material.clone()).or_insert_with(|| {
                mesh.materials.push(self.current_material.clone());
                mesh.materials.len() as u32 - 1
            })
        });
        let named = |n: &Option<String>| n.as_deref().is_some_and(is_door);
        let door = if self.object_name.is_none() && self.group.is_none() {
            named(&self.current_material)
        } else {
            named(&self.object_name) || named(&self.group)
        };
        *self.part.insert(Part { end: 0, object, material, door })
    }
}

/// Reads an OBJ file.
pub(crate) fn read(path: &Path) -> Result<(Mesh, InputFile), SceneError> {
    let mut lines = Lines::open(path)?;
    let mut mesh = Mesh { file: path.into(), ..Mesh::default() };
    let mut state = State::default();
    let mut corners: Vec<u32> = Vec::new();
    let mut points: Vec<DVec3> = Vec::new();
    let mut cut: Vec<[usize; 3]> = Vec::new();
    // Largest vertex number asked for, and where.
    let mut largest = (0u32, 0usize);
    let (mut not_finite, mut free_form, mut thin_faces, mut huge_faces) = (0u64, 0u64, 0u64, 0u64);
    let (mut first_not_finite, mut first_thin) = (0, 0);
    while lines.advance()? {
        let Some((key, rest)) = keyword(lines.text()) else { continue };
        match key {
            b"v" => {
                let mut xyz = words(rest).map(number);
                let (Some(Some(x)), Some(Some(y)), Some(Some(z))) =
                    (xyz.next(), xyz.next(), xyz.next())
                else {
                    return Err(lines.error(
                        format!("a vertex needs three numbers, not \"{}\"", excerpt(rest)),
                        "correct the line or export the model again",
                    ));
                };
                let p = DVec3::new(x, y, z);
                if !fits(p) {
                    not_finite += 1;
                    if not_finite == 1 {
                        first_not_finite = lines.number();
                    }
                }
                if mesh.positions.len() >= i32::MAX as usize {
                    return Err(lines.error(
                        "more than 2^31 vertices in one file",
                        "split the model into several files and list them in a scene file",
                    ));
                }
                mesh.positions.push(p);
            }
            b"f" => {
                corners.clear();
                for word in words(rest) {
                    let digits = word.split(|&b| b == b'/').next().unwrap_or(word);
                    let index =
                        std::str::from_utf8(digits).ok().and_then(|t| t.parse::<i64>().ok());
                    let count = mesh.positions.len() as i64;
                    let vertex = match index {
                        Some(i) if i > 0 && i <= i64::from(i32::MAX) => i - 1,
                        Some(i) if i < 0 && count + i >= 0 => count + i,
                        Some(i) => {
                            return Err(lines.error(
                                format!(
                                    "a face uses vertex {i}, but {count} vertices stand before it"
                                ),
                                "vertices count from 1 (or back from -1): export the model again",
                            ));
                        }
                        None => {
                            return Err(lines.error(
                                format!("\"{}\" is no vertex of a face", excerpt(word)),
                                "faces are written as f v1 v2 v3, v1/t1, v1//n1 or v1/t1/n1",
                            ));
                        }
                    } as u32;
                    if vertex >= largest.0 {
                        largest = (vertex, lines.number());
                    }
                    corners.push(vertex);
                }
                if corners.len() < 3 {
                    thin_faces += 1;
                    if thin_faces == 1 {
                        first_thin = lines.number();
                    }
                    continue;
                }
                cut.clear();
                if corners.len() == 3 {
                    cut.push([0, 1, 2]);
                } else {
                    points.clear();
                    let known = |&c: &u32| mesh.positions.get(c as usize).copied();
                    points.extend(corners.iter().map(|c| known(c).unwrap_or(DVec3::NAN)));
                    huge_faces += u64::from(corners.len() > polygon::EAR_LIMIT);
                    polygon::triangulate(&points, &mut cut);
                }
                if mesh.triangles.len() + cut.len() >= i32::MAX as usize {
                    return Err(lines.error(
                        "more than 2^31 triangles in one file",
                        "split the model into several files and list them in a scene file",
                    ));
                }
                mesh.triangles.extend(cut.iter().map(|t| t.map(|i| corners[i])));
                let mut part = state.part(&mut mesh);
                part.end = mesh.triangles.len() as u32;
                match mesh.parts.last_mut() {
                    Some(last) if Part { end: part.end, ..*last } == part => last.end = part.end,
                    _ => mesh.parts.push(part),
                }
            }
            b"o" => {
                state.part = None;
                state.object = None;
                state.object_name = (!rest.is_empty()).then(|| name(rest));
            }
            b"g" => {
                state.part = None;
                // "g default" is what Maya writes for "no group".
                state.group =
                    (!rest.is_empty() && rest != b"default" && rest != b"off").then(|| name(rest));
            }
            b"usemtl" => {
                state.part = None;
                state.material = None;
                state.current_material = (!rest.is_empty()).then(|| name(rest));
            }
            b"mtllib" if !rest.is_empty() => {
                let library = name(rest);
                if !mesh.libraries.iter().any(|l| l.0 == library) {
                    mesh.libraries.push((library, lines.number()));
                }
            }
            b"curv" | b"curv2" | b"surf" => free_form += 1,
            _ => {}
        }
    }
    if largest.1 > 0 && largest.0 as usize >= mesh.positions.len() {
        return Err(SceneError::line(
            path,
            largest.1,
            format!(
                "a face uses vertex {}, but the file has {}",
                u64::from(largest.0) + 1,
                mesh.positions.len()
            ),
            "the file is cut short or damaged: export the model again",
        ));
    }
    let file = path.display();
    if not_finite > 0 {
        mesh.warnings.push(format!(
            "{file}:{first_not_finite}: {not_finite} vertices are not finite (first here); their \
             triangles are left out"
        ));
    }
    if free_form > 0 {
        mesh.warnings.push(format!(
            "{file}: {free_form} free-form curves or surfaces are left out; export polygons"
        ));
    }
    if thin_faces > 0 {
        mesh.warnings.push(format!(
            "{file}:{first_thin}: {thin_faces} faces with fewer than three corners are left out \
             (first here)"
        ));
    }
    if huge_faces > 0 {
        mesh.warnings.push(format!(
            "{file}: {huge_faces} polygons with more than {} corners are cut as if they were convex",
            polygon::EAR_LIMIT
        ));
    }
    mesh.positions.shrink_to_fit();
    mesh.triangles.shrink_to_fit();
    mesh.parts.shrink_to_fit();
    for p in mesh.triangles.iter().flatten().map(|&v| mesh.positions[v as usize]) {
        if fits(p) {
            let (lo, hi) = mesh.bounds.get_or_insert((p, p));
            *lo = lo.min(p);
            *hi = hi.max(p);
        }
    }
    Ok((mesh, lines.finish()?))
}

/// Finite, and within the range of `f32`.
fn fits(p: DVec3) -> bool {
    p.abs().max_element() <= f64::from(f32::MAX) && p.is_finite()
}

/// The first characters of some bytes, fit for a message.
pub(crate) fn excerpt(bytes: &[u8]) -> String {
    let text: String = String::from_utf8_lossy(bytes)
        .chars()
        .map(|c| if c.is_control() { '\u{fffd}' } else { c })
        .take(41)
        .collect();
    if text.chars().count() > 40 { text.chars().take(40).chain(['…']).collect() } else { text }
}
