//! Columns of a timeline, with one value for each cycle. Most signals keep a value for long, so many rows are filled at a time,
//! and only the signals whose bits changed are decoded.

use can::CanFrame;
use dbc::{Database, SignalHandle, SignalMissing};
use plan::ControlLoop;
use plan::catalogue::ColumnMessage;
use platform::series::SeriesWriter;

use super::decoded::Column;

/// Columns of all messages, in their order.
pub(super) struct Columns(Vec<MessageColumns>);

impl Columns {
    /// Makes columns that keep at most `kept_max` rows of each signal in memory.
    pub(super) fn new(database: &Database, one: &ControlLoop, kept_max: usize) -> Self {
        let messages = one.columns(database);
        Self(
            messages
                .map(|one| MessageColumns::new(one, kept_max))
                .collect(),
        )
    }

    /// Returns the index of the column of a signal in a timeline, whose first column is the set-point.
    pub(super) fn place(&self, name: &str) -> Result<usize, SignalMissing> {
        let mut signals = self.0.iter().flat_map(|message| &message.signals);
        let place = signals.position(|signal| signal.name == name);
        Ok(1 + place.ok_or_else(|| SignalMissing::new(name))?)
    }

    /// Returns the identifiers of the messages.
    pub(super) fn raw_ids(&self) -> impl Iterator<Item = u32> {
        self.0.iter().map(|message| message.raw_id)
    }

    /// Takes a frame of the latest of `rows` cycles. A value that is measured after the end of that cycle belongs to no cycle.
    pub(super) fn on_frame(&mut self, frame: &CanFrame, rows: usize, is_late: bool) {
        let mut messages = self.0.iter_mut();
        let message = messages.find(|message| message.raw_id == frame.raw_id());
        if let Some(message) = message.filter(|message| !(is_late && message.is_measured)) {
            message.on_frame(frame, rows);
        }
    }

    /// Takes the first rows out.
    pub(super) fn take_rows(&mut self, rows: usize) -> Vec<Column> {
        let messages = self.0.iter_mut();
        messages
            .flat_map(|message| message.take_rows(rows))
            .collect()
    }
}

/// Signal that becomes a column.
struct SignalColumn {
    handle: SignalHandle,
    name: String,
    unit: String,
    is_term: bool,
    /// Value from the first missing row on.
    latest: f64,
    /// Rows up to the last change.
    rows: SeriesWriter<f64>,
}

impl SignalColumn {
    /// Sets another value from a row on.
    fn change(&mut self, row: usize, value: f64) {
        self.fill(row);
        self.latest = value;
    }

    /// Fills all rows before this one.
    fn fill(&mut self, row: usize) {
        match row.saturating_sub(self.rows.len()) {
            0 => {}
            // A signal that changes in each cycle.
            1 => self.rows.push(self.latest),
            _ => self.rows.fill(row, self.latest),
        }
    }

    fn take_column(&mut self, rows: usize) -> Column {
        self.fill(rows);
        Column {
            name: self.name.clone(),
            unit: self.unit.clone(),
            is_term: self.is_term,
            values: self.rows.take(rows),
        }
    }
}

/// Message whose signals become columns.
struct MessageColumns {
    raw_id: u32,
    signals: Vec<SignalColumn>,
    /// Whether its values are measured and belong to their cycle; other values hold until they change.
    is_measured: bool,
    /// Whether a value that was cut in its field is not known.
    is_of_plant: bool,
    /// Latest frame; `None` if it was too short for a signal, or if its values do not hold any more.
    latest: Option<CanFrame>,
    /// Number of rows when it came.
    rows: usize,
}

impl MessageColumns {
    fn new(columns: ColumnMessage<'_>, kept_max: usize) -> Self {
        let message = columns.message;
        let signals = columns.signals.into_iter();
        let signals = signals.map(|(name, signal)| SignalColumn {
            handle: message.handle(signal),
            name,
            unit: signal.unit.clone(),
            is_term: columns.is_term,
            latest: f64::NAN,
            rows: SeriesWriter::keeping(kept_max),
        });
        Self {
            raw_id: message.raw_id,
            signals: signals.collect(),
            is_measured: columns.is_measured,
            is_of_plant: columns.is_of_plant,
            latest: None,
            rows: 0,
        }
    }

    fn on_frame(&mut self, frame: &CanFrame, rows: usize) {
        // The latest row is not over, and there is none before the first cycle.
        let row = rows.saturating_sub(1);
        self.end_before(row);
        let changed = self.changed_bits(frame);
        let mut is_whole = true;
        for signal in &mut self.signals {
            if signal.handle.mask() & changed == 0 {
                continue;
            }
            if let Some(value) = signal.handle.decode(frame) {
                let is_cut = self.is_of_plant && signal.handle.is_cut(frame);
                signal.change(row, if is_cut { f64::NAN } else { value });
                continue;
            }
            is_whole = false;
            if self.is_measured && self.rows < rows {
                signal.change(row, f64::NAN);
            }
        }
        self.latest = is_whole.then_some(*frame);
        self.rows = rows;
    }

    /// Returns the bits by which the frame differs from the latest; all if they cannot be compared.
    fn changed_bits(&self, frame: &CanFrame) -> u64 {
        let bits = |frame: &CanFrame| u64::from_le_bytes(frame.buffer());
        match &self.latest {
            Some(latest) if latest.data().len() == frame.data().len() => bits(latest) ^ bits(frame),
            _ => u64::MAX,
        }
    }

    /// Ends measured values that were not sent again, from the cycle after theirs to this row.
    fn end_before(&mut self, row: usize) {
        if self.is_measured && self.rows < row {
            for signal in &mut self.signals {
                signal.change(self.rows, f64::NAN);
            }
            self.latest = None;
        }
    }

    /// Takes the first rows out.
    fn take_rows(&mut self, rows: usize) -> impl Iterator<Item = Column> {
        self.end_before(rows);
        self.rows = self.rows.saturating_sub(rows);
        let signals = self.signals.iter_mut();
        signals.map(move |signal| signal.take_column(rows))
    }
}
