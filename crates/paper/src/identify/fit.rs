//! The problem of the optimisers: the distance between simulated and measured positions.

use plant_emulator::plants::sma::{self, Actuator, STEP_SECONDS_MAX};
use scenario::plant::Sma;

use super::data::IdentificationData;
use super::parameter::{Inequality, Parameter, ordering};
use super::sensor_model::SensorModel;

/// Recordings, the parameters to identify, and the known rest of the plant.
#[derive(Clone)]
pub struct Fit<'a> {
    /// Recordings to fit.
    pub measurements: &'a [IdentificationData],
    /// Parameters to identify.
    pub parameters: Vec<&'static Parameter>,
    /// Plant with the values of all other parameters.
    pub known: Sma,
    /// Whether the simulation has one integration step per position, and its derivatives are one-sided differences, which suffices
    /// for all but the end of a search. Else it has the emulator's integration step, and central differences.
    pub(super) is_coarse: bool,
}

/// Derivatives of all predicted positions, one column for each parameter.
pub type Derivatives = Vec<Vec<f64>>;

/// Step of a coarse integration: one per position. The motion's fastest rate is some 60 1/s.
const COARSE_STEP_SECONDS: f64 = 10e-3;
/// Step of one-sided differences, as a fraction of the parameter's range.
const ONE_SIDED_DIFFERENCE: f64 = 1e-5;
/// Step of central differences, as a fraction of the parameter's range: far below a standard error. Across several of these the
/// motion is so little linear that the two optimisers ended up to 1.3 standard errors apart.
const CENTRAL_DIFFERENCE: f64 = 3e-6;

