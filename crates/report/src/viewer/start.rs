//! Opens a viewer as a separate program.

use std::io;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use platform::clock::{Clock, sleep};
use platform::scheduling;

use super::address::ViewerAddress;

/// Command that installs the viewer.
pub(crate) const INSTALL: &str = "pip install rerun-sdk==0.36.3";
/// Largest memory of the viewer and of the server for a run; they drop the oldest data of a longer one. Without a limit they take
/// three quarters of the memory, which the bench needs, too.
const MEMORY_MAX: &str = "1GB";
const SERVER_MEMORY_MAX: &str = "250MB";
/// Default port of the viewer.
const PORT: u16 = 9876;
/// Longest time until the viewer listens.
const START_PATIENCE: Duration = Duration::from_secs(30);
/// Time between two checks whether the viewer listens.
const LOOK_PERIOD: Duration = Duration::from_millis(100);

/// Returns the viewer that is open on its default port, or opens a new one.
pub(super) fn open() -> Result<ViewerAddress, String> {
    let address = ViewerAddress::loopback(PORT);
    if address.answers().is_ok() {
        return Ok(address);
    }
    let mut viewer = start().map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => {
            format!("there is no program `rerun`; install the viewer with: {INSTALL}")
        }
        _ => format!("`rerun` cannot be started: {error}"),
    })?;
    let clock = Clock::start();
    while address.answers().is_err() {
        if let Ok(Some(status)) = viewer.try_wait() {
            return Err(format!(
                "`rerun` ended at once ({status}); run it by itself to see why"
            ));
        }
        if clock.now() > START_PATIENCE {
            let seconds = START_PATIENCE.as_secs();
            return Err(format!(
                "`rerun` does not listen on {address} after {seconds} s"
            ));
        }
        sleep(LOOK_PERIOD);
    }
    Ok(address)
}

/// Starts the viewer on loopback only. It stays when the run ends, and yields when processors are scarce.
fn start() -> io::Result<Child> {
    let mut command = Command::new("rerun");
    command
        .args(["--bind", "127.0.0.1", "--port", &PORT.to_string()])
        .args(["--expect-data-soon", "--hide-welcome-screen"])
        .args(["--memory-limit", MEMORY_MAX])
        .args(["--server-memory-limit", SERVER_MEMORY_MAX])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        // Ctrl-C is for the run.
        .process_group(0);
    let starter = std::thread::spawn(move || {
        scheduling::step_back();
        command.spawn()
    });
    starter
        .join()
        .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}
