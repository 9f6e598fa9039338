//! The openings of a room, asked two things: how far away, and is the straight way through one.

use enf_layout::photon::PhotonRecord;
use enf_layout::room::{PIECE_CORNERS, PortalPieceRecord, PortalRecord};
use glam::{DVec3, Vec3};

/// Least slack around an opening, m: points on a door's sill lie on the edge of its opening.
const LEAST_TOLERANCE_M: f64 = 1e-3;
/// Slack relative to the largest coordinate: 2^-17, four times the tolerance of a hit.
const RELATIVE_TOLERANCE: f64 = 1.0 / 131_072.0;

/// The open pieces of a room's portals.
///
/// Borrows the store's records and prepares nothing: it is cheap to make and to copy, and costs no
/// memory. Pieces are convex and planar. A piece that is none (fewer than 3 corners, no area, a corner
/// that is no number) or lies outside the table is shut; [`PortalSet::check`] tells.
#[derive(Clone, Copy, Debug)]
pub struct PortalSet<'a> {
    portals: &'a [PortalRecord],
    pieces: &'a [PortalPieceRecord],
}

/// A portal or piece that [`PortalSet::check`] refuses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BadPortals {
    /// The portal at `portal` names pieces beyond the end of the table.
    PiecesOutOfRange {
        /// Position in the set's portals.
        portal: usize,
        /// First piece that it names.
        first_piece: u32,
        /// How many it names.
        piece_count: u32,
        /// Length of the table.
        pieces: usize,
    },
    /// The piece has no area, a corner that is no finite number, or not 3 to 8 corners.
    BadPiece {
        /// Index in the table of pieces.
        piece: usize,
        /// Number of corners that it claims.
        corners: u32,
    },
}

impl std::fmt::Display for BadPortals {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::PiecesOutOfRange { portal, first_piece, piece_count, pieces } => write!(
                f,
                "portal {portal} names {piece_count} pieces from {first_piece} on, but there are \
                 {pieces}: run the partition again"
            ),
            Self::BadPiece { piece, corners } => write!(
                f,
                "portal piece {piece} with {corners} corners is no convex polygon: run the \
                 partition again"
            ),
        }
    }
}

impl std::error::Error for BadPortals {}

impl<'a> PortalSet<'a> {
    /// The openings of one room (or some of them: those that lead to one neighbour, say).
    ///
    /// `portals` are the room's; their `first_piece` indexes `pieces`, which is usually the table of
    /// the whole scene. With no portals nothing is near and nothing crosses.
    pub fn new(portals: &'a [PortalRecord], pieces: &'a [PortalPieceRecord]) -> Self {
        Self { portals, pieces }
    }

    /// A set without openings.
    pub fn none() -> Self {
        Self::new(&[], &[])
    }

    /// Whether every portal names pieces that exist and every piece is a polygon.
    ///
    /// # Errors
    /// The first one that is not so.
    pub fn check(&self) -> Result<(), BadPortals> {
        for (index, portal) in self.portals.iter().enumerate() {
            let range = piece_range(portal);
            let pieces = self.pieces.get(range.clone()).ok_or(BadPortals::PiecesOutOfRange {
                portal: index,
                first_piece: portal.first_piece,
                piece_count: portal.piece_count,
                pieces: self.pieces.len(),
            })?;
            for (piece, index) in pieces.iter().zip(range) {
                if Opening::new(piece).is_none() {
                    return Err(BadPortals::BadPiece { piece: index, corners: piece.count });
                }
            }
        }
        Ok(())
    }

    fn pieces(&self) -> impl Iterator<Item = &'a PortalPieceRecord> {
        let table = self.pieces;
        self.portals.iter().flat_map(move |p| table.get(piece_range(p)).unwrap_or(&[]))
    }

    /// The pieces that a ball of `radius` about `point` may touch.
    fn openings_about(&self, point: DVec3, radius: f64) -> impl Iterator<Item = Opening> {
        self.pieces()
            .filter(move |piece| Bounds::of(piece, radius).may_touch(point))
            .filter_map(Opening::new)
    }

    /// Whether `point` is within `radius` (m) of an opening: exact distance to the convex polygons.
    #[cfg(test)]
    fn near(&self, point: Vec3, radius: f32) -> bool {
        let (point, radius) = (point.as_dvec3(), f64::from(radius));
        point.is_finite() && self.openings_about(point, radius).any(|o| o.distance(point) <= radius)
    }

    /// Whether the segment from `a` to `b` (m) passes an opening. Inclusive: touching it, an end in
    /// its plane, or a miss by less than the slack count as passing.
    #[cfg(test)]
    pub(crate) fn crosses(&self, a: Vec3, b: Vec3) -> bool {
        let (a, b) = (a.as_dvec3(), b.as_dvec3());
        a.is_finite()
            && b.is_finite()
            && self.openings_about((a + b) * 0.5, a.distance(b) * 0.5).any(|o| o.passes(a, b))
    }

    /// Puts the openings that a segment of length `radius` from `point` may pass into `out`.
    pub(crate) fn collect(&self, point: Vec3, radius: f32, out: &mut Vec<Opening>) {
        out.clear();
        out.extend(self.openings_about(point.as_dvec3(), f64::from(radius)));
    }
}

