//! The automatic furnisher: a list of what a room's use asks for, then more of it, until the room
//! has its share of triangles or no place is left.
//!
//! Fradin, Meneveaux and Horna furnished their Z-building and tower by an automatic process
//! (section 7.1). Rooms may have any outline: a piece is in a room when its middle is and no wall
//! crosses its box.

use super::catalogue::{self, Piece, Place};
use super::wishes::list;
use super::{Footprint, Placement, Stance};
use crate::fittings;
use crate::mesh::{Mesh, radians, sin_cos, v};
use crate::outline::{Convex, turn_of};
use crate::plan::Filling;
use crate::rng::Rng;
use crate::storey::{CEILING, Gap, Space, Storey, Use, Weight};
use glam::{DVec2, DVec3};
use std::collections::BTreeMap;

/// Triangles per square metre above which a room is full of furniture.
const DENSE: f64 = 2000.0;

/// Free space before and behind doorways, metres.
pub const DOORWAY: f64 = 0.75;

/// Meshes that were ordered, in the order of their names' first use.
#[derive(Default)]
pub struct Stock {
    /// Names and meshes.
    pub meshes: Vec<(String, Mesh)>,
    bounds: Vec<(DVec3, DVec3)>,
    index: BTreeMap<String, usize>,
    seed: u64,
}

impl Stock {
    /// An empty stock for a seed.
    pub fn new(seed: u64) -> Self {
        Self { seed, ..Self::default() }
    }

    fn get(&mut self, piece: &Piece, variant: usize) -> usize {
        let k = variant % piece.variants;
        let name = format!("{}-{}", piece.name, k + 1);
        let rng = Rng::new(self.seed, &name);
        self.mesh(name, || piece.make(k, rng))
    }

    fn mesh(&mut self, name: String, make: impl FnOnce() -> Mesh) -> usize {
        *self.index.entry(name.clone()).or_insert_with(|| {
            let mesh = make();
            self.bounds.push(mesh.bounds());
            self.meshes.push((name, mesh));
            self.meshes.len() - 1
        })
    }
}

/// The furniture of a storey: mesh in the stock, room of the storey, pose above its floor.
pub type Furnishing = Vec<(usize, usize, Placement)>;

/// Boxes of a storey's doorways with their approaches.
pub fn clearances(storey: &Storey) -> Vec<Footprint> {
    let wide = |g: &Gap| {
        let t = g.thick / 2.0 + DOORWAY;
        let (low, high) = g.height;
        upright(g.frame.origin, (g.width / 2.0, t), g.frame.turn, (low, high))
    };
    storey.gaps.iter().filter(|g| g.is_passage()).map(wide).collect()
}

/// Boxes of a storey's door leaves.
pub fn leaves(storey: &Storey) -> Vec<Footprint> {
    let hung = storey.gaps.iter().filter_map(fittings::leaf);
    hung.map(|(_, p, mesh)| Footprint::of(&mesh, &Placement { stance: Stance::Stands, ..p }))
        .collect()
}

fn upright(centre: DVec2, half: (f64, f64), turn: f64, height: (f64, f64)) -> Footprint {
    let half = DVec2::new(half.0, half.1);
    Footprint { centre, half, turn, height, stance: Stance::Stands }
}

/// What a storey's rooms keep free, room by room.
struct Zones {
    rooms: Vec<Vec<Footprint>>,
}

impl Zones {
    fn new(storey: &Storey) -> Self {
        let mut all = clearances(storey);
        all.extend(leaves(storey));
        for g in &storey.gaps {
            // Windows and screens stay free but for what is lower or hangs as a blind.
            if matches!(g.filling, Filling::Window { .. } | Filling::Screen { .. }) {
                let t = g.thick / 2.0 + 0.3;
                let height = (g.height.0 + 0.1, g.height.1);
                all.push(upright(g.frame.origin, (g.width / 2.0 + 0.05, t), g.frame.turn, height));
            }
        }
        for f in &storey.flights {
            let half = (fittings::FLIGHT / 2.0 + 0.1, fittings::RUN / 2.0 + 0.5);
            let middle = f.point(fittings::FLIGHT / 2.0 + 0.05, fittings::RUN / 2.0);
            all.push(upright(middle, half, f.turn, (0.0, CEILING)));
        }
        for &eye in &storey.eyes {
            all.push(upright(eye, (0.45, 0.45), 0.0, (0.0, CEILING)));
        }
        let near = |s: &Space, z: &Footprint| {
            let reach = z.half.length();
            s.pieces.iter().any(|c| {
                let (low, high) = c.bounds();
                z.centre.x > low.x - reach
                    && z.centre.x < high.x + reach
                    && z.centre.y > low.y - reach
                    && z.centre.y < high.y + reach
            })
        };
        let of = |s: &Space| all.iter().filter(|z| near(s, z)).copied().collect();
        Self { rooms: storey.spaces.iter().map(of).collect() }
    }
}

