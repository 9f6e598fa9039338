//! What carpenters and electricians bring to a storey: windows, casings, skirting, door leaves,
//! flights of stairs, luminaires.

use crate::furnish::Placement;
use crate::joinery::{casing, entrance, flight, hung, railing, screen, window};
use crate::lamps::{LUMENS_PER_AREA, luminaire};
use crate::mesh::{Mesh, cuboid, rounded, v};
use crate::outline::{Convex, Frame, at, shared, turn_of};
use crate::palette::PANEL;
use crate::plan::{Filling, LAWN, Lamp, Opening, Panel};
use crate::storey::{CEILING, Gap, HEIGHT, Light, Storey, Use};

/// Risers and going of a flight of stairs.
pub const RISERS: usize = 18;
const GOING: f64 = 0.26;
/// Length of a flight in plan, metres.
pub const RUN: f64 = GOING * (RISERS - 1) as f64;
/// Where the well above a flight begins, metres from its foot: two metres of head room.
pub const WELL: f64 = 1.25;
/// Width of a flight, metres.
pub const FLIGHT: f64 = 1.2;

/// Windows, casings and skirting of a storey at z = 0.
pub fn trim(storey: &Storey) -> Mesh {
    let mut mesh = Mesh::new();
    for gap in &storey.gaps {
        let (w, h, t) = (gap.width, gap.height.1 - gap.height.0, gap.thick);
        let m = match gap.filling {
            Filling::Window { sashes } => window(w, h, t, sashes),
            Filling::Screen { sashes } => screen(w, h, t, sashes),
            Filling::Entrance => entrance(w, h),
            Filling::Doorway(_) | Filling::Shut(_) => casing(w, h, t),
        };
        let frame = inwards(storey, gap);
        let p = frame.origin;
        mesh.add(m.turned(frame.turn).at(p.x, p.y, gap.height.0));
    }
    mesh.add(skirting(storey));
    mesh
}

/// The frame of a gap, its y axis towards a room where the other side is outside.
fn inwards(storey: &Storey, gap: &Gap) -> Frame {
    let p = gap.frame.point(0.0, gap.thick / 2.0 + 0.05);
    let inside = storey.spaces.iter().any(|s| s.holds(p, 0.0));
    let turn = if inside { gap.frame.turn } else { gap.frame.turn + 180.0 };
    Frame { turn, ..gap.frame }
}

/// The leaf of a doorway, if it has one: name and mesh, and where it hangs above z = 0.
pub fn leaf(gap: &Gap) -> Option<(String, Placement, Mesh)> {
    let (w, t) = (gap.width / 2.0, gap.thick / 2.0);
    let opening = Opening {
        along_x: true,
        band: (-t, t),
        span: (-w, w),
        height: gap.height,
        filling: gap.filling,
    };
    let (name, local, mesh) = hung(&opening)?;
    let p = gap.frame.point(local.position.x, local.position.y);
    let turn = local.turn + gap.frame.turn;
    Some((name, Placement::new(p.x, p.y, local.position.z, turn), mesh))
}

/// Skirting boards along all walls, stopping at doorways.
fn skirting(storey: &Storey) -> Mesh {
    let (thick, tall) = (0.012, 0.085);
    let mut mesh = Mesh::new();
    for space in storey.spaces.iter().filter(|s| s.use_ != Use::Stair) {
        let paint = if space.walls[0].starts_with("tile") { "tile.white" } else { "trim.white" };
        for wall in space.walls() {
            let length = (wall.1 - wall.0).length();
            let mut gaps: Vec<(f64, f64)> = storey
                .gaps
                .iter()
                .filter(|g| g.height.0 < 0.1)
                .filter_map(|g| {
                    let c = g.outline(0.0).0;
                    shared(wall, (c[0], c[1])).or_else(|| shared(wall, (c[2], c[3])))
                })
                .map(|(a, b)| (a - 0.072, b + 0.072))
                .chain([(length - thick, length)])
                .collect();
            gaps.sort_by(|a, b| a.0.total_cmp(&b.0));
            let mut from = thick;
            for (a, b) in gaps {
                let end = a.min(length - thick);
                if end - from > 0.03 {
                    let board = cuboid(paint, v(from, 0.0005, 0.001), v(end, thick, tall));
                    mesh.add(board.turned(turn_of(wall.1 - wall.0)).at(wall.0.x, wall.0.y, 0.0));
                }
                from = from.max(b);
            }
        }
    }
    mesh
}

