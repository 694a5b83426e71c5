//! PDOs: configuration, transmission types, reception.

use super::*;

const DISABLED: u32 = 0x8000_0000;

fn u32_bytes(value: u32) -> [u8; 4] {
    value.to_le_bytes()
}

/// Maps an RPDO or TPDO anew by the standard's procedure.
fn remap(bench: &mut Bench, index: u16, cob_id: u32, mapped: &[u32]) -> Result<(), AbortCode> {
    bench.write(index, 1, &u32_bytes(cob_id | DISABLED))?;
    bench.write(index + 0x200, 0, &[0])?;
    for (sub_index, entry) in (1..).zip(mapped) {
        bench.write(index + 0x200, sub_index, &u32_bytes(*entry))?;
    }
    let count = u8::try_from(mapped.len()).unwrap();
    bench.write(index + 0x200, 0, &[count])?;
    bench.write(index, 1, &u32_bytes(cob_id))
}

/// Sends one SYNC a millisecond; returns the numbers of the SYNCs, from 1, at which a frame with this identifier came.
fn syncs_with(bench: &mut Bench, prefix: &str, counters: impl Iterator<Item = u8>) -> Vec<u8> {
    counters
        .filter(|counter| {
            bench.pass(milliseconds(1));
            let sent = bench.send(0x80, &[*counter]);
            sent.iter().any(|frame| frame.starts_with(prefix))
        })
        .collect()
}

#[test]
fn mapping_is_read_from_the_dictionary_at_start() {
    let mut bench = Bench::operational();
    bench.send(0x210, &[0x0F, 0, 0x34, 0x12]);
    let sent = bench.send(0x80, &[1]);
    assert_eq!(
        sent,
        ["190#341200000000"],
        "length of TPDO1 is 6, as mapped"
    );
}

#[test]
fn mapping_is_changed_at_run_time_by_the_full_procedure() {
    let mut bench = Bench::operational();
    assert_eq!(
        remap(&mut bench, 0x1800, 0x4000_0191, &[0x2300_0020, 0x6041_0010]),
        Ok(())
    );
    assert_eq!(remap(&mut bench, 0x1400, 0x215, &[0x6071_0010]), Ok(()));
    bench.send(0x215, &[0x34, 0x12]);
    assert_eq!(bench.send(0x80, &[1]), ["191#000000003412"]);
    bench.send(0x210, &[0, 0, 9, 9]);
    assert_eq!(
        bench.send(0x80, &[2]),
        ["191#000000003412"],
        "0x210 is free"
    );
}

#[test]
fn mapping_needs_bit_31_and_sub_index_0_zero() {
    let mut bench = Bench::new();
    let refused = Err(AbortCode::UNSUPPORTED_ACCESS);
    assert_eq!(bench.write(0x1600, 0, &[0]), refused, "the PDO exists");
    bench
        .write(0x1400, 1, &u32_bytes(0x210 | DISABLED))
        .unwrap();
    assert_eq!(bench.write(0x1600, 1, &u32_bytes(0x6071_0010)), refused);
    bench.write(0x1600, 0, &[0]).unwrap();
    assert_eq!(bench.write(0x1600, 1, &u32_bytes(0x6071_0010)), Ok(()));
}

#[test]
fn more_than_8_objects_or_64_bits_are_refused_and_the_next_frame_does_no_harm() {
    let mut bench = Bench::operational();
    bench
        .write(0x1400, 1, &u32_bytes(0x210 | DISABLED))
        .unwrap();
    bench.write(0x1600, 0, &[0]).unwrap();
    for sub_index in 1..=8 {
        bench
            .write(0x1600, sub_index, &u32_bytes(0x2301_0020))
            .unwrap();
    }
    let refused = Err(AbortCode::PDO_TOO_LONG);
    for count in [3, 8, 9, 64, 254, 255] {
        assert_eq!(bench.write(0x1600, 0, &[count]), refused, "{count}");
    }
    assert_eq!(bench.write(0x1600, 0, &[2]), Ok(()));
    bench.write(0x1400, 1, &u32_bytes(0x210)).unwrap();
    bench.send(0x210, &[1, 0, 0, 0, 2, 0, 0, 0]);
    bench.send(0x80, &[1]);
    assert_eq!(bench.read(0x2301, 0), Ok(2));
}

