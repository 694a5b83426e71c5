//! The law's terms as objects 0x2200 to 0x2208, from where the controller's TPDOs take them.

use canopen::ObjectDictionary;
use canopen::object_dictionary::Handle;

use crate::law::Explanation;
use crate::node::ControllerError;

const MICRO: f64 = 1e6;
const CENTI: f64 = 100.0;
const FRACTION_STEPS: f64 = 50_000.0;

/// Where the terms stand in the dictionary, found once.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ExplanationObjects {
    first_to_last: [Handle; 9],
}

impl ExplanationObjects {
    pub(crate) fn find(dictionary: &ObjectDictionary) -> Result<Self, ControllerError> {
        let find = |index| {
            dictionary
                .find(index, 0)
                .map_err(|_| ControllerError::NoObject(index))
        };
        Ok(Self {
            first_to_last: [
                find(0x2200)?,
                find(0x2201)?,
                find(0x2202)?,
                find(0x2203)?,
                find(0x2204)?,
                find(0x2205)?,
                find(0x2206)?,
                find(0x2207)?,
                find(0x2208)?,
            ],
        })
    }

    /// Stores the terms; values beyond an object's type are cut to its ends. Allocates nothing.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "`as` cuts to the ends of the type, which is what is wanted"
    )]
    pub(crate) fn store(&self, dictionary: &mut ObjectDictionary, terms: &Explanation) {
        let micro = |value: f64| (libm::round(value * MICRO) as i32).to_le_bytes();
        let real = |value: f64| (value as f32).to_le_bytes();
        let temperature = libm::round(terms.estimated_temperature_celsius * CENTI) as i16;
        let fraction =
            libm::round(terms.estimated_martensite_fraction.clamp(0.0, 1.0) * FRACTION_STEPS)
                as u16;
        let values: [&[u8]; 9] = [
            &micro(terms.reference_position_metres),
            &micro(terms.reference_velocity_metres_per_second),
            &temperature.to_le_bytes(),
            &fraction.to_le_bytes(),
            &micro(terms.estimated_velocity_metres_per_second),
            &real(terms.sliding_variable_metres_per_second_squared),
            &[terms.saturation.bits()],
            &real(terms.equivalent_part_square_amperes),
            &real(terms.switching_part_square_amperes),
        ];
        for (handle, value) in self.first_to_last.into_iter().zip(values) {
            let stored = dictionary.store(handle, value);
            debug_assert!(stored.is_ok(), "the EDS gives each object its type");
        }
    }
}
