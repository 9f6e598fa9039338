//! What the bytes of an Enfilade store mean.
//!
//! Every record, header and version that is ever written to a store is defined here and nowhere
//! else. The crate does no I/O and holds no `unsafe`: it turns plain old data into bytes and back
//! with [`zerocopy`]. All integers and floats are little-endian; `docs/FORMAT.md` is the prose
//! beside these definitions, and `fixtures/golden/` freezes the bytes of one value of each record.
//!
//! Units, everywhere: metres, watts, W/m², W/m²/sr, radians unless a name says otherwise. RGB is
//! linear Rec.709.
#![forbid(unsafe_code)]

#[cfg(target_endian = "big")]
compile_error!("Enfilade's stores are little-endian and read in place");

pub mod bsp;
pub mod bvh;
pub mod codec;
pub mod film;
pub mod geometry;
pub mod grid;
pub mod journal;
pub mod light;
pub mod map;
pub mod material;
pub mod octahedral;
pub mod photon;
pub mod profile;
pub mod rgbe;
pub mod room;
pub mod sections;
pub mod segment;
pub mod sky;
pub mod texture;
pub mod transit;

/// Marks "no index" wherever an index is a `u32`.
pub const NONE: u32 = u32::MAX;

/// The version of the whole store format. Any change of bytes raises it.
pub const FORMAT_VERSION: u32 = 5;
