//! Rooms and portals of small buildings whose plans are known.

use enf_layout::bsp::{LEAF_OUTSIDE, LEAF_SOLID};
use enf_rooms::{Bsp, Hint, Options, RoomCount, RoomsError, Tables, TileLimit, partition};
use glam::DVec3;

type Triangle = [[f32; 3]; 3];

/// Corner points of quads, turned about the vertical at the end.
#[derive(Default)]
struct Model {
    triangles: Vec<Triangle>,
    panes: Vec<usize>,
    turn: f64,
}

impl Model {
    fn quad(&mut self, corners: [[f64; 3]; 4]) {
        let (sin, cos) = (libm::sin(self.turn), libm::cos(self.turn));
        let turned = corners
            .map(|[x, y, z]| [(x * cos - y * sin) as f32, (x * sin + y * cos) as f32, z as f32]);
        let [a, b, c, d] = turned;
        self.triangles.push([a, b, c]);
        self.triangles.push([a, c, d]);
    }

    /// A closed box, its faces looking out.
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

    /// A wall along x at y (thickness along y), with doors `(from, to, head)`.
    fn wall_x(&mut self, x: [f64; 2], y: [f64; 2], z: [f64; 2], doors: &[(f64, f64, f64)]) {
        let mut at = x[0];
        for &(from, to, head) in doors {
            self.solid([at, y[0], z[0]], [from, y[1], z[1]]);
            if head < z[1] {
                self.solid([from, y[0], head], [to, y[1], z[1]]);
            }
            at = to;
        }
        self.solid([at, y[0], z[0]], [x[1], y[1], z[1]]);
    }

    fn wall_y(&mut self, x: [f64; 2], y: [f64; 2], z: [f64; 2], doors: &[(f64, f64, f64)]) {
        let mut at = y[0];
        for &(from, to, head) in doors {
            self.solid([x[0], at, z[0]], [x[1], from, z[1]]);
            if head < z[1] {
                self.solid([x[0], from, head], [x[1], to, z[1]]);
            }
            at = to;
        }
        self.solid([x[0], at, z[0]], [x[1], y[1], z[1]]);
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
        let extent = (0..3).map(|k| (max[k] - min[k]).powi(2)).sum::<f32>().sqrt();
        let reach = (0..3).fold(extent, |m, k| m.max(min[k].abs()).max(max[k].abs()));
        let delta = (reach as u32 + 1).next_power_of_two() as f32 / 524_288.0;
        Options { delta, bounds_min: min, bounds_max: max, rooms: RoomCount::Auto, hints: vec![] }
    }

    fn tables(&self, options: &Options) -> Tables {
        let parted = partition(&self.triangles, &|i| !self.panes.contains(&i), options).unwrap();
        let inside = parted.room_count_without_outside();
        let tables = parted.finish(&self.triangles);
        assert_eq!(inside, tables.rooms.len() - usize::from(tables.outside.is_some()));
        Bsp::new(
            &tables.planes,
            &tables.nodes,
            &tables.leaves,
            &tables.faces,
            f64::from(options.delta),
        )
        .unwrap();
        tables
    }

    fn room_at(&self, tables: &Tables, options: &Options, p: [f64; 3]) -> u32 {
        let bsp = Bsp::new(
            &tables.planes,
            &tables.nodes,
            &tables.leaves,
            &tables.faces,
            f64::from(options.delta),
        )
        .unwrap();
        let (sin, cos) = (libm::sin(self.turn), libm::cos(self.turn));
        let p = DVec3::new(p[0] * cos - p[1] * sin, p[0] * sin + p[1] * cos, p[2]);
        bsp.leaves[bsp.locate(p) as usize].room
    }
}

fn inside(tables: &Tables) -> usize {
    tables.rooms.iter().filter(|r| r.flags & LEAF_OUTSIDE == 0).count()
}

/// Area of the openings between two rooms.
fn opening(tables: &Tables, a: u32, b: u32) -> f64 {
    let sum = tables.portals.iter().filter(|p| (p.room, p.other) == (a, b));
    sum.map(|p| f64::from(p.area_m2)).sum()
}

