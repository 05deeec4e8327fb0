//! Reader of Radiance pictures (`.hdr`): shared-exponent texels, flat, old or new run-length encoding.
//!
//! Format: Ward, *Real Pixels*, Graphics Gems II, and Radiance's `color.c` and `resolu.c`. A texel (r, g, b, e) is
//! `(r, g, b) 2^(e - 136)`, as most renderers read it (Radiance itself adds half a step), and black for e = 0.
//! Knows nothing of what the picture is for.

use super::{
    bounds,
    refusal::{Refusal, damaged},
};
use tauflow_data::Image;

/// The header.
struct Header {
    /// Bytes before the first texel.
    length: usize,
    /// Divides the texels.
    exposure: f64,
    /// The line of the resolution, for errors.
    place: String,
    /// Number of scanlines and texels in each.
    lines: usize,
    across: usize,
    layout: Layout,
}

/// Where texel `across` of scanline `line` goes.
struct Layout {
    /// Scanlines are columns of the picture.
    columns: bool,
    /// Rows count upwards.
    up: bool,
    /// Columns count leftwards.
    left: bool,
}

impl Layout {
    fn place(&self, header: &Header, line: usize, across: usize) -> (usize, usize) {
        let (width, height) = self.size(header);
        let (x, y) = if self.columns { (line, across) } else { (across, line) };
        (if self.left { width - 1 - x } else { x }, if self.up { height - 1 - y } else { y })
    }

    fn size(&self, header: &Header) -> (usize, usize) {
        if self.columns { (header.lines, header.across) } else { (header.across, header.lines) }
    }
}

/// Reads a picture; linear RGB, row 0 on top.
///
/// # Errors
/// If the bytes are no such picture, are cut short, or name too many texels.
pub fn read(bytes: &[u8]) -> Result<Image, Refusal> {
    let header = header(bytes)?;
    let (width, height) = header.layout.size(&header);
    bounds::texels(&header.place, width, height, bytes.len())?;
    let body = &bytes[header.length..];
    let mut image = Image::new(width, height, 3);
    let mut scan = vec![[0u8; 4]; header.across];
    let mut reader = HdrReader { bytes: body, at: 0 };
    for line in 0..header.lines {
        reader.scanline(&mut scan).map_err(|what| damaged(format!("scanline {line}"), what))?;
        for (across, texel) in scan.iter().enumerate() {
            let (x, y) = header.layout.place(&header, line, across);
            let scale = factor(texel[3]) / header.exposure;
            for (value, mantissa) in image.pixel_mut(x, y).iter_mut().zip(texel) {
                *value = (f64::from(*mantissa) * scale) as f32;
            }
        }
    }
    Ok(image)
}

/// 2^(e - 136), or 0 for e = 0.
fn factor(e: u8) -> f64 {
    if e == 0 { 0.0 } else { f64::from_bits(((i64::from(e) - 136 + 1023) as u64) << 52) }
}

