//! The stream: unique meshes and placements in, world-space triangles out, nothing kept.

use crate::{
    SceneError,
    frame::{Frame, Matrix, Placements},
    obj::Mesh,
    shape::{Lookup, Part, Shape},
};
use glam::DVec3;
use std::ops::Range;

/// Meshes of up to this many vertices are transformed vertex by vertex into scratch (12 bytes each),
/// larger ones corner by corner: the same arithmetic, and memory stays the meshes alone.
const SCRATCH_VERTICES: usize = 1 << 16;
/// Every so many triangles of an instance, the global index is noted, so that a range of a large mesh is
/// reached without counting from its beginning.
pub(crate) const MARK_EVERY: u32 = 1 << 16;

/// One `[[mesh]]` of the scene.
#[derive(Debug)]
pub(crate) struct Use {
    pub(crate) mesh: usize,
    pub(crate) name: String,
    pub(crate) placements: Placements,
    /// Placed by `instances`: each instance is one object.
    pub(crate) whole: bool,
    /// What the scene file says about its being a door.
    pub(crate) door: Option<bool>,
    pub(crate) first_object: u32,
    /// Scene material of each of the mesh's materials.
    pub(crate) materials: Vec<u32>,
    /// Global index of the first triangle of each instance.
    pub(crate) first: Vec<u32>,
    /// Of each instance, one after the other: the global index at its triangle [`MARK_EVERY`], twice that,
    /// and so on.
    pub(crate) marks: Vec<u32>,
    /// Emitting runs, of spooled meshes only, ascending: so that lights are found again without reading
    /// all that is dark.
    pub(crate) glowing: Vec<Glowing>,
}

/// A run of emitting triangles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Glowing {
    pub(crate) instance: u32,
    pub(crate) object: u32,
    pub(crate) material: u32,
    /// Triangles of the mesh.
    pub(crate) begin: u32,
    pub(crate) end: u32,
    /// Global index of the first one in the stream.
    pub(crate) index: u32,
}

impl Use {
    pub(crate) fn is_door(&self, part: &Part) -> bool {
        self.door.unwrap_or(part.door)
    }

    pub(crate) fn object(&self, instance: usize, part: &Part) -> u32 {
        self.first_object + if self.whole { instance as u32 } else { part.object }
    }

    /// The marks of an instance. All have the same number: they divide the mesh.
    pub(crate) fn marks_of(&self, instance: usize) -> &[u32] {
        let each = self.marks.len() / self.placements.len().max(1);
        self.marks.get(instance * each..(instance + 1) * each).unwrap_or_default()
    }

    pub(crate) fn objects(&self, meshes: &[Mesh]) -> usize {
        if self.whole { self.placements.len() } else { meshes[self.mesh].objects.len() }
    }
}

/// Why a triangle is not in the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Skipped {
    /// No area after rounding.
    Flat,
    /// A vertex that is not finite (or beyond `f32`).
    NotFinite,
}

/// A run of triangles of one object and one material.
#[derive(Clone, Debug)]
pub(crate) struct Run {
    pub(crate) object: u32,
    /// Before copies for lights of different areas.
    pub(crate) material: u32,
    pub(crate) triangles: Range<u32>,
}

/// Everything that triangles come from.
#[derive(Debug)]
pub(crate) struct Geometry {
    pub(crate) meshes: Vec<Mesh>,
    pub(crate) uses: Vec<Use>,
    pub(crate) frame: Frame,
    /// Doors are left out.
    pub(crate) open: bool,
}

/// What a pass needs beside the meshes, to be used again from instance to instance: 768 KiB at most, or
/// 3.5 MiB (and two bytes for every 1024 vertices) for a spooled mesh.
#[derive(Default)]
pub(crate) struct Scratch {
    points: Vec<[f32; 3]>,
    lookup: Lookup<[f32; 3]>,
}

/// A mesh in its place.
pub(crate) struct Placed<'a> {
    shape: &'a Shape,
    matrix: Matrix,
    points: &'a [[f32; 3]],
    lookup: &'a mut Lookup<[f32; 3]>,
}

