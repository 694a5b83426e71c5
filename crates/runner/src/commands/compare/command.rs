//! The command `canrig compare`.

use std::path::{Path, PathBuf};

use clap::Args;

use super::page::{self, Compared, LETTERS};
use crate::console::{WorkBar, print, print_text};
use crate::exit::{Exit, Failure};
use crate::number;
use crate::output::{link, write};
use crate::recorded::Recorded;
use judge::comparison::{
    Comparison, GivenTolerance, SIGNAL_PASSES, Scale, SignalDifference, Tolerances, compare_runs,
};
use recording::run_folder::file;
use scenario::metrics::is_traffic_metric;
use worlds::catalogue::catalogue;

/// Number of passes over the frames of a run: to read, to decode and to judge them.
const PASSES: u64 = 3;

/// Arguments of `compare`.
#[derive(Args, Debug)]
pub struct CompareArgs {
    /// A run folder, or a log of `candump -L` in a folder with its scenario.toml
    pub a: PathBuf,
    /// The run that is compared with A
    pub b: PathBuf,
    /// How far a signal, a metric or all signals of a unit may differ: `position_millimetres=0.5`, `degrees=2`; `inf`
    /// leaves it out
    #[arg(long, value_name = "NAME=VALUE", value_delimiter = ',')]
    pub tolerance: Vec<GivenTolerance>,
    /// How much earlier or later a value of B may come
    #[arg(long, value_name = "MILLISECONDS", default_value_t = 5.0, value_parser = milliseconds)]
    pub time_tolerance: f64,
    /// Compare the timing too where one run was played in real time and the other in virtual time
    #[arg(long)]
    pub timing: bool,
    /// Write a page with plots of what differs
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Print the comparison as JSON
    #[arg(long)]
    pub json: bool,
}

/// Parses a time from 0 to 10 s.
fn milliseconds(text: &str) -> Result<f64, String> {
    let expected = "a number of milliseconds is expected";
    let limits = "the time must be from 0 to 10000 ms";
    number::parse(text, 0.0..=10_000.0, expected, limits)
}

/// Compares two recordings; the exit code is 0 if they agree, 1 if they diverge.
pub fn compare(args: &CompareArgs) -> Result<Exit, Failure> {
    let (comparison, page) = compared(args)?;
    if args.json {
        print(&serde_json::to_string_pretty(&comparison).expect("plain data"));
    } else {
        print_text(&page::to_text(&comparison));
    }
    if let Some((place, text)) = page {
        write(place, text.as_bytes())?;
        if !args.json {
            print(&format!("plots  {}", place.display()));
        }
    }
    Ok(if comparison.agrees {
        Exit::Pass
    } else {
        Exit::VerdictFailed
    })
}

type Page<'a> = Option<(&'a Path, String)>;

fn compared(args: &CompareArgs) -> Result<(Comparison, Page<'_>), Failure> {
    let bar = WorkBar::new(2 * PASSES + SIGNAL_PASSES, true);
    let [a, b] = [&args.a, &args.b].map(|path| Recorded::load(path, None, catalogue()));
    let (a, b) = (a?, b?);
    bar.expect(2 * PASSES + a.passes_for_timing() + b.passes_for_timing() + SIGNAL_PASSES);
    let (a, b) = (a.judged(Recorded::judge)?, b.judged(Recorded::judge)?);
    let tolerances = Tolerances {
        given: &args.tolerance,
        time_seconds: args.time_tolerance / 1e3,
        scales: a.recorded.plan.loops.iter().map(Scale::of).collect(),
    };
    if let Some(name) = tolerances.unknown_name(&a.timelines, [&a.verdict, &b.verdict]) {
        let reason = format!("--tolerance: no signal, metric or unit is called `{name}`");
        return Err(Exit::Usage.because(reason));
    }
    let mut comparison = compare_runs(
        &tolerances,
        (&a.timelines, &a.verdict),
        (&b.timelines, &b.verdict),
    );
    let [a_clock, b_clock] = [&a, &b].map(|run| run.recorded.log.frames.clock());
    if !args.timing && a_clock != b_clock {
        leave_timing_out(&mut comparison);
    }
    for (letter, run) in LETTERS.iter().zip([&a, &b]) {
        for remark in run.recorded.log.unread.remarks() {
            comparison.remarks.push(format!("of {letter}, {remark}"));
        }
    }
    let page = args.output.as_deref().map(|place| {
        let runs = [&a, &b];
        let compared = Compared {
            comparison: &comparison,
            runs,
            pages: runs.map(|run| link(place, &run.recorded.path.join(file::REPORT))),
            time_tolerance_seconds: tolerances.time_seconds,
        };
        (place, page::to_html(&compared))
    });
    Ok((comparison, page))
}

/// Removes the metrics of the traffic, which depend on the clock: a run in virtual time misses no cycle.
fn leave_timing_out(comparison: &mut Comparison) {
    let whole = comparison.remarks.is_empty();
    comparison
        .metrics
        .retain(|metric| !is_traffic_metric(&metric.name));
    comparison.agrees = whole
        && comparison.signals.iter().all(SignalDifference::agrees)
        && comparison.metrics.iter().all(|metric| metric.agrees);
    comparison.remarks.push(
        "one run was played in real time, the other in virtual time: the metrics of the timing are left out (--timing compares them)".to_owned(),
    );
}
