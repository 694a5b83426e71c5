//! `canrig doctor`: checks whether this machine suits a test bench, and prints the commands that repair it.

use std::env;
use std::fs;
use std::io;
use std::path::Path;
use std::process::{self, Command};

use clap::Args;
use platform::hub::Hub;
use platform::private_bus::PrivateBus;
use platform::{probe, scheduling};

use runner::console::print;
use runner::exit::Exit;
use runner::machine::refused_priority;
use runner::run::RUNS;

/// The program that shows recordings.
const VIEWER: &str = "rerun";

/// Result of one check.
#[derive(Clone, Debug, PartialEq, Eq)]
struct MachineCheck {
    /// Name of the check.
    what: &'static str,
    /// Result, as text.
    found: String,
    /// Command that repairs it; `None` if no repair is needed.
    fix: Option<String>,
}

impl MachineCheck {
    fn new(what: &'static str, found: Result<String, String>, fix: &str) -> Self {
        let fix = found.is_err().then(|| fix.to_owned());
        let (Ok(found) | Err(found)) = found;
        Self { what, found, fix }
    }
}

/// The checks for one purpose.
struct Section {
    heading: &'static str,
    /// Whether the bench fails to work without it.
    is_needed: bool,
    checks: Vec<MachineCheck>,
}

impl Section {
    /// Returns the heading, and a line for each check with the command that repairs it.
    fn text(&self, width: usize) -> String {
        let line = |MachineCheck { what, found, fix }: &MachineCheck| {
            let mark = match (fix, self.is_needed) {
                (None, _) => "ok",
                (Some(_), true) => "MISSING",
                (Some(_), false) => "no",
            };
            let line = format!("  {mark:7}  {what:width$}  {found}");
            match fix {
                None => line,
                Some(fix) => format!("{line}\n           {:width$}  fix: {fix}", ""),
            }
        };
        let lines = Vec::from_iter(self.checks.iter().map(line));
        format!("{}\n{}", self.heading, lines.join("\n"))
    }
}

/// Arguments of `doctor`.
#[derive(Args, Debug)]
pub(crate) struct DoctorArgs {
    /// End with exit code 4 also when something optional is missing
    #[arg(long)]
    pub strict: bool,
}

/// Checks this machine, and prints the results.
pub(crate) fn doctor(args: &DoctorArgs) -> Exit {
    let sections = examine();
    print(&report(&sections));
    exit(&sections, args.strict)
}

/// Returns the exit code. Optional sections count only if `is_strict`.
fn exit(sections: &[Section], is_strict: bool) -> Exit {
    let deciding = sections.iter().filter(|one| one.is_needed || is_strict);
    let mut checks = deciding.flat_map(|one| &one.checks);
    if checks.any(|check| check.fix.is_some()) {
        Exit::BenchFailed
    } else {
        Exit::Pass
    }
}

/// Makes every check. It locks memory and makes buses for a moment.
fn examine() -> Vec<Section> {
    let section = |is_needed, heading, checks| Section {
        heading,
        is_needed,
        checks,
    };
    vec![
        section(
            true,
            "needed, to build canrig and to play scenarios",
            vec![rust(), c_compiler(), embedded_bus(), run_folder()],
        ),
        section(
            false,
            "optional, for a CAN bus of the kernel: --bus vcan0, --bus private, --bus can0 with real hardware",
            vec![kernel_can(), private_bus()],
        ),
        section(
            false,
            "optional, for limits on latencies in real time: [expect.timing]",
            vec![fifo(), memory(), clock_source(), governor(), isolation()],
        ),
        section(
            false,
            "optional, to watch runs and recordings: --viewer",
            vec![viewer()],
        ),
    ]
}

/// Returns the text of the sections, with a conclusion on whether the bench works here.
fn report(sections: &[Section]) -> String {
    let checks = sections.iter().flat_map(|section| &section.checks);
    let lengths = checks.map(|check| check.what.len());
    let width = lengths.max().unwrap_or_default();
    let blocks: Vec<String> = sections.iter().map(|section| section.text(width)).collect();
    let end = match exit(sections, false) {
        Exit::Pass => "Nothing that is needed is missing: canrig run scenarios/step.toml",
        _ => "Something that is needed is MISSING.",
    };
    format!("{}\n\n{end}", blocks.join("\n\n"))
}

