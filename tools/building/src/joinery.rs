//! What carpenters add to bare walls: windows, casings, skirting, door leaves, stairs.
//!
//! Glass is single sheets whose edges sit inside their frames; everything else is closed.

use crate::Part;
use crate::furnish::Placement;
use crate::lshape::STAIR_OPENING;
use crate::mesh::{
    Mesh, Paint, all, ball, block, cuboid, cylinder, lathe, rounded, sheet, soft, tube, v,
};
use crate::plan::{Filling, Leaf, Opening, Plan, Rect, STOREY, Side};

/// Width of the leaf of a 0.9 m doorway, metres.
const LEAF_WIDTH: f64 = 0.86;
/// How far a leaf's hinge is inside the opening, metres.
const HINGE: f64 = 0.026;

/// All joinery of the plan.
pub fn build(plan: &Plan) -> Vec<Part> {
    let mut windows = Mesh::new();
    let mut casings = Mesh::new();
    let mut doors: Vec<Part> = Vec::new();
    for (i, o) in plan.openings.iter().enumerate() {
        let (centre, turn) = pose(plan, o);
        let set = |m: Mesh| m.turned(turn).at(centre.0, centre.1, o.height.0);
        let (w, h) = (o.span.1 - o.span.0, o.height.1 - o.height.0);
        let t = o.band.1 - o.band.0;
        match o.filling {
            Filling::Window { sashes } => {
                windows.add(set(window(w, h, t, sashes)).named(format!("window-{i}")));
            }
            Filling::Screen { sashes } => {
                windows.add(set(screen(w, h, t, sashes)).named(format!("screen-{i}")));
            }
            Filling::Entrance => {
                windows.add(set(entrance(w, h)).named(format!("entrance-{i}")));
            }
            Filling::Doorway(_) | Filling::Shut(_) => {
                casings.add(set(casing(w, h, t)).named(format!("casing-{i}")));
                if let Some((name, copy, mesh)) = hung(o) {
                    match doors.iter_mut().find(|p| p.name == name) {
                        Some(part) => part.copies.push(copy),
                        None => doors.push(Part {
                            mesh: mesh.named("door"),
                            door: true,
                            copies: vec![copy],
                            name,
                        }),
                    }
                }
            }
        }
    }
    let mut parts = vec![
        Part::fixed("windows", windows),
        Part::fixed("casings", casings),
        Part::fixed("skirting", skirting(plan)),
        Part::fixed("outside", outside(plan)),
    ];
    if plan.storeys > 1 {
        parts.push(Part::fixed("stairs", stairs(plan)));
    }
    parts.extend(doors);
    parts
}

/// Centre of an opening in plan, and the turn that brings local +y to its inner side.
fn pose(plan: &Plan, o: &Opening) -> ((f64, f64), f64) {
    let r = o.rect();
    let (x, y) = ((r.x0 + r.x1) / 2.0, (r.y0 + r.y1) / 2.0);
    let beyond = (o.band.1 - o.band.0) / 2.0 + 0.05;
    let z = (o.height.0 + o.height.1) / 2.0;
    let inside = |dx: f64, dy: f64| plan.room_at(v(x + dx * beyond, y + dy * beyond, z)).is_some();
    let turn = match o.along_x {
        true if inside(0.0, 1.0) => 0.0,
        true => 180.0,
        false if inside(1.0, 0.0) => -90.0,
        false => 90.0,
    };
    ((x, y), turn)
}

/// A rectangular frame in the plane y = 0 from (x0, z0) to (x1, z1), with bars `bar` wide.
fn frame(
    paint: Paint,
    (x0, z0, x1, z1): (f64, f64, f64, f64),
    bar: f64,
    (y0, y1): (f64, f64),
) -> Mesh {
    all([
        cuboid(paint, v(x0, y0, z0), v(x1, y1, z0 + bar)),
        cuboid(paint, v(x0, y0, z1 - bar), v(x1, y1, z1)),
        cuboid(paint, v(x0, y0, z0 + bar), v(x0 + bar, y1, z1 - bar)),
        cuboid(paint, v(x1 - bar, y0, z0 + bar), v(x1, y1, z1 - bar)),
    ])
}

/// A vertical pane from (x0, z0) to (x1, z1) at `y`: one sheet, facing -y.
fn pane((x0, z0, x1, z1): (f64, f64, f64, f64), y: f64) -> Mesh {
    sheet("glass.pane", (1, 1), (false, false), |a, b| v(x0 + (x1 - x0) * a, y, z0 + (z1 - z0) * b))
}

