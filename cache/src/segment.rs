//! Segments: append-only files, written by one store instance and read by all.
//!
//! A pack segment holds small blobs, a log segment holds records. Both are sequences of checksummed frames, so that a
//! torn tail is detected and ignored:
//!
//! ```text
//! pack frame   "TFB1"  size u64  blake3 of the blob [32]  check u64  blob
//! log frame    "TFR1"  length u32  check [16]  body
//! log body     0x01 record | 0x02 commit mark: u64 offset
//! ```
//! A commit mark says that the blobs of every record before that offset in the same segment were durable when the mark
//! was written. Knows no index.

use crate::{
    codec::{Fields, Put},
    layout::{is_owner, open_plain},
    record::sum,
};
use std::{
    fs::File,
    io::{self, BufReader, Read, Seek, SeekFrom},
    os::unix::fs::FileExt,
    path::{Path, PathBuf},
    sync::Arc,
};

const BLOB_MAGIC: &[u8; 4] = b"TFB1";
const RECORD_MAGIC: &[u8; 4] = b"TFR1";
/// Bytes of a pack frame before its blob.
pub(crate) const BLOB_HEADER: u64 = 52;
/// Bytes of a log frame before its body.
pub(crate) const RECORD_HEADER: u64 = 24;
/// Largest body of a log frame.
pub(crate) const MAX_BODY: u64 = 256 << 20;
/// Largest blob of a pack, far above what is put there: memory is taken by what a frame says.
pub(crate) const MAX_PACKED: u64 = 16 << 20;
/// More bytes than a segment ever has; a longer one is not looked through.
const LONGEST: u64 = 600 << 20;
/// Bytes that are looked through at once for the frame after damage, at most and at first: the next one may be near,
/// and there may be many.
const RESYNC: usize = 1 << 20;
const RESYNC_FIRST: usize = 4 << 10;
/// Bytes of frames that turn out to be damaged are read so many times at most, for each byte of a log. Frames that lie
/// in each other, which no accident makes, would else be read once for each of them.
const IN_VAIN: u64 = 8;
const RECORD: u8 = 1;
const COMMIT: u8 = 2;

/// The two sorts of segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sort {
    Pack,
    Log,
}

impl Sort {
    pub fn folder(self) -> &'static str {
        match self {
            Self::Pack => "packs",
            Self::Log => "log",
        }
    }

    pub fn extension(self) -> &'static str {
        match self {
            Self::Pack => "pack",
            Self::Log => "log",
        }
    }

    /// `<seq>-<owner>.<extension>`: names sort by sequence number.
    pub fn name(self, seq: u64, owner: &str) -> String {
        format!("{seq:010}-{owner}.{}", self.extension())
    }

    /// Sequence number and owner out of a file name of this sort, which is exactly as `name` makes it.
    pub fn parse(self, name: &str) -> Option<(u64, &str)> {
        let (digits, owner) = name.strip_suffix(self.extension())?.strip_suffix('.')?.split_once('-')?;
        let seq: u64 = digits.parse().ok()?;
        (is_owner(owner) && format!("{seq:010}") == digits).then_some((seq, owner))
    }
}

/// A pack frame for a blob of known hash.
pub(crate) fn blob_frame(hash: &[u8; 32], bytes: &[u8]) -> Vec<u8> {
    let mut frame = Vec::with_capacity(BLOB_HEADER as usize + bytes.len());
    frame.extend_from_slice(BLOB_MAGIC);
    frame.u64(bytes.len() as u64);
    frame.extend_from_slice(hash);
    let check = sum(&frame);
    frame.u64(check);
    frame.extend_from_slice(bytes);
    frame
}

fn log_frame(kind: u8, body: &[u8]) -> Vec<u8> {
    let mut tagged = Vec::with_capacity(body.len() + 1);
    tagged.u8(kind);
    tagged.extend_from_slice(body);
    let mut frame = Vec::with_capacity(RECORD_HEADER as usize + tagged.len());
    frame.extend_from_slice(RECORD_MAGIC);
    frame.u32(tagged.len() as u32); // below MAX_BODY, which callers check
    frame.extend_from_slice(&blake3::hash(&tagged).as_bytes()[..16]);
    frame.extend_from_slice(&tagged);
    frame
}

/// A log frame for an encoded record.
pub(crate) fn record_frame(record: &[u8]) -> Vec<u8> {
    log_frame(RECORD, record)
}

/// A log frame saying that all records before `covered` have durable blobs.
pub(crate) fn commit_frame(covered: u64) -> Vec<u8> {
    log_frame(COMMIT, &covered.to_le_bytes())
}

/// A blob found in a pack: `offset` is that of its bytes.
pub(crate) struct PackedBlob {
    pub hash: [u8; 32],
    pub size: u64,
    pub offset: u64,
}

/// Where a scan of a segment ended, and what it passed over.
#[derive(Default)]
pub(crate) struct Scan {
    /// Offset of the first frame that is incomplete or foreign.
    pub end: u64,
    /// Frames, or stretches between frames, that were damaged.
    pub damaged: u64,
}

