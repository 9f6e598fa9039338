//! From leaves to rooms.
//!
//! Leaves grow together through what is wide open; a door stays a door because its wall is looked
//! at as well, one metre around it. Then come the exceptions: solid matter, the outside, doorways,
//! cupboards.

use crate::openings::Link;
use crate::probe::Facing;
use crate::tree::THIN;
use std::collections::{BTreeMap, BinaryHeap};

/// Regions grow together when this share of what is between them is open.
pub(crate) const WIDE: f64 = 0.6;
/// Around a corner this share of the walls beside the opening is free: more than at a door or at the mouth of a
/// corridor (a third), less than at the corner of a room (one half).
pub(crate) const CORNER: f64 = 0.42;
/// Corridors are so many times as long as they are wide.
const CORRIDOR: f64 = 3.0;
/// Who looks ahead where a corridor turns sees its wall, at no more than so many times its width.
const TURN: f64 = 2.0;
/// A region is not outside, however wide its opening, when this share of its surface is closed.
const ENCLOSED: f64 = 0.75;
/// A mouth rather than a door: this share of the wall around it is free.
const MOUTH: f64 = 0.36;
/// Bays are at most so many times as deep as their mouth is wide.
const DEPTH: f64 = 1.2;
/// Smaller is no room, m³ and m².
const LEAST_VOLUME: f64 = 1.5;
const LEAST_FLOOR: f64 = 1.0;
/// What opens less is sealed, m².
const LEAST_OPENING: f64 = 0.02;
/// What opens less of the surface of a cavity is a crack.
const CRACK: f64 = 0.01;
/// Lower is no room but the void above a ceiling, m.
const LEAST_HEIGHT: f64 = 2.05;

/// What merging needs to know about a leaf.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LeafFacts {
    pub(crate) volume: f64,
    pub(crate) width: f64,
    pub(crate) low: f64,
    pub(crate) high: f64,
    /// Touches the root box.
    pub(crate) bound: bool,
    /// Share of directions in which the back of a surface is seen.
    pub(crate) backs: f64,
    pub(crate) hint: Option<u32>,
}

/// The outcome: a region per leaf.
pub(crate) struct Merged {
    /// Region of each leaf; solid leaves have that of the neighbour they share most surface with.
    pub(crate) region: Vec<u32>,
    pub(crate) solid: Vec<bool>,
    /// The region that is outside.
    pub(crate) outside: Option<u32>,
    pub(crate) regions: u32,
    /// Which side of the model's triangles is the outer one.
    pub(crate) facing: Facing,
}

#[derive(Clone, Copy, Debug, Default)]
struct Between {
    shared: f64,
    free: f64,
    open: f64,
    weighted: f64,
    /// Of the free area, what reaches the end of its wall.
    flush: f64,
    /// Sum of free area times how far one sees ahead, m³.
    ahead: f64,
}

impl Between {
    fn add(&mut self, other: &Self) {
        self.shared += other.shared;
        self.free += other.free;
        self.open += other.open;
        self.weighted += other.weighted;
        self.ahead += other.ahead;
        self.flush += other.flush;
    }

    /// Not a door: the walls around the openings are open as well.
    fn gaping(&self) -> bool {
        self.free > 1e-4 && self.weighted >= CORNER * self.free
    }

    /// Hardly a wall around the openings, and most of what is in between is open.
    fn wide(&self) -> bool {
        self.free > 1e-4 && self.weighted >= WIDE * self.free && self.free >= WIDE * self.shared
    }
}

#[derive(Clone, Debug)]
struct Region {
    alive: bool,
    volume: f64,
    low: f64,
    high: f64,
    /// All leaves thin.
    thin: bool,
    /// Volume-weighted sum of `backs`.
    backs: f64,
    /// Surface shared with solid leaves.
    walled: f64,
    hint: Option<u32>,
    outside: bool,
    near: BTreeMap<u32, Between>,
}

struct Growing {
    scale: f64,
    parent: Vec<u32>,
    regions: Vec<Region>,
}

impl Growing {
    fn find(&mut self, mut i: u32) -> u32 {
        while self.parent[i as usize] != i {
            let up = self.parent[self.parent[i as usize] as usize];
            self.parent[i as usize] = up;
            i = up;
        }
        i
    }

    /// Neither is outside, and no hint keeps them apart.
    fn indoors(&self, a: u32, b: u32) -> bool {
        let (a, b) = (&self.regions[a as usize], &self.regions[b as usize]);
        !a.outside && !b.outside && a.hint == b.hint
    }

