//! `canrig monitor`: live traffic, one line per frame, decoded by DBC and EDS. Flags that are not set are left out.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use can::{CanFrame, Filter};
use canopen::nmt::ERROR_CONTROL_ID;
use canopen::sdo::{DEFAULT_REQUEST_ID, DEFAULT_RESPONSE_ID, expedited_length};
use canopen::{AbortCode, NmtCommand, NmtState, emcy};
use clap::Args;
use dbc::Database;
use dbc::scenario_clock::SYNC_COB_ID;
use platform::clock::Clock;
use platform::terminal::printable;

use super::nodes::state_name;
use super::{NamesArgs, ToolBusArgs, open, seconds, stop_signal, value};
use can::error_frames;
use plan::data_sheet::DataSheet;
use plan::named_nodes::NamedNodes;
use runner::console::{print_problem, print_with};
use runner::exit::{Exit, Failure};

/// Longest wait for a frame before the tool checks Ctrl-C and the duration.
const PATIENCE: Duration = Duration::from_millis(50);
/// Width of the column of names.
const NAME_WIDTH: usize = 23;

/// Choice of the frames to show, and limits on the length of the output.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct MonitorOptions {
    /// Show only frames with this part in their name (drive, sync, heartbeat), or with this identifier (0x190)
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub only: Vec<String>,
    /// Leave out frames with this part in their name, or with this identifier
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub except: Vec<String>,
    /// Show a frame only when its content has changed
    #[arg(long)]
    pub changes: bool,
    /// Show the bytes too
    #[arg(long)]
    pub raw: bool,
    /// End after this number of lines
    #[arg(long, value_name = "LINES")]
    pub count: Option<u64>,
    /// End after this time
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    pub duration: Option<f64>,
    /// The DBC file to decode by, if it is not that of canrig's built-in drive and controller
    #[arg(long, value_name = "FILE")]
    pub dbc: Option<PathBuf>,
}

/// The SDO channel that an identifier belongs to.
struct Channel<'a> {
    is_request: bool,
    node_id: u8,
    sheet: Option<&'a DataSheet>,
}

/// A decoder: it turns frames into lines.
#[derive(Debug)]
pub(crate) struct Decoder {
    database: Database,
    sheets: Vec<DataSheet>,
    options: MonitorOptions,
    last: BTreeMap<u32, CanFrame>,
}

impl Decoder {
    /// Makes a decoder from a DBC and data sheets.
    pub(crate) fn new(database: Database, sheets: Vec<DataSheet>, options: MonitorOptions) -> Self {
        let nodes = sheets
            .iter()
            .map(|sheet| (sheet.node_id, sheet.node_name.as_str()));
        Self {
            database: database.with_nodes(nodes),
            sheets,
            options,
            last: BTreeMap::new(),
        }
    }

    /// Returns the line for a frame; `None` if the options leave it out.
    pub(crate) fn line(&mut self, time: Duration, frame: &CanFrame) -> Option<String> {
        let name = self.name(frame);
        if !self.is_wanted(&name, frame) {
            return None;
        }
        let before = self.last.insert(frame.raw_id(), *frame);
        if self.options.changes && before == Some(*frame) {
            return None;
        }
        let seconds = time.as_secs_f64();
        let (id, bytes) = frame_texts(frame);
        let mut line = format!("{seconds:12.6}  {id:>8}  {name:<NAME_WIDTH$}");
        if self.options.raw {
            let _ = write!(line, "  [{bytes:<23}]");
        }
        let content = self.content(frame);
        let content = if content.is_empty() && !self.options.raw {
            bytes
        } else {
            content
        };
        let _ = write!(line, "  {content}");
        Some(line.trim_end().to_owned())
    }

    fn is_wanted(&self, name: &str, frame: &CanFrame) -> bool {
        let id = frame_texts(frame).0;
        let is_meant = |pattern: &String| {
            let digits = pattern.strip_prefix("0x").unwrap_or(pattern);
            name.contains(pattern.as_str()) || digits.eq_ignore_ascii_case(&id)
        };
        let MonitorOptions { only, except, .. } = &self.options;
        (only.is_empty() || only.iter().any(is_meant)) && !except.iter().any(is_meant)
    }

