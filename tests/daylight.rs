//! Daylight against closed forms and quadratures made here, through the real binaries (after CIE 171:2006, 5.9, 5.11,
//! 5.13 and 5.14).
//!
//! Pictures look at single points: shadow rays follow a low-discrepancy sequence, and the tolerances are the ones that
//! the cases ask for. Photons are counted: seeds are fixed, and bounds are at least 4 standard deviations, so that a change
//! of the random numbers would fail a test with a probability below 1e-4.

mod common;

use common::{Model, bin, digest, json, number, ok, photons};
use enf_layout::photon::{PHOTON_DIRECT, PhotonRecord};
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

type Point = [f64; 3];

/// Reflectance of everything: pictures are of direct light alone.
const RHO: f64 = 0.5;
/// Diffuse irradiance on the horizontal, W/m2.
const DIFFUSE: f64 = 1000.0;

fn sub(a: Point, b: Point) -> Point {
    [0, 1, 2].map(|i| a[i] - b[i])
}

fn dot(a: Point, b: Point) -> f64 {
    (0..3).map(|i| a[i] * b[i]).sum()
}

/// A CIE standard general sky, 1 to 15, or 16, the traditional overcast one, scaled to [`DIFFUSE`]: written down again from
/// the standard, independently of the program.
struct Sky {
    number: usize,
    sun: Point,
    scale: f64,
    ground: f64,
}

impl Sky {
    fn new(number: usize, sun_altitude: f64, ground: f64) -> Self {
        let (sin, cos) = sun_altitude.to_radians().sin_cos();
        // Azimuth 180 degrees: towards -y.
        let mut sky = Self { number, sun: [0.0, -cos, sin], scale: 1.0, ground: 0.0 };
        let (rows, columns) = (300, 600);
        let mut sum = 0.0;
        for r in 0..rows {
            let level = ((f64::from(r) + 0.5) / f64::from(rows)).sqrt();
            for c in 0..columns {
                let (s, c) = (TAU * (f64::from(c) + 0.5) / f64::from(columns)).sin_cos();
                sum += sky.at([level * c, level * s, (1.0 - level * level).sqrt()]);
            }
        }
        sky.scale = DIFFUSE / (sum * PI / f64::from(rows * columns));
        sky.ground = ground * DIFFUSE / PI;
        sky
    }

    fn at(&self, to: Point) -> f64 {
        if to[2] < 0.0 {
            return self.ground;
        }
        if self.number == 16 {
            return self.scale * (1.0 + 2.0 * to[2]) / 3.0;
        }
        let gradations =
            [(4.0, -0.7), (1.1, -0.8), (0.0, -1.0), (-1.0, -0.55), (-1.0, -0.32), (-1.0, -0.15)];
        let indicatrices = [
            (0.0, -1.0, 0.0),
            (2.0, -1.5, 0.15),
            (5.0, -2.5, 0.3),
            (10.0, -3.0, 0.45),
            (16.0, -3.0, 0.3),
            (24.0, -2.8, 0.15),
        ];
        let types = [11, 12, 21, 22, 31, 32, 33, 34, 42, 43, 44, 54, 55, 65, 66];
        let kind = types[self.number - 1];
        let ((a, b), (c, d, e)) = (gradations[kind / 10 - 1], indicatrices[kind % 10 - 1]);
        let x = dot(to, self.sun).clamp(-1.0, 1.0).acos();
        let gradation = 1.0 + a * (b / to[2].max(1e-9)).exp();
        let indicatrix = 1.0 + c * ((d * x).exp() - (d * FRAC_PI_2).exp()) + e * x.cos().powi(2);
        self.scale * gradation * indicatrix
    }
}

/// A rectangle: a corner and two sides.
#[derive(Clone, Copy)]
struct Rectangle {
    at: Point,
    u: Point,
    v: Point,
}

impl Rectangle {
    fn point(&self, u: f64, v: f64) -> Point {
        [0, 1, 2].map(|i| self.at[i] + u * self.u[i] + v * self.v[i])
    }

    /// u x v: the normal times the area.
    fn normal(&self) -> Point {
        let (u, v) = (self.u, self.v);
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    }
}

