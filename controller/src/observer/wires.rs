//! The two wires that it may be: one that forgets its turns, and one that remembers them.
//!
//! Nobody tells the controller which one it is. It has an estimate for each, and corrects both with the same gain, so that
//! they differ by their kinetics alone. Let a position lie `νf` and `νr` beside where the forgetting and the remembering
//! wire are expected, and let `S` be the variance of both. Then the logarithm of the odds for a memory gains
//! `γ (νf² − νr²) / 2S`. The factor `γ` is below 1, because successive distances depend on each other. The odds change in a
//! move only: in a hold hardly anything is transformed, and a better fit there is due to other parameters.

use crate::nominal_model::{Memory, NominalModel, State as ModelState, Turns};

/// Share of the remembering wire's slope that is Preisach's. The rest is the paper's: real memories are not Preisach's either.
const MEMORY_SHARE: f64 = 0.9;

/// Logarithm of the odds for a memory at the start: a probability of 0.27.
const LOG_ODDS_AT_START: f64 = -1.0;

/// `γ`.
const WEIGHT_OF_EVIDENCE: f64 = 0.6;

/// Largest change of the logarithm of the odds by one position.
const EVIDENCE_MAX: f64 = 3.0;

/// Largest logarithm of the odds for either wire: a probability of 0.993. A wire that was mistaken is recognised again.
const LOG_ODDS_MAX: f64 = 5.0;

/// Estimates for both wires, and the odds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wires {
    forgetting: ModelState,
    remembering: ModelState,
    turns: Turns,
    log_odds: f64,
    /// Probability that the wire remembers its turns.
    memory: f64,
}

impl Wires {
    /// Returns both wires in the same state, before any evidence.
    pub(super) fn start(state: &ModelState) -> Self {
        let mut wires = Self {
            forgetting: *state,
            remembering: *state,
            turns: Turns::default(),
            log_odds: LOG_ODDS_AT_START,
            memory: probability(LOG_ODDS_AT_START),
        };
        wires.place(state);
        wires
    }

    /// Moves both wires to a state without remembered turns; the odds stay.
    pub(super) fn place(&mut self, state: &ModelState) {
        self.turns = Turns::default();
        self.forgetting = *state;
        self.remembering = ModelState {
            memory: Memory {
                share: MEMORY_SHARE,
                ..Memory::default()
            },
            ..*state
        };
    }

    /// Returns the probability that the wire remembers its turns.
    pub(super) fn memory(&self) -> f64 {
        self.memory
    }

    /// Returns the estimates for both wires.
    pub(super) fn both(&mut self) -> [&mut ModelState; 2] {
        [&mut self.forgetting, &mut self.remembering]
    }

    /// Returns the mean of both wires by their probabilities.
    pub(super) fn mean(&self) -> ModelState {
        let (first, last) = (&self.forgetting, &self.remembering);
        let mean = |of: fn(&ModelState) -> f64| of(first) + (of(last) - of(first)) * self.memory;
        ModelState {
            position_metres: mean(|state| state.position_metres),
            velocity_metres_per_second: mean(|state| state.velocity_metres_per_second),
            martensite_fraction: mean(|state| state.martensite_fraction),
            temperature_celsius: mean(|state| state.temperature_celsius),
            unknown_heating_kelvins_per_second: mean(|state| {
                state.unknown_heating_kelvins_per_second
            }),
            memory: Memory {
                share: mean(|state| state.memory.share),
                ..last.memory
            },
        }
    }

    /// Takes what a position says about the kinetics, with the variance of its distance from the expected one. The share of
    /// motion is 1 in a move and 0 in a hold.
    pub(super) fn learn(&mut self, position_metres: f64, variance: f64, motion: f64) {
        let [forgetting, remembering] = self.both().map(|state| {
            let distance = position_metres - state.position_metres;
            distance * distance
        });
        let evidence = (forgetting - remembering) / (2.0 * variance);
        let change = (WEIGHT_OF_EVIDENCE * motion * evidence).clamp(-EVIDENCE_MAX, EVIDENCE_MAX);
        self.log_odds = (self.log_odds + change).clamp(-LOG_ODDS_MAX, LOG_ODDS_MAX);
        self.memory = probability(self.log_odds);
    }

    /// Follows the turns of the remembering wire under a current.
    pub(super) fn follow(&mut self, model: &NominalModel, squared_current: f64) {
        let rate = model.temperature_rate(&self.remembering, squared_current);
        model.follow(&mut self.turns, &mut self.remembering, rate);
    }
}

/// Returns the probability of these odds.
fn probability(log_odds: f64) -> f64 {
    1.0 / (1.0 + libm::exp(-log_odds))
}
