//! Output of the program while it works. It never panics when the reader of a pipe is gone, and no external text controls the
//! terminal.

use std::borrow::Cow;
use std::fmt;
use std::io::{self, BufWriter, IsTerminal, Write};
use std::panic::PanicHookInfo;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Once, OnceLock, mpsc};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use indicatif::{
    HumanDuration, ProgressBar, ProgressDrawTarget, ProgressFinish, ProgressState, ProgressStyle,
};
use platform::terminal::printable;

use crate::exit::{Exit, Failure};
use recording::frames::LogChanged;
use recording::progress::{LoopProgress, RunProgress};
use recording::work::{PARTS, parts_done};
use report::table::Text;
use scenario::without_colours;

/// First reason why standard output did not accept a text.
static UNPRINTED: OnceLock<String> = OnceLock::new();

/// Returns the reason why a text was not printed on standard output. A reader that has gone needs no more of it, and is no
/// reason.
pub fn unprinted() -> Option<&'static str> {
    keep_error(io::stdout().flush());
    UNPRINTED.get().map(String::as_str)
}

fn keep_error(written: io::Result<()>) {
    if let Err(error) = written
        && error.kind() != io::ErrorKind::BrokenPipe
    {
        let _ = UNPRINTED.set(error.to_string());
    }
}

/// Prints a line on standard output.
pub fn print(text: &str) {
    keep_error(writeln!(io::stdout(), "{}", printable(text)));
}

/// Prints a text with tables, in colours on a terminal.
pub fn print_text(text: &Text) {
    keep_error(write!(io::stdout(), "{text}"));
}

/// Prints bytes on standard output: unchanged, except for a terminal.
pub fn print_bytes(bytes: &[u8]) {
    print_with(|output| output.write_all(bytes));
}

/// Prints a text on standard output that is too long for the memory, or comes bit by bit: unchanged, except for a terminal.
pub fn print_with(write: impl FnOnce(&mut (dyn Write + Send)) -> io::Result<()>) {
    let stdout = io::stdout();
    let is_terminal = stdout.is_terminal();
    let mut lines = PrintableLines::new(&stdout);
    let mut plain = &stdout;
    let output: &mut (dyn Write + Send) = if is_terminal { &mut lines } else { &mut plain };
    let mut output = BufWriter::new(output);
    keep_error(write(&mut output).and_then(|()| output.flush()));
}

/// Output to a terminal. Parts are passed on as whole lines, so that no character is cut.
struct PrintableLines<W> {
    output: W,
    /// Line without its end.
    begun: Vec<u8>,
}

impl<W: Write> PrintableLines<W> {
    fn new(output: W) -> Self {
        let begun = Vec::new();
        Self { output, begun }
    }

    fn pass_on(&mut self, bytes: usize) -> io::Result<()> {
        let text = String::from_utf8_lossy(&self.begun[..bytes]);
        self.output.write_all(printable(&text).as_bytes())?;
        self.begun.drain(..bytes);
        Ok(())
    }
}

impl<W: Write> Write for PrintableLines<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.begun.extend(bytes);
        let end = self.begun.iter().rposition(|byte| *byte == b'\n');
        match end {
            Some(end) => self.pass_on(end + 1)?,
            // Data without lines are not meant for a reader, so a cut character does no harm.
            None if self.begun.len() >= BUFFER_BYTES => self.pass_on(self.begun.len())?,
            None => {}
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.pass_on(self.begun.len())?;
        self.output.flush()
    }
}

/// Prints a line on standard error.
pub fn print_error(text: &str) {
    let _ = writeln!(io::stderr(), "{}", printable(text));
}

/// Prints what is wrong, with the name of the program before it.
pub fn print_problem(problem: impl fmt::Display) {
    print_error(&format!("canrig: {problem}"));
}

/// Prints the failure of a command; returns its exit code.
pub fn failed(failure: Failure) -> Exit {
    match &failure.diagnostic {
        Some(error) => print_diagnostic(error),
        None => print_problem(&failure),
    }
    failure.exit
}

