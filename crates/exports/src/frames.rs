//! Frames of a recording as tables: all of them with their bytes, or those of one message with their signals.

use std::io::{self, Write};
use std::time::Duration;

use dbc::{Database, Message};

use crate::{ID_BITS, signals};
use recording::cell::{cell, heading};
use recording::frames::Frames;
use recording::log::Stamped;

/// Writes one row for each frame, in the order of the recording. Times are of the scenario, which began at `zero` on the clock of
/// the frames.
///
/// # Errors
/// If the output does not take it.
pub fn write_all(
    mut output: impl Write,
    frames: &Frames,
    database: &Database,
    zero: Duration,
) -> io::Result<()> {
    writeln!(output, "time_seconds,identifier,message,sender,data")?;
    for Stamped { time, frame, .. } in frames.iter() {
        let message = database.message_of(&frame).filter(|_| !frame.is_error());
        let name = message.map_or("", |message| message.name.as_str());
        let sender = message.and_then(|message| message.sender.as_deref());
        let identifier = frame.raw_id() & ID_BITS;
        let (name, sender) = (cell(name), cell(sender.unwrap_or_default()));
        let seconds = since(time, zero);
        write!(output, "{seconds:.6},{identifier},{name},{sender},")?;
        match (frame.is_error(), frame.is_remote()) {
            (true, _) => write!(output, "error")?,
            (false, true) => write!(output, "remote")?,
            (false, false) => {
                for byte in frame.data() {
                    write!(output, "{byte:02X}")?;
                }
            }
        }
        writeln!(output)?;
    }
    Ok(())
}

/// Writes one row for each frame of a message, with a column for each of its signals. A signal that a frame is too short for has
/// no value.
///
/// # Errors
/// If the output does not take it.
pub fn write_message(
    mut output: impl Write,
    frames: &Frames,
    zero: Duration,
    message: &Message,
) -> io::Result<()> {
    let names = message.signals.iter().map(|signal| signal.name.as_str());
    let names = ["time_seconds"].into_iter().chain(names);
    writeln!(output, "{}", heading(names))?;
    let signals = signals(message);
    let is_of_message = |stamped: &Stamped| {
        let frame = &stamped.frame;
        frame.raw_id() == message.raw_id && !frame.is_error() && !frame.is_remote()
    };
    for Stamped { time, frame, .. } in frames.iter().filter(is_of_message) {
        write!(output, "{:.6}", since(time, zero))?;
        for signal in &signals {
            match signal.decode(&frame) {
                Some(value) => write!(output, ",{value}")?,
                None => write!(output, ",")?,
            }
        }
        writeln!(output)?;
    }
    Ok(())
}

fn since(time: Duration, zero: Duration) -> f64 {
    time.as_secs_f64() - zero.as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;
    use can::CanFrame;

    fn frames() -> Frames {
        let frame = |id: u16, data: &[u8]| CanFrame::new(id, data);
        let at = |millis: u64, frame| Stamped::new(Duration::from_millis(millis), frame);
        vec![
            at(5, frame(0x080, &[])),
            at(
                10,
                frame(0x190, &[0x37, 0x02, 0x10, 0x27, 0, 0, 0xF4, 0x01]),
            ),
            at(12, frame(0x7E5, &[1, 0xAB])),
        ]
        .into()
    }

    #[test]
    fn every_frame_is_a_row() {
        let mut text = Vec::new();
        let zero = Duration::from_millis(10);
        write_all(&mut text, &frames(), Database::shipped(), zero).unwrap();
        let text = String::from_utf8(text).unwrap();
        let rows: Vec<&str> = text.lines().collect();
        assert_eq!(rows[0], "time_seconds,identifier,message,sender,data");
        assert_eq!(rows[1], "-0.005000,128,sync,controller,");
        assert_eq!(rows[2], "0.000000,400,drive_tpdo1,drive,370210270000F401");
        assert_eq!(rows[3], "0.002000,2021,,,01AB");
    }

    #[test]
    fn a_message_has_its_signals_as_columns() {
        let database = Database::shipped();
        let message = database.message("drive_tpdo1").unwrap();
        let mut text = Vec::new();
        write_message(&mut text, &frames(), Duration::ZERO, message).unwrap();
        let text = String::from_utf8(text).unwrap();
        let rows: Vec<Vec<&str>> = text.lines().map(|row| row.split(',').collect()).collect();
        assert_eq!(rows.len(), 2, "{text}");
        let cell = |name: &str| {
            let place = rows[0].iter().position(|column| *column == name);
            rows[1][place.unwrap()]
        };
        assert_eq!(cell("time_seconds"), "0.010000");
        assert_eq!(cell("position_millimetres"), "10");
        assert_eq!(cell("current_amperes"), "0.5");
    }
}
