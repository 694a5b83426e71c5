//! `controller --bus can0 --scenario S`: the controller as a process of its own, started by hand or on another machine.

use std::process::ExitCode;

fn main() -> ExitCode {
    canrig::by_hand(
        "controller",
        "Leads the drive on a CAN bus through a scenario, until Ctrl-C",
    )
}