#[test]
fn objects_that_cannot_be_mapped_are_refused() {
    let mut bench = Bench::new();
    bench
        .write(0x1400, 1, &u32_bytes(0x210 | DISABLED))
        .unwrap();
    bench.write(0x1600, 0, &[0]).unwrap();
    bench.write(0x1800, 1, &u32_bytes(0xC000_0190)).unwrap();
    bench.write(0x1A00, 0, &[0]).unwrap();
    for (index, entry, code) in [
        (0x1600, 0x5FFF_0010, 0x0602_0000), // no such object
        (0x1600, 0x6071_0110, 0x0609_0011), // no such sub-index
        (0x1600, 0x1017_0010, 0x0604_0041), // not mappable
        (0x1600, 0x6071_0008, 0x0604_0041), // another length
        (0x1600, 0x6071_0011, 0x0604_0041), // not in whole bytes
        (0x1600, 0x6041_0010, 0x0604_0041), // read only into an RPDO
        (0x1A00, 0x2302_0020, 0x0604_0041), // write only into a TPDO
    ] {
        let result = bench.write(index, 1, &u32_bytes(entry));
        assert_eq!(result, Err(AbortCode(code)), "{entry:#010x}");
    }
}

#[test]
fn dummies_skip_bytes_of_an_rpdo() {
    let mut bench = Bench::operational();
    remap(
        &mut bench,
        0x1400,
        0x210,
        &[0x0006_0010, 0x0002_0008, 0x6071_0010],
    )
    .unwrap();
    bench.send(0x210, &[1, 2, 3, 4, 0]);
    bench.send(0x80, &[1]);
    assert_eq!(bench.read(TARGET, 0), Ok(4));
}

#[test]
fn transmission_types_241_to_251_are_refused() {
    let mut bench = Bench::new();
    for kind in 0..=255_u8 {
        let for_tpdo = bench.write(0x1800, 2, &[kind]).is_ok();
        let for_rpdo = bench.write(0x1400, 2, &[kind]).is_ok();
        assert_eq!(for_tpdo, !(241..=251).contains(&kind), "TPDO {kind}");
        assert_eq!(for_rpdo, !(241..=253).contains(&kind), "RPDO {kind}");
    }
}

#[test]
fn cob_id_rules() {
    let mut bench = Bench::new();
    let invalid = Err(AbortCode::INVALID_VALUE);
    assert_eq!(bench.write(0x1400, 1, &u32_bytes(0x211)), invalid, "exists");
    for restricted in [0x000, 0x07F, 0x180, 0x581, 0x601, 0x701, 0x2000_0210] {
        let value = u32_bytes(restricted | DISABLED);
        assert_eq!(bench.write(0x1400, 1, &value), invalid, "{restricted:#x}");
    }
    bench
        .write(0x1400, 1, &u32_bytes(0x210 | DISABLED))
        .unwrap();
    assert_eq!(bench.write(0x1400, 1, &u32_bytes(0x211)), Ok(()));
}

#[test]
fn inhibit_time_and_sync_start_need_a_destroyed_pdo() {
    let mut bench = Bench::new();
    let refused = Err(AbortCode::DEVICE_STATE);
    assert_eq!(bench.write(0x1800, 3, &[1, 0]), refused);
    assert_eq!(bench.write(0x1800, 6, &[1]), refused);
    bench.write(0x1800, 1, &u32_bytes(0xC000_0190)).unwrap();
    assert_eq!(bench.write(0x1800, 3, &[1, 0]), Ok(()));
    assert_eq!(bench.write(0x1800, 6, &[240]), Ok(()));
    assert_eq!(
        bench.write(0x1800, 6, &[241]),
        Err(AbortCode::INVALID_VALUE)
    );
}

#[test]
fn type_10_sends_on_every_10th_sync() {
    let mut bench = Bench::operational();
    bench.write(0x1800, 2, &[10]).unwrap();
    assert_eq!(syncs_with(&mut bench, "190", 1..=40), [10, 20, 30, 40]);
}

#[test]
fn the_application_is_asked_for_fresh_values_only_where_a_tpdo_is_packed() {
    let mut bench = Bench::operational();
    bench
        .write(0x1801, 1, &u32_bytes(0x290 | DISABLED))
        .unwrap();
    bench.write(0x1800, 2, &[10]).unwrap();
    bench.device.application.samplings = Some(0);
    let mut sent = Vec::new();
    for counter in 1..=20 {
        sent.extend(bench.send(0x80, &[counter]));
        let samplings = bench.device.application.samplings;
        assert_eq!(samplings, Some((counter / 10).into()));
    }
    // The values are of this SYNC.
    assert_eq!(sent, ["190#000001000000", "190#000002000000"]);
}

