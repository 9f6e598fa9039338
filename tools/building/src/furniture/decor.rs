//! What makes a room lived in: plants, lamps that are off, pictures, rugs, screens, clutter.

use crate::mesh::{
    Mesh, Paint, all, ball, block, cuboid, curve, cylinder, lathe, plate, radians, ring, rod,
    rounded, sheet, sin_cos, soft, superellipse, top, tube, v,
};
use crate::rng::Rng;
use std::f64::consts::{PI, TAU};

/// A pot with soil; its rim is at `height`.
pub fn pot(paint: Paint, radius: f64, height: f64) -> Mesh {
    let r = radius;
    let mut m = lathe(
        paint,
        &[
            (0.0, 0.0),
            (r * 0.7, 0.0),
            (r * 0.74, 0.01),
            (r * 0.95, height - 0.04),
            (r, height - 0.035),
            (r, height - 0.004),
            (r - 0.006, height),
            (r - 0.016, height - 0.004),
            (r - 0.018, height - 0.035),
            (0.0, height - 0.035),
        ],
        10,
    );
    m.add(lathe(
        "soil",
        &[
            (0.0, height - 0.034),
            (r - 0.019, height - 0.034),
            (r * 0.5, height - 0.022),
            (0.0, height - 0.018),
        ],
        8,
    ));
    m
}

/// One leaf: a sheet from the origin along +x that droops, with a fold along its middle.
fn leaf(paint: Paint, length: f64, width: f64, droop: f64, n: usize) -> Mesh {
    sheet(paint, (n, 2), (false, false), |a, b| {
        let side = 2.0 * b - 1.0;
        let bow = libm::sin(PI * (0.06 + 0.94 * a).min(1.0)).max(0.001).sqrt();
        let half = width / 2.0 * bow * (1.0 - 0.35 * a);
        let z = length * (0.25 * a - droop * a * a) + side.abs() * half * 0.35;
        v(length * a, side * half, z)
    })
}

/// A rubber tree: stems with broad leaves.
pub fn rubber_tree(pot_paint: Paint, height: f64, leaves: usize, mut rng: Rng) -> Mesh {
    let mut m = pot(pot_paint, 0.19, 0.34);
    let stems = 3;
    for s in 0..stems {
        let turn = 120.0 * f64::from(s) + rng.around(25.0);
        let (sn, cs) = sin_cos(radians(turn));
        let tall = height * rng.range(0.82, 1.0);
        let lean = rng.range(0.06, 0.16);
        let path = curve(
            &[
                v(0.03 * cs, 0.03 * sn, 0.3),
                v(0.05 * cs, 0.06 * sn, tall * 0.5),
                v(lean * cs, lean * sn, tall * 0.94),
            ],
            3,
        );
        m.add(rod("bark", &path, |t| 0.013 - 0.007 * t, 5));
        let each = leaves / stems as usize;
        for k in 0..each {
            let t = 0.22 + 0.78 * (k as f64 + rng.unit() * 0.6) / each as f64;
            let p = path[((path.len() - 1) as f64 * t.min(1.0)) as usize];
            let angle = 137.5 * k as f64 + turn + rng.around(18.0);
            let size = rng.range(0.17, 0.26) * (1.15 - 0.45 * t);
            let paint = if rng.unit() < 0.65 { "leaf.dark" } else { "leaf.green" };
            let blade = leaf(paint, size, size * 0.5, rng.range(0.2, 0.6), 4);
            let lift = rng.range(5.0, 42.0) * (0.5 + t * 0.6);
            m.add(blade.rolled(-lift).turned(angle).at(p.x, p.y, p.z));
        }
    }
    m
}

/// A palm with arched fronds of many leaflets.
pub fn palm(pot_paint: Paint, height: f64, fronds: usize, mut rng: Rng) -> Mesh {
    let mut m = pot(pot_paint, 0.2, 0.36);
    for f in 0..fronds {
        let turn = 360.0 * f as f64 / fronds as f64 * 2.618 + rng.around(14.0);
        let reach = rng.range(0.3, 0.56);
        let tall = height * rng.range(0.7, 1.0);
        let path = curve(
            &[
                v(0.0, 0.0, 0.32),
                v(reach * 0.16, 0.0, tall * 0.62),
                v(reach * 0.55, 0.0, tall * 0.95),
                v(reach, 0.0, tall * 0.86),
            ],
            2,
        );
        let mut frond = rod("leaf.green", &path, |t| 0.008 - 0.006 * t, 4);
        let count = 11;
        let paint = if rng.unit() < 0.6 { "leaf.green" } else { "leaf.light" };
        for k in 0..count {
            let t = 0.42 + 0.58 * f64::from(k) / f64::from(count);
            let p = path[((path.len() - 1) as f64 * t) as usize];
            let long =
                0.26 * libm::sin(PI * (0.2 + 0.75 * (t - 0.42) / 0.58)) * rng.range(0.85, 1.1);
            for side in [-1.0, 1.0] {
                let blade = leaf(paint, long, 0.03, rng.range(0.35, 0.7), 2);
                frond.add(blade.turned(side * rng.range(42.0, 60.0)).at(p.x, p.y, p.z));
            }
        }
        m.add(frond.turned(turn));
    }
    m
}

