//! The drawing: rooms, doorways and windows as data, before a single wall stands.
//!
//! Plan coordinates are metres, x to the east, y to the north, z up, the ground floor at z = 0.
//! A room is given by its clear inside; walls are whatever is left of the footprint.

use crate::mesh::Paint;
use crate::outline::Convex;
use glam::{DVec2, DVec3};

/// Floor to floor, metres.
pub const STOREY: f64 = 3.1;
/// Floor to ceiling, metres.
pub const CLEAR: f64 = 2.8;
/// Height of the lawn, metres.
pub const LAWN: f64 = -0.15;

/// An axis-aligned rectangle in plan, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rect {
    /// West edge.
    pub x0: f64,
    /// South edge.
    pub y0: f64,
    /// East edge.
    pub x1: f64,
    /// North edge.
    pub y1: f64,
}

impl Rect {
    /// The rectangle `x0..x1` by `y0..y1`.
    pub const fn new(x0: f64, y0: f64, x1: f64, y1: f64) -> Self {
        Self { x0, y0, x1, y1 }
    }

    /// Square metres.
    pub fn area(&self) -> f64 {
        (self.x1 - self.x0) * (self.y1 - self.y0)
    }

    /// Whether the point lies inside or on the edge, to within `slack` metres.
    pub fn holds(&self, x: f64, y: f64, slack: f64) -> bool {
        x >= self.x0 - slack && x <= self.x1 + slack && y >= self.y0 - slack && y <= self.y1 + slack
    }
}

/// A compass side of a room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Towards -x.
    West,
    /// Towards +x.
    East,
    /// Towards -y.
    South,
    /// Towards +y.
    North,
}

/// A ceiling luminaire: one light.
#[derive(Clone, Debug, PartialEq)]
pub struct Lamp {
    /// The shape of one panel.
    pub panel: Panel,
    /// Where the panels hang, in plan; one slim rail joins them.
    pub points: Vec<(f64, f64)>,
    /// Whether 0.3 x 1.2 m panels run along y instead of x.
    pub along_y: bool,
    /// Ceiling height, metres.
    pub z: f64,
    /// Luminous flux of a whole luminaire, lumens.
    pub lumens: f64,
    /// How many luminaires there are: one over all points, or one at each.
    pub count: u32,
    /// Colour of the light, the greatest component 1.
    pub colour: [f64; 3],
}

/// The shape of a luminous panel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Panel {
    /// 0.6 x 0.6 m.
    Square,
    /// 1.2 x 0.3 m.
    Long,
    /// 0.5 m across.
    Round,
}

/// One room of the ground truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Room {
    /// Unique name, `ground/library`.
    pub name: String,
    /// 0 is the ground floor; the stairwell stands on 0.
    pub storey: u32,
    /// Clear plan; corridors have several rectangles.
    pub rects: Vec<Rect>,
    /// Clear heights: floor and ceiling, metres.
    pub height: (f64, f64),
    /// Further clear boxes (plan, low z, high z): the stairwell's storeys and slab openings.
    pub shafts: Vec<(Rect, f64, f64)>,
    /// Clear plan of a room whose walls may run at any angle, instead of `rects`.
    pub pieces: Vec<Convex>,
    /// Floor covering.
    pub floor: Paint,
    /// Walls to the west, east, south, north.
    pub walls: [Paint; 4],
    /// Index of its luminaire, if it is lit.
    pub lamp: Option<Lamp>,
}

impl Room {
    /// Floor area, square metres.
    pub fn area(&self) -> f64 {
        self.rects.iter().map(Rect::area).chain(self.pieces.iter().map(Convex::area)).sum()
    }

    /// Whether the point is in the room, at least `margin` metres from what bounds it (from the
    /// outline of each rectangle, for corridors).
    pub fn holds(&self, p: DVec3, margin: f64) -> bool {
        let tall = p.z >= self.height.0 + margin && p.z <= self.height.1 - margin;
        let plan = DVec2::new(p.x, p.y);
        let inside = || {
            self.rects.iter().any(|r| r.holds(p.x, p.y, -margin))
                || self.pieces.iter().any(|c| c.holds(plan, -margin))
        };
        (tall && inside())
            || self.shafts.iter().any(|(r, low, high)| {
                p.z >= low + margin && p.z <= high - margin && r.holds(p.x, p.y, -margin)
            })
    }
}

/// What fills an opening in a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Filling {
    /// A passage with a cased frame and, perhaps, a leaf that stands open.
    Doorway(Option<Leaf>),
    /// A framed window; `sashes` side by side.
    Window {
        /// Number of panes side by side.
        sashes: u32,
    },
    /// A fixed glass screen between rooms.
    Screen {
        /// Number of panes side by side.
        sashes: u32,
    },
    /// A glazed double door to the outside, shut.
    Entrance,
    /// A doorway whose leaf is shut.
    Shut(Paint),
}

/// A door leaf that stands open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leaf {
    /// Side of the wall that it opens to.
    pub into: Side,
    /// Whether the hinge is at the low end (west or south jamb) of the opening.
    pub hinge_low: bool,
    /// Opening angle, degrees.
    pub angle: f64,
    /// Paint of the leaf.
    pub paint: Paint,
}

/// An opening through a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opening {
    /// Whether the wall runs along x (and is crossed along y).
    pub along_x: bool,
    /// The wall's two faces, on the axis that crosses it.
    pub band: (f64, f64),
    /// The opening's extent along the wall.
    pub span: (f64, f64),
    /// Bottom and top, world z.
    pub height: (f64, f64),
    /// What fills it.
    pub filling: Filling,
}

impl Opening {
    /// The opening in plan.
    pub fn rect(&self) -> Rect {
        let ((a, b), (c, d)) = (self.span, self.band);
        if self.along_x { Rect::new(a, c, b, d) } else { Rect::new(c, a, d, b) }
    }

    /// Whether one walks through it.
    pub fn is_passage(&self) -> bool {
        matches!(self.filling, Filling::Doorway(_) | Filling::Entrance | Filling::Shut(_))
    }
}

/// A camera. World coordinates, metres, z up.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Unique name.
    pub name: String,
    /// Viewpoint.
    pub eye: DVec3,
    /// What stands in the middle of the picture.
    pub target: DVec3,
    /// Vertical field of view, degrees.
    pub fov: f64,
    /// Pixels.
    pub size: (u32, u32),
}

/// A whole drawing.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Name of the building.
    pub name: &'static str,
    /// Outer faces of the outer walls.
    pub footprint: Vec<Rect>,
    /// Number of storeys.
    pub storeys: u32,
    /// Rooms, ground truth of what a partitioner should find.
    pub rooms: Vec<Room>,
    /// Doorways, windows, glass screens.
    pub openings: Vec<Opening>,
    /// Cameras.
    pub views: Vec<View>,
}

impl Plan {
    /// The index of the room called `name`.
    pub fn room(&self, name: &str) -> Option<usize> {
        self.rooms.iter().position(|r| r.name == name)
    }

    /// The index of the room that holds `p`.
    pub fn room_at(&self, p: DVec3) -> Option<usize> {
        self.rooms.iter().position(|r| r.holds(p, 0.0))
    }
}
