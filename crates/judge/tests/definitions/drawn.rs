//! Runs drawn at random: the plan of the scenario, and the frames of its nodes, with stretches in which they sent none.

use std::fmt::Write;
use std::time::Duration;

use can::CanFrame;
use dbc::Database;
use proptest::prelude::*;
use recording::log::Stamped;

pub(crate) const PERIOD_SECONDS: f64 = 0.01;

/// Returns the time at which a cycle begins, rounded once as in the decimal of a file.
pub(crate) fn begin_seconds(number: u32) -> f64 {
    f64::from(number) / 100.0
}
/// Number of cycles in which all planned pieces of a scenario begin.
const PLANNED_CYCLES: u32 = 200;
/// Number of cycles of a run that continues beyond them and has a hold.
const CYCLES_WITH_HOLD: u32 = 450;
/// Longest stretch without frames that is no silence: 20 SYNC periods, and 20 cycle times of `drive_truth`.
pub(crate) const SILENCE_SECONDS: f64 = 0.2;
/// Begin of the scenario, in the log.
pub(crate) const ZERO_MICROS: u64 = 10_000;
/// Time from a SYNC to the message with the temperature.
pub(crate) const TEMPERATURE_MICROS: u64 = 260;

const ENABLED: u8 = 39;
const FAULT: u8 = 8;

#[derive(Clone, Debug)]
pub(crate) enum Piece {
    Hold(f64),
    Step(f64),
    Sine {
        centre: f64,
        amplitude: f64,
        period_seconds: f64,
    },
}

/// Values that the drive sends in a cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sent {
    pub(crate) position: f64,
    pub(crate) true_position: f64,
    pub(crate) current: f64,
    pub(crate) temperature: f64,
    pub(crate) is_enabled: bool,
}

/// Cycle whose SYNC was sent.
#[derive(Clone, Debug)]
pub(crate) struct Cycle {
    pub(crate) number: u32,
    /// Time of the SYNC, from the start of the scenario on.
    pub(crate) micros: u64,
    pub(crate) sent: Option<Sent>,
    /// Current that the controller asks for.
    pub(crate) command: Option<f64>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Truth {
    pub(crate) time_seconds: f64,
    pub(crate) current: f64,
    pub(crate) peak_temperature: f64,
}

#[derive(Clone, Debug)]
pub(crate) struct Drawn {
    pub(crate) cycles_due: u32,
    /// Pieces with their starts; the first one starts at 0.
    pub(crate) pieces: Vec<(f64, Piece)>,
    pub(crate) loads: Vec<f64>,
    /// Begin and end of the sensor's standstill.
    pub(crate) stuck: Option<(f64, f64)>,
    pub(crate) judged_until: Option<f64>,
    pub(crate) gain_limit: Option<(f64, f64)>,
    pub(crate) cycles: Vec<Cycle>,
    pub(crate) truth: Vec<Truth>,
    /// Scenario times of the drive's emergencies 0x8130.
    pub(crate) emergencies: Vec<f64>,
}

impl Drawn {
    pub(crate) fn duration(&self) -> f64 {
        f64::from(self.cycles_due) / 100.0
    }

    pub(crate) fn judged_end(&self) -> f64 {
        self.judged_until.unwrap_or(self.duration())
    }

    /// Returns the scenario file.
    pub(crate) fn text(&self) -> String {
        let mut text = format!(
            "schema = 1\nrig = \"sma_actuator\"\nname = \"drawn\"\nduration_seconds = {:?}\n\
             [bus]\nsync_period_milliseconds = 10.0\n[controller.pid]\n",
            self.duration()
        );
        for (start, piece) in &self.pieces {
            let piece = match piece {
                Piece::Hold(to) => {
                    format!(
                        "[[reference.hold]]\nat_seconds = {start:?}\nposition_millimetres = {to:?}"
                    )
                }
                Piece::Step(to) => {
                    format!(
                        "[[reference.step]]\nat_seconds = {start:?}\nposition_millimetres = {to:?}"
                    )
                }
                Piece::Sine {
                    centre,
                    amplitude,
                    period_seconds,
                } => format!(
                    "[[reference.sine]]\nfrom_seconds = {start:?}\ncentre_millimetres = {centre:?}\n\
                     amplitude_millimetres = {amplitude:?}\nperiod_seconds = {period_seconds:?}"
                ),
            };
            writeln!(text, "{piece}").unwrap();
        }
        for at in &self.loads {
            writeln!(
                text,
                "[[disturbance.load]]\nat_seconds = {at:?}\nadded_grams = 10.0"
            )
            .unwrap();
        }
        if let Some((from, until)) = self.stuck {
            let keys = format!("from_seconds = {from:?}\nuntil_seconds = {until:?}");
            writeln!(text, "[[fault.sensor.stuck]]\n{keys}").unwrap();
        }
        text + &self.expectations()
    }

