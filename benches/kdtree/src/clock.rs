//! What a piece of work took, on a machine that may be shared.

use std::time::Instant;

use rustix::time::{ClockId, clock_gettime};

/// What one run took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Seconds on the wall.
    pub wall: f64,
    /// Seconds of CPU time of this process, all threads.
    pub cpu: f64,
    /// CPUs that other processes kept busy meanwhile; `None` where the system does not tell.
    pub others: Option<f64>,
}

/// Runs something and takes its time.
pub fn time<T>(work: impl FnOnce() -> T) -> (T, Sample) {
    let busy = busy();
    let cpu = own();
    let start = Instant::now();
    let result = work();
    let wall = start.elapsed().as_secs_f64().max(1e-9);
    // CPU clocks tick more coarsely than the wall's on some machines.
    let cpu = (own() - cpu).max(1e-9);
    let others = busy.zip(self::busy()).map(|(a, b)| ((b - a - cpu) / wall).max(0.0));
    (result, Sample { wall, cpu, others })
}

/// CPU seconds of this process so far.
fn own() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// CPU seconds that anything on the machine has used so far, time stolen by other machines included.
fn busy() -> Option<f64> {
    ticks(&std::fs::read_to_string("/proc/stat").ok()?).map(|ticks| ticks / 100.0)
}

/// User, nice, system, irq, softirq and steal of the first line of `/proc/stat`, in ticks of 1/100 s.
fn ticks(text: &str) -> Option<f64> {
    let mut words = text.lines().next()?.strip_prefix("cpu ")?.split_whitespace();
    let mut sum = 0.0;
    for column in 0..8 {
        let ticks: f64 = words.next()?.parse().ok()?;
        // Idle, and waiting for a disk.
        if column != 3 && column != 4 {
            sum += ticks;
        }
    }
    Some(sum)
}

/// The middle one, or the mean of the two in the middle.
pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians() {
        assert_eq!(median([3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median([4.0, 1.0, 2.0, 3.0]), 2.5);
        assert!(median([]).is_nan());
    }

    #[test]
    fn ticks_leave_idleness_out() {
        assert_eq!(ticks("cpu  1 2 3 1000 2000 4 5 6 7 8\ncpu0 1"), Some(21.0));
        assert_eq!(ticks("cpu  1 2"), None);
        assert_eq!(ticks(""), None);
    }

    #[test]
    fn both_clocks_run() {
        let ((), slept) = time(|| std::thread::sleep(std::time::Duration::from_millis(20)));
        assert!(slept.wall >= 0.02, "{slept:?}");
        // Other tests' threads count as well.
        let start = own();
        let ((), spun) = time(|| {
            while own() < start + 0.02 {
                std::hint::spin_loop();
            }
        });
        assert!(spun.cpu >= 0.0199 && spun.wall > 0.0, "{spun:?}");
    }
}
