//! Kitchens and bathrooms.

use crate::furniture::tables::drawers;
use crate::mesh::{
    Mesh, Paint, all, ball, bands, curve, cylinder, lathe, plate, ring, rod, rounded, sheet,
    sin_cos, soft, superellipse, top, tube, v,
};
use std::f64::consts::TAU;

fn tap(paint: Paint, reach: f64, tall: f64) -> Mesh {
    let mut m = cylinder(paint, 0.026, 0.02, 8);
    let path = curve(
        &[
            v(0.0, 0.0, 0.018),
            v(0.0, 0.0, tall * 0.7),
            v(0.0, -reach * 0.4, tall),
            v(0.0, -reach, tall * 0.82),
        ],
        3,
    );
    m.add(tube(paint, &path, 0.012, 5));
    m.add(tube(paint, &[v(0.014, 0.0, 0.06), v(0.09, -0.01, 0.085)], 0.007, 5));
    m
}

/// A basin: an open bowl of `outline` half-sizes with its rim at z = 0, going down by `deep`.
fn bowl(paint: Paint, x: f64, y: f64, deep: f64, power: f64) -> Mesh {
    // Profile: outer rim, top, inner wall, floor; closed below by the outer skin.
    let profile = [
        (1.0, -0.012, 1.0),
        (1.0, 0.0, 1.0),
        (0.985, 0.004, 1.0),
        (0.955, 0.002, 1.0),
        (0.92, -0.012, 1.0),
        (0.88, -deep * 0.5, 1.0),
        (0.78, -deep * 0.88, 1.0),
        (0.55, -deep, 1.0),
    ];
    let outline = superellipse(x, y, power, 20);
    let mut m = Mesh::new();
    let mut rings: Vec<Vec<u32>> = Vec::new();
    for (f, z, _) in profile {
        rings.push(outline.iter().map(|p| m.point(v(p.x * f, p.y * f, z))).collect());
    }
    // Below: the outer skin, a little thicker than the inside.
    for (f, z) in [(0.6, -deep - 0.012), (0.82, -deep * 0.9 - 0.01), (0.93, -deep * 0.5)] {
        rings.push(outline.iter().map(|p| m.point(v(p.x * f, p.y * f, z))).collect());
    }
    let n = outline.len();
    let inner_floor = m.point(v(0.0, 0.0, -deep - 0.003));
    let outer_floor = m.point(v(0.0, 0.0, -deep - 0.014));
    let mut band = |a: &[u32], b: &[u32]| {
        for i in 0..n {
            m.quad([a[i], a[(i + 1) % n], b[(i + 1) % n], b[i]], paint);
        }
    };
    for k in 0..7 {
        band(&rings[k], &rings[k + 1]);
    }
    band(&rings[8], &rings[9]);
    band(&rings[9], &rings[10]);
    band(&rings[10], &rings[0]);
    for i in 0..n {
        let j = (i + 1) % n;
        m.triangle(rings[7][i], rings[7][j], inner_floor, paint);
        m.triangle(rings[8][j], rings[8][i], outer_floor, paint);
    }
    m
}

