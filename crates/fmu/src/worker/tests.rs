use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use super::protocol::{ADVANCE, CANNOT, DONE, FAILED, numbers, write};
use super::*;
use crate::Configuration;
use crate::archive::Archive;

/// Behaviour of the other end.
enum Does {
    Answer(Vec<u8>),
    Die,
    Hang,
}

/// A channel whose other end follows a script.
struct Scripted {
    script: VecDeque<Does>,
    sent: Arc<Mutex<Vec<Vec<u8>>>>,
}

impl Channel for Scripted {
    fn send(&mut self, message: &[u8]) -> io::Result<()> {
        self.sent.lock().unwrap().push(message.to_owned());
        Ok(())
    }

    fn receive(&mut self, message: &mut [u8], _: Option<Duration>) -> io::Result<usize> {
        match self.script.pop_front().expect("more was asked") {
            Does::Answer(answer) => {
                message[..answer.len()].copy_from_slice(&answer);
                Ok(answer.len())
            }
            Does::Die => Ok(0),
            Does::Hang => Err(io::ErrorKind::TimedOut.into()),
        }
    }

    fn ended(&mut self) -> (String, String) {
        ("was ended by signal 11".to_owned(), "oh".to_owned())
    }
}

fn done(values: &[f64]) -> Does {
    let mut message = Vec::new();
    write(&mut message, DONE, values.iter().copied());
    Does::Answer(message)
}

fn told(what: u8, text: &str) -> Does {
    Does::Answer([&[what], text.as_bytes()].concat())
}

/// Makes an FMU that is never loaded.
fn unpacked(folder: &std::path::Path) -> crate::Unpacked {
    use std::io::Write;
    let xml = r#"<fmiModelDescription fmiVersion="3.0" modelName="a" instantiationToken="t"><CoSimulation modelIdentifier="a"/></fmiModelDescription>"#;
    let file = folder.join("a.fmu");
    let mut zip = zip::ZipWriter::new(std::fs::File::create(&file).unwrap());
    let options = zip::write::SimpleFileOptions::default();
    zip.start_file("modelDescription.xml", options).unwrap();
    zip.write_all(xml.as_bytes()).unwrap();
    let library = format!(
        "binaries/{}/a.so",
        crate::description::Version::Three.platform()
    );
    zip.start_file(library, options).unwrap();
    zip.finish().unwrap();
    Archive::open(&file).unwrap().unpack().unwrap()
}

/// Loads and steps once; returns the output and the messages that were sent.
fn played(script: impl IntoIterator<Item = Does>) -> Result<(f64, Vec<Vec<u8>>), crate::FmuError> {
    let folder = tempfile::tempdir().unwrap();
    let unpacked = unpacked(folder.path());
    let sent = Arc::new(Mutex::new(Vec::new()));
    let channel = Scripted {
        script: script.into_iter().collect(),
        sent: sent.clone(),
    };
    let configuration = Configuration {
        inputs: vec!["u".to_owned()],
        outputs: vec!["x".to_owned()],
        ..Configuration::default()
    };
    let mut outputs = [0.0];
    let mut remote = Remote::load(Box::new(channel), &unpacked, &configuration, &mut outputs)?;
    remote.advance(0.5, &[2.0], &mut outputs)?;
    let sent = sent.lock().unwrap().clone();
    Ok((outputs[0], sent))
}

#[test]
fn time_and_inputs_go_and_outputs_come() {
    let (output, sent) = played([done(&[0.0]), done(&[7.5])]).unwrap();
    assert_eq!(output, 7.5);
    assert_eq!(sent[1][0], ADVANCE);
    assert_eq!(Vec::from_iter(numbers(&sent[1])), [0.5, 2.0]);
}

#[track_caller]
fn fails(script: impl IntoIterator<Item = Does>, in_run: bool, message: &str) {
    let error = played(script).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("a.fmu: ") && text.contains(message), "{text}");
    assert_eq!(error.fault.is_of_run(), in_run, "{text}");
}

#[test]
fn whatever_becomes_of_the_worker_is_an_error_of_the_run() {
    fails([told(CANNOT, "no function")], false, "no function");
    fails(
        [Does::Die],
        false,
        "was ended by signal 11 while it loaded it; only this run is lost; it said: oh",
    );
    fails(
        [Does::Hang],
        false,
        "it did not return within 60s while it loaded it",
    );
    fails([done(&[0.0]), told(FAILED, "x is NaN")], true, "x is NaN");
    fails(
        [done(&[0.0]), Does::Die],
        true,
        "was ended by signal 11 while it stepped",
    );
    fails(
        [done(&[0.0]), Does::Hang],
        true,
        "within 5s while it stepped; its process was ended",
    );
    fails([done(&[])], false, "answered what is no answer");
    fails([told(99, "")], false, "answered what is no answer");
}

#[test]
fn a_worker_ends_with_its_plant_and_refuses_nonsense() {
    let channel = |script: Vec<Does>| Scripted {
        script: script.into(),
        sent: Arc::default(),
    };
    serve(&mut channel(vec![Does::Die])).unwrap();
    assert!(serve(&mut channel(vec![told(77, "")])).is_err());
    assert!(serve(&mut channel(vec![told(ADVANCE, "")])).is_err());
    let mut confused = channel(vec![told(super::protocol::LOAD, "\u{7f}"), Does::Die]);
    serve(&mut confused).unwrap();
    let sent = confused.sent.lock().unwrap();
    assert_eq!(sent[0][0], CANNOT);
}
