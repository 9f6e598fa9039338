//! Walls and slabs of a storey whose walls run at any angle.
//!
//! Everything that is not room or opening is solid. Each side of a room (and of the footprint,
//! inside out) is cut into columns at every jamb and corner; floors and ceilings fan out from the
//! middle of convex pieces over the same points. So all faces share their vertices, and base,
//! storeys and roof stacked on each other are one closed outward solid.

use crate::mesh::{Mesh, Paint, v};
use crate::outline::{Convex, SAME, boundary, shared};
use crate::plan::{Filling, LAWN};
use crate::storey::{CEILING, Gap, HEIGHT, Storey};
use glam::{DVec2, DVec3};
use std::collections::{BTreeMap, BTreeSet};

/// How far foundations go below the floor of the ground storey, metres.
const FOUNDATION: f64 = 0.45;
/// Height and thickness of the parapet, metres.
const PARAPET: (f64, f64) = (0.5, 0.25);

/// Which slab of a storey has wells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Wells {
    /// The slab below: there is a storey below.
    pub below: bool,
    /// The slab above: there is a storey above.
    pub above: bool,
}

/// A side of a room or of the footprint, the open space on its left.
struct Face {
    from: DVec2,
    to: DVec2,
    /// Whether it is the outer face of the building.
    outside: bool,
    /// Distances from `from` at which columns end.
    splits: Vec<f64>,
    /// Ranges where another piece goes on: no wall.
    joints: Vec<(f64, f64)>,
    /// What is open: range along the side, range of heights.
    cuts: Vec<((f64, f64), (f64, f64))>,
    /// Bottom and top.
    height: (f64, f64),
    paint: Paint,
}

impl Face {
    fn point(&self, s: f64) -> DVec2 {
        let length = (self.to - self.from).length();
        if s <= 0.0 {
            self.from
        } else if s >= length {
            self.to
        } else {
            self.from + (self.to - self.from) * (s / length)
        }
    }

    /// No wall at the joints, at these heights.
    fn open_joints(&mut self, height: (f64, f64)) {
        for &(a, b) in &self.joints {
            self.splits.extend([a, b]);
            self.cuts.push(((a, b), height));
        }
    }

    /// The range that a gap's opening takes of this side, if it does.
    fn range(&self, gap: &Gap) -> Option<(f64, f64)> {
        let outline = gap.outline(0.0);
        let c = &outline.0;
        // The sides of the opening along the wall, the space behind on their left.
        [(c[1], c[0]), (c[3], c[2])].into_iter().find_map(|side| {
            let found = shared((self.from, self.to), (side.1, side.0))?;
            let mid = f64::midpoint(found.0, found.1);
            let wall = self.joints.iter().all(|&(low, high)| mid < low || mid > high);
            (wall && (found.1 - found.0 - gap.width).abs() < SAME).then_some(found)
        })
    }
}

/// Meshes with shared vertices: points by their place to a hundredth of a millimetre.
#[derive(Default)]
struct Weld {
    mesh: Mesh,
    index: BTreeMap<[i64; 3], u32>,
    /// Heights at which something ends, by place in plan.
    lines: BTreeMap<[i64; 2], BTreeSet<i64>>,
}

/// A coordinate as a key. The offset keeps round numbers away from where rounding turns.
fn key(c: f64) -> i64 {
    libm::floor(c * 1e5 + 0.263) as i64
}

impl Weld {
    fn vertex(&mut self, p: DVec2, z: f64) -> u32 {
        let mesh = &mut self.mesh;
        *self
            .index
            .entry([key(p.x), key(p.y), key(z)])
            .or_insert_with(|| mesh.point(v(p.x, p.y, z)))
    }

    fn mark(&mut self, p: DVec2, heights: [f64; 2]) {
        self.lines.entry([key(p.x), key(p.y)]).or_default().extend(heights.map(key));
    }

