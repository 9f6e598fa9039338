//! Furnished rooms, drawn from arithmetic alone: the same bits everywhere.
//!
//! A room is 8 x 6 x 3 m. What stands in it is the same for every number of triangles, and only the
//! tessellation changes: tables and chairs of curved wood, shelves of books, a sofa, lamps, plants with leaves,
//! curtains, a rug. Vertices are irregular (a patch's inner ones are moved at random, and so are the lines
//! by which walls are cut), so that no structure is lucky. The shell is closed, to the bit.

use glam::Vec3;

use crate::random::{Random, mix};
use crate::scene::{Light, Room, Scene};

/// Inner size of a room, m.
const SIZE: [f64; 3] = [8.0, 6.0, 3.0];
/// Thickness of a wall, m; a power of two, so that both sides agree on its middle.
const WALL: f64 = 0.25;
/// Where doors are in the walls along x and along y, m from the lower end.
const DOORS: [[f64; 2]; 2] = [[3.5, 4.5], [2.5, 3.5]];
/// Height of a door, m.
const DOOR_HEIGHT: f64 = 2.125;

/// A building to draw.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// What to call it.
    pub name: String,
    /// Rooms along x.
    pub columns: usize,
    /// Rooms along y.
    pub rows: usize,
    /// Triangles of each room, nearly.
    pub triangles: usize,
}

impl Plan {
    /// The plan of a name: `room12k` is one room of 12,000 triangles, `rooms32` are 8 x 4 rooms, with doors, of
    /// 62,500 each. Any number does for `roomN` (`k` and `M` are thousands and millions), from 8k to 20M.
    pub fn named(name: &str) -> Option<Self> {
        if name == "rooms32" {
            return Some(Self { name: name.into(), columns: 8, rows: 4, triangles: 62_500 });
        }
        let count = crate::number::count(name.strip_prefix("room")?).ok()?;
        (8_000..=20_000_000).contains(&count).then(|| Self {
            name: name.into(),
            columns: 1,
            rows: 1,
            triangles: count as usize,
        })
    }

    /// Draws it. Every room has a square light of 0.6 m, 2 cm below the middle of its ceiling.
    pub fn draw(&self) -> Scene {
        let scale = self.scale();
        let mut soup = Vec::new();
        let (mut lights, mut rooms) = (Vec::new(), Vec::new());
        for row in 0..self.rows {
            for column in 0..self.columns {
                let corner = [column as f64 * (SIZE[0] + WALL), row as f64 * (SIZE[1] + WALL), 0.0];
                let doors = [row > 0, row + 1 < self.rows, column > 0, column + 1 < self.columns];
                let mut drawing = Drawing::new(scale, Some(&mut soup));
                drawing.room(corner, doors, (row * self.columns + column) as u64);
                let at = |x: f64, y: f64, z: f64| {
                    Vec3::new((corner[0] + x) as f32, (corner[1] + y) as f32, z as f32)
                };
                lights.push(Light {
                    corner: at(SIZE[0] / 2.0 - 0.3, SIZE[1] / 2.0 - 0.3, SIZE[2] - 0.02),
                    u: Vec3::new(0.0, 0.6, 0.0),
                    v: Vec3::new(0.6, 0.0, 0.0),
                });
                let half = WALL / 2.0;
                rooms.push(Room {
                    min: at(-half, -half, -half),
                    max: at(SIZE[0] + half, SIZE[1] + half, SIZE[2] + half),
                    triangles: 0..soup.len() as u32,
                });
            }
        }
        Scene::weld(&self.name, &soup, lights, rooms)
    }

    /// How finely to cut, so that a room has its number of triangles.
    fn scale(&self) -> f64 {
        let count = |scale| {
            let mut drawing = Drawing::new(scale, None);
            drawing.room([0.0; 3], [false; 4], 0);
            drawing.count
        };
        let (mut low, mut high) = (0.0, 100.0);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if count(middle) < self.triangles { low = middle } else { high = middle }
        }
        high
    }
}

/// Where a piece of furniture stands: turned about z, then moved.
#[derive(Clone, Copy)]
struct Place {
    cos: f64,
    sin: f64,
    at: [f64; 3],
}

impl Place {
    fn new(at: [f64; 3], angle: f64) -> Self {
        Self { cos: libm::cos(angle), sin: libm::sin(angle), at }
    }

    fn apply(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        [
            self.at[0] + self.cos * x - self.sin * y,
            self.at[1] + self.sin * x + self.cos * y,
            self.at[2] + z,
        ]
    }
}

/// How a patch's edges meet.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Four free edges.
    Sheet,
    /// `u = 1` is `u = 0`.
    Tube,
    /// A tube whose `v = 0` and `v = 1` are points.
    Ball,
    /// A tube with a point at one end.
    Cap,
    /// A tube whose `v = 1` is `v = 0`.
    Ring,
}

