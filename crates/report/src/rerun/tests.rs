//! Reads the file back with the SDK's own reader and compares it with the timeline.

use judge::verdict::Verdict;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::Path;
use std::time::Duration;

use can::CanFrame;
use dbc::Database;
use re_sdk::external::re_log_encoding::{Decoder, RawRrdManifest};
use re_sdk::log::{Chunk, LogMsg};
use re_sdk_types::archetypes::{Scalars, SeriesLines};

use super::groups::Style;
use super::run_log::Rows;
use super::times::{CYCLE, RUN_TIME};
use recording::timeline::Timeline;

use super::*;
use judge::{Circumstances, judge};
use plan::Plan;
use recording::frames::Frames;
use recording::log::Stamped;
use recording::timeline;

/// Cycle in which the drive of the made-up run is silent.
const SILENT: u64 = 70;

/// Run time in nanoseconds, cycle, value.
type Row = (i64, i64, f64);

fn plan() -> Plan {
    let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"made up\"\nduration_seconds = 0.3\n\n[controller.sliding_mode]\n\n\
        [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n\n\
        [[reference.step]]\nat_seconds = 0.1\nposition_millimetres = 35.0\n";
    testing::plan(text)
}

/// Returns 300 cycles of frames: a position that moves in coarse steps, a temperature that moves in every cycle.
fn made_up_run() -> (Frames, Vec<Timeline>, Verdict) {
    let database = Database::shipped();
    let message = |name: &str, signals: &[(&str, f64)]| {
        let mut builder = database.builder(name).unwrap();
        for (signal, value) in signals {
            builder.set(
                &database.signal(&format!("{name}.{signal}")).unwrap(),
                *value,
            );
        }
        builder.frame()
    };
    let drive = |cycle: u32| {
        let position = f64::from(cycle / 7) * 0.06;
        let signals = [
            ("statusword_state", 55.0),
            ("position_millimetres", position),
            ("current_amperes", 0.3),
        ];
        message("drive_tpdo1", &signals)
    };
    let mut frames = vec![(9_900, drive(0))];
    for cycle in 0..300_u32 {
        let begin = u64::from(cycle) * 1000 + 10_000;
        frames.push((begin, CanFrame::new(0x080, &[1])));
        if u64::from(cycle) != SILENT {
            frames.push((begin + 100, drive(cycle)));
        }
        let signals = [
            ("wire_temperature_celsius", 20.0 + 0.2 * f64::from(cycle)),
            ("martensite_fraction", 1.0 - f64::from(cycle) / 300.0),
        ];
        frames.push((begin + 200, message("drive_tpdo2", &signals)));
    }
    let stamped = |(micros, frame)| Stamped::new(Duration::from_micros(micros), frame);
    let frames = Frames::from(frames.into_iter().map(stamped).collect::<Vec<_>>());
    let timelines = timeline::decode(&frames, &plan()).unwrap();
    let verdict = judge(&plan(), &timelines, &Circumstances::default());
    (frames, timelines, verdict)
}

/// Returns all chunks of the recording itself, without the layout.
fn chunks(path: &Path) -> Vec<Chunk> {
    let file = BufReader::new(File::open(path).unwrap());
    let mut chunks = Vec::new();
    for message in Decoder::<LogMsg>::decode_eager(file).unwrap() {
        if let LogMsg::ArrowMsg(store, message) = message.unwrap()
            && store.is_recording()
        {
            chunks.push(Chunk::from_arrow_msg(&message).unwrap());
        }
    }
    chunks
}

/// Returns the scalars of a recording by path.
fn scalars(path: &Path) -> BTreeMap<String, Vec<Row>> {
    let mut series: BTreeMap<String, Vec<Row>> = BTreeMap::new();
    let component = Scalars::descriptor_scalars().component;
    for chunk in chunks(path) {
        let values: Vec<f64> = chunk
            .iter_slices::<f64>(component)
            .map(|value| value[0])
            .collect();
        if values.is_empty() {
            continue;
        }
        let times = |name: &str| {
            let (_, times) = chunk
                .timelines()
                .iter()
                .find(|(timeline, _)| timeline.as_str() == name)
                .unwrap();
            times.times_raw().to_vec()
        };
        let rows = times(RUN_TIME)
            .into_iter()
            .zip(times(CYCLE))
            .zip(values)
            .map(|((time, cycle), value)| (time, cycle, value));
        series
            .entry(chunk.entity_path().to_string())
            .or_default()
            .extend(rows);
    }
    series
}

