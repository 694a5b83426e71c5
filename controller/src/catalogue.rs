//! The laws that scenarios can choose, by name: the shipped ones in [`laws`](crate::laws), and the custom ones of a
//! bench.

use std::sync::OnceLock;

use dbc::names::is_name;
use dbc::{Quantity, Signal, layout};
use scenario::Objection;
use scenario::controller::{Controller, is_built_in};
use scenario::custom::{CustomTable, Section, defaults};
use scenario::law_ports::WrongPort;
use scenario::registration::{InvalidRegistration, register};
use scenario::wiring::{LoopFacts, Measured, Wiring};

use crate::error::ControllerError;
use crate::law::{AnyLaw, Law};
use crate::laws::SHIPPED;
use crate::process_law;

/// A law that a scenario can choose by the table with its name.
#[derive(Clone, Copy)]
pub struct LawRow {
    name: &'static str,
    table: fn() -> CustomTable,
    make: fn(&Controller, &Wiring) -> Result<AnyLaw, ControllerError>,
    /// Makes a law of one loop with its default parameters; `None` if some parameters have no default.
    make_default: fn(&Wiring) -> Option<AnyLaw>,
}

impl LawRow {
    /// Returns the row of the law `L`.
    pub const fn of<L: Law>() -> Self {
        Self {
            name: L::NAME,
            table: || CustomTable::new::<L::Config>(L::NAME).leading(L::DRIVES),
            make: |controller, wiring| {
                Ok(controller.with_parameters(|config| AnyLaw::of::<L>(config, wiring))?)
            },
            make_default: |wiring| {
                let config = L::DRIVES.and_then(|_| defaults::<L::Config>().ok())?;
                Some(AnyLaw::of::<L>(&config, wiring))
            },
        }
    }
}

static OWN: OnceLock<Vec<LawRow>> = OnceLock::new();

/// Registers the custom laws, once and before any scenario is read. It also registers the shipped laws that are not in
/// the format of scenarios.
///
/// # Errors
/// A law has an invalid name, parameters or ports.
pub fn register_laws(laws: Vec<LawRow>) -> Result<(), InvalidRegistration> {
    laws.iter().try_for_each(check)?;
    let shipped = SHIPPED.iter().filter(|row| !is_built_in(row.name));
    let tables = shipped.chain(&laws).map(|row| (row.table)());
    register(Section::Controller, tables.collect())?;
    OWN.set(laws).map_err(|_| InvalidRegistration::again())
}

/// Checks whether the bus can carry the outputs of a law of one loop, whatever its drive's target may be.
fn check(row: &LawRow) -> Result<(), InvalidRegistration> {
    let check_for = |target: Quantity| {
        let mut wiring = Wiring::default();
        wiring.quantities.output = target;
        let Some(law) = (row.make_default)(&wiring) else {
            return Ok(());
        };
        law.wires().and_then(|_| check_terms(&law.terms(&wiring)))
    };
    let wrong = |wrong| InvalidRegistration(format!("the law `{}`: {wrong}", row.name));
    check_for(Quantity::current()).or_else(|for_current| {
        let fits = Quantity::known().any(|target| check_for(target).is_ok());
        fits.then_some(()).ok_or_else(|| wrong(for_current))
    })
}

/// Checks whether the terms have valid names of columns, and fit into the frames of a loop.
fn check_terms(terms: &[Signal]) -> Result<(), WrongPort> {
    if let Some(term) = terms.iter().find(|term| !is_name(&term.name)) {
        return Err(WrongPort {
            message: format!("a term cannot be called `{}`", term.name),
            label: "a name has at most 64 small letters, digits and underscores, and begins with a letter"
                .to_owned(),
        });
    }
    match layout(terms) {
        Some(_) => Ok(()),
        None => Err(WrongPort {
            message: format!("{} terms of one loop", terms.len()),
            label: "its four frames have room for 32 bytes, which are 8 terms of 32 bits"
                .to_owned(),
        }),
    }
}

/// Returns the only law in a scenario's `[controller]` table, before its first cycle, for the drive with this wiring.
///
/// # Errors
/// The table holds no law, several, or an unknown one.
pub fn law(controller: &Controller, wiring: &Wiring) -> Result<AnyLaw, ControllerError> {
    let mut names = controller.law_names();
    let name = match (names.next(), names.count()) {
        (Some(name), 0) => name,
        (first, others) => {
            let count = usize::from(first.is_some()) + others;
            return Err(ControllerError::Other(format!(
                "the [controller] table must hold exactly one law, found {count}"
            )));
        }
    };
    if let Some(law) = controller.process_law() {
        return Ok(AnyLaw::of_process(law, wiring));
    }
    let own = OWN.get().map_or(&[][..], Vec::as_slice);
    let row = SHIPPED
        .iter()
        .chain(own)
        .find(|row| row.name == name)
        .ok_or_else(|| ControllerError::Other(format!("there is no control law `{name}`")))?;
    (row.make)(controller, wiring)
}

/// Returns the terms that the law of a `[controller]` table publishes for the drive with this wiring.
pub fn terms(controller: &Controller, wiring: &Wiring) -> Vec<Signal> {
    law(controller, wiring).map_or_else(|_| Vec::new(), |law| law.terms(wiring))
}

