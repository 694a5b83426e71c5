//! The characters of an EDS, which makers write in several encodings.

/// Returns the text of a file: UTF-8 in which each byte that does not fit is a character of Latin-1, or UTF-16 if it
/// begins with a byte order mark of that.
pub fn text(bytes: Vec<u8>) -> String {
    String::from_utf8(bytes).unwrap_or_else(|error| {
        let bytes = error.into_bytes();
        let read_unit: fn([u8; 2]) -> u16 = match bytes[..] {
            [0xFF, 0xFE, ..] => u16::from_le_bytes,
            [0xFE, 0xFF, ..] => u16::from_be_bytes,
            _ => return with_latin_1(&bytes),
        };
        let (units, _) = bytes.as_chunks::<2>();
        let units = units.iter().map(|unit| read_unit(*unit));
        let characters = char::decode_utf16(units);
        characters
            .map(|character| character.unwrap_or(char::REPLACEMENT_CHARACTER))
            .collect()
    })
}

fn with_latin_1(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(bytes.len());
    for chunk in bytes.utf8_chunks() {
        text.push_str(chunk.valid());
        text.extend(chunk.invalid().iter().copied().map(char::from));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_encoding_of_a_maker_gives_the_same_text() {
        let wanted = "ParameterName=Größe in µm";
        let latin_1: Vec<u8> = wanted
            .chars()
            .map(|letter| u8::try_from(letter).unwrap())
            .collect();
        let utf_16 = |unit: fn(u16) -> [u8; 2]| {
            let units = "\u{feff}".encode_utf16().chain(wanted.encode_utf16());
            Vec::from_iter(units.flat_map(unit))
        };
        assert_eq!(text(wanted.as_bytes().to_vec()), wanted);
        assert_eq!(text(latin_1.clone()), wanted);
        for bytes in [utf_16(u16::to_le_bytes), utf_16(u16::to_be_bytes)] {
            assert_eq!(text(bytes), format!("\u{feff}{wanted}"));
        }
        // Two hands, two editors.
        let mixed = [wanted.as_bytes(), b"\n", &latin_1].concat();
        assert_eq!(text(mixed), format!("{wanted}\n{wanted}"));
        assert_eq!(text(b"50 \x80 \xB0".to_vec()), "50 \u{80} °");
    }
}