/// Which photons of a neighbour the map of a room must hold.
#[derive(Clone, Debug)]
pub struct Halo {
    radius: f64,
    /// Beyond this box nothing is wanted.
    min: Vec3,
    max: Vec3,
    openings: Vec<(Bounds, Opening)>,
}

impl Halo {
    /// Of a room whose `portals` lead to the neighbour; `radius` is the halo's width, m.
    pub fn new(portals: &PortalSet<'_>, radius: f32) -> Self {
        // A way of length `radius` through the slack around an opening ends this near to the opening.
        let radius = f64::from(radius) * (1.0 + 1e-6);
        let openings: Vec<_> = portals
            .pieces()
            .filter_map(|piece| {
                let bounds = Bounds::of(piece, radius + LEAST_TOLERANCE_M);
                Some((bounds, Opening::new(piece)?))
            })
            .collect();
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for (bounds, _) in &openings {
            min = min.min(bounds.min - bounds.reach);
            max = max.max(bounds.max + bounds.reach);
        }
        // Rounded outwards: what is told apart by this box lies clearly beyond it.
        let (down, up) = (|x: f32| x.next_down(), |x: f32| x.next_up());
        Self { radius, min: min.as_vec3().map(down), max: max.as_vec3().map(up), openings }
    }

    /// Whether photon `p` of the neighbour is wanted. Never false for one that some gather of at most the halo's width in
    /// the room can count.
    #[inline]
    pub fn wants(&self, p: &PhotonRecord) -> bool {
        let point = Vec3::from(p.position());
        // No number is within no bounds.
        (point.cmpge(self.min) & point.cmple(self.max)).all() && self.is_near(point.as_dvec3())
    }

    fn is_near(&self, point: DVec3) -> bool {
        point.is_finite()
            && self.openings.iter().any(|(bounds, opening)| {
                bounds.may_touch(point)
                    && opening.distance(point) <= self.radius + 4.0 * opening.tolerance
            })
    }
}

/// The box about a piece, and how far from it something may be that touches the piece.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    min: DVec3,
    max: DVec3,
    reach: f64,
}

impl Bounds {
    fn of(piece: &PortalPieceRecord, radius: f64) -> Self {
        let n = (piece.count as usize).min(PIECE_CORNERS);
        let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for &corner in &piece.corners[..n] {
            min = min.min(Vec3::from(corner));
            max = max.max(Vec3::from(corner));
        }
        let (min, max) = (min.as_dvec3(), max.as_dvec3());
        let reach = radius + 2.0 * tolerance(min.abs().max(max.abs()));
        Self { min, max, reach }
    }

    fn may_touch(&self, point: DVec3) -> bool {
        let away = (self.min - point).max(point - self.max).max(DVec3::ZERO);
        away.length_squared() <= self.reach * self.reach
    }
}

fn piece_range(portal: &PortalRecord) -> std::ops::Range<usize> {
    let first = portal.first_piece as usize;
    first..first.saturating_add(portal.piece_count as usize)
}

fn tolerance(largest: DVec3) -> f64 {
    LEAST_TOLERANCE_M.max(largest.max_element() * RELATIVE_TOLERANCE)
}

/// A piece made ready for questions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Opening {
    corners: [DVec3; PIECE_CORNERS],
    /// Unit vectors in the plane, across each edge, inwards; zero for an edge without length.
    inward: [DVec3; PIECE_CORNERS],
    count: usize,
    normal: DVec3,
    offset: f64,
    tolerance: f64,
}

