//! The EDS files of the rig.

use std::collections::{BTreeMap, BTreeSet};

use canopen::ObjectDictionary;
use canopen::object_dictionary::{Access, DataType, Entry};

use crate::database::Message;
use crate::node_objects::{DEVICE_NAME, shipped_objects};

/// The controller, node 0x01 (`controller.eds`).
pub const CONTROLLER_EDS: &str = include_str!("../controller.eds");
/// The drive, node 0x10, CiA 402 (`drive.eds`).
pub const DRIVE_EDS: &str = include_str!("../drive.eds");
/// The disturbance node 0x11, CiA 401 (`disturbance.eds`).
pub const DISTURBANCE_EDS: &str = include_str!("../disturbance.eds");

/// Lists of the objects of a sheet, in their order (CiA 306-1, clause 4.5).
const LISTS: [&str; 3] = ["MandatoryObjects", "OptionalObjects", "ManufacturerObjects"];
/// Parameters of RPDOs and of TPDOs, with the keys of their numbers.
const PDOS: [(std::ops::Range<u16>, &str); 2] =
    [(0x1400..0x1600, "NrOfRXPDO"), (0x1800..0x1A00, "NrOfTXPDO")];
/// First index behind the objects of CiA 301, and behind those of the manufacturer.
const MANUFACTURERS: u16 = 0x2000;
const PROFILES: u16 = 0x6000;

/// Returns the EDS of one node of a rig, with its name and number: `shipped` with these objects in place of its own. New objects
/// are described by the unit of their signals in `messages`.
///
/// # Panics
/// If the node-ID is not from 1 to 127.
pub fn sheet<'a>(
    shipped: &str,
    (name, node_id): (&str, u8),
    objects: &ObjectDictionary,
    messages: impl Iterator<Item = &'a Message>,
) -> String {
    let before = shipped_objects(shipped, node_id);
    let sections = shipped.split("\n\n").map(|text| (section_name(text), text));
    let writer = Writer {
        sections: sections.clone().collect(),
        shipped: &before,
        comments: comments(messages),
    };
    let mut text = String::with_capacity(shipped.len());
    let device_name =
        device_name(objects).filter(|name| Some(name) != device_name(&before).as_ref());
    let of_file = sections.take_while(|(name, _)| !LISTS.contains(name));
    for line in of_file.flat_map(|(_, section)| section.lines().chain([""])) {
        let number = PDOS.iter().find(|(_, key)| line.starts_with(key));
        let product = ["ProductName=", "OrderCode="];
        let product = product.into_iter().find(|key| line.starts_with(key));
        text += &match number {
            _ if line.starts_with("FileName=") => format!("FileName={name}.eds"),
            Some((range, key)) => format!(
                "{key}={}",
                indices(objects, |one| range.contains(&one)).len()
            ),
            None => match product.zip(device_name.as_ref()) {
                Some((key, name)) => format!("{key}{name}"),
                None => line.to_owned(),
            },
        };
        text.push('\n');
    }
    for list in LISTS {
        let listed = indices(objects, |index| list_of(index) == list);
        text += &format!("[{list}]\nSupportedObjects={}\n", listed.len());
        for (number, index) in (1..).zip(&listed) {
            text += &format!("{number}=0x{index:04X}\n");
        }
        text.push('\n');
        for index in listed {
            writer.write_object(objects, index, &mut text);
        }
    }
    // The standard's spelling (CiA 306-1, DCF).
    text + &format!("[DeviceComissioning]\nNodeID=0x{node_id:02X}\nNodeName={name}\n")
}

/// Returns the name of the device of these objects.
fn device_name(objects: &ObjectDictionary) -> Option<String> {
    let (index, sub_index) = DEVICE_NAME;
    let name = objects.get(index, sub_index)?.default.clone();
    String::from_utf8(name).ok()
}

/// Returns the indices of objects that fulfil a condition, in their order.
fn indices(objects: &ObjectDictionary, is_meant: impl Fn(u16) -> bool) -> BTreeSet<u16> {
    let indices = objects.entries().iter().map(|entry| entry.index);
    indices.filter(|index| is_meant(*index)).collect()
}

