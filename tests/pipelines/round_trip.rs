//! Scenes of all strata, written for Mitsuba and read again: the same up to the normal forms of the manual, and the
//! same pictures.

use crate::support::Done;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use tauflow_contract::{Digest, KindError};
use tauflow_data::{
    Image, Resolution, Stratum,
    mesh::Mesh,
    mitsuba::{Film, export},
    records::SceneRecord,
    scene::{Bsdf, DELTA_ALPHA, Emitter, Geometry, Scene, Texture},
};
use tauflow_render::{render::Renderer, world::World};
use tauflow_scene_readers::{Options, load_scene};

/// A scene of each stratum.
const PIPELINE: &str = "
pipeline: round_trip
seed: 7
nodes:
  scenes: { kind: scene_generation, params: { pool: 12 } }
";

/// Pixels along a side, and samples per pixel.
const SIDE: u32 = 32;
const SPP: u64 = 4;

/// A factor that is worked into a picture rounds its texels by half a unit in the last place, where the renderer rounds
/// what it looks up between them. Reflectances that differ by so little make pixels that do. Bumps that do send paths
/// elsewhere after some bounces: those samples are others of the same expectation. So pictures with such factors differ
/// on average by no more than this part of the mean and so many standard errors of the difference.
const PART: f64 = 1e-6;
const ERRORS: f64 = 5.0;

/// Brings scenes into the normal form: what an export and an import leave.
struct Normal<'a> {
    load: &'a dyn Fn(&Digest) -> Vec<u8>,
    /// The pictures that it made.
    made: BTreeMap<Digest, Vec<u8>>,
    /// What the mesh in hand has to be painted with: the colours that its material reads.
    tint: Option<([f32; 3], Option<u8>)>,
    /// True once a factor was worked into values, which rounds them otherwise than the renderer does.
    rounded: bool,
}

