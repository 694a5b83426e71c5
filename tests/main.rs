//! The integration tests, from pure to process level; one binary. Those on the kernel's CAN bus are in `vcan.rs`.

mod command_line;
mod lockstep;
mod processes;
mod rooms;
mod support;
