//! The drive, node 0x10 (CiA 402, cyclic synchronous torque): samples the position and applies the current at SYNC.
//!
//! A command that follows from the sample of one SYNC acts from the next SYNC on: one cycle of delay. The current falls
//! to 0 on arrival of whatever disables the drive, and by the drive's own timer when communication is lost.
//!
//! The drive holds the actuator it is wired to and brings it up to date whenever it samples, before the current or a
//! disturbance changes, and by a deadline of its own. Frames that only wait for a SYNC leave the physics alone.

mod objects;

use std::time::Duration;

use canopen::cia402::{self, CYCLIC_SYNCHRONOUS_TORQUE, OptionCodes, State, StateMachine, Status};
use canopen::emcy::ErrorCode;
use canopen::pdo::WaitingPdo;
use canopen::sync::Sync;
use canopen::{
    AbortCode, Application, CommunicationLoss, NmtCommand, NmtState, ObjectDictionary, Services,
};
use scenario::Scenario;

use objects::Objects;
pub use objects::Truth;

use crate::amplifier::Amplifier;
use crate::objects::MissingObject;
use crate::rig::Rig;
use crate::sensor::PositionSensor;
use crate::sma::{Actuator, Inputs};
use crate::thermal_protection::ThermalProtection;

/// Longest pause between two SYNCs (assumed). In it a wire at 1 A warms by less than 10 °C; a host that does not run
/// the manager for some milliseconds causes no fault.
pub const SYNC_TIMEOUT: Duration = Duration::from_millis(50);

/// Utilisation of the I²t protection from which the statusword warns, and below which a trip may be reset.
const WARNING_UTILISATION: f64 = 0.9;

const COMMUNICATION_CYCLE_PERIOD: u16 = 0x1006;

/// The drive's application: what happens round its object dictionary.
#[derive(Clone, Debug)]
pub struct Drive {
    objects: Objects,
    machine: StateMachine,
    sensor: PositionSensor,
    amplifier: Amplifier,
    protection: ThermalProtection,
    /// The actuator and what acts on it; its current is what the amplifier puts out.
    rig: Rig,
    /// Longest time that the actuator is left behind: beyond the next SYNC, which brings it up to date itself.
    idle_max: Duration,
    /// The option codes, to be read again when one may have been written.
    codes: Option<OptionCodes>,
    /// A limit cuts the target.
    is_limit_active: bool,
    /// When the latest SYNC came; supervised here while 0x1006 is 0.
    latest_sync: Duration,
    /// True while a SYNC period is configured, so that the SYNC consumer supervises it.
    has_sync_period: bool,
    is_stop_asked: bool,
}

impl Drive {
    /// The drive of a scenario's plant, with the objects of a dictionary. The sensor's noise follows from the seed.
    ///
    /// # Errors
    /// An object that the dictionary lacks.
    pub fn new(scenario: &Scenario, dictionary: &ObjectDictionary) -> Result<Self, MissingObject> {
        let objects = Objects::find(dictionary)?;
        let plant = &scenario.plant;
        Ok(Self {
            machine: StateMachine::new(),
            sensor: PositionSensor::new(&plant.sensor, scenario.seed),
            amplifier: Amplifier::new(&plant.amplifier, objects.rated_amperes(dictionary)),
            protection: ThermalProtection::new(objects.protection_limits(dictionary)),
            rig: Rig::new(Actuator::new(plant)),
            idle_max: scenario.bus.sync_period() * 3 / 2,
            codes: None,
            is_limit_active: false,
            latest_sync: Duration::ZERO,
            has_sync_period: false,
            is_stop_asked: false,
            objects,
        })
    }

    /// The actuator, as far as it has been brought up to date.
    #[must_use]
    pub fn actuator(&self) -> &Actuator {
        self.rig.actuator()
    }

    /// What acts on the actuator.
    #[must_use]
    pub fn inputs(&self) -> &Inputs {
        self.rig.inputs()
    }

    /// The state of the power state machine.
    #[must_use]
    pub fn state(&self) -> State {
        self.machine.state()
    }

