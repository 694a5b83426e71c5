//! Faults of the position sensor.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::lasting::{faults, one};

faults! {
    /// Faults of the position sensor, in the order in which they act: on the position before its conversion, then on the
    /// converter's number.
    SensorFaults {
        /// The sensor reads too much or too little.
        offset: Offset {
            /// Added to the position.
            #[schemars(range(min = -1e6, max = 1e6))]
            offset_millimetres: f64,
        }
        /// The sensor's zero wanders away while the fault lasts, and is back after it.
        drift: Drift {
            /// How fast the zero wanders.
            #[schemars(range(min = -1e6, max = 1e6))]
            rate_millimetres_per_second: f64,
        }
        /// Normal noise on top of the plant's own.
        noise: Noise {
            /// Standard deviation of the noise.
            #[schemars(range(min = 0.0, max = 1e6))]
            noise_millimetres_rms: f64,
        }
        /// Single samples are off by a fixed height, upwards or downwards.
        spikes: Spikes {
            /// Height of a spike.
            #[schemars(range(min = 0.0, max = 1e6))]
            height_millimetres: f64,
            /// Probability of a spike in a sample.
            #[serde(default = "one")]
            #[schemars(range(min = 0.0, max = 1.0))]
            probability: f64,
        }
        /// Bits of the converter's number read 0.
        lost_bits: LostBits {
            /// The bits, as a mask: 3 for the lowest two.
            #[schemars(range(min = 1, max = 16_777_215))]
            mask: u32,
        }
        /// The converter's number stays as it is.
        stuck: Stuck {}
    }
}
