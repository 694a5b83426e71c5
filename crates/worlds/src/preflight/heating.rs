//! Drive under a slow heating ramp, as the bus shows it: the rest position of the load, the direction of its motion, and the end
//! of the current on command.

use std::time::Duration;

use can::CanFrame;
use canopen::NmtCommand;
use canopen::NmtState;
use canopen::cia402::Command;
use canopen::nmt::ERROR_CONTROL_ID;
use dbc::Unit;
use dbc::scenario_clock::ScenarioClock;
use scenario::rig::drive::{Feedback, Scaled};

use super::checklist::Check;
use super::checklist::Found::{self, Failed, Open, Passed};
use super::observed::{Motion, QuickStop, Span};
use crate::error::WorldError;
use crate::played::End;
use can::error_frames;
use plan::loaded_drive::LoadedDrive;
use recording::capture::Capture;

/// Time for which the load is watched at rest before the current rises.
pub(super) const REST: Duration = Duration::from_secs(1);
/// Smallest displacement that counts as motion, in steps of the sensor.
const MOTION_STEPS: f64 = 5.0;
/// Fraction of the limit below which a current counts as none: the possible offset of a drive's measurement.
const NO_CURRENT: f64 = 0.05;

/// State of a heating session, as the bus has shown it so far.
pub(super) struct Heating<'a> {
    drive: &'a LoadedDrive,
    /// Unit of the drive's positions.
    unit: &'a Unit,
    clock: ScenarioClock,
    /// Number of frames of the recording that were read.
    frames_read: usize,
    commanded_amperes: f64,
    /// Span of the positions at rest.
    rest: Option<Span>,
    /// Effect of the ramp on the load; `None` before the ramp.
    motion: Option<Motion>,
    /// Observations after the first quick stop.
    quick_stop: Option<QuickStop>,
    /// Time of the first NMT stop, and the delay until a heartbeat had the state Stopped.
    nmt_stop: Option<Duration>,
    stopped_after: Option<Duration>,
    errors: Vec<String>,
}

impl<'a> Heating<'a> {
    /// Makes the session of a drive whose positions are in this unit, before its first frame.
    pub(super) fn new(drive: &'a LoadedDrive, clock: ScenarioClock, unit: &'a Unit) -> Self {
        Self {
            drive,
            unit,
            clock,
            frames_read: 0,
            commanded_amperes: 0.0,
            rest: None,
            motion: None,
            quick_stop: None,
            nmt_stop: None,
            stopped_after: None,
            errors: Vec::new(),
        }
    }

    /// Reads the new frames of a recording.
    pub(super) fn follow(&mut self, capture: &Capture<'_>) {
        for stamped in capture.since(&mut self.frames_read) {
            self.on_frame(stamped.time, &stamped.frame);
        }
    }

    /// Returns the longest time to await a heartbeat of the drive.
    pub(super) fn patience(&self) -> Duration {
        Duration::from_millis(self.drive.real.timeouts.drive_lost_milliseconds.into())
    }

    /// Returns whether the ramp has shown all that it can.
    pub(super) fn is_over(&self) -> bool {
        let heats = self.drive.real.preflight.heating;
        let is_shown = |motion: Motion| motion.has_moved() || !heats || self.position().is_err();
        self.motion.is_some_and(is_shown)
    }

    /// Returns whether a heartbeat has shown that the drive obeyed NMT stop.
    pub(super) fn is_stopped(&self) -> bool {
        self.stopped_after.is_some()
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.clock.on_frame(now, frame);
        let drive = &self.drive.layout;
        if let Some(message) = error_frames::read(frame) {
            if !message.is_good && !self.errors.contains(&message.text) {
                self.errors.push(message.text);
            }
        } else if let Some(feedback) = drive.decode(frame) {
            self.on_feedback(now, &feedback);
        } else if let Some(amperes) = drive.decode_target(frame) {
            self.on_command(now, frame, amperes);
        } else if *frame == NmtCommand::Stop.frame(Some(drive.node_id)) {
            self.nmt_stop.get_or_insert(now);
        } else if self.is_stopped_heartbeat(frame)
            && let Some(sent_at) = self.nmt_stop
        {
            let after = now.saturating_sub(sent_at);
            self.stopped_after.get_or_insert(after);
        }
    }

