//! Room ids on pipes: one a line in, one a line out.
//!
//! Who is at the other end is decided by what stdin *is*. A pipe or a file has something to say,
//! and then a stage does as it is told; a terminal, `/dev/null`, a socket or nothing at all means
//! *all rooms*, so that the same command works by hand, from cron and under a batch system.

use std::collections::HashSet;
use std::fmt;
use std::io::{self, Write};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FileType, fstat};
use rustix::io::Errno;

use crate::failure::{Failure, Result};
use crate::interrupt;
use crate::progress;

/// How long stdin may be silent before stderr says what is being waited for.
const PATIENCE: Duration = Duration::from_secs(5);

/// How often a wait looks whether a signal came.
const SLICE: Duration = Duration::from_millis(200);

/// Bytes of one line that are looked at; an id needs ten.
const LONGEST_LINE: usize = 64;

/// Which rooms a stage is to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Selection {
    /// Every room of the store.
    All,
    /// These, each once, in the order in which they came. May be empty: no rooms, exit 0.
    Ids(Vec<u32>),
}

/// The room ids that stdin gives, read only as far as asked.
pub fn stdin_ids(all_rooms_flag: bool) -> IdSource {
    let stdin = io::stdin();
    let input = if !all_rooms_flag && speaks(stdin.as_fd()) { Input::Stdin } else { Input::All };
    IdSource::new(input)
}

/// Whether something stands at this descriptor that gives ids: a pipe or a regular file.
fn speaks(fd: BorrowedFd<'_>) -> bool {
    fstat(fd).is_ok_and(|stat| {
        matches!(FileType::from_raw_mode(stat.st_mode), FileType::Fifo | FileType::RegularFile)
    })
}

enum Input {
    All,
    Stdin,
    Descriptor(OwnedFd),
}

/// Room ids from a pipe or a file, each once, in the order in which they come.
///
/// Nothing is read before it is asked for: [`Self::first`] is what a stage calls before it opens
/// the store, since its left neighbour may not have created that yet.
pub struct IdSource {
    input: Input,
    quiet: bool,
    rooms: Option<u32>,
    buffer: [u8; 4096],
    filled: std::ops::Range<usize>,
    line: Vec<u8>,
    line_number: u64,
    ended: bool,
    peeked: Option<u32>,
    seen: HashSet<u32>,
}

impl IdSource {
    fn new(input: Input) -> Self {
        Self {
            ended: matches!(input, Input::All),
            input,
            quiet: false,
            rooms: None,
            buffer: [0; 4096],
            filled: 0..0,
            line: Vec::new(),
            line_number: 0,
            peeked: None,
            seen: HashSet::new(),
        }
    }

    /// A source that reads this descriptor, whatever it is, instead of stdin.
    pub fn from_descriptor(descriptor: OwnedFd) -> Self {
        Self::new(Input::Descriptor(descriptor))
    }

    /// A source of all rooms, that reads nothing.
    pub fn all() -> Self {
        Self::new(Input::All)
    }

    /// Keeps quiet while waiting, if `quiet`.
    #[must_use]
    pub fn quiet(mut self, quiet: bool) -> Self {
        self.quiet = quiet;
        self
    }

    /// From now on an id of `rooms` or more is a bad line. Call it once the store is open; ids
    /// already given out are the caller's to check.
    pub fn set_rooms(&mut self, rooms: u32) {
        self.rooms = Some(rooms);
    }

    /// Whether this means all rooms; then there is nothing to read.
    pub fn is_all(&self) -> bool {
        matches!(self.input, Input::All)
    }

    /// Waits for the first id or the end of file. The id is not taken: iteration begins with it.
    /// `None` at the end of file, and for all rooms.
    ///
    /// # Errors
    /// A bad line (exit 4), a failed read (5), or a signal while waiting.
    pub fn first(&mut self) -> Result<Option<u32>> {
        if self.peeked.is_none() {
            self.peeked = self.read_id()?;
        }
        Ok(self.peeked)
    }

    /// The next id that has not come before, or `None` at the end of file; waits for it.
    ///
    /// # Errors
    /// A bad line (exit 4), a failed read (5), or a signal while waiting.
    pub fn next_id(&mut self) -> Result<Option<u32>> {
        match self.peeked.take() {
            Some(id) => self.in_range(id).map(Some),
            None => self.read_id(),
        }
    }

