//! The same rooms and the same rays, through our structures and through the real Embree.
//!
//! | module | question |
//! |---|---|
//! | [`room`], [`scene`] | what stands in the room? |
//! | [`walk`] | which rays? |
//! | [`ours`], [`embree`] | who is asked? |
//! | [`check`] | do both say the same? |
//! | [`clock`], [`measure`] | how long did it take? |
//! | [`args`], [`report`] | what is typed, and what is read? |
#![deny(unsafe_code)]

mod args;
mod check;
mod clock;
mod embree;
mod measure;
mod ours;
mod random;
mod report;
mod room;
mod scene;
mod walk;

use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use enf_geometry::Malformed;

use crate::args::Args;
use crate::check::{Agreement, beam};
use crate::embree::{Beam, Embree, EmbreeError, Mesh, Quality};
use crate::measure::{Contender, Group, spread};
use crate::ours::{Hit, Kind, Ours, Query, Tile, by_rooms};
use crate::report::{Table, Verdict};
use crate::room::Plan;
use crate::scene::{Scene, SceneError};
use crate::walk::{Flight, Walks, shuffled, sorted};

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error("--rooms {0}: there are rooms32 and roomN with N from 8k to 20M, such as room60k")]
    Room(String),
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error(transparent)]
    Embree(#[from] EmbreeError),
    #[error("our structure of {scene}: {malformed}")]
    Ours { scene: String, malformed: Malformed },
    #[error(
        "{scene}: photons make only {found} {what} of {wanted}: no surface that its lights reach?"
    )]
    Rays { scene: String, what: &'static str, found: usize, wanted: usize },
    #[error("{scene}: {ours} finds other hits than {reference} for {count} rays")]
    Unequal { scene: String, ours: String, reference: String, count: usize },
    #[error("{scene}: the sides disagree on more than {:.1} % of the rays: {agreement}", 100.0 * check::TOLERATED)]
    Apart { scene: String, agreement: Agreement },
    #[error("{path}: {error}")]
    Output { path: PathBuf, error: std::io::Error },
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("bench-embree: {failure}");
            ExitCode::FAILURE
        }
    }
}

/// Prints; a reader that has gone away is no error.
fn say(text: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}

fn run(args: &Args) -> Result<(), Failure> {
    let mut plans = Vec::new();
    if args.scene.is_empty() {
        for name in &args.rooms {
            plans.push(Plan::named(name).ok_or_else(|| Failure::Room(name.clone()))?);
        }
    }
    if let Some(folder) = &args.save {
        for plan in &plans {
            plan.draw().write(folder)?;
        }
        return Ok(());
    }
    // Everything that can fail at once, before anything takes time.
    let embree = Embree::load(args.library.as_deref())?;
    let mut table = Table::default();
    let write = |table: &Table| match &args.csv {
        Some(path) => std::fs::write(path, table.csv())
            .map_err(|error| Failure::Output { path: path.clone(), error }),
        None => Ok(()),
    };
    write(&table)?;
    say(&format!("Embree {} ({})", embree.version(), embree.path().display()));
    let mut verdicts = Vec::new();
    for plan in &plans {
        verdicts.extend(bench(args, &embree, &plan.draw(), &mut table)?);
        write(&table)?;
    }
    for prefix in &args.scene {
        verdicts.extend(bench(args, &embree, &Scene::read(prefix)?, &mut table)?);
        write(&table)?;
    }
    say(&report::summary(&verdicts));
    Ok(())
}

/// One of our structures, with what it was built over.
struct Built<'t, 's> {
    kind: Kind,
    tile: &'t Tile<'s>,
    blob: Vec<u8>,
}

impl<'t, 's> Built<'t, 's> {
    fn new(kind: Kind, tile: &'t Tile<'s>, delta: f32) -> Self {
        Self { kind, tile, blob: kind.build(tile, delta) }
    }

    fn open(&self, scene: &Scene) -> Result<Ours<'_>, Failure> {
        Ours::open(self.kind, &self.blob, self.tile, scene.delta())
            .map_err(|malformed| Failure::Ours { scene: scene.name.clone(), malformed })
    }
}

/// A room with its structure and its queue.
struct RoomQueue<'a> {
    ours: Ours<'a>,
    queries: Vec<Query>,
}