#[test]
fn type_10_keeps_its_phase_when_syncs_are_lost() {
    let mut bench = Bench::operational();
    bench.write(0x1800, 2, &[10]).unwrap();
    let heard = (1..=40).filter(|counter| ![4, 5, 20].contains(counter));
    assert_eq!(
        syncs_with(&mut bench, "190", heard),
        [10, 21, 30, 40],
        "a missed turn is made up for"
    );
}

#[test]
fn type_10_goes_on_over_the_counters_overflow() {
    let mut bench = Bench::operational();
    bench.write(0x1800, 2, &[10]).unwrap();
    let counters = (226..=240).chain(1..=15);
    assert_eq!(syncs_with(&mut bench, "190", counters), [235, 5, 15]);
    let with_losses = (16..=238).chain(3..=20);
    let sent = syncs_with(&mut bench, "190", with_losses);
    assert_eq!(sent[sent.len() - 3..], [235, 5, 15]);
}

#[test]
fn type_10_counts_each_sync_whose_counter_shows_nothing() {
    let odd = [[7, 7], [0, 0], [250, 250], [0, 7], [250, 7]];
    for counters in odd {
        let mut bench = Bench::operational();
        bench.write(0x1800, 2, &[10]).unwrap();
        let sent = (1..=40).filter(|number| {
            let answers = bench.send(0x80, &[counters[number % 2]]);
            answers.iter().any(|frame| frame.starts_with("190"))
        });
        assert_eq!(sent.collect::<Vec<_>>(), [10, 20, 30, 40], "{counters:?}");
    }
}

#[test]
fn sync_start_value_sets_the_phase() {
    let mut bench = Bench::new();
    bench.write(0x1800, 1, &u32_bytes(0xC000_0190)).unwrap();
    bench.write(0x1800, 6, &[3]).unwrap();
    bench.write(0x1800, 2, &[10]).unwrap();
    bench.write(0x1800, 1, &u32_bytes(0x4000_0190)).unwrap();
    bench.send(0, &[1, ID]);
    assert_eq!(syncs_with(&mut bench, "190", 1..=30), [3, 13, 23]);
}

#[test]
fn type_0_sends_at_the_sync_after_an_event_only() {
    let mut bench = Bench::operational();
    bench.write(0x1800, 2, &[0]).unwrap();
    assert!(bench.send(0x80, &[1]).is_empty());
    bench.device.services_mut().request_tpdo(1);
    assert!(bench.drain().is_empty());
    assert_eq!(bench.send(0x80, &[2]).len(), 1);
    assert!(bench.send(0x80, &[3]).is_empty());
}

#[test]
fn type_255_sends_on_entering_operational_and_on_request() {
    let mut bench = Bench::new();
    bench.write(0x1801, 1, &u32_bytes(0x4000_0290)).unwrap();
    bench.device.services_mut().request_tpdo(2);
    assert!(bench.drain().is_empty(), "not operational");
    bench.send(0, &[1, ID]);
    assert_eq!(bench.tick(), ["290#00000000"]);
    assert!(bench.tick().is_empty());
    bench.device.services_mut().request_tpdo(2);
    assert_eq!(bench.drain(), ["290#00000000"]);
}

#[test]
fn event_timer_sends_at_its_period() {
    let mut bench = Bench::new();
    bench.write(0x1801, 5, &[10, 0]).unwrap();
    bench.write(0x1801, 1, &u32_bytes(0x4000_0290)).unwrap();
    bench.send(0, &[1, ID]);
    let sent = bench.pass(milliseconds(35));
    let times: Vec<f64> = sent.iter().map(|(time, _)| *time).collect();
    assert_eq!(times, [0.0, 10.0, 20.0, 30.0]);
}

#[test]
fn inhibit_time_is_in_units_of_100_microseconds() {
    let mut bench = Bench::new();
    bench.write(0x1801, 3, &[25, 0]).unwrap();
    bench.write(0x1801, 1, &u32_bytes(0x4000_0290)).unwrap();
    bench.send(0, &[1, ID]);
    assert_eq!(bench.pass(Duration::ZERO).len(), 1);
    bench.device.services_mut().request_tpdo(2);
    bench.device.services_mut().request_tpdo(2);
    assert!(bench.drain().is_empty());
    let sent = bench.pass(milliseconds(10));
    assert_eq!(sent, [(2.5, "290#00000000".to_owned())], "one, not two");
}

