//! The flags that every stage takes, and how people write sizes and counts.
//!
//! Sizes are bytes and their letters are powers of 1024, as in systemd and SLURM; counts are
//! things and their letters are powers of 1000, because twenty thousand photons are 20000.

use std::num::NonZero;
use std::path::PathBuf;
use std::thread::available_parallelism;

use clap::{Args, ValueEnum};

/// Bytes of [`CommonArgs::memory`] when nothing is said: 380 MiB, the paper's machine.
pub const DEFAULT_MEMORY: u64 = 380 << 20;

/// More threads than this are refused: their stacks and scratch alone would be the budget.
pub const MAX_THREADS: usize = 1024;

/// When progress is shown on stderr.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ProgressMode {
    /// If stderr is a terminal.
    #[default]
    Auto,
    /// Always: a bar on a terminal, a plain line every two seconds elsewhere.
    Always,
    /// Never.
    Never,
}

/// The flags that every stage takes.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Common options")]
pub struct CommonArgs {
    /// Most memory the process may hold, heap and mapped pages together (K, M, G: powers of 1024)
    #[arg(long, value_name = "SIZE", default_value = "380M", value_parser = parse_size)]
    pub memory: u64,

    /// Worker threads [default: the CPUs allowed]
    #[arg(
        long,
        value_name = "N",
        default_value_t = default_threads(),
        hide_default_value = true,
        value_parser = parse_threads
    )]
    pub threads: usize,

    /// Seed of every random number; the same seed gives the same bits
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,

    /// Write what was done and what it cost to this file, as JSON
    #[arg(long, value_name = "FILE")]
    pub stats: Option<PathBuf>,

    /// When to show progress on stderr
    #[arg(long, value_name = "WHEN", value_enum, default_value_t)]
    pub progress: ProgressMode,

    /// Say nothing but errors (ids still go to stdout)
    #[arg(long)]
    pub quiet: bool,

    /// Say more; twice says everything
    #[arg(short, long, action = clap::ArgAction::Count)]
    pub verbose: u8,

    /// Write a timeline of work and I/O to this file, in Chrome's trace format (opens in Perfetto)
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,

    /// Number of this process among those that share the stage: each has its own files
    #[arg(long, value_name = "N", default_value_t = 0, hide = true)]
    pub process: u32,
}

impl Default for CommonArgs {
    /// What the flags say when none is given.
    fn default() -> Self {
        Self {
            memory: DEFAULT_MEMORY,
            threads: default_threads(),
            seed: 1,
            stats: None,
            progress: ProgressMode::Auto,
            quiet: false,
            verbose: 0,
            trace: None,
            process: 0,
        }
    }
}

/// The CPUs that this process may use (affinity and control groups included), at least 1.
pub fn default_threads() -> usize {
    available_parallelism().map_or(1, NonZero::get).clamp(1, MAX_THREADS)
}

fn parse_threads(text: &str) -> Result<usize, String> {
    match text.parse::<usize>() {
        Ok(n) if (1..=MAX_THREADS).contains(&n) => Ok(n),
        _ => Err(format!("a number from 1 to {MAX_THREADS} is wanted")),
    }
}

/// Bytes: `4096`, `512K`, `380M`, `1.5G`, `2T`. Letters are powers of 1024, in either case; a
/// fraction is rounded down to whole bytes.
///
/// # Errors
/// What is wrong with `text`, as the end of a sentence that quotes it.
pub fn parse_size(text: &str) -> Result<u64, String> {
    let (digits, unit) = split_unit(text);
    let unit = match unit.to_ascii_uppercase().as_str() {
        "" | "B" => 1,
        "K" | "KIB" => 1 << 10,
        "M" | "MIB" => 1 << 20,
        "G" | "GIB" => 1 << 30,
        "T" | "TIB" => 1 << 40,
        _ => return Err(format!("unknown unit \"{unit}\": bytes, K, M, G or T (powers of 1024)")),
    };
    let (whole, rest) = scale(digits, unit).ok_or_else(|| wanted("a size such as 380M or 1.5G"))?;
    if unit == 1 && rest { Err("bytes come whole".into()) } else { fit(whole) }
}

/// A count of things: `500`, `20k`, `1.5M`, `2G`. Letters are powers of 1000, in either case.
///
/// # Errors
/// What is wrong with `text`, as the end of a sentence that quotes it.
pub fn parse_count(text: &str) -> Result<u64, String> {
    let (digits, unit) = split_unit(text);
    let unit = match unit {
        "" => 1,
        "k" | "K" => 1_000,
        "M" | "m" => 1_000_000,
        "G" | "g" => 1_000_000_000,
        _ => return Err(format!("unknown unit \"{unit}\": k, M or G (powers of 1000)")),
    };
    let (whole, rest) = scale(digits, unit).ok_or_else(|| wanted("a count such as 500 or 20k"))?;
    if rest { Err("this is not a whole number".into()) } else { fit(whole) }
}

fn wanted(what: &str) -> String {
    format!("{what} is wanted")
}

fn fit(value: u128) -> Result<u64, String> {
    u64::try_from(value).map_err(|_| "this is more than 64 bits can hold".into())
}

fn split_unit(text: &str) -> (&str, &str) {
    let end = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    text.split_at(end)
}

