//! What the kernel says this process holds, in bytes.
//!
//! The promise is about what a user measures, so that is what is asked: `/proc/self/status`.

use std::sync::OnceLock;

/// The most bytes that were ever resident at once (`VmHWM`); 0 where the kernel does not say.
pub fn peak_resident() -> u64 {
    own("VmHWM:")
}

/// The bytes resident now (`VmRSS`); 0 where the kernel does not say.
pub fn resident() -> u64 {
    own("VmRSS:")
}

/// The bytes that were resident when this was first asked. [`crate::run_main`] asks before
/// anything else, so that code, libraries and first stack are counted in the budget too.
pub fn fixed_overhead_bytes() -> u64 {
    static AT_START: OnceLock<u64> = OnceLock::new();
    *AT_START.get_or_init(resident)
}

fn own(field: &str) -> u64 {
    std::fs::read_to_string("/proc/self/status").map_or(0, |status| parse(&status, field))
}

/// The value of one field of `/proc/self/status`, whose unit is always kB (1024 bytes).
fn parse(status: &str, field: &str) -> u64 {
    status
        .lines()
        .find_map(|line| line.strip_prefix(field))
        .and_then(|rest| rest.trim().trim_end_matches("kB").trim_end().parse::<u64>().ok())
        .map_or(0, |kib| kib.saturating_mul(1024))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_kib() {
        let status = "Name:\tenf-trace\nVmHWM:\t  389120 kB\nVmRSS:\t    1024 kB\n";
        assert_eq!(parse(status, "VmHWM:"), 380 << 20);
        assert_eq!(parse(status, "VmRSS:"), 1 << 20);
        assert_eq!(parse(status, "VmSwap:"), 0);
        assert_eq!(parse("VmRSS:\tmany kB", "VmRSS:"), 0);
    }

    #[test]
    fn memory_that_is_touched_is_seen() {
        let before = fixed_overhead_bytes();
        let touched = vec![1u8; 32 << 20];
        let now = resident();
        assert!(peak_resident() >= now);
        assert!(now >= 32 << 20, "{now} resident, {before} before");
        assert_eq!(fixed_overhead_bytes(), before);
        assert_eq!(touched.iter().map(|&b| u64::from(b)).sum::<u64>(), 32 << 20);
    }
}
