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

/// A number with just so many digits, an even number of them; what does not fit is cut off in front.
pub(crate) fn fixed<const WIDTH: usize>(mut number: u64) -> [u8; WIDTH] {
    const { assert!(WIDTH.is_multiple_of(2)) }
    let mut digits = [b'0'; WIDTH];
    for pair in digits.rchunks_exact_mut(2) {
        pair.copy_from_slice(&last_two(number));
        number /= 100;
    }
    digits
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
        fn a_fixed_width_is_kept(number in 0u64..1_000_000) {
            prop_assert_eq!(fixed::<6>(number).to_vec(), format!("{number:06}").into_bytes());
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
