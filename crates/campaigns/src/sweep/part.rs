//! Plays a part of a campaign, the cases that have no row yet, and makes the tables and the page if all have one. The rows are the same on every machine, however often they are
//! played.

use std::env;
use std::fmt::Display;
use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::cases::{Cases, Facts};
use super::finish::{Shown, finish};
use super::row::SweepRow;
use super::shard::{SHARDS_MAX, Shard};
use super::store::{Header, Rows, Writer};
use super::uncopied::Uncopied;
use crate::campaign::{Campaign, Interrupted, interrupted};
use recording::capture::Watch;
use recording::run_folder::{RunFolder, WriteError};
use recording::session::write_scenario;
use runner::console::{Bar, print};
use runner::exit::{Exit, Failure};
use runner::lines::EventLines;
use runner::play_record::PlayRecord;
use scenario::Override;

/// Largest number of rows that a power cut may cost; a kill of the program costs the one that it is writing.
const UNSYNCED_MAX: usize = 32;

/// Part of a campaign that a command plays.
#[derive(Args, Clone, Debug)]
pub struct PartArgs {
    /// Play one part, such as 2/4, the second of four, or `auto`, that of the task of an engine; `canrig merge` merges
    /// them
    #[arg(long, value_name = "PART", default_value = "1/1", value_parser = wanted)]
    shard: Wanted,
    /// With `--shard auto`: the number of parts. An engine numbers their tasks from 1, Kubernetes from 0
    #[arg(long, value_name = "COUNT")]
    shards: Option<usize>,
    /// For an engine: exit with 0 when every run of the part has a result, whatever it is, and leave tables and page to `merge`
    #[arg(long)]
    pub(crate) for_engine: bool,
    /// Play some runs to estimate parts, time, memory and disk of all runs on an engine. No result is kept
    #[arg(long, conflicts_with_all = ["shard", "for_engine"])]
    pub(crate) plan: bool,
    /// Number of runs at a time; without it one for each core
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(crate) threads: Option<u16>,
}

impl PartArgs {
    /// Returns the part.
    pub(crate) fn shard(&self) -> Result<Shard, Failure> {
        match (self.shard, self.shards) {
            (Wanted::This(shard), None) => Ok(shard),
            (Wanted::This(_), Some(_)) => Err(Exit::CannotStart
                .because("--shards goes with --shard auto only; a part is written as --shard 2/4")),
            (Wanted::Auto, shards) => engine_shard(|name| env::var(name).ok(), shards),
        }
    }
}

/// Value of `--shard`.
#[derive(Clone, Copy, Debug)]
enum Wanted {
    This(Shard),
    Auto,
}

fn wanted(text: &str) -> Result<Wanted, String> {
    match text {
        "auto" => Ok(Wanted::Auto),
        part => part.parse().map(Wanted::This),
    }
}

/// Returns the failure of a command that does not say which part to play.
fn no_part(reason: impl Display) -> Failure {
    Exit::CannotStart.because(format!("--shard auto: {reason}"))
}

fn no_count(name: &str) -> Failure {
    no_part(format!(
        "{name} says which task this is, but not how many there are; add --shards COUNT"
    ))
}

fn bad_count(count: usize) -> Failure {
    Exit::CannotStart.because(format!(
        "--shards {count}: there are 1 to {SHARDS_MAX} parts"
    ))
}

const SLURM: &str = "SLURM_ARRAY_TASK_ID";
const HYPERQUEUE: &str = "HQ_TASK_ID";
const KUBERNETES: &str = "JOB_COMPLETION_INDEX";

/// Returns the part that the engine's variables name.
fn engine_shard(
    variable: impl Fn(&str) -> Option<String>,
    shards: Option<usize>,
) -> Result<Shard, Failure> {
    if let Some(count) = shards.filter(|count| !(1..=SHARDS_MAX).contains(count)) {
        return Err(bad_count(count));
    }
    let number = |name: &'static str| -> Result<Option<usize>, Failure> {
        let Some(value) = variable(name) else {
            return Ok(None);
        };
        let number = value.trim().parse();
        let wrong = || format!("{name} is \"{value}\", which is not the number of a task");
        number.map(Some).map_err(|_| no_part(wrong()))
    };
    for (name, first) in [(SLURM, 1), (HYPERQUEUE, 1), (KUBERNETES, 0)] {
        let Some(task) = number(name)? else {
            continue;
        };
        let of = match shards {
            Some(of) => of,
            None if name == SLURM => return slurm_shard(task, &number),
            None => return Err(no_count(name)),
        };
        let last = of + first - 1;
        if !(first..=last).contains(&task) {
            return Err(no_part(format!(
                "{name} makes this task {task} of {of}; number the tasks from {first} to {last}"
            )));
        }
        let number = task - first + 1;
        return Ok(Shard { number, of });
    }
    Err(no_part(
        "no engine runs this command (SLURM_ARRAY_TASK_ID, HQ_TASK_ID and JOB_COMPLETION_INDEX are not set); name the part, such as --shard 2/4",
    ))
}

