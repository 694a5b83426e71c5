//! `canrig simulate --watch`: plays a scenario again whenever one of its files changes.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, SystemTime};

use recording::run_folder::file;
use report::terminal;
use scenario::HASH_SUFFIX;

use super::simulate::{OneProcess, SimulateArgs};
use crate::console::{print, print_problem};
use crate::event::{Listener, RunEvent};
use crate::exit::{Exit, Failure};
use crate::observer::observed;
use crate::output;
use crate::play::{ValueArgs, play_all};
use crate::recorded::unreadable;
use crate::scenarios::{is_to_play, load, scenario_files};

/// Time between two looks at the files.
const POLL: Duration = Duration::from_millis(200);
/// Name of the page of the last play, in the folder of `--output`.
const PAGE: &str = "watch.html";
/// Begin of the head of a page, and the element that makes a browser load the page again every two
/// seconds.
const HEAD: &str = "<head>";
const RELOAD: &str = "<meta http-equiv=\"refresh\" content=\"2\">";

/// Plays the scenario again and again until the user ends it.
pub(super) fn watch(args: &SimulateArgs) -> Result<Exit, Failure> {
    let paths = scenario_files(&args.play.scenarios, is_to_play)?;
    let [path] = &paths[..] else {
        let count = paths.len();
        return Err(Exit::Usage.because(format!(
            "--watch plays one scenario, but {count} are named; name one"
        )));
    };
    let page = args.play.output.join(PAGE);
    print(&format!(
        "watching {} and the files that it names; Ctrl-C ends\npage, which reloads itself: {}",
        path.display(),
        page.display()
    ));
    let (sender, stopped) = mpsc::channel();
    let stop = || {
        // Nobody hears a second request after the first one.
        let _ = sender.send(());
    };
    // A request to stop may come between two plays, too.
    observed(stop, || (), || play_again(args, path, &page, &stopped))?;
    Ok(Exit::Pass)
}

/// Plays the scenario, again at each change, until the user stops it.
fn play_again(
    args: &SimulateArgs,
    scenario: &Path,
    page: &Path,
    stopped: &Receiver<()>,
) -> Result<(), Failure> {
    let mut watched = Watched::default();
    let mut last: Option<PathBuf> = None;
    let mut number = 1;
    loop {
        // What changes from here on, during the play too, leads to another one.
        watched.look(scenario, &args.play.values);
        let listener = OneLine::new(number);
        let mut testbed = OneProcess::new(args, &listener);
        if play_all(&args.play, &mut testbed, &listener)? == Exit::Interrupted {
            return Ok(());
        }
        if let Some(folder) = listener.folder() {
            number += 1;
            copy_page(&folder.join(file::REPORT), page)?;
            if let Some(before) = last.replace(folder) {
                fs::remove_dir_all(&before).map_err(unreadable(&before))?;
            }
        }
        if !watched.wait_for_change(stopped) {
            return Ok(());
        }
    }
}

/// Copies the page of a run to a place where it reloads itself.
fn copy_page(report: &Path, page: &Path) -> Result<(), Failure> {
    let text = fs::read_to_string(report).map_err(unreadable(report))?;
    let text = text.replacen(HEAD, &format!("{HEAD}{RELOAD}"), 1);
    output::write(page, text.as_bytes())
}

/// State of a file: two states of one file that differ show a change.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Stamp {
    modified: SystemTime,
    length: u64,
    /// Number of the file in its file system. Editors replace a file by another one.
    inode: u64,
}

impl Stamp {
    /// Returns the state of a file; `None` if there is none.
    fn of(path: &Path) -> Option<Self> {
        let known = |found: fs::Metadata| -> io::Result<Self> {
            Ok(Self {
                modified: found.modified()?,
                length: found.len(),
                inode: found.ino(),
            })
        };
        fs::metadata(path).and_then(known).ok()
    }
}

/// Files that take part in a scenario, each with its last state.
#[derive(Debug, Default)]
struct Watched(BTreeMap<PathBuf, Option<Stamp>>);

