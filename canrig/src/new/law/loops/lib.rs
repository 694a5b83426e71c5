//! my_law: PI control of two axes that carry one beam. The law keeps the beam level. Put your law in its place.

use controller::law::{CommandRange, Cycle, Law, Port, Ports};
use schemars::JsonSchema;
use serde::Deserialize;

/// Range of the drives' currents, in amperes.
const CURRENT_RANGE: [f64; 2] = [0.0, 1.0];
/// Travel of the axes, in metres.
const TRAVEL: [f64; 2] = [0.0, 0.06];

/// The table `[controller.all.my_law]` of a scenario.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Names of the loops of the rig. Each loop has one drive of the same name.
    pub loops: [String; 2],
    /// Proportional gain of each axis.
    #[schemars(range(min = 0.0, max = 100_000.0))]
    pub proportional_amperes_per_metre: f64,
    /// Integral gain of each axis.
    #[schemars(range(min = 0.0, max = 100_000.0))]
    pub integral_amperes_per_metre_second: f64,
    /// Additional current of an axis for each metre that it is behind the other one.
    #[schemars(range(min = 0.0, max = 100_000.0))]
    pub level_amperes_per_metre: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            loops: ["left", "right"].map(String::from),
            proportional_amperes_per_metre: 3.0,
            integral_amperes_per_metre_second: 30.0,
            level_amperes_per_metre: 10.0,
        }
    }
}

/// The law: the part that is constant from cycle to cycle.
#[derive(Clone, Debug)]
pub struct MyLaw {
    config: Config,
}

/// State of one axis between cycles.
#[derive(Clone, Copy, Debug, Default)]
pub struct Axis {
    position_metres: f64,
    integral_amperes: f64,
}

impl Law for MyLaw {
    const NAME: &'static str = "my_law";
    /// The law leads all loops of a rig. Their names are in its ports.
    const DRIVES: Option<usize> = None;
    type Config = Config;
    type State = [Axis; 2];

    fn new(config: &Config, _: &[CommandRange]) -> Self {
        Self {
            config: config.clone(),
        }
    }

    fn ports(&self) -> Ports {
        let [left, right] = &self.config.loops;
        let read = |name: String| Port::input(&name, TRAVEL);
        let command = |of: &str| Port::output(&format!("{of}.command"), CURRENT_RANGE);
        let term = |of: &str| {
            Port::term(&format!("{of}.integral_part_amperes"))
                .with_comment("Integral part of the current.")
        };
        Ports {
            // The suffix of a name is the unit of the value.
            inputs: vec![
                read(format!("{left}.position_metres")),
                read(format!("{right}.position_metres")),
                read(format!("{left}.set_point_metres")),
                read(format!("{right}.set_point_metres")),
            ],
            // One command for each drive; the other values are recorded.
            outputs: vec![command(left), command(right), term(left), term(right)],
        }
    }

    fn start(&self) -> [Axis; 2] {
        [Axis::default(); 2]
    }

    /// Values come and go in the order of the ports.
    fn step(&self, state: &mut [Axis; 2], cycle: &Cycle, reads: &[f64], writes: &mut [f64]) {
        let (positions, set_points) = reads.split_at(2);
        for (axis, position) in state.iter_mut().zip(positions) {
            // A cycle may bring no position; then the last one holds.
            if position.is_finite() {
                axis.position_metres = *position;
            }
        }
        let behind = state[1].position_metres - state[0].position_metres;
        let wanted_behind = set_points[1] - set_points[0];
        let levels = [behind - wanted_behind, wanted_behind - behind];
        let (currents, terms) = writes.split_at_mut(2);
        for (place, axis) in state.iter_mut().enumerate() {
            let error = set_points[place] - axis.position_metres;
            let gain = self.config.integral_amperes_per_metre_second;
            let integral = axis.integral_amperes + gain * error * cycle.period_seconds;
            // The integral goes no further than a current can, so it does not wind up.
            axis.integral_amperes = integral.clamp(CURRENT_RANGE[0], CURRENT_RANGE[1]);
            currents[place] = self.config.proportional_amperes_per_metre * error
                + self.config.level_amperes_per_metre * levels[place]
                + axis.integral_amperes;
            terms[place] = axis.integral_amperes;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CYCLE: Cycle = Cycle {
        scenario_time_seconds: 0.0,
        period_seconds: 1e-3,
    };

    /// Plays one cycle at these positions, on the way to 20 mm, and returns the currents.
    fn step(law: &MyLaw, state: &mut [Axis; 2], [left, right]: [f64; 2]) -> [f64; 2] {
        let mut writes = [0.0; 4];
        law.step(state, &CYCLE, &[left, right, 0.02, 0.02], &mut writes);
        [writes[0], writes[1]]
    }

    #[test]
    fn the_axis_that_is_behind_gets_more() {
        let law = MyLaw::new(&Config::default(), &[]);
        let [left, right] = step(&law, &mut law.start(), [0.010, 0.012]);
        // 3 A/m of 10 mm and of 8 mm, plus and minus 10 A/m of 2 mm.
        assert!((left - 0.0503).abs() < 1e-9, "{left}");
        assert!((right - 0.004_24).abs() < 1e-9, "{right}");
    }

    #[test]
    fn a_long_way_off_does_not_wind_up() {
        let law = MyLaw::new(&Config::default(), &[]);
        let mut state = law.start();
        for _ in 0..100_000 {
            step(&law, &mut state, [-10.0, -10.0]);
        }
        assert!(state.iter().all(|axis| axis.integral_amperes <= 1.0));
    }

    #[test]
    fn a_missing_position_repeats_the_last() {
        let law = MyLaw::new(&Config::default(), &[]);
        let mut state = law.start();
        step(&law, &mut state, [0.01, 0.01]);
        let [held, _] = step(&law, &mut state, [f64::NAN, 0.01]);
        let [left, _] = step(&law, &mut state, [0.01, 0.01]);
        assert!((held - left).abs() < 1e-3);
    }

    #[test]
    fn its_ports_are_of_the_loops_that_its_table_names() {
        let loops = ["x", "y"].map(String::from);
        let config = Config {
            loops,
            ..Config::default()
        };
        let law = MyLaw::new(&config, &[]);
        assert_eq!(law.ports().outputs[1].name, "y.command");
    }
}
