//! Draws faults. The draws cover all kinds, with parameters from harmless to severe (chosen, not measured).

use canopen::nmt::ERROR_CONTROL_ID;
use dbc::scenario_clock::SYNC_COB_ID;
use faults::Stream;
use plan::{ControlLoop, Plan};
use scenario::fault::{Drawn, Group, KINDS, Kind, Time};
use scenario::wiring::Wiring;
use toml::{Table, Value};

/// Largest number of faults in a mix.
const FAULTS_MAX: u64 = 4;

/// Probability of a fault of the boot in a mix: many such runs never begin.
const BOOT_PROBABILITY: f64 = 0.1;

/// Nodes of a plan, which can fail.
pub(super) struct Nodes<'a>(pub(super) &'a Plan);

/// Returns whether a kind of fault has a meaning for a loop's plant.
fn has(one: &ControlLoop, kind: &Kind) -> bool {
    kind.group != Group::Plant || one.trial.plant().faults().contains(&kind.name)
}

impl Nodes<'_> {
    fn nodes(&self) -> Vec<&str> {
        let drives = self.0.loops.iter().map(|one| one.drive().name.as_str());
        [self.0.controller().name.as_str()]
            .into_iter()
            .chain(drives)
            .collect()
    }

    /// Returns the nodes that have a CAN controller.
    fn stations(&self) -> Vec<&str> {
        self.nodes().into_iter().chain([BENCH]).collect()
    }

    /// Returns the identifiers of the frames that a fault hits for preference: SYNC, TPDO1, RPDO1, heartbeats.
    fn identifiers(&self) -> Vec<u32> {
        let of = |base: u32| {
            let loops = self.0.loops.iter();
            loops.map(move |one| base + u32::from(one.drive().id()))
        };
        let pdos = of(0x180).chain(of(0x200));
        [u32::from(SYNC_COB_ID)]
            .into_iter()
            .chain(pdos)
            .chain([u32::from(ERROR_CONTROL_ID) + u32::from(self.0.controller().id())])
            .chain(of(ERROR_CONTROL_ID.into()))
            .collect()
    }

    /// Returns a drawn node-ID, or the next one that no node has.
    fn free(&self, drawn: Value) -> Value {
        let first = drawn.as_integer().unwrap_or_default();
        let taken = |id: &i64| {
            let mut loops = self.0.loops.iter();
            loops.any(|one| i64::from(one.drive().id()) == *id)
        };
        let mut candidates = (first..=127).chain(FREE_NODE_ID_MIN.into()..first);
        candidates.find(|id| !taken(id)).unwrap_or(first).into()
    }

    /// Returns the largest identifier below those with which plants publish the truth, which no node may forge.
    fn below_truth(&self) -> u32 {
        let loops = self.0.loops.iter();
        let lowest = loops.map(|one| one.trial.wiring.identifiers.truth).min();
        u32::from(lowest.unwrap_or_default()) - 1
    }

    /// Adapts a fault to its drive: names of positions, heights for its travel, and sizes for its amplifier.
    fn in_unit(&self, fault: Table) -> Table {
        // With a single drive, a fault need not name it.
        let name = fault.get("node").and_then(Value::as_str);
        let mut loops = self.0.loops.iter();
        let named = loops.find(|one| name.is_none_or(|name| name == one.drive().name));
        let Some(wiring) = named.map(|one| &one.trial.wiring) else {
            return fault;
        };
        // Heights are drawn for the travel of the default rig.
        let [travel, shipped] = [wiring, &Wiring::default()].map(|wiring| {
            let [min, max] = wiring.sensor.range();
            max - min
        });
        let travels = travel / shipped;
        let for_drive = |(key, value): (String, Value)| match value {
            Value::Float(height) if key.contains("{unit}") => (
                wiring.drive_quantities().name(&key),
                (height * travels).into(),
            ),
            Value::Float(current) if key.contains("{command_unit}") => {
                let key = wiring.drive_quantities().name(&key);
                (key, (current * wiring.amplifier.range().max).into())
            }
            value => (key, value),
        };
        fault.into_iter().map(for_drive).collect()
    }

    /// Returns the kinds that have a meaning for one of the drives: those of the boot, or all others.
    fn kinds(&self, is_of_boot: bool) -> Vec<&'static Kind> {
        let is_able = |kind: &&Kind| self.0.loops.iter().any(|one| has(one, kind));
        let kinds = KINDS.iter().filter(is_able);
        kinds
            .filter(|kind| (kind.time == Time::Boot) == is_of_boot)
            .collect()
    }

    /// Draws the drive whose part fails; `None` if the only drive needs no name.
    fn draw(&self, stream: &mut Stream, kind: &Kind) -> Option<Value> {
        let able = Vec::from_iter(self.0.loops.iter().filter(|one| has(one, kind)));
        match able.as_slice() {
            [_] if self.0.loops.len() == 1 => None,
            able => Some(pick(stream, able).drive().name.clone().into()),
        }
    }
}

