//! What the controller knows of the drive before it meets it: identity and PDOs, from the drive's EDS.

use canopen::{CanFrame, ObjectDictionary, cia402, eds};

use crate::node::{ControllerError, DRIVE};

const POSITION_ACTUAL_VALUE: u16 = 0x6064;
const TARGET_TORQUE: u16 = 0x6071;
const METRES_PER_MICROMETRE: f64 = 1e-6;
/// Permille of rated torque, which is defined as that at the rated current of 1 A (0x6075).
const PERMILLE_PER_AMPERE: f64 = 1000.0;

/// What the drive's TPDO1 tells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Feedback {
    pub(crate) statusword: u16,
    pub(crate) position_metres: f64,
}

/// A PDO of the drive as its EDS describes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Pdo {
    /// Index of the communication parameters.
    pub(crate) parameters: u16,
    /// Index of the mapping.
    pub(crate) mapping: u16,
    pub(crate) cob_id: u32,
    pub(crate) transmission_type: u8,
    /// Index, sub-index and length in bits of each mapped object (CiA 301, figure 74).
    pub(crate) entries: Vec<u32>,
}

impl Pdo {
    fn read(dictionary: &ObjectDictionary, parameters: u16, mapping: u16) -> Option<Self> {
        let count = u8::try_from(dictionary.unsigned(mapping, 0)?).ok()?;
        let entries = (1..=count).map(|sub_index| dictionary.unsigned(mapping, sub_index));
        Some(Self {
            parameters,
            mapping,
            cob_id: dictionary.unsigned(parameters, 1)?,
            transmission_type: u8::try_from(dictionary.unsigned(parameters, 2)?).ok()?,
            entries: entries.collect::<Option<_>>()?,
        })
    }

    /// The 11-bit identifier below the flags.
    fn id(&self) -> u16 {
        (self.cob_id & 0x7FF) as u16
    }

    fn length_bytes(&self) -> usize {
        bytes_of(&self.entries)
    }

    /// The first byte of a mapped object of `N` bytes.
    fn place<const N: usize>(&self, index: u16) -> Option<usize> {
        let wanted = u32::from(index) << 16 | u32::try_from(8 * N).ok()?;
        let place = self.entries.iter().position(|entry| *entry == wanted)?;
        let start = bytes_of(&self.entries[..place]);
        (start + N <= 8).then_some(start)
    }
}

/// The bytes that mapping entries take together; their lengths are whole bytes.
fn bytes_of(entries: &[u32]) -> usize {
    entries
        .iter()
        .map(|entry| (entry & 0xFF) as usize / 8)
        .sum()
}

/// The drive's identity and the layout of its PDOs.
#[derive(Clone, Debug)]
pub(crate) struct Drive {
    /// Its objects with their defaults.
    pub(crate) dictionary: ObjectDictionary,
    /// TPDO1.
    pub(crate) feedback: Pdo,
    /// RPDO1.
    pub(crate) command: Pdo,
    statusword: usize,
    position: usize,
    controlword: usize,
    target_torque: usize,
}

impl Drive {
    /// Reads the drive's EDS.
    pub(crate) fn from_eds(text: &str) -> Result<Self, ControllerError> {
        let dictionary = eds::parse(text, DRIVE.get())?.dictionary;
        let pdo = |parameters, mapping| {
            let pdo = Pdo::read(&dictionary, parameters, mapping);
            pdo.filter(|pdo| pdo.length_bytes() <= 8)
                .ok_or(ControllerError::DrivePdo(parameters))
        };
        let feedback = pdo(0x1800, 0x1A00)?;
        let command = pdo(0x1400, 0x1600)?;
        let missing = ControllerError::NotMapped;
        Ok(Self {
            statusword: (feedback.place::<2>(cia402::STATUSWORD))
                .ok_or(missing(cia402::STATUSWORD))?,
            position: (feedback.place::<4>(POSITION_ACTUAL_VALUE))
                .ok_or(missing(POSITION_ACTUAL_VALUE))?,
            controlword: (command.place::<2>(cia402::CONTROLWORD))
                .ok_or(missing(cia402::CONTROLWORD))?,
            target_torque: (command.place::<2>(TARGET_TORQUE)).ok_or(missing(TARGET_TORQUE))?,
            dictionary,
            feedback,
            command,
        })
    }

    /// Identifier of TPDO1.
    pub(crate) fn feedback_id(&self) -> u16 {
        self.feedback.id()
    }

    /// The content of TPDO1; `None` for other frames and when it is too short.
    pub(crate) fn decode(&self, frame: &CanFrame) -> Option<Feedback> {
        let data = frame.data();
        if frame.standard_id() != Some(self.feedback.id())
            || data.len() < self.feedback.length_bytes()
        {
            return None;
        }
        let micrometres = i32::from_le_bytes(bytes_at(data, self.position)?);
        Some(Feedback {
            statusword: u16::from_le_bytes(bytes_at(data, self.statusword)?),
            position_metres: f64::from(micrometres) * METRES_PER_MICROMETRE,
        })
    }

    /// RPDO1; the current is limited to what its object can hold.
    pub(crate) fn encode(&self, controlword: u16, current_amperes: f64) -> CanFrame {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "limited to the drive's range before"
        )]
        let torque = libm::round(current_amperes * PERMILLE_PER_AMPERE).clamp(0.0, 1000.0) as i16;
        let mut data = [0; 8];
        data[self.controlword..][..2].copy_from_slice(&controlword.to_le_bytes());
        data[self.target_torque..][..2].copy_from_slice(&torque.to_le_bytes());
        CanFrame::new(self.command.id(), &data[..self.command.length_bytes()])
    }
}

fn bytes_at<const N: usize>(data: &[u8], start: usize) -> Option<[u8; N]> {
    data.get(start..start + N)?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn feedback_and_command_are_laid_out_as_the_eds_says() {
        let drive = Drive::from_eds(dbc::DRIVE_EDS).unwrap();
        let frame = CanFrame::new(0x190, &[0x37, 0x02, 0x10, 0x27, 0, 0, 0, 2]);
        let feedback = drive.decode(&frame).unwrap();
        assert_eq!(feedback.statusword, 0x0237);
        assert!((feedback.position_metres - 0.01).abs() < 1e-15);
        assert_eq!(
            drive.encode(0x0F, 0.5),
            CanFrame::new(0x210, &[0x0F, 0, 0xF4, 0x01])
        );
    }

    #[test]
    fn short_and_foreign_frames_are_no_feedback() {
        let drive = Drive::from_eds(dbc::DRIVE_EDS).unwrap();
        assert_eq!(drive.decode(&CanFrame::new(0x190, &[0; 7])), None);
        assert_eq!(drive.decode(&CanFrame::new(0x191, &[0; 8])), None);
    }

    #[test]
    fn a_command_is_never_beyond_the_drives_range() {
        let drive = Drive::from_eds(dbc::DRIVE_EDS).unwrap();
        for (amperes, permille) in [
            (2.0, 1000_i16),
            (-1.0, 0),
            (f64::NAN, 0),
            (f64::INFINITY, 1000),
        ] {
            assert_eq!(drive.encode(0, amperes).data()[2..], permille.to_le_bytes());
        }
    }

    #[test]
    fn an_eds_without_the_position_is_refused() {
        let text = dbc::DRIVE_EDS.replace("0x60640020", "0x60780010");
        let error = Drive::from_eds(&text).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the drive's EDS maps no object 0x6064 into its first PDOs"
        );
    }
}
