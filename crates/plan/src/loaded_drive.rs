//! A real drive with its EDS, and the meaning that it gives to the frames of the bus.

use std::time::Duration;

use canopen::eds::{self, Notes};
use dbc::names::{self, HEARTBEAT, OUTPUT, POSITION, RPDO1, TARGET, TPDO1};
use dbc::{Coding, Composer, Kind, Message, Signal};
use scenario::Trial;
use scenario::reference::Trajectory;
use scenario::rig::drive::{DriveError, DriveLayout, Field, Pdo, Scaled};
use scenario::rig::{Limits, RealDrive};

/// Tolerance for rounding at the end of a ramp or a sine.
const ROUNDING: f64 = 1e-6;

/// A drive that canrig does not emulate.
#[derive(Clone, Debug)]
pub struct LoadedDrive {
    /// Facts from the rig file.
    pub real: RealDrive,
    /// EDS of the drive.
    pub eds: String,
    /// Identity and PDOs of the drive.
    pub layout: DriveLayout,
    /// Slips of the EDS.
    pub notes: Notes,
}

impl LoadedDrive {
    /// Makes the drive with this EDS; with that of the emulated drive if `None`.
    ///
    /// # Errors
    /// Rig file and EDS do not fit each other.
    pub fn new(real: RealDrive, eds: Option<&String>) -> Result<Self, DriveError> {
        let Some(text) = eds else {
            let dictionary = dbc::dictionary(dbc::DRIVE_EDS, real.node_id)?;
            return Ok(Self {
                layout: DriveLayout::new(dictionary, &real)?,
                real,
                eds: dbc::DRIVE_EDS.to_owned(),
                notes: Notes::default(),
            });
        };
        let sheet = eds::read(text, real.node_id)?;
        let used = DriveLayout::used_objects(&real);
        let mut doubts = used.into_iter().filter_map(|(index, sub_index)| {
            let what = sheet.contradiction(index, sub_index)?;
            Some(DriveError::contradiction((index, sub_index), what))
        });
        if let Some(error) = doubts.next() {
            return Err(error);
        }
        Ok(Self {
            layout: DriveLayout::new(sheet.dictionary, &real)?,
            real,
            eds: text.clone(),
            notes: sheet.notes,
        })
    }

    /// Adds the frames of its drive to those of a bus.
    pub(crate) fn with_drive(&self, composer: Composer, node: (&str, u8)) -> Composer {
        let drive = &self.layout;
        let feedback = |signal: &Signal| match names::pattern(&signal.name) {
            Some(POSITION) => Some(scaled(drive.position)),
            Some(OUTPUT) => drive.current.map(scaled),
            _ => Some(in_word(signal, drive.statusword)),
        };
        let command = |signal: &Signal| match names::pattern(&signal.name) {
            Some(TARGET) => Some(scaled(drive.target)),
            _ => Some(in_word(signal, drive.controlword)),
        };
        let heartbeat = self.real.timeouts.drive_heartbeat_milliseconds;
        composer
            .with_drive(node, None)
            .edited(node.0, TPDO1, |message| {
                lay_out(message, &drive.feedback, feedback)
            })
            .edited(node.0, RPDO1, |message| {
                lay_out(message, &drive.command, command)
            })
            .edited(node.0, HEARTBEAT, |message| {
                message.cycle_time_milliseconds = heartbeat.into();
            })
    }

    /// Refuses, before any current flows, a scenario whose set-point leaves the limits.
    ///
    /// # Errors
    /// The set-point leaves the limits; the error tells where.
    pub fn admits(&self, trial: &Trial) -> Result<(), String> {
        // A signal that another drive measures is no position of this one.
        if trial.reference.is_empty() || !trial.wiring.follows_itself() {
            return Ok(());
        }
        let Limits { min, max, .. } = self.real.limits;
        let trajectory = trial.reference.trajectory();
        for seconds in telling_cycles_seconds(trial, &trajectory) {
            let wanted = trajectory.at(seconds).position;
            if !(min - ROUNDING..=max + ROUNDING).contains(&wanted) {
                let symbol = trial.wiring.sensor.quantity.unit.symbol();
                return Err(format!(
                    "the set-point is {wanted} {symbol} at {seconds} s, beyond the rig's limits ({min} to {max} {symbol})"
                ));
            }
        }
        Ok(())
    }
}

