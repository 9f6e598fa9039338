//! Tables, desks and what is worked at.

use crate::mesh::{
    Mesh, Paint, Raised, all, ball, cuboid, cylinder, lathe, rod, rounded, sheet, soft,
    superellipse, top, tube, v,
};
use glam::DVec2;

fn tapered(paint: Paint, x: f64, y: f64, height: f64, (low, high): (f64, f64), splay: f64) -> Mesh {
    let n = (x * x + y * y).sqrt().max(1e-9);
    let foot = v(x + splay * x / n, y + splay * y / n, 0.0);
    let path: Vec<_> = (0..=1).map(|i| foot.lerp(v(x, y, height), f64::from(i))).collect();
    rod(paint, &path, |s| low + (high - low) * s, 6)
}

/// A table with four legs, `width` by `depth`, `height` to its top.
pub fn table(wood: Paint, width: f64, depth: f64, height: f64) -> Mesh {
    let outline = superellipse(width / 2.0, depth / 2.0, 14.0, 24);
    let mut m = top(wood, &outline, height - 0.032, height);
    let (x, y) = (width / 2.0 - 0.07, depth / 2.0 - 0.07);
    for s in [-1.0, 1.0] {
        m.add(
            rounded(wood, v(-x, -0.012, height - 0.11), v(x, 0.012, height - 0.033), 0.005, 1).at(
                0.0,
                (y - 0.01) * s,
                0.0,
            ),
        );
        m.add(
            rounded(wood, v(-0.012, -y, height - 0.11), v(0.012, y, height - 0.033), 0.005, 1).at(
                (x - 0.01) * s,
                0.0,
                0.0,
            ),
        );
        for t in [-1.0, 1.0] {
            m.add(tapered(wood, x * s, y * t, height - 0.033, (0.016, 0.03), 0.015));
        }
    }
    m
}

/// A round table on a turned pedestal.
pub fn round_table(wood: Paint, foot: Paint, radius: f64, height: f64) -> Mesh {
    let mut m = top(wood, &superellipse(radius, radius, 2.0, 24), height - 0.03, height);
    let h = height - 0.03;
    m.add(lathe(
        foot,
        &[
            (0.0, 0.0),
            (radius * 0.55, 0.0),
            (radius * 0.56, 0.01),
            (radius * 0.5, 0.022),
            (radius * 0.2, 0.045),
            (0.05, 0.09),
            (0.036, 0.16),
            (0.034, h * 0.6),
            (0.042, h * 0.85),
            (0.09, h - 0.02),
            (0.14, h - 0.001),
            (0.0, h - 0.001),
        ],
        12,
    ));
    m
}

/// A low table with a rounded top and a shelf.
pub fn coffee_table(wood: Paint, width: f64, depth: f64) -> Mesh {
    let mut m = top(wood, &superellipse(width / 2.0, depth / 2.0, 3.2, 24), 0.36, 0.395);
    m.add(top(wood, &superellipse(width / 2.0 - 0.1, depth / 2.0 - 0.09, 3.2, 20), 0.14, 0.158));
    for (s, t) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        m.add(tapered(
            wood,
            (width / 2.0 - 0.16) * s,
            (depth / 2.0 - 0.12) * t,
            0.36,
            (0.013, 0.022),
            0.05,
        ));
    }
    m
}

/// A small side table.
pub fn side_table(wood: Paint) -> Mesh {
    let mut m = top(wood, &superellipse(0.22, 0.22, 2.0, 16), 0.5, 0.525);
    m.add(top(wood, &superellipse(0.15, 0.15, 2.0, 12), 0.18, 0.195));
    for k in 0..3 {
        m.add(
            tapered(wood, 0.15, 0.0, 0.5, (0.01, 0.015), 0.05).turned(120.0 * f64::from(k) + 20.0),
        );
    }
    m
}

/// A row of drawers with handles; front at -y.
pub fn drawers(paint: Paint, handle: Paint, (w, d, h): (f64, f64, f64), rows: usize) -> Mesh {
    let mut m =
        rounded(paint, v(-w / 2.0, -d / 2.0 + 0.018, 0.0), v(w / 2.0, d / 2.0, h), 0.004, 1);
    let step = (h - 0.02) / rows as f64;
    for k in 0..rows {
        let z = 0.012 + step * k as f64;
        m.add(rounded(
            paint,
            v(-w / 2.0 + 0.006, -d / 2.0, z),
            v(w / 2.0 - 0.006, -d / 2.0 + 0.017, z + step - 0.006),
            0.004,
            1,
        ));
        let (y, zz) = (-d / 2.0 - 0.024, z + step * 0.68);
        let half = (w * 0.22).min(0.09);
        m.add(tube(
            handle,
            &[v(-half, -d / 2.0, zz), v(-half, y, zz), v(half, y, zz), v(half, -d / 2.0, zz)],
            0.005,
            5,
        ));
    }
    m
}

