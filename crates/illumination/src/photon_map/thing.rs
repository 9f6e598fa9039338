//! How large is a small thing? On legs, slats and edges a disc is mostly not there, and flux over its area is too little.
//!
//! Photons that are within a hop of each other, from the nearest one on, lie on one thing: across a gap there is another. The area on which
//! they lie is that of their convex hull, and more: of `n` points in a convex region the hull has `v` corners, and a further
//! point lies outside of it as often as it would be a corner, `v / (n + 1)` (Efron 1965, "The convex hull of a random
//! set of points"). That is exact for the mean, whatever the region's shape: a leg, a corner, a disc.

use std::cmp::Ordering;

use glam::Vec3;

/// Fewer photons say nothing about a thing's size.
pub(super) const FEWEST: usize = 10;
/// A hop, over the distance at which photons would be apart in a square grid.
const HOP: f32 = 1.6;
/// A hop along a line, over the distance at which photons would be apart there.
const HOP_ALONG: f32 = 8.0;
/// A hull's area is made larger by this factor at most.
const MOST_CORRECTION: f64 = 3.0;

/// A photon, seen from the point that is asked about.
#[derive(Clone, Copy, Debug)]
struct Member {
    /// In the tangent plane, and above it, m.
    at: [f32; 3],
    /// Squared distance as bits.
    d2: u32,
    /// Which of those that were found.
    which: u32,
}

/// Working memory of one thread.
#[derive(Clone, Debug, Default)]
pub(super) struct Thing {
    members: Vec<Member>,
    reached: Vec<bool>,
    waiting: Vec<u32>,
    hull: Vec<[f32; 2]>,
}

impl Thing {
    /// Room for so many photons.
    pub(super) fn with_capacity(photons: usize) -> Self {
        Self {
            members: Vec::with_capacity(photons),
            reached: Vec::with_capacity(photons),
            waiting: Vec::with_capacity(photons),
            hull: Vec::with_capacity(photons + 2),
        }
    }

    pub(super) fn bytes(&self) -> usize {
        self.members.capacity() * size_of::<Member>()
            + self.reached.capacity()
            + self.waiting.capacity() * size_of::<u32>()
            + self.hull.capacity() * size_of::<[f32; 2]>()
    }

    pub(super) fn clear(&mut self) {
        self.members.clear();
    }

    /// A photon, of those that were found number `which`, in a direction from the point, m.
    pub(super) fn add(&mut self, way: Vec3, [u, v, normal]: [Vec3; 3], d2: u32, which: usize) {
        let at = [way.dot(u), way.dot(v), way.dot(normal)];
        self.members.push(Member { at, d2, which: which as u32 });
    }

    /// The thing's area, m², as far as it lies in the disc of a radius, m, and which photons lie on it; nothing if they
    /// are too few. The order in which photons were added does not matter.
    pub(super) fn measure(&mut self, radius: f32) -> Option<(f64, impl Iterator<Item = usize>)> {
        if self.members.len() < FEWEST {
            return None;
        }
        self.members.sort_unstable_by(|a, b| match a.at[0].total_cmp(&b.at[0]) {
            Ordering::Equal => a.at[1].total_cmp(&b.at[1]),
            order => order,
        });
        let area = loop {
            let (area, count) = (self.area(), self.members.len());
            let apart = (area as f32 / count as f32).sqrt() * HOP;
            let near = self.reach(apart.max(HOP_ALONG * 2.0 * radius / count as f32));
            if near < FEWEST || near == count {
                break area;
            }
            let mut reached = self.reached.iter();
            self.members.retain(|_| reached.next() == Some(&true));
        };
        Some((area, self.members.iter().map(|m| m.which as usize)))
    }

    /// Marks the photons that hops lead to from the nearest ones; returns how many.
    fn reach(&mut self, hop: f32) -> usize {
        let Self { members, reached, waiting, .. } = self;
        let nearest = members.iter().map(|m| m.d2).min().unwrap_or(0);
        reached.clear();
        reached.extend(members.iter().map(|m| m.d2 == nearest));
        waiting.clear();
        waiting.extend((0..members.len() as u32).filter(|&i| reached[i as usize]));
        let mut count = waiting.len();
        // Rounding is monotone: whoever is farther away along an axis is not within a hop.
        let hop2 = hop * hop;
        while let Some(from) = waiting.pop() {
            let from = from as usize;
            let a = members[from].at;
            let mut look = |i: usize| {
                let b = members[i].at;
                let way = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
                let along2 = way[0] * way[0];
                if !reached[i] && along2 + way[1] * way[1] + way[2] * way[2] <= hop2 {
                    reached[i] = true;
                    waiting.push(i as u32);
                    count += 1;
                }
                along2 <= hop2
            };
            let _ = (0..from).rev().all(&mut look);
            let _ = (from + 1..members.len()).all(&mut look);
        }
        count
    }

    /// The area on which the photons lie, m².
    fn area(&mut self) -> f64 {
        let Self { members, hull, .. } = self;
        let count = members.len();
        // Andrew 1979: the lower half from left to right, then the upper one back.
        hull.clear();
        let mut fewest = 1;
        for half in 0..2 {
            for i in 0..count {
                let [u, v, _] = members[if half == 0 { i } else { count - 1 - i }].at;
                while hull.len() > fewest
                    && turn(hull[hull.len() - 2], hull[hull.len() - 1], [u, v]) <= 0.0
                {
                    hull.pop();
                }
                hull.push([u, v]);
            }
            fewest = hull.len();
        }
        let corners = hull.len().saturating_sub(1).min(count);
        let Some(&first) = hull.first() else { return 0.0 };
        let twice: f64 = hull.windows(2).map(|side| turn(first, side[0], side[1])).sum();
        let outside = corners as f64 / (count + 1) as f64;
        0.5 * twice.max(0.0) * (1.0 / (1.0 - outside)).min(MOST_CORRECTION)
    }
}

/// Twice the area of a triangle, positive if it turns to the left.
fn turn(a: [f32; 2], b: [f32; 2], c: [f32; 2]) -> f64 {
    let way = |p: [f32; 2]| [f64::from(p[0]) - f64::from(a[0]), f64::from(p[1]) - f64::from(a[1])];
    let (b, c) = (way(b), way(c));
    b[0] * c[1] - b[1] * c[0]
}
