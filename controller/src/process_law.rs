//! Laws that a separate process plays. Their ports follow from their tables; the caller of the controller starts the
//! process.

use std::fmt;
use std::time::Duration;

use dbc::{CommandRange, Port, Ports};
use scenario::Objection;
use scenario::controller::Controller;
use scenario::law_ports::{self, WrongPort};
use scenario::process_law::ProcessLaw;
use scenario::wiring::{LoopFacts, Wiring};

use crate::law::Cycle;

/// The time in which a law may answer, by the clock of the node.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Window {
    /// Present time.
    pub now: Duration,
    /// Latest time of an answer. After a cycle without a position, which needs no command, it is `now`: that answer is
    /// not waited for.
    pub until: Duration,
}

/// A law with its memory: in this process, or in another one.
pub trait Player: fmt::Debug + Send {
    /// Computes the outputs that act from the next cycle on. Returns false if there is no answer in time; then `writes`
    /// is unchanged. Does not allocate.
    fn step(&mut self, cycle: &Cycle, window: &Window, reads: &[f64], writes: &mut [f64]) -> bool;

    /// Returns the reason why it cannot continue, if there is one.
    fn failure(&self) -> Option<&str> {
        None
    }

    /// Returns the parameter that makes no physical sense, if there is one, and the reason.
    fn objection(&self) -> Option<(&'static str, String)> {
        None
    }
}

/// Function that starts the process of a law; its error is the reason why it cannot.
pub type StartPlayer<'a> = &'a dyn Fn(&ProcessLaw) -> Result<Box<dyn Player>, String>;

/// Refuses, for a controller that starts no processes.
///
/// # Errors
/// Always.
pub fn no_player(law: &ProcessLaw) -> Result<Box<dyn Player>, String> {
    Err(format!(
        "the law is played by `{}`, a process, and only `canrig` starts one",
        law.plays
    ))
}

/// Gives a law its place in the loop with this wiring: its process is told names without that loop, and the range of each of
/// `writes`. Returns it with its ports, whose names begin with those of loops and drives.
pub(crate) fn placed(mut law: ProcessLaw, wiring: &Wiring) -> (ProcessLaw, Ports) {
    let setup = &mut law.setup;
    let port = |signal: &String| port_of(signal, wiring);
    let term = |name: &String| Port::term(&whole_name(name, wiring));
    let terms = setup.terms.iter().map(term);
    let ports = Ports {
        inputs: setup.reads.iter().map(port).collect(),
        outputs: setup.writes.iter().map(port).chain(terms).collect(),
    };
    let loops = wiring.led_loops();
    let range = |signal: &String| match law_ports::writing(&port(signal), &loops) {
        Ok(writing) if writing.is_command => {
            let CommandRange { min, max, .. } = loops[writing.index].commands;
            [min / writing.factor, max / writing.factor]
        }
        // A port without a meaning is refused where it is wired.
        _ => ANY,
    };
    setup.ranges = setup.writes.iter().map(range).collect();
    let name = |signal: &str| name_in_loop(signal, wiring).to_owned();
    for signals in [&mut setup.reads, &mut setup.writes, &mut setup.terms] {
        signals.iter_mut().for_each(|signal| *signal = name(signal));
    }
    let variables = std::mem::take(&mut setup.variables).into_iter();
    setup.variables = variables
        .map(|(signal, variable)| (name(&signal), variable))
        .collect();
    wiring.loop_among_several().clone_into(&mut law.loop_name);
    (law, ports)
}

const ANY: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

/// Returns the port of a signal, without a range: the amplifier limits commands.
fn port_of(signal: &str, wiring: &Wiring) -> Port {
    Port::output(&whole_name(signal, wiring), ANY)
}

/// Returns the name of a signal with its loop or drive.
fn whole_name(signal: &str, wiring: &Wiring) -> String {
    if signal.contains('.') {
        signal.to_owned()
    } else {
        format!("{}.{signal}", wiring.loop_name)
    }
}

/// Returns the name of a signal in the process: without the loop if it is the own one.
fn name_in_loop<'a>(signal: &'a str, wiring: &Wiring) -> &'a str {
    match signal.split_once('.') {
        Some((owner, name)) if owner == wiring.loop_name || owner == wiring.drive().name => name,
        _ => signal,
    }
}

/// Returns the error in a port of a law that a process plays, with its place.
pub(crate) fn objection(controller: &Controller, wiring: &Wiring) -> Option<Objection> {
    let law = controller.process_law()?.setup;
    let loops = wiring.led_loops();
    // Whether they are outputs, and then whether they are commands.
    let tables = [
        ("reads", &law.reads, None),
        ("writes", &law.writes, Some(true)),
        ("terms", &law.terms, Some(false)),
    ];
    let mut signals = tables.into_iter().flat_map(|(key, signals, is_command)| {
        let numbered = signals.iter().enumerate();
        numbered.map(move |(place, signal)| (key, is_command, place, signal))
    });
    signals.find_map(|(key, is_command, place, signal)| {
        let port = port_of(signal, wiring);
        let checked = match is_command {
            None => law_ports::reading(&port, &loops).map(drop),
            Some(is_command) => check_output(&port, &loops, is_command),
        };
        let WrongPort { message, label } = checked.err()?;
        let mut variables = controller.fmu.iter().flat_map(|fmu| match key {
            "reads" => &fmu.reads,
            "writes" => &fmu.writes,
            _ => &fmu.terms,
        });
        let variable = variables.find(|(_, named)| *named == signal);
        let place = variable.map_or_else(|| place.to_string(), |(name, _)| name.clone());
        let path = format!("controller.{}.{key}.{place}", controller.law_name());
        Some(Objection::new(path, message, label))
    })
}

