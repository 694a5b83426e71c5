//! Facts about the drive before it is on the bus: its identity and PDOs, from its EDS and the rig file.

use can::CanFrame;
use canopen::eds::{EdsError, IDENTITY};
use canopen::nmt::NodeId;
use canopen::object_dictionary::Access;
use canopen::{ObjectDictionary, add_half, cia402};

use super::{RealDrive, object_address};

/// Bit 31 of a COB-ID: the PDO does not exist.
const INVALID: u32 = 0x8000_0000;
/// COB-IDs of TPDO1, without remote frames, and of RPDO1 without the node-ID (CiA 301, 7.3.5).
const TPDO1: u32 = 0x4000_0180;
const RPDO1: u32 = 0x0200;
/// Transmission type of a drive that samples and applies on every SYNC.
const EVERY_SYNC: u8 = 1;

/// Reason why a drive cannot be led.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct DriveError(String);

impl DriveError {
    /// Makes the error of an object that the EDS describes in two ways, and that the bench needs.
    pub fn contradiction((index, sub_index): (u16, u8), what: &str) -> Self {
        Self(format!(
            "the drive's EDS contradicts itself on the object 0x{index:04X}:{sub_index:02X}, which is used: {what}; leave the right one"
        ))
    }
}

impl From<EdsError> for DriveError {
    fn from(error: EdsError) -> Self {
        Self(format!("the EDS is wrong: {error}"))
    }
}

/// Content of the drive's TPDO1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Feedback {
    /// Statusword (0x6041).
    pub statusword: u16,
    /// Sampled position, in the unit of the drive's signal.
    pub position: f64,
    /// Measured output of the amplifier; `None` if the drive does not measure it.
    pub output: Option<f64>,
}

/// PDO of the drive as its EDS describes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pdo {
    /// Index of the communication parameters.
    pub parameters: u16,
    /// Index of the mapping.
    pub mapping: u16,
    /// COB-ID with the flags of CiA 301.
    pub cob_id: u32,
    /// Transmission type: when the PDO is sent or applied, as CiA 301 numbers it.
    pub transmission_type: u8,
    /// Index, sub-index and length in bits of each mapped object (CiA 301, figure 74).
    pub entries: Vec<u32>,
    /// Total length of the mapped objects.
    pub length_bytes: usize,
}

impl Pdo {
    /// Reads a PDO that the dictionary has; what the EDS leaves blank is as CiA 301 has it, since the controller writes what
    /// differs. A PDO that does not exist at first is wanted from then on.
    fn read(
        dictionary: &ObjectDictionary,
        [parameters, mapping]: [u16; 2],
        predefined: u32,
    ) -> Option<Self> {
        dictionary.get(parameters, 1)?;
        let unsigned = |index, sub_index| dictionary.unsigned(index, sub_index).unwrap_or(0);
        let cob_id = Some(unsigned(parameters, 1) & !INVALID);
        let count = u8::try_from(unsigned(mapping, 0)).unwrap_or(0);
        let entries = (1..=count).map(|sub_index| unsigned(mapping, sub_index));
        let mut entries = Vec::from_iter(entries);
        // Places without an object, and with an object of half a byte, are none to put a value at.
        if entries
            .iter()
            .any(|entry| entry & 0xFF == 0 || entry % 8 != 0)
        {
            entries.clear();
        }
        let transmission_type = u8::try_from(unsigned(parameters, 2));
        Some(Self {
            parameters,
            mapping,
            cob_id: cob_id.filter(|id| *id != 0).unwrap_or(predefined),
            transmission_type: transmission_type.unwrap_or(EVERY_SYNC),
            length_bytes: bytes_of(&entries),
            entries,
        })
    }

    /// Returns the 11-bit identifier below the flags.
    pub fn id(&self) -> u16 {
        (self.cob_id & 0x7FF) as u16
    }

    /// Returns the place of a mapped object.
    fn place(&self, object: &Object) -> Option<Field> {
        let mut entries = self.entries.iter();
        let place = entries.position(|entry| *entry == object.entry)?;
        let start_byte = bytes_of(&self.entries[..place]);
        Field::new(start_byte, bytes_of(&[object.entry]), object.is_signed)
    }

