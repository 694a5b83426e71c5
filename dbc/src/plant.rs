//! The frames of the rig with another plant: its own signals in place of those of the SMA actuator.

use crate::coding::{ByteOrder, Coding, Kind, Range, Scale};
use crate::database::{Database, Message, Signal};
use crate::signals::{DISTURBANCE_MESSAGE, WIRE_TEMPERATURE};

const TPDO1: &str = "drive_tpdo1";
const TPDO2: &str = "drive_tpdo2";
const MILLIMETRES: &str = "mm";
const TPDO3: &str = "drive_tpdo3";
/// COB-ID of TPDO3 less that of TPDO2 (CiA 301, 7.3.5).
const TPDO3_OFFSET: u32 = 0x100;
/// Signals before the true position in TPDO2.
const SIGNALS_IN_TPDO2: usize = 2;
const BITS: u8 = 16;
/// What the shipped DBC says of a wire in the controller's emergencies, and what is said of another plant.
const WORDS_OF_A_WIRE: [(&str, &str); 2] = [
    (
        "position changes faster than the wire moves",
        "position changes faster than the plant moves",
    ),
    (
        "position stands still although the wire is heated",
        "position stands still away from the set-point at the largest current",
    ),
];

/// A signal of an emulated plant: 16 bits, signed where its range begins below zero.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantSignal {
    /// Name; the unit is its end.
    pub name: String,
    /// Unit; empty for a number without one.
    pub unit: String,
    /// What it is.
    pub comment: String,
    /// Physical value of one step.
    pub resolution: f64,
    /// Lowest and highest value.
    pub range: Range,
}

impl Database {
    /// The frames of the rig with a plant that has these signals: the first two stand in `drive_tpdo2` before the true
    /// position, the others in a `drive_tpdo3`.
    #[must_use]
    pub fn with_plant(signals: &[PlantSignal]) -> Self {
        let mut messages = Self::shipped().messages().to_vec();
        let Some(place) = messages.iter().position(|message| message.name == TPDO2) else {
            return Self::from_messages(messages);
        };
        let (first, others) = signals.split_at(signals.len().min(SIGNALS_IN_TPDO2));
        let tpdo2 = &mut messages[place];
        let shipped = std::mem::take(&mut tpdo2.signals);
        tpdo2.signals = laid_out(first, &shipped);
        tpdo2
            .signals
            .extend_from_slice(&shipped[SIGNALS_IN_TPDO2..]);
        if !others.is_empty() {
            let signals = laid_out(others, &shipped);
            let tpdo3 = Message {
                name: TPDO3.to_owned(),
                raw_id: tpdo2.raw_id + TPDO3_OFFSET,
                length_bytes: signals.iter().map(|_| BITS / 8).sum(),
                comment: "TPDO3 of the emulated drive, every SYNC: more of the truth.".to_owned(),
                signals,
                ..tpdo2.clone()
            };
            messages.push(tpdo3);
        }
        if !signals.iter().any(|signal| signal.name == WIRE_TEMPERATURE) {
            let signals = messages.iter_mut().flat_map(|message| &mut message.signals);
            for (_, label) in signals.flat_map(|signal| &mut signal.labels) {
                let mut words = WORDS_OF_A_WIRE.iter();
                if let Some((_, of_a_plant)) = words.find(|(of_a_wire, _)| label == of_a_wire) {
                    (*of_a_plant).clone_into(label);
                }
            }
        }
        Self::from_messages(messages)
    }
}

impl Database {
    /// The same with an io node that has these outputs in RPDO1, from the one at the place `first` on; what stood there does so no
    /// more.
    #[must_use]
    pub fn with_io_outputs(&self, outputs: &[PlantSignal], first: usize) -> Self {
        let messages = self.messages().iter().map(|message| {
            let mut message = message.clone();
            if message.name == DISTURBANCE_MESSAGE {
                let own = laid_out(outputs, &message.signals).into_iter().zip(first..);
                let own = own.map(|(mut signal, place)| {
                    let place = u8::try_from(place).unwrap_or(u8::MAX);
                    signal.coding.start_bit = place.saturating_mul(BITS);
                    // Write analogue output 16-bit (CiA 401).
                    signal.coding.kind = Kind::Signed;
                    signal.object = format!("0x6411:{:02X}", place.saturating_add(1));
                    signal
                });
                let own = Vec::from_iter(own);
                message.signals.truncate(first);
                message.signals.extend(own);
                message.length_bytes = message.signals.iter().map(|_| BITS / 8).sum();
            }
            message
        });
        Self::from_messages(messages.collect())
    }

