//! Shelves, books, cupboards, boxes.

use crate::furniture::tables::drawers;
use crate::mesh::{
    Mesh, Paint, all, ball, block, cuboid, cylinder, lathe, rounded, sheet, soft, tube, v,
};
use crate::palette::BOOKS;
use crate::rng::Rng;

/// A book on a shelf, its spine to -y: thickness, depth, height. One closed block whose top shows
/// the pages.
fn shelved(cover: Paint, t: f64, d: f64, h: f64) -> Mesh {
    let e = t / 2.0;
    let mut m = Mesh::new();
    for z in [0.0, h] {
        for (x, y) in
            [(-e, d), (-e, 0.0), (-e * 0.55, -0.0045), (e * 0.55, -0.0045), (e, 0.0), (e, d)]
        {
            m.point(v(x, y, z));
        }
    }
    for i in 0..6u32 {
        let j = (i + 1) % 6;
        m.quad([i, j, j + 6, i + 6], cover);
    }
    for (a, b, c, paint) in
        [(1, 2, 3, cover), (1, 3, 4, cover), (0, 1, 4, "paper"), (0, 4, 5, "paper")]
    {
        m.triangle(a, c, b, paint);
        m.triangle(a + 6, b + 6, c + 6, paint);
    }
    m
}

/// A book that may be seen from all sides, its spine to -y: thickness, depth, height. A cover
/// around a block of pages that is set back on three sides.
pub fn book(cover: Paint, t: f64, d: f64, h: f64) -> Mesh {
    let (e, b) = (t / 2.0, 0.0024_f64.min(t * 0.12));
    let mut m = Mesh::new();
    // A U in plan: around the outside, then back along the inside. The spine is a little round.
    let around = [(e, d), (-e, d), (-e, 0.0), (-e * 0.55, -0.0045), (e * 0.55, -0.0045), (e, 0.0)];
    let outline = [
        around[1],
        around[2],
        around[3],
        around[4],
        around[5],
        around[0],
        (e - b, d),
        (e - b, 0.004),
        (-e + b, 0.004),
        (-e + b, d),
    ];
    for z in [0.0, h] {
        for (x, y) in outline {
            m.point(v(x, y, z));
        }
    }
    for i in 0..10u32 {
        let j = (i + 1) % 10;
        m.quad([i, j, j + 10, i + 10], cover);
    }
    // The ends: two boards, and the spine between them.
    for (a, b, c) in
        [(0, 1, 8), (0, 8, 9), (1, 2, 8), (2, 3, 8), (3, 7, 8), (3, 4, 7), (4, 6, 7), (4, 5, 6)]
    {
        m.triangle(a, c, b, cover);
        m.triangle(a + 10, b + 10, c + 10, cover);
    }
    m.add(cuboid(
        "paper",
        v(-e + b + 0.0001, 0.0042, 0.003),
        v(e - b - 0.0001, d - 0.004, h - 0.004),
    ));
    m
}

/// A row of books from x = 0 to `width`, spines near y = 0, no higher than `height`. Some lean,
/// some lie in a pile, and there are gaps: people read them.
pub fn books(width: f64, height: f64, depth: f64, rng: &mut Rng) -> Mesh {
    let mut m = Mesh::new();
    let mut x = 0.006 + rng.range(0.0, 0.02);
    let end = width - 0.008;
    while x < end - 0.03 {
        let roll = rng.unit();
        if roll < 0.035 && end - x > 0.3 {
            x += rng.range(0.06, 0.16);
            continue;
        }
        if roll < 0.075 && end - x > 0.3 {
            // A pile.
            let mut z = 0.0;
            let count = 2 + rng.below(4);
            for _ in 0..count {
                let t = rng.range(0.018, 0.045);
                let (d, h) = (rng.range(0.13, (depth - 0.02).min(0.18)), rng.range(0.19, 0.25));
                if z + t > height - 0.02 {
                    break;
                }
                let b = book(rng.pick(BOOKS), t, d, h).rolled(90.0).turned(rng.around(5.0));
                m.add(b.at(x + 0.005, 0.012, z + t / 2.0 + 0.0005));
                z += t;
            }
            x += 0.275;
            continue;
        }
        // A run of one set, or a single book.
        let set = if rng.unit() < 0.16 { 3 + rng.below(5) } else { 1 };
        let paint = rng.pick(BOOKS);
        let (t, d, h) = (
            rng.range(0.02, 0.058),
            rng.range(0.14, (depth - 0.03).clamp(0.141, 0.21)),
            rng.range(0.62, 0.95) * height.min(0.33),
        );
        for _ in 0..set {
            if x + t > end {
                break;
            }
            let y = 0.008 + rng.range(0.0, 0.014) + (depth - 0.03 - d).max(0.0) * 0.15;
            let b = shelved(paint, t, d, h);
            let lean = if set == 1 && rng.unit() < 0.07 && x + h * 0.2 + t < end {
                rng.range(6.0, 11.0)
            } else {
                0.0
            };
            if lean > 0.0 {
                // It leans on the book to its left: foot further right, top to the left.
                let (s, c) = crate::mesh::sin_cos(crate::mesh::radians(lean));
                let foot = x + h * s;
                m.add(b.at(t / 2.0, 0.0, 0.0).rolled(-lean).at(foot, y, 0.001));
                x = foot + t * c + 0.001;
            } else {
                m.add(b.at(x + t / 2.0, y, 0.0));
                x += t + rng.range(0.0006, 0.0018);
            }
        }
    }
    m
}

