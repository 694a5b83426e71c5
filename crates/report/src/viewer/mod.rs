//! A Rerun viewer that shows a run while it is played.
//!
//! The run does not depend on the viewer: frames go through a ring of bounded size ([`recording::frame_queue`]) to a separate
//! thread, which logs pieces of a tenth of a second and waits for the viewer after each. Frames for a viewer that is too slow are
//! dropped. At the run's end the viewer has [`END_PATIENCE`] for the data that is still on the way.
//!
//! That thread spends 6 µs a cycle on ten signals in real time (measured: 21 µs for 38 signals and the drawings, on two
//! busy processors), and 1 µs when a recording is replayed at once, since its pieces are larger then.

mod address;
#[cfg(feature = "rerun")]
mod live;
mod start;

pub use address::ViewerAddress;
pub(crate) use start::INSTALL;

use std::sync::mpsc::{Receiver, Sender};
use std::time::Duration;

use judge::verdict::Verdict;
use plan::Plan;
use recording::frame_queue::{DroppedFrames, FrameQueue, WhenFull};

/// Longest time that a run waits at its end for a viewer that takes no data.
pub const END_PATIENCE: Duration = Duration::from_secs(2);

/// Viewers of a command.
#[derive(Debug, Default)]
pub struct Viewers {
    addresses: Vec<ViewerAddress>,
}

impl Viewers {
    /// Opens a viewer, finds the one at an address, or both. Also returns the reasons why one is missing. The run continues
    /// without missing ones.
    pub fn open(opens_one: bool, connect: Option<&ViewerAddress>) -> (Self, Vec<String>) {
        let mut viewers = Self::default();
        let mut refused = Vec::new();
        let is_wanted = opens_one || connect.is_some();
        if is_wanted && !cfg!(feature = "rerun") {
            refused.push("this canrig cannot talk to viewers; build it with the feature \"rerun\" (a default one)".to_owned());
            return (viewers, refused);
        }
        let opened = opens_one.then(start::open);
        let found = connect.map(|address| address.answers().map(|()| address.clone()));
        for viewer in opened.into_iter().chain(found) {
            match viewer {
                Ok(address) => viewers.addresses.push(address),
                Err(reason) => refused.push(format!("no live view: {reason}")),
            }
        }
        (viewers, refused)
    }

    /// Returns whether there is no viewer.
    pub fn is_empty(&self) -> bool {
        self.addresses.is_empty()
    }

    /// Begins to show a run with all its loops in each viewer. Returns the queues for its frames, and the handle to end with.
    #[cfg(feature = "rerun")]
    pub fn show(&self, plan: &Plan, when_full: WhenFull) -> (Vec<FrameQueue>, Shows) {
        let addresses = self.addresses.iter();
        let started = addresses.map(|address| Show::start(address, plan, when_full));
        let (queues, shows) = started.unzip();
        (queues, Shows(shows))
    }

    /// Returns nothing, since there are no viewers without the SDK.
    #[cfg(not(feature = "rerun"))]
    pub fn show(&self, _plan: &Plan, _when_full: WhenFull) -> (Vec<FrameQueue>, Shows) {
        (Vec::new(), Shows::default())
    }
}

/// Run in all viewers.
#[derive(Debug, Default)]
pub struct Shows(Vec<Show>);

impl Shows {
    /// Shows the verdict and waits for the viewers until the patience ends. Returns texts on the data that viewers missed. A
    /// viewer that no longer takes data is not shown further runs.
    pub fn end(self, verdict: &Verdict, viewers: &mut Viewers) -> Vec<String> {
        for show in &self.0 {
            // A listener that has ended needs no verdict.
            let _ = show.verdict.send(verdict.clone());
        }
        let missed = self.0.into_iter().filter_map(|show| {
            let address = &show.address;
            let what = match show.ended.recv_timeout(END_PATIENCE) {
                Ok(Ok(())) => match show.dropped.count() {
                    0 => return None,
                    count => format!("was too slow for {count} frames"),
                },
                ended => {
                    viewers.addresses.retain(|other| other != address);
                    match ended {
                        Ok(Err(error)) => format!("was lost: {error}"),
                        _ => format!(
                            "took nothing for {} s and missed the end of the run",
                            END_PATIENCE.as_secs()
                        ),
                    }
                }
            };
            Some(format!(
                "the viewer at {address} {what}; the recording is complete"
            ))
        });
        missed.collect()
    }
}

/// Run in one viewer.
#[derive(Debug)]
struct Show {
    address: ViewerAddress,
    dropped: DroppedFrames,
    verdict: Sender<Verdict>,
    /// End of the thread, which is not joined, since it may hang on a paused viewer.
    ended: Receiver<Result<(), String>>,
}
