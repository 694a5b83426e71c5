//! SYNC consumer and producer.

use super::*;

/// Writes 0x1006 in microseconds.
fn set_period(bench: &mut Bench, microseconds: u32) {
    bench.write(0x1006, 0, &microseconds.to_le_bytes()).unwrap();
}

/// Makes the device a producer.
fn producer(microseconds: u32) -> Bench {
    let mut bench = Bench::new();
    set_period(&mut bench, microseconds);
    bench
        .write(0x1005, 0, &0x4000_0080_u32.to_le_bytes())
        .unwrap();
    bench
}

fn times(sent: &[(f64, String)]) -> Vec<f64> {
    sent.iter().map(|(time, _)| *time).collect()
}

#[test]
fn counter_overflow_is_writable_only_while_the_period_is_0() {
    let mut bench = Bench::new();
    assert_eq!(bench.write(0x1019, 0, &[10]), Ok(()));
    set_period(&mut bench, 1000);
    assert_eq!(bench.write(0x1019, 0, &[20]), Err(AbortCode(0x0800_0022)));
}

#[test]
fn counter_overflow_1_and_above_240_are_refused() {
    let mut bench = Bench::new();
    for value in 0..=255_u8 {
        let is_good = value == 0 || (2..=240).contains(&value);
        assert_eq!(bench.write(0x1019, 0, &[value]).is_ok(), is_good, "{value}");
    }
    assert_eq!(bench.write(0x1019, 0, &[1]), Err(AbortCode::INVALID_VALUE));
}

#[test]
fn wrong_length_raises_emcy_8240_and_is_no_sync() {
    let mut bench = Bench::operational();
    assert_eq!(bench.send(0x80, &[1, 2]), ["090#4082110000000000"]);
    assert!(bench.heard().is_empty());
    let sent = bench.send(0x80, &[1]);
    assert_eq!(sent, ["190#000000000000", "090#0000004082000000"]);
}

#[test]
fn a_counter_without_0x1019_is_a_wrong_length() {
    let mut bench = Bench::new();
    bench.write(0x1019, 0, &[0]).unwrap();
    bench.heard();
    assert_eq!(bench.send(0x80, &[1]), ["090#4082110000000000"]);
    assert!(bench.heard().is_empty());
}

#[test]
fn empty_syncs_are_accepted() {
    let mut bench = Bench::operational();
    assert_eq!(bench.send(0x80, &[]), ["190#000000000000"]);
    assert_eq!(bench.heard(), [Heard::Sync(None, 0)]);
}

#[test]
fn an_emcy_identifier_is_never_taken_for_a_sync() {
    let mut bench = Bench::operational();
    for node in 1..=127 {
        assert!(bench.send(0x80 + node, &[1]).is_empty());
        bench.send(0x80 + node, &[0x30, 0x81, 0x11, 0, 0, 0, 0, 0]);
    }
    let heard = bench.heard();
    assert_eq!(heard.len(), 127);
    assert!(
        heard
            .iter()
            .all(|heard| matches!(heard, Heard::Emergency(_, ErrorCode(0x8130))))
    );
}

#[test]
fn sync_is_heard_in_pre_operational_and_not_in_stopped() {
    let mut bench = Bench::new();
    bench.send(0x80, &[1]);
    assert_eq!(bench.heard(), [Heard::Sync(Some(1), 0)]);
    bench.send(0, &[2, ID]);
    bench.heard();
    bench.send(0x80, &[2]);
    assert!(bench.heard().is_empty());
}

#[test]
fn another_cob_id_is_obeyed() {
    let mut bench = Bench::new();
    bench.write(0x1005, 0, &0xA0_u32.to_le_bytes()).unwrap();
    bench.heard();
    bench.send(0x80, &[1]);
    bench.send(0xA0, &[1]);
    assert_eq!(bench.heard(), [Heard::Frame(0x80), Heard::Sync(Some(1), 0)]);
    let refused = bench.write(0x1005, 0, &0x601_u32.to_le_bytes());
    assert_eq!(refused, Err(AbortCode::INVALID_VALUE));
}

#[test]
fn time_out_comes_after_one_and_a_half_periods_and_is_reported_once() {
    let mut bench = Bench::operational();
    set_period(&mut bench, 1000);
    assert!(
        bench.pass(milliseconds(10)).is_empty(),
        "armed by the first SYNC"
    );
    bench.send(0x80, &[1]);
    bench.heard();
    let sent = bench.pass(milliseconds(10));
    assert_eq!(sent, [(11.5, "090#0081110000000000".to_owned())]);
    assert_eq!(bench.heard(), [Heard::Loss(CommunicationLoss::Sync)]);
    assert_eq!(bench.device.services().nmt_state(), NmtState::Operational);
    assert_eq!(bench.send(0x80, &[2])[1], "090#0000000081000000");
    assert!(
        bench
            .heard()
            .contains(&Heard::Recovery(CommunicationLoss::Sync))
    );
}

#[test]
fn the_application_may_tolerate_more_missing_syncs() {
    let mut bench = Bench::operational();
    let services = bench.device.services_mut();
    services.set_sync_timeout_min(milliseconds(10));
    set_period(&mut bench, 1000);
    bench.send(0x80, &[1]);
    assert_eq!(times(&bench.pass(milliseconds(20))), [10.5]);
}

