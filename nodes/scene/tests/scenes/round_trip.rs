//! Scenes of all strata, written for Mitsuba and read again: the same up to the normal forms of the manual.

use crate::support::{load, source};
use serde_json::json;
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::atomic::AtomicBool,
};
use tauflow_contract::{Context, Digest, MemoryBlobs, Silent};
use tauflow_data::{
    Image, Stratum,
    mesh::Mesh,
    mitsuba::{Film, export},
    records::SceneRecord,
    scene::{Bsdf, DELTA_ALPHA, Emitter, Geometry, Scene, Texture},
};
use tauflow_scene::{Options, load_scene};

/// Brings scenes into the normal form: what an export and an import leave.
struct Normal<'a> {
    load: &'a dyn Fn(&Digest) -> Vec<u8>,
    /// What each mesh has to be painted with: the colours that its material reads.
    tints: Vec<Option<([f32; 3], Option<u8>)>>,
}

impl Normal<'_> {
    /// A picture of three channels with its factor and channel worked into it.
    fn picture(&self, digest: &Digest, scale: &[f32; 3], channel: Option<u8>) -> Digest {
        let image = Image::from_bytes(&(self.load)(digest)).expect("a picture");
        let count = image.channels();
        let value = |t: &[f32], c: usize| match (channel.map(usize::from), count) {
            (Some(c), 1) if c < 3 => t[0],
            (Some(c), _) => t.get(c).copied().unwrap_or(1.0),
            (None, 1) => t[0],
            (None, _) => t[c],
        };
        let data = image.data().chunks_exact(count).flat_map(|t| [0, 1, 2].map(|c| value(t, c) * scale[c])).collect();
        Digest::of(&Image::from_data(image.width(), image.height(), 3, data).expect("fits").to_bytes())
    }

    fn texture(&mut self, texture: &Texture) -> Texture {
        match texture {
            Texture::Bitmap { image, uv, scale, channel, clamp } => {
                let image = self.picture(image, scale, *channel);
                Texture::Bitmap { image, uv: *uv, scale: [1.0; 3], channel: None, clamp: *clamp }
            }
            Texture::VertexColor { scale, channel } => {
                self.tints.push(Some((*scale, *channel)));
                Texture::VertexColor { scale: [1.0; 3], channel: None }
            }
            Texture::Product { a, b } => {
                let (a, b) = (self.texture(a), self.texture(b));
                let ((Texture::Constant { value }, other) | (other, Texture::Constant { value })) = (a, b) else {
                    panic!("the exporter refuses products of two pictures")
                };
                let times = |c: [f32; 3]| [0, 1, 2].map(|i: usize| c[i] * value[i]);
                match other {
                    Texture::Constant { value } => Texture::Constant { value: times(value) },
                    Texture::Checkerboard { color0, color1, scale } => {
                        Texture::Checkerboard { color0: times(color0), color1: times(color1), scale }
                    }
                    other => other,
                }
            }
            same => same.clone(),
        }
    }

    fn bsdf(&mut self, bsdf: &Bsdf) -> Bsdf {
        let alpha = |alpha: f32| if alpha < DELTA_ALPHA { 0.0 } else { alpha };
        match bsdf.clone() {
            Bsdf::Diffuse { reflectance } => Bsdf::Diffuse { reflectance: self.texture(&reflectance) },
            Bsdf::Conductor { eta, k, alpha: a, specular_reflectance: r } => {
                Bsdf::Conductor { eta, k, alpha: alpha(a), specular_reflectance: self.texture(&r) }
            }
            Bsdf::Dielectric { int_ior, ext_ior, alpha: a, specular_reflectance: r, specular_transmittance: t } => {
                let (specular_reflectance, specular_transmittance) = (self.texture(&r), self.texture(&t));
                Bsdf::Dielectric { int_ior, ext_ior, alpha: alpha(a), specular_reflectance, specular_transmittance }
            }
            Bsdf::Plastic { diffuse_reflectance: r, int_ior, ext_ior, alpha: a } => {
                Bsdf::Plastic { diffuse_reflectance: self.texture(&r), int_ior, ext_ior, alpha: alpha(a) }
            }
            Bsdf::TwoSided { inner } => Bsdf::TwoSided { inner: Box::new(self.bsdf(&inner)) },
            Bsdf::Mask { opacity, inner } => {
                Bsdf::Mask { opacity: self.texture(&opacity), inner: Box::new(self.bsdf(&inner)) }
            }
            Bsdf::Blend { weight, a, b } => {
                let weight = self.texture(&weight);
                Bsdf::Blend { weight, a: Box::new(self.bsdf(&a)), b: Box::new(self.bsdf(&b)) }
            }
            other => other,
        }
    }

    fn scene(&mut self, scene: &Scene) -> Scene {
        let mut out = Scene { seed: 0, materials: Vec::new(), ..scene.clone() };
        for shape in &mut out.shapes {
            self.tints.clear();
            let bsdf = self.bsdf(&scene.materials[shape.material]);
            shape.emission = shape.emission.as_ref().map(|texture| self.texture(texture));
            let tint = self.tints.first().copied().flatten();
            shape.material = out.materials.iter().position(|b| *b == bsdf).unwrap_or_else(|| {
                out.materials.push(bsdf);
                out.materials.len() - 1
            });
            if let Geometry::Mesh { mesh } = &mut shape.geometry {
                let mut own = Mesh::from_bytes(&(self.load)(mesh)).expect("a mesh");
                own.tangents = None;
                own.colors = tint.map(|(scale, channel)| {
                    let white = vec![[1.0; 4]; own.positions.len()];
                    let of = own.colors.take().unwrap_or(white);
                    let value = |c: [f32; 4], i: usize| channel.map_or(c[i], |channel| c[usize::from(channel).min(3)]);
                    let tinted = |c: &[f32; 4]| [0, 1, 2].map(|i: usize| value(*c, i) * scale[i]);
                    of.iter().map(tinted).map(|[r, g, b]| [r, g, b, 1.0]).collect()
                });
                *mesh = Digest::of(&own.to_bytes().expect("as before"));
            }
        }
        for emitter in &mut out.emitters {
            if let Emitter::Envmap { image, .. } = emitter {
                *image = self.picture(image, &[1.0; 3], None);
            }
        }
        out
    }
}