    /// Returns the message's name in the DBC, or its function in CANopen.
    fn name(&self, frame: &CanFrame) -> String {
        if let Some(message) = self.database.message_of(frame) {
            return message.name.clone();
        }
        let Some(id) = frame.standard_id() else {
            let kind = match (frame.is_error(), frame.is_remote()) {
                (true, _) => "error message",
                (_, true) => "remote frame",
                _ => "extended frame",
            };
            return kind.to_owned();
        };
        if let Some(channel) = self.channel(id) {
            let direction = if channel.is_request {
                "request"
            } else {
                "answer"
            };
            return format!("{} SDO {direction}", self.node(channel.node_id.into()));
        }
        let node_id = id & 0x7F;
        match id & 0x780 {
            0x000 if id == 0 => "NMT command".to_owned(),
            SYNC_COB_ID if node_id == 0 => "SYNC".to_owned(),
            emcy::DEFAULT_ID => format!("{} emergency", self.node(id)),
            ERROR_CONTROL_ID if node_id != 0 => format!("{} heartbeat", self.node(id)),
            pdo @ 0x180..=0x500 if node_id != 0 && pdo & 0x80 == 0 => {
                format!("{} RPDO{}", self.node(id), (pdo - 0x100) >> 8)
            }
            pdo @ 0x180..=0x500 if node_id != 0 => {
                format!("{} TPDO{}", self.node(id), pdo >> 8)
            }
            _ => "unknown".to_owned(),
        }
    }

    /// Returns the name of the node whose number is at the end of an identifier.
    fn node(&self, id: u16) -> String {
        let node_id = id & 0x7F;
        let mut sheets = self.sheets.iter();
        let sheet = sheets.find(|sheet| u16::from(sheet.node_id) == node_id);
        sheet.map_or_else(
            || format!("node {node_id}"),
            |sheet| sheet.node_name.clone(),
        )
    }

    fn channel(&self, id: u16) -> Option<Channel<'_>> {
        let second = self.sheets.iter().find_map(|sheet| {
            let (request, answer) = sheet.second_channel()?;
            [request, answer].contains(&id).then_some(Channel {
                is_request: id == request,
                node_id: sheet.node_id,
                sheet: Some(sheet),
            })
        });
        second.or_else(|| {
            let node_id = (id & 0x7F) as u8;
            let is_sdo = [DEFAULT_REQUEST_ID, DEFAULT_RESPONSE_ID].contains(&(id & 0x780));
            (is_sdo && node_id != 0).then(|| Channel {
                is_request: id & 0x780 == DEFAULT_REQUEST_ID,
                node_id,
                sheet: self.sheets.iter().find(|sheet| sheet.node_id == node_id),
            })
        })
    }

    /// Returns the meaning of the bytes.
    fn content(&self, frame: &CanFrame) -> String {
        if let Some(message) = error_frames::read(frame) {
            return message.text;
        }
        let channel = frame.standard_id().and_then(|id| self.channel(id));
        if let (Some(channel), Ok(payload)) = (channel, frame.data().try_into()) {
            return sdo_text(&channel, payload);
        }
        if let Some(message) = self.database.message_of(frame) {
            let signals = message
                .decode(frame)
                .filter(|(signal, value)| !value::is_idle(signal, *value))
                .map(|(signal, value)| value::show_signal(signal, value));
            return signals.collect::<Vec<_>>().join("  ");
        }
        match (frame.standard_id(), frame.data()) {
            (Some(0), &[command, node_id]) => {
                let order = NmtCommand::from_specifier(command);
                let order =
                    order.map_or_else(|| format!("{command}"), |order| format!("{order:?}"));
                format!("{order} node {node_id}")
            }
            (Some(0x701..=0x77F), &[state]) => NmtState::from_number(state & 0x7F).map_or_else(
                || format!("state {state}"),
                |state| state_name(state).to_owned(),
            ),
            (Some(0x081..=0x0FF), &[low, high, register, ..]) => {
                let code = u16::from_le_bytes([low, high]);
                format!("error code 0x{code:04X}, error register 0x{register:02X}")
            }
            _ => String::new(),
        }
    }
}