impl<'a> Fit<'a> {
    /// Returns the symbols of the parameters to identify.
    pub fn symbols(&self) -> Vec<&'static str> {
        let parameters = self.parameters.iter();
        parameters.map(|parameter| parameter.symbol).collect()
    }

    /// Makes the problem, with the emulator's accuracy.
    pub fn new(
        measurements: &'a [IdentificationData],
        parameters: Vec<&'static Parameter>,
        known: Sma,
    ) -> Self {
        Self {
            measurements,
            parameters,
            known,
            is_coarse: false,
        }
    }

    /// Returns the same problem with the coarse accuracy, which is several times faster.
    pub fn coarse(&self) -> Self {
        Self {
            is_coarse: true,
            ..self.clone()
        }
    }

    /// Returns the known plant with these values of the parameters.
    pub fn plant(&self, values: &[f64]) -> Sma {
        let mut plant = self.known.clone();
        for (parameter, value) in self.parameters.iter().zip(values) {
            parameter.set(&mut plant, *value);
        }
        plant
    }

    /// Returns the values of the parameters in a plant.
    pub fn values_in(&self, plant: &Sma) -> Vec<f64> {
        self.parameters
            .iter()
            .map(|parameter| parameter.get(plant))
            .collect()
    }

    /// Returns the inequalities of the transformation temperatures.
    pub fn ordering(&self) -> Vec<Inequality> {
        ordering(&self.parameters, &self.known)
    }

    /// Returns whether values are inside the bounds and in order.
    pub fn admits(&self, values: &[f64]) -> bool {
        let is_inside = |(parameter, value): (&&Parameter, &f64)| {
            (parameter.lower..=parameter.upper).contains(value)
        };
        self.parameters.iter().zip(values).all(is_inside) && self.is_ordered(values)
    }

    /// Returns whether the transformation temperatures are in order.
    pub fn is_ordered(&self, values: &[f64]) -> bool {
        self.ordering().iter().all(|order| {
            let products = order.coefficients.iter().zip(values);
            let sum: f64 = products.map(|(a, x)| a * x).sum();
            sum <= order.limit
        })
    }

    /// Returns the number of positions that are compared.
    pub fn sample_count(&self) -> usize {
        self.measurements
            .iter()
            .map(|measurement| measurement.positions_metres.len())
            .sum()
    }

    /// Returns the true positions at the times of the measured ones; `None` for an invalid plant, and for one whose motion
    /// is no number at this accuracy.
    pub fn simulated_metres(&self, values: &[f64]) -> Option<Vec<f64>> {
        let plant = self.plant(values);
        sma::check(&plant).ok()?;
        let measurements = self.measurements.iter();
        let positions = measurements.flat_map(|measurement| self.simulate(&plant, measurement));
        (positions.map(|metres| metres.is_finite().then_some(metres))).collect()
    }

    fn simulate(&self, plant: &Sma, measurement: &IdentificationData) -> Vec<f64> {
        let step_seconds = if self.is_coarse {
            COARSE_STEP_SECONDS
        } else {
            STEP_SECONDS_MAX
        };
        let mut actuator = Actuator::new(plant).continued_with_step(step_seconds);
        let mut positions = vec![0.0; measurement.positions_metres.len()];
        for stretch in &measurement.stretches {
            actuator.advance(stretch.duration_seconds, &stretch.inputs);
            if let Some(sample) = stretch.sample {
                positions[sample] = actuator.position_metres();
            }
        }
        positions
    }

    /// Returns each recording with its part of some values, of which there is one for each position of all recordings, or
    /// none at all.
    pub fn parts<'v>(
        &self,
        values: &'v [f64],
    ) -> impl Iterator<Item = (&'a IdentificationData, &'v [f64])> {
        let mut rest = values;
        self.measurements.iter().map(move |measurement| {
            let count = measurement.positions_metres.len().min(rest.len());
            let (part, later) = rest.split_at(count);
            rest = later;
            (measurement, part)
        })
    }

    /// Returns the sensor's mean readings for these true positions.
    pub fn expected_metres(&self, true_metres: &[f64]) -> Vec<f64> {
        let expected = self
            .parts(true_metres)
            .flat_map(|(measurement, positions)| {
                let model = SensorModel::new(measurement.sensor());
                let positions = positions.iter();
                positions.map(move |position| model.expected_metres(*position))
            });
        expected.collect()
    }

    /// Returns the measured less the expected positions; `None` for an invalid plant.
    pub fn residual_metres(&self, values: &[f64]) -> Option<Vec<f64>> {
        let expected = self.expected_metres(&self.simulated_metres(values)?);
        let residual = self.parts(&expected).flat_map(|(measurement, expected)| {
            let pairs = measurement.positions_metres.iter().zip(expected);
            pairs.map(|(measured, expected)| measured - expected)
        });
        Some(residual.collect())
    }

    /// Returns the derivatives of the residual by differences. The side of a difference depends on the bounds and the
    /// order. The columns are independent, so each has a thread.
    pub fn jacobian(&self, values: &[f64]) -> Option<Derivatives> {
        self.jacobian_at(values, &self.residual_metres(values)?)
    }

    /// Works as [`Fit::jacobian`], with a residual that is known already.
    pub fn jacobian_at(&self, values: &[f64], base: &[f64]) -> Option<Derivatives> {
        std::thread::scope(|scope| {
            let column = |index| scope.spawn(move || self.column(values, index, base));
            let threads: Vec<_> = (0..values.len()).map(column).collect();
            let columns = threads.into_iter().map(|thread| thread.join().ok()?);
            columns.collect()
        })
    }

    fn column(&self, values: &[f64], index: usize, base: &[f64]) -> Option<Vec<f64>> {
        let range = self.parameters[index].range();
        let moved = |by: f64| {
            let mut moved = values.to_vec();
            moved[index] += by;
            moved
        };
        let step = if self.is_coarse {
            ONE_SIDED_DIFFERENCE * range
        } else {
            CENTRAL_DIFFERENCE * range
        };
        let (above, below) = (moved(step), moved(-step));
        let (above, below, width) = match (self.admits(&above), self.admits(&below)) {
            (true, true) if !self.is_coarse => (
                self.residual_metres(&above)?,
                self.residual_metres(&below)?,
                2.0 * step,
            ),
            (true, _) => (self.residual_metres(&above)?, base.to_vec(), step),
            (false, _) => (base.to_vec(), self.residual_metres(&below)?, step),
        };
        let pairs = above.into_iter().zip(below);
        Some(
            pairs
                .map(|(above, below)| (above - below) / width)
                .collect(),
        )
    }
}

/// Returns the root of the mean square.
pub fn rms(values: &[f64]) -> f64 {
    libm::sqrt(mean_square(values))
}

/// Returns the mean square.
pub fn mean_square(values: &[f64]) -> f64 {
    let count = values.len().max(1) as f64;
    values.iter().map(|value| value * value).sum::<f64>() / count
}
