//! Tests of the promises in data sheets: every object of every EDS that ships is accessed over SDO. The promises are
//! the keys of the file, and the values that its comments list.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::ops::RangeInclusive;
use std::time::Duration;

use can::{CanFrame, Node};
use canopen::object_dictionary::{Access, DataType, Entry};
use canopen::sdo_client::{SdoClient, SdoFailure};
use canopen::{AbortCode, ObjectDictionary, eds};
use plan::named_nodes::node_sheets;
use plan::{ControlLoop, Plan};
use plant_emulator::catalogue;
use scenario::node::Part;
use worlds::law_process::LawPlace;
use worlds::names::emulator_name;
use worlds::nodes::{controller_views, make_controller, plant_emulator};

use crate::rigs::rig;
use crate::support::{root, scenario};

const START: u8 = 1;
const RESET_NODE: u8 = 129;
/// Bit 31 of a COB-ID: the PDO is disabled.
const OUT_OF_USE: u32 = 1 << 31;
/// Object whose entries without an error cannot be read (CiA 301, 7.5.2.4).
const ERROR_FIELD: u16 = 0x1003;
const PDO_PARAMETERS: [RangeInclusive<u16>; 2] = [0x1400..=0x15FF, 0x1800..=0x19FF];
const PDO_MAPPINGS: [RangeInclusive<u16>; 2] = [0x1600..=0x17FF, 0x1A00..=0x1BFF];
/// Offset from a mapping to its parameters.
const MAPPING_OFFSET: u16 = 0x200;
/// Largest range that is tried completely; of larger ranges only the ends are tried.
const VALUES_MAX: i128 = 512;

/// A data sheet and the node that it describes.
struct Sheet {
    text: &'static str,
    node_id: u8,
    dictionary: ObjectDictionary,
}

impl Sheet {
    fn shipped() -> [Self; 3] {
        [
            (0x01, dbc::CONTROLLER_EDS),
            (0x10, dbc::DRIVE_EDS),
            (0x11, dbc::DISTURBANCE_EDS),
        ]
        .map(|(node_id, text)| Self {
            text,
            node_id,
            dictionary: eds::parse(text, node_id).unwrap(),
        })
    }

    fn entries(&self) -> &[Entry] {
        self.dictionary.entries()
    }

    /// Returns the node after power-on, in Pre-operational.
    fn node(&self) -> Bench {
        let text = fs::read_to_string(scenario("step.toml")).unwrap();
        let scenario = testing::part(&text, "drive");
        let node: Box<dyn Node> = match self.node_id {
            0x01 => {
                let view = scenario.controller_view();
                Box::new(controller::controller_node(&view).unwrap())
            }
            _ => Box::new(catalogue::emulator(&scenario).unwrap()),
        };
        Bench::new(node, self.node_id)
    }

    /// Returns the node in the NMT state in which its manager writes an object: communication is configured in
    /// Pre-operational, the application's objects are written in Operational.
    fn node_for(&self, entry: &Entry) -> Bench {
        let mut bench = self.node();
        if entry.index >= 0x2000 {
            bench.command(START);
        }
        bench
    }

    /// Returns the comment above a sub-object's section, or above its object's.
    fn comment(&self, entry: &Entry) -> String {
        let comments = comments(self.text);
        let (index, sub_index) = (entry.index, entry.sub_index);
        let sub_comment = comments.get(&format!("{index:04X}sub{sub_index:X}"));
        let object_comment = comments.get(&format!("{index:04X}"));
        // A comment on an ARRAY or RECORD does not describe the number of its entries.
        let is_count = sub_index == 0 && self.dictionary.find(index, 1).is_ok();
        let found = sub_comment.or(object_comment.filter(|_| !is_count));
        found.cloned().unwrap_or_default()
    }

    /// Returns the parameters of the first PDO of a kind, if the node has one.
    fn first_pdo(&self, parameters: &RangeInclusive<u16>) -> Option<u16> {
        let index = *parameters.start();
        self.dictionary.find(index, 1).is_ok().then_some(index)
    }
}

/// Returns the comments by the section that follows them.
fn comments(text: &str) -> BTreeMap<String, String> {
    let mut comments = BTreeMap::new();
    let mut comment = String::new();
    for line in text.lines() {
        if let Some(text) = line.strip_prefix(';') {
            comment += text;
        } else {
            let name = line
                .strip_prefix('[')
                .and_then(|name| name.strip_suffix(']'));
            if let Some(name) = name.filter(|_| !comment.is_empty()) {
                comments.insert(name.to_owned(), comment.trim().to_owned());
            }
            comment.clear();
        }
    }
    comments
}

