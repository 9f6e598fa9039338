//! A tile's triangles: the arrays of an [`enf_layout::geometry`] blob, read in place.

use enf_layout::geometry as layout;
use enf_layout::sections::{self, Malformed, Transform};
use glam::Vec3;
use zerocopy::IntoBytes;

use crate::aabb::Aabb;

/// The mesh of one tile, borrowed from its blob.
#[derive(Clone, Copy, Debug)]
pub struct TileMesh<'a> {
    /// Vertices in store coordinates, m; finite.
    pub vertices: &'a [[f32; 3]],
    /// Vertex indices, counter-clockwise seen from the front; in range.
    pub triangles: &'a [[u32; 3]],
    /// Index in the scene of each triangle; ascending.
    pub global: &'a [u32],
    /// Material of each triangle.
    pub materials: &'a [u32],
}

impl<'a> TileMesh<'a> {
    /// Reads a blob (4-byte aligned). Fails when arrays have different lengths, a vertex is not
    /// finite or missing, or global indices do not ascend.
    pub fn from_blob(blob: &'a [u8]) -> Result<Self, Malformed> {
        let mesh = Self::from_checked_blob(blob)?;
        let n = mesh.triangles.len();
        if mesh.global.len() != n || mesh.materials.len() != n || n >= u32::MAX as usize {
            return Err(Malformed(format!(
                "mesh has {n} triangles, but {} global indices and {} materials",
                mesh.global.len(),
                mesh.materials.len()
            )));
        }
        if let Some(i) = mesh.vertices.iter().position(|v| !v.iter().all(|x| x.is_finite())) {
            return Err(Malformed(format!("mesh vertex {i} is not finite")));
        }
        let count = mesh.vertices.len();
        if let Some(i) = mesh.triangles.iter().position(|t| t.iter().any(|&v| v as usize >= count))
        {
            return Err(Malformed(format!(
                "mesh triangle {i} has corners {:?} of {count} vertices",
                mesh.triangles[i]
            )));
        }
        if let Some(i) = mesh.global.windows(2).position(|w| w[0] >= w[1]) {
            return Err(Malformed(format!("global indices do not ascend after triangle {i}")));
        }
        Ok(mesh)
    }

    /// A blob that [`TileMesh::from_blob`] has accepted before, without looking at each triangle again.
    pub fn from_checked_blob(blob: &'a [u8]) -> Result<Self, Malformed> {
        Ok(Self {
            vertices: sections::section(blob, layout::SECTION_VERTICES)?,
            triangles: sections::section(blob, layout::SECTION_TRIANGLES)?,
            global: sections::section(blob, layout::SECTION_GLOBAL)?,
            materials: sections::section(blob, layout::SECTION_MATERIALS)?,
        })
    }

    /// Number of triangles.
    pub fn len(&self) -> u32 {
        self.triangles.len() as u32
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Corners of triangle `i` of the tile, m.
    pub fn corners(&self, i: u32) -> [Vec3; 3] {
        self.corner_arrays(i).map(|&p| Vec3::from_array(p))
    }

    #[inline(always)]
    pub(crate) fn corner_arrays(&self, i: u32) -> [&'a [f32; 3]; 3] {
        let [a, b, c] = self.triangles[i as usize];
        let vertices = self.vertices;
        [&vertices[a as usize], &vertices[b as usize], &vertices[c as usize]]
    }

    /// Unit normal of triangle `i`, towards the side from which it is counter-clockwise; zero for a
    /// triangle without area. Computed in `f64`.
    pub fn geometric_normal(&self, i: u32) -> Vec3 {
        let [a, b, c] = self.corners(i).map(|p| p.as_dvec3());
        let n = (b - a).cross(c - a);
        // Scaled first, so that tiny triangles do not underflow.
        let largest = n.abs().max_element();
        if largest > 0.0 { (n / largest).normalize().as_vec3() } else { Vec3::ZERO }
    }

    /// Area of triangle `i`, m².
    pub fn area(&self, i: u32) -> f64 {
        let [a, b, c] = self.corners(i).map(|p| p.as_dvec3());
        0.5 * (b - a).cross(c - a).length()
    }

    /// The box of all triangles' corners.
    pub fn bounds(&self) -> Aabb {
        Aabb::of(
            self.triangles.iter().flatten().map(|&v| Vec3::from_array(self.vertices[v as usize])),
        )
    }

    /// Builds a blob of `(global index, material, corners)`. Equal vertices (bit for bit) are stored once, in
    /// the order in which ascending triangles first use them, so the bytes depend on the set of
    /// triangles alone. Global indices must be distinct.
    pub fn build_blob(
        triangles: impl Iterator<Item = (u32, u32, [[f32; 3]; 3])> + Clone,
    ) -> Vec<u8> {
        let mut ascending = true;
        let mut count = 0;
        let mut last = 0;
        for (global, ..) in triangles.clone() {
            ascending &= last <= global;
            last = global;
            count += 1;
        }
        if ascending {
            return build_ascending(triangles, count);
        }
        let mut sorted: Vec<_> = triangles.collect();
        sorted.sort_by_key(|t| t.0);
        build_ascending(sorted.into_iter(), count)
    }
}

fn build_ascending(
    input: impl Iterator<Item = (u32, u32, [[f32; 3]; 3])>,
    count: usize,
) -> Vec<u8> {
    let mut vertices = VertexTable::default();
    let mut triangles = Vec::with_capacity(count);
    let mut global = Vec::with_capacity(count);
    let mut materials = Vec::with_capacity(count);
    for (index, material, corners) in input {
        triangles.push(corners.map(|p| vertices.index_of(p)));
        global.push(index);
        materials.push(material);
    }
    vertices.slots = Vec::new();
    sections::build(&[
        (vertices.list.as_bytes(), Transform::Xor, 3),
        (triangles.as_bytes(), Transform::Delta, 3),
        (global.as_bytes(), Transform::Delta, 1),
        (materials.as_bytes(), Transform::Delta, 1),
    ])
}

/// Vertices in order of first use, with an open-addressed table of their bits.
#[derive(Default)]
struct VertexTable {
    list: Vec<[f32; 3]>,
    /// Index + 1 into `list`, 0 = free; a power of two of them.
    slots: Vec<u32>,
}

impl VertexTable {
    fn index_of(&mut self, p: [f32; 3]) -> u32 {
        if 2 * (self.list.len() + 1) > self.slots.len() {
            self.double();
        }
        let slot = self.slot_of(p);
        if self.slots[slot] == 0 {
            self.list.push(p);
            self.slots[slot] = self.list.len() as u32;
        }
        self.slots[slot] - 1
    }

    /// The slot that holds a vertex, or the free one where it belongs.
    fn slot_of(&self, p: [f32; 3]) -> usize {
        let bits = p.map(f32::to_bits);
        let mut hash = 0u64;
        for word in bits {
            hash = (hash ^ u64::from(word)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            hash ^= hash >> 29;
        }
        let mask = self.slots.len() - 1;
        let mut slot = hash as usize & mask;
        loop {
            match self.slots[slot] {
                0 => return slot,
                i if self.list[i as usize - 1].map(f32::to_bits) == bits => return slot,
                _ => slot = (slot + 1) & mask,
            }
        }
    }

    fn double(&mut self) {
        self.slots = vec![0; (2 * self.slots.len()).max(64)];
        for i in 0..self.list.len() {
            let slot = self.slot_of(self.list[i]);
            self.slots[slot] = i as u32 + 1;
        }
    }
}