/// Measures one scene.
fn bench(
    args: &Args,
    embree: &Embree,
    scene: &Scene,
    table: &mut Table,
) -> Result<Vec<Verdict>, Failure> {
    let delta = scene.delta();
    let id = (scene.name.as_str(), scene.triangles.len());
    let tile = Tile::whole(scene);
    let built: Vec<Built> =
        args.structures.iter().map(|&kind| Built::new(kind, &tile, delta)).collect();
    let ours: Vec<Ours> = built.iter().map(|b| b.open(scene)).collect::<Result<_, _>>()?;

    // The rays.
    let count = args.rays as usize;
    let walks = Walks::record(scene, count, args.seed, |flight| ours[0].land(flight));
    for (what, list) in [("rays", &walks.flights), ("shadow rays", &walks.shadows)] {
        if list.len() < count {
            let (scene, found) = (scene.name.clone(), list.len());
            return Err(Failure::Rays { scene, what, found, wanted: count });
        }
    }
    let random = shuffled(&walks.flights, args.seed);
    let neat = sorted(&walks.flights, scene.bounds());
    let shadows = shuffled(&walks.shadows, args.seed);
    say(&format!(
        "\n{}: {} triangles, {} vertices, {} lights, {} rooms, delta {:.3} mm; \
         {count} rays of {} photons ({} escaped), {count} shadow rays",
        scene.name,
        scene.triangles.len(),
        scene.vertices.list().len(),
        scene.lights.len(),
        scene.rooms.len(),
        1e3 * delta,
        walks.photons,
        walks.escaped,
    ));

    // Embree's hierarchies, and what everything takes.
    let device = embree.device()?;
    let mesh = Mesh::new(&scene.vertices, &scene.triangles)?;
    let build = |quality| embree.build(&device, mesh, quality);
    let medium = build(Quality::Medium)?;
    let high = build(Quality::High)?;
    let mut sizes: Vec<(String, usize)> =
        built.iter().map(|b| (format!("ours, {}", b.kind.name()), b.blob.len())).collect();
    sizes.push(("Embree, medium".into(), medium.bytes()));
    sizes.push(("Embree, high".into(), high.bytes()));
    sizes.push(("Embree, compact".into(), build(Quality::Compact)?.bytes()));
    bytes(scene, &tile, &sizes, table);

    // Do all say the same?
    let agreement = Agreement::of(&ours[0], &medium, &walks.flights, &walks.shadows);
    say(&format!("  {agreement}"));
    table.figure(id, "same rays, different hits", "both", "share", agreement.apart());
    if !agreement.tolerable() {
        return Err(Failure::Apart { scene: scene.name.clone(), agreement });
    }
    same_among_ours(args, scene, &ours, &random)?;

    // The building, room by room.
    let apart = scene.rooms.len() > 1;
    let tiles: Vec<Tile> = match apart {
        true => scene.rooms.iter().map(|room| Tile::room(scene, room)).collect(),
        false => Vec::new(),
    };
    let kind = args.structures[0];
    let blobs: Vec<Built> = tiles.iter().map(|tile| Built::new(kind, tile, delta)).collect();
    let queues = if apart { by_rooms(scene, &ours[0], &random) } else { Vec::new() };
    let rooms = rooms(scene, &ours[0], &random, &blobs, &queues)?;
    if apart {
        let queries: usize = rooms.iter().map(|room| room.queries.len()).sum();
        let bytes: usize = blobs.iter().map(|b| b.blob.len()).sum();
        say(&format!(
            "  as rooms: {} rooms, {:.0} rays a room, {:.3} queries a ray; {:.1} bytes a triangle",
            rooms.len(),
            count as f64 / rooms.len() as f64,
            queries as f64 / count as f64,
            bytes as f64 / scene.triangles.len() as f64,
        ));
    }

    let mut groups = vec![builds(args, scene, &tile, embree, mesh)?];
    let input = Input {
        args,
        ours: &ours,
        rooms: &rooms,
        embree: [&medium, &high],
        random: &random,
        walk: &walks.flights,
        neat: &neat,
        shadows: &shadows,
    };
    let mut verdicts = Vec::new();
    for &threads in &args.threads {
        let measured = input.queries(threads)?;
        verdicts.push(verdict(scene, threads, &groups[0], &measured));
        groups.extend(measured);
    }
    for group in &groups {
        table.group(id, group);
        say(&report::readable(group));
    }
    Ok(verdicts)
}

