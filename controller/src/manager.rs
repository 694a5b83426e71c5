//! Bring-up of the drive by SDO: checks its identity and configures it like a purchased drive.
//!
//! The PDO parameters are read back. They are written by the standard's full procedure only if they differ, since many
//! drives refuse or store such writes.

use std::time::Duration;

use canopen::eds::{self, IDENTITY};
use canopen::nmt::NodeId;
use canopen::sdo::little_endian_u32;
use canopen::sdo_client::{SdoClient, SdoError, SdoFailure};
use canopen::{Services, cia402};
use scenario::rig::Timeouts;
use scenario::rig::drive::{DriveLayout, Pdo};

/// Bit 31 of a COB-ID: the PDO does not exist.
const INVALID: u32 = 0x8000_0000;
/// Bit 30 of a TPDO's COB-ID: no remote frames. No node sends any, so both settings are accepted.
const NO_REMOTE_FRAMES: u32 = 0x4000_0000;

/// Action on one object.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Action {
    /// Read; any other value ends the bring-up.
    Require,
    /// Read, so that the recording has it; the EDS has no value to compare.
    Show,
    /// Write.
    Write,
    /// Read; a value that differs in the bits of the mask enables the following [`Action::Correct`].
    Compare { mask: u32 },
    /// Write if a value differed.
    Correct,
    /// Start of a new group: from here on no value has differed.
    NewGroup,
}

/// One object and its action.
#[derive(Clone, Debug)]
struct Step {
    action: Action,
    index: u16,
    sub_index: u8,
    /// Name of the object in the EDS.
    name: String,
    value: u32,
    length_bytes: usize,
}

impl Step {
    fn start(&self, client: &mut SdoClient, now: Duration) -> Result<(), SdoError> {
        let object = (self.index, self.sub_index);
        match self.action {
            Action::Write | Action::Correct => {
                let bytes = &self.value.to_le_bytes()[..self.length_bytes];
                client.start_download(now, object, bytes)
            }
            _ => client.start_upload(now, object),
        }
    }

    /// Returns a value of this object as text.
    fn shown(&self, value: u32) -> String {
        match self.length_bytes {
            4 => format!("0x{value:08X}"),
            _ => value.to_string(),
        }
    }
}

/// A program under construction.
struct Program<'drive> {
    drive: &'drive DriveLayout,
    steps: Vec<Step>,
}

impl Program<'_> {
    fn push(&mut self, action: Action, index: u16, sub_index: u8, value: u32) {
        let entry = self.drive.dictionary.get(index, sub_index);
        let size = entry.and_then(|entry| entry.data_type.size_bytes());
        // A sheet may leave out an object of the standard that the drive has.
        let size = size.or_else(|| eds::standard_type(index, sub_index)?.size_bytes());
        self.steps.push(Step {
            action,
            index,
            sub_index,
            name: entry.map_or_else(String::new, |entry| entry.name.clone()),
            value,
            length_bytes: size.map_or(4, |size| size.min(4)),
        });
    }

    /// Writes an object if the drive has it.
    fn write(&mut self, index: u16, sub_index: u8, value: u32) {
        if self.drive.dictionary.get(index, sub_index).is_some() {
            self.push(Action::Write, index, sub_index, value);
        }
    }

    /// Compares a PDO. If it differs, it configures the PDO in the standard's order (CiA 301, 7.5.2.36): destroy, no
    /// objects, objects, their number, create.
    fn pdo(&mut self, pdo: &Pdo) {
        let objects = || (1..=u8::MAX).zip(&pdo.entries);
        let count = u32::try_from(pdo.entries.len()).unwrap_or(u32::MAX);
        let transmission_type = u32::from(pdo.transmission_type);
        let any = Action::Compare { mask: u32::MAX };
        let cob_id_bits = Action::Compare {
            mask: !NO_REMOTE_FRAMES,
        };
        self.push(Action::NewGroup, pdo.parameters, 0, 0);
        self.push(cob_id_bits, pdo.parameters, 1, pdo.cob_id);
        self.push(any.clone(), pdo.parameters, 2, transmission_type);
        self.push(any.clone(), pdo.mapping, 0, count);
        for (sub_index, entry) in objects() {
            self.push(any.clone(), pdo.mapping, sub_index, *entry);
        }
        self.push(Action::Correct, pdo.parameters, 1, pdo.cob_id | INVALID);
        self.push(Action::Correct, pdo.mapping, 0, 0);
        for (sub_index, entry) in objects() {
            self.push(Action::Correct, pdo.mapping, sub_index, *entry);
        }
        self.push(Action::Correct, pdo.parameters, 2, transmission_type);
        self.push(Action::Correct, pdo.mapping, 0, count);
        self.push(Action::Correct, pdo.parameters, 1, pdo.cob_id);
    }
}

/// The program of SDO transfers that configures the drive.
#[derive(Debug)]
pub(crate) struct BringUp {
    client: SdoClient,
    steps: Vec<Step>,
    next: usize,
    differs: bool,
}

