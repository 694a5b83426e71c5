use proptest::prelude::*;

use super::*;

const SAMPLE: &str = include_str!("../../tests/data/sample.eds");

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

/// Sheet without a slip, of which each line of the table below changes one place.
const BASE: &str = "[FileInfo]\nFileName=base.eds\n\n[DeviceInfo]\nVendorName=nobody\n\n[Comments]\nLines=1\nLine1=None\n\n\
    [DummyUsage]\nDummy0001=0\n\n[MandatoryObjects]\nSupportedObjects=3\n1=0x1000\n2=0x1001\n3=0x1018\n\n\
    [OptionalObjects]\nSupportedObjects=1\n1=0x1800\n\n\
    [ManufacturerObjects]\nSupportedObjects=4\n1=0x2000\n2=0x2001\n3=0x2002\n4=0x2003\n\n\
    [1000]\nParameterName=Device type\nObjectType=7\nDataType=7\nAccessType=ro\nDefaultValue=0x20192\nPDOMapping=0\n\n\
    [1001]\nParameterName=Error register\nObjectType=7\nDataType=5\nAccessType=ro\nDefaultValue=0\nPDOMapping=0\n\n\
    [1018]\nParameterName=Identity\nObjectType=9\nSubNumber=2\n\n\
    [1018sub0]\nParameterName=Count\nObjectType=7\nDataType=5\nAccessType=const\nDefaultValue=1\nPDOMapping=0\n\n\
    [1018sub1]\nParameterName=Vendor\nObjectType=7\nDataType=7\nAccessType=ro\nDefaultValue=0x2FE\nPDOMapping=0\n\n\
    [1800]\nParameterName=TPDO\nObjectType=9\nSubNumber=2\n\n\
    [1800sub0]\nParameterName=Count\nObjectType=7\nDataType=5\nAccessType=const\nDefaultValue=1\nPDOMapping=0\n\n\
    [1800sub1]\nParameterName=COB-ID\nObjectType=7\nDataType=7\nAccessType=rw\nDefaultValue=$NODEID+0x180\nPDOMapping=0\n\n\
    [2000]\nParameterName=Speed\nObjectType=7\nDataType=3\nAccessType=rw\nLowLimit=-100\nHighLimit=100\nDefaultValue=-5\nPDOMapping=1\n\n\
    [2001]\nParameterName=Switch\nObjectType=7\nDataType=1\nAccessType=rw\nDefaultValue=1\nPDOMapping=0\n\n\
    [2002]\nParameterName=Gain\nObjectType=7\nDataType=8\nAccessType=rw\nDefaultValue=1.5\nPDOMapping=0\n\n\
    [2003]\nParameterName=Mask\nObjectType=7\nDataType=7\nAccessType=rw\nDefaultValue=4\nPDOMapping=0\n\n";

