//! Index of values by the identifiers of frames: looked up for every frame of a recording.

use std::collections::BTreeMap;

/// Number of identifiers of 11 bits.
const STANDARD: usize = 0x800;

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
    pub(crate) fn get(&self, raw_id: u32) -> Option<&T> {
        let (_, value) = self.values.get(self.place(raw_id)?)?;
        Some(value)
    }

    #[inline]
    pub(crate) fn get_mut(&mut self, raw_id: u32) -> Option<&mut T> {
        let place = self.place(raw_id)?;
        self.values.get_mut(place).map(|(_, value)| value)
    }

    #[inline]
    fn place(&self, raw_id: u32) -> Option<usize> {
        match self.standard.get(raw_id as usize) {
            Some(place) => Some(usize::from(place.checked_sub(1)?)),
            None => (self
                .values
                .binary_search_by_key(&raw_id, |(raw_id, _)| *raw_id))
            .ok(),
        }
    }
}

impl ByIdentifier<Vec<usize>> {
    /// Makes an index of readers, each named by its place, from the identifiers that each of them reads.
    pub(crate) fn of_readers<R: Iterator<Item = u32>>(read: impl IntoIterator<Item = R>) -> Self {
        let mut readers: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for (place, raw_ids) in read.into_iter().enumerate() {
            raw_ids.for_each(|raw_id| readers.entry(raw_id).or_default().push(place));
        }
        readers.values_mut().for_each(Vec::dedup);
        readers.into_iter().collect()
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
        let readers = ByIdentifier::of_readers(read);
        let of = |raw_id| readers.get(raw_id).map(Vec::as_slice);
        assert_eq!(of(0x000), Some(&[0][..]));
        assert_eq!(of(0x190), Some(&[0, 1][..]));
        assert_eq!([0x7FF, 0x8000_0190].map(of), [Some(&[1][..]); 2]);
        assert_eq!([0x191, 0x800, 0x2000_0004].map(of), [None; 3]);
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
