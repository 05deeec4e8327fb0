//! The archive that `torch.save` writes: a zip file whose entries are stored as they are. Nothing is unpacked.

/// An entry: its name and where its bytes lie.
pub(super) type Entry = (String, std::ops::Range<usize>);

/// Bytes of the record at the end of an archive, without its comment.
const END: usize = 22;
/// Longest comment after it.
const COMMENT: usize = 65_535;

fn number(bytes: &[u8], at: usize, size: usize) -> Option<usize> {
    let bytes = bytes.get(at..at.checked_add(size)?)?;
    Some(bytes.iter().rev().fold(0, |sum, byte| sum << 8 | usize::from(*byte)))
}

/// All entries of an archive.
///
/// # Errors
/// What is wrong with it: it is cut short, compressed, or larger than 4 GiB.
pub(super) fn entries(bytes: &[u8]) -> Result<Vec<Entry>, String> {
    let first = bytes.len().saturating_sub(END + COMMENT);
    let last = bytes.len().checked_sub(END).ok_or_else(cut)?;
    let end = (first..=last).rev().find(|at| bytes[*at..].starts_with(b"PK\x05\x06")).ok_or_else(cut)?;
    let field = |at: usize, size: usize| number(bytes, end + at, size).ok_or_else(cut);
    let (count, mut at) = (field(10, 2)?, field(16, 4)?);
    if count == 0xFFFF || at == 0xFFFF_FFFF {
        return Err("the archive is larger than 4 GiB; save the network's weights alone".into());
    }
    (0..count)
        .map(|_| {
            let entry = entry(bytes, at).ok_or_else(cut)??;
            at = entry.1;
            Ok(entry.0)
        })
        .collect()
}

fn cut() -> String {
    "the archive is cut short or damaged; copy the file again".into()
}

/// The entry whose header in the directory starts at `at`, and where the next one does.
fn entry(bytes: &[u8], at: usize) -> Option<Result<(Entry, usize), String>> {
    if !bytes.get(at..)?.starts_with(b"PK\x01\x02") {
        return None;
    }
    let field = |offset: usize, size: usize| number(bytes, at + offset, size);
    let (method, size, header) = (field(10, 2)?, field(24, 4)?, field(42, 4)?);
    let (name, extra, comment) = (field(28, 2)?, field(30, 2)?, field(32, 2)?);
    let text = String::from_utf8_lossy(bytes.get(at + 46..at + 46 + name)?).into_owned();
    if method != 0 {
        return Some(Err(format!("the entry `{text}` is compressed; save the file with `torch.save`")));
    }
    if size == 0xFFFF_FFFF || header == 0xFFFF_FFFF {
        return Some(Err(format!("the entry `{text}` is larger than 4 GiB; save the network's weights alone")));
    }
    if !bytes.get(header..)?.starts_with(b"PK\x03\x04") {
        return None;
    }
    let start = header.checked_add(30)?.checked_add(number(bytes, header + 26, 2)?)?;
    let start = start.checked_add(number(bytes, header + 28, 2)?)?;
    let end = start.checked_add(size).filter(|end| *end <= bytes.len())?;
    Some(Ok(((text, start..end), at + 46 + name + extra + comment)))
}
