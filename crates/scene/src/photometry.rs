//! IES files: luminous intensities of real luminaires, as manufacturers ship them.
//!
//! Read are ANSI/IES LM-63 of 1986, 1991, 1995, 2002 and 2019, photometric types A, B and C, and what is found in
//! the wild: any line breaks and separators, any 8-bit text in the keywords, words behind the table. Angles that do not ascend,
//! numbers that are missing, and symmetries that no edition knows are errors with a line.

use crate::{InputFile, SceneError, obj::excerpt};
use enf_layout::profile::{MAX_ANGLES, Samples};
use glam::DVec3;
use std::{f64::consts::FRAC_PI_2, fs::File, io::Read, path::Path};

/// Larger files are no photometry, bytes.
const LARGEST: u64 = 16 << 20;
/// Most angles of a kind.
const MOST: usize = MAX_ANGLES / 2;
/// An angle so near to a quarter turn is meant to be one, degrees. Angles are twice as far apart at least.
const SAME: f64 = 0.001;
/// Metres in a foot.
const FOOT: f64 = 0.3048;

/// How the angles of a file are counted (LM-63-2002, section 3; LM-75). "Straight down" is the luminaire's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhotometricType {
    /// Vertical angles are elevations from -90, straight down; horizontal ones go clockwise about the vertical.
    A,
    /// Vertical angles go about a horizontal axis, from 0, straight down, to 90; horizontal ones are elevations towards that axis, clockwise.
    B,
    /// Vertical angles from 0, straight down, to 180; horizontal ones go counter-clockwise about the vertical.
    C,
}

/// Lamp lumens that change as the luminaire is tilted (`TILT=INCLUDE`).
#[derive(Clone, Debug, PartialEq)]
pub struct Tilt {
    /// 1: the lamp is vertical when the luminaire points down; 2: horizontal, and stays so; 3: horizontal, and tilts.
    pub geometry: u32,
    /// Degrees, ascending.
    pub angles: Vec<f64>,
    /// Share of the lamp's lumens at each angle.
    pub factors: Vec<f64>,
}

/// What an IES file says.
#[derive(Clone, Debug, PartialEq)]
pub struct Photometry {
    /// Edition of LM-63 by its year; 1986 where the file does not say.
    pub edition: u32,
    /// How angles are counted.
    pub kind: PhotometricType,
    /// Number of lamps.
    pub lamps: f64,
    /// Rated lumens of each; none for absolute photometry.
    pub lamp_lumens: Option<f64>,
    /// The file's multiplier of all intensities.
    pub multiplier: f64,
    /// Ballast factor.
    pub ballast_factor: f64,
    /// Ballast-lamp photometric factor; 1 since the edition of 2002, which took its place for other things.
    pub lamp_factor: f64,
    /// Sizes of the luminous opening were in feet.
    pub feet: bool,
    /// Width, length and height of the luminous opening, m; negative widths are diameters. Not used for emission: a luminaire is a point.
    pub opening_m: [f64; 3],
    /// Electrical power, W.
    pub input_watts: f64,
    /// Vertical angles, degrees, ascending.
    pub vertical: Vec<f64>,
    /// Horizontal angles, degrees, ascending.
    pub horizontal: Vec<f64>,
    /// Intensities with all three factors, cd, by horizontal, then vertical angle.
    pub candela: Vec<f64>,
    /// What tilting does.
    pub tilt: Option<Tilt>,
    /// What is odd about the file, one sentence each, without its name.
    pub warnings: Vec<String>,
}

/// Reads an IES file.
///
/// # Errors
/// It cannot be read, or [`parse`] refuses it.
pub fn read(path: &Path) -> Result<(Photometry, InputFile), SceneError> {
    let fail = |e| SceneError::read(path, e);
    let file = File::open(path).map_err(fail)?;
    let mut bytes = Vec::new();
    file.take(LARGEST + 1).read_to_end(&mut bytes).map_err(fail)?;
    if bytes.len() as u64 > LARGEST {
        return Err(SceneError::whole(path, "more than 16 MiB", "this is no IES file"));
    }
    let hash = xxhash_rust::xxh3::xxh3_128(&bytes);
    Ok((parse(path, &bytes)?, InputFile { path: path.into(), hash }))
}