/// Slips that do no harm: the name, what is replaced in the base by what, and the number of notes. All objects are then as in
/// the base.
const HARMLESS: &[(&str, &str, &str, usize)] = &[
    ("no slip", "", "", 0),
    ("byte order mark", "[FileInfo]", "\u{feff}[FileInfo]", 0),
    ("CR LF", "\n", "\r\n", 0),
    ("CR", "\n", "\r", 0),
    ("blanks round =", "=", " \t= ", 0),
    ("blanks at the ends", "\n", " \t\n  ", 0),
    ("upper case", "AccessType=ro", "ACCESSTYPE=RO", 0),
    ("upper-case 0X", "0x", "0X", 0),
    ("blank before +", "$NODEID+0x180", "$NODEID +0x180", 0),
    ("node-ID behind", "$NODEID+0x180", "0x180+$NODEID", 0),
    ("lower-case node-ID", "$NODEID+0x180", "0x180 + $nodeid", 0),
    ("limits with comments", "=-100", "=-100 ; mm", 0),
    (
        "empty limits of another",
        "[2003]",
        "[2003]\nLowLimit=\nHighLimit=",
        0,
    ),
    ("without ObjectType", "ObjectType=7\n", "", 0),
    (
        "section [Tools]",
        "[1000]",
        "[Tools]\nItems=1\n[Tool1]\nName=x\nCommand=y\n[1000]",
        0,
    ),
    (
        "DCF",
        "DefaultValue=-5",
        "DefaultValue=3\nParameterValue=-5\nDenotation=fast",
        0,
    ),
    (
        "DCF section",
        "[1000]",
        "[DeviceComissioning]\nNodeID=5\n[1000]",
        0,
    ),
    (
        "links",
        "[2000]",
        "[2000ObjectLinks]\nObjectLinks=0\n[2000]",
        0,
    ),
    (
        "end mark",
        "PDOMapping=0\n\n[2003]",
        "PDOMapping=0\n\x1a\n[2003]",
        1,
    ),
    ("NUL bytes", "[FileInfo]", "\0\0[FileInfo]", 1),
    ("comment #", "[1000]", "# identity\n[1000]", 1),
    ("comment //", "[1000]", "// identity\n[1000]", 1),
    (
        "line before all sections",
        "[FileInfo]",
        "Made by hand\n[FileInfo]",
        1,
    ),
    (
        "free text",
        "Lines=1",
        "This drive is sold\nfor all it can do.",
        2,
    ),
    ("garbage", "[2001]", "%&$ garbage\n[2001]", 1),
    ("no key", "[2001]", "=5\n[2001]", 1),
    ("header without ]", "[2001]", "[2001", 1),
    (
        "header without ], with comment",
        "[2001]",
        "[2001 ; the switch",
        1,
    ),
    ("text behind ]", "[2001]", "[2001] switch", 1),
    ("blanks in a header", "[2001]", "[ 2001 ]", 0),
    ("blanks inside of a header", "[1018sub1]", "[1018 sub 1]", 1),
    ("0x in a header", "[2001]", "[0x2001]", 1),
    ("0x in a sub-index", "[1018sub1]", "[1018sub0x01]", 0),
    (
        "lower-case section",
        "[MandatoryObjects]",
        "[mandatoryobjects]",
        0,
    ),
    ("key twice", "DataType=3", "DataType=3\nDataType=3", 1),
    ("section twice", "[2001]", "[2001]\nObjectType=7\n[2001]", 2),
    (
        "section twice, different",
        "[DeviceInfo]",
        "[FileInfo]\nFileName=x\n[DeviceInfo]",
        2,
    ),
    (
        "unused key twice",
        "ParameterName=Switch",
        "ParameterName=Switch\nObjFlags=1\nObjFlags=2",
        1,
    ),
    (
        "sub-object twice",
        "[1800]",
        "[1018sub01]\nParameterName=Vendor\nDataType=7\nAccessType=ro\n\
        DefaultValue=0x2FE\nPDOMapping=0\n[1800]",
        1,
    ),
    (
        "no parent",
        "[1800]\nParameterName=TPDO\nObjectType=9\nSubNumber=2\n",
        "",
        1,
    ),
    (
        "parent without ObjectType",
        "ParameterName=TPDO\nObjectType=9\n",
        "ParameterName=TPDO\n",
        1,
    ),
    (
        "parent is a VAR",
        "Identity\nObjectType=9",
        "Identity\nObjectType=7",
        1,
    ),
    (
        "type of object in words",
        "ObjectType=9",
        "ObjectType=RECORD",
        2,
    ),
    (
        "unknown type of object",
        "Vendor\nObjectType=7",
        "Vendor\nObjectType=99",
        1,
    ),
    ("SubNumber", "SubNumber=2", "SubNumber=7", 2),
    (
        "SubNumber is no number",
        "TPDO\nObjectType=9\nSubNumber=2",
        "TPDO\nObjectType=9\nSubNumber=two",
        1,
    ),
    (
        "SupportedObjects",
        "SupportedObjects=3",
        "SupportedObjects=30",
        1,
    ),
    ("gap in a list", "3=0x1018", "5=0x1018", 1),
    (
        "listed, not described",
        "SupportedObjects=1\n",
        "SupportedObjects=2\n2=0x1400\n",
        1,
    ),
    (
        "described, not listed",
        "SupportedObjects=4\n1=0x2000\n2=0x2001\n3=0x2002\n4=0x2003",
        "SupportedObjects=0",
        1,
    ),
    (
        "listed twice",
        "SupportedObjects=1\n",
        "SupportedObjects=2\n2=0x1001\n",
        1,
    ),
    (
        "list of words",
        "SupportedObjects=1\n1=0x1800",
        "SupportedObjects=1\n1=TPDO",
        2,
    ),
    ("no [FileInfo]", "[FileInfo]\nFileName=base.eds\n", "", 1),
    (
        "no [DeviceInfo]",
        "[DeviceInfo]\nVendorName=nobody\n",
        "",
        1,
    ),
    (
        "true",
        "DefaultValue=1\nPDOMapping=0\n\n[2002]",
        "DefaultValue=true\nPDOMapping=0\n\n[2002]",
        1,
    ),
    ("PDOMapping=TRUE", "PDOMapping=1", "PDOMapping=TRUE", 1),
    (
        "PDOMapping=no",
        "DefaultValue=4\nPDOMapping=0",
        "DefaultValue=4\nPDOMapping=no",
        1,
    ),
    ("quotes", "=0x2FE", "=\"0x2FE\"", 1),
    ("quoted name", "=Speed", "=\"Speed\"", 0),
    ("unit", "=-100", "=-100 mm", 1),
    ("unit without a blank", "=100", "=100rpm", 1),
    (
        "comment behind //",
        "DefaultValue=4",
        "DefaultValue=4 // bits",
        1,
    ),
    (
        "comment behind #",
        "DefaultValue=4",
        "DefaultValue=4 # bits",
        1,
    ),
    ("brackets", "DefaultValue=4", "DefaultValue=4 (all)", 1),
    ("leading zeros", "DefaultValue=4", "DefaultValue=004", 0),
    ("no octal number", "HighLimit=100", "HighLimit=0000100.0", 1),
    ("plus", "HighLimit=100", "HighLimit=+100", 1),
    ("float", "=1.5", "=1,5", 1),
    ("float with a unit", "=1.5", "=1.5 V", 1),
    (
        "two's complement of a wider type",
        "DefaultValue=-5",
        "DefaultValue=0xFFFFFFFB",
        1,
    ),
    (
        "two's complement, decimal",
        "DefaultValue=-5",
        "DefaultValue=65531",
        1,
    ),
    (
        "two's complement of the type's width",
        "LowLimit=-100",
        "LowLimit=0xFF9C",
        0,
    ),
    ("type in words", "DataType=3", "DataType=INTEGER16", 1),
    (
        "standard type is missing",
        "Vendor\nObjectType=7\nDataType=7",
        "Vendor\nObjectType=7",
        1,
    ),
    (
        "standard type is unknown",
        "Vendor\nObjectType=7\nDataType=7",
        "Vendor\nObjectType=7\nDataType=0x17",
        1,
    ),
    (
        "AccessType is missing",
        "Mask\nObjectType=7\nDataType=7\nAccessType=rw\n",
        "Mask\nObjectType=7\nDataType=7\n",
        1,
    ),
    (
        "AccessType is unknown",
        "Mask\nObjectType=7\nDataType=7\nAccessType=rw\n",
        "Mask\nObjectType=7\nDataType=7\nAccessType=r/w\n",
        1,
    ),
    (
        "unreadable number of compact sub-objects",
        "Mask\n",
        "Mask\nCompactSubObj=many\n",
        0,
    ),
    (
        "compact PDOs",
        "[Comments]",
        "CompactPDO=3\nNrOfRXPDO=1\n[Comments]",
        1,
    ),
    (
        "CompactPDO=TRUE",
        "[Comments]",
        "CompactPDO=FALSE\nNrOfRXPDO=1\n[Comments]",
        1,
    ),
];

