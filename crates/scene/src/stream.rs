//! The stream: unique meshes and placements in, world-space triangles out, nothing kept.

use crate::{
    frame::{Frame, Matrix, Placements},
    obj::{Mesh, Part},
};
use glam::DVec3;
use std::ops::Range;

/// Meshes of up to this many vertices are transformed vertex by vertex into scratch (12 bytes each),
/// larger ones corner by corner: the same arithmetic, and memory stays the meshes alone.
const SCRATCH_VERTICES: usize = 1 << 16;

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
}

impl Use {
    pub(crate) fn is_door(&self, part: &Part) -> bool {
        self.door.unwrap_or(part.door)
    }

    pub(crate) fn object(&self, instance: usize, part: &Part) -> u32 {
        self.first_object + if self.whole { instance as u32 } else { part.object }
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

/// A mesh in its place.
pub(crate) struct Placed<'a> {
    mesh: &'a Mesh,
    matrix: Matrix,
    scratch: &'a [[f32; 3]],
}

impl Placed<'_> {
    /// Corners of a triangle of the mesh, in store coordinates, counter-clockwise from the front.
    pub(crate) fn corners(&self, triangle: u32) -> Result<[[f32; 3]; 3], Skipped> {
        let [a, b, c] = self.mesh.triangles[triangle as usize];
        let order = if self.matrix.flips { [a, c, b] } else { [a, b, c] };
        let corners = if self.scratch.is_empty() {
            order.map(|v| self.matrix.store(self.mesh.positions[v as usize]))
        } else {
            order.map(|v| self.scratch[v as usize])
        };
        let n = area_vector(&corners);
        if !n.is_finite() {
            return Err(Skipped::NotFinite);
        }
        if n == DVec3::ZERO { Err(Skipped::Flat) } else { Ok(corners) }
    }
}

impl Placed<'_> {
    /// The triangle's first corner, whatever it is.
    pub(crate) fn corner(&self, triangle: u32) -> [f32; 3] {
        let [v, _, _] = self.mesh.triangles[triangle as usize];
        self.matrix.store(self.mesh.positions[v as usize])
    }
}

/// Twice the triangle's area along its normal. Differences of `f32` are exact in `f64` for all but
/// absurd ranges, so zero means collinear.
pub(crate) fn area_vector(corners: &[[f32; 3]; 3]) -> DVec3 {
    let [a, b, c] = corners.map(|p| DVec3::from_array(p.map(f64::from)));
    (b - a).cross(c - a)
}

impl Geometry {
    /// Places one instance; `scratch` is the caller's, to be used again.
    pub(crate) fn place<'a>(
        &'a self,
        used: &Use,
        instance: usize,
        scratch: &'a mut Vec<[f32; 3]>,
    ) -> Placed<'a> {
        let mesh = &self.meshes[used.mesh];
        let matrix = self.frame.matrix(used.placements.get(instance));
        scratch.clear();
        if mesh.positions.len() <= SCRATCH_VERTICES {
            scratch.extend(mesh.positions.iter().map(|&p| matrix.store(p)));
        }
        Placed { mesh, matrix, scratch }
    }

    /// The runs of an instance, in order, without doors if they are to be open.
    pub(crate) fn runs<'a>(
        &'a self,
        used: &'a Use,
        instance: usize,
    ) -> impl Iterator<Item = Run> + 'a {
        let mut begin = 0;
        self.meshes[used.mesh].parts.iter().filter_map(move |part| {
            let triangles = begin..part.end;
            begin = part.end;
            (!(self.open && used.is_door(part))).then(|| Run {
                object: used.object(instance, part),
                material: used.materials[part.material as usize],
                triangles,
            })
        })
    }

    pub(crate) fn bytes(&self) -> u64 {
        let meshes: u64 = self.meshes.iter().map(|m| m.bytes() + size_of::<Mesh>() as u64).sum();
        let uses: u64 = self
            .uses
            .iter()
            .map(|u| {
                u.placements.bytes()
                    + (size_of::<Use>()
                        + u.name.capacity()
                        + (u.materials.capacity() + u.first.capacity()) * 4)
                        as u64
            })
            .sum();
        meshes + uses
    }
}
