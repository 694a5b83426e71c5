//! `platform` on a kernel CAN bus. These tests make their interfaces themselves.

use std::process::Command;
use std::time::Duration;

use can::frame::ERROR_FLAG;
use can::{CanFrame, Filter, Node, Progress};
use platform::bus::Bus;
use platform::clock::Clock;
use platform::lockstep::{
    ANSWER_PATIENCE, Answer, Failure, FollowError, Participant, Remote, Setting, channel, follow,
};
use platform::real_time;
use platform::recorder::Recorder;
use platform::stop::StopSignal;

use crate::counting_allocator::allocations;
use crate::echo::Echo;

const SOON: Duration = Duration::from_secs(5);
const NOT: Duration = Duration::from_millis(50);
const MS: Duration = Duration::from_millis(1);

pub(crate) const TESTS: [(&str, fn()); 8] = [
    (
        "frames_reach_those_who_want_them_and_not_their_sender",
        frames_reach_those_who_want_them_and_not_their_sender,
    ),
    (
        "what_the_kernel_drops_is_counted",
        what_the_kernel_drops_is_counted,
    ),
    (
        "the_recorder_hears_everyone_and_stamps_in_order",
        the_recorder_hears_everyone_and_stamps_in_order,
    ),
    (
        "an_interface_that_is_missing_or_down_says_what_to_do",
        an_interface_that_is_missing_or_down_says_what_to_do,
    ),
    (
        "carries_the_frames_of_lock_step",
        carries_the_frames_of_lock_step,
    ),
    (
        "a_foreign_frame_in_lock_step_is_an_error",
        a_foreign_frame_in_lock_step_is_an_error,
    ),
    (
        "the_real_time_loop_allocates_nothing_in_the_bus",
        the_real_time_loop_allocates_nothing_in_the_bus,
    ),
    ("a_node_runs_in_real_time", a_node_runs_in_real_time),
];

