//! Electronic data sheets (CiA 306-1): from EDS or DCF text to the object dictionary of one node.

use std::collections::BTreeMap;
use std::fmt;

use crate::object_dictionary::{Access, DataType, Entry, ObjectDictionary};

mod ini;
mod value;

use ini::{Item, Section, Sections};
pub use value::octets;

/// Longest text that is read.
pub const MAX_TEXT_BYTES: usize = 4 << 20;

/// Most sub-objects that a dictionary may have; compact sub-objects let a short text ask for millions.
pub const MAX_ENTRIES: usize = 32_768;

/// Error of an EDS: its line, section, key and value as far as it has them, and the reason.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct EdsError(String);

impl EdsError {
    /// Makes an error about a line, from 1.
    fn at_line(line: usize, reason: impl fmt::Display) -> Self {
        Self(format!("line {line}: {reason}"))
    }
}

/// Reads the objects in the text of an EDS or DCF for the node `node_id`; they hold their defaults.
///
/// A trailing comment starts with a semicolon after a blank. Numbers may be decimal, hexadecimal (`0x`), octal (leading
/// 0) and contain `$NODEID`. A number without default is 0. `ParameterValue` (DCF) takes the place of `DefaultValue`.
/// Sections that describe no value are passed over. Bought devices' data sheets are rarely free of errors, so some do
/// no harm: lists of objects (`[OptionalObjects]`), which are not read, an ARRAY or RECORD without sub-objects, a data type that
/// is no basic one of CiA 301 (read as DOMAIN), and a default of an OCTET_STRING or DOMAIN that is no hexadecimal bytes
/// (read as empty).
///
/// # Errors
/// The first thing that is wrong, with its line.
pub fn parse(text: &str, node_id: u8) -> Result<ObjectDictionary, EdsError> {
    if !(1..=127).contains(&node_id) {
        let reason = format!("node-ID {node_id} is outside 1 to 127");
        return Err(EdsError(reason));
    }
    if text.len() > MAX_TEXT_BYTES {
        let reason = format!("the text has {} bytes (limit {MAX_TEXT_BYTES})", text.len());
        return Err(EdsError(reason));
    }
    let sections = ini::read(text)?;
    check_compact_pdos(&sections, node_id)?;
    let mut reader = Reader {
        node_id,
        sections: &sections,
        dictionary: ObjectDictionary::new(),
    };
    for (name, section) in &sections {
        let Some((index, part)) = index_and_part(name) else {
            continue;
        };
        let is_part = matches!(part, "name" | "value") || part.starts_with("sub");
        if part.is_empty() {
            reader.object(index, section)?;
        } else if is_part && !sections.contains_key(&format!("{index:04x}")) {
            return Err(section.error(format!("there is no section [{index:04X}]")));
        }
    }
    Ok(reader.dictionary)
}

/// Splits the name of a section that describes an object: `1018`, `1018sub1`, `1018name` or `1018value`.
fn index_and_part(name: &str) -> Option<(u16, &str)> {
    let (index, part) = name.split_at_checked(4)?;
    let is_index = index.bytes().all(|letter| letter.is_ascii_hexdigit());
    let index = u16::from_str_radix(index, 16).ok().filter(|_| is_index)?;
    Some((index, part))
}

/// Sub-objects that are described one by one.
type Subs<'s, 't> = BTreeMap<u8, &'s Section<'t>>;

/// Collects sub-objects.
struct Reader<'s, 't> {
    node_id: u8,
    sections: &'s Sections<'t>,
    dictionary: ObjectDictionary,
}

