//! Pictures: PNG and JPEG files, or the same within glTF files, as 8-bit sRGB texels.
//!
//! They are decoded one at a time, when someone asks, and made smaller on the way: PNG row by row, so that
//! a large picture costs a row; JPEG as a whole.

use crate::{SceneError, input, obj};
use std::{
    fs::File,
    io::{BufRead, BufReader, Cursor, Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};

/// Pictures larger than this on a side are refused.
const LARGEST_SIDE: u32 = 16_384;
/// So are compressed ones of more bytes.
const LARGEST_FILE: u64 = 256 << 20;
/// What a decoder takes beside what is counted.
const DECODER_BYTES: u64 = 512 << 10;

/// Where a picture's bytes are.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Source {
    /// A part of a file, or all of it.
    File { path: PathBuf, start: u64, len: Option<u64> },
    /// From a data URI of this file.
    Memory { path: PathBuf, bytes: Vec<u8> },
}

impl Source {
    pub(crate) fn path(&self) -> &Path {
        match self {
            Self::File { path, .. } | Self::Memory { path, .. } => path,
        }
    }
}

/// What a material says about its texture.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Map {
    pub(crate) source: Source,
    /// `TEXTURE_*` bits.
    pub(crate) flags: u32,
    /// Rows of the map from coordinates (u, v, 1) to places on the picture, right and down.
    pub(crate) place: [[f32; 3]; 2],
}

/// A picture on matter, not read yet.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// File name, for messages.
    pub name: String,
    /// `TEXTURE_*` bits.
    pub flags: u32,
    /// Rows of the affine map from texture coordinates (u, v, 1) to places on the picture: right from its left border in
    /// widths, down from its upper border in heights.
    pub place: [[f32; 3]; 2],
    source: Source,
    kind: Kind,
    size: [u32; 2],
    interlaced: bool,
}

/// A picture that was read.
#[derive(Clone, Debug, PartialEq)]
pub struct Texels {
    /// Texels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// sRGB, top row first.
    pub texels: Vec<[u8; 3]>,
    /// Their mean, linear Rec.709.
    pub mean: [f32; 3],
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Png,
    Jpeg,
}

/// Part of a file as a stream.
trait Stream: BufRead + Seek {}
impl<T: BufRead + Seek> Stream for T {}

/// A window into a file: positions count from its start.
struct Window {
    file: BufReader<File>,
    start: u64,
    len: u64,
    at: u64,
}

impl Read for Window {
    fn read(&mut self, out: &mut [u8]) -> std::io::Result<usize> {
        let most = (self.len - self.at).min(out.len() as u64) as usize;
        let n = self.file.read(&mut out[..most])?;
        self.at += n as u64;
        Ok(n)
    }
}

impl BufRead for Window {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        let left = (self.len - self.at) as usize;
        let buffer = self.file.fill_buf()?;
        Ok(&buffer[..buffer.len().min(left)])
    }

    fn consume(&mut self, n: usize) {
        self.file.consume(n);
        self.at += n as u64;
    }
}

impl Seek for Window {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => self.len.checked_add_signed(by),
        };
        let at = at.filter(|&at| at <= self.len).ok_or_else(|| {
            std::io::Error::new(std::io::ErrorKind::InvalidInput, "beyond the end of a picture")
        })?;
        self.file.seek(SeekFrom::Start(self.start + at))?;
        self.at = at;
        Ok(at)
    }
}

/// Adds rows of sRGB bytes up to a smaller picture, by the mean of the light in squares of `step` pixels.
struct Shrink {
    step: u32,
    width: u32,
    /// Linear sums of the row of texels that is under way, and pixels in each.
    sums: Vec<[f64; 3]>,
    counts: Vec<u32>,
    rows: u32,
    texels: Vec<[u8; 3]>,
    total: [f64; 3],
    linear: [f64; 256],
}

