//! One scene of `time_error`: its images by method, each with what it took and what it is off by.
//!
//! Knows where images and their times come from; how scenes are summed up is in `time_tables`.

use crate::{
    held_out::{Errors, HeldOut},
    metrics::Reference,
    time_samples::{Measured, MethodOf, Sample, quartiles},
};
use std::collections::BTreeMap;
use tauflow_contract::{Context, Handle, ItemKey, Items, KindError, Media};
use tauflow_data::{
    Image, SamplerKind,
    methods::{Conditioning, GBUFFER, PATH_TRACER, PATH_TRACER_SOBOL},
    records::{Ladder, PackedScene, Refined, RefinedImage, TimedImage, Timing},
    timing::Repeated,
};

/// A cell's images and times, by scene.
struct CellOf<'a, I> {
    name: &'a str,
    images: BTreeMap<&'a str, I>,
    times: BTreeMap<&'a str, Handle<'a, Timing>>,
}

/// Images of a scene that were rendered for a method alone.
#[derive(Clone, Copy)]
enum Rendering<'a> {
    /// By another renderer.
    Renderer(Handle<'a, Refined>),
    /// By the path tracer, with another sampler.
    Sampler(Handle<'a, Ladder>),
}

/// The cells that start from our own endpoints, and those that render for themselves.
pub(crate) struct Cells<'a> {
    refined: Vec<CellOf<'a, Handle<'a, Refined>>>,
    rendered: Vec<CellOf<'a, Rendering<'a>>>,
}

/// The items connected to a port, with its name.
pub(crate) type Connected<'a, M> = (&'static str, Option<Items<'a, M>>);

/// The path tracer's images of a scene, what they take, and the scene's exposure.
pub(crate) struct Own<'a> {
    pub(crate) packed: &'a PackedScene,
    pub(crate) rendering: &'a Timing,
    pub(crate) factor: f64,
}

impl<'a> Cells<'a> {
    /// Cells of images that start from our own endpoints, and of images of other renderers and samplers; each with the
    /// times that they took.
    ///
    /// # Errors
    /// If a cell has images and no times, or times and no images.
    pub(crate) fn new(
        (refined, times): (Connected<'a, Refined>, Connected<'a, Timing>),
        (rendered, sampled, rendered_times): (Connected<'a, Refined>, Connected<'a, Ladder>, Connected<'a, Timing>),
    ) -> Result<Self, KindError> {
        let renderers = listed(rendered.1).map(|(key, images)| (key, Rendering::Renderer(images)));
        let samplers = listed(sampled.1).map(|(key, ladder)| (key, Rendering::Sampler(ladder)));
        let ports = format!("{}` or `{}", rendered.0, sampled.0);
        Ok(Self {
            refined: cells(refined.0, listed(refined.1), times)?,
            rendered: cells(&ports, renderers.chain(samplers), rendered_times)?,
        })
    }
}

fn listed<'a, M: Media>(items: Option<Items<'a, M>>) -> impl Iterator<Item = (&'a ItemKey, Handle<'a, M>)> {
    items.into_iter().flat_map(Items::iter)
}

/// Cells by name, which the ports of images and of times must share.
fn cells<'a, I>(
    images_port: &str,
    images: impl Iterator<Item = (&'a ItemKey, I)>,
    (times_port, times): Connected<'a, Timing>,
) -> Result<Vec<CellOf<'a, I>>, KindError> {
    let mut cells: BTreeMap<&str, CellOf<'_, I>> = BTreeMap::new();
    let empty = |name| CellOf { name, images: BTreeMap::new(), times: BTreeMap::new() };
    for (key, of) in images {
        let (name, scene) = key.split_cell().unwrap_or(("", key.as_str()));
        cells.entry(name).or_insert_with(|| empty(name)).images.insert(scene, of);
    }
    for (key, timing) in listed(times) {
        let (name, scene) = key.split_cell().unwrap_or(("", key.as_str()));
        cells.entry(name).or_insert_with(|| empty(name)).times.insert(scene, timing);
    }
    if let Some(cell) = cells.values().find(|cell| cell.images.is_empty() || cell.times.is_empty()) {
        let (there, missing) =
            if cell.images.is_empty() { (times_port, images_port) } else { (images_port, times_port) };
        return Err(KindError::Input(format!(
            "`{there}` has the cell `{}` and `{missing}` has not; connect the output and the `timing` of the same \
             nodes",
            cell.name
        )));
    }
    Ok(cells.into_values().collect())
}

impl<'a, I: Copy> CellOf<'a, I> {
    /// Images and times of a scene.
    fn scene(&self, key: &ItemKey) -> Result<(I, Handle<'a, Timing>), KindError> {
        let found = self.images.get(key.as_str()).zip(self.times.get(key.as_str()));
        found.map(|(images, times)| (*images, *times)).ok_or_else(|| {
            KindError::Input(format!("the cell `{}` lacks the scene `{key}`; connect the same scenes", self.name))
        })
    }
}

