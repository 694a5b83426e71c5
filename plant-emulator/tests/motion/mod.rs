//! The modes of position and velocity, on the shipped DC motor. 0x6064 counts micrometres.

mod random;

use canopen::AbortCode;
use canopen::cia402::State;

use crate::manager::{DRIVE, Manager, milliseconds};

pub(crate) const PROFILE_POSITION: u8 = 1;
pub(crate) const PROFILE_VELOCITY: u8 = 3;
pub(crate) const PROFILE_TORQUE: u8 = 4;
pub(crate) const CYCLIC_POSITION: u8 = 8;
pub(crate) const CYCLIC_VELOCITY: u8 = 9;

const ENABLE: u16 = 0x0F;
const NEW_SET_POINT: u16 = 1 << 4;
const HALT: u16 = 1 << 8;
const REACHED: u16 = 1 << 10;
const LIMIT: u16 = 1 << 11;
const BIT_12: u16 = 1 << 12;
const FOLLOWING_ERROR: u16 = 1 << 13;

/// Returns a manager of the DC motor, in Operational, with controlword and target position in RPDO1.
pub(crate) fn configured(mode: u8) -> Manager {
    let text = "schema = 1\nrig = \"dc_motor\"\nname = \"motion\"\nseed = 42\nduration_seconds = 1.0\n[controller.open_loop]\n";
    let mut manager = Manager::with(&testing::part(text, "drive"));
    manager.configure();
    manager.write(DRIVE, 0x6060, 0, &[mode]);
    let target = if matches!(mode, PROFILE_VELOCITY | CYCLIC_VELOCITY) {
        0x60FF_0020
    } else {
        0x607A_0020
    };
    manager.remap(0x1400, 1, &[0x6040_0010, target]);
    manager
}

/// Sends controlword and target, then SYNC, and returns the statusword.
pub(crate) fn cycle(manager: &mut Manager, controlword: u16, target: i32) -> u16 {
    let [a, b] = controlword.to_le_bytes();
    let [c, d, e, f] = target.to_le_bytes();
    manager.send(0x210, &[a, b, c, d, e, f]);
    manager.sync();
    statusword(manager)
}

pub(crate) fn statusword(manager: &mut Manager) -> u16 {
    u16::try_from(manager.read(DRIVE, 0x6041, 0) & 0xFFFF).expect("16 bits")
}

fn state(manager: &mut Manager) -> State {
    State::from_statusword(statusword(manager)).expect("a state of CiA 402")
}

pub(crate) fn signed(manager: &mut Manager, index: u16) -> i32 {
    manager.read(DRIVE, index, 0).cast_signed()
}

fn enabled(mode: u8) -> Manager {
    let mut manager = configured(mode);
    let held = signed(&mut manager, 0x6064);
    for controlword in [0x06, 0x07, ENABLE] {
        let target = if matches!(mode, CYCLIC_POSITION) {
            held
        } else {
            0
        };
        cycle(&mut manager, controlword, target);
    }
    assert_eq!(state(&mut manager), State::OperationEnabled);
    manager
}

/// Moves by profile position until bit 10 is set, and returns the milliseconds.
fn move_to(manager: &mut Manager, target: i32) -> u32 {
    let taken = cycle(manager, ENABLE | NEW_SET_POINT, target);
    assert_eq!(
        taken & (BIT_12 | REACHED),
        BIT_12,
        "acknowledged, not reached"
    );
    for milliseconds in 1..3000 {
        let statusword = cycle(manager, ENABLE, target);
        assert_eq!(statusword & BIT_12, 0, "bit 4 fell");
        if statusword & REACHED != 0 {
            return milliseconds;
        }
    }
    panic!("{target} was not reached: {}", signed(manager, 0x6064));
}

/// T = D/V + V/A, and the position window's time after it.
#[test]
fn profile_position_moves_in_the_time_of_its_trapezoid() {
    let mut manager = enabled(PROFILE_POSITION);
    for (target, way) in [(30_000, 30_000.0), (10_000, 20_000.0)] {
        let milliseconds = f64::from(move_to(&mut manager, target));
        let expected = (way / 50_000.0 + 50_000.0 / 1e6) * 1e3;
        let late = milliseconds - expected - 10.0;
        assert!((-2.0..60.0).contains(&late), "{milliseconds} {expected}");
        let error = signed(&mut manager, 0x6064) - target;
        assert!(error.abs() <= 200, "{error}");
        assert_eq!(signed(&mut manager, 0x6062), target);
    }
}

