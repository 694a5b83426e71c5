//! Shell completions and manual pages, made from the command line's own definition.

use std::io::{self, Write};
use std::path::Path;

use clap::CommandFactory;
use clap_complete::Shell;

use crate::cli::Cli;
use crate::console::{complain, say};
use crate::exit::Exit;

/// Prints the completions for a shell.
#[must_use]
pub fn completions(shell: Shell) -> Exit {
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "canrig", &mut text);
    // A reader that has gone needs no completions.
    let _ = io::stdout().write_all(&text);
    Exit::Pass
}

/// Writes `canrig.1` and a page for each command into a folder, which is made where it is missing.
#[must_use]
pub fn pages(folder: &Path) -> Exit {
    let written = std::fs::create_dir_all(folder)
        .and_then(|()| clap_mangen::generate_to(Cli::command(), folder));
    match written {
        Ok(()) => {
            say(&format!("man -l {}", folder.join("canrig.1").display()));
            Exit::Pass
        }
        Err(error) => {
            complain(&format!(
                "canrig: {} cannot be written: {error}",
                folder.display()
            ));
            Exit::BenchFailed
        }
    }
}
