//! Chairs, sofas, beds: whatever carries people.

use crate::mesh::{
    Mesh, Paint, Raised, all, ball, curve, cushion, cylinder, lathe, plate, radians, ring, rod,
    rounded, sin_cos, soft, tube, v,
};
use crate::rng::Rng;
use std::f64::consts::PI;

/// A straight leg from `foot` to `head`, thinner below.
fn leg(paint: Paint, foot: glam::DVec3, head: glam::DVec3, (low, high): (f64, f64)) -> Mesh {
    let path: Vec<_> = (0..=1).map(|i| foot.lerp(head, f64::from(i))).collect();
    rod(paint, &path, |s| low + (high - low) * s, 5)
}

/// A swivel chair on five castors, with arms.
pub fn office_chair(cloth: Paint, arms: bool) -> Mesh {
    let mut m = Mesh::new();
    for k in 0..5 {
        let turn = 72.0 * f64::from(k) + 18.0;
        let spoke = curve(&[v(0.03, 0.0, 0.12), v(0.16, 0.0, 0.105), v(0.3, 0.0, 0.075)], 3);
        let mut arm = rod("plastic.black", &spoke, |s| 0.026 - 0.01 * s, 5);
        let castor = [
            (0.0, -0.02),
            (0.024, -0.02),
            (0.028, -0.012),
            (0.028, 0.012),
            (0.024, 0.02),
            (0.0, 0.02),
        ];
        arm.add(
            lathe("rubber", &castor, if arms { 10 } else { 8 }).tipped(90.0).at(0.3, 0.0, 0.028),
        );
        m.add(arm.turned(turn));
    }
    m.add(cylinder("plastic.black", 0.034, 0.16, 8).at(0.0, 0.0, 0.09));
    m.add(cylinder("metal.chrome", 0.016, 0.2, 8).at(0.0, 0.0, 0.24));
    m.add(soft("plastic.black", 0.22, 0.2, 0.035, 0.012, 1).at(0.0, 0.01, 0.42));
    // The seat dips a little and rolls off at the front.
    m.add(
        cushion(
            cloth,
            v(0.49, 0.47, 0.075),
            0.034,
            0.006,
            if arms { 2 } else { 1 },
            if arms { 4 } else { 3 },
        )
        .map(|p| {
            let front = (-p.y - 0.12).max(0.0);
            v(p.x, p.y, p.z - front * front * 1.6 + p.x * p.x * 0.25)
        })
        .at(0.0, -0.01, 0.45),
    );
    // The back curves around the sitter and leans.
    let back = cushion(
        cloth,
        v(0.45, 0.055, 0.5),
        0.026,
        0.004,
        if arms { 2 } else { 1 },
        if arms { 6 } else { 3 },
    )
    .map(|p| {
        let s = (p.z / 0.5 - 0.35) * PI;
        v(
            p.x * (1.0 - 0.12 * (p.z / 0.5 - 0.4).raised(2)),
            p.y - p.x * p.x * 0.55 - 0.02 * libm::cos(s),
            p.z,
        )
    });
    m.add(back.tipped(-9.0).at(0.0, 0.235, 0.545));
    let spine = curve(
        &[v(0.0, 0.1, 0.435), v(0.0, 0.25, 0.44), v(0.0, 0.31, 0.56), v(0.0, 0.325, 0.74)],
        4,
    );
    m.add(rod("plastic.black", &spine, |_| 0.019, 5));
    if arms {
        for s in [-1.0, 1.0] {
            let post = curve(
                &[
                    v(0.1 * s, 0.03, 0.44),
                    v(0.26 * s, 0.03, 0.445),
                    v(0.285 * s, 0.03, 0.52),
                    v(0.285 * s, 0.03, 0.655),
                ],
                4,
            );
            m.add(rod("plastic.black", &post, |_| 0.015, 5));
            m.add(
                rounded("plastic.black", v(-0.035, -0.13, 0.0), v(0.035, 0.12, 0.028), 0.012, 3)
                    .at(0.285 * s, 0.0, 0.652),
            );
        }
    }
    m
}

