//! G-buffers: what a camera sees of surfaces.

use super::files::read_layers;
use crate::{DataError, Image, TensorFile, image_io::exr_bytes};
use tauflow_contract::{Artifact, Context, KindError, Media, ReadFiles, Stored, WriteFiles};

/// First-hit features, averaged over samples of each pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct GBuffer {
    /// Albedo in [0, 1].
    pub albedo: Image,
    /// Shading normal in the camera's frame (to the right, up, towards the camera), in [-1, 1]. It is shorter than 1
    /// where samples differ, and 0 where nothing is hit.
    pub normal: Image,
}

impl GBuffer {
    /// Name of its file in an exported folder.
    pub(super) const FILE: &'static str = "gbuffer.exr";
    /// Names of its layers in EXR files.
    pub const LAYERS: [&'static str; 2] = ["albedo", "normal"];
}

impl Media for GBuffer {
    const NAME: &'static str = "tauflow/gbuffer";
    const DOC: &'static str = "Albedo and shading normal as layers of `gbuffer.exr`.";

    fn load(ctx: &Context<'_>, artifact: &Artifact) -> Result<Self, KindError> {
        let file = TensorFile::from_bytes(&ctx.part(artifact, "")?)?;
        let gbuffer = Self { albedo: file.image(Self::LAYERS[0])?, normal: file.image(Self::LAYERS[1])? };
        if gbuffer.albedo.channels() != 3 || !gbuffer.albedo.same_shape(&gbuffer.normal) {
            let message = "the albedo and the normal of a G-buffer differ in size, or have not three channels each";
            return Err(DataError::Format(message.into()).into());
        }
        Ok(gbuffer)
    }

    fn store(&self, ctx: &Context<'_>) -> Result<Stored<Self>, KindError> {
        let file =
            TensorFile::default().with_image(Self::LAYERS[0], &self.albedo).with_image(Self::LAYERS[1], &self.normal);
        Ok(Stored::blob(ctx.put(&file.to_bytes()?)?))
    }

    fn export(ctx: &Context<'_>, artifact: &Artifact, to: &mut dyn WriteFiles) -> Result<(), KindError> {
        let gbuffer = Self::load(ctx, artifact)?;
        to.put(Self::FILE, &exr_bytes(&[(Self::LAYERS[0], &gbuffer.albedo), (Self::LAYERS[1], &gbuffer.normal)])?)
    }

    fn import(ctx: &Context<'_>, from: &dyn ReadFiles) -> Result<Stored<Self>, KindError> {
        let [albedo, normal] = read_layers(Self::FILE, &from.need(Self::FILE)?, Self::LAYERS)?;
        Self { albedo, normal }.store(ctx)
    }
}
