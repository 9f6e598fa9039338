//! From bins to tiles: big pieces are cut, then every tile's mesh is encoded and appended. Workers encode,
//! this thread appends in order, so that the file's bytes do not depend on the number of threads.

use enf_geometry::TileMesh;
use enf_layout::segment::{Codec, ExtentKind};
use enf_rooms::{Partition, Piece, Scratch};
use enf_stage::ordered::{Continue, ordered};
use enf_stage::{CommonArgs, Progress, Result, interrupt};
use enf_store::{MemoryBudget, StageWriter, StoreDir, encode};

use crate::bins::{Bins, Filling, Record};
use crate::textures::Coordinates;

/// Peak bytes per triangle while a tile is built and encoded: records, blob, vertex table, transform and frame.
const ENCODE_BYTES_PER_TRIANGLE: u64 = 110 + size_of::<Record>() as u64;
/// A sample of so many triangles tells where to cut a piece.
const SAMPLE: u64 = 1 << 16;
/// Cuts by a sample leave this much of the limit free: what it does not show is below that, nearly always.
const SAFE: f64 = 0.9;

/// All pieces, each with the bins that hold its triangles: first those that all triangles were sorted
/// to, then those of the pieces that were cut, and cut again.
pub(crate) struct Sorted {
    bins: Vec<Bins>,
    /// Piece and which of the bins it is in; a room's pieces one after the other.
    pieces: Vec<(Piece, usize)>,
}

impl Sorted {
    /// Pieces as they are, with all triangles in `bins`.
    pub(crate) fn new(partition: &Partition, bins: Bins) -> Self {
        let pieces = partition.pieces().into_iter().map(|p| (p, 0)).collect();
        Self { bins: vec![bins], pieces }
    }

    /// Numbers of the pieces, in the order of their tiles.
    pub(crate) fn order(&self) -> Vec<u32> {
        self.pieces.iter().map(|p| p.0.number()).collect()
    }

    /// Cuts pieces until none has more than `limit` triangles, as far as cutting helps.
    ///
    /// # Errors
    /// Exit 3 or 5 when the bins of the parts cannot be made or filled.
    pub(crate) fn cut(
        &mut self,
        partition: &mut Partition,
        store: &StoreDir,
        budget: &MemoryBudget,
        limit: u64,
    ) -> Result<()> {
        let mut hopeless = vec![false; self.pieces.len()];
        loop {
            let at = self.bins.len();
            let big = |s: &Self, i: usize| {
                let (piece, home) = &s.pieces[i];
                s.bins[*home].count(piece.number()) > limit
            };
            if !(0..self.pieces.len()).any(|i| !hopeless[i] && big(self, i)) {
                return Ok(());
            }
            // The sample, and a block of records for each of the two passes.
            let block = self.bins.iter().map(Bins::read_bytes).max().unwrap_or(0);
            let _sample = budget.reserve(SAMPLE * 3 * 36 + block, "a sample of a large room")?;
            // The tree first: it says how many parts there are.
            let mut pieces = Vec::with_capacity(self.pieces.len());
            let mut stays = Vec::with_capacity(self.pieces.len());
            // (piece that was cut, where it lies, its parts)
            let mut cuts: Vec<(u32, usize, Vec<u32>)> = Vec::new();
            let mut most = 0;
            for (i, (piece, home)) in std::mem::take(&mut self.pieces).into_iter().enumerate() {
                let (number, bins) = (piece.number(), &self.bins[home]);
                let count = bins.count(number);
                if hopeless[i] || count <= limit {
                    pieces.push((piece, home));
                    stays.push(hopeless[i]);
                    continue;
                }
                interrupt::check()?;
                let (sample, weight) = sample(bins, number)?;
                let goal = if weight > 1.0 { (limit as f64 * SAFE) as u64 } else { limit };
                let parts = partition.cut_piece(piece, &sample, weight, goal.max(1));
                if parts.len() == 1 {
                    pieces.extend(parts.into_iter().map(|p| (p, home)));
                    stays.push(true);
                    continue;
                }
                cuts.push((number, home, parts.iter().map(Piece::number).collect()));
                most = parts.iter().map(|p| p.number() as usize + 1).fold(most, usize::max);
                stays.extend(parts.iter().map(|_| false));
                pieces.extend(parts.into_iter().map(|p| (p, at)));
            }
            let mut part_of = vec![usize::MAX; most];
            for (k, cut) in cuts.iter().enumerate() {
                for &part in &cut.2 {
                    part_of[part as usize] = k;
                }
            }
            let mut filling = Filling::new(store, budget, most)?;
            let mut scratch = Scratch::default();
            for (k, (number, home, _)) in cuts.into_iter().enumerate() {
                interrupt::check()?;
                self.bins[home].read(number, |records| {
                    for record in records {
                        let start = start(partition, record);
                        let mut refused = Ok(());
                        partition.route(start, &record.corners, &mut scratch, |n| {
                            if part_of.get(n as usize) == Some(&k) && refused.is_ok() {
                                refused = filling.push(n, &[*record]);
                            }
                        });
                        refused?;
                    }
                    Ok(())
                })?;
            }
            self.bins.push(filling.full()?);
            self.pieces = pieces;
            hopeless = stays;
        }
    }

