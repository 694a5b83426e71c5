//! Ports: the named quantities of a plant to which drives and io nodes are wired, and those of a law.

use crate::names::is_name;
use crate::unit::{symbol_of, unit_in};

/// Largest number of steps that 16 bits hold.
const STEPS_MAX: f64 = 32_767.0;

/// Form of a law's term on the bus.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub enum Width {
    /// Real number of 32 bits.
    Real32,
    /// Two's complement of 8, 16 or 32 bits, in the port's steps.
    Signed(u8),
    /// Unsigned number of up to 8, 16 or 32 bits, in the port's steps. Those below 8 bits share a byte.
    Unsigned(u8),
}

/// Largest real number of 32 bits.
const REAL_MAX: f64 = 3.402_823_5e38;
/// Steps of a position on the bus, which has 32 bits, for one of its unit.
const POSITION_STEPS: f64 = 1e3;
const POSITION_RANGE: [f64; 2] = [-2_147_483.648, 2_147_483.647];

/// Named quantity of a plant or a law, in the unit in which the plant or law computes.
#[derive(Clone, Debug, PartialEq)]
pub struct Port {
    /// Name, which ends in the unit: `"flexor_current_amperes"`.
    pub name: String,
    /// Unit in words, as in the name; empty for a number without a unit.
    pub unit: String,
    /// Unit as the DBC writes it.
    pub symbol: String,
    /// Description of the quantity.
    pub comment: String,
    /// Lowest and highest value.
    pub range: [f64; 2],
    /// Value that acts while no node drives the port.
    pub at_rest: f64,
    /// Steps of one unit if the port is published as an integer: 100 for a resolution of 0.01.
    pub steps_per_unit: f64,
    /// Form of a law's term on the bus.
    pub width: Width,
    /// Whether a drive whose `record` is left out publishes the output.
    pub is_published: bool,
    /// Whether it is a term that the law writes in the unit of its loop's position, whatever the name says.
    pub is_position: bool,
}

impl Port {
    /// Makes an input with this range, which is 0 while no node drives it. Its unit is the end of its name.
    pub fn input(name: &str, range: [f64; 2]) -> Self {
        Self::output(name, range)
    }

    /// Makes an output with this range. Its unit is the end of its name.
    pub fn output(name: &str, range: [f64; 2]) -> Self {
        let unit = unit_in(name);
        Self {
            name: name.to_owned(),
            unit: unit.to_owned(),
            symbol: symbol_of(unit).to_owned(),
            comment: String::new(),
            range,
            at_rest: 0.0,
            steps_per_unit: steps_for(range),
            width: Width::Real32,
            is_published: true,
            is_position: false,
        }
    }

    /// Makes a term of a law: an output that is recorded, in 32 bits. Its unit is the end of its name.
    pub fn term(name: &str) -> Self {
        Self::output(name, [-REAL_MAX, REAL_MAX])
    }

    /// Makes a term of a law that is 0 or 1, in one bit.
    pub fn flag(name: &str) -> Self {
        Self::output(name, [0.0, 1.0]).counted(Width::Unsigned(1), 1.0)
    }

    /// Makes a term of a law that is a position of its loop, or a derivative of one. The law writes it in the unit in which it
    /// reads the position. The name is a pattern with the loop's unit, as `reference_{signal}_{unit}` or
    /// `reference_velocity_{unit}_per_second`.
    pub fn position_term(name: &str) -> Self {
        let mut port = Self::output(name, POSITION_RANGE);
        port.is_position = true;
        port.counted(Width::Signed(32), POSITION_STEPS)
    }

    /// Sets the form in which the port is published, and the steps of one unit.
    #[must_use]
    pub fn counted(mut self, width: Width, steps_per_unit: f64) -> Self {
        (self.width, self.steps_per_unit) = (width, steps_per_unit);
        self
    }

    /// Sets the description, a sentence.
    #[must_use]
    pub fn with_comment(self, comment: &str) -> Self {
        let comment = comment.to_owned();
        Self { comment, ..self }
    }

    /// Restricts the publication to drives whose `record` names the port.
    #[must_use]
    pub fn if_recorded(mut self) -> Self {
        self.is_published = false;
        self
    }

    /// Sets another unit than the end of its name, in words and as the DBC writes it.
    #[must_use]
    pub fn with_unit(mut self, unit: &str, symbol: &str) -> Self {
        (self.unit, self.symbol) = (unit.to_owned(), symbol.to_owned());
        self
    }

    /// Sets the value that acts while no node drives the port.
    #[must_use]
    pub fn resting_at(self, at_rest: f64) -> Self {
        Self { at_rest, ..self }
    }

    /// Sets the steps of one unit in which the port is published.
    #[must_use]
    pub fn in_steps(mut self, steps_per_unit: f64) -> Self {
        self.steps_per_unit = steps_per_unit;
        self
    }

    /// Returns its name without that of its plant.
    pub fn local_name(&self) -> &str {
        local_name(&self.name)
    }

