//! How a stage ends: an exit code a script can branch on, a sentence, and what to do about it.
//!
//! [`run_main`] is the whole `main` of every binary. Nothing that goes wrong shows a panic message.

use std::fmt;
use std::io::{self, Write};
use std::panic::{self, AssertUnwindSafe};
use std::path::Path;
use std::process::ExitCode;

use parking_lot::Mutex;

use crate::progress;

/// The result of anything a stage does.
pub type Result<T> = std::result::Result<T, Failure>;

/// The environment variable that brings Rust's own panic report back, for people who debug.
const BACKTRACE_VARIABLE: &str = "ENFILADE_BACKTRACE";

/// Why the process ends, as its exit code says it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExitStatus {
    /// 0: only help or the version was asked for; the message is the answer.
    Help,
    /// 1: the work is done and its answer is no (`validate`: a case failed).
    Negative,
    /// 2: the command line is wrong, or another run's output is in the way.
    Usage,
    /// 3: the memory budget cannot work.
    Budget,
    /// 4: missing, bad or corrupt input.
    Input,
    /// 5: I/O failed, or the program has a bug.
    Io,
    /// 128 + signal: interrupted by this signal (130 for SIGINT, 143 for SIGTERM).
    Interrupted(i32),
}

impl ExitStatus {
    /// The exit code.
    pub fn code(self) -> u8 {
        match self {
            Self::Help => 0,
            Self::Negative => 1,
            Self::Usage => 2,
            Self::Budget => 3,
            Self::Input => 4,
            Self::Io => 5,
            Self::Interrupted(signal) => u8::try_from(signal.clamp(1, 64)).unwrap_or(0) + 128,
        }
    }

    /// The status with this exit code; codes that are no [`ExitStatus`] become [`ExitStatus::Io`].
    pub fn from_code(code: u8) -> Self {
        match code {
            0 => Self::Help,
            1 => Self::Negative,
            2 => Self::Usage,
            3 => Self::Budget,
            4 => Self::Input,
            129.. => Self::Interrupted(i32::from(code) - 128),
            _ => Self::Io,
        }
    }
}

/// A failure as the user meets it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// What the exit code will be.
    pub code: ExitStatus,
    /// What happened: names the file, the room and the number; no full stop at its end.
    pub message: String,
    /// What would help, if that is known.
    pub hint: Option<String>,
}

/// What is said to who asks for a view that does not exist.
pub fn no_view(name: &str, known: &[&str]) -> Failure {
    Failure::usage(format!("there is no view {name}")).with_hint(format!(
        "views of this scene: {}; also auto, all, room:ID, panorama:ID and plan:ID",
        if known.is_empty() { "none".into() } else { known.join(", ") }
    ))
}

impl Failure {
    /// A failure of this kind, without a hint.
    pub fn new(code: ExitStatus, message: impl Into<String>) -> Self {
        Self { code, message: message.into(), hint: None }
    }

    /// Exit 2: the command line is wrong, or another run's output is in the way.
    pub fn usage(message: impl Into<String>) -> Self {
        Self::new(ExitStatus::Usage, message)
    }

    /// Exit 3: the memory budget cannot work. Say which room, what it needs and what would do.
    pub fn budget(message: impl Into<String>) -> Self {
        Self::new(ExitStatus::Budget, message)
    }

    /// Exit 4: missing, bad or corrupt input. Say which file, and where in it.
    pub fn input(message: impl Into<String>) -> Self {
        Self::new(ExitStatus::Input, message)
    }

    /// Exit 5: I/O failed. [`IoContext::at`] is shorter where there is a path.
    pub fn io(message: impl Into<String>) -> Self {
        Self::new(ExitStatus::Io, message)
    }

    /// Exit 5: something that cannot be, is; say what was expected.
    pub fn internal(message: impl fmt::Display) -> Self {
        Self::io(format!("internal error: {message}")).with_hint(REPORT)
    }

    /// Exit 128 + `signal`: interrupted, and everything committed is kept.
    pub fn interrupted(signal: i32) -> Self {
        Self::new(ExitStatus::Interrupted(signal), "interrupted")
            .with_hint("the same command goes on from here")
    }

    /// The same failure with what would help.
    pub fn with_hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }
}

const REPORT: &str = "this is a bug: please report it with the command line that led here";

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)?;
        if let Some(hint) = &self.hint {
            write!(f, "\n  {}", hint.replace('\n', "\n  "))?;
        }
        Ok(())
    }
}

impl std::error::Error for Failure {}

impl From<clap::Error> for Failure {
    /// Help and version are answers (exit 0, stdout); the rest is [`ExitStatus::Usage`].
    fn from(error: clap::Error) -> Self {
        use clap::error::ErrorKind;
        let text = error.render().to_string();
        let text = text.trim_end();
        match error.kind() {
            ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => Self::new(ExitStatus::Help, text),
            _ => Self::usage(text.strip_prefix("error: ").unwrap_or(text)),
        }
    }
}

