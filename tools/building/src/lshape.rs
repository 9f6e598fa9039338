//! The drawing of the L-shape: an institute downstairs, apartments upstairs.
//!
//! ```text
//!  north   +-----------------+
//!          |     library     |          upstairs: games room
//!          +------+--+-------+
//!          |studio|  |washroom|         bedroom | guest room
//!          |      |h |store   |
//!          +------+a +---+---+--+-------+------+
//!          |kitchen l|   meet|st|archive|      |   kitchen | bath, dressing | stairs | nursery | atelier
//!          +------+  l   |   |  |       |confe-|
//!          |canteen +----+---+--+-------+rence |
//!          |      |lobby |office |office|      |   living, salon, study, bedroom: an enfilade
//!          +------+------+-------+------+------+  east
//! ```

use crate::lamps::{LUMENS_PER_AREA, NEUTRAL, WARM};
use crate::mesh::{Paint, v};
use crate::plan::{
    CLEAR, Filling, Lamp, Leaf, Opening, Panel, Plan, Rect, Room, STOREY, Side, View,
};

/// Where the rooms' clear insides begin and end.
mod line {
    /// South and west outer walls.
    pub(super) const OUT: (f64, f64) = (0.0, 0.3);
    /// Between the outer rows and the corridor.
    pub(super) const ROW: (f64, f64) = (5.2, 5.35);
    /// Between the corridor and the inner rows.
    pub(super) const INNER: (f64, f64) = (7.25, 7.4);
    /// The end rooms' inner walls: north end, east end.
    pub(super) const NORTH_END: (f64, f64) = (17.7, 17.85);
    pub(super) const EAST_END: (f64, f64) = (18.3, 18.45);
    /// The outer walls of the inner corner.
    pub(super) const NOTCH: (f64, f64) = (12.2, 12.5);
    /// The outer walls at the far ends.
    pub(super) const FAR_NORTH: (f64, f64) = (22.7, 23.0);
    pub(super) const FAR_EAST: (f64, f64) = (23.4, 23.7);
}

/// The stairwell's slab opening begins here (y); south of it is the landing.
pub const STAIR_OPENING: f64 = 8.6;

/// What a floor is called in the names of its rooms.
pub(crate) fn floor_name(storey: u32) -> String {
    match storey {
        0 => "ground".to_owned(),
        1 => "upper".to_owned(),
        n => format!("floor-{n}"),
    }
}

struct Draw {
    rooms: Vec<Room>,
    openings: Vec<Opening>,
    storey: u32,
}

impl Draw {
    fn floor(&self) -> f64 {
        STOREY * f64::from(self.storey)
    }

    fn room(&mut self, name: &str, rects: &[Rect], floor: Paint, walls: [Paint; 4]) -> &mut Room {
        let z = self.floor();
        let prefix = floor_name(self.storey);
        self.rooms.push(Room {
            name: format!("{prefix}/{name}"),
            storey: self.storey,
            rects: rects.to_vec(),
            height: (z, z + CLEAR),
            shafts: Vec::new(),
            pieces: Vec::new(),
            floor,
            walls,
            lamp: None,
        });
        let last = self.rooms.len() - 1;
        &mut self.rooms[last]
    }

    fn open(
        &mut self,
        along_x: bool,
        band: (f64, f64),
        (centre, width): (f64, f64),
        (low, high): (f64, f64),
        filling: Filling,
    ) {
        let z = self.floor();
        let span = (centre - width / 2.0, centre + width / 2.0);
        self.openings.push(Opening { along_x, band, span, height: (z + low, z + high), filling });
    }

    /// A doorway of 0.9 x 2.1 m without a leaf.
    fn passage(&mut self, along_x: bool, band: (f64, f64), centre: f64) {
        self.open(along_x, band, (centre, 0.9), (0.0, 2.1), Filling::Doorway(None));
    }

    /// A doorway of 0.9 x 2.1 m whose leaf stands open.
    fn door(&mut self, along_x: bool, band: (f64, f64), centre: f64, leaf: Leaf) {
        self.open(along_x, band, (centre, 0.9), (0.0, 2.1), Filling::Doorway(Some(leaf)));
    }

