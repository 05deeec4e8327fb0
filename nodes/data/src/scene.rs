//! Scene description: plain, self-contained JSON; meshes and textures by digest.
//!
//! The renderer reads exactly the data that is hashed. Definitions are those of Mitsuba 3's plugins of the same name.
//! Right-handed world, metres, y up. Matrices are affine, row-major 3x4, and map columns: world = M * (local, 1).

use serde::{Deserialize, Serialize};
use tauflow_contract::Digest;

/// Linear RGB.
pub type Rgb = [f32; 3];

/// Affine map, rows of a 3x4 matrix.
pub type Affine = [[f64; 4]; 3];

/// The identity map.
pub const IDENTITY: Affine = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];

/// A scene: all that decides its image, and nothing else.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Format version, 1.
    pub version: u32,
    /// Seed of all its random numbers.
    pub seed: u64,
    /// The camera.
    pub camera: Camera,
    /// Longest path in segments: 1 sees emitters only, 2 adds direct light; as Mitsuba's `max_depth`.
    pub max_depth: u32,
    /// Surfaces.
    pub shapes: Vec<Shape>,
    /// Materials, referred to by index.
    pub materials: Vec<Bsdf>,
    /// Emitters that are not shapes.
    pub emitters: Vec<Emitter>,
    /// True hides emitters from camera rays: these pass through emitting shapes, and find no light from infinity.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub hide_emitters: bool,
}

/// Perspective pinhole camera. The image's aspect ratio is the film's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Where it stands.
    pub origin: [f64; 3],
    /// The point that it looks at.
    pub target: [f64; 3],
    /// Which way is up.
    pub up: [f64; 3],
    /// Horizontal field of view, degrees (Mitsuba's `fov_axis: x`).
    pub fov_x: f64,
    /// Nothing nearer is seen.
    pub near: f64,
}

/// A surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shape {
    /// Its form, in local coordinates.
    pub geometry: Geometry,
    /// Where it stands.
    pub to_world: Affine,
    /// Index into the scene's materials.
    pub material: usize,
    /// Emitted radiance on the side of the normal, if it is an area emitter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub emission: Option<Texture>,
    /// True turns the normals round.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub flip_normals: bool,
}

/// The form of a surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum Geometry {
    /// A triangle mesh, a blob in the format of [`crate::mesh::Mesh`].
    Mesh {
        /// Its digest.
        mesh: Digest,
    },
    /// A sphere; `to_world` may scale uniformly, rotate and move it.
    Sphere {
        /// Local centre.
        center: [f64; 3],
        /// Local radius.
        radius: f64,
    },
    /// The square [-1, 1]^2 in the plane z = 0, normal +z, uv = (xy + 1) / 2. Normal maps have s along u, t along v.
    Rectangle,
    /// The unit disk in the plane z = 0, normal +z.
    Disk,
    /// The cube [-1, 1]^3.
    Cube,
}

/// A value over a surface: constant, or an image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum Texture {
    /// The same everywhere. Scalars repeat their value.
    Constant {
        /// Linear RGB.
        value: Rgb,
    },
    /// Two colours in squares, by uv.
    Checkerboard {
        /// First colour.
        color0: Rgb,
        /// Second colour.
        color1: Rgb,
        /// Squares a unit of uv.
        scale: [f64; 2],
    },
    /// An image, a blob in the format of [`crate::mesh::Bitmap`]; bilinear, repeated unless `clamp`.
    Bitmap {
        /// Its digest.
        image: Digest,
        /// Linear map of uv before the look-up, rows of a 2x3 matrix.
        uv: [[f64; 3]; 2],
        /// Multiplies the image's values.
        scale: Rgb,
        /// For scalar uses, the channel to read (0 red ... 3 alpha); otherwise RGB.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        channel: Option<u8>,
        /// True clamps at the border, false repeats.
        #[serde(default, skip_serializing_if = "std::ops::Not::not")]
        clamp: bool,
    },
    /// The mesh's vertex colours, times a factor.
    VertexColor {
        /// Multiplies the colours.
        scale: Rgb,
        /// 3 for the alpha of the vertex colour, 0..2 for one channel, none for RGB.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        channel: Option<u8>,
    },
    /// The product of two.
    Product {
        /// First factor.
        a: Box<Texture>,
        /// Second factor.
        b: Box<Texture>,
    },
}

