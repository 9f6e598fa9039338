//! The command line.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use enf_illumination::Kernel;
use enf_image::Tone;
use enf_scene::{Camera, Projection};
use enf_stage::{CommonArgs, Failure, Result, parse_count, parse_size};
use enf_trace::QueueArgs;

use crate::camera;

/// Rays that the rays of one job may send off.
const JOB_RAYS: u64 = 8192;

/// How a photon's weight falls with its distance ([`Kernel`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum KernelArg {
    /// Not at all, as in the paper: least noise.
    #[default]
    Constant,
    /// In a straight line: sharpest.
    Cone,
    /// As a parabola.
    Epanechnikov,
}

impl KernelArg {
    /// The kernel, and its name.
    pub(crate) fn kernel(self) -> (Kernel, &'static str) {
        match self {
            Self::Constant => (Kernel::Constant, "constant"),
            Self::Cone => (Kernel::Cone, "cone"),
            Self::Epanechnikov => (Kernel::Epanechnikov, "epanechnikov"),
        }
    }
}

/// Where indirect light comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Indirect {
    /// The photon maps, directly: quick, blurred, and blotched where photons are few
    #[default]
    PhotonMap,
    /// Gather rays from what is seen to what lights it; the photon maps answer there
    FinalGather,
    /// Nowhere: direct light alone
    None,
}

/// `--projection`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ProjectionArg {
    /// As a camera sees
    #[default]
    Perspective,
    /// Everything about the eye: longitude across, latitude down
    Panorama,
    /// From above, what is higher than the eye cut away
    Plan,
}

/// `--tone`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ToneArg {
    /// Highlights roll off
    #[default]
    Filmic,
    /// As it is; what is too bright is cut off
    Linear,
}

impl From<ToneArg> for Tone {
    fn from(tone: ToneArg) -> Self {
        match tone {
            ToneArg::Filmic => Self::Filmic,
            ToneArg::Linear => Self::Linear,
        }
    }
}

/// A kind of file that pictures are written to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// VIEW.png: what an eye would see
    Png,
    /// VIEW.exr: linear radiance, with layers for direct and indirect light, albedo, normal, depth and room
    Exr,
    /// VIEW.hdr: linear radiance, for Radiance and its relatives
    Hdr,
    /// VIEW.falsecolour.png: luminance in cd/m2, with a legend
    Falsecolour,
}

/// What `--formats` is when it is not given.
pub(crate) const DEFAULT_FORMATS: [Format; 2] = [Format::Png, Format::Exr];

impl Format {
    /// What the file of a view is called.
    pub(crate) fn file(self, view: &str) -> String {
        match self {
            Self::Png => format!("{view}.png"),
            Self::Exr => format!("{view}.exr"),
            Self::Hdr => format!("{view}.hdr"),
            Self::Falsecolour => format!("{view}.falsecolour.png"),
        }
    }

    /// By a file's name.
    pub(crate) fn of(name: &str) -> Option<Self> {
        let format = match name.rsplit_once('.')? {
            (stem, "png") if stem.ends_with(".falsecolour") => Self::Falsecolour,
            (_, "png") => Self::Png,
            (_, "exr") => Self::Exr,
            (_, "hdr") => Self::Hdr,
            _ => return None,
        };
        Some(format)
    }
}