/// Gives an [`io::Error`] the path and the action that it lacks.
pub trait IoContext<T> {
    /// "cannot `action` `path`: reason", exit 5; `action` is a bare verb such as `"write"`.
    ///
    /// # Errors
    /// The I/O error, as a [`Failure`].
    fn at(self, action: &str, path: &Path) -> Result<T>;

    /// The same for input that the user named: exit 4.
    ///
    /// # Errors
    /// The I/O error, as a [`Failure`].
    fn at_input(self, action: &str, path: &Path) -> Result<T>;
}

impl<T> IoContext<T> for io::Result<T> {
    fn at(self, action: &str, path: &Path) -> Result<T> {
        self.map_err(|e| {
            let failure = Failure::io(cannot(action, path, &e));
            match e.kind() {
                io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
                    failure.with_hint("free some space and run the same command again")
                }
                _ => failure,
            }
        })
    }

    fn at_input(self, action: &str, path: &Path) -> Result<T> {
        self.map_err(|e| Failure::input(cannot(action, path, &e)))
    }
}

fn cannot(action: &str, path: &Path, error: &io::Error) -> String {
    format!("cannot {action} {}: {error}", path.display())
}

/// Where the first panic of this process happened.
static PANIC: Mutex<Option<String>> = Mutex::new(None);

/// Everything around a stage's body: measures the process's own memory, catches signals, runs
/// `body`, says what went wrong as `name: message` with an indented hint, and gives the exit code.
///
/// A panic in `body` (or in a thread that it joins) becomes an internal error with exit code 5 and
/// no panic message; setting `ENFILADE_BACKTRACE=1` shows Rust's own report as well.
pub fn run_main(name: &str, body: impl FnOnce() -> Result<()>) -> ExitCode {
    enf_store::tune_allocator();
    crate::memory::fixed_overhead_bytes();
    progress::set_program(name);
    silence_panics();
    let outcome = crate::interrupt::install()
        .and_then(|()| panic::catch_unwind(AssertUnwindSafe(body)).unwrap_or_else(|_| Err(bug())));
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            report(name, &failure);
            ExitCode::from(failure.code.code())
        }
    }
}

fn silence_panics() {
    let default = panic::take_hook();
    panic::set_hook(Box::new(move |info| {
        let place = info.location().map(|l| format!("{}:{}", l.file(), l.line()));
        PANIC.lock().get_or_insert(place.unwrap_or_else(|| "an unknown place".into()));
        if std::env::var_os(BACKTRACE_VARIABLE).is_some_and(|v| v != "0" && !v.is_empty()) {
            default(info);
        }
    }));
}

/// The failure that a panic is reported as.
fn bug() -> Failure {
    let place = PANIC.lock().clone().unwrap_or_else(|| "an unknown place".into());
    Failure::io(format!("internal error at {place}"))
        .with_hint(format!("{REPORT}\n{BACKTRACE_VARIABLE}=1 shows more"))
}

fn report(name: &str, failure: &Failure) {
    // A reader that is gone takes nothing away from the exit code.
    if failure.code == ExitStatus::Help {
        let mut out = io::stdout().lock();
        let _ = writeln!(out, "{failure}").and_then(|()| out.flush());
    } else {
        progress::write_line(&format!("{name}: {failure}"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_the_contract() {
        for (status, code) in [
            (ExitStatus::Help, 0),
            (ExitStatus::Negative, 1),
            (ExitStatus::Usage, 2),
            (ExitStatus::Budget, 3),
            (ExitStatus::Input, 4),
            (ExitStatus::Io, 5),
            (ExitStatus::Interrupted(2), 130),
            (ExitStatus::Interrupted(15), 143),
        ] {
            assert_eq!(status.code(), code);
            assert_eq!(ExitStatus::from_code(code), status);
        }
        assert_eq!(ExitStatus::Interrupted(i32::MAX).code(), 192);
        assert_eq!(ExitStatus::Interrupted(-1).code(), 129);
        assert_eq!(ExitStatus::from_code(77), ExitStatus::Io);
    }

    #[test]
    fn a_failure_is_a_sentence_and_a_hint() {
        let failure =
            Failure::budget("room 812 needs 412 MiB of 380").with_hint("try\n--memory 420M");
        assert_eq!(failure.to_string(), "room 812 needs 412 MiB of 380\n  try\n  --memory 420M");
        let missing: io::Result<()> = Err(io::Error::from(io::ErrorKind::NotFound));
        let failure = missing.at_input("read", Path::new("b.obj")).unwrap_err();
        assert_eq!(failure.code, ExitStatus::Input);
        assert_eq!(failure.to_string(), "cannot read b.obj: entity not found");
    }

    #[test]
    fn clap_speaks_through_us() {
        let command = || clap::Command::new("tool").version("1");
        let failure: Failure =
            command().try_get_matches_from(["tool", "--nope"]).unwrap_err().into();
        assert_eq!(failure.code, ExitStatus::Usage);
        assert!(failure.message.starts_with("unexpected argument '--nope'"), "{failure}");
        for flag in ["--help", "--version"] {
            let failure: Failure =
                command().try_get_matches_from(["tool", flag]).unwrap_err().into();
            assert_eq!(failure.code.code(), 0);
        }
    }
}
