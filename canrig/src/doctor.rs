//! What of this machine serves a test bench, and the command that mends what does not.

use std::env;
use std::fs;
use std::path::Path;

use clap::Args;
use platform::private_bus::PrivateBus;
use platform::{probe, scheduling};

use runner::console::print;
use runner::exit::Exit;

/// The program that shows recordings.
const VIEWER: &str = "rerun";

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct MachineCheck {
    /// What.
    pub what: &'static str,
    /// What was found.
    pub found: String,
    /// The command that mends it; none where nothing is amiss.
    pub mend: Option<String>,
}

impl MachineCheck {
    fn new(what: &'static str, found: Result<String, (String, &str)>) -> Self {
        let (found, mend) = match found {
            Ok(found) => (found, None),
            Err((found, mend)) => (found, Some(mend.to_owned())),
        };
        Self { what, found, mend }
    }
}

/// Arguments of `doctor`.
#[derive(Args, Debug)]
pub(crate) struct DoctorArgs {
    /// End with exit code 4 when something is amiss
    #[arg(long)]
    pub strict: bool,
}

/// Looks at this machine and prints what serves and what does not.
#[must_use]
pub(crate) fn doctor(args: &DoctorArgs) -> Exit {
    let checks = examine();
    print(&table(&checks));
    if args.strict && checks.iter().any(|check| check.mend.is_some()) {
        Exit::BenchFailed
    } else {
        Exit::Pass
    }
}

/// Looks at everything. Asks for memory and makes a private bus for a moment.
fn examine() -> Vec<MachineCheck> {
    vec![
        kernel_can(),
        private_bus(),
        fifo(),
        memory(),
        clock_source(),
        governor(),
        isolation(),
        viewer(),
    ]
}

/// The checks as lines.
fn table(checks: &[MachineCheck]) -> String {
    let width = checks.iter().map(|check| check.what.len()).max();
    let width = width.unwrap_or_default();
    let lines = checks.iter().map(|MachineCheck { what, found, mend }| {
        let mark = if mend.is_some() { "no" } else { "ok" };
        let line = format!("{mark}  {what:width$}  {found}");
        match mend {
            None => line,
            Some(mend) => format!("{line}\n    {:width$}  mend: {mend}", ""),
        }
    });
    lines.collect::<Vec<_>>().join("\n")
}

fn kernel_can() -> MachineCheck {
    let found = probe::kernel_can().map(|()| "CAN sockets open".to_owned());
    let mend = "sudo modprobe can-raw vcan   (where the kernel is built with CAN; else use --bus embedded)";
    MachineCheck::new(
        "kernel CAN",
        found.map_err(|error| (first_part(&error), mend)),
    )
}

fn private_bus() -> MachineCheck {
    let found =
        PrivateBus::start().map(|_| "a vcan in a namespace of one's own carries frames".to_owned());
    let mend = "sudo modprobe vcan can-raw && sudo sysctl user.max_user_namespaces=10000 kernel.unprivileged_userns_clone=1";
    MachineCheck::new(
        "private bus",
        found.map_err(|error| (first_part(&error), mend)),
    )
}

/// What went wrong, without the advice that a message holds in brackets or after a semicolon.
fn first_part(error: &impl ToString) -> String {
    let text = error.to_string();
    let end = text.find("; ").unwrap_or(text.len());
    text[..end].to_owned()
}

fn fifo() -> MachineCheck {
    // On a thread that ends at once, so that nothing else runs with the priority.
    let asked = std::thread::spawn(|| scheduling::request_fifo(scheduling::NODE_PRIORITY)).join();
    let found = match asked {
        Ok(Ok(())) => Ok(format!("SCHED_FIFO {} granted", scheduling::NODE_PRIORITY)),
        Ok(Err(refused)) => Err((
            first_part(&refused),
            "sudo prlimit --pid $$ --rtprio=99   (for ever: \"@realtime - rtprio 99\" in /etc/security/limits.d/)",
        )),
        Err(_) => Err(("could not be asked".to_owned(), "")),
    };
    MachineCheck::new("real-time priority", found)
}

fn memory() -> MachineCheck {
    let found = scheduling::lock_memory().map(|()| "granted".to_owned());
    let mend = "sudo prlimit --pid $$ --memlock=unlimited";
    MachineCheck::new(
        "locked memory",
        found.map_err(|error| (first_part(&error), mend)),
    )
}

fn clock_source() -> MachineCheck {
    let read = setting("/sys/devices/system/clocksource/clocksource0/current_clocksource");
    let found = match read {
        None => Ok("the system does not say".to_owned()),
        Some(source)
            if matches!(
                source.as_str(),
                "tsc" | "arch_sys_counter" | "kvm-clock" | "hyperv_clocksource_tsc_page"
            ) =>
        {
            Ok(source)
        }
        Some(source) => Err((
            format!("{source}: reading the clock costs a system call or more"),
            "add clocksource=tsc tsc=reliable to the kernel's command line",
        )),
    };
    MachineCheck::new("clock source", found)
}

fn governor() -> MachineCheck {
    let found = match setting("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor") {
        None => Ok("none: the clock rate is not this system's to choose".to_owned()),
        Some(governor) if governor == "performance" => Ok(governor),
        Some(governor) => Err((governor, "sudo cpupower frequency-set -g performance")),
    };
    MachineCheck::new("CPU governor", found)
}

fn isolation() -> MachineCheck {
    // Not needed, so never amiss.
    let isolated = setting("/sys/devices/system/cpu/isolated");
    let found = isolated.filter(|cpus| !cpus.is_empty());
    let none = "no CPU is isolated (optional: isolcpus=… on the kernel's command line)";
    MachineCheck::new("CPU isolation", Ok(found.unwrap_or(none.to_owned())))
}

fn viewer() -> MachineCheck {
    let path = env::var_os("PATH").unwrap_or_default();
    let place = env::split_paths(&path)
        .map(|folder| folder.join(VIEWER))
        .find(|program| program.is_file());
    let found = place.map(|place| place.display().to_string());
    let mend = "pip install rerun-sdk==0.36.3";
    MachineCheck::new("viewer", found.ok_or(("not in PATH".to_owned(), mend)))
}

/// The content of a one-line file of the kernel.
fn setting(path: impl AsRef<Path>) -> Option<String> {
    let text = fs::read_to_string(path).ok()?;
    Some(text.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_amiss_comes_with_the_command_that_mends_it() {
        let checks = [
            MachineCheck::new("kernel CAN", Ok("CAN sockets open".to_owned())),
            MachineCheck::new("viewer", Err(("not in PATH".to_owned(), "pip install it"))),
        ];
        assert_eq!(
            table(&checks),
            "ok  kernel CAN  CAN sockets open\nno  viewer      not in PATH\n                mend: pip install it"
        );
    }
}