/// What decides about the pictures.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Picture options")]
pub struct RenderArgs {
    /// A view by name, room:ID, panorama:ID or plan:ID (of a room, or its storey), auto (three viewpoints are found) or all (the scene's own); repeatable
    #[arg(long, value_name = "VIEW")]
    pub view: Vec<String>,
    /// More views: a file with [[view]] tables; without --view, all of them
    #[arg(long, value_name = "FILE")]
    pub views: Option<PathBuf>,
    /// A view from here, called camera; coordinates as in the model, and of a plan the picture's middle and the height of the cut
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true)]
    pub eye: Option<[f64; 3]>,
    /// What that view looks at
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_point, allow_hyphen_values = true, requires = "eye")]
    pub target: Option<[f64; 3]>,
    /// Its vertical field of view, degrees [default: 60]
    #[arg(long, value_name = "DEGREES", requires = "eye")]
    pub fov: Option<f64>,
    /// Its kind of picture
    #[arg(long, value_enum, default_value_t, requires = "eye")]
    pub projection: ProjectionArg,
    /// Height of what a plan from --eye shows, in the model's units [default: all of the storey]
    #[arg(long, value_name = "LENGTH", requires = "eye")]
    pub size: Option<f64>,
    /// Picture width, pixels [default: the view's, else 960]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=65536))]
    pub width: Option<u32>,
    /// Picture height, pixels [default: the view's, else 600, or what fits]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=65536))]
    pub height: Option<u32>,
    /// Camera rays per pixel
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=65536))]
    pub samples: u32,
    /// Camera rays of a pixel at most: beyond --samples only where the first ones differ by more than --noise [default: three times --samples, from four on; demo: none]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65536))]
    pub max_samples: Option<u32>,
    /// Error of a pixel, of its brightness, up to which it gets no more camera rays
    #[arg(long, value_name = "SHARE", default_value_t = 0.1, value_parser = parse_positive)]
    pub noise: f32,
    /// Shadow rays per shading point
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub light_samples: u32,
    /// Photons that irradiance is estimated from (k of the k nearest)
    #[arg(long, value_name = "N", default_value = "120", value_parser = parse_count)]
    pub gather_photons: u64,
    /// How their weights fall with distance
    #[arg(long, value_enum, default_value_t)]
    pub kernel: KernelArg,
    /// Where indirect light comes from
    #[arg(long, value_enum, default_value_t)]
    pub indirect: Indirect,
    /// Gather rays per pixel, with --indirect final-gather
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=65536))]
    pub gather_rays: u32,
    /// Gathered light is averaged over neighbouring pixels of a surface, as far as this share of the mean distance to what lights it; 0 turns that off
    #[arg(long, value_name = "SHARE", default_value_t = 0.25, value_parser = parse_share)]
    pub gather_smoothing: f32,
    /// Bytes of a room's photon map that are in memory at most, as far as that works. For tests: what is larger is in memory in part, and
    /// pictures are the same
    #[arg(long, value_name = "SIZE", hide = true, value_parser = parse_size)]
    pub map_memory: Option<u64>,
    /// Files per view, in a folder; one picture's name says itself what it is
    #[arg(
        long,
        value_enum,
        value_name = "FORMAT",
        value_delimiter = ',',
        default_values_t = DEFAULT_FORMATS
    )]
    pub formats: Vec<Format>,
    /// Exposure of PNG pictures: auto, a factor of linear radiance (W/m2/sr), or ev:N, an exposure value at ISO 100
    #[arg(long, value_name = "auto|FACTOR|ev:N", default_value = "auto", value_parser = parse_exposure, allow_hyphen_values = true)]
    pub exposure: Exposure,
    /// Tone mapping of PNG pictures
    #[arg(long, value_enum, default_value_t)]
    pub tone: ToneArg,
    /// End of the falsecolour scale, cd/m2 [default: found per picture]
    #[arg(long, value_name = "CD_M2", value_parser = parse_positive)]
    pub falsecolour_max: Option<f32>,
}

impl RenderArgs {
    /// Rays that a ray's point sends off at most, its own way on apart: those to the lights, to the sun, and for other light.
    pub(crate) fn asking(&self) -> u32 {
        let gather = match self.indirect {
            Indirect::FinalGather => self.gather_rays.div_ceil(self.samples) + 1,
            Indirect::PhotonMap => 1,
            Indirect::None => 0,
        };
        self.light_samples + 1 + gather
    }

    /// Photons of an estimate.
    pub(crate) fn estimate_photons(&self) -> u32 {
        self.gather_photons.clamp(2, 1 << 20) as u32
    }

    /// Rays of one job.
    pub(crate) fn job_rays(&self) -> u64 {
        (JOB_RAYS / u64::from(self.asking() + 1)).max(64)
    }

    /// Whether gathered light is smoothed.
    pub(crate) fn smooths(&self) -> bool {
        self.indirect == Indirect::FinalGather && self.gather_smoothing > 0.0
    }

    /// Camera rays that a pixel may have beyond the first ones.
    pub(crate) fn more_samples(&self) -> u32 {
        let most = match self.max_samples {
            Some(most) => most,
            // Two or three say too little, and who asks for so few is in a hurry.
            None if self.samples < 4 => 0,
            None => self.samples.saturating_mul(3),
        };
        // One cannot be told from itself.
        if self.samples < 2 { 0 } else { most.saturating_sub(self.samples) }
    }

    /// Views that must be in the scene, for they are asked for by name and are in no view file.
    ///
    /// # Errors
    /// Exit 4 for a bad view file, exit 2 for a camera that cannot be.
    pub fn views_of_the_scene(&self) -> Result<Vec<String>> {
        self.camera()?;
        camera::named(self)
    }

