//! Matches spaces with rooms by the floor that they share, and looks on both sides of each door.
//!
//! Plans are compared on one grid for all, 1 m above each space's floor.

use crate::found::{Found, Place};
use crate::truth::{Door, Shape, Space, Truth};
use glam::{DVec2, DVec3};
use std::collections::BTreeMap;

/// Side of a cell of the grid, m.
pub const STEP: f64 = 0.1;
/// Spaces with less floor than this are listed but not counted, m2.
pub const LEAST_AREA: f64 = 4.0;
/// A space and a room match when they share more than this of what they cover together.
pub const LEAST_MATCH: f64 = 0.5;
/// A room that covers less of a space than this does not divide it.
const LEAST_SHARE: f64 = 0.1;
/// How far around the building rooms are measured, m.
const AROUND: f64 = 5.0;
/// Cells lie off the round numbers on which walls stand.
const OFF: f64 = 0.537;
/// Spaces that touch over fewer cells than this are divided by a wall.
const LEAST_CONTACT: usize = 5;

/// How a space was found.
#[derive(Clone, Debug, PartialEq)]
pub struct SpaceScore {
    /// The room that is this space and no other.
    pub room: Option<u32>,
    /// Shared floor by common floor, 0 to 1, with the room that fits best.
    pub overlap: f64,
    /// Rooms in it, with the share of its floor that each covers, largest first.
    pub rooms: Vec<(u32, f64)>,
    /// Share of its floor that lies outside.
    pub outside: f64,
    /// Large enough and indoors: it counts.
    pub counts: bool,
}

/// What is between two spaces that are one room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Between {
    /// They touch: no wall divides them.
    Nothing,
    /// The truth has a door between them.
    Door,
    /// They do not touch.
    Wall,
    /// Only their boxes are known.
    Unknown,
}

/// A room that covers several spaces.
#[derive(Clone, Debug, PartialEq)]
pub struct Merged {
    /// The room.
    pub room: u32,
    /// Its spaces, in the order of the file.
    pub spaces: Vec<usize>,
    /// Pairs of them that touch, or have a door; the rest is divided by walls.
    pub pairs: Vec<(usize, usize, Between)>,
}

/// How a door was found.
#[derive(Clone, Debug, PartialEq)]
pub struct DoorScore {
    /// What is on both sides.
    pub sides: [Place; 2],
    /// The sides are different, and the right ones.
    pub found: bool,
    /// Area of the openings between them there, m2; 0 = shut.
    pub opening: f64,
}

/// The comparison of a whole building.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Score {
    /// By space of the truth.
    pub spaces: Vec<SpaceScore>,
    /// Rooms that cover several spaces, by id.
    pub merged: Vec<Merged>,
    /// By door of the truth.
    pub doors: Vec<DoorScore>,
}

/// So many of so many.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Share {
    /// The good ones.
    pub good: usize,
    /// All.
    pub all: usize,
}

impl Share {
    fn of(items: impl Iterator<Item = bool>) -> Self {
        items.fold(Self::default(), |s, good| Self {
            good: s.good + usize::from(good),
            all: s.all + 1,
        })
    }

    /// In percent; 100 of nothing.
    pub fn percent(self) -> f64 {
        if self.all == 0 { 100.0 } else { 100.0 * self.good as f64 / self.all as f64 }
    }
}

impl Score {
    /// Spaces above 4 m2 that are a room each.
    pub fn matched(&self) -> Share {
        Share::of(self.spaces.iter().filter(|s| s.counts).map(|s| s.room.is_some()))
    }

    /// The same, without those that are part of a room only because nothing divides them from its other spaces.
    pub fn matched_of_divided(&self) -> Share {
        Share::of(
            (0..self.spaces.len())
                .filter(|&i| self.spaces[i].counts)
                .filter(|&i| self.spaces[i].room.is_some() || !self.open(i))
                .map(|i| self.spaces[i].room.is_some()),
        )
    }

