//! The SDO client (CiA 301, 7.2.4): reads and writes objects of one server, one transfer at a time.

use std::time::Duration;

use crate::object_dictionary::{AbortCode, Accepted};
use crate::sdo::{
    DEFAULT_REQUEST_ID, DEFAULT_RESPONSE_ID, DEFAULT_TIMEOUT, MAX_TRANSFER_BYTES, Multiplexer,
    Payload, SEGMENT_BYTES, State, Step, Transfer, announced_length, check_toggle, data_bytes,
    expedited, expedited_length, payload_with_id,
};
use crate::sdo_block::{BLOCK_SIZE, BlockSender, check_end};
use can::CanFrame;

/// Reason for which a transfer failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SdoFailure {
    /// The server aborted it.
    #[error("{0}")]
    Aborted(AbortCode),
    /// This client aborted it, because the server broke the protocol.
    #[error("the answer is wrong, {0}")]
    Broken(AbortCode),
    /// The server did not answer within this time.
    #[error("no answer within {} ms", .0.as_millis())]
    TimedOut(Duration),
    /// The server answered, but with a frame of so many bytes; CiA 301 has 8 in each.
    #[error("a short answer: {0} bytes in the frame (CiA 301: 8)")]
    Short(usize),
    /// Another transfer is under way.
    #[error("another transfer is under way")]
    Busy,
    /// The value has this many bytes, more than [`MAX_TRANSFER_BYTES`].
    #[error("{0} bytes (limit {MAX_TRANSFER_BYTES})")]
    TooLong(usize),
}

/// Failed transfer: its node, its object, and the reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("object 0x{index:04X}:{sub_index:02X} of node 0x{node_id:02X}: {failure}")]
pub struct SdoError {
    /// Node-ID of the server.
    pub node_id: u8,
    /// Index of the object.
    pub index: u16,
    /// Sub-index of the object.
    pub sub_index: u8,
    /// Reason of the failure.
    pub failure: SdoFailure,
}

/// Client of one SDO channel.
///
/// Start a transfer, drain [`SdoClient::next_frame`] after each call that takes a time, and take its end from
/// [`SdoClient::take_result`]. Answers that do not fit are dropped: they belong to an earlier transfer.
#[derive(Clone, Debug)]
pub struct SdoClient {
    node_id: u8,
    request_id: u16,
    response_id: u16,
    timeout: Duration,
    transfer: Transfer,
    /// Length of an answer that was no SDO frame, since the transfer was waiting for one.
    short_bytes: Option<usize>,
    result: Option<Result<Vec<u8>, SdoError>>,
}

impl SdoClient {
    /// Makes a client on the default channel of the server `node_id`.
    pub fn new(node_id: u8) -> Self {
        Self {
            node_id,
            request_id: DEFAULT_REQUEST_ID + u16::from(node_id),
            response_id: DEFAULT_RESPONSE_ID + u16::from(node_id),
            timeout: DEFAULT_TIMEOUT,
            transfer: Transfer::default(),
            short_bytes: None,
            result: None,
        }
    }

    /// Uses another channel of the same server (0x1201 and following there); the low 11 bits count.
    #[must_use]
    pub fn with_channel(mut self, request_id: u16, response_id: u16) -> Self {
        self.request_id = request_id & 0x7FF;
        self.response_id = response_id & 0x7FF;
        self
    }

    /// Waits this long for each answer, instead of [`DEFAULT_TIMEOUT`].
    #[must_use]
    pub fn with_timeout(mut self, timeout: Duration) -> Self {
        self.timeout = timeout;
        self
    }

    /// Returns the node-ID of the server.
    pub fn node_id(&self) -> u8 {
        self.node_id
    }

    /// Returns the COB-ID of answers.
    pub fn response_id(&self) -> u16 {
        self.response_id
    }

    /// Checks whether a transfer is under way.
    pub fn is_busy(&self) -> bool {
        self.transfer.is_busy()
    }

