//! Words on stderr: messages, and how far along things are.
//!
//! Stdout belongs to data. On a terminal progress is a bar; elsewhere, if asked for, a plain line
//! every two seconds. Every word goes through here, so that a message never tears a bar.
//!
//! How long it is going to take is guessed from the recent pace ([`Pace`](crate::pace::Pace)), and left unsaid
//! until there is something to guess from.

use std::fmt;
use std::io::{self, IsTerminal, Write};
use std::sync::{LazyLock, OnceLock};
use std::time::{Duration, Instant};

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use parking_lot::Mutex;

use crate::args::{CommonArgs, ProgressMode};
use crate::pace::Pace;

/// Time between two plain lines.
const LINE_EVERY: Duration = Duration::from_secs(2);
/// Time between two looks of a bar.
const BAR_EVERY: Duration = Duration::from_millis(100);
/// A full bar: shares are counted in parts of this.
const BAR_LENGTH: u64 = 10_000;

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
    Bar(ProgressBar, Mutex<Meter>),
    Lines(Mutex<Meter>),
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
        let meter = || Mutex::new(Meter::new(label, total, unit, Instant::now()));
        Self(match (wanted && !args.quiet, terminal) {
            (false, _) => Shown::Nothing,
            (true, true) => Shown::Bar(bar(label, total.is_some()), meter()),
            (true, false) => Shown::Lines(meter()),
        })
    }

    /// Progress that is never shown.
    pub fn hidden() -> Self {
        Self(Shown::Nothing)
    }

    /// `n` units are done in all, and the work is as far as that says.
    pub fn set(&self, n: u64) {
        self.update(|meter| (meter.done, meter.share) = (n, None));
    }

    /// `n` units are done in all, and `share` of the work, from 0 to 1. Some units are more work than others: the share
    /// decides about the percentage and the time that is left, the units about the rate.
    pub fn at(&self, n: u64, share: f64) {
        self.update(|meter| (meter.done, meter.share) = (n, Some(share.clamp(0.0, 1.0))));
    }

    /// So much, and this share of the work, was done by an earlier run: it is no part of the pace.
    pub fn resume(&self, n: u64, share: f64) {
        self.update(|meter| meter.resume(n, share.clamp(0.0, 1.0), Instant::now()));
    }

    /// A few words behind the numbers, such as the room being worked on.
    pub fn message(&self, text: &str) {
        match &self.0 {
            Shown::Nothing => {}
            Shown::Bar(_, meter) | Shown::Lines(meter) => {
                text.clone_into(&mut meter.lock().message)
            }
        }
    }

    /// The work is over: the bar goes, or a last line is written.
    pub fn finish(self) {
        drop(self);
    }

    fn update(&self, change: impl FnOnce(&mut Meter)) {
        let (meter, every) = match &self.0 {
            Shown::Nothing => return,
            Shown::Bar(_, meter) => (meter, BAR_EVERY),
            Shown::Lines(meter) => (meter, LINE_EVERY),
        };
        let mut meter = meter.lock();
        change(&mut meter);
        let now = Instant::now();
        meter.note(now);
        if now.duration_since(meter.said) < every {
            return;
        }
        meter.said = now;
        match &self.0 {
            Shown::Nothing => {}
            Shown::Bar(bar, _) => {
                if let Some(share) = meter.share_done() {
                    bar.set_length(BAR_LENGTH);
                    bar.set_position((share * BAR_LENGTH as f64) as u64);
                }
                bar.set_message(meter.text());
                bar.tick();
            }
            Shown::Lines(_) => write_named(&meter.line()),
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        match &self.0 {
            Shown::Nothing => {}
            Shown::Bar(bar, _) => {
                bar.finish_and_clear();
                BARS.remove(bar);
            }
            Shown::Lines(meter) => {
                let mut meter = meter.lock();
                meter.message.clear();
                meter.over(Instant::now());
                write_named(&meter.line());
            }
        }
    }
}

fn bar(label: &str, total: bool) -> ProgressBar {
    let bar = BARS.add(if total { ProgressBar::new(BAR_LENGTH) } else { ProgressBar::no_length() });
    let template = if total {
        "{prefix} {bar:24} {percent:>3}%  {wide_msg}"
    } else {
        "{prefix} {spinner}  {wide_msg}"
    };
    // The template is a constant and parses; a default bar would do no harm either.
    let style =
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    bar.with_style(style).with_prefix(label.to_owned())
}

/// What is known about the work.
struct Meter {
    label: String,
    unit: &'static str,
    total: Option<u64>,
    message: String,
    done: u64,
    /// Of the work, if that is not what the units say.
    share: Option<f64>,
    /// Pace of the units, and of the share.
    units: Pace,
    work: Pace,
    started: Instant,
    said: Instant,
}

impl Meter {
    fn new(label: &str, total: Option<u64>, unit: &'static str, now: Instant) -> Self {
        let (label, message) = (label.to_owned(), String::new());
        let (units, work) = (Pace::default(), Pace::default());
        let (done, share, started, said) = (0, None, now, now);
        let mut meter =
            Self { label, unit, total, message, done, share, units, work, started, said };
        meter.note(now);
        meter
    }

