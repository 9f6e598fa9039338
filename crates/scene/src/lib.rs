//! A building goes in, triangles come out.
//!
//! In: an OBJ file with its MTL, the same compressed (`.obj.zst`), a glTF file, or a `scene.toml` that places
//! meshes, completes materials and adds lights, cameras and names of rooms (its format is in this
//! crate's README). Out: [`Scene::for_each_triangle`], a stream of world-space `f32` triangles in an
//! order that never changes, with materials ([`Material`]) and lights ([`Scene::lights`]) beside it.
//!
//! What stays in memory is each *different* mesh once and one placement per instance; a thousand
//! chairs are one chair and a thousand short rows of numbers. The world is made again on every pass. Meshes
//! too large for that wait in temporary files ([`Spool`]).
//!
//! ```no_run
//! let scene = enf_scene::load("house.obj.zst".as_ref(), &enf_scene::LoadOptions::default())?;
//! let mut area = 0.0;
//! scene.for_each_triangle(|t| area += f64::from(t.corners[0][2]))?;
//! # Ok::<(), enf_scene::SceneError>(())
//! ```
//!
//! Rules of the stream:
//!
//! - Vertices are read as `f64`, placed, turned z-up, scaled to metres, moved by the scene origin, and
//!   rounded to `f32` once. Zero is never negative. Equal input vertices give equal bits.
//! - The order is: meshes as the scene file lists them, instances as listed, faces as the OBJ has them.
//! - Triangles without area, or with a vertex that is not finite, have no index: they are counted in a
//!   warning. So are doors, when they are to be open.
//! - Front faces are counter-clockwise; a mirroring instance is turned over to keep them so.
//! - An *object* is an OBJ object (`o`; where there is none, a named `g`) of a mesh listed without
//!   `instances`, a glTF node, or one instance. A *light* is an object times an emitting material.

mod doors;
mod error;
mod file;
mod frame;
mod gltf;
mod hints;
mod input;
mod lamps;
mod lights;
mod load;
mod materials;
mod mtl;
mod obj;
pub mod photometry;
mod polygon;
mod shape;
mod sky;
mod stream;
mod texture;
mod views;

pub use error::SceneError;
pub use file::{LUMENS_PER_WATT, luminance, parse_units};
pub use frame::{Frame, Up};
pub use lamps::Profiles;
pub use load::load;
pub use texture::{Texels, Texture};
pub use views::{Camera, DEFAULT_HEIGHT, DEFAULT_WIDTH, Projection, load_views};

use enf_layout::{
    NONE,
    light::{EmitterRecord, LightRecord},
    material::MaterialRecord,
    room::ViewRecord,
    sky::SkyRecord,
};
use std::{collections::BTreeMap, ops::Range, path::PathBuf};

/// What becomes of doors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Doors {
    /// They stay where they are, mostly shut.
    #[default]
    AsModelled,
    /// Objects recognised as doors (by IFC type or name, or `door = true`) are left out.
    Open,
}

/// How to read a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoadOptions {
    /// Metres per unit of the input; overrides the scene file (default: 1).
    pub units: Option<f64>,
    /// Up axis of the input; overrides the scene file (default: z).
    pub up: Option<Up>,
    /// What becomes of doors.
    pub doors: Doors,
    /// Where large meshes go while they are read; `None`: every mesh stays in memory.
    pub spool: Option<Spool>,
    /// Refuse what is otherwise left out or replaced with a warning: faces with fewer than three corners or
    /// with vertices that are not finite, statements that no OBJ has, free-form surfaces, materials and
    /// material libraries that are missing.
    pub strict: bool,
}

/// A place for meshes that are too large for memory.
///
/// Reading, and every pass over the stream, then needs some 7 MiB beside the names of objects and
/// materials, however large the file (while it is read, up to `above` more): vertices and triangles are in temporary files that have no name and
/// vanish with the scene, 24 bytes a vertex and 12 a triangle. Triangles, order, bits and warnings are
/// those of the mesh in memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Spool {
    /// Where the temporary files are made. On a disk: a file system in memory would defeat the purpose.
    pub folder: PathBuf,
    /// Largest mesh, in bytes as [`Scene::resident_bytes`] counts them, that still stays in memory.
    pub above: u64,
}

