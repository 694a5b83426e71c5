//! The `[expect.timing]` table: limits on real time, which are judged only if the clock can be trusted.

use schemars::JsonSchema;
use serde::Deserialize;

use crate::limit::Limit;

/// Limits on median and tail of a distribution.
#[derive(Clone, Copy, Debug, Default, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct QuantileLimits {
    /// Half of the values are not above it.
    pub median: Option<Limit>,
    /// 99 % of the values are not above it.
    pub p99: Option<Limit>,
    /// 99.9 % of the values are not above it.
    pub p99_9: Option<Limit>,
    /// The largest value.
    pub max: Option<Limit>,
}

/// Limits on the timing of a run in real time; virtual time has none. If real-time priority was refused, or if the machine held
/// the nodes up, the run is inconclusive.
#[derive(Clone, Copy, Debug, Default, Deserialize, JsonSchema, PartialEq)]
#[serde(deny_unknown_fields, default)]
pub struct TimingLimits {
    /// Lateness of the nodes' loops on wake-up, the worse of controller and plant emulator.
    pub wake_up_lateness_microseconds: QuantileLimits,
    /// Time from the SYNC to the drive's position.
    pub sync_to_position_microseconds: QuantileLimits,
    /// Time from the drive's position to the command that follows from it.
    pub position_to_command_microseconds: QuantileLimits,
    /// Time from the SYNC to the command.
    pub round_trip_microseconds: QuantileLimits,
    /// Frames of canrig's nodes that waited for room in the full queue of the bus (ENOBUFS); one that waits for 50 ms ends
    /// the run.
    pub frames_delayed: Option<Limit>,
}

impl TimingLimits {
    /// Returns the limits that are given, each with its path below `[expect.timing]`.
    pub fn limits(&self) -> impl Iterator<Item = (String, Limit)> + use<> {
        let distributions = [
            (
                "wake_up_lateness_microseconds",
                self.wake_up_lateness_microseconds,
            ),
            (
                "sync_to_position_microseconds",
                self.sync_to_position_microseconds,
            ),
            (
                "position_to_command_microseconds",
                self.position_to_command_microseconds,
            ),
            ("round_trip_microseconds", self.round_trip_microseconds),
        ];
        let delayed = self
            .frames_delayed
            .map(|limit| ("frames_delayed".to_owned(), limit));
        let quantiles = distributions.into_iter().flat_map(|(name, limits)| {
            let limits = [
                ("median", limits.median),
                ("p99", limits.p99),
                ("p99_9", limits.p99_9),
                ("max", limits.max),
            ];
            let given = move |(quantile, limit): (&str, Option<Limit>)| {
                limit.map(|limit| (format!("{name}.{quantile}"), limit))
            };
            limits.into_iter().filter_map(given)
        });
        quantiles.chain(delayed)
    }

    /// Returns the rows of the verdict for the limits.
    pub fn rows(&self) -> impl Iterator<Item = String> + use<> {
        self.limits().map(|(path, _)| path.replace('.', "_"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limits_that_are_given_are_listed_with_their_paths() {
        let text = "round_trip_microseconds = { p99 = { max = 800.0 }, max = { max = 1000.0 } }";
        let limits: TimingLimits = toml::from_str(text).unwrap();
        let paths: Vec<String> = limits.limits().map(|(path, _)| path).collect();
        let expected = ["round_trip_microseconds.p99", "round_trip_microseconds.max"];
        assert_eq!(paths, expected);
        assert!(
            limits
                .rows()
                .eq(expected.map(|path| path.replace('.', "_")))
        );
        let none = TimingLimits::default();
        assert!(none.limits().next().is_none() && limits.limits().next().is_some());
    }
}
