//! The emulator as a node, with a small manager: start-up, the 402 sequence, the cycle, and every way to lose current.

mod manager;
mod motion;

use std::time::Duration;

use can::{CanFrame, Progress};
use canopen::AbortCode;
use canopen::cia402::State;
use manager::{DISTURBANCE, DRIVE, Manager, milliseconds};
use plant_emulator::catalogue;
use proptest::prelude::*;
use scenario::plant::{PlantModel, Sma};

const ENABLE_OPERATION: u16 = 0x0F;
/// Bit 11 of the statusword.
const INTERNAL_LIMIT: u16 = 1 << 11;

#[test]
fn both_nodes_boot_and_answer() {
    let mut manager = Manager::new();
    manager.run_for(milliseconds(2));
    for node in [DRIVE, DISTURBANCE] {
        let boot_up = CanFrame::new(0x700 + node, &[0]);
        assert!(
            manager.frames().contains(&boot_up),
            "{:?}",
            manager.frames()
        );
    }
    assert_eq!(manager.read(DRIVE, 0x1000, 0), 0x0002_0192);
    assert_eq!(manager.read(DISTURBANCE, 0x1000, 0) & 0xFFFF, 0x0191);
}

#[test]
fn the_402_sequence_leads_to_operation_enabled() {
    let mut manager = Manager::new();
    manager.configure();
    let states = [0x06, 0x07, 0x0F].map(|controlword| manager.cycle(controlword, 0).state);
    let expected = [
        State::ReadyToSwitchOn,
        State::SwitchedOn,
        State::OperationEnabled,
    ];
    assert_eq!(states, expected);
}

#[test]
fn a_command_acts_from_its_sync_and_shows_in_the_next_sample() {
    let mut manager = Manager::enabled();
    let first = manager.cycle(ENABLE_OPERATION, 700);
    assert_eq!(first.current_permille, 0, "the sample precedes the command");
    assert_eq!(manager.current_amperes(), 0.7);
    let second = manager.cycle(ENABLE_OPERATION, 300);
    assert_eq!(second.current_permille, 700);
    // Between two SYNCs a new command only waits.
    manager.send_rpdo(ENABLE_OPERATION, 900);
    assert_eq!(manager.current_amperes(), 0.3);
}

#[test]
fn current_lifts_the_load_in_steps_of_the_converter() {
    let mut manager = Manager::enabled();
    let mut sample = manager.cycle(ENABLE_OPERATION, 600);
    for _ in 0..3000 {
        sample = manager.cycle(ENABLE_OPERATION, 600);
    }
    assert!(sample.position_micrometres > 20_000, "{sample:?}");
    let truth = manager.actuator().position_metres() * 1e6;
    let counts = f64::from(sample.position_micrometres) / (60_000.0 / 1024.0);
    assert!((counts - counts.round()).abs() < 0.01, "{counts}");
    assert!((truth - f64::from(sample.position_micrometres)).abs() < 32.0);
}

#[test]
fn the_truth_is_in_tpdo2() {
    let mut manager = Manager::enabled();
    for _ in 0..2000 {
        manager.cycle(ENABLE_OPERATION, 600);
    }
    let data = manager.last(0x290).expect("TPDO2 comes with each SYNC");
    let temperature = i16::from_le_bytes([data[0], data[1]]);
    let fraction = u16::from_le_bytes([data[2], data[3]]);
    let position = i32::from_le_bytes([data[4], data[5], data[6], data[7]]);
    let actuator = manager.actuator();
    assert!((f64::from(temperature) * 1e-2 - actuator.temperature_celsius()).abs() < 0.0051);
    assert!((f64::from(fraction) / 5e4 - actuator.martensite_fraction()).abs() < 1.01e-5);
    assert!((f64::from(position) * 1e-9 - actuator.position_metres()).abs() < 0.51e-9);
}

