//! Shell completions and manual pages, made from the command line's own definition.

use std::io::{self, Write};
use std::path::PathBuf;

use clap::{Args, CommandFactory};
use clap_complete::Shell;

use crate::cli::Cli;
use runner::console::{print, print_error};
use runner::exit::Exit;

/// Arguments of `completions`.
#[derive(Args, Debug)]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    pub shell: Shell,
}

/// Arguments of `man`.
#[derive(Args, Debug)]
pub struct ManArgs {
    /// The folder for them, such as ~/.local/share/man/man1
    #[arg(value_name = "FOLDER")]
    pub folder: PathBuf,
}

/// Prints the completions for a shell.
#[must_use]
pub fn completions(args: &CompletionsArgs) -> Exit {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "canrig", &mut text);
    // A reader that has gone needs no completions.
    let _ = io::stdout().write_all(&text);
    Exit::Pass
}

/// Writes `canrig.1` and a page for each command into a folder, which is made where it is missing.
#[must_use]
pub fn man(args: &ManArgs) -> Exit {
    let folder = &args.folder;
    let written = std::fs::create_dir_all(folder)
        .and_then(|()| clap_mangen::generate_to(Cli::command(), folder));
    match written {
        Ok(()) => {
            print(&format!("man -l {}", folder.join("canrig.1").display()));
            Exit::Pass
        }
        Err(error) => {
            print_error(&format!(
                "canrig: {} cannot be written: {error}",
                folder.display()
            ));
            Exit::BenchFailed
        }
    }
}
