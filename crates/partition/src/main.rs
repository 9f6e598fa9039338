//! `enf-partition`: the stage alone, for shell pipes and batch jobs.

use std::process::ExitCode;

use clap::Parser;
use enf_partition::Cli;
use enf_stage::{Failure, IdSink, interrupt, run_main};

fn main() -> ExitCode {
    run_main("enf-partition", || {
        let cli = Cli::try_parse().map_err(Failure::from)?;
        interrupt::install()?;
        enf_partition::run(&cli, &IdSink::stdout()).map(drop)
    })
}
