//! Do both sides find the same hits?

use std::fmt;

use crate::embree::{self, Beam, Found};
use crate::ours::{Ours, query, query_as_embree};
use crate::walk::Flight;

/// Hits farther apart than this along the ray, m (or this share of its length), are different.
pub const NEAR: f32 = 1e-4;

/// The share of rays that may have different hits, on the same rays to the bit. There are such rays: Embree's default
/// test may miss at an edge, and its distances are those of `f32`.
pub const TOLERATED: f64 = 1e-3;

/// How often both sides agreed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Agreement {
    /// Rays that both were asked about, the same to the bit.
    pub rays: usize,
    /// Both hit the same triangle, or both nothing.
    pub same: usize,
    /// Another triangle, at the same distance: an edge, or two surfaces in one place.
    pub near: usize,
    /// Only ours hit something.
    pub ours_only: usize,
    /// Only Embree did.
    pub embree_only: usize,
    /// As they were measured (ours start on the triangle, Embree's a tenth of a millimetre above): the same triangle.
    pub same_as_measured: usize,
    /// Shadow rays, the same to the bit.
    pub shadows: usize,
    /// The same answer.
    pub same_shadows: usize,
}

impl Agreement {
    /// Asks both.
    pub fn of(
        ours: &Ours<'_>,
        embree: &embree::Scene<'_>,
        flights: &[Flight],
        shadows: &[Flight],
    ) -> Self {
        let mut sum = Self { rays: flights.len(), shadows: shadows.len(), ..Self::default() };
        for flight in flights {
            let found = embree.nearest(&beam(flight));
            let same = ours.nearest(&query_as_embree(flight));
            sum.compare(same.map(|h| Found { t: h.t, triangle: h.global }), found);
            let own = ours.nearest(&query(flight));
            sum.same_as_measured += usize::from(own.map(|h| h.global) == found.map(|f| f.triangle));
        }
        for flight in shadows {
            let own = ours.occluded(&query_as_embree(flight));
            sum.same_shadows += usize::from(own == embree.occluded(&beam(flight)));
        }
        sum
    }

    fn compare(&mut self, ours: Option<Found>, embree: Option<Found>) {
        match (ours, embree) {
            (None, None) => self.same += 1,
            (Some(a), Some(b)) if a.triangle == b.triangle => self.same += 1,
            (Some(a), Some(b)) if (a.t - b.t).abs() <= NEAR * b.t.max(1.0) => self.near += 1,
            (Some(_), Some(_)) => {}
            (Some(_), None) => self.ours_only += 1,
            (None, Some(_)) => self.embree_only += 1,
        }
    }

    /// The share of rays with different hits.
    pub fn apart(&self) -> f64 {
        1.0 - (self.same + self.near) as f64 / self.rays.max(1) as f64
    }

    /// Whether the figures compare like with like.
    pub fn tolerable(&self) -> bool {
        self.apart() <= TOLERATED
            && self.shadows - self.same_shadows <= (TOLERATED * self.shadows as f64) as usize
    }
}

/// A flight, as Embree is asked about it.
pub fn beam(flight: &Flight) -> Beam {
    Beam {
        origin: flight.lifted.to_array(),
        direction: flight.direction.to_array(),
        far: flight.far,
    }
}

impl fmt::Display for Agreement {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let share = |n: usize, of: usize| 100.0 * n as f64 / of.max(1) as f64;
        write!(
            out,
            "same rays: {:.4} % the same triangle, {:.4} % another at the same distance, {:.4} % different \
             (only ours hit {}, only Embree {}); shadow rays {:.4} % the same; \
             as measured {:.3} % the same triangle",
            share(self.same, self.rays),
            share(self.near, self.rays),
            100.0 * self.apart(),
            self.ours_only,
            self.embree_only,
            share(self.same_shadows, self.shadows),
            share(self.same_as_measured, self.rays),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_counts_as_the_same() {
        let found = |t, triangle| Some(Found { t, triangle });
        let mut sum = Agreement { rays: 6, ..Agreement::default() };
        sum.compare(None, None);
        sum.compare(found(2.0, 7), found(2.1, 7));
        sum.compare(found(2.0, 7), found(2.0001, 8));
        sum.compare(found(2.0, 7), found(2.1, 8));
        sum.compare(found(2.0, 7), None);
        sum.compare(None, found(1.0, 0));
        assert_eq!((sum.same, sum.near, sum.ours_only, sum.embree_only), (2, 1, 1, 1));
        assert!((sum.apart() - 0.5).abs() < 1e-12 && !sum.tolerable());
        let good = Agreement { rays: 9, same: 9, shadows: 9, same_shadows: 9, ..sum };
        assert!(good.tolerable());
        assert!(!Agreement { same_shadows: 8, ..good }.tolerable());
    }
}