/// Upright sword-like leaves in a low pot.
pub fn snake_plant(pot_paint: Paint, leaves: usize, mut rng: Rng) -> Mesh {
    let mut m = pot(pot_paint, 0.15, 0.26);
    for k in 0..leaves {
        let (sn, cs) = sin_cos(radians(137.5 * k as f64));
        let r = 0.1 * ((k as f64 + 0.5) / leaves as f64).sqrt();
        let tall = rng.range(0.4, 0.75);
        let twist = rng.around(1.2);
        let lean = rng.range(0.0, 0.16);
        let start = rng.range(0.0, TAU);
        let paint = if k % 3 == 0 { "leaf.light" } else { "leaf.dark" };
        m.add(plate(paint, (1, 5), 0.004, |a, b| {
            let half = 0.03 * (1.0 - b * b) * (0.75 + b * 0.5) + 0.0015;
            let (s, c) = sin_cos(start + twist * b);
            let x = (2.0 * a - 1.0) * half;
            let cup = 0.3 * x * x / 0.03;
            v(
                r * cs + x * c - cup * s + lean * b * b * cs,
                r * sn + x * s + cup * c + lean * b * b * sn,
                0.22 + tall * b,
            )
        }));
    }
    m
}

/// A small plant for a desk or a sill.
pub fn pot_plant(pot_paint: Paint, mut rng: Rng) -> Mesh {
    let mut m = pot(pot_paint, 0.07, 0.12);
    for k in 0..24 {
        let angle = 137.5 * f64::from(k);
        let t = f64::from(k) / 24.0;
        let size = rng.range(0.08, 0.13);
        let blade = leaf(
            if k % 4 == 0 { "leaf.light" } else { "leaf.green" },
            size,
            size * 0.42,
            rng.range(0.2, 0.8),
            3,
        );
        m.add(blade.rolled(-70.0 * t - 5.0).turned(angle).at(0.0, 0.0, 0.105 + 0.03 * t));
    }
    m
}

/// A floor lamp that is off: foot, stem and a cloth shade.
pub fn floor_lamp(metal: Paint, shade: Paint) -> Mesh {
    let mut m = lathe(
        metal,
        &[(0.0, 0.0), (0.14, 0.0), (0.145, 0.008), (0.13, 0.018), (0.02, 0.03), (0.0, 0.03)],
        10,
    );
    m.add(tube(metal, &[v(0.0, 0.0, 0.029), v(0.0, 0.0, 1.42)], 0.011, 6));
    m.add(drum(shade, 0.15, 0.21, 0.3).at(0.0, 0.0, 1.32));
    m.add(ball("ceramic.white", 0.035, 8).at(0.0, 0.0, 1.46));
    m
}

/// A lampshade: a thin closed wall between two radii.
fn drum(paint: Paint, upper: f64, lower: f64, height: f64) -> Mesh {
    let segments = 18;
    sheet(paint, (segments, 6), (true, true), |u, t| {
        // Around the profile: outside up, inside down.
        let ring = [
            (lower, 0.0),
            (lower * 0.5 + upper * 0.5, 0.5),
            (upper, 1.0),
            (upper - 0.004, 1.0),
            ((lower + upper) / 2.0 - 0.004, 0.5),
            (lower - 0.004, 0.0),
        ];
        let (r, z) = ring[libm::round(t * 6.0) as usize % 6];
        let (s, c) = sin_cos(TAU * u);
        v(r * c, r * s, z * height)
    })
}

/// An arc lamp that reaches over a table.
pub fn arc_lamp() -> Mesh {
    let mut m = soft("stone.dark", 0.34, 0.34, 0.07, 0.015, 1);
    let path = curve(
        &[
            v(0.0, 0.0, 0.069),
            v(0.0, 0.0, 1.1),
            v(0.0, -0.28, 1.72),
            v(0.0, -0.8, 1.95),
            v(0.0, -1.2, 1.78),
        ],
        5,
    );
    m.add(tube("metal.chrome", &path, 0.012, 5));
    let dome = lathe(
        "metal.chrome",
        &[
            (0.0, 0.0),
            (0.05, -0.004),
            (0.12, -0.04),
            (0.17, -0.1),
            (0.19, -0.17),
            (0.194, -0.17),
            (0.174, -0.097),
            (0.123, -0.034),
            (0.05, 0.003),
            (0.0, 0.007),
        ],
        14,
    );
    m.add(flip_if_inward(dome).at(0.0, -1.2, 1.78));
    m
}

/// Turns a closed mesh the right way round.
fn flip_if_inward(mut m: Mesh) -> Mesh {
    if m.volume() < 0.0 {
        for t in &mut m.triangles {
            t.corners.swap(1, 2);
        }
    }
    m
}

/// A table lamp that is off.
pub fn table_lamp(body: Paint, shade: Paint) -> Mesh {
    let mut m = lathe(
        body,
        &[
            (0.0, 0.0),
            (0.07, 0.0),
            (0.075, 0.01),
            (0.05, 0.03),
            (0.055, 0.07),
            (0.085, 0.13),
            (0.075, 0.19),
            (0.03, 0.24),
            (0.015, 0.27),
            (0.012, 0.33),
            (0.0, 0.33),
        ],
        8,
    );
    m.add(drum(shade, 0.1, 0.15, 0.2).at(0.0, 0.0, 0.28));
    m.add(ball("ceramic.white", 0.028, 8).at(0.0, 0.0, 0.36));
    m
}