    /// Heights on the line over `p` strictly between `low` and `high`, rising.
    fn between(&self, p: DVec2, low: f64, high: f64) -> Vec<f64> {
        let Some(all) = self.lines.get(&[key(p.x), key(p.y)]) else { return Vec::new() };
        all.range(key(low) + 1..key(high)).map(|&k| k as f64 * 1e-5).collect()
    }

    /// A polygon: a triangle or quadrilateral as it is, more corners around their middle.
    fn polygon(&mut self, corners: &[u32], paint: Paint) {
        match *corners {
            [a, b, c] => self.mesh.triangle(a, b, c, paint),
            [a, b, c, d] => self.mesh.quad([a, b, c, d], paint),
            _ => {
                let sum: DVec3 = corners.iter().map(|&i| self.mesh.points[i as usize]).sum();
                let centre = self.mesh.point(sum / corners.len() as f64);
                for (k, &a) in corners.iter().enumerate() {
                    self.mesh.triangle(centre, a, corners[(k + 1) % corners.len()], paint);
                }
            }
        }
    }

    /// A horizontal face over the outline through `ring`, looking up or down.
    fn level(&mut self, ring: &[DVec2], z: f64, up: bool, paint: Paint) {
        let mut corners: Vec<u32> = ring.iter().map(|&p| self.vertex(p, z)).collect();
        if !up {
            corners.reverse();
        }
        self.polygon(&corners, paint);
    }
}

/// The carcass of a building: what its storeys' shells have in common.
pub struct Carcass<'a> {
    footprint: &'a [Convex],
    /// Openings of all storeys: every shell has the same columns outside.
    marks: Vec<Gap>,
}

impl<'a> Carcass<'a> {
    /// The carcass over `footprint` for all of `storeys`.
    pub fn new(footprint: &'a [Convex], storeys: &[Storey]) -> Self {
        let marks = storeys.iter().flat_map(|s| s.gaps.iter().copied()).collect();
        Self { footprint, marks }
    }

    /// The outer sides, the open air on their left, with their columns.
    fn outside(&self, height: (f64, f64), paint: Paint) -> Vec<Face> {
        let mut faces = Vec::new();
        for (i, piece) in self.footprint.iter().enumerate() {
            for (p, q) in piece.sides() {
                let joints = self.joints(i, (p, q));
                faces.push(self.face((q, p), &joints, true, height, paint));
            }
        }
        faces
    }

    fn joints(&self, piece: usize, side: (DVec2, DVec2)) -> Vec<(f64, f64)> {
        joints(self.footprint, piece, side)
    }

    /// A footprint side from `p` to `q`; joints are counted from `q`.
    fn face(
        &self,
        (p, q): (DVec2, DVec2),
        joints: &[(f64, f64)],
        outside: bool,
        height: (f64, f64),
        paint: Paint,
    ) -> Face {
        let length = (q - p).length();
        let mut face = Face {
            from: p,
            to: q,
            outside,
            splits: vec![0.0, length],
            joints: joints.iter().map(|&(a, b)| (length - b, length - a)).collect(),
            cuts: Vec::new(),
            height,
            paint,
        };
        face.open_joints(height);
        let marks: Vec<_> = self.marks.iter().filter_map(|g| face.range(g)).collect();
        face.splits.extend(marks.into_iter().flat_map(|(a, b)| [a, b]));
        face
    }

    /// What is under the ground storey: plinth and foundation.
    pub fn base(&self) -> Mesh {
        let mut weld = Weld::default();
        let mut faces = self.outside((LAWN, 0.0), "facade.plinth");
        faces.extend(self.outside((-FOUNDATION, LAWN), "facade.plinth"));
        columns(&mut weld, &mut faces);
        self.levels(&mut weld, -FOUNDATION, false, "soil");
        weld.mesh
    }

    /// What is on the highest storey: the roof at z = 0 and a parapet.
    pub fn roof(&self) -> Mesh {
        let mut weld = Weld::default();
        self.levels(&mut weld, 0.0, true, "roof.gravel");
        let mut mesh = weld.mesh;
        mesh.add(parapet(self.footprint));
        mesh
    }

