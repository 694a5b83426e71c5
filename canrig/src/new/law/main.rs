//! The bench with my_law: every command of canrig, and the law `my_law` in scenarios.

use std::process::ExitCode;

use canrig::Bench;
use my_law::MyLaw;

fn main() -> ExitCode {
    Bench::new().law::<MyLaw>().main()
}
