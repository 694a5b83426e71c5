//! Nodes that are programs, in virtual time: started by canrig, or awaited by their names, each at a bus seat.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use can::{CanFrame, Filter, Node as CanNode, Progress};
use faults::{FaultPlan, Faulty};
use platform::listener::Listener;
use platform::lockstep::{ANSWER_PATIENCE, Answer, Failure, Local, Participant, Remote, Setting};
use platform::program::{
    BUS_VARIABLE, END_PATIENCE, ORDERLY, Order, Program, START_PATIENCE, open_seat,
};
use scenario::node::NodeIndex;
use tempfile::NamedTempFile;

use crate::error::{Doing, WorldError};
use crate::law_process::{CLOSED_PATIENCE, end_of};
use crate::part;
use plan::Plan;

/// Time for a node that canrig does not start to come to its seat.
const EXPECTED_PATIENCE: Duration = Duration::from_secs(15);

/// Settings for the hosting of programs.
#[derive(Clone, Copy)]
pub struct Hosting<'a> {
    /// Folder of their output, which is not kept if `None`.
    pub logs: Option<&'a Path>,
    /// Longest time for an answer; no limit if `None`.
    pub patience: Option<Duration>,
    /// Reports the seat at which a node is expected.
    pub announce: &'a dyn Fn(&str),
}

impl Default for Hosting<'_> {
    fn default() -> Self {
        Self {
            logs: None,
            patience: Some(ANSWER_PATIENCE),
            announce: &|_| (),
        }
    }
}

/// Instructions to start a program and to speak with it.
#[derive(Clone, Debug)]
pub(crate) struct ProgramOrder {
    index: NodeIndex,
    name: String,
    /// Its command and its folder; `None` if canrig does not start it.
    pub(crate) command: Option<(Vec<String>, PathBuf)>,
    log: Option<PathBuf>,
    part: String,
    /// Description of the run at its begin.
    setting: Setting,
    patience: Option<Duration>,
}

impl ProgramOrder {
    /// Makes the orders for all nodes that canrig does not run itself: drives, io nodes, the controller.
    pub(crate) fn all(plan: &Plan, logs: Option<&Path>, patience: Option<Duration>) -> Vec<Self> {
        let order = |index: NodeIndex| {
            let node = &plan.nodes[index];
            let program = node.program();
            let beside = &plan.shared.beside;
            Self {
                index,
                name: node.name.clone(),
                command: program.map(|one| beside.command(&one.command, &one.named_in)),
                log: logs.map(|logs| logs.join(format!("{}.log", node.name))),
                part: part::of(plan, index).to_string(),
                setting: Setting {
                    now: Duration::ZERO,
                    bits_per_second: 1_000 * plan.shared.run.bus.bitrate_kilobits_per_second,
                    seed: plan.shared.run.seed,
                    node_id: node.id(),
                },
                patience,
            }
        };
        plan.external_nodes().map(order).collect()
    }

    /// Returns its name among the participants.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// Starts the program of the node, on a bus.
    ///
    /// # Errors
    /// If the system refuses.
    pub(crate) fn start(
        &self,
        bus: String,
        clock: &str,
        listener: Option<Listener>,
    ) -> io::Result<StartedProgram> {
        let Some((command, folder)) = &self.command else {
            return Err(io::Error::other("the node has no program"));
        };
        let mut part = NamedTempFile::with_prefix("canrig-part-")?;
        part.write_all(self.part.as_bytes())?;
        let order = Order {
            command,
            folder,
            log: self.log.as_deref(),
            part: Some(part.path()),
            environment: &[
                (BUS_VARIABLE, bus),
                ("CANRIG_NODE", self.name.clone()),
                ("CANRIG_NODE_ID", self.setting.node_id.to_string()),
                ("CANRIG_PART", part.path().to_string_lossy().into_owned()),
                ("CANRIG_CLOCK", clock.to_owned()),
                ("CANRIG_SEED", self.setting.seed.to_string()),
            ],
        };
        let program = Program::start(&order, listener)?;
        Ok(StartedProgram {
            program,
            _part: part,
        })
    }

    /// Brings the node to a seat of its own, at a time of the run.
    ///
    /// # Errors
    /// If it does not come, or speaks another protocol.
    fn seat(&self, now: Duration, announce: &dyn Fn(&str)) -> Result<ProgramNode, WorldError> {
        let name = self.name();
        let refused = |error| {
            if now.is_zero() {
                WorldError::spawn(name)(error)
            } else {
                WorldError::control(name, "started again")(error)
            }
        };
        let listener = open_seat().map_err(refused)?;
        let bus = format!("lockstep:{}", listener.path().display());
        let (channel, program) = if self.command.is_some() {
            let mut started = self
                .start(bus, "virtual", Some(listener))
                .map_err(refused)?;
            if !started.program.accept().map_err(refused)? {
                let how = format!("did not come to its seat in {} s", START_PATIENCE.as_secs());
                return Err(started.silent(name, how, Duration::ZERO));
            }
            (started.program.take_channel(), Some(started))
        } else {
            announce(&format!("{name}: expected at {bus}"));
            (listener.accept(EXPECTED_PATIENCE).map_err(refused)?, None)
        };
        let Some(channel) = channel else {
            let seconds = EXPECTED_PATIENCE.as_secs();
            let how = format!("did not come to its seat in {seconds} s");
            return Err(broken_off(name, how, "", Doing::GaveUp));
        };
        let setting = Setting {
            now,
            ..self.setting
        };
        match Remote::accept(name, channel, self.patience, setting) {
            Ok(remote) => Ok(ProgramNode {
                order: self.clone(),
                program,
                remote,
            }),
            Err(failure) => Err(explained(program, name, failure)),
        }
    }
}

