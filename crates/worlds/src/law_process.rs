//! Laws in processes: `[controller.program]`, and canrig's own worker for `[controller.library]` and `[controller.fmu]`.
//!
//! The process has a port seat ([`platform::seat`]). Virtual time waits for its answers; in real time an answer that does not
//! come in time is late, and counted.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use controller::law::Cycle;
use controller::process_law::{self, Player, Window};
use fmu::Unpacked;
use plan::Plan;
use platform::clock::Clock;
use platform::program::{END_PATIENCE, Listener, Order, PORTS_VARIABLE, Program, START_PATIENCE};
use platform::seat::{
    Header, IS_MISSING, Kind, MESSAGE_BYTES_MAX, numbers, read_answer, read_hello, read_values,
    write_numbers, write_welcome,
};
use scenario::node::Part;
use scenario::process_law::{Plays, ProcessLaw};
use serde_json::json;

use crate::fmu_plant;
use crate::law_worker;

/// Number of cycles in a row without a timely answer after which a law has failed.
const LATE_IN_A_ROW_MAX: u32 = 20;
/// Number of waits without an answer after which a process is dead in virtual time. A standstill of the machine takes one wait.
const WAITS_MAX: u32 = 100;
const WAIT: Duration = Duration::from_millis(100);
/// Time for a process that closed its channel to end.
pub(crate) const CLOSED_PATIENCE: Duration = Duration::from_secs(10);
/// Description of a process that does not end then.
const CLOSED: &str = "closed its channel";

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
    pub(crate) fn start(&self, part: &process_law::Part) -> Result<Box<dyn Player>, String> {
        let mut unpacked = None;
        let command = match &part.plays {
            Plays::Command(words) => words.clone(),
            Plays::Library(file) => law_worker::command(file, None)?,
            Plays::Fmu(file) => {
                let files = unpacked.insert(fmu_plant::unpacked(file)?);
                law_worker::command(file, Some(files.folder()))?
            }
        };
        let clock = if self.is_real_time { "real" } else { "virtual" };
        let law = &part.plays;
        let (who, log_name) = match part.loop_name.as_str() {
            "" => (format!("the law's process `{law}`"), "law.log".to_owned()),
            name => (
                format!("the process `{law}` of the law of `{name}`"),
                format!("{name}.law.log"),
            ),
        };
        let log = self.logs.as_ref().map(|logs| logs.join(log_name));
        let program = Listener::open().and_then(|listener| {
            let seat = listener.path().to_string_lossy().into_owned();
            let order = Order {
                command: &command,
                folder: &self.folder,
                log: log.as_deref(),
                environment: &[
                    (PORTS_VARIABLE, seat),
                    ("CANRIG_CLOCK", clock.to_owned()),
                    ("CANRIG_SEED", self.seed.to_string()),
                ],
            };
            Program::start(&order, Some(listener))
        });
        let program = program
            .map_err(|error| format!("no process for the law `{law}` can be started: {error}"))?;
        let mut law = LawProcess {
            who,
            outputs: [&part.writes[..], &part.terms].concat(),
            program,
            _unpacked: unpacked,
            is_gone: false,
            clock: Clock::start(),
            is_real_time: self.is_real_time,
            ahead: Duration::MAX,
            asked: 0,
            answered: 0,
            message: Vec::with_capacity(MESSAGE_BYTES_MAX),
            answer: vec![0; MESSAGE_BYTES_MAX],
            late: Arc::clone(&self.late),
            late_in_a_row: 0,
            failure: None,
        };
        if let Err(why) = law.meet(part, self.seed) {
            law.fail(&why);
        }
        Ok(Box::new(law))
    }
}

/// Returns the folder of a plan's scenario.
pub fn scenario_folder(plan: &Plan) -> PathBuf {
    let folder = plan.shared.beside.scenario().parent();
    let folder = folder.filter(|folder| *folder != Path::new(""));
    folder.unwrap_or(Path::new(".")).to_owned()
}

/// Returns the additional time for a controller with these laws until it is there, and for its end.
pub(crate) fn more_patience(plan: &Plan) -> [Duration; 2] {
    let mut laws = plan.loops.iter().map(|one| &one.trial.controller);
    if laws.any(|law| law.process_law().is_some()) {
        [3 * START_PATIENCE + CLOSED_PATIENCE, END_PATIENCE]
    } else {
        [Duration::ZERO; 2]
    }
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
    let ours = plan
        .loops
        .iter()
        .filter(|one| one.is_ours(Part::Controller));
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
    program: Program,
    /// Files of an FMU, which its process has open.
    _unpacked: Option<Arc<Unpacked>>,
    /// Whether it closed its end of the channel.
    is_gone: bool,
    clock: Clock,
    is_real_time: bool,
    /// Smallest lead seen of its clock over the node's time, which is never later than the present.
    ahead: Duration,
    /// Number of the latest question, and of the latest one that was answered.
    asked: u32,
    answered: u32,
    message: Vec<u8>,
    answer: Vec<u8>,
    late: Arc<AtomicU64>,
    late_in_a_row: u32,
    failure: Option<String>,
}

