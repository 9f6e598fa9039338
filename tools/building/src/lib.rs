//! Buildings to order: walls, doors, lamps, and far too many chairs.
//!
//! [`generate`] writes a scene file and its meshes; [`design()`] makes the same building in memory.
//! The buildings follow Tables 1 to 3 of Fradin, Meneveaux and Horna 2005, *Out-of-Core
//! Photon-Mapping for Large Buildings*. Nobody's furniture was copied; all of it is turned, cut
//! and upholstered here, from a seed.
//!
//! | kind | floors | rooms | lights | triangles |
//! |---|---|---|---|---|
//! | [`lshape`] | 2 | 27 | 24 | 0.34 million |
//! | [`zbuilding`] | 1 | 22 | 15 | 1.07 million |
//! | [`octagon`] | 3 | 232 | 155 | 5.2 million |
//! | [`tower`] | 100 | 17,800 | 61,000 | 1.07 billion |
//!
//! The L-shape is furnished by hand, on one plan with boxes for rooms. The others are storeys with
//! walls at any angle, drawn once and stacked, furnished by an automatic process; however tall,
//! each mesh is there once and has a place on every floor.
//!
//! | module | question |
//! |---|---|
//! | [`mesh`] | how is a cushion made? |
//! | [`palette`] | what colour is it? |
//! | [`plan`], [`lshape`] | where is the door? |
//! | [`shell`], [`joinery`] | how does the wall around it stand up? |
//! | [`outline`], [`storey`], [`zbuilding`], [`octagon`], [`tower`] | and if walls are not square, and floors many? |
//! | [`carcass`], [`fittings`], [`assemble`] | how do such walls stand up, on each other? |
//! | [`lamps`] | who turned on the light? |
//! | [`furniture`], [`furnish`] | who put the chair there? |
//! | [`mod@write`] | what is in the files? |

pub mod assemble;
pub mod carcass;
pub mod error;
pub mod fittings;
pub mod furnish;
pub mod furniture;
pub mod joinery;
pub mod lamps;
pub mod lshape;
pub mod mesh;
pub mod octagon;
pub mod outline;
pub mod palette;
pub mod plan;
pub mod rng;
pub mod shell;
pub mod storey;
pub mod tower;
pub mod write;
pub mod zbuilding;

pub use error::BuildingError;

use furnish::Placement;
use mesh::Mesh;
use plan::Plan;
use std::path::Path;

/// The kinds of buildings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Kind {
    /// Two wings around a corner, corridors on each floor, one stairwell.
    LShape,
    /// Two bars joined by a spine, one floor.
    ZBuilding,
    /// Rings of rooms around a hall, three floors, walls at 45 degrees.
    Octagon,
    /// A slab of a hundred floors with 178 rooms each.
    Tower,
}

impl Kind {
    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::LShape => "l-shape",
            Self::ZBuilding => "z-building",
            Self::Octagon => "octagon",
            Self::Tower => "tower",
        }
    }

    /// Every kind.
    pub const ALL: &'static [Self] = &[Self::LShape, Self::ZBuilding, Self::Octagon, Self::Tower];

    /// The most floors that it can have.
    pub fn most_floors(self) -> u32 {
        match self {
            Self::LShape | Self::Octagon => 100,
            Self::ZBuilding | Self::Tower => 200,
        }
    }

    /// The floors that it has unless the request says otherwise.
    pub fn floors(self) -> u32 {
        match self {
            Self::LShape => 2,
            Self::ZBuilding => 1,
            Self::Octagon => 3,
            Self::Tower => 100,
        }
    }
}

impl std::str::FromStr for Kind {
    type Err = BuildingError;

    fn from_str(name: &str) -> Result<Self, BuildingError> {
        Self::ALL
            .iter()
            .copied()
            .find(|k| k.name() == name)
            .ok_or_else(|| BuildingError::Kind(name.to_owned()))
    }
}

/// An order for a building.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// What to build.
    pub kind: Kind,
    /// Number of floors; [`Kind::floors`] when absent.
    pub floors: Option<u32>,
    /// Varies how the furniture stands and which books are on the shelves.
    pub seed: u64,
}

/// What was built.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Summary {
    /// Triangles of the whole scene, instances expanded.
    pub triangles: u64,
    /// Rooms of the plan, the stairwell being one; the outside is not counted.
    pub rooms: u32,
    /// Luminaires.
    pub lights: u32,
    /// Files written.
    pub files: u32,
    /// Names of the views.
    pub views: Vec<String>,
}

/// One mesh file of a building and where its copies stand.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Name of the file without folder and extension, unique.
    pub name: String,
    /// Its triangles.
    pub mesh: Mesh,
    /// Whether it is a door leaf, which `--doors open` leaves out.
    pub door: bool,
    /// Copies with the room that each stands in and, for luminaires, the lumens.
    pub copies: Vec<Placement>,
}

