//! Models as people have them: flipped and doubled faces, gaps, sheets, furniture through walls. And shapes that are
//! no boxes: vaults, corners, corridors that branch.

use enf_layout::bsp::LEAF_OUTSIDE;
use enf_rooms::{Bsp, Hint, Options, RoomCount, Tables, partition};
use glam::DVec3;
use proptest::prelude::*;

type Triangle = [[f32; 3]; 3];

#[derive(Clone, Default)]
struct Model {
    triangles: Vec<Triangle>,
}

impl Model {
    fn quad(&mut self, c: [[f64; 3]; 4]) {
        let c = c.map(|p| p.map(|x| x as f32));
        self.triangles.push([c[0], c[1], c[2]]);
        self.triangles.push([c[0], c[2], c[3]]);
    }

    fn solid(&mut self, lo: [f64; 3], hi: [f64; 3]) {
        let p = |i: usize| {
            [
                if i & 1 == 0 { lo[0] } else { hi[0] },
                if i & 2 == 0 { lo[1] } else { hi[1] },
                if i & 4 == 0 { lo[2] } else { hi[2] },
            ]
        };
        for q in
            [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]]
        {
            self.quad(q.map(p));
        }
    }

    fn options(&self) -> Options {
        let mut min = [f32::INFINITY; 3];
        let mut max = [f32::NEG_INFINITY; 3];
        for p in self.triangles.iter().flatten() {
            for k in 0..3 {
                min[k] = min[k].min(p[k]);
                max[k] = max[k].max(p[k]);
            }
        }
        Options {
            delta: 32.0 / 524_288.0,
            bounds_min: min,
            bounds_max: max,
            rooms: RoomCount::Auto,
            hints: vec![],
        }
    }

    fn tables(&self, hints: Vec<Hint>) -> Tables {
        let options = Options { hints, ..self.options() };
        partition(&self.triangles, &|_| true, &options).unwrap().finish(&self.triangles)
    }
}

fn room(t: &Tables, p: [f64; 3]) -> u32 {
    let delta = 32.0 / 524_288.0;
    let bsp = Bsp::new(&t.planes, &t.nodes, &t.leaves, &t.faces, delta).unwrap();
    bsp.leaves[bsp.locate(DVec3::from_array(p)) as usize].room
}

fn inside(t: &Tables) -> usize {
    t.rooms.iter().filter(|r| r.flags & LEAF_OUTSIDE == 0).count()
}

fn opening(t: &Tables, a: u32, b: u32) -> f64 {
    let sum = t.portals.iter().filter(|p| (p.room, p.other) == (a, b));
    sum.map(|p| f64::from(p.area_m2)).sum()
}

/// Three rooms in a row; walls of 0.2 m in pieces, with a gap between these; two doors of 0.9 by 2.1 m.
fn three_rooms(gap: f64) -> Model {
    let mut m = Model::default();
    m.solid([-0.3, -0.3, -0.3], [15.1, 5.3, 0.0]);
    m.solid([-0.3, -0.3, 2.6], [15.1, 5.3, 2.9]);
    for y in [-0.3, 5.0] {
        for (a, b) in [(-0.3, 5.0), (5.0, 10.0), (10.0, 15.1)] {
            m.solid([a, y, 0.0], [b - gap, y + 0.3, 2.6]);
        }
    }
    for x in [-0.3, 14.8] {
        m.solid([x, gap, 0.0], [x + 0.3, 5.0 - gap, 2.6]);
    }
    for (x, door) in [(4.8, 1.0), (9.8, 3.0)] {
        m.solid([x, gap, 0.0], [x + 0.2, door, 2.6 - gap]);
        m.solid([x, door + 0.9, 0.0], [x + 0.2, 5.0 - gap, 2.6 - gap]);
        m.solid([x, door, 2.1], [x + 0.2, door + 0.9, 2.6 - gap]);
    }
    m
}

fn check_three(m: &Model, area: f64) {
    let t = m.tables(vec![]);
    assert_eq!(inside(&t), 3, "{:#?}", t.rooms);
    let at = |x: f64| room(&t, [x, 2.5, 1.5]);
    let (a, b, c) = (at(2.0), at(7.0), at(12.0));
    assert!(a != b && b != c && a != c);
    assert!((opening(&t, a, b) - 1.89).abs() < area, "{}", opening(&t, a, b));
    assert!((opening(&t, b, c) - 1.89).abs() < area, "{}", opening(&t, b, c));
}

#[test]
fn faces_that_are_there_twice() {
    let mut m = three_rooms(0.0);
    let twice = m.triangles.clone();
    m.triangles.extend(twice.into_iter().map(|t| [t[2], t[1], t[0]]));
    check_three(&m, 0.02);
}

