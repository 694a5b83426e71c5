//! The drive profile CiA 402: the power state machine, statusword, option codes, modes and limits, as pure functions
//! and states for both ends of the bus.
//!
//! A drive whose mode commands a torque has no ramps: every stop is the step to 0, and the option codes decide only which
//! state follows. A drive that moves sets [`StateMachine::set_ramps`]: then a stop is a ramp, and the state that follows comes
//! when the drive reports [`StateMachine::on_standstill`].

mod modes;

pub use modes::{Bit12, CYCLIC_SYNCHRONOUS_TORQUE, Generator, Level, MODES, Mode, WithoutValue};

use crate::object_dictionary::{AbortCode, Accepted, ObjectDictionary};

/// Object 0x6007: reaction to the loss of communication.
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
/// Object 0x6502: bit n - 1 represents mode n.
pub const SUPPORTED_DRIVE_MODES: u16 = 0x6502;

/// The states of the power state machine (CiA 402-2, figure 7).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[expect(missing_docs, reason = "the names are the standard's")]
pub enum State {
    NotReadyToSwitchOn,
    /// State after transitions 0 and 1: self-test and initialisation need no time here.
    #[default]
    SwitchOnDisabled,
    ReadyToSwitchOn,
    SwitchedOn,
    OperationEnabled,
    QuickStopActive,
    FaultReactionActive,
    Fault,
}

impl State {
    /// Returns bits 0 to 3, 5 and 6 of the statusword (CiA 402-2, table 30).
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

    /// Returns the state in a statusword; `None` for a pattern that the standard does not know.
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

    /// Returns the controlword that brings a drive in this state one step nearer to Operation enabled. It resets a fault, which
    /// takes a rising edge of bit 7.
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

/// The commands in a controlword (CiA 402-2, table 27), with the controlwords that give them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
#[expect(missing_docs, reason = "the names are the standard's")]
pub enum Command {
    Shutdown = 0x06,
    /// In Operation enabled the same bits mean "disable operation".
    SwitchOn = 0x07,
    EnableOperation = 0x0F,
    DisableVoltage = 0x00,
    QuickStop = 0x02,
    FaultReset = 0x80,
}

impl Command {
    /// Returns the command in bits 0 to 3; fault reset is an edge, which [`StateMachine::on_controlword`] finds.
    pub fn decode(controlword: u16) -> Self {
        match controlword & 0x0F {
            bits if bits & 0b0010 == 0 => Self::DisableVoltage,
            bits if bits & 0b0100 == 0 => Self::QuickStop,
            bits if bits & 0b0001 == 0 => Self::Shutdown,
            bits if bits & 0b1000 == 0 => Self::SwitchOn,
            _ => Self::EnableOperation,
        }
    }

    /// Returns the controlword that gives the command.
    pub fn controlword(self) -> u16 {
        self as u16
    }
}

const FAULT_RESET_BIT: u16 = 1 << 7;
const HALT_BIT: u16 = 1 << 8;

/// The ramp of a stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ramp {
    /// 0x6084.
    SlowDown,
    /// 0x6085.
    QuickStop,
    /// As fast as the limits of torque and current allow.
    Limit,
}

impl Ramp {
    /// Returns the ramp that the option codes 0x605A, 0x605D and 0x605E number alike from 1 to 4; `None` for 0, which
    /// disables at once.
    fn of(code: i16) -> Option<Self> {
        match code {
            1 => Some(Self::SlowDown),
            2 => Some(Self::QuickStop),
            3 | 4 => Some(Self::Limit),
            _ => None,
        }
    }
}

/// The option codes 0x6007 and 0x605A to 0x605E.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OptionCodes {
    /// 0x605A: 0 to 4 lead to Switch on disabled; 5 to 8 stay in Quick stop active.
    pub quick_stop: i16,
    /// 0x605B: 1 slows down before it disables.
    pub shutdown: i16,
    /// 0x605C: 1 slows down before it disables.
    pub disable_operation: i16,
    /// 0x605D.
    pub halt: i16,
    /// 0x605E.
    pub fault_reaction: i16,
    /// 0x6007: 1 fault, 2 disable voltage, 3 quick stop.
    pub abort_connection: i16,
}

impl Default for OptionCodes {
    fn default() -> Self {
        Self {
            quick_stop: 2,
            shutdown: 0,
            disable_operation: 1,
            halt: 1,
            fault_reaction: 2,
            abort_connection: 1,
        }
    }
}

