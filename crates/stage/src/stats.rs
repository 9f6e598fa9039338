//! `--stats FILE`: what was done and what it cost, as one JSON object.
//!
//! Keys are written with dots (`memory.budget_bytes`) and become nested objects. A run that cannot
//! write its statistics says so before it begins, not after five hours.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use rustix::time::{ClockId, clock_gettime};
use serde_json::{Map, Value};

use crate::args::CommonArgs;
use crate::failure::{Failure, IoContext, Result};
use crate::memory;

/// Statistics of one stage, built up key by key.
#[derive(Clone, Debug, Default)]
pub struct Stats {
    fields: Map<String, Value>,
    cpu_at_start: f64,
}

impl Stats {
    /// Begins the statistics of a stage: its CPU time counts from here.
    ///
    /// # Errors
    /// [`crate::ExitStatus::Io`] if `--stats` names a file that cannot be written.
    pub fn begin(args: &CommonArgs) -> Result<Self> {
        if let Some(path) = &args.stats {
            probe(path)?;
        }
        Ok(Self { fields: Map::new(), cpu_at_start: cpu_seconds() })
    }

    /// Sets the value of a key; dots in the key make nested objects. A later value replaces an
    /// earlier one. Numbers that are not finite become `null`.
    pub fn set(&mut self, key: &str, value: impl Into<Value>) {
        let mut object = &mut self.fields;
        let mut rest = key;
        while let Some((outer, inner)) = rest.split_once('.') {
            let slot = object.entry(outer).or_insert(Value::Null);
            if !slot.is_object() {
                *slot = Value::Object(Map::new());
            }
            match slot {
                Value::Object(map) => object = map,
                _ => return,
            }
            rest = inner;
        }
        object.insert(rest.to_owned(), value.into());
    }

    /// The value of a key, dots included.
    pub fn get(&self, key: &str) -> Option<&Value> {
        let mut keys = key.split('.');
        let first = self.fields.get(keys.next()?)?;
        keys.try_fold(first, |value, key| value.get(key))
    }

    /// Takes over what a stage of a run reported: bytes and records add up, of reserved memory the most counts, everything
    /// else is kept from the first stage that says it.
    pub fn merge(&mut self, stage: &Value) {
        const SUMS: [&str; 4] =
            ["io.read_bytes", "io.written_bytes", "io.inflated_bytes", "io.spilled_records"];
        const PEAK: &str = "peak_reserved_bytes";
        const HELD: &str = "reserved_at_peak";
        let reserved = |stats: Option<&Value>| stats?.get(PEAK)?.as_u64();
        if let Some(peak) = reserved(stage.get("memory"))
            && reserved(self.get("memory")).is_none_or(|before| before < peak)
        {
            self.set(&format!("memory.{PEAK}"), peak);
            self.set(&format!("memory.{HELD}"), stage["memory"][HELD].clone());
        }
        let mut leaves = Vec::new();
        flatten("", stage, &mut leaves);
        leaves.retain(|(key, _)| !key.starts_with(&format!("memory.{HELD}")));
        for (key, value) in leaves {
            match self.get(&key) {
                Some(before) if SUMS.contains(&key.as_str()) => {
                    let sum = before.as_u64().unwrap_or(0) + value.as_u64().unwrap_or(0);
                    self.set(&key, sum);
                }
                Some(_) => {}
                None => self.set(&key, value.clone()),
            }
        }
    }

    /// Fills in what every stage reports, writes the object to `--stats` if that was given, and
    /// gives it back (the driver makes its list `stages` of these).
    ///
    /// Filled in: `stage`, `version`, `seed`, `threads`, `wall_s` since `started`, `cpu_s` of the
    /// whole process since [`Self::begin`], `memory.budget_bytes`, `memory.peak_resident_bytes`.
    ///
    /// # Errors
    /// [`crate::ExitStatus::Io`] if the file cannot be written.
    pub fn finish(mut self, args: &CommonArgs, stage: &str, started: Instant) -> Result<Value> {
        self.set("stage", stage);
        self.set("version", env!("CARGO_PKG_VERSION"));
        self.set("seed", args.seed);
        self.set("threads", args.threads);
        self.set("wall_s", started.elapsed().as_secs_f64());
        self.set("cpu_s", (cpu_seconds() - self.cpu_at_start).max(0.0));
        self.set("memory.budget_bytes", args.memory);
        self.set("memory.peak_resident_bytes", memory::peak_resident());
        let value = Value::Object(self.fields);
        if let Some(path) = &args.stats {
            write(path, &format!("{value:#}\n"))?;
        }
        Ok(value)
    }
}

/// The leaves of nested objects, by dotted key.
fn flatten<'a>(prefix: &str, value: &'a Value, out: &mut Vec<(String, &'a Value)>) {
    match value {
        Value::Object(map) => {
            for (key, value) in map {
                let key = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
                flatten(&key, value, out);
            }
        }
        leaf => out.push((prefix.to_string(), leaf)),
    }
}

