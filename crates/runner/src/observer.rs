//! Shows the progress of a world while it works, and passes on the user's request to stop.

use std::future::poll_fn;
use std::io;
use std::sync::mpsc;
use std::task::Poll;
use std::time::Duration;

use platform::stop::{self, end_in_order, heard};
use tokio::signal::unix::{SignalKind, signal};
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
        let signals = heard().map(|number| signal(SignalKind::from_raw(number)));
        let mut signals = signals.collect::<io::Result<Vec<_>>>()?;
        drop(unprepared);
        let mut ticks = tokio::time::interval(PROGRESS_PERIOD);
        loop {
            let raised = poll_fn(|context| {
                let mut polled = signals.iter_mut().map(|one| one.poll_recv(context));
                polled.find(Poll::is_ready).unwrap_or(Poll::Pending)
            });
            tokio::select! {
                _ = &mut ended => return Ok(()),
                _ = raised => {
                    stop::request();
                    interrupt();
                }
                _ = ticks.tick() => show(),
            }
        }
    })
}