/// One kitchen base unit with a worktop, 0.6 deep; `kind` 0 drawers, 1 door, 2 oven, 3 sink.
pub fn base_unit(front: Paint, worktop: Paint, width: f64, kind: u32) -> Mesh {
    let (w, d) = (width / 2.0, 0.3);
    let mut m = rounded(front, v(-w + 0.001, -d + 0.02, 0.1), v(w - 0.001, d, 0.855), 0.003, 1);
    m.add(rounded(
        "metal.dark",
        v(-w + 0.001, -d + 0.07, 0.0),
        v(w - 0.001, d - 0.02, 0.099),
        0.003,
        1,
    ));
    let handle = |x0: f64, x1: f64, z: f64| {
        tube(
            "metal.steel",
            &[v(x0, -d, z), v(x0, -d - 0.03, z), v(x1, -d - 0.03, z), v(x1, -d, z)],
            0.006,
            5,
        )
    };
    match kind {
        0 => {
            m.add(drawers(front, "metal.steel", (width - 0.004, 0.04, 0.75), 4).at(
                0.0,
                -d + 0.0195,
                0.1,
            ));
        }
        2 => {
            m.add(rounded(
                "metal.steel",
                v(-w + 0.004, -d, 0.72),
                v(w - 0.004, -d + 0.019, 0.85),
                0.004,
                1,
            ));
            m.add(rounded(
                "plastic.black",
                v(-w + 0.004, -d, 0.13),
                v(w - 0.004, -d + 0.019, 0.712),
                0.006,
                1,
            ));
            m.add(handle(-w + 0.06, w - 0.06, 0.67));
            for k in 0..4 {
                let x = -w + 0.12 + (width - 0.24) * f64::from(k) / 3.0;
                m.add(cylinder("metal.dark", 0.02, 0.024, 9).tipped(90.0).at(
                    x,
                    -d - 0.0005,
                    0.785,
                ));
            }
        }
        _ => {
            m.add(rounded(
                front,
                v(-w + 0.003, -d, 0.112),
                v(w - 0.003, -d + 0.019, 0.85),
                0.004,
                1,
            ));
            m.add(handle(-w * 0.5, w * 0.5, 0.8));
        }
    }
    if kind == 3 {
        // A worktop with a hole: four pieces around the sink.
        let (x, y0, y1) = (w - 0.07, -0.21, 0.17);
        for (a, b) in [
            (v(-w, -d - 0.02, 0.856), v(w, y0, 0.895)),
            (v(-w, y1, 0.856), v(w, d, 0.895)),
            (v(-w, y0, 0.856), v(-x, y1, 0.895)),
            (v(x, y0, 0.856), v(w, y1, 0.895)),
        ] {
            m.add(rounded(worktop, a, b, 0.003, 1));
        }
        m.add(bowl("metal.steel", x + 0.012, (y1 - y0) / 2.0 + 0.012, 0.16, 7.0).at(
            0.0,
            (y0 + y1) / 2.0,
            0.8965,
        ));
        m.add(tap("metal.chrome", 0.2, 0.3).at(0.0, 0.23, 0.896));
    } else {
        m.add(rounded(worktop, v(-w, -d - 0.02, 0.856), v(w, d, 0.895), 0.004, 1));
    }
    if kind == 2 {
        m.add(rounded("screen", v(-w + 0.02, -0.24, 0.8955), v(w - 0.02, 0.26, 0.901), 0.002, 1));
        for (x, y, r) in
            [(-0.13, -0.11, 0.08), (0.13, -0.11, 0.065), (-0.13, 0.14, 0.065), (0.13, 0.14, 0.08)]
        {
            m.add(ring("metal.steel", r, 0.002, 12, 3).at(x, y, 0.9015));
        }
    }
    m
}

/// A wall cupboard, to hang at its height.
pub fn wall_unit(front: Paint, width: f64) -> Mesh {
    let w = width / 2.0;
    let mut m = rounded(front, v(-w + 0.001, -0.14, 0.0), v(w - 0.001, 0.16, 0.7), 0.003, 1);
    let n = if width > 0.7 { 2 } else { 1 };
    let step = width / f64::from(n);
    for k in 0..n {
        let x = -w + step * (f64::from(k) + 0.5);
        m.add(rounded(
            front,
            v(x - step / 2.0 + 0.003, -0.16, 0.003),
            v(x + step / 2.0 - 0.003, -0.1405, 0.697),
            0.004,
            1,
        ));
        let hx = x + if k == 0 { step / 2.0 - 0.05 } else { -step / 2.0 + 0.05 };
        m.add(tube(
            "metal.steel",
            &[v(hx, -0.16, 0.06), v(hx, -0.188, 0.06), v(hx, -0.188, 0.2), v(hx, -0.16, 0.2)],
            0.005,
            5,
        ));
    }
    m
}

/// An extractor hood with its flue.
pub fn hood() -> Mesh {
    let mut m = rounded("metal.steel", v(-0.13, -0.09, 0.18), v(0.13, 0.16, 1.0), 0.006, 1);
    m.add(rounded("metal.steel", v(-0.3, -0.3, 0.0), v(0.3, 0.16, 0.179), 0.01, 1).map(|p| {
        let t = ((p.z - 0.03) / 0.149).clamp(0.0, 1.0);
        v(p.x * (1.0 - 0.5 * t), 0.16 + (p.y - 0.16) * (1.0 - 0.4 * t), p.z)
    }));
    m
}

/// A tall refrigerator.
pub fn fridge(paint: Paint) -> Mesh {
    let mut m = rounded(paint, v(-0.3, -0.27, 0.02), v(0.3, 0.32, 1.85), 0.02, 1);
    for (z0, z1) in [(0.06, 0.68), (0.69, 1.83)] {
        m.add(rounded(paint, v(-0.296, -0.33, z0), v(0.296, -0.271, z1), 0.018, 2));
        let z = if z0 < 0.5 { 0.52 } else { 0.85 };
        m.add(tube(
            "metal.chrome",
            &[
                v(-0.24, -0.33, z - 0.1),
                v(-0.24, -0.37, z - 0.09),
                v(-0.24, -0.37, z + 0.15),
                v(-0.24, -0.33, z + 0.16),
            ],
            0.009,
            5,
        ));
    }
    for (x, y) in [(-0.24, -0.2), (0.24, -0.2), (-0.24, 0.25), (0.24, 0.25)] {
        m.add(cylinder("rubber", 0.02, 0.03, 8).at(x, y, 0.0));
    }
    m
}