/// Irradiance at a point by what is seen of the sky through an opening; `free` says which directions are.
fn through(
    point: Point,
    normal: Point,
    opening: &Rectangle,
    sky: &Sky,
    free: impl Fn(Point) -> bool,
) -> f64 {
    let n = 200;
    let area = opening.normal();
    let mut sum = 0.0;
    for i in 0..n {
        for j in 0..n {
            let step = |k: i32| (f64::from(k) + 0.5) / f64::from(n);
            let to = sub(opening.point(step(i), step(j)), point);
            let square = dot(to, to);
            let to = to.map(|c| c / square.sqrt());
            let cos = dot(to, normal);
            if cos > 0.0 && free(to) {
                sum += sky.at(to) * cos * dot(to, area).abs() / square;
            }
        }
    }
    sum / f64::from(n * n)
}

/// A wall, floor or ceiling in a plane of two axes, with a rectangular hole.
fn holed(model: &mut Model, wall: &Rectangle, hole: Option<[f64; 4]>) {
    let mut part = |u0: f64, u1: f64, v0: f64, v1: f64| {
        if u1 - u0 > 1e-9 && v1 - v0 > 1e-9 {
            model.quad([
                wall.point(u0, v0),
                wall.point(u1, v0),
                wall.point(u1, v1),
                wall.point(u0, v1),
            ]);
        }
    };
    let Some([u0, u1, v0, v1]) = hole else { return part(0.0, 1.0, 0.0, 1.0) };
    part(0.0, 1.0, 0.0, v0);
    part(0.0, 1.0, v1, 1.0);
    part(0.0, u0, v0, v1);
    part(u1, 1.0, v0, v1);
}

const SIZE: Point = [4.0, 4.0, 3.0];

/// The six sides of a room of 4 x 4 x 3 m at `x`, fronts inwards: floor, ceiling, y = 0, y = 4, x = 0, x = 4.
fn sides(x: f64) -> [Rectangle; 6] {
    let [w, d, h] = SIZE;
    let rectangle = |at, u, v| Rectangle { at, u, v };
    [
        rectangle([x, 0.0, 0.0], [w, 0.0, 0.0], [0.0, d, 0.0]),
        rectangle([x, 0.0, h], [0.0, d, 0.0], [w, 0.0, 0.0]),
        rectangle([x, 0.0, 0.0], [0.0, 0.0, h], [w, 0.0, 0.0]),
        rectangle([x, d, 0.0], [w, 0.0, 0.0], [0.0, 0.0, h]),
        rectangle([x, 0.0, 0.0], [0.0, d, 0.0], [0.0, 0.0, h]),
        rectangle([x + w, 0.0, 0.0], [0.0, 0.0, h], [0.0, d, 0.0]),
    ]
}

const CEILING: usize = 1;
const FRONT: usize = 2;
const LEFT: usize = 4;
const RIGHT: usize = 5;

fn room(model: &mut Model, x: f64, holes: &[(usize, [f64; 4])]) {
    model.object(&format!("room {x}"));
    model.material("grey");
    for (i, side) in sides(x).iter().enumerate() {
        holed(model, side, holes.iter().find(|h| h.0 == i).map(|h| h.1));
    }
}

/// The opening that a hole leaves in a side.
fn opening(x: f64, side: usize, [u0, u1, v0, v1]: [f64; 4]) -> Rectangle {
    let wall = sides(x)[side];
    Rectangle {
        at: wall.point(u0, v0),
        u: wall.u.map(|c| c * (u1 - u0)),
        v: wall.v.map(|c| c * (v1 - v0)),
    }
}

/// A scene on disk, and the points that are looked at.
struct Case {
    dir: tempfile::TempDir,
    views: String,
    points: Vec<(Point, Point)>,
}

