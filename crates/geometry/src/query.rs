//! One query: the nearest canonical hit in an interval.

use crate::mesh::TileMesh;
use crate::ray::{Hit, PreparedRay, intersect_along};

/// What a query asks for; narrows as hits are found.
pub(crate) struct Query<'m> {
    pub(crate) mesh: &'m TileMesh<'m>,
    pub(crate) exclude: u32,
    pub(crate) delta: f32,
    pub(crate) t_min: f32,
    pub(crate) best: Hit,
    found: bool,
}

impl Query<'_> {
    #[inline(always)]
    pub(crate) fn test<const Z: usize>(&mut self, ray: &PreparedRay, triangle: u32) {
        let corners = self.mesh.corner_arrays(triangle);
        if let Some((t, u, v)) = intersect_along::<Z>(ray, corners, self.delta) {
            self.offer(triangle, t, u, v);
        }
    }

    #[inline(never)]
    fn offer(&mut self, triangle: u32, t: f32, u: f32, v: f32) {
        let global = self.mesh.global[triangle as usize];
        let nearer =
            t < self.best.t || (self.found && t == self.best.t && global < self.best.global);
        if nearer && t >= self.t_min && global != self.exclude {
            self.best = Hit { t, triangle, global, u, v };
            self.found = true;
        }
    }

    pub(crate) fn answer(self) -> Option<Hit> {
        self.found.then_some(self.best)
    }
}

/// The nearest canonical hit with `t_min <= t < t_max` (m) on a triangle other than `exclude` (global index
/// or [`crate::NONE`]), by testing them all; ties go to the smaller global index. What
/// [`crate::GridView::nearest`] and [`crate::BvhView::nearest`] must agree with, and what they do when they cannot
/// be sure.
pub fn nearest_by_force(
    mesh: &TileMesh,
    ray: &PreparedRay,
    t_min: f32,
    t_max: f32,
    exclude: u32,
    delta: f32,
) -> Option<Hit> {
    let mut query = Query::new(mesh, t_min, t_max, exclude, delta);
    for triangle in 0..mesh.len() {
        match ray.axis {
            0 => query.test::<0>(ray, triangle),
            1 => query.test::<1>(ray, triangle),
            _ => query.test::<2>(ray, triangle),
        }
    }
    query.answer()
}

impl<'m> Query<'m> {
    pub(crate) fn new(
        mesh: &'m TileMesh<'m>,
        t_min: f32,
        t_max: f32,
        exclude: u32,
        delta: f32,
    ) -> Self {
        let best = Hit { t: t_max, triangle: 0, global: 0, u: 0.0, v: 0.0 };
        Self { mesh, exclude, delta, t_min, best, found: false }
    }
}
