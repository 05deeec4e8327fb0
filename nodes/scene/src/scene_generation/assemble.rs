//! From a stage to a scene: gives everything a material, lights the lamps, hangs the sky, aims the camera.

use super::{
    camera,
    cast::{Cast, Pool},
    hour::Hour,
    layouts,
    params::SceneGenerationParams,
    stage::{Body, HERE, Skin, Stage, Thing},
};
use core::f64::consts::PI;
use std::{collections::BTreeMap, sync::Arc};
use tauflow_contract::{Context, Digest, KindError};
use tauflow_data::{
    ContextClass, Regime, Scene, Stratum,
    geom::{Vec3, add, cross, dot, length, mul, sub, unit},
    maths,
    mesh::Mesh,
    records::AssetBody,
    rng::Stream,
    scene::{Affine, Bsdf, Emitter, Geometry, Recipe, Shape, Texture},
};
use tauflow_scene_library::{
    Facts,
    forms::Family,
    materials::{Materials, Palette},
    stuff::Stuff,
};

/// Which scene of a stratum.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Which {
    /// Number of the content: it decides everything but what `view` does.
    pub content: u64,
    /// Number of the view: camera, exposure and time of day. 0 is the plain one.
    pub view: u32,
}

/// The stage of a content.
///
/// # Errors
/// If a mesh of the library is too large for a blob.
pub fn plan<'a>(cast: &'a Cast<'a>, stratum: Stratum, stream: &Stream) -> Result<Stage<'a>, KindError> {
    let most = {
        let mut d = stream.part("count");
        let [low, high] = cast.params.objects.map(f64::from);
        // As many small scenes as large ones, by ratio.
        maths::exp(d.range(maths::log(low), maths::log(high + 1.0))).floor().clamp(low, high) as usize
    };
    let mut stage = layouts::build(stratum, cast, &stream.part("layout"), most);
    match stage.fault.take() {
        Some(fault) => Err(fault),
        None => Ok(stage),
    }
}

/// Makes a scene of a stratum. A function of the seed, the stratum, which it is, and the params alone (and of the
/// assets, where connected).
///
/// # Errors
/// If a blob cannot be stored.
pub fn scene(
    ctx: &Context<'_>,
    params: &SceneGenerationParams,
    pool: &Pool,
    stratum: Stratum,
    which: Which,
    seed: u64,
) -> Result<(Scene, Recipe), KindError> {
    let stream = Stream::new(seed, &[]);
    let cast = Cast::new(pool, params, stratum, which.content);
    let stage = plan(&cast, stratum, &stream)?;
    of_stage(ctx, stage, which, seed)
}

/// A view of a stage.
///
/// # Errors
/// If a blob cannot be stored.
pub fn of_stage(ctx: &Context<'_>, stage: Stage<'_>, which: Which, seed: u64) -> Result<(Scene, Recipe), KindError> {
    let (stratum, cast) = (stage.stratum, stage.cast);
    let params = cast.params;
    let stream = Stream::new(seed, &[]);
    let view = match which.view {
        0 => stream.clone(),
        view => stream.part(&format!("view.{view}")),
    };
    let ranges = params.ranges();
    let materials = Materials { ctx, ranges: &ranges, palette: Palette::new(&mut stream.part("palette")) };
    let mut work = Assembly {
        ctx,
        params,
        regime: stratum.regime,
        context: stratum.context,
        stream: stream.clone(),
        hour: Hour::draw(stratum, &mut view.part("hour")),
        materials,
        shapes: Vec::new(),
        bsdfs: Vec::new(),
        emitters: Vec::new(),
        stuffs: BTreeMap::new(),
        blobs: BTreeMap::new(),
    };
    for (label, skin) in &stage.skins {
        work.skin(label, skin)?;
    }
    for thing in &stage.things {
        work.thing(thing)?;
    }
    for (number, (light, power, _)) in stage.lights.iter().enumerate() {
        work.light(number, light, *power, cast)?;
    }
    let environment = work.sky(&stage, cast, &mut view.part("sky.turn"))?;
    let camera = camera::aim(&stage, params.fov, &view.part("camera"));
    let exposure_ev = view.part("exposure").range(params.exposure[0], params.exposure[1]);
    let mut objects: Vec<String> = stage.things.iter().map(|t| t.body.name()).collect();
    objects.sort();
    let recipe = Recipe {
        stratum: stratum.to_string(),
        index: which.content,
        content: Some(which.content),
        view: which.view,
        layout: stage.layout.to_owned(),
        layout_params: stage.params,
        objects,
        environment,
        side: cast.side,
        exposure_ev,
    };
    let scene = Scene {
        hide_emitters: false,
        version: 1,
        seed,
        camera,
        max_depth: params.depth(stratum.context),
        shapes: work.shapes,
        materials: work.bsdfs,
        emitters: work.emitters,
    };
    Ok((scene, recipe))
}

