//! The physics on the emulator's own clock: whatever the bus does, a hot wire cools on.

use std::any::Any;
use std::time::Duration;

use scenario::fault::Faults;

use crate::ports::{NoPlant, Port, PortedPlant};

/// Longest time that is caught up at once. After this long under constant inputs everything has settled, so nothing
/// is lost by leaving out the rest.
const CATCH_UP_MAX: Duration = Duration::from_secs(60);

/// The plant, the time it has reached, what acts on it since, and what was seen of it then.
#[derive(Debug)]
pub(crate) struct ClockedPlant {
    plant: Box<dyn PortedPlant>,
    inputs: Vec<f64>,
    /// As they were when the plant reached its time: all that look at it then see the same, whatever acts on it from then on.
    outputs: Vec<f64>,
    time: Duration,
    /// Why it does not go on.
    failure: Option<String>,
}

impl ClockedPlant {
    /// A plant at time zero, undisturbed.
    pub(crate) fn new(plant: Box<dyn PortedPlant>) -> Self {
        let inputs = plant.inputs().iter().map(|port| port.at_rest).collect();
        let mut clocked = Self {
            inputs,
            outputs: vec![0.0; plant.outputs().len()],
            plant,
            time: Duration::ZERO,
            failure: None,
        };
        clocked.look();
        clocked
    }

    /// None: what a drive holds while another one has the plant in hand. Allocates nothing.
    pub(crate) fn none() -> Self {
        Self {
            plant: Box::new(NoPlant),
            inputs: Vec::new(),
            outputs: Vec::new(),
            time: Duration::ZERO,
            failure: None,
        }
    }

    /// Brings the plant to `now`, under the inputs that have acted so far. One that has failed stays as it was.
    #[inline]
    pub(crate) fn advance_to(&mut self, now: Duration) {
        let elapsed = now.saturating_sub(self.time);
        if elapsed.is_zero() {
            return;
        }
        self.time = now;
        if self.failure.is_some() {
            return;
        }
        let seconds = elapsed.min(CATCH_UP_MAX).as_secs_f64();
        self.plant.step(seconds, &self.inputs);
        self.look();
    }

    /// Takes what is seen of the plant, if it is numbers.
    fn look(&mut self) {
        self.plant.read(&mut self.outputs);
        let is_sound = self.outputs.iter().all(|value| value.is_finite());
        if is_sound && self.plant.failure().is_none() {
            return;
        }
        self.fail();
    }

    #[cold]
    fn fail(&mut self) {
        let ports = self.plant.outputs().iter().zip(&self.outputs);
        let mut wrong = ports.filter(|(_, value)| !value.is_finite());
        let words = match (self.plant.failure(), wrong.next()) {
            (Some(reason), _) => reason.to_owned(),
            (None, Some((port, value))) => format!(
                "its port `{}` is {value} after {:.3} s: no finite number",
                port.name,
                self.time.as_secs_f64()
            ),
            (None, None) => return,
        };
        self.failure = Some(words);
        for value in &mut self.outputs {
            *value = if value.is_finite() { *value } else { 0.0 };
        }
    }

    /// Why the plant does not go on.
    pub(crate) fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// What acts on a port.
    #[inline]
    pub(crate) fn input(&self, place: usize) -> f64 {
        self.inputs.get(place).copied().unwrap_or_default()
    }

    /// What was seen at a port at the plant's time.
    #[inline]
    pub(crate) fn output(&self, place: usize) -> f64 {
        self.outputs.get(place).copied().unwrap_or_default()
    }

    /// What acts on a port from the present time on.
    pub(crate) fn set_input(&mut self, place: usize, value: f64) {
        if let Some(input) = self.inputs.get_mut(place) {
            *input = value;
        }
    }

    /// All that acts on it.
    pub(crate) fn inputs(&self) -> &[f64] {
        &self.inputs
    }

    /// The ports at which it is seen.
    pub(crate) fn ports(&self) -> &[Port] {
        self.plant.outputs()
    }

