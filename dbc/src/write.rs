//! Writer of DBC files.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fmt::{self, Display, Formatter};

use can::frame::EXTENDED_FLAG;

use crate::coding::{ByteOrder, Coding, Kind};
use crate::database::{Database, Message, Signal};
use crate::notation::{
    CYCLE_TIME, LONG_NAME, MESSAGE_OF_SIGNAL, OBJECT, PLACE_IN_MESSAGE, START_BIT_IN_MESSAGE,
    escaped,
};

/// Everything before the nodes; other tools want the whole list of symbols.
const HEAD: &str = "VERSION \"\"\n\n\nNS_ :\n\tNS_DESC_\n\tCM_\n\tBA_DEF_\n\tBA_\n\tVAL_\n\tCAT_DEF_\n\tCAT_\n\tFILTER\n\
    \tBA_DEF_DEF_\n\tEV_DATA_\n\tENVVAR_DATA_\n\tSGTYPE_\n\tSGTYPE_VAL_\n\tBA_DEF_SGTYPE_\n\tBA_SGTYPE_\n\
    \tSIG_TYPE_REF_\n\tVAL_TABLE_\n\tSIG_GROUP_\n\tSIG_VALTYPE_\n\tSIGTYPE_VALTYPE_\n\tBO_TX_BU_\n\tBA_DEF_REL_\n\
    \tBA_REL_\n\tBA_SGTYPE_REL_\n\tSG_MUL_VAL_\n\nBS_:\n\n";
/// Remark for readers of the file.
const COMMENT: &str = "Written by canrig. No frame carries a message with the attribute MessageOfSignal, which \
     holds a signal that is in no payload of that message.";
/// Name in the place of a missing node.
const NO_NODE: &str = "Vector__XXX";
/// Longest name of a signal.
const NAME_CHARACTERS_MAX: usize = 32;
/// Largest cycle time that the file declares, unless there is a larger one.
const CYCLE_TIME_MAX: u64 = 65_535;
const IDENTIFIER_MAX: u32 = EXTENDED_FLAG | 0x1FFF_FFFF;
const PAYLOAD_BYTES_MAX: u8 = 8;

impl Database {
    /// Writes the database as a DBC file, in UTF-8: [`Database::parse`] reads an equal one from it. Messages are in the order of
    /// their identifiers.
    ///
    /// Attributes hold the facts that the grammar cannot express. Each signal that does not fit its message's payload, or shares
    /// bits with another, is in the file in a separate message, under a free 29-bit identifier. A name that is no DBC name of
    /// at most 32 characters gets a short one in addition. In texts `"` is written as `\"`, which other readers understand, and
    /// `\` as `\x5C`, which they do not.
    ///
    /// A DBC cannot express the following, which [`Database::parse`] reads otherwise or refuses: a signal without a name, two of
    /// the same name in a message, a range from 0 to 0 (which is none), a number that is not finite, a factor of 0, an identifier
    /// above 0x7FF without the flag for 29 bits, a payload beyond 8 bytes, a text beyond [`Database::TEXT_BYTES_MAX`].
    pub fn to_dbc(&self) -> String {
        File::new(self.messages()).to_string()
    }
}

/// A DBC file.
struct File<'a> {
    messages: Vec<Entry<'a>>,
}

/// A message of the file.
struct Entry<'a> {
    file_id: u32,
    name: Cow<'a, str>,
    length_bytes: u8,
    sender: Option<&'a str>,
    cycle_time_milliseconds: u64,
    comment: &'a str,
    signals: Vec<Line<'a>>,
    origin: Origin<'a>,
}

/// Origin of a message of the file.
enum Origin<'a> {
    /// A message of the bus.
    Bus,
    /// A signal of another message, with its place and start bit there.
    Unplaced {
        message: &'a str,
        place: usize,
        start_bit: u8,
    },
}

/// A signal of the file.
struct Line<'a> {
    short_name: String,
    coding: Coding,
    signal: &'a Signal,
}

impl<'a> File<'a> {
    fn new(messages: &'a [Message]) -> Self {
        let mut entries = Vec::new();
        let mut unplaced = Vec::new();
        for message in messages {
            let (placed, others) = placed_and_unplaced(message);
            entries.push(Entry::new(message, placed));
            unplaced.extend(
                others
                    .into_iter()
                    .map(|(place, signal)| (message, place, signal)),
            );
        }
        let names: BTreeSet<_> = messages.iter().map(|message| &message.name).collect();
        let free_names = (1..)
            .map(|number: u32| format!("unplaced_{number}"))
            .filter(|name| !names.contains(name));
        let unplaced = unplaced.into_iter().zip(free_names);
        entries.extend(unplaced.map(|((message, place, signal), name)| {
            Entry::with_signal(message, place, signal, name)
        }));
        give_identifiers(messages, &mut entries);
        entries.sort_by_key(|entry| entry.file_id);
        Self { messages: entries }
    }

