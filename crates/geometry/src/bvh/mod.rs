//! A bounding volume hierarchy of a tile, eight children wide, in eighty bytes a node.
//!
//! A wide node asks eight boxes at once, which is what a vector unit likes (Wald, Benthin and Boulos 2008,
//! *Getting rid of packets*); boxes in eight bits a coordinate keep a room's hierarchy in the second-level cache
//! (Ylitie, Karras and Laine 2017). It is a [`sections`] blob that is used in place, wherever it was loaded;
//! [`enf_layout::bvh`] says what is in it.
//!
//! Why the nearest hit is the true one: a hit's point is within `delta` of its triangle; every box is grown by four
//! `delta`; the slab test in `f32` is off by less than one `delta` for origins within a few scenes; so a box
//! that holds a triangle is entered no later than the triangle is hit. Ties go to the smaller index
//! because a box at the best distance is still opened.

mod build;
mod walk;

pub use build::{build_bvh, bvh_build_bytes, bvh_bytes_estimate};
pub use enf_layout::bvh::{BvhHeader, BvhNode};

use enf_layout::bvh::{
    CHILD_INNER, CHILD_NONE, DEPTH, SECTION_HEADER, SECTION_NODES, SECTION_REFERENCES,
};
use enf_layout::sections::{self, Malformed};
use glam::Vec3;

use crate::aabb::Aabb;

/// A hierarchy, borrowed from its blob.
#[derive(Clone, Copy, Debug)]
pub struct BvhView<'a> {
    header: &'a BvhHeader,
    nodes: &'a [BvhNode],
    references: &'a [u32],
}

impl<'a> BvhView<'a> {
    /// Reads a blob (4-byte aligned) for a mesh of `triangle_count` triangles. Every index in it is
    /// checked, so that a walk never leaves it.
    pub fn from_blob(blob: &'a [u8], triangle_count: u32) -> Result<Self, Malformed> {
        let bvh = Self::from_checked_blob(blob)?;
        bvh.check(triangle_count).map_err(Malformed)?;
        Ok(bvh)
    }

    /// A blob that [`BvhView::from_blob`] has accepted before, without checking each index again.
    pub fn from_checked_blob(blob: &'a [u8]) -> Result<Self, Malformed> {
        let headers: &[BvhHeader] = sections::section(blob, SECTION_HEADER)?;
        let [header] = headers else {
            return Err(Malformed(format!("hierarchy has {} headers", headers.len())));
        };
        Ok(Self {
            header,
            nodes: sections::section(blob, SECTION_NODES)?,
            references: sections::section(blob, SECTION_REFERENCES)?,
        })
    }

    fn check(&self, triangle_count: u32) -> Result<(), String> {
        let h = self.header;
        if triangle_count >= 1 << 29 {
            return Err(format!("hierarchy of {triangle_count} triangles"));
        }
        if h.triangles != triangle_count || self.references.len() != triangle_count as usize {
            return Err(format!(
                "hierarchy is for {} triangles and lists {}, not {triangle_count}",
                h.triangles,
                self.references.len()
            ));
        }
        let finite = |p: &[f32; 3]| p.iter().all(|x| x.is_finite());
        if !(finite(&h.min) && finite(&h.max) && h.delta >= 0.0) {
            return Err(format!("hierarchy geometry makes no sense: {h:?}"));
        }
        if self.nodes.is_empty() || self.nodes.len() >= 1 << 28 {
            return Err(format!("hierarchy has {} nodes", self.nodes.len()));
        }
        let mut depth = vec![0u8; self.nodes.len()];
        depth[0] = 1;
        for (i, node) in self.nodes.iter().enumerate() {
            if depth[i] == 0 || depth[i] as usize > DEPTH {
                return Err(format!("hierarchy node {i} is at depth {}", depth[i]));
            }
            if !finite(&node.origin) || node.exponent.iter().any(|e| !(1..=254).contains(e)) {
                return Err(format!("hierarchy node {i} has no frame"));
            }
            let mut inner = 0;
            for (slot, child) in node.child.into_iter().enumerate() {
                if (node.used >> slot & 1 == 0) != (child == CHILD_NONE) {
                    return Err(format!("hierarchy node {i} is not sure about child {slot}"));
                }
                if child == CHILD_NONE {
                    continue;
                }
                if child & CHILD_INNER != 0 {
                    let at = u64::from(node.nodes) + u64::from(inner);
                    if child & !CHILD_INNER != inner || at <= i as u64 || at >= depth.len() as u64 {
                        return Err(format!("hierarchy node {i} has a child {at}"));
                    }
                    if depth[at as usize] != 0 {
                        return Err(format!("hierarchy node {at} has two parents"));
                    }
                    depth[at as usize] = depth[i] + 1;
                    inner += 1;
                    continue;
                }
                let first = u64::from(node.references) + u64::from(child & 31);
                if first + u64::from(child >> 5) >= self.references.len() as u64 {
                    return Err(format!("hierarchy node {i} has references from {first} on"));
                }
            }
        }
        if let Some(i) = self.references.iter().position(|&r| r >= triangle_count) {
            return Err(format!("hierarchy reference {i} is to triangle {}", self.references[i]));
        }
        Ok(())
    }

    /// Box, tolerance and count.
    pub fn header(&self) -> &'a BvhHeader {
        self.header
    }

    /// Number of nodes.
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// The mesh's box and four tolerances: outside, there is nothing to hit.
    pub fn bounds(&self) -> Aabb {
        Aabb { min: Vec3::from_array(self.header.min), max: Vec3::from_array(self.header.max) }
    }
}
