//! The bits of a signal, and the physical value that they represent.

use std::cmp::Ordering;

use serde::{Deserialize, Serialize};

/// Order of the bytes (DBC `@1` and `@0`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ByteOrder {
    /// Intel; CANopen's own order.
    LittleEndian,
    /// Motorola.
    BigEndian,
}

/// Meaning of the bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Kind {
    /// Unsigned integer.
    Unsigned,
    /// Two's complement.
    Signed,
    /// IEEE 754, 32 bits.
    Float32,
    /// IEEE 754, 64 bits.
    Float64,
}

/// Lowest and highest physical value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Range {
    /// Lowest physical value.
    pub minimum: f64,
    /// Highest physical value.
    pub maximum: f64,
}

/// Place of a signal in a payload, and conversion of its bits to a physical value. [`crate::Database::parse`] makes it, and
/// admits only codings that pass [`Coding::check`].
#[non_exhaustive]
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Coding {
    /// DBC start bit: of the lowest bit if little-endian, of the highest if big-endian.
    pub start_bit: u8,
    /// Length in bits, 1 to 64.
    pub length_bits: u8,
    /// Order of the bytes.
    pub byte_order: ByteOrder,
    /// Meaning of the bits.
    pub kind: Kind,
    /// Physical value per raw step.
    pub factor: f64,
    /// Physical value of raw 0.
    pub offset: f64,
    /// Physical range; `None` if the file gives none (`[0|0]`).
    pub range: Option<Range>,
    /// Use of the factor; see [`Scale`].
    pub(crate) scale: Scale,
}

/// Use of a factor. Division by the 1000 of a factor 0.001 gives the decimal number that a log would show, while multiplication
/// by 0.001 is off in the last place.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) enum Scale {
    Multiply(f64),
    /// Division by the inverse of the factor, if that is a whole number.
    Divide(f64),
}

impl Scale {
    pub(crate) fn new(factor: f64) -> Self {
        let divisor = (1.0 / factor).round();
        if divisor.is_finite() && divisor != 0.0 && 1.0 / divisor == factor {
            Self::Divide(divisor)
        } else {
            Self::Multiply(factor)
        }
    }
}

impl Coding {
    /// Makes a little-endian integer whose raw value is `units` times the physical one, plus `raw_offset`.
    pub fn integer(
        start_bit: u8,
        length_bits: u8,
        kind: Kind,
        units: f64,
        raw_offset: f64,
    ) -> Self {
        let factor = 1.0 / units;
        Self {
            offset: -raw_offset * factor,
            ..Self::little_endian(start_bit, length_bits, kind, factor, None)
        }
    }

    /// Makes a little-endian signal without offset.
    pub fn little_endian(
        start_bit: u8,
        length_bits: u8,
        kind: Kind,
        factor: f64,
        range: Option<Range>,
    ) -> Self {
        Self {
            start_bit,
            length_bits,
            byte_order: ByteOrder::LittleEndian,
            kind,
            factor,
            offset: 0.0,
            range,
            scale: Scale::new(factor),
        }
    }

    /// Makes the coding of an output of a plant: 16 bits, signed if its range begins below zero.
    pub fn of_output(steps_per_unit: f64, [minimum, maximum]: [f64; 2]) -> Self {
        let kind = if minimum < 0.0 {
            Kind::Signed
        } else {
            Kind::Unsigned
        };
        let range = Some(Range { minimum, maximum });
        Self::little_endian(0, 16, kind, 1.0 / steps_per_unit, range)
    }

    /// Sets the physical value per raw step.
    pub fn set_factor(&mut self, factor: f64) {
        self.factor = factor;
        self.scale = Scale::new(factor);
    }

    /// Moves the signal to another first bit.
    #[must_use]
    pub fn starting_at(self, start_bit: u8) -> Self {
        Self { start_bit, ..self }
    }