    /// Merges two regions and returns the one that stays; `changed` gets the neighbours that it
    /// now touches in more than before.
    fn merge(&mut self, a: u32, b: u32, changed: &mut Vec<u32>) -> u32 {
        changed.clear();
        let (a, b) = if self.regions[a as usize].near.len() >= self.regions[b as usize].near.len() {
            (a, b)
        } else {
            (b, a)
        };
        self.parent[b as usize] = a;
        let near = std::mem::take(&mut self.regions[b as usize].near);
        let gone = self.regions[b as usize].clone();
        self.regions[b as usize].alive = false;
        for (other, between) in near {
            let back = self.regions[other as usize].near.remove(&b);
            if other == a {
                continue;
            }
            if back.is_some() {
                self.regions[other as usize].near.entry(a).or_default().add(&between);
            }
            self.regions[a as usize].near.entry(other).or_default().add(&between);
            changed.push(other);
        }
        let stays = &mut self.regions[a as usize];
        stays.volume += gone.volume;
        stays.low = stays.low.min(gone.low);
        stays.high = stays.high.max(gone.high);
        stays.thin &= gone.thin;
        stays.backs += gone.backs;
        stays.walled += gone.walled;
        stays.outside |= gone.outside;
        stays.hint = stays.hint.or(gone.hint);
        a
    }

    fn enclosed(&self, i: u32) -> f64 {
        let region = &self.regions[i as usize];
        let (mut all, mut closed) = (region.walled, region.walled);
        for between in region.near.values() {
            all += between.shared;
            closed += between.shared - between.free;
        }
        if all > 0.0 { closed / all } else { 0.0 }
    }

    fn small(&self, i: u32) -> bool {
        let r = &self.regions[i as usize];
        let height = r.high - r.low;
        let s = self.scale;
        r.hint.is_none()
            && (r.thin
                || r.volume < LEAST_VOLUME * s * s * s
                || height < LEAST_HEIGHT * s
                || r.volume / height < LEAST_FLOOR * s * s)
    }

    /// Width of the opening between two regions, m, as if it were as high as the lower one.
    fn width(&self, a: u32, b: u32, between: &Between) -> f64 {
        let height = |i: u32| self.regions[i as usize].high - self.regions[i as usize].low;
        between.free / height(a).min(height(b))
    }

    /// How deep a region is behind an opening, in widths of the opening.
    fn depth(&self, i: u32, other: u32, between: &Between) -> f64 {
        self.regions[i as usize].volume / (between.free * self.width(i, other, between))
    }

    /// Whether two regions are one around a corner. Where a corridor branches off another one, which goes on, there
    /// is none.
    fn corner(&self, a: u32, b: u32, between: &Between) -> bool {
        between.free >= WIDE * between.shared
            && between.free > 1e-4
            && between.weighted >= CORNER * between.free
            && between.flush >= 0.5 * between.free
            && (self.depth(a, b, between).min(self.depth(b, a, between)) < CORRIDOR
                || between.ahead <= TURN * self.width(a, b, between) * between.free)
    }

    /// Whether the smaller one of two regions is a bay of the other: no deeper than its mouth is wide.
    fn alcove(&self, a: u32, b: u32, between: &Between) -> bool {
        between.free >= self.scale * self.scale
            && between.weighted >= MOUTH * between.free
            && self.depth(a, b, between).min(self.depth(b, a, between)) <= DEPTH
    }

    /// The neighbour behind the largest opening; inside rather than outside when they are alike.
    fn widest(&self, i: u32) -> Option<u32> {
        let region = &self.regions[i as usize];
        let mut least = LEAST_OPENING * self.scale * self.scale;
        if self.small(i) {
            // A crack does not make the cavity of a wall a part of the room.
            let surface: f64 = region.near.values().map(|b| b.shared).sum();
            least = least.max(CRACK * (region.walled + surface));
        }
        let mut best: Option<(f64, u32)> = None;
        for (&other, between) in &region.near {
            let outside = self.regions[other as usize].outside;
            let area = between.open * if outside { 0.98 } else { 1.0 };
            if between.open > least && best.is_none_or(|b| area > b.0 * 1.001) {
                best = Some((area, other));
            }
        }
        best.map(|b| b.1)
    }

