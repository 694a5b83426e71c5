//! Writer of DBC files.

use std::collections::BTreeSet;

use crate::coding::{ByteOrder, Coding, Kind};
use crate::database::{Database, Message, Signal};
use crate::notation::{CYCLE_TIME, LONG_NAME, OBJECT, escaped};

/// Everything before the nodes; other tools want the whole list of symbols.
const HEAD: &str = "VERSION \"\"\n\n\nNS_ :\n\tNS_DESC_\n\tCM_\n\tBA_DEF_\n\tBA_\n\tVAL_\n\tCAT_DEF_\n\tCAT_\n\tFILTER\n\
    \tBA_DEF_DEF_\n\tEV_DATA_\n\tENVVAR_DATA_\n\tSGTYPE_\n\tSGTYPE_VAL_\n\tBA_DEF_SGTYPE_\n\tBA_SGTYPE_\n\
    \tSIG_TYPE_REF_\n\tVAL_TABLE_\n\tSIG_GROUP_\n\tSIG_VALTYPE_\n\tSIGTYPE_VALTYPE_\n\tBO_TX_BU_\n\tBA_DEF_REL_\n\
    \tBA_REL_\n\tBA_SGTYPE_REL_\n\tSG_MUL_VAL_\n\nBS_:\n\n";
/// Remark for readers of the file.
const COMMENT: &str = "Written by canrig.";
/// Name in the place of a missing node.
const NO_NODE: &str = "Vector__XXX";
/// Longest name of a signal.
const NAME_CHARACTERS_MAX: usize = 32;
/// Largest cycle time that the file declares, unless there is a larger one.
const CYCLE_TIME_MAX: u64 = 65_535;

impl Database {
    /// Writes the database as a DBC file, in UTF-8: [`Database::parse`] reads an equal one from it. Messages are in the order of
    /// their identifiers.
    ///
    /// Attributes hold the facts that the grammar cannot express. A name that is no DBC name of at most 32 characters gets a
    /// short one in addition. In texts `"` is written as `\"`, which other readers understand, and `\` as `\x5C`, which they do
    /// not.
    ///
    /// [`Database::parse`] reads otherwise, or refuses: a signal that does not fit its message's payload or shares bits with
    /// another, one without a name, two of the same name in a message, a range from 0 to 0 (which is none), a number that is not finite, a factor of 0, an identifier
    /// above 0x7FF without the flag for 29 bits, a payload beyond 8 bytes, a text beyond [`Database::TEXT_BYTES_MAX`].
    pub fn to_dbc(&self) -> String {
        let messages = Vec::from_iter(self.messages().iter().map(Lines::of));
        let mut text = format!("{HEAD}BU_:");
        for node in nodes(self.messages()) {
            text += &format!(" {node}");
        }
        text += "\n\n";
        for Lines { message, lines } in &messages {
            let sender = message.sender.as_deref().unwrap_or(NO_NODE);
            let (id, name, length) = (message.raw_id, &message.name, message.length_bytes);
            text += &format!("BO_ {id} {name}: {length} {sender}\n");
            lines.iter().for_each(|line| text += &line.definition());
            text.push('\n');
        }
        text += &format!("CM_ {};\n", quoted(COMMENT));
        for message in &messages {
            text += &message.comments();
        }
        text += &declarations(self.messages());
        for message in self.messages() {
            let (id, milliseconds) = (message.raw_id, message.cycle_time_milliseconds);
            if milliseconds != 0 {
                text += &format!("BA_ \"{CYCLE_TIME}\" BO_ {id} {milliseconds};\n");
            }
        }
        let lines = || messages.iter().flat_map(|message| &message.lines);
        lines().for_each(|line| text += &line.attributes());
        lines().for_each(|line| text += &line.labels());
        lines().for_each(|line| text += line.value_type().as_deref().unwrap_or_default());
        text
    }
}

/// Returns senders and receivers in the order in which they appear.
fn nodes(messages: &[Message]) -> Vec<&String> {
    let mut nodes = Vec::new();
    for message in messages {
        let receivers = message.signals.iter().flat_map(|signal| &signal.receivers);
        for node in message.sender.iter().chain(receivers) {
            if !nodes.contains(&node) {
                nodes.push(node);
            }
        }
    }
    nodes
}

/// Returns the declarations of the attributes.
fn declarations(messages: &[Message]) -> String {
    let cycle_times = messages.iter().map(|one| one.cycle_time_milliseconds);
    let cycle_time_max = cycle_times.fold(CYCLE_TIME_MAX, u64::max);
    format!(
        "BA_DEF_ \"BusType\" STRING ;\n\
         BA_DEF_ BO_ \"{CYCLE_TIME}\" INT 0 {cycle_time_max};\n\
         BA_DEF_ SG_ \"{LONG_NAME}\" STRING ;\n\
         BA_DEF_ SG_ \"{OBJECT}\" STRING ;\n\
         BA_DEF_DEF_ \"BusType\" \"CAN\";\n\
         BA_DEF_DEF_ \"{CYCLE_TIME}\" 0;\n\
         BA_DEF_DEF_ \"{LONG_NAME}\" \"\";\n\
         BA_DEF_DEF_ \"{OBJECT}\" \"\";\n\
         BA_ \"BusType\" \"CAN\";\n"
    )
}

