//! Words on stderr: messages, and how far along things are.
//!
//! Stdout belongs to data. On a terminal progress is a bar; elsewhere, if asked for, a plain line
//! every two seconds. Every word goes through here, so that a message never tears a bar.

use std::fmt;
use std::io::{self, IsTerminal, Write};
use std::sync::{LazyLock, OnceLock};
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressState, ProgressStyle};
use parking_lot::Mutex;

use crate::args::{CommonArgs, ProgressMode};

/// Time between two plain lines.
const LINE_EVERY: Duration = Duration::from_secs(2);

static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);
static PROGRAM: OnceLock<String> = OnceLock::new();

/// Sets the name that messages begin with; the first name stays.
pub(crate) fn set_program(name: &str) {
    PROGRAM.get_or_init(|| name.to_owned());
}

/// Writes a line on stderr, above any bar. A stderr that is gone is no reason to fail.
pub(crate) fn write_line(text: &str) {
    BARS.suspend(|| {
        let _ = io::stderr().lock().write_all(format!("{text}\n").as_bytes());
    });
}

/// [`write_line`], beginning with the program's name.
pub(crate) fn write_named(text: &str) {
    match PROGRAM.get() {
        Some(name) => write_line(&format!("{name}: {text}")),
        None => write_line(text),
    }
}

/// Says something on stderr, unless `--quiet`.
pub fn say(args: &CommonArgs, message: impl fmt::Display) {
    if !args.quiet {
        write_named(&message.to_string());
    }
}

/// Says something that only people who passed `-v` want to know.
pub fn detail(args: &CommonArgs, message: impl fmt::Display) {
    if args.verbose > 0 {
        say(args, message);
    }
}

/// Warns: the result is right, but something deserves a look. Silent with `--quiet`.
pub fn warn(args: &CommonArgs, message: impl fmt::Display) {
    if !args.quiet {
        write_named(&format!("warning: {message}"));
    }
}

/// How far along one piece of work is. Threads may share it.
///
/// Updates cost well under a microsecond; still, one a block is enough. Dropping it finishes it.
pub struct Progress(Shown);

enum Shown {
    Nothing,
    Bar(ProgressBar),
    Lines(Mutex<Lines>),
}

impl Progress {
    /// Begins to show progress as `args` wish. `label` is what is being done ("tracing"), `total`
    /// how much there is if that is known, in `unit` ("photons", "rooms", "rays", "bytes").
    pub fn new(args: &CommonArgs, label: &str, total: Option<u64>, unit: &'static str) -> Self {
        let terminal = io::stderr().is_terminal();
        let wanted = match args.progress {
            ProgressMode::Never => false,
            ProgressMode::Auto => terminal,
            ProgressMode::Always => true,
        };
        Self(match (wanted && !args.quiet, terminal) {
            (false, _) => Shown::Nothing,
            (true, true) => Shown::Bar(bar(label, total, unit)),
            (true, false) => Shown::Lines(Mutex::new(Lines::new(label, total, unit))),
        })
    }

    /// Progress that is never shown.
    pub fn hidden() -> Self {
        Self(Shown::Nothing)
    }

    /// `n` units are done in all.
    pub fn set(&self, n: u64) {
        match &self.0 {
            Shown::Nothing => {}
            Shown::Bar(bar) => bar.set_position(n),
            Shown::Lines(lines) => lines.lock().update(n),
        }
    }

    /// The total is now known, or has changed.
    pub fn set_total(&self, total: u64) {
        match &self.0 {
            Shown::Nothing => {}
            Shown::Bar(bar) => bar.set_length(total),
            Shown::Lines(lines) => lines.lock().total = Some(total),
        }
    }

    /// A few words behind the numbers, such as the room being worked on.
    pub fn message(&self, text: &str) {
        match &self.0 {
            Shown::Nothing => {}
            Shown::Bar(bar) => bar.set_message(text.to_owned()),
            Shown::Lines(lines) => lines.lock().message = text.to_owned(),
        }
    }

    /// The work is over: the bar goes, or a last line is written.
    pub fn finish(self) {
        drop(self);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        match &self.0 {
            Shown::Nothing => {}
            Shown::Bar(bar) => {
                bar.finish_and_clear();
                BARS.remove(bar);
            }
            Shown::Lines(lines) => lines.lock().last(),
        }
    }
}

fn bar(label: &str, total: Option<u64>, unit: &'static str) -> ProgressBar {
    let bar = BARS.add(total.map_or_else(ProgressBar::no_length, ProgressBar::new));
    let template = if total.is_some() {
        "{prefix} {bar:24} {percent:>3}%  {numbers}  {wide_msg}"
    } else {
        "{prefix} {spinner} {numbers}  {wide_msg}"
    };
    // The template is a constant and parses; a default bar would do no harm either.
    let style = ProgressStyle::with_template(template)
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .with_key("numbers", move |state: &ProgressState, out: &mut dyn fmt::Write| {
            let numbers = Numbers { done: state.pos(), total: state.len(), rate: state.per_sec() };
            let _ = out.write_str(&numbers.describe(unit));
        });
    bar.with_style(style).with_prefix(label.to_owned())
}

/// Plain lines for a stderr that is no terminal.
struct Lines {
    label: String,
    unit: &'static str,
    total: Option<u64>,
    message: String,
    done: u64,
    started: Instant,
    said: Instant,
}

