//! Tests of the device behind its SDO servers: rights, limits, rules of the services, decisions of the application.

use super::*;

#[test]
fn aborts_name_missing_object_missing_sub_index_read_only_write_only() {
    let mut bench = Bench::new();
    assert_eq!(bench.read(0x5FFF, 0), Err(AbortCode(0x0602_0000)));
    assert_eq!(bench.read(0x1016, 9), Err(AbortCode(0x0609_0011)));
    assert_eq!(bench.write(0x1000, 0, &[0; 4]), Err(AbortCode(0x0601_0002)));
    assert_eq!(bench.read(0x2302, 0), Err(AbortCode(0x0601_0001)));
}

#[test]
fn aborts_name_too_long_too_short_above_and_below_limit() {
    let mut dictionary = dictionary();
    let (index, rights) = (0x2400, Rights::ReadWrite);
    let mut entry = Entry::new(index, 0, "limited", DataType::Integer16, rights, vec![0, 0]);
    (entry.low_limit, entry.high_limit) = (Some(-5), Some(5));
    dictionary.insert(entry);
    let mut bench = Bench::with(dictionary);
    assert_eq!(bench.write(index, 0, &[0; 4]), Err(AbortCode(0x0607_0012)));
    assert_eq!(bench.write(index, 0, &[0]), Err(AbortCode(0x0607_0013)));
    assert_eq!(bench.write(index, 0, &[6, 0]), Err(AbortCode(0x0609_0031)));
    let below = (-6_i16).to_le_bytes();
    assert_eq!(bench.write(index, 0, &below), Err(AbortCode(0x0609_0032)));
    let good = (-5_i16).to_le_bytes();
    assert_eq!(bench.write(index, 0, &good), Ok(()));
}

#[test]
fn the_application_hears_a_write_and_may_refuse_it() {
    let mut bench = Bench::new();
    assert_eq!(
        bench.write(TARGET, 0, &[0xFF, 0x7F]),
        Err(AbortCode::LOCAL_CONTROL)
    );
    assert_eq!(bench.read(TARGET, 0), Ok(0));
    assert_eq!(bench.write(TARGET, 0, &[5, 0]), Ok(()));
    assert_eq!(bench.read(TARGET, 0), Ok(5));
    assert_eq!(bench.heard().len(), 2);
}

#[test]
fn a_refused_write_never_reaches_the_application() {
    let mut bench = Bench::new();
    assert!(bench.write(0x1000, 0, &[0; 4]).is_err());
    assert!(bench.write(0x1019, 0, &[1]).is_err());
    assert!(bench.heard().is_empty());
}

#[test]
fn store_restore_and_lss_are_absent_and_say_so() {
    let mut bench = Bench::new();
    assert_eq!(bench.read(0x1010, 1), Err(AbortCode::NO_SUCH_OBJECT));
    assert_eq!(bench.read(0x1011, 1), Err(AbortCode::NO_SUCH_OBJECT));
    assert!(bench.send(0x7E5, &[0x04, 1, 0, 0, 0, 0, 0, 0]).is_empty());
}

#[test]
fn a_second_channel_answers_once_its_cob_ids_are_valid() {
    let mut bench = Bench::new();
    let request = [0x40, 0x00, 0x10, 0, 0, 0, 0, 0];
    assert!(bench.send(0x690, &request).is_empty());
    bench.write(0x1201, 1, &0x690_u32.to_le_bytes()).unwrap();
    assert!(bench.send(0x690, &request).is_empty());
    bench.write(0x1201, 2, &0x691_u32.to_le_bytes()).unwrap();
    assert_eq!(bench.send(0x690, &request), ["691#4300100092010200"]);
    assert_eq!(
        bench.write(0x1201, 1, &0x692_u32.to_le_bytes()),
        Err(AbortCode::DEVICE_STATE)
    );
    bench.send(0, &[130, ID]);
    assert!(bench.send(0x690, &request).is_empty());
}

/// Returns a bench whose object 0x2500 takes several segments.
fn bench_with_a_text() -> Bench {
    let mut dictionary = dictionary();
    let (kind, rights) = (DataType::VisibleString, Rights::ReadWrite);
    let text = b"a text of more than seven bytes".to_vec();
    dictionary.insert(Entry::new(0x2500, 0, "text", kind, rights, text));
    Bench::with(dictionary)
}

#[test]
fn channels_serve_two_clients_at_the_same_time() {
    let mut bench = bench_with_a_text();
    bench.write(0x1201, 1, &0x690_u32.to_le_bytes()).unwrap();
    bench.write(0x1201, 2, &0x691_u32.to_le_bytes()).unwrap();
    let start = [0x40, 0x00, 0x25, 0, 0, 0, 0, 0];
    assert_eq!(bench.send(0x610, &start), ["590#410025001F000000"]);
    assert_eq!(bench.send(0x690, &start), ["691#410025001F000000"]);
    let segment = [0x60, 0, 0, 0, 0, 0, 0, 0];
    assert_eq!(
        bench.send(0x610, &segment),
        ["590#00612074657874206F"[..20].to_owned()]
    );
    assert_eq!(
        bench.send(0x690, &segment),
        ["691#00612074657874206F"[..20].to_owned()]
    );
}

#[test]
fn a_half_open_transfer_times_out_by_the_devices_deadline() {
    let mut bench = bench_with_a_text();
    bench.send(0x610, &[0x40, 0x00, 0x25, 0, 0, 0, 0, 0]);
    let sent = bench.pass(Duration::from_secs(2));
    assert_eq!(sent, [(1000.0, "590#8000250000000405".to_owned())]);
}

#[test]
fn stopped_forgets_a_half_open_transfer_in_silence() {
    let mut bench = bench_with_a_text();
    bench.send(0x610, &[0x40, 0x00, 0x25, 0, 0, 0, 0, 0]);
    bench.send(0, &[2, ID]);
    assert!(bench.pass(Duration::from_secs(2)).is_empty());
    bench.send(0, &[128, ID]);
    let segment = bench.send(0x610, &[0x60, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(segment.len(), 1);
    assert!(segment[0].starts_with("590#80"), "no transfer is open");
}