/// Whether the box is inside the room: its middle is, and no wall crosses it.
pub fn inside(space: &Space, walls: &[(DVec2, DVec2)], f: &Footprint) -> bool {
    if !space.holds(f.centre, 0.0) {
        return false;
    }
    let (s, c) = sin_cos(radians(f.turn));
    let (a, b) = (DVec2::new(c, s), DVec2::new(-s, c));
    let half = f.half - DVec2::splat(1e-6);
    walls.iter().all(|&(p, q)| {
        // Clip the wall to the box, in the box's axes.
        let (p, q) = (p - f.centre, q - f.centre);
        let (p, q) = (DVec2::new(p.dot(a), p.dot(b)), DVec2::new(q.dot(a), q.dot(b)));
        let d = q - p;
        let (mut from, mut to) = (0.0f64, 1.0f64);
        for k in 0..2 {
            if d[k].abs() < 1e-12 {
                if p[k].abs() >= half[k] {
                    return true;
                }
            } else {
                let (x, y) = ((-half[k] - p[k]) / d[k], (half[k] - p[k]) / d[k]);
                from = from.max(x.min(y));
                to = to.min(x.max(y));
            }
        }
        from >= to
    })
}

/// One room while it is furnished.
struct Room<'a> {
    space: &'a Space,
    walls: Vec<(DVec2, DVec2)>,
    taken: Vec<Footprint>,
    rng: Rng,
    out: Vec<(usize, Placement)>,
    triangles: u64,
    /// How often each piece was placed, and how often it found no place: twice is enough.
    placed: BTreeMap<&'static str, (usize, usize)>,
}

impl Room<'_> {
    fn free(&self, f: &Footprint) -> bool {
        let reach = f.half.length();
        f.height.1 < CEILING
            && self.taken.iter().all(|t| {
                let far = reach + t.half.length();
                f.centre.distance_squared(t.centre) > far * far || !f.conflicts(t)
            })
            && inside(self.space, &self.walls, f)
    }

    fn put(&mut self, stock: &Stock, mesh: usize, mut p: Placement) -> bool {
        // Files carry five decimals: what is checked is what is written.
        let digits = |c: f64| libm::round(c * 1e5) / 1e5;
        p.position = v(digits(p.position.x), digits(p.position.y), digits(p.position.z));
        p.turn = digits(p.turn);
        let f = Footprint::of_bounds(stock.bounds[mesh], &p);
        if !self.free(&f) {
            return false;
        }
        self.taken.push(f);
        self.out.push((mesh, p));
        self.triangles += stock.meshes[mesh].1.triangles.len() as u64;
        true
    }

    /// Finds a place for a piece.
    fn place(&mut self, stock: &Stock, mesh: usize, piece: &Piece) -> bool {
        let (low, high) = stock.bounds[mesh];
        // A millimetre of air keeps feet and floors from sharing a plane.
        let lift = if low.z > -0.02 { 0.001 - low.z.min(0.0) } else { 0.001 };
        let pose = |p: DVec2, z: f64, turn: f64| Placement {
            stance: piece.stance,
            ..Placement::new(p.x, p.y, z + lift, turn)
        };
        match piece.place {
            Place::Wall(z) => {
                let gap = if z < 0.1 { 0.02 } else { 0.003 };
                let half = (high.x - low.x) / 2.0;
                let first = self.rng.below(self.walls.len());
                for k in 0..self.walls.len() {
                    let (p, q) = self.walls[(first + k) % self.walls.len()];
                    let length = (q - p).length();
                    let spare = length - 2.0 * half - 0.04;
                    if spare < 0.0 {
                        continue;
                    }
                    let d = (q - p) / length;
                    let inward = d.perp();
                    let turn = turn_of(d) + 180.0;
                    let steps = (spare / 0.12) as usize + 1;
                    let offset = self.rng.below(steps);
                    for s in 0..steps {
                        let share = (offset + s) % steps;
                        let along = 0.02 + half + spare * share as f64 / steps as f64;
                        let at = p + d * along + inward * (high.y + gap);
                        if self.put(stock, mesh, pose(at, z, turn)) {
                            return true;
                        }
                    }
                }
                false
            }
            Place::Edge => {
                // Near a wall, at any angle.
                let reach = high.x.max(-low.x).max(high.y).max(-low.y);
                for _ in 0..24 {
                    let (p, q) = self.walls[self.rng.below(self.walls.len())];
                    let d = (q - p).normalize();
                    let along = self.rng.unit() * (q - p).length();
                    let at = p + d * along + d.perp() * (reach + self.rng.range(0.05, 0.2));
                    let turn = turn_of(d) + 180.0 + self.rng.around(40.0);
                    let scale = self.rng.range(0.94, 1.06);
                    let p = Placement { scale, ..pose(at, 0.0, turn) };
                    if self.put(stock, mesh, p) {
                        return true;
                    }
                }
                false
            }
            Place::Free | Place::Ceiling => {
                let hung = piece.place == Place::Ceiling;
                let z = if hung { CEILING - 0.003 } else { 0.0 };
                for attempt in 0..40 {
                    let c = &self.space.pieces[self.rng.below(self.space.pieces.len())];
                    let (low, high) = c.bounds();
                    let at =
                        DVec2::new(self.rng.range(low.x, high.x), self.rng.range(low.y, high.y));
                    let quarter = 90.0 * self.rng.below(4) as f64;
                    let loose = if attempt < 20 { 5.0 } else { 1.0 };
                    let turn = self.space.turn + quarter + self.rng.around(loose);
                    if self.put(stock, mesh, pose(at, z, turn)) {
                        return true;
                    }
                }
                // Along a grid, from corner to corner.
                let turn = self.space.turn;
                let all = self.space.pieces.iter().map(Convex::bounds);
                let (low, high) =
                    all.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or_default();
                let n = 9;
                for k in 0..n * n * 2 {
                    let at = low
                        + (high - low) * DVec2::new((k % n) as f64 + 0.5, (k / n % n) as f64 + 0.5)
                            / n as f64;
                    let turn = turn + if k < n * n { 0.0 } else { 90.0 };
                    if self.put(stock, mesh, pose(at, z, turn)) {
                        return true;
                    }
                }
                false
            }
        }
    }
}

