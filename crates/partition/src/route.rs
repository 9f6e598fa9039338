//! All triangles of a scene past the partition, into the bins of the pieces that they touch.
//!
//! One thread places the instances, others find out where the triangles belong, this one fills the bins.

use crossbeam::channel::{Sender, bounded};
use enf_rooms::{Partition, Scratch};
use enf_scene::{Scene, SceneError};
use enf_stage::{CommonArgs, Failure, Progress, Result, interrupt};
use xxhash_rust::xxh3::xxh3_128;
use zerocopy::IntoBytes;

use crate::bins::{Filling, Record};
use crate::build::lost;

/// Triangles that travel together.
const BATCH: usize = 1024;
/// Neighbours in the file are neighbours in the room: so many begin their way down the tree together.
const NEAR: usize = 32;

/// What else is known when all triangles have passed.
pub(crate) struct Passed {
    /// Triangles of each room, each in the room of its centroid.
    pub(crate) owned: Vec<u64>,
    /// Sum of the triangles' hashes.
    pub(crate) digest: u128,
}

/// What a batch comes to: records by bin.
struct Routed {
    records: Vec<Record>,
    /// (bin, records), in the order of `records`.
    runs: Vec<(u32, u32)>,
    /// (room, triangles).
    owned: Vec<(u32, u32)>,
    digest: u128,
}

/// Bytes that are under way at most.
pub(crate) fn memory_bytes(threads: usize) -> u64 {
    // Batches in two queues and in hand; routed ones are up to twice as long.
    (6 * threads as u64 + 4) * 2 * (BATCH * size_of::<Record>()) as u64
}

/// Streams `scene`, then `extra`, through `partition` into `bins`. `material_hash` tells materials apart by what
/// they are.
///
/// # Errors
/// Exit 5 when the bins take no more; an interruption.
pub(crate) fn route(
    scene: &Scene,
    extra: &[Record],
    partition: &Partition,
    material_hash: &[u64],
    common: &CommonArgs,
    bins: &mut Filling,
) -> Result<Passed> {
    let threads = common.threads.max(1);
    let count = scene.triangle_count() + extra.len() as u64;
    let mut passed = Passed { owned: vec![0; partition.rooms().len()], digest: 0 };
    let progress = Progress::new(common, "sort", Some(count), "triangles");
    let (send_batch, batches) = bounded::<Vec<Record>>(2 * threads);
    let (send_routed, routed) = bounded::<Routed>(2 * threads);
    let mut seen = 0;
    std::thread::scope(|scope| {
        let producer = scope.spawn(|| produce(scene, extra, send_batch));
        for _ in 0..threads {
            let (batches, send_routed) = (batches.clone(), send_routed.clone());
            scope.spawn(move || {
                let mut scratch = Scratch::default();
                for batch in batches {
                    let done = route_batch(&batch, partition, material_hash, &mut scratch);
                    if send_routed.send(done).is_err() {
                        break;
                    }
                }
            });
        }
        drop((batches, send_routed));
        // Leaving drops the receiver, which stops the others.
        for done in routed {
            interrupt::check()?;
            let mut rest = &done.records[..];
            for &(bin, length) in &done.runs {
                let (run, after) = rest.split_at(length as usize);
                bins.push(bin, run)?;
                rest = after;
            }
            for &(room, n) in &done.owned {
                passed.owned[room as usize] += u64::from(n);
                seen += u64::from(n);
            }
            passed.digest = passed.digest.wrapping_add(done.digest);
            progress.set(seen);
        }
        producer.join().unwrap_or_else(|_| Err(Failure::internal("the reading thread failed")))
    })?;
    progress.finish();
    if seen != count {
        return Err(Failure::internal("some triangles were lost on their way to their rooms"));
    }
    Ok(passed)
}

/// Why the stream of triangles ended before its end.
enum Stopped {
    /// Nobody wants them any more; whoever has hung up knows why.
    Unwanted,
    /// The input cannot be read any more.
    Lost(SceneError),
}

impl From<SceneError> for Stopped {
    fn from(error: SceneError) -> Self {
        Self::Lost(error)
    }
}

/// Sends all triangles in batches until nobody wants them.
fn produce(scene: &Scene, extra: &[Record], send: Sender<Vec<Record>>) -> Result<()> {
    let mut batch = Vec::with_capacity(BATCH);
    let mut put = |record: Record| {
        batch.push(record);
        if batch.len() == BATCH {
            let full = std::mem::replace(&mut batch, Vec::with_capacity(BATCH));
            return send.send(full).map_err(|_| Stopped::Unwanted);
        }
        Ok(())
    };
    let mut streamed = scene.try_for_each_triangle(|t| {
        put(Record { corners: t.corners, index: t.index, material: t.material })
    });
    if streamed.is_ok() {
        streamed = extra.iter().try_for_each(|&record| put(record));
    }
    match streamed {
        Ok(()) => {
            let _ = send.send(batch);
            Ok(())
        }
        Err(Stopped::Unwanted) => Ok(()),
        Err(Stopped::Lost(error)) => Err(lost(error)),
    }
}

fn route_batch(
    batch: &[Record],
    partition: &Partition,
    material_hash: &[u64],
    scratch: &mut Scratch,
) -> Routed {
    let mut owned: Vec<(u32, u32)> = Vec::new();
    let mut digest = 0u128;
    // (bin, triangle of the batch)
    let mut places: Vec<(u32, u32)> = Vec::with_capacity(batch.len() + batch.len() / 4);
    for (k, near) in batch.chunks(NEAR).enumerate() {
        let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for corner in near.iter().flat_map(|r| &r.corners) {
            for axis in 0..3 {
                min[axis] = min[axis].min(corner[axis]);
                max[axis] = max[axis].max(corner[axis]);
            }
        }
        let start = partition.start(min, max);
        for (i, record) in near.iter().enumerate() {
            let at = (k * NEAR + i) as u32;
            partition.route(start, &record.corners, scratch, |bin| places.push((bin, at)));
            let room = partition.owner(start, &record.corners);
            match owned.last_mut() {
                Some(last) if last.0 == room => last.1 += 1,
                _ => owned.push((room, 1)),
            }
            let mut bytes = [0; 44];
            bytes[..36].copy_from_slice(record.corners.as_bytes());
            bytes[36..].copy_from_slice(&material_hash[record.material as usize].to_le_bytes());
            digest = digest.wrapping_add(xxh3_128(&bytes));
        }
    }
    places.sort_unstable();
    let mut runs: Vec<(u32, u32)> = Vec::new();
    let records = places
        .iter()
        .map(|&(bin, at)| {
            match runs.last_mut() {
                Some(last) if last.0 == bin => last.1 += 1,
                _ => runs.push((bin, 1)),
            }
            batch[at as usize]
        })
        .collect();
    Routed { records, runs, owned, digest }
}
