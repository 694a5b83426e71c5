//! The current profile of `[controller.open_loop]`, prepared for a look-up in every cycle.

use crate::controller::OpenLoop;
use crate::curve::{Piece, Trajectory};

impl OpenLoop {
    /// Prepares the profile for a look-up in every cycle: its positions are the currents in amperes. The piece that started last
    /// acts, 0 A before the first.
    pub fn profile(&self) -> Trajectory {
        let steps = self.step.iter().map(|step| {
            let value = step.current;
            (step.at_seconds, Piece::Constant { value })
        });
        let ramps = self.ramp.iter().map(|ramp| {
            let (until_seconds, end) = (ramp.until_seconds, ramp.current);
            (ramp.from_seconds, Piece::Line { until_seconds, end })
        });
        let tables = self.table.iter().map(|table| {
            let rows = table.rows.clone();
            (table.from_seconds, Piece::Table { rows })
        });
        Trajectory::new(steps.chain(ramps).chain(tables).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::{CurrentRamp, CurrentStep};

    #[test]
    fn up_and_down_in_forty_seconds() {
        let ramp = |from_seconds, until_seconds, current| CurrentRamp {
            from_seconds,
            until_seconds,
            current,
        };
        let mut open_loop = OpenLoop {
            ramp: vec![ramp(0.0, 20.0, 1.0), ramp(20.0, 40.0, 0.0)],
            ..OpenLoop::default()
        };
        for (time, amperes) in [
            (0.0, 0.0),
            (10.0, 0.5),
            (20.0, 1.0),
            (30.0, 0.5),
            (41.0, 0.0),
        ] {
            assert_eq!(open_loop.profile().at(time).position, amperes, "at {time}");
        }
        open_loop.step.push(CurrentStep {
            at_seconds: 42.0,
            current: 0.6,
        });
        assert_eq!(open_loop.profile().at(42.0).position, 0.6);
    }
}