    /// Lets other disturbances act from `now` on.
    pub(crate) fn disturb(
        &mut self,
        now: Duration,
        convection_factor: f64,
        added_load_kilograms: f64,
    ) {
        let inputs = Inputs {
            convection_factor,
            added_load_kilograms,
            ..*self.rig.inputs()
        };
        self.act_on_plant(now, inputs);
    }

    fn act_on_plant(&mut self, now: Duration, inputs: Inputs) {
        if inputs != *self.rig.inputs() {
            self.advance_to(now);
            self.rig.set_inputs(inputs);
        }
    }

    fn set_current(&mut self, now: Duration, current_amperes: f64) {
        let inputs = Inputs {
            current_amperes,
            ..*self.rig.inputs()
        };
        self.act_on_plant(now, inputs);
    }

    /// Brings the actuator and the overload integral to `now`.
    fn advance_to(&mut self, now: Duration) {
        let current_amperes = self.rig.inputs().current_amperes;
        let elapsed = self.rig.advance_to(now);
        self.protection
            .advance(elapsed.as_secs_f64(), current_amperes);
    }

    /// Samples the sensors into the dictionary.
    fn sample(&mut self, services: &mut Services) {
        self.advance_to(services.now());
        let truth = Truth::of(self.rig.actuator());
        let counts = self.sensor.sample(truth.position_metres);
        let position = self.sensor.position_metres(counts);
        let permille = self.amplifier.permille(self.rig.inputs().current_amperes);
        let dictionary = services.dictionary_mut();
        self.objects.set_position(dictionary, position);
        self.objects.set_truth(dictionary, &truth);
        self.objects.set_current(dictionary, permille);
        self.objects
            .set_utilisation(dictionary, self.protection.utilisation());
    }

    /// Lets the target torque act, where that is allowed.
    fn apply(&mut self, services: &Services) {
        if !self.may_heat(services) {
            return;
        }
        let dictionary = services.dictionary();
        let target = self.objects.target_torque_permille(dictionary);
        let (torque_max, current_max) = self.objects.limits_permille(dictionary);
        let (limited, is_cut) = cia402::limit_torque(target, torque_max, current_max);
        self.is_limit_active = is_cut || self.amplifier.clips(limited);
        self.set_current(services.now(), self.amplifier.current_amperes(limited));
    }

    fn may_heat(&self, services: &Services) -> bool {
        !self.is_stop_asked
            && services.nmt_state() == NmtState::Operational
            && self.machine.is_current_allowed()
            && self.objects.mode(services.dictionary()) == CYCLIC_SYNCHRONOUS_TORQUE
    }

    /// Ends every call that may have changed the state: no current without permission, and the statusword of now.
    fn settle(&mut self, services: &mut Services) {
        if !self.may_heat(services) {
            self.set_current(services.now(), 0.0);
            self.is_limit_active = false;
        }
        let mode = self.objects.mode(services.dictionary());
        let statusword = self.machine.statusword(&Status {
            is_voltage_enabled: true,
            has_warning: self.protection.utilisation() >= WARNING_UTILISATION,
            is_remote: services.nmt_state() == NmtState::Operational,
            is_limit_active: self.is_limit_active,
            mode,
        });
        self.objects
            .set_status(services.dictionary_mut(), statusword, mode);
    }

    /// I²t: a trip is a fault, over when the load is well below the limit.
    fn protect(&mut self, services: &mut Services) {
        if self.protection.is_tripped() && self.machine.is_current_allowed() {
            self.machine.on_fault();
            services.raise_error(ErrorCode::THERMAL_OVERLOAD, [0; 5]);
        } else if self.protection.utilisation() < WARNING_UTILISATION {
            services.clear_error(ErrorCode::THERMAL_OVERLOAD);
        }
    }

    fn codes(&mut self, services: &Services) -> OptionCodes {
        *self
            .codes
            .get_or_insert_with(|| OptionCodes::read(services.dictionary()))
    }

    fn obey(&mut self, controlword: u16, services: &Services) {
        let codes = self.codes(services);
        let is_fault_present = self.protection.utilisation() >= WARNING_UTILISATION;
        self.machine
            .on_controlword(controlword, &codes, is_fault_present);
    }

    /// The end of the SYNC's supervision while 0x1006 gives no period to the SYNC consumer.
    fn sync_deadline(&self) -> Option<Duration> {
        (self.rig.inputs().current_amperes > 0.0 && !self.has_sync_period)
            .then(|| self.latest_sync + SYNC_TIMEOUT)
    }

