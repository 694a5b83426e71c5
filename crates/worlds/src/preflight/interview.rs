//! Checks of the drive and the other expected nodes on the bus: their presence, their identity, and their objects.
//!
//! A guest listens for another manager, sends the manager's heartbeat from then on, resets the drive's communication, and asks by
//! SDO, one object after the other. No current can flow: a drive that was reset is not enabled.

use std::time::Duration;

use can::CanFrame;
use canopen::eds::IDENTITY;
use canopen::nmt::ERROR_CONTROL_ID;
use canopen::object_dictionary::{AbortCode, Entry};
use canopen::sdo::little_endian_u32;
use canopen::sdo_client::{SdoClient, SdoError, SdoFailure};
use canopen::{NmtCommand, NmtState, NodeId, cia402};
use platform::clock::Clock;
use scenario::rig::object_address;

use super::checklist::Check;
use super::checklist::Found::{self, Failed, Open, Passed};
use crate::guest::{Guest, GuestError};
use plan::loaded_drive::LoadedDrive;
use plan::presence::Presence;

/// Time to listen for another manager, longer than the period of its SYNC.
const LISTEN_TIME: Duration = Duration::from_millis(300);
/// Time between two calls to a node that has not answered.
const CALL_PERIOD: Duration = Duration::from_millis(100);
/// Standard objects that a controller uses, if the drive has them.
const USED: [(u16, u8); 5] = [
    (cia402::CONTROLWORD, 0),
    (cia402::STATUSWORD, 0),
    (cia402::MODES_OF_OPERATION, 0),
    (0x1016, 1),
    (0x1017, 0),
];
/// Those of them that take 0 before the drive is led; 0 is no mode of some drives.
const WRITTEN: [(u16, u8); 3] = [(cia402::CONTROLWORD, 0), (0x1016, 1), (0x1017, 0)];
const DEVICE_TYPE: (u16, u8) = IDENTITY[0];
/// Meanings of the objects of the identity.
const IDENTITY_NAMES: [&str; 3] = ["device type", "vendor", "product"];
/// Number of times that a question is repeated to a node that booted instead of answering.
const REPEATS_MAX: u8 = 3;

pub(super) const OTHER_MANAGER: &str = "other manager";

/// Reason why the interview broke off.
pub(super) enum BrokenOff {
    /// Another manager was heard; its evidence.
    Manager(String),
    /// The bus failed, or the user stops the interview.
    Guest(GuestError),
}

/// Answer of a node to a question.
type Answer = Result<Vec<u8>, SdoError>;

/// Interview of a drive and the other nodes of a rig by a guest.
pub(super) struct Interview<'a> {
    guest: Guest<'a>,
    drive: &'a LoadedDrive,
    presence: Presence,
    /// Node-ID of the manager of the rig.
    manager: u8,
}

impl<'a> Interview<'a> {
    /// Makes the interview for a manager with this node-ID, as a guest that hears all frames.
    pub(super) fn new(guest: Guest<'a>, drive: &'a LoadedDrive, manager: u8) -> Self {
        Self {
            guest,
            drive,
            presence: Presence::default(),
            manager,
        }
    }

