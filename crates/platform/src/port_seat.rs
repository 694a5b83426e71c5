//! Process at a port seat ([`crate::seat`]): a law's, or a worker with an FMU.

use std::io;
use std::path::Path;
use std::time::Duration;

use crate::listener::Listener;
use crate::program::{Order, PORTS_VARIABLE, Program, START_PATIENCE, open_seat};
use crate::seat::{
    Header, Kind, MESSAGE_BYTES_MAX, read_answer, read_hello, read_values, write_numbers,
    write_welcome,
};

/// Reason why a process gives no answer.
pub enum NoAnswer {
    /// It ended, or closed its channel without an end: how, and its last output.
    Ended((String, String)),
    /// It took too long.
    Late,
    /// It gave up, with this text.
    GaveUp(String),
    /// It did what no program at a seat does, or cannot be reached.
    Wrong(String),
}

/// Process that was started for a seat.
#[derive(Debug)]
pub struct PortSeat {
    /// The process.
    pub program: Program,
    message: Vec<u8>,
    answer: Vec<u8>,
    /// Number of the latest step, and of the latest one that was answered.
    asked: u32,
    answered: u32,
}

impl PortSeat {
    /// Starts a process for a seat, whose variable is added to its environment. The socket is in the folder `place`, or in the
    /// system's folder for temporary files.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn start(order: &Order<'_>, place: Option<&Path>) -> io::Result<Self> {
        let listener = match place {
            Some(place) => Listener::open_in(place, "s-", 1)?,
            None => open_seat()?,
        };
        let seat = (PORTS_VARIABLE, listener.path().display().to_string());
        let order = Order {
            environment: &[order.environment, &[seat]].concat(),
            ..*order
        };
        Ok(Self {
            program: Program::start(&order, Some(listener))?,
            message: Vec::with_capacity(MESSAGE_BYTES_MAX),
            answer: Vec::with_capacity(MESSAGE_BYTES_MAX),
            asked: 0,
            answered: 0,
        })
    }

    /// Waits for the process, sends it its part, and waits until it is ready. A process that closed its channel has
    /// `closed_patience` to end.
    ///
    /// # Errors
    /// If it is not ready.
    pub fn meet(
        &mut self,
        seed: u64,
        part: &[u8],
        closed_patience: Duration,
    ) -> Result<(), NoAnswer> {
        if !self.program.accept().map_err(unreachable)? {
            let seconds = START_PATIENCE.as_secs();
            let late = || NoAnswer::Wrong(format!("did not come to its seat in {seconds} s"));
            let ended = self.program.ended(Duration::ZERO);
            return Err(ended.map_or_else(late, NoAnswer::Ended));
        }
        read_hello(self.answer(START_PATIENCE, closed_patience)?)
            .map_err(|wrong| NoAnswer::Wrong(format!("spoke what is no HELLO: {wrong}")))?;
        write_welcome(&mut self.message, seed, part);
        self.program.send(&self.message).map_err(unreachable)?;
        let answer = self.answer(START_PATIENCE, closed_patience)?;
        let ready = read_answer(answer, Kind::Done, 0).map_err(|wrong| {
            NoAnswer::Wrong(format!("answered WELCOME with what is no answer: {wrong}"))
        })?;
        ready.map(drop).map_err(NoAnswer::GaveUp)
    }

    /// Waits for an answer. A process that closed its channel has `closed_patience` to end.
    ///
    /// # Errors
    /// If there is none in time, or the process is gone or cannot be reached.
    fn answer(&mut self, patience: Duration, closed_patience: Duration) -> Result<&[u8], NoAnswer> {
        let received = self.program.receive(&mut self.answer, patience);
        if !received.map_err(unreachable)? {
            return Err(NoAnswer::Late);
        }
        if self.answer.is_empty() {
            let closed = || (CLOSED.to_owned(), String::new());
            let ended = self.program.ended(closed_patience);
            return Err(NoAnswer::Ended(ended.unwrap_or_else(closed)));
        }
        Ok(&self.answer)
    }

    /// Sends the values of a step.
    ///
    /// # Errors
    /// If the process is gone, or does not read.
    pub fn step(&mut self, header: Header, period_seconds: f64, reads: &[f64]) -> io::Result<()> {
        self.asked = self.asked.wrapping_add(1);
        let number = self.asked;
        let header = Header { number, ..header };
        write_numbers(&mut self.message, header, Some(period_seconds), reads);
        self.program.send(&self.message)
    }

    /// Waits for the answer to a step, which has `count` values; `None` if a late one to an earlier step has come. A process
    /// that closed its channel has `closed_patience` to end.
    ///
    /// # Errors
    /// If there is none in time, the process gave up, is gone or cannot be reached.
    pub fn values(
        &mut self,
        patience: Duration,
        closed_patience: Duration,
        count: usize,
    ) -> Result<Option<&[u8]>, NoAnswer> {
        self.answer(patience, closed_patience)?;
        self.answered = self.answered.wrapping_add(1);
        let told = read_values(&self.answer, self.answered, count)
            .map_err(|wrong| NoAnswer::Wrong(format!("answered what is no answer: {wrong}")))?;
        let body = told.map_err(NoAnswer::GaveUp)?;
        Ok((self.answered == self.asked).then_some(body))
    }

    /// Asks the process to stop; returns whether it does in time.
    pub fn has_stopped(&mut self, patience: Duration) -> bool {
        Header::of(Kind::Stop).begin(&mut self.message);
        let is_asked = self.program.send(&self.message).is_ok();
        is_asked && self.answer(patience, Duration::ZERO).is_ok()
    }
}

/// Description of a process that closed its channel and does not end then.
pub const CLOSED: &str = "closed its channel";

fn unreachable(error: io::Error) -> NoAnswer {
    NoAnswer::Wrong(format!("cannot be reached: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lockstep::channel;
    use crate::program::tests::ending;

    #[test]
    fn a_late_answer_is_told_from_the_end_of_the_process() {
        let (ours, theirs) = channel().unwrap();
        let mut seat = PortSeat {
            program: ending(None, Some(ours)),
            message: Vec::new(),
            answer: Vec::with_capacity(MESSAGE_BYTES_MAX),
            asked: 1,
            answered: 0,
        };
        let mut answer = |patience| seat.values(patience, START_PATIENCE, 1).map(drop);
        assert!(matches!(answer(Duration::ZERO), Err(NoAnswer::Late)));
        drop(theirs);
        let Err(NoAnswer::Ended((how, _))) = answer(START_PATIENCE) else {
            panic!("it ended");
        };
        assert_eq!(how, "was killed with its keeper");
    }
}
