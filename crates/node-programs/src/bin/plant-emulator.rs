//! `plant-emulator --bus can0 --scenario S`: the emulator as a process of its own, started by hand or on another machine.

use std::process::ExitCode;

fn main() -> ExitCode {
    canrig::by_hand(
        "plant-emulator",
        "Plays the drive with its plant, and the fan and load module, on a CAN bus, until Ctrl-C",
    )
}
