//! A rig file as it lies on the disk, with the drive that it describes and what then the frames of the bus mean.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use dbc::names::{CURRENT, POSITION, TARGET_CURRENT};
use dbc::{Coding, Composer, Database, DbcError, ExternalFrames, Kind, PositionUnit, Signal};
use miette::Diagnostic;
use scenario::node::LoopNodes;
use scenario::reference::Trajectory;
use scenario::rig::drive::{DriveError, DriveLayout, Field, Scaled};
use scenario::rig::{PositionRange, RigFile};
use scenario::{Scenario, ScenarioError, read_text};

use crate::catalogue::{Player, Published};
use crate::data_sheet::FILE_BYTES_MAX;

/// 36 mm is 36.00000000000001 mm once it was metres.
const ROUNDING_MILLIMETRES: f64 = 1e-6;
/// Default name of a rig file, beside the scenarios.
pub const RIG_FILE: &str = "rig.toml";
/// Why a rig file cannot be used.
#[derive(Debug, Diagnostic, thiserror::Error)]
pub enum RigError {
    /// The file is not valid.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Invalid(#[from] ScenarioError),
    /// The EDS cannot be read.
    #[error("{}: the EDS {} cannot be read", rig.display(), eds.display())]
    Eds {
        /// The rig file.
        rig: PathBuf,
        /// The EDS.
        eds: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Rig file and EDS do not fit each other.
    #[error("{}: {reason}", rig.display())]
    Drive {
        /// The rig file.
        rig: PathBuf,
        /// Why.
        reason: Box<DriveError>,
    },
    /// Frames of the drive would be taken for another node's.
    #[error("{}: the drive's frames and another node's have the same identifier: {reason}", rig.display())]
    Identifier {
        /// The rig file.
        rig: PathBuf,
        /// Which.
        reason: DbcError,
    },
}

/// A rig with its drive.
#[derive(Clone, Debug)]
pub struct LoadedRig {
    /// The file.
    pub path: PathBuf,
    /// Its text.
    pub text: String,
    /// Its meaning.
    pub file: RigFile,
    /// The drive's EDS.
    pub eds: String,
    /// The drive's identity and PDOs.
    pub drive: DriveLayout,
    /// The frames under the law whose terms are in the shipped DBC.
    pub database: Arc<Database>,
}

impl LoadedRig {
    /// Reads a rig file and the EDS that it names.
    ///
    /// # Errors
    /// They cannot be read, or do not fit each other.
    pub fn load(path: &Path) -> Result<Self, RigError> {
        let (file, text) = RigFile::load_with_text(path)?;
        let eds = match file.eds_path(path) {
            None => dbc::DRIVE_EDS.to_owned(),
            Some(eds) => read_text(&eds, FILE_BYTES_MAX).map_err(|source| RigError::Eds {
                rig: path.to_owned(),
                eds,
                source,
            })?,
        };
        Self::new(path, file, text, eds)
    }

    /// A rig file that lies nowhere, for a drive with the emulated one's EDS.
    ///
    /// # Errors
    /// It is not valid.
    pub fn from_text(text: &str) -> Result<Self, RigError> {
        let file = RigFile::parse(text, RIG_FILE)?;
        let eds = dbc::DRIVE_EDS.to_owned();
        Self::new(Path::new(RIG_FILE), file, text.to_owned(), eds)
    }

    /// The drive of one node of a rig file with several, as that of a rig file of its own.
    ///
    /// # Errors
    /// Node and EDS do not fit each other.
    pub fn of_node(path: &Path, file: RigFile, eds: Option<&String>) -> Result<Self, RigError> {
        let eds = eds.map_or(dbc::DRIVE_EDS, String::as_str).to_owned();
        let text = file.to_toml();
        Self::new(path, file, text, eds)
    }

    fn new(path: &Path, file: RigFile, text: String, eds: String) -> Result<Self, RigError> {
        let dictionary = dbc::dictionary(&eds, file.drive.node_id);
        let drive = dictionary
            .map_err(DriveError::from)
            .and_then(|dictionary| {
                DriveLayout::new(dictionary, &file.drive, file.limits.current_amperes)
            })
            .map_err(|reason| RigError::Drive {
                rig: path.to_owned(),
                reason: Box::new(reason),
            })?;
        let mut rig = Self {
            path: path.to_owned(),
            text,
            file,
            eds,
            drive,
            database: Arc::default(),
        };
        let mut nodes = LoopNodes::default();
        rig.name_ids(&mut nodes);
        let composer = Composer::new(&nodes.controller.name, nodes.controller.id);
        let published = Published::default();
        let composer = published.compose(composer, &nodes, ("", 0), Player::OnRig(&rig));
        let database = composer.finish();
        (database.refuse_duplicates()).map_err(|reason| RigError::Identifier {
            rig: path.to_owned(),
            reason,
        })?;
        rig.database = Arc::new(database);
        Ok(rig)
    }

