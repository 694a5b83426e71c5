//! Rig files: the parts of the bench, and the hard limits of a real drive.
//!
//! A scenario defines the trial, a rig file the drives and plants for it.

pub mod drive;
pub mod limits;
pub mod nodes;
pub mod shipped;
#[cfg(test)]
mod tests;

use std::time::Duration;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::wiring::Wiring;

/// Steps of an emulated drive's sensor over its travel: assumed to be 10 bits, as in the shipped rig.
const STEPS_OF_TRAVEL: f64 = 1024.0;
/// Shortest time for the whole travel, if the node does not state its rate. Assumed: the paper's wire needs 0.2 s.
const TRAVEL_SECONDS: f64 = 0.12;

/// Description of a drive for the controller and the pre-flight: of a real one from its node in the rig file, or of an emulated one
/// from its wiring. The latter is described as if it were real, so that both are treated alike.
#[derive(Clone, Debug, PartialEq)]
pub struct RealDrive {
    /// Node-ID of the drive.
    pub node_id: u8,
    /// Mode of operation, written to 0x6060 before the drive is enabled: 10 is cyclic synchronous torque, negative modes are the
    /// maker's own.
    pub mode_of_operation: i8,
    /// Object of the current command.
    pub command: CommandObject,
    /// Object of the position.
    pub position: PositionObject,
    /// Object of the measured current; `object = ""` if the drive sends none.
    pub current: CurrentObject,
    /// Hard limits, which apply whatever a scenario says.
    pub limits: Limits,
    /// Times for which drive and controller wait for each other.
    pub timeouts: Timeouts,
    /// Checks of the drive before the first scenario.
    pub preflight: Preflight,
}

impl RealDrive {
    /// Makes a drive with these limits; all else is as for the emulated drive of the shipped rig.
    pub fn new(limits: Limits) -> Self {
        Self {
            node_id: 16,
            mode_of_operation: 10,
            command: CommandObject::default(),
            position: PositionObject::default(),
            current: CurrentObject::default(),
            limits,
            timeouts: Timeouts::default(),
            preflight: Preflight::default(),
        }
    }

    /// Returns the description of a drive that canrig emulates: its limits are those of its positions.
    pub fn emulated(wiring: &Wiring) -> Self {
        let (commands, plausible) = (wiring.amplifier.range(), &wiring.plausible);
        let [lowest, highest] = wiring.sensor.range();
        let travel = highest - lowest;
        let mut drive = Self::new(Limits {
            current_amperes: commands.largest(),
            min: plausible.min.unwrap_or(lowest),
            max: plausible.max.unwrap_or(highest),
            rate_max: plausible.rate_max.unwrap_or(travel / TRAVEL_SECONDS),
        });
        drive.node_id = wiring.drive().id();
        drive.command.units_per_ampere = commands.counts_per_unit;
        drive.current.units_per_ampere = commands.counts_per_unit;
        drive.position.increments_per_unit = wiring.sensor.counts_per_unit();
        drive.position.resolution = travel / STEPS_OF_TRAVEL;
        drive
    }
}

/// The object that takes the current command.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct CommandObject {
    /// Index and, if it is not 0, sub-index: "0x6071", "0x2345:01". An integer of 8, 16 or 32 bits.
    pub object: String,
    /// Units of the object for one ampere.
    #[schemars(range(min = 1e-6, max = 1e9))]
    pub units_per_ampere: f64,
}

impl Default for CommandObject {
    fn default() -> Self {
        Self {
            object: "0x6071".to_owned(),
            units_per_ampere: 1000.0,
        }
    }
}

/// The object that holds the position.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct PositionObject {
    /// Index and, if it is not 0, sub-index: "0x6064", "0x2345:01". An integer of 8, 16 or 32 bits.
    pub object: String,
    /// Increments of the object for one unit of the sensor; negative where the count falls as the position rises.
    #[schemars(range(min = -1e9, max = 1e9))]
    pub increments_per_unit: f64,
    /// The object's value at position 0.
    #[schemars(range(min = -2_147_483_648.0, max = 4_294_967_295.0))]
    pub increments_at_zero: f64,
    /// Step of the sensor (its LSB), in its unit; the pre-flight waits for five of them.
    #[schemars(range(min = 1e-6, max = 10_000.0))]
    pub resolution: f64,
}

impl Default for PositionObject {
    fn default() -> Self {
        Self {
            object: "0x6064".to_owned(),
            increments_per_unit: 1000.0,
            increments_at_zero: 0.0,
            resolution: 60.0 / 1024.0,
        }
    }
}