/// The flights from this storey to the next, with their rails.
pub fn stairs(storey: &Storey) -> Mesh {
    let mut mesh = Mesh::new();
    let rise = HEIGHT / RISERS as f64;
    for f in &storey.flights {
        let mut m = flight(RISERS, rise, GOING, FLIGHT).at(0.0, -0.002, 0.001);
        let x = FLIGHT - 0.05;
        m.add(railing(v(x, 0.15, rise), v(x, RUN - 0.15, HEIGHT - rise), 26));
        mesh.add(m.turned(f.turn).at(f.origin.x, f.origin.y, 0.0));
    }
    mesh
}

/// The guards around the wells in a storey's floor.
pub fn guards(storey: &Storey) -> Mesh {
    let mut mesh = Mesh::new();
    for f in &storey.flights {
        let x = FLIGHT + 0.1;
        let mut m = railing(v(x, WELL - 0.06, 0.001), v(x, RUN - 0.1, 0.001), 22);
        m.add(railing(v(0.05, WELL - 0.06, 0.001), v(x - 0.06, WELL - 0.06, 0.001), 8));
        mesh.add(m.turned(f.turn).at(f.origin.x, f.origin.y, 0.0));
    }
    mesh
}

/// Lawn around the building and steps at its entrances.
pub fn outside(footprint: &[Convex], storey: &Storey) -> Mesh {
    let corners = footprint.iter().map(Convex::bounds);
    let (low, high) =
        corners.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or((at(0.0, 0.0), at(0.0, 0.0)));
    let mut m = cuboid(
        "ground.lawn",
        v(low.x - 4.0, low.y - 4.0, -0.6),
        v(high.x + 4.0, high.y + 4.0, LAWN),
    );
    for gap in storey.gaps.iter().filter(|g| g.filling == Filling::Entrance) {
        let frame = inwards(storey, gap);
        let wide = gap.width / 2.0 + 0.5;
        let near = -gap.thick / 2.0 - 0.002;
        let step = rounded(
            "ground.paving",
            v(-wide, near - 1.5, LAWN + 0.001),
            v(wide, near, -0.02),
            0.02,
            1,
        );
        m.add(step.turned(frame.turn).at(frame.origin.x, frame.origin.y, 0.0));
    }
    m
}

/// The luminaires of a room: how they are listed, and each one's mesh and place under the ceiling.
pub fn lamps(light: &Light, area: f64) -> (Lamp, Vec<(Mesh, Placement)>) {
    let count = if light.each { light.points.len() as u32 } else { 1 };
    let lumens = (area * LUMENS_PER_AREA / f64::from(count) / 100.0).round().max(4.0) * 100.0;
    let points: Vec<(f64, f64)> = light.points.iter().map(|p| (p.x, p.y)).collect();
    let lamp = Lamp {
        panel: light.panel,
        points,
        along_y: false,
        z: CEILING,
        lumens,
        count,
        colour: light.colour,
    };
    let hang = |p: glam::DVec2, mesh: Mesh| {
        let copy = Placement { is_lamp: true, ..Placement::new(p.x, p.y, CEILING, light.turn) };
        (mesh, copy)
    };
    let origin = light.points[0];
    let all = if light.each {
        let one = luminaire(&Lamp { points: vec![(0.0, 0.0)], ..lamp.clone() });
        light.points.iter().map(|&p| hang(p, one.clone())).collect()
    } else {
        let frame = Frame { origin, turn: light.turn };
        let digits = |c: f64| libm::round(c * 1e4) / 1e4;
        let local = light.points.iter().map(|&p| frame.local(p));
        let points = local.map(|p| (digits(p.x), digits(p.y))).collect();
        vec![hang(origin, luminaire(&Lamp { points, ..lamp.clone() }))]
    };
    (lamp, all)
}

/// Area of the emitting side of a luminaire, square metres.
pub fn panel_area(mesh: &Mesh) -> f64 {
    (0..mesh.triangles.len())
        .filter(|&i| mesh.triangles[i].paint == PANEL)
        .map(|i| {
            let [a, b, c] = mesh.corners(i);
            (b - a).cross(c - a).length() / 2.0
        })
        .sum()
}

/// `nx` by `ny` panels over the rectangle `x0, y0, x1, y1` of a frame, each a luminaire of its own
/// or all joined: the rows run to and fro, so that one rail can do it.
pub fn grid(
    frame: &Frame,
    (x0, y0, x1, y1): (f64, f64, f64, f64),
    (nx, ny): (u32, u32),
    panel: Panel,
    each: bool,
    colour: [f64; 3],
) -> Light {
    let mut points = Vec::new();
    for j in 0..ny {
        for i in 0..nx {
            let i = if j % 2 == 1 { nx - 1 - i } else { i };
            let x = x0 + (x1 - x0) * (f64::from(i) + 0.5) / f64::from(nx);
            let y = y0 + (y1 - y0) * (f64::from(j) + 0.5) / f64::from(ny);
            points.push(frame.point(x, y));
        }
    }
    Light { panel, points, each, turn: frame.turn, colour }
}