impl Case {
    fn new(model: &Model, points: &[(Point, Point)]) -> Self {
        let dir = tempfile::tempdir().unwrap();
        model.write(&dir.path().join("room.obj"), &format!("newmtl grey\nKd {RHO} {RHO} {RHO}\n"));
        let mut views = String::new();
        for (i, (p, n)) in points.iter().enumerate() {
            // From half a metre in front of the point.
            let eye = [0, 1, 2].map(|c| p[c] + 0.5 * n[c]);
            let up = if n[2].abs() > 0.5 { [0, 1, 0] } else { [0, 0, 1] };
            writeln!(
                views,
                "[[view]]\nname = \"p{i}\"\neye = {eye:?}\ntarget = {p:?}\nup = {up:?}\nfov = 0.5\nwidth = 8\nheight = 8"
            )
            .unwrap();
        }
        Self { dir, views, points: points.to_vec() }
    }

    fn scene(&self, sky: &str) -> PathBuf {
        let path = self.dir.path().join("scene.toml");
        let text = format!(
            "[[mesh]]\nfile = \"room.obj\"\n[sky]\ndiffuse_horizontal = {DIFFUSE}\n{sky}\n{}",
            self.views
        );
        std::fs::write(&path, text).unwrap();
        path
    }

    /// Irradiance at each point, from pictures of direct light.
    fn rendered(&self, sky: &str) -> Vec<f64> {
        let out = self.dir.path().join("out");
        ok(bin("enfilade").arg("run").arg(self.scene(sky)).arg("-o").arg(&out).args([
            "--quiet",
            "--force",
            "--photons-per-light",
            "2k",
            "--view",
            "all",
            "--indirect",
            "none",
            "--samples",
            "8",
            "--light-samples",
            "32",
        ]));
        (0..self.points.len())
            .map(|i| {
                let picture = enf_image::read_exr(&out.join(format!("p{i}.exr"))).unwrap();
                let green = picture.channel("G").unwrap();
                let mean = green.iter().map(|&g| f64::from(g)).sum::<f64>() / green.len() as f64;
                mean * PI / RHO
            })
            .collect()
    }

    /// Photons that landed, and the report.
    fn traced(&self, sky: &str, count: &str) -> (Vec<PhotonRecord>, serde_json::Value) {
        let (store, stats) = (self.dir.path().join("s.enf"), self.dir.path().join("s.json"));
        ok(bin("enf-partition")
            .arg(self.scene(sky))
            .arg("-o")
            .arg(&store)
            .args(["--quiet", "--force"]));
        ok(bin("enf-grid").arg(&store).arg("--quiet"));
        ok(bin("enf-trace")
            .arg(&store)
            .args(["--quiet", "--photons-per-light", count, "--stats"])
            .arg(&stats));
        (photons(&store), json(&stats))
    }
}

/// Flux, W, and number of direct photons that landed where `keep` says, on sides that face the middle of the room at `x`.
fn watts(photons: &[PhotonRecord], x: f64, keep: impl Fn(Point) -> bool) -> (f64, f64) {
    let middle = [x + SIZE[0] / 2.0, SIZE[1] / 2.0, SIZE[2] / 2.0];
    let (mut sum, mut count) = (0.0, 0.0);
    for photon in photons.iter().filter(|p| p.flags & PHOTON_DIRECT != 0) {
        let (at, normal) = (photon.position().map(f64::from), photon.normal().map(f64::from));
        if keep(at) && dot(sub(middle, at), normal) > 0.0 {
            sum += f64::from(photon.flux_w()[1]);
            count += 1.0;
        }
    }
    (sum, count)
}

/// Points on the floor and on the wall y = 0, or, for a window there, on the wall y = 4.
fn points(wall: f64) -> Vec<(Point, Point)> {
    let n = [0.0, if wall == 0.0 { 1.0 } else { -1.0 }, 0.0];
    let mut all: Vec<(Point, Point)> =
        [0.25, 1.25, 2.25, 3.75].map(|y| ([2.0, y, 0.0], [0.0, 0.0, 1.0])).to_vec();
    all.extend([2.25, 1.25, 0.25].map(|z| ([2.0, wall, z], n)));
    all
}

fn assert_close(found: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    for (i, (f, e)) in found.iter().zip(expected).enumerate() {
        assert!((f - e).abs() <= tolerance * e, "{what}, point {i}: {f} for {e}");
    }
}

