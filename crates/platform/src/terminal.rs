//! Foreign text for a terminal.

use std::borrow::Cow;

/// Returns the text with each control character and each invisible character written as `\u001b`, as in JSON. New lines and tabs
/// stay.
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.contains(steers) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for character in text.chars() {
        if steers(character) {
            (character.encode_utf16(&mut [0; 2]).iter())
                .for_each(|unit| shown += &format!("\\u{unit:04x}"))
        } else {
            shown.push(character)
        }
    }
    Cow::Owned(shown)
}

/// Returns whether a character steers a terminal or is invisible: controls with the escape among them, marks that change the
/// direction of text, line ends of other systems, invisible characters (Unicode's `Default_Ignorable_Code_Point`, and the marks
/// of annotations), and noncharacters, which XML does not admit either.
fn steers(character: char) -> bool {
    match character {
        '\n' | '\t' | ' '..='~' => false,
        '\u{2028}'..='\u{202e}' | '\u{fff9}'..='\u{fffb}' | '\u{fffe}' | '\u{ffff}' => true,
        '\u{ad}'
        | '\u{34f}'
        | '\u{61c}'
        | '\u{115f}'..='\u{1160}'
        | '\u{17b4}'..='\u{17b5}'
        | '\u{180b}'..='\u{180f}'
        | '\u{200b}'..='\u{200f}'
        | '\u{2060}'..='\u{206f}'
        | '\u{3164}'
        | '\u{fe00}'..='\u{fe0f}'
        | '\u{feff}'
        | '\u{ffa0}'
        | '\u{fff0}'..='\u{fff8}'
        | '\u{1bca0}'..='\u{1bca3}'
        | '\u{1d173}'..='\u{1d17a}'
        | '\u{e0000}'..='\u{e0fff}' => true,
        other => other.is_control(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_steers_a_terminal_is_written_out_and_the_rest_stays() {
        let plain = "a path/with ünïcode, 25 °C → ≤ 3 │\tand\nlines";
        assert!(matches!(printable(plain), Cow::Borrowed(text) if text == plain));
        let cases = [
            ("\u{1b}[2J", "\\u001b[2J"),
            ("a\rb\u{7}", "a\\u000db\\u0007"),
            ("\u{9b}31m", "\\u009b31m"),
            ("\u{7f}", "\\u007f"),
            ("a\u{202e}b\u{2066}c", "a\\u202eb\\u2066c"),
            ("pa\u{200b}ss\u{feff}", "pa\\u200bss\\ufeff"),
            ("\u{e0041}", "\\udb40\\udc41"),
        ];
        for (text, expected) in cases {
            assert_eq!(printable(text), expected);
        }
    }

    #[test]
    fn nothing_that_steers_is_left_of_any_character() {
        for character in '\0'..=char::MAX {
            let text = String::from(character);
            let shown = printable(&text);
            assert!(!shown.contains(steers), "{character:?}");
            assert_eq!(printable(&shown), shown, "{character:?}");
        }
    }
}