#[test]
fn a_set_point_beyond_the_software_limits_ends_at_the_limit() {
    let mut manager = enabled(PROFILE_POSITION);
    manager.write(DRIVE, 0x607D, 2, &20_000_i32.to_le_bytes());
    manager.write(DRIVE, 0x607D, 1, &1000_i32.to_le_bytes());
    move_to(&mut manager, 50_000);
    assert_eq!(signed(&mut manager, 0x6062), 20_000);
}

#[test]
fn halt_stops_by_a_ramp_and_the_move_goes_on_after_it() {
    let mut manager = enabled(PROFILE_POSITION);
    cycle(&mut manager, ENABLE | NEW_SET_POINT, 40_000);
    for _ in 0..200 {
        cycle(&mut manager, ENABLE, 40_000);
    }
    let before = signed(&mut manager, 0x6062);
    let mut cycles = 0;
    while cycle(&mut manager, ENABLE | HALT, 40_000) & REACHED == 0 {
        cycles += 1;
        assert!(cycles < 300);
    }
    let way = signed(&mut manager, 0x6062) - before;
    // v²/2a = 1250, and a cycle at full speed.
    assert!((1200..1310).contains(&way), "{way}");
    for _ in 0..1500 {
        cycle(&mut manager, ENABLE, 40_000);
    }
    assert_eq!(signed(&mut manager, 0x6062), 40_000);
}

#[test]
fn profile_velocity_reaches_its_target_and_says_when_it_stands() {
    let mut manager = enabled(PROFILE_VELOCITY);
    assert_ne!(cycle(&mut manager, ENABLE, 0) & BIT_12, 0, "the speed is 0");
    let mut statusword = 0;
    for _ in 0..300 {
        statusword = cycle(&mut manager, ENABLE, 60_000);
    }
    assert_eq!(statusword & (REACHED | BIT_12), REACHED);
    let velocity = signed(&mut manager, 0x606C);
    assert!((velocity - 60_000).abs() < 3000, "{velocity}");
    assert_eq!(signed(&mut manager, 0x606B), 60_000);
}

#[test]
fn cyclic_velocity_follows_at_once_within_0x607f() {
    let mut manager = enabled(CYCLIC_VELOCITY);
    manager.write(DRIVE, 0x607F, 0, &40_000_u32.to_le_bytes());
    assert_eq!(
        cycle(&mut manager, ENABLE, 30_000) & (LIMIT | BIT_12),
        BIT_12
    );
    assert_eq!(signed(&mut manager, 0x606B), 30_000);
    assert_ne!(cycle(&mut manager, ENABLE, 90_000) & LIMIT, 0);
    assert_eq!(signed(&mut manager, 0x606B), 40_000);
}

#[test]
fn cyclic_position_follows_a_sine() {
    let mut manager = enabled(CYCLIC_POSITION);
    let mut largest = 0;
    for number in 0..2000 {
        let seconds = f64::from(number) * 1e-3;
        #[expect(clippy::cast_possible_truncation, reason = "micrometres of the travel")]
        let target = (20_000.0 * (1.0 - libm::cos(2.0 * seconds))) as i32;
        let statusword = cycle(&mut manager, ENABLE, target);
        assert_eq!(statusword & (BIT_12 | FOLLOWING_ERROR), BIT_12);
        assert_eq!(signed(&mut manager, 0x6062), target, "{number}");
        largest = largest.max(signed(&mut manager, 0x60F4).abs());
    }
    assert!((1..1500).contains(&largest), "{largest}");
}

/// Before the first target the drive holds its position; a target far away is approached at the maximum speed.
#[test]
fn nothing_jumps_when_cyclic_position_is_enabled() {
    let mut manager = configured(CYCLIC_POSITION);
    for controlword in [0x06_u16, 0x07, ENABLE] {
        manager.write(DRIVE, 0x6040, 0, &controlword.to_le_bytes());
        manager.sync();
    }
    for _ in 0..50 {
        manager.sync();
        let demand = signed(&mut manager, 0x6062);
        assert!((demand - signed(&mut manager, 0x6064)).abs() < 200);
    }
    let mut before = signed(&mut manager, 0x6062);
    for _ in 0..100 {
        let statusword = cycle(&mut manager, ENABLE, 30_000);
        let demand = signed(&mut manager, 0x6062);
        assert!(
            (0..=301).contains(&(demand - before)),
            "{}",
            demand - before
        );
        assert!(statusword & LIMIT != 0 || demand == 30_000);
        before = demand;
    }
    assert_eq!(before, 30_000);
}

