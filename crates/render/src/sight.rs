//! Which lights of other rooms a point may see through an opening: a guess, so that the right lights are asked.
//!
//! A lamp in the corridor lights a strip of the floor behind an open door, and nothing else of the room. Chosen by its distance
//! alone it would be asked in vain nearly everywhere; chosen seldom, it would be a grain in the strip. So the straight way from
//! a point to the light's middle is held against the openings of the point's room, made soft by the light's size. Walls and furniture
//! are not asked, and a light that seems hidden keeps a share: nothing is biased by a guess that is wrong.

use enf_layout::room::{PIECE_CORNERS, PortalPieceRecord, PortalRecord};
use enf_rooms::Bsp;
use glam::Vec3;

use enf_transport::sky::Daylight;

use crate::choice::Choice;

/// What a light that seems hidden counts, of one that does not.
const HIDDEN: f32 = 0.1;
/// Openings that are held against the way to a light, at most: those that it shines on most.
const OPENINGS: usize = 6;
/// Bytes that a light takes at most.
pub(crate) const BYTES: u64 = (size_of::<Option<Light>>() + OPENINGS * size_of::<Opening>()) as u64;
/// Where there is more to choose from, nothing is held against anything: it would take long, and bytes.
const MANY: usize = 1024;
/// The softness of an opening's edge is no less, m.
const LEAST_BLUR_M: f32 = 0.02;
/// A point may lie so far on the wrong side of an opening, m: reveals are deep.
const REVEAL_M: f32 = 0.05;

/// A piece of an opening, as a rectangle about it.
#[derive(Clone, Copy, Debug)]
struct Opening {
    centre: Vec3,
    normal: Vec3,
    /// Unit vectors along its sides, and half of their lengths, m.
    sides: [Vec3; 2],
    half: [f32; 2],
}

impl Opening {
    /// `None` for what has no area.
    fn new(piece: &PortalPieceRecord) -> Option<Self> {
        let corners = piece.corners.get(..(piece.count as usize).min(PIECE_CORNERS))?;
        let corner = |i: usize| Vec3::from(corners[i % corners.len()]);
        let mut normal = Vec3::ZERO;
        let mut longest = Vec3::ZERO;
        for i in 0..corners.len() {
            normal += (corner(i) - corner(0)).cross(corner(i + 1) - corner(0));
            let side = corner(i + 1) - corner(i);
            if side.length_squared() > longest.length_squared() {
                longest = side;
            }
        }
        let normal = normal.try_normalize()?;
        let along = longest.try_normalize()?;
        let across = normal.cross(along);
        let extent = |side: Vec3| {
            (0..corners.len())
                .map(|i| corner(i).dot(side))
                .fold([f32::INFINITY, f32::NEG_INFINITY], |[least, most], at| {
                    [least.min(at), most.max(at)]
                })
        };
        let [a, b] = [along, across].map(extent);
        let level = normal.dot(corner(0));
        let middle = |e: [f32; 2]| 0.5 * (e[0] + e[1]);
        Some(Self {
            centre: along * middle(a) + across * middle(b) + normal * level,
            normal,
            sides: [along, across],
            half: [a, b].map(|e| 0.5 * (e[1] - e[0])),
        })
    }

    /// How much of a light is seen through it.
    fn shows(&self, light: &Light, point: Vec3) -> f32 {
        let here = self.normal.dot(point - self.centre);
        let there = self.normal.dot(light.position - self.centre);
        let side = there.signum();
        if here * side > REVEAL_M || there == 0.0 {
            return 0.0;
        }
        // Where the way passes the opening's plane.
        let t = (here / (here - there)).clamp(0.0, 1.0);
        let way = point + (light.position - point) * t - self.centre;
        let blur = (light.radius * t).max(LEAST_BLUR_M);
        let part = |at: f32, half: f32| {
            (((at + blur).min(half) - (at - blur).max(-half)) / (2.0 * blur)).clamp(0.0, 1.0)
        };
        part(way.dot(self.sides[0]), self.half[0]) * part(way.dot(self.sides[1]), self.half[1])
    }

    /// How much of what a light sends out may fall on it, up to a factor.
    fn gets(&self, light: &Light) -> f32 {
        let way = light.position - self.centre;
        let square = way.length_squared() + self.half[0] * self.half[1];
        self.half[0] * self.half[1] * way.dot(self.normal).abs() / (square * square.sqrt())
    }
}

/// A light in another room.
#[derive(Clone, Debug)]
struct Light {
    position: Vec3,
    radius: f32,
    /// Openings that it may shine through.
    through: Vec<Opening>,
}

/// What a room's lights are seen through.
#[derive(Debug, Default)]
pub(crate) struct Sights(Vec<Option<Light>>);

