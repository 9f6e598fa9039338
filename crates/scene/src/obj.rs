//! Wavefront OBJ: vertices, polygons, objects, groups, material names.
//!
//! A reader of our own, because a building needs what general ones drop: the names of materials that
//! no MTL defines (a scene file may), `o` told apart from `g` (a light is an *object* times a
//! material), line numbers in messages, and a file of any size, zstd or not, read line by line into
//! 24 bytes a vertex and 12 a triangle, in memory or in temporary files ([`crate::Spool`]). (The tests
//! hold it against `tobj`.)
//!
//! Texture coordinates are kept where a material library has a texture. Normals (which side is the front is a matter of
//! the corners' order), lines, points, smoothing groups and free-form surfaces are read past.

use crate::{
    InputFile, LoadOptions, SceneError,
    doors::is_door,
    input::{Lines, keyword, leading_corner, leading_number, name, words},
    load::find_libraries,
    mtl, polygon,
    shape::{Builder, Part, Shape},
};
use glam::DVec3;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// One model file: OBJ, or what a glTF file holds.
#[derive(Debug, Default)]
pub(crate) struct Mesh {
    pub(crate) file: PathBuf,
    pub(crate) shape: Shape,
    /// Names of objects; `None`: faces outside every `o` and every named `g`.
    pub(crate) objects: Vec<Option<String>>,
    /// Names of materials; `None`: faces before the first `usemtl`.
    pub(crate) materials: Vec<Option<String>>,
    /// What follows `mtllib`, with the line.
    pub(crate) libraries: Vec<(String, usize)>,
    /// A box round all vertices that `f32` can hold, used or not.
    pub(crate) bounds: Option<(DVec3, DVec3)>,
    /// Vertices that are not finite: number and line of the first few.
    pub(crate) not_finite: Vec<(u32, usize)>,
    pub(crate) warnings: Vec<String>,
}

/// How many vertices that are not finite are remembered.
const REMEMBERED: usize = 4096;

impl Mesh {
    /// Heap bytes, the names of objects and materials included.
    pub(crate) fn bytes(&self) -> u64 {
        let names = |list: &Vec<Option<String>>| {
            list.capacity() * size_of::<Option<String>>()
                + list.iter().flatten().map(|n| n.capacity()).sum::<usize>()
        };
        let rest = self.not_finite.capacity() * size_of::<(u32, usize)>();
        self.shape.bytes() + (names(&self.objects) + names(&self.materials) + rest) as u64
    }

