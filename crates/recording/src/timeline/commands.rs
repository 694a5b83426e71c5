//! Cycles with a position but without the command that follows from it.

use std::time::Duration;

use can::CanFrame;
use dbc::{Database, SignalHandle, SignalMissing};
use plan::ControlLoop;
use platform::series::{Series, SeriesWriter};
use scenario::node::Node;

use crate::events::{Event, Events, Level};
use crate::losses::PERIODS_MAX;
use crate::occurrences::Occurrence;

/// Smallest delay after its position from which a command that comes with the next SYNC is late: adapters on USB carry frames in
/// bundles.
const LATE_MIN: Duration = Duration::from_millis(2);

/// Reader of positions and commands. Each command belongs to one cycle: to the one whose position waits for it or, if none waits,
/// to the latest one before its position. A cycle lacks its command if none came before the drive's next position.
pub(super) struct CommandReader {
    position_id: u32,
    command: SignalHandle,
    period: Duration,
    /// Name of the command for the user.
    what: String,
    /// Latest cycle, and whether its position has come.
    cycle: Option<(u64, bool)>,
    /// Whether a command came in it before its position.
    is_early: bool,
    /// Cycle whose position waits for a command, with the position's scenario time.
    waiting: Option<(u64, Duration)>,
    lacking: SeriesWriter<u64>,
    /// Cycles whose command acts a cycle too late: it came after the next SYNC.
    late: SeriesWriter<u64>,
    /// Cycles in a row without their command: scenario time of the first position that waited for one, and their number.
    silence: Option<(Duration, u32)>,
}

impl CommandReader {
    /// Makes a reader that keeps at most `kept_max` cycles of each kind in memory.
    pub(super) fn new(
        database: &Database,
        one: &ControlLoop,
        period: Duration,
        kept_max: usize,
    ) -> Result<Self, SignalMissing> {
        let [controller, drive] = [one.controller(), one.drive()].map(Node::in_sentence);
        let what = match one.loop_name() {
            Some(_) => format!("command from {controller} to {drive}"),
            None => format!("command from {controller}"),
        };
        Ok(Self {
            position_id: one.position(database)?.raw_id(),
            command: one.target(database)?,
            period,
            what,
            cycle: None,
            is_early: false,
            waiting: None,
            lacking: SeriesWriter::keeping(kept_max),
            late: SeriesWriter::keeping(kept_max),
            silence: None,
        })
    }

    /// Begins a cycle.
    pub(super) fn begin_cycle(&mut self, number: u64) {
        (self.cycle, self.is_early) = (Some((number, false)), false);
    }

    /// Takes a frame with this identifier before the scenario's end. A position that comes after the end of its cycle belongs to
    /// none.
    #[inline]
    pub(super) fn on_frame(&mut self, frame: &CanFrame, time: Duration, is_late: bool) {
        let id = frame.raw_id();
        if id == self.command.raw_id() {
            // A command that is too short has no effect.
            if self.command.is_in(frame) {
                self.on_command(time);
            }
        } else if id == self.position_id && !is_late {
            self.on_position(time);
        }
    }

    fn on_command(&mut self, time: Duration) {
        let Some((number, has_position)) = self.cycle else {
            return;
        };
        match self.waiting.take() {
            Some((answered, since))
                if answered < number && time.saturating_sub(since) >= LATE_MIN =>
            {
                self.late.push(answered);
            }
            Some(_) => {}
            None => self.is_early |= !has_position,
        }
        self.silence = None;
    }

    /// Takes the position of the cycle, unless it has one already.
    fn on_position(&mut self, time: Duration) {
        let Some((number, has_position @ false)) = &mut self.cycle else {
            return;
        };
        *has_position = true;
        let next = (!self.is_early).then_some((*number, time));
        if let Some((lacking, since)) = std::mem::replace(&mut self.waiting, next) {
            self.on_lacking(lacking, since);
        }
    }

    fn on_lacking(&mut self, cycle: u64, since: Duration) {
        self.lacking.push(cycle);
        let (_, cycles) = self.silence.get_or_insert((since, 0));
        *cycles = cycles.saturating_add(1);
    }

