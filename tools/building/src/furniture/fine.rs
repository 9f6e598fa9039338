//! Pieces for halls and towers: seats in rows, cabinets of bottles, blinds, lift doors.

use crate::mesh::{
    Mesh, Paint, all, bevelled, cuboid, curve, cushion, lathe, plate, rounded, sheet, sin_cos,
    soft, tube, v,
};
use crate::rng::Rng;

/// A tip-up theatre seat with one arm to its right; the row goes on along x every 0.56 m.
pub fn theatre_seat(cloth: Paint, rng: &mut Rng) -> Mesh {
    let mut m = Mesh::new();
    let seat = cushion(cloth, v(0.47, 0.46, 0.11), 0.045, 0.02, 2, 4);
    // Some are tipped up.
    if rng.unit() < 0.3 {
        m.add(seat.at(0.0, -0.23, 0.0).tipped(-80.0).at(0.0, 0.16, 0.43));
    } else {
        m.add(seat.at(0.0, -0.04, 0.36));
    }
    let back = cushion(cloth, v(0.48, 0.1, 0.62), 0.04, 0.02, 2, 4);
    m.add(back.tipped(-9.0).at(0.0, 0.2, 0.42));
    m.add(
        rounded("wood.walnut", v(-0.25, 0.245, 0.3), v(0.25, 0.275, 1.0), 0.01, 1)
            .tipped(-4.0)
            .at(0.0, 0.06, 0.0),
    );
    m.add(rounded("metal.dark", v(0.262, -0.2, 0.0), v(0.292, 0.26, 0.58), 0.01, 1));
    m.add(soft("wood.walnut", 0.07, 0.42, 0.04, 0.014, 3).at(0.277, 0.0, 0.581));
    m
}

/// A row of `count` theatre seats, centred, facing -y.
pub fn seat_row(cloth: Paint, count: usize, mut rng: Rng) -> Mesh {
    let half = 0.28 * (count as f64 - 1.0);
    let mut m =
        all((0..count).map(|k| theatre_seat(cloth, &mut rng).at(0.56 * k as f64 - half, 0.0, 0.0)));
    m.add(
        rounded("metal.dark", v(-0.292, -0.2, 0.0), v(-0.262, 0.26, 0.58), 0.01, 1)
            .at(-half, 0.0, 0.0),
    );
    m.add(soft("wood.walnut", 0.07, 0.42, 0.04, 0.014, 3).at(-half - 0.277, 0.0, 0.581));
    m
}

/// A bottle of one of several shapes.
fn bottle(paint: Paint, r: f64, h: f64) -> Mesh {
    let profile = [
        (0.0, 0.0),
        (r * 0.92, 0.0),
        (r, r * 0.2),
        (r, h * 0.56),
        (r * 0.8, h * 0.66),
        (r * 0.32, h * 0.76),
        (r * 0.3, h * 0.94),
        (r * 0.36, h * 0.95),
        (r * 0.36, h),
        (0.0, h),
    ];
    lathe(paint, &profile, 12)
}

/// A small open bowl.
fn bowl(paint: Paint, r: f64) -> Mesh {
    let profile = [
        (0.0, 0.0),
        (r * 0.5, 0.0),
        (r * 0.55, 0.01),
        (r * 0.9, r * 0.5),
        (r, r),
        (r * 0.94, r),
        (r * 0.8, r * 0.5),
        (r * 0.4, 0.02),
        (0.0, 0.015),
    ];
    lathe(paint, &profile, 14)
}

/// A glazed cabinet of bottles and bowls, `width` wide and 2.1 m high; its back is at +y.
pub fn vitrine(wood: Paint, width: f64, mut rng: Rng) -> Mesh {
    let (w, d, h) = (width / 2.0, 0.2, 2.1);
    let mut m = all([
        bevelled(wood, v(-w, d - 0.02, 0.0), v(w, d, h), 0.004),
        bevelled(wood, v(-w, -d, 0.0), v(-w + 0.03, d - 0.021, h), 0.004),
        bevelled(wood, v(w - 0.03, -d, 0.0), v(w, d - 0.021, h), 0.004),
        bevelled(wood, v(-w + 0.031, -d, h - 0.03), v(w - 0.031, d - 0.021, h), 0.004),
        bevelled(wood, v(-w + 0.031, -d, 0.0), v(w - 0.031, d - 0.021, 0.1), 0.004),
    ]);
    // The front is glass in one sheet, set into the sides.
    m.add(sheet("glass.pane", (1, 1), (false, false), |a, b| {
        v((w - 0.02) * (2.0 * a - 1.0), -d + 0.03, 0.1 + (h - 0.12) * b)
    }));
    let paints: [Paint; 8] = [
        "ceramic.white",
        "ceramic.blue",
        "ceramic.green",
        "ceramic.red",
        "ceramic.ochre",
        "lacquer.gloss",
        "metal.brass",
        "metal.copper",
    ];
    let shelves = 5;
    for k in 0..shelves {
        let z = 0.1 + (h - 0.13) * f64::from(k) / f64::from(shelves);
        if k > 0 {
            m.add(cuboid(wood, v(-w + 0.031, -d + 0.05, z - 0.018), v(w - 0.031, d - 0.022, z)));
        }
        // Two rows, the front one in the gaps of the other.
        for (row, y) in [(0.0, 0.085), (0.05, -0.045)] {
            let mut x = -w + 0.09 + row;
            while x < w - 0.08 {
                let r = rng.range(0.03, 0.046);
                let tall = rng.range(0.2, 0.31) * if row > 0.0 { 0.85 } else { 1.0 };
                let paint = rng.pick(&paints);
                let thing =
                    if rng.unit() < 0.75 { bottle(paint, r, tall) } else { bowl(paint, r * 1.2) };
                m.add(thing.turned(rng.range(0.0, 360.0)).at(x, y + rng.around(0.008), z + 0.001));
                x += rng.range(0.095, 0.115);
            }
        }
    }
    m
}

