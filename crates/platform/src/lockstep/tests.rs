use std::collections::VecDeque;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::Duration;

use canopen::{CanFrame, Filter, Progress};
use rustix::net::SendFlags;

use super::protocol::*;
use super::remote::receive_packet;
use super::*;
use crate::bus::{Bus, BusError};
use crate::test_nodes::Echo;

const MS: Duration = Duration::from_millis(1);

fn ms(value: u32) -> Duration {
    MS * value
}

fn ping(byte: u8) -> CanFrame {
    CanFrame::new(0x100, &[byte])
}

/// An echo in a thread and the coordinator's view of it.
fn remote_echo() -> (Remote, JoinHandle<Result<(), FollowError>>) {
    let (ours, theirs) = channel().unwrap();
    let echo = std::thread::spawn(move || follow(&mut Echo::new(MS), theirs, None::<&mut dyn Bus>));
    (Remote::accept("echo", ours).unwrap(), echo)
}

fn step(
    participant: &mut dyn Participant,
    to: Duration,
    frames: &[(Duration, CanFrame)],
) -> Result<Answer, LockstepError> {
    let mut answer = Answer::default();
    participant.advance(to, to, frames, &mut answer)?;
    Ok(answer)
}

fn stop(participant: &mut dyn Participant, at: Duration) -> Answer {
    let mut answer = Answer::default();
    participant.stop(at, &mut answer).unwrap();
    answer
}

/// Steps a participant through a fixed story.
fn story(participant: &mut dyn Participant) -> Vec<Answer> {
    let delivered = [(MS / 2, ping(1)), (MS, ping(2)), (MS, ping(3))];
    vec![
        step(participant, Duration::ZERO, &[]).unwrap(),
        step(participant, ms(2), &delivered).unwrap(),
        step(participant, ms(2), &[(ms(2), ping(4))]).unwrap(),
        stop(participant, ms(3)),
    ]
}

#[test]
fn remote_and_local_answer_alike() {
    let mut node = Echo::new(MS);
    let local = story(&mut Local::new("echo", &mut node));
    let (mut remote, echo) = remote_echo();
    assert_eq!(
        remote.filters(),
        [Filter::exact(0x100), Filter::exact(0x1FF)]
    );
    assert_eq!(remote.next_deadline(), Some(Duration::ZERO));
    assert_eq!(story(&mut remote), local);
    assert_eq!(remote.next_deadline(), local[3].next_deadline);
    echo.join().unwrap().unwrap();
}

#[test]
fn frames_come_before_a_tick_at_the_same_time_and_after_an_earlier_one() {
    let mut node = Echo::new(MS);
    let answers = story(&mut Local::new("echo", &mut node));
    let ids: Vec<_> = answers[1]
        .frames
        .iter()
        .map(|(at, frame)| (at.as_micros(), frame.standard_id().unwrap()))
        .collect();
    assert_eq!(
        ids,
        [
            (500, 0x101),
            (1000, 0x101),
            (1000, 0x101),
            (1000, 0x200),
            (2000, 0x200)
        ]
    );
    assert_eq!(answers[1].next_deadline, Some(ms(3)));
    assert_eq!(answers[2].frames, [(ms(2), CanFrame::new(0x101, &[4]))]);
    assert_eq!(answers[3].progress, Progress::Stopped);
}

#[test]
fn impossible_steps_are_errors() {
    let mut node = Echo::new(MS);
    let mut local = Local::new("echo", &mut node);
    let error = step(&mut local, ms(2), &[(ms(3), ping(0))])
        .unwrap_err()
        .to_string();
    assert_eq!(
        error,
        "echo could not be stepped: frame 100#00 at 3ms is out of order in the step from 0ns to 2ms"
    );
    step(&mut local, ms(5), &[]).unwrap();
    let error = step(&mut local, ms(4), &[]).unwrap_err().to_string();
    assert_eq!(
        error,
        "echo could not be stepped: time would go back from 5ms to 4ms"
    );
}

#[test]
fn a_deadline_that_does_not_move_is_an_error_and_not_a_hang() {
    let mut node = Echo::new(Duration::ZERO);
    let mut local = Local::new("echo", &mut node);
    let error = step(&mut local, ms(2), &[]).unwrap_err();
    assert!(matches!(
        error,
        LockstepError::Step {
            source: StepError::Stuck { .. },
            ..
        }
    ));
}