fn sky_text(number: usize, altitude: f64, ground: f64) -> String {
    format!("model = \"cie-{number}\"\nsun = [180, {altitude}]\nground = {ground}")
}

/// CIE 171:2006, 5.9: roof openings of 1 x 1 and 4 x 4 m under the sixteen skies, the sun at 60 degrees without its disc.
#[test]
fn roof_openings() {
    let points = points(0.0);
    for (side, hole) in [(1.0, [0.375, 0.625, 0.375, 0.625]), (4.0, [0.0, 1.0, 0.0, 1.0])] {
        let mut model = Model::default();
        room(&mut model, 0.0, &[(CEILING, hole)]);
        let case = Case::new(&model, &points);
        // The large one under each kind of sky: overcast, uniform, clear.
        for number in (1..=16).filter(|n| side == 1.0 || [1, 5, 12, 16].contains(n)) {
            let sky = Sky::new(number, 60.0, 0.2);
            let found = case.rendered(&sky_text(number, 60.0, 0.2));
            let expected: Vec<f64> = points
                .iter()
                .map(|&(p, n)| through(p, n, &opening(0.0, CEILING, hole), &sky, |_| true))
                .collect();
            assert_close(&found, &expected, 0.01, &format!("{side} m, sky {number}"));
            if number == 5 {
                // Uniform: the configuration factor of a square parallel to the floor, by its closed form.
                let p = points[1].0;
                let quarter = |x: f64, y: f64| {
                    let (a, b): (f64, f64) = (x.abs() / 3.0, y.abs() / 3.0);
                    let f = |a: f64, b: f64| {
                        let r = (1.0 + a * a).sqrt();
                        a / r * (b / r).atan()
                    };
                    (f(a, b) + f(b, a)) / TAU * x.signum() * y.signum()
                };
                let (lo, hi) = (2.0 - side / 2.0, 2.0 + side / 2.0);
                let at = |x: f64, y: f64| quarter(x - p[0], y - p[1]);
                let c = at(hi, hi) - at(lo, hi) - at(hi, lo) + at(lo, lo);
                assert!(
                    (found[1] / DIFFUSE / c - 1.0).abs() < 0.01,
                    "{} for {c}",
                    found[1] / DIFFUSE
                );
            }
        }
    }
}

/// CIE 171:2006, 5.11: openings of 2 x 1 m (sill at 1 m) and 4 x 3 m in a facade, over ground of 0.3.
#[test]
fn facade_openings() {
    let points = points(4.0);
    // u is the height in that wall.
    for hole in [[1.0 / 3.0, 2.0 / 3.0, 0.25, 0.75], [0.0, 1.0, 0.0, 1.0]] {
        let mut model = Model::default();
        room(&mut model, 0.0, &[(FRONT, hole)]);
        let case = Case::new(&model, &points);
        for number in [1, 5, 12, 15] {
            let sky = Sky::new(number, 35.0, 0.3);
            let found = case.rendered(&sky_text(number, 35.0, 0.3));
            let expected: Vec<f64> = points
                .iter()
                .map(|&(p, n)| through(p, n, &opening(0.0, FRONT, hole), &sky, |_| true))
                .collect();
            assert_close(&found, &expected, 0.02, &format!("{hole:?}, sky {number}"));
        }
    }
}

