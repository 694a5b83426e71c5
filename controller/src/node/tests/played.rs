//! The controller with a law that a process plays.

use std::sync::{Arc, Mutex};

use super::*;
use crate::law::Cycle;
use crate::process_law::{Player, Window};

const PLAYED: &str = "[controller.program]\ncommand = [\"true\"]\nreads = [\"position_millimetres\"]\n\
    writes = [\"current_amperes\"]\n[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n";

/// Requests to a player, and its behaviour.
#[derive(Debug, Default)]
struct Asked {
    /// Window of each cycle, and whether its position was missing.
    windows: Vec<(Window, bool)>,
    is_late: bool,
    failure: Option<&'static str>,
}

#[derive(Debug)]
struct Fake {
    asked: Arc<Mutex<Asked>>,
    failure: Option<&'static str>,
}

impl Player for Fake {
    fn step(&mut self, _: &Cycle, window: &Window, reads: &[f64], writes: &mut [f64]) -> bool {
        let mut asked = self.asked.lock().unwrap();
        asked.windows.push((*window, reads[0].is_nan()));
        self.failure = asked.failure;
        writes[0] = 0.25;
        !asked.is_late && self.failure.is_none()
    }

    fn failure(&self) -> Option<&str> {
        self.failure
    }
}

/// Makes a bus with a played law, in the middle of its run.
fn running() -> (Bus, Arc<Mutex<Asked>>) {
    let asked = Arc::<Mutex<Asked>>::default();
    let mut bus = Bus::new(OPEN_LOOP);
    let start = |_: &_| -> Result<Box<dyn Player>, String> {
        let asked = Arc::clone(&asked);
        let failure = None;
        Ok(Box::new(Fake { asked, failure }))
    };
    bus.controller = controller_node_of_loops([(&view(PLAYED), None)], &start).unwrap();
    bus.run_until_running();
    bus.run_for(50 * MILLISECOND + MILLISECOND / 2);
    assert!(bus.drive().application().is_heating());
    asked.lock().unwrap().windows.clear();
    (bus, asked)
}

#[test]
fn a_law_has_until_a_tenth_of_a_period_before_the_next_sync() {
    let (mut bus, asked) = running();
    bus.run_for(10 * MILLISECOND);
    let windows = std::mem::take(&mut asked.lock().unwrap().windows);
    assert_eq!(windows.len(), 10);
    let left = |window: &Window| window.until - window.now;
    assert!(
        windows
            .iter()
            .all(|(window, _)| left(window) == MILLISECOND * 9 / 10)
    );
    // A step without a command is not waited for: the SYNC comes after it.
    bus.lost = Some(0x190);
    bus.run_for(3 * MILLISECOND);
    bus.lost = None;
    bus.run_for(2 * MILLISECOND);
    let asked = asked.lock().unwrap();
    let missing = asked.windows.iter().filter(|(_, is_missing)| *is_missing);
    let missing = Vec::from_iter(missing.map(|(window, _)| left(window)));
    assert_eq!(missing, [Duration::ZERO; 3]);
    assert_eq!(asked.windows.len(), 5);
}

#[test]
fn a_late_law_commands_nothing_and_the_drive_holds() {
    let (mut bus, asked) = running();
    let from = bus.now;
    asked.lock().unwrap().is_late = true;
    bus.run_for(5 * MILLISECOND);
    assert_eq!(bus.frames(0x080, from).len(), 5);
    assert_eq!(bus.frames(0x210, from).len(), 0);
    assert!(bus.drive().application().is_heating());
    asked.lock().unwrap().is_late = false;
    bus.run_for(5 * MILLISECOND);
    assert_eq!(bus.frames(0x210, from).len(), 5);
}

#[test]
fn a_law_that_cannot_go_on_ends_the_run_without_current() {
    let (mut bus, asked) = running();
    asked.lock().unwrap().failure = Some("the law gave up");
    bus.fails_with("the law gave up");
    assert_eq!(emergencies(&bus), [(0x1000, 11)]);
}