    /// The view of `--eye`.
    ///
    /// # Errors
    /// Exit 2 when it lacks a target, or has what its projection has not.
    pub(crate) fn camera(&self) -> Result<Option<Camera>> {
        let Some(eye) = self.eye else { return Ok(None) };
        let camera = Camera {
            projection: match self.projection {
                ProjectionArg::Perspective => Projection::Perspective,
                ProjectionArg::Panorama => Projection::Panorama,
                ProjectionArg::Plan => Projection::Plan,
            },
            eye,
            target: self.target,
            up: None,
            fov: self.fov,
            size: self.size,
            width: None,
            height: None,
        };
        // What is wrong with it is so in any frame.
        let frame = enf_scene::Frame { units: 1.0, up: enf_scene::Up::Z, origin: [0.0; 3] };
        camera
            .record(&frame)
            .map_err(|(what, remedy)| Failure::usage(format!("--eye: {what}")).with_hint(remedy))?;
        Ok(Some(camera))
    }
}

/// `--exposure`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exposure {
    /// Found per picture.
    Auto,
    /// What linear radiance is multiplied with.
    Factor(f32),
}

/// `enf-render`: the command line.
#[derive(clap::Parser, Clone, Debug)]
#[command(name = "enf-render", version, about = "Render pictures from a store, room by room")]
pub struct Cli {
    /// The store
    #[arg(value_name = "NAME.enf")]
    pub store: PathBuf,
    /// The picture (.exr, .png, .falsecolour.png or .hdr), or a folder for the files of each view [default: .]
    #[arg(short, long, value_name = "FILE|DIR", default_value = ".")]
    pub output: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub render: RenderArgs,
    /// Flags of the queue.
    #[command(flatten)]
    pub queue: QueueArgs,
    /// Do not read ids from standard input: start at once
    #[arg(long)]
    pub all_rooms: bool,
    /// Render anew: discard the film that is there, of the same pictures or of others, and overwrite the files
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub common: CommonArgs,
}

fn parse_point(text: &str) -> std::result::Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> =
        text.split(',').map(|n| n.trim().parse().ok().filter(|n: &f64| n.is_finite())).collect();
    numbers
        .and_then(|n| <[f64; 3]>::try_from(n).ok())
        .ok_or_else(|| "three numbers, as in 1.5,2,1.6".into())
}

fn parse_positive(text: &str) -> std::result::Result<f32, String> {
    match text.parse::<f32>() {
        Ok(n) if n.is_finite() && n > 0.0 => Ok(n),
        _ => Err("a number above 0".into()),
    }
}

fn parse_share(text: &str) -> std::result::Result<f32, String> {
    match text.parse::<f32>() {
        Ok(n) if (0.0..=1.0).contains(&n) => Ok(n),
        _ => Err("a number from 0 to 1".into()),
    }
}

fn parse_exposure(text: &str) -> std::result::Result<Exposure, String> {
    let factor = match text.strip_prefix("ev:") {
        _ if text == "auto" => return Ok(Exposure::Auto),
        Some(ev) => ev.parse().ok().map(enf_image::exposure_of_ev),
        None => text.parse().ok(),
    };
    match factor {
        Some(factor) if factor.is_finite() && factor > 0.0 => Ok(Exposure::Factor(factor)),
        _ => Err("auto, a factor above 0, or an exposure value as in ev:7".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_and_their_formats() {
        for format in [Format::Png, Format::Exr, Format::Hdr, Format::Falsecolour] {
            assert_eq!(Format::of(&format.file("a.view")), Some(format));
        }
        assert_eq!((Format::of("a.jpg"), Format::of("png")), (None, None));
    }

    #[test]
    fn exposures() {
        assert_eq!(parse_exposure("auto"), Ok(Exposure::Auto));
        assert_eq!(parse_exposure("0.5"), Ok(Exposure::Factor(0.5)));
        // EV 7 at ISO 100: white at 153.6 cd/m2, the sum of 0.858 W/m2/sr.
        let Ok(Exposure::Factor(factor)) = parse_exposure("ev:7") else { panic!() };
        assert!((factor * 153.6 / 179.0 - 1.0).abs() < 1e-6);
        for bad in ["", "ev:", "ev:x", "-1", "0", "nan", "ev:1e9"] {
            assert!(parse_exposure(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn points() {
        assert_eq!(parse_point("1,-2.5, 3"), Ok([1.0, -2.5, 3.0]));
        for bad in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,inf"] {
            assert!(parse_point(bad).is_err(), "{bad}");
        }
    }
}
