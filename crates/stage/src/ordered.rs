//! Work on many items by several threads, consumed in order: the bytes that a stage writes do not depend on the
//! number of threads.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};

use crossbeam::channel::bounded;

use crate::failure::{Failure, Result};

/// Whether to go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Continue {
    /// With the next item.
    Yes,
    /// Not: what is in flight is dropped.
    No,
}

/// Calls `work(worker, item)` for items `0..items` on `threads` threads and `consume(item, result)` on this one, in
/// the order of the items. Few results are held at a time: a worker that is ahead waits.
///
/// # Errors
/// The first failure of `work` or `consume`; the rest is not begun.
pub fn ordered<T: Send>(
    threads: usize,
    items: usize,
    work: impl Fn(usize, usize) -> Result<T> + Sync,
    mut consume: impl FnMut(usize, T) -> Result<Continue>,
) -> Result<()> {
    let next = AtomicUsize::new(0);
    let (send, receive) = bounded(1);
    std::thread::scope(|scope| {
        for worker in 0..threads.max(1).min(items.max(1)) {
            let (send, next, work) = (send.clone(), &next, &work);
            scope.spawn(move || {
                loop {
                    let item = next.fetch_add(1, Ordering::Relaxed);
                    if item >= items {
                        break;
                    }
                    let done = catch_unwind(AssertUnwindSafe(|| work(worker, item)))
                        .unwrap_or_else(|_| Err(Failure::internal("a worker thread failed")));
                    let failed = done.is_err();
                    if send.send((item, done)).is_err() || failed {
                        break;
                    }
                }
            });
        }
        drop(send);
        let mut early = BTreeMap::new();
        let mut expected = 0;
        // Dropping the receiver on the way out stops the workers.
        for (item, done) in receive {
            early.insert(item, done?);
            while let Some(result) = early.remove(&expected) {
                if consume(expected, result)? == Continue::No {
                    return Ok(());
                }
                expected += 1;
            }
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_come_in_order_whatever_the_threads() {
        for threads in [1, 2, 5] {
            let mut seen = Vec::new();
            let spin = |i: usize| (0..(i * 7919) % 1000).sum::<usize>();
            ordered(
                threads,
                100,
                |_, i| Ok((i, spin(i))),
                |i, r| {
                    assert_eq!(r, (i, spin(i)));
                    seen.push(i);
                    Ok(Continue::Yes)
                },
            )
            .unwrap();
            assert_eq!(seen, (0..100).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_failure_ends_it() {
        let result = ordered(
            3,
            1000,
            |_, i| if i == 17 { Err(Failure::input("seventeen")) } else { Ok(i) },
            |_, _| Ok(Continue::Yes),
        );
        assert_eq!(result.unwrap_err().message, "seventeen");
    }

    #[test]
    fn stopping_early_is_no_failure() {
        let mut count = 0;
        ordered(
            2,
            1000,
            |_, i| Ok(i),
            |i, _| {
                count += 1;
                Ok(if i == 9 { Continue::No } else { Continue::Yes })
            },
        )
        .unwrap();
        assert_eq!(count, 10);
    }
}