    /// Gives the nodes of a loop the IDs that they have on the rig.
    pub(crate) fn name_ids(&self, nodes: &mut LoopNodes) {
        nodes.drive.id = self.drive.node_id().get();
        if let Some(io) = &mut nodes.io {
            io.id = self.file.fan.node_id;
        }
    }

    /// Adds the frames of its drive to those of a bus.
    pub(crate) fn with_drive(
        &self,
        composer: Composer,
        node: (&str, u8),
        unit: Option<&PositionUnit<'_>>,
    ) -> Composer {
        let drive = &self.drive;
        let [statusword, controlword] = drive.words();
        let feedback = |signal: &Signal| match signal.name.as_str() {
            POSITION => scaled(drive.position()),
            CURRENT => drive.current().map_or(signal.coding.absent(), scaled),
            _ => in_word(signal, statusword),
        };
        let command = |signal: &Signal| match signal.name.as_str() {
            TARGET_CURRENT => scaled(drive.target()),
            _ => in_word(signal, controlword),
        };
        let frames = ExternalFrames {
            identifiers: [drive.feedback_id(), drive.command_id()],
            lengths_bytes: drive.lengths_bytes().map(|bytes| u8::try_from(bytes).ok()),
            feedback: &feedback,
            command: &command,
            heartbeat_milliseconds: self.file.timeouts.drive_heartbeat_milliseconds.into(),
        };
        composer.with_drive(node, None, Some(&frames), unit)
    }

    /// Refuses, before any current flows, a scenario whose set-point leaves the limits.
    ///
    /// # Errors
    /// Where the set-point leaves the limits.
    pub fn admits(&self, scenario: &Scenario) -> Result<(), String> {
        if scenario.reference.is_empty() {
            return Ok(());
        }
        let PositionRange { min, max } = self.file.limits.position_millimetres;
        let trajectory = scenario.reference.trajectory();
        for seconds in telling_cycles_seconds(scenario, &trajectory) {
            let wanted = 1e3 * trajectory.at(seconds).position_metres;
            if !(min - ROUNDING_MILLIMETRES..=max + ROUNDING_MILLIMETRES).contains(&wanted) {
                let symbol = scenario.wiring.unit.symbol();
                return Err(format!(
                    "the set-point is {wanted} {symbol} at {seconds} s, beyond the rig's limits ({min} to {max} {symbol})"
                ));
            }
        }
        Ok(())
    }