/// How pieces stand in rows: name, distance along a row and between rows, width of the middle
/// aisle, distance of the rows from the sides, the front and the back.
struct Rows(&'static str, f64, f64, f64, [f64; 3]);

/// Pieces in rows behind each other in the room's main direction, from the back to the front, with
/// an aisle in the middle: seats of an auditorium, stacks of a library.
fn rows(room: &mut Room<'_>, stock: &mut Stock, how: &Rows, target: u64) {
    let &Rows(name, along, between, aisle, [side, front, back]) = how;
    let frame =
        crate::outline::Frame { origin: room.space.pieces[0].middle(), turn: room.space.turn };
    let local: Vec<DVec2> =
        room.space.pieces.iter().flat_map(|c| c.0.iter().map(|&p| frame.local(p))).collect();
    let low = local.iter().copied().reduce(DVec2::min).unwrap_or_default();
    let high = local.iter().copied().reduce(DVec2::max).unwrap_or_default();
    let Some(piece) = catalogue::find(name) else { return };
    let mut y = high.y - back;
    while y > low.y + front && room.triangles < target {
        let mut x = (low.x + high.x - aisle - along) / 2.0;
        let mut blocks = Vec::new();
        while x > low.x + side {
            blocks.push(x);
            x -= along;
        }
        for b in blocks {
            for at in [b, low.x + high.x - b] {
                let variant = room.rng.below(piece.variants);
                let mesh = stock.get(piece, variant);
                let p = frame.point(at, y + room.rng.around(0.02));
                let turn = frame.turn + room.rng.around(0.3);
                let pose =
                    Placement { stance: Stance::Stands, ..Placement::new(p.x, p.y, 0.001, turn) };
                if room.triangles < target {
                    room.put(stock, mesh, pose);
                }
            }
        }
        y -= between;
    }
}

/// Furnishes a storey so that it has about `target` triangles in furniture. `label` keys the
/// random numbers. The bits depend on the arguments alone.
pub fn furnish(
    storey: &Storey,
    target: u64,
    seed: u64,
    label: &str,
    stock: &mut Stock,
) -> Furnishing {
    let zones = Zones::new(storey);
    let mut out = Vec::new();
    // Rooms with a number of their own first, small shares before large ones: what one room has no
    // place for goes to those that come later.
    let mut order: Vec<usize> = (0..storey.spaces.len()).collect();
    let rank = |&i: &usize| match storey.spaces[i].weight {
        Weight::Triangles(_) => (0, 0),
        Weight::Share(w) => (1, (w / storey.spaces[i].area() * 1e6) as u64),
    };
    order.sort_by_key(|i| (rank(i), *i));
    let share = |i: usize| match storey.spaces[i].weight {
        Weight::Share(w) => w,
        Weight::Triangles(_) => 0.0,
    };
    let mut shares: f64 = (0..storey.spaces.len()).map(share).sum();
    let mut left = target as f64;
    for i in order {
        let space = &storey.spaces[i];
        let goal = match space.weight {
            Weight::Triangles(n) => n as f64,
            Weight::Share(w) => left.max(0.0) * w / shares,
        };
        shares = (shares - share(i)).max(1e-9);
        let mut room = Room {
            space,
            walls: space.walls(),
            taken: zones.rooms[i].clone(),
            rng: Rng::new(seed, &format!("{label}/{}", space.name)),
            out: Vec::new(),
            triangles: 0,
            placed: BTreeMap::new(),
        };
        if goal > 0.0 {
            dress(storey, &mut room, stock);
            fill(&mut room, stock, goal as u64);
        }
        left -= room.triangles as f64;
        out.extend(
            room.out.into_iter().map(|(mesh, p)| (mesh, i, Placement { room: Some(i), ..p })),
        );
    }
    out
}

/// Radiators and blinds at the windows.
fn dress(storey: &Storey, room: &mut Room<'_>, stock: &mut Stock) {
    for g in &storey.gaps {
        let Filling::Window { .. } = g.filling else { continue };
        for turn in [g.frame.turn, g.frame.turn + 180.0] {
            let (s, c) = sin_cos(radians(turn));
            let inward = DVec2::new(-s, c);
            let face = g.frame.origin + inward * (g.thick / 2.0);
            if !room.space.holds(face + inward * 0.05, 0.0) {
                continue;
            }
            let tenths = (g.width * 10.0) as u32;
            if room.space.use_ != Use::Stair {
                let mesh = stock.mesh(format!("radiator-{tenths}"), || {
                    crate::furniture::decor::radiator(g.width - 0.3)
                });
                let back = stock.bounds[mesh].1.y + 0.02;
                let p = face + inward * back;
                room.put(
                    stock,
                    mesh,
                    Placement {
                        stance: Stance::Stands,
                        ..Placement::new(p.x, p.y, 0.001, turn + 180.0)
                    },
                );
            }
            if room.rng.unit() < 0.75 {
                let k = room.rng.below(3);
                let drop = [0.45, 0.8, 1.2][k];
                let mesh = stock.mesh(format!("blind-{tenths}-{}", k + 1), || {
                    crate::furniture::fine::blind("lacquer.white", g.width + 0.1, drop)
                });
                let p = face + inward * 0.075;
                let z = g.height.1 + 0.1;
                // Blinds hang in the zone that is kept free for them.
                let pose = Placement {
                    stance: Stance::Rests,
                    ..Placement::new(p.x, p.y, z, turn + 180.0)
                };
                room.put(stock, mesh, pose);
            }
        }
    }
}

/// Orders pieces until the room has about `goal` triangles.
fn fill(room: &mut Room<'_>, stock: &mut Stock, goal: u64) {
    if room.space.use_ == Use::Auditorium {
        let (first, _) = list(room.space.use_);
        for name in first {
            order(room, stock, name, u64::MAX);
        }
        let how = Rows("seats-6", 3.5, 0.95, 1.3, [1.9, 2.4, 1.0]);
        rows(room, stock, &how, goal - goal / 20);
    }
    let (first, more) = list(room.space.use_);
    if room.space.use_ != Use::Auditorium {
        for name in first {
            order(room, stock, name, goal.saturating_sub(room.triangles) + goal / 6);
        }
    }
    if room.space.use_ == Use::Library && room.space.area() > 100.0 {
        rows(room, stock, &Rows("reading", 3.6, 2.6, 0.8, [6.0, 7.0, 8.4]), u64::MAX);
        rows(room, stock, &Rows("stack", 1.23, 1.75, 1.6, [0.9, 0.8, 0.8]), goal - goal / 40);
    }
    let mut failed = 0;
    // A room that is to hold much begins with what holds much: cabinets.
    let dense = goal as f64 > DENSE * room.space.area();
    let start = more.iter().position(|&name| name == "vitrine").filter(|_| dense);
    let mut k = start.unwrap_or(0);
    while failed < 2 * more.len() && room.triangles < goal {
        let left = goal - room.triangles;
        // A piece that is much more than what is left is too much.
        if order(room, stock, more[k % more.len()], left + left / 2 + 300) {
            failed = 0;
        } else {
            failed += 1;
        }
        k += 1;
    }
}

fn order(room: &mut Room<'_>, stock: &mut Stock, name: &str, most: u64) -> bool {
    let Some(piece) = catalogue::find(name) else { return false };
    let limit = piece.most * (room.space.area() / 40.0).ceil().max(1.0) as usize;
    let (count, failed) = room.placed.get(piece.name).copied().unwrap_or_default();
    if failed > 1 || count >= limit {
        return false;
    }
    let variant = room.rng.below(piece.variants);
    let mesh = stock.get(piece, variant);
    if stock.meshes[mesh].1.triangles.len() as u64 > most {
        return false;
    }
    let found = room.place(stock, mesh, piece);
    room.placed.insert(piece.name, (count + usize::from(found), failed + usize::from(!found)));
    found
}