fn header(bytes: &[u8]) -> Result<Header, Refusal> {
    let mut at = 0;
    let mut line = |number: usize| -> Result<&str, Refusal> {
        let rest = &bytes[at..];
        let end = rest
            .iter()
            .take(4096)
            .position(|b| *b == b'\n')
            .ok_or_else(|| damaged(format!("header line {number}"), "the header has no end"))?;
        at += end + 1;
        let text = std::str::from_utf8(&rest[..end]).unwrap_or("?");
        Ok(text.trim_end_matches('\r'))
    };
    if !line(1)?.starts_with("#?") {
        return Err(damaged("header", "the first line does not begin with `#?`, so this is no Radiance picture"));
    }
    let mut exposure = 1.0;
    let mut number = 2;
    loop {
        let text = line(number)?;
        number += 1;
        if text.is_empty() {
            break;
        }
        if number > 1000 {
            return Err(damaged("header", "more than 1,000 lines"));
        }
        let Some((name, value)) = text.split_once('=') else { continue };
        match name.trim() {
            "FORMAT" if value.trim() != "32-bit_rle_rgbe" => {
                return Err(Refusal::new(
                    format!("header line {}", number - 1),
                    format!("texels of format `{}`", value.trim()),
                    "convert them to 32-bit_rle_rgbe",
                ));
            }
            "EXPOSURE" => {
                let value: f64 = value.trim().parse().unwrap_or(f64::NAN);
                if !(value > 0.0 && value.is_finite()) {
                    return Err(damaged(
                        format!("header line {}", number - 1),
                        "an exposure that is no positive number",
                    ));
                }
                exposure *= value;
            }
            _ => {}
        }
    }
    let text = line(number)?.to_owned();
    let place = format!("header line {number}");
    let (lines, across, layout) = resolution(&text)
        .ok_or_else(|| damaged(&place, format!("`{text}` is no resolution such as `-Y 512 +X 1024`")))?;
    Ok(Header { length: at, exposure, place, lines, across, layout })
}

fn resolution(text: &str) -> Option<(usize, usize, Layout)> {
    let words: Vec<&str> = text.split_ascii_whitespace().collect();
    let [first, lines, second, across] = words[..] else { return None };
    let columns = match (first, second) {
        ("-Y" | "+Y", "-X" | "+X") => false,
        ("-X" | "+X", "-Y" | "+Y") => true,
        _ => return None,
    };
    let has = |name: &str| first == name || second == name;
    Some((lines.parse().ok()?, across.parse().ok()?, Layout { columns, up: has("+Y"), left: has("-X") }))
}

struct HdrReader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl HdrReader<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let end = self.at + N;
        let got = self.bytes.get(self.at..end).ok_or("the data end early")?;
        self.at = end;
        got.try_into().map_err(|_| "the data end early".to_owned())
    }

    fn scanline(&mut self, scan: &mut [[u8; 4]]) -> Result<(), String> {
        let first: [u8; 4] = self.take()?;
        let new = (8..=0x7fff).contains(&scan.len()) && first[0] == 2 && first[1] == 2 && first[2] & 0x80 == 0;
        if !new {
            return self.old(first, scan);
        }
        let length = usize::from(first[2]) << 8 | usize::from(first[3]);
        if length != scan.len() {
            return Err(format!("it is {length} texels long, the picture {} wide", scan.len()));
        }
        for channel in 0..4 {
            let mut x = 0;
            while x < scan.len() {
                let [code] = self.take()?;
                let run = code > 128;
                let count = usize::from(if run { code - 128 } else { code });
                if count == 0 || x + count > scan.len() {
                    return Err("a run leaves the scanline".to_owned());
                }
                if run {
                    let [value] = self.take()?;
                    scan[x..x + count].iter_mut().for_each(|texel| texel[channel] = value);
                } else {
                    for texel in &mut scan[x..x + count] {
                        [texel[channel]] = self.take()?;
                    }
                }
                x += count;
            }
        }
        Ok(())
    }

    /// Flat texels, where (1, 1, 1, n) repeats the one before n times, and runs on end count in units of 256^k.
    fn old(&mut self, first: [u8; 4], scan: &mut [[u8; 4]]) -> Result<(), String> {
        let (mut x, mut shift) = (0, 0);
        let mut next = Some(first);
        while x < scan.len() {
            let texel = match next.take() {
                Some(texel) => texel,
                None => self.take()?,
            };
            if texel[..3] == [1, 1, 1] {
                let count = usize::from(texel[3]) << shift;
                if x == 0 || shift > 16 || x + count > scan.len() {
                    return Err("a run leaves the scanline".to_owned());
                }
                let before = scan[x - 1];
                scan[x..x + count].fill(before);
                x += count;
                shift += 8;
            } else {
                scan[x] = texel;
                x += 1;
                shift = 0;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "hdr_tests.rs"]
mod tests;
