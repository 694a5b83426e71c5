//! Reports of the emulated plant on itself, in scenario time.

use std::time::Duration;

use dbc::{Database, Signal, SignalHandle, SignalMissing, names};
use plan::{ControlLoop, message_of};
use platform::series::{Series, SeriesWriter};

use crate::log::Stamped;

/// Signals of a message: the emulator's time, the amplifier's output, the plant's peak temperature.
const SIGNALS: [&str; 3] = [
    "plant_time_seconds",
    names::PLANT_OUTPUT,
    "plant_peak_temperature_celsius",
];

/// Temperature that a drive reports whose plant has none.
const ABSOLUTE_ZERO_CELSIUS: f64 = -273.15;

/// Checks whether a signal is the temperature to which the current heats a plant.
pub fn is_temperature(signal: &Signal) -> bool {
    signal.name.ends_with("_temperature_celsius")
}

/// Report of the emulated plant in one message.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct PlantTruth {
    /// Scenario time of the values; negative before the scenario.
    pub time_seconds: f64,
    /// Output of the amplifier.
    pub output: f64,
    /// Highest temperature of the heated part since the message before; not a number for a plant without one.
    pub peak_temperature_celsius: f64,
}

/// Reader of the messages. The plant's clock is not the recording's: their difference is the smallest one between a stamp and the
/// plant's own time in the message, since a full bus only makes messages late.
pub(crate) struct TruthReader {
    /// The [`SIGNALS`]; `None` for an external drive, which sends none.
    signals: Option<[SignalHandle; 3]>,
    messages: SeriesWriter<PlantTruth>,
    offset_seconds: f64,
}

impl TruthReader {
    pub(crate) fn new(database: &Database, one: &ControlLoop) -> Result<Self, SignalMissing> {
        let message = message_of(database, one.drive(), names::TRUTH).ok();
        let quantities = one.trial.wiring.drive_quantities();
        let signals = message.map(|message| {
            let [time, output, peak_temperature] = SIGNALS.map(|pattern| {
                let name = quantities.name(pattern);
                database.signal_of(&message.name, &name)
            });
            Ok([time?, output?, peak_temperature?])
        });
        Ok(Self {
            signals: signals.transpose()?,
            messages: SeriesWriter::default(),
            offset_seconds: f64::INFINITY,
        })
    }

    /// Returns the identifier of the messages.
    pub(crate) fn raw_id(&self) -> Option<u32> {
        self.signals.as_ref().map(|[time, ..]| time.raw_id())
    }

    pub(crate) fn on_frame(&mut self, stamped: &Stamped) {
        let Some(signals) = &self.signals else { return };
        let [time, output, temperature] = signals
            .each_ref()
            .map(|signal| signal.decode(&stamped.frame));
        let Some(time_seconds) = time else { return };
        let temperature = temperature.filter(|celsius| *celsius > ABSOLUTE_ZERO_CELSIUS);
        self.offset_seconds = self
            .offset_seconds
            .min(stamped.time.as_secs_f64() - time_seconds);
        self.messages.push(PlantTruth {
            time_seconds,
            output: output.unwrap_or(f64::NAN),
            peak_temperature_celsius: temperature.unwrap_or(f64::NAN),
        });
    }

    /// Takes the messages, in scenario time.
    pub(crate) fn take_all(&mut self, zero: Option<Duration>) -> Series<PlantTruth> {
        let zero_seconds = zero.unwrap_or_default().as_secs_f64();
        let messages = std::mem::take(&mut self.messages).finish();
        let in_scenario = |message: PlantTruth| PlantTruth {
            time_seconds: message.time_seconds + (self.offset_seconds - zero_seconds),
            ..message
        };
        messages.iter().map(in_scenario).collect()
    }
}

#[cfg(test)]
mod tests {
    use dbc::Database;

    use super::*;

    #[test]
    fn a_plant_without_a_temperature_has_none() {
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        let plan = testing::plan(text);
        let mut reader = TruthReader::new(plan.database(), plan.only_loop().unwrap()).unwrap();
        let mut message = Database::shipped().builder("drive_truth").unwrap();
        let signal = Database::shipped().signal("drive_truth.plant_peak_temperature_celsius");
        let signal = signal.unwrap();
        for celsius in [f64::NEG_INFINITY, 20.0] {
            message.set(&signal, celsius);
            reader.on_frame(&Stamped::new(Duration::ZERO, message.frame()));
        }
        let truth = reader.take_all(None).to_vec();
        assert!(truth[0].peak_temperature_celsius.is_nan());
        assert_eq!(truth[1].peak_temperature_celsius, 20.0);
    }
}
