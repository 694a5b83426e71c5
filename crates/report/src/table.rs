//! Tables for the terminal, and texts with such tables.
//!
//! The colours of a table are the only escape sequences of a text: all other text is escaped where it enters a cell or a line.

use std::fmt::{self, Display};

use comfy_table::{
    Attribute, CellAlignment, Color, ColumnConstraint, ContentArrangement, Width, presets,
};
use platform::terminal::printable;

/// Columns of a terminal that reports none, as in CI, and the least number to which tables are narrowed.
const TERMINAL_COLUMNS: u16 = 80;
const TERMINAL_COLUMNS_MIN: u16 = 40;

/// Cell of a table, with its text, alignment and colour.
#[derive(Clone)]
pub struct Cell(comfy_table::Cell);

impl Cell {
    /// Makes a cell from a text, in which a sequence that would control the terminal is escaped.
    pub fn new(text: impl AsRef<str>) -> Self {
        Self(comfy_table::Cell::new_owned(
            printable(text.as_ref()).into_owned(),
        ))
    }

    /// Makes a cell with a number, which is aligned to the right.
    pub fn number(text: impl AsRef<str>) -> Self {
        Self(Self::new(text).0.set_alignment(CellAlignment::Right))
    }

    /// Returns the cell in the colour of a success.
    #[must_use]
    pub fn good(self) -> Self {
        Self(self.0.fg(Color::Green))
    }

    /// Returns the cell in the colour of a failure.
    #[must_use]
    pub fn bad(self) -> Self {
        Self(self.0.fg(Color::Red))
    }

    /// Returns the cell in the colour of an open question.
    #[must_use]
    pub fn unsure(self) -> Self {
        Self(self.0.fg(Color::Yellow))
    }

    /// Returns the cell in bold type.
    #[must_use]
    pub fn bold(self) -> Self {
        Self(self.0.add_attribute(Attribute::Bold))
    }
}

impl<T: AsRef<str>> From<T> for Cell {
    fn from(text: T) -> Self {
        Self::new(text)
    }
}

/// Table that fits the terminal, in colours unless NO_COLOR (no-color.org) or a pipe forbids them. Where its columns do not fit
/// without breaking words, each cell has a separate line.
pub struct Table {
    heads: Vec<Cell>,
    rows: Vec<Vec<Cell>>,
}

impl Table {
    /// Makes a table without rows.
    pub fn new<T: Into<Cell>>(heads: impl IntoIterator<Item = T>) -> Self {
        Self {
            heads: heads.into_iter().map(Into::into).collect(),
            rows: Vec::new(),
        }
    }

    /// Adds a row.
    pub fn add<T: Into<Cell>>(&mut self, cells: impl IntoIterator<Item = T>) {
        self.rows.push(cells.into_iter().map(Into::into).collect());
    }

    /// Returns the widest word of each column.
    fn word_widths(&self) -> Vec<u16> {
        let mut widths = vec![0; self.heads.len()];
        for row in [&self.heads].into_iter().chain(&self.rows) {
            for (widest, Cell(cell)) in widths.iter_mut().zip(row) {
                let content = cell.content();
                let words = content.split_whitespace().map(|word| word.chars().count());
                let width = u16::try_from(words.max().unwrap_or(0)).unwrap_or(u16::MAX);
                *widest = width.max(*widest);
            }
        }
        widths
    }

    /// Returns the table for a terminal of this width.
    fn fitted(&self, columns: Option<u16>) -> comfy_table::Table {
        let widths = self.word_widths();
        // Each cell has a space on both sides and a line on its right, the first one also on its left.
        let taken = widths.iter().fold(1_u16, |sum, width| {
            sum.saturating_add(*width).saturating_add(3)
        });
        let mut table = match columns {
            Some(columns) if columns < taken => self.cell_by_cell(),
            _ => self.row_by_row(&widths),
        };
        table.set_content_arrangement(ContentArrangement::Dynamic);
        if let Some(columns) = columns {
            table.set_width(columns);
        }
        if std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty()) {
            table.force_no_tty();
        }
        table
    }

    fn row_by_row(&self, widths: &[u16]) -> comfy_table::Table {
        let mut table = comfy_table::Table::new();
        table.load_style(presets::UTF8_FULL_CONDENSED);
        table.set_header(self.heads.iter().map(|Cell(cell)| cell.clone()));
        for row in &self.rows {
            table.add_row(row.iter().map(|Cell(cell)| cell.clone()));
        }
        let at_least = |width: &u16| ColumnConstraint::LowerBoundary(Width::Fixed(width + 2));
        table.set_constraints(widths.iter().map(at_least));
        table
    }

    /// Writes each cell that is not empty behind the head of its column, and a blank line behind each row.
    fn cell_by_cell(&self) -> comfy_table::Table {
        let mut table = comfy_table::Table::new();
        table.load_style(presets::NOTHING);
        for (place, row) in self.rows.iter().enumerate() {
            if place > 0 {
                table.add_row([""]);
            }
            let cells = self.heads.iter().zip(row);
            for (Cell(head), Cell(cell)) in
                cells.filter(|(_, Cell(cell))| !cell.content().is_empty())
            {
                let cell = cell.clone().set_alignment(CellAlignment::Left);
                table.add_row([head.clone(), cell]);
            }
        }
        table
    }
}

