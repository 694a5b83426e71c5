//! Vector's binary log of CAN frames, without compression, as the format permits.

use std::io::{self, Write};
use std::time::Duration;

use super::MARKED_ID_BITS;
use super::asc::utc;
use recording::frames::Frames;
use recording::log::Stamped;

const FILE_HEADER_BYTES: u32 = 144;
const OBJECT_HEADER_BYTES: u16 = 32;
const CONTAINER_HEADER_BYTES: u16 = 16;
/// Approximate size of the frames in one container, in bytes.
const CONTAINER_BYTES_MAX: usize = 128 * 1024;

const LOG_CONTAINER: u32 = 10;
const CAN_MESSAGE: u32 = 1;
const CAN_ERROR_EXT: u32 = 73;
/// Flag of time stamps in nanoseconds.
const NANOSECONDS: u32 = 2;
const CHANNEL: u16 = 1;
const REMOTE: u8 = 0x80;

/// Writes the log to an output with a buffer. Times count from the whole millisecond of the first frame, which the header gives
/// in UTC. The frames are read twice, since the header has their number and length.
///
/// # Errors
/// If the output does not take it.
pub fn write(mut output: impl Write, frames: &Frames) -> io::Result<()> {
    let start_millis = frames.start().unwrap_or_default().as_millis();
    let start = Duration::from_millis(u64::try_from(start_millis).unwrap_or(u64::MAX));
    let (mut end, mut bytes) = (start, 0);
    write_containers(frames, start, |container, last| {
        (end, bytes) = (last, bytes + container.len());
        Ok(())
    })?;
    let whole_bytes = u64::from(FILE_HEADER_BYTES) + bytes as u64;
    let mut header = Vec::with_capacity(FILE_HEADER_BYTES as usize);
    header.extend_from_slice(b"LOGG");
    header.extend_from_slice(&FILE_HEADER_BYTES.to_le_bytes());
    // Application: number 5, version 0.0.0; format 2.6.8.1.
    header.extend_from_slice(&[5, 0, 0, 0, 2, 6, 8, 1]);
    // Sizes as stored, and without compression: the same.
    header.extend_from_slice(&whole_bytes.to_le_bytes());
    header.extend_from_slice(&whole_bytes.to_le_bytes());
    let count = u32::try_from(frames.len()).unwrap_or(u32::MAX);
    header.extend_from_slice(&count.to_le_bytes());
    header.extend_from_slice(&[0; 4]);
    push_system_time(&mut header, start);
    push_system_time(&mut header, end);
    header.resize(FILE_HEADER_BYTES as usize, 0);
    output.write_all(&header)?;
    write_containers(frames, start, |container, _| output.write_all(container))
}

/// Makes the containers of all frames one by one, each with the time of its last frame.
fn write_containers(
    frames: &Frames,
    start: Duration,
    mut write: impl FnMut(&[u8], Duration) -> io::Result<()>,
) -> io::Result<()> {
    let (mut container, mut content) = (Vec::new(), Vec::new());
    let mut rest = frames.iter().peekable();
    while let Some(stamped) = rest.next() {
        push_frame(&mut content, &stamped, start);
        if content.len() >= CONTAINER_BYTES_MAX || rest.peek().is_none() {
            container.clear();
            push_container(&mut container, &mut content);
            write(&container, stamped.time)?;
        }
    }
    Ok(())
}

/// Appends the start of an object.
fn push_base(bytes: &mut Vec<u8>, header_bytes: u16, object_bytes: u32, kind: u32) {
    bytes.extend_from_slice(b"LOBJ");
    bytes.extend_from_slice(&header_bytes.to_le_bytes());
    bytes.extend_from_slice(&1u16.to_le_bytes());
    bytes.extend_from_slice(&object_bytes.to_le_bytes());
    bytes.extend_from_slice(&kind.to_le_bytes());
}

fn push_frame(content: &mut Vec<u8>, Stamped { time, frame, .. }: &Stamped, start: Duration) {
    let (kind, object_bytes) = if frame.is_error() {
        (CAN_ERROR_EXT, 64)
    } else {
        (CAN_MESSAGE, 48)
    };
    push_base(content, OBJECT_HEADER_BYTES, object_bytes, kind);
    content.extend_from_slice(&NANOSECONDS.to_le_bytes());
    content.extend_from_slice(&[0; 4]);
    let nanos = u64::try_from(time.saturating_sub(start).as_nanos()).unwrap_or(u64::MAX);
    content.extend_from_slice(&nanos.to_le_bytes());
    content.extend_from_slice(&CHANNEL.to_le_bytes());
    if frame.is_error() {
        // The details of an error in a log of candump have no place here.
        content.extend_from_slice(&[0; 30]);
        return;
    }
    content.push(if frame.is_remote() { REMOTE } else { 0 });
    content.push(frame.length());
    let id = frame.raw_id() & MARKED_ID_BITS;
    content.extend_from_slice(&id.to_le_bytes());
    content.extend_from_slice(&frame.buffer());
}

/// Appends the content as one container and empties it.
fn push_container(containers: &mut Vec<u8>, content: &mut Vec<u8>) {
    let size = u32::try_from(content.len()).unwrap_or(u32::MAX);
    let object_bytes = size + u32::from(CONTAINER_HEADER_BYTES) + 16;
    push_base(
        containers,
        CONTAINER_HEADER_BYTES,
        object_bytes,
        LOG_CONTAINER,
    );
    // No compression.
    containers.extend_from_slice(&[0; 8]);
    containers.extend_from_slice(&size.to_le_bytes());
    containers.extend_from_slice(&[0; 4]);
    containers.append(content);
}

/// Appends a SYSTEMTIME of Windows.
fn push_system_time(file: &mut Vec<u8>, time: Duration) {
    let date = utc(time);
    for field in [
        date.year(),
        date.month().into(),
        date.weekday().to_sunday_zero_offset().into(),
        date.day().into(),
        date.hour().into(),
        date.minute().into(),
        date.second().into(),
        date.millisecond(),
    ] {
        file.extend_from_slice(&field.to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use can::CanFrame;

    /// The date of `date -u -d @951782400`, and half a second.
    #[test]
    fn a_date_has_its_day_of_the_week_and_its_milliseconds() {
        let mut bytes = Vec::new();
        push_system_time(&mut bytes, Duration::from_millis(951_782_400_500));
        let fields = bytes.as_chunks().0.iter().copied().map(u16::from_le_bytes);
        assert!(fields.eq([2000, 2, 2, 29, 0, 0, 0, 500]));
    }

    #[test]
    fn sizes_add_up() {
        let frames: Vec<Stamped> = (0..10_000u64)
            .map(|number| {
                Stamped::new(
                    Duration::from_micros(number * 130),
                    CanFrame::new(0x190, &[1, 2]),
                )
            })
            .collect();
        let mut file = Vec::new();
        write(&mut file, &frames.clone().into()).unwrap();
        assert_eq!(&file[..4], b"LOGG");
        assert_eq!(
            u64::from_le_bytes(file[16..24].try_into().unwrap()),
            file.len() as u64
        );
        let mut place = FILE_HEADER_BYTES as usize;
        let mut content = 0;
        while place < file.len() {
            assert_eq!(&file[place..place + 4], b"LOBJ");
            let object =
                u32::from_le_bytes(file[place + 8..place + 12].try_into().unwrap()) as usize;
            content +=
                u32::from_le_bytes(file[place + 24..place + 28].try_into().unwrap()) as usize;
            place += object;
        }
        assert_eq!(place, file.len());
        assert_eq!(content, 48 * frames.len());
    }
}