/// A scene, ready to be streamed.
#[derive(Debug)]
pub struct Scene {
    /// Name: from the scene file, else the file's stem; safe as a file name.
    pub name: String,
    /// Materials in order of first use; index = material id.
    pub materials: Vec<Material>,
    /// Textures; index = texture id, as in the materials' records.
    pub textures: Vec<Texture>,
    /// Cameras, in store coordinates.
    pub views: Vec<View>,
    /// What the scene file calls rooms, in store coordinates.
    pub hints: Vec<RoomHint>,
    /// The sky over the scene, if its file has a `[sky]`.
    pub sky: Option<SkyRecord>,
    /// What was subtracted from the coordinates before they were rounded to `f32`, m: 0, or, when some
    /// coordinate is beyond 4096 m, the bounds' centre in whole metres.
    pub origin: [f64; 3],
    /// Lower and upper corner of all triangles and point lights, store coordinates, m.
    pub bounds: ([f32; 3], [f32; 3]),
    /// The tolerance of every intersection, m: 2^-19 times the next power of two at or above the
    /// largest coordinate and the diagonal of the bounds.
    pub delta: f32,
    /// What the user should know, one sentence each, with file and place.
    pub warnings: Vec<String>,
    /// Every file that was read, in the order of reading.
    pub inputs: Vec<InputFile>,
    geometry: stream::Geometry,
    count: u64,
    skipped: u64,
    /// (object, material) of the lights whose material is a copy: see [`Scene::lights`].
    copies: BTreeMap<(u32, u32), u32>,
    points: Vec<(String, LightRecord)>,
    profiles: Profiles,
    doors: Vec<u32>,
}

/// A file that was read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputFile {
    /// Path as it was opened.
    pub path: PathBuf,
    /// XXH3-128 of its bytes (of the compressed bytes for `.zst`).
    pub hash: u128,
}

/// A material with its name.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name in the MTL or scene file; with an addition where two files mean different things by one
    /// name, or lights of one material need different radiances.
    pub name: String,
    /// What the photons see.
    pub record: MaterialRecord,
}

/// A named camera.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Name; unique, and safe as a file name.
    pub name: String,
    /// What kind of picture.
    pub projection: Projection,
    /// The camera, in store coordinates; of a plan `fov_degrees` is the height of what it shows, m, or 0 for all.
    pub record: ViewRecord,
}

/// A box or an upright prism that the scene's author calls a room, store coordinates, m.
#[derive(Clone, Debug, PartialEq)]
pub struct RoomHint {
    /// Name.
    pub name: String,
    /// Lower corner.
    pub min: [f32; 3],
    /// Upper corner.
    pub max: [f32; 3],
    /// Footprint: corners (x, y), counter-clockwise seen from above, not crossing itself, without the
    /// first one again at the end; `min` and `max` are its bounds and the heights of floor and ceiling.
    /// Empty: the box is the room.
    pub polygon: Vec<[f32; 2]>,
}

/// One triangle of the stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneTriangle {
    /// Global index, ascending from 0 without gaps.
    pub index: u32,
    /// Corners in store coordinates, m, counter-clockwise from the front.
    pub corners: [[f32; 3]; 3],
    /// Material id.
    pub material: u32,
    /// Object id.
    pub object: u32,
    /// Texture coordinates of the corners, as the model has them: where the material has a texture and the model gives
    /// them.
    pub coordinates: Option<[[f32; 2]; 3]>,
}

/// All lights of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lights {
    /// The lights; index = light id. Area lights first (by object, then material), then points.
    pub records: Vec<LightRecord>,
    /// Emitting triangles, light by light, ascending by triangle.
    pub emitters: Vec<EmitterRecord>,
    /// Names, one per light.
    pub names: Vec<String>,
    /// Intensities of luminaires.
    pub profiles: Profiles,
}

