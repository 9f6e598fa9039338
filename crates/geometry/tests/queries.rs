//! Intervals, ties, exclusions, and numbers that are none: answers that can be told by hand.

mod common;

use common::{Blobs, Corners, Random, Tile, delta};
use enf_geometry::{Hit, Instructions, NONE, Query, Ray};
use glam::Vec3;

const INFINITY: f32 = f32::INFINITY;

/// The answer of everybody, who must agree.
fn ask(tile: &Tile<'_>, query: Query) -> Option<Hit> {
    let truth = tile.by_force(&query);
    tile.check(&query, truth);
    tile.check_batch(&[query; 5], &[truth; 5]);
    truth
}

/// Panes across the x axis, at 1 m, 2 m and so on. They are two triangles each; this ray meets the first of them.
fn panes(count: usize) -> Vec<Corners> {
    let mut out = Vec::new();
    for i in 0..count {
        let at = |y: f32, z: f32| Vec3::new((i + 1) as f32, y, z);
        out.push([at(-2.0, -2.0), at(2.0, -2.0), at(2.0, 2.0)]);
        out.push([at(-2.0, -2.0), at(2.0, 2.0), at(-2.0, 2.0)]);
    }
    out
}

const ALONG: Ray = Ray { origin: Vec3::new(0.0, 0.5, -0.25), direction: Vec3::X };

/// Global indices in [`common::blob`] are `3 i + 1`.
fn pane(i: usize) -> u32 {
    6 * i as u32 + 1
}

#[test]
fn the_interval_is_half_open() {
    const PANES: usize = 40;
    let blobs = Blobs::new(&panes(PANES), delta(PANES as f32));
    let tile = blobs.tile();
    let bounds: Vec<f32> = (0..=PANES + 1)
        .flat_map(|i| {
            let t = i as f32;
            [t.next_down().max(0.0), t, t.next_up(), t + 0.5]
        })
        .collect();
    for &t_min in &bounds {
        for &t_max in bounds.iter().chain(&[INFINITY, f32::MAX]) {
            let first = t_min.ceil().max(1.0);
            let expected = (first < t_max && first <= PANES as f32).then_some(first);
            let query = Query { ray: ALONG, t_min, t_max, exclude: NONE };
            let hit = tile.bvh.nearest(&query);
            assert_eq!(hit.map(|h| h.t), expected, "[{t_min}, {t_max})");
            assert_eq!(hit.map(|h| h.global), expected.map(|t| pane(t as usize - 1)));
            assert_eq!(tile.grid.nearest(&query), hit);
            assert_eq!(tile.bvh.nearest_with(Instructions::Portable, &query), hit);
            assert_eq!(tile.batch(&[query]), [hit]);
        }
    }
}

#[test]
fn odd_beginnings_and_ends() {
    let blobs = Blobs::new(&panes(9), delta(9.0));
    let tile = blobs.tile();
    let inside = Ray { origin: ALONG.origin + 3.5 * Vec3::X, ..ALONG };
    let t = |ray, t_min, t_max| {
        ask(&tile, Query { ray, t_min, t_max, exclude: NONE }).map(|hit| (hit.t, hit.global))
    };
    // Nothing behind the origin is hit, wherever the interval begins.
    for t_min in [0.0, -0.0, -1e-45, -1e-30, -1.0, -3.5, -100.0, f32::MIN, f32::NEG_INFINITY] {
        assert_eq!(t(inside, t_min, INFINITY), Some((0.5, pane(3))), "{t_min}");
        assert_eq!(t(inside, t_min, 0.5), None, "{t_min}");
        for t_max in [0.0, -0.0, -1.0, -2.0, f32::NEG_INFINITY, f32::NAN] {
            assert_eq!(t(inside, t_min, t_max), None, "[{t_min}, {t_max})");
        }
    }
    for t_min in [f32::NAN, -f32::NAN, INFINITY, f32::MAX] {
        for t_max in [0.0, 1.0, f32::MAX, INFINITY, f32::NAN] {
            assert_eq!(t(inside, t_min, t_max), None, "[{t_min}, {t_max})");
        }
    }
    for t_max in [f32::MAX, INFINITY, 0.5f32.next_up()] {
        assert_eq!(t(inside, 0.5, t_max), Some((0.5, pane(3))), "{t_max}");
    }
    assert_eq!(t(inside, 2.0, 1.0), None);
    assert_eq!(t(inside, 0.5, 0.5), None);
}

