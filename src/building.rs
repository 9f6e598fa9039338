//! `enfilade building`: the generator's command line.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use enf_building::{BuildingError, Kind, Request, Summary};
use enf_stage::{Failure, Result};

/// The kinds of buildings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum KindArg {
    /// Two wings around a corner: 27 rooms, 24 lights, about 336,500 triangles on two floors.
    LShape,
}

/// `enfilade building`.
#[derive(Args, Debug)]
pub(crate) struct BuildingArgs {
    /// What to build
    kind: KindArg,
    /// Number of floors [default: 2]
    #[arg(long, value_name = "N")]
    floors: Option<u32>,
    /// Seed of the furniture's placement
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// The scene file to write; meshes go beside it
    #[arg(short, long, value_name = "SCENE.toml")]
    output: PathBuf,
    /// Overwrite another building
    #[arg(long)]
    force: bool,
}

fn failure(error: BuildingError) -> Failure {
    match error {
        BuildingError::Io { .. } => Failure::io(error.to_string()),
        _ => Failure::usage(error.to_string()),
    }
}

/// Generates a building, unless another scene is in the way.
pub(crate) fn generate(request: &Request, output: &Path, force: bool) -> Result<Summary> {
    let building = enf_building::design(request).map_err(failure)?;
    let stem = output.file_stem().unwrap_or_default().to_string_lossy();
    let folder = format!("{stem}.meshes");
    if let Ok(found) = std::fs::read(output)
        && !force
        && found != enf_building::write::scene(&building, &folder).as_bytes()
    {
        return Err(Failure::usage(format!("{} holds another scene", output.display()))
            .with_hint("--force overwrites it"));
    }
    enf_building::write::write(&building, output).map_err(failure)?;
    Ok(building.summary())
}

/// Runs the subcommand.
pub(crate) fn run(args: &BuildingArgs) -> Result<()> {
    let kind = match args.kind {
        KindArg::LShape => Kind::LShape,
    };
    let request = Request { kind, floors: args.floors, seed: args.seed };
    let summary = generate(&request, &args.output, args.force)?;
    eprintln!(
        "enfilade: {}: {} triangles, {} rooms, {} lights; views: {}",
        args.output.display(),
        summary.triangles,
        summary.rooms,
        summary.lights,
        summary.views.join(", ")
    );
    Ok(())
}
