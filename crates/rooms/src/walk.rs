//! The walk of a ray across the leaves of the BSP.
//!
//! A ray keeps its original origin and direction for its whole flight; only `t` grows. In each leaf
//! the caller asks for the nearest triangle among the leaf's (or its tile's) with `t < t_accept`;
//! without one the ray leaves through [`Exit::face`] at [`Exit::t_exit`] and [`Bsp::cross`] names
//! the next leaf.
//!
//! # Why the first accepted hit is the nearest of all, for every partition
//!
//! With δ the scene's tolerance:
//!
//! - a hit at `t` is only ever reported if `o + t d` lies within δ of its triangle;
//! - on entering a leaf the ray's point is at most δ outside of each of the leaf's half-spaces
//!   ([`Bsp::cross`] and [`Bsp::locate_towards`] take the *geometric* side unless the point is
//!   within δ of a plane), and from there to `t_exit` this cannot grow: `t_exit` is where the first
//!   half-space is left;
//! - a leaf lists every triangle that touches its half-spaces moved out by 4 δ, and faces are
//!   dropped only if they stay redundant with all half-spaces moved out by 2 δ. So whatever the
//!   ray hits in `[t_in, t_exit]` is listed here (2 δ + 1 δ < 4 δ);
//! - the intervals of consecutive leaves share their ends, so they cover the ray without a gap, and
//!   `t_exit < t_accept`: a wall sheet that lies *in* the splitting plane wins over the crossing.
//!
//! Hence the nearest hit lies in the interval of some leaf, that leaf lists and accepts it, and no
//! earlier leaf can accept anything nearer, for there is nothing nearer.
//!
//! # Why the walk ends
//!
//! A node's plane is only crossed to the side that the ray points to, and afterwards the point is
//! never again more than δ on the other side; every descent therefore stays on the side the ray
//! points to. Each node is crossed once at most.

use enf_layout::NONE;
use enf_layout::bsp::{FACE_IN_FRONT, FaceRecord, LEAF, LeafRecord, NodeRecord, PlaneRecord};
use glam::DVec3;
use thiserror::Error;

/// The BSP tables cannot be walked: one of them is damaged, or they do not belong together.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("BSP table `{table}`, record {index}: {fault}; partition the scene again")]
pub struct Malformed {
    /// The table: `planes`, `nodes`, `leaves`, `faces`, or `delta`.
    pub table: &'static str,
    /// Index of the record in it.
    pub index: usize,
    /// What is wrong with it.
    pub fault: &'static str,
}

/// A direction clearly leads away from a half-space when its share along the outward normal is below this.
pub(crate) const AWAY: f64 = -0.25;

/// A validated view of the tables of one BSP.
#[derive(Clone, Copy, Debug)]
pub struct Bsp<'a> {
    /// Planes.
    pub planes: &'a [PlaneRecord],
    /// Inner nodes; node 0 is the root. Without nodes, leaf 0 is all there is.
    pub nodes: &'a [NodeRecord],
    /// Convex cells.
    pub leaves: &'a [LeafRecord],
    /// Their faces.
    pub faces: &'a [FaceRecord],
    /// The scene's tolerance δ, m.
    pub delta: f64,
}

/// How a ray leaves a leaf.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exit {
    /// Ray parameter where it leaves, at least the `t_in` that was given; infinite when no face is
    /// ahead (which takes a direction without length).
    pub t_exit: f32,
    /// Hits with `t < t_accept` belong to this leaf, even if rounding puts them behind the plane.
    pub t_accept: f32,
    /// The face, an index into [`Bsp::faces`]; [`NONE`] when no face is ahead.
    pub face: u32,
}