    fn on_command(&mut self, now: Duration, frame: &CanFrame, amperes: f64) {
        self.commanded_amperes = amperes;
        let quick_stop = Command::QuickStop.controlword();
        let is_quick_stop = *frame == self.drive.layout.encode(quick_stop, 0.0);
        if is_quick_stop && self.clock.zero().is_some() {
            self.quick_stop.get_or_insert(QuickStop {
                sent_at: now,
                ..QuickStop::default()
            });
        }
    }

    fn on_feedback(&mut self, now: Duration, feedback: &Feedback) {
        let position = feedback.position;
        let is_at_rest = self.clock.scenario_time(now).unwrap_or_default() < REST;
        let (no_current, threshold) = (self.idle_output_max(), self.motion());
        if let Some(quick_stop) = &mut self.quick_stop {
            quick_stop.on_sample(now, feedback, no_current);
        } else if !is_at_rest {
            let motion = self.motion.get_or_insert_default();
            if let Some(rest) = self.rest {
                let displacement = position - rest.middle();
                motion.on_sample(displacement, self.commanded_amperes, threshold);
            }
        } else if self.motion.is_none() {
            self.rest = Some(Span::including(self.rest, position));
        }
    }

    fn is_stopped_heartbeat(&self, frame: &CanFrame) -> bool {
        let id = ERROR_CONTROL_ID + u16::from(self.drive.layout.node_id.get());
        frame.standard_id() == Some(id) && frame.data().first() == Some(&NmtState::Stopped.number())
    }

    /// Returns the smallest displacement that is motion, in the drive's unit.
    fn motion(&self) -> f64 {
        MOTION_STEPS * self.drive.real.position.resolution
    }

    fn idle_output_max(&self) -> f64 {
        NO_CURRENT * self.drive.real.limits.current_amperes
    }

    /// Returns the checks up to the first failure, after a session that ended like this.
    pub(super) fn checks(&self, ended: &Result<End, WorldError>) -> Vec<Check> {
        let reason = reason(ended);
        let found = [
            ("configuration", self.configuration()),
            ("drive", self.enabled()),
            ("position", self.at_rest()),
            ("direction", self.direction()),
            ("quick stop", self.quick_stop()),
            ("NMT stop", self.nmt_stop()),
        ];
        let mut checks = Vec::new();
        for (name, found) in found {
            let missing = |text| Failed(reason.clone().unwrap_or(text));
            let found = found.unwrap_or_else(missing);
            let is_failed = matches!(found, Failed(_));
            checks.push(Check(name, found));
            if is_failed {
                return checks;
            }
        }
        checks.push(self.end(reason));
        checks
    }

    fn end(&self, reason: Option<String>) -> Check {
        let name = "error frames";
        let errors = self.errors.join(", ");
        match reason {
            Some(reason) => Check("end", Failed(reason)),
            None if errors.is_empty() => Check(name, Passed("none".to_owned())),
            None => {
                let found = format!("{errors}: look at cable, termination and bit rates");
                Check(name, Failed(found))
            }
        }
    }

    fn configuration(&self) -> Finding {
        let drive = &self.drive.layout;
        let is_stop_seen = self.quick_stop.is_some_and(|stop| stop.last.is_some());
        if self.rest.is_none() && self.motion.is_none() && !is_stop_seen {
            return Err(format!("no PDO 0x{:03X} came", drive.feedback.id()));
        }
        let pdos = [&drive.feedback, &drive.command]
            .map(|pdo| format!("0x{:03X} ({} bytes)", pdo.id(), pdo.length_bytes));
        Ok(Passed(format!("PDOs {} are mapped", pdos.join(" and "))))
    }

    fn enabled(&self) -> Finding {
        match (self.clock.zero(), self.position()) {
            (Some(_), _) => Ok(Passed("Operation enabled, at 0 A".to_owned())),
            (None, Err(_)) => Ok(Open("not awaited".to_owned())),
            (None, Ok(())) => Err("the drive was not enabled".to_owned()),
        }
    }

    fn at_rest(&self) -> Finding {
        match (self.position(), self.rest, self.motion) {
            (Err(text), ..) => Ok(Failed(text)),
            (Ok(()), Some(rest), Some(_)) => Ok(Passed(at_rest(rest, self.unit))),
            _ => Err("the drive sent no position for a second".to_owned()),
        }
    }

