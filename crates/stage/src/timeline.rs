//! `--trace FILE`: when each thread did what, for eyes.
//!
//! The file is in Chrome's trace event format (a JSON array of complete events, `"ph":"X"`, in
//! microseconds) and opens in Perfetto: a lane per thread, a bar per span. The array's closing
//! bracket is optional in that format, so that the timeline of a killed run opens as well.
//!
//! A span is two clock readings and 48 bytes. Each lane keeps its own events and writes them in
//! bulk; a lane that has too many drops the rest and says how many. Switched off, it is a branch.

use std::cell::RefCell;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Instant;

use parking_lot::Mutex;

use crate::failure::{IoContext, Result};

/// Events that a lane holds before it writes them.
const BUFFERED: usize = 4096;

/// Events that a lane writes at most; a file of all lanes must still open in a browser.
const EVENTS_PER_LANE: u64 = 200_000;

/// Where the time went. Clones write the same file; [`Self::finish`] ends it.
#[derive(Clone)]
pub struct Timeline(Option<Arc<Inner>>);

struct Inner {
    path: PathBuf,
    start: Instant,
    lanes: AtomicU32,
    file: Mutex<Output>,
}

struct Output {
    writer: BufWriter<File>,
    any: bool,
    dropped: u64,
    error: Option<io::Error>,
}

impl Timeline {
    /// A timeline in this file, which is created now; without a file, one that does nothing.
    ///
    /// # Errors
    /// [`crate::ExitStatus::Io`] if the file cannot be created.
    pub fn new(path: Option<PathBuf>) -> Result<Self> {
        let Some(path) = path else { return Ok(Self(None)) };
        let writer = BufWriter::with_capacity(64 << 10, File::create(&path).at("write", &path)?);
        let mut output = Output { writer, any: false, dropped: 0, error: None };
        output.event(&format!(
            r#"{{"name":"process_name","ph":"M","pid":1,"args":{{"name":"enfilade {}"}}}}"#,
            env!("CARGO_PKG_VERSION")
        ));
        let (start, lanes) = (Instant::now(), AtomicU32::new(0));
        Ok(Self(Some(Arc::new(Inner { path, start, lanes, file: Mutex::new(output) }))))
    }

    /// A timeline that does nothing.
    pub fn disabled() -> Self {
        Self(None)
    }

    /// A lane for the calling thread, under this name. Lanes are shown in the order in which they
    /// were made.
    pub fn lane(&self, name: &str) -> Lane {
        Lane(self.0.as_ref().map(|inner| {
            let lane = inner.lanes.fetch_add(1, Ordering::Relaxed) + 1;
            let mut file = inner.file.lock();
            let name = serde_json::Value::from(name);
            file.event(&format!(
                r#"{{"name":"thread_name","ph":"M","pid":1,"tid":{lane},"args":{{"name":{name}}}}}"#
            ));
            file.event(&format!(
                r#"{{"name":"thread_sort_index","ph":"M","pid":1,"tid":{lane},"args":{{"sort_index":{lane}}}}}"#
            ));
            drop(file);
            RefCell::new(Events { inner: Arc::clone(inner), lane, written: 0, events: Vec::new() })
        }))
    }

    /// Ends the file. Lanes that still live then write nothing more that a reader would see, so
    /// let their threads end first.
    ///
    /// # Errors
    /// [`crate::ExitStatus::Io`] if any part of the file could not be written.
    pub fn finish(self) -> Result<()> {
        let Some(inner) = self.0 else { return Ok(()) };
        inner.file.lock().end().at("write", &inner.path)
    }
}

impl Output {
    /// Writes one event. The first error is kept for [`Timeline::finish`]: a timeline is no reason
    /// to stop a run.
    fn event(&mut self, json: &str) {
        if self.error.is_none() {
            let before = if self.any { ",\n" } else { "[\n" };
            self.any = true;
            self.error = write!(self.writer, "{before}{json}").err();
        }
    }

    fn end(&mut self) -> io::Result<()> {
        if self.dropped > 0 {
            let note =
                format!(r#"{{"name":"{} events were dropped","ph":"M","pid":1}}"#, self.dropped);
            self.event(&note);
        }
        match self.error.take() {
            Some(error) => Err(error),
            None => self.writer.write_all(b"\n]\n").and_then(|()| self.writer.flush()),
        }
    }
}

/// One thread's lane of a [`Timeline`]. Stays on its thread; dropping it writes what it holds.
pub struct Lane(Option<RefCell<Events>>);

struct Events {
    inner: Arc<Inner>,
    lane: u32,
    written: u64,
    events: Vec<Event>,
}

struct Event {
    name: &'static str,
    category: &'static str,
    id: u64,
    start: Instant,
    nanoseconds: u64,
}

impl Lane {
    /// A lane that does nothing.
    pub fn disabled() -> Self {
        Self(None)
    }

