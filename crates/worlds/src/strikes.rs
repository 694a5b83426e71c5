//! What happens to the controller's process in real time: a crash is a SIGKILL, a hang a SIGSTOP.

use std::collections::VecDeque;
use std::time::Duration;

use faults::{Kind, Plan};
use scenario::Scenario;
use scenario::fault::node::Node;

/// What is done to a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Strike {
    /// SIGKILL.
    Kill,
    /// A new process in its place.
    Start,
    /// SIGSTOP.
    Freeze,
    /// SIGCONT.
    Thaw,
}

/// The strikes of a scenario, in the order of scenario time.
pub(super) struct Strikes(VecDeque<(Duration, Strike)>);

impl Strikes {
    pub(super) fn new(scenario: &Scenario) -> Self {
        let plan = Plan::of(&scenario.fault, Node::Controller);
        let strikes = plan.faults.iter().flat_map(|fault| {
            let (begin, end) = match fault.kind {
                Kind::Crash(_) => (Strike::Kill, Strike::Start),
                Kind::Hang => (Strike::Freeze, Strike::Thaw),
                _ => return Vec::new(),
            };
            vec![(fault.from, begin), (fault.until, end)]
        });
        let mut strikes: Vec<_> = strikes.collect();
        strikes.sort_by_key(|(time, _)| *time);
        Self(strikes.into())
    }

    /// The next strike, once its time has come.
    pub(super) fn due(&mut self, scenario_time: Duration) -> Option<Strike> {
        let is_due = |strike: &mut (Duration, Strike)| strike.0 <= scenario_time;
        self.0.pop_front_if(is_due).map(|(_, strike)| strike)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crash_that_ends_kills_and_starts_and_a_drives_is_not_of_its_process() {
        let text = "schema = 1\nname = \"t\"\nduration_seconds = 9.0\n[controller.open_loop]\n\
            [[fault.node.crash]]\nfrom_seconds = 3.0\nuntil_seconds = 4.0\nnode = \"controller\"\n\
            [[fault.node.hang]]\nfrom_seconds = 1.0\nnode = \"controller\"\n\
            [[fault.node.crash]]\nfrom_seconds = 2.0\nnode = \"drive\"\n";
        let scenario = Scenario::parse(text, "t.toml", |_| unreachable!("no table")).unwrap();
        let mut strikes = Strikes::new(&scenario);
        assert_eq!(strikes.due(Duration::ZERO), None);
        let all: Vec<_> = std::iter::from_fn(|| strikes.due(Duration::from_secs(5))).collect();
        assert_eq!(all, [Strike::Freeze, Strike::Kill, Strike::Start]);
    }
}