/// Triangles on their way: drawn, or only counted.
struct Drawing<'s> {
    scale: f64,
    soup: Option<&'s mut Vec<[[f32; 3]; 3]>>,
    count: usize,
    /// Patches so far: each has a dither and a jitter of its own.
    patches: u64,
    place: Place,
    /// Corner of the room, m.
    corner: [f64; 3],
}

impl<'s> Drawing<'s> {
    fn new(scale: f64, soup: Option<&'s mut Vec<[[f32; 3]; 3]>>) -> Self {
        let place = Place::new([0.0; 3], 0.0);
        Self { scale, soup, count: 0, patches: 0, place, corner: [0.0; 3] }
    }

    /// Cells for a wish at scale 1. The remainder is dithered over the patches, so that totals meet their target.
    fn cells(&self, wish: f64, least: usize) -> usize {
        let golden = self.patches as f64 * 0.618_033_988_749_895;
        ((wish * self.scale + golden.fract()) as usize).max(least)
    }

    /// `nu` x `nv` cells of a surface over the unit square. Inner vertices are moved by up to a fifth of a cell.
    fn patch(&mut self, kind: Kind, nu: usize, nv: usize, at: impl Fn(f64, f64) -> [f64; 3]) {
        let key = mix(self.patches.wrapping_add(0x51ED_270B));
        self.patches += 1;
        let points = match kind {
            Kind::Ball => 2,
            Kind::Cap => 1,
            _ => 0,
        };
        self.count += (2 * nv - points) * nu;
        let Some(soup) = self.soup.as_deref_mut() else { return };
        let (place, corner) = (self.place, self.corner);
        let vertex = |i: usize, j: usize| {
            let i = if kind == Kind::Sheet { i } else { i % nu };
            let j = if kind == Kind::Ring { j % nv } else { j };
            let inner = (kind != Kind::Sheet || (i > 0 && i < nu))
                && (kind == Kind::Ring || (j > 0 && j < nv));
            let bits = mix(key ^ (i as u64) << 32 ^ j as u64);
            let jitter = |shift: u32| match inner {
                true => ((bits >> shift & 0xFFFF) as f64 / 65536.0 - 0.5) * 0.4,
                false => 0.0,
            };
            let p = at((i as f64 + jitter(0)) / nu as f64, (j as f64 + jitter(16)) / nv as f64);
            let p = place.apply(p);
            [0, 1, 2].map(|c| (corner[c] + p[c]) as f32)
        };
        let mut row: Vec<[f32; 3]> = (0..=nu).map(|i| vertex(i, 0)).collect();
        for j in 0..nv {
            let next: Vec<[f32; 3]> = (0..=nu).map(|i| vertex(i, j + 1)).collect();
            for i in 0..nu {
                let (a, b, c, d) = (row[i], row[i + 1], next[i + 1], next[i]);
                if mix(key ^ (j as u64) << 32 ^ i as u64 ^ 1 << 63) & 1 == 0 {
                    soup.extend([[a, b, c], [a, c, d]]);
                } else {
                    soup.extend([[a, b, d], [b, c, d]]);
                }
            }
            row = next;
        }
    }

    /// A box around `center`, leaning by `lean` radians about its lower edge along y.
    fn cuboid(&mut self, center: [f64; 3], size: [f64; 3], lean: f64) {
        let longest = size[0].max(size[1]).max(size[2]);
        let n = size.map(|s| self.cells(0.3 + 2.2 * s / longest, 1));
        let (cos, sin) = (libm::cos(lean), libm::sin(lean));
        for axis in 0..3 {
            let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
            for side in [-1.0, 1.0] {
                let (nu, nv) = if side > 0.0 { (n[b], n[c]) } else { (n[c], n[b]) };
                self.patch(Kind::Sheet, nu, nv, |u, v| {
                    let (s, t) = if side > 0.0 { (u, v) } else { (v, u) };
                    let mut p = [0.0; 3];
                    p[axis] = side * 0.5 * size[axis];
                    p[b] = (s - 0.5) * size[b];
                    p[c] = (t - 0.5) * size[c];
                    let z = p[2] + 0.5 * size[2];
                    [
                        center[0] + cos * p[0] + sin * z,
                        center[1] + p[1],
                        center[2] - 0.5 * size[2] - sin * p[0] + cos * z,
                    ]
                });
            }
        }
    }

    /// A rounded box (a superellipsoid) of half axes `half`: a ball at `round` 1, a box near 0. `bend` pulls its
    /// ends along x towards +y by so many metres a square metre, and `recline` its top towards -y per metre.
    fn cushion(&mut self, center: [f64; 3], half: [f64; 3], round: f64, [bend, recline]: [f64; 2]) {
        let (nu, nv) = (self.cells(10.0, 6), self.cells(5.5, 4));
        self.patch(Kind::Ball, nu, nv, |u, v| {
            let (longitude, latitude) = (TURN * u, 0.5 * TURN * (v - 0.5));
            let power = |x: f64| {
                let size = if x.abs() < 1e-9 { 0.0 } else { libm::pow(x.abs(), round) };
                size.copysign(x)
            };
            let ring = power(libm::cos(latitude));
            let x = half[0] * ring * power(libm::cos(longitude));
            let y = half[1] * ring * power(libm::sin(longitude));
            let z = half[2] * power(libm::sin(latitude));
            [center[0] + x, center[1] + y + bend * x * x - recline * z, center[2] + z]
        });
    }

