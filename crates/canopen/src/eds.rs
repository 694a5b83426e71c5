//! Electronic data sheets (CiA 306-1): from EDS or DCF text to the object dictionary of one node.
//!
//! Bought devices' data sheets are rarely free of errors. What the text says is read wherever it can mean one thing only; the rest is
//! left out, object by object and key by key. [`Notes`] list both. Whoever needs what is left out refuses the sheet.

use std::collections::btree_map::Entry as Slot;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use crate::object_dictionary::{Access, DataType, Entry, ObjectDictionary};

mod ini;
mod lists;
mod notes;
mod standard;
#[cfg(test)]
mod tests;
mod text;
mod value;

use ini::{Item, Section, Sections};
use notes::quoted;
pub use notes::{Note, Notes};
pub use standard::data_type as standard_type;
pub use text::text;
use value::Reading;
pub use value::octets;

/// Longest text that is read.
pub const MAX_TEXT_BYTES: usize = 4 << 20;

/// Most sub-objects that a dictionary may have; compact sub-objects let a short text ask for millions.
pub const MAX_ENTRIES: usize = 32_768;

/// Most characters of an object's name that are kept, about a line of CiA 306-1.
const NAME_MAX: usize = 241;
/// Name of an object that has none in the sheet.
const UNNAMED: &str = "unnamed";
/// Objects by which a device is told from others: its type, vendor and product.
pub const IDENTITY: [(u16, u8); 3] = [(0x1000, 0), (0x1018, 1), (0x1018, 2)];

/// Reason why a text is not the data sheet of a node.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct EdsError(String);

/// Content of a data sheet.
#[derive(Clone, Debug, PartialEq)]
pub struct Sheet {
    /// Objects, which hold their defaults.
    pub dictionary: ObjectDictionary,
    /// Slips of the text.
    pub notes: Notes,
    /// Sub-objects that the text describes in two ways, with the lines.
    contradictions: BTreeMap<(u16, u8), String>,
}

impl Sheet {
    /// Returns how the text contradicts itself on a sub-object.
    pub fn contradiction(&self, index: u16, sub_index: u8) -> Option<&str> {
        let found = self.contradictions.get(&(index, sub_index));
        found.map(String::as_str)
    }
}

/// Reads the objects in the text of an EDS or DCF for the node `node_id`, as [`read`] does, without the notes.
///
/// # Errors
/// As [`read`].
pub fn parse(text: &str, node_id: u8) -> Result<ObjectDictionary, EdsError> {
    read(text, node_id).map(|sheet| sheet.dictionary)
}

/// Reads the objects in the text of an EDS or DCF for the node `node_id`; they hold their defaults.
///
/// A trailing comment starts with a semicolon after a blank. Numbers may be decimal, hexadecimal (`0x`), octal (leading
/// 0) and contain `$NODEID`. A number without default is 0. `ParameterValue` (DCF) takes the place of `DefaultValue`.
/// Sections that describe no value are passed over. A data type that is not a basic one of CiA 301 is read as DOMAIN.
///
/// What differs from CiA 306-1 is noted: of a key or section that comes twice the first counts, a key that is missing or
/// unreadable is as if it were not there, limits of which the lower one is above the upper one are none.
///
/// # Errors
/// The node-ID is none, the text is too long or describes no object or too many, or it gives the device a type, vendor or product
/// that no device can have.
pub fn read(text: &str, node_id: u8) -> Result<Sheet, EdsError> {
    if !(1..=127).contains(&node_id) {
        let reason = format!("node-ID {node_id} is outside 1 to 127");
        return Err(EdsError(reason));
    }
    if text.len() > MAX_TEXT_BYTES {
        let reason = format!("the text has {} bytes (limit {MAX_TEXT_BYTES})", text.len());
        return Err(EdsError(reason));
    }
    let mut notes = Notes::default();
    let sections = ini::read(text, &mut notes);
    let mut reader = Reader {
        node_id,
        sections: &sections,
        dictionary: ObjectDictionary::new(),
        notes,
        contradictions: BTreeMap::new(),
    };
    let described = reader.described_indices();
    for index in &described {
        reader.object(*index)?;
    }
    reader.note_compact_pdos();
    let Reader {
        dictionary,
        mut notes,
        contradictions,
        ..
    } = reader;
    if dictionary.entries().is_empty() {
        return Err(EdsError("it describes no object: is it an EDS?".to_owned()));
    }
    lists::check(&sections, &described, &mut notes);
    notes.sort();
    Ok(Sheet {
        dictionary,
        notes,
        contradictions,
    })
}

