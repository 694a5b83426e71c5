//! `canrig examples`: lists, shows or copies the scenarios and rig files that ship.

use std::path::{Path, PathBuf};

use clap::Args;
use scenario::schema::{json_schema, rig_json_schema};
use toml::Table;

use crate::console::{print, print_bytes};
use crate::exit::{Exit, Failure};
use crate::output::write_new;
use crate::shipped::{ShippedFile, file, files, meant};

/// Arguments of `examples`.
#[derive(Args, Debug)]
pub struct ExamplesArgs {
    /// Names from the list; without any all are meant
    #[arg(value_name = "NAME")]
    pub names: Vec<String>,
    /// Copy the files to this folder; no file is overwritten
    #[arg(long, value_name = "FOLDER")]
    pub to: Option<PathBuf>,
}

/// Lists, shows or copies the files.
pub fn examples(args: &ExamplesArgs) -> Result<Exit, Failure> {
    let found = args.names.iter().map(|name| named(name));
    let chosen = found.collect::<Result<Vec<ShippedFile>, _>>()?;
    match (&args.to, chosen.as_slice()) {
        (Some(folder), []) => copy(folder, &files().collect::<Vec<_>>())?,
        (Some(folder), chosen) => copy(folder, &with_what_they_name(chosen))?,
        (None, []) => {
            let names = files().map(|file| file.name().len());
            let width = names.max().unwrap_or_default();
            for file in files() {
                print(&format!("{:width$}  {}", file.name(), title(&file)));
            }
        }
        (None, chosen) => {
            for file in chosen {
                print_bytes(file.text.as_bytes());
            }
        }
    }
    Ok(Exit::Pass)
}

fn named(name: &str) -> Result<ShippedFile, Failure> {
    file(name).ok_or_else(|| {
        Exit::Usage.because(match meant(name) {
            Some(meant) => format!("no example is called `{name}`; did you mean `{meant}`?"),
            None => format!("no example is called `{name}`; `canrig examples` lists them"),
        })
    })
}

/// Returns the title of a file: the name in it, or the file to which it belongs.
fn title(file: &ShippedFile) -> String {
    let document: Table = file.text.parse().unwrap_or_default();
    let name = document.get("name").and_then(toml::Value::as_str);
    let user = || files().find(|other| other.names(file));
    match (name, user()) {
        (Some(name), _) => name.to_owned(),
        (None, Some(user)) => format!("a table of {}", user.name()),
        (None, None) => "the texts of the requirements".to_owned(),
    }
}

/// Returns the files and those that they name: rig files and tables.
fn with_what_they_name(chosen: &[ShippedFile]) -> Vec<ShippedFile> {
    let is_named = |file: &ShippedFile| chosen.iter().any(|one| one == file || one.names(file));
    files().filter(is_named).collect()
}

/// Copies files, and next to them the schemas that their first lines name. An existing schema is kept.
fn copy(folder: &Path, files: &[ShippedFile]) -> Result<(), Failure> {
    for ShippedFile { place, text } in files {
        // In the repository the rig file lies in another place.
        let text = text.replacen("../../scenarios/rig_schema.json", "../rig_schema.json", 1);
        write_new(&folder.join(place), &text)?;
    }
    for (place, text) in [
        ("schema.json", json_schema()),
        ("rig_schema.json", rig_json_schema()),
    ] {
        let path = folder.join(place);
        if path.symlink_metadata().is_err() {
            write_new(&path, &text)?;
        }
    }
    print(&folder.display().to_string());
    Ok(())
}