/// Returns the place of a task in an array, from the bounds that Slurm gives of the array.
fn slurm_shard(
    task: usize,
    number: &impl Fn(&'static str) -> Result<Option<usize>, Failure>,
) -> Result<Shard, Failure> {
    let missing = || no_count(SLURM);
    let of = number("SLURM_ARRAY_TASK_COUNT")?.ok_or_else(missing)?;
    let first = number("SLURM_ARRAY_TASK_MIN")?.ok_or_else(missing)?;
    let step = number("SLURM_ARRAY_TASK_STEP")?.unwrap_or(1).max(1);
    let last = number("SLURM_ARRAY_TASK_MAX")?;
    // For a list such as 3,7,9, Slurm gives no step that would lead from its first to its last number.
    let gaps = || {
        no_part(
            "the tasks of the array are not evenly spaced; number them from 1 to the count of parts, and add --shards COUNT",
        )
    };
    let place = task.checked_sub(first).ok_or_else(gaps)?;
    let steps = of.checked_sub(1).and_then(|gaps| gaps.checked_mul(step));
    let end = steps.and_then(|steps| steps.checked_add(first));
    let is_even = end.is_some_and(|end| last.is_none_or(|last| last == end));
    if !is_even || !place.is_multiple_of(step) || place / step >= of {
        return Err(gaps());
    }
    let number = place / step + 1;
    if of <= SHARDS_MAX {
        Ok(Shard { number, of })
    } else {
        Err(bad_count(of))
    }
}

/// Parameters of a part's play.
pub(crate) struct PartPlay<'a> {
    pub(crate) args: &'a PartArgs,
    pub(crate) shard: Shard,
    pub(crate) output: &'a Path,
    pub(crate) shown: Shown,
    /// Values of the command line, which the scenario already has.
    pub(crate) overrides: &'a [Override],
}

impl PartPlay<'_> {
    /// Plays the cases that have no row, and makes tables and page. Returns the exit code and the rows.
    pub(crate) fn play(&self, cases: &dyn Cases) -> Result<(Exit, Rows), Failure> {
        let folder = open_folder(self.output, cases, self.shard)?;
        let mut rows = Rows::read(folder.path(), &Header::new(cases)?, self.shard)?;
        // A part may be played by several processes at the same time, the whole by one.
        if self.is_whole() {
            rows.require_unwritten()?;
        }
        let mut campaign = Campaign::on_all_cores(self.shown == Shown::All);
        campaign.threads = self.args.threads.map_or(campaign.threads, usize::from);
        if self.shown == Shown::All {
            self.announce(cases, &rows, campaign.threads);
        }
        self.report("began", cases, rows.len(), &folder);
        // It is locked while it lives, which keeps others out.
        let _writer = if rows.is_whole() {
            None
        } else {
            Some(self.play_rest(campaign, cases, &folder, &mut rows)?)
        };
        let exit = if self.args.for_engine {
            Exit::Pass
        } else {
            finish(&folder, cases, &rows, self.shown)?
        };
        self.report("ended", cases, rows.len(), &folder);
        if self.is_whole() {
            cases.show_more(&rows, self.output)?;
        }
        Ok((exit, rows))
    }

    /// Returns whether this process alone plays a whole campaign.
    pub(crate) fn is_whole(&self) -> bool {
        self.shard == Shard::WHOLE && !self.args.for_engine
    }

    /// Prints the progress for another program.
    fn report(&self, event: &str, cases: &dyn Cases, done: usize, folder: &RunFolder) {
        if self.shown == Shown::Events {
            let (of, folder) = (self.shard.cases(cases.facts().runs).len(), folder.path());
            let folder = folder.to_string_lossy();
            EventLines.print(&json!({"event": event, "done": done, "of": of, "folder": folder}));
        }
    }

    fn announce(&self, cases: &dyn Cases, rows: &Rows, threads: usize) {
        let runs = cases.facts().runs;
        let mut text = match self.shard {
            Shard::WHOLE => format!("{runs} runs"),
            part => format!("{} of {runs} runs (part {part})", part.cases(runs).len()),
        };
        text += &format!(", {threads} at a time");
        if rows.len() > 0 {
            text += &format!("; {} are done", rows.len());
        }
        print(&text);
    }

    fn play_rest(
        &self,
        campaign: Campaign,
        cases: &dyn Cases,
        folder: &RunFolder,
        rows: &mut Rows,
    ) -> Result<Writer, Failure> {
        let files = Uncopied::new(&cases.facts().plan)?;
        rows.print_damaged();
        let mut writer = rows.writer()?;
        PlayRecord::now(self.overrides).write(folder)?;
        let all = self.shard.cases(cases.facts().runs);
        let (of, mut done) = (all.len(), rows.len());
        let left = all.filter(|case| !rows.has(*case));
        let bar = Bar::runs(Some(of), done, campaign.is_shown);
        let work = |case: &usize, watch: &Watch| cases.row_of(*case, watch);
        let keep = |_, row: Result<SweepRow, Failure>| -> Result<(), Failure> {
            files.check()?;
            writer.append(&row?)?;
            done += 1;
            if done.is_multiple_of(UNSYNCED_MAX) {
                writer.sync()?;
            }
            self.report("reached", cases, done, folder);
            Ok(())
        };
        let ended = campaign.each(left, &bar, work, keep)?;
        ended.map_err(|Interrupted| interrupted(done, of))?;
        drop(bar);
        writer.sync()?;
        rows.look()?;
        rows.require_all()?;
        Ok(writer)
    }
}