/// Splits the name of a section that describes an object: `1018`, `1018sub1`, `1018name` or `1018value`.
fn index_and_part(name: &str) -> Option<(u16, &str)> {
    let (index, part) = name.split_at_checked(4)?;
    let is_index = index.bytes().all(|letter| letter.is_ascii_hexdigit());
    let index = u16::from_str_radix(index, 16).ok().filter(|_| is_index)?;
    Some((index, part))
}

/// Sub-objects that are described one by one.
type Subs<'s, 't> = BTreeMap<u8, &'s Section<'t>>;

/// Collects sub-objects.
struct Reader<'s, 't> {
    node_id: u8,
    sections: &'s Sections<'t>,
    dictionary: ObjectDictionary,
    notes: Notes,
    contradictions: BTreeMap<(u16, u8), String>,
}

impl<'s, 't> Reader<'s, 't> {
    /// Returns the indices of all objects that have a section, of their own or of a sub-object.
    fn described_indices(&mut self) -> BTreeSet<u16> {
        let mut indices = BTreeSet::new();
        for (name, section) in self.sections {
            let Some((index, part)) = index_and_part(name) else {
                continue;
            };
            if part.is_empty() || part.starts_with("sub") {
                indices.insert(index);
            } else if matches!(part, "name" | "value") && !self.sections.contains_key(&name[..4]) {
                self.remark(section, format!("there is no section [{index:04X}]"));
            }
        }
        indices
    }

    /// Notes a slip of a section as a whole.
    fn remark(&mut self, section: &Section<'_>, what: impl fmt::Display) {
        self.notes.add(section.line, format!("{section} {what}"));
    }

    /// Notes a slip of an item.
    fn remark_on(&mut self, item: &Item<'_>, what: impl fmt::Display) {
        self.notes.add(item.line, format!("{item}: {what}"));
    }

    /// Returns the sections `[1018sub1]` of an object.
    fn subs(&mut self, index: u16) -> Subs<'s, 't> {
        let prefix = format!("{index:04x}sub");
        let mut subs = Subs::new();
        for (name, section) in self.sections.range(prefix.clone()..) {
            let Some(digits) = name.strip_prefix(&prefix) else {
                break;
            };
            let bare = digits.strip_prefix("0x").unwrap_or(digits);
            let sub_index = u8::from_str_radix(bare, 16).ok();
            let Some(sub_index) = sub_index.filter(|_| !bare.starts_with('+')) else {
                self.remark(
                    section,
                    format!("\"{}\" is not a sub-index", quoted(digits)),
                );
                continue;
            };
            match subs.entry(sub_index) {
                Slot::Vacant(place) => drop(place.insert(section)),
                Slot::Occupied(mut place) => {
                    let other = place.insert(if section.line < place.get().line {
                        section
                    } else {
                        place.get()
                    });
                    self.repeated_sub((index, sub_index), [section, other]);
                }
            }
        }
        subs
    }

