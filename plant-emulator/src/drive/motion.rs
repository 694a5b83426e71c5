//! The cascade of a drive that moves: mode, motion generator, position loop, velocity loop.
//!
//! In: what the power stage lets the drive do, the mode's row, the objects and the measured position. Out: the torque, the
//! demands and the bits of the statusword. The drive calls [`Motion::step`] on its own clock and at each SYNC.

use std::time::Duration;

use canopen::cia402::{self, Generator, Level, Mode, Ramp};

use super::demand::{Demand, Ramps};
use super::interpolation::Interpolation;
use super::loops::VelocityLoop;
use super::motion_objects::Settings;
use super::set_points::{References, SetPoints};
use super::window::Window;

/// Longest time that a step covers: after a longer pause, as of a host that stalls, the motion does not catch up.
const STEP_SECONDS_MAX: f64 = 0.1;

/// The state of the cascade.
#[derive(Debug)]
pub(super) struct Motion {
    demand: Demand,
    /// Velocity that the velocity loop is given.
    velocity_command: f64,
    torque_permille: f64,
    /// The two latest samples of the position, the later one first.
    samples: [(Duration, f64); 2],
    /// Measured velocity: the difference of the means of two samples each.
    velocity: f64,
    stepped: Duration,
    mode: Option<&'static Mode>,
    set_points: SetPoints,
    interpolation: Interpolation,
    /// Whether a target position has come since the mode was chosen.
    has_target: bool,
    is_target_new: bool,
    control: VelocityLoop,
    reached: Window,
    following: Window,
    moving: Window,
    status: MotionStatus,
}

/// Report of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct MotionStatus {
    pub(super) is_target_reached: bool,
    pub(super) is_speed_zero: bool,
    pub(super) has_following_error: bool,
    pub(super) is_limit_active: bool,
    /// The demand stands, and the motor too.
    pub(super) is_standing: bool,
}

/// Values of the objects that the cascade writes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shown {
    pub(super) position_demand: f64,
    pub(super) velocity_demand: f64,
    pub(super) velocity: f64,
    pub(super) torque_permille: f64,
    pub(super) following_error: f64,
}

impl Motion {
    /// Makes a cascade at rest.
    pub(super) fn new() -> Self {
        Self {
            demand: Demand::default(),
            velocity_command: 0.0,
            torque_permille: 0.0,
            samples: [(Duration::ZERO, 0.0); 2],
            velocity: 0.0,
            stepped: Duration::ZERO,
            mode: None,
            set_points: SetPoints::default(),
            interpolation: Interpolation::at_rest(0.0, Duration::ZERO),
            has_target: false,
            is_target_new: false,
            control: VelocityLoop::default(),
            reached: Window::default(),
            following: Window::default(),
            moving: Window::default(),
            status: MotionStatus::default(),
        }
    }

    /// Leaves the modes that move. The next one begins at rest.
    pub(super) fn leave(&mut self) {
        self.mode = None;
    }

    /// Takes note that a target position was received.
    pub(super) fn on_target(&mut self) {
        (self.has_target, self.is_target_new) = (true, true);
    }

    /// Takes note of a controlword.
    pub(super) fn on_controlword(
        &mut self,
        controlword: u16,
        is_enabled: bool,
        settings: &Settings,
    ) {
        let is_here = self.mode.is_some_and(|mode| {
            matches!(
                (mode.level, mode.generator),
                (Level::Position, Generator::Profile)
            )
        });
        let references = References {
            demand: self.demand.position,
            actual: self.samples[0].1,
            positioning_option_code: settings.positioning_option_code,
        };
        let is_taken = self.set_points.on_controlword(
            controlword,
            is_enabled && is_here,
            &references,
            settings.target_position,
            |target| settings.within_travel(target).0,
        );
        if is_taken {
            self.reached = Window::default();
            self.status.is_target_reached = false;
        }
    }

    /// Forgets the set-points of a drive that is not enabled.
    pub(super) fn forget_set_points(&mut self) {
        self.set_points.clear();
    }

    /// Returns bit 12 of profile position.
    pub(super) fn is_set_point_acknowledged(&self) -> bool {
        self.set_points.is_acknowledged()
    }

    pub(super) fn status(&self) -> MotionStatus {
        self.status
    }

    pub(super) fn shown(&self) -> Shown {
        Shown {
            position_demand: self.demand.position,
            velocity_demand: self.velocity_command,
            velocity: self.velocity,
            torque_permille: self.torque_permille,
            following_error: self.demand.position - self.samples[0].1,
        }
    }

