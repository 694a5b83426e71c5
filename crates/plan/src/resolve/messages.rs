//! The messages of a run: those of each node, composed from its objects, and those of the bus.
//!
//! In comes the plan of a run, with the quantities of its drives, the terms of its laws, the outputs of its io nodes and the
//! identifiers of its frames; out comes the database that says what each frame means. `Plan` asks for it once.

use canopen::ObjectDictionary;
use dbc::loops::{TERMS_EVERY_CYCLES, truth_presets};
use dbc::messages::{Carried, Heading, Pdo, compose, services};
use dbc::node_objects::{self, PLANT_OBJECTS, PlantSignals, TRUE_POSITION_OBJECT};
use dbc::{
    Coding, Database, Kind, Message, Port, Quantity, Range, Signal, first_term, layout, names,
};
use scenario::node::{Node, Part};
use scenario::rig::drive::Scaled;
use scenario::rig::nodes::Amplifier;
use scenario::rig::object_address;
use scenario::wiring::{IoOutput, Measured, TRUE_STEPS_PER_UNIT};

use crate::plan::{ControlLoop, Plan};

/// Objects of a drive: position, torque and target torque (CiA 402-2), which an amplifier gives whatever its quantity.
const POSITION: (u16, u8) = (0x6064, 0);
const OUTPUT: (u16, u8) = (0x6078, 0);
const TARGET: (u16, u8) = (0x6071, 0);
/// Analogue outputs (CiA 401).
const IO_OUTPUTS: u16 = 0x6411;
/// Heartbeat time of a node (CiA 301).
const HEARTBEAT_TIME: u16 = 0x1017;
/// Functions of the predefined connection set (CiA 301, 7.3.5).
const EMERGENCY: u32 = 0x080;
const SDO_ANSWER: u32 = 0x580;
const SDO_REQUEST: u32 = 0x600;
const HEARTBEAT: u32 = 0x700;
/// The SYNC period for which cycle times are given.
const SYNC_MILLISECONDS: u64 = 1;
/// PDOs of a real drive that this bus uses.
const USED: [Pdo; 2] = [Pdo::Transmit(1), Pdo::Receive(1)];

/// Composes the messages of a run.
pub fn database(plan: &Plan) -> Database {
    let bus = BusNames::new(plan);
    let mut messages = bus.own();
    messages.extend(controller(plan, &bus));
    for one in &plan.loops {
        messages.extend(drive(plan, one, &bus));
    }
    for (io, outputs) in plan.io_outputs() {
        messages.extend(io_node(io, outputs, plan.controller(), &bus));
    }
    Database::from_messages(messages)
}

/// Names of the nodes of a bus.
struct BusNames<'a> {
    controller: &'a Node,
    drives: Vec<&'a Node>,
    io: Vec<&'a Node>,
}

impl<'a> BusNames<'a> {
    fn new(plan: &'a Plan) -> Self {
        Self {
            controller: plan.controller(),
            drives: plan.loops.iter().map(|one| &one.nodes.drive).collect(),
            io: plan.io_outputs().map(|(io, _)| io).collect(),
        }
    }

    /// Returns the nodes that the controller leads, and the bench.
    fn listeners(&self) -> impl Iterator<Item = &str> {
        let nodes = self.drives.iter().chain(&self.io);
        nodes.map(|node| &*node.name).chain([names::BENCH])
    }

    /// Returns the heading of a message of the controller to all others.
    fn to_all(&self, name: String) -> Heading {
        Heading::new(name, &self.controller.name, self.listeners())
    }

    /// Composes the messages of the bus itself.
    fn own(&self) -> Vec<Message> {
        let all = [self.controller]
            .into_iter()
            .chain(self.drives.iter().copied());
        let nodes = all.chain(self.io.iter().copied());
        let nmt = self.to_all(names::NMT_COMMAND.to_owned());
        let sync = self.to_all(names::SYNC.to_owned());
        vec![
            services::nmt_command(
                nmt.about("NMT node control (CiA 301, 7.2.8.2.1)."),
                nodes.map(|node| (node.id, &*node.name)),
            ),
            services::sync(
                sync.about("SYNC with counter (CiA 301, 7.2.5): drives sample and apply on it. Period 0x1006, overflow 0x1019."),
                SYNC_MILLISECONDS,
            ),
        ]
    }

