//! Shows the progress of a world while it works, and passes on the user's request to stop.

use std::io;
use std::sync::mpsc;
use std::time::Duration;

use platform::stop::{end_in_order, is_ignored};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::oneshot;

use crate::console::print_problem;

/// Time between two moves of the progress bar.
const PROGRESS_PERIOD: Duration = Duration::from_millis(100);

/// Does `work` while another thread calls `show` for its progress, and `interrupt` at Ctrl-C, at SIGTERM, and at SIGHUP and
/// SIGQUIT unless the parent process has them ignored (nohup).
pub fn observed<T>(
    interrupt: impl Fn() + Sync,
    show: impl Fn() + Sync,
    work: impl FnOnce() -> T,
) -> T {
    let (working, ended) = oneshot::channel::<()>();
    let (unprepared, prepared) = mpsc::channel::<()>();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            if let Err(error) = observe(&interrupt, &show, ended, unprepared) {
                print_problem(format!("signals cannot be handled: {error}"));
            }
        });
        // An earlier signal would end the program with all its work.
        let _ = prepared.recv();
        let result = work();
        drop(working);
        result
    })
}

fn observe(
    interrupt: &impl Fn(),
    show: &impl Fn(),
    mut ended: oneshot::Receiver<()>,
    unprepared: mpsc::Sender<()>,
) -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    end_in_order()?;
    runtime.block_on(async {
        let mut interrupted = signal(SignalKind::interrupt())?;
        let mut terminated = signal(SignalKind::terminate())?;
        let mut hung_up = unless_ignored(SignalKind::hangup())?;
        let mut quit = unless_ignored(SignalKind::quit())?;
        drop(unprepared);
        let mut ticks = tokio::time::interval(PROGRESS_PERIOD);
        loop {
            tokio::select! {
                _ = &mut ended => return Ok(()),
                _ = interrupted.recv() => interrupt(),
                _ = terminated.recv() => interrupt(),
                () = raised(&mut hung_up) => interrupt(),
                () = raised(&mut quit) => interrupt(),
                _ = ticks.tick() => show(),
            }
        }
    })
}

/// Returns a listener for the signal; `None` if it is ignored, which it stays.
fn unless_ignored(kind: SignalKind) -> io::Result<Option<Signal>> {
    if is_ignored(kind.as_raw_value()) {
        Ok(None)
    } else {
        signal(kind).map(Some)
    }
}

/// Waits for a signal; forever if there is none.
async fn raised(signal: &mut Option<Signal>) {
    match signal {
        Some(signal) => {
            signal.recv().await;
        }
        None => std::future::pending().await,
    }
}
