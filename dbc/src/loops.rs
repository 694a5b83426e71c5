//! One of several loops on a bus: its drive, its disturbance module and the terms of its law are where the rig has them.

use crate::data_sheets::TruthPace;
use crate::database::{Message, NO_FRAME};
use crate::{Database, SignalHandle};

/// Spreads small numbers over all bits: 2^64 divided by the golden ratio.
const GOLDEN_RATIO: u64 = 0x9E37_79B9_7F4A_7C15;
/// The controller publishes the terms of a loop in every so many cycles (the transmission type of its TPDOs).
pub const TERMS_EVERY_CYCLES: u8 = 10;
/// Node-IDs in the shipped DBC.
const DRIVE_NODE_ID: u32 = 0x10;
const DISTURBANCE_NODE_ID: u32 = 0x11;
/// The TPDOs of the controller's loops are these apart, which are those of nodes that no emulated node has; four of them before
/// those of the next function.
const LOOP_OFFSET: u32 = 0x20;
const LOOPS_IN_A_FUNCTION: u32 = 4;
const FUNCTION_OFFSET: u32 = 0x80;

/// Where on the bus a loop is.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub struct LoopPlace {
    /// Its number among the controller's loops, from 0.
    pub number: u8,
    /// Node-ID of its drive.
    pub drive_node_id: u8,
    /// Node-ID of the disturbance module of its plant, where there is one.
    pub disturbance_node_id: Option<u8>,
    /// The drive publishes the truth about its plant in every so many cycles.
    pub truth_every_cycles: u8,
}

/// The seed of what is random about a drive: each drive has noise of its own, the shipped rig's that of the scenario.
#[must_use]
pub fn seed_of_drive(seed: u64, drive_node_id: u8) -> u64 {
    let distance = u64::from(drive_node_id) ^ u64::from(DRIVE_NODE_ID);
    seed ^ distance.wrapping_mul(GOLDEN_RATIO)
}

impl LoopPlace {
    /// The shipped rig's only loop.
    pub const SHIPPED: Self = Self {
        number: 0,
        drive_node_id: 0x10,
        disturbance_node_id: Some(0x11),
        truth_every_cycles: 1,
    };

    /// In which cycles the controller publishes the terms of the loop: those with this remainder by [`TERMS_EVERY_CYCLES`]. Each
    /// loop has its own, since all terms at once would fill several cycles, with commands and SYNC behind them.
    #[must_use]
    pub fn terms_cycle(&self) -> u8 {
        self.number % TERMS_EVERY_CYCLES
    }

    /// In which cycles the drive publishes the truth: those with this remainder by its `truth_every_cycles`. As far as that may
    /// be, no other drive does so in them, and no terms come.
    #[must_use]
    pub fn truth_cycle(&self) -> u8 {
        let every = self.truth_every_cycles.max(1);
        (self.number + (every / 2).min(TERMS_EVERY_CYCLES / 2)) % every
    }

    /// What the drive's TPDOs that hold the truth are set to.
    #[must_use]
    pub fn truth_pace(&self) -> TruthPace {
        let every_cycles = self.truth_every_cycles;
        // SYNCs count from 1; 0 is no start value.
        let sync_start = match self.truth_cycle() {
            0 if every_cycles > 1 => every_cycles,
            cycle => cycle,
        };
        TruthPace {
            every_cycles,
            sync_start,
        }
    }

    /// COB-ID of a message of the shipped rig. No frame carries those of a module that is not there.
    fn identifier(&self, message: &Message) -> u32 {
        let id = message.raw_id;
        match owner(message) {
            Owner::Bus => id,
            Owner::Drive => id - DRIVE_NODE_ID + u32::from(self.drive_node_id),
            Owner::Disturbance => match self.disturbance_node_id {
                Some(node_id) => id - DISTURBANCE_NODE_ID + u32::from(node_id),
                None => id | NO_FRAME,
            },
            Owner::Law => id + law_offset(self.number),
        }
    }
}

/// How far the TPDOs of a loop are above those of the first one.
#[must_use]
pub fn law_offset(number: u8) -> u32 {
    let number = u32::from(number);
    LOOP_OFFSET * (number % LOOPS_IN_A_FUNCTION) + FUNCTION_OFFSET * (number / LOOPS_IN_A_FUNCTION)
}

/// What people call a loop and its nodes.
#[derive(Clone, Copy, Debug)]
pub struct NodesByName<'a> {
    /// The loop; empty for the only one.
    pub of_loop: &'a str,
    /// Its drive.
    pub drive: &'a str,
    /// The module that acts on its plant, where there is one.
    pub disturbance: Option<&'a str>,
}