/// Two boxes of single sheets that share a wall with a door of 0.9 by 2.1 m.
fn sheets() -> Model {
    let mut m = Model::default();
    let (x0, x1, x2, y, z) = (0.0, 4.0, 9.0, 5.0, 2.5);
    for (a, b) in [(x0, x1), (x1, x2)] {
        m.quad([[a, 0.0, 0.0], [b, 0.0, 0.0], [b, y, 0.0], [a, y, 0.0]]);
        m.quad([[a, 0.0, z], [a, y, z], [b, y, z], [b, 0.0, z]]);
        m.quad([[a, 0.0, 0.0], [a, 0.0, z], [b, 0.0, z], [b, 0.0, 0.0]]);
        m.quad([[a, y, 0.0], [b, y, 0.0], [b, y, z], [a, y, z]]);
    }
    for x in [x0, x2] {
        m.quad([[x, 0.0, 0.0], [x, y, 0.0], [x, y, z], [x, 0.0, z]]);
    }
    let x = x1;
    m.quad([[x, 0.0, 0.0], [x, 2.0, 0.0], [x, 2.0, z], [x, 0.0, z]]);
    m.quad([[x, 2.9, 0.0], [x, y, 0.0], [x, y, z], [x, 2.9, z]]);
    m.quad([[x, 2.0, 2.1], [x, 2.9, 2.1], [x, 2.9, z], [x, 2.0, z]]);
    m
}

#[test]
fn two_boxes_of_single_sheets_with_a_door() {
    let m = sheets();
    let options = m.options();
    let t = m.tables(&options);
    assert_eq!(inside(&t), 2);
    let a = m.room_at(&t, &options, [2.0, 2.5, 1.0]);
    let b = m.room_at(&t, &options, [7.0, 2.5, 1.0]);
    assert_ne!(a, b);
    assert_eq!(t.portals.len(), 2);
    let open = opening(&t, a, b);
    assert!((open / (0.9 * 2.1) - 1.0).abs() < 1e-3, "{open}");
    assert_eq!(opening(&t, b, a), open);
    let areas = [
        f64::from(t.rooms[a as usize].floor_area_m2),
        f64::from(t.rooms[b as usize].floor_area_m2),
    ];
    assert!((areas[0] - 20.0).abs() < 1e-3 && (areas[1] - 25.0).abs() < 1e-3, "{areas:?}");
    assert!((f64::from(t.rooms[a as usize].volume_m3) - 50.0).abs() < 1e-3);
    // Pieces face the room that they are listed for.
    for p in &t.portals {
        for piece in &t.pieces[p.first_piece as usize..(p.first_piece + p.piece_count) as usize] {
            let c = piece
                .corners
                .map(|c| DVec3::new(f64::from(c[0]), f64::from(c[1]), f64::from(c[2])));
            let normal = (c[1] - c[0]).cross(c[2] - c[0]);
            let r = t.rooms[p.room as usize].inside;
            let room = DVec3::new(f64::from(r[0]), f64::from(r[1]), f64::from(r[2]));
            assert!(normal.dot(room - c[0]) > 0.0);
        }
    }
    for r in t.rooms.iter().filter(|r| r.flags == 0) {
        assert!((r.inside[2] - 1.6).abs() < 1e-3, "{r:?}");
    }
}

