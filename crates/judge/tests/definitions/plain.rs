//! Computes each metric again, slowly and from the definitions in docs/reference/metrics.md, without any code of the judge.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use can::CanFrame;

use crate::drawn::{
    Drawn, PERIOD_SECONDS, Piece, SILENCE_SECONDS, TEMPERATURE_MICROS, ZERO_MICROS, begin_seconds,
    scenario_seconds,
};

/// Value of each row; `None` if the row has no value.
pub(crate) type Rows = BTreeMap<String, Option<f64>>;

const TOLERANCE: f64 = 1e-9;

/// Sample of a cycle.
#[derive(Clone, Copy)]
struct Sample {
    time: f64,
    set_point: f64,
    position: f64,
}

impl Sample {
    fn deviation(&self) -> f64 {
        (self.set_point - self.position).abs()
    }
}

type Span = (f64, f64);

/// Run to judge, with the measured position or the true one.
struct Plain<'a> {
    drawn: &'a Drawn,
    samples: Vec<Sample>,
    end: f64,
}

pub(crate) fn rows(drawn: &Drawn) -> Rows {
    let plain = |is_true: bool| Plain {
        drawn,
        samples: samples(drawn, is_true),
        end: drawn.judged_end(),
    };
    let measured = plain(false);
    let mut rows = Rows::new();
    measured.position_rows("", &mut rows);
    if drawn.stuck.is_some() && !measured.samples.is_empty() {
        plain(true).position_rows("true_", &mut rows);
    }
    measured.other_rows(&mut rows);
    measured.reaction_rows(&mut rows);
    measured.check_rows(&mut rows);
    rows
}

fn samples(drawn: &Drawn, is_true: bool) -> Vec<Sample> {
    let cycles = drawn.cycles.iter();
    let samples = cycles.filter_map(|cycle| {
        let sent = cycle.sent?;
        let time = begin_seconds(cycle.number);
        Some(Sample {
            time,
            set_point: set_point(&drawn.pieces, time),
            position: if is_true {
                sent.true_position
            } else {
                sent.position
            },
        })
    });
    samples.collect()
}

/// Returns the set-point at a time, which is 0 before the first piece.
pub(crate) fn set_point(pieces: &[(f64, Piece)], time: f64) -> f64 {
    let current = pieces
        .iter()
        .rev()
        .find(|(start, _)| *start <= time + TOLERANCE);
    current.map_or(0.0, |(start, piece)| match piece {
        Piece::Hold(to) | Piece::Step(to) => *to,
        Piece::Sine {
            centre,
            amplitude,
            period_seconds,
        } => centre + amplitude * libm::sin(TAU * (time - start) / period_seconds),
    })
}

/// Returns the window of the last three whole periods of each sine with at least four, and the period.
pub(crate) fn judged_sines(drawn: &Drawn) -> Vec<(Span, f64)> {
    let mut judged = Vec::new();
    for (place, (start, piece)) in drawn.pieces.iter().enumerate() {
        let Piece::Sine { period_seconds, .. } = piece else {
            continue;
        };
        let next = drawn
            .pieces
            .get(place + 1)
            .map_or(f64::INFINITY, |(start, _)| *start);
        let length = next.min(drawn.judged_end()) - start;
        let mut periods = 0.0;
        while (periods + 1.0) * period_seconds <= length + TOLERANCE {
            periods += 1.0;
        }
        if periods >= 4.0 {
            let until = start + periods * period_seconds;
            judged.push(((until - 3.0 * period_seconds, until), *period_seconds));
        }
    }
    judged
}

/// Returns whether times leave a silence in a span; its ends count as times.
fn has_silence(times: impl Iterator<Item = f64>, (from, until): Span) -> bool {
    let mut all = vec![from];
    all.extend(times);
    all.push(until);
    all.windows(2)
        .any(|pair| pair[1] - pair[0] > SILENCE_SECONDS + TOLERANCE)
}

