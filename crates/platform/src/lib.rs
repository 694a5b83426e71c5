//! Everything that touches the operating system: buses, clock, scheduling, processes, and the two runners.
//!
//! A [`canopen::Node`] knows no time and no socket. [`real_time`] moves it by the monotonic clock and a [`bus`];
//! [`lockstep`] moves it in virtual time, on behalf of a coordinator that models the bus.

pub mod bus;
pub mod clock;
pub mod counting_allocator;
mod embedded_bus;
pub mod hub;
mod kernel_format;
pub mod link;
pub mod lockstep;
mod open;
pub mod private_bus;
pub mod probe;
pub mod process;
pub mod real_time;
pub mod recorder;
pub mod scheduling;
mod socketcan_bus;
pub mod stop;

pub use open::open;

#[cfg(test)]
mod test_nodes;

#[cfg(test)]
#[global_allocator]
static ALLOCATOR: counting_allocator::CountingAllocator = counting_allocator::CountingAllocator;
