//! Events while scenarios are played, as lines of JSON for another program.

use serde_json::{Value, json};

use crate::console;
use crate::event::{Listener, RunEvent};
use dbc::names;
use plan::loop_prefix;
use recording::progress::RunProgress;
use worlds::preflight::PreflightEvent;

/// Printer of an object for each event, with its kind as `event`.
pub struct EventLines;

impl EventLines {
    /// Prints one object.
    pub fn print(&self, object: &Value) {
        console::print(&object.to_string());
    }
}

impl Listener for EventLines {
    fn on_event(&self, event: &RunEvent<'_>) {
        self.print(&match event {
            // The next event implies this one.
            RunEvent::Played { .. } => return,
            RunEvent::Note(text) | RunEvent::Spoiled(text) => {
                json!({"event": "note", "text": text})
            }
            RunEvent::Preflight(step) => json!({"event": "note", "text": preflight_text(step)}),
            RunEvent::Began { duration_seconds } => {
                json!({"event": "began", "duration_seconds": duration_seconds})
            }
            RunEvent::Reached(reading) => reached(reading),
            RunEvent::Judged { path, judged } => json!({
                "event": "judged",
                "scenario": path.to_string_lossy(),
                "folder": judged.folder.to_string_lossy(),
                "exit": judged.exit.code(),
            }),
            RunEvent::Failed(reason) => json!({"event": "failed", "reason": reason}),
            RunEvent::Ended(verdicts) => json!({"event": "ended", "runs": verdicts.len()}),
        });
    }
}

/// Returns the progress of a run, with the position of each loop.
fn reached(reading: &RunProgress) -> Value {
    let mut line = json!({
        "event": "reached",
        "time_seconds": reading.time.as_secs_f64(),
    });
    for one in &reading.loops {
        let prefix = loop_prefix(one.name.as_deref().unwrap_or_default());
        let position = one.quantities.name(names::POSITION);
        line[prefix + &position] = one.position.into();
    }
    line
}

fn preflight_text(step: &PreflightEvent) -> String {
    match step {
        PreflightEvent::Begun => "pre-flight".to_owned(),
        PreflightEvent::Drive(name) => format!("pre-flight of {name}"),
        PreflightEvent::Step(text) => format!("pre-flight: {text}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbc::{Quantities, Unit};
    use recording::progress::LoopProgress;

    #[test]
    fn a_position_is_in_the_unit_of_its_loop() {
        let turned = LoopProgress {
            quantities: Quantities::of_position(Unit::Degrees),
            position: Some(12.5),
            ..LoopProgress::default()
        };
        let mut reading = RunProgress {
            loops: vec![turned.clone()],
            ..RunProgress::default()
        };
        let expected = json!({"event": "reached", "time_seconds": 0.0, "position_degrees": 12.5});
        assert_eq!(reached(&reading), expected);
        let named = |name: &str| LoopProgress {
            name: Some(name.to_owned()),
            ..turned.clone()
        };
        reading.loops = vec![named("x"), named("y")];
        let both = reached(&reading);
        assert_eq!(both["x.position_degrees"], json!(12.5));
        assert_eq!(both["y.position_degrees"], json!(12.5));
    }
}
