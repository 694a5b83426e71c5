//! A Rerun viewer that shows the run while it goes on.
//!
//! The run does not depend on it: frames go through a ring of bounded size ([`crate::tap`]) to a thread of their own,
//! which logs in pieces of a tenth of a second and waits for the viewer after each. Whoever does not drain is dropped from; at the
//! run's end the viewer has [`END_PATIENCE`] for what is still on the way.
//!
//! That thread spends 6 µs a cycle on ten signals in real time (measured: 21 µs for 38 signals and the drawings, on two
//! busy processors), and 1 µs when a recording is replayed at once, since its pieces are larger then.

mod address;
mod args;
#[cfg(feature = "rerun")]
mod live;
mod start;

pub use address::ViewerAddress;
pub use args::ViewerArgs;

use std::sync::mpsc::{Receiver, Sender};
use std::time::Duration;

use crate::console::complain;
use crate::run::Source;
use crate::tap::{Dropped, Tap, WhenFull};
use crate::verdict::Verdict;

/// How long a run waits at its end for a viewer that takes nothing.
pub const END_PATIENCE: Duration = Duration::from_secs(2);
/// How to get the viewer.
pub const INSTALL: &str = "pip install rerun-sdk==0.36.3";

/// The viewers of a command.
#[derive(Debug, Default)]
pub struct Viewers {
    addresses: Vec<ViewerAddress>,
}

impl Viewers {
    /// Opens or finds the viewers that the arguments name, and tells which cannot be had: the run goes on without them.
    #[must_use]
    pub fn open(args: &ViewerArgs) -> Self {
        let wanted = args.viewer || args.rerun_connect.is_some();
        if wanted && !cfg!(feature = "rerun") {
            complain(
                "canrig: this canrig cannot talk to viewers; build it with the feature \"rerun\" (a default one)",
            );
            return Self::default();
        }
        let opened = args.viewer.then(start::open);
        let found = args.rerun_connect.clone().map(|address| {
            let answers = address.answers();
            answers.map(|()| address)
        });
        let mut viewers = Self::default();
        for viewer in opened.into_iter().chain(found) {
            match viewer {
                Ok(address) => viewers.addresses.push(address),
                Err(reason) => complain(&format!("canrig: no live view: {reason}")),
            }
        }
        viewers
    }

    /// Whether there is one.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.addresses.is_empty()
    }

    /// Begins to show a run in each viewer: where its frames go, and how to end.
    #[must_use]
    #[cfg(feature = "rerun")]
    pub fn show(&self, source: &Source, when_full: WhenFull) -> (Vec<Tap>, Shows) {
        let started = self.addresses.iter();
        let started = started.map(|address| Show::start(address, source, when_full));
        let (taps, shows) = started.unzip();
        (taps, Shows(shows))
    }

    /// Without the SDK there are no viewers.
    #[must_use]
    #[cfg(not(feature = "rerun"))]
    pub fn show(&self, _source: &Source, _when_full: WhenFull) -> (Vec<Tap>, Shows) {
        (Vec::new(), Shows::default())
    }
}

/// A run in all viewers.
#[derive(Debug, Default)]
pub struct Shows(Vec<Show>);

impl Shows {
    /// Shows the verdict too, waits for the viewers as long as the patience lasts, and tells what they did not get. One
    /// that takes nothing any more is shown no further run.
    pub fn end(self, verdict: &Verdict, viewers: &mut Viewers) {
        for show in &self.0 {
            // A listener that has ended needs no verdict.
            let _ = show.verdict.send(verdict.clone());
        }
        for show in self.0 {
            let what = match show.ended() {
                Ok(()) => match show.dropped.count() {
                    0 => continue,
                    count => format!("was too slow for {count} frames"),
                },
                Err(reason) => {
                    viewers.addresses.retain(|address| *address != show.address);
                    reason
                }
            };
            let address = show.address;
            complain(&format!(
                "canrig: the viewer at {address} {what}; the recording is complete"
            ));
        }
    }
}

/// A run in one viewer.
#[derive(Debug)]
struct Show {
    address: ViewerAddress,
    dropped: Dropped,
    verdict: Sender<Verdict>,
    /// How the thread ended; it may hang on a viewer that is paused, so it is not joined.
    ended: Receiver<Result<(), String>>,
}

impl Show {
    /// Waits for the viewer; why it took no more, in words that follow on its address.
    fn ended(&self) -> Result<(), String> {
        match self.ended.recv_timeout(END_PATIENCE) {
            Ok(shown) => shown.map_err(|error| format!("was lost: {error}")),
            Err(_) => Err(format!(
                "took nothing for {} s and missed the end of the run",
                END_PATIENCE.as_secs()
            )),
        }
    }
}
