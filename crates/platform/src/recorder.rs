//! Records a bus: every frame with its time, whoever sent it.
//!
//! A recorder never holds up the bus. Frames wait for their reader in a ring of 65 536; what does not fit is counted as
//! lost, and so is what the kernel threw away.

use std::fmt;
use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime};

use canopen::CanFrame;
use rtrb::{Consumer, Producer, RingBuffer};
use rustix::event::{EventfdFlags, PollFd, PollFlags, eventfd, poll};
use rustix::net::sockopt::{set_socket_recv_buffer_size, set_socket_recv_buffer_size_force};
use socketcan::{CanAnyFrame, CanFdSocket, CanSocket, Socket, SocketOptions};

use crate::bus::{BusAddress, BusError};
use crate::clock::Clock;
use crate::socketcan_bus::{kernel_drops, open_socket};

/// Frames that wait for the reader, at most: some 8 s of a full bus at 1 Mbit/s.
pub const RING_FRAMES: usize = 65_536;

/// Bytes asked for as the recorder's receive buffer in the kernel: some 5 000 frames.
const RECEIVE_BUFFER_BYTES: usize = 4 << 20;

/// So long without a frame, and the wall clock is looked at for a step. A step that is not seen comes back with the next one, and a log
/// whose time goes back by half a second is not read there.
const STAMP_GAP: Duration = Duration::from_millis(100);

/// A frame and when it was on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReceivedFrame {
    /// Time since the recorder's epoch, see [`Recorder::wall_epoch`].
    pub time: Duration,
    /// The frame.
    pub frame: CanFrame,
}

/// Every frame on a bus, in the order of time.
pub struct Recorder {
    frames: Consumer<ReceivedFrame>,
    lost: Arc<AtomicU64>,
    fd_frames: Arc<AtomicU64>,
    clock: Clock,
    interface: Option<InterfaceThread>,
}

impl Recorder {
    /// Starts to record a CAN interface; stamps are those of the kernel's receive path.
    ///
    /// # Errors
    /// As for opening the bus.
    pub fn on_interface(name: &str) -> Result<Self, BusError> {
        Self::on_socket(name, open_socket(name)?)
    }

    /// As [`Recorder::on_interface`] with a socket that is open already.
    pub(crate) fn on_socket(name: &str, socket: CanSocket) -> Result<Self, BusError> {
        let failed = |action| {
            move |source| BusError::System {
                address: BusAddress::Interface(name.into()),
                action,
                source,
            }
        };
        let (mut ring, recorder) = ring();
        // Only a socket for both kinds of frames has room for those of CAN FD, which a smaller one cuts.
        let socket = CanFdSocket::try_from(socket).map_err(failed("record"))?;
        prepare(&socket).map_err(failed("record"))?;
        let stop = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)
            .map_err(|errno| failed("record")(errno.into()))?;
        let raised = stop.try_clone().map_err(failed("record"))?;
        let thread = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || listen(&socket, &stop, &mut ring))
            .map_err(failed("record"))?;
        Ok(Self {
            interface: Some(InterfaceThread {
                stop: raised,
                thread: Some(thread),
            }),
            ..recorder
        })
    }

    /// The next frame, oldest first; `None` when there is none yet. Never waits.
    #[expect(
        clippy::should_implement_trait,
        reason = "None is not the end, so this is no iterator"
    )]
    pub fn next(&mut self) -> Option<ReceivedFrame> {
        self.frames.pop().ok()
    }

    /// The wall-clock time (since 1970) of the epoch.
    #[must_use]
    pub fn wall_epoch(&self) -> Duration {
        self.clock.wall_epoch()
    }

    /// A time of the system's monotonic clock as the recorder stamps its frames, see [`Recorder::wall_epoch`].
    #[must_use]
    pub fn from_monotonic(&self, time: Duration) -> Duration {
        self.clock.from_monotonic(time)
    }

    /// By how much the wall clock was stepped since the epoch. The kernel's stamps are wall-clock times, so on an
    /// interface more than a few milliseconds make them untrustworthy.
    #[must_use]
    pub fn wall_clock_step(&self) -> Duration {
        self.clock.wall_clock_step()
    }

    /// Stops listening to an interface; all frames before this moment can still be taken. On an embedded bus the hub's
    /// end does the same.
    pub fn stop(&mut self) {
        self.interface = None;
    }

    /// Frames that were not recorded. Final after [`Recorder::stop`].
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }

    /// CAN FD frames that were on the interface; they are counted and not recorded.
    #[must_use]
    pub fn fd_frames(&self) -> u64 {
        self.fd_frames.load(Ordering::Relaxed)
    }
}

