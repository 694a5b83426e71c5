use std::cell::Cell;
use std::thread::JoinHandle;

use can::{CanFrame, Filter};

use super::*;
use crate::counting_allocator::allocations;
use crate::hub::Hub;
use crate::recorder::Recorder;
use crate::stop::Stopper;
use crate::testing::Echo;

const MS: Duration = Duration::from_millis(1);
const SOON: Duration = Duration::from_secs(5);

/// Echo that runs in a thread on a bus, and a second participant that hears everything.
struct Bench {
    hub: Hub,
    recorder: Recorder,
    other: Box<dyn Bus>,
    stopper: Option<Stopper>,
    echo: JoinHandle<(Echo, Result<RunReport, RunError>)>,
}

fn bench(mut echo: Echo) -> Bench {
    let (hub, recorder) = Hub::start().unwrap();
    let other = crate::open(&hub.address(), &[Filter::ALL]).unwrap();
    let (stopper, stop) = StopSignal::manual().unwrap();
    let mut bus = crate::open(&hub.address(), &echo.filters()).unwrap();
    Bench {
        hub,
        recorder,
        other,
        stopper: Some(stopper),
        echo: std::thread::spawn(move || {
            let result = run(&mut echo, bus.as_mut(), &stop);
            (echo, result)
        }),
    }
}

impl Bench {
    /// Returns the data of the next frame with this identifier.
    fn next(&mut self, id: u16) -> Vec<u8> {
        loop {
            let frame = self.other.receive(SOON).unwrap().unwrap();
            if frame.standard_id() == Some(id) {
                return frame.data().to_vec();
            }
        }
    }

    fn stop(&mut self) {
        drop(self.stopper.take());
    }
}

#[test]
fn a_node_ticks_answers_and_stops() {
    let mut echo = Echo::new(MS);
    echo.stops_after = 20 * MS;
    let mut bench = bench(echo);
    for round in 0..50 {
        bench.other.send(&CanFrame::new(0x100, &[round])).unwrap();
        assert_eq!(bench.next(0x101), [round]);
        bench.next(0x200);
    }
    bench.stop();
    assert_eq!(bench.next(0x300), []);
    let (echo, result) = bench.echo.join().unwrap();
    let report = result.unwrap();
    assert_eq!(report.ticks, u64::from(echo.ticks));
    assert!(report.ticks >= 50, "{report}");
    assert_eq!(report.lateness_nanoseconds.len(), report.ticks);
    assert_eq!(report.frames_received, 50);
    assert_eq!(report.frames_sent, report.ticks + 50 + 1);
    assert_eq!(report.frames_dropped, 0);
    // All sent frames were recorded, with the pings.
    drop(bench.hub);
    let mut recorded = 0;
    while bench.recorder.next().is_some() {
        recorded += 1;
    }
    assert_eq!(recorded, report.frames_sent + 50);
    assert_eq!(bench.recorder.lost(), 0);
}

#[test]
fn a_node_is_ticked_at_its_deadlines_and_not_before() {
    let (hub, _recorder) = Hub::start().unwrap();
    let mut bus = crate::open(&hub.address(), &[]).unwrap();
    let (_stopper, stop) = StopSignal::manual().unwrap();
    let mut echo = Echo::new(MS);
    echo.stop_at = Some(200 * MS);
    let mut node = Watched::new(echo, |_| ());
    let report = run(&mut node, bus.as_mut(), &stop).unwrap();
    let echo = node.echo;
    // The node's deadlines are absolute, so late ticks are followed by the ones that they held up.
    assert_eq!(report.ticks, u64::from(echo.ticks));
    assert_eq!(echo.earliest_tick, Some(Duration::ZERO));
    assert!(echo.ticks <= 201, "{report}");
    // The loop sleeps in between.
    assert!(node.looks.get() <= 2 * echo.ticks, "{report}");
}

/// Echo, with work after each tick.
struct Watched<F> {
    echo: Echo,
    work: F,
    /// Number of times that the loop has asked for its progress.
    looks: Cell<u32>,
}

impl<F: FnMut(&mut Echo)> Watched<F> {
    fn new(echo: Echo, work: F) -> Self {
        Self {
            echo,
            work,
            looks: Cell::new(0),
        }
    }
}

impl<F: FnMut(&mut Echo)> Node for Watched<F> {
    fn filters(&self) -> Vec<Filter> {
        self.echo.filters()
    }
    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.echo.on_frame(now, frame);
    }
    fn on_tick(&mut self, now: Duration) {
        self.echo.on_tick(now);
        (self.work)(&mut self.echo);
    }
    fn on_stop(&mut self, now: Duration) {
        self.echo.on_stop(now);
    }
    fn next_frame(&mut self) -> Option<CanFrame> {
        self.echo.next_frame()
    }
    fn next_deadline(&self) -> Option<Duration> {
        self.echo.next_deadline()
    }
    fn progress(&self) -> Progress {
        self.looks.update(|looks| looks + 1);
        self.echo.progress()
    }
}