/// Commands outside 0 to the limits are cut, and the statusword shows it (bit 11).
#[test]
fn limits_cut_and_say_so() {
    let mut manager = Manager::enabled();
    manager.write(DRIVE, 0x6073, 0, &400_u16.to_le_bytes());
    manager.cycle(ENABLE_OPERATION, 700);
    assert_eq!(manager.current_amperes(), 0.4);
    assert!(manager.cycle(ENABLE_OPERATION, 100).statusword & 1 << 11 == 0);
    assert!(manager.cycle(ENABLE_OPERATION, -5).statusword & 1 << 11 != 0);
    assert_eq!(manager.current_amperes(), 0.0);
}

/// An RPDO beyond the limits of the data sheet is cut to them, since a PDO cannot be refused.
#[test]
fn a_target_beyond_its_objects_limits_is_cut_and_says_so() {
    let mut manager = Manager::enabled();
    for (target, stored) in [(32_000_i16, 1000), (-32_000, -1000)] {
        assert!(manager.cycle(ENABLE_OPERATION, 500).statusword & INTERNAL_LIMIT == 0);
        manager.cycle(ENABLE_OPERATION, target);
        let statusword = manager.cycle(ENABLE_OPERATION, target).statusword;
        assert!(statusword & INTERNAL_LIMIT != 0, "{statusword:#06x}");
        let bytes = manager.read(DRIVE, 0x6071, 0).to_le_bytes();
        assert_eq!(i16::from_le_bytes([bytes[0], bytes[1]]), stored);
        assert_eq!(manager.current_amperes(), f64::from(stored.max(0)) / 1e3);
    }
    manager.write(DRIVE, 0x6071, 0, &1000_i16.to_le_bytes());
    let bytes = 1001_i16.to_le_bytes();
    let refused = manager.try_write(DRIVE, 0x6071, 0, &bytes);
    assert_eq!(refused, Err(AbortCode::VALUE_TOO_HIGH));
    manager.sync();
    manager.sync();
    let statusword = manager.read(DRIVE, 0x6041, 0);
    assert!(
        statusword & u32::from(INTERNAL_LIMIT) == 0,
        "{statusword:#x}"
    );
}

#[test]
fn a_mode_that_the_drive_has_not_is_refused_by_rpdo_too() {
    let mut manager = Manager::new();
    manager.configure();
    manager.remap(0x1400, 1, &[0x6040_0010, 0x6071_0010, 0x6060_0008]);
    for (mode, expected) in [(7, 10), (10, 10), (0xFF, 10), (0, 0), (2, 0), (10, 10)] {
        manager.send(0x210, &[0x06, 0, 0, 0, mode]);
        manager.sync();
        let modes = [0x6060, 0x6061].map(|index| manager.read(DRIVE, index, 0));
        assert_eq!(modes, [expected; 2], "mode {mode} by RPDO");
    }
}

#[test]
fn a_factor_beyond_its_objects_limits_is_cut() {
    let mut manager = Manager::enabled();
    manager.send(0, &[1, 0x11]);
    for (factor, put_out) in [(32_000_i16, 30.0), (-5, 0.0), (2500, 2.5)] {
        let [low, high] = factor.to_le_bytes();
        manager.send(0x211, &[low, high, 0, 0]);
        assert_eq!(manager.inputs().convection_factor, put_out);
    }
}

/// Bit 9 of the statusword agrees with the effect of a controlword.
#[test]
fn a_controlword_is_refused_where_the_statusword_says_not_remote() {
    let mut manager = Manager::new();
    manager.run_for(milliseconds(2));
    for (command, is_remote) in [(128, false), (1, true), (128, false)] {
        manager.send(0, &[command, 0x10]);
        for controlword in [0x06_u16, 0x07, 0x00] {
            let before = manager.read(DRIVE, 0x6041, 0);
            assert_eq!(before >> 9 & 1 == 1, is_remote, "{before:#06x}");
            let bytes = controlword.to_le_bytes();
            let written = manager.try_write(DRIVE, 0x6040, 0, &bytes);
            if is_remote {
                assert_eq!(written, Ok(()));
            } else {
                assert_eq!(written, Err(AbortCode::DEVICE_STATE));
                assert_eq!(manager.read(DRIVE, 0x6041, 0), before);
                assert_eq!(manager.read(DRIVE, 0x6040, 0), 0);
            }
        }
    }
}

