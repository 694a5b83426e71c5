//! The name of a plant or a law, of its crate and of its type.

use scenario::custom::Section;
use scenario::registration::is_free;

use runner::exit::{Exit, Failure};

/// Names of crates that Rust or cargo reserves, in addition to Rust's keywords.
const KEPT: [&str; 10] = [
    "alloc",
    "build",
    "core",
    "deps",
    "examples",
    "gen",
    "incremental",
    "proc_macro",
    "std",
    "test",
];

/// Crates that the skeletons depend on, and their other modules and types in small letters.
const TAKEN: [&str; 35] = [
    "bench",
    "box",
    "canopen",
    "canrig",
    "clone",
    "config",
    "controller",
    "copy",
    "cycle",
    "dbc",
    "debug",
    "default",
    "deserialize",
    "err",
    "exit_code",
    "faults",
    "inputs",
    "invalid_plant",
    "json_schema",
    "law",
    "loop_reads",
    "ok",
    "option",
    "plant",
    "plant_emulator",
    "platform",
    "port",
    "ports",
    "result",
    "scenario",
    "schemars",
    "serde",
    "set_point",
    "signal",
    "state",
];

/// Refuses a name that a section's table, a crate or a type cannot have.
pub(super) fn require_crate_name(text: &str, section: Section) -> Result<(), Failure> {
    let refused = |why: &str| Err(Exit::Usage.because(format!("`{text}` {why}")));
    is_free(section, text).map_err(|error| Exit::Usage.because(error))?;
    // A number sticks to the word before it, so `a_1` and `a1` are the same type.
    if text.split('_').any(str::is_empty) {
        return refused("cannot become the name of a type; write single underscores between words");
    }
    let is_keyword = syn::parse_str::<syn::Ident>(text).is_err();
    if is_keyword || KEPT.contains(&text) {
        return refused(
            "has a meaning of its own in Rust, so no crate can have this name; choose another one",
        );
    }
    if TAKEN.contains(&text) {
        return refused("is the name of something that the crate uses; choose another one");
    }
    Ok(())
}

/// Converts `my_plant` to the name of a type, `MyPlant`.
pub(super) fn camel(snake: &str) -> String {
    let word = |word: &str| {
        let (first, rest) = word.split_at(word.len().min(1));
        first.to_uppercase() + rest
    };
    snake.split('_').map(word).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_tables_crates_and_types_differ_from_others() {
        let refused = |text: &str| {
            require_crate_name(text, Section::Plant)
                .err()
                .map(|error| error.to_string())
        };
        assert_eq!(refused("swing_arm_2"), None);
        assert_eq!(camel("swing_arm_2"), "SwingArm2");
        for text in ["pendulum", "a", "pid"] {
            assert_eq!(refused(text), None, "{text}");
        }
        for (text, reason) in [
            ("Pendulum", "cannot be the name of a table"),
            ("my-plant", "cannot be the name of a table"),
            ("../up", "cannot be the name of a table"),
            ("", "cannot be the name of a table"),
            ("heat", "is a table already"),
            ("dc_motor", "is a table already"),
            ("fn", "in Rust"),
            ("while", "in Rust"),
            ("gen", "in Rust"),
            ("test", "in Rust"),
            ("config", "the crate uses"),
            ("a__b", "underscores"),
            ("a_", "underscores"),
        ] {
            assert!(
                refused(text).is_some_and(|refusal| refusal.contains(reason)),
                "{text}"
            );
        }
        assert!(require_crate_name("pid", Section::Controller).is_err());
    }
}
