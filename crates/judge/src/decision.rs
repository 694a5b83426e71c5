//! Decides the outcome of a run by its metrics, the attribution of its missed cycles, and the node that ended it.

use std::collections::BTreeSet;

use plan::Plan;
use recording::ending::{EarlyEnd, EndedBy};
use recording::events::{Event, Level};
use recording::occurrences::Occurrence;
use recording::timeline::Timeline;
use recording::unrecorded::Unrecorded;
use recording::work::Pass;
use scenario::expect::rounded;
use scenario::metrics::is_traffic_metric;

use crate::attribution::breaches::Duty;
use crate::attribution::cause::{Lasting, NamedCause, node_name};
use crate::attribution::limits::open_limits;
use crate::attribution::{Cause, Commands, Totals};
use crate::circumstances::Circumstances;
use crate::duties::{
    LATE_COMMANDS, MISSED_COMMANDS, MISSED_CYCLES, PERIODS, SYNC_PERIOD_ERROR,
    largest_period_error, limited_max, percent_max,
};
use crate::evidence::Evidence;
use crate::loops::whole;
use crate::metric::{Metric, Unstored, leave_open, not_judged};
use crate::metrics::metrics;
use crate::off::{DRIVE_OFF, drive_off};
use crate::quality::{FOREIGN, cut_short, incomplete_recording, two_sources};
use crate::verdict::{Outcome, Verdict};

/// Largest number of losses in a verdict.
const LOSSES_MAX: usize = 20;
/// Bus load from which on a cycle with more frames than the others does not end in its time.
const BUSY_BUS_PERCENT: f64 = 70.0;

/// Duty of a drive that violated a limit of its rig, in `verdict.json`.
const LIMIT: &str = "limit";

/// Name of the metric that decides before all others: on an overloaded bus no other metric has a meaning.
const BUS_LOAD: &str = "bus_load_percent";

/// Largest load that a bus can carry: 100 %, and some room for the stamps of short recordings.
const LOAD_PERCENT_MAX: f64 = 101.0;

/// Outcome, with its reason if the metrics do not show it, and the cause if a duty was not done.
type Decision = (Outcome, Option<String>, Option<NamedCause>);

/// Judges a run by the timelines of its loops. Takes as long as one pass over the frames.
pub fn judge(plan: &Plan, timelines: &[Timeline], circumstances: &Circumstances) -> Verdict {
    let loops = Vec::from_iter(plan.loops.iter().zip(timelines));
    let mut pass = Pass::new(loops.len() as u64);
    let end = circumstances
        .ended_early
        .as_ref()
        .filter(|end| end.by == EndedBy::Node);
    let evidence = loops.iter().map(|(control_loop, timeline)| {
        Evidence::new(plan.database(), timeline, control_loop, circumstances)
            .among(&plan.shared.contours, &loops)
    });
    let all = Vec::from_iter(evidence);
    let found = end.map(|end| broke_off(&all, end));
    // For loops whose nodes did not cause it, the end is that of the bench.
    let mut elsewhere = circumstances.clone();
    if let Some(end) = &mut elsewhere.ended_early {
        end.by = EndedBy::Bench;
    }
    let verdicts = all.iter().map(|evidence| {
        let broke_off = found.as_ref();
        let verdict = match broke_off.and_then(|end| end.node_elsewhere(evidence)) {
            None => judge_loop(plan, evidence, broke_off),
            Some(node) => {
                let cut = Evidence::new(
                    plan.database(),
                    evidence.timeline,
                    evidence.control_loop,
                    &elsewhere,
                )
                .among(evidence.contours, evidence.loops);
                let verdict = judge_loop(plan, &cut, broke_off);
                ended_elsewhere(verdict, node, end)
            }
        };
        pass.advance(1);
        verdict
    });
    let verdict = whole(plan, verdicts.collect());
    let until_seconds = all.first().map_or(f64::INFINITY, Evidence::end_seconds);
    let told = fd_frames(&circumstances.unrecorded).into_iter();
    Verdict {
        losses: told.chain(losses(timelines, until_seconds)).collect(),
        ..verdict
    }
}