    /// Composes the services of a node that answers a client: its emergencies, its SDO channel and its heartbeat.
    fn services(&self, node: &Node, heartbeat_milliseconds: u64) -> Vec<Message> {
        let is_manager = node.part == Part::Controller;
        let own = &*node.name;
        let watching = if is_manager {
            vec![names::BENCH]
        } else {
            vec![&*self.controller.name, names::BENCH]
        };
        let client = watching[0];
        let name = |service: &str| names::message(own, service);
        let from_node = |service: &str| Heading::new(name(service), own, watching.clone());
        let heartbeat = if is_manager {
            self.to_all(name(names::HEARTBEAT))
        } else {
            from_node(names::HEARTBEAT)
        };
        let id = u32::from(node.id);
        vec![
            services::emergency(
                from_node(names::EMERGENCY).about(format!("EMCY of {own} (CiA 301, 7.2.7).")),
                EMERGENCY + id,
                node.part == Part::Drive,
                Vec::new(),
            ),
            services::sdo(
                from_node(names::SDO_ANSWER)
                    .about(format!("SDO answer of {own}'s default server channel.")),
                SDO_ANSWER + id,
                false,
            ),
            services::sdo(
                Heading::new(name(names::SDO_REQUEST), client, [own])
                    .about(format!("SDO client to {own}'s default server channel.")),
                SDO_REQUEST + id,
                true,
            ),
            services::heartbeat(
                heartbeat.about(format!(
                    "Heartbeat and boot-up of {own} (CiA 301, 7.2.8.3.2)."
                )),
                HEARTBEAT + id,
                heartbeat_milliseconds,
            ),
        ]
    }
}

/// Returns the heartbeat time of a node, in milliseconds.
fn heartbeat_of(objects: &ObjectDictionary) -> u64 {
    objects
        .unsigned(HEARTBEAT_TIME, 0)
        .unwrap_or_default()
        .into()
}

/// Composes the messages of the controller: its services, the terms of its laws, and the set-points that it gets.
fn controller(plan: &Plan, bus: &BusNames<'_>) -> Vec<Message> {
    let node = bus.controller;
    let terms = plan.loops.iter().map(|one| {
        let terms = Vec::from_iter(one.published_terms().iter().cloned());
        (terms, one.trial.wiring.identifiers.terms)
    });
    let terms = Vec::from_iter(terms);
    let drives = Vec::from_iter(bus.drives.iter().map(|drive| drive.id));
    let io = Vec::from_iter(bus.io.iter().map(|io| io.id));
    let objects = node_objects::controller(node.id, &terms, &drives, &io);
    let mut messages = bus.services(node, heartbeat_of(&objects));
    let emergency = names::message(&node.name, names::EMERGENCY);
    for message in messages
        .iter_mut()
        .filter(|message| message.name == emergency)
    {
        for signal in &mut message.signals {
            if signal.name == names::MANUFACTURER_ERROR {
                signal.labels = causes(plan);
            }
        }
    }
    let mut carried = Carried::new();
    for ((terms, _), place) in terms.iter().zip(0..) {
        carry_terms(&mut carried, terms, place);
    }
    let heading = |pdo: Pdo| {
        let Pdo::Transmit(number) = pdo else {
            return None;
        };
        let [of_loop, place] = [(number - 1) / TPDOS_OF_LOOP, (number - 1) % TPDOS_OF_LOOP];
        let one = &plan.loops[usize::from(of_loop)];
        let loop_name = one.trial.wiring.loop_among_several();
        let name = names::terms(&node.name, loop_name, place.into());
        let comment = format!(
            "TPDO{} of the controller, every {TERMS_EVERY_CYCLES}th SYNC: terms of the law.",
            place + 1
        );
        Some(Heading::new(name, &node.name, [names::BENCH]).about(comment))
    };
    if one_is_ours(plan) {
        messages.extend(compose(&objects, &carried, SYNC_MILLISECONDS, heading));
    }
    if plan.set_points_every_cycles().is_some() {
        for one in plan.loops.iter().filter(|one| one.has_set_point()) {
            let wiring = &one.trial.wiring;
            let name = names::set_point(one.name());
            let heading = Heading::new(name, names::BENCH, [&*node.name]);
            messages.push(services::set_point(
                heading
                    .about("From the bench after a SYNC: what the scenario wants at the next one."),
                wiring.identifiers.set_point.into(),
                &wiring.quantities.feedback,
                &wiring.quantities.name(names::SET_POINT),
            ));
        }
    }
    messages
}

