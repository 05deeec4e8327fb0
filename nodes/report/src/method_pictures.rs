//! Pictures of any methods, without an evaluation: one scene per row, and a column for each method.
//!
//! Knows no HTML. Scores are those of the pictures themselves.

use crate::{
    album::{frame_of, name_of, rung_of},
    material::{Cell, cell_of_key},
    montage::{Montage, MontageRow, Picture, choose, reduce},
};
use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{Context, Handle, Items, KindError};
use tauflow_data::{
    Image,
    image::preview,
    maths::log10,
    records::{PackedScene, Refined, bounded},
};

/// Longest side of the pictures that open the page.
const OPENING: usize = 512;

/// A column: a cell, and the calls of its image.
type Column = (Cell, u64);

/// The pictures of a report without an evaluation.
pub struct MethodPictures<'a> {
    ctx: &'a Context<'a>,
    references: Items<'a, PackedScene>,
    /// Images by scene and cell.
    images: BTreeMap<&'a str, Vec<(Cell, Handle<'a, Refined>)>>,
}

/// What is known of a scene.
struct Seen {
    /// The rung that methods start from; none in references that are held out.
    input: Option<Rung>,
    /// The last rung.
    reference: Rung,
    /// Images of the first and last calls by column, with their names.
    methods: BTreeMap<Column, (String, Image)>,
}

/// A rung of the references, by its sample count.
type Rung = (u64, Image);

/// Scores of a scene: of its input if it is there, and of the images by column.
type Scores = (Option<f64>, BTreeMap<Column, f64>);

impl<'a> MethodPictures<'a> {
    /// The pictures of these inputs.
    pub fn new(ctx: &'a Context<'a>, references: Items<'a, PackedScene>, refined: Items<'a, Refined>) -> Self {
        let mut images: BTreeMap<&str, Vec<_>> = BTreeMap::new();
        for (key, item) in refined.iter() {
            let own = key.split_cell().map_or(key.as_str(), |(_, own)| own);
            images.entry(own).or_default().push((cell_of_key(key.as_str()), item));
        }
        Self { ctx, references, images }
    }

    /// A scene; none without an image of a method.
    fn seen(&self, scene: &str, packed: Handle<'_, PackedScene>) -> Result<Option<Seen>, KindError> {
        self.ctx.check_cancelled()?;
        let Some(images) = self.images.get(scene) else { return Ok(None) };
        let packed = packed.load(self.ctx)?;
        let mut methods = BTreeMap::new();
        let mut from = None;
        for (cell, item) in images {
            for (said, image) in item.load(self.ctx)?.images {
                from = from.or(Some(said.from_spp)).min(Some(said.from_spp));
                methods.insert((cell.clone(), said.nfe), (name_of(cell, &said.method), image));
            }
        }
        let mut rungs: Vec<Rung> = packed.counts.into_iter().zip(packed.states).collect();
        rungs.sort_by_key(|(spp, _)| *spp);
        let Some((from, reference)) = from.zip(rungs.pop()) else { return Ok(None) };
        Ok(Some(Seen { input: rungs.into_iter().find(|(spp, _)| *spp == from), reference, methods }))
    }

    /// The pictures of the first scenes of each stratum, and those of the best method and the next in the scene of the
    /// median gain, or of the median PSNR if a scene lacks its input. None where no scene has images.
    ///
    /// # Errors
    /// If an image is missing from the store or damaged.
    pub fn montages(&self, scenes: usize, pixels: usize) -> Result<(Option<Montage>, Option<Montage>), KindError> {
        let mut scores: BTreeMap<String, Scores> = BTreeMap::new();
        let chosen: Vec<(String, String)> = choose(self.references, scenes)
            .into_iter()
            .map(|(scene, _, stratum)| (scene, stratum.to_string()))
            .collect();
        let (mut rows, mut columns) = (Vec::new(), Vec::new());
        for (key, packed) in self.references.iter() {
            let Some(seen) = self.seen(key.as_str(), packed)? else { continue };
            let score = |image: &Image| bounded("hdr_psnr", psnr(image, &seen.reference.1));
            let methods = seen.methods.iter().map(|(column, (_, image))| (column.clone(), score(image))).collect();
            scores.insert(key.to_string(), (seen.input.as_ref().map(|(_, image)| score(image)), methods));
            let Some((_, head)) = chosen.iter().find(|(scene, _)| *scene == key.as_str()) else { continue };
            let all: Vec<&Column> = seen.methods.keys().collect();
            let row = row(&seen, key.as_str(), head.clone(), &all, pixels);
            // Scenes with other methods than the first are left out: their pictures have no column.
            if columns.is_empty() {
                columns = row.0;
            } else if columns != row.0 {
                continue;
            }
            rows.push(row.1);
        }
        rows.sort_by_key(|row: &MontageRow| chosen.iter().position(|(scene, _)| *scene == row.scene));
        let title = "Pictures".to_owned();
        let grid = Montage { title: title.clone(), file: "methods.png".into(), columns, rows, reduced: 1 };
        let by_gain = scores.values().all(|(input, _)| input.is_some());
        let opening = match median(&gains(scores, by_gain)) {
            None => None,
            Some((scene, best)) => {
                let packed = self.references.get(scene).map(|packed| self.seen(scene, packed)).transpose()?.flatten();
                packed.map(|seen| {
                    let seen = Seen { input: seen.input.filter(|_| by_gain), ..seen };
                    let best: Vec<&Column> = best.iter().collect();
                    let (columns, row) = row(&seen, scene, String::new(), &best, OPENING);
                    Montage { title, file: String::new(), columns, rows: vec![row], reduced: 1 }
                })
            }
        };
        Ok((Some(grid).filter(|grid| !grid.rows.is_empty()), opening))
    }
}