    fn expectations(&self) -> String {
        let mut text =
            "[expect]\nno_event = [\"emergency\"]\ntemperature_celsius = { max = 60.0 }\nhunting_millimetres = { max = 0.25 }\n\
             missed_commands_percent = { max = 5.0 }\nlate_commands_percent = { max = 5.0 }\n\
             sync_period_error_percent = { max = 2.0 }\n\
             current_ripple_amperes_rms = { max = 0.25 }\n"
                .to_owned();
        if let Some(until) = self.judged_until {
            writeln!(text, "judged_until_seconds = {until:?}").unwrap();
        }
        if self.stuck.is_some() {
            text += "emcy = [\"drive 0x8130\"]\nsafe_state = true\n";
        }
        let has_judged_sine = !crate::plain::judged_sines(self).is_empty();
        if let Some((min, max)) = self.gain_limit.filter(|_| has_judged_sine) {
            writeln!(text, "sine_gain = {{ min = {min:?}, max = {max:?} }}").unwrap();
        }
        text + "[[expect.signal]]\nname = \"position_millimetres\"\nfrom_seconds = 0.5\nuntil_seconds = 1.5\n\
                stays = { min = 5.0, max = 30.0 }\nreaches = { min = 20.0, max = 30.0 }\n\
                rate_per_second = { min = -100.0, max = 100.0 }\n\
                [[expect.sequence]]\nname = \"there\"\nevent = [\n\
                { signal = \"position_millimetres\", reaches = { min = 5.0, max = 30.0 }, for_milliseconds = 300.0 },\n]\n"
    }

    /// Returns the frames with their times in the log, in the order of time.
    pub(crate) fn frames(&self) -> Vec<(u64, CanFrame)> {
        let database = Database::shipped();
        let message = |name: &str, values: &[(&str, f64)]| {
            let mut message = database.builder(name).unwrap();
            for (signal, value) in values {
                let signal = database.signal(&format!("{name}.{signal}")).unwrap();
                message.set(&signal, *value);
            }
            message.frame()
        };
        let feedback = |sent: &Sent| {
            let state = if sent.is_enabled { ENABLED } else { FAULT };
            message(
                "drive_tpdo1",
                &[
                    ("statusword_state", f64::from(state)),
                    ("position_millimetres", sent.position),
                    ("current_amperes", sent.current),
                ],
            )
        };
        let first = Sent {
            position: 0.0,
            true_position: 0.0,
            current: 0.0,
            temperature: 15.0,
            is_enabled: true,
        };
        let mut frames = vec![
            (0, feedback(&first)),
            (0, CanFrame::new(0x711, &[0])),
            (0, CanFrame::new(0x211, &[0; 8])),
        ];
        for cycle in &self.cycles {
            let micros = ZERO_MICROS + cycle.micros;
            frames.push((micros, CanFrame::new(0x080, &[])));
            if let Some(sent) = &cycle.sent {
                frames.push((micros + 130, feedback(sent)));
                let signals = [
                    ("wire_temperature_celsius", sent.temperature),
                    ("true_position_millimetres", sent.true_position),
                ];
                frames.push((
                    micros + TEMPERATURE_MICROS,
                    message("drive_tpdo2", &signals),
                ));
            }
            if let Some(current) = cycle.command {
                let command = [("target_current_amperes", current)];
                frames.push((micros + 390, message("drive_rpdo1", &command)));
            }
        }
        let micros = |seconds: f64| {
            let since_zero = Duration::from_secs_f64(seconds).as_micros();
            let micros = ZERO_MICROS + u64::try_from(since_zero).unwrap();
            micros.next_multiple_of(100)
        };
        for truth in &self.truth {
            let micros = micros(truth.time_seconds);
            let values = [
                ("plant_current_amperes", truth.current),
                ("plant_peak_temperature_celsius", truth.peak_temperature),
                ("plant_time_seconds", micros as f64 / 1e6),
            ];
            frames.push((micros, message("drive_truth", &values)));
        }
        let emergency = CanFrame::new(0x090, &[0x30, 0x81, 0x11, 0, 0, 0, 0, 0]);
        frames.extend(self.emergencies.iter().map(|at| (micros(*at), emergency)));
        // The recording continues beyond the end with any frame.
        frames.push((micros(self.duration() + 0.01), CanFrame::new(0x701, &[5])));
        frames.sort_by_key(|(micros, _)| *micros);
        frames
    }