/// Returns the value that the viewer shows in a cycle.
fn held(rows: &[Row], cycle: u64) -> Option<f64> {
    let cycle = i64::try_from(cycle).unwrap();
    rows.iter()
        .take_while(|row| row.1 <= cycle)
        .last()
        .map(|row| row.2)
}

fn run<'a>(
    plan: &'a Plan,
    frames: &'a Frames,
    timelines: &'a [Timeline],
    verdict: &'a Verdict,
) -> Run<'a> {
    Run {
        plan,
        frames,
        timelines,
        verdict,
        set: &[],
        played: None,
        is_long: false,
    }
}

fn written() -> (tempfile::TempDir, std::path::PathBuf, Timeline) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.rrd");
    let (frames, timelines, verdict) = made_up_run();
    write(&path, &run(&plan(), &frames, &timelines, &verdict)).unwrap();
    (folder, path, timelines.into_iter().next().unwrap())
}

#[test]
fn every_value_of_the_timeline_is_in_the_file() {
    let (_folder, path, timeline) = written();
    let series = scalars(&path);
    let mut compared = 0;
    for column in &timeline.columns {
        let Style { group, .. } = groups::style(&column.name, &timeline.quantities, &[], &[]);
        let rows = series
            .get(&format!("/{group}/{}", column.name))
            .cloned()
            .unwrap_or_default();
        for (row, value) in column
            .values
            .iter()
            .enumerate()
            .filter(|(_, value)| !value.is_nan())
        {
            assert_eq!(
                held(&rows, timeline.cycle.get(row).unwrap()),
                Some(value),
                "{} in row {row}",
                column.name
            );
            compared += 1;
        }
    }
    assert!(compared > 3 * 299, "{compared}");
    assert_eq!(
        series["/position/set_point_millimetres"],
        [
            (0, 0, 10.0),
            (100_000_000, 100, 35.0),
            (299_000_000, 299, 35.0)
        ]
    );
}

#[test]
fn a_signal_that_seldom_changes_or_is_not_drawn_has_rows_where_it_changes_and_the_others_in_every_cycle()
 {
    let nan = f64::NAN;
    let values = [nan, 1.0, 1.0, nan, 1.0, 2.0, 2.0, 2.0];
    let drawn = |values: &[f64]| Rows::new(&values.into(), "position", Known::Whole);
    assert_eq!(drawn(&values), Rows::All(vec![1, 2, 4, 5, 6, 7]));
    assert_eq!(
        drawn(&[values, [2.0; 8]].concat()),
        Rows::Changes(vec![1, 5, 15])
    );
    assert_eq!(drawn(&[nan; 9]), Rows::Changes(Vec::new()));
    // The further course of a run that is still played is unknown.
    let so_far = Rows::new(&vec![1.0; 9].into(), "position", Known::SoFar);
    assert_eq!(so_far, Rows::All((0..9).collect()));
    let other = |values: &[f64]| Rows::new(&values.into(), groups::OTHER, Known::SoFar);
    assert_eq!(other(&values), Rows::Changes(vec![1, 5, 7]));
    assert_eq!(other(&[nan, nan]), Rows::Changes(Vec::new()));
    assert_eq!(other(&[3.0]), Rows::Changes(vec![0]));
}

#[test]
fn the_viewer_draws_every_row_of_a_signal_that_has_few() {
    let (_folder, path, _) = written();
    let series = scalars(&path);
    let policy = SeriesLines::descriptor_aggregation_policy().component;
    let chunks = chunks(&path);
    let is_drawn_whole = |path: &str| {
        let mut styles = chunks
            .iter()
            .filter(|chunk| chunk.is_static())
            .filter(|chunk| chunk.entity_path().to_string() == path);
        styles.any(|style| style.components().contains_component(policy))
    };
    // The drive was silent in the cycle of a change.
    let position = &series["/position/position_millimetres"];
    assert_eq!(position.len(), 44);
    assert_eq!(position[10].1, i64::try_from(SILENT).unwrap() + 1);
    assert!(is_drawn_whole("/position/position_millimetres"));
    assert_eq!(series["/other/statusword_state"].len(), 2);
    assert!(is_drawn_whole("/other/statusword_state"));
    assert_eq!(series["/temperature/wire_temperature_celsius"].len(), 300);
    assert!(!is_drawn_whole("/temperature/wire_temperature_celsius"));
}