impl Sights {
    /// For what a room's points choose from, in its order. `portals` are the room's.
    pub(crate) fn new(
        room: u32,
        lights: &[Choice],
        portals: &[PortalRecord],
        pieces: &[PortalPieceRecord],
        bsp: &Bsp<'_>,
    ) -> Self {
        if lights.len() > MANY {
            return Self::default();
        }
        let of = |p: &PortalRecord| {
            let first = p.first_piece as usize;
            pieces.get(first..first + p.piece_count as usize).unwrap_or(&[])
        };
        let openings: Vec<Opening> = portals.iter().flat_map(of).filter_map(Opening::new).collect();
        let sight = |choice: &Choice| {
            let light = &choice.part;
            if Daylight::is_daylight(light) || openings.is_empty() {
                return None;
            }
            let position = Vec3::from(light.position);
            // A lamp's face lies in a wall, maybe; what is before it is what counts.
            let before = position + Vec3::from(light.axis).normalize_or_zero() * LEAST_BLUR_M;
            if bsp.leaves[bsp.locate(before.as_dvec3()) as usize].room == room {
                return None;
            }
            let mut light = Light { position, radius: light.radius, through: Vec::new() };
            let mut best: Vec<(f32, usize)> =
                openings.iter().map(|o| o.gets(&light)).zip(0..).collect();
            best.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            light.through = best.iter().take(OPENINGS).map(|&(_, at)| openings[at]).collect();
            Some(light)
        };
        Self(lights.iter().map(sight).collect())
    }

    /// How much a light counts at a point, by its place among the choices: its `share` if it is in the room. Without a point, what it
    /// counts where it seems hidden.
    #[inline]
    pub(crate) fn share(&self, light: usize, share: f32, point: Option<Vec3>) -> f32 {
        match (self.0.get(light), point) {
            (Some(Some(_)), None) => HIDDEN,
            (Some(Some(light)), Some(point)) => {
                let seen: f32 = light.through.iter().map(|o| o.shows(light, point)).sum();
                HIDDEN + (1.0 - HIDDEN) * seen.min(1.0)
            }
            _ => share,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A door of 1 m by 2 m in the plane x = 0.
    fn door() -> PortalPieceRecord {
        let mut corners = [[0.0; 3]; PIECE_CORNERS];
        let sides = [[1.0, 0.0], [2.0, 0.0], [2.0, 2.0], [1.0, 2.0]];
        corners.iter_mut().zip(sides).for_each(|(corner, [y, z])| *corner = [0.0, y, z]);
        PortalPieceRecord { corners, count: 4, area_m2: 2.0, reserved: [0; 2] }
    }

    #[test]
    fn a_lamp_is_seen_through_a_door() {
        let door = Opening::new(&door()).unwrap();
        assert!((door.centre - Vec3::new(0.0, 1.5, 1.0)).length() < 1e-6);
        let lamp =
            |radius| Light { position: Vec3::new(-2.0, 1.5, 2.5), radius, through: vec![door] };
        let at = |light: &Light, x: f32, y: f32, z: f32| door.shows(light, Vec3::new(x, y, z));
        // The way to the strip of floor, to beside it, to the wall above the door, to the corridor's own floor.
        let small = lamp(0.0);
        assert!((at(&small, 2.0, 1.5, 0.0) - 1.0).abs() < 1e-5);
        assert_eq!(at(&small, 2.0, 1.5, 1.6), 0.0);
        assert_eq!(at(&small, 2.0, 4.5, 0.0), 0.0);
        assert_eq!(at(&small, -1.0, 1.5, 0.0), 0.0);
        // In the reveal, and where half of it is behind the jamb: at y = 2 half way.
        assert!((at(&small, -0.03, 1.5, 0.5) - 1.0).abs() < 1e-5);
        assert!((at(&small, 2.0, 2.5, 0.0) - 0.5).abs() < 1e-3);
        // A wider one fades in over more, and is seen in part through what is narrower than it.
        let wide = lamp(0.8);
        assert!((at(&wide, 2.0, 2.9, 0.0) - 0.25).abs() < 1e-3);
        assert!(at(&lamp(4.0), 2.0, 1.5, 0.0) < 0.5);
        let sights = Sights(vec![Some(small), None]);
        let (floor, beside) = (Vec3::new(2.0, 1.5, 0.0), Vec3::new(2.0, 4.5, 0.0));
        assert!((sights.share(0, 0.3, Some(floor)) - 1.0).abs() < 1e-5);
        assert!((sights.share(0, 0.3, Some(beside)) - HIDDEN).abs() < 1e-6);
        assert_eq!(sights.share(1, 0.3, Some(beside)), 0.3);
    }

    #[test]
    fn what_is_no_opening_is_none() {
        let mut piece = door();
        piece.count = 0;
        assert!(Opening::new(&piece).is_none());
        piece.count = 400;
        piece.corners = [[1.0; 3]; PIECE_CORNERS];
        assert!(Opening::new(&piece).is_none());
    }
}
