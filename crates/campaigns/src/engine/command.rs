//! `canrig submit`: hands a campaign to an engine, waits, submits lost parts again, and merges.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;

use super::campaign::{Record, SharedCampaign, Submitted};
use super::round::{RowCounter, wait};
use super::{Engine, EngineKind, Limits};
use crate::sweep::Shard;
use crate::sweep::cases::Cases;
use crate::sweep::estimate::Estimate;
use crate::sweep::finish::Shown;
use crate::sweep::merge::merge_parts;
use crate::sweep::shard::SHARDS_MAX;
use crate::sweep::store::Header;
use crate::sweep::sweep_cases::SweepCases;
use crate::torture::cases::{Draws, TortureCases};
use recording::run_folder::WriteError;
use runner::console::{Bar, print};
use runner::exit::{Exit, Failure};
use runner::play::ValueArgs;
use runner::run::RUNS;
use runner::scenarios::load_to_play;

/// Largest number of lost parts in a message.
const NAMED_MAX: usize = 20;

/// Arguments of `submit`.
#[derive(Args, Debug)]
pub struct SubmitArgs {
    /// A scenario file with a [sweep] table; any scenario with --torture
    pub scenario: PathBuf,
    /// The engine that runs the parts
    #[arg(long, value_enum, required_unless_present = "resume")]
    pub engine: Option<EngineKind>,
    /// Torture by this many random combinations of faults, in place of the sweep
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u32).range(1..))]
    pub torture: Option<u32>,
    /// Seed of the random combinations
    #[arg(long, value_name = "SEED", default_value_t = 1, requires = "torture")]
    pub seed: u64,
    /// Folder in which the campaign's folder is made, on a disk that all machines of the engine have at the same place
    #[arg(long, short, value_name = "FOLDER", default_value = RUNS)]
    pub output: PathBuf,
    /// Number of parts, each a task of the engine; without it as many as take ten minutes each, by a probe of some runs
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=SHARDS_MAX as i64))]
    pub parts: Option<u16>,
    /// Time that a task may take
    #[arg(long, value_name = "MINUTES", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub task_minutes: Option<u32>,
    /// Memory that a task may use
    #[arg(long, value_name = "MEBIBYTES", value_parser = clap::value_parser!(u32).range(1..))]
    pub task_mebibytes: Option<u32>,
    /// Cores of a task, each with a run at a time
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub task_cores: Option<u16>,
    /// Where the tasks queue: Slurm's partition, HyperQueue's server folder, the namespace of Kubernetes
    #[arg(long, value_name = "NAME")]
    pub queue: Option<String>,
    /// Kubernetes: image of the containers; it needs a shell and a C library, canrig is on the shared disk
    #[arg(long, value_name = "IMAGE")]
    pub image: Option<String>,
    /// Kubernetes: persistent volume claim of the shared disk
    #[arg(long, value_name = "NAME")]
    pub claim: Option<String>,
    /// How often lost parts are submitted again
    #[arg(long, value_name = "COUNT", default_value_t = 2)]
    pub retries: u32,
    /// Print the job without submitting it
    #[arg(long)]
    pub dry_run: bool,
    /// Wait for the job that was submitted before, and continue the campaign
    #[arg(long, conflicts_with_all = ["engine", "parts", "dry_run"])]
    pub resume: bool,
    /// Print failures only
    #[arg(long, short)]
    pub quiet: bool,
    #[command(flatten)]
    pub values: ValueArgs,
}

