//! Whether what the nodes send in a cycle fits between two SYNCs.

use std::fmt;

use canopen::frame_bits::occupied_bits_max;
use dbc::Message;
use dbc::loops::TERMS_EVERY_CYCLES;
use scenario::rig::nodes::Rig;

use crate::setup::Setup;

const SYNC: &str = "sync";
/// The sample of a drive.
const SAMPLE: &str = "drive_tpdo1";
/// The command to a drive.
const COMMAND: &str = "drive_rpdo1";
/// What a drive publishes of its plant.
const TRUTH: [&str; 2] = ["drive_tpdo2", "drive_tpdo3"];
/// What the controller publishes of a law.
const TERMS: [&str; 4] = [
    "controller_tpdo1",
    "controller_tpdo2",
    "controller_tpdo3",
    "controller_tpdo4",
];
/// Among so many cycles are all in which terms and truths come together: each comes at least once in 240.
const CYCLES: u32 = TERMS_EVERY_CYCLES as u32 * 240;
/// Periods that are proposed are whole multiples of this.
const PERIOD_STEP_MILLISECONDS: f64 = 0.1;

/// What the cycles of a rig need of its bus, if every frame has as many stuff bits as it can. A node sends its frames one behind
/// the other: what does not fit into a cycle would delay the commands and the SYNC of the next one.
#[derive(Clone, Debug, PartialEq)]
pub struct BusBudget {
    /// What is on the bus.
    pub shares: Vec<BusShare>,
    /// Bit rate of the bus.
    pub bitrate_kilobits_per_second: f64,
    /// Time between two SYNCs.
    pub period_milliseconds: f64,
}

/// What a node sends for one purpose.
#[derive(Clone, Debug, PartialEq)]
pub struct BusShare {
    /// Who sends it.
    pub node: String,
    /// What it is, for people.
    pub what: String,
    /// Its bits in a cycle in which it comes.
    pub bits: f64,
    /// It comes once in so many cycles.
    pub every_cycles: u8,
    /// It comes in the cycles with this remainder.
    pub remainder: u8,
}

impl BusShare {
    fn comes_in(&self, cycle: u32) -> bool {
        cycle % u32::from(self.every_cycles) == u32::from(self.remainder)
    }
}

impl BusBudget {
    /// The budget of a rig, whose loops these are in their order.
    #[must_use]
    pub fn new(rig: &Rig, setups: &[Setup]) -> Self {
        let controller = rig.controller().map_or("", |(name, _)| name);
        let sync = setups.first().map(|setup| BusShare {
            node: controller.to_owned(),
            what: "SYNC".to_owned(),
            bits: frames(setup, &[SYNC]).bits,
            every_cycles: 1,
            remainder: 0,
        });
        let loops = rig.loops.values().zip(setups);
        let of_loops = loops.flat_map(|(one, setup)| {
            let drive = one.drives.first().map_or("", String::as_str);
            of_loop(controller, drive, setup)
        });
        let mut shares = Vec::from_iter(sync.into_iter().chain(of_loops));
        shares.sort_by_key(|share| rig.node.get(&share.node).map(|node| node.node_id));
        Self {
            shares,
            bitrate_kilobits_per_second: rig.bus.bitrate_kilobits_per_second.into(),
            period_milliseconds: rig.bus.sync_period_milliseconds,
        }
    }

    /// Bits between two SYNCs.
    #[must_use]
    pub fn available_bits(&self) -> f64 {
        self.period_milliseconds * self.bitrate_kilobits_per_second
    }

    /// Bits of the fullest cycle.
    #[must_use]
    pub fn needed_bits(&self) -> f64 {
        let bits = |cycle| -> f64 {
            let shares = self.shares.iter().filter(|share| share.comes_in(cycle));
            shares.map(|share| share.bits).sum()
        };
        (0..CYCLES).map(bits).fold(0.0, f64::max)
    }

    /// Share of the bus that all frames occupy, over many cycles.
    #[must_use]
    pub fn load_percent(&self) -> f64 {
        let shares = self.shares.iter();
        let bits: f64 = shares
            .map(|share| share.bits / f64::from(share.every_cycles))
            .sum();
        100.0 * bits / self.available_bits()
    }

    /// Whether it fits.
    #[must_use]
    pub fn fits(&self) -> bool {
        self.needed_bits() <= self.available_bits()
    }

    /// The shortest period that would fit.
    #[must_use]
    pub fn period_milliseconds_min(&self) -> f64 {
        let period = self.needed_bits() / self.bitrate_kilobits_per_second;
        // A sum of whole bits is no tenth of a bit above a step.
        let steps = (period / PERIOD_STEP_MILLISECONDS - 1e-9).ceil();
        steps * PERIOD_STEP_MILLISECONDS
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

/// What is sent for one loop.
fn of_loop(controller: &str, drive: &str, setup: &Setup) -> Vec<BusShare> {
    let place = &setup.place;
    let (truth, terms) = (frames(setup, &TRUTH), frames(setup, &TERMS));
    let share = |node: &str, what, sent: &Sent, (every_cycles, remainder)| BusShare {
        node: node.to_owned(),
        what,
        bits: sent.bits,
        every_cycles,
        remainder,
    };
    let each = (1, 0);
    let shares = [
        share(
            drive,
            "sample (TPDO1)".to_owned(),
            &frames(setup, &[SAMPLE]),
            each,
        ),
        share(
            controller,
            format!("command to {drive} (RPDO1)"),
            &frames(setup, &[COMMAND]),
            each,
        ),
        share(
            drive,
            format!("truth of the plant ({})", truth.words()),
            &truth,
            (place.truth_every_cycles, place.truth_cycle()),
        ),
        share(
            controller,
            format!("terms of the law for {drive} ({})", terms.words()),
            &terms,
            (TERMS_EVERY_CYCLES, place.terms_cycle()),
        ),
    ];
    shares
        .into_iter()
        .filter(|share| share.bits > 0.0)
        .collect()
}

/// Frames that are sent.
struct Sent {
    count: usize,
    bits: f64,
}

impl Sent {
    fn words(&self) -> String {
        match self.count {
            1 => "1 frame".to_owned(),
            count => format!("{count} frames"),
        }
    }
}

fn frames(setup: &Setup, names: &[&str]) -> Sent {
    let messages = names.iter().filter_map(|name| setup.database.message(name));
    let sent = messages.filter(|message| !message.is_silent());
    let bits = sent.map(|Message { length_bytes, .. }| f64::from(occupied_bits_max(*length_bytes)));
    let bits = Vec::from_iter(bits);
    Sent {
        count: bits.len(),
        bits: bits.iter().sum(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
