//! Reasons for which canrig's nodes left their duties, where their emergencies may not have reached the bus.

use std::io;
use std::path::Path;

use crate::run_folder::{file, parse_rows, read_text_in};

const HEADER: &str = "node,at_seconds,left,because,of";
/// Largest file that is read.
const BYTES_MAX: u64 = 16 << 20;
/// Largest number of reasons that are kept.
const REASONS_MAX: usize = 100_000;

/// Reason of a node, as its emergency gives it.
#[derive(Clone, Debug, PartialEq)]
pub struct Reason {
    /// Name of the node.
    pub node: String,
    /// Scenario time at which it had the emergency to send.
    pub at_seconds: f64,
    /// Error code of the emergency.
    pub code: u16,
    /// Its cause: see docs/reference/emergencies.md.
    pub cause: u8,
    /// Name of the node concerned; empty if the emergency names none.
    pub about: String,
}

/// All reasons of a run, in the order of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reasons(Vec<Reason>);

impl Reasons {
    /// Adds a reason; its time is that of the file, so that a replay judges by the same.
    pub fn add(&mut self, reason: Reason) {
        if self.0.len() < REASONS_MAX {
            let at_seconds = (reason.at_seconds * 1e6).round() / 1e6;
            self.0.push(Reason {
                at_seconds,
                ..reason
            });
        }
    }

    pub fn iter(&self) -> std::slice::Iter<'_, Reason> {
        self.0.iter()
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The text of `reasons.csv`.
    pub fn to_csv(&self) -> String {
        let row = |reason: &Reason| {
            let Reason {
                node,
                at_seconds,
                code,
                cause,
                about,
            } = reason;
            format!("{node},{at_seconds:.6},0x{code:04X},{cause},{about}\n")
        };
        let rows: String = self.0.iter().map(row).collect();
        format!("{HEADER}\n{rows}")
    }

    /// Reads `reasons.csv` of a run folder; empty without the file.
    ///
    /// # Errors
    /// If the file cannot be read, or is not of that form.
    pub fn read(folder: &Path) -> io::Result<Self> {
        let Some(text) = read_text_in(folder, file::REASONS, BYTES_MAX)? else {
            return Ok(Self::default());
        };
        let rows = parse_rows(&text, HEADER, parse);
        rows.map(Self)
            .map_err(|reason| io::Error::new(io::ErrorKind::InvalidData, reason))
    }
}

fn parse([node, at, code, cause, about]: [&str; 5]) -> Option<Reason> {
    Some(Reason {
        node: node.to_owned(),
        at_seconds: at
            .parse()
            .ok()
            .filter(|seconds: &f64| seconds.is_finite())?,
        code: u16::from_str_radix(code.strip_prefix("0x")?, 16).ok()?,
        cause: cause.parse().ok()?,
        about: about.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let mut reasons = Reasons::default();
        for (node, code, cause, about) in
            [("controller", 0x8250, 1, "drive"), ("drive", 0x8130, 0, "")]
        {
            reasons.add(Reason {
                node: node.to_owned(),
                at_seconds: 1.25,
                code,
                cause,
                about: about.to_owned(),
            });
        }
        let text = reasons.to_csv();
        let expected = "controller,1.250000,0x8250,1,drive\ndrive,1.250000,0x8130,0,\n";
        assert_eq!(text, format!("{HEADER}\n{expected}"));
        assert_eq!(parse_rows(&text, HEADER, parse), Ok(reasons.0));
    }
}
