//! The same rooms and the same rays, through our structures and through the real Embree.
//!
//! | module | question |
//! |---|---|
//! | [`room`], [`scene`] | what stands in the room? |
//! | [`walk`] | which rays? |
//! | [`ours`], [`embree`] | who is asked? |
//! | [`check`] | do both say the same? |
//! | [`contest`], [`measure`], [`clock`] | who does what, and how long does it take? |
//! | [`args`], [`number`], [`report`] | what is typed, and what is read? |
#![deny(unsafe_code)]

mod args;
mod check;
mod clock;
mod contest;
mod embree;
mod measure;
mod number;
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
use crate::check::Agreement;
use crate::contest::{Input, PACKETS_SORTED, RoomQueue, builds};
use crate::embree::{Embree, EmbreeError, Mesh, Quality};
use crate::measure::Group;
use crate::ours::{Hit, Kind, Ours, Query, Tile, available, by_rooms, name_of, query};
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
    let best = available().last().map_or("", |&best| name_of(best));
    let place = embree.path().display();
    say(&format!(
        "Embree {} ({place}); ours with {best} where nothing else is said",
        embree.version()
    ));
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
    fn new(kind: Kind, tile: &'t Tile<'s>, scene: &Scene) -> Result<Self, Failure> {
        let blob = kind
            .build(tile, scene.delta())
            .map_err(|malformed| Failure::Ours { scene: scene.name.clone(), malformed })?;
        Ok(Self { kind, tile, blob })
    }

    fn open(&self, scene: &Scene) -> Result<Ours<'_>, Failure> {
        Ours::open(self.kind, &self.blob, self.tile, scene.delta())
            .map_err(|malformed| Failure::Ours { scene: scene.name.clone(), malformed })
    }
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
    let built: Vec<Built> = args
        .structures
        .iter()
        .map(|&kind| Built::new(kind, &tile, scene))
        .collect::<Result<_, _>>()?;
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
    let neat_shadows = sorted(&walks.shadows, scene.bounds());
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
    let robust = build(Quality::Robust)?;
    let mut sizes = Vec::new();
    for b in &built {
        let size = b.blob.len();
        sizes.push((format!("ours, {}", b.kind.name()), size, size + tile.kept_bytes(b.kind)));
    }
    for (name, size) in [
        ("Embree, medium", medium.bytes()),
        ("Embree, high", high.bytes()),
        ("Embree, compact", build(Quality::Compact)?.bytes()),
    ] {
        sizes.push((name.to_owned(), size, size + tile.mesh_bytes()));
    }
    bytes(scene, &tile, &sizes, table);

    // Do all say the same?
    let agreement = Agreement::of(&ours[0], &medium, &walks.flights, &walks.shadows);
    say(&format!("  {agreement}"));
    table.figure(id, "same rays, different hits", "both", "share", agreement.apart());
    if !agreement.tolerable() {
        return Err(Failure::Apart { scene: scene.name.clone(), agreement });
    }
    same_among_ours(args, scene, &ours, &random, &shadows)?;

    // The building, room by room.
    let apart = scene.rooms.len() > 1;
    let tiles: Vec<Tile> = match apart {
        true => scene.rooms.iter().map(|room| Tile::room(scene, room)).collect(),
        false => Vec::new(),
    };
    let kind = args.structures[0];
    let blobs: Vec<Built> =
        tiles.iter().map(|tile| Built::new(kind, tile, scene)).collect::<Result<_, _>>()?;
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

    let mut keep = |group: &Group| {
        table.group(id, group);
        say(&report::readable(group));
    };
    let build = builds(args, scene, &tile, embree, mesh)?;
    keep(&build);
    let input = Input {
        args,
        ours: &ours,
        rooms: &rooms,
        embree: [&medium, &high, &robust],
        random: &random,
        walk: &walks.flights,
        neat: &neat,
        shadows: &shadows,
        neat_shadows: &neat_shadows,
    };
    let mut verdicts = Vec::new();
    for &threads in &args.threads {
        let measured = input.queries(threads)?;
        measured.iter().for_each(&mut keep);
        verdicts.push(verdict(scene, threads, &build, &measured));
    }
    Ok(verdicts)
}