    /// Checks that the position without current is plausible.
    fn position(&self) -> Result<(), String> {
        let Some(rest) = self.rest else {
            return Ok(());
        };
        let Span { low, high } = rest;
        let (symbol, at_rest) = (self.unit.symbol(), at_rest(rest, self.unit));
        let range = self.drive.real.limits;
        if low < range.min || high > range.max {
            return Err(format!(
                "{at_rest}, beyond the limits of the rig ({} to {} {symbol}): look at increments_at_zero and increments_per_unit",
                range.min, range.max
            ));
        }
        let position = self.drive.layout.position;
        if let Some(extreme) = [low, high].iter().find_map(|at| extreme(&position, *at)) {
            return Err(format!(
                "the object has its extreme value {extreme}: is the sensor connected?"
            ));
        }
        if high - low >= self.motion() {
            return Err(format!(
                "it moves from {at_rest}: noise, or resolution is too small"
            ));
        }
        Ok(())
    }

    fn direction(&self) -> Finding {
        let preflight = &self.drive.real.preflight;
        let threshold = self.motion();
        let motion = self.motion.unwrap_or_default();
        let (displacement, amperes) = (motion.displacement, motion.amperes);
        let symbol = self.unit.symbol();
        if !preflight.heating {
            Ok(Open("not heated, as you wished".to_owned()))
        } else if displacement <= -threshold {
            // A motion may reach a limit of the rig before it counts as motion.
            Ok(Failed(format!(
                "falls by {:.2} {symbol} at {amperes:.2} A: a positive current raises the position; turn the sign of increments_per_unit",
                -displacement
            )))
        } else if motion.has_moved() {
            Ok(Passed(format!(
                "rises by {displacement:.2} {symbol} at {amperes:.2} A"
            )))
        } else {
            Err(format!(
                "{displacement:.2} {symbol} within {} s, at {amperes:.2} A in the end ({threshold:.2} {symbol} are motion): is the plant connected, and the command's scaling right?",
                preflight.heating_seconds_max
            ))
        }
    }

    fn quick_stop(&self) -> Finding {
        let limit_milliseconds = self.drive.real.preflight.stop_milliseconds_max;
        let quick_stop = self.quick_stop.ok_or("none was sent")?;
        if let Some(after) = quick_stop.without_current_after {
            let after_milliseconds = after.as_secs_f64() * 1e3;
            let text = format!("after {after_milliseconds:.1} ms (limit {limit_milliseconds} ms)");
            return if after <= Duration::from_millis(limit_milliseconds.into()) {
                Ok(Passed(format!("no current {text}")))
            } else {
                Ok(Failed(format!("no current only {text}")))
            };
        }
        // Without a sample a limit was violated: NMT stop came at once.
        let last = quick_stop.last.ok_or("no sample came after it")?;
        let flowing = last.output;
        match flowing.filter(|amperes| amperes.abs() > self.idle_output_max()) {
            Some(amperes) => Ok(Failed(format!(
                "the drive does not obey: {amperes:.2} A flow on; switch it off by hand"
            ))),
            None => Ok(Failed(
                "the drive stays in Operation enabled; switch it off by hand".to_owned(),
            )),
        }
    }

    fn nmt_stop(&self) -> Finding {
        let limit = self.patience();
        let limit_milliseconds = limit.as_millis();
        match self.stopped_after.filter(|after| *after <= limit) {
            Some(after) => Ok(Passed(format!(
                "Stopped in a heartbeat after {:.1} ms (limit {limit_milliseconds} ms)",
                after.as_secs_f64() * 1e3
            ))),
            None => Ok(Failed(format!(
                "no heartbeat reported the state Stopped within {limit_milliseconds} ms: the drive does not obey NMT"
            ))),
        }
    }
}

/// Finding of a check. Without it, the end of the session gives the reason, or otherwise the text.
type Finding = Result<Found, String>;

/// Returns the reason why the session failed; for a controller that gave up, its last line.
fn reason(ended: &Result<End, WorldError>) -> Option<String> {
    let (said, whole) = match ended {
        Ok(End::Completed | End::Interrupted) => return None,
        Ok(End::ByNode(end)) => (end.what.as_str(), end.to_string()),
        Err(error @ WorldError::Process { log, .. }) => (log.as_str(), error.to_string()),
        Err(error) => ("", error.to_string()),
    };
    let last = said.lines().last().map(str::trim);
    let line = last.filter(|line| !line.is_empty());
    Some(line.map_or(whole, str::to_owned))
}