/// Returns the times of the cycles in which the set-point may have a new value: a day has too many cycles to check all.
fn telling_cycles_seconds(trial: &Trial, trajectory: &Trajectory) -> impl Iterator<Item = f64> {
    let nanoseconds = |seconds: f64| Duration::from_secs_f64(seconds).as_nanos();
    let period = trial.run.bus.sync_period().as_nanos();
    let end = nanoseconds(trial.run.duration_seconds);
    let stretches = trajectory.stretches(trial.run.duration_seconds);
    let cycles = stretches.flat_map(move |(from_seconds, until_seconds)| {
        let last = nanoseconds(until_seconds).div_ceil(period);
        nanoseconds(from_seconds) / period..=last
    });
    let times = cycles
        .map(move |cycle| cycle * period)
        .filter(move |time| *time < end);
    times.map(|time| Duration::from_nanos_u128(time).as_secs_f64())
}

/// Lays out a message as a PDO. A signal without a coding is not in it.
fn lay_out(message: &mut Message, pdo: &Pdo, coding: impl Fn(&Signal) -> Option<Coding>) {
    message.raw_id = pdo.id().into();
    message.length_bytes = u8::try_from(pdo.length_bytes).unwrap_or(message.length_bytes);
    message.signals.retain_mut(|signal| {
        let coding = coding(signal);
        signal.coding = coding.unwrap_or(signal.coding);
        coding.is_some()
    });
}

fn scaled(place: Scaled) -> Coding {
    let Scaled {
        field,
        units,
        offset,
    } = place;
    let kind = if field.is_signed {
        Kind::Signed
    } else {
        Kind::Unsigned
    };
    let length_bits = u8::try_from(8 * field.length_bytes).unwrap_or(u8::MAX);
    Coding::integer(start_bit(field), length_bits, kind, units, offset)
}

/// Places a bit of a status- or controlword, which comes first in the emulated drive's PDOs, in the word of this drive.
fn in_word(signal: &Signal, word: Field) -> Coding {
    let coding = signal.coding;
    coding.starting_at(coding.start_bit + start_bit(word))
}

