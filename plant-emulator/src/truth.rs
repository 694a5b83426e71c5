//! The truth about the emulated plant in scenarios with faults, in any state of the drive: the current that really
//! flows, and the temperature that it causes.

use std::time::Duration;

use can::CanFrame;
use dbc::{Database, MessageBuilder, SignalHandle, SignalMissing, names};
use scenario::wiring::Wiring;

use crate::drive::Drive;

/// Time between two messages.
const PERIOD: Duration = Duration::from_millis(10);

/// The producer of the truth of a drive's plant.
#[derive(Clone, Debug)]
pub(crate) struct Truth {
    message: MessageBuilder,
    current: SignalHandle,
    peak_temperature: SignalHandle,
    time: SignalHandle,
    peak_celsius: f64,
    is_heated: bool,
    next: Duration,
    waiting: Vec<CanFrame>,
}

impl Truth {
    pub(crate) fn new(database: &Database, wiring: &Wiring) -> Result<Self, SignalMissing> {
        let message = names::message(&wiring.drive().name, names::TRUTH);
        let quantities = wiring.drive_quantities();
        let signal = |pattern: &str| database.signal_of(&message, &quantities.name(pattern));
        Ok(Self {
            message: database.builder(&message)?,
            current: signal(names::PLANT_OUTPUT)?,
            peak_temperature: signal("plant_peak_temperature_celsius")?,
            time: signal("plant_time_seconds")?,
            peak_celsius: f64::NEG_INFINITY,
            is_heated: false,
            next: PERIOD,
            waiting: Vec::new(),
        })
    }

    /// Observes the rig of a drive after an event. The temperature is monotonic while the inputs are constant, so its
    /// peaks lie at these times.
    pub(crate) fn observe(&mut self, now: Duration, drive: &Drive) {
        // An unknown temperature is replaced by the lowest one.
        let temperature = drive.heated_celsius().unwrap_or(f64::NEG_INFINITY);
        self.peak_celsius = self.peak_celsius.max(temperature);
        let output = drive.output();
        let is_heated = output != 0.0;
        if is_heated == self.is_heated && now < self.next {
            return;
        }
        if now >= self.next {
            self.next = now + PERIOD;
        }
        self.is_heated = is_heated;
        self.message.set(&self.current, output);
        self.message.set(&self.peak_temperature, self.peak_celsius);
        self.message.set(&self.time, now.as_secs_f64());
        self.waiting.push(self.message.frame());
        self.peak_celsius = temperature;
    }

    pub(crate) fn next_frame(&mut self) -> Option<CanFrame> {
        (!self.waiting.is_empty()).then(|| self.waiting.remove(0))
    }

    pub(crate) fn next_deadline(&self) -> Duration {
        self.next
    }
}
