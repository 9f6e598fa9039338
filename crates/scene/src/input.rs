//! Files, line by line: plain or zstd, hashed while they are read, never held whole.

use crate::{InputFile, SceneError};
use std::{
    fs::File,
    io::{self, BufReader, Read},
    ops::Range,
    path::{Path, PathBuf},
};
use xxhash_rust::xxh3::Xxh3;

/// Longest line that is still taken for text, bytes.
const LINE_LIMIT: usize = 64 << 20;
/// Read at a time, bytes.
const BLOCK: usize = 256 << 10;

/// A reader that hashes what passes through it.
struct Hashing {
    file: File,
    hash: Box<Xxh3>,
}

impl Read for Hashing {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let n = self.file.read(out)?;
        self.hash.update(&out[..n]);
        Ok(n)
    }
}

enum Bytes {
    Plain(Hashing),
    Zstd(Box<zstd::stream::read::Decoder<'static, BufReader<Hashing>>>),
}

/// Lines of a file, as slices of the block that was read last: nothing is copied but lines that a block
/// ends in, and those that a backslash continues.
pub(crate) struct Lines {
    path: PathBuf,
    bytes: Bytes,
    /// Physical lines so far.
    line: usize,
    /// Physical lines that the last logical one spans.
    span: usize,
    block: Vec<u8>,
    /// What of the block is still to come.
    rest: Range<usize>,
    /// No more bytes behind the block.
    ended: bool,
    /// The current line in the block, unless it is in `joined`.
    current: Range<usize>,
    joined: Vec<u8>,
    is_joined: bool,
}

/// True for `X.zst`.
pub(crate) fn is_zstd(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("zst"))
}

impl Lines {
    pub(crate) fn open(path: &Path) -> Result<Self, SceneError> {
        let fail = |e| SceneError::read(path, e);
        let file = File::open(path).map_err(fail)?;
        let hashing = Hashing { file, hash: Box::new(Xxh3::new()) };
        let bytes = if is_zstd(path) {
            let packed = BufReader::with_capacity(BLOCK, hashing);
            let decoder = zstd::stream::read::Decoder::with_buffer(packed).map_err(fail)?;
            Bytes::Zstd(Box::new(decoder))
        } else {
            Bytes::Plain(hashing)
        };
        Ok(Self {
            path: path.into(),
            bytes,
            line: 0,
            span: 0,
            block: vec![0; BLOCK],
            rest: 0..0,
            ended: false,
            current: 0..0,
            joined: Vec::new(),
            is_joined: false,
        })
    }

    /// Number of the first physical line of the current logical one, from 1.
    pub(crate) fn number(&self) -> usize {
        self.line + 1 - self.span
    }

    /// An error at the current line.
    pub(crate) fn error(&self, what: impl Into<String>, remedy: impl Into<String>) -> SceneError {
        SceneError::line(&self.path, self.number(), what, remedy)
    }

    /// Brings more bytes behind `rest`, which moves to the front of the block.
    fn fill(&mut self) -> Result<(), SceneError> {
        self.block.copy_within(self.rest.clone(), 0);
        self.rest = 0..self.rest.len();
        if self.rest.end == self.block.len() {
            if self.rest.end >= LINE_LIMIT {
                self.line += 1;
                self.span += 1;
                return Err(self.error(
                    "a line of more than 64 MiB",
                    "this is no text file: give an OBJ, MTL or scene file",
                ));
            }
            self.block.resize(2 * self.block.len(), 0);
        }
        let out = &mut self.block[self.rest.end..];
        let read = loop {
            let read = match &mut self.bytes {
                Bytes::Plain(r) => r.read(out),
                Bytes::Zstd(r) => r.read(out),
            };
            match read {
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                other => break other,
            }
        };
        let n = read.map_err(|source| SceneError::Read {
            file: self.path.clone(),
            remedy: if is_zstd(&self.path) {
                format!(
                    "the file is damaged or no zstd file (after line {}): fetch or compress it again",
                    self.line
                )
            } else {
                "check the file and the disk".into()
            },
            source,
        })?;
        self.ended = n == 0;
        self.rest.end += n;
        Ok(())
    }

