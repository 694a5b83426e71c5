//! Data sheets as makers write them: shapes of one sheet, each by its own edits, through `check` and through the identity of a
//! drive in virtual time; what the bench needs and a sheet does not give is refused.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{canrig, output, root};

/// Writes the bytes of a sheet from its text.
type Encode = fn(&str) -> Vec<u8>;

/// A shape: its name, what is replaced in the sheet by what, and its encoding.
type Shape = (
    &'static str,
    &'static [(&'static str, &'static str)],
    Encode,
);

fn utf_8(text: &str) -> Vec<u8> {
    text.as_bytes().to_vec()
}

fn latin_1(text: &str) -> Vec<u8> {
    let letters = text.chars();
    letters
        .map(|letter| u8::try_from(letter).expect("a letter of Latin-1"))
        .collect()
}

fn utf_16(text: &str) -> Vec<u8> {
    let units = "\u{feff}".encode_utf16().chain(text.encode_utf16());
    units.flat_map(u16::to_le_bytes).collect()
}

const DEVICE_TYPE: &str = "DefaultValue=0x00020192";
const VENDOR: &str = "DefaultValue=0x000002FE";
const PRODUCT: &str = "DefaultValue=0x00000077";
const BLANK: &str = "DefaultValue=";

const SHAPES: &[Shape] = &[
    ("as it is", &[], utf_8),
    ("device type blank", &[(DEVICE_TYPE, BLANK)], utf_8),
    ("device type 0", &[(DEVICE_TYPE, "DefaultValue=0x0")], utf_8),
    (
        "device type without default",
        &[("DefaultValue=0x00020192\n", "")],
        utf_8,
    ),
    ("no device type", &[("[1000]", "[1000Unused]")], utf_8),
    ("vendor blank", &[(VENDOR, BLANK)], utf_8),
    ("vendor 0", &[(VENDOR, "DefaultValue=0")], utf_8),
    ("product blank", &[(PRODUCT, BLANK)], utf_8),
    (
        "product in words",
        &[(PRODUCT, "DefaultValue=see the label")],
        utf_8,
    ),
    (
        "identity blank",
        &[(DEVICE_TYPE, BLANK), (VENDOR, BLANK), (PRODUCT, BLANK)],
        utf_8,
    ),
    ("no identity object", &[("[1018", "[101x")], utf_8),
    (
        "Latin-1",
        &[("=Encoder", "=Größe in µm"), ("=none", "=Münchner Kärrner")],
        latin_1,
    ),
    (
        "Windows-1252",
        &[("=Encoder", "=Drive\u{92}s \u{80}ncoder")],
        latin_1,
    ),
    ("UTF-16", &[("=Encoder", "=Größe")], utf_16),
    (
        "UTF-8 with a byte order mark",
        &[("; A drive", "\u{feff}; A drive")],
        utf_8,
    ),
    ("CR LF", &[("\n", "\r\n")], utf_8),
    ("CR", &[("\n", "\r")], utf_8),
    (
        "end mark and NUL bytes",
        &[("[6060]", "\x1a\n[6060]"), ("=-128", "=-128\0\0")],
        utf_8,
    ),
    (
        "free text",
        &[(
            "[MandatoryObjects]",
            "[Comments]\nThis drive is sold\nas it is: no warranty\n[MandatoryObjects]",
        )],
        utf_8,
    ),
    (
        "keys twice",
        &[("AccessType=rw\n", "AccessType=rw\nAccessType=rw\n")],
        utf_8,
    ),
    (
        "a section twice",
        &[("[6060]", "[6060]\nParameterName=Modes of operation\n[6060]")],
        utf_8,
    ),
    (
        "sub-objects without a parent",
        &[("[1A00]", "[1A00Unused]"), ("[2100]", "[2100Unused]")],
        utf_8,
    ),
    (
        "parents without ObjectType",
        &[("ObjectType=0x9\n", "")],
        utf_8,
    ),
    ("no ObjectType", &[("ObjectType=0x7\n", "")], utf_8),
    (
        "signed limits as bytes",
        &[("[6060]", "[6060]\nLowLimit=0x00\nHighLimit=0xFF")],
        utf_8,
    ),
    (
        "signed limits as words",
        &[(
            "[2100sub1]",
            "[2100sub1]\nLowLimit=0x80000000\nHighLimit=0x7FFFFFFF",
        )],
        utf_8,
    ),
    (
        "limits of words",
        &[("[2201]", "[2201]\nLowLimit=min\nHighLimit=max")],
        utf_8,
    ),
    (
        "blank names",
        &[("ParameterName=Mapped object", "ParameterName=\nNote")],
        utf_8,
    ),
    ("no names", &[("ParameterName=", "Name=")], utf_8),
    (
        "PDOMapping=TRUE",
        &[
            ("PDOMapping=1", "PDOMapping=TRUE"),
            ("PDOMapping=0", "PDOMapping=FALSE"),
        ],
        utf_8,
    ),
    (
        "no PDOMapping",
        &[("PDOMapping=1\n", "\n"), ("PDOMapping=0\n", "\n")],
        utf_8,
    ),
    (
        "-1 of an UNSIGNED32",
        &[(
            "[1001]",
            "[1002]\nParameterName=a\nDataType=7\nAccessType=ro\nDefaultValue=-1\n[1001]",
        )],
        utf_8,
    ),
    (
        "true of a BOOLEAN",
        &[(
            "[2200]",
            "[2150]\nParameterName=a\nDataType=1\nAccessType=rw\nDefaultValue=true\n[2200]",
        )],
        utf_8,
    ),
    (
        "types of the maker",
        &[(
            "[2200]",
            "[2150]\nParameterName=a\nDataType=0x0017\nAccessType=rw\nDefaultValue=x\n[2200]",
        )],
        utf_8,
    ),
    (
        "no types of standard objects",
        &[("DataType=0x0007\n", "")],
        utf_8,
    ),
    (
        "no AccessType",
        &[("AccessType=rw\n", ""), ("AccessType=ro\n", "")],
        utf_8,
    ),
    (
        "unknown AccessType",
        &[("AccessType=rw", "AccessType=read/write")],
        utf_8,
    ),
    (
        "wrong numbers of sub-objects",
        &[("SubNumber=3", "SubNumber=0x10")],
        utf_8,
    ),
    (
        "wrong lists",
        &[
            ("SupportedObjects=9", "SupportedObjects=90"),
            ("2=0x1017", "22=0x1017"),
            ("=0x6060", "=0x6065"),
        ],
        utf_8,
    ),
    ("no lists", &[("Objects]", "Things]")], utf_8),
    (
        "no head",
        &[("[FileInfo]", "[A]"), ("[DeviceInfo]", "[B]")],
        utf_8,
    ),
    (
        "blank COB-IDs",
        &[
            ("DefaultValue=$NODEID+0x180", BLANK),
            ("DefaultValue=$NODEID+0x200", BLANK),
        ],
        utf_8,
    ),
    (
        "PDOs switched off",
        &[("$NODEID+0x", "$NODEID+0x80000")],
        utf_8,
    ),
    (
        "node-ID behind",
        &[
            ("$NODEID+0x180", "0x180 + $NodeID"),
            ("$NODEID+0x200", "$nodeid +0x200 (RPDO1)"),
        ],
        utf_8,
    ),
    (
        "blank transmission types",
        &[("DefaultValue=255", BLANK)],
        utf_8,
    ),
    (
        "blank mapping",
        &[(
            "DefaultValue=1\nPDOMapping=0\n\n[1600sub1]",
            "DefaultValue=\n[1600sub1]",
        )],
        utf_8,
    ),
    (
        "a mapping of nothing",
        &[(
            "DefaultValue=1\nPDOMapping=0\n\n[1A00sub1]",
            "DefaultValue=4\n[1A00sub1]",
        )],
        utf_8,
    ),
    (
        "no mapping",
        &[("[1600", "[160x"), ("[1A00", "[1A0x")],
        utf_8,
    ),
    (
        "no heartbeat, no mode",
        &[("[1017]", "[1017Unused]"), ("[6060]", "[6060Unused]")],
        utf_8,
    ),
    (
        "quotes",
        &[
            ("=0x00000077", "=\"0x00000077\""),
            ("DataType=0x0006", "DataType=\"0x0006\""),
        ],
        utf_8,
    ),
    (
        "units",
        &[("DefaultValue=0\n", "DefaultValue=0 mA\n")],
        utf_8,
    ),
    (
        "comments of C",
        &[
            (
                "DefaultValue=0x00000077",
                "// product\nDefaultValue=0x00000077 // 119",
            ),
            ("[6060]", "# mode\n[6060]"),
        ],
        utf_8,
    ),
    (
        "blanks and tabulators",
        &[("=", " \t= "), ("[1018sub1]", "[ 1018 sub 1 ]")],
        utf_8,
    ),
    (
        "upper case",
        &[
            ("ParameterName", "PARAMETERNAME"),
            ("sub", "SUB"),
            ("0x", "0X"),
        ],
        utf_8,
    ),
    (
        "lower case",
        &[
            ("DefaultValue", "defaultvalue"),
            ("[1A00", "[1a00"),
            ("[MandatoryObjects]", "[mandatoryobjects]"),
        ],
        utf_8,
    ),
    (
        "headers without ]",
        &[("[2201]", "[2201"), ("[1017]", "[1017")],
        utf_8,
    ),
    (
        "garbage",
        &[
            ("[2201]", "~~~~~ currents ~~~~~\n= ?\n[2201]"),
            ("; A drive", "A drive"),
        ],
        utf_8,
    ),
    (
        "configured",
        &[(
            "DefaultValue=0x00000077",
            "DefaultValue=1\nParameterValue=0x77\nDenotation=x axis",
        )],
        utf_8,
    ),
    (
        "compact PDOs beyond the first",
        &[(
            "[MandatoryObjects]",
            "CompactPDO=3\nNrOfRXPDO=4\nNrOfTXPDO=4\n[MandatoryObjects]",
        )],
        utf_8,
    ),
    (
        "compact sub-objects",
        &[(
            "[2200]",
            "[2150]\nParameterName=a\nObjectType=8\nDataType=7\nAccessType=rw\nCompactSubObj=300\n[2200]",
        )],
        utf_8,
    ),
    (
        "sections of tools",
        &[(
            "[MandatoryObjects]",
            "[DummyUsage]\nDummy0001=yes\n[Tools]\nItems=1\n[Tool1]\nName=T\n[MandatoryObjects]",
        )],
        utf_8,
    ),
];

