use miette::{GraphicalReportHandler, GraphicalTheme};

use super::{ObjectAddress, RigFile};

/// The least valid rig file, with `more` behind it.
fn with(more: &str) -> String {
    format!(
        "schema = 1\nname = \"bench\"\n[limits]\ncurrent_amperes = 0.9\n\
         position_millimetres = {{ min = -1.0, max = 45.0 }}\nspeed_millimetres_per_second = 400.0\n{more}"
    )
}

fn messages(text: &str) -> Vec<String> {
    let error = RigFile::parse(text, "rig.toml").expect_err("the rig file is broken");
    error.problems().iter().map(ToString::to_string).collect()
}

#[test]
fn what_is_left_out_is_as_with_the_emulated_drive() {
    let rig = RigFile::parse(&with(""), "rig.toml").unwrap();
    assert_eq!(rig.drive.node_id, 16);
    assert_eq!(rig.drive.position.object, "0x6064");
    assert_eq!(rig.bus.of_scenario(), crate::Bus::default());
    assert!(RigFile::is_meant(&with("")) && !RigFile::is_meant("[controller.pid]\n"));
}

#[test]
fn limits_must_be_given() {
    assert_eq!(
        messages("schema = 1\nname = \"bench\"\n"),
        ["the rig file lacks the key `limits`"]
    );
}

#[test]
fn an_error_underlines_its_place() {
    let error = RigFile::parse(&with("[drive]\nnode_id = 17\n"), "rig.toml").unwrap_err();
    let handler =
        GraphicalReportHandler::new_themed(GraphicalTheme::unicode_nocolor()).with_width(110);
    let mut text = String::new();
    handler.render_report(&mut text, &error).unwrap();
    for part in [
        "rig.toml is not a valid rig file",
        "node-ID 17 is taken",
        "node_id = 17",
        "drive, and fan and load module, have the same",
    ] {
        assert!(text.contains(part), "{part} is not in\n{text}");
    }
    assert_eq!(error.problems()[0].line_and_column(), Some((8, 11)));
}

#[test]
fn all_that_makes_no_sense_is_reported_at_once() {
    let text = with(
        "[drive]\neds = \"../other.eds\"\ncommand = { object = \"6071\" }\n\
         position = { units_per_millimetre = 0.0 }\n[timeouts]\ndrive_lost_milliseconds = 20\n",
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
fn an_object_is_index_and_sub_index() {
    let address = |text: &str| {
        let parsed = text.parse::<ObjectAddress>();
        parsed
            .map(|address| (address.index, address.sub_index))
            .ok()
    };
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

#[test]
fn the_committed_schema_is_current() {
    crate::schema::assert_committed("rig_schema.json", &crate::schema::rig_json_schema());
}
