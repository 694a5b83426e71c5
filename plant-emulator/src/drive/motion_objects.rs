//! Objects of the drive that only the modes that move use.
//!
//! In: the dictionary. Out: [`Settings`] in increments and seconds, and the demands and actual values that are stored there. The
//! drive reads them once a step, so that a value that is written acts from the next step on.

use std::time::Duration;

use canopen::ObjectDictionary;
use canopen::object_dictionary::{DataType, Handle, Preset};

use super::demand::Ramps;
use super::loops::Gains;
use super::motion::Shown;
use crate::InvalidEmulator;
use crate::amplifier::Amplifier;
use crate::objects::{self, SIGNED_16, rounded_16, rounded_i32};

/// Object of the target position.
pub(super) const TARGET_POSITION: u16 = 0x607A;
/// Maker's object of loop period and gains.
const LOOPS: u16 = 0x2120;
/// Value of 0x6065 and 0x6067 that turns the window off.
const NO_WINDOW: f64 = u32::MAX as f64;
/// Fixed-point steps of the gains in 0x2120.
const GAIN_STEPS: f64 = 1e3;
/// Increments per second to which the velocity gain in 0x2120 refers.
const GAIN_SPEED: f64 = 1e6;

/// Loop period and gains of a drive, the defaults of 0x2120. They suit the DC motor that ships: a velocity loop of 100 rad/s, a
/// position loop of a quarter of that, and an integral time of 4/100 s.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct LoopConfig {
    /// An integer divisor of the SYNC period.
    pub(crate) loop_period_microseconds: u32,
    /// In 0.001/s.
    pub(crate) position_gain: u32,
    /// Permille of the rated torque for 10^6 increments per second.
    pub(crate) velocity_gain: u32,
    /// 0 for none.
    pub(crate) integral_time_microseconds: u32,
}

impl Default for LoopConfig {
    fn default() -> Self {
        Self {
            loop_period_microseconds: 1000,
            position_gain: 25_000,
            velocity_gain: 7500,
            integral_time_microseconds: 40_000,
        }
    }
}

impl LoopConfig {
    /// Returns the values of the entries of 0x2120.
    pub(crate) fn presets(&self) -> [Preset; 4] {
        let values = [
            (1, self.loop_period_microseconds),
            (2, self.position_gain),
            (3, self.velocity_gain),
            (4, self.integral_time_microseconds),
        ];
        values.map(|(sub_index, value)| Preset::new(LOOPS, sub_index, value.into()))
    }
}

/// Handles of the objects.
#[derive(Clone, Debug)]
pub(super) struct MotionObjects {
    following_window: Handle,
    following_time: Handle,
    position_window: Handle,
    position_window_time: Handle,
    velocity_window: Handle,
    velocity_window_time: Handle,
    speed_zero: Handle,
    speed_zero_time: Handle,
    pub(super) target_position: Handle,
    target_velocity: Handle,
    travel: [Handle; 2],
    speed_max: Handle,
    profile_speed: Handle,
    acceleration: Handle,
    deceleration: Handle,
    quick_stop: Handle,
    acceleration_max: Handle,
    deceleration_max: Handle,
    velocity_offset: Handle,
    torque_offset: Handle,
    positioning_option_code: Handle,
    interpolation: [Handle; 2],
    torque_limits: [Handle; 2],
    loops: [Handle; 4],
    position_demands: [Handle; 2],
    velocity_demand: Handle,
    velocity: Handle,
    torque_demand: Handle,
    following_error: Handle,
}

