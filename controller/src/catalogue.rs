//! The laws that scenarios can choose, by name: those that ship, and those that a bench of somebody else's brings.

use std::sync::OnceLock;

use dbc::{LAW_TERMS_MAX, LawTerm};
use scenario::controller::Controller;
use scenario::own::{Own, OwnTable, Section, is_name};
use scenario::registration::{InvalidOwn, register};

use crate::law::{ControlLaw, Law, LawOfSeveral};
use crate::law_with_ports::{JointLaw, LawWithPorts, Ports};
use crate::nominal_model::NominalModel;
use crate::open_loop::OpenLoop;
use crate::pid::Pid;
use crate::pid_pair::PidPair;
use crate::sliding_mode::SlidingMode;
use crate::sliding_mode_paper::SlidingModePaper;

/// Why a `[controller]` table selects no law.
#[derive(Clone, Debug, Eq, PartialEq, thiserror::Error)]
pub enum LawError {
    /// No table or several.
    #[error("the [controller] table must hold exactly one law, found {0}")]
    NotExactlyOne(usize),
    /// A law from outside that nobody registered.
    #[error("there is no control law `{0}`")]
    Unknown(String),
    /// A law that leads all loops, where one of one loop is wanted.
    #[error("the control law `{0}` leads all loops of a rig")]
    WithPorts(String),
    /// The table of a law from outside is that of another one.
    #[error("controller: {0}")]
    Parameters(#[from] toml::de::Error),
}

/// A law from outside, with the table that it has in a scenario.
pub struct OwnLaw {
    name: &'static str,
    terms: Vec<LawTerm>,
    table: OwnTable,
    make: Make,
}

/// What makes a law of its table.
#[derive(Clone, Copy)]
enum Make {
    OfLoop(fn(&Own) -> Result<Law, LawError>),
    WithPorts(fn(&Own) -> Result<JointLaw, LawError>),
}

impl OwnLaw {
    /// The law `L`.
    #[must_use]
    pub fn of<L: ControlLaw>() -> Self {
        Self {
            name: L::NAME,
            terms: L::TERMS.iter().map(|term| term.described()).collect(),
            table: OwnTable::new::<L::Config>(L::NAME),
            make: Make::OfLoop(|own| Ok(Law::of::<L>(&own.parameters()?))),
        }
    }

    /// The law `L`, which leads all loops of a rig.
    #[must_use]
    pub fn with_ports<L: LawWithPorts>() -> Self {
        Self {
            name: L::NAME,
            terms: Vec::new(),
            table: OwnTable::new::<L::Config>(L::NAME).leading_all(),
            make: Make::WithPorts(|own| Ok(JointLaw::of::<L>(&own.parameters()?))),
        }
    }

    /// The law `L`, which leads several drives.
    #[must_use]
    pub fn of_several<L: LawOfSeveral>() -> Self {
        Self {
            name: L::NAME,
            terms: L::TERMS.iter().map(|term| term.described()).collect(),
            table: OwnTable::new::<L::Config>(L::NAME).leading(L::DRIVES),
            make: Make::OfLoop(|own| Ok(Law::of_several::<L>(&own.parameters()?))),
        }
    }
}

/// Why a law from outside cannot be registered.
#[derive(Clone, Debug, Eq, PartialEq, thiserror::Error)]
pub enum InvalidOwnLaw {
    /// Its table cannot be one.
    #[error(transparent)]
    Table(#[from] InvalidOwn),
    /// Too many terms.
    #[error("the law `{law}` has {count} terms of its own (limit {LAW_TERMS_MAX})")]
    TooManyTerms {
        /// The law.
        law: &'static str,
        /// How many.
        count: usize,
    },
    /// A term without a name of its own.
    #[error(
        "the term `{term}` of the law `{law}` needs a name of its own: at most 64 small letters, digits and underscores"
    )]
    Term {
        /// The law.
        law: &'static str,
        /// The term.
        term: String,
    },
}

/// A law from outside that was registered.
struct Registered {
    name: &'static str,
    terms: Vec<LawTerm>,
    make: Make,
}

static OWN: OnceLock<Vec<Registered>> = OnceLock::new();

/// Registers the laws from outside, once and before any scenario is read.
///
/// # Errors
/// One of them has a name, parameters or terms that it cannot have.
pub fn register_laws(laws: Vec<OwnLaw>) -> Result<(), InvalidOwnLaw> {
    laws.iter().try_for_each(check)?;
    let (laws, tables) = laws
        .into_iter()
        .map(|law| {
            let OwnLaw {
                name,
                terms,
                table,
                make,
            } = law;
            (Registered { name, terms, make }, table)
        })
        .unzip();
    register(Section::Controller, tables)?;
    OWN.set(laws)
        .map_err(|_| InvalidOwnLaw::Table(InvalidOwn::RegisteredAlready))
}

/// Whether the bus can carry a law's terms.
fn check(law: &OwnLaw) -> Result<(), InvalidOwnLaw> {
    let count = law.terms.len();
    if count > LAW_TERMS_MAX {
        return Err(InvalidOwnLaw::TooManyTerms {
            law: law.name,
            count,
        });
    }
    for (place, term) in law.terms.iter().enumerate() {
        let mut before = law.terms[..place].iter();
        if !is_name(&term.name) || before.any(|other| other.name == term.name) {
            return Err(InvalidOwnLaw::Term {
                law: law.name,
                term: term.name.clone(),
            });
        }
    }
    Ok(())
}