/// Gains over the input by scene and column, or the scores themselves.
fn gains(scores: BTreeMap<String, Scores>, by_gain: bool) -> BTreeMap<String, BTreeMap<Column, f64>> {
    let over = |(input, mut methods): Scores| {
        methods.values_mut().for_each(|score| *score -= input.filter(|_| by_gain).unwrap_or(0.0));
        methods
    };
    scores.into_iter().map(|(scene, of)| (scene, over(of))).collect()
}

/// The scene of the median gain of the best method, and the two best methods by their mean gains: columns that all
/// scenes have, one for each cell.
fn median(gains: &BTreeMap<String, BTreeMap<Column, f64>>) -> Option<(&str, Vec<Column>)> {
    let all: BTreeSet<&Column> = gains.values().flat_map(BTreeMap::keys).collect();
    let everywhere =
        all.into_iter().filter(|column| gains.values().all(|own| own.get(column).is_some_and(|gain| gain.is_finite())));
    let mean = |column: &Column| gains.values().map(|own| own[column]).sum::<f64>() / gains.len() as f64;
    let mut ranked: Vec<(f64, &Column)> = everywhere.map(|column| (mean(column), column)).collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(b.1)));
    let (_, best) = *ranked.first()?;
    let second = ranked.iter().map(|(_, column)| *column).find(|column| column.0 != best.0);
    let mut scenes: Vec<(f64, &str)> = gains.iter().map(|(scene, own)| (own[best], scene.as_str())).collect();
    scenes.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(b.1)));
    let (_, scene) = scenes[(scenes.len() - 1) / 2];
    Some((scene, [Some(best), second].into_iter().flatten().cloned().collect()))
}

/// The heads and the pictures of a scene: input if there is one, these methods, reference.
fn row(
    seen: &Seen,
    scene: &str,
    head: String,
    methods: &[&Column],
    pixels: usize,
) -> (Vec<(Option<Cell>, String)>, MontageRow) {
    let (last, reference) = &seen.reference;
    let size = reference.width().max(reference.height());
    let reduced = size.div_ceil(pixels.max(1));
    let shown = |image: &Image, psnr, frame| Picture { image: Some(reduce(image, reduced).map(preview)), psnr, frame };
    let score = |image: &Image| Some(psnr(image, reference));
    let input = seen.input.as_ref().and_then(|(_, image)| score(image));
    let (mut heads, mut pictures) = (Vec::new(), Vec::new());
    if let Some((first, image)) = &seen.input {
        heads.push((None, format!("Input, {first} spp")));
        pictures.push(shown(image, input, rung_of(*first)));
    }
    for (cell, nfe) in methods.iter().copied() {
        let Some((name, image)) = seen.methods.get(&(cell.clone(), *nfe)) else { continue };
        let several = seen.methods.keys().filter(|(own, _)| own == cell).count() > 1;
        let calls = if several { format!(", NFE {nfe}") } else { String::new() };
        heads.push((Some(cell.clone()), format!("{name}{calls}")));
        pictures.push(shown(image, score(image), frame_of(name, *nfe)));
    }
    heads.push((None, format!("Reference, {last} spp")));
    pictures.push(shown(reference, None, rung_of(*last)));
    (heads, MontageRow { scene: scene.to_owned(), head, input, pictures })
}

/// HDR PSNR with peak 1 of exposed radiance; NaN where sizes differ.
fn psnr(image: &Image, reference: &Image) -> f64 {
    if !image.same_shape(reference) {
        return f64::NAN;
    }
    let square = |(a, b): (&f32, &f32)| (f64::from(*a) - f64::from(*b)).powi(2);
    let sum: f64 = image.data().iter().zip(reference.data()).map(square).sum();
    -10.0 * log10(sum / image.data().len() as f64)
}
