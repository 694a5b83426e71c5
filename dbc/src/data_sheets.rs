//! The EDS files of the rig.

use std::ops::RangeInclusive;

use canopen::object_dictionary::Preset;

use crate::names::{ADDED_LOAD, CONVECTION_FACTOR};

/// The controller, node 0x01 (`controller.eds`).
pub const CONTROLLER_EDS: &str = include_str!("../controller.eds");
/// The drive, node 0x10, CiA 402 (`drive.eds`).
pub const DRIVE_EDS: &str = include_str!("../drive.eds");
/// The disturbance node 0x11, CiA 401 (`disturbance.eds`).
pub const DISTURBANCE_EDS: &str = include_str!("../disturbance.eds");

/// Data type of a float of 32 bits (CiA 301, 7.4.7.1).
const REAL32: &str = "0x0008";
/// Text of the shipped data sheet on the unit of positions.
const MICROMETRES: &str = "Positions count micrometres (0x60A8).";

/// Time in milliseconds after which an io node reacts to the silence of its manager (0x1016).
const IO_WATCH_MILLISECONDS: i64 = 0xFA;

/// Returns the entry by which an io node watches the heartbeat of its manager.
pub fn io_watch(manager: u8) -> Preset {
    Preset::new(0x1016, 1, i64::from(manager) << 16 | IO_WATCH_MILLISECONDS)
}

/// Sections of the controller's first and second SDO client, and the indices of all possible ones.
const FIRST_CLIENT: &str = "[1280]\n";
const SECOND_CLIENT: &str = "[1281]\n";
const CLIENTS: RangeInclusive<u16> = 0x1280..=0x12FF;
/// Section in which a data sheet lists its objects.
const OPTIONAL_OBJECTS: &str = "[OptionalObjects]\n";

/// Returns the controller's EDS for a rig: with an SDO client for each of these nodes, to which it talks.
///
/// # Panics
/// Never: a test checks the texts that are compiled in.
pub fn controller_sheet(servers: &[u8]) -> String {
    let (before, clients) = CONTROLLER_EDS
        .split_once(FIRST_CLIENT)
        .expect("it has an SDO client");
    let (first, clients) = clients
        .split_once(SECOND_CLIENT)
        .expect("it has a second one");
    // The second client's section is as long as the first's.
    let second: usize = clients
        .split_inclusive('\n')
        .take(first.lines().count())
        .map(str::len)
        .sum();
    let mut text = with_clients_listed(before, servers.len());
    for (number, server) in (1..).zip(servers) {
        let index = CLIENTS.start() + number - 1;
        let (request, answer) = (0x600 + u32::from(*server), 0x580 + u32::from(*server));
        text += &format!("[{index:04X}]\n");
        text += &first
            .replace("[1280", &format!("[{index:04X}"))
            .replace("parameter 1", &format!("parameter {number}"))
            .replace("0x00000610", &format!("0x{request:08X}"))
            .replace("0x00000590", &format!("0x{answer:08X}"))
            .replace("DefaultValue=0x10", &format!("DefaultValue=0x{server:02X}"));
    }
    text + &clients[second..]
}

/// Returns the beginning of the controller's EDS with this number of SDO clients in the list of its objects.
fn with_clients_listed(text: &str, count: usize) -> String {
    let (before, listed) = text
        .split_once(OPTIONAL_OBJECTS)
        .expect("it lists its objects");
    let (listed, behind) = listed.split_once("\n\n").expect("a list ends");
    let indices = listed.lines().filter_map(|line| {
        let (_, index) = line.split_once("=0x")?;
        u16::from_str_radix(index, 16).ok()
    });
    let others = indices.filter(|index| !CLIENTS.contains(index));
    let mut all = Vec::from_iter(others.chain(CLIENTS.take(count)));
    all.sort_unstable();
    let lines = (1..)
        .zip(&all)
        .map(|(number, index): (usize, _)| format!("{number}=0x{index:04X}\n"));
    let lines = String::from_iter(lines);
    let count = all.len();
    format!("{before}{OPTIONAL_OBJECTS}SupportedObjects={count}\n{lines}\n{behind}")
}