    /// The same where the drive's positions are in another unit than millimetres: `rename` gives a signal's name in it, `symbol`
    /// is how the DBC writes it, and `resolution` what one count of an emulated drive's position is in it.
    #[must_use]
    pub fn with_position_unit(
        &self,
        symbol: &str,
        resolution: Option<f64>,
        rename: impl Fn(&str) -> String,
    ) -> Self {
        let messages = self.messages().iter().map(|message| {
            let mut message = message.clone();
            for signal in &mut message.signals {
                let name = rename(&signal.name);
                if name == signal.name || !signal.unit.starts_with(MILLIMETRES) {
                    continue;
                }
                signal.unit = signal.unit.replacen(MILLIMETRES, symbol, 1);
                if let Some(resolution) = resolution.filter(|_| message.name == TPDO1) {
                    let coding = &mut signal.coding;
                    (coding.factor, coding.scale) = (resolution, Scale::new(resolution));
                    coding.range = None;
                }
                signal.name = name;
            }
            message
        });
        Self::from_messages(messages.collect())
    }
}

/// One after the other from the first bit on, with the receivers of the shipped ones and, where the shipped EDS knows them,
/// their objects.
fn laid_out(signals: &[PlantSignal], like: &[Signal]) -> Vec<Signal> {
    let starts = (0..=u8::MAX).step_by(usize::from(BITS));
    let laid_out = signals
        .iter()
        .zip(starts)
        .map(|(signal, start_bit)| Signal {
            name: signal.name.clone(),
            unit: signal.unit.clone(),
            coding: Coding {
                start_bit,
                length_bits: BITS,
                byte_order: ByteOrder::LittleEndian,
                kind: if signal.range.minimum < 0.0 {
                    Kind::Signed
                } else {
                    Kind::Unsigned
                },
                factor: signal.resolution,
                offset: 0.0,
                range: Some(signal.range),
                scale: Scale::new(signal.resolution),
            },
            labels: Vec::new(),
            receivers: like[0].receivers.clone(),
            object: (like.iter().find(|known| known.name == signal.name))
                .map_or_else(String::new, |known| known.object.clone()),
            comment: signal.comment.clone(),
        });
    laid_out.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use canopen::CanFrame;

    fn signal(name: &str, minimum: f64) -> PlantSignal {
        PlantSignal {
            name: name.to_owned(),
            unit: String::new(),
            comment: String::new(),
            resolution: 0.5,
            range: Range {
                minimum,
                maximum: 100.0,
            },
        }
    }

    #[test]
    fn a_third_signal_goes_into_a_message_of_its_own() {
        let signals = [signal("a", 0.0), signal("b", 0.0), signal("c", -100.0)];
        let database = Database::with_plant(&signals);
        let frame = CanFrame::new(0x390, &[0xFE, 0xFF]);
        let handle = database.signal("drive_tpdo3.c").unwrap();
        assert_eq!(handle.decode(&frame), Some(-1.0));
        assert_eq!(database.message_of(&frame).unwrap().length_bytes, 2);
        assert!(database.signal("drive_tpdo2.b").is_some());
        assert!(database.signal("drive_tpdo2.martensite_fraction").is_none());
        assert!(
            database
                .signal("drive_tpdo2.true_position_millimetres")
                .is_some()
        );
    }

    #[test]
    fn an_emergency_speaks_of_a_wire_only_where_there_is_one() {
        let labels = |signals: &[PlantSignal]| {
            let database = Database::with_plant(signals);
            let message = database.message("controller_emergency").unwrap();
            let labels = message.signals.iter().flat_map(|signal| &signal.labels);
            Vec::from_iter(labels.map(|(_, label)| label.clone()))
        };
        let count = |labels: &[String]| labels.iter().filter(|one| one.contains("wire")).count();
        let (wire, motor) = (
            labels(&[signal(WIRE_TEMPERATURE, 0.0)]),
            labels(&[signal("a", 0.0)]),
        );
        assert_eq!((count(&wire), count(&motor)), (WORDS_OF_A_WIRE.len(), 0));
        for (_, text) in WORDS_OF_A_WIRE {
            assert!(motor.iter().any(|label| label == text), "{text}");
        }
    }

    #[test]
    fn a_position_is_found_in_its_own_unit_and_by_that_name_only() {
        let rename = |name: &str| name.replace("millimetres", "degrees");
        let database = Database::shipped().with_position_unit("deg", Some(1e-3), rename);
        let frame = CanFrame::new(0x190, &[0x37, 0x12, 0x88, 0x13, 0, 0, 0, 0]);
        assert_eq!(database.position().unwrap().decode(&frame), Some(5.0));
        let by_name = database.signal("drive_tpdo1.position_degrees");
        assert_eq!(by_name, database.position().ok());
        assert_eq!(database.signal("drive_tpdo1.position_millimetres"), None);
        let shipped = Database::shipped();
        assert_eq!(
            shipped.position(),
            shipped.require(crate::signals::POSITION)
        );
    }

    #[test]
    fn a_plant_without_signals_has_its_position_only() {
        let database = Database::with_plant(&[]);
        assert_eq!(database.message("drive_tpdo2").unwrap().signals.len(), 1);
        assert!(database.message("drive_tpdo3").is_none());
    }
}
