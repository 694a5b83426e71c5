//! Checks of faults that the schema cannot express.

use std::collections::BTreeSet;

use super::Check;
use super::pieces::{entries, windows};
use crate::error::Problem;
use crate::fault::{Actor, Fault, Faults, Group, KINDS, Kind, Time};
use crate::load::Reading;
use crate::node::Nodes;
use crate::trial::Trial;

/// Checks that faults begin within the run and end after they begin.
pub(super) fn faults(check: &mut Check<'_>, faults: &Faults, nodes: &Nodes, duration_seconds: f64) {
    // The times of an entry that could not be read may be what is wrong with it.
    let read = BTreeSet::from_iter(faults.iter().map(Fault::path));
    for group in Group::ALL {
        let table = format!("fault.{}", group.name());
        let mut pieces = entries(check.document, &table);
        pieces.retain(|piece| read.contains(&piece.path));
        windows(check, &table, &pieces, duration_seconds);
    }
    for fault in faults.iter() {
        if fault.kind.time == Time::Ends && fault.until_seconds.is_none() {
            let name = fault.kind.name;
            let message = format!("{name} needs an end, at which its factors are reached");
            check.at(&fault.path(), message, "`until_seconds` is missing");
        }
        check.add(forged(check, fault));
        check.add(at_program(check, fault, nodes));
    }
}

/// Refuses a foreign node that sends the report of a plant, on which the verdict rests.
fn forged(check: &Check<'_>, fault: &Fault) -> Option<Problem> {
    let is_foreign = |_: &u32| fault.kind.actor == Actor::Foreign;
    let forged = fault.whole("identifier").filter(is_foreign)?;
    let mut loops = check.rig.loops.iter();
    let (loop_name, _) = loops.find(|(_, one)| u32::from(one.identifiers.truth) == forged)?;
    let path = format!("{}.identifier", fault.path());
    let message = "no foreign node may forge what the plant says of itself";
    let drive = check.rig.drive_of_loop(loop_name);
    let label = format!("0x{forged:03X} is `{drive}_truth`");
    Some(check.document.problem(&path, message, label))
}

/// Refuses faults that a program which plays a node cannot have: canrig can only end it, halt it and order it to stop.
fn at_program(check: &Check<'_>, fault: &Fault, nodes: &Nodes) -> Option<Problem> {
    let node = &nodes[fault.node?];
    node.program()?;
    let node = &node.name;
    (fault.kind.actor == Actor::Node).then(|| {
        let message = format!("{} cannot happen to a program", fault.kind.heading());
        let is_possible = |kind: &&Kind| matches!(kind.actor, Actor::Process | Actor::Message);
        let known = KINDS.iter().filter(is_possible).map(|kind| kind.name);
        let known = Vec::from_iter(known).join(", ");
        let label =
            format!("`{node}` is one: what can be done to it is {known}, and faults of the bus");
        check.document.problem(&fault.path(), message, label)
    })
}

/// Finds faults of a plant that have no meaning for it, and lost bits that a converter does not have.
pub(crate) fn faults_of_loops(
    check: &mut Check<'_>,
    faults: &Faults,
    loops: &[Trial],
    reading: Reading,
) {
    let loop_at = |fault: &Fault| {
        let is_at = |one: &&Trial| fault.is_at_drive(one.wiring.drive, &one.wiring.plant);
        loops.iter().find(is_at)
    };
    let sensors = faults.in_group(Group::Sensor);
    for fault in sensors.filter(|fault| fault.kind.name == "lost_bits") {
        let bits = loop_at(fault).map(|one| one.sensor.resolution_bits());
        let mask = fault.whole("mask").unwrap_or_default();
        if let Some(bits) = bits.filter(|bits| mask % (1 << bits) == 0) {
            let (path, message) = (format!("{}.mask", fault.path()), "no bit is lost");
            check.at(&path, message, format!("the converter has {bits} bits"));
        }
    }
    // Only the bench that played a plant from outside knows which faults have a meaning for it.
    let is_known = |one: &&Trial| one.plant().custom.is_none() || reading != Reading::Recorded;
    for fault in faults.in_group(Group::Plant) {
        let one = loop_at(fault);
        if one.is_none() && reading != Reading::Recorded {
            let path = fault.path() + ".plant";
            check.at(&path, "no drive moves this plant", "it has no faults");
        }
        let Some(one) = one.filter(is_known) else {
            continue;
        };
        let (name, known) = (one.plant().name(), one.plant().faults());
        if known.contains(&fault.kind.name) {
            continue;
        }
        let path = format!("fault.plant.{}", fault.kind.name);
        let message = format!("`{path}` cannot happen to the plant `{name}`");
        let help = match known {
            [] => "no fault of a plant can".to_owned(),
            known => format!("what can: {}", known.join(", ")),
        };
        let problem = check
            .document
            .key_problem(&path, message, "has no place here");
        check.add([problem.with_help(help)]);
    }
}