/// The object that holds the current.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct CurrentObject {
    /// Index and, if it is not 0, sub-index: "0x6078", "0x2345:01". An integer of 8, 16 or 32 bits.
    pub object: String,
    /// Units of the object for one ampere.
    #[schemars(range(min = 1e-6, max = 1e9))]
    pub units_per_ampere: f64,
}

impl Default for CurrentObject {
    fn default() -> Self {
        Self {
            object: "0x6078".to_owned(),
            units_per_ampere: 1000.0,
        }
    }
}

/// Hard limits, which hold whatever a scenario says: the controller keeps to them, and canrig stops the drive when they are
/// violated.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Largest current. The controller commands no more; more on the bus is a violation.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1000.0))]
    pub current_amperes: f64,
    /// Lowest position, in the sensor's unit; a little below 0, since a sensor at the stop has noise.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub min: f64,
    /// Highest position.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub max: f64,
    /// Fastest motion, in that unit per second, on average over 20 ms or two cycles.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1e9))]
    pub rate_max: f64,
}

/// Times for which nodes wait for each other.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Timeouts {
    /// The drive must be found and configured within this time.
    #[schemars(range(min = 1.0, max = 600.0))]
    pub bring_up_seconds: f64,
    /// The drive must answer each SDO within this time.
    #[schemars(range(min = 10, max = 10_000))]
    pub sdo_answer_milliseconds: u32,
    /// Heartbeat period that the drive is given (0x1017).
    #[schemars(range(min = 5, max = 10_000))]
    pub drive_heartbeat_milliseconds: u16,
    /// The drive counts as lost when it has sent no heartbeat for this time.
    #[schemars(range(min = 10, max = 60_000))]
    pub drive_lost_milliseconds: u16,
    /// The drive stops by itself when it has not heard the controller's heartbeat for this time (0x1016).
    #[schemars(range(min = 50, max = 60_000))]
    pub controller_lost_milliseconds: u16,
    /// Cycles without a position after which the controller stops the drive.
    #[schemars(range(min = 1, max = 1000))]
    pub missing_positions_cycles: u32,
}

impl Default for Timeouts {
    fn default() -> Self {
        Self {
            bring_up_seconds: 10.0,
            sdo_answer_milliseconds: 500,
            drive_heartbeat_milliseconds: 20,
            drive_lost_milliseconds: 100,
            controller_lost_milliseconds: 100,
            missing_positions_cycles: 20,
        }
    }
}

/// Checks of the drive before the first scenario.
#[derive(Clone, Copy, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Preflight {
    /// Raise the current slowly until the load moves; `false` leaves this check out.
    pub heating: bool,
    /// Rate at which the current rises, from 0 to the limit of the rig at most.
    #[schemars(range(min = 0.001, max = 10.0))]
    pub ramp_amperes_per_second: f64,
    /// The load must move within this time.
    #[schemars(range(min = 0.1, max = 600.0))]
    pub heating_seconds_max: f64,
    /// The current must be gone within this time after a quick stop (assumed: 100).
    #[schemars(range(min = 1, max = 10_000))]
    pub stop_milliseconds_max: u32,
    /// Time for which the wire then cools before the first scenario (assumed: 5).
    #[schemars(range(min = 0.0, max = 600.0))]
    pub cooling_seconds: f64,
}

impl Default for Preflight {
    fn default() -> Self {
        Self {
            heating: true,
            ramp_amperes_per_second: 0.1,
            heating_seconds_max: 20.0,
            stop_milliseconds_max: 100,
            cooling_seconds: 5.0,
        }
    }
}

impl Timeouts {
    /// Returns the time within which the drive must be found and configured.
    pub fn bring_up(&self) -> Duration {
        Duration::from_secs_f64(self.bring_up_seconds.clamp(0.0, 600.0))
    }
}

/// Parses index and sub-index of an object, written as "0x6064" or "0x2345:01".
///
/// # Errors
/// With the expected form.
pub fn object_address(text: &str) -> Result<(u16, u8), &'static str> {
    const WANTED: &str =
        "must be index and, if not 0, sub-index, as in \"0x6064\" or \"0x2345:01\"";
    let digits = text.strip_prefix("0x").ok_or(WANTED)?;
    let (index, sub_index) = digits.split_once(':').unwrap_or((digits, "0"));
    let is_hexadecimal = |digits: &str| digits.bytes().all(|byte| byte.is_ascii_hexdigit());
    if index.len() != 4 || !is_hexadecimal(index) || !is_hexadecimal(sub_index) {
        return Err(WANTED);
    }
    let index = u16::from_str_radix(index, 16).map_err(|_| WANTED)?;
    let sub_index = u8::from_str_radix(sub_index, 16).map_err(|_| WANTED)?;
    Ok((index, sub_index))
}