/// A ray that starts on a triangle hits it at zero, from either side, unless that is excluded.
#[test]
fn where_the_ray_starts() {
    let blobs = Blobs::new(&panes(9), delta(9.0));
    let tile = blobs.tile();
    for direction in [Vec3::X, Vec3::NEG_X] {
        let ray = Ray { origin: ALONG.origin + 5.0 * Vec3::X, direction };
        let next = if direction.x > 0.0 { pane(5) } else { pane(3) };
        let at = |t_min, t_max, exclude| {
            ask(&tile, Query { ray, t_min, t_max, exclude }).map(|hit| (hit.t, hit.global))
        };
        assert_eq!(at(0.0, INFINITY, NONE), Some((0.0, pane(4))));
        assert_eq!(at(-7.0, 1e-45, NONE), Some((0.0, pane(4))));
        assert_eq!(at(0.0, 0.0, NONE), None);
        assert_eq!(at(1e-45, INFINITY, NONE), Some((1.0, next)));
        assert_eq!(at(0.0, INFINITY, pane(4)), Some((1.0, next)));
        assert_eq!(at(0.0, 1.0, pane(4)), None);
        // A neighbour in the same plane is not the triangle itself.
        assert_eq!(at(0.0, INFINITY, pane(4) + 3), Some((0.0, pane(4))));
    }
}

/// Copies of the same triangles, corners turned and all mixed up: the smallest index wins, then the next one.
#[test]
fn ties_go_to_the_smaller_index_among_hundreds() {
    let mut random = Random(41);
    for round in 0..20 {
        let copies = 1 + random.below(150);
        let walls = panes(4);
        let mut triangles = Vec::new();
        for _ in 0..copies {
            let [a, b, c] = walls[random.below(walls.len())];
            triangles.push(match random.below(6) {
                0 => [a, b, c],
                1 => [b, c, a],
                2 => [c, a, b],
                3 => [c, b, a],
                4 => [b, a, c],
                _ => [a, c, b],
            });
        }
        let blobs = Blobs::new(&triangles, delta(4.0));
        let tile = blobs.tile();
        // Below the diagonal, above it, and on it, where both halves of a pane are hit.
        for (y, z) in [(0.5, -0.25), (-0.25, 0.5), (0.5, 0.5)] {
            let ray = Ray { origin: Vec3::new(0.0, y, z), direction: Vec3::X };
            let first = |exclude: u32, t_min: f32| {
                let on = |i: usize| {
                    let [a, b, c] = triangles[i];
                    let third = if a.y == a.z { if b.y == b.z { c } else { b } } else { a };
                    y == z || (third.y > third.z) == (y > z)
                };
                (0..triangles.len())
                    .map(|i| (triangles[i][0].x, 3 * i as u32 + 1))
                    .filter(|&(t, global)| {
                        on(global as usize / 3) && t >= t_min && global != exclude
                    })
                    .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
            };
            let (mut exclude, mut t_min) = (NONE, 0.0);
            for _ in 0..8 {
                let query = Query { ray, t_min, t_max: INFINITY, exclude };
                let found = ask(&tile, query).map(|hit| (hit.t, hit.global));
                assert_eq!(found, first(exclude, t_min), "round {round}");
                let Some((t, global)) = found else { break };
                (exclude, t_min) = (global, if random.below(3) == 0 { t.next_up() } else { t });
            }
        }
    }
}

/// Triangles without area: points, lines, doubled corners, folded lines; in front of a wall.
#[test]
fn what_has_no_area_is_never_hit() {
    let mut random = Random(42);
    let p = ALONG.origin;
    let at = |x: f32, y: f32, z: f32| Vec3::new(x, p.y + y, p.z + z);
    let mut triangles = vec![
        [at(1.0, 0.0, 0.0); 3],
        [at(1.0, -1.0, 0.0), at(1.0, 1.0, 0.0), at(1.0, 0.0, 0.0)],
        [at(1.0, -1.0, 0.0), at(1.0, 1.0, 0.0), at(1.0, 3.0, 0.0)],
        [at(1.5, -1.0, -1.0), at(1.5, 1.0, 1.0), at(1.5, 1.0, 1.0)],
        [at(1.5, -1.0, -1.0), at(1.5, -1.0, -1.0), at(1.5, 1.0, 1.0)],
        // Along the ray.
        [at(1.0, 0.0, 0.0), at(2.0, 0.0, 0.0), at(1.25, 0.0, 0.0)],
        [at(0.0, 0.0, 0.0), at(2.0, 0.0, 0.0), at(0.0, 0.0, 0.0)],
    ];
    for _ in 0..200 {
        let (a, step) =
            ((32.0 * random.cube()).round() / 32.0, (32.0 * random.cube()).round() / 32.0);
        let line = |k: usize| p + 1.5 * Vec3::X + a * Vec3::new(0.4, 0.0, 0.0) + k as f32 * step;
        let exact = [random.below(4), random.below(4), random.below(4)].map(line);
        let [a, b, c] = exact.map(|p| p.as_dvec3());
        if (b - a).cross(c - a).length() == 0.0 {
            triangles.push(exact);
        }
    }
    assert!(triangles.len() > 80, "{}", triangles.len());
    let flat = Blobs::new(&triangles, delta(8.0));
    let count = triangles.len() as u32;
    triangles.push([at(3.0, -9.0, -9.0), at(3.0, 9.0, -9.0), at(3.0, 0.0, 9.0)]);
    let walled = Blobs::new(&triangles, delta(8.0));
    for i in 0..2000 {
        let [a, b, c] = triangles[random.below(count as usize)];
        let mut ray = ALONG;
        if i > 0 {
            ray.origin = p + 0.5 * random.cube() - 2.0 * Vec3::X;
            let target = [a, b, c, 0.5 * (a + b), a + random.unit() * (c - a)][random.below(5)];
            ray.direction = (target - ray.origin).normalize();
        }
        let query = common::anything(ray);
        assert_eq!(ask(&flat.tile(), query), None);
        assert!(ask(&walled.tile(), query).is_none_or(|hit| hit.global == 3 * count + 1));
    }
    let hit = ask(&walled.tile(), common::anything(ALONG)).unwrap();
    assert_eq!((hit.t, hit.global), (3.0, 3 * count + 1));
}

