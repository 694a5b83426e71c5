//! The drive under a slow heating ramp, as the bus shows it: where the load rests, which way it moves, and whether the
//! current goes when it is told to.

use std::time::Duration;

use canopen::NmtState;
use canopen::cia402::{Command, State};
use canopen::{CanFrame, NmtCommand};
use dbc::SignalMissing;
use dbc::scenario_clock::ScenarioClock;
use scenario::rig::drive::{Feedback, Scaled};

use super::checklist::Check;
use crate::WorldError;
use recording::log::Stamped;
use rig::error_frames;
use rig::rig_file::LoadedRig;

/// How long the load is watched at rest before the current rises.
pub(super) const REST: Duration = Duration::from_secs(1);
/// Motion is a displacement of so many steps of the sensor …
const MOTION_STEPS: f64 = 5.0;
/// … in so many samples in a row, so that a spike is none.
const MOTION_SAMPLES: u32 = 3;
/// No current is less than this part of the limit: what a drive's measurement may be off.
const NO_CURRENT: f64 = 0.05;
const MILLIMETRES_PER_METRE: f64 = 1e3;

/// What the bus has shown so far.
pub(super) struct Heating<'a> {
    rig: &'a LoadedRig,
    clock: ScenarioClock,
    /// How many frames of the recording were taken.
    taken: usize,
    has_feedback: bool,
    /// Lowest and highest position without current.
    rest: Option<(f64, f64)>,
    is_rest_over: bool,
    commanded_amperes: f64,
    /// The command under which the displacement came about.
    heated_amperes: f64,
    displacement_millimetres: f64,
    samples_beyond: u32,
    has_moved: bool,
    quick_stop: Option<Duration>,
    /// When the drive first showed that no current flows.
    without_current: Option<Duration>,
    /// The last sample after it.
    after_stop: Option<Feedback>,
    nmt_stop: Option<Duration>,
    stopped: Option<Duration>,
    errors: Vec<String>,
}

impl<'a> Heating<'a> {
    /// Nothing has been seen yet.
    pub(super) fn new(rig: &'a LoadedRig) -> Result<Self, SignalMissing> {
        Ok(Self {
            rig,
            clock: ScenarioClock::new(&rig.database)?,
            taken: 0,
            has_feedback: false,
            rest: None,
            is_rest_over: false,
            commanded_amperes: 0.0,
            heated_amperes: 0.0,
            displacement_millimetres: 0.0,
            samples_beyond: 0,
            has_moved: false,
            quick_stop: None,
            without_current: None,
            after_stop: None,
            nmt_stop: None,
            stopped: None,
            errors: Vec::new(),
        })
    }

    /// Takes what is new in a recording.
    pub(super) fn follow(&mut self, recording: &[Stamped]) {
        let new = recording.get(self.taken..).unwrap_or_default();
        new.iter().for_each(|stamped| self.take(stamped));
        self.taken = recording.len();
    }

    /// How long a heartbeat of the drive may be awaited.
    pub(super) fn patience(&self) -> Duration {
        Duration::from_millis(self.rig.rig.timeouts.drive_lost_milliseconds.into())
    }

    fn take(&mut self, stamped: &Stamped) {
        let (now, frame) = (stamped.time, &stamped.frame);
        self.clock.on_frame(now, frame);
        let drive = &self.rig.drive;
        if let Some(message) = error_frames::read(frame) {
            if !message.is_good && !self.errors.contains(&message.text) {
                self.errors.push(message.text);
            }
        } else if let Some(feedback) = drive.decode(frame) {
            self.take_feedback(now, &feedback);
        } else if let Some(amperes) = drive.decode_target(frame) {
            self.commanded_amperes = amperes;
            let stop = drive.encode(Command::QuickStop.controlword(), 0.0);
            if self.clock.zero().is_some() && *frame == stop {
                self.quick_stop.get_or_insert(now);
            }
        } else if *frame == NmtCommand::Stop.frame(Some(drive.node_id())) {
            self.nmt_stop.get_or_insert(now);
        } else if self.is_heartbeat_of_stopped(frame) && self.nmt_stop.is_some() {
            self.stopped.get_or_insert(now);
        }
    }

