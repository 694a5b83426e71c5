use super::*;

const TWO: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="Arm" guid="{1}" generationTool="by hand">
  <CoSimulation modelIdentifier="arm" canHandleVariableCommunicationStepSize="true"/>
  <UnitDefinitions>
    <Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit>
    <Unit name="odd"/>
  </UnitDefinitions>
  <TypeDefinitions><SimpleType name="Length"><Real unit="mm" min="0" max="60"/></SimpleType></TypeDefinitions>
  <DefaultExperiment stepSize="0.001"/>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input"><Real start="0" unit="A"/></ScalarVariable>
    <ScalarVariable name="x" valueReference="1" causality="output" description="height"><Real declaredType="Length"/></ScalarVariable>
    <ScalarVariable name="m" valueReference="2" causality="parameter" variability="fixed"><Real start="0.5" min="0.1"/></ScalarVariable>
    <ScalarVariable name="n" valueReference="3" causality="parameter" variability="fixed"><Integer start="3"/></ScalarVariable>
    <ScalarVariable name="on" valueReference="4" causality="parameter" variability="fixed"><Boolean start="true"/></ScalarVariable>
    <ScalarVariable name="who" valueReference="5" causality="parameter" variability="fixed"><String start="me"/></ScalarVariable>
    <ScalarVariable name="w" valueReference="6"><Real unit="odd"/></ScalarVariable>
  </ModelVariables>
</fmiModelDescription>"#;

const THREE: &str = r#"<fmiModelDescription fmiVersion="3.0" modelName="Tank" instantiationToken="t">
  <ModelExchange modelIdentifier="tank"/>
  <CoSimulation modelIdentifier="tank" hasEventMode="true" fixedInternalStepSize="0.01"/>
  <ModelVariables>
    <Float64 name="level" valueReference="1" causality="output" unit="m"/>
    <Float64 name="field" valueReference="2"><Dimension start="3"/></Float64>
    <UInt8 name="valve" valueReference="3" causality="input" start="0"/>
    <String name="path" valueReference="4" causality="parameter"><Start value="a b"/></String>
    <Clock name="tick" valueReference="5" causality="input" intervalVariability="constant"/>
    <UInt64 name="size" valueReference="6" causality="structuralParameter" start="3"/>
  </ModelVariables>
</fmiModelDescription>"#;

#[test]
fn a_description_of_fmi_2_is_read() {
    let read = Description::parse(TWO).unwrap();
    assert_eq!(read.version, Version::Two);
    let co_simulation = read.served().unwrap();
    assert_eq!(co_simulation.model_identifier, "arm");
    assert!(co_simulation.takes_any_step && !co_simulation.has_event_mode);
    assert_eq!(read.step_seconds, Some(0.001));
    let x = read.variable("x").unwrap();
    // From the declared type.
    assert_eq!(
        (x.unit.as_deref(), x.min, x.max),
        (Some("mm"), Some(0.0), Some(60.0))
    );
    assert_eq!(read.base_unit(x).unwrap().factor, 0.001);
    // The unit is named but not defined: it is known by its symbol, or not at all.
    let unit = |name| read.base_unit(read.variable(name).unwrap());
    assert_eq!(unit("u").unwrap().exponents, [0, 0, 0, 1, 0, 0, 0, 0]);
    assert_eq!(unit("w"), None);
    assert_eq!(
        read.variable("w").unwrap().initial,
        Some(Initial::Calculated)
    );
    assert_eq!(read.not_served(), Vec::<String>::new());
}

