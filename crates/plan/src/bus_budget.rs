//! Bus budget: checks whether the frames of a cycle fit between two SYNCs.

use std::collections::BTreeSet;
use std::fmt;
use std::time::Duration;

use can::frame_bits::occupied_bits_max;
use dbc::loops::{TERMS_EVERY_CYCLES, terms_cycle, truth_cycle};
use dbc::{Message, names};

use crate::plan::{ControlLoop, Plan, message_of};

/// Largest number of cycles that are searched for the fullest one. If the cycles repeat later, all frames count as one cycle.
const CYCLES_MAX: u32 = 1 << 16;
/// Step of a proposed period.
const PERIOD_STEP_MILLISECONDS: f64 = 0.1;

/// Need of a rig's cycles on its bus, if every frame has as many stuff bits as it can. A node sends its frames one after the
/// other: frames that do not fit into a cycle would delay the commands and the SYNC of the next one.
#[derive(Clone, Debug, PartialEq)]
pub struct BusBudget {
    /// Traffic on the bus.
    pub shares: Vec<BusShare>,
    /// Bit rate of the bus.
    pub bitrate_kilobits_per_second: f64,
    /// Time between two SYNCs.
    pub period_milliseconds: f64,
}

/// Traffic that a node sends for one purpose.
#[derive(Clone, Debug, PartialEq)]
pub struct BusShare {
    /// Name of the sender.
    pub node: String,
    /// Description of the traffic.
    pub what: String,
    /// Bits in a cycle in which it is sent.
    pub bits: f64,
    /// Pace at which it is sent.
    pub pace: Pace,
}

/// Pace of traffic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pace {
    /// In cycles, with the SYNC.
    Cycles {
        /// Number of cycles from one to the next.
        every: u8,
        /// Remainder of these cycles.
        remainder: u8,
    },
    /// Period in milliseconds, whatever the cycle. The identifier of this traffic gives way to that of all frames with the SYNC,
    /// so it takes the rest of the bus.
    Milliseconds(f64),
}

impl BusShare {
    /// Checks whether it is sent in a cycle; with `None`, in any.
    fn comes_in(&self, cycle: Option<u32>) -> bool {
        match self.pace {
            Pace::Cycles { every, remainder } => {
                cycle.is_none_or(|cycle| cycle % u32::from(every) == u32::from(remainder))
            }
            Pace::Milliseconds(_) => false,
        }
    }
}

impl BusBudget {
    /// Makes the budget of a plan.
    pub fn new(plan: &Plan) -> Self {
        let (database, controller) = (plan.database(), &plan.controller().name);
        let sync = share(controller, "SYNC", database.message(names::SYNC), EACH);
        let loops = plan.loops.iter();
        let shares = loops.flat_map(|one| loop_shares(plan, one));
        let set_points = plan.set_points_every_cycles().and_then(|every| {
            let names = plan.loops.iter().map(|one| names::set_point(one.name()));
            let messages = names.filter_map(|name| database.message(&name));
            let pace = Pace::Cycles {
                every,
                remainder: 0,
            };
            share(names::BENCH, "set-points ({frames})", messages, pace)
        });
        let all = sync.into_iter().chain(shares).chain(set_points);
        let mut shares = Vec::from_iter(all.chain(heartbeats(plan)));
        let id = |name: &str| {
            let node = &plan.nodes[plan.nodes.find(name)?];
            node.profile().map(|_| node.id())
        };
        shares.sort_by_key(|share| id(&share.node));
        Self {
            shares,
            bitrate_kilobits_per_second: plan.shared.run.bus.bitrate_kilobits_per_second.into(),
            period_milliseconds: plan.shared.run.bus.sync_period_milliseconds,
        }
    }

    /// Returns the bits between two SYNCs.
    pub fn available_bits(&self) -> f64 {
        self.period_milliseconds * self.bitrate_kilobits_per_second
    }

    /// Returns the bits of the fullest cycle.
    pub fn needed_bits(&self) -> f64 {
        self.fullest().map(|share| share.bits).sum()
    }

    /// Returns the traffic of the fullest cycle.
    fn fullest(&self) -> impl Iterator<Item = &BusShare> {
        let bits_in = |cycle| -> f64 {
            let shares = self.shares.iter().filter(|share| share.comes_in(cycle));
            shares.map(|share| share.bits).sum()
        };
        let cycles = (0..self.cycles().unwrap_or(0)).map(Some);
        let fullest = cycles.max_by(|one, other| bits_in(*one).total_cmp(&bits_in(*other)));
        let shares = self.shares.iter();
        shares.filter(move |share| share.comes_in(fullest.flatten()))
    }