impl MotionObjects {
    pub(super) fn find(dictionary: &ObjectDictionary) -> Result<Self, InvalidEmulator> {
        use DataType::{Integer8, Integer16, Integer32, Unsigned8, Unsigned16, Unsigned32};
        let sub =
            |index, sub_index, data_type| objects::find(dictionary, index, sub_index, data_type);
        let at = |index, data_type| sub(index, 0, data_type);
        let one_of_loops = |sub_index| sub(LOOPS, sub_index, Unsigned32);
        Ok(Self {
            following_window: at(0x6065, Unsigned32)?,
            following_time: at(0x6066, Unsigned16)?,
            position_window: at(0x6067, Unsigned32)?,
            position_window_time: at(0x6068, Unsigned16)?,
            velocity_window: at(0x606D, Unsigned16)?,
            velocity_window_time: at(0x606E, Unsigned16)?,
            speed_zero: at(0x606F, Unsigned16)?,
            speed_zero_time: at(0x6070, Unsigned16)?,
            target_position: at(TARGET_POSITION, Integer32)?,
            target_velocity: at(0x60FF, Integer32)?,
            travel: [sub(0x607D, 1, Integer32)?, sub(0x607D, 2, Integer32)?],
            speed_max: at(0x607F, Unsigned32)?,
            profile_speed: at(0x6081, Unsigned32)?,
            acceleration: at(0x6083, Unsigned32)?,
            deceleration: at(0x6084, Unsigned32)?,
            quick_stop: at(0x6085, Unsigned32)?,
            acceleration_max: at(0x60C5, Unsigned32)?,
            deceleration_max: at(0x60C6, Unsigned32)?,
            velocity_offset: at(0x60B1, Integer32)?,
            torque_offset: at(0x60B2, Integer16)?,
            positioning_option_code: at(0x60F2, Unsigned16)?,
            interpolation: [sub(0x60C2, 1, Unsigned8)?, sub(0x60C2, 2, Integer8)?],
            torque_limits: [at(0x6072, Unsigned16)?, at(0x6073, Unsigned16)?],
            loops: [
                one_of_loops(1)?,
                one_of_loops(2)?,
                one_of_loops(3)?,
                one_of_loops(4)?,
            ],
            position_demands: [at(0x6062, Integer32)?, at(0x60FC, Integer32)?],
            velocity_demand: at(0x606B, Integer32)?,
            velocity: at(0x606C, Integer32)?,
            torque_demand: at(0x6074, Integer16)?,
            following_error: at(0x60F4, Integer32)?,
        })
    }

    /// Reads the settings. The torque is also limited by what the amplifier can give.
    pub(super) fn settings(
        &self,
        dictionary: &ObjectDictionary,
        amplifier: &Amplifier,
    ) -> Settings {
        #[expect(clippy::cast_precision_loss, reason = "at most 32 bits")]
        let get = |handle| dictionary.entry(handle).as_integer() as f64;
        let milliseconds = |handle| Duration::from_secs_f64(get(handle) / 1e3);
        let window = |handle| match get(handle) {
            NO_WINDOW => f64::INFINITY,
            width => width,
        };
        let [value, index] = self.interpolation;
        let [period, position_gain, velocity_gain, integral] = self.loops;
        let [torque, current] = self.torque_limits.map(get);
        let most = torque.min(current);
        let [lowest, highest] = amplifier.range_permille();
        Settings {
            loop_period: Duration::from_secs_f64(get(period) / 1e6),
            gains: Gains {
                position_per_second: get(position_gain) / GAIN_STEPS,
                velocity: get(velocity_gain) / GAIN_SPEED,
                integral_seconds: get(integral) / 1e6,
            },
            torque_limits: [(-most).max(lowest).min(0.0), most.min(highest).max(0.0)],
            following_window: window(self.following_window),
            following_time: milliseconds(self.following_time),
            position_window: window(self.position_window),
            position_window_time: milliseconds(self.position_window_time),
            velocity_window: get(self.velocity_window),
            velocity_window_time: milliseconds(self.velocity_window_time),
            speed_zero: get(self.speed_zero),
            speed_zero_time: milliseconds(self.speed_zero_time),
            target_position: get(self.target_position),
            target_velocity: get(self.target_velocity),
            travel: self.travel.map(get),
            speed_max: get(self.speed_max),
            profile_speed: get(self.profile_speed),
            acceleration: get(self.acceleration),
            deceleration: get(self.deceleration),
            quick_stop: get(self.quick_stop),
            acceleration_max: get(self.acceleration_max),
            deceleration_max: get(self.deceleration_max),
            velocity_offset: get(self.velocity_offset),
            torque_offset: get(self.torque_offset),
            positioning_option_code: dictionary
                .entry(self.positioning_option_code)
                .as_integer()
                .try_into()
                .unwrap_or_default(),
            interpolation_seconds: get(value) * libm::pow(10.0, get(index)),
        }
    }