    /// Starts reading an object, which is given by index and sub-index, as for all transfers.
    ///
    /// # Errors
    /// [`SdoFailure::Busy`].
    pub fn start_upload(&mut self, now: Duration, object: (u16, u8)) -> Result<(), SdoError> {
        self.begin(now, object, &[])?;
        self.transfer.state = State::UploadRequested { is_block: false };
        self.transfer.outgoing = Some(self.transfer.object.payload(0x40, [0; 4]));
        Ok(())
    }

    /// Starts reading an object by block transfer. A server may also answer with a plain upload.
    ///
    /// # Errors
    /// [`SdoFailure::Busy`].
    pub fn start_block_upload(&mut self, now: Duration, object: (u16, u8)) -> Result<(), SdoError> {
        self.begin(now, object, &[])?;
        self.transfer.state = State::UploadRequested { is_block: true };
        self.transfer.outgoing = Some(self.transfer.object.payload(0xA4, [BLOCK_SIZE, 0, 0, 0]));
        Ok(())
    }

    /// Starts writing an object: expedited up to four bytes, in segments beyond.
    ///
    /// # Errors
    /// [`SdoFailure::Busy`] or [`SdoFailure::TooLong`].
    pub fn start_download(
        &mut self,
        now: Duration,
        object: (u16, u8),
        bytes: &[u8],
    ) -> Result<(), SdoError> {
        self.begin(now, object, bytes)?;
        let expedited = expedited(0x20, bytes);
        self.transfer.state = State::DownloadRequested {
            is_expedited: expedited.is_some(),
        };
        self.transfer.outgoing = Some(match expedited {
            Some((command, data)) => self.transfer.object.payload(command, data),
            None => self.transfer.object.payload_with_length(0x21, bytes.len()),
        });
        Ok(())
    }

    /// Starts writing an object by block transfer.
    ///
    /// # Errors
    /// [`SdoFailure::Busy`] or [`SdoFailure::TooLong`].
    pub fn start_block_download(
        &mut self,
        now: Duration,
        object: (u16, u8),
        bytes: &[u8],
    ) -> Result<(), SdoError> {
        self.begin(now, object, bytes)?;
        self.transfer.state = State::BlockDownloadRequested;
        self.transfer.outgoing = Some(self.transfer.object.payload_with_length(0xC6, bytes.len()));
        Ok(())
    }

    /// Handles a frame; frames that are no answer to this transfer are ignored.
    pub fn on_frame(&mut self, now: Duration, frame: &CanFrame) {
        let Some(answer) = payload_with_id(frame, self.response_id) else {
            if frame.standard_id() == Some(self.response_id) && self.is_busy() {
                self.short_bytes = Some(frame.data().len());
            }
            return;
        };
        match self.handle(&answer) {
            Ok(Step::Stale) => {}
            Ok(Step::Forward) => self.transfer.deadline = Some(now.saturating_add(self.timeout)),
            Ok(Step::Done) => {
                let value = std::mem::take(&mut self.transfer.buffer);
                self.finish(Ok(value));
            }
            Err(code) => self.give_up(code, SdoFailure::Broken(code)),
        }
    }

    /// Ends a transfer whose server has been silent for too long.
    pub fn on_tick(&mut self, now: Duration) {
        if self.transfer.is_overdue(now) {
            let silent = SdoFailure::TimedOut(self.timeout);
            let failure = self.short_bytes.map_or(silent, SdoFailure::Short);
            self.give_up(AbortCode::PROTOCOL_TIMED_OUT, failure);
        }
    }

    /// Drops the transfer in silence, with its result.
    pub fn reset(&mut self) {
        self.transfer.close();
        self.transfer.outgoing = None;
        self.result = None;
    }

    /// Returns the next frame to send.
    pub fn next_frame(&mut self) -> Option<CanFrame> {
        let payload = self.transfer.next_payload()?;
        Some(CanFrame::new(self.request_id, &payload))
    }

    /// Returns the time at which [`SdoClient::on_tick`] is due; `None` between transfers.
    pub fn next_deadline(&self) -> Option<Duration> {
        self.transfer.deadline
    }

