//! The SDO server (CiA 301, 7.2.4): one channel by which one client reads and writes the object dictionary.

use std::time::Duration;

use crate::object_dictionary::{AbortCode, Accepted, ObjectDictionary};
use crate::sdo::{
    DEFAULT_REQUEST_ID, DEFAULT_RESPONSE_ID, DEFAULT_TIMEOUT, MAX_TRANSFER_BYTES, Multiplexer,
    Payload, SEGMENT_BYTES, State, Step, Transfer, announced_length, check_length, check_toggle,
    data_bytes, expedited, expedited_length, payload_with_id,
};
use crate::sdo_block::{BLOCK_SIZE, BlockSender, check_end};
use can::CanFrame;

/// Objects that a server serves, with their reactions to reads and writes.
pub trait Access {
    /// Returns the value of an object, little-endian. Values up to four bytes are served without allocation.
    ///
    /// # Errors
    /// The reason for which the object cannot be read.
    fn read(&mut self, index: u16, sub_index: u8) -> Accepted<&[u8]>;

    /// Writes an object.
    ///
    /// # Errors
    /// The reason for which the object cannot be written, or not with these bytes.
    fn write(&mut self, index: u16, sub_index: u8, bytes: &[u8]) -> Accepted;

    /// Returns the dictionary of the objects, by which hopeless segmented and block downloads end early, and which knows the length
    /// of expedited downloads that do not tell theirs.
    fn dictionary(&self) -> &ObjectDictionary;
}

/// Objects of a server.
type Objects<'a> = &'a mut dyn Access;

/// Server of one SDO channel.
///
/// Drain [`SdoServer::next_frame`] after each call that takes a time.
#[derive(Clone, Debug)]
pub struct SdoServer {
    request_id: u16,
    response_id: u16,
    transfer: Transfer,
}

impl SdoServer {
    /// Makes a server that hears requests on one COB-ID and answers on another; the low 11 bits count.
    pub fn new(request_id: u16, response_id: u16) -> Self {
        Self {
            request_id: request_id & 0x7FF,
            response_id: response_id & 0x7FF,
            transfer: Transfer::default(),
        }
    }

    /// Makes a server on the default channel of a node: requests on 0x600 + node-ID, answers on 0x580 + node-ID.
    pub fn for_node(node_id: u8) -> Self {
        let node_id = u16::from(node_id);
        Self::new(DEFAULT_REQUEST_ID + node_id, DEFAULT_RESPONSE_ID + node_id)
    }

    /// Returns the COB-ID of requests.
    pub fn request_id(&self) -> u16 {
        self.request_id
    }

    /// Returns the COB-ID of answers.
    pub fn response_id(&self) -> u16 {
        self.response_id
    }

    /// Checks whether a transfer is under way.
    pub fn is_busy(&self) -> bool {
        self.transfer.is_busy()
    }

    /// Forgets the transfer in silence (NMT reset, or a state without SDO).
    pub fn reset(&mut self) {
        self.transfer.close();
        self.transfer.outgoing = None;
    }

    /// Handles a frame; frames with another COB-ID, not of 8 bytes, or other than plain data frames are ignored.
    pub fn on_frame(&mut self, now: Duration, frame: &CanFrame, objects: Objects<'_>) {
        let Some(request) = payload_with_id(frame, self.request_id) else {
            return;
        };
        match self.handle(&request, objects) {
            Ok(_) if !self.is_busy() => self.transfer.deadline = None,
            Ok(Step::Forward) => self.transfer.deadline = Some(now.saturating_add(DEFAULT_TIMEOUT)),
            Ok(_) => {}
            Err(code) => self.fail(code),
        }
    }

    /// Aborts a transfer whose client has been silent for too long.
    pub fn on_tick(&mut self, now: Duration) {
        if self.transfer.is_overdue(now) {
            self.fail(AbortCode::PROTOCOL_TIMED_OUT);
        }
    }

    /// Returns the next frame to send.
    pub fn next_frame(&mut self) -> Option<CanFrame> {
        let payload = self.transfer.next_payload()?;
        Some(CanFrame::new(self.response_id, &payload))
    }

    /// Returns the time at which [`SdoServer::on_tick`] is due; `None` between transfers.
    pub fn next_deadline(&self) -> Option<Duration> {
        self.transfer.deadline
    }