/// A node alone with an SDO client.
struct Bench {
    node: Box<dyn Node>,
    node_id: u8,
}

impl Bench {
    /// Powers a node on, which stays in Pre-operational.
    fn new(mut node: Box<dyn Node>, node_id: u8) -> Self {
        node.on_tick(Duration::ZERO);
        while node.next_frame().is_some() {}
        Self { node, node_id }
    }

    fn command(&mut self, specifier: u8) {
        let frame = CanFrame::new(0, &[specifier, self.node_id]);
        self.node.on_frame(Duration::ZERO, &frame);
        while self.node.next_frame().is_some() {}
    }

    fn transfer(&mut self, mut client: SdoClient) -> Result<Vec<u8>, AbortCode> {
        for _ in 0..1000 {
            while let Some(request) = client.next_frame() {
                self.node.on_frame(Duration::ZERO, &request);
            }
            while let Some(answer) = self.node.next_frame() {
                client.on_frame(Duration::ZERO, &answer);
            }
            if let Some(result) = client.take_result() {
                return result.map_err(|error| match error.failure {
                    SdoFailure::Aborted(code) => code,
                    other => panic!("{other:?}"),
                });
            }
        }
        panic!("node {} does not answer", self.node_id);
    }

    fn read(&mut self, index: u16, sub_index: u8) -> Result<Vec<u8>, AbortCode> {
        let mut client = SdoClient::new(self.node_id);
        client
            .start_upload(Duration::ZERO, (index, sub_index))
            .unwrap();
        self.transfer(client)
    }

    fn write(&mut self, index: u16, sub_index: u8, bytes: &[u8]) -> Result<(), AbortCode> {
        let mut client = SdoClient::new(self.node_id);
        client
            .start_download(Duration::ZERO, (index, sub_index), bytes)
            .unwrap();
        self.transfer(client).map(drop)
    }

    /// Disables a PDO, and clears its mapping, as CiA 301 requires before they are changed.
    fn take_apart(&mut self, parameters: u16, with_mapping: bool) {
        let cob_id = self.read(parameters, 1).unwrap();
        let cob_id = u32::from_le_bytes(cob_id.try_into().unwrap()) | OUT_OF_USE;
        self.write(parameters, 1, &cob_id.to_le_bytes()).unwrap();
        if with_mapping {
            self.write(parameters + MAPPING_OFFSET, 0, &[0]).unwrap();
        }
    }

    /// Prepares the node for a write to an object.
    fn prepare(&mut self, entry: &Entry) {
        let is_in = |ranges: &[RangeInclusive<u16>; 2]| {
            ranges.iter().any(|range| range.contains(&entry.index))
        };
        if is_in(&PDO_PARAMETERS) && entry.sub_index != 1 {
            self.take_apart(entry.index, false);
        }
        if is_in(&PDO_MAPPINGS) {
            self.take_apart(entry.index - MAPPING_OFFSET, entry.sub_index != 0);
        }
    }
}

/// Values to write to an object, with the expected results.
#[derive(Debug, Default)]
struct Promises {
    accepted: BTreeSet<i128>,
    refused: BTreeMap<i128, Vec<AbortCode>>,
}

impl Promises {
    /// Returns the promises of a writable object with a numeric type.
    fn of(entry: &Entry, comment: &str) -> Self {
        let mut promises = Self::default();
        let default = integer(entry.data_type, &entry.default);
        let listed = listed_values(comment);
        promises.accepted.insert(default);
        promises.accepted.extend(&listed);
        let limits = [entry.low_limit, entry.high_limit].into_iter().flatten();
        promises.accepted.extend(limits);
        if let (Some(low), Some(high)) = (entry.low_limit, entry.high_limit)
            && high - low < VALUES_MAX
        {
            promises.accepted.extend(low..=high);
        }
        if let Some(low) = entry.low_limit {
            promises.refuse(entry, low - 1, &[AbortCode::VALUE_TOO_LOW]);
        }
        if let Some(high) = entry.high_limit {
            promises.refuse(entry, high + 1, &[AbortCode::VALUE_TOO_HIGH]);
        }
        let invalid = [AbortCode::INVALID_VALUE];
        if comment.contains("others are refused") {
            let others = (-128..=255).filter(|value| !listed.contains(value));
            others.for_each(|value| promises.refuse(entry, value, &invalid));
        }
        for value in refused_values(comment) {
            promises.refuse(entry, value, &invalid);
        }
        promises
    }