/// CIE 171:2006, 5.13 and 5.14: an overhang above the window, and a wall across the street: they stop the light, though
/// they are not in the opening.
#[test]
fn masks() {
    let hole = [1.0 / 3.0, 2.0 / 3.0, 0.25, 0.75];
    let points = points(4.0);
    let (sky, text) = (Sky::new(12, 35.0, 0.3), sky_text(12, 35.0, 0.3));
    let opening = opening(0.0, FRONT, hole);
    // At height 3, 1 m deep, 4 m wide; at y = -6, 6 m high, 16 m wide.
    for (name, mask) in [
        ("overhang", Rectangle { at: [0.0, -1.0, 3.0], u: [4.0, 0.0, 0.0], v: [0.0, 1.0, 0.0] }),
        ("wall", Rectangle { at: [-6.0, -6.0, 0.0], u: [16.0, 0.0, 0.0], v: [0.0, 0.0, 6.0] }),
    ] {
        let mut model = Model::default();
        room(&mut model, 0.0, &[(FRONT, hole)]);
        model.object("mask");
        model.quad([
            mask.point(0., 0.),
            mask.point(0., 1.),
            mask.point(1., 1.),
            mask.point(1., 0.),
        ]);
        let case = Case::new(&model, &points);
        let found = case.rendered(&text);
        let normal = mask.normal();
        let expected: Vec<f64> = points
            .iter()
            .map(|&(p, n)| {
                through(p, n, &opening, &sky, |to| {
                    let t = dot(sub(mask.at, p), normal) / dot(to, normal);
                    let hit = sub([0, 1, 2].map(|i| p[i] + t * to[i]), mask.at);
                    let share = |side: Point| dot(hit, side) / dot(side, side);
                    let inside = |s: f64| (0.0..=1.0).contains(&s);
                    !(t > 0.0 && inside(share(mask.u)) && inside(share(mask.v)))
                })
            })
            .collect();
        let open: Vec<f64> =
            points.iter().map(|&(p, n)| through(p, n, &opening, &sky, |_| true)).collect();
        assert!(open.iter().zip(&expected).any(|(o, e)| e < &(0.9 * o)), "{name} masks something");
        assert_close(&found, &expected, 0.02, name);
    }
}

/// The photons of an opening carry what the quadrature says, and land where it says; counts are exact.
#[test]
fn photons_through_an_opening() {
    let hole = [0.375, 0.625, 0.375, 0.625];
    let mut model = Model::default();
    room(&mut model, 0.0, &[(CEILING, hole)]);
    let case = Case::new(&model, &[]);
    let sky = Sky::new(12, 60.0, 0.2);
    let (all, stats) = case.traced(&sky_text(12, 60.0, 0.2), "400k");
    let n = |key: &str| number(&stats, key);
    // One opening, and the sky that comes through none.
    assert_eq!(n("photons_emitted"), 800_000.0);
    assert_eq!(n("photons_emitted"), n("photons_absorbed") + n("photons_escaped"));
    let balance = n("flux_emitted_w") - n("flux_absorbed_w") - n("flux_escaped_w");
    assert!(balance.abs() < 1e-5 * n("flux_emitted_w"), "{balance} W are missing");
    // All that enters lands inside. The opening is square to the zenith: 1000 W/m2 through 1 m2.
    let (landed, _) = watts(&all, 0.0, |_| true);
    // 400,000 weights, whose deviation is below 0.3 of their mean: 4 sigma are 0.2 %. RGBE adds nothing, on average.
    assert!((landed / DIFFUSE - 1.0).abs() < 0.002, "{landed} W");
    // A square metre of the floor under the opening, and a quarter of one in a corner.
    for (x, y, size) in [(1.5, 1.5, 1.0), (0.2, 0.2, 0.5)] {
        let (found, count) = watts(&all, 0.0, |p| {
            p[2].abs() < 1e-3 && (x..x + size).contains(&p[0]) && (y..y + size).contains(&p[1])
        });
        let steps = 8;
        let mut expected = 0.0;
        for i in 0..steps * steps {
            let at = |k: i32| (f64::from(k) + 0.5) / f64::from(steps) * size;
            let p = [x + at(i % steps), y + at(i / steps), 0.0];
            expected += through(p, [0.0, 0.0, 1.0], &opening(0.0, CEILING, hole), &sky, |_| true);
        }
        expected *= size * size / f64::from(steps * steps);
        let sigma = 1.1 / count.sqrt();
        assert!((found / expected - 1.0).abs() < 4.0 * sigma, "{found} W for {expected}, {count}");
    }
}

