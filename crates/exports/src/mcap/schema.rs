//! Fields of messages in the notation of ROS 2 (`.msg`).

use std::fmt::Write;

use dbc::{Message, Signal};

/// Levels of a `Log`.
pub(super) const INFO: u8 = 20;
pub(super) const WARN: u8 = 30;
pub(super) const ERROR: u8 = 40;

/// Frame as the driver of ROS 2 for SocketCAN publishes it.
pub(super) const FRAME: &str = "\
std_msgs/Header header
uint32 id
bool is_rtr
bool is_extended
bool is_error
uint8 dlc
uint8[8] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";

/// Log message of a node.
pub(super) const LOG: &str = "\
byte DEBUG=10
byte INFO=20
byte WARN=30
byte ERROR=40
byte FATAL=50
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";

/// Returns the name of a kind: `drive_tpdo1` is `canrig_msgs/msg/DriveTpdo1`.
pub(super) fn kind(message: &str) -> String {
    let words = message.split('_').map(|word| {
        let (first, rest) = word.split_at(word.len().min(1));
        first.to_ascii_uppercase() + rest
    });
    format!("canrig_msgs/msg/{}", words.collect::<String>())
}

/// Returns one field for each signal, with its unit in brackets, its meaning and the labels of its values as a comment.
pub(super) fn definition(message: &Message) -> String {
    let mut text = String::new();
    if !message.comment.is_empty() {
        let _ = writeln!(text, "# {}", one_line(&message.comment));
    }
    let mut names: Vec<String> = Vec::new();
    for signal in &message.signals {
        let mut name = field(&signal.name);
        while names.contains(&name) {
            name += "2";
        }
        let comment = comment(signal);
        let mark = if comment.is_empty() { "" } else { "  # " };
        let _ = writeln!(text, "float64 {name}{mark}{comment}");
        names.push(name);
    }
    text
}

fn comment(signal: &Signal) -> String {
    let mut parts = Vec::new();
    if !signal.unit.is_empty() {
        parts.push(format!("[{}]", signal.unit));
    }
    if !signal.comment.is_empty() {
        parts.push(one_line(&signal.comment));
    }
    let labels = signal.labels.iter();
    let labelled = labels.map(|(value, label)| format!("{value} = {}", one_line(label)));
    let labels = Vec::from_iter(labelled);
    if !labels.is_empty() {
        parts.push(format!("({})", labels.join(", ")));
    }
    parts.join(" ")
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Returns a name that ROS 2 accepts: small letters, digits and single underscores, none of them at an end.
fn field(name: &str) -> String {
    let name = name.to_ascii_lowercase();
    let words = name.split('_').filter(|word| !word.is_empty());
    let name = words.collect::<Vec<_>>().join("_");
    match name.chars().next() {
        Some('a'..='z') => name,
        _ => format!("signal_{name}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbc::Database;

    #[test]
    fn a_field_has_its_unit_and_the_labels_of_its_values() {
        let message = Database::shipped().message("drive_tpdo1").unwrap();
        let text = definition(message);
        let line = |name: &str| {
            let start = format!("float64 {name} ");
            text.lines().find(|line| line.starts_with(&start)).unwrap()
        };
        assert!(line("position_millimetres").contains("# [mm] "), "{text}");
        let state = line("statusword_state");
        assert!(state.contains("operation enabled"), "{state}");
        assert_eq!(kind(&message.name), "canrig_msgs/msg/DriveTpdo1");
    }

    #[test]
    fn names_are_those_that_ros_permits() {
        assert_eq!(field("Position__mm_"), "position_mm");
        assert_eq!(field("_2nd"), "signal_2nd");
    }
}