#[test]
fn diffuse_scenes_come_back_from_mitsubas_format() {
    let blobs = MemoryBlobs::default();
    let scenes =
        source(&blobs, "scene_generation", json!({ "pool": 12, "regimes": ["L0"] }), &BTreeMap::new()).remove("scenes");
    let (stop, mut strata) = (AtomicBool::new(false), BTreeSet::new());
    let ctx = Context::new(&blobs, &Silent, &stop);
    for (key, artifact) in &scenes.expect("the port").items {
        let scene = load::<SceneRecord>(&blobs, artifact).scene;
        let folder = tempfile::tempdir().expect("a folder");
        let film = Film { width: 320, height: 200, spp: 16 };
        export(&scene, &mut |digest| ctx.get(digest), folder.path(), film).expect("Mitsuba has all of it");
        let read = load_scene(&folder.path().join("scene.xml"), None, 0, Options::default());
        let read = read.unwrap_or_else(|e| panic!("{key}: {e}"));
        assert_eq!(read.film, Some([320, 200]));
        let load_own = |digest: &Digest| ctx.get(digest).expect("stored");
        let expected = Normal { load: &load_own, tints: Vec::new() }.scene(&scene);
        let found = Scene { seed: 0, ..read.scene.clone() };
        let text = |scene: &Scene| serde_json::to_string_pretty(scene).expect("it serialises");
        if text(&found) != text(&expected) {
            let (found, expected) = (text(&found), text(&expected));
            let at = found.lines().zip(expected.lines()).position(|(a, b)| a != b).unwrap_or(0);
            let around = |text: &str| text.lines().skip(at.saturating_sub(8)).take(16).collect::<Vec<_>>().join("\n");
            panic!("{key}, line {at}: found\n{}\nexpected\n{}", around(&found), around(&expected));
        }
        // What it names is there, and is what it says.
        assert!(read.scene.blobs().iter().all(|d| read.blobs.get(d).is_some_and(|bytes| Digest::of(bytes) == *d)));
        strata.insert(Stratum::of_key(key.as_str()).expect("a scene's key").0.to_string());
    }
    assert_eq!(strata.len(), 3, "{strata:?}");
}
