use std::io::{Cursor, Write};

use zip::CompressionMethod::Deflated;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use super::*;

const XML: &str = r#"<fmiModelDescription fmiVersion="3.0" modelName="a" instantiationToken="t"><CoSimulation modelIdentifier="a" canHandleVariableCommunicationStepSize="true"/></fmiModelDescription>"#;

fn zipped(entries: &[(&str, &[u8])]) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(Deflated);
    for (name, bytes) in entries {
        zip.start_file(*name, options).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn library() -> String {
    format!("binaries/{}/a.so", Version::Three.platform())
}

/// Writes an FMU to a file, and opens it.
fn archive(folder: &Path, entries: &[(&str, &[u8])]) -> Result<Archive, FmuError> {
    let file = folder.join("a.fmu");
    fs::write(&file, zipped(entries)).unwrap();
    Archive::open(&file)
}

#[test]
fn what_this_machine_needs_is_unpacked_and_gone_at_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let library = library();
    let entries: [(&str, &[u8]); 5] = [
        (DESCRIPTION, XML.as_bytes()),
        (&library, b"elf"),
        ("binaries/x86_64-windows/a.dll", b"pe"),
        ("resources/deep/table.csv", b"1,2"),
        ("sources/a.c", b"int x;"),
    ];
    let archive = archive(folder.path(), &entries).unwrap();
    assert_eq!(archive.platforms.len(), 2);
    let unpacked = archive.unpack().unwrap();
    let place = unpacked.folder().to_owned();
    assert_eq!(fs::read(place.join(&library)).unwrap(), b"elf");
    assert_eq!(
        fs::read(place.join("resources/deep/table.csv")).unwrap(),
        b"1,2"
    );
    assert!(!place.join("sources").exists() && !place.join("binaries/x86_64-windows").exists());
    assert_eq!(description_in(&place).unwrap(), archive.description);
    assert!(library_in(&place, &archive.description).unwrap().is_file());
    drop(unpacked);
    assert!(!place.exists());
}

#[test]
fn another_platform_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let entries: [(&str, &[u8]); 2] = [
        (DESCRIPTION, XML.as_bytes()),
        ("binaries/riscv64-linux/a.so", b"elf"),
    ];
    let error = archive(folder.path(), &entries)
        .unwrap()
        .unpack()
        .err()
        .unwrap();
    let text = error.to_string();
    assert!(
        text.contains("a.fmu: it has no library for this machine"),
        "{text}"
    );
    assert!(text.ends_with("it has riscv64-linux"), "{text}");
    assert!(!error.fault.is_of_run());
}

#[track_caller]
fn refused(bytes: Vec<u8>, message: &str) {
    let fault = read(Cursor::new(bytes)).unwrap_err().to_string();
    assert!(fault.contains(message), "{fault}");
}

#[test]
fn entries_that_climb_out_are_refused() {
    let xml = (DESCRIPTION, XML.as_bytes());
    for name in [
        "../evil",
        "resources/../../evil",
        "/etc/evil",
        "a\\..\\..\\evil",
    ] {
        refused(zipped(&[xml, (name, b"x")]), "leads out of its folder");
    }
}

#[test]
fn a_link_is_refused() {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default();
    zip.add_symlink("resources/out", "/etc", options).unwrap();
    refused(zip.finish().unwrap().into_inner(), "is a link");
}

#[test]
fn what_unpacks_to_more_than_it_says_is_refused_or_cut() {
    // The directory of the file states two gigabytes of zeros.
    let mut bytes = zipped(&[
        (DESCRIPTION, XML.as_bytes()),
        ("resources/zeros", &[0; 1 << 16]),
    ]);
    let size = u32::to_le_bytes(1 << 16);
    let huge = u32::to_le_bytes(0xF000_0000);
    let places =
        Vec::from_iter((0..bytes.len() - 4).filter(|place| bytes[*place..*place + 4] == size));
    assert!(!places.is_empty());
    for place in places {
        bytes[place..place + 4].copy_from_slice(&huge);
    }
    refused(bytes, "unpacks to");
    let long = vec![b' '; usize::try_from(BYTES_MAX).unwrap() + 1];
    refused(zipped(&[(DESCRIPTION, &long)]), "more than");
}

#[test]
fn what_is_no_fmu_is_refused() {
    refused(b"PK".to_vec(), "not a zip file");
    refused(zipped(&[("readme", b"x")]), "has no modelDescription.xml");
    refused(zipped(&[(DESCRIPTION, &[0xFF, 0xFE])]), "not text in UTF-8");
    let error = Archive::open(Path::new("/nowhere/a.fmu"))
        .err()
        .unwrap()
        .to_string();
    assert!(
        error.starts_with("/nowhere/a.fmu: cannot be opened"),
        "{error}"
    );
    assert!(Archive::open(Path::new("/tmp")).is_err());
}

#[test]
fn resources_are_shown_as_each_fmi_wants_them() {
    let folder = Path::new("/tmp/a b");
    assert_eq!(
        resources_in(folder, Version::Two),
        "file:///tmp/a%20b/resources"
    );
    assert_eq!(resources_in(folder, Version::Three), "/tmp/a b/resources/");
}

proptest::proptest! {
    #[test]
    fn any_change_of_a_byte_is_read_or_refused(place in 0_usize..400, byte: u8) {
        let mut bytes = zipped(&[(DESCRIPTION, XML.as_bytes()), (&library(), b"elf")]);
        let place = place % bytes.len();
        bytes[place] = byte;
        let folder = tempfile::tempdir().unwrap();
        let _ = read(Cursor::new(&bytes));
        let _ = unpack_to(Cursor::new(&bytes), folder.path(), "linux64");
    }
}