#[test]
fn type_252_samples_at_sync_and_253_at_the_remote_frame() {
    let mut bench = Bench::new();
    let remote = |id| CanFrame::from_raw(id | REMOTE_FLAG, 0, [0; 8]).unwrap();
    assert!(
        bench.send_frame(&remote(0x190)).is_empty(),
        "bit 30 forbids"
    );
    bench.write(0x1800, 1, &u32_bytes(0xC000_0190)).unwrap();
    bench.write(0x1800, 2, &[252]).unwrap();
    bench.write(0x1800, 1, &u32_bytes(0x0000_0190)).unwrap();
    bench.send(0, &[1, ID]);
    assert!(bench.send_frame(&remote(0x190)).is_empty(), "no SYNC yet");
    assert!(bench.send(0x80, &[1]).is_empty());
    assert_eq!(bench.send_frame(&remote(0x190)), ["190#000000000000"]);
    bench.write(TARGET, 0, &[7, 0]).unwrap();
    assert_eq!(bench.send_frame(&remote(0x190)), ["190#000000000000"]);
    bench.send(0x80, &[2]);
    assert_eq!(bench.send_frame(&remote(0x190)), ["190#070000000000"]);
    bench.write(0x1800, 2, &[253]).unwrap();
    assert_eq!(bench.send_frame(&remote(0x190)), ["190#070000000000"]);
    let dictionary = bench.device.services_mut().dictionary_mut();
    dictionary.set_integer(STATUSWORD, 0, 8).unwrap();
    assert_eq!(bench.send_frame(&remote(0x190)), ["190#080000000000"]);
    assert!(bench.send_frame(&remote(0x290)).is_empty(), "forbidden");
    bench.send(0, &[128, ID]);
    assert!(
        bench.send_frame(&remote(0x190)).is_empty(),
        "not Operational"
    );
}

#[test]
fn synchronous_rpdo_takes_effect_at_the_next_sync_and_the_tpdo_of_that_sync_shows_it() {
    let mut bench = Bench::operational();
    bench.send(0x210, &[0x0F, 0, 9, 0]);
    assert_eq!(bench.read(TARGET, 0), Ok(0), "not on arrival");
    assert_eq!(bench.send(0x80, &[1]), ["190#090000000000"]);
    assert_eq!(
        bench.heard(),
        [
            Heard::Waiting(1, 0x0F, 0),
            Heard::Rpdo(1, 9),
            Heard::Sync(Some(1), 9)
        ]
    );
}

#[test]
fn the_application_hears_of_a_waiting_controlword_before_it_is_valid() {
    let mut bench = Bench::operational();
    bench.send(0x210, &[0x02, 0, 0, 0]);
    assert_eq!(bench.heard(), [Heard::Waiting(1, 0x02, 0)]);
}

#[test]
fn the_last_of_two_synchronous_rpdos_before_a_sync_counts() {
    let mut bench = Bench::operational();
    bench.send(0x210, &[0, 0, 1, 0]);
    bench.send(0x210, &[0, 0, 2, 0]);
    assert_eq!(bench.send(0x80, &[1]), ["190#020000000000"]);
}

#[test]
fn event_driven_rpdo_takes_effect_on_arrival() {
    let mut bench = Bench::operational();
    bench.send(0x310, &[5, 0, 0, 0]);
    assert_eq!(bench.heard(), [Heard::Rpdo(2, 0)]);
    assert_eq!(bench.read(0x2301, 0), Ok(5));
}

#[test]
fn pdos_work_in_operational_only_and_what_waited_is_dropped() {
    let mut bench = Bench::new();
    bench.send(0x310, &[5, 0, 0, 0]);
    assert_eq!(bench.read(0x2301, 0), Ok(0));
    assert!(bench.send(0x80, &[1]).is_empty());
    bench.send(0, &[1, ID]);
    bench.send(0x210, &[0, 0, 9, 0]);
    bench.send(0, &[128, ID]);
    bench.send(0, &[1, ID]);
    assert_eq!(bench.send(0x80, &[2]), ["190#000000000000"]);
}

