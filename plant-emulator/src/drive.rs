//! The drive, node 0x10 (CiA 402): samples the position, and follows its targets in the mode of operation that is chosen.
//!
//! In the modes of torque it applies the current at SYNC. In the modes of position and velocity it closes its own loops
//! ([`motion`]), on its own clock and at SYNC, so that ramps and stops go on without SYNC.
//!
//! A command that follows from the sample of one SYNC acts from the next SYNC on: one cycle of delay. The current falls
//! to 0 on any event that disables the drive, and by the drive's own timer when communication is lost.
//!
//! An active drive holds the plant that it is wired to. It advances the plant before it samples, before the current or
//! a disturbance changes, and by a deadline of its own. Frames that only wait for a SYNC do not touch the physics.

mod clock;
mod demand;
mod interpolation;
mod loops;
mod motion;
mod motion_objects;
mod objects;
mod set_points;
mod window;

use std::time::Duration;

use canopen::cia402::{self, Generator, Level, Mode, OptionCodes, State, StateMachine, Status};
use canopen::emcy::ErrorCode;
use canopen::pdo::WaitingPdo;
use canopen::sync::Sync;
use canopen::{
    AbortCode, Application, CommunicationLoss, NmtCommand, NmtState, ObjectDictionary, Services,
};
use dbc::loops::drive_seed;
use scenario::Trial;
use scenario::plant::TARGET_TORQUE;

use clock::LoopClock;
use motion::Motion;
pub(crate) use motion_objects::LoopConfig;
use motion_objects::{MotionObjects, TARGET_POSITION};
use objects::Objects;
pub(crate) use objects::first_values;

use crate::InvalidEmulator;
use crate::amplifier::Amplifier;
use crate::clocked_plant::ClockedPlant;
use crate::faults::RigFaults;
use crate::sensor::PositionSensor;
use crate::thermal_protection::ThermalProtection;
use crate::wires::Wires;

/// Longest pause between two SYNCs (assumed). In it a wire at 1 A warms by less than 10 °C. If the host does not run
/// the manager for some milliseconds, there is no fault.
pub const SYNC_TIMEOUT: Duration = Duration::from_millis(50);

/// Utilisation of the I²t protection above which the statusword warns, and below which a trip may be reset.
const WARNING_UTILISATION: f64 = 0.9;

/// Time for which the current may deviate from its command (assumed) before the drive reports a fault of its amplifier.
const CURRENT_DEVIATION_TIME_MAX: Duration = Duration::from_millis(100);

/// The application of the drive, around its object dictionary.
#[derive(Debug)]
pub struct Drive {
    objects: Objects,
    machine: StateMachine,
    sensor: PositionSensor,
    amplifier: Amplifier,
    protection: ThermalProtection,
    /// The plant with its inputs and the time, while this drive holds it; else empty, and its time is 0. So a drive is advanced,
    /// disturbed and given a current only while it holds the plant.
    pub(crate) plant: ClockedPlant,
    /// Ports of the plant for amplifier and sensor.
    wires: Wires,
    /// Time of the overload integral and of the plant.
    followed: Duration,
    /// Faults of sensor, amplifier and plant.
    pub(crate) faults: RigFaults,
    /// Command of the amplifier.
    commanded: f64,
    /// Start of the present deviation of the current from its command.
    deviates_since: Option<Duration>,
    /// Longest time without an advance of the plant. The next SYNC advances it, so this is longer than a SYNC may be
    /// late. Otherwise a busy machine, which delays SYNCs, would cause itself more work.
    idle_max: Duration,
    /// Option codes; they are read again after a possible write.
    codes: Option<OptionCodes>,
    /// Whether a limit cuts the target.
    is_limit_active: bool,
    /// Whether the latest command was beyond the limits of its object, and was cut to them on reception.
    is_command_cut: bool,
    is_stop_asked: bool,
    /// Row of the mode of operation, and the value of 0x6060 to which it belongs.
    row: (i8, Option<&'static Mode>),
    motion: Motion,
    motion_objects: MotionObjects,
    clock: LoopClock,
    has_followed_badly: bool,
}

impl Drive {
    /// Makes the drive with the objects of a dictionary; it does not hold its plant yet. The sensor's noise follows from
    /// the seed.
    ///
    /// # Errors
    /// The dictionary lacks an object.
    pub(crate) fn new(
        trial: &Trial,
        wires: Wires,
        dictionary: &ObjectDictionary,
    ) -> Result<Self, InvalidEmulator> {
        let objects = Objects::find(dictionary, &wires)?;
        let wiring = &trial.wiring;
        let seed = drive_seed(trial.run.seed, wiring.nodes.drive.id);
        Ok(Self {
            machine: StateMachine::default(),
            sensor: PositionSensor::new(&trial.sensor, wires.sensor_unit, seed)
                .from(wiring.sensor.min * wires.sensor_unit),
            amplifier: Amplifier::new(&trial.amplifier),
            protection: ThermalProtection::new(objects.protection_limits(dictionary)),
            plant: ClockedPlant::default(),
            faults: RigFaults::new(trial, wires.sensor_unit, seed),
            wires,
            followed: Duration::ZERO,
            commanded: 0.0,
            deviates_since: None,
            idle_max: SYNC_TIMEOUT.max(trial.run.bus.sync_period() * 3 / 2),
            codes: None,
            is_limit_active: false,
            is_command_cut: false,
            is_stop_asked: false,
            row: (0, None),
            motion: Motion::new(),
            motion_objects: MotionObjects::find(dictionary)?,
            clock: LoopClock::default(),
            has_followed_badly: false,
            objects,
        })
    }

