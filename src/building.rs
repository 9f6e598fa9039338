//! `enfilade building`: the generator's command line.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use enf_building::{Building, BuildingError, Format, Kind, Request, Summary};
use enf_stage::{Failure, Result};

/// The kinds of buildings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum KindArg {
    /// Two wings around a corner: 27 rooms, 24 lights, about 336,500 triangles on two floors.
    LShape,
    /// A college on one floor: 22 rooms, 15 lights, 1.07 million triangles.
    ZBuilding,
    /// Rings of rooms around a hall on three floors: 232 rooms, 155 lights, 5.2 million triangles.
    Octagon,
    /// A slab of 100 floors: 17,800 rooms, 61,000 lights, 1.07 billion triangles.
    Tower,
}

/// What to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum FormatArg {
    /// A scene file that places meshes: small, whatever the building.
    Scene,
    /// One OBJ with its MTL, for other programs: up to 20 million triangles.
    Obj,
}

/// `enfilade building`.
#[derive(Args, Debug)]
pub(crate) struct BuildingArgs {
    /// What to build
    kind: KindArg,
    /// Number of floors [default: 2 for l-shape, 1 for z-building, 3 for octagon, 100 for tower]
    #[arg(long, value_name = "N")]
    floors: Option<u32>,
    /// Seed of the furniture's placement
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// What to write [default: obj when the output ends in .obj, else scene]
    #[arg(long, value_enum, value_name = "FORMAT")]
    format: Option<FormatArg>,
    /// The scene file or OBJ to write; meshes or materials go beside it
    #[arg(short, long, value_name = "FILE")]
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

/// Whether `output` holds something else than what would be written.
fn in_the_way(building: &Building, output: &Path, format: Format) -> bool {
    use std::io::Read as _;
    let (expected, most) = match format {
        Format::Scene => {
            let stem = output.file_stem().unwrap_or_default().to_string_lossy();
            (enf_building::write::scene(building, &format!("{stem}.meshes")), u64::MAX)
        }
        // The first line names the building.
        Format::Obj => {
            let line = enf_building::write::expanded::title(building);
            let most = line.len() as u64;
            (line, most)
        }
    };
    let Ok(file) = std::fs::File::open(output) else { return false };
    let mut found = Vec::new();
    file.take(most).read_to_end(&mut found).is_ok() && found != expected.as_bytes()
}

/// Generates a building, unless something else is in the way.
pub(crate) fn generate_as(
    request: &Request,
    output: &Path,
    format: Format,
    force: bool,
) -> Result<Summary> {
    let building = enf_building::design(request).map_err(failure)?;
    if !force && in_the_way(&building, output, format) {
        return Err(Failure::usage(format!("{} holds another scene", output.display()))
            .with_hint("--force overwrites it"));
    }
    match format {
        Format::Scene => enf_building::write::write(&building, output).map_err(failure)?,
        Format::Obj => enf_building::write::expanded::write(&building, output).map_err(failure)?,
    }
    Ok(building.summary())
}

/// Generates a building as a scene, unless another one is in the way.
pub(crate) fn generate(request: &Request, output: &Path, force: bool) -> Result<Summary> {
    generate_as(request, output, Format::Scene, force)
}

/// Runs the subcommand.
pub(crate) fn run(args: &BuildingArgs) -> Result<()> {
    let kind = match args.kind {
        KindArg::LShape => Kind::LShape,
        KindArg::ZBuilding => Kind::ZBuilding,
        KindArg::Octagon => Kind::Octagon,
        KindArg::Tower => Kind::Tower,
    };
    let implied = args.output.extension().is_some_and(|e| e.eq_ignore_ascii_case("obj"));
    let format = match args.format {
        Some(FormatArg::Obj) => Format::Obj,
        None if implied => Format::Obj,
        Some(FormatArg::Scene) if implied => {
            return Err(Failure::usage(format!(
                "{}: a scene file ends in .toml",
                args.output.display()
            ))
            .with_hint("--format obj writes one OBJ"));
        }
        Some(FormatArg::Scene) | None => Format::Scene,
    };
    let request = Request { kind, floors: args.floors, seed: args.seed };
    let summary = generate_as(&request, &args.output, format, args.force)?;
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