#[test]
fn short_pdo_is_ignored_with_emcy_8210_until_a_good_one_comes() {
    let mut bench = Bench::operational();
    assert_eq!(bench.send(0x210, &[1, 0, 1]), ["090#1082110100000000"]);
    assert!(bench.send(0x210, &[1]).is_empty(), "sent once");
    assert_eq!(bench.send(0x80, &[1]), ["190#000000000000"]);
    assert_eq!(bench.send(0x210, &[1, 0, 1, 0]), ["090#0000001082010000"]);
}

#[test]
fn long_pdo_is_used_with_emcy_8220() {
    let mut bench = Bench::operational();
    assert_eq!(
        bench.send(0x310, &[5, 0, 0, 0, 9]),
        ["090#2082110200000000"]
    );
    assert_eq!(bench.read(0x2301, 0), Ok(5));
    assert_eq!(bench.send(0x310, &[6, 0, 0, 0]), ["090#0000002082020000"]);
}

#[test]
fn rpdo_deadline_raises_emcy_8250_once_and_informs_the_application() {
    let mut bench = Bench::operational();
    bench.write(0x1400, 5, &[5, 0]).unwrap();
    assert!(
        bench.pass(milliseconds(50)).is_empty(),
        "armed by the first"
    );
    bench.send(0x210, &[0; 4]);
    bench.heard();
    let sent = bench.pass(milliseconds(50));
    assert_eq!(sent, [(55.0, "090#5082110100000000".to_owned())]);
    let loss = CommunicationLoss::Rpdo(1);
    assert_eq!(bench.heard(), [Heard::Loss(loss)]);
    assert_eq!(bench.send(0x210, &[0; 4]), ["090#0000005082010000"]);
    assert_eq!(bench.heard()[0], Heard::Recovery(loss));
}

#[test]
fn an_invalid_default_mapping_is_an_error_with_its_place() {
    let mut dictionary = dictionary();
    add_pdo(&mut dictionary, 0x1802, 0x4000_0390, 1, &[0x7777_0010]);
    let device = Device::new(NodeId::new(ID).unwrap(), dictionary, Listener::default());
    let error = device.err().unwrap();
    assert_eq!(
        (error.index, error.reason),
        (0x1802, AbortCode::NO_SUCH_OBJECT)
    );
}

#[test]
fn identifiers_in_use_are_refused_until_they_are_free() {
    let mut bench = Bench::new();
    bench.write(0x1201, 1, &u32_bytes(0x690)).unwrap();
    bench.write(0x1201, 2, &u32_bytes(0x6D0)).unwrap();
    for (index, sub_index, id_in_use) in [
        (0x1400, 1, 0x210),
        (0x1401, 1, 0x310),
        (0x1800, 1, 0x190),
        (0x1801, 1, 0x290),
        (0x1014, 0, 0x090),
        (0x1201, 1, 0x690),
    ] {
        bench
            .write(index, sub_index, &u32_bytes(id_in_use | DISABLED))
            .unwrap();
        let used = [0x080, 0x090, 0x210, 0x310, 0x190, 0x690, 0x6D0];
        for id in used.into_iter().filter(|id| *id != id_in_use) {
            let at = format!("{id:#x} into {index:#06x}");
            assert_eq!(
                bench.write(index, sub_index, &u32_bytes(id)),
                Err(AbortCode::INVALID_VALUE),
                "{at}"
            );
            let disabled = bench.write(index, sub_index, &u32_bytes(id | DISABLED));
            assert_eq!(disabled, Ok(()), "{at}: out of use it harms nobody");
        }
        bench
            .write(index, sub_index, &u32_bytes(id_in_use))
            .unwrap();
    }
    for id in [0x090, 0x210, 0x190, 0x690] {
        let refused = bench.write(0x1005, 0, &u32_bytes(id));
        assert_eq!(refused, Err(AbortCode::INVALID_VALUE), "SYNC as {id:#x}");
    }
    bench
        .write(0x1400, 1, &u32_bytes(0x210 | DISABLED))
        .unwrap();
    assert_eq!(bench.write(0x1005, 0, &u32_bytes(0x210)), Ok(()));
}

