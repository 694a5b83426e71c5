//! What the metrics must know of a scenario: steps, periods and disturbances, with their windows in scenario time.

use crate::Scenario;
use crate::disturbance::Disturbance;

/// A span of scenario time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// First instant.
    pub from_seconds: f64,
    /// Last instant.
    pub until_seconds: f64,
}

/// A step of the set-point that the metrics judge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JudgedStep {
    /// From the step to the next event, or to the end of the run.
    pub window: Window,
    /// The set-point just before.
    pub from_millimetres: f64,
    /// The set-point from the step on.
    pub to_millimetres: f64,
}

/// A disturbance that the metrics judge.
#[derive(Clone, Debug, PartialEq)]
pub struct DisturbanceWindow {
    /// From its start to its end; the change of a load begins and ends at one instant.
    pub window: Window,
    /// What happens, for people.
    pub text: String,
}

/// Something that happens at one time, for plots.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    /// When.
    pub at_seconds: f64,
    /// What, for people.
    pub text: String,
}

/// What the disturbance node is told at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DisturbanceCommand {
    /// From when.
    pub at_seconds: f64,
    /// Multiplies the convection coefficient.
    pub convection_factor: f64,
    /// Added to the plant's load.
    pub added_grams: f64,
}

impl Scenario {
    /// The steps that the metrics judge, in the order of time.
    #[must_use]
    pub fn judged_steps(&self) -> Vec<JudgedStep> {
        let trajectory = self.reference.trajectory();
        let starts = self.starts_in_order();
        let judged = self.reference.step.iter().map(|step| {
            let before = starts.partition_point(|&start| start < step.at_seconds);
            let next = starts.partition_point(|&start| start <= step.at_seconds);
            // Just before the step the piece before it is still in force.
            let last_moment = step.at_seconds.next_down();
            let from_metres = match before {
                0 => 0.0,
                _ => trajectory.at(last_moment).position_metres,
            };
            JudgedStep {
                window: Window {
                    from_seconds: step.at_seconds,
                    until_seconds: starts.get(next).copied().unwrap_or(self.duration_seconds),
                },
                from_millimetres: from_metres * 1e3,
                to_millimetres: step.position_millimetres,
            }
        });
        judged.collect()
    }

    /// The last three whole periods of the last sine, before the next piece or the end; `None` when fewer than four fit.
    #[must_use]
    pub fn judged_sine(&self) -> Option<Window> {
        let sine = self.reference.sine.last()?;
        let mut starts: Vec<f64> = self.reference.starts_seconds().collect();
        starts.sort_by(f64::total_cmp);
        let next = starts.partition_point(|&start| start <= sine.from_seconds);
        let end = starts.get(next).copied().unwrap_or(self.duration_seconds);
        // A period that ends with the run counts in spite of rounding.
        let periods = libm::floor((end - sine.from_seconds) / sine.period_seconds + 1e-9);
        (periods >= 4.0).then(|| {
            let until_seconds = sine.from_seconds + periods * sine.period_seconds;
            Window {
                from_seconds: until_seconds - 3.0 * sine.period_seconds,
                until_seconds,
            }
        })
    }

    /// The disturbances, in the order of time.
    #[must_use]
    pub fn disturbance_windows(&self) -> Vec<DisturbanceWindow> {
        let fans = self.disturbance.fan.iter().map(|fan| DisturbanceWindow {
            window: Window {
                from_seconds: fan.from_seconds,
                until_seconds: fan.until_seconds,
            },
            text: format!("fan, convection × {}", fan.convection_factor),
        });
        let loads = self.disturbance.load.iter().map(|load| DisturbanceWindow {
            window: Window {
                from_seconds: load.at_seconds,
                until_seconds: load.at_seconds,
            },
            text: format!("load {:+} g", load.added_grams),
        });
        let mut windows: Vec<_> = fans.chain(loads).collect();
        windows.sort_by(|left, right| {
            left.window
                .from_seconds
                .total_cmp(&right.window.from_seconds)
        });
        windows
    }

    /// Steps and disturbances for plots, in the order of time.
    #[must_use]
    pub fn events(&self) -> Vec<Event> {
        let event = |at_seconds, text| Event { at_seconds, text };
        let steps = self.reference.step.iter();
        let steps = steps.map(|step| {
            event(
                step.at_seconds,
                format!("step to {} mm", step.position_millimetres),
            )
        });
        let disturbances = self
            .disturbance_windows()
            .into_iter()
            .flat_map(|disturbance| {
                let Window {
                    from_seconds,
                    until_seconds,
                } = disturbance.window;
                let end = (until_seconds > from_seconds)
                    .then(|| event(until_seconds, "fan off".to_owned()));
                [Some(event(from_seconds, disturbance.text)), end]
            });
        let mut events: Vec<_> = steps.chain(disturbances.flatten()).collect();
        events.sort_by(|left, right| left.at_seconds.total_cmp(&right.at_seconds));
        events
    }

    /// The starts of all pieces and disturbances, and the ends of disturbances.
    fn starts_in_order(&self) -> Vec<f64> {
        let windows = self.disturbance_windows();
        let disturbances = windows.iter().flat_map(|disturbance| {
            [
                disturbance.window.from_seconds,
                disturbance.window.until_seconds,
            ]
        });
        let mut starts: Vec<f64> = self
            .reference
            .starts_seconds()
            .chain(disturbances)
            .collect();
        starts.sort_by(f64::total_cmp);
        starts
    }
}

impl Disturbance {
    /// What the disturbance node is told, in the order of time, one entry per instant; nothing before the first entry.
    #[must_use]
    pub fn commands(&self) -> Vec<DisturbanceCommand> {
        let fans = self
            .fan
            .iter()
            .flat_map(|fan| [fan.from_seconds, fan.until_seconds]);
        let loads = self.load.iter().map(|load| load.at_seconds);
        let mut times: Vec<f64> = fans.chain(loads).collect();
        times.sort_by(f64::total_cmp);
        times.dedup();
        let command = |at_seconds| DisturbanceCommand {
            at_seconds,
            convection_factor: self.convection_factor_at(at_seconds),
            added_grams: self.added_grams_at(at_seconds),
        };
        times.into_iter().map(command).collect()
    }

    /// The factor on the convection coefficient at one time; 1 while no fan blows.
    #[must_use]
    pub fn convection_factor_at(&self, time_seconds: f64) -> f64 {
        let blows = |fan: &&crate::disturbance::Fan| {
            (fan.from_seconds..fan.until_seconds).contains(&time_seconds)
        };
        self.fan
            .iter()
            .find(blows)
            .map_or(1.0, |fan| fan.convection_factor)
    }

    /// The added load in grams at one time; 0 before the first change.
    #[must_use]
    pub fn added_grams_at(&self, time_seconds: f64) -> f64 {
        let started = self
            .load
            .partition_point(|load| load.at_seconds <= time_seconds);
        started
            .checked_sub(1)
            .map_or(0.0, |last| self.load[last].added_grams)
    }
}
