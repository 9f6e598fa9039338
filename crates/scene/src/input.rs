//! Files, line by line: plain or zstd, hashed while they are read, never held whole.

use crate::{InputFile, SceneError};
use std::{
    fs::File,
    io::{self, BufRead, BufReader, Read},
    path::{Path, PathBuf},
};
use xxhash_rust::xxh3::Xxh3;

/// Longest line that is still taken for text, bytes.
const LINE_LIMIT: u64 = 64 << 20;

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
    Plain(BufReader<Hashing>),
    Zstd(Box<BufReader<zstd::stream::read::Decoder<'static, BufReader<Hashing>>>>),
}

/// Lines of a file.
pub(crate) struct Lines {
    path: PathBuf,
    bytes: Bytes,
    line: usize,
    /// Physical lines that the last logical one spans.
    span: usize,
    buffer: Vec<u8>,
}

/// True for `X.zst`.
pub(crate) fn is_zstd(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("zst"))
}

impl Lines {
    pub(crate) fn open(path: &Path) -> Result<Self, SceneError> {
        let fail = |e| SceneError::read(path, e);
        let file = File::open(path).map_err(fail)?;
        let hashing =
            BufReader::with_capacity(256 << 10, Hashing { file, hash: Box::new(Xxh3::new()) });
        let bytes = if is_zstd(path) {
            let decoder = zstd::stream::read::Decoder::with_buffer(hashing).map_err(fail)?;
            Bytes::Zstd(Box::new(BufReader::with_capacity(256 << 10, decoder)))
        } else {
            Bytes::Plain(hashing)
        };
        Ok(Self { path: path.into(), bytes, line: 0, span: 0, buffer: Vec::new() })
    }

    /// Number of the first physical line of the current logical one, from 1.
    pub(crate) fn number(&self) -> usize {
        self.line + 1 - self.span
    }

    /// An error at the current line.
    pub(crate) fn error(&self, what: impl Into<String>, remedy: impl Into<String>) -> SceneError {
        SceneError::line(&self.path, self.number(), what, remedy)
    }

    fn append_physical(&mut self) -> Result<bool, SceneError> {
        fn take(reader: &mut impl BufRead, out: &mut Vec<u8>) -> io::Result<usize> {
            reader.take(LINE_LIMIT).read_until(b'\n', out)
        }
        let read = match &mut self.bytes {
            Bytes::Plain(r) => take(r, &mut self.buffer),
            Bytes::Zstd(r) => take(r, &mut self.buffer),
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
        if n == 0 {
            return Ok(false);
        }
        self.line += 1;
        self.span += 1;
        if n as u64 == LINE_LIMIT || self.buffer.len() as u64 > LINE_LIMIT {
            return Err(self.error(
                "a line of more than 64 MiB",
                "this is no text file: give an OBJ, MTL or scene file",
            ));
        }
        while matches!(self.buffer.last(), Some(b'\n' | b'\r')) {
            self.buffer.pop();
        }
        Ok(true)
    }

    /// The next line without its end; lines that end in a backslash are joined with the next one.
    pub(crate) fn advance(&mut self) -> Result<bool, SceneError> {
        self.buffer.clear();
        self.span = 0;
        if !self.append_physical()? {
            self.span = usize::from(self.line > 0);
            return Ok(false);
        }
        if self.line == 1 && self.buffer.starts_with(b"\xef\xbb\xbf") {
            self.buffer.drain(..3);
        }
        while self.buffer.last() == Some(&b'\\') {
            self.buffer.pop();
            self.buffer.push(b' ');
            if !self.append_physical()? {
                break;
            }
        }
        Ok(true)
    }

    /// The current line.
    pub(crate) fn text(&self) -> &[u8] {
        &self.buffer
    }

    /// Hashes the rest and says what was read.
    pub(crate) fn finish(self) -> Result<InputFile, SceneError> {
        let fail = |e| SceneError::read(&self.path, e);
        let mut plain = match self.bytes {
            Bytes::Plain(r) => r,
            Bytes::Zstd(r) => r.into_inner().finish(),
        };
        io::copy(&mut plain, &mut io::sink()).map_err(fail)?;
        let hash = plain.into_inner().hash.digest128();
        Ok(InputFile { path: self.path, hash })
    }
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
