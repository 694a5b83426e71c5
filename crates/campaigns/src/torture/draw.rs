//! Draws faults. What is drawn covers all kinds, with parameters from harmless to severe (chosen, not measured).

use dbc::loops::LoopPlace;
use faults::Stream;
use rig::plan::Plan;
use scenario::plant::Plant;
use scenario::rig::nodes::{EMULATED_NODE_ID_MAX, Rig};
use scenario::wiring::Wiring;
use toml::{Table, Value};

/// Faults in one mix at most.
const FAULTS_MAX: u64 = 4;

/// Kinds that last, by group.
const LASTING: [(&str, &str); 26] = [
    ("bus", "lose"),
    ("bus", "delay"),
    ("bus", "duplicate"),
    ("bus", "reorder"),
    ("bus", "corrupt"),
    ("bus", "bit_error"),
    ("bus", "babble"),
    ("bus", "load"),
    ("node", "crash"),
    ("node", "hang"),
    ("node", "slow_cycle"),
    ("node", "clock_drift"),
    ("node", "lost_heartbeat"),
    ("sensor", "offset"),
    ("sensor", "drift"),
    ("sensor", "noise"),
    ("sensor", "spikes"),
    ("sensor", "lost_bits"),
    ("sensor", "stuck"),
    ("amplifier", "saturated"),
    ("amplifier", "stuck_on"),
    ("amplifier", "dead"),
    ("plant", "ageing"),
    ("plant", "broken_wire"),
    ("plant", "jammed_pulley"),
    ("plant", "dropped_load"),
];

/// Kinds that happen at an instant.
const INSTANT: [(&str, &str); 2] = [("node", "restart"), ("node", "nmt_stop")];

/// Kinds that are about the boot, and how often a mix has one: many such runs never begin.
const BOOT: [&str; 3] = ["late_boot", "wrong_identity", "wrong_node_id"];
const BOOT_PROBABILITY: f64 = 0.1;

/// Who can fail, by the names that the scenario has for them.
pub(super) struct Nodes {
    controller: String,
    drives: Vec<Drive>,
    /// Whether faults of drives say of which one: those of a scenario of one drive do not.
    are_named: bool,
}

struct Drive {
    name: String,
    node_id: u8,
    /// Faults that mean something to its plant.
    plant_faults: &'static [&'static str],
    /// In which unit and range its positions are.
    wiring: Wiring,
}

impl Nodes {
    /// Those of a scenario of schema 1.
    pub(super) fn of_one_drive(plant: &Plant) -> Self {
        let drive = Drive {
            name: "drive".to_owned(),
            node_id: LoopPlace::SHIPPED.drive_node_id,
            plant_faults: plant.faults(),
            wiring: Wiring::default(),
        };
        Self {
            controller: "controller".to_owned(),
            drives: vec![drive],
            are_named: false,
        }
    }

    /// Those of a rig, with the loops of a scenario on it.
    pub(super) fn of_rig(rig: &Rig, plan: &Plan) -> Self {
        let loops = rig.loops.values().zip(&plan.loops);
        let drives = loops.filter_map(|(of_rig, one)| {
            Some(Drive {
                name: of_rig.drives.first()?.clone(),
                node_id: one.place.drive_node_id,
                plant_faults: one.scenario.plant.faults(),
                wiring: one.scenario.wiring.clone(),
            })
        });
        Self {
            controller: rig.controller().map_or("", |(name, _)| name).to_owned(),
            drives: drives.collect(),
            are_named: true,
        }
    }

    fn nodes(&self) -> Vec<&str> {
        let drives = self.drives.iter().map(|drive| drive.name.as_str());
        [self.controller.as_str()]
            .into_iter()
            .chain(drives)
            .collect()
    }

    /// Who has a CAN controller.
    fn stations(&self) -> Vec<&str> {
        self.nodes().into_iter().chain([BENCH]).collect()
    }