    fn refuse(&mut self, entry: &Entry, value: i128, codes: &[AbortCode]) {
        if bytes(entry.data_type, value).is_some() {
            self.accepted.remove(&value);
            self.refused.insert(value, codes.to_vec());
        }
    }
}

/// Returns the values that a comment lists, as "0: none, 2 to 4: some".
fn listed_values(comment: &str) -> BTreeSet<i128> {
    let mut values = BTreeSet::new();
    for item in comment.split(", ").flat_map(|item| item.split(['.', ';'])) {
        let Some((numbers, _)) = item.split_once(':') else {
            continue;
        };
        let ends: Result<Vec<i128>, _> = numbers
            .split(" to ")
            .map(|end| end.trim().parse())
            .collect();
        match ends.as_deref() {
            Ok([value]) => values.extend([*value]),
            Ok([first, last]) => values.extend(*first..=*last),
            _ => {}
        }
    }
    values
}

/// Returns the values that a comment excepts, as "1 is refused".
fn refused_values(comment: &str) -> Vec<i128> {
    let parts = comment.split(" is refused");
    let numbers = parts.map(|part| part.rsplit(' ').next()?.parse().ok());
    let excepted = comment.matches(" is refused").count();
    numbers.take(excepted).flatten().collect()
}

fn integer(data_type: DataType, bytes: &[u8]) -> i128 {
    data_type.rank(bytes)
}

/// Returns a value in a type, if it fits.
fn bytes(data_type: DataType, value: i128) -> Option<Vec<u8>> {
    let size = data_type.size_bytes()?;
    let bytes = value.to_le_bytes()[..size].to_vec();
    (integer(data_type, &bytes) == value).then_some(bytes)
}

fn at(sheet: &Sheet, entry: &Entry) -> String {
    let Entry {
        index,
        sub_index,
        name,
        ..
    } = entry;
    format!(
        "node {}: 0x{index:04X}:{sub_index:02X} {name}",
        sheet.node_id
    )
}