    /// Returns the number of cycles after which the traffic repeats; `None` if they are too many to search.
    fn cycles(&self) -> Option<u32> {
        self.shares.iter().try_fold(1, |cycles, share| {
            let Pace::Cycles { every, .. } = share.pace else {
                return Some(cycles);
            };
            let every = u32::from(every);
            let together = cycles / greatest_common_divisor(cycles, every) * every;
            (together <= CYCLES_MAX).then_some(together)
        })
    }

    /// Returns the bits of each node in the fullest cycle, in the order of the shares: `hand 860, left 345`.
    pub fn fullest_cycle(&self) -> String {
        let mut nodes: Vec<(&str, f64)> = Vec::new();
        for BusShare { node, bits, .. } in self.fullest() {
            match nodes.iter_mut().find(|(name, _)| name == node) {
                Some((_, sum)) => *sum += bits,
                None => nodes.push((node, *bits)),
            }
        }
        let shares = nodes.iter().map(|(node, bits)| format!("{node} {bits:.0}"));
        Vec::from_iter(shares).join(", ")
    }

    /// Returns the share of the bus that all frames occupy on average.
    pub fn load_percent(&self) -> f64 {
        let [per_cycle, per_millisecond] = self.mean_bits();
        let bits = per_cycle + self.period_milliseconds * per_millisecond;
        100.0 * bits / self.available_bits()
    }

    /// Returns the mean bits of a cycle that come with the SYNC, and those of a millisecond that come by the clock.
    fn mean_bits(&self) -> [f64; 2] {
        let mut bits = [0.0; 2];
        for share in &self.shares {
            match share.pace {
                Pace::Cycles { every, .. } => bits[0] += share.bits / f64::from(every),
                Pace::Milliseconds(period) => bits[1] += share.bits / period,
            }
        }
        bits
    }

    /// Checks whether the traffic fits.
    pub fn fits(&self) -> bool {
        self.needed_bits() <= self.available_bits() && self.load_percent() <= 100.0
    }

    /// Returns the shortest period that would fit; `None` if the traffic by the clock alone exceeds the bit rate.
    pub fn period_milliseconds_min(&self) -> Option<f64> {
        let bitrate = self.bitrate_kilobits_per_second;
        let [per_cycle, per_millisecond] = self.mean_bits();
        if per_millisecond >= bitrate {
            return None;
        }
        let for_fullest = self.needed_bits() / bitrate;
        let for_all = per_cycle / (bitrate - per_millisecond);
        let period = for_fullest.max(for_all);
        // A sum of whole bits is no tenth of a bit above a step.
        let steps = (period / PERIOD_STEP_MILLISECONDS - 1e-9).ceil();
        Some(steps * PERIOD_STEP_MILLISECONDS)
    }
}

fn greatest_common_divisor(one: u32, other: u32) -> u32 {
    match other {
        0 => one,
        _ => greatest_common_divisor(other, one % other),
    }
}

/// `1065 of 2000 bits between two SYNCs (53 %)`
impl fmt::Display for BusBudget {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (needed, available) = (self.needed_bits(), self.available_bits());
        let percent = 100.0 * needed / available;
        write!(
            formatter,
            "{needed:.0} of {available:.0} bits between two SYNCs ({percent:.0} %)"
        )
    }
}

/// Returns the heartbeat of each node that sends one.
fn heartbeats(plan: &Plan) -> impl Iterator<Item = BusShare> {
    let nodes: BTreeSet<&str> = plan
        .rig_nodes()
        .map(|(_, node)| node.name.as_str())
        .collect();
    nodes.into_iter().filter_map(|node| {
        let name = names::message(node, names::HEARTBEAT);
        let message = plan.database().message(&name)?;
        let sent = Some(message).filter(|message| message.cycle_time_milliseconds > 0);
        share(node, "heartbeat", sent, by_clock(message))
    })
}

/// Returns the pace of a message by the clock.
fn by_clock(message: &Message) -> Pace {
    let period = Duration::from_millis(message.cycle_time_milliseconds);
    Pace::Milliseconds(period.as_secs_f64() * 1e3)
}

