//! Tests of EMCY, error register, history, and reports of the CAN controller.

use super::*;
use can::frame::ERROR_FLAG;

fn raise(bench: &mut Bench, code: u16) -> Vec<String> {
    let services = bench.device.services_mut();
    services.raise_error(ErrorCode(code), [1, 2, 3, 4, 5]);
    bench.drain()
}

/// Returns a kernel error message of a class, with the controller's byte.
fn error_message(class: u32, controller: u8) -> CanFrame {
    CanFrame::from_raw(ERROR_FLAG | class, 8, [0, controller, 0, 0, 0, 0, 0, 0]).unwrap()
}

#[test]
fn message_is_little_endian_with_register_and_manufacturer_bytes() {
    let mut bench = Bench::new();
    assert_eq!(raise(&mut bench, 0x4210), ["090#1042090102030405"]);
    assert!(raise(&mut bench, 0x4210).is_empty(), "sent once");
}

#[test]
fn encode_and_decode_agree() {
    let message = EmergencyMessage {
        code: ErrorCode(0x8130),
        register: 0x11,
        manufacturer: [1, 2, 3, 4, 5],
    };
    assert_eq!(message.encode(), [0x30, 0x81, 0x11, 1, 2, 3, 4, 5]);
    assert_eq!(EmergencyMessage::decode(&message.encode()), Some(message));
    assert_eq!(EmergencyMessage::decode(&[0; 7]), None);
}

#[test]
fn register_shows_what_is_active_and_no_error_what_remains() {
    let mut bench = Bench::new();
    raise(&mut bench, 0x4210);
    raise(&mut bench, 0x2310);
    assert_eq!(bench.read(0x1001, 0), Ok(0x0B));
    bench.device.services_mut().clear_error(ErrorCode(0x4210));
    assert_eq!(bench.drain(), ["090#0000031042000000"]);
    bench.device.services_mut().clear_error(ErrorCode(0x2310));
    assert_eq!(bench.drain(), ["090#0000001023000000"]);
    assert_eq!(bench.read(0x1001, 0), Ok(0));
    bench.device.services_mut().clear_error(ErrorCode(0x2310));
    assert!(bench.drain().is_empty(), "cleared once");
}

#[test]
fn history_keeps_the_newest_first_and_603f_follows_the_last() {
    let mut bench = Bench::new();
    assert_eq!(bench.read(0x1003, 0), Ok(0));
    assert_eq!(bench.read(0x1003, 1), Err(AbortCode::NO_DATA));
    for code in [0x1000, 0x2310, 0x3210, 0x4210, 0x8130] {
        raise(&mut bench, code);
        assert_eq!(bench.read(0x603F, 0), Ok(code.into()));
    }
    assert_eq!(bench.read(0x1003, 0), Ok(4));
    assert_eq!(bench.read(0x1003, 1), Ok(0x0201_8130));
    assert_eq!(bench.read(0x1003, 4), Ok(0x0201_2310));
    assert_eq!(bench.read(0x1003, 5), Err(AbortCode::NO_SUCH_SUB_INDEX));
}

#[test]
fn history_is_writable_with_0_only() {
    let mut bench = Bench::new();
    raise(&mut bench, 0x4210);
    assert_eq!(bench.write(0x1003, 0, &[1]), Err(AbortCode(0x0609_0030)));
    assert_eq!(bench.write(0x1003, 1, &[0; 4]), Err(AbortCode::READ_ONLY));
    assert_eq!(bench.write(0x1003, 0, &[0]), Ok(()));
    assert_eq!(bench.read(0x1003, 0), Ok(0));
    assert_eq!(bench.read(0x1003, 1), Err(AbortCode::NO_DATA));
    assert_eq!(bench.read(0x1001, 0), Ok(9), "the error itself remains");
}

#[test]
fn cob_id_0x1014_is_obeyed() {
    let mut bench = Bench::new();
    let moved = bench.write(0x1014, 0, &0xA5_u32.to_le_bytes());
    assert_eq!(moved, Err(AbortCode::DEVICE_STATE), "the EMCY exists");
    bench
        .write(0x1014, 0, &0x8000_0090_u32.to_le_bytes())
        .unwrap();
    assert!(raise(&mut bench, 0x1000).is_empty());
    bench.write(0x1014, 0, &0xA5_u32.to_le_bytes()).unwrap();
    assert_eq!(bench.drain(), [""; 0], "taken by the write's answer");
    assert_eq!(raise(&mut bench, 0x2310), ["0A5#1023030102030405"]);
    let restricted = bench.write(0x1014, 0, &0x8000_0701_u32.to_le_bytes());
    assert_eq!(restricted, Err(AbortCode::INVALID_VALUE));
}

