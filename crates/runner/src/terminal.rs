//! Output on the terminal while scenarios are played.

use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::console::{Bar, WorkBar, print, print_problem, print_text};
use crate::event::{Listener, RunEvent};
use crate::exit::Exit;
use crate::run::Judged;
use judge::verdict::Outcome;
use report::terminal;
use worlds::preflight::PreflightEvent;

/// Printer of events, as far as the user wants them.
pub(crate) struct Terminal {
    /// Whether it prints the verdicts only, as JSON.
    json: bool,
    /// Whether it prints failures only.
    quiet: bool,
    progress: Mutex<Option<Progress>>,
}

/// Progress that is drawn while the user waits.
enum Progress {
    Scenario(Bar),
    /// Bar that draws itself until it is dropped.
    Work(#[expect(dead_code, reason = "it draws itself")] WorkBar),
}

impl Terminal {
    pub(crate) fn new(json: bool, quiet: bool) -> Self {
        Self {
            json,
            quiet,
            progress: Mutex::new(None),
        }
    }

    fn prints_notes(&self) -> bool {
        !self.json && !self.quiet
    }

    fn progress(&self) -> MutexGuard<'_, Option<Progress>> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn note(&self, text: &str) {
        if self.prints_notes() {
            print(text);
        }
    }

    fn report(&self, path: &Path, judged: &Judged) {
        if judged.verdict.outcome == Outcome::Incomplete {
            let reason = judged.verdict.reason.as_deref().unwrap_or_default();
            print_problem(format!("`{}`: {reason}", path.display()));
        }
        if self.quiet && judged.verdict.judged_nothing() && judged.exit == Exit::Pass {
            print(&terminal::line(&judged.verdict));
        }
        if !self.json && (!self.quiet || judged.exit != Exit::Pass) {
            print_text(&terminal::run(&judged.verdict, &judged.folder));
        }
    }
}

impl Listener for Terminal {
    fn on_event(&self, event: &RunEvent<'_>) {
        match event {
            RunEvent::Note(text) => self.note(text),
            RunEvent::Preflight(step) => self.note(&preflight_text(step)),
            RunEvent::Began { duration_seconds } => {
                let bar = Bar::scenario(*duration_seconds, self.prints_notes());
                *self.progress() = Some(Progress::Scenario(bar));
            }
            RunEvent::Reached(reading) => {
                if let Some(Progress::Scenario(bar)) = &*self.progress() {
                    bar.show_run(reading);
                }
            }
            RunEvent::Played { passes } => {
                let bar = WorkBar::new(*passes, self.prints_notes());
                self.progress().take();
                *self.progress() = Some(Progress::Work(bar));
            }
            RunEvent::Judged { path, judged } => {
                self.progress().take();
                self.report(path, judged);
            }
            RunEvent::Spoiled(text) => {
                self.progress().take();
                self.note(text);
            }
            RunEvent::Failed(reason) => {
                self.progress().take();
                print_problem(reason);
            }
            RunEvent::Ended(verdicts) if self.json => {
                print(&serde_json::to_string_pretty(verdicts).expect("plain data"));
            }
            RunEvent::Ended(verdicts) if verdicts.len() > 1 && self.prints_notes() => {
                print_text(&terminal::summary(verdicts));
            }
            RunEvent::Ended(_) => {}
        }
    }
}

fn preflight_text(step: &PreflightEvent) -> String {
    match step {
        PreflightEvent::Begun => "pre-flight:".to_owned(),
        PreflightEvent::Drive(name) => format!(" {name}:"),
        PreflightEvent::Step(text) => format!("  {text}"),
    }
}