impl BringUp {
    /// Makes the program for a drive, the manager's node-ID and a SYNC period. Objects that the drive's EDS lacks are
    /// left out.
    pub(crate) fn new(
        drive: &DriveLayout,
        manager: NodeId,
        sync_period: Duration,
        timeouts: &Timeouts,
    ) -> Self {
        let microseconds = u32::try_from(sync_period.as_micros()).unwrap_or(u32::MAX);
        let manager = u32::from(manager.get()) << 16;
        let mode = u32::from(drive.mode_of_operation.cast_unsigned());
        let steps = Vec::new();
        let mut program = Program { drive, steps };
        for (index, sub_index) in IDENTITY {
            match drive.dictionary.unsigned(index, sub_index) {
                Some(0) => program.push(Action::Show, index, sub_index, 0),
                Some(value) => program.push(Action::Require, index, sub_index, value),
                None => {}
            }
        }
        let controller_lost = u32::from(timeouts.controller_lost_milliseconds);
        program.write(0x1016, 1, manager | controller_lost);
        let heartbeat = u32::from(timeouts.drive_heartbeat_milliseconds);
        program.push(Action::Write, 0x1017, 0, heartbeat);
        program.write(cia402::MODES_OF_OPERATION, 0, mode);
        program.write(0x1006, 0, microseconds);
        [&drive.feedback, &drive.command]
            .into_iter()
            .for_each(|pdo| program.pdo(pdo));
        let answer_time = Duration::from_millis(timeouts.sdo_answer_milliseconds.into());
        Self {
            client: SdoClient::new(drive.node_id.get()).with_timeout(answer_time),
            steps: program.steps,
            next: 0,
            differs: false,
        }
    }

    /// Requests the device type, to learn whether the drive is there. A pending request is dropped.
    pub(crate) fn ask(&mut self, services: &mut Services) {
        self.client.reset();
        let started = self.client.start_upload(services.now(), (0x1000, 0));
        debug_assert!(started.is_ok(), "a client that was reset is idle");
        self.drain(services);
    }

    /// Returns true once after the drive has answered the request, even with an abort.
    pub(crate) fn is_answered(&mut self) -> bool {
        self.client.take_result().is_some()
    }

    /// Goes back to the beginning of the program.
    pub(crate) fn rewind(&mut self) {
        self.client.reset();
        (self.next, self.differs) = (0, false);
    }

    /// Handles a frame, which may be an answer.
    pub(crate) fn on_frame(&mut self, services: &mut Services, frame: &can::CanFrame) {
        self.client.on_frame(services.now(), frame);
        self.drain(services);
    }

    /// Times out an overdue answer.
    pub(crate) fn on_tick(&mut self, services: &mut Services) {
        self.client.on_tick(services.now());
        self.drain(services);
    }

    /// Returns the time at which an answer is overdue.
    pub(crate) fn next_deadline(&self) -> Option<Duration> {
        self.client.next_deadline()
    }

    /// Continues the program as far as the answers allow.
    ///
    /// # Errors
    /// The drive is another one, or does not accept its configuration.
    pub(crate) fn advance(&mut self, services: &mut Services) -> Result<(), String> {
        if let Some(result) = self.client.take_result() {
            self.on_result(result)?;
        }
        while !self.client.is_busy()
            && let Some(step) = self.steps.get(self.next)
        {
            match step.action {
                Action::NewGroup => self.differs = false,
                Action::Correct if !self.differs => {}
                _ => {
                    let started = step.start(&mut self.client, services.now());
                    started.map_err(|error| error.to_string())?;
                    self.drain(services);
                    return Ok(());
                }
            }
            self.next += 1;
        }
        Ok(())
    }

    /// Returns whether the program has come to its end.
    pub(crate) fn is_configured(&self) -> bool {
        self.next == self.steps.len()
    }

    /// Checks the answer to the present step.
    fn on_result(&mut self, result: Result<Vec<u8>, SdoError>) -> Result<(), String> {
        let Some(step) = self.steps.get(self.next) else {
            return Ok(());
        };
        self.next += 1;
        let Step {
            name,
            index,
            sub_index,
            ..
        } = step;
        let wanted = step.shown(step.value);
        match (&step.action, result) {
            (Action::Compare { mask }, Ok(bytes)) => {
                let found = little_endian_u32(&bytes);
                self.differs |= found.is_none_or(|found| (found ^ step.value) & mask != 0);
                Ok(())
            }
            (Action::Show, Err(error)) if matches!(error.failure, SdoFailure::Aborted(_)) => Ok(()),
            // An unreadable object is written; a refusal of the write tells more.
            (Action::Compare { .. }, Err(error))
                if matches!(error.failure, SdoFailure::Aborted(_)) =>
            {
                self.differs = true;
                Ok(())
            }
            (Action::Require, Ok(bytes)) => match little_endian_u32(&bytes) {
                Some(found) if found == step.value => Ok(()),
                found => {
                    let found =
                        found.map_or_else(|| "no number".to_owned(), |found| step.shown(found));
                    Err(format!(
                        "the node is not the drive of the EDS: {name} (0x{index:04X}:{sub_index:02X}) is {found} instead of {wanted}"
                    ))
                }
            },
            (_, Ok(_)) => Ok(()),
            (Action::Write | Action::Correct, Err(error)) => Err(format!(
                "the drive did not accept {wanted} for {name}: {error}"
            )),
            (_, Err(error)) => Err(format!("the drive's {name} cannot be read: {error}")),
        }
    }

    fn drain(&mut self, services: &mut Services) {
        while let Some(frame) = self.client.next_frame() {
            services.send(frame);
        }
    }
}
