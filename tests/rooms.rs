//! Separation of the rooms, as ARCHITECTURE.md defines it.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use crate::support::root;

/// Rooms that get a plan as a whole.
const BEHIND_THE_PLAN: [&str; 9] = [
    "worlds",
    "recording",
    "judge",
    "report",
    "exports",
    "runner",
    "campaigns",
    "paper",
    "canrig",
];

/// Rooms that may print: `runner` has the console, and the nodes have their own programs.
const MAY_PRINT: [&str; 5] = ["runner", "campaigns", "paper", "canrig", "xtask"];
/// Code that writes to a terminal directly.
const PRINTS: [&str; 5] = [
    "println!(",
    "eprint!(",
    " print!(",
    "io::stdout()",
    "io::stderr()",
];

/// A package of the workspace.
struct Room {
    name: String,
    folder: PathBuf,
    /// Packages of the workspace in its manifest, without those for tests.
    depends_on: BTreeSet<String>,
}

fn manifest(path: &Path) -> toml::Table {
    fs::read_to_string(path).unwrap().parse().unwrap()
}

/// Returns the members of the workspace, by their folders.
fn members(root: &Path) -> Vec<String> {
    let workspace = &manifest(&root.join("Cargo.toml"))["workspace"];
    workspace["members"].clone().try_into().unwrap()
}

/// Returns the name of the package in a folder.
fn package(folder: &Path) -> String {
    let manifest = manifest(&folder.join("Cargo.toml"));
    manifest["package"]["name"].as_str().unwrap().to_owned()
}

/// A row of the table of rooms in ARCHITECTURE.md.
struct Rule {
    /// Package's name.
    room: String,
    may_depend_on: BTreeSet<String>,
}

/// Returns the rules in ARCHITECTURE.md, from the ground up. Folders that are no members of the workspace have none.
fn rules(root: &Path) -> Vec<Rule> {
    let text = fs::read_to_string(root.join("ARCHITECTURE.md")).unwrap();
    let members = members(root);
    let mut rules: Vec<Rule> = Vec::new();
    for row in text.lines().filter(|line| line.starts_with("| `")) {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let folder = cells[1].trim_matches(['`', '/']);
        if !members.iter().any(|member| member == folder) {
            continue;
        }
        let names = |list: &str| list.split(", ").map(str::to_owned).collect();
        let may_depend_on: BTreeSet<String> = match cells[cells.len() - 2] {
            "–" => BTreeSet::new(),
            list => match list.strip_prefix("all above but ") {
                None if list != "all above" => names(list),
                but => {
                    let others: BTreeSet<String> = but.map(names).unwrap_or_default();
                    let above = rules
                        .iter()
                        .map(|rule| rule.room.clone())
                        .collect::<BTreeSet<_>>();
                    assert!(others.is_subset(&above), "{row}");
                    &above - &others
                }
            },
        };
        rules.push(Rule {
            room: package(&root.join(folder)),
            may_depend_on,
        });
    }
    rules
}

/// Returns the packages of a manifest's table. A key may be another name for its package.
fn packages(manifest: &toml::Table, section: &str) -> Vec<String> {
    let Some(table) = manifest.get(section).and_then(toml::Value::as_table) else {
        return Vec::new();
    };
    let package = |(key, value): (&String, &toml::Value)| {
        let renamed = value.get("package").and_then(toml::Value::as_str);
        renamed.map_or_else(|| key.clone(), str::to_owned)
    };
    table.iter().map(package).collect()
}

/// Returns the members of the workspace by their manifests.
fn rooms(root: &Path) -> Vec<Room> {
    let mut rooms: Vec<Room> = members(root)
        .iter()
        .map(|member| {
            let folder = root.join(member);
            let manifest = manifest(&folder.join("Cargo.toml"));
            let sections = ["dependencies", "build-dependencies"];
            let named = sections.map(|section| packages(&manifest, section));
            Room {
                name: package(&folder),
                folder,
                depends_on: named.concat().into_iter().collect(),
            }
        })
        .collect();
    let names: BTreeSet<String> = rooms.iter().map(|room| room.name.clone()).collect();
    for room in &mut rooms {
        room.depends_on.retain(|name| names.contains(name));
    }
    rooms
}

/// Returns the dependencies in the manifests that the table forbids.
fn forbidden(rooms: &[Room]) -> Vec<String> {
    let rules = rules(&root());
    let arrows = |room: &Room| {
        let Some(rule) = rules.iter().find(|rule| rule.room == room.name) else {
            return vec![format!("{} has no row", room.name)];
        };
        let forbidden = room.depends_on.difference(&rule.may_depend_on);
        forbidden
            .map(|name| format!("{} must not depend on {name}", room.name))
            .collect()
    };
    rooms.iter().flat_map(arrows).collect()
}

/// Member that is an alias of cargo, and not built for users.
const ALIAS: &str = "xtask";