    /// Whether the ramp has shown what it can.
    pub(super) fn is_over(&self) -> bool {
        let is_warm = self.has_moved || !self.rig.rig.preflight.heating;
        self.is_rest_over && (is_warm || self.position().is_err())
    }

    /// Whether the drive has said that it was stopped.
    pub(super) fn is_stopped(&self) -> bool {
        self.stopped.is_some()
    }

    fn take_feedback(&mut self, now: Duration, feedback: &Feedback) {
        self.has_feedback = true;
        let since_zero = self.clock.scenario_time(now).unwrap_or_default();
        if let Some(since) = self.quick_stop {
            self.take_stop(now.saturating_sub(since), feedback);
            return;
        }
        let millimetres = feedback.position_metres * MILLIMETRES_PER_METRE;
        if since_zero < REST {
            let (low, high) = self.rest.unwrap_or((millimetres, millimetres));
            self.rest = Some((low.min(millimetres), high.max(millimetres)));
            return;
        }
        self.is_rest_over = true;
        self.take_heated(millimetres);
    }

    fn take_heated(&mut self, millimetres: f64) {
        let Some((low, high)) = self.rest.filter(|_| !self.has_moved) else {
            return;
        };
        self.displacement_millimetres = millimetres - (low + high) / 2.0;
        self.heated_amperes = self.commanded_amperes;
        let is_beyond = self.displacement_millimetres.abs() >= self.motion_millimetres();
        self.samples_beyond = if is_beyond {
            self.samples_beyond + 1
        } else {
            0
        };
        self.has_moved = self.samples_beyond >= MOTION_SAMPLES;
    }

    fn take_stop(&mut self, since: Duration, feedback: &Feedback) {
        self.after_stop = Some(*feedback);
        let is_enabled =
            State::from_statusword(feedback.statusword) == Some(State::OperationEnabled);
        let limit = NO_CURRENT * self.rig.rig.limits.current_amperes;
        let flows = feedback
            .current_amperes
            .is_some_and(|amperes| amperes.abs() > limit);
        if !is_enabled && !flows {
            self.without_current.get_or_insert(since);
        }
    }

    fn is_heartbeat_of_stopped(&self, frame: &CanFrame) -> bool {
        let id = 0x700 + u16::from(self.rig.drive.node_id().get());
        frame.standard_id() == Some(id) && frame.data().first() == Some(&NmtState::Stopped.number())
    }

    fn motion_millimetres(&self) -> f64 {
        MOTION_STEPS * self.rig.rig.drive.position.resolution_millimetres
    }

    /// What came of it, when the session has ended like this.
    pub(super) fn checks(&self, ended: Result<(), &WorldError>) -> Vec<Check> {
        let mut checks = Vec::new();
        let steps: [fn(&Self) -> Step; 6] = [
            Self::configuration,
            Self::enabled,
            Self::at_rest,
            Self::direction,
            Self::quick_stop,
            Self::nmt_stop,
        ];
        for step in steps {
            let Step { name, found } = step(self);
            let check = match (found, ended) {
                (Found::Passed(text), _) => Check::passed(name, text),
                (Found::Open(text), _) => Check::open(name, text),
                (Found::Failed(text), _) => Check::failed(name, text),
                (Found::Missing(text), Ok(())) => Check::failed(name, text),
                (Found::Missing(_), Err(error)) => Check::failed(name, reason(error)),
            };
            let has_failed = matches!(check.outcome, super::Outcome::Failed);
            checks.push(check);
            if has_failed {
                return checks;
            }
        }
        checks.push(match (self.errors.as_slice(), ended) {
            (_, Err(error)) => Check::failed("end", reason(error)),
            ([], Ok(())) => Check::passed("error frames", "none"),
            (errors, Ok(())) => Check::failed(
                "error frames",
                format!(
                    "{}: look at cable, termination and bit rates",
                    errors.join(", ")
                ),
            ),
        });
        checks
    }