/// A cooking pot with a lid.
pub fn cooking_pot(paint: Paint, r: f64, h: f64) -> Mesh {
    let mut m = lathe(
        paint,
        &[
            (0.0, 0.0),
            (r - 0.008, 0.0),
            (r, 0.008),
            (r, h),
            (r + 0.004, h + 0.003),
            (r - 0.01, h + 0.012),
            (r * 0.4, h + 0.028),
            (0.0, h + 0.032),
        ],
        10,
    );
    m.add(cylinder("plastic.black", 0.018, 0.022, 8).at(0.0, 0.0, h + 0.031));
    for s in [-1.0, 1.0] {
        let grip = curve(
            &[
                v(r * s, -0.03, h - 0.025),
                v((r + 0.035) * s, -0.025, h - 0.02),
                v((r + 0.035) * s, 0.025, h - 0.02),
                v(r * s, 0.03, h - 0.025),
            ],
            2,
        );
        m.add(tube("plastic.black", &grip, 0.006, 5));
    }
    m
}

/// Things on a worktop: jars, a board, a knife block, spoons.
pub fn worktop_things() -> Mesh {
    let mut m = all([
        rounded("wood.walnut", v(-0.2, -0.14, 0.0), v(0.16, 0.1, 0.02), 0.006, 1),
        rounded("wood.oak", v(-0.05, -0.06, 0.0), v(0.05, 0.06, 0.2), 0.008, 1)
            .tipped(8.0)
            .at(0.42, 0.1, 0.008),
        ball("fruit.apple", 0.036, 8).at(-0.08, -0.02, 0.055),
        ball("fruit.lime", 0.03, 8).at(0.02, 0.03, 0.05),
    ]);
    for k in 0..3 {
        let x = -0.42 + 0.13 * f64::from(k);
        let h = 0.19 - 0.03 * f64::from(k);
        m.add(
            lathe(
                "ceramic.white",
                &[
                    (0.0, 0.0),
                    (0.048, 0.0),
                    (0.052, 0.01),
                    (0.052, h - 0.03),
                    (0.045, h - 0.012),
                    (0.0, h - 0.012),
                ],
                8,
            )
            .at(x, 0.14, 0.0),
        );
        m.add(cylinder("wood.oak", 0.047, 0.02, 8).at(x, 0.14, h - 0.011));
    }
    m.add(
        lathe(
            "ceramic.blue",
            &[(0.0, 0.0), (0.05, 0.0), (0.058, 0.12), (0.055, 0.122), (0.047, 0.01), (0.0, 0.01)],
            8,
        )
        .at(0.27, 0.14, 0.0),
    );
    for k in 0..5 {
        let (s, c) = sin_cos(TAU * f64::from(k) / 5.0);
        m.add(rod(
            "wood.birch",
            &[v(0.27, 0.14, 0.012), v(0.27 + 0.05 * c, 0.14 + 0.05 * s, 0.29)],
            |t| 0.006 + 0.012 * (t - 0.8).max(0.0),
            5,
        ));
    }
    m
}

/// A bathtub, its back (with the tap) to +y and its long side along x.
pub fn bathtub() -> Mesh {
    let (x, y) = (0.85, 0.38);
    let mut m = bowl("ceramic.white", x, y, 0.44, 5.0).at(0.0, 0.0, 0.575);
    // An apron around it.
    let skirt =
        [(0.93, 0.0), (0.985, 0.0), (0.995, 0.28), (0.998, 0.562), (0.955, 0.562), (0.94, 0.28)];
    m.add(bands("ceramic.white", &superellipse(x, y, 5.0, 40), &skirt, true));
    m.add(tap("metal.chrome", 0.17, 0.16).at(0.0, y - 0.03, 0.578));
    m.add(cylinder("metal.chrome", 0.03, 0.006, 9).at(0.5, 0.0, 0.14));
    let hose =
        curve(&[v(0.12, y - 0.03, 0.578), v(0.2, y - 0.05, 0.66), v(0.28, y - 0.02, 0.6)], 4);
    m.add(tube("metal.chrome", &hose, 0.007, 5));
    m
}