/// A desk with a drawer unit; the sitter is at -y.
pub fn desk(wood: Paint, body: Paint, width: f64) -> Mesh {
    let d = 0.76;
    let mut m = top(wood, &superellipse(width / 2.0, d / 2.0, 20.0, 16), 0.71, 0.74);
    for x in [-width / 2.0 + 0.05, width / 2.0 - 0.05] {
        for y in [-d / 2.0 + 0.06, d / 2.0 - 0.06] {
            m.add(soft("metal.dark", 0.045, 0.045, 0.709, 0.006, 1).at(x, y, 0.0));
        }
        m.add(rounded(
            "metal.dark",
            v(x - 0.015, -d / 2.0 + 0.083, 0.66),
            v(x + 0.015, d / 2.0 - 0.083, 0.709),
            0.004,
            1,
        ));
    }
    m.add(rounded(
        body,
        v(-width / 2.0 + 0.075, d / 2.0 - 0.075, 0.36),
        v(width / 2.0 - 0.075, d / 2.0 - 0.055, 0.7),
        0.004,
        1,
    ));
    m.add(drawers(body, "metal.steel", (0.4, 0.55, 0.56), 3).at(width / 2.0 - 0.3, -0.02, 0.07));
    m.add(soft("metal.dark", 0.36, 0.5, 0.069, 0.006, 1).at(width / 2.0 - 0.3, -0.01, 0.0));
    m
}

/// A long conference table, its long side along y, on slab feet, with cable lids.
pub fn conference_table(wood: Paint, foot: Paint, length: f64, width: f64) -> Mesh {
    let boat = |inset: f64| -> Vec<DVec2> {
        superellipse(width / 2.0 - inset, length / 2.0 - inset, 6.0, 56)
            .into_iter()
            .map(|p| DVec2::new(p.x * (1.0 - 0.16 * (2.0 * p.y / length).raised(2)), p.y))
            .collect()
    };
    let mut m = top(wood, &boat(0.0), 0.705, 0.745);
    for k in 0..3 {
        let y = (f64::from(k) - 1.0) * length * 0.34;
        m.add(top(foot, &superellipse(width * 0.27, 0.2, 5.0, 24), 0.0, 0.03).at(0.0, y, 0.0));
        m.add(
            rounded(foot, v(-width * 0.2, -0.1, 0.029), v(width * 0.2, 0.1, 0.704), 0.03, 2)
                .at(0.0, y, 0.0),
        );
        m.add(
            rounded("metal.steel", v(-0.06, -0.14, 0.7455), v(0.06, 0.14, 0.7495), 0.0015, 1)
                .at(0.0, y, 0.0),
        );
    }
    m
}

/// A reception counter of `width` with a raised front; the visitor is at -y.
pub fn counter(front: Paint, worktop: Paint, width: f64) -> Mesh {
    let w = width / 2.0;
    let mut m = rounded(front, v(-w, -0.3, 0.04), v(w, -0.22, 1.04), 0.012, 1);
    for s in [-1.0, 1.0] {
        m.add(rounded(front, v(-0.03, -0.215, 0.04), v(0.03, 0.4, 1.04), 0.012, 1).at(
            (w - 0.031) * s,
            0.0,
            0.0,
        ));
    }
    m.add(rounded(worktop, v(-w - 0.02, -0.36, 1.041), v(w + 0.02, -0.06, 1.075), 0.012, 1));
    m.add(rounded(worktop, v(-w + 0.062, -0.21, 0.7), v(w - 0.062, 0.42, 0.73), 0.008, 1));
    m.add(rounded("metal.dark", v(-w + 0.03, -0.27, 0.0), v(w - 0.03, 0.3, 0.038), 0.006, 1));
    let n = (width / 0.075) as usize;
    for k in 0..n {
        let x = -w + 0.05 + (width - 0.1) * (k as f64 + 0.5) / n as f64;
        m.add(cuboid("wood.oak", v(x - 0.02, -0.319, 0.08), v(x + 0.02, -0.301, 1.0)));
    }
    m
}