impl Watched {
    /// Takes the states of the files as they are now. If the scenario is not valid, the files are
    /// those that it named before.
    fn look(&mut self, scenario: &Path, values: &ValueArgs) {
        self.0.insert(scenario.to_owned(), None);
        self.renew();
        if let Ok(plan) = load(scenario, values) {
            let beside = &plan.shared.beside;
            let names = plan.shared.tables.keys();
            let names = names.map(|name| name.strip_suffix(HASH_SUFFIX).unwrap_or(name));
            let named = names.map(|name| beside.place(name));
            // The scenario keeps its state from before it was read.
            self.0.retain(|path, _| path == scenario);
            self.0.extend(named.map(|path| {
                let stamp = Stamp::of(&path);
                (path, stamp)
            }));
        }
    }

    /// Takes the states of the files as they are now. Returns whether one has changed.
    fn renew(&mut self) -> bool {
        let mut has_changed = false;
        for (path, stamp) in &mut self.0 {
            let now = Stamp::of(path);
            has_changed |= now != *stamp;
            *stamp = now;
        }
        has_changed
    }

    /// Waits until a file has changed, and no file changes any more. Returns whether that came
    /// before the user's request to stop.
    fn wait_for_change(&mut self, stopped: &Receiver<()>) -> bool {
        let mut has_changed = false;
        loop {
            match self.renew() {
                true => has_changed = true,
                false if has_changed => return true,
                false => {}
            }
            if stopped.recv_timeout(POLL) != Err(RecvTimeoutError::Timeout) {
                return false;
            }
        }
    }
}

/// Listener that prints a line for each play, and problems.
struct OneLine {
    number: u64,
    folder: Mutex<Option<PathBuf>>,
}

impl OneLine {
    fn new(number: u64) -> Self {
        Self {
            number,
            folder: Mutex::new(None),
        }
    }

    /// Returns the run folder of the play; `None` if there was none.
    fn folder(self) -> Option<PathBuf> {
        let folder = self.folder.into_inner();
        folder.unwrap_or_else(PoisonError::into_inner)
    }
}

impl Listener for OneLine {
    fn on_event(&self, event: &RunEvent<'_>) {
        match event {
            RunEvent::Judged { judged, .. } => {
                let values = terminal::values(&judged.verdict);
                print(&format!("play {}: {values}", self.number));
                let mut folder = self.folder.lock().unwrap_or_else(PoisonError::into_inner);
                *folder = Some(judged.folder.clone());
            }
            RunEvent::Failed(reason) => print_problem(reason),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "schema = 1\nrig = \"sma_actuator\"\nname = \"s\"\nduration_seconds = 2.0\n[controller.pid]\n\
        [[reference.table]]\nfrom_seconds = 0.0\nfile = \"course.csv\"\n";
    const COURSE: &str = "time_seconds,position_millimetres\n0.0,10.0\n1.0,12.0\n";

    #[test]
    fn a_change_of_any_file_is_seen_once() {
        let folder = tempfile::tempdir().unwrap();
        let [scenario, course] = ["s.toml", "course.csv"].map(|name| folder.path().join(name));
        fs::write(&scenario, TEXT).unwrap();
        fs::write(&course, COURSE).unwrap();
        let mut watched = Watched::default();
        let values = ValueArgs::default();
        watched.look(&scenario, &values);
        assert!(!watched.renew());
        fs::write(&course, format!("{COURSE}2.0,14.0\n")).unwrap();
        assert!(watched.renew() && !watched.renew());
        fs::write(&scenario, format!("{TEXT}# more\n")).unwrap();
        assert!(watched.renew() && !watched.renew());
        // The table is watched also while the scenario is invalid.
        fs::write(&scenario, "schema = 7\n").unwrap();
        watched.look(&scenario, &values);
        assert!(!watched.renew());
        fs::remove_file(&course).unwrap();
        assert!(watched.renew() && !watched.renew());
        // Another file of the same content and length takes its place.
        let other = folder.path().join("other");
        fs::write(&other, "schema = 7\n").unwrap();
        fs::rename(&other, &scenario).unwrap();
        assert!(watched.renew() && !watched.renew());
    }
}
