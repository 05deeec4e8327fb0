//! From a stage and a cast to a scene: places objects, gives everything a material, hangs lights, aims the camera.

use super::{
    camera::Sight,
    cast::{Cast, Choice, Pool, Sky},
    forms, layouts,
    materials::{Materials, Palette, put_bitmap},
    params::SceneGenerationParams,
    skies,
    stage::{self, Role, Stage, toward},
};
use crate::geom::{Aabb, Vec3, compose, facing, length, rotation_x, rotation_y, rotation_z, scaling, sub, translation};
use std::collections::BTreeMap;
use tauflow_contract::{Context, KindError};
use tauflow_data::{
    Regime, Scene, Stratum,
    records::AssetBody,
    rng::Stream,
    scene::{Affine, Bsdf, Emitter, Geometry, Recipe, Shape, Texture},
};

/// The box of an object; empty for an HDRI.
fn box_of(body: &AssetBody) -> Aabb {
    match body {
        AssetBody::Hdri { .. } => Aabb::EMPTY,
        AssetBody::Object { bounds: [low, high], .. } => Aabb { low: *low, high: *high },
    }
}

/// Makes the `index`-th scene of a stratum. A function of the seed, the stratum, the index and the params alone (and
/// of the assets, where connected).
///
/// # Errors
/// If a blob cannot be stored.
pub fn scene(
    ctx: &Context<'_>,
    params: &SceneGenerationParams,
    pool: &Pool,
    stratum: Stratum,
    index: u64,
    seed: u64,
) -> Result<(Scene, Recipe), KindError> {
    let stream = Stream::new(seed, &[]);
    let cast = Cast::new(pool, params, stratum, index);
    let count = {
        let mut d = stream.part("count");
        let [low, high] = params.objects;
        low as usize + d.below((high - low + 1) as usize)
    };
    let choices = cast.objects(&stream, count);
    let mut stage = layouts::build(stratum, &stream.part("layout"), choices.len());
    let materials = Materials { ctx, params, palette: Palette::new(&mut stream.part("palette")) };
    let mut work = Work {
        ctx,
        params,
        regime: stratum.regime,
        stream: stream.clone(),
        materials,
        shapes: Vec::new(),
        bsdfs: Vec::new(),
        emitters: Vec::new(),
        placed: Vec::new(),
        names: Vec::new(),
    };
    work.architecture(&mut stage)?;
    work.objects(&mut stage, &choices)?;
    work.pane(&mut stage)?;
    work.lights(&mut stage);
    let environment = work.sky(&mut stage, &cast)?;
    let camera = {
        let cluster = work.placed.iter().fold(Aabb::EMPTY, Aabb::union);
        // Nothing hides a camera below objects that float; elsewhere there is a floor.
        let floor = if stage.spots.iter().all(|s| s.floating) { cluster.low[1] - 3.0 } else { 0.0 };
        let sight = Sight {
            cluster,
            objects: &work.placed,
            obstacles: &stage.obstacles,
            view: &stage.view,
            floor,
            fov: params.fov,
        };
        let draw = stream.part("camera");
        let unchecked = draw.part("check").chance(params.unchecked_cameras);
        if unchecked { sight.unchecked(&draw) } else { sight.frame(&draw) }
    };
    let exposure_ev = stream.part("exposure").range(params.exposure[0], params.exposure[1]);
    work.names.sort();
    let recipe = Recipe {
        stratum: stratum.to_string(),
        index,
        layout: stage.layout.to_owned(),
        layout_params: stage.params,
        objects: work.names,
        environment,
        content: None,
        view: 0,
        side: cast.side,
        exposure_ev,
    };
    let scene = Scene {
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

/// Air below what stands on something, in metres. Surfaces in one place are met in an order that rounding decides, and
/// renderers that move rays off surfaces by fixed steps see light where bodies touch.
const GAP: f64 = 1e-3;

struct Work<'a, 'c> {
    ctx: &'a Context<'c>,
    params: &'a SceneGenerationParams,
    regime: Regime,
    stream: Stream,
    materials: Materials<'a, 'c>,
    shapes: Vec<Shape>,
    bsdfs: Vec<Bsdf>,
    emitters: Vec<Emitter>,
    placed: Vec<Aabb>,
    names: Vec<String>,
}

impl Work<'_, '_> {
    /// The index of a material, which is added if it is new.
    fn material(&mut self, bsdf: Bsdf) -> usize {
        if let Some(found) = self.bsdfs.iter().position(|b| *b == bsdf) {
            return found;
        }
        self.bsdfs.push(bsdf);
        self.bsdfs.len() - 1
    }

    fn shape(&mut self, geometry: Geometry, to_world: Affine, material: usize) {
        self.shapes.push(Shape { geometry, to_world, material, emission: None, flip_normals: false });
    }

    fn architecture(&mut self, stage: &mut Stage) -> Result<(), KindError> {
        let mut by_role: BTreeMap<Role, usize> = BTreeMap::new();
        for piece in std::mem::take(&mut stage.pieces) {
            let material = match by_role.get(&piece.role) {
                Some(material) => *material,
                None => {
                    let mut d = self.stream.part(&format!("architecture.{:?}", piece.role));
                    let plain = matches!(piece.role, Role::Ceiling) || d.part("plain").chance(0.5);
                    // A polished floor now and then, where gloss is the subject.
                    let glossy = self.regime == Regime::L1 && piece.role == Role::Floor && d.part("gloss").chance(0.35);
                    let bsdf = if glossy {
                        self.materials.glossy(&mut d, true)?
                    } else {
                        self.materials.architecture(&mut d, piece.tiling.max(1.0).round(), plain)?
                    };
                    let material = self.material(bsdf);
                    by_role.insert(piece.role, material);
                    material
                }
            };
            let geometry = match piece.form {
                stage::Form::Rectangle => Geometry::Rectangle,
                stage::Form::Disk => Geometry::Disk,
                stage::Form::Cube => Geometry::Cube,
                stage::Form::Mesh(mesh) => Geometry::Mesh { mesh: self.ctx.put(&mesh.to_bytes()?)? },
            };
            self.shape(geometry, piece.to_world, material);
        }
        Ok(())
    }

    fn objects(&mut self, stage: &mut Stage, choices: &[Choice<'_>]) -> Result<(), KindError> {
        make_room(&mut stage.spots);
        let mut special_done = false;
        for (slot, choice) in choices.iter().enumerate() {
            let Some(spot) = stage.spots.get(slot) else { break };
            let ([x, y, z], size, floating) = (spot.position, spot.size, spot.floating);
            let position = if floating { [x, y, z] } else { [x, y + GAP, z] };
            let mut d = self.stream.part(&format!("place.{slot}"));
            let turn = stage.draw(&format!("object.{slot}.turn"), 0.0, core::f64::consts::TAU);
            let mut to_world = compose(&rotation_y(turn), &scaling([size; 3]));
            if floating {
                let tilt = stage.draw(&format!("object.{slot}.tilt"), -0.9, 0.9);
                let roll = stage.draw(&format!("object.{slot}.roll"), -0.9, 0.9);
                let centred = compose(&to_world, &translation([0.0, -0.5, 0.0]));
                to_world = compose(&compose(&rotation_x(tilt), &rotation_z(roll)), &centred);
            }
            let to_world = compose(&translation(position), &to_world);
            // The main object shows the regime, and so does the first that glass suits; of the others, half do.
            let glassy = matches!(self.regime, Regime::L2 | Regime::L3);
            let must = if glassy { !special_done && choice.glass() } else { slot == 0 };
            let special = must || slot == 0 || d.part("special").chance(0.5);
            special_done |= special && choice.glass();
            let bounds = match choice {
                Choice::Form(form, variant) => self.form(form, *variant, &to_world, special, &mut d)?,
                Choice::Asset(asset) => {
                    self.asset(&asset.body, &to_world, special, must, &mut d)?;
                    box_of(&asset.body)
                }
            };
            self.placed.push(bounds.mapped(&to_world));
            self.names.push(choice.name());
        }
        Ok(())
    }

    fn form(
        &mut self,
        form: &forms::Form,
        variant: u64,
        to_world: &Affine,
        special: bool,
        d: &mut Stream,
    ) -> Result<Aabb, KindError> {
        let bsdf = if special {
            self.materials.special(self.regime, &mut d.part("material"), form.uv, form.glass)?
        } else {
            self.materials.diffuse(&mut d.part("material"), form.uv)?
        };
        let material = self.material(bsdf);
        Ok(match forms::mesh(form, variant) {
            Some((mesh, bounds)) => {
                let mesh = self.ctx.put(&mesh.to_bytes()?)?;
                self.shape(Geometry::Mesh { mesh }, *to_world, material);
                bounds
            }
            None => {
                self.shape(Geometry::Sphere { center: [0.0, 0.5, 0.0], radius: 0.5 }, *to_world, material);
                Aabb::around([0.0, 0.5, 0.0], [0.5; 3])
            }
        })
    }

    /// An asset's parts. An asset that does not show the regime is diffuse. One that does (`special`) goes by regime:
    ///
    /// - L0 keeps base colours, on diffuse surfaces.
    /// - L1 keeps materials of its own, and gives transmissive parts a glossy one.
    /// - L2 and L3 make closed bodies of glass: always if it is the scene's only one, else three times in four. They
    ///   keep the file's own materials otherwise.
    fn asset(
        &mut self,
        body: &AssetBody,
        to_world: &Affine,
        special: bool,
        must: bool,
        d: &mut Stream,
    ) -> Result<(), KindError> {
        let AssetBody::Object { parts, materials, .. } = body else { return Ok(()) };
        let closed = parts.iter().all(|p| p.closed);
        let glassy = matches!(self.regime, Regime::L2 | Regime::L3);
        let as_glass = glassy && special && closed && (must || d.part("glass").chance(0.75));
        let glass = if as_glass {
            Some(self.materials.special(self.regime, &mut d.part("material"), false, true)?)
        } else {
            None
        };
        for (number, part) in parts.iter().enumerate() {
            let own = materials.get(part.material).ok_or_else(|| {
                KindError::Input(format!("an asset's part names material {} of {}", part.material, materials.len()))
            })?;
            let bsdf = match (&glass, self.regime) {
                (Some(glass), _) => glass.clone(),
                (None, Regime::L0) => own.diffuse.clone(),
                (None, _) if !special => own.diffuse.clone(),
                (None, Regime::L1) if own.transmissive => {
                    self.materials.glossy(&mut d.part(&format!("part.{number}")), part.uv)?
                }
                (None, _) => own.own.clone(),
            };
            let material = self.material(bsdf);
            let emission = if as_glass { None } else { own.emission.clone() };
            let geometry = Geometry::Mesh { mesh: part.mesh };
            self.shapes.push(Shape { geometry, to_world: *to_world, material, emission, flip_normals: false });
        }
        Ok(())
    }

    /// In L2, now and then, an upright thin pane beside the objects.
    fn pane(&mut self, stage: &mut Stage) -> Result<(), KindError> {
        if self.regime != Regime::L2 || !self.stream.part("pane").chance(self.params.refractive.panes) {
            return Ok(());
        }
        let Some(spot) = stage.spots.first() else { return Ok(()) };
        let (at, size) = (spot.position, spot.size);
        let azimuth = stage.draw("pane.azimuth", -0.8, 0.8) + core::f64::consts::PI;
        let (half, height) = (stage.draw("pane.half", 0.4, 0.7), stage.draw("pane.height", 0.5, 0.9));
        let away = crate::geom::direction(azimuth, 0.0);
        let far = 0.75 * size + 0.2;
        let center = [at[0] + away[0] * far, at[1] + height + 0.02, at[2] + away[2] * far];
        let bsdf = self.materials.pane(&mut self.stream.part("pane.material"));
        let material = self.material(bsdf);
        self.shape(Geometry::Rectangle, facing(center, away, [half, height]), material);
        Ok(())
    }

    fn lights(&mut self, stage: &mut Stage) {
        for (number, light) in std::mem::take(&mut stage.lights).into_iter().enumerate() {
            let mut d = self.stream.part(&format!("light.{number}"));
            // From candle to overcast, about a white of the same power.
            let warmth = d.range(-0.25, 0.5);
            let color = [1.0 + 0.5 * warmth, 1.0 + 0.05 * warmth, 1.0 - 0.6 * warmth];
            let scaled = |k: f64| color.map(|c| (c * k) as f32);
            let aim = toward(light.position, light.aim);
            let spots = matches!(self.regime, Regime::L0 | Regime::L1);
            if light.spot && spots {
                // Power into a cone of about 0.8 sr.
                self.emitters.push(Emitter::Spot {
                    to_world: facing(light.position, aim, [1.0, 1.0]),
                    intensity: scaled(light.power / 0.8),
                    cutoff_angle: 32.0,
                    beam_width: 22.0,
                });
                continue;
            }
            let material = self.material(Bsdf::Diffuse { reflectance: Texture::scalar(0.0) });
            let (geometry, to_world, area) = match self.regime {
                Regime::L3 => {
                    let [low, high] = self.params.caustic.emitter;
                    let radius = stage.draw(&format!("light.{number}.radius"), low, high);
                    // A disk as bright to what it faces as the rectangle that it stands for, somewhat off the wall.
                    let position = [0, 1, 2].map(|i| light.position[i] + 0.02 * aim[i]);
                    let to_world = facing(position, aim, [radius, radius]);
                    (Geometry::Disk, to_world, core::f64::consts::PI * radius * radius)
                }
                regime => {
                    // Broad light under L2, so that what little is focused stays soft.
                    let k = if regime == Regime::L2 { 1.5 } else { 1.0 };
                    let half = light.half.map(|h| h * k);
                    (Geometry::Rectangle, facing(light.position, aim, half), 4.0 * half[0] * half[1])
                }
            };
            let radiance = light.power / (core::f64::consts::PI * area);
            self.shapes.push(Shape {
                geometry,
                to_world,
                material,
                emission: Some(Texture::rgb(scaled(radiance))),
                flip_normals: false,
            });
        }
    }

    fn sky(&mut self, stage: &mut Stage, cast: &Cast<'_>) -> Result<String, KindError> {
        let Some(sky) = cast.sky(&mut self.stream.part("sky")) else { return Ok("none".to_owned()) };
        let turn = stage.draw("sky.turn", 0.0, core::f64::consts::TAU);
        let (image, mean) = match &sky {
            Sky::Procedural(kind, variant) => (put_bitmap(self.ctx, &skies::sky(kind.name, *variant))?, 1.0),
            Sky::Hdri(_, image, mean) => (*image, mean.max(1e-6)),
        };
        let scale = (stage.sky / mean) as f32;
        self.emitters.push(Emitter::Envmap { image, scale, to_world: rotation_y(turn) });
        Ok(sky.name())
    }
}

/// Shrinks objects that would stand in an earlier one; drops none, so that a recipe holds what was cast.
fn make_room(spots: &mut [stage::Spot]) {
    for i in 1..spots.len() {
        let (before, rest) = spots.split_at_mut(i);
        let spot = &mut rest[0];
        for other in before.iter() {
            let apart: Vec3 = sub(spot.position, other.position);
            let apart = if spot.floating { length(apart) } else { length([apart[0], 0.0, apart[2]]) };
            let most = 2.0 * (apart - 0.52 * other.size);
            spot.size = spot.size.min(most.max(0.15));
        }
    }
}
