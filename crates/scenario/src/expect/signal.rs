//! `[[expect.signal]]`: demands on a signal in a window of time.

use schemars::JsonSchema;
use serde::Deserialize;

use super::{ExpectedRow, at_most};
use crate::curve;
use crate::limit::{Limit, rounded};
use crate::window::Window;

/// Resolution of recordings.
const RESOLUTION_SECONDS: f64 = 1e-6;

/// Demands on a signal in a window of time; at least one of `stays`, `reaches`, `rate_per_second` and `follows`. A window without
/// a sample, a silent signal and a value that is no number never pass.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct SignalCheck {
    /// Requirements that the check tests, such as "REQ-12".
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(length(max = 100), inner(length(min = 1, max = 100)))]
    pub requirements: Vec<String>,
    /// The signal: `message.signal` or `signal` of the DBC, or the name of the object behind it in the EDS
    /// ("Position actual value", also as "drive.Position actual value").
    #[schemars(length(min = 1, max = 200))]
    pub name: String,
    /// Start of the window; a sample at this time counts. The start of the scenario if absent.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub from_seconds: Option<f64>,
    /// End of the window; a sample at this time no longer counts. The end of the run if absent.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub until_seconds: Option<f64>,
    /// Every sample of the window is within these limits; judged by the one that is nearest to a limit or beyond it.
    pub stays: Option<Limit>,
    /// Some sample of the window is within these limits; judged by the time from the start of the window to the first.
    pub reaches: Option<Limit>,
    /// Difference of two successive samples, divided by the time between them, in the signal's unit per second.
    pub rate_per_second: Option<Limit>,
    /// Every sample of the window is near a recorded course.
    pub follows: Option<Course>,
}

/// A recorded course of a signal: straight lines through the rows of a CSV file such as the `signals.csv` of a run. Without
/// a window of its own the check lasts as long as the course.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Course {
    /// The file, relative to the scenario, with a column `time_seconds` in scenario time; rows without a value are skipped.
    pub file: String,
    /// The column of the signal; by the name of the signal, without its message, if absent.
    #[schemars(length(min = 1, max = 200))]
    pub column: Option<String>,
    /// Largest distance that passes, in the signal's unit.
    #[schemars(range(min = 0.0, max = 1e12))]
    pub tolerance: f64,
    /// Rows `(time_seconds, value)`, put in by the loader.
    #[serde(skip)]
    pub rows: Vec<(f64, f64)>,
}

/// Demand of a check; each is a row of the verdict.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Demand<'a> {
    /// Every sample is within the limits.
    Stays(Limit),
    /// Some sample is within the limits.
    Reaches(Limit),
    /// Every rate is within the limits.
    RatePerSecond(Limit),
    /// Every sample is near the course.
    Follows(&'a Course),
}

impl Demand<'_> {
    /// Returns the key of the format that makes the demand.
    pub fn key(&self) -> &'static str {
        match self {
            Self::Stays(_) => "stays",
            Self::Reaches(_) => "reaches",
            Self::RatePerSecond(_) => "rate_per_second",
            Self::Follows(_) => "follows",
        }
    }

    /// Returns the limit of its row, if it is judged in this window.
    pub fn limit(&self, window: Window) -> Limit {
        match self {
            Self::Stays(limit) | Self::RatePerSecond(limit) => *limit,
            Self::Reaches(_) => at_most(rounded(window.until_seconds - window.from_seconds)),
            Self::Follows(course) => at_most(course.tolerance),
        }
    }
}

impl Course {
    /// Returns the value at a scenario time: straight lines through the rows, constant outside.
    pub fn at(&self, time_seconds: f64) -> f64 {
        curve::interpolate(&self.rows, time_seconds).position
    }

    /// Returns the time from the first row to the last.
    pub fn span(&self) -> Option<Window> {
        let (first, last) = (self.rows.first()?, self.rows.last()?);
        // A window ends before its last instant, but the last row counts.
        Some(Window::new(first.0, last.0 + RESOLUTION_SECONDS))
    }

    /// Returns the column to read.
    pub(crate) fn column_for<'a>(&'a self, signal: &'a str) -> &'a str {
        let name = || signal.rsplit_once('.').map_or(signal, |(_, name)| name);
        self.column.as_deref().unwrap_or_else(name)
    }
}