#[test]
fn a_model_that_is_inside_out() {
    let mut m = three_rooms(0.0);
    for t in &mut m.triangles {
        t.swap(1, 2);
    }
    check_three(&m, 0.02);
}

/// Boards half a millimetre off both sides of a wall: the plane that divides the rooms is the wall, not somewhere in between,
/// and what a ray meets on the wall belongs to the room that it faces.
#[test]
fn a_wall_belongs_to_the_room_that_it_faces() {
    for turn in [0.0_f64, 0.3, 0.7] {
        let mut m = three_rooms(0.0);
        for (x, y) in [(4.7996, 2.2), (5.0004, 2.8)] {
            m.quad([[x, y, 0.5], [x, y + 1.5, 0.5], [x, y + 1.5, 2.5], [x, y, 2.5]]);
        }
        let (sin, cos) = turn.sin_cos();
        let turned = |p: [f64; 3]| [cos * p[0] - sin * p[1], sin * p[0] + cos * p[1], p[2]];
        for p in m.triangles.iter_mut().flatten() {
            *p = turned(p.map(f64::from)).map(|x| x as f32);
        }
        let t = m.tables(vec![]);
        let at = |x: f64, y: f64, z: f64| room(&t, turned([x, y, z]));
        let (a, b) = (at(2.0, 2.5, 1.5), at(7.0, 2.5, 1.5));
        assert_ne!(a, b);
        let lift = 32.0 / 524_288.0 / 4.0;
        for i in 0..400 {
            let (y, z) = (2.0 + 2.9 * f64::from(i % 20) / 20.0, 0.05 + 0.125 * f64::from(i / 20));
            assert_eq!(at(4.8 - lift, y, z), a, "west face, {y} {z}, turned by {turn}");
            assert_eq!(at(5.0 + lift, y, z), b, "east face, {y} {z}, turned by {turn}");
        }
    }
}

#[test]
fn gaps_of_up_to_a_centimetre_between_the_pieces_of_walls() {
    for gap in [0.001, 0.005, 0.01] {
        // A crack at the ceiling is an opening as well.
        check_three(&three_rooms(gap), 0.02 + 12.0 * gap);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn normals_that_point_anywhere(flips in proptest::collection::vec(any::<bool>(), 600)) {
        let mut m = three_rooms(0.0);
        for (t, &flip) in m.triangles.iter_mut().zip(&flips) {
            if flip {
                t.swap(1, 2);
            }
        }
        check_three(&m, 0.02);
    }

    #[test]
    fn furniture_through_walls(x in 3.0..4.7_f64, y in 2.2..4.0_f64, w in 0.3..2.5_f64, h in 0.2..1.0_f64) {
        let mut m = three_rooms(0.0);
        m.solid([x, y, 0.0], [x + w, y + 0.6, h]);
        m.solid([11.0, -0.15, 0.4], [13.0, 0.7, 0.4 + h]);
        let t = m.tables(vec![]);
        prop_assert_eq!(inside(&t), 3);
        prop_assert!(room(&t, [2.0, 1.5, 1.5]) != room(&t, [7.0, 1.5, 1.5]));
    }
}

/// Corridors 2 m wide and 2.6 m high as single sheets: the outline, counter-clockwise in plan.
fn corridors(outline: &[[f64; 2]], floors: &[[f64; 4]]) -> Model {
    let mut m = Model::default();
    let z = 2.6;
    for i in 0..outline.len() {
        let (a, b) = (outline[i], outline[(i + 1) % outline.len()]);
        m.quad([[a[0], a[1], 0.0], [a[0], a[1], z], [b[0], b[1], z], [b[0], b[1], 0.0]]);
    }
    for &[x0, y0, x1, y1] in floors {
        m.quad([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]]);
        m.quad([[x0, y0, z], [x0, y1, z], [x1, y1, z], [x1, y0, z]]);
    }
    m
}

#[test]
fn a_corridor_goes_around_a_corner() {
    let m = corridors(
        &[[0.0, 0.0], [10.0, 0.0], [10.0, 2.0], [2.0, 2.0], [2.0, 12.0], [0.0, 12.0]],
        &[[0.0, 0.0, 10.0, 2.0], [0.0, 2.0, 2.0, 12.0]],
    );
    assert_eq!(inside(&m.tables(vec![])), 1);
}

#[test]
fn a_corridor_that_branches_off_is_another_one() {
    let m = corridors(
        &[
            [-10.0, 0.0],
            [10.0, 0.0],
            [10.0, 2.0],
            [1.0, 2.0],
            [1.0, 12.0],
            [-1.0, 12.0],
            [-1.0, 2.0],
            [-10.0, 2.0],
        ],
        &[[-10.0, 0.0, 10.0, 2.0], [-1.0, 2.0, 1.0, 12.0]],
    );
    let t = m.tables(vec![]);
    assert!(inside(&t) >= 2, "{:#?}", t.rooms);
    assert_ne!(room(&t, [0.0, 8.0, 1.0]), room(&t, [8.0, 1.0, 1.0]));
}

