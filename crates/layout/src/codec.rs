//! The lossless transform in front of zstd for section blobs: predict each word from the one a stride
//! before, then group bytes of equal significance ("byte planes"), where most of them are zero.

use crate::sections::{self, Malformed, SectionRecord, Transform};

fn transform_of(record: &SectionRecord) -> Result<Transform, Malformed> {
    [Transform::None, Transform::Delta, Transform::Xor, Transform::Planes]
        .into_iter()
        .find(|&t| t as u32 == record.transform)
        .ok_or_else(|| Malformed(format!("unknown section transform {}", record.transform)))
}

fn word(bytes: &[u8], i: usize) -> u32 {
    u32::from_le_bytes([bytes[4 * i], bytes[4 * i + 1], bytes[4 * i + 2], bytes[4 * i + 3]])
}

/// How a section is transformed.
enum Way {
    /// Not at all.
    Leave,
    /// Words, by their difference from the one so many before.
    Words { delta: bool, stride: usize },
    /// Records of so many bytes.
    Records { bytes: usize },
}

fn way_of(record: &SectionRecord) -> Result<Way, Malformed> {
    let transform = transform_of(record)?;
    let stride = record.stride as usize;
    if transform == Transform::None {
        return Ok(Way::Leave);
    }
    if stride == 0 {
        return Err(Malformed("a transformed section has stride 0".into()));
    }
    let (unit, way) = match transform {
        Transform::Planes => (4 * stride, Way::Records { bytes: 4 * stride }),
        _ => (4, Way::Words { delta: transform == Transform::Delta, stride }),
    };
    Ok(if record.bytes.is_multiple_of(unit as u64) { way } else { Way::Leave })
}

/// Transforms a blob into `out` (same length). The table stays as it is.
pub fn forward(blob: &[u8], out: &mut [u8]) -> Result<(), Malformed> {
    if out.len() != blob.len() {
        return Err(Malformed("transform buffer has another length than the blob".into()));
    }
    out.copy_from_slice(blob);
    for record in sections::table(blob)? {
        let range = record.offset as usize..(record.offset + record.bytes) as usize;
        let (src, dst) = (&blob[range.clone()], &mut out[range]);
        match way_of(&record)? {
            Way::Leave => {}
            Way::Words { delta, stride } => {
                let n = src.len() / 4;
                for i in 0..n {
                    let value = word(src, i);
                    let before = if i >= stride { word(src, i - stride) } else { 0 };
                    let residue = if delta {
                        let d = value.wrapping_sub(before) as i32;
                        ((d << 1) ^ (d >> 31)) as u32
                    } else {
                        value ^ before
                    };
                    for (plane, byte) in residue.to_le_bytes().into_iter().enumerate() {
                        dst[plane * n + i] = byte;
                    }
                }
            }
            Way::Records { bytes } => {
                let n = src.len() / bytes;
                for (i, record) in src.chunks_exact(bytes).enumerate() {
                    for (plane, &byte) in record.iter().enumerate() {
                        dst[plane * n + i] = byte;
                    }
                }
            }
        }
    }
    Ok(())
}

/// Undoes [`forward`], in place, with [`scratch_bytes`] of scratch.
pub fn inverse(blob: &mut [u8], scratch: &mut [u8]) -> Result<(), Malformed> {
    for record in sections::table(blob)? {
        let range = record.offset as usize..(record.offset + record.bytes) as usize;
        let section = &mut blob[range];
        let way = way_of(&record)?;
        if matches!(way, Way::Leave) {
            continue;
        }
        let too_small = || Malformed("transform scratch is too small".into());
        if let Way::Records { bytes } = way {
            from_records(scratch, section, bytes).ok_or_else(too_small)?;
            continue;
        }
        let planes = scratch.get_mut(..section.len()).ok_or_else(too_small)?;
        planes.copy_from_slice(section);
        match way {
            Way::Leave | Way::Records { .. } => {}
            Way::Words { delta: true, stride: 1 } => from_words::<1>(planes, section, undo_delta),
            Way::Words { delta: true, stride: 3 } => from_words::<3>(planes, section, undo_delta),
            Way::Words { delta: false, stride: 3 } => from_words::<3>(planes, section, undo_xor),
            Way::Words { delta: false, stride: 6 } => from_words::<6>(planes, section, undo_xor),
            Way::Words { delta, stride } => {
                let undo = if delta { undo_delta } else { undo_xor };
                let n = section.len() / 4;
                for i in 0..n {
                    let residue = [0, 1, 2, 3].map(|plane| planes[plane * n + i]);
                    let before = if i >= stride { word(section, i - stride) } else { 0 };
                    let value = undo(before, u32::from_le_bytes(residue));
                    section[4 * i..4 * i + 4].copy_from_slice(&value.to_le_bytes());
                }
            }
        }
    }
    Ok(())
}

#[inline(always)]
fn undo_delta(before: u32, residue: u32) -> u32 {
    before.wrapping_add((residue >> 1) ^ (residue & 1).wrapping_neg())
}

#[inline(always)]
fn undo_xor(before: u32, residue: u32) -> u32 {
    before ^ residue
}