    /// Advances the cascade to the present time. Returns the torque in permille of the rated torque; 0 without power.
    pub(super) fn step(
        &mut self,
        now: Duration,
        mode: &'static Mode,
        motion: cia402::Motion,
        settings: &Settings,
        actual: f64,
    ) -> f64 {
        let elapsed = now.saturating_sub(self.stepped).as_secs_f64();
        let seconds = elapsed.min(STEP_SECONDS_MAX);
        self.stepped = now;
        if self.mode.is_none() {
            self.samples = [(now, actual); 2];
            self.velocity = 0.0;
            self.demand = Demand {
                position: actual,
                velocity: 0.0,
            };
        }
        self.measure(now, actual);
        if self.mode.is_none_or(|old| !old.id.eq(&mode.id)) {
            self.enter(mode);
        }
        self.status.is_limit_active = false;
        match motion {
            cia402::Motion::Off => self.rest(now, settings, actual),
            cia402::Motion::Follow => self.follow(mode, now, settings, actual, seconds),
            cia402::Motion::Stop(ramp) => self.stop(ramp, settings, actual, seconds),
        }
        if mode.level != Level::Position {
            self.demand.position = actual;
        }
        if motion != cia402::Motion::Off {
            self.close_loops(mode, motion, settings, actual, seconds);
        }
        self.watch(mode, motion, now, settings, actual);
        self.torque_permille
    }

    fn measure(&mut self, now: Duration, actual: f64) {
        let [(latest, _), (before, position)] = self.samples;
        let seconds = now.saturating_sub(before).as_secs_f64();
        if now > latest {
            self.velocity = (actual - position) / seconds;
            self.samples = [(now, actual), self.samples[0]];
        }
    }

    /// Begins a mode at the present motion.
    fn enter(&mut self, mode: &'static Mode) {
        self.mode = Some(mode);
        self.has_target = false;
        self.is_target_new = false;
        self.set_points.clear();
        self.reached = Window::default();
        self.following = Window::default();
        self.moving = Window::default();
    }

    /// Follows the motor while no current flows, so that nothing jumps when the drive is enabled.
    fn rest(&mut self, now: Duration, settings: &Settings, actual: f64) {
        self.demand = Demand {
            position: actual,
            velocity: 0.0,
        };
        self.control = VelocityLoop::default();
        (self.velocity_command, self.torque_permille) = (0.0, 0.0);
        if std::mem::take(&mut self.is_target_new) {
            let (target, _) = settings.within_travel(settings.target_position);
            self.interpolation = Interpolation::at_rest(target, now);
        }
    }

    fn follow(
        &mut self,
        mode: &Mode,
        now: Duration,
        settings: &Settings,
        actual: f64,
        seconds: f64,
    ) {
        match (mode.level, mode.generator) {
            (Level::Position, Generator::Cyclic) => self.follow_targets(now, settings, seconds),
            (Level::Position, Generator::Profile) => self.follow_set_points(settings, seconds),
            (Level::Velocity, Generator::Cyclic) => {
                let target = settings.target_velocity + settings.velocity_offset;
                self.follow_velocity(target, &settings.cyclic_ramps(), seconds);
            }
            (Level::Velocity, Generator::Profile) => {
                let target = settings.target_velocity;
                self.follow_velocity(target, &settings.profile_ramps(), seconds);
            }
            (Level::Torque, _) => self.demand.position = actual,
        }
    }

    /// Cyclic synchronous position: interpolates, and moves by 0x607F at most.
    fn follow_targets(&mut self, now: Duration, settings: &Settings, seconds: f64) {
        if std::mem::take(&mut self.is_target_new) {
            let (target, is_cut) = settings.within_travel(settings.target_position);
            self.status.is_limit_active |= is_cut;
            let present = self.demand.position;
            let period = settings.interpolation_seconds;
            self.interpolation.receive(target, present, now, period);
        }
        if !self.has_target {
            self.demand.velocity = 0.0;
            return;
        }
        let Some(goal) = self.interpolation.at(now + settings.loop_period) else {
            self.demand.ramp(0.0, &settings.profile_ramps(), seconds);
            return;
        };
        let reach = settings.speed_max * seconds.max(settings.loop_period.as_secs_f64());
        let way = goal.position - self.demand.position;
        if way.abs() <= reach {
            // A stop begins at this velocity, so the limit holds for it too.
            self.demand = Demand {
                velocity: goal.velocity.clamp(-settings.speed_max, settings.speed_max),
                ..goal
            };
        } else {
            self.status.is_limit_active = true;
            self.demand.position += reach.copysign(way);
            self.demand.velocity = settings.speed_max.copysign(way);
        }
    }

