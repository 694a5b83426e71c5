//! Names the shared library in the FMUs of the plants that ship: the program carries it. Cargo makes it first, since the program
//! depends on `fmu-library`.

use std::fs::File;
use std::path::Path;

fn main() {
    let output = std::env::var_os("OUT_DIR").expect("cargo sets it");
    // From `build/canrig-…/out`.
    let library = Path::new(&output).join("../../../deps/libcanrig_plants.so");
    // `cargo check` makes no library, and is content with an empty file.
    let _ = File::create_new(&library);
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-env=SHIPPED_LIBRARY={}", library.display());
}