#[test]
fn harmless_slips_are_read_and_noted() {
    let base = read(BASE, 5).unwrap();
    for (name, from, to, count) in HARMLESS {
        assert!(from.is_empty() || BASE.contains(from), "{name}");
        let text = BASE.replace(from, to);
        let text = if from.is_empty() { BASE } else { &text };
        let sheet = read(text, 5).unwrap_or_else(|error| panic!("{name}: {error}"));
        let notes = sheet.notes.first(99);
        assert_eq!(sheet.notes.count(), *count, "{name}: {notes:#?}");
        let wanted = base.dictionary.entries().iter();
        for (found, wanted) in sheet.dictionary.entries().iter().zip(wanted) {
            assert_eq!(found, wanted, "{name}");
        }
        let count = sheet.dictionary.entries().len();
        assert_eq!(count, base.dictionary.entries().len(), "{name}");
        let places = sheet.dictionary.entries().iter();
        let mut places = places.map(|entry| (entry.index, entry.sub_index));
        assert!(
            places.all(|(index, sub)| sheet.contradiction(index, sub).is_none()),
            "{name}"
        );
    }
}

/// An entry that cannot be read is left out, and nothing else is.
#[test]
#[expect(clippy::too_many_lines, reason = "a table of slips")]
fn slips_that_cost_a_value_cost_no_other() {
    let base = read(BASE, 5).unwrap().dictionary;
    for (name, from, to, (index, sub_index), note) in [
        (
            "default",
            "=-5",
            "=fast",
            (0x2000, 0),
            "[2000] DefaultValue=fast: \"fast\" is not a decimal number: it is ignored",
        ),
        (
            "too large",
            "=-5",
            "=100000",
            (0x2000, 0),
            "100000 does not fit the type Integer16",
        ),
        (
            "limits turned round",
            "=-100\nHighLimit=100",
            "=0x00\nHighLimit=0xFFFF",
            (0x2000, 0),
            "[2000] LowLimit=0x00: LowLimit is above HighLimit as Integer16: both are ignored",
        ),
        (
            "limits of words",
            "=-100\nHighLimit=100",
            "=min\nHighLimit=max",
            (0x2000, 0),
            "[2000] LowLimit=min: ",
        ),
        (
            "limit of another type",
            "HighLimit=100",
            "HighLimit=0x12345",
            (0x2000, 0),
            "74565 does not fit the type Integer16: it is ignored",
        ),
        (
            "real",
            "=1.5",
            "=inf",
            (0x2002, 0),
            "\"inf\" is not a finite Real32",
        ),
        (
            "-1",
            "DefaultValue=4",
            "DefaultValue=-1",
            (0x2003, 0),
            "-1 does not fit the type Unsigned32: it is read as its two's complement",
        ),
        (
            "name",
            "ParameterName=Mask",
            "ParameterName=",
            (0x2003, 0),
            "[2003] the key ParameterName is missing",
        ),
        (
            "no name",
            "ParameterName=Mask\n",
            "",
            (0x2003, 0),
            "[2003] the key ParameterName is missing",
        ),
        (
            "access",
            "=3\nAccessType=rw",
            "=3\nAccessType=w",
            (0x2000, 0),
            "",
        ),
        (
            "type",
            "DataType=8",
            "DataType=float",
            (0x2002, 0),
            "[2002] DataType=float: the data type is unknown: it is read as Domain",
        ),
        (
            "no type",
            "DataType=8\n",
            "",
            (0x2002, 0),
            "[2002] the key DataType is missing: it is read as Domain",
        ),
        (
            "mapping",
            "PDOMapping=1",
            "PDOMapping=2",
            (0x2000, 0),
            "[2000] PDOMapping=2: 2 is outside 0 to 1: it is ignored",
        ),
        (
            "other value",
            "=-5",
            "=-5\nDefaultValue=7",
            (0x2000, 0),
            "[2000] DefaultValue=7: the key has the value \"-5\" in line",
        ),
        (
            "not a sub-index",
            "[1018sub1]",
            "[1018subX]",
            (0x1018, 1),
            "[1018subX] \"x\" is not a sub-index",
        ),
        (
            "vendor in words",
            "=0x2FE",
            "=see the label",
            (0x1018, 1),
            "is not a decimal number",
        ),
    ] {
        assert!(BASE.contains(from), "{name}");
        let sheet = read(&BASE.replacen(from, to, 1), 5).unwrap();
        let notes = Vec::from_iter(sheet.notes.first(99).iter().map(ToString::to_string));
        assert!(
            notes.iter().any(|one| one.contains(note)),
            "{name}: {notes:#?}"
        );
        for wanted in base.entries() {
            if (wanted.index, wanted.sub_index) == (index, sub_index) {
                continue;
            }
            let found = sheet.dictionary.get(wanted.index, wanted.sub_index);
            assert_eq!(found, Some(wanted), "{name}");
        }
    }
}

