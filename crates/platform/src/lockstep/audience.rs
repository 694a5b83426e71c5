//! Listeners of a node, and the frames that they may answer.

use std::cmp::Reverse;

use can::{CanFrame, Filter, FilterSet};

use super::protocol::FILTERS_MAX;

/// Number of identifiers of 11 bits.
const IDENTIFIERS: u16 = 0x800;

/// Reception of a node's frames by the other participants of a bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Audience {
    /// Frames that at least one participant listens to.
    pub accepted: FilterSet,
    /// Frames that all their listeners take in silence ([`can::Node::silent_filters`]).
    pub silent: FilterSet,
}

impl Default for Audience {
    /// Assumes that any frame may be answered, since the others are unknown.
    fn default() -> Self {
        Self {
            accepted: vec![Filter::ALL, Filter::ERRORS].into(),
            silent: Vec::new().into(),
        }
    }
}

impl Audience {
    /// Returns whether a participant may queue a frame because of this one.
    pub fn may_answer(&self, frame: &CanFrame) -> bool {
        self.accepted.accepts(frame) && !self.silent.accepts(frame)
    }

    /// Returns the frames that no participant answers, as blocks of identifiers: the largest ones, if there are too many.
    pub fn quiet(&self) -> Vec<Filter> {
        let is_quiet = |id: u16| !self.may_answer(&CanFrame::new(id, &[]));
        let mut blocks = Vec::new();
        add_blocks(0, IDENTIFIERS, &is_quiet, &mut blocks);
        blocks.sort_by_key(|(first, size)| (Reverse(*size), *first));
        blocks.truncate(FILTERS_MAX);
        let filter = |(first, size): (u16, u16)| {
            let exact = Filter::exact(first);
            Filter {
                mask: exact.mask & !u32::from(size - 1),
                ..exact
            }
        };
        blocks.into_iter().map(filter).collect()
    }
}

/// Adds the largest blocks of identifiers that `holds` accepts as a whole, each with its size, a power of two.
fn add_blocks(first: u16, size: u16, holds: &impl Fn(u16) -> bool, blocks: &mut Vec<(u16, u16)>) {
    if (first..first + size).all(holds) {
        blocks.push((first, size));
    } else if size > 1 {
        let half = size / 2;
        add_blocks(first, half, holds, blocks);
        add_blocks(first + half, half, holds, blocks);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_accepted_and_not_taken_in_silence_may_be_answered() {
        let audience = Audience {
            accepted: vec![Filter::exact(0x080), Filter::exact(0x210)].into(),
            silent: vec![Filter::exact(0x210)].into(),
        };
        let may_answer = |id| audience.may_answer(&CanFrame::new(id, &[]));
        assert!(may_answer(0x080) && !may_answer(0x210) && !may_answer(0x290));
        assert!(Audience::default().may_answer(&CanFrame::new(0x290, &[])));
    }

    #[test]
    fn quiet_is_all_that_nobody_answers() {
        let audience = Audience {
            accepted: vec![Filter::exact(0x080), Filter::block(0x200, 0x7F0)].into(),
            silent: vec![Filter::exact(0x20F)].into(),
        };
        let filters = audience.quiet();
        assert!(filters.len() < 30, "{filters:?}");
        let quiet = FilterSet::from(filters);
        for id in 0..IDENTIFIERS {
            let frame = CanFrame::new(id, &[]);
            assert_eq!(
                quiet.accepts(&frame),
                !audience.may_answer(&frame),
                "{id:#x}"
            );
        }
        let remote = CanFrame::from_raw(0x4000_0300, 0, [0; 8]).unwrap();
        assert!(!quiet.accepts(&remote));
        assert_eq!(Audience::default().quiet(), []);
    }
}
