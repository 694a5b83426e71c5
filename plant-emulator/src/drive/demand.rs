//! The demand of a drive that moves: a position and a velocity that follow ramps.
//!
//! In: a target and the ramps of the profile objects. Out: the demand after some time, exact within the step, whatever its
//! length. The cascade in [`super::motion`] calls it once a step.

/// Number of phases of a move that one step can hold: braking, turning, accelerating, cruising, braking.
const PHASES_MAX: u32 = 8;

/// Relative deviation of the braking distance from the way that is left, below which the move is in its last phase.
const TOLERANCE: f64 = 1e-9;

/// Limits of a move, in increments and seconds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ramps {
    pub(super) speed: f64,
    pub(super) acceleration: f64,
    pub(super) deceleration: f64,
}

/// Position and velocity that the loops are given.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Demand {
    pub(super) position: f64,
    pub(super) velocity: f64,
}

/// A phase of constant acceleration towards a target that lies ahead.
struct Phase {
    end_speed: f64,
    seconds: f64,
    is_last: bool,
}

impl Demand {
    /// Takes the velocity to a target; the position follows.
    pub(super) fn ramp(&mut self, target: f64, ramps: &Ramps, seconds: f64) {
        let mut left = seconds;
        while left > 0.0 && self.velocity != target {
            let is_braking = self.velocity != 0.0
                && (target - self.velocity).is_sign_positive() != self.velocity.is_sign_positive();
            let turns = is_braking && target * self.velocity <= 0.0;
            let (goal, rate) = match (turns, is_braking) {
                (true, _) => (0.0, ramps.deceleration),
                (false, true) => (target, ramps.deceleration),
                (false, false) => (target, ramps.acceleration),
            };
            let change = goal - self.velocity;
            let needed = change.abs() / rate;
            let (time, end) = if needed > left {
                (left, self.velocity + rate * left * change.signum())
            } else {
                (needed, goal)
            };
            self.position += (self.velocity + end) / 2.0 * time;
            self.velocity = end;
            left -= time;
        }
        self.position += self.velocity * left.max(0.0);
    }

    /// Moves towards a target, which it passes or reaches at `end_speed`. Returns the seconds that are left on arrival.
    pub(super) fn move_to(
        &mut self,
        target: f64,
        end_speed: f64,
        ramps: &Ramps,
        seconds: f64,
    ) -> Option<f64> {
        let mut left = seconds;
        for _ in 0..PHASES_MAX {
            let distance = target - self.position;
            let direction = if distance < 0.0 { -1.0 } else { 1.0 };
            let (way, speed) = (distance.abs(), self.velocity * direction);
            if way == 0.0 && speed == end_speed {
                return Some(left);
            }
            let phase = phase(way, speed, end_speed.min(ramps.speed), ramps);
            if phase.seconds > left {
                let end = speed + (phase.end_speed - speed) * left / phase.seconds;
                self.position += (speed + end) / 2.0 * left * direction;
                self.velocity = end * direction;
                return None;
            }
            self.velocity = phase.end_speed * direction;
            left -= phase.seconds;
            if phase.is_last {
                self.position = target;
                return Some(left);
            }
            self.position += (speed + phase.end_speed) / 2.0 * phase.seconds * direction;
        }
        None
    }
}