fn rust() -> MachineCheck {
    let least = env!("CARGO_PKG_RUST_VERSION");
    let fix = "install it from https://rustup.rs, or: rustup update stable   (an installed canrig runs without it)";
    let found = match first_line("rustc", "--version") {
        Some(version) if is_at_least(&version, least) => Ok(version),
        Some(version) => Err(format!("{version}, but {least} or newer is needed")),
        None => Err("rustc is not in PATH".to_owned()),
    };
    MachineCheck::new("Rust toolchain", found, fix)
}

/// Returns whether the version in the second word of a text is at least `least`.
fn is_at_least(version: &str, least: &str) -> bool {
    let numbers = |text: &str| -> Vec<u32> {
        let parts = text.split(['.', '-']).take(2);
        parts.filter_map(|part| part.parse().ok()).collect()
    };
    let found = version.split(' ').nth(1).unwrap_or_default();
    numbers(found) >= numbers(least)
}

fn c_compiler() -> MachineCheck {
    let program = env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    let version = first_line(&program, "--version");
    let found = version.ok_or_else(|| format!("{program} is not in PATH"));
    let fix = "sudo apt-get install gcc libc6-dev   (an installed canrig runs without it)";
    MachineCheck::new("C compiler", found, fix)
}

/// Returns the first line that a program prints; `None` if there is no such program.
fn first_line(program: &str, argument: &str) -> Option<String> {
    let ran = Command::new(program).arg(argument).output().ok()?;
    let text = String::from_utf8_lossy(&ran.stdout).into_owned();
    let line = text.lines().next()?.trim();
    ran.status.success().then(|| line.to_owned())
}

fn embedded_bus() -> MachineCheck {
    let joined = || -> Result<(), String> {
        let (hub, _recorder) = Hub::start().map_err(|error| error.to_string())?;
        let joined = platform::open(&hub.address(), &[]);
        joined.map(|_| ()).map_err(|error| error.to_string())
    };
    let found = joined().map(|()| "programs can join it".to_owned());
    let fix = "set TMPDIR to a folder that you can write to and that admits sockets";
    MachineCheck::new("embedded bus", found, fix)
}

fn run_folder() -> MachineCheck {
    let runs = Path::new(RUNS);
    let folder = if runs.is_dir() { runs } else { Path::new(".") };
    let fix = "go to a folder that you can write to, or name one: canrig run --output FOLDER …";
    let found = match write_into(folder) {
        Ok(()) => Ok("can be written here".to_owned()),
        Err(error) => Err(format!("cannot be written here: {error}")),
    };
    MachineCheck::new("run folders", found, fix)
}

/// Writes a file and removes it.
fn write_into(folder: &Path) -> io::Result<()> {
    let file = folder.join(format!(".canrig-doctor-{}", process::id()));
    fs::write(&file, "canrig\n")?;
    fs::remove_file(file)
}

fn kernel_can() -> MachineCheck {
    let found = probe::kernel_can().map(|()| "CAN sockets open".to_owned());
    let fix = "sudo modprobe -a can-raw vcan   (where the kernel is built with CAN; else use --bus embedded)";
    MachineCheck::new("kernel CAN", found.map_err(first_part), fix)
}

fn private_bus() -> MachineCheck {
    let found =
        PrivateBus::start().map(|_| "a vcan in a private namespace carries frames".to_owned());
    let fix = "sudo modprobe -a can-raw vcan && sudo sysctl user.max_user_namespaces=10000 kernel.unprivileged_userns_clone=1";
    MachineCheck::new("private bus", found.map_err(first_part), fix)
}

/// Returns an error without the advice of the message: the line below has a command.
fn first_part(error: impl ToString) -> String {
    let text = error.to_string();
    let ends = ["; ", " (load it with"].map(|advice| text.find(advice));
    let end = ends.into_iter().flatten().min().unwrap_or(text.len());
    text[..end].to_owned()
}

fn fifo() -> MachineCheck {
    let found = match refused_priority() {
        None => Ok(format!("SCHED_FIFO {} granted", scheduling::NODE_PRIORITY)),
        Some(refused) => Err(first_part(refused)),
    };
    let fix = "sudo prlimit --pid $$ --rtprio=99   (for ever: \"@realtime - rtprio 99\" in /etc/security/limits.d/)";
    MachineCheck::new("real-time priority", found, fix)
}

fn memory() -> MachineCheck {
    let found = scheduling::lock_memory().map(|()| "granted".to_owned());
    let fix = "sudo prlimit --pid $$ --memlock=unlimited";
    MachineCheck::new("locked memory", found.map_err(first_part), fix)
}

