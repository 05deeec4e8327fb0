//! Tests of the reader of Radiance pictures.

use super::*;

fn picture(resolution: &str, extra: &str, body: &[u8]) -> Vec<u8> {
    let mut bytes =
        format!("#?RADIANCE\n#?RADIANCE\n# a note\n{extra}FORMAT=32-bit_rle_rgbe\n\n{resolution}\n").into_bytes();
    bytes.extend_from_slice(body);
    bytes
}

#[test]
fn flat_texels_runs_and_exposure_are_read() {
    // 128 2^(128 - 136) = 0.5.
    let flat = picture("-Y 1 +X 2", "EXPOSURE=2\nEXPOSURE=0.5\n", &[128, 64, 0, 128, 255, 255, 255, 0]);
    assert_eq!(read(&flat).expect("flat").data(), &[0.5, 0.25, 0.0, 0.0, 0.0, 0.0]);
    let exposed = picture("-Y 1 +X 1", "EXPOSURE=4\n", &[128, 64, 0, 128]);
    assert_eq!(read(&exposed).expect("flat").data(), &[0.125, 0.0625, 0.0]);
    let old = picture("-Y 1 +X 4", "", &[128, 0, 0, 129, 1, 1, 1, 3]);
    assert_eq!(read(&old).expect("old runs").data(), &[1.0, 0.0, 0.0].repeat(4));
    let new = picture("-Y 1 +X 8", "", &[2, 2, 0, 8, 136, 128, 8, 1, 2, 3, 4, 5, 6, 7, 8, 136, 0, 136, 129]);
    let image = read(&new).expect("new runs");
    assert_eq!(image.pixel(0, 0), &[1.0, 1.0 / 128.0, 0.0]);
    assert_eq!(image.pixel(7, 0), &[1.0, 8.0 / 128.0, 0.0]);
}

#[test]
fn orientations_turn_the_picture() {
    let body: Vec<u8> = (0..6u8).flat_map(|i| [i, 0, 0, 136]).collect();
    let first = |resolution: &str| {
        let image = read(&picture(resolution, "", &body)).expect("flat");
        ([image.width(), image.height()], image.data().iter().step_by(3).copied().collect::<Vec<f32>>())
    };
    assert_eq!(first("-Y 2 +X 3"), ([3, 2], vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]));
    assert_eq!(first("+Y 2 +X 3"), ([3, 2], vec![3.0, 4.0, 5.0, 0.0, 1.0, 2.0]));
    assert_eq!(first("-Y 2 -X 3"), ([3, 2], vec![2.0, 1.0, 0.0, 5.0, 4.0, 3.0]));
    assert_eq!(first("+X 2 -Y 3"), ([2, 3], vec![0.0, 3.0, 1.0, 4.0, 2.0, 5.0]));
    assert_eq!(first("-X 2 +Y 3"), ([2, 3], vec![5.0, 2.0, 4.0, 1.0, 3.0, 0.0]));
}

#[test]
fn broken_pictures_are_refused_in_a_line() {
    let texel = [1u8, 2, 3, 128];
    for (bytes, says) in [
        (b"PNG".to_vec(), "header"),
        (b"PNG\n".to_vec(), "#?"),
        (b"#?RADIANCE\n\n-Y x +X 1\n".to_vec(), "resolution"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n".to_vec(), "xyze"),
        (picture("-Y 0 +X 4", "", &texel), "0 texels"),
        (picture("-Y 99999 +X 99999", "", &texel), "99999"),
        (picture("-Y 8192 +X 8192", "", &texel), "bytes"),
        (picture("-Y 1 +X 2", "", &texel), "end early"),
        (picture("-Y 1 +X 8", "", &[2, 2, 0, 9, 0, 0, 0, 0]), "9 texels"),
        (picture("-Y 1 +X 8", "", &[2, 2, 0, 8, 200, 1, 1, 1]), "leaves"),
        (picture("-Y 1 +X 4", "", &[1, 1, 1, 3]), "leaves"),
        (picture("-Y 1 +X 1", "EXPOSURE=-1\n", &texel), "exposure"),
    ] {
        let line = read(&bytes).expect_err(says).line("x.hdr");
        assert!(line.contains(says) && !line.contains('\n') && line.contains("x.hdr"), "{says}: {line}");
    }
}
