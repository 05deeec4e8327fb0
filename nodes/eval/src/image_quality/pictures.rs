//! The images that are scored: generated ones, and clean renders in display values, at one size.
//!
//! Knows no score.

use tauflow_contract::{Context, Handle, Items, KindError};
use tauflow_data::{
    Image,
    image::preview,
    records::{Family, Generated, GeneratedMeta, PackedScene, Variant},
};

/// A backbone with its samples, in the order of their numbers.
#[derive(Clone)]
pub(crate) struct Backbone<'a> {
    /// Its name.
    pub(crate) name: String,
    /// What sort of model it is.
    pub(crate) family: Family,
    /// Sampler steps.
    pub(crate) steps: u64,
    /// The variants that each of its samples has.
    pub(crate) variants: Vec<Variant>,
    /// The samples.
    pub(crate) samples: Vec<Sample<'a>>,
}

/// One sample of a backbone.
#[derive(Clone)]
pub(crate) struct Sample<'a> {
    /// What is said of it.
    pub(crate) meta: GeneratedMeta,
    /// Its images, not loaded yet.
    pub(crate) images: Handle<'a, Generated>,
}

/// The backbones that samples are of, by name.
///
/// # Errors
/// If samples of one backbone do not belong together, or a number stands twice.
pub(crate) fn backbones<'a>(
    ctx: &Context<'_>,
    generated: Items<'a, Generated>,
) -> Result<Vec<Backbone<'a>>, KindError> {
    let mut found: Vec<Backbone<'a>> = Vec::new();
    for (key, images) in generated.iter() {
        let meta = Generated::meta(ctx, images)?;
        let variants: Vec<Variant> = meta.variants.iter().map(|its| its.variant).collect();
        let name = meta.backbone.as_str().to_owned();
        let at = found.iter().position(|backbone| backbone.name == name).unwrap_or_else(|| {
            let (family, steps) = (meta.family, meta.steps);
            found.push(Backbone { name, family, steps, variants: variants.clone(), samples: Vec::new() });
            found.len() - 1
        });
        let backbone = &mut found[at];
        if (backbone.family, backbone.steps) != (meta.family, meta.steps) || backbone.variants != variants {
            return Err(KindError::Input(format!(
                "`{key}` is a sample of backbone `{}` of another family, number of steps or list of variants than the \
                 samples before it; give each run of a backbone its own name",
                backbone.name
            )));
        }
        if backbone.samples.iter().any(|sample| sample.meta.sample == meta.sample) {
            return Err(KindError::Input(format!(
                "`{key}` is sample {} of backbone `{}`, which another item is too; give each run of a backbone its own \
                 name",
                meta.sample, backbone.name
            )));
        }
        backbone.samples.push(Sample { meta, images });
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    found.iter_mut().for_each(|backbone| backbone.samples.sort_by_key(|sample| sample.meta.sample));
    Ok(found)
}

impl Sample<'_> {
    /// The final image of a variant.
    ///
    /// # Errors
    /// If its blob is missing or damaged.
    pub(crate) fn image(&self, ctx: &Context<'_>, variant: Variant) -> Result<Image, KindError> {
        Generated::image(ctx, self.images, variant)
    }
}

/// The clean render of a scene in display values: its last rung.
///
/// # Errors
/// If the scene is damaged.
pub(crate) fn clean(ctx: &Context<'_>, scene: Handle<'_, PackedScene>) -> Result<Image, KindError> {
    let last = scene.load(ctx)?.states.pop();
    last.map(|state| state.map(preview)).ok_or_else(|| KindError::Input("a packed scene without rungs".into()))
}

/// Width and height.
pub(crate) type Size = [usize; 2];

/// The size of an image.
pub(crate) fn size(image: &Image) -> Size {
    [image.width(), image.height()]
}

/// The smaller of two sizes, if the larger one is a whole multiple of it.
pub(crate) fn common(a: Size, b: Size) -> Option<Size> {
    [(a, b), (b, a)].into_iter().find(|(small, large)| factor(*large, *small).is_some()).map(|(small, _)| small)
}

/// By which whole number both sides of `small` fit into those of `large`.
fn factor(large: Size, small: Size) -> Option<usize> {
    let factor = large[0].checked_div(small[0])?;
    (factor > 0 && [small[0] * factor, small[1] * factor] == large).then_some(factor)
}

/// The image at a size that divides its own: means of blocks of display values.
///
/// # Errors
/// If the size is none of that; `what` names the image.
pub(crate) fn at_size(image: Image, to: Size, what: &str) -> Result<Image, KindError> {
    let own = size(&image);
    let factor = factor(own, to).ok_or_else(|| {
        KindError::Input(format!(
            "{what} has {} x {} pixels, which is no whole multiple of {} x {}; images of one side have one size",
            own[0], own[1], to[0], to[1]
        ))
    })?;
    if factor == 1 {
        return Ok(image);
    }
    let mut out = Image::new(to[0], to[1], image.channels());
    let area = (factor * factor) as f32;
    for (x, y) in (0..to[1]).flat_map(|y| (0..to[0]).map(move |x| (x, y))) {
        for c in 0..image.channels() {
            let rows = y * factor..(y + 1) * factor;
            let block = rows.flat_map(|row| (x * factor..(x + 1) * factor).map(move |column| (column, row)));
            out.pixel_mut(x, y)[c] = block.map(|(column, row)| image.pixel(column, row)[c]).sum::<f32>() / area;
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_meet_at_the_smaller_size() {
        assert_eq!(common([64, 32], [128, 64]), Some([64, 32]));
        assert_eq!(common([128, 64], [64, 32]), Some([64, 32]));
        assert_eq!(common([64, 64], [64, 64]), Some([64, 64]));
        assert_eq!([common([64, 64], [96, 96]), common([64, 64], [128, 64]), common([0, 0], [4, 4])], [None; 3]);
        let image = Image::from_data(2, 2, 1, vec![0.0, 0.5, 1.0, 0.5]).expect("fits");
        assert_eq!(at_size(image.clone(), [1, 1], "it").expect("divides").data(), [0.5]);
        assert_eq!(at_size(image.clone(), [2, 2], "it").expect("itself"), image);
        let told = at_size(image, [3, 3], "the image").expect_err("no multiple").to_string();
        assert!(told.contains("the image has 2 x 2") && told.contains("3 x 3"), "{told}");
    }
}
