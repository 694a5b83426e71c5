//! `canrig eds`: the data sheet of each node of a rig, as files for other programs.

use std::path::PathBuf;

use clap::Args;
use runner::console::print;
use runner::exit::{Exit, Failure};
use runner::named::named_sheets;
use runner::output::write_new;

/// Arguments of `eds`.
#[derive(Args, Debug)]
pub(crate) struct EdsArgs {
    /// Rig file, scenario or folder of a run with the nodes
    #[arg(value_name = "RIG")]
    pub rig: PathBuf,
    /// Write the files to this folder; no file is overwritten
    #[arg(long, value_name = "FOLDER")]
    pub to: PathBuf,
}

/// Writes the EDS of each node, and prints the names of the files.
pub(crate) fn eds(args: &EdsArgs) -> Result<Exit, Failure> {
    for (node, eds) in named_sheets(&args.rig)? {
        let path = args.to.join(format!("{}.eds", node.name));
        write_new(&path, &eds)?;
        let id = node.id();
        print(&format!("{}  node {id} (0x{id:02X})", path.display()));
    }
    Ok(Exit::Pass)
}