    /// Returns the reason why it cannot be a port of a plant, as the end of a sentence.
    fn flaw(&self) -> Option<&'static str> {
        let [min, max] = self.range;
        // Rounded as on the bus: -32.768 in steps of 0.001 are -32768.
        let [lowest, highest] = self.range.map(|end| libm::round(end * self.steps_per_unit));
        let highest_max = if min < 0.0 {
            f64::from(i16::MAX)
        } else {
            f64::from(u16::MAX)
        };
        let fits = lowest >= f64::from(i16::MIN) && highest <= highest_max;
        if !is_name(&self.name) {
            Some("needs a name of at most 64 small letters, digits and underscores")
        } else if min.is_nan() || max.is_nan() || min >= max {
            Some("has a range that ends where it has not begun")
        } else if !(self.steps_per_unit > 0.0 && self.steps_per_unit.is_finite()) {
            Some("needs a number of steps per unit above 0")
        } else if self.has_range() && !fits {
            Some("does not fit 16 bits over its range: take fewer steps per unit")
        } else {
            None
        }
    }

    /// Checks whether its range is valid: two finite numbers, the lower one first.
    pub fn has_range(&self) -> bool {
        let [min, max] = self.range;
        min.is_finite() && max.is_finite() && min < max
    }
}

/// Ports of a plant or a law with certain parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ports {
    /// Inputs of the plant or the law, in its order.
    pub inputs: Vec<Port>,
    /// Outputs of the plant or the law, in its order.
    pub outputs: Vec<Port>,
}

impl Ports {
    /// Joins the ports of plants that are emulated together, each as `PLANT.PORT`, in the order of these plants.
    pub fn joined<'a>(plants: impl IntoIterator<Item = (&'a str, Self)>) -> Self {
        let mut all = Self::default();
        for (plant, mut ports) in plants {
            for port in ports.inputs.iter_mut().chain(&mut ports.outputs) {
                port.name = format!("{plant}.{}", port.name);
            }
            all.inputs.append(&mut ports.inputs);
            all.outputs.append(&mut ports.outputs);
        }
        all
    }

    /// Returns the index of an input.
    pub fn input(&self, name: &str) -> Option<usize> {
        self.inputs.iter().position(|port| port.name == name)
    }

    /// Returns the first port that a plant cannot have, with the reason as the end of a sentence.
    pub fn flaw(&self) -> Option<(&Port, &'static str)> {
        let all = Vec::from_iter(self.inputs.iter().chain(&self.outputs));
        all.iter().enumerate().find_map(|(place, port)| {
            let is_second = all[..place].iter().any(|other| other.name == port.name);
            let reason = port.flaw().or(is_second.then_some("is there twice"))?;
            Some((*port, reason))
        })
    }

    /// Returns the index of an output.
    pub fn output(&self, name: &str) -> Option<usize> {
        self.outputs.iter().position(|port| port.name == name)
    }
}

/// Returns the plant of a port with a name `PLANT.PORT`.
pub fn plant_of_port(port: &str) -> Option<&str> {
    port.split_once('.').map(|(plant, _)| plant)
}

/// Returns the name of a port without that of its plant.
pub fn local_name(port: &str) -> &str {
    port.split_once('.').map_or(port, |(_, name)| name)
}

/// Returns the finest resolution of 1, 2 and 5 times a power of ten whose steps over a range fit 16 bits; 1 for an invalid range.
pub fn steps_for([min, max]: [f64; 2]) -> f64 {
    let most = STEPS_MAX / min.abs().max(max.abs());
    // The range is neither empty nor without an end.
    if !(most.is_finite() && most > 0.0) {
        return 1.0;
    }
    let mut power = 1.0;
    while power > most {
        power /= 10.0;
    }
    while power * 10.0 <= most {
        power *= 10.0;
    }
    let fitting = [5.0, 2.0].into_iter().find(|step| step * power <= most);
    fitting.unwrap_or(1.0) * power
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_steps_of_a_range_fit_16_bits_and_are_as_fine_as_they_can_be() {
        for (range, steps) in [
            ([-60.0, 60.0], 500.0),
            ([0.0, 1.0], 20_000.0),
            ([-1e6, 1e6], 0.02),
            ([0.0, f64::INFINITY], 1.0),
            ([0.0, 0.0], 1.0),
            ([-1e-310, 1e-310], 1.0),
        ] {
            assert!((steps_for(range) / steps - 1.0).abs() < 1e-9, "{range:?}");
        }
    }

    #[test]
    fn a_port_that_the_bus_cannot_carry_is_refused() {
        let port = |name: &str, steps, min, max| Port::output(name, [min, max]).in_steps(steps);
        assert_eq!(port("angle_degrees", 100.0, -180.0, 180.0).flaw(), None);
        assert_eq!(port("speed", 1e3, -32.768, 32.767).flaw(), None);
        let endless = port("turns", 1.0, f64::NEG_INFINITY, f64::INFINITY);
        assert_eq!(endless.flaw(), None);
        for (wrong, reason) in [
            (port("Angle (°)", 1.0, 0.0, 1.0), "name"),
            (port("angle", 0.0, 0.0, 1.0), "above 0"),
            (port("angle", f64::NAN, 0.0, 1.0), "above 0"),
            (port("angle", 1.0, 1.0, 1.0), "has not begun"),
            (port("angle", 1.0, 1.0, f64::NAN), "has not begun"),
            (port("angle", 1e3, -180.0, 180.0), "16 bits"),
            (port("angle", 1.0, 0.0, 65_536.0), "16 bits"),
        ] {
            assert!(wrong.flaw().unwrap().contains(reason), "{wrong:?}");
        }
    }
}
