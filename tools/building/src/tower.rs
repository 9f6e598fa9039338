//! The drawing of the tower: 178 rooms a floor on two long corridors.
//!
//! ```text
//!   +----------------------- 30 suites with baths -----------------------+
//!   +--------------------------- corridor-north --------------------------+
//!   | lobby | ballroom | rooms |c| rooms | stair |c| rooms | c |  ...      |   row B
//!   | stair | rooms    | rooms |r| rooms | lifts |r| rooms | r |  ...      |   row A
//!   +--------------------------- corridor-south --------------------------+
//!   +----------------------- 30 suites with baths -----------------------+
//! ```

use crate::assemble::{Drawing, look};
use crate::fittings::grid;
use crate::lamps::{NEUTRAL, WARM};
use crate::outline::Frame;
use crate::plan::{Filling, Panel};
use crate::storey::{Door, OUTER, Storey, Use, WALL, Weight, cells};

/// Modules along the building, and what one of them takes of its length.
const MODULES: usize = 30;
const MODULE: f64 = 4.95;
/// Clear bands from south to north: suites, corridor, rooms, rooms, corridor, suites.
const SOUTH: (f64, f64) = (0.3, 8.1);
const HALL_S: (f64, f64) = (8.25, 10.45);
const ROW_A: (f64, f64) = (10.6, 17.4);
const ROW_B: (f64, f64) = (17.55, 24.35);
const HALL_N: (f64, f64) = (24.5, 26.7);
const NORTH: (f64, f64) = (26.85, 34.65);
/// Modules that are corridors from south to north.
const CROSS: [usize; 3] = [7, 15, 22];

/// Clear x range of modules `from..=to`.
fn span(from: usize, to: usize) -> (f64, f64) {
    (OUTER + MODULE * from as f64, OUTER + MODULE * (to + 1) as f64 - WALL)
}

fn length() -> f64 {
    2.0 * OUTER + MODULE * MODULES as f64 - WALL
}

/// The tower's drawing: one storey, furnished in ten ways in turn.
pub fn drawing() -> Drawing {
    let mut s = Storey { triangles: 10_732_000, ..Storey::default() };
    corridors(&mut s);
    middle(&mut s);
    suites(&mut s);
    let views = vec![
        look(&mut s, "corridor", 0, (1.0, 9.6, 1.6), (20.0, 9.3, 1.3), 50.0),
        look(&mut s, "ballroom", 0, (15.9, 18.2, 1.65), (22.0, 22.0, 1.0), 60.0),
        look(&mut s, "suite", 0, (60.4, 6.6, 1.6), (62.2, 1.2, 0.9), 62.0),
    ];
    Drawing {
        name: "tower",
        footprint: cells(&Frame::PLAN, (0.0, 0.0, length(), NORTH.1 + OUTER), 30.0),
        storeys: vec![s],
        furnishings: 10,
        views,
    }
}

fn corridors(s: &mut Storey) {
    let f = Frame::PLAN;
    let (x0, x1) = (OUTER, length() - OUTER);
    for (name, (y0, y1)) in [("corridor-south", HALL_S), ("corridor-north", HALL_N)] {
        let rect = (x0, y0, x1, y1);
        // Cut between two modules: no door is there.
        let cut = |k: usize| if k == MODULES { x1 } else { span(k, k).0 - WALL / 2.0 };
        let pieces = (0..MODULES)
            .step_by(2)
            .map(|k| f.rect(if k == 0 { x0 } else { cut(k) }, y0, cut(k + 2), y1))
            .collect();
        let room = s.space(name, Use::Corridor, pieces, 0.0, Weight::Share(80.0));
        s.spaces[room].light = Some(grid(&f, rect, (16, 1), Panel::Long, true, WARM));
        let y = f64::midpoint(y0, y1);
        s.window(&f, (OUTER / 2.0, y), false, 1.4);
        s.window(&f, (length() - OUTER / 2.0, y), false, 1.4);
    }
    for (k, m) in CROSS.into_iter().enumerate() {
        let (x0, x1) = span(m, m);
        let rect = (x0, ROW_A.0, x1, ROW_B.1);
        let name = format!("crossing-{}", k + 1);
        let room = s.space(name, Use::Lobby, cells(&f, rect, 7.0), 90.0, Weight::Share(50.0));
        s.spaces[room].light = Some(grid(&f, rect, (1, 2), Panel::Long, true, WARM));
        let x = f64::midpoint(x0, x1);
        s.door(&f, (x, ROW_A.0 - WALL / 2.0), true, WALL, Door::None);
        s.door(&f, (x, ROW_B.1 + WALL / 2.0), true, WALL, Door::None);
    }
}

