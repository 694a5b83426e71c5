//! The book and the other pages: each link and path exists, each snippet loads, each command parses, and the worked examples
//! of the metrics have the values that the page says.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use fmu::description::Version;
use plan::Plan;
use scenario::rig::nodes::Rig;
use serde_json::Value;
use toml::Table;

use crate::fmus::motor;
use crate::support::{canrig, output, root};

/// Pages outside the book.
const PAGES: [&str; 5] = [
    "README.md",
    "ARCHITECTURE.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "RELEASE.md",
];
/// Prefixes of paths in a page.
const FOLDERS: [&str; 13] = [
    ".ci/",
    "benches/",
    "canrig/",
    "controller/",
    "crates/",
    "dbc/",
    "docs/",
    "fuzz/",
    "plant-emulator/",
    "python/",
    "scenarios/",
    "tests/",
    "xtask/",
];
/// Placeholders in paths and commands.
const PLACEHOLDERS: [&str; 6] = ["…", "*", "<", "NAME", "{", "[RUN"];
/// Number of blocks of TOML that need a custom plant or law: those of `your-plant.md` and `your-law.md`, and the
/// library and the FMU of `laws-in-any-language.md`.
const OWN_BLOCKS: usize = 7;

pub(crate) struct Page {
    pub(crate) path: PathBuf,
    text: String,
}

/// A block of code with the text after its fence.
struct Block<'a> {
    info: &'a str,
    text: String,
}

impl Page {
    fn read(path: PathBuf) -> Self {
        let text = fs::read_to_string(&path).unwrap();
        Self { path, text }
    }

    /// Returns the blocks of code, and the other lines.
    fn parts(&self) -> (Vec<Block<'_>>, Vec<&str>) {
        let (mut blocks, mut prose) = (Vec::new(), Vec::new());
        let mut lines = self.text.lines();
        while let Some(line) = lines.next() {
            let Some(info) = line.strip_prefix("```") else {
                prose.push(line);
                continue;
            };
            let inside = lines.by_ref().take_while(|line| *line != "```");
            let text = inside.map(|line| format!("{line}\n")).collect();
            blocks.push(Block { info, text });
        }
        (blocks, prose)
    }

    fn blocks(&self) -> Vec<Block<'_>> {
        self.parts().0
    }

    /// Returns the texts between backticks in the other lines.
    fn code_spans(&self) -> Vec<&str> {
        let (_, prose) = self.parts();
        let spans = prose.into_iter().filter(|line| !line.starts_with("    "));
        spans
            .flat_map(|line| line.split('`').skip(1).step_by(2))
            .collect()
    }

    /// Returns the targets of the links and pictures.
    fn links(&self) -> Vec<&str> {
        let (_, prose) = self.parts();
        // Pictures may be in Markdown, or in HTML, which also has one for narrow screens.
        let starts = [("](", ')'), ("src=\"", '"'), ("srcset=\"", '"')];
        let links = prose.into_iter().flat_map(|line| {
            starts.into_iter().flat_map(move |(start, end)| {
                let rests = line.split(start).skip(1);
                rests.filter_map(move |rest| Some(rest.split_once(end)?.0))
            })
        });
        links.collect()
    }

    /// Returns the anchors of headings, as mdBook and GitHub make them.
    fn anchors(&self) -> BTreeSet<String> {
        let (_, prose) = self.parts();
        let headings = prose.into_iter().filter(|line| line.starts_with('#'));
        headings
            .map(|line| anchor(line.trim_start_matches('#').trim()))
            .collect()
    }
}

fn anchor(heading: &str) -> String {
    let kept = |letter: &char| letter.is_alphanumeric() || " _-".contains(*letter);
    let letters: String = heading.to_lowercase().chars().filter(kept).collect();
    letters.replace(' ', "-")
}

fn in_book() -> Vec<Page> {
    let mut paths = Vec::new();
    let mut folders = vec![root().join("docs")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                paths.push(path);
            }
        }
    }
    paths.sort();
    paths.into_iter().map(Page::read).collect()
}

pub(crate) fn pages() -> Vec<Page> {
    let others = PAGES.map(|name| Page::read(root().join(name)));
    others.into_iter().chain(in_book()).collect()
}

pub(crate) fn has_placeholder(text: &str) -> bool {
    PLACEHOLDERS.iter().any(|one| text.contains(one))
}