    /// Returns all signals, each with its message.
    fn lines(&self) -> impl Iterator<Item = (&Entry<'a>, &Line<'a>)> {
        let messages = self.messages.iter();
        messages.flat_map(|entry| entry.signals.iter().map(move |line| (entry, line)))
    }

    /// Returns senders and receivers in the order in which they appear.
    fn nodes(&self) -> Vec<&'a str> {
        let mut nodes = Vec::new();
        for entry in &self.messages {
            let receivers = entry.signals.iter().flat_map(|line| &line.signal.receivers);
            for node in entry
                .sender
                .into_iter()
                .chain(receivers.map(String::as_str))
            {
                if !nodes.contains(&node) {
                    nodes.push(node);
                }
            }
        }
        nodes
    }
}

impl<'a> Entry<'a> {
    fn new(message: &'a Message, signals: Vec<&'a Signal>) -> Self {
        let short_names = short_names(&signals).into_iter();
        let lines = short_names.zip(signals).map(|(short_name, signal)| Line {
            short_name,
            coding: signal.coding,
            signal,
        });
        Self {
            file_id: message.raw_id,
            name: Cow::Borrowed(&message.name),
            length_bytes: message.length_bytes,
            sender: message.sender.as_deref(),
            cycle_time_milliseconds: message.cycle_time_milliseconds,
            comment: &message.comment,
            signals: lines.collect(),
            origin: Origin::Bus,
        }
    }

    /// Makes a message for one signal, which begins with the first bit.
    fn with_signal(message: &'a Message, place: usize, signal: &'a Signal, name: String) -> Self {
        let start_bit = match signal.coding.byte_order {
            ByteOrder::LittleEndian => 0,
            ByteOrder::BigEndian => 7,
        };
        let mut entry = Self::new(message, vec![signal]);
        for line in &mut entry.signals {
            line.coding = signal.coding.starting_at(start_bit);
        }
        Self {
            name: Cow::Owned(name),
            length_bytes: PAYLOAD_BYTES_MAX,
            cycle_time_milliseconds: 0,
            comment: "",
            origin: Origin::Unplaced {
                message: &message.name,
                place,
                start_bit: signal.coding.start_bit,
            },
            ..entry
        }
    }
}

/// Divides the signals of a message into those that share no bits in its payload, and the others with their places.
fn placed_and_unplaced(message: &Message) -> (Vec<&Signal>, Vec<(usize, &Signal)>) {
    let mut taken_bits = 0;
    let (mut placed, mut unplaced) = (Vec::new(), Vec::new());
    for (place, signal) in message.signals.iter().enumerate() {
        let coding = &signal.coding;
        let is_inside = coding.check(usize::from(message.length_bytes)).is_ok();
        if is_inside && coding.occupied_bits() & taken_bits == 0 {
            taken_bits |= coding.occupied_bits();
            placed.push(signal);
        } else {
            unplaced.push((place, signal));
        }
    }
    (placed, unplaced)
}