    fn windows(&mut self, along_x: bool, band: (f64, f64), at: &[(f64, f64)]) {
        for &(centre, width) in at {
            let sashes = if width > 1.5 { 3 } else { 2 };
            let filling = Filling::Window { sashes };
            self.open(along_x, band, (centre, width), (0.9, 2.35), filling);
        }
    }
}

impl Room {
    /// Hangs a luminaire with its panels at `points`.
    fn light(&mut self, panel: Panel, along_y: bool, points: &[(f64, f64)], colour: [f64; 3]) {
        // A hundred lumens are as exact as a catalogue gets.
        let lumens = (self.area() * LUMENS_PER_AREA / 100.0).round() * 100.0;
        let z = self.height.1;
        self.lamp =
            Some(Lamp { panel, points: points.to_vec(), along_y, z, lumens, count: 1, colour });
    }
}

const fn leaf(into: Side, hinge_low: bool, angle: f64, paint: Paint) -> Leaf {
    Leaf { into, hinge_low, angle, paint }
}

/// The L-shape with `storeys` floors, at least one.
pub fn plan(storeys: u32) -> Plan {
    let mut d = Draw { rooms: Vec::new(), openings: Vec::new(), storey: 0 };
    for storey in 0..storeys {
        d.storey = storey;
        common(&mut d);
        if storey == 0 {
            ground(&mut d);
        } else {
            upper(&mut d);
        }
    }
    stairwell(&mut d, storeys);
    Plan {
        name: "l-shape",
        footprint: vec![Rect::new(0.0, 0.0, 23.7, 12.5), Rect::new(0.0, 0.0, 12.5, 23.0)],
        storeys,
        rooms: d.rooms,
        openings: d.openings,
        views: views(storeys),
    }
}

/// The corridor and what is the same on every floor.
fn common(d: &mut Draw) {
    use line::{FAR_EAST, FAR_NORTH, INNER, NOTCH, OUT, ROW};
    let hall = [Rect::new(5.35, 5.35, 18.3, 7.25), Rect::new(5.35, 7.25, 7.25, 17.7)];
    let (floor, walls): (Paint, [Paint; 4]) = if d.storey == 0 {
        ("floor.stone", ["wall.cream", "wall.cream", "wall.cream", "wall.ochre"])
    } else {
        ("floor.oak", ["wall.white", "wall.white", "wall.white", "wall.sky"])
    };
    d.room("hall", &hall, floor, walls).light(
        Panel::Square,
        false,
        &[(6.3, 15.9), (6.3, 12.9), (6.3, 9.6), (6.3, 6.3), (9.6, 6.3), (12.6, 6.3), (15.9, 6.3)],
        WARM,
    );
    // South and west fronts.
    d.windows(true, OUT, &[(1.6, 1.4), (3.9, 1.4)]);
    d.windows(false, OUT, &[(1.9, 1.4), (4.9, 1.4), (9.8, 1.8), (15.0, 1.8)]);
    d.windows(true, OUT, &[(12.1, 1.8), (16.27, 1.8)]);
    d.windows(true, OUT, &[(20.0, 1.4), (22.0, 1.4)]);
    // East, north, and the two fronts of the inner corner.
    d.windows(false, FAR_EAST, &[(2.2, 1.8), (6.25, 1.8), (10.2, 1.8)]);
    d.windows(true, FAR_NORTH, &[(2.4, 1.8), (6.25, 1.8), (10.1, 1.8)]);
    d.windows(false, OUT, &[(20.25, 1.4)]);
    d.windows(false, NOTCH, &[(20.25, 1.4), (16.1, 1.2)]);
    d.windows(true, NOTCH, &[(16.75, 1.4), (21.0, 1.4)]);
    // Stairs, and the rooms at the corridor's ends.
    d.passage(true, INNER, 13.0);
    d.passage(true, line::NORTH_END, 6.3);
    d.passage(false, line::EAST_END, 6.3);
    d.passage(false, ROW, 6.3);
}

