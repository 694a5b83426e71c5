//! What the terminal shows of the scenarios that are played.

use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::console::{Progress, complain, say};
use crate::event::{Listener, RunEvent};
use crate::exit::Exit;
use crate::play::PlayArgs;
use crate::run::Judged;
use judge::verdict::Outcome;
use report::terminal;
use std::path::Path;
use worlds::preflight::PreflightEvent;

/// Prints what happens, as far as the user wants it.
pub(crate) struct Terminal {
    json: bool,
    quiet: bool,
    progress: Mutex<Option<Progress>>,
}

impl Terminal {
    pub(crate) fn new(args: &PlayArgs) -> Self {
        Self {
            json: args.json,
            quiet: args.quiet,
            progress: Mutex::new(None),
        }
    }

    fn is_talkative(&self) -> bool {
        !self.json && !self.quiet
    }

    fn progress(&self) -> MutexGuard<'_, Option<Progress>> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn note(&self, text: &str) {
        if self.is_talkative() {
            say(text);
        }
    }

    fn report(&self, path: &Path, judged: &Judged) {
        if judged.verdict.outcome == Outcome::Incomplete {
            let reason = judged.verdict.reason.as_deref().unwrap_or_default();
            complain(&format!("canrig: {}: {reason}", path.display()));
        }
        if !self.json && (!self.quiet || judged.exit != Exit::Pass) {
            say(&terminal::run(&judged.verdict, &judged.folder));
        }
    }
}

impl Listener for Terminal {
    fn hear(&self, event: &RunEvent<'_>) {
        match event {
            RunEvent::Note(text) => self.note(text),
            RunEvent::Preflight(step) => self.note(&in_words(step)),
            RunEvent::Began { duration_seconds } => {
                *self.progress() = Some(Progress::new(*duration_seconds, self.is_talkative()));
            }
            RunEvent::Reached(reading) => {
                if let Some(progress) = &*self.progress() {
                    progress.show(reading);
                }
            }
            RunEvent::Judged { path, judged } => {
                self.progress().take();
                self.report(path, judged);
            }
            RunEvent::Failed(reason) => {
                self.progress().take();
                complain(&format!("canrig: {reason}"));
            }
            RunEvent::Ended(verdicts) if self.json => {
                say(&serde_json::to_string_pretty(verdicts).expect("plain data"));
            }
            RunEvent::Ended(verdicts) if verdicts.len() > 1 => {
                self.note(&terminal::summary(verdicts));
            }
            RunEvent::Ended(_) => {}
        }
    }
}

fn in_words(step: &PreflightEvent) -> String {
    match step {
        PreflightEvent::Begun => "pre-flight:".to_owned(),
        PreflightEvent::Checked(check) => format!("  {check}"),
        PreflightEvent::Cooling(time) => format!("  the wire cools for {} s", time.as_secs_f64()),
    }
}
