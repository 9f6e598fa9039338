//! What can be typed.

use std::path::PathBuf;

use clap::Parser;

use crate::number::count;
use crate::ours::Kind;

/// The same rooms and the same rays, through our structures and through the real Embree, in turn.
///
/// Prints a table for each scene: rates in millions a second as medians of the repetitions, by the clock on the wall
/// and by the process's own CPU time, and ours over Embree's as the median of ratios of neighbouring runs.
#[derive(Debug, Parser)]
#[command(version)]
pub struct Args {
    /// Rooms to draw and measure: roomN with any number of triangles (room12k), and rooms32, a building
    #[arg(long, value_delimiter = ',', default_values = ["room12k", "room60k", "room450k", "rooms32"])]
    pub rooms: Vec<String>,

    /// Measure PREFIX.vtx (f32 x, y, z), PREFIX.idx (3 x u32) and PREFIX.light instead of drawn rooms; repeatable
    #[arg(long, value_name = "PREFIX")]
    pub scene: Vec<PathBuf>,

    /// Rays of each kind (k and M are thousands and millions)
    #[arg(long, value_parser = rays, default_value = "1M")]
    pub rays: u64,

    /// Repetitions of every measurement, after one that does not count
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub repetitions: u32,

    /// Numbers of threads to ask with; structures are always built with one
    #[arg(long, value_delimiter = ',', default_values_t = [1, 2], value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub threads: Vec<u32>,

    /// Structures of ours; the first one is what Embree is compared with
    #[arg(long, value_delimiter = ',', value_enum, default_values_t = [Kind::Bvh])]
    pub structures: Vec<Kind>,

    /// Queries that we are given at a time, where they come in batches
    #[arg(long, value_parser = count, default_value = "64k")]
    pub batch: u64,

    /// Seed of the photons
    #[arg(long, default_value_t = 1)]
    pub seed: u64,

    /// Embree's shared library, or a folder that holds it
    #[arg(long, env = "EMBREE_LIBRARY", value_name = "PATH")]
    pub library: Option<PathBuf>,

    /// Write every figure to a file as well
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,

    /// Write the drawn rooms to a folder (NAME.vtx, .idx, .light, as --scene reads them) and measure nothing
    #[arg(long, value_name = "FOLDER")]
    pub save: Option<PathBuf>,
}

/// A number of rays: what fits into memory several times over.
fn rays(text: &str) -> Result<u64, String> {
    match count(text)? {
        n @ 1000..=100_000_000 => Ok(n),
        n => Err(format!("{n} rays: 1k to 100M")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts() {
        assert_eq!(count("12"), Ok(12));
        assert_eq!(count("60k"), Ok(60_000));
        assert_eq!(count("2M"), Ok(2_000_000));
        assert_eq!(rays("1M"), Ok(1_000_000));
        assert!(rays("999").is_err() && rays("101M").is_err());
        for bad in ["", "k", "0", "-1", "1.5M", "99999999999999999G", "ä"] {
            assert!(count(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn the_command_line_is_sound() {
        use clap::CommandFactory;
        Args::command().debug_assert();
        let args = Args::try_parse_from(["bench-embree", "--threads", "1"]).unwrap();
        assert_eq!((args.rays, args.threads.as_slice()), (1_000_000, [1].as_slice()));
    }
}
