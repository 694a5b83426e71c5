//! Any bytes as a log of candump: refused, or read, and what was read survives being written.
#![no_main]

use recording::log::{Unread, read_cut_log};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Ok((frames, _)) = read_cut_log(bytes) else {
        return;
    };
    let mut written = String::new();
    frames.iter().for_each(|frame| frame.push_to(&mut written));
    assert_eq!(
        read_cut_log(written.as_bytes()).expect("our own log is a log"),
        (frames, Unread::default())
    );
});