    /// Returns the output of the amplifier.
    pub(crate) fn output(&self) -> f64 {
        self.plant.input(self.wires.input) / self.wires.input_per_output
    }

    /// Returns the temperature of the part that the output heats.
    pub(crate) fn heated_celsius(&self) -> Option<f64> {
        self.plant.heated_celsius(self.wires.input)
    }

    /// Sets an input of the plant from now on, for another node.
    pub(crate) fn disturb(&mut self, input: usize, value: f64) {
        if self.plant.input(input) != value {
            self.advance();
            self.plant.set_input(input, value);
        }
    }

    /// Takes over the rig of a drive that reboots, as after power-on.
    pub(crate) fn wire_to_rig_of(&mut self, worn: &mut Self) {
        std::mem::swap(&mut self.plant, &mut worn.plant);
        std::mem::swap(&mut self.faults, &mut worn.faults);
        std::mem::swap(&mut self.sensor, &mut worn.sensor);
        (self.followed, self.commanded) = (worn.followed, worn.commanded);
    }

    /// Returns the next time at which a fault of the rig begins or ends.
    pub(crate) fn next_fault(&self) -> Option<Duration> {
        self.faults.next_change(self.followed)
    }

    /// Advances the rig, even if the node is silent, and lets its faults begin and end.
    pub(crate) fn follow(&mut self) {
        self.set_output(self.commanded);
        self.advance();
    }

    /// Returns the time by which the plant must be advanced, by the emulator's own clock.
    pub(crate) fn next_advance(&self) -> Duration {
        self.followed + self.idle_max
    }

    /// Sets the command of the amplifier.
    pub(crate) fn set_output(&mut self, commanded: f64) {
        let now = self.plant.now;
        self.commanded = commanded;
        let input = self.wires.input;
        let mut output = commanded;
        if self.faults.plant_faults(now).is_some() {
            self.advance();
        }
        if let Some((faults, time_seconds)) = self.faults.plant_faults(now) {
            self.plant.set_condition(input, faults, time_seconds);
            output = if self.plant.conducts(input) {
                self.faults.output(now, commanded)
            } else {
                0.0
            };
        }
        if self.plant.failure().is_some() {
            output = 0.0;
        }
        self.disturb(input, output * self.wires.input_per_output);
    }

    /// Advances the plant and the overload integral.
    fn advance(&mut self) {
        let now = self.plant.now;
        let elapsed = now.saturating_sub(self.followed);
        let output = self.output();
        self.plant.advance_to(now);
        self.protection.advance(elapsed.as_secs_f64(), output);
        self.followed = self.followed.max(now);
    }

    /// Samples the sensors into the dictionary, and returns the position in increments.
    fn sample(&mut self, services: &mut Services) -> f64 {
        let now = self.plant.now;
        self.advance();
        let true_position = self.plant.output(self.wires.output);
        let sensor = &mut self.sensor;
        let convert = |position| sensor.sample(position);
        let counts = self.faults.sense(now, true_position, convert);
        let position = self.sensor.position(counts) * self.wires.counts_per_output;
        let permille = self.amplifier.permille(self.output());
        let dictionary = services.dictionary_mut();
        self.objects.set_position(dictionary, position);
        self.objects.set_truth(dictionary, &self.wires, &self.plant);
        self.objects.set_output(dictionary, permille);
        self.objects
            .set_utilisation(dictionary, self.protection.utilisation());
        position
    }

