//! Hits: which frames, values and nodes the faults of a scenario took, delayed or changed.
//!
//! The model of the bus notes its hits frame by frame. Faults inside a node or a plant act exactly as the scenario says, so their
//! hits follow from it. `hits.csv` of the run folder holds both; the judge explains a breach by them and by nothing else.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use canopen::nmt::ERROR_CONTROL_ID;
use plan::Plan;
use scenario::fault::{Actor, Fault, Group};

use crate::run_folder::{file, parse_rows, read_text_in};

const HEADER: &str = "fault,effect,node,identifier,from_seconds,until_seconds,frames,amount";
/// Largest file that is read.
const BYTES_MAX: u64 = 256 << 20;
/// Word for every node, in the place of a name.
const ALL: &str = "*";

/// Effect of a hit on a frame or a node.
#[derive(Clone, Copy, Debug, Eq, Ord, PartialEq, PartialOrd)]
pub enum Effect {
    /// A frame did not reach the node; without a node, it reached nobody.
    Lost,
    /// A frame of the node came later, by at most the amount in milliseconds.
    Late,
    /// A frame of the node, or the value in it, is another than without the fault.
    Changed,
    /// A copy of a frame of the node followed it.
    Copied,
    /// The node did not run.
    NotRun,
    /// The node's clock was wrong, by the amount in parts per million.
    Clock,
    /// The node got a command of the scenario.
    Commanded,
}

impl Effect {
    const EACH: [(Self, &'static str); 7] = [
        (Self::Lost, "lost"),
        (Self::Late, "late"),
        (Self::Changed, "changed"),
        (Self::Copied, "copied"),
        (Self::NotRun, "not_run"),
        (Self::Clock, "clock"),
        (Self::Commanded, "commanded"),
    ];

    fn word(self) -> &'static str {
        let mut each = Self::EACH.iter();
        each.find(|(effect, _)| *effect == self)
            .map_or("", |(_, word)| word)
    }

    fn parse(word: &str) -> Option<Self> {
        let mut each = Self::EACH.iter();
        each.find(|(_, known)| *known == word)
            .map(|(effect, _)| *effect)
    }
}

/// Frames in a row, or a stretch of time, on which a fault had the same effect.
#[derive(Clone, Debug, PartialEq)]
pub struct Hit {
    /// Path of the fault in the scenario.
    pub fault: String,
    pub effect: Effect,
    /// The node that did not get the frame or that is affected; `None` for all.
    pub node: Option<String>,
    /// Identifier of the frames; `None` for all frames of the node.
    pub identifier: Option<u16>,
    /// Scenario time of the first frame, or of the start.
    pub from_seconds: f64,
    /// Scenario time of the last frame, or of the end; infinite if the effect lasts.
    pub until_seconds: f64,
    /// Number of frames; 0 if the effect is not counted in frames.
    pub frames: u64,
    /// Delay in milliseconds, or error of a clock in parts per million; 0 for other effects.
    pub amount: f64,
}

impl Hit {
    /// Whether the effect overlaps a stretch of scenario time.
    pub fn overlaps(&self, from_seconds: f64, until_seconds: f64) -> bool {
        self.from_seconds <= until_seconds && self.until_seconds >= from_seconds
    }

    /// Whether it concerns frames with this identifier.
    pub fn is_of(&self, identifier: u16) -> bool {
        self.identifier.is_none_or(|own| own == identifier)
    }

    /// Whether it concerns the node with this name.
    pub fn is_at(&self, node: &str) -> bool {
        self.node.as_deref().is_none_or(|own| own == node)
    }

    fn to_row(&self) -> String {
        let node = self.node.as_deref().unwrap_or(ALL);
        let identifier = self
            .identifier
            .map_or_else(String::new, |id| format!("0x{id:03X}"));
        let time = |seconds: f64| {
            if seconds.is_finite() {
                format!("{seconds:.6}")
            } else {
                String::new()
            }
        };
        let (from, until) = (time(self.from_seconds), time(self.until_seconds));
        let (fault, effect) = (&self.fault, self.effect.word());
        let (frames, amount) = (self.frames, self.amount);
        format!("{fault},{effect},{node},{identifier},{from},{until},{frames},{amount:.3}\n")
    }

