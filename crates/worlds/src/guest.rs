//! Guest on a bus: hears what others send, asks nodes for objects, and may send a manager's heartbeat meanwhile.

use std::time::Duration;

use can::CanFrame;
use canopen::NmtState;
use canopen::nmt::ERROR_CONTROL_ID;
use canopen::sdo_client::{SdoClient, SdoError};
use platform::bus::{Bus, BusError};
use platform::clock::Clock;

/// Longest wait after which the guest looks whether it is to stop.
const LOOK: Duration = Duration::from_millis(20);
/// Period of the heartbeat, short enough for another bench's pre-flight, and for a drive that watches its manager for 100 ms.
const HEARTBEAT_PERIOD: Duration = Duration::from_millis(50);

/// Reason why a guest could not do what it was asked for.
#[derive(Debug, thiserror::Error)]
pub enum GuestError {
    /// The bus does not work.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The guest was asked to stop.
    #[error("interrupted")]
    Interrupted,
}

/// Guest that hears the frames of its bus's filters. Its own frames do not come back.
pub struct Guest<'a> {
    bus: Box<dyn Bus>,
    clock: Clock,
    is_to_stop: Box<dyn Fn() -> bool + Send + 'a>,
    /// Heartbeat of the manager, and the time of the next one.
    heartbeat: Option<(CanFrame, Duration)>,
}

impl<'a> Guest<'a> {
    /// Makes a guest on a bus.
    pub fn new(bus: Box<dyn Bus>, is_to_stop: impl Fn() -> bool + Send + 'a) -> Self {
        Self {
            bus,
            clock: Clock::start(),
            is_to_stop: Box::new(is_to_stop),
            heartbeat: None,
        }
    }

    /// Lets it send the heartbeat of a manager with this node-ID that does not lead yet, as long as it waits for frames.
    pub(crate) fn keep_place_of(&mut self, manager: u8) {
        let identifier = ERROR_CONTROL_ID + u16::from(manager);
        let heartbeat = CanFrame::new(identifier, &[NmtState::PreOperational.number()]);
        self.heartbeat = Some((heartbeat, Duration::ZERO));
    }

    /// Sends a frame.
    ///
    /// # Errors
    /// If the bus does not take it.
    pub fn send(&mut self, frame: &CanFrame) -> Result<(), GuestError> {
        Ok(self.bus.send(frame)?)
    }

    /// Passes on the frames that come within a time.
    ///
    /// # Errors
    /// If the bus fails, or the guest is to stop.
    pub fn hear(
        &mut self,
        time: Duration,
        mut heard: impl FnMut(&CanFrame),
    ) -> Result<(), GuestError> {
        let until = self.clock.now() + time;
        while let Some(frame) = self.next_until(until)? {
            heard(&frame);
        }
        Ok(())
    }

    /// Reads an object, or writes it; returns the node's answer. Passes on the frames that come in the meantime.
    ///
    /// # Errors
    /// If the bus fails, or the guest is to stop.
    pub fn transfer(
        &mut self,
        client: &mut SdoClient,
        object: (u16, u8),
        written: Option<&[u8]>,
        mut heard: impl FnMut(&CanFrame),
    ) -> Result<Result<Vec<u8>, SdoError>, GuestError> {
        let now = self.clock.now();
        let started = match written {
            Some(bytes) => client.start_download(now, object, bytes),
            None => client.start_upload(now, object),
        };
        if let Err(error) = started {
            return Ok(Err(error));
        }
        loop {
            while let Some(frame) = client.next_frame() {
                self.send(&frame)?;
            }
            if let Some(result) = client.take_result() {
                return Ok(result);
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
    ///
    /// # Errors
    /// If the bus fails, or the guest is to stop.
    pub(crate) fn next_until(&mut self, until: Duration) -> Result<Option<CanFrame>, GuestError> {
        loop {
            if (self.is_to_stop)() {
                return Err(GuestError::Interrupted);
            }
            let now = self.clock.now();
            let mut wait = until.saturating_sub(now).min(LOOK);
            if wait.is_zero() {
                return Ok(None);
            }
            if let Some((heartbeat, next)) = &mut self.heartbeat {
                if *next <= now {
                    self.bus.send(heartbeat)?;
                    *next = now + HEARTBEAT_PERIOD;
                }
                wait = wait.min(*next - now);
            }
            let frame = self.bus.receive(wait)?;
            if frame.is_some() {
                return Ok(frame);
            }
        }
    }
}
