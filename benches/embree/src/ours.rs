//! Our side: every call of `enf-geometry` is in this file.

use std::borrow::Cow;

use clap::ValueEnum;
use enf_geometry::{Malformed, NONE, Ray, Structure, StructureKind, TileMesh};
use glam::Vec3;

use crate::scene::{Room, Scene};
use crate::walk::{Flight, Landing};

pub use enf_geometry::{Hit, Instructions, Query};

/// Structures to choose from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    /// The wide hierarchy
    Bvh,
    /// The uniform grid
    Grid,
}

impl Kind {
    /// What to call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bvh => "bvh",
            Self::Grid => "grid",
        }
    }

    /// The instructions that it can be asked by, besides the best.
    pub fn lesser(self) -> Vec<Instructions> {
        let mut all = available();
        all.pop();
        if self == Self::Bvh { all } else { Vec::new() }
    }

    fn structure(self) -> StructureKind {
        match self {
            Self::Bvh => StructureKind::Bvh,
            Self::Grid => StructureKind::Grid,
        }
    }

    /// Builds the structure of a tile for tolerance `delta` (m), ready to be asked.
    pub fn build(self, tile: &Tile<'_>, delta: f32) -> Result<Vec<u8>, Malformed> {
        let mut blob = self.structure().build(&tile.mesh(), delta);
        self.structure().complete(&mut blob, &tile.mesh())?;
        Ok(blob)
    }
}

/// The instructions of this machine, the best last.
pub fn available() -> Vec<Instructions> {
    Instructions::ALL.into_iter().filter(|instructions| instructions.available()).collect()
}

/// What to call them.
pub fn name_of(instructions: Instructions) -> &'static str {
    match instructions {
        Instructions::Portable => "portable",
        Instructions::Avx2 => "AVX2",
        Instructions::Avx512 => "AVX-512",
    }
}

/// A flight, as we are asked about it.
pub fn query(flight: &Flight) -> Query {
    let ray = Ray { origin: flight.from, direction: flight.direction };
    Query { ray, t_min: 0.0, t_max: flight.far, exclude: flight.left }
}

/// A flight, exactly as Embree is asked about it.
pub fn query_as_embree(flight: &Flight) -> Query {
    let ray = Ray { origin: flight.lifted, direction: flight.direction };
    Query { ray, t_min: 0.0, t_max: flight.far, exclude: NONE }
}

/// A mesh as we hold it.
#[derive(Debug)]
pub struct Tile<'s> {
    vertices: Cow<'s, [[f32; 3]]>,
    triangles: Cow<'s, [[u32; 3]]>,
    global: Vec<u32>,
    materials: Vec<u32>,
}

impl<'s> Tile<'s> {
    /// The whole scene, in place.
    pub fn whole(scene: &'s Scene) -> Self {
        let count = scene.triangles.len();
        Self {
            vertices: scene.vertices.list().into(),
            triangles: scene.triangles.as_slice().into(),
            global: (0..count as u32).collect(),
            materials: vec![0; count],
        }
    }

    /// One room, with vertices of its own.
    pub fn room(scene: &'s Scene, room: &Room) -> Self {
        let vertices = scene.vertices.list();
        let mut local = vec![NONE; vertices.len()];
        let mut own = Vec::new();
        let range = room.triangles.start as usize..room.triangles.end as usize;
        let triangles: Vec<[u32; 3]> = scene.triangles[range]
            .iter()
            .map(|corners| {
                corners.map(|v| {
                    let slot = &mut local[v as usize];
                    if *slot == NONE {
                        *slot = own.len() as u32;
                        own.push(vertices[v as usize]);
                    }
                    *slot
                })
            })
            .collect();
        let materials = vec![0; triangles.len()];
        let global = room.triangles.clone().collect();
        Self { vertices: own.into(), triangles: triangles.into(), global, materials }
    }

    /// What the structure is built over.
    pub fn mesh(&self) -> TileMesh<'_> {
        TileMesh {
            vertices: &self.vertices,
            triangles: &self.triangles,
            global: &self.global,
            materials: &self.materials,
        }
    }

    /// Bytes of vertices and vertex indices.
    pub fn mesh_bytes(&self) -> usize {
        12 * (self.vertices.len() + self.triangles.len())
    }

    /// What stays in memory beside a structure while rays are traced: nothing where it has triangles, global indices and
    /// materials of its own.
    pub fn kept_bytes(&self, kind: Kind) -> usize {
        match kind {
            Kind::Bvh => 0,
            Kind::Grid => self.mesh_bytes() + 4 * (self.global.len() + self.materials.len()),
        }
    }
}

/// A structure, ready to be asked.
pub struct Ours<'a> {
    structure: Structure<'a>,
}

impl<'a> Ours<'a> {
    /// Opens what [`Kind::build`] built of the same tile.
    pub fn open(
        kind: Kind,
        blob: &'a [u8],
        tile: &'a Tile<'_>,
        delta: f32,
    ) -> Result<Self, Malformed> {
        let structure = Structure::from_blob(kind.structure(), blob, tile.mesh(), delta)?;
        Ok(Self { structure })
    }

    /// The nearest hit.
    #[inline]
    pub fn nearest(&self, query: &Query) -> Option<Hit> {
        self.structure.nearest(query)
    }

    /// The nearest hit, by certain instructions; the grid has one way only.
    #[inline]
    pub fn nearest_with(&self, instructions: Instructions, query: &Query) -> Option<Hit> {
        match &self.structure {
            Structure::Grid(grid) => grid.nearest(query),
            Structure::Bvh(bvh) => bvh.nearest_with(instructions, query),
        }
    }