    pub(crate) fn stamped(&self) -> Vec<Stamped> {
        let frames = self.frames().into_iter();
        frames
            .map(|(micros, frame)| Stamped::new(Duration::from_micros(micros), frame))
            .collect()
    }
}

/// Returns the scenario time of a frame.
pub(crate) fn scenario_seconds(micros: u64) -> f64 {
    (micros as f64 - ZERO_MICROS as f64) / 1e6
}

/// Distances from the set-point, none of them at the edge of a band.
const ERRORS: [f64; 8] = [0.0, 0.003, 0.013, 0.217, 0.313, 0.717, 3.113, 15.017];

fn piece() -> impl Strategy<Value = Piece> {
    let position = || (1..50_u8).prop_map(f64::from);
    prop_oneof![
        1 => position().prop_map(Piece::Hold),
        3 => position().prop_map(Piece::Step),
        1 => (15..35_u8, 1..10_u8, 5..20_u8).prop_map(|(centre, amplitude, period)| Piece::Sine {
            centre: f64::from(centre),
            amplitude: f64::from(amplitude),
            period_seconds: f64::from(period) / 100.0,
        }),
    ]
}

/// Draws times in milliseconds, on cycles and between them, each once.
fn times(count: std::ops::Range<usize>) -> impl Strategy<Value = Vec<f64>> {
    let times =
        prop::collection::btree_set((1..PLANNED_CYCLES, prop_oneof![Just(0), Just(3)]), count);
    times.prop_map(|times| {
        let times = times.into_iter();
        times
            .map(|(cycle, more)| f64::from(10 * cycle + more) / 1e3)
            .collect()
    })
}

fn pieces() -> impl Strategy<Value = Vec<(f64, Piece)>> {
    let later = times(0..4).prop_flat_map(|times| {
        let pieces = prop::collection::vec(piece(), times.len());
        (Just(times), pieces)
    });
    (piece(), later).prop_map(|(first, (times, pieces))| {
        let mut all = vec![(0.0, first)];
        all.extend(times.into_iter().zip(pieces));
        all
    })
}

/// Draws the presence of each of `count` things: most are there, except for single ones and for stretches.
fn came(count: u32) -> impl Strategy<Value = Vec<bool>> {
    let alone = prop::collection::vec(0..count, 0..6);
    let gap = || (0..count, prop_oneof![1..15_u32, 15..30_u32, 30..80_u32]);
    let gaps = prop_oneof![
        2 => Just(Vec::new()),
        2 => prop::collection::vec(gap(), 1..3),
    ];
    let stop = prop_oneof![
        4 => Just(count),
        1 => 1..count,
    ];
    (alone, gaps, stop).prop_map(move |(alone, gaps, stop)| {
        let is_in =
            |number: u32, (from, length): &(u32, u32)| number >= *from && number - from < *length;
        let came = |number| {
            number < stop && !alone.contains(&number) && !gaps.iter().any(|gap| is_in(number, gap))
        };
        (0..count).map(came).collect()
    })
}

/// Draws one value for each of `count` things, with segments of equal values.
fn segments<T: Clone + std::fmt::Debug>(
    value: impl Strategy<Value = T>,
    count: u32,
) -> impl Strategy<Value = Vec<T>> {
    let segment = (value, 1..60_usize);
    prop::collection::vec(segment, 1..12).prop_map(move |segments| {
        let values = segments
            .into_iter()
            .cycle()
            .flat_map(|(value, length)| std::iter::repeat_n(value, length));
        values.take(count as usize).collect()
    })
}

/// Returns the measured position for a set-point and an error: whole micrometres, as the bus carries them.
fn measured(set_point: f64, error: f64) -> f64 {
    ((set_point + error) * 1e3).round() / 1e3
}

fn error() -> impl Strategy<Value = f64> {
    (0..ERRORS.len(), any::<bool>()).prop_map(|(place, is_below)| {
        if is_below {
            -ERRORS[place]
        } else {
            ERRORS[place]
        }
    })
}

/// Course of a run, before it is combined with the pieces of a scenario.
#[derive(Clone, Debug)]
struct Course {
    syncs: Vec<bool>,
    late_micros: Vec<u64>,
    positions: Vec<bool>,
    errors: Vec<f64>,
    true_errors: Vec<f64>,
    currents: Vec<f64>,
    temperatures: Vec<f64>,
    enabled: Vec<bool>,
    commands: Vec<Option<f64>>,
}

fn course(count: u32) -> impl Strategy<Value = Course> {
    let current = (0..1000_u16).prop_map(|milliamperes| f64::from(milliamperes) / 1e3);
    let temperature = (15..70_u8).prop_map(f64::from);
    let late = prop_oneof![5 => Just(0), 1 => 0..4000_u64];
    let sent = (
        came(count),
        segments(error(), count),
        segments(error(), count),
        segments(current.clone(), count),
        segments(temperature, count),
        segments(any::<bool>(), count),
    );
    (
        came(count),
        prop::collection::vec(late, count as usize),
        sent,
        commands(current, count),
    )
        .prop_map(|(syncs, late_micros, sent, commands)| {
            let (positions, errors, true_errors, currents, temperatures, enabled) = sent;
            Course {
                syncs,
                late_micros,
                positions,
                errors,
                true_errors,
                currents,
                temperatures,
                enabled,
                commands,
            }
        })
}

/// Draws commands for most cycles, or none at all.
fn commands(
    current: impl Strategy<Value = f64>,
    count: u32,
) -> impl Strategy<Value = Vec<Option<f64>>> {
    let came = prop_oneof![
        9 => came(count),
        1 => Just(vec![false; count as usize]),
    ];
    (came, segments(current, count)).prop_map(|(came, currents)| {
        let commands = came.into_iter().zip(currents);
        commands
            .map(|(came, current)| came.then_some(current))
            .collect()
    })
}

impl Course {
    /// Brings the position near the set-point from one cycle on, and all frames onto the bus up to another.
    fn calm(&mut self, (from, until): (usize, usize)) {
        for (place, error) in self.errors.iter_mut().enumerate().skip(from) {
            *error = ERRORS[place % 4];
        }
        self.syncs[from..until].fill(true);
        self.positions[from..until].fill(true);
    }
}

/// Returns every cycle whose SYNC came; that of the first cycle always does.
fn cycles(course: &Course, pieces: &[(f64, Piece)], cycles_due: u32) -> Vec<Cycle> {
    let mut cycles = Vec::new();
    for number in 0..cycles_due {
        let place = number as usize;
        if number > 0 && !course.syncs[place] {
            continue;
        }
        let late = if number == 0 {
            0
        } else {
            course.late_micros[place]
        };
        let set_point = crate::plain::set_point(pieces, begin_seconds(number));
        let sent = course.positions[place].then(|| Sent {
            position: measured(set_point, course.errors[place]),
            true_position: measured(set_point, course.true_errors[place]),
            current: course.currents[place],
            temperature: course.temperatures[place],
            is_enabled: course.enabled[place],
        });
        cycles.push(Cycle {
            number,
            micros: u64::from(number) * 10_000 + late,
            sent,
            command: course.commands[place],
        });
    }
    cycles
}

fn truth(count: u32) -> impl Strategy<Value = Vec<Truth>> {
    let current = prop_oneof![Just(0.0), Just(0.0), Just(0.5)];
    let peak = (15..70_u8).prop_map(f64::from);
    (came(count), segments(current, count), segments(peak, count)).prop_map(
        move |(came, currents, peaks)| {
            let sent = (0..count).filter(|number| came[*number as usize]);
            let truth = sent.map(|number| Truth {
                time_seconds: f64::from(10 * number + 5) / 1e3,
                current: currents[number as usize],
                peak_temperature: peaks[number as usize],
            });
            truth.collect()
        },
    )
}

/// Draws a run.
pub(crate) fn drawn() -> impl Strategy<Value = Drawn> {
    prop_oneof![
        3 => run(PLANNED_CYCLES, Just(None)),
        1 => {
            let calm = (100..250_usize, 330..=CYCLES_WITH_HOLD as usize);
            run(CYCLES_WITH_HOLD, prop::option::weighted(0.8, calm))
        },
    ]
}

fn run(
    cycles_due: u32,
    calm: impl Strategy<Value = Option<(usize, usize)>>,
) -> impl Strategy<Value = Drawn> {
    let duration = f64::from(cycles_due) / 100.0;
    let stuck = prop::option::of((0.1..1.0_f64, 0.1..1.2_f64)).prop_map(move |stuck| {
        let rounded = |seconds: f64| (seconds * 1e3).round() / 1e3;
        stuck.map(|(from, length)| (rounded(from), rounded(from + length).min(duration)))
    });
    let judged_until = prop::option::weighted(
        0.3,
        (50..=cycles_due).prop_map(|cycles| f64::from(cycles) / 100.0),
    );
    let gain_limit = prop::option::of((0.0..1.0_f64, 1.0..2.0_f64));
    let emergencies =
        prop::collection::vec((1..2300_u16).prop_map(|time| f64::from(time) / 1e3), 0..2);
    let course = (course(cycles_due), calm).prop_map(|(mut course, calm)| {
        if let Some(calm) = calm {
            course.calm(calm);
        }
        course
    });
    (
        pieces(),
        times(0..3),
        stuck,
        judged_until,
        gain_limit,
        course,
        truth(cycles_due),
        emergencies,
    )
        .prop_map(
            move |(pieces, loads, stuck, judged_until, gain_limit, course, truth, emergencies)| {
                Drawn {
                    cycles_due,
                    cycles: cycles(&course, &pieces, cycles_due),
                    truth: if stuck.is_some() { truth } else { Vec::new() },
                    pieces,
                    loads,
                    stuck,
                    judged_until,
                    gain_limit,
                    emergencies,
                }
            },
        )
}
