//! Laws in processes: `[controller.program]`, and canrig's own worker for `[controller.library]` and `[controller.fmu]`.
//!
//! The process has a port seat ([`platform::seat`]). Virtual time waits for its answers; in real time an answer that does not
//! come in time is late, and counted.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use controller::law::Cycle;
use controller::process_law::{Player, Window};
use fmu::Unpacked;
use plan::Plan;
use platform::clock::Clock;
use platform::port_seat::{CLOSED, NoAnswer, PortSeat};
use platform::program::{Order, START_PATIENCE};
use platform::seat::{Header, IS_MISSING, Kind, numbers};
use platform::stop::is_requested;
use scenario::process_law::{LawSetup, Plays, ProcessLaw};

use crate::fmu_plant;
use crate::law_worker::{SUBCOMMAND, command};

/// Number of cycles in a row without a timely answer after which a law has failed.
const LATE_IN_A_ROW_MAX: u32 = 20;
/// Number of waits without an answer after which a process is dead in virtual time. A standstill of the machine takes one wait.
const WAITS_MAX: u32 = 100;
const WAIT: Duration = Duration::from_millis(100);
/// Time for a process that closed its channel to end.
pub(crate) const CLOSED_PATIENCE: Duration = Duration::from_secs(10);

/// Environment of the processes of laws.
#[derive(Clone, Debug)]
pub struct LawPlace {
    /// Name of their controller.
    pub controller: String,
    /// Their working directory: the folder of the scenario.
    pub folder: PathBuf,
    /// Folder of their output, which is not kept if `None`.
    pub logs: Option<PathBuf>,
    /// Whether the run is in real time, so that answers may be late.
    pub is_real_time: bool,
    /// Seed of the run.
    pub seed: u64,
    /// Number of cycles without a timely answer.
    pub late: Arc<AtomicU64>,
}

impl LawPlace {
    /// Makes the place of a plan in virtual time.
    pub fn of(plan: &Plan) -> Self {
        Self {
            controller: plan.controller().name.clone(),
            folder: scenario_folder(plan),
            logs: None,
            is_real_time: false,
            seed: plan.shared.run.seed,
            late: Arc::default(),
        }
    }

    /// Starts the process of a law. Its later errors are failures of the law.
    ///
    /// # Errors
    /// If the system refuses.
    pub(crate) fn start(&self, process: &ProcessLaw) -> Result<Box<dyn Player>, String> {
        let mut unpacked = None;
        let words = match &process.plays {
            Plays::Command(words) => words.clone(),
            Plays::Library(file) => command(SUBCOMMAND, &[Path::new(file)])?,
            Plays::Fmu(file) => {
                let files = unpacked.insert(fmu_plant::unpacked(file)?);
                command(SUBCOMMAND, &[Path::new(file), files.folder()])?
            }
        };
        let clock = if self.is_real_time { "real" } else { "virtual" };
        let law = &process.plays;
        let (who, log_name) = match process.loop_name.as_str() {
            "" => (format!("the law's process `{law}`"), "law.log".to_owned()),
            name => (
                format!("the process `{law}` of the law of `{name}`"),
                format!("{name}.law.log"),
            ),
        };
        let log = self.logs.as_ref().map(|logs| logs.join(log_name));
        let order = Order {
            command: &words,
            folder: &self.folder,
            log: log.as_deref(),
            part: None,
            environment: &[
                ("CANRIG_CLOCK", clock.to_owned()),
                ("CANRIG_SEED", self.seed.to_string()),
            ],
        };
        // Where a kill leaves the seat, it goes with the unpacked files.
        let place = unpacked.as_ref().map(|unpacked| unpacked.folder());
        let seat = PortSeat::start(&order, place)
            .map_err(|error| format!("no process for the law `{law}` can be started: {error}"))?;
        let mut law = LawProcess {
            who,
            outputs: [&process.setup.writes[..], &process.setup.terms].concat(),
            seat,
            _unpacked: unpacked,
            is_gone: false,
            clock: Clock::start(),
            is_real_time: self.is_real_time,
            ahead: Duration::MAX,
            late: Arc::clone(&self.late),
            late_in_a_row: 0,
            failure: None,
        };
        if let Err(why) = law.meet(&process.setup, self.seed) {
            law.fail(&why);
        }
        Ok(Box::new(law))
    }
}

