use std::collections::VecDeque;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::Duration;

use can::{CanFrame, Filter, Progress};
use rustix::net::SendFlags;

use super::protocol::*;

use super::*;
use crate::bus::{Bus, BusError};
use crate::seat::{MESSAGE_BYTES_MAX, Misread, receive_packet};
use crate::testing::Echo;

const MS: Duration = Duration::from_millis(1);

fn ms(value: u32) -> Duration {
    MS * value
}

fn ping(byte: u8) -> CanFrame {
    CanFrame::new(0x100, &[byte])
}

fn accept(name: &str, channel: OwnedFd) -> Result<Remote, Failure> {
    Remote::accept(name, channel, Some(ANSWER_PATIENCE), Setting::default())
}

/// Starts an echo in a thread; returns the coordinator's view of it.
fn remote_echo() -> (Remote, JoinHandle<Result<(), FollowError>>) {
    let (ours, theirs) = channel().unwrap();
    let echo = std::thread::spawn(move || follow(&mut Echo::new(MS), theirs, None::<&mut dyn Bus>));
    (accept("echo", ours).unwrap(), echo)
}

fn step(
    participant: &mut dyn Participant,
    to: Duration,
    frames: &[(Duration, CanFrame)],
) -> Result<Answer, Failure> {
    let mut answer = Answer::default();
    participant.advance(to, to, frames, &mut answer)?;
    Ok(answer)
}

fn stop(participant: &mut dyn Participant, at: Duration) -> Answer {
    let mut answer = Answer::default();
    participant.stop(at, &mut answer).unwrap();
    answer
}

/// Steps a participant through a fixed sequence of frames.
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
        remote.hello().filters,
        [Filter::exact(0x100), Filter::exact(0x1FF)]
    );
    assert_eq!(remote.hello().next_deadline, Some(Duration::ZERO));
    let answers = story(&mut remote);
    assert_eq!(answers, local);
    assert_eq!(answers[3].next_deadline, local[3].next_deadline);
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
        "could not be stepped: frame 100#00 at 3ms is out of order in the step from 0ns to 2ms"
    );
    step(&mut local, ms(5), &[]).unwrap();
    let error = step(&mut local, ms(4), &[]).unwrap_err().to_string();
    assert_eq!(
        error,
        "could not be stepped: time would go back from 5ms to 4ms"
    );
}

#[test]
fn a_deadline_that_does_not_move_is_an_error_and_not_a_hang() {
    let mut node = Echo::new(Duration::ZERO);
    let mut local = Local::new("echo", &mut node);
    let error = step(&mut local, ms(2), &[]).unwrap_err();
    assert!(matches!(error, Failure::Step(_)));
    let error = error.to_string();
    assert!(error.ends_with("its deadline does not move"), "{error}");
}

#[test]
fn more_frames_than_an_answer_holds_is_an_error() {
    let mut node = Echo::new(Duration::from_micros(1));
    let mut local = Local::new("echo", &mut node);
    let error = step(&mut local, ms(3), &[]).unwrap_err();
    assert!(matches!(error, Failure::Step(_)));
    let error = error.to_string();
    assert!(error.contains("queued more than 1024 frames"), "{error}");
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
    let error = echo.join().unwrap().unwrap_err().to_string();
    assert!(error.contains("out of order"), "{error}");
}

#[test]
fn a_dead_process_is_noticed() {
    let (ours, theirs) = channel().unwrap();
    drop(theirs);
    let error = accept("controller", ours).err().unwrap();
    assert!(matches!(error, Failure::Ended));
    assert_eq!(
        error.to_string(),
        "ended before it answered; see the end of its log"
    );

    let (ours, theirs) = channel().unwrap();
    send(&theirs, &hello_packet());
    let mut remote = accept("controller", ours).unwrap();
    drop(theirs);
    let error = step(&mut remote, MS, &[]).unwrap_err();
    assert!(matches!(error, Failure::Ended));
}

#[test]
fn a_process_that_dies_in_the_middle_of_a_step_is_noticed() {
    let (ours, theirs) = channel().unwrap();
    send(&theirs, &hello_packet());
    let mut remote = accept("controller", ours).unwrap();
    let dying = std::thread::spawn(move || {
        receive_packet(&theirs, &mut Vec::with_capacity(MESSAGE_BYTES_MAX))
    });
    let error = step(&mut remote, MS, &[]).unwrap_err();
    assert!(matches!(error, Failure::Ended), "{error}");
    dying.join().unwrap().unwrap();
}

