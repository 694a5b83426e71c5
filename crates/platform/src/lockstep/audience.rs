//! Who listens to a node, and whom it may make speak.

use canopen::{CanFrame, Filter, FilterSet};

/// What the other participants of a bus do with a node's frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Audience {
    /// What somebody listens to.
    pub accepted: FilterSet,
    /// What all who listen to it take in silence ([`canopen::Node::silent_filters`]).
    pub silent: FilterSet,
}

impl Default for Audience {
    /// Nothing is known of the others: any frame may be answered.
    fn default() -> Self {
        Self {
            accepted: vec![Filter::ALL, Filter::ERRORS].into(),
            silent: Vec::new().into(),
        }
    }
}

impl Audience {
    /// True when somebody may queue a frame because of this one.
    #[must_use]
    pub fn may_answer(&self, frame: &CanFrame) -> bool {
        self.accepted.accepts(frame) && !self.silent.accepts(frame)
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
}
