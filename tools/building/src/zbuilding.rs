//! The drawing of the Z-building: a college on one floor, copied for more.
//!
//! ```text
//!   +---------+-----+-----+-----+
//!   |  audi-  |office|meet.|loung|      top bar
//!   |  torium +-----+-----+-----+
//!   |         |  hall-2         |
//!   |         +---+----+-+------+
//!   +---------+clk|arch|h|wash  |
//!                 +----+a+------+
//!                 |paper|l|stair|      spine
//!                 +----+l+------+
//!                 |store|-|office|
//!                 +----+3+------+------+------+
//!                 |bin | |kitchen|studio|reading|
//!                 +----+-+------+------+------+
//!                 |  hall-1                    |   bottom bar
//!                 +------+------+------+------+
//!                 |office|meeting|lounge|canteen|
//!                 +------+------+------+------+
//! ```

use crate::assemble::{Drawing, look};
use crate::fittings::grid;
use crate::lamps::{NEUTRAL, WARM};
use crate::outline::Frame;
use crate::plan::{Filling, Panel};
use crate::storey::{Door, OUTER, Storey, Use, WALL, Weight, cells};

/// Name, use, rectangle, panels across and along (none: unlit), share of the furniture.
type Row = (&'static str, Use, (f64, f64, f64, f64), (u32, u32), f64);

const ROOMS: [Row; 20] = [
    // Bottom bar.
    ("hall-1", Use::Corridor, (16.3, 5.1, 43.7, 7.1), (7, 1), 9.0),
    ("office-south", Use::Office, (16.3, 0.3, 23.0, 4.95), (2, 2), 31.0),
    ("meeting-south", Use::Meeting, (23.15, 0.3, 29.85, 4.95), (2, 2), 31.0),
    ("lounge-south", Use::Lounge, (30.0, 0.3, 36.7, 4.95), (2, 2), 31.0),
    ("canteen", Use::Restaurant, (36.85, 0.3, 43.7, 4.95), (3, 2), 32.0),
    ("cellar", Use::Store, (16.3, 7.25, 20.85, 11.7), (0, 0), 20.0),
    ("kitchen", Use::Kitchen, (23.15, 7.25, 29.9, 11.7), (2, 2), 30.0),
    ("studio", Use::Studio, (30.05, 7.25, 36.8, 11.7), (2, 2), 30.0),
    ("reading-room", Use::Library, (36.95, 7.25, 43.7, 11.7), (2, 2), 30.0),
    // Spine.
    ("hall-3", Use::Corridor, (21.0, 7.25, 23.0, 30.85), (1, 6), 8.0),
    ("store", Use::Store, (16.3, 11.85, 20.85, 18.85), (0, 0), 26.0),
    ("paper-store", Use::Store, (16.3, 19.0, 20.85, 25.85), (0, 0), 26.0),
    ("office-east", Use::Office, (23.15, 11.85, 27.7, 18.85), (2, 2), 32.0),
    // Top bar.
    ("hall-2", Use::Corridor, (12.0, 31.0, 27.7, 33.0), (5, 1), 6.0),
    ("cloakroom", Use::Store, (12.0, 26.3, 15.85, 30.85), (0, 0), 18.0),
    ("archive", Use::Library, (16.0, 26.0, 20.85, 30.85), (0, 0), 26.0),
    ("washroom", Use::Washroom, (23.15, 26.0, 27.7, 30.85), (0, 0), 16.0),
    ("office-north", Use::Office, (12.0, 33.15, 17.1, 37.7), (2, 2), 26.0),
    ("meeting-north", Use::Meeting, (17.25, 33.15, 22.35, 37.7), (2, 2), 26.0),
    ("lounge-north", Use::Lounge, (22.5, 33.15, 27.7, 37.7), (2, 2), 26.0),
];

/// The Z-building's drawing.
pub fn drawing() -> Drawing {
    let f = Frame::PLAN;
    let mut s = Storey { triangles: 1_068_000, ..Storey::default() };
    for (name, use_, rect, (nx, ny), share) in ROOMS {
        let room = s.space(name, use_, cells(&f, rect, 8.0), 0.0, Weight::Share(share));
        if nx > 0 {
            let (panel, colour) = match use_ {
                Use::Lounge | Use::Restaurant | Use::Corridor => (Panel::Round, WARM),
                Use::Library => (Panel::Square, WARM),
                _ => (Panel::Square, NEUTRAL),
            };
            s.spaces[room].light = Some(grid(&f, rect, (nx, ny), panel, false, colour));
        }
    }
    let hall = (0.3, 26.3, 11.85, 37.7);
    // The speaker's side is to the south.
    let auditorium = s.space(
        "auditorium",
        Use::Auditorium,
        cells(&f, hall, 8.0),
        0.0,
        Weight::Triangles(215_200),
    );
    s.spaces[auditorium].light = Some(grid(&f, hall, (4, 4), Panel::Square, false, NEUTRAL));
    s.stair("stairwell", &f, (23.15, 27.7), 19.0, 6.85);
    doors(&mut s);
    windows(&mut s);
    let views = vec![
        look(&mut s, "canteen", 0, (43.1, 0.9, 1.6), (38.0, 4.0, 0.95), 58.0),
        look(&mut s, "auditorium", 0, (1.1, 27.2, 1.65), (7.5, 34.0, 0.7), 60.0),
        look(&mut s, "reading-room", 0, (37.5, 7.8, 1.65), (42.0, 10.6, 1.0), 60.0),
    ];
    Drawing {
        name: "z-building",
        footprint: vec![
            f.rect(16.0, 0.0, 44.0, 12.0),
            f.rect(16.0, 12.0, 28.0, 26.0),
            f.rect(0.0, 26.0, 28.0, 38.0),
        ],
        storeys: vec![s],
        furnishings: 1,
        views,
    }
}

fn doors(s: &mut Storey) {
    let f = Frame::PLAN;
    let mut door =
        |x: f64, y: f64, along_x: bool, door: Door| s.door(&f, (x, y), along_x, WALL, door);
    // Off the bottom corridor, and the enfilade along the south front.
    door(18.2, 5.025, true, Door::Open(false));
    door(24.6, 5.025, true, Door::Open(false));
    door(31.4, 5.025, true, Door::None);
    door(38.6, 5.025, true, Door::None);
    door(18.2, 7.175, true, Door::Open(true));
    door(22.0, 7.175, true, Door::None);
    door(26.0, 7.175, true, Door::None);
    door(33.0, 7.175, true, Door::Open(true));
    door(39.2, 7.175, true, Door::None);
    door(23.075, 1.3, false, Door::None);
    door(29.925, 1.3, false, Door::None);
    door(36.775, 1.3, false, Door::None);
    door(29.975, 10.6, false, Door::Shut);
    door(36.875, 10.6, false, Door::None);
    // Off the spine.
    door(20.925, 13.2, false, Door::Open(true));
    door(20.925, 20.4, false, Door::Open(true));
    door(23.075, 16.4, false, Door::None);
    door(23.075, 19.95, false, Door::None);
    door(20.925, 28.2, false, Door::None);
    door(23.075, 28.2, false, Door::Open(false));
    door(22.0, 30.925, true, Door::None);
    // Off the top corridor.
    door(13.8, 30.925, true, Door::Open(false));
    door(14.4, 33.075, true, Door::Open(true));
    door(20.8, 33.075, true, Door::None);
    door(25.2, 33.075, true, Door::None);
    door(11.925, 32.5, false, Door::None);
    door(17.175, 36.6, false, Door::Shut);
    door(22.425, 36.6, false, Door::None);
    let entrance = (16.15, 6.1);
    s.gap(&f, entrance, false, 1.4, OUTER, (0.0, 2.3), Filling::Entrance);
}

fn windows(s: &mut Storey) {
    let f = Frame::PLAN;
    for x in [18.0, 21.3, 24.8, 28.2, 31.7, 35.0, 38.6, 42.0] {
        s.window(&f, (x, 0.15), true, 1.8);
    }
    for x in [31.6, 35.2, 38.6, 42.0] {
        s.window(&f, (x, 11.85), true, 1.8);
    }
    for (y, width) in [(2.6, 1.8), (6.1, 1.2), (9.5, 1.8)] {
        s.window(&f, (43.85, y), false, width);
    }
    for y in [2.6, 9.5, 15.3, 22.4] {
        s.window(&f, (16.15, y), false, 1.4);
    }
    for y in [13.6, 17.0, 22.4, 28.4, 32.0, 35.4] {
        s.window(&f, (27.85, y), false, 1.4);
    }
    for x in [2.0, 4.6, 7.6, 10.2, 14.5, 19.8, 25.1] {
        s.window(&f, (x, 37.85), true, 1.8);
    }
    for y in [28.0, 30.6, 33.4, 36.0] {
        s.window(&f, (0.15, y), false, 1.8);
    }
    for x in [3.0, 8.5, 14.0] {
        s.window(&f, (x, 26.15), true, 1.4);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outline::at;

    #[test]
    fn twenty_two_rooms_fifteen_lights() {
        let d = drawing();
        let s = &d.storeys[0];
        assert_eq!(s.spaces.len(), 22);
        assert_eq!(s.spaces.iter().filter(|r| r.light.is_some()).count(), 15);
        assert!(d.footprint.iter().any(|p| p.holds(at(17.0, 20.0), 0.0)));
    }
}