    /// Returns the row of the mode of operation.
    fn row(&mut self, services: &Services) -> Option<&'static Mode> {
        let id = self.objects.mode(services.dictionary());
        if self.row.0 != id {
            self.row = (id, Mode::find(id));
        }
        self.row.1
    }

    /// Returns the row of a mode whose loops the drive closes.
    fn moving_row(&mut self, services: &Services) -> Option<&'static Mode> {
        let row = self.row(services);
        row.filter(|row| !matches!(row.level, Level::Torque))
    }

    /// Tells the power stage whether stops have ramps, and starts or ends the clock of the loops.
    fn take_mode(&mut self, services: &Services) {
        let is_moving = self.moving_row(services).is_some();
        self.machine.set_ramps(is_moving);
        if !is_moving {
            self.motion.leave();
            let is_profile = |row: &Mode| matches!(row.generator, Generator::Profile);
            if !self.row.1.is_some_and(is_profile) {
                self.clock = LoopClock::default();
            }
        } else if self.clock.next.is_none() {
            self.clock.next = Some(services.now());
        }
    }

    /// Takes a step of the loops, or applies the torque in a mode without loops.
    fn act(&mut self, services: &mut Services, position: f64) {
        match self.moving_row(services) {
            Some(row) => self.step_loops(services, row, position),
            None => self.apply(services),
        }
    }

    /// Takes a step of the loops.
    fn step_loops(&mut self, services: &mut Services, row: &'static Mode, position: f64) {
        let codes = self.codes(services);
        self.machine.set_ramps(true);
        if self.machine.state() != State::OperationEnabled {
            self.motion.forget_set_points();
        }
        let is_able = !self.is_stop_asked && self.plant.failure().is_none();
        let allowed = if is_able {
            self.machine.motion(&codes)
        } else {
            cia402::Motion::Off
        };
        let settings = (self.motion_objects).settings(services.dictionary(), &self.amplifier);
        let now = services.now();
        let torque = (self.motion).step(now, row, allowed, &settings, position);
        let output = self.amplifier.output(rounded_permille(torque));
        self.set_output(if allowed == cia402::Motion::Off {
            0.0
        } else {
            output
        });
        let status = self.motion.status();
        self.is_limit_active = status.is_limit_active;
        if row.has_following_error && status.has_following_error && !self.has_followed_badly {
            self.has_followed_badly = true;
            self.machine.react_to_fault(&codes);
            services.raise_error(ErrorCode::FOLLOWING_ERROR, [0; 5]);
        } else if status.is_standing && matches!(allowed, cia402::Motion::Stop(_)) {
            self.machine.on_standstill();
            if services.nmt_state() != NmtState::Operational {
                self.machine.disable();
            }
        }
        let shown = self.motion.shown();
        self.motion_objects.show(services.dictionary_mut(), &shown);
    }

    /// Applies the target torque, if it is allowed.
    fn apply(&mut self, services: &mut Services) {
        if !self.may_drive(services) {
            return;
        }
        let (limited, is_cut) = self.objects.limited_torque(services.dictionary());
        self.is_limit_active = is_cut || self.is_command_cut || self.amplifier.clips(limited);
        let output = self.amplifier.output(limited);
        self.set_output(output);
        (self.motion_objects).show_torque(services.dictionary_mut(), limited);
    }

    /// Checks whether a mode of torque may command a current.
    fn may_drive(&mut self, services: &Services) -> bool {
        !self.is_stop_asked
            && self.plant.failure().is_none()
            && services.nmt_state() == NmtState::Operational
            && self.machine.is_current_allowed()
            && self
                .row(services)
                .is_some_and(|row| matches!(row.level, Level::Torque))
    }

    /// Ends every call that may have changed the state: removes a current without permission, and updates the
    /// statusword.
    fn settle(&mut self, services: &mut Services) {
        self.take_mode(services);
        let is_moving = self.moving_row(services).is_some();
        let may_drive = if is_moving {
            self.machine.is_powered() && !self.is_stop_asked && self.plant.failure().is_none()
        } else {
            self.may_drive(services)
        };
        if !may_drive {
            self.set_output(0.0);
            self.is_limit_active = false;
            if !is_moving {
                (self.motion_objects).show_torque(services.dictionary_mut(), 0);
            }
        }
        let is_faulty = matches!(
            self.machine.state(),
            State::Fault | State::FaultReactionActive
        );
        if self.has_followed_badly && !is_faulty {
            self.has_followed_badly = false;
            services.clear_error(ErrorCode::FOLLOWING_ERROR);
        }
        let mode = self.objects.mode(services.dictionary());
        let mut status = Status {
            is_voltage_enabled: true,
            has_warning: self.protection.utilisation() >= WARNING_UTILISATION,
            is_remote: services.nmt_state() == NmtState::Operational,
            is_limit_active: self.is_limit_active,
            mode,
            is_target_reached: may_drive && !self.is_limit_active,
            ..Status::default()
        };
        if is_moving {
            let motion = self.motion.status();
            status.is_target_reached = motion.is_target_reached;
            status.is_speed_zero = motion.is_speed_zero;
            status.has_following_error = motion.has_following_error || self.has_followed_badly;
            status.is_set_point_acknowledged = self.motion.is_set_point_acknowledged();
        }
        let statusword = self.machine.statusword(&status);
        self.objects
            .set_status(services.dictionary_mut(), statusword, mode);
    }

    /// Settles after a PDO, which usually does not change machine and mode.
    fn settle_after(&mut self, before: StateMachine, services: &mut Services) {
        if self.machine != before || self.objects.is_mode_new(services.dictionary()) {
            self.settle(services);
        }
    }

    /// Reports a fault if the current deviates from its command for some time. The fault is over when the deviation is.
    fn supervise_output(&mut self, services: &mut Services) {
        let deviation = self.output() - self.commanded;
        if deviation.abs() <= self.amplifier.deviation_max() {
            self.deviates_since = None;
            services.clear_error(ErrorCode::HARDWARE);
            return;
        }
        let now = self.plant.now;
        let since = *self.deviates_since.get_or_insert(now);
        if now.saturating_sub(since) >= CURRENT_DEVIATION_TIME_MAX {
            self.machine.on_fault();
            services.raise_error(ErrorCode::HARDWARE, [0; 5]);
        }
    }

    /// Reports a fault if the I²t protection trips. The fault is over when the load is well below the limit.
    fn protect(&mut self, services: &mut Services) {
        self.supervise_output(services);
        let may_heat = self.machine.is_current_allowed()
            || self.moving_row(services).is_some() && self.machine.is_powered();
        if self.protection.is_tripped() && may_heat {
            self.machine.on_fault();
            services.raise_error(ErrorCode::THERMAL_OVERLOAD, [0; 5]);
        } else if self.protection.utilisation() < WARNING_UTILISATION {
            services.clear_error(ErrorCode::THERMAL_OVERLOAD);
        }
    }

    /// Plans that a profile torque acts without a SYNC, once the value is stored.
    fn apply_on_arrival(&mut self, services: &Services) {
        let is_profile = |row: &Mode| {
            matches!(
                (row.level, row.generator),
                (Level::Torque, Generator::Profile)
            )
        };
        if self.row(services).is_some_and(is_profile) {
            self.clock.next = Some(services.now());
        }
    }

    fn codes(&mut self, services: &Services) -> OptionCodes {
        *self
            .codes
            .get_or_insert_with(|| OptionCodes::read(services.dictionary()))
    }

    fn obey(&mut self, controlword: u16, services: &Services) {
        let codes = self.codes(services);
        let is_fault_present =
            self.protection.utilisation() >= WARNING_UTILISATION || self.deviates_since.is_some();
        self.take_mode(services);
        self.machine
            .on_controlword(controlword, &codes, is_fault_present);
        if self.moving_row(services).is_some() {
            let settings = (self.motion_objects).settings(services.dictionary(), &self.amplifier);
            let is_enabled = self.machine.is_current_allowed();
            (self.motion).on_controlword(controlword, is_enabled, &settings);
        }
    }
}

