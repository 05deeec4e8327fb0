//! The functions as C calls them, and the header as a C compiler reads it.

#![expect(unsafe_code, reason = "the interface takes pointers")]

use std::{
    ffi::{CStr, c_char},
    fs,
    path::Path,
    process::Command,
    ptr,
};
use tauflow_data::{Image, rng::Stream};
use tauflow_denoiser::{Denoiser, Frame, Settings, Weights};
use tauflow_denoiser_c::{
    TauflowFrame, tauflow_denoise, tauflow_denoiser_frame_size, tauflow_denoiser_free, tauflow_denoiser_new,
};

const WIDTH: usize = 24;
const HEIGHT: usize = 17;

fn made_up(seed: u64) -> Vec<f32> {
    let mut stream = Stream::new(seed, &[]);
    (0..3 * WIDTH * HEIGHT).map(|_| stream.uniform() as f32).collect()
}

fn frame(radiance: &[f32], output: &mut [f32]) -> TauflowFrame {
    TauflowFrame {
        width: WIDTH,
        height: HEIGHT,
        radiance: radiance.as_ptr(),
        albedo: ptr::null(),
        normal: ptr::null(),
        variance: ptr::null(),
        output: output.as_mut_ptr(),
        spp: 0,
        exposure: 0.0,
        keep: 0.0,
    }
}

fn text(error: &[c_char]) -> String {
    // SAFETY: the function ended it with 0, or it is the 0 that it started with.
    unsafe { CStr::from_ptr(error.as_ptr()) }.to_string_lossy().into_owned()
}

#[test]
fn images_are_those_of_the_library() {
    let [radiance, albedo, mut normal] = [1, 2, 3].map(made_up);
    // Not longer than 1.
    normal.iter_mut().for_each(|value| *value *= 0.5);
    let mut error: [c_char; 200] = [0; 200];
    // SAFETY: the name ends in 0, and the text has 200 bytes.
    let denoiser = unsafe { tauflow_denoiser_new(c"fast".as_ptr(), error.as_mut_ptr(), error.len()) };
    assert!(!denoiser.is_null(), "{}", text(&error));
    let image = |data: &[f32]| Image::from_data(WIDTH, HEIGHT, 3, data.to_vec()).expect("fits");
    let library = Denoiser::built_in(Weights::Fast).expect("bundled");
    for features in [false, true] {
        let mut output = vec![0.0; radiance.len()];
        let mut asked = frame(&radiance, &mut output);
        let mut expected = Frame::new(image(&radiance)).expect("finite");
        if features {
            (asked.albedo, asked.normal) = (albedo.as_ptr(), normal.as_ptr());
            expected = expected.with_gbuffer(image(&albedo).beside(&image(&normal)).expect("one size")).expect("fits");
        }
        // SAFETY: all images have the size of the frame.
        let code = unsafe { tauflow_denoise(denoiser, &asked, error.as_mut_ptr(), error.len()) };
        assert_eq!((code, text(&error)), (0, String::new()));
        let expected = library.denoise(&expected, &Settings::default(), &mut |_, _| Ok(())).expect("denoised");
        assert!(output == expected.image.data());
        // In place.
        let mut both = radiance.clone();
        let place = both.as_mut_ptr();
        let asked = TauflowFrame { radiance: place, output: place, ..asked };
        // SAFETY: as above; the input is copied before the output is written.
        assert_eq!(unsafe { tauflow_denoise(denoiser, &asked, ptr::null_mut(), 0) }, 0);
        assert!(both == output);
    }
    // SAFETY: it was made above, and is used no more.
    unsafe { tauflow_denoiser_free(denoiser) };
}

