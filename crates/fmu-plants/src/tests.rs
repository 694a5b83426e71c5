use fmu::description::{Causality, Version};
use fmu::{Description, Fault};

use super::*;

fn of(name: &str) -> Box<dyn Exported> {
    let found = shipped()
        .into_iter()
        .find(|exported| exported.name() == name);
    found.expect("it ships")
}

/// Returns the parameters' start values, with one of them changed.
fn parameters(exported: &dyn Exported, change: Option<(&str, StartValue)>) -> Vec<StartValue> {
    let model = exported.model().unwrap();
    let variables = model.variables.iter();
    let values = variables.filter_map(|variable| Some((&variable.name, variable.role.start()?)));
    let changed = values.map(|(name, value)| match &change {
        Some((other, new)) if name == other => new.clone(),
        _ => value,
    });
    changed.collect()
}

/// With its defaults an FMU is the plant that the emulator plays, to the bit, and has the variables of its ports.
#[test]
fn the_shipped_plants_are_those_of_the_emulator() {
    fn compare<P: Plant>(name: &str, config: &P::Config, inputs: impl Fn(f64) -> Vec<f64>) {
        let exported = of(name);
        let mut plant = P::new(config).ok().unwrap();
        let ports = plant.ports();
        let variables = exported.model().unwrap().variables;
        let names = |is_wanted: fn(&Role) -> bool| {
            let wanted = variables.iter().filter(|one| is_wanted(&one.role));
            Vec::from_iter(wanted.map(|variable| variable.name.clone()))
        };
        let port_names =
            |ports: &[Port]| Vec::from_iter(ports.iter().map(|port| port.name.clone()));
        let input_names = names(|role| matches!(role, Role::Input(_)));
        assert_eq!(input_names, port_names(&ports.inputs));
        assert_eq!(
            names(|role| *role == Role::Output),
            port_names(&ports.outputs)
        );
        let mut runs = exported.start(&parameters(&*exported, None)).unwrap();
        let mut outputs = vec![0.0; ports.outputs.len()];
        let mut highest: f64 = 0.0;
        for step in 0..3000 {
            let inputs = inputs(if step % 1000 < 500 { 0.8 } else { 0.1 });
            runs.step(1e-3, &inputs);
            plant.step(1e-3, &inputs);
            plant.read(&mut outputs);
            highest = highest.max(outputs[0]);
        }
        assert_eq!(runs.outputs(), outputs);
        assert!(highest > 1e-3, "it moved");
    }
    let axis_inputs = |current| vec![current, 1.5, 0.01];
    compare::<Actuator>("sma", &scenario::plant::Sma::default(), axis_inputs);
    compare::<DcMotor>(
        "dc_motor",
        &scenario::plant::DcMotor::default(),
        axis_inputs,
    );
    let config = scenario::plant::SmaPair::default();
    compare::<SmaPair>("sma_pair", &config, |current| vec![current, 0.1, 1.5, 0.01]);
}

/// The effect of a parameter on the ports is known only when the FMU starts.
#[test]
fn other_ports_than_those_described_are_refused() {
    let one = Actuator::new(&scenario::plant::Sma::default()).ports();
    assert!(have_the_same_names(&one, &one));
    let joint = SmaPair::new(&scenario::plant::SmaPair::default());
    assert!(!have_the_same_names(&one, &joint.ok().unwrap().ports()));
}

#[test]
fn parameters_reach_the_plant_or_are_refused_with_a_message() {
    let motor = of("dc_motor");
    let with = |name, value| motor.start(&parameters(&*motor, Some((name, value))));
    let height = |name, value: f64| {
        let mut runs = with(name, StartValue::Number(value)).ok().unwrap();
        runs.step(1.0, &[0.8, 1.0, 0.0]);
        runs.outputs()[0]
    };
    assert!(height("load_kilograms", 2.0) < height("load_kilograms", 0.2));
    let error = with("pinion_radius_metres", StartValue::Number(0.0))
        .err()
        .unwrap();
    assert!(
        error.contains("pinion_radius_metres is 0, it must be above 0"),
        "{error}"
    );
    let wire = of("sma");
    let with = |value: &str| {
        let value = StartValue::Text(value.to_owned());
        wire.start(&parameters(
            &*wire,
            Some(("mechanics.stress_strain", value)),
        ))
    };
    assert!(with("full").is_ok());
    assert!(with("none").err().unwrap().contains("unknown variant"));
    // A turn changes the fraction permanently.
    for (name, output) in [("sma", 2), ("sma_pair", 2)] {
        let wire = of(name);
        let after_loops = |kinetics: &str| {
            let kinetics = StartValue::Text(kinetics.to_owned());
            let started = wire.start(&parameters(&*wire, Some(("kinetics", kinetics))));
            let mut runs = started.ok().unwrap();
            for current in [0.7, 0.57, 0.7, 0.57] {
                let inputs = [current, 0.0, 1.0, 0.0];
                let inputs = match name {
                    "sma" => &[current, 1.0, 0.0],
                    _ => &inputs[..],
                };
                runs.step(3.0, inputs);
            }
            runs.outputs()[output]
        };
        let [paper, nested, preisach] = ["paper", "nested", "preisach"].map(after_loops);
        assert!((nested - paper).abs() > 1e-3, "{name}: {nested} {paper}");
        assert!(
            (preisach - paper).abs() > 1e-3,
            "{name}: {preisach} {paper}"
        );
    }
}

/// Our own reader accepts the descriptions: variables with units, limits, start values, and no unsupported features.
#[test]
fn the_descriptions_are_complete() {
    for version in [Version::Two, Version::Three] {
        for exported in shipped() {
            let model = exported.model().unwrap();
            let read = Description::parse(&model.description_xml(version))
                .unwrap_or_else(|fault: Fault| panic!("{fault}"));
            assert_eq!(
                (read.version, read.token.as_str()),
                (version, &*model.token())
            );
            assert_eq!(read.not_served(), Vec::<String>::new());
            assert_eq!(read.variables.len(), model.variables.len() + 1);
            for variable in &read.variables[1..] {
                assert!(
                    !variable.description.is_empty(),
                    "{} says nothing",
                    variable.name
                );
                let is_parameter = variable.causality == Causality::Parameter;
                assert_eq!(
                    is_parameter,
                    variable.start.is_some() && !variable.is_input(),
                    "{}",
                    variable.name
                );
                if let Some(unit) = &variable.unit {
                    assert!(read.units[unit].is_some(), "{unit} is not defined");
                }
            }
            let (position, unit) = match exported.name() {
                "sma_pair" => ("angle_degrees", "deg"),
                _ => ("position_metres", "m"),
            };
            let position = read.variable(position).unwrap();
            assert_eq!(position.unit.as_deref(), Some(unit));
        }
    }
    let motor = of("dc_motor").model().unwrap();
    let parameters = motor
        .variables
        .iter()
        .filter(|variable| matches!(variable.role, Role::Number { .. }));
    assert_eq!(parameters.count(), 17);
}