/// Makes sense of the bytes of an IES file; `path` is for messages.
///
/// # Errors
/// [`SceneError::Line`] where a number is missing, unreadable or out of range, where angles do not ascend or their range is
/// none that LM-63 knows, and where tilt data are in another file; [`SceneError::File`] for files of another kind.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<Photometry, SceneError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if bytes.contains(&0) {
        return Err(SceneError::whole(
            path,
            "is no plain text",
            "save it as plain text, not as UTF-16",
        ));
    }
    let mut lines = Lines { rest: bytes, number: 0 };
    let mut edition = 1986;
    let mut said_tilt = None;
    while let Some(line) = lines.next_line() {
        if lines.number == 1 {
            edition = edition_of(line).unwrap_or(1986);
        }
        if let Some(value) = tilt_line(line) {
            said_tilt = Some(value);
            break;
        }
    }
    let Some(value) = said_tilt else {
        return Err(SceneError::whole(
            path,
            "has no line TILT=",
            "give an IES photometric file (LM-63); other formats, EULUMDAT among them, are not read",
        ));
    };
    let mut numbers = Numbers { path, lines, line: b"", at: 0 };
    let tilt = match value.as_str() {
        "NONE" => None,
        "INCLUDE" => Some(numbers.tilt()?),
        _ => {
            let what =
                format!("the tilt data are in another file, \"{}\"", excerpt(value.as_bytes()));
            let remedy = "put them here behind TILT=INCLUDE, or write TILT=NONE where the lamp does not mind";
            return Err(numbers.error(what, remedy));
        }
    };
    numbers.luminaire(edition, tilt)
}

/// The year in `IESNA:LM-63-2002`, `IES:LM-63-2019`, `IESNA91`.
fn edition_of(line: &[u8]) -> Option<u32> {
    let line = String::from_utf8_lossy(line).trim().to_ascii_uppercase();
    if let Some((_, year)) = line.split_once("LM-63-") {
        let digits: String = year.chars().take_while(char::is_ascii_digit).collect();
        return match (digits.len(), digits.parse::<u32>().ok()?) {
            (2, y) => Some(if y < 80 { 2000 + y } else { 1900 + y }),
            (4, y) => Some(y),
            _ => None,
        };
    }
    match line.strip_prefix("IESNA")?.trim() {
        "86" => Some(1986),
        "91" => Some(1991),
        "95" => Some(1995),
        _ => None,
    }
}

/// What a line `TILT=` says, in capitals.
fn tilt_line(line: &[u8]) -> Option<String> {
    let text = String::from_utf8_lossy(line.trim_ascii());
    let (key, value) = text.split_once('=')?;
    let word = value.trim().trim_matches('"');
    if !key.trim().eq_ignore_ascii_case("TILT") {
        return None;
    }
    let upper = word.to_ascii_uppercase();
    Some(if matches!(&*upper, "NONE" | "INCLUDE") { upper } else { word.to_string() })
}

/// Lines that end in a line feed, a carriage return, or both.
struct Lines<'a> {
    rest: &'a [u8],
    number: usize,
}

impl<'a> Lines<'a> {
    fn next_line(&mut self) -> Option<&'a [u8]> {
        if self.rest.is_empty() {
            return None;
        }
        let end = self.rest.iter().position(|b| matches!(b, b'\n' | b'\r'));
        let (line, rest) = self.rest.split_at(end.unwrap_or(self.rest.len()));
        self.rest = match rest {
            [b'\r', b'\n', rest @ ..] | [_, rest @ ..] => rest,
            [] => rest,
        };
        self.number += 1;
        Some(line)
    }
}

/// Numbers behind each other, wherever lines end.
struct Numbers<'a> {
    path: &'a Path,
    lines: Lines<'a>,
    line: &'a [u8],
    at: usize,
}

impl<'a> Numbers<'a> {
    fn error(&self, what: impl Into<String>, remedy: impl Into<String>) -> SceneError {
        SceneError::line(self.path, self.lines.number.max(1), what, remedy)
    }

