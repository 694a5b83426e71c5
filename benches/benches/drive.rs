//! Instructions that the drive's events take.

use std::hint::black_box;

use can::CanFrame;
use canrig_benches::{Bench, limit};
use gungraun::prelude::*;

/// Returns a drive one period after its latest SYNC: the next one triggers physics, the sample and TPDOs.
fn before_sync() -> Bench {
    let mut bench = Bench::heated();
    bench.wait();
    bench
}

#[library_benchmark(config = limit(6000))]
#[bench::operational(before_sync())]
fn sync_to_tpdo(mut bench: Bench) -> (Bench, Option<CanFrame>) {
    let answer = black_box(bench.sync());
    (bench, answer)
}

#[library_benchmark(config = limit(8000))]
#[bench::operational(Bench::heated())]
fn rpdo_to_apply(mut bench: Bench) -> (Bench, Option<CanFrame>) {
    // The command waits for the SYNC that makes it act.
    bench.deliver(black_box(&CanFrame::new(0x210, &[15, 0, 0x2C, 0x01])));
    let answer = black_box(bench.sync());
    (bench, answer)
}

#[library_benchmark(config = limit(2900))]
#[bench::operational(Bench::heated())]
fn sdo_expedited_upload(mut bench: Bench) -> (Bench, Option<CanFrame>) {
    let read = CanFrame::new(0x610, &[0x40, 0x00, 0x10, 0, 0, 0, 0, 0]);
    let answer = black_box(bench.deliver(black_box(&read)));
    (bench, answer)
}

library_benchmark_group!(
    name = drive,
    benchmarks = [sync_to_tpdo, rpdo_to_apply, sdo_expedited_upload]
);
main!(library_benchmark_groups = drive);