/// Three rooms along a corridor, walls of 0.2 m, doors, a window and furniture.
fn corridor(turn: f64) -> Model {
    let mut m = Model { turn, ..Model::default() };
    let z = [0.0, 2.6];
    m.solid([-0.3, -0.3, -0.3], [12.3, 7.3, 0.0]);
    m.solid([-0.3, -0.3, 2.6], [12.3, 7.3, 2.9]);
    m.wall_x([-0.3, 12.3], [-0.3, 0.0], z, &[(5.0, 6.0, 2.1)]);
    m.wall_x([-0.3, 12.3], [7.0, 7.3], z, &[]);
    m.wall_y([-0.3, 0.0], [0.0, 7.0], z, &[]);
    m.wall_y([12.0, 12.3], [0.0, 7.0], z, &[]);
    m.wall_x([0.0, 12.0], [1.8, 2.0], z, &[(1.0, 1.9, 2.1), (5.0, 5.9, 2.1), (9.0, 9.9, 2.1)]);
    m.wall_y([3.9, 4.1], [2.0, 7.0], z, &[]);
    m.wall_y([7.9, 8.1], [2.0, 7.0], z, &[(4.0, 4.9, 2.1)]);
    // Tables and a cupboard.
    m.solid([1.0, 4.0, 0.7], [2.5, 5.0, 0.74]);
    m.solid([9.0, 4.0, 0.7], [11.0, 5.2, 0.74]);
    m.solid([5.0, 6.4, 0.0], [7.0, 7.0, 2.0]);
    m
}

fn check_corridor(turn: f64) {
    let m = corridor(turn);
    let options = m.options();
    let t = m.tables(&options);
    assert_eq!(inside(&t), 4, "{:#?}", t.rooms);
    let at = |x, y| m.room_at(&t, &options, [x, y, 1.5]);
    let hall = at(6.0, 1.0);
    let rooms = [at(2.0, 3.0), at(6.0, 3.0), at(10.0, 3.0)];
    for &r in &rooms {
        assert_ne!(r, hall);
        let open = opening(&t, hall, r);
        assert!((open / (0.9 * 2.1) - 1.0).abs() < 0.01, "{open}");
    }
    assert!((opening(&t, rooms[1], rooms[2]) / (0.9 * 2.1) - 1.0).abs() < 0.01);
    assert_eq!(opening(&t, rooms[0], rooms[1]), 0.0);
    let out = t.outside.unwrap();
    assert!((opening(&t, hall, out) / 2.1 - 1.0).abs() < 0.01);
    // Doorways belong to one of their sides, so an area may hold that of a doorway or two.
    for (r, area) in [(rooms[0], 3.9 * 5.0), (hall, 12.0 * 1.8)] {
        let got = f64::from(t.rooms[r as usize].floor_area_m2);
        assert!(got >= area * 0.999 && got <= area + 1.0, "{got} instead of {area}");
    }
    assert!(t.leaves.iter().any(|l| l.flags & LEAF_SOLID != 0));
    // In the middle of a wall.
    let bsp = Bsp::new(&t.planes, &t.nodes, &t.leaves, &t.faces, f64::from(options.delta)).unwrap();
    let (sin, cos) = (libm::sin(turn), libm::cos(turn));
    let p = DVec3::new(3.0 * cos - 1.9 * sin, 3.0 * sin + 1.9 * cos, 1.0);
    assert_ne!(bsp.leaves[bsp.locate(p) as usize].flags & LEAF_SOLID, 0);
}

#[test]
fn rooms_along_a_corridor() {
    check_corridor(0.0);
}

#[test]
fn rooms_along_a_corridor_turned_by_30_degrees() {
    check_corridor(30.0_f64.to_radians());
}

#[test]
fn a_wall_of_45_degrees_divides() {
    let mut m = Model::default();
    let z = 3.0;
    m.quad([[0.0, 0.0, 0.0], [8.0, 0.0, 0.0], [8.0, 8.0, 0.0], [0.0, 8.0, 0.0]]);
    m.quad([[0.0, 0.0, z], [0.0, 8.0, z], [8.0, 8.0, z], [8.0, 0.0, z]]);
    for [a, b] in [
        [[0.0, 0.0], [8.0, 0.0]],
        [[8.0, 0.0], [8.0, 8.0]],
        [[8.0, 8.0], [0.0, 8.0]],
        [[0.0, 8.0], [0.0, 0.0]],
    ] {
        m.quad([[a[0], a[1], 0.0], [a[0], a[1], z], [b[0], b[1], z], [b[0], b[1], 0.0]]);
    }
    // The diagonal from (0, 8) to (8, 0) with a door of 1 m by 2 m.
    let s = |t: f64, z: f64| [t * 8.0, 8.0 - t * 8.0, z];
    let (d0, d1) = (0.4, 0.4 + 1.0 / 128.0_f64.sqrt());
    m.quad([s(0.0, 0.0), s(d0, 0.0), s(d0, z), s(0.0, z)]);
    m.quad([s(d1, 0.0), s(1.0, 0.0), s(1.0, z), s(d1, z)]);
    m.quad([s(d0, 2.0), s(d1, 2.0), s(d1, z), s(d0, z)]);
    let options = m.options();
    let t = m.tables(&options);
    assert_eq!(inside(&t), 2);
    assert!((opening(&t, 0, 1) - 2.0).abs() < 0.02, "{}", opening(&t, 0, 1));
}

