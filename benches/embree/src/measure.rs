//! Runs contenders in turn, and keeps what each took.

use std::hint::black_box;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::clock::{Sample, median, time};

/// Whatever a run makes: dropped after the clock has stopped.
pub trait Made {}

impl<T> Made for T {}

/// Something to measure.
pub struct Contender<'a, E> {
    /// What to call it.
    pub name: String,
    /// Does the work once.
    pub run: Box<dyn Fn() -> Result<Box<dyn Made + 'a>, E> + 'a>,
}

impl<'a, E> Contender<'a, E> {
    /// A contender that cannot fail.
    pub fn new<T: 'a>(name: impl Into<String>, run: impl Fn() -> T + 'a) -> Self {
        Self::fallible(name, move || Ok(run()))
    }

    /// A contender that can.
    pub fn fallible<T: 'a>(name: impl Into<String>, run: impl Fn() -> Result<T, E> + 'a) -> Self {
        let run = move || run().map(|made| Box::new(black_box(made)) as Box<dyn Made + 'a>);
        Self { name: name.into(), run: Box::new(run) }
    }
}

/// What one contender took.
#[derive(Clone, Debug)]
pub struct Series {
    /// Its name.
    pub name: String,
    /// One sample for each repetition.
    pub samples: Vec<Sample>,
}

/// The same work, done by all contenders in turn. The first one is ours.
#[derive(Clone, Debug)]
pub struct Group {
    /// What was done.
    pub measure: String,
    /// How much of it, in each run: triangles or rays.
    pub work: f64,
    /// With so many threads.
    pub threads: u32,
    /// One for each contender.
    pub series: Vec<Series>,
}

/// A rate or a ratio, by both clocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figure {
    /// By the clock on the wall.
    pub wall: f64,
    /// By CPU time.
    pub cpu: f64,
}

impl Group {
    /// Runs every contender once to warm up, then all of them in turn, `repetitions` times, every other time backwards, so
    /// that neighbours see the same state of the machine.
    pub fn run<E>(
        measure: impl Into<String>,
        work: usize,
        threads: u32,
        repetitions: u32,
        contenders: &[Contender<'_, E>],
    ) -> Result<Self, E> {
        let mut series: Vec<Series> = contenders
            .iter()
            .map(|c| Series { name: c.name.clone(), samples: Vec::new() })
            .collect();
        for contender in contenders {
            drop((contender.run)()?);
        }
        for repetition in 0..repetitions {
            for k in 0..contenders.len() {
                let k = if repetition % 2 == 0 { k } else { contenders.len() - 1 - k };
                let (made, sample) = time(|| (contenders[k].run)());
                drop(made?);
                series[k].samples.push(sample);
            }
        }
        Ok(Self { measure: measure.into(), work: work as f64, threads, series })
    }

    /// Median rate of a contender, in units of work a second; by CPU time, as if each thread had had a CPU to itself.
    pub fn rate(&self, k: usize) -> Figure {
        let samples = &self.series[k].samples;
        let threads = f64::from(self.threads);
        Figure {
            wall: self.work / median(samples.iter().map(|s| s.wall)),
            cpu: self.work * threads / median(samples.iter().map(|s| s.cpu)),
        }
    }

    /// Lowest and highest rate of a contender by the wall's clock.
    pub fn range(&self, k: usize) -> (f64, f64) {
        let walls = self.series[k].samples.iter().map(|s| self.work / s.wall);
        walls.fold((f64::INFINITY, 0.0), |(low, high), r| (low.min(r), high.max(r)))
    }

    /// How many times faster the first contender is: the median of the ratios of each repetition.
    pub fn ratio(&self, k: usize) -> Figure {
        let pairs = || self.series[k].samples.iter().zip(&self.series[0].samples);
        Figure {
            wall: median(pairs().map(|(this, ours)| this.wall / ours.wall)),
            cpu: median(pairs().map(|(this, ours)| this.cpu / ours.cpu)),
        }
    }

    /// The most that other processes took meanwhile, in CPUs.
    pub fn others(&self, k: usize) -> Option<f64> {
        self.series[k].samples.iter().filter_map(|s| s.others).reduce(f64::max)
    }

    /// The contender that is hardest to beat among those that `of` accepts, by CPU time.
    pub fn hardest(&self, of: impl Fn(&str) -> bool) -> Option<usize> {
        (0..self.series.len())
            .filter(|&k| of(&self.series[k].name))
            .min_by(|&a, &b| self.ratio(a).cpu.total_cmp(&self.ratio(b).cpu))
    }
}

/// Cuts `0..count` into pieces of `piece` and hands them to threads as these get free; adds up what they return. One
/// thread is the calling one.
pub fn spread(
    threads: u32,
    count: usize,
    piece: usize,
    work: impl Fn(&mut dyn FnMut() -> Option<Range<usize>>) -> f64 + Sync,
) -> f64 {
    let next = AtomicUsize::new(0);
    let worker = || {
        work(&mut || {
            let start = next.fetch_add(piece, Ordering::Relaxed);
            (start < count).then(|| start..(start + piece).min(count))
        })
    };
    std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(worker)).collect();
        let own = worker();
        let join = |other: std::thread::ScopedJoinHandle<'_, f64>| {
            other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        own + others.into_iter().map(join).sum::<f64>()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(name: &str, walls: &[f64]) -> Series {
        let samples = walls
            .iter()
            .map(|&wall| Sample { wall, cpu: 0.5 * wall, others: Some(wall) })
            .collect();
        Series { name: name.into(), samples }
    }

    #[test]
    fn ratios_are_of_pairs() {
        let group = Group {
            measure: "test".into(),
            work: 8.0,
            threads: 1,
            series: vec![
                series("ours", &[1.0, 2.0, 4.0]),
                series("a", &[2.0, 8.0, 8.0]),
                series("b", &[0.5, 1.0, 2.0]),
            ],
        };
        // The pairs are 2, 4, 2: not the ratio of the medians, which is 4.
        assert_eq!(group.ratio(1), Figure { wall: 2.0, cpu: 2.0 });
        assert_eq!(group.rate(0), Figure { wall: 4.0, cpu: 8.0 });
        assert_eq!(group.range(0), (2.0, 8.0));
        assert_eq!(group.hardest(|name| name != "ours"), Some(2));
        assert_eq!(group.hardest(|_| false), None);
        assert_eq!(group.others(0), Some(4.0));
    }

    #[test]
    fn everybody_runs_once_more_than_asked_and_errors_come_through() {
        let runs = [AtomicUsize::new(0), AtomicUsize::new(0)];
        let contenders: Vec<Contender<'_, String>> = (0..2)
            .map(|k| {
                let runs = &runs;
                Contender::new("x", move || runs[k].fetch_add(1, Ordering::Relaxed))
            })
            .collect();
        let group = Group::run("test", 1, 1, 3, &contenders).unwrap();
        assert_eq!(group.series[0].samples.len(), 3);
        assert!(runs.iter().all(|n| n.load(Ordering::Relaxed) == 4));
        let bad = [Contender::fallible("bad", || Err::<(), _>("no".to_owned()))];
        assert_eq!(Group::run("test", 1, 1, 3, &bad).unwrap_err(), "no");
    }

    #[test]
    fn pieces_cover_everything_once() {
        for threads in [1, 3] {
            let sum = spread(threads, 1000, 7, |next| {
                let mut sum = 0.0;
                while let Some(range) = next() {
                    sum += range.map(|i| i as f64).sum::<f64>();
                }
                sum
            });
            assert_eq!(sum, 999.0 * 1000.0 / 2.0);
        }
    }
}