#[test]
fn a_description_of_fmi_3_is_read() {
    let read = Description::parse(THREE).unwrap();
    assert_eq!(read.version, Version::Three);
    assert_eq!(read.other_interfaces, ["model exchange"]);
    let co_simulation = read.served().unwrap();
    assert_eq!(co_simulation.fixed_step_seconds, Some(0.01));
    let valve = read.variable("valve").unwrap();
    assert_eq!(
        (valve.kind, valve.variability),
        (Kind::UInt8, Variability::Discrete)
    );
    assert_eq!(read.variable("path").unwrap().start.as_deref(), Some("a b"));
    let needs = read.not_served();
    assert_eq!(
        needs,
        [
            "arrays are no ports: `field`",
            "clocks are not ticked: `tick`",
            "structural parameters keep their values: `size`"
        ]
    );
    let takes_start = |name| read.variable(name).unwrap().takes_start();
    assert!(takes_start("path") && !takes_start("size"));
}

#[test]
fn what_is_not_served_says_what_to_do() {
    let without = THREE.replace("<CoSimulation", "<Other");
    let fault = Description::parse(&without)
        .unwrap()
        .served()
        .unwrap_err()
        .to_string();
    assert!(
        fault.contains("only model exchange; export it for co-simulation"),
        "{fault}"
    );
    let bridge = TWO.replace("<CoSimulation", "<CoSimulation needsExecutionTool=\"true\"");
    let needs = Description::parse(&bridge).unwrap().not_served();
    assert_eq!(
        needs,
        ["it may need by hand on this machine (needsExecutionTool)"]
    );
    let fault = Description::parse(&TWO.replace("\"2.0\"", "\"1.0\"")).unwrap_err();
    assert!(
        fault.to_string().contains("line 2: it is of FMI 1.0"),
        "{fault}"
    );
}

#[track_caller]
fn refused(from: &str, to: &str, message: &str) {
    assert!(TWO.contains(from), "{from}");
    let fault = Description::parse(&TWO.replace(from, to))
        .unwrap_err()
        .to_string();
    assert!(fault.contains(message), "{fault}");
}

#[test]
fn a_wrong_description_names_its_line() {
    refused(
        " guid=\"{1}\"",
        "",
        "line 2: <fmiModelDescription> has no `guid`",
    );
    refused(
        "valueReference=\"1\"",
        "valueReference=\"-1\"",
        "line 12: `x` has the valueReference `-1`",
    );
    refused(
        "causality=\"output\"",
        "causality=\"out\"",
        "line 12: `causality` cannot be `out`",
    );
    refused(
        "min=\"0.1\"",
        "min=\"low\"",
        "line 13: `min` is `low`, not a number",
    );
    refused(
        "factor=\"0.001\"",
        "factor=\"0\"",
        "line 5: the factor of a unit is 0",
    );
    refused(
        "modelIdentifier=\"arm\"",
        "modelIdentifier=\"../arm\"",
        "is not a name in C",
    );
    refused("name=\"w\"", "name=\"u\"", "there are two variables `u`");
    refused("</ModelVariables>", "", "cannot be read as XML");
}

#[test]
fn entities_that_a_document_defines_are_refused() {
    let bomb = "<!DOCTYPE b [<!ENTITY a \"aaaaaaaa\"><!ENTITY b \"&a;&a;&a;\">]><fmiModelDescription modelName=\"&b;\"/>";
    let fault = Description::parse(bomb).unwrap_err().to_string();
    assert!(fault.contains("cannot be read as XML"), "{fault}");
    let deep = "<a>".repeat(100_000);
    assert!(Description::parse(&deep).is_err());
}

#[test]
fn a_variable_that_is_not_there_is_guessed() {
    let read = Description::parse(&TWO.replace("\"who\"", "\"operator\"")).unwrap();
    let fault = read.variable("operater").unwrap_err().to_string();
    assert!(fault.contains("did you mean `operator`?"), "{fault}");
    let fault = read.variable("zzz").unwrap_err().to_string();
    assert!(fault.contains("canrig fmu FILE"), "{fault}");
}

proptest::proptest! {
    #[test]
    fn any_text_is_read_or_refused(place in 0_usize..1800, put in "[<>\"/=a-z0-9 -]{0,6}") {
        let mut text = TWO.to_owned();
        let place = text.floor_char_boundary(place.min(text.len()));
        text.replace_range(place..place, &put);
        let _ = Description::parse(&text);
    }
}