/// Program that canrig started for a node.
#[derive(Debug)]
pub(crate) struct StartedProgram {
    pub(crate) program: Program,
    /// File with its part of the plan.
    _part: NamedTempFile,
}

impl StartedProgram {
    /// Returns the error for an end that nobody asked for, if it comes within a patience.
    pub(crate) fn end_by_itself(
        &mut self,
        name: &str,
        patience: Duration,
        when: &str,
    ) -> Option<WorldError> {
        let (how, output) = self.program.ended(patience)?;
        let doing = if how.starts_with("cannot be started") {
            Doing::NotSetUp
        } else {
            Doing::GaveUp
        };
        Some(broken_off(name, how + when, &output, doing))
    }

    /// Returns the error for a program that went silent, with its last output: how it ended by itself, otherwise `what`.
    fn silent(mut self, name: &str, what: String, patience: Duration) -> WorldError {
        let ended = self.end_by_itself(name, patience, "");
        ended.unwrap_or_else(|| self.broken(name, what))
    }

    /// Kills a program that broke its part, and returns the error for it, with its last output. Its channel may be closed
    /// already, which it may end of: that says nothing.
    fn broken(mut self, name: &str, what: String) -> WorldError {
        self.program.kill();
        let (_, output) = self.program.ended(END_PATIENCE).unwrap_or_default();
        broken_off(name, what, &output, Doing::Crashed)
    }

    /// Waits for the end of a program that has nothing more to do.
    ///
    /// # Errors
    /// If it did not end by itself, or ended badly.
    pub(crate) fn end(&mut self, name: &str) -> Result<(), WorldError> {
        let (how, output) = match self.program.dismiss() {
            Some((how, _)) if how == ORDERLY => return Ok(()),
            Some(ended) => ended,
            None => ("did not end".to_owned(), String::new()),
        };
        let how = how + " when it was to stop";
        Err(broken_off(name, how, &output, Doing::Crashed))
    }
}

/// Returns the error for a program that ended its part, with its last output.
fn broken_off(name: &str, how: String, output: &str, doing: Doing) -> WorldError {
    WorldError::Process {
        name: name.to_owned(),
        how,
        log: end_of("output", output),
        doing,
    }
}

/// Explains a failure of a node, if canrig started its program: of one that went silent, by its end.
fn explained(program: Option<StartedProgram>, name: &str, failure: Failure) -> WorldError {
    match (program, failure) {
        (Some(program), Failure::Ended) => {
            program.silent(name, "closed its channel".to_owned(), CLOSED_PATIENCE)
        }
        (Some(program), Failure::NoAnswer(patience)) => {
            let what = format!("gave no answer within {} s", patience.as_secs());
            program.silent(name, what, Duration::ZERO)
        }
        (Some(program), Failure::Step(source)) => program.broken(name, source.to_string()),
        (Some(program), failure @ (Failure::Protocol(_) | Failure::Overloaded(_))) => {
            program.broken(name, failure.to_string())
        }
        (_, failure) => WorldError::Participant {
            name: name.to_owned(),
            failure,
        },
    }
}

/// Node at its seat.
#[derive(Debug)]
struct ProgramNode {
    order: ProgramOrder,
    /// Dropped before the program, which waits at its other end.
    remote: Remote,
    /// The started program; `None` if canrig did not start it.
    program: Option<StartedProgram>,
}

impl ProgramNode {
    /// Ends it after a run; returns the result of the run, or of this end.
    fn finish<T>(self, played: Result<T, WorldError>) -> Result<T, WorldError> {
        let name = self.order.name();
        match played {
            Ok(played) => {
                drop(self.remote);
                let ended = self.program.map(|mut program| program.end(name));
                ended.unwrap_or(Ok(())).map(|()| played)
            }
            Err(WorldError::Participant {
                name: lost,
                failure,
            }) if lost == name => Err(explained(self.program, name, failure)),
            Err(error) => Err(error),
        }
    }
}

/// Node at its seat that is asked at each event, as faults need.
#[derive(Debug)]
struct Asked {
    /// The node at its seat; `None` once it is gone.
    node: Option<ProgramNode>,
    filters: Vec<Filter>,
    answer: Answer,
    queued: VecDeque<CanFrame>,
    /// Reason why it is gone, unless a fault ended it.
    failure: Option<WorldError>,
}

impl Asked {
    fn new(node: ProgramNode) -> Self {
        let hello = node.remote.hello();
        Self {
            filters: hello.filters.clone(),
            answer: Answer {
                next_deadline: hello.next_deadline,
                ..Answer::default()
            },
            queued: VecDeque::new(),
            failure: None,
            node: Some(node),
        }
    }