#[test]
fn a_window_is_a_portal_to_the_outside() {
    let mut m = sheets();
    // A pane in the door: still two rooms, and light passes.
    let before = m.triangles.len();
    m.quad([[4.0, 2.0, 0.0], [4.0, 2.9, 0.0], [4.0, 2.9, 2.1], [4.0, 2.0, 2.1]]);
    m.panes = (before..m.triangles.len()).collect();
    let t = m.tables(&m.options());
    assert_eq!(inside(&t), 2);
    assert!((opening(&t, 0, 1) / (0.9 * 2.1) - 1.0).abs() < 1e-3);
}

#[test]
fn a_box_that_is_open_in_front_is_a_room() {
    for scale in [0.1, 1.0] {
        let mut m = Model::default();
        let s = 5.5 * scale;
        m.quad([[0.0, 0.0, 0.0], [s, 0.0, 0.0], [s, s, 0.0], [0.0, s, 0.0]]);
        m.quad([[0.0, 0.0, s], [0.0, s, s], [s, s, s], [s, 0.0, s]]);
        m.quad([[0.0, s, 0.0], [s, s, 0.0], [s, s, s], [0.0, s, s]]);
        m.quad([[0.0, 0.0, 0.0], [0.0, s, 0.0], [0.0, s, s], [0.0, 0.0, s]]);
        m.quad([[s, 0.0, 0.0], [s, 0.0, s], [s, s, s], [s, s, 0.0]]);
        m.solid([0.15 * s, 0.4 * s, 0.0], [0.4 * s, 0.7 * s, 0.6 * s]);
        let t = m.tables(&m.options());
        assert_eq!(inside(&t), 1, "scale {scale}");
        assert!((opening(&t, 0, 1) / (s * s) - 1.0).abs() < 1e-3);
    }
}

#[test]
fn a_closed_box_is_a_room_whichever_way_it_faces() {
    for inward in [false, true] {
        let mut m = Model::default();
        m.solid([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]);
        if inward {
            for t in &mut m.triangles {
                t.swap(1, 2);
            }
        }
        let options = m.options();
        let t = m.tables(&options);
        assert_eq!(inside(&t), 1, "inward {inward}");
        assert_ne!(Some(m.room_at(&t, &options, [0.5; 3])), t.outside);
    }
}

#[test]
fn as_many_rooms_as_asked_for() {
    for (model, most) in [(corridor(0.0), 9), (sheets(), 7)] {
        let mut options = model.options();
        for n in 1..=most {
            options.rooms = RoomCount::Exactly(n);
            let t = model.tables(&options);
            assert_eq!(inside(&t), n as usize);
            assert_eq!(t.outside.is_none(), n == 1);
            let all: u64 = t.rooms.iter().map(|r| r.triangles).sum();
            assert_eq!(all, model.triangles.len() as u64);
        }
        options.rooms = RoomCount::Exactly(0);
        let err = partition(&model.triangles, &|_| true, &options).unwrap_err();
        assert!(matches!(err, RoomsError::Request(_)));
    }
}

