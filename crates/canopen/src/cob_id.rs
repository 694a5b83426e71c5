//! COB-IDs in the dictionary (CiA 301, 7.5.2.5, 7.5.2.15, 7.5.2.35), and the identifiers that no service may take.

use crate::object_dictionary::{AbortCode, Accepted, Entry, ObjectDictionary};

const SYNC: u16 = 0x1005;
const EMCY: u16 = 0x1014;
const FLAG_31: u32 = 0x8000_0000;
const FLAG_30: u32 = 0x4000_0000;
const EXTENDED: u32 = 0x2000_0000;

/// A COB-ID: an 11-bit identifier with flags whose meaning depends on the service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CobId(pub(crate) u32);

impl CobId {
    /// Reads the COB-ID in an object's bytes.
    pub(crate) fn from_bytes(bytes: &[u8]) -> Accepted<Self> {
        let bytes = bytes.try_into().map_err(|_| AbortCode::LENGTH_MISMATCH)?;
        Ok(Self(u32::from_le_bytes(bytes)))
    }

    /// Checks bit 31: if it is clear, the PDO or the EMCY exists.
    pub(crate) fn is_valid(self) -> bool {
        self.0 & FLAG_31 == 0
    }

    /// Checks bit 30: SYNC is produced here; a TPDO allows no remote frame.
    pub(crate) fn flag_30(self) -> bool {
        self.0 & FLAG_30 != 0
    }

    /// Returns the identifier.
    pub(crate) fn id(self) -> u16 {
        (self.0 & 0x7FF) as u16
    }

    /// Refuses 29-bit identifiers and the restricted ones.
    pub(crate) fn check(self) -> Accepted {
        if self.0 & EXTENDED != 0 || self.0 & 0x1FFF_F800 != 0 || is_restricted(self.id()) {
            return Err(AbortCode::INVALID_VALUE);
        }
        Ok(())
    }

    /// Refuses COB-IDs that [`CobId::check`] refuses, and an identifier that another service of the node has: two services of one
    /// node would answer the same frame, or send different frames under one identifier. CiA 301 gives each its own (7.3.5).
    pub(crate) fn check_at(
        self,
        dictionary: &ObjectDictionary,
        (index, sub_index): (u16, u8),
    ) -> Accepted {
        self.check()?;
        let is_other = |entry: &&Entry| (entry.index, entry.sub_index) != (index, sub_index);
        let mut others = dictionary.entries().iter().filter(is_other);
        let is_used = |entry: &Entry| used_id(entry) == Some(self.id());
        if is_in_use(index, self) && others.any(is_used) {
            return Err(AbortCode::INVALID_VALUE);
        }
        Ok(())
    }
}

/// Checks the COB-ID to be written to a place: as [`CobId::check_at`], and the identifier stays while the service exists.
pub(crate) fn check_write(
    dictionary: &ObjectDictionary,
    place: (u16, u8),
    bytes: &[u8],
    refusal: AbortCode,
) -> Accepted {
    let new = CobId::from_bytes(bytes)?;
    new.check_at(dictionary, place)?;
    let old = CobId(dictionary.unsigned(place.0, place.1).unwrap_or(u32::MAX));
    if old.is_valid() && new.is_valid() && old.id() != new.id() {
        return Err(refusal);
    }
    Ok(())
}

/// Returns the identifier that a service has through this sub-object; `None` if the sub-object configures none, or the service
/// has none now.
fn used_id(entry: &Entry) -> Option<u16> {
    let is_cob_id = match entry.index {
        SYNC | EMCY => entry.sub_index == 0,
        0x1200..=0x12FF => matches!(entry.sub_index, 1 | 2),
        0x1400..=0x15FF | 0x1800..=0x19FF => entry.sub_index == 1,
        _ => false,
    };
    let cob_id = CobId(u32::try_from(entry.as_integer()).ok()?);
    (is_cob_id && is_in_use(entry.index, cob_id)).then(|| cob_id.id())
}

/// Checks whether a COB-ID is in use: bit 31 takes it out of use, but that of SYNC has no such bit.
fn is_in_use(index: u16, cob_id: CobId) -> bool {
    index == SYNC || cob_id.is_valid()
}

/// Checks whether an identifier is restricted: no configurable service may use it (CiA 301, table 42).
pub fn is_restricted(id: u16) -> bool {
    matches!(id, 0x000..=0x07F | 0x101..=0x180 | 0x581..=0x5FF | 0x601..=0x67F | 0x6E0..=0x6FF | 0x701..)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn restricted_and_extended_identifiers_are_refused() {
        for good in [0x080, 0x190, 0x210, 0x8000_0211, 0x4000_0080] {
            assert_eq!(CobId(good).check(), Ok(()), "{good:#x}");
        }
        for bad in [
            0x000,
            0x07F,
            0x101,
            0x180,
            0x590,
            0x610,
            0x701,
            0x7FF,
            0x2000_0190,
            0x0000_0990,
        ] {
            assert_eq!(
                CobId(bad).check(),
                Err(AbortCode::INVALID_VALUE),
                "{bad:#x}"
            );
        }
    }
}
