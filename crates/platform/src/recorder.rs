//! Recorder of a bus: every frame of every sender with its time.
//!
//! A recorder never holds up the bus. Frames wait for their reader in a ring of 65 536. Frames that do not fit are counted as
//! lost, and so are frames that the kernel discarded.

use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use can::CanFrame;
use rtrb::{Consumer, Producer, RingBuffer};
use rustix::net::sockopt::{set_socket_recv_buffer_size, set_socket_recv_buffer_size_force};
use socketcan::{CanAnyFrame, CanFdSocket, CanSocket, Socket, SocketOptions};

use crate::bus::{BusAddress, BusError};
use crate::clock::Clock;
use crate::socket_bus::{kernel_drops, open_socket};
use crate::stop::StoppedThread;
use crate::wait::wait_for_any;

/// Largest number of frames that wait for the reader: some 8 s of a full bus at 1 Mbit/s.
pub const RING_FRAMES: usize = 65_536;

/// Requested size of the recorder's receive buffer in the kernel: some 5 000 frames.
const RECEIVE_BUFFER_BYTES: usize = 4 << 20;

/// Gap between stamps above which the wall clock is checked for a step. An unnoticed step is corrected with the next one that is
/// noticed; a log whose time goes back by half a second is not read from there on.
const STAMP_GAP: Duration = Duration::from_millis(100);

/// Frame with the time at which it was on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReceivedFrame {
    /// Time since the recorder's epoch, see [`Recorder::clock`].
    pub time: Duration,
    /// The frame.
    pub frame: CanFrame,
    /// Process that sent it; `None` on a CAN interface, and from another container.
    pub process: Option<u32>,
}

/// Recorder of every frame on a bus, in the order of time.
#[derive(Debug)]
pub struct Recorder {
    frames: Consumer<ReceivedFrame>,
    lost: Arc<AtomicU64>,
    fd_frames: Arc<AtomicU64>,
    /// Clock whose start is the epoch of the frames' times. The kernel's stamps are wall-clock times, so on an interface a step of the
    /// wall clock of more than a few milliseconds makes them untrustworthy.
    pub clock: Clock,
    /// Thread that listens to an interface.
    interface: Option<StoppedThread>,
}

impl Recorder {
    /// Starts recording a CAN interface; stamps are those of the kernel's receive path.
    ///
    /// # Errors
    /// As for opening the bus.
    pub fn on_interface(name: &str) -> Result<Self, BusError> {
        Self::on_socket(name, open_socket(name)?)
    }

    /// As [`Recorder::on_interface`] with an open socket.
    pub(crate) fn on_socket(name: &str, socket: CanSocket) -> Result<Self, BusError> {
        let address = BusAddress::Interface(name.into());
        let failed = |source| BusError::system(&address, "record", source);
        let (mut ring, recorder) = ring();
        // Only a socket for both kinds of frames has room for CAN FD frames, which a smaller one cuts.
        let socket = CanFdSocket::try_from(socket).map_err(failed)?;
        prepare(&socket).map_err(failed)?;
        let thread = StoppedThread::start("recorder", |stop| {
            Ok(move || listen(&socket, &stop, &mut ring))
        });
        Ok(Self {
            interface: Some(thread.map_err(failed)?),
            ..recorder
        })
    }

    /// Returns the oldest frame that was not taken yet; `None` if there is none. Never waits.
    #[expect(
        clippy::should_implement_trait,
        reason = "None is not the end, so this is no iterator"
    )]
    pub fn next(&mut self) -> Option<ReceivedFrame> {
        self.frames.pop().ok()
    }

    /// Stops listening to an interface; all frames before this moment can still be taken. On an embedded bus the hub's end has
    /// the same effect.
    pub fn stop(&mut self) {
        self.interface = None;
    }

    /// Number of frames that were not recorded. Final after [`Recorder::stop`].
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }

    /// Number of CAN FD frames on the interface; they are counted and not recorded.
    pub fn fd_frames(&self) -> u64 {
        self.fd_frames.load(Ordering::Relaxed)
    }
}

/// Writing end of a recorder's ring.
pub(crate) struct Ring {
    frames: Producer<ReceivedFrame>,
    lost: Arc<AtomicU64>,
    fd_frames: Arc<AtomicU64>,
    clock: Clock,
}

impl Ring {
    /// Records a frame of a process with the present time.
    pub(crate) fn push_now(&mut self, frame: CanFrame, process: Option<u32>) {
        let time = self.clock.now();
        self.push(ReceivedFrame {
            time,
            frame,
            process,
        });
    }