/// Returns the folder of a plan's scenario.
pub fn scenario_folder(plan: &Plan) -> PathBuf {
    let parent = plan.shared.beside.scenario().parent();
    let folder = parent.filter(|folder| *folder != Path::new(""));
    folder.unwrap_or(Path::new(".")).to_owned()
}

/// Returns the additional time until the nodes are there whose plants and laws are processes.
pub(crate) fn processes_patience(plan: &Plan) -> Duration {
    let mut patience = Duration::ZERO;
    if plan.loops.iter().any(|one| one.trial.has_fmu()) {
        patience += START_PATIENCE;
    }
    if has_process_law(plan) {
        patience += 3 * START_PATIENCE + CLOSED_PATIENCE;
    }
    patience
}

/// Returns whether a law is a process, which its controller ends.
pub(crate) fn has_process_law(plan: &Plan) -> bool {
    let mut laws = plan.loops.iter().map(|one| &one.trial.controller);
    laws.any(|law| law.process_law().is_some())
}

/// Returns the programs, libraries and FMUs that are started for a plan, one line each.
pub fn started_by(plan: &Plan) -> Vec<String> {
    let programs = plan.programs().into_iter().map(|(node, program)| {
        let beside = &plan.shared.beside;
        let (command, folder) = beside.command(&program.command, &program.named_in);
        let (command, folder) = (command.join(" "), folder.display());
        format!("{}: starts `{command}` in {folder}", node.name)
    });
    let left_out = plan.shared.has_unused_law.then(|| {
        let name = &plan.controller().name;
        format!("{name}: a program leads, so [controller] of the scenario is left out")
    });
    let loops = plan.loops.iter();
    let ours = loops.filter(|one| one.controller().is_ours());
    let laws = ours.filter_map(|one| one.trial.controller.process_law());
    let folder = scenario_folder(plan);
    let line = |law: ProcessLaw| format!("law: starts `{}` in {}", law.plays, folder.display());
    programs.chain(left_out).chain(laws.map(line)).collect()
}

/// Law in a process.
#[derive(Debug)]
struct LawProcess {
    who: String,
    /// Names of its outputs.
    outputs: Vec<String>,
    seat: PortSeat,
    /// Files of an FMU, which its process has open.
    _unpacked: Option<Arc<Unpacked>>,
    /// Whether it closed its end of the channel.
    is_gone: bool,
    clock: Clock,
    is_real_time: bool,
    /// Smallest lead seen of its clock over the node's time, which is never later than the present.
    ahead: Duration,
    late: Arc<AtomicU64>,
    late_in_a_row: u32,
    failure: Option<String>,
}

impl LawProcess {
    /// Waits for the process, and sends it its setup.
    fn meet(&mut self, setup: &LawSetup, seed: u64) -> Result<(), String> {
        let welcome = serde_json::to_value(setup).map_err(|error| error.to_string())?;
        let welcome = welcome.to_string();
        let met = self.seat.meet(seed, welcome.as_bytes(), CLOSED_PATIENCE);
        met.map_err(|why| unanswered(START_PATIENCE, why))
    }

    fn fail(&mut self, what: &str) {
        self.failure = Some(format!("{} {what}", self.who));
    }

    /// Returns the rest of a window in real time, otherwise this time.
    fn patience(&mut self, window: &Window, in_virtual_time: Duration) -> Duration {
        if !self.is_real_time {
            return in_virtual_time;
        }
        let now = self.clock.now();
        self.ahead = self.ahead.min(now.saturating_sub(window.now));
        (window.until + self.ahead).saturating_sub(now)
    }