/// Runs the command.
pub fn submit(args: &SubmitArgs) -> Result<Exit, Failure> {
    let plan = load_to_play(&args.scenario, &args.values)?;
    let seed = args.seed;
    let (cases, arguments): (Box<dyn Cases>, _) = match args.torture {
        Some(runs) => {
            let words = ["--runs", &runs.to_string(), "--seed", &seed.to_string()];
            let arguments = words.map(str::to_owned).into();
            let torture = TortureCases::new(&plan, Draws { runs, seed });
            (Box::new(torture), arguments)
        }
        None => (Box::new(SweepCases::new(&plan)?), Vec::new()),
    };
    let campaign = SharedCampaign {
        cases: &*cases,
        header: Header::new(&*cases)?,
        output: std::path::absolute(&args.output).map_err(WriteError::at(&args.output))?,
        arguments,
    };
    let mut record = record(args, &campaign)?;
    let engine = record.engine.engine();
    if args.dry_run {
        let parts = Vec::from_iter(1..=record.parts);
        let job = campaign.job(&record, &parts);
        print(engine.file(&job).1.trim_end());
        return Ok(Exit::Pass);
    }
    campaign.prepare(&args.values.all())?;
    campaign.keep(&record)?;
    play(args, &campaign, engine, &mut record)?;
    let of = record.parts;
    let parts = Vec::from_iter((1..=of).map(|number| campaign.part(Shard { number, of })));
    let shown = Shown::unless(args.quiet);
    merge_parts(&parts, &*cases, &campaign.output, shown)
}

/// Returns the record of the campaign, changed as the command line says.
fn record(args: &SubmitArgs, campaign: &SharedCampaign<'_>) -> Result<Record, Failure> {
    let path = campaign.path();
    let known = campaign.record()?;
    let refused = |reason: String| Err(Exit::CannotStart.because(reason));
    let limits = |known: Limits| Limits {
        minutes: args.task_minutes.or(known.minutes),
        mebibytes: args.task_mebibytes.or(known.mebibytes),
        cores: args.task_cores.unwrap_or(known.cores.max(1)),
        queue: args.queue.clone().or(known.queue),
        image: args.image.clone().or(known.image),
        claim: args.claim.clone().or(known.claim),
    };
    let parts = args.parts.map(usize::from);
    let Some(known) = known else {
        let Some(engine) = args.engine else {
            return refused(format!(
                "nothing was submitted from here that could be resumed ({} is not there); submit it with --engine",
                path.display()
            ));
        };
        return Ok(Record {
            program: campaign.header.identity.program.clone(),
            engine,
            parts: match parts {
                Some(parts) => parts.min(campaign.cases.facts().runs),
                None => probed_parts(args, campaign)?,
            },
            limits: limits(Limits::default()),
            rounds: 0,
            job: None,
        });
    };
    if known.program != campaign.header.identity.program {
        let program = path.join("engine/canrig");
        return refused(format!(
            "this campaign was submitted by another canrig; go on with the one that did, {}, or move its folder away",
            program.display()
        ));
    }
    if let Some(Submitted { id, .. }) = &known.job
        && args.engine.is_some()
        && !args.dry_run
    {
        let (engine, queue) = (known.engine, known.limits.queue.as_deref());
        let cancel = engine.engine().cancel_command(id, queue);
        return refused(format!(
            "this campaign was submitted already ({engine:?}, job {id}): --resume waits for it; `{cancel}` takes it away, then --resume submits the rest again"
        ));
    }
    // The parts exist already, cut for that number.
    if let Some(wanted) = parts
        && wanted != known.parts
    {
        let found = known.parts;
        return refused(format!(
            "this campaign has {found} parts, not {wanted}: leave out --parts, or move {} away",
            path.display()
        ));
    }
    Ok(Record {
        engine: args.engine.unwrap_or(known.engine),
        limits: limits(known.limits),
        ..known
    })
}

/// Returns the number of parts of which each is worth the start of a task.
fn probed_parts(args: &SubmitArgs, campaign: &SharedCampaign<'_>) -> Result<usize, Failure> {
    let estimate = Estimate::probe(campaign.cases, args.task_cores.unwrap_or(1))?;
    if !args.quiet && !args.dry_run {
        print(&estimate.to_string());
    }
    Ok(estimate.parts())
}