    fn push(&mut self, received: ReceivedFrame) {
        if self.frames.push(received).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Makes a recorder and the ring that feeds it; the epoch is now.
pub(crate) fn ring() -> (Ring, Recorder) {
    let (producer, consumer) = RingBuffer::new(RING_FRAMES);
    let lost = Arc::new(AtomicU64::new(0));
    let fd_frames = Arc::new(AtomicU64::new(0));
    let clock = Clock::start();
    let ring = Ring {
        frames: producer,
        lost: Arc::clone(&lost),
        fd_frames: Arc::clone(&fd_frames),
        clock,
    };
    let recorder = Recorder {
        frames: consumer,
        lost,
        fd_frames,
        clock,
        interface: None,
    };
    (ring, recorder)
}

/// Sets a socket up to receive all frames, with stamps and a large buffer.
fn prepare(socket: &CanFdSocket) -> std::io::Result<()> {
    socket.set_error_filter_accept_all()?;
    socket.set_recv_timestamp(true)?;
    socket.set_nonblocking(true)?;
    // Beyond `net.core.rmem_max` only with CAP_NET_ADMIN; otherwise as much as is allowed.
    set_socket_recv_buffer_size_force(socket, RECEIVE_BUFFER_BYTES)
        .or_else(|_| set_socket_recv_buffer_size(socket, RECEIVE_BUFFER_BYTES))?;
    Ok(())
}

/// Reads frames into the ring until the other end of the pipe `stop` closes, or until the interface is gone.
fn listen(socket: &CanFdSocket, stop: &OwnedFd, ring: &mut Ring) {
    let mut stamps = Stamps {
        clock: ring.clock,
        latest: ring.clock.wall_epoch(),
    };
    loop {
        let waited = wait_for_any([Some(socket.as_fd()), Some(stop.as_fd())], None);
        let is_stop_requested = waited.is_ok_and(|[_, stop]| stop);
        let alive = read_all(socket, &mut stamps, ring);
        if is_stop_requested || !alive {
            break;
        }
    }
    ring.lost.fetch_add(kernel_drops(socket), Ordering::Relaxed);
}

/// Conversion of the kernel's stamps, which are wall-clock times, to the recorder's clock.
struct Stamps {
    clock: Clock,
    latest: Duration,
}

impl Stamps {
    /// Returns the time since the epoch. Stamps that go back, or far ahead, mean a stepped wall clock. Time continues regardless;
    /// otherwise a run would wait for its end for as long as the clock was set back.
    fn run_time(&mut self, stamp: SystemTime) -> Duration {
        let wall = stamp
            .duration_since(SystemTime::UNIX_EPOCH)
            .unwrap_or_default();
        if wall < self.latest || wall > self.latest + STAMP_GAP {
            self.clock.follow_wall_steps();
        }
        self.latest = wall;
        self.clock.from_wall(wall)
    }
}

/// Reads all frames that the kernel holds; returns false if the interface is gone.
fn read_all(socket: &CanFdSocket, stamps: &mut Stamps, ring: &mut Ring) -> bool {
    loop {
        match socket.read_frame_with_timestamp() {
            Ok((frame, stamp)) => {
                let time = stamps.run_time(stamp);
                match from_socketcan(&frame) {
                    Some(frame) => ring.push(ReceivedFrame {
                        time,
                        frame,
                        process: None,
                    }),
                    None => drop(ring.fd_frames.fetch_add(1, Ordering::Relaxed)),
                }
            }
            Err(error) => match error.kind() {
                std::io::ErrorKind::WouldBlock => return true,
                std::io::ErrorKind::Interrupted => {}
                _ => return false,
            },
        }
    }
}

/// Converts a classical frame; `None` for a CAN FD frame.
fn from_socketcan(frame: &CanAnyFrame) -> Option<CanFrame> {
    let raw: &libc::can_frame = match frame {
        CanAnyFrame::Normal(frame) => frame.as_ref(),
        CanAnyFrame::Remote(frame) => frame.as_ref(),
        CanAnyFrame::Error(frame) => frame.as_ref(),
        CanAnyFrame::Fd(_) => return None,
    };
    CanFrame::from_raw(raw.can_id, raw.can_dlc, raw.data)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_stamps_that_go_back_or_far_ahead_mean_a_stepped_wall_clock() {
        let hour = Duration::from_secs(3600);
        let moment = Duration::from_nanos(1);
        let clock = Clock::start().before_step(hour);
        let stamp = clock.wall_epoch() + hour;
        let time_after = |latest| {
            let mut stamps = Stamps { clock, latest };
            stamps.run_time(SystemTime::UNIX_EPOCH + stamp)
        };
        assert_eq!(time_after(stamp), hour);
        assert_eq!(time_after(stamp - STAMP_GAP), hour);
        assert!(time_after(stamp - STAMP_GAP - moment) < hour / 2);
        assert!(time_after(stamp + moment) < hour / 2);
    }
}
