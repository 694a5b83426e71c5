//! Calls the engines' own programs.

use std::io;
use std::process::{Command, Stdio};

use runner::exit::{Exit, Failure};

/// Largest part of a program's error output that a message repeats.
const SAID_CHARACTERS_MAX: usize = 600;

/// Returns the failure of an answer that canrig does not understand.
pub(super) fn unclear(program: &str, said: &str) -> Failure {
    let said = shortened(said);
    Exit::BenchFailed.because(format!(
        "{program} said what canrig does not understand: {said}"
    ))
}

/// Runs a program to its end and returns its output.
pub(super) fn run(program: &str, arguments: &[&str], help: &str) -> Result<String, Failure> {
    let absent = |error: io::Error| {
        Exit::BenchFailed.because(format!("{program} cannot be started ({error}): {help}"))
    };
    let output = Command::new(program)
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .map_err(absent)?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let said = match said.trim() {
            "" => String::from_utf8_lossy(&output.stdout),
            _ => said,
        };
        let (how, said) = (output.status, shortened(said.trim()));
        return Err(Exit::BenchFailed.because(format!("{program} refuses ({how}): {said}")));
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Returns the end of a text, where programs say what is wrong.
fn shortened(said: &str) -> String {
    let skipped = said.chars().count().saturating_sub(SAID_CHARACTERS_MAX);
    let end: String = said.chars().skip(skipped).collect();
    match skipped {
        0 => end,
        _ => format!("… {end}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_program_says_of_its_failure_is_repeated() {
        let help = "is it installed?";
        let error = run("/nowhere/sbatch", &[], help).unwrap_err().to_string();
        assert!(
            error.starts_with("/nowhere/sbatch cannot be started"),
            "{error}"
        );
        assert!(error.ends_with(help), "{error}");
        let error = run("sh", &["-c", "echo queue closed >&2; exit 3"], help)
            .unwrap_err()
            .to_string();
        assert_eq!(error, "sh refuses (exit status: 3): queue closed");
        assert_eq!(run("printf", &["text"], help).unwrap(), "text");
    }
}