/// Returns the error of the law of a `[controller]` table: in its parameters, or in its ports at the drive with this
/// wiring. For a law of all loops only the first loop returns it.
pub fn objection(controller: &Controller, wiring: &Wiring) -> Option<Objection> {
    let law = law(controller, wiring).ok()?;
    let name = controller.law_name();
    if let Some((parameter, reason)) = law.objection() {
        let words = parameter.replace('_', " ");
        let path = format!("controller.{name}.{parameter}");
        let message = format!("the {words} of `{name}` makes no physical sense");
        return Some(Objection::new(path, message, reason));
    }
    let is_of_all = law.drives().is_none();
    let is_of_another = |first: &LoopFacts| first.name != wiring.loop_name;
    // A further drive has no law of its own.
    let first = wiring.shared.loops.iter().find(|one| one.led_by.is_none());
    if is_of_all && first.is_some_and(is_of_another) {
        return None;
    }
    if let Some(objection) = process_law::objection(controller, wiring) {
        return Some(objection);
    }
    let mut each = wiring.shared.loops.iter().enumerate();
    let checked = law.wires().and_then(|_| {
        if is_of_all {
            each.try_for_each(|(index, one)| {
                let feedback = Measured {
                    quantity: one.quantities.feedback.clone(),
                    ..Measured::default()
                };
                check_terms(&law.loop_terms(index, &one.quantities, &feedback))
            })
        } else {
            check_terms(&law.terms(wiring))
        }
    });
    let WrongPort { message, label } = checked.err()?;
    Some(Objection::new(format!("controller.{name}"), message, label))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::{CommandRange, Cycle, Port, one_loop};
    use crate::laws::pid::Pid;
    use crate::terms::described;
    use dbc::{Ports, Quantities};
    use scenario::{Identifiers, controller};

    #[test]
    fn exactly_one_law_is_selected() {
        let none = Controller::default();
        let refused = |controller: &Controller| {
            let refused = law(controller, &Wiring::default());
            refused.unwrap_err().to_string()
        };
        let message = "the [controller] table must hold exactly one law, found";
        assert_eq!(refused(&none), format!("{message} 0"));
        let one = Controller {
            sliding_mode: Some(controller::SlidingMode::default()),
            ..none.clone()
        };
        assert!(law(&one, &Wiring::default()).is_ok());
        let two = Controller {
            pid: Some(controller::Pid::default()),
            open_loop: Some(controller::OpenLoop::default()),
            ..none
        };
        assert_eq!(refused(&two), format!("{message} 2"));
    }

    /// A law with `TERMS` terms.
    #[derive(Debug)]
    struct Talkative<const TERMS: usize>;

    impl<const TERMS: usize> Law for Talkative<TERMS> {
        const NAME: &'static str = "talkative";
        type Config = controller::OpenLoop;
        type State = ();

        fn new(_: &Self::Config, _: &[CommandRange]) -> Self {
            Self
        }

        fn ports(&self) -> Ports {
            let names = (0..TERMS).map(|number| match TERMS {
                1 => "a.b".to_owned(),
                _ => format!("x{number}"),
            });
            one_loop::<Self>(names.map(|name| Port::term(&name)))
        }

        fn start(&self) {}

        fn step(&self, (): &mut (), _: &Cycle, _: &[f64], _: &mut [f64]) {}
    }

    #[test]
    fn a_law_that_the_bus_cannot_carry_is_refused() {
        assert_eq!(check(&LawRow::of::<Talkative<8>>()), Ok(()));
        let refused = check(&LawRow::of::<Talkative<9>>()).unwrap_err();
        assert!(
            refused
                .to_string()
                .starts_with("the law `talkative`: 9 terms of one loop")
        );
        for name in ["µ", "A", ""] {
            let term = described(
                &Port::term(name),
                &Quantities::default(),
                &Measured::default(),
            );
            assert!(check_terms(&[term]).is_err(), "{name}");
        }
        assert_eq!(
            check(&LawRow::of::<Talkative<1>>())
                .unwrap_err()
                .to_string(),
            "the law `talkative`: a term cannot be called `a.b`: a law of one loop names no loop"
        );
        // The law is registered already.
        let refused = register_laws(vec![LawRow::of::<Pid>()]).unwrap_err();
        assert_eq!(
            refused.to_string(),
            "[controller.pid] is a table already: choose another name"
        );
    }

    #[test]
    fn the_shipped_frames_are_those_of_the_wire_under_sliding_mode() {
        let sliding_mode = Controller {
            sliding_mode: Some(controller::SlidingMode::default()),
            ..Controller::default()
        };
        let terms = terms(&sliding_mode, &Wiring::default());
        let shipped = dbc::Database::shipped();
        let composer = dbc::Composer::new("controller", 1);
        let composed = composer
            .with_terms((0, ""), Identifiers::default().terms, &terms)
            .finish();
        let ours = Vec::from_iter(composed.term_messages("controller", ""));
        let theirs = Vec::from_iter(shipped.term_messages("controller", ""));
        assert_eq!(ours, theirs);
    }

    #[test]
    fn every_shipped_law_has_ports_that_the_bus_can_carry() {
        for row in &SHIPPED {
            assert_eq!(check(row), Ok(()), "{}", row.name);
        }
    }
}
