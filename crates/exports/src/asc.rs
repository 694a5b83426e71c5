//! Vector's ASCII log of CAN frames.

use std::io::{self, Write};
use std::time::Duration;

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::Offset;

use crate::ID_BITS;
use recording::frames::Frames;
use recording::log::Stamped;

/// Writes the log to an output with a buffer. Times count from the whole second of the first frame, which the header gives in
/// UTC.
///
/// # Errors
/// If the output does not take it.
pub fn write(mut output: impl Write, frames: &Frames) -> io::Result<()> {
    let start = Duration::from_secs(frames.start().unwrap_or_default().as_secs());
    let date = date(start);
    write!(
        output,
        "date {date}\nbase hex  timestamps absolute\ninternal events logged\nBegin Triggerblock {date}\n   0.000000 Start of measurement\n"
    )?;
    for Stamped { time, frame, .. } in frames.iter() {
        let since = time.saturating_sub(start);
        let (seconds, micros) = (since.as_secs(), since.subsec_micros());
        if frame.is_error() {
            writeln!(output, "{seconds:4}.{micros:06} 1  ErrorFrame")?;
            continue;
        }
        let mark = if frame.is_extended() { "x" } else { "" };
        let id = format!("{:X}{mark}", frame.raw_id() & ID_BITS);
        write!(output, "{seconds:4}.{micros:06} 1  {id:<15} Rx   ")?;
        if frame.is_remote() {
            write!(output, "r")?;
        } else {
            write!(output, "d {:X}", frame.data().len())?;
            for byte in frame.data() {
                write!(output, " {byte:02X}")?;
            }
        }
        writeln!(output)?;
    }
    writeln!(output, "End TriggerBlock")
}

/// Returns a date as Vector's programs write it: `Fri Nov 20 06:15:12.000 am 2026`.
fn date(time: Duration) -> String {
    let format = "%a %b %d %I:%M:%S.000 %P %Y";
    utc(time).strftime(format).to_string()
}

/// Returns the date this long after the start of 1970; at most the end of 9999.
pub(super) fn utc(time: Duration) -> DateTime {
    let time = Timestamp::UNIX_EPOCH.saturating_add(time);
    Offset::UTC.to_datetime(time.unwrap_or(Timestamp::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;
    use can::CanFrame;

    #[test]
    fn a_frame_is_a_line() {
        let frames = [
            Stamped::new(
                Duration::from_micros(1_763_619_312_000_250),
                CanFrame::new(0x190, &[1, 0xAB]),
            ),
            Stamped::new(
                Duration::from_micros(1_763_619_313_500_000),
                CanFrame::new(0x80, &[]),
            ),
        ];
        let mut text = Vec::new();
        write(&mut text, &frames.to_vec().into()).unwrap();
        let text = String::from_utf8(text).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "date Thu Nov 20 06:15:12.000 am 2025");
        assert_eq!(lines[5], "   0.000250 1  190             Rx   d 2 01 AB");
        assert_eq!(lines[6], "   1.500000 1  80              Rx   d 0");
    }

    /// The same dates as `date -u -d @SECONDS` prints.
    #[test]
    fn dates_are_those_of_the_calendar() {
        for (seconds, expected) in [
            (0, "Thu Jan 01 12:00:00.000 am 1970"),
            (951_782_400, "Tue Feb 29 12:00:00.000 am 2000"),
            (1_735_689_599, "Tue Dec 31 11:59:59.000 pm 2024"),
            (4_107_585_600, "Mon Mar 01 12:00:00.000 pm 2100"),
        ] {
            assert_eq!(date(Duration::from_secs(seconds)), expected);
        }
        assert!(date(Duration::MAX).ends_with("9999"));
    }
}
