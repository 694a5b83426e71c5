//! The part of a scenario that the metrics use: steps, periods and disturbances, with their windows in scenario time.

use crate::disturbance::Change;
use crate::reference::Chirp;
use crate::trial::Trial;
pub use crate::window::Window;
use crate::wiring::IoWiring;
use dbc::Unit;

/// Recovery band in millimetres, unless the scenario has another one.
const RECOVERY_BAND_MILLIMETRES: f64 = 0.25;
/// Recovery band in another unit, as a share of the sensor's range.
const RECOVERY_BAND_SHARE: f64 = 1.0 / 240.0;

/// A step of the set-point that the metrics judge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JudgedStep {
    /// Window from the step to the next event, or to the end of the judgement.
    pub window: Window,
    /// Set-point just before the step.
    pub from: f64,
    /// Set-point from the step on.
    pub to: f64,
}

/// A sine of the set-point that the metrics judge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JudgedSine {
    /// Window of the last three whole periods.
    pub window: Window,
    /// Length of one period.
    pub period_seconds: f64,
}

/// A chirp of the set-point that the metrics judge.
#[derive(Clone, Debug, PartialEq)]
pub struct JudgedChirp {
    /// The chirp itself.
    pub piece: Chirp,
    /// Whole turns up to its end, the next piece or the end of the judgement; at least four.
    pub turns: f64,
}

impl Trial {
    /// Returns the end of the time that the metrics of the loop judge.
    pub fn judged_end_seconds(&self) -> f64 {
        let earlier = self.expect.judged_until_seconds;
        earlier.unwrap_or(self.run.duration_seconds)
    }

    /// Returns the deviation within which the position counts as recovered, in the unit of the loop: four steps of a 10-bit
    /// converter over 60 mm, and in another unit the same share of the sensor's range.
    pub fn recovery_band(&self) -> f64 {
        let [min, max] = self.wiring.feedback.range();
        let usual = match self.wiring.feedback.quantity.unit {
            Unit::Millimetres => RECOVERY_BAND_MILLIMETRES,
            _ => (max - min) * RECOVERY_BAND_SHARE,
        };
        self.expect.recovery_band.unwrap_or(usual)
    }

    /// Returns the steps that the metrics judge, in the order of time.
    pub fn judged_steps(&self) -> Vec<JudgedStep> {
        let trajectory = self.reference.trajectory();
        let pieces = self.reference.starts_seconds();
        let next_event = self.next_of(pieces.chain(self.disturbance_ends()));
        let end_seconds = self.judged_end_seconds();
        let steps = self.reference.step.iter();
        let within = steps.filter(|step| step.at_seconds < end_seconds);
        let judged = within.map(|step| {
            // Just before the step the piece before it still acts.
            let last_moment = step.at_seconds.next_down();
            JudgedStep {
                window: Window::new(step.at_seconds, next_event(step.at_seconds)),
                from: trajectory.at(last_moment).position,
                to: step.position,
            }
        });
        judged.collect()
    }

    /// Returns for each sine its last three whole periods, before the next piece or the end of the judgement. Sines of which
    /// fewer than four periods fit are left out.
    pub fn judged_sines(&self) -> Vec<JudgedSine> {
        let end_of_piece = self.next_of(self.reference.starts_seconds());
        let judged = self.reference.sine.iter().filter_map(|sine| {
            let period_seconds = sine.period_seconds;
            let length_seconds = end_of_piece(sine.from_seconds) - sine.from_seconds;
            // A period that ends with the run counts in spite of rounding.
            let periods = libm::floor(length_seconds / period_seconds + 1e-9);
            let until_seconds = sine.from_seconds + periods * period_seconds;
            (periods >= 4.0).then_some(JudgedSine {
                window: Window::new(until_seconds - 3.0 * period_seconds, until_seconds),
                period_seconds,
            })
        });
        judged.collect()
    }

