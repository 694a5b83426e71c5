//! This machine: its name, and time and memory of work on it.

use std::panic::resume_unwind;
use std::time::Duration;
use std::{env, fs};

use platform::clock::Clock;
use platform::scheduling;

/// File in which the kernel reports the resources of the process.
const STATUS: &str = "/proc/self/status";

/// Variables with the machine's name, as an engine sets them; without one the kernel knows it.
const NAME_VARIABLES: [&str; 2] = ["CANRIG_NODE", "SLURMD_NODENAME"];
const KERNEL_NAME: &str = "/proc/sys/kernel/hostname";

/// Returns the name of this machine; `unknown` if the system has none.
pub fn name() -> String {
    let named = NAME_VARIABLES.iter().find_map(|name| env::var(name).ok());
    let named = named
        .or_else(|| fs::read_to_string(KERNEL_NAME).ok())
        .unwrap_or_default()
        .replace(char::is_control, "");
    if named.is_empty() {
        "unknown".to_owned()
    } else {
        named
    }
}

/// Returns the reason why nodes will run without real-time priority. It is found out on a thread that ends at once, so no other
/// code runs with the priority.
pub fn refused_priority() -> Option<String> {
    let asked = std::thread::spawn(|| scheduling::request_fifo(scheduling::NODE_PRIORITY)).join();
    asked.unwrap_or_else(|panic| resume_unwind(panic)).err()
}

/// Measures the time since its start.
pub struct Stopwatch(Clock);

impl Stopwatch {
    /// Starts a stopwatch.
    pub fn start() -> Self {
        Self(Clock::start())
    }

    /// Returns the time since the start.
    pub fn elapsed(&self) -> Duration {
        self.0.now()
    }
}

/// Returns the largest memory that this process has had, in bytes; `None` if the kernel does not report it.
pub fn memory_bytes_max() -> Option<u64> {
    let text = fs::read_to_string(STATUS).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes << 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_has_used_some_memory_and_time() {
        let watch = Stopwatch::start();
        assert!(memory_bytes_max().is_some_and(|bytes| bytes > 1 << 20));
        let mut looks = 0..1_000_000;
        assert!(
            looks.any(|_| watch.elapsed() > Duration::ZERO),
            "it stands still"
        );
    }
}