    /// Ends the transfer and sends the client the reason.
    fn fail(&mut self, code: AbortCode) {
        self.transfer.close();
        self.transfer.outgoing = Some(self.transfer.object.abort(code));
    }

    /// Handles a request by the state and by its command specifier, which exists only outside the segments of a block.
    fn handle(&mut self, request: &Payload, objects: Objects<'_>) -> Accepted<Step> {
        if self.transfer.is_abort(request) {
            self.transfer.close();
            return Ok(Step::Stale);
        }
        match (self.transfer.state, request[0] >> 5, request[0] & 0b11) {
            (State::ReceivingBlock { stored }, ..) => {
                return self.transfer.receive_block_segment(request, stored);
            }
            (State::Receiving { toggle }, 0, _) => {
                self.download_segment(request, toggle, objects)?
            }
            (_, 1, _) => self.initiate_download(request, objects)?,
            (_, 2, _) => self.initiate_upload(request, objects)?,
            (State::Sending { toggle, position }, 3, _) => {
                self.upload_segment(request, toggle, position)?;
            }
            (_, 5, 0) => self.initiate_block_upload(request, objects)?,
            (State::BlockSent, 5, 1) => self.transfer.close(),
            (State::SendingBlock(sender), 5, 2) => {
                self.transfer.acknowledge_block(request, sender)?;
            }
            // The client is ready: the second part of "SDO block upload initiate".
            (State::BlockPrepared(sender), 5, 3) => {
                self.transfer.state = State::SendingBlock(sender);
            }
            (_, 6, 0 | 2) => self.initiate_block_download(request, objects)?,
            (State::BlockReceived, 6, 1 | 3) => self.end_block_download(request, objects)?,
            (_, 7, _) => {
                self.transfer.object = Multiplexer::from_payload(request);
                return Err(AbortCode::COMMAND_SPECIFIER_INVALID);
            }
            _ => return Err(AbortCode::COMMAND_SPECIFIER_INVALID),
        }
        Ok(Step::Forward)
    }

    /// Drops the current transfer, since the client starts a new one.
    fn begin(&mut self, request: &Payload) -> Multiplexer {
        self.transfer.close();
        self.transfer.object = Multiplexer::from_payload(request);
        self.transfer.object
    }

    /// Handles "SDO download initiate", expedited or segmented.
    fn initiate_download(&mut self, request: &Payload, objects: Objects<'_>) -> Accepted {
        let Multiplexer { index, sub_index } = self.begin(request);
        let command = request[0];
        if command & 0b10 != 0 {
            let type_bytes = || {
                let entry = objects.dictionary().get(index, sub_index)?;
                entry.data_type.size_bytes()
            };
            let told = expedited_length(command);
            let length = told.unwrap_or_else(|| type_bytes().unwrap_or(4).min(4));
            objects.write(index, sub_index, &data_bytes(request)[..length])?;
        } else {
            self.prepare_download(request, command & 1 != 0, objects)?;
            self.transfer.state = State::Receiving { toggle: false };
        }
        self.transfer.outgoing = Some(self.transfer.object.payload(0x60, [0; 4]));
        Ok(())
    }

    /// Prepares the reception of a value, once object and memory agree to the length that the client announces.
    fn prepare_download(
        &mut self,
        request: &Payload,
        is_announced: bool,
        objects: Objects<'_>,
    ) -> Accepted {
        let Multiplexer { index, sub_index } = self.transfer.object;
        let announced = announced_length(request, is_announced);
        let dictionary = objects.dictionary();
        let entry = dictionary.entry(dictionary.find(index, sub_index)?);
        if !entry.access.is_writable() {
            return Err(AbortCode::READ_ONLY);
        }
        // A length beyond the limit may also be beyond the object's, which is the better answer.
        if let Some(length) = announced.unwrap_or(Some(usize::MAX)) {
            check_length(length, entry.data_type.size_bytes())?;
        }
        self.transfer.announced = announced?;
        self.transfer.buffer.clear();
        Ok(())
    }

    /// Handles "SDO download segment".
    fn download_segment(
        &mut self,
        request: &Payload,
        toggle: bool,
        objects: Objects<'_>,
    ) -> Accepted {
        self.transfer.state = State::Receiving { toggle: !toggle };
        if self.transfer.receive_segment(request, toggle)? {
            self.finish_download(objects)?;
        }
        self.transfer.outgoing = Some([0x20 | u8::from(toggle) << 4, 0, 0, 0, 0, 0, 0, 0]);
        Ok(())
    }

