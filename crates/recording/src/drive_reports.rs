//! Reports of a drive on itself after a node ended a run: its power state and its current. The bench asks for them by SDO once
//! the drive's watches have run out, since a drive that hears no SYNC sends no message by itself.

use std::time::Duration;

use can::CanFrame;
use canopen::cia402::STATUSWORD;
use canopen::sdo::{DEFAULT_REQUEST_ID, DEFAULT_RESPONSE_ID};
use dbc::{Coding, Database, names};
use plan::{ControlLoop, message_of};
use scenario::rig::{Timeouts, object_address};

/// Index and sub-index of an object.
type ObjectAddress = (u16, u8);

/// Client's command that reads an object.
const UPLOAD: u8 = 0x40;
/// Mask and value of the server's answer that contains the value, of any length.
const EXPEDITED: (u8, u8) = (0b1110_0010, 0b0100_0010);
const STATUSWORD_OBJECT: ObjectAddress = (STATUSWORD, 0);
/// Number of SYNC periods after which a drive misses the SYNC.
const SYNC_PERIODS: u32 = 3;
/// Longest watch to wait for.
const WATCH_MAX: Duration = Duration::from_secs(1);

/// Returns the time after which a drive without a controller is off by itself: its watches for heartbeat and SYNC have run out.
pub fn watch(one: &ControlLoop) -> Duration {
    let real = one.real_drive.as_ref();
    let timeouts = real.map_or_else(Timeouts::default, |drive| drive.real.timeouts);
    let heartbeat = Duration::from_millis(timeouts.controller_lost_milliseconds.into());
    let sync = SYNC_PERIODS * one.trial.run.bus.sync_period();
    heartbeat.max(sync).min(WATCH_MAX)
}

/// Returns the requests for a drive's power state and for its current, if it measures that.
pub fn requests(database: &Database, one: &ControlLoop) -> [Option<CanFrame>; 2] {
    let drive = one.drive().id();
    let request = |(index, sub_index): ObjectAddress| {
        let [low, high] = index.to_le_bytes();
        let data = [UPLOAD, low, high, sub_index, 0, 0, 0, 0];
        CanFrame::new(DEFAULT_REQUEST_ID + u16::from(drive), &data)
    };
    let current = current(database, one).map(|(object, _)| object);
    [Some(STATUSWORD_OBJECT), current].map(|object| object.map(request))
}

/// Returns the object of the measured current, with the coding of its value.
fn current(database: &Database, one: &ControlLoop) -> Option<(ObjectAddress, Coding)> {
    let feedback = message_of(database, one.drive(), names::TPDO1).ok()?;
    let signal = feedback.signal(&one.trial.wiring.drive_quantities().name(names::OUTPUT))?;
    let real = one.real_drive.as_ref();
    let object = real.map_or(&signal.object, |drive| &drive.real.current.object);
    Some((object_address(object).ok()?, signal.coding.starting_at(0)))
}

/// Answers of a drive, each with its scenario time in seconds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DriveReports {
    pub statuswords: Vec<(f64, f64)>,
    pub currents_amperes: Vec<(f64, f64)>,
}

/// Reader of the answers of one drive.
pub(crate) struct DriveReportReader {
    /// Identifier of the answers.
    pub(crate) raw_id: u32,
    current: Option<(ObjectAddress, Coding)>,
    /// Answers so far, in the order of time.
    pub(crate) reports: DriveReports,
}

impl DriveReportReader {
    pub(crate) fn new(database: &Database, one: &ControlLoop) -> Self {
        let drive = one.drive().id();
        Self {
            raw_id: u32::from(DEFAULT_RESPONSE_ID) + u32::from(drive),
            current: current(database, one),
            reports: DriveReports::default(),
        }
    }

    /// Takes a frame with that identifier.
    pub(crate) fn on_frame(&mut self, time: Duration, frame: &CanFrame) {
        let &[command, low, high, sub_index, a, b, c, d] = frame.data() else {
            return;
        };
        if command & EXPEDITED.0 != EXPEDITED.1 {
            return;
        }
        let index = u16::from_le_bytes([low, high]);
        let object = (index, sub_index);
        let time_seconds = time.as_secs_f64();
        if object == STATUSWORD_OBJECT {
            let word = f64::from(u16::from_le_bytes([a, b]));
            self.reports.statuswords.push((time_seconds, word));
        }
        if let Some((_, coding)) = self.current.filter(|(current, _)| *current == object) {
            let amperes = coding.decode(&[a, b, c, d, 0, 0, 0, 0]);
            self.reports.currents_amperes.push((time_seconds, amperes));
        }
    }
}