impl Placed<'_> {
    /// Corners of a triangle of the mesh, in store coordinates, counter-clockwise from the front.
    ///
    /// # Errors
    /// A spooled mesh cannot be read.
    #[inline]
    pub(crate) fn corners(
        &mut self,
        triangle: u32,
    ) -> Result<Result<[[f32; 3]; 3], Skipped>, SceneError> {
        let [a, b, c] = self.lookup.triangle(self.shape, triangle)?;
        let [a, b, c] = if self.matrix.flips { [a, c, b] } else { [a, b, c] };
        let corners = if self.points.is_empty() {
            let matrix = &self.matrix;
            let mut at =
                |v| self.lookup.vertex(self.shape, v, |p| matrix.store(DVec3::from_array(p)));
            [at(a)?, at(b)?, at(c)?]
        } else {
            [a, b, c].map(|v| self.points[v as usize])
        };
        let n = area_vector(&corners);
        Ok(if !n.is_finite() {
            Err(Skipped::NotFinite)
        } else if n == DVec3::ZERO {
            Err(Skipped::Flat)
        } else {
            Ok(corners)
        })
    }

    /// Texture coordinates of a triangle's corners, in the order of [`Placed::corners`].
    ///
    /// # Errors
    /// A spooled mesh cannot be read.
    pub(crate) fn coordinates(
        &mut self,
        triangle: u32,
    ) -> Result<Option<[[f32; 2]; 3]>, SceneError> {
        let found = self.lookup.coordinates(self.shape, triangle)?;
        Ok(found.map(|[a, b, c]| if self.matrix.flips { [a, c, b] } else { [a, b, c] }))
    }

    /// The vertices of a triangle, and the first one's place, whatever it is.
    pub(crate) fn vertices(&mut self, triangle: u32) -> Result<([u32; 3], [f32; 3]), SceneError> {
        let vertices = self.lookup.triangle(self.shape, triangle)?;
        let matrix = &self.matrix;
        let place =
            self.lookup.vertex(self.shape, vertices[0], |p| matrix.store(DVec3::from_array(p)))?;
        Ok((vertices, place))
    }
}

/// Twice the triangle's area along its normal. Differences of `f32` are exact in `f64` for all but
/// absurd ranges, so zero means collinear.
pub(crate) fn area_vector(corners: &[[f32; 3]; 3]) -> DVec3 {
    let [a, b, c] = corners.map(|p| DVec3::from_array(p.map(f64::from)));
    (b - a).cross(c - a)
}

impl Geometry {
    /// The triangles of this use are in files.
    pub(crate) fn is_spooled(&self, used: &Use) -> bool {
        matches!(self.meshes[used.mesh].shape, Shape::Spooled(_))
    }

    /// Places one instance; `scratch` is the caller's, to be used again.
    pub(crate) fn place<'a>(
        &'a self,
        used: &Use,
        instance: usize,
        scratch: &'a mut Scratch,
    ) -> Placed<'a> {
        let shape = &self.meshes[used.mesh].shape;
        let matrix = self.frame.matrix(used.placements.get(instance));
        let Scratch { points, lookup } = scratch;
        points.clear();
        lookup.reset();
        if let Shape::Resident(r) = shape
            && r.positions.len() <= SCRATCH_VERTICES
        {
            points.extend(r.positions.iter().map(|&p| matrix.store(DVec3::from_array(p))));
        }
        Placed { shape, matrix, points, lookup }
    }

    /// The runs of an instance, in order, without doors if they are to be open.
    pub(crate) fn runs<'a>(
        &'a self,
        used: &'a Use,
        instance: usize,
    ) -> impl Iterator<Item = Result<Run, SceneError>> + 'a {
        self.meshes[used.mesh].shape.parts().filter_map(move |part| match part {
            Err(e) => Some(Err(e)),
            Ok((part, _)) if self.open && used.is_door(&part) => None,
            Ok((part, triangles)) => Some(Ok(Run {
                object: used.object(instance, &part),
                material: used.materials[part.material as usize],
                triangles,
            })),
        })
    }

    /// Heap bytes.
    pub(crate) fn bytes(&self) -> u64 {
        let meshes: u64 = self.meshes.iter().map(|m| m.bytes() + size_of::<Mesh>() as u64).sum();
        let uses: u64 = self
            .uses
            .iter()
            .map(|u| {
                u.placements.bytes()
                    + (size_of::<Use>()
                        + u.name.capacity()
                        + (u.materials.capacity() + u.first.capacity() + u.marks.capacity()) * 4
                        + u.glowing.capacity() * size_of::<Glowing>()) as u64
            })
            .sum();
        meshes + uses
    }
}