impl Lines {
    fn new(label: &str, total: Option<u64>, unit: &'static str) -> Self {
        let (label, message, now) = (label.to_owned(), String::new(), Instant::now());
        Self { label, unit, total, message, done: 0, started: now, said: now }
    }

    fn update(&mut self, done: u64) {
        self.done = done;
        if self.said.elapsed() >= LINE_EVERY {
            self.said = Instant::now();
            write_named(&self.line(self.started.elapsed()));
        }
    }

    fn last(&mut self) {
        self.message.clear();
        write_named(&self.line(self.started.elapsed()));
    }

    fn line(&self, elapsed: Duration) -> String {
        let rate = self.done as f64 / elapsed.as_secs_f64().max(1e-3);
        let numbers = Numbers { done: self.done, total: self.total, rate }.describe(self.unit);
        let percent = match self.total {
            Some(total) if total > 0 => {
                format!("{:.0}%  ", 100.0 * self.done as f64 / total as f64)
            }
            _ => String::new(),
        };
        let gap = if self.message.is_empty() { "" } else { "  " };
        format!("{}: {percent}{numbers}{gap}{}", self.label, self.message)
    }
}

struct Numbers {
    done: u64,
    total: Option<u64>,
    /// Units per second.
    rate: f64,
}

impl Numbers {
    /// "1.20 of 4.00 M photons, 2.10 M/s, 1:23 left".
    fn describe(&self, unit: &str) -> String {
        let (show, noun): (fn(f64) -> String, String) = match unit {
            "bytes" => (binary, String::new()),
            _ => (decimal, format!(" {unit}")),
        };
        let mut text = show(self.done as f64);
        if let Some(total) = self.total {
            text += &format!(" of {}", show(total as f64));
        }
        text += &noun;
        if self.rate > 0.0 && self.rate.is_finite() {
            text += &format!(", {}/s", show(self.rate));
            if let Some(left) = self.total.map(|t| t.saturating_sub(self.done)).filter(|&l| l > 0) {
                text += &format!(", {} left", time(left as f64 / self.rate));
            }
        }
        text
    }
}

/// Three digits and a power of 1000.
fn decimal(value: f64) -> String {
    scaled(value, 1000.0, &["", " k", " M", " G", " T"])
}

/// Three digits and a power of 1024.
fn binary(value: f64) -> String {
    scaled(value, 1024.0, &[" B", " KiB", " MiB", " GiB", " TiB"])
}

fn scaled(mut value: f64, step: f64, units: &[&str]) -> String {
    let mut units = units.iter();
    let mut unit = units.next().copied().unwrap_or_default();
    let whole = value.fract() == 0.0 && value < step;
    for &next in units {
        if value < step - 0.5 {
            break;
        }
        (value, unit) = (value / step, next);
    }
    let digits = match value {
        _ if whole => 0,
        v if v < 9.995 => 2,
        v if v < 99.95 => 1,
        _ => 0,
    };
    format!("{value:.digits$}{unit}")
}

/// Seconds as "42 s", "3:07" or "2:03:07".
fn time(seconds: f64) -> String {
    // Saturates; a rate near zero gives a very long time, not an overflow.
    let s = seconds.round() as u64;
    match s {
        0..=59 => format!("{s} s"),
        60..=3599 => format!("{}:{:02}", s / 60, s % 60),
        _ => format!("{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (7.0, "7"),
            (7.25, "7.25"),
            (999.0, "999"),
            (999.7, "1.00 k"),
            (1234.0, "1.23 k"),
            (20_000.0, "20.0 k"),
            (999_999.0, "1.00 M"),
            (1.07e9, "1.07 G"),
        ] {
            assert_eq!(decimal(value), text);
        }
        assert_eq!(binary(380.0 * 1024.0 * 1024.0), "380 MiB");
        assert_eq!(binary(12.0), "12 B");
        assert_eq!(
            (time(59.4), time(187.0), time(7387.0)),
            ("59 s".into(), "3:07".into(), "2:03:07".into())
        );
        assert!(time(f64::INFINITY).contains(':'));
    }

    #[test]
    fn a_line_says_it_all() {
        let mut lines = Lines::new("tracing", Some(4_000_000), "photons");
        lines.done = 1_000_000;
        lines.message = "room 12".into();
        assert_eq!(
            lines.line(Duration::from_secs(2)),
            "tracing: 25%  1.00 M of 4.00 M photons, 500 k/s, 6 s left  room 12"
        );
        let lines = Lines::new("reading", None, "bytes");
        assert_eq!(lines.line(Duration::from_secs(2)), "reading: 0 B");
        let none = Lines::new("tracing", Some(0), "photons");
        assert_eq!(none.line(Duration::ZERO), "tracing: 0 of 0 photons");
    }

    #[test]
    fn quiet_and_never_show_nothing() {
        let quiet =
            CommonArgs { quiet: true, progress: ProgressMode::Always, ..Default::default() };
        assert!(matches!(Progress::new(&quiet, "x", None, "rooms").0, Shown::Nothing));
        let never = CommonArgs { progress: ProgressMode::Never, ..Default::default() };
        let progress = Progress::new(&never, "x", Some(3), "rooms");
        assert!(matches!(progress.0, Shown::Nothing));
        progress.set(1);
        progress.set_total(2);
        progress.message("y");
        progress.finish();
        bar("x", Some(3), "rooms").finish_and_clear();
    }
}
