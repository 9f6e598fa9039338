//! Lamps that are points and shine one way more than another: spot lights, and luminaires from IES files.

use crate::{
    InputFile, SceneError,
    file::{LUMENS_PER_WATT, luminance},
    photometry::{self, PhotometricType, Photometry},
};
use enf_layout::{
    light::{LIGHT_POINT_LAMBERT, LIGHT_PROFILE, LIGHT_SPOT, LightRecord, cone_steradians},
    profile::ProfileRecord,
};
use glam::DVec3;
use std::{
    collections::{BTreeMap, btree_map::Entry},
    path::{Path, PathBuf},
};

/// Intensities of luminaires, each file once.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Profiles {
    /// Index = profile id.
    pub records: Vec<ProfileRecord>,
    /// Values of all of them: see [`ProfileRecord::first_value`].
    pub values: Vec<f32>,
    /// Names of the files, by profile.
    pub names: Vec<String>,
}

impl Profiles {
    /// Bytes on the heap.
    pub(crate) fn bytes(&self) -> usize {
        self.records.capacity() * size_of::<ProfileRecord>()
            + self.values.capacity() * 4
            + self.names.iter().map(|n| n.capacity() + size_of::<String>()).sum::<usize>()
    }
}

/// IES files that were read.
#[derive(Default)]
pub(crate) struct Luminaires {
    pub(crate) profiles: Profiles,
    pub(crate) inputs: Vec<InputFile>,
    pub(crate) warnings: Vec<String>,
    /// How the angles of each profile are counted.
    kinds: Vec<PhotometricType>,
    /// By where the file is.
    known: BTreeMap<PathBuf, Luminaire>,
}

/// An IES file that was read.
pub(crate) struct Luminaire {
    /// What it says, without the intensities.
    pub(crate) photometry: Photometry,
    /// Where those are.
    pub(crate) profile: u32,
    /// Its flux when it points down, lm.
    pub(crate) lumens: f64,
}

impl Luminaires {
    /// Reads an IES file, once.
    pub(crate) fn get(&mut self, path: &Path) -> Result<&Luminaire, SceneError> {
        let key = std::fs::canonicalize(path).unwrap_or_else(|_| path.into());
        match self.known.entry(key) {
            Entry::Occupied(known) => Ok(known.into_mut()),
            Entry::Vacant(new) => {
                let (mut photometry, input) = photometry::read(path)?;
                let samples = photometry.samples();
                let lumens = samples.lumens();
                let Some(record) = samples.store(&mut self.profiles.values) else {
                    return Err(SceneError::whole(
                        path,
                        format!(
                            "the luminaire has {lumens} lm: its intensities times the multipliers"
                        ),
                        "check the multiplier and the ballast factor, or leave the light out",
                    ));
                };
                let profile = self.profiles.records.len() as u32;
                self.profiles.records.push(record);
                self.kinds.push(photometry.kind);
                let name = path.file_name().unwrap_or_default().to_string_lossy();
                self.profiles.names.push(name.into_owned());
                self.inputs.push(input);
                let warned = photometry.warnings.iter().map(|w| format!("{}: {w}", path.display()));
                self.warnings.extend(warned);
                photometry.candela = Vec::new();
                Ok(new.insert(Luminaire { photometry, profile, lumens }))
            }
        }
    }
}

impl Luminaires {
    /// Moves a lamp that points somewhere a quarter of `delta` that way, as photons of area lights are: one that is
    /// mounted *in* a ceiling's plane shines from below it.
    pub(crate) fn step_out(&self, light: &mut LightRecord, delta: f32) {
        let ahead = match light.kind {
            LIGHT_SPOT | LIGHT_POINT_LAMBERT => light.axis,
            LIGHT_PROFILE => match self.kinds.get(light.profile as usize) {
                // What goes straight ahead lies on the equator of these.
                Some(PhotometricType::A | PhotometricType::B) => light.tangent,
                _ => light.axis,
            },
            _ => return,
        };
        for (p, a) in light.position.iter_mut().zip(ahead) {
            *p += 0.25 * delta * a;
        }
    }
}

