//! The cause of a run that broke off, or at whose end a node was silent: the earliest breach that lasts to the end. Later
//! breaches follow from it by the nodes' own watches.

use recording::stalls::Who;
use recording::timeline::TIME_TOLERANCE_SECONDS;
use scenario::expect::rounded;
use scenario::node::NodeIndex;
use serde::{Deserialize, Serialize};

use super::breaches::Duty;
use super::stalls::Stretch;
use super::{Cause, Commands, HEARTBEAT_SECONDS, SILENT_AT_END, Stay, Totals};
use crate::duties::{MISSED_COMMANDS, limited_max};
use crate::evidence::Evidence;

/// Cause that kept a run from passing, as `verdict.json` holds it.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct NamedCause {
    /// Name of the node in the rig; `host`, `fault` or `foreign` if the cause was not a node.
    pub node: String,
    /// Duty that was not done.
    pub duty: String,
    /// Begin of the breach, in scenario time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_seconds: Option<f64>,
    /// Description of the cause.
    #[serde(rename = "words")]
    pub description: String,
}

/// Breach that lasts to the end of a run, with its attribution.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lasting {
    pub(crate) duty: Duty,
    pub(crate) from_seconds: f64,
    pub(crate) cause: Cause,
}

impl NamedCause {
    /// Returns the cause for a duty that a node did not do.
    pub(crate) fn by_node(
        evidence: &Evidence<'_>,
        duty: Duty,
        at: f64,
        description: String,
    ) -> Self {
        Self {
            node: node_name(evidence, duty.node(evidence.control_loop)).to_owned(),
            duty: duty.name().to_owned(),
            at_seconds: Some(rounded(at)),
            description,
        }
    }

    /// Returns the cause for a stall that kept a node from its duty.
    pub(crate) fn by_stall(evidence: &Evidence<'_>, stretch: &Stretch, duty: &str) -> Self {
        Self {
            node: stalled(evidence, stretch).to_owned(),
            duty: duty.to_owned(),
            at_seconds: Some(rounded(stretch.from_seconds)),
            description: stretch.description(),
        }
    }
}

impl Lasting {
    /// Returns the earliest lasting breach of a loop. In a run that broke off, it began before the end; in any other run, a node
    /// was silent at the end of the judged time.
    pub(crate) fn earliest(evidence: &Evidence<'_>, broke_off: Option<f64>) -> Option<Self> {
        let mut all = Vec::from_iter(all(evidence, broke_off));
        // In a run that was played to its end, a command is due if it is limited.
        let has_commands = broke_off.is_some() || limited_max(evidence, MISSED_COMMANDS).is_some();
        let counts = |one: &Self| {
            broke_off.is_none_or(|until| one.from_seconds < until)
                && (has_commands || one.duty != Duty::Command)
        };
        all.retain(counts);
        all.sort_by(|one, other| one.from_seconds.total_cmp(&other.from_seconds));
        let first = *all.first()?;
        // A node that is gone sends none of its frames.
        let node = |one: &Self| one.duty.node(evidence.control_loop);
        let is_same = |one: &&Self| {
            node(one) == node(&first)
                && !matches!(one.duty, Duty::Heartbeat(_))
                && one.from_seconds
                    <= first.from_seconds + HEARTBEAT_SECONDS.max(evidence.timeline.period_seconds)
        };
        all.iter().find(is_same).copied().or(Some(first))
    }

    /// Returns the cause as `verdict.json` holds it.
    pub(crate) fn named(&self, evidence: &Evidence<'_>) -> NamedCause {
        let owing = node_name(evidence, self.duty.node(evidence.control_loop));
        let (from, breach) = (self.from_seconds, self.duty.breach());
        let description = format!("{owing}: {breach} from {from:.3} s on");
        match self.cause {
            Cause::Host(stretch) => NamedCause::by_stall(evidence, &stretch, self.duty.name()),
            Cause::Node(_) | Cause::Unknown(_) => {
                NamedCause::by_node(evidence, self.duty, from, description)
            }
            Cause::Fault => NamedCause {
                node: "fault".to_owned(),
                description: format!("a fault of the scenario ({description})"),
                ..NamedCause::by_node(evidence, self.duty, from, String::new())
            },
        }
    }
}

