//! The drawing of the octagon: a great hall, a ring of rooms, a ring corridor, an outer ring.
//!
//! Eight sectors, each drawn in a frame of its own whose y axis points outwards; the rooms at the
//! corners lie in two of them. Four corridors with doors between them make the ring.
//!
//! ```text
//!    apothem   0 ....... 9.75 | 9.9 .. 14.5 | 14.65 .. 16.85 | 17 .............. 23.4 | 23.7
//!              great hall       inner rooms    corridor        rooms, baths, stairs
//! ```

use crate::assemble::{Drawing, look};
use crate::fittings::grid;
use crate::lamps::{NEUTRAL, WARM};
use crate::outline::{Convex, Frame, at};
use crate::plan::{Filling, Panel};
use crate::storey::{Door, Light, OUTER, Storey, Use, WALL, Weight};

/// tan 22.5 degrees: half a side of an octagon with apothem 1.
const K: f64 = std::f64::consts::SQRT_2 - 1.0;
/// Apothems where the hall ends, and between which the rings lie.
const HALL: f64 = 9.75;
const INNER: (f64, f64) = (9.9, 14.5);
const RING: (f64, f64) = (14.65, 16.85);
const OUT: (f64, f64) = (17.0, 23.4);
const FACADE: f64 = 23.7;
/// How far corner rooms reach from their corner along the inner side.
const INNER_LEG: f64 = 0.7;
const OUT_LEG: f64 = 1.5;

fn sector(i: usize) -> Frame {
    Frame::turned(45.0 * (i % 8) as f64)
}

/// The octagon's drawing.
pub fn drawing() -> Drawing {
    let mut storeys: Vec<Storey> = (0..3).map(storey).collect();
    let views = vec![
        look(&mut storeys[0], "great-hall", 0, (0.6, -8.6, 1.65), (0.0, 2.0, 1.0), 62.0),
        look(&mut storeys[1], "dining-hall", 1, (6.4, 6.0, 1.65), (-3.0, -2.0, 0.9), 60.0),
        look(&mut storeys[0], "ring", 0, (1.2, 15.9, 1.6), (10.6, 11.4, 1.2), 60.0),
    ];
    let corner = |i: usize| sector(i).point(FACADE * K, FACADE);
    let footprint = (0..8).map(|i| Convex(vec![at(0.0, 0.0), corner(i), corner(i + 1)])).collect();
    Drawing { name: "octagon", footprint, storeys, furnishings: 1, views }
}

fn light(s: &mut Storey, room: usize, light: Light) {
    s.spaces[room].light = Some(light);
}

fn storey(level: usize) -> Storey {
    let mut s = Storey { triangles: [1_952_000, 1_642_000, 1_642_000][level], ..Storey::default() };
    let hall = Convex((0..8).map(|i| sector(i).point(HALL * K, HALL)).collect());
    let (use_, weight) =
        [(Use::Library, 449_000), (Use::Restaurant, 210_000), (Use::Lobby, 160_000)][level];
    let room = s.space("hall", use_, vec![hall], 0.0, Weight::Triangles(weight));
    let area = (-7.6, -7.6, 7.6, 7.6);
    light(&mut s, room, grid(&Frame::PLAN, area, (5, 5), Panel::Square, false, WARM));
    for quarter in 0..4 {
        corridor(&mut s, quarter);
    }
    for i in 0..8 {
        inner(&mut s, i, level);
        outer(&mut s, i, level);
    }
    s
}

/// A quarter of the ring corridor: from the middle of one sector to the middle of the next but one.
fn corridor(s: &mut Storey, quarter: usize) {
    let (a, b) = RING;
    let i = 2 * quarter;
    let half = WALL / 2.0;
    let pieces = vec![
        sector(i).outline(&[(-a * K, a), (-half, a), (-half, b), (-b * K, b)]),
        sector(i + 1).outline(&[(0.0, a), (a * K, a), (b * K, b), (0.0, b)]),
        sector(i + 1).outline(&[(-a * K, a), (0.0, a), (0.0, b), (-b * K, b)]),
        sector(i + 2).outline(&[(half, a), (a * K, a), (b * K, b), (half, b)]),
    ];
    let f = sector(i + 1);
    let room =
        s.space(format!("ring-{}", quarter + 1), Use::Corridor, pieces, f.turn, Weight::Share(9.0));
    let middle = f64::midpoint(a, b);
    let mut points = vec![sector(i).point(-3.4, middle)];
    points.extend([4.2, 0.0, -4.2].map(|x| f.point(x, middle)));
    points.push(sector(i + 2).point(3.4, middle));
    light(s, room, Light { panel: Panel::Round, points, each: false, turn: f.turn, colour: WARM });
    s.door(&sector(i), (0.0, middle), false, WALL, Door::None);
}