/// Returns the next phase of a move over `way`, which is not negative, with a speed that is positive towards the target.
fn phase(way: f64, speed: f64, end_speed: f64, ramps: &Ramps) -> Phase {
    let (up, down) = (ramps.acceleration, ramps.deceleration);
    let by = |rate: f64, end_speed: f64| Phase {
        end_speed,
        seconds: (end_speed - speed).abs() / rate,
        is_last: false,
    };
    if speed < 0.0 {
        return by(down, 0.0);
    }
    let braking = (speed * speed - end_speed * end_speed) / (2.0 * down);
    let slack = TOLERANCE * (1.0 + way);
    if speed > end_speed && braking > way + slack {
        return by(down, 0.0);
    }
    if speed > end_speed && braking >= way - slack {
        // The mean speed takes the phase exactly to the target.
        return Phase {
            end_speed,
            seconds: 2.0 * way / (speed + end_speed),
            is_last: true,
        };
    }
    if end_speed > speed && (end_speed * end_speed - speed * speed) / (2.0 * up) >= way {
        let reached = (speed * speed + 2.0 * up * way).sqrt();
        return Phase {
            is_last: true,
            ..by(up, reached)
        };
    }
    if speed > ramps.speed {
        return by(down, ramps.speed);
    }
    let peak =
        (2.0 * up * down * way + down * speed * speed + up * end_speed * end_speed) / (up + down);
    let peak = peak.sqrt().min(ramps.speed);
    if peak > speed {
        return by(up, peak);
    }
    let is_last = end_speed >= speed;
    Phase {
        end_speed: speed,
        seconds: (way - braking.max(0.0)) / speed,
        is_last,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RAMPS: Ramps = Ramps {
        speed: 50.0,
        acceleration: 400.0,
        deceleration: 800.0,
    };
    const STEP: f64 = 1e-3;

    /// Returns the time of a move from rest, and its highest speed.
    fn time_of(distance: f64, step: f64) -> (f64, f64) {
        let (mut demand, mut seconds, mut peak) = (Demand::default(), 0.0, 0.0_f64);
        loop {
            let before = demand.velocity;
            let left = demand.move_to(distance, 0.0, &RAMPS, step);
            peak = peak.max(demand.velocity.abs());
            let change = (demand.velocity - before).abs();
            assert!(
                change <= RAMPS.deceleration * step * (1.0 + 1e-6),
                "{change}"
            );
            seconds += step - left.unwrap_or_default();
            assert!(seconds < 100.0);
            if left.is_some() {
                assert_eq!((demand.position, demand.velocity), (distance, 0.0));
                return (seconds, peak);
            }
        }
    }

    /// T = D/V + V/2 (1/A + 1/Dec), and without a plateau T = √(2 D (1/A + 1/Dec)), peak √(2 D A Dec/(A + Dec)).
    #[test]
    fn a_move_takes_the_time_of_its_trapezoid() {
        let Ramps {
            speed,
            acceleration: up,
            deceleration: down,
        } = RAMPS;
        let inverse = 1.0 / up + 1.0 / down;
        for distance in [0.01, 1.0, 4.0, 5.0, 60.0, -60.0, 1000.0] {
            let way = f64::abs(distance);
            let expected_peak = (2.0 * way * up * down / (up + down)).sqrt();
            let expected = if expected_peak > speed {
                way / speed + speed / 2.0 * inverse
            } else {
                (2.0 * way * inverse).sqrt()
            };
            for step in [STEP, 3.7e-3] {
                let (seconds, peak) = time_of(distance, step);
                assert!((seconds - expected).abs() < 1e-6, "{distance}: {seconds}");
                assert!(peak <= expected_peak.min(speed) + 1e-9, "{peak}");
            }
        }
    }

    /// A quick stop takes v/a and v²/2a.
    #[test]
    fn a_stop_takes_the_time_and_the_way_of_its_ramp() {
        let mut demand = Demand {
            position: 3.0,
            velocity: -40.0,
        };
        let mut steps = 0;
        while demand.velocity != 0.0 {
            demand.ramp(0.0, &RAMPS, STEP);
            steps += 1;
        }
        assert!(
            (50..=51).contains(&steps),
            "40 / 800 s, and rounding: {steps}"
        );
        assert!((demand.position - (3.0 - 40.0 * 40.0 / 1600.0)).abs() < 1e-9);
    }

    #[test]
    fn a_reversal_brakes_by_the_deceleration_and_leaves_by_the_acceleration() {
        let mut demand = Demand {
            position: 0.0,
            velocity: 40.0,
        };
        demand.ramp(-40.0, &RAMPS, 0.05 + 0.05);
        assert!((demand.velocity + 20.0).abs() < 1e-9, "{demand:?}");
        assert!((demand.position - (1.0 - 0.5)).abs() < 1e-9, "{demand:?}");
    }

    #[test]
    fn a_target_that_is_too_near_is_overrun_and_then_reached() {
        let mut demand = Demand {
            position: 0.0,
            velocity: 50.0,
        };
        let mut highest = 0.0_f64;
        while demand.move_to(1.0, 0.0, &RAMPS, STEP).is_none() {
            highest = highest.max(demand.position);
        }
        assert!((highest - 50.0 * 50.0 / 1600.0).abs() < 1e-3, "{highest}");
        assert_eq!((demand.position, demand.velocity), (1.0, 0.0));
    }

    #[test]
    fn a_target_is_passed_at_the_end_speed() {
        let mut demand = Demand::default();
        let left = loop {
            if let Some(left) = demand.move_to(30.0, 50.0, &RAMPS, STEP) {
                break left;
            }
        };
        assert!(left < STEP);
        assert_eq!((demand.position, demand.velocity), (30.0, 50.0));
    }

    #[test]
    fn a_million_moves_do_not_drift() {
        let mut demand = Demand::default();
        for number in 0..1_000_000 {
            let target = if number % 2 == 0 { 0.1 } else { 0.0 };
            assert!(demand.move_to(target, 0.0, &RAMPS, 1.0).is_some());
        }
        assert_eq!(demand, Demand::default());
    }
}
