//! `canrig new controller`: a controller in another language, with a scenario that it plays as it is, and its test.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use runner::exit::Failure;

use super::{IGNORED, in_new_folder, require_name, write_files};

/// Placeholder in the files for the controller's name.
const NAME: &str = "my_controller";
/// Placeholder in the scenario for the command.
const PROGRAM: &str = "\"PROGRAM\"";
const SCENARIO: &str = include_str!("controller/scenario.toml");
const README: &str = include_str!("controller/README.md");

/// A language.
#[derive(Clone, Copy, Debug, Eq, PartialEq, ValueEnum)]
pub(crate) enum Language {
    /// C99, with canrig.h
    C,
    /// Python, with its standard library
    Python,
}

/// The controller to write.
#[derive(Args, Debug)]
pub(crate) struct ControllerArgs {
    /// Name of the controller and of its scenario: small letters, digits and underscores
    pub name: String,
    /// The language
    #[arg(long, value_enum)]
    pub language: Language,
    /// Folder of the files, which must not be there yet [default: NAME]
    #[arg(long, value_name = "FOLDER")]
    pub path: Option<PathBuf>,
}

impl Language {
    /// Returns the command as it is written in the scenario, and the commands that build and test the controller.
    fn commands(self) -> [&'static str; 3] {
        match self {
            Self::C => ["\"./controller\"", "make", "make test"],
            Self::Python => ["\"python3\", \"controller.py\"", "", "python3 -m unittest"],
        }
    }

    fn files(self) -> [(&'static str, &'static str); 3] {
        match self {
            Self::C => [
                ("controller.c", include_str!("controller/controller.c")),
                ("canrig.h", include_str!("../../../include/canrig.h")),
                ("Makefile", include_str!("controller/Makefile")),
            ],
            Self::Python => [
                ("controller.py", include_str!("controller/controller.py")),
                (
                    "canrig_node.py",
                    include_str!("../../../python/canrig/node.py"),
                ),
                (
                    "test_controller.py",
                    include_str!("controller/test_controller.py"),
                ),
            ],
        }
    }
}

/// Writes the files, and returns the next steps for the user.
pub(super) fn written(args: &ControllerArgs) -> Result<String, Failure> {
    let name = &args.name;
    require_name(name, "controller")?;
    let folder = args.path.clone().unwrap_or_else(|| PathBuf::from(name));
    let [program, build, test] = args.language.commands();
    let renamed = |text: &str| text.replace(NAME, name);
    let built = renamed(README).replace("    BUILD\n", &indented(build));
    let command = program.replace(['"', ','], "");
    let readme = built.replace("TEST", test).replace("COMMAND", &command);
    let skeletons = args.language.files().into_iter();
    let of_language = skeletons.map(|(file, text)| (file.to_owned(), renamed(text)));
    let scenario = renamed(SCENARIO).replace(PROGRAM, program);
    let shared = [
        (format!("{name}.toml"), scenario),
        ("README.md".to_owned(), readme),
        (".gitignore".to_owned(), IGNORED.to_owned()),
    ];
    in_new_folder(&folder, |folder| {
        write_files(folder, of_language.chain(shared))
    })?;
    let folder = folder.display();
    let play = format!("canrig simulate {name}.toml");
    let steps = [build, &play, test].map(|step| match step {
        "" => String::new(),
        step => format!("\n  {step}"),
    });
    Ok(format!(
        "{folder} holds a controller and a scenario. Play and test it:\n  cd {folder}{}",
        steps.concat()
    ))
}

/// Indents a line of a block; an empty line stays empty.
fn indented(line: &str) -> String {
    match line {
        "" => String::new(),
        line => format!("    {line}\n"),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use plan::Plan;
    use worlds::catalogue::catalogue;

    use super::*;

    #[test]
    fn a_controller_is_written_once_and_its_scenario_is_valid() {
        let parent = tempfile::tempdir().unwrap();
        for (language, file) in [
            (Language::C, "canrig.h"),
            (Language::Python, "canrig_node.py"),
        ] {
            let args = ControllerArgs {
                name: "lift".to_owned(),
                language,
                path: Some(parent.path().join(file)),
            };
            let said = written(&args).unwrap();
            assert!(said.contains("canrig simulate lift.toml"), "{said}");
            let folder = parent.path().join(file);
            assert!(folder.join(file).exists());
            // The compiled program is not there yet.
            fs::write(folder.join("controller"), "").unwrap();
            let plan = Plan::load(&folder.join("lift.toml"), catalogue()).unwrap();
            assert_eq!(plan.programs().len(), 1);
            let readme = fs::read_to_string(folder.join("README.md")).unwrap();
            assert!(
                readme.contains("# lift") && !readme.contains("my_"),
                "{readme}"
            );
            let again = written(&args).unwrap_err();
            super::super::tests::require_exists(&again, &folder);
        }
    }
}