fn ground(d: &mut Draw) {
    use Side::{East, North, South, West};
    use line::{INNER, OUT, ROW};
    let four = |a: Paint| [a; 4];
    d.room(
        "canteen",
        &[Rect::new(0.3, 0.3, 5.2, 7.25)],
        "floor.terracotta",
        ["wall.cream", "wall.cream", "wall.cream", "wall.terracotta"],
    )
    .light(Panel::Round, false, &[(2.75, 1.9), (2.75, 3.8), (2.75, 5.7)], WARM);
    d.room(
        "lobby",
        &[Rect::new(5.35, 0.3, 9.95, 5.2)],
        "floor.stone",
        ["wall.white", "wall.white", "wall.white", "wall.teal"],
    )
    .light(Panel::Round, false, &[(6.55, 2.75), (8.75, 2.75)], WARM);
    d.room(
        "office-1",
        &[Rect::new(10.1, 0.3, 14.1, 5.2)],
        "carpet.grey",
        ["wall.white", "wall.blue", "wall.white", "wall.white"],
    )
    .light(Panel::Long, false, &[(12.1, 1.9), (12.1, 3.6)], NEUTRAL);
    d.room(
        "office-2",
        &[Rect::new(14.25, 0.3, 18.3, 5.2)],
        "carpet.grey",
        ["wall.white", "wall.white", "wall.white", "wall.green"],
    )
    .light(Panel::Long, false, &[(16.3, 1.9), (16.3, 3.6)], NEUTRAL);
    d.room(
        "conference",
        &[Rect::new(18.45, 0.3, 23.4, 12.2)],
        "carpet.blue",
        ["wall.white", "wall.cream", "wall.cream", "wall.red"],
    )
    .light(
        Panel::Long,
        true,
        &[(20.95, 1.9), (20.95, 4.1), (20.95, 6.3), (20.95, 8.5), (20.95, 10.7)],
        NEUTRAL,
    );
    d.room(
        "meeting",
        &[Rect::new(7.4, 7.4, 12.2, 12.2)],
        "carpet.green",
        ["wall.white", "wall.ochre", "wall.white", "wall.white"],
    )
    .light(Panel::Square, false, &[(8.9, 9.8), (10.7, 9.8)], NEUTRAL);
    d.room("archive", &[Rect::new(15.2, 7.4, 18.3, 12.2)], "floor.concrete", four("wall.white"));
    d.room(
        "kitchen",
        &[Rect::new(0.3, 7.4, 5.2, 12.2)],
        "floor.tile",
        ["wall.white", "wall.white", "wall.white", "tile.aqua"],
    )
    .light(Panel::Square, false, &[(1.9, 9.8), (3.6, 9.8)], NEUTRAL);
    d.room(
        "studio",
        &[Rect::new(0.3, 12.35, 5.2, 17.7)],
        "floor.maple",
        ["wall.white", "wall.white", "wall.ochre", "wall.white"],
    )
    .light(Panel::Long, true, &[(1.75, 15.0), (3.75, 15.0)], NEUTRAL);
    d.room("store", &[Rect::new(7.4, 12.35, 12.2, 14.35)], "floor.concrete", four("wall.white"));
    d.room(
        "washroom",
        &[Rect::new(7.4, 14.5, 12.2, 17.7)],
        "floor.tile",
        ["tile.white", "tile.white", "tile.white", "tile.aqua"],
    )
    .light(Panel::Round, false, &[(9.0, 16.1), (10.9, 16.1)], NEUTRAL);
    d.room(
        "library",
        &[Rect::new(0.3, 17.85, 12.2, 22.7)],
        "floor.walnut",
        ["wall.green", "wall.cream", "wall.cream", "wall.cream"],
    )
    .light(
        Panel::Square,
        false,
        &[(1.9, 20.3), (4.1, 20.3), (6.25, 20.3), (8.4, 20.3), (10.6, 20.3)],
        WARM,
    );
    // The enfilade of the south front.
    d.passage(false, ROW, 1.5);
    d.passage(false, (9.95, 10.1), 1.5);
    d.passage(false, (14.1, 14.25), 1.5);
    // Off the corridor.
    d.passage(true, INNER, 4.2);
    d.passage(true, ROW, 8.6);
    d.door(true, ROW, 13.2, leaf(South, false, 92.0, "door.oak"));
    d.door(true, ROW, 15.2, leaf(South, true, 88.0, "door.oak"));
    d.door(true, INNER, 11.2, leaf(North, false, 90.0, "door.oak"));
    d.door(true, INNER, 16.2, leaf(North, true, 95.0, "door.white"));
    d.door(false, ROW, 11.4, leaf(West, false, 84.0, "door.white"));
    d.door(false, ROW, 13.4, leaf(West, true, 93.0, "door.oak"));
    d.door(false, INNER, 13.6, leaf(East, false, 86.0, "door.white"));
    d.door(false, INNER, 15.3, leaf(East, true, 97.0, "door.white"));
    d.open(true, OUT, (7.65, 1.7), (0.0, 2.3), Filling::Entrance);
    d.open(false, INNER, (9.6, 2.0), (0.35, 2.35), Filling::Screen { sashes: 2 });
}

