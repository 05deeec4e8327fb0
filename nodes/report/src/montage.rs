//! Montages: strata x methods, and methods x numbers of calls, as pictures for the page and as labelled PNGs.
//!
//! Knows no HTML.

use crate::{
    album, font,
    material::{Cell, cell_of_key},
    ranking::{Group, conditioning_name, groups, method_name, with_baselines},
};
use std::collections::BTreeMap;
use tauflow_contract::{Context, Handle, Items, KindError, Media};
use tauflow_data::{
    Image, StratumName,
    image::preview,
    image_io::encode_png,
    methods::Conditioning,
    records::{Evaluation, MethodTable, PackedScene, Refined, SceneRow},
};

/// A grid of pictures that share their conditioning.
#[derive(Clone, Debug)]
pub struct Montage {
    /// The common label of the methods, e.g. `RGB`.
    pub title: String,
    /// File name of its PNG.
    pub file: String,
    /// The columns: the input if references have it, each method with its cell, the reference; with their heads.
    pub columns: Vec<(Option<Cell>, String)>,
    /// The rows.
    pub rows: Vec<MontageRow>,
    /// Integer factor by which pictures were reduced.
    pub reduced: usize,
}

/// A scene.
#[derive(Clone, Debug)]
pub struct MontageRow {
    /// Its item key.
    pub scene: String,
    /// The name of the row: its stratum, or a method.
    pub head: String,
    /// HDR PSNR of the input, if it is known.
    pub input: Option<f64>,
    /// A picture for each column.
    pub pictures: Vec<Picture>,
}

/// A picture and its score.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Display-encoded, 3 channels; none if there is no such image.
    pub image: Option<Image>,
    /// HDR PSNR; none for the reference.
    pub psnr: Option<f64>,
    /// The frame of the viewer that shows it.
    pub frame: String,
}

/// How to make montages.
#[derive(Clone, Copy, Debug)]
pub struct Choice {
    /// Number of scenes per stratum.
    pub scenes: usize,
    /// Network calls.
    pub nfe: u64,
    /// Network calls of solvers with G-buffers.
    pub nfe_gbuffer: u64,
    /// Longest side; larger pictures are reduced by an integer factor.
    pub pixels: usize,
    /// Whether the references have the input as a rung.
    pub input: bool,
}