/// Name of canrig's own node.
const BENCH: &str = "bench";

/// Smallest node-ID that is drawn for a node that is not on the bus.
const FREE_NODE_ID_MIN: u32 = 0x20;

/// Returns the kinds that are drawn, each with its group: `bus.lose`.
pub(super) fn kinds(nodes: &Nodes<'_>) -> Vec<String> {
    let kinds = [false, true]
        .map(|is_of_boot| nodes.kinds(is_of_boot))
        .into_iter()
        .flatten();
    kinds
        .map(|kind| format!("{}.{}", kind.group.name(), kind.name))
        .collect()
}

/// Fault of a mix.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DrawnFault {
    /// Name of its group.
    pub(super) group: &'static str,
    /// Name of its kind.
    pub(super) kind: &'static str,
    /// Its table in a scenario.
    pub(super) table: Table,
}

/// Draws a mix of faults for a run, as far as they have a meaning for the plants. Those of a group, and in it those of a kind,
/// follow each other.
pub(super) fn mix(stream: &mut Stream, nodes: &Nodes<'_>) -> Vec<DrawnFault> {
    let duration_seconds = nodes.0.shared.run.duration_seconds;
    let (kinds, of_boot) = (nodes.kinds(false), nodes.kinds(true));
    let mut faults = Vec::new();
    for _ in 0..1 + stream.below(FAULTS_MAX) {
        let kind = *pick(stream, &kinds);
        let mut fault = parameters(stream, nodes, kind);
        let from = tenth_milliseconds(stream.uniform() * 0.8 * duration_seconds);
        if kind.time == Time::Instant {
            fault.insert("at_seconds".to_owned(), from.into());
        } else {
            fault.insert("from_seconds".to_owned(), from.into());
            if kind.time == Time::Ends || stream.happens(0.8) {
                // Short faults are as likely as long ones.
                let length = 1e-3 * libm::pow(duration_seconds * 1e3, stream.uniform());
                let until = tenth_milliseconds(from + length.max(1e-3));
                fault.insert("until_seconds".to_owned(), until.into());
            }
        }
        push(&mut faults, kind, nodes.in_unit(fault));
    }
    if stream.happens(BOOT_PROBABILITY) {
        let kind = *pick(stream, &of_boot);
        let fault = parameters(stream, nodes, kind);
        push(&mut faults, kind, fault);
    }
    faults
}

fn push(faults: &mut Vec<DrawnFault>, kind: &Kind, table: Table) {
    let (group, kind) = (kind.group.name(), kind.name);
    let of_kind = faults.iter().rposition(|other| other.kind == kind);
    let last = of_kind.or_else(|| faults.iter().rposition(|other| other.group == group));
    let place = last.map_or(faults.len(), |last| last + 1);
    faults.insert(place, DrawnFault { group, kind, table });
}

/// Draws the keys of a kind other than those of its time.
fn parameters(stream: &mut Stream, nodes: &Nodes<'_>, kind: &Kind) -> Table {
    let mut table = Table::new();
    if kind.time == Time::Boot && kind.is_drive_fault() {
        set_drive(&mut table, stream, nodes, kind);
    }
    for key in kind.keys {
        if let Some(value) = drawn(stream, nodes, key.drawn) {
            table.insert(key.name.to_owned(), value);
        }
    }
    if kind.time != Time::Boot && kind.is_drive_fault() {
        set_drive(&mut table, stream, nodes, kind);
    }
    table
}

