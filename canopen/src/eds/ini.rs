//! The text layer of an EDS (CiA 306-1, clause 4): sections of `key=value` lines with comments.
//!
//! Written by hand because errors need line numbers and a repeated section or key must be an error, not a silent merge.

use std::collections::BTreeMap;

use super::EdsError;

/// Longest line; CiA 306-1 allows 255 characters.
const MAX_LINE_BYTES: usize = 1024;

/// One `key=value` line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Item<'t> {
    pub(super) line: usize,
    pub(super) section: &'t str,
    pub(super) key: &'t str,
    pub(super) value: &'t str,
}

impl Item<'_> {
    /// An error about this item.
    pub(super) fn error(&self, reason: impl Into<String>) -> EdsError {
        EdsError {
            line: self.line,
            section: self.section.to_owned(),
            key: self.key.to_owned(),
            value: self.value.to_owned(),
            reason: reason.into(),
        }
    }
}

/// One section.
#[derive(Debug)]
pub(super) struct Section<'t> {
    pub(super) line: usize,
    pub(super) name: &'t str,
    items: BTreeMap<String, Item<'t>>,
}

impl<'t> Section<'t> {
    /// The item with this key (lower case); `None` when it is absent or its value is empty.
    pub(super) fn get(&self, key: &str) -> Option<&Item<'t>> {
        self.items.get(key).filter(|item| !item.value.is_empty())
    }

    /// All items, sorted by key.
    pub(super) fn items(&self) -> impl Iterator<Item = &Item<'t>> {
        self.items.values()
    }

    /// An error about the section as a whole.
    pub(super) fn error(&self, reason: impl Into<String>) -> EdsError {
        EdsError {
            line: self.line,
            section: self.name.to_owned(),
            key: String::new(),
            value: String::new(),
            reason: reason.into(),
        }
    }
}

/// Sections by their lower-case names.
pub(super) type Sections<'t> = BTreeMap<String, Section<'t>>;

/// Splits a text into sections.
pub(super) fn read(text: &str) -> Result<Sections<'_>, EdsError> {
    let mut sections = Sections::new();
    let mut current = None;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    for (number, line) in (1..).zip(text.lines()) {
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
    let (key, value) = line.split_once('=').ok_or_else(|| EdsError {
        line: number,
        ..section.error(format!("expected key=value, found \"{line}\""))
    })?;
    let item = Item {
        line: number,
        section: section.name,
        key: key.trim(),
        value: without_comment(value),
    };
    match section.items.insert(item.key.to_ascii_lowercase(), item) {
        Some(first) => Err(item.error(format!("the key stands in line {} already", first.line))),
        None => Ok(()),
    }
}

/// Files a section that is complete.
fn finish<'t>(sections: &mut Sections<'t>, section: Option<Section<'t>>) -> Result<(), EdsError> {
    let Some(section) = section else {
        return Ok(());
    };
    let name = section.name.to_ascii_lowercase();
    if let Some(first) = sections.get(&name) {
        let reason = format!("the section stands in line {} already", first.line);
        return Err(section.error(reason));
    }
    sections.insert(name, section);
    Ok(())
}

/// The value without a trailing comment: a semicolon at its start or after a blank.
fn without_comment(value: &str) -> &str {
    let is_comment = |(place, _): &(usize, &str)| {
        value[..*place].is_empty() || value[..*place].ends_with([' ', '\t'])
    };
    let end = value.match_indices(';').find(is_comment);
    value[..end.map_or(value.len(), |(place, _)| place)].trim()
}
