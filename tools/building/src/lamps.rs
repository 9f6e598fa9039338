//! Luminaires: a housing under the ceiling and a panel that emits downwards.
//!
//! One luminaire is one light. Large rooms hang several panels from one slim rail. The panel is
//! an open sheet, counter-clockwise seen from below, and the lowest face of its luminaire.

use crate::Part;
use crate::furnish::Placement;
use crate::mesh::{Mesh, cuboid, lathe, rounded, sin_cos, tube, v};
use crate::palette::PANEL;
use crate::plan::{Lamp, Panel, Plan};
use std::f64::consts::TAU;

/// Warm white, about 3000 K.
pub const WARM: [f64; 3] = [1.0, 0.82, 0.58];
/// Neutral white, about 4000 K.
pub const NEUTRAL: [f64; 3] = [1.0, 0.91, 0.78];
/// Luminous flux installed per floor area, lumens per square metre.
pub const LUMENS_PER_AREA: f64 = 330.0;

/// How far the panel is below the ceiling, metres.
pub const DROP: f64 = 0.05;

/// One panel with its housing, hanging from z = 0.
fn unit(panel: Panel, along_y: bool) -> Mesh {
    let (x, y) = match (panel, along_y) {
        (Panel::Square, _) => (0.6, 0.6),
        (Panel::Long, false) => (1.2, 0.3),
        (Panel::Long, true) => (0.3, 1.2),
        (Panel::Round, _) => return round(),
    };
    let (hx, hy) = (x / 2.0, y / 2.0);
    let edge = 0.02;
    let z = -DROP;
    let mut m = rounded("lamp.housing", v(-hx, -hy, z + 0.008), v(hx, hy, -0.002), 0.008, 1);
    // A rim around the panel, whose lower side stays above the panel.
    for (a, b) in [
        (v(-hx, -hy, 0.0), v(hx, -hy + edge, 0.0)),
        (v(-hx, hy - edge, 0.0), v(hx, hy, 0.0)),
        (v(-hx, -hy + edge, 0.0), v(-hx + edge, hy - edge, 0.0)),
        (v(hx - edge, -hy + edge, 0.0), v(hx, hy - edge, 0.0)),
    ] {
        m.add(cuboid("lamp.housing", v(a.x, a.y, z + 0.001), v(b.x, b.y, z + 0.012)));
    }
    let (px, py) = (hx - edge, hy - edge);
    let (nx, ny) = if x > y {
        (8, 2)
    } else if y > x {
        (2, 8)
    } else {
        (4, 4)
    };
    // u runs west, so that u x v points down.
    m.add(crate::mesh::sheet(PANEL, (nx, ny), (false, false), |a, b| {
        v(px * (1.0 - 2.0 * a), py * (2.0 * b - 1.0), z)
    }));
    m
}

fn round() -> Mesh {
    let r = 0.25;
    let mut m = lathe(
        "lamp.housing",
        &[
            (0.0, -DROP + 0.004),
            (r - 0.012, -DROP + 0.004),
            (r - 0.01, -DROP + 0.001),
            (r, -DROP + 0.006),
            (r + 0.012, -DROP + 0.02),
            (r + 0.014, -0.02),
            (r, -0.002),
            (0.0, -0.002),
        ],
        16,
    );
    let segments = 16;
    let centre = m.point(v(0.0, 0.0, -DROP));
    let rim: Vec<u32> = (0..segments)
        .map(|i| {
            let (s, c) = sin_cos(TAU * f64::from(i) / f64::from(segments));
            m.points.push(v(c, s, 0.0) * (r - 0.012) + v(0.0, 0.0, -DROP));
            (m.points.len() - 1) as u32
        })
        .collect();
    for i in 0..rim.len() {
        m.triangle(centre, rim[(i + 1) % rim.len()], rim[i], PANEL);
    }
    m
}

/// The luminaire, its first panel above the origin, its ceiling at z = 0.
pub(crate) fn luminaire(lamp: &Lamp) -> Mesh {
    let (x0, y0) = lamp.points[0];
    let mut m = Mesh::new();
    for &(x, y) in &lamp.points {
        m.add(unit(lamp.panel, lamp.along_y).at(x - x0, y - y0, 0.0));
    }
    for pair in lamp.points.windows(2) {
        let [a, b] = [pair[0], pair[1]].map(|(x, y)| v(x - x0, y - y0, -0.02));
        // The rail turns the corner in the same way as the corridor, and ends at the housings.
        let mut bends = vec![a];
        if (a.x - b.x).abs() > 1e-6 && (a.y - b.y).abs() > 1e-6 {
            bends.push(v(b.x, a.y, a.z));
        }
        bends.push(b);
        let n = bends.len();
        let half = 0.29;
        let (first, last) = ((bends[1] - a).normalize(), (bends[n - 2] - b).normalize());
        let reach = |d: glam::DVec3| match (lamp.panel, lamp.along_y) {
            (Panel::Long, along_y) if (d.x.abs() > 0.5) != along_y => 0.6,
            (Panel::Long, _) => 0.15,
            (Panel::Square, _) => half + 0.01,
            (Panel::Round, _) => 0.264,
        };
        bends[0] = a + first * reach(first);
        bends[n - 1] = b + last * reach(last);
        if bends[0].distance(bends[n - 1]) > 0.1 {
            m.add(tube("lamp.housing", &bends, 0.012, 10));
        }
    }
    m
}

/// Every luminaire of the plan: parts by shape, copies by room.
pub fn build(plan: &Plan) -> Vec<Part> {
    let mut parts: Vec<Part> = Vec::new();
    for (r, room) in plan.rooms.iter().enumerate() {
        let Some(lamp) = &room.lamp else { continue };
        let mesh = luminaire(lamp);
        let (x, y) = lamp.points[0];
        let copy = Placement { room: Some(r), is_lamp: true, ..Placement::new(x, y, lamp.z, 0.0) };
        if let Some(part) = parts.iter_mut().find(|p| p.mesh == mesh) {
            part.copies.push(copy);
        } else {
            let kind = match lamp.panel {
                Panel::Square => "square",
                Panel::Long => "long",
                Panel::Round => "round",
            };
            let name = format!("lamp-{kind}-{}", parts.len() + 1);
            parts.push(Part { name, mesh, door: false, copies: vec![copy] });
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panels_face_down_and_are_the_lowest() {
        for panel in [Panel::Square, Panel::Long, Panel::Round] {
            let m = unit(panel, true);
            let low = m.bounds().0.z;
            let mut area = 0.0;
            for (i, t) in m.triangles.iter().enumerate() {
                if t.paint == PANEL {
                    let [a, b, c] = m.corners(i);
                    let n = (b - a).cross(c - a);
                    assert!(n.z < 0.0 && n.x == 0.0 && n.y == 0.0);
                    assert!((a.z - low).abs() < 1e-9);
                    area += n.length() / 2.0;
                }
            }
            assert!(area > 0.17 && area < 0.36, "{area}");
        }
    }
}