/// Submits missing parts until every part is complete.
fn play(
    args: &SubmitArgs,
    campaign: &SharedCampaign<'_>,
    engine: &dyn Engine,
    record: &mut Record,
) -> Result<(), Failure> {
    let mut counter = RowCounter(campaign.rows(record.parts)?);
    let bar = Bar::parts(campaign.cases.facts().runs, counter.rows(), !args.quiet);
    let mut begun = 0;
    loop {
        let submitted = match record.job.clone() {
            Some(submitted) => submitted,
            None => {
                let missing = counter.missing();
                if missing.is_empty() {
                    break;
                }
                if begun > args.retries {
                    let (missing, of) = (missing.len(), record.parts);
                    let logs = campaign.path().join("engine/log");
                    return Err(Exit::BenchFailed.because(format!(
                        "{missing} of {of} parts were lost, and were submitted {begun} times. What they did is kept: look at what their tasks printed in {}, then give the command again with --resume",
                        logs.display()
                    )));
                }
                let submitted = hand_over(campaign, engine, record, missing)?;
                let (count, id) = (submitted.parts.len(), &submitted.id);
                if !args.quiet {
                    bar.print(&format!("{:?} job {id}: {count} parts", record.engine));
                }
                submitted
            }
        };
        begun += 1;
        let Some(failed) = wait(engine, campaign, &submitted, &mut counter, &bar)? else {
            let queue = record.limits.queue.as_deref();
            let cancel = engine.cancel_command(&submitted.id, queue);
            return Err(Exit::Interrupted.because(format!(
                "the job goes on without this command: give it again with --resume and without --engine and --parts, or take the job away with `{cancel}`"
            )));
        };
        record.job = None;
        campaign.keep(record)?;
        counter.count()?;
        print_parts(&bar, missing_parts(&counter, &failed));
    }
    if !args.quiet {
        print_parts(&bar, lost_parts(&counter));
    }
    Ok(())
}

/// Submits some parts, and records the id that the engine gives the job.
fn hand_over(
    campaign: &SharedCampaign<'_>,
    engine: &dyn Engine,
    record: &mut Record,
    parts: Vec<usize>,
) -> Result<Submitted, Failure> {
    let (name, text) = engine.file(&campaign.job(record, &parts));
    let file = campaign.write_job(name, &text)?;
    let submitted = Submitted {
        id: engine.submit(&file)?,
        file: name.to_owned(),
        parts,
    };
    record.rounds += 1;
    record.job = Some(submitted.clone());
    campaign.keep(record)?;
    Ok(submitted)
}

/// Describes the parts that a job did not complete.
fn missing_parts(
    counter: &RowCounter,
    failed: &BTreeMap<usize, String>,
) -> impl Iterator<Item = String> {
    let missing = counter.0.iter().filter(|part| !part.is_whole());
    missing.map(|part| {
        let (shard, rows, of) = (part.shard(), part.len(), part.of());
        let why = match (failed.get(&shard.number), part.nodes().last()) {
            (Some(why), _) => why.clone(),
            (None, Some(node)) => format!("lost on {node}"),
            (None, None) => "never began".to_owned(),
        };
        format!("part {shard}: {why}; {rows} of {of} runs are done")
    })
}

/// Describes the parts that were lost on one node and completed on another: all nodes that began a part, except the last.
fn lost_parts(counter: &RowCounter) -> impl Iterator<Item = String> {
    counter.0.iter().filter_map(|part| {
        let nodes = Vec::from_iter(part.nodes());
        let (_, lost) = nodes.split_last().filter(|(_, lost)| !lost.is_empty())?;
        let (shard, lost) = (part.shard(), lost.join(", "));
        Some(format!("part {shard}: lost on {lost}, then run again"))
    })
}