    /// Returns the PDO with these objects: with the mapping of the EDS if it has them all, else with these objects alone.
    fn with(mut self, objects: &[Object]) -> Result<Self, DriveError> {
        let entries = Vec::from_iter(objects.iter().map(|object| object.entry));
        let mut places = 1..entries.len();
        if let Some(place) = places.find(|place| entries[..*place].contains(&entries[*place])) {
            let object = entries[place] >> 8;
            return Err(DriveError(format!(
                "the rig file gives object 0x{:04X}:{:02X} two meanings in PDO mapping 0x{:04X}",
                object >> 8,
                object & 0xFF,
                self.mapping
            )));
        }
        let is_mapped = |object: &Object| self.place(object).is_some();
        if !objects.iter().all(is_mapped) || self.length_bytes > 8 {
            self.length_bytes = bytes_of(&entries);
            self.entries = entries;
        }
        // Some drives wait for a SYNC or send by themselves; here the controller sets the cycle.
        if self.transmission_type == 0 || self.transmission_type > 240 {
            self.transmission_type = EVERY_SYNC;
        }
        match self.length_bytes {
            0..=8 => Ok(self),
            bytes => Err(DriveError(format!(
                "the objects of the rig file take {bytes} bytes in PDO mapping 0x{:04X} (limit 8)",
                self.mapping
            ))),
        }
    }
}

/// Returns the total length of mapping entries; their lengths are whole bytes.
fn bytes_of(entries: &[u32]) -> usize {
    entries
        .iter()
        .map(|entry| (entry & 0xFF) as usize / 8)
        .sum()
}

/// Object for a PDO.
#[derive(Clone, Copy, Debug)]
struct Object {
    /// Entry of the object in a mapping.
    entry: u32,
    is_signed: bool,
}

impl Object {
    /// Finds an integer in the drive's dictionary.
    fn find(
        dictionary: &ObjectDictionary,
        (index, sub_index): (u16, u8),
    ) -> Result<Self, DriveError> {
        let entry = dictionary.get(index, sub_index).ok_or_else(|| {
            DriveError(format!(
                "the drive's EDS has no object 0x{index:04X}:{sub_index:02X}"
            ))
        })?;
        let data_type = entry.data_type;
        let length_bytes = data_type
            .size_bytes()
            .filter(|bytes| matches!(bytes, 1 | 2 | 4) && !data_type.is_real())
            .ok_or_else(|| {
                DriveError(format!(
                    "the drive's object 0x{index:04X}:{sub_index:02X} is no integer of 8, 16 or 32 bits"
                ))
            })?;
        #[expect(clippy::cast_possible_truncation, reason = "at most 32 bits")]
        let bits = 8 * length_bytes as u32;
        Ok(Self {
            entry: u32::from(index) << 16 | u32::from(sub_index) << 8 | bits,
            is_signed: data_type.is_signed(),
        })
    }
}

impl Object {
    /// Refuses an object that, by the EDS, takes no command from a PDO.
    fn refuse_unmappable(&self, dictionary: &ObjectDictionary) -> Result<(), DriveError> {
        let [high, low, sub_index, _] = self.entry.to_be_bytes();
        let index = u16::from_be_bytes([high, low]);
        let Some(entry) = dictionary.get(index, sub_index) else {
            return Ok(());
        };
        let why = match entry.access {
            Access::ReadOnly | Access::Constant => "it can only be read",
            Access::ReadWriteRead => "it can only be sent by the drive",
            _ if entry.is_pdo_mappable || entry.lacks_pdo_mapping => return Ok(()),
            _ => "no PDO can carry it",
        };
        let (access, mapping) = (entry.access.word(), u8::from(entry.is_pdo_mappable));
        Err(DriveError(format!(
            "the drive's object 0x{index:04X}:{sub_index:02X} cannot take the command: by its EDS {why} (AccessType={access}, PDOMapping={mapping}); name another object in `command`, or correct the EDS if the drive is otherwise"
        )))
    }
}

/// Place of an integer in a PDO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// First byte, which is the lowest one.
    pub start_byte: usize,
    /// Length: one, two or four bytes.
    pub length_bytes: usize,
    /// Whether the integer is a two's complement.
    pub is_signed: bool,
    /// Number of bits above it in a PDO of 8 bytes.
    bits_above: usize,
    /// Number of bits that an integer of 8 bytes has more.
    unused_bits: usize,
}

impl Field {
    /// Makes a field; `None` if the PDO ends before the field.
    fn new(start_byte: usize, length_bytes: usize, is_signed: bool) -> Option<Self> {
        let bytes_above = 8_usize.checked_sub(start_byte + length_bytes)?;
        Some(Self {
            start_byte,
            length_bytes,
            is_signed,
            bits_above: 8 * bytes_above,
            unused_bits: 64 - 8 * length_bytes,
        })
    }