/// Checks that an output is a command, or a term of the law's own loop.
fn check_output(port: &Port, loops: &[LoopFacts], is_command: bool) -> Result<(), WrongPort> {
    let name = &port.name;
    let writing = law_ports::writing(port, loops)?;
    let (message, label) = match (writing.is_command, is_command) {
        (true, true) => return Ok(()),
        (false, false) if writing.index == 0 => return Ok(()),
        (true, false) => (
            format!("`{name}` is a command, not a term"),
            "list commands in `writes`".to_owned(),
        ),
        (false, true) => {
            let right = loops[writing.index].quantities.output.key();
            (
                format!("`{name}` is not a drive command"),
                format!("write `command` or `{right}`; list any other output in `terms`"),
            )
        }
        (false, false) => (
            format!("the term `{name}` is of another drive"),
            "a term is the loop's own: its name alone".to_owned(),
        ),
    };
    Err(WrongPort { message, label })
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};
    use std::sync::Arc;

    use dbc::{Quantities, Quantity};
    use scenario::process_law::{FmuLaw, Program};
    use scenario::wiring::SharedWiring;

    use super::*;

    #[test]
    fn a_command_has_the_name_and_the_unit_of_its_amplifier() {
        let written = |output: Quantity, name: &str| {
            let one = LoopFacts {
                name: "x".to_owned(),
                drive: "drive".to_owned(),
                followed: "drive".to_owned(),
                is_commanded: true,
                emulated: String::new(),
                quantities: Quantities {
                    output,
                    ..Quantities::default()
                },
                commands: CommandRange::of_rated(4.0, -2.0, 4.0),
                led_by: None,
                touched: BTreeSet::new(),
            };
            let wiring = Wiring {
                loop_name: "x".to_owned(),
                shared: Arc::new(SharedWiring {
                    loops: vec![one],
                    ..SharedWiring::default()
                }),
                ..Wiring::default()
            };
            let program = Program {
                command: vec!["law".to_owned()],
                reads: vec!["position_metres".to_owned()],
                writes: vec![name.to_owned()],
                terms: vec!["x.sum".to_owned()],
                parameters: BTreeMap::new(),
            };
            let (law, _) = placed(ProcessLaw::from(&program), &wiring);
            let controller = Controller {
                program: Some(program),
                ..Controller::default()
            };
            (law, objection(&controller, &wiring))
        };
        let (law, wrong) = written(Quantity::current(), "x.current_milliamperes");
        assert_eq!(wrong.map(|wrong| wrong.message), None);
        assert_eq!(law.setup.ranges, [[-2000.0, 4000.0]]);
        assert_eq!(
            (&law.setup.writes[0], &law.setup.terms[0]),
            (&"current_milliamperes".to_owned(), &"sum".to_owned())
        );
        let voltage = || Quantity::of_port("a.heater_volts");
        for command in ["command", "x.command"] {
            let (law, wrong) = written(voltage(), command);
            assert_eq!(wrong.map(|wrong| wrong.message), None);
            assert_eq!(law.setup.ranges, [[-2.0, 4.0]]);
            assert_eq!(law.setup.writes, ["command"]);
        }
        let (law, wrong) = written(voltage(), "voltage_volts");
        assert_eq!(wrong.map(|wrong| wrong.message), None);
        assert_eq!(law.setup.ranges, [[-2.0, 4.0]]);
        let (law, wrong) = written(voltage(), "current_amperes");
        assert_eq!(law.setup.ranges, [ANY], "one for each of `writes`");
        let wrong = wrong.unwrap();
        assert_eq!(wrong.path, "controller.program.writes.0");
        assert!(
            wrong
                .label
                .starts_with("write `command` or `voltage_volts`"),
            "{}",
            wrong.label
        );
    }

    #[test]
    fn a_wrong_signal_of_an_fmu_is_at_the_variable_of_its_own_table() {
        let named = |variable: &str, signal: &str| {
            BTreeMap::from([(variable.to_owned(), signal.to_owned())])
        };
        let fmu = FmuLaw {
            file: "law.fmu".to_owned(),
            reads: named("y", "speed"),
            writes: named("u", "current_amperes"),
            terms: named("z", "speed"),
            parameters: BTreeMap::new(),
        };
        let controller = Controller {
            fmu: Some(fmu),
            ..Controller::default()
        };
        let wrong = objection(&controller, &Wiring::default());
        assert_eq!(wrong.unwrap().path, "controller.fmu.reads.y");
    }
}