/// Prints the first of these lines, each on a part.
fn print_parts(bar: &Bar, lines: impl Iterator<Item = String>) {
    let lines = Vec::from_iter(lines);
    for line in lines.iter().take(NAMED_MAX) {
        bar.print(line);
    }
    if let more @ 1.. = lines.len().saturating_sub(NAMED_MAX) {
        bar.print(&format!("and {more} more parts"));
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;
    use std::sync::Mutex;

    use clap::{Command, FromArgMatches};

    use super::super::campaign::tests::{campaign, plan};
    use super::super::{Job, JobState, ranges};
    use super::*;
    use crate::sweep::row::{Ended, SweepRow};
    use crate::sweep::store::{Rows, Writer};

    fn args(options: &str) -> SubmitArgs {
        let words = ["submit", "s.toml"].into_iter().chain(options.split(' '));
        let command = SubmitArgs::augment_args(Command::new("submit"));
        let matches = command.try_get_matches_from(words).unwrap();
        SubmitArgs::from_arg_matches(&matches).unwrap()
    }

    /// Engine that is asked twice about a job before it is over. It loses the second part of the first two jobs.
    struct Lossy<'a> {
        campaign: &'a SharedCampaign<'a>,
        jobs: Mutex<Vec<String>>,
        questions: Mutex<usize>,
    }

    impl Engine for Lossy<'_> {
        fn file(&self, job: &Job<'_>) -> (&'static str, String) {
            ("job", ranges(job.parts))
        }

        fn submit(&self, file: &Path) -> Result<String, Failure> {
            let mut jobs = self.jobs.lock().unwrap();
            jobs.push(fs::read_to_string(file).unwrap());
            Ok(jobs.len().to_string())
        }

        fn state(&self, id: &str, _: &Path, parts: &[usize]) -> Result<JobState, Failure> {
            let mut questions = self.questions.lock().unwrap();
            *questions += 1;
            let mut state = JobState {
                is_over: questions.is_multiple_of(2),
                ..JobState::default()
            };
            if !state.is_over {
                return Ok(state);
            }
            for &number in parts {
                if number == 2 && id != "3" {
                    state.failed.insert(number, "lost".to_owned());
                    continue;
                }
                let shard = Shard { number, of: 2 };
                let folder = self.campaign.part(shard);
                fs::create_dir_all(&folder).unwrap();
                let mut writer = Writer::begin(&folder, &self.campaign.header)?;
                for case in shard.cases(4) {
                    let row = SweepRow::without_verdict(case, "id", Ended::Invalid, String::new());
                    writer.append(&row)?;
                }
            }
            Ok(state)
        }

        fn cancel_command(&self, id: &str, _: Option<&str>) -> String {
            id.to_owned()
        }
    }

    #[test]
    fn lost_parts_are_submitted_again_as_often_as_the_retries_say() {
        let cases = SweepCases::new(&plan()).unwrap();
        let output = tempfile::tempdir().unwrap();
        let campaign = campaign(&cases, output.path());
        let engine = Lossy {
            campaign: &campaign,
            jobs: Mutex::default(),
            questions: Mutex::default(),
        };
        let args = args("--engine slurm --parts 2 --retries 1 --quiet");
        let mut record = record(&args, &campaign).unwrap();
        let error = play(&args, &campaign, &engine, &mut record).unwrap_err();
        let text = "1 of 2 parts were lost, and were submitted 2 times.";
        assert!(error.reason.starts_with(text), "{error}");
        // The next command begins with the rows that there are.
        play(&args, &campaign, &engine, &mut record).unwrap();
        assert!(campaign.rows(2).unwrap().iter().all(Rows::is_whole));
        assert_eq!(*engine.jobs.lock().unwrap(), ["1-2", "2", "2"]);
    }

    #[test]
    fn a_campaign_of_months_has_as_many_parts_as_an_engine_takes() {
        let draws = Draws {
            runs: u32::MAX,
            seed: 1,
        };
        let cases = TortureCases::new(&plan(), draws);
        let campaign = campaign(&cases, Path::new("runs"));
        let record = record(&args("--engine slurm --quiet"), &campaign).unwrap();
        assert_eq!(record.parts, 1000);
    }
}