    fn parse(
        [fault, effect, node, identifier, from, until, frames, amount]: [&str; 8],
    ) -> Option<Self> {
        let time = |text: &str, unknown: f64| match text {
            "" => Some(unknown),
            text => text
                .parse()
                .ok()
                .filter(|seconds: &f64| seconds.is_finite()),
        };
        let identifier = match identifier {
            "" => None,
            text => Some(u16::from_str_radix(text.strip_prefix("0x")?, 16).ok()?),
        };
        Some(Self {
            fault: fault.to_owned(),
            effect: Effect::parse(effect)?,
            node: (node != ALL).then(|| node.to_owned()),
            identifier,
            from_seconds: time(from, f64::NEG_INFINITY)?,
            until_seconds: time(until, f64::INFINITY)?,
            frames: frames.parse().ok()?,
            amount: amount.parse().ok()?,
        })
    }
}

/// All hits of a run, in the order of their starts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hits {
    all: Vec<Hit>,
    /// Places of the hits with the same fault, effect, node and identifier: these hardly overlap, so a search looks at few.
    groups: Vec<AlikeHits>,
}

/// Hits with the same fault, effect, node and identifier, in the order of their starts.
#[derive(Clone, Debug, PartialEq)]
struct AlikeHits {
    effect: Effect,
    places: Vec<usize>,
    /// Latest end of each hit and those before it.
    reached_seconds: Vec<f64>,
}

impl Hits {
    /// Joins the hits on the bus with those of the faults that act inside nodes and plants.
    ///
    /// All values are those of the file, so that a replay judges by the same.
    pub fn new(on_bus: Vec<Hit>, plan: &Plan) -> Self {
        let faults = plan.shared.run.faults.iter();
        let inside = faults.flat_map(|fault| inside(fault, plan));
        let mut hits = Vec::from_iter(on_bus.into_iter().chain(inside).map(rounded));
        hits.sort_by(order);
        Self::indexed(hits)
    }

    fn indexed(all: Vec<Hit>) -> Self {
        let mut groups: BTreeMap<_, AlikeHits> = BTreeMap::new();
        for (place, hit) in all.iter().enumerate() {
            let key = (&hit.fault, hit.effect, &hit.node, hit.identifier);
            let group = groups.entry(key).or_insert_with(|| AlikeHits {
                effect: hit.effect,
                places: Vec::new(),
                reached_seconds: Vec::new(),
            });
            let before = group.reached_seconds.last();
            let reached = before.map_or(hit.until_seconds, |before| before.max(hit.until_seconds));
            group.places.push(place);
            group.reached_seconds.push(reached);
        }
        let groups = groups.into_values().collect();
        Self { all, groups }
    }

    pub fn iter(&self) -> std::slice::Iter<'_, Hit> {
        self.all.iter()
    }

    /// Hits with an effect.
    pub fn of(&self, effect: Effect) -> impl Iterator<Item = &Hit> {
        let groups = self.groups.iter();
        let of_effect = groups.filter(move |group| group.effect == effect);
        of_effect.flat_map(|group| group.places.iter().map(|place| &self.all[*place]))
    }

    /// Hits with an effect that overlap a stretch of scenario time.
    pub fn overlapping(
        &self,
        effect: Effect,
        from_seconds: f64,
        until_seconds: f64,
    ) -> impl Iterator<Item = &Hit> {
        let groups = self.groups.iter();
        let of_effect = groups.filter(move |group| group.effect == effect);
        of_effect.flat_map(move |group| {
            let reached = &group.reached_seconds;
            let first = reached.partition_point(|reached| *reached < from_seconds);
            let hits = group.places[first..].iter().map(|place| &self.all[*place]);
            hits.take_while(move |hit| hit.from_seconds <= until_seconds)
                .filter(move |hit| hit.overlaps(from_seconds, until_seconds))
        })
    }

    /// The text of `hits.csv`.
    pub fn to_csv(&self) -> String {
        let rows: String = self.all.iter().map(Hit::to_row).collect();
        format!("{HEADER}\n{rows}")
    }

    /// Reads `hits.csv` of a run folder; `None` without the file.
    ///
    /// # Errors
    /// If the file cannot be read, or is not of that form.
    pub fn read(folder: &Path) -> io::Result<Option<Self>> {
        let Some(text) = read_text_in(folder, file::HITS, BYTES_MAX)? else {
            return Ok(None);
        };
        let rows = parse_rows(&text, HEADER, Hit::parse);
        rows.map(|rows| Some(Self::indexed(rows)))
            .map_err(|reason| io::Error::new(io::ErrorKind::InvalidData, reason))
    }
}

