use std::fs;
use std::os::fd::OwnedFd;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use can::frame::ERROR_FLAG;
use can::{CanFrame, Filter};
use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, SocketAddrUnix, SocketFlags, SocketType, connect, send,
    socket_with,
};

use super::*;
use crate::bus::Bus;
use crate::clock::Clock;

const SOON: Duration = Duration::from_secs(5);
const NOT: Duration = Duration::from_millis(30);

fn join(hub: &Hub, filters: &[Filter]) -> Box<dyn Bus> {
    crate::open(&hub.address(), filters).unwrap()
}

fn frame(id: u16, byte: u8) -> CanFrame {
    CanFrame::new(id, &[byte])
}

/// Returns the error message of a controller that has lost a frame (`CAN_ERR_CRTL`).
fn error_message() -> CanFrame {
    CanFrame::from_raw(ERROR_FLAG | 4, 8, [0, 1, 0, 0, 0, 0, 0, 0]).unwrap()
}

/// Returns a connection that may send any packet.
fn raw_client(hub: &Hub) -> OwnedFd {
    let socket = socket_with(
        AddressFamily::UNIX,
        SocketType::SEQPACKET,
        SocketFlags::CLOEXEC,
        None,
    )
    .unwrap();
    let address = SocketAddrUnix::new(hub.listener.path()).unwrap();
    connect(&socket, &address).unwrap();
    socket
}

/// Waits until the hub has counted something.
fn eventually(condition: impl Fn() -> bool) {
    let clock = Clock::start();
    while !condition() {
        assert!(clock.now() < SOON, "it did not happen within 5 s");
        std::thread::yield_now();
    }
}

fn recorded(recorder: &mut Recorder, count: usize) -> Vec<crate::recorder::ReceivedFrame> {
    let clock = Clock::start();
    let mut frames = vec![];
    while frames.len() < count {
        assert!(clock.now() < SOON, "{} of {count} recorded", frames.len());
        frames.extend(recorder.next());
    }
    frames
}

#[test]
fn frames_reach_those_who_want_them_and_not_their_sender() {
    let (hub, mut recorder) = Hub::start().unwrap();
    let mut everything = join(&hub, &[Filter::ALL]);
    let mut some = join(&hub, &[Filter::exact(0x190), Filter::exact(0x80)]);
    let mut nothing = join(&hub, &[]);
    let mut errors = join(&hub, &[Filter::ERRORS]);

    everything.send(&frame(0x190, 1)).unwrap();
    everything.send(&frame(0x191, 2)).unwrap();
    nothing.send(&frame(0x80, 3)).unwrap();
    some.send(&error_message()).unwrap();
    some.send(&frame(0x7FF, 4)).unwrap();

    assert_eq!(some.receive(SOON).unwrap(), Some(frame(0x190, 1)));
    assert_eq!(some.receive(SOON).unwrap(), Some(frame(0x80, 3)));
    assert_eq!(some.receive(NOT).unwrap(), None);
    let mut heard = [everything.receive(SOON), everything.receive(SOON)]
        .map(|frame| frame.unwrap().unwrap().raw_id());
    heard.sort_unstable();
    assert_eq!(heard, [0x80, 0x7FF]);
    assert_eq!(everything.receive(NOT).unwrap(), None);
    assert_eq!(nothing.receive(NOT).unwrap(), None);

    assert_eq!(errors.receive(SOON).unwrap(), Some(error_message()));
    assert_eq!(errors.receive(NOT).unwrap(), None);

    let times: Vec<_> = recorded(&mut recorder, 5)
        .iter()
        .map(|stamped| stamped.time)
        .collect();
    assert!(times.is_sorted(), "{times:?}");
    assert_eq!(recorder.lost(), 0);
}

#[test]
fn a_client_that_does_not_drain_is_dropped_from_and_never_waited_for() {
    let (hub, _recorder) = Hub::start().unwrap();
    let mut sender = join(&hub, &[]);
    let mut asleep = join(&hub, &[Filter::ALL]);
    let mut awake = join(&hub, &[Filter::ALL]);
    for round in 0..1000_u32 {
        sender
            .send(&CanFrame::new(0x100, &round.to_le_bytes()))
            .unwrap();
        let heard = awake.receive(SOON).unwrap().unwrap();
        assert_eq!(heard.data(), round.to_le_bytes());
    }

    let mut kept = 0;
    while asleep.receive(NOT).unwrap().is_some() {
        kept += 1;
    }
    assert!((1..1000).contains(&kept), "{kept} kept");
    sender.send(&frame(0x101, 0)).unwrap();
    assert_eq!(asleep.receive(SOON).unwrap(), Some(frame(0x101, 0)));
    assert_eq!(asleep.dropped(), 1000 - kept);
    assert_eq!(awake.dropped(), 0);
}

