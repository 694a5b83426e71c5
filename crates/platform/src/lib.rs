//! Everything that touches the operating system: buses, clock, scheduling, processes, and the two runners.
//!
//! Input: a [`can::Node`], which has no clock and no socket, and the [`bus::BusAddress`] of its bus. Output: the node's
//! frames on that bus, stamped frames of all participants from a [`recorder`], and a report on how late the node's loop woke up.
//!
//! [`real_time`] moves a node by the monotonic clock and a [`bus`]; [`lockstep`] moves it in virtual time, on behalf of a
//! coordinator that models the bus. [`open()`] joins a bus of any kind: SocketCAN, the [`hub`]'s or the [`private_bus`].
//!
//! It knows no scenarios, no meaning of frames, no purpose of a node.

pub mod bus;
pub mod claim;
pub mod clock;
pub mod hub;
pub mod keeper;
mod kernel_format;
pub mod link;
pub mod listener;
pub mod lockstep;
pub mod memory;
mod netlink;
mod open;
pub mod port_seat;
pub mod private_bus;
pub mod probe;
pub mod process;
pub mod program;
pub mod real_time;
pub mod recorder;
pub mod scheduling;
pub mod seat;
pub mod series;
mod socket_bus;
pub mod stall_watch;
pub mod stop;
pub mod terminal;
pub mod unfinished;
mod wait;

pub use open::open;

#[cfg(test)]
#[path = "../tests/support/counting_allocator.rs"]
mod counting_allocator;
#[cfg(test)]
mod testing;

#[cfg(test)]
#[global_allocator]
static ALLOCATOR: counting_allocator::CountingAllocator = counting_allocator::CountingAllocator;