    /// Makes the next physical line current; false at the end.
    fn physical(&mut self) -> Result<bool, SceneError> {
        let mut searched = 0;
        let end = loop {
            let unread = &self.block[self.rest.clone()];
            if let Some(at) = memchr::memchr(b'\n', &unread[searched..]) {
                break searched + at + 1;
            }
            if self.ended {
                if unread.is_empty() {
                    return Ok(false);
                }
                break unread.len();
            }
            searched = unread.len();
            self.fill()?;
        };
        let (start, mut stop) = (self.rest.start, self.rest.start + end);
        self.rest.start = stop;
        while stop > start && matches!(self.block[stop - 1], b'\n' | b'\r') {
            stop -= 1;
        }
        self.current = start..stop;
        self.line += 1;
        self.span += 1;
        Ok(true)
    }

    /// The next line without its end; lines that end in a backslash are joined with the next one.
    pub(crate) fn advance(&mut self) -> Result<bool, SceneError> {
        self.span = 0;
        self.is_joined = false;
        if !self.physical()? {
            self.span = usize::from(self.line > 0);
            self.current = 0..0;
            return Ok(false);
        }
        if self.line == 1 && self.block[self.current.clone()].starts_with(b"\xef\xbb\xbf") {
            self.current.start += 3;
        }
        if self.block[self.current.clone()].last() == Some(&b'\\') {
            self.is_joined = true;
            self.joined.clear();
            self.joined.extend_from_slice(&self.block[self.current.clone()]);
            while self.joined.last() == Some(&b'\\') {
                self.joined.pop();
                self.joined.push(b' ');
                if !self.physical()? {
                    break;
                }
                self.joined.extend_from_slice(&self.block[self.current.clone()]);
                if self.joined.len() > LINE_LIMIT {
                    return Err(self.error(
                        "a line of more than 64 MiB",
                        "this is no text file: give an OBJ, MTL or scene file",
                    ));
                }
            }
        }
        Ok(true)
    }

    /// The current line.
    pub(crate) fn text(&self) -> &[u8] {
        if self.is_joined { &self.joined } else { &self.block[self.current.clone()] }
    }

    /// Hashes the rest and says what was read.
    pub(crate) fn finish(self) -> Result<InputFile, SceneError> {
        let fail = |e| SceneError::read(&self.path, e);
        let mut plain = match self.bytes {
            Bytes::Plain(r) => r,
            Bytes::Zstd(r) => {
                let mut packed = r.finish();
                io::copy(&mut packed, &mut io::sink()).map_err(fail)?;
                packed.into_inner()
            }
        };
        io::copy(&mut plain, &mut io::sink()).map_err(fail)?;
        Ok(InputFile { path: self.path, hash: plain.hash.digest128() })
    }
}

/// Reads a whole file through the hash without keeping it.
pub(crate) fn hash_file(path: &Path) -> Result<InputFile, SceneError> {
    let fail = |e| SceneError::read(path, e);
    let file = File::open(path).map_err(fail)?;
    let hashing = Hashing { file, hash: Box::new(Xxh3::new()) };
    let mut hashing = BufReader::with_capacity(BLOCK, hashing);
    io::copy(&mut hashing, &mut io::sink()).map_err(fail)?;
    Ok(InputFile { path: path.into(), hash: hashing.into_inner().hash.digest128() })
}

/// Splits a line into its first word and the rest, both trimmed; `None` for blank lines and comments.
pub(crate) fn keyword(line: &[u8]) -> Option<(&[u8], &[u8])> {
    let line = line.trim_ascii();
    if line.is_empty() || line[0] == b'#' {
        return None;
    }
    let end = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
    Some((&line[..end], line[end..].trim_ascii()))
}

/// The words of a line.
pub(crate) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty())
}