/// A pool table with balls, its long side along x.
pub fn pool_table(wood: Paint) -> Mesh {
    let (w, d) = (1.22, 0.68);
    let mut m = all([
        rounded(wood, v(-w, -d, 0.58), v(w, d, 0.775), 0.03, 1),
        rounded("felt.green", v(-w + 0.1, -d + 0.1, 0.7755), v(w - 0.1, d - 0.1, 0.79), 0.004, 1),
    ]);
    for s in [-1.0, 1.0] {
        for (x0, x1) in [(-w + 0.1, -0.06), (0.06, w - 0.1)] {
            m.add(rounded(wood, v(x0, -0.05, 0.776), v(x1, 0.05, 0.832), 0.016, 1).at(
                0.0,
                (d - 0.05) * s,
                0.0,
            ));
            m.add(
                rounded(
                    "felt.green",
                    v(x0 + 0.03, -0.025, 0.7905),
                    v(x1 - 0.03, 0.0249, 0.825),
                    0.01,
                    1,
                )
                .at(0.0, (d - 0.126) * s, 0.0),
            );
        }
        m.add(rounded(wood, v(-0.05, -d + 0.1, 0.776), v(0.05, d - 0.1, 0.832), 0.016, 1).at(
            (w - 0.05) * s,
            0.0,
            0.0,
        ));
        m.add(
            rounded(
                "felt.green",
                v(-0.025, -d + 0.13, 0.7905),
                v(0.0249, d - 0.13, 0.825),
                0.01,
                1,
            )
            .at((w - 0.126) * s, 0.0, 0.0),
        );
        for t in [-1.0, 0.0, 1.0] {
            let (x, y) = ((w - 0.075) * t, (d - 0.06) * s);
            m.add(
                lathe(
                    "leather.black",
                    &[
                        (0.0, 0.0),
                        (0.05, 0.0),
                        (0.062, 0.012),
                        (0.064, 0.05),
                        (0.05, 0.058),
                        (0.044, 0.05),
                        (0.04, 0.02),
                        (0.0, 0.012),
                    ],
                    8,
                )
                .at(x, y, 0.78),
            );
        }
        for t in [-1.0, 1.0] {
            m.add(
                lathe(
                    wood,
                    &[
                        (0.0, 0.0),
                        (0.05, 0.0),
                        (0.06, 0.03),
                        (0.045, 0.06),
                        (0.06, 0.12),
                        (0.075, 0.2),
                        (0.06, 0.32),
                        (0.085, 0.42),
                        (0.09, 0.579),
                        (0.0, 0.579),
                    ],
                    8,
                )
                .at((w - 0.2) * s, (d - 0.16) * t, 0.0),
            );
        }
    }
    let colours: [Paint; 15] = [
        "lacquer.yellow",
        "lacquer.blue",
        "lacquer.red",
        "fabric.plum",
        "fabric.orange",
        "lacquer.green",
        "book.wine",
        "plastic.black",
        "fabric.mustard",
        "fabric.blue",
        "fabric.red",
        "book.violet",
        "fruit.orange",
        "fabric.green",
        "book.brown",
    ];
    let r = 0.0286;
    let mut k = 0;
    for row in 0..5 {
        for i in 0..=row {
            let (x, y) = (
                0.45 + f64::from(row) * r * 1.76,
                (f64::from(i) - f64::from(row) / 2.0) * r * 2.03,
            );
            m.add(ball(colours[k], r, 8).at(x, y, 0.791 + r));
            k += 1;
        }
    }
    m.add(ball("ceramic.white", r, 8).at(-0.62, 0.08, 0.791 + r));
    let cue = [v(-1.05, -0.28, 0.86), v(0.25, 0.12, 0.835)];
    m.add(rod("wood.birch", &cue, |s| 0.014 - 0.008 * s, 5));
    m
}

