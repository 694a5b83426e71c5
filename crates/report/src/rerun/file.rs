//! `run.rrd` as a place where a recording goes.
//!
//! All parts of the file are the SDK's, but it is put together here. The SDK's own writer takes messages, and parses
//! each of them back into the chunk that it was made of, twice: to learn whether it is static, and for the table of
//! contents. That was the dearest part of the file.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::mem;
use std::path::Path;

use re_protos::common::v1alpha1::Compression;
use re_protos::external::prost::Message;
use re_protos::external::prost::encoding::{WireType, encode_key, encode_varint};
use re_protos::log_msg::v1alpha1::{ArrowMsg, Encoding, RrdFooter};
use re_span::Span;
use rerun::RecordingStreamError;
use rerun::external::arrow::array::RecordBatch;
use rerun::external::arrow::error::ArrowError;
use rerun::external::arrow::ipc::writer::{
    DictionaryTracker, IpcDataGenerator, IpcWriteOptions, write_message,
};
use rerun::external::re_log_encoding::{
    self as encoding, CodecError, Encodable, EncodeError, EncodingOptions, MessageHeader,
    MessageKind, RRD_FOURCC, StreamFooter, StreamHeader, ToTransport,
};
use rerun::external::re_log_types::{BlueprintActivationCommand, LogMsg, StoreId, StoreInfo};
use rerun::log::Chunk;

use super::contents::Contents;
use super::fields::Fields;
use super::output::{Output, begin};

type Written = Result<(), EncodeError>;

/// Most of the messages are far shorter, and are handed on together.
const BUFFER_BYTES: usize = 64 * 1024;
/// Number of the field `payload` of an `ArrowMsg`.
const PAYLOAD_FIELD: u32 = 5;
/// What lies around two messages of an Arrow stream.
const FRAMES_BYTES_MAX: usize = 2 * (8 + 64);
/// The end of an Arrow stream.
const END_OF_STREAM: [u8; 8] = [0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0];

/// A recording on its way to the disk. It is not compressed: that would halve it, and was the dearest single part of a
/// whole simulation. Nor does a stream of the SDK lie between, whose threads and queues serve those who may not wait.
pub(super) struct RecordingFile {
    info: StoreInfo,
    file: BufWriter<File>,
    bytes_written: u64,
    /// What lies where, of the recording and of its layout.
    contents: BTreeMap<StoreId, Contents>,
    fields: Fields,
    /// What went wrong first; nothing is written after it.
    outcome: Written,
}

impl RecordingFile {
    pub(super) fn create(path: &Path, info: StoreInfo) -> Result<Self, EncodeError> {
        let mut file = Self {
            info: info.clone(),
            file: BufWriter::with_capacity(BUFFER_BYTES, File::create(path)?),
            bytes_written: 0,
            contents: BTreeMap::new(),
            fields: Fields::default(),
            outcome: Ok(()),
        };
        file.write_part(&StreamHeader {
            fourcc: RRD_FOURCC,
            version: rerun::build_info().version.to_bytes(),
            options: EncodingOptions::PROTOBUF_UNCOMPRESSED,
        })?;
        file.write_message(&begin(info))?;
        Ok(file)
    }

    /// Writes what is still missing.
    pub(super) fn finish(mut self) -> Written {
        self.then(Self::write_table);
        self.outcome
    }

    /// Writes the table of contents: it is the last message, and the last bytes say where it is.
    fn write_table(&mut self) -> Written {
        let manifests = mem::take(&mut self.contents).into_iter();
        let manifests = manifests.map(|(store, contents)| contents.manifest(store));
        let manifests: Result<_, ArrowError> = manifests.collect();
        let table = RrdFooter {
            manifests: manifests.map_err(CodecError::ArrowSerialization)?,
        };
        let table = table.encode_to_vec();
        self.write_part(&MessageHeader {
            kind: MessageKind::End,
            len: table.len() as u64,
        })?;
        let place = self.bytes_written;
        self.write(&table)?;
        self.write_part(&StreamFooter::from_rrd_footer_bytes(place, &table))?;
        Ok(self.file.flush()?)
    }