impl OptionCodes {
    /// Reads the codes of a dictionary; the standard's defaults if it has none.
    pub fn read(dictionary: &ObjectDictionary) -> Self {
        let get = |index, default| {
            let value = dictionary.integer(index, 0).map(i16::try_from);
            value.and_then(Result::ok).unwrap_or(default)
        };
        let default = Self::default();
        Self {
            quick_stop: get(QUICK_STOP_OPTION_CODE, default.quick_stop),
            shutdown: get(SHUTDOWN_OPTION_CODE, default.shutdown),
            disable_operation: get(DISABLE_OPERATION_OPTION_CODE, default.disable_operation),
            halt: get(HALT_OPTION_CODE, default.halt),
            fault_reaction: get(FAULT_REACTION_OPTION_CODE, default.fault_reaction),
            abort_connection: get(ABORT_CONNECTION_OPTION_CODE, default.abort_connection),
        }
    }

    /// Returns the ramp of a quick stop; 5 to 8 are the ramps of 1 to 4.
    fn quick_stop_ramp(&self) -> Option<Ramp> {
        Ramp::of(if self.stays_in_quick_stop() {
            self.quick_stop - 4
        } else {
            self.quick_stop
        })
    }

    /// Checks whether the drive stays in Quick stop active after a quick stop.
    fn stays_in_quick_stop(&self) -> bool {
        matches!(self.quick_stop, 5..=8)
    }

    /// Checks whether an option code may be written. 0x6007 = 0 ("no action") is refused: without its manager the drive must not
    /// go on driving.
    ///
    /// # Errors
    /// [`AbortCode::INVALID_VALUE`].
    pub fn check(index: u16, value: i16) -> Accepted {
        let is_known = match index {
            QUICK_STOP_OPTION_CODE => matches!(value, 0..=8),
            SHUTDOWN_OPTION_CODE | DISABLE_OPERATION_OPTION_CODE => matches!(value, 0 | 1),
            HALT_OPTION_CODE => matches!(value, 1..=4),
            FAULT_REACTION_OPTION_CODE => matches!(value, 0..=4),
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

/// Checks whether a mode of operation may be chosen: one that 0x6502 names, or 0 for none.
///
/// # Errors
/// [`AbortCode::INVALID_VALUE`].
pub fn check_mode(mode: i8, supported_drive_modes: u32) -> Accepted {
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

/// Bits of the statusword other than the state (CiA 402-2, table 29).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// Bit 4: the power stage has its supply.
    pub is_voltage_enabled: bool,
    /// Bit 7: a value is near its limit.
    pub has_warning: bool,
    /// Bit 9: the controlword is obeyed; false while the node is not Operational.
    pub is_remote: bool,
    /// Bit 11: a limit cuts the command.
    pub is_limit_active: bool,
    /// Mode of operation (0x6061), which decides the meaning of bits 10, 12 and 13.
    pub mode: i8,
    /// Bit 10 in modes that have a target to reach.
    pub is_target_reached: bool,
    /// Bit 12 in modes that acknowledge a set-point.
    pub is_set_point_acknowledged: bool,
    /// Bit 12 in modes that report a speed of 0.
    pub is_speed_zero: bool,
    /// Bit 13 in modes that have a following error.
    pub has_following_error: bool,
}

/// Motion that the power stage allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// No current.
    Off,
    /// The drive follows its target.
    Follow,
    /// The drive comes to a standstill by this ramp, and stands under power.
    Stop(Ramp),
}

/// A stop that has not come to its end, and the state that follows at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stop {
    ramp: Ramp,
    then: State,
}

/// The power state machine of a drive.
///
/// A torque may be commanded only while [`StateMachine::is_current_allowed`]; with ramps, [`StateMachine::motion`] says more.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StateMachine {
    state: State,
    controlword: u16,
    has_ramps: bool,
    stop: Option<Stop>,
}

impl StateMachine {
    /// Returns the state.
    pub fn state(&self) -> State {
        self.state
    }

    /// Sets whether a stop takes a ramp. Without ramps a stop that is under way is over.
    pub fn set_ramps(&mut self, has_ramps: bool) {
        self.has_ramps = has_ramps;
        if !has_ramps {
            self.on_standstill();
        }
    }

    /// Checks whether the drive may follow its target: Operation enabled, no halt and no stop under way.
    pub fn is_current_allowed(&self) -> bool {
        self.state == State::OperationEnabled
            && self.stop.is_none()
            && self.controlword & HALT_BIT == 0
    }

