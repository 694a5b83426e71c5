//! The drive profile CiA 402: the power state machine, statusword, option codes, modes and limits, as pure functions
//! and states for both ends of the bus.
//!
//! The drive at hand has no moving mass: its output is a current, and every ramp to standstill is the step to 0. So in
//! each state but Operation enabled the current is 0 at once, and the option codes decide only which state follows.

use std::time::Duration;

use crate::object_dictionary::{AbortCode, ObjectDictionary};

/// Object 0x6007: what to do when communication is lost.
pub const ABORT_CONNECTION_OPTION_CODE: u16 = 0x6007;
/// Object 0x6040.
pub const CONTROLWORD: u16 = 0x6040;
/// Object 0x6041.
pub const STATUSWORD: u16 = 0x6041;
/// Object 0x605A.
pub const QUICK_STOP_OPTION_CODE: u16 = 0x605A;
/// Object 0x605B.
pub const SHUTDOWN_OPTION_CODE: u16 = 0x605B;
/// Object 0x605C.
pub const DISABLE_OPERATION_OPTION_CODE: u16 = 0x605C;
/// Object 0x605D.
pub const HALT_OPTION_CODE: u16 = 0x605D;
/// Object 0x605E.
pub const FAULT_REACTION_OPTION_CODE: u16 = 0x605E;
/// Object 0x6060.
pub const MODES_OF_OPERATION: u16 = 0x6060;
/// Object 0x6061.
pub const MODES_OF_OPERATION_DISPLAY: u16 = 0x6061;
/// Object 0x6502: bit n - 1 stands for mode n.
pub const SUPPORTED_DRIVE_MODES: u16 = 0x6502;

/// Mode of operation 10: cyclic synchronous torque.
pub const CYCLIC_SYNCHRONOUS_TORQUE: i8 = 10;

/// The states of the power state machine (CiA 402-2, figure 7).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[expect(missing_docs, reason = "the names are the standard's")]
pub enum State {
    NotReadyToSwitchOn,
    SwitchOnDisabled,
    ReadyToSwitchOn,
    SwitchedOn,
    OperationEnabled,
    QuickStopActive,
    FaultReactionActive,
    Fault,
}

impl State {
    /// Bits 0 to 3, 5 and 6 of the statusword (CiA 402-2, table 30).
    fn status_bits(self) -> u16 {
        match self {
            Self::NotReadyToSwitchOn => 0x00,
            Self::SwitchOnDisabled => 0x40,
            Self::ReadyToSwitchOn => 0x21,
            Self::SwitchedOn => 0x23,
            Self::OperationEnabled => 0x27,
            Self::QuickStopActive => 0x07,
            Self::FaultReactionActive => 0x0F,
            Self::Fault => 0x08,
        }
    }

    /// The state that a statusword tells; `None` for a pattern that the standard does not know.
    #[must_use]
    pub fn from_statusword(statusword: u16) -> Option<Self> {
        Some(match (statusword & 0x4F, statusword & 0x20 != 0) {
            (0x00, _) => Self::NotReadyToSwitchOn,
            (0x40, _) => Self::SwitchOnDisabled,
            (0x01, true) => Self::ReadyToSwitchOn,
            (0x03, true) => Self::SwitchedOn,
            (0x07, true) => Self::OperationEnabled,
            (0x07, false) => Self::QuickStopActive,
            (0x0F, _) => Self::FaultReactionActive,
            (0x08, _) => Self::Fault,
            _ => return None,
        })
    }

    /// The controlword that brings a drive in this state one step nearer to Operation enabled; a fault is reset.
    #[must_use]
    pub fn controlword_towards_operation(self) -> u16 {
        match self {
            Self::NotReadyToSwitchOn | Self::FaultReactionActive | Self::QuickStopActive => 0x00,
            Self::SwitchOnDisabled => Command::Shutdown.controlword(),
            Self::ReadyToSwitchOn => Command::SwitchOn.controlword(),
            Self::SwitchedOn | Self::OperationEnabled => Command::EnableOperation.controlword(),
            Self::Fault => Command::FaultReset.controlword(),
        }
    }
}

/// The commands in a controlword (CiA 402-2, table 27).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names are the standard's")]
pub enum Command {
    Shutdown,
    /// In Operation enabled the same bits mean "disable operation".
    SwitchOn,
    EnableOperation,
    DisableVoltage,
    QuickStop,
    FaultReset,
}

impl Command {
    /// The command in bits 0 to 3; fault reset is an edge and found by [`StateMachine::on_controlword`].
    #[must_use]
    pub fn decode(controlword: u16) -> Self {
        match controlword & 0x0F {
            bits if bits & 0b0010 == 0 => Self::DisableVoltage,
            bits if bits & 0b0100 == 0 => Self::QuickStop,
            bits if bits & 0b0001 == 0 => Self::Shutdown,
            bits if bits & 0b1000 == 0 => Self::SwitchOn,
            _ => Self::EnableOperation,
        }
    }

