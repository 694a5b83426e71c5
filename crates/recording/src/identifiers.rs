//! Index of the frames that a reader reads, and of their purpose: looked up for every frame of a recording.

use std::collections::BTreeMap;

/// Number of identifiers of 11 bits.
const STANDARD: usize = 0x800;

/// Index of several readers by frame. Each reader is named by its place.
pub(crate) struct Readers {
    /// Readers by identifier of 11 bits.
    standard: Vec<Vec<usize>>,
    /// Readers of the longer identifiers: all.
    all: Vec<usize>,
}

impl Readers {
    /// Makes the index from the identifiers that each of them reads.
    pub(crate) fn new<R: Iterator<Item = u32>>(read: impl IntoIterator<Item = R>) -> Self {
        let mut standard = vec![Vec::new(); STANDARD];
        let mut all = Vec::new();
        for (place, raw_ids) in read.into_iter().enumerate() {
            for raw_id in raw_ids {
                if let Some(readers) = standard.get_mut(raw_id as usize)
                    && readers.last() != Some(&place)
                {
                    readers.push(place);
                }
            }
            all.push(place);
        }
        Self { standard, all }
    }

    /// Returns the readers of a frame, in their order.
    #[inline]
    pub(crate) fn of(&self, raw_id: u32) -> &[usize] {
        self.standard.get(raw_id as usize).unwrap_or(&self.all)
    }
}

/// Map of values by the identifiers of messages.
pub(crate) struct ByIdentifier<T> {
    /// Values in the order of the identifiers.
    values: Vec<(u32, T)>,
    /// One more than the place of the value, by identifier of 11 bits; 0 for no value.
    standard: Box<[u16; STANDARD]>,
}

impl<T> ByIdentifier<T> {
    pub(crate) fn raw_ids(&self) -> impl Iterator<Item = u32> {
        self.values.iter().map(|(raw_id, _)| *raw_id)
    }

    pub(crate) fn values(&self) -> impl Iterator<Item = &T> {
        self.values.iter().map(|(_, value)| value)
    }

    #[inline]
    pub(crate) fn get_mut(&mut self, raw_id: u32) -> Option<&mut T> {
        let place = match self.standard.get(raw_id as usize) {
            Some(place) => usize::from(place.checked_sub(1)?),
            None => (self
                .values
                .binary_search_by_key(&raw_id, |(raw_id, _)| *raw_id))
            .ok()?,
        };
        self.values.get_mut(place).map(|(_, value)| value)
    }
}

impl<T> FromIterator<(u32, T)> for ByIdentifier<T> {
    /// Keeps the later of two values with one identifier.
    fn from_iter<I: IntoIterator<Item = (u32, T)>>(values: I) -> Self {
        let values = BTreeMap::from_iter(values).into_iter();
        let values = Vec::from_iter(values);
        let mut standard = Box::new([0; STANDARD]);
        for (place, (raw_id, _)) in (1..=u16::MAX).zip(&values) {
            if let Some(known) = standard.get_mut(*raw_id as usize) {
                *known = place;
            }
        }
        Self { values, standard }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_for_those_who_read_it() {
        let [first, second] = [vec![0x000, 0x190, 0x000], vec![0x7FF, 0x190, 0x8000_0190]];
        let read = [first, second, Vec::new()].map(Vec::into_iter);
        let readers = Readers::new(read);
        assert_eq!(readers.of(0x000), [0]);
        assert_eq!(readers.of(0x190), [0, 1]);
        assert_eq!(readers.of(0x7FF), [1]);
        assert_eq!(readers.of(0x191), [0; 0]);
        for unlisted in [0x800, 0x2000_0004, 0x8000_0190] {
            assert_eq!(readers.of(unlisted), [0, 1, 2], "{unlisted:#x}");
        }
    }

    #[test]
    fn a_value_is_found_by_its_identifier_whatever_its_length() {
        let mut values = ByIdentifier::from_iter([(0x9000_0190, 'c'), (0x190, 'a'), (0x7FF, 'b')]);
        assert_eq!(
            Vec::from_iter(values.raw_ids()),
            [0x190, 0x7FF, 0x9000_0190]
        );
        assert_eq!(Vec::from_iter(values.values()), [&'a', &'b', &'c']);
        let found =
            [0x190, 0x7FF, 0x9000_0190, 0x000, 0x9000_0191].map(|id| values.get_mut(id).copied());
        assert_eq!(found, [Some('a'), Some('b'), Some('c'), None, None]);
    }
}
