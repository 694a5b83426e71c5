//! The `canrig` program; everything is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    canrig::Bench::new().main()
}