#[test]
fn the_settling_band_is_that_of_the_verdict() {
    let (_folder, path, _) = written();
    let band = &scalars(&path)["/position/settling_band/step_1/upper_millimetres"];
    assert_eq!(
        band.as_slice(),
        [(100_000_000, 100, 36.25), (300_000_000, 300, 36.25)]
    );
}

#[test]
fn the_table_of_contents_names_each_chunk_of_the_recording_and_of_its_layout() {
    let (_folder, path, _) = written();
    let contents = RawRrdManifest::from_rrd_bytes(&fs::read(&path).unwrap()).unwrap();
    let of = |kind| {
        let mut tables = contents.iter().filter(|it| it.store_id.kind() == kind);
        let table = tables.next().unwrap();
        table.sanity_check_heavy().unwrap();
        table.col_chunk_id().unwrap().collect::<Vec<_>>()
    };
    let chunks: Vec<_> = chunks(&path).iter().map(Chunk::id).collect();
    assert_eq!(of(StoreKind::Recording), chunks);
    assert!(of(StoreKind::Blueprint).len() > 20);
}

#[test]
fn the_file_is_complete_or_not_there() {
    let (folder, path, _) = written();
    let bytes = fs::read(&path).unwrap();
    assert!(bytes.starts_with(b"RRF"));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    let (frames, timelines, verdict) = made_up_run();
    let nowhere = folder.path().join("missing").join("run.rrd");
    let written = write(&nowhere, &run(&plan(), &frames, &timelines, &verdict));
    assert!(written.is_err());
    // If the new file cannot be made, since its temporary name would be too long, the old one stays.
    let path = folder.path().join("r".repeat(250));
    fs::write(&path, &bytes).unwrap();
    let written = write(&path, &run(&plan(), &frames, &timelines, &verdict));
    assert!(written.is_err() && fs::read(&path).unwrap() == bytes);
}

/// A peak of one row is kept, a constant value appears once, and its last row marks its end.
#[test]
fn of_a_long_run_the_extremes_of_each_stretch_are_kept() {
    let mut values = vec![f64::NAN; 10];
    values.extend([1.0; 40]);
    values[23] = 9.0;
    values[27] = -9.0;
    let extremes = |values: &[f64], count| Rows::extremes(&values.into(), count);
    assert_eq!(
        extremes(&values, 10),
        Rows::Changes(vec![10, 23, 27, 30, 49])
    );
    assert_eq!(extremes(&[f64::NAN; 3], 2), Rows::Changes(Vec::new()));
}

#[test]
fn a_long_run_is_thinned_and_keeps_its_peaks_its_events_and_its_times() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.rrd");
    let (frames, timelines, verdict) = made_up_run();
    let (plan, timeline) = (plan(), &timelines[0]);
    let run = Run {
        is_long: true,
        ..run(&plan, &frames, &timelines, &verdict)
    };
    write(&path, &run).unwrap();
    let series = scalars(&path);
    let position = &series["/position/position_millimetres"];
    assert!(position.len() < timeline.cycle.len() / 10, "{position:?}");
    let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(f64::NAN, f64::max);
    assert_eq!(
        largest(&mut position.iter().map(|row| row.2)),
        largest(&mut timeline.position().iter())
    );
    let (whole, ..) = written();
    let texts = |path: &Path| {
        let chunks = chunks(path).into_iter();
        let events = chunks.filter(|chunk| chunk.entity_path().to_string() == "/events");
        events.map(|chunk| chunk.num_rows()).sum::<usize>()
    };
    assert_eq!(texts(&path), texts(&whole.path().join("run.rrd")));
}

#[test]
fn a_week_has_no_more_rows_than_ten_hours() {
    let stretch = |duration_seconds| {
        let mut scenario = plan().only_loop().unwrap().trial.clone();
        scenario.run_mut().duration_seconds = duration_seconds;
        super::bus::stretch_seconds(&scenario)
    };
    assert_eq!([600.0, 36_000.0].map(stretch), [0.1; 2]);
    assert_eq!([86_400.0, 604_800.0].map(stretch), [0.24, 1.68]);
}
