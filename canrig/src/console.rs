//! What people see while the program works. Nothing here panics when the reader of a pipe is gone.

use std::io::{self, IsTerminal, Write};
use std::panic::PanicHookInfo;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Prints a line on standard output.
pub fn say(text: &str) {
    let _ = writeln!(io::stdout(), "{text}");
}

/// Prints a line on standard error.
pub fn complain(text: &str) {
    let _ = writeln!(io::stderr(), "{text}");
}

/// Tells of a panic in words that help to report it.
pub fn report_panic(info: &PanicHookInfo<'_>) {
    complain(&format!(
        "canrig: internal error: {info}\nThis is a fault of canrig {}; please report it with the command that you typed.",
        env!("CARGO_PKG_VERSION")
    ));
}

/// A line that shows what a computation of unknown length does. It is drawn on a terminal only.
pub struct Activity {
    bar: ProgressBar,
}

impl Activity {
    /// A line without text.
    #[must_use]
    pub fn new(is_shown: bool) -> Self {
        let is_shown = is_shown && io::stderr().is_terminal();
        let target = if is_shown {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::hidden()
        };
        let bar = ProgressBar::with_draw_target(None, target);
        let style = ProgressStyle::with_template("{spinner} {msg}");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
        Self { bar }
    }

    /// Says what is going on.
    pub fn show(&self, text: &str) {
        self.bar.tick();
        self.bar.set_message(text.to_owned());
    }
}

impl Drop for Activity {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// A bar that shows how far a scenario is. It is drawn on a terminal only.
pub struct Progress {
    bar: ProgressBar,
}

impl Progress {
    /// A bar at zero.
    #[must_use]
    pub fn new(duration_seconds: f64, is_shown: bool) -> Self {
        let is_shown = is_shown && io::stderr().is_terminal();
        let target = if is_shown {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::hidden()
        };
        let bar = ProgressBar::with_draw_target(
            Some(micros(Duration::from_secs_f64(duration_seconds))),
            target,
        );
        let style = ProgressStyle::with_template("{bar:40} {percent:>3} %  {msg}");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        Self { bar }
    }

    /// Moves the bar to a scenario time.
    pub fn show(&self, time: Duration) {
        self.bar.set_position(micros(time));
        let message = if time.is_zero() {
            "starting".to_owned()
        } else {
            format!("{:.1} s", time.as_secs_f64())
        };
        self.bar.set_message(message);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}
