//! The removal men: they carry everything to its room, and bump into nothing.
//!
//! Each room has a list of what stands where, as in a drawing. The seed nudges and turns things
//! within what is free: not through a wall, not into each other, not in a doorway.

pub mod auto;
mod catalogue;
mod rooms;
mod wishes;

use crate::Part;
use crate::mesh::{Mesh, radians, sin_cos, v};
use crate::plan::{Filling, Plan, Rect, Side};
use crate::rng::Rng;
use glam::{DVec2, DVec3};
use std::collections::BTreeMap;

/// Where one copy of a mesh stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Where the mesh's origin goes, metres.
    pub position: DVec3,
    /// Turn about z, degrees, x towards y.
    pub turn: f64,
    /// Size factor.
    pub scale: f64,
    /// The room it stands in.
    pub room: Option<usize>,
    /// Whether it is a luminaire.
    pub is_lamp: bool,
    /// How it stands.
    pub stance: Stance,
}

impl Default for Placement {
    fn default() -> Self {
        Self {
            position: DVec3::ZERO,
            turn: 0.0,
            scale: 1.0,
            room: None,
            is_lamp: false,
            stance: Stance::Built,
        }
    }
}

impl Placement {
    /// A copy at `(x, y, z)`, turned by degrees.
    pub fn new(x: f64, y: f64, z: f64, turn: f64) -> Self {
        Self { position: v(x, y, z), turn, ..Self::default() }
    }

    /// A point of the mesh in world space.
    pub fn apply(&self, p: DVec3) -> DVec3 {
        let (s, c) = sin_cos(radians(self.turn));
        let q = p * self.scale;
        self.position + v(c * q.x - s * q.y, s * q.x + c * q.y, q.z)
    }
}

/// How a thing shares space with others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stance {
    /// Part of the building: its designer looks after it.
    Built,
    /// Stands on the floor or hangs on a wall, and needs its place for itself.
    Stands,
    /// A seat that may be pushed under a table.
    Seat,
    /// A table that seats may be pushed under.
    Table,
    /// Lies flat; others stand on it.
    Flat,
    /// Rests on top of something else.
    Rests,
}

/// The box that a thing takes up: an upright box turned about z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// Centre in plan.
    pub centre: DVec2,
    /// Half width and half depth, before turning.
    pub half: DVec2,
    /// Turn, degrees.
    pub turn: f64,
    /// Bottom and top, metres.
    pub height: (f64, f64),
    /// How it stands.
    pub stance: Stance,
}

impl Footprint {
    /// The box of a copy of a mesh.
    pub fn of(mesh: &Mesh, p: &Placement) -> Self {
        Self::of_bounds(mesh.bounds(), p)
    }

    /// The box of a copy of a mesh with these bounds.
    pub fn of_bounds((low, high): (DVec3, DVec3), p: &Placement) -> Self {
        let mid = p.apply((low + high) / 2.0);
        Self {
            centre: DVec2::new(mid.x, mid.y),
            half: DVec2::new(high.x - low.x, high.y - low.y) * (p.scale / 2.0),
            turn: p.turn,
            height: (p.position.z + low.z * p.scale, p.position.z + high.z * p.scale),
            stance: p.stance,
        }
    }

    /// A box around a rectangle of the plan.
    pub fn rect(r: &Rect, height: (f64, f64)) -> Self {
        Self {
            centre: DVec2::new(r.x0 + r.x1, r.y0 + r.y1) / 2.0,
            half: DVec2::new(r.x1 - r.x0, r.y1 - r.y0) / 2.0,
            turn: 0.0,
            height,
            stance: Stance::Stands,
        }
    }

    fn axes(&self) -> [DVec2; 2] {
        let (s, c) = sin_cos(radians(self.turn));
        [DVec2::new(c, s), DVec2::new(-s, c)]
    }

