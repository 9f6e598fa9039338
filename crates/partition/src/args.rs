//! The command line.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use enf_rooms::RoomCount;
use enf_scene::{Doors, Up};
use enf_stage::CommonArgs;

use crate::luminaires::parse_lux;

/// More rooms (or random tiles) than this are not made by request.
const MOST_ROOMS: u32 = 65_536;

/// Which axis points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum UpArg {
    /// y, as in most modelling programs.
    Y,
    /// z, as in CAD and BIM.
    Z,
}

impl From<UpArg> for Up {
    fn from(up: UpArg) -> Self {
        match up {
            UpArg::Y => Self::Y,
            UpArg::Z => Self::Z,
        }
    }
}

/// `--doors`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum DoorsArg {
    /// Where the model has them.
    #[default]
    AsModelled,
    /// Objects recognised as doors are left out.
    Open,
}

impl From<DoorsArg> for Doors {
    fn from(doors: DoorsArg) -> Self {
        match doors {
            DoorsArg::AsModelled => Self::AsModelled,
            DoorsArg::Open => Self::Open,
        }
    }
}

/// `--hints`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum HintsArg {
    /// Boxes that the scene file calls rooms come first.
    #[default]
    Use,
    /// Rooms come from the walls alone.
    Ignore,
}

/// What decides about rooms, tiles and lights.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Scene options")]
pub struct PartitionArgs {
    /// How many rooms: a number, or auto for as many as the walls make
    #[arg(long, value_name = "N|auto", default_value = "auto", value_parser = parse_rooms)]
    pub rooms: Rooms,
    /// What becomes of the scene file's room boxes
    #[arg(long, value_enum, default_value_t)]
    pub hints: HintsArg,
    /// What becomes of doors
    #[arg(long, value_enum, default_value_t)]
    pub doors: DoorsArg,
    /// Metres per unit of the model [default: what the scene file says, else 1]
    #[arg(long, value_name = "METRES", value_parser = parse_units)]
    pub units: Option<f64>,
    /// Axis of the model that points up [default: what the scene file says, else z]
    #[arg(long, value_enum)]
    pub up: Option<UpArg>,
    /// Refuse models with bad lines, missing materials or vertices that are no numbers, instead of a warning
    #[arg(long)]
    pub strict: bool,
    /// Make textures smaller until all of them together take no more than this: later stages keep them in memory
    #[arg(long, value_name = "SIZE", default_value = "8M", value_parser = enf_stage::parse_size)]
    pub texture_memory: u64,
    /// Hang a luminaire in every room, sized for this illuminance (for models without lights)
    #[arg(long, value_name = "LUX", value_parser = parse_lux)]
    pub ceiling_lights: Option<f64>,
    /// Cut rooms with more triangles than this into tiles [default: what --memory allows]
    #[arg(long, value_name = "N", value_parser = enf_stage::parse_count)]
    pub tile_triangles: Option<u64>,
    /// Cut the scene into N tiles by random oblique planes through the furniture (for tests: nothing changes)
    #[arg(long, value_name = "N", hide = true,
        value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST_ROOMS)))]
    pub random_tiles: Option<u32>,
}

/// `--rooms`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rooms(
    /// How many.
    pub RoomCount,
);

fn parse_units(text: &str) -> std::result::Result<f64, String> {
    match text.parse::<f64>() {
        Ok(units) if units.is_finite() && units > 0.0 => Ok(units),
        _ => Err("a positive number of metres is wanted".into()),
    }
}

fn parse_rooms(text: &str) -> std::result::Result<Rooms, String> {
    match text {
        "auto" => Ok(Rooms(RoomCount::Auto)),
        _ => match text.parse() {
            Ok(n) if (1..=MOST_ROOMS).contains(&n) => Ok(Rooms(RoomCount::Exactly(n))),
            _ => Err(format!("a number from 1 to {MOST_ROOMS}, or auto")),
        },
    }
}

/// `enf-partition`: the command line.
#[derive(clap::Parser, Clone, Debug)]
#[command(
    name = "enf-partition",
    version,
    about = "Turn a building file into rooms, portals and tiles"
)]
pub struct Cli {
    /// The model: .obj, .obj.zst, .gltf, .glb or a scene file (.toml)
    #[arg(value_name = "SCENE")]
    pub scene: PathBuf,
    /// The store to make
    #[arg(short, long, value_name = "NAME.enf")]
    pub output: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub partition: PartitionArgs,
    /// Views that a later stage will ask for by name: refused before anything is computed if the scene has not got them.
    #[arg(skip)]
    pub views: Vec<String>,
    /// Discard another run's store
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub common: CommonArgs,
}
