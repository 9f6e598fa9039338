//! The same photons and the same questions, through our photon maps and through kiddo, nabo and nanoflann.
//!
//! | module | question |
//! |---|---|
//! | [`scene`] | which photons? |
//! | [`clock`] | how long did it take? |
//! | `nanoflann` | how is C++ called? |
#![deny(unsafe_code)]

#[path = "../../embree/src/clock.rs"]
mod clock;
#[cfg(nanoflann)]
mod nanoflann;
mod scene;

use std::collections::BTreeMap;
use std::io::Write as _;
use std::num::NonZero;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use enf_illumination::photon_map::{GatherScratch, PhotonMap, blob_bytes, build_map};
use enf_layout::photon::PhotonRecord;
use glam::Vec3;
use kiddo::SquaredEuclidean;
use nabo::simple_point::SimplePoint;

use crate::clock::{Sample, median, time};
#[cfg(nanoflann)]
use crate::nanoflann::Nanoflann;

/// Our photon maps beside kiddo, nabo and nanoflann, one thread
#[derive(Parser, Debug)]
#[command(version)]
struct Args {
    /// Photons, several counts separated by commas
    #[arg(long, value_delimiter = ',', default_value = "100000,1600000")]
    photons: Vec<usize>,
    /// Nearest photons that are asked for
    #[arg(long, value_delimiter = ',', default_value = "50,100")]
    nearest: Vec<usize>,
    /// Questions
    #[arg(long, default_value_t = 20_000)]
    queries: usize,
    /// Repetitions; medians are printed
    #[arg(long, default_value_t = 5)]
    repetitions: usize,
    /// Photons of a finished trace instead of the generated room's (the first ones of --room)
    #[arg(long, value_name = "NAME.enf")]
    store: Option<PathBuf>,
    /// Room of the store
    #[arg(long, default_value_t = 0)]
    room: u32,
    /// Lines for a spreadsheet: what, photons, nearest, who, median of CPU seconds, of wall seconds
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error(transparent)]
    Store(#[from] enf_store::StoreError),
    #[error(
        "room {room} has {found} photons, {wanted} are asked for: trace more, or see --photons"
    )]
    Few { room: u32, found: usize, wanted: usize },
    #[error("--photons, --queries, --nearest and --repetitions must not be 0")]
    Zero,
    #[error("kiddo does not build: {0}")]
    Kiddo(String),
    #[error(
        "{who} and {other} do not find the same: {a:?} and {b:?} (photons, sum of squared radii)"
    )]
    Unequal { who: &'static str, other: &'static str, a: (usize, f64), b: (usize, f64) },
    #[error("{path}: {error}")]
    Output { path: PathBuf, error: std::io::Error },
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("bench-kdtree: {failure}");
            ExitCode::FAILURE
        }
    }
}

/// Prints; a reader that has gone away is no error.
fn say(text: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}