    pub(crate) fn heated_celsius(&self, input: usize) -> Option<f64> {
        self.plant.heated_celsius(input)
    }

    pub(crate) fn conducts(&self, input: usize) -> bool {
        self.plant.conducts(input)
    }

    pub(crate) fn is_condition_new(
        &self,
        input: usize,
        faults: &Faults,
        time_seconds: f64,
    ) -> bool {
        self.plant.is_condition_new(input, faults, time_seconds)
    }

    pub(crate) fn set_condition(&mut self, input: usize, faults: &Faults, time_seconds: f64) {
        self.plant.set_condition(input, faults, time_seconds);
    }

    /// The plant itself, if it is of this type.
    pub(crate) fn plant<P: PortedPlant>(&self) -> Option<&P> {
        let plant: &dyn Any = &*self.plant;
        plant.downcast_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ports::{CURRENT, SingleAxis};
    use crate::sma::Actuator;
    use scenario::plant;

    fn clocked() -> ClockedPlant {
        let plant = Actuator::new(&plant::Plant::default());
        ClockedPlant::new(Box::new(SingleAxis::new(plant)))
    }

    #[test]
    fn events_in_between_change_nothing() {
        let (mut once, mut often) = (clocked(), clocked());
        for plant in [&mut once, &mut often] {
            plant.set_input(CURRENT, 0.6);
        }
        once.advance_to(Duration::from_millis(2000));
        for microseconds in (0..=2_000_000).step_by(310) {
            often.advance_to(Duration::from_micros(microseconds));
        }
        often.advance_to(Duration::from_millis(2000));
        let difference = once.output(0) - often.output(0);
        assert!(difference.abs() < 1e-9, "{difference}");
        assert!(once.output(0) > 0.01);
    }

    #[test]
    fn time_does_not_go_back_and_a_long_gap_is_bounded() {
        let mut plant = clocked();
        plant.set_input(CURRENT, 1.0);
        plant.advance_to(Duration::from_secs(1_000_000_000));
        let celsius = plant.heated_celsius(CURRENT).unwrap();
        assert!((celsius - 138.44).abs() < 0.01);
        let before = plant.output(0);
        plant.advance_to(Duration::ZERO);
        assert_eq!(plant.output(0), before);
        assert_eq!(plant.time, Duration::from_secs(1_000_000_000));
    }

    /// Is no number from a time on.
    #[derive(Debug)]
    struct Diverging {
        ports: [Port; 2],
        seconds: f64,
        after: f64,
    }

    impl PortedPlant for Diverging {
        fn inputs(&self) -> &[Port] {
            &[]
        }

        fn outputs(&self) -> &[Port] {
            &self.ports
        }

        fn step(&mut self, duration_seconds: f64, _inputs: &[f64]) {
            self.seconds += duration_seconds;
        }

        fn read(&self, outputs: &mut [f64]) {
            outputs[0] = self.seconds;
            outputs[1] = if self.seconds < 0.5 { 1.0 } else { self.after };
        }
    }

    #[test]
    fn what_is_no_number_is_named_and_the_plant_stops() {
        for after in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let ports = ["time_seconds", "height_metres"];
            let ports = ports.map(|name| Port::output(name, [0.0, 9.0]));
            let diverging = Diverging {
                ports,
                seconds: 0.0,
                after,
            };
            let mut plant = ClockedPlant::new(Box::new(diverging));
            plant.advance_to(Duration::from_millis(400));
            assert_eq!((plant.failure(), plant.output(1)), (None, 1.0));
            plant.advance_to(Duration::from_millis(600));
            let expected =
                format!("its port `height_metres` is {after} after 0.600 s: no finite number");
            assert_eq!(plant.failure(), Some(expected.as_str()));
            assert_eq!(plant.output(1), 0.0);
            plant.advance_to(Duration::from_secs(2));
            assert!((plant.output(0) - 0.6).abs() < 1e-12, "it does not go on");
        }
    }
}
