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

/// Returns the scenario time at which a cycle begins, the same for a law, a judge and a reader.
pub fn cycle_start_seconds(cycle: u64, period_seconds: f64) -> f64 {
    cycle as f64 * period_seconds
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cycle_begins_not_before_the_time_that_a_file_gives_it() {
        for cycle in 0..60_000 {
            let written = format!("{}.{:03}", cycle / 1000, cycle % 1000);
            let written: f64 = written.parse().unwrap();
            assert!(cycle_start_seconds(cycle, 1e-3) >= written, "{cycle}");
        }
    }
}
