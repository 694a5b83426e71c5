//! Data that identification takes from a recording: the inputs over time and the measured positions.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dbc::{Database, SignalMissing, names};
use plant_emulator::plant::Inputs;
use scenario::Trial;
use scenario::rig::RealDrive;
use scenario::rig::nodes::Sensor;

use plan::{ControlLoop, Plan};
use recording::frames::Frames;
use recording::log::Stamped;
use recording::run_folder::log_in;
use recording::timeline::{self, Series, Timeline};
use runner::recorded::Recorded;
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
    /// Inputs from scenario time 0 on.
    pub stretches: Vec<Stretch>,
    /// Scenario time of each position.
    pub times_seconds: Vec<f64>,
    /// Measured positions.
    pub positions_metres: Vec<f64>,
}

impl IdentificationData {
    /// Reads a run folder, or a log of `candump -L` with the scenario that was played or the `scenario.toml` in its folder. A run
    /// folder has its own scenario, whatever `scenario` is. Frames are decoded by `database`; without it by the DBC of the run
    /// folder, else by the DBC of the emulated drive. The nodes that were external are those of the verdict.
    ///
    /// # Errors
    /// The recording cannot be read, or identification cannot use it. A folder is refused also for a damaged verdict, and for
    /// damaged tables of stalls and sent frames.
    pub fn load(
        path: &Path,
        scenario: Option<&Path>,
        database: Option<&Database>,
    ) -> Result<Self, String> {
        let at = |reason: String| format!("{}: {reason}", path.display());
        let metadata = path.metadata();
        let is_folder = metadata
            .map_err(|error| at(format!("the recording cannot be read: {error}")))?
            .is_dir();
        let played = scenario.filter(|_| !is_folder);
        let recorded = Recorded::load(path, played, catalogue());
        let Recorded { mut plan, log, .. } =
            recorded.map_err(|failure| match failure.diagnostic {
                Some(error) => at(format!("the scenario is invalid: {error}")),
                None => failure.reason,
            })?;
        let unreadable = log.unread.unreadable.first().map(ToString::to_string);
        let fd_frames = (log.unread.fd_frames > 0).then(|| "it has CAN FD frames".to_owned());
        if let Some(reason) = unreadable.or(log.unread.broken).or(fd_frames) {
            let name = if is_folder { log_in(path) } else { "the log" };
            return Err(at(format!("{name} cannot be read: {reason}")));
        }
        for one in &mut plan.loops {
            if let Some(drive) = &one.real_drive {
                one.trial.sensor = real_sensor(&drive.real);
            }
        }
        if let Some(database) = database {
            plan = plan.with_database(&Arc::new(database.clone()));
        }
        Self::from_frames(path, &log.frames, &plan).map_err(at)
    }