    /// Encodes and appends every tile. `tile(triangles, blob bytes, bytes of texture coordinates, lights)` is told in the
    /// order of the tiles; `lights_of` appends the lights of a triangle.
    ///
    /// # Errors
    /// Exit 3 when the largest tile cannot be encoded within the budget, exit 5 from the disk.
    pub(crate) fn write(
        &self,
        writer: &mut StageWriter,
        budget: &MemoryBudget,
        common: &CommonArgs,
        lights_of: &(dyn Fn(&Record, &mut Vec<u32>) + Sync),
        coordinates: Option<&Coordinates>,
        mut tile: impl FnMut(u64, u64, u64, Vec<u32>),
    ) -> Result<()> {
        let count = |i: usize| self.bins[self.pieces[i].1].count(self.pieces[i].0.number());
        let tiles = self.pieces.len();
        let reading = self.bins.iter().map(Bins::read_bytes).max().unwrap_or(0);
        // Coordinates are collected, put together, transformed and compressed.
        let per_triangle = ENCODE_BYTES_PER_TRIANGLE
            + if coordinates.is_some() { 4 * Coordinates::BYTES } else { 0 };
        let largest = (0..tiles).map(count).max().unwrap_or(0) * per_triangle + reading;
        let threads = common
            .threads
            .min((budget.available() / largest.max(1)) as usize)
            .clamp(1, tiles.max(1));
        let _work = budget.reserve(largest * threads as u64, "tiles being encoded")?;
        let progress = Progress::new(common, "tiles", Some(tiles as u64), "tiles");
        ordered(
            threads,
            tiles,
            |_, i| {
                let (piece, home) = &self.pieces[i];
                let mut records: Vec<Record> = Vec::with_capacity(count(i) as usize);
                self.bins[*home].read(piece.number(), |block| {
                    records.extend_from_slice(block);
                    Ok(())
                })?;
                records.sort_unstable_by_key(|r| r.index);
                let mut lights = Vec::new();
                for record in &records {
                    lights_of(record, &mut lights);
                }
                let blob =
                    TileMesh::build_blob(records.iter().map(|r| (r.index, r.material, r.corners)));
                let triangles = records.len() as u64;
                let (bytes, encoded) = (blob.len() as u64, encode(&blob, Codec::ZstdPlanes)?);
                drop(blob);
                let textured = match coordinates.map(|c| c.blob(&records)).transpose()?.flatten() {
                    Some((count, blob)) => Some((count, encode(&blob, Codec::ZstdPlanes)?)),
                    None => None,
                };
                Ok((triangles, bytes, lights, encoded, textured))
            },
            |i, (triangles, bytes, lights, encoded, textured)| {
                interrupt::check()?;
                let id = i as u32;
                writer.append_encoded(ExtentKind::Geometry, id, triangles, &encoded)?;
                let mut more = 0;
                if let Some((count, encoded)) = textured {
                    more = encoded.raw_bytes();
                    writer.append_encoded(ExtentKind::Coordinates, id, count, &encoded)?;
                }
                tile(triangles, bytes, more, lights);
                progress.set(i as u64 + 1);
                Ok(Continue::Yes)
            },
        )?;
        progress.finish();
        Ok(())
    }
}

fn start(partition: &Partition, record: &Record) -> enf_rooms::Start {
    let [a, b, c] = record.corners;
    let fold = |f: fn(f32, f32) -> f32| [0, 1, 2].map(|k| f(f(a[k], b[k]), c[k]));
    partition.start(fold(f32::min), fold(f32::max))
}

/// Evenly drawn triangles of a piece, and how many each stands for.
fn sample(bins: &Bins, number: u32) -> Result<(Vec<[[f32; 3]; 3]>, f64)> {
    let count = bins.count(number);
    let one_of = count.div_ceil(SAMPLE);
    let mut sample = Vec::new();
    bins.read(number, |records| {
        let drawn = records
            .iter()
            // A stride would follow the files' own rhythm; Knuth's multiplicative hash does not.
            .filter(|r| u64::from(r.index.wrapping_mul(2_654_435_769) >> 4) % one_of == 0)
            .map(|r| r.corners);
        sample.extend(drawn.take((2 * SAMPLE) as usize));
        Ok(())
    })?;
    let weight = if one_of == 1 { 1.0 } else { count as f64 / sample.len().max(1) as f64 };
    Ok((sample, weight))
}