    /// Returns the chirps that the metrics judge, in the order of the file. Chirps of which fewer than four turns fit are left
    /// out.
    pub fn judged_chirps(&self) -> Vec<JudgedChirp> {
        let end_of_piece = self.next_of(self.reference.starts_seconds());
        let judged = self.reference.chirp.iter().filter_map(|chirp| {
            let until_seconds = end_of_piece(chirp.from_seconds).min(chirp.until_seconds);
            // A turn that ends with the run counts in spite of rounding.
            let phase = chirp.phase_at(until_seconds - chirp.from_seconds);
            let turns = libm::floor(phase.turns + 1e-9);
            let piece = chirp.clone();
            (turns >= 4.0).then_some(JudgedChirp { piece, turns })
        });
        judged.collect()
    }

    /// Returns the changes of outputs that are signals of its loop, in the order of time.
    pub fn disturbances(&self) -> Vec<Change> {
        self.changes(|port| self.wiring.has_output(port))
    }

    /// Returns those that act on a plant of the loop, which the metrics judge.
    pub fn judged_disturbances(&self) -> Vec<Change> {
        self.changes(|port| self.wiring.is_disturbed_at(port))
    }

    /// Returns the changes of outputs on these ports, in the order of time.
    fn changes(&self, is_meant: impl Fn(&str) -> bool) -> Vec<Change> {
        let mut changes = self.run.disturbance.changes();
        let io = &self.wiring.shared.io;
        changes.retain(|one| {
            let is_its = |io: &&IoWiring| self.wiring.node(io.node).name == one.node;
            let port = io
                .iter()
                .find(is_its)
                .and_then(|io| io.outputs.get(&one.output));
            port.is_some_and(|port| is_meant(port))
        });
        let start = |one: &Change| one.window.from_seconds;
        changes.sort_by(|left, right| start(left).total_cmp(&start(right)));
        changes
    }

    /// Returns the starts and ends of the disturbances and faults by which the position may deviate, in no order.
    pub fn edges_seconds(&self) -> Vec<f64> {
        let disturbances = self.disturbance_ends().map(Some);
        let faults = self
            .position_faults()
            .flat_map(|fault| [fault.from_seconds, fault.until_seconds]);
        disturbances.chain(faults).flatten().collect()
    }

    /// Returns the starts and ends of the disturbances.
    fn disturbance_ends(&self) -> impl Iterator<Item = f64> + use<> {
        let windows = self.judged_disturbances().into_iter();
        windows.flat_map(|one| [one.window.from_seconds, one.window.until_seconds])
    }