fn list_of(index: u16) -> &'static str {
    match index {
        0x1000 | 0x1001 | 0x1018 => LISTS[0],
        MANUFACTURERS..PROFILES => LISTS[2],
        _ => LISTS[1],
    }
}

/// Returns the name of the section in a text that may begin with comments.
fn section_name(text: &str) -> &str {
    let line = text.lines().find_map(|line| line.strip_prefix('['));
    line.unwrap_or_default().trim_end_matches(']')
}

fn name_of_section(index: u16, sub_index: u8, is_single: bool) -> String {
    if is_single {
        format!("{index:04X}")
    } else {
        format!("{index:04X}sub{sub_index:X}")
    }
}

/// Returns a comment on each object that one signal alone has: the unit of a count, and what the signal is.
fn comments<'a>(messages: impl Iterator<Item = &'a Message>) -> BTreeMap<&'a str, String> {
    let mut comments = BTreeMap::new();
    for signal in messages.flat_map(|message| &message.signals) {
        let count = match (signal.coding.factor, &*signal.unit) {
            (1.0, "") => String::new(),
            (1.0, unit) => format!("In {unit}. "),
            (factor, unit) => format!("In {factor} {unit}. "),
        };
        let comment = || format!("; {count}{}\n", signal.comment);
        let known = comments.entry(signal.object.as_str());
        known.and_modify(String::clear).or_insert_with(comment);
    }
    comments
}

/// Writes the sections of objects.
struct Writer<'a> {
    /// Sections of the shipped sheet by their names, with the comments above them.
    sections: BTreeMap<&'a str, &'a str>,
    /// Objects of the shipped sheet.
    shipped: &'a ObjectDictionary,
    /// Comments on new objects.
    comments: BTreeMap<&'a str, String>,
}

impl Writer<'_> {
    /// Returns the shipped object that describes an object: the same one, or for another PDO or SDO client one of those before it.
    fn like(&self, index: u16) -> u16 {
        let indices = self.shipped.entries().iter().map(|entry| entry.index);
        let before = indices.take_while(|shipped| *shipped <= index).last();
        before.filter(|_| index < MANUFACTURERS).unwrap_or(index)
    }

    fn write_object(&self, objects: &ObjectDictionary, index: u16, text: &mut String) {
        let entries = objects.entries().iter();
        let entries = Vec::from_iter(entries.filter(|entry| entry.index == index));
        let is_single = matches!(entries[..], [Entry { sub_index: 0, .. }]);
        if !is_single {
            let like = self.like(index);
            let section = self.sections.get(&*name_of_section(like, 0, true));
            for line in section.iter().flat_map(|section| section.lines()) {
                *text += &match line.split_once('=') {
                    Some(("SubNumber", _)) => format!("SubNumber={}", entries.len()),
                    Some(("ParameterName", _)) => renumbered(line, index - like),
                    _ if line.starts_with('[') => format!("[{index:04X}]"),
                    _ => line.to_owned(),
                };
                text.push('\n');
            }
            text.push('\n');
        }
        for entry in entries {
            let name = name_of_section(index, entry.sub_index, is_single);
            let known = self.sections.get(&*name);
            match known.filter(|_| self.shipped.get(index, entry.sub_index) == Some(entry)) {
                Some(section) => *text += section.trim_end(),
                None => *text += &self.section(entry, &name, is_single),
            }
            *text += "\n\n";
        }
    }

    /// Returns the section of an object that is not as the shipped one.
    fn section(&self, entry: &Entry, name: &str, is_single: bool) -> String {
        let Entry {
            index, sub_index, ..
        } = *entry;
        let like = self.like(index);
        let shipped = self.shipped.get(like, sub_index);
        let is_known = shipped.is_some_and(|shipped| shipped.name == entry.name);
        let known = self
            .sections
            .get(&*name_of_section(like, sub_index, is_single));
        let known = known.filter(|_| is_known);
        let object = format!("0x{index:04X}:{sub_index:02X}");
        let mut text = match known {
            Some(section) => section[..section.find('[').unwrap_or(0)].to_owned(),
            None => self.comments.get(&*object).cloned().unwrap_or_default(),
        };
        let (data_type, access) = (entry.data_type.number(), entry.access.word());
        text += &format!("[{name}]\nParameterName={}\nObjectType=0x7\n", entry.name);
        text += &format!("DataType=0x{data_type:04X}\nAccessType={access}\n");
        for (key, limit) in [("Low", entry.low_limit), ("High", entry.high_limit)] {
            text += &limit.map_or_else(String::new, |limit| format!("{key}Limit={limit}\n"));
        }
        // A node publishes the first value of a plant or a law, which no sheet knows.
        if is_known || entry.access != Access::ReadOnly {
            let value = entry.decode_integer(&entry.default);
            let is_text = entry.data_type == DataType::VisibleString;
            let notation = known.and_then(|section| section.split_once("DefaultValue="));
            let is_hexadecimal = match notation {
                Some((_, notation)) => notation.starts_with("0x") || notation.starts_with('$'),
                None => entry.data_type == DataType::Unsigned32,
            };
            let digits = 2 * entry.data_type.size_bytes().unwrap_or_default();
            text += &if is_text {
                format!("DefaultValue={}\n", String::from_utf8_lossy(&entry.default))
            } else if is_hexadecimal {
                format!("DefaultValue=0x{value:0digits$X}\n")
            } else {
                format!("DefaultValue={value}\n")
            };
        }
        text + &format!("PDOMapping={}", u8::from(entry.is_pdo_mappable))
    }
}

