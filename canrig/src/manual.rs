//! Shell completions and manual pages, made from the definition of the command line.

use std::io;
use std::path::{Path, PathBuf};

use clap::{Args, Command};
use clap_complete::Shell;
use clap_mangen::Man;

use recording::run_folder::write_whole;
use runner::console::{print, print_bytes};
use runner::exit::{Exit, Failure};
use runner::output::unwritten;

/// Arguments of `completions`.
#[derive(Args, Debug)]
pub(crate) struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    pub shell: Shell,
    /// Write the file that the shell looks for into this folder, instead of printing it
    #[arg(long, value_name = "FOLDER")]
    pub to: Option<PathBuf>,
}

/// Arguments of `man`.
#[derive(Args, Debug)]
pub(crate) struct ManArgs {
    /// Folder in which the pages are written, such as ~/.local/share/man/man1
    #[arg(long, value_name = "FOLDER")]
    pub to: PathBuf,
}

/// Prints the completions for a shell, or writes them into a folder.
pub(crate) fn completions(
    args: &CompletionsArgs,
    command_line: &mut Command,
) -> Result<Exit, Failure> {
    let Some(folder) = &args.to else {
        let mut text = Vec::new();
        clap_complete::generate(args.shell, command_line, "canrig", &mut text);
        print_bytes(&text);
        return Ok(Exit::Pass);
    };
    let written = std::fs::create_dir_all(folder)
        .and_then(|()| clap_complete::generate_to(args.shell, command_line, "canrig", folder));
    let file = written.map_err(|error| unwritten(folder, &error))?;
    print(&file.display().to_string());
    Ok(Exit::Pass)
}

/// Writes the pages of a command and of its subcommands.
fn write_pages(command: Command, folder: &Path) -> io::Result<()> {
    for below in command
        .get_subcommands()
        .filter(|below| !below.is_hide_set())
    {
        write_pages(below.clone(), folder)?;
    }
    let page = Man::new(command);
    write_whole(&folder.join(page.get_filename()), |output| {
        page.render(output)
    })
}

/// Writes `canrig.1` and a page for each command into a folder, which is made if it is missing.
pub(crate) fn man(args: &ManArgs, command_line: Command) -> Result<Exit, Failure> {
    let folder = &args.to;
    let mut command_line = command_line.disable_help_subcommand(true);
    command_line.build();
    let written = std::fs::create_dir_all(folder).and_then(|()| write_pages(command_line, folder));
    written.map_err(|error| unwritten(folder, &error))?;
    let page = folder.join("canrig.1");
    print(&format!("read them with: man -l {}", page.display()));
    Ok(Exit::Pass)
}
