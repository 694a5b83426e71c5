//! The bench with my_plant: every command of canrig, and the model `my_plant` in rig files.

use std::process::ExitCode;

use canrig::Bench;
use my_plant::MyPlant;

fn main() -> ExitCode {
    Bench::new().plant::<MyPlant>().main()
}