impl<'s, 't> Reader<'s, 't> {
    /// Returns the sections `[1018sub1]` of an object.
    fn subs(&self, index: u16) -> Result<Subs<'s, 't>, EdsError> {
        let prefix = format!("{index:04x}sub");
        let mut subs = Subs::new();
        for (name, section) in self.sections.range(prefix.clone()..) {
            let Some(digits) = name.strip_prefix(&prefix) else {
                break;
            };
            let sub_index = u8::from_str_radix(digits, 16)
                .ok()
                .filter(|_| !digits.starts_with('+'))
                .ok_or_else(|| section.error(format!("\"{digits}\" is not a sub-index")))?;
            if let Some(other) = subs.insert(sub_index, section) {
                let first = section.line.min(other.line);
                let second = if section.line > first { section } else { other };
                let reason = format!("the sub-object stands in line {first} already");
                return Err(second.error(reason));
            }
        }
        Ok(subs)
    }

    /// Reads one object by its object type (CiA 301, table 42).
    fn object(&mut self, index: u16, main: &Section<'_>) -> Result<(), EdsError> {
        let subs = self.subs(index)?;
        match integer_at(main, "objecttype", self.node_id, u8::MAX)?.unwrap_or(7) {
            // NULL, DEFTYPE and DEFSTRUCT hold no value.
            0 | 5 | 6 => Ok(()),
            2 | 7 => match subs.values().next() {
                None => self.described(index, 0, main),
                Some(sub) => Err(sub.error(format!("[{}] is neither ARRAY nor RECORD", main.name))),
            },
            8 | 9 => {
                self.compact_sub_objects(index, main)?;
                let mut subs = subs.into_iter();
                subs.try_for_each(|(sub_index, section)| self.described(index, sub_index, section))
            }
            other => Err(main.error(format!("object type {other} is unknown"))),
        }
    }

    /// Keeps the value that a section describes.
    fn described(
        &mut self,
        index: u16,
        sub_index: u8,
        section: &Section<'_>,
    ) -> Result<(), EdsError> {
        let entry = self.entry(index, sub_index, section)?;
        self.add(entry, section)
    }

    /// Expands `CompactSubObj` (CiA 306-1, clause 4.6.3.4): sub-index 0 and that number of equal sub-objects, whose place those
    /// that are described one by one then take.
    fn compact_sub_objects(&mut self, index: u16, main: &Section<'_>) -> Result<(), EdsError> {
        let count = integer_at(main, "compactsubobj", self.node_id, 254_u8)?.unwrap_or(0);
        if count == 0 {
            return Ok(());
        }
        let mut number_of_entries = Entry::new(
            index,
            0,
            "NrOfObjects",
            DataType::Unsigned8,
            Access::ReadOnly,
            vec![count],
        );
        number_of_entries.high_limit = Some(254);
        self.add(number_of_entries, main)?;
        let template = self.entry(index, 1, main)?;
        let sections = self.sections;
        let [names, values] =
            ["name", "value"].map(|part| sections.get(&format!("{index:04x}{part}")));
        for sub_index in 1..=count {
            let key = sub_index.to_string();
            let mut entry = template.clone();
            entry.sub_index = sub_index;
            entry.name = match names.and_then(|names| names.get(&key)) {
                Some(item) => item.value.to_owned(),
                None => format!("{}{sub_index}", template.name),
            };
            if let Some(item) = values.and_then(|values| values.get(&key)) {
                entry.set_default(self.default(template.data_type, item)?);
            }
            self.add(entry, main)?;
        }
        Ok(())
    }

    /// Reads the section of one value.
    fn entry(&self, index: u16, sub_index: u8, section: &Section<'_>) -> Result<Entry, EdsError> {
        let is_domain = integer_at(section, "objecttype", self.node_id, u8::MAX)? == Some(2);
        let data_type = match section.get("datatype") {
            None if is_domain => DataType::Domain,
            None => return Err(section.error("the key DataType is missing")),
            Some(item) => self.data_type(item)?,
        };
        let access = match section.get("accesstype") {
            None if is_domain => Access::ReadWrite,
            None => return Err(section.error("the key AccessType is missing")),
            Some(item) => access(item)?,
        };
        let name = section
            .get("parametername")
            .ok_or_else(|| section.error("the key ParameterName is missing"))?;
        let default = section
            .get("parametervalue")
            .or_else(|| section.get("defaultvalue"))
            .map(|item| self.default(data_type, item))
            .transpose()?
            .unwrap_or_else(|| vec![0; data_type.size_bytes().unwrap_or(0)]);
        let mut entry = Entry::new(index, sub_index, name.value, data_type, access, default);
        entry.is_pdo_mappable =
            integer_at(section, "pdomapping", self.node_id, 1_u8)?.unwrap_or(0) == 1;
        entry.low_limit = self.limit(data_type, section.get("lowlimit"))?;
        entry.high_limit = self.limit(data_type, section.get("highlimit"))?;
        if let (Some(low), Some(high)) = (entry.low_limit, entry.high_limit)
            && low > high
        {
            return Err(section.error("LowLimit is above HighLimit"));
        }
        Ok(entry)
    }