    /// Makes the checks, up to the first that fails. It calls all `nodes`, of which the drive is the first.
    ///
    /// # Errors
    /// If another manager is heard at any time, or the interview broke off otherwise.
    pub(super) fn checks(mut self, nodes: &[(NodeId, String)]) -> Result<Vec<Check>, BrokenOff> {
        let presence = &mut self.presence;
        let heard = self
            .guest
            .hear(LISTEN_TIME, |frame| presence.on_frame(frame));
        self.unless_led(heard)?;
        self.guest.keep_place_of(self.manager);
        let reset = NmtCommand::ResetCommunication.frame(Some(self.drive.layout.node_id));
        self.guest.send(&reset).map_err(BrokenOff::Guest)?;
        let mut checks = vec![Check(OTHER_MANAGER, Passed("none is heard".to_owned()))];
        let named = |(node, name): &(NodeId, String)| format!("{name} (node {node})");
        for node in nodes {
            if !self.has_answered(node.0)? {
                let seconds = self.drive.real.timeouts.bring_up().as_secs_f64();
                let text = format!(
                    "{} answered no SDO for {seconds} s: is it switched on, is that its node-ID, and its bit rate that of the bus?",
                    named(node)
                );
                checks.push(Check("nodes", Failed(text)));
                return Ok(checks);
            }
        }
        let found = Vec::from_iter(nodes.iter().map(named)).join(", ");
        checks.push(Check("nodes", Passed(format!("found: {found}"))));
        let identity = self.identity()?;
        let is_the_drive = !matches!(identity, Failed(_));
        checks.push(Check("identity", identity));
        if is_the_drive {
            checks.push(Check("objects", self.objects()?));
        }
        Ok(checks)
    }

