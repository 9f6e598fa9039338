//! The same bits from every structure, with all instructions, one by one and all at once.

mod common;

use common::closed::surfaces;
use common::hard::hard;
use common::{Blobs, Corners, Random, Tile};
use enf_geometry::{Hit, Instructions, NONE, Query, Ray};
use glam::Vec3;

/// Numbers of queries, and of hits.
#[derive(Clone, Copy, Debug, Default)]
struct Count {
    queries: usize,
    hits: usize,
}

/// A mesh, and how large it is, m.
struct Scene {
    blobs: Blobs,
    triangles: Vec<Corners>,
    size: f32,
    centre: Vec3,
}

impl Scene {
    fn new(triangles: Vec<Corners>, delta: f32, size: f32, centre: Vec3) -> Self {
        Self { blobs: Blobs::new(&triangles, delta), triangles, size, centre }
    }

    fn zoo(seed: u64, count: usize, size: f32) -> Self {
        let triangles = common::zoo(&mut Random(seed), count, size);
        Self::new(triangles, common::delta(size), size, Vec3::ZERO)
    }

    /// A ray that is out to get us, with an interval.
    fn query(&self, random: &mut Random, last: f32) -> Query {
        let ray = if self.centre == Vec3::ZERO {
            common::ray(random, &self.triangles, self.size)
        } else {
            let triangle = self.triangles[random.below(self.triangles.len())];
            let ray = common::ray(random, &[triangle.map(|p| p - self.centre)], self.size);
            Ray { origin: ray.origin + self.centre, direction: ray.direction }
        };
        let mut query = common::anything(ray);
        match random.below(8) {
            0 => query.t_min = last,
            1 => query.t_max = last,
            2 => query.t_min = self.size * random.unit(),
            3 => query.t_max = self.size * random.unit(),
            4 => query.exclude = 3 * random.below(self.triangles.len()) as u32 + 1,
            _ => {}
        }
        query
    }

    /// Every way of asking agrees; with brute force as well, where that is asked for.
    fn agree(&self, tile: &Tile<'_>, seed: u64, count: usize, force: bool) -> Count {
        let mut random = Random(seed);
        let mut sum = Count::default();
        let mut last = f32::INFINITY;
        while sum.queries < count {
            // A batch of odd length, now and then one that is sorted, and what follows: the same rays without the
            // triangles that they hit.
            let most = if random.below(4) == 0 { 6000 } else { 700 };
            let n = (1 + random.below(most)).min(count - sum.queries);
            let mut queries: Vec<Query> = Vec::with_capacity(n);
            let mut truths: Vec<Option<Hit>> = Vec::with_capacity(n);
            for _ in 0..n {
                let mut query = self.query(&mut random, last);
                if let (Some(previous), Some(Some(hit)), 0) =
                    (queries.last(), truths.last(), random.below(3))
                {
                    query = Query { t_min: hit.t, exclude: hit.global, ..*previous };
                }
                let truth = if force {
                    tile.by_force(&query)
                } else {
                    tile.bvh.nearest_with(Instructions::Portable, &query)
                };
                tile.check(&query, truth);
                if let Some(hit) = truth {
                    sum.hits += 1;
                    last = hit.t;
                }
                queries.push(query);
                truths.push(truth);
            }
            tile.check_batch(&queries, &truths);
            sum.queries += n;
        }
        sum
    }
}

/// Meshes that are small enough to test all their triangles.
fn small() -> Vec<Scene> {
    let mut scenes: Vec<Scene> =
        [(1, 1, 1.0), (2, 7, 0.01), (3, 60, 30.0), (4, 120, 4.0), (5, 200, 900.0)]
            .into_iter()
            .map(|(seed, count, size)| Scene::zoo(seed, count, size))
            .collect();
    for surface in surfaces().into_iter().filter(|s| s.name == "octahedron") {
        scenes.push(Scene::new(surface.triangles, surface.delta, 4.0, Vec3::ZERO));
    }
    // Everything in one plane, everything on a lattice, everything in one place.
    let mut random = Random(6);
    let flat = |p: Vec3| Vec3::new(p.x, p.y, 0.75);
    let plane = common::zoo(&mut random, 80, 2.0).into_iter().map(|t| t.map(flat)).collect();
    scenes.push(Scene::new(plane, common::delta(2.0), 2.0, Vec3::ZERO));
    let lattice = |random: &mut Random| (4.0 * random.cube()).round();
    let triangles = (0..100)
        .map(|_| [lattice(&mut random), lattice(&mut random), lattice(&mut random)])
        .collect();
    scenes.push(Scene::new(triangles, common::delta(4.0), 4.0, Vec3::ZERO));
    let one = [0, 1, 2].map(|_| random.cube());
    scenes.push(Scene::new(vec![one; 60], common::delta(1.0), 1.0, Vec3::ZERO));
    scenes
}

