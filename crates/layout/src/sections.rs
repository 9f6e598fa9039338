//! Blobs of several arrays: a table of sections, then the arrays, each 64-byte aligned.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// First word of a blob.
pub const SECTIONS_MAGIC: u32 = u32::from_le_bytes(*b"SECT");

/// Head of a blob.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct SectionsHeader {
    /// [`SECTIONS_MAGIC`].
    pub magic: u32,
    /// Number of sections that follow.
    pub count: u32,
}

/// How [`crate::codec`] may transform a section before it is compressed. The discriminant is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Transform {
    /// Bytes as they are.
    None = 0,
    /// `u32` words: difference from the word `stride` words before, zigzag, byte planes.
    Delta = 1,
    /// `u32` words (floats): exclusive or with the word `stride` words before, byte planes.
    Xor = 2,
    /// Records of `stride` words: the first bytes of all records, then the second ones, and so on.
    Planes = 3,
}

/// Place of one section.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct SectionRecord {
    /// First byte, from the blob's start; a multiple of 64.
    pub offset: u64,
    /// Bytes.
    pub bytes: u64,
    /// [`Transform`].
    pub transform: u32,
    /// Words between a word and its predictor, or words of a record.
    pub stride: u32,
}
const _: () = assert!(size_of::<SectionRecord>() == 24);

/// A malformed blob; the text says what is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Malformed(pub String);

impl std::fmt::Display for Malformed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for Malformed {}

fn aligned(bytes: usize) -> usize {
    bytes.next_multiple_of(64)
}

/// Bytes of a blob whose sections have these lengths.
pub fn blob_bytes(lengths: &[usize]) -> usize {
    let table = size_of::<SectionsHeader>() + lengths.len() * size_of::<SectionRecord>();
    lengths.iter().fold(aligned(table), |at, &l| aligned(at + l))
}

/// Writes the head of a blob and returns where each section goes. `out` must be zeroed and
/// [`blob_bytes`] long.
pub fn write_table(
    out: &mut [u8],
    sections: &[(usize, Transform, u32)],
) -> Vec<std::ops::Range<usize>> {
    let header = SectionsHeader { magic: SECTIONS_MAGIC, count: sections.len() as u32 };
    out[..8].copy_from_slice(header.as_bytes());
    let mut at = aligned(8 + sections.len() * size_of::<SectionRecord>());
    let mut ranges = Vec::with_capacity(sections.len());
    for (i, &(bytes, transform, stride)) in sections.iter().enumerate() {
        let record = SectionRecord {
            offset: at as u64,
            bytes: bytes as u64,
            transform: transform as u32,
            stride,
        };
        out[8 + i * 24..][..24].copy_from_slice(record.as_bytes());
        ranges.push(at..at + bytes);
        at = aligned(at + bytes);
    }
    ranges
}

/// Builds a blob from byte slices.
pub fn build(sections: &[(&[u8], Transform, u32)]) -> Vec<u8> {
    let lengths: Vec<usize> = sections.iter().map(|s| s.0.len()).collect();
    let mut out = vec![0; blob_bytes(&lengths)];
    let table: Vec<_> = sections.iter().map(|s| (s.0.len(), s.1, s.2)).collect();
    for (range, section) in write_table(&mut out, &table).into_iter().zip(sections) {
        out[range].copy_from_slice(section.0);
    }
    out
}

/// The section table of a blob, every bound checked.
pub fn table(blob: &[u8]) -> Result<Vec<SectionRecord>, Malformed> {
    let (header, rest) = SectionsHeader::read_from_prefix(blob)
        .map_err(|_| Malformed("section table is cut short".into()))?;
    if header.magic != SECTIONS_MAGIC {
        return Err(Malformed("section table has a wrong magic number".into()));
    }
    let count = header.count as usize;
    if count > 64 || rest.len() < count * size_of::<SectionRecord>() {
        return Err(Malformed(format!("section table claims {count} sections")));
    }
    let mut records = Vec::with_capacity(count);
    for chunk in rest.chunks_exact(size_of::<SectionRecord>()).take(count) {
        let record = SectionRecord::read_from_bytes(chunk)
            .map_err(|_| Malformed("section table is cut short".into()))?;
        let end = record.offset.checked_add(record.bytes);
        if record.offset % 64 != 0 || end.is_none_or(|e| e > blob.len() as u64) {
            return Err(Malformed(format!(
                "section at {} with {} bytes lies outside a blob of {} bytes",
                record.offset,
                record.bytes,
                blob.len()
            )));
        }
        records.push(record);
    }
    Ok(records)
}

/// A section as a typed slice.
pub fn section<T: FromBytes + Immutable + KnownLayout>(
    blob: &[u8],
    index: usize,
) -> Result<&[T], Malformed> {
    let table = table(blob)?;
    let record = table
        .get(index)
        .ok_or_else(|| Malformed(format!("section {index} of {} is missing", table.len())))?;
    let bytes = &blob[record.offset as usize..(record.offset + record.bytes) as usize];
    <[T]>::ref_from_bytes(bytes).map_err(|_| {
        Malformed(format!("section {index} has {} bytes, no whole number of records", bytes.len()))
    })
}

/// All sections of a blob that has `N`, which lie one after the other, to be changed.
pub fn split_mut<const N: usize>(blob: &mut [u8]) -> Result<[&mut [u8]; N], Malformed> {
    let table = table(blob)?;
    if table.len() != N {
        return Err(Malformed(format!("blob has {} sections, not {N}", table.len())));
    }
    let mut parts: [&mut [u8]; N] = std::array::from_fn(|_| Default::default());
    let (mut rest, mut at) = (blob, 0);
    for (i, (part, record)) in parts.iter_mut().zip(&table).enumerate() {
        if record.offset < at {
            return Err(Malformed(format!("section {i} begins within the one before")));
        }
        let (before, after) = rest.split_at_mut((record.offset - at) as usize);
        let _ = before;
        let (mine, after) = after.split_at_mut(record.bytes as usize);
        (*part, rest, at) = (mine, after, record.offset + record.bytes);
    }
    Ok(parts)
}