impl Texture {
    /// A constant colour.
    pub fn rgb(value: Rgb) -> Self {
        Self::Constant { value }
    }

    /// A constant scalar.
    pub fn scalar(value: f32) -> Self {
        Self::Constant { value: [value; 3] }
    }

    /// Every image it reads.
    pub fn images(&self, found: &mut Vec<Digest>) {
        match self {
            Self::Bitmap { image, .. } => found.push(*image),
            Self::Product { a, b } => {
                a.images(found);
                b.images(found);
            }
            Self::Constant { .. } | Self::Checkerboard { .. } | Self::VertexColor { .. } => {}
        }
    }
}

/// Roughness alpha below which a lobe is specular: it has no density, and is exported as the smooth plugin.
pub const DELTA_ALPHA: f32 = 1e-3;

/// The distribution of the microfacets of a rough surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distribution {
    /// GGX (Trowbridge-Reitz), with long tails.
    Ggx,
    /// Beckmann: Gaussian slopes.
    Beckmann,
}

/// The content of a [`Bsdf::Relief`] map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReliefForm {
    /// Normals in the tangent space.
    Normals,
    /// Heights above the surface, in the unit of its positions.
    Heights,
}

/// The scattering of a surface. Roughness `alpha` is GGX's; below [`DELTA_ALPHA`] a lobe is specular.
///
/// # Units
/// Reflectances, transmittances, opacities, weights and the parameters of `principled` are shares: the renderer refuses
/// a scene in which one of them can be below 0, above 1 or no number, with its material, field and value, and cuts
/// nothing. A texture is held to its bounds (texels times `scale`, products factor by factor), in which one part in a
/// million beyond 1 counts as rounding: that much is cut where the surface is shaded. Vertex colours that a material
/// reads are held to 0 to 1, too.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
#[expect(
    clippy::large_enum_variant,
    reason = "a scene holds a few dozen of them, and boxed fields would be a nuisance to build"
)]
pub enum Bsdf {
    /// Lambertian, one-sided.
    Diffuse {
        /// Albedo.
        reflectance: Texture,
    },
    /// Metal: GGX with the Fresnel term of a complex index of refraction (`conductor`, `roughconductor`).
    Conductor {
        /// Real part of the IOR, by RGB; finite, from 0.
        eta: Rgb,
        /// Imaginary part; finite, from 0.
        k: Rgb,
        /// Roughness; 0 is a mirror.
        alpha: f32,
        /// Multiplies the reflection.
        specular_reflectance: Texture,
    },
    /// Glass (`dielectric`, `roughdielectric`): normal points outside.
    Dielectric {
        /// Index of refraction inside.
        int_ior: f32,
        /// Index of refraction outside.
        ext_ior: f32,
        /// Roughness; 0 is smooth.
        alpha: f32,
        /// Multiplies the reflection.
        specular_reflectance: Texture,
        /// Multiplies the transmission.
        specular_transmittance: Texture,
    },
    /// A thin sheet of glass (`thindielectric`).
    ThinDielectric {
        /// Index of refraction inside.
        int_ior: f32,
        /// Index of refraction outside.
        ext_ior: f32,
        /// Multiplies the reflection.
        specular_reflectance: Texture,
        /// Multiplies the transmission.
        specular_transmittance: Texture,
    },
    /// A diffuse base under a dielectric coat (`plastic`, `roughplastic`), with `nonlinear: false`.
    Plastic {
        /// Albedo of the base.
        diffuse_reflectance: Texture,
        /// Index of refraction of the coat.
        int_ior: f32,
        /// Index of refraction outside.
        ext_ior: f32,
        /// Roughness of the coat; 0 is smooth.
        alpha: f32,
    },
    /// Disney's BSDF as Mitsuba 3's `principled`, with the parameters glTF needs.
    Principled {
        /// Base colour.
        base_color: Texture,
        /// Metal share.
        metallic: Texture,
        /// Perceptual roughness; alpha = roughness^2, but 0.001 at least, as in Mitsuba.
        roughness: Texture,
        /// Specular level in [0, 1]; 0.5 is an IOR of 1.5, and below 0.001 counts as that, as in Mitsuba.
        specular: f32,
        /// Share of specular transmission.
        spec_trans: Texture,
        /// Clearcoat strength in [0, 1].
        clearcoat: f32,
        /// Clearcoat gloss in [0, 1].
        clearcoat_gloss: f32,
    },
    /// Lets light through unchanged where opacity is below 1 (`mask`).
    Mask {
        /// Opacity in [0, 1].
        opacity: Texture,
        /// The material of opaque points.
        inner: Box<Bsdf>,
    },
    /// A mix of two (`blendbsdf`).
    Blend {
        /// Weight of the second, in [0, 1].
        weight: Texture,
        /// First.
        a: Box<Bsdf>,
        /// Second.
        b: Box<Bsdf>,
    },
    /// Perturbs the shading normal by a tangent-space map (`normalmap`).
    NormalMap {
        /// Normals as (n + 1) / 2; what points less than 0.001 above the surface is raised to that, as no surface is
        /// seen from below.
        map: Texture,
        /// Scales x and y of the map's normals.
        scale: f32,
        /// The material to shade.
        inner: Box<Bsdf>,
    },
    /// A normal map or a bump map with the options that Mitsuba 3.7 has added (`normalmap`, `bumpmap`).
    Relief {
        /// The content of the map.
        form: ReliefForm,
        /// Normals as (n + 1) / 2, or heights.
        map: Texture,
        /// Scales x and y of normals, or heights.
        scale: f32,
        /// Whether the perturbed normal is turned about the shading normal where the viewer would see it from behind.
        flip: bool,
        /// Whether light at grazing incidence is dimmed, which smooths the edge of shadows (Estevez et al. 2019).
        shadowing: bool,
        /// The material to shade.
        inner: Box<Bsdf>,
    },
    /// A conductor, dielectric or plastic whose microfacets are not GGX of constant roughness, or a nonlinear plastic.
    Finish {
        /// The distribution of microfacets.
        distribution: Distribution,
        /// Roughness at each point, which replaces `alpha` of a conductor or dielectric. Values below 0.001 count as
        /// 0.001.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        alpha: Option<Texture>,
        /// Roughness across the direction of growing u; `alpha`, which is then required, is that along it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        alpha_v: Option<Texture>,
        /// Whether internal reflections below the coat of a plastic are coloured by the base (`nonlinear`).
        #[serde(default)]
        nonlinear: bool,
        /// The conductor, dielectric or plastic.
        inner: Box<Bsdf>,
    },
    /// The same from both sides (`twosided`).
    TwoSided {
        /// The material of both sides.
        inner: Box<Bsdf>,
    },
}