    fn levels(&self, weld: &mut Weld, z: f64, up: bool, paint: Paint) {
        for (i, piece) in self.footprint.iter().enumerate() {
            let mut ring = Vec::new();
            for (p, q) in piece.sides() {
                let mut face = self.face((q, p), &self.joints(i, (p, q)), true, (0.0, 1.0), paint);
                tidy(&mut face.splits);
                // The face runs the other way.
                ring.extend(
                    face.splits.iter().rev().map(|&s| face.point(s)).take(face.splits.len() - 1),
                );
            }
            weld.level(&ring, z, up, paint);
        }
    }

    /// The shell of a storey at z = 0: rooms, reveals and the outer walls around them.
    pub fn storey(&self, storey: &Storey, wells: Wells) -> Mesh {
        let mut weld = Weld::default();
        let mut faces = self.outside((0.0, HEIGHT), "facade.render");
        // Sides of each piece of each room, for its floor and ceiling.
        let mut rings: Vec<(usize, usize, Vec<usize>)> = Vec::new();
        for (r, space) in storey.spaces.iter().enumerate() {
            let mut wall = 0;
            for (k, piece) in space.pieces.iter().enumerate() {
                let open = wells.above && space.well == Some(k);
                let top = if open { HEIGHT } else { CEILING };
                let mut sides = Vec::new();
                for (p, q) in piece.sides() {
                    let length = (q - p).length();
                    let paint = space.walls[usize::from(wall % 3 == 1)];
                    let mut face = Face {
                        from: p,
                        to: q,
                        outside: false,
                        splits: vec![0.0, length],
                        joints: joints(&space.pieces, k, (p, q)),
                        cuts: Vec::new(),
                        height: (0.0, top),
                        paint,
                    };
                    face.open_joints((0.0, CEILING));
                    wall += usize::from(face.joints.is_empty());
                    sides.push(faces.len());
                    faces.push(face);
                }
                rings.push((r, k, sides));
            }
        }
        let mut found = vec![Vec::new(); storey.gaps.len()];
        for face in &mut faces {
            for (g, gap) in storey.gaps.iter().enumerate() {
                if let Some((a, b)) = face.range(gap) {
                    face.splits.extend([a, b]);
                    face.cuts.push(((a, b), gap.height));
                    found[g].push((face.point(a), face.point(b)));
                }
            }
        }
        columns(&mut weld, &mut faces);
        for (r, k, sides) in rings {
            let mut ring = Vec::new();
            for f in sides {
                let face = &faces[f];
                ring.extend(face.splits.iter().take(face.splits.len() - 1).map(|&s| face.point(s)));
            }
            let space = &storey.spaces[r];
            let well = space.well == Some(k);
            if !(well && wells.below) {
                weld.level(&ring, 0.0, true, space.floor);
            }
            if !(well && wells.above) {
                weld.level(&ring, CEILING, false, "ceiling.white");
            }
        }
        for (gap, ends) in storey.gaps.iter().zip(found) {
            reveal(&mut weld, gap, &ends);
        }
        weld.mesh
    }

    /// Openings of `storey` that do not go from one open space to another, by index: a drawing
    /// must have none.
    pub fn blind(&self, storey: &Storey) -> Vec<usize> {
        let mut faces = self.outside((0.0, HEIGHT), "facade.render");
        for space in &storey.spaces {
            for (k, piece) in space.pieces.iter().enumerate() {
                faces.extend(piece.sides().map(|(from, to)| Face {
                    from,
                    to,
                    outside: false,
                    splits: Vec::new(),
                    joints: joints(&space.pieces, k, (from, to)),
                    cuts: Vec::new(),
                    height: (0.0, CEILING),
                    paint: "wall.white",
                }));
            }
        }
        let sides = |g: &Gap| faces.iter().filter(|f| f.range(g).is_some()).count();
        (0..storey.gaps.len()).filter(|&g| sides(&storey.gaps[g]) != 2).collect()
    }
}