/// Images of one cell: each with its method's name and samples per pixel; a note; and the sampler of our own ladders.
type Images = (Vec<(String, u64, Image)>, Option<String>, Option<SamplerKind>);

impl Rendering<'_> {
    fn load(self, ctx: &Context<'_>) -> Result<Images, KindError> {
        match self {
            Self::Renderer(images) => {
                let Refined { images, note, .. } = images.load(ctx)?;
                let images = images.into_iter().map(|(said, image)| (said.method, said.from_spp, image)).collect();
                Ok((images, note, None))
            }
            Self::Sampler(ladder) => {
                let ladder = ladder.load(ctx)?;
                let name = match ladder.meta.sampler {
                    SamplerKind::Independent => PATH_TRACER,
                    SamplerKind::Sobol => PATH_TRACER_SOBOL,
                };
                let images = ladder.rungs.into_iter().map(|rung| (name.to_owned(), rung.spp, rung.image)).collect();
                Ok((images, None, Some(ladder.meta.sampler)))
            }
        }
    }
}

/// Quartiles of the wall and processor times of an image.
#[derive(Clone, Copy, Default)]
struct Took {
    wall_s: [f64; 3],
    cpu_s: [f64; 3],
}

impl Took {
    /// The time of consecutive steps.
    fn then(self, next: Self) -> Self {
        let sum = |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|i| a[i] + b[i]);
        Self { wall_s: sum(self.wall_s, next.wall_s), cpu_s: sum(self.cpu_s, next.cpu_s) }
    }

    /// Quartiles of repeated times; none of no times.
    fn of(Repeated { wall_s, cpu_s }: &Repeated) -> Option<Self> {
        let quartiles = |times: &[f64]| (!times.is_empty()).then(|| quartiles(times.iter().copied()));
        Some(Self { wall_s: quartiles(wall_s)?, cpu_s: quartiles(cpu_s)? })
    }
}

/// Times of an image; none if it was not timed. Without a method any one's times will do, but for the G-buffer's.
fn times_of(timing: &Timing, method: Option<&str>, spp: u64, nfe: u64) -> Option<Took> {
    let named = |e: &TimedImage| method.map_or(e.method != GBUFFER, |method| method == e.method);
    Took::of(&timing.entries.iter().find(|e| e.from_spp == spp && e.nfe == nfe && named(e))?.took)
}

/// Times of the G-buffer, whatever its samples; none if it was not timed.
fn times_of_gbuffer(timing: &Timing) -> Option<Took> {
    Took::of(&timing.entries.iter().find(|e| e.method == GBUFFER)?.took)
}

/// Measures a scene.
struct Judge<'a> {
    key: &'a ItemKey,
    held_out: &'a HeldOut,
    reference: Reference<'a>,
}

impl<'a> Judge<'a> {
    fn new(key: &'a ItemKey, held_out: &'a HeldOut) -> Result<Self, KindError> {
        let reference =
            Reference::new(&held_out.image).map_err(|e| KindError::Input(format!("the reference of `{key}`: {e}")))?;
        Ok(Self { key, held_out, reference })
    }

    fn untimed(&self, what: &str) -> KindError {
        KindError::Input(format!("`{what}` of `{}` was not timed; time it at the same rungs and NFE", self.key))
    }

    fn sample(&self, image: &Image, from_spp: u64, nfe: u64, took: Took) -> Result<Sample, KindError> {
        let metrics =
            self.reference.metrics(image).map_err(|e| KindError::Input(format!("an image of `{}`: {e}", self.key)))?;
        let Errors { mse, rel_mse, hdr_psnr, unresolved } = self.held_out.errors(image);
        let Took { wall_s, cpu_s } = took;
        let (preview_psnr, ssim) = (metrics.preview_psnr, metrics.ssim);
        Ok(Sample { from_spp, nfe, wall_s, cpu_s, mse, rel_mse, hdr_psnr, preview_psnr, ssim, unresolved })
    }

    /// The path tracer's own images. A ladder may go on beyond what was timed.
    fn own(&self, own: &Own<'_>) -> Result<Vec<Sample>, KindError> {
        let mut samples = Vec::new();
        for (spp, image) in own.packed.counts.iter().zip(&own.packed.states) {
            if let Some(took) = times_of(own.rendering, Some(PATH_TRACER), *spp, 0) {
                samples.push(self.sample(image, *spp, 0, took)?);
            }
        }
        if samples.len() < 2 { Err(self.untimed(PATH_TRACER)) } else { Ok(samples) }
    }