    fn configuration(&self) -> Step {
        let drive = &self.rig.drive;
        let [told, taken] = drive.lengths_bytes();
        let found = match self.has_feedback {
            true => Found::Passed(format!(
                "PDOs 0x{:03X} ({told} bytes) and 0x{:03X} ({taken} bytes) are mapped",
                drive.feedback_id(),
                drive.command_id()
            )),
            false => Found::Missing(format!("no PDO 0x{:03X} came", drive.feedback_id())),
        };
        Step::new("configuration", found)
    }

    fn enabled(&self) -> Step {
        let found = match (self.clock.zero(), self.position()) {
            (Some(_), _) => Found::Passed("Operation enabled, at 0 A".to_owned()),
            (None, Err(_)) => Found::Open("not awaited".to_owned()),
            (None, Ok(())) => Found::Missing("the drive was not enabled".to_owned()),
        };
        Step::new("drive", found)
    }

    fn at_rest(&self) -> Step {
        let found = match (self.position(), self.rest) {
            (Err(text), _) => Found::Failed(text),
            (Ok(()), Some((low, high))) if self.is_rest_over => Found::Passed(at_rest(low, high)),
            _ => Found::Missing("the drive told none for a second".to_owned()),
        };
        Step::new("position", found)
    }

    /// Whether the position without current can be true.
    fn position(&self) -> Result<(), String> {
        let Some((low, high)) = self.rest else {
            return Ok(());
        };
        let range = self.rig.rig.limits.position_millimetres;
        if low < range.min || high > range.max {
            return Err(format!(
                "{}, beyond the limits of the rig ({} to {} mm): look at units_at_stop and units_per_millimetre",
                at_rest(low, high),
                range.min,
                range.max
            ));
        }
        if let Some(rail) = [low, high]
            .iter()
            .find_map(|at| rail(&self.rig.drive.position(), *at))
        {
            return Err(format!(
                "the object has its extreme value {rail}: is the sensor connected?"
            ));
        }
        if high - low >= self.motion_millimetres() {
            return Err(format!(
                "it moves from {}: noise, or resolution_millimetres is too small",
                at_rest(low, high)
            ));
        }
        Ok(())
    }

    fn direction(&self) -> Step {
        let preflight = &self.rig.rig.preflight;
        let (displacement, amperes) = (self.displacement_millimetres, self.heated_amperes);
        let found = if !preflight.heating {
            Found::Open("not heated, as you wished".to_owned())
        } else if displacement <= -self.motion_millimetres() {
            // Beyond a limit of the rig it may be before it is motion.
            Found::Failed(format!(
                "falls by {:.2} mm at {amperes:.2} A: a heated wire lifts its load; turn the sign of units_per_millimetre",
                -displacement
            ))
        } else if self.has_moved {
            Found::Passed(format!("rises by {displacement:.2} mm at {amperes:.2} A"))
        } else {
            Found::Missing(format!(
                "{displacement:.2} mm within {} s, at {amperes:.2} A in the end ({:.2} mm are motion): is the wire connected, and the command's scaling right?",
                preflight.heating_seconds_max,
                self.motion_millimetres()
            ))
        };
        Step::new("direction", found)
    }

    fn quick_stop(&self) -> Step {
        let limit = Duration::from_millis(self.rig.rig.preflight.stop_milliseconds_max.into());
        let milliseconds = |time: Duration| time.as_secs_f64() * 1e3;
        let found = match (self.quick_stop, self.without_current) {
            (None, _) => Found::Missing("none was sent".to_owned()),
            (Some(_), Some(after)) if after <= limit => Found::Passed(format!(
                "no current after {:.1} ms (limit {} ms)",
                milliseconds(after),
                limit.as_millis()
            )),
            (Some(_), Some(after)) => Found::Failed(format!(
                "no current only after {:.1} ms (limit {} ms)",
                milliseconds(after),
                limit.as_millis()
            )),
            (Some(_), None) => match self.after_stop.map(|sample| sample.current_amperes) {
                // As when a limit was violated: NMT stop came at once.
                None => Found::Missing("no sample came after it".to_owned()),
                Some(Some(amperes)) => Found::Failed(format!(
                    "the drive does not obey: {amperes:.2} A flow on; switch it off by hand"
                )),
                Some(None) => Found::Failed(
                    "the drive stays in Operation enabled; switch it off by hand".to_owned(),
                ),
            },
        };
        Step::new("quick stop", found)
    }