/// `digits` (decimal, at most one point) times `unit`: the whole part, and whether anything was
/// rounded away. Exact: no float is involved.
fn scale(digits: &str, unit: u128) -> Option<(u128, bool)> {
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    if whole.is_empty() || (digits.contains('.') && fraction.is_empty()) {
        return None;
    }
    let fraction = fraction.trim_end_matches('0');
    let (whole_digits, fraction_digits) = (whole.trim_start_matches('0'), fraction);
    // 20 digits hold any u64; 18 more of fraction, times a unit of 2^40, still fit in 128 bits.
    if whole_digits.len() > 20 {
        return whole.bytes().all(|b| b.is_ascii_digit()).then_some((u128::MAX, false));
    }
    if fraction_digits.len() > 18 || fraction_digits.contains('.') {
        return None;
    }
    let parse = |s: &str| if s.is_empty() { Some(0) } else { s.parse::<u128>().ok() };
    let denominator = 10u128.pow(u32::try_from(fraction_digits.len()).ok()?);
    let part = parse(fraction_digits)? * unit;
    Some((parse(whole_digits)? * unit + part / denominator, !part.is_multiple_of(denominator)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use proptest::prelude::*;

    #[derive(Parser)]
    struct Tool {
        #[command(flatten)]
        common: CommonArgs,
    }

    #[test]
    fn sizes_are_powers_of_1024() {
        for (text, bytes) in [
            ("0", 0),
            ("4096", 4096),
            ("512K", 512 << 10),
            ("380M", 380 << 20),
            ("380m", 380 << 20),
            ("380MiB", 380 << 20),
            ("2G", 2 << 30),
            ("1.5G", 3 << 29),
            ("1.50G", 3 << 29),
            ("0.3K", 307),
            ("2T", 2 << 40),
            ("0000000000000000000000001K", 1024),
            ("18446744073709551615", u64::MAX),
            ("16777215.99999T", 18446744073698556499),
        ] {
            assert_eq!(parse_size(text), Ok(bytes), "{text}");
        }
        for text in [
            "",
            "M",
            "-1",
            "1.5",
            "1..5G",
            "1.2.3G",
            ".5G",
            "5.G",
            "1e9",
            "380X",
            "380MB",
            "1 G",
            "18446744073709551616",
            "16777216T",
            "9999999999999999999999999",
            " 1",
            "1K ",
            "٣K",
            "0.0000000000000000001G",
        ] {
            assert!(parse_size(text).is_err(), "{text}");
        }
    }

    #[test]
    fn counts_are_powers_of_1000() {
        for (text, n) in [
            ("0", 0),
            ("20k", 20_000),
            ("20K", 20_000),
            ("1.5M", 1_500_000),
            ("2G", 2_000_000_000),
            ("0.001k", 1),
        ] {
            assert_eq!(parse_count(text), Ok(n), "{text}");
        }
        for text in ["", "k", "1.5", "0.0001k", "-3", "20kk", "1T", "20 k", "NaN", "inf"] {
            assert!(parse_count(text).is_err(), "{text}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_answered(text in "\\PC*") {
            let _ = (parse_size(&text), parse_count(&text));
        }

        #[test]
        fn every_number_is_itself(n: u64) {
            prop_assert_eq!(parse_size(&n.to_string()), Ok(n));
            prop_assert_eq!(parse_count(&n.to_string()), Ok(n));
        }

        #[test]
        fn fractions_are_exact(whole in 0u64..1000, milli in 0u64..1000) {
            let text = format!("{whole}.{milli:03}");
            prop_assert_eq!(parse_count(&format!("{text}k")), Ok(whole * 1000 + milli));
            prop_assert_eq!(
                parse_size(&format!("{text}G")),
                Ok(((whole * 1000 + milli) << 30) / 1000)
            );
        }
    }

    #[test]
    fn defaults_are_the_contract() {
        let parsed = Tool::try_parse_from(["tool"]).unwrap().common;
        let default = CommonArgs::default();
        assert_eq!(format!("{parsed:?}"), format!("{default:?}"));
        assert_eq!((parsed.memory, parsed.seed, parsed.process), (380 << 20, 1, 0));
        assert_eq!(parsed.threads, available_parallelism().unwrap().get());
        assert_eq!(parsed.progress, ProgressMode::Auto);
    }

    #[test]
    fn flags_are_read() {
        let args = Tool::try_parse_from([
            "tool",
            "--memory",
            "64M",
            "--threads",
            "3",
            "--seed",
            "7",
            "--stats",
            "s.json",
            "--progress",
            "never",
            "--quiet",
            "-vv",
            "--trace",
            "t.json",
            "--process",
            "2",
        ])
        .unwrap()
        .common;
        assert_eq!((args.memory, args.threads, args.seed, args.process), (64 << 20, 3, 7, 2));
        assert_eq!((args.quiet, args.verbose, args.progress), (true, 2, ProgressMode::Never));
        assert_eq!(args.stats.unwrap().to_str(), Some("s.json"));
        assert_eq!(args.trace.unwrap().to_str(), Some("t.json"));
        for bad in
            [["--threads", "0"], ["--threads", "2000"], ["--memory", "lots"], ["--seed", "x"]]
        {
            assert!(Tool::try_parse_from(["tool", bad[0], bad[1]]).is_err(), "{bad:?}");
        }
    }
}
