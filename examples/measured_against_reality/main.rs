//! Generated scenes beside reality: measures views cut out of HDRIs and scenes of `pipelines/reality.yaml` by the same
//! functions, and prints the tables of `docs/benchmarks/scenes.md`.
//!
//! `cargo run --release --example measured_against_reality -- [--sheets FOLDER] HDRIS [OBJECTS]`
//!
//! Folders are searched for HDRIs (.hdr, .exr) and objects (.glb, .gltf). What was made is kept in the cache.

mod nearest;
mod tables;
mod views;

#[path = "../../tests/pipelines/support.rs"]
#[expect(dead_code, reason = "tests use the rest")]
mod support;

use std::{
    collections::BTreeMap,
    error::Error,
    fs,
    path::{Path, PathBuf},
};
use support::{Done, root};
use tauflow_contract::{Context, Handle, KindError};
use tauflow_data::{
    Image,
    image_io::preview_png,
    records::{Asset, AssetBody, Ladder, SceneStatistics, SplitReport, Verdict},
};
use tauflow_render::{picture_statistics, quality_gate::geometric_mean_luminance};
use tauflow_scene::SceneGenerationParams;

/// Samples per pixel of previews.
const PREVIEW_SPP: u64 = 32;
/// Pictures in a row of a sheet, and rows.
const SHEET: [usize; 2] = [10, 6];
/// The same of the sheets by which the gate is judged.
const JUDGED: [usize; 2] = [10, 10];

fn main() -> Result<(), Box<dyn Error>> {
    let (mut folders, mut sheets) = (Vec::new(), None);
    let mut arguments = std::env::args_os().skip(1);
    while let Some(argument) = arguments.next() {
        if argument == "--sheets" {
            sheets = Some(PathBuf::from(arguments.next().ok_or("`--sheets` wants a folder after it")?));
            continue;
        }
        let folder = Path::new(&argument);
        let found = folder.canonicalize().ok().filter(|found| found.is_dir());
        folders.push(found.ok_or_else(|| format!("{} is no folder; name one with HDRIs", folder.display()))?);
    }
    if folders.is_empty() {
        return Err("name a folder with HDRIs (.hdr, .exr), and one with objects (.glb, .gltf)".into());
    }
    let store = std::env::var_os("TAUFLOW_CACHE").map_or_else(|| root().join("cache/store"), PathBuf::from);
    eprintln!("making scenes and measuring them, which takes minutes the first time ...");
    let sets = vec![format!("assets.folders={}", serde_json::to_string(&folders)?)];
    let done = Done::run(&root().join("pipelines/reality.yaml"), sets, &store);

    eprintln!("cutting views ...");
    let (views, left_out) = real_views(&done)?;
    if views.is_empty() {
        return Err(format!("none of the HDRIs in {folders:?} can be cut into views: {left_out:?}").into());
    }
    let procedural: BTreeMap<String, SceneStatistics> = done.read("procedural_statistics");
    let furnished: BTreeMap<String, SceneStatistics> = done.read("furnished_statistics");
    tables::pictures(&views, &procedural, &furnished);
    tables::maps(&views);
    tables::contexts(&procedural);
    for line in left_out {
        println!("left out: {line}");
    }
    tables::geometry(&procedural, &furnished);
    near_copies(&done)?;
    if let Some(folder) = sheets {
        fs::create_dir_all(&folder)?;
        // Evenly out of all there are.
        let real: Vec<&Image> = views.iter().flat_map(|map| &map.views).map(|view| &view.image).collect();
        let previews: Vec<Image> = previews(&done, "procedural_previews")?
            .into_iter()
            .filter_map(|(key, image)| procedural.contains_key(&key).then_some(image))
            .collect();
        fs::write(folder.join("real_views.png"), sheet(&real, SHEET)?)?;
        fs::write(folder.join("procedural_scenes.png"), sheet(&previews.iter().collect::<Vec<_>>(), SHEET)?)?;
        judged(&done, &folder)?;
    }
    Ok(())
}

