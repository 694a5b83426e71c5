//! Place of the bench on its bus, so that no other bench leads there at the same time.
//!
//! On one machine the interface is claimed. Benches of other machines hear the manager's heartbeat in their pre-flight: our
//! controller sends it while it runs; before and between, the interview and a [`Vigil`] send it.

use std::thread::JoinHandle;
use std::time::Duration;

use can::{CanFrame, Filter, Node, Progress};
use canopen::NmtState;
use dbc::scenario_clock::SYNC_COB_ID;
use plan::data_sheet::{DataSheet, data_sheets_led_by};
use plan::presence::Presence;
use platform::bus::BusAddress;
use platform::claim::{Claim, ClaimError};
use platform::real_time::{RunError, RunReport};
use platform::stop::Stopper;

use crate::bus_choice::RunBus;
use crate::bus_connection::stop_signal;
use crate::error::WorldError;
use crate::names::BENCH;

/// Period of the heartbeat, short enough for another bench's pre-flight, and for a drive that watches its manager for 100 ms.
const HEARTBEAT_PERIOD: Duration = Duration::from_millis(50);

/// Takes the interface, so that no other bench of this machine uses it meanwhile. Buses that canrig makes for a run need no claim.
///
/// # Errors
/// If another bench has it; the text names its process.
pub fn claim(bus: &RunBus) -> Result<Option<Claim>, WorldError> {
    let RunBus::Interface(name) = bus else {
        return Ok(None);
    };
    let claim = Claim::on(name).map_err(|error| match error {
        ClaimError::Taken { .. } => WorldError::SecondMaster(error.to_string()),
        ClaimError::System { .. } => WorldError::Claim(error),
    });
    claim.map(Some)
}

/// Heartbeat of a manager that does not lead yet.
#[derive(Debug)]
pub(crate) struct ManagerHeartbeat {
    identifier: u16,
    next: Option<Duration>,
}

impl ManagerHeartbeat {
    /// Makes the heartbeat of a manager with this node-ID.
    pub(crate) fn of(manager: u8) -> Self {
        Self {
            identifier: canopen::nmt::ERROR_CONTROL_ID + u16::from(manager),
            next: None,
        }
    }

    /// Starts the heartbeat, if it has not started.
    pub(crate) fn start(&mut self, now: Duration) {
        self.next.get_or_insert(now);
    }

    /// Returns the frame, once its time has come.
    pub(crate) fn due(&mut self, now: Duration) -> Option<CanFrame> {
        self.next.filter(|next| *next <= now)?;
        self.next = Some(now + HEARTBEAT_PERIOD);
        let state = NmtState::PreOperational.number();
        Some(CanFrame::new(self.identifier, &[state]))
    }

    pub(crate) fn next_deadline(&self) -> Option<Duration> {
        self.next
    }
}

/// Node that sends the manager's heartbeat, and listens for another manager.
#[derive(Debug)]
struct Watchman {
    heartbeat: ManagerHeartbeat,
    presence: Presence,
    sheets: Vec<DataSheet>,
    frame: Option<CanFrame>,
    is_stopped: bool,
}

impl Watchman {
    fn new(manager: u8) -> Self {
        Self {
            heartbeat: ManagerHeartbeat::of(manager),
            presence: Presence::default(),
            sheets: data_sheets_led_by(manager),
            frame: None,
            is_stopped: false,
        }
    }
}

impl Node for Watchman {
    fn filters(&self) -> Vec<Filter> {
        vec![
            Filter::exact(SYNC_COB_ID),
            Filter::exact(self.heartbeat.identifier),
        ]
    }

    fn on_frame(&mut self, _now: Duration, frame: &CanFrame) {
        self.presence.on_frame(frame);
    }

    fn on_tick(&mut self, now: Duration) {
        self.heartbeat.start(now);
        self.frame = self.heartbeat.due(now);
    }

    fn on_stop(&mut self, _now: Duration) {
        self.is_stopped = true;
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        self.frame.take()
    }

    fn next_deadline(&self) -> Option<Duration> {
        self.heartbeat.next_deadline().or(Some(Duration::ZERO))
    }

    fn progress(&self) -> Progress {
        match self.presence.manager(&self.sheets) {
            Some(manager) => Progress::Failed(format!("{manager} is heard; end the other bench")),
            None if self.is_stopped => Progress::Stopped,
            None => Progress::Running,
        }
    }
}

/// Keeps the place while no controller of ours runs. Use it only after an orderly stop: if a controller was lost, the silence of
/// its heartbeat makes the drive switch the current off.
#[derive(Debug)]
pub struct Vigil {
    /// Thread that keeps the place; `None` on a private bus, which no other bench can join.
    kept: Option<(Stopper, JoinHandle<Result<RunReport, RunError>>)>,
}

impl Vigil {
    /// Begins on an existing bus, for a manager with this node-ID.
    ///
    /// # Errors
    /// If the bus cannot be joined.
    pub fn begin(address: &BusAddress, manager: u8) -> Result<Self, WorldError> {
        if let BusAddress::Private(_) = address {
            return Ok(Self { kept: None });
        }
        let mut watchman = Watchman::new(manager);
        let mut bus = platform::open(address, &watchman.filters())?;
        let (stopper, stop) = stop_signal()?;
        let thread = std::thread::Builder::new().name("vigil".into());
        let thread =
            thread.spawn(move || platform::real_time::run(&mut watchman, &mut *bus, &stop));
        let thread = thread.map_err(WorldError::spawn(BENCH))?;
        Ok(Self {
            kept: Some((stopper, thread)),
        })
    }

    /// Returns whether it ended by itself; [`Vigil::end`] gives the reason.
    pub fn is_broken(&self) -> bool {
        let kept = self.kept.as_ref();
        kept.is_some_and(|(_, thread)| thread.is_finished())
    }

    /// Ends the vigil.
    ///
    /// # Errors
    /// If another manager was heard, or the bus failed.
    pub fn end(self) -> Result<(), WorldError> {
        let Some((stopper, thread)) = self.kept else {
            return Ok(());
        };
        drop(stopper);
        let ended = thread.join();
        match ended.unwrap_or_else(|panic| std::panic::resume_unwind(panic)) {
            Ok(_) => Ok(()),
            Err(RunError::Node(manager)) => Err(WorldError::SecondMaster(manager)),
            Err(error) => Err(WorldError::Bench(error)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_watchman_is_heard_twice_while_a_pre_flight_listens_and_hears_another() {
        let mut watchman = Watchman::new(1);
        let mut now = Duration::ZERO;
        let mut heard = Presence::default();
        while now <= Duration::from_millis(100) {
            watchman.on_tick(now);
            let frame = watchman.next_frame().unwrap();
            heard.on_frame(&frame);
            now = watchman.next_deadline().unwrap();
        }
        assert!(
            heard
                .manager(&data_sheets_led_by(1))
                .unwrap()
                .contains("node 1")
        );
        assert_eq!(watchman.progress(), Progress::Running);
        watchman.on_frame(now, &CanFrame::new(SYNC_COB_ID, &[]));
        let expected = "SYNC is heard; end the other bench";
        assert_eq!(watchman.progress(), Progress::Failed(expected.to_owned()));
    }
}