/// Rounds a torque to the permille that the amplifier takes; 0 for NaN.
fn rounded_permille(torque: f64) -> i16 {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the cast saturates and makes 0 of NaN, which is what is wanted"
    )]
    let permille = torque.round() as i16;
    permille
}

impl Application for Drive {
    fn on_reset(&mut self, services: &mut Services, _reset: NmtCommand) {
        self.machine = StateMachine::default();
        self.motion = Motion::new();
        self.clock = LoopClock::default();
        self.is_command_cut = false;
        self.codes = None;
        let dictionary = services.dictionary();
        let limits = self.objects.protection_limits(dictionary);
        self.protection.set_limits(limits);
        services.set_sync_timeout_min(SYNC_TIMEOUT);
        self.settle(services);
    }

    fn on_nmt_state(&mut self, services: &mut Services, state: NmtState) {
        if state == NmtState::Operational {
            services.expect_heartbeats();
        } else if !self.machine.is_stopping() {
            self.machine.disable();
        }
        self.settle(services);
    }

    fn on_sync(&mut self, services: &mut Services, _sync: &Sync) {
        let position = self.sample(services);
        self.protect(services);
        self.act(services, position);
        if self.moving_row(services).is_some() {
            let period = self.motion_objects.loop_period(services.dictionary());
            self.clock.on_sync(services.now(), period);
        }
        self.settle(services);
    }