    /// The controlword that gives the command.
    #[must_use]
    pub fn controlword(self) -> u16 {
        match self {
            Self::Shutdown => 0x06,
            Self::SwitchOn => 0x07,
            Self::EnableOperation => 0x0F,
            Self::DisableVoltage => 0x00,
            Self::QuickStop => 0x02,
            Self::FaultReset => 0x80,
        }
    }
}

const FAULT_RESET_BIT: u16 = 1 << 7;
const HALT_BIT: u16 = 1 << 8;

/// The option codes 0x6007 and 0x605A to 0x605E.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OptionCodes {
    /// 0x605A: 0, 1 or 2 lead to Switch on disabled; 5 or 6 stay in Quick stop active.
    pub quick_stop: i16,
    /// 0x6007: 1 fault, 2 disable voltage, 3 quick stop.
    pub abort_connection: i16,
}

impl Default for OptionCodes {
    fn default() -> Self {
        Self {
            quick_stop: 2,
            abort_connection: 1,
        }
    }
}

impl OptionCodes {
    /// The codes of a dictionary; the standard's defaults where it has none.
    #[must_use]
    pub fn read(dictionary: &ObjectDictionary) -> Self {
        let get = |index, default| {
            let value = dictionary.integer(index, 0).map(i16::try_from);
            value.and_then(Result::ok).unwrap_or(default)
        };
        let default = Self::default();
        Self {
            quick_stop: get(QUICK_STOP_OPTION_CODE, default.quick_stop),
            abort_connection: get(ABORT_CONNECTION_OPTION_CODE, default.abort_connection),
        }
    }

    /// Whether an option code may be written. 0x6007 = 0 ("no action") is refused: without its manager the drive must
    /// not go on heating. Ramps at current or voltage limit make no sense here and are refused too.
    ///
    /// # Errors
    /// [`AbortCode::INVALID_VALUE`].
    pub fn check(index: u16, value: i16) -> Result<(), AbortCode> {
        let is_known = match index {
            QUICK_STOP_OPTION_CODE => matches!(value, 0 | 1 | 2 | 5 | 6),
            SHUTDOWN_OPTION_CODE | DISABLE_OPERATION_OPTION_CODE => matches!(value, 0 | 1),
            HALT_OPTION_CODE => matches!(value, 1 | 2),
            FAULT_REACTION_OPTION_CODE => matches!(value, 0..=2),
            ABORT_CONNECTION_OPTION_CODE => matches!(value, 1..=3),
            _ => true,
        };
        if is_known {
            Ok(())
        } else {
            Err(AbortCode::INVALID_VALUE)
        }
    }
}

/// Whether a mode of operation may be chosen: one that 0x6502 names, or 0 for none.
///
/// # Errors
/// [`AbortCode::INVALID_VALUE`].
pub fn check_mode(mode: i8, supported_drive_modes: u32) -> Result<(), AbortCode> {
    let bit = match mode {
        0 => return Ok(()),
        1..=32 => u32::from(mode.unsigned_abs()) - 1,
        _ => return Err(AbortCode::INVALID_VALUE),
    };
    if supported_drive_modes >> bit & 1 == 1 {
        Ok(())
    } else {
        Err(AbortCode::INVALID_VALUE)
    }
}

/// What the statusword tells beside the state (CiA 402-2, table 29).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// Bit 4: the power stage has its supply.
    pub is_voltage_enabled: bool,
    /// Bit 7: something is near its limit.
    pub has_warning: bool,
    /// Bit 9: the controlword is obeyed; false while the node is not Operational.
    pub is_remote: bool,
    /// Bit 11: a limit cuts the command.
    pub is_limit_active: bool,
    /// Mode of operation (0x6061); bit 12 depends on it.
    pub mode: i8,
}

/// The power state machine of a drive.
///
/// Current may flow only while [`StateMachine::is_current_allowed`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StateMachine {
    state: State,
    controlword: u16,
}

impl Default for StateMachine {
    fn default() -> Self {
        Self::new()
    }
}

impl StateMachine {
    /// A machine after transitions 0 and 1: self-test and initialisation need no time here.
    #[must_use]
    pub fn new() -> Self {
        Self {
            state: State::SwitchOnDisabled,
            controlword: 0,
        }
    }

    /// The state.
    #[must_use]
    pub fn state(&self) -> State {
        self.state
    }

    /// True when the drive may follow its target: Operation enabled and no halt.
    #[must_use]
    pub fn is_current_allowed(&self) -> bool {
        self.state == State::OperationEnabled && self.controlword & HALT_BIT == 0
    }

    /// Obeys a controlword that has taken effect. `is_fault_present` keeps a fault from being reset.
    pub fn on_controlword(
        &mut self,
        controlword: u16,
        codes: &OptionCodes,
        is_fault_present: bool,
    ) {
        let rising = controlword & !self.controlword;
        self.controlword = controlword;
        if self.state == State::Fault {
            if rising & FAULT_RESET_BIT != 0 && !is_fault_present {
                self.state = State::SwitchOnDisabled; // 15
            }
            return;
        }
        self.obey(Command::decode(controlword), codes);
    }

