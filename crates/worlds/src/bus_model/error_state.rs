//! Error counters of one station: error active, error passive, bus-off and back (ISO 11898-1, "Fault confinement").

use std::time::Duration;

use can::CanFrame;
use can::frame::ERROR_FLAG;

use can::error_frames::{
    BACK_TO_ACTIVE, BUS_OFF, CONTROLLER, RECEIVE_PASSIVE, RESTARTED, TRANSMIT_PASSIVE,
};

/// Increase of a counter by an error, for a transmitter and for a receiver.
const TRANSMIT_ERROR: u16 = 8;
const RECEIVE_ERROR: u16 = 1;
/// Largest counter of an error active station; above it the station is error passive.
const ACTIVE_MAX: u16 = 127;
/// Largest counter of an error passive transmitter; above it the station is bus-off.
const PASSIVE_MAX: u16 = 255;
/// Receive counter after a good reception, if it was above [`ACTIVE_MAX`]; the standard permits 119 to 127.
const RECOVERED_RECEIVE_COUNT: u16 = 119;
/// Number of sequences of recessive bits after which bus-off ends.
const RECOVERY_SEQUENCES: u32 = 128;
/// Length of such a sequence.
pub(crate) const SEQUENCE_BITS: u32 = 11;

/// Activity of a station on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Activity {
    /// It answers an error with an active error flag.
    Active,
    /// It answers with a passive flag and waits after its own frames.
    Passive,
    /// It neither sends nor receives.
    Off,
}

/// Error counters of a station.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ErrorState {
    transmit: u16,
    receive: u16,
    /// Recessive sequences seen since bus-off, and the time up to which they are counted.
    recovery: Option<(u32, Duration)>,
}

impl ErrorState {
    /// Returns the station's activity.
    pub(crate) fn activity(&self) -> Activity {
        if self.recovery.is_some() {
            Activity::Off
        } else if self.transmit.max(self.receive) > ACTIVE_MAX {
            Activity::Passive
        } else {
            Activity::Active
        }
    }

    /// Counts an error in the station's own frame; the bus is free again at `free_at`.
    pub(crate) fn on_transmit_error(&mut self, free_at: Duration) {
        self.transmit += TRANSMIT_ERROR;
        if self.transmit > PASSIVE_MAX {
            self.recovery = Some((0, free_at));
        }
    }

    /// Counts an error in another station's frame.
    pub(crate) fn on_receive_error(&mut self) {
        self.receive = (self.receive + RECEIVE_ERROR).min(PASSIVE_MAX);
    }

    /// Counts a frame of its own that has passed.
    pub(crate) fn on_transmitted(&mut self) {
        self.transmit = self.transmit.saturating_sub(1);
    }

    /// Counts a frame of another station that has passed.
    pub(crate) fn on_received(&mut self) {
        self.receive = match self.receive {
            0 => 0,
            1..=ACTIVE_MAX => self.receive - 1,
            _ => RECOVERED_RECEIVE_COUNT,
        };
    }

    /// Counts a use of the bus: the idle time before it, and its own recessive end as one sequence.
    pub(crate) fn on_bus_used(&mut self, start: Duration, free_at: Duration, sequence: Duration) {
        if let Some((sequences, counted_to)) = &mut self.recovery {
            *sequences += idle_sequences(*counted_to, start, sequence) + 1;
            *counted_to = free_at;
        }
    }

    /// Returns the time at which bus-off ends if the bus stays idle.
    pub(crate) fn recovers_at(&self, sequence: Duration) -> Option<Duration> {
        let (sequences, counted_to) = self.recovery?;
        Some(counted_to + sequence * RECOVERY_SEQUENCES.saturating_sub(sequences))
    }

    /// Returns from bus-off, with counters at 0.
    pub(crate) fn recover(&mut self) {
        *self = Self::default();
    }

