//! A recorded run of python-canopen as manager of a device made from `drive.eds`: the device still answers the same.
//!
//! In the recording python-canopen found every answer right: boot-up, reads and aborts, heartbeat periods, PDO mapping
//! changed at run time, SYNC with and without counter, a short PDO, loss of its heartbeat and of SYNC, block upload,
//! reset of communication.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::time::Duration;

use can::{CanFrame, Node};
use canopen::{Application, Device, NodeId, Services, sync::Sync};

const RECORDING: &str = include_str!("data/python_canopen_manager.log");

/// Sets the position to ten times the target torque at each SYNC.
struct Echo;

impl Application for Echo {
    fn on_sync(&mut self, services: &mut Services, _sync: &Sync) {
        let torque = services.dictionary().integer(0x6071, 0).unwrap();
        let dictionary = services.dictionary_mut();
        dictionary.set_integer(0x6064, 0, torque * 10).unwrap();
    }
}

fn frame(text: &str) -> CanFrame {
    let (id, data) = text.split_once('#').unwrap();
    let digits = |place: usize| u8::from_str_radix(&data[place..place + 2], 16).unwrap();
    let data: Vec<u8> = (0..data.len()).step_by(2).map(digits).collect();
    CanFrame::new(u16::from_str_radix(id, 16).unwrap(), &data)
}

#[test]
fn device_answers_python_canopen_as_recorded() {
    let mut dictionary = canopen::eds::parse(dbc::DRIVE_EDS, 0x10).unwrap();
    // Statusword and martensite fraction had these defaults at the time of the recording.
    for (index, default) in [(0x6041, 0_u16), (0x2102, 50_000)] {
        let handle = dictionary.find(index, 0).unwrap();
        let mut entry = dictionary.entry(handle).clone();
        entry.default = default.to_le_bytes().to_vec();
        dictionary.insert(entry);
    }
    let node_id = NodeId::new(0x10).unwrap();
    let mut device = Device::new(node_id, dictionary, Echo).unwrap();
    let mut answers = 0;
    for line in RECORDING.lines().filter(|line| !line.starts_with(';')) {
        if let Some(expected) = line.strip_prefix("> ") {
            let sent = device.next_frame().map(|frame| frame.to_string());
            assert_eq!(sent.as_deref(), Some(expected));
            answers += 1;
            continue;
        }
        assert_eq!(device.next_frame(), None, "before {line}");
        let (microseconds, event) = line.split_once(' ').unwrap();
        let now = Duration::from_micros(microseconds.parse().unwrap());
        match event.strip_prefix("< ") {
            Some(text) => device.on_frame(now, &frame(text)),
            None => device.on_tick(now),
        }
    }
    assert!(answers > 100, "the recording has {answers} answers");
}
