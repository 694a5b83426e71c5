//! The physics on the emulator's own clock: whatever the bus does, a hot wire cools on.

use std::time::Duration;

use crate::plant::{Inputs, Plant};

/// Longest time that is caught up at once. After this long under constant inputs everything has settled, so nothing
/// is lost by leaving out the rest.
const CATCH_UP_MAX: Duration = Duration::from_secs(60);

/// The plant, the time it has reached and what acts on it since.
#[derive(Clone, Debug)]
pub(crate) struct ClockedPlant<P: Plant> {
    plant: P,
    inputs: Inputs<P::Condition>,
    time: Duration,
}

impl<P: Plant> ClockedPlant<P> {
    /// A plant at time zero, without current and undisturbed.
    pub(crate) fn new(plant: P) -> Self {
        Self {
            plant,
            inputs: Inputs::default(),
            time: Duration::ZERO,
        }
    }

    /// Brings the plant to `now`, under the inputs that have acted so far, and returns how much time that was.
    pub(crate) fn advance_to(&mut self, now: Duration) -> Duration {
        let elapsed = now.saturating_sub(self.time);
        if !elapsed.is_zero() {
            self.plant
                .step(elapsed.min(CATCH_UP_MAX).as_secs_f64(), &self.inputs);
            self.time = now;
        }
        elapsed
    }

    /// The time that the plant has reached.
    pub(crate) fn time(&self) -> Duration {
        self.time
    }

    pub(crate) fn plant(&self) -> &P {
        &self.plant
    }

    pub(crate) fn inputs(&self) -> &Inputs<P::Condition> {
        &self.inputs
    }

    /// What acts from the present time on.
    pub(crate) fn set_inputs(&mut self, inputs: Inputs<P::Condition>) {
        self.inputs = inputs;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sma::{Actuator, Inputs};
    use scenario::plant;

    fn clocked() -> ClockedPlant<Actuator> {
        ClockedPlant::new(Actuator::new(&plant::Plant::default()))
    }

    fn current(current_amperes: f64) -> Inputs {
        Inputs {
            current_amperes,
            ..Inputs::default()
        }
    }

    #[test]
    fn events_in_between_change_nothing() {
        let (mut once, mut often) = (clocked(), clocked());
        for plant in [&mut once, &mut often] {
            plant.set_inputs(current(0.6));
        }
        once.advance_to(Duration::from_millis(2000));
        for microseconds in (0..=2_000_000).step_by(310) {
            often.advance_to(Duration::from_micros(microseconds));
        }
        often.advance_to(Duration::from_millis(2000));
        let difference = once.plant().position_metres() - often.plant().position_metres();
        assert!(difference.abs() < 1e-9, "{difference}");
        assert!(once.plant().position_metres() > 0.01);
    }

    #[test]
    fn time_does_not_go_back_and_a_long_gap_is_bounded() {
        let mut plant = clocked();
        plant.set_inputs(current(1.0));
        plant.advance_to(Duration::from_secs(1_000_000_000));
        assert!((plant.plant().temperature_celsius() - 138.44).abs() < 0.01);
        assert_eq!(plant.advance_to(Duration::ZERO), Duration::ZERO);
        assert_eq!(plant.time(), Duration::from_secs(1_000_000_000));
    }
}
