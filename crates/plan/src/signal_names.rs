//! The signals of the bus by all their names: `message.signal`, `signal`, and the object behind it, as the EDS calls it.

use std::collections::BTreeMap;

use canopen::ObjectDictionary;
use dbc::node_objects::{self, PlantSignals};
use dbc::{Database, Message, Signal, names};
use scenario::node::NodeIndex;
use scenario::rig::object_address;
use scenario::wiring::{IoOutput, Wiring};
use scenario::{Objection, Trial, nearest};

use crate::catalogue::{Frames, Published, followed, messages_of, name_in_loop};

/// Largest number of signals that a message about an ambiguous name lists.
const CANDIDATES_MAX: usize = 10;

/// All names of all signals.
#[derive(Debug)]
pub struct SignalNames {
    /// Names, each with its signal as `message.signal`.
    aliases: Vec<(String, String)>,
    /// Objects of the data sheets, whether on the bus or not.
    objects: Vec<String>,
}

impl SignalNames {
    /// Collects the names of the signals of a loop's nodes and its law, with those of the objects behind them.
    pub(crate) fn new(database: &Database, wiring: &Wiring, published: &Published) -> Self {
        let objects = objects_of_nodes(database, wiring, published);
        let mut aliases = Vec::new();
        let mut add = |message: &Message, signal: &Signal, names: Vec<String>| {
            let path = format!("{}.{}", message.name, signal.name);
            let names = [path.clone()].into_iter().chain(names);
            aliases.extend(names.map(|name| (name, path.clone())));
        };
        let mut add_message = |message: &Message, node: Option<NodeIndex>| {
            let signals = message.signals.iter();
            for signal in signals.filter(|signal| wiring.has_signal(node, &signal.name)) {
                let mut names = vec![name_in_loop(signal, node, wiring)];
                let is_io = node.is_some_and(|node| wiring.node(node).is_io());
                if names[0] != signal.name && is_io {
                    names.push(signal.name.clone());
                }
                if let Some(node) = node
                    && let Some(object) = object_name(&objects[&node], signal)
                {
                    names.push(format!("{}.{object}", wiring.node(node).name));
                    names.push(object.to_owned());
                }
                add(message, signal, names);
            }
        };
        for message in ["nmt_command", names::SYNC] {
            let message = database.message(message).into_iter();
            message.for_each(|message| add_message(message, None));
        }
        let all = Vec::from_iter(wiring.all_nodes());
        for node in all.iter().copied() {
            let messages = messages_of(database, wiring.node(node));
            messages.for_each(|message| add_message(message, Some(node)));
        }
        let terms = database.term_messages(&wiring.controller().name, wiring.loop_among_several());
        let controller = wiring.shared.nodes.manager();
        terms.for_each(|message| add_message(message, Some(controller)));
        for (message, signal) in followed(database, wiring) {
            add(message, signal, vec![signal.name.clone()]);
        }
        let objects = all.into_iter().flat_map(|node| {
            let name = &wiring.node(node).name;
            let known = objects[&node].entries().iter();
            let entries = known.filter(move |entry| wiring.has_signal(Some(node), &entry.name));
            entries.flat_map(move |entry| [entry.name.clone(), format!("{name}.{}", entry.name)])
        });
        Self {
            objects: objects.collect(),
            aliases,
        }
    }

    /// Finds the signal of a name, as `message.signal`; case does not matter.
    ///
    /// # Errors
    /// There is no such signal, or there are several. The objection has no path.
    pub fn find(&self, name: &str) -> Result<&str, Objection> {
        let is_meant = |other: &str| other.eq_ignore_ascii_case(name);
        let found = self.aliases.iter().filter(|(alias, _)| is_meant(alias));
        let paths = Vec::from_iter(found.map(|(_, path)| path.as_str()));
        Err(match paths.as_slice() {
            [path] => return Ok(path),
            [] if self.objects.iter().any(|object| is_meant(object)) => {
                let message = format!("the object `{name}` is in no PDO, so no recording has it");
                let help = "only what a PDO, an EMCY or a heartbeat carries can be judged";
                Objection::new("", message, "not on the bus").with_help(help)
            }
            [] => {
                let known = self.aliases.iter().map(|(alias, _)| alias.as_str());
                let label = match nearest(name, known) {
                    Some(nearest) => format!("did you mean `{nearest}`?"),
                    None => "not on the bus".to_owned(),
                };
                let message = format!("no signal is called `{name}`");
                let help = "`canrig signals SCENARIO` lists every signal with its unit, sender, message and range; [[expect.LOOP.signal]] has those of its loop";
                Objection::new("", message, label).with_help(help)
            }
            several => {
                let count = several.len();
                let more = if count > CANDIDATES_MAX { ", …" } else { "" };
                let listed = several[..count.min(CANDIDATES_MAX)].join(", ");
                let message = format!("`{name}` is the name of {count} signals");
                let help = format!("it may be {listed}{more}");
                Objection::new("", message, "which one?").with_help(help)
            }
        })
    }