/// Three windows in a line: the sky that is seen through all of them is counted once, by photons and by shadow rays.
#[test]
fn a_line_through_three_openings_counts_once() {
    // 1 x 1 m at y = 1.5 to 2.5, z = 1 to 2; in the wall x = 0, u is y; in x = 4, u is z.
    let (low, high) = ([0.375, 0.625, 1.0 / 3.0, 2.0 / 3.0], [1.0 / 3.0, 2.0 / 3.0, 0.375, 0.625]);
    let mut model = Model::default();
    room(&mut model, 0.0, &[(LEFT, low), (RIGHT, high)]);
    room(&mut model, 5.0, &[(LEFT, low)]);
    let point = ([9.0, 2.0, 1.5], [-1.0, 0.0, 0.0]);
    let case = Case::new(&model, &[point]);
    let text = "model = \"uniform\"\nground = 1.0";
    // Sky and ground are alike, L = E / pi. From the far wall's middle only the farthest window lies free, 9 m away.
    let found = case.rendered(text)[0];
    let side = 0.5f64 / 9.0;
    let r = (1.0 + side * side).sqrt();
    let factor = 4.0 * 2.0 * side / r * (side / r).atan() / TAU;
    assert!((found / DIFFUSE / factor - 1.0).abs() < 0.02, "{} for {factor}", found / DIFFUSE);
    // Photons: what goes through the windows 5 m apart lands on the far wall, for it fits through the one between.
    // Form factor of parallel unit squares at distance 5.
    let (all, stats) = case.traced(text, "400k");
    assert_eq!(number(&stats, "photons_emitted"), 4.0 * 400_000.0);
    let h = 5.0f64;
    let x = 1.0 / h;
    let s = (1.0 + x * x).sqrt();
    let form = 2.0 / (PI * x * x)
        * (((s * s) * (s * s) / (1.0 + 2.0 * x * x)).sqrt().ln() + 2.0 * x * s * (x / s).atan()
            - 2.0 * x * x.atan());
    let (inner, _) = watts(&all, 5.0, |p| (p[0] - 9.0).abs() < 1e-3);
    let expected = DIFFUSE * form;
    let sigma = 1.0 / (400_000.0 * form).sqrt();
    assert!((inner / expected - 1.0).abs() < 4.5 * sigma, "{inner} W for {expected}");
}

/// A room on stilts with a hole in its floor: all its light comes from the ground, whose photons are the coarse ones of the
/// whole sky. They are aimed at the hole, and bring what a quadrature says.
#[test]
fn light_from_the_ground() {
    let hole = [0.375, 0.625, 0.375, 0.625];
    let mut model = Model::default();
    room(&mut model, 0.0, &[(0, hole)]);
    model.object("ground");
    model.material("ground");
    let (low, high, depth) = (-8.0, 12.0, -3.0);
    model.quad([[low, low, depth], [high, low, depth], [high, high, depth], [low, high, depth]]);
    let case = Case::new(&model, &[]);
    // The room is black: nothing goes back and forth below it.
    let mtl = format!("newmtl grey\nKd 0 0 0\nnewmtl ground\nKd {RHO} {RHO} {RHO}\n");
    std::fs::write(case.dir.path().join("room.mtl"), mtl).unwrap();
    let (all, stats) = case.traced("model = \"uniform\"\nground = 0", "400k");
    assert_eq!(number(&stats, "photons_emitted"), 800_000.0);
    let n = |key: &str| number(&stats, key);
    assert_eq!(n("photons_emitted"), n("photons_absorbed") + n("photons_escaped"));
    let balance = n("flux_emitted_w") - n("flux_absorbed_w") - n("flux_escaped_w");
    assert!(balance.abs() < 1e-4 * n("flux_emitted_w"), "{balance} W are missing");
    let inside = |p: &&PhotonRecord| {
        let (at, normal) = (p.position().map(f64::from), p.normal().map(f64::from));
        at[2] > -1e-3 && dot(sub([2.0, 2.0, 1.5], at), normal) > 0.0
    };
    let (mut found, mut squares) = (0.0, 0.0);
    for photon in all.iter().filter(inside) {
        let flux = f64::from(photon.flux_w()[1]);
        (found, squares) = (found + flux, squares + flux * flux);
        assert_eq!(photon.flags & PHOTON_DIRECT, 0, "no sky is seen from inside");
    }
    // The ground's irradiance: the sky that the room does not hide. Both squares are cut into cells.
    let (cells, rings, sectors) = (40, 24, 48);
    let mut expected = 0.0;
    for cell in 0..cells * cells {
        let at = |k: i32| low + (high - low) * (f64::from(k) + 0.5) / f64::from(cells);
        let p = [at(cell % cells), at(cell / cells), depth];
        let mut free = 0;
        for i in 0..rings * sectors {
            let level = ((f64::from(i / sectors) + 0.5) / f64::from(rings)).sqrt();
            let (s, c) = (TAU * (f64::from(i % sectors) + 0.5) / f64::from(sectors)).sin_cos();
            let to = [level * c, level * s, (1.0 - level * level).sqrt()];
            // Slabs of the box of the room.
            let (mut near, mut far) = (0.0f64, f64::INFINITY);
            for axis in 0..3 {
                let a = (0.0 - p[axis]) / to[axis];
                let b = (SIZE[axis] - p[axis]) / to[axis];
                (near, far) = (near.max(a.min(b)), far.min(a.max(b)));
            }
            free += i32::from(near > far);
        }
        let irradiance = DIFFUSE * f64::from(free) / f64::from(rings * sectors);
        let area = (high - low).powi(2) / f64::from(cells * cells);
        for i in 0..16 {
            let at = |k: i32| 1.5 + (f64::from(k) + 0.5) / 4.0;
            let to = sub([at(i % 4), at(i / 4), 0.0], p);
            let square = dot(to, to);
            let cos2 = to[2] * to[2] / square;
            expected += RHO * irradiance * area * cos2 / (PI * square) / 16.0;
        }
    }
    // Photons that came of one are not independent: 4 sigma of twice the deviation, and 1 % for the quadrature.
    let sigma = 2.0 * squares.sqrt();
    assert!(sigma < 0.02 * expected, "{sigma} of {expected}");
    assert!((found - expected).abs() < 4.0 * sigma + 0.01 * expected, "{found} W for {expected}");
}

