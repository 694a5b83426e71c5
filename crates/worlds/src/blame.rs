//! Attribution of a run that broke off: a node under test fails the run, failures of the bench itself and of the bus leave it
//! undecided.

use std::ops::RangeInclusive;
use std::time::Duration;

use can::error_frames;
use canopen::emcy::{self, EmergencyMessage, ErrorCode};
use canopen::nmt::{COMMAND_ID, ERROR_CONTROL_ID, NmtCommand};
use dbc::names::{STATUSWORD, TPDO1, message};
use dbc::scenario_clock::SYNC_COB_ID;
use plan::{ControlLoop, Plan};
use platform::lockstep::Failure;
use recording::capture::Capture;
use recording::ending::{EarlyEnd, EndedBy};
use recording::log::Stamped;

use crate::error::{Doing, WorldError};
use crate::names::emulator_name;
use crate::supervisor::Supervisor;

/// Time before the end in which trouble of the bus explains why a node gave up.
const BUS_TROUBLE: Duration = Duration::from_secs(1);
const BUS_TROUBLES: [&str; 2] = ["bus-off", "error passive"];
/// Number of periods without a position after which the drive counts as silent.
const SILENT_PERIODS: u32 = 5;

/// Identifiers of all nodes' emergencies.
const EMCYS: RangeInclusive<u16> = 0x081..=0x0FF;
/// Causes in the controller's EMCY that are the drive's: no position, not enabled, an emergency, not operational, no bring-up.
const CAUSES_OF_DRIVE: [u8; 5] = [1, 5, 6, 7, 9];

/// Returns the end of a run that broke off with an error, if a node under test caused it.
///
/// # Errors
/// With the unchanged error if no node under test caused it.
pub(crate) fn end_by_node(
    error: WorldError,
    plan: &Plan,
    capture: &Capture<'_>,
) -> Result<EarlyEnd, WorldError> {
    let seen = Seen {
        plan,
        frames: capture.frames_of_run(),
        zero: capture.zero(),
    };
    match error {
        WorldError::Silent { node, silence } => Ok(seen.silent(&node, silence)),
        WorldError::NoStart { patience } => Ok(seen.never_began(patience)),
        WorldError::Violation { ref drive, .. } => Ok(seen.violated(drive, &error)),
        WorldError::NoStop { ref name, .. } => {
            Ok(seen.end(seen.node(name), None, error.to_string()))
        }
        WorldError::Process {
            name,
            how,
            log,
            doing,
        } => match doing {
            Doing::GaveUp if !seen.is_bus_in_trouble() => Ok(seen.gave_up(&name, &how, &log)),
            Doing::Crashed => {
                let what = format!("{how}{}{log}", seen.when());
                Ok(seen.end(seen.node(&name), None, what))
            }
            _ => Err(WorldError::Process {
                name: seen.text(&name),
                how,
                log,
                doing,
            }),
        },
        WorldError::Participant {
            failure: Failure::Channel(_),
            ..
        } => Err(error),
        WorldError::Participant { name, failure } => {
            let what = match failure {
                Failure::GaveUp(reason) => {
                    return Ok(seen.gave_up(&name, "gave up", &format!(": {reason}")));
                }
                Failure::NoAnswer(patience) => {
                    format!("no answer within {} s", patience.as_secs())
                }
                failure => failure.to_string(),
            };
            Ok(seen.end(seen.node(&name), None, what + &seen.when()))
        }
        error => Err(error),
    }
}

/// End of a run as the recording shows it.
#[derive(Clone, Copy)]
struct Seen<'a> {
    plan: &'a Plan,
    frames: &'a [Stamped],
    zero: Option<Duration>,
}