    /// Takes all cycles without their command, those whose command came a whole cycle late, and a lasting loss; `latest` is the
    /// scenario time of the last frame before the end.
    pub(super) fn take_all(&mut self, latest: Duration) -> (Series<u64>, Series<u64>, Events) {
        let is_due = |(_, since): &(u64, Duration)| latest.saturating_sub(*since) >= self.period;
        if let Some((cycle, since)) = self.waiting.take().filter(is_due) {
            self.on_lacking(cycle, since);
        }
        // A loss takes as many cycles as for any cyclic frame.
        let is_loss = |(_, cycles): &(Duration, u32)| *cycles > PERIODS_MAX;
        let loss = self.silence.take().filter(is_loss).map(|(since, _)| {
            let text = format!("loss: no {} from here on", self.what);
            Occurrence::new(since.as_secs_f64(), Event::new(Level::Error, &text))
        });
        let lacking = self.lacking.take(self.lacking.len());
        let late = self.late.take(self.late.len());
        (lacking, late, loss.into_iter().collect())
    }
}

#[cfg(test)]
mod tests {
    use plan::Plan;

    use super::*;

    fn plan() -> Plan {
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 1.0\n[controller.open_loop]\n";
        testing::plan(text)
    }

    /// Returns the cycles without a command, those with a late one, and the losses. Each cycle is a text of frames, a tenth of its
    /// length apart: `s` a SYNC, `p` a position, `c` a command.
    fn found(milliseconds: u64, cycles: &[&str]) -> (Vec<u64>, Vec<u64>, Vec<(f64, String)>) {
        let micros = |cycle: u64| Duration::from_micros(cycle * 1000 * milliseconds);
        let plan = plan();
        let mut reader =
            CommandReader::new(plan.database(), plan.only_loop().unwrap(), micros(1), 100).unwrap();
        for (number, frames) in (0..).zip(cycles) {
            for (place, letter) in (0..).zip(frames.chars()) {
                let time = micros(number) + Duration::from_micros(100 * milliseconds * place);
                match letter {
                    's' => reader.begin_cycle(number),
                    'p' => reader.on_frame(&CanFrame::new(0x190, &[0; 8]), time, false),
                    'c' => reader.on_frame(&CanFrame::new(0x210, &[0; 4]), time, false),
                    other => panic!("{other}"),
                }
            }
        }
        let (lacking, late, events) = reader.take_all(micros(cycles.len() as u64));
        let events = events
            .iter()
            .map(|event| (event.time_seconds, event.text.clone()));
        (lacking.to_vec(), late.to_vec(), events.collect())
    }

    fn lacking(cycles: &[&str]) -> Vec<u64> {
        found(1, cycles).0
    }

    #[test]
    fn a_cycle_lacks_its_command_where_none_came_before_the_next_position() {
        assert_eq!(lacking(&["spc", "spc", "sp", "spc", "spc"]), [2]);
        assert_eq!(lacking(&["spc", "sp", "sp", "spc"]), [1, 2]);
        // A second position in a cycle does not count.
        assert_eq!(lacking(&["sppc", "spcp", "spc"]), [0; 0]);
        // A command that comes with the next SYNC is in time, and belongs to one cycle only.
        assert_eq!(lacking(&["sp", "scp", "scp", "scp"]), [0; 0]);
        assert_eq!(lacking(&["sp", "scp", "sp", "scp", "sp", "scp"]), [1, 3]);
        // A law that reads another drive's position may command before this drive's came.
        let early = ["scp", "scp", "sp", "scp", "sp", "scp"];
        assert_eq!(
            lacking(&early),
            [3],
            "the first that is late is in time still"
        );
        assert_eq!(
            lacking(&["spcc", "sp", "spc"]),
            [1],
            "one too many is none in advance"
        );
        // Without a position no command is due.
        assert_eq!(lacking(&["spc", "s", "sc", "s", "spc"]), [0; 0]);
        assert_eq!(lacking(&["s", "s"]), [0; 0]);
        // The command of the last cycle is due when a period has passed since its position.
        assert_eq!(lacking(&["spc", "sp"]), [0; 0], "0.9 ms after it");
        assert_eq!(lacking(&["spc", "sp", "s"]), [1]);
    }

    #[test]
    fn a_command_is_late_from_the_next_sync_on() {
        assert_eq!(found(30, &["spc", "spc"]).1, [0; 0]);
        assert_eq!(found(30, &["sp", "sc", "spc"]).1, [0]);
    }

    #[test]
    fn more_than_20_commands_that_do_not_come_any_more_are_a_loss() {
        let cycles = |silent: usize, after: usize| {
            let all = [vec!["spc"; 3], vec!["sp"; silent], vec!["spc"; after]];
            found(1, &all.concat()).2
        };
        // The last position is still waiting.
        assert_eq!(cycles(21, 0), []);
        let loss = "loss: no command from the controller from here on";
        assert_eq!(cycles(22, 0), [(0.0031, loss.to_owned())]);
        assert_eq!(cycles(22, 1), []);
    }
}