    /// Checks whether a stop is under way.
    pub fn is_stopping(&self) -> bool {
        self.stop.is_some()
    }

    /// Checks whether the power stage is on. In a mode of torque no current flows in a stop all the same.
    pub fn is_powered(&self) -> bool {
        matches!(
            self.state,
            State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive
        )
    }

    /// Returns what a drive with ramps may do.
    pub fn motion(&self, codes: &OptionCodes) -> Motion {
        if let Some(Stop { ramp, .. }) = self.stop {
            return Motion::Stop(ramp);
        }
        match self.state {
            State::OperationEnabled if self.controlword & HALT_BIT == 0 => Motion::Follow,
            State::OperationEnabled => Motion::Stop(Ramp::of(codes.halt).unwrap_or(Ramp::SlowDown)),
            State::QuickStopActive => Motion::Stop(Ramp::QuickStop),
            _ => Motion::Off,
        }
    }

    /// Ends the stop that is under way: the drive stands still.
    pub fn on_standstill(&mut self) {
        if let Some(Stop { then, .. }) = self.stop.take() {
            self.state = then;
        }
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

    /// Obeys at once the orders that take energy away in a controlword that waits for its SYNC; the rest waits.
    pub fn on_waiting_controlword(&mut self, controlword: u16, codes: &OptionCodes) {
        let command = Command::decode(controlword);
        if self.state == State::OperationEnabled && command != Command::EnableOperation {
            self.obey(command, codes);
        }
        self.controlword |= controlword & HALT_BIT;
    }

    /// Transitions 13 and 14 at once, for a fault in which the drive cannot brake.
    pub fn on_fault(&mut self) {
        self.enter(State::Fault);
    }

    /// Transition 13, and 14 at standstill, by 0x605E. Without power it is over at once.
    pub fn react_to_fault(&mut self, codes: &OptionCodes) {
        match self.state {
            State::FaultReactionActive | State::Fault => {}
            _ if self.is_powered() => {
                let ramp = Ramp::of(codes.fault_reaction);
                self.begin_stop(ramp, State::FaultReactionActive, State::Fault);
            }
            _ => self.on_fault(),
        }
    }

    /// Disables at once, as for the command "disable voltage" (NMT stop, leaving Operational).
    pub fn disable(&mut self) {
        if self.state == State::FaultReactionActive {
            self.enter(State::Fault);
        }
        self.obey(Command::DisableVoltage, &OptionCodes::default());
    }

    /// Reacts to lost communication by 0x6007; false if the drive was not enabled, so that no reaction was needed.
    pub fn on_communication_loss(&mut self, codes: &OptionCodes) -> bool {
        let is_enabled = matches!(self.state, State::OperationEnabled | State::QuickStopActive);
        match codes.abort_connection {
            _ if !is_enabled => {}
            2 => self.obey(Command::DisableVoltage, codes),
            3 => self.obey(Command::QuickStop, codes),
            _ => self.react_to_fault(codes),
        }
        is_enabled
    }

    /// Returns the statusword 0x6041.
    pub fn statusword(&self, status: &Status) -> u16 {
        let bit = |number: u16, is_set: bool| u16::from(is_set) << number;
        let mut statusword = self.state.status_bits()
            | bit(4, status.is_voltage_enabled)
            | bit(7, status.has_warning)
            | bit(9, status.is_remote)
            | bit(11, status.is_limit_active);
        if let Some(mode) = Mode::find(status.mode) {
            let bit_12 = match mode.bit_12 {
                Bit12::FollowsTarget => self.is_current_allowed(),
                Bit12::SetPointAcknowledge => status.is_set_point_acknowledged,
                Bit12::SpeedIsZero => status.is_speed_zero,
                Bit12::None => false,
            };
            statusword |= bit(10, mode.has_target_reached && status.is_target_reached)
                | bit(12, bit_12)
                | bit(13, mode.has_following_error && status.has_following_error);
        }
        statusword
    }

    /// Transitions 2 to 12 and 16 (CiA 402-2, figure 7 and table 26).
    fn obey(&mut self, command: Command, codes: &OptionCodes) {
        use State::{
            OperationEnabled, QuickStopActive, ReadyToSwitchOn, SwitchOnDisabled, SwitchedOn,
        };
        let slow_down = |code| (code == 1).then_some(Ramp::SlowDown);
        match (self.state, command) {
            (SwitchOnDisabled, Command::Shutdown) => self.enter(ReadyToSwitchOn), // 2
            (ReadyToSwitchOn, Command::SwitchOn) => self.enter(SwitchedOn),       // 3
            // 4, and 3 before it; it also ends a stop that would have disabled.
            (ReadyToSwitchOn | SwitchedOn | OperationEnabled, Command::EnableOperation) => {
                self.enter(OperationEnabled);
            }
            (OperationEnabled, Command::SwitchOn) => {
                let ramp = slow_down(codes.disable_operation);
                self.begin_stop(ramp, OperationEnabled, SwitchedOn); // 5
            }
            (OperationEnabled, Command::Shutdown) => {
                let ramp = slow_down(codes.shutdown);
                self.begin_stop(ramp, OperationEnabled, ReadyToSwitchOn); // 8
            }
            (SwitchedOn, Command::Shutdown) => self.enter(ReadyToSwitchOn), // 6
            (ReadyToSwitchOn | SwitchedOn, Command::DisableVoltage | Command::QuickStop) => {
                self.enter(SwitchOnDisabled); // 7, 10
            }
            (OperationEnabled | QuickStopActive, Command::DisableVoltage) => {
                self.enter(SwitchOnDisabled); // 9, 12
            }
            (OperationEnabled, Command::QuickStop) => {
                let then = if codes.stays_in_quick_stop() {
                    QuickStopActive
                } else {
                    SwitchOnDisabled
                };
                self.begin_stop(codes.quick_stop_ramp(), QuickStopActive, then); // 11, 12
            }
            (QuickStopActive, Command::EnableOperation) if codes.stays_in_quick_stop() => {
                self.enter(OperationEnabled); // 16
            }
            _ => {}
        }
    }

    fn enter(&mut self, state: State) {
        self.state = state;
        self.stop = None;
    }

    /// Enters `then`: at once without a ramp, else at standstill after the state `meanwhile`.
    fn begin_stop(&mut self, ramp: Option<Ramp>, meanwhile: State, then: State) {
        match ramp.filter(|_| self.has_ramps) {
            Some(ramp) => {
                self.state = meanwhile;
                self.stop = Some(Stop { ramp, then });
            }
            None => self.enter(then),
        }
    }
}

/// Limits a target torque by 0x6072 maximum torque and 0x6073 maximum current, all in permille of the rated values (0x6075,
/// 0x6076). The flag is true if the limit cuts.
pub fn limit_torque(target: i16, torque_max: u16, current_max: u16) -> (i16, bool) {
    let limit = i16::try_from(torque_max.min(current_max)).unwrap_or(i16::MAX);
    let limited = target.clamp(-limit, limit);
    (limited, limited != target)
}

/// Returns the name of a mode of operation (CiA 402-2, 0x6060) whose command is a position or a speed; `None` for the modes of a
/// torque and of the maker, and for none.
pub fn mode_without_torque(mode: i8) -> Option<&'static str> {
    if let Some(row) = Mode::find(mode) {
        return (row.level != Level::Torque).then_some(row.word);
    }
    Some(match mode {
        2 => "velocity",
        6 => "homing",
        7 => "interpolated position",
        5 | 12.. => "which CiA 402 reserves",
        _ => return None,
    })
}