#[test]
fn every_link_leads_somewhere() {
    let mut count = 0;
    for page in pages() {
        for link in page.links() {
            if link.starts_with("https://") {
                continue;
            }
            count += 1;
            let place = format!("{}: {link}", page.path.display());
            let (file, heading) = link.split_once('#').unwrap_or((link, ""));
            let target = match file {
                "" => page.path.clone(),
                file => page.path.parent().unwrap().join(file),
            };
            assert!(target.exists(), "{place}");
            if page.path.starts_with(root().join("docs")) {
                let target = target.canonicalize().unwrap();
                assert!(
                    target.starts_with(root().canonicalize().unwrap().join("docs")),
                    "{place} leads out of the book"
                );
            }
            if !heading.is_empty() {
                assert!(Page::read(target).anchors().contains(heading), "{place}");
            }
        }
    }
    assert!(count > 100, "{count} links");
}

#[test]
fn the_summary_lists_every_page_once() {
    let book = root().join("docs");
    let summary = Page::read(book.join("SUMMARY.md"));
    let mut listed: Vec<PathBuf> = summary.links().iter().map(|link| book.join(link)).collect();
    listed.sort();
    let pages = in_book().into_iter().map(|page| page.path);
    assert!(
        listed
            .into_iter()
            .eq(pages.filter(|path| *path != summary.path))
    );
}

/// Code and scenarios cite corrections of the paper, `PAPER E3` or `PAPER E3 to E5 and E9`.
#[test]
fn every_cited_erratum_is_on_its_page() {
    let page = fs::read_to_string(root().join("docs/reference/paper.md")).unwrap();
    let mut count = 0;
    for folder in ["controller", "plant-emulator", "crates", "scenarios"] {
        for path in files(&root().join(folder)) {
            let text = fs::read_to_string(path).unwrap_or_default();
            for citation in text.split("PAPER ").skip(1) {
                let cited = citation
                    .split(|c: char| !c.is_alphanumeric() && c != ' ')
                    .next();
                let words = cited.unwrap_or_default().split(' ');
                let is_erratum =
                    |word: &&str| word.starts_with('E') && word[1..].parse::<u8>().is_ok();
                for erratum in words.filter(is_erratum) {
                    assert!(page.contains(&format!("\n| {erratum} | ")), "{erratum}");
                    count += 1;
                }
            }
        }
    }
    assert!(count > 20, "{count} citations");
}

/// Returns all files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    entries
        .flat_map(|path| {
            if path.is_dir() {
                files(&path)
            } else {
                vec![path]
            }
        })
        .collect()
}

#[test]
fn every_path_is_there() {
    let mut count = 0;
    for page in pages() {
        for span in page.code_spans() {
            let path = span.split(' ').next().unwrap_or_default();
            if !FOLDERS.iter().any(|folder| path.starts_with(folder)) || has_placeholder(path) {
                continue;
            }
            count += 1;
            assert!(
                root().join(path).exists(),
                "{}: {path}",
                page.path.display()
            );
        }
    }
    assert!(count > 80, "{count} paths");
}

/// Merges a snippet, which is a part of a scenario, into a complete one.
fn merged(base: &str, part: &str) -> String {
    let text = fs::read_to_string(root().join(base)).unwrap();
    let mut whole: Table = text.parse().unwrap();
    // The limits are not a part of the snippet.
    whole.remove("expect");
    merge(&mut whole, part.parse().unwrap());
    whole.to_string()
}

fn merge(whole: &mut Table, part: Table) {
    for (key, value) in part {
        match (whole.get_mut(&key), value) {
            (Some(toml::Value::Table(whole)), toml::Value::Table(part)) => merge(whole, part),
            (Some(toml::Value::Array(whole)), toml::Value::Array(part)) => whole.extend(part),
            (_, value) => {
                whole.insert(key, value);
            }
        }
    }
}

/// Loads a file as `canrig check` does, next to the files that snippets name.
fn load(folder: &Path, text: &str) -> Result<(), String> {
    let path = folder.join("snippet.toml");
    fs::write(&path, text).unwrap();
    let catalogue = worlds::catalogue::catalogue();
    let loaded = if Rig::is_meant(text) {
        Plan::from_rig(&path, text, catalogue)
    } else {
        Plan::load(&path, catalogue)
    };
    let loaded = loaded.map(drop).map_err(miette_text);
    loaded.map_err(|error| format!("{error}\n{text}"))
}

fn miette_text(error: impl std::fmt::Debug) -> String {
    format!("{error:?}")
}