/// A scene in the making.
pub struct Assembly<'a, 'c> {
    pub(super) ctx: &'a Context<'c>,
    pub(super) params: &'a SceneGenerationParams,
    pub(super) regime: Regime,
    context: ContextClass,
    pub(super) stream: Stream,
    pub(super) hour: Hour,
    materials: Materials<'a, 'c>,
    shapes: Vec<Shape>,
    bsdfs: Vec<Bsdf>,
    pub(super) emitters: Vec<Emitter>,
    /// Materials of things, by stuff, whether they are special, and number.
    stuffs: BTreeMap<(Stuff, bool, usize), usize>,
    /// Blobs of forms that are stored.
    blobs: BTreeMap<(&'static str, u64), Vec<Digest>>,
}

/// How many materials of a stuff a scene has at most: chairs of one set are of one wood, books have covers of their
/// own.
fn kinds(stuff: Stuff) -> usize {
    match stuff {
        Stuff::Print => 8,
        Stuff::Fabric | Stuff::Ceramic | Stuff::Plastic | Stuff::Food | Stuff::PaintedMetal => 5,
        Stuff::Wood | Stuff::Metal | Stuff::Leather | Stuff::Paper | Stuff::Clay | Stuff::Leaf | Stuff::Wax => 3,
        Stuff::Grass | Stuff::Soil | Stuff::Sand | Stuff::Asphalt | Stuff::Snow | Stuff::Water | Stuff::Brick => 1,
        _ => 2,
    }
}

impl Assembly<'_, '_> {
    /// The index of a material, which is added if it is new.
    pub(super) fn material(&mut self, bsdf: Bsdf) -> usize {
        if let Some(found) = self.bsdfs.iter().position(|b| *b == bsdf) {
            return found;
        }
        self.bsdfs.push(bsdf);
        self.bsdfs.len() - 1
    }

    pub(super) fn shape(&mut self, geometry: Geometry, to_world: Affine, material: usize, emission: Option<Texture>) {
        self.shapes.push(Shape { geometry, to_world, material, emission, flip_normals: false });
    }

    /// A structure of one material: a rectangle if it is one quad, otherwise a mesh.
    fn skin(&mut self, label: &str, skin: &Skin) -> Result<(), KindError> {
        let d = self.stream.part(&format!("skin.{label}"));
        let special = skin.special;
        for (land, to_world) in &skin.lands {
            let bsdf = self.materials.stuff(skin.stuff, self.regime, special, [1.0, 1.0], &mut d.clone())?;
            let material = self.material(bsdf);
            let mesh = self.ctx.put(&land.blob)?;
            self.shape(Geometry::Mesh { mesh }, *to_world, material, None);
        }
        match skin.quads.as_slice() {
            [] => {}
            [[a, b, c, e]] => {
                let (u, v) = (mul(sub(*b, *a), 0.5), mul(sub(*e, *a), 0.5));
                let n = unit(cross(u, v));
                let center = mul(add(*a, *c), 0.5);
                let to_world = [0, 1, 2].map(|r| [u[r], v[r], n[r], center[r]]);
                // A rectangle's v grows upwards, that of images downwards.
                let per_metre = [0.5 / length(u), -0.5 / length(v)];
                let bsdf = self.materials.stuff(skin.stuff, self.regime, special, per_metre, &mut d.clone())?;
                let material = self.material(bsdf);
                self.shape(Geometry::Rectangle, to_world, material, None);
            }
            quads => {
                let bsdf = self.materials.stuff(skin.stuff, self.regime, special, [1.0, 1.0], &mut d.clone())?;
                let material = self.material(bsdf);
                let mesh = self.ctx.put(&mesh_of(quads).to_bytes()?)?;
                self.shape(Geometry::Mesh { mesh }, HERE, material, None);
            }
        }
        Ok(())
    }