/// A bookcase with `shelves` rows of books.
pub fn bookcase(wood: Paint, width: f64, height: f64, shelves: usize, mut rng: Rng) -> Mesh {
    let (d, t) = (0.28, 0.022);
    let (w, h) = (width / 2.0, d / 2.0);
    let mut m = Mesh::new();
    for s in [-1.0, 1.0] {
        m.add(rounded(wood, v(-t / 2.0, -h, 0.0), v(t / 2.0, h, height), 0.003, 1).at(
            (w - t / 2.0) * s,
            0.0,
            0.0,
        ));
    }
    m.add(cuboid(
        wood,
        v(-w + t + 0.0005, h - 0.008, 0.06),
        v(w - t - 0.0005, h - 0.0005, height - t),
    ));
    m.add(rounded(wood, v(-w + t, -h + 0.01, 0.0), v(w - t, -h + 0.025, 0.06), 0.003, 1));
    let pitch = (height - 0.06 - t) / shelves as f64;
    for k in 0..=shelves {
        let z = 0.06 + pitch * k as f64;
        m.add(rounded(
            wood,
            v(-w + t + 0.0005, -h + 0.003, z),
            v(w - t - 0.0005, h - 0.0085, z + t),
            0.003,
            1,
        ));
        if k < shelves {
            let room = pitch - t - 0.03;
            let gap = rng.unit();
            let inner = width - 2.0 * t;
            // Now and then a shelf holds something else as well.
            let used = if gap < 0.16 { inner * 0.62 } else { inner };
            let row = books(used, room, d - 0.01, &mut rng);
            m.add(row.at(-w + t, -h + 0.006, z + t + 0.0005));
            if gap < 0.16 {
                let x = -w + t + inner * 0.82;
                let thing = match rng.below(3) {
                    0 => crate::furniture::decor::vase("ceramic.blue", 0.2),
                    1 => crate::furniture::decor::vase("ceramic.ochre", 0.16),
                    _ => ball("wood.walnut", 0.06, 8).at(0.0, 0.0, 0.06),
                };
                m.add(thing.at(x, -0.02, z + t + 0.001));
            }
        }
    }
    m.add(rounded(
        wood,
        v(-w - 0.01, -h - 0.012, height + 0.0005),
        v(w + 0.01, h, height + 0.03),
        0.006,
        1,
    ));
    m
}

/// A low sideboard with doors and drawers.
pub fn sideboard(body: Paint, front: Paint, width: f64) -> Mesh {
    let (w, d) = (width / 2.0, 0.22);
    let mut m = rounded(body, v(-w, -d + 0.019, 0.14), v(w, d, 0.76), 0.006, 1);
    m.add(rounded(body, v(-w - 0.012, -d - 0.01, 0.7605), v(w + 0.012, d, 0.785), 0.006, 1));
    let n = (width / 0.48).max(1.0) as usize;
    let step = (width - 0.02) / n as f64;
    for k in 0..n {
        let x = -w + 0.01 + step * (k as f64 + 0.5);
        if k % 3 == 1 {
            m.add(drawers(front, "metal.brass", (step - 0.006, 0.04, 0.6), 3).at(
                x,
                -d + 0.0185 - 0.0,
                0.15,
            ));
        } else {
            m.add(rounded(
                front,
                v(x - step / 2.0 + 0.003, -d, 0.152),
                v(x + step / 2.0 - 0.003, -d + 0.018, 0.75),
                0.004,
                1,
            ));
            let side = if k % 2 == 0 { 1.0 } else { -1.0 };
            m.add(ball("metal.brass", 0.013, 8).at(
                x + side * (step / 2.0 - 0.05),
                -d - 0.016,
                0.55,
            ));
            m.add(cylinder("metal.brass", 0.005, 0.016, 8).tipped(90.0).at(
                x + side * (step / 2.0 - 0.05),
                -d,
                0.55,
            ));
        }
    }
    for (s, t) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        m.add(lathe(body, &[(0.0, 0.0), (0.012, 0.0), (0.022, 0.139), (0.0, 0.139)], 8).at(
            (w - 0.1) * s,
            (d - 0.06) * t,
            0.0,
        ));
    }
    m
}

