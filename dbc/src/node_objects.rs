//! The objects of the nodes of a rig: those of the shipped data sheets, with the signals of the rig in place of the shipped ones.
//!
//! A node has these objects, and its data sheet is written from them.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

use canopen::ObjectDictionary;
use canopen::object_dictionary::{Access, DataType, Entry, Preset};

use crate::coding::Kind;
use crate::data_sheets::{CONTROLLER_EDS, DISTURBANCE_EDS, DRIVE_EDS};
use crate::database::{Database, Signal};
use crate::dictionary;
use crate::law::{first_term, layout};
use crate::names::{ADDED_LOAD, CONVECTION_FACTOR, TERMS_MAX};

/// Manufacturer device name (CiA 301).
pub(crate) const DEVICE_NAME: (u16, u8) = (0x1008, 0);
/// Consumer heartbeat time (CiA 301).
pub const CONSUMER_HEARTBEAT_TIME: u16 = 0x1016;
/// Entry of the controller's 0x1016 that watches the first io node; those of further ones come behind those of all drives.
const IO_WATCH_ENTRY: u8 = 2;
/// Time in milliseconds after which an io node reacts to the silence of its manager (0x1016).
pub const IO_WATCH_MILLISECONDS: u16 = 0xFA;
/// Parameters of SDO clients (CiA 301, 7.5.2.33).
const SDO_CLIENTS: RangeInclusive<u16> = 0x1280..=0x12FF;

/// Objects of an emulated drive for the signals of its plant, in their order.
pub const PLANT_OBJECTS: [u16; 6] = [0x2101, 0x2102, 0x2104, 0x2105, 0x2106, 0x2107];
/// Object of an emulated drive for the true position.
pub const TRUE_POSITION_OBJECT: u16 = 0x2103;
/// Number of a plant's signals that share TPDO2 with the true position.
pub(crate) const SIGNALS_IN_TPDO2: usize = 2;

/// Objects of the parameters and of the mapping of a node's first TPDO, and the number of TPDOs of each loop of the controller.
const TPDOS: [u16; 2] = [0x1800, 0x1A00];
const TPDOS_OF_LOOP: u16 = 4;
/// Sub-index of the SYNC start value of a TPDO (CiA 301, 7.5.2.37).
const SYNC_START: u8 = 6;
/// Identifier of TPDO3 without the node-ID (CiA 301, 7.3.5).
const TPDO3_FUNCTION: u16 = 0x380;

/// Objects "write analogue output 16-bit", error mode and error value (CiA 401), each with the type and the access of its entries.
const OUTPUTS: u16 = 0x6411;
const OUTPUT_OBJECTS: [(u16, DataType, Access); 3] = [
    (OUTPUTS, DataType::Integer16, Access::ReadWriteWrite),
    (0x6443, DataType::Unsigned8, Access::ReadWrite),
    (0x6444, DataType::Integer32, Access::ReadWrite),
];
/// Mapping of an io node's RPDO1.
const OUTPUT_MAPPING: u16 = 0x1600;
const OUTPUT_BITS: i64 = 16;
const MAPPED_MAX: u8 = 8;

/// Returns the entry of the controller's 0x1016 that watches the drive of a loop, by the place of the loop.
pub fn watch_entry(loop_place: usize) -> u8 {
    let behind_io = u8::try_from(loop_place + usize::from(IO_WATCH_ENTRY));
    behind_io.map_or(u8::MAX, |entry| if loop_place == 0 { 1 } else { entry })
}

