//! Heartbeat producer and consumers.

use super::*;

/// Returns the bytes of a 0x1016 entry.
fn consumer_time(node_id: u8, milliseconds: u16) -> [u8; 4] {
    let [low, high] = milliseconds.to_le_bytes();
    [low, high, node_id, 0]
}

fn losses(bench: &mut Bench) -> Vec<Heard> {
    let heard = bench.heard().into_iter();
    heard
        .filter(|heard| matches!(heard, Heard::Loss(_) | Heard::Recovery(_)))
        .collect()
}

fn loss(node_id: u8) -> CommunicationLoss {
    CommunicationLoss::Heartbeat(NodeId::new(node_id).unwrap())
}

#[test]
fn producer_is_re_armed_at_once() {
    let mut bench = Bench::new();
    bench.write(0x1017, 0, &[100, 0]).unwrap();
    assert_eq!(
        bench.pass(milliseconds(1000)).len(),
        11,
        "at once, then every 100 ms"
    );
    bench.write(0x1017, 0, &[10, 0]).unwrap();
    let sent = bench.pass(milliseconds(999));
    assert_eq!(sent.len(), 100);
    assert_eq!(sent[0], (1000.0, "710#7F".to_owned()));
    assert_eq!(sent[99].0, 1990.0);
    bench.write(0x1017, 0, &[0, 0]).unwrap();
    assert!(bench.pass(milliseconds(1000)).is_empty());
}

#[test]
fn the_boot_up_message_is_the_first_heartbeat() {
    let mut dictionary = dictionary();
    let heartbeat = Entry::new(
        0x1017,
        0,
        "producer",
        DataType::Unsigned16,
        Rights::ReadWrite,
        vec![20, 0],
    );
    dictionary.insert(heartbeat);
    let mut bench = Bench::with(dictionary);
    let sent = bench.pass(milliseconds(45));
    let expected = [20.0, 40.0].map(|time| (time, "710#7F".to_owned()));
    assert_eq!(sent, expected);
}

#[test]
fn a_change_of_state_is_sent_at_once() {
    let mut bench = Bench::new();
    bench.write(0x1017, 0, &[100, 0]).unwrap();
    assert_eq!(bench.send(0, &[1, ID]), ["710#05"]);
    assert_eq!(bench.send(0, &[2, ID]), ["710#04"]);
    assert_eq!(bench.pass(milliseconds(101)).last().unwrap().1, "710#04");
}

#[test]
fn a_missing_heartbeat_raises_emcy_8130_and_recovery_ends_it() {
    let mut bench = Bench::new();
    bench.write(0x1016, 1, &consumer_time(1, 50)).unwrap();
    assert!(
        bench.pass(milliseconds(500)).is_empty(),
        "armed by the first"
    );
    bench.send(0x701, &[5]);
    let sent = bench.pass(milliseconds(200));
    assert_eq!(sent, [(550.0, "090#3081110100000000".to_owned())]);
    assert_eq!(losses(&mut bench), [Heard::Loss(loss(1))]);
    assert_eq!(bench.send(0x701, &[5]), ["090#0000003081010000"]);
    assert_eq!(losses(&mut bench), [Heard::Recovery(loss(1))]);
    let sent = bench.pass(milliseconds(200));
    assert_eq!(sent.len(), 1, "watched again");
}

#[test]
fn heartbeats_in_time_raise_nothing() {
    let mut bench = Bench::new();
    bench.write(0x1016, 1, &consumer_time(1, 50)).unwrap();
    for _ in 0..100 {
        assert!(bench.send(0x701, &[5]).is_empty());
        assert!(bench.pass(milliseconds(49)).is_empty());
    }
    assert!(losses(&mut bench).is_empty());
}

#[test]
fn several_nodes_are_watched_each_by_its_time() {
    let mut bench = Bench::new();
    for (sub_index, node_id, time) in [(1, 1, 50), (2, 2, 30), (3, 127, 90)] {
        let entry = consumer_time(node_id, time);
        bench.write(0x1016, sub_index, &entry).unwrap();
        bench.send(0x700 + u16::from(node_id), &[5]);
    }
    let watches = |node_id| bench.device.watches(NodeId::new(node_id).unwrap());
    assert_eq!([1, 2, 3, 127].map(watches), [true, true, false, true]);
    let sent = bench.pass(milliseconds(200));
    assert_eq!(
        sent,
        [
            (30.0, "090#3081110200000000".to_owned()),
            (50.0, "090#3081110100000000".to_owned()),
            (90.0, "090#3081117F00000000".to_owned()),
        ]
    );
    bench.send(0x702, &[5]);
    assert_eq!(bench.read(0x1001, 0), Ok(0x11), "two are still missing");
}

#[test]
fn a_node_is_watched_once() {
    let mut bench = Bench::new();
    bench.write(0x1016, 1, &consumer_time(1, 50)).unwrap();
    let twice = bench.write(0x1016, 2, &consumer_time(1, 60));
    assert_eq!(twice, Err(AbortCode::PARAMETER_INCOMPATIBLE));
    assert_eq!(bench.write(0x1016, 1, &consumer_time(1, 60)), Ok(()));
}