    /// Profile position: a step may end one move and begin the next.
    fn follow_set_points(&mut self, settings: &Settings, seconds: f64) {
        let ramps = settings.position_ramps();
        let mut left = seconds;
        for _ in 0..2 {
            let Some(set_point) = self.set_points.active() else {
                self.demand.ramp(0.0, &ramps, left);
                return;
            };
            let end_speed = if self.set_points.is_passing() {
                ramps.speed
            } else {
                0.0
            };
            let arrival = (self.demand).move_to(set_point.target, end_speed, &ramps, left);
            let Some(rest) = arrival else {
                return;
            };
            self.set_points.on_arrival();
            left = rest;
        }
    }

    fn follow_velocity(&mut self, target: f64, ramps: &Ramps, seconds: f64) {
        let within = target.clamp(-ramps.speed, ramps.speed);
        self.status.is_limit_active |= within != target;
        self.demand.ramp(within, ramps, seconds);
    }

    /// Stops; the set-points stay, since a halt may end.
    fn stop(&mut self, ramp: Ramp, settings: &Settings, actual: f64, seconds: f64) {
        match ramp {
            Ramp::SlowDown => self.demand.ramp(0.0, &settings.profile_ramps(), seconds),
            Ramp::QuickStop => self.demand.ramp(0.0, &settings.quick_stop_ramps(), seconds),
            Ramp::Limit => {
                self.demand.velocity = 0.0;
                if self.velocity.abs() > settings.speed_zero {
                    self.demand.position = actual;
                }
            }
        }
    }

    fn close_loops(
        &mut self,
        mode: &Mode,
        motion: cia402::Motion,
        settings: &Settings,
        actual: f64,
        seconds: f64,
    ) {
        let is_following = motion == cia402::Motion::Follow;
        let offsets = if is_following {
            [settings.velocity_offset, settings.torque_offset]
        } else {
            [0.0; 2]
        };
        let [velocity_offset, torque_offset] = offsets;
        self.velocity_command = match mode.level {
            Level::Position => {
                settings.gains.velocity_command(&self.demand, actual) + velocity_offset
            }
            Level::Velocity | Level::Torque => self.demand.velocity,
        };
        let error = self.velocity_command - self.velocity;
        let limits = settings.torque_limits;
        let (torque, is_cut) =
            (self.control).step(error, torque_offset, limits, &settings.gains, seconds);
        self.torque_permille = torque;
        self.status.is_limit_active |= is_cut;
    }

    /// Updates the windows.
    fn watch(
        &mut self,
        mode: &Mode,
        motion: cia402::Motion,
        now: Duration,
        settings: &Settings,
        actual: f64,
    ) {
        let speed = self.velocity.abs();
        let is_fast = speed > settings.speed_zero;
        let is_moving = (self.moving).lasts(is_fast, now, settings.speed_zero_time);
        let error = (self.demand.position - actual).abs();
        let is_off = motion != cia402::Motion::Off && error > settings.following_window;
        let following_time = settings.following_time;
        let (is_in_window, window_time) = match mode.level {
            Level::Velocity => {
                let deviation = (settings.target_velocity - self.velocity).abs();
                (
                    deviation <= settings.velocity_window,
                    settings.velocity_window_time,
                )
            }
            Level::Position | Level::Torque => {
                let last = self.set_points.last();
                let has_arrived = last.is_some() && self.set_points.active().is_none();
                let deviation = last.map_or(f64::INFINITY, |target| (target - actual).abs());
                (
                    has_arrived && deviation <= settings.position_window,
                    settings.position_window_time,
                )
            }
        };
        let is_standing = self.demand.velocity == 0.0 && !is_fast;
        let is_following = motion == cia402::Motion::Follow;
        let is_reached = (self.reached).lasts(is_following && is_in_window, now, window_time);
        let stands_in_stop = matches!(motion, cia402::Motion::Stop(_)) && is_standing;
        self.status = MotionStatus {
            is_target_reached: is_reached || stands_in_stop,
            is_speed_zero: !is_moving,
            has_following_error: self.following.lasts(is_off, now, following_time),
            is_standing,
            ..self.status
        };
    }
}