/// A finished building, not yet on disk.
#[derive(Clone, Debug, PartialEq)]
pub struct Building {
    /// The order it was made to.
    pub request: Request,
    /// The drawing.
    pub plan: Plan,
    /// All geometry.
    pub parts: Vec<Part>,
}

impl Building {
    /// Triangles with all copies.
    pub fn triangles(&self) -> u64 {
        self.parts.iter().map(|p| (p.mesh.triangles.len() * p.copies.len()) as u64).sum()
    }

    /// Calls `f(part, copy, corners)` for every triangle in world space.
    pub fn for_each_triangle(&self, mut f: impl FnMut(usize, usize, [glam::DVec3; 3])) {
        for (p, part) in self.parts.iter().enumerate() {
            for (c, copy) in part.copies.iter().enumerate() {
                for t in 0..part.mesh.triangles.len() {
                    f(p, c, part.mesh.corners(t).map(|q| copy.apply(q)));
                }
            }
        }
    }

    /// Triangles by room, in the order of the plan; the last entry is the outside. What stands in a
    /// room is the room's; walls and windows count where they face.
    pub fn triangles_by_room(&self) -> Vec<u64> {
        let rooms = &self.plan.rooms;
        let mut counts = vec![0u64; rooms.len() + 1];
        for part in &self.parts {
            for copy in &part.copies {
                if let Some(room) = copy.room {
                    counts[room] += part.mesh.triangles.len() as u64;
                    continue;
                }
                // Only rooms at the part's height come into question.
                let (low, high) = part.mesh.bounds();
                let (low, high) = (copy.apply(low).z - 0.1, copy.apply(high).z + 0.1);
                let near: Vec<usize> = (0..rooms.len())
                    .filter(|&r| {
                        let top = rooms[r].shafts.last().map_or(rooms[r].height.1, |s| s.2);
                        rooms[r].height.0 < high && top > low
                    })
                    .collect();
                let at = |p: glam::DVec3| near.iter().copied().find(|&r| rooms[r].holds(p, 0.0));
                for t in 0..part.mesh.triangles.len() {
                    let [a, b, c] = part.mesh.corners(t).map(|q| copy.apply(q));
                    let middle = (a + b + c) / 3.0;
                    let n = (b - a).cross(c - a).normalize_or_zero() * 0.01;
                    let room = at(middle).or_else(|| at(middle + n)).or_else(|| at(middle - n));
                    counts[room.unwrap_or(rooms.len())] += 1;
                }
            }
        }
        counts
    }

    /// What [`generate`] reports.
    pub fn summary(&self) -> Summary {
        Summary {
            triangles: self.triangles(),
            rooms: self.plan.rooms.len() as u32,
            lights: self.plan.rooms.iter().filter_map(|r| r.lamp.as_ref()).map(|l| l.count).sum(),
            files: write::files(self),
            views: self.plan.views.iter().map(|v| v.name.clone()).collect(),
        }
    }
}

/// Designs the building of `request` in memory. The same request gives the same bits everywhere.
///
/// # Errors
/// [`BuildingError::Floors`] when the kind cannot have so many floors.
pub fn design(request: &Request) -> Result<Building, BuildingError> {
    let floors = request.floors.unwrap_or(request.kind.floors());
    let most = request.kind.most_floors();
    if floors == 0 || floors > most {
        return Err(BuildingError::Floors { kind: request.kind.name(), floors, most });
    }
    let plan = match request.kind {
        Kind::LShape => lshape::plan(floors),
        Kind::ZBuilding => return Ok(assemble::build(request, &zbuilding::drawing(), floors)),
        Kind::Octagon => return Ok(assemble::build(request, &octagon::drawing(), floors)),
        Kind::Tower => return Ok(assemble::build(request, &tower::drawing(), floors)),
    };
    let mut parts = vec![Part::fixed("shell", shell::build(&plan))];
    parts.extend(joinery::build(&plan));
    parts.extend(lamps::build(&plan));
    parts.extend(furnish::build(&plan, request.seed));
    Ok(Building { request: *request, plan, parts })
}

impl Part {
    /// A mesh that is modelled in place and stands once.
    pub fn fixed(name: &str, mesh: Mesh) -> Self {
        Self { name: name.to_owned(), mesh, door: false, copies: vec![Placement::default()] }
    }
}

/// What a building is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// A scene file that places meshes.
    Scene,
    /// One OBJ with its MTL: everything in world space.
    Obj,
}

/// Writes the building of `request` as the scene file `scene_toml`, with its meshes in a folder
/// beside it: `scene.toml` and `scene.meshes/*.obj`.
///
/// Every file is written aside and renamed, the scene file last: a scene file that exists is
/// complete.
///
/// # Errors
/// [`BuildingError::Floors`] for an impossible number of floors, [`BuildingError::Path`] when
/// `scene_toml` names no file, [`BuildingError::Io`] when something cannot be written.
pub fn generate(request: &Request, scene_toml: &Path) -> Result<Summary, BuildingError> {
    let building = design(request)?;
    write::write(&building, scene_toml)?;
    Ok(building.summary())
}