/// A jointed desk lamp.
pub fn desk_lamp(paint: Paint) -> Mesh {
    let mut m = cylinder(paint, 0.09, 0.022, 14);
    m.add(tube(paint, &[v(0.0, 0.0, 0.02), v(0.1, 0.0, 0.24)], 0.009, 5));
    m.add(ball(paint, 0.017, 8).at(0.1, 0.0, 0.24));
    m.add(tube(paint, &[v(0.1, 0.0, 0.24), v(-0.12, 0.0, 0.42)], 0.008, 5));
    m.add(ball(paint, 0.015, 8).at(-0.12, 0.0, 0.42));
    let head = lathe(
        paint,
        &[
            (0.0, -0.1),
            (0.065, -0.1),
            (0.07, -0.096),
            (0.045, -0.03),
            (0.02, 0.0),
            (0.02, 0.03),
            (0.0, 0.035),
        ],
        8,
    );
    m.add(head.rolled(25.0).at(-0.14, 0.0, 0.42));
    m
}

/// A framed picture with an abstract landscape, to hang on a wall; its middle is at z = 0.
pub fn picture(frame: Paint, colours: [Paint; 3], width: f64, height: f64, mut rng: Rng) -> Mesh {
    let (w, h, bar) = (width / 2.0, height / 2.0, 0.03);
    let mut m = all([
        cuboid(frame, v(-w, -0.024, -h), v(w, 0.0, -h + bar)),
        cuboid(frame, v(-w, -0.024, h - bar), v(w, 0.0, h)),
        cuboid(frame, v(-w, -0.024, -h + bar), v(-w + bar, 0.0, h - bar)),
        cuboid(frame, v(w - bar, -0.024, -h + bar), v(w, 0.0, h - bar)),
        cuboid("paper", v(-w + bar, -0.01, -h + bar), v(w - bar, -0.001, h - bar)),
    ]);
    let (a, b) = (w - bar - 0.07_f64.min(width * 0.1), h - bar - 0.07_f64.min(height * 0.1));
    let mut low = [-b; 17];
    for (k, paint) in colours.into_iter().enumerate() {
        let level = -b + 2.0 * b * (k as f64 + 1.0) / 3.0;
        let (f, p, s) = (rng.range(2.0, 5.0), rng.range(0.0, TAU), rng.range(0.03, 0.09) * height);
        let mut high = [b; 17];
        if k < 2 {
            for (i, z) in high.iter_mut().enumerate() {
                *z = (level + s * libm::sin(f * i as f64 / 16.0 + p)).clamp(low[i] + 0.01, b);
            }
        }
        m.add(sheet(paint, (16, 1), (false, false), |u, t| {
            let i = libm::round(u * 16.0) as usize;
            v(a * (2.0 * u - 1.0), -0.0112, low[i] + (high[i] - low[i]) * t)
        }));
        low = high;
    }
    m
}

/// A framed mirror; its middle is at z = 0.
pub fn mirror(frame: Paint, width: f64, height: f64) -> Mesh {
    let (w, h, bar) = (width / 2.0, height / 2.0, 0.035);
    all([
        rounded(frame, v(-w, -0.03, -h), v(w, 0.0, -h + bar), 0.008, 1),
        rounded(frame, v(-w, -0.03, h - bar), v(w, 0.0, h), 0.008, 1),
        rounded(frame, v(-w, -0.03, -h + bar), v(-w + bar, 0.0, h - bar), 0.008, 1),
        rounded(frame, v(w - bar, -0.03, -h + bar), v(w, 0.0, h - bar), 0.008, 1),
        cuboid(frame, v(-w + bar, -0.01, -h + bar), v(w - bar, -0.001, h - bar)),
        sheet("mirror", (4, 4), (false, false), |a, b| {
            v((w - bar) * (2.0 * a - 1.0), -0.0105, (h - bar) * (2.0 * b - 1.0))
        }),
    ])
}

/// A rug with a border and stripes, `width` along x.
pub fn rug(
    ground: Paint,
    border: Paint,
    stripe: Paint,
    width: f64,
    depth: f64,
    mut rng: Rng,
) -> Mesh {
    let (nx, ny) = (12, 9);
    let waves = [rng.range(0.0, TAU), rng.range(0.0, TAU)];
    let mut m = plate(ground, (nx, ny), 0.008, |a, b| {
        let (x, y) = ((a - 0.5) * width, (b - 0.5) * depth);
        let ripple = 0.0012 * libm::sin(2.3 * x + waves[0]) * libm::sin(3.1 * y + waves[1]);
        v(x + 0.006 * libm::sin(3.0 * y), y + 0.005 * libm::sin(2.0 * x), 0.0105 + ripple)
    });
    // Paint by cell: triangles of the upper side come first in each pair of quads.
    for (k, t) in m.triangles.iter_mut().enumerate() {
        let cell = k / 4;
        let (i, j) = (cell % nx, cell / nx);
        if j < ny {
            let edge = i.min(nx - 1 - i).min(j.min(ny - 1 - j));
            t.paint = match edge {
                0 | 2 => border,
                1 | 3 => ground,
                _ => stripe,
            };
        }
    }
    m
}