/// With any ramp in the option codes the current falls at once.
#[test]
fn every_option_code_of_the_profile_takes_the_current_away_at_once() {
    const QUICK_STOP: u16 = 0x02;
    const HALT: u16 = 0x10F;
    for (index, values, controlword) in [
        (0x605A, 0..=8, QUICK_STOP),
        (0x605B, 0..=1, 0x06),
        (0x605C, 0..=1, 0x07),
        (0x605D, 1..=4, HALT),
    ] {
        for value in values {
            let mut manager = Manager::enabled();
            manager.write(DRIVE, index, 0, &i16::to_le_bytes(value));
            let stop = |manager: &mut Manager| manager.send_rpdo(controlword, 800);
            let (mut manager, elapsed) = time_to_zero(manager, stop);
            assert_eq!(elapsed, Duration::ZERO, "{index:#06x} = {value}");
            manager.sync();
            let statusword = u16::try_from(manager.read(DRIVE, 0x6041, 0)).unwrap();
            let expected = match (index, value) {
                (0x605A, 0..=4) => State::SwitchOnDisabled,
                (0x605A, _) => State::QuickStopActive,
                (0x605B, _) => State::ReadyToSwitchOn,
                (0x605C, _) => State::SwitchedOn,
                _ => State::OperationEnabled,
            };
            assert_eq!(State::from_statusword(statusword), Some(expected));
        }
    }
    let refused = Manager::enabled().try_write(DRIVE, 0x6007, 0, &[0, 0]);
    assert_eq!(refused, Err(AbortCode::INVALID_VALUE), "no action");
}

#[test]
fn the_statusword_is_sent_when_it_changes() {
    let mut manager = Manager::new();
    manager.configure();
    manager.remap(0x1800, 255, &[0x6041_0010]);
    let count = |manager: &Manager| {
        let frames = manager.frames().iter();
        frames
            .filter(|frame| frame.standard_id() == Some(0x190))
            .count()
    };
    manager.run_for(milliseconds(1));
    let mut before = count(&manager);
    for (controlword, changes) in [(0x06_u16, 1), (0x06, 0), (0x07, 1), (0x0F, 1), (0x00, 1)] {
        manager.write(DRIVE, 0x6040, 0, &controlword.to_le_bytes());
        manager.run_for(milliseconds(1));
        assert_eq!(count(&manager) - before, changes, "{controlword:#x}");
        before = count(&manager);
    }
    let statusword = manager.read(DRIVE, 0x6041, 0).to_le_bytes();
    assert_eq!(manager.last(0x190), Some(&statusword[..2]));
}

/// Heats, calls `disturb`, and returns the time after which the current is gone.
fn time_to_zero(mut manager: Manager, disturb: impl FnOnce(&mut Manager)) -> (Manager, Duration) {
    for _ in 0..100 {
        manager.cycle(ENABLE_OPERATION, 800);
    }
    assert_eq!(manager.current_amperes(), 0.8);
    let start = manager.now();
    disturb(&mut manager);
    while manager.current_amperes() > 0.0 {
        manager.tick();
        assert!(
            manager.now() < start + Duration::from_secs(1),
            "still heated"
        );
    }
    let elapsed = manager.now() - start;
    (manager, elapsed)
}