#[test]
fn a_contradiction_is_known_where_it_matters() {
    let twice = BASE.replace("=0x2FE", "=0x2FE\nDefaultValue=0x2FF");
    let sheet = read(&twice, 5).unwrap();
    let what = sheet.contradiction(0x1018, 1).unwrap();
    assert!(
        what.contains("DefaultValue=0x2FE: line") && what.ends_with("has another value"),
        "{what}"
    );
    let twice = BASE.replace(
        "[1800]",
        "[1018sub01]\nParameterName=Vendor\nDefaultValue=2\n[1800]",
    );
    let sheet = read(&twice, 5).unwrap();
    assert!(sheet.contradiction(0x1018, 1).is_some());
    assert_eq!(sheet.dictionary.unsigned(0x1018, 1), Some(0x2FE));
    let name = read(&BASE.replace("=Vendor", "=Vendor\nParameterName=Maker"), 5).unwrap();
    assert_eq!(name.contradiction(0x1018, 1), None);
}

#[test]
fn signed_limits_are_two_s_complements_of_their_width() {
    for (data_type, low, high, expected) in [
        (2, "0x80", "0x7F", Some((-128, 127))),
        (2, "0x00", "0xFF", None),
        (3, "0x8000", "0x7FFF", Some((-32768, 32767))),
        (
            4,
            "0x80000000",
            "0x7FFFFFFF",
            Some((-2_147_483_648, 2_147_483_647)),
        ),
        (
            4,
            "0x80000000",
            "2147483647",
            Some((-2_147_483_648, 2_147_483_647)),
        ),
        (
            4,
            "-2147483648",
            "0x7FFFFFFF",
            Some((-2_147_483_648, 2_147_483_647)),
        ),
        (
            4,
            "0xFFFFFFFF80000000",
            "0x7FFFFFFF",
            Some((-2_147_483_648, 2_147_483_647)),
        ),
        (4, "0x00000000", "0xFFFFFFFF", None),
        (0x10, "0x800000", "0x7FFFFF", Some((-8_388_608, 8_388_607))),
        (
            0x15,
            "0x8000000000000000",
            "0x7FFFFFFFFFFFFFFF",
            Some((i64::MIN.into(), i64::MAX.into())),
        ),
        (
            7,
            "0x80000000",
            "0xFFFFFFFF",
            Some((0x8000_0000, 0xFFFF_FFFF)),
        ),
    ] {
        let text = object(&format!(
            "DataType={data_type}\nLowLimit={low}\nHighLimit={high}"
        ));
        let sheet = read(&text, 1).unwrap();
        let entry = &sheet.dictionary.entries()[0];
        let limits = entry.low_limit.zip(entry.high_limit);
        assert_eq!(limits, expected, "{data_type} {low} {high}");
        let is_noted = sheet
            .notes
            .first(99)
            .iter()
            .any(|note| note.text.contains("both are ignored"));
        assert_eq!(is_noted, expected.is_none(), "{data_type} {low} {high}");
    }
}

