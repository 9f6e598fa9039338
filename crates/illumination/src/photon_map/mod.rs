//! Photon maps: sort, balance, ask (Jensen 2001, chapters 5 to 7).
//!
//! A room's impacts become a tree without a single pointer, neighbours sixteen to a block ([`build_map`]); a
//! surface point asks it for the `k` nearest photons that agree with it, and divides their flux by
//! the area of the disc that they fill ([`PhotonMap::irradiance`]).
//!
//! Two things are not in the book:
//!
//! - **A doorway is not an edge.** A map also holds the photons beyond its room's portals, as far as a
//!   gather reaches ([`Halo`]). Each counts only if the straight way to it leads through an
//!   opening ([`PortalSet::crosses`]), so there is neither a dark seam at the door nor a glow on the
//!   floor behind the wall. (A seam is what Fradin et al. 2005, "Out-of-Core Photon-Mapping for Large
//!   Buildings", section 8, leave open.)
//! - **Nothing depends on luck.** Whether a photon counts is a question about the point, its normal,
//!   the photon and the room alone. Ties go by the photons' own bytes and fluxes are summed in fixed
//!   point, so a result has the same bits whatever the order of arrival, the shape of the tree, or
//!   the side of the portal that a photon was stored on.

mod build;
mod cache;
mod chunk;
mod gather;
mod lanes;
mod map;
mod order;
mod pieces;
mod portals;
mod search;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_support;
mod thing;

pub use build::build_map;
pub use cache::{IrradianceCache, Places};
pub use gather::{
    ENDING_PHOTONS, Gather, GatherScratch, Irradiance, Kernel, NORMAL_COSINE, Nearest,
    SLAB_FLOOR_M, SLAB_FLOOR_RADII, SLAB_SLOPE, SMALLEST_DISC_M, SMALLEST_DISC_RADII,
};
pub use lanes::Instructions;
pub use map::{Outline, PhotonMap, blob_bytes};
pub use order::canonical_sort;
pub use pieces::{Cube, DIVIDE_BYTES, PieceRange, divide};
pub use portals::{BadPortals, Halo, PortalSet};