impl<'a> Bsp<'a> {
    /// Checks every index, that nodes and leaves form one tree, and that each face's `beyond` is the
    /// sibling across the ancestor plane it names, so that walks can neither panic nor loop.
    ///
    /// # Errors
    /// [`Malformed`] names the first bad record.
    pub fn new(
        planes: &'a [PlaneRecord],
        nodes: &'a [NodeRecord],
        leaves: &'a [LeafRecord],
        faces: &'a [FaceRecord],
        delta: f64,
    ) -> Result<Self, Malformed> {
        let bad = |table, index, fault| Err(Malformed { table, index, fault });
        if !(delta.is_finite() && delta > 0.0) {
            return bad("delta", 0, "the tolerance is not a positive number");
        }
        for (i, plane) in planes.iter().enumerate() {
            let n = DVec3::from_array(plane.normal);
            if !(n.is_finite() && plane.offset.is_finite() && (n.length() - 1.0).abs() < 1e-6) {
                return bad("planes", i, "the normal is not of unit length");
            }
        }
        let limit = LEAF as usize;
        if nodes.len() >= limit || planes.len() >= limit || faces.len() >= limit {
            return bad("nodes", limit, "more records than an index can name");
        }
        if leaves.is_empty() || leaves.len() >= limit || leaves.len() != nodes.len() + 1 {
            return bad("leaves", leaves.len(), "a binary tree has one leaf more than nodes");
        }
        // Parents, in one array: nodes first, then leaves. `NONE` = not yet seen.
        let mut parent = vec![NONE; nodes.len() + leaves.len()];
        for (i, node) in nodes.iter().enumerate() {
            if node.plane as usize >= planes.len() {
                return bad("nodes", i, "its plane does not exist");
            }
            for child in [node.front, node.back] {
                let at = match child & LEAF {
                    0 if (child as usize) < nodes.len() && child != 0 => child as usize,
                    LEAF if ((child & !LEAF) as usize) < leaves.len() => {
                        nodes.len() + (child & !LEAF) as usize
                    }
                    _ => return bad("nodes", i, "a child does not exist"),
                };
                if parent[at] != NONE {
                    return bad("nodes", i, "a child has two parents");
                }
                parent[at] = i as u32;
            }
        }
        // Everything but the root has one parent; what is left to exclude is a cycle off the tree.
        let mut stack = vec![if nodes.is_empty() { LEAF } else { 0 }];
        let mut reached = 0usize;
        while let Some(at) = stack.pop() {
            reached += 1;
            if at & LEAF == 0 {
                stack.push(nodes[at as usize].front);
                stack.push(nodes[at as usize].back);
            }
        }
        if reached != parent.len() {
            return bad("nodes", 0, "some nodes hang together in a circle");
        }
        for (i, leaf) in leaves.iter().enumerate() {
            let first = leaf.first_face as usize;
            let Some(own) = faces.get(first..first.saturating_add(leaf.face_count as usize)) else {
                return bad("leaves", i, "its faces do not exist");
            };
            for (k, face) in own.iter().enumerate() {
                if (face.plane & !FACE_IN_FRONT) as usize >= planes.len() {
                    return bad("faces", first + k, "its plane does not exist");
                }
                if face.beyond == NONE {
                    continue;
                }
                let mut child = i as u32 | LEAF;
                let mut at = parent[nodes.len() + i];
                loop {
                    if at == NONE {
                        return bad("faces", first + k, "what lies beyond is not across its plane");
                    }
                    let node = &nodes[at as usize];
                    let (side, sibling) = if node.front == child {
                        (FACE_IN_FRONT, node.back)
                    } else {
                        (0, node.front)
                    };
                    if face.plane == node.plane | side && face.beyond == sibling {
                        break;
                    }
                    child = at;
                    at = parent[at as usize];
                }
            }
        }
        Ok(Self { planes, nodes, leaves, faces, delta })
    }

    #[inline]
    fn root(&self) -> u32 {
        if self.nodes.is_empty() { LEAF } else { 0 }
    }

    /// The leaf a point belongs to, canonically: on every plane, exactly on it counts as front.
    /// What is attributed to rooms uses this.
    #[inline]
    pub fn locate(&self, point: DVec3) -> u32 {
        let mut at = self.root();
        while at & LEAF == 0 {
            let node = &self.nodes[at as usize];
            let (n, offset) = self.plane(node.plane);
            at = if n.dot(point) - offset >= 0.0 { node.front } else { node.back };
        }
        at & !LEAF
    }

    /// The leaf in which a ray from `point` along `direction` starts: the side the direction points
    /// to of every plane within δ of the point (parallel counts as front).
    #[inline]
    pub fn locate_towards(&self, point: DVec3, direction: DVec3) -> u32 {
        self.descend(self.root(), point, direction, 0.0)
    }

    /// Whether a hit at `t` of a ray that is in `leaf` belongs to this leaf: what `t < exit(..).t_accept` asks, without a division.
    /// It may say no where that says yes, to rounding.
    #[inline]
    pub fn accepts(&self, leaf: u32, origin: DVec3, direction: DVec3, t: f32) -> bool {
        let t = f64::from(t);
        self.outward(leaf).all(|(n, offset)| {
            let sd = n.dot(direction);
            sd <= 0.0 || (n.dot(origin) - offset) + t * sd < self.delta
        })
    }