    /// A surface of revolution about z: `(radius, height)` of the outline, a polyline smoothed a little.
    fn lathe(&mut self, center: [f64; 3], outline: &[[f64; 2]], fine: f64) {
        let (nu, nv) = (self.cells(8.0, 6), self.cells(fine, outline.len() - 1));
        let closed = |p: &[f64; 2]| p[0] == 0.0;
        let kind = match (outline.first().is_some_and(closed), outline.last().is_some_and(closed)) {
            (true, true) => Kind::Ball,
            (false, false) => Kind::Tube,
            _ => Kind::Cap,
        };
        self.patch(kind, nu, nv, |u, v| {
            let [r, z] = spline(outline, v);
            [
                center[0] + r.max(0.0) * libm::cos(TURN * u),
                center[1] + r.max(0.0) * libm::sin(TURN * u),
                center[2] + z,
            ]
        });
    }

    /// A pipe along a curve that lies in a plane whose unit normal is `side`, `thick(t)` in radius, open at both ends.
    fn pipe(
        &mut self,
        side: [f64; 3],
        long: f64,
        thick: impl Fn(f64) -> f64,
        curve: impl Fn(f64) -> [f64; 3],
    ) {
        let (nu, nv) = (self.cells(5.0, 5), self.cells(long, 2));
        self.patch(Kind::Tube, nu, nv, |u, v| {
            let (p, q) = (curve((v - 1e-3).max(0.0)), curve((v + 1e-3).min(1.0)));
            let d = [q[0] - p[0], q[1] - p[1], q[2] - p[2]];
            let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
            let d = d.map(|x| x / length);
            let other = [
                d[1] * side[2] - d[2] * side[1],
                d[2] * side[0] - d[0] * side[2],
                d[0] * side[1] - d[1] * side[0],
            ];
            let (r, center) = (thick(v), curve(v));
            let (cos, sin) = (r * libm::cos(TURN * u), r * libm::sin(TURN * u));
            let [x, y, z] = [0, 1, 2].map(|c| center[c] + cos * side[c] + sin * other[c]);
            // A leg that is not upright would dip into the floor.
            [x, y, z.max(0.002)]
        });
    }

    /// A ring around z.
    fn ring(&mut self, center: [f64; 3], radius: f64, thick: f64) {
        let (nu, nv) = (self.cells(8.0, 6), self.cells(4.0, 4));
        self.patch(Kind::Ring, nu, nv, |u, v| {
            let r = radius + thick * libm::cos(TURN * v);
            [
                center[0] + r * libm::cos(TURN * u),
                center[1] + r * libm::sin(TURN * u),
                center[2] + thick * libm::sin(TURN * v),
            ]
        });
    }
}

const TURN: f64 = std::f64::consts::TAU;

/// A polyline with its corners cut (a uniform quadratic B-spline that starts and ends on it), at `t` in `[0, 1]`.
fn spline(points: &[[f64; 2]], t: f64) -> [f64; 2] {
    let last = points.len() - 1;
    if t <= 0.0 || t >= 1.0 {
        return points[if t <= 0.0 { 0 } else { last }];
    }
    let x = t * last as f64;
    let at = |x: f64| {
        let i = (x as usize).min(last - 1);
        let f = x - i as f64;
        [0, 1].map(|c| points[i][c] + f * (points[i + 1][c] - points[i][c]))
    };
    let reach = 0.3f64.min(x).min(last as f64 - x);
    let (p, q, r) = (at(x - reach), at(x), at(x + reach));
    [0, 1].map(|c| 0.25 * p[c] + 0.5 * q[c] + 0.25 * r[c])
}

