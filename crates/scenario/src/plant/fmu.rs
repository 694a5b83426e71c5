//! A plant from a modelling tool: `[plant.NAME.fmu]` of a rig file.

use std::collections::BTreeMap;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize};
use toml::{Table, Value};

/// An FMU of FMI 2.0 or 3.0 for co-simulation, which only a rig file can wire.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Fmu {
    /// The FMU, in the rig file's folder or below it.
    #[schemars(length(min = 1, max = 4096))]
    pub file: String,
    /// Length of its steps, if it should differ from the length that follows from the drive's cycle, or if the FMU takes no
    /// other.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 1_000.0))]
    pub step_milliseconds: Option<f64>,
    /// Variables that are recorded in addition to the ports: outputs, local variables, parameters. Each becomes a port by its
    /// own name and unit, and needs a lowest and a highest value in the FMU.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schemars(length(max = 64), inner(length(min = 1, max = 1000)))]
    pub record: Vec<String>,
    /// Start values by the names of its variables, in the FMU's units: numbers, truths or texts. A name with dots may be written
    /// as it is: `motor.inertia = 0.1`.
    #[serde(
        deserialize_with = "whole_names",
        skip_serializing_if = "BTreeMap::is_empty"
    )]
    #[schemars(schema_with = "any_values")]
    pub start: BTreeMap<String, Value>,
    /// Its variables as ports, by names that end in the unit that they have on the bench.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub ports: BTreeMap<String, FmuPort>,
}

/// Reads start values by the whole names of their variables.
pub(crate) fn whole_names<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<BTreeMap<String, Value>, D::Error> {
    fn flatten(table: Table, above: &str, into: &mut BTreeMap<String, Value>) {
        for (key, value) in table {
            let name = match above {
                "" => key,
                above => format!("{above}.{key}"),
            };
            match value {
                Value::Table(below) => flatten(below, &name, into),
                value => drop(into.insert(name, value)),
            }
        }
    }
    let mut whole = BTreeMap::new();
    flatten(Table::deserialize(deserializer)?, "", &mut whole);
    Ok(whole)
}

/// A variable of an FMU as a port.
#[derive(Clone, Debug, Default, Deserialize, JsonSchema, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FmuPort {
    /// The variable's name in the FMU.
    #[schemars(length(min = 1, max = 1000))]
    pub variable: String,
    /// The port is the variable times this, plus the offset. Without both, the units of variable and port say it.
    #[schemars(range(min = -1e12, max = 1e12))]
    pub factor: Option<f64>,
    /// Added to the variable times the factor.
    #[schemars(range(min = -1e12, max = 1e12))]
    pub offset: Option<f64>,
    /// Lowest and highest value at the port, where they are to be other than the FMU says. An output without a range is not
    /// published.
    #[schemars(length(min = 2, max = 2))]
    pub range: Option<Vec<f64>>,
}

/// Returns the schema of values of any kind: the FMU's variable or the program that gets a value decides on its kind.
pub(crate) fn any_values(_: &mut SchemaGenerator) -> Schema {
    json_schema!({"type": "object", "additionalProperties": {}})
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use crate::plant::PlantModel;

    /// Returns the start values of an FMU by their names.
    fn placed(start: &str) -> Vec<String> {
        let text = format!("[fmu]\nfile = \"arm.fmu\"\n[fmu.start]\n{start}\n");
        let plant: PlantModel = toml::from_str(&text).unwrap();
        let fmu = plant.beside(Path::new("rigs/rig.toml")).fmu.unwrap();
        assert_eq!(fmu.file, "rigs/arm.fmu");
        fmu.start.into_keys().collect()
    }

    #[test]
    fn a_name_with_dots_may_be_quoted_or_not() {
        assert_eq!(placed("\"body.arm.m\" = 2.0"), ["body.arm.m"]);
        assert_eq!(placed("body.arm.m = 2.0"), ["body.arm.m"]);
        let several = "n = 1\nbody.mass = 1.0\nbody.arm = { m = 2.0, on = true }";
        let names = ["body.arm.m", "body.arm.on", "body.mass", "n"];
        assert_eq!(placed(several), names);
    }
}