/// A virtual interface, which is removed when dropped.
struct Vcan(&'static str);

impl Vcan {
    fn new(name: &'static str) -> Self {
        ip(&["link", "add", "dev", name, "type", "vcan"]);
        let vcan = Self(name);
        vcan.set("up");
        vcan
    }

    fn set(&self, state: &str) {
        ip(&["link", "set", self.0, state]);
    }

    fn join(&self, filters: &[Filter]) -> Box<dyn Bus> {
        platform::open(&self.0.parse().unwrap(), filters).unwrap()
    }
}

impl Drop for Vcan {
    fn drop(&mut self) {
        ip(&["link", "delete", self.0]);
    }
}

pub(crate) fn ip(arguments: &[&str]) {
    let status = Command::new("ip").args(arguments).status().unwrap();
    assert!(status.success(), "ip {arguments:?} failed");
}

fn frame(id: u16, byte: u8) -> CanFrame {
    CanFrame::new(id, &[byte])
}

fn frames_reach_those_who_want_them_and_not_their_sender() {
    let vcan = Vcan::new("vcan-frames");
    let mut everything = vcan.join(&[Filter::ALL]);
    let mut some = vcan.join(&[Filter::exact(0x190), Filter::exact(0x80)]);
    let mut nothing = vcan.join(&[]);
    let mut errors = vcan.join(&[Filter::ERRORS]);
    let error = CanFrame::from_raw(ERROR_FLAG | 4, 8, [0, 1, 0, 0, 0, 0, 0, 0]).unwrap();
    let extended = CanFrame::from_raw(0x8000_0190, 1, [7; 8]).unwrap();
    let remote = CanFrame::from_raw(0x4000_0190, 0, [0; 8]).unwrap();

    some.send(&error).unwrap();
    everything.send(&extended).unwrap();
    everything.send(&remote).unwrap();
    everything.send(&frame(0x190, 1)).unwrap();
    everything.send(&frame(0x191, 2)).unwrap();
    nothing.send(&frame(0x80, 3)).unwrap();

    assert_eq!(some.receive(SOON).unwrap(), Some(frame(0x190, 1)));
    assert_eq!(some.receive(SOON).unwrap(), Some(frame(0x80, 3)));
    assert_eq!(some.receive(NOT).unwrap(), None);
    assert_eq!(everything.receive(SOON).unwrap(), Some(frame(0x80, 3)));
    assert_eq!(everything.receive(NOT).unwrap(), None);
    assert_eq!(nothing.receive(NOT).unwrap(), None);
    assert_eq!(errors.receive(SOON).unwrap(), Some(error));
    assert_eq!(errors.receive(NOT).unwrap(), None);
    assert_eq!(some.dropped(), 0);
}

fn what_the_kernel_drops_is_counted() {
    let vcan = Vcan::new("vcan-drops");
    let mut asleep = vcan.join(&[Filter::ALL]);
    let mut sender = vcan.join(&[]);
    for round in 0..3000_u32 {
        sender
            .send(&CanFrame::new(0x100, &round.to_le_bytes()))
            .unwrap();
        // The kernel's own queue before the sockets holds 1000 frames, and its losses are not counted.
        if round % 500 == 499 {
            std::thread::sleep(10 * MS);
        }
    }
    let mut kept = 0;
    while asleep.receive(NOT).unwrap().is_some() {
        kept += 1;
    }
    let dropped = asleep.dropped();
    assert!(dropped > 0);
    assert_eq!(kept + dropped, 3000);
}

fn the_recorder_hears_everyone_and_stamps_in_order() {
    let vcan = Vcan::new("vcan-record");
    let mut recorder = Recorder::on_interface(vcan.0).unwrap();
    let mut first = vcan.join(&[]);
    let mut second = vcan.join(&[]);
    let clock = Clock::start();
    for round in 0..250 {
        first.send(&frame(0x100, round)).unwrap();
        second.send(&frame(0x200, round)).unwrap();
    }
    recorder.stop();
    let duration = clock.now() + recorder.clock.wall_clock_step() + MS;
    let mut frames = vec![];
    while let Some(stamped) = recorder.next() {
        frames.push(stamped);
    }
    assert_eq!(recorder.lost(), 0);
    assert_eq!(frames.len(), 500);
    assert!(frames.is_sorted_by_key(|stamped| stamped.time));
    let length = frames[499].time - frames[0].time;
    assert!(length > Duration::ZERO && length < duration, "{length:?}");
    assert_eq!(frames[3].frame, frame(0x200, 1));
    // A value from before 2020 would not be of this wall clock.
    assert!(recorder.clock.wall_epoch() > Duration::from_secs(1_577_836_800));
}

fn an_interface_that_is_missing_or_down_says_what_to_do() {
    let error = |name: &str| {
        platform::open(&name.parse().unwrap(), &[])
            .err()
            .unwrap()
            .to_string()
    };
    assert_eq!(
        error("vcan-none"),
        "CAN interface vcan-none does not exist; make a virtual one with: ip link add dev vcan-none type vcan && ip link set vcan-none up"
    );
    assert!(error("lo").starts_with("lo is no CAN interface"));
    let vcan = Vcan::new("vcan-down");
    let mut bus = vcan.join(&[Filter::ALL]);
    vcan.set("down");
    assert!(error("vcan-down").starts_with("CAN interface vcan-down is down"));
    for result in [bus.receive(SOON).map(drop), bus.send(&frame(1, 1))] {
        let error = result.unwrap_err().to_string();
        assert!(
            error.starts_with("CAN interface vcan-down is down"),
            "{error}"
        );
    }
}

/// Steps an echo over a wire; `on_wire` are the frames there for the announced `100#01`.
fn step_over_wire(
    name: &'static str,
    on_wire: &[CanFrame],
) -> (Result<Progress, Failure>, Result<(), FollowError>) {
    let vcan = Vcan::new(name);
    let mut coordinator = vcan.join(&[]);
    let (ours, theirs) = channel().unwrap();
    let mut echo = Echo::new(MS);
    let mut wire = vcan.join(&echo.filters());
    let echo = std::thread::spawn(move || follow(&mut echo, theirs, Some(wire.as_mut())));
    let mut remote =
        Remote::accept("echo", ours, Some(ANSWER_PATIENCE), Setting::default()).unwrap();
    for frame in on_wire {
        coordinator.send(frame).unwrap();
    }
    let (mut answer, now) = (Answer::default(), MS / 2);
    let stepped = remote.advance(now, now, &[(now, frame(0x100, 1))], &mut answer);
    let progress = stepped.map(|()| answer.progress.clone());
    if matches!(progress, Ok(Progress::Running)) {
        assert_eq!(answer.frames[1], (now, frame(0x101, 1)));
        remote.stop(MS, &mut answer).unwrap();
    }
    drop(remote);
    (progress, echo.join().unwrap())
}

fn carries_the_frames_of_lock_step() {
    let (progress, outcome) = step_over_wire("vcan-step", &[frame(0x555, 0), frame(0x100, 1)]);
    assert_eq!(progress.unwrap(), Progress::Running);
    outcome.unwrap();
}

fn a_foreign_frame_in_lock_step_is_an_error() {
    let (progress, outcome) = step_over_wire("vcan-foreign", &[frame(0x100, 2), frame(0x100, 1)]);
    assert!(matches!(progress.unwrap_err(), Failure::Ended));
    let error = outcome.unwrap_err().to_string();
    assert!(error.contains("is another program sending"), "{error}");
}

fn the_real_time_loop_allocates_nothing_in_the_bus() {
    let vcan = Vcan::new("vcan-loop");
    let mut bus = vcan.join(&[Filter::exact(0x100)]);
    let mut other = vcan.join(&[]);
    let mut exchange = || {
        for round in 0..200 {
            other.send(&frame(0x100, round)).unwrap();
            assert_eq!(bus.receive(SOON).unwrap(), Some(frame(0x100, round)));
        }
        assert_eq!(bus.receive(MS).unwrap(), None);
        allocations()
    };
    // The process's first use of the clock determines the method.
    let before = exchange();
    assert_eq!(exchange(), before);
}

fn a_node_runs_in_real_time() {
    let vcan = Vcan::new("vcan-time");
    let mut other = vcan.join(&[Filter::exact(0x101)]);
    let mut bus = vcan.join(&[Filter::exact(0x100)]);
    let (stopper, stop) = StopSignal::manual().unwrap();
    let echo = std::thread::spawn(move || {
        let mut echo = Echo::new(5 * MS);
        real_time::run(&mut echo, bus.as_mut(), &stop)
    });
    for round in 0..50 {
        other.send(&frame(0x100, round)).unwrap();
        assert_eq!(other.receive(SOON).unwrap(), Some(frame(0x101, round)));
    }
    drop(stopper);
    let report = echo.join().unwrap().unwrap();
    assert_eq!(report.frames_received, 50);
    assert_eq!(report.frames_dropped, 0);
}
