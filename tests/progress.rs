//! Progress on a pipe: whole lines of plain text, never a control code, and nothing at all unless it is asked for.

mod common;

use common::{bin, furnished, ok, stderr};

#[test]
fn progress_on_a_pipe_is_plain_lines() {
    let dir = tempfile::tempdir().unwrap();
    let scene = furnished(dir.path());
    let store = dir.path().join("b.enf");
    let said = |stage: &str, more: &[&str]| {
        let mut command = bin(stage);
        match stage {
            "enf-partition" => command.arg(&scene).arg("-o").arg(&store),
            _ => command.arg(&store),
        };
        let text = stderr(&ok(command.args(more)));
        assert!(text.chars().all(|c| c == '\n' || !c.is_control()), "{text:?}");
        text
    };
    for (stage, more, last) in [
        ("enf-partition", &[][..], "tiles: 100%  4 of 4 tiles"),
        ("enf-grid", &[], "grid: 100%  "),
        ("enf-trace", &["--photons-per-light", "20k"], "trace: 100%  60.0 k of 60.0 k photons"),
        ("enf-kdtree", &[], "photon maps: 100%  "),
        (
            "enf-render",
            &["--view", "door", "--width", "32", "--height", "24", "--samples", "2", "-o", "-"],
            "render: 100%  1.54 k of 1.54 k rays",
        ),
    ] {
        let out = dir.path().join("door.png");
        let mut flags: Vec<&str> = more.to_vec();
        if stage == "enf-render" {
            *flags.last_mut().unwrap() = out.to_str().unwrap();
        }
        flags.extend(["--force", "--progress", "always"]);
        let text = said(stage, &flags);
        let line = text.lines().find(|line| line.contains(last));
        let line = line.unwrap_or_else(|| panic!("{stage} does not say {last:?}: {text}"));
        assert!(line.starts_with(&format!("{stage}: ")), "{line}");
        assert!(!line.contains(" left"), "nothing is left: {line}");
        // By itself on a terminal only.
        flags.truncate(flags.len() - 2);
        let label = last.split(':').next().unwrap_or(last);
        let text = said(stage, &flags);
        assert!(!text.contains(&format!("{stage}: {label}: ")), "{text}");
    }
}