/// Returns the objects of the controller of a rig: with the terms of each loop's law and the identifiers of its TPDOs, and with an
/// SDO client for each of these drives and io nodes.
///
/// # Panics
/// If the node-ID is not from 1 to 127.
pub fn controller(
    own_id: u8,
    loops: &[(Vec<Signal>, [u16; TERMS_MAX])],
    drives: &[u8],
    io_nodes: &[u8],
) -> ObjectDictionary {
    let mut objects = shipped_objects(CONTROLLER_EDS, own_id);
    let laws = TPDOS.map(|first| first..first + TPDOS_OF_LOOP);
    let terms = first_term(0)..first_term(1);
    let shipped = objects.take(|Entry { index, .. }| {
        let is_of_law = terms.contains(index) || laws.iter().any(|one| one.contains(index));
        is_of_law || SDO_CLIENTS.contains(index)
    });
    let mut known = BTreeSet::new();
    let nodes = drives.iter().chain(io_nodes);
    let servers = nodes.filter(|id| known.insert(**id));
    let first_client = shipped.entries().iter();
    let first_client = first_client.filter(|entry| entry.index == *SDO_CLIENTS.start());
    for (index, server) in SDO_CLIENTS.zip(servers.copied()) {
        for entry in first_client.clone() {
            objects.insert(entry.clone().at(index, entry.sub_index));
        }
        let identifiers = [0x600, 0x580].map(|function| function + i64::from(server));
        for (sub_index, value) in (1..).zip(identifiers.into_iter().chain([server.into()])) {
            objects.preset(&Preset::new(index, sub_index, value));
        }
    }
    for (place, (terms, identifiers)) in (0..).zip(loops) {
        add_terms(&mut objects, &shipped, terms, identifiers, place);
    }
    // The data sheet watches the module of the shipped rig, whose node-ID may belong to a drive here.
    let shipped_watch = objects.unsigned(CONSUMER_HEARTBEAT_TIME, IO_WATCH_ENTRY);
    let io_milliseconds = shipped_watch.unwrap_or_default() & u32::from(u16::MAX);
    let mut watched = BTreeMap::from([(IO_WATCH_ENTRY, 0)]);
    for place in 0..loops.len() {
        let drive = drives.get(place).copied().unwrap_or_default();
        watched.insert(watch_entry(place), u32::from(drive) << 16);
    }
    let entries = [IO_WATCH_ENTRY]
        .into_iter()
        .chain((loops.len()..).map(watch_entry));
    for (entry, io) in entries.zip(io_nodes) {
        watched.insert(entry, u32::from(*io) << 16 | io_milliseconds);
    }
    let count = watched.keys().last().copied().unwrap_or_default();
    let first = objects
        .get(CONSUMER_HEARTBEAT_TIME, watch_entry(0))
        .cloned();
    for (entry, value) in watched {
        if let Some(mut like) = first.clone() {
            like.name = format!("Consumer heartbeat time {entry}");
            objects.insert(like.at(CONSUMER_HEARTBEAT_TIME, entry));
        }
        objects.preset(&Preset::new(CONSUMER_HEARTBEAT_TIME, entry, value.into()));
    }
    objects.preset(&Preset::new(CONSUMER_HEARTBEAT_TIME, 0, count.into()));
    objects
}

/// Adds the terms of a loop's law, and the TPDOs that carry them, to the objects of the controller.
fn add_terms(
    objects: &mut ObjectDictionary,
    shipped: &ObjectDictionary,
    terms: &[Signal],
    identifiers: &[u16; TERMS_MAX],
    loop_place: u8,
) {
    let laid_out = layout(terms).unwrap_or_default();
    let numbered = || (first_term(loop_place)..).zip(&laid_out);
    for ((index, object), known) in numbered().zip(first_term(0)..) {
        let parts = Vec::from_iter(object.terms.iter().map(|(term, _)| &terms[*term]));
        let entry = entry_of(shipped, known, &parts, object.bits);
        objects.insert(entry.at(index, 0));
    }
    for (number, (message, identifier)) in (0..TPDOS_OF_LOOP).zip(identifiers.iter().enumerate()) {
        let own = numbered().filter(|(_, object)| object.message == message);
        let mapped = own.map(|(index, object)| u32::from(index) << 16 | u32::from(object.bits));
        let mapped = Vec::from_iter(mapped);
        if mapped.is_empty() {
            continue;
        }
        let like = TPDOS.map(|first| first + number);
        let at = like.map(|index| index + TPDOS_OF_LOOP * u16::from(loop_place));
        let tpdo = shipped.pdo_like(like, at, *identifier, &mapped);
        tpdo.into_iter().for_each(|entry| objects.insert(entry));
        // Each loop has its own cycles (`loops::terms_cycle`).
        objects.preset(&Preset::new(at[0], SYNC_START, loop_place.into()));
    }
}

