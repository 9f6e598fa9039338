//! The large triangles of a scene: walls are found from them, and they fit in memory.
//!
//! Rooms depend on the scene alone, so the survey does as well: all triangles of a small scene, the
//! largest of a big one, however much memory there is.

use enf_scene::Scene;
use enf_stage::{CommonArgs, Failure, Progress, Result};
use enf_store::{Array, MemoryBudget};

use crate::build::lost;

/// So many triangles are looked at in any case.
const ALWAYS: u64 = 500_000;
/// In a big scene, one of so many: furnished rooms have some hundred large triangles among tens of thousands.
const ONE_OF: u64 = 512;
/// Never more than these.
const AT_MOST: u64 = 1_000_000;

/// Triangles that show where the walls are.
pub(crate) struct Survey {
    /// Corners, in global order.
    pub(crate) corners: Array<[[f32; 3]; 3]>,
    /// Their materials.
    pub(crate) material_of: Array<u32>,
}

/// Bytes that a survey takes of a scene of `count` triangles.
pub(crate) fn bytes(count: u64) -> u64 {
    let buckets = if size(count) < count { BUCKETS as u64 * 8 } else { 0 };
    size(count) * 40 + buckets
}

/// How many triangles of a scene of `count` are looked at.
pub(crate) fn size(count: u64) -> u64 {
    (count / ONE_OF).clamp(ALWAYS, AT_MOST).min(count)
}

/// Buckets of sizes: one for each value of a float's upper half and sign.
const BUCKETS: usize = 1 << 17;

/// Twice the area of a triangle, as its bucket: sizes that differ by less than 0.4 % may share one.
fn bucket(corners: &[[f32; 3]; 3]) -> usize {
    let [a, b, c] = corners.map(glam::Vec3::from);
    let area = (b - a).cross(c - a).length();
    (area.to_bits() >> 15) as usize
}

impl Survey {
    /// Takes the `size` largest triangles of the scene (of those that are equally large, to 0.4 %, the first).
    /// Streams it once, or twice if it has more.
    ///
    /// # Errors
    /// Exit 3 without place for the survey.
    pub(crate) fn take(
        scene: &Scene,
        size: u64,
        common: &CommonArgs,
        budget: &MemoryBudget,
    ) -> Result<Self> {
        let count = scene.triangle_count();
        let mut survey = Self {
            corners: Array::with_capacity(budget, size as usize, "large triangles")?,
            material_of: Array::with_capacity(budget, size as usize, "large triangles")?,
        };
        // Everything above one bucket, and so many of that bucket.
        let (mut above, mut ties) = (0, u64::MAX);
        let progress = Progress::new(common, "survey", Some(count), "triangles");
        if size < count {
            let mut buckets: Array<u64> =
                Array::with_capacity(budget, BUCKETS, "sizes of triangles")?;
            // Just made with place for them.
            let _ = buckets.resize(BUCKETS, 0);
            scene
                .for_each_triangle(|t| {
                    buckets[bucket(&t.corners)] += 1;
                    if t.index & 0xffff == 0 {
                        progress.set(u64::from(t.index) / 2);
                    }
                })
                .map_err(lost)?;
            let mut left = size;
            above = buckets.len();
            while above > 0 && buckets[above - 1] <= left {
                above -= 1;
                left -= buckets[above];
            }
            (above, ties) = (above.saturating_sub(1), left);
        }
        let mut full = false;
        scene
            .for_each_triangle(|t| {
                let at = bucket(&t.corners);
                if at > above || (at == above && ties > 0) {
                    if at == above {
                        ties -= 1;
                    }
                    full |= survey.corners.push(t.corners).is_err();
                    full |= survey.material_of.push(t.material).is_err();
                }
                if t.index & 0xffff == 0 {
                    let half = if size < count { count / 2 } else { 0 };
                    progress.set(half + u64::from(t.index) / if half > 0 { 2 } else { 1 });
                }
            })
            .map_err(lost)?;
        progress.finish();
        if full {
            return Err(Failure::internal("the scene has more triangles than it said"));
        }
        Ok(survey)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_depend_on_the_scene_alone() {
        assert_eq!(size(12), 12);
        assert_eq!(size(ALWAYS + 1), ALWAYS);
        assert_eq!(size(257_000_000), 257_000_000 / ONE_OF);
        assert_eq!(size(1 << 32), AT_MOST);
    }

    #[test]
    fn the_largest_are_taken() {
        #[derive(clap::Parser)]
        struct Cli {
            #[command(flatten)]
            common: CommonArgs,
        }
        let common = <Cli as clap::Parser>::parse_from(["test"]).common;
        let dir = tempfile::tempdir().unwrap();
        let obj = dir.path().join("a.obj");
        // Sizes 1 to 40, shuffled, each twice.
        let sizes: Vec<u32> = (0..80).map(|i| i * 27 % 80 / 2 + 1).collect();
        let mut text = String::new();
        for (i, s) in sizes.iter().enumerate() {
            text += &format!("v {i} 0 0\nv {i} {s} 0\nv {i} 0 {s}\nf -3 -2 -1\n");
        }
        std::fs::write(&obj, text).unwrap();
        let scene = enf_scene::load(&obj, &enf_scene::LoadOptions::default()).unwrap();
        let budget = MemoryBudget::new(2 << 20);
        for size in [1, 2, 7, 33, 79, 80] {
            let survey = Survey::take(&scene, size, &common, &budget).unwrap();
            // Of two that are alike, the first; in global order.
            let mut by_size: Vec<(u32, usize)> =
                sizes.iter().enumerate().map(|(i, &s)| (s, i)).collect();
            by_size.sort_by_key(|&(s, i)| (std::cmp::Reverse(s), i));
            let mut want: Vec<usize> = by_size[..size as usize].iter().map(|&(_, i)| i).collect();
            want.sort_unstable();
            let got: Vec<usize> =
                survey.corners.iter().map(|t| (t[0][0] - scene.bounds.0[0]) as usize).collect();
            assert_eq!(got, want, "{size}");
        }
    }

    #[test]
    fn buckets_ascend_with_area() {
        let triangle = |s: f32| [[0.0; 3], [s, 0.0, 0.0], [0.0, s, 0.0]];
        let sizes = [1e-12, 1e-3, 0.01, 0.5, 1.0, 1.01, 3.0, 1e6];
        assert!(sizes.windows(2).all(|w| bucket(&triangle(w[0])) < bucket(&triangle(w[1]))));
        assert!(bucket(&triangle(1e15)) < 1 << 17);
    }
}
