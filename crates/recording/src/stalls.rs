//! Stalls of the bench or of the machine itself in a run in real time: the evidence that a missed cycle is the bench's.
//! `stalls.csv` of the run folder holds it, so that a replay decides as the run did.

use std::fmt;
use std::io;
use std::path::Path;
use std::time::Duration;

use dbc::names::is_name;

use crate::log::parse_time;
use crate::run_folder::{file, read_rows};

const HEADER: &str = "from_seconds,until_seconds,who,what";
/// Longest name of a node.
const NAME_BYTES_MAX: usize = 64;
/// Largest file that is read: a million rows.
const BYTES_MAX: u64 = 64 << 20;

/// Name of a node, as a plain value.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct NodeName {
    bytes: [u8; NAME_BYTES_MAX],
    length: usize,
}

impl NodeName {
    /// Returns the name; `None` if no node can have it.
    pub fn new(name: &str) -> Option<Self> {
        let mut bytes = [0; NAME_BYTES_MAX];
        bytes
            .get_mut(..name.len())
            .filter(|_| is_name(name))?
            .copy_from_slice(name.as_bytes());
        Some(Self {
            bytes,
            length: name.len(),
        })
    }

    fn as_str(&self) -> &str {
        std::str::from_utf8(&self.bytes[..self.length]).unwrap_or_default()
    }
}

impl fmt::Debug for NodeName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.as_str().fmt(formatter)
    }
}

/// Owner of a stalled thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Who {
    /// The whole machine: a thread that only sleeps woke up late.
    Machine,
    /// The thread that carries the frames of an embedded bus.
    Bus,
    /// The controller's process.
    Controller,
    /// An emulator's process that canrig started, for any plant.
    PlantEmulator,
    /// The process of a drive or an io node that canrig does not play.
    Node(NodeName),
}

impl Who {
    const KINDS: [Self; 4] = [
        Self::Machine,
        Self::Bus,
        Self::Controller,
        Self::PlantEmulator,
    ];
    /// Prefix of a node's name in the file, since a node may be called like a kind.
    const NODE: &'static str = "node ";

    /// Returns its name in the file.
    fn name(&self) -> &str {
        match self {
            Self::Machine => "machine",
            Self::Bus => "bus",
            Self::Controller => "controller",
            Self::PlantEmulator => "plant-emulator",
            Self::Node(node) => node.as_str(),
        }
    }

    /// Returns the owner of a name in the file.
    fn named(text: &str) -> Option<Self> {
        match text.strip_prefix(Self::NODE) {
            Some(node) => NodeName::new(node).map(Self::Node),
            None => (Self::KINDS.into_iter()).find(|kind| kind.name() == text),
        }
    }

    /// Returns the text for the file.
    fn label(&self) -> String {
        match self {
            Self::Node(node) => format!("{}{}", Self::NODE, node.as_str()),
            kind => kind.name().to_owned(),
        }
    }

    /// Returns whether a node of this name is meant.
    pub fn is_node(&self, name: &str) -> bool {
        matches!(self, Self::Node(node) if node.as_str() == name)
    }
}

/// Kind of a stall.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum What {
    /// No thread ran.
    StoodStill,
    /// It was ready to run while others ran.
    Waited,
    /// It slept before its deadline, and was woken after it.
    WokeLate,
}

impl What {
    const ALL: [Self; 3] = [Self::StoodStill, Self::Waited, Self::WokeLate];

    /// Returns its text in the file.
    fn label(self) -> &'static str {
        match self {
            Self::StoodStill => "stood still",
            Self::Waited => "waited for a processor",
            Self::WokeLate => "woke up late",
        }
    }
}

/// Host stall, on the clock of the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stall {
    pub from: Duration,
    pub until: Duration,
    pub who: Who,
    pub what: What,
}

impl Stall {
    /// Makes a stall, with times cut to the microseconds of the file, so that a replay sees the same.
    pub fn new(from: Duration, until: Duration, who: Who, what: What) -> Self {
        let cut = |time: Duration| Duration::new(time.as_secs(), time.subsec_micros() * 1000);
        Self {
            from: cut(from),
            until: cut(until),
            who,
            what,
        }
    }

    /// Returns the length of the stall.
    pub fn length(&self) -> Duration {
        self.until.saturating_sub(self.from)
    }
}

/// Writes a text such as `the machine stood still for 45.0 ms`.
impl fmt::Display for Stall {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (who, what) = (self.who.name(), self.what.label());
        let milliseconds = 1e3 * self.length().as_secs_f64();
        let verb = match self.what {
            What::StoodStill | What::Waited => format!("{what} for {milliseconds:.1} ms"),
            What::WokeLate => format!("{what} by {milliseconds:.1} ms"),
        };
        write!(formatter, "the {who} {verb}")
    }
}

/// Returns the text of `stalls.csv`.
pub fn to_csv(stalls: &[Stall]) -> String {
    let row = |stall: &Stall| {
        let seconds = |time: Duration| format!("{}.{:06}", time.as_secs(), time.subsec_micros());
        let (from, until) = (seconds(stall.from), seconds(stall.until));
        format!(
            "{from},{until},{},{}\n",
            stall.who.label(),
            stall.what.label()
        )
    };
    let rows: String = stalls.iter().map(row).collect();
    format!("{HEADER}\n{rows}")
}

/// Reads `stalls.csv` of a run folder. Without the file there were no stalls, as in virtual time or in a foreign recording.
///
/// # Errors
/// If the file cannot be read, or is not of that form.
pub fn read_stalls(folder: &Path) -> io::Result<Vec<Stall>> {
    read_rows(folder, file::STALLS, BYTES_MAX, HEADER, stall)
}

/// Returns the stall in a row of the file.
fn stall([from, until, who, what]: [&str; 4]) -> Option<Stall> {
    Some(Stall {
        from: parse_time(from).ok()?,
        until: parse_time(until).ok()?,
        who: Who::named(who)?,
        what: (What::ALL.into_iter()).find(|known| known.label() == what)?,
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::run_folder::parse_rows;

    fn parse_csv(text: &str) -> Result<Vec<Stall>, String> {
        parse_rows(text, HEADER, stall)
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(rows in prop::collection::vec((0..u64::from(u32::MAX), 0..2_000_000_u64, 0..5_usize, 0..3_usize), 0..9)) {
            let stall = |(from, length, who, what): &(u64, u64, usize, usize)| {
                let from = Duration::from_nanos(1_001 * from);
                let node = NodeName::new("bus").map(Who::Node);
                let who = Who::KINDS.get(*who).copied().or(node).unwrap();
                Stall::new(from, from + Duration::from_micros(*length), who, What::ALL[*what])
            };
            let stalls: Vec<Stall> = rows.iter().map(stall).collect();
            prop_assert_eq!(parse_csv(&to_csv(&stalls)), Ok(stalls));
        }
    }

    #[test]
    fn a_damaged_line_is_named() {
        let good = "1.000000,1.045000,machine,stood still";
        let stalls = parse_csv(&format!("{HEADER}\n{good}\n")).unwrap();
        assert_eq!(stalls[0].to_string(), "the machine stood still for 45.0 ms");
        for bad in [
            "1.0,1.045000,machine,stood still",
            "1.000000,1.045000,moon,stood still",
            "1.000000,1.045000,node Moon,stood still",
            "1.000000",
        ] {
            let error = parse_csv(&format!("{HEADER}\n{good}\n{bad}\n")).unwrap_err();
            assert!(
                error.starts_with("line 3: ") && error.contains(bad),
                "{error}"
            );
        }
        assert!(parse_csv("").is_err());
    }
}
