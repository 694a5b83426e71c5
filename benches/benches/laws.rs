//! Instructions that one cycle of each control law takes, with its terms.

use std::hint::black_box;

use canrig_benches::{HeldLaw, law_in_a_hold, limit};
use gungraun::prelude::*;
use scenario::controller::{Controller, CurrentRamp, OpenLoop, Pid, SlidingMode, SlidingModePaper};

fn sliding_mode() -> Box<HeldLaw> {
    law_in_a_hold(&Controller {
        sliding_mode: Some(SlidingMode::default()),
        ..Controller::default()
    })
}

fn sliding_mode_paper() -> Box<HeldLaw> {
    law_in_a_hold(&Controller {
        sliding_mode_paper: Some(SlidingModePaper::default()),
        ..Controller::default()
    })
}

fn pid() -> Box<HeldLaw> {
    law_in_a_hold(&Controller {
        pid: Some(Pid::default()),
        ..Controller::default()
    })
}

fn open_loop() -> Box<HeldLaw> {
    let ramp = CurrentRamp {
        from_seconds: 0.0,
        until_seconds: 10.0,
        current: 1.0,
    };
    law_in_a_hold(&Controller {
        open_loop: Some(OpenLoop {
            ramp: vec![ramp],
            ..OpenLoop::default()
        }),
        ..Controller::default()
    })
}

/// On the heap, so that moving the law in and out is no part of what is counted.
fn cycle(held: Box<HeldLaw>) -> Box<HeldLaw> {
    let mut held = black_box(held);
    held.step();
    held
}

#[library_benchmark(config = limit(3400))]
#[bench::hold(sliding_mode())]
fn sliding_mode_cycle(start: Box<HeldLaw>) -> Box<HeldLaw> {
    cycle(start)
}

#[library_benchmark(config = limit(990))]
#[bench::hold(sliding_mode_paper())]
fn sliding_mode_paper_cycle(start: Box<HeldLaw>) -> Box<HeldLaw> {
    cycle(start)
}

#[library_benchmark(config = limit(270))]
#[bench::hold(pid())]
fn pid_cycle(start: Box<HeldLaw>) -> Box<HeldLaw> {
    cycle(start)
}

#[library_benchmark(config = limit(225))]
#[bench::hold(open_loop())]
fn open_loop_cycle(start: Box<HeldLaw>) -> Box<HeldLaw> {
    cycle(start)
}

library_benchmark_group!(
    name = laws,
    benchmarks = [
        sliding_mode_cycle,
        sliding_mode_paper_cycle,
        pid_cycle,
        open_loop_cycle
    ]
);
main!(library_benchmark_groups = laws);
