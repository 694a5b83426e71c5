//! The signals of the bus by all their names: `message.signal`, `signal`, and the object behind it, as the EDS calls it.

use dbc::{Database, Message, names};
use scenario::node::{Node, Part};
use scenario::wiring::Wiring;
use scenario::{Objection, Trial, nearest};

use crate::catalogue::{followed, name_in_loop};
use crate::data_sheet::{self, DataSheet};

/// Largest number of signals that a message about an ambiguous name lists.
const CANDIDATES_MAX: usize = 10;

/// Reason why a name does not give one signal.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// No signal has the name.
    #[error("no signal is called `{name}`")]
    Unknown {
        /// Unknown name.
        name: String,
        /// Name that was probably meant.
        nearest: Option<String>,
    },
    /// Several signals have the name.
    #[error("`{name}` is the name of {} signals", paths.len())]
    Ambiguous {
        /// Ambiguous name.
        name: String,
        /// Signals with the name, as `message.signal`.
        paths: Vec<String>,
    },
    /// No PDO carries the object.
    #[error("the object `{name}` is in no PDO, so no recording has it")]
    NotOnBus {
        /// Name of the object.
        name: String,
    },
}

/// Name and its signal, as `message.signal`.
#[derive(Debug)]
struct Alias {
    name: String,
    path: String,
}

/// Returns the aliases of a signal.
fn path_aliases(path: String, names: Vec<String>) -> impl Iterator<Item = Alias> {
    names.into_iter().map(move |name| Alias {
        name,
        path: path.clone(),
    })
}

/// All names of all signals.
#[derive(Debug)]
pub struct SignalNames {
    aliases: Vec<Alias>,
    /// Objects of the data sheets, whether on the bus or not.
    objects: Vec<String>,
}

impl SignalNames {
    /// Collects the names of the signals of a loop's nodes and its law, with those of the objects behind them.
    #[must_use]
    pub fn new(database: &Database, wiring: &Wiring) -> Self {
        let nodes = &wiring.nodes;
        let sheets = data_sheet::rig_data_sheets();
        let sheet_by_part = Vec::from_iter(
            [Part::Controller, Part::Drive, Part::Io]
                .into_iter()
                .zip(&sheets),
        );
        let sheet = |wanted: Part| {
            sheet_by_part
                .iter()
                .find(|(part, _)| *part == wanted)
                .map(|one| one.1)
        };
        let mut aliases = Vec::new();
        let mut add = |message: &Message, node: Option<&Node>| {
            for signal in &message.signals {
                let path = format!("{}.{}", message.name, signal.name);
                let is_drive = node.is_some_and(|node| node.part == Part::Drive);
                let name = if is_drive {
                    name_in_loop(signal, wiring)
                } else {
                    signal.name.clone()
                };
                let mut names = vec![path.clone(), name];
                if let Some(node) = node
                    && let Some(sheet) = sheet(node.part)
                    && let Some(object) = object_name(sheet, &signal.object)
                {
                    names.push(format!("{}.{object}", node.name));
                    names.push(object);
                }
                aliases.extend(path_aliases(path, names));
            }
        };
        for message in ["nmt_command", names::SYNC] {
            database
                .message(message)
                .into_iter()
                .for_each(|message| add(message, None));
        }
        for node in nodes.all() {
            let services = match node.part {
                Part::Controller => &names::CONTROLLER_SERVICES[..],
                Part::Io => &names::IO_SERVICES,
                Part::Drive | Part::Bench => &names::DRIVE_SERVICES,
            };
            let messages = services.iter().filter_map(|service| {
                let name = names::message(&node.name, service);
                database.message(&name)
            });
            messages.for_each(|message| add(message, Some(node)));
        }
        let terms = database.term_messages(&nodes.controller.name, wiring.loop_among_several());
        terms.for_each(|message| add(message, Some(&nodes.controller)));
        aliases.extend(followed(database, wiring).flat_map(|(message, signal)| {
            let path = format!("{}.{}", message.name, signal.name);
            let names = vec![path.clone(), signal.name.clone()];
            path_aliases(path, names)
        }));
        let entries = |(part, sheet): &(Part, &DataSheet)| {
            let names = sheet
                .dictionary
                .entries()
                .iter()
                .map(|entry| entry.name.clone());
            let node = nodes.of(*part).map(|node| node.name.clone());
            let full = names
                .clone()
                .zip(std::iter::repeat(node))
                .filter_map(|(name, node)| Some(format!("{}.{name}", node?)));
            names.chain(full).collect::<Vec<_>>()
        };
        Self {
            aliases,
            objects: sheet_by_part.iter().flat_map(entries).collect(),
        }
    }

