//! The `[disturbance]` table: disturbances of the plant.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::load::only_one;
use crate::rig::nodes::{FAN_OUTPUT, LOAD_OUTPUT, Rig};
use crate::window::Window;
use dbc::{symbol_of, unit_in};

/// Disturbances of the plant; each is commanded over the bus to an io node.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Disturbance {
    /// A fan blows at the plant and multiplies its cooling by air.
    #[schemars(length(max = 10_000))]
    pub fan: Vec<Fan>,
    /// The load changes, and stays so.
    #[schemars(length(max = 10_000))]
    pub load: Vec<Load>,
    /// Another output of an io node changes: one that the rig file names in its `outputs`.
    #[schemars(length(max = 10_000))]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub output: Vec<Output>,
}

/// An output of an io node changes.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "DisturbanceOutput")]
pub struct Output {
    /// The io node; needed where several have this output, or the rig has several loops.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub node: String,
    /// Its name among the `outputs` of the io node.
    #[schemars(length(min = 1, max = 64))]
    pub name: String,
    /// Time of the change.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub at_seconds: f64,
    /// Time at which the output returns to its value at rest; it stays if absent.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub until_seconds: Option<f64>,
    /// Its value, in the unit at the end of its name, within the range of the plant's port.
    pub value: f64,
}

/// A fan blows at the wire.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Fan {
    /// The io node; needed where several have this output, or the rig has several loops.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub node: String,
    /// Time at which the fan starts.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub from_seconds: f64,
    /// Time at which the fan stops.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub until_seconds: f64,
    /// Factor on the cooling by air while the fan is on.
    #[schemars(range(min = 1.0, max = 30.0))]
    pub convection_factor: f64,
}

/// The load changes and stays so.
#[derive(Clone, Debug, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Load {
    /// The io node; needed where several have this output, or the rig has several loops.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub node: String,
    /// Time of the change.
    #[schemars(range(min = 0.0, max = crate::TIME_SECONDS_MAX))]
    pub at_seconds: f64,
    /// Added to the plant's load; may be negative.
    #[schemars(range(min = -1_000.0, max = 1_000.0))]
    pub added_grams: f64,
}

/// A change of an output of an io node: the one form of all entries.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// Place of its entry in the scenario.
    pub path: String,
    /// The io node.
    pub node: String,
    /// Name of the output.
    pub output: String,
    /// Window from its start to its end; a change that stays begins and ends at one instant.
    pub window: Window,
    /// Value of the output in its unit.
    pub value: f64,
    /// Description of the change.
    pub text: String,
}

impl Change {
    /// Checks whether the output has the value at one time.
    fn acts_at(&self, time_seconds: f64) -> bool {
        let Window {
            from_seconds,
            until_seconds,
        } = self.window;
        from_seconds <= time_seconds
            && (until_seconds == from_seconds || time_seconds < until_seconds)
    }
}

impl Disturbance {
    /// Names the node of each entry without one: the only one that has the output.
    pub(crate) fn name_nodes(&mut self, rig: &Rig) {
        let fans = self.fan.iter_mut().map(|it| (&mut it.node, FAN_OUTPUT));
        let loads = self.load.iter_mut().map(|it| (&mut it.node, LOAD_OUTPUT));
        let outputs = self.output.iter_mut().map(|it| (&mut it.node, &*it.name));
        let all = fans.chain(loads).chain(outputs);
        for (node, output) in all.filter(|(node, _)| node.is_empty()) {
            let only = only_one(rig.io_with(output));
            only.unwrap_or_default().clone_into(node);
        }
    }

    /// Returns the changes of outputs: fans, loads, and others.
    pub fn changes(&self) -> Vec<Change> {
        let fans = self.fan.iter().enumerate().map(|(index, fan)| Change {
            path: format!("disturbance.fan.{index}"),
            node: fan.node.clone(),
            output: FAN_OUTPUT.to_owned(),
            window: Window::new(fan.from_seconds, fan.until_seconds),
            value: fan.convection_factor,
            text: format!("fan, convection × {}", fan.convection_factor),
        });
        let loads = self.load.iter().enumerate().map(|(index, load)| Change {
            path: format!("disturbance.load.{index}"),
            node: load.node.clone(),
            output: LOAD_OUTPUT.to_owned(),
            window: Window::new(load.at_seconds, load.at_seconds),
            value: load.added_grams,
            text: format!("load {:+} g", load.added_grams),
        });
        let outputs = self.output.iter().enumerate().map(|(index, output)| {
            let (name, at_seconds) = (&output.name, output.at_seconds);
            let text = format!("{name} {} {}", output.value, symbol_of(unit_in(name)));
            Change {
                path: format!("disturbance.output.{index}"),
                node: output.node.clone(),
                output: name.clone(),
                window: Window::new(at_seconds, output.until_seconds.unwrap_or(at_seconds)),
                value: output.value,
                text: text.trim_end().to_owned(),
            }
        });
        fans.chain(loads).chain(outputs).collect()
    }
}

/// Returns the value of an output at one time, by that of the latest change in force; `None` at rest.
pub fn value_at(changes: &[Change], output: &str, time_seconds: f64) -> Option<f64> {
    let acting = changes
        .iter()
        .filter(|change| change.output == output && change.acts_at(time_seconds));
    let start = |change: &&Change| change.window.from_seconds;
    let latest = acting.max_by(|left, right| start(left).total_cmp(&start(right)));
    latest.map(|change| change.value)
}