    fn nmt_stop(&self) -> Step {
        let limit = self.patience().as_millis();
        let after = self.nmt_stop.zip(self.stopped);
        let found = match after.map(|(sent, stopped)| stopped - sent) {
            Some(after) if after <= self.patience() => Found::Passed(format!(
                "Stopped in a heartbeat after {:.1} ms (limit {limit} ms)",
                after.as_secs_f64() * 1e3
            )),
            _ => Found::Failed(format!(
                "no heartbeat told the state Stopped within {limit} ms: the drive does not obey NMT"
            )),
        };
        Step::new("NMT stop", found)
    }
}

/// One check of the session.
struct Step {
    name: &'static str,
    found: Found,
}

impl Step {
    fn new(name: &'static str, found: Found) -> Self {
        Self { name, found }
    }
}

enum Found {
    Passed(String),
    Failed(String),
    Open(String),
    /// It was not seen; how the session ended tells why, else this text.
    Missing(String),
}

/// Why the session failed; of a controller that gave up, what it said last.
fn reason(error: &WorldError) -> String {
    match error {
        WorldError::Process { log, .. } => log.lines().last().map(|line| line.trim().to_owned()),
        _ => None,
    }
    .filter(|said| !said.is_empty())
    .unwrap_or_else(|| error.to_string())
}

/// The extreme value that the object has at a position, as a sensor's that is not connected.
fn rail(position: &Scaled, millimetres: f64) -> Option<f64> {
    let bits = 8 * i32::try_from(position.field.length_bytes).unwrap_or(4);
    let raw = (millimetres * position.units + position.offset).round();
    let extremes = if position.field.is_signed {
        [-(2_f64.powi(bits - 1)), 2_f64.powi(bits - 1) - 1.0]
    } else {
        // 0 is where many a sensor's load rests.
        [2_f64.powi(bits) - 1.0; 2]
    };
    extremes
        .into_iter()
        .find(|extreme| raw.to_bits() == extreme.to_bits())
}

/// Where the load rests, to the hundredth of a millimetre; a zero has no sign.
fn at_rest(low: f64, high: f64) -> String {
    let [low, high] = [low, high].map(|at| (100.0 * at).round() / 100.0 + 0.0);
    format!("{low:.2} to {high:.2} mm without current")
}

#[cfg(test)]
mod tests {
    use canopen::frame::ERROR_FLAG;

    use super::*;

    const RIG: &str = "schema = 1\nname = \"bench\"\n[limits]\ncurrent_amperes = 0.9\n\
        position_millimetres = { min = -1.0, max = 45.0 }\nspeed_millimetres_per_second = 400.0\n";
    const PERIOD: Duration = Duration::from_millis(10);

    /// A flight on the emulated drive, whose frames may be left out or made otherwise.
    struct Flight {
        frames: Vec<Stamped>,
        now: Duration,
    }

    impl Flight {
        /// Rest, a ramp with motion, quick stop and NMT stop, as they should be.
        fn good() -> Self {
            let mut flight = Self::heated(0.5);
            flight.stop(&[(0x0250, 0), (0x0250, 0)]);
            flight.hear(CanFrame::new(0x000, &[2, 0x10]));
            flight.hear(CanFrame::new(0x710, &[4]));
            flight
        }

        /// Until the load has moved.
        fn heated(millimetres: f64) -> Self {
            let mut flight = Self {
                frames: Vec::new(),
                now: Duration::ZERO,
            };
            for cycle in 0..110 {
                let at = if cycle < 105 { 0.0 } else { millimetres };
                flight.cycle(0x0237, at, 600);
                flight.hear(CanFrame::new(0x210, &[0x0F, 0, 0x58, 2]));
            }
            flight
        }

        /// The samples after a quick stop.
        fn stop(&mut self, samples: &[(u16, i16)]) {
            self.hear(CanFrame::new(0x210, &[2, 0, 0, 0]));
            for (statusword, milliamperes) in samples {
                self.cycle(*statusword, 0.5, *milliamperes);
            }
        }