/// Writes what the gate made of scenes that nobody looked at: sheets of those it takes, and of those it rejects by
/// their first reason.
fn judged(done: &Done, folder: &Path) -> Result<(), Box<dyn Error>> {
    let previews = previews(done, "previews")?;
    let mut by_reason: BTreeMap<String, Vec<&Image>> = BTreeMap::new();
    for (key, verdict) in done.read::<Verdict>("gate.verdicts") {
        let reason =
            verdict.reasons.first().map_or_else(|| "accepted".to_owned(), |reason| format!("rejected_{reason}"));
        by_reason.entry(reason).or_default().extend(previews.get(&key));
    }
    for (reason, images) in by_reason {
        println!("{reason}: {}", images.len());
        let pages = if reason == "accepted" { 2 } else { images.len().div_ceil(JUDGED[0] * JUDGED[1]) };
        for page in 0..pages {
            let of_page: Vec<&Image> = images.iter().copied().skip(page).step_by(pages).collect();
            fs::write(folder.join(format!("{reason}_{page}.png")), sheet(&of_page, JUDGED)?)?;
        }
    }
    Ok(())
}

/// The views of each HDRI, and the HDRIs that are too coarse, a line each.
fn real_views(done: &Done) -> Result<(Vec<views::Panorama>, Vec<String>), Box<dyn Error>> {
    let fov = SceneGenerationParams::default().fov;
    let (mut found, mut left_out) = (Vec::new(), Vec::new());
    for asset in done.read::<Asset>("assets").into_values() {
        let AssetBody::Hdri { image, size, .. } = asset.body else { continue };
        if views::resolves(size[0], fov) {
            let views = done.with(|ctx| views::cut(&asset.name, image, fov, ctx))?;
            found.push(views::Panorama { name: asset.name, views });
        } else {
            left_out.push(format!("{}, {} texels around: a pixel of a view has less than one", asset.name, size[0]));
        }
    }
    Ok((found, left_out))
}

/// The previews at a node, by scene.
fn previews(done: &Done, node: &str) -> Result<BTreeMap<String, Image>, Box<dyn Error>> {
    let read = |ctx: &Context<'_>| -> Result<BTreeMap<String, Image>, KindError> {
        let mut found = BTreeMap::new();
        for (key, artifact) in done.collection(node).iter() {
            found.insert(key.to_string(), Ladder::rung(ctx, Handle::new(artifact)?, PREVIEW_SPP)?);
        }
        Ok(found)
    };
    Ok(done.with(read)?)
}

/// Prints how near the previews of the two sides of the split come.
fn near_copies(done: &Done) -> Result<(), Box<dyn Error>> {
    let report: SplitReport = done.only("split.report");
    let signatures = report.signatures();
    let thumbnails: BTreeMap<String, Vec<f64>> = previews(done, "previews")?
        .iter()
        .map(|(key, image)| (key.clone(), picture_statistics::thumbnail(image)))
        .collect();
    let side = |port: &str| -> Vec<nearest::Scene<'_>> {
        let of = |key: String| {
            let (key, thumbnail) = thumbnails.get_key_value(&key)?;
            Some(nearest::Scene { key, content: signatures.get(key.as_str())?, thumbnail })
        };
        done.keys(port).into_iter().filter_map(of).collect()
    };
    tables::neighbours(&nearest::between(&side("split.train"), &side("split.test")));
    Ok(())
}

/// A sheet of so many columns and rows of pictures, evenly out of all, as the gate exposes them.
fn sheet(all: &[&Image], [columns, rows]: [usize; 2]) -> Result<Vec<u8>, Box<dyn Error>> {
    let Some(first) = all.first() else { return Err("there are no pictures to show".into()) };
    let (width, height) = (first.width(), first.height());
    let mut sheet = Image::new(columns * width, rows * height, 3);
    let shown = (columns * rows).min(all.len());
    for place in 0..shown {
        let image = all[place * all.len() / shown];
        let exposure = picture_statistics::KEY / geometric_mean_luminance(image);
        let (left, top) = (place % columns * width, place / columns * height);
        for y in 0..height {
            for x in 0..width {
                let exposed = image.pixel(x, y).iter().map(|value| (f64::from(*value) * exposure) as f32);
                sheet.pixel_mut(left + x, top + y).iter_mut().zip(exposed).for_each(|(to, value)| *to = value);
            }
        }
    }
    Ok(preview_png(&sheet)?)
}
