//! Any text as DBC: read or refused, and frames of what was read can be decoded, and encoded again.
#![no_main]

use can::CanFrame;
use dbc::Database;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let Ok(database) = Database::parse(text) else {
        return;
    };
    for message in database.messages() {
        let mut builder = database
            .builder(&message.name)
            .expect("it has this message");
        for payload in [[0; 8], [0xFF; 8], *b"\x01\x23\x45\x67\x89\xAB\xCD\xEF"] {
            let frame = CanFrame::from_raw(message.raw_id, message.length_bytes, payload).expect("longer messages are refused");
            let found = database.message_of(&frame).expect("it has this identifier");
            for (signal, value) in found.decode(&frame) {
                let path = format!("{}.{}", message.name, signal.name);
                if let Some(signal) = database.signal(&path) {
                    builder.set(&signal, value);
                }
            }
        }
        assert_eq!(builder.frame().raw_id(), message.raw_id);
    }
});
