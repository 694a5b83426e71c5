use std::collections::VecDeque;
use std::ffi::CStr;

use super::*;
use crate::description::Variability::{Continuous, Discrete};
use crate::description::{Causality, Kind, Variability};
use crate::library::{Stepped, Updated};

/// Behaviour of a test's FMU in one step, by its end.
#[derive(Clone, Copy, Debug)]
enum Does {
    Step,
    /// Reaches this time only.
    Early(f64),
    Discard,
    /// Discards longer steps.
    DiscardAbove(f64),
    Event,
    Terminate,
    Fail(Status),
}

#[derive(Default)]
struct Fake {
    script: VecDeque<Does>,
    otherwise: Option<Does>,
    /// Calls of the FMU, for the test.
    calls: std::rc::Rc<std::cell::RefCell<Vec<String>>>,
    value: f64,
    next_event: Option<f64>,
    /// Number of updates after which it asks for another one.
    updates_again: u32,
}

impl Fake {
    fn noted(&self, call: impl Into<String>) {
        self.calls.borrow_mut().push(call.into());
    }
}

impl Slave for Fake {
    fn set_number(&mut self, _: Kind, reference: u32, value: f64) -> Status {
        self.noted(format!("set {reference} {value}"));
        Status(0)
    }
    fn number(&mut self, _: Kind, _: u32) -> (Status, f64) {
        (Status(0), self.value)
    }
    fn set_text(&mut self, _: u32, _: &CStr) -> Status {
        Status(0)
    }
    fn enter_initialization(&mut self, _: f64, _: Option<f64>) -> Status {
        Status(0)
    }
    fn step(&mut self, from: f64, duration: f64) -> Stepped {
        let end = from + duration;
        self.noted(format!("step {from} {end}"));
        let does = self.script.pop_front().or(self.otherwise);
        let (status, reached) = match does.unwrap_or(Does::Step) {
            Does::Early(reached) => (Status(0), reached),
            Does::Discard => (Status::DISCARD, from),
            Does::DiscardAbove(longest) if duration > longest => (Status::DISCARD, from),
            Does::Fail(status) => (status, from),
            _ => (Status(0), end),
        };
        Stepped {
            status,
            reached_seconds: reached,
            needs_events: matches!(does, Some(Does::Event)),
            is_terminated: matches!(does, Some(Does::Terminate)),
        }
    }
    fn update_discrete(&mut self) -> (Status, Updated) {
        let next_event_seconds = self.next_event.take();
        let updated = Updated {
            again: self.updates_again > 0,
            next_event_seconds,
            ..Updated::default()
        };
        self.updates_again = self.updates_again.saturating_sub(1);
        (Status(0), updated)
    }
    fn call(&mut self, function: &'static str) -> Status {
        match function {
            "EnterEventMode" => self.noted("events"),
            "Terminate" => self.noted("terminate"),
            "ExitInitializationMode" | "EnterStepMode" => {}
            other => panic!("{other} is not a function of FMI"),
        }
        Status(0)
    }
    fn log(&mut self) -> String {
        "what it said".to_owned()
    }
    fn forsake(&mut self) {
        self.noted("forsake");
    }
}

fn behind(name: &str, reference: u32, kind: Kind, variability: Variability) -> PortVariable {
    let variable = Variable {
        name: name.to_owned(),
        reference,
        description: String::new(),
        kind,
        is_array: false,
        causality: Causality::Input,
        variability,
        initial: None,
        start: None,
        unit: None,
        min: None,
        max: None,
    };
    PortVariable {
        variable,
        conversion: Conversion::NONE,
    }
}

fn input(behind: PortVariable) -> Input {
    Input {
        behind,
        value: f64::NAN,
        is_changed: false,
    }
}

fn instance(fake: Fake) -> Instance {
    Instance {
        slave: Box::new(fake),
        inputs: Vec::new(),
        outputs: vec![behind("x", 9, Kind::Float64, Continuous)],
        step_seconds: None,
        steps: 0.0,
        may_shorten: true,
        has_events: false,
        next_event_seconds: f64::INFINITY,
        time_seconds: 0.0,
        is_initialized: true,
    }
}

fn doing(script: impl IntoIterator<Item = Does>) -> Fake {
    Fake {
        script: script.into_iter().collect(),
        ..Fake::default()
    }
}

fn always(does: Does) -> Fake {
    Fake {
        otherwise: Some(does),
        ..Fake::default()
    }
}

/// Returns the calls of the FMU in one advance of a second.
#[track_caller]
fn calls(mut instance: Instance, of: &std::cell::RefCell<Vec<String>>) -> Vec<String> {
    instance.advance(1.0, &[]).unwrap();
    assert_eq!(instance.time_seconds(), 1.0);
    of.borrow().clone()
}

#[test]
fn an_early_return_is_gone_on_from() {
    let fake = doing([Does::Early(0.25)]);
    let noted = fake.calls.clone();
    assert_eq!(
        calls(instance(fake), &noted),
        ["step 0 0.25", "step 0.25 1"].map(|call| call.replace("0 0.25", "0 1"))
    );
}

#[test]
fn a_refused_step_is_halved_until_it_is_taken() {
    let fake = always(Does::DiscardAbove(0.3));
    let noted = fake.calls.clone();
    let calls = calls(instance(fake), &noted);
    assert_eq!(calls[..3], ["step 0 1", "step 0 0.5", "step 0 0.25"]);
    assert_eq!(calls.len(), 6);
}

#[track_caller]
fn fails(mut instance: Instance, message: &str) {
    let error = instance.advance(1.0, &[]).unwrap_err();
    let text = error.to_string();
    assert!(text.contains(message), "{text}");
    assert!(error.is_of_run(), "{text}");
}

