//! Listeners of each frame, computed once: with many participants most frames are for few of them.

use can::{CanFrame, FilterSet};

/// Largest number of participants; more have no place on one bus.
const PARTICIPANTS_MAX: usize = 64;

/// Filters of all participants, which are named by their index.
pub(crate) struct Listeners {
    accepted: Vec<FilterSet>,
    /// Set of participants by 11-bit identifier, with a bit for each.
    standard: Vec<u64>,
}

impl Listeners {
    /// # Panics
    /// If there are more than 64.
    pub(crate) fn new(accepted: Vec<FilterSet>) -> Self {
        assert!(accepted.len() <= PARTICIPANTS_MAX, "too many participants");
        let of = |id| bits(&accepted, &CanFrame::new(id, &[]));
        Self {
            standard: (0..0x800).map(of).collect(),
            accepted,
        }
    }

    /// Returns the participants that accept a frame, in their order.
    pub(crate) fn of(&self, frame: &CanFrame) -> impl Iterator<Item = usize> + use<> {
        let mut left = match frame.standard_id() {
            Some(id) => self.standard[usize::from(id)],
            None => bits(&self.accepted, frame),
        };
        std::iter::from_fn(move || {
            let first = left.trailing_zeros() as usize;
            let is_there = left != 0;
            left &= left.wrapping_sub(1);
            is_there.then_some(first)
        })
    }
}

fn bits(accepted: &[FilterSet], frame: &CanFrame) -> u64 {
    let places = (0..).zip(accepted);
    let listening = places.filter(|(_, accepted)| accepted.accepts(frame));
    listening.fold(0, |bits, (place, _)| bits | 1 << place)
}

#[cfg(test)]
mod tests {
    use can::Filter;

    use super::*;

    #[test]
    fn a_frame_is_for_those_who_accept_it() {
        let filters = [
            vec![Filter::exact(0x190)],
            vec![Filter::ALL],
            vec![Filter::exact(0x080), Filter::ERRORS],
        ];
        let listeners = Listeners::new(filters.map(FilterSet::from).into());
        let of = |frame: CanFrame| Vec::from_iter(listeners.of(&frame));
        assert_eq!(of(CanFrame::new(0x190, &[])), [0, 1]);
        assert_eq!(of(CanFrame::new(0x080, &[])), [1, 2]);
        assert_eq!(of(CanFrame::from_raw(0x2000_0004, 8, [0; 8]).unwrap()), [2]);
        assert_eq!(of(CanFrame::from_raw(0x8000_0190, 0, [0; 8]).unwrap()), [1]);
    }
}
