//! Tests on the kernel's own CAN bus. Each runs in its own process and network namespace, so they need no interface, do
//! not interfere with each other, and leave nothing. If the kernel has no CAN, or does not permit namespaces, they are
//! reported as ignored, by name, never as passed; `./run` gives a machine one that has both.
#![expect(
    clippy::unwrap_used,
    clippy::disallowed_methods,
    clippy::print_stderr,
    reason = "tests fail by panicking, wait for processes, and say what they did not do"
)]

mod bench;
mod bus;
#[path = "../../crates/platform/tests/support/counting_allocator.rs"]
mod counting_allocator;
#[path = "../../crates/platform/src/testing.rs"]
mod echo;
mod hardware;
#[path = "../real_time.rs"]
#[expect(dead_code, reason = "these tests return what went wrong")]
mod real_time;
#[path = "../support.rs"]
mod support;

use std::process::{Command, ExitCode};

use libtest_mimic::{Arguments, Failed, Trial};
use platform::probe;

use counting_allocator::CountingAllocator;
use real_time::while_time_flows;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Virtual interface in the namespace of each test.
const INTERFACE: &str = "vcan0";
/// Variable that is set in the process of one test inside its namespace.
const INSIDE: &str = "CANRIG_TEST_INSIDE_NAMESPACE";

type Test = fn() -> Result<(), Failed>;

fn main() -> ExitCode {
    let why_not = cannot_run().err();
    if let Some(why_not) = &why_not {
        eprintln!("tests on vcan are ignored: {why_not}");
    }
    let bus_tests = bus::TESTS.map(|(name, test)| {
        isolated(name, move || {
            test();
            Ok(())
        })
    });
    let bench_tests = bench::TESTS.map(|(name, test)| isolated(name, test));
    let hardware_tests = hardware::TESTS.map(|(name, test)| isolated(name, test));
    let private_bus_tests = bench::PRIVATE_BUS_TESTS.map(|(name, test)| Trial::test(name, test));
    let trials = bus_tests
        .into_iter()
        .chain(bench_tests)
        .chain(hardware_tests)
        .chain(private_bus_tests)
        .map(|trial| trial.with_ignored_flag(why_not.is_some()));
    // Parallel real-time runs would only wait for each other.
    let arguments = Arguments {
        test_threads: Some(1),
        ..Arguments::from_args()
    };
    libtest_mimic::run(&arguments, trials.collect()).exit_code()
}

/// Checks whether the tests can run; the error is the reason why not.
fn cannot_run() -> Result<(), String> {
    if inside() {
        return Ok(());
    }
    probe::kernel_can().map_err(|error| error.to_string())?;
    let made = in_namespace("ip").args(make_interface()).output();
    match made {
        Ok(made) if made.status.success() => Ok(()),
        Ok(made) => Err(String::from_utf8_lossy(&made.stderr).into_owned()),
        Err(error) => Err(format!("unshare (util-linux): {error}")),
    }
}

fn inside() -> bool {
    std::env::var_os(INSIDE).is_some()
}

fn make_interface() -> [&'static str; 5] {
    ["link", "add", INTERFACE, "type", "vcan"]
}

/// Returns a program in its own network namespace. An ordinary user needs a user namespace to make one.
fn in_namespace(program: &str) -> Command {
    let mut unshare = Command::new("unshare");
    if !rustix::process::geteuid().is_root() {
        unshare.arg("--map-root-user");
    }
    unshare.args(["--net", program]);
    unshare
}

/// Runs the test in its own process of this program.
fn isolated(
    name: &'static str,
    test: impl FnOnce() -> Result<(), Failed> + Send + 'static,
) -> Trial {
    Trial::test(name, move || {
        if inside() {
            bus::ip(&make_interface());
            bus::ip(&["link", "set", INTERFACE, "up"]);
            return test();
        }
        let this = std::env::current_exe()?;
        fn text(failed: &Failed) -> &str {
            failed.message().unwrap_or_default()
        }
        let attempt = || {
            let mut test = in_namespace(&this.to_string_lossy());
            let test = test.env(INSIDE, "1").args(["--exact", name]).output()?;
            if test.status.success() {
                return Ok(());
            }
            let [stdout, stderr] =
                [test.stdout, test.stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
            Err(format!("{stdout}\n{stderr}").into())
        };
        while_time_flows(attempt, text)
    })
}
