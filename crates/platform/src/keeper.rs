//! Keeper of a program: a process of this executable that starts the program, keeps its output, and ends it with all its
//! descendants, also after canrig was killed.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{Command, ExitStatus, Stdio};
use std::time::Duration;

use rustix::fs::{OFlags, fcntl_setfl};
use rustix::io::Errno;
use rustix::pipe::{PipeFlags, pipe_with};
use rustix::process::{
    Pid, PidfdFlags, Signal, WaitOptions, getpid, kill_process, kill_process_group, pidfd_open,
    set_child_subreaper, waitpid,
};
use rustix::stdio::stdin;

use crate::clock::monotonic;
use crate::process::{in_new_session, inherit, stat};
use crate::scheduling::pass_on_fifo;
use crate::stop::{OF_TERMINAL, ignore};
use crate::wait::wait_for_any;

/// Hidden subcommand that keeps a program.
pub const SUBCOMMAND: &str = "program-keeper";

/// Variable with the number of a pipe from canrig. The pipe is closed when the program is to end.
const LIFELINE_VARIABLE: &str = "CANRIG_LIFELINE";

/// Time for a program to end after the request, and after SIGTERM.
pub(crate) const STOP_PATIENCE: Duration = Duration::from_secs(3);
pub(crate) const TERM_PATIENCE: Duration = Duration::from_secs(2);

/// Largest kept output of a program.
const LOG_BYTES_MAX: u64 = 16 << 20;
/// Largest part of its last output that is told.
const TOLD_BYTES_MAX: usize = 2_000;
const TOLD_LINES_MAX: usize = 12;
const PART_BYTES: usize = 64 << 10;

/// Index of the parent's number in `/proc/PID/stat` after the process's name (proc(5)).
const PARENT_FIELD: usize = 1;

/// Starts a program, keeps its output in a file, and waits for its end: by itself, or after the end
/// of standard input. Then it removes the file with the program's part. Returns a text that
/// continues "the program", such as "exited with code 0", and in the next lines the last output.
///
/// # Errors
/// If the system refuses.
pub fn keep(
    log: Option<PathBuf>,
    part: Option<PathBuf>,
    command: &[OsString],
) -> io::Result<String> {
    ignore(&OF_TERMINAL)?;
    ignore(&[libc::SIGTERM])?;
    set_child_subreaper(Some(getpid()))?;
    let (output, theirs) = pipe_with(PipeFlags::CLOEXEC)?;
    fcntl_setfl(&output, OFlags::NONBLOCK)?;
    let mut log = Log {
        path: log,
        ..Log::default()
    };
    let how = match start(command, theirs) {
        Ok(program) => {
            let status = wait(program, &output, &mut log)?;
            end_descendants();
            while log.take(&output) {}
            how(status)
        }
        Err(error) => format!("cannot be started: {error}"),
    };
    if let Some(part) = part {
        // A killed canrig cannot remove it; one that lives may have done so.
        let _ = fs::remove_file(part);
    }
    log.finish()?;
    Ok(format!("{how}\n{}", last_lines(&log.end)))
}

fn start(command: &[OsString], output: OwnedFd) -> io::Result<Pid> {
    let [program, arguments @ ..] = command else {
        return Err(io::Error::other("no program is named"));
    };
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null());
    command.stdout(output.try_clone()?).stderr(output);
    in_new_session(&mut command);
    let lifeline = inherit(&mut command, stdin().try_clone_to_owned()?);
    command.env(LIFELINE_VARIABLE, lifeline.to_string());
    pass_on_fifo(&mut command);
    // It is waited for below.
    Ok(Pid::from_child(&command.spawn()?))
}

/// Waits for the program's end; ends it when standard input ends.
fn wait(program: Pid, output: &OwnedFd, log: &mut Log) -> io::Result<ExitStatus> {
    let handle = pidfd_open(program, PidfdFlags::empty())?;
    let mut signals = [(STOP_PATIENCE, Signal::TERM), (TERM_PATIENCE, Signal::KILL)].into_iter();
    let mut following = || {
        let (time, signal) = signals.next()?;
        Some((monotonic() + time, signal))
    };
    // Next signal, with its time.
    let mut next: Option<(Duration, Signal)> = None;
    let (mut is_wanted, mut is_open) = (true, true);
    loop {
        let timeout = next.map(|(time, _)| time.saturating_sub(monotonic()));
        let stdin = stdin();
        // A descriptor that has ended stays readable.
        let fds = [
            Some(handle.as_fd()),
            is_wanted.then_some(stdin),
            is_open.then(|| output.as_fd()),
        ];
        let [has_ended, has_input, has_output] = wait_for_any(fds, timeout)?;
        if has_output {
            is_open = log.take(output);
        }
        if has_ended {
            let waited = waitpid(Some(program), WaitOptions::empty())?;
            let status = waited.map_or(0, |(_, status)| status.as_raw());
            return Ok(ExitStatus::from_raw(status));
        }
        if has_input && !matches!(rustix::io::read(stdin, &mut [0; 64]), Ok(1..)) {
            is_wanted = false;
            next = following();
        }
        if let Some((_, signal)) = next.filter(|(time, _)| *time <= monotonic()) {
            // The poll above sees a program that has ended meanwhile.
            let _ = kill_process_group(program, signal);
            next = following();
        }
    }
}