    /// Merges all pairs that `wanted` allows, largest opening first.
    fn grow(&mut self, wanted: impl Fn(&Self, u32, u32, &Between) -> bool) {
        let mut heap: BinaryHeap<(u64, u32, u32)> = BinaryHeap::new();
        // Positive floats sort like their bits.
        let key = |between: &Between| between.free.max(0.0).to_bits();
        for (i, region) in self.regions.iter().enumerate() {
            for (&other, between) in &region.near {
                if (i as u32) < other {
                    heap.push((key(between), i as u32, other));
                }
            }
        }
        let mut changed = Vec::new();
        while let Some((free, a, b)) = heap.pop() {
            let Some(between) = self.regions[a as usize].near.get(&b).copied() else { continue };
            if !self.regions[a as usize].alive
                || key(&between) != free
                || !wanted(self, a, b, &between)
            {
                continue;
            }
            let stays = self.merge(a, b, &mut changed);
            for &other in &changed {
                if let Some(between) = self.regions[stays as usize].near.get(&other) {
                    heap.push((key(between), stays.min(other), stays.max(other)));
                }
            }
        }
    }
}

pub(crate) fn merge(
    facts: &[LeafFacts],
    links: &[Link],
    ahead: &[f64],
    scale: f64,
    facing: Facing,
    sealed_backs: &dyn Fn(u32) -> f64,
) -> Merged {
    let mut solid = solid_leaves(facts, links, facing == Facing::Mixed);
    let mut growing = Growing {
        scale,
        parent: (0..facts.len() as u32).collect(),
        regions: facts
            .iter()
            .zip(&solid)
            .map(|(f, &solid)| Region {
                alive: !solid,
                volume: f.volume,
                low: f.low,
                high: f.high,
                thin: f.width < THIN * scale,
                backs: 0.0,
                walled: 0.0,
                hint: f.hint.filter(|_| !f.bound),
                outside: f.bound && !solid,
                near: BTreeMap::new(),
            })
            .collect(),
    };
    for (link, &ahead) in links.iter().zip(ahead) {
        let [a, b] = link.leaves;
        match (solid[a as usize], solid[b as usize]) {
            (false, false) => {
                let between = Between {
                    shared: link.shared,
                    free: link.free * link.reach,
                    open: link.open * link.reach,
                    weighted: link.free * link.reach * link.openness,
                    flush: if link.flush { link.free * link.reach } else { 0.0 },
                    ahead: link.free * link.reach * ahead,
                };
                growing.regions[a as usize].near.entry(b).or_default().add(&between);
                growing.regions[b as usize].near.entry(a).or_default().add(&between);
            }
            (true, false) => growing.regions[b as usize].walled += link.shared,
            (false, true) => growing.regions[a as usize].walled += link.shared,
            (true, true) => {}
        }
    }
    // All of the bound is one outside, and all of a hint is one room.
    let mut hinted: BTreeMap<u32, u32> = BTreeMap::new();
    let mut outside: Option<u32> = None;
    for i in 0..facts.len() as u32 {
        let region = &growing.regions[i as usize];
        if !region.alive {
            continue;
        }
        if region.outside {
            outside = Some(outside.map_or(i, |o| growing.merge(o, i, &mut Vec::new())));
        } else if let Some(hint) = region.hint {
            let first = hinted.get(&hint).copied();
            let stays = first.map_or(i, |f| growing.merge(f, i, &mut Vec::new()));
            hinted.insert(hint, stays);
        }
    }
    // Inside first: what is wide open, then around corners, then alcoves.
    growing.grow(|g, a, b, between| g.indoors(a, b) && between.wide());
    growing.grow(|g, a, b, between| g.indoors(a, b) && g.corner(a, b, between));
    growing.grow(|g, a, b, between| g.indoors(a, b) && g.alcove(a, b, between));
    // Then what is wide open to the outside.
    growing.grow(|g, a, b, between| {
        let (inner, outer) = if g.regions[a as usize].outside { (b, a) } else { (a, b) };
        g.regions[outer as usize].outside
            && g.regions[inner as usize].hint.is_none()
            && between.gaping()
            && g.enclosed(inner) < ENCLOSED
    });
    // Doorways, cupboards and slivers belong to what they open to.
    loop {
        let mut small: Vec<(u64, u32)> = (0..facts.len() as u32)
            .filter(|&i| {
                let r = &growing.regions[i as usize];
                r.alive && !r.outside && growing.small(i)
            })
            .map(|i| (growing.regions[i as usize].volume.to_bits(), i))
            .collect();
        small.sort_unstable();
        let mut changed = false;
        for (_, i) in small {
            let r = &growing.regions[i as usize];
            if !r.alive || r.outside || !growing.small(i) {
                continue;
            }
            if let Some(other) = growing.widest(i) {
                growing.merge(i, other, &mut Vec::new());
                changed = true;
            }
        }
        if !changed {
            break;
        }
    }
    // What is sealed and small, or sealed and seen from behind only, is solid.
    let roots: Vec<u32> = (0..facts.len() as u32).map(|i| growing.find(i)).collect();
    let mut becomes_solid: Vec<u32> = Vec::new();
    let mut rooms = 0;
    let mut largest: BTreeMap<u32, (f64, u32)> = BTreeMap::new();
    for (leaf, &root) in roots.iter().enumerate() {
        let entry = largest.entry(root).or_insert((0.0, leaf as u32));
        if facts[leaf].volume > entry.0 {
            *entry = (facts[leaf].volume, leaf as u32);
        }
    }
    for i in 0..facts.len() as u32 {
        let r = &growing.regions[i as usize];
        if !r.alive || r.outside {
            continue;
        }
        let sealed = growing.widest(i).is_none() && r.hint.is_none();
        if sealed && (growing.small(i) || largest.get(&i).is_some_and(|l| sealed_backs(l.1) >= 0.7))
        {
            becomes_solid.push(i);
        } else {
            rooms += 1;
        }
    }
    if rooms == 0 {
        // A model whose only room shows its back is still a room.
        becomes_solid.retain(|&i| growing.small(i));
    }
    for (leaf, &root) in roots.iter().enumerate() {
        if becomes_solid.binary_search(&root).is_ok() {
            solid[leaf] = true;
        }
    }
    number(facts, links, roots, solid, &growing, facing)
}