    /// Everything up to the end of file. What `enf-trace` and `enf-render` start with.
    ///
    /// # Errors
    /// A bad line (exit 4), a failed read (5), or a signal while waiting.
    pub fn into_selection(mut self) -> Result<Selection> {
        if self.is_all() {
            return Ok(Selection::All);
        }
        let mut ids = Vec::new();
        while let Some(id) = self.next_id()? {
            ids.push(id);
        }
        Ok(Selection::Ids(ids))
    }

    fn read_id(&mut self) -> Result<Option<u32>> {
        while self.read_line()? {
            let text = self.line.trim_ascii();
            if text.is_empty() {
                continue;
            }
            let id = std::str::from_utf8(text)
                .ok()
                .filter(|t| t.bytes().all(|b| b.is_ascii_digit()))
                .and_then(|t| t.parse::<u32>().ok())
                .ok_or_else(|| self.bad_line())?;
            let id = self.in_range(id)?;
            if self.seen.insert(id) {
                return Ok(Some(id));
            }
        }
        Ok(None)
    }

    fn bad_line(&self) -> Failure {
        let shown = String::from_utf8_lossy(self.line.trim_ascii()).into_owned();
        let dots = if self.line.len() >= LONGEST_LINE { "..." } else { "" };
        let n = self.line_number;
        Failure::input(format!("line {n} of stdin is no room id: {shown:?}{dots}"))
            .with_hint("room ids come one a line; --all-rooms does every room and reads nothing")
    }

    fn in_range(&self, id: u32) -> Result<u32> {
        match self.rooms {
            Some(rooms) if id >= rooms => {
                let n = self.line_number;
                Err(Failure::input(format!(
                    "line {n} of stdin: there is no room {id}, the store has {rooms}"
                ))
                .with_hint("ids begin at 0"))
            }
            _ => Ok(id),
        }
    }

    /// Puts the next line, without its end, in `self.line`; `false` at the end of file.
    fn read_line(&mut self) -> Result<bool> {
        self.line.clear();
        self.line_number += 1;
        loop {
            if self.filled.is_empty() {
                if self.ended || !self.fill()? {
                    return Ok(!self.line.is_empty());
                }
                continue;
            }
            let waiting = &self.buffer[self.filled.clone()];
            let end = waiting.iter().position(|&b| b == b'\n');
            let text = &waiting[..end.unwrap_or(waiting.len())];
            let room = LONGEST_LINE - self.line.len();
            self.line.extend_from_slice(&text[..text.len().min(room)]);
            if text.len() > room {
                return Err(self.bad_line());
            }
            self.filled.start += text.len() + usize::from(end.is_some());
            if end.is_some() {
                return Ok(true);
            }
        }
    }

    /// Reads what there is, waiting for at least a byte; `false` at the end of file.
    fn fill(&mut self) -> Result<bool> {
        self.wait()?;
        let stdin = io::stdin();
        let fd = match &self.input {
            Input::All => return Ok(false),
            Input::Stdin => stdin.as_fd(),
            Input::Descriptor(fd) => fd.as_fd(),
        };
        loop {
            match rustix::io::read(fd, &mut self.buffer[..]) {
                Ok(0) => {
                    self.ended = true;
                    return Ok(false);
                }
                Ok(n) => {
                    self.filled = 0..n;
                    return Ok(true);
                }
                Err(Errno::INTR) => interrupt::check()?,
                // A pipe that a neighbour made non-blocking.
                Err(Errno::AGAIN) => self.wait()?,
                Err(e) => {
                    return Err(Failure::io(format!("cannot read room ids from stdin: {e}")));
                }
            }
        }
    }

    /// Waits until a read would not block; says so when that takes long.
    fn wait(&self) -> Result<()> {
        let stdin = io::stdin();
        let fd = match &self.input {
            Input::All => return Ok(()),
            Input::Stdin => stdin.as_fd(),
            Input::Descriptor(fd) => fd.as_fd(),
        };
        let slice = Timespec { tv_sec: 0, tv_nsec: i64::from(SLICE.subsec_nanos()) };
        let started = Instant::now();
        let mut said = self.quiet;
        loop {
            interrupt::check()?;
            match poll(&mut [PollFd::new(&fd, PollFlags::IN)], Some(&slice)) {
                Ok(0) | Err(Errno::INTR) => {}
                // Ready, hung up, or something that the read will name.
                Ok(_) | Err(_) => return Ok(()),
            }
            if !said && started.elapsed() >= PATIENCE {
                said = true;
                let so_far = match self.seen.len() {
                    0 => String::new(),
                    n => format!(" ({n} so far)"),
                };
                progress::write_named(&format!(
                    "waiting for room ids on stdin, one a line, until end of file{so_far}; \
                     --all-rooms does every room"
                ));
            }
        }
    }
}