/// Returns identifier and bytes as text.
fn frame_texts(frame: &CanFrame) -> (String, String) {
    let text = frame.to_string();
    let (id, _) = text.split_once('#').unwrap_or((&text, ""));
    if frame.is_remote() {
        return (
            id.to_owned(),
            format!("asks for {} bytes", frame.data().len()),
        );
    }
    let bytes = frame.data().iter();
    let pairs = Vec::from_iter(bytes.map(|byte| format!("{byte:02X}")));
    (id.to_owned(), pairs.join(" "))
}

/// Describes an SDO frame (CiA 301, 7.2.4.3).
fn sdo_text(channel: &Channel<'_>, payload: [u8; 8]) -> String {
    let [command, low, high, sub_index, data @ ..] = payload;
    let index = u16::from_le_bytes([low, high]);
    let entry = channel
        .sheet
        .and_then(|sheet| sheet.dictionary.get(index, sub_index));
    let name = entry.map_or_else(String::new, |entry| format!(" {}", entry.name));
    let object = format!("0x{index:04X}:{sub_index:02X}{name}");
    let value = || {
        let is_expedited = command & 0b10 != 0;
        if is_expedited {
            let length = expedited_length(command).unwrap_or(4);
            format!(" = {}", value::show(entry, &data[..length]))
        } else if command & 1 != 0 {
            format!(" ({} bytes follow)", u32::from_le_bytes(data))
        } else {
            " (segments follow)".to_owned()
        }
    };
    match (channel.is_request, command >> 5) {
        (_, 4) => format!("{object}: {}", AbortCode(u32::from_le_bytes(data))),
        (true, 1) => format!("write {object}{}", value()),
        (true, 2) => format!("read {object}"),
        (true, 0) => "write segment".to_owned(),
        (true, 3) => "read next segment".to_owned(),
        (true, 5) => "block upload".to_owned(),
        (true, 6) => "block download".to_owned(),
        (false, 2) => format!("is {object}{}", value()),
        (false, 3) => format!("written {object}"),
        (false, 0) => "segment".to_owned(),
        (false, 1) => "segment written".to_owned(),
        (false, 5) => "block download".to_owned(),
        (false, 6) => "block upload".to_owned(),
        _ => "no SDO command".to_owned(),
    }
}

/// Arguments of `monitor`.
#[derive(Args, Debug)]
pub(crate) struct MonitorArgs {
    #[command(flatten)]
    pub bus: ToolBusArgs,
    #[command(flatten)]
    pub options: MonitorOptions,
    #[command(flatten)]
    pub names: NamesArgs,
}

