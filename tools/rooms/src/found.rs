//! The rooms that were found, as questions: what is at this point, what opens between these rooms?

use enf_layout::bsp::{LEAF_OUTSIDE, LEAF_SOLID};
use enf_layout::room::PortalRecord;
use enf_rooms::Bsp;
use glam::DVec3;

/// What is at a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Place {
    /// A room, by its id.
    Room(u32),
    /// The open air.
    Outside,
    /// The inside of a wall.
    Solid,
}

/// What the comparison needs to know about a building.
pub trait Found {
    /// What is at a point of the architect's coordinates, m.
    fn at(&self, p: DVec3) -> Place;
    /// Open area between two rooms within 1.5 m of a point (`None` is the outside), m2: zero when the door is
    /// shut.
    fn opening(&self, rooms: [Option<u32>; 2], near: DVec3) -> f64;
}

/// Rooms in the tables of a partition.
pub struct Partitioned<'a> {
    /// The BSP.
    pub bsp: Bsp<'a>,
    /// Portals by room.
    pub portals: &'a [PortalRecord],
    /// The outside's room id, if there is an outside.
    pub outside: Option<u32>,
    /// What was subtracted from the coordinates, m.
    pub origin: [f64; 3],
    /// How far the building was turned about the z axis before it was partitioned, radians.
    pub turn: f64,
}

impl Partitioned<'_> {
    fn place(&self, p: DVec3) -> DVec3 {
        let (sin, cos) = (libm::sin(self.turn), libm::cos(self.turn));
        let turned = DVec3::new(p.x * cos - p.y * sin, p.x * sin + p.y * cos, p.z);
        turned - DVec3::from_array(self.origin)
    }
}

impl Found for Partitioned<'_> {
    fn at(&self, p: DVec3) -> Place {
        let Some(leaf) = self.bsp.leaves.get(self.bsp.locate(self.place(p)) as usize) else {
            return Place::Outside;
        };
        if leaf.flags & LEAF_SOLID != 0 {
            Place::Solid
        } else if leaf.flags & LEAF_OUTSIDE != 0 {
            Place::Outside
        } else {
            Place::Room(leaf.room)
        }
    }

    fn opening(&self, rooms: [Option<u32>; 2], near: DVec3) -> f64 {
        let [a, b] = rooms.map(|r| r.or(self.outside));
        let near = self.place(near);
        self.portals
            .iter()
            .filter(|p| Some(p.room) == a && Some(p.other) == b)
            .filter(|p| {
                let c = DVec3::new(p.centre[0].into(), p.centre[1].into(), p.centre[2].into());
                (c - near).length() < 1.5
            })
            .fold(0.0, |sum, p| sum + f64::from(p.area_m2))
    }
}