/// Number of TPDOs that each loop has at the controller.
const TPDOS_OF_LOOP: u16 = 4;

/// Checks whether canrig plays the controller.
fn one_is_ours(plan: &Plan) -> bool {
    plan.loops.iter().all(|one| one.is_ours(Part::Controller))
}

/// Lays the terms of a law into the objects of its loop's place.
fn carry_terms(carried: &mut Carried, terms: &[Signal], place: u8) {
    let objects = layout(terms).unwrap_or_default();
    for (index, object) in (first_term(place)..).zip(&objects) {
        let signals = object.terms.iter().map(|(term, bit)| {
            let term = &terms[*term];
            Signal {
                coding: term.coding.starting_at(*bit),
                labels: match term.coding.length_bits {
                    1 => dbc::messages::words::yes_or_no(),
                    _ => Vec::new(),
                },
                ..term.clone()
            }
        });
        carried.insert((index, 0), signals.collect());
    }
}

/// Returns the causes for which the controller gives up. Of several drives each has causes of its own, whose lowest byte is its
/// node-ID.
fn causes(plan: &Plan) -> Vec<(i64, String)> {
    let of = |one: &ControlLoop| {
        let wiring = &one.trial.wiring;
        services::causes(&wiring.sensor.quantity, &wiring.quantities.output)
    };
    if let [only] = &plan.loops[..] {
        return of(only);
    }
    let mut causes = services::causes(&Quantity::default(), &Quantity::current());
    for one in &plan.loops {
        let drive = &one.nodes.drive;
        let own = of(one).into_iter();
        causes.extend(own.map(|(cause, text)| {
            (
                cause | i64::from(drive.id),
                format!("{text} ({})", drive.name),
            )
        }));
    }
    causes
}

/// Composes the messages of a loop's drive.
fn drive(plan: &Plan, one: &ControlLoop, bus: &BusNames<'_>) -> Vec<Message> {
    let (node, wiring) = (&one.nodes.drive, &one.trial.wiring);
    let (own, manager) = (&*node.name, &*bus.controller.name);
    let heading = |pdo: Pdo| match pdo {
        Pdo::Transmit(1) => Some(
            Heading::new(
                names::message(own, names::TPDO1),
                own,
                [manager, names::BENCH],
            )
            .about(format!("TPDO1 of {own}, on SYNC.")),
        ),
        Pdo::Transmit(number) => Some(
            Heading::new(format!("{own}_tpdo{number}"), own, [names::BENCH])
                .about(format!("TPDO{number} of {own}, on SYNC.")),
        ),
        Pdo::Receive(1) => Some(
            Heading::new(
                names::message(own, names::RPDO1),
                manager,
                [own, names::BENCH],
            )
            .about(format!("RPDO1 of {own}, taken over at the next SYNC.")),
        ),
        Pdo::Receive(_) => None,
    };
    let (objects, heartbeat, mut messages) = match &one.real_drive {
        Some(real) => {
            let objects = real.layout.mapped_objects();
            let carried = real_signals(one);
            let used = |pdo: Pdo| USED.contains(&pdo).then(|| heading(pdo))?;
            let messages = compose(&objects, &carried, SYNC_MILLISECONDS, used);
            let heartbeat = real.real.timeouts.drive_heartbeat_milliseconds.into();
            (objects, heartbeat, messages)
        }
        None => {
            let position = true_position(&wiring.sensor);
            let published = one.published_signals();
            let truth = PlantSignals {
                published: published.iter().collect(),
                position: &position,
            };
            let pace = truth_presets(wiring.loop_number(), wiring.truth_every_cycles());
            let presets = one.trial.presets().into_iter().chain(pace);
            let objects = node_objects::drive(node.id, Some(truth), presets);
            let mut carried = Carried::from([
                (POSITION, vec![measured(&wiring.sensor)]),
                (
                    OUTPUT,
                    vec![output(&wiring.quantities.output, &wiring.amplifier)],
                ),
                (
                    TARGET,
                    vec![target(&wiring.quantities.output, &wiring.amplifier)],
                ),
                ((TRUE_POSITION_OBJECT, 0), vec![position.clone()]),
            ]);
            let numbered = PLANT_OBJECTS.into_iter().zip(published);
            carried.extend(numbered.map(|(index, signal)| ((index, 0), vec![signal.clone()])));
            let messages = compose(&objects, &carried, SYNC_MILLISECONDS, heading);
            let heartbeat = heartbeat_of(&objects);
            (objects, heartbeat, messages)
        }
    };
    let _ = (objects, plan);
    messages.extend(bus.services(node, heartbeat));
    let name = |service: &str| names::message(own, service);
    let [request, answer] = wiring.identifiers.second_sdo;
    messages.push(services::sdo(
        Heading::new(name(names::SDO2_REQUEST), names::BENCH, [own])
            .about(format!("SDO client to {own}'s second server channel.")),
        request.into(),
        true,
    ));
    messages.push(services::sdo(
        Heading::new(name(names::SDO2_ANSWER), own, [names::BENCH])
            .about(format!("SDO answer of {own}'s second server channel.")),
        answer.into(),
        false,
    ));
    if one.real_drive.is_none() {
        messages.push(services::truth(
            Heading::new(name(names::TRUTH), own, [names::BENCH]).about(
                "Truth about the plant, in scenarios with faults only: every 10 ms, and whenever the amplifier's output begins or ends.",
            ),
            wiring.identifiers.truth.into(),
            plant_output(&wiring.quantities.output, &wiring.amplifier),
        ));
    }
    messages
}

