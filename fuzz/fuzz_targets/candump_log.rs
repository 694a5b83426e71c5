//! Any bytes as a log of candump: refused, or read, and what was read survives being written.
#![no_main]

use recording::log::{read_cut_log, read_log, write_log};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = read_log(bytes);
    let Ok((frames, _)) = read_cut_log(bytes) else {
        return;
    };
    let mut written = Vec::new();
    write_log(&mut written, &frames).expect("memory takes it");
    assert_eq!(
        read_log(&written[..]).expect("our own log is valid"),
        frames
    );
});