/// Prints an error with the underlined place in the file: in colours and as wide as the terminal, else without line breaks.
fn print_diagnostic(error: &miette::Report) {
    match printable(&without_colours(error.as_ref())) {
        // The remaining escapes are the bench's own: colours.
        Cow::Borrowed(_) if io::stderr().is_terminal() => {
            let _ = writeln!(io::stderr(), "{error:?}");
        }
        shown => print_error(&shown),
    }
}

/// Prints the output of the command line's parser: errors on standard error, the help on standard output.
pub fn print_parsed(error: &clap::Error) {
    let printed = error.print();
    if !error.use_stderr() {
        keep_error(printed);
    }
}

/// Prints a panic with a request to report it. The panic of a changed log is no fault of canrig; it is printed once, although
/// several threads may read the log.
pub fn print_panic(info: &PanicHookInfo<'_>) {
    static CHANGED: Once = Once::new();
    if let Some(changed) = info.payload().downcast_ref::<LogChanged>() {
        CHANGED.call_once(|| print_problem(changed));
        return;
    }
    print_problem(format!(
        "internal error: {info}\nThis is a fault of canrig {}; please report it with the command that you typed.",
        env!("CARGO_PKG_VERSION")
    ));
}

/// Time of work from which on a bar is shown.
const PATIENCE: Duration = Duration::from_secs(2);
/// Time between two moves of its bar.
const WORK_PERIOD: Duration = Duration::from_millis(200);

/// Largest number of bytes that wait for a busy writer.
const BUFFER_BYTES: usize = 64 << 10;

/// Line on work that is done, drawn on a terminal only. It disappears when it is dropped.
pub struct Bar(ProgressBar);

impl Bar {
    /// Makes a bar with some work done before, which does not count for the remaining time.
    fn new(total: Option<u64>, before: u64, template: &str, is_shown: bool) -> Self {
        let parsed = ProgressStyle::with_template(template);
        let style = parsed.unwrap_or_else(|_| ProgressStyle::default_bar());
        let target = if is_shown && io::stderr().is_terminal() {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::hidden()
        };
        let bar = ProgressBar::with_draw_target(total, target)
            .with_style(style.with_key("left", show_eta).with_key("rest", show_rest))
            .with_finish(ProgressFinish::AndClear);
        bar.set_position(before);
        bar.reset_eta();
        Self(bar)
    }

    /// Makes a line without text, on a computation of unknown length.
    pub fn spinner(is_shown: bool) -> Self {
        Self::new(None, 0, "{spinner} {msg}", is_shown)
    }

    /// Makes a bar on the progress of a scenario.
    pub(crate) fn scenario(duration_seconds: f64, is_shown: bool) -> Self {
        let duration = micros(Duration::from_secs_f64(duration_seconds));
        let template = "{bar:10} {percent:>3} %  {eta:>4} left  {msg}";
        Self::new(Some(duration), 0, template, is_shown)
    }

    /// Makes a bar on the number of completed runs; for an unknown total it only counts.
    pub fn runs(total: Option<usize>, before: usize, is_shown: bool) -> Self {
        let total = total.map(|total| total as u64);
        let template = "{bar:40} {pos} of {len} runs{left}";
        Self::new(total, before as u64, template, is_shown)
    }

    /// Makes a bar on the runs of a campaign on other machines: their number, their pace, and the state of the parts.
    pub fn parts(runs: usize, before: usize, is_shown: bool) -> Self {
        let template = "{bar:20} {pos} of {len} runs  {per_sec}  {eta} left  {msg}";
        Self::new(Some(runs as u64), before as u64, template, is_shown)
    }

    /// Moves the bar to a number of runs.
    pub fn show(&self, done: u64) {
        self.0.set_position(done);
    }

    /// Returns the number of runs that it shows.
    pub fn done(&self) -> u64 {
        self.0.position()
    }

