//! Rig files and scenarios of many shapes, drawn by a seed. Their names come from the tables of the format, so that a new unit, metric
//! or fault is drawn too.

use std::fs::File;
use std::path::Path;

use dbc::{Quantities, Quantity, Unit, conversion, known_units, unit_in};
use fmu::description::Version;
use fmu::export::{Model, ModelVariable, Role, write_fmu};
use scenario::fault::{Form, Group, KINDS, Key, Kind, Need, Time};
use scenario::metrics::{Form as Limit, METRICS, Metric, Needs, Subject};

/// Stream of numbers (splitmix64), the same on every machine.
pub(crate) struct Draw(pub(crate) u64);

impl Draw {
    pub(crate) fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        let end = u64::try_from(end).unwrap();
        usize::try_from((mixed ^ (mixed >> 31)) % end).unwrap()
    }

    pub(crate) fn choose<T: Clone>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())].clone()
    }

    /// Returns the text in half of the cases, else an empty one.
    fn maybe<'t>(&mut self, text: &'t str) -> &'t str {
        self.choose(&[text, ""])
    }
}

/// A model of a plant.
struct Plant {
    name: &'static str,
    /// Inputs, each for one drive. Those of an FMU are drawn, as are its outputs.
    inputs: &'static [&'static str],
    outputs: &'static [&'static str],
    parameters: &'static [&'static str],
}

const PLANTS: [Plant; 4] = [
    Plant {
        name: "sma",
        inputs: &["current_amperes"],
        outputs: &["position_metres", "wire_temperature_celsius"],
        parameters: &["kinetics = \"preisach\"", "mechanics.load_kilograms = 0.05"],
    },
    Plant {
        name: "dc_motor",
        inputs: &["current_amperes"],
        outputs: &[
            "position_metres",
            "motor_speed_revolutions_per_minute",
            "spring_force_newtons",
            "pinion_angle_degrees",
        ],
        parameters: &["load_kilograms = 0.3", "gear_ratio = 20"],
    },
    Plant {
        name: "sma_pair",
        inputs: &["flexor_current_amperes", "extensor_current_amperes"],
        outputs: &["angle_degrees", "speed_degrees_per_second"],
        parameters: &["kinetics = \"nested\"", "pulley_radius_millimetres = 11.5"],
    },
    Plant {
        name: "fmu",
        inputs: &[],
        outputs: &[],
        parameters: &["start.gain = 2.0", "start = { arm.mass = 1, gain = 3 }"],
    },
];

const FMU: &str = "units.fmu";

/// Writes the FMU whose ports can have any unit.
pub(crate) fn write_fmu_of_any_unit(folder: &Path) {
    let variable = |name: &str, role| ModelVariable {
        name: name.to_owned(),
        description: String::new(),
        unit: "",
        role,
    };
    let number = Role::Number {
        start: 1.0,
        min: None,
        max: None,
    };
    let model = Model {
        name: "units".to_owned(),
        description: String::new(),
        version: "1".to_owned(),
        variables: vec![
            variable("input", Role::Input(0.0)),
            variable("output", Role::Output),
            variable("gain", number.clone()),
            variable("arm.mass", number),
        ],
    };
    let file = File::create(folder.join(FMU)).unwrap();
    write_fmu(file, &model, Version::Three, b"no library").unwrap();
}

/// A plant with its drives and its loop.
pub(crate) struct Axis {
    number: usize,
    plant: &'static Plant,
    inputs: Vec<String>,
    output: String,
    /// Name of its loop.
    name: String,
    quantities: Quantities,
    is_external: bool,
}

/// Draws a rig file; returns its text and its contents.
pub(crate) fn rig(draw: &mut Draw) -> (String, Vec<Axis>) {
    let axes = Vec::from_iter((0..=draw.below(3)).map(|number| Axis::new(draw, number)));
    let period = draw.choose(&["10", "10.3", "12.7", "6.6"]);
    let head = format!(
        "schema = 1\nname = \"drawn\"\n\
         [bus]\nsync_period_milliseconds = {period}\n\
         [defaults.drive.plausible]\nrate_max = 1e6\nstall = {{ current_rms = 0.9, seconds = 1, motion = 0.5 }}\n\
         [node.controller]\nkind = \"controller\"\nnode_id = 1\n"
    );
    let tables = axes.iter().map(|axis| axis.tables(draw));
    (head + &tables.collect::<String>(), axes)
}

/// Draws a scenario on a rig.
pub(crate) fn scenario(draw: &mut Draw, axes: &[Axis], rig_file: &str) -> String {
    let mut text =
        format!("schema = 1\nrig = \"{rig_file}\"\nname = \"drawn\"\nduration_seconds = 9\n");
    text += draw.maybe("[bus]\nsync_period_milliseconds = 20.3\n");
    for axis in axes {
        // The only loop may be named, too.
        let is_named = axes.len() > 1 || draw.below(2) == 0;
        let below = if is_named {
            format!(".{}", axis.name)
        } else {
            String::new()
        };
        text += &axis.law(draw, &below);
        text += &axis.set_points(draw, is_named);
        text += &axis.limits(draw, &below);
        text += &axis.fault(draw);
        text += &axis.values(draw);
    }
    if let [one, other, ..] = axes
        && one.quantities.feedback.unit == other.quantities.feedback.unit
    {
        let limit = one
            .quantities
            .name("contour_error_{unit}_max = { max = 3 }");
        let loops = [&one.name, &other.name];
        text += &format!("[[expect.contour]]\nloops = {loops:?}\n{limit}\n");
    }
    text
}