    /// Writes a value that arrived in segments.
    fn finish_download(&mut self, objects: Objects<'_>) -> Accepted {
        let Multiplexer { index, sub_index } = self.transfer.object;
        objects.write(index, sub_index, &self.transfer.buffer)?;
        self.transfer.close();
        Ok(())
    }

    /// Handles "SDO upload initiate".
    fn initiate_upload(&mut self, request: &Payload, objects: Objects<'_>) -> Accepted {
        let Multiplexer { index, sub_index } = self.begin(request);
        let value = objects.read(index, sub_index)?;
        self.answer_upload(value)
    }

    /// Answers an upload, expedited or segmented.
    fn answer_upload(&mut self, value: &[u8]) -> Accepted {
        if let Some((command, data)) = expedited(0x40, value) {
            self.transfer.outgoing = Some(self.transfer.object.payload(command, data));
            return Ok(());
        }
        self.keep(value)?;
        self.transfer.state = State::Sending {
            toggle: false,
            position: 0,
        };
        self.transfer.outgoing = Some(self.transfer.object.payload_with_length(0x41, value.len()));
        Ok(())
    }

    /// Keeps a copy of a value that leaves in segments, so that they belong together.
    fn keep(&mut self, value: &[u8]) -> Accepted {
        if value.len() > MAX_TRANSFER_BYTES {
            return Err(AbortCode::OUT_OF_MEMORY);
        }
        self.transfer.buffer.clear();
        self.transfer.buffer.extend_from_slice(value);
        Ok(())
    }

    /// Handles "SDO upload segment".
    fn upload_segment(&mut self, request: &Payload, toggle: bool, position: usize) -> Accepted {
        check_toggle(request, toggle)?;
        if self.transfer.send_segment(toggle, position) {
            self.transfer.close();
        } else {
            self.transfer.state = State::Sending {
                toggle: !toggle,
                position: position + SEGMENT_BYTES,
            };
        }
        Ok(())
    }

    /// Handles "SDO block download initiate".
    fn initiate_block_download(&mut self, request: &Payload, objects: Objects<'_>) -> Accepted {
        self.begin(request);
        self.prepare_download(request, request[0] & 0b10 != 0, objects)?;
        self.transfer.with_crc = request[0] & 0b100 != 0;
        self.transfer.state = State::ReceivingBlock { stored: 0 };
        self.transfer.outgoing = Some(self.transfer.object.payload(0xA4, [BLOCK_SIZE, 0, 0, 0]));
        Ok(())
    }

    /// Handles "SDO block download end".
    fn end_block_download(&mut self, request: &Payload, objects: Objects<'_>) -> Accepted {
        check_end(&mut self.transfer, request)?;
        self.finish_download(objects)?;
        self.transfer.outgoing = Some([0xA1, 0, 0, 0, 0, 0, 0, 0]);
        Ok(())
    }