/// The first scenes of each stratum, in order of strata and keys.
pub fn choose<M: Media>(of: Items<'_, M>, scenes: usize) -> Vec<(String, Handle<'_, M>, StratumName)> {
    let mut by: BTreeMap<StratumName, Vec<(String, Handle<'_, M>)>> = BTreeMap::new();
    for (key, item) in of.iter() {
        if let Some((stratum, _)) = StratumName::of_key(key.as_str()) {
            by.entry(stratum).or_default().push((key.to_string(), item));
        }
    }
    by.into_iter()
        .flat_map(|(stratum, all)| all.into_iter().take(scenes).map(move |(key, item)| (key, item, stratum.clone())))
        .collect()
}

/// The sources of the images.
pub struct Pictures<'a> {
    ctx: &'a Context<'a>,
    evaluation: &'a Evaluation,
    /// Refined images by cell and scene.
    images: BTreeMap<(Cell, &'a str), Handle<'a, Refined>>,
    /// All scenes by key.
    scenes: BTreeMap<&'a str, Handle<'a, PackedScene>>,
    /// The first scenes of each stratum.
    chosen: Vec<(String, Handle<'a, PackedScene>, StratumName)>,
    choice: Choice,
}

/// Longest side of the pictures that open the page.
const OPENING: usize = 512;

impl<'a> Pictures<'a> {
    /// Montage of the first scenes of each stratum.
    pub fn new(
        ctx: &'a Context<'a>,
        evaluation: &'a Evaluation,
        references: Items<'a, PackedScene>,
        refined: Option<Items<'a, Refined>>,
        choice: Choice,
    ) -> Self {
        let items = refined.into_iter().flat_map(Items::iter);
        let images = items.map(|(key, item)| ((cell_of_key(key.as_str()), own(key.as_str())), item)).collect();
        let scenes = references.iter().map(|(key, item)| (key.as_str(), item)).collect();
        Self { ctx, evaluation, images, scenes, chosen: choose(references, choice.scenes), choice }
    }

    /// Input, if references have it, these methods and reference of one scene. The scene is that of the median gain of
    /// the first method over its input, of all scenes that it was tested on. None without its image. The methods have
    /// one image each.
    ///
    /// # Errors
    /// As [`Pictures::by_stratum`].
    pub fn opening(&self, methods: &[&MethodTable]) -> Result<Option<Montage>, KindError> {
        let Some(first) = methods.first() else { return Ok(None) };
        let calls = |table: &MethodTable| self.calls(table);
        let gain = |scene: &str| {
            let own = score(self.evaluation, scene, &first.cell, calls(first))?;
            Some(own - score(self.evaluation, scene, &Cell::new(), 0)?).filter(|gain| gain.is_finite())
        };
        let there = |scene: &&str| self.images.contains_key(&(first.cell.clone(), *scene));
        let mut gains: Vec<(f64, &str)> =
            self.scenes.keys().copied().filter(there).filter_map(|scene| Some((gain(scene)?, scene))).collect();
        gains.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(b.1)));
        let Some((_, scene)) = gains.get(gains.len().saturating_sub(1) / 2) else { return Ok(None) };
        let ends = self.ends(scene, self.scenes[scene], OPENING)?;
        let (mut heads, mut pictures) = (Vec::new(), Vec::new());
        for table in methods {
            let picture = self.refined(scene, &table.cell, calls(table), ends.reduced)?;
            if picture.image.is_some() {
                let name = format!("{}, {}", method_name(&table.method), conditioning_name(&table.conditioning));
                heads.push((Some(table.cell.clone()), name));
                pictures.push(picture);
            }
        }
        let rows = vec![ends.row(scene, (*scene).to_owned(), pictures)];
        let columns = self.columns(heads.into_iter());
        Ok(Some(Montage { title: String::new(), file: String::new(), columns, rows, reduced: ends.reduced }))
    }

    /// All methods that have images, where baselines have some; then one montage for each group of solvers that differ
    /// in the method alone.
    ///
    /// # Errors
    /// If an image is missing from the store or damaged.
    pub fn by_stratum(&self) -> Result<Vec<Montage>, KindError> {
        let drawn = |table: &&MethodTable| self.images.keys().any(|(cell, _)| *cell == table.cell);
        let everyone = with_baselines(self.evaluation).into_iter().filter(drawn).collect();
        let everyone = Group { title: "All methods".into(), slug: "all".into(), tables: everyone };
        let baselines = self.evaluation.baselines.iter().any(|table| drawn(&table));
        let own = groups(self.evaluation);
        let all: Vec<Group<'_>> = baselines.then_some(everyone).into_iter().chain(own).collect();
        let mut out = Vec::new();
        for (place, Group { title, slug, tables }) in all.into_iter().enumerate() {
            self.ctx.check_cancelled()?;
            let together = baselines && place == 0;
            let name = |t: &MethodTable| if together { album::track_of(t) } else { method_name(&t.method) };
            let heads = tables.iter().map(|t| (Some(t.cell.clone()), name(t)));
            let (mut rows, mut reduced) = (Vec::new(), 1);
            for (scene, packed, stratum) in &self.chosen {
                let ends = self.ends(scene, *packed, self.choice.pixels)?;
                reduced = ends.reduced;
                let refined = tables.iter().map(|table| self.refined(scene, &table.cell, self.calls(table), reduced));
                rows.push(ends.row(scene, stratum.to_string(), refined.collect::<Result<_, _>>()?));
            }
            let (file, columns) = (format!("montage-{slug}.png"), self.columns(heads));
            out.push(Montage { title, file, columns, rows, reduced });
        }
        Ok(out)
    }

    /// For each such group its methods by number of calls, in one scene; none where there is one number alone.
    ///
    /// The scene is one that [`Pictures::by_stratum`] shows: that of the median input by HDR PSNR, the lower of two.
    ///
    /// # Errors
    /// As [`Pictures::by_stratum`].
    pub fn by_calls(&self) -> Result<Vec<Montage>, KindError> {
        let calls = &self.evaluation.nfe;
        let mut chosen: Vec<_> = self.chosen.iter().collect();
        let input = |scene: &str| score(self.evaluation, scene, &Cell::new(), 0).unwrap_or(f64::INFINITY);
        chosen.sort_by(|a, b| input(&a.0).total_cmp(&input(&b.0)));
        let (Some((scene, packed, _)), true) = (chosen.get(chosen.len().saturating_sub(1) / 2), calls.len() > 1) else {
            return Ok(Vec::new());
        };
        let ends = self.ends(scene, *packed, self.choice.pixels)?;
        let mut out = Vec::new();
        for Group { title, slug, tables } in groups(self.evaluation) {
            self.ctx.check_cancelled()?;
            let mut rows = Vec::new();
            for table in tables.iter().filter(|t| self.images.contains_key(&(t.cell.clone(), scene.as_str()))) {
                let refined = calls.iter().map(|nfe| self.refined(scene, &table.cell, *nfe, ends.reduced));
                rows.push(ends.row(scene, method_name(&table.method), refined.collect::<Result<_, _>>()?));
            }
            let heads = calls.iter().map(|nfe| (None, format!("NFE {nfe}")));
            let (file, columns) = (format!("montage-{slug}-by-nfe.png"), self.columns(heads));
            out.push(Montage { title, file, columns, rows, reduced: ends.reduced });
        }
        Ok(out)
    }

    /// The number of calls of a method's picture: that of all, or the first that it has.
    fn calls(&self, table: &MethodTable) -> u64 {
        let gbuffer = table.conditioning == Conditioning::Gbuffer.name();
        let nfe = if gbuffer { self.choice.nfe_gbuffer } else { self.choice.nfe };
        table.at.iter().find(|at| at.nfe == nfe).or(table.at.first()).map_or(0, |at| at.nfe)
    }

    /// The input if there is one, what is between, the reference.
    fn columns(&self, between: impl Iterator<Item = (Option<Cell>, String)>) -> Vec<(Option<Cell>, String)> {
        let input = self.choice.input.then(|| (None, format!("Input, {} spp", self.evaluation.from_spp)));
        let reference = (None, format!("Reference, {} spp", self.evaluation.reference_spp));
        input.into_iter().chain(between).chain([reference]).collect()
    }

    /// The image of a cell for a scene and number of calls.
    fn refined(&self, scene: &str, cell: &Cell, nfe: u64, reduced: usize) -> Result<Picture, KindError> {
        let image = match self.images.get(&(cell.clone(), scene)) {
            Some(images) => at_nfe(self.ctx, *images, nfe)?,
            None => None,
        };
        let image = image.map(|image| reduce(&image, reduced).map(preview));
        let table = self.evaluation.methods.iter().chain(&self.evaluation.baselines).find(|of| of.cell == *cell);
        let frame = table.map_or_else(String::new, |table| album::frame_of(&album::track_of(table), nfe));
        Ok(Picture { image, psnr: score(self.evaluation, scene, cell, nfe), frame })
    }

    fn ends(&self, scene: &str, packed: Handle<'_, PackedScene>, pixels: usize) -> Result<Ends, KindError> {
        let packed = packed.load(self.ctx)?;
        let longest = |image: &Image| image.width().max(image.height());
        let reduced = packed.states.first().map_or(1, |i| longest(i).div_ceil(pixels.max(1)));
        let rung = |spp: u64| {
            let index = packed.counts.iter().position(|n| *n == spp)?;
            Some(reduce(&packed.states[index], reduced).map(preview))
        };
        let psnr = score(self.evaluation, scene, &Cell::new(), 0);
        let picture = |spp, psnr| Picture { image: rung(spp), psnr, frame: album::rung_of(spp) };
        let input = self.choice.input.then(|| picture(self.evaluation.from_spp, psnr));
        Ok(Ends { input, psnr, reference: picture(self.evaluation.reference_spp, None), reduced })
    }
}

