//! Renders as pictures: previews of exposed radiance, from 0 to 1, of one size.

use tauflow_contract::{All, Context, Items, KindError};
use tauflow_data::{Image, image::preview, records::PackedScene};

/// A scene's rungs as pictures, with their sample counts.
pub(crate) struct Rungs {
    pub(crate) counts: Vec<u64>,
    pub(crate) pictures: Vec<Image>,
}

/// The pictures of each scene, from `first` of its last rungs on.
///
/// # Errors
/// If there is no scene, or they differ in size or rungs.
pub(crate) fn load(
    ctx: &Context<'_>,
    scenes: Items<'_, PackedScene>,
    port: All<PackedScene>,
    last: usize,
) -> Result<Vec<Rungs>, KindError> {
    let port = port.name();
    let mut out: Vec<Rungs> = Vec::with_capacity(scenes.len());
    for (key, scene) in scenes.iter() {
        ctx.check_cancelled()?;
        let PackedScene { counts, states, sampler, .. } = scene.load(ctx)?;
        if last > 1 && !sampler.is_independent() {
            return Err(KindError::Input(format!(
                "the rungs of `{key}` on `{port}` have correlated samples, but their times are those of independent \
                 ones; render them with `sampler: independent`"
            )));
        }
        let from = counts.len().saturating_sub(last);
        let pictures: Vec<Image> = states[from..].iter().map(|state| state.map(preview)).collect();
        let counts = counts[from..].to_vec();
        let first = out.first().and_then(|first| Some((first.pictures.first()?, &first.counts)));
        if let (Some((first, of_first)), Some(own)) = (first, pictures.first())
            && (!own.same_shape(first) || (last > 1 && counts != *of_first))
        {
            return Err(KindError::Input(format!(
                "scene `{key}` on `{port}` has {} x {} pixels and rungs {counts:?}, others {} x {} and {of_first:?}; \
                 render them alike",
                own.width(),
                own.height(),
                first.width(),
                first.height()
            )));
        }
        out.push(Rungs { counts, pictures });
    }
    if out.is_empty() {
        return Err(KindError::Input(format!("there are no scenes on `{port}`; connect scenes that were packed")));
    }
    Ok(out)
}

/// A picture turned left to right.
pub(crate) fn mirrored(picture: &Image) -> Image {
    let mut out = picture.clone();
    let row = picture.width() * picture.channels();
    for (to, from) in out.data_mut().chunks_exact_mut(row).zip(picture.data().chunks_exact(row)) {
        let pixels = to.chunks_exact_mut(picture.channels()).zip(from.chunks_exact(picture.channels()).rev());
        pixels.for_each(|(to, from)| to.copy_from_slice(from));
    }
    out
}
