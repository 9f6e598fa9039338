//! `enfilade`: the driver. Every stage is a subcommand; `run` is all of them in one process.
#![forbid(unsafe_code)]

mod building;
mod inspect;
mod pipeline;
mod plan;
mod summary;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use enf_stage::{Failure, IdSink, Result, interrupt, run_main, stdin_ids};

/// Global illumination for buildings that do not fit in memory.
#[derive(Parser, Debug)]
#[command(name = "enfilade", version, about, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Generate a furnished building and light it: pictures and a summary in ./enfilade-demo/
    Demo(Box<pipeline::DemoArgs>),
    /// Do everything: from a building file to pictures, lux and a summary
    Run(Box<pipeline::RunArgs>),
    /// Generate a furnished building
    Building(building::BuildingArgs),
    /// Say what is in a store, and whether it is sound
    Inspect(inspect::InspectArgs),
    /// Turn a building file into rooms, portals and tiles (enf-partition)
    Partition(Box<enf_partition::Cli>),
    /// Build the acceleration structure of every room (enf-grid)
    Grid(enf_grid::Cli),
    /// Trace photons room by room (enf-trace)
    Trace(enf_trace::Cli),
    /// Build the photon map of every room (enf-kdtree)
    Kdtree(enf_kdtree::Cli),
    /// Render pictures from a store (enf-render)
    Render(Box<enf_render::Cli>),
}

fn main() -> ExitCode {
    run_main("enfilade", || {
        let cli = Cli::try_parse().map_err(Failure::from)?;
        interrupt::install()?;
        dispatch(cli.command)
    })
}

fn dispatch(command: Command) -> Result<()> {
    let out = IdSink::stdout();
    let ids = |all: bool, quiet: bool| stdin_ids(all).quiet(quiet);
    match command {
        Command::Demo(args) => pipeline::demo(&args),
        Command::Run(args) => pipeline::run(&args),
        Command::Building(args) => building::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Partition(cli) => enf_partition::run(&cli, &out).map(drop),
        Command::Grid(cli) => {
            enf_grid::run(&cli, ids(cli.all_rooms, cli.common.quiet), &out).map(drop)
        }
        Command::Trace(cli) => {
            enf_trace::run(&cli, ids(cli.all_rooms, cli.common.quiet), &out).map(drop)
        }
        Command::Kdtree(cli) => {
            enf_kdtree::run(&cli, ids(cli.all_rooms, cli.common.quiet), &out).map(drop)
        }
        Command::Render(cli) => {
            enf_render::run(&cli, ids(cli.all_rooms, cli.common.quiet), &out).map(drop)
        }
    }
}