/// Returns an EDS for one node of a rig, with the node's name and number, with the values of `presets`, and with the word of the unit
/// of a drive's positions, if it is not the millimetre.
pub fn node_sheet(
    eds: &str,
    (name, node_id): (&str, u8),
    presets: &[Preset],
    unit: Option<&str>,
) -> String {
    let mut preset = None;
    let mut sheet = String::with_capacity(eds.len());
    for line in eds.lines() {
        if line.starts_with('[') {
            preset = presets.iter().find(|preset| section(preset) == line);
        }
        match (preset.and_then(|preset| preset_line(preset, line)), unit) {
            (Some(line), _) => sheet += &line,
            (None, Some(unit)) if line.ends_with(MICROMETRES) => {
                let text = format!("Positions are in {unit} as 0x60A8 says.");
                sheet += &line.replace(MICROMETRES, &text);
            }
            _ if line.starts_with("FileName=") => sheet += &format!("FileName={name}.eds"),
            _ => sheet += line,
        }
        sheet.push('\n');
    }
    // The standard's spelling (CiA 306-1, DCF).
    sheet + &format!("\n[DeviceComissioning]\nNodeID=0x{node_id:02X}\nNodeName={name}\n")
}

fn section(preset: &Preset) -> String {
    let Preset {
        index, sub_index, ..
    } = preset;
    match sub_index {
        0 => format!("[{index:04X}]"),
        sub_index => format!("[{index:04X}sub{sub_index:X}]"),
    }
}

/// Returns a line of an object's section with the value of its preset, in the notation of the line; `None` if the preset does not
/// change it.
fn preset_line(preset: &Preset, line: &str) -> Option<String> {
    let (key, written) = line.split_once('=')?;
    if key == "DataType" && preset.is_real32 {
        return Some(format!("{key}={REAL32}"));
    }
    let value = match (key, preset.limits) {
        ("DefaultValue", _) => preset.value,
        ("LowLimit", Some([low, _])) => low,
        ("HighLimit", Some([_, high])) => high,
        _ => return None,
    };
    Some(match written.strip_prefix("0x") {
        Some(digits) => format!("{key}=0x{value:0width$X}", width = digits.len()),
        None => format!("{key}={value}"),
    })
}

/// Objects "write analogue output 16-bit", error mode and error value (CiA 401), each with the data type and the access of its
/// entries.
const OUTPUT_OBJECTS: [(&str, &str, &str); 3] = [
    ("6411", "0x0003", "rww"),
    ("6443", "0x0005", "rw"),
    ("6444", "0x0004", "rw"),
];
/// Section before which new sections are inserted.
const MANUFACTURER_OBJECTS: &str = "[ManufacturerObjects]";

/// Returns the EDS of an io node (CiA 401) with these analogue outputs, each with its place from 0, its name, and its value at the
/// start and after an error, in steps. The sheet has the fan and the load as they are, before all others.
pub fn with_outputs<'a>(eds: &str, outputs: impl Iterator<Item = (usize, &'a str, i16)>) -> String {
    let is_other = |(_, name, _): &(_, &str, _)| ![CONVECTION_FACTOR, ADDED_LOAD].contains(name);
    let outputs = Vec::from_iter(outputs.filter(is_other));
    let (Some((first, ..)), Some((last, ..))) = (outputs.first(), outputs.last()) else {
        return eds.to_owned();
    };
    let count = last + 1;
    let is_replaced = |section: &str| {
        OUTPUT_OBJECTS.iter().any(|(object, ..)| {
            let number = section
                .strip_prefix(object)
                .and_then(|rest| rest.strip_prefix("sub")?.parse().ok());
            number.is_some_and(|number: usize| number > *first)
        })
    };
    let mut section = String::new();
    let mut text = String::with_capacity(eds.len());
    for line in eds.lines() {
        if let Some(name) = line.strip_prefix('[') {
            name.trim_end_matches(']').clone_into(&mut section);
            if line == MANUFACTURER_OBJECTS {
                outputs.iter().for_each(|output| text += &entries(*output));
            }
        }
        // Comments on fan and load, and sections that are written again.
        let is_stale = line.starts_with("; Sub 1:")
            || line.starts_with("; 0: keep")
            || line.starts_with("; In the units");
        if is_stale || is_replaced(&section) {
            continue;
        }
        text += &adapted_line(&section, line, count);
        text.push('\n');
    }
    text
}