/// A frame with mullions between `sashes` panes, in the plane y = 0.
fn glazing(paint: Paint, w: f64, h: f64, sashes: u32, (y0, y1): (f64, f64)) -> Mesh {
    // Frames reach a little into the wall, and panes into their frames: no light gets around.
    let embed = 0.002;
    let bar = 0.07;
    let (x0, x1) = (-w / 2.0 - embed, w / 2.0 + embed);
    let mut m = frame(paint, (x0, -embed, x1, h + embed), bar, (y0, y1));
    let step = (x1 - x0 - 2.0 * bar) / f64::from(sashes);
    let (low, high) = (bar - embed, h + embed - bar);
    for k in 0..sashes {
        let a = x0 + bar + step * f64::from(k);
        let (left, right) = (if k == 0 { a } else { a + bar / 2.0 }, a + step);
        let right = if k + 1 == sashes { right } else { right - bar / 2.0 };
        if k > 0 {
            m.add(cuboid(paint, v(a - bar / 2.0, y0, low), v(a + bar / 2.0, y1, high)));
        }
        let e = 0.01;
        m.add(pane((left - e, low - e, right + e, high + e), (y0 + y1) / 2.0));
    }
    m
}

/// A window in its opening; local +y is inside.
pub(crate) fn window(w: f64, h: f64, t: f64, sashes: u32) -> Mesh {
    let mut m = glazing("frame.white", w, h, sashes, (-0.07, -0.01));
    // Handles on the sashes, a board inside, a drip sill outside.
    for k in 1..sashes {
        let x = -w / 2.0 + w * f64::from(k) / f64::from(sashes) + 0.02;
        let grip = [
            v(x, -0.01, h * 0.45 + 0.01),
            v(x, 0.032, h * 0.45 + 0.01),
            v(x, 0.036, h * 0.45 - 0.05),
            v(x, 0.036, h * 0.45 - 0.11),
        ];
        m.add(tube("metal.steel", &grip, 0.009, 5));
    }
    let e = w / 2.0 - 0.002;
    m.add(cuboid("stone.sill", v(-e, 0.01, 0.001), v(e, t / 2.0 + 0.04, 0.026)));
    m.add(cuboid("metal.steel", v(-e, -t / 2.0 - 0.04, 0.001), v(e, -0.075, 0.016)));
    m
}

/// A fixed glass screen with dark slender bars.
pub(crate) fn screen(w: f64, h: f64, t: f64, sashes: u32) -> Mesh {
    let d = t / 2.0;
    let mut m = glazing("frame.dark", w, h, sashes, (-0.035, 0.025));
    let c = 0.05;
    // A narrow architrave hides the joint on both sides.
    for y in [-d - 0.012, d + 0.0005] {
        m.add(frame("frame.dark", (-w / 2.0 - c, -c, w / 2.0 + c, h + c), c, (y, y + 0.0115)));
    }
    m
}

/// A glazed double door, shut.
pub(crate) fn entrance(w: f64, h: f64) -> Mesh {
    let mut m = glazing("frame.dark", w, h, 2, (-0.05, 0.01));
    for s in [-1.0, 1.0] {
        let x = 0.07 * s;
        for y in [-0.09, 0.075] {
            m.add(tube("metal.steel", &[v(x, y, 0.75), v(x, y, 1.35)], 0.013, 5));
            for z in [0.85, 1.25] {
                let (a, b) = if y < 0.0 { (y, -0.036) } else { (0.02, y) };
                m.add(tube("metal.steel", &[v(x, a, z), v(x, b, z)], 0.008, 5));
            }
        }
    }
    m
}

/// The casing (architraves) of a doorway on both faces of its wall.
pub(crate) fn casing(w: f64, h: f64, t: f64) -> Mesh {
    let (c, e) = (0.07, w / 2.0);
    let mut m = Mesh::new();
    for (y0, y1) in [(-t / 2.0 - 0.0155, -t / 2.0 - 0.0005), (t / 2.0 + 0.0005, t / 2.0 + 0.0155)] {
        m.add(cuboid("trim.white", v(-e - c, y0, 0.001), v(-e, y1, h)));
        m.add(cuboid("trim.white", v(e, y0, 0.001), v(e + c, y1, h)));
        m.add(cuboid("trim.white", v(-e - c, y0, h), v(e + c, y1, h + c)));
    }
    m
}