/// Returns the name of an object of CiA 402 that takes a position or a speed, of any axis of the drive: the objects of each further
/// axis are 0x800 above.
pub fn target_without_torque(index: u16) -> Option<&'static str> {
    const AXES: std::ops::RangeInclusive<u16> = 0x6000..=0x9FFF;
    if !AXES.contains(&index) {
        return None;
    }
    Some(match (index - AXES.start()) % 0x800 {
        0x42 => "vl target velocity",
        0x62 => "position demand value",
        0x6B => "velocity demand value",
        0x7A => "target position",
        0x7C => "home offset",
        0x81 => "profile velocity",
        0x82 => "end velocity",
        0x99 => "homing speed",
        0xB0 => "position offset",
        0xB1 => "velocity offset",
        0xC1 => "interpolation data record",
        0xFF => "target velocity",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use State::{
        Fault, OperationEnabled, QuickStopActive, ReadyToSwitchOn, SwitchOnDisabled, SwitchedOn,
    };

    const SHUTDOWN: u16 = 0x06;
    const SWITCH_ON: u16 = 0x07;
    const ENABLE: u16 = 0x0F;
    const DISABLE_VOLTAGE: u16 = 0x00;
    const QUICK_STOP: u16 = 0x02;
    const FAULT_RESET: u16 = 0x80;

    fn codes(quick_stop: i16, abort_connection: i16) -> OptionCodes {
        OptionCodes {
            quick_stop,
            abort_connection,
            ..OptionCodes::default()
        }
    }

    fn machine_in(state: State) -> StateMachine {
        StateMachine {
            state,
            ..StateMachine::default()
        }
    }

    /// Every state with every command, against the standard's table of transitions.
    #[test]
    fn all_transitions() {
        #[rustfmt::skip]
        let table = [
            // from, command, to with quick stop option code 2, to with 6
            (SwitchOnDisabled, SHUTDOWN, ReadyToSwitchOn, ReadyToSwitchOn),            // 2
            (SwitchOnDisabled, SWITCH_ON, SwitchOnDisabled, SwitchOnDisabled),
            (SwitchOnDisabled, ENABLE, SwitchOnDisabled, SwitchOnDisabled),
            (SwitchOnDisabled, DISABLE_VOLTAGE, SwitchOnDisabled, SwitchOnDisabled),
            (SwitchOnDisabled, QUICK_STOP, SwitchOnDisabled, SwitchOnDisabled),
            (ReadyToSwitchOn, SHUTDOWN, ReadyToSwitchOn, ReadyToSwitchOn),
            (ReadyToSwitchOn, SWITCH_ON, SwitchedOn, SwitchedOn),                      // 3
            (ReadyToSwitchOn, ENABLE, OperationEnabled, OperationEnabled),             // 3, 4
            (ReadyToSwitchOn, DISABLE_VOLTAGE, SwitchOnDisabled, SwitchOnDisabled),    // 7
            (ReadyToSwitchOn, QUICK_STOP, SwitchOnDisabled, SwitchOnDisabled),         // 7
            (SwitchedOn, SHUTDOWN, ReadyToSwitchOn, ReadyToSwitchOn),                  // 6
            (SwitchedOn, SWITCH_ON, SwitchedOn, SwitchedOn),
            (SwitchedOn, ENABLE, OperationEnabled, OperationEnabled),                  // 4
            (SwitchedOn, DISABLE_VOLTAGE, SwitchOnDisabled, SwitchOnDisabled),         // 10
            (SwitchedOn, QUICK_STOP, SwitchOnDisabled, SwitchOnDisabled),              // 10
            (OperationEnabled, SHUTDOWN, ReadyToSwitchOn, ReadyToSwitchOn),            // 8
            (OperationEnabled, SWITCH_ON, SwitchedOn, SwitchedOn),                     // 5
            (OperationEnabled, ENABLE, OperationEnabled, OperationEnabled),
            (OperationEnabled, DISABLE_VOLTAGE, SwitchOnDisabled, SwitchOnDisabled),   // 9
            (OperationEnabled, QUICK_STOP, SwitchOnDisabled, QuickStopActive),         // 11, 12
            (QuickStopActive, SHUTDOWN, QuickStopActive, QuickStopActive),
            (QuickStopActive, SWITCH_ON, QuickStopActive, QuickStopActive),
            (QuickStopActive, ENABLE, QuickStopActive, OperationEnabled),              // 16
            (QuickStopActive, DISABLE_VOLTAGE, SwitchOnDisabled, SwitchOnDisabled),    // 12
            (QuickStopActive, QUICK_STOP, QuickStopActive, QuickStopActive),
            (Fault, SHUTDOWN, Fault, Fault),
            (Fault, SWITCH_ON, Fault, Fault),
            (Fault, ENABLE, Fault, Fault),
            (Fault, DISABLE_VOLTAGE, Fault, Fault),
            (Fault, QUICK_STOP, Fault, Fault),
            (Fault, FAULT_RESET, SwitchOnDisabled, SwitchOnDisabled),                  // 15
        ];
        for (from, controlword, to, to_with_6) in table {
            for (quick_stop, to) in [(2, to), (6, to_with_6)] {
                let mut machine = machine_in(from);
                machine.on_controlword(controlword, &codes(quick_stop, 1), false);
                assert_eq!(machine.state(), to, "{from:?} by {controlword:#04x}");
            }
        }
    }

    fn moving(state: State) -> StateMachine {
        StateMachine {
            has_ramps: true,
            ..machine_in(state)
        }
    }

    /// Each stop with each value of its option code: the ramp, the state in it and the state at its end.
    #[test]
    fn a_stop_with_a_ramp_ends_at_standstill_and_not_before() {
        use Ramp::{Limit, QuickStop, SlowDown};
        let default = OptionCodes::default();
        let ramps = [SlowDown, QuickStop, Limit, Limit];
        for (code, ramp) in (1..).zip(ramps) {
            for (quick_stop, then) in [(code, SwitchOnDisabled), (code + 4, QuickStopActive)] {
                let codes = codes(quick_stop, 1);
                let mut machine = moving(OperationEnabled);
                machine.on_controlword(QUICK_STOP, &codes, false);
                assert_eq!(machine.state(), QuickStopActive, "{quick_stop}");
                assert_eq!(machine.motion(&codes), Motion::Stop(ramp), "{quick_stop}");
                assert!(!machine.is_current_allowed());
                machine.on_standstill();
                assert_eq!(machine.state(), then, "{quick_stop}");
            }
            let codes = OptionCodes {
                fault_reaction: code,
                halt: code,
                ..default
            };
            let mut machine = moving(OperationEnabled);
            machine.on_controlword(ENABLE | HALT_BIT, &codes, false);
            assert_eq!(machine.motion(&codes), Motion::Stop(ramp), "halt {code}");
            machine.on_standstill();
            assert_eq!(machine.state(), OperationEnabled, "halt {code}");
            machine.react_to_fault(&codes);
            assert_eq!(machine.state(), State::FaultReactionActive, "{code}");
            assert_eq!(machine.motion(&codes), Motion::Stop(ramp), "{code}");
            machine.on_controlword(DISABLE_VOLTAGE, &codes, false);
            assert_eq!(machine.state(), State::FaultReactionActive, "no command");
            machine.on_standstill();
            assert_eq!(
                (machine.state(), machine.motion(&codes)),
                (Fault, Motion::Off)
            );
        }
        let slow = OptionCodes {
            shutdown: 1,
            disable_operation: 1,
            ..default
        };
        let at_once = OptionCodes {
            shutdown: 0,
            disable_operation: 0,
            ..default
        };
        for (controlword, then) in [(SHUTDOWN, ReadyToSwitchOn), (SWITCH_ON, SwitchedOn)] {
            let mut machine = moving(OperationEnabled);
            machine.on_controlword(controlword, &slow, false);
            assert_eq!(machine.state(), OperationEnabled);
            assert_eq!(machine.motion(&slow), Motion::Stop(SlowDown));
            machine.on_standstill();
            assert_eq!(machine.state(), then);
            let mut machine = moving(OperationEnabled);
            machine.on_controlword(controlword, &at_once, false);
            assert_eq!(machine.state(), then);
        }
    }

    #[test]
    fn the_code_0_disables_without_a_ramp() {
        let codes = OptionCodes {
            quick_stop: 0,
            fault_reaction: 0,
            ..OptionCodes::default()
        };
        let mut machine = moving(OperationEnabled);
        machine.on_controlword(QUICK_STOP, &codes, false);
        assert_eq!(machine.state(), SwitchOnDisabled);
        let mut machine = moving(OperationEnabled);
        machine.react_to_fault(&codes);
        assert_eq!(machine.state(), Fault);
    }

    #[test]
    fn a_stop_gives_way_to_harder_commands_and_to_enabling() {
        let codes = OptionCodes::default();
        let stopping = |controlword| {
            let mut machine = moving(OperationEnabled);
            machine.on_controlword(controlword, &codes, false);
            machine
        };
        let mut machine = stopping(SWITCH_ON);
        machine.on_controlword(QUICK_STOP, &codes, false);
        assert_eq!(machine.state(), QuickStopActive);
        let mut machine = stopping(SWITCH_ON);
        machine.on_controlword(ENABLE, &codes, false);
        assert_eq!(machine.motion(&codes), Motion::Follow);
        let mut machine = stopping(QUICK_STOP);
        machine.on_controlword(ENABLE, &codes, false);
        assert_eq!(machine.state(), QuickStopActive, "16 needs 5 to 8");
        machine.on_controlword(DISABLE_VOLTAGE, &codes, false);
        assert_eq!(machine.motion(&codes), Motion::Off);
        let mut machine = stopping(SWITCH_ON);
        machine.set_ramps(false);
        assert_eq!(machine.state(), SwitchedOn, "a mode without ramps");
    }

    #[test]
    fn the_usual_sequence_leads_to_operation_enabled() {
        let mut machine = StateMachine::default();
        let mut statusword = machine.statusword(&Status::default());
        for expected in [ReadyToSwitchOn, SwitchedOn, OperationEnabled] {
            let state = State::from_statusword(statusword).unwrap();
            let controlword = state.controlword_towards_operation();
            machine.on_controlword(controlword, &OptionCodes::default(), false);
            assert_eq!(machine.state(), expected);
            statusword = machine.statusword(&Status::default());
        }
        assert!(machine.is_current_allowed());
    }

    #[test]
    fn every_state_has_its_statusword_and_is_recognised() {
        for (state, bits) in [
            (State::NotReadyToSwitchOn, 0x00),
            (SwitchOnDisabled, 0x40),
            (ReadyToSwitchOn, 0x21),
            (SwitchedOn, 0x23),
            (OperationEnabled, 0x27),
            (QuickStopActive, 0x07),
            (State::FaultReactionActive, 0x0F),
            (Fault, 0x08),
        ] {
            let statusword = machine_in(state).statusword(&Status::default());
            assert_eq!(statusword & 0x6F, bits, "{state:?}");
            let noisy = statusword | 0xFF90;
            assert_eq!(State::from_statusword(noisy), Some(state));
        }
        assert_eq!(State::from_statusword(0x02), None);
    }

    #[test]
    fn statusword_bits_beside_the_state() {
        let machine = machine_in(OperationEnabled);
        let base = Status::default();
        #[rustfmt::skip]
        let cases = [
            (Status { is_voltage_enabled: true, ..base }, 1 << 4),
            (Status { has_warning: true, ..base }, 1 << 7),
            (Status { is_remote: true, ..base }, 1 << 9),
            (Status { is_limit_active: true, ..base }, 1 << 11),
            (Status { mode: CYCLIC_SYNCHRONOUS_TORQUE, ..base }, 1 << 12),
        ];
        for (status, bit) in cases {
            assert_eq!(machine.statusword(&status), 0x27 | bit);
        }
    }

    #[test]
    fn bit_12_says_in_torque_mode_whether_the_drive_follows_its_target() {
        let status = Status {
            mode: CYCLIC_SYNCHRONOUS_TORQUE,
            ..Status::default()
        };
        let follows = |machine: &StateMachine| machine.statusword(&status) & 1 << 12 != 0;
        let mut machine = machine_in(SwitchedOn);
        assert!(!follows(&machine));
        machine.on_controlword(ENABLE, &OptionCodes::default(), false);
        assert!(follows(&machine));
        machine.on_controlword(ENABLE | HALT_BIT, &OptionCodes::default(), false);
        assert!(!follows(&machine), "halt");
    }

    #[test]
    fn fault_reset_needs_an_edge_and_the_fault_to_be_gone() {
        let codes = OptionCodes::default();
        let mut machine = machine_in(OperationEnabled);
        machine.on_controlword(ENABLE | FAULT_RESET, &codes, false);
        assert_eq!(machine.state(), OperationEnabled);
        machine.on_fault();
        assert!(!machine.is_current_allowed());
        machine.on_controlword(FAULT_RESET, &codes, false);
        assert_eq!(machine.state(), Fault, "no edge");
        machine.on_controlword(0, &codes, false);
        machine.on_controlword(FAULT_RESET, &codes, true);
        assert_eq!(machine.state(), Fault, "still there");
        machine.on_controlword(0, &codes, false);
        machine.on_controlword(FAULT_RESET | ENABLE, &codes, false);
        assert_eq!(machine.state(), SwitchOnDisabled);
    }

    #[test]
    fn a_waiting_controlword_can_only_take_the_current_away() {
        for controlword in 0..=u16::from(u8::MAX) {
            for state in [
                SwitchOnDisabled,
                ReadyToSwitchOn,
                SwitchedOn,
                QuickStopActive,
                Fault,
            ] {
                let mut machine = machine_in(state);
                machine.on_waiting_controlword(controlword, &OptionCodes::default());
                assert_eq!(machine.state(), state, "{controlword:#04x}");
            }
            let mut machine = machine_in(OperationEnabled);
            machine.on_waiting_controlword(controlword, &OptionCodes::default());
            let goes_on = controlword & 0x0F == ENABLE;
            assert_eq!(machine.is_current_allowed(), goes_on, "{controlword:#04x}");
        }
    }

    #[test]
    fn halt_acts_on_arrival_and_ends_with_the_next_controlword() {
        let codes = OptionCodes::default();
        let mut machine = machine_in(OperationEnabled);
        machine.on_waiting_controlword(ENABLE | HALT_BIT, &codes);
        assert!(!machine.is_current_allowed());
        assert_eq!(machine.state(), OperationEnabled);
        machine.on_controlword(ENABLE, &codes, false);
        assert!(machine.is_current_allowed());
    }

    #[test]
    fn abort_connection_option_code_decides_the_state_after_a_loss() {
        for (abort_connection, state) in [(1, Fault), (2, SwitchOnDisabled), (3, QuickStopActive)] {
            let mut machine = machine_in(OperationEnabled);
            assert!(machine.on_communication_loss(&codes(6, abort_connection)));
            assert_eq!(machine.state(), state);
            assert!(!machine.is_current_allowed());
        }
        let mut machine = machine_in(SwitchedOn);
        assert!(!machine.on_communication_loss(&codes(2, 1)));
        assert_eq!(machine.state(), SwitchedOn);
    }

    #[test]
    fn any_abort_connection_option_code_takes_the_current_away() {
        for abort_connection in [i16::MIN, -1, 0, 4, i16::MAX] {
            let mut machine = machine_in(OperationEnabled);
            machine.on_communication_loss(&codes(2, abort_connection));
            assert!(!machine.is_current_allowed(), "{abort_connection}");
        }
    }

    #[test]
    fn disable_acts_in_every_state_and_keeps_a_fault() {
        for state in [
            ReadyToSwitchOn,
            SwitchedOn,
            OperationEnabled,
            QuickStopActive,
        ] {
            let mut machine = machine_in(state);
            machine.disable();
            assert_eq!(machine.state(), SwitchOnDisabled);
        }
        let mut machine = machine_in(Fault);
        machine.disable();
        assert_eq!(machine.state(), Fault);
    }

    #[test]
    fn option_codes_without_meaning_here_are_refused() {
        for (index, good) in [
            (QUICK_STOP_OPTION_CODE, &[0, 1, 2, 3, 4, 5, 6, 7, 8][..]),
            (SHUTDOWN_OPTION_CODE, &[0, 1]),
            (DISABLE_OPERATION_OPTION_CODE, &[0, 1]),
            (HALT_OPTION_CODE, &[1, 2, 3, 4]),
            (FAULT_REACTION_OPTION_CODE, &[0, 1, 2, 3, 4]),
            (ABORT_CONNECTION_OPTION_CODE, &[1, 2, 3]),
        ] {
            for value in -2..10 {
                let is_ok = OptionCodes::check(index, value).is_ok();
                assert_eq!(is_ok, good.contains(&value), "{index:#06x} = {value}");
            }
        }
    }

    #[test]
    fn only_the_modes_of_0x6502_are_accepted() {
        let only_torque = 1 << 9;
        for mode in i8::MIN..=i8::MAX {
            let is_ok = check_mode(mode, only_torque).is_ok();
            assert_eq!(is_ok, matches!(mode, 0 | 10), "{mode}");
        }
        assert_eq!(check_mode(8, only_torque), Err(AbortCode::INVALID_VALUE));
    }

    #[test]
    fn torque_is_limited_by_the_smaller_of_0x6072_and_0x6073() {
        assert_eq!(limit_torque(900, 1000, 1000), (900, false));
        assert_eq!(limit_torque(900, 800, 1000), (800, true));
        assert_eq!(limit_torque(-900, 1000, 700), (-700, true));
        assert_eq!(limit_torque(i16::MIN, 65535, 65535), (-i16::MAX, true));
    }

    #[test]
    fn option_codes_come_from_the_dictionary_or_the_standard() {
        use crate::object_dictionary::{Access, DataType, Entry};
        let mut dictionary = ObjectDictionary::new();
        assert_eq!(OptionCodes::read(&dictionary), codes(2, 1));
        for (index, value) in [(0x605A, 6), (0x6007, 3)] {
            let (kind, access) = (DataType::Integer16, Access::ReadWrite);
            dictionary.insert(Entry::new(index, 0, "code", kind, access, vec![value, 0]));
        }
        assert_eq!(OptionCodes::read(&dictionary), codes(6, 3));
    }
}