    /// Reads the integer from a PDO's 8 bytes. The shift to the top drops the bits above the field, the shift down those below
    /// it.
    #[inline]
    fn read(self, data: u64) -> i64 {
        let at_top = data << self.bits_above;
        if self.is_signed {
            at_top.cast_signed() >> self.unused_bits
        } else {
            (at_top >> self.unused_bits).cast_signed()
        }
    }

    /// Returns a PDO of 8 bytes with a value at the field's place, and 0 elsewhere.
    #[inline]
    fn placed(self, value: i64) -> u64 {
        let at_top = value.cast_unsigned() << self.unused_bits;
        at_top >> self.bits_above
    }

    /// Returns the largest value.
    pub fn max(self) -> f64 {
        let bits = 8 * self.length_bytes - usize::from(self.is_signed);
        ((1_i64 << bits) - 1) as f64
    }
}

/// Field with the scale of its values: `(raw − offset) / units`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scaled {
    /// Place of the field.
    pub field: Field,
    /// Raw steps for one unit.
    pub units: f64,
    /// Raw value of 0.
    pub offset: f64,
}

impl Scaled {
    fn read(&self, data: u64) -> f64 {
        (self.field.read(data) as f64 - self.offset) / self.units
    }
}

/// Identity of the drive, and layout of its PDOs.
#[derive(Clone, Debug)]
pub struct DriveLayout {
    /// Node-ID of the drive.
    pub node_id: NodeId,
    /// Objects with their defaults.
    pub dictionary: ObjectDictionary,
    /// TPDO1, to be configured in the drive.
    pub feedback: Pdo,
    /// RPDO1, to be configured in the drive.
    pub command: Pdo,
    /// Mode of operation, which is written to 0x6060.
    pub mode_of_operation: i8,
    /// Place of the statusword in TPDO1.
    pub statusword: Field,
    /// Position in TPDO1, in the unit of the drive's signal.
    pub position: Scaled,
    /// Measured output of the amplifier in TPDO1, in the amplifier's unit; `None` if the drive does not measure it.
    pub current: Option<Scaled>,
    /// Place of the controlword in RPDO1.
    pub controlword: Field,
    /// Command in RPDO1, in the amplifier's unit.
    pub target: Scaled,
    /// Largest command, in whole units of the target.
    target_max: f64,
}

impl DriveLayout {
    /// Returns the objects on whose description a drive's layout depends, as far as the rig file names any.
    pub fn used_objects(rig: &RealDrive) -> Vec<(u16, u8)> {
        let named = [
            &rig.command.object,
            &rig.position.object,
            &rig.current.object,
        ];
        let named = named
            .into_iter()
            .filter_map(|text| object_address(text).ok());
        let words = [(cia402::STATUSWORD, 0), (cia402::CONTROLWORD, 0)];
        let pdos = [(0x1800, 1), (0x1400, 1)];
        IDENTITY
            .into_iter()
            .chain(words)
            .chain(pdos)
            .chain(named)
            .collect()
    }

