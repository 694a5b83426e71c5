//! Connection of the bench to the bus of a run in real time: the recorder, and a place for its own nodes.

use std::time::Duration;

use can::Filter;
use platform::bus::{Bus, BusAddress, BusError};
use platform::hub::Hub;
use platform::link::link;
use platform::private_bus::PrivateBus;
use platform::recorder::Recorder;
use platform::stop::{StopSignal, Stopper};

use crate::bus_choice::RunBus;
use crate::error::WorldError;
use crate::names::BENCH;
use crate::senders::Senders;
use plan::Plan;
use recording::capture::Capture;
use recording::log::Stamped;

/// Period at which the recorded frames are taken and written.
pub(super) const COLLECT_PERIOD: Duration = Duration::from_millis(20);

/// Makes a stop signal for a thread of the bench.
pub(super) fn stop_signal() -> Result<(Stopper, StopSignal), WorldError> {
    StopSignal::manual().map_err(WorldError::spawn(BENCH))
}

/// Bus of a run with the recorder on it.
pub struct BusConnection {
    address: BusAddress,
    recorder: Recorder,
    hub: Option<Hub>,
    senders: Senders,
    private: Option<PrivateBus>,
    /// Whether the bus has no wire: every node on it runs on this machine.
    is_of_this_machine: bool,
}

impl BusConnection {
    /// Joins the bus of a run of the plan, or makes it.
    ///
    /// # Errors
    /// If the bus is not available.
    pub fn open(bus: &RunBus, plan: &Plan) -> Result<Self, WorldError> {
        let (mut hub, mut private) = (None, None);
        let (address, recorder) = match bus {
            RunBus::Embedded { .. } => {
                let (made, recorder) = Hub::start()?;
                (hub.insert(made).address(), recorder)
            }
            RunBus::Interface(name) => {
                let address = BusAddress::Interface(name.clone());
                (address, Recorder::on_interface(name)?)
            }
            RunBus::Private => {
                let made = private.insert(PrivateBus::start().map_err(WorldError::Private)?);
                (BusAddress::Private(made.process()), made.recorder()?)
            }
        };
        let is_of_this_machine = match bus {
            RunBus::Embedded { .. } | RunBus::Private => true,
            RunBus::Interface(name) => link(name).is_ok_and(|link| link.is_virtual),
        };
        Ok(Self {
            address,
            recorder,
            hub,
            senders: Senders::new(plan),
            private,
            is_of_this_machine,
        })
    }

    /// Returns the address at which other programs find the bus.
    pub fn address(&self) -> &BusAddress {
        &self.address
    }

    /// Returns the nodes that canrig did not start and that stand still with this machine.
    pub(super) fn on_this_machine(&self, plan: &Plan) -> Vec<String> {
        if self.is_of_this_machine {
            plan.expected_names()
        } else {
            Vec::new()
        }
    }

    /// Returns the senders that were heard so far, if the bus knows the process of each.
    pub(super) fn senders(&self) -> Option<&Senders> {
        self.hub.as_ref().map(|_| &self.senders)
    }

    /// Joins the bus as a node of the bench itself.
    pub(super) fn join(&mut self, filters: &[Filter]) -> Result<Box<dyn Bus>, BusError> {
        match &mut self.private {
            Some(private) => private.join(filters),
            None => platform::open(&self.address, filters),
        }
    }

    /// Converts a time of the system's monotonic clock to the clock of the recording.
    pub(super) fn recorded_time(&self, time: Duration) -> Duration {
        self.recorder.clock.wall_epoch() + self.recorder.clock.from_monotonic(time)
    }

    /// Returns the step of the clock of the stamps; zero on an embedded bus, whose clock is monotonic.
    pub(super) fn wall_clock_step(&self) -> Duration {
        if self.hub.is_some() {
            Duration::ZERO
        } else {
            self.recorder.clock.wall_clock_step()
        }
    }

    /// Gives the capture the frames recorded since the last call.
    pub(crate) fn collect(&mut self, capture: &mut Capture<'_>) -> Result<(), WorldError> {
        let epoch = self.recorder.clock.wall_epoch();
        while let Some(received) = self.recorder.next() {
            let time = epoch + received.time;
            self.senders.hear(time, &received);
            capture.record(Stamped::new(time, received.frame));
        }
        Ok(capture.flush()?)
    }

    /// As [`Self::collect`], after all nodes have left, with their last frames.
    pub(crate) fn collect_rest(&mut self, capture: &mut Capture<'_>) -> Result<(), WorldError> {
        if self.hub.is_some() {
            drop(self.join(&[])?);
        }
        self.collect(capture)
    }

    /// Discards the frames that were recorded since the last call; who sent them is known from then on.
    pub fn discard(&mut self) {
        while let Some(received) = self.recorder.next() {
            self.senders.hear(received.time, &received);
        }
        self.senders.forget_foreign();
    }

    /// Ends the bus; gives the capture the last frames, the number of frames that were not recorded, and those that no node of the
    /// run sent.
    ///
    /// # Errors
    /// If the recording cannot be written.
    pub fn close(mut self, capture: &mut Capture<'_>, plan: &Plan) -> Result<(), WorldError> {
        self.recorder.stop();
        let is_hub = self.hub.take().is_some();
        capture.unrecorded.frames_lost += self.recorder.lost();
        capture.unrecorded.fd_frames += self.recorder.fd_frames();
        self.collect(capture)?;
        let foreign = self.senders.foreign(capture.zero(), plan.duration());
        capture.unrecorded.foreign = is_hub.then_some(foreign);
        Ok(())
    }
}