/// Shows live traffic until the user stops it.
pub(crate) fn monitor(args: MonitorArgs) -> Result<Exit, Failure> {
    let bus = args.bus.chosen();
    let options = args.options;
    let NamedNodes { sheets, database } = args.names.nodes()?;
    let database = match &options.dbc {
        None => database,
        Some(path) => {
            let (shown, read) = (
                path.display(),
                scenario::read_text(path, plan::FILE_BYTES_MAX),
            );
            let text = read.map_err(|error| {
                Exit::Usage.because(format!("`{shown}` cannot be read: {error}"))
            })?;
            Database::parse(&text)
                .map_err(|error| Exit::Usage.because(format!("`{shown}`: {error}")))?
        }
    };
    let (count, duration) = (options.count, options.duration);
    let mut decoder = Decoder::new(database, sheets, options);
    let stop = stop_signal()?;
    let mut bus = open(&bus, &[Filter::ALL, Filter::ERRORS])?;
    bus.count_fd_frames();
    let clock = Clock::start();
    let is_over = |lines: u64| {
        count.is_some_and(|count| lines >= count)
            || duration.is_some_and(|seconds| clock.now().as_secs_f64() >= seconds)
            || stop.is_raised()
    };
    let mut received = Ok(None);
    print_with(|output| {
        let mut lines = 0;
        while !is_over(lines) {
            // The output is buffered while the bus is busy, and flushed when it is quiet.
            received = bus.receive(Duration::ZERO);
            if let Ok(None) = received {
                output.flush()?;
                received = bus.receive(PATIENCE);
            }
            let Ok(frame) = &received else {
                break;
            };
            if let Some(line) = frame.and_then(|frame| decoder.line(clock.now(), &frame)) {
                writeln!(output, "{}", printable(&line))?;
                lines += 1;
            }
        }
        Ok(())
    });
    received?;
    if bus.dropped() > 0 {
        print_problem(format!(
            "{} frames were lost: they came faster than they could be shown (show fewer with --only, --except or --changes)",
            bus.dropped()
        ));
    }
    if bus.fd_frames() > 0 {
        print_problem(format!(
            "{} CAN FD frames were on the bus and are not shown: canrig reads classic CAN",
            bus.fd_frames()
        ));
    }
    Ok(Exit::Pass)
}

#[cfg(test)]
mod tests {
    use super::*;
    use can::frame::{ERROR_FLAG, EXTENDED_FLAG};
    use plan::data_sheet::rig_data_sheets;
    use proptest::prelude::*;

    fn decoder(options: MonitorOptions) -> Decoder {
        Decoder::new(Database::shipped().clone(), rig_data_sheets(), options)
    }

    /// Returns the line without its time.
    fn line(frame: &CanFrame) -> String {
        let line = decoder(MonitorOptions::default()).line(Duration::from_millis(1500), frame);
        line.unwrap()
            .strip_prefix("    1.500000  ")
            .unwrap()
            .to_owned()
    }

    #[test]
    fn signals_come_with_units_and_labels() {
        let frame = CanFrame::new(0x190, &[0x37, 0x12, 0x10, 0x27, 0, 0, 0x2C, 1]);
        let line = line(&frame);
        assert!(line.starts_with("     190  drive_tpdo1 "), "{line}");
        for part in [
            "statusword_state=\"operation enabled\"",
            "statusword_follows_command=\"yes\"",
            "position_millimetres=10.000 mm",
            "current_amperes=0.300 A",
        ] {
            assert!(line.contains(part), "{part} in {line}");
        }
    }