    /// Makes the layout from the objects of the drive's EDS with their defaults, and the facts of the rig file.
    ///
    /// # Errors
    /// The EDS does not have the objects.
    pub fn new(dictionary: ObjectDictionary, rig: &RealDrive) -> Result<Self, DriveError> {
        let node_id = NodeId::new(rig.node_id)
            .ok_or_else(|| DriveError(format!("{} is no node-ID", rig.node_id)))?;
        let no_pdo = |parameters: u16| {
            DriveError(format!(
                "the drive's EDS describes no usable PDO at 0x{parameters:04X}"
            ))
        };
        let pdo = |places: [u16; 2], function: u32| {
            let [parameters, _] = places;
            let predefined = function + u32::from(node_id.get());
            let pdo =
                Pdo::read(&dictionary, places, predefined).ok_or_else(|| no_pdo(parameters))?;
            // Cut to 11 bits, an identifier of 29 bits would be another one.
            canopen::pdo::identifier(pdo.cob_id).map_err(|_| {
                DriveError(format!(
                    "the drive's EDS gives the PDO at 0x{parameters:04X}:01 the COB-ID 0x{:08X}: PDOs here have identifiers of 11 bits (up to 0x7FF), and none that CiA 301 keeps for other services; give this PDO another default there",
                    pdo.cob_id
                ))
            })?;
            Ok::<_, DriveError>(pdo)
        };
        let object = |text: &str| {
            let unnamed = |_| DriveError(format!("\"{text}\" names no object"));
            Object::find(&dictionary, object_address(text).map_err(unnamed)?)
        };
        let word = |index| Object::find(&dictionary, (index, 0));
        let (statusword, controlword) = (word(cia402::STATUSWORD)?, word(cia402::CONTROLWORD)?);
        let position = object(&rig.position.object)?;
        let target = object(&rig.command.object)?;
        target.refuse_unmappable(&dictionary)?;
        let current = match rig.current.object.as_str() {
            "" => None,
            measured => Some(object(measured)?),
        };
        let reported: Vec<Object> = [statusword, position].into_iter().chain(current).collect();
        let feedback = pdo([0x1800, 0x1A00], TPDO1)?.with(&reported)?;
        let command = pdo([0x1400, 0x1600], RPDO1)?.with(&[controlword, target])?;
        let place =
            |pdo: &Pdo, object: &Object| pdo.place(object).ok_or_else(|| no_pdo(pdo.parameters));
        let scaled = |pdo: &Pdo, object: &Object, units, offset| {
            let field = place(pdo, object)?;
            Ok::<_, DriveError>(Scaled {
                field,
                units,
                offset,
            })
        };
        let counts = &rig.position;
        let (per_unit, at_zero) = (counts.increments_per_unit, counts.increments_at_zero);
        let per_ampere = rig.current.units_per_ampere;
        let measured = current
            .map(|object| scaled(&feedback, &object, per_ampere, 0.0))
            .transpose()?;
        let target = scaled(&command, &target, rig.command.units_per_ampere, 0.0)?;
        let units_max = libm::floor(rig.limits.current_amperes * target.units);
        Ok(Self {
            node_id,
            statusword: place(&feedback, &statusword)?,
            position: scaled(&feedback, &position, per_unit, at_zero)?,
            current: measured,
            controlword: place(&command, &controlword)?,
            target,
            target_max: units_max.min(target.field.max()),
            mode_of_operation: rig.mode_of_operation,
            dictionary,
            feedback,
            command,
        })
    }

    /// Decodes TPDO1; `None` for other frames, and for one that is too short.
    #[inline]
    pub fn decode(&self, frame: &CanFrame) -> Option<Feedback> {
        let is_whole = frame.data().len() >= self.feedback.length_bytes;
        if frame.standard_id() != Some(self.feedback.id()) || !is_whole {
            return None;
        }
        let data = u64::from_le_bytes(frame.buffer());
        Some(Feedback {
            statusword: u16::try_from(self.statusword.read(data)).ok()?,
            position: self.position.read(data),
            output: self.current.map(|current| current.read(data)),
        })
    }

    /// Decodes the command in RPDO1; `None` for other frames, and for one that is too short.
    pub fn decode_target(&self, frame: &CanFrame) -> Option<f64> {
        let field = &self.target.field;
        let is_command = frame.standard_id() == Some(self.command.id())
            && frame.data().len() >= field.start_byte + field.length_bytes;
        is_command.then(|| self.target.read(u64::from_le_bytes(frame.buffer())))
    }