#[test]
fn more_frames_than_an_answer_holds_is_an_error() {
    let mut node = Echo::new(Duration::from_micros(1));
    let mut local = Local::new("echo", &mut node);
    assert!(matches!(
        step(&mut local, ms(3), &[]),
        Err(LockstepError::Step {
            source: StepError::TooManyFrames,
            ..
        })
    ));
}

#[test]
fn a_failed_node_says_why_on_both_sides() {
    let (mut remote, echo) = remote_echo();
    let answer = step(&mut remote, MS, &[(MS, CanFrame::new(0x1FF, &[]))]).unwrap();
    assert_eq!(
        answer.progress,
        Progress::Failed("the echo was ordered to fail".into())
    );
    let error = echo.join().unwrap().unwrap_err();
    assert_eq!(error.to_string(), "the echo was ordered to fail");
}

#[test]
fn a_step_that_the_remote_node_cannot_do_is_its_failure() {
    let (mut remote, echo) = remote_echo();
    let Progress::Failed(text) = step(&mut remote, ms(2), &[(ms(3), ping(0))])
        .unwrap()
        .progress
    else {
        panic!("an impossible step was answered");
    };
    assert!(text.contains("out of order"), "{text}");
    assert!(matches!(
        echo.join().unwrap(),
        Err(FollowError::Step(StepError::FrameOutOfOrder { .. }))
    ));
}

#[test]
fn a_dead_process_is_named() {
    let (ours, theirs) = channel().unwrap();
    drop(theirs);
    let error = Remote::accept("controller", ours).err().unwrap();
    assert!(matches!(error, LockstepError::Ended { .. }));
    assert_eq!(
        error.to_string(),
        "controller ended before it answered; see the end of its log"
    );

    let (ours, theirs) = channel().unwrap();
    send(&theirs, &hello_packet());
    let mut remote = Remote::accept("controller", ours).unwrap();
    drop(theirs);
    assert!(matches!(
        step(&mut remote, MS, &[]),
        Err(LockstepError::Ended { .. })
    ));
}

#[test]
fn a_process_that_dies_in_the_middle_of_a_step_is_named() {
    let (ours, theirs) = channel().unwrap();
    send(&theirs, &hello_packet());
    let mut remote = Remote::accept("controller", ours).unwrap();
    let dying =
        std::thread::spawn(move || receive_packet(&theirs, &mut Vec::with_capacity(PACKET_MAX)));
    let error = step(&mut remote, MS, &[]).unwrap_err();
    assert!(matches!(error, LockstepError::Ended { .. }), "{error}");
    dying.join().unwrap().unwrap();
}

#[test]
fn a_silent_process_is_named() {
    let (ours, theirs) = channel().unwrap();
    send(&theirs, &hello_packet());
    let mut remote = Remote::accept_within("plant", ours, ms(30)).unwrap();
    let error = step(&mut remote, MS, &[]).unwrap_err();
    assert!(
        matches!(error, LockstepError::NoAnswer { .. }),
        "{error}: not the right error"
    );
    drop(theirs);
}

#[test]
fn a_coordinator_that_dies_ends_the_process() {
    let (remote, echo) = remote_echo();
    drop(remote);
    assert!(matches!(
        echo.join().unwrap(),
        Err(FollowError::CoordinatorGone)
    ));
}

#[test]
fn malformed_answers_are_errors() {
    let mut done = Vec::new();
    let answer = Answer {
        frames: vec![(MS, ping(1))],
        next_deadline: None,
        reached: MS,
        progress: Progress::Running,
    };
    encode_done(&mut done, &answer).unwrap();
    let decode = |packet: &[u8]| {
        let mut decoded = story(&mut Local::new("echo", &mut Echo::new(MS))).remove(1);
        decode_done(packet, &mut decoded).map(|()| decoded)
    };
    assert_eq!(decode(&done), Ok(answer));
    for end in 0..done.len() {
        assert!(
            matches!(decode(&done[..end]), Err(ProtocolError::TooShort { .. })),
            "cut at {end}"
        );
    }
    let with = |index: usize, value: u8| {
        let mut packet = done.clone();
        packet[index] = value;
        decode(&packet).unwrap_err().to_string()
    };
    assert_eq!(with(0, 9), "message kind 9 where done was due");
    assert_eq!(with(1, 7), "progress is 7");
    assert_eq!(with(2, 2), "the message ends too early (41 bytes)");
    assert_eq!(with(2, 0), "the message has 21 bytes too many");
    assert_eq!(with(3, 0xFF), "65281 frames (limit 2048)");
    assert_eq!(with(32, 9), "frame length is 9");
}