    /// Notes that two sections describe a sub-object, of which the first one counts.
    fn repeated_sub(&mut self, place: (u16, u8), mut sections: [&Section<'_>; 2]) {
        sections.sort_by_key(|section| section.line);
        let [first, second] = sections;
        let what = format!("the sub-object stands in line {} already", first.line);
        self.remark(second, &what);
        let differs = second.items().any(|item| {
            let same = first.get(item.key);
            !same.is_some_and(|same| same.agrees_with(item))
        });
        if differs {
            let what = format!("lines {} and {} differ", first.line, second.line);
            self.contradictions.entry(place).or_insert(what);
        }
    }

    /// Reads one object by its object type (CiA 301, table 42).
    fn object(&mut self, index: u16) -> Result<(), EdsError> {
        let subs = self.subs(index);
        let Some(main) = self.sections.get(&format!("{index:04x}")) else {
            if let Some(section) = subs.values().next() {
                self.remark(section, format!("there is no section [{index:04X}]"));
            }
            return self.described_subs(index, subs);
        };
        let object_type = self.object_type(main);
        match object_type {
            // NULL, DEFTYPE and DEFSTRUCT hold no value.
            Some(0 | 5 | 6) if subs.is_empty() => return Ok(()),
            None | Some(2 | 7) if subs.is_empty() => {
                return self.described(index, 0, main, object_type);
            }
            Some(8 | 9) => {}
            Some(_) => self.remark(main, "is neither ARRAY nor RECORD, but has sub-objects"),
            None => self.remark(main, "the key ObjectType is missing"),
        }
        self.check_sub_number(main, &subs);
        let is_compact = self.compact_sub_objects(index, main)?;
        if !subs.contains_key(&0) && !is_compact && main.get("datatype").is_some() {
            self.remark(main, "has a value of its own, which is read as sub-index 0");
            self.described(index, 0, main, object_type)?;
        }
        self.described_subs(index, subs)
    }

    fn described_subs(&mut self, index: u16, subs: Subs<'s, 't>) -> Result<(), EdsError> {
        for (sub_index, section) in subs {
            let object_type = self.object_type(section);
            self.described(index, sub_index, section, object_type)?;
        }
        Ok(())
    }

    /// Keeps the value that a section describes.
    fn described(
        &mut self,
        index: u16,
        sub_index: u8,
        section: &Section<'_>,
        object_type: Option<u8>,
    ) -> Result<(), EdsError> {
        let entry = self.entry((index, sub_index), section, object_type == Some(2))?;
        self.add(entry, section)
    }

    /// Reads `ObjectType`, a number or, by a slip, its name; `None` if it is missing or unknown.
    fn object_type(&mut self, section: &Section<'_>) -> Option<u8> {
        const NAMES: [(&str, u8); 7] = [
            ("NULL", 0),
            ("DOMAIN", 2),
            ("DEFTYPE", 5),
            ("DEFSTRUCT", 6),
            ("VAR", 7),
            ("ARRAY", 8),
            ("RECORD", 9),
        ];
        let item = section.get("objecttype")?;
        let word = value::unquoted(item.value);
        let mut names = NAMES.iter();
        if let Some((_, number)) = names.find(|(name, _)| name.eq_ignore_ascii_case(word)) {
            self.remark_on(item, format!("it is read as {number}"));
            return Some(*number);
        }
        let number = self.integer_at(section, "objecttype", u8::MAX)?;
        if NAMES.iter().any(|(_, known)| *known == number) {
            return Some(number);
        }
        self.remark_on(item, "the object type is unknown");
        None
    }

    /// Notes a number of sub-objects that is not theirs.
    fn check_sub_number(&mut self, main: &Section<'_>, subs: &Subs<'_, '_>) {
        let number = self.integer_at(main, "subnumber", u8::MAX);
        if let (Some(number), Some(item)) = (number, main.get("subnumber"))
            && usize::from(number) != subs.len()
            && main.get("compactsubobj").is_none()
        {
            self.remark_on(item, format!("{} sub-objects are described", subs.len()));
        }
    }

    /// Expands `CompactSubObj` (CiA 306-1, clause 4.6.3.4): sub-index 0 and that number of equal sub-objects, whose place those
    /// that are described one by one then take. Returns whether there are any.
    fn compact_sub_objects(&mut self, index: u16, main: &Section<'_>) -> Result<bool, EdsError> {
        let count = self.integer_at(main, "compactsubobj", 254_u8).unwrap_or(0);
        if count == 0 {
            return Ok(false);
        }
        let mut number_of_entries = Entry::new(
            index,
            0,
            "NrOfObjects",
            DataType::Unsigned8,
            Access::ReadOnly,
            vec![count],
        );
        number_of_entries.high_limit = Some(254);
        self.add(number_of_entries, main)?;
        let template = self.entry((index, 1), main, false)?;
        let sections = self.sections;
        let [names, values] =
            ["name", "value"].map(|part| sections.get(&format!("{index:04x}{part}")));
        for sub_index in 1..=count {
            let key = sub_index.to_string();
            let mut entry = template.clone();
            entry.sub_index = sub_index;
            entry.name = match names.and_then(|names| names.get(&key)) {
                Some(item) => self.shortened(item),
                None => format!("{}{sub_index}", template.name),
            };
            if let Some(item) = values.and_then(|values| values.get(&key))
                && let Some(default) = self.value((index, sub_index), template.data_type, item)?
            {
                entry.set_default(default);
            }
            self.add(entry, main)?;
        }
        Ok(true)
    }

    /// Reads the section of one value.
    fn entry(
        &mut self,
        place: (u16, u8),
        section: &Section<'_>,
        is_domain: bool,
    ) -> Result<Entry, EdsError> {
        let data_type = self.data_type(place, section, is_domain);
        let access = self.access(section, is_domain);
        let name = match section.get("parametername") {
            Some(item) => self.shortened(item),
            None => {
                self.remark(section, "the key ParameterName is missing");
                UNNAMED.to_owned()
            }
        };
        let mut default = None;
        for key in ["parametervalue", "defaultvalue"] {
            if let Some(item) = section.get(key).filter(|_| default.is_none()) {
                default = self.value(place, data_type, item)?;
            }
        }
        let default = default.unwrap_or_else(|| vec![0; data_type.size_bytes().unwrap_or(0)]);
        let mut entry = Entry::new(place.0, place.1, &name, data_type, access, default);
        let mapping = self.integer_at(section, "pdomapping", 1_u8);
        entry.is_pdo_mappable = mapping == Some(1);
        entry.lacks_pdo_mapping = mapping.is_none();
        (entry.low_limit, entry.high_limit) = self.limits(data_type, section);
        self.contradicted(place, section);
        Ok(entry)
    }

    /// Keeps that the text contradicts itself on a sub-object, unless nobody needs the key.
    fn contradicted(&mut self, place: (u16, u8), section: &Section<'_>) {
        const NEEDED: [&str; 5] = [
            "datatype",
            "accesstype",
            "pdomapping",
            "parametervalue",
            "defaultvalue",
        ];
        let items = NEEDED.iter().filter_map(|key| section.get(key));
        for (item, other) in items.filter_map(|item| Some((item, item.contradicted_in?))) {
            let what = format!("line {}: {item}: line {other} has another value", item.line);
            self.contradictions.entry(place).or_insert(what);
        }
    }

    /// Returns the name of an object.
    fn shortened(&mut self, item: &Item<'_>) -> String {
        let name = value::unquoted(item.value);
        if let Some((end, _)) = name.char_indices().nth(NAME_MAX) {
            self.remark_on(
                item,
                format!("the name has more than {NAME_MAX} characters"),
            );
            return name[..end].to_owned();
        }
        name.to_owned()
    }

    /// Reads limits; types without an order have none.
    fn limits(
        &mut self,
        data_type: DataType,
        section: &Section<'_>,
    ) -> (Option<i128>, Option<i128>) {
        if data_type.size_bytes().is_none() {
            return (None, None);
        }
        let [low, high] = ["lowlimit", "highlimit"].map(|key| {
            let item = section.get(key)?;
            let bytes = self.encode(data_type, item).ok()?;
            Some((data_type.rank(&bytes), item))
        });
        if let (Some((low, item)), Some((high, _))) = (low, high)
            && low > high
        {
            let what = format!("LowLimit is above HighLimit as {data_type:?}: both are ignored");
            self.remark_on(item, what);
            return (None, None);
        }
        let rank = |limit: Option<(i128, _)>| limit.map(|(rank, _)| rank);
        (rank(low), rank(high))
    }

    /// Reads `DataType`; without a known one it is that of the standard.
    fn data_type(
        &mut self,
        (index, sub_index): (u16, u8),
        section: &Section<'_>,
        is_domain: bool,
    ) -> DataType {
        let standard = standard::data_type(index, sub_index).unwrap_or(DataType::Domain);
        let Some(item) = section.get("datatype") else {
            if is_domain {
                return DataType::Domain;
            }
            let what = format!("the key DataType is missing: it is read as {standard:?}");
            self.remark(section, what);
            return standard;
        };
        if let Some(named) = DataType::from_name(value::unquoted(item.value)) {
            self.remark_on(item, format!("it is read as 0x{:04X}", named.number()));
            return named;
        }
        let number = self
            .integer(item)
            .and_then(|number| u32::try_from(number).ok());
        if let Some(known) = number.and_then(DataType::from_number) {
            return known;
        }
        // Structures of the standard, the profiles and the makers are no slip.
        if number.is_none_or(|number| number < 0x20) || standard != DataType::Domain {
            self.remark_on(
                item,
                format!("the data type is unknown: it is read as {standard:?}"),
            );
        }
        standard
    }

    /// Reads `AccessType`; without a known one an object can be read and written.
    fn access(&mut self, section: &Section<'_>, is_domain: bool) -> Access {
        let Some(item) = section.get("accesstype") else {
            if !is_domain {
                self.remark(section, "the key AccessType is missing: it is read as rw");
            }
            return Access::ReadWrite;
        };
        let word = value::unquoted(item.value);
        let mut all = Access::ALL.into_iter();
        all.find(|access| word.eq_ignore_ascii_case(access.word()))
            .unwrap_or_else(|| {
                self.remark_on(
                    item,
                    "expected ro, wo, rw, rwr, rww or const: it is read as rw",
                );
                Access::ReadWrite
            })
    }

    /// Reads a default or the value of a DCF; `None` if it is unreadable.
    ///
    /// # Errors
    /// A device type, vendor or product that no device has.
    fn value(
        &mut self,
        place: (u16, u8),
        data_type: DataType,
        item: &Item<'_>,
    ) -> Result<Option<Vec<u8>>, EdsError> {
        match self.encode(data_type, item) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) if error.is_number && IDENTITY.contains(&place) => {
                let (line, reason) = (item.line, error.reason);
                Err(EdsError(format!(
                    "line {line}: {item}: {reason}, so this is no device"
                )))
            }
            Err(_) => Ok(None),
        }
    }

    /// Reads a value of a type, and notes what is wrong with it.
    fn encode(
        &mut self,
        data_type: DataType,
        item: &Item<'_>,
    ) -> Result<Vec<u8>, value::Unreadable> {
        let read = value::encode(data_type, item.value, self.node_id);
        self.noted(item, read)
    }

    /// Reads an integer, and notes what is wrong with it; `None` if it is unreadable.
    fn integer(&mut self, item: &Item<'_>) -> Option<i128> {
        let read = value::integer(item.value, self.node_id);
        self.noted(item, read).ok()
    }

    fn noted<T>(
        &mut self,
        item: &Item<'_>,
        read: Result<Reading<T>, value::Unreadable>,
    ) -> Result<T, value::Unreadable> {
        match read {
            Ok(Reading { value, slip }) => {
                slip.into_iter().for_each(|slip| self.remark_on(item, slip));
                Ok(value)
            }
            Err(error) => {
                self.remark_on(item, format!("{}: it is ignored", error.reason));
                Err(error)
            }
        }
    }

    /// Reads an integer from a section, at most `limit`; `None` if it is missing or unreadable.
    fn integer_at<T>(&mut self, section: &Section<'_>, key: &str, limit: T) -> Option<T>
    where
        T: Copy + Into<i128> + TryFrom<i128>,
    {
        let item = section.get(key)?;
        let value = self.integer(item)?;
        match T::try_from(value) {
            Ok(inside) if (0..=limit.into()).contains(&value) => Some(inside),
            _ => {
                let limit = limit.into();
                self.remark_on(
                    item,
                    format!("{value} is outside 0 to {limit}: it is ignored"),
                );
                None
            }
        }
    }

    /// Keeps a sub-object.
    fn add(&mut self, entry: Entry, section: &Section<'_>) -> Result<(), EdsError> {
        self.dictionary.insert(entry);
        if self.dictionary.entries().len() > MAX_ENTRIES {
            let line = section.line;
            return Err(EdsError(format!(
                "line {line}: {section} more than {MAX_ENTRIES} sub-objects"
            )));
        }
        Ok(())
    }

    /// Notes PDOs that the sheet leaves to `CompactPDO`: which objects they have is not known.
    fn note_compact_pdos(&mut self) {
        let Some(section) = self.sections.get("deviceinfo") else {
            return;
        };
        let Some(item) = section.get("compactpdo") else {
            return;
        };
        if self.integer_at(section, "compactpdo", u8::MAX).unwrap_or(0) == 0 {
            return;
        }
        for (count_key, first) in [("nrofrxpdo", "1400"), ("nroftxpdo", "1800")] {
            let count = self.integer_at(section, count_key, 512_u16).unwrap_or(0);
            if count > 0 && !self.sections.contains_key(first) {
                self.remark_on(
                    item,
                    format!("compact PDOs are not read: [{first}] is missing"),
                );
            }
        }
    }
}
