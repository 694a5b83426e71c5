//! Instructions that a sweep takes for one cycle, from the case's number to its row: everything except the disk.

use std::hint::black_box;
use std::path::Path;

// The parts of `canrig sweep`.
use campaigns::campaign::play_one;
use campaigns::sweep::row::{Ended, SweepRow};
use campaigns::sweep::sweep_cases::SweepCases;
use dbc::{CONTROLLER_EDS, DISTURBANCE_EDS, DRIVE_EDS};
use plan::Plan;
use recording::capture::Watch;
use worlds::catalogue::catalogue;

use canrig_benches::limit;
use gungraun::prelude::*;

const SWEEP: &str = "../scenarios/sweeps/plants.toml";
/// Cases with a plant that the controller does not know, without and with noise at the sensor.
const CASES: [usize; 2] = [1, 201];
/// Number of cycles of these cases, repeated in the benchmark's name for `benches/count_instructions`.
const CYCLES: u64 = 24_000;
/// Limit for one case, which resolves its scenario and the rig that it names: 22 461 were counted when the limit was set. 730 of
/// them are for the law that learns whether its wire remembers, 150 for the list of nodes that all parts of a run share.
const INSTRUCTIONS_PER_CYCLE_MAX: u64 = 22_500;

/// Number of cases that are resolved without being played.
const CASES_RESOLVED: usize = 100;
/// Limit for one of them: 2 007 312 were counted when it was set.
const INSTRUCTIONS_PER_CASE_MAX: u64 = 2_200_000;

/// Returns the cases of the sweep to play.
fn cases() -> SweepCases {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(SWEEP);
    let plan = Plan::load(&file, catalogue()).expect("the shipped sweep is valid");
    // Read once for all cases of a sweep, however many they are.
    let sheets = [
        (CONTROLLER_EDS, 0x01),
        (DRIVE_EDS, 0x10),
        (DISTURBANCE_EDS, 0x11),
    ];
    for (sheet, node_id) in sheets {
        dbc::dictionary(sheet, node_id).expect("the data sheets ship");
    }
    SweepCases::new(&plan).expect("it is a sweep")
}

/// Plays a case as a thread of `canrig sweep` does; returns its row, and its number of cycles.
fn played(plan: &SweepCases, number: usize) -> (SweepRow, usize) {
    let case = plan.case(number);
    let loops = case.plan().expect("the case is valid");
    let row = play_one(number, &loops, &Watch::default(), |played| {
        let row = SweepRow::from_verdict(number, &case.id, played.verdict);
        (row, played.only_timeline().unwrap().cycle.len())
    });
    row.expect("the case is played")
}

/// Checks the number of cycles by which the count is divided.
fn check(rows: [(SweepRow, usize); CASES.len()]) {
    let cycles: usize = rows.iter().map(|(_, cycles)| cycles).sum();
    assert_eq!(u64::try_from(cycles), Ok(CYCLES), "cycles were played");
    for (row, _) in rows {
        assert_eq!(row.ended, Ended::Pass, "{row:?}");
    }
}

#[library_benchmark(config = limit(CYCLES * INSTRUCTIONS_PER_CYCLE_MAX))]
#[bench::cycles_24000(args = (cases()), teardown = check)]
fn sweep_in_memory(plan: SweepCases) -> [(SweepRow, usize); CASES.len()] {
    CASES.map(|number| black_box(played(&plan, number)))
}

// The texts of cases become plans, with the values of the case in the rig.
#[library_benchmark(config = limit(CASES_RESOLVED as u64 * INSTRUCTIONS_PER_CASE_MAX))]
#[bench::cases_100(args = (cases()))]
fn cases_resolved(sweep: SweepCases) -> usize {
    let plans = (1..=CASES_RESOLVED).map(|number| sweep.case(number).plan());
    plans.filter(|plan| black_box(plan).is_ok()).count()
}

library_benchmark_group!(
    name = campaign,
    benchmarks = [sweep_in_memory, cases_resolved]
);
main!(library_benchmark_groups = campaign);
