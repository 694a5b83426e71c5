//! my_law: PI control with anti-windup. Put your law in its place.

use controller::law::{CommandRange, Cycle, Law, LoopReads, Port, Ports, one_loop};
use schemars::JsonSchema;
use serde::Deserialize;

/// The table `[controller.my_law]` of a scenario.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Proportional gain.
    #[schemars(range(min = 0.0, max = 100_000.0))]
    #[serde(rename = "proportional_{gain}")]
    pub proportional: f64,
    /// Integral gain.
    #[schemars(range(min = 0.0, max = 100_000.0))]
    #[serde(rename = "integral_{gain}_second")]
    pub integral: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            proportional: 3.0,
            integral: 30.0,
        }
    }
}

/// The law: the part that is constant from cycle to cycle.
#[derive(Clone, Debug)]
pub struct MyLaw {
    config: Config,
    commands: CommandRange,
}

/// State of the law between cycles.
#[derive(Clone, Copy, Debug, Default)]
pub struct State {
    position: f64,
    integral_amperes: f64,
}

impl Law for MyLaw {
    const NAME: &'static str = "my_law";
    type Config = Config;
    type State = State;

    /// The second is what each drive that it leads can be commanded: this law leads one.
    fn new(config: &Config, commands: &[CommandRange]) -> Self {
        Self {
            config: config.clone(),
            commands: commands[0],
        }
    }

    /// The law's own terms are sent every 10th cycle: names in recording, report and `[[expect.signal]]`.
    fn ports(&self) -> Ports {
        one_loop::<Self>([
            Port::term("proportional_part_amperes")
                .with_comment("Proportional part of the command."),
            Port::term("integral_part_amperes").with_comment("Integral part of the command."),
        ])
    }

    fn start(&self) -> State {
        State::default()
    }

    fn step(&self, state: &mut State, cycle: &Cycle, reads: &[f64], writes: &mut [f64]) {
        let LoopReads {
            position,
            set_point,
        } = LoopReads::of(reads);
        // A cycle may bring no position; then the last one holds.
        if position.is_finite() {
            state.position = position;
        }
        let error = set_point.position - state.position;
        let proportional = self.config.proportional * error;
        let step = self.config.integral * error * cycle.period_seconds;
        // The integral goes no further than a command can, so it does not wind up.
        let CommandRange { min, max, .. } = self.commands;
        state.integral_amperes = (state.integral_amperes + step).clamp(min, max);
        let command = proportional + state.integral_amperes;
        // The command, then the terms in the order of the ports.
        writes.copy_from_slice(&[
            command.clamp(min, max),
            proportional,
            state.integral_amperes,
        ]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CYCLE: Cycle = Cycle {
        scenario_time_seconds: 0.0,
        period_seconds: 1e-3,
    };

    /// Returns the law for a drive with a range of 0 to 1 A.
    fn law() -> MyLaw {
        MyLaw::new(&Config::default(), &[CommandRange::default()])
    }

    /// Plays one cycle at a position, on the way to 20 mm, and returns the current.
    fn step(law: &MyLaw, state: &mut State, position: f64) -> f64 {
        let mut reads = LoopReads {
            position,
            ..LoopReads::default()
        };
        reads.set_point.position = 0.02;
        let mut writes = [0.0; 3];
        law.step(state, &CYCLE, &reads.values(), &mut writes);
        writes[0]
    }

    #[test]
    fn the_current_is_the_sum_of_both_parts() {
        let law = law();
        let mut state = law.start();
        for _ in 0..1000 {
            step(&law, &mut state, 0.01);
        }
        // 3 A/m and, after a second, 30 A/m of 10 mm.
        assert!((step(&law, &mut state, 0.01) - 0.33).abs() < 1e-3);
    }

    #[test]
    fn a_long_way_off_does_not_wind_up() {
        let law = law();
        let mut state = law.start();
        for _ in 0..100_000 {
            step(&law, &mut state, -10.0);
        }
        assert!(state.integral_amperes <= 1.0);
    }

    #[test]
    fn a_missing_position_repeats_the_last() {
        let law = law();
        let mut state = law.start();
        step(&law, &mut state, 0.01);
        let held = step(&law, &mut state, f64::NAN);
        assert!((held - step(&law, &mut state, 0.01)).abs() < 1e-3);
    }
}
