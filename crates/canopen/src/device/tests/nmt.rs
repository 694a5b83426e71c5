//! NMT and start-up.

use super::*;

#[test]
fn boot_up_after_power_on_and_both_resets_with_defaults_restored() {
    let mut bench = Bench::new();
    for (specifier, application_value) in [(130, 77), (129, 0)] {
        bench.write(0x1017, 0, &[50, 0]).unwrap();
        bench.write(0x2301, 0, &77_i32.to_le_bytes()).unwrap();
        bench.send(0, &[1, ID]);
        assert_eq!(bench.send(0, &[specifier, ID]), ["710#00"]);
        assert_eq!(bench.read(0x1017, 0), Ok(0));
        assert_eq!(bench.read(0x2301, 0), Ok(application_value));
        assert_eq!(
            bench.device.services().nmt_state(),
            NmtState::PreOperational
        );
    }
}

#[test]
fn broadcast_is_obeyed() {
    let mut bench = Bench::new();
    bench.send(0, &[1, 0]);
    assert_eq!(bench.heard(), [Heard::State(NmtState::Operational)]);
}

#[test]
fn two_commands_in_a_row_are_both_obeyed() {
    let mut bench = Bench::new();
    for specifier in [1, 2] {
        let frame = CanFrame::new(0, &[specifier, ID]);
        bench.device.on_frame(bench.now, &frame);
    }
    assert_eq!(
        bench.heard(),
        [
            Heard::State(NmtState::Operational),
            Heard::State(NmtState::Stopped)
        ]
    );
}

#[test]
fn at_most_eight_requests_of_the_node_itself_wait() {
    let mut bench = Bench::new();
    for command in [NmtCommand::Start, NmtCommand::Stop].repeat(5) {
        bench.device.services_mut().request_nmt(command);
    }
    bench.tick();
    bench.tick();
    assert_eq!(bench.heard().len(), 8);
}

#[test]
fn commands_for_other_nodes_are_ignored() {
    let mut bench = Bench::new();
    for specifier in [1, 2, 128, 129, 130] {
        assert!(bench.send(0, &[specifier, ID + 1]).is_empty());
    }
    assert!(bench.heard().is_empty());
}

#[test]
fn node_1_boots_and_obeys() {
    let mut dictionary = dictionary();
    dictionary.set_integer(0x1014, 0, 0x81).unwrap();
    let node = NodeId::new(1).unwrap();
    let mut device = Device::new(node, dictionary, Listener::default()).unwrap();
    device.on_tick(Duration::ZERO);
    assert_eq!(device.next_frame().unwrap().to_string(), "701#00");
    device.on_frame(Duration::ZERO, &CanFrame::new(0, &[1, 1]));
    assert_eq!(device.services().nmt_state(), NmtState::Operational);
}

#[test]
fn stopped_answers_no_sdo_and_obeys_start() {
    let mut bench = Bench::new();
    bench.send(0, &[2, ID]);
    let request = [0x40, 0x00, 0x10, 0, 0, 0, 0, 0];
    assert!(bench.send(0x610, &request).is_empty());
    bench.send(0, &[1, ID]);
    assert_eq!(bench.send(0x610, &request), ["590#4300100092010200"]);
}

#[test]
fn a_new_node_wants_a_tick_at_once_and_a_frame_boots_it_too() {
    let node = NodeId::new(ID).unwrap();
    let mut device = Device::new(node, dictionary(), Listener::default()).unwrap();
    assert_eq!(device.next_deadline(), Some(Duration::ZERO));
    device.on_frame(milliseconds(3), &CanFrame::new(0, &[1, ID]));
    assert_eq!(device.next_frame().unwrap().to_string(), "710#00");
    assert_eq!(device.services().nmt_state(), NmtState::Operational);
}

#[test]
fn stop_disables_on_arrival() {
    let mut bench = Bench::operational();
    bench
        .device
        .on_frame(bench.now, &CanFrame::new(0, &[2, ID]));
    assert_eq!(bench.heard(), [Heard::State(NmtState::Stopped)]);
}