fn is_in(time: f64, (from, until): Span) -> bool {
    time >= from - TOLERANCE && time < until - TOLERANCE
}

/// Returns the largest value; `None` if one is missing.
fn worst(values: Vec<Option<f64>>) -> Option<f64> {
    let values: Option<Vec<f64>> = values.into_iter().collect();
    values?.into_iter().reduce(f64::max)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

impl Plain<'_> {
    fn within(&self, span: Span) -> Vec<Sample> {
        let samples = self.samples.iter().copied();
        samples.filter(|sample| is_in(sample.time, span)).collect()
    }

    /// Returns the samples of a span without a silence; `None` if the span has one, or no sample.
    fn seen(&self, span: Span) -> Option<Vec<Sample>> {
        let samples = self.within(span);
        let times = samples.iter().map(|sample| sample.time);
        let is_seen = !samples.is_empty() && !has_silence(times, span);
        is_seen.then_some(samples)
    }

    fn whole(&self) -> Span {
        (0.0, self.end)
    }

    fn position_rows(&self, before: &str, rows: &mut Rows) {
        let mut add = |name: &str, value: Option<f64>| {
            rows.insert(format!("{before}{name}"), value);
        };
        let steps = self.steps();
        if !steps.is_empty() {
            let worst_step = |metric: fn(&Self, &Step) -> Option<f64>| {
                worst(steps.iter().map(|step| metric(self, step)).collect())
            };
            add("settling_time_seconds", worst_step(Self::settling_time));
            add("overshoot_percent", worst_step(Self::overshoot));
        }
        let last = ((self.end - 0.5).max(0.0), self.end);
        let set_points: Vec<f64> = self.within(last).iter().map(|one| one.set_point).collect();
        if set_points
            .windows(2)
            .all(|pair| (pair[0] - pair[1]).abs() < TOLERANCE)
        {
            let error = self.seen(last).map(|samples| deviation_mean(&samples));
            add("steady_state_error_millimetres", error);
        }
        let sines = judged_sines(self.drawn);
        let spans: Vec<Span> = match sines.as_slice() {
            [] => vec![self.whole()],
            sines => sines.iter().map(|(span, _)| *span).collect(),
        };
        let errors = spans
            .into_iter()
            .map(|span| self.seen(span).map(|samples| deviation_rms(&samples)));
        add("tracking_error_millimetres_rms", worst(errors.collect()));
        for (name, value) in self.sines(&sines) {
            add(name, value);
        }
        let loads = self.drawn.loads.iter().filter(|at| **at < self.end);
        let next_edge = |at: f64| {
            let later = self
                .edges()
                .into_iter()
                .filter(|edge| *edge > at + TOLERANCE);
            later.fold(f64::INFINITY, f64::min)
        };
        let until = |at: f64| (at + 3.0).max(next_edge(at)).min(self.end);
        let spans: Vec<Span> = loads.map(|at| (*at, until(*at))).collect();
        if !spans.is_empty() {
            let deviations = spans.iter().map(|span| self.deviation_max(*span));
            add("maximum_deviation_millimetres", worst(deviations.collect()));
            let recoveries = spans.iter().map(|span| self.recovery(*span));
            add("recovery_time_seconds", worst(recoveries.collect()));
        }
        let highest = self.seen(self.whole()).map(|samples| {
            let positions = samples.iter().map(|sample| sample.position);
            positions.fold(f64::NEG_INFINITY, f64::max)
        });
        add("position_millimetres_max", highest);
        add("hunting_millimetres", self.hunting());
        if let Some((_, until)) = self.drawn.stuck {
            let end = self.drawn.duration();
            let recovery = if until < end {
                self.recovery((until, end))
            } else {
                None
            };
            add("recovers_within_seconds", recovery);
        }
    }

    /// Returns the times at which the set-point changes, or a disturbance or a fault starts or ends.
    fn edges(&self) -> Vec<f64> {
        let samples = self.within(self.whole());
        let changes = samples.windows(2);
        let changes =
            changes.filter(|pair| (pair[0].set_point - pair[1].set_point).abs() >= TOLERANCE);
        let changes = changes.map(|pair| pair[1].time);
        let (from, until) = self.drawn.stuck.unzip();
        let edges = changes.chain(self.drawn.loads.iter().copied());
        edges.chain(from).chain(until).collect()
    }

    /// Returns the highest less the lowest mean of 10 ms in the last second; `None` if something changes in it.
    fn hunting(&self) -> Option<f64> {
        let last = (self.end - 1.0, self.end);
        let is_inside = |edge: f64| edge > last.0 + TOLERANCE && edge < last.1;
        if last.0 < -TOLERANCE || self.edges().into_iter().any(is_inside) {
            return None;
        }
        let samples = self.seen(last)?;
        let parts = (0..100).map(|part| {
            let from = last.0 + f64::from(part) * 0.01;
            let part_samples = samples
                .iter()
                .filter(|sample| is_in(sample.time, (from, from + 0.01)));
            part_samples
                .map(|sample| sample.position)
                .collect::<Vec<_>>()
        });
        let means: Vec<f64> = parts
            .filter(|part_samples| !part_samples.is_empty())
            .map(|part_samples| mean(&part_samples))
            .collect();
        let highest = means.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        Some(highest - means.into_iter().fold(f64::INFINITY, f64::min))
    }

    /// Returns the standard deviation of the command from 1 s after the last recovery on. A command holds until the next.
    fn ripple(&self) -> Option<f64> {
        let edges = self.edges().into_iter().filter(|edge| *edge < self.end);
        let calm = (edges.fold(0.0, f64::max), self.end);
        let hold = (calm.0 + self.recovery(calm)? + 1.0, self.end);
        if hold.1 - hold.0 < 2.0 - TOLERANCE {
            return None;
        }
        self.seen(hold)?;
        if self.has_no_commands(hold) {
            return None;
        }
        let mut latest = None;
        let mut commands = Vec::new();
        for cycle in &self.drawn.cycles {
            latest = cycle.command.or(latest);
            if is_in(begin_seconds(cycle.number), hold) {
                commands.extend(latest);
            }
        }
        let middle = mean(&commands);
        let squares: Vec<f64> = commands.iter().map(|one| (one - middle).powi(2)).collect();
        (!commands.is_empty()).then(|| mean(&squares).sqrt())
    }

    fn steps(&self) -> Vec<Step> {
        let starts = self.drawn.pieces.iter().map(|(start, _)| *start);
        let events: Vec<f64> = starts.chain(self.drawn.loads.iter().copied()).collect();
        let mut steps = Vec::new();
        for (place, (start, piece)) in self.drawn.pieces.iter().enumerate() {
            let Piece::Step(to) = piece else { continue };
            if *start >= self.end {
                continue;
            }
            let later = events.iter().copied().filter(|event| event > start);
            let next = later.fold(self.end, f64::min);
            let before = match (place, self.drawn.pieces[..place].last()) {
                (0, _) | (_, None) => 0.0,
                (_, Some((from, piece))) => match piece {
                    Piece::Hold(to) | Piece::Step(to) => *to,
                    Piece::Sine { .. } => set_point(&[(*from, piece.clone())], *start),
                },
            };
            steps.push(Step {
                span: (*start, next),
                from: before,
                to: *to,
            });
        }
        steps
    }

    /// Returns the time to the first sample from which on every sample is within the band and no silence follows up to the
    /// window's end. It must come at least 0.1 s before that end.
    fn settling_time(&self, step: &Step) -> Option<f64> {
        let band = 0.05 * (step.to - step.from).abs();
        let samples = self.within(step.span);
        let stays = |first: usize| {
            let rest = &samples[first..];
            let is_inside = rest
                .iter()
                .all(|one| (one.position - step.to).abs() <= band);
            let times = rest.iter().map(|sample| sample.time);
            is_inside && !has_silence(times, (rest[0].time, step.span.1))
        };
        let first = (0..samples.len()).find(|first| stays(*first))?;
        let time = samples[first].time;
        (step.span.1 - time >= 0.1 - TOLERANCE).then_some(time - step.span.0)
    }

    fn overshoot(&self, step: &Step) -> Option<f64> {
        let samples = self.seen(step.span)?;
        let height = step.to - step.from;
        let beyond = samples
            .iter()
            .map(|one| 100.0 * (one.position - step.to) / height);
        // Rounding gives a height to two equal set-points.
        (height.abs() > 1e-6).then(|| beyond.fold(0.0, f64::max))
    }

    fn sines(&self, sines: &[(Span, f64)]) -> Vec<(&'static str, Option<f64>)> {
        if sines.is_empty() {
            return Vec::new();
        }
        let fits: Option<Vec<[f64; 3]>> = sines.iter().map(|sine| self.sine(*sine)).collect();
        let of = |place: usize, goodness: &dyn Fn(f64) -> f64| {
            let values = fits.as_ref()?.iter().map(|fit| fit[place]);
            values.reduce(|worst, value| {
                if goodness(value) < goodness(worst) {
                    value
                } else {
                    worst
                }
            })
        };
        let gain_goodness = |gain: f64| match self.drawn.gain_limit {
            Some((min, max)) => (gain - min).min(max - gain),
            None => -(gain - 1.0).abs(),
        };
        let nearness = |value: f64| -value.abs();
        vec![
            ("sine_gain", of(0, &gain_goodness)),
            ("sine_phase_degrees", of(1, &nearness)),
            ("sine_offset_millimetres", of(2, &nearness)),
        ]
    }

    /// Returns gain, phase and offset.
    fn sine(&self, (span, period): (Span, f64)) -> Option<[f64; 3]> {
        let samples = self.seen(span)?;
        let wanted = fit(&samples, period, |sample| sample.set_point)?;
        let measured = fit(&samples, period, |sample| sample.position)?;
        let amplitude = |[_, a, b]: [f64; 3]| a.hypot(b);
        let mut degrees =
            (measured[2].atan2(measured[1]) - wanted[2].atan2(wanted[1])).to_degrees();
        while degrees >= 90.0 {
            degrees -= 360.0;
        }
        while degrees < -270.0 {
            degrees += 360.0;
        }
        let gain = amplitude(measured) / amplitude(wanted);
        Some([gain, degrees, measured[0] - wanted[0]])
    }

    fn deviation_max(&self, span: Span) -> Option<f64> {
        let samples = self.seen(span)?;
        samples.iter().map(Sample::deviation).reduce(f64::max)
    }

    /// Returns the end of the last cycle outside 0.25 mm, or the first sample after the last silence, whichever is later.
    fn recovery(&self, span: Span) -> Option<f64> {
        let samples = self.within(span);
        let last = samples.last()?;
        if last.deviation() > 0.25 || has_silence([].into_iter(), (last.time, span.1)) {
            return None;
        }
        let outside = samples
            .iter()
            .filter(|sample| sample.deviation() > 0.25)
            .map(|sample| sample.time + PERIOD_SECONDS);
        let before = [span.0]
            .into_iter()
            .chain(samples.iter().map(|one| one.time));
        let silences = before
            .zip(&samples)
            .filter(|(before, sample)| has_silence([].into_iter(), (*before, sample.time)));
        let back = silences.map(|(_, sample)| sample.time);
        let recovered = outside.chain(back).fold(span.0, f64::max);
        (recovered + 0.5 * PERIOD_SECONDS < span.1).then_some(recovered - span.0)
    }

    fn other_rows(&self, rows: &mut Rows) {
        let currents: Vec<f64> = self
            .drawn
            .cycles
            .iter()
            .filter(|cycle| is_in(begin_seconds(cycle.number), self.whole()))
            .filter_map(|cycle| Some(cycle.sent?.current.powi(2)))
            .collect();
        let rms = self.seen(self.whole()).map(|_| mean(&currents).sqrt());
        rows.insert("current_amperes_rms".to_owned(), rms);
        rows.insert("current_ripple_amperes_rms".to_owned(), self.ripple());
        let due = self.drawn.cycles.last().map_or(0, |cycle| cycle.number + 1);
        let due_seconds = begin_seconds(due);
        let has_sync = self.end - due_seconds <= SILENCE_SECONDS + TOLERANCE;
        let due = (0..self.drawn.cycles_due)
            .filter(|number| is_in(begin_seconds(*number), self.whole()))
            .count();
        let served = self.within(self.whole()).len();
        let missed = 100.0 * (due - served) as f64 / due as f64;
        rows.insert("missed_cycles_percent".to_owned(), Some(missed));
        let (lacking, late) = (self.lacking_commands(), self.late_commands());
        for (name, cycles) in [("missed", lacking), ("late", late)] {
            let share = self.share_of_commands(&cycles);
            rows.insert(format!("{name}_commands_percent"), share);
        }
        let error = self.sync_period_error();
        rows.insert("sync_period_error_percent".to_owned(), error);
        let before_end = |micros: &u64| *micros as f64 / 1e6 < self.end;
        let syncs: Vec<u64> = self
            .drawn
            .cycles
            .iter()
            .map(|cycle| cycle.micros)
            .filter(before_end)
            .collect();
        let longest = syncs
            .windows(2)
            .map(|pair| (pair[1] - pair[0]) as f64 / 1e3)
            .reduce(f64::max);
        rows.insert(
            "sync_interval_milliseconds_max".to_owned(),
            longest.filter(|_| has_sync),
        );
        rows.insert("bus_load_percent".to_owned(), self.bus_load());
    }

    /// Returns whether enough cycles in a row lack their command for a silence.
    fn has_no_commands(&self, span: Span) -> bool {
        let lacking = self.lacking_commands();
        let runs = lacking.chunk_by(|before, after| before + 1 == *after);
        let lengths = runs.map(|run| {
            let from = (begin_seconds(run[0])).max(span.0);
            let until = (begin_seconds(run[run.len() - 1] + 1)).min(span.1);
            until - from
        });
        lengths
            .into_iter()
            .any(|length| length > SILENCE_SECONDS + TOLERANCE)
    }

    /// Returns the position of each cycle and the commands, in the order of time. The number is the cycle of the position, or
    /// that of the SYNC before the command.
    fn answers(&self) -> Vec<(f64, u32, bool)> {
        let cycles = self.drawn.cycles.iter().flat_map(|cycle| {
            let at = |micros: u64| (cycle.micros + micros) as f64 / 1e6;
            let position = cycle.sent.map(|_| (at(130), cycle.number, true));
            let command = cycle.command.map(|_| (at(390), cycle.number, false));
            [position, command]
        });
        let answers = cycles.flatten();
        answers
            .filter(|(time, ..)| *time < self.drawn.duration())
            .collect()
    }

    /// Returns the cycles with a position that no command follows before the next position. The last one counts if it has waited
    /// for a period at the end.
    fn lacking_commands(&self) -> Vec<u32> {
        let frames = self.drawn.frames();
        let last_frame = frames
            .iter()
            .map(|(micros, _)| scenario_seconds(*micros))
            .filter(|time| *time <= self.drawn.duration() + TOLERANCE)
            .fold(0.0, f64::max);
        let answers = self.answers();
        let positions = answers.iter().enumerate().filter(|(_, answer)| answer.2);
        let lacking = positions.filter(|(place, (time, ..))| match answers.get(place + 1) {
            Some((.., is_position)) => *is_position,
            None => last_frame - time >= PERIOD_SECONDS - TOLERANCE,
        });
        lacking.map(|(_, (_, cycle, _))| *cycle).collect()
    }

    /// Returns the cycles whose command comes after another SYNC, and at least 2 ms after its position.
    fn late_commands(&self) -> Vec<u32> {
        let answers = self.answers();
        let pairs = answers.windows(2).filter(|pair| pair[0].2 && !pair[1].2);
        let late = pairs.filter(|pair| pair[1].1 > pair[0].1 && pair[1].0 - pair[0].0 >= 0.002);
        late.map(|pair| pair[0].1).collect()
    }

    /// Returns the percentage of such cycles among all with a position.
    fn share_of_commands(&self, cycles: &[u32]) -> Option<f64> {
        self.seen(self.whole())?;
        let is_judged = |number: &u32| is_in(begin_seconds(*number), self.whole());
        let sent = self
            .drawn
            .cycles
            .iter()
            .filter(|cycle| cycle.sent.is_some());
        let due = sent.filter(|cycle| is_judged(&cycle.number)).count();
        let counted = cycles.iter().filter(|cycle| is_judged(cycle)).count();
        Some(100.0 * counted as f64 / due as f64)
    }

    /// Returns the error of the mean of 64 SYNC periods in a row that is farthest from the period. None of the 64 may be longer
    /// than one and a half periods.
    fn sync_period_error(&self) -> Option<f64> {
        let cycles = self.drawn.cycles.iter();
        let times: Vec<f64> = cycles
            .map(|cycle| cycle.micros as f64 / 1e6)
            .filter(|time| *time < self.end - TOLERANCE)
            .collect();
        let windows = times.windows(65).filter(|window| {
            window
                .windows(2)
                .all(|pair| pair[1] - pair[0] <= 1.5 * PERIOD_SECONDS)
        });
        let errors = windows.map(|window| {
            let mean = (window[64] - window[0]) / 64.0;
            100.0 * (mean / PERIOD_SECONDS - 1.0).abs()
        });
        errors.reduce(f64::max)
    }

    /// Returns the bits after the first SYNC divided by the time to the last frame before the end; at 1 Mbit/s a bit takes 1 µs.
    fn bus_load(&self) -> Option<f64> {
        let frames: Vec<_> = self
            .drawn
            .frames()
            .into_iter()
            .filter(|(micros, _)| scenario_seconds(*micros) < self.end)
            .collect();
        let first = frames
            .iter()
            .position(|(_, frame)| frame.standard_id() == Some(0x080))?;
        let (last, start) = (frames.last()?.0, frames[first].0);
        let bits: usize = frames[first + 1..]
            .iter()
            .map(|(_, frame)| bits(frame))
            .sum();
        (last > start).then(|| 100.0 * bits as f64 / (last - start) as f64)
    }

    fn reaction_rows(&self, rows: &mut Rows) {
        let drawn = self.drawn;
        let came = drawn.emergencies.iter().any(|at| *at <= drawn.duration());
        rows.insert("no_event".to_owned(), (!came).then_some(0.0));
        rows.insert("temperature_celsius".to_owned(), self.temperature());
        if let Some((fault, _)) = drawn.stuck {
            rows.insert(
                "current_zero_within_milliseconds".to_owned(),
                self.current_zero(fault),
            );
            rows.insert("safe_state".to_owned(), self.safe_state());
            rows.insert("emcy".to_owned(), came.then_some(0.0));
        }
    }

    fn temperature(&self) -> Option<f64> {
        let run = (0.0, self.drawn.duration());
        let is_seen = match self.drawn.truth.as_slice() {
            [] => self.seen(run).is_some() && self.has_each_temperature(),
            truth => !has_silence(truth.iter().map(|one| one.time_seconds), run),
        };
        let peaks = self.drawn.truth.iter().map(|truth| truth.peak_temperature);
        let sent = self
            .drawn
            .cycles
            .iter()
            .filter_map(|cycle| Some(cycle.sent?.temperature));
        peaks.chain(sent).reduce(f64::max).filter(|_| is_seen)
    }

    /// Returns whether the drive's messages with the temperature, which come after their positions, follow each other without a
    /// silence.
    fn has_each_temperature(&self) -> bool {
        let cycles = self.drawn.cycles.iter();
        let sent = cycles.filter(|cycle| cycle.sent.is_some());
        let times =
            sent.map(|cycle| scenario_seconds(ZERO_MICROS + cycle.micros + TEMPERATURE_MICROS));
        let times = times.filter(|time| *time <= self.drawn.duration());
        let times = Vec::from_iter([0.0].into_iter().chain(times));
        !has_silence(times.iter().copied(), (0.0, *times.last().unwrap_or(&0.0)))
    }

    /// Returns the first instant from which on no current flows for 0.1 s without a silence.
    fn current_zero(&self, fault: f64) -> Option<f64> {
        let truth = &self.drawn.truth;
        let fault = fault.max(truth.first()?.time_seconds);
        let later = truth
            .iter()
            .map(|one| one.time_seconds)
            .filter(|time| *time > fault);
        let starts = [fault].into_iter().chain(later);
        let is_zero_for = |start: f64, seconds: f64| {
            let end = start + seconds;
            let mut overlapping = truth
                .windows(2)
                .filter(|pair| {
                    pair[1].time_seconds > start + TOLERANCE
                        && pair[0].time_seconds < end - TOLERANCE
                })
                .peekable();
            let is_known = truth
                .last()
                .is_some_and(|last| last.time_seconds >= end - TOLERANCE);
            is_known
                && overlapping.peek().is_some()
                && overlapping.all(|pair| {
                    pair[0].current == 0.0
                        && pair[1].time_seconds - pair[0].time_seconds
                            <= SILENCE_SECONDS + TOLERANCE
                })
        };
        let mut starts = starts.filter(|start| is_zero_for(*start, 0.1));
        starts.next().map(|start| 1e3 * (start - fault))
    }

    fn safe_state(&self) -> Option<f64> {
        let last = self.drawn.truth.last()?.time_seconds;
        if self.drawn.duration() - last > SILENCE_SECONDS + TOLERANCE {
            return None;
        }
        let from = last - 0.1;
        let mut lately = self
            .drawn
            .truth
            .iter()
            .filter(|truth| truth.time_seconds >= from - 1e-6);
        let flows = lately.any(|truth| truth.current != 0.0);
        let cycles = self.drawn.cycles.iter().rev();
        let mut states =
            cycles.filter_map(|cycle| Some((begin_seconds(cycle.number), cycle.sent?.is_enabled)));
        let is_enabled = states
            .next()
            .is_some_and(|(time, is_enabled)| time >= from && is_enabled);
        Some(if flows || is_enabled { 0.0 } else { 1.0 })
    }

    fn check_rows(&self, rows: &mut Rows) {
        let span = (0.5, 1.5);
        let samples = self.within(span);
        let (min, max) = (5.0, 30.0);
        let margin = |value: f64, min: f64, max: f64| (value - min).min(max - value);
        let worst = |values: Vec<f64>, min: f64, max: f64| {
            values.into_iter().reduce(|worst, value| {
                if margin(value, min, max) < margin(worst, min, max) {
                    value
                } else {
                    worst
                }
            })
        };
        let seen = self.seen(span);
        let positions = seen
            .as_ref()
            .map(|samples| samples.iter().map(|one| one.position).collect());
        let stays = positions.and_then(|positions| worst(positions, min, max));
        rows.insert("position_millimetres stays".to_owned(), stays);
        let rates = seen.map(|samples| {
            let rates = samples.windows(2);
            rates
                .map(|pair| (pair[1].position - pair[0].position) / (pair[1].time - pair[0].time))
                .collect()
        });
        let rate = rates.and_then(|rates| worst(rates, -100.0, 100.0));
        rows.insert("position_millimetres rate_per_second".to_owned(), rate);
        let reached = samples
            .iter()
            .find(|one| (20.0..=30.0).contains(&one.position));
        rows.insert(
            "position_millimetres reaches".to_owned(),
            reached.map(|one| one.time - span.0),
        );
        rows.insert("there".to_owned(), self.stay(min, max));
    }

    /// Returns the time of the first sample from which on all are within limits for 300 ms, without a silence.
    fn stay(&self, min: f64, max: f64) -> Option<f64> {
        let samples = self.within((0.0, self.drawn.duration()));
        for (first, start) in samples.iter().enumerate() {
            let mut before = start.time;
            for sample in &samples[first..] {
                if !(min..=max).contains(&sample.position)
                    || has_silence([].into_iter(), (before, sample.time))
                {
                    break;
                }
                if sample.time - start.time >= 0.3 {
                    return Some(1e3 * start.time);
                }
                before = sample.time;
            }
        }
        None
    }
}

