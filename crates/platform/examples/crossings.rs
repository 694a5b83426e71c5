//! How fast frames and steps cross between processes on this machine:
//! `cargo run --release -p platform --example crossings [-- vcan0]`.
#![expect(clippy::print_stdout, reason = "a program that shows numbers")]

use std::error::Error;
use std::process::Child;
use std::time::Duration;

use can::{CanFrame, Filter, Node, Progress};
use platform::bus::{Bus, BusAddress};
use platform::clock::Clock;
use platform::hub::Hub;
use platform::lockstep::{self, Answer, Local, Participant, Remote, Setting};
use platform::process;

type Outcome<T> = Result<T, Box<dyn Error>>;

const ROUNDS: u32 = 50_000;
const PATIENCE: Duration = Duration::from_secs(1);
const PERIOD: Duration = Duration::from_millis(1);

/// Node that answers each frame with one, as the drive and the controller do once per cycle.
struct Answering {
    hears: u16,
    says: u16,
    queued: Option<CanFrame>,
    progress: Progress,
}

impl Answering {
    fn new(hears: u16, says: u16) -> Self {
        Self {
            hears,
            says,
            queued: None,
            progress: Progress::Running,
        }
    }
}

impl Node for Answering {
    fn filters(&self) -> Vec<Filter> {
        vec![Filter::exact(self.hears)]
    }

    fn on_frame(&mut self, _now: Duration, frame: &CanFrame) {
        self.queued = Some(CanFrame::new(self.says, frame.data()));
    }

    fn on_tick(&mut self, _now: Duration) {}

    fn on_stop(&mut self, _now: Duration) {
        self.progress = Progress::Stopped;
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        self.queued.take()
    }

    fn next_deadline(&self) -> Option<Duration> {
        None
    }

    fn progress(&self) -> Progress {
        self.progress.clone()
    }
}

fn main() -> Outcome<()> {
    let given: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = given.iter().map(String::as_str).collect();
    match arguments[..] {
        ["echo", address] => echo(&address.parse()?),
        ["follow", channel, hears, says] => {
            let channel = process::inherited_channel(channel.parse()?)?;
            let mut node = Answering::new(hears.parse()?, says.parse()?);
            Ok(lockstep::follow(&mut node, channel, None)?)
        }
        [] => {
            let (hub, _recorder) = Hub::start()?;
            measure_bus("embedded bus", &hub.address())?;
            measure_lockstep()
        }
        [interface] => measure_bus(interface, &interface.parse()?),
        _ => Err("usage: crossings [INTERFACE]".into()),
    }
}

/// Runs the other end of the bus's measurement; ends when the bus or its frames end.
fn echo(address: &BusAddress) -> Outcome<()> {
    let mut bus = platform::open(address, &[Filter::exact(0x100)])?;
    bus.send(&CanFrame::new(0x101, &[]))?;
    while let Some(frame) = bus.receive(PATIENCE)? {
        bus.send(&CanFrame::new(0x101, frame.data()))?;
    }
    Ok(())
}

fn measure_bus(name: &str, address: &BusAddress) -> Outcome<()> {
    let mut bus = platform::open(address, &[Filter::exact(0x101)])?;
    let mut child = process::myself()?
        .args(["echo", &address.to_string()])
        .spawn()?;
    expect_frame(bus.as_mut())?;
    let clock = Clock::start();
    for round in 0..ROUNDS {
        bus.send(&CanFrame::new(0x100, &round.to_le_bytes()))?;
        expect_frame(bus.as_mut())?;
    }
    show(name, "round trips", clock.now());
    child.wait()?;
    Ok(())
}

fn expect_frame(bus: &mut dyn Bus) -> Outcome<CanFrame> {
    Ok(bus.receive(PATIENCE * 5)?.ok_or("no answer on the bus")?)
}

fn measure_lockstep() -> Outcome<()> {
    let (mut plant_child, mut plant) = follower("plant", 1, 2)?;
    let (mut controller_child, mut controller) = follower("controller", 2, 1)?;
    let elapsed = cycles(&mut plant, &mut controller)?;
    show("lock-step, processes", "cycles of two round trips", elapsed);
    for (participant, child) in [
        (&mut plant, &mut plant_child),
        (&mut controller, &mut controller_child),
    ] {
        participant.stop(PERIOD * ROUNDS, &mut Answer::default())?;
        child.wait()?;
    }

    let (mut plant, mut controller) = (Answering::new(1, 2), Answering::new(2, 1));
    let elapsed = cycles(
        &mut Local::new("plant", &mut plant),
        &mut Local::new("controller", &mut controller),
    )?;
    show(
        "lock-step, one process",
        "cycles of two round trips",
        elapsed,
    );
    Ok(())
}

fn follower(name: &str, hears: u16, says: u16) -> Outcome<(Child, Remote)> {
    let (ours, theirs) = lockstep::channel()?;
    let mut command = process::myself()?;
    let number = process::inherit(&mut command, theirs);
    let child = command
        .args(["follow".into(), number.to_string()])
        .args([hears.to_string(), says.to_string()])
        .spawn()?;
    drop(command);
    let patience = Some(lockstep::ANSWER_PATIENCE);
    let remote = Remote::accept(name, ours, patience, Setting::default())?;
    Ok((child, remote))
}

/// Passes the frame of each participant to the other, in turn.
fn cycles(plant: &mut impl Participant, controller: &mut impl Participant) -> Outcome<Duration> {
    let mut frames = vec![(Duration::ZERO, CanFrame::new(1, &[0; 8]))];
    let mut answer = Answer::default();
    let clock = Clock::start();
    for round in 0..ROUNDS {
        let now = PERIOD * round;
        for participant in [plant as &mut dyn Participant, controller] {
            frames[0].0 = now;
            participant.advance(now, now, &frames, &mut answer)?;
            std::mem::swap(&mut frames, &mut answer.frames);
            if frames.len() != 1 {
                return Err("not one frame was answered".into());
            }
        }
    }
    Ok(clock.now())
}

fn show(name: &str, what: &str, elapsed: Duration) {
    let per_second = f64::from(ROUNDS) / elapsed.as_secs_f64();
    println!("{name}: {per_second:.0} {what} per second");
}