fn rounded(hit: Hit) -> Hit {
    let round = |value: f64, steps: f64| (value * steps).round() / steps;
    Hit {
        from_seconds: round(hit.from_seconds, 1e6),
        until_seconds: round(hit.until_seconds, 1e6),
        amount: round(hit.amount, 1e3),
        ..hit
    }
}

fn order(one: &Hit, other: &Hit) -> Ordering {
    let times = one.from_seconds.total_cmp(&other.from_seconds);
    let key = |hit: &Hit| {
        (
            hit.fault.clone(),
            hit.effect,
            hit.node.clone(),
            hit.identifier,
        )
    };
    times.then_with(|| key(one).cmp(&key(other)))
}

/// The hits of a fault that acts inside a node or a plant; those of the bus are noted frame by frame.
fn inside(fault: &Fault, plan: &Plan) -> Vec<Hit> {
    if fault.kind.group == Group::Bus {
        return Vec::new();
    }
    let hit = |node: Option<&str>, effect, amount| Hit {
        fault: fault.path(),
        effect,
        node: node.map(str::to_owned),
        identifier: None,
        from_seconds: fault.from_seconds.unwrap_or(f64::NEG_INFINITY),
        until_seconds: fault.until_seconds.unwrap_or(f64::INFINITY),
        frames: 0,
        amount,
    };
    let Some(index) = fault.node else {
        // A fault of a plant changes what each of its drives measures.
        let loops = plan.loops.iter();
        let here =
            loops.filter(|one| fault.is_at_drive(one.trial.wiring.drive, &one.trial.wiring.plant));
        let drives = here.map(|one| one.drive().name.as_str());
        return drives
            .map(|drive| hit(Some(drive), Effect::Changed, 0.0))
            .collect();
    };
    let node = &plan.nodes[index];
    let own = Some(node.name.as_str());
    let one = match fault.kind.name {
        _ if fault.kind.group != Group::Node => hit(own, Effect::Changed, 0.0),
        "slow_cycle" => hit(own, Effect::Late, fault.number("delay_milliseconds")),
        "clock_drift" => hit(own, Effect::Clock, fault.number("parts_per_million")),
        "lost_heartbeat" => Hit {
            identifier: Some(ERROR_CONTROL_ID + u16::from(node.id())),
            ..hit(None, Effect::Lost, 0.0)
        },
        "late_boot" => Hit {
            until_seconds: 0.0,
            ..hit(own, Effect::NotRun, 0.0)
        },
        "wrong_identity" | "wrong_node_id" => Hit {
            until_seconds: 0.0,
            ..hit(own, Effect::Changed, 0.0)
        },
        _ if fault.kind.actor == Actor::Message => hit(own, Effect::Commanded, 0.0),
        _ => hit(own, Effect::NotRun, 0.0),
    };
    vec![one]
}

/// Key that tells frames in a row apart from others: fault, effect, node and identifier.
type RunOfFrames = (String, Effect, Option<String>, u16);

/// Notes hits frame by frame, and joins those of frames in a row.
#[derive(Debug, Default)]
pub struct HitLog {
    /// Open rows, each with the number of its last frame among those of its identifier.
    open: BTreeMap<RunOfFrames, (u64, Hit)>,
    done: Vec<Hit>,
}

