//! Features that are skipped for scenes without them. Each skip can be disabled, to measure its effect and to verify
//! that the image is unchanged.
//!
//! | skip | what is left out | for |
//! |---|---|---|
//! | `kernels` | lobes that a material lacks: each sort of material has its own kernel, by lanes | every scene |
//! | `opacity` | rays that pass surfaces and are met again, dimmed shadow rays | scenes without opacity |
//! | `environment` | light from infinity: its tables, samples and lookups | closed rooms |
//! | `textures` | lookups for materials of one colour, and the coordinates for them | constant materials |
//! | `normal_maps` | frames of normal maps | materials without one |
//!
//! The first leaves every bit as it is. The others draw other random numbers, or round otherwise, when they are undone:
//! the same expectation.

use crate::world::World;
use tauflow_contract::Digest;
use tauflow_data::{
    Image,
    scene::{Bsdf, Emitter, Scene, Texture},
};

/// A skip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Skip {
    /// A kernel for each sort of material.
    Kernels,
    /// No passage through surfaces.
    Opacity,
    /// No light from infinity.
    Environment,
    /// No lookups of constant colours.
    Textures,
    /// No frames of normal maps.
    NormalMaps,
}

impl Skip {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Kernels, Self::Opacity, Self::Environment, Self::Textures, Self::NormalMaps];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Kernels => "kernels",
            Self::Opacity => "opacity",
            Self::Environment => "environment",
            Self::Textures => "textures",
            Self::NormalMaps => "normal_maps",
        }
    }

    /// Whether undoing it leaves every bit as it is.
    pub fn is_exact(self) -> bool {
        self == Self::Kernels
    }

    /// Gives a scene what it does not need, if that takes a change of the scene: a black sky, pictures of one texel,
    /// flat normal maps. Blobs that it then needs go to `put`. False if the scene needs it anyway.
    pub fn undo_in_scene(self, scene: &mut Scene, put: &mut dyn FnMut(Vec<u8>) -> Digest) -> bool {
        match self {
            Self::Kernels | Self::Opacity => true,
            Self::Environment => {
                let there = |e: &Emitter| matches!(e, Emitter::Constant { .. } | Emitter::Envmap { .. });
                if scene.emitters.iter().any(there) {
                    return false;
                }
                scene.emitters.push(Emitter::Constant { radiance: [0.0; 3] });
                true
            }
            Self::Textures => {
                let image = put(texel([1.0; 3]));
                let before = scene.materials.clone();
                scene.materials.iter_mut().for_each(|bsdf| picture(bsdf, &image));
                scene.materials != before
            }
            Self::NormalMaps => {
                let image = put(texel([0.5, 0.5, 1.0]));
                let before = scene.materials.clone();
                for bsdf in &mut scene.materials {
                    flat_map(bsdf, &image);
                }
                scene.materials != before
            }
        }
    }

    /// Makes a world do what it does not need, if that is no matter of the scene. False if it does it anyway.
    pub fn undo_in_world(self, world: &mut World) -> bool {
        match self {
            Self::Kernels => {
                world.materials.iter_mut().for_each(|used| used.material.make_general());
                true
            }
            Self::Opacity => !std::mem::replace(&mut world.features.opacity, true),
            Self::Environment | Self::Textures | Self::NormalMaps => true,
        }
    }
}

fn texel(color: [f32; 3]) -> Vec<u8> {
    Image::from_data(1, 1, 3, color.to_vec()).expect("one texel of three channels").to_bytes()
}

fn bitmap(image: &Digest, scale: [f32; 3]) -> Texture {
    Texture::Bitmap { image: *image, uv: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], scale, channel: None, clamp: false }
}

/// Constant colours of a material as pictures of one texel.
fn picture(bsdf: &mut Bsdf, image: &Digest) {
    let textures: Vec<&mut Texture> = match bsdf {
        Bsdf::Mask { inner, .. }
        | Bsdf::NormalMap { inner, .. }
        | Bsdf::Relief { inner, .. }
        | Bsdf::Finish { inner, .. }
        | Bsdf::TwoSided { inner } => return picture(inner, image),
        Bsdf::Blend { a, b, .. } => {
            picture(a, image);
            return picture(b, image);
        }
        Bsdf::Diffuse { reflectance } => vec![reflectance],
        Bsdf::Conductor { specular_reflectance, .. } => vec![specular_reflectance],
        Bsdf::Dielectric { specular_reflectance, specular_transmittance, .. }
        | Bsdf::ThinDielectric { specular_reflectance, specular_transmittance, .. } => {
            vec![specular_reflectance, specular_transmittance]
        }
        Bsdf::Plastic { diffuse_reflectance, .. } => vec![diffuse_reflectance],
        // Its other textures decide on lobes.
        Bsdf::Principled { base_color, .. } => vec![base_color],
    };
    for texture in textures {
        if let Texture::Constant { value } = texture {
            *texture = bitmap(image, *value);
        }
    }
}

/// A normal map that changes nothing, around what a material is on its sides.
fn flat_map(bsdf: &mut Bsdf, image: &Digest) {
    match bsdf {
        Bsdf::Mask { inner, .. } => flat_map(inner, image),
        Bsdf::NormalMap { .. } | Bsdf::Relief { .. } => {}
        other => {
            let inner = Box::new(other.clone());
            *other = Bsdf::NormalMap { map: bitmap(image, [1.0; 3]), scale: 1.0, inner };
        }
    }
}