    /// Returns the result of a transfer, once: the value that was read, or an empty one after a write. `None` during the
    /// transfer.
    pub fn take_result(&mut self) -> Option<Result<Vec<u8>, SdoError>> {
        self.result.take()
    }

    /// Prepares a transfer.
    fn begin(
        &mut self,
        now: Duration,
        (index, sub_index): (u16, u8),
        bytes: &[u8],
    ) -> Result<(), SdoError> {
        let refuse = |failure| SdoError {
            node_id: self.node_id,
            index,
            sub_index,
            failure,
        };
        if self.is_busy() {
            return Err(refuse(SdoFailure::Busy));
        }
        if bytes.len() > MAX_TRANSFER_BYTES {
            return Err(refuse(SdoFailure::TooLong(bytes.len())));
        }
        self.transfer.object = Multiplexer { index, sub_index };
        self.transfer.buffer.clear();
        self.transfer.buffer.extend_from_slice(bytes);
        self.result = None;
        self.short_bytes = None;
        self.transfer.deadline = Some(now.saturating_add(self.timeout));
        Ok(())
    }

    /// Ends the transfer.
    fn finish(&mut self, result: Result<Vec<u8>, SdoFailure>) {
        self.transfer.close();
        self.result = Some(result.map_err(|failure| SdoError {
            node_id: self.node_id,
            index: self.transfer.object.index,
            sub_index: self.transfer.object.sub_index,
            failure,
        }));
    }

    /// Ends the transfer and sends the server an abort.
    fn give_up(&mut self, code: AbortCode, failure: SdoFailure) {
        self.transfer.outgoing = Some(self.transfer.object.abort(code));
        self.finish(Err(failure));
    }

    /// Handles an answer in the present state.
    fn handle(&mut self, answer: &Payload) -> Accepted<Step> {
        if self.transfer.is_abort(answer) {
            return Ok(self.aborted(answer));
        }
        match self.transfer.state {
            State::UploadRequested { is_block } => self.upload_initiated(answer, is_block),
            State::Receiving { toggle } => self.upload_segment(answer, toggle),
            State::ReceivingBlock { stored } => self.transfer.receive_block_segment(answer, stored),
            State::BlockReceived => self.block_upload_end(answer),
            State::DownloadRequested { is_expedited } => {
                Ok(self.download_initiated(answer, is_expedited))
            }
            State::Sending { toggle, position } => self.download_segment(answer, toggle, position),
            State::BlockDownloadRequested => self.block_download_initiated(answer),
            State::SendingBlock(sender) if answer[0] >> 5 == 5 && answer[0] & 0b11 == 2 => {
                self.transfer.acknowledge_block(answer, sender)?;
                Ok(Step::Forward)
            }
            State::BlockSent if answer[0] == 0xA1 => Ok(self.written()),
            State::Idle | State::BlockPrepared(_) | State::SendingBlock(_) | State::BlockSent => {
                Ok(Step::Stale)
            }
        }
    }

    /// Handles the server's abort of this object.
    fn aborted(&mut self, answer: &Payload) -> Step {
        if self.is_busy() && Multiplexer::from_payload(answer) == self.transfer.object {
            let code = AbortCode(u32::from_le_bytes(data_bytes(answer)));
            self.finish(Err(SdoFailure::Aborted(code)));
        }
        Step::Stale
    }

    /// Ends a write: there is no value to return.
    fn written(&mut self) -> Step {
        self.transfer.buffer.clear();
        Step::Done
    }

