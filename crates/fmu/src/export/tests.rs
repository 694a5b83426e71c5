use std::ffi::{CStr, c_char};

use super::*;
use crate::description::Description;

/// A model with every kind of variable and names with special characters.
struct Sum;

impl Exported for Sum {
    fn name(&self) -> &str {
        "sum"
    }

    fn model(&self) -> Result<Model, String> {
        let variable = |name: &str, unit, role| ModelVariable {
            name: name.to_owned(),
            description: "a < b & \"c\"".to_owned(),
            unit,
            role,
        };
        Ok(Model {
            name: "sum".to_owned(),
            description: "adds up".to_owned(),
            version: "1".to_owned(),
            variables: vec![
                variable("u", "A", Role::Input(0.5)),
                variable("total", "degC", Role::Output),
                variable(
                    "gain",
                    "",
                    Role::Number {
                        start: 2.0,
                        min: Some(0.0),
                        max: None,
                    },
                ),
                variable(
                    "word",
                    "",
                    Role::Word {
                        start: "plus".to_owned(),
                    },
                ),
            ],
        })
    }

    fn start(&self, parameters: &[StartValue]) -> Result<Box<dyn Running>, String> {
        match parameters {
            [StartValue::Number(gain), StartValue::Text(word)] if word == "plus" => {
                Ok(Box::new(Adds(*gain, 1.0)))
            }
            other => Err(format!("no sum of {other:?}")),
        }
    }
}

struct Adds(f64, f64);

impl Running for Adds {
    fn step(&mut self, duration_seconds: f64, inputs: &[f64]) {
        assert!(inputs[0] < 100.0, "too much");
        self.1 += self.0 * inputs[0] * duration_seconds;
    }

    fn outputs(&self) -> Vec<f64> {
        vec![self.1]
    }
}

fn played() -> played::Played {
    register(|| vec![Box::new(Sum)]);
    played::Played::new(&Sum.model().unwrap().token())
        .ok()
        .unwrap()
}

#[test]
fn a_model_is_described_as_it_is_read() {
    for version in [Version::Two, Version::Three] {
        let read = Description::parse(&Sum.model().unwrap().description_xml(version)).unwrap();
        assert_eq!(read.token, Sum.model().unwrap().token());
        let variable = |name| read.variable(name).unwrap();
        assert_eq!(variable("u").description, "a < b & \"c\"");
        assert_eq!(variable("word").start.as_deref(), Some("plus"));
        assert_eq!(
            (variable("gain").min, variable("gain").max),
            (Some(0.0), None)
        );
        assert_eq!(read.units["degC"].unwrap().offset, 273.15);
        assert!(read.served().unwrap().takes_any_step);
    }
}

#[test]
fn a_token_is_of_one_description() {
    // Models are registered before the first request, as when a library is loaded.
    let _ = played();
    let mut other = Sum.model().unwrap();
    other.variables.swap(0, 1);
    assert_ne!(other.token(), Sum.model().unwrap().token());
    assert!(played::Played::new("sum-1-0").is_err());
}

#[test]
fn values_go_where_they_belong() {
    let mut played = played();
    // Before the start the outputs are those of an instance that would start now.
    assert_eq!(played.number(2).unwrap(), 1.0);
    assert!(played.step(0.0, 0.1).is_err());
    played.set_number(3, 4.0).unwrap();
    played.set_number(1, 0.25).unwrap();
    played.start().unwrap();
    played.step(0.0, 0.5).unwrap();
    assert_eq!(
        (played.number(0).unwrap(), played.number(2).unwrap()),
        (0.5, 1.5)
    );
    for (reference, value) in [
        (2, 1.0),
        (3, 1.0),
        (4, 1.0),
        (5, 1.0),
        (0, 1.0),
        (1, f64::NAN),
    ] {
        assert!(played.set_number(reference, value).is_err(), "{reference}");
    }
    assert!(played.step(0.5, f64::NAN).is_err());
    played.step(0.5, 0.5).unwrap();
    played.reset().unwrap();
    played.set_word(4, c"minus").unwrap();
    assert_eq!(played.word(4).unwrap(), c"minus");
    assert!(played.start().unwrap_err().contains("no sum of"));
}

#[test]
#[expect(unsafe_code, reason = "C reads the texts")]
fn the_versions_are_told() {
    let text = |text: *const c_char| {
        assert!(!text.is_null());
        // SAFETY: a C string that is never freed.
        unsafe { CStr::from_ptr(text) }
    };
    let of_two = [two::fmi2GetTypesPlatform(), two::fmi2GetVersion()];
    assert_eq!(of_two.map(text), [c"default", c"2.0"]);
    assert_eq!(text(three::fmi3GetVersion()), c"3.0");
}

#[test]
fn a_panic_does_not_leave_through_c() {
    let mut played = played();
    played.set_number(1, 1e9).unwrap();
    played.start().unwrap();
    let failure = played::guarded(|| played.step(0.0, 1.0)).err().unwrap();
    assert_eq!(failure.0, 4);
}
