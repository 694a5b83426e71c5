//! Mistakes in TOML text, drawn by a seed. They depend on the lines themselves and not on their numbers, so a new line
//! in a file leaves most of its mutants unchanged.

use sha2::{Digest, Sha256};

/// One draw; `seed` names it.
struct Dice<'a> {
    seed: String,
    /// Words of the file.
    words: Vec<&'a str>,
}

impl Dice<'_> {
    fn roll(&self, of: &str) -> u64 {
        let digest = Sha256::digest(format!("{}\n{of}", self.seed));
        u64::from_be_bytes(digest[..8].try_into().unwrap())
    }

    fn another_word(&self, than: &str) -> Option<String> {
        let others = self.words.iter().filter(|word| **word != than);
        let drawn = others.min_by_key(|word| self.roll(word));
        drawn.map(|word| (*word).to_owned())
    }
}

/// Piece of a text that contains a mistake.
#[derive(Clone, Copy, PartialEq)]
enum Piece {
    Line,
    /// A header with all lines up to the next one.
    Table,
}

/// A mistake in a piece; `None` if it is not applicable.
type Edit = fn(&str, &Dice) -> Option<String>;

const EDITS: [(Piece, Edit); 17] = [
    (Piece::Line, |line, _| line.contains('=').then(String::new)),
    (Piece::Line, |line, _| twice(line)),
    (Piece::Line, |line, _| {
        Some(line.get(..line.len() / 2)?.to_owned())
    }),
    (Piece::Line, |line, _| {
        Some(line.strip_suffix([']', '"', '}'])?.to_owned())
    }),
    (Piece::Line, |line, _| {
        Some(format!(
            "[{}]",
            line.strip_prefix("[[")?.strip_suffix("]]")?
        ))
    }),
    (Piece::Line, |line, _| {
        (is_header(line) && !line.starts_with("[[")).then(|| format!("[{line}]"))
    }),
    (Piece::Line, |line, _| {
        is_header(line).then(|| format!("{line}\nstrange = 1"))
    }),
    (Piece::Line, another_value),
    (Piece::Line, another_value),
    (Piece::Line, another_number),
    (Piece::Line, another_number),
    (Piece::Line, another_number),
    (Piece::Line, |line, dice| {
        word(line, dice, |word| {
            Some(word[..word.len() / 2].to_owned() + &word[word.len() / 2 + 1..])
        })
    }),
    (Piece::Line, another_word),
    (Piece::Line, |line, dice| {
        (is_header(line) || line.contains('"')).then(|| another_word(line, dice))?
    }),
    (Piece::Table, |table, _| is_header(table).then(String::new)),
    (Piece::Table, |table, _| {
        is_header(table).then(|| twice(table))?
    }),
];

/// Replacements of a number.
const NUMBERS: [fn(f64) -> f64; 7] = [
    |number| number * 1000.0,
    |number| number / 1000.0,
    |number| -number,
    |number| number + 1.0,
    |_| 0.0,
    |_| f64::NAN,
    |_| f64::INFINITY,
];

/// Replacements of any value.
const VALUES: [&str; 6] = ["[]", "{}", "\"\"", "true", "\"seven\"", "7"];

/// Replacements of the beginning of a unit.
const UNITS: [(&str, &str); 3] = [
    ("millimetre", "degree"),
    ("metre", "degree"),
    ("degree", "millimetre"),
];

fn is_header(piece: &str) -> bool {
    piece.starts_with('[')
}

fn twice(piece: &str) -> Option<String> {
    Some(format!("{piece}\n{piece}"))
}

fn another_value(line: &str, dice: &Dice) -> Option<String> {
    let (key, old) = line.split_once(" = ")?;
    let others = VALUES.iter().filter(|value| **value != old);
    let value = others.min_by_key(|value| dice.roll(value))?;
    Some(format!("{key} = {value}"))
}

/// Replaces a word by another word of the file, or by another unit.
fn another_word(line: &str, dice: &Dice) -> Option<String> {
    word(line, dice, |word| {
        let unit = UNITS.iter().find(|(unit, _)| word.contains(unit));
        match unit {
            Some((unit, other)) => Some(word.replace(unit, other)),
            None => dice.another_word(word),
        }
    })
}

fn is_in_number(character: char) -> bool {
    character.is_ascii_alphanumeric() || "_.+-".contains(character)
}