/// What was measured: of what, by whom.
type Series = BTreeMap<(String, &'static str), Vec<Sample>>;

fn run(args: &Args) -> Result<(), Failure> {
    let most = args.photons.iter().copied().max().unwrap_or(0);
    let zero = args.photons.contains(&0) || args.nearest.contains(&0);
    if zero || most == 0 || args.queries == 0 || args.repetitions == 0 {
        return Err(Failure::Zero);
    }
    let (photons, queries) = match &args.store {
        None => (scene::impacts(most, 1), scene::impacts(args.queries, 2)),
        Some(store) => {
            let all = scene::of_store(store, args.room)?;
            let wanted = most + args.queries;
            if all.len() < wanted {
                return Err(Failure::Few { room: args.room, found: all.len(), wanted });
            }
            (all[..most].to_vec(), all[most..wanted].to_vec())
        }
    };
    let mut random = scene::Random(3);
    let mut queries: Vec<[f32; 3]> = queries.iter().map(PhotonRecord::position).collect();
    for i in (1..queries.len()).rev() {
        queries.swap(i, (random.next() * (i + 1) as f32) as usize % (i + 1));
    }
    let sorted = scene::sorted(&queries);
    let mut csv = String::from("what,photons,nearest,who,cpu_s,wall_s\n");
    for &n in &args.photons {
        bench(args, &photons[..n], [&queries, &sorted], &mut csv)?;
    }
    if let Some(path) = &args.csv {
        let written = std::fs::write(path, csv);
        written.map_err(|error| Failure::Output { path: path.clone(), error })?;
    }
    Ok(())
}

/// What one side found: photons, and the sum of the squared distances of the farthest ones.
type Found = (usize, f64);

/// Everything about so many photons.
fn bench(
    args: &Args,
    photons: &[PhotonRecord],
    queries: [&[[f32; 3]]; 2],
    csv: &mut String,
) -> Result<(), Failure> {
    let n = photons.len();
    let points: Vec<[f32; 3]> = photons.iter().map(PhotonRecord::position).collect();
    let simple = |p: &[f32; 3]| SimplePoint::<2>::new3d(p[0], p[1], p[2]);
    let cloud: Vec<SimplePoint<3>> = points.iter().map(simple).collect();
    let asked: Vec<Vec<SimplePoint<3>>> =
        queries.iter().map(|list| list.iter().map(simple).collect()).collect();
    let mut blob = vec![0u8; blob_bytes(n)];
    let mut series = Series::new();
    let mut radii = BTreeMap::new();
    for _ in 0..args.repetitions {
        let mut take = |what: &str, who, sample| {
            series.entry((what.to_string(), who)).or_default().push(sample);
        };
        blob.fill(0);
        let ((), sample) = time(|| build_map(photons, &mut blob, f32::INFINITY, [0, 1], 1));
        take("build", "ours", sample);
        let ours = PhotonMap::from_blob(&blob).map_err(|e| Failure::Kiddo(e.to_string()))?;
        let (kiddo, sample) = time(|| kiddo::ImmutableKdTree::<f32, 3>::new_from_slice(&points));
        take("build", "kiddo", sample);
        let kiddo = kiddo.map_err(|e| Failure::Kiddo(format!("{e:?}")))?;
        let (nabo, sample) = time(|| nabo::KDTree::new(&cloud));
        take("build", "nabo", sample);
        #[cfg(nanoflann)]
        let nanoflann = {
            let (tree, sample) = time(|| Nanoflann::new(&points));
            take("build", "nanoflann", sample);
            tree
        };
        for &k in &args.nearest {
            let radius = *radii.entry(k).or_insert_with(|| radius_for(&ours, queries[0], k));
            for (order, list) in ["shuffled", "sorted"].into_iter().zip(queries) {
                let what = format!("{k} nearest, {order}");
                let mut answers: Vec<(&'static str, Found)> = Vec::new();
                let (found, sample) = time(|| ask_ours(&ours, list, k, radius));
                take(&what, "ours", sample);
                answers.push(("ours", found));
                if order == "shuffled" {
                    let (found, sample) = time(|| {
                        let list = scene::sorted(list);
                        ask_ours(&ours, &list, k, radius)
                    });
                    take(&what, "ours, sorting", sample);
                    answers.push(("ours, sorting", found));
                }
                let (found, sample) = time(|| {
                    let (mut found, mut sum) = (0, 0.0);
                    for q in list {
                        let query = kiddo.query(q).nearest_n::<SquaredEuclidean<f32>>(
                            NonZero::new(k).unwrap_or(NonZero::<usize>::MIN),
                        );
                        let near = query.within(radius * radius).unsorted().execute();
                        found += near.len();
                        let far = near.iter().map(|x| x.distance).fold(0.0f32, f32::max);
                        sum += f64::from(far);
                    }
                    (found, sum)
                });
                take(&what, "kiddo", sample);
                answers.push(("kiddo", found));
                let (found, sample) = time(|| {
                    let parameters = nabo::Parameters {
                        epsilon: 0.0.try_into().unwrap_or_default(),
                        max_radius: radius.try_into().unwrap_or_default(),
                        allow_self_match: true,
                        sort_results: false,
                    };
                    let (mut found, mut sum) = (0, 0.0);
                    for q in &asked[usize::from(order == "sorted")] {
                        let heap = nabo::CandidateContainer::BinaryHeap;
                        let near = nabo.knn_advanced(k as u32, q, heap, &parameters, None);
                        found += near.len();
                        let far = near.iter().map(|x| f32::from(x.dist2)).fold(0.0f32, f32::max);
                        sum += f64::from(far);
                    }
                    (found, sum)
                });
                take(&what, "nabo", sample);
                answers.push(("nabo", found));
                #[cfg(nanoflann)]
                if let Some(tree) = &nanoflann {
                    let (found, sample) = time(|| tree.ask(list, k, radius));
                    take(&what, "nanoflann", sample);
                    answers.push(("nanoflann", found));
                }
                agree(&answers, radius)?;
            }
        }
    }
    report(args, n, &radii, &series, csv);
    Ok(())
}

/// Nearest photons of ours: how many, how far the farthest.
fn ask_ours(map: &PhotonMap<'_>, list: &[[f32; 3]], k: usize, radius: f32) -> Found {
    let mut scratch = GatherScratch::new(k as u32);
    let (mut found, mut sum) = (0, 0.0);
    for &q in list {
        let near = map.nearest(Vec3::from(q), k as u32, radius, &mut scratch);
        found += near.len();
        let far = near.iter().map(|x| x.1).fold(0.0f32, f32::max);
        sum += f64::from(far);
    }
    (found, sum)
}

/// A radius within which 97 of 100 questions find all that they look for, m.
fn radius_for(map: &PhotonMap<'_>, queries: &[[f32; 3]], k: usize) -> f32 {
    let mut scratch = GatherScratch::new(k as u32);
    let mut radii: Vec<f32> = queries
        .iter()
        .step_by(10)
        .map(|&q| {
            let near = map.nearest(Vec3::from(q), k as u32, f32::INFINITY, &mut scratch);
            near.iter().map(|x| x.1).fold(0.0f32, f32::max).sqrt()
        })
        .collect();
    radii.sort_by(f32::total_cmp);
    radii[radii.len() * 97 / 100]
}

/// All must find as many photons in discs as large, but for a few of ten thousand: some sides count what is exactly at the
/// radius, some do not.
fn agree(answers: &[(&'static str, Found)], radius: f32) -> Result<(), Failure> {
    let (who, a) = answers[0];
    let few = 3.0 + 1e-4 * a.0 as f64;
    for &(other, b) in &answers[1..] {
        let photons = (a.0 as f64 - b.0 as f64).abs();
        let discs = (a.1 - b.1).abs() - 1e-5 * a.1;
        if photons > few || discs > few * f64::from(radius * radius) {
            return Err(Failure::Unequal { who, other, a, b });
        }
    }
    Ok(())
}

fn report(args: &Args, n: usize, radii: &BTreeMap<usize, f32>, series: &Series, csv: &mut String) {
    let radii: Vec<String> = radii.iter().map(|(k, r)| format!("{k} within {r:.3} m")).collect();
    say(&format!("\n{n} photons ({}); medians of CPU time, one thread", radii.join(", ")));
    say(&format!("{:<26}{:<16}{:>14}{:>14}{:>10}", "", "", "CPU", "wall", "ours/this"));
    let mut whats: Vec<&String> = series.keys().map(|k| &k.0).collect();
    whats.dedup();
    for what in whats {
        let building = what == "build";
        let (work, unit) =
            if building { (n as f64 / 1e6, "M/s") } else { (args.queries as f64 / 1e3, "K/s") };
        let of = |who, pick: fn(&Sample) -> f64| {
            series.get(&(what.clone(), who)).map(|s| median(s.iter().map(pick)))
        };
        let ours = of("ours", |s| s.cpu).unwrap_or(f64::NAN);
        let mut best = f64::INFINITY;
        for who in ["ours", "ours, sorting", "kiddo", "nabo", "nanoflann"] {
            let (Some(cpu), Some(wall)) = (of(who, |s| s.cpu), of(who, |s| s.wall)) else {
                continue;
            };
            if !who.starts_with("ours") {
                best = best.min(cpu);
            }
            say(&format!(
                "{what:<26}{who:<16}{:>10.1} {unit}{:>10.1} {unit}{:>10.2}",
                work / cpu,
                work / wall,
                cpu / ours
            ));
            let k = what.split(' ').next().filter(|_| !building).unwrap_or("");
            csv.push_str(&format!("{what:?},{n},{k},{who:?},{cpu:.6},{wall:.6}\n"));
        }
        say(&format!("{what:<26}{:<44}{:>10.2}", "against the best of the others", best / ours));
    }
}