    /// Does what is to be done if nothing went wrong yet.
    fn then(&mut self, write: impl FnOnce(&mut Self) -> Written) {
        if self.outcome.is_ok() {
            self.outcome = write(self);
        }
    }

    fn write_chunk(&mut self, store: &StoreId, chunk: &Chunk) -> Written {
        let batch = self.fields.batch(chunk);
        let stream = batch.and_then(|batch| ipc_stream(&batch));
        let (head, rows) = stream.map_err(CodecError::ArrowSerialization)?;
        let payload_bytes = (head.len() + rows.len() + END_OF_STREAM.len()) as u64;
        let message = ArrowMsg {
            store_id: Some(store.clone().into()),
            chunk_id: Some(chunk.id().as_tuid().into()),
            compression: Compression::None.into(),
            uncompressed_size: payload_bytes,
            encoding: Encoding::ArrowIpc.into(),
            is_static: Some(chunk.is_static()),
            ..ArrowMsg::default()
        };
        // The payload follows as the last field, so that the rows are not copied into the message first.
        let mut message = message.encode_to_vec();
        encode_key(PAYLOAD_FIELD, WireType::LengthDelimited, &mut message);
        encode_varint(payload_bytes, &mut message);
        let len = message.len() as u64 + payload_bytes;
        let kind = MessageKind::ArrowMsg;
        self.write_part(&MessageHeader { kind, len })?;
        let span = Span::from_start_len(self.bytes_written, len);
        for piece in [&message[..], &head, &rows, &END_OF_STREAM] {
            self.write(piece)?;
        }
        let contents = self.contents.entry(store.clone()).or_default();
        contents.append(chunk, span, payload_bytes);
        Ok(())
    }

    fn write_message(&mut self, message: &LogMsg) -> Written {
        self.write_part(&message.to_transport(encoding::Compression::Off)?)
    }

    fn write_part(&mut self, part: &impl Encodable) -> Written {
        let mut bytes = Vec::new();
        part.to_rrd_bytes(&mut bytes)?;
        self.write(&bytes)
    }

    fn write(&mut self, bytes: &[u8]) -> Written {
        self.bytes_written += bytes.len() as u64;
        Ok(self.file.write_all(bytes)?)
    }
}

/// Rows as an Arrow stream that lacks its end: what says where they are, and the rows themselves.
fn ipc_stream(batch: &RecordBatch) -> Result<(Vec<u8>, Vec<u8>), ArrowError> {
    let (encoder, options) = (IpcDataGenerator::default(), IpcWriteOptions::default());
    let mut dictionaries = DictionaryTracker::new(false);
    let schema = encoder.schema_to_bytes_with_dictionary_tracker(
        batch.schema_ref(),
        &mut dictionaries,
        &options,
    );
    // No column has a dictionary.
    let (_, mut encoded) =
        encoder.encode(batch, &mut dictionaries, &options, &mut Default::default())?;
    let rows = mem::take(&mut encoded.arrow_data);
    let bytes = schema.ipc_message.len() + encoded.ipc_message.len();
    let mut head = Vec::with_capacity(bytes + FRAMES_BYTES_MAX);
    write_message(&mut head, schema, &options)?;
    write_message(&mut head, encoded, &options)?;
    Ok((head, rows))
}

impl Output for RecordingFile {
    fn info(&self) -> Option<StoreInfo> {
        Some(self.info.clone())
    }

    fn send(&mut self, chunk: Chunk) {
        let store = self.info.store_id.clone();
        self.then(|file| file.write_chunk(&store, &chunk));
    }

    fn send_layout(
        &mut self,
        info: StoreInfo,
        layout: Vec<Chunk>,
        show: BlueprintActivationCommand,
    ) -> Result<(), RecordingStreamError> {
        let store = info.store_id.clone();
        self.then(|file| {
            file.write_message(&begin(info))?;
            for chunk in &layout {
                file.write_chunk(&store, chunk)?;
            }
            file.write_message(&show.into())
        });
        Ok(())
    }
}
