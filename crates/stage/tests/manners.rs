//! A stage as the shell meets it: pipes, signals, exit codes, seen from outside the process.
//!
//! This test is its own subject. Called with `child` it is a small stage; called by `cargo test`
//! it runs that stage and looks at what comes out.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::panic::catch_unwind;
use std::path::Path;
use std::process::{Child, Command, ExitCode, Output, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use clap::Parser;
use enf_stage::{
    CommonArgs, Failure, IdSink, Progress, Result, Selection, Stats, Timeline, interrupt,
    interrupted, run_main, say, stdin_ids,
};

#[derive(Parser)]
#[command(name = "child", version)]
struct ChildArgs {
    /// What the child does.
    what: String,
    #[arg(long)]
    all_rooms: bool,
    #[command(flatten)]
    common: CommonArgs,
}

fn child() -> Result<()> {
    let args = ChildArgs::try_parse_from(std::env::args_os().skip(1))?;
    let common = &args.common;
    let started = Instant::now();
    let stats = Stats::begin(common)?;
    let timeline = Timeline::new(common.trace.clone())?;
    let lane = timeline.lane("main");
    let whole = lane.span("all", 0u32);
    match args.what.as_str() {
        "ids" => {
            let ids = stdin_ids(args.all_rooms).quiet(common.quiet).into_selection()?;
            let sink = IdSink::stdout();
            let ids = match ids {
                Selection::All => vec![111, 222, 333],
                Selection::Ids(ids) => ids,
            };
            let progress = Progress::new(common, "counting", Some(ids.len() as u64), "rooms");
            for (done, &id) in ids.iter().enumerate() {
                sink.print(id)?;
                progress.set(done as u64 + 1);
                if sink.closed() {
                    say(common, "nobody reads any more");
                    break;
                }
            }
        }
        "echo" => {
            let sink = IdSink::stdout();
            for id in stdin_ids(false) {
                sink.print(id?)?;
            }
        }
        "wait" => {
            println!("ready");
            let signal = loop {
                match interrupted() {
                    Some(signal) => break signal,
                    None => thread::sleep(Duration::from_millis(5)),
                }
            };
            thread::sleep(Duration::from_millis(if common.verbose > 0 { 60_000 } else { 300 }));
            return Err(Failure::interrupted(signal));
        }
        "budget" => {
            return Err(Failure::budget("room 812 needs 412 MiB of 380").with_hint("--memory 420M"));
        }
        "panic" => {
            let empty: Vec<u32> = Vec::new();
            println!("{}", empty[common.threads]);
        }
        "thread-panic" => thread::scope(|scope| {
            scope.spawn(|| panic!("a tracer has a bug"));
        }),
        other => return Err(Failure::usage(format!("no such thing: {other}"))),
    }
    interrupt::check()?;
    drop(whole);
    drop(lane);
    timeline.finish()?;
    stats.finish(common, "child", started).map(drop)
}

fn stage(args: &[&str]) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.arg("child").args(args).stdin(Stdio::null());
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn run(args: &[&str], stdin: impl Into<Stdio>) -> (Option<i32>, String, String) {
    told(stage(args).stdin(stdin).output().unwrap())
}

fn told(output: Output) -> (Option<i32>, String, String) {
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

/// Runs a shell command in which `$STAGE` is the child.
fn shell(script: &str) -> (Option<i32>, String, String) {
    let exe = std::env::current_exe().unwrap();
    let stage = format!("{} child", exe.display());
    told(Command::new("sh").args(["-c", script]).env("STAGE", stage).output().unwrap())
}

fn signal(child: &Child, signal: rustix::process::Signal) {
    let pid = rustix::process::Pid::from_child(child);
    rustix::process::kill_process(pid, signal).unwrap();
}

const INT: rustix::process::Signal = rustix::process::Signal::INT;
const TERM: rustix::process::Signal = rustix::process::Signal::TERM;
const ALL: &str = "111\n222\n333\n";

fn stdin_decides() {
    for script in ["$STAGE ids </dev/null", "$STAGE ids <&-", "echo 5 | $STAGE ids --all-rooms"] {
        assert_eq!(shell(script), (Some(0), ALL.into(), String::new()), "{script}");
    }
    let script = "seq 0 49999 | $STAGE ids | $STAGE echo | $STAGE ids | tail -n 2";
    assert_eq!(shell(script), (Some(0), "49998\n49999\n".into(), String::new()));
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("ids");
    std::fs::write(&file, "3\n1\n3\n").unwrap();
    assert_eq!(run(&["ids"], File::open(&file).unwrap()).1, "3\n1\n");
    assert_eq!(shell("printf '' | $STAGE ids"), (Some(0), String::new(), String::new()));
}

fn bad_ids_are_input_errors() {
    let (code, out, err) = shell("printf '1\\ntwo\\n' | $STAGE ids");
    assert_eq!((code, out.as_str()), (Some(4), ""));
    assert!(err.starts_with("enf-child: line 2 of stdin is no room id: \"two\"\n  "), "{err}");
}

fn a_stage_streams() {
    let mut child = stage(&["echo"]).stdin(Stdio::piped()).spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let mut stdout = BufReader::new(child.stdout.take().unwrap());
    for id in ["7\n", "8\n"] {
        stdin.write_all(id.as_bytes()).unwrap();
        let mut line = String::new();
        stdout.read_line(&mut line).unwrap();
        assert_eq!(line, id);
    }
    drop(stdin);
    assert_eq!(child.wait().unwrap().code(), Some(0));
}

fn a_closed_stdout_is_success() {
    let mut child = stage(&["ids"]).stdin(Stdio::piped()).spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    for id in 0..20_000 {
        writeln!(stdin, "{id}").unwrap();
    }
    drop(stdin);
    let mut line = String::new();
    BufReader::with_capacity(8, child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let (code, _, err) = told(child.wait_with_output().unwrap());
    assert_eq!((line.as_str(), code), ("0\n", Some(0)));
    assert_eq!(err, "enf-child: nobody reads any more\n");
    let (code, out, _) = shell("seq 0 9999 | $STAGE ids --quiet | head -n 1");
    assert_eq!((code, out.as_str()), (Some(0), "0\n"));
    let (code, _, err) = shell("$STAGE ids > /dev/full");
    assert_eq!(code, Some(5), "{err}");
}

fn silence_is_explained() {
    let waits = [&["ids"][..], &["ids", "--quiet"]].map(|args| {
        let mut child = stage(args).stdin(Stdio::piped()).spawn().unwrap();
        let mut stdin = child.stdin.take().unwrap();
        thread::spawn(move || {
            stdin.write_all(b"4\n").unwrap();
            thread::sleep(Duration::from_millis(5600));
            drop(stdin);
            told(child.wait_with_output().unwrap())
        })
    });
    let [plain, quiet] = waits.map(|wait| wait.join().unwrap());
    assert!(plain.2.starts_with("enf-child: waiting for room ids on stdin"), "{}", plain.2);
    assert_eq!((plain.0, plain.1.as_str(), plain.2.lines().count()), (Some(0), "4\n", 1));
    assert_eq!(quiet, (Some(0), "4\n".into(), String::new()));
}

fn ready() -> Child {
    running(&["wait"])
}

fn running(args: &[&str]) -> Child {
    let mut child = stage(args).spawn().unwrap();
    let mut line = String::new();
    let mut first = [0; 6];
    child.stdout.as_mut().unwrap().read_exact(&mut first).unwrap();
    line.push_str(std::str::from_utf8(&first).unwrap());
    assert_eq!(line, "ready\n");
    child
}

fn signals_end_it_politely() {
    for (which, code) in [(INT, 130), (TERM, 143)] {
        let child = ready();
        signal(&child, which);
        let (status, _, err) = told(child.wait_with_output().unwrap());
        assert_eq!(status, Some(code));
        assert_eq!(err, "enf-child: interrupted\n  the same command goes on from here\n");
    }
    // What `timeout -s INT` sends: twice, one right after the other.
    let child = ready();
    signal(&child, INT);
    thread::sleep(Duration::from_millis(20));
    signal(&child, INT);
    let (status, _, err) = told(child.wait_with_output().unwrap());
    assert_eq!((status, err.lines().count()), (Some(130), 2));
}

fn a_second_ctrl_c_insists() {
    let child = running(&["wait", "-v"]);
    signal(&child, INT);
    thread::sleep(Duration::from_millis(700));
    let asked = Instant::now();
    signal(&child, INT);
    let (status, _, err) = told(child.wait_with_output().unwrap());
    assert!(asked.elapsed() < Duration::from_secs(5));
    assert_eq!((status, err.as_str()), (Some(130), ""));
}

/// The child takes a minute over its last steps: nobody is asked to wait for that.
fn one_signal_is_enough() {
    for (which, code) in [(INT, 130), (TERM, 143)] {
        let child = running(&["wait", "-v"]);
        let asked = Instant::now();
        signal(&child, which);
        let (status, _, err) = told(child.wait_with_output().unwrap());
        assert!(asked.elapsed() < Duration::from_secs(30));
        assert_eq!(status, Some(code));
        assert_eq!(err, "enf-child: interrupted\n  the same command goes on from here\n");
    }
}

fn a_signal_ends_the_wait_for_ids() {
    let mut child = stage(&["ids"]).stdin(Stdio::piped()).spawn().unwrap();
    let stdin = child.stdin.take();
    thread::sleep(Duration::from_millis(500));
    signal(&child, TERM);
    assert_eq!(child.wait().unwrap().code(), Some(143));
    drop(stdin);
}

fn failures_have_codes_and_no_panic_messages() {
    let none = Stdio::null;
    assert_eq!(
        run(&["budget"], none()),
        (
            Some(3),
            String::new(),
            "enf-child: room 812 needs 412 MiB of 380\n  --memory 420M\n".into()
        )
    );
    for what in ["panic", "thread-panic"] {
        let (code, _, err) = run(&[what], none());
        assert_eq!(code, Some(5));
        assert!(err.starts_with("enf-child: internal error at "), "{err}");
        assert!(err.contains("manners.rs:") && err.contains("report"), "{err}");
        assert!(!err.contains("panicked") && !err.contains("RUST_BACKTRACE"), "{err}");
    }
    let loud = stage(&["panic"]).env("ENFILADE_BACKTRACE", "1").output().unwrap();
    assert!(told(loud).2.contains("panicked"));
    for args in [&["nonsense"][..], &["ids", "--nope"], &[], &["ids", "--memory", "x"]] {
        let (code, out, err) = run(args, none());
        assert_eq!((code, out.as_str()), (Some(2), ""), "{args:?}");
        assert!(err.starts_with("enf-child: ") && !err.contains("error: "), "{err}");
    }
    for flag in ["--help", "--version"] {
        let (code, out, err) = run(&[flag], none());
        assert_eq!((code, err.as_str()), (Some(0), ""));
        assert!(out.contains("child"), "{out}");
    }
    assert!(run(&["--help"], none()).1.contains("--memory <SIZE>"));
    for script in [
        "$STAGE --help | true",
        "$STAGE --help > /dev/full",
        "$STAGE ids --progress always 2>&- >/dev/null",
        "$STAGE ids --progress always 2>/dev/full >/dev/null",
    ] {
        assert_eq!(shell(script).0, Some(0), "{script}");
    }
    assert_eq!(shell("$STAGE budget 2>&-").0, Some(3));
    assert_eq!(shell("$STAGE panic 2>/dev/full").0, Some(5));
}

fn the_record_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    let (stats, trace) = (path("s.json"), path("t.json"));
    let args = ["ids", "--progress", "always", "--seed", "5"];
    let files = ["--stats", &text(&stats), "--trace", &text(&trace)];
    let (code, out, err) = run(&[&args[..], &files[..]].concat(), Stdio::null());
    assert_eq!((code, out.as_str()), (Some(0), ALL));
    assert!(err.starts_with("enf-child: counting: 100%  3 of 3 rooms"), "{err}");
    let read = |path: &Path| -> serde_json::Value {
        serde_json::from_reader(File::open(path).unwrap()).unwrap()
    };
    assert_eq!(read(&stats)["seed"], 5);
    assert!(read(&stats)["memory"]["peak_resident_bytes"].as_u64().unwrap() > 100_000);
    assert!(read(&trace).as_array().unwrap().iter().any(|e| e["ph"] == "X"));
    for flag in ["--stats", "--trace"] {
        let (code, out, err) = run(&["ids", flag, "/no/such/folder/x.json"], Stdio::null());
        assert_eq!((code, out.as_str()), (Some(5), ""), "before work begins: {err}");
    }
}

fn main() -> ExitCode {
    if std::env::args().nth(1).as_deref() == Some("child") {
        return run_main("enf-child", child);
    }
    let tests: [(&str, fn()); 11] = [
        ("stdin_decides", stdin_decides),
        ("bad_ids_are_input_errors", bad_ids_are_input_errors),
        ("a_stage_streams", a_stage_streams),
        ("a_closed_stdout_is_success", a_closed_stdout_is_success),
        ("silence_is_explained", silence_is_explained),
        ("signals_end_it_politely", signals_end_it_politely),
        ("a_second_ctrl_c_insists", a_second_ctrl_c_insists),
        ("one_signal_is_enough", one_signal_is_enough),
        ("a_signal_ends_the_wait_for_ids", a_signal_ends_the_wait_for_ids),
        ("failures_have_codes_and_no_panic_messages", failures_have_codes_and_no_panic_messages),
        ("the_record_is_written", the_record_is_written),
    ];
    let wanted = std::env::args().skip(1).find(|a| !a.starts_with('-')).unwrap_or_default();
    let chosen = tests.into_iter().filter(|(name, _)| name.contains(&wanted));
    let running: Vec<_> =
        chosen.map(|(n, t)| (n, thread::spawn(move || catch_unwind(t)))).collect();
    let mut failed = 0;
    for (name, test) in running {
        let passed = matches!(test.join(), Ok(Ok(())));
        println!("test {name} ... {}", if passed { "ok" } else { "FAILED" });
        failed += usize::from(!passed);
    }
    if failed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
