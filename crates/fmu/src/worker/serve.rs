//! The worker's side.

use std::io;
use std::path::Path;

use super::Channel;
use super::protocol::{
    ADVANCE, CANNOT, DONE, END, FAILED, LOAD, MESSAGE_BYTES_MAX, Order, numbers, write,
};
use crate::error::{Fault, FmuError};
use crate::instance::Instance;

/// The loaded FMU, and buffers for its values.
struct Loaded {
    instance: Instance,
    inputs: Vec<f64>,
    outputs: Vec<f64>,
}

/// Loads one FMU and steps it by the messages of the other end, until that end is gone. It runs foreign code, so only a
/// process of its own may call it.
///
/// # Errors
/// The channel failed, or the other end speaks another protocol.
pub fn serve(channel: &mut dyn Channel) -> io::Result<()> {
    let mut message = vec![0; MESSAGE_BYTES_MAX];
    let mut answer = Vec::with_capacity(MESSAGE_BYTES_MAX);
    let mut loaded = None;
    loop {
        let length = channel.receive(&mut message, None)?;
        let Some((what, body)) = message[..length].split_first() else {
            return Ok(());
        };
        match *what {
            LOAD => match load(body) {
                Ok(new) => {
                    write(&mut answer, DONE, new.outputs.iter().copied());
                    loaded = Some(new);
                }
                Err(error) => tell(&mut answer, &error),
            },
            ADVANCE => {
                let loaded = loaded.as_mut().ok_or_else(unknown)?;
                match loaded.advance(&message[..length]) {
                    Ok(()) => write(&mut answer, DONE, loaded.outputs.iter().copied()),
                    Err(error) => tell(&mut answer, &error),
                }
            }
            END => {
                match loaded
                    .take()
                    .map_or(Ok(()), |loaded| loaded.instance.terminate())
                {
                    Ok(()) => write(&mut answer, DONE, std::iter::empty()),
                    Err(error) => tell(&mut answer, &error),
                }
                return channel.send(&answer);
            }
            _ => return Err(unknown()),
        }
        channel.send(&answer)?;
    }
}

fn unknown() -> io::Error {
    io::Error::other("the other end speaks another protocol")
}

fn tell(answer: &mut Vec<u8>, error: &FmuError) {
    let what = if error.fault.is_of_run() {
        FAILED
    } else {
        CANNOT
    };
    answer.clear();
    answer.push(what);
    let text = error.fault.to_string();
    let end = text.floor_char_boundary(MESSAGE_BYTES_MAX - 1);
    answer.extend_from_slice(&text.as_bytes()[..end]);
}

fn load(body: &[u8]) -> Result<Loaded, FmuError> {
    let order: Order = postcard::from_bytes(body).map_err(|error| FmuError {
        file: Default::default(),
        fault: Fault::Worker(format!("was not understood: {error}")),
    })?;
    let (folder, file) = (Path::new(&order.folder), Path::new(&order.file));
    let mut loaded = Loaded {
        instance: Instance::new(folder, file, &order.configuration)?,
        inputs: vec![0.0; order.configuration.inputs.len()],
        outputs: vec![0.0; order.configuration.outputs.len()],
    };
    loaded.instance.read(&mut loaded.outputs)?;
    Ok(loaded)
}

impl Loaded {
    fn advance(&mut self, message: &[u8]) -> Result<(), FmuError> {
        let mut numbers = numbers(message);
        let to_seconds = numbers.next().unwrap_or(f64::NAN);
        for (input, number) in self.inputs.iter_mut().zip(numbers) {
            *input = number;
        }
        self.instance.advance(to_seconds, &self.inputs)?;
        self.instance.read(&mut self.outputs)
    }
}