/// Returns the extreme value of the object at a position, as of an unconnected sensor.
fn extreme(position: &Scaled, at: f64) -> Option<f64> {
    let raw = (at * position.units + position.offset).round();
    let max = position.field.max();
    let other = if position.field.is_signed {
        -max - 1.0
    } else {
        // 0 is the rest position of many sensors.
        max
    };
    let mut extremes = [other, max].into_iter();
    extremes.find(|extreme| raw.to_bits() == extreme.to_bits())
}

/// Describes the rest position of the load, to the hundredth of its unit; a zero has no sign.
fn at_rest(rest: Span, unit: &Unit) -> String {
    let [low, high] = [rest.low, rest.high].map(|at| (100.0 * at).round() / 100.0 + 0.0);
    format!("{low:.2} to {high:.2} {} without current", unit.symbol())
}

#[cfg(test)]
mod tests {
    use can::frame::ERROR_FLAG;
    use dbc::Database;
    use recording::log::Stamped;
    use scenario::rig::{Limits, RealDrive};

    use super::*;

    /// Returns the emulated drive, as a real one.
    fn drive() -> LoadedDrive {
        let limits = Limits {
            current_amperes: 0.9,
            min: -1.0,
            max: 45.0,
            rate_max: 400.0,
        };
        LoadedDrive::new(RealDrive::new(limits), None).unwrap()
    }

    const PERIOD: Duration = Duration::from_millis(10);

    /// Session on the emulated drive, whose frames may be left out or changed.
    struct SessionFrames {
        frames: Vec<Stamped>,
        now: Duration,
    }

    impl SessionFrames {
        /// Makes a good session: rest, a ramp with motion, quick stop and NMT stop.
        fn good() -> Self {
            let mut session = Self::heated(0.5);
            session.stop(&[(0x0250, 0), (0x0250, 0)]);
            session.push(CanFrame::new(0x000, &[2, 0x10]));
            session.push(CanFrame::new(0x710, &[4]));
            session
        }

        /// Makes a session up to the motion of the load.
        fn heated(millimetres: f64) -> Self {
            let mut session = Self {
                frames: Vec::new(),
                now: Duration::ZERO,
            };
            for cycle in 0..110 {
                let at = if cycle < 105 { 0.0 } else { millimetres };
                session.cycle(0x0237, at, 600);
                session.push(CanFrame::new(0x210, &[0x0F, 0, 0x58, 2]));
            }
            session
        }

        /// Adds the samples after a quick stop.
        fn stop(&mut self, samples: &[(u16, i16)]) {
            self.push(CanFrame::new(0x210, &[2, 0, 0, 0]));
            for (statusword, milliamperes) in samples {
                self.cycle(*statusword, 0.5, *milliamperes);
            }
        }

        fn cycle(&mut self, statusword: u16, millimetres: f64, milliamperes: i16) {
            self.now += PERIOD;
            self.push(CanFrame::new(0x080, &[1]));
            #[expect(clippy::cast_possible_truncation, reason = "a few millimetres")]
            let micrometres = (millimetres * 1e3) as i32;
            let mut data = [0; 8];
            data[..2].copy_from_slice(&statusword.to_le_bytes());
            data[2..6].copy_from_slice(&micrometres.to_le_bytes());
            data[6..].copy_from_slice(&milliamperes.to_le_bytes());
            self.push(CanFrame::new(0x190, &data));
        }

        fn push(&mut self, frame: CanFrame) {
            self.frames.push(Stamped::new(self.now, frame));
        }

        /// Returns the checklist, and whether the bench would have ended the ramp.
        fn judged(&self) -> (String, bool) {
            self.judged_in(&Unit::Millimetres)
        }

        fn judged_in(&self, unit: &Unit) -> (String, bool) {
            let drive = drive();
            let clock = ScenarioClock::new(Database::shipped(), ["drive"]).unwrap();
            let mut heating = Heating::new(&drive, clock, unit);
            for stamped in &self.frames {
                heating.on_frame(stamped.time, &stamped.frame);
            }
            let checks = heating.checks(&Ok(End::Completed));
            let lines: Vec<String> = checks.iter().map(ToString::to_string).collect();
            (lines.join("\n"), heating.is_over())
        }
    }

