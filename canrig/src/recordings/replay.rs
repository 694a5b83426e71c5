//! `canrig replay`: a recording judged again.

use dbc::Database;

use super::args::ReplayArgs;
use super::{Recorded, RecordedError, refuse};
use crate::console::{complain, say};
use crate::exit::Exit;
use crate::report::terminal;
use crate::run::Source;
use crate::verdict::Verdict;

/// Judges a recording again; the exit code is that of the verdict.
#[must_use]
pub fn replay(args: &ReplayArgs) -> Exit {
    match judged(args) {
        Err(error) => refuse(error),
        Ok((recorded, verdict)) => {
            tell(args, &recorded, &verdict);
            verdict.outcome.exit()
        }
    }
}

fn judged(args: &ReplayArgs) -> Result<(Recorded, Verdict), RecordedError> {
    let path = &args.recording;
    let limits = args.scenario.as_deref().filter(|_| path.is_dir());
    let played = args.scenario.as_deref().filter(|_| !path.is_dir());
    let mut recorded = Recorded::load(path, played)?;
    if let Some(limits) = limits {
        let other =
            Source::load(limits).map_err(|error| RecordedError::Scenario(Box::new(error)))?;
        recorded.source.scenario.expect = other.scenario.expect;
    }
    let database = Database::sma_actuator();
    let timeline = recorded.timeline(&database)?;
    let verdict = recorded.judge(&timeline, &database)?;
    Ok((recorded, verdict))
}

fn tell(args: &ReplayArgs, recorded: &Recorded, verdict: &Verdict) {
    if let Some(broken) = &recorded.log.broken {
        let read = recorded.log.frames.len();
        complain(&format!(
            "canrig: the log breaks off ({broken}); {read} frames before that are judged"
        ));
    }
    if args.json {
        say(verdict.to_json().trim_end());
        return;
    }
    say(&terminal::verdict(verdict));
    if let (Some(stored), None) = (&recorded.stored, &args.scenario) {
        say(&against(stored, verdict));
    }
}

/// What the verdict of the run said.
fn against(stored: &Verdict, verdict: &Verdict) -> String {
    if stored == verdict {
        return "the same verdict as that of the run".to_owned();
    }
    let other_version = match stored.version == verdict.version {
        true => String::new(),
        false => format!(", by canrig {}", stored.version),
    };
    format!(
        "the verdict of the run was: {}{other_version}",
        stored.outcome.word()
    )
}
