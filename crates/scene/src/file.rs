//! `scene.toml` and `views.toml`: what the tables may say, and errors with lines.
//!
//! The format is described in this crate's README.

use crate::{
    InputFile, SceneError,
    frame::{Placements, Up},
    input,
    mtl::Spec,
};
use serde::{
    Deserialize, Deserializer,
    de::{DeserializeOwned, Error as _, SeqAccess, Visitor},
};
use std::{collections::BTreeMap, f64::consts::PI, fmt, path::Path};
use toml::Spanned;

/// Lumens per watt of the scalar flux (the project's fixed luminous efficacy).
pub const LUMENS_PER_WATT: f64 = 179.0;

/// The scalar of a linear Rec.709 colour.
pub fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// A whole scene file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SceneFile {
    pub(crate) name: Option<Spanned<String>>,
    pub(crate) units: Option<Units>,
    pub(crate) up: Option<Up>,
    #[serde(default)]
    pub(crate) mesh: Vec<Spanned<MeshTable>>,
    #[serde(default)]
    pub(crate) material: Vec<Spanned<MaterialTable>>,
    #[serde(default)]
    pub(crate) light: Vec<Spanned<LightTable>>,
    pub(crate) sky: Option<Spanned<crate::sky::SkyTable>>,
    #[serde(default)]
    pub(crate) room: Vec<Spanned<RoomTable>>,
    #[serde(default)]
    pub(crate) view: Vec<Spanned<ViewTable>>,
}

/// A file of views.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ViewsFile {
    #[serde(default)]
    pub(crate) view: Vec<Spanned<ViewTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MeshTable {
    pub(crate) file: String,
    pub(crate) name: Option<String>,
    pub(crate) door: Option<bool>,
    pub(crate) instances: Option<Placements>,
    pub(crate) instances_file: Option<String>,
    #[serde(default)]
    pub(crate) materials: BTreeMap<String, String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MaterialTable {
    pub(crate) name: String,
    kd: Option<Rgb>,
    ks: Option<Rgb>,
    ke: Option<Rgb>,
    tf: Option<Rgb>,
    d: Option<f64>,
    #[serde(alias = "index")]
    ni: Option<f64>,
    roughness: Option<f64>,
    metallic: Option<f64>,
    solid: Option<bool>,
    absorption: Option<Rgb>,
    mirror: Option<Rgb>,
    glass: Option<bool>,
    lumens: Option<f64>,
    candela: Option<f64>,
    watts: Option<Rgb>,
    color: Option<Rgb>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct LightTable {
    pub(crate) name: Option<String>,
    pub(crate) kind: PointKind,
    pub(crate) position: [f64; 3],
    #[serde(alias = "axis", alias = "aim")]
    pub(crate) direction: Option<[f64; 3]>,
    pub(crate) target: Option<[f64; 3]>,
    pub(crate) inner: Option<f64>,
    pub(crate) outer: Option<f64>,
    pub(crate) file: Option<String>,
    pub(crate) turn: Option<f64>,
    scale: Option<f64>,
    lumens: Option<f64>,
    candela: Option<f64>,
    watts: Option<Rgb>,
    color: Option<Rgb>,
}

#[derive(Clone, Copy, Deserialize, PartialEq, Eq)]
pub(crate) enum PointKind {
    #[serde(rename = "point")]
    Point,
    #[serde(rename = "lambert-point")]
    LambertPoint,
    #[serde(rename = "spot")]
    Spot,
    #[serde(rename = "ies")]
    Ies,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RoomTable {
    pub(crate) name: Option<String>,
    pub(crate) min: Option<[f64; 3]>,
    pub(crate) max: Option<[f64; 3]>,
    pub(crate) polygon: Option<Vec<[f64; 2]>>,
    pub(crate) z: Option<[f64; 2]>,
    pub(crate) file: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ViewTable {
    pub(crate) name: Option<String>,
    pub(crate) kind: Option<String>,
    pub(crate) eye: [f64; 3],
    pub(crate) target: Option<[f64; 3]>,
    pub(crate) up: Option<[f64; 3]>,
    pub(crate) fov: Option<f64>,
    pub(crate) size: Option<f64>,
    pub(crate) width: Option<u32>,
    pub(crate) height: Option<u32>,
}

/// Metres per unit.
#[derive(Clone, Copy)]
pub(crate) struct Units(pub(crate) f64);

/// Metres in a unit of this name.
fn unit(name: &str) -> Option<f64> {
    Some(match name {
        "m" => 1.0,
        "cm" => 0.01,
        "mm" => 0.001,
        "ft" => 0.3048,
        "in" => 0.0254,
        _ => return None,
    })
}

/// Reads `m`, `cm`, `mm`, `ft`, `in` or a number of metres, as for `--units`.
pub fn parse_units(text: &str) -> Result<f64, String> {
    unit(text)
        .or_else(|| text.parse().ok())
        .filter(|u| usable_unit(*u))
        .ok_or_else(|| format!("\"{text}\" is no unit: give m, cm, mm, ft, in or metres per unit"))
}

pub(crate) fn usable_unit(metres: f64) -> bool {
    (1e-9..=1e9).contains(&metres)
}

impl<'de> Deserialize<'de> for Units {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct V;
        impl Visitor<'_> for V {
            type Value = Units;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("units: \"m\", \"cm\", \"mm\", \"ft\", \"in\" or metres per unit")
            }
            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Units, E> {
                unit(text)
                    .map(Units)
                    .ok_or_else(|| E::invalid_value(serde::de::Unexpected::Str(text), &self))
            }
            fn visit_f64<E: serde::de::Error>(self, v: f64) -> Result<Units, E> {
                if usable_unit(v) {
                    Ok(Units(v))
                } else {
                    Err(E::invalid_value(serde::de::Unexpected::Float(v), &self))
                }
            }
            fn visit_i64<E: serde::de::Error>(self, v: i64) -> Result<Units, E> {
                self.visit_f64(v as f64)
            }
        }
        deserializer.deserialize_any(V)
    }
}

/// A colour, or one number for all three channels; never negative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rgb {
    values: [f64; 3],
    /// It was one number.
    single: bool,
}