#[test]
fn whatever_disables_acts_on_arrival() {
    let nmt = |command| move |manager: &mut Manager| manager.send(0, &[command, 0x10]);
    let rpdo = |controlword| move |manager: &mut Manager| manager.send_rpdo(controlword, 800);
    for command in [2, 128, 129, 130] {
        let (_, elapsed) = time_to_zero(Manager::enabled(), nmt(command));
        assert_eq!(elapsed, Duration::ZERO, "NMT command {command}");
    }
    for controlword in [0x00, 0x02, 0x06, 0x07, 0x10F] {
        let (_, elapsed) = time_to_zero(Manager::enabled(), rpdo(controlword));
        assert_eq!(elapsed, Duration::ZERO, "controlword {controlword:#x}");
    }
    let sdo = |manager: &mut Manager| manager.write(DRIVE, 0x6040, 0, &[0x02, 0]);
    assert_eq!(time_to_zero(Manager::enabled(), sdo).1, Duration::ZERO);
    let stop = |manager: &mut Manager| manager.stop();
    let (manager, elapsed) = time_to_zero(Manager::enabled(), stop);
    assert_eq!(elapsed, Duration::ZERO);
    assert_eq!(manager.progress(), Progress::Stopped);
}

/// Without any frame the first supervision removes the current, within one period of its time.
#[test]
fn the_drive_takes_the_current_away_when_its_manager_is_gone() {
    let (_, elapsed) = time_to_zero(Manager::enabled(), |_| {});
    let limit = plant_emulator::drive::SYNC_TIMEOUT + milliseconds(2);
    assert!(elapsed <= limit, "{elapsed:?}");
}

#[test]
fn lost_syncs_are_a_fault_with_an_emergency() {
    let (mut manager, elapsed) = time_to_zero(Manager::enabled(), |manager| {
        manager.keep_heartbeat_alive();
    });
    assert!(
        elapsed <= plant_emulator::drive::SYNC_TIMEOUT + milliseconds(2),
        "{elapsed:?}"
    );
    manager.run_for(milliseconds(2));
    assert_eq!(
        &manager.last(0x090).expect("an emergency")[..2],
        &[0x00, 0x81]
    );
    assert_back_only_after_fault_reset(manager);
}

#[test]
fn a_late_sync_makes_nothing_due_before_its_timeout() {
    let mut manager = Manager::enabled();
    for node in [DRIVE, DISTURBANCE] {
        manager.write(node, 0x1017, 0, &[0; 2]);
    }
    manager.lose_heartbeat();
    manager.cycle(ENABLE_OPERATION, 300);
    manager.sync();
    let latest_sync = manager.now();
    manager.tick();
    let pause = manager.now() - latest_sync;
    assert!(
        pause >= plant_emulator::drive::SYNC_TIMEOUT,
        "due after {pause:?}"
    );
}

#[test]
fn lost_syncs_are_noticed_without_a_configured_period() {
    let mut manager = Manager::new();
    manager.configure();
    manager.write(DRIVE, 0x1006, 0, &[0; 4]);
    manager.enable();
    let (mut manager, elapsed) = time_to_zero(manager, |manager| manager.keep_heartbeat_alive());
    assert!(
        elapsed <= plant_emulator::drive::SYNC_TIMEOUT + milliseconds(2),
        "{elapsed:?}"
    );
    manager.run_for(milliseconds(2));
    assert_eq!(
        &manager.last(0x090).expect("an emergency")[..2],
        &[0x00, 0x81]
    );
}

#[test]
fn a_lost_heartbeat_is_a_fault_although_syncs_come() {
    let (manager, elapsed) = time_to_zero(Manager::enabled(), |manager| {
        manager.lose_heartbeat();
        for _ in 0..101 {
            manager.cycle(ENABLE_OPERATION, 800);
        }
        assert_eq!(manager.current_amperes(), 0.0);
    });
    assert!(elapsed <= milliseconds(101), "{elapsed:?}");
    assert_eq!(
        &manager.last(0x090).expect("an emergency")[..2],
        &[0x30, 0x81]
    );
    assert_back_only_after_fault_reset(manager);
}

#[test]
fn a_lost_rpdo_is_a_fault_although_syncs_come() {
    let mut manager = Manager::new();
    manager.configure();
    manager.write(DRIVE, 0x1400, 5, &20_u16.to_le_bytes());
    manager.enable();
    let (manager, _) = time_to_zero(manager, |manager| {
        for _ in 0..22 {
            manager.sync();
        }
        assert_eq!(manager.current_amperes(), 0.0);
    });
    assert_eq!(
        &manager.last(0x090).expect("an emergency")[..2],
        &[0x50, 0x82]
    );
    assert_back_only_after_fault_reset(manager);
}