impl<'a> Seen<'a> {
    /// Returns the node that a participant plays: for a plant's emulator, the drive that moves it.
    fn node<'b>(&self, participant: &'b str) -> &'b str
    where
        'a: 'b,
    {
        let mut loops = self.plan.loops.iter();
        let is_played = |one: &&ControlLoop| one.loop_name().is_some();
        let plays = loops.find(|one| is_played(one) && emulator_name(one) == participant);
        plays.map_or(participant, |one| &one.drive().name)
    }

    /// Returns the name of a participant for a message: for a plant's emulator, with the drive that it plays.
    fn text(&self, participant: &str) -> String {
        let drive = self.node(participant);
        if drive == participant {
            participant.to_owned()
        } else {
            format!("emulator of {participant} and its drive {drive}")
        }
    }

    /// Returns scenario time, to the microsecond of the recording; `None` before the scenario began.
    fn seconds(&self, time: Duration) -> Option<f64> {
        let since = time.checked_sub(self.zero?)?;
        let micros = since.as_micros() as f64;
        Some(micros / 1e6)
    }

    /// Returns scenario time, or the time since the first frame if the scenario never began.
    fn stamp(&self, time: Duration) -> f64 {
        let begin = self.frames.first().map_or(time, |first| first.time);
        let since_begin = time.saturating_sub(begin).as_secs_f64();
        self.seconds(time).unwrap_or(since_begin)
    }

    fn end_of_recording(&self) -> Option<Duration> {
        self.frames.last().map(|last| last.time)
    }

    /// Returns a text such as ` at 3.012 s`.
    fn when(&self) -> String {
        self.when_at(self.end_of_recording())
    }

    fn when_at(&self, time: Option<Duration>) -> String {
        let seconds = time.and_then(|time| self.seconds(time));
        seconds.map_or_else(
            || " before the scenario began".to_owned(),
            |seconds| format!(" at {seconds:.3} s"),
        )
    }

    /// Returns an end of the run at the end of its recording.
    fn end(&self, node: &str, since: Option<Duration>, what: String) -> EarlyEnd {
        EarlyEnd {
            by: EndedBy::Node,
            node: Some(node.to_owned()),
            since_seconds: since.map(|since| self.stamp(since)),
            at_seconds: self.end_of_recording().map(|end| self.stamp(end)),
            what,
            is_rig_limit: false,
        }
    }

    /// Returns the end by a drive that violated a limit of the rig, at the frame that shows it.
    fn violated(&self, drive: &str, error: &WorldError) -> EarlyEnd {
        let mut loops = self.plan.loops.iter();
        let supervisor = loops
            .find(|one| one.drive().name == drive)
            .map(Supervisor::new);
        let shown = supervisor.and_then(|mut supervisor| {
            let mut frames = self.frames.iter();
            frames.find(|one| supervisor.check(one.time, &one.frame).is_some())
        });
        let at = shown.map(|shown| shown.time).or(self.end_of_recording());
        EarlyEnd {
            at_seconds: at.map(|at| self.stamp(at)),
            is_rig_limit: true,
            ..self.end(drive, None, format!("{error}{}", self.when_at(at)))
        }
    }

    fn last(&self, raw_id: u32) -> Option<&Stamped> {
        let mut latest_first = self.frames.iter().rev();
        latest_first.find(|stamped| stamped.frame.raw_id() == raw_id)
    }

    fn last_position(&self, drive: &str) -> Option<Duration> {
        let mut loops = self.plan.loops.iter();
        let its_loop = loops.find(|one| one.drive().name == drive)?;
        let position = its_loop.drive_position(self.plan.database()).ok()?;
        self.last(position.raw_id()).map(|position| position.time)
    }

    fn silent(&self, node: &str, silence: Duration) -> EarlyEnd {
        let last = if node == self.plan.controller().name {
            self.last(SYNC_COB_ID.into()).map(|sync| sync.time)
        } else {
            self.last_position(node)
        };
        let since = last.and_then(|last| self.seconds(last)).unwrap_or_default();
        EarlyEnd {
            at_seconds: last.map(|last| self.stamp(last + silence)),
            ..self.end(node, last, format!("silent since {since:.3} s"))
        }
    }

    /// Returns the end of a run in which no controller enabled the drive.
    fn never_began(&self, patience: Duration) -> EarlyEnd {
        let heartbeat = ERROR_CONTROL_ID + self.controller_id();
        let is_of_controller = |stamped: &Stamped| {
            let frame = &stamped.frame;
            match frame.standard_id() {
                Some(COMMAND_ID) => frame.data().first() != Some(&NmtCommand::Stop.specifier()),
                Some(id) => [SYNC_COB_ID, heartbeat].contains(&id),
                None => false,
            }
        };
        let is_heard = self.frames.iter().any(is_of_controller);
        let seconds = patience.as_secs();
        let what = if is_heard {
            format!(
                "the scenario did not begin within {seconds} s: the drive never reported Operation enabled ({})",
                self.bring_up()
            )
        } else {
            format!(
                "not heard at all within {seconds} s: no SYNC, no NMT, no heartbeat 0x{heartbeat:03X}; is it running, and on this bus?"
            )
        };
        self.end(&self.plan.controller().name, None, what)
    }

    /// How far the bring-up came: `NMT start: sent, SYNC: none, drive: switch on disabled`.
    fn bring_up(&self) -> String {
        let is_start = |one: &Stamped| {
            one.frame.standard_id() == Some(COMMAND_ID)
                && one.frame.data().first() == Some(&NmtCommand::Start.specifier())
        };
        let is_sync = |one: &Stamped| one.frame.standard_id() == Some(SYNC_COB_ID);
        let sent = |is_sent| if is_sent { "sent" } else { "none" };
        let mut parts = vec![
            format!("NMT start: {}", sent(self.frames.iter().any(is_start))),
            format!("SYNC: {}", sent(self.frames.iter().any(is_sync))),
        ];
        parts.extend(self.plan.loops.iter().map(|one| {
            let state = self.last_state(one).unwrap_or("no statusword");
            format!("{}: {state}", one.drive().name)
        }));
        parts.join(", ")
    }

    /// The state in the last statusword of a loop's drive.
    fn last_state(&self, one: &'a ControlLoop) -> Option<&'a str> {
        let path = format!("{}.{STATUSWORD}", message(&one.drive().name, TPDO1));
        let database = self.plan.database();
        let statusword = database.require(&path).ok()?;
        let last = statusword.decode(&self.last(statusword.raw_id())?.frame)?;
        database.definition(&path)?.label(last)
    }

    fn controller_id(&self) -> u16 {
        self.plan.controller().id().into()
    }

    /// Returns the end by a node that gave up by itself. If a controller gave a drive up, the end is the drive's.
    fn gave_up(&self, name: &str, how: &str, log: &str) -> EarlyEnd {
        let is_controller = name == self.plan.controller().name;
        let Some((drive, given_up)) = self.drive_given_up().filter(|_| is_controller) else {
            let what = format!("{how}{}{log}", self.when());
            let node = self.node(name);
            return self.end(node, self.last_position(node), what);
        };
        // The drive may have been heard again since if it was only late.
        let until = self.frames.iter().position(|one| one.time >= given_up);
        let before = Self {
            frames: &self.frames[..until.unwrap_or(self.frames.len())],
            ..*self
        };
        let position = before.last_position(drive);
        let patience = SILENT_PERIODS * self.plan.sync_period();
        let silent = position
            .filter(|position| given_up > *position + patience)
            .and_then(|position| self.seconds(position));
        let silent =
            silent.map_or_else(String::new, |since| format!("silent since {since:.3} s; "));
        let when = self.when_at(Some(given_up));
        let what = format!("{silent}the controller gave it up{when} and {how}{log}");
        EarlyEnd {
            at_seconds: Some(self.stamp(given_up)),
            ..self.end(drive, position, what)
        }
    }

    /// Returns the drive that the controller gave up, with the time, if its last error blames a drive: for its heartbeat, or for
    /// a cause of the controller's own. An error in the bring-up is reported at once by some node, but the drive is given up only
    /// when the time for the bring-up is over, so the time is that of the first error.
    fn drive_given_up(&self) -> Option<(&'a str, Duration)> {
        let emcy = emcy::DEFAULT_ID + self.controller_id();
        let (given_up, emergency) = self
            .errors()
            .rfind(|(stamped, _)| stamped.frame.standard_id() == Some(emcy))?;
        let [node_id, cause, ..] = emergency.manufacturer;
        let is_of_drive =
            emergency.code == ErrorCode::HEARTBEAT || CAUSES_OF_DRIVE.contains(&cause);
        let noticed = match self.zero {
            None => self.errors().next().map(|(first, _)| first.time),
            Some(_) => Some(given_up.time),
        };
        let mut loops = self.plan.loops.iter();
        let is_meant =
            |one: &&ControlLoop| self.plan.loops.len() == 1 || one.drive().id() == node_id;
        let drive = loops.find(is_meant).filter(|_| is_of_drive)?;
        Some((drive.drive().name.as_str(), noticed?))
    }

    /// Returns the errors that nodes reported.
    fn errors(&self) -> impl DoubleEndedIterator<Item = (&Stamped, EmergencyMessage)> {
        self.frames.iter().filter_map(|stamped| {
            let id = stamped.frame.standard_id()?;
            let emergency = EmergencyMessage::decode(stamped.frame.data())?;
            let is_error = EMCYS.contains(&id) && emergency.code != ErrorCode::NO_ERROR;
            is_error.then_some((stamped, emergency))
        })
    }

    fn is_bus_in_trouble(&self) -> bool {
        let end = self.end_of_recording().unwrap_or_default();
        let latest_first = self.frames.iter().rev();
        let lately = latest_first.take_while(|stamped| stamped.time + BUS_TROUBLE >= end);
        let mut messages = lately.filter_map(|stamped| error_frames::read(&stamped.frame));
        messages.any(|message| {
            !message.is_good && BUS_TROUBLES.iter().any(|text| message.text.contains(text))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use can::CanFrame;

    const POSITION: u16 = 0x190;

    #[test]
    fn a_drive_that_is_given_up_is_amiss_since_its_last_position_before() {
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let plan = testing::plan(text);
        let frame = |milliseconds, id, data: &[u8]| {
            Stamped::new(Duration::from_millis(milliseconds), CanFrame::new(id, data))
        };
        let no_position = [0x50, 0x82, 0x11, 0, 1, 0, 0, 0];
        let frames = [
            frame(10, SYNC_COB_ID, &[1]),
            frame(11, POSITION, &[0; 8]),
            frame(34, SYNC_COB_ID, &[2]),
            frame(34, emcy::DEFAULT_ID + 1, &no_position),
            frame(35, POSITION, &[0; 8]),
            frame(36, POSITION, &[0; 8]),
        ];
        let seen = Seen {
            plan: &plan,
            frames: &frames,
            zero: Some(Duration::from_millis(10)),
        };
        let end = seen.gave_up("controller", "ended", "");
        assert_eq!(end.node.as_deref(), Some("drive"));
        assert_eq!(
            (end.since_seconds, end.at_seconds),
            (Some(0.001), Some(0.024))
        );
        let what = "silent since 0.001 s; the controller gave it up at 0.024 s and ended";
        assert_eq!(end.what, what);
    }
}
