//! A classical CAN frame and the filters that select frames.

use std::fmt;

/// Number of identifiers of 11 bits.
pub const STANDARD_IDS: usize = 1 << 11;

/// A classical CAN frame, as the kernel's `struct can_frame` carries it.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct CanFrame {
    id: u32,
    length: u8,
    data: [u8; 8],
}

/// Flag for a 29-bit identifier (`CAN_EFF_FLAG`).
pub const EXTENDED_FLAG: u32 = 0x8000_0000;
/// Flag for a remote frame (`CAN_RTR_FLAG`).
pub const REMOTE_FLAG: u32 = 0x4000_0000;
/// Flag for an error message (`CAN_ERR_FLAG`).
pub const ERROR_FLAG: u32 = 0x2000_0000;

impl CanFrame {
    /// Makes a data frame with an 11-bit identifier.
    ///
    /// # Panics
    /// `id` exceeds 0x7FF, or `data` is longer than 8 bytes: both are the caller's constants.
    #[expect(clippy::cast_possible_truncation, reason = "at most 8")]
    pub fn new(id: u16, data: &[u8]) -> Self {
        assert!(id <= 0x7FF, "identifier {id:#x} exceeds 11 bits");
        assert!(data.len() <= 8, "{} data bytes exceed 8", data.len());
        let mut bytes = [0; 8];
        bytes[..data.len()].copy_from_slice(data);
        Self {
            id: u32::from(id),
            length: data.len() as u8,
            data: bytes,
        }
    }

    /// Makes a frame from the fields of the kernel's `struct can_frame`; `None` if `length` exceeds 8. An error message has no
    /// other flag, and a remote frame no payload: further bits of a socket are dropped, so that a recording holds all of a frame.
    pub fn from_raw(id: u32, length: u8, data: [u8; 8]) -> Option<Self> {
        let (id, data) = match id & (ERROR_FLAG | REMOTE_FLAG) {
            0 => (id, data),
            REMOTE_FLAG => (id, [0; 8]),
            ERROR_FLAG => (id & !EXTENDED_FLAG, data),
            // No driver asks for an error: somebody sent it, and it says nothing about any CAN
            // controller.
            _ => (ERROR_FLAG, [0; 8]),
        };
        (length <= 8).then_some(Self { id, length, data })
    }

    /// Returns the identifier with the kernel's flags.
    #[inline]
    pub fn raw_id(&self) -> u32 {
        self.id
    }

    /// Returns the 11-bit identifier of a data frame; `None` for extended, remote and error frames.
    #[inline]
    pub fn standard_id(&self) -> Option<u16> {
        u16::try_from(self.id).ok().filter(|id| *id <= 0x7FF)
    }

    /// Checks whether it is a remote frame.
    #[inline]
    pub fn is_remote(&self) -> bool {
        self.id & REMOTE_FLAG != 0
    }

    /// Checks whether it has a 29-bit identifier.
    #[inline]
    pub fn is_extended(&self) -> bool {
        self.id & EXTENDED_FLAG != 0
    }

    /// Checks whether it is the kernel's error message.
    #[inline]
    pub fn is_error(&self) -> bool {
        self.id & ERROR_FLAG != 0
    }

    /// Returns the payload (0 to 8 bytes); for a remote frame, zeros in the number that it asks for.
    #[inline]
    pub fn data(&self) -> &[u8] {
        &self.data[..usize::from(self.length)]
    }

    /// Returns the length of the payload.
    pub fn length(&self) -> u8 {
        self.length
    }

    /// Appends the notation of candump's log: `190#1234ABCD`; `#R8` for a remote frame of that length, `#R` for one of length 0.
    /// A log has thousands of frames a second, for which a formatter takes five times as long.
    pub fn push_to(&self, text: &mut String) {
        let (id, digits) = match () {
            () if self.is_error() => (self.id, 8),
            () if self.is_extended() => (self.id & 0x1FFF_FFFF, 8),
            () => (self.id & 0x7FF, 3),
        };
        push_hexadecimal(text, id, digits);
        text.push('#');
        if self.is_remote() {
            text.push('R');
            if self.length > 0 {
                push_hexadecimal(text, self.length.into(), 1);
            }
            return;
        }
        for byte in self.data() {
            push_hexadecimal(text, (*byte).into(), 2);
        }
    }