#[test]
fn a_room_around_a_corner_and_an_alcove_are_one_room() {
    // 5 x 4 m, a wing of 3 x 3 m, and a bay of 2 x 1 m.
    let m = corridors(
        &[
            [0.0, 0.0],
            [2.0, 0.0],
            [2.0, -1.0],
            [4.0, -1.0],
            [4.0, 0.0],
            [5.0, 0.0],
            [5.0, 7.0],
            [2.0, 7.0],
            [2.0, 4.0],
            [0.0, 4.0],
        ],
        &[[0.0, 0.0, 5.0, 4.0], [2.0, 4.0, 5.0, 7.0], [2.0, -1.0, 4.0, 0.0]],
    );
    assert_eq!(inside(&m.tables(vec![])), 1);
}

#[test]
fn a_hall_with_a_vault_is_a_room() {
    let mut m = Model::default();
    let (r, length, spring) = (4.0, 20.0, 4.0);
    m.quad([[-r, 0.0, 0.0], [r, 0.0, 0.0], [r, length, 0.0], [-r, length, 0.0]]);
    for x in [-r, r] {
        m.quad([[x, 0.0, 0.0], [x, length, 0.0], [x, length, spring], [x, 0.0, spring]]);
    }
    let steps = 48;
    let at = |i: usize| {
        let a = std::f64::consts::PI * i as f64 / f64::from(steps);
        (r * libm::cos(a), spring + r * libm::sin(a))
    };
    for i in 0..steps as usize {
        let ((x0, z0), (x1, z1)) = (at(i), at(i + 1));
        m.quad([[x0, 0.0, z0], [x0, length, z0], [x1, length, z1], [x1, 0.0, z1]]);
        for y in [0.0, length] {
            m.quad([[0.0, y, spring], [x0, y, z0], [x1, y, z1], [0.0, y, spring]]);
        }
    }
    for y in [0.0, length] {
        m.quad([[-r, y, 0.0], [r, y, 0.0], [r, y, spring], [-r, y, spring]]);
    }
    m.triangles.retain(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]);
    // Something beside it, so that there is an open space around.
    m.solid([20.0, 0.0, 0.0], [21.0, 20.0, 12.0]);
    let t = m.tables(vec![]);
    let hall = room(&t, [0.0, 10.0, 1.5]);
    assert_ne!(Some(hall), t.outside);
    assert_eq!(room(&t, [2.0, 3.0, 3.0]), hall);
    assert_eq!(Some(room(&t, [12.0, 10.0, 1.5])), t.outside);
}

#[test]
fn a_hint_may_be_any_polygon() {
    // An open hall of 10 x 10 m, with an L and a triangle in it.
    let mut m = Model::default();
    m.solid([-0.3, -0.3, -0.3], [10.3, 10.3, 0.0]);
    m.solid([-0.3, -0.3, 3.0], [10.3, 10.3, 3.3]);
    for (lo, hi) in [
        ([-0.3, -0.3], [10.3, 0.0]),
        ([-0.3, 10.0], [10.3, 10.3]),
        ([-0.3, 0.0], [0.0, 10.0]),
        ([10.0, 0.0], [10.3, 10.0]),
    ] {
        m.solid([lo[0], lo[1], 0.0], [hi[0], hi[1], 3.0]);
    }
    let hint = |polygon: &[[f32; 2]]| Hint {
        min: [0.0, 0.0, 0.0],
        max: [0.0, 0.0, 3.0],
        polygon: polygon.to_vec(),
    };
    let l = hint(&[[0.0, 0.0], [6.0, 0.0], [6.0, 3.0], [3.0, 3.0], [3.0, 6.0], [0.0, 6.0]]);
    let triangle = hint(&[[10.0, 10.0], [6.0, 10.0], [10.0, 6.0]]);
    let t = m.tables(vec![l, triangle]);
    assert_eq!(inside(&t), 3, "{:#?}", t.rooms);
    let (a, b, c) =
        (room(&t, [1.0, 5.0, 1.0]), room(&t, [9.0, 9.0, 1.0]), room(&t, [5.0, 5.0, 1.0]));
    assert_eq!(room(&t, [5.0, 1.0, 1.0]), a);
    assert!(a != b && b != c && a != c);
    for (id, area) in [(a, 27.0), (b, 8.0), (c, 65.0)] {
        let got = f64::from(t.rooms[id as usize].floor_area_m2);
        assert!((got - area).abs() < 0.01, "{got} instead of {area}");
    }
    // A polygon without area is no room.
    let flat = hint(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]);
    let options = Options { hints: vec![flat], ..m.options() };
    assert!(partition(&m.triangles, &|_| true, &options).is_err());
}
