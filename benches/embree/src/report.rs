//! The table that is read, and the file that is kept.

use std::fmt::Write as _;

use crate::measure::{Figure, Group};

/// Everything about one scene that goes into the file, a line each.
#[derive(Debug, Default)]
pub struct Table {
    lines: Vec<String>,
}

/// Names of the file's columns.
const COLUMNS: &str = "scene,triangles,measure,threads,contender,unit,value,lowest,highest,by_cpu,\
                       ours_over_this,ours_over_this_by_cpu,others_cpus,repetitions";

impl Table {
    /// Adds a figure that is no rate.
    pub fn figure(
        &mut self,
        scene: (&str, usize),
        measure: &str,
        contender: &str,
        unit: &str,
        value: f64,
    ) {
        let line = format!(
            "{},{},{},,{},{unit},{value:.6},,,,,,,",
            quoted(scene.0),
            scene.1,
            quoted(measure),
            quoted(contender)
        );
        self.lines.push(line);
    }

    /// Adds a group's rates.
    pub fn group(&mut self, scene: (&str, usize), group: &Group) {
        for (k, series) in group.series.iter().enumerate() {
            let (rate, (low, high)) = (group.rate(k), group.range(k));
            let mut line = format!(
                "{},{},{},{},{},M/s,{:.5},{:.5},{:.5},{:.5}",
                quoted(scene.0),
                scene.1,
                quoted(&group.measure),
                group.threads,
                quoted(&series.name),
                rate.wall / 1e6,
                low / 1e6,
                high / 1e6,
                rate.cpu / 1e6
            );
            if k > 0 {
                let ratio = group.ratio(k);
                let _ = write!(line, ",{:.4},{:.4}", ratio.wall, ratio.cpu);
            } else {
                line += ",,";
            }
            let others = group.others(k).map_or(String::new(), |x| format!("{x:.3}"));
            let _ = write!(line, ",{others},{}", series.samples.len());
            self.lines.push(line);
        }
    }

    /// The file: comma-separated values with a head.
    pub fn csv(&self) -> String {
        let mut text = format!("{COLUMNS}\n");
        for line in &self.lines {
            text += line;
            text.push('\n');
        }
        text
    }
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

/// A group as it is read.
pub fn readable(group: &Group) -> String {
    let threads =
        if group.threads == 1 { "1 thread" } else { &format!("{} threads", group.threads) };
    let head = format!("{}, {threads}", group.measure);
    let mut text = format!(
        "  {head:<58} {:>8} {:>8}   {:>9} {:>7}   {:>6}\n",
        "M/s", "by CPU", "ours/this", "by CPU", "others"
    );
    for (k, series) in group.series.iter().enumerate() {
        let rate = group.rate(k);
        let _ = write!(
            text,
            "    {:<56} {:>8.3} {:>8.3}",
            series.name,
            rate.wall / 1e6,
            rate.cpu / 1e6
        );
        if k > 0 {
            let Figure { wall, cpu } = group.ratio(k);
            let _ = write!(text, "   {wall:>8.2}x {cpu:>6.2}x");
        } else {
            let _ = write!(text, "   {:>9} {:>7}", "", "");
        }
        match group.others(k) {
            Some(others) => drop(writeln!(text, "   {others:>6.2}")),
            None => text.push('\n'),
        }
    }
    text
}

/// A line of the summary: ours over Embree's, by the wall's clock and by CPU time.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// The scene.
    pub scene: String,
    /// Threads.
    pub threads: u32,
    /// What was done, against which contender, and the ratio.
    pub ratios: Vec<(&'static str, String, Figure)>,
}

/// The summary.
pub fn summary(verdicts: &[Verdict]) -> String {
    let mut text = String::from(
        "ours / Embree, median of neighbouring runs: by the wall's clock (by CPU time)\n",
    );
    for verdict in verdicts {
        let threads = if verdict.threads == 1 { "" } else { "s" };
        let _ = writeln!(text, "  {}, {} thread{threads}", verdict.scene, verdict.threads);
        for (what, against, ratio) in &verdict.ratios {
            let _ = writeln!(
                text,
                "    {what:<22} {:>5.2}x ({:.2}x)   against {against}",
                ratio.wall, ratio.cpu
            );
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Sample;
    use crate::measure::Series;

    fn group() -> Group {
        let samples = |wall: f64| vec![Sample { wall, cpu: wall, others: None }; 3];
        Group {
            measure: "nearest, single".into(),
            work: 3e6,
            threads: 2,
            series: vec![
                Series { name: "ours, bvh".into(), samples: samples(1.0) },
                Series { name: "Embree".into(), samples: samples(0.5) },
            ],
        }
    }

    #[test]
    fn every_line_has_every_column() {
        let mut table = Table::default();
        table.group(("room, \"12k\"", 12_000), &group());
        table.figure(("b", 1), "bytes", "ours", "bytes a triangle", 12.5);
        let text = table.csv();
        let columns = |line: &str| {
            let mut inside = false;
            line.chars()
                .filter(|&c| {
                    inside ^= c == '"';
                    c == ',' && !inside
                })
                .count()
                + 1
        };
        assert_eq!(columns(COLUMNS), 14);
        assert_eq!(text.lines().count(), 4);
        for line in text.lines() {
            assert_eq!(columns(line), 14, "{line}");
        }
        assert!(
            text.contains("\"room, \"\"12k\"\"\",12000,\"nearest, single\",2,Embree,M/s,6.00000")
        );
        assert!(text.contains(",0.5000,0.5000,,3"));
    }

    #[test]
    fn tables_say_who_is_faster() {
        let text = readable(&group());
        assert!(text.contains("2 threads") && text.contains("0.50x"), "{text}");
        let verdict = Verdict {
            scene: "room".into(),
            threads: 1,
            ratios: vec![("shadow rays", "Embree".into(), group().ratio(1))],
        };
        assert!(summary(&[verdict]).contains("0.50x (0.50x)   against Embree"));
    }
}