/// Gives messages that no frame carries the highest identifiers whose numbers no other message has, with or without the flag for
/// 29 bits, since some readers ignore it.
fn give_identifiers(messages: &[Message], entries: &mut [Entry<'_>]) {
    let taken = messages
        .iter()
        .map(|message| message.raw_id | EXTENDED_FLAG);
    let taken = BTreeSet::from_iter(taken);
    let mut free = (0..=IDENTIFIER_MAX).rev().filter(|id| !taken.contains(id));
    let inaudible = entries
        .iter_mut()
        .filter(|entry| !matches!(entry.origin, Origin::Bus));
    for (entry, id) in inaudible.rev().zip(&mut free) {
        entry.file_id = id;
    }
}

/// Returns for each signal a name that the grammar admits and that no other signal of the message has.
fn short_names(signals: &[&Signal]) -> Vec<String> {
    let names = signals.iter().map(|signal| signal.name.as_str());
    let mut taken: BTreeSet<_> = names
        .filter(|name| is_dbc_name(name))
        .map(str::to_owned)
        .collect();
    let short_name = |signal: &&Signal| {
        if is_dbc_name(&signal.name) {
            return signal.name.clone();
        }
        let candidates = (1..).map(|number: u32| shortened(&signal.name, number));
        let mut free = candidates.filter(|name| !taken.contains(name));
        let name = free.next().unwrap_or_default();
        taken.insert(name.clone());
        name
    };
    signals.iter().map(short_name).collect()
}

/// Checks whether a signal can have this name in the file.
fn is_dbc_name(name: &str) -> bool {
    let is_part = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_';
    name.len() <= NAME_CHARACTERS_MAX
        && name.bytes().all(is_part)
        && name.starts_with(|first: char| !first.is_ascii_digit())
}

/// Returns the beginning of a name, made admissible; from the second one on with a number at its end.
fn shortened(name: &str, number: u32) -> String {
    let ending = if number > 1 {
        format!("_{number}")
    } else {
        String::new()
    };
    let admissible = name.chars().map(|character| {
        if character.is_ascii_alphanumeric() {
            character
        } else {
            '_'
        }
    });
    let before = name
        .starts_with(|first: char| first.is_ascii_digit())
        .then_some('_');
    let characters = before.into_iter().chain(admissible);
    let beginning: String = characters
        .take(NAME_CHARACTERS_MAX - ending.len())
        .collect();
    beginning + &ending
}

impl Display for File<'_> {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        formatter.write_str(HEAD)?;
        formatter.write_str("BU_:")?;
        let mut nodes = self.nodes().into_iter();
        nodes.try_for_each(|node| write!(formatter, " {node}"))?;
        formatter.write_str("\n\n")?;
        let mut messages = self.messages.iter();
        messages.try_for_each(|entry| write!(formatter, "{entry}"))?;
        self.write_comments(formatter)?;
        self.write_attributes(formatter)?;
        self.write_labels(formatter)?;
        self.write_floats(formatter)
    }
}

impl File<'_> {
    fn write_comments(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        writeln!(formatter, "CM_ {};", Quoted(COMMENT))?;
        for entry in &self.messages {
            let id = entry.file_id;
            if !entry.comment.is_empty() {
                writeln!(formatter, "CM_ BO_ {id} {};", Quoted(entry.comment))?;
            }
            for Line {
                short_name, signal, ..
            } in &entry.signals
            {
                if !signal.comment.is_empty() {
                    let comment = Quoted(&signal.comment);
                    writeln!(formatter, "CM_ SG_ {id} {short_name} {comment};")?;
                }
            }
        }
        Ok(())
    }

    fn write_attributes(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        let cycle_times = self
            .messages
            .iter()
            .map(|entry| entry.cycle_time_milliseconds);
        let cycle_time_max = cycle_times.fold(CYCLE_TIME_MAX, u64::max);
        write!(
            formatter,
            "BA_DEF_ \"BusType\" STRING ;\n\
            BA_DEF_ BO_ \"{CYCLE_TIME}\" INT 0 {cycle_time_max};\n\
            BA_DEF_ BO_ \"{MESSAGE_OF_SIGNAL}\" STRING ;\n\
            BA_DEF_ SG_ \"{PLACE_IN_MESSAGE}\" INT -1 65535;\n\
            BA_DEF_ SG_ \"{START_BIT_IN_MESSAGE}\" INT -1 255;\n\
            BA_DEF_ SG_ \"{LONG_NAME}\" STRING ;\n\
            BA_DEF_ SG_ \"{OBJECT}\" STRING ;\n\
            BA_DEF_DEF_ \"BusType\" \"CAN\";\n\
            BA_DEF_DEF_ \"{CYCLE_TIME}\" 0;\n\
            BA_DEF_DEF_ \"{MESSAGE_OF_SIGNAL}\" \"\";\n\
            BA_DEF_DEF_ \"{PLACE_IN_MESSAGE}\" -1;\n\
            BA_DEF_DEF_ \"{START_BIT_IN_MESSAGE}\" -1;\n\
            BA_DEF_DEF_ \"{LONG_NAME}\" \"\";\n\
            BA_DEF_DEF_ \"{OBJECT}\" \"\";\n\
            BA_ \"BusType\" \"CAN\";\n"
        )?;
        for entry in &self.messages {
            entry.write_attributes(formatter)?;
        }
        self.lines()
            .try_for_each(|(entry, line)| line.write_attributes(entry.file_id, formatter))
    }

    fn write_labels(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        let labelled = self
            .lines()
            .filter(|(_, line)| !line.signal.labels.is_empty());
        for (entry, line) in labelled {
            write!(formatter, "VAL_ {} {}", entry.file_id, line.short_name)?;
            for (value, label) in &line.signal.labels {
                write!(formatter, " {value} {}", Quoted(label))?;
            }
            formatter.write_str(" ;\n")?;
        }
        Ok(())
    }

    fn write_floats(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        for (entry, line) in self.lines() {
            let value_type = match line.coding.kind {
                Kind::Unsigned | Kind::Signed => continue,
                Kind::Float32 => 1,
                Kind::Float64 => 2,
            };
            let (id, name) = (entry.file_id, &line.short_name);
            writeln!(formatter, "SIG_VALTYPE_ {id} {name} : {value_type};")?;
        }
        Ok(())
    }
}