impl Rgb {
    /// Its three channels.
    pub(crate) fn values(self) -> [f64; 3] {
        self.values
    }
}

impl<'de> Deserialize<'de> for Rgb {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct V;
        fn checked<E: serde::de::Error>(values: [f64; 3], single: bool) -> Result<Rgb, E> {
            match values.iter().find(|v| !(0.0..=1e20).contains(*v)) {
                Some(bad) => Err(E::custom(format!("{bad} is out of range: give 0 or more"))),
                None => Ok(Rgb { values, single }),
            }
        }
        impl<'de> Visitor<'de> for V {
            type Value = Rgb;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("[red, green, blue] or one number")
            }
            fn visit_f64<E: serde::de::Error>(self, v: f64) -> Result<Rgb, E> {
                checked([v; 3], true)
            }
            fn visit_i64<E: serde::de::Error>(self, v: i64) -> Result<Rgb, E> {
                checked([v as f64; 3], true)
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Rgb, A::Error> {
                let mut values = [0.0; 3];
                for (i, v) in values.iter_mut().enumerate() {
                    *v = seq.next_element()?.ok_or_else(|| A::Error::invalid_length(i, &self))?;
                }
                if seq.next_element::<f64>()?.is_some() {
                    return Err(A::Error::invalid_length(4, &self));
                }
                checked(values, false)
            }
        }
        deserializer.deserialize_any(V)
    }
}

/// Flux, W, of one light, from at most one of the three ways to say how strong it is.
/// `lumens_per_candela` depends on how the light spreads: pi for a Lambertian one, 4 pi for a point.
fn flux(
    lumens: Option<f64>,
    candela: Option<f64>,
    watts: Option<Rgb>,
    color: Option<Rgb>,
    lumens_per_candela: f64,
) -> Result<Option<[f64; 3]>, String> {
    let scalar = match (lumens, candela, watts) {
        (None, None, None) => {
            return match color {
                Some(_) => {
                    Err("\"color\" needs \"lumens\", \"candela\" or \"watts\" beside it".into())
                }
                None => Ok(None),
            };
        }
        (Some(lm), None, None) => lm / LUMENS_PER_WATT,
        (None, Some(cd), None) => cd * lumens_per_candela / LUMENS_PER_WATT,
        (None, None, Some(w)) if w.single => w.values[0],
        (None, None, Some(w)) if color.is_none() => return Ok(Some(w.values)),
        (None, None, Some(_)) => {
            return Err("\"watts\" of three channels and \"color\" exclude each other".into());
        }
        _ => return Err("give only one of \"lumens\", \"candela\" and \"watts\"".into()),
    };
    if !(0.0..=1e20).contains(&scalar) {
        return Err(format!("a light of {scalar} W is out of range: give 0 or more"));
    }
    let color = color.map_or([1.0; 3], |c| c.values);
    let of = luminance(color);
    if of <= 0.0 {
        return Err("a light's \"color\" is black: give a colour above 0".into());
    }
    Ok(Some(color.map(|c| c / of * scalar)))
}

