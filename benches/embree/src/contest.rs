//! Who does what, side by side: the contenders of every group.

use crate::Failure;
use crate::args::Args;
use crate::check::beam;
use crate::embree::{self, Beam, Embree, Mesh, Quality};
use crate::measure::{Contender, Group, spread};
use crate::ours::{Hit, Ours, Query, Tile, name_of, query};
use crate::scene::Scene;
use crate::walk::Flight;

/// A room with its structure and its queue.
pub struct RoomQueue<'a> {
    /// Its structure.
    pub ours: Ours<'a>,
    /// What it is asked.
    pub queries: Vec<Query>,
}

/// Builds, each with one thread.
pub fn builds(
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
        contenders.push(Contender::fallible(name, move || {
            kind.build(tile, delta)
                .map_err(|malformed| Failure::Ours { scene: scene.name.clone(), malformed })
        }));
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
pub const PACKETS_SORTED: &str = "Embree, packets on sorted rays";

/// What queries are measured with.
pub struct Input<'i> {
    /// What was typed.
    pub args: &'i Args,
    /// One for each kind that was asked for.
    pub ours: &'i [Ours<'i>],
    /// The building room by room, if it has several.
    pub rooms: &'i [RoomQueue<'i>],
    /// Medium, high, robust.
    pub embree: [&'i embree::Scene<'i>; 3],
    /// The rays, shuffled.
    pub random: &'i [Flight],
    /// The same in the photons' order.
    pub walk: &'i [Flight],
    /// The same sorted.
    pub neat: &'i [Flight],
    /// Shadow rays, shuffled.
    pub shadows: &'i [Flight],
    /// The same sorted.
    pub neat_shadows: &'i [Flight],
}

impl Input<'_> {
    /// All groups of queries with so many threads.
    pub fn queries(&self, threads: u32) -> Result<Vec<Group>, Failure> {
        let queries = |flights: &[Flight]| flights.iter().map(query).collect::<Vec<_>>();
        let beams = |flights: &[Flight]| flights.iter().map(beam).collect::<Vec<_>>();
        let random = &(queries(self.random), beams(self.random));
        let walk = &(queries(self.walk), beams(self.walk));
        let shadows = &(queries(self.shadows), beams(self.shadows));
        let (neat, neat_shadows) = (beams(self.neat), beams(self.neat_shadows));
        let [medium, high, robust] = self.embree;
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
        // What else the machine could do, for the first kind.
        let lesser = self.args.structures[0].lesser();
        for &instructions in &lesser {
            let name = format!("ours, {}", name_of(instructions));
            let ask =
                move || single(threads, &random.0, |q| self.ours[0].nearest_with(instructions, q));
            contenders.push(Contender::new(name, ask));
        }
        if !self.rooms.is_empty() {
            contenders.push(Contender::new("ours, room by room", || {
                let ask =
                    |room: &RoomQueue| single(threads, &room.queries, |q| room.ours.nearest(q));
                self.rooms.iter().map(ask).sum::<f64>()
            }));
        }
        for (name, scene) in [
            ("Embree, rtcIntersect1", medium),
            ("Embree, rtcIntersect1, high", high),
            ("Embree, rtcIntersect1, robust", robust),
        ] {
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
        // As many for each thread, so that none waits for the last one.
        let piece = |count: usize| {
            let pieces = count.div_ceil(batch).next_multiple_of(threads as usize);
            count.div_ceil(pieces.max(1)).max(1)
        };
        let batches = |ours: &Ours<'_>, queries: &[Query]| {
            let piece = piece(queries.len());
            in_batches(threads, queries, piece, |q, answers| ours.nearest_batch(q, answers))
        };
        let (piece, batches) = (&piece, &batches);
        let mut contenders = Vec::new();
        for (kind, ours) in kinds() {
            let name = format!("ours, {}, batches of shuffled rays", kind.name());
            contenders.push(Contender::new(name, || batches(ours, &random.0)));
        }
        for &instructions in &lesser {
            contenders.push(Contender::new(
                format!("ours, {}, batches", name_of(instructions)),
                move || {
                    in_batches(threads, &random.0, piece(random.0.len()), |q, answers| {
                        self.ours[0].nearest_batch_with(instructions, q, answers);
                    })
                },
            ));
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
        for (name, scene) in [
            ("Embree, rtcOccluded1", medium),
            ("Embree, rtcOccluded1, high", high),
            ("Embree, rtcOccluded1, robust", robust),
        ] {
            let ask = || any(threads, &shadows.1, |beam| scene.occluded(beam));
            contenders.push(Contender::new(name, ask));
        }
        measure("shadow rays, one by one, shuffled", &contenders)?;

        let mut contenders = Vec::new();
        for (kind, ours) in kinds() {
            let name = format!("ours, {}, batches of shuffled rays", kind.name());
            let piece = piece(shadows.0.len());
            contenders.push(Contender::new(name, move || {
                dark_in_batches(threads, &shadows.0, piece, |q, dark| ours.occluded_batch(q, dark))
            }));
        }
        for (order, beams) in [("sorted", &neat_shadows), ("shuffled", &shadows.1)] {
            let name = |n: u32| format!("Embree, packets on {order} rays, rtcOccluded{n}");
            contenders.push(Contender::new(name(8), move || {
                packets(threads, beams, |beams, sum| {
                    medium.occluded8(beams, |dark| *sum += f64::from(u8::from(dark)));
                })
            }));
            contenders.push(Contender::new(name(16), move || {
                packets(threads, beams, |beams, sum| {
                    medium.occluded16(beams, |dark| *sum += f64::from(u8::from(dark)));
                })
            }));
        }
        let ask = || any(threads, &neat_shadows, |beam| medium.occluded(beam));
        contenders.push(Contender::new("Embree, sorted rays, rtcOccluded1", ask));
        measure("shadow rays, many at a time", &contenders)?;
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

/// Asks for nearest hits in batches of `piece`; the sum of their distances.
fn in_batches(
    threads: u32,
    queries: &[Query],
    piece: usize,
    nearest: impl Fn(&[Query], &mut [Option<Hit>]) + Sync,
) -> f64 {
    spread(threads, queries.len(), piece, |next| {
        let mut answers = vec![None; piece];
        let mut sum = 0.0;
        while let Some(range) = next() {
            let answers = &mut answers[..range.len()];
            nearest(&queries[range], answers);
            sum += answers.iter().flatten().map(|hit| f64::from(hit.t)).sum::<f64>();
        }
        sum
    })
}

/// Asks whether anything is in the way, in batches of `piece`; how often.
fn dark_in_batches(
    threads: u32,
    queries: &[Query],
    piece: usize,
    occluded: impl Fn(&[Query], &mut [bool]) + Sync,
) -> f64 {
    spread(threads, queries.len(), piece, |next| {
        let mut answers = vec![false; piece];
        let mut count = 0;
        while let Some(range) = next() {
            let answers = &mut answers[..range.len()];
            occluded(&queries[range], answers);
            count += answers.iter().filter(|&&dark| dark).count();
        }
        count as f64
    })
}

/// Asks Embree for nearest hits one by one; the sum of their distances.
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

/// Asks Embree in packets, whose answers `ask` adds up.
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