#[test]
fn malformed_requests_end_the_process_with_an_error() {
    for garbage in [&[2, 0][..], &[7; 40], &[2; 5000]] {
        let (ours, theirs) = channel().unwrap();
        send(&ours, garbage);
        let error = follow(&mut Echo::new(MS), theirs, None).unwrap_err();
        assert!(matches!(error, FollowError::Protocol(_)), "{error}");
    }
}

#[test]
fn another_version_is_refused() {
    let mut packet = hello_packet();
    packet[1] = 77;
    let (ours, theirs) = channel().unwrap();
    send(&theirs, &packet);
    let error = Remote::accept("plant", ours).err().unwrap().to_string();
    assert!(error.contains("protocol version 77, ours is 2"), "{error}");
}

#[test]
fn the_largest_step_fits_one_packet() {
    let frames = vec![(MS, ping(1)); FRAMES_MAX];
    let mut node = Echo::new(MS);
    node.deadline = ms(100);
    let (ours, theirs) = channel().unwrap();
    let echo = std::thread::spawn(move || follow(&mut node, theirs, None));
    let mut remote = Remote::accept("echo", ours).unwrap();
    assert_eq!(
        step(&mut remote, MS, &frames).unwrap().frames.len(),
        FRAMES_MAX
    );
    stop(&mut remote, MS);
    echo.join().unwrap().unwrap();
    assert!(matches!(
        step(&mut remote, MS, &[frames, vec![(MS, ping(2))]].concat()),
        Err(LockstepError::Protocol { .. })
    ));
}

/// A wire whose frames come from a channel of the test.
struct TestWire {
    incoming: mpsc::Receiver<CanFrame>,
    waiting: OwnedFd,
}

impl Bus for TestWire {
    fn send(&mut self, _frame: &CanFrame) -> Result<(), BusError> {
        panic!("a follower never sends on the wire");
    }

    fn receive(&mut self, timeout: Duration) -> Result<Option<CanFrame>, BusError> {
        Ok(self.incoming.recv_timeout(timeout.min(ms(100))).ok())
    }

    fn as_fd(&self) -> BorrowedFd<'_> {
        self.waiting.as_fd()
    }

    fn dropped(&self) -> u64 {
        0
    }

    fn delayed(&self) -> u64 {
        0
    }
}

/// Announces one ping to an echo whose own 0x100 frames come back, with these frames on the wire.
fn announced_with(
    on_wire: &[CanFrame],
) -> (Result<Answer, LockstepError>, Result<(), FollowError>) {
    let (sender, incoming) = mpsc::channel();
    on_wire
        .iter()
        .for_each(|frame| sender.send(*frame).unwrap());
    let (ours, theirs) = channel().unwrap();
    let echo = std::thread::spawn(move || {
        let mut wire = TestWire {
            incoming,
            waiting: channel().unwrap().0,
        };
        let mut node = Echo::new(MS);
        follow(&mut node, theirs, Some(&mut wire))
    });
    let mut remote = Remote::accept("echo", ours).unwrap();
    let answer = step(&mut remote, MS / 2, &[(MS / 2, ping(1))]);
    drop(remote);
    (answer, echo.join().unwrap())
}

#[test]
fn the_wires_copy_reaches_the_node() {
    let (answer, _) = announced_with(&[ping(1)]);
    assert_eq!(
        answer.unwrap().frames[1],
        (MS / 2, CanFrame::new(0x101, &[1]))
    );
}

#[test]
fn a_different_frame_on_the_wire_is_an_error() {
    let (answer, outcome) = announced_with(&[ping(2)]);
    let text =
        "frame 100#01 was announced but 100#02 arrived: is another program sending on this bus?";
    assert!(matches!(answer, Err(LockstepError::Ended { .. })));
    assert_eq!(outcome.unwrap_err().to_string(), text);
}