/// The linear value of an sRGB code (IEC 61966-2-1).
fn linear(code: f64) -> f64 {
    let c = code / 255.0;
    if c <= 0.04045 { c / 12.92 } else { libm::pow((c + 0.055) / 1.055, 2.4) }
}

fn code(linear: f64) -> u8 {
    let c = if linear <= 0.003_130_8 {
        linear * 12.92
    } else {
        1.055 * libm::pow(linear, 1.0 / 2.4) - 0.055
    };
    (c * 255.0 + 0.5).clamp(0.0, 255.0) as u8
}

impl Shrink {
    fn new(width: u32, height: u32, halvings: u32) -> Self {
        let step = 1 << halvings.min(14);
        let out = width.div_ceil(step);
        Self {
            step,
            width: out,
            sums: vec![[0.0; 3]; out as usize],
            counts: vec![0; out as usize],
            rows: 0,
            texels: Vec::with_capacity((out * height.div_ceil(step)) as usize),
            total: [0.0; 3],
            linear: std::array::from_fn(|i| linear(i as f64)),
        }
    }

    /// A row of pixels of `channels` bytes: grey, grey and alpha, RGB, or RGB and alpha (which is not looked at).
    fn row(&mut self, row: &[u8], channels: usize) {
        let pixels = row.chunks_exact(channels.max(1));
        for (x, pixel) in pixels.enumerate() {
            let rgb = match *pixel {
                [r, g, b, ..] => [r, g, b],
                [grey, ..] => [grey; 3],
                [] => [0; 3],
            };
            let at = (x as u32 / self.step) as usize;
            let Some(sum) = self.sums.get_mut(at) else { break };
            for (s, c) in sum.iter_mut().zip(rgb) {
                *s += self.linear[usize::from(c)];
            }
            self.counts[at] += 1;
        }
        self.rows += 1;
        if self.rows == self.step {
            self.flush();
        }
    }

    fn flush(&mut self) {
        for (sum, count) in self.sums.iter_mut().zip(&mut self.counts) {
            let mean = sum.map(|s| s / f64::from((*count).max(1)));
            self.texels.push(mean.map(code));
            for (t, s) in self.total.iter_mut().zip(mean) {
                *t += s;
            }
            (*sum, *count) = ([0.0; 3], 0);
        }
        self.rows = 0;
    }

    fn finish(mut self) -> Texels {
        if self.rows > 0 {
            self.flush();
        }
        let count = self.texels.len();
        Texels {
            width: self.width,
            height: (count / (self.width as usize).max(1)) as u32,
            mean: self.total.map(|t| (t / count.max(1) as f64) as f32),
            texels: self.texels,
        }
    }
}

