//! Guest on a bus: hears what others send, and asks nodes for objects.

use std::time::Duration;

use can::{CanFrame, Filter};
use canopen::sdo_client::SdoClient;
use platform::bus::Bus;
use platform::clock::Clock;
use platform::stop::StopSignal;

use plan::data_sheet::DataSheet;

use super::{ToolBus, ToolError, open};

/// Time within which a node answers a guest.
const ANSWER_TIME: Duration = Duration::from_secs(1);
/// Longest wait after which the guest looks whether it is to stop.
const LOOK: Duration = Duration::from_millis(20);

/// Returns the second SDO channel of a node, if one of its data sheets has it.
pub(crate) fn second_channel(node_id: u8, sheets: &[DataSheet]) -> Option<(u16, u16)> {
    let mut sheets = sheets.iter().filter(|sheet| sheet.node_id == node_id);
    sheets.find_map(DataSheet::second_channel)
}

/// Guest that hears all frames.
pub(crate) struct Guest {
    bus: Box<dyn Bus>,
    clock: Clock,
    stop: StopSignal,
}

impl Guest {
    /// Joins a bus.
    pub(crate) fn join(bus: &ToolBus) -> Result<Self, ToolError> {
        Ok(Self {
            bus: open(bus, &[Filter::ALL])?,
            clock: Clock::start(),
            stop: StopSignal::from_signals().map_err(ToolError::Signals)?,
        })
    }

    pub(crate) fn send(&mut self, frame: &CanFrame) -> Result<(), ToolError> {
        Ok(self.bus.send(frame)?)
    }

    /// Passes on the frames that come within a time.
    pub(crate) fn hear(
        &mut self,
        time: Duration,
        mut heard: impl FnMut(&CanFrame),
    ) -> Result<(), ToolError> {
        let until = self.clock.now() + time;
        while let Some(frame) = self.next_until(until)? {
            heard(&frame);
        }
        Ok(())
    }

    /// Returns a client of a node: on its default channel, or on another one.
    pub(crate) fn client(node_id: u8, channel: Option<(u16, u16)>) -> SdoClient {
        let client = SdoClient::new(node_id).with_timeout(ANSWER_TIME);
        match channel {
            Some((request, response)) => client.with_channel(request, response),
            None => client,
        }
    }

    /// Reads an object, or writes it. Passes on the frames that come in the meantime.
    pub(crate) fn transfer(
        &mut self,
        client: &mut SdoClient,
        (index, sub_index): (u16, u8),
        written: Option<&[u8]>,
        mut heard: impl FnMut(&CanFrame),
    ) -> Result<Vec<u8>, ToolError> {
        let now = self.clock.now();
        match written {
            Some(bytes) => client.start_download(now, index, sub_index, bytes),
            None => client.start_upload(now, index, sub_index),
        }?;
        loop {
            while let Some(frame) = client.next_frame() {
                self.send(&frame)?;
            }
            if let Some(result) = client.take_result() {
                return Ok(result?);
            }
            let until = client.next_deadline().unwrap_or_default();
            match self.next_until(until)? {
                Some(frame) => {
                    heard(&frame);
                    client.on_frame(self.clock.now(), &frame);
                }
                None => client.on_tick(self.clock.now()),
            }
        }
    }

    /// Returns the next frame; `None` when the time is reached.
    fn next_until(&mut self, until: Duration) -> Result<Option<CanFrame>, ToolError> {
        loop {
            if self.stop.is_raised() {
                return Err(ToolError::Interrupted);
            }
            let left = until.saturating_sub(self.clock.now());
            if left.is_zero() {
                return Ok(None);
            }
            let frame = self.bus.receive(left.min(LOOK))?;
            if frame.is_some() {
                return Ok(frame);
            }
        }
    }
}