    /// Checks that the signal fits a payload of this many bytes, and that its numbers make sense.
    ///
    /// # Errors The reason.
    pub fn check(&self, payload_bytes: usize) -> Result<(), &'static str> {
        if !(1..=64).contains(&self.length_bits) {
            return Err("length is not 1 to 64 bits");
        }
        match self.kind {
            Kind::Float32 if self.length_bits != 32 => return Err("a 32-bit float needs 32 bits"),
            Kind::Float64 if self.length_bits != 64 => return Err("a 64-bit float needs 64 bits"),
            _ => {}
        }
        if self.end_bit() > 8 * payload_bytes.min(8) {
            return Err("reaches beyond the payload");
        }
        if self.factor == 0.0 || !self.factor.is_finite() || !self.offset.is_finite() {
            return Err("factor is 0 or not finite, or offset is not finite");
        }
        match self.range {
            Some(range)
                if range
                    .minimum
                    .partial_cmp(&range.maximum)
                    .is_none_or(Ordering::is_gt) =>
            {
                Err("range is empty")
            }
            _ => Ok(()),
        }
    }

    /// Returns the number of bytes that a payload needs to contain the signal.
    pub fn payload_bytes(&self) -> usize {
        self.end_bit().div_ceil(8)
    }

    /// Returns the bits of the signal in a payload's 64 bits, read in the signal's own byte order.
    pub fn mask(&self) -> u64 {
        u64::MAX >> (64 - u32::from(self.length_bits)) << self.shift()
    }

    /// Returns the same bits with byte 0 in the lowest 8 bits, whatever the byte order.
    pub fn occupied_bits(&self) -> u64 {
        match self.byte_order {
            ByteOrder::LittleEndian => self.mask(),
            ByteOrder::BigEndian => self.mask().swap_bytes(),
        }
    }

    /// Decodes the physical value in a payload; bytes beyond the signal do not matter.
    #[inline]
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a 32-bit float has 32 bits"
    )]
    pub fn decode(&self, payload: &[u8; 8]) -> f64 {
        let word = self.word(payload);
        // First shifted to the top: the shift down then leaves only the signal, with its sign.
        let unused = 64 - usize::from(self.length_bits);
        let top = word << (unused - self.shift());
        let number = match self.kind {
            Kind::Unsigned => (top >> unused) as f64,
            Kind::Signed => (top.cast_signed() >> unused) as f64,
            Kind::Float32 => f64::from(f32::from_bits((top >> unused) as u32)),
            Kind::Float64 => f64::from_bits(top),
        };
        match self.scale {
            Scale::Divide(divisor) => number / divisor + self.offset,
            Scale::Multiply(factor) => number * factor + self.offset,
        }
    }

    /// Writes the raw value nearest to a physical one, saturated at the range and at the limits of the bits. Floats keep
    /// not-a-number; for integers it has the value of raw 0.
    pub fn encode(&self, value: f64, payload: &mut [u8; 8]) {
        let raw = self.raw(value) << self.shift() & self.mask();
        let word = self.word(payload) & !self.mask() | raw;
        *payload = match self.byte_order {
            ByteOrder::LittleEndian => word.to_le_bytes(),
            ByteOrder::BigEndian => word.to_be_bytes(),
        };
    }

    /// Returns the 64 bits of a payload in the signal's byte order.
    #[inline]
    fn word(&self, payload: &[u8; 8]) -> u64 {
        match self.byte_order {
            ByteOrder::LittleEndian => u64::from_le_bytes(*payload),
            ByteOrder::BigEndian => u64::from_be_bytes(*payload),
        }
    }

    /// Returns the number of bits from the first bit of the payload to the end of the signal, in the signal's byte order.
    #[inline]
    fn end_bit(&self) -> usize {
        self.first_bit() + usize::from(self.length_bits)
    }

    /// Returns the place of the start bit, counted from the lowest bit of byte 0 or, big-endian, from its highest.
    #[inline]
    fn first_bit(&self) -> usize {
        let start = usize::from(self.start_bit);
        match self.byte_order {
            ByteOrder::LittleEndian => start,
            ByteOrder::BigEndian => start / 8 * 8 + 7 - start % 8,
        }
    }

    /// Returns the place of the lowest bit in the payload's 64 bits; [`Coding::check`] keeps it below 64.
    #[inline]
    fn shift(&self) -> usize {
        match self.byte_order {
            ByteOrder::LittleEndian => self.first_bit(),
            ByteOrder::BigEndian => 64 - self.end_bit(),
        }
    }

    /// Returns the raw bits of a physical value.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "casts from float saturate; the number is clamped to the bits, negative ones are two's complement"
    )]
    fn raw(&self, value: f64) -> u64 {
        let value = self
            .range
            .map_or(value, |range| value.clamp(range.minimum, range.maximum));
        let number = match self.scale {
            Scale::Divide(divisor) => (value - self.offset) * divisor,
            Scale::Multiply(factor) => (value - self.offset) / factor,
        };
        let length = u32::from(self.length_bits);
        match self.kind {
            Kind::Unsigned => (number.round() as i128).clamp(0, (1 << length) - 1) as u64,
            Kind::Signed => {
                let limit = 1_i128 << (length - 1);
                (number.round() as i128).clamp(-limit, limit - 1) as u64
            }
            Kind::Float32 => u64::from((number as f32).to_bits()),
            Kind::Float64 => number.to_bits(),
        }
    }
}
