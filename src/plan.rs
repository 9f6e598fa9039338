//! `enfilade inspect --plan`: floor plans, storey by storey, as one SVG.
//!
//! A plan is a section through the BSP at 1.2 m above the floor: the root's rectangle is cut by the nodes' planes
//! on its way down the tree, and what arrives at a leaf has that leaf's room. Nothing but the tables is needed.

use std::collections::BTreeMap;
use std::fmt::Write;

use enf_layout::NONE;
use enf_layout::bsp::{LEAF, LEAF_OUTSIDE, LEAF_SOLID};
use enf_stage::tables::Tables;
use enf_stage::{Failure, Result};

/// Height of the section above the floor, m.
const SECTION: f64 = 1.2;
/// Height of the eyes, at which rooms have their inside point, m.
const EYES: f64 = 1.6;
/// Floors within this height belong to one storey, m.
const STOREY: f64 = 1.5;
/// Smaller rooms have no label, m2.
const LEAST_LABEL: f64 = 0.5;
/// Openings below this are not drawn, m.
const LEAST_OPENING: f64 = 0.05;
/// Width of a whole sheet of plans, pixels.
const SHEET: f64 = 1600.0;
/// Most storeys in one picture.
const MOST_STOREYS: usize = 200;

type Point = [f64; 2];

/// One storey: its floor, and where it is cut.
struct Storey {
    floor: f64,
    level: f64,
    rooms: Vec<u32>,
}

/// A piece of the section.
struct Piece {
    room: u32,
    solid: bool,
    corners: Vec<Point>,
}

/// Draws all storeys of a partitioned building.
///
/// # Errors
/// Exit 4 when the store's BSP is damaged, or has no room.
pub(crate) fn draw(tables: &Tables) -> Result<String> {
    tables.bsp()?;
    let storeys = storeys(tables);
    if storeys.is_empty() {
        return Err(Failure::input("there is no room to draw: all is outside")
            .with_hint("--rooms N cuts the outside into rooms"));
    }
    // The box of all rooms.
    let (mut lo, mut hi) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for (_, room) in indoors(tables) {
        for k in 0..2 {
            lo[k] = lo[k].min(f64::from(room.min[k]) - 1.0);
            hi[k] = hi[k].max(f64::from(room.max[k]) + 1.0);
        }
    }
    let size = [hi[0] - lo[0], hi[1] - lo[1]];
    let columns = columns(storeys.len(), size);
    let rows = storeys.len().div_ceil(columns);
    let scale = (SHEET / (size[0] * columns as f64)).clamp(2.0, 60.0);
    let (head, foot) = (30.0, 50.0);
    let (cell_x, cell_y) = (size[0] * scale + 20.0, size[1] * scale + head + 10.0);
    let (width, height) = (cell_x * columns as f64 + 20.0, cell_y * rows as f64 + head + foot);
    let mut svg = String::new();
    let mut put = |text: &str| {
        svg.push_str(text);
        svg.push('\n');
    };
    put(&format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 {width:.0} \
         {height:.0}\" font-family=\"Helvetica, Arial, sans-serif\">"
    ));
    put(&format!("<rect width=\"{width:.0}\" height=\"{height:.0}\" fill=\"#fff\"/>"));
    put(&format!(
        "<text x=\"20\" y=\"22\" font-size=\"16\" font-weight=\"bold\">{}: {} rooms, {} lights</text>",
        escaped(&tables.names.scene),
        tables.rooms_without_outside(),
        tables.lights().len()
    ));
    for (i, storey) in storeys.iter().enumerate() {
        let x = 20.0 + cell_x * (i % columns) as f64;
        let y = head + cell_y * (i / columns) as f64;
        put(&format!("<g transform=\"translate({x:.2} {y:.2})\">"));
        put(&format!(
            "<text x=\"0\" y=\"18\" font-size=\"13\" fill=\"#333\">Storey {}: floor at {:.2} m, {} rooms, cut at {:.2} m</text>",
            i + 1,
            storey.floor + tables.scene.origin[2],
            storey.rooms.len(),
            storey.level + tables.scene.origin[2]
        ));
        put(&format!("<g transform=\"translate(0 {head})\">"));
        let view = View { lo, hi, scale };
        put(&plan(tables, storey, storeys.get(i + 1).map(|s| s.floor), &view));
        put("</g></g>");
    }
    put(&legend(20.0, height - foot + 10.0, scale));
    put("</svg>");
    Ok(svg)
}

/// From metres to pixels.
struct View {
    lo: Point,
    hi: Point,
    scale: f64,
}

impl View {
    fn at(&self, p: Point) -> Point {
        [(p[0] - self.lo[0]) * self.scale, (self.hi[1] - p[1]) * self.scale]
    }

