//! `canrig simulate`: scenarios in one process and virtual time.

use clap::Args;

use crate::event::{Listener, RunEvent};
use crate::exit::Exit;
use crate::play::{PlayArgs, Testbed, play_all};
use crate::terminal::Terminal;
use recording::capture::Capture;
use recording::frame_queue::WhenFull;
use recording::run_folder::RunFolder;
use rig::setup::Setup;
use worlds::{Played, WorldError, lockstep};

/// Arguments of `simulate`.
#[derive(Args, Debug)]
pub struct SimulateArgs {
    #[command(flatten)]
    pub play: PlayArgs,
}

/// Plays the scenarios; the worst exit of all.
#[must_use]
pub fn simulate(args: &SimulateArgs) -> Exit {
    let terminal = Terminal::new(args.play.json, args.play.quiet);
    let where_and_when = "bus: modelled · clock: lock-step, in one process";
    terminal.on_event(&RunEvent::Note(where_and_when.to_owned()));
    play_all(&args.play, &OneProcess, &terminal)
}

/// All nodes in this process, on a modelled bus.
struct OneProcess;

impl Testbed for OneProcess {
    fn prepare(&self, setup: Setup) -> Result<Setup, String> {
        Ok(setup)
    }

    fn when_full(&self) -> WhenFull {
        WhenFull::Wait
    }

    fn play(
        &self,
        setup: &Setup,
        _folder: &RunFolder,
        capture: &mut Capture<'_>,
    ) -> Result<Played, WorldError> {
        lockstep::simulate(setup, capture).map(Played::in_virtual_time)
    }
}