impl Texture {
    /// Looks at the head of a picture: `None` if it is of no kind that is read here.
    pub(crate) fn open(map: &Map) -> Result<Option<Self>, SceneError> {
        let source = map.source.clone();
        let mut head = [0u8; 8];
        let path = source.path().to_path_buf();
        let mut bytes = stream(&source)?;
        let mut filled = 0;
        while filled < head.len() {
            match bytes.read(&mut head[filled..]).map_err(|e| SceneError::read(&path, e))? {
                0 => break,
                n => filled += n,
            }
        }
        bytes.rewind().map_err(|e| SceneError::read(&path, e))?;
        let kind = match head {
            [0x89, b'P', b'N', b'G', 0x0d, 0x0a, 0x1a, 0x0a] => Kind::Png,
            [0xff, 0xd8, 0xff, ..] => Kind::Jpeg,
            _ => return Ok(None),
        };
        let (size, interlaced) = match kind {
            Kind::Png => {
                let reader = png::Decoder::new(bytes).read_info().map_err(|e| bad(&path, e))?;
                let info = reader.info();
                ([info.width, info.height], info.interlaced)
            }
            Kind::Jpeg => {
                let bytes = all(bytes, &path)?;
                let mut decoder = zune_jpeg::JpegDecoder::new(&bytes[..]);
                decoder.decode_headers().map_err(|e| bad(&path, e))?;
                let (w, h) = decoder.dimensions().unwrap_or((0, 0));
                ([w as u32, h as u32], false)
            }
        };
        if size.iter().any(|&s| s == 0 || s > LARGEST_SIDE) {
            return Err(SceneError::whole(
                &path,
                format!("the picture has {} by {} pixels", size[0], size[1]),
                "1 to 16384 a side are read: make it smaller",
            ));
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let Map { flags, place, .. } = *map;
        Ok(Some(Self { name, flags, place, source, kind, size, interlaced }))
    }

    /// Pixels of the file: width and height.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Texels after so many halvings of both sides.
    pub fn texels(&self, halvings: u32) -> u64 {
        self.size.iter().map(|s| u64::from(s.div_ceil(1 << halvings.min(14)))).product()
    }

    /// Bytes that [`Texture::decode`] takes at most beside what it returns.
    pub fn decode_bytes(&self) -> u64 {
        let [w, h] = self.size.map(u64::from);
        let pixels = match self.kind {
            Kind::Png if !self.interlaced => 0,
            Kind::Png => w * h * 4,
            // Coefficients of a progressive picture, its planes and its bytes.
            Kind::Jpeg => {
                let file = match &self.source {
                    Source::File { path, len, .. } => {
                        len.unwrap_or_else(|| std::fs::metadata(path).map_or(0, |m| m.len()))
                    }
                    Source::Memory { bytes, .. } => bytes.len() as u64,
                };
                w.next_multiple_of(16) * h.next_multiple_of(16) * 9 + file
            }
        };
        pixels + w * 64 + DECODER_BYTES
    }

    /// Reads the picture, with both sides halved so often: each texel is the mean of the light of its pixels.
    ///
    /// # Errors
    /// A file that has gone, or is damaged.
    pub fn decode(&self, halvings: u32) -> Result<Texels, SceneError> {
        let path = self.source.path();
        let [width, height] = self.size;
        let mut shrink = Shrink::new(width, height, halvings);
        let bytes = stream(&self.source)?;
        match self.kind {
            Kind::Png => {
                let mut decoder = png::Decoder::new(bytes);
                decoder.set_transformations(png::Transformations::normalize_to_color8());
                let mut reader = decoder.read_info().map_err(|e| bad(path, e))?;
                let channels = reader.output_color_type().0.samples();
                if self.interlaced {
                    let size = reader.output_buffer_size().unwrap_or(0);
                    let mut out = vec![0; size];
                    let info = reader.next_frame(&mut out).map_err(|e| bad(path, e))?;
                    for row in out.chunks_exact(info.line_size.max(1)).take(height as usize) {
                        shrink.row(row, channels);
                    }
                } else {
                    for _ in 0..height {
                        let row = reader.next_row().map_err(|e| bad(path, e))?;
                        let row = row.ok_or_else(|| bad(path, "its rows end too early"))?;
                        shrink.row(row.data(), channels);
                    }
                }
            }
            Kind::Jpeg => {
                let bytes = all(bytes, path)?;
                let mut decoder = zune_jpeg::JpegDecoder::new(&bytes[..]);
                let out = decoder.decode().map_err(|e| bad(path, e))?;
                let channels = out.len() / (width as usize * height as usize);
                if channels == 0 || channels > 4 {
                    return Err(bad(path, "its rows end too early"));
                }
                for row in out.chunks_exact(width as usize * channels) {
                    shrink.row(row, channels);
                }
            }
        }
        Ok(shrink.finish())
    }

    /// Heap bytes.
    pub(crate) fn bytes(&self) -> u64 {
        let held = match &self.source {
            Source::File { path, .. } => path.as_os_str().len(),
            Source::Memory { bytes, .. } => bytes.capacity(),
        };
        (size_of::<Self>() + self.name.capacity() + held) as u64
    }

    /// The same picture, whatever becomes of it.
    pub(crate) fn is(&self, map: &Map) -> bool {
        self.source == map.source && self.flags == map.flags && self.place == map.place
    }
}

/// Hashes the file of a picture, unless it lies within a file that was read anyway.
pub(crate) fn input_of(map: &Map) -> Result<Option<crate::InputFile>, SceneError> {
    match &map.source {
        Source::File { path, len: None, .. } => input::hash_file(path).map(Some),
        _ => Ok(None),
    }
}

fn stream(source: &Source) -> Result<Box<dyn Stream + '_>, SceneError> {
    match source {
        Source::Memory { bytes, .. } => Ok(Box::new(Cursor::new(&bytes[..]))),
        Source::File { path, start, len } => {
            let fail = |e| SceneError::read(path, e);
            let file = File::open(path).map_err(fail)?;
            let whole = file.metadata().map_err(fail)?.len();
            let left = whole.saturating_sub(*start);
            let len = len.unwrap_or(left).min(left);
            let mut window = Window { file: BufReader::new(file), start: *start, len, at: 0 };
            window.rewind().map_err(fail)?;
            Ok(Box::new(window))
        }
    }
}