/// Runs a check on every object of every node, and reports all errors together.
fn for_every_object(check: impl Fn(&Sheet, &Entry) -> Result<(), String>) {
    let mut wrong = Vec::new();
    let mut count = 0;
    for sheet in &Sheet::shipped() {
        for entry in sheet.entries() {
            count += 1;
            if let Err(text) = check(sheet, entry) {
                wrong.push(format!("{}: {text}", at(sheet, entry)));
            }
        }
    }
    assert!(count >= 281, "only {count} objects were looked at");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn expect<T: PartialEq + std::fmt::Debug>(what: &str, found: T, expected: T) -> Result<(), String> {
    if found == expected {
        Ok(())
    } else {
        Err(format!("{what}: {found:02X?} instead of {expected:02X?}"))
    }
}

#[test]
fn every_object_holds_its_default_in_its_type_after_power_on() {
    for_every_object(|sheet, entry| {
        let found = sheet.node().read(entry.index, entry.sub_index);
        let expected = if !entry.access.is_readable() {
            Err(AbortCode::WRITE_ONLY)
        } else if entry.index == ERROR_FIELD && entry.sub_index > 0 {
            Err(AbortCode::NO_DATA)
        } else {
            Ok(entry.default.clone())
        };
        let is_within = entry.check(&entry.default).is_ok();
        expect("the default is within the limits", is_within, true)?;
        expect("read", found, expected)
    });
}

#[test]
fn what_is_not_promised_is_not_there() {
    for sheet in &Sheet::shipped() {
        let mut bench = sheet.node();
        let indices: BTreeSet<u16> = sheet.entries().iter().map(|entry| entry.index).collect();
        for index in 0x1000..=0xFFFF {
            let is_there = bench.read(index, 0) != Err(AbortCode::NO_SUCH_OBJECT);
            let is_promised = indices.contains(&index);
            assert_eq!(
                is_there, is_promised,
                "node {}: 0x{index:04X}",
                sheet.node_id
            );
        }
        for index in indices {
            for sub_index in 0..=u8::MAX {
                let is_there = bench.read(index, sub_index) != Err(AbortCode::NO_SUCH_SUB_INDEX);
                let is_promised = sheet.dictionary.find(index, sub_index).is_ok();
                let node_id = sheet.node_id;
                assert_eq!(
                    is_there, is_promised,
                    "node {node_id}: 0x{index:04X}:{sub_index:02X}"
                );
            }
        }
    }
}

#[test]
fn every_object_that_may_not_be_written_refuses() {
    for_every_object(|sheet, entry| {
        if entry.access.is_writable() {
            return Ok(());
        }
        let mut bench = sheet.node_for(entry);
        let written = bench.write(entry.index, entry.sub_index, &entry.default);
        expect("write", written, Err(AbortCode::READ_ONLY))
    });
}

#[test]
fn every_object_takes_the_values_that_are_promised_and_no_others() {
    for_every_object(|sheet, entry| {
        if !entry.access.is_writable() {
            return Ok(());
        }
        let promises = Promises::of(entry, &sheet.comment(entry));
        let mut bench = sheet.node_for(entry);
        bench.prepare(entry);
        let accepted = promises.accepted.iter().map(|value| (value, None));
        let refused = promises
            .refused
            .iter()
            .map(|(value, codes)| (value, Some(codes)));
        for (value, codes) in accepted.chain(refused) {
            let bytes = bytes(entry.data_type, *value).ok_or(format!("{value} has no room"))?;
            let written = bench.write(entry.index, entry.sub_index, &bytes);
            match (written, codes) {
                (Ok(()), None) if entry.access.is_readable() => {
                    let read = bench.read(entry.index, entry.sub_index);
                    expect(&format!("read after writing {value}"), read, Ok(bytes))?;
                }
                (Ok(()), None) => {}
                (Err(code), Some(codes)) if codes.contains(&code) => {}
                (written, _) => return Err(format!("write of {value}: {written:?}")),
            }
        }
        Ok(())
    });
}

#[test]
fn every_object_refuses_values_of_another_length() {
    for_every_object(|sheet, entry| {
        let Some(size) = entry
            .data_type
            .size_bytes()
            .filter(|_| entry.access.is_writable())
        else {
            return Ok(());
        };
        let mut bench = sheet.node_for(entry);
        let long = bench.write(entry.index, entry.sub_index, &vec![0; size + 1]);
        expect("a byte too many", long, Err(AbortCode::TOO_LONG))?;
        if size > 1 {
            let short = bench.write(entry.index, entry.sub_index, &vec![0; size - 1]);
            expect("a byte too few", short, Err(AbortCode::TOO_SHORT))?;
        }
        Ok(())
    });
}

#[test]
fn reset_node_restores_every_object() {
    for_every_object(|sheet, entry| {
        // The error field accepts only 0, and a controller that is reset by others records that as an error.
        if !entry.access.is_writable() || entry.index == ERROR_FIELD {
            return Ok(());
        }
        let promises = Promises::of(entry, &sheet.comment(entry));
        let default = integer(entry.data_type, &entry.default);
        let unlisted = [default ^ 1, default ^ i128::from(OUT_OF_USE), 0];
        let mut others = promises.accepted.iter().copied().chain(unlisted);
        let mut bench = sheet.node_for(entry);
        bench.prepare(entry);
        let changed = others.find(|value| {
            let bytes = bytes(entry.data_type, *value).filter(|_| *value != default);
            bytes.is_some_and(|bytes| {
                bench.write(entry.index, entry.sub_index, &bytes) == Ok(())
                    && bench.read(entry.index, entry.sub_index) == Ok(bytes)
            })
        });
        let is_unused_entry =
            default == 0 && PDO_MAPPINGS.iter().any(|all| all.contains(&entry.index));
        let has_one_value = entry.low_limit.is_some() && entry.low_limit == entry.high_limit;
        let has_others = !is_unused_entry && !has_one_value;
        expect("took another value", changed.is_some(), has_others)?;
        bench.command(RESET_NODE);
        let read = bench.read(entry.index, entry.sub_index);
        expect("read after reset node", read, Ok(entry.default.clone()))
    });
}

#[test]
fn every_object_is_mapped_where_its_data_sheet_says_so() {
    for_every_object(|sheet, entry| {
        let directions = [
            (
                &PDO_PARAMETERS[0],
                [Access::WriteOnly, Access::ReadWriteWrite],
            ),
            (
                &PDO_PARAMETERS[1],
                [Access::ReadOnly, Access::ReadWriteRead],
            ),
        ];
        for (parameters, accesses) in directions {
            let Some(parameters) = sheet.first_pdo(parameters) else {
                continue;
            };
            let is_for_it = accesses.contains(&entry.access)
                || entry.access == Access::ReadWrite
                || (entry.access == Access::Constant && parameters >= 0x1800);
            let expected = if entry.is_pdo_mappable && is_for_it {
                Ok(())
            } else {
                Err(AbortCode::NOT_MAPPABLE)
            };
            let bits = 8 * entry.data_type.size_bytes().unwrap_or(0);
            let mapped = u32::from(entry.index) << 16
                | u32::from(entry.sub_index) << 8
                | u32::try_from(bits).unwrap();
            let mut bench = sheet.node();
            bench.take_apart(parameters, true);
            let written = bench.write(parameters + MAPPING_OFFSET, 1, &mapped.to_le_bytes());
            expect(&format!("mapped at 0x{parameters:04X}"), written, expected)?;
        }
        Ok(())
    });
}

/// The parser of the lists in the comments works, so the tests of them are not empty.
#[test]
fn comments_list_values() {
    let listed = |comment: &str| Vec::from_iter(listed_values(comment));
    let none: [i128; 0] = [];
    assert_eq!(
        listed("0: none, 2 to 4: some. More; 7: all"),
        [0, 2, 3, 4, 7]
    );
    assert_eq!(
        listed("Bits 16 to 23: node-ID, bits 0 to 15: ms. Sub 1: mA."),
        none
    );
    assert_eq!(refused_values("1 is refused; writable only so"), [1]);
    assert_eq!(refused_values("Others. It is so"), none);
    let drive = &Sheet::shipped()[1];
    let of = |index, sub_index| {
        let handle = drive.dictionary.find(index, sub_index).unwrap();
        listed(&drive.comment(drive.dictionary.entry(handle)))
    };
    assert_eq!(of(0x6007, 0), [1, 2, 3]);
    assert_eq!(of(0x605A, 0), Vec::from_iter(0..=8));
    assert_eq!(of(0x605E, 0), [0, 1, 2, 3, 4]);
    assert_eq!(of(0x6060, 0), [0, 1, 3, 4, 8, 9, 10]);
    assert_eq!(of(0x1029, 1), [0, 1, 2]);
    assert_eq!(of(0x1029, 0), none);
}

/// The sheet of each node of a rig promises what the node has: the signals of its plants, the terms of its laws, its io outputs.
#[test]
fn the_nodes_of_a_rig_are_as_their_sheets_say() {
    // The loops of the two io nodes are in another order than these, and in an emulator each.
    let folder = tempfile::tempdir().unwrap();
    let fans = folder.path().join("fans.toml");
    fs::write(folder.path().join("rig.toml"), rig("two_fans")).unwrap();
    let idle = "schema = 1\nrig = \"rig.toml\"\nname = \"fans\"\nduration_seconds = 1.0\n[controller.all.open_loop]\n";
    fs::write(&fans, idle).unwrap();
    for scenario in [
        fans.to_str().unwrap(),
        "scenarios/step.toml",
        "docs/examples/lift.toml",
        "docs/examples/feed_and_press.toml",
        "tests/data/net/rigs/shop.toml",
        "tests/data/net/rigs/pair_and_axis.toml",
    ] {
        let plan = Plan::load(&root().join(scenario), worlds::catalogue::catalogue()).unwrap();
        let views = controller_views(&plan);
        for (node, text) in node_sheets(&plan) {
            let played: Box<dyn Node> = if node.part == Part::Controller {
                Box::new(make_controller(&views, &LawPlace::of(&plan)).unwrap())
            } else {
                let has_it = |one: &&ControlLoop| {
                    let has_plant = |plant: &str| one.trial.plants.contains_key(plant);
                    let mut io = one.trial.wiring.shared.io_on(has_plant);
                    one.nodes.drive.id == node.id || io.any(|io| io.node.id == node.id)
                };
                let name = emulator_name(plan.loops.iter().find(has_it).unwrap());
                plant_emulator(&plan, name).unwrap()
            };
            let mut bench = Bench::new(played, node.id);
            let promised = eds::parse(&text, node.id).unwrap();
            for entry in promised.entries() {
                let found = bench.read(entry.index, entry.sub_index);
                let at = format!("{scenario}, {}: {entry:?}", node.name);
                if entry.index == ERROR_FIELD && entry.sub_index > 0 {
                    continue;
                }
                let found = found.unwrap_or_else(|error| panic!("{error}: {at}"));
                assert_eq!(found.len(), entry.default.len(), "{at}");
                // A plant or a law decides on the first value.
                if entry.access != Access::ReadOnly || entry.index < 0x2000 {
                    assert_eq!(found, entry.default, "{at}");
                }
            }
            for index in (0x1800..0x1C00).chain(0x2100..0x2400) {
                let is_there = bench.read(index, 0) != Err(AbortCode::NO_SUCH_OBJECT);
                let is_promised = promised.get(index, 0).is_some();
                assert_eq!(
                    is_there, is_promised,
                    "{scenario}, {}: 0x{index:04X}",
                    node.name
                );
            }
        }
    }
}
