//! Objects of the drive: their handles and units.

use canopen::cia402;
use canopen::object_dictionary::{DataType, Handle, Preset};
use canopen::pdo::WaitingPdo;
use canopen::{AbortCode, ObjectDictionary};
use dbc::node_objects::{PLANT_OBJECTS, TRUE_POSITION_OBJECT};
use scenario::plant::{I2t, MAX_CURRENT, MAX_TORQUE, TARGET_TORQUE, THERMAL_PROTECTION};

use crate::InvalidEmulator;
use crate::clocked_plant::ClockedPlant;
use crate::objects::{self, SIGNED_16, UNSIGNED_16};
use crate::wires::{Published, Wires};

const POSITION_ACTUAL_VALUE: u16 = 0x6064;
const TORQUE_ACTUAL_VALUE: u16 = 0x6077;
const CURRENT_ACTUAL_VALUE: u16 = 0x6078;

/// Handles of the drive's objects.
#[derive(Clone, Debug)]
pub(super) struct Objects {
    controlword: Handle,
    statusword: Handle,
    mode: Handle,
    mode_display: Handle,
    position: Handle,
    target_torque: Handle,
    max_torque: Handle,
    max_current: Handle,
    torque: Handle,
    current: Handle,
    signals: Vec<Handle>,
    true_position: Handle,
    continuous_current: Handle,
    overload_limit: Handle,
    overload_utilisation: Handle,
}

impl Objects {
    pub(super) fn find(
        dictionary: &ObjectDictionary,
        wires: &Wires,
    ) -> Result<Self, InvalidEmulator> {
        let at = |index, data_type| objects::find(dictionary, index, 0, data_type);
        let protection = |sub_index, data_type| {
            objects::find(dictionary, THERMAL_PROTECTION, sub_index, data_type)
        };
        let truth_type = if wires.is_true_float {
            DataType::Real32
        } else {
            DataType::Integer32
        };
        let signals = wires
            .published
            .iter()
            .zip(PLANT_OBJECTS)
            .map(|(one, index)| at(index, data_type(one)));
        Ok(Self {
            controlword: at(cia402::CONTROLWORD, DataType::Unsigned16)?,
            statusword: at(cia402::STATUSWORD, DataType::Unsigned16)?,
            mode: at(cia402::MODES_OF_OPERATION, DataType::Integer8)?,
            mode_display: at(cia402::MODES_OF_OPERATION_DISPLAY, DataType::Integer8)?,
            position: at(POSITION_ACTUAL_VALUE, DataType::Integer32)?,
            target_torque: at(TARGET_TORQUE, DataType::Integer16)?,
            max_torque: at(MAX_TORQUE, DataType::Unsigned16)?,
            max_current: at(MAX_CURRENT, DataType::Unsigned16)?,
            torque: at(TORQUE_ACTUAL_VALUE, DataType::Integer16)?,
            current: at(CURRENT_ACTUAL_VALUE, DataType::Integer16)?,
            signals: signals.collect::<Result<_, _>>()?,
            true_position: at(TRUE_POSITION_OBJECT, truth_type)?,
            continuous_current: protection(1, DataType::Unsigned32)?,
            overload_limit: protection(2, DataType::Unsigned32)?,
            overload_utilisation: protection(3, DataType::Unsigned16)?,
        })
    }

    /// Returns 0x6040.
    pub(super) fn controlword(&self, dictionary: &ObjectDictionary) -> u16 {
        u16::from_le_bytes(bytes(dictionary, self.controlword))
    }

    /// Returns 0x6040 as it will be from the next SYNC on; `None` if the PDO does not contain it.
    pub(super) fn waiting_controlword(
        &self,
        dictionary: &ObjectDictionary,
        waiting: &WaitingPdo,
    ) -> Option<u16> {
        u16::try_from(waiting.integer(dictionary, self.controlword)?).ok()
    }

    /// Returns 0x6060.
    pub(super) fn mode(&self, dictionary: &ObjectDictionary) -> i8 {
        i8::from_le_bytes(bytes(dictionary, self.mode))
    }

    /// Returns whether 0x6061 does not show 0x6060 yet.
    pub(super) fn is_mode_new(&self, dictionary: &ObjectDictionary) -> bool {
        self.mode(dictionary) != i8::from_le_bytes(bytes(dictionary, self.mode_display))
    }

    /// Reverts a mode that an RPDO set and the drive does not support, as an SDO would have been refused.
    pub(super) fn refuse_mode(&self, dictionary: &mut ObjectDictionary) {
        if self.is_mode_new(dictionary) && check_mode(dictionary, self.mode(dictionary)).is_err() {
            let present: [u8; 1] = bytes(dictionary, self.mode_display);
            objects::store(dictionary, self.mode, &present);
        }
    }

