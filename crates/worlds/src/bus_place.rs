//! Place of the bench on its bus, so that no other bench leads there at the same time.
//!
//! On one machine the interface is claimed. Benches of other machines hear the manager's heartbeat in their pre-flight: our
//! controller sends it while it runs; before and between, the interview and a [`Vigil`] send it.

use std::thread::JoinHandle;
use std::time::Duration;

use can::Filter;
use canopen::nmt::ERROR_CONTROL_ID;
use dbc::scenario_clock::SYNC_COB_ID;
use plan::presence::Presence;
use platform::bus::BusAddress;
use platform::claim::{Claim, ClaimError};
use platform::stop::Stopper;

use crate::bus_choice::RunBus;
use crate::bus_connection::stop_signal;
use crate::error::WorldError;
use crate::guest::{Guest, GuestError};
use crate::names::BENCH;

/// Takes the interface, so that no other bench of this machine uses it meanwhile. Buses that canrig makes for a run need no claim.
///
/// # Errors
/// If another bench has it; the text names its process.
pub fn claim(bus: &RunBus) -> Result<Option<Claim>, WorldError> {
    let RunBus::Interface(name) = bus else {
        return Ok(None);
    };
    let claim = Claim::on(name).map_err(|error| match error {
        ClaimError::Taken(why) => WorldError::SecondMaster(why),
        ClaimError::System(_) => WorldError::Claim(error),
    });
    claim.map(Some)
}

/// Keeps the place while no controller of ours runs. Use it only after an orderly stop: if a controller was lost, the silence of
/// its heartbeat makes the drive switch the current off.
#[derive(Debug)]
pub struct Vigil {
    /// Thread that keeps the place; `None` on a private bus, which no other bench can join.
    kept: Option<(Stopper, JoinHandle<Result<(), WorldError>>)>,
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
        let heartbeat = ERROR_CONTROL_ID + u16::from(manager);
        let filters = [SYNC_COB_ID, heartbeat].map(Filter::exact);
        let bus = platform::open(address, &filters)?;
        let (stopper, stop) = stop_signal()?;
        let mut guest = Guest::new(bus, move || stop.is_raised());
        guest.keep_place_of(manager);
        let thread = std::thread::Builder::new()
            .name("vigil".into())
            .spawn(move || keep(guest, manager))
            .map_err(WorldError::spawn(BENCH))?;
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
        ended.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

/// Sends the manager's heartbeat until the vigil ends.
///
/// # Errors
/// If another manager is heard, or the bus fails.
fn keep(mut guest: Guest<'_>, manager: u8) -> Result<(), WorldError> {
    let mut presence = Presence::default();
    loop {
        match guest.next_until(Duration::MAX) {
            Err(GuestError::Interrupted) => return Ok(()),
            Err(GuestError::Bus(error)) => return Err(error.into()),
            Ok(frame) => frame.iter().for_each(|frame| presence.on_frame(frame)),
        }
        if let Some(manager) = presence.manager(|node_id| node_id == manager) {
            let found = format!("{manager} is heard; end the other bench");
            return Err(WorldError::SecondMaster(found));
        }
    }
}
