//! The drive's objects: where they are and in which units they count.

use canopen::ObjectDictionary;
use canopen::cia402;
use canopen::object_dictionary::{DataType, Handle};

use crate::objects::{self, MissingObject};
use crate::sma::Actuator;
use crate::thermal_protection::Limits;

const POSITION_ACTUAL_VALUE: u16 = 0x6064;
const TARGET_TORQUE: u16 = 0x6071;
const MAX_TORQUE: u16 = 0x6072;
const MAX_CURRENT: u16 = 0x6073;
const MOTOR_RATED_CURRENT: u16 = 0x6075;
const TORQUE_ACTUAL_VALUE: u16 = 0x6077;
const CURRENT_ACTUAL_VALUE: u16 = 0x6078;
const WIRE_TEMPERATURE: u16 = 0x2101;
const MARTENSITE_FRACTION: u16 = 0x2102;
const TRUE_POSITION: u16 = 0x2103;
const THERMAL_PROTECTION: u16 = 0x2110;

/// What the emulator knows and no real drive can measure (TPDO2).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// Temperature of the wire.
    pub temperature_celsius: f64,
    /// Martensite fraction, 0 to 1.
    pub martensite_fraction: f64,
    /// Height of the load above its stop.
    pub position_metres: f64,
}

impl Truth {
    /// The state of an actuator.
    #[must_use]
    pub fn of(actuator: &Actuator) -> Self {
        Self {
            temperature_celsius: actuator.temperature_celsius(),
            martensite_fraction: actuator.martensite_fraction(),
            position_metres: actuator.position_metres(),
        }
    }
}

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
    wire_temperature: Handle,
    martensite_fraction: Handle,
    true_position: Handle,
    continuous_current: Handle,
    overload_limit: Handle,
    overload_utilisation: Handle,
    rated_current: Handle,
}

impl Objects {
    pub(super) fn find(dictionary: &ObjectDictionary) -> Result<Self, MissingObject> {
        let at = |index, data_type| objects::find(dictionary, index, 0, data_type);
        let protection = |sub_index, data_type| {
            objects::find(dictionary, THERMAL_PROTECTION, sub_index, data_type)
        };
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
            wire_temperature: at(WIRE_TEMPERATURE, DataType::Integer16)?,
            martensite_fraction: at(MARTENSITE_FRACTION, DataType::Unsigned16)?,
            true_position: at(TRUE_POSITION, DataType::Integer32)?,
            continuous_current: protection(1, DataType::Unsigned32)?,
            overload_limit: protection(2, DataType::Unsigned32)?,
            overload_utilisation: protection(3, DataType::Unsigned16)?,
            rated_current: at(MOTOR_RATED_CURRENT, DataType::Unsigned32)?,
        })
    }

    /// 0x6040.
    pub(super) fn controlword(&self, dictionary: &ObjectDictionary) -> u16 {
        unsigned16(dictionary, self.controlword)
    }

    /// 0x6060.
    pub(super) fn mode(&self, dictionary: &ObjectDictionary) -> i8 {
        let value = objects::integer16(dictionary, self.mode);
        i8::try_from(value).unwrap_or_default()
    }

    /// 0x6071 in permille of the rated torque.
    pub(super) fn target_torque_permille(&self, dictionary: &ObjectDictionary) -> i16 {
        objects::integer16(dictionary, self.target_torque)
    }

    /// 0x6072 and 0x6073 in permille of the rated values.
    pub(super) fn limits_permille(&self, dictionary: &ObjectDictionary) -> (u16, u16) {
        (
            unsigned16(dictionary, self.max_torque),
            unsigned16(dictionary, self.max_current),
        )
    }

    /// 0x6075.
    pub(super) fn rated_amperes(&self, dictionary: &ObjectDictionary) -> f64 {
        unsigned32(dictionary, self.rated_current) / 1e3
    }

    /// 0x2110:01 and :02.
    pub(super) fn protection_limits(&self, dictionary: &ObjectDictionary) -> Limits {
        Limits {
            continuous_amperes: unsigned32(dictionary, self.continuous_current) / 1e3,
            overload_square_ampere_seconds: unsigned32(dictionary, self.overload_limit) / 1e3,
        }
    }

    /// 0x6041 and 0x6061.
    pub(super) fn set_status(&self, dictionary: &mut ObjectDictionary, statusword: u16, mode: i8) {
        objects::store(dictionary, self.statusword, &statusword.to_le_bytes());
        objects::store(dictionary, self.mode_display, &mode.to_le_bytes());
    }

    /// 0x6064 in micrometres.
    pub(super) fn set_position(&self, dictionary: &mut ObjectDictionary, position_metres: f64) {
        let micrometres = objects::rounded_i32(position_metres * 1e6);
        objects::store(dictionary, self.position, &micrometres.to_le_bytes());
    }

    /// 0x6077 and 0x6078 in permille of the rated values.
    pub(super) fn set_current(&self, dictionary: &mut ObjectDictionary, permille: i16) {
        objects::store(dictionary, self.torque, &permille.to_le_bytes());
        objects::store(dictionary, self.current, &permille.to_le_bytes());
    }

    /// 0x2110:03 in permille of the limit.
    pub(super) fn set_utilisation(&self, dictionary: &mut ObjectDictionary, utilisation: f64) {
        let utilisation = objects::rounded_u16(utilisation * 1e3);
        let bytes = utilisation.to_le_bytes();
        objects::store(dictionary, self.overload_utilisation, &bytes);
    }

    /// 0x2101 in 0.01 °C, 0x2102 in 1/50000, 0x2103 in nanometres.
    pub(super) fn set_truth(&self, dictionary: &mut ObjectDictionary, truth: &Truth) {
        let temperature = objects::rounded_i16(truth.temperature_celsius * 1e2);
        let fraction = objects::rounded_u16(truth.martensite_fraction * 5e4);
        let position = objects::rounded_i32(truth.position_metres * 1e9);
        objects::store(
            dictionary,
            self.wire_temperature,
            &temperature.to_le_bytes(),
        );
        objects::store(
            dictionary,
            self.martensite_fraction,
            &fraction.to_le_bytes(),
        );
        objects::store(dictionary, self.true_position, &position.to_le_bytes());
    }
}

fn unsigned16(dictionary: &ObjectDictionary, handle: Handle) -> u16 {
    u16::try_from(dictionary.entry(handle).as_integer()).unwrap_or_default()
}

fn unsigned32(dictionary: &ObjectDictionary, handle: Handle) -> f64 {
    f64::from(u32::try_from(dictionary.entry(handle).as_integer()).unwrap_or_default())
}
