//! `canrig replay`: judges a recording again.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use platform::clock::{Clock, sleep};

use crate::console::{WorkBar, print, print_problem, print_text};
use crate::exit::{Exit, Failure};
use crate::identity::identity;
use crate::number;
use crate::play::ViewerArgs;
use crate::recorded::Recorded;
use judge::verdict::Verdict;
use recording::frame_queue::WhenFull;
use recording::run_folder::file;
use recording::session::with_limits;
use report::terminal;
use worlds::catalogue::catalogue;

/// Longest time by which frames go to a viewer before their time.
const AHEAD_MAX: Duration = Duration::from_millis(10);

/// Number of passes over the frames: to read, to decode and to judge them.
const PASSES: u64 = 3;

/// Arguments of `replay`.
#[derive(Args, Debug)]
pub struct ReplayArgs {
    /// A run folder, or a log of `candump -L`
    #[arg(value_name = "RUN|LOG")]
    pub recording: PathBuf,
    /// For a run folder: the scenario whose limits ([expect]) decide. For a log: the scenario that was played
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<PathBuf>,
    /// Print the verdict as JSON, as verdict.json has it
    #[arg(long)]
    pub json: bool,
    /// Fail a recording that passes although nothing is limited
    #[arg(long)]
    pub strict: bool,
    #[command(flatten)]
    pub viewer: ViewerArgs,
    /// Speed in the viewer: 1 as recorded, 0.1 in slow motion, inf without waiting
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = speed)]
    pub speed: f64,
}

/// Parses a factor on time.
fn speed(text: &str) -> Result<f64, String> {
    let expected = "a number is expected, or inf";
    number::parse(text, 1e-3.., expected, "0.001 is the slowest")
}

/// Judges a recording again; the exit code is that of the verdict.
pub fn replay(args: &ReplayArgs) -> Result<Exit, Failure> {
    let (recorded, verdict) = judged(args)?;
    show(args, &recorded, &verdict);
    report(args, &recorded, &verdict);
    Ok(if args.strict && verdict.judged_nothing() {
        Exit::VerdictFailed
    } else {
        verdict.outcome.into()
    })
}

fn judged(args: &ReplayArgs) -> Result<(Recorded, Verdict), Failure> {
    let bar = WorkBar::new(PASSES, true);
    let path = &args.recording;
    let limits = args.scenario.as_deref().filter(|_| path.is_dir());
    let played = args.scenario.as_deref().filter(|_| !path.is_dir());
    let mut recorded = Recorded::load(path, played, catalogue())?;
    bar.expect(PASSES + recorded.passes_for_timing());
    for name in changed_files(&recorded)? {
        print_problem(format!(
            "`{}` has another SHA-256 than the file that was played (`identity` in `{}`): the recording is judged by the one in the folder",
            path.join(name).display(),
            file::VERDICT
        ));
    }
    if let Some(limits) = limits {
        let plan = with_limits(recorded.plan, path, limits, catalogue())?;
        recorded.plan = plan.ok_or_else(|| {
            let path = limits.display();
            Exit::CannotStart.because(format!(
                "`{path}` has other loops than the recording, so its limits cannot be applied"
            ))
        })?;
    }
    let timelines = recorded.timelines()?;
    let verdict = recorded.judge(&timelines)?;
    Ok((recorded, verdict))
}

/// Returns the names of those files of the plan that are not as they were played.
fn changed_files(recorded: &Recorded) -> Result<Vec<String>, Failure> {
    let stored = recorded.stored.as_ref();
    let Some(played) = stored.and_then(|stored| stored.identity.as_ref()) else {
        return Ok(Vec::new());
    };
    let found = identity(&recorded.plan)?.files.into_iter();
    let is_other = |(name, hash): &(String, String)| {
        let played = played.files.get(name);
        played.is_some_and(|played| played != hash)
    };
    Ok(found.filter(is_other).map(|(name, _)| name).collect())
}

/// Plays the recording into the viewers, at the speed of the command line.
fn show(args: &ReplayArgs, recorded: &Recorded, verdict: &Verdict) {
    let (mut viewers, refused) = args.viewer.open();
    report_all(&refused);
    if viewers.is_empty() {
        return;
    }
    let (mut queues, shows) = viewers.show(&recorded.plan, WhenFull::Wait);
    let frames = &recorded.log.frames;
    let begin = frames.start().unwrap_or_default();
    let clock = Clock::start();
    for stamped in frames.iter() {
        let since = stamped.time.saturating_sub(begin);
        let due = Duration::try_from_secs_f64(since.as_secs_f64() / args.speed);
        let ahead = due.unwrap_or(Duration::MAX).saturating_sub(clock.now());
        if ahead >= AHEAD_MAX {
            sleep(ahead);
        }
        for queue in &mut queues {
            queue.push(stamped);
        }
    }
    drop(queues);
    report_all(&shows.end(verdict, &mut viewers));
}

fn report_all(reasons: &[String]) {
    for reason in reasons {
        print_problem(reason);
    }
}

fn report(args: &ReplayArgs, recorded: &Recorded, verdict: &Verdict) {
    for remark in recorded.log.unread.remarks() {
        let read = recorded.log.frames.len();
        print_problem(format!("{remark}; the other {read} frames are judged"));
    }
    if args.json {
        print(verdict.to_json().trim_end());
        return;
    }
    print_text(&terminal::verdict(verdict));
    if let (Some(stored), None) = (&recorded.stored, &args.scenario) {
        print(&against(stored, verdict));
    }
}

/// Compares the new verdict with that of the run, as a text.
fn against(stored: &Verdict, verdict: &Verdict) -> String {
    if stored == verdict {
        return "the same verdict as that of the run".to_owned();
    }
    let other_version = if stored.version == verdict.version {
        String::new()
    } else {
        format!(", by canrig {}", stored.version)
    };
    format!(
        "the verdict of the run was: {}{other_version}",
        stored.outcome.word()
    )
}