    /// Handles the answer to either initiation of an upload.
    fn upload_initiated(&mut self, answer: &Payload, is_block: bool) -> Accepted<Step> {
        if Multiplexer::from_payload(answer) != self.transfer.object {
            return Ok(Step::Stale);
        }
        match answer[0] >> 5 {
            2 if answer[0] & 0b10 != 0 => {
                let length = expedited_length(answer[0]).unwrap_or(4);
                self.transfer
                    .buffer
                    .extend_from_slice(&data_bytes(answer)[..length]);
                Ok(Step::Done)
            }
            2 => {
                self.transfer.announced = announced_length(answer, answer[0] & 1 != 0)?;
                self.transfer.state = State::Receiving { toggle: false };
                self.transfer.outgoing = Some([0x60, 0, 0, 0, 0, 0, 0, 0]);
                Ok(Step::Forward)
            }
            6 if is_block && answer[0] & 1 == 0 => {
                self.transfer.announced = announced_length(answer, answer[0] & 0b10 != 0)?;
                self.transfer.with_crc = answer[0] & 0b100 != 0;
                self.transfer.state = State::ReceivingBlock { stored: 0 };
                self.transfer.outgoing = Some([0xA3, 0, 0, 0, 0, 0, 0, 0]);
                Ok(Step::Forward)
            }
            _ => Ok(Step::Stale),
        }
    }

    /// Handles a segment of a segmented upload.
    fn upload_segment(&mut self, answer: &Payload, toggle: bool) -> Accepted<Step> {
        if answer[0] >> 5 != 0 {
            return Ok(Step::Stale);
        }
        if self.transfer.receive_segment(answer, toggle)? {
            return Ok(Step::Done);
        }
        self.transfer.state = State::Receiving { toggle: !toggle };
        self.transfer.outgoing = Some([0x60 | u8::from(!toggle) << 4, 0, 0, 0, 0, 0, 0, 0]);
        Ok(Step::Forward)
    }

    /// Handles the end of a block upload.
    fn block_upload_end(&mut self, answer: &Payload) -> Accepted<Step> {
        if answer[0] >> 5 != 6 || answer[0] & 1 == 0 {
            return Ok(Step::Stale);
        }
        check_end(&mut self.transfer, answer)?;
        self.transfer.outgoing = Some([0xA1, 0, 0, 0, 0, 0, 0, 0]);
        Ok(Step::Done)
    }

    /// Handles the answer to the initiation of a plain download.
    fn download_initiated(&mut self, answer: &Payload, is_expedited: bool) -> Step {
        if answer[0] >> 5 != 3 || Multiplexer::from_payload(answer) != self.transfer.object {
            return Step::Stale;
        }
        if is_expedited {
            return self.written();
        }
        self.send_segment(false, 0);
        Step::Forward
    }

    /// Sends the segment at `position` of a segmented download.
    fn send_segment(&mut self, toggle: bool, position: usize) {
        self.transfer.send_segment(toggle, position);
        let position = position + SEGMENT_BYTES;
        self.transfer.state = State::Sending { toggle, position };
    }

    /// Handles the confirmation of a segment.
    fn download_segment(
        &mut self,
        answer: &Payload,
        toggle: bool,
        position: usize,
    ) -> Accepted<Step> {
        if answer[0] >> 5 != 1 {
            return Ok(Step::Stale);
        }
        check_toggle(answer, toggle)?;
        if position >= self.transfer.buffer.len() {
            return Ok(self.written());
        }
        self.send_segment(!toggle, position);
        Ok(Step::Forward)
    }

