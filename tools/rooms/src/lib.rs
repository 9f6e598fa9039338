//! How good are automatic rooms? Real buildings come with the architect's own list of spaces and doors; this
//! compares both.
//!
//! [`truth`] reads that list, [`found`] answers which room a point is in, [`score`](mod@score) matches the two by floor
//! area, and [`table`] prints what came out.
#![forbid(unsafe_code)]

pub mod found;
pub mod hints;
pub mod score;
pub mod table;
pub mod truth;