    fn path(&self, corners: &[Point]) -> String {
        let mut d = String::new();
        for (i, &c) in corners.iter().enumerate() {
            let [x, y] = self.at(c);
            let _ = write!(d, "{}{x:.1} {y:.1}", if i == 0 { 'M' } else { 'L' });
        }
        d.push('Z');
        d
    }
}

fn indoors(tables: &Tables) -> impl Iterator<Item = (u32, &enf_layout::room::RoomRecord)> {
    let rooms = tables.rooms().iter().enumerate().map(|(i, r)| (i as u32, r));
    rooms.filter(|(_, r)| r.flags & LEAF_OUTSIDE == 0)
}

/// Rooms by the height of their floors.
fn storeys(tables: &Tables) -> Vec<Storey> {
    let mut floors: Vec<(f64, u32)> = indoors(tables)
        .map(|(id, r)| {
            // Low rooms have their inside point half way up.
            let eyes = f64::from(r.inside[2]);
            ((eyes - EYES).max(f64::from(r.min[2])), id)
        })
        .collect();
    floors.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut storeys: Vec<Storey> = Vec::new();
    for (floor, id) in floors {
        match storeys.last_mut() {
            Some(s) if floor - s.floor < STOREY => s.rooms.push(id),
            _ => storeys.push(Storey { floor, level: floor + SECTION, rooms: vec![id] }),
        }
    }
    // Cut where most of the storey is cut: at the floor that has most area.
    for storey in &mut storeys {
        let mut areas: BTreeMap<i64, f64> = BTreeMap::new();
        for &id in &storey.rooms {
            let r = &tables.rooms()[id as usize];
            let floor = (f64::from(r.inside[2]) - EYES).max(f64::from(r.min[2]));
            *areas.entry((floor * 20.0).round() as i64).or_default() += f64::from(r.floor_area_m2);
        }
        let mut best = (0.0, 0);
        for (floor, area) in areas {
            if area > best.0 {
                best = (area, floor);
            }
        }
        storey.floor = best.1 as f64 / 20.0;
        storey.level = storey.floor + SECTION;
        storey.rooms.sort_unstable();
    }
    storeys.truncate(MOST_STOREYS);
    storeys
}

/// How many plans stand side by side, so that the sheet looks most like a sheet of paper.
fn columns(count: usize, size: Point) -> usize {
    let mut best = (f64::INFINITY, 1);
    for columns in 1..=count {
        let rows = count.div_ceil(columns);
        let ratio = (columns as f64 * size[0]) / (rows as f64 * size[1]);
        let off = (ratio / 1.414).max(1.414 / ratio);
        if off < best.0 {
            best = (off, columns);
        }
    }
    best.1
}

/// The section of the whole tree at a height.
fn section(tables: &Tables, z: f64, view: &View) -> Vec<Piece> {
    let (lo, hi) = (view.lo, view.hi);
    let start = vec![[lo[0], lo[1]], [hi[0], lo[1]], [hi[0], hi[1]], [lo[0], hi[1]]];
    let root = if tables.nodes().is_empty() { LEAF } else { 0 };
    let mut stack = vec![(root, start)];
    let mut pieces = Vec::new();
    while let Some((at, corners)) = stack.pop() {
        if corners.len() < 3 {
            continue;
        }
        if at & LEAF != 0 {
            if let Some(leaf) = tables.leaves().get((at & !LEAF) as usize)
                && leaf.flags & LEAF_OUTSIDE == 0
            {
                let solid = leaf.flags & LEAF_SOLID != 0;
                pieces.push(Piece { room: leaf.room, solid, corners });
            }
            continue;
        }
        // The tables were checked: nodes and planes are in range.
        let node = &tables.nodes()[at as usize];
        let plane = &tables.planes()[node.plane as usize];
        let n = [plane.normal[0], plane.normal[1]];
        let d = plane.offset - plane.normal[2] * z;
        stack.push((node.front, half(&corners, n, d, 1.0)));
        stack.push((node.back, half(&corners, n, d, -1.0)));
    }
    pieces
}

/// The part of a convex polygon where `sign * (n.p - d) >= 0`.
fn half(corners: &[Point], n: Point, d: f64, sign: f64) -> Vec<Point> {
    let side = |p: Point| sign * (n[0] * p[0] + n[1] * p[1] - d);
    let mut out = Vec::with_capacity(corners.len() + 1);
    let Some(&last) = corners.last() else { return out };
    let (mut a, mut sa) = (last, side(last));
    for &b in corners {
        let sb = side(b);
        if (sa < 0.0 && sb > 0.0) || (sa > 0.0 && sb < 0.0) {
            let t = sa / (sa - sb);
            out.push([a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t]);
        }
        if sb >= 0.0 {
            out.push(b);
        }
        (a, sa) = (b, sb);
    }
    out
}