impl fmt::Debug for Recorder {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Recorder")
            .field("waiting", &self.frames.slots())
            .field("lost", &self.lost())
            .finish_non_exhaustive()
    }
}

/// The writing end of a recorder's ring.
pub(crate) struct Ring {
    frames: Producer<ReceivedFrame>,
    lost: Arc<AtomicU64>,
    fd_frames: Arc<AtomicU64>,
    clock: Clock,
}

impl Ring {
    /// Records a frame that is on the bus now.
    pub(crate) fn push_now(&mut self, frame: CanFrame) {
        self.push(self.clock.now(), frame);
    }

    fn push(&mut self, time: Duration, frame: CanFrame) {
        if self.frames.push(ReceivedFrame { time, frame }).is_err() {
            self.add_lost(1);
        }
    }

    fn add_lost(&self, count: u64) {
        self.lost.fetch_add(count, Ordering::Relaxed);
    }

    fn count_fd(&self) {
        self.fd_frames.fetch_add(1, Ordering::Relaxed);
    }
}

/// A recorder and the ring that feeds it; the epoch is now.
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

/// The thread that listens to an interface; ends when dropped.
struct InterfaceThread {
    stop: OwnedFd,
    thread: Option<JoinHandle<()>>,
}

impl Drop for InterfaceThread {
    fn drop(&mut self) {
        // An event counter takes this write; should it not, the join below would wait for ever.
        if rustix::io::write(&self.stop, &1_u64.to_ne_bytes()).is_ok()
            && let Some(thread) = self.thread.take()
        {
            drop(thread.join());
        }
    }
}

/// All frames, stamps, and room for them.
fn prepare(socket: &CanFdSocket) -> std::io::Result<()> {
    socket.set_error_filter_accept_all()?;
    socket.set_recv_timestamp(true)?;
    socket.set_nonblocking(true)?;
    // Beyond `net.core.rmem_max` only with CAP_NET_ADMIN; else as much as is allowed.
    set_socket_recv_buffer_size_force(socket, RECEIVE_BUFFER_BYTES)
        .or_else(|_| set_socket_recv_buffer_size(socket, RECEIVE_BUFFER_BYTES))?;
    Ok(())
}

/// Reads frames into the ring until it is to stop, or the interface is gone.
fn listen(socket: &CanFdSocket, stop: &OwnedFd, ring: &mut Ring) {
    let mut stamps = Stamps {
        clock: ring.clock,
        latest: ring.clock.wall_epoch(),
    };
    loop {
        let mut fds = [
            PollFd::from_borrowed_fd(socket.as_fd(), PollFlags::IN),
            PollFd::from_borrowed_fd(stop.as_fd(), PollFlags::IN),
        ];
        // An interrupted wait leaves no events and is repeated.
        let waited = poll(&mut fds, None).is_ok();
        let is_stop_requested = waited && !fds[1].revents().is_empty();
        let alive = read_all(socket, &mut stamps, ring);
        if is_stop_requested || !alive {
            break;
        }
    }
    ring.add_lost(kernel_drops(socket));
}

/// The kernel's stamps, which are wall-clock times, on the recorder's clock.
struct Stamps {
    clock: Clock,
    latest: Duration,
}

impl Stamps {
    /// Time since the epoch. Stamps that go back, or far ahead, mean a stepped wall clock: time goes on all the same, or
    /// a run would wait for its end for as long as the clock was set back.
    fn time_of(&mut self, stamp: SystemTime) -> Duration {
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

/// Reads what the kernel holds; false when the interface is gone.
fn read_all(socket: &CanFdSocket, stamps: &mut Stamps, ring: &mut Ring) -> bool {
    loop {
        match socket.read_frame_with_timestamp() {
            Ok((frame, stamp)) => {
                let time = stamps.time_of(stamp);
                match from_socketcan(&frame) {
                    Some(frame) => ring.push(time, frame),
                    None => ring.count_fd(),
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

/// A classical frame; none for one of CAN FD.
fn from_socketcan(frame: &CanAnyFrame) -> Option<CanFrame> {
    let raw: &libc::can_frame = match frame {
        CanAnyFrame::Normal(frame) => frame.as_ref(),
        CanAnyFrame::Remote(frame) => frame.as_ref(),
        CanAnyFrame::Error(frame) => frame.as_ref(),
        CanAnyFrame::Fd(_) => return None,
    };
    CanFrame::from_raw(raw.can_id, raw.can_dlc, raw.data)
}