/// Numbers the regions by their first leaf and hands solid leaves to their neighbours.
fn number(
    facts: &[LeafFacts],
    links: &[Link],
    roots: Vec<u32>,
    solid: Vec<bool>,
    growing: &Growing,
    facing: Facing,
) -> Merged {
    let mut region = vec![u32::MAX; facts.len()];
    let mut numbers: BTreeMap<u32, u32> = BTreeMap::new();
    let mut outside = None;
    for leaf in 0..facts.len() {
        if solid[leaf] {
            continue;
        }
        let next = numbers.len() as u32;
        let number = *numbers.entry(roots[leaf]).or_insert(next);
        region[leaf] = number;
        if growing.regions[roots[leaf] as usize].outside {
            outside = Some(number);
        }
    }
    let regions = numbers.len() as u32;
    spread(links, &mut region, &solid);
    for r in &mut region {
        if *r == u32::MAX {
            *r = outside.unwrap_or(0);
        }
    }
    Merged { region, solid, outside, regions: regions.max(1), facing }
}

/// Solid leaves take the region of the neighbour they share most surface with, ring by ring.
fn spread(links: &[Link], region: &mut [u32], solid: &[bool]) {
    loop {
        let mut best: BTreeMap<u32, BTreeMap<u32, f64>> = BTreeMap::new();
        for link in links {
            for (me, other) in [(0, 1), (1, 0)] {
                let (me, other) = (link.leaves[me] as usize, link.leaves[other] as usize);
                if solid[me] && region[me] == u32::MAX && region[other] != u32::MAX {
                    *best.entry(me as u32).or_default().entry(region[other]).or_default() +=
                        link.shared;
                }
            }
        }
        if best.is_empty() {
            return;
        }
        for (leaf, shares) in best {
            let mut most: Option<(f64, u32)> = None;
            for (r, area) in shares {
                if most.is_none_or(|m| area > m.0) {
                    most = Some((area, r));
                }
            }
            if let Some((_, r)) = most {
                region[leaf as usize] = r;
            }
        }
    }
}

/// Leaves in walls and slabs: thin, nothing but backs to see, and hardly open to space that is not. Where backs are
/// `guessed`, one that turns out to be open makes its neighbours more open, and so on.
fn solid_leaves(facts: &[LeafFacts], links: &[Link], guessed: bool) -> Vec<bool> {
    let mut solid: Vec<bool> = facts.iter().map(|f| !f.bound && f.backs >= 0.75).collect();
    loop {
        let mut surface = vec![0.0; facts.len()];
        let mut airy = vec![0.0; facts.len()];
        for link in links {
            let [a, b] = link.leaves.map(|l| l as usize);
            for (me, other) in [(a, b), (b, a)] {
                surface[me] += link.shared;
                if !solid[other] {
                    airy[me] += link.free;
                }
            }
        }
        let mut changed = false;
        for (i, s) in solid.iter_mut().enumerate() {
            if *s && airy[i] > 0.25 * surface[i] {
                *s = false;
                changed = true;
            }
        }
        if !changed || !guessed {
            return solid;
        }
    }
}