    /// The four corners in plan.
    pub fn corners(&self) -> [DVec2; 4] {
        let [a, b] = self.axes();
        [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
            .map(|(s, t)| self.centre + a * (self.half.x * s) + b * (self.half.y * t))
    }

    /// Whether two boxes share space by more than `slack` metres in every direction.
    pub fn overlaps(&self, other: &Self, slack: f64) -> bool {
        if self.height.0.max(other.height.0) + slack >= self.height.1.min(other.height.1) {
            return false;
        }
        self.axes().into_iter().chain(other.axes()).all(|axis| {
            let reach = |f: &Self| {
                let [a, b] = f.axes();
                f.half.x * a.dot(axis).abs() + f.half.y * b.dot(axis).abs()
            };
            (self.centre - other.centre).dot(axis).abs() + slack < reach(self) + reach(other)
        })
    }

    /// Whether the two may not stand like this. Rugs lie under everything, seats go under tables,
    /// and what rests on a thing is inside that thing's box where it has a tap or a raised edge:
    /// it keeps clear of other things at rest only.
    pub fn conflicts(&self, other: &Self) -> bool {
        use Stance::{Built, Flat, Rests, Seat, Table};
        let free = match (self.stance, other.stance) {
            (Built | Flat, _) | (_, Built | Flat) | (Seat, Table) | (Table, Seat) => true,
            (Rests, Rests) => false,
            (Rests, _) | (_, Rests) => true,
            _ => false,
        };
        !free && self.overlaps(other, 0.012)
    }

    /// Whether the point is inside the box grown by `margin`.
    pub fn holds(&self, p: DVec3, margin: f64) -> bool {
        let [a, b] = self.axes();
        let d = DVec2::new(p.x, p.y) - self.centre;
        d.dot(a).abs() < self.half.x + margin
            && d.dot(b).abs() < self.half.y + margin
            && p.z > self.height.0 - margin
            && p.z < self.height.1 + margin
    }
}

/// Free space before and behind doorways that furniture keeps out of, metres.
pub const DOORWAY_DEPTH: f64 = 0.55;

/// The zones that must stay clear: each passage with its approaches.
pub fn clearances(plan: &Plan) -> Vec<Footprint> {
    plan.openings
        .iter()
        .filter(|o| o.is_passage())
        .map(|o| {
            let mut r = o.rect();
            if o.along_x {
                r.y0 -= DOORWAY_DEPTH;
                r.y1 += DOORWAY_DEPTH;
            } else {
                r.x0 -= DOORWAY_DEPTH;
                r.x1 += DOORWAY_DEPTH;
            }
            Footprint::rect(&r, o.height)
        })
        .collect()
}

/// The boxes of door leaves that stand open.
pub fn leaves(plan: &Plan) -> Vec<Footprint> {
    plan.openings
        .iter()
        .filter_map(|o| match o.filling {
            Filling::Doorway(Some(leaf)) => {
                let (p, mesh) = crate::joinery::leaf(o, &leaf);
                Some(Footprint::of(&mesh, &Placement { stance: Stance::Stands, ..p }))
            }
            _ => None,
        })
        .collect()
}

/// Everything on the lorry.
pub(crate) struct Removal<'a> {
    plan: &'a Plan,
    seed: u64,
    parts: BTreeMap<String, Part>,
    taken: Vec<(usize, Footprint)>,
    clear: Vec<Footprint>,
}

/// One room being furnished. Positions are metres from its south-west corner and its floor.
pub(crate) struct Site<'r, 'a> {
    lorry: &'r mut Removal<'a>,
    room: usize,
    rect: Rect,
    z: f64,
    rng: Rng,
    /// Largest nudge in metres and turn in degrees for the next things.
    loose: (f64, f64),
}

impl<'a> Removal<'a> {
    fn site(&mut self, name: &str) -> Option<Site<'_, 'a>> {
        let room = self.plan.room(name)?;
        let r = &self.plan.rooms[room];
        let rng = Rng::new(self.seed, name);
        let (rect, z) = (r.rects[0], r.height.0);
        Some(Site { lorry: self, room, rect, z, rng, loose: (0.0, 0.0) })
    }

    /// A site in another rectangle of a room (a corridor's second leg).
    fn site_in(&mut self, name: &str, rect: usize) -> Option<Site<'_, 'a>> {
        let mut site = self.site(name)?;
        site.rect = *site.lorry.plan.rooms[site.room].rects.get(rect)?;
        Some(site)
    }

    fn free(&self, room: usize, f: &Footprint) -> bool {
        let rects = &self.plan.rooms[room].rects;
        let inside = f.corners().iter().all(|c| rects.iter().any(|r| r.holds(c.x, c.y, 1e-6)));
        inside
            && (f.stance == Stance::Flat || self.clear.iter().all(|c| !f.overlaps(c, 0.0)))
            && self.taken.iter().all(|(r, other)| *r != room || !f.conflicts(other))
    }
}

impl Site<'_, '_> {
    /// The next things are nudged by up to `metres` and turned by up to `degrees`.
    pub(crate) fn loose(&mut self, metres: f64, degrees: f64) -> &mut Self {
        self.loose = (metres, degrees);
        self
    }

    /// Width (x) and depth (y) of the room.
    pub(crate) fn size(&self) -> (f64, f64) {
        (self.rect.x1 - self.rect.x0, self.rect.y1 - self.rect.y0)
    }

    /// A random stream for a thing of this room.
    pub(crate) fn stream(&self, label: &str) -> Rng {
        let room = &self.lorry.plan.rooms[self.room].name;
        Rng::new(self.lorry.seed, &format!("{room}/{label}"))
    }

    fn mesh(&mut self, name: &str, make: impl FnOnce() -> Mesh) -> &Mesh {
        let entry = self.lorry.parts.entry(name.to_owned()).or_insert_with(|| Part {
            name: name.to_owned(),
            mesh: make(),
            door: false,
            copies: Vec::new(),
        });
        &entry.mesh
    }