/// Words from their planes, each from the one `STRIDE` before.
#[inline(always)]
fn from_words<const STRIDE: usize>(
    planes: &[u8],
    section: &mut [u8],
    undo: impl Fn(u32, u32) -> u32,
) {
    let n = section.len() / 4;
    let (low, high) = planes.split_at(2 * n);
    let (p0, p1) = low.split_at(n);
    let (p2, p3) = high.split_at(n);
    let mut before = [0; STRIDE];
    let words = section.as_chunks_mut::<4>().0;
    // Some words at a time: first their bytes are put together, many at once, then each is added to the one before.
    let mut residues = [0u32; WORDS_AT_ONCE];
    let most = WORDS_AT_ONCE - WORDS_AT_ONCE % STRIDE;
    let parts = words.chunks_mut(most).zip(p0.chunks(most).zip(p1.chunks(most)));
    for ((words, (a, b)), (c, d)) in parts.zip(p2.chunks(most).zip(p3.chunks(most))) {
        let residues = &mut residues[..words.len()];
        for ((residue, (&a, &b)), (&c, &d)) in
            residues.iter_mut().zip(a.iter().zip(b)).zip(c.iter().zip(d))
        {
            *residue = u32::from_le_bytes([a, b, c, d]);
        }
        for (words, residues) in words.chunks_mut(STRIDE).zip(residues.chunks(STRIDE)) {
            for ((word, before), &residue) in words.iter_mut().zip(&mut before).zip(residues) {
                *before = undo(*before, residue);
                *word = before.to_le_bytes();
            }
        }
    }
}

/// Words that are put together at a time, about.
const WORDS_AT_ONCE: usize = 768;

/// The planes of records that hold anything, and their places in the record.
fn planes_of(section: &[u8], bytes: usize) -> impl Iterator<Item = (usize, &[u8])> {
    let n = (section.len() / bytes).max(1);
    let any = |plane: &[u8]| plane.iter().fold(0, |any, &byte| any | byte) != 0;
    section.chunks_exact(n).enumerate().filter(move |(_, plane)| any(plane))
}

/// Records from their planes; `None` where scratch has no place for those that are not zero.
fn from_records(scratch: &mut [u8], section: &mut [u8], bytes: usize) -> Option<()> {
    let n = (section.len() / bytes).max(1);
    let mut places = Vec::new();
    for (place, plane) in planes_of(section, bytes) {
        scratch.get_mut(places.len() * n..)?.get_mut(..n)?.copy_from_slice(plane);
        places.push(place);
    }
    // A few records at a time, which stay in the cache until they are done.
    for (k, records) in section.chunks_mut(AT_ONCE * bytes).enumerate() {
        records.fill(0);
        for (&place, plane) in places.iter().zip(scratch.chunks_exact(n)) {
            let values = plane.iter().skip(k * AT_ONCE);
            for (record, &value) in records.chunks_exact_mut(bytes).zip(values) {
                record[place] = value;
            }
        }
    }
    Some(())
}

/// Records whose planes are put together at a time.
const AT_ONCE: usize = 64;

fn scratch_of(way: &Way, section: &[u8]) -> usize {
    match way {
        Way::Leave => 0,
        Way::Words { .. } => section.len(),
        Way::Records { bytes } => planes_of(section, *bytes).map(|(_, plane)| plane.len()).sum(),
    }
}

/// Bytes of scratch that [`inverse`] needs for this blob, which is what [`forward`] made.
pub fn scratch_bytes(blob: &[u8]) -> Result<usize, Malformed> {
    let mut most = 0;
    for record in sections::table(blob)? {
        let section = &blob[record.offset as usize..(record.offset + record.bytes) as usize];
        most = most.max(scratch_of(&way_of(&record)?, section));
    }
    Ok(most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn records_become_planes() {
        let records = [[1, 0, 0, 9], [2, 0, 0, 8], [3, 0, 0, 7]];
        let blob = sections::build(&[(records.as_flattened(), Transform::Planes, 1)]);
        let at = sections::table(&blob).unwrap()[0].offset as usize;
        let mut coded = vec![0; blob.len()];
        forward(&blob, &mut coded).unwrap();
        assert_eq!(coded[at..at + 12], [1, 2, 3, 0, 0, 0, 0, 0, 0, 9, 8, 7]);
        // Scratch is needed for what is not zero.
        assert_eq!(scratch_bytes(&coded).unwrap(), 6);
        assert!(inverse(&mut coded.clone(), &mut [0; 5]).is_err());
        inverse(&mut coded, &mut [0; 6]).unwrap();
        assert_eq!(coded, blob);
    }

    proptest! {
        #[test]
        fn inverse_undoes_forward(
            a in proptest::collection::vec(any::<u32>(), 0..200),
            b in proptest::collection::vec(any::<f32>(), 0..100),
            c in proptest::collection::vec(any::<u8>(), 0..50),
            stride in 1u32..4,
            wide in 3u32..8,
        ) {
            use zerocopy::IntoBytes;
            let blob = sections::build(&[
                (a.as_bytes(), Transform::Delta, stride),
                (b.as_bytes(), Transform::Xor, stride),
                (&c, Transform::None, 0),
                (&c, Transform::Planes, stride),
                (a.as_bytes(), Transform::Planes, stride),
                (b.as_bytes(), Transform::Xor, wide),
                (b.as_bytes(), Transform::Delta, wide),
            ]);
            let mut t = vec![0; blob.len()];
            forward(&blob, &mut t).unwrap();
            let mut scratch = vec![0; scratch_bytes(&t).unwrap()];
            inverse(&mut t, &mut scratch).unwrap();
            prop_assert_eq!(t, blob);
        }
    }
}
