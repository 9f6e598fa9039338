//! Writes the tiles' meshes: workers encode, this thread appends in order, so that the file's bytes do not
//! depend on the number of threads.

use enf_geometry::TileMesh;
use enf_layout::segment::{Codec, ExtentKind};
use enf_rooms::Tables;
use enf_stage::ordered::{Continue, ordered};
use enf_stage::{CommonArgs, Progress, Result, interrupt};
use enf_store::{MemoryBudget, StageWriter, encode};

use crate::World;

/// Peak bytes per triangle while a tile is built and encoded: blob, vertex table, transform and frame.
const ENCODE_BYTES_PER_TRIANGLE: u64 = 110;

/// Encodes and appends every tile; returns the number of stored triangles.
pub(crate) fn write(
    writer: &mut StageWriter,
    budget: &MemoryBudget,
    common: &CommonArgs,
    world: &World,
    tables: &mut Tables,
) -> Result<u64> {
    let tiles = tables.tiles.len();
    let largest = tables.tile_offsets.windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0)
        * ENCODE_BYTES_PER_TRIANGLE;
    let threads =
        common.threads.min((budget.available() / largest.max(1)) as usize).clamp(1, tiles.max(1));
    let _work = budget.reserve(largest * threads as u64, "tiles being encoded")?;
    let progress = Progress::new(common, "tiles", Some(tiles as u64), "tiles");
    let (offsets, lists) = (&tables.tile_offsets, &tables.tile_triangles);
    let mut sizes = Vec::with_capacity(tiles);
    ordered(
        threads,
        tiles,
        |_, tile| {
            let list = &lists[offsets[tile] as usize..offsets[tile + 1] as usize];
            let blob = TileMesh::build_blob(
                list.iter().map(|&g| (g, world.material_of[g as usize], world.corners[g as usize])),
            );
            Ok((blob.len() as u64, encode(&blob, Codec::ZstdPlanes)?))
        },
        |tile, (bytes, encoded)| {
            interrupt::check()?;
            let count = offsets[tile + 1] - offsets[tile];
            writer.append_encoded(ExtentKind::Geometry, tile as u32, count, &encoded)?;
            sizes.push((count, bytes));
            progress.set(sizes.len() as u64);
            Ok(Continue::Yes)
        },
    )?;
    progress.finish();
    let mut stored = 0;
    for (record, (count, bytes)) in tables.tiles.iter_mut().zip(sizes) {
        record.triangles = count;
        record.mesh_bytes = bytes;
        stored += count;
    }
    Ok(stored)
}
