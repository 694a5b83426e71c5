//! Statements of an EDS about itself: its sections and its lists of objects (CiA 306-1, clauses 4.4 and 4.5). Nothing here decides what is
//! read, but a sheet that contradicts itself may be of another device than its user thinks.

use std::collections::BTreeSet;

use super::ini::{Item, Section, Sections};
use super::notes::Notes;
use super::value;

/// Lists of objects.
const LISTS: [&str; 3] = ["mandatoryobjects", "optionalobjects", "manufacturerobjects"];
/// Sections that each EDS has, as the standard writes them.
const REQUIRED: [&str; 3] = ["FileInfo", "DeviceInfo", "MandatoryObjects"];
/// First index that a list has: below are the data types.
const FIRST: u16 = 0x1000;

/// Notes how the lists differ from the objects that are described.
pub(super) fn check(sections: &Sections<'_>, described: &BTreeSet<u16>, notes: &mut Notes) {
    for name in REQUIRED {
        if !sections.contains_key(&name.to_ascii_lowercase()) {
            notes.add(0, format!("there is no section [{name}]"));
        }
    }
    let mut listed = BTreeSet::new();
    for list in LISTS.iter().filter_map(|list| sections.get(*list)) {
        check_list(list, described, &mut listed, notes);
    }
    let has_lists = LISTS.iter().any(|list| sections.contains_key(*list));
    let unlisted = described
        .iter()
        .filter(|index| **index >= FIRST && !listed.contains(index));
    if has_lists && let Some(objects) = several(unlisted) {
        notes.add(0, format!("no list has {objects}"));
    }
}

/// Notes the gaps of one list, and adds its objects to those that are listed.
fn check_list(
    list: &Section<'_>,
    described: &BTreeSet<u16>,
    listed: &mut BTreeSet<u16>,
    notes: &mut Notes,
) {
    let place = |item: &Item<'_>| item.key.parse::<u32>().ok();
    let numbered = list.items().filter_map(|item| Some((place(item)?, item)));
    let numbered = Vec::from_iter(numbered);
    let count = numbered.len();
    if let Some(item) = list.get("supportedobjects")
        && value::integer(item.value, 1)
            .ok()
            .and_then(|one| usize::try_from(one.value).ok())
            != Some(count)
    {
        notes.add(item.line, format!("{item}: the list has {count} objects"));
    }
    let last = numbered.iter().map(|(place, _)| *place).max();
    if last.is_some_and(|last| usize::try_from(last) != Ok(count)) {
        notes.add(
            list.line,
            format!("{list} the numbers of the objects have gaps"),
        );
    }
    let index = |item: &Item<'_>| {
        let read = value::integer(item.value, 1).ok()?;
        u16::try_from(read.value).ok()
    };
    let mut missing = BTreeSet::new();
    for (_, item) in numbered {
        match index(item) {
            None => notes.add(item.line, format!("{item}: expected an index")),
            Some(index) if !described.contains(&index) => drop(missing.insert(index)),
            Some(index) if !listed.insert(index) => {
                notes.add(item.line, format!("{item}: the object is listed already"));
            }
            Some(_) => {}
        }
    }
    if let Some(objects) = several(missing.iter()) {
        notes.add(
            list.line,
            format!("{list} there is no section for {objects}"),
        );
    }
}

/// Names the first of several objects; `None` if there is none.
fn several<'a>(mut indices: impl Iterator<Item = &'a u16>) -> Option<String> {
    let first = indices.next()?;
    Some(match indices.count() {
        0 => format!("0x{first:04X}"),
        more => format!("0x{first:04X} and {more} more"),
    })
}