    fn on_rpdo(&mut self, services: &mut Services, number: u16) {
        self.is_command_cut = services.is_rpdo_cut(number);
        self.objects.refuse_mode(services.dictionary_mut());
        if self.moving_row(services).is_some()
            && services.is_in_rpdo(number, self.motion_objects.target_position)
        {
            self.motion.on_target();
        }
        let controlword = self.objects.controlword(services.dictionary());
        let before = self.machine;
        self.obey(controlword, services);
        self.settle_after(before, services);
        self.apply_on_arrival(services);
    }

    fn on_waiting_rpdo(&mut self, services: &mut Services, waiting: &WaitingPdo) {
        let dictionary = services.dictionary();
        if let Some(controlword) = self.objects.waiting_controlword(dictionary, waiting) {
            let codes = self.codes(services);
            self.take_mode(services);
            let before = self.machine;
            self.machine.on_waiting_controlword(controlword, &codes);
            self.settle_after(before, services);
        }
    }

    fn on_read(&mut self, services: &mut Services, index: u16, _sub_index: u8) {
        if matches!(index, 0x2101..=0x2107 | 0x2110 | 0x6064 | 0x6077 | 0x6078) {
            self.sample(services);
        }
    }

    fn on_write(
        &mut self,
        services: &mut Services,
        index: u16,
        _sub_index: u8,
        bytes: &[u8],
    ) -> Result<(), AbortCode> {
        self.codes = None;
        match (index, bytes) {
            (cia402::MODES_OF_OPERATION, &[mode]) => {
                objects::check_mode(services.dictionary(), mode.cast_signed())?;
            }
            // Bit 9 of the statusword then means "not remote", and no controlword is obeyed (CiA 402-2, table 29).
            (cia402::CONTROLWORD, _) if services.nmt_state() != NmtState::Operational => {
                return Err(AbortCode::DEVICE_STATE);
            }
            (cia402::CONTROLWORD, &[low, high]) => {
                self.obey(u16::from_le_bytes([low, high]), services);
                self.settle(services);
            }
            (TARGET_TORQUE, _) => {
                self.is_command_cut = false;
                self.apply_on_arrival(services);
            }
            (TARGET_POSITION, _) => self.motion.on_target(),
            (index, &[low, high]) => OptionCodes::check(index, i16::from_le_bytes([low, high]))?,
            _ => {}
        }
        Ok(())
    }

    fn on_communication_loss(&mut self, services: &mut Services, _loss: CommunicationLoss) {
        let codes = self.codes(services);
        self.take_mode(services);
        self.machine.on_communication_loss(&codes);
        self.settle(services);
    }

    fn on_tick(&mut self, services: &mut Services) {
        self.follow();
        let limits = self.objects.protection_limits(services.dictionary());
        self.protection.set_limits(limits);
        self.protect(services);
        let now = services.now();
        if self.clock.next.is_some_and(|next| next <= now) {
            self.clock.next = None;
            let position = self.sample(services);
            self.act(services, position);
            if self.moving_row(services).is_some() {
                let period = self.motion_objects.loop_period(services.dictionary());
                self.clock.on_step(now, period);
            }
        }
        self.settle(services);
    }

    fn next_deadline(&self) -> Option<Duration> {
        self.clock.next
    }

    fn on_stop(&mut self, services: &mut Services) {
        self.is_stop_asked = true;
        self.machine.disable();
        self.settle(services);
    }
}
