use super::nodes::Rig;
use super::object_address;

/// Returns a rig with one real drive, and these keys in its node.
fn with(more: &str) -> String {
    format!(
        "schema = 1\nname = \"bench\"\n[node.controller]\nkind = \"controller\"\nnode_id = 1\n\
         [loop.position]\nfeedback = \"drive.position\"\noutputs = [\"drive.current\"]\n\
         [node.drive]\nkind = \"drive\"\nnode_id = 16\n\
         limits = {{ current_amperes = 0.9, min = -1.0, max = 45.0, rate_max = 400.0 }}\n{more}"
    )
}

fn messages(text: &str) -> Vec<String> {
    let error = Rig::parse(text, "rig.toml").expect_err("the rig file is broken");
    error.problems().iter().map(ToString::to_string).collect()
}

#[test]
fn what_is_left_out_is_as_with_the_emulated_drive() {
    let rig = Rig::parse(&with(""), "rig.toml").unwrap();
    let real = rig.real_drive("drive").unwrap();
    assert!(rig.node["drive"].external, "it has limits");
    assert_eq!(real.position.object, "0x6064");
    assert_eq!(rig.bus, crate::Bus::default());
}

#[test]
fn an_external_drive_needs_limits() {
    let limits = "limits = { current_amperes = 0.9, min = -1.0, max = 45.0, rate_max = 400.0 }";
    let text = with("").replace(limits, "external = true");
    assert_eq!(messages(&text), ["`drive` lacks its limits"]);
}

#[test]
fn all_that_makes_no_sense_is_reported_at_once() {
    let text = with(
        "eds = \"../other.eds\"\ncommand = { object = \"6071\" }\n\
         position = { increments_per_unit = 0.0 }\n[node.drive.timeouts]\ndrive_lost_milliseconds = 20\n",
    )
    .replace("min = -1.0", "min = 45.0");
    let expected = [
        "no position is within the limits",
        "the EDS must lie in the rig file's folder",
        "\"6071\" names no object",
        "a position that does not change with the load",
        "the drive is lost between two heartbeats",
    ];
    assert_eq!(messages(&text), expected);
}

#[test]
fn a_rig_of_one_drive_alone_is_a_rig() {
    let text = crate::rig::shipped::text("sma_pair").unwrap();
    let rig = Rig::parse(text, "rig.toml").unwrap();
    let real = Rig::parse(&with(""), "rig.toml")
        .unwrap()
        .real_drive("drive")
        .unwrap();
    let one = rig.loops.values().next().unwrap();
    let drive = one.drives().next().unwrap().to_owned();
    let alone = rig.with_one_drive(&drive, &real, []);
    let read = Rig::parse(&alone.to_toml(), "rig.toml").unwrap();
    assert_eq!(read.real_drive(&drive).unwrap().limits, real.limits);
    assert_eq!((read.node.len(), read.plant.len()), (2, 0));
}

/// The drive may also measure another signal than a position.
#[test]
fn a_rig_of_one_drive_alone_follows_what_that_measures() {
    let real = Rig::parse(&with(""), "rig.toml").unwrap();
    let mut rig = real.clone();
    let sensor = &mut rig.node.get_mut("drive").unwrap().sensor;
    sensor.get_or_insert_default().signal = Some("speed".to_owned());
    let alone = rig.with_one_drive("drive", &real.real_drive("drive").unwrap(), []);
    let read = Rig::parse(&alone.to_toml(), "rig.toml").unwrap();
    assert_eq!(read.loops.values().next().unwrap().feedback, "drive.speed");
}

#[test]
fn an_object_is_index_and_sub_index() {
    let address = |text: &str| object_address(text).ok();
    assert_eq!(address("0x6064"), Some((0x6064, 0)));
    assert_eq!(address("0x2345:0A"), Some((0x2345, 10)));
    for bad in [
        "",
        "6064",
        "0x606",
        "0x60640",
        "0x6064:",
        "0x6064:100",
        "0x+123",
        "0x6064:+1",
    ] {
        assert_eq!(address(bad), None, "{bad}");
    }
}