fn upper(d: &mut Draw) {
    use Side::{East, North, South, West};
    use line::{INNER, OUT, ROW};
    let four = |a: Paint| [a; 4];
    d.room(
        "living",
        &[Rect::new(0.3, 0.3, 5.2, 7.25)],
        "floor.oak",
        ["wall.cream", "wall.cream", "wall.cream", "wall.red"],
    )
    .light(Panel::Round, false, &[(2.75, 1.9), (2.75, 3.8), (2.75, 5.7)], WARM);
    d.room(
        "salon",
        &[Rect::new(5.35, 0.3, 9.95, 5.2)],
        "floor.oak",
        ["wall.sand", "wall.sand", "wall.sand", "wall.blue"],
    )
    .light(Panel::Round, false, &[(6.55, 2.75), (8.75, 2.75)], WARM);
    d.room(
        "study",
        &[Rect::new(10.1, 0.3, 14.1, 5.2)],
        "floor.oak",
        ["wall.green", "wall.green", "wall.cream", "wall.cream"],
    )
    .light(Panel::Square, false, &[(12.1, 2.75)], WARM);
    d.room(
        "bedroom",
        &[Rect::new(14.25, 0.3, 18.3, 5.2)],
        "floor.oak",
        ["wall.rose", "wall.rose", "wall.rose", "wall.plum"],
    )
    .light(Panel::Round, false, &[(16.3, 2.75)], WARM);
    d.room(
        "atelier",
        &[Rect::new(18.45, 0.3, 23.4, 12.2)],
        "floor.maple",
        ["wall.white", "wall.white", "wall.terracotta", "wall.ochre"],
    )
    .light(
        Panel::Long,
        true,
        &[(20.95, 1.9), (20.95, 4.1), (20.95, 6.3), (20.95, 8.5), (20.95, 10.7)],
        NEUTRAL,
    );
    d.room(
        "bath",
        &[Rect::new(7.4, 7.4, 10.55, 12.2)],
        "floor.tile",
        ["tile.white", "tile.white", "tile.white", "tile.aqua"],
    )
    .light(Panel::Round, false, &[(8.97, 9.8)], NEUTRAL);
    d.room("dressing", &[Rect::new(10.7, 7.4, 12.2, 12.2)], "floor.oak", four("wall.sand"));
    d.room(
        "nursery",
        &[Rect::new(15.2, 7.4, 18.3, 12.2)],
        "floor.maple",
        ["wall.sky", "wall.cream", "wall.cream", "wall.sky"],
    )
    .light(Panel::Round, false, &[(16.75, 9.8)], WARM);
    d.room(
        "kitchen",
        &[Rect::new(0.3, 7.4, 5.2, 12.2)],
        "floor.terracotta",
        ["wall.cream", "wall.sage", "wall.cream", "tile.white"],
    )
    .light(Panel::Round, false, &[(1.9, 9.8), (3.6, 9.8)], WARM);
    d.room(
        "child",
        &[Rect::new(0.3, 12.35, 5.2, 17.7)],
        "floor.maple",
        ["wall.cream", "wall.cream", "wall.teal", "wall.cream"],
    )
    .light(Panel::Square, false, &[(2.75, 14.1), (2.75, 15.9)], WARM);
    d.room(
        "guest",
        &[Rect::new(7.4, 12.35, 12.2, 17.7)],
        "floor.oak",
        ["wall.sand", "wall.sand", "wall.sage", "wall.sand"],
    )
    .light(Panel::Round, false, &[(9.8, 14.1), (9.8, 15.9)], WARM);
    d.room(
        "games",
        &[Rect::new(0.3, 17.85, 12.2, 22.7)],
        "carpet.wine",
        ["wall.blue", "wall.sand", "wall.sand", "wall.sand"],
    )
    .light(
        Panel::Square,
        false,
        &[(1.9, 20.3), (4.1, 20.3), (6.25, 20.3), (8.4, 20.3), (10.6, 20.3)],
        WARM,
    );
    // The enfilade of the south front: six rooms in a line.
    d.passage(false, ROW, 1.5);
    d.passage(false, (9.95, 10.1), 1.5);
    d.passage(false, (14.1, 14.25), 1.5);
    d.passage(false, line::EAST_END, 1.5);
    // Off the corridor.
    d.passage(true, INNER, 4.2);
    d.passage(true, ROW, 8.6);
    d.door(true, ROW, 13.2, leaf(South, false, 92.0, "door.white"));
    d.door(true, ROW, 15.2, leaf(South, true, 88.0, "door.white"));
    d.door(true, INNER, 9.8, leaf(North, false, 90.0, "door.white"));
    d.door(true, INNER, 11.45, leaf(North, false, 91.0, "door.white"));
    d.door(true, INNER, 16.2, leaf(North, true, 95.0, "door.blue"));
    d.door(false, ROW, 11.4, leaf(West, false, 84.0, "door.white"));
    d.door(false, ROW, 13.4, leaf(West, true, 93.0, "door.blue"));
    d.door(false, INNER, 15.3, leaf(East, true, 97.0, "door.white"));
    d.windows(true, OUT, &[(7.65, 1.8)]);
}