    /// Handles "SDO block upload initiate"; values up to the client's protocol switch threshold take a plain upload.
    fn initiate_block_upload(&mut self, request: &Payload, objects: Objects<'_>) -> Accepted {
        let Multiplexer { index, sub_index } = self.begin(request);
        let [block_size, threshold, ..] = data_bytes(request);
        let value = objects.read(index, sub_index)?;
        if value.len() <= usize::from(threshold) {
            return self.answer_upload(value);
        }
        let sender = BlockSender::new(block_size)?;
        self.keep(value)?;
        self.transfer.with_crc = request[0] & 0b100 != 0;
        self.transfer.state = State::BlockPrepared(sender);
        self.transfer.outgoing = Some(self.transfer.object.payload_with_length(0xC6, value.len()));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use proptest::prelude::*;

    use super::*;
    use crate::object_dictionary::{self, DataType, Entry};
    use crate::sdo::bytes;

    const NOW: Duration = Duration::from_secs(5);

    /// Plain storage: existence, access rights, length and limits are checked, and there is no other effect.
    impl Access for ObjectDictionary {
        fn read(&mut self, index: u16, sub_index: u8) -> Result<&[u8], AbortCode> {
            ObjectDictionary::read(self, index, sub_index)
        }

        fn write(&mut self, index: u16, sub_index: u8, bytes: &[u8]) -> Result<(), AbortCode> {
            let handle = self.check_write(index, sub_index, bytes)?;
            self.store(handle, bytes)
        }

        fn dictionary(&self) -> &ObjectDictionary {
            self
        }
    }

    /// A server with a few objects of every kind.
    struct Bench {
        server: SdoServer,
        objects: ObjectDictionary,
        now: Duration,
    }

    impl Bench {
        fn new() -> Self {
            use object_dictionary::Access::{ReadOnly, ReadWrite, WriteOnly};
            let mut objects = ObjectDictionary::new();
            let mut add = |index, sub_index, data_type, access, value: &[u8]| {
                let entry = Entry::new(index, sub_index, "", data_type, access, value.to_vec());
                objects.insert(entry);
            };
            add(0x1000, 0, DataType::Unsigned32, ReadOnly, &[0x92, 1, 2, 0]);
            add(0x1017, 0, DataType::Unsigned16, ReadWrite, &[0, 0]);
            add(
                0x2000,
                0,
                DataType::VisibleString,
                ReadWrite,
                b"hello, world",
            );
            add(0x2001, 0, DataType::Unsigned8, WriteOnly, &[7]);
            add(
                0x2002,
                0,
                DataType::Unsigned64,
                ReadWrite,
                &[1, 2, 3, 4, 5, 6, 7, 8],
            );
            add(0x2003, 0, DataType::Domain, ReadWrite, b"");
            let mut limited = Entry::new(0x2004, 0, "", DataType::Integer8, ReadWrite, vec![0]);
            (limited.low_limit, limited.high_limit) = (Some(-10), Some(10));
            objects.insert(limited);
            Self {
                server: SdoServer::for_node(0x10),
                objects,
                now: NOW,
            }
        }

        fn ask(&mut self, request: &[u8]) -> Vec<Vec<u8>> {
            let frame = CanFrame::new(0x610, request);
            self.server.on_frame(self.now, &frame, &mut self.objects);
            self.drain()
        }

        fn drain(&mut self) -> Vec<Vec<u8>> {
            std::iter::from_fn(|| self.server.next_frame())
                .inspect(|frame| assert_eq!(frame.standard_id(), Some(0x590)))
                .map(|frame| frame.data().to_vec())
                .collect()
        }

        #[track_caller]
        fn check(&mut self, request: &[u8], answer: &[u8]) {
            assert_eq!(self.ask(request), [answer]);
        }

        fn value(&self, index: u16) -> &[u8] {
            let handle = self.objects.find(index, 0).unwrap();
            self.objects.entry(handle).value()
        }
    }

    #[track_caller]
    fn only_abort(answers: &[Vec<u8>]) -> AbortCode {
        assert_eq!(answers.len(), 1, "{answers:?}");
        assert_eq!(answers[0][0], 0x80, "{answers:?}");
        AbortCode(u32::from_le_bytes(answers[0][4..8].try_into().unwrap()))
    }

    #[test]
    fn codes_of_the_application_reach_the_client() {
        struct Refusing(AbortCode, ObjectDictionary);
        impl Access for Refusing {
            fn read(&mut self, _: u16, _: u8) -> Result<&[u8], AbortCode> {
                Err(self.0)
            }
            fn write(&mut self, _: u16, _: u8, _: &[u8]) -> Result<(), AbortCode> {
                Err(self.0)
            }
            fn dictionary(&self) -> &ObjectDictionary {
                &self.1
            }
        }
        let access = object_dictionary::Access::ReadWrite;
        let mut objects = ObjectDictionary::new();
        objects.insert(Entry::new(0x1600, 0, "", DataType::Domain, access, vec![]));
        for code in [
            AbortCode::UNSUPPORTED_ACCESS,
            AbortCode::NOT_MAPPABLE,
            AbortCode::PDO_TOO_LONG,
            AbortCode::LENGTH_MISMATCH,
            AbortCode::INVALID_VALUE,
            AbortCode::DEVICE_STATE,
        ] {
            let mut server = SdoServer::for_node(0x10);
            for (requests, end) in [
                (&[b"\x40\0\x16\0\0\0\0\0"][..], "upload"),
                (&[b"\xA4\0\x16\0\x7F\0\0\0"], "block upload"),
                (&[b"\x2F\0\x16\0\0\0\0\0"], "expedited download"),
                (
                    &[b"\x21\0\x16\0\x01\0\0\0", b"\x0D\x01\0\0\0\0\0\0"],
                    "segmented download",
                ),
                (
                    &[
                        b"\xC2\0\x16\0\x01\0\0\0",
                        b"\x81\x01\0\0\0\0\0\0",
                        b"\xD9\0\0\0\0\0\0\0",
                    ],
                    "block download",
                ),
            ] {
                for request in requests {
                    let frame = CanFrame::new(0x610, &request[..]);
                    server.on_frame(NOW, &frame, &mut Refusing(code, objects.clone()));
                }
                let answer = server.next_frame().unwrap().data().to_vec();
                assert_eq!(only_abort(std::slice::from_ref(&answer)), code, "{end}");
                assert_eq!(answer[1..4], [0, 0x16, 0], "{end}");
                assert!(!server.is_busy(), "{end}");
            }
        }
    }

    #[test]
    fn half_open_transfers_time_out_with_0504_0000() {
        for opening in [
            &[&b"\x40\x00\x20\0\0\0\0\0"[..]][..],
            &[b"\x21\x03\x20\0\x0E\0\0\0", b"\x00abcdefg"],
            &[b"\xA4\x00\x20\0\x7F\0\0\0"],
            &[b"\xA4\x00\x20\0\x7F\0\0\0", b"\xA3\0\0\0\0\0\0\0"],
            &[
                b"\xA4\x00\x20\0\x7F\0\0\0",
                b"\xA3\0\0\0\0\0\0\0",
                b"\xA2\x02\x7F\0\0\0\0\0",
            ],
            &[b"\xC6\x03\x20\0\x09\0\0\0"],
            &[b"\xC6\x03\x20\0\x09\0\0\0", b"\x01abcdefg"],
            &[b"\xC6\x03\x20\0\x09\0\0\0", b"\x81abcdefg"],
        ] {
            let mut bench = Bench::new();
            for request in opening {
                bench.now += Duration::from_millis(300);
                bench.ask(request);
            }
            let deadline = bench.now + DEFAULT_TIMEOUT;
            assert_eq!(bench.server.next_deadline(), Some(deadline));
            bench.server.on_tick(deadline - Duration::from_nanos(1));
            assert!(bench.drain().is_empty());
            bench.server.on_tick(deadline);
            assert_eq!(only_abort(&bench.drain()), AbortCode::PROTOCOL_TIMED_OUT);
            assert_eq!(bench.server.next_deadline(), None);
            bench.check(b"\x40\x17\x10\0\0\0\0\0", b"\x4B\x17\x10\0\0\0\0\0");
        }
    }

    #[test]
    fn transfers_beyond_64_kib_abort_0504_0005() {
        let mut bench = Bench::new();
        for command in [0x21, 0xC6] {
            let request = [command, 3, 0x20, 0, 1, 0, 1, 0];
            assert_eq!(only_abort(&bench.ask(&request)), AbortCode::OUT_OF_MEMORY);
        }
        bench.ask(b"\x20\x03\x20\0\0\0\0\0");
        let end = (0..=MAX_TRANSFER_BYTES / SEGMENT_BYTES)
            .map(|number| bench.ask(&[if number % 2 == 0 { 0 } else { 0x10 }; 8]))
            .find(|answers| answers[0][0] == 0x80);
        assert_eq!(only_abort(&end.unwrap()), AbortCode::OUT_OF_MEMORY);
        bench.ask(b"\xC0\x03\x20\0\0\0\0\0");
        let end = (0..=MAX_TRANSFER_BYTES / SEGMENT_BYTES + 1)
            .map(|number| bench.ask(&[u8::try_from(number % 127 + 1).unwrap(); 8]))
            .find(|answers| answers.first().is_some_and(|answer| answer[0] == 0x80));
        assert_eq!(only_abort(&end.unwrap()), AbortCode::OUT_OF_MEMORY);
    }

    #[test]
    fn requests_that_a_block_swallows_do_not_hold_it_open() {
        let mut bench = Bench::new();
        bench.ask(b"\xC6\x03\x20\0\x09\0\0\0");
        let deadline = bench.server.next_deadline();
        bench.now += Duration::from_millis(500);
        // A client that starts anew looks like segment 64.
        assert!(bench.ask(b"\x40\x17\x10\0\0\0\0\0").is_empty());
        assert_eq!(bench.server.next_deadline(), deadline);
    }

    #[test]
    fn other_frames_are_passed_over() {
        let mut bench = Bench::new();
        let mut pass = |frame: Option<CanFrame>| {
            bench
                .server
                .on_frame(NOW, &frame.unwrap(), &mut bench.objects);
            assert!(bench.drain().is_empty());
        };
        let upload = [0x40, 0, 0x10, 0, 0, 0, 0, 0];
        pass(Some(CanFrame::new(0x611, &upload)));
        pass(Some(CanFrame::new(0x610, &upload[..7])));
        pass(Some(CanFrame::new(0x610, &[])));
        for flag in [
            can::frame::EXTENDED_FLAG,
            can::frame::REMOTE_FLAG,
            can::frame::ERROR_FLAG,
        ] {
            pass(CanFrame::from_raw(0x610 | flag, 8, upload));
        }
    }

    #[test]
    fn each_exchange_is_answered_as_cia_301_says() {
        let exchanges = include_str!("../tests/data/sdo_server_exchanges.log");
        exchanges.split("\n\n").for_each(play);
    }

    #[test]
    fn answers_satisfy_python_canopens_client() {
        play(include_str!(
            "../tests/data/sdo_client_of_python_canopen.log"
        ));
    }

    /// Plays requests to a server, and compares its answers and the values of its objects.
    fn play(transcript: &str) {
        let mut bench = Bench::new();
        let mut answers = VecDeque::new();
        for line in transcript.lines().filter(|line| !line.starts_with(';')) {
            match line.split_once(['#', ' ']).unwrap() {
                ("610", request) => {
                    assert_eq!(answers, [[0; 0]; 0], "before {line} of {transcript}");
                    answers.extend(bench.ask(&bytes(request)));
                }
                ("590", answer) => {
                    let expected = Some(bytes(answer));
                    assert_eq!(answers.pop_front(), expected, "{line} of {transcript}");
                    let is_abort = answer.starts_with("80");
                    assert!(!is_abort || !bench.server.is_busy(), "{transcript}");
                }
                (_, object) => {
                    let (index, value) = object.split_once(' ').unwrap();
                    let index = u16::from_str_radix(index, 16).unwrap();
                    assert_eq!(bench.value(index), bytes(value), "{transcript}");
                }
            }
        }
        assert_eq!(answers, [[0; 0]; 0], "at the end of {transcript}");
        assert!(!bench.server.is_busy(), "{transcript}");
        assert_eq!(bench.server.next_deadline(), None, "{transcript}");
    }

    /// Returns requests that mostly resemble the protocol's.
    fn request() -> impl Strategy<Value = Vec<u8>> {
        let command = prop_oneof![
            any::<u8>(),
            proptest::sample::select(&b"\x40\x2F\x23\x21\x20\x00\x10\x0D\x60\x70\x80\xA4\xA0\xA3\xA2\xA1\xC6\xC2\xC1\xC5\x01\x02\x81"[..]),
        ];
        let index = proptest::sample::select(
            &[
                0x1000_u16, 0x1017, 0x2000, 0x2001, 0x2002, 0x2003, 0x2004, 0x3000,
            ][..],
        );
        (
            command,
            index,
            0_u8..2,
            any::<[u8; 4]>(),
            prop_oneof![9 => Just(8_usize), 1 => 0..8_usize],
        )
            .prop_map(|(command, index, sub_index, data, length)| {
                Multiplexer { index, sub_index }.payload(command, data)[..length].to_vec()
            })
    }

    proptest! {
        #[test]
        fn arbitrary_frames_never_panic_or_wedge(
            requests in proptest::collection::vec((request(), 0_u64..2000), 0..60),
        ) {
            let mut bench = Bench::new();
            for (request, pause) in requests {
                bench.now += Duration::from_millis(pause);
                if bench.server.next_deadline().is_some_and(|deadline| deadline <= bench.now) {
                    bench.server.on_tick(bench.now);
                    bench.drain();
                }
                prop_assert!(bench.ask(&request).len() <= 127);
                prop_assert_eq!(bench.server.is_busy(), bench.server.next_deadline().is_some());
            }
            bench.server.on_tick(bench.now + DEFAULT_TIMEOUT);
            bench.drain();
            bench.check(b"\x40\x00\x10\0\0\0\0\0", b"\x43\x00\x10\0\x92\x01\x02\0");
        }
    }
}
