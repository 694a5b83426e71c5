//! End of a run that broke off: the drives live until their watches have run out, and are asked then whether they are off.

use std::time::Duration;

use can::CanFrame;
use plan::Plan;
use recording::drive_reports;

/// Time in which all drives answer a request.
const ANSWER_TIME: Duration = Duration::from_millis(20);
/// Delay with which a watch may run out on a busy machine.
const MARGIN: Duration = Duration::from_millis(50);

/// Returns the requests to all drives in rounds, each with the time until the next: first the time after which each drive is off
/// by itself, then two rounds, since each drive answers one request before it gets the next.
pub(crate) fn rounds(plan: &Plan) -> [(Vec<CanFrame>, Duration); 3] {
    let watches = plan.loops.iter().map(drive_reports::watch);
    let off = watches.fold(MARGIN, |longest, watch| longest.max(watch + MARGIN));
    let request = |one| drive_reports::requests(plan.database(), one);
    let requests = Vec::from_iter(plan.loops.iter().map(request));
    let round = |number: usize| requests.iter().filter_map(|each| each[number]).collect();
    [
        (Vec::new(), off),
        (round(0), ANSWER_TIME),
        (round(1), ANSWER_TIME),
    ]
}
