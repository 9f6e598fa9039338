//! Ways of keeping light: where flux that met a surface is stored, and how irradiance is read back.
//!
//! One module per way. [`photon_map`] keeps every impact as a point and asks the nearest ones
//! (Jensen 2001, "Realistic Image Synthesis Using Photon Mapping"); whatever joins it sits beside it
//! and never inside it. Everything here turns slices into slices: no files, no clocks, no threads
//! left behind, and the same bits every time.
#![forbid(unsafe_code)]

pub mod photon_map;

pub use photon_map::{
    Gather, GatherScratch, Irradiance, IrradianceCache, Kernel, Outline, PhotonMap, Places,
    PortalSet, build_map, canonical_sort,
};