/// Returns the signal of the position object of an emulated drive.
fn measured(sensor: &Measured) -> Signal {
    let factor = 1.0 / sensor.counts_per_unit();
    let [minimum, maximum] = [i32::MIN, i32::MAX].map(|end| f64::from(end) * factor);
    let range = Some(Range { minimum, maximum });
    let coding = Coding::little_endian(0, 32, Kind::Signed, factor, range);
    let Quantity { unit, .. } = &sensor.quantity;
    let comment = "Signal that the drive's sensor measures.";
    Signal::new(sensor.quantity.key(), unit.symbol(), comment, coding)
}

/// Returns the signal of the position before the sensor: in millionths of its unit, or a float where 32 bits do not hold it.
fn true_position(sensor: &Measured) -> Signal {
    let coding = if sensor.is_true_float() {
        Coding::little_endian(0, 32, Kind::Float32, 1.0, None)
    } else {
        let factor = 1.0 / TRUE_STEPS_PER_UNIT;
        let [minimum, maximum] = [i32::MIN, i32::MAX].map(|end| f64::from(end) * factor);
        let range = Some(Range { minimum, maximum });
        Coding::little_endian(0, 32, Kind::Signed, factor, range)
    };
    let name = format!("true_{}", sensor.quantity.key());
    let symbol = sensor.quantity.unit.symbol();
    Signal::new(
        name,
        symbol,
        "Signal of the drive before its sensor.",
        coding,
    )
}

/// Returns the signal of an output of an amplifier in 16 bits, in thousandths of its rated value.
fn thousandths(
    name: String,
    of: &Quantity,
    amplifier: &Amplifier,
    [minimum, maximum]: [f64; 2],
    comment: &str,
) -> Signal {
    let range = Some(Range { minimum, maximum });
    let coding = Coding::little_endian(0, 16, Kind::Signed, 1e-3 * amplifier.rated(), range);
    Signal::new(name, of.unit.symbol(), comment, coding)
}

/// Describes the counts of an object of an amplifier.
fn counted(of: &Quantity, amplifier: &Amplifier) -> String {
    let rated = format!("{} {}", amplifier.rated(), of.unit.symbol());
    format!(
        "the object counts thousandths of the rated value of {}.",
        rated.trim_end()
    )
}

