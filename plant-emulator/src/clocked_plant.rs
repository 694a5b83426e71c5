//! The physics on the emulator's own clock: a hot wire cools down whatever the bus does.

use std::any::Any;
use std::ops::Range;
use std::time::Duration;

use crate::plant::{Faults, Plant};

/// Longest time that is simulated at once. After this time under constant inputs everything has settled, so the rest
/// can be left out.
const CATCH_UP_MAX: Duration = Duration::from_secs(60);

/// The plants with their time, their inputs since then, and their outputs at that time. They act on each other through
/// nodes only. The default is an empty place for plants that another drive holds.
#[derive(Debug, Default)]
pub(crate) struct ClockedPlant {
    /// The plants, usually one; none while another drive holds them.
    parts: Vec<Part>,
    inputs: Vec<f64>,
    /// Outputs at the plants' time, so every reader at that time gets the same values, whatever acts afterwards.
    outputs: Vec<f64>,
    time: Duration,
    /// The emulator's own time, whatever the clocks of its nodes show; the plants follow it.
    pub(crate) now: Duration,
    /// Reason why they cannot continue.
    failure: Option<String>,
}

/// A plant, and the indices of its ports among those of all plants.
#[derive(Debug)]
struct Part {
    name: String,
    plant: Box<dyn Plant>,
    inputs: Range<usize>,
    outputs: Range<usize>,
}

impl ClockedPlant {
    /// Joins named plants at time zero, undisturbed. Their ports are in the order of the plants.
    pub(crate) fn new(plants: Vec<(String, Box<dyn Plant>)>) -> Self {
        let mut clocked = Self::default();
        for (name, plant) in plants {
            let ports = plant.ports();
            let [first_input, first_output] = [clocked.inputs.len(), clocked.outputs.len()];
            let at_rest = ports.inputs.iter().map(|port| port.at_rest);
            clocked.inputs.extend(at_rest);
            clocked.outputs.extend(ports.outputs.iter().map(|_| 0.0));
            clocked.parts.push(Part {
                name,
                plant,
                inputs: first_input..clocked.inputs.len(),
                outputs: first_output..clocked.outputs.len(),
            });
        }
        clocked.look();
        clocked
    }

    /// Advances the plants to `now` under the inputs that have acted since their time. After a failure their state
    /// stays.
    #[inline]
    pub(crate) fn advance_to(&mut self, now: Duration) {
        debug_assert!(!self.parts.is_empty(), "another drive holds the plants");
        let elapsed = now.saturating_sub(self.time);
        if elapsed.is_zero() {
            return;
        }
        self.time = now;
        if self.failure.is_some() {
            return;
        }
        let seconds = elapsed.min(CATCH_UP_MAX).as_secs_f64();
        for part in &mut self.parts {
            let inputs = &self.inputs[part.inputs.clone()];
            part.plant.step(seconds, inputs);
        }
        self.look();
    }

    /// Reads the outputs. The plants fail if they are not finite.
    #[inline]
    fn look(&mut self) {
        let mut is_sound = true;
        for part in &self.parts {
            let outputs = &mut self.outputs[part.outputs.clone()];
            part.plant.read(outputs);
            is_sound &= outputs.iter().all(|value| value.is_finite());
            is_sound &= part.plant.failure().is_none();
        }
        if !is_sound {
            self.fail();
        }
    }

    #[cold]
    fn fail(&mut self) {
        let mut parts = self.parts.iter();
        let reason = parts.find_map(|part| part.plant.failure());
        self.failure = reason.map(str::to_owned).or_else(|| self.wrong_output());
        for value in &mut self.outputs {
            *value = if value.is_finite() { *value } else { 0.0 };
        }
    }

    /// Describes the first output that is not finite; the name of its plant is needed only among several.
    fn wrong_output(&self) -> Option<String> {
        let place = self.outputs.iter().position(|value| !value.is_finite())?;
        let mut parts = self.parts.iter();
        let part = parts.find(|part| part.outputs.contains(&place))?;
        let port = &part.plant.ports().outputs[place - part.outputs.start].name;
        let port = match self.parts.len() {
            1 => port.clone(),
            _ => format!("{}.{port}", part.name),
        };
        let (value, seconds) = (self.outputs[place], self.time.as_secs_f64());
        Some(format!(
            "its port `{port}` is {value} after {seconds:.3} s: no finite number"
        ))
    }

    /// Returns the reason why the plants cannot continue, if there is one.
    pub(crate) fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// Returns the value of an input.
    #[inline]
    pub(crate) fn input(&self, place: usize) -> f64 {
        self.inputs.get(place).copied().unwrap_or_default()
    }

    /// Returns the value of an output at the plants' time.
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

    /// Returns the plant of an input, and the index of the input there.
    fn at(&self, input: usize) -> Option<(&dyn Plant, usize)> {
        let mut parts = self.parts.iter();
        let part = parts.find(|part| part.inputs.contains(&input))?;
        Some((&*part.plant, input - part.inputs.start))
    }

    pub(crate) fn heated_celsius(&self, input: usize) -> Option<f64> {
        let (plant, input) = self.at(input)?;
        plant.heated_celsius(input)
    }

    pub(crate) fn conducts(&self, input: usize) -> bool {
        self.at(input)
            .is_none_or(|(plant, input)| plant.conducts(input))
    }

    pub(crate) fn set_condition(&mut self, input: usize, faults: &Faults, time_seconds: f64) {
        let mut parts = self.parts.iter_mut();
        if let Some(part) = parts.find(|part| part.inputs.contains(&input)) {
            let input = input - part.inputs.start;
            part.plant.set_condition(input, faults, time_seconds);
        }
    }

    /// Returns the first plant of this type.
    pub(crate) fn plant<P: Plant>(&self) -> Option<&P> {
        self.parts.iter().find_map(|part| {
            let plant: &dyn Any = &*part.plant;
            plant.downcast_ref()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::{CURRENT, InvalidPlant, Port, Ports};
    use crate::plants::sma::Actuator;

    fn clocked() -> ClockedPlant {
        let plant = Actuator::new(&scenario::plant::Sma::default());
        ClockedPlant::new(vec![("wire".to_owned(), Box::new(plant))])
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
            let name = "diverging".to_owned();
            let mut plant = ClockedPlant::new(vec![(name, Box::new(diverging))]);
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
