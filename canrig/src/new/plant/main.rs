//! The bench with my_plant: every command of canrig, and the table `[plant.my_plant]`.

use std::process::ExitCode;

use canrig::Bench;
use my_plant::MyPlant;

fn main() -> ExitCode {
    Bench::new().plant::<MyPlant>().main()
}