/// Prints and keeps what structures take: alone, and with all that stays in memory while rays are traced.
fn bytes(scene: &Scene, tile: &Tile<'_>, sizes: &[(String, usize, usize)], table: &mut Table) {
    let triangles = scene.triangles.len();
    let share = |bytes: usize| bytes as f64 / triangles as f64;
    say(&format!(
        "  {:<58} {:>9}   {:>26}   {:>13}",
        "bytes a triangle", "structure", "with vertices and indices", "while tracing"
    ));
    for (name, size, kept) in sizes {
        let figures = [
            ("structure", share(*size)),
            ("structure, vertices and indices", share(size + tile.mesh_bytes())),
            ("in memory while tracing", share(*kept)),
        ];
        let [alone, together, kept] = figures.map(|(_, figure)| figure);
        say(&format!("    {name:<56} {alone:>9.1}   {together:>26.1}   {kept:>13.1}"));
        for (measure, figure) in figures {
            let id = (scene.name.as_str(), triangles);
            table.figure(id, measure, name, "bytes a triangle", figure);
        }
    }
}

/// Our ways must agree with each other to the bit.
fn same_among_ours(
    args: &Args,
    scene: &Scene,
    ours: &[Ours<'_>],
    flights: &[Flight],
    shadows: &[Flight],
) -> Result<(), Failure> {
    let queries: Vec<Query> = flights.iter().map(query).collect();
    let expected: Vec<Option<Hit>> = queries.iter().map(|query| ours[0].nearest(query)).collect();
    let compare = |ours: String, answers: &[Option<Hit>]| {
        let count = answers.iter().zip(&expected).filter(|(a, b)| a != b).count();
        let (scene, reference) = (scene.name.clone(), args.structures[0].name().to_owned());
        if count == 0 { Ok(()) } else { Err(Failure::Unequal { scene, ours, reference, count }) }
    };
    for (kind, ours) in args.structures.iter().zip(ours) {
        let single: Vec<Option<Hit>> = queries.iter().map(|query| ours.nearest(query)).collect();
        compare(kind.name().into(), &single)?;
        let mut batch = vec![None; queries.len()];
        ours.nearest_batch(&queries, &mut batch);
        compare(format!("{}, in batches", kind.name()), &batch)?;
        for instructions in kind.lesser() {
            let single: Vec<Option<Hit>> =
                queries.iter().map(|query| ours.nearest_with(instructions, query)).collect();
            compare(format!("{}, {}", kind.name(), name_of(instructions)), &single)?;
            ours.nearest_batch_with(instructions, &queries, &mut batch);
            compare(format!("{}, {}, in batches", kind.name(), name_of(instructions)), &batch)?;
        }
        // Of shadow rays, only whether.
        let queries: Vec<Query> = shadows.iter().map(query).collect();
        let mut batch = vec![false; queries.len()];
        ours.occluded_batch(&queries, &mut batch);
        let differ = |(query, answer): &(&Query, bool)| {
            ours.occluded(query) != *answer || ours.nearest(query).is_some() != *answer
        };
        let count = queries.iter().zip(batch).filter(differ).count();
        if count > 0 {
            let ours = format!("{}, shadow rays in batches", kind.name());
            let (scene, reference) = (scene.name.clone(), kind.name().to_owned());
            return Err(Failure::Unequal { scene, ours, reference, count });
        }
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
    if built.is_empty() {
        return Ok(rooms);
    }
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
    let differ = |(flight, answer): &(&Flight, Option<(u32, f32)>)| {
        whole.nearest(&query(flight)).map(|hit| (hit.global, hit.t)) != *answer
    };
    match flights.iter().zip(answers).filter(differ).count() {
        0 => Ok(rooms),
        count => Err(Failure::Unequal {
            scene: scene.name.clone(),
            ours: "room by room".into(),
            reference: "one scene".into(),
            count,
        }),
    }
}

/// What is asked first about a scene: ours against Embree's own default, and, where another of its ways is harder to beat,
/// against that.
fn verdict(scene: &Scene, threads: u32, build: &Group, queries: &[Group]) -> Verdict {
    let mut ratios = Vec::new();
    let mut add = |what, group: &Group, of: &str| {
        let fair = group.hardest(|name| {
            name.starts_with(of) && !name.contains(", high") && !name.contains(", robust")
        });
        let best = group.hardest(|name| name.starts_with("Embree"));
        for k in fair.into_iter().chain(best.filter(|_| best != fair)) {
            ratios.push((what, group.series[k].name.clone(), group.ratio(k)));
        }
    };
    if threads == 1 {
        add("build", build, "Embree, medium");
    }
    if let [single, _, batch, shadow, shadows] = queries {
        add("nearest hits, single", single, "Embree");
        add("nearest hits, batches", batch, PACKETS_SORTED);
        add("shadow rays, single", shadow, "Embree");
        add("shadow rays, batches", shadows, PACKETS_SORTED);
    }
    Verdict { scene: scene.name.clone(), threads, ratios }
}