    fn word(&mut self) -> Option<&'a [u8]> {
        // A control-Z ends old files.
        let blank = |b: &u8| b.is_ascii_whitespace() || matches!(b, b',' | b';' | 0x1a);
        loop {
            let left = &self.line[self.at..];
            if let Some(first) = left.iter().position(|b| !blank(b)) {
                let word = &left[first..];
                let word = &word[..word.iter().position(blank).unwrap_or(word.len())];
                self.at += first + word.len();
                return Some(word);
            }
            self.line = self.lines.next_line()?;
            self.at = 0;
        }
    }

    fn number(&mut self, what: &str) -> Result<f64, SceneError> {
        let Some(word) = self.word() else {
            let remedy = "the file is cut short: fetch it again";
            return Err(self.error(format!("ends where {what} is wanted"), remedy));
        };
        let number = crate::input::number(word).filter(|v| v.abs() <= 1e12);
        number.ok_or_else(|| {
            self.error(
                format!("\"{}\" where {what} is wanted", excerpt(word)),
                "correct the file, or the counts before it",
            )
        })
    }

    /// One of a few.
    fn choice(&mut self, what: &str, of: &[u32]) -> Result<u32, SceneError> {
        let value = self.number(what)?;
        of.iter().copied().find(|&c| f64::from(c) == value).ok_or_else(|| {
            let known: Vec<String> = of.iter().map(u32::to_string).collect();
            self.error(format!("{what} is {value}"), format!("LM-63 knows {}", known.join(", ")))
        })
    }

    fn count(&mut self, what: &str, least: usize) -> Result<usize, SceneError> {
        let value = self.number(what)?;
        if value.fract() != 0.0 || value < least as f64 || value > MOST as f64 {
            let remedy = format!("a whole number from {least} to {MOST} is wanted");
            return Err(self.error(format!("{what} is {value}"), remedy));
        }
        Ok(value as usize)
    }

    fn factor(&mut self, what: &str) -> Result<f64, SceneError> {
        let value = self.number(what)?;
        if value < 0.0 {
            return Err(self.error(format!("{what} is {value}"), "it cannot be below zero"));
        }
        Ok(value)
    }

    fn angles(&mut self, what: &str, count: usize) -> Result<Vec<f64>, SceneError> {
        let mut angles: Vec<f64> = Vec::with_capacity(count);
        for _ in 0..count {
            let angle = self.number(&format!("a {what} angle"))?;
            if angles.last().is_some_and(|&last| angle < last + 2.0 * SAME) {
                let last = angles.last().copied().unwrap_or_default();
                return Err(self.error(
                    format!("the {what} angle {angle} comes behind {last}"),
                    "angles must ascend: correct them, or their number",
                ));
            }
            angles.push(angle);
        }
        Ok(angles)
    }

    fn tilt(&mut self) -> Result<Tilt, SceneError> {
        let geometry = self.choice("the lamp-to-luminaire geometry", &[1, 2, 3])?;
        let count = self.count("the number of tilt angles", 1)?;
        let angles = self.angles("tilt", count)?;
        let factors =
            (0..count).map(|_| self.factor("a tilt factor")).collect::<Result<Vec<_>, _>>()?;
        Ok(Tilt { geometry, angles, factors })
    }

    fn luminaire(mut self, edition: u32, tilt: Option<Tilt>) -> Result<Photometry, SceneError> {
        let mut warnings = Vec::new();
        let lamps = self.factor("the number of lamps")?;
        let lamp_lumens = self.number("the lumens of a lamp")?;
        let multiplier = self.factor("the multiplier")?;
        let rows = self.count("the number of vertical angles", 2)?;
        let columns = self.count("the number of horizontal angles", 1)?;
        let kind = match self.choice("the photometric type", &[1, 2, 3])? {
            1 => PhotometricType::C,
            2 => PhotometricType::B,
            _ => PhotometricType::A,
        };
        let feet = self.choice("the type of units", &[1, 2])? == 1;
        let mut opening_m = [0.0; 3];
        for size in &mut opening_m {
            *size = self.number("a size of the luminous opening")? * if feet { FOOT } else { 1.0 };
        }
        let ballast_factor = self.factor("the ballast factor")?;
        let other = self.factor("the ballast-lamp factor")?;
        let input_watts = self.number("the input watts")?;
        // "Future use" in 2002, the kind of test in 2019.
        let lamp_factor = if edition >= 2002 { 1.0 } else { other };
        let vertical = self.angles("vertical", rows)?;
        self.check_vertical(kind, &vertical)?;
        let horizontal = self.angles("horizontal", columns)?;
        self.check_horizontal(kind, &horizontal)?;
        let scale = multiplier * ballast_factor * lamp_factor;
        let mut candela = Vec::with_capacity((rows * columns).min(self.lines.rest.len()));
        for h in &horizontal {
            for v in &vertical {
                let value = self.number("an intensity")?;
                if value < 0.0 {
                    return Err(self.error(
                        format!("the intensity {value} at vertical {v}, horizontal {h}"),
                        "intensities cannot be below zero",
                    ));
                }
                candela.push(value * scale);
            }
        }
        // What follows should be nothing; words are harmless, numbers are not.
        if let Some(word) = self.word()
            && crate::input::number(word).is_some()
        {
            warnings.push(format!(
                "line {}: more numbers than {rows} x {columns} intensities are left out",
                self.lines.number
            ));
        }
        let edges = [(0, vertical[0]), (rows - 1, vertical[rows - 1])];
        for (row, angle) in edges {
            let sharp = (angle / 90.0 - (angle / 90.0).round()).abs() * 90.0 > SAME;
            if sharp && (0..columns).any(|plane| candela[plane * rows + row] > 0.0) {
                warnings.push(format!("it is dark beyond the vertical angle {angle}"));
            }
        }
        Ok(Photometry {
            edition,
            kind,
            lamps,
            lamp_lumens: (lamp_lumens >= 0.0).then_some(lamp_lumens),
            multiplier,
            ballast_factor,
            lamp_factor,
            feet,
            opening_m,
            input_watts,
            vertical,
            horizontal,
            candela,
            tilt,
            warnings,
        })
    }

    fn check_vertical(&self, kind: PhotometricType, angles: &[f64]) -> Result<(), SceneError> {
        let (low, high) = match kind {
            PhotometricType::A => (-90.0, 90.0),
            PhotometricType::B => (-180.0, 180.0),
            PhotometricType::C => (0.0, 180.0),
        };
        let (first, last) = (angles[0], angles[angles.len() - 1]);
        if first >= low - SAME && last <= high + SAME {
            return Ok(());
        }
        Err(self.error(
            format!("vertical angles from {first} to {last}, of photometric type {kind:?}"),
            format!("they lie between {low} and {high}: is the type right?"),
        ))
    }

    fn check_horizontal(&self, kind: PhotometricType, angles: &[f64]) -> Result<(), SceneError> {
        let (first, last) = (angles[0], angles[angles.len() - 1]);
        let near = |a: f64, b: f64| (a - b).abs() < SAME;
        let (good, known) = match kind {
            PhotometricType::C => (
                angles.len() == 1
                    || near(first, 0.0)
                        && (near(last, 90.0) || last > 180.0 - SAME && last < 360.0 + SAME)
                    || near(first, 90.0) && near(last, 270.0),
                "they go from 0 to 0, 90, 180 or 360, or from 90 to 270",
            ),
            PhotometricType::A => (
                angles.len() == 1
                    || near(first, 0.0) && last < 180.0 + SAME
                    || first > -180.0 - SAME && first < 0.0 && last < 180.0 + SAME,
                "they go from 0 or -90 to 90",
            ),
            PhotometricType::B => (
                angles.len() > 1
                    && (near(first, 0.0) || first > -90.0 - SAME && first < 0.0)
                    && last < 90.0 + SAME,
                "they go from 0 or -90 to 90",
            ),
        };
        if good {
            return Ok(());
        }
        Err(self.error(
            format!("horizontal angles from {first} to {last}, of photometric type {kind:?}"),
            known,
        ))
    }
}