/// The rooms between hall and corridor in sector `i`, and the corner room to its right.
fn inner(s: &mut Storey, i: usize, level: usize) {
    let f = sector(i);
    let (a, b) = INNER;
    let long = a * K - INNER_LEG;
    let wall = b + WALL / 2.0;
    for (j, (x0, x1)) in [(-long, -WALL / 2.0), (WALL / 2.0, long)].into_iter().enumerate() {
        let middle = f64::midpoint(x0, x1);
        // Four foyers lead into the hall.
        let foyer = i.is_multiple_of(2) && j == 0;
        let dark = i == 3 && j == 1 || i == 7 && j == 1 && level > 0;
        let use_ = match (foyer, dark, (i + j + level) % 3) {
            (true, ..) => Use::Lobby,
            (_, true, _) => Use::Store,
            (.., 0) => Use::Office,
            (.., 1) => Use::Lounge,
            _ => Use::Studio,
        };
        let name = format!("inner-{}{}", i + 1, ["a", "b"][j]);
        let room = s.space(name, use_, vec![f.rect(x0, a, x1, b)], f.turn, Weight::Share(16.0));
        if !dark {
            let colour = if use_ == Use::Lounge { WARM } else { NEUTRAL };
            light(s, room, grid(&f, (x0, a, x1, b), (1, 2), Panel::Square, false, colour));
        }
        let door = if (i + j) % 3 == 1 { Door::Open(false) } else { Door::None };
        s.door(&f, (middle, wall), true, WALL, door);
        if foyer {
            s.door(&f, (middle, a - WALL / 2.0), true, WALL, Door::None);
        }
    }
    let x = long + WALL;
    let right = sector(i + 7);
    let pieces = vec![
        f.outline(&[(x, a), (a * K, a), (b * K, b), (x, b)]),
        right.outline(&[(-a * K, a), (-x, a), (-x, b), (-b * K, b)]),
    ];
    let turn = f.turn - 22.5;
    s.space(format!("closet-{}", i + 1), Use::Store, pieces, turn, Weight::Share(11.0));
    s.door(&f, (f64::midpoint(x, b * K) - 0.2, wall), true, WALL, Door::Open(false));
    if i % 4 == 1 {
        // Two rooms that one walks through.
        s.door(&f, (0.0, 11.0), false, WALL, Door::None);
    }
}