/// A washbasin in a cabinet.
pub fn washbasin(front: Paint, width: f64) -> Mesh {
    let (w, d) = (width / 2.0, 0.24);
    let mut m = drawers(front, "metal.chrome", (width - 0.02, 0.44, 0.5), 2).at(0.0, 0.02, 0.28);
    let (x, y0, y1) = (w - 0.09, -0.17, 0.13);
    for (a, b) in [
        (v(-w, -d, 0.782), v(w, y0, 0.83)),
        (v(-w, y1, 0.782), v(w, d, 0.83)),
        (v(-w, y0, 0.782), v(-x, y1, 0.83)),
        (v(x, y0, 0.782), v(w, y1, 0.83)),
    ] {
        m.add(rounded("ceramic.white", a, b, 0.004, 1));
    }
    m.add(bowl("ceramic.white", x + 0.02, (y1 - y0) / 2.0 + 0.02, 0.1, 3.4).at(
        0.0,
        (y0 + y1) / 2.0,
        0.8315,
    ));
    m.add(tap("metal.chrome", 0.13, 0.15).at(0.0, 0.18, 0.831));
    m
}

/// A toilet with a cistern.
pub fn toilet() -> Mesh {
    let mut m = bowl("ceramic.white", 0.19, 0.24, 0.17, 2.4).at(0.0, -0.12, 0.4);
    // The foot narrows below the bowl.
    let outline = superellipse(0.19, 0.24, 2.4, 20);
    let foot = [
        (0.0, 0.001),
        (0.6, 0.0),
        (0.62, 0.02),
        (0.5, 0.1),
        (0.56, 0.2),
        (0.8, 0.33),
        (0.0, 0.331),
    ];
    m.add(bands("ceramic.white", &outline, &foot, false).at(0.0, -0.12, 0.0));
    // Seat: a flat ring, and the lid that leans on the cistern.
    let seat = [(0.66, 0.0), (1.02, 0.0), (1.03, 0.01), (0.98, 0.02), (0.68, 0.02)];
    m.add(bands("plastic.white", &outline, &seat, true).at(0.0, -0.12, 0.408));
    m.add(
        top("plastic.white", &superellipse(0.19, 0.23, 2.4, 20), 0.0, 0.02)
            .tipped(97.0)
            .at(0.0, 0.1, 0.66),
    );
    m.add(rounded("ceramic.white", v(-0.2, 0.14, 0.38), v(0.2, 0.32, 0.76), 0.02, 1));
    m.add(rounded("ceramic.white", v(-0.21, 0.13, 0.761), v(0.21, 0.325, 0.795), 0.012, 1));
    m.add(cylinder("metal.chrome", 0.025, 0.008, 9).at(0.0, 0.23, 0.7955));
    m
}

/// A wall-hung paper holder, its wall at y = 0, its roll around z = 0.
pub fn paper_roll() -> Mesh {
    let mut m = tube(
        "metal.chrome",
        &[v(-0.08, 0.0, 0.0), v(-0.08, -0.07, 0.0), v(0.07, -0.07, 0.0)],
        0.006,
        5,
    );
    m.add(cylinder("paper", 0.052, 0.1, 10).rolled(90.0).at(-0.05, -0.07, 0.0));
    m.add(plate("paper", (1, 4), 0.0012, |a, b| v(-0.05 + 0.1 * a, -0.124, -0.16 + 0.15 * b)));
    m
}

/// A heated rail with towels, its wall at y = 0.
pub fn towel_rail(towel: Paint) -> Mesh {
    let mut m = Mesh::new();
    for s in [-1.0, 1.0] {
        m.add(tube("metal.chrome", &[v(0.24 * s, -0.06, 0.0), v(0.24 * s, -0.06, 1.1)], 0.012, 5));
        for z in [0.1, 1.0] {
            m.add(tube("metal.chrome", &[v(0.24 * s, -0.048, z), v(0.24 * s, 0.0, z)], 0.008, 5));
        }
    }
    for k in 0..12 {
        let z = 0.06 + 0.09 * f64::from(k);
        m.add(tube("metal.chrome", &[v(-0.24, -0.06, z), v(0.24, -0.06, z)], 0.008, 5));
    }
    for (z, paint) in [(0.96, towel), (0.42, "fabric.white")] {
        m.add(plate(paint, (6, 10), 0.008, |a, b| {
            // Over the rail: down the front, across the bar, down the back.
            let s = (b - 0.5) * 0.8;
            let bend = 0.025;
            let x = -0.19 + 0.38 * a;
            let wave = 0.004 * libm::sin(14.0 * x + 3.0 * s);
            let (y, h) = if s.abs() < bend {
                let (sn, cs) = sin_cos(s / bend * std::f64::consts::FRAC_PI_2);
                (0.02 * sn, 0.016 * cs)
            } else {
                (0.02 * s.signum(), -(s.abs() - bend) * if s > 0.0 { 0.7 } else { 1.0 })
            };
            v(x, -0.06 + y + wave, z + 0.012 + h)
        }));
    }
    m
}