/// Returns the sheet of a drive of `tests/data/programs`, edited.
fn edited(edits: &[(&str, &str)]) -> String {
    let base = fs::read_to_string(root().join("tests/foreign/servo.eds")).unwrap();
    // A limit to damage.
    let base = base.replace("[6060]", "[6060]\nLowLimit=-128");
    edits.iter().fold(base, |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replace(from, to)
    })
}

/// Writes rig, scenario and drive to a folder.
fn bench(folder: &Path, sheet: &[u8]) -> PathBuf {
    for (from, to) in [
        ("tests/data/programs/rig.toml", "rig.toml"),
        ("tests/data/programs/drive.py", "drive.py"),
        ("tests/data/programs/fan.py", "fan.py"),
        ("python/canrig/node.py", "canrig_node.py"),
    ] {
        fs::copy(root().join(from), folder.join(to)).unwrap();
    }
    fs::write(folder.join("servo.eds"), sheet).unwrap();
    let scenario = folder.join("short.toml");
    let text = "schema = 1\nrig = \"rig.toml\"\nname = \"short\"\nduration_seconds = 0.05\n\
        [controller.open_loop]\n";
    fs::write(&scenario, text).unwrap();
    scenario
}

/// Returns exit code and words of `canrig check` of the rig.
fn checked(folder: &Path) -> (Option<i32>, String) {
    let mut check = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let check = check
        .arg("check")
        .arg(folder.join("rig.toml"))
        .env("NO_COLOR", "1");
    let (code, stdout, stderr) = output(check);
    (code, stdout + &stderr)
}

