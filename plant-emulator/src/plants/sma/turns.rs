//! Turns of a wire's temperature, as far as its transformation remembers them.

/// Largest number of turns that are remembered.
pub(super) const TURNS_MAX: usize = 64;

/// A place on the hysteresis at which the temperature turned.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Turn {
    /// `T`.
    pub(super) temperature_celsius: f64,
    /// `ξ`.
    pub(super) martensite_fraction: f64,
}

/// A stack of turns, the last one on top.
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

    /// All turns, the oldest first.
    pub(super) fn all(&self) -> &[Turn] {
        &self.places[..self.count]
    }

    /// The turn below so many; `None` where there are no more.
    pub(super) fn below(&self, count: usize) -> Option<&Turn> {
        let place = self.count.checked_sub(count + 1)?;
        self.places.get(place)
    }

    /// Puts a turn on top. False if there is no room.
    pub(super) fn remember(&mut self, turn: Turn) -> bool {
        let Some(place) = self.places.get_mut(self.count) else {
            return false;
        };
        *place = turn;
        self.count += 1;
        true
    }

    /// Takes so many turns from the top.
    pub(super) fn forget(&mut self, count: usize) {
        self.count = self.count.saturating_sub(count);
    }

    pub(super) fn forget_all(&mut self) {
        self.count = 0;
    }
}