/// A round rug.
pub fn round_rug(ground: Paint, border: Paint, radius: f64) -> Mesh {
    let mut m = lathe(
        ground,
        &[
            (0.0, 0.002),
            (radius - 0.004, 0.002),
            (radius, 0.006),
            (radius - 0.004, 0.0105),
            (radius * 0.9, 0.011),
            (radius * 0.6, 0.011),
            (radius * 0.5, 0.011),
            (0.0, 0.011),
        ],
        24,
    );
    for t in &mut m.triangles {
        let far =
            t.corners.iter().map(|&c| m.points[c as usize].truncate().length()).fold(0.0, f64::max);
        if far > radius * 0.91 || (far > radius * 0.55 && far < radius * 0.65) {
            t.paint = border;
        }
    }
    m
}

/// A vase with a narrow neck.
pub fn vase(paint: Paint, height: f64) -> Mesh {
    let h = height;
    lathe(
        paint,
        &[
            (0.0, 0.0),
            (0.2 * h, 0.0),
            (0.24 * h, 0.03 * h),
            (0.34 * h, 0.3 * h),
            (0.33 * h, 0.5 * h),
            (0.2 * h, 0.75 * h),
            (0.12 * h, 0.88 * h),
            (0.15 * h, 0.99 * h),
            (0.14 * h, h),
            (0.1 * h, 0.9 * h),
            (0.17 * h, 0.74 * h),
            (0.0, 0.6 * h),
        ],
        8,
    )
}

/// A vase with tulips.
pub fn flowers(paint: Paint, bloom: Paint, mut rng: Rng) -> Mesh {
    let mut m = vase(paint, 0.2);
    for k in 0..6 {
        let (s, c) = sin_cos(radians(60.0 * f64::from(k) + rng.around(12.0)));
        let (out, up) = (rng.range(0.03, 0.12), rng.range(0.32, 0.44));
        let path = curve(
            &[v(0.0, 0.0, 0.13), v(out * 0.3 * c, out * 0.3 * s, 0.25), v(out * c, out * s, up)],
            2,
        );
        m.add(tube("leaf.green", &path, 0.003, 3));
        m.add(
            lathe(
                bloom,
                &[
                    (0.0, 0.0),
                    (0.012, 0.003),
                    (0.021, 0.018),
                    (0.02, 0.034),
                    (0.013, 0.048),
                    (0.009, 0.044),
                    (0.0, 0.02),
                ],
                6,
            )
            .at(out * c, out * s, up - 0.004),
        );
        let blade = leaf("leaf.green", 0.16, 0.028, 0.2, 4);
        m.add(blade.rolled(-58.0).turned(40.0 * f64::from(k) + 20.0).at(0.0, 0.0, 0.17));
    }
    m
}

/// A mug.
pub fn mug(paint: Paint) -> Mesh {
    let mut m = lathe(
        paint,
        &[
            (0.0, 0.0),
            (0.036, 0.0),
            (0.04, 0.004),
            (0.041, 0.09),
            (0.039, 0.092),
            (0.037, 0.09),
            (0.036, 0.012),
            (0.0, 0.01),
        ],
        8,
    );
    let handle = curve(
        &[v(0.04, 0.0, 0.075), v(0.066, 0.0, 0.07), v(0.068, 0.0, 0.035), v(0.04, 0.0, 0.02)],
        1,
    );
    m.add(tube(paint, &handle, 0.005, 5));
    m
}

/// A bowl of fruit.
pub fn fruit_bowl(paint: Paint, fruit: [Paint; 2], mut rng: Rng) -> Mesh {
    let mut m = lathe(
        paint,
        &[
            (0.0, 0.0),
            (0.06, 0.0),
            (0.065, 0.008),
            (0.11, 0.03),
            (0.15, 0.075),
            (0.155, 0.08),
            (0.148, 0.078),
            (0.105, 0.036),
            (0.05, 0.018),
            (0.0, 0.016),
        ],
        10,
    );
    for k in 0..7 {
        let (s, c) = sin_cos(TAU * f64::from(k) / 6.0);
        let (r, z) = if k == 6 { (0.0, 0.095) } else { (0.068, 0.066) };
        m.add(ball(fruit[k as usize % 2], rng.range(0.033, 0.037), 8).at(r * c, r * s, z));
    }
    m
}

/// A plate with cutlery; the eater is at -y.
pub fn place_setting() -> Mesh {
    let mut m = lathe(
        "ceramic.white",
        &[
            (0.0, 0.0),
            (0.07, 0.0),
            (0.08, 0.004),
            (0.13, 0.016),
            (0.132, 0.019),
            (0.128, 0.02),
            (0.08, 0.009),
            (0.0, 0.007),
        ],
        14,
    );
    for (x, w) in [(-0.17, 0.011), (0.165, 0.009), (0.19, 0.012)] {
        m.add(cuboid("metal.chrome", v(x - 0.004, -0.1, 0.0), v(x + 0.004, 0.02, 0.004)));
        m.add(cuboid("metal.chrome", v(x - w, 0.021, 0.0005), v(x + w, 0.085, 0.0035)));
    }
    m.add(
        lathe(
            "ceramic.blue",
            &[
                (0.0, 0.0),
                (0.028, 0.0),
                (0.036, 0.085),
                (0.034, 0.085),
                (0.027, 0.006),
                (0.0, 0.005),
            ],
            14,
        )
        .at(0.15, 0.15, 0.0),
    );
    m
}