    fn resume(&mut self, done: u64, share: f64, now: Instant) {
        (self.done, self.share) = (done, Some(share));
        (self.units, self.work) = (Pace::default(), Pace::default());
        self.note(now);
    }

    /// How much of the work is done, from 0 to 1.
    fn share_done(&self) -> Option<f64> {
        let total = self.total.filter(|&total| total > 0)?;
        Some(self.share.unwrap_or(self.done as f64 / total as f64).min(1.0))
    }

    fn note(&mut self, now: Instant) {
        let elapsed = now.duration_since(self.started);
        self.units.note(elapsed, self.done as f64);
        if let Some(share) = self.share_done() {
            self.work.note(elapsed, share);
        }
    }

    /// From now on the rate is that of all the time.
    fn over(&mut self, now: Instant) {
        let elapsed = now.duration_since(self.started);
        self.units.end(elapsed, self.done as f64);
        self.work = Pace::default();
    }

    /// "trace: 25%  1.00 M of 4.00 M photons, 500 k/s, 6 s left  room 12".
    fn line(&self) -> String {
        let percent = match self.share_done() {
            // Rounded down: nothing is 100 % that is not at its end.
            Some(share) => format!("{}%  ", (100.0 * share) as u64),
            None => String::new(),
        };
        format!("{}: {percent}{}", self.label, self.text())
    }

    /// "1.00 M of 4.00 M photons, 500 k/s, 6 s left  room 12".
    fn text(&self) -> String {
        let (show, noun): (fn(f64) -> String, String) = match self.unit {
            "bytes" => (binary, String::new()),
            unit => (decimal, format!(" {unit}")),
        };
        let mut text = show(self.done as f64);
        if let Some(total) = self.total {
            text += &format!(" of {}", show(total as f64));
        }
        text += &noun;
        if let Some(rate) = self.units.rate() {
            text += &format!(", {}/s", show(rate));
        }
        if let Some(left) = self.work.left(1.0) {
            text += &format!(", {} left", time(left));
        }
        if !self.message.is_empty() {
            text += &format!("  {}", self.message);
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

    /// A meter to which `at` told (seconds, units, share).
    fn meter(total: Option<u64>, unit: &'static str, at: &[(f64, u64, Option<f64>)]) -> Meter {
        let start = Instant::now();
        let mut meter = Meter::new("trace", total, unit, start);
        for &(seconds, done, share) in at {
            (meter.done, meter.share) = (done, share);
            meter.note(start + Duration::from_secs_f64(seconds));
        }
        meter
    }

    #[test]
    fn a_line_says_it_all() {
        let steady: Vec<_> = (0..=10).map(|i| (f64::from(i), 100_000 * i as u64, None)).collect();
        let mut lines = meter(Some(4_000_000), "photons", &steady);
        lines.message = "room 12".into();
        assert_eq!(
            lines.line(),
            "trace: 25%  1.00 M of 4.00 M photons, 100 k/s, 30 s left  room 12"
        );
        assert!(lines.line().chars().all(|c| !c.is_control()), "no control codes in a pipe");
        assert_eq!(meter(None, "bytes", &[]).line(), "trace: 0 B");
        assert_eq!(meter(Some(0), "photons", &[]).line(), "trace: 0 of 0 photons");
        let unknown = meter(None, "photons", &steady);
        assert_eq!(unknown.line(), "trace: 1.00 M photons, 100 k/s");
    }

    /// Most photons have ended, but most of the light has not.
    #[test]
    fn the_share_decides_and_the_units_are_shown() {
        let light: Vec<_> = (0..=20)
            .map(|i| (f64::from(i), 190_000 * i as u64, Some(0.02 * f64::from(i))))
            .collect();
        let lines = meter(Some(4_000_000), "photons", &light);
        assert_eq!(lines.line(), "trace: 40%  3.80 M of 4.00 M photons, 190 k/s, 30 s left");
        let nearly = meter(Some(10), "photons", &[(0.0, 10, Some(0.9999))]);
        assert_eq!(nearly.line(), "trace: 99%  10 of 10 photons");
    }

    /// What an earlier run has done is no work of this one.
    #[test]
    fn a_resumed_run_has_its_own_pace() {
        let mut lines = meter(Some(4_000_000), "photons", &[]);
        lines.resume(3_000_000, 0.75, lines.started);
        for i in 1..=10 {
            (lines.done, lines.share) = (3_000_000 + 50_000 * i, None);
            lines.note(lines.started + Duration::from_secs(i));
        }
        assert_eq!(lines.line(), "trace: 87%  3.50 M of 4.00 M photons, 50.0 k/s, 10 s left");
        lines.over(lines.started + Duration::from_secs(20));
        assert_eq!(lines.line(), "trace: 87%  3.50 M of 4.00 M photons, 25.0 k/s");
    }

    #[test]
    fn nothing_is_guessed_at_the_beginning() {
        let first = meter(Some(4_000_000), "photons", &[(0.0, 0, None), (0.4, 90_000, None)]);
        assert_eq!(first.line(), "trace: 2%  90.0 k of 4.00 M photons");
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
        progress.message("y");
        progress.finish();
        bar("x", true).finish_and_clear();
        bar("x", false).finish_and_clear();
    }
}