/// A glass shower corner with a tray; the walls are at +x and +y.
pub fn shower() -> Mesh {
    let mut m = rounded("ceramic.white", v(-0.45, -0.45, 0.0), v(0.45, 0.45, 0.06), 0.015, 1);
    m.add(cylinder("metal.chrome", 0.045, 0.006, 10).at(0.0, 0.0, 0.0605));
    // Screens to -x and -y with slender posts; the front one leaves a gap to enter.
    for (a, b) in [((-0.43, -0.43), (-0.43, 0.44)), ((-0.43, -0.43), (-0.02, -0.43))] {
        m.add(sheet("glass.pane", (2, 3), (false, false), |s, t| {
            v(a.0 + (b.0 - a.0) * s, a.1 + (b.1 - a.1) * s, 0.07 + 1.92 * t)
        }));
    }
    for (x, y) in [(-0.43, -0.43), (-0.43, 0.43), (-0.02, -0.43)] {
        m.add(soft("metal.chrome", 0.024, 0.024, 1.95, 0.005, 1).at(x, y, 0.06));
    }
    m.add(tube("metal.chrome", &[v(0.0, 0.4, 0.9), v(0.0, 0.4, 2.0)], 0.011, 5));
    let arm = curve(&[v(0.0, 0.4, 2.0), v(0.0, 0.36, 2.08), v(0.0, 0.12, 2.09)], 2);
    m.add(tube("metal.chrome", &arm, 0.011, 5));
    m.add(
        lathe(
            "metal.chrome",
            &[(0.0, 0.0), (0.1, 0.0), (0.103, 0.006), (0.02, 0.02), (0.0, 0.04)],
            12,
        )
        .at(0.0, 0.12, 2.055),
    );
    m.add(rounded("metal.chrome", v(-0.13, 0.385, 1.05), v(0.13, 0.43, 1.09), 0.012, 1));
    m
}

/// A cubicle wall with feet: `long` along y.
pub fn cubicle_wall(paint: Paint, long: f64) -> Mesh {
    let mut m = rounded(paint, v(-0.015, -long / 2.0, 0.15), v(0.015, long / 2.0, 2.0), 0.006, 1);
    for s in [-1.0, 1.0] {
        m.add(cylinder("metal.chrome", 0.016, 0.151, 8).at(0.0, (long / 2.0 - 0.08) * s, 0.0));
    }
    m
}

/// A washing machine.
pub fn washing_machine() -> Mesh {
    let mut m = soft("lacquer.white", 0.6, 0.58, 0.85, 0.012, 1);
    let face = |m: Mesh| m.tipped(90.0);
    m.add(face(ring("metal.chrome", 0.17, 0.022, 24, 7)).at(0.0, -0.296, 0.42));
    m.add(
        face(lathe(
            "screen",
            &[(0.0, 0.0), (0.155, 0.0), (0.15, 0.012), (0.08, 0.03), (0.0, 0.034)],
            14,
        ))
        .at(0.0, -0.2905, 0.42),
    );
    m.add(rounded("plastic.grey", v(-0.27, -0.297, 0.71), v(0.27, -0.2905, 0.82), 0.003, 1));
    m.add(face(cylinder("metal.steel", 0.03, 0.02, 10)).at(0.14, -0.2975, 0.765));
    m
}

/// A bucket with a mop.
pub fn mop_bucket() -> Mesh {
    let mut m = lathe(
        "lacquer.red",
        &[
            (0.0, 0.0),
            (0.12, 0.0),
            (0.125, 0.006),
            (0.155, 0.27),
            (0.162, 0.275),
            (0.15, 0.275),
            (0.12, 0.012),
            (0.0, 0.01),
        ],
        18,
    );
    m.add(tube("wood.birch", &[v(-0.03, 0.0, 0.1), v(0.12, 0.09, 1.35)], 0.012, 5));
    for k in 0..14 {
        let (s, c) = sin_cos(TAU * f64::from(k) / 14.0);
        let strand = curve(
            &[
                v(-0.03, 0.0, 0.13),
                v(-0.03 + 0.05 * c, 0.05 * s, 0.1),
                v(-0.03 + 0.075 * c, 0.075 * s, 0.03),
            ],
            1,
        );
        m.add(tube("fabric.cream", &strand, 0.009, 5));
    }
    m
}