    fn ask(&mut self, ask: impl FnOnce(&mut Remote, &mut Answer) -> Result<(), Failure>) {
        let Some(node) = &mut self.node else { return };
        match ask(&mut node.remote, &mut self.answer) {
            Ok(()) => self
                .queued
                .extend(self.answer.frames.iter().map(|(_, frame)| *frame)),
            Err(failure) => {
                let name = node.order.name().to_owned();
                let program = self.node.take().and_then(|node| node.program);
                let failure = explained(program, &name, failure);
                self.answer.next_deadline = None;
                self.answer.progress = Progress::Failed(failure.to_string());
                self.failure = Some(failure);
            }
        }
    }

    fn advance(&mut self, now: Duration, frames: &[(Duration, CanFrame)]) {
        let deadline = self.answer.next_deadline;
        // A fault may have halted it beyond its deadline.
        let is_late = deadline.is_some_and(|deadline| deadline < now);
        self.ask(|remote, answer| {
            is_late.then(|| remote.was_halted());
            remote.advance(now, now, frames, answer)
        });
    }

    /// Ends it after a run, unless a fault ended it, or it gave up.
    fn finish<T>(&mut self, played: Result<T, WorldError>) -> Result<T, WorldError> {
        match (self.failure.take(), self.node.take()) {
            (Some(failure), _) if played.is_ok() => Err(failure),
            (_, Some(node)) if self.answer.progress == Progress::Stopped => node.finish(played),
            _ => played,
        }
    }

    /// Ends the process of a node that a fault ends, and starts another one in its place.
    fn renew(&mut self) {
        let Some(node) = self.node.take() else { return };
        let order = node.order.clone();
        if let Some(started) = &node.program {
            started.program.kill();
        }
        let now = self.answer.reached;
        drop(node);
        match order.seat(now, &|_| ()) {
            Ok(node) => *self = Self::new(node),
            Err(failure) => {
                self.answer.progress = Progress::Failed(failure.to_string());
                self.failure = Some(failure);
            }
        }
    }
}

impl CanNode for Asked {
    fn filters(&self) -> Vec<Filter> {
        self.filters.clone()
    }

    fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        self.advance(now, &[(now, *frame)]);
    }

    fn on_tick(&mut self, now: Duration) {
        self.advance(now, &[]);
    }

    fn on_stop(&mut self, now: Duration) {
        self.ask(|remote, answer| remote.stop(now, answer));
    }

    fn next_frame(&mut self) -> Option<CanFrame> {
        self.queued.pop_front()
    }

    fn next_deadline(&self) -> Option<Duration> {
        self.answer.next_deadline
    }

    fn progress(&self) -> Progress {
        self.answer.progress.clone()
    }
}

/// Nodes of a run that canrig does not run itself, at their seats. In a run all are of one kind.
#[derive(Default)]
pub(crate) struct Guests {
    plain: Vec<ProgramNode>,
    /// Nodes with faults around them, by their names.
    faulty: Vec<(String, Faulty<Asked>)>,
}

impl Guests {
    /// Brings them to their seats.
    ///
    /// # Errors
    /// If one of them does not come, or speaks another protocol.
    pub(crate) fn seat(plan: &Plan, hosting: &Hosting<'_>) -> Result<Self, WorldError> {
        let mut guests = Self::default();
        for order in ProgramOrder::all(plan, hosting.logs, hosting.patience) {
            let node = order.seat(Duration::ZERO, hosting.announce)?;
            if plan.has_faults() {
                let (faults, clock) = (faults_at(plan, order.index), plan.scenario_clock()?);
                let faulty = Faulty::new(Asked::new(node), faults, clock, Asked::renew);
                guests.faulty.push((order.name, faulty));
            } else {
                guests.plain.push(node);
            }
        }
        Ok(guests)
    }

    /// Returns them as participants: those without faults, and those with faults around them. The controller is the last one.
    pub(crate) fn participants(&mut self) -> (Vec<&mut Remote>, Vec<Local<'_>>) {
        let plain = self.plain.iter_mut().map(|node| &mut node.remote);
        let faulty = self.faulty.iter_mut();
        let faulty = faulty.map(|(name, node)| Local::new(&*name, node));
        (plain.collect(), faulty.collect())
    }

    /// Ends them after a run; returns the result of the run.
    ///
    /// # Errors
    /// With the reason why the run broke off, or with the first bad end of one of them.
    pub(crate) fn finish<T>(self, played: Result<T, WorldError>) -> Result<T, WorldError> {
        let plain = self.plain.into_iter().rev();
        let played = plain.fold(played, |played, node| node.finish(played));
        let faulty = self.faulty.into_iter().rev();
        faulty.fold(played, |played, (_, mut node)| {
            node.node_mut().finish(played)
        })
    }
}

/// Returns the faults of a node.
pub(crate) fn faults_at(plan: &Plan, node: NodeIndex) -> FaultPlan {
    FaultPlan::new(&plan.shared.run.faults.at_node(node), plan.nodes[node].id())
}