impl Axis {
    fn new(draw: &mut Draw, number: usize) -> Self {
        let plant = &PLANTS[draw.below(PLANTS.len())];
        let units = Vec::from_iter(known_units());
        let (inputs, output) = match plant.name {
            "fmu" => {
                // An amplifier cannot give a time, whose name a recording has.
                let inputs = units.iter().map(|unit| format!("in_{unit}"));
                let inputs = inputs.filter(|port| !Quantity::of_port(port).is_ambiguous());
                let input = draw.choose(&Vec::from_iter(inputs));
                let output = draw.choose(&units);
                (vec![input], format!("out_{output}"))
            }
            _ => {
                let inputs = plant.inputs.iter().map(|&input| input.to_owned());
                (inputs.collect(), draw.choose(plant.outputs).to_owned())
            }
        };
        let quantities = Quantities {
            feedback: Quantity::new(
                draw.choose(&["position", "speed", "valve_opening", "force"]),
                draw.choose(&Unit::fitting_port(unit_in(&output))),
            ),
            output: Quantity::of_port(&inputs[0]),
        };
        let can_be_external = inputs.len() == 1 && quantities.output == Quantity::current();
        // Some names begin or end like limits.
        let name = draw.choose(&["loop_N", "hunting_N", "axis_N_max"]);
        Self {
            number,
            plant,
            inputs,
            output,
            name: name.replace('N', &number.to_string()),
            quantities,
            is_external: can_be_external && draw.below(4) == 0,
        }
    }

    fn drive(&self, place: usize) -> String {
        format!("drive_{}_{place}", self.number)
    }

    /// Draws the tables of the axis in a rig file.
    fn tables(&self, draw: &mut Draw) -> String {
        let (number, output) = (self.number, &self.output);
        let Quantities {
            feedback: Quantity { name: signal, unit },
            output: command,
        } = &self.quantities;
        let parameter = draw.choose(self.plant.parameters);
        let mut text = format!("[plant.p{number}.{}]\n", self.plant.name);
        text = text + draw.maybe(parameter) + "\n";
        if self.plant.name == "fmu" {
            let input = &self.inputs[0];
            text += &format!(
                "file = \"{FMU}\"\n\
                 [plant.p{number}.fmu.ports]\n\
                 {input} = {{ variable = \"input\", range = [0, 1] }}\n\
                 {output} = {{ variable = \"output\", factor = 1.0, range = [-500, 500.0] }}\n"
            );
        }
        let mut outputs = Vec::new();
        for (place, input) in self.inputs.iter().enumerate() {
            let drive = self.drive(place);
            outputs.push(format!("{drive}.{}", command.name));
            text += &format!(
                "[node.{drive}]\nkind = \"drive\"\nnode_id = {}\nplausible.stall.motion = 1\n\
                 [node.{drive}.sensor]\nport = \"p{number}.{output}\"\nsignal = \"{signal}\"\nunit = \"{unit}\"\nmin = -20.5\nmax = 100\n\
                 [node.{drive}.amplifier]\nport = \"p{number}.{input}\"\n",
                16 + 2 * number + place,
            );
            if *command == Quantity::current() {
                text += "i2t = { continuous = 0.8, peak_square_seconds = 2 }\n";
            }
            if self.is_external {
                text += &format!(
                    "[node.{drive}.limits]\ncurrent_amperes = 0.9\nmin = -21\nmax = 101.5\nrate_max = 4000\n\
                     [node.{drive}.position]\nincrements_per_unit = 100.0\nresolution = 0.05\n\
                     [node.{drive}.preflight]\nheating = false\n"
                );
            }
        }
        let (name, first) = (&self.name, self.drive(0));
        text + &format!("[loop.{name}]\nfeedback = \"{first}.{signal}\"\noutputs = {outputs:?}\n")
    }

    fn law(&self, draw: &mut Draw, below: &str) -> String {
        let unit = &self.quantities.feedback.unit;
        if draw.below(4) == 0 {
            let step = self
                .quantities
                .name("at_seconds = 0.5\n{command}_{command_unit} = 0.4\n");
            return format!("[[controller{below}.open_loop.step]]\n{step}");
        }
        if self.plant.name == "sma" && self.quantities == Quantities::default() {
            let law = draw.choose(&["sliding_mode", "sliding_mode_paper"]);
            return format!("[controller{below}.{law}.nominal_model]\nload_kilograms = 0.05\n");
        }
        // Gains may be per any unit of the quantity.
        let units = known_units().filter(|by| conversion(unit.law_word(), by).is_some());
        let mut by = self.quantities.clone();
        by.feedback.unit = Unit::Other(draw.choose(&Vec::from_iter(units)).to_owned());
        let (law, more) = match self.inputs.len() {
            2 => (
                "pid_pair",
                draw.maybe("co_contraction_{command_unit} = 0.4\n"),
            ),
            _ => ("pid", draw.maybe("set_point_weight = 1\n")),
        };
        let gains = "proportional_{gain} = 2\nintegral_{gain}_second = 0.5\nderivative_{gain_seconds} = 0.1\n";
        by.name(&format!("[controller{below}.{law}]\n{gains}{more}"))
    }

