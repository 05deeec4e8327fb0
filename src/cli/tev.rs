//! Progress in the viewer tev, by its protocol over TCP.
//!
//! A packet is its own length in bytes (u32), its type (u8), and fields: truth values of one byte, texts that end with
//! a zero byte, and numbers, all little-endian. [`Tev::connect`] creates an image, and [`Tev::show`] sends its pixels
//! anew (`CreateImage` and `UpdateImageV3` in tev's `Ipc.h`).

use super::CliError;
use std::{
    io::{self, Write},
    net::{TcpStream, ToSocketAddrs},
    time::Duration,
};
use tauflow_data::Image;

const CREATE_IMAGE: u8 = 4;
const UPDATE_IMAGE: u8 = 6;
const CHANNELS: [&str; 3] = ["R", "G", "B"];
/// How long a viewer may take to answer, or to read an image.
const PATIENCE: Duration = Duration::from_secs(10);

/// An image in a viewer.
pub(super) struct Tev {
    stream: TcpStream,
    address: String,
    name: String,
}

/// A packet as it grows.
struct Packet(Vec<u8>);

impl Packet {
    fn new(kind: u8) -> Self {
        Self(vec![0, 0, 0, 0, kind])
    }

    fn flag(mut self, flag: bool) -> Self {
        self.0.push(u8::from(flag));
        self
    }

    fn text(mut self, text: &str) -> Self {
        self.0.extend(text.bytes().filter(|byte| *byte != 0));
        self.0.push(0);
        self
    }

    fn numbers<const N: usize>(mut self, numbers: impl IntoIterator<Item = [u8; N]>) -> Self {
        numbers.into_iter().for_each(|bytes| self.0.extend(bytes));
        self
    }

    fn channels(self) -> Self {
        CHANNELS.iter().fold(self, |packet, name| packet.text(name))
    }

    /// Its bytes; none if it is longer than a length can say.
    fn bytes(mut self) -> Option<Vec<u8>> {
        let length = u32::try_from(self.0.len()).ok()?;
        self.0[..4].copy_from_slice(&length.to_le_bytes());
        Some(self.0)
    }
}

/// A side as the protocol has it.
fn side(pixels: usize) -> [u8; 4] {
    i32::try_from(pixels).unwrap_or(i32::MAX).to_le_bytes()
}

fn create(name: &str, width: usize, height: usize) -> Packet {
    let count = (CHANNELS.len() as i32).to_le_bytes();
    Packet::new(CREATE_IMAGE).flag(false).text(name).numbers([side(width), side(height), count]).channels()
}

fn update(name: &str, image: &Image) -> Packet {
    let count = (CHANNELS.len() as i32).to_le_bytes();
    let corner = [side(0), side(0), side(image.width()), side(image.height())];
    Packet::new(UPDATE_IMAGE)
        .flag(false)
        .text(name)
        .numbers([count])
        .channels()
        .numbers(corner)
        .numbers((0..CHANNELS.len() as i64).map(i64::to_le_bytes))
        .numbers(CHANNELS.map(|_| (CHANNELS.len() as i64).to_le_bytes()))
        .numbers(image.data().iter().map(|value| value.to_le_bytes()))
}

impl Tev {
    /// Creates an image of this name and size in the viewer at `HOST:PORT`.
    ///
    /// # Errors
    /// If there is no such address, or nobody answers there.
    pub(super) fn connect(address: &str, name: &str, (width, height): (usize, usize)) -> Result<Self, CliError> {
        let failed = |error: io::Error| {
            CliError::Environment(format!(
                "--tev {address}: no viewer answers there: {error}; start tev, or name its `--host` (127.0.0.1:14158)"
            ))
        };
        let mut last = io::Error::new(io::ErrorKind::NotFound, "the name has no address");
        for at in address.to_socket_addrs().map_err(failed)? {
            match TcpStream::connect_timeout(&at, PATIENCE) {
                Ok(stream) => {
                    stream.set_write_timeout(Some(PATIENCE)).map_err(failed)?;
                    let mut tev = Self { stream, address: address.to_owned(), name: name.to_owned() };
                    tev.send(create(name, width, height))?;
                    return Ok(tev);
                }
                Err(error) => last = error,
            }
        }
        Err(failed(last))
    }

    /// Shows an image of three channels and of the size that was created.
    ///
    /// # Errors
    /// If the viewer has gone.
    pub(super) fn show(&mut self, image: &Image) -> Result<(), CliError> {
        self.send(update(&self.name, image))
    }

    fn send(&mut self, packet: Packet) -> Result<(), CliError> {
        let address = &self.address;
        let bytes = packet.bytes().ok_or_else(|| {
            CliError::Bad(format!(
                "--tev {address}: the image has more than 4 GiB; render a smaller one, or leave it out"
            ))
        })?;
        self.stream
            .write_all(&bytes)
            .and_then(|()| self.stream.flush())
            .map_err(|error| CliError::Environment(format!("--tev {address}: the viewer has gone: {error}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{io::Read, net::TcpListener, thread};

    fn packets(mut bytes: &[u8]) -> Vec<&[u8]> {
        let mut found = Vec::new();
        while !bytes.is_empty() {
            let length = u32::from_le_bytes(bytes[..4].try_into().expect("four bytes")) as usize;
            found.push(&bytes[4..length]);
            bytes = &bytes[length..];
        }
        found
    }

    #[test]
    fn a_viewer_gets_the_image_it_is_told_of() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("loopback");
        let address = listener.local_addr().expect("bound").to_string();
        let viewer = thread::spawn(move || {
            let mut bytes = Vec::new();
            listener.accept().expect("a client").0.read_to_end(&mut bytes).expect("all of it");
            bytes
        });
        let image = Image::from_data(2, 1, 3, vec![0.5, 1.0, 2.0, 4.0, 8.0, 16.0]).expect("fits");
        let mut tev = Tev::connect(&address, "room", (2, 1)).expect("a viewer");
        tev.show(&image).expect("it listens");
        drop(tev);
        let bytes = viewer.join().expect("no panic");
        let [create, update] = packets(&bytes)[..] else { panic!("{bytes:?}") };
        let mut expected = b"\x04\0room\0".to_vec();
        expected.extend([2u8, 0, 0, 0, 1, 0, 0, 0, 3, 0, 0, 0]);
        expected.extend(b"R\0G\0B\0");
        assert_eq!(create, expected);
        let mut expected = b"\x06\0room\0\x03\0\0\0R\0G\0B\0".to_vec();
        expected.extend([0i32, 0, 2, 1].iter().flat_map(|v| v.to_le_bytes()));
        expected.extend([0i64, 1, 2, 3, 3, 3].iter().flat_map(|v| v.to_le_bytes()));
        expected.extend(image.data().iter().flat_map(|v| v.to_le_bytes()));
        assert_eq!(update, expected);
    }

    #[test]
    fn an_address_without_a_viewer_is_an_error_that_says_so() {
        // A port that was free a moment ago.
        let free = TcpListener::bind("127.0.0.1:0").expect("loopback").local_addr().expect("bound").to_string();
        for address in [free.as_str(), "127.0.0.1", "no host:1"] {
            let Err(error) = Tev::connect(address, "x", (1, 1)) else { panic!("{address} answers") };
            assert!(error.to_string().contains(address), "{error}");
        }
    }
}
