//! The random numbers and the cycles of each loop on a bus.

use canopen::object_dictionary::Preset;

/// Spreads small numbers over all bits: 2^64 divided by the golden ratio.
const GOLDEN_RATIO: u64 = 0x9E37_79B9_7F4A_7C15;
/// Number of cycles from one publication of a loop's terms to the next (the transmission type of the controller's TPDOs).
pub const TERMS_EVERY_CYCLES: u8 = 10;
/// Node-ID of the drive in the shipped DBC.
const DRIVE_NODE_ID: u32 = 0x10;

/// Returns the seed of a drive's random numbers: each drive has other noise; that of the shipped rig has the scenario's
/// seed.
pub fn drive_seed(seed: u64, drive_node_id: u8) -> u64 {
    let distance = u64::from(drive_node_id) ^ u64::from(DRIVE_NODE_ID);
    seed ^ distance.wrapping_mul(GOLDEN_RATIO)
}

/// Returns the cycles in which the controller publishes the terms of the loop with this number, as their remainder by
/// [`TERMS_EVERY_CYCLES`]. Each loop has its own, since all terms at once would fill several cycles and delay commands and SYNC.
pub fn terms_cycle(loop_number: u8) -> u8 {
    loop_number % TERMS_EVERY_CYCLES
}

/// Returns the cycles in which the drive of the loop with this number publishes the truth about its plant, as their remainder by
/// the number of cycles from one publication to the next. As far as possible, no other drive publishes in them, and no terms are
/// sent.
pub fn truth_cycle(loop_number: u8, every_cycles: u8) -> u8 {
    let every = every_cycles.max(1);
    (loop_number + (every / 2).min(TERMS_EVERY_CYCLES / 2)) % every
}

/// Returns the values that the drive of a loop has in its data sheet: the transmission type (1 to 240 of CiA 301, 7.5.2.37) and
/// the SYNC start value of its truth, as [`truth_cycle`].
pub fn truth_presets(loop_number: u8, every_cycles: u8) -> [Preset; 4] {
    // SYNCs count from 1; 0 is no start value.
    let start = match truth_cycle(loop_number, every_cycles) {
        0 if every_cycles > 1 => every_cycles,
        cycle => cycle,
    };
    let [second, third] = TRUTH_PDOS;
    [
        Preset::new(second, TRANSMISSION_TYPE, every_cycles.into()),
        Preset::new(second, SYNC_START_VALUE, start.into()),
        Preset::new(third, TRANSMISSION_TYPE, every_cycles.into()),
        Preset::new(third, SYNC_START_VALUE, start.into()),
    ]
}

/// Communication parameters of the TPDOs that hold the truth about a drive's plant.
const TRUTH_PDOS: [u16; 2] = [0x1801, 0x1802];
/// Sub-indices of the transmission type and the SYNC start value (CiA 301, 7.5.2.37).
const TRANSMISSION_TYPE: u8 = 2;
const SYNC_START_VALUE: u8 = 6;
