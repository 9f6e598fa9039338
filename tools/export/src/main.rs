//! `enf-export`: a scene for Mitsuba or Radiance, and pictures side by side.
#![forbid(unsafe_code)]

use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{ArgGroup, Args, Parser, Subcommand};
use enf_export::building::Building;
use enf_export::compare::{self, compare};
use enf_export::{mitsuba, radiance, view};
use enf_partition::{DoorsArg, UpArg};
use enf_scene::{LoadOptions, Up, parse_units};
use enf_stage::{ExitStatus, Failure, Result};

/// Write a scene for another renderer, or compare its picture with ours.
#[derive(Parser, Debug)]
#[command(name = "enf-export", version, args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    export: Option<Export>,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Compare our picture with that of another renderer: mean radiance, ratios and relMSE, in all and room by room
    Compare(Compare),
}

#[derive(Args, Debug)]
#[command(group = ArgGroup::new("format").args(["mitsuba", "radiance"]).required(true).multiple(true))]
struct Export {
    /// A scene file, a model (.obj, .obj.zst, .gltf, .glb), or a store (.enf)
    #[arg(value_name = "SCENE|STORE", required = true)]
    scene: PathBuf,
    /// Write scene.xml, VIEW.xml and meshes for Mitsuba 3 into this folder
    #[arg(long, value_name = "DIR")]
    mitsuba: Option<PathBuf>,
    /// Write scene.rad and VIEW.vf for Radiance into this folder
    #[arg(long, value_name = "DIR")]
    radiance: Option<PathBuf>,
    /// A view of the scene; repeatable [default: all]
    #[arg(long, value_name = "NAME")]
    view: Vec<String>,
    /// Picture width, pixels [default: the view's, else 960]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=65536))]
    width: Option<u32>,
    /// Picture height, pixels [default: the view's, else 600]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=65536))]
    height: Option<u32>,
    /// Metres per unit of a scene or model: m, cm, mm, ft, in or a number
    #[arg(long, value_name = "UNIT", value_parser = parse_units)]
    units: Option<f64>,
    /// Up axis of a scene or model
    #[arg(long, value_enum)]
    up: Option<UpArg>,
    /// Doors of a scene or model
    #[arg(long, value_enum, default_value_t)]
    doors: DoorsArg,
}

#[derive(Args, Debug)]
struct Compare {
    /// Our picture; layers are used where it has them
    #[arg(value_name = "OURS.exr")]
    ours: PathBuf,
    /// Theirs, the reference: any linear RGB picture
    #[arg(value_name = "THEIRS.exr")]
    theirs: PathBuf,
    /// Only pixels that see this room and no other
    #[arg(long, value_name = "N")]
    mask_room: Option<u32>,
    /// Only pixels darker than this in both, W/m2/sr by luminance: without lamps
    #[arg(long, value_name = "RADIANCE")]
    below: Option<f32>,
    /// A layer of ours in place of all light: direct or indirect
    #[arg(long, value_name = "NAME")]
    layer: Option<String>,
    /// Exit with 1 if a mean differs by more than this share, in all or in a room of 1 % of the pixels or more
    #[arg(long, value_name = "SHARE", default_value_t = 0.01)]
    tolerance: f64,
}

fn export(cli: &Export) -> Result<()> {
    let options = LoadOptions {
        units: cli.units,
        up: cli.up.map(Up::from),
        doors: cli.doors.into(),
        ..LoadOptions::default()
    };
    let building = Building::read(&cli.scene, &options)?;
    let views = view::chosen(&building.views, &cli.view, cli.width, cli.height)?;
    let mut said = building.warnings.clone();
    if views.is_empty() {
        said.push("the scene has no view: only what is to be seen is written".into());
    }
    if building.lights.is_empty() {
        said.push("no light is written: pictures will be black".into());
    }
    for (name, folder, write) in [
        ("mitsuba", &cli.mitsuba, mitsuba::write as fn(&_, &_, &_) -> _),
        ("radiance", &cli.radiance, radiance::write),
    ] {
        if let Some(folder) = folder {
            let notes = write(&building, &views, folder)?;
            said.extend(notes.0.into_iter().map(|n| format!("{name}: {n}")));
        }
    }
    let mut text = String::new();
    for line in said {
        text += &format!("enf-export: {line}\n");
    }
    // A reader that is gone does not make the files worse.
    let _ = std::io::stderr().write_all(text.as_bytes());
    Ok(())
}

fn compare_pictures(cli: &Compare) -> Result<()> {
    let read =
        |path: &PathBuf| enf_image::read_exr(path).map_err(|e| Failure::input(e.to_string()));
    let options =
        compare::Options { mask_room: cli.mask_room, below: cli.below, layer: cli.layer.clone() };
    let found = compare(&read(&cli.ours)?, &read(&cli.theirs)?, &options)?;
    match std::io::stdout().write_all(found.table().as_bytes()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            return Err(Failure::io(format!("cannot print: {e}")));
        }
        _ => {}
    }
    let off = found.off();
    // Written so that what is no number fails.
    if off <= cli.tolerance {
        return Ok(());
    }
    Err(Failure::new(
        ExitStatus::Negative,
        format!(
            "means differ by {:.2} %, and {:.2} % are allowed",
            100.0 * off,
            100.0 * cli.tolerance
        ),
    ))
}

fn main() -> ExitCode {
    enf_stage::run_main("enf-export", || {
        let cli = Cli::try_parse()?;
        match (&cli.command, &cli.export) {
            (Some(Command::Compare(pictures)), _) => compare_pictures(pictures),
            (None, Some(scene)) => export(scene),
            (None, None) => Err(Failure::usage("nothing to do").with_hint("enf-export --help")),
        }
    })
}