#[test]
fn what_is_no_sheet_is_refused() {
    for (text, node_id, wanted) in [
        ("", 5, "it describes no object: is it an EDS?"),
        (
            "[FileInfo]\nFileName=a\n",
            5,
            "it describes no object: is it an EDS?",
        ),
        (BASE, 0, "node-ID 0 is outside 1 to 127"),
        (
            &BASE.replace("=0x20192", "=0x1FFFFFFFF"),
            5,
            "line 36: [1000] DefaultValue=0x1FFFFFFFF: \
            8589934591 does not fit the type Unsigned32, so this is no device",
        ),
    ] {
        assert_eq!(read(text, node_id).unwrap_err().to_string(), wanted);
    }
}

#[test]
fn size_is_bounded() {
    assert!(message(&" ".repeat(MAX_TEXT_BYTES + 1)).contains("bytes (limit"));
    let compact = |index| {
        format!(
            "[{index:04X}]\nParameterName=a\nObjectType=8\nDataType=1\nAccessType=ro\nCompactSubObj=254\n"
        )
    };
    let many: String = (0x2000..0x2100).map(compact).collect();
    assert!(message(&many).ends_with("more than 32768 sub-objects"));
    let long = BASE.replace("=Speed", &format!("={}", "y".repeat(1500)));
    let sheet = read(&long, 5).unwrap();
    assert_eq!(
        sheet.dictionary.get(0x2000, 0).unwrap().name.len(),
        NAME_MAX
    );
    let garbage = BASE.to_owned() + &format!("{}\n", "x".repeat(400)).repeat(5000);
    let notes = read(&garbage, 5).unwrap().notes;
    assert_eq!(notes.count(), 10_000);
    assert_eq!(notes.first(usize::MAX).len(), 1000);
    let longest = notes.first(1000).iter().map(|note| note.text.len()).max();
    assert!(longest < Some(300), "{longest:?}");
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