/// Returns a name that ends with a number, or has one, with a number that is larger by so much.
fn renumbered(name: &str, by: u16) -> String {
    let digits = |letter: char| letter.is_ascii_digit();
    let (Some(first), Some(last)) = (name.find(digits), name.rfind(digits)) else {
        return name.to_owned();
    };
    let number = name[first..=last].parse().unwrap_or(0) + by;
    format!("{}{number}{}", &name[..first], &name[last + 1..])
}

#[cfg(test)]
mod tests {
    use canopen::eds;
    use canopen::object_dictionary::Preset;

    use super::*;
    use crate::Composer;
    use crate::coding::{Coding, Kind, Range};
    use crate::database::{Database, Signal};
    use crate::names::{ADDED_LOAD, CONVECTION_FACTOR};
    use crate::node_objects::{self, PlantSignals};

    /// Returns the sheet of a node on a bus, whose objects it has.
    fn checked(
        shipped: &str,
        of: (&str, u8),
        objects: &ObjectDictionary,
        bus: &Database,
    ) -> String {
        let text = sheet(shipped, of, objects, bus.messages().iter());
        let read = eds::parse(&text, of.1).unwrap();
        assert_eq!(&read, objects, "{text}");
        text
    }

    fn signal(name: &str, kind: Kind, factor: f64) -> Signal {
        let range = Some(Range {
            minimum: 0.0,
            maximum: 30.0,
        });
        let coding = Coding::little_endian(0, 16, kind, factor, range);
        Signal::new(name.to_owned(), "N", "How it pulls.", coding)
    }

    #[test]
    fn the_sheets_of_the_shipped_rig_are_the_shipped_ones() {
        let shipped = Database::shipped();
        let terms = shipped.term_messages("controller", "");
        let terms = terms.flat_map(|message| message.signals.clone());
        let loops = [(terms.collect(), [0x181, 0x281, 0x381, 0x481])];
        let outputs = [(0, CONVECTION_FACTOR, 1000), (1, ADDED_LOAD, 0)];
        for (text, of, objects) in [
            (
                CONTROLLER_EDS,
                ("controller", 1),
                node_objects::controller(1, &loops, &[0x10], &[0x11]),
            ),
            (
                DRIVE_EDS,
                ("drive", 0x10),
                node_objects::drive(0x10, PlantSignals::of(shipped, "drive"), []),
            ),
            (
                DISTURBANCE_EDS,
                ("disturbance", 0x11),
                node_objects::io(0x11, outputs.into_iter(), 1),
            ),
        ] {
            let written = checked(text, of, &objects, shipped);
            let (written, number) = written.rsplit_once("\n\n").unwrap();
            for (written, text) in written.lines().zip(text.lines()) {
                assert_eq!(written, text);
            }
            assert_eq!(written.lines().count(), text.lines().count());
            let (name, id) = of;
            let expected = format!("[DeviceComissioning]\nNodeID=0x{id:02X}\nNodeName={name}\n");
            assert_eq!(number, expected);
        }
    }

