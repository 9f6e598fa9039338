//! Walls, slabs and roof: the solid that is left when rooms and openings are carved out.
//!
//! The building is a grid of cells between all coordinates of the drawing; a cell is solid, air, a
//! room or an opening. Where solid meets the rest there is a face, painted by what it faces. Faces
//! are merged into large rectangles, and rectangles share every vertex on their edges: one closed,
//! outward mesh, with reveals in every doorway and nothing coplanar twice.

use crate::mesh::{Mesh, Paint, v};
use crate::plan::{Filling, LAWN, Opening, Plan, Rect, STOREY};
use std::collections::{BTreeMap, BTreeSet};

/// Bottom of the ground, metres.
const GROUND: f64 = -0.6;
/// Height of the parapet above the roof, metres.
const PARAPET: f64 = 0.4;
/// Thickness of the parapet, metres.
const PARAPET_WIDTH: f64 = 0.3;
/// How far the lawn reaches beyond the building, metres.
const GARDEN: f64 = 3.0;
/// Longest edge of a wall rectangle, metres.
const LONGEST: f64 = 3.2;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Cell {
    Solid,
    Air,
    Room(u32),
    Opening(u32),
}

struct Grid {
    axes: [Vec<f64>; 3],
    cells: Vec<Cell>,
}

/// The rank of a coordinate that is known to be on the axis (the nearest one).
fn rank(axis: &[f64], value: f64) -> usize {
    axis.partition_point(|&a| a < value - 1e-6)
}

impl Grid {
    fn new(mut axes: [Vec<f64>; 3]) -> Self {
        for axis in &mut axes {
            axis.sort_by(f64::total_cmp);
            axis.dedup_by(|a, b| (*a - *b).abs() < 1e-6);
        }
        let count = axes.iter().map(|a| a.len() - 1).product();
        Self { axes, cells: vec![Cell::Air; count] }
    }

    fn index(&self, c: [usize; 3]) -> usize {
        (c[2] * (self.axes[1].len() - 1) + c[1]) * (self.axes[0].len() - 1) + c[0]
    }

    fn fill(&mut self, r: &Rect, (low, high): (f64, f64), cell: Cell) {
        let span =
            |axis: usize, a: f64, b: f64| rank(&self.axes[axis], a)..rank(&self.axes[axis], b);
        let (xs, ys, zs) = (span(0, r.x0, r.x1), span(1, r.y0, r.y1), span(2, low, high));
        for z in zs {
            for y in ys.clone() {
                for x in xs.clone() {
                    let i = self.index([x, y, z]);
                    self.cells[i] = cell;
                }
            }
        }
    }

    /// The cell at signed coordinates; air beyond the grid.
    fn cell(&self, c: [isize; 3]) -> Cell {
        let inside = (0..3).all(|k| c[k] >= 0 && (c[k] as usize) < self.axes[k].len() - 1);
        if inside { self.cells[self.index(c.map(|k| k as usize))] } else { Cell::Air }
    }
}

/// The footprint's rectangles without the parapet. Wings overlap where they join, by more than
/// two parapets.
fn roof_wells(plan: &Plan) -> Vec<Rect> {
    let w = PARAPET_WIDTH;
    plan.footprint.iter().map(|r| Rect::new(r.x0 + w, r.y0 + w, r.x1 - w, r.y1 - w)).collect()
}

/// Carves the building's shell out of the solid.
pub fn build(plan: &Plan) -> Mesh {
    let top = STOREY * f64::from(plan.storeys);
    let mut axes: [Vec<f64>; 3] = [vec![], vec![], vec![GROUND, LAWN, 0.0, top, top + PARAPET]];
    let mut boxes: Vec<(Rect, (f64, f64), Cell)> = Vec::new();
    let mut garden = Rect::new(f64::MAX, f64::MAX, f64::MIN, f64::MIN);
    for r in &plan.footprint {
        garden.x0 = garden.x0.min(r.x0 - GARDEN);
        garden.y0 = garden.y0.min(r.y0 - GARDEN);
        garden.x1 = garden.x1.max(r.x1 + GARDEN);
        garden.y1 = garden.y1.max(r.y1 + GARDEN);
    }
    boxes.push((garden, (GROUND, LAWN), Cell::Solid));
    boxes.extend(plan.footprint.iter().map(|&r| (r, (LAWN, top + PARAPET), Cell::Solid)));
    boxes.extend(roof_wells(plan).into_iter().map(|r| (r, (top, top + PARAPET), Cell::Air)));
    for (i, room) in plan.rooms.iter().enumerate() {
        let cell = Cell::Room(i as u32);
        boxes.extend(room.rects.iter().map(|&r| (r, room.height, cell)));
        boxes.extend(room.shafts.iter().map(|&(r, low, high)| (r, (low, high), cell)));
    }
    for (i, o) in plan.openings.iter().enumerate() {
        boxes.push((o.rect(), o.height, Cell::Opening(i as u32)));
    }
    for (r, (low, high), _) in &boxes {
        axes[0].extend([r.x0, r.x1]);
        axes[1].extend([r.y0, r.y1]);
        axes[2].extend([low, high]);
    }
    let mut grid = Grid::new(axes);
    for (r, height, cell) in &boxes {
        grid.fill(r, *height, *cell);
    }
    surface(plan, &grid)
}