    /// Stores the demands and the actual values.
    pub(super) fn show(&self, dictionary: &mut ObjectDictionary, shown: &Shown) {
        let mut store = |handle, value: f64| {
            objects::store(dictionary, handle, &rounded_i32(value).to_le_bytes());
        };
        let [demand, internal] = self.position_demands;
        store(demand, shown.position_demand);
        store(internal, shown.position_demand);
        store(self.velocity_demand, shown.velocity_demand);
        store(self.velocity, shown.velocity);
        store(self.following_error, shown.following_error);
        let torque = rounded_16(shown.torque_permille, SIGNED_16);
        objects::store(dictionary, self.torque_demand, &torque);
    }

    /// Stores the torque demand of a mode of torque.
    pub(super) fn show_torque(&self, dictionary: &mut ObjectDictionary, permille: i16) {
        objects::store(dictionary, self.torque_demand, &permille.to_le_bytes());
    }

    /// Returns the loop period.
    pub(super) fn loop_period(&self, dictionary: &ObjectDictionary) -> Duration {
        let microseconds = dictionary.entry(self.loops[0]).as_integer();
        Duration::from_micros(microseconds.try_into().unwrap_or_default())
    }
}

/// Values of the objects, in increments, seconds and permille of the rated torque.
#[derive(Clone, Copy, Debug)]
pub(super) struct Settings {
    pub(super) loop_period: Duration,
    pub(super) gains: Gains,
    pub(super) torque_limits: [f64; 2],
    pub(super) following_window: f64,
    pub(super) following_time: Duration,
    pub(super) position_window: f64,
    pub(super) position_window_time: Duration,
    pub(super) velocity_window: f64,
    pub(super) velocity_window_time: Duration,
    pub(super) speed_zero: f64,
    pub(super) speed_zero_time: Duration,
    pub(super) target_position: f64,
    pub(super) target_velocity: f64,
    travel: [f64; 2],
    pub(super) speed_max: f64,
    profile_speed: f64,
    acceleration: f64,
    deceleration: f64,
    quick_stop: f64,
    acceleration_max: f64,
    deceleration_max: f64,
    pub(super) velocity_offset: f64,
    pub(super) torque_offset: f64,
    pub(super) positioning_option_code: u16,
    pub(super) interpolation_seconds: f64,
}

impl Settings {
    /// Limits a target position by 0x607D; the flag is true if the limit cuts. Two zeros are no limits, and limits that are
    /// the wrong way round have no effect.
    pub(super) fn within_travel(&self, target: f64) -> (f64, bool) {
        let [min, max] = self.travel;
        if min >= max {
            return (target, false);
        }
        let within = target.clamp(min, max);
        (within, within != target)
    }

    /// Returns the ramps of 0x6083 and 0x6084, up to the maximum speed.
    pub(super) fn profile_ramps(&self) -> Ramps {
        self.ramps(self.speed_max, self.acceleration, self.deceleration)
    }

    /// Returns the ramps of a move by profile position.
    pub(super) fn position_ramps(&self) -> Ramps {
        let speed = self.profile_speed.min(self.speed_max);
        self.ramps(speed, self.acceleration, self.deceleration)
    }

    /// Returns the ramps of a quick stop.
    pub(super) fn quick_stop_ramps(&self) -> Ramps {
        self.ramps(self.speed_max, self.acceleration, self.quick_stop)
    }

    /// Returns the steepest ramps.
    pub(super) fn cyclic_ramps(&self) -> Ramps {
        self.ramps(self.speed_max, f64::INFINITY, f64::INFINITY)
    }

    fn ramps(&self, speed: f64, acceleration: f64, deceleration: f64) -> Ramps {
        // The data sheet admits no 0, which would never end.
        Ramps {
            speed: speed.max(1.0),
            acceleration: acceleration.min(self.acceleration_max).max(1.0),
            deceleration: deceleration.min(self.deceleration_max).max(1.0),
        }
    }
}