/// Kills all processes that the program left behind; this process became their parent when the program ended.
fn end_descendants() {
    loop {
        for child in children(getpid().as_raw_nonzero().get().unsigned_abs()) {
            let _ = kill_process(child, Signal::KILL);
        }
        match waitpid(None, WaitOptions::empty()) {
            Ok(_) | Err(Errno::INTR) => {}
            Err(_) => return,
        }
    }
}

/// Returns the child processes of `parent`.
pub(crate) fn children(parent: u32) -> Vec<Pid> {
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    processes
        .filter_map(|entry| entry.file_name().to_str()?.parse().ok())
        .filter_map(Pid::from_raw)
        .filter(|process| stat(*process, PARENT_FIELD) == Some(parent))
        .collect()
}

/// Describes how a process ended.
fn how(status: ExitStatus) -> String {
    let name = |signal| match signal {
        libc::SIGSEGV => " (SIGSEGV: it used memory that is not its own)",
        libc::SIGABRT => " (SIGABRT: it gave up)",
        libc::SIGFPE => " (SIGFPE: it computed what cannot be)",
        libc::SIGILL => " (SIGILL: it ran what is no instruction here)",
        libc::SIGBUS => " (SIGBUS: it used memory that is not there)",
        libc::SIGKILL => " (SIGKILL: somebody ended it, or memory ran out)",
        _ => "",
    };
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("exited with code {code}"),
        (None, Some(signal)) => format!("was ended by signal {signal}{}", name(signal)),
        (None, None) => "ended".to_owned(),
    }
}

/// Kept output of a program.
#[derive(Default)]
struct Log {
    path: Option<PathBuf>,
    file: Option<File>,
    written: u64,
    dropped: u64,
    end: Vec<u8>,
}

impl Log {
    /// Takes a part of the pending output; returns false at the end.
    fn take(&mut self, output: &OwnedFd) -> bool {
        let mut part = [0; PART_BYTES];
        match rustix::io::read(output, &mut part) {
            Ok(length @ 1..) => {
                self.put(&part[..length]);
                true
            }
            Err(Errno::INTR) => true,
            // A program that has ended writes no more.
            Ok(_) | Err(_) => false,
        }
    }

    fn put(&mut self, part: &[u8]) {
        self.end.extend_from_slice(part);
        let too_many = self.end.len().saturating_sub(TOLD_BYTES_MAX);
        self.end.drain(..too_many);
        let room = LOG_BYTES_MAX.saturating_sub(self.written);
        let kept = part.len().min(usize::try_from(room).unwrap_or(usize::MAX));
        let kept = &part[..kept];
        if self.file.is_none() && self.written == 0 {
            self.file = self.path.as_ref().and_then(|path| {
                // A link to a file of the law may have this name.
                let _ = fs::remove_file(path);
                File::create_new(path).ok()
            });
        }
        let is_kept = match &mut self.file {
            Some(file) => file.write_all(kept).is_ok(),
            None => true,
        };
        let kept = if is_kept { kept.len() as u64 } else { 0 };
        self.written += kept;
        self.dropped += part.len() as u64 - kept;
    }

    fn finish(&mut self) -> io::Result<()> {
        match (&mut self.file, self.dropped) {
            (Some(file), dropped @ 1..) => writeln!(file, "\n({dropped} bytes more are not kept)"),
            _ => Ok(()),
        }
    }
}

/// Returns the last lines of an output.
pub fn last_lines(output: &[u8]) -> String {
    let text = String::from_utf8_lossy(output);
    let lines = Vec::from_iter(text.trim().lines());
    lines[lines.len().saturating_sub(TOLD_LINES_MAX)..].join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_output_is_kept_up_to_its_limit_and_its_end_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("law.log");
        let mut log = Log {
            path: Some(path.clone()),
            ..Log::default()
        };
        log.finish().unwrap();
        assert!(!path.exists());
        let line = [b'x'; 1023];
        for number in 0..20_000 {
            log.put(format!("{number}\n").as_bytes());
            log.put(&line);
        }
        log.finish().unwrap();
        let kept = fs::read(&path).unwrap();
        let limit = usize::try_from(LOG_BYTES_MAX).unwrap();
        assert_eq!(&kept[..2], b"0\n");
        let text = String::from_utf8_lossy(&kept[limit..]).into_owned();
        let put = (0..20_000).map(|number: u32| format!("{number}\n").len() + line.len());
        let dropped = put.sum::<usize>() - limit;
        assert_eq!(text, format!("\n({dropped} bytes more are not kept)\n"));
        assert!(last_lines(&log.end).contains("19999"));
        assert!(last_lines(&log.end).len() <= TOLD_BYTES_MAX);
    }
}