impl Normal<'_> {
    fn put(&mut self, bytes: Vec<u8>) -> Digest {
        let digest = Digest::of(&bytes);
        self.made.insert(digest, bytes);
        digest
    }

    /// A picture of three channels, each `of` what it was.
    fn picture(&mut self, digest: &Digest, channel: Option<u8>, of: impl Fn(f32, usize) -> f32) -> Digest {
        let image = Image::from_bytes(&(self.load)(digest)).expect("a picture");
        let count = image.channels();
        let value = |t: &[f32], c: usize| match (channel.map(usize::from), count) {
            (Some(c), 1) if c < 3 => t[0],
            (Some(c), _) => t.get(c).copied().unwrap_or(1.0),
            (None, 1) => t[0],
            (None, _) => t[c],
        };
        let data = image.data().chunks_exact(count).flat_map(|t| [0, 1, 2].map(|c| of(value(t, c), c))).collect();
        self.put(Image::from_data(image.width(), image.height(), 3, data).expect("fits").to_bytes())
    }

    fn texture(&mut self, texture: &mut Texture) {
        match texture {
            Texture::Bitmap { image, scale, channel, .. } => {
                self.rounded |= *scale != [1.0; 3];
                let by = std::mem::replace(scale, [1.0; 3]);
                *image = self.picture(image, channel.take(), |value, c| value * by[c]);
            }
            Texture::VertexColor { scale, channel } => {
                self.rounded |= *scale != [1.0; 3];
                self.tint = Some((std::mem::replace(scale, [1.0; 3]), channel.take()));
            }
            Texture::Product { a, b } => {
                self.rounded = true;
                let mut factors = [a, b].map(|factor| std::mem::replace(&mut **factor, Texture::scalar(1.0)));
                factors.sort_by_key(|factor| !matches!(factor, Texture::Constant { .. }));
                let [Texture::Constant { value }, mut other] = factors else {
                    panic!("the exporter refuses products of two pictures")
                };
                let times = |c: &mut [f32; 3]| (0..3).for_each(|i| c[i] *= value[i]);
                match &mut other {
                    Texture::Constant { value } => times(value),
                    Texture::Checkerboard { color0, color1, .. } => [color0, color1].into_iter().for_each(times),
                    Texture::Bitmap { scale, .. } | Texture::VertexColor { scale, .. } => times(scale),
                    Texture::Product { .. } => panic!("a product in a product"),
                }
                *texture = other;
                self.texture(texture);
            }
            Texture::Constant { .. } | Texture::Checkerboard { .. } => {}
        }
    }

    fn bsdf(&mut self, bsdf: &mut Bsdf) {
        let smooth = |alpha: &mut f32| *alpha = if *alpha < DELTA_ALPHA { 0.0 } else { *alpha };
        match bsdf {
            Bsdf::Diffuse { reflectance } => self.texture(reflectance),
            Bsdf::Conductor { alpha, specular_reflectance, .. } => {
                smooth(alpha);
                self.texture(specular_reflectance);
            }
            Bsdf::Dielectric { alpha, specular_reflectance, specular_transmittance, .. } => {
                smooth(alpha);
                [specular_reflectance, specular_transmittance].into_iter().for_each(|t| self.texture(t));
            }
            Bsdf::ThinDielectric { specular_reflectance, specular_transmittance, .. } => {
                [specular_reflectance, specular_transmittance].into_iter().for_each(|t| self.texture(t));
            }
            Bsdf::Plastic { diffuse_reflectance, alpha, .. } => {
                smooth(alpha);
                self.texture(diffuse_reflectance);
            }
            Bsdf::Principled { base_color, metallic, roughness, spec_trans, .. } => {
                [base_color, metallic, roughness, spec_trans].into_iter().for_each(|t| self.texture(t));
            }
            Bsdf::Mask { opacity, inner } => {
                self.texture(opacity);
                self.bsdf(inner);
            }
            Bsdf::Relief { map, inner, .. } => {
                self.texture(map);
                self.bsdf(inner);
            }
            Bsdf::Finish { alpha, alpha_v, inner, .. } => {
                alpha.iter_mut().chain(alpha_v).for_each(|t| self.texture(t));
                self.bsdf(inner);
            }
            Bsdf::Blend { weight, a, b } => {
                self.texture(weight);
                [a, b].into_iter().for_each(|inner| self.bsdf(inner));
            }
            Bsdf::NormalMap { map, scale, inner } => {
                let by = std::mem::replace(scale, 1.0);
                match map {
                    Texture::Bitmap { image, channel, scale, .. } if by != 1.0 => {
                        self.rounded = true;
                        let factor = std::mem::replace(scale, [1.0; 3]);
                        let bent = |value: f32, c: usize| match value * factor[c] {
                            value if c < 2 => by * (value - 0.5) + 0.5,
                            value => value,
                        };
                        *image = self.picture(image, channel.take(), bent);
                    }
                    map => {
                        assert_eq!(by, 1.0, "maps that are no pictures have a test of their own");
                        self.texture(map);
                    }
                }
                self.bsdf(inner);
            }
            Bsdf::TwoSided { inner } => self.bsdf(inner),
        }
    }

    fn scene(&mut self, scene: &Scene) -> Scene {
        let mut out = Scene { seed: 0, materials: Vec::new(), ..scene.clone() };
        for shape in &mut out.shapes {
            self.tint = None;
            let mut bsdf = scene.materials[shape.material].clone();
            self.bsdf(&mut bsdf);
            shape.emission.iter_mut().for_each(|texture| self.texture(texture));
            shape.material = out.materials.iter().position(|b| *b == bsdf).unwrap_or_else(|| {
                out.materials.push(bsdf);
                out.materials.len() - 1
            });
            if let Geometry::Mesh { mesh } = &mut shape.geometry {
                let mut own = Mesh::from_bytes(&(self.load)(mesh)).expect("a mesh");
                own.tangents = None;
                let tint = self.tint.take();
                own.colors = tint.map(|(scale, channel)| {
                    let white = vec![[1.0; 4]; own.positions.len()];
                    let of = own.colors.take().unwrap_or(white);
                    let value = |c: [f32; 4], i: usize| channel.map_or(c[i], |channel| c[usize::from(channel).min(3)]);
                    let tinted = |c: &[f32; 4]| [0, 1, 2].map(|i: usize| value(*c, i) * scale[i]);
                    of.iter().map(tinted).map(|[r, g, b]| [r, g, b, 1.0]).collect()
                });
                *mesh = self.put(own.to_bytes().expect("as before"));
            }
        }
        for emitter in &mut out.emitters {
            if let Emitter::Envmap { image, .. } = emitter {
                *image = self.picture(image, None, |value, _| value);
            }
        }
        out
    }
}

/// A scene without factors on its pictures and normal maps.
fn bare(scene: &Scene) -> Scene {
    fn strip(value: &mut Value) {
        match value {
            Value::Object(map) => {
                match map.get("type").and_then(Value::as_str) {
                    Some("bitmap" | "vertex_color") => map["scale"] = json!([1.0, 1.0, 1.0]),
                    Some("normal_map") => map["scale"] = json!(1.0),
                    _ => {}
                }
                map.values_mut().for_each(strip);
            }
            Value::Array(values) => values.iter_mut().for_each(strip),
            _ => {}
        }
    }
    let mut value = serde_json::to_value(scene).expect("it serialises");
    strip(&mut value);
    serde_json::from_value(value).expect("a scene still")
}

