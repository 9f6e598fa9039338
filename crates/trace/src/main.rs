//! `enf-trace`: the stage alone, for shell pipes and batch jobs.

use std::process::ExitCode;

use clap::Parser;
use enf_stage::{Failure, IdSink, interrupt, run_main};
use enf_trace::Cli;

fn main() -> ExitCode {
    run_main("enf-trace", || {
        let cli = Cli::try_parse().map_err(Failure::from)?;
        interrupt::install()?;
        enf_trace::run(
            &cli,
            enf_stage::stdin_ids(cli.all_rooms).quiet(cli.common.quiet),
            &IdSink::stdout(),
        )
        .map(drop)
    })
}