    /// Identifiers that matter: SYNC, TPDO1, RPDO1, heartbeats.
    fn identifiers(&self) -> Vec<u32> {
        let of = |base: u32| {
            self.drives
                .iter()
                .map(move |drive| base + u32::from(drive.node_id))
        };
        let pdos = of(0x180).chain(of(0x200));
        [0x080]
            .into_iter()
            .chain(pdos)
            .chain([0x701])
            .chain(of(0x700))
            .collect()
    }

    /// The identifiers with which plants publish the truth begin above this: no node may forge that.
    fn below_truth(&self) -> u32 {
        let lowest = self.drives.iter().map(|drive| drive.node_id).min();
        0x6A0 + u32::from(lowest.unwrap_or_default()) - 1
    }

    /// A fault with the names that its drive has for positions, and as high for its travel.
    fn in_unit(&self, fault: Table) -> Table {
        let name = fault.get("node").and_then(Value::as_str);
        let mut drives = self.drives.iter();
        let drive = drives.find(|drive| name == Some(drive.name.as_str()));
        let Some(wiring) = drive.map(|drive| &drive.wiring) else {
            return fault;
        };
        // Heights are drawn for the travel of the rig that ships.
        let [travel, shipped] = [wiring, &Wiring::default()].map(|wiring| {
            let [min, max] = wiring.range();
            max - min
        });
        let travels = travel / shipped;
        let of_drive = |(key, value): (String, Value)| match value {
            Value::Float(height) if key.contains("millimetres") => {
                (wiring.unit.rename(&key), (height * travels).into())
            }
            value => (key, value),
        };
        fault.into_iter().map(of_drive).collect()
    }

    fn has_fault(&self, (group, kind): &(&str, &str)) -> bool {
        *group != "plant"
            || self
                .drives
                .iter()
                .any(|drive| drive.plant_faults.contains(kind))
    }

    /// The drive whose part fails.
    fn draw(&self, stream: &mut Stream, group: &str, kind: &str) -> Option<Value> {
        if !self.are_named {
            return None;
        }
        let drives = self.drives.iter();
        let able = drives.filter(|drive| group != "plant" || drive.plant_faults.contains(&kind));
        let able = Vec::from_iter(able);
        Some(pick(stream, &able).name.clone().into())
    }
}

/// canrig's own node.
const BENCH: &str = "bench";

/// The kinds that are drawn, each with its group: `bus.lose`.
pub(super) fn kinds(nodes: &Nodes) -> Vec<String> {
    let lasting = LASTING.iter().filter(|kind| nodes.has_fault(kind));
    let kinds = lasting.chain(&INSTANT).copied();
    let boot = BOOT.into_iter().map(|kind| ("node", kind));
    let kinds = kinds.chain(boot);
    kinds
        .map(|(group, kind)| format!("{group}.{kind}"))
        .collect()
}

/// A mix of faults for a run of some length, as far as they mean something to the plants: the `[fault]` table.
pub(super) fn mix(stream: &mut Stream, nodes: &Nodes, duration_seconds: f64) -> Table {
    let lasting = LASTING.iter().filter(|kind| nodes.has_fault(kind));
    let kinds: Vec<_> = lasting
        .map(|kind| (kind, true))
        .chain(INSTANT.iter().map(|kind| (kind, false)))
        .collect();
    let mut faults = Table::new();
    for _ in 0..1 + stream.below(FAULTS_MAX) {
        let (&(group, kind), is_lasting) = *pick(stream, &kinds);
        let mut fault = parameters(stream, nodes, group, kind);
        let from = tenth_milliseconds(stream.uniform() * 0.8 * duration_seconds);
        if is_lasting {
            fault.insert("from_seconds".to_owned(), from.into());
            if kind == "ageing" || stream.happens(0.8) {
                // Short faults are as likely as long ones.
                let length = 1e-3 * libm::pow(duration_seconds * 1e3, stream.uniform());
                let until = tenth_milliseconds(from + length.max(1e-3));
                fault.insert("until_seconds".to_owned(), until.into());
            }
        } else {
            fault.insert("at_seconds".to_owned(), from.into());
        }
        push(&mut faults, group, kind, nodes.in_unit(fault));
    }
    if stream.happens(BOOT_PROBABILITY) {
        let kind = *pick(stream, &BOOT);
        let fault = boot(stream, nodes, kind);
        push(&mut faults, "node", kind, fault);
    }
    faults
}

