//! Conventions of the reader and the writer of DBC files beyond the grammar.

/// Attribute with the full name of a signal whose DBC name had to stay within 32 characters.
pub(crate) const LONG_NAME: &str = "SystemSignalLongSymbol";
/// Attribute with the object behind a signal, such as `0x6064:00`.
pub(crate) const OBJECT: &str = "CanopenObject";
/// Attribute with the cycle time of a message.
pub(crate) const CYCLE_TIME: &str = "GenMsgCycleTime";

/// A quotation mark within a text, in the form of other readers of DBC files.
const QUOTE: &str = "\\\"";
/// A backslash within a text. It is not `\\`, since readers would take the second one and the end of the text for a [`QUOTE`].
const BACKSLASH: &str = "\\x5C";

/// Returns a text in the form between quotation marks.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('\\', BACKSLASH).replace('"', QUOTE)
}

/// Returns the text of the form between quotation marks; a backslash that begins no escape is itself.
pub(crate) fn unescaped(text: &str) -> String {
    text.replace(QUOTE, "\"").replace(BACKSLASH, "\\")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_survive() {
        for text in ["", "\"", "\\", "\\\"", "\\x5C", "\\\\", "a\nb", "µ"] {
            assert_eq!(unescaped(&escaped(text)), text);
            assert!(!escaped(text).ends_with('\\'));
        }
        assert_eq!(unescaped(r"C:\temp"), r"C:\temp");
    }
}
