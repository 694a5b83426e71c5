//! Tests of rig files with external drives.

use scenario::rig::nodes::Rig;

const RIG: &str = r#"
schema = 1
name = "a bench"

[plant.wire.sma]

[node.controller]
kind = "controller"
node_id = 1

[node.real]
kind = "drive"
node_id = 0x30
external = true
mode_of_operation = -1
amplifier.port = "wire.current_amperes"
command = { object = "0x2200", units_per_ampere = 10000.0 }

[node.real.limits]
current_amperes = 0.9
min = -1.0
max = 45.0
rate_max = 400.0

[loop.lift]
feedback = "real.position"
outputs = ["real.current"]
"#;
const FAN: &str = "\n[node.fan]\nkind = \"io\"\nnode_id = 17\noutputs.convection_factor = \"wire.convection_factor\"\n";

fn refused(text: &str) -> String {
    let Err(error) = Rig::parse(text, "rig.toml") else {
        panic!("a wrong rig is read");
    };
    format!("{:?}", miette::Report::new(error))
}

#[test]
fn an_external_drive_is_described_by_its_node() {
    let rig = Rig::parse(RIG, "rig.toml").unwrap();
    let real = rig.real_drive("real").unwrap();
    assert_eq!((real.node_id, real.mode_of_operation), (0x30, -1));
    assert_eq!(real.command.object, "0x2200");
    assert_eq!(real.position.object, "0x6064");
    assert!(rig.real_drive("controller").is_none());
    // It needs no plant: no drive emulates it.
    let alone = RIG
        .replace("[plant.wire.sma]", "")
        .replace("amplifier.port = \"wire.current_amperes\"", "");
    Rig::parse(&alone, "rig.toml").unwrap();
}

#[test]
fn what_an_external_drive_needs_and_others_cannot_have_is_named() {
    let without = |table: &str| {
        let start = RIG.find(table).unwrap();
        let end = RIG[start..].find("[loop").unwrap() + start;
        RIG[..start].to_owned() + &RIG[end..]
    };
    for (text, message) in [
        (without("[node.real.limits]"), "`real` lacks its limits"),
        (
            RIG.replace("node_id = 1\n", "node_id = 1\nexternal = true\n"),
            "controller is canrig's",
        ),
        (
            RIG.replace("\"0x2200\"", "\"2200\""),
            "\"2200\" names no object",
        ),
        (
            RIG.replace("min = -1.0", "min = 50.0"),
            "no position is within the limits",
        ),
        (
            RIG.replace("external = true", "external = true\neds = \"../servo.eds\""),
            "the EDS must lie in the rig file's folder",
        ),
        (RIG.to_owned() + FAN, "which nobody emulates"),
        (
            RIG.replace("= -1\n", "= 8\n"),
            "mode 8, cyclic synchronous position, is not served yet",
        ),
        (
            RIG.replace("= -1\n", "= 9\n"),
            "mode 9, cyclic synchronous velocity, is not served yet",
        ),
        (RIG.replace("= -1\n", "= 1\n"), "mode 1, profile position"),
        (RIG.replace("= -1\n", "= 3\n"), "mode 3, profile velocity"),
        (
            RIG.replace("= -1\n", "= 7\n"),
            "mode 7, interpolated position",
        ),
        (
            RIG.replace("= -1\n", "= 12\n"),
            "mode 12, which CiA 402 reserves",
        ),
        (
            RIG.replace("0x2200", "0x607A"),
            "\"0x607A\" is the target position of a drive",
        ),
        (
            RIG.replace("0x2200", "0x60FF"),
            "\"0x60FF\" is the target velocity of a drive",
        ),
        (
            RIG.replace("0x2200", "0x607a:00"),
            "\"0x607a:00\" is the target position of a drive",
        ),
        // The second axis.
        (
            RIG.replace("0x2200", "0x68FF"),
            "\"0x68FF\" is the target velocity of a drive",
        ),
        (
            without("[node.real.limits]")
                .replace("external = true", "")
                .replace("0x30", "0x13"),
            "`real` can have no mode_of_operation",
        ),
    ] {
        let refused = refused(&text);
        assert!(refused.contains(message), "{message} in {refused}");
    }
    Rig::parse(&(RIG.to_owned() + FAN + "external = true\n"), "rig.toml").unwrap();
    for torque in ["= 4\n", "= 10\n", "= 11\n", "= -128\n"] {
        Rig::parse(&RIG.replace("= -1\n", torque), "rig.toml").unwrap();
    }
    let refused = refused(&RIG.replace("= -1\n", "= 8\n"));
    let words = Vec::from_iter(refused.split_whitespace()).join(" ");
    assert!(words.contains("mode_of_operation = 8"), "{refused}");
    assert!(
        words.contains("mode_of_operation = 10, cyclic synchronous torque"),
        "{refused}"
    );
}