fn registered() -> &'static [Registered] {
    OWN.get().map_or(&[], Vec::as_slice)
}

/// The laws of one loop from outside, each with its terms; those that ship have none of their own.
pub fn own_laws() -> impl Iterator<Item = (&'static str, &'static [LawTerm])> {
    let of_loop = registered().iter();
    let of_loop = of_loop.filter(|law| matches!(law.make, Make::OfLoop(_)));
    of_loop.map(|law| (law.name, law.terms.as_slice()))
}

/// The ports of the law that a `[controller]` table chooses; none where it is a law of one loop, or its table is wrong.
#[must_use]
pub fn law_ports(controller: &Controller) -> Option<Ports> {
    let law = joint_law(controller)?.ok()?;
    Some(law.ports().clone())
}

/// The law with ports that a `[controller]` table chooses, before its first cycle; none where it is a law of one loop.
pub fn joint_law(controller: &Controller) -> Option<Result<JointLaw, LawError>> {
    let own = controller.own.as_ref()?;
    match find(own.name())?.make {
        Make::WithPorts(make) => Some(make(own)),
        Make::OfLoop(_) => None,
    }
}

fn find(name: &str) -> Option<&'static Registered> {
    registered().iter().find(|law| law.name == name)
}

/// The one law in a scenario's `[controller]` table, before its first cycle.
///
/// # Errors
/// The table holds none or several, or one that nobody registered.
pub fn law(controller: &Controller) -> Result<Law, LawError> {
    let shipped = [
        (controller.sliding_mode.as_ref()).map(Law::of::<SlidingMode>),
        (controller.sliding_mode_paper.as_ref()).map(Law::of::<SlidingModePaper>),
        controller.pid.as_ref().map(Law::of::<Pid>),
        (controller.pid_pair.as_ref()).map(Law::of_several::<PidPair>),
        controller.open_loop.as_ref().map(Law::of::<OpenLoop>),
    ];
    let own = controller.own.as_ref().map(own_law).transpose()?;
    let mut laws = shipped.into_iter().chain([own]).flatten();
    match (laws.next(), laws.count()) {
        (Some(law), 0) => Ok(law),
        (first, others) => Err(LawError::NotExactlyOne(
            usize::from(first.is_some()) + others,
        )),
    }
}

/// The law in a `[controller]` table by whose model of the plant the load can be lifted nowhere; none where there is no such law.
#[must_use]
pub fn law_that_lifts_nothing(controller: &Controller) -> Option<&'static str> {
    let [full, paper] = [
        (controller.sliding_mode.as_ref()).map(|law| (SlidingMode::NAME, &law.nominal_model)),
        (controller.sliding_mode_paper.as_ref())
            .map(|law| (SlidingModePaper::NAME, &law.nominal_model)),
    ];
    let (name, model) = full.or(paper)?;
    let lifts = NominalModel::new(model).set_point_metres_max() > 0.0;
    (!lifts).then_some(name)
}

fn own_law(own: &Own) -> Result<Law, LawError> {
    let name = || own.name().to_owned();
    let law = find(own.name()).ok_or_else(|| LawError::Unknown(name()))?;
    match law.make {
        Make::OfLoop(make) => make(own),
        Make::WithPorts(_) => Err(LawError::WithPorts(name())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenario::controller;

    #[test]
    fn exactly_one_law_is_selected() {
        let none = Controller::default();
        assert_eq!(law(&none).unwrap_err(), LawError::NotExactlyOne(0));
        let one = Controller {
            sliding_mode: Some(controller::SlidingMode::default()),
            ..none.clone()
        };
        assert!(law(&one).is_ok());
        let two = Controller {
            pid: Some(controller::Pid::default()),
            open_loop: Some(controller::OpenLoop::default()),
            ..none
        };
        assert_eq!(law(&two).unwrap_err(), LawError::NotExactlyOne(2));
    }

    #[test]
    fn a_law_that_the_bus_cannot_carry_is_refused() {
        let of = |names: &[&str]| OwnLaw {
            terms: (names.iter())
                .map(|name| LawTerm {
                    name: (*name).to_owned(),
                    unit: String::new(),
                    comment: String::new(),
                })
                .collect(),
            ..OwnLaw::of::<Pid>()
        };
        assert_eq!(check(&of(&["a", "b", "c", "d", "e", "f"])), Ok(()));
        let seven = ["a", "b", "c", "d", "e", "f", "g"];
        assert!(matches!(
            check(&of(&seven)),
            Err(InvalidOwnLaw::TooManyTerms { count: 7, .. })
        ));
        for names in [["a", "a"], ["a", "µ"]] {
            assert!(matches!(
                check(&of(&names)),
                Err(InvalidOwnLaw::Term { .. })
            ));
        }
        // It is there already.
        assert!(matches!(
            register_laws(vec![OwnLaw::of::<Pid>()]),
            Err(InvalidOwnLaw::Table(_))
        ));
    }
}
