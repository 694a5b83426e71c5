//! Data that identification takes from a recording: the inputs over time and the measured positions.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dbc::{Database, SignalMissing, names};
use plant_emulator::plant::Inputs;
use scenario::plant::Sensor;
use scenario::rig::RealDrive;
use scenario::{ScenarioError, Trial};

use dbc::scenario_clock::SYNC_COB_ID;
use plan::{ControlLoop, Plan, Shared};
use recording::log::{self, Stamped};
use recording::run_folder::{file_in, log_in};
use recording::session::{FileError, ReadError, read_plan};
use recording::timeline::{self, Series, Timeline};
use worlds::catalogue::catalogue;

/// Time between the positions that are compared. The wire's time constant is 0.65 s; closer positions would add little.
const GRID_SECONDS: f64 = 0.01;
/// Duration of the shortest recording, some time constants of the wire.
const DURATION_SECONDS_MIN: f64 = 3.0;
/// Longest gap that is bridged by holding the inputs, unless [`GAP_CYCLES_MAX`] is longer.
const GAP_SECONDS_MAX: f64 = 0.02;
/// The same in cycles: without a SYNC the drive itself holds its command.
const GAP_CYCLES_MAX: f64 = 2.5;
/// Delay of a command: if it comes in the cycle of row k, it flows until row k + 2.
const COMMAND_CYCLES: usize = 2;
/// Largest share of cycles without a position.
const MISSED_PERCENT_MAX: f64 = 1.0;
/// Smallest motion, in steps of the sensor.
const MOTION_STEPS_MIN: f64 = 20.0;
/// Largest distance from the stop at the start of a recording, in steps of the sensor.
const START_STEPS_MAX: f64 = 8.0;

/// Reason why a recording cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{}: {fault}", path.display())]
pub struct RecordingError {
    /// Path of the recording.
    pub path: PathBuf,
    /// Error in it.
    pub fault: RecordingFault,
}

/// Error in a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordingFault {
    /// A file cannot be read.
    #[error("{name} cannot be read: {source}")]
    Read {
        /// Name of the file.
        name: String,
        /// Error of the system.
        source: io::Error,
    },
    /// The scenario is invalid.
    #[error("the scenario is invalid: {0}")]
    Scenario(Box<ScenarioError>),
    /// A file of the folder is invalid.
    #[error(transparent)]
    File(#[from] FileError),
    /// The plant is not a shape-memory-alloy wire.
    #[error(
        "its plant is `{0}`; identification knows the equations of the shape-memory-alloy wire only"
    )]
    OtherPlant(String),
    /// The scenario has several drives.
    #[error(
        "it is of {0} loops; identification explains one wire behind one drive, so play a scenario of one loop and take its recording"
    )]
    SeveralLoops(usize),
    /// The recording is a log without its scenario.
    #[error(
        "a log alone does not hold the cycle time and the sensor; name the scenario that was played with --scenario"
    )]
    NoScenario,
    /// The DBC lacks a signal.
    #[error("{0}; identification needs the rig's own DBC")]
    Signal(#[from] SignalMissing),
    /// No frame is of the drive.
    #[error(
        "none of its {frames} frames is {message} (0x{id:03X}), the drive's position and current: is it the right DBC?"
    )]
    NoDriveFrames {
        /// Number of frames in the log.
        frames: usize,
        /// Name of the message that was sought.
        message: String,
        /// Identifier of the message.
        id: u32,
    },
    /// There are frames of the drive, but the scenario time never begins.
    #[error("{reason}, so scenario time never begins: is it the right DBC?")]
    NeverBegan {
        /// Missing condition for the beginning.
        reason: &'static str,
    },
    /// The recording is too short.
    #[error("it is {seconds:.2} s long, identification needs {DURATION_SECONDS_MIN} s")]
    TooShort {
        /// Duration of the recording.
        seconds: f64,
    },
    /// The recording has a long gap.
    #[error(
        "it has a gap of {gap_seconds:.3} s at {at_seconds:.3} s (limit {limit_seconds:.3} s): the current in it is unknown"
    )]
    Gap {
        /// Time of the gap.
        at_seconds: f64,
        /// Duration of the gap.
        gap_seconds: f64,
        /// Longest gap that is bridged.
        limit_seconds: f64,
    },
    /// Too many cycles have no position.
    #[error("{percent:.1} % of its cycles have no position (limit {MISSED_PERCENT_MAX} %)")]
    MissedCycles {
        /// Share of those cycles.
        percent: f64,
    },
    /// A value is outside the range of the rig.
    #[error(
        "the {quantity} is {value} {unit} at {at_seconds:.3} s, outside {lower} to {upper} {unit}: is it the right DBC?"
    )]
    Implausible {
        /// Name of the quantity.
        quantity: &'static str,
        /// Value of the quantity.
        value: f64,
        /// Unit of the quantity.
        unit: &'static str,
        /// Time of the value.
        at_seconds: f64,
        /// Smallest plausible value.
        lower: f64,
        /// Largest plausible value.
        upper: f64,
    },
    /// The load is up at the start.
    #[error(
        "the load is at {millimetres:.2} mm when it begins; only a cold start on the stop has a known temperature"
    )]
    NotAtRest {
        /// First position.
        millimetres: f64,
    },
    /// The load does not move enough.
    #[error(
        "the load moves by {millimetres:.2} mm at most (identification needs {needed_millimetres:.2} mm), with currents up to \
         {current_amperes_max:.3} A: without motion the position shows nothing of the parameters"
    )]
    NoMotion {
        /// Difference of the highest and the lowest position.
        millimetres: f64,
        /// Smallest sufficient motion.
        needed_millimetres: f64,
        /// Largest current.
        current_amperes_max: f64,
    },
}

