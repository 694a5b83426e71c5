//! The command line of sweeps.

use std::path::PathBuf;

use clap::Args;

use super::Shard;

/// Arguments of `sweep`.
#[derive(Args, Debug)]
pub struct SweepArgs {
    /// A scenario file with a [sweep] table
    pub scenario: PathBuf,
    /// Where the sweep's folder is made; one that is there goes on where it ended
    #[arg(long, value_name = "FOLDER", default_value = "runs")]
    pub output: PathBuf,
    /// Play a part only, such as 2/4: the second of four, for as many machines; `canrig merge` puts them together
    #[arg(long, value_name = "PART", default_value_t = Shard::WHOLE)]
    pub shard: Shard,
    /// Runs at a time; as many as there are cores if not given
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Print nothing but failures
    #[arg(long, short)]
    pub quiet: bool,
}

/// Arguments of `merge`.
#[derive(Args, Debug)]
pub struct MergeArgs {
    /// The folders that `canrig sweep --shard` made
    #[arg(required = true, value_name = "SHARD")]
    pub shards: Vec<PathBuf>,
    /// Where the folder of the whole sweep is made
    #[arg(long, value_name = "FOLDER", default_value = "runs")]
    pub output: PathBuf,
    /// Print nothing but failures
    #[arg(long, short)]
    pub quiet: bool,
}