    /// Obeys at once what takes energy away in a controlword that waits for its SYNC; the rest waits.
    pub fn on_waiting_controlword(&mut self, controlword: u16, codes: &OptionCodes) {
        let command = Command::decode(controlword);
        if self.state == State::OperationEnabled && command != Command::EnableOperation {
            self.obey(command, codes);
        }
        self.controlword |= controlword & HALT_BIT;
    }

    /// Transitions 13 and 14: the reaction is the current's step to 0 and over at once.
    pub fn on_fault(&mut self) {
        self.state = State::Fault;
    }

    /// Disables at once, as for the command "disable voltage" (NMT stop, leaving Operational).
    pub fn disable(&mut self) {
        self.obey(Command::DisableVoltage, &OptionCodes::default());
    }

    /// Reacts to lost communication by 0x6007; false when the drive was not enabled and nothing had to be done.
    pub fn on_communication_loss(&mut self, codes: &OptionCodes) -> bool {
        let is_enabled = matches!(self.state, State::OperationEnabled | State::QuickStopActive);
        match codes.abort_connection {
            _ if !is_enabled => {}
            2 => self.obey(Command::DisableVoltage, codes),
            3 => self.obey(Command::QuickStop, codes),
            _ => self.on_fault(),
        }
        is_enabled
    }

    /// The statusword 0x6041.
    #[must_use]
    pub fn statusword(&self, status: &Status) -> u16 {
        let follows_target = status.mode == CYCLIC_SYNCHRONOUS_TORQUE && self.is_current_allowed();
        let bit = |number: u16, is_set: bool| u16::from(is_set) << number;
        self.state.status_bits()
            | bit(4, status.is_voltage_enabled)
            | bit(7, status.has_warning)
            | bit(9, status.is_remote)
            | bit(11, status.is_limit_active)
            | bit(12, follows_target)
    }

    /// Transitions 2 to 12 and 16 (CiA 402-2, figure 7 and table 26).
    fn obey(&mut self, command: Command, codes: &OptionCodes) {
        self.state = match (self.state, command) {
            (State::SwitchOnDisabled, Command::Shutdown) => State::ReadyToSwitchOn, // 2
            (State::ReadyToSwitchOn, Command::SwitchOn) => State::SwitchedOn,       // 3
            (State::ReadyToSwitchOn | State::SwitchedOn, Command::EnableOperation) => {
                State::OperationEnabled // 4, and 3 before it
            }
            (State::OperationEnabled, Command::SwitchOn) => State::SwitchedOn, // 5
            (State::SwitchedOn | State::OperationEnabled, Command::Shutdown) => {
                State::ReadyToSwitchOn // 6, 8
            }
            (
                State::ReadyToSwitchOn | State::SwitchedOn,
                Command::DisableVoltage | Command::QuickStop,
            ) => State::SwitchOnDisabled, // 7, 10
            (State::OperationEnabled | State::QuickStopActive, Command::DisableVoltage) => {
                State::SwitchOnDisabled // 9, 12
            }
            (State::OperationEnabled, Command::QuickStop) if stays(codes) => {
                State::QuickStopActive // 11
            }
            (State::OperationEnabled, Command::QuickStop) => State::SwitchOnDisabled, // 11, 12
            (State::QuickStopActive, Command::EnableOperation) => State::OperationEnabled, // 16
            (state, _) => state,
        };
    }
}

/// True when the quick stop option code keeps the drive in Quick stop active.
fn stays(codes: &OptionCodes) -> bool {
    matches!(codes.quick_stop, 5..=8)
}

/// Limits a target torque by 0x6072 maximum torque and 0x6073 maximum current, all in permille of the rated values
/// (0x6075, 0x6076). True when the limit cuts.
#[must_use]
pub fn limit_torque(target: i16, torque_max: u16, current_max: u16) -> (i16, bool) {
    let limit = i16::try_from(torque_max.min(current_max)).unwrap_or(i16::MAX);
    let limited = target.clamp(-limit, limit);
    (limited, limited != target)
}

/// The interpolation time period 0x60C2: `value` times ten to the power `exponent` seconds; `None` when it is 0 or
/// below a nanosecond or beyond a thousand seconds.
#[must_use]
pub fn interpolation_period(value: u8, exponent: i8) -> Option<Duration> {
    let nanoseconds_exponent = u32::try_from(i32::from(exponent) + 9).ok()?;
    let unit = 10_u64.checked_pow(nanoseconds_exponent)?;
    let nanoseconds = u64::from(value).checked_mul(unit)?;
    let is_usable = (1..=1_000_000_000_000).contains(&nanoseconds);
    is_usable.then(|| Duration::from_nanos(nanoseconds))
}