/// Coordinates from denormal to nearly infinite, meshes too large for their tolerance, origins anywhere: no panic, and
/// brute force has the last word.
#[test]
fn huge_and_denormal_coordinates_are_harmless() {
    let mut random = Random(43);
    let sizes = [1e-44, 1e-38, 1e-30, 1e-20, 1e-3, 1.0, 1e6, 1e12, 1e19, 1e30, 1e38, 3.4e38];
    // No scene is blurred by more than this.
    let most = 1e30;
    let mut hits = 0;
    for size in sizes {
        for tolerance in [size * (4.0 / (1 << 19) as f32), size * 1e-12, 0.0, size.min(most), 1e-4]
        {
            let triangles: Vec<Corners> =
                (0..24).map(|_| [0, 1, 2].map(|_| size * random.cube())).collect();
            let blobs = Blobs::new(&triangles, tolerance);
            let tile = blobs.tile();
            for _ in 0..40 {
                let far = sizes[random.below(sizes.len())];
                let reach = if random.below(2) == 0 { size } else { far };
                let origin = reach * random.cube();
                let target = triangles[random.below(24)][0];
                let direction = match random.below(3) {
                    0 => random.direction(),
                    1 => {
                        let away = target / size.max(reach) - origin / size.max(reach);
                        away.try_normalize().unwrap_or(Vec3::Z)
                    }
                    _ => [Vec3::X, Vec3::NEG_Y, Vec3::new(1.0, 1e-40, -1e-45)][random.below(3)],
                };
                let ray = Ray { origin, direction };
                for (t_min, t_max) in [(0.0, INFINITY), (-1.0, 0.5 * size), (1e-45, 1e-30)] {
                    let query = Query { ray, t_min, t_max, exclude: NONE };
                    hits += usize::from(ask(&tile, query).is_some());
                }
            }
        }
    }
    assert!(hits > 300, "{hits}");
}

/// Rays that are no rays: nothing is hit, whatever else is asked.
#[test]
fn rays_without_numbers_or_direction_hit_nothing() {
    let blobs = Blobs::new(&panes(9), delta(9.0));
    let tile = blobs.tile();
    assert!(ask(&tile, common::anything(ALONG)).is_some());
    for bad in [f32::NAN, INFINITY, f32::NEG_INFINITY] {
        for axis in 0..3 {
            let mut ray = ALONG;
            ray.origin[axis] = bad;
            assert_eq!(ask(&tile, common::anything(ray)), None, "{ray:?}");
            let mut ray = ALONG;
            ray.direction[axis] = bad;
            assert_eq!(ask(&tile, common::anything(ray)), None, "{ray:?}");
        }
    }
    for direction in [Vec3::ZERO, -Vec3::ZERO] {
        assert_eq!(ask(&tile, common::anything(Ray { direction, ..ALONG })), None);
    }
}

#[test]
fn a_batch_may_have_any_length() {
    let blobs = Blobs::new(&panes(9), delta(9.0));
    let tile = blobs.tile();
    for n in (0..70).chain([1000, 2047, 2048, 2049, 5000]) {
        let queries: Vec<Query> = (0..n)
            .map(|i| Query { t_min: (i % 11) as f32 + 0.5, ..common::anything(ALONG) })
            .collect();
        let t: Vec<Option<f32>> = tile.batch(&queries).iter().map(|h| h.map(|h| h.t)).collect();
        let expected: Vec<Option<f32>> =
            (0..n).map(|i| Some((i % 11) as f32 + 1.0).filter(|&t| t < 9.5)).collect();
        assert_eq!(t, expected);
    }
    // As many as there are of both.
    let queries = [common::anything(ALONG); 10];
    let hit = tile.by_force(&queries[0]);
    for n in [0, 4, 10, 12] {
        for kind in common::KINDS {
            let (mut hits, mut shadows) = (vec![None; n], vec![false; n]);
            tile.structure(kind).nearest_batch(&queries, &mut hits);
            tile.structure(kind).occluded_batch(&queries, &mut shadows);
            for i in 0..n {
                assert_eq!((hits[i], shadows[i]), if i < 10 { (hit, true) } else { (None, false) });
            }
        }
    }
}
