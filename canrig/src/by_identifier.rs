//! What belongs to each identifier of the bus, found without a search: for readers that are asked at every frame.

/// Identifiers of 11 bits, which all frames of the rig have.
const STANDARD: usize = 0x800;

/// Things by the raw identifier of their frames ([`canopen::CanFrame::raw_id`]); one thing each.
pub(crate) struct ByIdentifier<T> {
    things: Vec<(u32, T)>,
    /// Of each identifier of 11 bits, the place of its thing and one more; 0 where there is none.
    places: Box<[u16; STANDARD]>,
}

impl<T> ByIdentifier<T> {
    /// The thing of an identifier.
    #[inline]
    pub(crate) fn get_mut(&mut self, raw_id: u32) -> Option<&mut T> {
        let place = match self.places.get(raw_id as usize) {
            Some(place) => usize::from(*place).checked_sub(1)?,
            None => self.things.iter().position(|(id, _)| *id == raw_id)?,
        };
        self.things.get_mut(place).map(|(_, thing)| thing)
    }

    /// The identifiers of all things.
    pub(crate) fn raw_ids(&self) -> impl Iterator<Item = u32> {
        self.things.iter().map(|(id, _)| *id)
    }

    /// All things, in the order in which they came.
    pub(crate) fn values_mut(&mut self) -> impl Iterator<Item = &mut T> {
        self.things.iter_mut().map(|(_, thing)| thing)
    }

    /// All things, in the order in which they came.
    pub(crate) fn values(&self) -> impl Iterator<Item = &T> {
        self.things.iter().map(|(_, thing)| thing)
    }
}

impl<T> FromIterator<(u32, T)> for ByIdentifier<T> {
    /// Of things with one identifier the first counts.
    fn from_iter<I: IntoIterator<Item = (u32, T)>>(things: I) -> Self {
        let things: Vec<(u32, T)> = things.into_iter().collect();
        let mut places = Box::new([0; STANDARD]);
        for ((id, _), place) in things.iter().zip(1..) {
            if let Some(standard) = places.get_mut(*id as usize).filter(|place| **place == 0) {
                *standard = place;
            }
        }
        Self { things, places }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use canopen::frame::EXTENDED_FLAG;

    #[test]
    fn each_identifier_has_its_own_thing_or_none() {
        let ids = [0x190, 0, 0x7FF, EXTENDED_FLAG | 0x190];
        let mut things: ByIdentifier<u32> = ids.into_iter().zip(0..).collect();
        let found = ids.map(|id| things.get_mut(id).copied());
        assert_eq!(found, [Some(0), Some(1), Some(2), Some(3)]);
        let others = [0x191, 0x800, EXTENDED_FLAG, u32::MAX];
        assert_eq!(others.map(|id| things.get_mut(id).copied()), [None; 4]);
        assert!(things.values().eq(&[0, 1, 2, 3]));
    }
}