/// Returns for each signal a name that the grammar admits and that no other signal of the message has.
fn short_names(signals: &[Signal]) -> Vec<String> {
    let names = signals.iter().map(|signal| signal.name.as_str());
    let mut taken: BTreeSet<_> = names
        .filter(|name| is_dbc_name(name))
        .map(str::to_owned)
        .collect();
    let short_name = |signal: &Signal| {
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

/// A message of the file, with its signals.
struct Lines<'a> {
    message: &'a Message,
    lines: Vec<Line<'a>>,
}

/// A signal of the file.
struct Line<'a> {
    raw_id: u32,
    short_name: String,
    signal: &'a Signal,
}

impl<'a> Lines<'a> {
    fn of(message: &'a Message) -> Self {
        let names = short_names(&message.signals).into_iter();
        let lines = names
            .zip(&message.signals)
            .map(|(short_name, signal)| Line {
                raw_id: message.raw_id,
                short_name,
                signal,
            });
        Self {
            message,
            lines: lines.collect(),
        }
    }

    fn comments(&self) -> String {
        let (id, comment) = (self.message.raw_id, &self.message.comment);
        let mut text = String::new();
        if !comment.is_empty() {
            text += &format!("CM_ BO_ {id} {};\n", quoted(comment));
        }
        for line in &self.lines {
            let (name, comment) = (&line.short_name, &line.signal.comment);
            if !comment.is_empty() {
                text += &format!("CM_ SG_ {id} {name} {};\n", quoted(comment));
            }
        }
        text
    }
}

impl Line<'_> {
    /// Returns the bits of the signal, its numbers, its unit and its receivers.
    fn definition(&self) -> String {
        let Coding {
            start_bit,
            length_bits,
            byte_order,
            kind,
            factor,
            offset,
            range,
            ..
        } = self.signal.coding;
        let byte_order = match byte_order {
            ByteOrder::LittleEndian => 1,
            ByteOrder::BigEndian => 0,
        };
        let sign = if kind == Kind::Unsigned { '+' } else { '-' };
        let [minimum, maximum] = range.map_or([0.0; 2], |range| [range.minimum, range.maximum]);
        let [factor, offset, minimum, maximum] = [factor, offset, minimum, maximum].map(number);
        let unit = quoted(&self.signal.unit);
        let receivers = match &self.signal.receivers[..] {
            [] => NO_NODE.to_owned(),
            receivers => receivers.join(","),
        };
        format!(
            " SG_ {} : {start_bit}|{length_bits}@{byte_order}{sign} ({factor},{offset}) [{minimum}|{maximum}] {unit} {receivers}\n",
            self.short_name
        )
    }

    fn attributes(&self) -> String {
        let (id, name) = (self.raw_id, &self.short_name);
        let long_name = Some(&self.signal.name).filter(|long_name| *long_name != name);
        let object = Some(&self.signal.object).filter(|object| !object.is_empty());
        let attributes = [(LONG_NAME, long_name), (OBJECT, object)].into_iter();
        let set = attributes.filter_map(|(attribute, text)| Some((attribute, quoted(text?))));
        set.map(|(attribute, text)| format!("BA_ \"{attribute}\" SG_ {id} {name} {text};\n"))
            .collect()
    }

    fn labels(&self) -> String {
        if self.signal.labels.is_empty() {
            return String::new();
        }
        let written = |(value, label): &(i64, String)| format!(" {value} {}", quoted(label));
        let labels = String::from_iter(self.signal.labels.iter().map(written));
        format!("VAL_ {} {}{labels} ;\n", self.raw_id, self.short_name)
    }

    /// Returns the kind of a floating-point number.
    fn value_type(&self) -> Option<String> {
        let value_type = match self.signal.coding.kind {
            Kind::Unsigned | Kind::Signed => return None,
            Kind::Float32 => 1,
            Kind::Float64 => 2,
        };
        let (id, name) = (self.raw_id, &self.short_name);
        Some(format!("SIG_VALTYPE_ {id} {name} : {value_type};\n"))
    }
}

/// Returns a text between quotation marks.
fn quoted(text: &str) -> String {
    format!("\"{}\"", escaped(text))
}

/// Writes a number with the fewest digits that no other number has.
fn number(value: f64) -> String {
    let digits = format!("{value:?}");
    let is_negative_zero = value == 0.0 && value.is_sign_negative();
    match digits.strip_suffix(".0") {
        // As a whole number it would lose its sign.
        Some(whole) if !is_negative_zero => whole.to_owned(),
        _ => digits,
    }
}

#[cfg(test)]
mod tests;