    /// The rig file in a folder, if there is one.
    ///
    /// # Errors
    /// There is one that cannot be used.
    pub fn in_folder(folder: &Path) -> Result<Option<Self>, RigError> {
        let path = folder.join(RIG_FILE);
        if fs::exists(&path).unwrap_or(false) {
            Self::load(&path).map(Some)
        } else {
            Ok(None)
        }
    }
}

/// The times of the cycles in which the set-point may have a value that it did not have before: a day has too many to ask for all.
fn telling_cycles_seconds(
    scenario: &Scenario,
    trajectory: &Trajectory,
) -> impl Iterator<Item = f64> {
    let nanoseconds = |seconds: f64| Duration::from_secs_f64(seconds).as_nanos();
    let period = scenario.bus.sync_period().as_nanos();
    let end = nanoseconds(scenario.duration_seconds);
    let stretches = trajectory.stretches(scenario.duration_seconds);
    let cycles = stretches.flat_map(move |(from_seconds, until_seconds)| {
        let last = nanoseconds(until_seconds).div_ceil(period);
        nanoseconds(from_seconds) / period..=last
    });
    let times = cycles.map(move |cycle| cycle * period);
    let times = times.filter(move |time| *time < end);
    times.map(|time| Duration::from_nanos_u128(time).as_secs_f64())
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

/// Bits of a status- or controlword, which comes first in the emulated drive's PDOs.
fn in_word(signal: &Signal, word: Field) -> Coding {
    let coding = signal.coding;
    coding.starting_at(coding.start_bit + start_bit(word))
}

fn start_bit(field: Field) -> u8 {
    u8::try_from(8 * field.start_byte).unwrap_or(u8::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use canopen::CanFrame;

    const RIG: &str = "schema = 1\nname = \"bench\"\n[drive]\nnode_id = 32\n\
        position = { units_per_millimetre = -10.0, units_at_stop = 5000.0 }\ncurrent = { object = \"\" }\n\
        [limits]\ncurrent_amperes = 0.9\nposition_millimetres = { min = -1.0, max = 45.0 }\n\
        speed_millimetres_per_second = 400.0\n";

    fn load(text: &str) -> Result<LoadedRig, RigError> {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(RIG_FILE), text).unwrap();
        LoadedRig::in_folder(folder.path()).map(Option::unwrap)
    }

    #[test]
    fn frames_of_another_drive_mean_what_the_rig_file_says() {
        let rig = load(RIG).unwrap();
        let decode =
            |path: &str, frame: &CanFrame| rig.database.require(path).unwrap().decode(frame);
        let feedback = CanFrame::new(0x1A0, &[0x37, 2, 0x4C, 0x13, 0, 0, 0x11, 0x22]);
        let position = decode("drive_tpdo1.position_millimetres", &feedback).unwrap();
        assert!((position - 6.0).abs() < 1e-9, "{position}");
        assert_eq!(
            decode("drive_tpdo1.statusword_state", &feedback),
            Some(55.0)
        );
        assert_eq!(
            decode("drive_tpdo1.current_amperes", &feedback),
            None,
            "it has none"
        );
        let command = rig.drive.encode(0x0F, 0.25);
        assert_eq!(
            decode("drive_rpdo1.target_current_amperes", &command),
            Some(0.25)
        );
        let heartbeat = CanFrame::new(0x720, &[5]);
        assert_eq!(decode("drive_heartbeat.nmt_state", &heartbeat), Some(5.0));
        // The emulated drive's own identifiers mean nothing here.
        for id in [0x190, 0x210, 0x290, 0x710] {
            assert_eq!(
                rig.database.decode(&CanFrame::new(id, &[0; 8])).map(|_| ()),
                None
            );
        }
    }

    #[test]
    fn a_set_point_on_the_limit_is_admitted() {
        let text = "schema = 1\nname = \"s\"\nduration_seconds = 1.0\n[controller.pid]\n\
            [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 36.0\n";
        let scenario = Scenario::parse(text, "s.toml", |_| unreachable!("no table")).unwrap();
        let rig = |max: &str| load(&RIG.replace("max = 45.0", max)).unwrap();
        assert_eq!(rig("max = 36.0").admits(&scenario), Ok(()));
        assert!(rig("max = 35.9").admits(&scenario).is_err());
    }

    #[test]
    fn a_set_point_beyond_the_limits_is_found_wherever_it_is() {
        let rig = load(&RIG.replace("max = 45.0", "max = 35.0")).unwrap();
        let admits = |pieces: &str| {
            let text = format!(
                "schema = 1\nname = \"s\"\nduration_seconds = 604800.0\n[bus]\nsync_period_milliseconds = 0.1\n[controller.pid]\n\
                 [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 20.0\n{pieces}"
            );
            let scenario = Scenario::parse(&text, "s.toml", |_| unreachable!("no table")).unwrap();
            rig.admits(&scenario)
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
        // Behind the end, and where another piece is in its place before it gets there.
        assert_eq!(
            admits(&(sine(15.1) + &step(10.0, 20.0) + &ramp(36.0) + &step(600_001.0, 0.0))),
            Ok(())
        );
    }

    #[test]
    fn the_fan_is_where_the_rig_file_says() {
        let rig = load(&format!("{RIG}[fan]\nnode_id = 64\n")).unwrap();
        let frame = CanFrame::new(0x240, &[0x88, 0x13, 0x85, 0xFF]);
        let factor = rig.database.require("disturbance_rpdo1.convection_factor");
        assert_eq!(factor.unwrap().decode(&frame), Some(5.0));
        let heartbeat = CanFrame::new(0x740, &[5]);
        let state = rig.database.require("disturbance_heartbeat.nmt_state");
        assert_eq!(state.unwrap().decode(&heartbeat), Some(5.0));
        // Either may take the number that is the other's by default.
        let swapped = RIG.replace("node_id = 32", "node_id = 17") + "[fan]\nnode_id = 16\n";
        assert!(load(&swapped).is_ok());
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let refused = |text: &str| load(text).unwrap_err().to_string();
        let other = RIG.replace("node_id = 32", "node_id = 32\neds = \"none.eds\"");
        assert!(refused(&other).contains("none.eds cannot be read"));
        let other = RIG.replace("object = \"\"", "object = \"0x2345:01\"");
        assert!(refused(&other).ends_with("the drive's EDS has no object 0x2345:01"));
    }
}
