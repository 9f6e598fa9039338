//! Scenes: OBJ, MTL and scene.toml in, a stream of world-space triangles out.

mod error;

pub use error::SceneError;

use enf_layout::{
    light::{EmitterRecord, LightRecord},
    material::MaterialRecord,
    room::ViewRecord,
};
use std::path::{Path, PathBuf};

/// Which axis of the input points up. The store's is always z.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Up {
    /// y points up, as in most modelling programs: `(x, y, z)` becomes `(x, -z, y)`.
    Y,
    /// z points up, as in CAD and BIM.
    #[default]
    Z,
}

/// What becomes of doors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Doors {
    /// They stay where they are, mostly shut.
    #[default]
    AsModelled,
    /// Objects recognised as doors are left out.
    Open,
}

/// How to read a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LoadOptions {
    /// Metres per unit of the input; overrides the scene file (default: metres).
    pub units: Option<f64>,
    /// Up axis of the input; overrides the scene file (default: z).
    pub up: Option<Up>,
    /// What becomes of doors.
    pub doors: Doors,
}

/// How the input's coordinates become the store's: `rotate(up) * units * p - origin`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Metres per unit of the input.
    pub units: f64,
    /// Up axis of the input.
    pub up: Up,
    /// Subtracted last, m.
    pub origin: [f64; 3],
}

/// A scene, ready to be streamed.
#[derive(Debug)]
pub struct Scene {
    /// Name: from the scene file, else the file's stem.
    pub name: String,
    /// Materials; index = material id.
    pub materials: Vec<Material>,
    /// Cameras, in store coordinates.
    pub views: Vec<View>,
    /// Boxes that the scene file calls rooms, in store coordinates.
    pub hints: Vec<RoomHint>,
    /// What was subtracted from the coordinates before they were rounded to `f32`, m.
    pub origin: [f64; 3],
    /// Lower and upper corner of all triangles and point lights, store coordinates, m.
    pub bounds: ([f32; 3], [f32; 3]),
    /// The tolerance of every intersection, m.
    pub delta: f32,
    /// What the user should know; one sentence each.
    pub warnings: Vec<String>,
    /// Every file that was read.
    pub inputs: Vec<InputFile>,
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
    /// Name in the MTL or scene file.
    pub name: String,
    /// What the photons see.
    pub record: MaterialRecord,
}

/// A named camera.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Name; safe as a file name.
    pub name: String,
    /// The camera, in store coordinates.
    pub record: ViewRecord,
}

/// A box that the scene's author calls a room, store coordinates, m.
#[derive(Clone, Debug, PartialEq)]
pub struct RoomHint {
    /// Name.
    pub name: String,
    /// Lower corner.
    pub min: [f32; 3],
    /// Upper corner.
    pub max: [f32; 3],
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
}

/// All lights of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lights {
    /// The lights; index = light id.
    pub records: Vec<LightRecord>,
    /// Emitting triangles, light by light.
    pub emitters: Vec<EmitterRecord>,
    /// Names, one per light.
    pub names: Vec<String>,
}

/// Reads a scene.
pub fn load(path: &Path, _options: &LoadOptions) -> Result<Scene, SceneError> {
    Err(SceneError::whole(path, "is not read yet", "wait"))
}

/// Reads a file of `[[view]]` tables.
pub fn load_views(path: &Path, _frame: &Frame) -> Result<Vec<View>, SceneError> {
    Err(SceneError::whole(path, "is not read yet", "wait"))
}

impl Scene {
    /// Number of triangles in the stream.
    pub fn triangle_count(&self) -> u64 {
        0
    }

    /// Streams the triangles in global order.
    pub fn for_each_triangle(&self, _f: impl FnMut(SceneTriangle)) {}

    /// Streams the triangles in global order until `f` fails.
    pub fn try_for_each_triangle<E>(
        &self,
        _f: impl FnMut(SceneTriangle) -> Result<(), E>,
    ) -> Result<(), E> {
        Ok(())
    }

    /// Name of an object.
    pub fn object_name(&self, object: u32) -> String {
        object.to_string()
    }

    /// Objects recognised as doors, ascending.
    pub fn door_objects(&self) -> Vec<u32> {
        Vec::new()
    }

    /// The scene's lights.
    pub fn lights(&self) -> Lights {
        Lights::default()
    }

    /// Heap bytes that this scene keeps.
    pub fn resident_bytes(&self) -> u64 {
        0
    }

    /// How input coordinates become store coordinates.
    pub fn frame(&self) -> Frame {
        Frame { units: 1.0, up: Up::Z, origin: self.origin }
    }
}