impl Scene {
    /// Number of triangles in the stream.
    pub fn triangle_count(&self) -> u64 {
        self.count
    }

    /// Number of triangles in the input that are not in the stream because they have no area after
    /// rounding or a vertex that is not finite (open doors do not count).
    pub fn skipped_triangles(&self) -> u64 {
        self.skipped
    }

    /// Streams all triangles in global order. Keeps nothing: every call makes the world again.
    ///
    /// # Errors
    /// The temporary files of a spooled mesh cannot be read ([`Spool`]); without any there is none.
    pub fn for_each_triangle(&self, f: impl FnMut(SceneTriangle)) -> Result<(), SceneError> {
        self.for_each_triangle_in(0..u32::MAX, f)
    }

    /// Streams the triangles whose index is in the range; work before it is skipped, by instances and by
    /// pieces of 65,536 triangles, so that threads can share a scene.
    ///
    /// # Errors
    /// As [`Scene::for_each_triangle`].
    pub fn for_each_triangle_in(
        &self,
        range: Range<u32>,
        mut f: impl FnMut(SceneTriangle),
    ) -> Result<(), SceneError> {
        self.walk(range, |t| {
            f(t);
            Ok(())
        })
    }

    /// Streams all triangles in global order until `f` fails; returns its error.
    ///
    /// # Errors
    /// What `f` returns, or what [`Scene::for_each_triangle`] does.
    pub fn try_for_each_triangle<E: From<SceneError>>(
        &self,
        f: impl FnMut(SceneTriangle) -> Result<(), E>,
    ) -> Result<(), E> {
        self.walk(0..u32::MAX, f)
    }

    fn walk<E: From<SceneError>>(
        &self,
        range: Range<u32>,
        mut f: impl FnMut(SceneTriangle) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut scratch = stream::Scratch::default();
        let uses = &self.geometry.uses;
        for (u, used) in uses.iter().enumerate() {
            let end = uses.get(u + 1).and_then(|n| n.first.first().copied());
            if used.first.is_empty() || end.is_some_and(|e| e <= range.start) {
                continue;
            }
            let begin = used.first.partition_point(|&first| first <= range.start).max(1) - 1;
            for i in begin..used.first.len() {
                let mut index = used.first[i];
                if index >= range.end {
                    return Ok(());
                }
                // The last mark at or before the range: all that lies before it is skipped.
                let marks = used.marks_of(i);
                let mark = marks.partition_point(|&m| m <= range.start);
                let skip = mark as u32 * stream::MARK_EVERY;
                if mark > 0 {
                    index = marks[mark - 1];
                }
                let mut placed = self.geometry.place(used, i, &mut scratch);
                for run in self.geometry.runs(used, i) {
                    let run = run?;
                    let material = self.material_of(run.object, run.material);
                    let textured = self.materials[material as usize].record.texture != NONE;
                    for t in run.triangles.start.max(skip)..run.triangles.end {
                        let Ok(corners) = placed.corners(t)? else { continue };
                        if index >= range.end {
                            return Ok(());
                        }
                        if index >= range.start {
                            let coordinates = if textured { placed.coordinates(t)? } else { None };
                            let object = run.object;
                            f(SceneTriangle { index, corners, material, object, coordinates })?;
                        }
                        index += 1;
                    }
                }
            }
        }
        Ok(())
    }

    fn material_of(&self, object: u32, material: u32) -> u32 {
        if self.copies.is_empty() {
            return material;
        }
        self.copies.get(&(object, material)).copied().unwrap_or(material)
    }

    /// Number of objects; ids are below it.
    pub fn object_count(&self) -> u32 {
        self.geometry
            .uses
            .last()
            .map_or(0, |u| u.first_object + u.objects(&self.geometry.meshes) as u32)
    }