impl MaterialTable {
    /// Completes or overrides what an MTL file says.
    pub(crate) fn apply(&self, spec: &mut Spec) -> Result<(), String> {
        let rgb = |c: Option<Rgb>| c.map(|c| c.values);
        let power = flux(self.lumens, self.candela, self.watts, self.color, PI)?;
        if power.is_some() && self.ke.is_some() {
            return Err("\"ke\" and \"lumens\", \"candela\" or \"watts\" exclude each other".into());
        }
        for (key, value) in [("d", self.d), ("ni", self.ni)] {
            if value.is_some_and(|v| !(0.0..=1e3).contains(&v)) {
                return Err(format!("\"{key}\" is out of range"));
            }
        }
        for (key, value) in [("roughness", self.roughness), ("metallic", self.metallic)] {
            if value.is_some_and(|v| !(0.0..=1.0).contains(&v)) {
                return Err(format!("\"{key}\" is from 0 to 1"));
            }
        }
        if self.solid == Some(true) && (self.mirror.is_some() || self.glass.is_some()) {
            return Err("\"solid = true\" excludes \"mirror\" and \"glass\"".into());
        }
        if self.absorption.is_some() && self.solid != Some(true) {
            return Err("\"absorption\" needs \"solid = true\" beside it".into());
        }
        if self.mirror.is_some() && self.glass == Some(true) {
            return Err("\"mirror\" and \"glass = true\" exclude each other".into());
        }
        if self.kd.is_some() {
            spec.kd = rgb(self.kd);
            spec.kd_final = true;
        }
        spec.ks = rgb(self.ks).or(spec.ks);
        spec.tf = rgb(self.tf).or(spec.tf);
        spec.d = self.d.or(spec.d);
        spec.ni = self.ni.or(spec.ni);
        spec.pr = self.roughness.or(spec.pr);
        spec.pm = self.metallic.or(spec.pm);
        spec.solid = self.solid.unwrap_or(spec.solid);
        spec.absorption = rgb(self.absorption).or(spec.absorption);
        spec.mirror = rgb(self.mirror).or(spec.mirror);
        spec.glass = self.glass.or(spec.glass);
        if self.glass == Some(true) {
            spec.mirror = None;
        }
        let opaque = self.mirror.is_some() || spec.solid;
        if self.glass.is_none() && !opaque && self.tf.is_some() {
            spec.glass = Some(true);
        }
        if let Some(ke) = rgb(self.ke) {
            (spec.ke, spec.power) = (Some(ke), None);
        }
        if let Some(power) = power {
            let dark = power.iter().all(|&w| w == 0.0);
            (spec.ke, spec.power) = (None, (!dark).then_some(power));
        }
        Ok(())
    }
}

impl LightTable {
    /// Keys that its kind has no use for.
    pub(crate) fn check(&self) -> Result<(), String> {
        let spot = self.kind == PointKind::Spot;
        let ies = self.kind == PointKind::Ies;
        let keys = [
            ("inner", self.inner.is_some(), spot, "spot"),
            ("outer", self.outer.is_some(), spot, "spot"),
            ("file", self.file.is_some(), ies, "ies"),
            ("turn", self.turn.is_some(), ies, "ies"),
            ("scale", self.scale.is_some(), ies, "ies"),
        ];
        if let Some((key, _, _, kind)) = keys.iter().find(|k| k.1 && !k.2) {
            return Err(format!("\"{key}\" is for lights of kind \"{kind}\""));
        }
        if ies && self.candela.is_some() {
            return Err(
                "the intensities are in the IES file: give \"lumens\" or \"scale\" instead of \
                        \"candela\""
                    .into(),
            );
        }
        if self.direction.is_some() && self.target.is_some() {
            return Err("give only one of \"direction\" and \"target\"".into());
        }
        if let Some(turn) = self.turn.filter(|t| !t.is_finite()) {
            return Err(format!("\"turn\" is {turn}"));
        }
        Ok(())
    }