#[test]
fn what_is_wrong_is_told_and_nothing_is_written() {
    let mut error: [c_char; 400] = [0; 400];
    // SAFETY: the name ends in 0, and the text has 400 bytes.
    let none = unsafe { tauflow_denoiser_new(c"better".as_ptr(), error.as_mut_ptr(), error.len()) };
    assert!(none.is_null() && text(&error).contains("`better`"), "{}", text(&error));
    // SAFETY: null is allowed.
    assert!(unsafe { tauflow_denoiser_new(ptr::null(), ptr::null_mut(), 0) }.is_null());
    // SAFETY: null is allowed.
    unsafe { tauflow_denoiser_free(ptr::null_mut()) };
    // SAFETY: as above.
    let denoiser = unsafe { tauflow_denoiser_new(c"fast".as_ptr(), error.as_mut_ptr(), error.len()) };
    let (radiance, mut output) = (made_up(1), vec![7.0; 3 * WIDTH * HEIGHT]);
    let fine = frame(&radiance, &mut output);
    let nan = vec![f32::NAN; radiance.len()];
    for (asked, part) in [
        (TauflowFrame { radiance: ptr::null(), ..fine }, "must not be NULL"),
        (TauflowFrame { output: ptr::null_mut(), ..fine }, "must not be NULL"),
        (TauflowFrame { albedo: radiance.as_ptr(), ..fine }, "belong together"),
        (TauflowFrame { width: 0, ..fine }, "0 x 17 pixels"),
        (TauflowFrame { width: usize::MAX, ..fine }, "must fit in memory"),
        (TauflowFrame { keep: 2.0, ..fine }, "`keep` is 2"),
        (TauflowFrame { exposure: -1.0, ..fine }, "an exposure of -1"),
        (TauflowFrame { radiance: nan.as_ptr(), ..fine }, "no finite pixel"),
    ] {
        // SAFETY: images have the size of the frame, or it is refused before they are read.
        assert_eq!(unsafe { tauflow_denoise(denoiser, &asked, error.as_mut_ptr(), error.len()) }, 1, "{part}");
        assert!(text(&error).contains(part), "{}", text(&error));
    }
    // SAFETY: null is refused.
    assert_eq!(unsafe { tauflow_denoise(ptr::null(), &fine, error.as_mut_ptr(), error.len()) }, 1);
    assert!(output.iter().all(|value| *value == 7.0));
    // A frame with odd values is denoised, and they are told.
    let mut odd = radiance.clone();
    (odd[0], odd[300], odd[301]) = (f32::NAN, -1.0, 65504.0);
    let tenfold: Vec<f32> = radiance.iter().map(|value| 10.0 * value + 2.0).collect();
    let features = TauflowFrame { albedo: tenfold.as_ptr(), normal: tenfold.as_ptr(), ..fine };
    // SAFETY: images have the size of the frame.
    let code = unsafe {
        let odd = TauflowFrame { radiance: odd.as_ptr(), ..features };
        tauflow_denoise(denoiser, &odd, error.as_mut_ptr(), error.len())
    };
    let lines = [
        "1 of 408 pixels of radiance",
        "1 values are 65504",
        "1 values are negative",
        "1224 of 1224 values of the albedo",
        "408 of 408 normals",
    ];
    let found = text(&error);
    assert_eq!((code, found.lines().count()), (0, lines.len()), "{found}");
    for (line, part) in found.lines().zip(lines) {
        assert!(line.starts_with(part), "{found}");
    }
    // A short buffer gets the first bytes.
    // SAFETY: as above, and the text has 5 bytes.
    let code = unsafe {
        let odd = TauflowFrame { radiance: odd.as_ptr(), ..features };
        tauflow_denoise(denoiser, &odd, error.as_mut_ptr(), 5)
    };
    assert_eq!((code, text(&error).as_str()), (0, "1 of"));
    // SAFETY: it was made above, and is used no more.
    unsafe { tauflow_denoiser_free(denoiser) };
    assert!(output.iter().all(|value| value.is_finite()));
}

#[test]
fn the_header_has_the_layout_of_the_frame() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let offsets = ["radiance", "albedo", "normal", "variance", "output", "spp", "exposure", "keep"];
    let print = offsets.map(|field| format!("printf(\"%zu\\n\", offsetof(TauflowFrame, {field}));")).join("\n");
    let source = format!(
        "#include \"tauflow_denoise.h\"\n#include <stdio.h>\n\
         int main(void) {{ {print}\nprintf(\"%zu\\n\", sizeof(TauflowFrame)); return 0; }}\n"
    );
    fs::write(folder.join("layout.c"), source).expect("writable");
    let include = Path::new(env!("CARGO_MANIFEST_DIR")).join("include");
    let program = folder.join("layout");
    // The linker of Rust programs is a C compiler, too.
    let built = Command::new("cc")
        .args(["-std=c99", "-Wall", "-Werror", "-I"])
        .arg(&include)
        .arg(folder.join("layout.c"))
        .arg("-o")
        .arg(&program)
        .status()
        .expect("a C compiler");
    assert!(built.success());
    let printed = Command::new(&program).output().expect("it starts").stdout;
    let found: Vec<usize> =
        String::from_utf8_lossy(&printed).lines().map(|line| line.parse().expect("a number")).collect();
    let expected = [
        std::mem::offset_of!(TauflowFrame, radiance),
        std::mem::offset_of!(TauflowFrame, albedo),
        std::mem::offset_of!(TauflowFrame, normal),
        std::mem::offset_of!(TauflowFrame, variance),
        std::mem::offset_of!(TauflowFrame, output),
        std::mem::offset_of!(TauflowFrame, spp),
        std::mem::offset_of!(TauflowFrame, exposure),
        std::mem::offset_of!(TauflowFrame, keep),
        tauflow_denoiser_frame_size(),
    ];
    assert_eq!(found, expected);
}