/// Returns the measured output of an amplifier.
fn output(of: &Quantity, amplifier: &Amplifier) -> Signal {
    let ends = [-32.768, 32.767].map(|end| end * amplifier.rated());
    let comment = format!("Output of the amplifier; {}", counted(of, amplifier));
    thousandths(of.key(), of, amplifier, ends, &comment)
}

/// Returns the range of commands to an amplifier in either direction: they reach the rated value at least.
fn both_ways(amplifier: &Amplifier) -> [f64; 2] {
    let most = amplifier.range().largest().max(amplifier.rated());
    [-most, most]
}

/// Returns the command to an amplifier.
fn target(of: &Quantity, amplifier: &Amplifier) -> Signal {
    let counted = counted(of, amplifier);
    let comment = format!("Command to the amplifier, as target torque: {counted}");
    let name = format!("target_{}", of.key());
    thousandths(name, of, amplifier, both_ways(amplifier), &comment)
}

/// Returns the output of an amplifier that really acts.
fn plant_output(of: &Quantity, amplifier: &Amplifier) -> Signal {
    let comment = "Output of the amplifier that really acts.";
    let name = format!("plant_{}", of.key());
    thousandths(name, of, amplifier, both_ways(amplifier), comment)
}

/// Returns the signals of the objects that a rig file names of a real drive, as it counts them.
fn real_signals(one: &ControlLoop) -> Carried {
    let mut carried = Carried::new();
    let Some(real) = &one.real_drive else {
        return carried;
    };
    let (quantities, layout) = (one.trial.wiring.drive_quantities(), &real.layout);
    let (measured, output) = (&quantities.feedback, &quantities.output);
    let mut carry = |object: &str, scaled: Scaled, name: String, of: &Quantity, comment: &str| {
        if let Ok(address) = object_address(object) {
            let signal = Signal::new(name, of.unit.symbol(), comment, counts(scaled));
            carried.insert(address, vec![signal]);
        }
    };
    let comment = "Signal that the drive's sensor measures.";
    carry(
        &real.real.position.object,
        layout.position,
        measured.key(),
        measured,
        comment,
    );
    if let Some(current) = layout.current {
        carry(
            &real.real.current.object,
            current,
            output.key(),
            output,
            "Output of the amplifier.",
        );
    }
    let target = format!("target_{}", output.key());
    carry(
        &real.real.command.object,
        layout.target,
        target,
        output,
        "Command to the amplifier.",
    );
    carried
}

/// Returns the coding of an object that a rig file scales, from its own first bit on.
fn counts(scaled: Scaled) -> Coding {
    let Scaled {
        field,
        units,
        offset,
    } = scaled;
    let kind = if field.is_signed {
        Kind::Signed
    } else {
        Kind::Unsigned
    };
    let bits = u8::try_from(8 * field.length_bytes).unwrap_or(u8::MAX);
    Coding::integer(0, bits, kind, units, offset)
}

/// Composes the messages of an io node with these outputs.
fn io_node(node: &Node, outputs: &[IoOutput], manager: &Node, bus: &BusNames<'_>) -> Vec<Message> {
    let in_sheet = outputs.iter().map(IoOutput::in_sheet);
    let objects = node_objects::io(node.id, in_sheet, manager.id);
    let carried = outputs.iter().map(|output| {
        let sub_index = u8::try_from(output.place + 1).unwrap_or(u8::MAX);
        ((IO_OUTPUTS, sub_index), vec![io_signal(&output.port)])
    });
    let own = &*node.name;
    let heading = |pdo: Pdo| {
        let heading = Heading::new(names::message(own, names::RPDO1), names::BENCH, [own]);
        let comment = format!("RPDO1 of {own} (event-driven): its analogue outputs.");
        (pdo == Pdo::Receive(1)).then(|| heading.about(comment))
    };
    let mut messages = compose(&objects, &carried.collect(), SYNC_MILLISECONDS, heading);
    messages.extend(bus.services(node, heartbeat_of(&objects)));
    messages
}

/// Returns the signal of an output, which is signed on the bus (CiA 401).
fn io_signal(port: &Port) -> Signal {
    let mut coding = Coding::of_output(port.steps_per_unit, port.range);
    coding.kind = Kind::Signed;
    Signal::new(port.name.clone(), &port.symbol, &port.comment, coding)
}