impl HitLog {
    /// Notes the hit on the frame that is `number` among the frames with its identifier, from its time until the fault let it
    /// go, both in scenario time.
    pub fn note(
        &mut self,
        (fault, effect, node): (&str, Effect, Option<&str>),
        (identifier, number): (u16, u64),
        (from_seconds, until_seconds): (f64, f64),
    ) {
        let late = match effect {
            Effect::Late => 1e3 * (until_seconds - from_seconds),
            _ => 0.0,
        };
        let key = (
            fault.to_owned(),
            effect,
            node.map(str::to_owned),
            identifier,
        );
        if let Some((last, hit)) = self.open.get_mut(&key)
            && *last + 1 == number
        {
            *last = number;
            hit.until_seconds = hit.until_seconds.max(until_seconds);
            hit.frames += 1;
            hit.amount = hit.amount.max(late);
            return;
        }
        let hit = Hit {
            fault: key.0.clone(),
            effect,
            node: key.2.clone(),
            identifier: Some(identifier),
            from_seconds,
            until_seconds,
            frames: 1,
            amount: late,
        };
        if let Some((_, ended)) = self.open.insert(key, (number, hit)) {
            self.done.push(ended);
        }
    }

    /// Takes all hits.
    pub fn take(&mut self) -> Vec<Hit> {
        let open = std::mem::take(&mut self.open).into_values();
        let mut hits = std::mem::take(&mut self.done);
        hits.extend(open.map(|(_, hit)| hit));
        hits
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lost(number: u64, at: f64) -> ((u16, u64), (f64, f64)) {
        ((0x080, number), (at, at))
    }

    #[test]
    fn frames_in_a_row_are_one_hit() {
        let mut log = HitLog::default();
        for (number, at) in [(3, 0.3), (4, 0.4), (6, 0.6)] {
            let (frame, times) = lost(number, at);
            log.note(
                ("fault.bus.lose.0", Effect::Lost, Some("drive")),
                frame,
                times,
            );
        }
        let hits = log.take();
        let rows = hits
            .iter()
            .map(|hit| (hit.from_seconds, hit.until_seconds, hit.frames));
        assert_eq!(Vec::from_iter(rows), [(0.3, 0.4, 2), (0.6, 0.6, 1)]);
    }

    #[test]
    fn a_search_finds_what_overlaps() {
        let mut log = HitLog::default();
        for number in 0..40_u32 {
            // Every third frame, 2.5 ms late: each hit reaches into the times of the next ones.
            let at = f64::from(number) * 1e-3;
            let frame = (0x190, u64::from(3 * number));
            let hit = ("fault.bus.delay.0", Effect::Late, Some("drive"));
            log.note(hit, frame, (at, at + 2.5e-3));
            let whole = ("fault.bus.lose.0", Effect::Lost, Some("drive"));
            log.note(whole, (0x080, u64::from(2 * number)), (at, at));
        }
        let mut all = log.take();
        all.sort_by(order);
        let hits = Hits::indexed(all);
        for effect in [Effect::Late, Effect::Lost, Effect::NotRun] {
            for step in 0..90_u32 {
                let from = f64::from(step) * 0.5e-3 - 2e-3;
                for until in [from, from + 1e-3, from + 1.0] {
                    let slow = hits.iter().filter(|hit| hit.effect == effect);
                    let slow = slow.filter(|hit| hit.overlaps(from, until));
                    let found = hits.overlapping(effect, from, until);
                    assert!(found.eq(slow), "{effect:?} {from} {until}");
                }
            }
        }
    }

    #[test]
    fn what_is_written_is_read() {
        let hit = Hit {
            fault: "fault.node.crash.0".to_owned(),
            effect: Effect::NotRun,
            node: Some("drive".to_owned()),
            identifier: None,
            from_seconds: 1.5,
            until_seconds: f64::INFINITY,
            frames: 0,
            amount: 0.0,
        };
        let late = Hit {
            effect: Effect::Late,
            node: None,
            identifier: Some(0x190),
            until_seconds: 1.75,
            frames: 3,
            amount: 0.25,
            ..hit.clone()
        };
        let hits = Hits::indexed(vec![hit, late]);
        let text = hits.to_csv();
        assert_eq!(
            text.lines().nth(2),
            Some("fault.node.crash.0,late,*,0x190,1.500000,1.750000,3,0.250")
        );
        assert_eq!(parse_rows(&text, HEADER, Hit::parse), Ok(hits.all));
        let damaged = text.replace("not_run", "ran");
        assert!(parse_rows(&damaged, HEADER, Hit::parse).is_err());
    }
}