impl Photometry {
    /// The intensities in the angles that a store has: polar angle and azimuth in the frame of
    /// [`Photometry::frame`], symmetries kept as folds.
    pub fn samples(&self) -> Samples {
        let (rows, planes) = (self.vertical.len(), self.horizontal.len());
        let at = |row: usize, plane: usize| self.candela[plane * rows + row];
        let turned = |degrees: f64| snap(degrees).to_radians();
        match self.kind {
            PhotometricType::C => {
                let (first, last) = (snap(self.horizontal[0]), snap(self.horizontal[planes - 1]));
                // Planes up to 345 and not up to 360 close the circle with the first one.
                let closes = planes > 1 && last > 180.0 && last < 360.0 && first == 0.0;
                let folds = match last - first {
                    _ if planes == 1 => 1,
                    90.0 => 4,
                    180.0 => 2,
                    _ => 1,
                };
                let mut azimuth: Vec<f64> =
                    self.horizontal.iter().map(|&h| turned(h) - first.to_radians()).collect();
                if planes == 1 {
                    azimuth = vec![0.0];
                }
                if closes {
                    azimuth.push(360f64.to_radians());
                }
                let columns = azimuth.len();
                Samples {
                    polar: self.vertical.iter().map(|&v| turned(v).max(0.0)).collect(),
                    folds,
                    origin: if planes == 1 { 0.0 } else { first.to_radians() },
                    candela: (0..rows)
                        .flat_map(|row| (0..columns).map(move |c| (row, c % planes)))
                        .map(|(row, plane)| at(row, plane))
                        .collect(),
                    azimuth,
                }
            }
            PhotometricType::A => {
                let mirrored = planes > 1 && snap(self.horizontal[0]) == 0.0;
                let first = if planes == 1 { self.horizontal[0] } else { snap(self.horizontal[0]) };
                Samples {
                    polar: self
                        .vertical
                        .iter()
                        .rev()
                        .map(|&v| (FRAC_PI_2 - turned(v)).max(0.0))
                        .collect(),
                    azimuth: self.horizontal.iter().map(|&h| turned(h) - turned(first)).collect(),
                    folds: if mirrored { 2 } else { 1 },
                    origin: if planes == 1 { 0.0 } else { turned(first) },
                    candela: (0..rows)
                        .rev()
                        .flat_map(|row| (0..planes).map(move |plane| (row, plane)))
                        .map(|(row, plane)| at(row, plane))
                        .collect(),
                }
            }
            PhotometricType::B => {
                // Horizontal angles from 0 on are mirrored: they are polar angles here, so they are written out.
                let mirrored = snap(self.horizontal[0]) == 0.0;
                let mut lines: Vec<(f64, usize)> =
                    self.horizontal.iter().enumerate().map(|(i, &h)| (turned(h), i)).collect();
                if mirrored {
                    let left: Vec<_> = lines[1..].iter().rev().map(|&(h, i)| (-h, i)).collect();
                    lines.splice(0..0, left);
                }
                Samples {
                    polar: lines.iter().map(|&(h, _)| (FRAC_PI_2 + h).max(0.0)).collect(),
                    azimuth: self
                        .vertical
                        .iter()
                        .map(|&v| turned(v) - turned(self.vertical[0]))
                        .collect(),
                    folds: 1,
                    origin: turned(self.vertical[0]),
                    candela: lines
                        .iter()
                        .flat_map(|&(_, plane)| (0..rows).map(move |row| (row, plane)))
                        .map(|(row, plane)| at(row, plane))
                        .collect(),
                }
            }
        }
    }