#[test]
fn garbage_hurts_nobody() {
    let (hub, mut recorder) = Hub::start().unwrap();
    let mut listener = join(&hub, &[Filter::ALL]);

    let talks_nonsense = raw_client(&hub);
    send(&talks_nonsense, &[0; 8], SendFlags::NOSIGNAL).unwrap();
    for garbage in [&[1][..], &[0; 15], &[0; 72], &[0; 10_000], &[0xFF; 16]] {
        send(&talks_nonsense, garbage, SendFlags::NOSIGNAL).unwrap();
    }

    // The first packet is no array of filters, or far too long.
    for hello in [&[0; 7][..], &[0; 8192]] {
        let client = raw_client(&hub);
        send(&client, hello, SendFlags::NOSIGNAL).unwrap();
        let mut answer = [0; 8];
        let end = rustix::net::recv(&client, &mut answer, RecvFlags::empty());
        assert!(matches!(end, Ok((_, 0)) | Err(_)), "{end:?}");
    }

    send(
        &talks_nonsense,
        &crate::kernel_format::encode_frame(&frame(0x123, 9)),
        SendFlags::NOSIGNAL,
    )
    .unwrap();
    assert_eq!(listener.receive(SOON).unwrap(), Some(frame(0x123, 9)));
    assert_eq!(recorded(&mut recorder, 1)[0].frame, frame(0x123, 9));
}

#[test]
fn more_clients_than_there_is_room_for_are_refused_and_places_become_free() {
    let (hub, _recorder) = Hub::start().unwrap();
    let mut clients: Vec<_> = (0..CLIENTS_MAX)
        .map(|_| join(&hub, &[Filter::ALL]))
        .collect();
    let refused = crate::open(&hub.address(), &[Filter::ALL]).err().unwrap();
    let refused = refused.to_string();
    assert!(refused.ends_with("did not let us join"), "{refused}");
    clients.pop();
    eventually(|| crate::open(&hub.address(), &[Filter::ALL]).is_ok());
}

#[test]
fn the_socket_is_private_and_goes_with_the_hub() {
    let (hub, _recorder) = Hub::start().unwrap();
    let socket = hub.listener.path();
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    assert_eq!(mode(&socket), 0o600);
    assert_eq!(mode(socket.parent().unwrap()), 0o700);

    let mut client = join(&hub, &[Filter::ALL]);
    let address = hub.address();
    drop(hub);
    assert!(!socket.exists());
    assert!(!socket.parent().unwrap().exists());
    let closed = client.receive(SOON).unwrap_err();
    assert_eq!(closed.to_string(), format!("the bus {address} ended"));
    let closed = client.send(&frame(1, 1)).unwrap_err();
    assert_eq!(closed.to_string(), format!("the bus {address} ended"));
    let gone = crate::open(&address, &[]).err().unwrap().to_string();
    assert!(gone.ends_with("has the run that made it ended?"), "{gone}");
}

#[test]
fn what_a_killed_hub_left_is_removed() {
    let parent = TestDirectory::new("leftover");
    // No process has the largest number, since the kernel's limit is 2^22.
    let dead = parent.path.join("canrig-bus-2147483647-0");
    fs::create_dir(&dead).unwrap();
    let socket = socket_with(
        AddressFamily::UNIX,
        SocketType::SEQPACKET,
        SocketFlags::CLOEXEC,
        None,
    )
    .unwrap();
    rustix::net::bind(&socket, &SocketAddrUnix::new(dead.join("socket")).unwrap()).unwrap();
    drop(socket);
    // Not leftovers: another name, and a hub that lives.
    let foreign = parent.path.join("other-2147483647-0");
    fs::create_dir(&foreign).unwrap();
    let (alive, _recorder) = Hub::start_in(std::slice::from_ref(&parent.path)).unwrap();

    let (_hub, _recorder) = Hub::start_in(std::slice::from_ref(&parent.path)).unwrap();
    assert!(!dead.exists());
    assert!(foreign.exists());
    assert!(alive.listener.path().exists());
}

#[test]
fn a_path_that_is_too_long_is_an_error_that_says_what_to_set() {
    let parent = TestDirectory::new(&"x".repeat(100));
    let error = Hub::start_in(std::slice::from_ref(&parent.path)).unwrap_err();
    assert!(error.to_string().contains("name too long"), "{error}");
    assert!(
        error
            .to_string()
            .contains("TMPDIR to a directory with a shorter name"),
        "{error}"
    );
    assert_eq!(fs::read_dir(&parent.path).unwrap().count(), 0);
}

#[test]
fn the_next_directory_is_tried_and_none_is_an_error() {
    let parent = TestDirectory::new("second");
    let missing = parent.path.join("missing");
    let (hub, _recorder) = Hub::start_in(&[missing.clone(), parent.path.clone()]).unwrap();
    assert!(hub.listener.path().starts_with(&parent.path));
    let error = Hub::start_in(&[missing]).unwrap_err().to_string();
    assert!(error.contains("missing"), "{error}");
}

#[test]
fn what_the_recorder_has_no_room_for_is_counted() {
    let (mut ring, recorder) = crate::recorder::ring();
    for _ in 0..crate::recorder::RING_FRAMES + 3 {
        ring.push_now(frame(1, 1), None);
    }
    assert_eq!(recorder.lost(), 3);
}

/// A directory that is removed with all that is in it.
struct TestDirectory {
    path: PathBuf,
}

impl TestDirectory {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("platform-{}-{name}", std::process::id()));
        fs::create_dir(&path).unwrap();
        Self { path }
    }
}

impl Drop for TestDirectory {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.path).unwrap();
    }
}