    /// Nothing divides it from another space of its room.
    pub fn open(&self, space: usize) -> bool {
        self.merged
            .iter()
            .flat_map(|m| &m.pairs)
            .any(|&(a, b, between)| (a == space || b == space) && between == Between::Nothing)
    }

    /// Doors and windows found, inside or to the outside.
    pub fn doors(&self, truth: &Truth, exterior: bool) -> Share {
        Share::of(
            truth
                .doors
                .iter()
                .zip(&self.doors)
                .filter(|(d, _)| d.exterior == exterior)
                .map(|(_, s)| s.found),
        )
    }
}

/// The cells of a space in plan.
type Cells = Vec<(i32, i32)>;

fn cell(x: f64) -> i32 {
    ((x / STEP) - OFF).ceil() as i32
}

fn middle(i: i32) -> f64 {
    (f64::from(i) + OFF) * STEP
}

/// Cells whose middle is inside the outline: even-odd, row by row.
fn cells(outline: &[[DVec2; 2]]) -> Cells {
    let mut rows: BTreeMap<i32, Vec<f64>> = BTreeMap::new();
    for [a, b] in outline {
        let (low, high) = if a.y <= b.y { (a, b) } else { (b, a) };
        for j in cell(low.y)..cell(high.y) {
            let t = (middle(j) - low.y) / (high.y - low.y);
            rows.entry(j).or_default().push(low.x + (high.x - low.x) * t);
        }
    }
    let mut cells = Vec::new();
    for (j, mut crossings) in rows {
        crossings.sort_by(f64::total_cmp);
        for pair in crossings.chunks_exact(2) {
            cells.extend((cell(pair[0])..cell(pair[1])).map(|i| (i, j)));
        }
    }
    cells.sort_unstable();
    cells
}

fn cells_at(space: &Space, z: f64) -> Cells {
    if z < space.min.z || z > space.max.z { Vec::new() } else { cells(&space.outline(z)) }
}

/// What lies between two spaces.
fn between(truth: &Truth, a: usize, b: usize) -> Between {
    let (x, y) = (&truth.spaces[a], &truth.spaces[b]);
    if truth.doors.iter().any(|d| d.spaces == [Some(a), Some(b)] || d.spaces == [Some(b), Some(a)])
    {
        return Between::Door;
    }
    if x.shape == Shape::Box || y.shape == Shape::Box {
        return Between::Unknown;
    }
    for z in [x.level(), y.level()] {
        let (of_x, of_y) = (cells_at(x, z), cells_at(y, z));
        let beside = of_x.iter().filter(|c| {
            [(1, 0), (-1, 0), (0, 1), (0, -1), (0, 0)]
                .iter()
                .any(|d| of_y.binary_search(&(c.0 + d.0, c.1 + d.1)).is_ok())
        });
        if beside.count() >= LEAST_CONTACT {
            return Between::Nothing;
        }
    }
    // One above the other, without a slab.
    if (x.max.z - y.min.z).abs() < 0.05 || (y.max.z - x.min.z).abs() < 0.05 {
        let (of_x, of_y) = (cells_at(x, x.level()), cells_at(y, y.level()));
        if of_x.iter().filter(|c| of_y.binary_search(c).is_ok()).count() >= LEAST_CONTACT {
            return Between::Nothing;
        }
    }
    Between::Wall
}

/// What is on one side of a door: the first room, else the outside, looking at points 0.3 to 0.6 m from the wall.
fn beside(found: &dyn Found, door: &Door, sign: f64) -> Place {
    let across = door.normal.cross(DVec3::Z).normalize_or_zero();
    let mut seen = Place::Solid;
    for distance in [0.4, 0.3, 0.5, 0.6] {
        for along in [0.0, 0.2, -0.2] {
            let p = door.centre
                + door.normal * (sign * (0.5 * door.thickness + distance))
                + across * (along * door.width);
            match found.at(p) {
                Place::Solid => {}
                Place::Outside => seen = Place::Outside,
                room => return room,
            }
        }
    }
    seen
}