impl Drawing<'_> {
    /// A whole room: `doors` in the walls towards -y, +y, -x, +x.
    fn room(&mut self, corner: [f64; 3], doors: [bool; 4], seed: u64) {
        self.corner = corner;
        self.shell(doors);
        let mut random = Random::new(seed);
        self.round_table([2.1, 1.75], &mut random);
        self.long_table([5.9, 4.2], 0.35);
        for (x, y, angle) in [(1.0, 5.8, 0.0), (2.4, 5.8, 0.0), (0.2, 4.6, 0.25)] {
            self.shelf([x, y], angle * TURN, &mut random);
        }
        self.sofa([6.2, 0.65]);
        for (x, y, angle) in [(5.0, 0.5, 0.05), (7.55, 5.5, 0.6), (0.4, 0.4, 0.12)] {
            self.floor_lamp([x, y], angle * TURN);
        }
        self.pendant([2.1, 1.75]);
        for (x, y, size) in [(7.5, 0.5, 1.0), (5.1, 5.5, 0.9), (3.0, 0.5, 0.8), (3.25, 5.6, 0.6)] {
            self.plant([x, y], size, &mut random);
        }
        self.textiles();
    }

    /// Walls, floor and ceiling on one lattice of uneven lines, so that they share their edges' vertices; doors
    /// with jambs as deep as half of the wall.
    fn shell(&mut self, doors: [bool; 4]) {
        let lines = [
            self.lattice(&[0.0, DOORS[0][0], DOORS[0][1], SIZE[0]]),
            self.lattice(&[0.0, DOORS[1][0], DOORS[1][1], SIZE[1]]),
            self.lattice(&[0.0, DOOR_HEIGHT, SIZE[2]]),
        ];
        self.place = Place::new([0.0; 3], 0.0);
        for (axis, side) in [(2, 0), (2, 1), (1, 0), (1, 1), (0, 0), (0, 1)] {
            // Axes of the face, so that it is counter-clockwise from inside.
            let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
            let (b, c) = if side == 0 { (b, c) } else { (c, b) };
            let along = 1 - axis.min(1);
            let door = axis < 2 && doors[2 * along + side];
            for (i, s) in lines[b].windows(2).enumerate() {
                for (j, t) in lines[c].windows(2).enumerate() {
                    let mid =
                        |x: usize| if x == b { 0.5 * (s[0] + s[1]) } else { 0.5 * (t[0] + t[1]) };
                    if door && mid(2) < DOOR_HEIGHT && within(mid(along), DOORS[along]) {
                        continue;
                    }
                    let point = |s: f64, t: f64| {
                        let mut p = [0.0; 3];
                        (p[axis], p[b], p[c]) = (side as f64 * SIZE[axis], s, t);
                        p
                    };
                    self.cell(
                        [
                            point(s[0], t[0]),
                            point(s[1], t[0]),
                            point(s[1], t[1]),
                            point(s[0], t[1]),
                        ],
                        (i + j) % 2 == 0,
                    );
                }
            }
            if door {
                self.jambs(axis, side, &lines);
            }
        }
    }

    /// The inside of a door in the wall across `axis`.
    fn jambs(&mut self, axis: usize, side: usize, lines: &[Vec<f64>; 3]) {
        let along = 1 - axis;
        let depth =
            [side as f64 * SIZE[axis], side as f64 * SIZE[axis] + (side as f64 - 0.5) * WALL];
        let mut strip = |first: [f64; 2], second: [f64; 2], flip: bool| {
            // So that the front is inside.
            let (first, second) =
                if (axis + side) % 2 == 1 { (second, first) } else { (first, second) };
            let point = |e: [f64; 2], d: f64| {
                let mut p = [0.0; 3];
                (p[axis], p[along], p[2]) = (d, e[0], e[1]);
                p
            };
            let corners = [
                point(first, depth[0]),
                point(second, depth[0]),
                point(second, depth[1]),
                point(first, depth[1]),
            ];
            self.cell(corners, flip);
        };
        for (i, s) in lines[along].windows(2).enumerate() {
            if within(0.5 * (s[0] + s[1]), DOORS[along]) {
                strip([s[0], 0.0], [s[1], 0.0], i % 2 == 0);
                strip([s[1], DOOR_HEIGHT], [s[0], DOOR_HEIGHT], i % 2 == 0);
            }
        }
        for (i, t) in lines[2].windows(2).enumerate() {
            if t[1] <= DOOR_HEIGHT {
                let [low, high] = DOORS[along];
                strip([low, t[1]], [low, t[0]], i % 2 == 0);
                strip([high, t[0]], [high, t[1]], i % 2 == 0);
            }
        }
    }

    /// Two triangles.
    fn cell(&mut self, [a, b, c, d]: [[f64; 3]; 4], flip: bool) {
        self.count += 2;
        let corner = self.corner;
        if let Some(soup) = self.soup.as_deref_mut() {
            let [a, b, c, d] = [a, b, c, d].map(|p| [0, 1, 2].map(|i| (corner[i] + p[i]) as f32));
            match flip {
                true => soup.extend([[a, b, c], [a, c, d]]),
                false => soup.extend([[a, b, d], [b, c, d]]),
            }
        }
    }

    /// Uneven lines through all of `stops`.
    fn lattice(&mut self, stops: &[f64]) -> Vec<f64> {
        let mut lines = vec![stops[0]];
        for (s, stop) in stops.windows(2).enumerate() {
            let n = self.cells(1.7 * (stop[1] - stop[0]), 1);
            let mut random = Random::new(mix(s as u64 + 77 * stops.len() as u64));
            for i in 1..n {
                let x = (i as f64 + random.within(-0.3, 0.3)) / n as f64;
                lines.push(stop[0] + x * (stop[1] - stop[0]));
            }
            lines.push(stop[1]);
        }
        lines
    }

    /// A chair that looks towards +y, its middle at the place.
    fn chair(&mut self, [x, y]: [f64; 2], angle: f64) {
        self.place = Place::new([x, y, 0.0], angle);
        self.cushion([0.0, 0.0, 0.46], [0.22, 0.215, 0.03], 0.35, [0.0, 0.0]);
        self.cushion([0.0, -0.23, 0.82], [0.21, 0.014, 0.09], 0.35, [0.9, 0.2]);
        for i in [-1.0, 1.0] {
            for j in [-1.0, 1.0] {
                // Turned legs, splayed.
                let thick = |t: f64| 0.012 + 0.008 * t + 0.003 * libm::sin(3.0 * TURN * t);
                self.pipe([0.0, 1.0, 0.0], 4.0, thick, |t| {
                    let out = 0.05 * (1.0 - t) * (1.0 - t);
                    [i * (0.17 + out), j * (0.165 + 0.6 * out), 0.003 + 0.435 * t]
                });
            }
        }
        for i in [-1.0, 0.0, 1.0] {
            self.pipe(
                [1.0, 0.0, 0.0],
                3.0,
                |_| 0.009,
                |t| [0.15 * i, -0.19 - 0.06 * t * t, 0.475 + 0.29 * t],
            );
        }
    }

    /// A round table on one foot, four chairs, and what is left of breakfast.
    fn round_table(&mut self, [x, y]: [f64; 2], random: &mut Random) {
        for quarter in 0..4 {
            let angle = TURN * (0.25 * f64::from(quarter) + 0.04) + random.within(-0.15, 0.15);
            let place = Place::new([x, y, 0.0], angle);
            let p = place.apply([0.0, -0.9, 0.0]);
            self.chair([p[0], p[1]], angle);
        }
        self.place = Place::new([x, y, 0.0], 0.3);
        let top =
            [[0.0, 0.72], [0.4, 0.72], [0.64, 0.725], [0.66, 0.74], [0.64, 0.755], [0.0, 0.755]];
        self.lathe([0.0; 3], &top, 9.0);
        let foot =
            [[0.3, 0.003], [0.28, 0.04], [0.06, 0.09], [0.045, 0.3], [0.07, 0.6], [0.13, 0.715]];
        self.lathe([0.0; 3], &foot, 10.0);
        let bowl = [
            [0.0, 0.004],
            [0.06, 0.003],
            [0.13, 0.06],
            [0.16, 0.1],
            [0.15, 0.1],
            [0.1, 0.03],
            [0.0, 0.015],
        ];
        self.lathe([0.05, 0.02, 0.756], &bowl, 9.0);
        for fruit in 0..5 {
            let turn = TURN * (0.2 * f64::from(fruit) + random.within(-0.05, 0.05));
            let center = [0.05 + 0.06 * libm::cos(turn), 0.02 + 0.06 * libm::sin(turn), 0.835];
            let r = random.within(0.03, 0.04);
            self.cushion(center, [r, r, 0.9 * r], 1.0, [0.0, 0.0]);
        }
        for place in 0..4 {
            let turn = TURN * (0.25 * f64::from(place) + 0.02);
            self.cup([0.43 * libm::cos(turn), 0.43 * libm::sin(turn), 0.756]);
        }
    }

    /// A cup with its handle and saucer.
    fn cup(&mut self, at: [f64; 3]) {
        let saucer = [[0.0, 0.003], [0.04, 0.003], [0.075, 0.012], [0.072, 0.014], [0.0, 0.006]];
        self.lathe(at, &saucer, 6.0);
        let cup = [
            [0.0, 0.012],
            [0.025, 0.01],
            [0.038, 0.04],
            [0.042, 0.075],
            [0.039, 0.075],
            [0.034, 0.04],
            [0.0, 0.018],
        ];
        self.lathe(at, &cup, 8.0);
        self.pipe(
            [0.0, 1.0, 0.0],
            5.0,
            |_| 0.004,
            |t| {
                let turn = TURN * (0.25 - 0.5 * t);
                let (cos, sin) = (libm::cos(turn), libm::sin(turn));
                [at[0] + 0.038 + 0.022 * cos, at[1], at[2] + 0.043 + 0.02 * sin]
            },
        );
    }

    /// A long table with rounded corners, four chairs, cups and a vase.
    fn long_table(&mut self, [x, y]: [f64; 2], angle: f64) {
        let place = Place::new([x, y, 0.0], angle);
        for i in [-1.0, 1.0] {
            for j in [-1.0, 1.0] {
                let p = place.apply([0.45 * i, 0.68 * j, 0.0]);
                self.chair([p[0], p[1]], angle + if j < 0.0 { 0.0 } else { 0.5 * TURN });
            }
        }
        self.place = place;
        self.cushion([0.0, 0.0, 0.735], [0.9, 0.45, 0.02], 0.2, [0.0, 0.0]);
        for i in [-1.0, 1.0] {
            for j in [-1.0, 1.0] {
                self.pipe(
                    [0.0, 1.0, 0.0],
                    6.0,
                    |t| 0.02 + 0.015 * t,
                    |t| {
                        let bow = 0.05 * libm::sin(0.5 * TURN * t);
                        [i * (0.74 + bow), j * 0.33, 0.003 + 0.712 * t]
                    },
                );
            }
        }
        for i in [-1.0, 1.0] {
            self.cup([0.5 * i, -0.25 * i, 0.757]);
        }
        let vase =
            [[0.0, 0.003], [0.05, 0.002], [0.08, 0.08], [0.06, 0.17], [0.03, 0.22], [0.045, 0.26]];
        self.lathe([0.05, 0.08, 0.756], &vase, 11.0);
        self.ring([0.05, 0.08, 1.018], 0.045, 0.004);
    }

    /// A shelf of 1.2 x 0.3 x 2 m with five rows of books, some leaning.
    fn shelf(&mut self, [x, y]: [f64; 2], angle: f64, random: &mut Random) {
        self.place = Place::new([x, y, 0.0], angle);
        let boards = [0.08, 0.46, 0.84, 1.22, 1.6, 1.98];
        for z in boards {
            self.cuboid([0.0, 0.0, z], [1.16, 0.28, 0.022], 0.0);
        }
        for i in [-1.0, 1.0] {
            self.cuboid([0.595 * i, 0.0, 1.005], [0.022, 0.3, 2.0], 0.0);
        }
        self.cuboid([0.0, 0.144, 1.03], [1.16, 0.008, 1.9], 0.0);
        for z in &boards[..5] {
            let mut left = -0.56;
            for _ in 0..9 {
                let (w, h) = (random.within(0.025, 0.075), random.within(0.2, 0.3));
                let d = random.within(0.15, 0.22);
                let lean = if random.unit() < 0.2 { random.within(0.05, 0.2) } else { 0.0 };
                self.cuboid([left + 0.5 * w, 0.02, z + 0.014 + 0.5 * h], [w, d, h], lean);
                left += w + 0.004 + h * libm::sin(lean);
                if left > 0.4 {
                    break;
                }
            }
            if left < 0.35 {
                let egg = [[0.0, 0.002], [0.04, 0.004], [0.07, 0.08], [0.03, 0.16], [0.0, 0.17]];
                self.lathe([0.47, 0.0, z + 0.012], &egg, 7.0);
            }
        }
    }

    /// A sofa that looks towards +y, its cushions, and a low table.
    fn sofa(&mut self, [x, y]: [f64; 2]) {
        self.place = Place::new([x, y, 0.0], 0.0);
        self.cushion([0.0, 0.0, 0.2], [1.0, 0.42, 0.14], 0.2, [0.0, 0.0]);
        self.cushion([0.0, -0.36, 0.55], [1.0, 0.12, 0.3], 0.3, [0.05, 0.15]);
        for i in [-1.0, 1.0] {
            self.cushion([0.95 * i, 0.02, 0.42], [0.11, 0.42, 0.2], 0.5, [0.0, 0.0]);
            self.cushion([0.42 * i, 0.05, 0.4], [0.41, 0.34, 0.08], 0.35, [0.0, 0.0]);
            self.cushion([0.6 * i, -0.15, 0.62], [0.2, 0.07, 0.2], 0.6, [0.5, 0.3]);
            for j in [-1.0, 1.0] {
                self.lathe(
                    [0.85 * i, 0.3 * j, 0.0],
                    &[[0.02, 0.003], [0.035, 0.05], [0.03, 0.08]],
                    3.0,
                );
            }
        }
        self.place = Place::new([x - 0.1, y + 1.05, 0.0], 0.4);
        let top = [[0.0, 0.38], [0.3, 0.38], [0.4, 0.39], [0.4, 0.405], [0.0, 0.41]];
        self.lathe([0.0; 3], &top, 7.0);
        for leg in 0..3 {
            let turn = TURN * f64::from(leg) / 3.0;
            let (cos, sin) = (libm::cos(turn), libm::sin(turn));
            self.pipe(
                [-sin, cos, 0.0],
                4.0,
                |t| 0.012 + 0.008 * t,
                |t| {
                    let r = 0.36 - 0.2 * t * t;
                    [r * cos, r * sin, 0.003 + 0.38 * t]
                },
            );
        }
        self.cup([0.15, 0.1, 0.411]);
    }

    /// A lamp on an arched stem.
    fn floor_lamp(&mut self, [x, y]: [f64; 2], angle: f64) {
        self.place = Place::new([x, y, 0.0], angle);
        let base = [[0.15, 0.003], [0.155, 0.02], [0.14, 0.035], [0.03, 0.045], [0.0, 0.05]];
        self.lathe([0.0; 3], &base, 6.0);
        self.pipe(
            [0.0, 1.0, 0.0],
            14.0,
            |t| 0.014 - 0.005 * t,
            |t| [0.45 * t * t * t, 0.0, 0.04 + 1.95 * t - 0.35 * t * t * t * t],
        );
        let shade = [[0.05, 0.02], [0.1, 0.0], [0.16, -0.08], [0.19, -0.2]];
        self.lathe([0.47, 0.0, 1.66], &shade, 7.0);
        self.cushion([0.47, 0.0, 1.55], [0.04, 0.04, 0.055], 1.0, [0.0, 0.0]);
    }

    /// A lamp that hangs from the ceiling.
    fn pendant(&mut self, [x, y]: [f64; 2]) {
        self.place = Place::new([x, y, 0.0], 0.0);
        self.pipe([0.0, 1.0, 0.0], 3.0, |_| 0.004, |t| [0.0, 0.0, 2.2 + 0.797 * t]);
        let shade = [
            [0.03, 0.25],
            [0.06, 0.22],
            [0.1, 0.1],
            [0.24, 0.0],
            [0.235, 0.0],
            [0.09, 0.11],
            [0.025, 0.24],
        ];
        self.lathe([0.0, 0.0, 1.95], &shade, 12.0);
        self.cushion([0.0, 0.0, 2.05], [0.045, 0.045, 0.06], 1.0, [0.0, 0.0]);
    }

    /// A plant in its pot: stems that bow, a long leaf at each.
    fn plant(&mut self, [x, y]: [f64; 2], size: f64, random: &mut Random) {
        self.place = Place::new([x, y, 0.0], TURN * random.unit());
        let pot = [
            [0.0, 0.003],
            [0.11, 0.002],
            [0.15, 0.15],
            [0.18, 0.28],
            [0.17, 0.29],
            [0.16, 0.26],
            [0.0, 0.25],
        ];
        self.lathe([0.0; 3], &pot.map(|p| p.map(|x| x * size)), 10.0);
        for leaf in 0..14 {
            let turn = TURN * (f64::from(leaf) * 0.381_966 + random.within(-0.03, 0.03));
            let (cos, sin) = (libm::cos(turn), libm::sin(turn));
            let high = size * random.within(0.3, 0.9);
            let out = size * random.within(0.08, 0.2);
            let curve = |t: f64| {
                let r = 0.03 * size + out * t * t;
                [r * cos, r * sin, 0.255 * size + high * t]
            };
            self.pipe([-sin, cos, 0.0], 3.0, |t| size * (0.007 - 0.003 * t), curve);
            let (start, long) = (curve(1.0), size * random.within(0.18, 0.32));
            let (droop, width) = (random.within(0.5, 1.3), size * random.within(0.03, 0.06));
            let (nu, nv) = (self.cells(7.0, 3), self.cells(3.0, 2));
            self.patch(Kind::Sheet, nu, nv, |u, v| {
                let across = 2.0 * v - 1.0;
                let half = width * (0.08 + libm::sin(0.5 * TURN * libm::pow(u, 0.7)).max(0.0));
                let r = long * u;
                let side = half * across;
                let fold = 0.35 * half * across * across;
                let z = start[2] + long * (0.7 * u - droop * u * u) + fold;
                [start[0] + r * cos - side * sin, start[1] + r * sin + side * cos, z.max(0.01)]
            });
        }
    }

    /// Curtains at the wall towards +x, a rug, pictures.
    fn textiles(&mut self) {
        self.place = Place::new([0.0; 3], 0.0);
        for (low, high) in [(0.95, 1.7), (4.0, 5.0)] {
            let (nu, nv) = (self.cells(22.0, 12), self.cells(6.0, 3));
            self.patch(Kind::Sheet, nu, nv, |u, v| {
                let fold = libm::sin(9.0 * TURN * u + 0.8 * libm::sin(TURN * v));
                [7.88 + (0.03 + 0.03 * (1.0 - v)) * fold, low + (high - low) * u, 0.02 + 2.6 * v]
            });
            self.pipe(
                [1.0, 0.0, 0.0],
                4.0,
                |_| 0.012,
                |t| [7.88, low - 0.1 + (high - low + 0.2) * t, 2.64],
            );
        }
        self.place = Place::new([6.1, 1.9, 0.0], 0.06);
        let (nu, nv) = (self.cells(11.0, 4), self.cells(8.0, 3));
        self.patch(Kind::Sheet, nu, nv, |u, v| {
            let wave = libm::sin(2.0 * TURN * u) * libm::sin(1.5 * TURN * v);
            [2.4 * (u - 0.5), 1.6 * (v - 0.5), 0.012 + 0.006 * wave]
        });
        self.place = Place::new([0.0; 3], 0.0);
        for (x, width) in [(1.0, 0.9), (2.2, 0.6)] {
            self.cuboid([x, 0.02, 1.6], [width, 0.03, 0.7], 0.0);
            self.cuboid([x, 0.037, 1.6], [width - 0.1, 0.005, 0.6], 0.0);
        }
    }
}

