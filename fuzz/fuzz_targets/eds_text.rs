//! Any bytes as EDS: read or refused, with notes that a page can hold, and a device made of what was read boots.
#![no_main]

use std::time::Duration;

use canopen::{Application, Device, NodeId, eds};
use canrig_fuzz::Journey;
use libfuzzer_sys::fuzz_target;

struct Passive;

impl Application for Passive {}

fuzz_target!(|input: (u8, &[u8])| {
    let (number, bytes) = input;
    let text = eds::text(bytes.to_vec());
    let Ok(sheet) = eds::read(&text, number) else {
        return;
    };
    let notes = sheet.notes.first(usize::MAX);
    assert!(notes.len() <= 1000 && notes.iter().all(|note| note.text.chars().count() < 500));
    let node_id = NodeId::new(number).expect("other numbers are refused");
    if let Ok(device) = Device::new(node_id, sheet.dictionary, Passive) {
        Journey::new(device).pass(Duration::from_millis(5));
    }
});
