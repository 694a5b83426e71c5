//! What the emulated plant reported of itself, in scenario time.

use std::time::Duration;

use dbc::{Database, SignalHandle, SignalMissing};

use crate::log::Stamped;

/// One message of the emulated plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantTruth {
    /// When it was so, in scenario time; negative before its beginning.
    pub time_seconds: f64,
    /// Current through the wire.
    pub current_amperes: f64,
    /// Highest temperature of the wire since the message before.
    pub peak_temperature_celsius: f64,
}

/// Collects the messages. The plant's clock is not the recording's: their difference is the smallest between a stamp and the
/// plant's own time in the message, since a full bus only makes messages late.
pub(crate) struct TruthReader {
    current: SignalHandle,
    peak_temperature: SignalHandle,
    time: SignalHandle,
    messages: Vec<PlantTruth>,
    offset_seconds: f64,
}

impl TruthReader {
    pub(crate) fn new(database: &Database) -> Result<Self, SignalMissing> {
        Ok(Self {
            current: database.require("plant_truth.plant_current_amperes")?,
            peak_temperature: database.require("plant_truth.plant_peak_temperature_celsius")?,
            time: database.require("plant_truth.plant_time_seconds")?,
            messages: Vec::new(),
            offset_seconds: f64::INFINITY,
        })
    }

    /// The identifier of the messages.
    pub(crate) fn raw_id(&self) -> u32 {
        self.time.raw_id()
    }

    pub(crate) fn on_frame(&mut self, stamped: &Stamped) {
        let decode = |signal: &SignalHandle| signal.decode(&stamped.frame);
        let Some(time_seconds) = decode(&self.time) else {
            return;
        };
        let (current, temperature) = (decode(&self.current), decode(&self.peak_temperature));
        self.offset_seconds = self
            .offset_seconds
            .min(stamped.time.as_secs_f64() - time_seconds);
        self.messages.push(PlantTruth {
            time_seconds,
            current_amperes: current.unwrap_or(f64::NAN),
            peak_temperature_celsius: temperature.unwrap_or(f64::NAN),
        });
    }

    /// The messages in scenario time.
    pub(crate) fn take_all(&mut self, zero: Option<Duration>) -> Vec<PlantTruth> {
        let zero_seconds = zero.unwrap_or_default().as_secs_f64();
        for message in &mut self.messages {
            message.time_seconds += self.offset_seconds - zero_seconds;
        }
        std::mem::take(&mut self.messages)
    }
}
