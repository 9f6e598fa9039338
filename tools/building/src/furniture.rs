//! The workshop: everything that stands, lies or hangs in a room.
//!
//! A piece is centred on x = y = 0, stands on z = 0 and turns its front to -y and its back to +y;
//! what hangs on a wall has its back at the greatest y. Metres.

pub mod decor;
pub mod fine;
pub mod seating;
pub mod sets;
pub mod storage;
pub mod tables;
pub mod wet;