/// If there are several programs, `cargo run` takes the default one of the package.
#[test]
fn cargo_builds_every_program_and_runs_canrig() {
    let root = root();
    let workspace = manifest(&root.join("Cargo.toml"))["workspace"].clone();
    let built: BTreeSet<String> = workspace["default-members"].clone().try_into().unwrap();
    let members = members(&root);
    let is_program = |member: &&String| {
        let has = |place: &str| root.join(member).join(place).exists();
        *member != ALIAS && (has("src/main.rs") || has("src/bin"))
    };
    let programs: BTreeSet<_> = members.iter().filter(is_program).cloned().collect();
    assert_eq!(programs, built);
    let runs = built.iter().filter_map(|member| {
        let package = manifest(&root.join(member).join("Cargo.toml"))["package"].clone();
        Some(package.get("default-run")?.as_str()?.to_owned())
    });
    assert_eq!(runs.collect::<Vec<_>>(), ["canrig"]);
}

#[test]
fn each_room_depends_only_on_the_rooms_it_may() {
    let rooms = rooms(&root());
    assert_eq!(forbidden(&rooms), Vec::<String>::new());
    // Without any dependencies the rules would be empty.
    let arrows: usize = rooms.iter().map(|room| room.depends_on.len()).sum();
    assert!(arrows > 40, "{arrows} arrows");
}

#[test]
fn a_forbidden_arrow_is_found() {
    let mut rooms = rooms(&root());
    let judge = rooms.iter_mut().find(|room| room.name == "judge").unwrap();
    judge.depends_on.insert("worlds".to_owned());
    assert_eq!(forbidden(&rooms), ["judge must not depend on worlds"]);
}

/// The table is ordered: no rule names a later room or its own, so there is no cycle.
#[test]
fn no_rule_makes_a_circle() {
    let mut below = BTreeSet::new();
    for rule in rules(&root()) {
        let wrong: Vec<_> = rule.may_depend_on.difference(&below).collect();
        assert!(wrong.is_empty(), "not above {}: {wrong:?}", rule.room);
        below.insert(rule.room);
    }
}

/// Returns all Rust files below a folder, sorted.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                files.push(path);
            }
        }
    }
    files.sort();
    assert!(!files.is_empty());
    files
}

/// Returns the code lines of a file: without comments, and without the tests at its end.
fn code(text: &str) -> impl Iterator<Item = &str> {
    let tests = ["mod tests", "pub(crate) mod tests"];
    let begins = tests.map(|tests| text.find(&format!("\n#[cfg(test)]\n{tests}")));
    let end = begins.into_iter().flatten().min();
    let lines = text[..end.unwrap_or(text.len())].lines();
    lines.filter(|line| !line.trim_start().starts_with("//"))
}

/// Returns the lines of a file that print.
fn prints(text: &str) -> Vec<&str> {
    let is_print = |line: &&str| PRINTS.iter().any(|print| line.contains(print));
    code(text).filter(is_print).collect()
}

#[test]
fn nothing_below_the_runner_prints() {
    let rooms = rooms(&root());
    let silent = rooms
        .iter()
        .filter(|room| !MAY_PRINT.contains(&room.name.as_str()));
    for room in silent {
        for path in sources(&room.folder.join("src")) {
            // A node's program reports errors on its own standard error.
            if path.ends_with("src/main.rs") || path.ends_with("tests.rs") {
                continue;
            }
            let text = fs::read_to_string(&path).unwrap();
            let printed = prints(&text);
            assert!(printed.is_empty(), "{} prints: {printed:?}", path.display());
        }
    }
}

/// Output goes through one console.
#[test]
fn only_the_console_and_what_prints_data_open_the_terminal() {
    let allowed = [
        "runner/src/console.rs",
        // These write bytes for a pipe: an exported recording, completions, lines of live traffic.
        "runner/src/commands/export.rs",
        "canrig/src/manual.rs",
        "canrig/src/tools/monitor.rs",
        "xtask/src/main.rs",
    ];
    let rooms = rooms(&root());
    let talkative = rooms
        .iter()
        .filter(|room| MAY_PRINT.contains(&room.name.as_str()));
    for room in talkative {
        for path in sources(&room.folder.join("src")) {
            let is_allowed = allowed.iter().any(|end| path.ends_with(end));
            if is_allowed || path.to_string_lossy().contains("/src/new/") {
                continue;
            }
            let text = fs::read_to_string(&path).unwrap();
            let printed = prints(&text);
            assert!(printed.is_empty(), "{} prints: {printed:?}", path.display());
        }
    }
}

#[test]
fn a_print_below_the_runner_is_found() {
    let planted = "fn judge() {\n    println!(\"passed\");\n}\n";
    assert_eq!(prints(planted), ["    println!(\"passed\");"]);
    let harmless = "// println!(\"x\")\nfn f() {}\n\n#[cfg(test)]\nmod tests { fn g() { println!(\"x\"); } }\n";
    assert_eq!(prints(harmless), Vec::<&str>::new());
}

