use super::*;

const XML: &str = r#"<fmiModelDescription fmiVersion="2.0" modelName="Arm" guid="{1}">
  <CoSimulation modelIdentifier="arm" canHandleVariableCommunicationStepSize="true"/>
  <UnitDefinitions>
    <Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit>
    <Unit name="K"><BaseUnit K="1"/></Unit>
  </UnitDefinitions>
  <ModelVariables>
    <ScalarVariable name="motor.I" valueReference="0" causality="input"><Real start="0" unit="A"/></ScalarVariable>
    <ScalarVariable name="x" valueReference="1" causality="output" description="height&#10;of it"><Real unit="mm" min="0" max="60"/></ScalarVariable>
    <ScalarVariable name="T" valueReference="2" causality="output"><Real unit="K"/></ScalarVariable>
    <ScalarVariable name="count" valueReference="3" causality="output" variability="discrete"><Integer/></ScalarVariable>
    <ScalarVariable name="m" valueReference="4" causality="parameter" variability="fixed"><Real start="0.5" min="0.1" unit="kg"/></ScalarVariable>
    <ScalarVariable name="arm's name" valueReference="5" causality="parameter" variability="fixed"><String start="a &quot;b&quot;"/></ScalarVariable>
    <ScalarVariable name="n" valueReference="6" causality="parameter" variability="fixed"><Integer start="3"/></ScalarVariable>
    <ScalarVariable name="on" valueReference="7" causality="parameter" variability="fixed"><Boolean start="true"/></ScalarVariable>
  </ModelVariables>
</fmiModelDescription>"#;

fn description() -> Description {
    Description::parse(XML).unwrap()
}

fn table(text: &str) -> PlantTable {
    toml::from_str(&format!("file = \"arm.fmu\"\n{text}")).unwrap()
}

fn wiring(text: &str) -> Result<Wiring, String> {
    table(text)
        .wiring("arm", &description())
        .map_err(|fault| fault.to_string())
}

#[track_caller]
fn refused(text: &str, words: &str) {
    let error = wiring(text).unwrap_err();
    assert!(error.contains(words), "{error}");
}

#[test]
fn ports_are_in_the_units_of_their_names() {
    let ports = "[ports]\n\
        current_milliamperes = { variable = \"motor.I\" }\n\
        position_metres = { variable = \"x\" }\n\
        arm_celsius = { variable = \"T\" }\n\
        turns = { variable = \"count\", factor = 0.5, offset = 1.0 }\n";
    let wiring = wiring(ports).unwrap();
    let input = &wiring.inputs[0];
    assert_eq!((input.unit, input.conversion.back(500.0)), ("mA", 0.5));
    let value = |name: &str, value: f64| {
        let port = wiring.outputs.iter().find(|port| port.name == name);
        port.unwrap().conversion.of(value)
    };
    assert!((value("position_metres", 20.0) - 0.02).abs() < 1e-15);
    assert!((value("arm_celsius", 300.0) - 26.85).abs() < 1e-12);
    assert_eq!(value("turns", 4.0), 3.0);
    let position = wiring.outputs.iter().find(|port| port.variable == "x");
    assert_eq!(position.unwrap().range, [Some(0.0), Some(0.06)]);
}

#[test]
fn what_cannot_be_a_port_is_refused() {
    let port = |name: &str, rest: &str| format!("[ports]\n{name} = {{ {rest} }}\n");
    refused(
        &port("position_seconds", "variable = \"x\""),
        "`x` is in mm, and the port `position_seconds` would be in seconds",
    );
    refused(
        &port("y_metres", "variable = \"y\""),
        "variable `y` is not in the FMU",
    );
    refused(
        &port("x_metres", "variable = \"x\", factor = 0.0"),
        "cannot be the port `x_metres`",
    );
    refused(
        &port("name", "variable = \"arm's name\""),
        "is no number, so it is no port",
    );
}

#[test]
fn start_values_fit_their_variables() {
    assert!(
        wiring("start = { m = 1, n = 4, on = false, \"arm's name\" = \"z\" }\nports = {}").is_ok()
    );
    let start = |start: &str| format!("start = {{ {start} }}\nports = {{}}");
    refused(
        &start("m = 0.01"),
        "`m` cannot start with 0.01, it must be from 0.1 to inf",
    );
    refused(&start("m = true"), "`m` takes a number");
    refused(&start("n = 0.5"), "must be a whole number");
    refused(&start("on = 1"), "`on` takes true or false");
    refused(
        &start("x = 1"),
        "`x` is an output, which takes no start value",
    );
    refused(&start("m = [1]"), "write a number, a truth or a text");
    refused("step_milliseconds = 0\nports = {}", "its step is 0 s");
}

#[test]
fn the_proposed_table_fits() {
    let text = PlantTable::proposed("arm", "arm.fmu", &description());
    let value: toml::Table = text.parse().unwrap();
    let table: PlantTable = value["plant"]["arm"]["fmu"].clone().try_into().unwrap();
    let wiring = table.wiring("arm", &description()).unwrap();
    let names = Vec::from_iter(wiring.outputs.iter().map(|port| port.name.as_str()));
    assert_eq!(names, ["count", "t_kelvins", "x_millimetres"]);
    assert_eq!(wiring.inputs[0].name, "motor_i_amperes");
    assert_eq!(wiring.setup.start.len(), 4);
    assert!(
        text.contains("x_millimetres = { variable = \"x\" }  # mm: height of it\n"),
        "{text}"
    );
}

#[test]
fn names_are_made_of_any_variable() {
    assert_eq!(snake("motorSpeed"), "motor_speed");
    assert_eq!(snake("der(x)[1].y"), "der_x_1_y");
    assert_eq!(snake("3"), "port_3");
    assert_eq!(snake("ΔT"), "t");
}
