//! The messages of a drive, emulated or external.
//!
//! From a loop and the other nodes: the drive's PDOs, both SDO channels and the truth about the plant. `messages` calls
//! `compose_drive` for each drive of a run.

use canopen::ObjectDictionary;
use dbc::loops::truth_presets;
use dbc::messages::{Carried, Heading, Pdo, compose, services};
use dbc::node_objects::{self, PLANT_OBJECTS, PlantSignals, TRUE_POSITION_OBJECT};
use dbc::{Coding, Kind, Message, Quantity, Range, Signal, names};
use scenario::rig::drive::Scaled;
use scenario::rig::nodes::Amplifier;
use scenario::rig::object_address;
use scenario::wiring::{Measured, TRUE_STEPS_PER_UNIT};

use super::messages::{BusNodes, SYNC_MILLISECONDS, heartbeat_of};
use crate::loaded_drive::LoadedDrive;
use crate::plan::ControlLoop;

/// Objects of a drive (CiA 402-2): position actual value, current actual value, target torque. The last two carry the amplifier's
/// output and command in any quantity, not only a current.
const POSITION: (u16, u8) = (0x6064, 0);
const OUTPUT: (u16, u8) = (0x6078, 0);
const TARGET: (u16, u8) = (0x6071, 0);
/// PDOs of an external drive that this bus uses.
const USED: [Pdo; 2] = [Pdo::Transmit(1), Pdo::Receive(1)];

