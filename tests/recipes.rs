//! The recipes of the book: each is played in an empty folder, with the files that the page shows.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::support::{output, root};

/// Number of recipes.
const RECIPES: usize = 6;

/// Returns the blocks of a language.
fn blocks<'a>(page: &'a str, language: &'a str) -> impl Iterator<Item = &'a str> {
    let blocks = page.split("```").skip(1).step_by(2);
    blocks.filter_map(move |block| block.strip_prefix(language)?.strip_prefix('\n'))
}

/// Writes the files of a page, whose first line names them, and runs its commands, each with the
/// exit code that it names.
fn play(page: &str, folder: &Path) {
    for text in blocks(page, "toml") {
        let name = text.lines().next().unwrap().strip_prefix("# ").unwrap();
        fs::write(folder.join(name), text).unwrap();
        let words = Vec::from_iter(page.split_whitespace()).join(" ");
        assert!(words.contains(&format!("Save this as `{name}`:")), "{name}");
    }
    let program = Path::new(env!("CARGO_BIN_EXE_canrig")).parent().unwrap();
    let path = format!("{}:{}", program.display(), env!("PATH"));
    let mut count = 0;
    for line in blocks(page, "sh").flat_map(str::lines) {
        count += 1;
        let (command, code) = line.split_once(" # exit code ").unwrap_or((line, "0"));
        let mut shell = Command::new("bash");
        shell
            .args(["-c", command])
            .current_dir(folder)
            .env("PATH", &path);
        let (ended, stdout, stderr) = output(&mut shell);
        assert_eq!(ended, code.parse().ok(), "{line}\n{stdout}{stderr}");
    }
    assert!(count > 1);
}

#[test]
fn each_recipe_does_what_its_page_says() {
    let mut count = 0;
    for entry in fs::read_dir(root().join("docs/recipes")).unwrap() {
        let page = fs::read_to_string(entry.unwrap().path()).unwrap();
        assert!(
            page.lines().next().unwrap().ends_with('?'),
            "one problem each"
        );
        let folder = tempfile::tempdir().unwrap();
        play(&page, folder.path());
        count += 1;
    }
    assert_eq!(count, RECIPES);
}
