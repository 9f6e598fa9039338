//! Walking a ray through the bricks and cells (Amanatides and Woo 1987).

use super::{BRICK, BrickRecord, FINER, GridView, LARGEST};
use crate::query::{Query, Search};
use crate::ray::Hit;

/// Mailboxes (Amanatides and Woo 1987), few enough to clear for each ray: one holds the last triangle that
/// was tested among those that share it.
const MAILBOXES: usize = 64;

/// Origins farther out than this many tolerances are beyond what the walk's arithmetic can vouch for.
const FAR: f64 = (1u64 << 44) as f64;

impl GridView<'_> {
    /// The canonical hit with the smallest `(t, global)` among those that the query admits: exactly what testing
    /// every triangle finds.
    pub fn nearest(&self, query: &Query) -> Option<Hit> {
        let mut search = Search::new(self.delta, query);
        if search.is_sane() {
            self.walk::<false>(&mut search);
        }
        search.answer()
    }

    /// Whether the query admits any hit.
    pub fn occluded(&self, query: &Query) -> bool {
        let mut search = Search::new(self.delta, query);
        if search.is_sane() {
            self.walk::<true>(&mut search);
        }
        search.found
    }

    /// To any hit, or to the nearest.
    fn walk<const ANY: bool>(&self, search: &mut Search) {
        let header = self.header;
        let far = FAR * f64::from(header.delta);
        let origin = search.ray.origin.map(f64::from);
        let direction = search.ray.direction.map(f64::from);
        if origin.iter().any(|x| x.abs() > far) || header.delta > LARGEST {
            return search.by_force(&self.mesh);
        }

        // Clip to the box. It has four tolerances of air, so rounding cannot cut off a hit.
        let mut enter = f64::from(search.t_min);
        let mut leave = f64::from(search.best.t);
        let scale = 1.0 / f64::from(header.cell);
        // Position at t, in cells: start + speed * t. Crossing of plane k: base + k * pace.
        let (mut start, mut speed) = ([0.0; 3], [0.0; 3]);
        let (mut base, mut pace) = ([f64::INFINITY; 3], [0.0; 3]);
        for i in 0..3 {
            let (o, d) = (origin[i], direction[i]);
            let (low, high) = (f64::from(header.min[i]) - o, f64::from(header.max[i]) - o);
            start[i] = -low * scale;
            if d == 0.0 {
                if low > 0.0 || high < 0.0 {
                    return;
                }
                continue;
            }
            let inverse = 1.0 / d;
            let (near, far) = (low * inverse, high * inverse);
            enter = enter.max(near.min(far));
            leave = leave.min(near.max(far));
            speed[i] = d * scale;
            pace[i] = f64::from(header.cell) * inverse;
            base[i] = near;
        }
        // A NaN bound was dropped by min or max; no hit passes the test against it either.
        if enter > leave {
            return;
        }

        let [nx, ny, nz] = header.bricks.map(|n| n as i32);
        let count = [nx, ny, nz];
        let step = direction.map(|d| if d < 0.0 { -1 } else { 1 });
        let ahead = direction.map(|d| if d < 0.0 { 0.0 } else { 1.0 });
        let cells = Cells { start, speed, base, pace, step, ahead };
        let stride = [step[0], step[1] * nx, step[2] * nx * ny];
        let edge = f64::from(BRICK);

        let mut brick = [0i32; 3];
        let mut brick_exit = [0.0; 3];
        let mut brick_pace = [0.0; 3];
        // Bricks that remain along each axis.
        let mut ahead_bricks = [0i32; 3];
        for i in 0..3 {
            let at = (start[i] + speed[i] * enter) * (1.0 / edge);
            brick[i] = (at as i32).clamp(0, count[i] - 1);
            brick_exit[i] = base[i] + (f64::from(brick[i]) + ahead[i]) * edge * pace[i];
            brick_pace[i] = (edge * pace[i]).abs();
            ahead_bricks[i] = if step[i] < 0 { brick[i] } else { count[i] - 1 - brick[i] };
        }
        let mut index = ((brick[2] * ny + brick[1]) * nx + brick[0]) as usize;
        let mut mailboxes = [u32::MAX; MAILBOXES];
        loop {
            let record = &self.bricks[index];
            if record.mask() != 0 {
                let corner = brick.map(|b| b * BRICK as i32);
                let span = [enter, leave];
                if self.through::<ANY, true>(record, corner, &cells, span, search, &mut mailboxes) {
                    return;
                }
            }
            let axis = first_of(&brick_exit);
            enter = brick_exit[axis];
            if enter >= leave || f64::from(search.best.t) < enter {
                return;
            }
            ahead_bricks[axis] -= 1;
            if ahead_bricks[axis] < 0 {
                return;
            }
            brick[axis] += step[axis];
            index = (index as i64 + i64::from(stride[axis])) as usize;
            brick_exit[axis] += brick_pace[axis];
        }
    }

    /// Through the cells of a brick between two distances; `corner` is its first cell. True when no later cell can matter.
    #[inline(always)]
    fn through<const ANY: bool, const OUTER: bool>(
        &self,
        record: &BrickRecord,
        corner: [i32; 3],
        cells: &Cells,
        span: [f64; 2],
        search: &mut Search,
        mailboxes: &mut [u32; MAILBOXES],
    ) -> bool {
        let [enter, leave] = span;
        let mask = record.mask();
        let mut left = [0i32; 3];
        let mut exit = [0.0; 3];
        let mut bit = 0i32;
        for i in 0..3 {
            let corner = f64::from(corner[i]);
            let at = cells.start[i] + cells.speed[i] * enter - corner;
            let cell = (at as i32).clamp(0, BRICK as i32 - 1);
            exit[i] = cells.base[i] + (corner + f64::from(cell) + cells.ahead[i]) * cells.pace[i];
            left[i] = if cells.step[i] < 0 { cell } else { BRICK as i32 - 1 - cell };
            bit += cell << (2 * i);
        }
        let mut begin = enter;
        loop {
            let axis = first_of(&exit);
            let end = exit[axis];
            if mask >> bit & 1 != 0 {
                let below = mask & ((1u64 << bit) - 1);
                let cell = (record.first + below.count_ones()) as usize;
                let range = self.starts[cell] as usize..self.starts[cell + 1] as usize;
                let list = &self.references[range];
                if OUTER && list[0] & FINER != 0 {
                    let finer = &self.bricks[(list[0] & !FINER) as usize];
                    let inside = [bit & 3, bit >> 2 & 3, bit >> 4];
                    let corner = std::array::from_fn(|i| (corner[i] + inside[i]) * BRICK as i32);
                    self.divided::<ANY>(
                        finer,
                        corner,
                        cells,
                        [begin, end.min(leave)],
                        search,
                        mailboxes,
                    );
                } else {
                    for &triangle in list {
                        let mailbox = &mut mailboxes[triangle as usize % MAILBOXES];
                        if *mailbox == triangle {
                            continue;
                        }
                        *mailbox = triangle;
                        let corners = self.mesh.corner_arrays(triangle);
                        let global = self.mesh.global[triangle as usize];
                        search.test(corners, global, triangle);
                    }
                }
                if (ANY && search.found) || f64::from(search.best.t) < end {
                    return true;
                }
            }
            if end >= leave {
                return OUTER;
            }
            left[axis] -= 1;
            if left[axis] < 0 {
                return false;
            }
            bit += cells.step[axis] << (2 * axis);
            exit[axis] += cells.pace[axis].abs();
            begin = end;
        }
    }

    /// Through a crowded cell.
    #[inline(never)]
    fn divided<const ANY: bool>(
        &self,
        record: &BrickRecord,
        corner: [i32; 3],
        cells: &Cells,
        span: [f64; 2],
        search: &mut Search,
        mailboxes: &mut [u32; MAILBOXES],
    ) {
        let edge = f64::from(BRICK);
        let finer = Cells {
            start: cells.start.map(|x| x * edge),
            speed: cells.speed.map(|x| x * edge),
            pace: cells.pace.map(|x| x / edge),
            ..*cells
        };
        self.through::<ANY, false>(record, corner, &finer, span, search, mailboxes);
    }
}

/// A ray in units of cells.
#[derive(Clone, Copy)]
struct Cells {
    /// Where it is at distance 0, and how far it gets in a metre.
    start: [f64; 3],
    speed: [f64; 3],
    /// At which distance it crosses plane 0, and how far the planes are apart, m.
    base: [f64; 3],
    pace: [f64; 3],
    /// Towards which cell it goes along each axis, and which of a cell's two planes is ahead.
    step: [i32; 3],
    ahead: [f64; 3],
}

/// The axis with the smallest value; the first on ties.
#[inline(always)]
fn first_of(t: &[f64; 3]) -> usize {
    if t[0] <= t[1] {
        if t[0] <= t[2] { 0 } else { 2 }
    } else if t[1] <= t[2] {
        1
    } else {
        2
    }
}