fn clock_source() -> MachineCheck {
    const FAST: [&str; 4] = [
        "tsc",
        "arch_sys_counter",
        "kvm-clock",
        "hyperv_clocksource_tsc_page",
    ];
    let read = setting("/sys/devices/system/clocksource/clocksource0/current_clocksource");
    let found = match read {
        None => Ok("the system does not say".to_owned()),
        Some(source) if FAST.contains(&source.as_str()) => Ok(source),
        Some(source) => Err(format!(
            "{source}: reading the clock costs a system call or more"
        )),
    };
    let fix = "add clocksource=tsc tsc=reliable to the kernel's command line";
    MachineCheck::new("clock source", found, fix)
}

fn governor() -> MachineCheck {
    let found = match setting("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor") {
        None => Ok("none: this system cannot choose the clock rate".to_owned()),
        Some(governor) if governor == "performance" => Ok(governor),
        Some(governor) => Err(governor),
    };
    let fix = "sudo cpupower frequency-set -g performance";
    MachineCheck::new("CPU governor", found, fix)
}

fn isolation() -> MachineCheck {
    // Isolation is optional, so it never counts as missing.
    let isolated = setting("/sys/devices/system/cpu/isolated");
    let found = isolated.filter(|cpus| !cpus.is_empty());
    let none = "no CPU is isolated (optional: isolcpus=… on the kernel's command line)";
    MachineCheck::new("CPU isolation", Ok(found.unwrap_or(none.to_owned())), "")
}

fn viewer() -> MachineCheck {
    let path = env::var_os("PATH").unwrap_or_default();
    let place = env::split_paths(&path)
        .map(|folder| folder.join(VIEWER))
        .find(|program| program.is_file());
    let shown = place.map(|place| place.display().to_string());
    let found = shown.ok_or("not in PATH".to_owned());
    MachineCheck::new("viewer", found, "pip install rerun-sdk==0.36.3")
}

/// Returns the content of a one-line file of the kernel.
fn setting(path: impl AsRef<Path>) -> Option<String> {
    let text = fs::read_to_string(path).ok()?;
    Some(text.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn section(is_needed: bool, fix: Result<(), &str>) -> Section {
        let (found, fix) = match fix {
            Ok(()) => (Ok("found".to_owned()), ""),
            Err(fix) => (Err("absent".to_owned()), fix),
        };
        Section {
            heading: "for something",
            is_needed,
            checks: vec![
                MachineCheck::new("bus", Ok("carries frames".to_owned()), ""),
                MachineCheck::new("viewer", found, fix),
            ],
        }
    }

    #[test]
    fn what_is_amiss_comes_with_the_command_that_fixes_it() {
        let text = section(true, Err("install it")).text(6);
        let expected = "for something\n  ok       bus     carries frames\n  MISSING  viewer  absent\n\
                                   \x20                  fix: install it";
        assert_eq!(text, expected);
        let text = section(false, Err("install it")).text(6);
        assert!(text.contains("\n  no       viewer  absent\n"), "{text}");
    }

    #[test]
    fn only_what_is_needed_fails() {
        let missing = Err("install it");
        let optional = [section(true, Ok(())), section(false, missing)];
        assert_eq!(exit(&optional, false), Exit::Pass);
        assert_eq!(exit(&optional, true), Exit::BenchFailed);
        let needed = [section(true, missing), section(false, Ok(()))];
        assert_eq!(exit(&needed, false), Exit::BenchFailed);
        assert!(report(&needed).ends_with("Something that is needed is MISSING."));
    }

    /// Without `-a`, `modprobe` reads a second module as a parameter of the first.
    #[test]
    fn several_modules_are_loaded_together() {
        for check in [kernel_can(), private_bus()] {
            let fix = check.fix.unwrap_or_default();
            assert!(!fix.contains("modprobe") || fix.contains("modprobe -a can-raw vcan"));
        }
    }

    #[test]
    fn versions_are_compared_as_numbers() {
        assert!(is_at_least("rustc 1.95.0 (abc 2026-01-01)", "1.95"));
        assert!(is_at_least("rustc 1.100.0-nightly", "1.95"));
        assert!(is_at_least("rustc 2.0.0", "1.95"));
        assert!(!is_at_least("rustc 1.94.9", "1.95"));
        assert!(!is_at_least("nothing", "1.95"));
    }
}