    /// Reads the frames of a recording.
    ///
    /// # Errors
    /// Identification cannot use the recording.
    pub fn from_frames(path: &Path, frames: &Frames, plan: &Plan) -> Result<Self, String> {
        let [only] = &plan.loops[..] else {
            let count = plan.loops.len();
            return Err(format!(
                "it is of {count} loops; identification explains one wire behind one drive, so play a scenario of one loop and take its recording"
            ));
        };
        let plant = only.trial.plant();
        if plant.actuator().is_none() {
            let name = plant.name();
            return Err(format!(
                "its plant is `{name}`; identification knows the equations of the shape-memory-alloy wire only"
            ));
        }
        let timelines = timeline::decode(frames, plan).map_err(of_other_dbc)?;
        let timeline = &timelines[0];
        check_frames(frames, (plan, only), timeline)?;
        check_values(timeline, &only.trial)?;
        let mut measurement = Self {
            path: path.to_owned(),
            text: plan.shared.text.clone(),
            control_loop: only.clone(),
            tables: plan.shared.tables.clone(),
            stretches: Vec::new(),
            times_seconds: Vec::new(),
            positions_metres: Vec::new(),
        };
        let disturbances = disturbances(timeline);
        let grid = timeline.cycles_in(GRID_SECONDS);
        let flowed = flowed(timeline);
        let times = timeline.time_seconds.iter();
        let samples = times.zip(timeline.position()).skip(1);
        let cycles = timeline.cycle.pairs().zip(flowed.iter().skip(1));
        let rows = cycles.zip(samples);
        for (row, (((before, cycle), current_amperes), (time, position))) in rows.enumerate() {
            let inputs = Inputs {
                current_amperes,
                ..disturbances(row)
            };
            let cycles = (cycle - before) as f64;
            let is_sampled = cycle.is_multiple_of(grid) && !position.is_nan();
            let sample = is_sampled.then_some(measurement.positions_metres.len());
            if is_sampled {
                measurement.times_seconds.push(time);
                measurement.positions_metres.push(position * 1e-3);
            }
            measurement.extend(cycles * timeline.period_seconds, inputs, sample);
        }
        Ok(measurement)
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

    /// Returns the sensor of the recording.
    pub fn sensor(&self) -> &Sensor {
        &self.control_loop.trial.sensor
    }

    /// Returns one step of the sensor's converter.
    pub fn sensor_step_metres(&self) -> f64 {
        sensor_step_millimetres(self.sensor()) * 1e-3
    }
}

/// Returns the reason for a DBC that lacks a signal.
fn of_other_dbc(error: SignalMissing) -> String {
    format!("{error}; identification needs the rig's own DBC")
}

/// Returns the current up to each row, in amperes.
fn flowed(timeline: &Timeline) -> Series<f64> {
    let reported = timeline
        .current()
        .filter(|values| values.iter().any(|value| !value.is_nan()));
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
    let column = timeline.column(names::TARGET);
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
    let step = real.position.resolution;
    let bits = libm::ceil(libm::log2(real.limits.max / step)).clamp(1.0, 24.0);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped just above"
    )]
    let resolution_bits = bits as u32;
    Sensor {
        resolution_bits: Some(resolution_bits),
        max: Some(step * f64::from(1_u32 << resolution_bits)),
        ..Sensor::default()
    }
}

/// Returns one step of a sensor's converter.
pub(crate) fn sensor_step_millimetres(sensor: &Sensor) -> f64 {
    sensor.span() / f64::from(1_u32 << sensor.resolution_bits().clamp(1, 24))
}

/// Returns the disturbances from each row on. Until the node is commanded, air is still and the load has no addition.
fn disturbances(timeline: &Timeline) -> impl Fn(usize) -> Inputs {
    let [convection_factor, added_grams] = [names::CONVECTION_FACTOR, names::ADDED_LOAD]
        .map(|name| timeline.column(name).map(|column| column.values.clone()));
    let at = |column: &Option<Series<f64>>, row| {
        column.as_ref()?.get(row).filter(|value| !value.is_nan())
    };
    let default = Inputs::default();
    move |row| Inputs {
        convection_factor: at(&convection_factor, row).unwrap_or(default.convection_factor),
        added_load_kilograms: at(&added_grams, row)
            .map_or(default.added_load_kilograms, |grams| grams * 1e-3),
        ..default
    }
}

/// Checks whether the frames are of the rig.
fn check_frames(
    frames: &Frames,
    (plan, one): (&Plan, &ControlLoop),
    timeline: &Timeline,
) -> Result<(), String> {
    let position = one.position(plan.database()).map_err(of_other_dbc)?;
    let is_drive = |stamped: Stamped| stamped.frame.raw_id() == position.raw_id();
    if !frames.iter().any(is_drive) {
        let (count, id) = (frames.len(), position.raw_id());
        let message = names::message(&one.drive().name, names::TPDO1);
        return Err(format!(
            "none of its {count} frames is {message} (0x{id:03X}), the drive's position and current: is it the right DBC?"
        ));
    }
    if timeline.cycle.is_empty() {
        return Err(
            "scenario time never begins: it needs a SYNC (0x080) after the drive reports Operation Enabled, and one of the two is missing: was the drive enabled, and is it the right DBC?"
                .to_owned(),
        );
    }
    Ok(())
}