impl SignalCheck {
    /// Returns the demands, in the order of the format.
    pub fn demands(&self) -> impl Iterator<Item = Demand<'_>> {
        let demands = [
            self.stays.map(Demand::Stays),
            self.reaches.map(Demand::Reaches),
            self.rate_per_second.map(Demand::RatePerSecond),
            self.follows.as_ref().map(Demand::Follows),
        ];
        demands.into_iter().flatten()
    }

    /// Returns the window of a demand, in a run of this duration.
    pub fn window(&self, demand: &Demand<'_>, duration_seconds: f64) -> Window {
        let whole = Window::new(0.0, duration_seconds);
        let natural = match demand {
            Demand::Follows(course) => course.span().unwrap_or(whole),
            _ => whole,
        };
        let end = natural.until_seconds.min(duration_seconds);
        let from_seconds = self.from_seconds.unwrap_or(natural.from_seconds);
        Window::new(from_seconds, self.until_seconds.unwrap_or(end))
    }

    /// Returns the rows of its demands in the verdict of a run of this duration.
    pub fn rows(&self, duration_seconds: f64) -> impl Iterator<Item = ExpectedRow> {
        self.demands().map(move |demand| ExpectedRow {
            name: self.row_name(&demand),
            limit: Some(demand.limit(self.window(&demand, duration_seconds))),
            requirements: self.requirements.clone(),
        })
    }

    /// Returns the name of a demand's row in the verdict. A value in another unit than the signal's has that unit at the end of
    /// the name.
    pub fn row_name(&self, demand: &Demand<'_>) -> String {
        let (name, window) = (&self.name, self.window_text());
        match demand {
            Demand::Stays(_) => format!("{name} stays{window}"),
            Demand::Reaches(limit) => format!("{name} reaches {limit}{window} within seconds"),
            Demand::RatePerSecond(_) => format!("{name} rate_per_second{window}"),
            Demand::Follows(course) => format!("{name} follows {}{window}", course.file),
        }
    }

    fn window_text(&self) -> String {
        match (self.from_seconds, self.until_seconds) {
            (None, None) => String::new(),
            (Some(from), None) => format!(" from {from} s"),
            (None, Some(until)) => format!(" until {until} s"),
            (Some(from), Some(until)) => format!(" from {from} to {until} s"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_named_by_what_they_demand_and_when() {
        let text = "name = \"current_amperes\"\nfrom_seconds = 1\nuntil_seconds = 2.5\nstays = { max = 1 }\n\
                    reaches = { min = 0.2, max = 0.3 }\nrate_per_second = { min = -5 }\n\
                    follows = { file = \"golden.csv\", tolerance = 0.1 }";
        let check: SignalCheck = toml::from_str(text).unwrap();
        let names: Vec<String> = check
            .demands()
            .map(|demand| check.row_name(&demand))
            .collect();
        let expected = [
            "current_amperes stays from 1 to 2.5 s",
            "current_amperes reaches 0.2 to 0.3 from 1 to 2.5 s within seconds",
            "current_amperes rate_per_second from 1 to 2.5 s",
            "current_amperes follows golden.csv from 1 to 2.5 s",
        ];
        assert_eq!(names, expected);
    }

    #[test]
    fn a_course_lasts_from_its_first_row_to_its_last_but_not_beyond_the_run() {
        let course = Course {
            file: "golden.csv".to_owned(),
            column: None,
            tolerance: 0.1,
            rows: vec![(0.5, 1.0), (2.0, 4.0)],
        };
        let text = "name = \"drive_tpdo1.current_amperes\"";
        let mut check: SignalCheck = toml::from_str(text).unwrap();
        let demand = Demand::Follows(&course);
        let ends = |check: &SignalCheck, duration_seconds| {
            let window = check.window(&demand, duration_seconds);
            (window.from_seconds, window.until_seconds)
        };
        assert_eq!(ends(&check, 3.0), (0.5, 2.000_001));
        assert_eq!(ends(&check, 1.0), (0.5, 1.0));
        check.from_seconds = Some(0.7);
        assert_eq!(ends(&check, 1.0), (0.7, 1.0));
        assert_eq!((course.at(1.0), course.at(9.0)), (2.0, 4.0));
        assert_eq!(course.column_for(&check.name), "current_amperes");
    }
}
