//! While a world works: shows how far it is, and takes the user's wish to stop.

use std::io;
use std::time::Duration;

use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::oneshot;

use crate::capture::Watch;
use crate::console::{Progress, complain};

/// How often the progress bar moves.
const PROGRESS_PERIOD: Duration = Duration::from_millis(100);

/// Does `work` while another thread shows its progress, and passes Ctrl-C and SIGTERM on as a wish to stop.
pub fn observed<T>(watch: &Watch, progress: &Progress, work: impl FnOnce() -> T) -> T {
    let (working, ended) = oneshot::channel::<()>();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            if let Err(error) = observe(watch, progress, ended) {
                complain(&format!("canrig: Ctrl-C cannot be handled: {error}"));
            }
        });
        let result = work();
        drop(working);
        result
    })
}

fn observe(watch: &Watch, progress: &Progress, mut ended: oneshot::Receiver<()>) -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    runtime.block_on(async {
        let mut interrupt = signal(SignalKind::interrupt())?;
        let mut terminate = signal(SignalKind::terminate())?;
        let mut ticks = tokio::time::interval(PROGRESS_PERIOD);
        loop {
            tokio::select! {
                _ = &mut ended => return Ok(()),
                _ = interrupt.recv() => watch.interrupt(),
                _ = terminate.recv() => watch.interrupt(),
                _ = ticks.tick() => progress.show(watch.scenario_time()),
            }
        }
    })
}