/// Composes the messages of a loop's drive.
pub(super) fn compose_drive(one: &ControlLoop, bus: &BusNodes<'_>) -> Vec<Message> {
    let (node, wiring) = (one.drive(), &one.trial.wiring);
    let (own, manager) = (&*node.name, &*bus.controller.name);
    let heading_of = |pdo: Pdo| {
        let heading = match pdo {
            Pdo::Transmit(1) => Heading::new(
                names::message(own, names::TPDO1),
                own,
                [manager, names::BENCH],
            ),
            Pdo::Transmit(number) => {
                Heading::new(format!("{own}_tpdo{number}"), own, [names::BENCH])
            }
            Pdo::Receive(number) => {
                Heading::new(format!("{own}_rpdo{number}"), manager, [own, names::BENCH])
            }
        };
        Some(heading.about(match pdo {
            Pdo::Transmit(number) => format!("TPDO{number} of {own}, sent at a SYNC."),
            Pdo::Receive(number) => format!("RPDO{number} of {own}, applied at the next SYNC."),
        }))
    };
    let (mut messages, heartbeat) = match &one.real_drive {
        Some(real) => {
            let (objects, carried) = (real.layout.mapped_objects(), external_signals(one, real));
            let used = |pdo: Pdo| USED.contains(&pdo).then(|| heading_of(pdo))?;
            let heartbeat = real.real.timeouts.drive_heartbeat_milliseconds.into();
            (
                compose(&objects, &carried, SYNC_MILLISECONDS, used),
                heartbeat,
            )
        }
        None => {
            let (objects, carried) = emulated_objects(one);
            let messages = compose(&objects, &carried, SYNC_MILLISECONDS, heading_of);
            (messages, heartbeat_of(&objects))
        }
    };
    messages.extend(bus.services(node, heartbeat, Vec::new()));
    let name = |service: &str| names::message(own, service);
    let [request, answer] = wiring.identifiers.second_sdo;
    messages.push(services::sdo(
        Heading::new(name(names::SDO2_REQUEST), names::BENCH, [own])
            .about(format!("SDO request to {own}'s second server channel.")),
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
        let heading = Heading::new(name(names::TRUTH), own, [names::BENCH]);
        messages.push(services::truth(
            heading.about(
                "Truth about the plant, sent only in scenarios with faults: every 10 ms, and when the amplifier's output starts or stops.",
            ),
            wiring.identifiers.truth.into(),
            plant_output(&wiring.quantities.output, &wiring.amplifier),
        ));
    }
    messages
}

/// Returns the objects of an emulated drive, and the signals that they carry.
fn emulated_objects(one: &ControlLoop) -> (ObjectDictionary, Carried) {
    let wiring = &one.trial.wiring;
    let (output, amplifier) = (&wiring.quantities.output, &wiring.amplifier);
    let (position, published) = (true_position(&wiring.sensor), one.published_signals());
    let truth = PlantSignals {
        published: published.iter().collect(),
        position: &position,
    };
    let pace = truth_presets(wiring.loop_number(), wiring.truth_every_cycles());
    let presets = one.trial.presets().into_iter().chain(pace);
    let objects = node_objects::drive(one.drive().id(), Some(truth), presets);
    let own = [
        (POSITION, feedback_signal(&wiring.sensor)),
        (OUTPUT, measured_output(output, amplifier)),
        (TARGET, target(output, amplifier)),
        ((TRUE_POSITION_OBJECT, 0), position),
    ];
    let numbered = PLANT_OBJECTS.into_iter().zip(published);
    let of_plant = numbered.map(|(index, signal)| ((index, 0), signal.clone()));
    let carried = own.into_iter().chain(of_plant);
    let carried = carried
        .map(|(object, signal)| (object, vec![signal]))
        .collect();
    (objects, carried)
}

/// Returns the signal of the position object of an emulated drive.
fn feedback_signal(sensor: &Measured) -> Signal {
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
fn amplifier_signal(
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
fn describe_counts(of: &Quantity, amplifier: &Amplifier) -> String {
    let rated = format!("{} {}", amplifier.rated(), of.unit.symbol());
    format!(
        "the object counts thousandths of the rated value of {}.",
        rated.trim_end()
    )
}

/// Returns the measured output of an amplifier.
fn measured_output(of: &Quantity, amplifier: &Amplifier) -> Signal {
    let ends = [-32.768, 32.767].map(|end| end * amplifier.rated());
    let comment = format!(
        "Output of the amplifier; {}",
        describe_counts(of, amplifier)
    );
    amplifier_signal(of.key(), of, amplifier, ends, &comment)
}

/// Returns a symmetric command range that includes the rated value.
fn both_ways(amplifier: &Amplifier) -> [f64; 2] {
    let most = amplifier.range().largest().max(amplifier.rated());
    [-most, most]
}

/// Returns the command to an amplifier.
fn target(of: &Quantity, amplifier: &Amplifier) -> Signal {
    let counted = describe_counts(of, amplifier);
    let comment = format!("Command to the amplifier, as target torque: {counted}");
    let name = format!("target_{}", of.key());
    amplifier_signal(name, of, amplifier, both_ways(amplifier), &comment)
}

/// Returns the output of an amplifier that really acts.
fn plant_output(of: &Quantity, amplifier: &Amplifier) -> Signal {
    let comment = "Output of the amplifier that really acts.";
    let name = format!("plant_{}", of.key());
    amplifier_signal(name, of, amplifier, both_ways(amplifier), comment)
}

/// Returns the signals of an external drive's objects, scaled as in the rig file.
fn external_signals(one: &ControlLoop, drive: &LoadedDrive) -> Carried {
    let (quantities, layout) = (one.trial.wiring.drive_quantities(), &drive.layout);
    let (measured, output) = (&quantities.feedback, &quantities.output);
    let signal = |name: String, of: &Quantity, comment: &str, scaled: Scaled| {
        Signal::new(name, of.unit.symbol(), comment, coding_of(scaled))
    };
    let position = signal(
        measured.key(),
        measured,
        "Signal that the drive's sensor measures.",
        layout.position,
    );
    let target = signal(
        format!("target_{}", output.key()),
        output,
        "Command to the amplifier.",
        layout.target,
    );
    let current = layout.current.map(|current| {
        let current = signal(output.key(), output, "Output of the amplifier.", current);
        (&drive.real.current.object, current)
    });
    let named = [
        (&drive.real.position.object, position),
        (&drive.real.command.object, target),
    ];
    let carried = named.into_iter().chain(current);
    // `LoadedDrive` has already found these objects in the EDS.
    let carried = carried.filter_map(|(object, signal)| {
        let address = object_address(object).ok()?;
        Some((address, vec![signal]))
    });
    carried.collect()
}

/// Returns the coding of a scaled object, starting at the object's first bit.
fn coding_of(scaled: Scaled) -> Coding {
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