impl NodesByName<'_> {
    /// A message by its node, from its name in the shipped DBC.
    fn name(&self, controller: &str, message: &str) -> String {
        let (node, rest) = message.split_once('_').unwrap_or((message, ""));
        match (owner_of(message), node) {
            (Owner::Drive, "plant") => format!("{}_truth", self.drive),
            (Owner::Drive, _) => format!("{}_{rest}", self.drive),
            (Owner::Disturbance, _) => format!("{}_{rest}", self.disturbance.unwrap_or(node)),
            (Owner::Law, _) if !self.of_loop.is_empty() => {
                format!("{controller}_{}_{rest}", self.of_loop)
            }
            (Owner::Law | Owner::Bus, "controller") => format!("{controller}_{rest}"),
            _ => message.to_owned(),
        }
    }
}

/// Whose a message is.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
enum Owner {
    /// All loops share it.
    Bus,
    Drive,
    Disturbance,
    /// The controller sends it for one loop.
    Law,
}

fn owner(message: &Message) -> Owner {
    owner_of(&message.name)
}

fn owner_of(name: &str) -> Owner {
    match name {
        "plant_truth" => Owner::Drive,
        _ if name.starts_with("drive_") => Owner::Drive,
        _ if name.starts_with("disturbance_") => Owner::Disturbance,
        _ if name.starts_with("controller_tpdo") => Owner::Law,
        _ => Owner::Bus,
    }
}

impl Database {
    /// The frames of a loop that is elsewhere on the bus than the shipped rig's only one.
    #[must_use]
    pub fn at(&self, place: &LoopPlace) -> Self {
        let messages = self.messages().iter().map(|message| Message {
            raw_id: match message.is_silent() {
                true => message.raw_id,
                false => place.identifier(message),
            },
            ..message.clone()
        });
        Self::from_messages(messages.collect())
    }

    /// The same with the frames of another loop on the same bus, whose names begin with that loop's.
    #[must_use]
    pub fn beside(&self, name: &str, other: &Self) -> Self {
        let named = (other.messages().iter())
            .filter(|message| owner(message) != Owner::Bus)
            .map(|message| named(message, name));
        Self::from_messages(self.messages().iter().cloned().chain(named).collect())
    }

    /// The same without the frames of loops that are beside it, by their names.
    #[must_use]
    pub fn without(&self, others: &[&str]) -> Self {
        let is_of = |message: &&Message, other: &str| {
            let own = message.name.strip_prefix(other);
            let own = own.and_then(|rest| rest.strip_prefix('_'));
            own.is_some_and(|own| owner_of(own) != Owner::Bus)
        };
        let messages = self.messages().iter();
        let left = messages.filter(|message| !others.iter().any(|other| is_of(message, other)));
        Self::from_messages(left.cloned().collect())
    }

    /// The frames as one of several loops knows them, from how another one, `own`, does.
    #[must_use]
    pub fn seen_from(&self, own: &str, other: &str) -> Self {
        let end = format!("{other}_");
        let messages =
            self.messages()
                .iter()
                .map(|message| match message.name.strip_prefix(&end) {
                    Some(name) => renamed(message, name.to_owned(), |sender| {
                        sender.strip_prefix(&end).unwrap_or(sender).to_owned()
                    }),
                    None if owner(message) == Owner::Bus => message.clone(),
                    None => named(message, own),
                });
        Self::from_messages(messages.collect())
    }

    /// The frames as a person calls them, each by its node, from how the first of these loops knows them.
    #[must_use]
    pub fn by_node(&self, controller: &str, loops: &[NodesByName<'_>]) -> Self {
        let name = |message: &Message| {
            let is_of = |one: &NodesByName<'_>, name: &str| {
                let own = name.strip_prefix(one.of_loop)?.strip_prefix('_')?;
                (owner_of(own) != Owner::Bus).then(|| one.name(controller, own))
            };
            let name = message.name.as_str();
            let (first, others) = loops.split_first()?;
            let of_others = others.iter().find_map(|one| is_of(one, name));
            Some(of_others.unwrap_or_else(|| first.name(controller, name)))
        };
        let messages = self.messages().iter().map(|message| Message {
            name: name(message).unwrap_or_else(|| message.name.clone()),
            ..message.clone()
        });
        Self::from_messages(messages.collect())
    }

    /// The same signal of the other loops on the bus.
    pub(crate) fn of_other_loops(&self, path: &str) -> impl Iterator<Item = SignalHandle> {
        let end = format!("_{}", path.split('.').next().unwrap_or_default());
        let signal = path.split('.').next_back().unwrap_or_default();
        let others = self.messages().iter();
        let others = others.filter(move |message| message.name.ends_with(&end));
        others.filter_map(move |message| self.signal(&format!("{}.{signal}", message.name)))
    }
}