/// The first and last images of a row.
struct Ends {
    input: Option<Picture>,
    /// HDR PSNR of the input.
    psnr: Option<f64>,
    reference: Picture,
    reduced: usize,
}

impl Ends {
    fn row(&self, scene: &str, head: String, between: Vec<Picture>) -> MontageRow {
        let pictures = self.input.iter().cloned().chain(between).chain([self.reference.clone()]).collect();
        MontageRow { scene: scene.to_owned(), head, input: self.psnr, pictures }
    }
}

fn own(key: &str) -> &str {
    key.rsplit('/').next().unwrap_or(key)
}

fn at_nfe(ctx: &Context<'_>, images: Handle<'_, Refined>, nfe: u64) -> Result<Option<Image>, KindError> {
    let found = Refined::meta(ctx, images)?.images.iter().position(|image| image.nfe == nfe);
    found.map(|index| Refined::image(ctx, images, index)).transpose()
}

fn score(evaluation: &Evaluation, scene: &str, cell: &Cell, nfe: u64) -> Option<f64> {
    let hit = |r: &&SceneRow| r.scene == scene && r.cell == *cell && r.score.nfe == nfe;
    evaluation.per_scene.iter().find(hit).map(|r| r.score.metrics.hdr_psnr)
}

/// The mean of each block of `factor` x `factor` pixels; those of the last row and column may be smaller.
pub fn reduce(image: &Image, factor: usize) -> Image {
    if factor <= 1 {
        return image.clone();
    }
    let mut out = Image::new(image.width().div_ceil(factor), image.height().div_ceil(factor), image.channels());
    let block = |at: usize, side: usize| at * factor..((at + 1) * factor).min(side);
    for y in 0..out.height() {
        for x in 0..out.width() {
            let (columns, rows) = (block(x, image.width()), block(y, image.height()));
            let area = (columns.len() * rows.len()) as f32;
            for c in 0..image.channels() {
                let pixels = rows.clone().flat_map(|y| columns.clone().map(move |x| image.pixel(x, y)[c]));
                out.pixel_mut(x, y)[c] = pixels.sum::<f32>() / area;
            }
        }
    }
    out
}