/// A flat screen on a foot, a keyboard and a mouse; the user is at -y.
pub fn computer() -> Mesh {
    let mut m = all([
        rounded("plastic.black", v(-0.29, 0.11, 0.12), v(0.29, 0.135, 0.47), 0.006, 1),
        cuboid("screen", v(-0.28, 0.1085, 0.132), v(0.28, 0.1095, 0.458)),
        rounded("plastic.black", v(-0.11, 0.06, 0.0), v(0.11, 0.24, 0.012), 0.005, 1),
        soft("plastic.black", 0.05, 0.03, 0.2, 0.008, 1).at(0.0, 0.155, 0.0115),
    ]);
    // A window with lines of text.
    for k in 0..9 {
        let wide = 0.1 + 0.09 * libm::sin(f64::from(k) * 2.4).abs();
        let z = 0.43 - 0.028 * f64::from(k);
        m.add(cuboid("screen.text", v(-0.25, 0.1072, z - 0.009), v(-0.25 + wide, 0.108, z)));
    }
    m.add(keyboard().at(0.0, -0.16, 0.0));
    m.add(
        rounded("plastic.black", v(-0.03, -0.05, 0.0), v(0.03, 0.05, 0.032), 0.015, 2)
            .at(0.3, -0.15, 0.001),
    );
    m
}

fn keyboard() -> Mesh {
    let mut m = rounded("plastic.grey", v(-0.215, -0.065, 0.001), v(0.215, 0.065, 0.014), 0.005, 1);
    for row in 0..3 {
        for k in 0..10 {
            if row == 0 && (2..7).contains(&k) {
                continue;
            }
            let (x, y) = (
                -0.2 + 0.0405 * f64::from(k) + 0.004 * f64::from(row % 2),
                -0.054 + 0.038 * f64::from(row),
            );
            m.add(cuboid("plastic.black", v(x, y, 0.0145), v(x + 0.035, y + 0.032, 0.02)));
        }
    }
    m.add(cuboid("plastic.black", v(-0.1, -0.054, 0.0145), v(0.07, -0.022, 0.02)));
    m
}

/// An open laptop; the user is at -y.
pub fn laptop(paint: Paint) -> Mesh {
    let mut m = rounded(paint, v(-0.16, -0.11, 0.0), v(0.16, 0.11, 0.014), 0.005, 1);
    for row in 0..3 {
        for k in 0..7 {
            let (x, y) = (-0.138 + 0.0398 * f64::from(k), 0.005 + 0.0287 * f64::from(row));
            m.add(cuboid("plastic.black", v(x, y, 0.0143), v(x + 0.034, y + 0.023, 0.0165)));
        }
    }
    m.add(cuboid("plastic.grey", v(-0.05, -0.085, 0.0143), v(0.05, -0.02, 0.015)));
    let mut lid = rounded(paint, v(-0.16, -0.004, 0.0), v(0.16, 0.004, 0.215), 0.003, 1);
    lid.add(cuboid("screen", v(-0.15, -0.0055, 0.012), v(0.15, -0.0045, 0.205)));
    for k in 0..5 {
        let z = 0.18 - 0.026 * f64::from(k);
        lid.add(cuboid(
            "screen.text",
            v(-0.13, -0.0066, z - 0.008),
            v(0.02 + 0.07 * libm::sin(f64::from(k)).abs(), -0.0058, z),
        ));
    }
    m.add(lid.tipped(-14.0).at(0.0, 0.112, 0.01));
    m
}

/// A few sheets of paper and a pencil.
pub fn papers(mut rng: Rng) -> Mesh {
    let mut m = Mesh::new();
    for k in 0..5 {
        m.add(block("paper", 0.21, 0.297, 0.0009).turned(rng.around(14.0)).at(
            rng.around(0.02),
            rng.around(0.02),
            0.0012 * f64::from(k),
        ));
    }
    let pencil = [v(-0.08, -0.05, 0.012), v(0.06, 0.04, 0.012)];
    m.add(rod("lacquer.yellow", &pencil, |_| 0.0036, 5));
    m
}

/// A pile of books lying down.
pub fn book_pile(count: usize, mut rng: Rng) -> Mesh {
    let mut m = Mesh::new();
    let mut z = 0.0;
    for _ in 0..count {
        let t = rng.range(0.018, 0.042);
        let (d, h) = (rng.range(0.13, 0.17), rng.range(0.19, 0.24));
        let b = crate::furniture::storage::book(rng.pick(crate::palette::BOOKS), t, d, h);
        m.add(b.at(0.0, -d / 2.0, -h / 2.0).rolled(90.0).turned(rng.around(20.0)).at(
            0.0,
            0.0,
            z + t / 2.0,
        ));
        z += t + 0.0006;
    }
    m
}

/// A radiator with ribs, to hang on a wall under a window; it stands 0.12 above the floor.
pub fn radiator(width: f64) -> Mesh {
    let mut m = Mesh::new();
    let n = (width / 0.2) as usize;
    for k in 0..n {
        let x = -width / 2.0 + width * (k as f64 + 0.5) / n as f64;
        m.add(rounded("lacquer.white", v(x - 0.09, -0.045, 0.1), v(x + 0.09, 0.03, 0.68), 0.02, 1));
    }
    for z in [0.15, 0.63] {
        m.add(cuboid(
            "lacquer.white",
            v(-width / 2.0 - 0.012, -0.02, z),
            v(width / 2.0 + 0.012, 0.005, z + 0.03),
        ));
    }
    m.add(tube(
        "metal.chrome",
        &[v(width / 2.0 - 0.03, -0.02, 0.0), v(width / 2.0 - 0.03, -0.02, 0.105)],
        0.009,
        5,
    ));
    for s in [-1.0, 1.0] {
        m.add(block("metal.steel", 0.02, 0.03, 0.1).at(s * width * 0.3, 0.047, 0.5));
    }
    m
}