/// A moulded shell on four wooden legs.
pub fn shell_chair(shell: Paint, wood: Paint) -> Mesh {
    let seat = plate(shell, (6, 10), 0.009, |a, b| {
        // b runs from the front edge over the seat and up the back; a from left to right.
        let side = 2.0 * a - 1.0;
        let (y, z) = if b < 0.5 {
            let t = b / 0.5;
            (-0.21 + 0.36 * t, 0.445 - 0.035 * libm::sin(t * PI * 0.8) - 0.03 * (1.0 - t).raised(4))
        } else {
            let t = (b - 0.5) / 0.5;
            let bend = sin_cos(t.min(0.35) / 0.35 * PI * 0.46);
            (
                0.15 + 0.055 * bend.0 + 0.075 * t,
                0.4245 + 0.09 * (1.0 - bend.1) + 0.33 * (t - 0.2).max(0.0) * 1.2,
            )
        };
        let half = 0.235 - 0.05 * (2.0 * b - 1.1).abs().raised(3) - 0.015 * b;
        let curl = side * side * (0.035 + 0.02 * (1.0 - (2.0 * b - 1.0).abs()));
        let (dy, dz) =
            if b < 0.5 { (0.0, curl) } else { (-curl * (b - 0.5) * 2.6, curl * (1.0 - b) * 1.6) };
        v(side * half, y + dy, z + dz)
    });
    let mut m = seat;
    for (sx, sy) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        m.add(leg(
            wood,
            v(0.22 * sx, 0.21 * sy, 0.0),
            v(0.12 * sx, 0.12 * sy - 0.01, 0.4),
            (0.011, 0.017),
        ));
    }
    for (a, b) in [((-1.0, -1.0), (1.0, 1.0)), ((1.0, -1.0), (-1.0, 1.0))] {
        let at = |(x, y): (f64, f64), s: f64, z: f64| v(0.12 * x * s, 0.12 * y * s - 0.01, z);
        m.add(tube(
            "metal.dark",
            &[at(a, 1.25, 0.26), at(a, 0.3, 0.385), at(b, 0.3, 0.385), at(b, 1.25, 0.26)],
            0.005,
            5,
        ));
    }
    m
}

/// A wooden dining chair with a slatted back and an upholstered seat.
pub fn slat_chair(wood: Paint, cloth: Paint) -> Mesh {
    let mut m = Mesh::new();
    for s in [-1.0, 1.0] {
        m.add(leg(wood, v(0.195 * s, -0.19, 0.0), v(0.19 * s, -0.185, 0.44), (0.013, 0.02)));
        let post = curve(
            &[
                v(0.18 * s, 0.225, 0.0),
                v(0.18 * s, 0.195, 0.42),
                v(0.18 * s, 0.215, 0.66),
                v(0.175 * s, 0.27, 0.93),
            ],
            3,
        );
        m.add(rod(wood, &post, |t| 0.015 + 0.005 * libm::sin(t * PI), 5));
        m.add(tube(wood, &[v(0.185 * s, -0.18, 0.2), v(0.18 * s, 0.205, 0.2)], 0.009, 5));
        m.add(soft(wood, 0.022, 0.34, 0.055, 0.006, 1).at(0.185 * s, 0.005, 0.385));
    }
    m.add(tube(wood, &[v(-0.18, 0.01, 0.2), v(0.18, 0.01, 0.2)], 0.009, 5));
    for y in [-0.185, 0.19] {
        m.add(soft(wood, 0.34, 0.022, 0.055, 0.006, 1).at(0.0, y, 0.385));
    }
    m.add(cushion(cloth, v(0.42, 0.42, 0.05), 0.022, 0.012, 1, 2).at(0.0, -0.01, 0.435));
    for (k, z) in [0.58, 0.7, 0.82].into_iter().enumerate() {
        let h = if k == 2 { 0.09 } else { 0.055 };
        m.add(plate(wood, (4, 1), 0.014, |a, b| {
            let x = 0.345 * (a - 0.5);
            let zz = z + h * b + 0.01 * (1.0 - (2.0 * a - 1.0).raised(2)) * b;
            let lean = 0.215 + (zz - 0.66).max(0.0) * 0.2;
            v(x, lean - 0.012 + 0.035 * (1.0 - (x / 0.1725).raised(2)), zz)
        }));
    }
    m
}

