//! Bytes: the buffers of a glTF file, read block by block, and what their components mean.

use crate::{SceneError, texture::Source};
use std::{fs::File, os::unix::fs::FileExt, path::PathBuf};

/// Bytes of a buffer that are read in one go, about.
const BLOCK: u64 = 256 << 10;

/// Bytes of a buffer: part of a file, or decoded from a data URI.
pub(super) enum Buffer {
    File { file: File, path: PathBuf, start: u64, len: u64 },
    Memory(Vec<u8>),
}

impl Buffer {
    pub(super) fn len(&self) -> u64 {
        match self {
            Self::File { len, .. } => *len,
            Self::Memory(bytes) => bytes.len() as u64,
        }
    }

    /// Where a run of its bytes is, for a picture; `of` is the glTF file.
    pub(super) fn source(&self, of: &std::path::Path, at: u64, len: u64) -> Option<Source> {
        if at.checked_add(len).is_none_or(|end| end > self.len()) {
            return None;
        }
        Some(match self {
            Self::File { path, start, .. } => {
                Source::File { path: path.clone(), start: start + at, len: Some(len) }
            }
            Self::Memory(bytes) => Source::Memory {
                path: of.into(),
                bytes: bytes[at as usize..(at + len) as usize].to_vec(),
            },
        })
    }

    /// Reads what was checked to be there.
    fn read(&self, at: u64, out: &mut [u8]) -> Result<(), SceneError> {
        match self {
            Self::File { file, path, start, .. } => {
                file.read_exact_at(out, start + at).map_err(|e| SceneError::read(path, e))
            }
            Self::Memory(bytes) => {
                out.copy_from_slice(&bytes[at as usize..at as usize + out.len()]);
                Ok(())
            }
        }
    }
}

/// Number of bytes of a component (5.1.3), and what its integers are divided by when normalised (3.11).
pub(super) fn component(kind: u32) -> Option<(u64, f64)> {
    Some(match kind {
        5120 => (1, 127.0),
        5121 => (1, 255.0),
        5122 => (2, 32767.0),
        5123 => (2, 65535.0),
        5125 => (4, 4294967295.0),
        5126 => (4, 1.0),
        _ => return None,
    })
}

/// A component's value.
pub(super) fn value(kind: u32, bytes: &[u8]) -> f64 {
    let two = || [bytes[0], bytes[1]];
    let four = || [bytes[0], bytes[1], bytes[2], bytes[3]];
    match kind {
        5120 => f64::from(bytes[0] as i8),
        5121 => f64::from(bytes[0]),
        5122 => f64::from(i16::from_le_bytes(two())),
        5123 => f64::from(u16::from_le_bytes(two())),
        5125 => f64::from(u32::from_le_bytes(four())),
        _ => f64::from(f32::from_le_bytes(four())),
    }
}

/// A run of equal items in a buffer, known to lie in it.
pub(super) struct Items<'a> {
    pub(super) buffer: &'a Buffer,
    pub(super) at: u64,
    pub(super) stride: u64,
    pub(super) size: u64,
    pub(super) count: u64,
}

impl Items<'_> {
    /// Calls `f` with the bytes of each item.
    pub(super) fn each(
        &self,
        mut f: impl FnMut(&[u8]) -> Result<(), SceneError>,
    ) -> Result<(), SceneError> {
        let per_block = (BLOCK / self.stride).max(1);
        let mut block = Vec::new();
        let mut done = 0;
        while done < self.count {
            let n = per_block.min(self.count - done);
            // The last item of a view need not be followed by its padding.
            block.resize(((n - 1) * self.stride + self.size) as usize, 0);
            self.buffer.read(self.at + done * self.stride, &mut block)?;
            for i in 0..n {
                let at = (i * self.stride) as usize;
                f(&block[at..at + self.size as usize])?;
            }
            done += n;
        }
        Ok(())
    }
}

/// `%20` and the like undone.
pub(super) fn unescaped(uri: &str) -> String {
    let bytes = uri.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut i = 0;
    while i < bytes.len() {
        let hex = bytes.get(i + 1..i + 3).and_then(|h| std::str::from_utf8(h).ok());
        match hex.and_then(|h| u8::from_str_radix(h, 16).ok()) {
            Some(byte) if bytes[i] == b'%' => {
                out.push(byte);
                i += 3;
            }
            _ => {
                out.push(bytes[i]);
                i += 1;
            }
        }
    }
    String::from_utf8_lossy(&out).into_owned()
}

/// Base64 (RFC 4648, section 4); blanks and the padding are optional.
pub(super) fn base64(text: &str) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(text.len() / 4 * 3);
    let (mut bits, mut n) = (0u32, 0);
    for b in text.bytes() {
        let six = match b {
            b'A'..=b'Z' => b - b'A',
            b'a'..=b'z' => b - b'a' + 26,
            b'0'..=b'9' => b - b'0' + 52,
            b'+' | b'-' => 62,
            b'/' | b'_' => 63,
            b'=' | b'\r' | b'\n' | b' ' | b'\t' => continue,
            _ => return None,
        };
        bits = bits << 6 | u32::from(six);
        n += 6;
        if n >= 8 {
            n -= 8;
            out.push((bits >> n) as u8);
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_decoded() {
        assert_eq!(base64("aGVsbG8=").unwrap(), b"hello");
        assert_eq!(base64("aGVs\nbG8").unwrap(), b"hello");
        assert!(base64("a*b").is_none());
        assert_eq!(unescaped("a%20b%2Fc%"), "a b/c%");
    }
}