/// Returns a line of the shipped EDS for this number of outputs.
fn adapted_line(section: &str, line: &str, count: usize) -> String {
    let is_default = line.starts_with("DefaultValue=");
    let mut objects = OUTPUT_OBJECTS.iter().map(|(object, ..)| *object);
    if objects.clone().any(|object| section == object) && line.starts_with("SubNumber=") {
        return format!("SubNumber={}", count + 1);
    }
    let counts = section == "1600sub0" || objects.any(|object| section == format!("{object}sub0"));
    if counts && is_default {
        return format!("DefaultValue={count}");
    }
    let mapped = section
        .strip_prefix("1600sub")
        .and_then(|rest| rest.parse().ok())
        .filter(|number| (1..=count).contains(number));
    match (section, mapped) {
        (_, Some(number)) if is_default => format!("DefaultValue=0x6411{number:02X}10"),
        ("Comments", _) if line.starts_with("Line1=") => {
            format!("Line1={count} analogue outputs, which the rig file wires to a plant.")
        }
        ("Comments", _) if line.starts_with("Line2=") => {
            "Line2=When the manager's heartbeat is lost or NMT stops the node, the outputs return to rest (0x6443, 0x6444).".to_owned()
        }
        _ => line.to_owned(),
    }
}

/// Returns the entries of an output.
fn entries((place, name, at_rest): (usize, &str, i16)) -> String {
    let entries = OUTPUT_OBJECTS.iter().map(|(object, data_type, access)| {
        let (limits, default) = match *object {
            "6443" => ("LowLimit=0\nHighLimit=1\n", 1),
            _ => ("", at_rest),
        };
        let mapping = u8::from(*object == "6411");
        format!(
            "[{object}sub{:X}]\nParameterName={name}\nObjectType=0x7\nDataType={data_type}\nAccessType={access}\n{limits}DefaultValue={default}\nPDOMapping={mapping}\n\n",
            place + 1
        )
    });
    entries.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use canopen::eds;

    #[test]
    fn the_controller_has_a_client_for_each_node_of_its_rig() {
        assert_eq!(controller_sheet(&[0x10, 0x11]), CONTROLLER_EDS);
        let clients = |servers: &[u8]| {
            let text = controller_sheet(servers);
            let dictionary = eds::parse(&text, 1).unwrap();
            let value = |index, sub_index| dictionary.unsigned(index, sub_index);
            let found = CLIENTS.map_while(|index| {
                Some([1, 2, 3].map(|sub_index| value(index, sub_index)))
                    .filter(|client| client[0].is_some())
            });
            (Vec::from_iter(found), text)
        };
        let (found, text) = clients(&[0x12, 0x14, 0x1F]);
        let expected = [0x12, 0x14, 0x1F].map(|id| [0x600 + id, 0x580 + id, id].map(Some));
        assert_eq!(found, expected);
        assert!(text.contains("SupportedObjects=26\n") && text.contains("\n17=0x1282\n"));
        assert_eq!(clients(&[0x10]).0.len(), 1);
    }

    #[test]
    fn an_io_node_has_the_outputs_that_the_rig_wires() {
        let with_outputs = |outputs: &[_]| with_outputs(DISTURBANCE_EDS, outputs.iter().copied());
        assert_eq!(with_outputs(&[]), DISTURBANCE_EDS);
        let text = with_outputs(&[
            (0, CONVECTION_FACTOR, 1000),
            (1, ADDED_LOAD, 0),
            (2, "valve_percent", 500),
            (3, "tilt_degrees", -3),
        ]);
        let beside = eds::parse(&text, 0x11).unwrap();
        let values = |index: u16| {
            [1, 2, 3, 4].map(|sub_index| {
                let handle = beside.find(index, sub_index).unwrap();
                beside.entry(handle).as_integer()
            })
        };
        assert_eq!(beside.unsigned(0x6411, 0), Some(4));
        assert_eq!(values(0x6411), [1000, 0, 500, -3]);
        assert_eq!(values(0x6444), [1000, 0, 500, -3]);
        assert_eq!(values(0x6443), [1; 4]);
        assert_eq!(beside.unsigned(0x1600, 0), Some(4));
        assert_eq!(beside.unsigned(0x1600, 3), Some(0x6411_0310));

        let text = with_outputs(&[(0, "valve_percent", 7)]);
        let alone = eds::parse(&text, 0x11).unwrap();
        let handle = alone.find(0x6411, 1).unwrap();
        assert_eq!(alone.entry(handle).name, "valve_percent");
        assert_eq!(alone.entry(handle).as_integer(), 7);
        assert_eq!(alone.unsigned(0x1600, 0), Some(1));
        assert!(alone.find(0x6411, 2).is_err());
        assert!(!text.contains("fan"), "{text}");
    }
}
