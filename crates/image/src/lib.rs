//! From radiance to pictures.
//!
//! A [`Film`] sums radiance in integers, so that the order in which rays come home cannot change a
//! bit. A finished [`Picture`] (or anything that can hand out [`Rows`], for pictures larger than
//! the memory budget) becomes
//!
//! * OpenEXR ([`write_exr`]): everything, linear, lossless, in layers;
//! * PNG ([`write_png`]): what an eye would see, after [`exposure`] and a filmic curve;
//! * Radiance HDR ([`write_hdr`]): for `pvalue`, `falsecolor`, `evalglare` and friends;
//! * falsecolour ([`falsecolour_png`]): luminance in cd/m² with a legend, for people who need
//!   numbers rather than pictures.
//!
//! Equal pixels give equal files: no time, path, host or budget is ever written, and every
//! transcendental function comes from `libm`. A file appears under its name complete or not at all.
//! Colours are linear Rec.709; 1 W/m²/sr of white is 179 cd/m².
#![forbid(unsafe_code)]

mod aside;
mod error;
mod exposure;
mod falsecolour;
mod film;
mod font;
mod hdr;
mod openexr;
mod portable;
mod rows;
mod tone;

pub use error::ImageError;
pub use exposure::{ExposureMeter, exposure, exposure_from};
pub use falsecolour::{falsecolour_map_png, falsecolour_png, falsecolour_png_from};
pub use film::{Film, Gathered, UNITS};
pub use hdr::{write_hdr, write_hdr_from};
pub use openexr::{Loaded, read_exr, write_exr, write_exr_from};
pub use portable::{write_png, write_png_from, write_png_toned};
pub use rows::{Picture, Rows, RowsError, scratch_bytes};
pub use tone::{LUMENS_PER_WATT, Tone, encode_srgb, exposure_of_ev, luminance, tone_map};