/// A wardrobe with panelled doors.
pub fn wardrobe(paint: Paint, width: f64, height: f64) -> Mesh {
    let (w, d) = (width / 2.0, 0.29);
    let mut m = rounded(paint, v(-w, -d + 0.021, 0.07), v(w, d, height), 0.006, 1);
    m.add(rounded(paint, v(-w + 0.02, -d + 0.05, 0.0), v(w - 0.02, d, 0.069), 0.004, 1));
    m.add(rounded(
        paint,
        v(-w - 0.02, -d - 0.02, height + 0.0005),
        v(w + 0.02, d, height + 0.05),
        0.012,
        1,
    ));
    let n = (width / 0.5).max(1.0) as usize;
    let step = width / n as f64;
    for k in 0..n {
        let x = -w + step * (k as f64 + 0.5);
        let (a, b) = (x - step / 2.0 + 0.003, x + step / 2.0 - 0.003);
        m.add(rounded(paint, v(a, -d, 0.08), v(b, -d + 0.02, height - 0.01), 0.004, 1));
        for (z0, z1) in [(0.2, height * 0.46), (height * 0.46 + 0.1, height - 0.13)] {
            m.add(rounded(
                paint,
                v(a + 0.08, -d - 0.008, z0),
                v(b - 0.08, -d - 0.0005, z1),
                0.006,
                1,
            ));
        }
        let side = if k % 2 == 0 { 1.0 } else { -1.0 };
        let hx = x + side * (step / 2.0 - 0.04);
        m.add(tube(
            "metal.brass",
            &[v(hx, -d, 1.0), v(hx, -d - 0.035, 1.01), v(hx, -d - 0.035, 1.15), v(hx, -d, 1.16)],
            0.006,
            5,
        ));
    }
    m
}

/// A steel rack with boxes and binders.
pub fn rack(width: f64, height: f64, shelves: usize, mut rng: Rng) -> Mesh {
    let (w, d) = (width / 2.0, 0.22);
    let mut m = Mesh::new();
    for (s, t) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        m.add(soft("metal.steel", 0.035, 0.035, height, 0.005, 1).at(
            (w - 0.018) * s,
            (d - 0.018) * t,
            0.0,
        ));
    }
    let pitch = (height - 0.14) / (shelves - 1) as f64;
    for k in 0..shelves {
        let z = 0.1 + pitch * k as f64;
        m.add(rounded(
            "metal.steel",
            v(-w + 0.002, -d + 0.002, z),
            v(w - 0.002, d - 0.002, z + 0.03),
            0.004,
            1,
        ));
        if k + 1 == shelves {
            continue;
        }
        let room = pitch - 0.05;
        let mut x = -w + 0.05;
        while x < w - 0.12 {
            if rng.unit() < 0.45 {
                let count = 3 + rng.below(5);
                let paint = rng.pick(&[
                    "book.grey",
                    "book.blue",
                    "book.black",
                    "book.green",
                    "book.red",
                    "book.white",
                ]);
                for _ in 0..count {
                    if x + 0.075 > w - 0.05 || room < 0.33 {
                        break;
                    }
                    m.add(binder(paint).at(
                        x + 0.0375,
                        -d + 0.04 + rng.range(0.0, 0.02),
                        z + 0.031,
                    ));
                    x += 0.0765;
                }
                if room < 0.33 {
                    x += 0.05;
                }
            } else {
                let bw = rng.range(0.24, 0.38).min(w - 0.05 - x);
                if bw > 0.14 {
                    let bh = rng.range(0.55, 0.9) * room.min(0.36);
                    m.add(carton(bw - 0.015, 0.34, bh).turned(rng.around(3.0)).at(
                        x + bw / 2.0,
                        rng.around(0.015),
                        z + 0.031,
                    ));
                }
                x += bw.max(0.1) + 0.01;
            }
        }
    }
    m
}

/// A ring binder, its spine to -y.
pub fn binder(paint: Paint) -> Mesh {
    let (t, d, h) = (0.036, 0.28, 0.31);
    all([
        cuboid(paint, v(-t, 0.0, 0.0), v(t, d, h)),
        cuboid("paper", v(-0.022, -0.0012, 0.12), v(0.022, -0.0003, 0.26)),
        lathe("metal.dark", &[(0.0, 0.0), (0.012, 0.0), (0.0, 0.002)], 8)
            .tipped(90.0)
            .at(0.0, -0.0003, 0.06),
    ])
}