/// The message of another loop.
fn named(message: &Message, name: &str) -> Message {
    renamed(
        message,
        format!("{name}_{}", message.name),
        |sender| match sender {
            "drive" | "disturbance" | "plant" => format!("{name}_{sender}"),
            shared => shared.to_owned(),
        },
    )
}

fn renamed(message: &Message, name: String, sender: impl Fn(&str) -> String) -> Message {
    Message {
        name,
        sender: message.sender.as_deref().map(sender),
        ..message.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario_clock::{STATUSWORD, ScenarioClock};
    use canopen::CanFrame;
    use std::time::Duration;

    #[test]
    fn the_shipped_rig_s_only_loop_is_where_it_ships() {
        let shipped = Database::shipped();
        assert_eq!(&shipped.at(&LoopPlace::SHIPPED), shipped);
    }

    fn two_loops() -> Database {
        let place = |number, drive_node_id| LoopPlace {
            number,
            drive_node_id,
            disturbance_node_id: None,
            truth_every_cycles: 1,
        };
        let [x, y] = [place(0, 0x10), place(1, 0x12)].map(|place| Database::shipped().at(&place));
        x.beside("y", &y)
    }

    #[test]
    fn two_loops_share_the_bus_and_nothing_else() {
        let both = two_loops();
        let id = |name| both.message(name).map(|message| message.raw_id);
        assert_eq!(id("drive_tpdo1"), Some(0x190));
        assert_eq!(id("y_drive_tpdo1"), Some(0x192));
        assert_eq!(id("y_drive_rpdo1"), Some(0x212));
        assert_eq!(id("y_controller_tpdo1"), Some(0x1A1));
        assert_eq!(id("y_plant_truth"), Some(0x6B2));
        assert!(both.message("disturbance_rpdo1").unwrap().is_silent());
        assert_eq!(id("y_sync"), None);
        let sender = |name| {
            both.message(name)
                .and_then(|message| message.sender.clone())
        };
        assert_eq!(sender("y_drive_tpdo1").as_deref(), Some("y_drive"));
        // All identifiers are different.
        let sent = both
            .messages()
            .iter()
            .filter(|message| !message.is_silent());
        let mut ids = Vec::from_iter(sent.map(|message| message.raw_id));
        let count = ids.len();
        ids.dedup();
        assert_eq!(ids.len(), count);
    }

    #[test]
    fn what_one_loop_knows_of_the_bus_says_what_the_other_knows() {
        let both = two_loops();
        let of_y = both.seen_from("x", "y");
        let id = |name| of_y.message(name).map(|message| message.raw_id);
        assert_eq!(
            (id("drive_tpdo1"), id("x_drive_tpdo1")),
            (Some(0x192), Some(0x190))
        );
        assert_eq!(of_y.seen_from("y", "x"), both);
    }

    #[test]
    fn people_know_messages_by_their_nodes() {
        let loops = [("drive", "left", Some("fan")), ("y", "right", None)];
        let loops = loops.map(|(of_loop, drive, disturbance)| NodesByName {
            of_loop,
            drive,
            disturbance,
        });
        let named = two_loops().by_node("hand", &loops);
        for (id, name) in [
            (0x190, "left_tpdo1"),
            (0x192, "right_tpdo1"),
            (0x212, "right_rpdo1"),
            (0x6B0, "left_truth"),
            (0x1A1, "hand_y_tpdo1"),
            (0x181, "hand_drive_tpdo1"),
            (0x701, "hand_heartbeat"),
            (0x080, "sync"),
        ] {
            let frame = CanFrame::new(id, &[0; 8]);
            let found = named
                .message_of(&frame)
                .map(|message| message.name.as_str());
            assert_eq!(found, Some(name), "0x{id:03X}");
        }
    }

    #[test]
    fn scenario_time_begins_once_every_drive_is_enabled() {
        let mut clock = ScenarioClock::new(&two_loops()).unwrap();
        assert_eq!(STATUSWORD, "drive_tpdo1.statusword_state");
        let [sync, x, y] = [0x080, 0x190, 0x192].map(|id| {
            let data = if id == 0x080 {
                &[1][..]
            } else {
                &[0x37, 0x12, 0, 0, 0, 0, 0, 0]
            };
            CanFrame::new(id, data)
        });
        let off = CanFrame::new(0x190, &[0x33, 0x12, 0, 0, 0, 0, 0, 0]);
        let frames = [x, sync, off, y, sync, x, sync];
        for (time, frame) in (0..).map(Duration::from_millis).zip(&frames) {
            clock.on_frame(time, frame);
        }
        assert_eq!(clock.zero(), Some(Duration::from_millis(6)));
    }
}