/// A period of constant inputs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// Length of the period.
    pub duration_seconds: f64,
    /// Inputs of the plant.
    pub inputs: Inputs,
    /// Index in [`IdentificationData::positions_metres`] of the position at the end of the period, if it was measured.
    pub sample: Option<usize>,
}

/// One recording, ready for comparison with a simulation from the start state.
#[derive(Clone, Debug)]
pub struct IdentificationData {
    /// Path of the recording.
    pub path: PathBuf,
    /// Text of the scenario that was played; empty if there is none.
    pub text: String,
    /// Loop of the recording.
    pub control_loop: ControlLoop,
    /// Tables that the scenario names, by these names.
    pub tables: BTreeMap<String, String>,
    /// Sensor of the recording.
    pub sensor: Sensor,
    /// Inputs from scenario time 0 on.
    pub stretches: Vec<Stretch>,
    /// Scenario time of each position.
    pub times_seconds: Vec<f64>,
    /// Measured positions.
    pub positions_metres: Vec<f64>,
    /// Current at each position, for plots.
    pub currents_amperes: Vec<f64>,
}

impl From<ReadError> for RecordingFault {
    fn from(error: ReadError) -> Self {
        match error {
            ReadError::Scenario(error) => Self::Scenario(error),
            ReadError::File(error) => Self::File(error),
        }
    }
}

impl IdentificationData {
    /// Reads a run folder, or a log of `candump -L` together with the scenario that was played. Frames are decoded by
    /// `database`; without it by the DBC of the run folder, else by the DBC of the emulated drive.
    ///
    /// # Errors
    /// The recording cannot be read, or identification cannot use it.
    pub fn load(
        path: &Path,
        scenario: Option<&Path>,
        database: Option<&Database>,
    ) -> Result<Self, RecordingError> {
        let at = |fault| RecordingError {
            path: path.to_owned(),
            fault,
        };
        let metadata = path.metadata().map_err(|source| {
            let name = "the recording".to_owned();
            at(RecordingFault::Read { name, source })
        })?;
        let (log, mut plan) = if metadata.is_dir() {
            let plan = read_plan(path, Some(&[]), catalogue()).map_err(|error| at(error.into()))?;
            let name = log_in(path);
            let log = file_in(path, name).map_err(|source| {
                let name = name.to_owned();
                at(RecordingFault::Read { name, source })
            });
            (log?, plan)
        } else {
            let scenario = scenario.ok_or_else(|| at(RecordingFault::NoScenario))?;
            (path.to_owned(), load_plan(scenario).map_err(at)?)
        };
        for one in &mut plan.loops {
            if let Some(drive) = &one.real_drive {
                one.trial.sensor = real_sensor(&drive.real);
            }
        }
        if let Some(database) = database {
            plan = plan.with_database(&Arc::new(database.clone()));
        }
        let frames = read(&log).map_err(at)?;
        Self::from_plan(path, &frames, &plan).map_err(at)
    }

