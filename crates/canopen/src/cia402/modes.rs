//! The modes of operation of CiA 402, a row each.
//!
//! In: the number of a mode (0x6060). Out: the mode's objects, limits and status bits, and the command that holds while there
//! is no value. Drives call it wherever their conduct depends on the mode, instead of comparing numbers.

/// Quantity that a mode commands, which is the level at which its target enters the cascade of loops.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Permille of the rated torque (0x6076): the loops of velocity and position are idle.
    Torque,
    /// Increments per second: the position loop is idle.
    Velocity,
    /// Increments: all loops work.
    Position,
}

/// Source of the commands between two targets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Generator {
    /// The master sends a target each period.
    Cyclic,
    /// The drive moves to the target with its own ramps.
    Profile,
}

/// Meaning of bit 12 of the statusword.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bit12 {
    /// The drive follows the target; 0 if it ignores the target.
    FollowsTarget,
    /// The drive has taken the set-point over.
    SetPointAcknowledge,
    /// The speed is 0.
    SpeedIsZero,
    /// Reserved.
    None,
}

/// Command of an enabled drive that has received no value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WithoutValue {
    /// 0: the target is a torque or a velocity.
    Zero,
    /// The last target; before the first one the actual position.
    HoldTarget,
}

/// A mode of operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mode {
    /// Value of 0x6060.
    pub id: i8,
    /// Name in messages.
    pub word: &'static str,
    /// Quantity that the mode commands.
    pub level: Level,
    /// Source of the commands between two targets.
    pub generator: Generator,
    /// Object of the target.
    pub target: u16,
    /// Object of the demand, which is the target behind ramps and limits.
    pub demand: u16,
    /// Object of the actual value.
    pub actual: u16,
    /// Objects that limit the target or the demand.
    pub limits: &'static [u16],
    /// Whether bit 10 of the statusword means "target reached"; else it is reserved.
    pub has_target_reached: bool,
    /// Meaning of bit 12 of the statusword.
    pub bit_12: Bit12,
    /// Whether bit 13 of the statusword means "following error"; else it is 0.
    pub has_following_error: bool,
    /// Command without a value.
    pub without_value: WithoutValue,
}

/// Mode of operation 10: cyclic synchronous torque.
pub const CYCLIC_SYNCHRONOUS_TORQUE: i8 = 10;

const TORQUE_LIMITS: &[u16] = &[0x6072, 0x6073];
const VELOCITY_LIMITS: &[u16] = &[0x607F, 0x60C5, 0x60C6, 0x6072, 0x6073];
const POSITION_LIMITS: &[u16] = &[0x607D, 0x607F, 0x60C5, 0x60C6, 0x6072, 0x6073];
const CYCLIC_POSITION_LIMITS: &[u16] = &[0x607D, 0x607F, 0x6072, 0x6073];

const TORQUE: Mode = Mode {
    id: 4,
    word: "profile torque",
    level: Level::Torque,
    generator: Generator::Profile,
    target: 0x6071,
    demand: 0x6074,
    actual: 0x6077,
    limits: TORQUE_LIMITS,
    has_target_reached: true,
    bit_12: Bit12::None,
    has_following_error: false,
    without_value: WithoutValue::Zero,
};

const VELOCITY: Mode = Mode {
    id: 3,
    word: "profile velocity",
    level: Level::Velocity,
    target: 0x60FF,
    demand: 0x606B,
    actual: 0x606C,
    limits: VELOCITY_LIMITS,
    bit_12: Bit12::SpeedIsZero,
    ..TORQUE
};

const POSITION: Mode = Mode {
    id: 1,
    word: "profile position",
    level: Level::Position,
    target: 0x607A,
    demand: 0x6062,
    actual: 0x6064,
    limits: POSITION_LIMITS,
    bit_12: Bit12::SetPointAcknowledge,
    has_following_error: true,
    without_value: WithoutValue::HoldTarget,
    ..TORQUE
};

/// Returns the mode with the level's objects whose targets come each period.
const fn cyclic(id: i8, word: &'static str, profile: Mode) -> Mode {
    Mode {
        id,
        word,
        generator: Generator::Cyclic,
        has_target_reached: false,
        bit_12: Bit12::FollowsTarget,
        ..profile
    }
}

/// The modes.
pub static MODES: [Mode; 6] = [
    POSITION,
    VELOCITY,
    TORQUE,
    Mode {
        limits: CYCLIC_POSITION_LIMITS,
        ..cyclic(8, "cyclic synchronous position", POSITION)
    },
    cyclic(9, "cyclic synchronous velocity", VELOCITY),
    cyclic(
        CYCLIC_SYNCHRONOUS_TORQUE,
        "cyclic synchronous torque",
        TORQUE,
    ),
];

impl Mode {
    /// Returns the row of a value of 0x6060; `None` for no mode (0) and for modes without a row.
    pub fn find(id: i8) -> Option<&'static Self> {
        MODES.iter().find(|mode| mode.id.eq(&id))
    }

    /// Returns the bit of the mode in 0x6502.
    pub fn supported_bit(&self) -> u32 {
        1 << (self.id - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_mode_is_found_by_its_number_alone() {
        for mode in &MODES {
            assert_eq!(Mode::find(mode.id), Some(mode));
        }
        for id in [i8::MIN, -1, 0, 2, 5, 6, 7, 11, i8::MAX] {
            assert_eq!(Mode::find(id), None, "{id}");
        }
    }

    /// Objects by CiA 402-2: target, demand and actual value of a mode have one unit.
    #[test]
    fn the_objects_of_a_mode_belong_to_its_level() {
        for mode in &MODES {
            let objects = (mode.target, mode.demand, mode.actual);
            let expected = match mode.level {
                Level::Torque => (0x6071, 0x6074, 0x6077),
                Level::Velocity => (0x60FF, 0x606B, 0x606C),
                Level::Position => (0x607A, 0x6062, 0x6064),
            };
            assert_eq!(objects, expected, "{}", mode.word);
            let is_held = mode.without_value == WithoutValue::HoldTarget;
            assert_eq!(is_held, mode.level == Level::Position, "{}", mode.word);
            assert!(mode.limits.ends_with(TORQUE_LIMITS), "{}", mode.word);
        }
    }

    #[test]
    fn the_bits_of_0x6502_are_those_of_the_standard() {
        let all = MODES.iter().map(Mode::supported_bit).sum::<u32>();
        assert_eq!(all, 0x38D);
    }
}
