//! Textures of a material being made: read where the mesh has their coordinates. Knows nothing of shading.
//!
//! A texture that cannot be read, for want of its coordinates or of a place for it, is noted, and its factor does not
//! stand alone. Additive effects are omitted with it: emission, transmission, the coat, bumps, holes. Required values
//! become the texture's average times the factor: colour, metal, roughness, opacity.

use super::{
    container::Document,
    images::{Images, Use},
    slots::Slot,
    uv_sets::UvSet,
};
use crate::assets::{blobs::BlobSet, refusal::Refusal};
use tauflow_data::{
    records::AssetReport,
    scene::{Rgb, Texture},
};

/// The properties of a mesh that determine the form of its material.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Features {
    /// The sets of texture coordinates that it has, of those that the material reads.
    pub sets: Vec<UvSet>,
    /// It has vertex colours.
    pub colors: bool,
    /// The bits of their alpha, if it is the same everywhere; 1 without colours.
    pub alpha: Option<u32>,
    /// It encloses a volume.
    pub closed: bool,
}

/// One material being made.
pub struct Making<'m, 'a, 'd> {
    /// The file.
    pub document: &'a Document<'d>,
    /// Its images.
    pub images: &'m mut Images,
    /// Where bitmaps go.
    pub blobs: &'m mut BlobSet,
    /// The note.
    pub report: &'m mut AssetReport,
    /// The attributes of the mesh.
    pub features: Features,
}

impl Making<'_, '_, '_> {
    /// A slot's map of the coordinates that the mesh keeps, if it has those that the slot reads.
    fn coordinates(&mut self, slot: &Slot, what: &str, becomes: &str) -> Option<[[f64; 3]; 2]> {
        let found = self.features.sets.iter().find(|set| set.set == slot.set).map(|set| set.after(&slot.uv));
        if found.is_none() {
            let why = if self.features.sets.is_empty() {
                "on meshes without their texture coordinates"
            } else {
                "on a second set of coordinates"
            };
            self.report.note(format!("textures of {what} {why} {becomes}"));
        }
        found
    }

    /// The texture of a slot times `scale`, or the scale alone without a slot; none if the mesh lacks its coordinates.
    ///
    /// # Errors
    /// If the texture or its image cannot be read.
    pub fn texture(
        &mut self,
        slot: Option<Slot>,
        purpose: Use,
        scale: Rgb,
        channel: Option<u8>,
        what: &str,
    ) -> Result<Option<Texture>, Refusal> {
        let Some(slot) = slot else { return Ok(Some(Texture::rgb(scale))) };
        let Some(uv) = self.coordinates(&slot, what, "are left out with their effect") else { return Ok(None) };
        self.bitmap(&slot, uv, purpose, scale, channel).map(Some)
    }

    /// The texture of a slot times `scale`, or the scale alone without a slot; its average if the mesh lacks its
    /// coordinates.
    ///
    /// # Errors
    /// If the texture or its image cannot be read.
    pub fn value(
        &mut self,
        slot: Option<Slot>,
        purpose: Use,
        scale: Rgb,
        channel: Option<u8>,
        what: &str,
    ) -> Result<Texture, Refusal> {
        let Some(slot) = slot else { return Ok(Texture::rgb(scale)) };
        if let Some(uv) = self.coordinates(&slot, what, "are averaged") {
            return self.bitmap(&slot, uv, purpose, scale, channel);
        }
        let average = self.average(&slot, purpose)?;
        let at = |c: usize| average[channel.map_or(c, usize::from)];
        Ok(Texture::rgb([0, 1, 2].map(|c| scale[c] * at(c))))
    }

    fn bitmap(
        &mut self,
        slot: &Slot,
        uv: [[f64; 3]; 2],
        purpose: Use,
        scale: Rgb,
        channel: Option<u8>,
    ) -> Result<Texture, Refusal> {
        let (image, clamp) = slot.image(self.document, self.report)?;
        let image = self.images.get(self.document, image, purpose, self.blobs, self.report)?;
        Ok(Texture::Bitmap { image, uv, scale, channel, clamp })
    }

    /// The average of a slot's image.
    ///
    /// # Errors
    /// If the texture or its image cannot be read.
    pub fn average(&mut self, slot: &Slot, purpose: Use) -> Result<Rgb, Refusal> {
        let (image, _) = slot.image(self.document, self.report)?;
        self.images.average(self.document, image, purpose, self.report)
    }

    /// The average of a texture that has no place in our materials; 1 without one.
    ///
    /// # Errors
    /// If the texture or its image cannot be read.
    pub fn averaged(&mut self, slot: Option<Slot>, purpose: Use, what: &str) -> Result<[f64; 3], Refusal> {
        let Some(slot) = slot else { return Ok([1.0; 3]) };
        self.report.note(format!("textures of {what} are averaged"));
        Ok(self.average(&slot, purpose)?.map(f64::from))
    }
}