/// Walks the frames of a pack from `from`; returns where the first incomplete or foreign frame begins. Blobs are not
/// read, only their headers. If `whole` is set, because no process appends any more, a damaged header before an intact
/// frame is skipped.
pub(crate) fn scan_pack(path: &Path, from: u64, whole: bool, mut found: impl FnMut(PackedBlob)) -> io::Result<Scan> {
    let file = open_plain(path)?;
    let len = file.metadata()?.len();
    let frame = |at: u64| -> io::Result<Option<PackedBlob>> {
        let mut header = [0; BLOB_HEADER as usize];
        if at.checked_add(BLOB_HEADER).is_none_or(|end| end > len) || !read_at(&file, &mut header, at)? {
            return Ok(None);
        }
        let offset = at + BLOB_HEADER;
        let parsed = parse_blob_header(&header).filter(|(_, size)| *size <= len - offset);
        Ok(parsed.map(|(hash, size)| PackedBlob { hash, size, offset }))
    };
    let mut scan = Scan { end: from, damaged: 0 };
    loop {
        let blob = match frame(scan.end)? {
            Some(blob) => blob,
            // Torn, still being written, or damaged.
            None if whole => match next_frame(&file, scan.end + 1, BLOB_MAGIC, |at| Ok(frame(at)?.is_some()))? {
                Some(at) => {
                    scan.damaged += 1;
                    scan.end = at;
                    continue;
                }
                None => return Ok(scan),
            },
            None => return Ok(scan),
        };
        scan.end = blob.offset + blob.size;
        found(blob);
    }
}

/// Reads bytes at a place; whether they are there.
fn read_at(file: &File, bytes: &mut [u8], at: u64) -> io::Result<bool> {
    match file.read_exact_at(bytes, at) {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(false),
        other => other.map(|()| true),
    }
}

/// The first place from `from` on where a frame begins: the magic stands there, and `good` says so.
fn next_frame(
    file: &File,
    from: u64,
    magic: &[u8; 4],
    mut good: impl FnMut(u64) -> io::Result<bool>,
) -> io::Result<Option<u64>> {
    if file.metadata()?.len() > LONGEST {
        return Ok(None);
    }
    let mut at = from;
    let mut bytes = vec![0; RESYNC_FIRST];
    loop {
        let read = file.read_at(&mut bytes, at)?;
        let mut place = 0;
        while let Some(step) = bytes[place..read].iter().position(|byte| *byte == magic[0]) {
            place += step;
            if bytes[place..read].starts_with(magic) && good(at + place as u64)? {
                return Ok(Some(at + place as u64));
            }
            place += 1;
        }
        if read < magic.len() {
            return Ok(None);
        }
        at += (read + 1 - magic.len()) as u64; // a magic may lie across the border
        bytes.resize((bytes.len() * 4).min(RESYNC), 0);
    }
}

fn parse_blob_header(header: &[u8; BLOB_HEADER as usize]) -> Option<([u8; 32], u64)> {
    let mut fields = Fields(header);
    let magic = fields.take(4)?;
    let size = fields.u64()?;
    let hash = fields.array()?;
    let check = fields.u64()?;
    (magic == BLOB_MAGIC && check == sum(&header[..44]) && size <= MAX_PACKED).then_some((hash, size))
}

/// The entry of a log segment at an offset.
pub(crate) enum LogEntry<'a> {
    Record(&'a [u8]),
    Commit(u64),
}

/// Walks the frames of a log from `from`. A damaged frame that is followed by another frame, or by the end, is stepped
/// over; with `whole`, when nobody appends any more, so is a damaged header.
pub(crate) fn scan_log(
    path: &Path,
    from: u64,
    whole: bool,
    mut found: impl FnMut(u64, LogEntry<'_>),
) -> io::Result<Scan> {
    let file = open_plain(path)?;
    let len = file.metadata()?.len();
    let probe = file.try_clone()?;
    let mut reader = BufReader::with_capacity(1 << 20, file);
    reader.seek(SeekFrom::Start(from))?;
    let mut scan = Scan { end: from, damaged: 0 };
    let mut body = Vec::new();
    let mut left = len.saturating_mul(IN_VAIN);
    loop {
        let step = match read_frame(&mut reader, scan.end, len, &mut body)? {
            None => Step::Lost,
            Some((next, true)) => {
                match parse_body(&body) {
                    Some(entry) => found(scan.end, entry),
                    None => scan.damaged += 1,
                }
                Step::To(next)
            }
            Some((next, false)) => {
                left = left.saturating_sub(next - scan.end);
                let mut magic = [0; 4];
                if next == len || (read_at(&probe, &mut magic, next)? && &magic == RECORD_MAGIC) {
                    scan.damaged += 1;
                    Step::To(next)
                } else {
                    Step::Lost
                }
            }
        };
        scan.end = match step {
            Step::To(next) => next,
            Step::Lost if !whole => return Ok(scan),
            Step::Lost => {
                let mut good = |at: u64| {
                    if left == 0 {
                        return Ok(false);
                    }
                    let found = read_frame(&mut Positioned { file: &probe, at }, at, len, &mut body)?;
                    if let Some((next, false)) = found {
                        left = left.saturating_sub(next - at);
                    }
                    Ok(matches!(found, Some((_, true))))
                };
                let Some(at) = next_frame(&probe, scan.end + 1, RECORD_MAGIC, &mut good)? else { return Ok(scan) };
                scan.damaged += 1;
                // Within what is read already, as the next frame mostly is, this reads nothing.
                let here = reader.stream_position()?;
                match i64::try_from(i128::from(at) - i128::from(here)) {
                    Ok(step) => reader.seek_relative(step)?,
                    Err(_) => drop(reader.seek(SeekFrom::Start(at))?),
                }
                at
            }
        };
    }
}

/// Reads a file from a place on, whatever else reads it.
struct Positioned<'a> {
    file: &'a File,
    at: u64,
}