    /// Lets the SYNC consumer wait for [`SYNC_TIMEOUT`], and for one missing SYNC at least.
    fn supervise_sync(&mut self, services: &mut Services, period_microseconds: u32) {
        self.has_sync_period = period_microseconds != 0;
        let timeout_microseconds = u32::try_from(SYNC_TIMEOUT.as_micros()).unwrap_or(u32::MAX);
        let count = timeout_microseconds.checked_div(period_microseconds);
        services.set_missing_syncs_tolerated(count.unwrap_or_default().max(1));
    }
}

impl Application for Drive {
    fn on_reset(&mut self, services: &mut Services, _reset: NmtCommand) {
        self.machine = StateMachine::new();
        self.codes = None;
        let dictionary = services.dictionary();
        let limits = self.objects.protection_limits(dictionary);
        let period = dictionary.unsigned(COMMUNICATION_CYCLE_PERIOD, 0);
        self.protection.set_limits(limits);
        self.supervise_sync(services, period.unwrap_or_default());
        self.settle(services);
    }

    fn on_nmt_state(&mut self, services: &mut Services, state: NmtState) {
        if state != NmtState::Operational {
            self.machine.disable();
        }
        self.settle(services);
    }

    fn on_sync(&mut self, services: &mut Services, _sync: &Sync) {
        self.latest_sync = services.now();
        self.sample(services);
        self.protect(services);
        self.apply(services);
        self.settle(services);
    }

    fn on_rpdo(&mut self, services: &mut Services, _number: u16) {
        let controlword = self.objects.controlword(services.dictionary());
        self.obey(controlword, services);
        self.settle(services);
    }

    fn on_waiting_rpdo(&mut self, services: &mut Services, waiting: &WaitingPdo) {
        let dictionary = services.dictionary();
        let controlword = waiting.integer(dictionary, cia402::CONTROLWORD, 0);
        if let Some(controlword) = controlword.and_then(|value| u16::try_from(value).ok()) {
            let codes = self.codes(services);
            self.machine.on_waiting_controlword(controlword, &codes);
            self.settle(services);
        }
    }

    fn on_read(&mut self, services: &mut Services, index: u16, _sub_index: u8) {
        if matches!(index, 0x2101..=0x2103 | 0x2110 | 0x6064 | 0x6077 | 0x6078) {
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
                let supported = services
                    .dictionary()
                    .unsigned(cia402::SUPPORTED_DRIVE_MODES, 0);
                cia402::check_mode(mode.cast_signed(), supported.unwrap_or_default())?;
            }
            (cia402::CONTROLWORD, &[low, high]) => {
                self.obey(u16::from_le_bytes([low, high]), services);
                self.settle(services);
            }
            (COMMUNICATION_CYCLE_PERIOD, &[a, b, c, d]) => {
                self.supervise_sync(services, u32::from_le_bytes([a, b, c, d]));
            }
            (index, &[low, high]) => OptionCodes::check(index, i16::from_le_bytes([low, high]))?,
            _ => {}
        }
        Ok(())
    }

    fn on_communication_loss(&mut self, services: &mut Services, _loss: CommunicationLoss) {
        let codes = self.codes(services);
        self.machine.on_communication_loss(&codes);
        self.settle(services);
    }

    fn on_tick(&mut self, services: &mut Services) {
        self.advance_to(services.now());
        if self
            .sync_deadline()
            .is_some_and(|deadline| services.now() >= deadline)
        {
            services.raise_error(ErrorCode::COMMUNICATION, [0; 5]);
            self.on_communication_loss(services, CommunicationLoss::Sync);
        }
        let limits = self.objects.protection_limits(services.dictionary());
        self.protection.set_limits(limits);
        self.protect(services);
        self.settle(services);
    }

    fn next_deadline(&self) -> Option<Duration> {
        let physics = self.rig.time() + self.idle_max;
        Some(
            self.sync_deadline()
                .map_or(physics, |sync| sync.min(physics)),
        )
    }

    fn on_stop(&mut self, services: &mut Services) {
        self.is_stop_asked = true;
        self.machine.disable();
        self.settle(services);
    }
}