    /// Returns all 8 bytes of the payload's buffer; those beyond the length are as they came.
    #[inline]
    pub fn buffer(&self) -> [u8; 8] {
        self.data
    }
}

impl fmt::Debug for CanFrame {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, formatter)
    }
}

/// Writes the notation of [`CanFrame::push_to`].
impl fmt::Display for CanFrame {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text = String::new();
        self.push_to(&mut text);
        formatter.write_str(&text)
    }
}

/// Appends a number of hexadecimal digits.
fn push_hexadecimal(text: &mut String, number: u32, digits: u32) {
    for place in (0..digits).rev() {
        let digit = number >> (4 * place) & 0xF;
        text.push(char::from(b"0123456789ABCDEF"[digit as usize]));
    }
}

/// Accepts a frame as the kernel's `struct can_filter` does.
///
/// A data or remote frame passes when its identifier equals `id` in the bits of `mask`. With [`ERROR_FLAG`] in `mask`
/// the filter is for error messages only, and those pass when they share a bit with the rest of `mask`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Filter {
    /// Identifier with flags.
    pub id: u32,
    /// Bits of the identifier that are compared.
    pub mask: u32,
}

impl Filter {
    /// Accepts every data and remote frame.
    pub const ALL: Self = Self { id: 0, mask: 0 };

    /// Accepts every error message.
    pub const ERRORS: Self = Self {
        id: 0,
        mask: ERROR_FLAG | 0x1FFF_FFFF,
    };

    /// Accepts every remote frame.
    pub const REMOTE: Self = Self {
        id: REMOTE_FLAG,
        mask: REMOTE_FLAG,
    };

    /// Accepts every frame with a 29-bit identifier.
    pub const EXTENDED: Self = Self {
        id: EXTENDED_FLAG,
        mask: EXTENDED_FLAG,
    };

    /// Accepts frames whose 11-bit identifier equals `id` in the bits of `mask`.
    pub fn block(id: u16, mask: u16) -> Self {
        Self {
            id: u32::from(id),
            mask: EXTENDED_FLAG | u32::from(mask),
        }
    }

    /// Accepts data frames with this 11-bit identifier only.
    pub fn exact(id: u16) -> Self {
        Self {
            id: u32::from(id),
            mask: EXTENDED_FLAG | REMOTE_FLAG | 0x7FF,
        }
    }

    /// Checks whether the frame passes.
    #[inline]
    pub fn accepts(&self, frame: &CanFrame) -> bool {
        if frame.is_error() {
            return self.mask & ERROR_FLAG != 0 && frame.raw_id() & self.mask & !ERROR_FLAG != 0;
        }
        self.mask & ERROR_FLAG == 0 && frame.raw_id() & self.mask == self.id & self.mask
    }
}

/// A set of filters with a table of the 11-bit identifiers whose data frames pass one of them, for checks of every frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilterSet {
    filters: Vec<Filter>,
    /// Table with one bit for each identifier.
    standard: Box<[u64; Self::WORDS]>,
}

impl FilterSet {
    const WORDS: usize = 0x800 / 64;

