//! Nodes in Python that misbehave in virtual time, beside faults of the scenario and without: the verdict names the node that is
//! the cause, and a replay says the same.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::support::{only_run, output, root};

const NEVER_HIT: &str = "0x7F0";

/// A play: what controller and drive do wrong (JSON; a node without is canrig's own), a fault, and the outcome with the node.
struct Case {
    name: &'static str,
    controller: Option<&'static str>,
    drive: Option<&'static str>,
    fault: String,
    outcome: [&'static str; 2],
}

fn case(
    name: &'static str,
    [controller, drive]: [Option<&'static str>; 2],
    fault: &str,
    outcome: [&'static str; 2],
) -> Case {
    Case {
        name,
        controller,
        drive,
        fault: fault.to_owned(),
        outcome,
    }
}

const PASS: [&str; 2] = ["pass", "-"];
const CONTROLLER: [&str; 2] = ["fail", "controller"];
const DRIVE: [&str; 2] = ["fail", "drive"];
const MUTE: &str = r#"{"mute_from": 2.0}"#;
const STOPS: &str = r#"{"acts": [{"at": 2.0, "id": "000", "data": "0210"}]}"#;

/// A fault of the bus from the start on that hits a frame of nobody, or touches none of the run.
fn idle_fault(kind: &str, keys: &str) -> String {
    format!("[[fault.bus.{kind}]]\nfrom_seconds = 0.0\n{keys}\n")
}

fn of_node(kind: &str, keys: &str) -> String {
    format!("[[fault.node.{kind}]]\nfrom_seconds = 0.0\nnode = \"drive\"\n{keys}\n")
}

#[expect(clippy::too_many_lines, reason = "a table")]
fn cases() -> Vec<Case> {
    let load = idle_fault("load", "identifier = 0x333\nperiod_milliseconds = 1000.0");
    let of_nobody = |kind, more: &str| {
        idle_fault(
            kind,
            &format!("sender = \"drive\"\nidentifier = {NEVER_HIT}\n{more}"),
        )
    };
    let duplicate = of_nobody("duplicate", "");
    let by = |wrong| [Some(wrong), None];
    let by_drive = |wrong| [None, Some(wrong)];
    let mut cases = vec![
        case("a sound controller", by("{}"), "", PASS),
        case("a sound controller beside a load", by("{}"), &load, PASS),
        case("a sound drive", by_drive("{}"), &duplicate, PASS),
        case("no frame beside a load", by(MUTE), &load, CONTROLLER),
        case(
            "each 3rd SYNC beside a load",
            by(r#"{"leaves_out_each_sync": 3}"#),
            &load,
            CONTROLLER,
        ),
        case(
            "each 3rd command beside a load",
            by(r#"{"leaves_out_each_command": 3}"#),
            &load,
            CONTROLLER,
        ),
        case(
            "no frame beside a bit error that never comes",
            by(MUTE),
            &idle_fault("bit_error", "probability = 0.0"),
            CONTROLLER,
        ),
        case(
            "no frame beside a frame that nobody loses",
            by(MUTE),
            &idle_fault("lose", "receiver = \"drive\"\nidentifier = 0x7F0"),
            CONTROLLER,
        ),
        case(
            "no frame 0.15 s after a load",
            by(r#"{"mute_from": 2.15}"#),
            SHORT_LOAD,
            CONTROLLER,
        ),
        case(
            "stops the drive beside a drift of 1 ppm",
            by(STOPS),
            &of_node("clock_drift", "parts_per_million = 1.0"),
            CONTROLLER,
        ),
        case(
            "stops the drive beside a slow one",
            by(STOPS),
            &of_node("slow_cycle", "delay_milliseconds = 5.0"),
            CONTROLLER,
        ),
        case(
            "a drive that a fault makes slow",
            by("{}"),
            &of_node("slow_cycle", "delay_milliseconds = 5.0"),
            PASS,
        ),
        case(
            "each 3rd SYNC beside a slow drive",
            by(r#"{"leaves_out_each_sync": 3}"#),
            &of_node("slow_cycle", "delay_milliseconds = 5.0"),
            CONTROLLER,
        ),
        case("stops the drive", by(STOPS), "", CONTROLLER),
        case(
            "no heartbeat before the controller crashes",
            by_drive(r#"{"heartbeat_until": 1.9}"#),
            CRASH,
            DRIVE,
        ),
        case("trips", by_drive(r#"{"trips_at": 2.0}"#), &duplicate, DRIVE),
        case(
            "switches off",
            by_drive(r#"{"switches_off_at": 2.0}"#),
            &duplicate,
            DRIVE,
        ),
        case(
            "boots again",
            by_drive(r#"{"boots_at": 2.0}"#),
            &duplicate,
            DRIVE,
        ),
        case(
            "a silent drive",
            by_drive(r#"{"mute_from": 2.0}"#),
            &duplicate,
            DRIVE,
        ),
        case(
            "each 150th position before the other is mute",
            [
                Some(r#"{"mute_from": 3.0}"#),
                Some(r#"{"leaves_out_each": 150}"#),
            ],
            "",
            CONTROLLER,
        ),
        case(
            "a boot-up in mid-run",
            by(r#"{"acts": [{"at": 2.0, "id": "701", "data": "00"}]}"#),
            "",
            CONTROLLER,
        ),
        case(
            "never a heartbeat",
            by(r#"{"heartbeat_until": -2.0, "watch_milliseconds": 1000}"#),
            "",
            CONTROLLER,
        ),
        case(
            "stops the io node that is to disturb",
            by(r#"{"acts": [{"at": 2.0, "id": "000", "data": "0211"}]}"#),
            "[[disturbance.load]]\nat_seconds = 2.5\nadded_grams = 1000.0\n",
            CONTROLLER,
        ),
        case("a flood", by(r#"{"floods_from": 2.0}"#), "", CONTROLLER),
        case(
            "a flood late in the run",
            by(r#"{"floods_from": 2.6}"#),
            "",
            CONTROLLER,
        ),
        case(
            "a counter that goes back beside a slow drive",
            by(r#"{"counter_steps_back_each": 50}"#),
            &of_node("slow_cycle", "delay_milliseconds = 5.0"),
            CONTROLLER,
        ),
        case(
            "commands that a gateway sends after the next frame",
            by("{}"),
            &idle_fault(
                "reorder",
                "sender = \"controller\"\nidentifier = 0x210\nprobability = 0.5",
            ),
            PASS,
        ),
        case(
            "SYNCs that a gateway sends twice",
            by("{}"),
            &idle_fault("duplicate", "sender = \"controller\"\nidentifier = 0x080"),
            PASS,
        ),
        case(
            "positions held up after a drive that hung",
            by("{}"),
            HANG_AND_DELAY,
            PASS,
        ),
        case(
            "no frame after an NMT stop that it did not obey",
            by(MUTE),
            "[[fault.node.nmt_stop]]\nat_seconds = 1.2\nnode = \"controller\"\n",
            CONTROLLER,
        ),
        case(
            "no frame a second after its drive tripped by a fault",
            by(r#"{"mute_from": 3.2}"#),
            "[[fault.amplifier.dead]]\nfrom_seconds = 0.8\nuntil_seconds = 2.0\n",
            CONTROLLER,
        ),
        case(
            "heartbeats each 60 ms, watched for 50",
            by(r#"{"watch_milliseconds": 50, "beats_each": 3}"#),
            "",
            CONTROLLER,
        ),
        case(
            "writes another heartbeat time",
            by(r#"{"acts": [{"at": 2.0, "id": "610", "data": "2B17100032000000"}]}"#),
            "",
            PASS,
        ),
        case(
            "unmaps the position",
            by(r#"{"acts": [{"at": 2.0, "id": "610", "data": "2300180190010080"}]}"#),
            "",
            CONTROLLER,
        ),
        case(
            "a counter that goes back each 50 cycles",
            by(r#"{"counter_steps_back_each": 50}"#),
            "",
            CONTROLLER,
        ),
    ];
    for kind in ["corrupt", "reorder"] {
        cases.push(case(
            "no frame beside a frame of nobody",
            by(MUTE),
            &of_nobody(kind, ""),
            CONTROLLER,
        ));
    }
    cases
}

const SHORT_LOAD: &str = "[[fault.bus.load]]\nfrom_seconds = 1.9\nuntil_seconds = 2.0\nidentifier = 0x333\nperiod_milliseconds = 10.0\n";
const HANG_AND_DELAY: &str = "[[fault.node.hang]]\nfrom_seconds = 0.4\nuntil_seconds = 0.6\nnode = \"drive\"\n\
    [[fault.bus.delay]]\nfrom_seconds = 2.4\nuntil_seconds = 3.4\nsender = \"drive\"\n\
    delay_milliseconds = 13.9\nidentifier = 0x190\nprobability = 0.1\n";
const CRASH: &str =
    "[[fault.node.crash]]\nfrom_seconds = 2.0\nuntil_seconds = 2.3\nnode = \"controller\"\n";

/// The controller that `canrig new controller` writes, without the line that starts it.
pub(crate) fn controller_base(place: &Path) -> String {
    let mut new = Command::new(env!("CARGO_BIN_EXE_canrig"));
    new.args(["new", "controller", "base", "--language", "python"]);
    let (code, stdout, stderr) = output(new.current_dir(place));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
    let base = fs::read_to_string(place.join("base/controller.py")).unwrap();
    base.replace("Controller.run()\n", "")
}

/// Mistakes of controller and drive, as JSON; a node without an entry is canrig's own.
pub(crate) type Wrong<'a> = [Option<&'a str>; 2];

/// Plays a scenario with these nodes and faults in a folder of its own, and returns outcome, node and reason, each also as a
/// replay says it.
pub(crate) fn play(
    folder: &Path,
    base: &str,
    [controller, drive]: Wrong<'_>,
    faults: &str,
) -> [(Vec<String>, String); 2] {
    fs::create_dir(folder).unwrap();
    write(folder, base, [controller, drive], faults);
    let mut play = Command::new(env!("CARGO_BIN_EXE_canrig"));
    play.args(["simulate", "scenario.toml", "--quiet", "--output", "runs"]);
    play.env("CONTROLLER", controller.unwrap_or("{}"));
    play.env("DRIVE", drive.unwrap_or("{}"));
    let (_, stdout, stderr) = output(play.current_dir(folder));
    let runs = folder.join("runs");
    assert!(runs.exists(), "{stdout}{stderr}");
    let run = only_run(&runs);
    let verdict = found(&fs::read_to_string(run.join("verdict.json")).unwrap());
    let mut replay = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let (_, again, _) = output(replay.args(["replay", "--json"]).arg(&run));
    [verdict, found(&again)]
}

/// Writes the programs and the scenario into a folder.
fn write(folder: &Path, base: &str, [controller, drive]: Wrong<'_>, faults: &str) {
    let read = |path: &str| fs::read_to_string(root().join(path)).unwrap();
    let seats = "tests/misbehaving/seats";
    let law = base.to_owned() + &read(&format!("{seats}/controller_misbehaviour.py"));
    let servo = read("tests/data/programs/drive.py").replace("Drive.run()\n", "")
        + &read(&format!("{seats}/drive_misbehaviour.py"));
    for (name, text) in [
        ("controller.py", law),
        ("drive.py", servo),
        ("canrig_node.py", read("python/canrig/node.py")),
        ("servo.eds", read("tests/foreign/servo.eds")),
        ("rig.toml", read(&format!("{seats}/rig.toml"))),
    ] {
        fs::write(folder.join(name), text).unwrap();
    }
    let rig = drive.map_or("dc_motor", |_| "rig.toml");
    let leads = match controller {
        Some(_) => "[node.controller]\nprogram = [\"python3\", \"controller.py\"]",
        None => "[controller.open_loop]",
    };
    let text = format!(
        "schema = 1\nrig = \"{rig}\"\nname = \"m\"\nduration_seconds = 4.0\n[bus]\nsync_period_milliseconds = 10.0\n{leads}\n{faults}\
         [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\
         [[reference.step]]\nat_seconds = 1.0\nposition_millimetres = 15.0\n\
         [expect]\nposition_millimetres_max = {{ max = 5000.0 }}\n"
    );
    fs::write(folder.join("scenario.toml"), text).unwrap();
}

/// Outcome and cause in a verdict, and its reason.
fn found(text: &str) -> (Vec<String>, String) {
    let verdict: Value = serde_json::from_str(text).unwrap_or_else(|_| panic!("{text}"));
    let word = |value: &Value| value.as_str().unwrap_or("-").to_owned();
    let both = [&verdict["outcome"], &verdict["cause"]["node"]].map(word);
    (both.into(), word(&verdict["reason"]))
}

#[test]
fn the_guilty_one_is_named_beside_faults_too() {
    let place = tempfile::tempdir().unwrap();
    let base = controller_base(place.path());
    let mut differences = Vec::new();
    for (number, case) in cases().iter().enumerate() {
        let folder = place.path().join(number.to_string());
        let wrong = [case.controller, case.drive];
        let [verdict, again] = play(&folder, &base, wrong, &case.fault);
        if verdict.0 != case.outcome || again != verdict {
            differences.push(format!("{}: {verdict:?}, again {again:?}", case.name));
        }
    }
    assert!(differences.is_empty(), "{}", differences.join("\n"));
}
