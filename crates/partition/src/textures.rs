//! Textures: pictures small enough to stay in memory, and where the tiles' triangles lie on them.

use enf_layout::NONE;
use enf_layout::sections::{self, Transform};
use enf_layout::segment::{Codec, ExtentKind};
use enf_layout::texture::TextureRecord;
use enf_scene::{Scene, SceneError, Texture};
use enf_stage::{CommonArgs, Failure, Result, interrupt, say};
use enf_store::{MemoryBudget, Reservation, ScratchFile, StageWriter, StoreDir, StoreError};
use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

use crate::bins::Record;
use crate::build::lost;

/// Bytes of a texel.
const TEXEL: u64 = 3;
/// Coordinates that are written and read together.
const BLOCK: usize = 1024;

/// How often both sides of each picture are halved until all of them have `limit` bytes: the largest first, so that small
/// ones stay sharp. It depends on the pictures and the limit alone.
fn halvings(textures: &[Texture], limit: u64) -> Vec<u32> {
    let mut halvings = vec![0u32; textures.len()];
    let mut sum: u64 = textures.iter().map(|t| t.texels(0)).sum();
    while sum * TEXEL > limit {
        let size = |i: usize| textures[i].texels(halvings[i]);
        // The first of the largest.
        let largest = (0..textures.len()).rev().max_by_key(|&i| size(i));
        let Some(largest) = largest.filter(|&i| size(i) > 1) else { break };
        sum -= size(largest);
        halvings[largest] += 1;
        sum += textures[largest].texels(halvings[largest]);
    }
    halvings
}

/// Reads all pictures, makes them small, and appends them.
///
/// # Errors
/// Exit 3 when a picture cannot be decoded within the budget, exit 4 when one is damaged, exit 5 from the disk.
pub(crate) fn write(
    scene: &Scene,
    limit: u64,
    common: &CommonArgs,
    budget: &MemoryBudget,
    writer: &mut StageWriter,
) -> Result<()> {
    let textures = &scene.textures;
    let halvings = halvings(textures, limit);
    let each = textures.iter().zip(&halvings).map(|(t, &h)| t.texels(h));
    let count: u64 = each.clone().sum();
    if count * TEXEL > limit.max(textures.len() as u64 * TEXEL) || count >= u64::from(NONE) {
        return Err(Failure::internal("textures do not become small enough"));
    }
    // All texels, and the largest picture once more.
    let bytes = (count + each.max().unwrap_or(0)) * TEXEL;
    let _texels = budget.reserve(bytes, "texels of all textures")?;
    let mut texels: Vec<[u8; 3]> = Vec::with_capacity(count as usize);
    let mut records = Vec::with_capacity(textures.len());
    for (texture, &halvings) in textures.iter().zip(&halvings) {
        interrupt::check()?;
        let work = budget.reserve(texture.decode_bytes(), "a picture while it is read");
        let _work = work.map_err(|e| {
            Failure::from(StoreError::from(e)).with_hint(format!(
                "make the picture {} smaller, or save it as a PNG that is not interlaced: that is read row by row",
                texture.name
            ))
        })?;
        let read = texture.decode(halvings).map_err(lost)?;
        if read.texels.len() as u64 != texture.texels(halvings) {
            return Err(Failure::input(format!(
                "the picture {} was changed while it was read",
                texture.name
            )));
        }
        records.push(TextureRecord {
            first_texel: texels.len() as u32,
            width: read.width,
            height: read.height,
            flags: texture.flags,
            place: texture.place,
            mean: read.mean,
            reserved: 0,
        });
        texels.extend_from_slice(&read.texels);
    }
    let smaller = halvings.iter().filter(|&&h| h > 0).count();
    if smaller > 0 {
        say(
            common,
            format!(
                "{smaller} of {} textures were made smaller for --texture-memory {}K",
                textures.len(),
                limit >> 10
            ),
        );
    }
    let (n, m) = (records.len() as u64, texels.len() as u64);
    writer.append(ExtentKind::Textures, 0, n, records.as_bytes(), Codec::Zstd)?;
    writer.append(ExtentKind::Texels, 0, m, texels.as_bytes(), Codec::Zstd)?;
    Ok(())
}