/// A number; "not a number" in the spelling of any C library is one.
pub(crate) fn number(word: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    match text.parse() {
        Ok(value) => Some(value),
        // 1.#IND, -1.#QNAN, 1.#INF
        Err(_) if text.contains('#') && text.starts_with(['1', '-', '+']) => Some(f64::NAN),
        Err(_) => None,
    }
}

/// Powers of ten that `f64` has exactly.
const TENS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
    1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
];

/// The number that a trimmed text begins with, and the trimmed rest.
///
/// Up to 53 bits of digits and a power of ten up to 22 are two exact `f64`, so their product or quotient
/// is rounded once and is what `str::parse` gives (Clinger, "How to Read Floating Point Numbers
/// Accurately", section 1). Everything else goes to `str::parse`.
pub(crate) fn leading_number(text: &[u8]) -> Option<(f64, &[u8])> {
    let mut at = 0;
    let negative = match text.first() {
        Some(b'-') => {
            at = 1;
            true
        }
        _ => false,
    };
    let mut mantissa = 0u64;
    let mut digits = 0;
    let mut after_point = 0i32;
    let mut point = false;
    while let Some(&b) = text.get(at) {
        let digit = b.wrapping_sub(b'0');
        if digit < 10 {
            mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(digit));
            // Leading zeros are no digits: they cannot overflow.
            digits += i32::from(mantissa != 0);
            after_point += i32::from(point);
        } else if b == b'.' && !point {
            point = true;
        } else {
            break;
        }
        at += 1;
    }
    let seen = at - usize::from(negative) - usize::from(point);
    let mut exponent = -after_point;
    let mut good = seen > 0 && seen < 64 && digits <= 18 && mantissa <= 1 << 53;
    if good && matches!(text.get(at), Some(b'e' | b'E')) {
        at += 1;
        let down = match text.get(at) {
            Some(b'-') => {
                at += 1;
                true
            }
            Some(b'+') => {
                at += 1;
                false
            }
            _ => false,
        };
        let begin = at;
        let mut power = 0i32;
        while let Some(digit) = text.get(at).map(|b| b.wrapping_sub(b'0')).filter(|&d| d < 10) {
            power = power.saturating_mul(10).saturating_add(i32::from(digit)).min(9999);
            at += 1;
        }
        good = at > begin;
        exponent += if down { -power } else { power };
    }
    let ends = text.get(at).is_none_or(u8::is_ascii_whitespace);
    if good && ends && exponent.unsigned_abs() <= 22 {
        let power = TENS[exponent.unsigned_abs() as usize];
        let exact = mantissa as f64;
        let value = if exponent < 0 { exact / power } else { exact * power };
        let value = if negative { -value } else { value };
        return Some((value, text[at..].trim_ascii_start()));
    }
    let end = text.iter().position(u8::is_ascii_whitespace).unwrap_or(text.len());
    number(&text[..end]).map(|value| (value, text[end..].trim_ascii_start()))
}

/// The whole number that a corner of a face (`7`, `7/1`, `7//2`, `-1`) begins with, and the trimmed text
/// after the corner; `None` where that is not how it is written.
pub(crate) fn leading_corner(text: &[u8]) -> Option<(i64, &[u8])> {
    let negative = text.first() == Some(&b'-');
    let begin = usize::from(negative);
    let mut at = begin;
    let mut value = 0i64;
    while let Some(digit) = text.get(at).map(|b| b.wrapping_sub(b'0')).filter(|&d| d < 10) {
        value = value * 10 + i64::from(digit);
        at += 1;
        if at > begin + 17 {
            return None;
        }
    }
    if at == begin {
        return None;
    }
    if text.get(at) == Some(&b'/') {
        while text.get(at).is_some_and(|b| !b.is_ascii_whitespace()) {
            at += 1;
        }
    } else if text.get(at).is_some_and(|b| !b.is_ascii_whitespace()) {
        return None;
    }
    Some((if negative { -value } else { value }, text[at..].trim_ascii_start()))
}

