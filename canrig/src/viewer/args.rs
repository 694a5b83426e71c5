//! The command line of the live view.

use clap::Args;

use super::ViewerAddress;

/// Where to show what happens.
#[derive(Args, Clone, Debug, Default)]
pub struct ViewerArgs {
    /// Open the Rerun viewer and show the run in it while it goes on
    #[arg(long)]
    pub viewer: bool,
    /// Show the run in a viewer that is already open: PORT on this machine, HOST:PORT, or the viewer's own address
    #[arg(long, value_name = "ADDRESS")]
    pub rerun_connect: Option<ViewerAddress>,
}
