//! Numbers as text without the machinery of `format!`: recordings have hundreds of thousands of them.

/// Two hexadecimal digits of every byte.
pub(crate) const HEXADECIMAL: [[u8; 2]; 256] = pairs(16, b"0123456789ABCDEF");

/// Two decimal digits of every number below 100.
const DECIMAL: [[u8; 2]; 100] = pairs(10, b"0123456789");

/// The two digits of each number in a number system with so many digits.
const fn pairs<const NUMBERS: usize>(base: usize, digits: &[u8]) -> [[u8; 2]; NUMBERS] {
    let mut pairs = [[0; 2]; NUMBERS];
    let mut number = 0;
    while number < NUMBERS {
        pairs[number] = [digits[number / base], digits[number % base]];
        number += 1;
    }
    pairs
}

/// Appends a number.
pub(crate) fn push(text: &mut Vec<u8>, number: u64) {
    let mut digits = [0; 20];
    let first = put(&mut digits, number);
    text.extend_from_slice(&digits[first..]);
}

/// Writes a number at the end of a text that has room for it, and tells where it begins.
pub(crate) fn put(text: &mut [u8], mut number: u64) -> usize {
    let mut first = text.len();
    while number > 9 {
        first -= 2;
        text[first..first + 2].copy_from_slice(&last_two(number));
        number /= 100;
    }
    if number > 0 || first == text.len() {
        first -= 1;
        text[first] = last_two(number)[1];
    }
    first
}

/// The eight digits of a number with no more, worked out side by side.
pub(crate) fn eight(number: u32) -> [u8; 8] {
    /// The quotients of what stands in each of the equal parts of a word, by way of a product that is shifted.
    const fn quotients(parts: u64, factor: u64, shift: u32, mask: u64) -> u64 {
        parts.wrapping_mul(factor) >> shift & mask
    }
    // The first digit goes into the lowest byte, so what comes first in the number is lower in the word.
    let word = u64::from(number % 10_000) << 32 | u64::from(number / 10_000);
    let hundreds = quotients(word, 10_486, 20, 0x0000_007F_0000_007F);
    let word = word.wrapping_sub(100 * hundreds) << 16 | hundreds;
    let tens = quotients(word, 103, 10, 0x000F_000F_000F_000F);
    let word = word.wrapping_sub(10 * tens) << 8 | tens;
    (word | u64::from_le_bytes([b'0'; 8])).to_le_bytes()
}

fn last_two(number: u64) -> [u8; 2] {
    DECIMAL[(number % 100) as usize]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pushed(number: u64) -> String {
        let mut text = Vec::new();
        push(&mut text, number);
        String::from_utf8(text).unwrap()
    }

    proptest! {
        #[test]
        fn a_number_reads_as_the_standard_library_writes_it(digits in 0u32..20, seed: u64) {
            let number = seed % 10u64.pow(digits);
            prop_assert_eq!(pushed(number), number.to_string());
        }

        #[test]
        fn eight_digits_are_kept(number in 0u32..100_000_000) {
            prop_assert_eq!(eight(number).to_vec(), format!("{number:08}").into_bytes());
        }

        #[test]
        fn bytes_have_two_digits(byte: u8) {
            let expected = format!("{byte:02X}");
            prop_assert_eq!(&HEXADECIMAL[usize::from(byte)], expected.as_bytes());
        }
    }

    #[test]
    fn the_largest_number_fits() {
        assert_eq!(pushed(u64::MAX), u64::MAX.to_string());
    }
}
