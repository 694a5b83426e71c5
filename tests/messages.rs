//! Messages composed from node objects equal `Composer`'s, on every rig in the repository.

use std::fs;
use std::path::{Path, PathBuf};

use dbc::{Database, Message, Signal};
use plan::Plan;
use plan::resolve::messages;

use crate::support::root;

/// Objects with the truth about a plant.
const TRUTH: &str = "0x210";
/// Objects of an amplifier: its output and its command.
const AMPLIFIER: [&str; 2] = ["0x6078:00", "0x6071:00"];

/// Clears what may differ: message descriptions, and the truth's cycle time, which `Composer`
/// always sets to the SYNC period.
fn without_known_differences(message: &Message) -> Message {
    let mut signals = message.signals.iter();
    let is_truth = signals.any(|signal| signal.object.starts_with(TRUTH));
    Message {
        comment: String::new(),
        cycle_time_milliseconds: if is_truth {
            0
        } else {
            message.cycle_time_milliseconds
        },
        signals: message.signals.iter().map(without_rated_comment).collect(),
        ..message.clone()
    }
}

/// Clears the comment of an external drive's amplifier signals, because `Composer` names a rated
/// value of 1 A there.
fn without_rated_comment(signal: &Signal) -> Signal {
    let is_of_bought = AMPLIFIER.contains(&&*signal.object) && signal.coding.range.is_none();
    Signal {
        comment: if is_of_bought {
            String::new()
        } else {
            signal.comment.clone()
        },
        ..signal.clone()
    }
}

/// Returns the TOML files of the repository's folders of scenarios and rigs.
fn toml_files() -> Vec<PathBuf> {
    let mut folders =
        Vec::from(["scenarios", "docs/examples", "tests/core", "tests/rigs"].map(PathBuf::from));
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(root().join(&folder)).unwrap() {
            let entry = entry.unwrap();
            let path = folder.join(entry.file_name());
            if entry.path().is_dir() {
                folders.push(path);
            } else if path
                .extension()
                .is_some_and(|extension| extension == "toml")
            {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

/// Describes a message and its signals, a line each.
fn lines(message: &Message) -> Vec<String> {
    let without_signals = Message {
        signals: Vec::new(),
        ..message.clone()
    };
    let signals = message
        .signals
        .iter()
        .map(|signal| format!("    {signal:?}"));
    [format!("{without_signals:?}")]
        .into_iter()
        .chain(signals)
        .collect()
}

/// Returns the lines in which the messages of two databases differ.
fn differences(file: &Path, before: &Database, composed: &Database) -> Vec<String> {
    let all = |database: &Database| {
        let messages = database.messages().iter().map(without_known_differences);
        Vec::from_iter(messages.flat_map(|message| lines(&message)))
    };
    let [before, composed] = [before, composed].map(all);
    let file = file.display();
    let gone = before.iter().filter(|line| !composed.contains(line));
    let new = composed.iter().filter(|line| !before.contains(line));
    let gone = gone.map(|line| format!("{file} - {line}"));
    gone.chain(new.map(|line| format!("{file} + {line}")))
        .collect()
}

#[test]
fn composed_messages_equal_the_composers() {
    let mut differing = Vec::new();
    let mut count = 0;
    for file in toml_files() {
        let (path, catalogue) = (root().join(&file), worlds::catalogue::catalogue());
        let text = fs::read_to_string(&path).unwrap();
        let plan = if scenario::rig::nodes::Rig::is_meant(&text) {
            Plan::from_rig(&path, &text, catalogue)
        } else {
            Plan::load(&path, catalogue)
        };
        let Ok(plan) = plan else { continue };
        count += 1;
        differing.extend(differences(
            &file,
            plan.database(),
            &messages::database(&plan),
        ));
    }
    assert!(count > 50, "{count}");
    let first = differing.iter().take(20).map(String::as_str);
    let first = Vec::from_iter(first).join("\n");
    assert!(differing.is_empty(), "{} lines:\n{first}", differing.len());
}