/// The signals that an emulated drive publishes of its plant.
#[derive(Debug)]
pub struct PlantSignals<'a> {
    /// Outputs of the plant, in their order.
    pub published: Vec<&'a Signal>,
    /// Position before the sensor.
    pub position: &'a Signal,
}

impl<'a> PlantSignals<'a> {
    /// Returns those of a drive of a database; `None` if it publishes none.
    pub fn of(database: &'a Database, drive: &str) -> Option<Self> {
        let mut messages = database.plant_messages(drive);
        let (position, first) = messages.next()?.signals.split_last()?;
        let others = messages.flat_map(|message| &message.signals);
        let published = first.iter().chain(others).collect();
        Some(Self {
            published,
            position,
        })
    }
}

/// Returns the objects of an emulated drive with a node-ID, with the signals of its plant and with `presets`. Signals that do not fit
/// into TPDO2 are in a TPDO3.
///
/// # Panics
/// If the node-ID is not from 1 to 127.
pub fn drive(
    node_id: u8,
    truth: Option<PlantSignals<'_>>,
    presets: impl IntoIterator<Item = Preset>,
) -> ObjectDictionary {
    let mut objects = shipped_objects(DRIVE_EDS, node_id);
    if let Some(PlantSignals {
        published,
        position,
    }) = truth
    {
        let mut add = |index, signal: &Signal| {
            let bits = signal.coding.length_bits;
            let entry = entry_of(&objects, index, &[signal], bits);
            objects.insert(entry);
            u32::from(index) << 16 | u32::from(bits)
        };
        add(TRUE_POSITION_OBJECT, position);
        let numbered = PLANT_OBJECTS.into_iter().zip(&published);
        let mapped = Vec::from_iter(numbered.map(|(index, signal)| add(index, signal)));
        let in_tpdo2 = PLANT_OBJECTS.into_iter().take(SIGNALS_IN_TPDO2);
        for index in in_tpdo2.skip(published.len()) {
            objects.insert(published_entry(index, "reserved", DataType::Unsigned16));
        }
        if let Some(mapped @ [_, ..]) = mapped.get(SIGNALS_IN_TPDO2..) {
            let identifier = TPDO3_FUNCTION + u16::from(node_id);
            let [like, at] = [1, 2].map(|number| TPDOS.map(|first| first + number));
            let tpdo3 = objects.pdo_like(like, at, identifier, mapped);
            tpdo3.into_iter().for_each(|entry| objects.insert(entry));
        }
    }
    presets
        .into_iter()
        .for_each(|preset| objects.preset(&preset));
    objects
}

/// Returns the objects of an io node (CiA 401) that its manager leads, with these analogue outputs, each with its place from 0, its
/// name, and its value at the start and after an error, in steps. The data sheet has the fan and the load, before all others.
///
/// # Panics
/// If the node-ID is not from 1 to 127.
pub fn io<'a>(
    node_id: u8,
    outputs: impl Iterator<Item = (usize, &'a str, i16)>,
    manager: u8,
) -> ObjectDictionary {
    let mut objects = shipped_objects(DISTURBANCE_EDS, node_id);
    let watch = i64::from(manager) << 16 | i64::from(IO_WATCH_MILLISECONDS);
    objects.preset(&Preset::new(CONSUMER_HEARTBEAT_TIME, 1, watch));
    let is_other = |(_, name, _): &(_, &str, _)| ![CONVECTION_FACTOR, ADDED_LOAD].contains(name);
    let others = Vec::from_iter(outputs.filter(is_other));
    let Some((last, ..)) = others.last() else {
        return objects;
    };
    let count = u8::try_from(last + 1).unwrap_or(u8::MAX);
    let is_output = |index: u16| OUTPUT_OBJECTS.iter().any(|(object, ..)| *object == index);
    objects.take(|entry| is_output(entry.index) && entry.sub_index > count);
    for (place, name, at_rest) in others {
        let sub_index = u8::try_from(place + 1).unwrap_or(u8::MAX);
        for (index, data_type, access) in OUTPUT_OBJECTS {
            let is_mode = data_type == DataType::Unsigned8;
            let value = if is_mode { 1 } else { i32::from(at_rest) };
            let default = value.to_le_bytes()[..data_type.size_bytes().unwrap_or(4)].to_vec();
            let mut entry = Entry::new(index, sub_index, name, data_type, access, default);
            entry.is_pdo_mappable = index == OUTPUTS;
            entry.low_limit = is_mode.then_some(0);
            entry.high_limit = is_mode.then_some(1);
            objects.insert(entry);
        }
    }
    let counted = OUTPUT_OBJECTS.map(|(index, ..)| index).into_iter();
    for index in counted.chain([OUTPUT_MAPPING]) {
        objects.preset(&Preset::new(index, 0, count.into()));
    }
    for number in 1..=MAPPED_MAX {
        let mapped = i64::from(OUTPUTS) << 16 | i64::from(number) << 8 | OUTPUT_BITS;
        let value = if number > count { 0 } else { mapped };
        objects.preset(&Preset::new(OUTPUT_MAPPING, number, value));
    }
    objects
}