fn large() -> Vec<Scene> {
    let mut scenes = vec![Scene::zoo(7, 3_000, 8.0), Scene::zoo(8, 8_000, 50.0)];
    for surface in surfaces() {
        let mut triangles = surface.triangles;
        let size = surface.half.max_element();
        // Furniture, of which little can be seen.
        let zoo =
            common::zoo(&mut Random(9), triangles.len() / 2, 0.5 * surface.half.min_element());
        triangles.extend(zoo.into_iter().map(|t| t.map(|p| p + surface.centre)));
        scenes.push(Scene::new(triangles, surface.delta, 2.0 * size, surface.centre));
    }
    scenes
}

#[test]
fn small_meshes_give_the_bits_of_brute_force() {
    let scenes = small();
    let mut hits = 0;
    for (i, scene) in scenes.iter().enumerate() {
        let count = scene.agree(&scene.blobs.tile(), i as u64, 100_000 / scenes.len() + 1, true);
        println!("scene {i}: {count:?}");
        hits += count.hits;
    }
    assert!(hits > 20_000, "{hits}");
}

#[test]
fn large_meshes_give_the_same_bits_in_all_ways() {
    let scenes = large();
    let mut hits = 0;
    for (i, scene) in scenes.iter().enumerate() {
        let count = scene.agree(&scene.blobs.tile(), i as u64, 100_000 / scenes.len() + 1, false);
        println!("scene {i}: {count:?}");
        hits += count.hits;
        scene.agree(&scene.blobs.tile(), 1000 + i as u64, 20, true);
    }
    assert!(hits > 30_000, "{hits}");
}

/// Rays and triangles that only just keep the margin, or not in `f32`, with coordinates up to the bound: side by side in
/// blocks they are what they are alone.
#[test]
fn hard_triangles_are_the_same_in_blocks() {
    let mut random = Random(0xB10C);
    let (mut queries, mut hits) = (0, 0);
    for i in 0..2500 {
        let s = libm::exp2f([6.0, 0.0, -11.0, 13.0, 29.0][i % 5]);
        let delta = s / (1 << 19) as f32;
        // Boxes are four tolerances larger than what is in them. Every tenth mesh is too large for them.
        let size = if i % 10 == 0 { s } else { s - 8.0 * delta };
        let (mut triangles, mut rays) = (Vec::new(), Vec::new());
        for _ in 0..1 + random.below(48) {
            let (_, ray, triangle) = hard(&mut random, size);
            rays.push(ray);
            triangles.push(triangle);
        }
        let blobs = Blobs::new(&triangles, delta);
        let tile = blobs.tile();
        let mut asked = Vec::new();
        for ray in rays {
            let mut query = common::anything(ray);
            let first = tile.by_force(&query);
            asked.push((query, first));
            if let Some(first) = first {
                (query.t_min, query.exclude) = (first.t, first.global);
                asked.push((query, tile.by_force(&query)));
                query = Query { t_min: 0.0, t_max: first.t.next_up(), exclude: NONE, ..query };
                asked.push((query, Some(first)));
                query.t_max = first.t;
                asked.push((query, None));
            }
        }
        for (query, truth) in &asked {
            tile.check(query, *truth);
            hits += usize::from(truth.is_some());
        }
        queries += asked.len();
        let (asked, truths): (Vec<_>, Vec<_>) = asked.into_iter().unzip();
        tile.check_batch(&asked, &truths);
    }
    assert!(queries > 100_000 && hits > queries / 3, "{queries} queries, {hits} hits");
}

/// Ten million, on all cores.
#[test]
#[ignore = "takes minutes"]
fn heavy_ten_million_queries_give_the_same_bits() {
    let count =
        std::env::var("ENFILADE_QUERIES").ok().and_then(|n| n.parse().ok()).unwrap_or(10_000_000);
    let scenes: Vec<(Scene, bool)> = small()
        .into_iter()
        .map(|s| (s, true))
        .chain(large().into_iter().map(|s| (s, false)))
        .collect();
    const EACH: usize = 20_000;
    let jobs = count / EACH;
    let next = std::sync::atomic::AtomicUsize::new(0);
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    let work = || {
        let mut sum = Count::default();
        loop {
            let job = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            if job >= jobs {
                return sum;
            }
            let (scene, force) = &scenes[job % scenes.len()];
            let count = scene.agree(&scene.blobs.tile(), 1 << 32 | job as u64, EACH, *force);
            sum.queries += count.queries;
            sum.hits += count.hits;
            if job.is_multiple_of(50) {
                eprintln!("{job} of {jobs} jobs");
            }
        }
    };
    let sums: Vec<Count> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        threads.into_iter().map(|t| t.join().unwrap()).collect()
    });
    let (queries, hits) = sums.iter().fold((0, 0), |s, c| (s.0 + c.queries, s.1 + c.hits));
    eprintln!("{queries} queries, {hits} hits");
    assert!(queries == jobs * EACH && hits > queries / 4);
}