/// The object and paint of a face of the solid that looks along `sign * axis` at `cell`.
fn face_of(plan: &Plan, cell: Cell, axis: usize, sign: isize, z: f64) -> Option<(String, Paint)> {
    let storey = ((z + 0.2) / STOREY).max(0.0) as u32;
    Some(match cell {
        Cell::Solid => return None,
        Cell::Air => match (axis, sign) {
            (2, 1) if z < 0.0 => ("ground".into(), "ground.lawn"),
            (2, -1) => ("ground".into(), "soil"),
            (2, _) => ("roof".into(), "roof.gravel"),
            _ if z < LAWN => ("ground".into(), "soil"),
            _ if z < 0.0 => ("facade/plinth".into(), "facade.plinth"),
            _ => (format!("facade/floor-{storey}"), "facade.render"),
        },
        Cell::Room(r) => {
            let room = &plan.rooms[r as usize];
            match (axis, sign) {
                (2, 1) => (format!("floors/{}", room.name), room.floor),
                (2, _) => (format!("ceilings/{}", room.name), "ceiling.white"),
                // The solid looks at the room, so its face is the opposite wall's.
                (0, 1) => (format!("walls/floor-{storey}"), room.walls[0]),
                (0, _) => (format!("walls/floor-{storey}"), room.walls[1]),
                (_, 1) => (format!("walls/floor-{storey}"), room.walls[2]),
                (_, _) => (format!("walls/floor-{storey}"), room.walls[3]),
            }
        }
        Cell::Opening(o) => {
            let paint = match plan.openings[o as usize].filling {
                Filling::Doorway(_) | Filling::Shut(_) if axis == 2 && sign == 1 => "trim.oak",
                Filling::Window { .. } if axis == 2 && sign == 1 => "stone.sill",
                Filling::Entrance if axis == 2 && sign == 1 => "stone.sill",
                _ => "trim.white",
            };
            (format!("reveals/floor-{storey}"), paint)
        }
    })
}

type Layer = BTreeSet<(usize, usize)>;

