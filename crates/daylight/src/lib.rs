//! Daylight before it meets the building: what the sky looks like, and where the sun stands.
//!
//! [`model`] has the sky's patterns, by the CIE standard and by Perez; [`sun`] finds the sun by date, time and place;
//! [`Sky`] answers what radiance arrives from a direction. Plain arithmetic in `f64`, with the `libm` crate's
//! functions, so that the same sky has the same bits everywhere.
//!
//! Directions point *to* where light comes from; z is up. Radiant units are the project's: 179 lumens a watt.
#![forbid(unsafe_code)]

pub mod model;
pub mod sky;
pub mod sun;

pub use model::{Model, Pattern, PerezError};
pub use sky::{Amount, Grid, Sky, record};

/// Angular radius of the sun's disc, degrees.
pub const SUN_RADIUS_DEGREES: f64 = 0.2665;