    /// Reads the frames of a recording on the emulated rig.
    ///
    /// # Errors
    /// Identification cannot use the recording.
    pub fn from_frames(
        path: &Path,
        frames: &[Stamped],
        scenario: Trial,
    ) -> Result<Self, RecordingFault> {
        let plan = Plan::new(scenario, catalogue()).with_database(&shipped());
        Self::from_plan(path, frames, &plan)
    }

    fn from_plan(path: &Path, frames: &[Stamped], plan: &Plan) -> Result<Self, RecordingFault> {
        let [only] = &plan.loops[..] else {
            return Err(RecordingFault::SeveralLoops(plan.loops.len()));
        };
        let plant = &only.trial.plant;
        if plant.actuator().is_none() {
            return Err(RecordingFault::OtherPlant(plant.name().to_owned()));
        }
        let timelines = timeline::decode(frames, plan)?;
        let timeline = &timelines[0];
        check_frames(frames, only, timeline)?;
        check_values(timeline, &only.trial)?;
        Ok(Self::build(path, timeline, only, &plan.shared))
    }

    fn build(
        path: &Path,
        timeline: &Timeline,
        control_loop: &ControlLoop,
        shared: &Shared,
    ) -> Self {
        let mut measurement = Self {
            path: path.to_owned(),
            sensor: control_loop.trial.sensor.clone(),
            text: shared.text.clone(),
            control_loop: control_loop.clone(),
            tables: shared.tables.clone(),
            stretches: Vec::new(),
            times_seconds: Vec::new(),
            positions_metres: Vec::new(),
            currents_amperes: Vec::new(),
        };
        let disturbances = Disturbances::new(timeline);
        let grid = timeline.cycles_in(GRID_SECONDS);
        let flowed = flowed(timeline);
        let samples = timeline
            .time_seconds
            .iter()
            .zip(timeline.position())
            .skip(1);
        let rows = timeline
            .cycle
            .pairs()
            .zip(flowed.iter().skip(1))
            .zip(samples);
        for (row, (((before, cycle), current_amperes), (time, position))) in rows.enumerate() {
            let inputs = Inputs {
                current_amperes,
                ..disturbances.at(row)
            };
            let cycles = (cycle - before) as f64;
            let is_sampled = cycle.is_multiple_of(grid) && !position.is_nan();
            let sample = is_sampled.then_some(measurement.positions_metres.len());
            if is_sampled {
                measurement.times_seconds.push(time);
                measurement.positions_metres.push(position * 1e-3);
                measurement.currents_amperes.push(inputs.current_amperes);
            }
            measurement.extend(cycles * timeline.period_seconds, inputs, sample);
        }
        measurement
    }

    /// Appends a period. A period with the inputs of the last one is joined to it.
    fn extend(&mut self, duration_seconds: f64, inputs: Inputs, sample: Option<usize>) {
        match self.stretches.last_mut() {
            Some(last) if last.sample.is_none() && last.inputs == inputs => {
                last.duration_seconds += duration_seconds;
                last.sample = sample;
            }
            _ => self.stretches.push(Stretch {
                duration_seconds,
                inputs,
                sample,
            }),
        }
    }

    /// Returns one step of the sensor's converter.
    pub fn sensor_step_metres(&self) -> f64 {
        sensor_step_millimetres(&self.sensor) * 1e-3
    }
}

