//! One floor of a large building as data: rooms of convex pieces, openings at any angle, lamps.
//!
//! A storey is drawn once and built as often as the building has such floors. Heights are above
//! its own floor. Walls are whatever is left between the rooms; a doorway is an opening through
//! the wall between two rooms, a window one to the outside.

use crate::fittings::{FLIGHT, RUN, WELL};
use crate::mesh::Paint;
use crate::outline::{Convex, Frame, boundary};
use crate::plan::{Filling, Leaf, Panel, Side};
use glam::DVec2;

/// Floor to floor, metres: exact in binary, so that storeys meet to the bit.
pub const HEIGHT: f64 = 3.25;
/// Floor to ceiling, metres.
pub const CEILING: f64 = 2.875;
/// Thickness of walls between rooms, metres.
pub const WALL: f64 = 0.15;
/// Thickness of outer walls, metres.
pub const OUTER: f64 = 0.3;

/// What a room is for. It decides what stands in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Use {
    /// Desks in islands, shelves.
    Office,
    /// A long table with chairs.
    Meeting,
    /// Sofas, books, plants.
    Lounge,
    /// A hotel bedroom.
    Bedroom,
    /// Bathtub, washbasin, toilet.
    Bath,
    /// Washbasins and toilets for many.
    Washroom,
    /// Units along the walls, a table.
    Kitchen,
    /// Racks and cartons.
    Store,
    /// Stairs between the storeys.
    Stair,
    /// Pictures, benches, plants.
    Corridor,
    /// Lift doors.
    Lift,
    /// Book stacks and reading tables.
    Library,
    /// Rows of seats.
    Auditorium,
    /// Many small tables.
    Restaurant,
    /// Easels, workbenches.
    Studio,
    /// Reception.
    Lobby,
}

/// The luminaires of a room.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Shape of a panel.
    pub panel: Panel,
    /// Where the panels hang, in plan.
    pub points: Vec<DVec2>,
    /// Whether each panel is a luminaire of its own; otherwise a rail joins them into one.
    pub each: bool,
    /// Turn of the panels, degrees.
    pub turn: f64,
    /// Colour of the light, the greatest component 1.
    pub colour: [f64; 3],
}

/// A room of a storey.
#[derive(Clone, Debug, PartialEq)]
pub struct Space {
    /// Name, unique in the storey.
    pub name: String,
    /// What it is for.
    pub use_: Use,
    /// Clear plan; pieces touch along whole or partial sides.
    pub pieces: Vec<Convex>,
    /// The piece that has no slab between this storey and its neighbours above and below.
    pub well: Option<usize>,
    /// Floor covering.
    pub floor: Paint,
    /// Walls; every third one has the second paint.
    pub walls: [Paint; 2],
    /// Its luminaires.
    pub light: Option<Light>,
    /// Triangles that its furniture should have, relative to other rooms (`Share`), or in number.
    pub weight: Weight,
    /// Turn of its main direction, degrees.
    pub turn: f64,
}

/// How much furniture a room gets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Weight {
    /// A share of what the storey has left.
    Share(f64),
    /// About so many triangles.
    Triangles(u64),
}

impl Space {
    /// Floor area, square metres.
    pub fn area(&self) -> f64 {
        self.pieces.iter().map(Convex::area).sum()
    }

    /// Whether the point is in one of its pieces, or at most `slack` metres outside.
    pub fn holds(&self, p: DVec2, slack: f64) -> bool {
        self.pieces.iter().any(|c| c.holds(p, slack))
    }

    /// Its walls in plan, the room on their left.
    pub fn walls(&self) -> Vec<(DVec2, DVec2)> {
        boundary(&self.pieces)
    }
}

/// An opening through a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    /// Middle of the opening in plan; local x runs along the wall.
    pub frame: Frame,
    /// Width, metres.
    pub width: f64,
    /// Thickness of the wall, metres.
    pub thick: f64,
    /// Bottom and top above the floor, metres.
    pub height: (f64, f64),
    /// What fills it; a leaf that opens north opens towards local +y.
    pub filling: Filling,
}

impl Gap {
    /// The opening in plan, `beyond` metres longer on both sides of the wall.
    pub fn outline(&self, beyond: f64) -> Convex {
        let (w, t) = (self.width / 2.0, self.thick / 2.0 + beyond);
        self.frame.rect(-w, -t, w, t)
    }

    /// Whether one walks through it.
    pub fn is_passage(&self) -> bool {
        matches!(self.filling, Filling::Doorway(_) | Filling::Entrance | Filling::Shut(_))
    }
}

/// One floor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Storey {
    /// Its rooms.
    pub spaces: Vec<Space>,
    /// Its openings.
    pub gaps: Vec<Gap>,
    /// Flights of stairs: the foot's left end; local x runs across, y up the flight.
    pub flights: Vec<Frame>,
    /// Triangles that the whole storey should have.
    pub triangles: u64,
    /// Viewpoints in plan: nothing may stand there.
    pub eyes: Vec<DVec2>,
}

/// The rectangle `x0..x1` by `y0..y1` of a frame in pieces of at most `most` metres.
pub fn cells(f: &Frame, (x0, y0, x1, y1): (f64, f64, f64, f64), most: f64) -> Vec<Convex> {
    let count = |length: f64| libm::ceil(length / most).max(1.0);
    let (nx, ny) = (count(x1 - x0), count(y1 - y0));
    let mut out = Vec::new();
    for j in 0..ny as usize {
        for i in 0..nx as usize {
            let x = |i: usize| x0 + (x1 - x0) * i as f64 / nx;
            let y = |j: usize| y0 + (y1 - y0) * j as f64 / ny;
            out.push(f.rect(x(i), y(j), x(i + 1), y(j + 1)));
        }
    }
    out
}