/// Gives the device of these objects a name; without one it keeps that of the shipped data sheet.
#[must_use]
pub fn with_device_name(mut objects: ObjectDictionary, name: Option<String>) -> ObjectDictionary {
    let (index, sub_index) = DEVICE_NAME;
    if let (Some(name), Some(entry)) = (name, objects.get(index, sub_index)) {
        let mut entry = entry.clone();
        entry.set_default(name.into_bytes());
        objects.insert(entry);
    }
    objects
}

/// Returns the objects of a shipped data sheet.
pub(crate) fn shipped_objects(text: &str, node_id: u8) -> ObjectDictionary {
    dictionary(text, node_id).expect("a test reads each of them, and node-IDs are from 1 to 127")
}

/// Returns the object of a signal, or of several that share its bits: that of the shipped data sheet if the shipped database has the
/// first signal there, and otherwise a new one, which has their names.
fn entry_of(shipped: &ObjectDictionary, index: u16, signals: &[&Signal], bits: u8) -> Entry {
    let signal = signals[0];
    if let Some(entry) = shipped.get(index, 0).filter(|_| is_shipped(index, signal)) {
        return entry.clone();
    }
    let data_type = match (signal.coding.kind, bits) {
        (Kind::Float32 | Kind::Float64, _) => DataType::Real32,
        (Kind::Signed, 8) => DataType::Integer8,
        (Kind::Signed, 16) => DataType::Integer16,
        (Kind::Signed, _) => DataType::Integer32,
        (Kind::Unsigned, 8) => DataType::Unsigned8,
        (Kind::Unsigned, 16) => DataType::Unsigned16,
        (Kind::Unsigned, _) => DataType::Unsigned32,
    };
    let names = Vec::from_iter(signals.iter().map(|signal| signal.name.as_str()));
    let mut entry = published_entry(index, &names.join(", "), data_type);
    // A float has no counts, and signals that share an object have a range each.
    let has_limits = !data_type.is_real() && signal.coding.length_bits == bits;
    if let Some(range) = signal.coding.range.filter(|_| has_limits) {
        #[expect(clippy::cast_possible_truncation, reason = "the ends of 32 bits")]
        let counts = |end: f64| Some((end / signal.coding.factor).round() as i128);
        (entry.low_limit, entry.high_limit) = (counts(range.minimum), counts(range.maximum));
    }
    entry
}

/// Returns an object that a PDO of the node may carry.
fn published_entry(index: u16, name: &str, data_type: DataType) -> Entry {
    let start = vec![0; data_type.size_bytes().unwrap_or_default()];
    let mut entry = Entry::new(index, 0, name, data_type, Access::ReadOnly, start);
    entry.is_pdo_mappable = true;
    entry
}

/// Checks whether the shipped database has a signal of this name and kind in this object.
fn is_shipped(index: u16, signal: &Signal) -> bool {
    let messages = Database::shipped().messages().iter();
    let mut signals = messages.flat_map(|message| &message.signals);
    signals.any(|shipped| {
        let is_alike = shipped.name == signal.name && shipped.coding.kind == signal.coding.kind;
        is_alike && shipped.object == object_name(index)
    })
}

/// Returns the object of a signal as a database names it.
pub(crate) fn object_name(index: u16) -> String {
    format!("0x{index:04X}:00")
}