/// Asserts that after a fault `enable operation` alone does not restore the current.
fn assert_back_only_after_fault_reset(mut manager: Manager) {
    manager.restore_heartbeat();
    manager.send(0, &[1, 0x10]);
    for _ in 0..30 {
        let sample = manager.cycle(ENABLE_OPERATION, 500);
        assert_eq!(sample.state, State::Fault);
    }
    assert_eq!(manager.current_amperes(), 0.0);
    assert_eq!(manager.cycle(0x80, 0).state, State::SwitchOnDisabled);
    for controlword in [0x06, 0x07, 0x0F] {
        manager.cycle(controlword, 500);
    }
    assert_eq!(manager.current_amperes(), 0.5);
}

#[test]
fn one_ampere_for_ever_trips_the_protection() {
    let mut manager = Manager::enabled();
    let mut cycles = 0;
    while manager.cycle(ENABLE_OPERATION, 1000).state == State::OperationEnabled {
        cycles += 1;
        assert!(cycles < 20_000, "no trip");
    }
    assert!((9_990..10_010).contains(&cycles), "{cycles} ms");
    assert_eq!(manager.current_amperes(), 0.0);
    assert_eq!(
        &manager.last(0x090).expect("an emergency")[..2],
        &[0x50, 0x23]
    );
    // While the load is hot, a reset has no effect; later it has.
    assert_eq!(manager.cycle(0x80, 0).state, State::Fault);
    for _ in 0..5000 {
        manager.cycle(0, 0);
    }
    assert_eq!(manager.cycle(0x80, 0).state, State::SwitchOnDisabled);
}

#[test]
fn the_ramp_to_one_ampere_and_back_passes() {
    let mut manager = Manager::enabled();
    for cycle in 0..40_000_i32 {
        let permille = 1000 - (cycle - 20_000).abs() / 20;
        let permille = i16::try_from(permille).expect("0 to 1000");
        let sample = manager.cycle(ENABLE_OPERATION, permille);
        assert_eq!(sample.state, State::OperationEnabled, "cycle {cycle}");
    }
}

/// Cooling follows the emulator's own time: the wire is equally cold with and without SYNCs.
#[test]
fn a_lost_sync_never_slows_cooling() {
    let cooled = |has_syncs: bool| {
        let mut manager = Manager::enabled();
        for _ in 0..2000 {
            manager.cycle(ENABLE_OPERATION, 600);
        }
        manager.send(0, &[2, 0]);
        for _ in 0..500 {
            if has_syncs {
                manager.sync();
            } else {
                manager.run_for(milliseconds(1));
            }
        }
        manager.actuator_now().temperature_celsius()
    };
    let (with, without) = (cooled(true), cooled(false));
    assert!((with - without).abs() < 1e-6, "{with} {without}");
    assert!(with < 40.0);
}

#[test]
fn the_disturbance_module_acts_on_arrival_and_falls_back() {
    let mut manager = Manager::enabled();
    let fan_and_load = |manager: &mut Manager| {
        manager.send(0x211, &[0x88, 0x13, 0x64, 0x00]);
    };
    fan_and_load(&mut manager);
    assert_eq!(manager.inputs().convection_factor, 5.0);
    assert!((manager.inputs().added_load_kilograms - 0.01).abs() < 1e-12);
    manager.send(0, &[2, 0x11]);
    assert_eq!(manager.inputs().convection_factor, 1.0);
    assert_eq!(manager.inputs().added_load_kilograms, 0.0);
    manager.send(0, &[1, 0x11]);
    assert_eq!(manager.inputs().convection_factor, 1.0);
    fan_and_load(&mut manager);
    manager.lose_heartbeat();
    manager.run_for(milliseconds(400));
    assert_eq!(manager.inputs().convection_factor, 1.0, "heartbeat lost");
    // A negative factor does not heat.
    let mut manager = Manager::enabled();
    manager.send(0x211, &[0x00, 0x80, 0x00, 0x00]);
    assert_eq!(manager.inputs().convection_factor, 0.0);
    manager.write(DISTURBANCE, 0x6411, 1, &2000_i16.to_le_bytes());
    manager.run_for(milliseconds(1));
    assert_eq!(manager.inputs().convection_factor, 2.0);
}