        fn cycle(&mut self, statusword: u16, millimetres: f64, milliamperes: i16) {
            self.now += PERIOD;
            self.hear(CanFrame::new(0x080, &[1]));
            #[expect(clippy::cast_possible_truncation, reason = "a few millimetres")]
            let micrometres = (millimetres * 1e3) as i32;
            let mut data = [0; 8];
            data[..2].copy_from_slice(&statusword.to_le_bytes());
            data[2..6].copy_from_slice(&micrometres.to_le_bytes());
            data[6..].copy_from_slice(&milliamperes.to_le_bytes());
            self.hear(CanFrame::new(0x190, &data));
        }

        fn hear(&mut self, frame: CanFrame) {
            self.frames.push(Stamped::new(self.now, frame));
        }

        /// The checklist, and whether the bench would have ended the ramp.
        fn told(&self) -> (String, bool) {
            let rig = LoadedRig::of_text(RIG).unwrap();
            let mut heating = Heating::new(&rig).unwrap();
            heating.follow(&self.frames);
            let checks = heating.checks(Ok(()));
            let lines: Vec<String> = checks.iter().map(ToString::to_string).collect();
            (lines.join("\n"), heating.is_over())
        }
    }

    #[test]
    fn a_good_flight_passes_and_is_over_when_the_load_has_moved() {
        let (lines, is_over) = Flight::good().told();
        assert!(is_over && !lines.contains('✗'), "{lines}");
        let expected = "✓ direction     rises by 0.50 mm at 0.60 A\n\
            ✓ quick stop    no current after 10.0 ms (limit 100 ms)\n\
            ✓ NMT stop      Stopped in a heartbeat after 0.0 ms (limit 100 ms)\n✓ error frames  none";
        assert!(lines.ends_with(expected), "{lines}");
    }

    #[test]
    fn a_drive_that_does_not_stop_is_told() {
        let mut deaf = Flight::heated(0.5);
        deaf.stop(&[(0x0237, 600), (0x0237, 600)]);
        let (lines, _) = deaf.told();
        assert!(
            lines.ends_with("the drive does not obey: 0.60 A flow on; switch it off by hand"),
            "{lines}"
        );

        let mut slow = Flight::heated(0.5);
        slow.stop(&[(0x0237, 600); 12]);
        slow.cycle(0x0250, 0.5, 0);
        let (lines, _) = slow.told();
        assert!(
            lines.ends_with("✗ quick stop    no current only after 130.0 ms (limit 100 ms)"),
            "{lines}"
        );

        let mut no_nmt = Flight::heated(0.5);
        no_nmt.stop(&[(0x0250, 0)]);
        no_nmt.hear(CanFrame::new(0x000, &[2, 0x10]));
        no_nmt.hear(CanFrame::new(0x710, &[5]));
        let (lines, _) = no_nmt.told();
        assert!(lines.ends_with("the drive does not obey NMT"), "{lines}");
    }

    #[test]
    fn a_zero_at_rest_has_no_sign() {
        let text = at_rest(-0.004, 0.004);
        assert_eq!(text, "0.00 to 0.00 mm without current");
    }

    #[test]
    fn a_spike_is_no_motion_and_a_sensor_at_its_end_no_position() {
        let mut spike = Flight::heated(0.0);
        spike.cycle(0x0237, 3.0, 600);
        spike.cycle(0x0237, 0.0, 600);
        assert!(!spike.told().1);
        let rig = LoadedRig::of_text(RIG).unwrap();
        let position = rig.drive.position();
        assert_eq!(rail(&position, -2_147_483.648), Some(-2_147_483_648.0));
        assert_eq!(rail(&position, 10.0), None);
    }

    #[test]
    fn errors_on_the_bus_are_told() {
        let mut flight = Flight::good();
        let data = [0, 0x20, 0, 0, 0, 0, 0, 0];
        let message = CanFrame::from_raw(ERROR_FLAG | 0x004, 8, data).unwrap();
        flight.hear(message);
        flight.hear(message);
        let (lines, _) = flight.told();
        assert!(
            lines.ends_with(
                "✗ error frames  error passive: look at cable, termination and bit rates"
            ),
            "{lines}"
        );
    }
}
