//! `enfilade run` and `enfilade demo`: the five stages, one after the other, in one process.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use enf_building::{Kind, Request};
use enf_grid::GridArgs;
use enf_kdtree::KdtreeArgs;
use enf_partition::PartitionArgs;
use enf_render::RenderArgs;
use enf_stage::{CommonArgs, Failure, IdSink, IdSource, IoContext, Result, Stats, say, session};
use enf_trace::TraceArgs;
use serde_json::Value;

use crate::{building, summary};

/// Everything that the stages take.
#[derive(Args, Clone, Debug)]
pub(crate) struct StageArgs {
    #[command(flatten)]
    pub(crate) partition: PartitionArgs,
    #[command(flatten)]
    pub(crate) grid: GridArgs,
    #[command(flatten)]
    pub(crate) trace: TraceArgs,
    #[command(flatten)]
    pub(crate) kdtree: KdtreeArgs,
    #[command(flatten)]
    pub(crate) render: RenderArgs,
    /// Discard what another run left in the output folder
    #[arg(long)]
    pub(crate) force: bool,
    #[command(flatten)]
    pub(crate) common: CommonArgs,
}

/// `enfilade run`.
#[derive(Args, Debug)]
pub(crate) struct RunArgs {
    /// The model: .obj, .obj.zst or a scene file (.toml)
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// Folder for the store, the pictures and the summary
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    #[command(flatten)]
    stages: StageArgs,
}

/// `enfilade demo`.
#[derive(Args, Debug)]
pub(crate) struct DemoArgs {
    /// Folder for the scene, the store, the pictures and the summary
    #[arg(short, long, value_name = "DIR", default_value = "enfilade-demo")]
    output: PathBuf,
    #[command(flatten)]
    stages: StageArgs,
}

/// Photons per light of the demo: what the paper shot from each light of its L-Shape (section 7.2).
const DEMO_PHOTONS: u64 = 50_000;

/// Generates the L-shape and runs everything on it.
pub(crate) fn demo(args: &DemoArgs) -> Result<()> {
    let mut stages = args.stages.clone();
    if stages.trace.photons.is_none() {
        stages.trace.photons_per_light.get_or_insert(DEMO_PHOTONS);
        // A first look should be quick.
        stages.render.max_samples.get_or_insert(stages.render.samples);
    }
    if stages.render.view.is_empty() && stages.render.views.is_none() {
        stages.render.view.push("all".into());
    }
    std::fs::create_dir_all(&args.output).at("create", &args.output)?;
    let scene = args.output.join("l-shape.toml");
    let request = Request { kind: Kind::LShape, floors: None, seed: 1 };
    let built = building::generate(&request, &scene, stages.force)?;
    say(
        &stages.common,
        format!(
            "generated {}: {} triangles, {} rooms, {} lights",
            scene.display(),
            built.triangles,
            built.rooms,
            built.lights
        ),
    );
    everything(&scene, &args.output, &stages)
}

/// Runs everything on a scene.
pub(crate) fn run(args: &RunArgs) -> Result<()> {
    everything(&args.scene, &args.output, &args.stages)
}

/// The scene file's name without its endings: the store's, and the summary's title.
pub(crate) fn store_stem(scene: &Path) -> String {
    let name = scene.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    name.split('.').next().filter(|s| !s.is_empty()).unwrap_or("building").to_string()
}

fn everything(scene: &Path, output: &Path, args: &StageArgs) -> Result<()> {
    let started = Instant::now();
    if !scene.is_file() {
        return Err(Failure::input(format!("{}: there is no such file", scene.display()))
            .with_hint("the model is an .obj, .obj.zst or a scene file (.toml)"));
    }
    std::fs::create_dir_all(output).at("create", output)?;
    let mut report = Stats::begin(&args.common)?;
    session::share_timeline(&args.common)?;
    let store = output.join(format!("{}.enf", store_stem(scene)));
    let quiet_stage = CommonArgs { stats: None, trace: None, ..args.common.clone() };
    let nowhere = IdSink::nowhere();
    let mut stages: Vec<Value> = Vec::new();

    stages.push(enf_partition::run(
        &enf_partition::Cli {
            scene: scene.to_path_buf(),
            output: store.clone(),
            partition: args.partition.clone(),
            views: args.render.views_of_the_scene()?,
            force: args.force,
            common: quiet_stage.clone(),
        },
        &nowhere,
    )?);
    let all_rooms = true;
    stages.extend(enf_grid::run(
        &enf_grid::Cli {
            store: store.clone(),
            all_rooms,
            grid: args.grid.clone(),
            force: args.force,
            common: quiet_stage.clone(),
        },
        IdSource::all(),
        &nowhere,
    )?);
    stages.extend(enf_trace::run(
        &enf_trace::Cli {
            store: store.clone(),
            trace: args.trace.clone(),
            share: enf_trace::Share::default(),
            all_rooms,
            force: args.force,
            common: quiet_stage.clone(),
        },
        IdSource::all(),
        &nowhere,
    )?);
    stages.extend(enf_kdtree::run(
        &enf_kdtree::Cli {
            store: store.clone(),
            kdtree: args.kdtree.clone(),
            all_rooms,
            force: args.force,
            common: quiet_stage.clone(),
        },
        IdSource::all(),
        &nowhere,
    )?);
    let out = IdSink::stdout();
    stages.extend(enf_render::run(
        &enf_render::Cli {
            store: store.clone(),
            output: output.to_path_buf(),
            render: args.render.clone(),
            queue: args.trace.queue.clone(),
            all_rooms,
            force: args.force,
            common: quiet_stage.clone(),
        },
        IdSource::all(),
        &out,
    )?);
    session::end_timeline()?;

    for stage in &stages {
        report.merge(stage);
    }
    report.set("stages", stages.clone());
    let report = report.finish(&args.common, "run", started)?;
    let json = serde_json::to_string_pretty(&report).map_err(Failure::internal)?;
    let path = output.join("stats.json");
    std::fs::write(&path, json + "\n").at("write", &path)?;
    let text = summary::text(scene, &store, &args.common, &stages, &report);
    let path = output.join("summary.txt");
    std::fs::write(&path, &text).at("write", &path)?;
    if !args.common.quiet {
        eprint!("\n{text}");
    }
    Ok(())
}