    /// Calls a node until it answers; returns `false` if it does not in time.
    fn has_answered(&mut self, node: NodeId) -> Result<bool, BrokenOff> {
        let clock = Clock::start();
        while clock.now() < self.drive.real.timeouts.bring_up() {
            let answer = self.ask(node, CALL_PERIOD, DEVICE_TYPE, None)?;
            // An abort is an answer, too; silence is not.
            if !matches!(answer, Err(error) if matches!(error.failure, SdoFailure::TimedOut(_))) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Asks the drive for an object, or writes it.
    fn ask_drive(
        &mut self,
        address: (u16, u8),
        written: Option<&[u8]>,
    ) -> Result<Answer, BrokenOff> {
        let milliseconds = self.drive.real.timeouts.sdo_answer_milliseconds;
        let answer_time = Duration::from_millis(milliseconds.into());
        self.ask(self.drive.layout.node_id, answer_time, address, written)
    }

    fn ask(
        &mut self,
        node: NodeId,
        answer_time: Duration,
        address: (u16, u8),
        written: Option<&[u8]>,
    ) -> Result<Answer, BrokenOff> {
        let mut repeats = 0;
        loop {
            let mut client = SdoClient::new(node.get()).with_timeout(answer_time);
            let presence = &mut self.presence;
            let mut has_booted = false;
            let answer = self.guest.transfer(&mut client, address, written, |frame| {
                presence.on_frame(frame);
                has_booted |= is_boot_up(frame, node);
            });
            let answer = self.unless_led(answer)?;
            // A node that boots twice does not answer what it was asked between the two.
            let is_lost =
                matches!(answer, Err(error) if matches!(error.failure, SdoFailure::TimedOut(_)));
            if !(is_lost && has_booted && repeats < REPEATS_MAX) {
                return Ok(answer);
            }
            repeats += 1;
        }
    }

    /// Returns a result, unless another manager was heard meanwhile.
    fn unless_led<T>(&self, result: Result<T, GuestError>) -> Result<T, BrokenOff> {
        match self.presence.manager(|node_id| node_id == self.manager) {
            Some(manager) => Err(BrokenOff::Manager(manager)),
            None => result.map_err(BrokenOff::Guest),
        }
    }

    /// Compares the identity of the drive with its EDS, as far as that has it: what it leaves out, or gives as 0, is not known.
    fn identity(&mut self) -> Result<Found, BrokenOff> {
        let dictionary = &self.drive.layout.dictionary;
        let (mut compared, mut blank) = (Vec::new(), Vec::new());
        for (address, what) in IDENTITY.into_iter().zip(IDENTITY_NAMES) {
            let wanted = dictionary.unsigned(address.0, address.1);
            let wanted = wanted.filter(|number| *number != 0);
            let Some((entry, wanted)) = dictionary.get(address.0, address.1).zip(wanted) else {
                blank.push(what);
                continue;
            };
            let read = match self.ask_drive(address, None)? {
                Err(error) => return Ok(Failed(error.to_string())),
                Ok(bytes) if has_other_length(entry, &bytes) => {
                    return Ok(Failed(lengths(entry, &bytes)));
                }
                Ok(bytes) => little_endian_u32(&bytes),
            };
            let wanted = format!("0x{wanted:X}");
            let read = read.map_or("no number".to_owned(), |number| format!("0x{number:X}"));
            if read != wanted {
                let name = name(entry);
                return Ok(Failed(format!(
                    "{name} is {read}, in the EDS {wanted}: another drive, or another EDS"
                )));
            }
            compared.push(format!("{what} {wanted}"));
        }
        let [compared, blank] = [compared.join(", "), blank.join(", ")];
        Ok(match (compared.as_str(), blank.as_str()) {
            ("", blank) => Open(format!("not compared, since blank in the EDS: {blank}")),
            (compared, "") => Passed(format!("as in the EDS: {compared}")),
            (compared, blank) => Passed(format!(
                "as in the EDS: {compared}; not compared, since blank there: {blank}"
            )),
        })
    }

    /// Reads the objects that a run uses and that are readable by the EDS, and writes 0 to those that a run writes: that removes a
    /// command or switches a watch off.
    fn objects(&mut self) -> Result<Found, BrokenOff> {
        let (mut read, mut written) = (0, 0);
        let command = object_address(&self.drive.real.command.object).unwrap_or_default();
        let dictionary = &self.drive.layout.dictionary;
        for address in used_objects(self.drive) {
            let Some(entry) = dictionary.get(address.0, address.1) else {
                continue;
            };
            let size = entry.data_type.size_bytes();
            if entry.access.is_readable() {
                match self.ask_drive(address, None)? {
                    Err(error) => {
                        return Ok(Failed(format!("{} cannot be read: {error}", name(entry))));
                    }
                    Ok(bytes) if has_other_length(entry, &bytes) => {
                        return Ok(Failed(lengths(entry, &bytes)));
                    }
                    Ok(_) => read += 1,
                }
            }
            let may_be_zero =
                (address == command || WRITTEN.contains(&address)) && entry.access.is_writable();
            if let Some(size) = size.filter(|_| may_be_zero) {
                match self.ask_drive(address, Some(&vec![0; size]))? {
                    Ok(_) => written += 1,
                    Err(error) if waits_for_operational(entry, &error) => {}
                    Err(error) => {
                        return Ok(Failed(format!("{} does not take 0: {error}", name(entry))));
                    }
                }
            }
        }
        Ok(Passed(format!(
            "{read} read, {written} written, as the EDS says"
        )))
    }
}

/// Returns whether a value is not as long as the EDS says.
fn has_other_length(entry: &Entry, bytes: &[u8]) -> bool {
    let size = entry.data_type.size_bytes();
    size.is_some_and(|size| size != bytes.len())
}

/// Describes a value of another length.
fn lengths(entry: &Entry, bytes: &[u8]) -> String {
    let (has, wanted) = (
        bytes.len(),
        entry.data_type.size_bytes().unwrap_or_default(),
    );
    let short = if has < wanted { ", a short answer" } else { "" };
    format!(
        "{} has {has} bytes{short}, in the EDS {wanted}",
        name(entry)
    )
}

/// Returns whether a node says that it has booted.
fn is_boot_up(frame: &CanFrame, node: NodeId) -> bool {
    let identifier = ERROR_CONTROL_ID + u16::from(node.get());
    let state = frame.data().first();
    frame.standard_id() == Some(identifier) && state == Some(&NmtState::Initialising.number())
}

fn name(entry: &Entry) -> String {
    let Entry {
        index, sub_index, ..
    } = entry;
    format!("0x{index:04X}:{sub_index:02X} ({})", entry.name)
}

/// Returns every object of the drive that a run uses.
fn used_objects(drive: &LoadedDrive) -> impl Iterator<Item = (u16, u8)> {
    let drive = &drive.real;
    let objects = [
        &drive.command.object,
        &drive.position.object,
        &drive.current.object,
    ];
    let named = objects.into_iter();
    let addresses = named.filter_map(|text| object_address(text).ok());
    addresses.chain(USED)
}

/// Returns whether the drive refused its controlword before NMT state operational, as some do; the object then has no effect.
fn waits_for_operational(entry: &Entry, error: &SdoError) -> bool {
    let states = [AbortCode::DEVICE_STATE, AbortCode::LOCAL_CONTROL];
    entry.index == cia402::CONTROLWORD
        && matches!(error.failure, SdoFailure::Aborted(code) if states.contains(&code))
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;
    use std::fs::File;
    use std::os::fd::{AsFd, BorrowedFd};
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use canopen::ObjectDictionary;
    use canopen::object_dictionary::Preset;
    use platform::bus::{Bus, BusError};
    use scenario::rig::{Limits, RealDrive};

    use super::*;

    /// Drive that answers expedited transfers (CiA 301, 7.2.4.3) with the values of a data sheet.
    struct Answering {
        dictionary: ObjectDictionary,
        answers: VecDeque<CanFrame>,
        written: Arc<AtomicUsize>,
        /// Number of questions that it answers before it boots once more, in the middle of the next one.
        boots_after: Option<usize>,
        /// Bytes of its answers and of the values in them.
        answer_bytes: usize,
        value_bytes: usize,
        nothing: File,
    }

    impl Bus for Answering {
        fn send(&mut self, frame: &CanFrame) -> Result<(), BusError> {
            let [command, low, high, sub_index, ..] = *frame.data() else {
                return Ok(());
            };
            // The client gives up a transfer, which a drive does not answer.
            if command == 0x80 {
                return Ok(());
            }
            match self.boots_after.as_mut() {
                Some(0) => {
                    self.boots_after = None;
                    self.answers.push_back(CanFrame::new(0x710, &[0]));
                    return Ok(());
                }
                Some(left) => *left -= 1,
                None => {}
            }
            let mut answer = [0x60, low, high, sub_index, 0, 0, 0, 0];
            if command == 0x40 {
                let index = u16::from_le_bytes([low, high]);
                let handle = self.dictionary.find(index, sub_index).unwrap();
                let value = &self.dictionary.entry(handle).default;
                let value = &value[..value.len().min(self.value_bytes)];
                let unused = u8::try_from(4 - value.len()).unwrap();
                answer[0] = 0x43 | unused << 2;
                answer[4..][..value.len()].copy_from_slice(value);
            } else {
                self.written.fetch_add(1, Ordering::Relaxed);
            }
            let answer = CanFrame::new(0x590, &answer[..self.answer_bytes]);
            self.answers.push_back(answer);
            Ok(())
        }

        fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>, BusError> {
            let answer = self.answers.pop_front();
            if answer.is_none() {
                platform::clock::sleep(timeout);
            }
            Ok(answer)
        }

        fn as_fd(&self) -> BorrowedFd<'_> {
            self.nothing.as_fd()
        }

        fn dropped(&self) -> u64 {
            0
        }

        fn delayed(&self) -> u64 {
            0
        }
    }

    /// Returns the checks of a drive whose EDS is edited, with its data sheet's values but for these, as the bus shows it, and the
    /// number of its written objects.
    fn checks(
        eds: &str,
        presets: &[Preset],
        behave: impl Fn(&mut Answering),
    ) -> (Vec<Check>, usize) {
        let limits = Limits {
            current_amperes: 1.0,
            min: 0.0,
            max: 60.0,
            rate_max: 1e4,
        };
        let mut real = RealDrive::new(limits);
        real.timeouts.sdo_answer_milliseconds = 50;
        real.timeouts.bring_up_seconds = 1.0;
        let drive = LoadedDrive::new(real, Some(&eds.to_owned())).unwrap();
        let mut dictionary = dbc::dictionary(dbc::DRIVE_EDS, 0x10).unwrap();
        presets.iter().for_each(|preset| dictionary.preset(preset));
        let written = Arc::new(AtomicUsize::new(0));
        let mut bus = Answering {
            dictionary,
            answers: VecDeque::new(),
            written: Arc::clone(&written),
            boots_after: None,
            answer_bytes: 8,
            value_bytes: 4,
            nothing: File::open("/dev/null").unwrap(),
        };
        behave(&mut bus);
        let guest = Guest::new(Box::new(bus), || false);
        let interview = Interview::new(guest, &drive, 1);
        let node = (NodeId::new(0x10).unwrap(), "drive".to_owned());
        let Ok(checks) = interview.checks(&[node]) else {
            panic!("nobody else is there");
        };
        (checks, written.load(Ordering::Relaxed))
    }

    #[test]
    fn nothing_is_written_to_another_drive() {
        let checks_made = ["other manager", "nodes", "identity", "objects"];
        for (device_type, made) in [
            (0x0002_0192, &checks_made[..]),
            (0x0003_0192, &checks_made[..3]),
        ] {
            let preset = Preset::new(0x1000, 0, device_type);
            let (checks, written) = checks(dbc::DRIVE_EDS, &[preset], |_| ());
            let names = Vec::from_iter(checks.iter().map(|Check(name, _)| *name));
            assert_eq!(names, made);
            let has_passed = matches!(checks.last(), Some(Check(_, Passed(_))));
            assert_eq!(
                has_passed,
                device_type == 0x0002_0192,
                "{:?}",
                checks.last()
            );
            assert_eq!(written > 0, has_passed);
        }
    }

    #[test]
    fn what_the_eds_leaves_blank_is_not_compared() {
        let others = [Preset::new(0x1018, 1, 0x2FE), Preset::new(0x1018, 2, 7)];
        let blank = |text: &str| dbc::DRIVE_EDS.replace(text, "DefaultValue=");
        let product = blank("DefaultValue=0x00000001");
        let all = product.replace("DefaultValue=0x00020192", "DefaultValue=0");
        for (eds, found) in [
            (
                dbc::DRIVE_EDS,
                Failed(
                    "0x1018:02 (Product code) is 0x7, in the EDS 0x1: another drive, or another EDS"
                        .to_owned(),
                ),
            ),
            (
                &product,
                Passed(
                    "as in the EDS: device type 0x20192; not compared, since blank there: vendor, product"
                        .to_owned(),
                ),
            ),
            (
                &all,
                Open(
                    "not compared, since blank in the EDS: device type, vendor, product".to_owned(),
                ),
            ),
        ] {
            let (checks, _) = checks(eds, &others, |_| ());
            assert_eq!(checks[2], Check("identity", found));
        }
    }

    #[test]
    fn a_drive_that_boots_twice_is_asked_again() {
        let (_, usual) = checks(dbc::DRIVE_EDS, &[], |_| ());
        for questions in 0..12 {
            let boots = |bus: &mut Answering| bus.boots_after = Some(questions);
            let (checks, written) = checks(dbc::DRIVE_EDS, &[], boots);
            let last = checks.last().unwrap();
            assert!(
                matches!(last, Check("objects", Passed(_))),
                "{questions}: {last:?}"
            );
            assert_eq!(written, usual, "{questions}");
        }
    }

    #[test]
    fn a_short_answer_is_called_that() {
        let frame = |bus: &mut Answering| bus.answer_bytes = 5;
        let value = |bus: &mut Answering| bus.value_bytes = 2;
        let (of_frame, _) = checks(dbc::DRIVE_EDS, &[], frame);
        let (of_value, _) = checks(dbc::DRIVE_EDS, &[], value);
        let says = |checks: &[Check], text: &str| {
            let last = checks.last().unwrap();
            assert_eq!(*last, Check("identity", Failed(text.to_owned())));
        };
        says(
            &of_frame,
            "object 0x1000:00 of node 0x10: a short answer: 5 bytes in the frame (CiA 301: 8)",
        );
        says(
            &of_value,
            "0x1000:00 (Device type) has 2 bytes, a short answer, in the EDS 4",
        );
    }
}
