//! What happens to the controller's process in real time: a crash is a SIGKILL, a hang a SIGSTOP.

use std::collections::VecDeque;
use std::time::Duration;

use faults::FaultKind;
use plan::Plan;

use crate::nodes::controller_faults;

/// What is done to a process to play a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ProcessAction {
    /// SIGKILL.
    Kill,
    /// A new process in its place.
    Start,
    /// SIGSTOP.
    Suspend,
    /// SIGCONT.
    Resume,
}

/// What a scenario's faults do to the controller's process, in the order of scenario time.
pub(super) struct ProcessFaults(VecDeque<(Duration, ProcessAction)>);

impl ProcessFaults {
    pub(super) fn new(plan: &Plan) -> Self {
        let faults = controller_faults(plan).faults;
        let mut actions: Vec<_> = faults
            .iter()
            .flat_map(|fault| {
                let (begin, end) = match fault.kind {
                    FaultKind::Crash(_) => (ProcessAction::Kill, ProcessAction::Start),
                    FaultKind::Hang => (ProcessAction::Suspend, ProcessAction::Resume),
                    _ => return Vec::new(),
                };
                vec![(fault.from, begin), (fault.until, end)]
            })
            .collect();
        actions.sort_by_key(|(time, _)| *time);
        Self(actions.into())
    }

    /// The next action, once its time has come.
    pub(super) fn due(&mut self, scenario_time: Duration) -> Option<ProcessAction> {
        let is_due = |action: &mut (Duration, ProcessAction)| action.0 <= scenario_time;
        self.0.pop_front_if(is_due).map(|(_, action)| action)
    }
}

#[cfg(test)]
mod tests {
    use plan::catalogue::Catalogue;
    use scenario::Trial;

    use super::*;

    #[test]
    fn a_crash_that_ends_kills_and_starts_and_a_drives_is_not_of_its_process() {
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 9.0\n[controller.open_loop]\n\
            [[fault.node.crash]]\nfrom_seconds = 3.0\nuntil_seconds = 4.0\nnode = \"controller\"\n\
            [[fault.node.hang]]\nfrom_seconds = 1.0\nnode = \"controller\"\n\
            [[fault.node.crash]]\nfrom_seconds = 2.0\nnode = \"drive\"\n";
        let scenario = Trial::parse(text, "t.toml", |_| unreachable!("no table")).unwrap();
        let plan = Plan::new(scenario, &Catalogue::shipped());
        let mut actions = ProcessFaults::new(&plan);
        assert_eq!(actions.due(Duration::ZERO), None);
        let all: Vec<_> = std::iter::from_fn(|| actions.due(Duration::from_secs(5))).collect();
        assert_eq!(
            all,
            [
                ProcessAction::Suspend,
                ProcessAction::Kill,
                ProcessAction::Start
            ]
        );
    }
}
