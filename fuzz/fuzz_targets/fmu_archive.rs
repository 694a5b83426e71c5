//! Any bytes as the zip file of an FMU: read or refused, and nothing is unpacked outside its folder.
#![no_main]

use std::io::Cursor;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if fmu::archive::read(Cursor::new(bytes)).is_err() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let inner = folder.path().join("inner");
    std::fs::create_dir(&inner).expect("a folder in it");
    let _ = fmu::archive::unpack_to(Cursor::new(bytes), &inner, "linux64");
    let beside = std::fs::read_dir(folder.path()).expect("it is there");
    assert_eq!(beside.count(), 1, "something was unpacked beside its folder");
});
