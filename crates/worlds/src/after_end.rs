//! End of a run that broke off: the drives live until their watches have run out, and are asked then whether they are off.

use std::time::Duration;

use can::CanFrame;
use plan::Plan;
use recording::drive_reports;

/// Time in which all drives answer a request.
pub(crate) const ANSWER_TIME: Duration = Duration::from_millis(20);
/// Delay with which a watch may run out on a busy machine.
const MARGIN: Duration = Duration::from_millis(50);

/// Returns the time after which each drive is off by itself.
pub(crate) fn watch(plan: &Plan) -> Duration {
    let watches = plan.loops.iter().map(drive_reports::watch);
    watches.fold(MARGIN, |longest, watch| longest.max(watch + MARGIN))
}

/// Returns the requests to all drives, in rounds: each drive answers one before it gets the next.
pub(crate) fn requests(plan: &Plan) -> [Vec<CanFrame>; 2] {
    let mut rounds = [Vec::new(), Vec::new()];
    for of_drive in plan.loops.iter().map(drive_reports::requests) {
        let each = rounds.iter_mut().zip(of_drive);
        each.for_each(|(round, request)| round.extend(request));
    }
    rounds
}