fn set_drive(table: &mut Table, stream: &mut Stream, nodes: &Nodes<'_>, kind: &Kind) {
    if let Some(drive) = nodes.draw(stream, kind) {
        table.insert("node".to_owned(), drive);
    }
}

/// Draws the value of a key; `None` if it is left out this time.
fn drawn(stream: &mut Stream, nodes: &Nodes<'_>, drawn: Drawn) -> Option<Value> {
    Some(match drawn {
        Drawn::Between(lowest, highest) => between(stream, lowest, highest),
        Drawn::Whole(lowest, highest) => whole(stream, lowest, highest),
        Drawn::Identifier if stream.happens(0.7) => (*pick(stream, &nodes.identifiers())).into(),
        Drawn::Foreign(lowest) => whole(stream, lowest, nodes.below_truth()),
        Drawn::FreeNodeId => nodes.free(whole(stream, FREE_NODE_ID_MIN, 127)),
        Drawn::Node => (*pick(stream, &nodes.nodes())).into(),
        Drawn::PerhapsStation if stream.happens(0.5) => None?,
        Drawn::Station | Drawn::PerhapsStation => (*pick(stream, &nodes.stations())).into(),
        Drawn::Word(word) if stream.happens(0.3) => word.into(),
        Drawn::Identifier | Drawn::Word(_) => None?,
    })
}

fn pick<'a, T>(stream: &mut Stream, choices: &'a [T]) -> &'a T {
    let place = usize::try_from(stream.below(choices.len() as u64)).unwrap_or_default();
    &choices[place]
}

fn between(stream: &mut Stream, lowest: f64, highest: f64) -> Value {
    Value::Float(lowest + (highest - lowest) * stream.uniform())
}

fn whole(stream: &mut Stream, lowest: u32, highest: u32) -> Value {
    let drawn = stream.below(u64::from(highest - lowest) + 1);
    Value::Integer(i64::from(lowest) + i64::try_from(drawn).unwrap_or_default())
}