/// Without SYNC the drive brakes on its own clock, and is in Fault when it stands.
#[test]
fn a_lost_sync_ends_in_a_ramp_and_a_fault() {
    let mut manager = enabled(CYCLIC_VELOCITY);
    for _ in 0..100 {
        cycle(&mut manager, ENABLE, 100_000);
    }
    manager.write(DRIVE, 0x6085, 0, &1_000_000_u32.to_le_bytes());
    let mut states = Vec::new();
    for _ in 0..400 {
        manager.run_for(milliseconds(1));
        let now = state(&mut manager);
        if states.last().is_none_or(|(last, _)| *last != now) {
            states.push((now, 0));
        }
        states.last_mut().unwrap().1 += 1;
        if now == State::Fault {
            assert_eq!(manager.current_amperes(), 0.0);
        }
    }
    let order = Vec::from_iter(states.iter().map(|(state, _)| *state));
    let expected = [
        State::OperationEnabled,
        State::FaultReactionActive,
        State::Fault,
    ];
    assert_eq!(order, expected);
    let braking = states[1].1;
    assert!((95..200).contains(&braking), "v/a = 100 ms: {braking}");
}

#[test]
fn every_quick_stop_option_code_ends_at_a_standstill() {
    for code in 0..=8_i16 {
        let mut manager = enabled(CYCLIC_VELOCITY);
        manager.write(DRIVE, 0x605A, 0, &code.to_le_bytes());
        for _ in 0..100 {
            cycle(&mut manager, ENABLE, 60_000);
        }
        let first = cycle(&mut manager, 0x02, 60_000);
        let first = State::from_statusword(first).unwrap();
        let mut cycles = 0;
        let is_moving = |manager: &mut Manager| {
            signed(manager, 0x606B) != 0 || signed(manager, 0x606C).abs() > 5000
        };
        while code != 0 && is_moving(&mut manager) {
            cycle(&mut manager, 0x02, 60_000);
            cycles += 1;
            assert!(cycles < 200, "{code}");
        }
        cycle(&mut manager, 0x02, 60_000);
        let last = state(&mut manager);
        let expected = match code {
            0 => [State::SwitchOnDisabled; 2],
            1..=4 => [State::QuickStopActive, State::SwitchOnDisabled],
            _ => [State::QuickStopActive; 2],
        };
        assert_eq!([first, last], expected, "{code}");
        let is_powered = last == State::QuickStopActive;
        assert!(is_powered || manager.current_amperes() == 0.0, "{code}");
    }
}

#[test]
fn a_following_error_is_a_fault_with_its_emcy() {
    let mut manager = enabled(PROFILE_POSITION);
    manager.write(DRIVE, 0x6065, 0, &2000_u32.to_le_bytes());
    manager.write(DRIVE, 0x6066, 0, &20_u16.to_le_bytes());
    manager.write(DRIVE, 0x6072, 0, &0_u16.to_le_bytes());
    cycle(&mut manager, ENABLE | NEW_SET_POINT, 40_000);
    let mut statusword = 0;
    for _ in 0..300 {
        statusword = cycle(&mut manager, ENABLE, 40_000);
    }
    assert_eq!(State::from_statusword(statusword), Some(State::Fault));
    assert_ne!(statusword & FOLLOWING_ERROR, 0);
    assert_eq!(manager.last(0x090).unwrap()[..2], [0x11, 0x86]);
    cycle(&mut manager, 0x00, 0);
    cycle(&mut manager, 0x80, 0);
    assert_eq!(state(&mut manager), State::SwitchOnDisabled);
    assert_eq!(statusword_bit(&mut manager, FOLLOWING_ERROR), 0);
}

fn statusword_bit(manager: &mut Manager, bit: u16) -> u16 {
    statusword(manager) & bit
}

#[test]
fn profile_torque_acts_without_sync() {
    let mut manager = enabled(PROFILE_TORQUE);
    manager.write(DRIVE, 0x6071, 0, &200_i16.to_le_bytes());
    manager.run_for(milliseconds(1));
    assert_eq!(manager.current_amperes(), 0.2);
    assert_ne!(statusword(&mut manager) & REACHED, 0);
    assert_eq!(signed(&mut manager, 0x6074), 200);
}

#[test]
fn values_that_an_option_code_does_not_have_are_invalid() {
    let mut manager = configured(CYCLIC_POSITION);
    for (index, value) in [
        (0x6007, 0_i16),
        (0x605A, 9),
        (0x605B, 2),
        (0x605C, -1),
        (0x605D, 0),
        (0x605E, 5),
    ] {
        let refused = manager.try_write(DRIVE, index, 0, &value.to_le_bytes());
        assert_eq!(refused, Err(AbortCode::INVALID_VALUE), "{index:#06x}");
    }
}