    /// Axis and tangent of a light, from the direction that the file calls straight down and the one of
    /// horizontal angle 0 square to it.
    pub fn frame(&self, down: DVec3, zero: DVec3) -> (DVec3, DVec3) {
        match self.kind {
            PhotometricType::C => (down, zero),
            PhotometricType::A => (-down, zero),
            PhotometricType::B => (zero.cross(down), down),
        }
    }

    /// Luminous flux, lm, with lamps as they are when the luminaire points down: the integral of the
    /// intensities, bilinear in the angles, over the sphere.
    pub fn lumens(&self) -> f64 {
        self.samples().lumens()
    }

    /// Share of the lamps' lumens when the luminaire is tilted by so many degrees from straight down; 1
    /// without tilt data. Beyond the data their ends count.
    pub fn tilt_factor(&self, degrees: f64) -> f64 {
        let Some(tilt) = &self.tilt else { return 1.0 };
        let at = tilt.angles.partition_point(|&a| a <= degrees);
        if at == 0 || at == tilt.angles.len() {
            return tilt.factors[at.saturating_sub(1)];
        }
        let (a, b) = (tilt.angles[at - 1], tilt.angles[at]);
        let s = (degrees - a) / (b - a);
        tilt.factors[at - 1] * (1.0 - s) + tilt.factors[at] * s
    }
}

/// A multiple of 90 degrees, if it is meant.
fn snap(degrees: f64) -> f64 {
    let quarter = (degrees / 90.0).round() * 90.0;
    if (degrees - quarter).abs() < SAME { quarter } else { degrees }
}
