//! The architect's spaces as hints for the partitioner.

use crate::truth::{Shape, Truth};
use enf_rooms::Hint;

/// One hint for each space indoors: its footprint where its solid is known, else its box. `origin` is subtracted, m,
/// after a turn of `turn` radians about the z axis.
pub fn hints(truth: &Truth, origin: [f64; 3], turn: f64) -> Vec<Hint> {
    let (sin, cos) = (libm::sin(turn), libm::cos(turn));
    let place = |x: f64, y: f64| {
        [(x * cos - y * sin - origin[0]) as f32, (x * sin + y * cos - origin[1]) as f32]
    };
    truth
        .spaces
        .iter()
        .filter(|s| !s.outdoors && s.max.z > s.min.z)
        .filter_map(|s| {
            let mut corners = s.footprint();
            if s.shape == Shape::Box {
                // The outline of a box starts anywhere; its corners are simple.
                let (a, b) = (s.min, s.max);
                corners =
                    [(a.x, a.y), (b.x, a.y), (b.x, b.y), (a.x, b.y)].map(|c| c.into()).to_vec();
            }
            let polygon: Vec<[f32; 2]> = corners.iter().map(|c| place(c.x, c.y)).collect();
            (polygon.len() > 2).then(|| Hint {
                min: [0.0, 0.0, (s.min.z - origin[2]) as f32],
                max: [0.0, 0.0, (s.max.z - origin[2]) as f32],
                polygon,
            })
        })
        .collect()
}