/// The leaf of a doorway, if it has one: name of its mesh, pose, mesh.
pub(crate) fn hung(o: &Opening) -> Option<(String, Placement, Mesh)> {
    match o.filling {
        Filling::Doorway(Some(l)) => {
            let (copy, mesh) = leaf(o, &l);
            Some((l.paint.replace('.', "-leaf-"), copy, mesh))
        }
        Filling::Shut(paint) => {
            // Nearly as wide as its opening, in the middle of the wall.
            let width = o.span.1 - o.span.0;
            let mesh = leaf_mesh(paint).scaled((width - 0.014) / LEAF_WIDTH, 1.0, 1.0);
            let (low, middle) = (o.span.0 + 0.009, f64::midpoint(o.band.0, o.band.1));
            let (x, y, turn) = if o.along_x { (low, middle, 0.0) } else { (middle, low, 90.0) };
            let name = paint.replace('.', "-shut-");
            Some((name, Placement::new(x, y, o.height.0 + 0.008, turn), mesh))
        }
        _ => None,
    }
}

/// The leaf of an opening where it stands: pose and mesh (hinge at the origin, leaf along +x).
pub fn leaf(o: &Opening, leaf: &Leaf) -> (Placement, Mesh) {
    let a = leaf.angle;
    let low = leaf.hinge_low;
    let turn = match leaf.into {
        Side::North if low => a,
        Side::North => 180.0 - a,
        Side::South if low => -a,
        Side::South => 180.0 + a,
        Side::East if low => 90.0 - a,
        Side::East => a - 90.0,
        Side::West if low => 90.0 + a,
        Side::West => -90.0 - a,
    };
    let along = if low { o.span.0 + HINGE } else { o.span.1 - HINGE };
    let across = match leaf.into {
        Side::North | Side::East => o.band.1 + 0.02,
        Side::South | Side::West => o.band.0 - 0.02,
    };
    let (x, y) = if o.along_x { (along, across) } else { (across, along) };
    (Placement::new(x, y, o.height.0 + 0.008, turn), leaf_mesh(leaf.paint))
}

fn leaf_mesh(paint: Paint) -> Mesh {
    let (w, h, t) = (LEAF_WIDTH, 2.075, 0.019);
    let mut m = rounded(paint, v(0.0, -t, 0.0), v(w, t, h), 0.004, 1);
    for side in [-1.0, 1.0] {
        // Two raised panels with a moulding.
        for (z0, z1) in [(0.16, 0.88), (1.14, 1.94)] {
            let (x0, x1) = (0.13, w - 0.13);
            let y = |a: f64, b: f64| if side > 0.0 { (a, b) } else { (-b, -a) };
            let (a, b) = y(t + 0.0005, t + 0.007);
            m.add(rounded(paint, v(x0, a, z0), v(x1, b, z1), 0.006, 1));
        }
        let (x, z) = (w - 0.065, 1.02);
        let y = t * side;
        let rose =
            lathe("metal.steel", &[(0.0, 0.0), (0.026, 0.0), (0.024, 0.008), (0.0, 0.008)], 12);
        let facing = if side > 0.0 { -90.0 } else { 90.0 };
        m.add(rose.tipped(facing).at(x, y + 0.0005 * side, z));
        let lever = [
            v(x, y + 0.008 * side, z),
            v(x, y + 0.045 * side, z),
            v(x - 0.012, y + 0.055 * side, z),
            v(x - 0.12, y + 0.055 * side, z - 0.004),
        ];
        m.add(tube("metal.steel", &crate::mesh::curve(&lever, 2), 0.009, 5));
    }
    for z in [0.25, 1.85] {
        m.add(tube("metal.steel", &[v(-0.006, 0.0, z), v(-0.006, 0.0, z + 0.09)], 0.007, 6));
    }
    m
}

