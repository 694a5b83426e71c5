//! The bench with my_law: every command of canrig, and the table `[controller.all.my_law]`.

use std::process::ExitCode;

use canrig::Bench;
use my_law::MyLaw;

fn main() -> ExitCode {
    Bench::new().law::<MyLaw>().main()
}