/// One curtain that hangs from z = 0 down to `-drop`, gathered in `folds`.
fn drape(paint: Paint, width: f64, drop: f64, folds: f64, phase: f64) -> Mesh {
    let nu = (folds * 4.0) as usize;
    plate(paint, (nu, 2), 0.0022, |a, b| {
        let wave = libm::sin(TAU * folds * a + phase);
        let deep = 0.02 + 0.016 * (1.0 - b);
        v(
            width * (a - 0.5) + 0.006 * libm::sin(TAU * folds * 2.0 * a),
            deep * wave + 0.008 * libm::sin(9.0 * a + phase),
            -drop * (1.0 - b),
        )
    })
}

/// A pair of drawn-back curtains on a pole for a window of `width`; the pole is at z = 0, the
/// wall at y = 0.12.
pub fn curtains(paint: Paint, width: f64, drop: f64, mut rng: Rng) -> Mesh {
    let half = width / 2.0 + 0.22;
    let mut m =
        tube("metal.dark", &[v(-half - 0.06, 0.04, 0.0), v(half + 0.06, 0.04, 0.0)], 0.013, 5);
    for s in [-1.0, 1.0] {
        m.add(ball("metal.dark", 0.026, 8).at((half + 0.08) * s, 0.04, 0.0));
        m.add(tube(
            "metal.dark",
            &[v((half - 0.02) * s, 0.04, 0.0), v((half - 0.02) * s, 0.117, 0.0)],
            0.008,
            5,
        ));
        m.add(drape(paint, 0.34, drop, 4.5, rng.range(0.0, TAU)).at(
            (half - 0.14) * s,
            0.04,
            -0.015,
        ));
    }
    m
}

/// A white board with a tray and a drawing on it; its middle is at z = 0.
pub fn whiteboard(width: f64, height: f64) -> Mesh {
    let (w, h) = (width / 2.0, height / 2.0);
    let mut m = all([
        rounded("metal.steel", v(-w, -0.02, -h), v(w, 0.0, h), 0.006, 1),
        cuboid("lacquer.white", v(-w + 0.02, -0.0222, -h + 0.02), v(w - 0.02, -0.0203, h - 0.02)),
        rounded(
            "metal.steel",
            v(-w * 0.6, -0.08, -h - 0.03),
            v(w * 0.6, -0.001, -h - 0.005),
            0.006,
            1,
        ),
    ]);
    let line = |paint: Paint, from: f64, to: f64, f: &dyn Fn(f64) -> f64| {
        let path: Vec<_> = (0..=12)
            .map(|i| from + (to - from) * f64::from(i) / 12.0)
            .map(|x| v(x, -0.0235, f(x)))
            .collect();
        tube(paint, &path, 0.0045, 5)
    };
    m.add(line("lacquer.blue", -w * 0.8, -w * 0.1, &|x| 0.12 * libm::sin(7.0 * x) + 0.1));
    m.add(line("lacquer.red", -w * 0.8, -w * 0.1, &|x| 0.3 * x / w + 0.2));
    m.add(line("lacquer.green", w * 0.1, w * 0.8, &|x| {
        0.26 * libm::exp(-2.0 * (x - w * 0.1)) - 0.1
    }));
    m.add(line("plastic.black", -w * 0.85, -w * 0.05, &|_| -0.25));
    m.add(line("plastic.black", w * 0.08, w * 0.85, &|_| -0.25));
    for (k, p) in ["lacquer.blue", "lacquer.red", "lacquer.green"].into_iter().enumerate() {
        let x = -0.2 + 0.17 * k as f64;
        m.add(tube(p, &[v(x, -0.05, -h + 0.004), v(x + 0.12, -0.045, -h + 0.004)], 0.008, 5));
    }
    m
}

/// A wall clock; its middle is at z = 0.
pub fn clock(rim: Paint) -> Mesh {
    let mut m = lathe(
        rim,
        &[
            (0.0, 0.0),
            (0.15, 0.0),
            (0.155, 0.01),
            (0.155, 0.03),
            (0.145, 0.034),
            (0.14, 0.026),
            (0.0, 0.026),
        ],
        20,
    )
    .tipped(90.0);
    m.add(
        lathe("lacquer.white", &[(0.0, 0.0265), (0.138, 0.0265), (0.137, 0.028), (0.0, 0.028)], 20)
            .tipped(90.0),
    );
    for k in 0..12 {
        let mark = cuboid("plastic.black", v(-0.004, -0.0305, 0.112), v(0.004, -0.0284, 0.132));
        m.add(mark.rolled(30.0 * f64::from(k)));
    }
    for (turn, long, wide) in [(305.0, 0.075, 0.005), (60.0, 0.11, 0.0035)] {
        m.add(
            rounded("plastic.black", v(-wide, -0.034, -0.02), v(wide, -0.031, long), 0.001, 1)
                .rolled(turn),
        );
    }
    m
}