    /// Encodes RPDO1; the command is limited to the largest one that the drive may be given and its object can hold.
    #[inline]
    pub fn encode(&self, controlword: u16, command: f64) -> CanFrame {
        let max = self.target_max;
        let min = if self.target.field.is_signed {
            -max
        } else {
            0.0
        };
        #[expect(
            clippy::cast_possible_truncation,
            reason = "limited to the object's range, whose ends are whole"
        )]
        let target = add_half(command * self.target.units).clamp(min, max) as i64;
        let controlword = self.controlword.placed(i64::from(controlword));
        let data = (controlword | self.target.field.placed(target)).to_le_bytes();
        CanFrame::new(self.command.id(), &data[..self.command.length_bytes])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::Limits;
    use canopen::eds;

    /// EDS of the drive that canrig emulates.
    const DRIVE_EDS: &str = include_str!("../../../../dbc/drive.eds");

    /// Returns the emulated drive with this largest current.
    fn with_current(current_amperes: f64) -> RealDrive {
        RealDrive::new(Limits {
            current_amperes,
            min: 0.0,
            max: 60.0,
            rate_max: 500.0,
        })
    }

    fn objects(eds: &str, node_id: u8) -> ObjectDictionary {
        eds::parse(eds, node_id).unwrap()
    }

    fn emulated() -> DriveLayout {
        DriveLayout::new(objects(DRIVE_EDS, 0x10), &with_current(1.0)).unwrap()
    }

    #[test]
    fn feedback_and_command_are_laid_out_as_the_eds_says() {
        let drive = emulated();
        let frame = CanFrame::new(0x190, &[0x37, 0x02, 0x10, 0x27, 0, 0, 0, 2]);
        let feedback = drive.decode(&frame).unwrap();
        assert_eq!(feedback.statusword, 0x0237);
        assert!((feedback.position - 10.0).abs() < 1e-12);
        assert_eq!(
            drive.encode(0x0F, 0.5),
            CanFrame::new(0x210, &[0x0F, 0, 0xF4, 0x01])
        );
    }

    #[test]
    fn short_and_foreign_frames_are_no_feedback() {
        let drive = emulated();
        assert_eq!(drive.decode(&CanFrame::new(0x190, &[0; 7])), None);
        assert_eq!(drive.decode(&CanFrame::new(0x191, &[0; 8])), None);
    }

    #[test]
    fn a_command_is_never_beyond_the_drives_range() {
        let drive = emulated();
        for (amperes, permille) in [
            (2.0, 1000_i16),
            (-0.5, -500),
            (-2.0, -1000),
            (f64::NAN, 0),
            (f64::INFINITY, 1000),
        ] {
            assert_eq!(drive.encode(0, amperes).data()[2..], permille.to_le_bytes());
        }
    }

    #[test]
    fn an_object_that_is_not_mapped_is_mapped_and_one_that_is_not_there_is_refused() {
        let text = DRIVE_EDS.replace("0x60640020", "0x60780010");
        let drive = DriveLayout::new(objects(&text, 0x10), &with_current(1.0)).unwrap();
        let wanted = [0x6041_0010, 0x6064_0020, 0x6078_0010];
        assert_eq!(drive.feedback.entries, wanted);
        let mut rig = with_current(1.0);
        rig.position.object = "0x2345:01".to_owned();
        let error = DriveLayout::new(objects(&text, 0x10), &rig).unwrap_err();
        assert_eq!(error.to_string(), "the drive's EDS has no object 0x2345:01");
        rig.position.object = "0x1008".to_owned();
        let error = DriveLayout::new(objects(&text, 0x10), &rig).unwrap_err();
        assert!(
            error.to_string().contains("0x1008:00 is no integer"),
            "{error}"
        );
        rig.position.object = "0x6078".to_owned();
        let error = DriveLayout::new(objects(&text, 0x10), &rig).unwrap_err();
        assert!(
            error.to_string().contains("object 0x6078:00 two meanings"),
            "{error}"
        );
    }

    #[test]
    fn identifiers_that_the_bench_cannot_serve_are_refused_with_their_place() {
        for (was, cob_id, place) in [
            ("$NODEID+0x40000180", "0x20000190", "0x1800:01"),
            ("$NODEID+0x200", "0x20000210", "0x1400:01"),
            ("$NODEID+0x200", "0x00000810", "0x1400:01"),
            ("$NODEID+0x200", "0x00000601", "0x1400:01"),
        ] {
            let text = DRIVE_EDS.replace(
                &format!("DefaultValue={was}\n"),
                &format!("DefaultValue={cob_id}\n"),
            );
            let error = DriveLayout::new(objects(&text, 0x10), &with_current(1.0))
                .unwrap_err()
                .to_string();
            assert!(error.contains(cob_id) && error.contains(place), "{error}");
        }
    }

    #[test]
    fn other_objects_scalings_and_limits_come_from_the_rig_file() {
        let mut rig = with_current(0.9);
        rig.node_id = 0x20;
        // Counts fall from 5000 at the stop by 10 a millimetre; the command is in 1/2 permille.
        rig.position.increments_per_unit = -10.0;
        rig.position.increments_at_zero = 5000.0;
        rig.command.units_per_ampere = 2000.0;
        rig.current.object = String::new();
        let drive = DriveLayout::new(objects(DRIVE_EDS, 0x20), &rig).unwrap();
        let frame = CanFrame::new(0x1A0, &[0x37, 2, 0x4C, 0x13, 0, 0, 0, 0]);
        let feedback = drive.decode(&frame).unwrap();
        assert!((feedback.position - 6.0).abs() < 1e-9);
        assert_eq!(feedback.output, None);
        for (amperes, units) in [(0.5, 1000_i16), (0.95, 1800), (7.0, 1800)] {
            let frame = drive.encode(0x0F, amperes);
            assert_eq!(frame.standard_id(), Some(0x220));
            assert_eq!(frame.data()[2..], units.to_le_bytes());
            assert_eq!(drive.decode_target(&frame), Some(f64::from(units) / 2000.0));
        }
    }
}