    #[test]
    fn nodes_of_a_rig_are_shown_by_its_names() {
        let rig = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../crates/worlds/tests/data/two_axes_rig.toml"
        );
        let rig = NamesArgs {
            rig: Some(rig.into()),
        };
        let NamedNodes { sheets, database } = rig.nodes().unwrap();
        let mut decoder = Decoder::new(database, sheets, MonitorOptions::default());
        for (id, data, expected) in [
            (
                0x192,
                &[0x37, 0x12, 0x10, 0x27, 0, 0, 0x2C, 1][..],
                "y_tpdo1",
            ),
            (0x212, &[0x0F, 0, 0, 0], "y_rpdo1"),
            (0x190, &[0x37, 0x12, 0x10, 0x27, 0, 0, 0x2C, 1], "x_tpdo1"),
            (0x701, &[5], "controller_heartbeat"),
            (0x692, &[0x40, 0x18, 0x10, 2, 0, 0, 0, 0], "y_sdo2_request"),
            (0x712, &[5], "y_heartbeat"),
            (0x000, &[1, 0x12], "nmt_node_id=\"y\""),
            (0x492, &[0; 8], "y TPDO4"),
        ] {
            let line = decoder
                .line(Duration::ZERO, &CanFrame::new(id, data))
                .unwrap();
            assert!(line.contains(expected), "{expected} in {line}");
        }
    }

    #[test]
    fn sdo_is_described_by_the_names_of_the_eds() {
        for (id, data, expected) in [
            (
                0x610,
                [0x40, 0x18, 0x10, 2, 0, 0, 0, 0],
                "read 0x1018:02 Product code",
            ),
            (
                0x590,
                [0x43, 0x18, 0x10, 2, 1, 0, 0, 0],
                "is 0x1018:02 Product code = 1 (0x00000001)",
            ),
            (
                0x690,
                [0x2B, 0x71, 0x60, 0, 0xFE, 0xFF, 0, 0],
                "write 0x6071:00 Target torque = -2",
            ),
            (
                0x6D0,
                [0x60, 0x71, 0x60, 0, 0, 0, 0, 0],
                "written 0x6071:00 Target torque",
            ),
            (
                0x591,
                [0x80, 0, 0x20, 0, 0, 0, 2, 6],
                "0x2000:00: abort 0x0602_0000: object does not exist in the object dictionary",
            ),
            (
                0x5A0,
                [0x43, 0x18, 0x10, 2, 1, 0, 0, 0],
                "is 0x1018:02 = 01 00 00 00 (4 bytes)",
            ),
        ] {
            let line = line(&CanFrame::new(id, &data));
            assert!(line.ends_with(expected), "{expected} at the end of {line}");
        }
    }

    #[test]
    fn nodes_that_are_not_in_the_dbc_are_described_by_canopen() {
        for (id, data, expected) in [
            (
                0x722,
                &[0x7F][..],
                "node 34 heartbeat        pre-operational",
            ),
            (
                0x0A2,
                &[0x10, 0x81, 0x11, 0, 0, 0, 0, 0],
                "error code 0x8110, error register 0x11",
            ),
            (0x2A2, &[1, 2], "node 34 TPDO2            01 02"),
            (0x222, &[1], "node 34 RPDO1            01"),
            (0x7E5, &[1], "unknown                  01"),
        ] {
            let line = line(&CanFrame::new(id, data));
            assert!(line.ends_with(expected), "{expected} at the end of {line}");
        }
    }

    #[test]
    fn options_choose_frames() {
        let (drive, sync) = (CanFrame::new(0x190, &[0; 8]), CanFrame::new(0x080, &[1]));
        let now = Duration::ZERO;
        for pattern in ["drive_tpdo1", "drive", "0x190", "190"] {
            let only = MonitorOptions {
                only: vec![pattern.to_owned()],
                ..MonitorOptions::default()
            };
            let mut chosen = decoder(only);
            assert!(
                chosen.line(now, &drive).is_some() && chosen.line(now, &sync).is_none(),
                "{pattern}"
            );
            let except = MonitorOptions {
                except: vec![pattern.to_owned()],
                ..MonitorOptions::default()
            };
            let mut chosen = decoder(except);
            assert!(
                chosen.line(now, &drive).is_none() && chosen.line(now, &sync).is_some(),
                "{pattern}"
            );
        }
        let mut changes = decoder(MonitorOptions {
            changes: true,
            ..MonitorOptions::default()
        });
        assert!(changes.line(now, &drive).is_some());
        assert!(changes.line(now, &drive).is_none());
        assert!(changes.line(now, &CanFrame::new(0x190, &[1; 8])).is_some());
        let mut raw = decoder(MonitorOptions {
            raw: true,
            ..MonitorOptions::default()
        });
        assert!(raw.line(now, &sync).unwrap().contains("[01 "));
    }

    proptest! {
        #[test]
        fn any_frame_has_a_line(id: u32, length in 0u8..=8, data: [u8; 8], raw: bool) {
            let mut decoder = decoder(MonitorOptions { raw, ..MonitorOptions::default() });
            for id in [id, id & 0x7FF, id | EXTENDED_FLAG, id | ERROR_FLAG] {
                let frame = CanFrame::from_raw(id, length, data).unwrap();
                prop_assert!(decoder.line(Duration::ZERO, &frame).is_some());
            }
        }
    }
}