impl Opening {
    fn new(piece: &PortalPieceRecord) -> Option<Self> {
        let count = piece.count as usize;
        if !(3..=PIECE_CORNERS).contains(&count) {
            return None;
        }
        let corners = piece.corners.map(|c| DVec3::from(c.map(f64::from)));
        let used = &corners[..count];
        if !used.iter().all(|c| c.is_finite()) {
            return None;
        }
        let fan = used.windows(2).skip(1).map(|w| (w[0] - used[0]).cross(w[1] - used[0]));
        let normal = fan.fold(DVec3::ZERO, |sum, n| sum + n).try_normalize()?;
        let middle = used.iter().fold(DVec3::ZERO, |sum, &c| sum + c) / count as f64;
        let largest = used.iter().fold(DVec3::ZERO, |m, c| m.max(c.abs()));
        let mut inward = [DVec3::ZERO; PIECE_CORNERS];
        for i in 0..count {
            inward[i] = normal.cross(used[(i + 1) % count] - used[i]).normalize_or_zero();
        }
        let tolerance = tolerance(largest);
        Some(Self { corners, inward, count, normal, offset: normal.dot(middle), tolerance })
    }

    fn edges(&self) -> impl Iterator<Item = (DVec3, DVec3, DVec3)> {
        (0..self.count)
            .map(|i| (self.corners[i], self.corners[(i + 1) % self.count], self.inward[i]))
    }

    /// Distance of a point from the polygon, m.
    fn distance(&self, point: DVec3) -> f64 {
        if self.edges().all(|(a, _, inward)| inward.dot(point - a) >= 0.0) {
            return (self.normal.dot(point) - self.offset).abs();
        }
        let to_edge = |(a, b, _): (DVec3, DVec3, DVec3)| {
            let along = b - a;
            let length2 = along.length_squared();
            let t = if length2 > 0.0 { (point - a).dot(along) / length2 } else { 0.0 };
            point.distance_squared(a + along * t.clamp(0.0, 1.0))
        };
        self.edges().map(to_edge).fold(f64::INFINITY, f64::min).sqrt()
    }