    fn set_points(&self, draw: &mut Draw, is_named: bool) -> String {
        let mut text = String::new();
        for at in [0, 4] {
            let until = at + 3;
            let position = draw.choose(&["12", "7.5"]);
            let harmonic = format!(
                "from_seconds = {at}\ncentre_{{unit}} = {position}\namplitude_{{unit}} = 2"
            );
            let (kind, keys) = draw.choose(&[
                ("hold", format!("at_seconds = {at}\n{{signal}}_{{unit}} = {position}")),
                ("step", format!("at_seconds = {at}\n{{signal}}_{{unit}} = {position}")),
                ("ramp", format!("from_seconds = {at}\nuntil_seconds = {until}\n{{signal}}_{{unit}} = {position}")),
                ("sine", format!("{harmonic}\nperiod_seconds = 0.5")),
                ("chirp", format!("{harmonic}\nuntil_seconds = {until}\nfrom_hertz = 0.5\nuntil_hertz = 4")),
            ]);
            let keys = self.quantities.name(&keys);
            text += &format!("[[reference.{kind}]]\n{keys}\n");
            if is_named {
                text += &format!("loop = \"{}\"\n", self.name);
            }
        }
        text
    }

    fn limits(&self, draw: &mut Draw, below: &str) -> String {
        let is_possible = |metric: &&Metric| {
            matches!(
                metric.needs,
                Needs::Nothing | Needs::SetPoint | Needs::Fault
            ) && (metric.subject != Subject::Bus || below.is_empty())
                && !(self.is_external && metric.name == "temperature_celsius")
        };
        let list = format!("[\"{} 0x5000\"]", self.drive(0));
        let mut text = format!("[expect{below}]\n");
        text += draw.maybe(&self.quantities.name("recovery_band_{unit} = 0.5\n"));
        for metric in METRICS.iter().filter(is_possible) {
            let limit = match metric.form {
                Limit::TwoSided => draw.choose(&["{ max = 90 }", "{ min = -1, max = 2.5 }"]),
                Limit::AtMost(_) => "900.5",
                Limit::Answer => "true",
                Limit::List => &list,
            };
            let name = self.quantities.name(metric.name);
            text += draw.maybe(&format!("{name} = {limit}\n"));
        }
        text
    }

    fn fault(&self, draw: &mut Draw) -> String {
        let is_possible = |kind: &&Kind| match kind.group {
            Group::Plant => self.plant.name == "sma" && !self.is_external,
            Group::Sensor | Group::Amplifier => !self.is_external,
            Group::Bus | Group::Node => true,
        };
        let kind = draw.choose(&Vec::from_iter(KINDS.iter().filter(is_possible)));
        let mut text = kind.heading() + "\n";
        text += match kind.time {
            Time::Lasts | Time::Ends => "from_seconds = 2\nuntil_seconds = 2.5\n",
            Time::Instant => "at_seconds = 2.5\n",
            Time::Boot => "",
        };
        if kind.is_drive_fault() {
            text += &format!("node = \"{}\"\n", self.drive(0));
        }
        for key in kind.keys {
            let line = format!("{} = {}\n", key.name, self.value(draw, key));
            text += match key.need {
                Need::Required => &line,
                _ => draw.maybe(&line),
            };
        }
        self.quantities.name(&text)
    }

    fn value(&self, draw: &mut Draw, key: &Key) -> String {
        match key.form {
            Form::Number(min, max) => format!("{:?}", 0.5_f64.clamp(min, max)),
            Form::Whole(..) if key.name == "node_id" => "0x60".to_owned(),
            Form::Whole(min, _) => min.to_string(),
            Form::Word(words) => format!("\"{}\"", draw.choose(words).0),
            Form::Node | Form::Station => format!("\"{}\"", self.drive(0)),
        }
    }

    /// Draws other values for the axis.
    fn values(&self, draw: &mut Draw) -> String {
        let (number, drive) = (self.number, self.drive(0));
        let parameter = draw.choose(self.plant.parameters);
        let mut text = draw
            .maybe(&format!("[plant.p{number}]\n{parameter}\n"))
            .to_owned();
        text += draw.maybe(&format!("[node.{drive}.sensor]\nnoise_rms = 0.1\n"));
        text += draw.maybe(&format!("[node.{drive}.plausible]\nstall.seconds = 2\n"));
        if self.quantities.output == Quantity::current() {
            text += draw.maybe(&format!("[node.{drive}.amplifier.i2t]\ncontinuous = 0.6\n"));
        }
        if self.is_external {
            text += draw.maybe(&format!("[node.{drive}.preflight]\ncooling_seconds = 2\n"));
        }
        text
    }
}
