//! Tests of a faulty node, seen from the bus.

use can::CanFrame;
use dbc::Database;
use scenario::fault::{Form, Group, KINDS, Kind, Time};

use super::*;

/// Node that sends a heartbeat every 10 ms, and answers every frame 0x300 at once.
#[derive(Debug, Default)]
struct Ticker {
    next: Duration,
    ticks: u64,
    queue: Vec<CanFrame>,
}

impl Node for Ticker {
    fn filters(&self) -> Vec<Filter> {
        vec![Filter::exact(0x300)]
    }

    fn on_frame(&mut self, _now: Duration, frame: &CanFrame) {
        if frame.standard_id() == Some(0x300) {
            self.queue.push(CanFrame::new(0x301, frame.data()));
        }
    }

    fn on_tick(&mut self, now: Duration) {
        if now >= self.next {
            self.ticks += 1;
            self.next = now + Duration::from_millis(10);
            self.queue.push(CanFrame::new(0x710, &[5]));
        }
    }

    fn on_stop(&mut self, _now: Duration) {}

    fn next_frame(&mut self) -> Option<CanFrame> {
        (!self.queue.is_empty()).then(|| self.queue.remove(0))
    }

    fn next_deadline(&self) -> Option<Duration> {
        Some(self.next)
    }

    fn progress(&self) -> Progress {
        Progress::Running
    }
}

fn milliseconds(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

/// A node with one fault from 50 ms to 100 ms; the scenario begins at 0.
fn clock() -> ScenarioClock {
    ScenarioClock::new(Database::shipped(), ["drive"]).unwrap()
}

fn faulty(kind: &str, keys: &str) -> Faulty<Ticker> {
    let times = "from_seconds = 0.05\nuntil_seconds = 0.1\nnode = \"drive\"\n";
    node_with(&format!("[[fault.node.{kind}]]\n{times}{keys}"))
}

fn node_with(fault: &str) -> Faulty<Ticker> {
    let text = format!(
        "schema = 1\nrig = \"sma_actuator\"\nname = \"t\"\nduration_seconds = 9.0\n[controller.open_loop]\n{fault}"
    );
    let trial = testing::part(&text, "drive");
    let plan = FaultPlan::new(&trial.run.faults, 0x10);
    let mut node = Faulty::new(Ticker::default(), plan, clock(), |ticker| {
        *ticker = Ticker::default()
    });
    node.on_frame(
        Duration::ZERO,
        &CanFrame::new(0x190, &[0x37, 2, 0, 0, 0, 0, 0, 0]),
    );
    node.on_frame(Duration::ZERO, &CanFrame::new(0x080, &[1]));
    assert_eq!(node.scenario_zero(), Some(Duration::ZERO));
    node
}

/// Runs the node by its deadlines with a frame 0x300 every 20 ms; returns its frames, with times in milliseconds.
fn run(node: &mut Faulty<Ticker>, until: u64) -> Vec<(u64, u16)> {
    let mut sent = Vec::new();
    let mut asked = milliseconds(15);
    loop {
        let deadline = node.next_deadline().unwrap_or(Duration::MAX).max(node.now);
        let now = deadline.min(asked);
        if now > milliseconds(until) {
            return sent;
        }
        if now == asked {
            node.on_frame(now, &CanFrame::new(0x300, &[]));
            asked += milliseconds(20);
        } else {
            node.on_tick(now);
        }
        while let Some(frame) = node.next_frame() {
            let time = u64::try_from(now.as_millis()).unwrap();
            sent.push((time, frame.standard_id().unwrap()));
        }
    }
}

fn times(sent: &[(u64, u16)], id: u16) -> Vec<u64> {
    sent.iter()
        .filter(|(_, of)| *of == id)
        .map(|(time, _)| *time)
        .collect()
}

#[test]
fn each_fault_with_a_time_changes_what_a_node_sends() {
    let sound = run(&mut node_with(""), 130);
    // The bench sends the order of `nmt_stop`.
    let is_played_here = |kind: &&Kind| {
        kind.group == Group::Node && kind.time != Time::Boot && kind.name != "nmt_stop"
    };
    for kind in KINDS.iter().filter(is_played_here) {
        let times = match kind.time {
            Time::Instant => "at_seconds = 0.055\n",
            _ => "from_seconds = 0.05\nuntil_seconds = 0.1\n",
        };
        let keys = kind.keys.iter().map(|key| match key.form {
            Form::Number(_, max) => format!("{} = {max:?}\n", key.name),
            Form::Whole(_, max) => format!("{} = {max}\n", key.name),
            Form::Word(words) => format!("{} = \"{}\"\n", key.name, words[0].0),
            Form::Node | Form::Station => format!("{} = \"drive\"\n", key.name),
        });
        let fault = format!("{}\n{times}{}", kind.heading(), String::from_iter(keys));
        assert_ne!(run(&mut node_with(&fault), 130), sound, "{fault}");
    }
}

#[test]
fn a_dead_node_is_silent_and_boots_anew() {
    let mut node = faulty("crash", "output = \"hold\"\n");
    let sent = run(&mut node, 130);
    assert_eq!(times(&sent, 0x710), [0, 10, 20, 30, 40, 100, 110, 120, 130]);
    assert_eq!(times(&sent, 0x301), [15, 35, 115]);
    assert_eq!(node.node().ticks, 4, "its memory is new");
}

#[test]
fn a_hanging_node_goes_on_with_what_was_kept_for_it() {
    let mut node = faulty("hang", "");
    let sent = run(&mut node, 130);
    assert_eq!(times(&sent, 0x710), [0, 10, 20, 30, 40, 100, 110, 120, 130]);
    assert_eq!(times(&sent, 0x301), [15, 35, 100, 100, 100, 115]);
    assert_eq!(node.node().ticks, 9, "its memory stays");
}

#[test]
fn a_slow_node_answers_late_and_a_heartbeat_is_lost_alone() {
    let sent = run(&mut faulty("slow_cycle", "delay_milliseconds = 3.0\n"), 130);
    assert_eq!(times(&sent, 0x301), [15, 35, 58, 78, 98, 115]);
    let sent = run(&mut faulty("lost_heartbeat", ""), 130);
    assert_eq!(times(&sent, 0x710), [0, 10, 20, 30, 40, 100, 110, 120, 130]);
    assert_eq!(times(&sent, 0x301), [15, 35, 55, 75, 95, 115]);
}

#[test]
fn a_fast_clock_ticks_more_often() {
    let mut node = faulty("clock_drift", "parts_per_million = 250000.0\n");
    let sent = run(&mut node, 110);
    assert_eq!(
        times(&sent, 0x710),
        [0, 10, 20, 30, 40, 50, 58, 66, 74, 82, 90, 98, 107]
    );
    let ahead = node.clock.node_time(node.now) - node.now;
    assert!(ahead.abs_diff(Duration::from_micros(12_500)) < Duration::from_micros(1));
}

#[test]
fn a_late_node_is_silent_until_it_boots() {
    let plan = FaultPlan {
        number: 0x10,
        late_boot: milliseconds(35),
        faults: Vec::new(),
    };
    let mut node = Faulty::new(Ticker::default(), plan, clock(), |_| {});
    let sent = run(&mut node, 60);
    assert_eq!(times(&sent, 0x710), [35, 45, 55]);
}