    /// Reads a limit; types without an order have none.
    fn limit(
        &self,
        data_type: DataType,
        item: Option<&Item<'_>>,
    ) -> Result<Option<i128>, EdsError> {
        item.filter(|_| data_type.size_bytes().is_some())
            .map(|item| Ok(data_type.rank(&self.encode(data_type, item)?)))
            .transpose()
    }

    /// Reads `DataType`.
    fn data_type(&self, item: &Item<'_>) -> Result<DataType, EdsError> {
        let number = item.integer(self.node_id)?;
        let known = u32::try_from(number).ok().and_then(DataType::from_number);
        Ok(known.unwrap_or(DataType::Domain))
    }

    /// Reads a default; a default of plain bytes may be unreadable.
    fn default(&self, data_type: DataType, item: &Item<'_>) -> Result<Vec<u8>, EdsError> {
        match self.encode(data_type, item) {
            Err(_) if matches!(data_type, DataType::OctetString | DataType::Domain) => {
                Ok(Vec::new())
            }
            result => result,
        }
    }

    /// Reads a value of a type.
    fn encode(&self, data_type: DataType, item: &Item<'_>) -> Result<Vec<u8>, EdsError> {
        value::encode(data_type, item.value, self.node_id).map_err(|reason| item.error(reason))
    }

    /// Keeps a sub-object.
    fn add(&mut self, entry: Entry, section: &Section<'_>) -> Result<(), EdsError> {
        self.dictionary.insert(entry);
        if self.dictionary.entries().len() > MAX_ENTRIES {
            return Err(section.error(format!("more than {MAX_ENTRIES} sub-objects")));
        }
        Ok(())
    }
}

/// Reads an integer from a section, at most `limit`.
fn integer_at<T: Copy + Into<i128> + TryFrom<i128>>(
    section: &Section<'_>,
    key: &str,
    node_id: u8,
    limit: T,
) -> Result<Option<T>, EdsError> {
    let Some(item) = section.get(key) else {
        return Ok(None);
    };
    let value = item.integer(node_id)?;
    match T::try_from(value) {
        Ok(inside) if (0..=limit.into()).contains(&value) => Ok(Some(inside)),
        _ => Err(item.error(format!("{value} is outside 0 to {}", limit.into()))),
    }
}

/// Reads `AccessType`.
fn access(item: &Item<'_>) -> Result<Access, EdsError> {
    let mut all = Access::ALL.into_iter();
    all.find(|access| item.value.eq_ignore_ascii_case(access.word()))
        .ok_or_else(|| item.error("expected ro, wo, rw, rwr, rww or const"))
}

