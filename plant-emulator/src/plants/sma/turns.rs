//! The turns of a wire's temperature that its transformation remembers.

/// Largest number of remembered turns.
pub(super) const TURNS_MAX: usize = 64;

/// A point of the hysteresis at which the temperature turned.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Turn {
    /// Temperature `T` of the turn.
    pub(super) temperature_celsius: f64,
    /// Martensite fraction `ξ` at the turn.
    pub(super) martensite_fraction: f64,
}

/// A stack of turns; the last one is on top.
#[derive(Clone, Debug)]
pub(super) struct Turns {
    places: [Turn; TURNS_MAX],
    count: usize,
}

impl Turns {
    pub(super) fn none() -> Self {
        Self {
            places: [Turn::default(); TURNS_MAX],
            count: 0,
        }
    }

    /// Returns all turns, the oldest first.
    pub(super) fn all(&self) -> &[Turn] {
        &self.places[..self.count]
    }

    /// Puts a turn on top. Returns false if there is no room.
    pub(super) fn remember(&mut self, turn: Turn) -> bool {
        let Some(place) = self.places.get_mut(self.count) else {
            return false;
        };
        *place = turn;
        self.count += 1;
        true
    }

    /// Removes the topmost `count` turns.
    pub(super) fn forget(&mut self, count: usize) {
        self.count = self.count.saturating_sub(count);
    }
}