fn push(faults: &mut Table, group: &str, kind: &str, fault: Table) {
    let group = faults
        .entry(group)
        .or_insert_with(|| Value::Table(Table::new()));
    if let Some(kinds) = group.as_table_mut() {
        let all = kinds
            .entry(kind)
            .or_insert_with(|| Value::Array(Vec::new()));
        if let Some(all) = all.as_array_mut() {
            all.push(Value::Table(fault));
        }
    }
}

/// What a kind has besides its time.
fn parameters(stream: &mut Stream, nodes: &Nodes, group: &str, kind: &str) -> Table {
    let mut table = Table::new();
    let stations = nodes.stations();
    let mut set = |key: &str, value: Value| {
        table.insert(key.to_owned(), value);
    };
    match kind {
        "lose" => {
            set("receiver", (*pick(stream, &stations)).into());
            hits(stream, nodes, &mut set);
        }
        "delay" => {
            set("sender", (*pick(stream, &stations)).into());
            set("delay_milliseconds", between(stream, 0.1, 20.0));
            hits(stream, nodes, &mut set);
        }
        "duplicate" | "reorder" => {
            set("sender", (*pick(stream, &stations)).into());
            hits(stream, nodes, &mut set);
        }
        "corrupt" => {
            set("sender", (*pick(stream, &stations)).into());
            set("inverted_bits", whole(stream, 1, 8));
            hits(stream, nodes, &mut set);
        }
        "bit_error" => {
            if stream.happens(0.5) {
                set("sender", (*pick(stream, &stations)).into());
            }
            hits(stream, nodes, &mut set);
        }
        "babble" => set("identifier", whole(stream, 1, nodes.below_truth())),
        "load" => {
            set("identifier", whole(stream, 0x181, nodes.below_truth()));
            set("period_milliseconds", between(stream, 0.2, 5.0));
        }
        "slow_cycle" => set("delay_milliseconds", between(stream, 0.1, 20.0)),
        "clock_drift" => set("parts_per_million", between(stream, -5000.0, 5000.0)),
        "offset" => set("offset_millimetres", between(stream, -60.0, 60.0)),
        "drift" => set("rate_millimetres_per_second", between(stream, -50.0, 50.0)),
        "noise" => set("noise_millimetres_rms", between(stream, 0.01, 5.0)),
        "spikes" => {
            set("height_millimetres", between(stream, 0.5, 60.0));
            set("probability", between(stream, 0.01, 1.0));
        }
        "lost_bits" => set("mask", whole(stream, 1, 1023)),
        "saturated" => set("current_amperes_max", between(stream, 0.01, 1.0)),
        "stuck_on" => set("current_amperes", between(stream, 0.01, 1.0)),
        "ageing" => {
            set("resistance_factor", between(stream, 0.5, 1.0));
            set("recoverable_strain_factor", between(stream, 0.5, 1.0));
        }
        _ => {}
    }
    match group {
        "node" => set("node", (*pick(stream, &nodes.nodes())).into()),
        "bus" => {}
        _ => {
            if let Some(drive) = nodes.draw(stream, group, kind) {
                set("node", drive);
            }
        }
    }
    if kind == "crash" && stream.happens(0.3) {
        set("output", "hold".into());
    }
    table
}

