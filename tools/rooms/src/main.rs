//! `enf-rooms-truth`: a partitioned store, or a model, against the architect's own rooms.
#![forbid(unsafe_code)]

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use enf_rooms::{Bsp, Options, RoomCount};
use enf_rooms_truth::found::{Found, Partitioned};
use enf_rooms_truth::score::score;
use enf_rooms_truth::truth::{self, Truth};
use enf_rooms_truth::{hints::hints, table};
use enf_stage::tables::Tables;
use enf_stage::{Failure, Result};
use enf_store::{MemoryBudget, StoreDir};

/// Compare the rooms of a building with those in its truth file.
#[derive(Parser, Debug)]
#[command(name = "enf-rooms-truth", version)]
struct Cli {
    /// A partitioned store (.enf), or a model or scene file, which is then partitioned in memory
    #[arg(value_name = "BUILDING")]
    building: PathBuf,
    /// The architect's spaces and doors
    #[arg(value_name = "NAME.truth.json")]
    truth: PathBuf,
    /// The solids of the spaces
    #[arg(value_name = "NAME.spaces.obj.zst")]
    spaces: Option<PathBuf>,
    /// Turn a model about the z axis before it is partitioned; for a store: how far its model was turned
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0, allow_negative_numbers = true)]
    turn: f64,
    /// Give the architect's spaces to the partitioner as hints (models only)
    #[arg(long)]
    hints: bool,
    /// List the doors that were found as well
    #[arg(long)]
    doors: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// What reading a store may hold in memory.
const BUDGET: u64 = 1 << 30;

fn compare(cli: &Cli, truth: &Truth, found: &dyn Found) -> Result<()> {
    let score = score(truth, found);
    let text = if cli.json {
        serde_json::to_string_pretty(&table::json(truth, &score)).map_err(Failure::internal)?
    } else {
        table::text(truth, &score, cli.doors)
    };
    match std::io::Write::write_all(
        &mut std::io::stdout(),
        format!("{}\n", text.trim_end()).as_bytes(),
    ) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Failure::io(format!("cannot print: {e}")))
        }
        _ => Ok(()),
    }
}

fn from_store(cli: &Cli, truth: &Truth) -> Result<()> {
    if cli.hints {
        return Err(Failure::usage(
            "--hints is for models: the rooms of a store are there already",
        ));
    }
    let store = StoreDir::open(&cli.building)?;
    let tables = Tables::open(&store, &MemoryBudget::new(BUDGET))?;
    let outside = tables.scene.outside;
    compare(
        cli,
        truth,
        &Partitioned {
            bsp: tables.bsp()?,
            portals: tables.portals(),
            outside: (outside != enf_layout::NONE).then_some(outside),
            origin: tables.scene.origin,
            turn: cli.turn.to_radians(),
        },
    )
}

fn from_model(cli: &Cli, truth: &Truth) -> Result<()> {
    let scene = enf_scene::load(&cli.building, &enf_scene::LoadOptions::default())
        .map_err(|e| Failure::input(e.to_string()))?;
    if scene.origin != [0.0; 3] && cli.turn != 0.0 {
        return Err(Failure::usage("a model far from its origin cannot be turned here")
            .with_hint("turn it by a [[mesh]] transform in a scene file"));
    }
    let (sin, cos) = (libm::sin(cli.turn.to_radians()), libm::cos(cli.turn.to_radians()));
    let (mut triangles, mut materials) = (Vec::new(), Vec::new());
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    scene
        .for_each_triangle(|t| {
            let corners = t.corners.map(|p| {
                let (x, y) = (f64::from(p[0]), f64::from(p[1]));
                if cli.turn == 0.0 {
                    p
                } else {
                    [(x * cos - y * sin) as f32, (x * sin + y * cos) as f32, p[2]]
                }
            });
            for p in corners {
                for k in 0..3 {
                    (min[k], max[k]) = (min[k].min(p[k]), max[k].max(p[k]));
                }
            }
            triangles.push(corners);
            materials.push(t.material);
        })
        .map_err(|e| Failure::input(e.to_string()))?;
    let opaque = |i: usize| {
        let material = scene.materials.get(materials[i] as usize);
        material.is_none_or(|m| m.record.flags & enf_layout::material::MATERIAL_SEE_THROUGH == 0)
    };
    let delta = scene.delta;
    let options = Options {
        delta,
        bounds_min: min,
        bounds_max: max,
        rooms: RoomCount::Auto,
        hints: if cli.hints {
            hints(truth, scene.origin, cli.turn.to_radians())
        } else {
            Vec::new()
        },
    };
    let tables = enf_rooms::partition(&triangles, &opaque, &options)
        .map_err(|e| Failure::input(format!("{}: {e}", cli.building.display())))?
        .finish(&triangles);
    let bsp =
        Bsp::new(&tables.planes, &tables.nodes, &tables.leaves, &tables.faces, f64::from(delta))
            .map_err(Failure::internal)?;
    compare(
        cli,
        truth,
        &Partitioned {
            bsp,
            portals: &tables.portals,
            outside: tables.outside,
            origin: scene.origin,
            turn: cli.turn.to_radians(),
        },
    )
}

fn main() -> ExitCode {
    enf_stage::run_main("enf-rooms-truth", || {
        let cli = Cli::try_parse()?;
        let truth = truth::load(&cli.truth, cli.spaces.as_deref())
            .map_err(|e| Failure::input(e.to_string()))?;
        if cli.building.is_dir() { from_store(&cli, &truth) } else { from_model(&cli, &truth) }
    })
}
