//! Pictures of rendered ladders side by side: scenes down, cells and sample counts across, the largest count last.
//!
//! Knows no score and no HTML.

use crate::{
    album::rungs_of,
    material::{Cell, cell_of_key},
    montage::{Montage, MontageRow, Picture, reduce},
    ranking::extra,
};
use std::collections::BTreeMap;
use tauflow_contract::{Context, Handle, Items, KindError};
use tauflow_data::{
    Image, StratumName,
    bins::{KEY, geometric_mean_luminance},
    image::preview,
    records::Ladder,
};

/// Name of the PNG.
pub const FILE: &str = "pictures.png";

/// The ladders of one scene, by cell.
type Scene<'a> = BTreeMap<Cell, Handle<'a, Ladder>>;

/// The first scenes of each stratum, or the first scenes of all where keys name no strata: one column for the lowest
/// rung of each cell, and one for the last rung of all, by which all are exposed. None without a ladder.
///
/// # Errors
/// If an image is missing from the store or damaged, or a ladder has no rung.
pub fn montage(
    ctx: &Context<'_>,
    ladders: Items<'_, Ladder>,
    scenes: usize,
    pixels: usize,
) -> Result<Option<Montage>, KindError> {
    let mut by_scene: BTreeMap<&str, Scene<'_>> = BTreeMap::new();
    for (key, ladder) in ladders.iter() {
        let own = key.split_cell().map_or(key.as_str(), |(_, own)| own);
        by_scene.entry(own).or_default().insert(cell_of_key(key.as_str()), ladder);
    }
    let mut taken: BTreeMap<String, usize> = BTreeMap::new();
    let mut rows = Vec::new();
    let mut columns = Vec::new();
    let mut reduced = 1;
    for (scene, cells) in &by_scene {
        let head = StratumName::of_key(scene).map_or_else(String::new, |(stratum, _)| stratum.to_string());
        let count = taken.entry(head.clone()).or_default();
        if *count >= scenes {
            continue;
        }
        *count += 1;
        ctx.check_cancelled()?;
        let row = row(ctx, scene, cells, pixels)?;
        reduced = row.reduced;
        // Scenes with other cells or counts than the first are left out: their pictures have no column.
        if columns.is_empty() {
            columns = row.heads;
        } else if columns != row.heads {
            continue;
        }
        let head = if head.is_empty() { (*scene).to_owned() } else { head };
        rows.push(MontageRow { scene: (*scene).to_owned(), head, input: None, pictures: row.pictures });
    }
    let montage = Montage { title: "Pictures".into(), file: FILE.into(), columns, rows, reduced };
    Ok(Some(montage).filter(|montage| !montage.rows.is_empty()))
}

struct Row {
    heads: Vec<(Option<Cell>, String)>,
    pictures: Vec<Picture>,
    reduced: usize,
}

fn row(ctx: &Context<'_>, scene: &str, cells: &Scene<'_>, pixels: usize) -> Result<Row, KindError> {
    let mut ends = Vec::with_capacity(cells.len());
    for (cell, ladder) in cells {
        let counts = Ladder::meta(ctx, *ladder)?.counts;
        let (Some(first), Some(last)) = (counts.first(), counts.last()) else {
            return Err(KindError::Input(format!("the ladder of `{scene}` has no rung")));
        };
        ends.push((cell, *ladder, *first, *last));
    }
    let (best_cell, best, _, most) = *ends.iter().max_by_key(|end| end.3).expect("a scene has a ladder");
    let last = Ladder::rung(ctx, best, most)?;
    let exposure = KEY / geometric_mean_luminance(&last);
    let reduced = last.width().max(last.height()).div_ceil(pixels.max(1));
    let shown = |image: &Image, cell: &Cell, spp: u64| {
        let exposed = image.map(|value| (f64::from(value) * exposure) as f32);
        Picture {
            image: Some(reduce(&exposed, reduced).map(preview)),
            psnr: None,
            frame: format!("{}/{spp} spp", rungs_of(cell)),
        }
    };
    let (mut heads, mut pictures) = (Vec::new(), Vec::new());
    for (cell, ladder, first, _) in &ends {
        let name = extra(cell);
        let name = if name.is_empty() { String::new() } else { format!("{name}, ") };
        heads.push((Some((*cell).clone()), format!("{name}{first} spp")));
        pictures.push(shown(&Ladder::rung(ctx, *ladder, *first)?, cell, *first));
    }
    heads.push((None, format!("{most} spp")));
    pictures.push(shown(&last, best_cell, most));
    Ok(Row { heads, pictures, reduced })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicBool;
    use tauflow_contract::{Collection, ItemKey, Media, MemoryBlobs, Silent};
    use tauflow_data::{
        IntegratorKind, SamplerKind,
        records::{LadderMeta, Rung},
    };

    fn ladder(counts: &[u64]) -> Ladder {
        let image = |value: f32| Image::from_data(4, 4, 3, vec![value; 48]).expect("fits");
        Ladder {
            meta: LadderMeta {
                counts: counts.to_vec(),
                width: 4,
                height: 4,
                rejected: 0,
                mean_path_length: 1.0,
                sampler: SamplerKind::Independent,
                integrator: IntegratorKind::Path,
                estimated_error: None,
            },
            rungs: counts.iter().map(|spp| Rung { spp: *spp, image: image(*spp as f32) }).collect(),
            variance: image(0.0),
        }
    }

    #[test]
    fn cells_stand_side_by_side_at_the_exposure_of_the_last_rung() {
        let (blobs, stop) = (MemoryBlobs::default(), AtomicBool::new(false));
        let ctx = Context::new(&blobs, &Silent, &stop);
        let stored = |counts: &[u64]| ladder(counts).store(&ctx).expect("in memory").into_artifact();
        let key = |text: &str| ItemKey::new(text).expect("plain");
        let collection: Collection = [
            (key("sampler=independent/L0-open-000000"), stored(&[1, 4])),
            (key("sampler=sobol/L0-open-000000"), stored(&[2, 16])),
            (key("sampler=independent/L0-open-000001"), stored(&[1, 4])),
            (key("sampler=sobol/L0-open-000001"), stored(&[2, 16])),
        ]
        .into_iter()
        .collect();
        let items = Items::new(&collection).expect("ladders");
        let montage = montage(&ctx, items, 1, 2).expect("whole").expect("pictures");
        let heads: Vec<&str> = montage.columns.iter().map(|(_, head)| head.as_str()).collect();
        assert_eq!(heads, ["sampler independent, 1 spp", "sampler sobol, 2 spp", "16 spp"]);
        assert_eq!((montage.rows.len(), montage.reduced), (1, 2));
        // The last rung is exposed to mid grey: x/(1 + x) at 0.18, to the power 1/2.2.
        let last = montage.rows[0].pictures[2].image.as_ref().expect("a picture");
        assert!((last.pixel(0, 0)[0] - preview(0.18)).abs() < 1e-6 && last.width() == 2);
        assert!(super::montage(&ctx, Items::new(&Collection::default()).expect("none"), 1, 2).expect("none").is_none());
    }
}