    /// Finds the signal of a name, as `message.signal`; case does not matter.
    ///
    /// # Errors
    /// There is no such signal, or there are several.
    pub fn find(&self, name: &str) -> Result<&str, NameError> {
        let is_meant = |alias: &&Alias| alias.name.eq_ignore_ascii_case(name);
        let found = self.aliases.iter().filter(is_meant);
        let paths: Vec<&str> = found.map(|alias| alias.path.as_str()).collect();
        let name = name.to_owned();
        match paths.as_slice() {
            [path] => Ok(path),
            [] if self
                .objects
                .iter()
                .any(|object| object.eq_ignore_ascii_case(&name)) =>
            {
                Err(NameError::NotOnBus { name })
            }
            [] => {
                let known = self.aliases.iter().map(|alias| alias.name.as_str());
                let nearest = nearest(&name, known).map(str::to_owned);
                Err(NameError::Unknown { name, nearest })
            }
            _ => {
                let paths = paths.into_iter().map(str::to_owned).collect();
                Err(NameError::Ambiguous { name, paths })
            }
        }
    }

    /// Returns objections to the names of signals in a scenario. `names` returns those of its bus; it is called only if the
    /// scenario has some.
    #[must_use]
    pub fn objections<'a>(trial: &Trial, names: impl Fn() -> &'a SignalNames) -> Vec<Objection> {
        let named = trial.expect.named_signals();
        let wrong = named.filter_map(|(path, name)| {
            let error = names().find(name).err()?;
            Some(objection(path, &error))
        });
        wrong.collect()
    }
}

/// Returns the name of an object given as `0x6064:00`.
fn object_name(sheet: &DataSheet, object: &str) -> Option<String> {
    if object.is_empty() {
        return None;
    }
    let (index, sub_index) = sheet.find(object).ok()?;
    Some(sheet.entry(index, sub_index)?.name.clone())
}

fn objection(path: String, error: &NameError) -> Objection {
    let (label, help) = match error {
        NameError::Unknown { nearest, .. } => (
            match nearest {
                Some(nearest) => format!("did you mean `{nearest}`?"),
                None => "not on the bus".to_owned(),
            },
            "`canrig signals SCENARIO` lists every signal with its unit, sender, message and range"
                .to_owned(),
        ),
        NameError::Ambiguous { paths, .. } => {
            let more = if paths.len() > CANDIDATES_MAX {
                ", …"
            } else {
                ""
            };
            let listed = &paths[..paths.len().min(CANDIDATES_MAX)];
            let help = format!("it may be {}{more}", listed.join(", "));
            ("which one?".to_owned(), help)
        }
        NameError::NotOnBus { .. } => (
            "not on the bus".to_owned(),
            "only what a PDO, an EMCY or a heartbeat carries can be judged".to_owned(),
        ),
    };
    Objection {
        path,
        message: error.to_string(),
        label,
        help: Some(help),
    }
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
        let found = names.find(name).map_err(|error| error.to_string());
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
        let suggested = |name: &str| match names.find(name) {
            Err(NameError::Unknown { nearest, .. }) => nearest,
            other => panic!("{other:?}"),
        };
        let near = suggested("drive_tpdo1.positon_millimetres");
        assert_eq!(near.as_deref(), Some("drive_tpdo1.position_millimetres"));
        assert_eq!(
            suggested("Position actual valve").as_deref(),
            Some("Position actual value")
        );
        assert_eq!(suggested("§"), None);
    }
}