/// A slatted blind for a window of `width`, let down by `drop`; it hangs from z = 0 with its back
/// at y = 0.03.
pub fn blind(paint: Paint, width: f64, drop: f64) -> Mesh {
    let w = width / 2.0;
    let mut m = rounded("metal.steel", v(-w, -0.03, -0.045), v(w, 0.03, 0.0), 0.008, 1);
    let count = (drop / 0.04) as usize;
    for k in 0..count {
        let z = -0.075 - 0.04 * k as f64;
        let slat = plate(paint, (1, 4), 0.0012, |a, b| {
            let y = 0.02 * (2.0 * b - 1.0);
            v((w - 0.01) * (2.0 * a - 1.0), y, 0.004 * (1.0 - (2.0 * b - 1.0) * (2.0 * b - 1.0)))
        });
        m.add(slat.tipped(32.0).at(0.0, 0.0, z));
    }
    let bottom = -0.075 - 0.04 * count as f64;
    m.add(rounded(
        "metal.steel",
        v(-w + 0.01, -0.018, bottom - 0.01),
        v(w - 0.01, 0.018, bottom + 0.01),
        0.005,
        1,
    ));
    for x in [-w * 0.6, w * 0.6] {
        m.add(tube("fabric.white", &[v(x, -0.028, -0.04), v(x, -0.028, bottom)], 0.0018, 4));
    }
    m
}

/// Lift doors, shut, in their portal; the wall is at y = 0.
pub fn lift_doors() -> Mesh {
    let mut m = all([
        rounded("metal.steel", v(-0.72, -0.06, 0.0), v(-0.6, 0.0, 2.3), 0.008, 1),
        rounded("metal.steel", v(0.6, -0.06, 0.0), v(0.72, 0.0, 2.3), 0.008, 1),
        rounded("metal.steel", v(-0.599, -0.06, 2.16), v(0.599, 0.0, 2.3), 0.008, 1),
        bevelled("metal.brushed", v(-0.597, -0.03, 0.012), v(-0.002, -0.002, 2.155), 0.003),
        bevelled("metal.brushed", v(0.002, -0.03, 0.012), v(0.597, -0.002, 2.155), 0.003),
        rounded("plastic.black", v(0.86, -0.015, 1.0), v(0.94, 0.0, 1.22), 0.004, 1),
    ]);
    for z in [1.06, 1.16] {
        let knob =
            lathe("metal.brass", &[(0.0, 0.0), (0.016, 0.0), (0.014, 0.006), (0.0, 0.006)], 12);
        m.add(knob.tipped(90.0).at(0.9, -0.0155, z));
    }
    m
}

/// A chandelier that is off: arms with glass-white cups around a turned stem, from z = 0 down.
pub fn chandelier(metal: Paint) -> Mesh {
    let mut m = lathe(
        metal,
        &[
            (0.0, -0.75),
            (0.05, -0.72),
            (0.075, -0.66),
            (0.03, -0.58),
            (0.018, -0.5),
            (0.04, -0.44),
            (0.018, -0.38),
            (0.012, -0.06),
            (0.06, -0.03),
            (0.065, -0.002),
            (0.0, -0.002),
        ],
        18,
    );
    for k in 0..8 {
        let (s, c) = sin_cos(std::f64::consts::TAU * f64::from(k) / 8.0);
        let arm = curve(
            &[
                v(0.05 * c, 0.05 * s, -0.66),
                v(0.2 * c, 0.2 * s, -0.72),
                v(0.36 * c, 0.36 * s, -0.66),
                v(0.4 * c, 0.4 * s, -0.52),
            ],
            4,
        );
        m.add(tube(metal, &arm, 0.008, 6));
        let cup = lathe(
            "ceramic.white",
            &[
                (0.0, 0.0),
                (0.02, 0.0),
                (0.045, 0.03),
                (0.06, 0.09),
                (0.055, 0.09),
                (0.04, 0.033),
                (0.0, 0.012),
            ],
            16,
        );
        m.add(cup.at(0.4 * c, 0.4 * s, -0.519));
    }
    m
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::is_closed;

    #[test]
    fn solids_are_closed_and_outward() {
        for m in [
            seat_row("fabric.red", 4, Rng::new(1, "row")),
            blind("lacquer.white", 1.4, 0.8),
            lift_doors(),
            chandelier("metal.brass"),
        ] {
            assert!(is_closed(&m) && m.volume() > 0.0);
        }
        let v = vitrine("wood.oak", 1.2, Rng::new(1, "v"));
        assert!(v.triangles.len() > 4000, "{}", v.triangles.len());
    }
}