    /// Shows a text on the current work.
    pub fn say(&self, text: &str) {
        self.0.tick();
        self.0.set_message(printable(text).into_owned());
    }

    /// Shows the state of a scenario's run.
    pub(crate) fn show_run(&self, reading: &RunProgress) {
        self.0.set_position(micros(reading.time));
        self.0.set_message(state(reading));
    }

    /// Prints a line above the bar.
    pub fn print(&self, text: &str) {
        self.0.suspend(|| print(text));
    }
}

/// Room for the state of a run.
const STATE_BYTES: usize = 64;
/// Columns for the time and the loops, in addition to the lateness of the cycles.
const COLUMNS_OF_LOOPS: usize = 36;

/// Writes the state of a run in 48 columns, so that it fits next to the bar in 80. Numbers stay in their places.
fn state(reading: &RunProgress) -> String {
    if reading.time.is_zero() {
        return "starting".to_owned();
    }
    // The capacity holds the whole text: memory of a text that grew at the end of the heap is not used again, and a run has ten
    // each second.
    let mut text = String::with_capacity(STATE_BYTES);
    text += &format!("{:.1} s", reading.time.as_secs_f64());
    for (place, one) in reading.loops.iter().enumerate() {
        let loop_text = state_of_loop(one);
        if text.len() + loop_text.len() > COLUMNS_OF_LOOPS {
            text += &format!("  and {} more", reading.loops.len() - place);
            break;
        }
        text += &loop_text;
    }
    if let Some(lateness) = reading.lateness {
        text += &format!("  {:5} µs late", lateness.as_micros());
    }
    text
}

/// Writes the position of a loop, and the error if it is the only one.
fn state_of_loop(one: &LoopProgress) -> String {
    let symbol = one.quantities.feedback.unit.symbol();
    let mut text = String::with_capacity(STATE_BYTES);
    if let Some(name) = &one.name {
        text += &format!("  {name}");
    }
    if let Some(position) = one.position {
        text += &format!("  {position:6.2} {symbol}");
    }
    if let (Some(error), None) = (one.error, &one.name) {
        text += &format!("  error {error:+6.2} {symbol}");
    }
    text
}

fn show_eta(state: &ProgressState, output: &mut dyn fmt::Write) {
    // A state that cannot be written is not worth a panic.
    let _ = output.write_str(&eta_text(state.eta()));
}

/// Writes the remaining time after other text. Until a run has ended, it is zero, since it is unknown.
fn eta_text(eta: Duration) -> String {
    if eta.is_zero() {
        String::new()
    } else {
        format!("  {:#} left", HumanDuration(eta))
    }
}

/// Bar on the progress of long work on a recording, and the remaining time. It is drawn on a terminal only, by a separate thread,
/// if the work lasts longer than two seconds.
pub struct WorkBar {
    passes: Arc<AtomicU64>,
    /// End of the channel by whose loss the thread ends; `None` if the bar is not drawn.
    drawn: Option<(mpsc::Sender<()>, JoinHandle<()>)>,
}

impl WorkBar {
    /// Makes the bar of work with this number of passes over the recordings.
    pub fn new(passes: u64, is_shown: bool) -> Self {
        let passes = Arc::new(AtomicU64::new(passes));
        let is_shown = is_shown && io::stderr().is_terminal();
        let drawn = is_shown.then(|| {
            let (ended, end) = mpsc::channel();
            let (expected, before) = (Arc::clone(&passes), parts_done());
            let thread = thread::spawn(move || show_work(&expected, before, &end));
            (ended, thread)
        });
        Self { passes, drawn }
    }

    /// Sets the number of passes, which is known when the recordings have been read.
    pub fn expect(&self, passes: u64) {
        self.passes.store(passes, Ordering::Relaxed);
    }
}

impl Drop for WorkBar {
    fn drop(&mut self) {
        if let Some((ended, thread)) = self.drawn.take() {
            drop(ended);
            // A bar that panicked does not end the work.
            let _ = thread.join();
        }
    }
}