/// How a doorway is closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Door {
    /// No leaf.
    None,
    /// A leaf that stands open to local +y or -y.
    Open(bool),
    /// A leaf that is shut.
    Shut,
}

/// Paints of a room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scheme(pub Paint, pub Paint, pub Paint);

impl Storey {
    /// Adds a room and returns its index.
    pub fn space(
        &mut self,
        name: impl Into<String>,
        use_: Use,
        pieces: Vec<Convex>,
        turn: f64,
        weight: Weight,
    ) -> usize {
        let Scheme(floor, a, b) = scheme(use_, self.spaces.len());
        self.spaces.push(Space {
            name: name.into(),
            use_,
            pieces,
            well: None,
            floor,
            walls: [a, b],
            light: None,
            weight,
            turn,
        });
        self.spaces.len() - 1
    }

    /// A doorway of 0.9 x 2.1 m at local `(x, y)`, in a wall along local x or y.
    pub fn door(&mut self, f: &Frame, (x, y): (f64, f64), along_x: bool, thick: f64, door: Door) {
        let n = self.gaps.len();
        let paint = ["door.oak", "door.white", "door.blue"][n % 3];
        let filling = match door {
            Door::None => Filling::Doorway(None),
            Door::Shut => Filling::Shut(paint),
            Door::Open(up) => Filling::Doorway(Some(Leaf {
                into: if up { Side::North } else { Side::South },
                hinge_low: n.is_multiple_of(2),
                angle: 82.0 + (n * 7 % 15) as f64,
                paint,
            })),
        };
        self.gap(f, (x, y), along_x, 0.9, thick, (0.0, 2.1), filling);
    }

    /// A window in an outer wall.
    pub fn window(&mut self, f: &Frame, at: (f64, f64), along_x: bool, width: f64) {
        let sashes = if width > 1.5 { 3 } else { 2 };
        self.gap(f, at, along_x, width, OUTER, (0.85, 2.35), Filling::Window { sashes });
    }

    /// A room with a flight of stairs along its west wall in the frame `f`, rising along local y:
    /// `x0..x1` by `y0..y0 + length`. The well over the flight is a piece of its own.
    pub fn stair(
        &mut self,
        name: &str,
        f: &Frame,
        (x0, x1): (f64, f64),
        y0: f64,
        length: f64,
    ) -> usize {
        let foot = y0 + (length - RUN) / 2.0;
        let x = x0 + FLIGHT + 0.04;
        let (low, high) = (foot + WELL, foot + RUN + 0.005);
        let pieces = vec![
            f.rect(x, y0, x1, y0 + length),
            f.rect(x0, y0, x, low),
            f.rect(x0, low, x, high),
            f.rect(x0, high, x, y0 + length),
        ];
        let turn = f.turn;
        let room = self.space(name, Use::Stair, pieces, turn, Weight::Share(4.0));
        self.spaces[room].well = Some(2);
        self.flights.push(Frame { origin: f.point(x0 + 0.02, foot), turn });
        room
    }

    /// Any opening.
    #[expect(clippy::too_many_arguments, reason = "a drawing is a list of numbers")]
    pub fn gap(
        &mut self,
        f: &Frame,
        (x, y): (f64, f64),
        along_x: bool,
        width: f64,
        thick: f64,
        height: (f64, f64),
        filling: Filling,
    ) {
        let turn = f.turn + if along_x { 0.0 } else { 90.0 };
        let frame = Frame { origin: f.point(x, y), turn };
        self.gaps.push(Gap { frame, width, thick, height, filling });
    }
}

/// Colours by use, varied from room to room.
fn scheme(use_: Use, k: usize) -> Scheme {
    let bold =
        ["wall.blue", "wall.terracotta", "wall.green", "wall.ochre", "wall.teal", "wall.red"]
            [k % 6];
    let soft = ["wall.cream", "wall.white", "wall.sand", "wall.sage", "wall.sky"][k % 5];
    match use_ {
        Use::Office => {
            Scheme(["carpet.grey", "carpet.blue", "carpet.green"][k % 3], "wall.white", bold)
        }
        Use::Meeting => Scheme("carpet.blue", "wall.cream", bold),
        Use::Lounge => Scheme("floor.oak", soft, bold),
        Use::Bedroom => Scheme(["floor.oak", "floor.walnut", "carpet.wine"][k % 3], soft, bold),
        Use::Bath | Use::Washroom => Scheme("floor.tile", "tile.white", "tile.aqua"),
        Use::Kitchen => Scheme("floor.terracotta", "wall.cream", "tile.white"),
        Use::Store => Scheme("floor.concrete", "wall.white", "wall.white"),
        Use::Stair => Scheme("floor.stone", "wall.white", "wall.ochre"),
        Use::Corridor => Scheme("floor.stone", "wall.cream", "wall.white"),
        Use::Lift => Scheme("stone.polished", "wall.sand", "wall.plum"),
        Use::Library => Scheme("floor.walnut", "wall.cream", "wall.green"),
        Use::Auditorium => Scheme("carpet.wine", "wall.sand", "wall.red"),
        Use::Restaurant => Scheme("floor.parquet", "wall.cream", "wall.terracotta"),
        Use::Studio => Scheme("floor.maple", "wall.white", "wall.ochre"),
        Use::Lobby => Scheme("stone.polished", "wall.white", "wall.teal"),
    }
}