/// Returns exit code and words of a run in virtual time, and its log.
fn simulated(folder: &Path, scenario: &Path) -> (Option<i32>, String, String) {
    let runs = folder.join("runs");
    let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(scenario));
    let mut runs = fs::read_dir(&runs).into_iter().flatten();
    let log = runs.next().map(|run| run.unwrap().path().join("bus.log"));
    let log = log.map_or_else(String::new, |log| fs::read_to_string(log).unwrap());
    (code, stdout + &stderr, log)
}

#[test]
fn sheets_as_makers_write_them_pass_check_and_identity() {
    let mut failed = Vec::new();
    for (name, edits, encode) in SHAPES {
        let folder = tempfile::tempdir().unwrap();
        let scenario = bench(folder.path(), &encode(&edited(edits)));
        let (code, said) = checked(folder.path());
        if code != Some(0) {
            failed.push(format!("{name}: check: {said}"));
            continue;
        }
        let notes = said.lines().filter(|line| line.starts_with("note: "));
        let longest = notes.clone().map(|note| note.chars().count()).max();
        assert!(notes.count() <= 11 && longest < Some(300), "{name}: {said}");
        let (code, said, log) = simulated(folder.path(), &scenario);
        if code != Some(0) {
            failed.push(format!("{name}: {said}"));
        } else if !log.contains(" 620#40001000") && *name != "no device type" {
            failed.push(format!("{name}: the device type was not asked for"));
        }
    }
    assert!(SHAPES.len() >= 37, "{}", SHAPES.len());
    assert!(
        failed.is_empty(),
        "{} of {}:\n{}",
        failed.len(),
        SHAPES.len(),
        failed.join("\n")
    );
}

