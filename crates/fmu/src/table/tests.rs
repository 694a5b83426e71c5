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

fn table(text: &str) -> Fmu {
    toml::from_str(&format!("file = \"arm.fmu\"\n{text}")).unwrap()
}

fn wiring(text: &str) -> Result<Wiring, String> {
    super::wiring(&table(text), "arm", &description())
        .map_err(|misfit| format!("{}: {}", misfit.place, misfit.fault))
}

#[track_caller]
fn refused(text: &str, message: &str) {
    let error = wiring(text).unwrap_err();
    assert!(error.contains(message), "{error}");
}

#[test]
fn ports_are_in_the_units_of_their_names() {
    let ports = "[ports]\n\
        current_milliamperes = { variable = \"motor.I\" }\n\
        position_metres = { variable = \"x\" }\n\
        arm_celsius = { variable = \"T\" }\n\
        turns = { variable = \"count\", factor = 0.5, offset = 1.0 }\n";
    let wiring = wiring(ports).unwrap();
    let (ports, configuration) = (wiring.ports, wiring.configuration);
    let input = configuration.inputs[0].conversion.back(500.0);
    assert_eq!((&*ports.inputs[0].symbol, input), ("mA", 0.5));
    let value = |name: &str, value: f64| {
        let place = ports.output(name).unwrap();
        configuration.outputs[place].conversion.of(value)
    };
    assert!((value("position_metres", 20.0) - 0.02).abs() < 1e-15);
    assert!((value("arm_celsius", 300.0) - 26.85).abs() < 1e-12);
    assert_eq!(value("turns", 4.0), 3.0);
    let position = ports.output("position_metres").unwrap();
    assert_eq!(configuration.outputs[position].variable.name, "x");
    assert_eq!(ports.outputs[position].range, [0.0, 0.06]);
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
        "is not a number, so it cannot be a port",
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
    let text = proposed("arm", "arm.fmu", &description());
    let value: toml::Table = text.parse().unwrap();
    let table: Fmu = value["plant"]["arm"]["fmu"].clone().try_into().unwrap();
    let wiring = super::wiring(&table, "arm", &description()).unwrap();
    let names = Vec::from_iter(wiring.ports.outputs.iter().map(|port| port.name.as_str()));
    assert_eq!(names, ["count", "t_kelvins", "x_millimetres"]);
    assert_eq!(wiring.ports.inputs[0].name, "motor_i_amperes");
    assert_eq!(wiring.configuration.start.len(), 4);
    assert!(
        text.contains("x_millimetres = { variable = \"x\" }  # mm: height of it\n"),
        "{text}"
    );
}

#[test]
fn the_place_of_what_does_not_fit_is_named() {
    for (text, place) in [
        (
            "[ports]\nx_metres = { variable = \"y\" }",
            "ports.x_metres.variable: variable `y`",
        ),
        (
            "[start]\n\"arm.m\" = 1.0",
            "start.arm.m: variable `arm.m` is not in the FMU",
        ),
        (
            "record = [\"x\", \"T\"]",
            "record.1: variable `T` has no lowest and highest value",
        ),
        (
            "step_milliseconds = 0.0",
            "step_milliseconds: its step is 0 s",
        ),
    ] {
        let error = wiring(text).unwrap_err();
        assert!(error.starts_with(place), "{error}");
    }
    let twice = "a_amperes = { variable = \"motor.I\" }\nb_amperes = { variable = \"motor.I\" }";
    refused(
        &format!("[ports]\n{twice}"),
        "`motor.I` is two ports already",
    );
}

#[test]
fn a_recorded_variable_keeps_its_name_and_a_port_has_the_range_that_is_said() {
    let wiring = wiring(
        "record = [\"x\", \"on\"]\n[start]\n\"motor.I\" = 0.25\n[ports]\n\
         drive_milliamperes = { variable = \"motor.I\" }\n\
         arm_celsius = { variable = \"T\", range = [-20.0, 90.0] }\n",
    );
    let wiring = wiring.unwrap();
    let named = |port: &Port| (port.name.clone(), port.range);
    assert_eq!(
        Vec::from_iter(wiring.ports.outputs.iter().map(named)),
        [
            ("arm_celsius".to_owned(), [-20.0, 90.0]),
            ("x_millimetres".to_owned(), [0.0, 60.0]),
            ("on".to_owned(), [0.0, 1.0])
        ]
    );
    assert_eq!(wiring.ports.inputs[0].at_rest, 250.0);
    for range in ["[1.0, 1.0]", "[1.0]", "[0.0, inf]"] {
        refused(
            &format!("[ports]\narm_celsius = {{ variable = \"T\", range = {range} }}"),
            "write the lowest value, then a higher one",
        );
    }
}

#[test]
fn an_input_rests_at_the_start_value_of_the_table() {
    let parameter = "valueReference=\"7\" causality=\"parameter\" variability=\"fixed\"";
    let input = "valueReference=\"7\" causality=\"input\"";
    let description = Description::parse(&XML.replace(parameter, input)).unwrap();
    let at_rest = |start: &str| {
        let table = table(&format!("{start}[ports]\non = {{ variable = \"on\" }}\n"));
        let wiring = super::wiring(&table, "arm", &description).unwrap();
        wiring.ports.inputs[0].at_rest
    };
    assert_eq!(at_rest(""), 1.0);
    assert_eq!(at_rest("start = { on = false }\n"), 0.0);
}

#[test]
fn names_are_made_of_any_variable() {
    assert_eq!(snake("motorSpeed"), "motor_speed");
    assert_eq!(snake("der(x)[1].y"), "der_x_1_y");
    assert_eq!(snake("3"), "port_3");
    assert_eq!(snake("ΔT"), "t");
}