/// Prints and keeps what structures take.
fn bytes(scene: &Scene, tile: &Tile<'_>, sizes: &[(String, usize)], table: &mut Table) {
    let triangles = scene.triangles.len();
    let head = format!(
        "  {:<48} {:>9}   {:>26}",
        "bytes a triangle", "structure", "with vertices and indices"
    );
    say(&head);
    for (name, size) in sizes {
        let alone = *size as f64 / triangles as f64;
        let together = (size + tile.mesh_bytes()) as f64 / triangles as f64;
        say(&format!("    {name:<46} {alone:>9.1}   {together:>26.1}"));
        let id = (scene.name.as_str(), triangles);
        table.figure(id, "structure", name, "bytes a triangle", alone);
        table.figure(id, "structure, vertices and indices", name, "bytes a triangle", together);
    }
}

/// Our ways must agree with each other to the bit.
fn same_among_ours(
    args: &Args,
    scene: &Scene,
    ours: &[Ours<'_>],
    flights: &[Flight],
) -> Result<(), Failure> {
    let queries: Vec<Query> = flights.iter().map(Query::of).collect();
    let expected: Vec<Option<Hit>> = queries.iter().map(|query| ours[0].nearest(query)).collect();
    let compare = |name: String, answers: &[Option<Hit>]| match answers
        .iter()
        .zip(&expected)
        .filter(|(a, b)| a != b)
        .count()
    {
        0 => Ok(()),
        count => Err(Failure::Unequal {
            scene: scene.name.clone(),
            ours: name,
            reference: args.structures[0].name().into(),
            count,
        }),
    };
    for (kind, ours) in args.structures.iter().zip(ours) {
        let single: Vec<Option<Hit>> = queries.iter().map(|query| ours.nearest(query)).collect();
        compare(kind.name().into(), &single)?;
        let portable: Vec<Option<Hit>> =
            queries.iter().map(|query| ours.nearest_portable(query)).collect();
        compare(format!("{}, portable", kind.name()), &portable)?;
        let mut batch = vec![None; queries.len()];
        ours.nearest_batch(&queries, &mut batch);
        compare(format!("{}, in batches", kind.name()), &batch)?;
    }
    Ok(())
}

/// Opens rooms, and holds their answers together against the whole scene's.
fn rooms<'a>(
    scene: &Scene,
    whole: &Ours<'_>,
    flights: &[Flight],
    built: &'a [Built<'_, '_>],
    queues: &[Vec<(Query, u32)>],
) -> Result<Vec<RoomQueue<'a>>, Failure> {
    let mut rooms = Vec::with_capacity(built.len());
    let mut answers: Vec<Option<(u32, f32)>> = vec![None; flights.len()];
    for (built, queue) in built.iter().zip(queues) {
        let ours = built.open(scene)?;
        for (query, flight) in queue {
            if let Some(hit) = ours.nearest(query) {
                answers[*flight as usize] = Some((hit.global, hit.t));
            }
        }
        rooms.push(RoomQueue { ours, queries: queue.iter().map(|(query, _)| *query).collect() });
    }
    let differ = |(flight, answer): (&Flight, Option<(u32, f32)>)| {
        whole.nearest(&Query::of(flight)).map(|hit| (hit.global, hit.t)) != answer
    };
    match flights.iter().zip(answers).filter(|&(f, a)| !built.is_empty() && differ((f, a))).count()
    {
        0 => Ok(rooms),
        count => Err(Failure::Unequal {
            scene: scene.name.clone(),
            ours: "room by room".into(),
            reference: "one scene".into(),
            count,
        }),
    }
}

/// Builds, each with one thread.
fn builds(
    args: &Args,
    scene: &Scene,
    tile: &Tile<'_>,
    embree: &Embree,
    mesh: Mesh<'_>,
) -> Result<Group, Failure> {
    let delta = scene.delta();
    // One device for each, so that nobody builds in what another left.
    let devices = [embree.device()?, embree.device()?, embree.device()?];
    let mut contenders: Vec<Contender<Failure>> = Vec::new();
    for &kind in &args.structures {
        let name = format!("ours, {}", kind.name());
        contenders.push(Contender::new(name, move || kind.build(tile, delta)));
    }
    let qualities = [
        ("Embree, medium", Quality::Medium),
        ("Embree, high", Quality::High),
        ("Embree, compact", Quality::Compact),
    ];
    for ((name, quality), device) in qualities.into_iter().zip(&devices) {
        contenders
            .push(Contender::fallible(name, move || Ok(embree.build(device, mesh, quality)?)));
    }
    Group::run("build, triangles", scene.triangles.len(), 1, args.repetitions, &contenders)
}

