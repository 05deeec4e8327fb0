//! How much a file may ask for, by what it holds: a small file costs little. Knows no file format.
//!
//! Bounds are held against headers, before memory is taken. Each has a part that any file is granted, and more with
//! its bytes. Files that hold what they claim stay far below: uncompressed, a texel takes 2 bytes and more.

use super::refusal::Refusal;

/// Most texels of a picture.
pub const MOST_TEXELS: usize = 1 << 26;

/// Texels that a picture of any file may have: 4096 x 2048.
const FREE_TEXELS: usize = 1 << 23;

/// More of them for each byte. One colour says 16 in run-length encoding, and pictures of the world say less than 1.
const TEXELS_PER_BYTE: usize = 32;

/// Most instances of `EXT_mesh_gpu_instancing` in a file: what says where they stand takes 80 MB.
const MOST_INSTANCES: usize = 1 << 20;

/// Instances that any file may have: values that no bytes hold are zeros.
const FREE_INSTANCES: usize = 1 << 16;

/// Most channels of a picture.
const MOST_CHANNELS: usize = 1024;

/// Most numbers of a picture, over all of its channels: 1 GiB.
const MOST_NUMBERS: usize = 1 << 28;

/// Numbers that a picture of any file may have.
const FREE_NUMBERS: usize = 4 * FREE_TEXELS;

/// More of them for each byte.
const NUMBERS_PER_BYTE: usize = 4 * TEXELS_PER_BYTE;

fn most(free: usize, per_byte: usize, bytes: usize, ever: usize) -> usize {
    bytes.saturating_mul(per_byte).saturating_add(free).min(ever)
}

/// Most instances in a file of `bytes`. Places that differ take 3 bytes and more.
pub fn instances(bytes: usize) -> usize {
    most(FREE_INSTANCES, 1, bytes, MOST_INSTANCES)
}

/// Number of texels of a picture in a file of `bytes`.
///
/// # Errors
/// If there are none, or more than such a file may have.
pub fn texels(place: &str, width: usize, height: usize, bytes: usize) -> Result<usize, Refusal> {
    let most = most(FREE_TEXELS, TEXELS_PER_BYTE, bytes, MOST_TEXELS);
    width.checked_mul(height).filter(|texels| (1..=most).contains(texels)).ok_or_else(|| {
        Refusal::new(
            place,
            format!("{width} x {height} texels in a file of {bytes} bytes, which may have 1 to {most}"),
            "make the picture smaller, or save it without compression if it is that plain",
        )
    })
}

/// Checks how many numbers the channels of a picture have in a file of `bytes`.
///
/// # Errors
/// If there are more than such a file may have.
pub fn channels(place: &str, channels: usize, texels: usize, bytes: usize) -> Result<(), Refusal> {
    let most = most(FREE_NUMBERS, NUMBERS_PER_BYTE, bytes, MOST_NUMBERS);
    if channels > MOST_CHANNELS || texels.saturating_mul(channels) > most {
        return Err(Refusal::new(
            place,
            format!(
                "{channels} channels of {texels} texels in a file of {bytes} bytes, which may have {MOST_CHANNELS} \
                 channels and {most} numbers"
            ),
            "take out the channels that are not R, G, B or Y",
        ));
    }
    Ok(())
}

/// The remaining budget of the images and meshes of an object or a scene.
#[derive(Clone)]
pub struct Allowance {
    /// Texels to be read, each for each use.
    texels: usize,
    /// Bytes of bitmaps and meshes to be made.
    made: usize,
    bytes: usize,
}

/// Texels that the images of any object may have: 16 images of 4096 x 4096.
const FREE_READ: usize = 1 << 28;

/// Bytes that the bitmaps and meshes of any object may have: 42 bitmaps of 1024 x 1024 in three colours.
const FREE_MADE: usize = 1 << 29;

/// More of both for each byte. A photograph as JPEG says some 10 texels with a byte.
const IMAGES_PER_BYTE: usize = 64;

impl Allowance {
    /// Of an object of `bytes`, external files counted.
    pub fn of(bytes: usize) -> Self {
        let most = |free| most(free, IMAGES_PER_BYTE, bytes, usize::MAX);
        Self { texels: most(FREE_READ), made: most(FREE_MADE), bytes }
    }

    /// Takes what reading an image once costs.
    ///
    /// # Errors
    /// If the file has used up what it may cost.
    pub fn read(&mut self, place: &str, texels: usize) -> Result<(), Refusal> {
        self.texels =
            self.texels.checked_sub(texels).ok_or_else(|| self.used_up(place, FREE_READ, "texels to be read"))?;
        Ok(())
    }

    /// Takes what a bitmap or a mesh costs.
    ///
    /// # Errors
    /// If the file has used up what it may cost.
    pub fn make(&mut self, place: &str, bytes: usize) -> Result<(), Refusal> {
        self.made = self
            .made
            .checked_sub(bytes)
            .ok_or_else(|| self.used_up(place, FREE_MADE, "bytes of bitmaps and meshes"))?;
        Ok(())
    }

    /// Gives back what was taken for something that is held no longer.
    pub fn give_back(&mut self, bytes: usize) {
        self.made = self.made.saturating_add(bytes);
    }

    fn used_up(&self, place: &str, free: usize, what: &str) -> Refusal {
        let most = most(free, IMAGES_PER_BYTE, self.bytes, usize::MAX);
        Refusal::new(
            place,
            format!("with it the file asks for more than {most} {what}, the most for a file of {} bytes", self.bytes),
            "use fewer images and meshes, or smaller ones, and one alpha cutoff for each image",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_file_may_ask_for_grows_with_its_bytes() {
        assert_eq!(texels("header", 4096, 2048, 10), Ok(1 << 23));
        let told = texels("header", 4096, 4096, 10).expect_err("plain or hostile").line("x.hdr");
        assert!(told.starts_with("x.hdr: header: 4096 x 4096 texels in a file of 10 bytes"), "{told}");
        assert!(told.contains("8388928") && told.contains("; make"), "{told}");
        assert_eq!(texels("header", 4096, 4096, 1 << 18), Ok(1 << 24));
        for (width, height) in [(0, 5), (1 << 13, 1 << 14), (usize::MAX, 2)] {
            assert!(texels("header", width, height, usize::MAX).is_err());
        }
        assert_eq!(channels("header", 30, 1 << 20, 10), Ok(()));
        assert!(channels("header", 30, 1 << 21, 10).is_err() && channels("header", 1025, 1, usize::MAX).is_err());
    }

    #[test]
    fn images_share_one_allowance() {
        let mut left = Allowance::of(1000);
        for _ in 0..16 {
            left.read("image 0", 1 << 24).expect("granted");
        }
        let told = left.read("image 1", 1 << 24).expect_err("used up").to_string();
        assert!(told.starts_with("image 1: ") && told.contains("268499456") && told.contains("1000 bytes"), "{told}");
        assert!(left.make("image 1", 1 << 29).is_ok() && left.make("image 1", 1 << 20).is_err());
        assert!(left.make("image 2", 64_000).is_ok());
    }
}