impl Iterator for IdSource {
    type Item = Result<u32>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_id().transpose()
    }
}

/// Prints the ids of sealed rooms on stdout, one a line, each as soon as it is sealed.
///
/// When the reader is gone (`| head -1`), that is no error: [`Self::closed`] says so, and the
/// stage seals what is in flight and exits 0. Threads may share a sink.
pub struct IdSink {
    output: Mutex<Output>,
    closed: AtomicBool,
}

enum Output {
    Stdout,
    Descriptor(OwnedFd),
    Nowhere,
}

impl IdSink {
    fn new(output: Output) -> Self {
        Self { output: Mutex::new(output), closed: AtomicBool::new(false) }
    }

    /// A sink on this process's stdout.
    pub fn stdout() -> Self {
        Self::new(Output::Stdout)
    }

    /// A sink on this descriptor.
    pub fn to_descriptor(descriptor: OwnedFd) -> Self {
        Self::new(Output::Descriptor(descriptor))
    }

    /// A sink that prints nothing and is never closed: for stages that run inside another.
    pub fn nowhere() -> Self {
        Self::new(Output::Nowhere)
    }

    /// Prints one id (or a picture's path) and its line end in a single write. Does nothing once the sink is closed.
    ///
    /// # Errors
    /// I/O other than a closed pipe, such as a full disk behind a redirection.
    pub fn print(&self, id: impl fmt::Display) -> Result<()> {
        if self.closed.load(Ordering::Relaxed) {
            return Ok(());
        }
        let line = format!("{id}\n");
        let output = self.output.lock();
        let written = match &*output {
            Output::Stdout => {
                let mut stdout = io::stdout().lock();
                stdout.write_all(line.as_bytes()).and_then(|()| stdout.flush())
            }
            Output::Descriptor(fd) => write_all(fd.as_fd(), line.as_bytes()),
            Output::Nowhere => Ok(()),
        };
        match written {
            Err(e) if e.kind() == io::ErrorKind::BrokenPipe => {
                self.closed.store(true, Ordering::Relaxed);
                Ok(())
            }
            other => other.map_err(|e| Failure::io(format!("cannot print room ids: {e}"))),
        }
    }

    /// Whether nobody reads any more. Asks the pipe, so that a stage need not finish one more
    /// room to find out; one system call, fit for once a room.
    pub fn closed(&self) -> bool {
        if self.closed.load(Ordering::Relaxed) {
            return true;
        }
        let gone = match &*self.output.lock() {
            Output::Stdout => reader_is_gone(io::stdout().as_fd()),
            Output::Descriptor(fd) => reader_is_gone(fd.as_fd()),
            Output::Nowhere => false,
        };
        if gone {
            self.closed.store(true, Ordering::Relaxed);
        }
        gone
    }
}

fn write_all(fd: BorrowedFd<'_>, mut bytes: &[u8]) -> io::Result<()> {
    while !bytes.is_empty() {
        match rustix::io::write(fd, bytes) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(n) => bytes = &bytes[n..],
            Err(Errno::INTR) => {}
            Err(e) => return Err(e.into()),
        }
    }
    Ok(())
}