/// Where a lamp points, and what it is turned by.
#[derive(Clone, Copy)]
pub(crate) struct Aim {
    /// Store coordinates, of length 1.
    pub(crate) down: DVec3,
    /// Counter-clockwise as seen from above for a lamp that points down, degrees.
    pub(crate) turn: f64,
}

impl Aim {
    /// The direction of a lamp's zero angle: `x` for a lamp that points down. Others are that one, tilted the
    /// shortest way.
    fn zero(&self) -> DVec3 {
        let a = self.down;
        let x = if a.z > 1.0 - 1e-9 {
            DVec3::X
        } else {
            DVec3::X - (a - DVec3::Z) * (a.x / (1.0 - a.z))
        };
        let x = (x - a * a.dot(x)).normalize_or(a.any_orthonormal_vector());
        let (sin, cos) = crate::frame::sin_cos_degrees(self.turn);
        x * cos + x.cross(a) * sin
    }

    /// Angle to straight down, degrees.
    pub(crate) fn tilt(&self) -> f64 {
        libm::atan2(self.down.truncate().length(), -self.down.z).to_degrees()
    }
}

fn single(v: DVec3) -> [f32; 3] {
    v.to_array().map(|c| c as f32 + 0.0)
}

/// A light's record.
pub(crate) fn measured(
    luminaire: &Luminaire,
    position: [f32; 3],
    aim: Aim,
    flux: [f64; 3],
) -> LightRecord {
    let (axis, tangent) = luminaire.photometry.frame(aim.down, aim.zero());
    LightRecord {
        kind: LIGHT_PROFILE,
        flux_w: flux.map(|v| v as f32),
        position,
        axis: single(axis),
        tangent: single(tangent),
        profile: luminaire.profile,
        ..LightRecord::DARK
    }
}

/// Cosines of a cone's angles, degrees from its axis; or what is wrong with them.
pub(crate) fn cone(inner: f64, outer: f64) -> Result<[f32; 2], String> {
    if !(0.1..=180.0).contains(&outer) {
        return Err(format!("\"outer\" is {outer} degrees: give 0.1 to 180, from the axis"));
    }
    if !(0.0..=outer).contains(&inner) {
        return Err(format!("\"inner\" is {inner} degrees: give 0 to \"outer\", which is {outer}"));
    }
    Ok([inner, outer].map(|d| crate::frame::sin_cos_degrees(d).1 as f32))
}

/// A spot light's record.
pub(crate) fn spot(
    position: [f32; 3],
    axis: [f32; 3],
    cone: [f32; 2],
    flux: [f64; 3],
) -> LightRecord {
    LightRecord {
        kind: LIGHT_SPOT,
        flux_w: flux.map(|v| v as f32),
        position,
        axis,
        cone,
        ..LightRecord::DARK
    }
}

/// Flux, W, of a spot light by its intensity on the axis, cd of each channel.
pub(crate) fn spot_flux(candela: [f64; 3], cone: [f32; 2]) -> [f64; 3] {
    candela.map(|cd| cd * cone_steradians(cone) / LUMENS_PER_WATT)
}

/// Flux, W, of a luminaire of so many lumens and a colour, white if none.
pub(crate) fn coloured(lumens: f64, color: Option<[f64; 3]>) -> Result<[f64; 3], String> {
    let color = color.unwrap_or([1.0; 3]);
    let of = luminance(color);
    let flux = color.map(|c| c / of * lumens / LUMENS_PER_WATT);
    if of <= 0.0 {
        return Err("a light's \"color\" is black: give a colour above 0".into());
    }
    if flux.iter().any(|w| !(0.0..=1e20).contains(w)) {
        return Err(format!("a light of {lumens} lm is out of range: give 0 or more"));
    }
    Ok(flux)
}