/// The events of types 0, 254 and 255 (CiA 301, 7.5.2.37) are changes of mapped values.
#[test]
fn a_changed_value_is_the_event_of_types_254_and_255() {
    for kind in [254, 255] {
        let mut bench = Bench::new();
        bench.write(0x1801, 2, &[kind]).unwrap();
        bench.write(0x1801, 1, &u32_bytes(0x4000_0290)).unwrap();
        bench.send(0, &[1, ID]);
        assert_eq!(bench.tick(), ["290#00000000"]);
        // By RPDO2, by SDO, by the application; the same value again is no event.
        bench.send(0x310, &[5, 0, 0, 0]);
        assert_eq!(bench.pass(Duration::ZERO).len(), 1);
        bench.send(0x310, &[5, 0, 0, 0]);
        assert!(bench.pass(milliseconds(1)).is_empty());
        bench.write(0x2301, 0, &[6, 0, 0, 0]).unwrap();
        let sent = bench.pass(Duration::ZERO);
        assert_eq!(sent, [(1.0, "290#06000000".to_owned())]);
        let dictionary = bench.device.services_mut().dictionary_mut();
        dictionary.set_integer(0x2301, 0, 7).unwrap();
        assert_eq!(bench.tick(), ["290#07000000"]);
        bench.send(0, &[128, ID]);
        bench.write(0x2301, 0, &[8, 0, 0, 0]).unwrap();
        assert!(bench.pass(milliseconds(1)).is_empty(), "not Operational");
    }
}

#[test]
fn changes_within_the_inhibit_time_leave_together_at_its_end() {
    let mut bench = Bench::new();
    bench.write(0x1801, 3, &[25, 0]).unwrap();
    bench.write(0x1801, 1, &u32_bytes(0x4000_0290)).unwrap();
    bench.send(0, &[1, ID]);
    assert_eq!(bench.pass(Duration::ZERO).len(), 1);
    bench.write(0x2301, 0, &[1, 0, 0, 0]).unwrap();
    bench.write(0x2301, 0, &[2, 0, 0, 0]).unwrap();
    let sent = bench.pass(milliseconds(10));
    assert_eq!(sent, [(2.5, "290#02000000".to_owned())]);
}

#[test]
fn a_changed_value_makes_type_0_send_at_the_next_sync() {
    let mut bench = Bench::operational();
    bench.write(0x1800, 2, &[0]).unwrap();
    assert!(bench.send(0x80, &[1]).is_empty());
    bench.send(0x210, &[0, 0, 9, 0]);
    assert!(bench.pass(milliseconds(1)).is_empty(), "not before a SYNC");
    assert_eq!(bench.send(0x80, &[2]), ["190#090000000000"]);
    assert!(bench.send(0x80, &[3]).is_empty());
}

#[test]
fn an_rpdo_is_not_silent_where_a_change_may_be_sent_at_once() {
    let mut bench = Bench::operational();
    assert!(bench.device.takes_silently(0x210));
    bench.write(0x1800, 2, &[255]).unwrap();
    assert!(!bench.device.takes_silently(0x210));
}

/// A PDO cannot be refused as an SDO can, so its values are cut to the limits of the EDS.
#[test]
fn an_rpdos_value_beyond_its_objects_limits_is_cut_to_them() {
    let mut dictionary = dictionary();
    for (index, low, high) in [(TARGET, -1000, 1000), (0x2301, -70_000, 70_000)] {
        let mut entry = dictionary.entry(dictionary.find(index, 0).unwrap()).clone();
        (entry.low_limit, entry.high_limit) = (Some(low), Some(high));
        dictionary.insert(entry);
    }
    let mut bench = Bench::with(dictionary);
    bench.send(0, &[1, ID]);
    for (target, expected) in [
        (32_000_i16, 1000),
        (1000, 1000),
        (-32_000, -1000),
        (-999, -999),
    ] {
        let [low, high] = target.to_le_bytes();
        bench.send(0x210, &[0x0F, 0, low, high]);
        bench.send(0x80, &[1]);
        let stored = bench.device.services.dictionary.integer(TARGET, 0);
        assert_eq!(stored, Some(expected), "{target}");
        let is_cut = bench.device.services.is_rpdo_cut(1);
        assert_eq!(is_cut, i128::from(target) != expected);
    }
    for (value, expected) in [(i32::MAX, 70_000), (i32::MIN, -70_000), (-3, -3)] {
        bench.send(0x310, &value.to_le_bytes());
        let stored = bench.device.services.dictionary.integer(0x2301, 0);
        assert_eq!(stored, Some(expected));
    }
    assert_eq!(bench.read(CONTROLWORD, 0), Ok(0x0F), "the rest is taken");
}