fn check_values(timeline: &Timeline, scenario: &Trial) -> Result<(), String> {
    check_plausible(timeline, scenario)?;
    let seconds = timeline.end_seconds();
    if seconds < DURATION_SECONDS_MIN {
        return Err(format!(
            "it is {seconds:.2} s long, identification needs {DURATION_SECONDS_MIN} s"
        ));
    }
    check_gaps(timeline)?;
    check_motion(timeline, scenario)
}

fn check_plausible(timeline: &Timeline, scenario: &Trial) -> Result<(), String> {
    let check = |quantity: &str, values: &Series<f64>, unit: &str, full: f64| {
        let (lower, upper) = (-0.05 * full, 1.05 * full);
        let outside = |value: &f64| !value.is_nan() && !(lower..=upper).contains(value);
        let mut rows = timeline.time_seconds.iter().zip(values);
        match rows.find(|(_, value)| outside(value)) {
            None => Ok(()),
            Some((at_seconds, value)) => Err(format!(
                "the {quantity} is {value} {unit} at {at_seconds:.3} s, outside {lower} to {upper} {unit}: is it the right DBC?"
            )),
        }
    };
    let current_max = scenario.amplifier.range().max;
    check(
        "position",
        timeline.position(),
        "mm",
        scenario.sensor.span(),
    )?;
    check("current", &flowed(timeline), "A", current_max)
}

fn check_gaps(timeline: &Timeline) -> Result<(), String> {
    let limit_seconds = GAP_SECONDS_MAX.max(GAP_CYCLES_MAX * timeline.period_seconds);
    let mut last_seconds = 0.0;
    let rows = timeline.time_seconds.iter().zip(timeline.position());
    for (time, _) in rows.filter(|(_, position)| !position.is_nan()) {
        let gap_seconds = time - last_seconds - timeline.period_seconds;
        if gap_seconds > limit_seconds {
            return Err(format!(
                "it has a gap of {gap_seconds:.3} s at {last_seconds:.3} s (limit {limit_seconds:.3} s): the current in it is unknown"
            ));
        }
        last_seconds = time;
    }
    let percent = timeline.missed_cycles_percent();
    if percent > MISSED_PERCENT_MAX {
        return Err(format!(
            "{percent:.1} % of its cycles have no position (limit {MISSED_PERCENT_MAX} %)"
        ));
    }
    Ok(())
}

fn check_motion(timeline: &Timeline, scenario: &Trial) -> Result<(), String> {
    let sensor = &scenario.sensor;
    let step = sensor_step_millimetres(sensor);
    let largest = |values: &Series<f64>| values.iter().fold(f64::NEG_INFINITY, f64::max);
    let positions = timeline.position();
    let lowest = positions.iter().fold(f64::INFINITY, f64::min);
    let mut known = positions.iter().filter(|position| !position.is_nan());
    let first = known.next().unwrap_or(0.0);
    let noise = sensor.noise_rms();
    if first > START_STEPS_MAX * (step + noise) {
        return Err(format!(
            "the load is at {first:.2} mm when it begins; only a cold start on the stop has a known temperature"
        ));
    }
    let needed_millimetres = MOTION_STEPS_MIN * (step + noise);
    let millimetres = largest(positions) - lowest;
    if millimetres < needed_millimetres {
        let amperes = largest(&flowed(timeline));
        return Err(format!(
            "the load moves by {millimetres:.2} mm at most (identification needs {needed_millimetres:.2} mm), with currents up to \
             {amperes:.3} A: without motion the position shows nothing of the parameters"
        ));
    }
    Ok(())
}