/// Texture coordinates of one triangle of the scene.
#[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
struct Placed {
    index: u32,
    corners: [[f32; 2]; 3],
}

/// Texture coordinates of all triangles that have some, on disk, to be looked up by tiles.
pub(crate) struct Coordinates {
    file: ScratchFile,
    /// First index of each block, and where it lies.
    blocks: Vec<(u32, u64)>,
    count: u64,
    _reserved: Reservation,
}

impl Coordinates {
    /// Bytes of a tile's coordinates, in a store and in memory, for each triangle that has some.
    pub(crate) const BYTES: u64 = 28;

    /// Collects them in a pass over the scene; `None` if there are none.
    ///
    /// # Errors
    /// Exit 3 without memory, exit 5 without a place for the scratch file.
    pub(crate) fn collect(
        scene: &Scene,
        store: &StoreDir,
        budget: &MemoryBudget,
    ) -> Result<Option<Self>> {
        if scene.textures.is_empty() {
            return Ok(None);
        }
        let most = scene.triangle_count().div_ceil(BLOCK as u64) * 16;
        let needs = most + ScratchFile::MEMORY_BYTES + (BLOCK * size_of::<Placed>()) as u64;
        let reserved = budget.reserve(needs, "texture coordinates")?;
        let mut all = Self {
            file: ScratchFile::new(store)?,
            blocks: Vec::new(),
            count: 0,
            _reserved: reserved,
        };
        let mut block: Vec<Placed> = Vec::with_capacity(BLOCK);
        let mut seen = 0u32;
        let streamed = scene.try_for_each_triangle(|t| {
            seen = seen.wrapping_add(1);
            if seen.is_multiple_of(1 << 20) {
                interrupt::check().map_err(Stopped::Failed)?;
            }
            let Some(corners) = t.coordinates else { return Ok(()) };
            block.push(Placed { index: t.index, corners });
            if block.len() == BLOCK {
                all.put(&block).map_err(Stopped::Failed)?;
                block.clear();
            }
            Ok(())
        });
        match streamed {
            Ok(()) => all.put(&block)?,
            Err(Stopped::Failed(failure)) => return Err(failure),
            Err(Stopped::Lost(error)) => return Err(lost(error)),
        }
        all.file.flush()?;
        Ok((all.count > 0).then_some(all))
    }

    fn put(&mut self, block: &[Placed]) -> Result<()> {
        if let Some(first) = block.first() {
            let at = self.file.append(&[block.as_bytes()])?;
            self.blocks.push((first.index, at));
            self.count += block.len() as u64;
        }
        Ok(())
    }

    /// The blob of a tile: the coordinates of those of its triangles (ascending) that have some; `None` if there are none.
    ///
    /// # Errors
    /// Exit 5 when the scratch file cannot be read.
    pub(crate) fn blob(&self, records: &[Record]) -> Result<Option<(u64, Vec<u8>)>> {
        let mut indices: Vec<u32> = Vec::new();
        let mut corners: Vec<[[f32; 2]; 3]> = Vec::new();
        let mut block: Vec<Placed> = Vec::new();
        let mut here = usize::MAX;
        for record in records {
            let Some(at) = self.blocks.partition_point(|b| b.0 <= record.index).checked_sub(1)
            else {
                continue;
            };
            if at != here {
                here = at;
                let left = self.count - at as u64 * BLOCK as u64;
                block.resize(left.min(BLOCK as u64) as usize, Placed::new_zeroed());
                self.file.read(self.blocks[at].1, block.as_mut_slice().as_mut_bytes())?;
            }
            if let Ok(i) = block.binary_search_by_key(&record.index, |p| p.index) {
                indices.push(record.index);
                corners.push(block[i].corners);
            }
        }
        if indices.is_empty() {
            return Ok(None);
        }
        let blob = sections::build(&[
            (indices.as_bytes(), Transform::Delta, 1),
            (corners.as_bytes(), Transform::Xor, 6),
        ]);
        Ok(Some((indices.len() as u64, blob)))
    }
}

/// Why the stream of triangles ended before its end.
enum Stopped {
    Failed(Failure),
    Lost(SceneError),
}

impl From<SceneError> for Stopped {
    fn from(error: SceneError) -> Self {
        Self::Lost(error)
    }
}