/// A fault of the boot.
fn boot(stream: &mut Stream, nodes: &Nodes, kind: &str) -> Table {
    let mut table = Table::new();
    if kind != "late_boot"
        && let Some(drive) = nodes.draw(stream, "node", kind)
    {
        table.insert("node".to_owned(), drive);
    }
    match kind {
        "late_boot" => {
            let node = *pick(stream, &nodes.nodes());
            table.insert("node".to_owned(), node.into());
            table.insert("delay_seconds".to_owned(), between(stream, 0.0, 12.0));
        }
        "wrong_identity" => {
            table.insert("product_code".to_owned(), whole(stream, 0, u32::MAX));
        }
        // Not the controller's own, nor that of another drive.
        _ => {
            let lowest = if nodes.are_named {
                EMULATED_NODE_ID_MAX + 1
            } else {
                2
            };
            table.insert("node_id".to_owned(), whole(stream, lowest.into(), 127));
        }
    }
    table
}

/// Which frames are hit, how often, how many in a row.
fn hits(stream: &mut Stream, nodes: &Nodes, set: &mut impl FnMut(&str, Value)) {
    if stream.happens(0.7) {
        set("identifier", (*pick(stream, &nodes.identifiers())).into());
    }
    set("probability", between(stream, 0.01, 1.0));
    set("burst_frames", whole(stream, 1, 60));
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
    use std::collections::{BTreeMap, BTreeSet};

    use scenario::Scenario;

    use super::*;
    use crate::torture::TortureCase;

    const BASE: &str = "schema = 1\nname = \"t\"\nduration_seconds = 2.0\n[controller.pid]\n\
        [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";

    #[test]
    fn every_mix_is_valid_and_all_kinds_are_drawn() {
        let mut drawn = BTreeSet::new();
        for seed in 0..1000 {
            let faults = mix(
                &mut Stream::new(seed),
                &Nodes::of_one_drive(&Plant::default()),
                2.0,
            );
            let case = TortureCase::new(BASE, &BTreeMap::new(), faults, seed).unwrap();
            let plan = case.plan().unwrap_or_else(|problems| panic!("{problems}"));
            let scenario = &plan.leading().scenario;
            let windows = scenario.fault.windows();
            assert!((1..=5).contains(&windows.len()));
            drawn.extend(
                windows
                    .iter()
                    .map(|window| (window.place.group, window.place.kind)),
            );
        }
        assert_eq!(drawn.len(), LASTING.len() + INSTANT.len() + BOOT.len());
        let schema: serde_json::Value =
            serde_json::from_str(&scenario::schema::json_schema()).unwrap();
        let groups = ["Bus", "Node", "Sensor", "Amplifier", "Plant"];
        let kinds = groups.map(|group| {
            let group = &schema["definitions"][format!("{group}Faults")];
            group["properties"].as_object().unwrap().len()
        });
        assert_eq!(
            kinds.iter().sum::<usize>(),
            drawn.len(),
            "a kind is not drawn"
        );
    }

    #[test]
    fn a_plant_meets_no_fault_that_means_nothing_to_it() {
        let base = format!("{BASE}[plant.dc_motor]\n");
        let scenario = Scenario::parse(&base, "t.toml", |_| unreachable!("no table")).unwrap();
        let mut drawn = BTreeSet::new();
        for seed in 0..300 {
            let faults = mix(
                &mut Stream::new(seed),
                &Nodes::of_one_drive(&scenario.plant),
                2.0,
            );
            let case = TortureCase::new(&base, &BTreeMap::new(), faults, seed).unwrap();
            let plan = case.plan().unwrap_or_else(|problems| panic!("{problems}"));
            let scenario = &plan.leading().scenario;
            drawn.extend(scenario.fault.windows().iter().map(|one| one.place.kind));
        }
        assert!(drawn.contains("dropped_load") && !drawn.contains("ageing"));
    }

    #[test]
    fn a_seed_gives_one_mix() {
        let draw = |seed| {
            mix(
                &mut Stream::new(seed),
                &Nodes::of_one_drive(&Plant::default()),
                2.0,
            )
        };
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2));
    }
}