    /// The material of a part of a thing of `set`. Prints that cover a whole part use its uv box.
    fn stuff(
        &mut self,
        stuff: Stuff,
        special: bool,
        set: u32,
        over: Option<[[f64; 2]; 2]>,
    ) -> Result<usize, KindError> {
        let mut d = self.stream.part(&format!("set.{set}.{stuff:?}"));
        let number = d.below(kinds(stuff));
        if let (None, Some(found)) = (over, self.stuffs.get(&(stuff, special, number))) {
            return Ok(*found);
        }
        let label = match over {
            Some(_) => format!("whole.{set}"),
            None => format!("stuff.{stuff:?}.{special}.{number}"),
        };
        let mut d = self.stream.part(&label);
        let bsdf = self.materials.stuff_over(stuff, self.regime, special, [1.0, 1.0], over, &mut d)?;
        let material = self.material(bsdf);
        if over.is_none() {
            self.stuffs.insert((stuff, special, number), material);
        }
        Ok(material)
    }

    /// The meshes of a form's variant, stored.
    fn meshes(&mut self, facts: &Arc<Facts>) -> Result<Vec<Digest>, KindError> {
        let key = (facts.form.name, facts.variant);
        if let Some(found) = self.blobs.get(&key) {
            return Ok(found.clone());
        }
        let stored: Vec<Digest> =
            facts.parts.iter().map(|p| self.ctx.put(&p.blob)).collect::<Result<_, KindError>>()?;
        self.blobs.insert(key, stored.clone());
        Ok(stored)
    }

    fn thing(&mut self, thing: &Thing<'_>) -> Result<(), KindError> {
        let facts = match &thing.body {
            Body::Form(facts) => facts.clone(),
            Body::Asset(asset) => return self.asset(&asset.body, thing),
        };
        let meshes = self.meshes(&facts)?;
        let mut d = self.stream.part(&format!("thing.{}", thing.set));
        let as_glass = thing.glass.then(|| {
            let mirror = self.regime == Regime::L3 && d.chance(self.params.caustic.mirror);
            if mirror { Stuff::Mirror } else { Stuff::Glass }
        });
        let glows: f64 = facts.parts.iter().filter(|p| glows(p.stuff)).map(|p| p.area).sum();
        let glassy = matches!(self.regime, Regime::L2 | Regime::L3);
        for (part, mesh) in facts.parts.iter().zip(meshes) {
            // Without glass a pane would be a board before what it is to show.
            if part.stuff == Stuff::Pane && !glassy {
                continue;
            }
            let stuff = as_glass.filter(|_| !glows_or_grows(part.stuff)).unwrap_or(part.stuff);
            // In regimes with glass, what is special is glass through and through, or in L3 polished metal.
            let special = match self.regime {
                Regime::L0 | Regime::L1 => thing.special,
                Regime::L2 => false,
                Regime::L3 => thing.special && stuff == Stuff::Metal,
            };
            let pictured = matches!(facts.form.family, Family::Frame | Family::Sign);
            let over = (stuff == Stuff::Print && pictured).then_some(part.extent);
            let material = self.stuff(stuff, special, thing.set, over)?;
            let emission = match self.power(&facts, thing, part.stuff) {
                Some(power) if power > 0.0 => {
                    let radiance = self.warm(power / (PI * glows.max(1e-4)), &mut d.part("warmth"));
                    let mut own = d.part("glow");
                    Some(self.materials.glow_over(part.stuff, &mut own, radiance, part.extent)?)
                }
                _ => None,
            };
            self.shape(Geometry::Mesh { mesh }, thing.to_world, material, emission);
        }
        Ok(())
    }