/// Asserts that no source of a package names an item in its code.
#[track_caller]
fn must_not_name(package: &str, name: &str, is_excepted: impl Fn(&Path) -> bool) {
    let rooms = rooms(&root());
    let room = rooms.iter().find(|room| room.name == package).unwrap();
    for path in sources(&room.folder.join("src")) {
        let text = fs::read_to_string(&path).unwrap();
        let names = code(&text).any(|line| line.contains(name));
        assert!(
            !names || is_excepted(&path),
            "{} names {name}",
            path.display()
        );
    }
}

#[test]
fn libraries_of_nodes_do_not_know_the_platform() {
    for package in ["controller", "plant-emulator"] {
        must_not_name(package, "platform::", |_| false);
    }
}

/// A controller that knew the plan would know the plant.
#[test]
fn nodes_do_not_know_the_plan() {
    for package in ["controller", "plant-emulator"] {
        must_not_name(package, "plan::", |_| false);
    }
}

#[test]
fn only_platform_and_the_c_functions_of_fmus_are_unsafe() {
    for package in rules(&root()).into_iter().map(|rule| rule.room) {
        if package != "platform" {
            let calls_c = |path: &Path| {
                let path = path.to_string_lossy();
                ["/fmu/src/library/", "/fmu/src/export/"]
                    .iter()
                    .any(|folder| path.contains(folder))
            };
            must_not_name(&package, "unsafe ", |path| {
                package == "fmu" && calls_c(path)
            });
        }
    }
}

/// The code of an FMU is foreign: only the hidden worker process loads it.
#[test]
fn only_workers_load_fmus_and_libraries() {
    for package in rules(&root()).into_iter().map(|rule| rule.room) {
        must_not_name(&package, "Instance::new(", |path| {
            path.ends_with("worlds/src/fmu_worker.rs") || path.ends_with("worlds/src/law_worker.rs")
        });
        must_not_name(&package, "LawLibrary::load(", |path| {
            path.ends_with("worlds/src/law_worker.rs")
        });
    }
}

/// Behind the plan a run has loops and nodes, of any number and with any names.
#[test]
fn behind_the_plan_no_loop_and_no_node_is_another_than_the_others() {
    let one_of_several = [
        "loops[0]",
        "loops.first()",
        "nodes[0]",
        "nodes.first()",
        "drives[0]",
        "drives.first()",
    ];
    let is_test = |path: &Path| {
        let path = path.to_string_lossy();
        path.ends_with("/tests.rs") || path.contains("/tests/")
    };
    // A controller has all loops, too, but of drives it knows the first of a law.
    for name in &one_of_several[..2] {
        must_not_name("controller", name, is_test);
    }
    for package in BEHIND_THE_PLAN {
        for name in one_of_several {
            must_not_name(package, name, is_test);
        }
        // This is a kind of node, a check of the pre-flight, or a table of scenarios.
        let is_no_node = |path: &Path| {
            let is_test = is_test(path);
            let path = path.to_string_lossy();
            let files = [
                "worlds/src/child.rs",
                "worlds/src/part.rs",
                "preflight/mod.rs",
                "preflight/interview.rs",
                "preflight/heating.rs",
                "stalls.rs",
                "timing.rs",
                "identify/played.rs",
                "new/profile.rs",
                "new/controller.rs",
                "new/name.rs",
            ];
            is_test || files.iter().any(|file| path.ends_with(file))
        };
        for node in ["\"controller\"", "\"drive\""] {
            must_not_name(package, node, is_no_node);
        }
    }
}

#[test]
fn nothing_asks_whether_it_is_simulated() {
    for package in ["controller", "plant-emulator", "canopen"] {
        must_not_name(package, "is_simulat", |_| false);
    }
}

/// A doc comment begins with the noun that the item is, or says what a function does, not with a clause in place of a noun.
#[test]
fn doc_comments_begin_with_what_the_item_is() {
    let clauses = [
        "What", "Who", "Whose", "Whom", "So", "None", "Nobody", "Nothing",
    ];
    let is_doc = |line: &str| line.starts_with("///") || line.starts_with("//!");
    let mut found = Vec::new();
    let folders = rooms(&root()).into_iter().map(|room| room.folder);
    for folder in folders.chain([root().join("tests")]) {
        for path in sources(&folder) {
            let text = fs::read_to_string(&path).unwrap();
            let mut before = "";
            for (number, line) in (1..).zip(text.lines().map(str::trim_start)) {
                let first = line.get(3..).unwrap_or_default().split_whitespace().next();
                let is_clause = first.is_some_and(|first| clauses.contains(&first));
                if is_doc(line) && !is_doc(before) && is_clause {
                    found.push(format!("{}:{number}: {line}", path.display()));
                }
                before = line;
            }
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}