fn surface(plan: &Plan, grid: &Grid) -> Mesh {
    // Layers of unit faces: (object, axis, plane, positive side, paint) -> cells (b, c).
    let mut layers: BTreeMap<(String, usize, usize, bool, Paint), Layer> = BTreeMap::new();
    let n = [0, 1, 2].map(|k| grid.axes[k].len() - 1);
    for axis in 0..3 {
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        for plane in 0..=n[axis] {
            for j in 0..n[c] {
                for i in 0..n[b] {
                    let mut below = [0isize; 3];
                    below[axis] = plane as isize - 1;
                    below[b] = i as isize;
                    below[c] = j as isize;
                    let mut above = below;
                    above[axis] += 1;
                    let (p, q) = (grid.cell(below), grid.cell(above));
                    let (cell, sign) = match (p == Cell::Solid, q == Cell::Solid) {
                        (true, false) => (q, 1),
                        (false, true) => (p, -1),
                        _ => continue,
                    };
                    let k = below[2].max(0) as usize;
                    let z = if axis == 2 {
                        grid.axes[2][plane]
                    } else {
                        (grid.axes[2][k] + grid.axes[2][k + 1]) / 2.0
                    };
                    if let Some((object, paint)) = face_of(plan, cell, axis, sign, z) {
                        layers
                            .entry((object, axis, plane, sign > 0, paint))
                            .or_default()
                            .insert((i, j));
                    }
                }
            }
        }
    }
    // Greedy rectangles, in grid ranks.
    let mut rectangles = Vec::new();
    for ((object, axis, plane, positive, paint), mut cells) in layers {
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        let length =
            |axis: usize, from: usize, to: usize| grid.axes[axis][to] - grid.axes[axis][from];
        while let Some(&(i0, j0)) = cells.first() {
            let mut i1 = i0 + 1;
            while cells.contains(&(i1, j0)) && length(b, i0, i1 + 1) <= LONGEST {
                i1 += 1;
            }
            let mut j1 = j0 + 1;
            while (i0..i1).all(|i| cells.contains(&(i, j1))) && length(c, j0, j1 + 1) <= LONGEST {
                j1 += 1;
            }
            for i in i0..i1 {
                for j in j0..j1 {
                    cells.remove(&(i, j));
                }
            }
            rectangles.push((object.clone(), axis, plane, positive, paint, [i0, i1, j0, j1]));
        }
    }
    let place = |axis: usize, plane: usize, i: usize, j: usize| {
        let mut k = [0usize; 3];
        k[axis] = plane;
        k[(axis + 1) % 3] = i;
        k[(axis + 2) % 3] = j;
        k
    };
    let mut used = BTreeSet::new();
    for &(_, axis, plane, _, _, [i0, i1, j0, j1]) in &rectangles {
        for (i, j) in [(i0, j0), (i1, j0), (i1, j1), (i0, j1)] {
            used.insert(place(axis, plane, i, j));
        }
    }
    let mut mesh = Mesh::new();
    let mut index: BTreeMap<[usize; 3], u32> = BTreeMap::new();
    for (object, axis, plane, positive, paint, [i0, i1, j0, j1]) in rectangles {
        if mesh.objects.last() != Some(&object) {
            mesh.objects.push(object);
        }
        // Walk around the rectangle, stopping at every vertex that others use.
        let mut around: Vec<(usize, usize)> = Vec::new();
        around.extend((i0..i1).map(|i| (i, j0)));
        around.extend((j0..j1).map(|j| (i1, j)));
        around.extend((i0 + 1..=i1).rev().map(|i| (i, j1)));
        around.extend((j0 + 1..=j1).rev().map(|j| (i0, j)));
        let mut corners: Vec<u32> = around
            .into_iter()
            .map(|(i, j)| place(axis, plane, i, j))
            .filter(|k| used.contains(k))
            .map(|k| {
                *index.entry(k).or_insert_with(|| {
                    mesh.points.push(v(grid.axes[0][k[0]], grid.axes[1][k[1]], grid.axes[2][k[2]]));
                    (mesh.points.len() - 1) as u32
                })
            })
            .collect();
        if !positive {
            corners.reverse();
        }
        let first = mesh.triangles.len();
        if let [a, b, c, d] = corners[..] {
            mesh.quad([a, b, c, d], paint);
        } else {
            let low = mesh.points[corners[0] as usize];
            let (low, high) = corners.iter().fold((low, low), |(l, h), &i| {
                let p = mesh.points[i as usize];
                (l.min(p), h.max(p))
            });
            let centre = mesh.point((low + high) / 2.0);
            for (k, &a) in corners.iter().enumerate() {
                mesh.triangle(centre, a, corners[(k + 1) % corners.len()], paint);
            }
        }
        let object = (mesh.objects.len() - 1) as u32;
        for t in &mut mesh.triangles[first..] {
            t.object = object;
        }
    }
    mesh
}

/// Whether an opening is a window or a screen: it has glass.
pub fn is_glazed(o: &Opening) -> bool {
    !matches!(o.filling, Filling::Doorway(_) | Filling::Shut(_))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{lshape, mesh::is_closed};

    #[test]
    fn the_shell_is_one_closed_outward_solid() {
        for storeys in [1, 2, 3] {
            let plan = lshape::plan(storeys);
            let shell = build(&plan);
            assert!(is_closed(&shell));
            let built = 23.7 * 12.5 + 12.5 * 10.5;
            let garden = 29.7 * 29.0 * (LAWN - GROUND);
            let rooms: f64 = plan
                .rooms
                .iter()
                .map(|r| {
                    r.area() * (r.height.1 - r.height.0)
                        + r.shafts.iter().map(|(s, a, b)| s.area() * (b - a)).sum::<f64>()
                })
                .sum();
            let open: f64 =
                plan.openings.iter().map(|o| o.rect().area() * (o.height.1 - o.height.0)).sum();
            let wells = 23.1 * 11.9 + 11.9 * 10.5;
            let expected = garden + built * (STOREY * f64::from(storeys) + PARAPET - LAWN)
                - wells * PARAPET
                - rooms
                - open;
            assert!((shell.volume() - expected).abs() < 1e-6 * expected, "{storeys}");
            assert!(shell.triangles.len() < 12_000 * storeys as usize);
        }
    }
}