    #[test]
    fn a_drive_has_the_signals_of_its_plant_and_the_values_of_its_rig() {
        let signals = ["a", "b", "c"].map(|name| signal(name, Kind::Unsigned, 0.01));
        let bus = Composer::new("controller", 1).with_drive(("y", 0x12), Some(&signals));
        let bus = bus.finish();
        let target = Preset {
            limits: Some([-2000, 2000]),
            ..Preset::new(0x6071, 0, 0)
        };
        let presets = [
            Preset::new(0x1801, 2, 5),
            Preset::new(0x60A8, 0, 0xFD41_0000),
        ];
        let objects = node_objects::drive(
            0x12,
            PlantSignals::of(&bus, "y"),
            presets.into_iter().chain([target]),
        );
        let text = checked(DRIVE_EDS, ("y", 0x12), &objects, &bus);
        for part in [
            "\nFileName=y.eds\n",
            "\nNodeID=0x12\n",
            "\nNrOfTXPDO=3\n",
            "\n[ManufacturerObjects]\nSupportedObjects=6\n1=0x2101\n2=0x2102\n3=0x2103\n4=0x2104\n",
            "\n; In 0.01 N. How it pulls.\n[2101]\nParameterName=a\nObjectType=0x7\nDataType=0x0006\nAccessType=ro\nLowLimit=0\nHighLimit=3000\nPDOMapping=1\n",
            "\n[1802]\nParameterName=TPDO3 communication parameter\n",
            "\n[1A02sub1]\nParameterName=Application object 1\nObjectType=0x7\nDataType=0x0007\nAccessType=rw\nDefaultValue=0x21040010\n",
            "\n[1802sub1]\nParameterName=COB-ID used by TPDO\nObjectType=0x7\nDataType=0x0007\nAccessType=rw\nDefaultValue=0x40000392\n",
            "\nLowLimit=-2000\nHighLimit=2000\nDefaultValue=0\n",
            "\nDefaultValue=0xFD410000\n",
        ] {
            assert!(text.contains(part), "{part}\n{text}");
        }
        let alone = Composer::new("controller", 1).with_drive(("y", 0x12), Some(&signals[..1]));
        let objects = node_objects::drive(0x12, PlantSignals::of(&alone.finish(), "y"), []);
        let reserved = objects.get(0x2102, 0).map(|entry| entry.name.as_str());
        assert_eq!(
            (reserved, objects.unsigned(0x1802, 1)),
            (Some("reserved"), None)
        );
    }