    /// Whether the segment touches the polygon, thickened and widened by the slack: the segment is
    /// clipped to the prism's half-spaces, and something must be left.
    pub(crate) fn passes(&self, a: DVec3, b: DVec3) -> bool {
        let (mut from, mut to) = (0.0f64, 1.0f64);
        let mut clip = |at_a: f64, at_b: f64| {
            if at_a < 0.0 && at_b < 0.0 {
                from = 2.0;
            } else if at_a < 0.0 {
                from = from.max(at_a / (at_a - at_b));
            } else if at_b < 0.0 {
                to = to.min(at_a / (at_a - at_b));
            }
            from <= to
        };
        let slack = self.tolerance;
        let (sa, sb) = (self.normal.dot(a) - self.offset, self.normal.dot(b) - self.offset);
        clip(sa + slack, sb + slack)
            && clip(slack - sa, slack - sb)
            && self.edges().all(|(corner, _, inward)| {
                clip(inward.dot(a - corner) + slack, inward.dot(b - corner) + slack)
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photon_map::tests_support::{door, opening};
    use proptest::prelude::*;

    #[test]
    fn distance_to_a_door_by_hand() {
        let (portals, pieces) = door(); // x = 2, y 1..2, z 0..2
        let set = PortalSet::new(&portals, &pieces);
        set.check().unwrap();
        for (point, distance) in [
            ([3.0, 1.5, 1.0], 1.0),          // in front of it
            ([1.5, 1.2, 0.3], 0.5),          // behind it
            ([2.0, 0.5, 1.0], 0.5),          // in its plane, beside it
            ([5.0, 5.0, 1.0], 18f32.sqrt()), // nearest an edge
            ([4.0, 4.0, 3.0], 3.0),          // nearest a corner: 2, 2, 1
        ] {
            let point = Vec3::from(point);
            assert!(set.near(point, distance + 1e-5), "{point}");
            assert!(!set.near(point, distance - 1e-5), "{point}");
        }
        assert!(!set.near(Vec3::NAN, 10.0));
    }

    #[test]
    fn segments_through_a_door_and_past_it() {
        let (portals, pieces) = door();
        let set = PortalSet::new(&portals, &pieces);
        let crosses = |a: [f32; 3], b: [f32; 3]| {
            let (a, b) = (Vec3::from(a), Vec3::from(b));
            assert_eq!(set.crosses(a, b), set.crosses(b, a));
            set.crosses(a, b)
        };
        assert!(crosses([1.0, 1.5, 1.0], [3.0, 1.5, 1.0]));
        assert!(crosses([1.0, 1.5, 0.0], [3.0, 1.5, 0.0]), "along the sill");
        assert!(crosses([1.0, 1.0, 0.0], [3.0, 1.0, 0.0]), "along the sill at the jamb");
        assert!(crosses([2.0, 1.5, 0.0], [3.0, 4.0, 0.0]), "starts in the opening");
        assert!(crosses([2.0, 0.0, 1.0], [2.0, 3.0, 1.0]), "in the plane of the opening");
        assert!(crosses([1.5, 1.5, -0.0005], [2.5, 1.5, -0.0005]), "rounding below the sill");
        assert!(!crosses([1.5, 1.5, -0.01], [2.5, 1.5, -0.01]), "below the sill");
        assert!(!crosses([1.0, 0.5, 1.0], [3.0, 0.5, 1.0]), "through the wall");
        assert!(!crosses([1.0, 1.5, 1.0], [1.9, 1.5, 1.0]), "stops before it");
        assert!(!crosses([1.0, 0.0, 0.0], [3.0, 1.5, 0.0]), "round the jamb");
        assert!(!crosses([2.0, 0.0, 1.0], [2.0, 0.9, 1.0]), "in the plane of the wall");
        assert!(!crosses([f32::NAN; 3], [3.0, 1.5, 1.0]));
    }

    #[test]
    fn bad_records_are_shut_and_named() {
        let (mut portals, mut pieces) = door();
        pieces[0].count = 9;
        let set = PortalSet::new(&portals, &pieces);
        assert_eq!(set.check(), Err(BadPortals::BadPiece { piece: 0, corners: 9 }));
        assert!(!set.crosses(Vec3::new(1.0, 1.5, 1.0), Vec3::new(3.0, 1.5, 1.0)));
        pieces[0].count = 4;
        pieces[0].corners[2] = [f32::INFINITY; 3];
        assert!(PortalSet::new(&portals, &pieces).check().is_err());
        portals[0].first_piece = u32::MAX;
        let set = PortalSet::new(&portals, &pieces);
        assert!(set.check().unwrap_err().to_string().contains("run the partition again"));
        assert!(!set.near(Vec3::new(2.0, 1.5, 1.0), 1.0));
    }

    proptest! {
        /// A clipped prism against the closed form for a rectangle.
        #[test]
        fn crossing_agrees_with_the_rectangle(
            a in prop::array::uniform3(-1.0f32..5.0), b in prop::array::uniform3(-1.0f32..5.0),
        ) {
            let (portals, pieces) = door();
            let set = PortalSet::new(&portals, &pieces);
            let (a, b) = (Vec3::from(a), Vec3::from(b));
            let t = (2.0 - a.x) / (b.x - a.x);
            let at = a + (b - a) * t;
            let margin = (at.y - 1.5).abs().max((at.z - 1.0).abs() * 0.5) - 0.5;
            // Leave out the slack, seen along the segment.
            let slack = 0.004 * (1.0 + (b - a).length() / (b.x - a.x).abs());
            prop_assume!(margin.abs() > slack && a.x != 2.0 && (a.x - 2.0).abs() > 0.01 && (b.x - 2.0).abs() > 0.01);
            prop_assert_eq!(set.crosses(a, b), (0.0..=1.0).contains(&t) && margin < 0.0);
        }

        /// Completeness: whatever a gather may count is in the halo.
        #[test]
        fn what_crosses_is_wanted(
            a in prop::array::uniform3(0.0f32..4.0), b in prop::array::uniform3(0.0f32..4.0),
        ) {
            let (portals, pieces) = door();
            let set = PortalSet::new(&portals, &pieces);
            let (a, b) = (Vec3::from(a), Vec3::from(b));
            let p = PhotonRecord { position_bits: b.to_array().map(f32::to_bits), ..Default::default() };
            if set.crosses(a, b) {
                prop_assert!(Halo::new(&set, a.distance(b)).wants(&p));
            }
        }

        /// The distance to a regular octagon lies between those to its two circles.
        #[test]
        fn octagon_lies_between_its_circles(p in prop::array::uniform3(-3.0f32..3.0)) {
            let corners: Vec<[f32; 3]> = (0..8)
                .map(|i| { let a = f64::from(i) * std::f64::consts::FRAC_PI_4; [libm::cos(a) as f32, libm::sin(a) as f32, 0.0] })
                .collect();
            let (portals, pieces) = opening(&corners);
            let set = PortalSet::new(&portals, &pieces);
            let p = Vec3::from(p);
            let to_disc = |r: f32| ((p.truncate().length() - r).max(0.0).powi(2) + p.z * p.z).sqrt();
            prop_assert!(set.near(p, to_disc(0.923) + 1e-4));
            prop_assert!(!set.near(p, to_disc(1.0) - 1e-4));
        }
    }
}