fn tenth_milliseconds(seconds: f64) -> f64 {
    libm::round(seconds * 1e4) / 1e4
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;

    use scenario::Beside;
    use worlds::catalogue::catalogue;

    use super::*;
    use crate::torture::shrink::TortureCase;

    const BASE: &str = "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 2.0\n[controller.pid]\n\
        proportional_amperes_per_metre = 22.8\nintegral_amperes_per_metre_second = 37.9\n\
        derivative_ampere_seconds_per_metre = 3.59\n[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";

    fn base(text: &str) -> Plan {
        let beside = Beside::new(Path::new("t.toml"));
        Plan::parse_beside(&beside, text.to_owned(), catalogue()).unwrap()
    }

    fn mix_of(base: &Plan, seed: u64) -> Vec<DrawnFault> {
        mix(&mut Stream::new(seed), &Nodes(base))
    }

    #[test]
    fn every_mix_is_valid_and_all_kinds_are_drawn() {
        let base = base(BASE);
        let mut drawn = BTreeSet::new();
        for seed in 0..1000 {
            let case = TortureCase::new(&base, mix_of(&base, seed), seed);
            let plan = case.plan().unwrap_or_else(|problems| panic!("{problems}"));
            let scenario = &plan.only_loop().unwrap().trial;
            let kinds = Vec::from_iter(scenario.run.faults.iter().map(|fault| fault.kind.name));
            assert!((1..=5).contains(&kinds.len()));
            drawn.extend(kinds);
        }
        assert_eq!(drawn.len(), KINDS.len(), "a kind is not drawn");
    }

    #[test]
    fn a_plant_meets_no_fault_that_means_nothing_to_it() {
        let base = base(&BASE.replace("sma_actuator", "dc_motor"));
        let mut drawn = BTreeSet::new();
        for seed in 0..300 {
            let case = TortureCase::new(&base, mix_of(&base, seed), seed);
            let plan = case.plan().unwrap_or_else(|problems| panic!("{problems}"));
            let scenario = &plan.only_loop().unwrap().trial;
            drawn.extend(scenario.run.faults.iter().map(|fault| fault.kind.name));
        }
        assert!(drawn.contains("dropped_load") && !drawn.contains("ageing"));
    }

    #[test]
    fn a_drive_in_another_unit_meets_faults_in_that_unit() {
        let rig = include_str!("../../../../scenarios/rigs/dc_motor.toml");
        let sensor = |line: &&str| line.starts_with("sensor = ");
        let in_metres = "sensor = { port = \"motor.position_metres\", unit = \"metres\", min = 0.0, max = 0.06, resolution_bits = 16, position_increment = 1e-6 }";
        let rig = rig.replace(rig.lines().find(sensor).unwrap(), in_metres);
        let text = BASE
            .replace("sma_actuator", "rig.toml")
            .replace("position_millimetres = 10.0", "position_metres = 0.01");
        let beside = Beside::default();
        let base = Plan::parse(&beside, text, |_| Ok(rig.clone()), catalogue())
            .unwrap_or_else(|error| panic!("{error:?}"));
        for seed in 0..100 {
            let case = TortureCase::new(&base, mix_of(&base, seed), seed);
            let problems = case.plan().err();
            assert!(problems.is_none(), "{}", problems.unwrap());
        }
    }

    #[test]
    fn a_seed_gives_one_mix() {
        let base = base(BASE);
        let draw = |seed| mix_of(&base, seed);
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2));
    }

    /// Rig of two drives, one of a wire and one of a motor, with a node-ID among those that are drawn.
    fn wire_and_motor() -> Plan {
        let rig = include_str!("../../../../scenarios/rigs/two_axes.toml")
            .replacen(".dc_motor]", ".sma]", 1)
            .replace("node_id = 0x12", "node_id = 0x20")
            .replace("min = -1.0", "min = 0.0");
        let text = BASE
            .replace("sma_actuator", "rig.toml")
            .replace("[controller.pid]", "[controller.all.pid]")
            .replace("[[reference.hold]]", "[[reference.hold]]\nloop = \"x\"")
            + "[[reference.hold]]\nloop = \"y\"\nat_seconds = 0.0\nposition_millimetres = 10.0\n";
        Plan::parse(&Beside::default(), text, |_| Ok(rig.clone()), catalogue())
            .unwrap_or_else(|error| panic!("{error:?}"))
    }

    #[test]
    fn a_drive_is_named_unless_it_is_the_only_one() {
        let kind = |name: &str| KINDS.iter().find(|kind| kind.name == name).unwrap();
        let named = |base: &Plan, name: &str| {
            let name = Nodes(base).draw(&mut Stream::new(1), kind(name))?;
            Some(name.as_str().unwrap().to_owned())
        };
        let (one, two) = (base(BASE), wire_and_motor());
        assert_eq!(named(&one, "ageing"), None);
        assert_eq!(named(&two, "ageing").as_deref(), Some("x"), "y has no wire");
        assert!(["x", "y"].contains(&&*named(&two, "stuck").unwrap()));
    }

    #[test]
    fn what_nobody_has_and_may_forge_is_drawn() {
        let two = wire_and_motor();
        let nodes = Nodes(&two);
        let free = |drawn: i64| nodes.free(drawn.into()).as_integer().unwrap();
        assert_eq!([free(0x20), free(0x21), free(127)], [0x21, 0x21, 127]);
        let truths = two
            .loops
            .iter()
            .map(|one| one.trial.wiring.identifiers.truth);
        assert_eq!(nodes.below_truth() + 1, u32::from(truths.min().unwrap()));
    }

    #[test]
    fn heights_are_of_the_travel_and_currents_of_the_amplifier() {
        let pair = include_str!("../../../../scenarios/sma_pair_step.toml");
        let pair = base(pair);
        let fault = "\"height_{unit}\" = 10.0\n\"by_{command_unit}\" = 0.5\nprobability = 0.1\nnode = \"extensor\"";
        let fault = Nodes(&pair).in_unit(fault.parse().unwrap());
        let expected =
            "height_degrees = 20.0\nby_amperes = 0.5\nprobability = 0.1\nnode = \"extensor\"";
        assert_eq!(fault, expected.parse().unwrap());
    }
}
