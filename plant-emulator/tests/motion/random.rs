//! A thousand masters that send legal and illegal commands in any order, at any time, in any mode.

use canopen::cia402::State;
use proptest::prelude::Rng;
use proptest::test_runner::{RngAlgorithm, TestRng};

use super::{configured, signed, statusword};
use crate::manager::{DRIVE, Manager, milliseconds};

const MASTERS: u64 = 1000;
const COMMANDS: u32 = 40;
/// Micrometres that 0x607F allows in the two milliseconds that a step covers where a SYNC was not heard, and the rounding.
const REACH: i32 = 601;

fn any<T: Copy>(random: &mut TestRng, values: &[T]) -> T {
    let count = u64::try_from(values.len()).expect("a short list");
    values[usize::try_from(random.next_u64() % count).expect("an index")]
}

/// Sends one command. None writes 0x607F, of which the bound of a jump follows.
fn send(manager: &mut Manager, random: &mut TestRng) {
    const CONTROLWORDS: [u16; 14] = [
        0x00, 0x02, 0x06, 0x07, 0x0F, 0x0F, 0x1F, 0x3F, 0x5F, 0x21F, 0x10F, 0x80, 0x8F, 0xFFFF,
    ];
    let target = any(
        random,
        &[0, 1, -1, 5000, 30_000, 59_000, i32::MAX, i32::MIN],
    );
    let controlword = any(random, &CONTROLWORDS);
    match random.next_u32() % 12 {
        0..=3 => {
            let [a, b] = controlword.to_le_bytes();
            let [c, d, e, f] = target.to_le_bytes();
            manager.send(0x210, &[a, b, c, d, e, f]);
        }
        4 => {
            let _ = manager.try_write(DRIVE, 0x6040, 0, &controlword.to_le_bytes());
        }
        5 | 6 => {
            let mode = any(random, &[0, 1, 3, 4, 6, 7, 8, 9, 10, 0x80, 0xFF]);
            let _ = manager.try_write(DRIVE, 0x6060, 0, &[mode]);
        }
        7 => {
            let index = any(random, &[0x605A, 0x605B, 0x605C, 0x605D, 0x605E, 0x6007]);
            let value = any(random, &[-1_i16, 0, 1, 2, 3, 4, 5, 6, 8, 9]);
            let _ = manager.try_write(DRIVE, index, 0, &value.to_le_bytes());
        }
        8 => {
            let index = any(random, &[0x607A, 0x60FF, 0x60B1]);
            let _ = manager.try_write(DRIVE, index, 0, &target.to_le_bytes());
        }
        9 => {
            let index = any(
                random,
                &[0x6065, 0x6067, 0x6081, 0x6083, 0x6084, 0x6085, 0x60C5],
            );
            let value = any(random, &[0, 1, 1000, 1_000_000, u32::MAX]);
            let _ = manager.try_write(DRIVE, index, 0, &value.to_le_bytes());
        }
        10 => {
            let index = any(random, &[0x6071, 0x60B2, 0x6072, 0x6073, 0x6066, 0x6068]);
            let value = any(random, &[-1000_i16, 0, 300, 1000, i16::MAX]);
            let _ = manager.try_write(DRIVE, index, 0, &value.to_le_bytes());
        }
        _ => {
            let command = any(random, &[1, 1, 1, 2, 128, 130]);
            manager.send(0, &[command, 0x10]);
        }
    }
}

/// Checks what holds after every event. Returns the demand of the position.
fn check(manager: &mut Manager, seed: u64, before: Option<i32>) -> Option<i32> {
    let statusword = statusword(manager);
    let state = State::from_statusword(statusword);
    let state = state.unwrap_or_else(|| panic!("master {seed}: {statusword:#06x}"));
    let current = manager.current_amperes();
    assert!((-1.0..=1.0).contains(&current), "master {seed}: {current}");
    let is_powered = matches!(
        state,
        State::OperationEnabled | State::QuickStopActive | State::FaultReactionActive
    );
    assert!(
        is_powered || current == 0.0,
        "master {seed}: {current} A in {state:?}"
    );
    let [demand, actual] = [0x6062, 0x6064].map(|index| signed(manager, index));
    if let Some(before) = before {
        let is_ramp = (demand - before).abs() <= REACH;
        let is_at_motor = (demand - actual).abs() <= 600;
        assert!(
            is_ramp || is_at_motor,
            "master {seed}: from {before} to {demand}, at {actual}"
        );
    }
    Some(demand)
}

#[test]
fn a_thousand_random_masters_find_no_way_out_of_the_figure() {
    for seed in 0..MASTERS {
        let mut bytes = [0; 32];
        bytes[..8].copy_from_slice(&seed.to_le_bytes());
        let mut random = TestRng::from_seed(RngAlgorithm::ChaCha, &bytes);
        let mut manager = configured(any(&mut random, &[1, 3, 4, 8, 9, 10]));
        for controlword in [0x06_u16, 0x07, 0x0F] {
            manager.write(DRIVE, 0x6040, 0, &controlword.to_le_bytes());
        }
        let mut demand = None;
        for _ in 0..COMMANDS {
            send(&mut manager, &mut random);
            // A drive that is stopped does not answer SDOs.
            if random.next_u32().is_multiple_of(8) {
                manager.run_for(milliseconds(u64::from(random.next_u32() % 5)));
                demand = None;
            }
            manager.send(0, &[1, 0x10]);
            manager.sync();
            demand = check(&mut manager, seed, demand);
        }
    }
}
