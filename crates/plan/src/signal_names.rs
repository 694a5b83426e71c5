//! The signals of the bus by all their names: `message.signal`, `signal`, and the object behind it, as the EDS calls it.

use std::collections::BTreeMap;
use std::ops::Range;

use dbc::{Database, Message, Signal, names};
use scenario::node::{Node, Part};
use scenario::wiring::Wiring;
use scenario::{Objection, Trial, nearest};

use crate::catalogue::{Frames, followed, messages_of, name_in_loop};
use crate::data_sheet::{self, DataSheet};

/// Largest number of signals that a message about an ambiguous name lists.
const CANDIDATES_MAX: usize = 10;

/// Indices of the manufacturer's objects (CiA 301).
const MANUFACTURERS: Range<u16> = 0x2000..0x6000;

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
    pub fn new(database: &Database, wiring: &Wiring) -> Self {
        let nodes = &wiring.nodes;
        let parts = [Part::Controller, Part::Drive, Part::Io];
        let sheets = parts.into_iter().zip(data_sheet::rig_data_sheets());
        let sheet_by_part = BTreeMap::from_iter(sheets);
        let mut aliases = Vec::new();
        let mut add = |message: &Message, signal: &Signal, names: Vec<String>| {
            let path = format!("{}.{}", message.name, signal.name);
            let names = [path.clone()].into_iter().chain(names);
            aliases.extend(names.map(|name| (name, path.clone())));
        };
        let mut add_message = |message: &Message, node: Option<&Node>| {
            for signal in &message.signals {
                let mut names = vec![match node {
                    Some(node) if node.part == Part::Drive => name_in_loop(signal, wiring),
                    _ => signal.name.clone(),
                }];
                if let Some(node) = node
                    && let Some(sheet) = sheet_by_part.get(&node.part)
                    && let Some(object) = object_name(sheet, signal)
                {
                    names.push(format!("{}.{object}", node.name));
                    names.push(object);
                }
                add(message, signal, names);
            }
        };
        for message in ["nmt_command", names::SYNC] {
            let message = database.message(message).into_iter();
            message.for_each(|message| add_message(message, None));
        }
        for node in nodes.all() {
            messages_of(database, node).for_each(|message| add_message(message, Some(node)));
        }
        let terms = database.term_messages(&nodes.controller.name, wiring.loop_among_several());
        terms.for_each(|message| add_message(message, Some(&nodes.controller)));
        for (message, signal) in followed(database, wiring) {
            add(message, signal, vec![signal.name.clone()]);
        }
        let objects = sheet_by_part.iter().flat_map(|(part, sheet)| {
            let node = nodes.of(*part);
            sheet.dictionary.entries().iter().flat_map(move |entry| {
                let full = node.map(|node| format!("{}.{}", node.name, entry.name));
                [Some(entry.name.clone()), full].into_iter().flatten()
            })
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
                let help = "`canrig signals SCENARIO` lists every signal with its unit, sender, message and range";
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

/// Returns the name of a signal's object. The manufacturer's objects of the data sheets are those of the shipped plant and law:
/// other signals of these objects have none.
fn object_name(sheet: &DataSheet, signal: &Signal) -> Option<String> {
    if signal.object.is_empty() {
        return None;
    }
    let (index, sub_index) = sheet.find(&signal.object).ok()?;
    let shipped = Database::shipped().messages().iter();
    let mut shipped = shipped.flat_map(|message| &message.signals);
    let is_it = |one: &Signal| one.name == signal.name && one.object == signal.object;
    if MANUFACTURERS.contains(&index) && !shipped.any(is_it) {
        return None;
    }
    Some(sheet.dictionary.get(index, sub_index)?.name.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn actuator_names() -> SignalNames {
        SignalNames::new(Database::shipped(), &Wiring::default())
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