impl Display for Table {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = comfy_table::Table::new().width();
        self.fitted(width.map(usable_columns)).fmt(formatter)
    }
}

/// Returns the columns for a table on a terminal of this width.
fn usable_columns(columns: u16) -> u16 {
    match columns {
        0 => TERMINAL_COLUMNS,
        _ => columns.max(TERMINAL_COLUMNS_MIN),
    }
}

/// Text for the terminal, in whole lines. It may be printed as it is: only its tables steer the terminal, by their colours.
#[derive(Default)]
pub struct Text(String);

impl Text {
    /// Adds lines of plain text.
    pub fn line(&mut self, text: impl AsRef<str>) {
        self.0 += &printable(text.as_ref());
        self.0.push('\n');
    }

    /// Adds a table.
    pub fn table(&mut self, table: &Table) {
        self.0 += &format!("{table}\n");
    }
}

impl Display for Text {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(formatter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn compared() -> Table {
        let mut table = Table::new([
            "signal",
            "rms",
            "differs by",
            "tolerance",
            "from",
            "B later by",
            "result",
        ]);
        for result in ["DIVERGES", "same"] {
            let row = [
                "true_position_millimetres",
                "1.234",
                "12.34",
                "0.25",
                "",
                "−0.004 s",
            ]
            .into_iter()
            .map(Cell::new);
            table.add(row.chain([Cell::new(result).bad()]));
        }
        table
    }

    #[test]
    fn no_width_of_a_terminal_breaks_a_word() {
        assert_eq!([0, 20, 60, 200].map(usable_columns), [80, 40, 60, 200]);
        let table = compared();
        for columns in 40..120 {
            let text = table.fitted(Some(columns)).to_string();
            for word in [
                "true_position_millimetres",
                "tolerance",
                "DIVERGES",
                "−0.004",
                "12.34",
            ] {
                assert!(text.contains(word), "{columns}: {text}");
            }
            let widest = text
                .lines()
                .map(|line| line.trim_end().chars().count())
                .max();
            assert!(widest <= Some(columns.into()), "{columns}: {text}");
        }
    }

    #[test]
    fn a_narrow_terminal_gets_a_line_for_each_cell_that_is_not_empty() {
        let text = compared().fitted(Some(60)).to_string();
        let lines = text
            .lines()
            .map(|line| Vec::from_iter(line.split_whitespace()).join(" "));
        let row = |result: &str| {
            let rest = [
                "rms 1.234",
                "differs by 12.34",
                "tolerance 0.25",
                "B later by −0.004 s",
            ];
            let mut row = vec!["signal true_position_millimetres".to_owned()];
            row.extend(rest.map(str::to_owned));
            row.push(format!("result {result}"));
            row
        };
        let expected = [row("DIVERGES"), vec![String::new()], row("same")].concat();
        assert_eq!(Vec::from_iter(lines), expected);
    }

    #[test]
    fn only_colours_steer_the_terminal() {
        let mut table = Table::new(["name\u{1b}[2J"]);
        table.add([Cell::new("\u{1b}[31m\u{202e}x").good()]);
        let mut text = Text::default();
        text.line("\u{1b}]0;title\u{7}");
        text.0 += &table.fitted(None).enforce_styling().to_string();
        let colours = ["\u{1b}[38;5;10m", "\u{1b}[39m", "\u{1b}[0m"];
        let plain = colours
            .iter()
            .fold(text.to_string(), |text, colour| text.replace(colour, ""));
        assert!(text.to_string().contains(colours[0]));
        assert_eq!(printable(&plain), plain);
        assert!(
            plain.contains("\\u001b[2J") && plain.contains("\\u001b[31m\\u202ex"),
            "{plain}"
        );
    }
}
