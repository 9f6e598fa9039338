//! What every Enfilade binary shares.
//!
//! A stage is a Unix tool first: it takes the same flags as its siblings ([`CommonArgs`]), reads
//! room ids from its left neighbour ([`stdin_ids`]) and hands them to its right one ([`IdSink`]),
//! keeps its words on stderr ([`say`], [`Progress`]), stops politely ([`interrupted`]), leaves a
//! record of what it did ([`Stats`], [`Timeline`]) and ends with a code that a batch system can
//! branch on ([`run_main`], [`Failure`]).
//!
//! Beside the manners live the small machines that every streaming stage is built around: the tiles in
//! memory ([`resident::TileCache`]), the table of incoming records ([`RowTable`]) and the choice of what to visit
//! next ([`Scheduler`], [`Sweep`]). None of them knows what a photon is.
#![forbid(unsafe_code)]

pub mod args;
pub mod failure;
pub mod ids;
pub mod interrupt;
pub mod memory;
pub mod neighbours;
pub mod ordered;
mod pace;
pub mod progress;
pub mod resident;
pub mod rowtable;
pub mod scheduler;
pub mod session;
pub mod stats;
pub mod store;
pub mod sweep;
pub mod tables;
pub mod timeline;

pub use args::{CommonArgs, ProgressMode, parse_count, parse_size};
pub use failure::{ExitStatus, Failure, IoContext, Result, run_main};
pub use ids::{IdSink, IdSource, Selection, stdin_ids};
pub use interrupt::interrupted;
pub use memory::{fixed_overhead_bytes, peak_resident, resident};
pub use neighbours::Neighbours;
pub use progress::{Progress, detail, say, warn};
pub use rowtable::RowTable;
pub use scheduler::{Schedule, Scheduler};
pub use stats::Stats;
pub use store::memory_budget;
pub use sweep::Sweep;
pub use timeline::{Lane, Span, Timeline};