/// The rooms at the facade in sector `i`, and the corner room to its right.
fn outer(s: &mut Storey, i: usize, level: usize) {
    let f = sector(i);
    let (a, b) = OUT;
    let long = a * K - OUT_LEG;
    let wide = (2.0 * long - 2.0 * WALL) / 3.0;
    let wall = a - WALL / 2.0;
    let pane = b + OUTER / 2.0;
    for j in 0..3 {
        let x0 = -long + (wide + WALL) * f64::from(j);
        let x1 = x0 + wide;
        let middle = f64::midpoint(x0, x1);
        let name = format!("outer-{}{}", i + 1, ["a", "b", "c"][j as usize]);
        let all = (x0, a, x1, b);
        if j == 1 && i.is_multiple_of(4) {
            let room = s.stair(&format!("stairwell-{}", i / 4 + 1), &f, (x0, x1), a, b - a);
            let strip = (x0 + 1.3, a, x1, b);
            light(s, room, grid(&f, strip, (1, 2), Panel::Square, false, NEUTRAL));
            s.door(&f, (x0 + 2.4, wall), true, WALL, Door::None);
            s.window(&f, (x0 + 2.5, pane), true, 1.4);
            continue;
        } else if j == 1 && i == 2 && level == 0 {
            // The way in: a vestibule, and the porter behind it.
            let cut = a + 3.2;
            let lobby = (x0, cut + WALL, x1, b);
            let porter = (x0, a, x1, cut);
            for (name, use_, r) in
                [("porter", Use::Office, porter), ("vestibule", Use::Lobby, lobby)]
            {
                let rect = f.rect(r.0, r.1, r.2, r.3);
                let room = s.space(name, use_, vec![rect], f.turn, Weight::Share(12.0));
                light(s, room, grid(&f, r, (1, 1), Panel::Square, false, NEUTRAL));
            }
            s.door(&f, (x0 + 0.9, cut + WALL / 2.0), true, WALL, Door::None);
            s.door(&f, (x0 + 0.9, wall), true, WALL, Door::None);
            s.gap(&f, (middle, pane), true, 1.8, OUTER, (0.0, 2.3), Filling::Entrance);
            continue;
        } else if j == 1 {
            let use_ = [Use::Office, Use::Meeting, Use::Studio][(i + level) % 3];
            let room = s.space(name, use_, vec![f.rect(x0, a, x1, b)], f.turn, Weight::Share(23.0));
            light(s, room, grid(&f, all, (1, 3), Panel::Square, false, NEUTRAL));
            s.door(&f, (middle + 0.9, wall), true, WALL, Door::Open(true));
        } else {
            suite(
                s,
                &f,
                all,
                name,
                [Use::Bedroom, Use::Lounge, Use::Bedroom, Use::Office]
                    [(i + level + j as usize / 2) % 4],
            );
        }
        s.window(&f, (middle, pane), true, 1.8);
    }
    let x = long + WALL;
    let right = sector(i + 7);
    let pieces = vec![
        f.outline(&[(x, a), (a * K, a), (b * K, b), (x, b)]),
        right.outline(&[(-a * K, a), (-x, a), (-x, b), (-b * K, b)]),
    ];
    let use_ = [Use::Lounge, Use::Office, Use::Library, Use::Meeting][(i + level) % 4];
    let room =
        s.space(format!("corner-{}", i + 1), use_, pieces, f.turn - 22.5, Weight::Share(30.0));
    let points = vec![f.point(x + 1.5, 19.2), f.point(x + 2.0, 21.4), right.point(-x - 2.0, 21.4)];
    light(s, room, Light { panel: Panel::Round, points, each: false, turn: f.turn, colour: WARM });
    s.door(
        &f,
        (x + 0.7, wall),
        true,
        WALL,
        if i.is_multiple_of(3) { Door::Open(true) } else { Door::None },
    );
    let pane_x = f64::midpoint(x, b * K);
    s.window(&f, (pane_x, pane), true, 1.4);
    s.window(&right, (-pane_x, pane), true, 1.4);
}

/// A room with a bath beside its entrance.
fn suite(s: &mut Storey, f: &Frame, (x0, a, x1, b): (f64, f64, f64, f64), name: String, use_: Use) {
    let (x, y) = (x0 + 1.55, a + 2.55);
    let pieces = vec![f.rect(x0, y + WALL, x1, b), f.rect(x + WALL, a, x1, y + WALL)];
    let bath = vec![f.rect(x0, a, x, y)];
    s.space(format!("{name}/bath"), Use::Bath, bath, f.turn, Weight::Share(6.5));
    let room = s.space(name, use_, pieces, f.turn, Weight::Share(21.0));
    let panels = grid(f, (x0, y + WALL, x1, b), (1, 2), Panel::Round, false, WARM);
    light(s, room, panels);
    let hall = f64::midpoint(x + WALL, x1);
    s.door(f, (hall, a - WALL / 2.0), true, WALL, Door::None);
    s.door(
        f,
        (x + WALL / 2.0, a + 1.2),
        false,
        WALL,
        if x0 < 0.0 { Door::None } else { Door::Shut },
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_hundred_and_thirty_two_rooms() {
        let d = drawing();
        let rooms: Vec<usize> = d.storeys.iter().map(|s| s.spaces.len()).collect();
        assert_eq!(rooms, [78, 77, 77]);
        let lit = d.storeys.iter().flat_map(|s| &s.spaces).filter(|r| r.light.is_some()).count();
        assert_eq!(lit, 155);
    }
}