/// The rooms between the corridors.
fn middle(s: &mut Storey) {
    let f = Frame::PLAN;
    let uses = [Use::Office, Use::Meeting, Use::Library, Use::Office, Use::Studio, Use::Lounge];
    for (row, (y0, y1)) in [("a", ROW_A), ("b", ROW_B)] {
        let wall = if row == "a" { y0 - WALL / 2.0 } else { y1 + WALL / 2.0 };
        let mut m = 0;
        while m < MODULES {
            let (x0, x1) = span(m, m);
            let name = format!("{row}-{}", m + 1);
            let rect = (x0, y0, x1, y1);
            let x = f64::midpoint(x0, x1);
            let door = match m % 4 {
                1 => Door::Open(row == "a"),
                3 if m > 20 => Door::Shut,
                _ => Door::None,
            };
            m += 1;
            match (row, m - 1) {
                (_, cross) if CROSS.contains(&cross) => {}
                ("b", 3) => {
                    let (x0, x1) = span(3, 5);
                    let rect = (x0, y0, x1, y1);
                    let room = s.space(
                        "ballroom",
                        Use::Restaurant,
                        cells(&f, rect, 7.0),
                        0.0,
                        Weight::Triangles(171_300),
                    );
                    s.spaces[room].light = Some(grid(&f, rect, (6, 2), Panel::Round, true, WARM));
                    s.door(&f, (x0 + 1.5, wall), true, WALL, Door::None);
                    s.door(&f, (x1 - 1.5, wall), true, WALL, Door::None);
                    m = 6;
                }
                ("a", 6) | ("b", 23) => {
                    // One flight begins at the south, one at the north.
                    let g = if row == "a" {
                        f
                    } else {
                        Frame { origin: f.point(x0 + x1, y0 + y1), turn: 180.0 }
                    };
                    let room = s.stair(&format!("stair-{row}"), &g, (x0, x1), y0, y1 - y0);
                    let well = (x0 + 1.4, y0, x1, y1);
                    s.spaces[room].light =
                        Some(grid(&g, well, (1, 2), Panel::Square, true, NEUTRAL));
                    let x = g.point(x0 + 2.8, 0.0).x;
                    s.door(&f, (x, wall), true, WALL, Door::None);
                }
                ("a", 14) | ("b", 14) => {
                    let rects = cells(&f, rect, 7.0);
                    let room =
                        s.space(format!("lifts-{row}"), Use::Lift, rects, 0.0, Weight::Share(45.0));
                    s.spaces[room].light = Some(grid(&f, rect, (2, 2), Panel::Square, true, WARM));
                    // From the corridor and from the crossing beside it.
                    s.door(&f, (x, wall), true, WALL, Door::None);
                    s.door(&f, (x1 + WALL / 2.0, f64::midpoint(y0, y1)), false, WALL, Door::None);
                }
                ("a", 29) => {
                    let cut = f64::midpoint(y0, y1);
                    for (name, use_, (y0, y1)) in [
                        ("washroom", Use::Washroom, (y0, cut - WALL)),
                        ("linen", Use::Store, (cut, y1)),
                    ] {
                        let r = (x0, y0, x1, y1);
                        let room = s.space(name, use_, cells(&f, r, 7.0), 0.0, Weight::Share(24.0));
                        s.spaces[room].light =
                            Some(grid(&f, r, (2, 1), Panel::Square, true, NEUTRAL));
                    }
                    s.door(&f, (x, wall), true, WALL, Door::None);
                    s.door(&f, (x + 0.9, cut - WALL / 2.0), true, WALL, Door::None);
                }
                _ => {
                    let use_ = uses[(m * 5 + usize::from(row == "b")) % 6];
                    let room = s.space(name, use_, cells(&f, rect, 7.0), 0.0, Weight::Share(90.0));
                    let colour = if use_ == Use::Lounge { WARM } else { NEUTRAL };
                    s.spaces[room].light = Some(grid(&f, rect, (2, 2), Panel::Long, true, colour));
                    s.door(&f, (x, wall), true, WALL, door);
                }
            }
        }
    }
    // Some neighbours share a door.
    for m in [1, 10, 18, 25] {
        let x = span(m, m).1 + WALL / 2.0;
        s.door(&f, (x, 14.2), false, WALL, Door::None);
        s.door(&f, (x + MODULE, 20.9), false, WALL, Door::Shut);
    }
}