/// Draws the bar until the other end of the channel is dropped.
fn show_work(passes: &AtomicU64, before: u64, end: &mpsc::Receiver<()>) {
    let is_over = |wait| end.recv_timeout(wait) != Err(mpsc::RecvTimeoutError::Timeout);
    if is_over(PATIENCE) {
        return;
    }
    let parts = || passes.load(Ordering::Relaxed) * PARTS;
    let template = "{bar:40} {percent:>3} %  {rest} left";
    let Bar(bar) = Bar::new(Some(parts()), 0, template, true);
    let bar = bar.with_elapsed(PATIENCE);
    while !is_over(WORK_PERIOD) {
        bar.set_length(parts());
        bar.set_position((parts_done() - before).min(parts()));
    }
}

/// Writes the remaining time if the rest takes as long as the completed work. Parts of the work differ, so the pace of the latest
/// one says little.
fn show_rest(state: &ProgressState, output: &mut dyn fmt::Write) {
    let rest = state.len().unwrap_or(0).saturating_sub(state.pos());
    let left = state.elapsed().as_secs_f64() * rest as f64 / state.pos().max(1) as f64;
    let left = Duration::try_from_secs_f64(left).unwrap_or(Duration::MAX);
    // A state that cannot be written is not worth a panic.
    let _ = write!(output, "{:#}", HumanDuration(left));
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    #[test]
    fn what_is_printed_in_parts_is_passed_on_by_lines_and_steers_nothing() {
        let text = "25 °C\n\u{1b}[2J \u{202e}→\nthe end ≤";
        for size in 1..text.len() {
            let mut lines = PrintableLines::new(Vec::new());
            for part in text.as_bytes().chunks(size) {
                lines.write_all(part).unwrap();
            }
            assert!(lines.begun.len() <= size + "the end ≤".len());
            lines.flush().unwrap();
            assert_eq!(String::from_utf8(lines.output).unwrap(), printable(text));
        }
        let mut endless = PrintableLines::new(io::sink());
        io::copy(&mut io::repeat(b'x').take(10 << 20), &mut endless).unwrap();
        assert!(endless.begun.capacity() < 4 * BUFFER_BYTES);
    }

    #[test]
    fn the_state_of_a_run_fits_beside_the_bar() {
        let only = LoopProgress {
            position: Some(34.986),
            error: Some(0.014),
            ..LoopProgress::default()
        };
        let with = |loops: Vec<LoopProgress>| RunProgress {
            time: Duration::from_millis(9_140),
            loops,
            lateness: Some(Duration::from_micros(143)),
        };
        let text = state(&with(vec![only.clone()]));
        assert_eq!(text, "9.1 s   34.99 mm  error  +0.01 mm    143 µs late");
        assert!(text.chars().count() <= 49, "{text}");
        assert_eq!(state(&RunProgress::default()), "starting");
        let open_loop = LoopProgress {
            error: None,
            ..only.clone()
        };
        let text = state(&with(vec![open_loop]));
        assert_eq!(text, "9.1 s   34.99 mm    143 µs late");
        let axes = ["x", "y", "z", "tool"].map(|name| LoopProgress {
            name: Some(name.to_owned()),
            ..only.clone()
        });
        let text = state(&with(axes.to_vec()));
        assert_eq!(
            text,
            "9.1 s  x   34.99 mm  y   34.99 mm  and 2 more    143 µs late"
        );
    }

    #[test]
    fn no_time_is_left_that_nobody_knows() {
        let eta = |bar: &Bar| eta_text(bar.0.eta());
        for bar in [
            Bar::runs(Some(1000), 0, false),
            Bar::runs(Some(1000), 400, false),
        ] {
            bar.show(0);
            assert_eq!(eta(&bar), "");
        }
        assert_eq!(eta_text(Duration::from_secs(30)), "  30s left");
    }
}