#[test]
fn failures_say_what_and_when() {
    fails(
        instance(always(Does::Discard)),
        "refused (discard) a step of",
    );
    let mut fixed = instance(always(Does::Discard));
    fixed.may_shorten = false;
    fails(
        fixed,
        "DoStep refused (discard) a step of 1 s, and it takes no shorter one at 0 s; it said: what it said",
    );
    fails(
        instance(always(Does::Terminate)),
        "ended the simulation by itself at 1 s",
    );
    fails(
        instance(always(Does::Fail(Status::ERROR))),
        "DoStep failed (error) at 0 s",
    );
    fails(
        instance(always(Does::Early(2.0))),
        "says that it reached 2 s",
    );
    fails(
        instance(always(Does::Early(f64::NAN))),
        "says that it reached NaN s",
    );
    fails(instance(always(Does::Fail(Status(5)))), "pending");
    let fake = always(Does::Fail(Status::FATAL));
    let noted = fake.calls.clone();
    fails(instance(fake), "failed for good");
    assert_eq!(noted.borrow().last().unwrap(), "forsake");
}

#[test]
fn an_fmu_that_never_comes_further_is_given_up() {
    let mut instance = instance(always(Does::Early(0.0)));
    let error = instance.advance(1.0, &[]).unwrap_err().to_string();
    assert!(error.contains("was called 1000000 times"), "{error}");
}

#[test]
fn events_are_handled_where_it_asks_and_where_it_told_of_them() {
    let fake = Fake {
        next_event: Some(0.5),
        ..doing([Does::Event])
    };
    let noted = fake.calls.clone();
    let mut instance = instance(fake);
    instance.has_events = true;
    // The first step ends in an event, which announces another one half a second from the start.
    instance.advance(0.25, &[]).unwrap();
    assert_eq!(noted.borrow_mut().split_off(0), ["step 0 0.25", "events"]);
    instance.advance(1.0, &[]).unwrap();
    assert_eq!(
        noted.borrow_mut().split_off(0),
        ["step 0.25 0.5", "events", "step 0.5 1"]
    );
}

#[test]
fn discrete_states_are_updated_until_they_are_stable() {
    let restless = |updates_again| {
        let mut instance = instance(Fake {
            updates_again,
            ..always(Does::Event)
        });
        instance.has_events = true;
        instance
    };
    restless(99).advance(1.0, &[]).unwrap();
    fails(
        restless(100),
        "UpdateDiscreteStates wanted to be called more than 100 times at 1 s",
    );
}

#[test]
fn inputs_are_set_where_they_changed_and_discrete_ones_in_events() {
    let fake = Fake::default();
    let noted = fake.calls.clone();
    let mut instance = instance(fake);
    instance.has_events = true;
    instance.inputs = vec![
        input(behind("u", 1, Kind::Float64, Continuous)),
        input(behind("valve", 2, Kind::UInt8, Discrete)),
    ];
    instance.advance(1.0, &[0.5, 3.4]).unwrap();
    assert_eq!(
        noted.borrow_mut().split_off(0),
        ["set 1 0.5", "events", "set 2 3", "step 0 1"]
    );
    instance.advance(2.0, &[0.6, 3.4]).unwrap();
    assert_eq!(noted.borrow_mut().split_off(0), ["set 1 0.6", "step 1 2"]);
    // The value exceeds 8 bits.
    instance.advance(3.0, &[0.6, 300.0]).unwrap();
    assert_eq!(
        noted.borrow_mut().split_off(0),
        ["events", "set 2 255", "step 2 3"]
    );
}

#[test]
fn steps_of_one_length_do_not_drift() {
    let fake = Fake::default();
    let noted = fake.calls.clone();
    let mut instance = instance(fake);
    instance.step_seconds = Some(0.1);
    for to in [0.05, 0.3, 0.35, 0.4] {
        instance.advance(to, &[]).unwrap();
    }
    assert_eq!(noted.borrow().len(), 4);
    assert_eq!(instance.time_seconds(), 0.4);
}

#[test]
fn values_are_in_the_units_of_their_ports() {
    let fake = Fake {
        value: 0.02,
        ..Fake::default()
    };
    let noted = fake.calls.clone();
    let mut instance = instance(fake);
    let thousands = Conversion {
        factor: 1e3,
        offset: 0.0,
    };
    instance.outputs[0].conversion = thousands;
    instance.inputs = vec![input(PortVariable {
        conversion: thousands,
        ..behind("u", 1, Kind::Float64, Continuous)
    })];
    instance.advance(1.0, &[500.0]).unwrap();
    assert_eq!(*noted.borrow(), ["set 1 0.5", "step 0 1"]);
    let mut outputs = [0.0];
    instance.read(&mut outputs).unwrap();
    assert_eq!(outputs, [20.0]);
}

#[test]
fn what_is_no_number_is_named() {
    let mut computed = instance(Fake {
        value: f64::NAN,
        ..Fake::default()
    });
    let error = computed.read(&mut [0.0]).unwrap_err().to_string();
    assert_eq!(error, "variable `x` is NaN at 0 s: the FMU computed it");
    let mut given = instance(Fake::default());
    given.inputs = vec![input(behind("u", 1, Kind::Float64, Continuous))];
    let error = given
        .advance(1.0, &[f64::INFINITY])
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("`u` is inf at 0 s: what is wired to it"),
        "{error}"
    );
}

#[test]
fn it_is_terminated_at_its_end() {
    let fake = Fake::default();
    let noted = fake.calls.clone();
    drop(instance(fake));
    assert_eq!(*noted.borrow(), ["terminate"]);
}