impl Read for Positioned<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.file.read_at(bytes, self.at)?;
        self.at += read as u64;
        Ok(read)
    }
}

/// Where the scan of a log goes on.
enum Step {
    To(u64),
    /// Nobody knows: the frame is damaged, and so is what says how long it is; or it is the end.
    Lost,
}

/// Reads the frame at `at`, where the reader stands, in a log of `len` bytes: where the next one begins, and whether
/// this one's checksum is right. None if there is no whole frame.
fn read_frame(reader: &mut impl Read, at: u64, len: u64, body: &mut Vec<u8>) -> io::Result<Option<(u64, bool)>> {
    let mut header = [0; RECORD_HEADER as usize];
    if at.checked_add(RECORD_HEADER).is_none_or(|end| end > len) || !read_on(reader, &mut header)? {
        return Ok(None);
    }
    let Some((size, check)) = parse_log_header(&header) else { return Ok(None) };
    let next = at + RECORD_HEADER + size;
    if next > len {
        return Ok(None);
    }
    body.resize(size as usize, 0);
    if !read_on(reader, body)? {
        return Ok(None);
    }
    Ok(Some((next, blake3::hash(body).as_bytes()[..16] == check)))
}

/// Reads on; whether there was enough to read.
fn read_on(reader: &mut impl Read, bytes: &mut [u8]) -> io::Result<bool> {
    match reader.read_exact(bytes) {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(false),
        other => other.map(|()| true),
    }
}

fn parse_log_header(header: &[u8; RECORD_HEADER as usize]) -> Option<(u64, [u8; 16])> {
    let mut fields = Fields(header);
    let magic = fields.take(4)?;
    let size = u64::from(fields.u32()?);
    let check = fields.array()?;
    (magic == RECORD_MAGIC && size <= MAX_BODY).then_some((size, check))
}

fn parse_body(body: &[u8]) -> Option<LogEntry<'_>> {
    match body.split_first()? {
        (&RECORD, record) => Some(LogEntry::Record(record)),
        (&COMMIT, offset) => Fields(offset).u64().map(LogEntry::Commit),
        _ => None,
    }
}

/// A frame with a record, read from a log.
pub(crate) struct RecordFrame(Vec<u8>);

impl RecordFrame {
    /// The encoded record.
    pub fn bytes(&self) -> &[u8] {
        &self.0[RECORD_HEADER as usize + 1..]
    }
}

/// The record whose frame is at `offset` and has a body of `len` bytes; `None` when it is damaged, or cut off.
pub(crate) fn read_record(file: &File, offset: u64, len: u32) -> io::Result<Option<RecordFrame>> {
    if u64::from(len) > MAX_BODY {
        return Ok(None);
    }
    let mut frame = vec![0; RECORD_HEADER as usize + len as usize];
    match file.read_exact_at(&mut frame, offset) {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
        other => other?,
    }
    let Some((header, body)) = frame.split_first_chunk() else { return Ok(None) };
    let good = parse_log_header(header).is_some_and(|(size, check)| {
        size == u64::from(len) && blake3::hash(body).as_bytes()[..16] == check && body.first() == Some(&RECORD)
    });
    Ok(good.then_some(RecordFrame(frame)))
}

/// The end of a segment that this store instance writes.
#[derive(Debug)]
pub(crate) struct Appender {
    pub file: Arc<File>,
    pub path: PathBuf,
    /// Number of the segment in the index.
    pub segment: u32,
    /// Its sequence number.
    pub seq: u64,
    pub end: u64,
}

impl Appender {
    /// Appends a frame and returns its offset. After an error the segment ends where it ended before, or must not be
    /// appended to again (`Err(true)`).
    pub fn append(&mut self, frame: &[u8]) -> Result<u64, (io::Error, bool)> {
        let offset = self.end;
        if let Err(error) = self.file.write_all_at(frame, offset) {
            // A torn frame in the middle would hide what is appended after it.
            let spoiled = self.file.set_len(offset).is_err();
            return Err((error, spoiled));
        }
        self.end += frame.len() as u64;
        Ok(offset)
    }
}