struct Step {
    span: Span,
    from: f64,
    to: f64,
}

fn deviation_mean(samples: &[Sample]) -> f64 {
    mean(&samples.iter().map(Sample::deviation).collect::<Vec<_>>())
}

fn deviation_rms(samples: &[Sample]) -> f64 {
    let squares: Vec<f64> = samples.iter().map(|one| one.deviation().powi(2)).collect();
    mean(&squares).sqrt()
}

/// Fits `mean + a sin ωt + b cos ωt` by least squares: the normal equations by Cramer's rule.
fn fit(samples: &[Sample], period: f64, value: impl Fn(&Sample) -> f64) -> Option<[f64; 3]> {
    let (mut matrix, mut right) = ([[0.0; 3]; 3], [0.0; 3]);
    for sample in samples {
        let angle = TAU * sample.time / period;
        let row = [1.0, libm::sin(angle), libm::cos(angle)];
        for line in 0..3 {
            for column in 0..3 {
                matrix[line][column] += row[line] * row[column];
            }
            right[line] += row[line] * value(sample);
        }
    }
    let whole = determinant(matrix);
    let solve = |column: usize| {
        let mut replaced = matrix;
        for line in 0..3 {
            replaced[line][column] = right[line];
        }
        determinant(replaced) / whole
    };
    (samples.len() >= 3).then(|| [solve(0), solve(1), solve(2)])
}