/// A globe on a wooden stand.
pub fn globe() -> Mesh {
    let mut m = lathe(
        "wood.walnut",
        &[
            (0.0, 0.0),
            (0.1, 0.0),
            (0.105, 0.012),
            (0.03, 0.03),
            (0.018, 0.06),
            (0.024, 0.09),
            (0.0, 0.095),
        ],
        10,
    );
    let mut sphere = ball("book.blue", 0.14, 14);
    for t in &mut sphere.triangles {
        let p =
            t.corners.iter().map(|&c| sphere.points[c as usize]).sum::<glam::DVec3>() / 3.0 / 0.14;
        let land = libm::sin(3.1 * p.x + 1.0)
            + libm::sin(4.2 * p.y + 2.0 * p.z)
            + libm::sin(2.7 * p.z - 3.0 * p.x);
        if land > 0.55 {
            t.paint = if p.z.abs() > 0.75 { "ceramic.white" } else { "book.olive" };
        }
    }
    m.add(sphere.rolled(23.4).at(0.0, 0.0, 0.25));
    let arc: Vec<_> = (0..=9)
        .map(|i| {
            let (s, c) = sin_cos(radians(-90.0 + 23.4 + 180.0 * f64::from(i) / 9.0));
            v(0.165 * c, 0.0, 0.25 + 0.165 * s)
        })
        .collect();
    m.add(tube("metal.brass", &arc, 0.007, 5));
    m
}

/// A waste-paper basket.
pub fn basket(paint: Paint) -> Mesh {
    lathe(
        paint,
        &[
            (0.0, 0.0),
            (0.11, 0.0),
            (0.115, 0.005),
            (0.145, 0.3),
            (0.148, 0.304),
            (0.142, 0.304),
            (0.112, 0.012),
            (0.0, 0.01),
        ],
        10,
    )
}

/// A coat stand with two coats.
pub fn coat_stand(mut rng: Rng) -> Mesh {
    let mut m = lathe(
        "wood.walnut",
        &[
            (0.0, 0.0),
            (0.2, 0.0),
            (0.205, 0.015),
            (0.05, 0.04),
            (0.026, 0.08),
            (0.022, 1.7),
            (0.03, 1.74),
            (0.0, 1.78),
        ],
        8,
    );
    for k in 0..6 {
        let hook = curve(
            &[v(0.015, 0.0, 1.58), v(0.08, 0.0, 1.6), v(0.13, 0.0, 1.66), v(0.13, 0.0, 1.7)],
            2,
        );
        m.add(rod("wood.walnut", &hook, |t| 0.012 - 0.004 * t, 5).turned(60.0 * f64::from(k)));
    }
    for (k, paint) in ["fabric.navy", "fabric.mustard"].into_iter().enumerate() {
        let (a, turn) = (rng.range(0.0, TAU), 60.0 + 180.0 * k as f64);
        let coat = sheet(paint, (26, 12), (true, false), |u, t| {
            let (s, c) = sin_cos(-TAU * u);
            let wide = 0.05 + 0.12 * (t * 4.0).min(1.0);
            let ripple = 1.0 + 0.12 * libm::sin(7.0 * TAU * u + a) * t;
            v(
                0.15 + 0.07 * (0.15 + t * 3.0).min(1.0) * c * ripple,
                wide * s * ripple,
                1.68 - 1.05 * t,
            )
        });
        m.add(coat.turned(turn));
    }
    m
}

/// A television on a low board.
pub fn television(width: f64) -> Mesh {
    let (w, h) = (width / 2.0, width * 0.565);
    all([
        rounded("plastic.black", v(-w, -0.02, 0.06), v(w, 0.025, 0.06 + h), 0.006, 1),
        cuboid("screen", v(-w + 0.012, -0.0222, 0.075), v(w - 0.012, -0.0205, 0.045 + h)),
        rounded("plastic.black", v(-0.2, -0.11, 0.0), v(0.2, 0.1, 0.014), 0.005, 1),
        soft("plastic.black", 0.09, 0.03, 0.06, 0.006, 1).at(0.0, 0.005, 0.0135),
    ])
}

/// A fireplace surround with logs, for a wall.
pub fn fireplace() -> Mesh {
    let mut m = all([
        rounded("stone.white", v(-0.75, -0.14, 0.0), v(-0.47, 0.0, 1.02), 0.012, 1),
        rounded("stone.white", v(0.47, -0.14, 0.0), v(0.75, 0.0, 1.02), 0.012, 1),
        rounded("stone.white", v(-0.469, -0.14, 0.78), v(0.469, 0.0, 1.02), 0.012, 1),
        rounded("stone.white", v(-0.84, -0.2, 1.021), v(0.84, 0.0, 1.075), 0.016, 2),
        rounded("stone.dark", v(-0.7, -0.5, 0.0), v(0.7, -0.141, 0.03), 0.008, 1),
        cuboid("stone.dark", v(-0.469, -0.02, 0.0), v(0.469, -0.001, 0.779)),
        rounded("metal.dark", v(-0.36, -0.13, 0.1), v(0.36, -0.11, 0.12), 0.005, 1),
    ]);
    for s in [-1.0, 1.0] {
        m.add(tube("metal.dark", &[v(0.25 * s, -0.12, 0.0), v(0.25 * s, -0.12, 0.24)], 0.012, 5));
        m.add(rounded("stone.white", v(-0.1, -0.02, 0.16), v(0.1, 0.0, 0.72), 0.006, 1).at(
            0.61 * s,
            -0.141,
            0.0,
        ));
    }
    for (k, (y, z)) in [(-0.06, 0.09), (-0.09, 0.17), (-0.055, 0.25)].into_iter().enumerate() {
        let t = 0.05 * (k as f64 - 1.0);
        m.add(tube("bark", &[v(-0.28, y, z + t * 0.3), v(0.28, y + 0.01, z - t * 0.3)], 0.042, 6));
    }
    m
}

