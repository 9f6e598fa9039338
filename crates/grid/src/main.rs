//! `enf-grid`: the stage alone, for shell pipes and batch jobs.

use std::process::ExitCode;

use clap::Parser;
use enf_grid::Cli;
use enf_stage::{Failure, IdSink, interrupt, run_main};

fn main() -> ExitCode {
    run_main("enf-grid", || {
        let cli = Cli::try_parse().map_err(Failure::from)?;
        interrupt::install()?;
        enf_grid::run(
            &cli,
            enf_stage::stdin_ids(cli.all_rooms).quiet(cli.common.quiet),
            &IdSink::stdout(),
        )
        .map(drop)
    })
}
