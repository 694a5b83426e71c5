//! Tests of the gateway and the receiver, without a bus.

use std::path::Path;

use plan::catalogue::Catalogue;
use scenario::Beside;

use super::*;
use crate::catalogue::catalogue;
use crate::names::emulator_names;

/// Returns the faults of these tables for one drive; scenario time begins at 0.
fn faults(tables: &str) -> BusFaults {
    let text = format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 9.0\n[controller.open_loop]\n{tables}"
    );
    let plan = testing::plan(&text);
    let participants = ["plant-emulator".to_owned()];
    let mut faults = BusFaults::new(&plan, &participants).unwrap().unwrap();
    faults.observe(
        Duration::ZERO,
        &CanFrame::new(0x190, &[0x37, 2, 0, 0, 0, 0, 0, 0]),
    );
    faults.observe(Duration::ZERO, &CanFrame::new(0x080, &[1]));
    faults
}

fn milliseconds(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

/// Returns the frames that leave the gateway if 0x190 and 0x290 are sent at 1, 2, 3 … ms: times in milliseconds and identifiers.
fn sent(faults: &mut BusFaults, cycles: u64) -> Vec<(u128, u16)> {
    let mut outbox = VecDeque::new();
    for cycle in 1..=cycles {
        let frames = [0x190, 0x290].map(|id| (milliseconds(cycle), CanFrame::new(id, &[1, 2, 3])));
        faults.queue(0, &frames, &mut outbox);
    }
    let sent = outbox.iter();
    sent.map(|(time, frame)| (time.as_millis(), frame.standard_id().unwrap()))
        .collect()
}

#[test]
fn a_delayed_frame_comes_later_and_the_others_in_their_time() {
    let mut faults = faults(
        "[[fault.bus.delay]]\nfrom_seconds = 0.002\nuntil_seconds = 0.003\nsender = \"drive\"\n\
         identifier = 0x190\ndelay_milliseconds = 5.0\n",
    );
    let expected = [
        (1, 0x190),
        (1, 0x290),
        (2, 0x290),
        (3, 0x190),
        (3, 0x290),
        (7, 0x190),
    ];
    assert_eq!(sent(&mut faults, 3), expected);
}

#[test]
fn a_doubled_frame_comes_twice_and_an_overtaken_one_after_the_next() {
    let window =
        "from_seconds = 0.002\nuntil_seconds = 0.003\nsender = \"drive\"\nidentifier = 0x190\n";
    let doubled = sent(
        &mut faults(&format!("[[fault.bus.duplicate]]\n{window}")),
        2,
    );
    assert_eq!(
        doubled,
        [(1, 0x190), (1, 0x290), (2, 0x190), (2, 0x190), (2, 0x290)]
    );
    let overtaken = sent(&mut faults(&format!("[[fault.bus.reorder]]\n{window}")), 2);
    assert_eq!(overtaken, [(1, 0x190), (1, 0x290), (2, 0x290), (2, 0x190)]);
}

#[test]
fn a_corrupted_frame_differs_in_as_many_bits_as_asked_for() {
    let mut faults = faults(
        "[[fault.bus.corrupt]]\nfrom_seconds = 0.0\nsender = \"drive\"\ninverted_bits = 1\n",
    );
    let frame = CanFrame::new(0x190, &[0; 8]);
    for cycle in 0..100 {
        let mut outbox = VecDeque::new();
        faults.queue(0, &[(milliseconds(cycle), frame)], &mut outbox);
        let ones: u32 = outbox[0]
            .1
            .data()
            .iter()
            .map(|byte| byte.count_ones())
            .sum();
        assert_eq!((ones, outbox[0].1.raw_id()), (1, 0x190));
    }
}

/// The node-ID puts the report of the plant at 0x6D0.
#[test]
fn no_fault_hits_the_report_of_a_plant_whatever_its_identifier() {
    let text = "schema = 1\nrig = \"rig.toml\"\nname = \"t\"\nduration_seconds = 9.0\n[controller.open_loop]\n\
        [[fault.bus.delay]]\nfrom_seconds = 0.0\nsender = \"drive\"\ndelay_milliseconds = 5.0\n";
    let shipped = scenario::rig::shipped::text("sma_actuator").unwrap();
    let rig = shipped.replace("node_id = 0x10", "node_id = 0x30");
    let plan = testing::plan_beside(text, &[("rig.toml", &rig)], &Catalogue::shipped());
    assert_eq!(
        plan.loops.first().unwrap().trial.wiring.identifiers.truth,
        0x6D0
    );
    let participants = ["plant-emulator".to_owned()];
    let mut faults = BusFaults::new(&plan, &participants).unwrap().unwrap();
    for (id, data) in [(0x1B0, &[0x37, 2, 0, 0, 0, 0, 0, 0][..]), (0x080, &[1])] {
        faults.observe(Duration::ZERO, &CanFrame::new(id, data));
    }
    let mut outbox = VecDeque::new();
    let frames = [0x1B0, 0x6D0].map(|id| (milliseconds(1), CanFrame::new(id, &[0; 8])));
    faults.queue(0, &frames, &mut outbox);
    let queued = outbox.iter();
    let sent = queued.map(|(time, frame)| (time.as_millis(), frame.standard_id().unwrap()));
    assert_eq!(Vec::from_iter(sent), [(1, 0x6D0), (6, 0x1B0)]);
}

/// Two drives of one plant share the CAN controller of their emulator; each that canrig does not emulate has its own.
#[test]
fn a_drive_beside_others_is_a_sender_by_its_own_frames_and_a_receiver_with_them() {
    let text = "schema = 1\nrig = \"sma_pair\"\nname = \"t\"\nduration_seconds = 9.0\n\
        [controller.pid_pair]\nproportional_amperes_per_degree = 0.04\n\
        [[reference.hold]]\nat_seconds = 0.0\nposition_degrees = 5.0\n\
        [[fault.bus.duplicate]]\nfrom_seconds = 0.0\nsender = \"extensor\"\n\
        [[fault.bus.lose]]\nfrom_seconds = 0.0\nreceiver = \"extensor\"\n";
    let beside = Beside::new(Path::new("t.toml"));
    let read = |_: &str| unreachable!("no file");
    let emulated = Plan::parse(&beside, text.to_owned(), read, catalogue()).unwrap();
    let emulator = emulator_names(&emulated.loops)[0];
    let all = ["flexor", "extensor", "load"];
    for (external, participant, copies, misses) in [
        (&[][..], emulator, [1, 2], true),
        (&["extensor"], emulator, [1, 1], false),
        (&["extensor"], "extensor", [2, 2], true),
        (&all, "flexor", [1, 1], false),
        (&all, "extensor", [2, 2], true),
    ] {
        let names = Vec::from_iter(external.iter().map(ToString::to_string));
        let plan = emulated.clone().with_external(&names).unwrap();
        let faults = BusFaults::new(&plan, &[participant.to_owned()]).unwrap();
        let mut faults = faults.unwrap();
        let enabled = &[0x37, 2, 0, 0, 0, 0, 0, 0][..];
        for (id, data) in [(0x190, enabled), (0x192, enabled), (0x080, &[1])] {
            faults.observe(Duration::ZERO, &CanFrame::new(id, data));
        }
        let mut outbox = VecDeque::new();
        let ids = [0x190, 0x192];
        let frames = ids.map(|id| (milliseconds(1), CanFrame::new(id, &[])));
        faults.queue(0, &frames, &mut outbox);
        let count = |id| {
            outbox
                .iter()
                .filter(|sent| sent.1.standard_id() == Some(id))
                .count()
        };
        assert_eq!(ids.map(count), copies, "{participant} beside {external:?}");
        let command = CanFrame::new(0x210, &[]);
        assert_eq!(
            faults.misses(0, milliseconds(1), &command),
            misses,
            "{participant}"
        );
    }
}

#[test]
fn a_receiver_misses_bursts_of_what_is_meant() {
    let mut faults = faults(
        "[[fault.bus.lose]]\nfrom_seconds = 0.0\nreceiver = \"drive\"\nidentifier = 0x210\n\
         probability = 0.05\nburst_frames = 4\n",
    );
    let mut misses = |id| faults.misses(0, milliseconds(1), &CanFrame::new(id, &[]));
    assert!((0..100).all(|_| !misses(0x080)));
    let missed: Vec<bool> = (0..2000).map(|_| misses(0x210)).collect();
    let count = missed.iter().filter(|missed| **missed).count();
    // A burst of 4 begins after 20 frames on average: 4 of 23.
    assert!((250..450).contains(&count), "{count}");
    let runs = missed.split(|missed| !missed).filter(|run| !run.is_empty());
    assert!(runs.into_iter().all(|run| run.len() % 4 == 0));
}

#[test]
fn a_foreign_node_keeps_its_rate_and_a_babbling_one_never_pauses() {
    let mut load = faults(
        "[[fault.bus.load]]\nfrom_seconds = 0.001\nuntil_seconds = 0.004\nidentifier = 0x555\nperiod_milliseconds = 1.0\n",
    );
    let mut times = Vec::new();
    while let Some(next) = load.next_foreign(Duration::ZERO) {
        let (frame, _) = load.take_foreign(next, None).unwrap();
        assert_eq!(frame.standard_id(), Some(0x555));
        times.push(next.as_millis());
    }
    assert_eq!(times, [1, 2, 3]);
    let babble = faults(
        "[[fault.bus.babble]]\nfrom_seconds = 0.001\nuntil_seconds = 0.004\nidentifier = 1\n",
    );
    assert_eq!(babble.next_foreign(Duration::ZERO), Some(milliseconds(1)));
    assert_eq!(babble.next_foreign(milliseconds(2)), Some(milliseconds(2)));
    assert_eq!(babble.next_foreign(milliseconds(4)), None);
}
