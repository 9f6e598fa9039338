//! What light does between a lamp and its last wall: emission, flight across leaves, scattering.
//!
//! Everything here is a plain function over one resident tile. A random number depends on *who asks*
//! (seed, light, photon, bounce), never on when, where or on which thread: that is what makes the same
//! photon land on the same spot whatever the rooms, the budget or the order of visits.
#![forbid(unsafe_code)]

pub mod emission;
pub mod flight;
pub mod gloss;
pub mod lamp;
mod landing;
pub mod photon;
pub mod rng;
pub mod scatter;
pub mod sky;
pub mod spherical;
pub mod texture;
pub mod vector;