/// A small picture of a scene, of one stream of random numbers.
fn rendered(scene: &Scene, load: &dyn Fn(&Digest) -> Vec<u8>) -> Image {
    let world = World::new(scene, &mut |digest: &Digest| -> Result<Vec<u8>, KindError> { Ok(load(digest)) });
    let world = world.expect("a sound scene");
    let renderer = Renderer::new(&world, Resolution::new(SIDE, SIDE).expect("small"), 7).expect("a film of that size");
    let mut film = renderer.begin();
    renderer.advance(&mut film, SPP, &mut |_| Ok(())).expect("nothing stops it");
    assert_eq!(film.rejected, 0);
    film.mean()
}

/// The mean of a picture, of its difference to another, and the standard error of that over pixels.
fn difference(a: &Image, b: &Image) -> [f64; 3] {
    let sum = |pixel: &[f32]| pixel.iter().map(|v| f64::from(*v)).sum::<f64>();
    let pixels = || a.data().chunks_exact(3).zip(b.data().chunks_exact(3)).map(|(a, b)| (sum(a), sum(b) - sum(a)));
    let count = f64::from(SIDE * SIDE);
    let mean = pixels().map(|(_, d)| d).sum::<f64>() / count;
    let variance = pixels().map(|(_, d)| (d - mean) * (d - mean)).sum::<f64>() / (count - 1.0);
    [pixels().map(|(a, _)| a).sum::<f64>() / count, mean, (variance / count).sqrt()]
}

#[test]
fn scenes_of_all_strata_come_back_from_mitsubas_format() {
    let place = tempfile::tempdir().expect("a temporary folder");
    let file = place.path().join("round_trip.yaml");
    std::fs::write(&file, PIPELINE).expect("written");
    let done = Done::run(&file, Vec::new(), &place.path().join("cache"));
    let load_own = |digest: &Digest| done.with(|ctx| ctx.get(digest)).expect("stored");
    let (mut strata, mut exact) = (BTreeSet::new(), 0);
    let scenes: BTreeMap<String, SceneRecord> = done.read("scenes");
    let both = scenes.iter().flat_map(|(key, SceneRecord { scene, .. })| [(key, scene.clone()), (key, bare(scene))]);
    for (key, scene) in both {
        let scene = &scene;
        let folder = tempfile::tempdir().expect("a folder");
        let film = Film { width: 320, height: 200, spp: 16 };
        export(scene, &mut |digest| Ok(load_own(digest)), folder.path(), film).expect("Mitsuba has all of it");
        let read = load_scene(&folder.path().join("scene.xml"), None, 0, Options::default());
        let read = read.unwrap_or_else(|e| panic!("{key}: {e}"));
        assert_eq!(read.film, Some([320, 200]));
        let mut normal = Normal { load: &load_own, made: BTreeMap::new(), tint: None, rounded: false };
        let expected = normal.scene(scene);
        let found = Scene { seed: 0, ..read.scene.clone() };
        // A zero has no sign here.
        let text = |scene: &Scene| {
            let text = serde_json::to_string_pretty(scene).expect("it serialises");
            text.replace(" -0.0\n", " 0.0\n").replace(" -0.0,", " 0.0,")
        };
        if text(&found) != text(&expected) {
            let (found, expected) = (text(&found), text(&expected));
            let at = found.lines().zip(expected.lines()).position(|(a, b)| a != b).unwrap_or(0);
            let around = |text: &str| text.lines().skip(at.saturating_sub(8)).take(16).collect::<Vec<_>>().join("\n");
            panic!("{key}, line {at}: found\n{}\nexpected\n{}", around(&found), around(&expected));
        }
        // What it names is there, and is what it says.
        assert!(read.scene.blobs().iter().all(|d| read.blobs.get(d).is_some_and(|bytes| Digest::of(bytes) == *d)));
        let found = Scene { seed: scene.seed, ..found };
        let (before, after) = (rendered(scene, &load_own), rendered(&found, &|d| read.blobs[d].clone()));
        let [mean, off, error] = difference(&before, &after);
        if normal.rounded {
            assert!(off.abs() <= PART * mean + ERRORS * error, "{key}: {off} +- {error} of {mean}");
        } else {
            assert!(before == after, "{key}: not the same to the bit, but {off} +- {error} of {mean}");
            exact += 1;
        }
        strata.insert(Stratum::of_key(key).expect("a scene's key").0.to_string());
    }
    assert_eq!(strata.len(), 12, "{strata:?}");
    assert!(exact >= scenes.len(), "{exact} of {} pictures compared to the bit", 2 * scenes.len());
}
