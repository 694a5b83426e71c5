//! Notes on a data sheet: what its text has that CiA 306-1 does not, and what was made of it.

use std::fmt;

/// Most notes that are kept; the others are counted.
const KEPT_MAX: usize = 1000;
/// Most characters of a text that a note quotes.
const QUOTED_MAX: usize = 40;

/// A slip in a data sheet that does no harm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// Line in the text, from 1; 0 for the text as a whole.
    pub line: usize,
    /// Section, key and value as far as the slip has them, and what is wrong.
    pub text: String,
}

impl fmt::Display for Note {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { line, text } = self;
        match line {
            0 => formatter.write_str(text),
            _ => write!(formatter, "line {line}: {text}"),
        }
    }
}

/// All slips of a data sheet.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Notes {
    kept: Vec<Note>,
    count: usize,
}

impl Notes {
    /// Adds a note on a line.
    pub(super) fn add(&mut self, line: usize, text: impl fmt::Display) {
        self.count += 1;
        if self.kept.len() < KEPT_MAX {
            let text = text.to_string();
            self.kept.push(Note { line, text });
        }
    }

    /// Puts the notes into the order of their lines.
    pub(super) fn sort(&mut self) {
        self.kept.sort_by_key(|note| note.line);
    }

    /// Returns the first notes, in the order of their lines.
    pub fn first(&self, max: usize) -> &[Note] {
        &self.kept[..self.kept.len().min(max)]
    }

    /// Returns the number of slips.
    pub fn count(&self) -> usize {
        self.count
    }
}

/// Returns a text as a note quotes it: not longer than a line.
pub(super) fn quoted(text: &str) -> String {
    match text.char_indices().nth(QUOTED_MAX) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}