#[test]
fn a_terrain_is_outside_and_can_be_cut_into_rooms() {
    let mut m = Model::default();
    m.quad([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [50.0, 50.0, 3.0], [0.0, 50.0, 3.0]]);
    let mut options = m.options();
    assert_eq!(inside(&m.tables(&options)), 0);
    options.rooms = RoomCount::Exactly(3);
    assert_eq!(inside(&m.tables(&options)), 3);
}

#[test]
fn hints_make_rooms() {
    let m = corridor(0.0);
    let mut options = m.options();
    // One box over the first two rooms, one over half of the corridor.
    options.hints = vec![
        Hint { min: [0.0, 2.0, 0.0], max: [7.9, 7.0, 2.6], polygon: vec![] },
        Hint { min: [0.0, 0.0, 0.0], max: [6.0, 1.8, 2.6], polygon: vec![] },
    ];
    let t = m.tables(&options);
    let at = |x, y| m.room_at(&t, &options, [x, y, 1.5]);
    assert_eq!(at(2.0, 3.0), at(6.0, 3.0));
    assert_ne!(at(3.0, 1.0), at(9.0, 1.0));
    assert_eq!(inside(&t), 4);
}

#[test]
fn tiles_follow_the_limit_and_rooms_do_not() {
    let mut m = corridor(0.0);
    // Many small things in one room.
    for i in 0..20 {
        for j in 0..20 {
            let (x, y) = (0.3 + 0.15 * f64::from(i), 2.3 + 0.2 * f64::from(j));
            m.solid([x, y, 0.01], [x + 0.05, y + 0.05, 0.06]);
        }
    }
    let options = m.options();
    let whole = m.tables(&options);
    let mut parted = partition(&m.triangles, &|_| true, &options).unwrap();
    parted.cut_tiles(&m.triangles, TileLimit::Triangles(800)).unwrap();
    assert!(parted.oversized().is_empty());
    assert!(parted.cut_tiles(&m.triangles, TileLimit::Triangles(800)).is_err());
    let cut = parted.finish(&m.triangles);
    assert!(cut.tiles.len() > whole.tiles.len());
    assert!(cut.tiles.iter().all(|t| t.triangles <= 800));
    assert_eq!(whole.rooms.len(), cut.rooms.len());
    assert_eq!(whole.portals, cut.portals);
    // The same again is the same.
    let mut again = partition(&m.triangles, &|_| true, &options).unwrap();
    again.cut_tiles(&m.triangles, TileLimit::Triangles(800)).unwrap();
    assert_eq!(again.finish(&m.triangles), cut);
    // A star of triangles around a point cannot be cut.
    let star: Vec<Triangle> = (0..2000)
        .map(|i| {
            let a = f64::from(i) * 0.1;
            let p = |a: f64| {
                [
                    5.0 + 4.0 * libm::cos(a) as f32,
                    5.0 + 4.0 * libm::sin(a) as f32,
                    (i % 50) as f32 * 0.1,
                ]
            };
            [[5.0, 5.0, 2.5], p(a), p(a + 0.05)]
        })
        .collect();
    let m = Model { triangles: star, ..Model::default() };
    let mut parted = partition(&m.triangles, &|_| true, &m.options()).unwrap();
    parted.cut_tiles(&m.triangles, TileLimit::Triangles(100)).unwrap();
    assert!(!parted.oversized().is_empty());
}

#[test]
fn bad_input_is_refused() {
    let m = sheets();
    let options = m.options();
    assert_eq!(partition(&[], &|_| true, &options).unwrap_err(), RoomsError::Empty);
    let mut broken = m.triangles.clone();
    broken[3][1][2] = f32::NAN;
    let err = partition(&broken, &|_| true, &options).unwrap_err();
    assert_eq!(err, RoomsError::NotFinite { triangle: 3 });
    broken[3][1][2] = 99.0;
    assert!(matches!(
        partition(&broken, &|_| true, &options).unwrap_err(),
        RoomsError::Bounds { .. }
    ));
    let bad = Options { delta: 0.0, ..options };
    assert!(partition(&m.triangles, &|_| true, &bad).is_err());
}