    /// Images of another renderer or sampler, which may go on beyond what was timed, but not be without.
    fn rendered(
        &self,
        cell: &str,
        images: &[(String, u64, Image)],
        times: &Timing,
        factor: f64,
    ) -> Result<Vec<Judged>, KindError> {
        if let Some((name, ..)) = images.first()
            && images.iter().all(|(_, spp, _)| times_of(times, None, *spp, 0).is_none())
        {
            return Err(self.untimed(name));
        }
        if images.iter().any(|(name, ..)| name == PATH_TRACER) {
            return Err(KindError::Input(format!(
                "the cell `{cell}` has ladders of independent samples, as `ladders` has; `sampled` takes those of \
                 another sampler"
            )));
        }
        let mut judged = Vec::new();
        for (name, spp, image) in images {
            let Some(took) = times_of(times, None, *spp, 0) else { continue };
            let exposed = image.map(|v| (f64::from(v) * factor) as f32);
            // A renderer sees a scene, and no image of it.
            let method = MethodOf { conditioning: String::new(), ..MethodOf::new(cell, name) };
            judged.push((method, self.sample(&exposed, *spp, 0, took)?));
        }
        Ok(judged)
    }

    /// Images made from our own endpoints, or from those of another sampler: each takes the endpoint's time, too, and
    /// the G-buffer's if it sees one.
    fn refined(
        &self,
        cell: &str,
        images: &Refined,
        times: &Timing,
        (rendering, own): (&Timing, &Timing),
    ) -> Result<Vec<Judged>, KindError> {
        let judge = |(said, image): &(RefinedImage, Image)| {
            let mut method = MethodOf::new(cell, &said.method);
            if !images.sampler.is_independent() {
                method = method.on_sampler(images.sampler.name());
            }
            let after = times_of(times, None, said.from_spp, said.nfe).ok_or_else(|| self.untimed(&said.method))?;
            let before = times_of(rendering, Some(PATH_TRACER), said.from_spp, 0);
            let before = before.ok_or_else(|| self.untimed(PATH_TRACER))?;
            let aside = match method.conditioning == Conditioning::Gbuffer.name() {
                true => times_of_gbuffer(own).ok_or_else(|| self.untimed(GBUFFER))?,
                false => Took::default(),
            };
            let sample = self.sample(image, said.from_spp, said.nfe, after.then(before).then(aside))?;
            Ok((method, sample))
        };
        images.images.iter().map(judge).collect()
    }
}

/// The times of the ladders of a sampler that the images of a cell were made from.
fn rendering_by<'a>(
    sampler: SamplerKind,
    ladders: &'a [(SamplerKind, Timing)],
    cell: &str,
) -> Result<&'a Timing, KindError> {
    let mut found = ladders.iter().filter(|(of, _)| *of == sampler).map(|(_, times)| times);
    let name = sampler.name();
    match (found.next(), found.next()) {
        (Some(times), None) => Ok(times),
        (None, _) => Err(KindError::Input(format!(
            "the images of `{cell}` were made from ladders of `sampler: {name}`, whose times are unknown; connect \
             these ladders to `sampled`, and their `timing` to `rendered_times`"
        ))),
        (Some(_), Some(_)) => Err(KindError::Input(format!(
            "the images of `{cell}` were made from ladders of `sampler: {name}`, but several cells of `sampled` have \
             it; connect one"
        ))),
    }
}

/// An image with the method that made it.
type Judged = (MethodOf, Sample);

/// All images of a scene, measured. Notes say what was left out.
///
/// # Errors
/// If the reference is no judge, an image cannot be compared with it or was not timed, or a cell lacks the scene.
pub(crate) fn measured(
    ctx: &Context<'_>,
    key: &ItemKey,
    held_out: &HeldOut,
    own: &Own<'_>,
    cells: &Cells<'_>,
    notes: &mut Vec<String>,
) -> Result<Measured, KindError> {
    let judge = Judge::new(key, held_out)?;
    // Of the same samples a reference is no judge.
    if held_out.noisy && own.packed.states.contains(&held_out.image) {
        return Err(KindError::Input(format!(
            "the reference of `{key}` is a rung of its own ladder; render references with a different `stream`"
        )));
    }
    let mut methods: BTreeMap<MethodOf, Vec<Sample>> = BTreeMap::new();
    let samples = judge.own(own)?;
    let mut judged = Vec::new();
    // The times of ladders of other samplers.
    let mut ladders: Vec<(SamplerKind, Timing)> = Vec::new();
    for cell in &cells.rendered {
        let (images, times) = cell.scene(key)?;
        let (images, note, sampler) = images.load(ctx)?;
        notes.extend(note);
        let times = times.load(ctx)?;
        judged.extend(judge.rendered(cell.name, &images, &times, own.factor)?);
        ladders.extend(sampler.map(|sampler| (sampler, times)));
    }
    for cell in &cells.refined {
        let (images, times) = cell.scene(key)?;
        let images = images.load(ctx)?;
        notes.extend(images.note.clone());
        let rendering = if images.sampler.is_independent() {
            own.rendering
        } else {
            rendering_by(images.sampler, &ladders, cell.name)?
        };
        judged.extend(judge.refined(cell.name, &images, &times.load(ctx)?, (rendering, own.rendering))?);
    }
    for (method, sample) in judged {
        methods.entry(method).or_default().push(sample);
    }
    // Cells come in the order of their names, where 16 is before 4.
    methods.values_mut().for_each(|of| of.sort_by_key(|sample| (sample.from_spp, sample.nfe)));
    Ok(Measured { scene: key.to_string(), own: samples, methods })
}