impl LawProcess {
    /// Waits for the process, and sends it its part.
    fn meet(&mut self, part: &process_law::Part, seed: u64) -> Result<(), String> {
        let wrong = |error: std::io::Error| format!("cannot be reached: {error}");
        if !self.program.accept().map_err(wrong)? {
            return Err(match self.program.ended(Duration::ZERO) {
                Some(ended) => end_text(&ended),
                None => format!("did not come to its seat in {} s", START_PATIENCE.as_secs()),
            });
        }
        let hello = self.first_answer()?;
        read_hello(hello).map_err(|wrong| format!("spoke what is no HELLO: {wrong}"))?;
        let mut welcome = json!({
            "reads": part.reads,
            "writes": part.writes,
            "terms": part.terms,
            "ranges": part.ranges,
            "parameters": part.parameters,
            "period_seconds": part.period.as_secs_f64(),
        });
        if !part.variables.is_empty() {
            welcome["variables"] = json!(part.variables);
        }
        write_welcome(&mut self.message, seed, welcome.to_string().as_bytes());
        self.program.send(&self.message).map_err(wrong)?;
        let ready = read_answer(self.first_answer()?, Kind::Done, 0)
            .map_err(|wrong| format!("answered WELCOME with what is no answer: {wrong}"))?;
        ready.map(drop).map_err(|text| format!("gave up: {text}"))
    }

    /// Waits for the message before the first cycle.
    fn first_answer(&mut self) -> Result<&[u8], String> {
        let received = self.program.receive(&mut self.answer, START_PATIENCE);
        match received.map_err(|error| format!("cannot be reached: {error}"))? {
            Some(length @ 1..) => Ok(&self.answer[..length]),
            None => Err(format!("was not ready in {} s", START_PATIENCE.as_secs())),
            Some(0) => Err(match self.program.ended(CLOSED_PATIENCE) {
                Some(ended) => end_text(&ended),
                None => CLOSED.to_owned(),
            }),
        }
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
        self.asked = self.asked.wrapping_add(1);
        let time = Duration::try_from_secs_f64(cycle.scenario_time_seconds)
            .unwrap_or_default()
            .as_nanos();
        let is_missing = reads.iter().any(|value| value.is_nan());
        let header = Header {
            a: if is_missing { IS_MISSING } else { 0 },
            number: self.asked,
            time: u64::try_from(time).unwrap_or(u64::MAX),
            ..Header::of(Kind::Step)
        };
        let period = Some(cycle.period_seconds);
        write_numbers(&mut self.message, header, period, reads);
        self.is_gone |= self.program.send(&self.message).is_err();
    }

    /// Waits for the answer; returns false if none comes in time, or none will come.
    fn wait(&mut self, window: &Window, writes: &mut [f64]) -> bool {
        let mut waits = 0;
        while !self.is_gone {
            let patience = self.patience(window, WAIT);
            match self.program.receive(&mut self.answer, patience) {
                Ok(Some(length @ 1..)) => {
                    if let Some(is_answer) = self.take(length, writes) {
                        return is_answer;
                    }
                }
                Ok(None) if self.is_real_time => return false,
                Ok(None) if waits < WAITS_MAX => waits += 1,
                Ok(None) => {
                    let seconds = (WAITS_MAX * WAIT).as_secs();
                    self.fail(&format!("did not answer in {seconds} s"));
                    return false;
                }
                Ok(Some(0)) | Err(_) => self.is_gone = true,
            }
        }
        // In real time one of the next cycles sees how it ended.
        let patience = self.patience(window, CLOSED_PATIENCE);
        match self.program.ended(patience) {
            Some(ended) => self.fail(&end_text(&ended)),
            None if self.is_real_time => {}
            None => self.fail(CLOSED),
        }
        false
    }

    /// Returns whether a message is a valid answer; `None` for a late answer to an earlier question.
    fn take(&mut self, length: usize, writes: &mut [f64]) -> Option<bool> {
        self.answered = self.answered.wrapping_add(1);
        let told = read_values(&self.answer[..length], self.answered, writes.len());
        let what = match told {
            Ok(Ok(body)) => match numbers(body).position(|value| !value.is_finite()) {
                _ if self.answered != self.asked => return None,
                None => {
                    let values = writes.iter_mut().zip(numbers(body));
                    values.for_each(|(write, value)| *write = value);
                    return Some(true);
                }
                Some(place) => {
                    let value = numbers(body).nth(place).unwrap_or(f64::NAN);
                    format!("answered {value} for `{}`", self.outputs[place])
                }
            },
            Ok(Err(text)) => format!("gave up: {text}"),
            Err(wrong) => format!("answered what is no answer: {wrong}"),
        };
        self.fail(&what);
        Some(false)
    }
}

/// Describes the end of a process, with its last output.
fn end_text((how, output): &(String, String)) -> String {
    format!("{how}{}", output_end(output))
}

/// Returns the end of a message with the last output of a process, if there is any.
pub(crate) fn output_end(output: &str) -> String {
    match output {
        "" => String::new(),
        output => format!("; the end of its output:\n{}", indented(output)),
    }
}

/// Indents lines below a message.
pub(crate) fn indented(output: &str) -> String {
    let lines = output.lines().map(|line| format!("    {line}"));
    Vec::from_iter(lines).join("\n")
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