/// A cardboard box with a lid.
pub fn carton(w: f64, d: f64, h: f64) -> Mesh {
    let mut m = cuboid("cardboard", v(-w / 2.0, -d / 2.0, 0.0), v(w / 2.0, d / 2.0, h * 0.78));
    m.add(rounded(
        "cardboard",
        v(-w / 2.0 - 0.004, -d / 2.0 - 0.004, h * 0.7801),
        v(w / 2.0 + 0.004, d / 2.0 + 0.004, h),
        0.004,
        1,
    ));
    m.add(cuboid(
        "paper",
        v(-w * 0.25, -d / 2.0 - 0.002, h * 0.35),
        v(w * 0.25, -d / 2.0 - 0.0008, h * 0.6),
    ));
    m
}

/// A storage crate of slats with a few things in it.
pub fn crate_of(fruit: Paint, mut rng: Rng) -> Mesh {
    let (w, d, h) = (0.26, 0.18, 0.24);
    let mut m = block("wood.birch", 2.0 * w - 0.03, 2.0 * d - 0.03, 0.012);
    for k in 0..3 {
        let z = 0.012 + 0.08 * f64::from(k);
        for s in [-1.0, 1.0] {
            m.add(rounded("wood.birch", v(-w, -0.006, z), v(w, 0.006, z + 0.062), 0.003, 1).at(
                0.0,
                (d - 0.006) * s,
                0.0,
            ));
            m.add(
                rounded(
                    "wood.birch",
                    v(-0.006, -d + 0.013, z),
                    v(0.006, d - 0.013, z + 0.062),
                    0.003,
                    1,
                )
                .at((w - 0.006) * s, 0.0, 0.0),
            );
        }
    }
    for j in 0..3 {
        for i in 0..4 {
            let (x, y) = (-0.18 + 0.12 * f64::from(i), -0.11 + 0.11 * f64::from(j));
            m.add(ball(fruit, rng.range(0.042, 0.05), 8).at(
                x + rng.around(0.008),
                y + rng.around(0.006),
                h - 0.065 + rng.around(0.02),
            ));
        }
    }
    m
}

/// Clothes on a rail of `width` between two posts.
pub fn clothes(width: f64, count: usize, mut rng: Rng) -> Mesh {
    let w = width / 2.0;
    let mut m = tube("metal.chrome", &[v(-w, 0.0, 1.62), v(w, 0.0, 1.62)], 0.013, 5);
    for s in [-1.0, 1.0] {
        m.add(tube("metal.chrome", &[v(w * s, 0.0, 0.02), v(w * s, 0.0, 1.655)], 0.014, 5));
        m.add(soft("metal.chrome", 0.05, 0.44, 0.02, 0.006, 1).at(w * s, 0.0, 0.0));
    }
    let cloth: [Paint; 8] = [
        "fabric.navy",
        "fabric.white",
        "fabric.red",
        "fabric.grey",
        "fabric.teal",
        "fabric.mustard",
        "fabric.plum",
        "fabric.cream",
    ];
    for k in 0..count {
        let x = -w + 0.07 + (width - 0.14) * (k as f64 + 0.5) / count as f64 + rng.around(0.012);
        let (long, paint) = (rng.range(0.55, 1.15), rng.pick(&cloth));
        let (a, b) = (rng.range(0.0, 6.0), rng.range(0.006, 0.014));
        m.add(tube(
            "metal.steel",
            &[v(x, 0.0, 1.56), v(x, 0.0, 1.6), v(x, 0.016, 1.637)],
            0.003,
            5,
        ));
        for s in [-1.0, 1.0] {
            m.add(tube("wood.birch", &[v(x, 0.0, 1.56), v(x, 0.2 * s, 1.49)], 0.007, 5));
        }
        // A closed bag of cloth: around u, down v.
        m.add(sheet(paint, (12, 6), (true, false), |u, t| {
            let (sn, cs) = crate::mesh::sin_cos(-std::f64::consts::TAU * u);
            let spread = 0.07 + 0.16 * (t * 6.0).min(1.0) + 0.02 * t;
            let wave = b * libm::sin(9.0 * cs + a) * t;
            v(
                x + (0.012 + 0.012 * t) * sn + wave,
                spread * cs,
                1.565 - 0.08 * (t * 6.0).min(1.0) - long * t,
            )
        }));
    }
    m
}