/// Rays that single queries are handed out in.
const PIECE: usize = 8192;

/// Names of Embree's packets on sorted rays begin with this.
const PACKETS_SORTED: &str = "Embree, packets on sorted rays";

/// What queries are measured with.
struct Input<'i> {
    args: &'i Args,
    ours: &'i [Ours<'i>],
    rooms: &'i [RoomQueue<'i>],
    /// Medium, high.
    embree: [&'i embree::Scene<'i>; 2],
    random: &'i [Flight],
    walk: &'i [Flight],
    neat: &'i [Flight],
    shadows: &'i [Flight],
}

impl Input<'_> {
    /// All groups of queries with so many threads.
    fn queries(&self, threads: u32) -> Result<Vec<Group>, Failure> {
        let queries = |flights: &[Flight]| flights.iter().map(Query::of).collect::<Vec<_>>();
        let beams = |flights: &[Flight]| flights.iter().map(beam).collect::<Vec<_>>();
        let random = (queries(self.random), beams(self.random));
        let walk = (queries(self.walk), beams(self.walk));
        let shadows = (queries(self.shadows), beams(self.shadows));
        let neat = beams(self.neat);
        let [medium, high] = self.embree;
        let kinds = || self.args.structures.iter().zip(self.ours);
        let mut groups = Vec::new();
        let mut measure = |name: &str, contenders: &[Contender<Failure>]| {
            let count = self.random.len();
            let group = Group::run(name, count, threads, self.args.repetitions, contenders)?;
            groups.push(group);
            Ok::<(), Failure>(())
        };

        let mut contenders = Vec::new();
        for (kind, ours) in kinds() {
            let name = format!("ours, {}", kind.name());
            contenders
                .push(Contender::new(name, || single(threads, &random.0, |q| ours.nearest(q))));
        }
        if let Some((kind, ours)) = kinds().next() {
            let name = format!("ours, {}, portable", kind.name());
            let ask = || single(threads, &random.0, |q| ours.nearest_portable(q));
            contenders.push(Contender::new(name, ask));
        }
        if !self.rooms.is_empty() {
            contenders.push(Contender::new("ours, room by room", || {
                let ask =
                    |room: &RoomQueue| single(threads, &room.queries, |q| room.ours.nearest(q));
                self.rooms.iter().map(ask).sum::<f64>()
            }));
        }
        for (name, scene) in
            [("Embree, rtcIntersect1", medium), ("Embree, rtcIntersect1, high", high)]
        {
            let ask = || embree_single(threads, &random.1, scene);
            contenders.push(Contender::new(name, ask));
        }
        measure("nearest hits, one by one, shuffled rays", &contenders)?;

        let ours = &self.ours[0];
        measure(
            "nearest hits, one by one, in the photons' order",
            &[
                Contender::new("ours", || single(threads, &walk.0, |q| ours.nearest(q))),
                Contender::new("Embree, rtcIntersect1", || embree_single(threads, &walk.1, medium)),
            ],
        )?;

        let batch = self.args.batch as usize;
        let batches = |ours: &Ours<'_>, queries: &[Query]| {
            // As many for each thread, so that none waits for the last one.
            let pieces = queries.len().div_ceil(batch).next_multiple_of(threads as usize);
            let piece = queries.len().div_ceil(pieces.max(1)).max(1);
            spread(threads, queries.len(), piece, |next| {
                let mut answers = vec![None; piece];
                let mut sum = 0.0;
                while let Some(range) = next() {
                    let answers = &mut answers[..range.len()];
                    ours.nearest_batch(&queries[range], answers);
                    sum += answers.iter().flatten().map(|hit| f64::from(hit.t)).sum::<f64>();
                }
                sum
            })
        };
        let batches = &batches;
        let mut contenders = Vec::new();
        for (kind, ours) in kinds() {
            let name = format!("ours, {}, batches of shuffled rays", kind.name());
            contenders.push(Contender::new(name, || batches(ours, &random.0)));
        }
        let ordered = || batches(&self.ours[0], &walk.0);
        contenders.push(Contender::new("ours, batches in the photons' order", ordered));
        if !self.rooms.is_empty() {
            contenders.push(Contender::new("ours, batches, room by room", || {
                self.rooms.iter().map(|room| batches(&room.ours, &room.queries)).sum::<f64>()
            }));
        }
        for (order, beams) in [("sorted", &neat), ("shuffled", &random.1)] {
            let name = |n: u32| format!("Embree, packets on {order} rays, rtcIntersect{n}");
            contenders.push(Contender::new(name(8), || {
                packets(threads, beams, |beams, sum| {
                    medium.nearest8(beams, |found| *sum += found.map_or(0.0, |f| f64::from(f.t)));
                })
            }));
            contenders.push(Contender::new(name(16), || {
                packets(threads, beams, |beams, sum| {
                    medium.nearest16(beams, |found| *sum += found.map_or(0.0, |f| f64::from(f.t)));
                })
            }));
        }
        let ask = || embree_single(threads, &neat, medium);
        contenders.push(Contender::new("Embree, sorted rays, rtcIntersect1", ask));
        measure("nearest hits, many at a time", &contenders)?;

        let mut contenders = Vec::new();
        for (kind, ours) in kinds() {
            let name = format!("ours, {}", kind.name());
            let ask = || any(threads, &shadows.0, |q| ours.occluded(q));
            contenders.push(Contender::new(name, ask));
        }
        for (name, scene) in
            [("Embree, rtcOccluded1", medium), ("Embree, rtcOccluded1, high", high)]
        {
            let ask = || any(threads, &shadows.1, |beam| scene.occluded(beam));
            contenders.push(Contender::new(name, ask));
        }
        measure("shadow rays, one by one, shuffled", &contenders)?;
        Ok(groups)
    }
}

