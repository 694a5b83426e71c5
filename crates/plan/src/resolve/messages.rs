//! Messages of a run: each node's, composed from the node's objects, and the bus's own.
//!
//! From the plan of a run, with the quantities of its drives, the terms of its laws, the outputs of its io nodes and its
//! identifiers, `database` composes what each frame means.

use canopen::ObjectDictionary;
use dbc::loops::TERMS_EVERY_CYCLES;
use dbc::messages::{Carried, Heading, Pdo, compose, services};
use dbc::node_objects;
use dbc::{Coding, Database, Kind, Message, Port, Signal, carried_terms, names};
use scenario::node::{Node, Profile};
use scenario::wiring::IoOutput;

use super::drive_messages::compose_drive;
use crate::plan::Plan;

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
pub(super) const SYNC_MILLISECONDS: u64 = 1;
/// Number of TPDOs that each loop has at the controller.
const TPDOS_OF_LOOP: u16 = 4;

/// Composes the messages of a run.
pub fn database(plan: &Plan) -> Database {
    let bus = BusNodes::new(plan);
    let mut messages = bus.bus_messages();
    messages.extend(controller(plan, &bus));
    for one in &plan.loops {
        messages.extend(compose_drive(one, &bus));
    }
    for (io, outputs) in plan.io_outputs() {
        messages.extend(io_node(&plan.nodes[*io], outputs, plan.controller(), &bus));
    }
    Database::from_messages(messages)
}

/// Nodes of a bus, by kind.
pub(super) struct BusNodes<'a> {
    pub(super) controller: &'a Node,
    drives: Vec<&'a Node>,
    io: Vec<&'a Node>,
}

impl<'a> BusNodes<'a> {
    fn new(plan: &'a Plan) -> Self {
        Self {
            controller: plan.controller(),
            drives: plan.loops.iter().map(|one| one.drive()).collect(),
            io: plan.io_outputs().map(|(io, _)| &plan.nodes[*io]).collect(),
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
    fn bus_messages(&self) -> Vec<Message> {
        let all = [self.controller]
            .into_iter()
            .chain(self.drives.iter().copied());
        let nodes = all.chain(self.io.iter().copied());
        let nmt = self.to_all(names::NMT_COMMAND.to_owned());
        let sync = self.to_all(names::SYNC.to_owned());
        vec![
            services::nmt_command(
                nmt.about("NMT node control (CiA 301, 7.2.8.2.1)."),
                nodes.map(|node| (node.id(), &*node.name)),
            ),
            services::sync(
                sync.about("SYNC with counter (CiA 301, 7.2.5): drives sample and apply commands at each SYNC. Period 0x1006, overflow 0x1019."),
                SYNC_MILLISECONDS,
            ),
        ]
    }

    /// Composes the services of a node: its emergencies, with labels for the manufacturer-specific field, its SDO channel and its heartbeat.
    pub(super) fn services(
        &self,
        node: &Node,
        heartbeat_milliseconds: u64,
        causes: Vec<(i64, String)>,
    ) -> Vec<Message> {
        let is_manager = node.profile() == Some(Profile::Manager);
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
        let id = u32::from(node.id());
        vec![
            services::emergency(
                from_node(names::EMERGENCY).about(format!("EMCY of {own} (CiA 301, 7.2.7).")),
                EMERGENCY + id,
                node.is_drive(),
                causes,
            ),
            services::sdo(
                from_node(names::SDO_ANSWER)
                    .about(format!("SDO answer of {own}'s default server channel.")),
                SDO_ANSWER + id,
                false,
            ),
            services::sdo(
                Heading::new(name(names::SDO_REQUEST), client, [own])
                    .about(format!("SDO request to {own}'s default server channel.")),
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
pub(super) fn heartbeat_of(objects: &ObjectDictionary) -> u64 {
    objects
        .unsigned(HEARTBEAT_TIME, 0)
        .unwrap_or_default()
        .into()
}

/// Composes the messages of the controller: its services, the terms of its laws, and the set-points that it gets.
fn controller(plan: &Plan, bus: &BusNodes<'_>) -> Vec<Message> {
    let node = bus.controller;
    let terms = plan.loops.iter().map(|one| {
        let terms = Vec::from_iter(one.published_terms().iter().cloned());
        (terms, one.trial.wiring.identifiers.terms)
    });
    let terms = Vec::from_iter(terms);
    let drives = Vec::from_iter(bus.drives.iter().map(|drive| drive.id()));
    let io = Vec::from_iter(bus.io.iter().map(|io| io.id()));
    let objects = node_objects::controller(node.id(), &terms, &drives, &io);
    let led = plan.loops.iter().map(|one| {
        let drive = one.drive();
        (
            &*drive.name,
            drive.id(),
            one.trial.wiring.drive_quantities(),
        )
    });
    let causes = services::causes_at(&Vec::from_iter(led));
    let mut messages = bus.services(node, heartbeat_of(&objects), causes);
    let carried = terms.iter().zip(0..);
    let carried = carried.flat_map(|((terms, _), place)| carried_terms(terms, place));
    let carried = carried.collect::<Carried>();
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
    if node.is_ours() {
        messages.extend(compose(&objects, &carried, SYNC_MILLISECONDS, heading));
    }
    if plan.set_points_every_cycles().is_some() {
        for one in plan.loops.iter().filter(|one| one.has_set_point()) {
            let wiring = &one.trial.wiring;
            let name = names::set_point(one.name());
            let heading = Heading::new(name, names::BENCH, [&*node.name]);
            messages.push(services::set_point(
                heading.about("The scenario's set-point for the next SYNC, sent by the bench."),
                wiring.identifiers.set_point.into(),
                &wiring.quantities.feedback,
                &wiring.quantities.name(names::SET_POINT),
            ));
        }
    }
    messages
}

/// Composes the messages of an io node with these outputs.
fn io_node(node: &Node, outputs: &[IoOutput], manager: &Node, bus: &BusNodes<'_>) -> Vec<Message> {
    let in_sheet = outputs.iter().map(IoOutput::in_sheet);
    let objects = node_objects::io(node.id(), in_sheet, manager.id());
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
    messages.extend(bus.services(node, heartbeat_of(&objects), Vec::new()));
    messages
}

/// Returns the signal of an output, which is signed on the bus (CiA 401).
fn io_signal(port: &Port) -> Signal {
    let mut coding = Coding::of_output(port.steps_per_unit, port.range);
    coding.kind = Kind::Signed;
    Signal::new(port.name.clone(), &port.symbol, &port.comment, coding)
}