/// An emitter that is not a shape.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum Emitter {
    /// The same radiance from everywhere.
    Constant {
        /// Radiance.
        radiance: Rgb,
    },
    /// An environment map (Mitsuba's `envmap`): latitude-longitude, a blob in the format of
    /// [`crate::mesh::Bitmap`]. Local direction d, y up: u = atan2(d.x, -d.z) / 2 pi, v = acos(d.y) / pi.
    Envmap {
        /// Its digest.
        image: Digest,
        /// Multiplies the radiance.
        scale: f32,
        /// Turns it.
        to_world: Affine,
    },
    /// A point light.
    Point {
        /// Where.
        position: [f64; 3],
        /// Radiant intensity.
        intensity: Rgb,
    },
    /// A spot light, linear falloff between two angles.
    Spot {
        /// Looks along local +z from the local origin.
        to_world: Affine,
        /// Radiant intensity on the axis.
        intensity: Rgb,
        /// Half angle where it ends, degrees.
        cutoff_angle: f64,
        /// Half angle where it begins to fall, degrees.
        beam_width: f64,
    },
    /// Parallel light, as from a sun without extent.
    Directional {
        /// Direction in which it travels.
        direction: [f64; 3],
        /// Irradiance on a surface that faces it.
        irradiance: Rgb,
    },
}