/// One room from the ground to the roof, with a landing on every floor.
fn stairwell(d: &mut Draw, storeys: u32) {
    let plan = Rect::new(12.35, 7.4, 15.05, 12.2);
    let hole = Rect::new(plan.x0, STAIR_OPENING, plan.x1, plan.y1);
    d.storey = 0;
    let top = STOREY * f64::from(storeys) - (STOREY - CLEAR);
    let room = d.room(
        "stairwell",
        &[plan],
        "floor.stone",
        ["wall.white", "wall.white", "wall.white", "wall.ochre"],
    );
    for storey in 1..storeys {
        let z = STOREY * f64::from(storey);
        room.shafts.push((hole, z - (STOREY - CLEAR), z));
        room.shafts.push((plan, z, z + CLEAR));
    }
    room.name = "stairwell".into();
    room.lamp = Some(Lamp {
        panel: Panel::Square,
        points: vec![(13.7, 9.6)],
        along_y: false,
        z: top,
        lumens: 4000.0 + 2000.0 * f64::from(storeys - 1),
        count: 1,
        colour: NEUTRAL,
    });
    // Tall windows at the half landings.
    for storey in 1..storeys {
        let z = STOREY * f64::from(storey) - STOREY / 2.0;
        d.openings.push(Opening {
            along_x: true,
            band: line::NOTCH,
            span: (13.1, 14.3),
            height: (z + 0.9, z + 2.1),
            filling: Filling::Window { sashes: 2 },
        });
    }
}

/// Where a photographer would stand: in a corner, at eye height, with a doorway in the picture.
fn views(storeys: u32) -> Vec<View> {
    let size = (960, 600);
    // The enfilade is upstairs where there is an upstairs.
    let z = if storeys > 1 { STOREY } else { 0.0 };
    let view = |name: &str, eye, target, fov| View { name: name.into(), eye, target, fov, size };
    vec![
        view("enfilade", v(0.75, 0.8, z + 1.55), v(4.1, 3.35, z + 1.1), 55.0),
        view("library", v(8.8, 22.0, 1.6), v(2.9, 19.2, 1.1), 52.0),
        view("conference", v(22.6, 0.95, 1.65), v(20.25, 7.2, 0.95), 55.0),
    ]
}
