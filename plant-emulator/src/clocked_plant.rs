//! The physics on the emulator's own clock: a hot wire cools down whatever the bus does.

use std::any::Any;
use std::time::Duration;

use crate::plant::{Faults, Plant};

/// Longest time that is simulated at once. After this time under constant inputs everything has settled, so the rest
/// can be left out.
const CATCH_UP_MAX: Duration = Duration::from_secs(60);

/// The plant with its time, its inputs since then, and its outputs at that time. The default is an empty place for a
/// plant that another drive holds.
#[derive(Debug, Default)]
pub(crate) struct ClockedPlant {
    /// The plant; `None` while another drive holds it.
    plant: Option<Box<dyn Plant>>,
    inputs: Vec<f64>,
    /// Outputs at the plant's time, so every reader at that time gets the same values, whatever acts afterwards.
    outputs: Vec<f64>,
    time: Duration,
    /// Reason why it cannot continue.
    failure: Option<String>,
}

impl ClockedPlant {
    /// Makes a plant at time zero, undisturbed.
    pub(crate) fn new(plant: Box<dyn Plant>) -> Self {
        let ports = plant.ports();
        let mut clocked = Self {
            inputs: ports.inputs.iter().map(|port| port.at_rest).collect(),
            outputs: vec![0.0; ports.outputs.len()],
            plant: Some(plant),
            ..Self::default()
        };
        clocked.look();
        clocked
    }

    /// Advances the plant to `now` under the inputs that have acted since its time. After a failure its state stays.
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
        if let Some(plant) = &mut self.plant {
            plant.step(seconds, &self.inputs);
            self.look();
        }
    }

    /// Reads the outputs. The plant fails if they are not finite.
    fn look(&mut self) {
        let Some(plant) = &self.plant else { return };
        plant.read(&mut self.outputs);
        let is_sound = self.outputs.iter().all(|value| value.is_finite());
        if !is_sound || plant.failure().is_some() {
            self.fail();
        }
    }

    #[cold]
    fn fail(&mut self) {
        let Some(plant) = &self.plant else { return };
        let ports = plant.ports().outputs;
        let mut values = ports.iter().zip(&self.outputs);
        let wrong = values.find(|(_, value)| !value.is_finite());
        self.failure = match (plant.failure(), wrong) {
            (Some(reason), _) => Some(reason.to_owned()),
            (None, Some((port, value))) => Some(format!(
                "its port `{}` is {value} after {:.3} s: no finite number",
                port.name,
                self.time.as_secs_f64()
            )),
            (None, None) => None,
        };
        for value in &mut self.outputs {
            *value = if value.is_finite() { *value } else { 0.0 };
        }
    }

    /// Returns the reason why the plant cannot continue, if there is one.
    pub(crate) fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// Returns the value of an input.
    #[inline]
    pub(crate) fn input(&self, place: usize) -> f64 {
        self.inputs.get(place).copied().unwrap_or_default()
    }

    /// Returns the value of an output at the plant's time.
    #[inline]
    pub(crate) fn output(&self, place: usize) -> f64 {
        self.outputs.get(place).copied().unwrap_or_default()
    }

    /// Sets the value of an input from the present time on.
    pub(crate) fn set_input(&mut self, place: usize, value: f64) {
        if let Some(input) = self.inputs.get_mut(place) {
            *input = value;
        }
    }

    /// Returns the values of all inputs.
    pub(crate) fn inputs(&self) -> &[f64] {
        &self.inputs
    }

    pub(crate) fn heated_celsius(&self, input: usize) -> Option<f64> {
        self.plant.as_ref()?.heated_celsius(input)
    }

    pub(crate) fn conducts(&self, input: usize) -> bool {
        let plant = self.plant.as_ref();
        plant.is_none_or(|plant| plant.conducts(input))
    }

    pub(crate) fn is_condition_new(
        &self,
        input: usize,
        faults: &Faults,
        time_seconds: f64,
    ) -> bool {
        let plant = self.plant.as_ref();
        plant.is_some_and(|plant| plant.is_condition_new(input, faults, time_seconds))
    }

    pub(crate) fn set_condition(&mut self, input: usize, faults: &Faults, time_seconds: f64) {
        if let Some(plant) = &mut self.plant {
            plant.set_condition(input, faults, time_seconds);
        }
    }

    /// Returns the plant itself, if it is of this type.
    pub(crate) fn plant<P: Plant>(&self) -> Option<&P> {
        let plant: &dyn Any = &**self.plant.as_ref()?;
        plant.downcast_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::{CURRENT, InvalidPlant, Port, Ports};
    use crate::plants::sma::Actuator;

    fn clocked() -> ClockedPlant {
        let plant = Actuator::new(&scenario::plant::Sma::default());
        ClockedPlant::new(Box::new(plant))
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

    /// A plant whose height is `after` from a certain time on.
    #[derive(Debug, Default)]
    struct Diverging {
        seconds: f64,
        after: f64,
    }

    impl Plant for Diverging {
        type Config = f64;

        fn name() -> &'static str {
            "diverging"
        }

        fn new(after: &f64) -> Result<Self, InvalidPlant> {
            Ok(Self {
                after: *after,
                ..Self::default()
            })
        }

        fn ports(&self) -> Ports {
            let ports = ["time_seconds", "height_metres"];
            Ports {
                outputs: ports.map(|name| Port::output(name, [0.0, 9.0])).into(),
                ..Ports::default()
            }
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
    fn an_output_that_is_not_finite_is_named_and_the_plant_stops() {
        for after in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let diverging = Diverging::new(&after).unwrap();
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