/// Opens the folder of a campaign, or of a part of it: the same one each time.
pub(crate) fn open_folder(
    parent: &Path,
    cases: &dyn Cases,
    shard: Shard,
) -> Result<RunFolder, WriteError> {
    let facts = cases.facts();
    let folder = RunFolder::lasting(parent, facts.name(), &folder_id(facts, shard))?;
    for (name, text) in &facts.files {
        folder.ensure(name, text.as_bytes())?;
    }
    write_scenario(&folder, &facts.plan)?;
    Ok(folder)
}

/// Returns the path of that folder, which need not exist yet.
pub(crate) fn folder_path(parent: &Path, cases: &dyn Cases, shard: Shard) -> PathBuf {
    let facts = cases.facts();
    RunFolder::lasting_path(parent, facts.name(), &folder_id(facts, shard))
}

/// Returns the end of that folder's name.
fn folder_id(facts: &Facts, shard: Shard) -> String {
    let part = match shard {
        Shard::WHOLE => String::new(),
        Shard { number, of } => format!("-{number}-of-{of}"),
    };
    format!("{}-{}{part}", facts.kind, facts.id)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shard(variables: &[(&str, &str)], shards: Option<usize>) -> Result<String, Failure> {
        let variable = |name: &str| {
            let found = variables.iter().find(|(known, _)| *known == name);
            found.map(|(_, value)| (*value).to_owned())
        };
        engine_shard(variable, shards).map(|shard| shard.to_string())
    }

    #[test]
    fn each_engine_says_which_part_its_task_is() {
        let array = |task, min, max, step, count| {
            [
                (SLURM, task),
                ("SLURM_ARRAY_TASK_MIN", min),
                ("SLURM_ARRAY_TASK_MAX", max),
                ("SLURM_ARRAY_TASK_STEP", step),
                ("SLURM_ARRAY_TASK_COUNT", count),
            ]
        };
        for (array, shards, expected) in [
            (array("0", "0", "9", "1", "10"), None, "1/10"),
            (array("9", "0", "9", "1", "10"), None, "10/10"),
            (array("12", "4", "20", "8", "3"), None, "2/3"),
            // Array of the parts that are submitted again.
            (array("7", "3", "9", "1", "3"), Some(9), "7/9"),
        ] {
            assert_eq!(shard(&array, shards).unwrap(), expected);
        }
        assert_eq!(shard(&[(HYPERQUEUE, "8")], Some(8)).unwrap(), "8/8");
        assert_eq!(shard(&[(KUBERNETES, "0")], Some(8)).unwrap(), "1/8");
        assert_eq!(shard(&[(KUBERNETES, "7")], Some(8)).unwrap(), "8/8");
    }

    #[test]
    fn a_variable_that_names_no_part_is_refused() {
        let list = [
            (SLURM, "7"),
            ("SLURM_ARRAY_TASK_MIN", "3"),
            ("SLURM_ARRAY_TASK_MAX", "9"),
            ("SLURM_ARRAY_TASK_STEP", "1"),
            ("SLURM_ARRAY_TASK_COUNT", "3"),
        ];
        let most = usize::MAX.to_string();
        let absurd = list.map(|(name, _)| (name, most.as_str()));
        for (variables, shards, text) in [
            (&[][..], None, "no engine runs this command"),
            (&[(KUBERNETES, "3")], None, "add --shards COUNT"),
            (
                &[(HYPERQUEUE, "0")],
                Some(4),
                "number the tasks from 1 to 4",
            ),
            (
                &[(KUBERNETES, "4")],
                Some(4),
                "number the tasks from 0 to 3",
            ),
            (
                &[(SLURM, "x")],
                Some(4),
                "is \"x\", which is not the number of a task",
            ),
            (&[(SLURM, "1")], Some(0), "there are 1 to 10000 parts"),
            (&list, None, "not evenly spaced"),
            (&absurd, None, "not evenly spaced"),
        ] {
            let error = shard(variables, shards).unwrap_err().to_string();
            assert!(error.contains(text), "{text}: {error}");
        }
    }
}