/// A stool with a round seat; `height` 0.45 for tables, 0.75 for bars.
pub fn stool(wood: Paint, cloth: Paint, height: f64) -> Mesh {
    let mut m = lathe(
        cloth,
        &[
            (0.0, 0.0),
            (0.15, 0.0),
            (0.17, 0.008),
            (0.178, 0.025),
            (0.172, 0.042),
            (0.15, 0.054),
            (0.08, 0.06),
            (0.0, 0.062),
        ],
        13,
    )
    .at(0.0, 0.0, height - 0.062);
    for k in 0..4 {
        let (s, c) = sin_cos(radians(45.0 + 90.0 * f64::from(k)));
        m.add(leg(
            wood,
            v(0.2 * c, 0.2 * s, 0.0),
            v(0.11 * c, 0.11 * s, height - 0.06),
            (0.011, 0.017),
        ));
    }
    let z = height * 0.35;
    m.add(ring("metal.steel", 0.2 - 0.09 * z / height, 0.008, 18, 5).at(0.0, 0.0, z));
    m
}

/// A deep armchair on tapered legs.
pub fn armchair(cloth: Paint, wood: Paint) -> Mesh {
    let mut m = Mesh::new();
    m.add(rounded(cloth, v(-0.36, -0.34, 0.16), v(0.36, 0.34, 0.3), 0.04, 2));
    m.add(cushion(cloth, v(0.54, 0.6, 0.16), 0.055, 0.025, 1, 4).at(0.0, -0.06, 0.29));
    m.add(
        cushion(cloth, v(0.54, 0.17, 0.52), 0.06, 0.03, 1, 4)
            .map(|p| v(p.x, p.y - 0.05 * (p.x / 0.27).raised(2), p.z))
            .tipped(-12.0)
            .at(0.0, 0.225, 0.36),
    );
    m.add(
        rounded(cloth, v(-0.36, 0.24, 0.28), v(0.36, 0.37, 0.74), 0.05, 2)
            .map(|p| v(p.x, p.y + (p.z - 0.28) * 0.14, p.z)),
    );
    for s in [-1.0, 1.0] {
        let arm = rounded(cloth, v(-0.065, -0.36, 0.0), v(0.065, 0.3, 0.33), 0.055, 2)
            .map(|p| v(p.x, p.y, p.z + 0.03 * (p.y + 0.36) / 0.66));
        m.add(arm.at(0.34 * s, 0.0, 0.24));
        for y in [-0.28, 0.28] {
            m.add(leg(wood, v(0.31 * s, y * 1.08, 0.0), v(0.28 * s, y, 0.19), (0.011, 0.02)));
        }
    }
    m
}

