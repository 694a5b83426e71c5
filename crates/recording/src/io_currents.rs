//! Currents that io nodes let flow through the plants of a loop, by the commands to them and by
//! their own watch over their manager.

use std::time::Duration;

use can::CanFrame;
use canopen::nmt::{COMMAND_ID, ERROR_CONTROL_ID, NmtCommand};
use canopen::sdo::DEFAULT_REQUEST_ID;
use dbc::node_objects::{CONSUMER_HEARTBEAT_TIME, IO_WATCH_MILLISECONDS};
use dbc::{Database, SignalHandle, names};
use plan::ControlLoop;

/// Largest number of spans that are kept.
const SPANS_MAX: usize = 100_000;
/// Client's command that begins to write an object.
const SDO_DOWNLOAD: u8 = 1;

/// Reader of the currents that io nodes are commanded to let flow.
pub(crate) struct IoCurrentReader {
    manager: u8,
    /// Time of the manager's latest heartbeat.
    beat: Option<Duration>,
    nodes: Vec<IoNode>,
    /// Spans of scenario time in which some node let a current flow.
    spans: Vec<(f64, f64)>,
}

struct IoNode {
    id: u8,
    /// Identifier of its commands.
    raw_id: u32,
    /// Outputs in amperes and volts.
    outputs: Vec<SignalHandle>,
    /// Time after which it misses its manager (0x1016).
    watch: Duration,
    /// Whether it follows commands: not after it was stopped or reset, or has missed its manager,
    /// until it is started again.
    is_operational: bool,
    /// Time since which its outputs let a current flow.
    since: Option<Duration>,
}

impl IoCurrentReader {
    pub(crate) fn new(database: &Database, one: &ControlLoop) -> Self {
        let nodes = one.trial.wiring.io_nodes().filter_map(|io| {
            let io = one.node(io);
            let commands = names::message(&io.name, names::RPDO1);
            let mut columns = one.columns(database);
            let column = columns.find(|column| column.message.name == commands)?;
            let mut outputs = column.signals;
            outputs.retain(|(_, signal)| signal.unit.ends_with(['A', 'V']));
            let handles = outputs
                .iter()
                .map(|(_, signal)| column.message.handle(signal));
            let node = IoNode {
                id: io.id(),
                raw_id: column.message.raw_id,
                outputs: handles.collect(),
                watch: Duration::from_millis(IO_WATCH_MILLISECONDS.into()),
                is_operational: true,
                since: None,
            };
            (!node.outputs.is_empty()).then_some(node)
        });
        Self {
            manager: one.controller().id(),
            beat: None,
            nodes: nodes.collect(),
            spans: Vec::new(),
        }
    }

    /// Returns the identifiers of the frames that it reads.
    pub(crate) fn raw_ids(&self) -> impl Iterator<Item = u32> {
        let own = self.nodes.iter().flat_map(|node| {
            let [heartbeat, request] = [ERROR_CONTROL_ID, DEFAULT_REQUEST_ID]
                .map(|base| u32::from(base) + u32::from(node.id));
            [node.raw_id, heartbeat, request]
        });
        let heartbeat = u32::from(ERROR_CONTROL_ID) + u32::from(self.manager);
        let of_manager = [u32::from(COMMAND_ID), heartbeat].into_iter();
        of_manager.filter(|_| !self.nodes.is_empty()).chain(own)
    }

    /// Takes a frame with one of these identifiers.
    pub(crate) fn on_frame(&mut self, time: Duration, frame: &CanFrame) {
        let Some(id) = frame.standard_id().filter(|_| !self.nodes.is_empty()) else {
            return;
        };
        self.miss_manager(time);
        if id == ERROR_CONTROL_ID + u16::from(self.manager) {
            self.beat = Some(time);
        }
        for node in &mut self.nodes {
            let is_own = |base: u16| id == base + u16::from(node.id);
            match frame.data() {
                &[specifier, addressee, ..]
                    if id == COMMAND_ID && [0, node.id].contains(&addressee) =>
                {
                    node.is_operational = specifier == NmtCommand::Start.specifier();
                    let keeps = [NmtCommand::Start, NmtCommand::EnterPreOperational];
                    if !keeps.iter().any(|keeps| keeps.specifier() == specifier) {
                        node.end(time, &mut self.spans);
                    }
                }
                [0] if is_own(ERROR_CONTROL_ID) => {
                    node.is_operational = false;
                    node.end(time, &mut self.spans);
                }
                &[command, low, high, _, a, b, watched, _]
                    if is_own(DEFAULT_REQUEST_ID)
                        && command >> 5 == SDO_DOWNLOAD
                        && u16::from_le_bytes([low, high]) == CONSUMER_HEARTBEAT_TIME
                        && watched == self.manager =>
                {
                    node.watch = Duration::from_millis(u16::from_le_bytes([a, b]).into());
                }
                _ if frame.raw_id() == node.raw_id && node.is_operational => {
                    let flows = |output: &SignalHandle| {
                        output.decode(frame).is_some_and(|value| value != 0.0)
                    };
                    if node.outputs.iter().any(flows) {
                        node.since.get_or_insert(time);
                    } else {
                        node.end(time, &mut self.spans);
                    }
                }
                _ => {}
            }
        }
    }

    /// Lets the nodes put out their error values that have not heard their manager for too long: no
    /// current.
    fn miss_manager(&mut self, now: Duration) {
        let Some(beat) = self.beat else { return };
        for node in &mut self.nodes {
            let is_watching = node.is_operational && !node.watch.is_zero();
            if is_watching && now > beat + node.watch {
                node.is_operational = false;
                node.end(beat + node.watch, &mut self.spans);
            }
        }
    }

    /// Takes all spans; `latest` is the scenario time of the last frame before the end.
    pub(crate) fn take_all(&mut self, latest: Duration) -> Vec<(f64, f64)> {
        self.miss_manager(latest);
        let flowing = self.nodes.iter().filter_map(|node| node.since);
        let flowing = flowing.map(|since| (since.as_secs_f64(), f64::INFINITY));
        self.spans.extend(Vec::from_iter(flowing));
        std::mem::take(&mut self.spans)
    }
}

impl IoNode {
    fn end(&mut self, time: Duration, spans: &mut Vec<(f64, f64)>) {
        if let Some(since) = self.since.take()
            && spans.len() < SPANS_MAX
        {
            spans.push((since.as_secs_f64(), time.as_secs_f64()));
        }
    }
}
