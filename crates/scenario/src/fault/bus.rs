//! Faults of the bus.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::lasting::{Lasting, faults, one};

/// A participant of the bus, with a CAN controller of its own.
#[derive(Clone, Copy, Debug, Deserialize, Eq, JsonSchema, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Station {
    /// The controller.
    Controller,
    /// The drive, and the disturbance module on the same CAN controller.
    Drive,
    /// canrig's own node, which can stop the drive.
    Bench,
}

/// One frame by default.
fn one_frame() -> u32 {
    1
}

faults! {
    /// Faults of the bus. A fault of frames hits those of one identifier or, without, all; each with a probability, and
    /// then so many of them in a row.
    BusFaults {
        /// One receiver overruns: it misses frames that all others get. `bus.log` shows them.
        lose: Lose {
            /// Station that misses them.
            receiver: Station,
            /// Only frames with this identifier.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            #[schemars(range(min = 0, max = 2047))]
            identifier: Option<u16>,
            /// Probability for each frame.
            #[serde(default = "one")]
            #[schemars(range(min = 0.0, max = 1.0))]
            probability: f64,
            /// Frames lost in a row.
            #[serde(default = "one_frame")]
            #[schemars(range(min = 1, max = 100_000))]
            burst_frames: u32,
        }
        /// The sender's frames wait before they may take part in the arbitration. `bus.log` shows them when they come.
        delay: Delay {
            /// Station whose frames are hit.
            sender: Station,
            /// Only frames with this identifier.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            #[schemars(range(min = 0, max = 2047))]
            identifier: Option<u16>,
            /// Probability for each frame.
            #[serde(default = "one")]
            #[schemars(range(min = 0.0, max = 1.0))]
            probability: f64,
            /// Frames delayed in a row.
            #[serde(default = "one_frame")]
            #[schemars(range(min = 1, max = 100_000))]
            burst_frames: u32,
            /// How long the frames wait.
            #[schemars(range(min = 0.0, max = 10_000.0))]
            delay_milliseconds: f64,
        }
        /// A gateway between the sender and the bus sends frames twice. `bus.log` shows both.
        duplicate: Duplicate {
            /// Station whose frames are hit.
            sender: Station,
            /// Only frames with this identifier.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            #[schemars(range(min = 0, max = 2047))]
            identifier: Option<u16>,
            /// Probability for each frame.
            #[serde(default = "one")]
            #[schemars(range(min = 0.0, max = 1.0))]
            probability: f64,
            /// Frames doubled in a row.
            #[serde(default = "one_frame")]
            #[schemars(range(min = 1, max = 100_000))]
            burst_frames: u32,
        }
        /// A gateway between the sender and the bus lets the sender's next frame overtake. `bus.log` shows them in the
        /// new order.
        reorder: Reorder {
            /// Station whose frames are hit.
            sender: Station,
            /// Only frames with this identifier.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            #[schemars(range(min = 0, max = 2047))]
            identifier: Option<u16>,
            /// Probability for each frame.
            #[serde(default = "one")]
            #[schemars(range(min = 0.0, max = 1.0))]
            probability: f64,
            /// Frames overtaken in a row.
            #[serde(default = "one_frame")]
            #[schemars(range(min = 1, max = 100_000))]
            burst_frames: u32,
        }
        /// A gateway between the sender and the bus changes payloads; the CRC on the bus is right. `bus.log` shows the
        /// changed frames.
        corrupt: Corrupt {
            /// Station whose frames are hit.
            sender: Station,
            /// Only frames with this identifier.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            #[schemars(range(min = 0, max = 2047))]
            identifier: Option<u16>,
            /// Probability for each frame.
            #[serde(default = "one")]
            #[schemars(range(min = 0.0, max = 1.0))]
            probability: f64,
            /// Frames changed in a row.
            #[serde(default = "one_frame")]
            #[schemars(range(min = 1, max = 100_000))]
            burst_frames: u32,
            /// Bits that are inverted, at random places.
            #[serde(default = "one_frame")]
            #[schemars(range(min = 1, max = 64))]
            inverted_bits: u32,
        }
        /// A bit is disturbed on the wire: error flag, retransmission, error counters up to error passive and bus-off (ISO
        /// 11898-1). `bus.log` shows the frame when it has passed, and an error message of the bench's for each change of
        /// a station's state. The bus load counts frames that passed, as on a real interface: what was disturbed only
        /// makes them late.
        bit_error: BitError {
            /// Only while this station sends.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            sender: Option<Station>,
            /// Only frames with this identifier.
            #[serde(default, skip_serializing_if = "Option::is_none")]
            #[schemars(range(min = 0, max = 2047))]
            identifier: Option<u16>,
            /// Probability for each transmission.
            #[serde(default = "one")]
            #[schemars(range(min = 0.0, max = 1.0))]
            probability: f64,
            /// Transmissions disturbed in a row.
            #[serde(default = "one_frame")]
            #[schemars(range(min = 1, max = 100_000))]
            burst_frames: u32,
        }
        /// A foreign node sends without a pause. `bus.log` shows its frames.
        babble: Babble {
            /// Identifier of its frames; the lowest wins each arbitration.
            #[schemars(range(min = 1, max = 2047))]
            identifier: u16,
        }
        /// A foreign node sends at an even rate. `bus.log` shows its frames.
        load: Load {
            /// Identifier of its frames.
            #[schemars(range(min = 1, max = 2047))]
            identifier: u16,
            /// Time between two frames.
            #[schemars(range(min = 0.1, max = 10_000.0))]
            period_milliseconds: f64,
        }
    }
}

/// What faults of frames have in common.
pub trait OfFrames: Lasting {
    /// Whose frames are hit, or who misses them; everybody's without.
    fn station(&self) -> Option<Station>;
    /// Which frames; all without.
    fn identifier(&self) -> Option<u16>;
    /// Of each of them, where no burst goes on.
    fn probability(&self) -> f64;
    /// Frames hit in a row.
    fn burst_frames(&self) -> u32;
}

macro_rules! of_frames {
    ($($fault:ident by $station:ident),*) => {
        $(impl OfFrames for $fault {
            fn station(&self) -> Option<Station> {
                self.$station.into()
            }

            fn identifier(&self) -> Option<u16> {
                self.identifier
            }

            fn probability(&self) -> f64 {
                self.probability
            }

            fn burst_frames(&self) -> u32 {
                self.burst_frames
            }
        })*
    };
}
of_frames!(
    Lose by receiver,
    Delay by sender,
    Duplicate by sender,
    Reorder by sender,
    Corrupt by sender,
    BitError by sender
);
