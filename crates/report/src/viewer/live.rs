//! The thread that shows a run in a viewer, on which it may hang.

use std::sync::mpsc::{self, Receiver};
use std::time::Duration;

use platform::clock::sleep;
use platform::scheduling;
use re_sdk::log::ChunkBatcherConfig;
use re_sdk::sink::SinkFlushError;
use re_sdk::{RecordingStream, RecordingStreamBuilder};
use rtrb::Consumer;

use super::{Show, ViewerAddress};
use crate::ReportError;
use crate::rerun::{self, APPLICATION, Known, Recording};
use judge::verdict::Verdict;
use plan::Plan;
use recording::frame_queue::{FrameQueue, WhenFull};
use recording::log::Stamped;
use recording::timeline::RunReader;

/// Time between two pieces that are sent.
const PIECE_PERIOD: Duration = Duration::from_millis(100);
/// Largest number of frames in one piece, which bounds the data on the way to the viewer.
const PIECE_FRAMES_MAX: usize = 20_000;
/// Longest single wait for the viewer, after which its presence is checked.
const FLUSH_PATIENCE: Duration = Duration::from_secs(1);

impl Show {
    /// Begins to show a run, whose frames go into the queue.
    pub(super) fn start(
        address: &ViewerAddress,
        plan: &Plan,
        when_full: WhenFull,
    ) -> (FrameQueue, Self) {
        let (queue, frames, dropped) = FrameQueue::new(when_full);
        let (verdict, judged) = mpsc::channel();
        let (end, ended) = mpsc::channel();
        let (url, plan) = (address.url(), plan.clone());
        std::thread::spawn(move || {
            scheduling::step_back();
            let shown = connect(&url, &plan.shared.run.name).and_then(|stream| {
                let shown = follow(stream.clone(), &plan, frames, &judged);
                // Dropping the stream would first send its data, which the viewer does not take.
                if shown.is_err() {
                    std::mem::forget(stream);
                }
                shown
            });
            // The receiver may no longer be waiting.
            let _ = end.send(shown.map_err(|error| error.to_string()));
        });
        let show = Self {
            address: address.clone(),
            dropped,
            verdict,
            ended,
        };
        (queue, show)
    }
}

/// Connects to a viewer. Each run is a separate recording, also if it is played twice.
fn connect(url: &str, name: &str) -> Result<RecordingStream, ReportError> {
    let stream = RecordingStreamBuilder::new(APPLICATION)
        .enabled(true)
        .recording_name(name)
        // Each piece is flushed, so the SDK need not look for rows by itself.
        .batcher_config(ChunkBatcherConfig {
            flush_tick: PIECE_PERIOD,
            ..ChunkBatcherConfig::DEFAULT
        })
        .connect_grpc_opts(url)?;
    stream.set_log_time_enabled(false);
    Ok(stream)
}

/// Logs pieces until the run drops its end of the ring, then the verdict. With several loops each has a folder.
fn follow(
    stream: RecordingStream,
    plan: &Plan,
    mut frames: Consumer<Stamped>,
    judged: &Receiver<Verdict>,
) -> Result<(), ReportError> {
    // The outputs are further handles of the same stream.
    let mut outputs = vec![stream.clone(); plan.loops.len()];
    let mut shown = Vec::new();
    for (output, control_loop) in outputs.iter_mut().zip(&plan.loops) {
        shown.push(Recording::begin(
            output,
            (plan, control_loop),
            Known::SoFar,
        )?);
    }
    let mut reader = RunReader::new(plan)?;
    rerun::expect_all(&mut stream.clone(), plan)?;
    loop {
        let is_last = frames.is_abandoned() && frames.slots() <= PIECE_FRAMES_MAX;
        let is_behind = frames.slots() > PIECE_FRAMES_MAX;
        let new = frames.slots().min(PIECE_FRAMES_MAX);
        for stamped in frames.read_chunk(new).into_iter().flatten() {
            reader.on_frame(&stamped);
            for recording in &mut shown {
                recording.observe(&stamped);
            }
        }
        for (recording, piece) in shown.iter_mut().zip(reader.take(is_last)) {
            recording.log(&piece)?;
        }
        flush(&stream)?;
        if is_last {
            break;
        }
        if !is_behind {
            sleep(PIECE_PERIOD);
        }
    }
    let mut end_seconds = 0.0_f64;
    for recording in shown {
        let (_, end) = recording.end()?;
        end_seconds = end_seconds.max(end);
    }
    if let Ok(verdict) = judged.recv() {
        rerun::log_verdict(&mut stream.clone(), plan, &verdict, end_seconds)?;
    }
    flush(&stream)
}

/// Waits until the viewer has everything: no more than one piece is ever on the way, however slow or paused the viewer is.
fn flush(stream: &RecordingStream) -> Result<(), ReportError> {
    loop {
        match stream.flush_with_timeout(FLUSH_PATIENCE) {
            Ok(()) => return Ok(()),
            Err(SinkFlushError::Timeout) => {}
            Err(_) => return Err("it does not answer any more".into()),
        }
    }
}
