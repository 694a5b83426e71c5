//! The disturbance module, an io node (CiA 401) with analogue outputs: a fan and an added load, or the inputs that a
//! rig file wires.

use canopen::object_dictionary::{DataType, Handle};
use canopen::{
    AbortCode, Application, CommunicationLoss, NmtCommand, NmtState, ObjectDictionary, Services,
};

use crate::InvalidEmulator;
use crate::objects;

/// Write analogue output 16-bit (CiA 401).
const OUTPUT: u16 = 0x6411;
/// Analogue output error mode (CiA 401): 1 outputs the error value after an error.
const ERROR_MODE: u16 = 0x6443;
/// Analogue output error value integer (CiA 401).
const ERROR_VALUE: u16 = 0x6444;

/// An analogue output.
#[derive(Clone, Copy, Debug)]
struct Output {
    value: Handle,
    error_mode: Handle,
    error_value: Handle,
}

impl Output {
    fn find(dictionary: &ObjectDictionary, sub_index: u8) -> Result<Self, InvalidEmulator> {
        let find = |index, data_type| objects::find(dictionary, index, sub_index, data_type);
        Ok(Self {
            value: find(OUTPUT, DataType::Integer16)?,
            error_mode: find(ERROR_MODE, DataType::Unsigned8)?,
            error_value: find(ERROR_VALUE, DataType::Integer32)?,
        })
    }
}

/// The outputs, whose values are in the dictionary.
#[derive(Clone, Debug)]
pub struct DisturbanceModule {
    outputs: Vec<Output>,
    /// Whether values may have changed since its owner looked.
    pub(crate) is_changed: bool,
}

impl DisturbanceModule {
    /// Makes a module with the outputs of a dictionary.
    ///
    /// # Errors
    /// The dictionary lacks an object of an output.
    pub fn new(dictionary: &ObjectDictionary) -> Result<Self, InvalidEmulator> {
        let count = dictionary.unsigned(OUTPUT, 0).unwrap_or_default();
        let outputs = (1..=u8::try_from(count).unwrap_or_default())
            .map(|sub_index| Output::find(dictionary, sub_index));
        Ok(Self {
            outputs: outputs.collect::<Result<_, _>>()?,
            is_changed: true,
        })
    }

    /// Returns the value of an output, in the units of 0x6411; 0 if there is no such output.
    pub(crate) fn steps(&self, dictionary: &ObjectDictionary, place: usize) -> f64 {
        self.outputs.get(place).map_or(0.0, |output| {
            objects::integer16(dictionary, output.value).into()
        })
    }

    /// Outputs the error values of all outputs whose error mode requires it. They become the commanded values, so no
    /// old value returns with the next start.
    fn put_out_error_values(&mut self, dictionary: &mut ObjectDictionary) {
        for output in &self.outputs {
            if dictionary.entry(output.error_mode).as_integer() == 1 {
                let value = objects::integer16(dictionary, output.error_value);
                objects::store(dictionary, output.value, &value.to_le_bytes());
            }
        }
        self.is_changed = true;
    }
}

impl Application for DisturbanceModule {
    fn on_reset(&mut self, _services: &mut Services, _reset: NmtCommand) {
        self.is_changed = true;
    }

    fn on_nmt_state(&mut self, services: &mut Services, state: NmtState) {
        if state == NmtState::Stopped {
            self.put_out_error_values(services.dictionary_mut());
        }
    }

    fn on_rpdo(&mut self, _services: &mut Services, _number: u16) {
        self.is_changed = true;
    }

    fn on_write(&mut self, _: &mut Services, _: u16, _: u8, _: &[u8]) -> Result<(), AbortCode> {
        self.is_changed = true;
        Ok(())
    }

    fn on_communication_loss(&mut self, services: &mut Services, _loss: CommunicationLoss) {
        self.put_out_error_values(services.dictionary_mut());
    }

    fn on_stop(&mut self, services: &mut Services) {
        self.put_out_error_values(services.dictionary_mut());
    }
}