/// Where other pieces touch a side of piece `k`.
fn joints(pieces: &[Convex], k: usize, side: (DVec2, DVec2)) -> Vec<(f64, f64)> {
    pieces
        .iter()
        .enumerate()
        .filter(|&(j, _)| j != k)
        .flat_map(|(_, other)| other.sides().filter_map(|s| shared(side, s)))
        .collect()
}

fn tidy(splits: &mut Vec<f64>) {
    splits.sort_by(f64::total_cmp);
    splits.dedup_by(|a, b| (*a - *b).abs() < SAME);
}

/// Wall columns of all faces.
fn columns(weld: &mut Weld, faces: &mut [Face]) {
    let mut walls: Vec<(DVec2, DVec2, f64, f64, Paint)> = Vec::new();
    for face in faces {
        tidy(&mut face.splits);
        for pair in face.splits.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            let mid = f64::midpoint(a, b);
            let mut open: Vec<(f64, f64)> = face
                .cuts
                .iter()
                .filter(|((low, high), _)| *low < mid && mid < *high)
                .map(|&(_, heights)| heights)
                .collect();
            open.sort_by(|x, y| x.0.total_cmp(&y.0));
            let (p, q) = (face.point(a), face.point(b));
            let mut from = face.height.0;
            for (low, high) in open.into_iter().chain([(face.height.1, face.height.1)]) {
                if low - from > SAME {
                    let paint =
                        if face.outside || from < CEILING { face.paint } else { "ceiling.white" };
                    walls.push((p, q, from, low, paint));
                }
                from = from.max(high);
            }
        }
    }
    for &(p, q, low, high, _) in &walls {
        weld.mark(p, [low, high]);
        weld.mark(q, [low, high]);
    }
    for (p, q, low, high, paint) in walls {
        // Seen from the left of p -> q: up at p, along to q, down again.
        let mut corners = vec![weld.vertex(p, low)];
        for z in weld.between(p, low, high) {
            corners.push(weld.vertex(p, z));
        }
        corners.push(weld.vertex(p, high));
        corners.push(weld.vertex(q, high));
        for z in weld.between(q, low, high).into_iter().rev() {
            corners.push(weld.vertex(q, z));
        }
        corners.push(weld.vertex(q, low));
        weld.polygon(&corners, paint);
    }
}

/// The four faces inside an opening.
fn reveal(weld: &mut Weld, gap: &Gap, ends: &[(DVec2, DVec2)]) {
    let &[a, b] = ends else { return };
    let (x, y) = gap.frame.axes();
    // The side at local -y, then the one at +y; each with its low end first.
    let side = |(p, q): (DVec2, DVec2)| if (q - p).dot(x) > 0.0 { [p, q] } else { [q, p] };
    let (near, far) =
        if (b.0 - a.0).dot(y) > 0.0 { (side(a), side(b)) } else { (side(b), side(a)) };
    let (low, high) = gap.height;
    let mut at = |p: DVec2, z: f64| weld.vertex(p, z);
    let n = [at(near[0], low), at(near[1], low), at(near[1], high), at(near[0], high)];
    let f = [at(far[0], low), at(far[1], low), at(far[1], high), at(far[0], high)];
    let tread = match gap.filling {
        Filling::Doorway(_) | Filling::Shut(_) => "trim.oak",
        Filling::Window { .. } | Filling::Entrance => "stone.sill",
        Filling::Screen { .. } => "trim.white",
    };
    weld.polygon(&[n[0], f[0], f[3], n[3]], "trim.white");
    weld.polygon(&[n[2], f[2], f[1], n[1]], "trim.white");
    weld.polygon(&[n[3], f[3], f[2], n[2]], "trim.white");
    weld.polygon(&[n[1], f[1], f[0], n[0]], tread);
}