    fn ask(&mut self, cycle: &Cycle, reads: &[f64]) {
        let time = Duration::try_from_secs_f64(cycle.scenario_time_seconds)
            .unwrap_or_default()
            .as_nanos();
        let is_missing = reads.iter().any(|value| value.is_nan());
        let header = Header {
            a: if is_missing { IS_MISSING } else { 0 },
            time: u64::try_from(time).unwrap_or(u64::MAX),
            ..Header::of(Kind::Step)
        };
        self.is_gone |= self.seat.step(header, cycle.period_seconds, reads).is_err();
    }

    /// Waits for the answer; returns false if none comes in time, or none will come.
    fn wait(&mut self, window: &Window, writes: &mut [f64]) -> bool {
        let mut waits = 0;
        while !self.is_gone {
            let patience = self.patience(window, WAIT);
            let answered = self.seat.values(patience, Duration::ZERO, writes.len());
            let taken = match answered {
                // A late answer to an earlier question has no effect.
                Ok(None) => continue,
                Ok(Some(body)) => take(body, writes, &self.outputs),
                Err(NoAnswer::Ended(_)) => break,
                Err(NoAnswer::Late) if self.is_real_time => return false,
                Err(NoAnswer::Late) if waits < WAITS_MAX && !is_requested() => {
                    waits += 1;
                    continue;
                }
                Err(why) => Err(unanswered(WAITS_MAX * WAIT, why)),
            };
            if let Err(what) = &taken {
                self.fail(what);
            }
            return taken.is_ok();
        }
        self.is_gone = true;
        // In real time one of the next cycles sees how it ended.
        let patience = self.patience(window, CLOSED_PATIENCE);
        match self.seat.program.ended(patience) {
            Some(ended) => self.fail(&end_text(&ended)),
            None if self.is_real_time => {}
            None => self.fail(CLOSED),
        }
        false
    }
}

/// Describes the reason why a process gives no answer.
fn unanswered(patience: Duration, why: NoAnswer) -> String {
    match why {
        NoAnswer::Ended(ended) => end_text(&ended),
        NoAnswer::Late => format!("did not answer in {} s", patience.as_secs()),
        NoAnswer::GaveUp(text) => format!("gave up: {text}"),
        NoAnswer::Wrong(what) => what,
    }
}

/// Takes the values of an answer.
///
/// # Errors
/// If one of them is no number.
fn take(body: &[u8], writes: &mut [f64], outputs: &[String]) -> Result<(), String> {
    let mut named = numbers(body).zip(outputs);
    if let Some((value, output)) = named.find(|(value, _)| !value.is_finite()) {
        return Err(format!("answered {value} for `{output}`"));
    }
    let values = writes.iter_mut().zip(numbers(body));
    values.for_each(|(write, value)| *write = value);
    Ok(())
}

/// Describes the end of a process, with its last output.
fn end_text((how, output): &(String, String)) -> String {
    format!("{how}{}", end_of("output", output))
}

/// Returns the end of a message with the last lines of a process's output or log, if there are any.
pub(crate) fn end_of(what: &str, lines: &str) -> String {
    if lines.is_empty() {
        return String::new();
    }
    let indented = Vec::from_iter(lines.lines().map(|line| format!("    {line}")));
    format!("; the end of its {what}:\n{}", indented.join("\n"))
}

impl Player for LawProcess {
    fn step(&mut self, cycle: &Cycle, window: &Window, reads: &[f64], writes: &mut [f64]) -> bool {
        if self.failure.is_some() {
            return false;
        }
        self.ask(cycle, reads);
        if self.is_real_time && window.until <= window.now {
            return false;
        }
        let is_in_time = self.wait(window, writes);
        if is_in_time {
            self.late_in_a_row = 0
        } else {
            self.late.fetch_add(1, Ordering::Relaxed);
            self.late_in_a_row += 1;
        }
        if self.late_in_a_row >= LATE_IN_A_ROW_MAX && self.failure.is_none() {
            let what = if self.is_gone {
                CLOSED.to_owned()
            } else {
                format!("did not answer in time in {LATE_IN_A_ROW_MAX} cycles in a row")
            };
            self.fail(&what);
        }
        is_in_time
    }

    fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }
}
