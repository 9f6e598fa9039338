//! Scenes for other renderers, so that their pictures can be held against ours.
//!
//! [`building`] reads a scene or a store as everything here does; [`mitsuba`] writes it for Mitsuba 3's path tracer,
//! [`radiance`] for Radiance's `oconv` and `rpict`; [`compare`](mod@compare) says how far two pictures are apart, room by room.
//!
//! What another renderer has no faithful counterpart for is written as near as it goes, and said: see [`Notes`].
//! Those renderers hold a whole scene in memory, and so does this.
#![forbid(unsafe_code)]

pub mod building;
pub mod compare;
pub mod mitsuba;
mod pfm;
pub mod radiance;
pub mod view;

/// What was not carried over faithfully, one sentence each, in the order of materials, lights and views.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Notes(pub Vec<String>);

impl Notes {
    /// Adds a sentence about a material.
    pub fn material(&mut self, name: &str, what: &str) {
        self.0.push(format!("material {name}: {what}"));
    }

    /// Adds a sentence about a light.
    pub fn light(&mut self, name: &str, what: &str) {
        self.0.push(format!("light {name}: {what}"));
    }

    /// Adds a sentence about a view.
    pub fn view(&mut self, name: &str, what: &str) {
        self.0.push(format!("view {name}: {what}"));
    }
}
