//! Where the store's words become a stage's: errors, the budget, the I/O counters.

use enf_store::{BudgetError, IoCounters, MemoryBudget, Reservation, StoreError, format_bytes};
use serde_json::Value;

use crate::args::CommonArgs;
use crate::failure::{ExitStatus, Failure, Result};
use crate::memory;
use crate::stats::Stats;

/// Bytes set aside for each thread: the stack that it really touches, its share of the allocator.
const PER_THREAD: u64 = 256 << 10;

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::Budget(error) => error.into(),
            error => Self::new(ExitStatus::from_code(error.exit_code()), error.to_string()),
        }
    }
}

impl From<BudgetError> for Failure {
    fn from(error: BudgetError) -> Self {
        let lacking = error.needed.saturating_sub(error.available);
        // A refusal is rarely the last one: a little more than what this one lacked.
        let enough = error.limit.saturating_add(lacking).saturating_add(lacking / 4) >> 20;
        Self::budget(error.to_string()).with_hint(format!("try --memory {}M", enough + 2))
    }
}

/// Pages of code, of the allocator and of small tables that are not resident yet when the program starts.
const LATER_CODE: u64 = 3 << 20;

/// The budget that `--memory` gives, and the part of it that the process itself takes: what was
/// resident before any work (code, libraries, first stack), the code that comes in while it works, and a little
/// for each thread. Keep the reservation alive as long as the budget is used.
///
/// # Errors
/// [`ExitStatus::Budget`] if the process alone is more than `--memory`.
pub fn memory_budget(args: &CommonArgs) -> Result<(MemoryBudget, Reservation)> {
    let own = memory::fixed_overhead_bytes() + LATER_CODE + args.threads as u64 * PER_THREAD;
    let budget = MemoryBudget::new(args.memory);
    let reservation = budget.reserve(own, "the program itself").map_err(|_| {
        Failure::budget(format!(
            "--memory {} cannot work: the program itself takes {} with {} threads",
            format_bytes(args.memory),
            format_bytes(own),
            args.threads
        ))
        .with_hint("64M is enough for most buildings, 380M is the default")
    })?;
    Ok((budget, reservation))
}

impl Stats {
    /// `memory.peak_reserved_bytes`: the most that was ever reserved at once; `memory.reserved_at_peak`: for what, bytes each.
    pub fn set_budget(&mut self, budget: &MemoryBudget) {
        self.set("memory.peak_reserved_bytes", budget.peak());
        let holders = budget.peak_holders().into_iter();
        let holders = holders.map(|(what, bytes)| (what.to_owned(), bytes.into()));
        self.set("memory.reserved_at_peak", Value::Object(holders.collect()));
    }

    /// `io.read_bytes`, `io.written_bytes`, `io.inflated_bytes`: what the store counted since
    /// `before` (the counters at the stage's begin; the default for a store just opened).
    pub fn set_io(&mut self, now: IoCounters, before: IoCounters) {
        self.set("io.read_bytes", now.read_bytes.saturating_sub(before.read_bytes));
        self.set("io.written_bytes", now.written_bytes.saturating_sub(before.written_bytes));
        self.set("io.inflated_bytes", now.inflated_bytes.saturating_sub(before.inflated_bytes));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io;

    #[test]
    fn the_store_fails_with_its_own_codes() {
        let missing = StoreError::Missing { path: "b.enf".into(), remedy: "partition it".into() };
        let failure = Failure::from(missing);
        assert_eq!(failure.code, ExitStatus::Input);
        assert_eq!(failure.message, "b.enf is missing: partition it");
        let source = io::ErrorKind::StorageFull.into();
        let full = StoreError::Io { path: "b.enf".into(), action: "write", source };
        assert_eq!(Failure::from(full).code, ExitStatus::Io);
        let refused = MemoryBudget::new(10).reserve(11, "grid of a tile").unwrap_err();
        let failure = Failure::from(StoreError::from(refused.clone()));
        assert_eq!(failure.code, ExitStatus::Budget);
        assert!(failure.message.contains("grid of a tile"));
        assert!(failure.to_string().contains("try --memory "), "{failure}");
        assert_eq!(Failure::from(refused).code, ExitStatus::Budget);
    }

    #[test]
    fn the_program_is_in_the_budget() {
        let (budget, own) = memory_budget(&CommonArgs::default()).unwrap();
        assert_eq!((budget.limit(), budget.reserved()), (380 << 20, own.bytes()));
        assert!(own.bytes() > 1 << 20);
        let tiny = CommonArgs { memory: 1000, ..Default::default() };
        assert_eq!(memory_budget(&tiny).err().unwrap().code, ExitStatus::Budget);
    }

    #[test]
    fn counters_are_differences() {
        let mut stats = Stats::default();
        let before = IoCounters { read_bytes: 5, ..Default::default() };
        let now = IoCounters { read_bytes: 12, written_bytes: 3, inflated_bytes: 1 };
        stats.set_io(now, before);
        let budget = MemoryBudget::new(7);
        let (grid, mesh) = (budget.reserve(2, "grid").unwrap(), budget.reserve(4, "mesh").unwrap());
        drop(grid);
        let _more = budget.reserve(1, "more").unwrap();
        stats.set_budget(&budget);
        drop(mesh);
        assert_eq!(stats.get("io.read_bytes"), Some(&7u64.into()));
        assert_eq!(stats.get("memory.peak_reserved_bytes"), Some(&6u64.into()));
        let held = serde_json::json!({ "grid": 2, "mesh": 4 });
        assert_eq!(stats.get("memory.reserved_at_peak"), Some(&held));
    }
}
