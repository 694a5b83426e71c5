//! `canrig simulate`: scenarios in one process and virtual time.

use clap::Args;

use crate::event::RunEvent;
use crate::exit::Exit;
use crate::play::{PlayArgs, Testbed, play_all, refuse_external};
use plan::Plan;
use recording::capture::Capture;
use recording::frame_queue::WhenFull;
use recording::run_folder::RunFolder;
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
    let listener = args.play.listener();
    let where_and_when = "bus: modelled · clock: lock-step, in one process";
    listener.on_event(&RunEvent::Note(where_and_when.to_owned()));
    play_all(&args.play, &OneProcess, &*listener)
}

/// All nodes in this process, on a modelled bus.
struct OneProcess;

impl Testbed for OneProcess {
    fn prepare(&self, plan: Plan) -> Result<Plan, String> {
        refuse_external(&plan)?;
        Ok(plan)
    }

    fn when_full(&self) -> WhenFull {
        WhenFull::Wait
    }

    fn play(
        &self,
        plan: &Plan,
        folder: &RunFolder,
        capture: &mut Capture<'_>,
    ) -> Result<Played, WorldError> {
        lockstep::simulate(plan, Some(folder.path()), capture).map(Played::in_virtual_time)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::event::Listener;
    use crate::play::{ValueArgs, ViewerArgs};

    struct Nobody;

    impl Listener for Nobody {
        fn on_event(&self, _event: &RunEvent<'_>) {}
    }

    #[test]
    fn the_worst_of_several_scenarios_decides_in_any_order() {
        let folder = tempfile::tempdir().unwrap();
        let scenario = |name: &str, limit: &str| {
            let path = folder.path().join(name);
            let text = format!(
                "schema = 1\nrig = \"sma_actuator\"\nname = \"{name}\"\nduration_seconds = 0.2\n[controller.pid]\n\
                 [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n[expect]\n{limit}"
            );
            fs::write(&path, text).unwrap();
            path
        };
        let met = scenario("met.toml", "");
        let missed = scenario("missed.toml", "current_amperes_rms = { max = 0.0 }\n");
        let exit = |scenarios: [&std::path::PathBuf; 2]| {
            let args = PlayArgs {
                scenarios: scenarios.map(Clone::clone).into(),
                output: folder.path().join("runs"),
                json: false,
                events: false,
                quiet: true,
                strict: false,
                compress_above: 600.0,
                values: ValueArgs::default(),
                viewer: ViewerArgs::default(),
            };
            play_all(&args, &OneProcess, &Nobody)
        };
        assert_eq!(exit([&met, &met]), Exit::Pass);
        assert_eq!(exit([&missed, &met]), Exit::VerdictFailed);
        assert_eq!(exit([&met, &missed]), Exit::VerdictFailed);
    }
}
