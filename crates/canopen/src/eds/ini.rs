//! The text layer of an EDS (CiA 306-1, clause 4): sections of `key=value` lines with comments.
//!
//! Written by hand because notes need line numbers, and because whatever is no such line must not hide the lines after it.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fmt::{self, Display};

use super::notes::{Notes, quoted};

/// Longest line of CiA 306-1.
const LINE_BYTES: usize = 255;

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
    /// Line in which the key has another value, which does not count.
    pub(super) contradicted_in: Option<usize>,
}

impl Display for Item<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [section, key, value] = [self.section, self.key, self.value].map(quoted);
        write!(formatter, "[{section}] {key}={value}")
    }
}

impl Item<'_> {
    /// Checks whether another item says the same.
    pub(super) fn agrees_with(&self, other: &Item<'_>) -> bool {
        self.value.eq_ignore_ascii_case(other.value)
    }
}

/// Section of the text.
#[derive(Debug)]
pub(super) struct Section<'t> {
    pub(super) line: usize,
    pub(super) name: &'t str,
    items: BTreeMap<Key<'t>, Item<'t>>,
}

impl Display for Section<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "[{}]", quoted(self.name))
    }
}

impl<'t> Section<'t> {
    /// Returns the item with this key; `None` if it is absent or its value is empty.
    pub(super) fn get<'s>(&'s self, key: &'s str) -> Option<&'s Item<'t>> {
        let item = self.items.get(&Key(key));
        item.filter(|item| !item.value.is_empty())
    }

    /// Returns all items.
    pub(super) fn items(&self) -> impl Iterator<Item = &Item<'t>> {
        self.items.values()
    }

    /// Adds an item, unless the key is there: then the first value counts.
    fn add(&mut self, item: Item<'t>, notes: &mut Notes) {
        match self.items.entry(Key(item.key)) {
            Entry::Vacant(place) => drop(place.insert(item)),
            Entry::Occupied(mut first) => {
                let first = first.get_mut();
                if item.agrees_with(first) {
                    let what = format!("{item}: the key stands in line {} already", first.line);
                    notes.add(item.line, what);
                    return;
                }
                first.contradicted_in.get_or_insert(item.line);
                let (line, value) = (first.line, quoted(first.value));
                let what = format!("{item}: the key has the value \"{value}\" in line {line}");
                notes.add(item.line, format!("{what}, which counts"));
            }
        }
    }
}

/// Sections by their names in lower case, without blanks and `0x`.
pub(super) type Sections<'t> = BTreeMap<String, Section<'t>>;

/// Splits a text into sections.
pub(super) fn read<'t>(text: &'t str, notes: &mut Notes) -> Sections<'t> {
    let mut sections = Sections::new();
    let mut current = None;
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    for (number, line) in (1..).zip(lines(text)) {
        if line.len() > LINE_BYTES {
            let length = line.len();
            notes.add(
                number,
                format!("the line has {length} bytes (limit {LINE_BYTES})"),
            );
        }
        if line.bytes().any(|byte| byte < b' ' && byte != b'\t') {
            notes.add(number, "the line has control characters");
        }
        let line = trimmed(line);
        if line.is_empty() || line.starts_with(';') {
            continue;
        }
        if line.starts_with('#') || line.starts_with("//") {
            notes.add(number, "a comment begins with a semicolon");
        } else if line.starts_with('[') {
            finish(
                &mut sections,
                current.replace(header(number, line, notes)),
                notes,
            );
        } else {
            add_line(current.as_mut(), number, line, notes);
        }
    }
    finish(&mut sections, current, notes);
    sections
}

/// Splits a text at line feeds, carriage returns and pairs of them.
fn lines(text: &str) -> impl Iterator<Item = &str> {
    let mut rest = Some(text);
    std::iter::from_fn(move || {
        let text = rest?;
        let mut bytes = text.bytes();
        let Some(end) = bytes.position(|byte| matches!(byte, b'\n' | b'\r')) else {
            rest = None;
            return Some(text);
        };
        let behind = &text[end..];
        let width = if behind.starts_with("\r\n") { 2 } else { 1 };
        rest = Some(&behind[width..]);
        Some(&text[..end])
    })
}

/// Returns a text without what cannot be seen at its ends: blanks, NUL bytes, the end mark of CP/M (0x1A).
fn trimmed(text: &str) -> &str {
    text.trim_matches(|letter: char| {
        letter.is_whitespace() || letter.is_control() || letter == '\u{feff}'
    })
}

/// Reads `[name] ; comment`.
fn header<'t>(number: usize, line: &'t str, notes: &mut Notes) -> Section<'t> {
    let (name, rest) = line[1..].split_once(']').unwrap_or_else(|| {
        notes.add(number, "a section header without ']'");
        (without_comment(&line[1..]), "")
    });
    if !without_comment(rest).is_empty() {
        let name = quoted(name);
        notes.add(number, format!("unexpected text after [{name}]"));
    }
    Section {
        line: number,
        name: trimmed(name),
        items: BTreeMap::new(),
    }
}

/// Adds a `key=value` line to a section.
fn add_line<'t>(
    section: Option<&mut Section<'t>>,
    number: usize,
    line: &'t str,
    notes: &mut Notes,
) {
    let Some(section) = section else {
        return notes.add(number, "a line before the first [section]");
    };
    let Some((key, value)) = cut(line, b'=').filter(|(key, _)| !key.trim_end().is_empty()) else {
        let found = quoted(line);
        return notes.add(
            number,
            format!("{section} expected key=value, found \"{found}\""),
        );
    };
    let item = Item {
        line: number,
        section: section.name,
        key: key.trim_end(),
        value: without_comment(value),
        contradicted_in: None,
    };
    section.add(item, notes);
}

/// Adds a complete section to the others; one that is there takes its items.
fn finish<'t>(sections: &mut Sections<'t>, section: Option<Section<'t>>, notes: &mut Notes) {
    let Some(section) = section else {
        return;
    };
    match sections.entry(normalised(&section, notes)) {
        Entry::Vacant(place) => drop(place.insert(section)),
        Entry::Occupied(mut first) => {
            let first = first.get_mut();
            let what = format!(
                "{section} the section stands in line {} already",
                first.line
            );
            notes.add(section.line, what);
            for item in section.items.into_values() {
                first.add(item, notes);
            }
        }
    }
}

/// Returns the name by which a section is found.
fn normalised(section: &Section<'_>, notes: &mut Notes) -> String {
    let mut name = section.name.to_ascii_lowercase();
    if name.contains(char::is_whitespace) || name.starts_with("0x") {
        name.retain(|letter| !letter.is_whitespace());
        let written = name.len();
        name = name.strip_prefix("0x").unwrap_or(&name).to_owned();
        // A word such as "Tool 1" is nobody's concern.
        if name.len() != written || name.as_bytes().first().is_some_and(u8::is_ascii_digit) {
            notes.add(section.line, format!("{section} is read as [{name}]"));
        }
    }
    name
}

/// Returns the value without a trailing comment: a semicolon at its start or after a blank.
fn without_comment(value: &str) -> &str {
    let mut before = b' ';
    let begins_comment = |letter: u8| {
        let is_after_blank = matches!(std::mem::replace(&mut before, letter), b' ' | b'\t');
        letter == b';' && is_after_blank
    };
    let end = value.bytes().position(begins_comment);
    trimmed(&value[..end.unwrap_or(value.len())])
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