fn area(corners: &[Point]) -> f64 {
    let mut sum = 0.0;
    for i in 0..corners.len() {
        let (a, b) = (corners[i], corners[(i + 1) % corners.len()]);
        sum += a[0] * b[1] - a[1] * b[0];
    }
    (sum * 0.5).abs()
}

fn middle(corners: &[Point]) -> Point {
    let n = corners.len().max(1) as f64;
    let sum = corners.iter().fold([0.0; 2], |s, c| [s[0] + c[0], s[1] + c[1]]);
    [sum[0] / n, sum[1] / n]
}

/// A light colour, as `#rrggbb`; neighbouring numbers have different ones.
fn colour(room: u32) -> String {
    let hue = (f64::from(room) * 137.508) % 360.0 / 60.0;
    let lightness = 0.78 + f64::from(room % 3) * 0.05;
    let chroma = 0.62 * (1.0 - (2.0 * lightness - 1.0).abs());
    let second = chroma * (1.0 - (hue % 2.0 - 1.0).abs());
    let rgb = match hue as u32 {
        0 => [chroma, second, 0.0],
        1 => [second, chroma, 0.0],
        2 => [0.0, chroma, second],
        3 => [0.0, second, chroma],
        4 => [second, 0.0, chroma],
        _ => [chroma, 0.0, second],
    };
    let byte = |x: f64| ((x + lightness - 0.5 * chroma) * 255.0).round().clamp(0.0, 255.0) as u8;
    let [r, g, b] = rgb.map(byte);
    format!("#{r:02x}{g:02x}{b:02x}")
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

fn plan(tables: &Tables, storey: &Storey, above: Option<f64>, view: &View) -> String {
    let mut out = String::new();
    let mut put = |text: String| {
        out.push_str(&text);
        out.push('\n');
    };
    // One path per room, and one for all walls.
    let mut rooms: BTreeMap<u32, (String, f64, (f64, Point))> = BTreeMap::new();
    let mut walls = String::new();
    for piece in section(tables, storey.level, view) {
        let d = view.path(&piece.corners);
        if piece.solid {
            walls.push_str(&d);
            continue;
        }
        let a = area(&piece.corners);
        let room = rooms.entry(piece.room).or_insert((String::new(), 0.0, (0.0, [0.0; 2])));
        room.0.push_str(&d);
        room.1 += a;
        if a > room.2.0 {
            room.2 = (a, middle(&piece.corners));
        }
    }
    for (room, (d, ..)) in &rooms {
        let c = colour(*room);
        put(format!("<path d=\"{d}\" fill=\"{c}\" stroke=\"{c}\" stroke-width=\"0.6\"/>"));
    }
    if !walls.is_empty() {
        put(format!(
            "<path d=\"{walls}\" fill=\"#454545\" stroke=\"#454545\" stroke-width=\"0.6\"/>"
        ));
    }
    openings(tables, storey.level, view, &mut put);
    let top = above.unwrap_or(f64::INFINITY);
    for light in tables.lights() {
        let z = f64::from(light.position[2]);
        let lowest = if tables.rooms().is_empty() { 0.0 } else { storey.floor - 0.2 };
        if z < lowest || z >= top {
            continue;
        }
        let [x, y] = view.at([f64::from(light.position[0]), f64::from(light.position[1])]);
        let r = (0.14 * view.scale).clamp(1.5, 6.0);
        put(format!(
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{r:.1}\" fill=\"#ffd400\" stroke=\"#8a6d00\" stroke-width=\"0.6\"/>"
        ));
    }
    for (&id, &(_, cut, (largest, at))) in &rooms {
        if cut < LEAST_LABEL {
            continue;
        }
        let room = &tables.rooms()[id as usize];
        // Of its own storey, the room's floor area; of others that it goes through, what is cut there.
        let own = storey.rooms.binary_search(&id).is_ok();
        let floor = if own { f64::from(room.floor_area_m2) } else { cut };
        let size = (largest.sqrt() * view.scale * 0.2).clamp(5.0, 15.0);
        let [x, y] = view.at(at);
        put(format!(
            "<text x=\"{x:.1}\" y=\"{:.1}\" font-size=\"{size:.1}\" text-anchor=\"middle\" font-weight=\"bold\">{id}</text>",
            y
        ));
        put(format!(
            "<text x=\"{x:.1}\" y=\"{:.1}\" font-size=\"{:.1}\" text-anchor=\"middle\">{floor:.1} m\u{b2}</text>",
            y + size * 0.95,
            size * 0.75
        ));
    }
    out
}

/// Portals that the section cuts: blue to the outside, red inside, each with its area.
fn openings(tables: &Tables, z: f64, view: &View, put: &mut impl FnMut(String)) {
    let outside = tables.scene.outside;
    for portal in tables.portals().iter().filter(|p| p.room < p.other) {
        let out = outside != NONE && (portal.room == outside || portal.other == outside);
        let colour = if out { "#1d5fd0" } else { "#d81e1e" };
        let first = portal.first_piece as usize;
        let (mut longest, mut at) = (0.0, None);
        for piece in &tables.pieces()[first..first + portal.piece_count as usize] {
            let corners = &piece.corners[..(piece.count as usize).min(piece.corners.len())];
            let mut ends: Vec<Point> = Vec::new();
            for i in 0..corners.len() {
                let a = corners[i].map(f64::from);
                let b = corners[(i + 1) % corners.len()].map(f64::from);
                if (a[2] < z) != (b[2] < z) {
                    let t = (z - a[2]) / (b[2] - a[2]);
                    ends.push([a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t]);
                }
            }
            let &[a, b] = ends.as_slice() else { continue };
            let length = ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt();
            if length < LEAST_OPENING {
                continue;
            }
            let ([x0, y0], [x1, y1]) = (view.at(a), view.at(b));
            put(format!(
                "<path d=\"M{x0:.1} {y0:.1}L{x1:.1} {y1:.1}\" stroke=\"{colour}\" stroke-width=\"{:.1}\" fill=\"none\"/>",
                (0.09 * view.scale).clamp(1.2, 3.0)
            ));
            if length > longest {
                (longest, at) = (length, Some(view.at(middle(&[a, b]))));
            }
        }
        if let Some([x, y]) = at {
            let size = (0.28 * view.scale).clamp(3.5, 8.0);
            put(format!(
                "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"{size:.1}\" fill=\"{colour}\">{:.1}</text>",
                x + 2.5,
                y - 2.5,
                portal.area_m2
            ));
        }
    }
}

fn legend(x: f64, y: f64, scale: f64) -> String {
    // A round length of about 120 pixels.
    let wanted = 120.0 / scale;
    let lengths = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0];
    let metres = lengths.into_iter().find(|&l| l >= wanted * 0.6).unwrap_or(1000.0);
    let end = x + metres * scale;
    let mut out = format!(
        "<path d=\"M{x:.1} {:.1}V{y:.1}H{end:.1}V{:.1}\" stroke=\"#000\" fill=\"none\" transform=\"translate(0 8)\"/>\n\
         <text x=\"{:.1}\" y=\"{:.1}\" font-size=\"11\">{metres:.0} m</text>\n",
        y - 5.0,
        y - 5.0,
        end + 6.0,
        y + 11.0
    );
    let mut at = end + 70.0;
    for (mark, words) in [
        ("<rect y=\"-4\" width=\"18\" height=\"8\" fill=\"#454545\"/>", "wall"),
        (
            "<path d=\"M0 0H18\" stroke=\"#d81e1e\" stroke-width=\"3\"/>",
            "opening between rooms, m\u{b2}",
        ),
        (
            "<path d=\"M0 0H18\" stroke=\"#1d5fd0\" stroke-width=\"3\"/>",
            "window or door to the outside, m\u{b2}",
        ),
        ("<circle cx=\"9\" r=\"5\" fill=\"#ffd400\" stroke=\"#8a6d00\"/>", "light"),
    ] {
        let _ = writeln!(
            out,
            "<g transform=\"translate({at:.1} {:.1})\">{mark}<text x=\"24\" y=\"4\" font-size=\"11\">{words}</text></g>",
            y + 6.0
        );
        at += 50.0 + 6.2 * words.len() as f64;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_make_a_whole() {
        let square = vec![[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]];
        let n = [0.6, 0.8];
        let (a, b) = (half(&square, n, 1.0, 1.0), half(&square, n, 1.0, -1.0));
        assert!((area(&a) + area(&b) - 4.0).abs() < 1e-12);
        assert!(half(&square, [1.0, 0.0], 5.0, 1.0).is_empty());
        assert_eq!(half(&square, [0.0, 0.0], -1.0, 1.0).len(), 4);
    }

    #[test]
    fn sheets_look_like_paper() {
        assert_eq!(columns(1, [10.0, 50.0]), 1);
        assert_eq!(columns(2, [10.0, 10.0]), 2);
        assert_eq!(columns(2, [60.0, 10.0]), 1);
        assert_eq!(columns(12, [10.0, 10.0]), 4);
    }

    #[test]
    fn a_view_turns_y_upside_down() {
        let view = View { lo: [1.0, 2.0], hi: [5.0, 10.0], scale: 10.0 };
        assert_eq!(view.at([1.0, 10.0]), [0.0, 0.0]);
        assert_eq!(view.at([2.0, 9.0]), [10.0, 10.0]);
        assert_eq!(view.path(&[[1.0, 10.0], [2.0, 9.0]]), "M0.0 0.0L10.0 10.0Z");
        assert_eq!(escaped("a<b & c>"), "a&lt;b &amp; c&gt;");
    }
}
