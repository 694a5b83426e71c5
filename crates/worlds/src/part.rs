//! Part of a plan that a program may know: its node, the bus, and for each loop the frames, the limits and the set-point. The
//! plant, the disturbances, the faults and the limits of the verdict are not in it.

use dbc::{ByteOrder, Kind, Message, Signal, SignalHandle, names};
use plan::{ControlLoop, Plan};
use scenario::node::NodeIndex;
use serde_json::{Value, json};

/// Version of the file.
const VERSION: u32 = 1;
/// Largest number of rows of a set-point that is no straight line; the rows of a longer one are further apart than a cycle.
const ROWS_MAX: f64 = 100_000.0;

/// Returns the part of a node.
pub(crate) fn of(plan: &Plan, index: NodeIndex) -> Value {
    let node = &plan.nodes[index];
    let all = plan.loops.iter();
    let loops = all.filter(|one| one.trial.wiring.all_nodes().any(|other| other == index));
    json!({
        "version": VERSION,
        "node": {"name": node.name, "node_id": node.id(), "kind": node.word()},
        "bus": {
            "bits_per_second": 1_000 * plan.shared.run.bus.bitrate_kilobits_per_second,
            "period_seconds": plan.sync_period().as_secs_f64(),
        },
        "loops": Vec::from_iter(loops.map(|one| loop_part(plan, one, index))),
    })
}

fn loop_part(plan: &Plan, one: &ControlLoop, node: NodeIndex) -> Value {
    let wiring = &one.trial.wiring;
    let commands = wiring.amplifier.range();
    let drive = one.drive();
    let io = wiring.io_nodes().map(|io| {
        let io = one.node(io);
        json!({"name": io.name, "node_id": io.id()})
    });
    let mut told = json!({
        "name": one.name(),
        "drive": {"name": drive.name, "node_id": drive.id()},
        "io": Vec::from_iter(io),
        "signal": wiring.quantities.name(names::POSITION),
        "range": wiring.feedback.range(),
        "command_range": [commands.min, commands.max],
        "reads": frame(plan, one.position(plan.database()).ok()),
        "writes": frame(plan, one.target(plan.database()).ok()),
    });
    if node == plan.nodes.manager() && wiring.led_by.is_none() {
        let (end, period) = (
            plan.duration().as_secs_f64(),
            plan.sync_period().as_secs_f64(),
        );
        let spacing = period.max(end / ROWS_MAX);
        told["set_point"] = json!(one.trial.reference.trajectory().rows(end, spacing));
        let message = plan.database().message(&names::set_point(one.name()));
        told["set_points"] = message_layout(message);
    }
    told
}

/// Returns the frame of a signal.
fn frame(plan: &Plan, signal: Option<SignalHandle>) -> Value {
    let messages = plan.database().messages().iter();
    let id = signal.map(|signal| signal.raw_id());
    let mut messages = messages.filter(|message| Some(message.raw_id) == id);
    message_layout(messages.next())
}

fn message_layout(message: Option<&Message>) -> Value {
    message.map_or(Value::Null, |message| {
        let signals = Vec::from_iter(message.signals.iter().map(signal_layout));
        json!({"id": message.raw_id, "length": message.length_bytes, "signals": signals})
    })
}

fn signal_layout(signal: &Signal) -> Value {
    let coding = &signal.coding;
    json!({
        "name": signal.name,
        "unit": signal.unit,
        "start_bit": coding.start_bit,
        "bits": coding.length_bits,
        "is_little_endian": coding.byte_order == ByteOrder::LittleEndian,
        "kind": match coding.kind {
            Kind::Unsigned => "unsigned",
            Kind::Signed => "signed",
            Kind::Float32 | Kind::Float64 => "float",
        },
        "factor": coding.factor,
        "offset": coding.offset,
    })
}
