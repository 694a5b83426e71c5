//! `canrig simulate`: plays scenarios in one process and virtual time.

use clap::Args;

use crate::event::{Listener, RunEvent};
use crate::exit::{Exit, Failure};
use crate::play::{GuestArgs, PlayArgs, Testbed, in_virtual_time, play_all};
use plan::Plan;
use recording::capture::Capture;
use recording::frame_queue::WhenFull;
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
}

/// Plays the scenarios and returns the worst exit of all.
pub fn simulate(args: &SimulateArgs) -> Result<Exit, Failure> {
    let listener = args.play.listener();
    listener.on_note("bus: modelled · clock: lock-step, in one process".to_owned());
    let mut testbed = OneProcess {
        args,
        listener: &*listener,
        has_difference: false,
    };
    let exit = play_all(&args.play, &mut testbed, &*listener)?;
    Ok(if testbed.has_difference {
        exit.max(Exit::VerdictFailed)
    } else {
        exit
    })
}

/// Testbed with all of canrig's nodes in this process, on a modelled bus.
struct OneProcess<'a> {
    args: &'a SimulateArgs,
    listener: &'a dyn Listener,
    /// Whether two plays of a scenario differed.
    has_difference: bool,
}

impl OneProcess<'_> {
    /// Plays the plan once more, and prints whether the frames are the same.
    fn compare(&mut self, plan: &Plan, first: &Capture<'_>) -> Result<(), WorldError> {
        let clock = plan.scenario_clock()?;
        let mut second = Capture::in_memory(clock, first.watch());
        let announce = |text: &str| self.listener.on_note(text.to_owned());
        let hosting = self.args.guests.hosting(None, &announce);
        lockstep::simulate(plan, &hosting, &mut second)?;
        let difference = difference(plan, first, &second);
        let path = plan.shared.beside.scenario().display();
        if let Some(difference) = difference {
            self.has_difference = true;
            let difference = format!("{path}: {difference}");
            self.listener.on_event(&RunEvent::Failed(difference));
        } else {
            let frames = first.frames().len();
            let same = format!("played twice: the same {frames} frames");
            self.listener.on_note(same);
        }
        Ok(())
    }
}

/// Describes the first frame in which two plays differ, with its sender and its time; `None` if they are the same.
fn difference(plan: &Plan, first: &Capture<'_>, second: &Capture<'_>) -> Option<String> {
    let (one, other) = (first.frames(), second.frames());
    let same = one
        .iter()
        .zip(other)
        .take_while(|(one, other)| one == other);
    let place = same.count();
    let frames = [one.get(place), other.get(place)];
    let earliest = frames
        .into_iter()
        .flatten()
        .min_by_key(|frame| frame.time)?;
    let database = plan.database();
    let sender = |frame: &Stamped| {
        let message = database.message_of(&frame.frame);
        message.and_then(|message| message.sender.clone())
    };
    let told = frames.map(|frame| match frame {
        Some(frame) => {
            let sender = sender(frame).map_or_else(String::new, |sender| format!(" of {sender}"));
            let seconds = frame.time.as_secs_f64();
            format!("{}{sender} at {seconds:.6} s of the bus", frame.frame)
        }
        None => "no frame any more".to_owned(),
    });
    let when = match first
        .zero()
        .and_then(|zero| earliest.time.checked_sub(zero))
    {
        Some(time) => format!("at {:.6} s", time.as_secs_f64()),
        None => "before the scenario began".to_owned(),
    };
    let [one, other] = told;
    Some(format!(
        "two plays differ {when}, in frame {}: {one} in the first, {other} in the second",
        place + 1
    ))
}

impl Testbed for OneProcess<'_> {
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
        let end = lockstep::simulate(plan, &hosting, capture)?;
        if self.args.twice && !capture.is_interrupted() {
            self.compare(plan, capture)?;
        }
        Ok(Played::in_virtual_time(end))
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
            };
            let mut testbed = OneProcess {
                args: &args,
                listener: &Nobody,
                has_difference: false,
            };
            play_all(&args.play, &mut testbed, &Nobody).unwrap()
        };
        assert_eq!(exit([&met, &met]), Exit::Pass);
        assert_eq!(exit([&missed, &met]), Exit::VerdictFailed);
        assert_eq!(exit([&met, &missed]), Exit::VerdictFailed);
    }
}