#[test]
fn a_frame_missing_on_the_wire_is_an_error() {
    let (answer, outcome) = announced_with(&[]);
    let text = "frame 100#01 was announced but nothing arrived within 10 s";
    assert!(matches!(answer, Err(LockstepError::Ended { .. })));
    assert_eq!(outcome.unwrap_err().to_string(), text);
}

fn hello_packet() -> Vec<u8> {
    let mut packet = Vec::new();
    let hello = Hello {
        filters: vec![Filter::ALL],
        silent_filters: vec![Filter::exact(0x210)],
        next_deadline: None,
    };
    encode_hello(&mut packet, &hello).unwrap();
    assert_eq!(decode_hello(&packet), Ok(hello));
    packet
}

fn send(channel: &OwnedFd, packet: &[u8]) {
    rustix::net::send(channel, packet, SendFlags::NOSIGNAL).unwrap();
}

#[test]
fn own_frames_that_come_back_are_not_delivered() {
    struct Talker(VecDeque<CanFrame>, Vec<CanFrame>, Option<Duration>);
    impl canopen::Node for Talker {
        fn filters(&self) -> Vec<Filter> {
            vec![Filter::ALL]
        }
        fn on_frame(&mut self, _now: Duration, frame: &CanFrame) {
            self.1.push(*frame);
        }
        fn on_tick(&mut self, _now: Duration) {
            self.2 = None;
        }
        fn on_stop(&mut self, _now: Duration) {}
        fn next_frame(&mut self) -> Option<CanFrame> {
            self.0.pop_front()
        }
        fn next_deadline(&self) -> Option<Duration> {
            self.2
        }
        fn progress(&self) -> Progress {
            if self.1.is_empty() {
                Progress::Running
            } else {
                Progress::Stopped
            }
        }
    }
    let (sender, incoming) = mpsc::channel();
    let (ours, theirs) = channel().unwrap();
    let talker = std::thread::spawn(move || {
        let mut wire = TestWire {
            incoming,
            waiting: channel().unwrap().0,
        };
        let mut node = Talker([ping(1), ping(2)].into(), vec![], Some(Duration::ZERO));
        follow(&mut node, theirs, Some(&mut wire)).map(|()| node.1)
    });
    let mut remote = Remote::accept("talker", ours).unwrap();
    let queued = step(&mut remote, Duration::ZERO, &[]).unwrap().frames;
    assert_eq!(queued.len(), 2);
    // The coordinator puts its frames on the wire in another order, then another node's.
    for frame in [ping(2), ping(1), ping(9)] {
        sender.send(frame).unwrap();
    }
    step(&mut remote, MS, &[(MS, ping(9))]).unwrap();
    assert_eq!(talker.join().unwrap().unwrap(), [ping(9)]);
}

/// The echo sends 0x200 each millisecond; somebody may answer that or not.
fn ahead(audience: Option<&Audience>, participant: &mut dyn Participant) -> Answer {
    if let Some(audience) = audience {
        participant.meet(audience);
    }
    let mut answer = Answer::default();
    participant
        .advance(MS / 2, ms(3), &[], &mut answer)
        .unwrap();
    answer
}

#[test]
fn a_node_goes_ahead_until_it_says_what_may_be_answered() {
    let answered = Audience {
        accepted: vec![Filter::exact(0x200)].into(),
        silent: vec![].into(),
    };
    let silent = Audience {
        silent: answered.accepted.clone(),
        ..answered.clone()
    };
    let cases = [
        // It speaks at 0 already, before the look-ahead begins.
        (None, 1, MS / 2),
        (Some(answered), 1, MS / 2),
        (Some(silent), 4, ms(3)),
    ];
    for (audience, frames, reached) in cases {
        let mut node = Echo::new(MS);
        let local = ahead(audience.as_ref(), &mut Local::new("echo", &mut node));
        assert_eq!((local.frames.len(), local.reached), (frames, reached));
        let (mut remote, _echo) = remote_echo();
        assert_eq!(ahead(audience.as_ref(), &mut remote), local);
    }
    let mut node = Echo::new(MS);
    node.deadline = MS;
    let answer = ahead(None, &mut Local::new("echo", &mut node));
    assert_eq!((answer.frames.len(), answer.reached), (1, MS));
    assert_eq!(answer.next_deadline, Some(ms(2)));
}
