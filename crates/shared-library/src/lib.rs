//! The bytes of a dependency's shared library, at compile time. Cargo cannot name it yet (artifact dependencies,
//! rust-lang/cargo#9096), but it tells the compiler where the same crate's library for Rust is, and makes the two side by side.

use std::env;
use std::path::Path;

use proc_macro::TokenStream;

/// Expands to the bytes of the shared library of a dependency of both kinds, `crate-type = ["cdylib", "lib"]`. There are no bytes
/// if the library is not made: by `cargo check`, and for systems without shared libraries.
#[proc_macro]
pub fn shared_library(dependency: TokenStream) -> TokenStream {
    // As in `--extern canrig_plants=/…/libcanrig_plants.rlib`.
    let place = format!("{dependency}=");
    let library = env::args()
        .find_map(|argument| Some(Path::new(argument.strip_prefix(&place)?).with_extension("so")))
        .filter(|library| library.is_file());
    let bytes = library.map_or_else(
        || "b\"\"".to_owned(),
        |library| format!("include_bytes!({library:?})"),
    );
    bytes.parse().expect("an expression")
}