/// Whether `fd` is a pipe whose reading end is closed.
fn reader_is_gone(fd: BorrowedFd<'_>) -> bool {
    let is_pipe = fstat(fd).is_ok_and(|s| FileType::from_raw_mode(s.st_mode) == FileType::Fifo);
    let mut polled = [PollFd::new(&fd, PollFlags::empty())];
    is_pipe
        && poll(&mut polled, Some(&Timespec { tv_sec: 0, tv_nsec: 0 })).is_ok()
        && polled[0].revents().contains(PollFlags::ERR)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::failure::ExitStatus;
    use std::fs::File;
    use std::io::Read;
    use std::net::{TcpListener, TcpStream};
    use std::thread;

    fn source(text: &[u8]) -> IdSource {
        let (reader, mut writer) = io::pipe().unwrap();
        let text = text.to_vec();
        // A thread, since a long text does not fit in a pipe; an early close is the reader's right.
        thread::spawn(move || {
            let _ = writer.write_all(&text);
        });
        IdSource::from_descriptor(reader.into())
    }

    fn ids(text: &[u8]) -> Vec<u32> {
        match source(text).into_selection().unwrap() {
            Selection::Ids(ids) => ids,
            Selection::All => panic!("a pipe means ids"),
        }
    }

    #[test]
    fn what_stdin_is_decides() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("ids");
        std::fs::write(&file, "1\n").unwrap();
        assert!(speaks(File::open(&file).unwrap().as_fd()));
        assert!(speaks(io::pipe().unwrap().0.as_fd()));
        assert!(!speaks(File::open("/dev/null").unwrap().as_fd()));
        assert!(!speaks(File::open(folder.path()).unwrap().as_fd()));
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let socket = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        assert!(!speaks(socket.as_fd()));
        assert!(stdin_ids(true).is_all());
        assert_eq!(IdSource::all().into_selection(), Ok(Selection::All));
        assert_eq!(IdSource::all().first(), Ok(None));
    }

    #[test]
    fn ids_come_once_in_order() {
        assert!(ids(b"").is_empty());
        assert!(ids(b"\n\n").is_empty());
        assert_eq!(ids(b"7\n3\n7\n0\n3\n"), [7, 3, 0]);
        assert_eq!(ids(b" 12 \r\n\n4294967295"), [12, u32::MAX]);
        let many: String = (0..20_000).map(|i| format!("{}\n", 20_000 - i)).collect();
        assert_eq!(ids(many.as_bytes()), (1..=20_000).rev().collect::<Vec<_>>());
    }

    #[test]
    fn a_bad_line_is_named() {
        for (text, line) in [
            (&b"1\ntwo\n"[..], "line 2 "),
            (b"1\n\n3\n-4\n", "line 4 "),
            (b"+5\n", "line 1 "),
            (b"4294967296\n", "line 1 "),
            (b"1 2\n", "line 1 "),
            (b"9\n\xff\xfe\n", "line 2 "),
            (b"\0\0\0\0", "line 1 "),
            (&[b'1'; 100_000], "line 1 "),
        ] {
            let failure = source(text).into_selection().unwrap_err();
            assert_eq!(failure.code, ExitStatus::Input);
            assert!(failure.message.contains(line), "{failure}");
            assert!(failure.message.len() < 300);
        }
    }

    #[test]
    fn the_store_bounds_the_ids() {
        let mut ids = source(b"2\n9\n");
        assert_eq!(ids.first(), Ok(Some(2)));
        assert_eq!(ids.first(), Ok(Some(2)));
        ids.set_rooms(3);
        assert_eq!(ids.next_id(), Ok(Some(2)));
        let failure = ids.next_id().unwrap_err();
        assert!(failure.message.contains("line 2 of stdin: there is no room 9"), "{failure}");
        let mut ids = source(b"5\n");
        assert_eq!(ids.first(), Ok(Some(5)));
        ids.set_rooms(5);
        assert!(ids.next_id().is_err());
    }

    #[test]
    fn the_first_id_is_there_before_the_last() {
        let (reader, mut writer) = io::pipe().unwrap();
        let mut ids = IdSource::from_descriptor(reader.into());
        writer.write_all(b"41\n4").unwrap();
        assert_eq!(ids.first(), Ok(Some(41)));
        writer.write_all(b"2\n").unwrap();
        drop(writer);
        assert_eq!(ids.collect::<Result<Vec<_>>>(), Ok(vec![41, 42]));
    }

    #[test]
    fn printed_ids_are_lines() {
        let (mut reader, writer) = io::pipe().unwrap();
        let sink = IdSink::to_descriptor(writer.into());
        sink.print(3).unwrap();
        sink.print(u32::MAX).unwrap();
        assert!(!sink.closed());
        drop(sink);
        let mut text = String::new();
        reader.read_to_string(&mut text).unwrap();
        assert_eq!(text, "3\n4294967295\n");
    }

    #[test]
    fn a_reader_that_leaves_is_no_error() {
        for ask_first in [true, false] {
            let (reader, writer) = io::pipe().unwrap();
            let sink = IdSink::to_descriptor(writer.into());
            sink.print(1).unwrap();
            assert!(!sink.closed());
            drop(reader);
            if ask_first {
                assert!(sink.closed());
            }
            assert_eq!(sink.print(2), Ok(()));
            assert!(sink.closed());
            assert_eq!(sink.print(3), Ok(()));
        }
    }

    #[test]
    fn a_full_disk_is_an_error() {
        let sink =
            IdSink::to_descriptor(File::options().write(true).open("/dev/full").unwrap().into());
        assert_eq!(sink.print(1).unwrap_err().code, ExitStatus::Io);
        assert!(!sink.closed());
        let nowhere = IdSink::nowhere();
        assert_eq!((nowhere.print(1), nowhere.closed()), (Ok(()), false));
    }
}
