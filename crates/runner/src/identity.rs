//! Identity of a run, so that its results are not confused with those of another run.

use std::fs::File;
use std::io;
use std::sync::OnceLock;

use crate::exit::{Exit, Failure};
use judge::verdict::Identity;
use object::Endianness;
use object::elf::{ELF_NOTE_GNU, FileHeader64, NT_GNU_BUILD_ID};
use object::read::ReadCache;
use object::read::elf::{FileHeader, ProgramHeader};
use plan::{Plan, listed};
use recording::session::plan_files;
use scenario::plant::PlantModel;
use scenario::{HASH_SUFFIX, file_hash, hash_in, hexadecimal};
use sha2::{Digest, Sha256};

/// File that this process runs, even if it was replaced meanwhile.
const PROGRAM: &str = "/proc/self/exe";

/// Returns the identity of a run: this program, the plant, the law, and the files as they were read.
///
/// # Errors
/// The program's file cannot be read.
pub fn identity(plan: &Plan) -> Result<Identity, Failure> {
    let unknown = |error| {
        Exit::BenchFailed.because(format!(
            "the program's own file cannot be read ({PROGRAM}: {error}); is /proc mounted?"
        ))
    };
    let hash = |(name, text): (&str, &str)| match name.strip_suffix(HASH_SUFFIX) {
        // An FMU is not among the texts, but its hash is.
        Some(file) => (file.to_owned(), hash_in(text).to_owned()),
        None => (name.to_owned(), hexadecimal(Sha256::digest(text))),
    };
    let trials = plan.loops.iter().map(|one| &one.trial);
    let plants = trials.flat_map(|one| [one.plant()].into_iter().chain(one.plants.values()));
    Ok(Identity {
        program: program().map_err(unknown)?.to_owned(),
        plant: listed(plants.map(PlantModel::name)),
        law: plan.leader(),
        files: plan_files(plan).map(hash).collect(),
    })
}

/// Returns the build ID that the linker wrote into the program, or the hash of its file if there is none. Reads it once.
fn program() -> io::Result<&'static str> {
    static NAME: OnceLock<String> = OnceLock::new();
    if let Some(known) = NAME.get() {
        return Ok(known);
    }
    let name = match build_id(File::open(PROGRAM)?) {
        Some(build_id) => hexadecimal(build_id),
        None => file_hash(File::open(PROGRAM)?)?,
    };
    Ok(NAME.get_or_init(|| name))
}

/// Reads the build ID. The linker computes it from the whole program, so 50 MB need not be read at each start. Only the notes are
/// read: the symbols, which `object::File` would read, too, are megabytes.
fn build_id(program: File) -> Option<Vec<u8>> {
    let file = ReadCache::new(program);
    let header = FileHeader64::<Endianness>::parse(&file).ok()?;
    let endian = header.endian().ok()?;
    let segments = header.program_headers(endian, &file).ok()?;
    let mut notes = segments
        .iter()
        .filter_map(|segment| segment.notes(endian, &file).ok()?)
        .flatten()
        .flatten();
    notes
        .find(|note| note.name() == ELF_NOTE_GNU && note.n_type(endian) == NT_GNU_BUILD_ID)
        .map(|note| note.desc().to_vec())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use worlds::catalogue::catalogue;

    use super::*;

    const TEXT: &str = "schema = 1\nrig = \"sma_actuator\"\nname = \"s\"\nduration_seconds = 2.0\n[controller.pid]\n\
        [[reference.table]]\nfrom_seconds = 0.0\nfile = \"course.csv\"\n";
    const COURSE: &str = "time_seconds,position_millimetres\n0.0,10.0\n1.0,12.0\n";

    fn written_identity(text: &str, course: &str) -> Identity {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.toml");
        fs::write(&path, text).unwrap();
        fs::write(folder.path().join("course.csv"), course).unwrap();
        identity(&Plan::load(&path, catalogue()).unwrap()).unwrap()
    }

    #[test]
    fn whatever_takes_part_is_named_and_a_change_of_it_is_another_identity() {
        let one = written_identity(TEXT, COURSE);
        assert_eq!(one, written_identity(TEXT, COURSE));
        assert_eq!(
            (one.plant.as_str(), one.law.as_str()),
            ("sma_actuator", "pid")
        );
        let names: Vec<_> = one.files.keys().collect();
        assert_eq!(
            names,
            ["course.csv", "rig/sma_actuator.toml", "scenario.toml"]
        );
        // `sha256sum` gives the same.
        assert_eq!(one.files["course.csv"], hexadecimal(Sha256::digest(COURSE)));
        assert!(!one.program.is_empty());
        assert_ne!(one, written_identity(&format!("{TEXT}# more\n"), COURSE));
        assert_ne!(one, written_identity(TEXT, &COURSE.replace("12.0", "12.5")));
    }

    /// The names are those of `readelf -n`, or of `sha256sum` without a build ID.
    #[test]
    fn a_program_is_named_by_its_build_id_or_else_by_its_hash() {
        let path = std::env::current_exe().unwrap();
        if let Some(build_id) = build_id(File::open(&path).unwrap()) {
            assert_eq!(program().unwrap(), hexadecimal(&build_id));
            let note = [
                &[4, 0, 0, 0, 20, 0, 0, 0, 3, 0, 0, 0][..],
                b"GNU\0",
                &build_id,
            ]
            .concat();
            let file = fs::read(&path).unwrap();
            assert!(file.windows(note.len()).any(|part| part == note));
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("script");
        fs::write(&path, COURSE).unwrap();
        assert_eq!(build_id(File::open(&path).unwrap()), None);
        let hash = file_hash(File::open(&path).unwrap()).unwrap();
        assert_eq!(hash, hexadecimal(Sha256::digest(COURSE)));
    }
}