/// A parapet along the outline, mitred at its corners, standing on z = 0.
fn parapet(footprint: &[Convex]) -> Mesh {
    let mut mesh = Mesh::new();
    let (tall, thick) = PARAPET;
    let mut sides = boundary(footprint);
    while let Some(first) = sides.pop() {
        // One closed outline after another.
        let mut ring = vec![first];
        while let Some(k) = sides.iter().position(|s| s.0.distance(ring[ring.len() - 1].1) < SAME) {
            ring.push(sides.remove(k));
        }
        let n = ring.len();
        let mut rows: Vec<[u32; 4]> = Vec::new();
        for i in 0..n {
            let corner = ring[i].0;
            let before = {
                let (p, q) = ring[(i + n - 1) % n];
                (q - p).normalize()
            };
            let after = (ring[i].1 - ring[i].0).normalize();
            let bisector = (before.perp() + after.perp()).normalize();
            let inner = corner + bisector * (thick / bisector.dot(after.perp()));
            let mut at = |p: DVec2, z: f64| mesh.point(v(p.x, p.y, z));
            rows.push([at(corner, 0.001), at(inner, 0.001), at(inner, tall), at(corner, tall)]);
        }
        for i in 0..n {
            let (a, b) = (rows[i], rows[(i + 1) % n]);
            for k in 0..4 {
                let j = (k + 1) % 4;
                mesh.quad([a[k], b[k], b[j], a[j]].map(|c| c), "facade.render");
            }
        }
    }
    if mesh.volume() < 0.0 {
        for t in &mut mesh.triangles {
            t.corners.swap(1, 2);
        }
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::is_closed;
    use crate::outline::{Frame, at};
    use crate::storey::{Door, OUTER, Use, WALL, Weight};

    /// Two rooms and a stair, turned by any angle.
    fn house(turn: f64) -> (Vec<Convex>, Storey) {
        let f = Frame { origin: at(11.0, -3.0), turn };
        let mut s = Storey::default();
        let w = Weight::Share(1.0);
        s.space("a", Use::Office, vec![f.rect(0.3, 0.3, 4.0, 5.7)], turn, w);
        let b = s.space(
            "b",
            Use::Stair,
            vec![
                f.rect(4.15, 0.3, 6.0, 5.7),
                f.rect(6.0, 0.3, 7.7, 1.5),
                f.rect(6.0, 1.5, 7.7, 4.5),
                f.rect(6.0, 4.5, 7.7, 5.7),
            ],
            turn,
            w,
        );
        s.spaces[b].well = Some(2);
        s.door(&f, (4.075, 2.0), false, WALL, Door::Open(true));
        s.window(&f, (2.0, 0.15), true, 1.4);
        s.window(&f, (7.85, 3.0), false, 1.8);
        assert!((OUTER - 0.3).abs() < 1e-12);
        (vec![f.rect(0.0, 0.0, 4.0, 6.0), f.rect(4.0, 0.0, 8.0, 6.0)], s)
    }

    #[test]
    fn a_stack_is_one_closed_outward_solid() {
        for turn in [0.0, 45.0, 22.5, 130.0] {
            for floors in 1..=3u32 {
                let (footprint, storey) = house(turn);
                let storeys = [storey];
                let carcass = Carcass::new(&footprint, &storeys);
                assert_eq!(carcass.blind(&storeys[0]), [0usize; 0]);
                let mut all = carcass.base();
                for k in 0..floors {
                    let wells = Wells { below: k > 0, above: k + 1 < floors };
                    all.add(carcass.storey(&storeys[0], wells).at(0.0, 0.0, HEIGHT * f64::from(k)));
                }
                all.add(carcass.roof().at(0.0, 0.0, HEIGHT * f64::from(floors)));
                assert!(is_closed(&all), "{turn} {floors}");
                let n = f64::from(floors);
                let rooms = (3.7 * 5.4 + 3.55 * 5.4) * CEILING * n;
                let well = 1.7 * 3.0 * (HEIGHT - CEILING) * (n - 1.0);
                let gaps = n * (0.9 * 2.1 * WALL + (1.4 + 1.8) * 1.5 * OUTER);
                let parapet = (28.0 * 0.25 - 0.25) * (0.5 - 0.001);
                let solid = 48.0 * (HEIGHT * n + FOUNDATION) + parapet - rooms - well - gaps;
                assert!((all.volume() - solid).abs() < 1e-6 * solid, "{} {solid}", all.volume());
            }
        }
    }
}