fn within(x: f64, [low, high]: [f64; 2]) -> bool {
    low < x && x < high
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn names() {
        assert_eq!(Plan::named("room12k").map(|p| p.triangles), Some(12_000));
        assert_eq!(Plan::named("room450k").map(|p| p.triangles), Some(450_000));
        assert_eq!(Plan::named("rooms32").map(|p| p.columns * p.rows), Some(32));
        for bad in ["room", "room1", "rooms3", "kitchen", "room12q"] {
            assert_eq!(Plan::named(bad), None, "{bad}");
        }
    }

    #[test]
    fn rooms_have_the_triangles_that_they_promise() {
        for (name, wanted) in [("room12k", 12_000.0), ("room60k", 60_000.0)] {
            let scene = Plan::named(name).unwrap().draw();
            let count = scene.triangles.len() as f64;
            assert!((count / wanted - 1.0).abs() < 0.01, "{name}: {count}");
            let (min, max) = scene.bounds();
            assert_eq!((min, max), (Vec3::ZERO, Vec3::new(8.0, 6.0, 3.0)), "{name}");
        }
    }

    /// The same bits everywhere: figures of two machines are about one room.
    #[test]
    fn rooms_are_frozen() {
        let digest = |scene: &Scene| {
            let words = scene.vertices.list().iter().flatten().map(|x| x.to_bits());
            let words = words.chain(scene.triangles.iter().flatten().copied());
            words.fold(0, |hash: u64, word| mix(hash ^ u64::from(word)))
        };
        let two = Plan { name: "two".into(), columns: 2, rows: 1, triangles: 20_000 };
        let digests = [Plan::named("room12k").unwrap(), two].map(|plan| digest(&plan.draw()));
        assert_eq!(digests, [0x5182_AE28_AF54_C7EA, 0xF053_7334_BB00_32F4], "{digests:#018X?}");
    }

    #[test]
    fn vertices_are_shared_and_irregular() {
        let scene = Plan::named("room60k").unwrap().draw();
        let (vertices, triangles) = (scene.vertices.list(), &scene.triangles);
        // A closed mesh has half as many vertices as triangles, boxes and single sheets more.
        assert!(vertices.len() < triangles.len() * 7 / 10, "{}", vertices.len());
        let mut heights: Vec<u32> = vertices.iter().map(|v| v[2].to_bits()).collect();
        heights.sort_unstable();
        heights.dedup();
        assert!(heights.len() * 2 > vertices.len(), "{} of {}", heights.len(), vertices.len());
    }

    /// Every edge of the shell is shared by exactly two triangles, seen from opposite sides: doors and jambs too.
    #[test]
    fn shells_are_closed_to_the_bit() {
        let plan = Plan { name: "two".into(), columns: 2, rows: 2, triangles: 9_000 };
        let mut soup = Vec::new();
        for row in 0..2 {
            for column in 0..2 {
                let mut drawing = Drawing::new(plan.scale(), Some(&mut soup));
                drawing.corner =
                    [column as f64 * (SIZE[0] + WALL), row as f64 * (SIZE[1] + WALL), 0.0];
                drawing.shell([row == 1, row == 0, column == 1, column == 0]);
            }
        }
        let scene = Scene::weld("two", &soup, Vec::new(), Vec::new());
        let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
        for &[a, b, c] in &scene.triangles {
            for (a, b) in [(a, b), (b, c), (c, a)] {
                *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
            }
        }
        let open = edges.values().filter(|&&n| n != 0).count();
        assert_eq!(open, 0, "of {} edges", edges.len());
        // Six times the volume, by the divergence theorem: four rooms and four doorways.
        let volume: f64 = scene
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] =
                    t.map(|v| Vec3::from_array(scene.vertices.list()[v as usize]).as_dvec3());
                a.dot(b.cross(c)) / 6.0
            })
            .sum();
        let expected = 4.0 * 144.0 + 4.0 * DOOR_HEIGHT * WALL;
        assert!((volume.abs() - expected).abs() < 1e-3, "{volume}, not {expected}");
    }

    #[test]
    fn rooms_keep_to_their_boxes() {
        let scene = Plan { name: "two".into(), columns: 2, rows: 1, triangles: 10_000 }.draw();
        assert_eq!(scene.rooms.len(), 2);
        let mut end = 0;
        for room in &scene.rooms {
            assert_eq!(room.triangles.start, end);
            end = room.triangles.end;
            for t in room.triangles.clone() {
                for v in scene.triangles[t as usize] {
                    let p = Vec3::from_array(scene.vertices.list()[v as usize]);
                    assert!(room.min.cmple(p).all() && p.cmple(room.max).all(), "{p}");
                }
            }
        }
        assert_eq!(end as usize, scene.triangles.len());
        // Light shines down.
        assert!(scene.lights.iter().all(|l| l.normal() == Vec3::NEG_Z));
    }
}
