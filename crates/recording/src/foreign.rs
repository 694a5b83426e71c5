//! Foreign frames: those that no node of the run sent, where the sender of each frame is known.
//!
//! In virtual time each frame comes from a participant, and on the embedded bus from a client. On a kernel's CAN all frames look
//! alike; there [`crate::sources`] counts them, and the run folder has no `foreign.csv`.

use std::io;
use std::path::Path;

use crate::run_folder::{file, parse_rows, read_text_in};

const HEADER: &str = "at_seconds,identifier,frames";
/// Largest file that is read.
const BYTES_MAX: u64 = 16 << 20;
/// Largest number of frames that are kept; the last row counts further ones.
const ROWS_MAX: usize = 100_000;

/// Foreign frames with the same identifier in a row.
#[derive(Clone, Debug, PartialEq)]
pub struct ForeignFrames {
    /// Scenario time of the first one.
    pub at_seconds: f64,
    pub identifier: u16,
    pub frames: u64,
}

/// All foreign frames of a run, in the order of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Foreign(Vec<ForeignFrames>);

impl Foreign {
    /// Notes a foreign frame.
    pub fn note(&mut self, at_seconds: f64, identifier: u16) {
        let is_full = self.0.len() >= ROWS_MAX;
        match self.0.last_mut() {
            Some(last) if is_full || last.identifier == identifier => last.frames += 1,
            _ => self.0.push(ForeignFrames {
                at_seconds: (at_seconds * 1e6).round() / 1e6,
                identifier,
                frames: 1,
            }),
        }
    }

    pub fn iter(&self) -> std::slice::Iter<'_, ForeignFrames> {
        self.0.iter()
    }

    /// The text of `foreign.csv`.
    pub fn to_csv(&self) -> String {
        let row = |one: &ForeignFrames| {
            let (at, identifier, frames) = (one.at_seconds, one.identifier, one.frames);
            format!("{at:.6},0x{identifier:03X},{frames}\n")
        };
        let rows: String = self.0.iter().map(row).collect();
        format!("{HEADER}\n{rows}")
    }

    /// Reads `foreign.csv` of a run folder; `None` without the file: the senders are not known.
    ///
    /// # Errors
    /// If the file cannot be read, or is not of that form.
    pub fn read(folder: &Path) -> io::Result<Option<Self>> {
        let Some(text) = read_text_in(folder, file::FOREIGN, BYTES_MAX)? else {
            return Ok(None);
        };
        let rows = parse_rows(&text, HEADER, parse);
        rows.map(|rows| Some(Self(rows)))
            .map_err(|reason| io::Error::new(io::ErrorKind::InvalidData, reason))
    }
}

fn parse([at, identifier, frames]: [&str; 3]) -> Option<ForeignFrames> {
    Some(ForeignFrames {
        at_seconds: at
            .parse()
            .ok()
            .filter(|seconds: &f64| seconds.is_finite())?,
        identifier: u16::from_str_radix(identifier.strip_prefix("0x")?, 16).ok()?,
        frames: frames.parse().ok()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let mut foreign = Foreign::default();
        for identifier in [0x210, 0x210, 0x000, 0x210] {
            foreign.note(0.5, identifier);
        }
        let text = foreign.to_csv();
        let expected = "0.500000,0x210,2\n0.500000,0x000,1\n0.500000,0x210,1\n";
        assert_eq!(text, format!("{HEADER}\n{expected}"));
        assert_eq!(parse_rows(&text, HEADER, parse), Ok(foreign.0));
    }
}