fn all(mut bytes: Box<dyn Stream + '_>, path: &Path) -> Result<Vec<u8>, SceneError> {
    let mut out = Vec::new();
    let read = bytes.by_ref().take(LARGEST_FILE + 1).read_to_end(&mut out);
    read.map_err(|e| SceneError::read(path, e))?;
    if out.len() as u64 > LARGEST_FILE {
        return Err(SceneError::whole(
            path,
            "the picture has more than 256 MiB",
            "make it smaller",
        ));
    }
    Ok(out)
}

fn bad(path: &Path, what: impl std::fmt::Display) -> SceneError {
    let what = obj::excerpt(what.to_string().as_bytes());
    SceneError::whole(
        path,
        format!("the picture cannot be read: {what}"),
        "it is damaged or of a rare kind: save it again as PNG or baseline JPEG",
    )
}

/// What follows `map_Kd` in an MTL file: options, then the file's name, which may have blanks (MTL specification,
/// "Options for texture map statements"). `None`: no name, or an option that is none.
pub(crate) fn map_statement(rest: &[u8], mtl: &Path) -> Option<Result<Map, PathBuf>> {
    use enf_layout::texture::{TEXTURE_CLAMP_X, TEXTURE_CLAMP_Y};
    let text = String::from_utf8_lossy(rest);
    let mut left = text.trim();
    let (mut scale, mut shift, mut flags) = ([1.0f32; 2], [0.0f32; 2], 0);
    while let Some(option) = left.split_whitespace().next().filter(|w| w.starts_with('-')) {
        let mut after = left[option.len()..].trim_start();
        let next = |after: &mut &str| {
            let word = after.split_whitespace().next()?;
            *after = after[word.len()..].trim_start();
            Some(word.to_string())
        };
        match option {
            "-s" | "-o" | "-t" => {
                let mut numbers = [None; 3];
                for number in &mut numbers {
                    let word = after.split_whitespace().next().and_then(|w| w.parse::<f32>().ok());
                    let Some(value) = word.filter(|v| v.is_finite()) else { break };
                    *number = Some(value);
                    next(&mut after);
                }
                let [Some(u), v, _] = numbers else { return None };
                match option {
                    "-s" => scale = [u, v.unwrap_or(1.0)],
                    "-o" => shift = [u, v.unwrap_or(0.0)],
                    _ => {}
                }
            }
            "-mm" => {
                next(&mut after)?;
                next(&mut after)?;
            }
            "-clamp" => {
                if next(&mut after)? == "on" {
                    flags = TEXTURE_CLAMP_X | TEXTURE_CLAMP_Y;
                }
            }
            "-blendu" | "-blendv" | "-cc" | "-texres" | "-bm" | "-imfchan" | "-type" | "-boost" => {
                next(&mut after)?;
            }
            // A name may begin so.
            _ => break,
        }
        left = after;
    }
    if left.is_empty() {
        return None;
    }
    let folder = mtl.parent().unwrap_or(Path::new(""));
    let name = left.trim_matches('"').replace('\\', "/");
    let base = name.rsplit('/').next().unwrap_or(&name);
    let found = [folder.join(&name), folder.join(base)].into_iter().find(|p| p.is_file());
    let Some(path) = found else { return Some(Err(folder.join(name))) };
    // v points up in MTL, and rows go down.
    let place = [[scale[0], 0.0, shift[0]], [0.0, -scale[1], 1.0 - shift[1]]];
    Some(Ok(Map { source: Source::File { path, start: 0, len: None }, flags, place }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn png_of(width: u32, height: u32, rgb: &[u8], path: &Path) {
        let mut encoder = png::Encoder::new(File::create(path).unwrap(), width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header().unwrap().write_image_data(rgb).unwrap();
    }

    fn open(path: &Path) -> Texture {
        let source = Source::File { path: path.into(), start: 0, len: None };
        let map = Map { source, flags: 0, place: [[1.0, 0.0, 0.0], [0.0, -1.0, 1.0]] };
        Texture::open(&map).unwrap().unwrap()
    }

    #[test]
    fn light_is_averaged_and_not_codes() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        // 3 x 3: the last column and row are squares of their own.
        let (w, k, r) = ([255u8; 3], [0u8; 3], [255u8, 0, 0]);
        png_of(3, 3, &[w, k, r, k, w, r, r, r, w].concat(), &path);
        let texture = open(&path);
        assert_eq!((texture.size(), texture.texels(1)), ([3, 3], 4));
        let whole = texture.decode(0).unwrap();
        assert_eq!((whole.width, whole.height), (3, 3));
        assert_eq!(whole.texels[..3], [w, k, r]);
        let half = texture.decode(1).unwrap();
        assert_eq!((half.width, half.height), (2, 2));
        // Half the light is the code 188.
        assert_eq!(half.texels, [[188; 3], r, r, w]);
        assert!((half.mean[1] - 0.375).abs() < 1e-6 && half.mean[0] == 0.875, "{:?}", half.mean);
    }

    #[test]
    fn what_is_no_picture_is_said() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        png_of(2, 2, &[9; 12], &path);
        let whole = std::fs::read(&path).unwrap();
        let texture = open(&path);
        for cut in [45, 20] {
            std::fs::write(&path, &whole[..cut]).unwrap();
            let error = texture.decode(0).unwrap_err().to_string();
            assert!(error.contains("a.png") && error.contains("picture"), "{error}");
        }
        std::fs::write(&path, b"GIF89a..........").unwrap();
        let source = Source::File { path: path.clone(), start: 0, len: None };
        let map = Map { source, flags: 0, place: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] };
        assert_eq!(Texture::open(&map).unwrap(), None);
    }

    #[test]
    fn map_statements() {
        let dir = tempfile::tempdir().unwrap();
        let mtl = dir.path().join("m.mtl");
        std::fs::write(dir.path().join("old brick.png"), b"").unwrap();
        let read = |text: &str| map_statement(text.as_bytes(), &mtl);
        let map =
            read("-s 2 3 1 -o 0.5 -clamp on -bm 0.2 textures\\old brick.png").unwrap().unwrap();
        assert_eq!(map.place, [[2.0, 0.0, 0.5], [0.0, -3.0, 1.0]]);
        assert_eq!(map.flags, 3);
        assert!(map.source.path().ends_with("old brick.png"));
        assert!(read("missing.png").unwrap().is_err());
        assert!(read("-s 2 2 2").is_none());
        assert!(read("-s x old brick.png").is_none());
    }
}