    #[test]
    fn a_controller_has_the_terms_of_each_loop_and_a_client_for_each_node() {
        let flags = ["x", "y"].map(|name| {
            let coding = Coding::little_endian(0, 1, Kind::Unsigned, 1.0, None);
            Signal::new(name.to_owned(), "", "", coding)
        });
        let loops = [[0x181, 0x281, 0x381, 0x481], [0x1A1, 0x2A1, 0x3A1, 0x4A1]];
        let loops = loops.map(|identifiers| {
            let mut terms = vec![signal("force", Kind::Signed, 0.5)];
            terms.extend(flags.clone());
            (terms, identifiers)
        });
        let mut composer = Composer::new("hand", 1);
        for (place, (terms, identifiers)) in (0..).zip(&loops) {
            let name = ["left", "right"][usize::from(place)];
            composer = composer.with_terms((place, name), *identifiers, terms);
        }
        let bus = composer.finish();
        let objects = node_objects::controller(1, &loops, &[0x12, 0x14], &[0x1F]);
        let text = checked(CONTROLLER_EDS, ("hand", 1), &objects, &bus);
        for part in [
            "\n[ManufacturerObjects]\nSupportedObjects=4\n1=0x2200\n2=0x2201\n3=0x2240\n4=0x2241\n",
            "\n; In 0.5 N. How it pulls.\n[2240]\nParameterName=force\n",
            "\n[2241]\nParameterName=x, y\nObjectType=0x7\nDataType=0x0005\nAccessType=ro\nPDOMapping=1\n",
            "\n[1804]\nParameterName=TPDO5 communication parameter\n",
            "\n[1282]\nParameterName=SDO client parameter 3\n",
            "\nNrOfTXPDO=2\n",
        ] {
            assert!(text.contains(part), "{part}\n{text}");
        }
        let unsigned = |index, sub_index| objects.unsigned(index, sub_index).unwrap();
        assert_eq!(
            [1, 2, 3].map(|sub| unsigned(0x1282, sub)),
            [0x61F, 0x59F, 0x1F]
        );
        assert_eq!(
            [0, 1, 2].map(|sub| unsigned(0x1A04, sub)),
            [2, 0x2240_0010, 0x2241_0008]
        );
        assert_eq!(
            [0, 1, 2, 3].map(|sub| unsigned(0x1016, sub)),
            [3, 0x12_0000, 0x1F_0064, 0x14_0000]
        );
        let object = &bus.definition("hand_right_tpdo1.force").unwrap().object;
        assert_eq!(object, "0x2240:00");
    }

    #[test]
    fn a_drive_can_have_the_node_id_that_the_module_of_the_shipped_rig_has() {
        let watched = |io_nodes: &[u8]| {
            let loops = [(Vec::new(), [0; 4]), (Vec::new(), [0; 4])];
            let objects = node_objects::controller(1, &loops, &[0x11, 0x13], io_nodes);
            [2, 4].map(|entry| objects.unsigned(0x1016, entry))
        };
        assert_eq!(watched(&[]), [Some(0), None]);
        assert_eq!(watched(&[0x11]), [Some(0x0011_0064), None]);
        assert_eq!(watched(&[0x12]), [Some(0x0012_0064), None]);
        assert_eq!(
            watched(&[0x12, 0x15]),
            [Some(0x0012_0064), Some(0x0015_0064)]
        );
    }

    #[test]
    fn an_io_node_has_the_outputs_that_the_rig_wires() {
        let shipped = Database::shipped();
        let with = |outputs: &[_]| {
            let objects = node_objects::io(0x13, outputs.iter().copied(), 1);
            let text = checked(DISTURBANCE_EDS, ("valves", 0x13), &objects, shipped);
            (objects, text)
        };
        let (beside, _) = with(&[
            (0, CONVECTION_FACTOR, 1000),
            (1, ADDED_LOAD, 0),
            (2, "valve_percent", 500),
            (3, "tilt_degrees", -3),
        ]);
        let values = |index: u16| [1, 2, 3, 4].map(|sub| beside.integer(index, sub).unwrap());
        assert_eq!(beside.unsigned(0x6411, 0), Some(4));
        assert_eq!(values(0x6411), [1000, 0, 500, -3]);
        assert_eq!(values(0x6444), [1000, 0, 500, -3]);
        assert_eq!(values(0x6443), [1; 4]);
        assert_eq!(beside.unsigned(0x1600, 0), Some(4));
        assert_eq!(beside.unsigned(0x1600, 3), Some(0x6411_0310));

        let (alone, text) = with(&[(0, "valve_percent", 7)]);
        assert_eq!(alone.get(0x6411, 1).unwrap().name, "valve_percent");
        assert_eq!(alone.integer(0x6411, 1), Some(7));
        assert_eq!(alone.unsigned(0x1600, 0), Some(1));
        assert!(alone.find(0x6411, 2).is_err());
        assert!(!text.contains("fan"), "{text}");
    }
}
