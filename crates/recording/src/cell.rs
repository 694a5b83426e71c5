//! Texts in tables for other programs. Names in a folder's DBC are foreign.

use std::borrow::Cow;

/// Returns a text that no spreadsheet takes for a formula: with an apostrophe before it if it could be one.
pub fn inert(text: &str) -> Cow<'_, str> {
    if text.starts_with(['=', '+', '-', '@', '\t', '\r', '\n']) {
        format!("'{text}").into()
    } else {
        text.into()
    }
}

/// Returns the text as a cell of a CSV table, in quotes if a character would be taken for the table's own.
pub fn cell(text: &str) -> Cow<'_, str> {
    let text = inert(text);
    if text.contains([',', '"', '\r', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\"")).into()
    } else {
        text
    }
}

/// Returns the names of a table's columns as its first line.
pub fn heading<'a>(names: impl IntoIterator<Item = &'a str>) -> String {
    let cells = names.into_iter().map(cell);
    Vec::from_iter(cells).join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_somebody_else_stay_one_cell_each_and_are_no_formulas() {
        let names = ["position_millimetres", "a,b", "a \"b\"", "=1+1", "-a\nb"];
        let expected = "position_millimetres,\"a,b\",\"a \"\"b\"\"\",'=1+1,\"'-a\nb\"";
        assert_eq!(heading(names), expected);
    }
}