/// Returns the traffic of one loop.
fn loop_shares(plan: &Plan, one: &ControlLoop) -> impl Iterator<Item = BusShare> {
    let (wiring, database) = (&one.trial.wiring, plan.database());
    let controller = plan.controller().name.as_str();
    let (number, truth_every) = (wiring.loop_number(), wiring.truth_every_cycles());
    let drive = one.drive().name.as_str();
    let frame = |service| message_of(database, one.drive(), service).ok();
    let cycles = |every, remainder| Pace::Cycles { every, remainder };
    // For a drive without faults only the truth is published.
    let beside_faults = frame(names::TRUTH).filter(|_| one.trial.has_loop_faults());
    let fault_pace = beside_faults.map_or(EACH, by_clock);
    let fault_text = "current and peak temperature, for its faults ({frames})";
    let truth = database.plant_messages(drive);
    let truth_pace = cycles(truth_every, truth_cycle(number, truth_every));
    let terms = database.term_messages(controller, one.name());
    let terms_pace = cycles(TERMS_EVERY_CYCLES, terms_cycle(number));
    let terms_text = format!("terms of the law for {drive} ({{frames}})");
    let command_text = format!("command to {drive} (RPDO1)");
    let shares = [
        share(drive, "sample (TPDO1)", frame(names::TPDO1), EACH),
        share(controller, &command_text, frame(names::RPDO1), EACH),
        share(drive, "truth of the plant ({frames})", truth, truth_pace),
        share(drive, fault_text, beside_faults, fault_pace),
        share(controller, &terms_text, terms, terms_pace),
    ];
    shares.into_iter().flatten()
}

/// Pace of traffic in every cycle.
const EACH: Pace = Pace::Cycles {
    every: 1,
    remainder: 0,
};

/// Returns the traffic of these messages, if there are any; `{frames}` in its description becomes their number.
fn share<'a>(
    node: &str,
    what: &str,
    messages: impl IntoIterator<Item = &'a Message>,
    pace: Pace,
) -> Option<BusShare> {
    let occupied = |message: &Message| f64::from(occupied_bits_max(message.length_bytes));
    let bits = Vec::from_iter(messages.into_iter().map(occupied));
    let frames = match bits.len() {
        0 => return None,
        1 => "1 frame".to_owned(),
        count => format!("{count} frames"),
    };
    Some(BusShare {
        node: node.to_owned(),
        what: what.replace("{frames}", &frames),
        bits: bits.iter().sum(),
        pace,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn budget(paces: &[(f64, Pace)]) -> BusBudget {
        let shares = paces.iter().map(|(bits, pace)| BusShare {
            node: "x".to_owned(),
            what: "a frame".to_owned(),
            bits: *bits,
            pace: *pace,
        });
        BusBudget {
            shares: shares.collect(),
            bitrate_kilobits_per_second: 1000.0,
            period_milliseconds: 1.0,
        }
    }

    /// 9 · 100 bits in each cycle leave a tenth of the bus: room for traffic by the clock, as long as it needs no more.
    #[test]
    fn what_comes_by_the_clock_takes_what_the_cycles_leave() {
        let of = |bits| budget(&[(900.0, EACH), (bits, Pace::Milliseconds(10.0))]);
        let fits = of(1000.0);
        assert!(fits.fits());
        assert_eq!((fits.needed_bits(), fits.load_percent()), (900.0, 100.0));
        assert_eq!(fits.period_milliseconds_min(), Some(1.0));
        let too_much = of(1350.0);
        assert!(!too_much.fits());
        assert_eq!(too_much.needed_bits(), 900.0);
        // 900 / (1000 - 135) = 1.04
        assert_eq!(too_much.period_milliseconds_min(), Some(1.1));
    }

    #[test]
    fn what_seldom_comes_together_is_counted_together() {
        let pace = |every, remainder| Pace::Cycles { every, remainder };
        // Both fall into cycle 4 of each 35.
        let soon = budget(&[(500.0, pace(5, 4)), (600.0, pace(7, 4)), (100.0, EACH)]);
        assert_eq!(soon.needed_bits(), 1200.0);
        let never = budget(&[(500.0, pace(6, 1)), (600.0, pace(4, 2))]);
        assert_eq!(never.needed_bits(), 600.0);
        // After 199 · 211 · 10 cycles, too many to search.
        let rare = [
            (500.0, pace(199, 0)),
            (600.0, pace(211, 1)),
            (100.0, pace(10, 3)),
        ];
        assert_eq!(budget(&rare).needed_bits(), 1200.0);
    }

    #[test]
    fn no_period_is_proposed_where_none_would_do() {
        let too_much = budget(&[(100.0, EACH), (10_000.0, Pace::Milliseconds(10.0))]);
        assert!(!too_much.fits());
        assert_eq!(too_much.period_milliseconds_min(), None);
    }

    #[test]
    fn the_terms_come_as_often_as_the_controller_s_data_sheet_says() {
        let controller = dbc::dictionary(dbc::CONTROLLER_EDS, 1).unwrap();
        for tpdo in 0x1800..=0x1803 {
            assert_eq!(
                controller.unsigned(tpdo, 2),
                Some(TERMS_EVERY_CYCLES.into())
            );
        }
    }
}