/// Compares.
pub fn score(truth: &Truth, found: &dyn Found) -> Score {
    let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for s in truth.spaces.iter().filter(|s| !s.outdoors) {
        (min, max) = (min.min(s.min), max.max(s.max));
    }
    let (from, to) = (min - AROUND, max + AROUND);
    // Level (cm) -> cells of each room there, and what is at each cell of the grid.
    let width = (cell(to.x) - cell(from.x)).max(0) as usize;
    let mut levels: BTreeMap<i64, (BTreeMap<Place, usize>, Vec<Place>)> = BTreeMap::new();
    for s in truth.spaces.iter().filter(|s| !s.outdoors) {
        levels.entry((s.level() * 100.0).round() as i64).or_insert_with(|| {
            let z = (s.level() * 100.0).round() / 100.0;
            let mut sizes: BTreeMap<Place, usize> = BTreeMap::new();
            let mut grid = Vec::new();
            for j in cell(from.y)..cell(to.y) {
                for i in cell(from.x)..cell(to.x) {
                    let place = found.at(DVec3::new(middle(i), middle(j), z));
                    *sizes.entry(place).or_default() += 1;
                    grid.push(place);
                }
            }
            (sizes, grid)
        });
    }
    let mut pairs: Vec<(f64, usize, u32)> = Vec::new();
    let mut spaces: Vec<SpaceScore> = Vec::new();
    let mut pieces: Vec<Vec<u32>> = Vec::new();
    for (index, s) in truth.spaces.iter().enumerate() {
        let mut score = SpaceScore {
            room: None,
            overlap: 0.0,
            rooms: Vec::new(),
            outside: 0.0,
            counts: !s.outdoors && s.area >= LEAST_AREA,
        };
        if let Some((sizes, grid)) =
            levels.get(&((s.level() * 100.0).round() as i64)).filter(|_| !s.outdoors)
        {
            let own = cells(&s.outline(s.level()));
            let mut shared: BTreeMap<Place, usize> = BTreeMap::new();
            for &(i, j) in &own {
                let (i, j) = ((i - cell(from.x)) as usize, (j - cell(from.y)) as usize);
                *shared.entry(grid[j * width + i]).or_default() += 1;
            }
            // Of a box, only as much as the author says is floor.
            let unit = STEP * STEP;
            let floor = if s.shape == Shape::Box { s.area } else { own.len() as f64 * unit };
            for (place, count) in shared {
                let common = (count as f64 * unit).min(floor);
                match place {
                    Place::Room(room) => {
                        let whole = sizes[&place] as f64 * unit;
                        let overlap = common / (floor + whole - common).max(1e-9);
                        score.overlap = score.overlap.max(overlap);
                        pairs.push((overlap, index, room));
                        score.rooms.push((room, common / floor.max(1e-9)));
                    }
                    Place::Outside => score.outside = common / floor.max(1e-9),
                    Place::Solid => {}
                }
            }
            score.rooms.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        }
        pieces.push(score.rooms.iter().map(|r| r.0).collect());
        score.rooms.retain(|r| r.1 >= LEAST_SHARE);
        spaces.push(score);
    }
    // One to one, best first.
    pairs.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let mut taken: BTreeMap<u32, usize> = BTreeMap::new();
    for (overlap, space, room) in pairs {
        if overlap > LEAST_MATCH && spaces[space].room.is_none() && !taken.contains_key(&room) {
            spaces[space].room = Some(room);
            taken.insert(room, space);
        }
    }
    let mut inside: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (index, s) in spaces.iter().enumerate() {
        if let Some(&(room, share)) = s.rooms.first()
            && share > LEAST_MATCH
        {
            inside.entry(room).or_default().push(index);
        }
    }
    let merged = inside
        .into_iter()
        .filter(|(_, list)| list.len() > 1)
        .map(|(room, list)| {
            let mut pairs = Vec::new();
            for (k, &a) in list.iter().enumerate() {
                for &b in &list[k + 1..] {
                    match between(truth, a, b) {
                        Between::Wall => {}
                        other => pairs.push((a, b, other)),
                    }
                }
            }
            Merged { room, spaces: list, pairs }
        })
        .collect();
    // The room of a space, or a piece of it that is no other space's room.
    let belongs = |space: usize, room: u32| {
        let s = &spaces[space];
        let own = s.room.or_else(|| s.rooms.first().map(|r| r.0));
        own == Some(room) || (!taken.contains_key(&room) && pieces[space].contains(&room))
    };
    let doors = truth
        .doors
        .iter()
        .map(|door| {
            let sides = [beside(found, door, 1.0), beside(found, door, -1.0)];
            let room = |p: Place| if let Place::Room(r) = p { Some(r) } else { None };
            let rooms = sides.map(room);
            // Each space of the truth that is known must be on a side of its own.
            let right = |space: Option<usize>, room: Option<u32>| match (space, room) {
                (Some(space), Some(room)) => belongs(space, room),
                _ => true,
            };
            let [a, b] = door.spaces;
            let [x, y] = rooms;
            let right = (right(a, x) && right(b, y)) || (right(a, y) && right(b, x));
            let indoors = if door.exterior { 1 } else { 2 };
            let found_it = sides[0] != sides[1]
                && rooms.iter().flatten().count() >= indoors
                && !sides.contains(&Place::Solid)
                && right;
            DoorScore { sides, found: found_it, opening: found.opening(rooms, door.centre) }
        })
        .collect();
    Score { spaces, merged, doors }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two spaces of 4 x 5 m with a wall of 0.2 m between, and a door in it.
    fn truth() -> Truth {
        let space = |name: &str, x0: f64, x1: f64| Space {
            name: name.into(),
            min: DVec3::new(x0, 0.0, 0.0),
            max: DVec3::new(x1, 5.0, 2.5),
            area: (x1 - x0) * 5.0,
            shape: Shape::Solid(solid(DVec3::new(x0, 0.0, 0.0), DVec3::new(x1, 5.0, 2.5))),
            outdoors: false,
        };
        let door = |x: f64, exterior: bool, spaces: [Option<usize>; 2]| Door {
            name: "door".into(),
            centre: DVec3::new(x, 2.0, 1.0),
            normal: DVec3::X,
            thickness: 0.2,
            width: 0.9,
            door: true,
            exterior,
            spaces,
        };
        Truth {
            model: "two".into(),
            spaces: vec![space("A", 0.0, 4.0), space("B", 4.2, 8.2)],
            doors: vec![door(4.1, false, [Some(0), Some(1)]), door(-0.1, true, [None, Some(0)])],
        }
    }

    fn solid(lo: DVec3, hi: DVec3) -> Vec<[DVec3; 3]> {
        let p = |i: usize| {
            DVec3::new(
                if i & 1 == 0 { lo.x } else { hi.x },
                if i & 2 == 0 { lo.y } else { hi.y },
                if i & 4 == 0 { lo.z } else { hi.z },
            )
        };
        let mut out = Vec::new();
        for q in
            [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]]
        {
            out.push([p(q[0]), p(q[1]), p(q[2])]);
            out.push([p(q[0]), p(q[2]), p(q[3])]);
        }
        out
    }

    struct Plan<F: Fn(DVec3) -> Place>(F);

    impl<F: Fn(DVec3) -> Place> Found for Plan<F> {
        fn at(&self, p: DVec3) -> Place {
            (self.0)(p)
        }
        fn opening(&self, _: [Option<u32>; 2], _: DVec3) -> f64 {
            1.5
        }
    }

    fn within(p: DVec3) -> bool {
        p.y > 0.0 && p.y < 5.0 && p.x > 0.0 && p.x < 8.2
    }

    #[test]
    fn the_same_rooms_match_with_their_doors() {
        let score = score(
            &truth(),
            &Plan(|p| match p {
                _ if !within(p) => Place::Outside,
                _ if p.x < 4.0 => Place::Room(7),
                _ if p.x > 4.2 => Place::Room(3),
                _ => Place::Solid,
            }),
        );
        assert_eq!(score.matched(), Share { good: 2, all: 2 });
        assert_eq!([score.spaces[0].room, score.spaces[1].room], [Some(7), Some(3)]);
        assert!(score.spaces.iter().all(|s| (s.overlap - 1.0).abs() < 1e-9));
        assert!(score.merged.is_empty());
        assert!(score.doors.iter().all(|d| d.found && d.opening > 0.0));
    }

    #[test]
    fn one_room_for_two_spaces_is_said_and_its_door_is_missing() {
        let score =
            score(&truth(), &Plan(|p| if within(p) { Place::Room(0) } else { Place::Outside }));
        // 20 of 41 m2 is less than half.
        assert_eq!(score.matched(), Share { good: 0, all: 2 });
        assert_eq!(score.merged.len(), 1);
        assert_eq!(score.merged[0].spaces, [0, 1]);
        assert_eq!(score.merged[0].pairs, [(0, 1, Between::Door)]);
        assert_eq!(score.doors(&truth(), false), Share { good: 0, all: 1 });
        assert_eq!(score.doors(&truth(), true), Share { good: 1, all: 1 });
        assert_eq!(score.matched_of_divided(), Share { good: 0, all: 2 });
    }

    #[test]
    fn spaces_that_nothing_divides_are_counted_apart() {
        let mut truth = truth();
        truth.doors.remove(0);
        truth.spaces[1].min.x = 4.0;
        truth.spaces[1].shape = Shape::Solid(solid(truth.spaces[1].min, truth.spaces[1].max));
        let score =
            score(&truth, &Plan(|p| if within(p) { Place::Room(0) } else { Place::Outside }));
        assert_eq!(score.merged[0].pairs, [(0, 1, Between::Nothing)]);
        assert!(score.open(0) && score.open(1));
        // The larger half matches the room by a hair; the other one has no room of its own.
        assert_eq!(score.matched_of_divided().all, score.matched_of_divided().good);
    }

    #[test]
    fn a_space_in_two_pieces_matches_the_larger_one() {
        let score = score(
            &truth(),
            &Plan(|p| match p {
                _ if !within(p) => Place::Outside,
                _ if p.x < 2.8 => Place::Room(1),
                _ if p.x < 4.1 => Place::Room(2),
                _ => Place::Room(3),
            }),
        );
        assert_eq!(score.spaces[0].room, Some(1));
        assert_eq!(score.spaces[0].rooms.len(), 2);
        assert!((score.spaces[0].rooms[0].1 - 0.7).abs() < 0.02);
        // The door leads to the smaller piece, which is no other space.
        assert!(score.doors[0].found);
    }

    #[test]
    fn boxes_use_the_area_of_their_author() {
        let mut truth = truth();
        truth.spaces[0].shape = Shape::Box;
        truth.spaces[0].area = 10.0;
        let score = score(
            &truth,
            &Plan(|p| match p {
                _ if !within(p) || p.x > 4.0 => Place::Outside,
                _ if p.x < 2.0 => Place::Room(1),
                _ => Place::Solid,
            }),
        );
        assert!((score.spaces[0].overlap - 1.0).abs() < 0.05, "{:?}", score.spaces[0]);
        assert!((score.spaces[1].outside - 1.0).abs() < 1e-9);
    }

    #[test]
    fn cells_count_what_an_outline_covers() {
        let ring = |c: &[(f64, f64)]| -> Vec<[DVec2; 2]> {
            (0..c.len())
                .map(|i| [c[i], c[(i + 1) % c.len()]].map(|(x, y)| DVec2::new(x, y)))
                .collect()
        };
        let mut outline =
            ring(&[(0.0, 0.0), (6.0, 0.0), (6.0, 2.0), (2.0, 2.0), (2.0, 4.0), (0.0, 4.0)]);
        assert_eq!(cells(&outline).len(), 1600);
        outline.extend(ring(&[(0.5, 0.5), (1.5, 0.5), (1.5, 1.5), (0.5, 1.5)]));
        assert_eq!(cells(&outline).len(), 1500);
    }
}