/// The sun through a roof opening: a patch as large as the opening, of its irradiance times the sine of its height; and
/// the photons' flux is that times its area.
#[test]
fn the_sun_through_a_roof_opening() {
    let hole = [0.375, 0.625, 0.375, 0.625];
    let mut model = Model::default();
    room(&mut model, 0.0, &[(CEILING, hole)]);
    // From the south, 70 degrees high: the patch is moved north by 3 / tan 70.
    let shift = 3.0 / 70f64.to_radians().tan();
    let up = [0.0, 0.0, 1.0];
    let wall = ([2.0, 4.0, 0.5], [0.0, -1.0, 0.0]);
    let points = [([2.0, 2.0 + shift, 0.0], up), ([2.0, 1.0, 0.0], up), wall];
    let case = Case::new(&model, &points);
    let text = "model = \"uniform\"\nsun = [180, 70]\nground = 0\ndirect_normal = 50000";
    let found = case.rendered(text);
    let sky = Sky::new(5, 70.0, 0.0);
    let sky_alone: Vec<f64> = points
        .iter()
        .map(|&(p, n)| through(p, n, &opening(0.0, CEILING, hole), &sky, |_| true))
        .collect();
    let sun = 50_000.0 * 70f64.to_radians().sin();
    assert!((found[0] / (sun + sky_alone[0]) - 1.0).abs() < 0.01, "{} for {sun}", found[0]);
    for i in [1, 2] {
        assert!((found[i] / sky_alone[i] - 1.0).abs() < 0.05, "{} for {}", found[i], sky_alone[i]);
    }
    let (all, _) = case.traced(text, "100k");
    let (patch, _) = watts(&all, 0.0, |p| {
        p[2].abs() < 1e-3 && (p[0] - 2.0).abs() < 0.55 && (p[1] - 2.0 - shift).abs() < 0.55
    });
    // The sun's photons are all alike but for the cosine in the disc, and all land there; the sky's share has 4 sigma
    // of 1 % of its own.
    let diffuse = sky_alone[0] * 1.1 * 1.1;
    assert!((patch - sun - diffuse).abs() < 0.001 * sun + 0.05 * diffuse, "{patch} for {sun}");
}