/// Refuses an EDS that leaves PDOs undescribed by `CompactPDO`, because their mapping would be a guess.
fn check_compact_pdos(sections: &Sections<'_>, node_id: u8) -> Result<(), EdsError> {
    let Some(section) = sections.get("deviceinfo") else {
        return Ok(());
    };
    let Some(item) = section.get("compactpdo") else {
        return Ok(());
    };
    if integer_at(section, "compactpdo", node_id, u8::MAX)?.unwrap_or(0) == 0 {
        return Ok(());
    }
    for (count_key, first) in [("nrofrxpdo", "1400"), ("nroftxpdo", "1800")] {
        let count = integer_at(section, count_key, node_id, 512_u16)?.unwrap_or(0);
        if count > 0 && !sections.contains_key(first) {
            return Err(item.error("compact PDOs are not supported: describe each PDO"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SAMPLE: &str = include_str!("../tests/data/sample.eds");

    /// One described value, for short tests.
    fn object(body: &str) -> String {
        let section = "[2000]\nParameterName=Test\nObjectType=7\nAccessType=rw\n";
        format!("{section}{body}\n")
    }

    fn value(body: &str) -> Vec<u8> {
        let eds = parse(&object(body), 0x10).unwrap();
        eds.entries()[0].value().to_vec()
    }

    fn message(text: &str) -> String {
        parse(text, 0x10).unwrap_err().to_string()
    }

    #[test]
    fn integers_and_access_agree_with_python_canopen() {
        use Access::{Constant, ReadOnly, ReadWrite, ReadWriteRead, ReadWriteWrite, WriteOnly};
        use DataType::{
            Boolean, Domain, Integer16, Integer24, Integer32, Unsigned8, Unsigned16, Unsigned32,
            Unsigned64,
        };
        // Printed by python-canopen 2.4.1 for node 0x10, except for compact sub-objects (it leaves out their count and
        // [2108Value], gives other names, and forgets PDOMapping from sub-index 2 on), 0x2107 (it reads 4294967294 into
        // an INTEGER32), and 0 where it says None.
        #[rustfmt::skip]
        let expected = [
            (0x1000, 0x00, "Device type", Unsigned32, Constant, false, None, None, 131_474),
            (0x1001, 0x00, "Error register", Unsigned8, ReadOnly, true, None, None, 0),
            (0x1003, 0x00, "NrOfObjects", Unsigned8, ReadOnly, false, None, Some(254), 4),
            (0x1003, 0x01, "Newest error", Unsigned32, ReadOnly, false, None, None, 0),
            (0x1003, 0x02, "Error before", Unsigned32, ReadOnly, false, None, None, 0),
            (0x1003, 0x03, "Pre-defined error field3", Unsigned32, ReadOnly, false, None, None, 0),
            (0x1003, 0x04, "Pre-defined error field4", Unsigned32, ReadOnly, false, None, None, 0),
            (0x1005, 0x00, "COB-ID SYNC", Unsigned32, ReadWrite, false, None, None, 128),
            (0x1014, 0x00, "COB-ID EMCY", Unsigned32, ReadWrite, false, None, None, 144),
            (0x1018, 0x00, "Highest sub-index supported", Unsigned8, Constant, false, None, None, 2),
            (0x1018, 0x01, "Vendor-ID", Unsigned32, ReadOnly, false, None, None, 416),
            (0x1018, 0x02, "Product code", Unsigned32, ReadOnly, false, None, None, 4711),
            (0x1400, 0x00, "Highest sub-index supported", Unsigned8, Constant, false, None, None, 2),
            (0x1400, 0x01, "COB-ID", Unsigned32, ReadWrite, false, None, None, 528),
            (0x1400, 0x02, "Transmission type", Unsigned8, ReadWrite, false, Some(0), Some(255), 255),
            (0x1800, 0x00, "Highest sub-index supported", Unsigned8, Constant, false, None, None, 1),
            (0x1800, 0x01, "COB-ID", Unsigned32, ReadWrite, false, None, None, 400),
            (0x1F50, 0x00, "Program data", Domain, WriteOnly, false, None, None, 0),
            (0x2100, 0x00, "Limited", Integer16, ReadWriteWrite, true, Some(-1000), Some(1000), -5),
            (0x2101, 0x00, "Real32", DataType::Real32, ReadWriteRead, true, None, None, 0),
            (0x2102, 0x00, "Real64", DataType::Real64, ReadWrite, false, None, None, 0),
            (0x2103, 0x00, "Name; with a semicolon inside", DataType::VisibleString, Constant, false, None, None, 0),
            (0x2104, 0x00, "Octets", DataType::OctetString, ReadWrite, false, None, None, 0),
            (0x2105, 0x00, "Widest", Unsigned64, ReadWrite, false, None, None, 18_446_744_073_709_551_615),
            (0x2106, 0x00, "No default", Unsigned16, ReadWrite, false, None, None, 0),
            (0x2107, 0x00, "Signed in hexadecimal", Integer32, ReadWrite, false, None, None, -2),
            (0x2108, 0x00, "NrOfObjects", Unsigned8, ReadOnly, false, None, Some(254), 3),
            (0x2108, 0x01, "Gain1", Unsigned16, ReadWrite, true, Some(1), Some(100), 7),
            (0x2108, 0x02, "Gain2", Unsigned16, ReadWrite, true, Some(1), Some(100), 9),
            (0x2108, 0x03, "Gain3", Unsigned16, ReadWrite, true, Some(1), Some(100), 7),
            (0x2109, 0x00, "Count", Unsigned8, ReadOnly, false, None, None, 2),
            (0x2109, 0x0A, "Sub-index ten", Boolean, ReadWrite, false, None, None, 1),
            (0x210A, 0x00, "Configured", Unsigned16, ReadWrite, false, None, None, 4660),
            (0x210B, 0x00, "24 bits", Integer24, ReadWrite, false, None, None, -2),
        ];
        let eds = parse(SAMPLE, 0x10).unwrap();
        let found: Vec<_> = eds
            .entries()
            .iter()
            .map(|entry| {
                (
                    entry.index,
                    entry.sub_index,
                    entry.name.as_str(),
                    entry.data_type,
                    entry.access,
                    entry.is_pdo_mappable,
                    entry.low_limit,
                    entry.high_limit,
                    entry.as_integer(),
                )
            })
            .collect();
        assert_eq!(found, expected);
    }

    #[test]
    fn reals_strings_and_octets_agree_with_python_canopen() {
        let eds = parse(SAMPLE, 0x10).unwrap();
        let value = |index| {
            let handle = eds.find(index, 0).unwrap();
            eds.entry(handle).value()
        };
        assert_eq!(value(0x2101), 1.5_f32.to_le_bytes());
        assert_eq!(value(0x2102), (-0.0025_f64).to_le_bytes());
        assert_eq!(value(0x2103), b"canrig drive");
        assert_eq!(value(0x2104), [0x01, 0x02, 0xAB]);
        assert_eq!(value(0x1F50), []);
    }

    #[test]
    fn node_id_may_stand_on_either_side_with_or_without_blanks() {
        for formula in [
            "$NODEID+0x180",
            "0x180+$NODEID",
            "$NODEID + 0x180",
            " 0x180  +  $NodeId ; TPDO1",
            "$nodeid+384",
        ] {
            let bytes = value(&format!("DataType=7\nDefaultValue={formula}"));
            assert_eq!(bytes, 0x190_u32.to_le_bytes(), "{formula}");
        }
        assert_eq!(value("DataType=5\nDefaultValue=$NODEID"), [0x10]);
    }

    #[test]
    fn node_id_counts_in_parameter_values_and_limits() {
        let text =
            object("DataType=7\nParameterValue=$NODEID+1\nLowLimit=$NODEID\nHighLimit=$NODEID+2");
        let eds = parse(&text, 0x10).unwrap();
        let entry = &eds.entries()[0];
        assert_eq!(entry.as_integer(), 0x11);
        assert_eq!(
            (entry.low_limit, entry.high_limit),
            (Some(0x10), Some(0x12))
        );
    }

    #[test]
    fn numbers_may_be_decimal_hexadecimal_or_octal() {
        for (number, expected) in [("10", 10), ("0x10", 16), ("0X1f", 31), ("010", 8), ("0", 0)] {
            assert_eq!(
                value(&format!("DataType=5\nDefaultValue={number}")),
                [expected]
            );
        }
    }

    /// The numbers of CiA 301, table 44.
    #[test]
    fn integers_of_all_lengths_are_read() {
        let signed = [0x02, 0x03, 0x10, 0x04, 0x12, 0x13, 0x14, 0x15];
        let unsigned = [0x05, 0x06, 0x16, 0x07, 0x18, 0x19, 0x1A, 0x1B];
        for (types, default) in [(signed, -2_i64), (unsigned, 2)] {
            for (data_type, length) in types.into_iter().zip(1..) {
                let bytes = value(&format!("DataType={data_type:#x}\nDefaultValue={default}"));
                assert_eq!(bytes, default.to_le_bytes()[..length], "{data_type:#x}");
            }
        }
    }

    #[test]
    fn trailing_comments_are_cut() {
        assert_eq!(
            value("DataType=5 ; unsigned\nDefaultValue=7;no blank needed"),
            [7]
        );
        assert_eq!(value("DataType=5\nDefaultValue= ; none"), [0]);
        assert_eq!(value("DataType=9\nDefaultValue=a;b ; c"), b"a;b");
        assert_eq!(value("DataType=8\nDefaultValue=1;2"), 1_f32.to_le_bytes());
    }

    #[test]
    fn keys_and_sections_ignore_case_and_line_ends() {
        let text = "\u{feff}[1018]\r\nPARAMETERNAME=a\r\nobjecttype=9\r\n[1018SUB0]\r\nparameterNAME = b \r\n\
                    DATATYPE=5\r\naccesstype=RO\r\ndefaultvalue = 3\r\n";
        let eds = parse(text, 1).unwrap();
        assert_eq!(eds.integer(0x1018, 0), Some(3));
        assert_eq!(eds.entries()[0].name, "b");
    }

    #[test]
    fn described_sub_objects_take_the_place_of_compact_ones() {
        let text = "[1003]\nParameterName=Errors\nObjectType=8\nDataType=7\nAccessType=ro\nCompactSubObj=2\n\
                    [1003sub0]\nParameterName=Count\nDataType=5\nAccessType=rw\nDefaultValue=0\n";
        let eds = parse(text, 1).unwrap();
        assert_eq!(eds.entries().len(), 3);
        assert_eq!(eds.integer(0x1003, 0), Some(0));
        assert!(eds.entries()[0].access.is_writable());
    }

    #[test]
    fn limits_of_reals_order_like_the_reals() {
        let text = object("DataType=8\nLowLimit=-1.5\nHighLimit=2e3");
        let eds = parse(&text, 1).unwrap();
        let check = |value: f32| eds.entries()[0].check(&value.to_le_bytes());
        for inside in [-1.5, -0.1, -0.0, 0.0, 1999.0, 2000.0] {
            assert_eq!(check(inside), Ok(()), "{inside}");
        }
        for above in [2000.1, f32::INFINITY, f32::NAN] {
            assert_eq!(
                check(above),
                Err(crate::AbortCode::VALUE_TOO_HIGH),
                "{above}"
            );
        }
        for below in [-1.6, f32::NEG_INFINITY] {
            assert_eq!(
                check(below),
                Err(crate::AbortCode::VALUE_TOO_LOW),
                "{below}"
            );
        }
    }

    #[test]
    fn real_defaults_may_be_bits() {
        assert_eq!(
            value("DataType=8\nDefaultValue=0x3FC00000"),
            1.5_f32.to_le_bytes()
        );
    }

    #[test]
    fn errors_name_line_section_key_value_and_reason() {
        assert_eq!(
            message(&object("DataType=5\nDefaultValue=0x1G")),
            "line 6: [2000] DefaultValue=0x1G: \"0x1G\" is not a hexadecimal number"
        );
        assert_eq!(
            message(&object("DataType=5\nDefaultValue=256")),
            "line 6: [2000] DefaultValue=256: 256 does not fit the type Unsigned8"
        );
        assert_eq!(
            message(&object("DataType=5\nDefaultValue=08")),
            "line 6: [2000] DefaultValue=08: \"08\" is not an octal number (leading 0)"
        );
        assert_eq!(
            message(&object("")),
            "line 1: [2000] the key DataType is missing"
        );
        assert_eq!(
            message("[2000]\nParameterName=a\nDataType=5\nAccessType=read"),
            "line 4: [2000] AccessType=read: expected ro, wo, rw, rwr, rww or const"
        );
        assert_eq!(
            message("[A]\n[B]\n[a]"),
            "line 3: [a] the section stands in line 1 already"
        );
        assert_eq!(
            message("[A]\nx=1\nX=2"),
            "line 3: [A] X=2: the key stands in line 2 already"
        );
        assert_eq!(
            message("[A]\nwhat"),
            "line 2: [A] expected key=value, found \"what\""
        );
        assert_eq!(message("x=1"), "line 1: a line before the first [section]");
        assert_eq!(message("[A"), "line 1: a section header without ']'");
        assert_eq!(
            message("[1018sub1]"),
            "line 1: [1018sub1] there is no section [1018]"
        );
        assert_eq!(
            message("[1018]\nObjectType=9\n[1018sub01]\n[1018sub1]"),
            "line 4: [1018sub1] the sub-object stands in line 3 already"
        );
        assert_eq!(
            message(&object("DataType=5\nLowLimit=2\nHighLimit=1")),
            "line 1: [2000] LowLimit is above HighLimit"
        );
        assert_eq!(
            message("[DeviceInfo]\nCompactPDO=3\nNrOfTXPDO=1"),
            "line 2: [DeviceInfo] CompactPDO=3: compact PDOs are not supported: describe each PDO"
        );
        assert_eq!(
            parse("", 0).unwrap_err().to_string(),
            "node-ID 0 is outside 1 to 127"
        );
    }

    #[test]
    fn errors_that_do_no_harm_are_passed_over() {
        let text = object("DataType=0x40\nDefaultValue=@A\nLowLimit=x");
        let text = format!("[OptionalObjects]\n1=0x1F51\n{text}\n[2001]\nObjectType=9");
        let dictionary = parse(&text, 1).unwrap();
        let [entry] = dictionary.entries() else {
            panic!("neither 0x1F51 nor 0x2001 has a value");
        };
        assert_eq!(
            (entry.index, entry.data_type, entry.value()),
            (0x2000, DataType::Domain, &[][..])
        );
    }

    #[test]
    fn size_is_bounded() {
        let long_line = format!("[A]\nx={}", "y".repeat(2000));
        assert!(message(&long_line).starts_with("line 2: the line has 2002 bytes"));
        assert!(message(&" ".repeat(MAX_TEXT_BYTES + 1)).contains("bytes (limit"));
        let compact = |index| {
            format!(
                "[{index:04X}]\nParameterName=a\nObjectType=8\nDataType=1\nAccessType=ro\nCompactSubObj=254\n"
            )
        };
        let many: String = (0x2000..0x2100).map(compact).collect();
        assert!(message(&many).ends_with("more than 32768 sub-objects"));
    }

    proptest! {
        #[test]
        fn arbitrary_text_never_panics(text in "\\PC*", node_id: u8) {
            let _ = parse(&text, node_id);
        }

        #[test]
        fn damaged_samples_never_panic(place in 0..SAMPLE.len(), length in 0_usize..20, patch in "[\\PC\n]{0,8}") {
            let end = (place + length).min(SAMPLE.len());
            let damaged = [&SAMPLE.as_bytes()[..place], patch.as_bytes(), &SAMPLE.as_bytes()[end..]].concat();
            let _ = parse(&String::from_utf8_lossy(&damaged), 0x10);
        }

        #[test]
        fn arbitrary_values_never_panic(
            data_type in 0_u8..0x20,
            key in "(DefaultValue|ParameterValue|LowLimit|HighLimit|ObjectType|CompactSubObj|PDOMapping)",
            text in "[-+0-9a-fxX$NODEID.; ]{0,45}",
        ) {
            let _ = parse(&object(&format!("DataType={data_type}\n{key}={text}")), 0x7F);
        }
    }
}
