//! Segments: append-only files that one store instance writes and everybody reads.
//!
//! A pack segment holds small blobs, a log segment holds records.  Both are
//! sequences of checksummed frames, so that a torn tail is seen and ignored:
//!
//! ```text
//! pack frame   "TFB1"  size u64  blake3 of the blob [32]  check u64  blob
//! log frame    "TFR1"  length u32  check [16]  body
//! log body     0x01 record | 0x02 commit mark: u64 offset
//! ```
//! A commit mark says that the blobs of every record before that offset in the
//! same segment were durable when the mark was written.  Knows no index.

use crate::{
    codec::{Fields, Put},
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
pub(crate) const MAX_BODY: u64 = 1 << 30;
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

    /// Sequence number and owner out of a file name of this sort.
    pub fn parse(self, name: &str) -> Option<(u64, &str)> {
        let (seq, owner) = name.strip_suffix(self.extension())?.strip_suffix('.')?.split_once('-')?;
        Some((seq.parse().ok()?, owner))
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

/// Walks the frames of a pack from `from`; returns where the first incomplete or foreign frame begins.
/// Blobs are not read, only their headers.
pub(crate) fn scan_pack(path: &Path, from: u64, mut found: impl FnMut(PackedBlob)) -> io::Result<u64> {
    let file = File::open(path)?;
    let len = file.metadata()?.len();
    let mut at = from;
    let mut header = [0; BLOB_HEADER as usize];
    while at + BLOB_HEADER <= len {
        file.read_exact_at(&mut header, at)?;
        let Some((hash, size)) = parse_blob_header(&header) else { break };
        let offset = at + BLOB_HEADER;
        if size > len - offset {
            break; // torn, or still being written
        }
        found(PackedBlob { hash, size, offset });
        at = offset + size;
    }
    Ok(at)
}

fn parse_blob_header(header: &[u8; BLOB_HEADER as usize]) -> Option<([u8; 32], u64)> {
    let mut fields = Fields(header);
    let magic = fields.take(4)?;
    let size = fields.u64()?;
    let hash = fields.array()?;
    let check = fields.u64()?;
    (magic == BLOB_MAGIC && check == sum(&header[..44])).then_some((hash, size))
}

/// What a log segment holds at an offset.
pub(crate) enum LogEntry<'a> {
    Record(&'a [u8]),
    Commit(u64),
}

/// Where a scan of a log ended, and what it passed over.
#[derive(Default)]
pub(crate) struct LogScan {
    /// Offset of the first frame that is incomplete or foreign.
    pub end: u64,
    /// Complete frames whose checksum was wrong.
    pub damaged: u64,
}

/// Walks the frames of a log from `from`.  A damaged frame that is followed by
/// another frame, or by the end, is stepped over.
pub(crate) fn scan_log(path: &Path, from: u64, mut found: impl FnMut(u64, LogEntry<'_>)) -> io::Result<LogScan> {
    let mut file = File::open(path)?;
    let len = file.metadata()?.len();
    file.seek(SeekFrom::Start(from))?;
    let probe = file.try_clone()?;
    let mut reader = BufReader::with_capacity(1 << 20, file);
    let mut scan = LogScan { end: from, damaged: 0 };
    let (mut header, mut body) = ([0; RECORD_HEADER as usize], Vec::new());
    while scan.end + RECORD_HEADER <= len {
        reader.read_exact(&mut header)?;
        let Some((size, check)) = parse_log_header(&header) else { break };
        let next = scan.end + RECORD_HEADER + size;
        if next > len {
            break;
        }
        body.resize(size as usize, 0);
        reader.read_exact(&mut body)?;
        if blake3::hash(&body).as_bytes()[..16] != check {
            let mut magic = [0; 4];
            if next != len && (probe.read_exact_at(&mut magic, next).is_err() || &magic != RECORD_MAGIC) {
                break;
            }
            scan.damaged += 1;
        } else {
            match parse_body(&body) {
                Some(entry) => found(scan.end, entry),
                None => scan.damaged += 1,
            }
        }
        scan.end = next;
    }
    Ok(scan)
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
    pub end: u64,
}

impl Appender {
    /// Appends a frame and returns its offset.  After an error the segment ends
    /// where it ended before, or must not be appended to again (`Err(true)`).
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