    /// Power of a part that glows, if the thing is lit: what the layout gives, else small lamps and screens as they
    /// come.
    fn power(&self, facts: &Facts, thing: &Thing<'_>, stuff: Stuff) -> Option<f64> {
        if !glows(stuff) {
            return None;
        }
        if self.context == ContextClass::Environment {
            // By day lamps are off, and what else glows is lost in the light of the sky.
            return None;
        }
        if let Some(power) = thing.power {
            return Some(power * self.hour.lamps);
        }
        let mut d = self.stream.part(&format!("lit.{}", thing.set));
        match facts.form.family {
            Family::Screen => d.chance(0.85).then(|| 6.0 * d.range(0.5, 1.5)),
            Family::Sign => d.chance(0.7).then(|| 5.0 * d.range(0.5, 1.5)),
            family if Stage::is_lamp(family) => d.chance(0.6).then(|| self.hour.lamps * d.range(3.0, 10.0)),
            _ => Some(1.5 * d.range(0.5, 1.5)),
        }
    }

    /// An asset's parts. An asset that does not show the regime is diffuse. One that does goes by regime:
    ///
    /// - L0 keeps base colours, on diffuse surfaces.
    /// - L1 keeps materials of its own, and gives transmissive parts a glossy one.
    /// - L2 and L3 make closed bodies of glass if the stage says so. They keep the file's own materials otherwise.
    fn asset(&mut self, body: &AssetBody, thing: &Thing<'_>) -> Result<(), KindError> {
        let AssetBody::Object { parts, materials, .. } = body else { return Ok(()) };
        let mut d = self.stream.part(&format!("thing.{}", thing.set));
        let glass = if thing.glass {
            let mirror = self.regime == Regime::L3 && d.chance(self.params.caustic.mirror);
            Some(self.stuff(if mirror { Stuff::Mirror } else { Stuff::Glass }, false, thing.set, None)?)
        } else {
            None
        };
        for (number, part) in parts.iter().enumerate() {
            let own = materials.get(part.material).ok_or_else(|| {
                KindError::Input(format!("an asset's part names material {} of {}", part.material, materials.len()))
            })?;
            let material = match (glass, self.regime) {
                (Some(glass), _) => glass,
                (None, Regime::L0) => self.material(own.diffuse.clone()),
                (None, _) if !thing.special => self.material(own.diffuse.clone()),
                (None, Regime::L1) if own.transmissive => {
                    let bsdf = self.materials.glossy(&mut d.part(&format!("part.{number}")), part.uv)?;
                    self.material(bsdf)
                }
                (None, _) => self.material(own.own.clone()),
            };
            let emission = if thing.glass { None } else { own.emission.clone() };
            self.shape(Geometry::Mesh { mesh: part.mesh }, thing.to_world, material, emission);
        }
        Ok(())
    }
}

fn glows(stuff: Stuff) -> bool {
    matches!(stuff, Stuff::Glow | Stuff::Screen)
}

fn glows_or_grows(stuff: Stuff) -> bool {
    glows(stuff) || matches!(stuff, Stuff::Leaf | Stuff::Grass | Stuff::Soil)
}

/// The mesh of quads: flat, uv in metres, u along the longer side so that grain follows it.
fn mesh_of(quads: &[[Vec3; 4]]) -> Mesh {
    let mut mesh = Mesh::default();
    let mut uvs = Vec::new();
    for quad in quads {
        let (mut a, mut b) = (sub(quad[1], quad[0]), sub(quad[3], quad[0]));
        // Narrow boards have their grain along them; broad surfaces have v upright.
        if length(b) > 3.0 * length(a) && length(a) < 0.4 {
            core::mem::swap(&mut a, &mut b);
        }
        let (a, b) = (unit(a), unit(b));
        let first = mesh.positions.len() as u32;
        for p in quad {
            mesh.positions.push(p.map(|v| v as f32));
            uvs.push([dot(*p, a) as f32, -dot(*p, b) as f32]);
        }
        mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    mesh.uvs = Some(uvs);
    mesh
}