/// Skirting boards around every room except the stairwell.
fn skirting(plan: &Plan) -> Mesh {
    let mut mesh = Mesh::new();
    let (thick, tall) = (0.012, 0.085);
    for room in &plan.rooms {
        if room.name == "stairwell" {
            continue;
        }
        let paint = if room.walls[0].starts_with("tile") { "tile.white" } else { "trim.white" };
        let mut boards = Mesh::new();
        for (k, r) in room.rects.iter().enumerate() {
            for side in [Side::West, Side::East, Side::South, Side::North] {
                let along_x = matches!(side, Side::South | Side::North);
                let wall = match side {
                    Side::West => r.x0,
                    Side::East => r.x1,
                    Side::South => r.y0,
                    Side::North => r.y1,
                };
                let (from, to) = if along_x { (r.x0, r.x1) } else { (r.y0, r.y1) };
                let mut gaps: Vec<(f64, f64)> = plan
                    .openings
                    .iter()
                    .filter(|o| {
                        o.along_x == along_x
                            && (o.height.0 - room.height.0).abs() < 0.1
                            && ((o.band.0 - wall).abs() < 1e-6 || (o.band.1 - wall).abs() < 1e-6)
                    })
                    .map(|o| (o.span.0 - 0.072, o.span.1 + 0.072))
                    .collect();
                for (_, q) in room.rects.iter().enumerate().filter(|&(j, _)| j != k) {
                    let (near, far, a, b) =
                        if along_x { (q.y0, q.y1, q.x0, q.x1) } else { (q.x0, q.x1, q.y0, q.y1) };
                    if (near - wall).abs() < 1e-6 || (far - wall).abs() < 1e-6 {
                        gaps.push((a, b));
                    }
                }
                gaps.sort_by(|a, b| a.0.total_cmp(&b.0));
                let trim = if along_x { 0.0 } else { thick };
                let mut start = from + trim;
                gaps.push((to - trim, to));
                for (a, b) in gaps {
                    let end = a.min(to - trim);
                    if end - start > 0.03 {
                        let (near, far) = match side {
                            Side::West | Side::South => (wall + 0.0005, wall + thick),
                            Side::East | Side::North => (wall - thick, wall - 0.0005),
                        };
                        let (z0, z1) = (room.height.0 + 0.001, room.height.0 + tall);
                        let (low, high) = if along_x {
                            (v(start, near, z0), v(end, far, z1))
                        } else {
                            (v(near, start, z0), v(far, end, z1))
                        };
                        boards.add(cuboid(paint, low, high));
                    }
                    start = start.max(b);
                }
            }
        }
        mesh.add(boards.named(format!("skirting/{}", room.name)));
    }
    mesh
}

/// A flight of `n` risers towards +y from the origin: `n - 1` treads, `width` across +x.
pub(crate) fn flight(n: usize, rise: f64, going: f64, width: f64) -> Mesh {
    let mut m = Mesh::new();
    let steps = n - 1;
    let soffit = |i: usize| (rise * (i as f64 + 0.1) - 0.16).max(0.0);
    let mut at = |x: f64, i: usize, z: f64| m.point(v(x, going * i as f64, z));
    let mut rows = Vec::new();
    for i in 0..=steps {
        // Bottom, the tread before, the tread after; left and right.
        let (b, p, t) = (soffit(i), rise * i as f64, rise * (i + 1) as f64);
        rows.push([0.0, width].map(|x| [at(x, i, b), at(x, i, p.max(b)), at(x, i, t)]));
    }
    for i in 0..steps {
        let ([l, r], [l1, r1]) = (rows[i], rows[i + 1]);
        m.quad([l[2], r[2], r1[1], l1[1]], "floor.oak");
        m.quad([l[1], r[1], r[2], l[2]], "trim.white");
        m.quad([r[0], l[0], l1[0], r1[0]], "wall.white");
        for (a, b, flip) in [(l, l1, true), (r, r1, false)] {
            let ring: Vec<u32> = if i == 0 {
                vec![b[1], a[2], a[0], b[0]]
            } else {
                vec![b[1], a[2], a[1], a[0], b[0]]
            };
            for k in 1..ring.len() - 1 {
                let (p, q) = if flip { (ring[k + 1], ring[k]) } else { (ring[k], ring[k + 1]) };
                m.triangle(ring[0], p, q, "wall.white");
            }
        }
    }
    let [l, r] = rows[steps];
    m.quad([r[0], l[0], l[1], r[1]], "wall.white");
    // The first riser begins on the floor, where bottom and previous tread coincide.
    m.triangles.retain(|t| {
        let [a, b, c] = t.corners.map(|c| m.points[c as usize]);
        (b - a).cross(c - a).length_squared() > 1e-18
    });
    m
}

/// Balusters and handrail from `a` to `b` (feet of the rail).
pub(crate) fn railing(a: glam::DVec3, b: glam::DVec3, count: usize) -> Mesh {
    let up = v(0.0, 0.0, 0.92);
    let mut m = tube("wood.oak", &[a + up, b + up], 0.024, 6);
    for p in [a, b] {
        m.add(soft("wood.oak", 0.05, 0.05, 1.02, 0.008, 1).at(p.x, p.y, p.z));
        m.add(ball("wood.oak", 0.032, 8).at(p.x, p.y, p.z + 1.04));
    }
    for k in 0..count {
        let p = a.lerp(b, (k as f64 + 0.5) / count as f64);
        m.add(tube("metal.dark", &[p + v(0.0, 0.0, 0.012), p + up * 0.985], 0.007, 5));
    }
    m
}

