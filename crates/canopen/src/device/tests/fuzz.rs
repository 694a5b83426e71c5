//! Fuzz tests: after any frames, the device does not panic, answers SDO and obeys NMT.

use proptest::prelude::*;

use super::*;
use can::frame::{ERROR_FLAG, EXTENDED_FLAG};

/// Returns identifiers that have a meaning, and any others.
fn identifiers() -> impl Strategy<Value = u32> {
    prop_oneof![
        4 => prop::sample::select(vec![
            0x000_u32, 0x080, 0x090, 0x081, 0x190, 0x210, 0x290, 0x310, 0x590, 0x610, 0x690, 0x701, 0x710, 0x7E5,
        ]),
        1 => 0..0x800_u32,
        1 => any::<u32>(),
    ]
}

/// Returns any frames, most of them plain data frames.
fn frames() -> impl Strategy<Value = CanFrame> {
    let flags = prop_oneof![
        6 => Just(0),
        1 => Just(REMOTE_FLAG),
        1 => Just(ERROR_FLAG),
        1 => Just(EXTENDED_FLAG),
    ];
    (identifiers(), flags, 0..=8_u8, any::<[u8; 8]>()).prop_map(|(id, flags, length, data)| {
        CanFrame::from_raw(id | flags, length, data).expect("at most 8 bytes")
    })
}

/// Returns SDO downloads to the objects of the services, which may break the configuration.
fn configuration() -> impl Strategy<Value = CanFrame> {
    let indices = prop::sample::select(vec![
        0x1003_u16, 0x1005, 0x1006, 0x1007, 0x1014, 0x1015, 0x1016, 0x1017, 0x1019, 0x1029, 0x1201,
        0x1400, 0x1401, 0x1600, 0x1601, 0x1800, 0x1801, 0x1A00, 0x1A01,
    ]);
    let values = prop_oneof![
        any::<u32>(),
        0..10_u32,
        prop::sample::select(vec![
            0x210_u32,
            0x8000_0210,
            0x4000_0190,
            0xC000_0190,
            0x190,
            0x6040_0010,
            0x2301_0020,
            0x4000_0080,
            1000,
        ]),
    ];
    (indices, 0..9_u8, values, 0..4_u8).prop_map(|(index, sub_index, value, unused)| {
        let [low, high] = index.to_le_bytes();
        let [a, b, c, d] = value.to_le_bytes();
        CanFrame::new(
            0x610,
            &[0x23 | unused << 2, low, high, sub_index, a, b, c, d],
        )
    })
}

/// Returns steps: a frame, and the microseconds before it.
fn steps() -> impl Strategy<Value = Vec<(CanFrame, u64)>> {
    let frame = prop_oneof![frames(), configuration()];
    prop::collection::vec((frame, 0..3000_u64), 0..200)
}

proptest! {
    #[test]
    fn any_sequence_of_frames_leaves_the_device_able_to_answer_and_obey(steps in steps()) {
        let mut bench = Bench::new();
        for (frame, microseconds) in steps {
            bench.now += Duration::from_micros(microseconds);
            if bench.device.next_deadline().is_some_and(|deadline| deadline <= bench.now) {
                bench.tick();
            }
            bench.send_frame(&frame);
        }
        prop_assert_eq!(bench.device.services().dropped_frames(), 0);
        let sent = bench.send(0, &[129, ID]);
        prop_assert_eq!(sent, ["710#00"]);
        prop_assert_eq!(bench.read(0x1000, 0), Ok(0x0002_0192));
        bench.send(0, &[1, ID]);
        prop_assert_eq!(bench.send(0x80, &[1]), ["190#000000000000"]);
    }

    #[test]
    fn any_sequence_of_frames_before_an_nmt_start_leaves_a_default_configuration_answering(
        frames in prop::collection::vec(frames(), 0..200)
    ) {
        let mut bench = Bench::new();
        for frame in &frames {
            bench.send_frame(frame);
        }
        bench.send(0, &[128, ID]);
        bench.send(0x610, &[0x80, 0, 0, 0, 0, 0, 0, 0]);
        prop_assert_eq!(bench.read(0x1000, 0), Ok(0x0002_0192));
    }

    #[test]
    fn time_always_goes_on(steps in steps()) {
        let mut bench = Bench::operational();
        for (frame, microseconds) in steps {
            bench.pass(Duration::from_micros(microseconds));
            bench.send_frame(&frame);
        }
    }
}