/// Returns the name of a node in the rig.
pub(crate) fn node_name<'a>(evidence: &Evidence<'a>, node: NodeIndex) -> &'a str {
    &evidence.control_loop.node(node).name
}

/// Returns the name for the part that a stall held up.
fn stalled<'a>(evidence: &Evidence<'a>, stretch: &Stretch) -> &'a str {
    match stretch.stall.who {
        Who::Machine | Who::Bus => "host",
        Who::Controller => &evidence.control_loop.controller().name,
        Who::PlantEmulator | Who::Node(_) => &evidence.control_loop.drive().name,
    }
}

/// Returns all breaches of a loop that last to the end.
fn all(evidence: &Evidence<'_>, broke_off: Option<f64>) -> impl Iterator<Item = Lasting> {
    let attribution = &evidence.attribution;
    let until = broke_off.unwrap_or_else(|| evidence.trial.judged_end_seconds());
    let commands = Commands::Missed.totals(evidence);
    // The command of the last cycle may have been due after the end.
    let without_cycles = lasting(evidence, &attribution.cycles, attribution.due, broke_off);
    let due =
        (!Commands::Missed.are_sound(evidence.timeline)).then(|| super::commands_due(evidence));
    let last_commands = due.and_then(Iterator::last).unwrap_or_default();
    let without_commands = lasting(evidence, &commands, last_commands, broke_off);
    let attributed = move |duty: Duty, from_seconds: f64, explained: Option<Cause>| {
        // A stall explains a breach that began in it only if it covers half of the missing time.
        let node = duty.node(evidence.control_loop);
        let stall = || {
            let stall = attribution.stall(node, from_seconds, until);
            stall.or_else(|| attribution.stood_since(node, from_seconds))
        };
        let cause = explained.or_else(|| stall().map(Cause::Host));
        Lasting {
            duty,
            from_seconds,
            cause: cause.unwrap_or(Cause::Node(duty)),
        }
    };
    let stays = without_cycles.into_iter().chain(without_commands);
    let attributed_stays = stays.map(move |stay| {
        let (duty, explained) = match stay.cause {
            Cause::Node(duty) => (duty, None),
            Cause::Host(_) => (stay.first.duty, None),
            cause => (stay.first.duty, Some(cause)),
        };
        attributed(duty, stay.first.from_seconds, explained)
    });
    let heartbeats = evidence.timeline.lost_heartbeats.iter();
    let lost = heartbeats.filter(|lost| lost.back_seconds.is_infinite());
    let heartbeats = lost.map(move |lost| {
        let explained = attribution.heartbeat_explained(lost);
        attributed(Duty::Heartbeat(lost.node), lost.due_seconds, explained)
    });
    attributed_stays.chain(heartbeats)
}

/// Returns the stay of breaches that lasts to the end; in a run that was played to its end, it must be long enough for a silence.
fn lasting(
    evidence: &Evidence<'_>,
    totals: &Totals,
    cycles: u64,
    broke_off: Option<f64>,
) -> Option<Stay> {
    let stay = totals.lasting(cycles.saturating_sub(1))?;
    let count = stay.last_cycle + 1 - stay.first.cycle;
    let seconds = evidence.timeline.cycle_start_seconds(count);
    let lost = evidence.circumstances.unrecorded.frames_lost;
    let is_silence = count.saturating_sub(lost) > SILENT_AT_END.0
        && seconds > SILENT_AT_END.1 + TIME_TOLERANCE_SECONDS;
    (is_silence || broke_off.is_some()).then_some(stay)
}