/// An upright piano; the player is at -y.
pub fn piano(wood: Paint) -> Mesh {
    let w = 0.74;
    let mut m = all([
        rounded(wood, v(-w, 0.0, 0.02), v(w, 0.3, 1.16), 0.01, 1),
        rounded(wood, v(-w - 0.012, -0.02, 1.161), v(w + 0.012, 0.31, 1.19), 0.01, 1),
        rounded(wood, v(-w, -0.3, 0.6), v(w, -0.001, 0.68), 0.01, 1),
        rounded(wood, v(-w + 0.06, -0.016, 0.14), v(w - 0.06, -0.001, 0.56), 0.006, 1),
        rounded(wood, v(-w + 0.06, -0.016, 0.76), v(w - 0.06, -0.001, 1.1), 0.006, 1),
        rounded(wood, v(-0.45, -0.05, 0.82), v(0.45, -0.036, 1.06), 0.005, 1).tipped(0.0),
        rounded(wood, v(-0.45, -0.1, 0.806), v(0.45, -0.017, 0.82), 0.005, 1),
    ]);
    for s in [-1.0, 1.0] {
        m.add(rounded(wood, v(-0.035, -0.3, 0.681), v(0.035, -0.001, 0.76), 0.012, 1).at(
            (w - 0.036) * s,
            0.0,
            0.0,
        ));
        m.add(
            lathe(
                wood,
                &[
                    (0.0, 0.0),
                    (0.03, 0.0),
                    (0.036, 0.05),
                    (0.024, 0.1),
                    (0.036, 0.3),
                    (0.042, 0.599),
                    (0.0, 0.599),
                ],
                8,
            )
            .at((w - 0.06) * s, -0.24, 0.0),
        );
    }
    let (keys, left) = (52, -w + 0.08);
    let step = (2.0 * w - 0.16) / f64::from(keys);
    for k in 0..keys {
        let x = left + step * f64::from(k);
        m.add(crate::mesh::cuboid(
            "ceramic.white",
            v(x + 0.0006, -0.27, 0.681),
            v(x + step - 0.0006, -0.13, 0.702),
        ));
        if ![2, 6].contains(&(k % 7)) && k + 1 < keys {
            m.add(crate::mesh::cuboid(
                "plastic.black",
                v(x + step - 0.006, -0.225, 0.7025),
                v(x + step + 0.006, -0.131, 0.713),
            ));
        }
    }
    // Sheet music.
    for s in [-1.0, 1.0] {
        m.add(sheet("paper", (6, 4), (false, false), |a, b| {
            let x = 0.21 * (a - 0.5) + 0.107 * s;
            v(x, -0.056 - 0.012 * libm::sin(a * 3.0), 0.825 + 0.27 * b)
        }));
    }
    for k in 0..3 {
        m.add(tube(
            "metal.brass",
            &[v(0.1 * (f64::from(k) - 1.0), -0.12, 0.05), v(0.1 * (f64::from(k) - 1.0), 0.0, 0.08)],
            0.012,
            5,
        ));
    }
    m
}

/// An easel with a canvas; the painter is at -y.
pub fn easel(wood: Paint, strokes: [Paint; 4]) -> Mesh {
    let mut m = Mesh::new();
    for s in [-1.0, 1.0] {
        m.add(tube(wood, &[v(0.32 * s, -0.12, 0.0), v(0.06 * s, 0.12, 1.75)], 0.016, 5));
    }
    m.add(tube(wood, &[v(0.0, 0.55, 0.0), v(0.0, 0.13, 1.68)], 0.016, 5));
    m.add(rounded(wood, v(-0.4, -0.09, 0.74), v(0.4, -0.005, 0.77), 0.006, 1));
    let mut canvas = rounded("paper", v(-0.36, -0.012, 0.0), v(0.36, 0.012, 0.86), 0.005, 1);
    for (k, paint) in strokes.into_iter().enumerate() {
        let f = k as f64;
        canvas.add(sheet(paint, (12, 2), (false, false), |a, b| {
            let x = -0.3 + 0.6 * a;
            let z = 0.12
                + 0.17 * f
                + (0.1 + 0.05 * libm::sin(5.0 * a + f)) * b
                + 0.05 * libm::sin(6.0 * a + 2.0 * f);
            v(x, -0.0135 - 0.0004 * f - 0.001 * libm::sin(20.0 * a), z)
        }));
    }
    m.add(canvas.tipped(-7.8).at(0.0, -0.03, 0.772));
    m
}

/// A workbench with a vice; the worker is at -y.
pub fn workbench(wood: Paint, width: f64) -> Mesh {
    let mut m = soft(wood, width, 0.66, 0.07, 0.01, 1).at(0.0, 0.0, 0.8);
    for s in [-1.0, 1.0] {
        for t in [-1.0, 1.0] {
            m.add(soft(wood, 0.085, 0.085, 0.799, 0.01, 1).at(
                (width / 2.0 - 0.14) * s,
                0.24 * t,
                0.0,
            ));
        }
        m.add(soft(wood, 0.05, 0.39, 0.09, 0.008, 1).at((width / 2.0 - 0.14) * s, 0.0, 0.16));
    }
    m.add(soft(wood, width - 0.38, 0.4, 0.03, 0.006, 1).at(0.0, 0.0, 0.2));
    m.add(soft("metal.dark", 0.18, 0.05, 0.12, 0.012, 1).at(-width / 2.0 + 0.3, -0.37, 0.745));
    m.add(tube(
        "metal.steel",
        &[v(-width / 2.0 + 0.3, -0.46, 0.79), v(-width / 2.0 + 0.3, -0.3, 0.79)],
        0.013,
        5,
    ));
    m.add(tube(
        "metal.steel",
        &[v(-width / 2.0 + 0.2, -0.455, 0.79), v(-width / 2.0 + 0.4, -0.455, 0.79)],
        0.008,
        5,
    ));
    m.add(cylinder("metal.copper", 0.05, 0.11, 10).at(width / 2.0 - 0.25, 0.15, 0.871));
    m
}
