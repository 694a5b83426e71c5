//! Faults of processes in real time, the controller's and those of programs: a crash is a SIGKILL, a hang a SIGSTOP.

use std::collections::VecDeque;
use std::time::Duration;

use plan::Plan;

use crate::programs::faults_at;

/// Action on a process that plays a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ProcessAction {
    /// SIGKILL.
    Kill,
    /// Start of a new process in its place.
    Start,
    /// SIGSTOP.
    Suspend,
    /// SIGCONT.
    Resume,
}

/// Actions of a scenario's faults on these processes, by the names of their nodes, in the order of scenario time.
pub(super) struct ProcessFaults(VecDeque<(Duration, String, ProcessAction)>);

impl ProcessFaults {
    pub(super) fn new(plan: &Plan) -> Self {
        let controller = plan.nodes.manager();
        let programs = plan
            .external_nodes()
            .filter(|node| plan.nodes[*node].program().is_some() && *node != controller);
        let mut actions = Vec::new();
        for index in programs.chain([controller]) {
            let node = &plan.nodes[index];
            for fault in faults_at(plan, index).faults {
                let (begin, end) = match fault.name() {
                    "crash" => (ProcessAction::Kill, ProcessAction::Start),
                    "hang" => (ProcessAction::Suspend, ProcessAction::Resume),
                    _ => continue,
                };
                actions.push((fault.from, node.name.clone(), begin));
                actions.push((fault.until, node.name.clone(), end));
            }
        }
        actions.sort_by_key(|(time, ..)| *time);
        Self(actions.into())
    }

    /// Returns the next action with its node, once its time has come.
    pub(super) fn due(&mut self, scenario_time: Duration) -> Option<(String, ProcessAction)> {
        let is_due = |action: &mut (Duration, String, ProcessAction)| action.0 <= scenario_time;
        let action = self.0.pop_front_if(is_due);
        action.map(|(_, name, action)| (name, action))
    }
}

#[cfg(test)]
mod tests {

    use super::*;

    #[test]
    fn a_crash_that_ends_kills_and_starts_and_a_drives_is_not_of_its_process() {
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 9.0\n[controller.open_loop]\n\
            [[fault.node.crash]]\nfrom_seconds = 3.0\nuntil_seconds = 4.0\nnode = \"controller\"\n\
            [[fault.node.hang]]\nfrom_seconds = 1.0\nnode = \"controller\"\n\
            [[fault.node.crash]]\nfrom_seconds = 2.0\nnode = \"drive\"\n";
        let plan = testing::plan(text);
        let mut actions = ProcessFaults::new(&plan);
        assert_eq!(actions.due(Duration::ZERO), None);
        let all = std::iter::from_fn(|| actions.due(Duration::from_secs(5)));
        let all = Vec::from_iter(all.map(|(name, action)| {
            assert_eq!(name, "controller");
            action
        }));
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
