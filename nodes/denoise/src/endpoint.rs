//! The input of denoisers: a rung of a scene, and its G-buffer on request.

use tauflow_contract::{Each, Facts, Foreseen, KindError, Known};
use tauflow_data::{
    Image, SamplerKind,
    facts::{self, NFE, SPP},
    methods::{Conditioning, MethodName},
    records::{PackedScene, RefinedImage},
};

/// An endpoint of a scene.
pub(crate) struct Endpoint<'a> {
    /// Exposed linear radiance, [H, W, 3].
    pub(crate) color: &'a Image,
    /// Albedo and normal, [H, W, 6].
    pub(crate) gbuffer: Option<&'a Image>,
    /// The metadata of an image that is computed from it in one step.
    pub(crate) said: RefinedImage,
    /// How its samples were drawn.
    pub(crate) sampler: SamplerKind,
}

/// What is known of the image that a method makes in one step of the rung of `from` samples, and what is sure to fail.
pub(crate) fn foresee(
    known: &Known,
    port: Each<PackedScene>,
    from: u64,
    conditioning: Conditioning,
) -> (Facts, Vec<Foreseen>) {
    let endpoints = known.each(port);
    let problems = facts::rung(&endpoints, from, "/from").into_iter();
    let problems = problems.chain(facts::gbuffer(port, &endpoints, conditioning)).collect();
    (facts::image_of(&endpoints.facts).with(SPP, vec![from]).with(NFE, vec![1]), problems)
}

impl<'a> Endpoint<'a> {
    /// The rung of `from` samples, as a method sees it.
    ///
    /// # Errors
    /// If there is no such rung or no G-buffer, or the rung is no image of three channels.
    pub(crate) fn of(
        scene: &'a PackedScene,
        method: &MethodName,
        from: u64,
        conditioning: Conditioning,
    ) -> Result<Self, KindError> {
        let rung = scene.counts.iter().zip(&scene.states).find(|(count, _)| **count == from);
        let (_, color) = rung.ok_or_else(|| {
            KindError::Input(format!(
                "the scene has no rung of {from} samples, only {:?}; change `from` or the rungs",
                scene.counts
            ))
        })?;
        if color.channels() != 3 {
            return Err(KindError::Input(format!(
                "the rung of {from} samples has {} values per pixel; pack images with 3: red, green and blue",
                color.channels()
            )));
        }
        let gbuffer = match (conditioning, &scene.gbuffer) {
            (Conditioning::Rgb, _) => None,
            (Conditioning::Gbuffer, Some(gbuffer)) => Some(gbuffer),
            (Conditioning::Gbuffer, None) => {
                return Err(KindError::Input(
                    "`conditioning` is gbuffer, but the scene has no G-buffer; connect `gbuffers` of its \
                    `dataset_packing`"
                        .into(),
                ));
            }
        };
        let to_spp = scene.counts.last().copied().unwrap_or(from);
        let said = RefinedImage { method: method.as_str().to_owned(), from_spp: from, to_spp, nfe: 1 };
        Ok(Self { color, gbuffer, said, sampler: scene.sampler })
    }
}