    /// Makes a set that accepts the frames of each of these sets.
    pub fn union<'a>(sets: impl IntoIterator<Item = &'a Self>) -> Self {
        let mut all = Self::from(Vec::new());
        for set in sets {
            let filters = set.filters.iter();
            let fresh = filters.filter(|filter| !all.filters.contains(filter));
            let fresh = Vec::from_iter(fresh.copied());
            all.filters.extend(fresh);
            for (word, other) in all.standard.iter_mut().zip(*set.standard) {
                *word |= other;
            }
        }
        all
    }

    /// Returns the filters.
    pub fn filters(&self) -> &[Filter] {
        &self.filters
    }

    /// Checks whether the frame passes one of the filters.
    #[inline]
    pub fn accepts(&self, frame: &CanFrame) -> bool {
        match frame.standard_id() {
            Some(id) => self.standard[usize::from(id / 64)] >> (id % 64) & 1 == 1,
            None => self.filters.iter().any(|filter| filter.accepts(frame)),
        }
    }
}

impl From<Vec<Filter>> for FilterSet {
    fn from(filters: Vec<Filter>) -> Self {
        let mut standard = Box::new([0; Self::WORDS]);
        for filter in &filters {
            let (fixed, free) = (filter.id & filter.mask, !filter.mask & 0x7FF);
            // A data frame with 11 bits has no flag.
            if filter.mask & ERROR_FLAG != 0 || fixed > 0x7FF {
                continue;
            }
            let mut part = free;
            loop {
                let id = fixed | part;
                standard[(id / 64) as usize] |= 1 << (id % 64);
                if part == 0 {
                    break;
                }
                part = (part - 1) & free;
            }
        }
        Self { filters, standard }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw(id: u32) -> CanFrame {
        CanFrame::from_raw(id, 0, [0; 8]).unwrap()
    }

    #[test]
    fn exact_filter_takes_only_the_data_frame() {
        let filter = Filter::exact(0x190);
        assert!(filter.accepts(&raw(0x190)));
        for other in [
            0x191,
            0x190 | REMOTE_FLAG,
            0x190 | EXTENDED_FLAG,
            0x190 | ERROR_FLAG,
        ] {
            assert!(!filter.accepts(&raw(other)), "{other:#x}");
        }
    }

    #[test]
    fn a_remote_frame_shows_its_length_and_an_error_message_has_no_other_flag() {
        let remote = |length| CanFrame::from_raw(REMOTE_FLAG | 0x190, length, [7; 8]).unwrap();
        assert_eq!(remote(8).to_string(), "190#R8");
        assert_eq!(remote(8).data(), [0; 8]);
        assert_eq!(remote(0).to_string(), "190#R");
        for (flag, expected) in [(0, "20000004#0101"), (REMOTE_FLAG, "20000000#0000")] {
            let flags = ERROR_FLAG | EXTENDED_FLAG | flag;
            let error = CanFrame::from_raw(flags | 4, 2, [1; 8]).unwrap();
            assert!(error.is_error() && !error.is_remote());
            assert_eq!(error.to_string(), expected);
        }
    }

    /// `linux/can.h`: a mask with `CAN_ERR_FLAG` makes a filter for error messages, so no data filter may carry it.
    #[test]
    fn error_messages_pass_only_the_filter_for_them() {
        let error = raw(ERROR_FLAG | 0x40);
        assert!(Filter::ERRORS.accepts(&error));
        assert!(!Filter::ALL.accepts(&error));
        assert!(!Filter::ERRORS.accepts(&raw(0x40)));
        assert!(Filter::ALL.accepts(&raw(0x40)));
    }

    #[test]
    fn a_set_accepts_what_one_of_its_filters_accepts() {
        let heartbeats = Filter {
            id: 0x700,
            mask: EXTENDED_FLAG | REMOTE_FLAG | 0x780,
        };
        let filters = vec![Filter::exact(0x190), heartbeats, Filter::ERRORS];
        let set = FilterSet::from(filters.clone());
        let standard = 0..=0x7FF;
        let others = [
            0x190 | REMOTE_FLAG,
            0x190 | EXTENDED_FLAG,
            ERROR_FLAG | 0x40,
        ];
        for id in standard.chain(others) {
            let expected = filters.iter().any(|filter| filter.accepts(&raw(id)));
            assert_eq!(set.accepts(&raw(id)), expected, "{id:#x}");
        }
        assert_eq!(set.filters(), filters);
    }
}