    /// Handles the answer to the initiation of a block download.
    fn block_download_initiated(&mut self, answer: &Payload) -> Accepted<Step> {
        let is_answer = answer[0] >> 5 == 5 && answer[0] & 0b11 == 0;
        if !is_answer || Multiplexer::from_payload(answer) != self.transfer.object {
            return Ok(Step::Stale);
        }
        self.transfer.state = State::SendingBlock(BlockSender::new(answer[4])?);
        self.transfer.with_crc = answer[0] & 0b100 != 0;
        Ok(Step::Forward)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use proptest::prelude::*;

    use super::*;
    use crate::object_dictionary::{Access, DataType, Entry, ObjectDictionary};
    use crate::sdo::bytes;
    use crate::sdo_server::SdoServer;

    const NOW: Duration = Duration::from_secs(3);

    fn client() -> SdoClient {
        SdoClient::new(0x10)
    }

    fn answer(client: &mut SdoClient, payload: &[u8]) {
        client.on_frame(NOW, &CanFrame::new(0x590, payload));
    }

    /// Returns the frames that the client wants to send.
    fn sent(client: &mut SdoClient) -> Vec<Vec<u8>> {
        std::iter::from_fn(|| client.next_frame())
            .inspect(|frame| assert_eq!(frame.standard_id(), Some(0x610)))
            .map(|frame| frame.data().to_vec())
            .collect()
    }

    /// Returns a started upload of 0x2000:00 whose request is sent.
    fn upload() -> SdoClient {
        let mut client = client();
        client.start_upload(NOW, (0x2000, 0)).unwrap();
        assert_eq!(sent(&mut client), [b"\x40\x00\x20\0\0\0\0\0"]);
        client
    }

    fn failure(client: &mut SdoClient, index: u16) -> SdoFailure {
        let error = client.take_result().unwrap().unwrap_err();
        assert!(!client.is_busy());
        assert_eq!(client.next_deadline(), None);
        assert_eq!(
            (error.node_id, error.index, error.sub_index),
            (0x10, index, 0)
        );
        error.failure
    }

    #[test]
    fn stale_answers_do_not_postpone_the_time_out() {
        let mut client = upload();
        let deadline = client.next_deadline();
        let late = NOW + Duration::from_millis(900);
        client.on_frame(late, &CanFrame::new(0x590, b"\x4F\x00\x20\x01\x63\0\0\0"));
        assert_eq!(client.next_deadline(), deadline);
    }

    #[test]
    fn answers_after_a_time_out_are_dropped() {
        let mut client = upload();
        client.on_tick(NOW + DEFAULT_TIMEOUT);
        sent(&mut client);
        client.take_result();
        client.start_download(NOW, (0x2000, 0), &[1]).unwrap();
        sent(&mut client);
        // The late answer to the upload names the same object.
        answer(&mut client, b"\x4F\x00\x20\0\x05\0\0\0");
        assert!(client.is_busy());
        answer(&mut client, b"\x60\x00\x20\0\0\0\0\0");
        assert_eq!(client.take_result(), Some(Ok(Vec::new())));
        answer(&mut client, b"\x60\x00\x20\0\0\0\0\0");
        assert_eq!(client.take_result(), None);
    }

    #[test]
    fn a_short_answer_is_no_silence() {
        let mut client = upload();
        answer(&mut client, b"\x4B\x00\x20\0\x05\0");
        assert!(client.is_busy());
        client.on_tick(NOW + DEFAULT_TIMEOUT);
        sent(&mut client);
        let failure = failure(&mut client, 0x2000);
        assert_eq!(failure, SdoFailure::Short(6));
        let text = "a short answer: 6 bytes in the frame (CiA 301: 8)";
        assert_eq!(failure.to_string(), text);
        // The next transfer does not know of it.
        client.start_upload(NOW, (0x2000, 0)).unwrap();
        client.on_tick(NOW + DEFAULT_TIMEOUT);
        sent(&mut client);
        let silent = SdoFailure::TimedOut(DEFAULT_TIMEOUT);
        assert_eq!(self::failure(&mut client, 0x2000), silent);
    }

    #[test]
    fn silence_times_out_and_aborts_at_the_server() {
        let mut client = upload();
        let deadline = NOW + DEFAULT_TIMEOUT;
        assert_eq!(client.next_deadline(), Some(deadline));
        client.on_tick(deadline - Duration::from_nanos(1));
        assert!(client.is_busy());
        client.on_tick(deadline);
        assert_eq!(sent(&mut client), [b"\x80\x00\x20\0\0\0\x04\x05"]);
        assert_eq!(
            failure(&mut client, 0x2000),
            SdoFailure::TimedOut(DEFAULT_TIMEOUT)
        );
    }

    #[test]
    fn one_transfer_at_a_time_and_none_too_long() {
        let mut client = upload();
        let error = client.start_download(NOW, (0x1017, 0), &[0]).unwrap_err();
        assert_eq!(error.failure, SdoFailure::Busy);
        answer(&mut client, b"\x4F\x00\x20\0\x05\0\0\0");
        assert_eq!(client.take_result(), Some(Ok(vec![5])));
        let long = vec![0; MAX_TRANSFER_BYTES + 1];
        let error = client.start_download(NOW, (0x1017, 0), &long).unwrap_err();
        assert_eq!(error.failure, SdoFailure::TooLong(MAX_TRANSFER_BYTES + 1));
        assert!(!client.is_busy());
    }

    #[test]
    fn another_channel_has_identifiers_of_11_bits() {
        let mut client = client().with_channel(0x8000 | 0x633, 0x8000 | 0x5B3);
        client.start_upload(NOW, (0x2000, 0)).unwrap();
        let request = client.next_frame().unwrap();
        assert_eq!(request.to_string(), "633#4000200000000000");
        let answer = CanFrame::new(0x5B3, b"\x4F\x00\x20\0\x05\0\0\0");
        client.on_frame(NOW, &answer);
        assert_eq!(client.take_result(), Some(Ok(vec![5])));
    }

    #[test]
    fn errors_name_node_object_and_reason() {
        let message = |failure| {
            SdoError {
                node_id: 0x10,
                index: 0x6060,
                sub_index: 0,
                failure,
            }
            .to_string()
        };
        assert_eq!(
            message(SdoFailure::Aborted(AbortCode::INVALID_VALUE)),
            "object 0x6060:00 of node 0x10: abort 0x0609_0030: invalid value for parameter"
        );
        assert_eq!(
            message(SdoFailure::TimedOut(DEFAULT_TIMEOUT)),
            "object 0x6060:00 of node 0x10: no answer within 1000 ms"
        );
    }

    #[test]
    fn each_exchange_is_led_as_cia_301_says() {
        let exchanges = include_str!("../tests/data/sdo_client_exchanges.log");
        exchanges.split("\n\n").for_each(replay);
    }

    #[test]
    fn requests_satisfy_python_canopens_server() {
        replay(include_str!(
            "../tests/data/sdo_server_of_python_canopen.log"
        ));
    }

    #[test]
    fn requests_satisfy_canopennodes_server_with_block_transfer() {
        replay(include_str!("../tests/data/sdo_server_of_canopennode.log"));
    }

    /// Replays a session with a server, and compares the client's frames and results with it.
    fn replay(transcript: &str) {
        let mut client = client();
        let (mut requests, mut index) = (VecDeque::new(), 0);
        for line in transcript.lines().filter(|line| !line.starts_with(';')) {
            let code = |code| AbortCode(u32::from_str_radix(code, 16).unwrap());
            let parts: Vec<_> = line.split([' ', '#']).collect();
            match parts[..] {
                [">", ref command @ ..] => index = start(&mut client, command),
                ["610", request] => {
                    let request = Some(bytes(request));
                    assert_eq!(requests.pop_front(), request, "{line} of {transcript}");
                }
                ["590", payload] => {
                    assert_eq!(requests, [[0; 0]; 0], "before {line} of {transcript}");
                    answer(&mut client, &bytes(payload));
                }
                ["=", value] => assert_eq!(client.take_result(), Some(Ok(bytes(value)))),
                ["!", text] => {
                    assert_eq!(failure(&mut client, index), SdoFailure::Aborted(code(text)));
                }
                ["?", text] => {
                    assert_eq!(failure(&mut client, index), SdoFailure::Broken(code(text)));
                }
                _ => panic!("{line}"),
            }
            requests.extend(sent(&mut client));
        }
        assert_eq!(requests, [[0; 0]; 0], "at the end of {transcript}");
        assert!(client.take_result().is_none() && !client.is_busy());
    }

    /// Starts the transfer of a transcript's command; returns the index of its object.
    fn start(client: &mut SdoClient, command: &[&str]) -> u16 {
        let index = u16::from_str_radix(command[1], 16).unwrap();
        match *command {
            ["UP", _] => client.start_upload(NOW, (index, 0)).unwrap(),
            ["BUP", _] => client.start_block_upload(NOW, (index, 0)).unwrap(),
            ["DOWN", _, value] => client
                .start_download(NOW, (index, 0), &bytes(value))
                .unwrap(),
            ["BDOWN", _, value] => client
                .start_block_download(NOW, (index, 0), &bytes(value))
                .unwrap(),
            _ => panic!("{command:?}"),
        }
        index
    }

    /// Effect of the bus on a frame.
    #[derive(Clone, Copy, Debug)]
    enum Fate {
        Delivered,
        Lost,
        Doubled,
    }

    /// A client and a server on a bus that loses and doubles frames.
    struct Bus {
        client: SdoClient,
        server: SdoServer,
        objects: ObjectDictionary,
        now: Duration,
        fates: std::vec::IntoIter<Fate>,
        to_server: VecDeque<CanFrame>,
        to_client: VecDeque<CanFrame>,
    }

    impl Bus {
        fn new(value: &[u8], fates: Vec<Fate>) -> Self {
            let mut objects = ObjectDictionary::new();
            for (index, value) in [(0x2000, value.to_vec()), (0x2001, b"alive".to_vec())] {
                let (data_type, access) = (DataType::Domain, Access::ReadWrite);
                objects.insert(Entry::new(index, 0, "", data_type, access, value));
            }
            Self {
                client: client(),
                server: SdoServer::for_node(0x10),
                objects,
                now: NOW,
                fates: fates.into_iter(),
                to_server: VecDeque::new(),
                to_client: VecDeque::new(),
            }
        }

        fn value(&self) -> &[u8] {
            let handle = self.objects.find(0x2000, 0).unwrap();
            self.objects.entry(handle).value()
        }

        /// Puts all queued frames on the bus.
        fn drain(&mut self) {
            let mut put = |queue: &mut VecDeque<CanFrame>, frame| {
                let copies = match self.fates.next().unwrap_or(Fate::Delivered) {
                    Fate::Lost => 0,
                    Fate::Delivered => 1,
                    Fate::Doubled => 2,
                };
                queue.extend(std::iter::repeat_n(frame, copies));
            };
            while let Some(frame) = self.client.next_frame() {
                put(&mut self.to_server, frame);
            }
            while let Some(frame) = self.server.next_frame() {
                put(&mut self.to_client, frame);
            }
        }

        /// Runs until both sides rest.
        fn run(&mut self) -> Result<Vec<u8>, SdoError> {
            for _ in 0..5_000 {
                self.drain();
                self.now += Duration::from_micros(100);
                let deadlines = [self.client.next_deadline(), self.server.next_deadline()];
                if let Some(frame) = self.to_server.pop_front() {
                    self.server.on_frame(self.now, &frame, &mut self.objects);
                } else if let Some(frame) = self.to_client.pop_front() {
                    self.client.on_frame(self.now, &frame);
                } else if let Some(deadline) = deadlines.into_iter().flatten().min() {
                    self.now = self.now.max(deadline);
                    self.client.on_tick(self.now);
                    self.server.on_tick(self.now);
                } else {
                    return self.client.take_result().expect("the transfer ended");
                }
            }
            panic!("the transfer is wedged");
        }

        fn upload(&mut self, is_block: bool) -> Result<Vec<u8>, SdoError> {
            let (client, now) = (&mut self.client, self.now);
            if is_block {
                client.start_block_upload(now, (0x2000, 0))?;
            } else {
                client.start_upload(now, (0x2000, 0))?;
            }
            self.run()
        }

        fn download(&mut self, is_block: bool, value: &[u8]) -> Result<Vec<u8>, SdoError> {
            let (client, now) = (&mut self.client, self.now);
            if is_block {
                client.start_block_download(now, (0x2000, 0), value)?;
            } else {
                client.start_download(now, (0x2000, 0), value)?;
            }
            self.run()
        }

        /// Checks that on a bus without faults the next transfer works.
        fn is_alive(&mut self) -> bool {
            self.fates = Vec::new().into_iter();
            self.client.start_upload(self.now, (0x2001, 0)).unwrap();
            self.run() == Ok(b"alive".to_vec())
        }
    }

    /// Returns values of all three modes: expedited, segmented, several blocks.
    fn value() -> impl Strategy<Value = Vec<u8>> {
        prop_oneof![
            1 => proptest::collection::vec(any::<u8>(), 0..=8),
            2 => proptest::collection::vec(any::<u8>(), 0..2000),
        ]
    }

    /// Returns about one fault in forty frames.
    fn fates() -> impl Strategy<Value = Vec<Fate>> {
        let fate = prop_oneof![38 => Just(Fate::Delivered), 1 => Just(Fate::Lost), 1 => Just(Fate::Doubled)];
        proptest::collection::vec(fate, 0..1500)
    }

    proptest! {
        #[test]
        fn values_of_all_sizes_survive_both_ways(value in value(), is_block: bool) {
            let mut bus = Bus::new(&value, Vec::new());
            prop_assert_eq!(bus.upload(is_block), Ok(value.clone()));
            let reversed: Vec<u8> = value.iter().rev().copied().collect();
            prop_assert_eq!(bus.download(is_block, &reversed), Ok(Vec::new()));
            prop_assert_eq!(bus.value(), reversed);
        }

        #[test]
        fn faults_end_an_upload_cleanly(value in value(), is_block: bool, fates in fates()) {
            let mut bus = Bus::new(&value, fates);
            if let Ok(read) = bus.upload(is_block) {
                prop_assert_eq!(read, value);
            }
            prop_assert!(bus.is_alive());
        }

        #[test]
        fn faults_end_a_download_cleanly(value in value(), is_block: bool, fates in fates()) {
            let mut bus = Bus::new(b"before", fates);
            match bus.download(is_block, &value) {
                Ok(_) => prop_assert_eq!(bus.value(), &value[..]),
                // The confirmation may have been lost, but the object has the old or the new value, never a mixture.
                Err(_) => prop_assert!(bus.value() == value || bus.value() == b"before"),
            }
            prop_assert!(bus.is_alive());
        }

        #[test]
        fn lost_segments_of_a_block_are_sent_again(value in proptest::collection::vec(any::<u8>(), 900..2000), lost in 2_usize..100) {
            // The first frames are the request, its answer and the start of the upload; the last of a block is kept.
            let mut fates = vec![Fate::Delivered; lost + 1];
            fates.push(Fate::Lost);
            prop_assert_eq!(Bus::new(b"", fates.clone()).download(true, &value), Ok(Vec::new()));
            fates.insert(0, Fate::Delivered);
            prop_assert_eq!(Bus::new(&value, fates).upload(true), Ok(value));
        }

        #[test]
        fn arbitrary_answers_never_panic_or_wedge(
            transfer in 0_u8..4,
            answers in proptest::collection::vec((any::<u8>(), 0_usize..=8, any::<[u8; 4]>()), 0..60),
        ) {
            let mut client = client();
            match transfer {
                0 => client.start_upload(NOW, (0x2000, 0)).unwrap(),
                1 => client.start_block_upload(NOW, (0x2000, 0)).unwrap(),
                2 => client.start_download(NOW, (0x2000, 0), &[7; 100]).unwrap(),
                _ => client.start_block_download(NOW, (0x2000, 0), &[7; 1000]).unwrap(),
            }
            let object = Multiplexer { index: 0x2000, sub_index: 0 };
            for (command, length, data) in answers {
                // Mostly whole frames for this object.
                let length = if length < 7 { 8 } else { length };
                answer(&mut client, &object.payload(command, data)[..length]);
                prop_assert!(sent(&mut client).len() <= 128);
                prop_assert_eq!(client.is_busy(), client.next_deadline().is_some());
            }
            client.on_tick(NOW + DEFAULT_TIMEOUT);
            prop_assert!(!client.is_busy());
            prop_assert!(client.take_result().is_some());
        }
    }
}