    #[test]
    fn a_good_session_passes_and_is_over_when_the_load_has_moved() {
        let (lines, is_over) = SessionFrames::good().judged();
        assert!(is_over && !lines.contains('✗'), "{lines}");
        let expected = "✓ direction     rises by 0.50 mm at 0.60 A\n\
            ✓ quick stop    no current after 10.0 ms (limit 100 ms)\n\
            ✓ NMT stop      Stopped in a heartbeat after 0.0 ms (limit 100 ms)\n✓ error frames  none";
        assert!(lines.ends_with(expected), "{lines}");
    }

    #[test]
    fn a_drive_that_does_not_stop_is_reported() {
        let mut deaf = SessionFrames::heated(0.5);
        deaf.stop(&[(0x0237, 600), (0x0237, 600)]);
        let (lines, _) = deaf.judged();
        assert!(
            lines.ends_with("the drive does not obey: 0.60 A flow on; switch it off by hand"),
            "{lines}"
        );

        let mut slow = SessionFrames::heated(0.5);
        slow.stop(&[(0x0237, 600); 12]);
        slow.cycle(0x0250, 0.5, 0);
        let (lines, _) = slow.judged();
        assert!(
            lines.ends_with("✗ quick stop    no current only after 130.0 ms (limit 100 ms)"),
            "{lines}"
        );

        let mut no_nmt = SessionFrames::heated(0.5);
        no_nmt.stop(&[(0x0250, 0)]);
        no_nmt.push(CanFrame::new(0x000, &[2, 0x10]));
        no_nmt.push(CanFrame::new(0x710, &[5]));
        let (lines, _) = no_nmt.judged();
        assert!(lines.ends_with("the drive does not obey NMT"), "{lines}");
    }

    #[test]
    fn a_zero_at_rest_has_no_sign() {
        let rest = Span {
            low: -0.004,
            high: 0.004,
        };
        let text = at_rest(rest, &Unit::Millimetres);
        assert_eq!(text, "0.00 to 0.00 mm without current");
    }

    #[test]
    fn a_drive_in_degrees_is_judged_in_degrees() {
        let last = |session: &SessionFrames| {
            let (lines, _) = session.judged_in(&Unit::Degrees);
            assert!(!lines.contains("mm") && !lines.contains("milli"), "{lines}");
            lines
        };
        let lines = last(&SessionFrames::good());
        for line in [
            "✓ position      0.00 to 0.00 deg without current\n",
            "✓ direction     rises by 0.50 deg at 0.60 A\n",
        ] {
            assert!(lines.contains(line), "{line} is not in\n{lines}");
        }
        let lines = last(&SessionFrames::heated(-0.5));
        assert!(
            lines.ends_with("turn the sign of increments_per_unit"),
            "{lines}"
        );
        let mut far = SessionFrames::heated(0.0);
        far.frames.clear();
        (0..110).for_each(|_| far.cycle(0x0237, 60.0, 0));
        let lines = last(&far);
        let expected = "60.00 to 60.00 deg without current, beyond the limits of the rig (-1 to 45 deg): \
            look at increments_at_zero and increments_per_unit";
        assert!(lines.ends_with(expected), "{lines}");
    }

    #[test]
    fn a_spike_is_no_motion_and_a_sensor_at_its_end_no_position() {
        let mut spike = SessionFrames::heated(0.0);
        spike.cycle(0x0237, 3.0, 600);
        spike.cycle(0x0237, 0.0, 600);
        assert!(!spike.judged().1);
        let position = drive().layout.position;
        assert_eq!(extreme(&position, -2_147_483.648), Some(-2_147_483_648.0));
        assert_eq!(extreme(&position, 10.0), None);
    }

    #[test]
    fn errors_on_the_bus_are_reported() {
        let mut session = SessionFrames::good();
        let data = [0, 0x20, 0, 0, 0, 0, 0, 0];
        let message = CanFrame::from_raw(ERROR_FLAG | 0x004, 8, data).unwrap();
        session.push(message);
        session.push(message);
        let (lines, _) = session.judged();
        assert!(
            lines.ends_with(
                "✗ error frames  error passive: look at cable, termination and bit rates"
            ),
            "{lines}"
        );
    }
}