#[test]
fn a_silent_process_is_noticed() {
    let (ours, theirs) = channel().unwrap();
    send(&theirs, &hello_packet());
    let mut remote = Remote::accept("plant", ours, Some(ms(30)), Setting::default()).unwrap();
    let error = step(&mut remote, MS, &[]).unwrap_err();
    assert!(
        matches!(error, Failure::NoAnswer(_)),
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

/// Returns the error in an answer to 0 to 2 ms that may continue to 4 ms, where 0x100 is quiet.
fn wrong(packet: &[u8]) -> Option<String> {
    let asked = Asked {
        number: 7,
        from: Duration::ZERO,
        to: ms(2),
        until: ms(4),
        was_halted: false,
    };
    let quiet = vec![Filter::exact(0x100)].into();
    let misread = decode_done(packet, &asked, &quiet, &mut Answer::default());
    misread.err().map(|misread: Misread| misread.to_string())
}

fn answer_with(frames: &[(Duration, CanFrame)], reached: Duration) -> Answer {
    Answer {
        frames: frames.to_vec(),
        next_deadline: None,
        reached,
        progress: Progress::Running,
    }
}

fn done(answer: &Answer) -> Vec<u8> {
    let mut packet = Vec::new();
    encode_done(&mut packet, 7, answer).unwrap();
    packet
}

#[test]
fn malformed_answers_are_named_with_their_byte() {
    let packet = done(&answer_with(&[(MS, ping(1))], ms(2)));
    assert_eq!(packet.len(), 48);
    assert_eq!(wrong(&packet), None);
    for end in 0..packet.len() {
        assert!(
            wrong(&packet[..end]).unwrap().contains("ends here"),
            "cut at {end}"
        );
    }
    let with = |index: usize, value: u8| {
        let mut packet = packet.clone();
        packet[index] = value;
        wrong(&packet).unwrap()
    };
    assert_eq!(with(0, 9), "byte 0: kind 9, where DONE is 4");
    assert_eq!(with(1, 7), "byte 1: 7, which is neither 0, 1 nor 2");
    assert_eq!(with(4, 6), "byte 4: number 6, and 7 was asked");
    let short = "byte 48: the message has 72 bytes, and this one ends here";
    assert_eq!(with(2, 2), short);
    let long = "byte 24: the message ends here, and 24 bytes follow";
    assert_eq!(with(2, 0), long);
    assert_eq!(
        with(3, 0xFF),
        "byte 2: 65281 frames, where 1024 is the limit"
    );
    assert!(with(36, 9).starts_with("byte 36: a frame of 9 bytes with flags 0x00"));
    assert!(with(37, 4).starts_with("byte 36: a frame of 1 bytes with flags 0x04"));
    assert!(with(35, 0x20).contains("is an error frame, which no node sends"));
}

#[test]
fn an_answer_keeps_to_the_time_that_was_granted() {
    let other = CanFrame::new(0x200, &[]);
    for (frames, reached, said) in [
        (&[(ms(3), ping(1))][..], ms(4), None),
        (&[(MS, ping(1)), (MS, other)], ms(2), None),
        (&[(ms(3), ping(1)), (ms(3), other)], ms(3), None),
        (
            &[],
            MS,
            Some("byte 16: it reached 1ms, which lies outside 2ms to 4ms"),
        ),
        (
            &[],
            ms(5),
            Some("byte 16: it reached 5ms, which lies outside 2ms to 4ms"),
        ),
        // It continued after a frame that may be answered.
        (
            &[(MS, other)],
            ms(3),
            Some("byte 16: it reached 3ms, which lies outside 2ms to 2ms"),
        ),
        (
            &[(ms(3), other)],
            ms(4),
            Some("byte 16: it reached 4ms, which lies outside 2ms to 3ms"),
        ),
        (
            &[(MS, ping(1)), (Duration::ZERO, ping(2))],
            ms(2),
            Some("byte 48: frame 100#02 at 0ns, which lies outside 1ms to 2ms"),
        ),
        (
            &[(ms(3), ping(1))],
            ms(2),
            Some("byte 24: frame 100#01 at 3ms, which lies outside 0ns to 2ms"),
        ),
    ] {
        let packet = done(&answer_with(frames, reached));
        assert_eq!(wrong(&packet).as_deref(), said);
    }
    // A node that stops need not continue.
    let stopped = Answer {
        progress: Progress::Stopped,
        ..answer_with(&[], MS)
    };
    assert_eq!(wrong(&done(&stopped)), None);
}

#[test]
fn malformed_requests_end_the_process_with_an_error() {
    for garbage in [&[3, 0][..], &[7; 40], &[3; 5000]] {
        let (ours, theirs) = channel().unwrap();
        let mut welcome = Vec::new();
        encode_welcome(&mut welcome, &Setting::default(), &[]).unwrap();
        send(&ours, &welcome);
        send(&ours, garbage);
        let error = follow(&mut Echo::new(MS), theirs, None).unwrap_err();
        assert!(matches!(error, FollowError::Protocol(_)), "{error}");
    }
}

#[test]
fn another_version_and_another_seat_are_refused() {
    for (byte, value, said) in [
        (1, 77, "byte 1: version 77, where 1 is spoken"),
        (16, 1, "byte 16: seat 1, and a node's is 0"),
        (17, 4, "byte 17: flags 0x04, and 0x02 alone is known"),
    ] {
        let mut packet = hello_packet();
        packet[byte] = value;
        let (ours, theirs) = channel().unwrap();
        send(&theirs, &packet);
        let error = accept("plant", ours).err().unwrap().to_string();
        assert!(error.ends_with(said), "{error}");
    }
}

#[test]
fn a_welcome_has_these_bytes() {
    let setting = Setting {
        now: Duration::ZERO,
        bits_per_second: 1_000_000,
        seed: 5,
        node_id: 1,
    };
    let mut welcome = Vec::new();
    encode_welcome(&mut welcome, &setting, &[Filter::exact(0x210)]).unwrap();
    let mut expected = vec![2, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    expected.extend([
        0x40, 0x42, 0x0F, 0, 0x40, 0x42, 0x0F, 0, 5, 0, 0, 0, 0, 0, 0, 0,
    ]);
    expected.extend([1, 0, 0, 0, 0, 0, 0, 0, 0x10, 2, 0, 0, 0xFF, 7, 0, 0xC0]);
    assert_eq!(welcome, expected);
    assert_eq!(decode_welcome(&welcome), Ok(vec![Filter::exact(0x210)]));
}

#[test]
fn more_frames_than_a_message_holds_go_in_several() {
    let frames = vec![(MS, ping(1)); FRAMES_MAX];
    let mut node = Echo::new(MS);
    node.deadline = ms(100);
    let (ours, theirs) = channel().unwrap();
    let echo = std::thread::spawn(move || follow(&mut node, theirs, None));
    let mut remote = accept("echo", ours).unwrap();
    let more = [&frames[..], &frames, &frames[..5]].concat();
    assert_eq!(
        step(&mut remote, MS, &frames).unwrap().frames.len(),
        FRAMES_MAX
    );
    assert_eq!(
        step(&mut remote, MS, &more).unwrap().frames.len(),
        more.len()
    );
    stop(&mut remote, MS);
    echo.join().unwrap().unwrap();
}

#[test]
fn a_process_whose_deadline_does_not_move_is_noticed() {
    let (ours, theirs) = channel().unwrap();
    send(&theirs, &hello_packet());
    let mut remote = accept("controller", ours).unwrap();
    let stuck = std::thread::spawn(move || {
        let mut packet = Vec::with_capacity(MESSAGE_BYTES_MAX);
        receive_packet(&theirs, &mut packet).unwrap();
        while receive_packet(&theirs, &mut packet).is_ok() && !packet.is_empty() {
            let (number, _) = decode_request(&packet, &mut Vec::new()).unwrap();
            let mut done = Vec::new();
            let answer = answer_with(&[], MS);
            encode_done(
                &mut done,
                number,
                &Answer {
                    next_deadline: Some(MS),
                    ..answer
                },
            )
            .unwrap();
            send(&theirs, &done);
        }
    });
    let error = (0..2000).find_map(|_| step(&mut remote, MS, &[]).err());
    assert!(
        error
            .unwrap()
            .to_string()
            .contains("its deadline does not move")
    );
    drop(remote);
    stuck.join().unwrap();
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
fn announced_with(on_wire: &[CanFrame]) -> (Result<Answer, Failure>, Result<(), FollowError>) {
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
    let mut remote = accept("echo", ours).unwrap();
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
    assert!(matches!(answer.unwrap_err(), Failure::Ended));
    assert_eq!(outcome.unwrap_err().to_string(), text);
}

#[test]
fn a_frame_missing_on_the_wire_is_an_error() {
    let (answer, outcome) = announced_with(&[]);
    let text = "frame 100#01 was announced but nothing arrived within 10 s";
    assert!(matches!(answer.unwrap_err(), Failure::Ended));
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
fn echoed_frames_are_not_delivered() {
    struct Talker(VecDeque<CanFrame>, Vec<CanFrame>, Option<Duration>);
    impl can::Node for Talker {
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
    let mut remote = accept("talker", ours).unwrap();
    let queued = step(&mut remote, Duration::ZERO, &[]).unwrap().frames;
    assert_eq!(queued.len(), 2);
    // The coordinator puts its frames on the wire in another order, then another node's.
    for frame in [ping(2), ping(1), ping(9)] {
        sender.send(frame).unwrap();
    }
    step(&mut remote, MS, &[(MS, ping(9))]).unwrap();
    assert_eq!(talker.join().unwrap().unwrap(), [ping(9)]);
}

/// Steps an echo that sends 0x200 each millisecond, which the audience may answer or not.
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
        // It sends at 0 already, before the look-ahead begins.
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
