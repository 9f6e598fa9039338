//! Ctrl-C and SIGTERM: the first asks, the second Ctrl-C insists.
//!
//! A stage looks at [`interrupted`] between blocks, commits what it has and returns
//! [`crate::Failure::interrupted`]. A user who presses Ctrl-C again does not want to wait: the
//! process exits at once, and the journal makes that harmless too. It does the same when the stage is not done
//! within a second and a half (one huge room, a slow disk): nobody waits for longer than two.

use std::io;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::{Duration, Instant};

use signal_hook::consts::{SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::iterator::Signals;

use crate::failure::{Failure, Result};
use crate::progress;

/// `timeout` signals its child and then the child's whole group: two signals that are one wish.
const SAME_WISH: Duration = Duration::from_millis(400);

/// So long a stage may take to look up and commit.
const PATIENCE: Duration = Duration::from_millis(1500);

static SIGNAL: OnceLock<Arc<AtomicUsize>> = OnceLock::new();

/// Begins to catch SIGINT and SIGTERM, and SIGXFSZ, so that a file that becomes too large is an error like another; only the
/// first call does anything.
///
/// # Errors
/// I/O, if the system refuses the handlers or the thread that watches for a second Ctrl-C.
pub fn install() -> Result<()> {
    let flag = Arc::new(AtomicUsize::new(0));
    if SIGNAL.set(Arc::clone(&flag)).is_err() {
        return Ok(());
    }
    watch(&flag).map_err(|e| Failure::io(format!("cannot catch signals: {e}")))
}

fn watch(flag: &Arc<AtomicUsize>) -> io::Result<()> {
    for (signal, value) in [(SIGINT, SIGINT as usize), (SIGTERM, SIGTERM as usize)] {
        signal_hook::flag::register_usize(signal, Arc::clone(flag), value)?;
    }
    // A file that reaches the limit of `ulimit -f` is an error of the write, not the end of the process.
    signal_hook::flag::register(SIGXFSZ, Arc::new(AtomicBool::new(false)))?;
    let mut signals = Signals::new([SIGINT, SIGTERM])?;
    thread::Builder::new().name("signals".into()).stack_size(64 << 10).spawn(move || {
        let mut first: Option<Instant> = None;
        for signal in &mut signals {
            let since = *first.get_or_insert_with(|| {
                // Without it the stage just takes the time that it takes.
                let patience = thread::Builder::new().name("patience".into()).stack_size(64 << 10);
                let _ = patience.spawn(move || {
                    thread::sleep(PATIENCE);
                    abandon(signal)
                });
                Instant::now()
            });
            if ABANDON.load(Ordering::Relaxed) > 0 {
                abandon(signal);
            }
            if signal == SIGINT && since.elapsed() > SAME_WISH {
                signal_hook::low_level::exit(128 + SIGINT);
            }
        }
    })?;
    Ok(())
}

/// How many parts of the program have nothing to lose now.
static ABANDON: AtomicUsize = AtomicUsize::new(0);

fn abandon(signal: i32) -> ! {
    let failure = Failure::interrupted(signal);
    progress::write_named(&failure.to_string());
    signal_hook::low_level::exit(i32::from(failure.code.code()))
}

/// While it lives, a signal ends the process at once: nothing is half done that a commit could save, and the work
/// is too dense to look up from.
#[must_use]
#[derive(Debug)]
pub struct NothingToLose(());

/// From here on, until the guard is dropped, there is nothing to lose.
///
/// # Errors
/// [`Failure::interrupted`] when a signal has come already.
pub fn nothing_to_lose() -> Result<NothingToLose> {
    ABANDON.fetch_add(1, Ordering::Relaxed);
    let guard = NothingToLose(());
    check()?;
    Ok(guard)
}

impl Drop for NothingToLose {
    fn drop(&mut self) {
        ABANDON.fetch_sub(1, Ordering::Relaxed);
    }
}

/// The signal that asked this process to stop, if one did. Costs one relaxed load.
pub fn interrupted() -> Option<i32> {
    let signal = SIGNAL.get()?.load(Ordering::Relaxed);
    i32::try_from(signal).ok().filter(|&s| s != 0)
}

/// [`interrupted`] as a result, for `?` in loops that have nothing to tidy up.
///
/// # Errors
/// [`Failure::interrupted`].
pub fn check() -> Result<()> {
    interrupted().map_or(Ok(()), |signal| Err(Failure::interrupted(signal)))
}