/// The suites at the facades.
fn suites(s: &mut Storey) {
    let uses = [Use::Bedroom, Use::Lounge, Use::Bedroom, Use::Office, Use::Studio];
    for (row, (y0, y1)) in [("south", SOUTH), ("north", NORTH)] {
        for m in 0..MODULES {
            let (x0, x1) = span(m, m);
            // Drawn from the corridor to the window; the northern ones are turned round.
            let south = row == "south";
            let f = if south {
                Frame { origin: Frame::PLAN.point(x1, y1), turn: 180.0 }
            } else {
                Frame { origin: Frame::PLAN.point(x0, y0), turn: 0.0 }
            };
            let (wide, deep) = (x1 - x0, y1 - y0);
            let (x, y) = (2.0, 2.15);
            let name = format!("{row}-{}", m + 1);
            let use_ = uses[(m * 3 + usize::from(south)) % 5];
            let pieces =
                vec![f.rect(0.0, y + WALL, wide, deep), f.rect(x + WALL, 0.0, wide, y + WALL)];
            let room = s.space(name.clone(), use_, pieces, f.turn, Weight::Share(85.0));
            let main = (0.0, y + WALL, wide, deep);
            s.spaces[room].light = Some(grid(&f, main, (2, 2), Panel::Round, true, WARM));
            let rect = vec![f.rect(0.0, 0.0, x, y)];
            let bath = s.space(format!("{name}/bath"), Use::Bath, rect, f.turn, Weight::Share(9.0));
            s.spaces[bath].light =
                Some(grid(&f, (0.0, 0.0, x, y), (2, 1), Panel::Round, true, NEUTRAL));
            let door = if m % 5 == 2 { Door::Open(true) } else { Door::None };
            s.door(&f, (f64::midpoint(x + WALL, wide), -WALL / 2.0), true, WALL, door);
            let door = if m % 6 == 5 { Door::Shut } else { Door::None };
            s.door(&f, (x + WALL / 2.0, 1.2), false, WALL, door);
            for wx in [wide * 0.27, wide * 0.73] {
                let filling = Filling::Window { sashes: 2 };
                s.gap(&f, (wx, deep + OUTER / 2.0), true, 1.5, OUTER, (0.85, 2.35), filling);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_floor_has_178_rooms_and_610_lights() {
        let s = &drawing().storeys[0];
        assert_eq!(s.spaces.len(), 178);
        let lights: usize =
            s.spaces.iter().filter_map(|r| r.light.as_ref()).map(|l| l.points.len()).sum();
        assert_eq!(lights, 610);
    }
}
