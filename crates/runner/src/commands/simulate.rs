//! `canrig simulate`: plays scenarios in one process and virtual time.

use std::time::Duration;

use clap::Args;

use super::watch::watch;
use crate::event::{Listener, RunEvent};
use crate::exit::{Exit, Failure};
use crate::play::{GuestArgs, PlayArgs, Testbed, in_virtual_time, play_all};
use crate::run::Judged;
use plan::Plan;
use recording::capture::{Capture, Watch};
use recording::frame_queue::WhenFull;
use recording::frames::Frames;
use recording::log::Stamped;
use recording::run_folder::RunFolder;
use worlds::{Played, WorldError, lockstep};

/// Arguments of `simulate`.
#[derive(Args, Debug)]
pub struct SimulateArgs {
    #[command(flatten)]
    pub play: PlayArgs,
    #[command(flatten)]
    pub guests: GuestArgs,
    /// Play each scenario twice, and name the first frame in which the two plays differ
    #[arg(long)]
    pub twice: bool,
    /// Play the scenario again whenever it, its rig, a table or its program changes, with a line
    /// for each play
    #[arg(long, conflicts_with_all = ["twice", "json", "events", "quiet"])]
    pub watch: bool,
}

/// Plays the scenarios and returns the worst exit of all.
pub fn simulate(args: &SimulateArgs) -> Result<Exit, Failure> {
    if args.watch {
        return watch(args);
    }
    let listener = args.play.listener();
    listener.on_note("bus: modelled · clock: lock-step, in one process".to_owned());
    let mut testbed = OneProcess::new(args, &*listener);
    let exit = play_all(&args.play, &mut testbed, &*listener)?;
    Ok(exit.max(testbed.exit))
}

/// Testbed with all of canrig's nodes in this process, on a modelled bus.
pub(super) struct OneProcess<'a> {
    args: &'a SimulateArgs,
    listener: &'a dyn Listener,
    /// Worst result of playing a scenario twice.
    exit: Exit,
}

impl<'a> OneProcess<'a> {
    pub(super) fn new(args: &'a SimulateArgs, listener: &'a dyn Listener) -> Self {
        Self {
            args,
            listener,
            exit: Exit::Pass,
        }
    }

    /// Plays the plan once more; describes the first frame that differs, `None` if all are the same.
    fn difference(
        &self,
        plan: &Plan,
        first: &Frames,
        watch: &Watch,
    ) -> Result<Option<String>, WorldError> {
        let mut second = Capture::in_memory(plan.scenario_clock()?, watch);
        let announce = |text: &str| self.listener.on_note(text.to_owned());
        let hosting = self.args.guests.hosting(None, &announce);
        lockstep::simulate(plan, &hosting, &mut second)?;
        let zero = second.zero();
        let (second, _) = second.finish(plan)?;
        Ok(difference(plan, zero, [first, &second]))
    }
}

/// Describes the first frame in which two plays differ, with its sender and its time; `None` if they are the same.
fn difference(plan: &Plan, zero: Option<Duration>, [one, other]: [&Frames; 2]) -> Option<String> {
    let (mut one, mut other) = (one.iter(), other.iter());
    let mut place = 0;
    let frames = loop {
        place += 1;
        match [one.next(), other.next()] {
            [None, None] => return None,
            [one, other] if one == other => {}
            different => break different,
        }
    };
    let times = frames.iter().flatten().map(|frame| frame.time);
    let earliest = times.min()?;
    let database = plan.database();
    let sender = |frame: &Stamped| {
        let message = database.message_of(&frame.frame);
        message.and_then(|message| message.sender.clone())
    };
    let told = frames.map(|frame| match frame {
        Some(frame) => {
            let sender = sender(&frame).map_or_else(String::new, |sender| format!(" of {sender}"));
            let seconds = frame.time.as_secs_f64();
            format!("{}{sender} at {seconds:.6} s of the bus", frame.frame)
        }
        None => "no frame any more".to_owned(),
    });
    let when = match zero.and_then(|zero| earliest.checked_sub(zero)) {
        Some(time) => format!("at {:.6} s", time.as_secs_f64()),
        None => "before the scenario began".to_owned(),
    };
    let [one, other] = told;
    Some(format!(
        "two plays differ {when}, in frame {place}: {one} in the first, {other} in the second"
    ))
}

impl Testbed for OneProcess<'_> {
    fn external(&self) -> &[String] {
        &self.args.guests.external
    }

    fn prepare(&self, plan: Plan) -> Result<Plan, String> {
        in_virtual_time(plan, &self.args.guests.external)
    }

    fn when_full(&self) -> WhenFull {
        WhenFull::Wait
    }

    fn play(
        &mut self,
        plan: &Plan,
        folder: &RunFolder,
        capture: &mut Capture<'_>,
    ) -> Result<Played, WorldError> {
        let announce = |text: &str| self.listener.on_note(text.to_owned());
        let hosting = self.args.guests.hosting(Some(folder.path()), &announce);
        lockstep::simulate(plan, &hosting, capture).map(Played::in_virtual_time)
    }

    fn check(&mut self, plan: &Plan, judged: &Judged, watch: &Watch) {
        if !self.args.twice || judged.exit > Exit::VerdictFailed {
            return;
        }
        let frames = &judged.frames;
        let path = plan.shared.beside.scenario().display();
        let (exit, failed) = match self.difference(plan, frames, watch) {
            // The second play has been cut short.
            _ if watch.is_interrupted() => return,
            Ok(None) => {
                let same = format!("played twice: the same {} frames", frames.len());
                self.listener.on_note(same);
                return;
            }
            Ok(Some(difference)) => (Exit::VerdictFailed, difference),
            Err(error) => (Exit::BenchFailed, error.to_string()),
        };
        self.exit = self.exit.max(exit);
        let failed = RunEvent::Failed(format!("{path}: {failed}"));
        self.listener.on_event(&failed);
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::play::{ValueArgs, ViewerArgs};
    use worlds::programs::Hosting;

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
            let guests = GuestArgs {
                external: Vec::new(),
                patience: Hosting::default().patience,
            };
            let play = PlayArgs {
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
            let args = SimulateArgs {
                play,
                guests,
                twice: false,
                watch: false,
            };
            let mut testbed = OneProcess::new(&args, &Nobody);
            play_all(&args.play, &mut testbed, &Nobody).unwrap()
        };
        assert_eq!(exit([&met, &met]), Exit::Pass);
        assert_eq!(exit([&missed, &met]), Exit::VerdictFailed);
        assert_eq!(exit([&met, &missed]), Exit::VerdictFailed);
    }
}