/// Asks for nearest hits one by one; the sum of their distances.
fn single(threads: u32, queries: &[Query], nearest: impl Fn(&Query) -> Option<Hit> + Sync) -> f64 {
    spread(threads, queries.len(), PIECE, |next| {
        let mut sum = 0.0;
        while let Some(range) = next() {
            for query in &queries[range] {
                sum += nearest(query).map_or(0.0, |hit| f64::from(hit.t));
            }
        }
        sum
    })
}

/// The same of Embree.
fn embree_single(threads: u32, beams: &[Beam], scene: &embree::Scene<'_>) -> f64 {
    spread(threads, beams.len(), PIECE, |next| {
        let mut sum = 0.0;
        while let Some(range) = next() {
            for beam in &beams[range] {
                sum += scene.nearest(beam).map_or(0.0, |found| f64::from(found.t));
            }
        }
        sum
    })
}

/// The same of Embree's packets.
fn packets(threads: u32, beams: &[Beam], ask: impl Fn(&[Beam], &mut f64) + Sync) -> f64 {
    spread(threads, beams.len(), PIECE, |next| {
        let mut sum = 0.0;
        while let Some(range) = next() {
            ask(&beams[range], &mut sum);
        }
        sum
    })
}

/// Asks whether anything is in the way, one by one; how often.
fn any<Q: Sync>(threads: u32, questions: &[Q], occluded: impl Fn(&Q) -> bool + Sync) -> f64 {
    spread(threads, questions.len(), PIECE, |next| {
        let mut count = 0u32;
        while let Some(range) = next() {
            count += questions[range].iter().map(|q| u32::from(occluded(q))).sum::<u32>();
        }
        f64::from(count)
    })
}

/// What is asked first about a scene: ours against Embree's own default, and, where another of its ways is harder to beat,
/// against that.
fn verdict(scene: &Scene, threads: u32, build: &Group, queries: &[Group]) -> Verdict {
    let mut ratios = Vec::new();
    let mut add = |what, group: &Group, of: &str| {
        let fair = group.hardest(|name| name.starts_with(of) && !name.ends_with("high"));
        let best = group.hardest(|name| name.starts_with("Embree"));
        for k in fair.into_iter().chain(best.filter(|_| best != fair)) {
            ratios.push((what, group.series[k].name.clone(), group.ratio(k)));
        }
    };
    if threads == 1 {
        add("build", build, "Embree, medium");
    }
    if let [single, _, batch, shadow] = queries {
        add("nearest hits, single", single, "Embree");
        add("nearest hits, batches", batch, PACKETS_SORTED);
        add("shadow rays", shadow, "Embree");
    }
    Verdict { scene: scene.name.clone(), threads, ratios }
}