#[test]
fn consumer_is_re_armed_at_once() {
    let mut bench = Bench::new();
    bench.write(0x1016, 1, &consumer_time(1, 1000)).unwrap();
    bench.send(0x701, &[5]);
    bench.pass(milliseconds(100));
    bench.write(0x1016, 1, &consumer_time(1, 20)).unwrap();
    let sent = bench.pass(milliseconds(2000));
    assert_eq!(sent, [(120.0, "090#3081110100000000".to_owned())]);
}

#[test]
fn an_entry_that_is_cleared_ends_its_error() {
    let mut bench = Bench::new();
    bench.write(0x1016, 1, &consumer_time(1, 20)).unwrap();
    bench.send(0x701, &[5]);
    bench.pass(milliseconds(100));
    assert_eq!(bench.read(0x1001, 0), Ok(0x11));
    bench.write(0x1016, 1, &[0; 4]).unwrap();
    assert_eq!(bench.read(0x1001, 0), Ok(0));
}

#[test]
fn error_behaviour_0_goes_to_pre_operational_1_stays_2_stops() {
    for (behaviour, state) in [
        (0, NmtState::PreOperational),
        (1, NmtState::Operational),
        (2, NmtState::Stopped),
    ] {
        let mut bench = Bench::operational();
        bench.write(0x1029, 1, &[behaviour]).unwrap();
        bench.write(0x1016, 1, &consumer_time(1, 50)).unwrap();
        bench.send(0x701, &[5]);
        bench.heard();
        bench.pass(milliseconds(60));
        assert_eq!(bench.device.services().nmt_state(), state);
        let heard = bench.heard();
        assert_eq!(
            heard[0],
            Heard::Loss(loss(1)),
            "the application hears first"
        );
        assert_eq!(heard.len(), if behaviour == 1 { 1 } else { 2 });
    }
}

#[test]
fn error_behaviour_leaves_pre_operational_alone() {
    let mut bench = Bench::new();
    bench.write(0x1029, 1, &[2]).unwrap();
    bench.write(0x1016, 1, &consumer_time(1, 50)).unwrap();
    bench.send(0x701, &[5]);
    bench.pass(milliseconds(60));
    assert_eq!(
        bench.device.services().nmt_state(),
        NmtState::PreOperational
    );
}

#[test]
fn a_watched_node_that_boots_is_lost() {
    let mut bench = Bench::operational();
    bench.write(0x1016, 1, &consumer_time(1, 50)).unwrap();
    bench.send(0x701, &[0]);
    assert!(losses(&mut bench).is_empty(), "its first boot-up is none");
    bench.send(0x701, &[5]);
    bench.send(0x701, &[0]);
    assert_eq!(losses(&mut bench), [Heard::Loss(loss(1))]);
    bench.send(0x701, &[127]);
    assert_eq!(losses(&mut bench), [Heard::Recovery(loss(1))]);
}

/// Makes a device in Operational that expects node 1 within 50 ms.
fn expecting() -> Bench {
    let mut bench = Bench::operational();
    bench.write(0x1016, 1, &consumer_time(1, 50)).unwrap();
    bench.device.services.expect_heartbeats();
    bench.heard();
    bench
}

#[test]
fn a_node_that_is_expected_and_stays_silent_is_lost() {
    let mut bench = expecting();
    let sent = bench.pass(milliseconds(200));
    assert_eq!(sent, [(50.0, "090#3081110100000000".to_owned())]);
    assert_eq!(losses(&mut bench), [Heard::Loss(loss(1))]);
    assert_eq!(bench.send(0x701, &[5]), ["090#0000003081010000"]);
    assert_eq!(losses(&mut bench), [Heard::Recovery(loss(1))]);
}

#[test]
fn a_node_that_is_expected_and_heard_is_watched_as_any_other() {
    let mut bench = expecting();
    bench.pass(milliseconds(40));
    assert!(bench.send(0x701, &[5]).is_empty());
    assert!(bench.pass(milliseconds(40)).is_empty());
    assert!(losses(&mut bench).is_empty());
    bench.send(0x701, &[0]);
    assert_eq!(losses(&mut bench), [Heard::Loss(loss(1))]);
}

#[test]
fn the_boot_up_of_a_node_that_is_expected_is_no_loss_and_begins_the_wait_again() {
    let mut bench = expecting();
    assert!(bench.send(0x701, &[0]).is_empty());
    assert!(losses(&mut bench).is_empty());
    bench.pass(milliseconds(200));
    assert_eq!(losses(&mut bench), [Heard::Loss(loss(1))]);
}

#[test]
fn outside_operational_only_nodes_that_were_heard_are_watched() {
    let mut bench = expecting();
    bench.write(0x1016, 2, &consumer_time(2, 50)).unwrap();
    bench.send(0x702, &[5]);
    bench.send(0, &[128, ID]);
    bench.pass(milliseconds(200));
    assert_eq!(losses(&mut bench), [Heard::Loss(loss(2))]);
}

#[test]
fn a_manager_sees_boot_ups_and_states_of_all_nodes() {
    let mut bench = Bench::new();
    bench.send(0x711, &[0]);
    bench.send(0x711, &[127]);
    bench.send(0x77F, &[5]);
    bench.send(0x711, &[99]);
    bench.send(0x711, &[]);
    assert_eq!(
        bench.heard(),
        [
            Heard::Heartbeat(0x11, NmtState::Initialising),
            Heard::Heartbeat(0x11, NmtState::PreOperational),
            Heard::Heartbeat(0x7F, NmtState::Operational),
        ]
    );
}