impl Montage {
    /// Whether the first column is the input: it is of no cell.
    pub fn shows_input(&self) -> bool {
        self.columns.first().is_some_and(|(cell, _)| cell.is_none())
    }

    /// The montage as one labelled PNG on white.
    ///
    /// # Errors
    /// If it cannot be encoded.
    pub fn png(&self) -> Result<Vec<u8>, KindError> {
        const GAP: usize = 8;
        const SCALE: usize = 2;
        const LINE: usize = font::HEIGHT * SCALE + 6;
        let size = self
            .rows
            .iter()
            .flat_map(|r| &r.pictures)
            .filter_map(|p| p.image.as_ref())
            .fold((1, 1), |(w, h), i| (w.max(i.width()), h.max(i.height())));
        let zoom = (208 / size.0.max(size.1)).max(1);
        let (cell_w, cell_h) = (size.0 * zoom, size.1 * zoom);
        let left = self.rows.iter().map(|r| font::width(&r.head, SCALE)).max().unwrap_or(0) + 2 * GAP;
        let width = left + self.columns.len() * (cell_w + GAP);
        let mut sheet = Image::new(width, LINE + GAP + self.rows.len() * (cell_h + LINE + GAP), 3).map(|_| 1.0);
        for (c, (_, head)) in self.columns.iter().enumerate() {
            centred(&mut sheet, left + c * (cell_w + GAP), cell_w, GAP, &head.replace("Reference", "Ref."));
        }
        for (r, row) in self.rows.iter().enumerate() {
            let y = LINE + GAP + r * (cell_h + LINE + GAP);
            font::draw(&mut sheet, [GAP, y + cell_h / 2 - font::HEIGHT], &row.head, SCALE, 0.1);
            for (c, picture) in row.pictures.iter().enumerate() {
                let x = left + c * (cell_w + GAP);
                if let Some(image) = &picture.image {
                    paste(&mut sheet, image, [x + (cell_w - image.width() * zoom) / 2, y], zoom);
                }
                let caption = match picture.psnr {
                    Some(psnr) if psnr.is_infinite() => "equal".to_owned(),
                    Some(psnr) => format!("{psnr:.2} dB"),
                    None => String::new(),
                };
                centred(&mut sheet, x, cell_w, y + cell_h + 4, &caption);
            }
        }
        Ok(encode_png(&sheet)?)
    }
}

/// A text in the middle of a cell; smaller where it does not fit.
pub fn centred(sheet: &mut Image, x: usize, cell_w: usize, y: usize, text: &str) {
    let scale = if font::width(text, 2) > cell_w { 1 } else { 2 };
    let room = cell_w.saturating_sub(font::width(text, scale)) / 2;
    font::draw(sheet, [x + room, y + (2 - scale) * font::HEIGHT / 2], text, scale, 0.1);
}

/// Puts a picture onto a sheet, its pixels enlarged.
pub fn paste(sheet: &mut Image, image: &Image, at: [usize; 2], zoom: usize) {
    for y in 0..image.height() * zoom {
        for x in 0..image.width() * zoom {
            let from = image.pixel(x / zoom, y / zoom);
            sheet.pixel_mut(at[0] + x, at[1] + y).copy_from_slice(&from[..3]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_averaged() {
        let image = Image::from_data(2, 2, 1, vec![1.0, 2.0, 3.0, 6.0]).expect("fits");
        assert_eq!(reduce(&image, 2).data(), [3.0]);
        assert_eq!(reduce(&image, 1), image);
        // A film with less than a block on one side, and part of one on the other.
        let image = Image::from_data(3, 1, 1, vec![1.0, 2.0, 5.0]).expect("fits");
        assert_eq!((reduce(&image, 2).data(), reduce(&image, 2).width()), (&[1.5, 5.0][..], 2));
    }
}
