//! How fast something goes, lately, and how long the rest will take.
//!
//! Work on a building does not go at one pace: the first rooms are sent most of the light, the last ones are loaded for a few
//! photons. So the pace is that of the last third of the time, and at first there is none.

use std::collections::VecDeque;
use std::time::Duration;

/// The pace is measured over so much of the time that has gone by, but over [`SHORTEST`] at least.
const LATELY: f64 = 1.0 / 3.0;
/// Seconds.
const SHORTEST: f64 = 4.0;
/// Before so many seconds have gone by there is no rate.
const RATE_AFTER: f64 = 1.0;
/// Before that, or before so much is done, or in so few steps, nothing is said about the rest.
const LEFT_AFTER: f64 = 4.0;
const LEFT_SHARE: f64 = 0.01;
const LEFT_STEPS: usize = 4;
/// Samples that are kept; a longer time is kept more coarsely.
const SAMPLES: usize = 256;

/// See the module. What is done is a number that grows, in any unit.
#[derive(Debug, Default)]
pub(crate) struct Pace {
    /// (seconds, done) at some moments, the first one always; never more than [`SAMPLES`].
    samples: VecDeque<(f64, f64)>,
    /// The latest.
    now: (f64, f64),
    /// Seconds between two samples that are kept.
    step: f64,
    over: bool,
}

impl Pace {
    /// `elapsed` after the beginning so much was done. The first note says what was done before.
    pub(crate) fn note(&mut self, elapsed: Duration, done: f64) {
        self.now = (elapsed.as_secs_f64(), done);
        if self.samples.back().is_some_and(|last| self.now.0 - last.0 < self.step) {
            return;
        }
        self.samples.push_back(self.now);
        if self.samples.len() >= SAMPLES {
            // Every second one goes, and from now on half as many come.
            let mut index = 0;
            self.samples.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.step = (2.0 * self.step).max(0.05);
        }
    }

    /// It is over: the rate is that of the whole time.
    pub(crate) fn end(&mut self, elapsed: Duration, done: f64) {
        self.note(elapsed, done);
        self.over = true;
    }

    /// Where the time begins over which the pace is measured.
    fn since(&self) -> Option<(f64, f64)> {
        let first = *self.samples.front()?;
        if self.over {
            return Some(first);
        }
        let from = self.now.0 - (LATELY * (self.now.0 - first.0)).max(SHORTEST);
        // The last sample before that moment.
        self.samples.iter().rev().find(|s| s.0 <= from).copied().or(Some(first))
    }

    /// Done a second, lately; `None` when that means nothing yet.
    pub(crate) fn rate(&self) -> Option<f64> {
        let (since, before) = self.since()?;
        let (seconds, done) = (self.now.0 - since, self.now.1 - before);
        (seconds >= RATE_AFTER && done > 0.0).then(|| done / seconds)
    }

    /// Seconds until `all` is done; `None` when nobody can know.
    pub(crate) fn left(&self, all: f64) -> Option<f64> {
        let first = self.samples.front()?;
        let rest = all - self.now.1;
        let enough = self.now.0 - first.0 >= LEFT_AFTER
            && self.now.1 - first.1 >= LEFT_SHARE * all
            && self.steps() >= LEFT_STEPS;
        (enough && rest > 0.0 && !self.over).then_some(())?;
        self.rate().map(|rate| rest / rate)
    }

    /// How often something was done since the beginning, as far as it is known.
    fn steps(&self) -> usize {
        let moments = self.samples.iter().chain([&self.now]);
        moments.clone().zip(moments.skip(1)).filter(|(a, b)| b.1 > a.1).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pace(at: impl IntoIterator<Item = (f64, f64)>) -> Pace {
        let mut pace = Pace::default();
        for (seconds, done) in at {
            pace.note(Duration::from_secs_f64(seconds), done);
        }
        pace
    }

    #[test]
    fn a_steady_pace_is_known_exactly() {
        // Noted rarely, often, and more often than is kept.
        for often in [1.0, 10.0, 1000.0] {
            let steady = pace((0..=(40.0 * often) as u32).map(|i| {
                let t = f64::from(i) / often;
                (t, 5.0 + 0.5 * t)
            }));
            assert!((steady.rate().unwrap() - 0.5).abs() < 1e-9);
            assert!((steady.left(100.0).unwrap() - 150.0).abs() < 1e-6, "{often}");
            assert!(steady.samples.len() < SAMPLES);
        }
    }

    #[test]
    fn what_was_done_before_does_not_count() {
        let resumed = pace((0..=10).map(|i| (f64::from(i), 0.9 + 0.001 * f64::from(i))));
        assert!((resumed.left(1.0).unwrap() - 90.0).abs() < 1e-6);
    }

    /// Nine tenths in ten seconds, and then a hundredth a second: the rest takes ten seconds less what is gone, not one.
    #[test]
    fn a_slow_end_is_seen() {
        let slow = |t: f64| if t < 10.0 { 0.09 * t } else { 0.9 + 0.01 * (t - 10.0) };
        for t in [14.0, 16.0, 18.0] {
            let pace = pace(
                (0..=(4.0 * t) as u32).map(|i| (f64::from(i) / 4.0, slow(f64::from(i) / 4.0))),
            );
            let (left, rest) = (pace.left(1.0).unwrap(), 20.0 - t);
            assert!((left / rest - 1.0).abs() < 0.7, "{left} s at {t} s, not {rest}");
        }
        let late = pace((0..=18 * 4).map(|i| (f64::from(i) / 4.0, slow(f64::from(i) / 4.0))));
        assert!((late.left(1.0).unwrap() - 2.0).abs() < 1e-6);
    }

    #[test]
    fn nothing_is_said_too_early() {
        assert_eq!(pace([]).rate(), None);
        assert_eq!(pace([(0.0, 3.0)]).rate(), None);
        assert_eq!(pace([(0.0, 0.0), (0.5, 0.2)]).rate(), None, "too short");
        let short = pace((0..=20).map(|i| (0.1 * f64::from(i), 0.02 * f64::from(i))));
        assert!(short.rate().is_some() && short.left(1.0).is_none(), "two seconds");
        let little = pace((0..=20).map(|i| (f64::from(i), 0.0001 * f64::from(i))));
        assert_eq!(little.left(1.0), None, "a fifth of a percent");
        let one = pace([(0.0, 0.0), (5.0, 0.0), (9.0, 0.5), (10.0, 0.5)]);
        assert_eq!(one.left(1.0), None, "one step says nothing about the next");
        let done = pace((0..=20).map(|i| (f64::from(i), 0.05 * f64::from(i))));
        assert_eq!(done.left(1.0), None, "nothing is left");
    }

    #[test]
    fn a_standstill_takes_longer_and_longer() {
        let mut still = pace((0..=20).map(|i| (f64::from(i), 0.02 * f64::from(i))));
        let before = still.left(1.0).unwrap();
        still.note(Duration::from_secs(24), 0.4);
        assert!(still.left(1.0).unwrap() > before);
        still.note(Duration::from_secs(60), 0.4);
        assert_eq!(still.left(1.0), None, "nobody knows");
    }
}