#[test]
fn inhibit_time_0x1015_spaces_messages() {
    let mut bench = Bench::new();
    bench.write(0x1015, 0, &[100, 0]).unwrap();
    assert_eq!(raise(&mut bench, 0x1000).len(), 1);
    assert!(raise(&mut bench, 0x2310).is_empty());
    assert!(raise(&mut bench, 0x4210).is_empty());
    let times: Vec<f64> = bench
        .pass(milliseconds(50))
        .iter()
        .map(|(time, _)| *time)
        .collect();
    assert_eq!(times, [10.0, 20.0]);
}

#[test]
fn messages_wait_while_stopped() {
    let mut bench = Bench::new();
    bench.send(0, &[2, ID]);
    assert!(raise(&mut bench, 0x4210).is_empty());
    assert!(bench.pass(milliseconds(10)).is_empty());
    assert_eq!(bench.send(0, &[1, ID]), ["090#1042090102030405"]);
}

#[test]
fn a_flood_of_errors_is_bounded_and_the_newest_survive() {
    let mut bench = Bench::new();
    bench.send(0, &[2, ID]);
    for round in 0..1000 {
        let code = ErrorCode(0x4000 + round % 200);
        bench.device.services_mut().raise_error(code, [0; 5]);
        bench.device.services_mut().clear_error(code);
    }
    let sent = bench.send(0, &[1, ID]);
    assert_eq!(sent.len(), 16);
    assert_eq!(sent.last().unwrap(), "090#000000C740000000");
}

#[test]
fn reset_forgets_errors() {
    let mut bench = Bench::new();
    raise(&mut bench, 0x4210);
    bench.send(0, &[130, ID]);
    assert_eq!(bench.read(0x1001, 0), Ok(0));
    assert_eq!(bench.read(0x1003, 0), Ok(0));
    assert_eq!(raise(&mut bench, 0x4210).len(), 1);
}

#[test]
fn controller_overrun_is_8110_and_error_passive_8120() {
    let mut bench = Bench::new();
    assert_eq!(
        bench.send_frame(&error_message(0x004, 0x01)),
        ["090#1081110000000000", "090#0000001081000000"]
    );
    let passive = error_message(0x004, 0x10);
    assert_eq!(bench.send_frame(&passive), ["090#2081110000000000"]);
    assert!(bench.send_frame(&passive).is_empty());
    assert_eq!(
        bench.send_frame(&error_message(0x004, 0x40)),
        ["090#0000002081000000"]
    );
}

#[test]
fn an_output_that_nobody_drains_is_bounded_and_reported_as_8110() {
    let mut bench = Bench::operational();
    for _ in 0..300 {
        bench.device.on_frame(bench.now, &CanFrame::new(0x80, &[]));
    }
    assert_eq!(bench.device.services().dropped_frames(), 300 - 256);
    let sent = bench.drain();
    assert_eq!(sent.len(), 256 + 2);
    assert_eq!(
        sent[256..],
        ["090#1081110100000000", "090#0000001081010000"]
    );
}

#[test]
fn bus_off_is_a_loss_and_recovery_is_8140() {
    let mut bench = Bench::operational();
    assert!(bench.send_frame(&error_message(0x040, 0)).is_empty());
    assert_eq!(
        bench.heard(),
        [
            Heard::Loss(CommunicationLoss::BusOff),
            Heard::State(NmtState::PreOperational)
        ]
    );
    assert_eq!(
        bench.send_frame(&error_message(0x100, 0)),
        ["090#4081110000000000", "090#0000004081000000"]
    );
    assert_eq!(bench.heard(), [Heard::Recovery(CommunicationLoss::BusOff)]);
}

#[test]
fn messages_of_other_nodes_reach_the_application() {
    let mut bench = Bench::new();
    bench.send(0x091, &[0x50, 0x82, 0x11, 0, 0, 0, 0, 0]);
    assert_eq!(
        bench.heard(),
        [Heard::Emergency(0x11, ErrorCode::RPDO_TIMEOUT)]
    );
}
