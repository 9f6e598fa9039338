//! The store: one directory, `NAME.enf/`, that hands out slices of bytes and never sees a ray.
//!
//! | question | module |
//! |---|---|
//! | May I have this memory? | [`budget`] |
//! | What stages are in this directory, and how far are they? | [`dir`] |
//! | What was a stage made from? | [`identity`] |
//! | How do I write extents so that a kill loses nothing that was committed? | [`writer`] |
//! | How are bytes packed on their way to the disk? | [`encode`](mod@encode) |
//! | How do I read, map and check what was written? | [`reader`] |
//! | What has another process committed to the stage that I write? | [`peer`] |
//! | What does the seal of a finished stage say? | [`seal`] |
//! | Where do I sort what does not fit in memory? | [`scratch`] |
//! | What went wrong, where, and what helps? | [`error`] |
//!
//! A stage of one process is three files: `trace.000.000.dat` holds extents, `trace.000.journal`
//! makes them visible, `trace.seal` makes them immutable. Bytes mean nothing until the journal names
//! them, and a journal record counts only once a commit record follows it.

pub mod budget;
pub mod dir;
pub mod encode;
pub mod error;
mod files;
pub mod identity;
mod load;
mod map;
pub mod peer;
pub mod reader;
mod replay;
pub mod scratch;
pub mod seal;
pub mod writer;

pub use budget::{Array, ArrayFull, BudgetError, Buffer, MemoryBudget, Reservation, format_bytes};
pub use dir::{IoCounters, StageState, StoreDir};
pub use encode::{Encoded, Encoder, encode};
pub use error::StoreError;
pub use identity::Identity;
pub use load::{Extent, ExtentReader};
pub use map::{Mapped, give_back_free_memory, tune_allocator};
pub use peer::{Peer, PeerEvent};
pub use reader::{StageReader, Verified, verify};
pub use scratch::ScratchFile;
pub use writer::StageWriter;