fn start_bit(field: Field) -> u8 {
    u8::try_from(8 * field.start_byte).unwrap_or(u8::MAX)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::catalogue::Catalogue;
    use crate::plan::Plan;
    use can::CanFrame;
    use scenario::Beside;
    use std::path::Path;

    const RIG: &str = r#"schema = 1
name = "bench"
[node.controller]
kind = "controller"
node_id = 1
[node.drive]
kind = "drive"
node_id = 32
position = { increments_per_unit = -10.0, increments_at_zero = 5000.0 }
current = { object = "" }
limits = { current_amperes = 0.9, min = -1.0, max = 45.0, rate_max = 400.0 }
[loop.position]
feedback = "drive.position"
outputs = ["drive.current"]
"#;
    const SCENARIO: &str = "schema = 1\nrig = \"rig.toml\"\nname = \"s\"\nduration_seconds = 1.0\n[controller.pid]\n\
        [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 36.0\n";

    fn load_plan(rig: &str, trial: &str) -> Result<Plan, String> {
        let beside = Beside::new(Path::new("s.toml"));
        let read = |name: &str| match name {
            "rig.toml" => Ok(rig.to_owned()),
            _ => Err(std::io::ErrorKind::NotFound.into()),
        };
        let plan = Plan::parse(&beside, trial.to_owned(), read, &Catalogue::shipped());
        plan.map_err(|error| scenario::without_colours(&error))
    }

    fn drive(plan: &Plan) -> Arc<LoadedDrive> {
        plan.only_loop().unwrap().real_drive.clone().unwrap()
    }

    #[test]
    fn frames_of_another_drive_mean_what_the_rig_file_says() {
        let plan = load_plan(RIG, SCENARIO).unwrap();
        let database = plan.database();
        let decode = |path: &str, frame: &CanFrame| database.require(path).unwrap().decode(frame);
        let feedback = CanFrame::new(0x1A0, &[0x37, 2, 0x4C, 0x13, 0, 0, 0x11, 0x22]);
        let position = decode("drive_tpdo1.position_millimetres", &feedback).unwrap();
        assert!((position - 6.0).abs() < 1e-9, "{position}");
        assert_eq!(
            decode("drive_tpdo1.statusword_state", &feedback),
            Some(55.0)
        );
        assert!(database.signal("drive_tpdo1.current_amperes").is_none());
        let command = drive(&plan).layout.encode(0x0F, 0.25);
        assert_eq!(
            decode("drive_rpdo1.target_current_amperes", &command),
            Some(0.25)
        );
        let heartbeat = CanFrame::new(0x720, &[5]);
        assert_eq!(decode("drive_heartbeat.nmt_state", &heartbeat), Some(5.0));
        // The identifiers of the emulated drive have no meaning here.
        for id in [0x190, 0x210, 0x290, 0x710] {
            assert_eq!(database.message_of(&CanFrame::new(id, &[0; 8])), None);
        }
    }

    #[test]
    fn a_set_point_on_the_limit_is_admitted() {
        let admits = |max: &str| {
            let plan = load_plan(&RIG.replace("max = 45.0", max), SCENARIO).unwrap();
            drive(&plan).admits(&plan.only_loop().unwrap().trial)
        };
        assert_eq!(admits("max = 36.0"), Ok(()));
        assert!(admits("max = 35.9").is_err());
    }

    #[test]
    fn a_set_point_beyond_the_limits_is_found_wherever_it_is() {
        let rig = RIG.replace("max = 45.0", "max = 35.0");
        let admits = |pieces: &str| {
            let text = SCENARIO
                .replace("= 1.0", "= 604800.0")
                .replace("= 36.0", "= 20.0");
            let text = format!("{text}{pieces}[bus]\nsync_period_milliseconds = 1.0\n");
            let plan = load_plan(&rig, &text).unwrap();
            drive(&plan).admits(&plan.only_loop().unwrap().trial)
        };
        let step = |at: f64, to: f64| {
            format!("[[reference.step]]\nat_seconds = {at:?}\nposition_millimetres = {to:?}\n")
        };
        let sine = |amplitude: f64| {
            format!(
                "[[reference.sine]]\nfrom_seconds = 9.0\ncentre_millimetres = 20.0\namplitude_millimetres = {amplitude:?}\nperiod_seconds = 5.0\n"
            )
        };
        let ramp = |to: f64| {
            format!(
                "[[reference.ramp]]\nfrom_seconds = 600000.0\nuntil_seconds = 600009.0\nposition_millimetres = {to:?}\n"
            )
        };
        assert_eq!(
            admits(&(sine(15.0) + &ramp(35.0) + &step(604_799.5, 35.0))),
            Ok(())
        );
        for (pieces, at) in [
            (step(604_799.99, 36.0), "604799.99"),
            (sine(15.1), "10.1"),
            (ramp(36.0), "60000"),
        ] {
            let refused = admits(&pieces).unwrap_err();
            assert!(refused.contains(&format!("at {at}")), "{refused}");
        }
        // After the end, and where another piece replaces it before it gets there.
        assert_eq!(
            admits(&(sine(15.1) + &step(10.0, 20.0) + &ramp(36.0) + &step(600_001.0, 0.0))),
            Ok(())
        );
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let other = RIG.replace("object = \"\"", "object = \"0x2345:01\"");
        let said = load_plan(&other, SCENARIO).unwrap_err();
        assert!(
            said.contains("the drive's EDS has no object 0x2345:01"),
            "{said}"
        );
        let other = RIG.replace("node_id = 32", "node_id = 32\neds = \"none.eds\"");
        let said = load_plan(&other, SCENARIO).unwrap_err();
        assert!(said.contains("the EDS of `drive` cannot be read"), "{said}");
    }
}