    /// Whether it is plain that `point`, which lies in `leaf` or next to it, belongs to that leaf, and a ray along the unit vector
    /// `direction` starts in it as well: then [`Self::locate`] and [`Self::locate_towards`] give that leaf and need not be asked.
    ///
    /// Faces that are dropped do not hide another answer. With `n` the outward normal of a dropped half-space, `a_i` those of the
    /// faces, linear programming gives weights `w_i >= 0` with `n = sum w_i a_i`, so `sum w_i >= 1`; a point that is `s` inside of
    /// each face is at least `s` inside of the dropped one. If it is near the dropped plane it is near all faces of large
    /// weight, and `direction`, which leads clearly away from those, leads away from that plane.
    #[inline]
    pub fn keeps(&self, leaf: u32, point: DVec3, direction: DVec3) -> bool {
        let (clearly, far) = self.kept();
        self.outward(leaf).all(|(n, offset)| {
            let s = n.dot(point) - offset;
            s < far || (s < clearly && n.dot(direction) < AWAY)
        })
    }

    /// How far outside of a half-space a point of [`Self::keeps`] may be, when the direction leads away from it and when not: below
    /// these, m.
    #[inline]
    pub(crate) fn kept(&self) -> (f64, f64) {
        (-self.delta / 16.0, -16.0 * self.delta)
    }

    /// The outward half-spaces of a leaf: unit normal and offset.
    #[inline]
    pub(crate) fn outward(&self, leaf: u32) -> impl Iterator<Item = (DVec3, f64)> {
        let leaf = &self.leaves[leaf as usize];
        let first = leaf.first_face as usize;
        self.faces[first..first + leaf.face_count as usize].iter().map(|face| {
            let (n, offset) = self.plane(face.plane & !FACE_IN_FRONT);
            if face.plane & FACE_IN_FRONT == 0 { (n, offset) } else { (-n, -offset) }
        })
    }

    /// Where the ray `origin + t direction` that entered `leaf` at `t_in` leaves it.
    ///
    /// `leaf` must be below the number of leaves. Among faces met at the same `t` the first counts.
    #[inline]
    pub fn exit(&self, leaf: u32, origin: DVec3, direction: DVec3, t_in: f32) -> Exit {
        let leaf = &self.leaves[leaf as usize];
        let first = leaf.first_face;
        let (mut t_plane, mut t_accept, mut nearest) = (f64::INFINITY, f64::INFINITY, NONE);
        for face in first..first + leaf.face_count {
            let plane = self.faces[face as usize].plane;
            let (mut n, mut offset) = self.plane(plane & !FACE_IN_FRONT);
            if plane & FACE_IN_FRONT != 0 {
                (n, offset) = (-n, -offset);
            }
            let sd = n.dot(direction);
            if sd > 0.0 {
                let s0 = n.dot(origin) - offset;
                let t = -s0 / sd;
                if t < t_plane || (nearest == NONE && !t.is_nan()) {
                    (t_plane, nearest) = (t, face);
                }
                t_accept = t_accept.min((self.delta - s0) / sd);
            }
        }
        Exit { t_exit: t_in.max(t_plane as f32), t_accept: t_accept as f32, face: nearest }
    }

    /// The leaf entered by a ray that leaves its leaf through `face` at `t`; `None` when it has left
    /// the scene.
    #[inline]
    pub fn cross(&self, face: u32, origin: DVec3, direction: DVec3, t: f32) -> Option<u32> {
        let beyond = self.faces.get(face as usize)?.beyond;
        (beyond != NONE).then(|| self.descend(beyond, origin, direction, f64::from(t)))
    }

    #[inline]
    fn descend(&self, mut at: u32, origin: DVec3, direction: DVec3, t: f64) -> u32 {
        while at & LEAF == 0 {
            let node = &self.nodes[at as usize];
            let (n, offset) = self.plane(node.plane);
            let sd = n.dot(direction);
            let s = (n.dot(origin) - offset) + t * sd;
            let front = if s > self.delta {
                true
            } else if s < -self.delta {
                false
            } else {
                sd >= 0.0
            };
            at = if front { node.front } else { node.back };
        }
        at & !LEAF
    }

    #[inline]
    fn plane(&self, index: u32) -> (DVec3, f64) {
        let plane = &self.planes[index as usize];
        (DVec3::from_array(plane.normal), plane.offset)
    }
}
