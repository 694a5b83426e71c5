//! Shell completions and manual pages, made from the definition of the command line.

use std::path::PathBuf;

use clap::{Args, Command};
use clap_complete::Shell;

use runner::console::{print, print_bytes, print_error};
use runner::exit::Exit;

/// Arguments of `completions`.
#[derive(Args, Debug)]
pub(crate) struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    pub shell: Shell,
}

/// Arguments of `man`.
#[derive(Args, Debug)]
pub(crate) struct ManArgs {
    /// Folder in which the pages are written, such as ~/.local/share/man/man1
    #[arg(value_name = "FOLDER")]
    pub folder: PathBuf,
}

/// Prints the completions for a shell.
#[must_use]
pub(crate) fn completions(args: &CompletionsArgs, command_line: &mut Command) -> Exit {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, command_line, "canrig", &mut text);
    print_bytes(&text);
    Exit::Pass
}

/// Writes `canrig.1` and a page for each command into a folder, which is made where it is missing.
#[must_use]
pub(crate) fn man(args: &ManArgs, command_line: Command) -> Exit {
    let folder = &args.folder;
    let written = std::fs::create_dir_all(folder)
        .and_then(|()| clap_mangen::generate_to(command_line, folder));
    match written {
        Ok(()) => {
            print(&format!(
                "read them with: man -l {}",
                folder.join("canrig.1").display()
            ));
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
