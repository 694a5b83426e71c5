//! The `[bus]` table.

use std::time::Duration;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The bus and its cycle.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Bus {
    /// Bit rate of the bus.
    #[schemars(extend("enum" = [10, 20, 50, 125, 250, 500, 800, 1000]))]
    pub bitrate_kilobits_per_second: u32,
    /// Time between two SYNCs, a multiple of 0.1 ms.
    #[schemars(range(min = 0.1, max = 100.0), extend("x-multiple-of" = 0.1))]
    pub sync_period_milliseconds: f64,
    /// Number of cycles between two frames with the set-point of a loop, which the bench sends; 0 for no such frames. If absent 1
    /// where the controller is a program or external, else 0.
    #[schemars(range(min = 0, max = 100))]
    pub set_points_every_cycles: Option<u8>,
}

impl Default for Bus {
    fn default() -> Self {
        Self {
            bitrate_kilobits_per_second: 1000,
            sync_period_milliseconds: 1.0,
            set_points_every_cycles: None,
        }
    }
}

impl Bus {
    /// Returns the time between two SYNCs.
    pub fn sync_period(&self) -> Duration {
        // The schema admits multiples of 0.1 ms; rounding removes the error of the decimal fraction.
        let tenths = libm::round(self.sync_period_milliseconds * 10.0).clamp(1.0, 1000.0);
        Duration::from_micros(100).mul_f64(tenths)
    }
}

/// Returns the scenario time at which a cycle begins: the number that its decimal in a file is, since it is rounded once.
#[inline]
pub fn cycle_start_seconds(cycle: u64, period: Duration) -> f64 {
    cycle.saturating_mul(nanos(period)) as f64 / 1e9
}

/// Returns the nearest whole number of periods.
pub fn nearest_cycle(time: Duration, period: Duration) -> u64 {
    let period = nanos(period).max(1);
    nanos(time).saturating_add(period / 2) / period
}

fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cycle_begins_at_the_time_that_a_file_gives_it() {
        for tenths in 1..=1000 {
            for cycle in (0..60).chain(1118..1130).chain(59_990..60_000) {
                let place = cycle * tenths;
                let written = format!("{}.{:04}", place / 10_000, place % 10_000);
                let begin = cycle_start_seconds(cycle, Duration::from_micros(100 * tenths));
                assert_eq!(written.parse(), Ok(begin), "{cycle} of {tenths}");
            }
        }
    }
}