fn is_in_word(character: char) -> bool {
    character.is_ascii_alphanumeric() || character == '_'
}

/// Changes one token of a piece.
fn token(
    piece: &str,
    dice: &Dice,
    is_in: fn(char) -> bool,
    change: impl Fn(&str) -> Option<String>,
) -> Option<String> {
    let mut begin = 0;
    let mut changed = Vec::new();
    for part in piece.split_inclusive(|character| !is_in(character)) {
        let token = part.trim_end_matches(|character| !is_in(character));
        if let Some(new) = change(token) {
            changed.push((begin, begin + token.len(), new));
        }
        begin += part.len();
    }
    let (begin, end, new) = changed
        .iter()
        .min_by_key(|(begin, end, _)| dice.roll(&piece[*begin..*end]))?;
    Some([&piece[..*begin], new, &piece[*end..]].concat())
}

/// Changes a number, or a node-ID.
fn another_number(line: &str, dice: &Dice) -> Option<String> {
    let drawn = NUMBERS.iter().enumerate();
    let (_, change) = drawn.min_by_key(|(place, _)| dice.roll(&place.to_string()))?;
    token(line, dice, is_in_number, |text| {
        if let Some(digits) = text.strip_prefix("0x") {
            let number = u32::from_str_radix(digits, 16).ok()?;
            return Some(format!("0x{:X}", number * 3));
        }
        if !text.starts_with(|first: char| first.is_ascii_digit() || first == '-') {
            return None;
        }
        let number = change(text.replace('_', "").parse().ok()?);
        let changed = if text.contains('.') || !number.is_finite() {
            format!("{number:?}").to_lowercase()
        } else {
            format!("{number}")
        };
        (changed != text).then_some(changed)
    })
}

fn is_word(text: &str) -> bool {
    text.len() > 1 && text.starts_with(|first: char| first.is_ascii_lowercase())
}

/// Changes one word of a piece: of a key, a header, or a name in quotes.
fn word(piece: &str, dice: &Dice, change: impl Fn(&str) -> Option<String>) -> Option<String> {
    token(piece, dice, is_in_word, |text| {
        is_word(text).then(|| change(text))?
    })
}

/// Returns the pieces of a text; together they are the text.
fn pieces(text: &str, piece: Piece) -> Vec<&str> {
    if piece == Piece::Line {
        return text.split_inclusive('\n').collect();
    }
    let headers = text.match_indices("\n[").map(|(place, _)| place + 1);
    let mut begins = vec![0];
    begins.extend(headers);
    let ends = begins.iter().skip(1).copied().chain([text.len()]);
    begins
        .iter()
        .zip(ends)
        .map(|(begin, end)| &text[*begin..end])
        .collect()
}

fn is_code(line: &&str) -> bool {
    !line.starts_with('#') && !line.trim().is_empty()
}

/// Returns a text with a mistake, and the description of the mistake.
pub(crate) fn mutant(text: &str, seed: &str) -> (String, String) {
    let lines = text.lines().filter(is_code);
    let words = lines.flat_map(|line| line.split(|character| !is_in_word(character)));
    let mut dice = Dice {
        seed: seed.to_owned(),
        words: words.filter(|word| is_word(word)).collect(),
    };
    for attempt in 0..100 {
        dice.seed = format!("{seed} {attempt}");
        let drawn = EDITS
            .iter()
            .enumerate()
            .min_by_key(|(place, _)| dice.roll(&place.to_string()));
        let (_, (kind, edit)) = drawn.unwrap();
        let pieces = pieces(text, *kind);
        let edited = pieces.iter().enumerate().filter_map(|(place, piece)| {
            let edited = is_code(piece).then(|| edit(piece.trim_end(), &dice))??;
            Some((place, edited))
        });
        let Some((place, edited)) = edited.min_by_key(|(place, _)| dice.roll(pieces[*place]))
        else {
            continue;
        };
        let first = |piece: &str| piece.lines().next().unwrap_or_default().to_owned();
        let many = if edited.contains('\n') { " …" } else { "" };
        let told = format!("{} -> {}{many}", first(pieces[place]), first(&edited));
        let [before, after] = [&pieces[..place], &pieces[place + 1..]].map(<[&str]>::concat);
        return ([&before, &edited, "\n", &after].concat(), told);
    }
    panic!("no mistake can be made in {seed}")
}
