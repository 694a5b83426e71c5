//! Tests of the `[fault]` table in the loader.

use std::collections::BTreeSet;

use super::*;
use crate::Trial;
use dbc::Quantities;

fn parse(tables: &str) -> Result<Trial, Vec<String>> {
    let text = format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 9.0\n[controller.pid]\n[[reference.hold]]\n\
         at_seconds = 0.0\nposition_millimetres = 10.0\n{tables}"
    );
    let parsed = Trial::parse(&text, "t.toml", |_| unreachable!("no table"));
    parsed.map_err(|error| error.problems().iter().map(ToString::to_string).collect())
}

/// Returns the smallest table of a kind.
fn least(kind: &Kind) -> String {
    let times = match kind.time {
        Time::Lasts => "from_seconds = 0.0\n",
        Time::Ends => "from_seconds = 0.0\nuntil_seconds = 1.0\n",
        Time::Instant => "at_seconds = 0.0\n",
        Time::Boot => "",
    };
    let required = kind
        .keys
        .iter()
        .filter(|key| matches!(key.need, Need::Required));
    let values = required.map(|key| match key.form {
        Form::Number(min, _) => format!("{} = {:.1}\n", key.name, min.max(0.0)),
        Form::Whole(min, _) => format!("{} = {min}\n", key.name),
        Form::Word(words) => format!("{} = \"{}\"\n", key.name, words[0].0),
        Form::Node | Form::Station => format!("{} = \"controller\"\n", key.name),
    });
    let values = Quantities::default().name(&values.collect::<String>());
    format!("{}\n{times}{values}", kind.heading())
}

#[test]
fn every_kind_is_read_with_its_name() {
    assert!(KINDS.len() >= 31, "{} kinds", KINDS.len());
    for kind in KINDS {
        let table = least(kind);
        let scenario = parse(&table).unwrap_or_else(|problems| panic!("{table}: {problems:?}"));
        let faults = Vec::from_iter(scenario.run.faults.iter());
        assert_eq!(faults.len(), 1, "{table}");
        assert_eq!(faults[0].kind.name, kind.name);
        let is_behind_the_drive = ![Group::Bus, Group::Node].contains(&kind.group);
        assert_eq!(
            kind.touch == Touch::Nothing,
            is_behind_the_drive || kind.name == "duplicate",
            "{table}"
        );
    }
}

#[test]
fn every_kind_says_where_it_acts_or_its_group_does() {
    for kind in KINDS {
        let is_said = |text: &str| text.contains("bus.log");
        assert!(
            is_said(kind.text) || is_said(kind.group.text()),
            "{}",
            kind.name
        );
    }
}

#[test]
fn what_makes_no_sense_is_refused() {
    let cases = [
        (
            "[[fault.sensor.stuk]]\nfrom_seconds = 1.0\n",
            "unknown key `stuk` in [fault.sensor]",
        ),
        (
            "[fault.sensor.stuck]\nfrom_seconds = 1.0\n",
            "`fault.sensor.stuck` must be an array of tables",
        ),
        (
            "[fault.sensor]\nstuck = [3]\n",
            "`fault.sensor.stuck` must be a table",
        ),
        (
            "[[fault.sensor.stuck]]\nfrom_seconds = 2.0\nuntil_seconds = 1.0\n",
            "[[fault.sensor.stuck]] ends before it begins",
        ),
        (
            "[[fault.sensor.stuck]]\nfrom_seconds = inf\nuntil_seconds = 1.0\n",
            "`fault.sensor.stuck.from_seconds` must be finite",
        ),
        (
            "[[fault.node.restart]]\nat_seconds = 9.0\nnode = \"drive\"\n",
            "[[fault.node.restart]] starts after the end of the run",
        ),
        (
            "[[fault.node.hang]]\nfrom_seconds = 1.0\nnode = \"wheel\"\n",
            "the rig has no node `wheel`",
        ),
        (
            "[[fault.bus.lose]]\nfrom_seconds = 1.0\nreceiver = \"drive\"\nprobability = 1.5\n",
            "`fault.bus.lose.probability` = 1.5 is out of range",
        ),
        (
            "[[fault.amplifier.stuck_on]]\nfrom_seconds = 1.0\ncurrent_amperes = 1.5\n",
            "`fault.amplifier.stuck_on.current_amperes` = 1.5 is out of range",
        ),
        (
            "[[fault.amplifier.saturated]]\nfrom_seconds = 1.0\ncurrent_amperes_max = 1.5\n",
            "`fault.amplifier.saturated.current_amperes_max` = 1.5 is out of range",
        ),
        (
            "[[fault.plant.ageing]]\nfrom_seconds = 1.0\n",
            "ageing needs an end, at which its factors are reached",
        ),
        (
            "[[fault.bus.babble]]\nfrom_seconds = 1.0\nidentifier = 0x6B0\n",
            "no foreign node may forge what the plant says of itself",
        ),
        (
            "[expect]\nsafe_state = true\n",
            "`safe_state` cannot be judged",
        ),
        (
            "[[fault.sensor.stuck]]\nfrom_seconds = 1.0\n[expect]\nemcy = [\"drive 8130\"]\n",
            "\"drive 8130\" names no emergency",
        ),
        (
            "[[fault.sensor.stuck]]\nfrom_seconds = 1.0\n[expect]\nemcy = 1\n",
            "`expect.emcy` must be an array of strings",
        ),
    ];
    for (tables, expected) in cases {
        assert_eq!(parse(tables).unwrap_err(), [expected]);
    }
}

#[test]
fn kinds_have_different_names() {
    let names: BTreeSet<_> = KINDS.iter().map(|kind| kind.name).collect();
    assert_eq!(names.len(), KINDS.len());
}