/// Pictures look out: rays that leave the scene see the sky, the ground below the horizon, and nothing without a sky.
#[test]
fn the_sky_in_a_picture() {
    let mut model = Model::default();
    model.object("plate");
    model.material("grey");
    model.quad([[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]]);
    // Straight up, and down beside the plate.
    let case = Case::new(
        &model,
        &[([0.5, 0.5, 3.0], [0.0, 0.0, -1.0]), ([3.0, 3.0, 1.0], [0.0, 0.0, 1.0])],
    );
    let found = case.rendered(&sky_text(16, 45.0, 0.4));
    let zenith = 9.0 / 7.0 * DIFFUSE / PI;
    let radiance = |e: f64| e * RHO / PI;
    assert!((radiance(found[0]) / zenith - 1.0).abs() < 1e-3, "{}", radiance(found[0]));
    assert!((radiance(found[1]) / (0.4 * DIFFUSE / PI) - 1.0).abs() < 1e-3);
    // The plate itself is outside: it gets the whole sky.
    let case = Case::new(&model, &[([0.5, 0.5, 0.0], [0.0, 0.0, 1.0])]);
    let found = case.rendered(&sky_text(12, 45.0, 0.4));
    assert!((found[0] / DIFFUSE - 1.0).abs() < 0.02, "{}", found[0]);
}

/// Photons of a scene with daylight do not depend on tiles, threads and memory.
#[test]
fn the_same_bits() {
    let mut model = Model::default();
    room(&mut model, 0.0, &[(FRONT, [1.0 / 3.0, 2.0 / 3.0, 0.25, 0.75])]);
    room(
        &mut model,
        5.0,
        &[(LEFT, [0.375, 0.625, 1.0 / 3.0, 2.0 / 3.0]), (CEILING, [0.4, 0.6, 0.4, 0.6])],
    );
    model.object("things");
    for i in 0..12 {
        let x = f64::from(i) * 0.8;
        model.turned([x - 0.3, 1.0 + 0.2 * x, 0.4], [0.2, 0.25, 0.3], 7.0 * x);
    }
    model.object("ground");
    model.quad([[-6., -6., -0.1], [15., -6., -0.1], [15., 9., -0.1], [-6., 9., -0.1]]);
    let case = Case::new(&model, &[]);
    let scene = case.scene("model = \"cie-12\"\ndirect_normal = 300\nsun = [160, 40]");
    let dir = &case.dir;
    let trace = |name: &str, partition: &[&str], trace: &[&str]| {
        let store = dir.path().join(format!("{name}.enf"));
        ok(bin("enf-partition").arg(&scene).arg("-o").arg(&store).arg("--quiet").args(partition));
        ok(bin("enf-grid").arg(&store).arg("--quiet"));
        ok(bin("enf-trace").arg(&store).args(["--quiet", "--photons-per-light", "5k"]).args(trace));
        digest(&store, "photons")
    };
    let one = trace("plain", &[], &["--threads", "1"]);
    let stats = dir.path().join("partition.json");
    let again = ["--quiet", "--stats"];
    ok(bin("enf-partition")
        .arg(&scene)
        .arg("-o")
        .arg(dir.path().join("plain.enf"))
        .args(again)
        .arg(&stats));
    assert!(number(&json(&stats), "sky_openings") >= 3.0);
    assert_eq!(one, trace("tiles", &["--random-tiles", "9"], &["--threads", "2"]));
    assert_eq!(one, trace("small", &["--tile-triangles", "40"], &["--queue-block", "64"]));
}

/// A scene with a sky but no window says so.
#[test]
fn no_opening() {
    let mut model = Model::default();
    room(&mut model, 0.0, &[]);
    let case = Case::new(&model, &[]);
    let scene = case.scene("model = \"uniform\"");
    let store = Path::new("closed.enf");
    let output =
        ok(bin("enf-partition").current_dir(case.dir.path()).arg(&scene).arg("-o").arg(store));
    let text = common::stderr(&output);
    assert!(text.contains("no room has an opening to the outside"), "{text}");
}