/// The motor behind its drive, as on the page.
#[test]
fn the_motor_from_another_tool_passes() {
    let folder = tempfile::tempdir().unwrap();
    let mut export = Command::new(env!("CARGO_BIN_EXE_canrig"));
    export.args(["fmu", "--export", "dc_motor", "--output"]);
    let (code, _, stderr) = output(export.arg(folder.path().join("motor.fmu")));
    assert_eq!(code, Some(0), "{stderr}");
    for name in ["motor_rig.toml", "motor_step.toml"] {
        let example = root().join("docs/examples").join(name);
        fs::copy(example, folder.path().join(name)).unwrap();
    }
    let runs = folder.path().join("runs");
    let step = folder.path().join("motor_step.toml");
    let (code, stdout, stderr) = output(canrig(&runs, "simulate").arg(step));
    assert_eq!(code, Some(0), "{stdout}{stderr}");
}

#[test]
fn every_scenario_loads() {
    let folder = tempfile::tempdir().unwrap();
    let course = "time_seconds,current_amperes\n0,0.5\n12,0.5\n";
    fs::write(folder.path().join("golden.csv"), course).unwrap();
    fs::write(
        folder.path().join("nominal_model.toml"),
        "[nominal_model]\n",
    )
    .unwrap();
    let eds = root().join("tests/foreign/servo.eds");
    fs::copy(eds, folder.path().join("servo.eds")).unwrap();
    motor(folder.path(), Version::Three);
    for (page, name) in [
        ("several-drives", "feeder.toml"),
        ("several-drives", "feed_and_press.toml"),
        ("fmu", "motor_rig.toml"),
        ("fmu", "motor_step.toml"),
        ("laws-in-any-language", "pid.py"),
        ("laws-in-any-language", "pid_in_python.toml"),
    ] {
        let example = root().join("docs/examples").join(name);
        let page = Page::read(root().join(format!("docs/{page}.md")));
        assert!(
            page.text.contains(&fs::read_to_string(&example).unwrap()),
            "{name}"
        );
        fs::copy(example, folder.path().join(name)).unwrap();
    }
    let (mut whole, mut parts, mut custom) = (0, 0, 0);
    for page in pages() {
        for block in page.blocks() {
            let text = match block.info {
                "toml" => {
                    whole += 1;
                    block.text
                }
                "toml,fragment" => {
                    parts += 1;
                    merged("scenarios/step.toml", &block.text)
                }
                "toml,fragment,lift" => {
                    parts += 1;
                    merged("docs/examples/lift.toml", &block.text)
                }
                "toml,fragment,rig" => {
                    parts += 1;
                    merged("docs/examples/feed_and_press.toml", &block.text)
                }
                "toml,fragment,fmu" => {
                    parts += 1;
                    merged("docs/examples/motor_step.toml", &block.text)
                }
                "toml,fragment,python" => {
                    parts += 1;
                    merged("docs/examples/pid_in_python.toml", &block.text)
                }
                "toml,fragment,own" => {
                    custom += 1;
                    continue;
                }
                info => {
                    assert!(!info.starts_with("toml"), "{}: {info}", page.path.display());
                    continue;
                }
            };
            let place = page.path.display();
            load(folder.path(), &text).unwrap_or_else(|error| panic!("{place}: {error}"));
        }
    }
    assert!(
        whole >= 3 && parts >= 10,
        "{whole} scenarios, {parts} parts"
    );
    assert_eq!(custom, OWN_BLOCKS);
}

/// Returns the commands of canrig on a page: in shell blocks and indented ones, after the prompt if the block has output, and in
/// README's table.
pub(crate) fn commands(page: &Page) -> Vec<String> {
    let mut commands = Vec::new();
    for block in page.blocks() {
        let lines = block.text.lines();
        match block.info {
            "sh" => commands.extend(lines.map(str::to_owned)),
            "console" | "text" => {
                commands.extend(lines.filter_map(|line| Some(line.strip_prefix("$ ")?.to_owned())));
            }
            _ => {}
        }
    }
    let (_, prose) = page.parts();
    let indented = prose.iter().filter_map(|line| line.strip_prefix("    "));
    commands.extend(indented.map(str::to_owned));
    if page.path.ends_with("README.md") {
        commands.extend(page.code_spans().into_iter().map(str::to_owned));
    }
    commands
}

/// Returns the arguments of a command of canrig; `None` for another program.
pub(crate) fn arguments(command: &str) -> Option<Vec<&str>> {
    let command = command.split(['#', '>', '|']).next()?.trim();
    let rest = command
        .strip_prefix("canrig ")
        .or_else(|| command.strip_prefix("cargo run --release -- "))?;
    Some(
        ["canrig"]
            .into_iter()
            .chain(rest.split_whitespace())
            .collect(),
    )
}

#[test]
fn every_command_parses() {
    let mut count = 0;
    for page in pages() {
        for command in commands(&page) {
            let Some(arguments) =
                arguments(&command).filter(|_| !has_placeholder(&command.replace("/*", "")))
            else {
                continue;
            };
            count += 1;
            let parsed = canrig::command().try_get_matches_from(arguments);
            let place = page.path.display();
            parsed.unwrap_or_else(|error| panic!("{place}: {command}\n{error}"));
        }
    }
    assert!(count > 50, "{count} commands");
}

