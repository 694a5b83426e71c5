//! Hard limits of a rig: the controller keeps to them, and the bench watches that all nodes do.

use std::time::Duration;

use super::Limits;
use super::drive::Feedback;
use dbc::Unit;

/// Shortest window of a speed, or two cycles if that is longer: a step of a converter is no speed.
const SPEED_WINDOW: Duration = Duration::from_millis(20);
/// Share by which a measured current may exceed the limit, unlike a command. Assumed: the rig file does not have the drive's
/// accuracy.
const MEASURED_CURRENT_TOLERANCE: f64 = 0.05;
/// Tolerance for the rounding of commands to whole units of an object.
const COMMAND_TOLERANCE_AMPERES: f64 = 1e-9;

/// Watch over the limits from sample to sample.
#[derive(Clone, Copy, Debug)]
pub struct LimitWatch {
    limits: Limits,
    window: Duration,
    /// Time and position at the start of the window.
    since: Option<(Duration, f64)>,
    /// Unit of positions in messages.
    symbol: &'static str,
}

impl LimitWatch {
    /// Makes a watch that has seen no sample; the drive's positions are in `unit`.
    pub fn new(limits: &Limits, sync_period: Duration, unit: &Unit) -> Self {
        Self {
            limits: *limits,
            window: SPEED_WINDOW.max(2 * sync_period),
            since: None,
            symbol: unit.known_symbol(),
        }
    }

    /// Checks a sample of the drive, and describes the violation of a limit.
    pub fn check(&mut self, now: Duration, feedback: &Feedback) -> Option<String> {
        let limit = self.limits.current_amperes;
        let amperes = feedback.output.unwrap_or(0.0);
        if amperes.abs() > limit * (1.0 + MEASURED_CURRENT_TOLERANCE) {
            return Some(format!(
                "limit of the rig: {amperes:.3} A flow (limit {limit} A)"
            ));
        }
        let (position, symbol) = (feedback.position, self.symbol);
        let Limits { min, max, .. } = self.limits;
        if !(min..=max).contains(&position) {
            return Some(format!(
                "limit of the rig: the position is {position:.2} {symbol} (limits {min} to {max} {symbol})"
            ));
        }
        self.check_speed(now, position)
    }

    /// Checks a command to the drive, and describes the violation of a limit.
    pub fn check_command(&self, amperes: f64) -> Option<String> {
        let limit = self.limits.current_amperes;
        let is_beyond = amperes.abs() > limit + COMMAND_TOLERANCE_AMPERES;
        is_beyond
            .then(|| format!("limit of the rig: {amperes:.3} A are commanded (limit {limit} A)"))
    }

    fn check_speed(&mut self, now: Duration, position: f64) -> Option<String> {
        let (start, before) = *self.since.get_or_insert((now, position));
        let elapsed = now.saturating_sub(start);
        if elapsed < self.window {
            return None;
        }
        self.since = Some((now, position));
        let rate = (position - before).abs() / elapsed.as_secs_f64();
        let (limit, symbol) = (self.limits.rate_max, self.symbol);
        (rate > limit).then(|| {
            format!(
                "limit of the rig: the load moves at {rate:.0} {symbol}/s (limit {limit} {symbol}/s)"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watch() -> LimitWatch {
        let limits = Limits {
            current_amperes: 0.9,
            min: -1.0,
            max: 45.0,
            rate_max: 400.0,
        };
        LimitWatch::new(&limits, Duration::from_millis(5), &Unit::Millimetres)
    }

    fn sample(millimetres: f64, amperes: f64) -> Feedback {
        Feedback {
            statusword: 0x0237,
            position: millimetres,
            output: Some(amperes),
        }
    }

    #[test]
    fn each_limit_is_watched_and_named() {
        let check =
            |millimetres, amperes| watch().check(Duration::ZERO, &sample(millimetres, amperes));
        assert_eq!(
            check(44.9, 0.94),
            None,
            "within the tolerance of a measurement"
        );
        assert_eq!(
            check(10.0, 0.96).unwrap(),
            "limit of the rig: 0.960 A flow (limit 0.9 A)"
        );
        assert_eq!(check(10.0, -0.94), None);
        assert_eq!(check(10.0, 0.9 * 1.05), None, "the limit itself");
        assert_eq!(
            check(10.0, -0.96).unwrap(),
            "limit of the rig: -0.960 A flow (limit 0.9 A)"
        );
        assert_eq!(
            check(-1.5, 0.0).unwrap(),
            "limit of the rig: the position is -1.50 mm (limits -1 to 45 mm)"
        );
        assert!(check(45.1, 0.0).is_some() && check(f64::NAN, 0.0).is_some());
        assert_eq!(
            watch().check_command(0.901).unwrap(),
            "limit of the rig: 0.901 A are commanded (limit 0.9 A)"
        );
        assert_eq!(
            watch().check_command(-0.901).unwrap(),
            "limit of the rig: -0.901 A are commanded (limit 0.9 A)"
        );
        for allowed in [0.9, -0.9, 0.9 + COMMAND_TOLERANCE_AMPERES] {
            assert_eq!(watch().check_command(allowed), None);
        }
    }

    #[test]
    fn a_speed_is_a_mean_over_20_ms() {
        let run = |millimetres_per_cycle: f64| {
            let mut watch = watch();
            (0..20_u32).find_map(|cycle| {
                let now = Duration::from_millis(5) * cycle;
                watch.check(now, &sample(millimetres_per_cycle * f64::from(cycle), 0.0))
            })
        };
        for slow in [1.9, 2.0, -0.04] {
            assert_eq!(run(slow), None, "380 and 400 mm/s up, 8 mm/s down");
        }
        let expected = "limit of the rig: the load moves at 420 mm/s (limit 400 mm/s)";
        assert_eq!(run(2.1).as_deref(), Some(expected));
        // Downwards, from a place from which the load does not leave its range.
        let mut falling = watch();
        let down = (0..5_u32).find_map(|cycle| {
            let now = Duration::from_millis(5) * cycle;
            falling.check(now, &sample(40.0 - 2.1 * f64::from(cycle), 0.0))
        });
        assert_eq!(down.as_deref(), Some(expected));
        // One step of a coarse converter.
        let mut watch = watch();
        let jump = [0.0, 3.0, 3.0, 3.0, 3.0, 3.0];
        let times = (0..).map(|cycle| Duration::from_millis(5) * cycle);
        let found = times
            .zip(jump)
            .find_map(|(now, at)| watch.check(now, &sample(at, 0.0)));
        assert_eq!(found, None, "150 mm/s on average");
    }
}