    /// Returns objections to the names of signals in a scenario with these frames, whose names are collected only if the scenario
    /// has some.
    pub(crate) fn objections(trial: &Trial, frames: &Frames) -> Vec<Objection> {
        let named = trial.expect.named_signals();
        let wrong = named.filter_map(|(path, name)| {
            let objection = frames.names().find(name).err()?;
            Some(Objection { path, ..objection })
        });
        wrong.collect()
    }
}

/// Returns the objects of the nodes of a loop.
fn objects_of_nodes(
    database: &Database,
    wiring: &Wiring,
    published: &Published,
) -> BTreeMap<NodeIndex, ObjectDictionary> {
    let (controller, drive) = (wiring.controller(), wiring.drive());
    let mut loops = vec![Default::default(); usize::from(wiring.loop_number())];
    loops.push((published.terms.clone(), wiring.identifiers.terms));
    let io = wiring.io_nodes().map(|io| {
        let all = published.io.iter().filter(move |(other, _)| *other == io);
        let outputs = all.flat_map(|(_, outputs)| outputs.iter().map(IoOutput::in_sheet));
        let id = wiring.node(io).id();
        (io, node_objects::io(id, outputs, controller.id()))
    });
    let others = [
        (
            wiring.shared.nodes.manager(),
            node_objects::controller(controller.id(), &loops, &[], &[]),
        ),
        (
            wiring.drive,
            node_objects::drive(drive.id(), PlantSignals::of(database, &drive.name), []),
        ),
    ];
    io.chain(others).collect()
}

/// Returns the name of a signal's object, if it is not the signal's.
fn object_name<'a>(objects: &'a ObjectDictionary, signal: &Signal) -> Option<&'a str> {
    let (index, sub_index) = object_address(&signal.object).ok()?;
    let name = &objects.get(index, sub_index)?.name;
    (*name != signal.name).then_some(name)
}

#[cfg(test)]
mod tests {
    use scenario::Scenario;

    use super::*;
    use crate::catalogue::terms_of_sliding_mode;

    fn actuator_names() -> SignalNames {
        let published = Published {
            terms: terms_of_sliding_mode(),
            ..Published::default()
        };
        let rig = scenario::rig::shipped::text("sma_actuator").unwrap();
        let scenario = Scenario::from_rig(rig, "rig.toml").unwrap();
        SignalNames::new(
            Database::shipped(),
            &scenario.loops.first().unwrap().wiring,
            &published,
        )
    }

    #[track_caller]
    fn check(name: &str, expected: Result<&str, &str>) {
        let names = actuator_names();
        let found = names.find(name).map_err(|objection| objection.message);
        assert_eq!(found.as_deref(), expected.map_err(str::to_owned).as_deref());
    }

    #[test]
    fn a_signal_is_found_by_each_of_its_names() {
        let position = Ok("drive_tpdo1.position_millimetres");
        check("drive_tpdo1.position_millimetres", position);
        check("position_millimetres", position);
        check("Position actual value", position);
        check("drive.position actual value", position);
        let target = Ok("drive_rpdo1.target_current_amperes");
        check("Target torque", target);
        check(
            "sliding_variable_metres_per_second_squared",
            Ok("controller_tpdo3.sliding_variable_metres_per_second_squared"),
        );
        check(
            "Convection factor",
            Ok("disturbance_rpdo1.convection_factor"),
        );
    }

    #[test]
    fn a_name_of_no_signal_or_of_several_is_refused() {
        check(
            "positon_millimetres",
            Err("no signal is called `positon_millimetres`"),
        );
        check("error_code", Err("`error_code` is the name of 3 signals"));
        check("Statusword", Err("`Statusword` is the name of 8 signals"));
        let nowhere = "the object `Motor rated current` is in no PDO, so no recording has it";
        check("Motor rated current", Err(nowhere));
    }

    #[test]
    fn the_nearest_name_is_suggested() {
        let names = actuator_names();
        let suggested = |name: &str| names.find(name).unwrap_err().label;
        assert_eq!(
            suggested("drive_tpdo1.positon_millimetres"),
            "did you mean `drive_tpdo1.position_millimetres`?"
        );
        assert_eq!(
            suggested("Position actual valve"),
            "did you mean `Position actual value`?"
        );
        assert_eq!(suggested("§"), "not on the bus");
    }
}