    /// Lets a vertex into the bounds.
    pub(crate) fn note(&mut self, p: DVec3) {
        let (lo, hi) = self.bounds.get_or_insert((p, p));
        *lo = lo.min(p);
        *hi = hi.max(p);
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

/// The statements of the OBJ specification that are read past.
const READ_PAST: [&[u8]; 36] = [
    b"vt",
    b"vn",
    b"vp",
    b"s",
    b"l",
    b"p",
    b"mg",
    b"cstype",
    b"deg",
    b"bmat",
    b"step",
    b"parm",
    b"trim",
    b"hole",
    b"scrv",
    b"sp",
    b"end",
    b"con",
    b"bevel",
    b"c_interp",
    b"d_interp",
    b"lod",
    b"maplib",
    b"usemap",
    b"shadow_obj",
    b"trace_obj",
    b"ctech",
    b"stech",
    b"call",
    b"csh",
    b"bsp",
    b"bzp",
    b"cdc",
    b"cdp",
    b"res",
    b"vw",
];

/// Counts something, and remembers the line of the first.
#[derive(Clone, Copy, Default)]
struct Seen {
    count: u64,
    first: usize,
}

impl Seen {
    fn at(&mut self, line: usize) {
        if self.count == 0 {
            self.first = line;
        }
        self.count += 1;
    }
}

/// Reads an OBJ file, into temporary files if `options.spool` says so.
pub(crate) fn read(path: &Path, options: &LoadOptions) -> Result<(Mesh, InputFile), SceneError> {
    let mut lines = Lines::open(path)?;
    let mut mesh = Mesh { file: path.into(), ..Mesh::default() };
    let mut shape = Builder::new(options.spool.as_ref());
    let mut state = State::default();
    let mut corners: Vec<u32> = Vec::new();
    // Texture coordinates, once a library with textures was named; NaN for those before.
    let mut pictures = false;
    let mut coordinates = Builder::new(options.spool.as_ref());
    let mut coordinate_count = 0u32;
    let mut at: Vec<[f32; 2]> = Vec::new();
    let mut points: Vec<DVec3> = Vec::new();
    let mut cut: Vec<[usize; 3]> = Vec::new();
    // Largest vertex number asked for, and where.
    let mut largest = (0u32, 0usize);
    let mut vertices = 0u32;
    let (mut not_finite, mut free_form) = (Seen::default(), Seen::default());
    let (mut thin, mut huge, mut unknown) = (Seen::default(), Seen::default(), Seen::default());
    while lines.advance()? {
        let Some((key, rest)) = keyword(lines.text()) else { continue };
        match key {
            b"v" => {
                let Some(p) = position(rest) else {
                    return Err(lines.error(
                        format!("a vertex needs three numbers, not \"{}\"", excerpt(rest)),
                        "correct the line or export the model again",
                    ));
                };
                if fits(p) {
                    mesh.note(p);
                } else {
                    not_finite.at(lines.number());
                    if mesh.not_finite.len() < REMEMBERED {
                        mesh.not_finite.push((vertices, lines.number()));
                    }
                }
                if vertices >= i32::MAX as u32 {
                    return Err(lines.error(
                        "more than 2^31 vertices in one file",
                        "split the model into several files and list them in a scene file",
                    ));
                }
                shape.push_vertex(p.to_array())?;
                vertices += 1;
            }
            b"f" => {
                corners.clear();
                at.clear();
                let mut text = rest;
                while !text.is_empty() {
                    let (word, (index, after)) = (text, corner(text));
                    text = after;
                    let count = i64::from(vertices);
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
                            let word = words(word).next().unwrap_or_default();
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
                    if pictures {
                        let said = &word[..word.len() - text.len()];
                        let number = texture_index(said, coordinate_count);
                        let place = match number {
                            Some(number) => coordinates.position(number)?,
                            None => None,
                        };
                        at.push(place.map_or([f32::NAN; 2], |[u, v, _]| [u as f32, v as f32]));
                    }
                }
                if corners.len() < 3 {
                    if options.strict {
                        return Err(lines.error(
                            "a face with fewer than three corners",
                            "remove the line, or do without --strict",
                        ));
                    }
                    thin.at(lines.number());
                    continue;
                }
                let triangles = corners.len() as u64 - 2;
                if shape.triangles() + triangles >= i32::MAX as u64 {
                    return Err(lines.error(
                        "more than 2^31 triangles in one file",
                        "split the model into several files and list them in a scene file",
                    ));
                }
                let part = state.part(&mut mesh);
                if let [a, b, c] = corners[..] {
                    shape.push_triangle([a, b, c], part)?;
                    if let [a, b, c] = at[..] {
                        textured(&mut shape, [a, b, c])?;
                    }
                    continue;
                }
                points.clear();
                for &c in &corners {
                    let p = shape.position(c)?.unwrap_or([f64::NAN; 3]);
                    points.push(DVec3::from_array(p));
                }
                if corners.len() > polygon::EAR_LIMIT {
                    huge.at(lines.number());
                }
                cut.clear();
                polygon::triangulate(&points, &mut cut);
                for t in &cut {
                    shape.push_triangle(t.map(|i| corners[i]), part)?;
                    if pictures {
                        textured(&mut shape, t.map(|i| at[i]))?;
                    }
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
                if !pictures && has_pictures(path, &library) {
                    pictures = true;
                    for _ in 0..coordinate_count {
                        coordinates.push_vertex([f64::NAN; 3])?;
                    }
                }
                if !mesh.libraries.iter().any(|l| l.0 == library) {
                    mesh.libraries.push((library, lines.number()));
                }
            }
            b"vt" => {
                coordinate_count = coordinate_count.saturating_add(1);
                if pictures {
                    let (u, rest) = leading_number(rest).unwrap_or((f64::NAN, b""));
                    let v = leading_number(rest).map_or(0.0, |v| v.0);
                    coordinates.push_vertex([u, v, 0.0])?;
                }
            }
            b"vn" | b"s" | b"mtllib" => {}
            b"curv" | b"curv2" | b"surf" => {
                if options.strict {
                    return Err(lines.error(
                        "a free-form curve or surface",
                        "export polygons, or do without --strict",
                    ));
                }
                free_form.at(lines.number());
            }
            other if READ_PAST.contains(&other) => {}
            other => {
                if options.strict {
                    return Err(lines.error(
                        format!("\"{}\" is no statement of an OBJ file", excerpt(other)),
                        "remove the line, or do without --strict",
                    ));
                }
                unknown.at(lines.number());
            }
        }
    }
    if largest.1 > 0 && largest.0 >= vertices {
        return Err(SceneError::line(
            path,
            largest.1,
            format!("a face uses vertex {}, but the file has {vertices}", u64::from(largest.0) + 1),
            "the file is cut short or damaged: export the model again",
        ));
    }
    let file = path.display();
    let mut warn = |seen: Seen, what: &dyn Fn(u64) -> String| {
        if seen.count > 0 {
            mesh.warnings.push(format!("{file}:{}: {}", seen.first, what(seen.count)));
        }
    };
    warn(not_finite, &|n| {
        format!("{n} vertices are not finite (first here); their triangles are left out")
    });
    warn(free_form, &|n| {
        format!("{n} free-form curves or surfaces are left out (first here); export polygons")
    });
    warn(thin, &|n| format!("{n} faces with fewer than three corners are left out (first here)"));
    warn(huge, &|n| {
        format!(
            "{n} polygons with more than {} corners are cut as if they were convex (first here)",
            polygon::EAR_LIMIT
        )
    });
    warn(unknown, &|n| format!("{n} lines are no statement of an OBJ file (first here)"));
    mesh.shape = shape.finish()?;
    mesh.objects.shrink_to_fit();
    mesh.not_finite.shrink_to_fit();
    Ok((mesh, lines.finish()?))
}

/// Whether a material library has textures. One that cannot be read is somebody else's to complain about.
fn has_pictures(obj: &Path, library: &str) -> bool {
    find_libraries(obj, library).iter().any(|at| {
        mtl::read(at).is_ok_and(|(specs, _)| specs.values().any(|spec| spec.map_kd.is_some()))
    })
}

/// Keeps the texture coordinates of the triangle that was pushed last, if they are numbers.
fn textured(shape: &mut Builder, corners: [[f32; 2]; 3]) -> Result<(), SceneError> {
    if corners.iter().flatten().all(|c| c.is_finite()) {
        shape.push_coordinates(corners)?;
    }
    Ok(())
}

/// The number of the texture coordinates (from 0) in `v/vt` or `v/vt/vn`, when so many stand before it.
fn texture_index(corner: &[u8], count: u32) -> Option<u32> {
    let word = corner.split(|&b| b == b'/').nth(1)?;
    let index = std::str::from_utf8(word).ok()?.trim().parse::<i64>().ok()?;
    let index = if index < 0 { i64::from(count) + index } else { index - 1 };
    u32::try_from(index).ok().filter(|&i| i < count)
}

/// The place that a `v` line gives.
fn position(rest: &[u8]) -> Option<DVec3> {
    let (x, rest) = leading_number(rest)?;
    let (y, rest) = leading_number(rest)?;
    let (z, _) = leading_number(rest)?;
    Some(DVec3::new(x, y, z))
}

/// The vertex number of the next corner of a face, and the text after it.
fn corner(text: &[u8]) -> (Option<i64>, &[u8]) {
    if let Some((index, rest)) = leading_corner(text) {
        return (Some(index), rest);
    }
    let end = text.iter().position(u8::is_ascii_whitespace).unwrap_or(text.len());
    let word = &text[..end];
    let digits = word.split(|&b| b == b'/').next().unwrap_or(word);
    let index = std::str::from_utf8(digits).ok().and_then(|t| t.parse::<i64>().ok());
    (index, text[end..].trim_ascii_start())
}

/// Finite, and within the range of `f32`.
pub(crate) fn fits(p: DVec3) -> bool {
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