impl Scene {
    /// Digests of every mesh and image it reads, in order, without repeats.
    pub fn blobs(&self) -> Vec<Digest> {
        let mut found = Vec::new();
        for shape in &self.shapes {
            if let Geometry::Mesh { mesh } = shape.geometry {
                found.push(mesh);
            }
            if let Some(texture) = &shape.emission {
                texture.images(&mut found);
            }
        }
        self.materials.iter().for_each(|material| material.images(&mut found));
        for emitter in &self.emitters {
            if let Emitter::Envmap { image, .. } = emitter {
                found.push(*image);
            }
        }
        found.sort();
        found.dedup();
        found
    }
}

impl Bsdf {
    /// Every image it reads.
    pub fn images(&self, found: &mut Vec<Digest>) {
        match self {
            Self::Diffuse { reflectance } => reflectance.images(found),
            Self::Conductor { specular_reflectance, .. } => specular_reflectance.images(found),
            Self::Dielectric { specular_reflectance, specular_transmittance, .. }
            | Self::ThinDielectric { specular_reflectance, specular_transmittance, .. } => {
                specular_reflectance.images(found);
                specular_transmittance.images(found);
            }
            Self::Plastic { diffuse_reflectance, .. } => diffuse_reflectance.images(found),
            Self::Principled { base_color, metallic, roughness, spec_trans, .. } => {
                [base_color, metallic, roughness, spec_trans].iter().for_each(|t| t.images(found));
            }
            Self::Mask { opacity, inner } => {
                opacity.images(found);
                inner.images(found);
            }
            Self::Blend { weight, a, b } => {
                weight.images(found);
                a.images(found);
                b.images(found);
            }
            Self::NormalMap { map, inner, .. } | Self::Relief { map, inner, .. } => {
                map.images(found);
                inner.images(found);
            }
            Self::Finish { alpha, alpha_v, inner, .. } => {
                alpha.iter().chain(alpha_v).for_each(|t| t.images(found));
                inner.images(found);
            }
            Self::TwoSided { inner } => inner.images(found),
        }
    }
}

/// How a scene was made; beside the scene, never read by the renderer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// Its stratum, as text such as `L1-open`.
    pub stratum: String,
    /// Index in its stratum.
    pub index: u64,
    /// Which content of its stratum it shows: objects, layout and materials. None where each scene has its own, of its
    /// index; see [`Recipe::content`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub content: Option<u64>,
    /// Which view of the content it is: camera, exposure, power of the lights, turn of the sky. 0 is the plain one.
    #[serde(default, skip_serializing_if = "is_plain")]
    pub view: u32,
    /// Layout template.
    pub layout: String,
    /// The layout's parameters.
    pub layout_params: std::collections::BTreeMap<String, f64>,
    /// Names of the objects in it (assets by name, procedural ones as `procedural/<form>`), sorted, with repeats.
    pub objects: Vec<String>,
    /// Name of the environment (an asset, `procedural/<sky>`, or `none`).
    pub environment: String,
    /// Side of the asset pools it was drawn from, when assets are held out.
    pub side: Option<Side>,
    /// Exposure offset in stops, U[-1, 1].
    pub exposure_ev: f64,
}

fn is_plain(view: &u32) -> bool {
    *view == 0
}

impl Recipe {
    /// Number of the content that the scene shows, among those of its stratum.
    pub fn content(&self) -> u64 {
        self.content.unwrap_or(self.index)
    }
}

/// Side of a split.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// For learning.
    Train,
    /// For judging.
    Test,
}
