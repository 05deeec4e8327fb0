//! A denoiser that is a program: images go in and come back as EXR files.

use std::process::Command;
use tauflow_contract::KindError;
use tauflow_data::{
    Image,
    image_io::{read_exr, write_exr},
};

/// What may stand in a template.
const PLACES: [&str; 4] = ["{color}", "{albedo}", "{normal}", "{output}"];

/// What is wrong with a template; none if it can be used.
pub(crate) fn problem(template: &[String]) -> Option<String> {
    let has = |place: &str| template.iter().any(|word| word.contains(place));
    let missing: Vec<&str> = ["{color}", "{output}"].into_iter().filter(|place| !has(place)).collect();
    let unknown = template.iter().find_map(|word| {
        let start = word.find('{')?;
        let place = word[start..].split_inclusive('}').next()?;
        (!PLACES.contains(&place)).then(|| place.to_owned())
    });
    match (missing.is_empty(), unknown) {
        (false, _) => Some(format!("the command never names {}", missing.join(" or "))),
        (true, Some(place)) => Some(format!("the command names `{place}`, which is none of {}", PLACES.join(", "))),
        (true, None) => None,
    }
}

/// The image that the program makes of an image [H, W, 3], and the seconds that the program took.
///
/// # Errors
/// If it cannot be started, fails, or writes no image of the same size.
pub(crate) fn run(template: &[String], color: &Image, gbuffer: Option<&Image>) -> Result<(Image, f64), KindError> {
    let failed = |what: String| KindError::Environment(format!("the denoiser `{}` {what}", template.join(" ")));
    let folder = tempfile::tempdir().map_err(|e| failed(format!("got no folder for its images: {e}")))?;
    let path = |name: &str| folder.path().join(name);
    write_exr(&path("color.exr"), &[("", color)])?;
    if let Some(gbuffer) = gbuffer {
        for (name, first) in [("albedo.exr", 0), ("normal.exr", 3)] {
            let part = gbuffer.data().chunks_exact(6).flat_map(|pixel| pixel[first..first + 3].iter().copied());
            let image = Image::from_data(gbuffer.width(), gbuffer.height(), 3, part.collect())?;
            write_exr(&path(name), &[("", &image)])?;
        }
    }
    let filled = template.iter().map(|word| {
        PLACES.iter().fold(word.clone(), |word, place| {
            let file = format!("{}.exr", place.trim_matches(['{', '}']));
            word.replace(place, &path(&file).to_string_lossy())
        })
    });
    let words: Vec<String> = filled.collect();
    let Some((program, arguments)) = words.split_first() else { return Err(failed("is empty".into())) };
    let begun = std::time::Instant::now();
    let done = Command::new(program).args(arguments).output().map_err(|e| failed(format!("cannot be started: {e}")))?;
    let seconds = begun.elapsed().as_secs_f64();
    if !done.status.success() {
        let told = String::from_utf8_lossy(&done.stderr);
        let last = told.lines().rev().take(5).collect::<Vec<_>>().into_iter().rev().collect::<Vec<_>>().join("\n");
        return Err(failed(format!("failed with {}:\n{last}", done.status)));
    }
    let layers = read_exr(&path("output.exr")).map_err(|e| failed(format!("left no image that can be read: {e}")))?;
    // The layer without a name comes first.
    let image = layers.into_values().next().ok_or_else(|| failed("left an image without channels".into()))?;
    if !image.same_shape(color) {
        let shape = |i: &Image| format!("{} x {} pixels of {} values", i.width(), i.height(), i.channels());
        return Err(failed(format!("made {} of {}", shape(&image), shape(color))));
    }
    Ok((image, seconds))
}