    /// Name of an object: the OBJ file's, or `mesh/number` for an instance. Objects keep their ids and
    /// names whether doors are open or not.
    pub fn object_name(&self, object: u32) -> String {
        load::object_name(&self.geometry, object)
    }

    /// Objects recognised as doors, ascending; with [`Doors::Open`], those that were left out.
    pub fn door_objects(&self) -> Vec<u32> {
        self.doors.clone()
    }

    /// The scene's lights: each object times each of its emitting materials, then the points.
    ///
    /// The flux of an area light is pi times its area times its material's radiance. Where a scene file
    /// gives the flux of each light, and lights of one material have different areas, they have copies
    /// of the material with a radiance each. Lights without area are left out. May be empty: a scene
    /// without light is the caller's to refuse.
    ///
    /// An emitting face that is in a light twice (the same three corners, the same front, whatever the
    /// vertices are called) emits once.
    ///
    /// # Errors
    /// As [`Scene::for_each_triangle`].
    pub fn lights(&self) -> Result<Lights, SceneError> {
        let emits: Vec<bool> =
            self.materials.iter().map(|m| m.record.emission.iter().any(|&v| v > 0.0)).collect();
        let mut found = Vec::new();
        let mut scratch = stream::Scratch::default();
        for used in &self.geometry.uses {
            if !used.materials.iter().any(|&m| emits[m as usize]) {
                continue;
            }
            let mut add = |object, material, index, corners| {
                let material = self.material_of(object, material);
                if emits[material as usize] {
                    found.push(lights::Emitting { object, material, index, corners });
                }
            };
            for glowing in used.glowing.chunk_by(|a, b| a.instance == b.instance) {
                let mut placed =
                    self.geometry.place(used, glowing[0].instance as usize, &mut scratch);
                for g in glowing {
                    let mut index = g.index;
                    for t in g.begin..g.end {
                        let Ok(corners) = placed.corners(t)? else { continue };
                        add(g.object, g.material, index, corners);
                        index += 1;
                    }
                }
            }
            if self.geometry.is_spooled(used) {
                continue;
            }
            for (i, &first) in used.first.iter().enumerate() {
                let mut index = first;
                let mut placed = self.geometry.place(used, i, &mut scratch);
                for run in self.geometry.runs(used, i) {
                    let run = run?;
                    for t in run.triangles {
                        let Ok(corners) = placed.corners(t)? else { continue };
                        add(run.object, run.material, index, corners);
                        index += 1;
                    }
                }
            }
        }
        let mut lights = lights::gather(found, &self.materials, |object| self.object_name(object));
        for (name, record) in &self.points {
            lights.records.push(*record);
            lights.names.push(name.clone());
        }
        lights.profiles.clone_from(&self.profiles);
        Ok(lights)
    }

    /// Heap bytes that this scene keeps: placements, names, and the meshes that are in memory. A pass over
    /// the stream adds 768 KiB at most, with spooled meshes 4 MiB (and 2 bytes for every 1024 vertices of
    /// the largest).
    pub fn resident_bytes(&self) -> u64 {
        let names: usize = self.materials.iter().map(|m| m.name.capacity()).sum();
        let lists = self.materials.capacity() * size_of::<Material>()
            + self.points.capacity() * size_of::<(String, LightRecord)>()
            + self.views.capacity() * size_of::<View>()
            + self.hints.capacity() * size_of::<RoomHint>()
            + self
                .hints
                .iter()
                .map(|h| h.name.capacity() + h.polygon.capacity() * 8)
                .sum::<usize>()
            + self.profiles.bytes()
            + self.doors.capacity() * 4
            + self.copies.len() * 32;
        let textures: u64 = self.textures.iter().map(Texture::bytes).sum();
        self.geometry.bytes() + (names + lists) as u64 + textures
    }

    /// How the input's coordinates become store coordinates: what [`load_views`] needs.
    pub fn frame(&self) -> Frame {
        self.geometry.frame
    }
}