/// Each command has a section in the reference.
#[test]
fn every_command_is_described() {
    let page = Page::read(root().join("docs/reference/commands.md"));
    let lines = page.text.lines();
    let headings = Vec::from_iter(lines.filter(|line| line.starts_with("### "))).join(" ");
    for command in canrig::command()
        .get_subcommands()
        .filter(|one| !one.is_hide_set())
    {
        let name = command.get_name();
        assert!(headings.contains(&format!("`canrig {name}")), "{name}");
    }
}

/// Each error code that a node may send is on its page.
#[test]
fn every_emergency_is_described() {
    let page = Page::read(root().join("docs/reference/emergencies.md"));
    let source = fs::read_to_string(root().join("crates/canopen/src/emcy.rs")).unwrap();
    let codes = source.lines().filter_map(|line| {
        let (_, code) = line.trim().split_once(": Self = Self(")?;
        code.strip_suffix(");")
    });
    let codes = Vec::from_iter(codes);
    assert!(codes.len() > 10, "{codes:?}");
    for code in codes {
        assert!(page.text.contains(&format!("| `{code}` |")), "{code}");
    }
}

/// Checks the exit code and the values of an example, as the page states them.
#[track_caller]
fn check(example: &str, exit: i32, expected: &[(&str, f64)]) {
    let place = root().join("docs/examples/metrics").join(example);
    let mut canrig = Command::new(env!("CARGO_BIN_EXE_canrig"));
    let canrig = canrig.arg("replay").arg(place.with_extension("log"));
    let scenario = place.with_extension("toml");
    let (code, stdout, stderr) = output(canrig.arg("--json").arg("--scenario").arg(scenario));
    assert_eq!(code, Some(exit), "{stderr}");
    let verdict: Value = serde_json::from_str(&stdout).unwrap();
    let metrics = verdict["metrics"].as_array().unwrap();
    for (name, value) in expected {
        let metric = metrics.iter().find(|metric| metric["name"] == *name);
        let measured = metric.and_then(|metric| metric["value"].as_f64());
        // The page shows this number of digits.
        let is_same =
            measured.is_some_and(|measured| (measured - value).abs() <= 5e-4 * value.abs());
        assert!(is_same, "{example}: {name} is {measured:?} and not {value}");
    }
}

#[test]
fn the_worked_examples_are_right() {
    let window = "from 1 to 2 s";
    let step = [
        ("settling_time_seconds", 0.6),
        ("overshoot_percent", 6.0),
        ("steady_state_error_millimetres", 0.06),
        ("tracking_error_millimetres_rms", 6.221),
        ("position_millimetres_max", 31.2),
        ("current_amperes_rms", 0.6727),
        ("missed_cycles_percent", 0.0),
        ("bus_load_percent", 0.2638),
        ("sync_interval_milliseconds_max", 104.0),
        (&format!("position_millimetres stays {window}"), 31.2),
        (
            &format!("position_millimetres reaches 29.95 to 30.05 {window} within seconds"),
            0.7,
        ),
        (
            &format!("position_millimetres rate_per_second {window}"),
            -6.0,
        ),
        (
            "the load rises, 2: position_millimetres 29 to 31 for 200 ms within milliseconds",
            600.0,
        ),
    ];
    check("step", 1, &step);
    let sine = [
        ("sine_gain", 0.7616),
        ("sine_phase_degrees", -23.2),
        ("sine_offset_millimetres", 0.5),
        ("tracking_error_millimetres_rms", 3.0822),
    ];
    check("sine", 0, &sine);
    let sines = [
        ("sine_gain", 1.2),
        ("sine_phase_degrees", -23.2),
        ("sine_offset_millimetres", 1.0),
        ("tracking_error_millimetres_rms", 3.0822),
    ];
    check("sines", 0, &sines);
    check(
        "chirp",
        0,
        &[
            ("bandwidth_hertz", 0.9682),
            ("bandwidth_with_mean_hertz", 0.9682),
        ],
    );
    let load = [
        ("maximum_deviation_millimetres", 1.4),
        ("recovery_time_seconds", 0.7),
    ];
    check("load", 0, &load);
    let fault = [
        ("temperature_celsius", 71.5),
        ("current_zero_within_milliseconds", 50.0),
        ("safe_state", 1.0),
        ("emcy", 0.0),
        ("no_event", 0.0),
    ];
    check("fault", 5, &fault);
}