/// Reads the plan of a scenario's file on the emulated rig.
fn load_plan(path: &Path) -> Result<Plan, RecordingFault> {
    let invalid = |error| RecordingFault::Scenario(Box::new(error));
    Plan::load(path, catalogue()).map_err(invalid)
}

/// Returns the DBC of the SMA actuator under a shipped law.
fn shipped() -> Arc<Database> {
    Arc::new(Database::shipped().clone())
}

/// Returns the current up to each row, in amperes.
fn flowed(timeline: &Timeline) -> Series<f64> {
    let reported = timeline.current();
    let reported = reported.filter(|values| values.iter().any(|value| !value.is_nan()));
    let Some(reported) = reported else {
        return commanded(timeline);
    };
    // The current that the drive reports at a SYNC flowed until then.
    let mut flowed = reported.to_vec();
    let mut next = 0.0;
    for value in flowed.iter_mut().rev() {
        if value.is_nan() {
            *value = next;
        }
        next = *value;
    }
    flowed.into()
}

/// Returns the command that acts up to each row, for a drive that does not report its current. A command that is
/// computed from the sample of a SYNC acts from the next SYNC on.
fn commanded(timeline: &Timeline) -> Series<f64> {
    let column = timeline.column(names::TARGET_CURRENT);
    let mut last = 0.0;
    let held = column
        .into_iter()
        .flat_map(|column| &column.values)
        .map(|value| {
            if !value.is_nan() {
                last = value;
            }
            last
        });
    let delayed = std::iter::repeat_n(0.0, COMMAND_CYCLES).chain(held);
    delayed.take(timeline.cycle.len()).collect()
}

/// Returns the sensor of a real drive, with counts that cover the travel.
fn real_sensor(real: &RealDrive) -> Sensor {
    let step = real.drive.position.resolution;
    let bits = libm::ceil(libm::log2(real.limits.max / step)).clamp(1.0, 24.0);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped just above"
    )]
    let resolution_bits = bits as u32;
    Sensor {
        resolution_bits,
        span: step * f64::from(1_u32 << resolution_bits),
        ..Sensor::default()
    }
}

fn sensor_step_millimetres(sensor: &Sensor) -> f64 {
    sensor.span / f64::from(1_u32 << sensor.resolution_bits.clamp(1, 24))
}

fn read(path: &Path) -> Result<Vec<Stamped>, RecordingFault> {
    let fault = |source| RecordingFault::Read {
        name: path
            .file_name()
            .unwrap_or(path.as_os_str())
            .display()
            .to_string(),
        source,
    };
    log::open(path).and_then(log::read_log).map_err(fault)
}

/// Columns of the disturbance node.
struct Disturbances {
    convection_factor: Series<f64>,
    added_load_grams: Series<f64>,
}

impl Disturbances {
    fn new(timeline: &Timeline) -> Self {
        let column = |name: &str| {
            let column = timeline.column(name);
            column.map_or_else(Series::default, |column| column.values.clone())
        };
        Self {
            convection_factor: column(names::CONVECTION_FACTOR),
            added_load_grams: column(names::ADDED_LOAD),
        }
    }

    /// Returns the inputs from a row on. Until the node is commanded, air is still and the load has no addition.
    fn at(&self, row: usize) -> Inputs {
        let value = |column: &Series<f64>| column.get(row).filter(|value| !value.is_nan());
        let default = Inputs::default();
        Inputs {
            convection_factor: value(&self.convection_factor).unwrap_or(default.convection_factor),
            added_load_kilograms: value(&self.added_load_grams)
                .map_or(default.added_load_kilograms, |grams| grams * 1e-3),
            ..default
        }
    }
}