    /// Puts a thing at `(x, y)`, `z` above the floor, turned by degrees.
    pub(crate) fn put(
        &mut self,
        stance: Stance,
        name: &str,
        make: impl FnOnce() -> Mesh,
        (x, y, z): (f64, f64, f64),
        turn: f64,
    ) {
        self.mesh(name, make);
        let mesh = &self.lorry.parts[name].mesh;
        // A millimetre of air keeps feet and floors from sharing a plane. Splayed legs are cut
        // square and would dig in with one edge; what hangs is lower than that by far.
        let low = mesh.bounds().0.z;
        let lift = if low > -0.02 { 0.001 - low.min(0.0) } else { 0.001 };
        let home = Placement {
            stance,
            room: Some(self.room),
            ..Placement::new(self.rect.x0 + x, self.rect.y0 + y, self.z + z + lift, turn)
        };
        let (far, twist) = self.loose;
        let mut best = home;
        if far > 0.0 || twist > 0.0 {
            for attempt in 0..12 {
                let amplitude = 1.0 - f64::from(attempt) / 12.0;
                let mut p = home;
                p.position.x += self.rng.around(far * amplitude);
                p.position.y += self.rng.around(far * amplitude);
                p.turn += self.rng.around(twist * amplitude);
                if self.lorry.free(self.room, &Footprint::of(mesh, &p)) {
                    best = p;
                    break;
                }
            }
        }
        // Files carry five decimals: what is checked is what is written.
        let digits = |c: f64| libm::round(c * 1e5) / 1e5;
        best.position =
            v(digits(best.position.x), digits(best.position.y), digits(best.position.z));
        best.turn = digits(best.turn);
        self.lorry.taken.push((self.room, Footprint::of(mesh, &best)));
        if let Some(part) = self.lorry.parts.get_mut(name) {
            part.copies.push(best);
        }
    }

    /// Stands a thing on the floor.
    pub(crate) fn stand(
        &mut self,
        name: &str,
        make: impl FnOnce() -> Mesh,
        x: f64,
        y: f64,
        turn: f64,
    ) {
        self.put(Stance::Stands, name, make, (x, y, 0.0), turn);
    }

    /// Stands a seat on the floor, facing `(tx, ty)`.
    pub(crate) fn seat(
        &mut self,
        name: &str,
        make: impl FnOnce() -> Mesh,
        (x, y): (f64, f64),
        (tx, ty): (f64, f64),
    ) {
        let turn = libm::atan2(ty - y, tx - x).to_degrees() + 90.0;
        self.put(Stance::Seat, name, make, (x, y, 0.0), turn);
    }

    /// Stands a table on the floor.
    pub(crate) fn table(
        &mut self,
        name: &str,
        make: impl FnOnce() -> Mesh,
        x: f64,
        y: f64,
        turn: f64,
    ) {
        self.put(Stance::Table, name, make, (x, y, 0.0), turn);
    }

    /// Lays a rug.
    pub(crate) fn rug(
        &mut self,
        name: &str,
        make: impl FnOnce() -> Mesh,
        x: f64,
        y: f64,
        turn: f64,
    ) {
        self.put(Stance::Flat, name, make, (x, y, 0.0), turn);
    }

    /// Sets a thing down at height `z`.
    pub(crate) fn rest(
        &mut self,
        name: &str,
        make: impl FnOnce() -> Mesh,
        (x, y, z): (f64, f64, f64),
        turn: f64,
    ) {
        self.put(Stance::Rests, name, make, (x, y, z), turn);
    }

    /// Stands (or hangs, at height `z`) a thing with its back to a wall, its middle `along` metres
    /// from the wall's west or south end.
    pub(crate) fn against(
        &mut self,
        side: Side,
        name: &str,
        make: impl FnOnce() -> Mesh,
        along: f64,
        z: f64,
    ) {
        self.against_as(Stance::Stands, side, name, make, along, z);
    }

    /// [`Self::against`] with another stance.
    pub(crate) fn against_as(
        &mut self,
        stance: Stance,
        side: Side,
        name: &str,
        make: impl FnOnce() -> Mesh,
        along: f64,
        z: f64,
    ) {
        // Furniture on the floor keeps off the skirting board.
        let gap = if z < 0.1 { 0.02 } else { 0.003 };
        let back = self.mesh(name, make).bounds().1.y + gap;
        let (w, d) = self.size();
        let (x, y, turn) = match side {
            Side::North => (along, d - back, 0.0),
            Side::South => (along, back, 180.0),
            Side::East => (w - back, along, -90.0),
            Side::West => (back, along, 90.0),
        };
        let loose = std::mem::replace(&mut self.loose, (0.0, 0.0));
        self.put(stance, name, Mesh::new, (x, y, z), turn);
        self.loose = loose;
    }
}

/// Furnishes the whole plan.
pub fn build(plan: &Plan, seed: u64) -> Vec<Part> {
    let mut lorry =
        Removal { plan, seed, parts: BTreeMap::new(), taken: Vec::new(), clear: clearances(plan) };
    for leaf in leaves(plan) {
        let c = v(leaf.centre.x, leaf.centre.y, leaf.height.0 + 0.5);
        if let Some(room) = plan.room_at(c) {
            lorry.taken.push((room, leaf));
        }
    }
    rooms::furnish(&mut lorry);
    lorry.parts.into_values().filter(|p| !p.copies.is_empty()).collect()
}