/// A lounge chair of bent wood and leather.
pub fn lounge_chair(leather: Paint, wood: Paint) -> Mesh {
    let mut m = Mesh::new();
    for s in [-1.0, 1.0] {
        let runner = curve(
            &[
                v(0.3 * s, -0.36, 0.5),
                v(0.3 * s, -0.39, 0.25),
                v(0.3 * s, -0.33, 0.02),
                v(0.3 * s, 0.0, 0.014),
                v(0.3 * s, 0.36, 0.014),
                v(0.3 * s, 0.4, 0.03),
            ],
            3,
        );
        m.add(rod(wood, &runner, |_| 0.017, 5));
        let arm = curve(
            &[
                v(0.3 * s, -0.36, 0.5),
                v(0.3 * s, 0.0, 0.52),
                v(0.3 * s, 0.28, 0.48),
                v(0.29 * s, 0.36, 0.4),
            ],
            3,
        );
        m.add(rod(wood, &arm, |t| 0.017 + 0.012 * libm::sin(t * PI), 5));
        m.add(tube(wood, &[v(0.3 * s, 0.1, 0.5), v(0.29 * s, 0.16, 0.02)], 0.015, 5));
    }
    for y in [-0.3, 0.2] {
        m.add(tube(wood, &[v(-0.3, y, 0.29), v(0.3, y, 0.29)], 0.013, 5));
    }
    let pad = |m: Mesh, tip: f64, y: f64, z: f64| m.tipped(tip).at(0.0, y, z);
    m.add(pad(cushion(leather, v(0.52, 0.56, 0.1), 0.042, 0.018, 1, 4), -9.0, -0.03, 0.3));
    m.add(pad(cushion(leather, v(0.52, 0.11, 0.6), 0.045, 0.02, 1, 5), -24.0, 0.26, 0.36));
    m.add(pad(cushion(leather, v(0.4, 0.09, 0.17), 0.04, 0.012, 1, 3), -24.0, 0.37, 0.8));
    m
}

/// A sofa for `seats` people with loose pillows.
pub fn sofa(cloth: Paint, pillows: [Paint; 2], seats: usize) -> Mesh {
    let each = 0.64;
    let half = each * seats as f64 / 2.0;
    let out = half + 0.17;
    let mut m = Mesh::new();
    m.add(rounded(cloth, v(-out + 0.02, -0.42, 0.12), v(out - 0.02, 0.42, 0.29), 0.04, 3));
    m.add(
        rounded(cloth, v(-out + 0.05, 0.22, 0.25), v(out - 0.05, 0.42, 0.72), 0.06, 4)
            .map(|p| v(p.x, p.y + (p.z - 0.25) * 0.1, p.z)),
    );
    for s in [-1.0, 1.0] {
        m.add(rounded(cloth, v(-0.085, -0.43, 0.11), v(0.085, 0.44, 0.58), 0.07, 4).at(
            (out - 0.085) * s,
            0.0,
            0.0,
        ));
        for y in [-0.35, 0.35] {
            m.add(leg(
                "wood.walnut",
                v((out - 0.12) * s, y, 0.0),
                v((out - 0.13) * s, y, 0.14),
                (0.014, 0.022),
            ));
        }
    }
    for k in 0..seats {
        let x = -half + each * (k as f64 + 0.5);
        m.add(cushion(cloth, v(each - 0.008, 0.66, 0.17), 0.05, 0.022, 1, 3).at(x, -0.1, 0.28));
        m.add(
            cushion(cloth, v(each - 0.02, 0.19, 0.44), 0.07, 0.035, 1, 3)
                .tipped(-13.0)
                .at(x, 0.16, 0.44),
        );
    }
    for (k, s) in [-1.0, 1.0].into_iter().enumerate() {
        let pillow = cushion(pillows[k], v(0.42, 0.1, 0.42), 0.045, 0.055, 1, 3);
        m.add(pillow.tipped(-24.0).rolled(9.0 * s).turned(-14.0 * s).at(
            (half - 0.24) * s,
            -0.03,
            0.475,
        ));
    }
    m
}

/// An upholstered bench, its long side to the front.
pub fn bench(cloth: Paint, wood: Paint, width: f64) -> Mesh {
    let mut m = cushion(cloth, v(width, 0.42, 0.09), 0.035, 0.012, 1, 3).at(0.0, 0.0, 0.37);
    m.add(soft(wood, width - 0.06, 0.36, 0.04, 0.008, 1).at(0.0, 0.0, 0.335));
    for (sx, sy) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let x = (width / 2.0 - 0.12) * sx;
        m.add(leg(wood, v(x + 0.03 * sx, 0.15 * sy, 0.0), v(x, 0.13 * sy, 0.34), (0.012, 0.02)));
    }
    m
}