/// CPU time of the process so far, all threads, user and system, in seconds.
fn cpu_seconds() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Whether `path` is something that is written in place: a device, a pipe.
fn in_place(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|m| !m.is_file() && !m.is_dir())
}

/// Where the new content of `path` is written before it is renamed.
fn aside(path: &Path) -> Result<PathBuf> {
    let name = path
        .file_name()
        .filter(|_| !path.is_dir())
        .ok_or_else(|| Failure::io(format!("cannot write {}: not a file", path.display())))?;
    let mut hidden = std::ffi::OsString::from(".");
    hidden.push(name);
    hidden.push(format!(".{}.tmp", std::process::id()));
    Ok(path.with_file_name(hidden))
}

fn probe(path: &Path) -> Result<()> {
    if in_place(path) {
        return File::options().write(true).open(path).map(drop).at("write", path);
    }
    let temporary = aside(path)?;
    File::create(&temporary).at("write", path)?;
    fs::remove_file(&temporary).at("remove", &temporary)
}

/// Replaces the file in one step, so that no reader ever sees half of it.
fn write(path: &Path, text: &str) -> Result<()> {
    if in_place(path) {
        let mut file = File::options().write(true).open(path).at("write", path)?;
        return file.write_all(text.as_bytes()).at("write", path);
    }
    let temporary = aside(path)?;
    let written = File::create(&temporary)
        .and_then(|mut file| {
            file.write_all(text.as_bytes())?;
            file.sync_all()
        })
        .and_then(|()| fs::rename(&temporary, path));
    if written.is_err() {
        let _ = fs::remove_file(&temporary);
    }
    written.at("write", path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::failure::ExitStatus;

    #[test]
    fn dots_are_nested_objects() {
        let mut stats = Stats::default();
        stats.set("rooms", 3u32);
        stats.set("io.read_bytes", u64::MAX);
        stats.set("io.room_load_mean", 1.5);
        stats.set("io.deep.er", "x");
        stats.set("io.nan", f64::NAN);
        stats.set("rooms.replaced", true);
        assert_eq!(
            serde_json::to_string(&stats.fields).unwrap(),
            r#"{"io":{"deep":{"er":"x"},"nan":null,"read_bytes":18446744073709551615,"room_load_mean":1.5},"rooms":{"replaced":true}}"#
        );
        assert_eq!(stats.get("io.deep.er"), Some(&Value::from("x")));
        assert_eq!((stats.get("io.none"), stats.get("none.x")), (None, None));
    }

    #[test]
    fn a_run_adds_up_its_stages() {
        let stage = |rooms: u64, read: u64, peak: u64, what: &str| {
            serde_json::json!({
                "rooms": rooms,
                "io": { "read_bytes": read },
                "memory": { "peak_reserved_bytes": peak, "reserved_at_peak": { what: peak } },
            })
        };
        let mut run = Stats::default();
        for stage in [stage(3, 10, 5, "mesh"), stage(4, 20, 9, "grid"), stage(5, 30, 7, "map")] {
            run.merge(&stage);
        }
        assert_eq!(Value::Object(run.fields), stage(3, 60, 9, "grid"));
    }

    #[test]
    fn the_file_is_whole_and_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("stats.json");
        let args =
            CommonArgs { stats: Some(path.clone()), seed: 9, threads: 2, ..Default::default() };
        let started = Instant::now();
        let mut stats = Stats::begin(&args).unwrap();
        assert!(!path.exists());
        stats.set("photons_emitted", 12u64);
        let mut sum = 0u64;
        while cpu_seconds() < stats.cpu_at_start + 0.01 {
            sum = std::hint::black_box(sum + 1);
        }
        let value = stats.finish(&args, "trace", started).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        // As text: reading a float back may be off by its last bit.
        assert_eq!(text, format!("{value:#}\n"));
        let read: Value = serde_json::from_str(&text).unwrap();
        assert_eq!(
            (&read["stage"], &read["seed"], &read["threads"]),
            (&"trace".into(), &9.into(), &2.into())
        );
        assert_eq!(read["memory"]["budget_bytes"], 380u64 << 20);
        assert!(read["memory"]["peak_resident_bytes"].as_u64().unwrap() > 0);
        assert!(read["cpu_s"].as_f64().unwrap() >= 0.01 && read["wall_s"].as_f64().unwrap() > 0.0);
        assert_eq!(read["version"], env!("CARGO_PKG_VERSION"));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_cannot_be_written_is_known_at_once() {
        let folder = tempfile::tempdir().unwrap();
        for path in ["no/such/folder/s.json", ".", "..", "/", ""] {
            let args = CommonArgs { stats: Some(folder.path().join(path)), ..Default::default() };
            let failure = Stats::begin(&args).unwrap_err();
            assert_eq!(failure.code, ExitStatus::Io, "{path}");
        }
        let args = CommonArgs { stats: Some("/dev/null".into()), ..Default::default() };
        Stats::begin(&args).unwrap().finish(&args, "grid", Instant::now()).unwrap();
    }
}
