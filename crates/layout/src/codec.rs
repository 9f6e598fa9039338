//! The lossless transform in front of zstd for section blobs: predict each word from the one a stride
//! before, then group bytes of equal significance ("byte planes"), where most of them are zero.

use crate::sections::{self, Malformed, SectionRecord, Transform};

fn transform_of(record: &SectionRecord) -> Result<Transform, Malformed> {
    [Transform::None, Transform::Delta, Transform::Xor]
        .into_iter()
        .find(|&t| t as u32 == record.transform)
        .ok_or_else(|| Malformed(format!("unknown section transform {}", record.transform)))
}

fn word(bytes: &[u8], i: usize) -> u32 {
    u32::from_le_bytes([bytes[4 * i], bytes[4 * i + 1], bytes[4 * i + 2], bytes[4 * i + 3]])
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
        let (n, stride) = (src.len() / 4, record.stride as usize);
        let mode = transform_of(&record)?;
        if mode == Transform::None || !src.len().is_multiple_of(4) {
            continue;
        }
        for i in 0..n {
            let value = word(src, i);
            let before = if i >= stride { word(src, i - stride) } else { 0 };
            let residue = match mode {
                Transform::Delta => {
                    let d = value.wrapping_sub(before) as i32;
                    ((d << 1) ^ (d >> 31)) as u32
                }
                _ => value ^ before,
            };
            for (plane, byte) in residue.to_le_bytes().into_iter().enumerate() {
                dst[plane * n + i] = byte;
            }
        }
    }
    Ok(())
}

/// Undoes [`forward`], in place, with `scratch` at least as long as the longest section.
pub fn inverse(blob: &mut [u8], scratch: &mut [u8]) -> Result<(), Malformed> {
    for record in sections::table(blob)? {
        let range = record.offset as usize..(record.offset + record.bytes) as usize;
        let section = &mut blob[range];
        let (n, stride) = (section.len() / 4, record.stride as usize);
        let mode = transform_of(&record)?;
        if mode == Transform::None || !section.len().is_multiple_of(4) {
            continue;
        }
        if stride == 0 {
            return Err(Malformed("a transformed section has stride 0".into()));
        }
        let planes = scratch
            .get_mut(..section.len())
            .ok_or_else(|| Malformed("transform scratch is too small".into()))?;
        planes.copy_from_slice(section);
        let (p0, rest) = planes.split_at(n);
        let (p1, rest) = rest.split_at(n);
        let (p2, p3) = rest.split_at(n);
        for i in 0..n {
            let residue = u32::from_le_bytes([p0[i], p1[i], p2[i], p3[i]]);
            let before = if i >= stride { word(section, i - stride) } else { 0 };
            let value = match mode {
                Transform::Delta => {
                    before.wrapping_add((residue >> 1) ^ (residue & 1).wrapping_neg())
                }
                _ => before ^ residue,
            };
            section[4 * i..4 * i + 4].copy_from_slice(&value.to_le_bytes());
        }
    }
    Ok(())
}

/// Bytes of scratch that [`inverse`] needs for this blob.
pub fn scratch_bytes(blob: &[u8]) -> Result<usize, Malformed> {
    Ok(sections::table(blob)?.iter().map(|r| r.bytes as usize).max().unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn inverse_undoes_forward(
            a in proptest::collection::vec(any::<u32>(), 0..200),
            b in proptest::collection::vec(any::<f32>(), 0..100),
            c in proptest::collection::vec(any::<u8>(), 0..50),
            stride in 1u32..4,
        ) {
            use zerocopy::IntoBytes;
            let blob = sections::build(&[
                (a.as_bytes(), Transform::Delta, stride),
                (b.as_bytes(), Transform::Xor, stride),
                (&c, Transform::None, 0),
            ]);
            let mut t = vec![0; blob.len()];
            forward(&blob, &mut t).unwrap();
            let mut scratch = vec![0; scratch_bytes(&t).unwrap()];
            inverse(&mut t, &mut scratch).unwrap();
            prop_assert_eq!(t, blob);
        }
    }
}