    /// Begins a span of work on `id` (a room, a tile, a band); it lasts until it is dropped.
    pub fn span(&self, name: &'static str, id: impl Into<u64>) -> Span<'_> {
        self.begin("work", name, id.into())
    }

    /// Begins a span of reading, writing or waiting for either.
    pub fn io(&self, name: &'static str, id: impl Into<u64>) -> Span<'_> {
        self.begin("io", name, id.into())
    }

    fn begin(&self, category: &'static str, name: &'static str, id: u64) -> Span<'_> {
        Span(self.0.as_ref().map(|events| {
            (events, Event { name, category, id, start: Instant::now(), nanoseconds: 0 })
        }))
    }
}

impl Events {
    fn push(&mut self, event: Event) {
        if self.events.capacity() == 0 {
            self.events.reserve_exact(BUFFERED);
        }
        self.events.push(event);
        if self.events.len() >= BUFFERED {
            self.write();
        }
    }

    fn write(&mut self) {
        let mut file = self.inner.file.lock();
        for event in self.events.drain(..) {
            if self.written >= EVENTS_PER_LANE {
                file.dropped += 1;
                continue;
            }
            self.written += 1;
            let start = event.start.saturating_duration_since(self.inner.start).as_nanos();
            let Event { name, category, id, nanoseconds, .. } = event;
            let (name, category) =
                (serde_json::Value::from(name), serde_json::Value::from(category));
            file.event(&format!(
                r#"{{"name":{name},"cat":{category},"ph":"X","pid":1,"tid":{},"ts":{}.{:03},"dur":{}.{:03},"args":{{"id":{id}}}}}"#,
                self.lane,
                start / 1000,
                start % 1000,
                nanoseconds / 1000,
                nanoseconds % 1000,
            ));
        }
    }
}

impl Drop for Events {
    fn drop(&mut self) {
        self.write();
    }
}

/// Something that is being done; it ends when this is dropped.
#[must_use = "a span ends when it is dropped"]
pub struct Span<'a>(Option<(&'a RefCell<Events>, Event)>);

impl Drop for Span<'_> {
    fn drop(&mut self) {
        if let Some((events, mut event)) = self.0.take() {
            let nanoseconds = event.start.elapsed().as_nanos();
            event.nanoseconds = u64::try_from(nanoseconds).unwrap_or(u64::MAX);
            events.borrow_mut().push(event);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::failure::ExitStatus;
    use serde_json::Value;
    use std::fs;
    use std::time::Duration;

    fn read(path: &std::path::Path) -> Vec<Value> {
        serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
    }

    #[test]
    fn spans_become_complete_events() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.json");
        let timeline = Timeline::new(Some(path.clone())).unwrap();
        std::thread::scope(|scope| {
            for thread in 0..3u32 {
                let timeline = &timeline;
                scope.spawn(move || {
                    let lane = timeline.lane(&format!("tracer \"{thread}\""));
                    let _outer = lane.span("visit", thread);
                    let _inner = lane.io("load", 7u64);
                    std::thread::sleep(Duration::from_millis(2));
                });
            }
        });
        timeline.finish().unwrap();
        let events = read(&path);
        let complete: Vec<_> = events.iter().filter(|e| e["ph"] == "X").collect();
        assert_eq!(complete.len(), 6);
        for tid in 1..=3 {
            let of_lane: Vec<_> = complete.iter().filter(|e| e["tid"] == tid).collect();
            let (inner, outer) = (of_lane[0], of_lane[1]);
            assert_eq!((&inner["name"], &inner["cat"]), (&"load".into(), &"io".into()));
            assert_eq!((&outer["name"], &outer["cat"]), (&"visit".into(), &"work".into()));
            let of = |e: &Value, key: &str| e[key].as_f64().unwrap();
            assert!(of(inner, "dur") >= 2000.0 && of(inner, "ts") >= of(outer, "ts"));
            assert!(of(inner, "ts") + of(inner, "dur") <= of(outer, "ts") + of(outer, "dur"));
        }
        assert!(events.iter().any(|e| e["args"]["name"] == "tracer \"1\""));
    }

    #[test]
    fn a_lane_is_bounded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.json");
        let timeline = Timeline::new(Some(path.clone())).unwrap();
        let lane = timeline.lane("busy");
        for i in 0..EVENTS_PER_LANE + 10 {
            drop(lane.span("x", i));
        }
        drop(lane);
        timeline.finish().unwrap();
        let text = fs::read_to_string(&path).unwrap();
        assert_eq!(text.matches("\"ph\":\"X\"").count() as u64, EVENTS_PER_LANE);
        assert!(text.contains("10 events were dropped") && text.ends_with("]\n"));
    }

    #[test]
    fn without_a_file_nothing_happens() {
        let timeline = Timeline::new(None).unwrap();
        let lane = timeline.lane("x");
        assert!(lane.span("x", 1u32).0.is_none() && Lane::disabled().io("y", 2u32).0.is_none());
        drop(lane);
        timeline.finish().unwrap();
        assert!(Timeline::disabled().finish().is_ok());
    }

    #[test]
    fn bad_files_are_failures() {
        let failure = Timeline::new(Some("/no/such/folder/t.json".into())).err().unwrap();
        assert_eq!(failure.code, ExitStatus::Io);
        let full = Timeline::new(Some("/dev/full".into())).unwrap();
        drop(full.lane("x").span("x", 1u32));
        assert_eq!(full.finish().unwrap_err().code, ExitStatus::Io);
    }
}