/// Flights, half landings and rails, storey by storey.
fn stairs(plan: &Plan) -> Mesh {
    let Some(well) = plan.room("stairwell").map(|i| plan.rooms[i].rects[0]) else {
        return Mesh::new();
    };
    let (risers, going, width) = (9, 0.28, 1.24);
    let rise = STOREY / (2.0 * risers as f64);
    let run = going * (risers - 1) as f64;
    let (y0, y1) = (STAIR_OPENING, STAIR_OPENING + run);
    let mut m = Mesh::new();
    for storey in 0..plan.storeys - 1 {
        let z = STOREY * f64::from(storey) + 0.001;
        let half = z + STOREY / 2.0;
        let mut s = flight(risers, rise, going, width).at(well.x1 - width - 0.002, y0, z);
        s.add(flight(risers, rise, going, width).turned(180.0).at(
            well.x0 + width + 0.002,
            y1,
            half,
        ));
        let edge = 0.002;
        s.add(cuboid(
            "floor.oak",
            v(well.x0 + edge, y1 + 0.001, half - 0.18),
            v(well.x1 - edge, well.y1 - edge, half),
        ));
        let (a, b) = (well.x1 - width + 0.05, well.x0 + width - 0.05);
        s.add(railing(v(a, y0 + 0.14, z + rise), v(a, y1 - 0.14, half - rise), 14));
        s.add(railing(v(b, y1 - 0.14, half + rise), v(b, y0 + 0.14, z + STOREY - rise), 14));
        s.add(railing(v(b + 0.01, y1 + 0.04, half), v(a - 0.01, y1 + 0.04, half), 3));
        m.add(s.named(format!("stairs/{storey}")));
    }
    // The highest landing needs a guard over the flight below.
    let z = STOREY * f64::from(plan.storeys - 1) + 0.001;
    let y = y0 - 0.06;
    m.add(
        railing(v(well.x0 + width + 0.06, y, z), v(well.x1 - 0.06, y, z), 11).named("stairs/guard"),
    );
    m
}

/// Paving, a canopy, downpipes and a hedge: what the building shows to the street.
fn outside(plan: &Plan) -> Mesh {
    let mut m = Mesh::new();
    let lawn = crate::plan::LAWN;
    let top = STOREY * f64::from(plan.storeys);
    for o in plan.openings.iter().filter(|o| o.filling == Filling::Entrance) {
        let r = o.rect();
        let x = (r.x0 + r.x1) / 2.0;
        let step = Rect::new(x - 1.3, r.y0 - 1.5, x + 1.3, r.y0 - 0.002);
        m.add(rounded(
            "ground.paving",
            v(step.x0, step.y0, lawn + 0.001),
            v(step.x1, step.y1, -0.02),
            0.02,
            1,
        ));
        m.add(rounded(
            "frame.dark",
            v(x - 1.3, r.y0 - 1.3, 2.5),
            v(x + 1.3, r.y0 - 0.002, 2.6),
            0.02,
            1,
        ));
        for s in [-1.2, 1.2] {
            m.add(cylinder("metal.dark", 0.03, 2.52, 8).at(x + s, r.y0 - 1.2, -0.019));
        }
    }
    for (x, y) in [(0.35, -0.06), (23.35, -0.06), (-0.06, 22.6), (12.56, 22.6), (23.76, 12.1)] {
        m.add(tube("metal.steel", &[v(x, y, lawn + 0.05), v(x, y, top)], 0.045, 8));
        let brackets = 2 * plan.storeys;
        for k in 0..brackets {
            let z = top * (f64::from(k) + 0.5) / f64::from(brackets);
            m.add(cylinder("metal.dark", 0.052, 0.03, 8).at(x, y, z));
        }
    }
    m.add(block("facade.plinth", 0.4, 0.4, 0.3).at(-1.5, -1.5, lawn + 0.001));
    m.named("outside")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::is_closed;

    #[test]
    fn flights_and_leaves_are_closed_and_outward() {
        let f = flight(9, 0.172, 0.28, 1.2);
        assert!(is_closed(&f));
        assert!(f.volume() > 0.3, "{}", f.volume());
        let l = leaf_mesh("door.oak");
        assert!(is_closed(&l));
        assert!(l.volume() > 0.05);
    }
}