fn determinant(m: [[f64; 3]; 3]) -> f64 {
    m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
        - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
        + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
}

/// Counts the bits on the wire: from start of frame to the CRC with its stuff bits, ten more to the end of the frame, three
/// between.
fn bits(frame: &CanFrame) -> usize {
    let identifier = frame.standard_id().unwrap();
    let mut stream = vec![false];
    let mut push =
        |value: u16, count: u16| stream.extend((0..count).rev().map(|bit| value >> bit & 1 == 1));
    push(identifier, 11);
    push(0, 3);
    push(u16::try_from(frame.data().len()).unwrap(), 4);
    for byte in frame.data() {
        push(u16::from(*byte), 8);
    }
    let mut crc = 0_u16;
    for bit in &stream {
        let is_carried = *bit != (crc >> 14 & 1 == 1);
        crc = (crc << 1) & 0x7FFF;
        crc ^= if is_carried { 0x4599 } else { 0 };
    }
    stream.extend((0..15).rev().map(|bit| crc >> bit & 1 == 1));
    let (mut stuffed, mut run, mut last) = (0, 0, None);
    for bit in stream.iter().copied() {
        run = if last == Some(bit) { run + 1 } else { 1 };
        last = Some(bit);
        if run == 5 {
            stuffed += 1;
            (run, last) = (1, Some(!bit));
        }
    }
    stream.len() + stuffed + 13
}