/// Returns the verdict of a loop whose nodes did not cause the end of the run: values that are missing because of it are not
/// judged.
fn ended_elsewhere(mut verdict: Verdict, node: &str, end: Option<&EarlyEnd>) -> Verdict {
    let is_unseen = |row: &&mut Metric| {
        row.value.is_none() && row.passed != Some(false) && row.name != DRIVE_OFF
    };
    for row in verdict.metrics.iter_mut().filter(is_unseen) {
        row.remark = Some(format!("not judged, ended by {node}"));
    }
    verdict.ended_early = end.cloned();
    verdict
}

/// Returns the verdict of one loop. The contours are among the rows of their first loop.
fn judge_loop(plan: &Plan, evidence: &Evidence<'_>, broke_off: Option<&BrokeOff>) -> Verdict {
    let circumstances = evidence.circumstances;
    let mut metrics = metrics(evidence);
    let (outcome, reason, cause) = match &circumstances.ended_early {
        None => decide(evidence, &mut metrics),
        Some(end) => {
            // A value that a node kept from being seen is missed. If the bench broke off, only the traffic is meaningful.
            let is_kept = |metric: &Metric| {
                broke_off.is_some() || is_traffic_metric(&metric.name) && metric.value.is_some()
            };
            metrics.retain(is_kept);
            let foreign = two_sources(evidence).filter(|_| end.by != EndedBy::User);
            let decision = decide_broken(end, broke_off, foreign, &mut metrics);
            let off = drive_off(evidence, end);
            let decision = with_drive(evidence, off.as_ref(), decision);
            metrics.extend(off);
            decision
        }
    };
    let unrecorded = &circumstances.unrecorded;
    Verdict {
        is_open_for_stalls: Unstored(
            outcome == Outcome::Inconclusive && is_open_for_stalls(cause.as_ref(), &metrics),
        ),
        has_unexplained_breach: Unstored(has_unexplained_breach(evidence)),
        outcome,
        reason,
        cause,
        frames_lost: unrecorded.frames_lost,
        fd_frames: unrecorded.fd_frames,
        ended_early: circumstances.ended_early.clone(),
        metrics,
        ..Verdict::incomplete_run(plan, "")
    }
}

/// Returns whether only stalls keep an inconclusive run from being decided: they are its cause, and
/// no limit is on a value that no node sends.
fn is_open_for_stalls(cause: Option<&NamedCause>, metrics: &[Metric]) -> bool {
    let is_unavailable = |row: &Metric| row.limit.is_some() && row.is_unavailable.0;
    // A run without a foreign source of frames is inconclusive for a cause only if that is a stall.
    cause.is_some_and(|cause| cause.node != FOREIGN) && !metrics.iter().any(is_unavailable)
}

/// Returns whether a node under test broke a duty in real time, and neither a stall nor a fault
/// explains it.
fn has_unexplained_breach(evidence: &Evidence<'_>) -> bool {
    let host = &evidence.circumstances.host;
    let is_virtual = host.controller.is_none() && host.plant_emulator.is_none();
    if is_virtual && host.stalls.is_empty() {
        return false;
    }
    let one = evidence.control_loop;
    let is_under_test = |duty: Duty| one.node(duty.node(one)).is_under_test;
    let commands = [Commands::Missed, Commands::Late].map(|kind| kind.totals(evidence));
    let totals = commands.iter().chain([&evidence.attribution.cycles]);
    totals.flat_map(Totals::broken_by_nodes).any(is_under_test)
}

/// Cause of a run that broke off.
struct BrokeOff {
    cause: NamedCause,
    /// Whether the host is the cause.
    is_of_host: bool,
    /// Whether a fault of the scenario made the end look like a node's.
    is_of_fault: bool,
}