/// A pouf.
pub fn pouf(cloth: Paint) -> Mesh {
    let mut profile = vec![(0.0, 0.0)];
    for i in 0..=7 {
        let (s, c) = sin_cos(PI * f64::from(i) / 7.0);
        profile.push((0.19 + 0.09 * s, 0.19 - 0.19 * c));
    }
    profile.push((0.0, 0.385));
    let mut m = lathe(cloth, &profile, 24).map(|p| {
        let a = libm::atan2(p.y, p.x);
        let f = 1.0 + 0.018 * libm::cos(a * 12.0);
        v(p.x * f, p.y * f, p.z)
    });
    m.add(ball(cloth, 0.018, 8).at(0.0, 0.0, 0.385));
    m
}

/// A bed, its head to +y: `width` 0.9 for one, 1.6 for two.
pub fn bed(wood: Paint, cover: Paint, pillow: Paint, width: f64, mut rng: Rng) -> Mesh {
    let (w, l) = (width / 2.0, 1.02);
    let mut m = Mesh::new();
    // Frame, feet and headboard.
    for s in [-1.0, 1.0] {
        m.add(rounded(wood, v(-0.015, -l, 0.16), v(0.015, l, 0.34), 0.006, 1).at(
            (w + 0.016) * s,
            0.0,
            0.0,
        ));
        for y in [-l + 0.05, l - 0.05] {
            m.add(leg(wood, v((w - 0.03) * s, y, 0.0), v((w - 0.03) * s, y, 0.18), (0.022, 0.03)));
        }
    }
    m.add(rounded(wood, v(-w - 0.03, -l - 0.03, 0.16), v(w + 0.03, -l, 0.36), 0.008, 1));
    m.add(rounded(wood, v(-w - 0.05, l, 0.12), v(w + 0.05, l + 0.05, 1.0), 0.018, 3));
    m.add(rounded(
        "fabric.cream",
        v(-w + 0.04, l - 0.03, 0.52),
        v(w - 0.04, l + 0.003, 0.94),
        0.014,
        3,
    ));
    m.add(rounded("fabric.white", v(-w, -l + 0.005, 0.2), v(w, l - 0.035, 0.44), 0.05, 3));
    // The duvet falls over three sides in soft folds, and is turned back below the pillows.
    let waves = [rng.range(0.0, 6.0), rng.range(0.0, 6.0), rng.range(0.0, 6.0)];
    let (nu, nv) = (18, 13);
    m.add(plate(cover, (nu, nv), 0.03, |a, b| {
        let x = (a - 0.5) * (2.0 * w + 0.5);
        let y = -l - 0.06 + b * 1.5;
        let over = (x.abs() - w - 0.015).max(0.0);
        let px = if over > 0.0 { (w + 0.045 + 0.12 * over) * x.signum() } else { x };
        let ripple = 0.010 * libm::sin(7.0 * x + waves[0] + 2.0 * y)
            + 0.008 * libm::sin(9.0 * y + waves[1] - 3.0 * x);
        let puff = 0.035 * (1.0 - (x / (w + 0.1)).raised(2)).max(0.0);
        let fold = 0.012 * libm::sin(16.0 * y + waves[2]) * (over * 6.0).min(1.0);
        let tuck = if b > 0.9 { 0.03 * libm::sin((b - 0.9) * 10.0 * PI) } else { 0.0 };
        let drop = if over > 0.0 { over * 0.96 } else { 0.0 };
        v(px + fold * x.signum(), y, 0.485 + puff + ripple + tuck - drop)
    }));
    let count = if width > 1.2 { 2 } else { 1 };
    for k in 0..count {
        let x = if count == 2 { (f64::from(k) - 0.5) * width * 0.5 } else { 0.0 };
        let p = cushion(
            pillow,
            v((width / f64::from(count) - 0.12).min(0.7), 0.4, 0.12),
            0.055,
            0.06,
            1,
            3,
        );
        m.add(p.tipped(20.0).turned(rng.around(5.0)).at(x + rng.around(0.02), l - 0.27, 0.46));
        let q = cushion(cover, v(0.44, 0.34, 0.1), 0.045, 0.05, 1, 3);
        m.add(q.tipped(48.0).turned(rng.around(8.0)).at(x + rng.around(0.03), l - 0.42, 0.53));
    }
    m
}

