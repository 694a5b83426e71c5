//! Reads `sma_actuator.dbc` for [`Database::shipped`], by the code that reads such files at run time.
#![allow(
    dead_code,
    unfulfilled_lint_expectations,
    unreachable_pub,
    reason = "the library's modules, of which only what reads a file is used"
)]

use std::path::Path;
use std::{env, fs};

use database::Database;

#[path = "src/coding.rs"]
mod coding;
#[path = "src/database.rs"]
mod database;
#[path = "src/error.rs"]
mod error;
#[path = "src/notation.rs"]
mod notation;
#[path = "src/parse.rs"]
mod parse;

const SMA_ACTUATOR: &str = include_str!("sma_actuator.dbc");

fn main() {
    // A change of the compiled-in parts makes a new build script, which runs again.
    println!("cargo::rerun-if-changed=build.rs");
    let database =
        Database::parse(SMA_ACTUATOR).unwrap_or_else(|error| panic!("sma_actuator.dbc: {error}"));
    let bytes = postcard::to_extend(&database, Vec::new()).expect("plain data");
    let folder = env::var_os("OUT_DIR").expect("cargo gives one");
    let path = Path::new(&folder).join("sma_actuator.postcard");
    fs::write(&path, bytes).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}