impl Entry<'_> {
    fn write_attributes(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        let id = self.file_id;
        if self.cycle_time_milliseconds != 0 {
            let milliseconds = self.cycle_time_milliseconds;
            writeln!(formatter, "BA_ \"{CYCLE_TIME}\" BO_ {id} {milliseconds};")?;
        }
        match self.origin {
            Origin::Bus => Ok(()),
            Origin::Unplaced {
                message,
                place,
                start_bit,
            } => {
                let message = Quoted(message);
                writeln!(formatter, "BA_ \"{MESSAGE_OF_SIGNAL}\" BO_ {id} {message};")?;
                self.signals.iter().try_for_each(|line| {
                    let name = &line.short_name;
                    writeln!(
                        formatter,
                        "BA_ \"{PLACE_IN_MESSAGE}\" SG_ {id} {name} {place};"
                    )?;
                    writeln!(
                        formatter,
                        "BA_ \"{START_BIT_IN_MESSAGE}\" SG_ {id} {name} {start_bit};"
                    )
                })
            }
        }
    }
}

impl Line<'_> {
    fn write_attributes(&self, file_id: u32, formatter: &mut Formatter<'_>) -> fmt::Result {
        let short_name = &self.short_name;
        let Signal { name, object, .. } = self.signal;
        if name != short_name {
            let name = Quoted(name);
            writeln!(
                formatter,
                "BA_ \"{LONG_NAME}\" SG_ {file_id} {short_name} {name};"
            )?;
        }
        if !object.is_empty() {
            let object = Quoted(object);
            writeln!(
                formatter,
                "BA_ \"{OBJECT}\" SG_ {file_id} {short_name} {object};"
            )?;
        }
        Ok(())
    }
}

/// Writes the message and its signals.
impl Display for Entry<'_> {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        let sender = self.sender.unwrap_or(NO_NODE);
        let (id, name, length) = (self.file_id, &self.name, self.length_bytes);
        writeln!(formatter, "BO_ {id} {name}: {length} {sender}")?;
        let mut lines = self.signals.iter();
        lines.try_for_each(|line| writeln!(formatter, " {line}"))?;
        formatter.write_str("\n")
    }
}

/// Writes the bits of a signal, its numbers, its unit and its receivers.
impl Display for Line<'_> {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        let Coding {
            start_bit,
            length_bits,
            byte_order,
            kind,
            factor,
            offset,
            range,
            ..
        } = self.coding;
        let byte_order = match byte_order {
            ByteOrder::LittleEndian => 1,
            ByteOrder::BigEndian => 0,
        };
        let sign = if kind == Kind::Unsigned { '+' } else { '-' };
        let [minimum, maximum] = range.map_or([0.0; 2], |range| [range.minimum, range.maximum]);
        let [factor, offset, minimum, maximum] = [factor, offset, minimum, maximum].map(Number);
        let unit = Quoted(&self.signal.unit);
        let receivers = match &self.signal.receivers[..] {
            [] => NO_NODE.to_owned(),
            receivers => receivers.join(","),
        };
        write!(
            formatter,
            "SG_ {} : {start_bit}|{length_bits}@{byte_order}{sign} ({factor},{offset}) [{minimum}|{maximum}] {unit} {receivers}",
            self.short_name
        )
    }
}

/// Text between quotation marks.
struct Quoted<'a>(&'a str);

impl Display for Quoted<'_> {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        write!(formatter, "\"{}\"", escaped(self.0))
    }
}

/// Number, written with the fewest digits that no other number has.
struct Number(f64);

impl Display for Number {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> fmt::Result {
        let digits = format!("{:?}", self.0);
        let is_negative_zero = self.0 == 0.0 && self.0.is_sign_negative();
        match digits.strip_suffix(".0") {
            // As a whole number it would lose its sign.
            Some(whole) if !is_negative_zero => formatter.write_str(whole),
            _ => formatter.write_str(&digits),
        }
    }
}

#[cfg(test)]
mod tests;