#[test]
fn a_shortest_time_out_needs_no_period() {
    let mut bench = Bench::operational();
    bench.send(0x80, &[1]);
    assert!(bench.pass(milliseconds(20)).is_empty());
    let services = bench.device.services_mut();
    services.set_sync_timeout_min(milliseconds(10));
    assert!(bench.pass(milliseconds(20)).is_empty());
    bench.send(0x80, &[2]);
    assert_eq!(times(&bench.pass(milliseconds(20))), [50.0]);
}

#[test]
fn stopped_ends_the_time_out() {
    let mut bench = Bench::operational();
    set_period(&mut bench, 1000);
    bench.send(0x80, &[1]);
    bench.send(0, &[2, ID]);
    bench.heard();
    bench.pass(milliseconds(20));
    assert!(bench.heard().is_empty());
}

#[test]
fn an_rpdo_after_the_window_is_ignored() {
    let mut bench = Bench::operational();
    bench.write(0x1007, 0, &500_u32.to_le_bytes()).unwrap();
    bench.send(0x80, &[1]);
    bench.pass(Duration::from_micros(500));
    bench.send(0x210, &[0, 0, 1, 0]);
    bench.pass(Duration::from_micros(1));
    bench.send(0x210, &[0, 0, 2, 0]);
    assert_eq!(bench.send(0x80, &[2]), ["190#010000000000"]);
}

#[test]
fn the_producer_starts_with_bit_30_and_stops_without() {
    let mut bench = Bench::new();
    set_period(&mut bench, 1000);
    assert!(bench.pass(milliseconds(5)).is_empty());
    bench
        .write(0x1005, 0, &0x4000_0080_u32.to_le_bytes())
        .unwrap();
    assert_eq!(times(&bench.pass(milliseconds(3))), [6.0, 7.0, 8.0]);
    let moved = bench.write(0x1005, 0, &0x4000_0081_u32.to_le_bytes());
    assert_eq!(moved, Err(AbortCode::DEVICE_STATE));
    bench.write(0x1005, 0, &0x80_u32.to_le_bytes()).unwrap();
    assert!(bench.pass(milliseconds(5)).is_empty());
}

#[test]
fn the_counter_runs_from_1_to_overflow() {
    let mut bench = Bench::new();
    bench.write(0x1019, 0, &[3]).unwrap();
    set_period(&mut bench, 1000);
    bench
        .write(0x1005, 0, &0x4000_0080_u32.to_le_bytes())
        .unwrap();
    let sent = bench.pass(milliseconds(5));
    let frames: Vec<&str> = sent.iter().map(|(_, frame)| frame.as_str()).collect();
    assert_eq!(frames, ["080#01", "080#02", "080#03", "080#01", "080#02"]);
}

#[test]
fn without_overflow_the_syncs_are_empty() {
    let mut bench = Bench::new();
    bench.write(0x1019, 0, &[0]).unwrap();
    set_period(&mut bench, 1000);
    bench
        .write(0x1005, 0, &0x4000_0080_u32.to_le_bytes())
        .unwrap();
    assert_eq!(bench.pass(milliseconds(1)), [(1.0, "080#".to_owned())]);
}

#[test]
fn leaving_stopped_restarts_the_counter_at_1() {
    let mut bench = producer(1000);
    assert_eq!(bench.pass(milliseconds(3)).last().unwrap().1, "080#03");
    bench.send(0, &[2, ID]);
    assert!(bench.pass(milliseconds(3)).is_empty());
    bench.send(0, &[128, ID]);
    assert_eq!(bench.pass(milliseconds(1)), [(7.0, "080#01".to_owned())]);
}

#[test]
fn the_period_never_drifts_however_late_the_ticks_are() {
    let mut bench = producer(1000);
    for cycle in 1..=1000_u64 {
        bench.now = milliseconds(cycle) + Duration::from_micros(cycle * 37 % 900);
        assert_eq!(bench.tick().len(), 1);
        assert_eq!(bench.device.next_deadline(), Some(milliseconds(cycle + 1)));
    }
    assert_eq!(bench.device.services().sync_overruns(), 0);
}

#[test]
fn overruns_are_skipped_and_counted_not_stretched() {
    let mut bench = producer(1000);
    bench.now = Duration::from_micros(4_300);
    assert_eq!(bench.tick(), ["080#01"], "one SYNC, not four");
    assert_eq!(bench.device.services().sync_overruns(), 3);
    assert_eq!(bench.device.next_deadline(), Some(milliseconds(5)));
    bench.now = milliseconds(5);
    assert_eq!(bench.tick(), ["080#02"]);
}

#[test]
fn the_sync_of_a_producer_drives_its_application_and_its_tpdos() {
    let mut bench = producer(1000);
    bench.write(0x1800, 2, &[10]).unwrap();
    bench.send(0, &[1, ID]);
    bench.heard();
    let sent = bench.pass(milliseconds(20));
    let with_tpdo: Vec<&(f64, String)> = sent
        .iter()
        .filter(|(_, frame)| frame.starts_with("190"))
        .collect();
    assert_eq!(with_tpdo.len(), 2);
    assert_eq!(with_tpdo[0].0, 10.0);
    assert_eq!(sent[9].1, "080#0A", "SYNC goes first");
    assert_eq!(bench.heard().len(), 20);
    assert!(bench.send(0x80, &[1]).is_empty(), "no second master");
    assert_eq!(bench.heard(), [Heard::Frame(0x80)]);
}