/// A doll's house of shelves, balls and bricks: a toy corner on a mat.
pub fn toys(mut rng: Rng) -> Mesh {
    let paints: [Paint; 6] = [
        "lacquer.red",
        "lacquer.blue",
        "lacquer.yellow",
        "lacquer.green",
        "fabric.orange",
        "lacquer.white",
    ];
    let mut m = Mesh::new();
    for k in 0..14 {
        let (x, y) = (rng.around(0.4), rng.around(0.3));
        let turn = rng.range(0.0, 90.0);
        m.add(soft(paints[k % 6], 0.07, 0.07, 0.07, 0.008, 1).turned(turn).at(x, y, 0.0));
    }
    for k in 0..5 {
        let z = 0.02 + 0.045 * f64::from(k);
        m.add(
            ring(paints[k as usize], 0.085 - 0.013 * f64::from(k), 0.022, 14, 6).at(0.55, 0.1, z),
        );
    }
    m.add(cylinder("wood.birch", 0.012, 0.27, 8).at(0.55, 0.1, 0.0));
    m.add(ball("lacquer.red", 0.11, 11).at(-0.55, 0.2, 0.11));
    m
}

/// A rocking horse.
pub fn rocking_horse() -> Mesh {
    let mut m = Mesh::new();
    for s in [-1.0, 1.0] {
        let runner = curve(
            &[
                v(0.13 * s, -0.5, 0.14),
                v(0.13 * s, -0.25, 0.03),
                v(0.13 * s, 0.0, 0.014),
                v(0.13 * s, 0.25, 0.03),
                v(0.13 * s, 0.5, 0.14),
            ],
            3,
        );
        m.add(rod("lacquer.red", &runner, |_| 0.016, 5));
        for y in [-0.22, 0.22] {
            m.add(rod(
                "wood.birch",
                &[v(0.13 * s, y * 1.15, 0.045), v(0.08 * s, y, 0.42)],
                |t| 0.018 + 0.014 * t,
                5,
            ));
        }
    }
    m.add(ball("wood.birch", 0.14, 10).scaled(0.85, 2.2, 0.95).at(0.0, 0.0, 0.48));
    let neck = curve(&[v(0.0, -0.2, 0.5), v(0.0, -0.32, 0.68), v(0.0, -0.36, 0.82)], 3);
    m.add(rod("wood.birch", &neck, |t| 0.085 - 0.03 * t, 8));
    m.add(ball("wood.birch", 0.07, 8).scaled(0.8, 1.7, 0.9).tipped(28.0).at(0.0, -0.42, 0.81));
    m.add(tube("lacquer.red", &[v(-0.15, -0.36, 0.72), v(0.15, -0.36, 0.72)], 0.012, 5));
    m.add(soft("leather.brown", 0.2, 0.26, 0.05, 0.02, 1).at(0.0, 0.02, 0.6));
    for k in 0..7 {
        let t = f64::from(k) / 6.0;
        m.add(tube(
            "fabric.cream",
            &[
                v(0.0, -0.2 - 0.14 * t, 0.6 + 0.28 * t),
                v(0.03 * (t - 0.5), -0.1 - 0.14 * t, 0.56 + 0.26 * t),
            ],
            0.012,
            5,
        ));
    }
    m
}

/// A projector that hangs from a ceiling at z = 0.
pub fn projector() -> Mesh {
    let mut m = cylinder("lacquer.white", 0.06, 0.02, 10).at(0.0, 0.0, -0.022);
    m.add(tube("lacquer.white", &[v(0.0, 0.0, -0.021), v(0.0, 0.0, -0.3)], 0.016, 5));
    m.add(rounded("lacquer.white", v(-0.17, -0.14, -0.41), v(0.17, 0.14, -0.3), 0.025, 2));
    m.add(
        lathe(
            "plastic.black",
            &[(0.0, 0.0), (0.04, 0.0), (0.042, 0.03), (0.034, 0.034), (0.03, 0.02), (0.0, 0.014)],
            8,
        )
        .tipped(90.0)
        .at(0.08, -0.138, -0.355),
    );
    m
}

/// A bottle and glasses on a tray.
pub fn carafe() -> Mesh {
    let mut m = top("metal.steel", &superellipse(0.19, 0.13, 4.0, 20), 0.0, 0.012);
    m.add(
        lathe(
            "ceramic.green",
            &[
                (0.0, 0.0),
                (0.045, 0.0),
                (0.05, 0.01),
                (0.052, 0.13),
                (0.03, 0.18),
                (0.018, 0.2),
                (0.02, 0.26),
                (0.016, 0.262),
                (0.0, 0.24),
            ],
            8,
        )
        .at(-0.09, 0.02, 0.0125),
    );
    for (x, y) in [(0.03, 0.05), (0.11, 0.03), (0.04, -0.05), (0.12, -0.06)] {
        m.add(
            lathe(
                "ceramic.white",
                &[
                    (0.0, 0.0),
                    (0.026, 0.0),
                    (0.032, 0.1),
                    (0.03, 0.1),
                    (0.025, 0.008),
                    (0.0, 0.007),
                ],
                8,
            )
            .at(x, y, 0.0125),
        );
    }
    m
}