#[test]
fn equal_frames_give_equal_frames() {
    let run = || {
        let mut scenario = manager::scenario();
        scenario.sensor.noise_rms = Some(0.06);
        let mut manager = Manager::with(&scenario);
        manager.configure();
        manager.enable();
        for cycle in 0..2000 {
            manager.cycle(ENABLE_OPERATION, 400 + cycle % 300);
        }
        manager.frames().to_vec()
    };
    assert_eq!(run(), run());
}

#[test]
fn an_impossible_plant_is_refused_by_name() {
    let mut scenario = manager::scenario();
    let mut plant = Sma::default();
    plant.phase.austenite_finish_celsius = 50.0;
    scenario.set_plant(PlantModel::from_sma(plant));
    let error = catalogue::emulator(&scenario).unwrap_err();
    assert_eq!(
        error.to_string(),
        "plant: austenite_start_celsius is 53 °C, it must be below austenite_finish_celsius of 50 °C"
    );
}

fn any_frame() -> impl Strategy<Value = CanFrame> {
    let ids = prop_oneof![
        0_u32..0x800,
        prop::sample::select(vec![0, 0x80, 0x210, 0x211, 0x610, 0x611, 0x690, 0x701]),
        any::<u32>(),
    ];
    (ids, 0_u8..=8, any::<[u8; 8]>()).prop_map(|(id, length, data)| {
        CanFrame::from_raw(id, length, data).expect("at most 8 bytes")
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 128, failure_persistence: None, ..ProptestConfig::default() })]

    /// Arbitrary frames cause no panic; the plant stays finite, the output bounded, and no current remains without a
    /// manager.
    #[test]
    fn arbitrary_frames_never_harm(frames in prop::collection::vec((any_frame(), 0_u64..3000), 1..200)) {
        let mut manager = Manager::enabled();
        for (frame, pause) in frames {
            manager.run_for(Duration::from_micros(pause));
            manager.send_frame(&frame);
            prop_assert!(manager.actuator().position_metres().is_finite());
            prop_assert!(manager.actuator().temperature_celsius().is_finite());
        }
        manager.lose_heartbeat();
        manager.run_for(milliseconds(500));
        prop_assert_eq!(manager.current_amperes(), 0.0);
    }
}

/// The heartbeat consumer of CiA 301 begins with the first heartbeat. A manager that never sends one is lost after the
/// same time.
#[test]
fn a_manager_that_was_never_heard_is_lost_too() {
    let mut manager = Manager::new();
    manager.run_for(milliseconds(2));
    manager.write(DRIVE, 0x1016, 1, &0x0001_0064_u32.to_le_bytes());
    manager.write(DRIVE, 0x1006, 0, &1000_u32.to_le_bytes());
    manager.write(DRIVE, 0x6060, 0, &[10]);
    manager.send(0, &[1, 0]);
    for controlword in [0x06, 0x07, 0x0F] {
        manager.cycle(controlword, 0);
    }
    let mut heated = 0;
    for _ in 0..150 {
        manager.cycle(ENABLE_OPERATION, 500);
        heated += u32::from(manager.current_amperes() > 0.0);
    }
    assert!((80..=100).contains(&heated), "{heated} cycles");
    assert_eq!(manager.current_amperes(), 0.0);
    assert_eq!(manager.last(0x090).expect("an EMCY")[..2], [0x30, 0x81]);
    assert_eq!(manager.last(0x710), Some(&[0x7F][..]), "Pre-operational");
}