impl BrokeOff {
    /// Returns the node of the cause, if it is the drive of another loop.
    fn node_elsewhere(&self, evidence: &Evidence<'_>) -> Option<&str> {
        let node = self.cause.node.as_str();
        let mut loops = evidence.loops.iter();
        let is_drive = loops.any(|(one, _)| one.drive().name == node);
        (is_drive && !is_in_loop(evidence, node)).then_some(node)
    }
}

/// Returns whether a node is the controller or the drive of a loop.
fn is_in_loop(evidence: &Evidence<'_>, node: &str) -> bool {
    let one = evidence.control_loop;
    one.controller().name == node || one.drive().name == node
}

/// Returns the earliest breach of all loops that lasts to an end caused by a node, or else the end itself.
fn broke_off(all: &[Evidence<'_>], end: &EarlyEnd) -> BrokeOff {
    if let Some(violation) = violation(all, end) {
        return violation;
    }
    let lasting = all.iter().filter_map(|evidence| {
        let lasting = Lasting::earliest(evidence, Some(end.at_seconds?))?;
        Some((lasting, evidence))
    });
    let earliest =
        lasting.min_by(|(one, _), (other, _)| one.from_seconds.total_cmp(&other.from_seconds));
    if let Some((lasting, evidence)) = earliest {
        return BrokeOff {
            cause: lasting.named(evidence),
            is_of_host: matches!(lasting.cause, Cause::Host(_)),
            is_of_fault: false,
        };
    }
    let ended_by = end.node.as_deref().unwrap_or_default();
    let concerns = |evidence: &&Evidence<'_>| is_in_loop(evidence, ended_by);
    // All loops feel a stall that held up a node outside the loops.
    let concerns_none = !all.iter().any(|evidence| concerns(&evidence));
    let mut concerned = all.iter().filter(|one| concerns_none || concerns(one));
    let stall = concerned.find_map(|evidence| {
        let stretch = evidence.stall_of_end(end)?;
        Some(NamedCause::by_stall(evidence, &stretch, "end"))
    });
    BrokeOff {
        is_of_host: stall.is_some(),
        is_of_fault: false,
        cause: stall.unwrap_or_else(|| NamedCause {
            node: end.node.clone().unwrap_or_default(),
            duty: "end".to_owned(),
            at_seconds: end.since_seconds.or(end.at_seconds),
            description: end.to_string(),
        }),
    }
}

/// Returns the end by a drive that violated a limit of its rig, unless a duty that the drive had
/// broken before explains it, or a fault changed the frame that shows it.
fn violation(all: &[Evidence<'_>], end: &EarlyEnd) -> Option<BrokeOff> {
    let at = end.at_seconds.filter(|_| end.is_rig_limit)?;
    let drive = end.node.clone().unwrap_or_default();
    let evidence = all
        .iter()
        .find(|evidence| evidence.control_loop.drive().name == drive)?;
    let one = evidence.control_loop;
    let lasting = Lasting::earliest(evidence, Some(at));
    if lasting.is_some_and(|lasting| lasting.duty.node(one) == one.drive_index()) {
        return None;
    }
    let is_of_fault = evidence.attribution.hits.changed_value(at);
    let (node, description) = if is_of_fault {
        let description = format!("a fault of the scenario changes frames ({end})");
        ("fault".to_owned(), description)
    } else if Duty::Command.is_of_external(evidence.control_loop) {
        let controller = &evidence.control_loop.controller().name;
        (
            drive,
            format!("{end}; the {controller} that leads it is under test, too"),
        )
    } else {
        (drive, end.to_string())
    };
    Some(BrokeOff {
        cause: NamedCause {
            node,
            duty: LIMIT.to_owned(),
            at_seconds: Some(rounded(at)),
            description,
        },
        is_of_host: false,
        is_of_fault,
    })
}

/// Decides a run that broke off. Its traffic is reported, and so are its failures until then. An end by a node is a failure,
/// unless the host is the cause. A bus that is loaded beyond its limit is a failed limit, with the consequence as the reason.
fn decide_broken(
    end: &EarlyEnd,
    broke_off: Option<&BrokeOff>,
    foreign: Option<NamedCause>,
    metrics: &mut [Metric],
) -> Decision {
    if let Some(reason) = overload(metrics) {
        return (Outcome::Fail, Some(format!("{reason}; {end}")), None);
    }
    if let Some(cause) = foreign {
        metrics.iter_mut().for_each(leave_open);
        let reason = format!("{}; {end}", cause.description);
        return (Outcome::Inconclusive, Some(reason), Some(cause));
    }
    let Some(broke_off) = broke_off else {
        return (Outcome::Incomplete, Some(end.to_string()), None);
    };
    let cause = Some(broke_off.cause.clone());
    let description = &broke_off.cause.description;
    if broke_off.is_of_host {
        metrics.iter_mut().for_each(leave_open);
        let reason = format!(
            "{description}, so the end of the run proves nothing ({end}); run it again or use --clock lockstep"
        );
        return (Outcome::Inconclusive, Some(reason), cause);
    }
    if broke_off.is_of_fault {
        metrics.iter_mut().for_each(leave_open);
        return (Outcome::Inconclusive, Some(description.clone()), cause);
    }
    // The end follows from a cause elsewhere by the watch of another node.
    let reason = if broke_off.cause.node != end.node.as_deref().unwrap_or_default() {
        format!("{description}; {end}")
    } else if broke_off.cause.duty == LIMIT {
        description.clone()
    } else {
        end.to_string()
    };
    (Outcome::Fail, Some(reason), cause)
}

/// Fails a run that broke off if its drive was not off afterwards, whatever the other decision.
fn with_drive(evidence: &Evidence<'_>, off: Option<&Metric>, decision: Decision) -> Decision {
    let Some(on) = off.filter(|off| off.passed == Some(false)) else {
        return decision;
    };
    let description = on.remark.clone().unwrap_or_default();
    let (_, reason, cause) = decision;
    let reason = match reason {
        Some(reason) => format!("{description}; {reason}"),
        None => description.clone(),
    };
    let cause = cause.unwrap_or_else(|| NamedCause {
        node: evidence.control_loop.drive().name.clone(),
        duty: "off".to_owned(),
        at_seconds: on.at_seconds,
        description,
    });
    (Outcome::Fail, Some(reason), Some(cause))
}

/// Decides a run that was played to its end, or a recording that ends somewhere. Opens the limits that stalls explain.
fn decide(evidence: &Evidence<'_>, metrics: &mut [Metric]) -> Decision {
    if let Some(reason) = overload(metrics) {
        return (Outcome::Fail, Some(reason), None);
    }
    // With a foreign source of frames, the run does not show how the nodes under test behave.
    if let Some(cause) = two_sources(evidence) {
        let reason = Some(cause.description.clone());
        return (Outcome::Inconclusive, reason, Some(cause));
    }
    let unrecorded = &evidence.circumstances.unrecorded;
    // Frames that are missing in the log may have been on the bus.
    let is_log_whole = unrecorded.unreadable_lines.is_none();
    if let Some((reason, cause)) = breached(evidence).filter(|_| is_log_whole) {
        return (Outcome::Fail, Some(reason), Some(cause));
    }
    if let Some(reason) = incomplete_recording(unrecorded).or_else(|| unexplained(evidence)) {
        return (Outcome::Inconclusive, Some(reason), None);
    }
    let opened = open_limits(evidence, metrics);
    let is_failed = |metric: &Metric| metric.passed == Some(false);
    if let Some(reason) = cut_short(evidence.timeline, evidence.control_loop) {
        return (Outcome::Incomplete, Some(reason), None);
    }
    if metrics.iter().any(is_failed) {
        return (Outcome::Fail, None, None);
    }
    let opened = opened.map(|reason| {
        let stall = evidence.longest_stall();
        let cause = stall.map(|stall| NamedCause::by_stall(evidence, &stall, "sync"));
        (Outcome::Inconclusive, Some(reason), cause)
    });
    opened.unwrap_or_else(|| {
        let open = not_judged(metrics)
            .or_else(|| unknown_load(metrics, unrecorded))
            .or_else(|| not_recovered(evidence));
        match open {
            None => (Outcome::Pass, None, None),
            reason => (Outcome::Inconclusive, reason, None),
        }
    })
}

/// Returns the reason why a run fails whose nodes broke their duties: too often for the limit of the scenario or the default, or
/// from some time on to the end.
fn breached(evidence: &Evidence<'_>) -> Option<(String, NamedCause)> {
    let cycles = &evidence.attribution.cycles;
    let silent = silent_at_end(evidence);
    let too_many_commands = |commands: Commands, metric: &str| {
        let max = limited_max(evidence, metric)?;
        too_many(evidence, &commands.totals(evidence), max, commands.breach())
    };
    let left = left(evidence);
    let (reason, cause) = too_many(evidence, cycles, percent_max(evidence, MISSED_CYCLES), None)
        .or_else(|| too_many_commands(Commands::Missed, MISSED_COMMANDS))
        .or_else(|| silent.clone())
        .or_else(|| too_many_commands(Commands::Late, LATE_COMMANDS))
        .or_else(|| too_many_positions(evidence))
        .or_else(|| counter_goes_back(evidence))
        .or_else(|| off_period(evidence))
        .or_else(|| left.clone())?;
    // A node that left its duties before explains what came after it.
    let (reason, cause) = match left {
        Some((_, earlier)) if earlier.at_seconds < cause.at_seconds => {
            (format!("{}; {reason}", earlier.description), earlier)
        }
        _ => (reason, cause),
    };
    // A breach that lasts to the end and began before explains this one.
    let (reason, cause) = match silent {
        Some((_, lasting)) if lasting.at_seconds < cause.at_seconds => {
            (format!("{}; {reason}", lasting.description), lasting)
        }
        _ => (reason, cause),
    };
    let load = evidence.timeline.bus_load_percent;
    let reason = if load > BUSY_BUS_PERCENT {
        format!("{reason}; the bus is nearly full (load {load:.1} %)")
    } else {
        reason
    };
    Some((reason, cause))
}

/// Returns the reason why the outcome is open if nothing in the recording explains breaches beside faults.
fn unexplained(evidence: &Evidence<'_>) -> Option<String> {
    let cycles = &evidence.attribution.cycles;
    let unknown = cycles.too_many_unknown(percent_max(evidence, MISSED_CYCLES));
    let commands = || {
        let max = limited_max(evidence, MISSED_COMMANDS)?;
        Commands::Missed.totals(evidence).too_many_unknown(max)
    };
    let breach = unknown.or_else(commands)?;
    let node = node_name(evidence, breach.duty.node(evidence.control_loop));
    let (what, at) = (breach.duty.breach(), breach.from_seconds);
    let why = if evidence.attribution.hits.are_known() {
        ", which no fault of the scenario explains"
    } else {
        ", and this recording does not say what its faults hit: play it again"
    };
    Some(format!("{node}: {what} at {at:.3} s{why}"))
}

/// Returns the reason why the outcome is open if a node has not come back when the run ends, after a fault that has.
fn not_recovered(evidence: &Evidence<'_>) -> Option<String> {
    let first = evidence.attribution.not_recovered()?;
    let node = node_name(evidence, first.duty.node(evidence.control_loop));
    let (what, from) = (first.duty.breach(), first.from_seconds);
    Some(format!(
        "{node}: {what} from {from:.3} s to the end, after a fault of the scenario: what comes after it was not tried"
    ))
}

/// Returns the duties that were broken too often, and the first of them.
fn too_many(
    evidence: &Evidence<'_>,
    totals: &Totals,
    max: f64,
    breach: Option<&str>,
) -> Option<(String, NamedCause)> {
    let lost = evidence.circumstances.unrecorded.frames_lost;
    let mut shares = totals.too_many(max, lost);
    shares.sort_by_key(|(duty, ..)| duty.place(evidence.control_loop));
    let description = shares.iter().map(|(duty, percent, first)| {
        let node = node_name(evidence, duty.node(evidence.control_loop));
        let breach = breach.unwrap_or(duty.breach());
        format!("{node}: {breach} in {percent:.2} % of the cycles, first at {first:.3} s")
    });
    let description = Vec::from_iter(description).join("; ");
    let reason = format!("{description} (limit {max} %)");
    let first = shares
        .into_iter()
        .min_by(|one, other| one.2.total_cmp(&other.2));
    let (duty, _, at) = first?;
    Some((reason, NamedCause::by_node(evidence, duty, at, description)))
}

/// Returns the node that left its duties for a reason of its own.
fn left(evidence: &Evidence<'_>) -> Option<(String, NamedCause)> {
    let (at, duty) = evidence.attribution.left()?;
    let node = node_name(evidence, duty.node(evidence.control_loop));
    let reason = format!("{node}: {}", duty.departure(at));
    let cause = NamedCause::by_node(evidence, duty, at, reason.clone());
    Some((reason, cause))
}

/// Returns the external controller if the counter of its SYNC goes back too often, where nobody else can have sent them.
fn counter_goes_back(evidence: &Evidence<'_>) -> Option<(String, NamedCause)> {
    let is_external = Duty::Sync.is_of_external(evidence.control_loop);
    let is_known = evidence.circumstances.unrecorded.foreign.is_some();
    let sources = &evidence.timeline.sources;
    let (frames, at) = sources
        .sync_steps_back()
        .filter(|_| is_external && is_known)?;
    let own = frames.saturating_sub(evidence.attribution.hits.count_changed_syncs());
    let percent = 100.0 * own as f64 / evidence.attribution.due.max(1) as f64;
    let max = percent_max(evidence, MISSED_CYCLES);
    let node = &evidence.control_loop.controller().name;
    let description = format!(
        "{node}: the SYNC counter goes back in {percent:.2} % of the cycles, first at {at:.3} s"
    );
    let reason = format!("{description} (limit {max} %)");
    let cause = NamedCause::by_node(evidence, Duty::Sync, at, description);
    (percent > max).then_some((reason, cause))
}

/// Returns the external drive if it sends more positions than there are SYNCs.
fn too_many_positions(evidence: &Evidence<'_>) -> Option<(String, NamedCause)> {
    let is_external = Duty::Position.is_of_external(evidence.control_loop);
    let found = evidence.timeline.sources.positions_too_many();
    let (frames, at) = found.filter(|_| is_external)?;
    let node = &evidence.control_loop.drive().name;
    let reason = format!("{node}: {frames} positions more than SYNCs, from {at:.3} s on");
    let cause = NamedCause::by_node(evidence, Duty::Position, at, reason.clone());
    Some((reason, cause))
}

/// Returns the controller if its SYNC has a wrong period.
fn off_period(evidence: &Evidence<'_>) -> Option<(String, NamedCause)> {
    let max = limited_max(evidence, SYNC_PERIOD_ERROR)?;
    let (percent, at) = largest_period_error(evidence, false)?;
    let explained = evidence
        .attribution
        .hits
        .period_error_percent(at, PERIODS as f64);
    if rounded(percent - explained) <= max {
        return None;
    }
    let node = &evidence.control_loop.controller().name;
    let description =
        format!("{node}: SYNC period wrong by {percent:.2} % on average until {at:.3} s");
    let reason = format!("{description} (limit {max} %)");
    let cause = NamedCause::by_node(evidence, Duty::Sync, at, description);
    Some((reason, cause))
}

/// Returns the node that was silent at the end of the judged time.
fn silent_at_end(evidence: &Evidence<'_>) -> Option<(String, NamedCause)> {
    let lasting = Lasting::earliest(evidence, None)?;
    if !matches!(lasting.cause, Cause::Node(_)) {
        return None;
    }
    let cause = lasting.named(evidence);
    let (node, breach, from) = (&cause.node, lasting.duty.breach(), lasting.from_seconds);
    let reason = format!("{node}: {breach} from {from:.3} s to the end");
    Some((reason, cause))
}

/// Returns the reason of a verdict on a bus that is loaded beyond its limit, or beyond what any bus carries.
fn overload(metrics: &[Metric]) -> Option<String> {
    let load = metrics.iter().find(|metric| metric.name == BUS_LOAD)?;
    let percent = load.value?;
    if percent > LOAD_PERCENT_MAX {
        return Some(format!(
            "the bus load is {percent:.1} %: no bus carries that at this bit rate, only a virtual one; send less, or raise [bus] bitrate_kilobits_per_second"
        ));
    }
    (load.passed == Some(false))
        .then(|| format!("the bus load of {percent:.1} % is not within its limit"))
}

/// Returns the reason why it is uncertain whether a limit on the bus load is met.
fn unknown_load(metrics: &[Metric], unrecorded: &Unrecorded) -> Option<String> {
    let is_limited = |metric: &Metric| metric.name == BUS_LOAD && metric.limit.is_some();
    let fd_frames = fd_frames(unrecorded)?;
    metrics
        .iter()
        .any(is_limited)
        .then(|| format!("the bus load is not known: {fd_frames}"))
}

/// Describes the CAN FD frames that were on the bus.
fn fd_frames(unrecorded: &Unrecorded) -> Option<String> {
    let frames = unrecorded.fd_frames;
    (frames > 0).then(|| {
        let noun = if frames == 1 { "frame" } else { "frames" };
        format!("{frames} CAN FD {noun} on the bus, not recorded: canrig reads classic CAN")
    })
}

/// Returns descriptions of the first errors among the events of each loop, with their times and in the order of these. An error that
/// several loops saw appears once.
fn losses<'a>(timelines: &'a [Timeline], until_seconds: f64) -> Vec<String> {
    let is_error = |event: &&Occurrence<Event>| {
        event.level == Level::Error && event.time_seconds <= until_seconds
    };
    let errors = |one: &'a Timeline| one.events.iter().filter(is_error).take(LOSSES_MAX);
    let mut losses = Vec::from_iter(timelines.iter().flat_map(errors));
    let milliseconds = |event: &Occurrence<Event>| (1e3 * event.time_seconds).round();
    losses.sort_by(|one, other| milliseconds(one).total_cmp(&milliseconds(other)));
    let texts = losses
        .iter()
        .map(|event| format!("{:.3} s {}", event.time_seconds, event.text));
    let mut seen = BTreeSet::new();
    texts.filter(|text| seen.insert(text.clone())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_of_all_loops_are_in_the_order_of_time_and_each_appears_once() {
        let saw = |errors: &[(f64, &str)]| {
            let mut timeline = Timeline::default();
            let errors = errors.iter();
            let events =
                errors.map(|(time, text)| Occurrence::new(*time, Event::new(Level::Error, text)));
            timeline.events = events.collect();
            timeline
        };
        let loops = [
            saw(&[(1.5, "lost"), (9.0, "late")]),
            saw(&[(-0.5, "lost"), (1.5, "lost"), (1.5, "gone")]),
        ];
        let told = ["-0.500 s lost", "1.500 s lost", "1.500 s gone"];
        assert_eq!(losses(&loops, 8.0), told);
        let many = vec![(1.0, "lost"); LOSSES_MAX + 1];
        let texts = (0..many.len()).map(|number| number.to_string());
        let texts = Vec::from_iter(texts);
        let each = many
            .iter()
            .zip(&texts)
            .map(|((time, _), text)| (*time, text.as_str()));
        assert_eq!(losses(&[saw(&Vec::from_iter(each))], 8.0).len(), LOSSES_MAX);
    }
}