    /// The nearest hits of many.
    pub fn nearest_batch(&self, queries: &[Query], answers: &mut [Option<Hit>]) {
        self.structure.nearest_batch(queries, answers);
    }

    /// The nearest hits of many, by certain instructions; the grid has one way only.
    pub fn nearest_batch_with(
        &self,
        instructions: Instructions,
        queries: &[Query],
        answers: &mut [Option<Hit>],
    ) {
        match &self.structure {
            Structure::Grid(_) => self.nearest_batch(queries, answers),
            Structure::Bvh(bvh) => bvh.nearest_batch_with(instructions, queries, answers),
        }
    }

    /// Whether anything is in the way.
    #[inline]
    pub fn occluded(&self, query: &Query) -> bool {
        self.structure.occluded(query)
    }

    /// Whether anything is in the way of each of many.
    pub fn occluded_batch(&self, queries: &[Query], answers: &mut [bool]) {
        self.structure.occluded_batch(queries, answers);
    }

    /// Where a flight lands.
    pub fn land(&self, flight: &Flight) -> Option<Landing> {
        self.nearest(&query(flight)).map(|h| Landing { triangle: h.global, u: h.u, v: h.v })
    }
}

/// How far a room's queries reach beyond its box, m, so that nothing is lost in rounding. No room has triangles there.
const REACH: f32 = 1e-3;

/// The queries of flights where each room is asked by itself: a ray that leaves a room by its door asks the next one.
/// In the order of the flights, room by room; the second number is the flight's.
pub fn by_rooms(scene: &Scene, whole: &Ours<'_>, flights: &[Flight]) -> Vec<Vec<(Query, u32)>> {
    let mut queues = vec![Vec::new(); scene.rooms.len()];
    let room_of =
        |p: Vec3| scene.rooms.iter().position(|r| r.min.cmple(p).all() && p.cmple(r.max).all());
    for (i, flight) in flights.iter().enumerate() {
        let query = query(flight);
        let end = whole.nearest(&query).map_or(query.t_max, |hit| hit.t);
        let mut entry = 0.0f32;
        let mut room = room_of(query.ray.origin);
        while let Some(r) = room {
            let exit = exit(&scene.rooms[r], &query.ray).max(entry);
            let (t_min, t_max) = ((entry - REACH).max(0.0), (exit + REACH).min(query.t_max));
            queues[r].push((Query { t_min, t_max, ..query }, i as u32));
            if exit >= end {
                break;
            }
            entry = exit;
            room = room_of(query.ray.at(exit + REACH)).filter(|&next| next != r);
        }
    }
    queues
}

/// Where a ray from inside leaves a room's box, m.
fn exit(room: &Room, ray: &Ray) -> f32 {
    (0..3)
        .filter(|&axis| ray.direction[axis] != 0.0)
        .map(|axis| {
            let wall = if ray.direction[axis] > 0.0 { room.max } else { room.min };
            (wall[axis] - ray.origin[axis]) / ray.direction[axis]
        })
        .fold(f32::INFINITY, f32::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::room::Plan;
    use crate::walk::Walks;

    /// What rooms answer one by one is what the whole scene answers, to the bit.
    #[test]
    fn rooms_answer_as_the_whole_scene_does() {
        let plan = Plan { name: "four".into(), columns: 2, rows: 2, triangles: 9_000 };
        let scene = plan.draw();
        let delta = scene.delta();
        let tile = Tile::whole(&scene);
        let blob = Kind::Bvh.build(&tile, delta).unwrap();
        let whole = Ours::open(Kind::Bvh, &blob, &tile, delta).unwrap();
        let flights = Walks::record(&scene, 20_000, 1, |f| whole.land(f)).flights;
        let queues = by_rooms(&scene, &whole, &flights);
        let mut answers = vec![None; flights.len()];
        let mut asked = 0;
        for (room, queue) in scene.rooms.iter().zip(&queues) {
            let tile = Tile::room(&scene, room);
            assert!(tile.mesh().len() > 8_000);
            let blob = Kind::Bvh.build(&tile, delta).unwrap();
            let ours = Ours::open(Kind::Bvh, &blob, &tile, delta).unwrap();
            asked += queue.len();
            for (query, flight) in queue {
                if let Some(hit) = ours.nearest(query) {
                    answers[*flight as usize] = Some((hit.global, hit.t));
                }
            }
        }
        // Some rays cross doors, few.
        assert!((20_100..24_000).contains(&asked), "{asked}");
        for (flight, answer) in flights.iter().zip(answers) {
            let expected = whole.nearest(&query(flight)).map(|h| (h.global, h.t));
            assert_eq!(answer, expected, "{flight:?}");
        }
    }

    #[test]
    fn drawn_rooms_are_tight() {
        let scene = Plan::named("room12k").unwrap().draw();
        let tile = Tile::whole(&scene);
        let blob = Kind::Bvh.build(&tile, scene.delta()).unwrap();
        let ours = Ours::open(Kind::Bvh, &blob, &tile, scene.delta()).unwrap();
        let walks = Walks::record(&scene, 100_000, 1, |f| ours.land(f));
        assert_eq!(walks.escaped, 0);
        // Furniture is hit more than walls are: the room is furnished.
        let walls = scene.triangles.iter().filter(|t| {
            let flat = |axis: usize, at: f32| {
                t.iter().all(|&v| scene.vertices.list()[v as usize][axis] == at)
            };
            flat(2, 0.0)
                || flat(2, 3.0)
                || flat(0, 0.0)
                || flat(0, 8.0)
                || flat(1, 0.0)
                || flat(1, 6.0)
        });
        assert!(walls.count() < 3_000);
    }
}