    /// Returns 0x6071 in permille of the rated torque, within 0x6072 and 0x6073, and whether these cut it.
    pub(super) fn limited_torque(&self, dictionary: &ObjectDictionary) -> (i16, bool) {
        let unsigned = |handle| u16::from_le_bytes(bytes(dictionary, handle));
        let target = i16::from_le_bytes(bytes(dictionary, self.target_torque));
        cia402::limit_torque(
            target,
            unsigned(self.max_torque),
            unsigned(self.max_current),
        )
    }

    /// Returns 0x2110:01 and :02.
    pub(super) fn protection_limits(&self, dictionary: &ObjectDictionary) -> I2t {
        I2t {
            continuous: unsigned32(dictionary, self.continuous_current) / 1e3,
            peak_square_seconds: unsigned32(dictionary, self.overload_limit) / 1e3,
        }
    }

    /// Sets 0x6041 and 0x6061.
    pub(super) fn set_status(&self, dictionary: &mut ObjectDictionary, statusword: u16, mode: i8) {
        objects::store(dictionary, self.statusword, &statusword.to_le_bytes());
        objects::store(dictionary, self.mode_display, &mode.to_le_bytes());
    }

    /// Sets 0x6064 in micrometres, or in the corresponding counts of another unit.
    pub(super) fn set_position(&self, dictionary: &mut ObjectDictionary, counts: f64) {
        let counts = objects::rounded_i32(counts);
        objects::store(dictionary, self.position, &counts.to_le_bytes());
    }

    /// Sets 0x6077 and 0x6078 in permille of the rated values.
    pub(super) fn set_output(&self, dictionary: &mut ObjectDictionary, permille: i16) {
        objects::store(dictionary, self.torque, &permille.to_le_bytes());
        objects::store(dictionary, self.current, &permille.to_le_bytes());
    }

    /// Sets 0x2110:03 in permille of the limit.
    pub(super) fn set_utilisation(&self, dictionary: &mut ObjectDictionary, utilisation: f64) {
        let permille = objects::rounded_16(utilisation * 1e3, UNSIGNED_16);
        objects::store(dictionary, self.overload_utilisation, &permille);
    }

    /// Sets the plant's own signals in their steps, and 0x2103 in nanometres or millionths of another unit.
    pub(super) fn set_truth(
        &self,
        dictionary: &mut ObjectDictionary,
        wires: &Wires,
        plant: &ClockedPlant,
    ) {
        for (handle, signal) in self.signals.iter().zip(&wires.published) {
            objects::store(dictionary, *handle, &raw(signal, plant));
        }
        let steps = plant.output(wires.output) * wires.true_steps_per_output;
        #[expect(clippy::cast_possible_truncation, reason = "a float of 32 bits")]
        let bytes = if wires.is_true_float {
            (steps as f32).to_le_bytes()
        } else {
            objects::rounded_i32(steps).to_le_bytes()
        };
        objects::store(dictionary, self.true_position, &bytes);
    }
}

/// Checks whether 0x6502 contains a mode.
pub(super) fn check_mode(dictionary: &ObjectDictionary, mode: i8) -> Result<(), AbortCode> {
    let supported = dictionary.unsigned(cia402::SUPPORTED_DRIVE_MODES, 0);
    cia402::check_mode(mode, supported.unwrap_or_default())
}

/// Returns the first values of the published outputs of the plant.
pub(crate) fn first_values(wires: &Wires, plant: &ClockedPlant) -> impl Iterator<Item = Preset> {
    let published = wires.published.iter().zip(PLANT_OBJECTS);
    published.map(|(signal, index)| {
        let value = i16::from_le_bytes(raw(signal, plant));
        Preset::new(index, 0, value.into())
    })
}

fn data_type(signal: &Published) -> DataType {
    if signal.range == SIGNED_16 {
        DataType::Integer16
    } else {
        DataType::Unsigned16
    }
}

fn raw(signal: &Published, plant: &ClockedPlant) -> [u8; 2] {
    let steps = plant.output(signal.output) * signal.steps_per_unit;
    objects::rounded_16(steps, signal.range)
}

fn unsigned32(dictionary: &ObjectDictionary, handle: Handle) -> f64 {
    f64::from(u32::from_le_bytes(bytes(dictionary, handle)))
}

/// Returns a value. Its width is that of the object's type, as [`objects::find`] has checked.
#[inline]
fn bytes<const N: usize>(dictionary: &ObjectDictionary, handle: Handle) -> [u8; N] {
    let value = dictionary.entry(handle).value();
    <[u8; N]>::try_from(value).unwrap_or([0; N])
}
