//! The text layer of an EDS (CiA 306-1, clause 4): sections of `key=value` lines with comments.
//!
//! Written by hand because errors need line numbers and a repeated section or key must be an error, not a silent merge.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fmt::Display;

use super::EdsError;
use super::value;

/// Longest line; CiA 306-1 allows 255 characters.
const MAX_LINE_BYTES: usize = 1024;

/// Name of a key, in which case does not matter. Shorter names come first, since most differ in length.
#[derive(Clone, Copy, Debug)]
struct Key<'t>(&'t str);

impl Ord for Key<'_> {
    fn cmp(&self, other: &Self) -> Ordering {
        let lower_case = |key: &Self| key.0.bytes().map(|letter| letter.to_ascii_lowercase());
        let by_length = self.0.len().cmp(&other.0.len());
        by_length.then_with(|| lower_case(self).cmp(lower_case(other)))
    }
}

impl PartialOrd for Key<'_> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Key<'_> {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Key<'_> {}

/// A `key=value` line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Item<'t> {
    pub(super) line: usize,
    pub(super) section: &'t str,
    pub(super) key: &'t str,
    pub(super) value: &'t str,
}

impl Item<'_> {
    /// Makes an error about this item.
    pub(super) fn error(&self, reason: impl Display) -> EdsError {
        let Self {
            line,
            section,
            key,
            value,
        } = self;
        EdsError::at_line(*line, format!("[{section}] {key}={value}: {reason}"))
    }

    /// Reads the value as an integer.
    pub(super) fn integer(&self, node_id: u8) -> Result<i128, EdsError> {
        value::integer(self.value, node_id).map_err(|reason| self.error(reason))
    }
}

/// Section of the text.
#[derive(Debug)]
pub(super) struct Section<'t> {
    pub(super) line: usize,
    pub(super) name: &'t str,
    items: BTreeMap<Key<'t>, Item<'t>>,
}

impl<'t> Section<'t> {
    /// Returns the item with this key; `None` if it is absent or its value is empty.
    pub(super) fn get<'s>(&'s self, key: &'s str) -> Option<&'s Item<'t>> {
        let item = self.items.get(&Key(key));
        item.filter(|item| !item.value.is_empty())
    }

    /// Makes an error about the section as a whole.
    pub(super) fn error(&self, reason: impl Display) -> EdsError {
        self.error_at(self.line, reason)
    }

    /// Makes an error about a line of the section.
    fn error_at(&self, line: usize, reason: impl Display) -> EdsError {
        EdsError::at_line(line, format!("[{}] {reason}", self.name))
    }
}

/// Sections by their names in lower case, since case does not matter.
pub(super) type Sections<'t> = BTreeMap<String, Section<'t>>;

/// Splits a text into sections.
pub(super) fn read(text: &str) -> Result<Sections<'_>, EdsError> {
    let mut sections = Sections::new();
    let mut current = None;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    for (number, line) in (1..).zip(split(text, b'\n')) {
        let line = line.strip_suffix('\r').unwrap_or(line);
        if line.len() > MAX_LINE_BYTES {
            let reason = format!("the line has {} bytes (limit {MAX_LINE_BYTES})", line.len());
            return Err(EdsError::at_line(number, reason));
        }
        let line = line.trim();
        if line.is_empty() || line.starts_with([';', '#']) {
            continue;
        }
        if line.starts_with('[') {
            finish(&mut sections, current.replace(header(number, line)?))?;
        } else {
            let section = current
                .as_mut()
                .ok_or_else(|| EdsError::at_line(number, "a line before the first [section]"))?;
            add_item(section, number, line)?;
        }
    }
    finish(&mut sections, current)?;
    Ok(sections)
}

/// Reads `[name] ; comment`.
fn header(number: usize, line: &str) -> Result<Section<'_>, EdsError> {
    let (name, rest) = line[1..]
        .split_once(']')
        .ok_or_else(|| EdsError::at_line(number, "a section header without ']'"))?;
    if !without_comment(rest).is_empty() {
        let reason = format!("unexpected text after [{name}]");
        return Err(EdsError::at_line(number, reason));
    }
    Ok(Section {
        line: number,
        name: name.trim(),
        items: BTreeMap::new(),
    })
}

/// Adds a `key=value` line to a section.
fn add_item<'t>(section: &mut Section<'t>, number: usize, line: &'t str) -> Result<(), EdsError> {
    let (key, value) = cut(line, b'=')
        .ok_or_else(|| section.error_at(number, format!("expected key=value, found \"{line}\"")))?;
    let item = Item {
        line: number,
        section: section.name,
        key: key.trim_end(),
        value: without_comment(value),
    };
    match section.items.insert(Key(item.key), item) {
        Some(first) => Err(item.error(format!("the key stands in line {} already", first.line))),
        None => Ok(()),
    }
}

/// Adds a complete section to the others.
fn finish<'t>(sections: &mut Sections<'t>, section: Option<Section<'t>>) -> Result<(), EdsError> {
    let Some(section) = section else {
        return Ok(());
    };
    match sections.entry(section.name.to_ascii_lowercase()) {
        Entry::Vacant(place) => {
            place.insert(section);
            Ok(())
        }
        Entry::Occupied(first) => {
            let reason = format!("the section stands in line {} already", first.get().line);
            Err(section.error(reason))
        }
    }
}

/// Returns the value without a trailing comment: a semicolon at its start or after a blank.
fn without_comment(value: &str) -> &str {
    let mut before = b' ';
    let begins_comment = |letter: u8| {
        let is_after_blank = matches!(std::mem::replace(&mut before, letter), b' ' | b'\t');
        letter == b';' && is_after_blank
    };
    let end = value.bytes().position(begins_comment);
    value[..end.unwrap_or(value.len())].trim()
}

/// Splits a text at these ASCII letters. Texts are so short that the standard library's search, which looks at many bytes at
/// once, would take longer.
pub(super) fn split(text: &str, letter: u8) -> impl Iterator<Item = &str> {
    let mut rest = Some(text);
    std::iter::from_fn(move || {
        let text = rest?;
        let (piece, behind) = cut(text, letter).unzip();
        rest = behind;
        Some(piece.unwrap_or(text))
    })
}

/// Returns the text before and behind the first of these ASCII letters.
fn cut(text: &str, letter: u8) -> Option<(&str, &str)> {
    let place = text.bytes().position(|byte| byte == letter)?;
    Some((&text[..place], &text[place + 1..]))
}
