//! Wavefront MTL, as written: what each material says, before it is mapped to what photons see.

use crate::{
    InputFile, SceneError,
    input::{Lines, keyword, name, number, words},
    obj::excerpt,
    texture::{Map, map_statement},
};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// What files say about a material; `None` where they say nothing.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Spec {
    /// `Kd`.
    pub(crate) kd: Option<[f64; 3]>,
    /// `kd` comes from a scene file: it is not scaled by `d`.
    pub(crate) kd_final: bool,
    /// `Ks`.
    pub(crate) ks: Option<[f64; 3]>,
    /// `Ke`, W/m²/sr.
    pub(crate) ke: Option<[f64; 3]>,
    /// `Tf`.
    pub(crate) tf: Option<[f64; 3]>,
    /// `d`, or 1 - `Tr`.
    pub(crate) d: Option<f64>,
    /// `Ni`.
    pub(crate) ni: Option<f64>,
    /// `Ns`, the exponent of Phong's highlight.
    pub(crate) ns: Option<f64>,
    /// `Pm`, metalness.
    pub(crate) pm: Option<f64>,
    /// `Pr`, roughness: the root of GGX's alpha.
    pub(crate) pr: Option<f64>,
    /// `illum`.
    pub(crate) illum: Option<u8>,
    /// Scene file: `glass`.
    pub(crate) glass: Option<bool>,
    /// Scene file: `mirror`.
    pub(crate) mirror: Option<[f64; 3]>,
    /// Scene file: `solid`.
    pub(crate) solid: bool,
    /// Scene file: `absorption` inside, 1/m.
    pub(crate) absorption: Option<[f64; 3]>,
    /// Scene file: flux of each light of this material, W.
    pub(crate) power: Option<[f64; 3]>,
    /// `map_Kd`.
    pub(crate) map_kd: Option<Map>,
    /// File of a `map_Kd` that is not there.
    pub(crate) lost_map: Option<PathBuf>,
    /// Some other `map_...` is given (and not used).
    pub(crate) textured: bool,
}

/// Reads an MTL file: materials by name. A name that comes twice keeps its last definition.
pub(crate) fn read(path: &Path) -> Result<(BTreeMap<String, Spec>, InputFile), SceneError> {
    let mut lines = Lines::open(path)?;
    let mut all: BTreeMap<String, Spec> = BTreeMap::new();
    let mut current: Option<(String, Spec)> = None;
    while lines.advance()? {
        let Some((key, rest)) = keyword(lines.text()) else { continue };
        if key == b"newmtl" {
            if rest.is_empty() {
                return Err(lines.error("newmtl without a name", "name the material"));
            }
            all.extend(current.take());
            current = Some((name(rest), Spec::default()));
            continue;
        }
        // Statements before the first newmtl belong to nothing.
        let Some((_, spec)) = &mut current else { continue };
        let one = || scalar(&lines, key, rest);
        match key {
            b"Kd" => spec.kd = colour(&lines, key, rest)?.or(spec.kd),
            b"Ks" => spec.ks = colour(&lines, key, rest)?.or(spec.ks),
            b"Ke" => spec.ke = colour(&lines, key, rest)?.or(spec.ke),
            b"Tf" => spec.tf = colour(&lines, key, rest)?.or(spec.tf),
            // "d -halo 0.5" makes it depend on the angle; the number is the one at the centre.
            b"d" => {
                let rest = rest.strip_prefix(b"-halo").unwrap_or(rest);
                spec.d = Some(scalar(&lines, key, rest)?);
            }
            b"Tr" => spec.d = Some(spec.d.unwrap_or(1.0 - one()?)),
            b"Ni" => spec.ni = Some(one()?),
            b"Ns" => spec.ns = Some(one()?),
            b"Pm" => spec.pm = Some(one()?),
            b"Pr" => spec.pr = Some(one()?),
            b"illum" => {
                let value = one()?;
                if !(0.0..=255.0).contains(&value) {
                    return Err(lines.error(
                        format!("illum {value} is no illumination model"),
                        "models are 0 to 10",
                    ));
                }
                spec.illum = Some(value as u8);
            }
            b"map_Kd" => match map_statement(rest, path) {
                Some(Ok(map)) => spec.map_kd = Some(map),
                Some(Err(path)) => spec.lost_map = Some(path),
                None => {
                    return Err(lines.error(
                        format!("map_Kd needs options and a file, not \"{}\"", excerpt(rest)),
                        "write map_Kd picture.png",
                    ));
                }
            },
            _ if key.starts_with(b"map_") => spec.textured = true,
            _ => {}
        }
    }
    all.extend(current);
    Ok((all, lines.finish()?))
}

fn usable(value: f64) -> bool {
    value.is_finite() && value.abs() <= 1e20
}

fn scalar(lines: &Lines, key: &[u8], rest: &[u8]) -> Result<f64, SceneError> {
    words(rest).next().and_then(number).filter(|&v| usable(v)).ok_or_else(|| {
        lines.error(
            format!("{} needs a number, not \"{}\"", excerpt(key), excerpt(rest)),
            "correct the line",
        )
    })
}

/// Three numbers, or one for all three; `None` for the spectral and CIE XYZ forms, which nobody writes.
fn colour(lines: &Lines, key: &[u8], rest: &[u8]) -> Result<Option<[f64; 3]>, SceneError> {
    let mut parts = words(rest).peekable();
    if matches!(parts.peek(), Some(&b"spectral" | &b"xyz")) {
        return Ok(None);
    }
    let values: Vec<Option<f64>> =
        parts.take(3).map(|w| number(w).filter(|&v| usable(v))).collect();
    match values[..] {
        [Some(r), Some(g), Some(b)] => Ok(Some([r, g, b])),
        [Some(v)] => Ok(Some([v; 3])),
        _ => Err(lines.error(
            format!("{} needs one or three numbers, not \"{}\"", excerpt(key), excerpt(rest)),
            "correct the line",
        )),
    }
}