/// Text of a name; bytes that are no UTF-8 are replaced.
pub(crate) fn name(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Reads a whole (TOML) file as text.
pub(crate) fn read_text(path: &Path) -> Result<(String, InputFile), SceneError> {
    let bytes = std::fs::read(path).map_err(|e| SceneError::read(path, e))?;
    let hash = xxhash_rust::xxh3::xxh3_128(&bytes);
    let text = String::from_utf8(bytes).map_err(|e| {
        let upto = e.utf8_error().valid_up_to();
        let line = 1 + e.as_bytes()[..upto].iter().filter(|&&b| b == b'\n').count();
        SceneError::line(path, line, "the text is not UTF-8", "save the file as UTF-8")
    })?;
    Ok((text, InputFile { path: path.into(), hash }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn same(text: &str) {
        let expected =
            text.trim().split_ascii_whitespace().next().and_then(|w| number(w.as_bytes()));
        let got = leading_number(text.as_bytes()).map(|(v, _)| v);
        assert_eq!(got.map(f64::to_bits), expected.map(f64::to_bits), "{text}");
    }

    #[test]
    fn numbers_are_what_the_standard_library_reads() {
        for text in [
            "0",
            "-0",
            "-0.0",
            "1",
            "1.",
            ".5",
            "-.5e1",
            "1e22",
            "1e23",
            "1e-22",
            "1e-23",
            "1E+5",
            "+1",
            "9007199254740992",
            "9007199254740993",
            "0.1",
            "0.30000000000000004",
            "123456789012345678",
            "1234567890123456789",
            "99999999999999999999999",
            "0.00000000000000000000000000000001",
            "00000000000000000000000000000000000000000000000000000000000000000000000000001",
            "1e",
            "e1",
            ".",
            "-",
            "",
            "1e+",
            "1.2.3",
            "1_0",
            "0x10",
            "nan",
            "-inf",
            "1.#IND",
            "1e99999",
            "1e-99999",
            "1,5",
            "2 3",
            "3\t4",
        ] {
            same(text);
        }
        let (v, rest) = leading_number(b"1.5  \t-2e3 x").unwrap();
        assert_eq!((v, rest), (1.5, &b"-2e3 x"[..]));
    }

    #[test]
    fn corners_as_exporters_write_them() {
        assert_eq!(leading_corner(b"7/1/2 8"), Some((7, &b"8"[..])));
        assert_eq!(leading_corner(b"-3// 8"), Some((-3, &b"8"[..])));
        assert_eq!(leading_corner(b"12"), Some((12, &b""[..])));
        for bad in ["", "-", "/1", "x", "1x", "99999999999999999999", "+1"] {
            assert_eq!(leading_corner(bad.as_bytes()), None, "{bad}");
        }
    }

    #[test]
    fn lines_longer_than_a_block_and_lines_on_its_edge() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("long.txt");
        for length in [BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK + 7] {
            let long = "x".repeat(length);
            std::fs::write(&path, format!("a\r\n{long}\nb \\\n{long}\n\nlast")).unwrap();
            let mut lines = Lines::open(&path).unwrap();
            let mut seen = Vec::new();
            while lines.advance().unwrap() {
                seen.push((lines.number(), lines.text().len()));
            }
            assert_eq!(seen, [(1, 1), (2, length), (3, length + 3), (5, 0), (6, 4)]);
            let hash = xxhash_rust::xxh3::xxh3_128(&std::fs::read(&path).unwrap());
            assert_eq!(lines.finish().unwrap().hash, hash);
            assert_eq!(hash_file(&path).unwrap().hash, hash);
        }
    }

    proptest! {
        #[test]
        fn any_number_is_read_as_the_standard_library_does(
            bits in any::<u64>(), small in -1e6..1e6f64, places in 0..20usize, text in "[-+0-9.eE]{0,24}",
        ) {
            same(&format!("{}", f64::from_bits(bits)));
            same(&format!("{:e}", f64::from_bits(bits)));
            same(&format!("{small:.places$}"));
            same(&text);
        }
    }
}