    /// Flux, W, of a light that has so many lumens a candela.
    pub(crate) fn flux(&self, lumens_per_candela: f64) -> Result<[f64; 3], String> {
        flux(self.lumens, self.candela, self.watts, self.color, lumens_per_candela)?
            .ok_or_else(|| "a light needs \"lumens\", \"candela\" or \"watts\"".into())
    }

    /// Flux, W, of a luminaire that has so many lumens unless the table says otherwise.
    pub(crate) fn luminaire_flux(&self, lumens: f64) -> Result<[f64; 3], String> {
        let said = self.lumens.is_some() || self.watts.is_some();
        if said && self.scale.is_some() {
            return Err("give only one of \"lumens\", \"watts\" and \"scale\"".into());
        }
        if said {
            return self.flux(0.0);
        }
        crate::lamps::coloured(lumens * self.scale.unwrap_or(1.0), self.color.map(|c| c.values))
    }
}

/// A TOML file with the text kept for line numbers.
pub(crate) struct Parsed<T> {
    pub(crate) value: T,
    text: String,
    path: std::path::PathBuf,
}

impl<T> Parsed<T> {
    /// An error at a table or value.
    pub(crate) fn error<U>(
        &self,
        at: &Spanned<U>,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> SceneError {
        SceneError::line(&self.path, line_of(&self.text, at.span().start), what, remedy)
    }
}

fn line_of(text: &str, offset: usize) -> usize {
    1 + text.as_bytes().iter().take(offset).filter(|&&b| b == b'\n').count()
}

/// Reads and checks a TOML file against a schema.
pub(crate) fn parse<T: DeserializeOwned>(
    path: &Path,
) -> Result<(Parsed<T>, InputFile), SceneError> {
    let (text, input) = input::read_text(path)?;
    match toml::from_str(&text) {
        Ok(value) => Ok((Parsed { value, text, path: path.into() }, input)),
        Err(error) => {
            let line = error.span().map_or(1, |s| line_of(&text, s.start));
            let at = text.lines().nth(line - 1).unwrap_or_default().trim();
            let what = error.message().trim().replace('\n', ", ");
            let at = crate::obj::excerpt(at.as_bytes());
            Err(SceneError::line(
                path,
                line,
                if at.is_empty() { what } else { format!("{what}, in \"{at}\"") },
                "correct the line (the format is described in crates/scene/README.md)",
            ))
        }
    }
}

/// Reads an instance file: one placement a line, numbers separated by blanks or commas.
pub(crate) fn read_instances(path: &Path) -> Result<(Placements, InputFile), SceneError> {
    let mut lines = input::Lines::open(path)?;
    let mut out = Placements::default();
    let mut numbers = Vec::new();
    while lines.advance()? {
        let text = lines.text();
        let text = text.split(|&b| b == b'#').next().unwrap_or(text);
        numbers.clear();
        for word in text.split(|&b| b == b',' || b.is_ascii_whitespace()) {
            if word.is_empty() {
                continue;
            }
            match input::number(word) {
                Some(v) => numbers.push(v),
                None => {
                    return Err(lines.error(
                        format!("\"{}\" is no number", crate::obj::excerpt(word)),
                        "write one instance a line, such as x y z degrees scale",
                    ));
                }
            }
        }
        if !numbers.is_empty() {
            out.push(&numbers).map_err(|e| lines.error(e, "correct the line"))?;
        }
    }
    out.shrink();
    Ok((out, lines.finish()?))
}

/// Names become file names of stores and pictures.
pub(crate) fn name_problem(name: &str) -> Option<String> {
    let bad = name.is_empty()
        || name.starts_with('.')
        || name.len() > 120
        || name.chars().any(|c| c.is_control() || "/\\:*?\"<>|".contains(c));
    bad.then(|| format!("the name {name:?} cannot be used in a file name"))
}