    /// Returns a function from a time to the first of some times after it, or to the end of the judgement if that is earlier.
    fn next_of(&self, times_seconds: impl Iterator<Item = f64>) -> impl Fn(f64) -> f64 {
        let mut times = Vec::from_iter(times_seconds);
        times.sort_by(f64::total_cmp);
        let end_seconds = self.judged_end_seconds();
        move |seconds| {
            let next = times.partition_point(|&time| time <= seconds);
            times
                .get(next)
                .map_or(end_seconds, |time| time.min(end_seconds))
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::disturbance::value_at;
    use crate::rig::nodes::{FAN_OUTPUT, LOAD_OUTPUT};

    use super::*;

    fn scenario(tables: &str) -> Trial {
        let text = format!(
            "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 30.0\n[controller.pid]\n{tables}"
        );
        Trial::parse(
            &text,
            "t.toml",
            |_| Err(std::io::ErrorKind::NotFound.into()),
        )
        .unwrap()
    }

    const STEPS: &str = "[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
        [[reference.step]]\nat_seconds = 10.0\nposition_millimetres = 35.0\n\
        [[reference.step]]\nat_seconds = 20.0\nposition_millimetres = 15.0\n";
    const FAN: &str =
        "[[disturbance.fan]]\nfrom_seconds = 12.0\nuntil_seconds = 15.0\nconvection_factor = 5.0\n";
    const LOADS: &str = "[[disturbance.load]]\nat_seconds = 13.0\nadded_grams = 10.0\n\
        [[disturbance.load]]\nat_seconds = 25.0\nadded_grams = -5.0\n";

    #[test]
    fn a_step_lasts_until_the_next_event_or_the_end() {
        let steps = scenario(&format!("{STEPS}{FAN}")).judged_steps();
        let expected = [(10.0, 12.0, 10.0, 35.0), (20.0, 30.0, 35.0, 15.0)];
        let found = steps.iter().map(|step| {
            let Window {
                from_seconds,
                until_seconds,
            } = step.window;
            (from_seconds, until_seconds, step.from, step.to)
        });
        assert!(found.eq(expected));
    }

    #[test]
    fn a_step_at_once_starts_from_the_stop() {
        let step = "[[reference.step]]\nat_seconds = 0.0\nposition_millimetres = 25.0\n";
        let steps = scenario(step).judged_steps();
        assert_eq!(steps[0].from, 0.0);
        assert_eq!(steps[0].window.until_seconds, 30.0);
    }

    /// Returns the windows of the judged sines, each with start and end.
    fn windows_of_sines(tables: &str) -> Vec<(f64, f64)> {
        let sines = scenario(tables).judged_sines().into_iter();
        sines
            .map(|sine| (sine.window.from_seconds, sine.window.until_seconds))
            .collect()
    }

    fn sine(from_seconds: f64, period_seconds: f64) -> String {
        format!(
            "[[reference.sine]]\nfrom_seconds = {from_seconds:?}\ncentre_millimetres = 25.0\n\
             amplitude_millimetres = 10.0\nperiod_seconds = {period_seconds:?}\n"
        )
    }

    #[test]
    fn the_last_three_of_at_least_four_whole_periods_count() {
        assert_eq!(windows_of_sines(&sine(5.0, 5.0)), [(15.0, 30.0)]);
        assert_eq!(windows_of_sines(&sine(5.0, 6.0)), [(11.0, 29.0)]);
        assert_eq!(windows_of_sines(&sine(5.0, 7.0)), []);
    }

    #[test]
    fn each_sine_that_is_long_enough_is_judged() {
        let two = sine(0.0, 2.0) + &sine(9.0, 5.0);
        assert_eq!(windows_of_sines(&two), [(2.0, 8.0), (14.0, 29.0)]);
        let last_is_short = sine(0.0, 2.0) + &sine(9.0, 6.0);
        assert_eq!(windows_of_sines(&last_is_short), [(2.0, 8.0)]);
    }

    #[test]
    fn nothing_is_judged_behind_the_end_of_the_judgement() {
        let until = "[expect]\njudged_until_seconds = 11.0\n";
        let steps = scenario(&format!("{STEPS}{until}")).judged_steps();
        let windows = steps.iter().map(|step| step.window);
        assert!(windows.eq([Window {
            from_seconds: 10.0,
            until_seconds: 11.0
        }]));
        let sines = sine(0.0, 2.0) + &sine(9.0, 1.0) + until;
        assert_eq!(windows_of_sines(&sines), [(2.0, 8.0)]);
    }

    #[test]
    fn disturbances_have_windows_commands_and_names() {
        let scenario = scenario(&format!("{STEPS}{FAN}{LOADS}"));
        let windows = scenario.disturbances();
        let spans = windows.iter().map(|disturbance| {
            (
                disturbance.window.from_seconds,
                disturbance.window.until_seconds,
            )
        });
        assert!(spans.eq([(12.0, 15.0), (13.0, 13.0), (25.0, 25.0)]));
        let value = |output: &str, at: f64| value_at(&windows, output, at);
        let values = [11.0, 12.0, 13.0, 15.0, 25.0]
            .map(|at| (value(FAN_OUTPUT, at), value(LOAD_OUTPUT, at)));
        let expected = [
            (None, None),
            (Some(5.0), None),
            (Some(5.0), Some(10.0)),
            (None, Some(10.0)),
            (None, Some(-5.0)),
        ];
        assert_eq!(values, expected);
    }
}
