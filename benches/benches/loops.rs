//! Instructions that one, two, four and eight loops on one bus take for one cycle in memory.

use std::fs;
use std::hint::black_box;
use std::path::Path;

use judge::{Circumstances, judge};
use plan::Plan;
use recording::capture::{Capture, Watch};
use recording::timeline::decode;
use worlds::catalogue::catalogue;
use worlds::lockstep::simulate;
use worlds::programs::Hosting;

use canrig_benches::limit;
use gungraun::prelude::*;

/// Number of cycles, large enough to make the bring-up of eight drives negligible; the benchmarks' names repeat it for
/// `benches/count_instructions`.
const CYCLES: u64 = 4000;
/// Limits for one, two, four and eight drives, three per cent more than were counted: 19 805, 37 540, 74 288 and 153 735. Each of
/// several drives may take 110 % of a single one.
const INSTRUCTIONS_PER_CYCLE_MAX: [u64; 4] = [20_400, 38_670, 76_520, 158_350];

const RIG: &str = "schema = 1\nname = \"bench\"\n[bus]\nsync_period_milliseconds = 4.0\n\
    [defaults.drive]\namplifier = { min = -1.0 }\nsensor = { resolution_bits = 16 }\ntruth_every_cycles = 10\n\
    [node.controller]\nkind = \"controller\"\nnode_id = 1\n";
const SCENARIO: &str = "schema = 1\nrig = \"rig.toml\"\nname = \"bench\"\nduration_seconds = 16.0\n\
    [controller.all.pid]\nproportional_amperes_per_metre = 22.8\nintegral_amperes_per_metre_second = 37.9\n\
    derivative_ampere_seconds_per_metre = 3.59\n";

/// Returns the plan of a rig with this many DC motors, each of which follows a sine.
fn loops(drives: u8) -> Plan {
    let (mut rig, mut scenario) = (RIG.to_owned(), SCENARIO.to_owned());
    for number in 0..drives {
        let node_id = 0x10 + number;
        rig += &format!(
            "[plant.motor_{number}.dc_motor]\n[loop.d{number}]\nfeedback = \"d{number}.position\"\noutputs = [\"d{number}.current\"]\n\
             [node.d{number}]\nkind = \"drive\"\nnode_id = {node_id}\n\
             amplifier.port = \"motor_{number}.current_amperes\"\nsensor.port = \"motor_{number}.position_metres\"\n"
        );
        scenario += &format!(
            "[[reference.sine]]\nloop = \"d{number}\"\nfrom_seconds = 0.0\ncentre_millimetres = 20.0\n\
             amplitude_millimetres = 10.0\nperiod_seconds = 2.0\n"
        );
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{drives}_drives"));
    fs::create_dir_all(&folder).expect("cargo's folder takes folders");
    fs::write(folder.join("rig.toml"), rig).expect("and files");
    let path = folder.join("scenario.toml");
    fs::write(&path, scenario).expect("and files");
    Plan::load(&path, catalogue()).expect("it is valid")
}

/// Limit for the joint with two wires: three per cent more instructions than were counted, which was 2.13 times as many as a
/// campaign with one wire takes. The aim is 2.2 times.
const PAIR_INSTRUCTIONS_PER_CYCLE_MAX: u64 = 47_270;

/// Returns the plan of the shipped joint with two wires, under its law along a sine: two drives on one plant in one loop.
fn pair() -> Plan {
    let rig = include_str!("../../scenarios/rigs/sma_pair.toml").replace(
        "sync_period_milliseconds = 2.0",
        "sync_period_milliseconds = 4.0",
    );
    let scenario = "schema = 1\nrig = \"rig.toml\"\nname = \"bench\"\nduration_seconds = 16.0\n\
        [controller.pid_pair]\n[[reference.sine]]\nfrom_seconds = 0.0\ncentre_degrees = 0.0\n\
        amplitude_degrees = 15.0\nperiod_seconds = 4.0\n";
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("pair");
    fs::create_dir_all(&folder).expect("cargo's folder takes folders");
    fs::write(folder.join("rig.toml"), rig).expect("and files");
    let path = folder.join("scenario.toml");
    fs::write(&path, scenario).expect("and files");
    Plan::load(&path, catalogue()).expect("it is valid")
}

/// Plays and judges the loops; returns the number of cycles of each.
fn played(plan: &Plan) -> Vec<usize> {
    let watch = Watch::default();
    let clock = plan.scenario_clock().expect("the bus has a SYNC");
    let mut capture = Capture::in_memory(clock, &watch);
    simulate(plan, &Hosting::default(), &mut capture).expect("they are played");
    let (frames, _) = capture.finish(plan).expect("the memory suffices");
    let timelines = decode(&frames, plan).expect("they are decoded");
    black_box(judge(plan, &timelines, &Circumstances::default()));
    let cycles = timelines.iter().map(|timeline| timeline.cycle.len());
    cycles.collect()
}

/// Checks the number of cycles by which the count is divided.
fn check(cycles: Vec<usize>) {
    for cycles in cycles {
        assert_eq!(u64::try_from(cycles), Ok(CYCLES), "cycles were played");
    }
}

/// Returns the limit of the run at this place in the list.
fn run_limit(place: usize) -> gungraun::LibraryBenchmarkConfig {
    limit(CYCLES * INSTRUCTIONS_PER_CYCLE_MAX[place])
}

#[library_benchmark]
#[bench::one_cycles_4000(args = (loops(1)), teardown = check, config = run_limit(0))]
#[bench::two_cycles_4000(args = (loops(2)), teardown = check, config = run_limit(1))]
#[bench::four_cycles_4000(args = (loops(4)), teardown = check, config = run_limit(2))]
#[bench::eight_cycles_4000(args = (loops(8)), teardown = check, config = run_limit(3))]
#[bench::pair_cycles_4000(args = (pair()), teardown = check, config = limit(CYCLES * PAIR_INSTRUCTIONS_PER_CYCLE_MAX))]
fn loops_in_memory(plan: Plan) -> Vec<usize> {
    black_box(played(&plan))
}

library_benchmark_group!(name = several, benchmarks = [loops_in_memory]);
main!(library_benchmark_groups = several);
