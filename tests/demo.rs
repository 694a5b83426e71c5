//! The demo plays in what the machine has, and overwrites nothing.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Command;

use crate::support::output;

/// Returns a folder with links to these programs, for PATH.
fn only(programs: &[&str], folder: &Path) -> String {
    let path = std::env::var("PATH").unwrap();
    fs::create_dir(folder).unwrap();
    for program in programs {
        let mut folders = std::env::split_paths(&path);
        let place = folders.find_map(|one| Some(one.join(program)).filter(|file| file.exists()));
        symlink(place.unwrap(), folder.join(program)).unwrap();
    }
    folder.display().to_string()
}

fn demo(folder: &Path, path: Option<&str>) -> (Option<i32>, String, String) {
    let mut demo = Command::new(env!("CARGO_BIN_EXE_canrig"));
    demo.arg("demo").current_dir(folder).env("NO_COLOR", "1");
    if let Some(path) = path {
        demo.env("PATH", path);
    }
    output(&mut demo)
}

/// Returns the rows of the table for the values of the step, of the play of a scenario.
fn rows<'a>(text: &'a str, scenario: &str) -> Vec<&'a str> {
    let (_, played) = text
        .split_once(&format!("{scenario} --clock lockstep"))
        .unwrap();
    let rows = played
        .lines()
        .skip_while(|line| !line.starts_with('╞'))
        .skip(1);
    let rows = rows.take_while(|line| line.starts_with('│'));
    let of_step = ["settling_time", "overshoot", "steady_state", "current"];
    let cells = rows.map(|row| row.split(['│', '┆']).map(str::trim));
    let shown = cells.filter_map(|mut cells| {
        let name = cells.nth(1)?;
        of_step
            .iter()
            .any(|start| name.starts_with(start))
            .then(|| cells.next())?
    });
    shown.collect()
}

#[test]
fn the_demo_plays_the_same_law_from_a_file_in_what_the_machine_has() {
    let folder = tempfile::tempdir().unwrap();
    let cases = [
        ("python", None, Some("pid_in_python.toml")),
        ("c", Some(&["cc", "as", "ld"][..]), Some("pid_in_c.toml")),
        ("neither", Some(&[][..]), None),
    ];
    for (name, programs, law) in cases {
        let here = folder.path().join(name);
        fs::create_dir(&here).unwrap();
        let path =
            programs.map(|programs| only(programs, &folder.path().join(format!("{name}-path"))));
        let (code, stdout, stderr) = demo(&here, path.as_deref());
        assert_eq!(code, Some(0), "{name}: {stdout}{stderr}");
        let step = rows(&stdout, "motor_step.toml");
        assert_eq!(step.len(), 4, "{stdout}");
        match law {
            Some(law) => assert_eq!(rows(&stdout, law), step, "{stdout}"),
            None => assert!(
                stdout.contains("3. A law from a file is left out"),
                "{stdout}"
            ),
        }
        for line in stdout
            .lines()
            .filter(|line| line.starts_with("  canrig-demo/"))
        {
            assert!(here.join(line.trim()).exists(), "{line}");
        }
        let (_, next) = stdout.split_once("  cd canrig-demo\n").unwrap();
        assert_eq!(
            next.lines()
                .filter(|line| line.starts_with("  canrig "))
                .count(),
            3
        );
        // Again it is refused, and nothing changes.
        let (code, stdout, stderr) = demo(&here, path.as_deref());
        assert_eq!((code, stdout.as_str()), (Some(2), ""), "{stderr}");
        assert!(stderr.contains("`canrig-demo` is not empty"), "{stderr}");
    }
}