#[test]
fn overruns_are_counted() {
    let (hub, _recorder) = Hub::start().unwrap();
    let mut bus = crate::open(&hub.address(), &[]).unwrap();
    let (_stopper, stop) = StopSignal::manual().unwrap();
    let mut slow = Watched::new(Echo::new(MS), |echo: &mut Echo| {
        if echo.ticks.is_multiple_of(10) {
            crate::clock::sleep(3 * MS);
        }
        if echo.ticks == 50 {
            echo.progress = Progress::Stopped;
        }
    });
    let report = run(&mut slow, bus.as_mut(), &stop).unwrap();
    assert!(report.overruns >= 10, "{report}");
    assert!(report.lateness_nanoseconds.max() >= 1_900_000, "{report}");
}

#[test]
fn the_loop_allocates_nothing_after_its_start() {
    let (hub, _recorder) = Hub::start().unwrap();
    let mut other = crate::open(&hub.address(), &[Filter::exact(0x101)]).unwrap();
    let mut bus = crate::open(&hub.address(), &[Filter::exact(0x100)]).unwrap();
    let (stopper, stop) = StopSignal::manual().unwrap();
    let node = std::thread::spawn(move || {
        let (mut first, mut latest) = (None, 0);
        let mut node = Watched::new(Echo::new(MS / 10), |_: &mut Echo| {
            latest = allocations();
            first.get_or_insert(latest);
        });
        let before = allocations();
        run(&mut node, bus.as_mut(), &stop).unwrap();
        assert!(allocations() > before, "the allocator does not count");
        let echo = node.echo;
        (echo, first, latest)
    });
    let clock = Clock::start();
    let mut pings = 0;
    while pings < 200 || clock.now() < 50 * MS {
        other.send(&CanFrame::new(0x100, &[])).unwrap();
        other.receive(SOON).unwrap().unwrap();
        pings += 1;
    }
    drop(stopper);
    let (echo, first, latest) = node.join().unwrap();
    assert_eq!(echo.received, pings);
    // Their number depends on the machine.
    assert!(echo.ticks > 10, "{} ticks", echo.ticks);
    assert_eq!(first, Some(latest));
}

#[test]
fn a_node_that_fails_ends_the_loop_with_its_message() {
    let mut bench = bench(Echo::new(MS));
    bench.other.send(&CanFrame::new(0x1FF, &[])).unwrap();
    let error = bench.echo.join().unwrap().1.unwrap_err();
    assert_eq!(error.to_string(), "the echo was ordered to fail");
}

#[test]
fn a_node_that_does_not_stop_ends_the_loop() {
    let mut echo = Echo::new(MS);
    echo.stops_after = 2 * STOP_PATIENCE;
    let mut bench = bench(echo);
    let clock = Clock::start();
    bench.stop();
    let error = bench.echo.join().unwrap().1.unwrap_err();
    assert_eq!(error.to_string(), "the node did not stop within 500 ms");
    assert!(clock.now() >= STOP_PATIENCE);
}

#[test]
fn a_deadline_that_does_not_move_ends_the_loop() {
    let bench = bench(Echo::new(Duration::ZERO));
    let ended = bench.echo.join().unwrap().1.unwrap_err();
    let error = ended.to_string();
    assert!(error.ends_with("its deadline does not move"), "{error}");
}

#[test]
fn the_end_of_the_bus_ends_the_loop() {
    let mut bench = bench(Echo::new(MS));
    bench.next(0x200);
    drop(bench.hub);
    let error = bench.echo.join().unwrap().1.unwrap_err();
    assert!(
        matches!(&error, RunError::Bus(ended) if ended.to_string().ends_with(" ended")),
        "{error}"
    );
}

#[test]
fn a_late_wake_up_is_the_machines_if_the_loop_waited_before_the_deadline() {
    let (hub, _recorder) = Hub::start().unwrap();
    let mut bus = crate::open(&hub.address(), &[]).unwrap();
    let mut echo = Echo::new(MS);
    let mut late_of = |waits_since, woken_at| {
        let mut cycle = Cycle {
            node: &mut echo,
            bus: bus.as_mut(),
            clock: Clock::start(),
            report: RunReport::new(),
            waits_since,
            stop_asked_at: None,
            ticks_at_deadline: 0,
        };
        cycle.note_late(5 * MS, woken_at);
        let on_monotonic = |time| nanoseconds(cycle.clock.on_monotonic(time));
        let expected = [5 * MS, woken_at].map(on_monotonic);
        assert!(cycle.report.late.iter().all(|late| *late == expected));
        cycle.report.late.len()
    };
    let late = 5 * MS + LATE_MIN + Duration::from_nanos(1);
    assert_eq!(late_of(5 * MS, late), 1);
    assert_eq!(late_of(5 * MS, 5 * MS + LATE_MIN), 0);
    assert_eq!(late_of(6 * MS, late), 0, "the node was late by itself");
}