#[test]
fn slips_are_noted_with_their_line_and_the_rest_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    bench(folder.path(), &utf_8(&edited(&[])));
    let (code, said) = checked(folder.path());
    assert!(code == Some(0) && !said.contains("note: EDS"), "{said}");
    let sheet = edited(&[("PDOMapping=0", "PDOMapping=none")]);
    fs::write(folder.path().join("servo.eds"), sheet).unwrap();
    let (code, said) = checked(folder.path());
    assert_eq!(code, Some(0), "{said}");
    let notes = Vec::from_iter(said.lines().filter(|line| line.starts_with("note: EDS")));
    let first = "note: EDS of `drive`, line 48: [1000] PDOMapping=none: \"none\" is not a decimal number: it is ignored";
    assert_eq!(notes[0], first);
    assert_eq!(notes.len(), 11, "{said}");
    assert!(notes[10].ends_with(" more slips that do no harm"), "{said}");
}

#[test]
fn another_drive_is_still_refused() {
    let folder = tempfile::tempdir().unwrap();
    let sheet = edited(&[(VENDOR, BLANK), (PRODUCT, "DefaultValue=0x78")]);
    let scenario = bench(folder.path(), &utf_8(&sheet));
    let (code, said, _) = simulated(folder.path(), &scenario);
    assert_eq!(code, Some(1), "{said}");
    let said = Vec::from_iter(said.split_whitespace()).join(" ");
    assert!(
        said.contains("the node is not the drive of the EDS: Product code"),
        "{said}"
    );
}

#[test]
fn what_the_bench_needs_and_a_sheet_does_not_give_is_refused() {
    for (name, edits, message) in [
        (
            "no statusword",
            &[("[6041]", "[6041Unused]")][..],
            "the drive's EDS has no object 0x6041:00",
        ),
        (
            "no PDO",
            &[("[1400", "[140x")],
            "the drive's EDS describes no usable PDO at 0x1400",
        ),
        (
            "no such type",
            &[("DataType=0x0004", "DataType=long")],
            "0x2100:01 is no integer of 8, 16 or 32 bits",
        ),
        (
            "no such device",
            &[(PRODUCT, "DefaultValue=0x1000000077")],
            "so this is no device",
        ),
        (
            "two products",
            &[(PRODUCT, "DefaultValue=0x77\nDefaultValue=0x78")],
            "contradicts itself on the object 0x1018:02",
        ),
        (
            "two types",
            &[("[6041]", "[6041]\nDataType=5\n[6041]")],
            "contradicts itself on the object 0x6041:00",
        ),
        (
            "a command to read",
            &[(
                "0.1 mA\nObjectType=0x7\nDataType=0x0006\nAccessType=rw",
                "0.1 mA\nDataType=0x0006\nAccessType=ro",
            )],
            "0x2200:00 cannot take the command: by its EDS it can only be read (AccessType=ro, PDOMapping=1)",
        ),
        (
            "a constant command",
            &[(
                "0.1 mA\nObjectType=0x7\nDataType=0x0006\nAccessType=rw",
                "0.1 mA\nDataType=0x0006\nAccessType=const",
            )],
            "0x2200:00 cannot take the command",
        ),
        (
            "a command to send",
            &[(
                "0.1 mA\nObjectType=0x7\nDataType=0x0006\nAccessType=rw",
                "0.1 mA\nDataType=0x0006\nAccessType=rwr",
            )],
            "by its EDS it can only be sent by the drive",
        ),
        (
            "a command by SDO only",
            &[(
                "DefaultValue=0\nPDOMapping=1\n\n[2201]",
                "DefaultValue=0\nPDOMapping=0\n\n[2201]",
            )],
            "by its EDS no PDO can carry it (AccessType=rw, PDOMapping=0); name another object in `command`",
        ),
        (
            "no sheet",
            &[("[", "(")],
            "it describes no object: is it an EDS?",
        ),
    ] {
        let folder = tempfile::tempdir().unwrap();
        bench(folder.path(), &utf_8(&edited(edits)));
        let (code, said) = checked(folder.path());
        assert_eq!(code, Some(3), "{name}: {said}");
        let said = Vec::from_iter(said.split_whitespace())
            .join(" ")
            .replace("│ ", "");
        assert!(said.contains(message), "{name}: {said}");
    }
}