/// Checks whether the frames are of the rig.
fn check_frames(
    frames: &[Stamped],
    one: &ControlLoop,
    timeline: &Timeline,
) -> Result<(), RecordingFault> {
    let position = one.position()?;
    let is_drive = |stamped: &Stamped| stamped.frame.raw_id() == position.raw_id();
    if !frames.iter().any(is_drive) {
        return Err(RecordingFault::NoDriveFrames {
            frames: frames.len(),
            message: names::message(&one.nodes.drive.name, names::TPDO1),
            id: position.raw_id(),
        });
    }
    let is_sync = |stamped: &Stamped| stamped.frame.standard_id() == Some(SYNC_COB_ID);
    if !frames.iter().any(is_sync) {
        let reason = "it has no SYNC (0x080)";
        return Err(RecordingFault::NeverBegan { reason });
    }
    if timeline.cycle.is_empty() {
        let reason = "the drive never reports Operation Enabled";
        return Err(RecordingFault::NeverBegan { reason });
    }
    Ok(())
}

fn check_values(timeline: &Timeline, scenario: &Trial) -> Result<(), RecordingFault> {
    check_plausible(timeline, scenario)?;
    let seconds = timeline.end_seconds();
    if seconds < DURATION_SECONDS_MIN {
        return Err(RecordingFault::TooShort { seconds });
    }
    check_gaps(timeline)?;
    check_motion(timeline, scenario)
}

fn check_plausible(timeline: &Timeline, scenario: &Trial) -> Result<(), RecordingFault> {
    let span = scenario.sensor.span;
    let current_max = scenario.amplifier.range.max;
    let quantities = [
        (
            "position",
            timeline.position().clone(),
            "mm",
            -0.05 * span,
            1.05 * span,
        ),
        (
            "current",
            flowed(timeline),
            "A",
            -0.05 * current_max,
            1.05 * current_max,
        ),
    ];
    for (quantity, values, unit, lower, upper) in quantities {
        let outside = |value: &f64| !value.is_nan() && !(lower..=upper).contains(value);
        let mut rows = timeline.time_seconds.iter().zip(&values);
        if let Some((at_seconds, value)) = rows.find(|(_, value)| outside(value)) {
            return Err(RecordingFault::Implausible {
                quantity,
                value,
                unit,
                at_seconds,
                lower,
                upper,
            });
        }
    }
    Ok(())
}

fn check_gaps(timeline: &Timeline) -> Result<(), RecordingFault> {
    let limit_seconds = GAP_SECONDS_MAX.max(GAP_CYCLES_MAX * timeline.period_seconds);
    let mut last_seconds = 0.0;
    let rows = timeline.time_seconds.iter().zip(timeline.position());
    for (time, _) in rows.filter(|(_, position)| !position.is_nan()) {
        let gap_seconds = time - last_seconds - timeline.period_seconds;
        if gap_seconds > limit_seconds {
            return Err(RecordingFault::Gap {
                at_seconds: last_seconds,
                gap_seconds,
                limit_seconds,
            });
        }
        last_seconds = time;
    }
    let percent = timeline.missed_cycles_percent();
    if percent > MISSED_PERCENT_MAX {
        return Err(RecordingFault::MissedCycles { percent });
    }
    Ok(())
}

fn check_motion(timeline: &Timeline, scenario: &Trial) -> Result<(), RecordingFault> {
    let sensor = &scenario.sensor;
    let step = sensor_step_millimetres(sensor);
    let largest = |values: &Series<f64>| values.iter().fold(f64::NEG_INFINITY, f64::max);
    let positions = timeline.position();
    let lowest = positions.iter().fold(f64::INFINITY, f64::min);
    let first = positions
        .iter()
        .find(|position| !position.is_nan())
        .unwrap_or(0.0);
    let noise = sensor.noise_rms;
    if first > START_STEPS_MAX * (step + noise) {
        return Err(RecordingFault::NotAtRest { millimetres: first });
    }
    let needed_millimetres = MOTION_STEPS_MIN * (step + noise);
    let millimetres = largest(positions) - lowest;
    if millimetres < needed_millimetres {
        return Err(RecordingFault::NoMotion {
            millimetres,
            needed_millimetres,
            current_amperes_max: largest(&flowed(timeline)),
        });
    }
    Ok(())
}