/// A cot with bars.
pub fn cot(wood: Paint, cover: Paint) -> Mesh {
    let (w, l) = (0.36, 0.66);
    let mut m = Mesh::new();
    for (sx, sy) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        m.add(soft(wood, 0.045, 0.045, 0.95, 0.01, 1).at(w * sx, l * sy, 0.0));
        m.add(ball(wood, 0.03, 8).at(w * sx, l * sy, 0.965));
    }
    for s in [-1.0, 1.0] {
        for z in [0.3, 0.88] {
            m.add(
                rounded(wood, v(-0.012, -l + 0.023, z), v(0.012, l - 0.023, z + 0.04), 0.006, 1)
                    .at(w * s, 0.0, 0.0),
            );
            m.add(
                rounded(wood, v(-w + 0.023, -0.012, z), v(w - 0.023, 0.012, z + 0.04), 0.006, 1)
                    .at(0.0, l * s, 0.0),
            );
        }
        for k in 0..11 {
            let y = -l + 2.0 * l * (f64::from(k) + 1.0) / 12.0;
            m.add(tube(wood, &[v(w * s, y, 0.33), v(w * s, y, 0.885)], 0.009, 5));
        }
        for k in 0..5 {
            let x = -w + 2.0 * w * (f64::from(k) + 1.0) / 6.0;
            m.add(tube(wood, &[v(x, l * s, 0.33), v(x, l * s, 0.885)], 0.009, 5));
        }
    }
    m.add(rounded(
        "fabric.white",
        v(-w + 0.02, -l + 0.02, 0.36),
        v(w - 0.02, l - 0.02, 0.46),
        0.03,
        3,
    ));
    m.add(cushion(cover, v(0.6, 0.8, 0.05), 0.022, 0.025, 1, 5).at(0.0, -0.18, 0.46));
    m.add(cushion("fabric.cream", v(0.4, 0.26, 0.07), 0.03, 0.03, 1, 4).at(0.0, 0.45, 0.46));
    m
}

/// A soft bear that sits.
pub fn bear(cloth: Paint) -> Mesh {
    let blob = |r: f64, x: f64, y: f64, z: f64, s: [f64; 3]| {
        ball(cloth, r, 9).scaled(s[0], s[1], s[2]).at(x, y, z)
    };
    let mut m = all([
        blob(0.11, 0.0, 0.0, 0.12, [1.0, 0.9, 1.1]),
        blob(0.085, 0.0, -0.01, 0.3, [1.05, 0.95, 1.0]),
        ball("fabric.cream", 0.038, 8).at(0.0, -0.075, 0.285),
        ball("plastic.black", 0.012, 8).at(0.0, -0.113, 0.295),
    ]);
    for s in [-1.0, 1.0] {
        m.add(blob(0.035, 0.065 * s, 0.0, 0.375, [1.0, 0.6, 1.0]));
        m.add(blob(0.045, 0.11 * s, -0.05, 0.17, [1.0, 1.5, 0.9]));
        m.add(blob(0.05, 0.075 * s, -0.13, 0.05, [1.0, 1.6, 1.0]));
        m.add(ball("plastic.black", 0.009, 8).at(0.032 * s, -0.083, 0.325));
    }
    m
}