    /// Returns the message of the station's CAN driver on its state, as in `linux/can/error.h`: the class, the controller's
    /// state, in data[5] the node's number, the counters in data[6] and data[7].
    pub(crate) fn message(&self, node: u8, has_recovered: bool) -> CanFrame {
        let (class, controller) = match self.activity() {
            Activity::Off => (BUS_OFF, 0),
            Activity::Active if has_recovered => (RESTARTED, 0),
            Activity::Active => (CONTROLLER, BACK_TO_ACTIVE),
            Activity::Passive if self.transmit > ACTIVE_MAX => (CONTROLLER, TRANSMIT_PASSIVE),
            Activity::Passive => (CONTROLLER, RECEIVE_PASSIVE),
        };
        let [transmit, receive] =
            [self.transmit, self.receive].map(|count| u8::try_from(count).unwrap_or(u8::MAX));
        let data = [0, controller, 0, 0, 0, node, transmit, receive];
        CanFrame::from_raw(ERROR_FLAG | class, 8, data).unwrap_or_else(|| CanFrame::new(0, &[]))
    }
}

fn idle_sequences(from: Duration, until: Duration, sequence: Duration) -> u32 {
    let sequences = until.saturating_sub(from).as_nanos() / sequence.as_nanos().max(1);
    u32::try_from(sequences).unwrap_or(u32::MAX / 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use can::error_frames;

    #[test]
    fn sixteen_errors_make_passive_and_thirty_two_bus_off() {
        let mut state = ErrorState::default();
        let activities: Vec<Activity> = (0..32)
            .map(|_| {
                state.on_transmit_error(Duration::ZERO);
                state.activity()
            })
            .collect();
        assert!(activities[..15].iter().all(|one| *one == Activity::Active));
        assert!(
            activities[15..31]
                .iter()
                .all(|one| *one == Activity::Passive)
        );
        assert_eq!(activities[31], Activity::Off);
    }

    #[test]
    fn good_frames_count_down_by_one() {
        let mut state = ErrorState::default();
        (0..16).for_each(|_| state.on_transmit_error(Duration::ZERO));
        assert_eq!(state.activity(), Activity::Passive);
        state.on_transmitted();
        assert_eq!(state.activity(), Activity::Active);
        let mut receiver = ErrorState::default();
        (0..200).for_each(|_| receiver.on_receive_error());
        assert_eq!(receiver.activity(), Activity::Passive);
        receiver.on_received();
        assert_eq!(receiver.activity(), Activity::Active);
        assert_eq!(receiver.receive, RECOVERED_RECEIVE_COUNT);
    }

    #[test]
    fn bus_off_ends_after_128_times_11_recessive_bits() {
        let (bit, sequence) = (Duration::from_micros(1), Duration::from_micros(11));
        let mut state = ErrorState::default();
        (0..32).for_each(|_| state.on_transmit_error(Duration::ZERO));
        assert_eq!(state.recovers_at(sequence), Some(bit * 11 * 128));
        // A frame of 100 bits after 22 idle ones: two sequences before it, one at its end.
        state.on_bus_used(bit * 22, bit * 122, sequence);
        assert_eq!(state.recovers_at(sequence), Some(bit * (122 + 11 * 125)));
        state.recover();
        assert_eq!(
            (state.activity(), state.recovers_at(sequence)),
            (Activity::Active, None)
        );
    }

    #[test]
    fn messages_say_who_is_in_which_state() {
        let mut state = ErrorState::default();
        (0..16).for_each(|_| state.on_transmit_error(Duration::ZERO));
        let described = |message: CanFrame| {
            let message = error_frames::read(&message).unwrap();
            (message.node, message.text)
        };
        let reported = |text: &str| (16, text.to_owned());
        assert_eq!(
            described(state.message(16, false)),
            reported("error passive")
        );
        assert_eq!(
            state.message(16, false).to_string(),
            "20000004#0020000000108000"
        );
        (0..16).for_each(|_| state.on_transmit_error(Duration::ZERO));
        assert_eq!(described(state.message(16, false)), reported("bus-off"));
        state.recover();
        assert_eq!(
            described(state.message(16, true)),
            reported("back from bus-off")
        );
    }
}
