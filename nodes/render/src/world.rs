//! A scene made ready to render: shapes in world space under one hierarchy, materials, lights, and what it needs.
//!
//! A mesh that several shapes place is held once, if that is worth it: [`crate::placement`] has the rule.
//!
//! Reads scenes and blobs, never files. Degenerate and non-finite triangles are dropped and counted; what cannot be
//! rendered at all is refused.

mod collect;
#[cfg(test)]
mod tests;

pub use crate::placement::Sharing;

use crate::{
    accel::{Accel, Hit},
    bsdf::{Material, Relief, ReliefOptions},
    choices::Choices,
    geometry::{Frame, Ray},
    lights::{Learnt, Lights},
    surface::{Form, IN_WORLD, Interaction, MeshAttributes, Shape, derivatives, interact, tangent_frame},
    table::{DARK, DISK, SPHERE, TRIANGLE, TURNED, Table},
    texels::Texels,
    texture::Texture,
};
use collect::Collected;
use glam::{DVec3, Vec3, Vec4};
use std::{collections::BTreeMap, sync::Arc};
use tauflow_contract::{Digest, KindError};
use tauflow_data::{Image, scene::Scene};

/// Hands out the bytes of a blob.
pub type LoadBlob<'a> = &'a mut dyn FnMut(&Digest) -> Result<Vec<u8>, KindError>;

/// Features of a scene: missing ones are skipped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Features {
    /// Light from infinity.
    pub environment: bool,
    /// Shapes that emit.
    pub area_lights: bool,
    /// Point, spot or directional lights.
    pub delta_lights: bool,
    /// Materials that let rays pass.
    pub opacity: bool,
    /// Normal maps or bump maps.
    pub normal_maps: bool,
    /// Emitters that camera rays do not see.
    pub hidden_emitters: bool,
    /// Normal maps or bump maps with options, whose normals depend on the viewer.
    pub view_dependent_normals: bool,
}

/// Discarded parts of a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dropped {
    /// Triangles without area.
    pub degenerate: u64,
    /// Triangles with a vertex that is not finite, or becomes so in the world.
    pub not_finite: u64,
}

/// A material, and what is so of the shapes that have it.
#[derive(Debug)]
pub(crate) struct UsedMaterial {
    pub(crate) material: Material,
    /// Some share a mesh.
    pub(crate) shared: bool,
    /// Some emit.
    pub(crate) emits: bool,
    /// It reads vertex colours, or the emission of some does.
    pub(crate) reads_colors: bool,
    /// Some are meshes.
    meshes: bool,
    /// Some are no meshes.
    pub(crate) bodies: bool,
    /// Some are meshes with tangents of their own.
    pub(crate) tangents: bool,
}

impl UsedMaterial {
    fn new(material: Material) -> Self {
        let reads_colors = material.reads_colors();
        Self { material, shared: false, emits: false, reads_colors, meshes: false, bodies: false, tangents: false }
    }

    /// Whether it, or what its shapes emit, reads texture coordinates.
    #[inline(always)]
    pub(crate) fn reads_uv(&self) -> bool {
        self.material.reads_uv() || self.emits
    }

    /// Its normal map, if triangles get their frames by lane.
    #[inline(always)]
    pub(crate) fn normal_map_by_lane(&self) -> Option<&Relief> {
        let plain = self.meshes && !self.tangents && !self.material.is_anisotropic();
        let relief = self.material.relief()?;
        (plain && relief.is_by_lane()).then_some(relief)
    }
}

/// A scene made ready to render.
pub struct World {
    pub(crate) accel: Accel,
    pub(crate) table: Table,
    pub(crate) shapes: Vec<Shape>,
    /// Of each shape: its light, its number among placed meshes, and what it is ([`TRIANGLE`], [`DISK`], [`SPHERE`], or
    /// [`TURNED`]).
    pub(crate) light_of: Vec<u32>,
    pub(crate) placed_of: Vec<u32>,
    pub(crate) form_of: Vec<u32>,
    /// The shape of each placed mesh.
    placed_shapes: Vec<u32>,
    pub(crate) materials: Vec<UsedMaterial>,
    pub(crate) lights: Lights,
    /// Its camera.
    pub camera: tauflow_data::scene::Camera,
    /// Longest path in segments.
    pub max_depth: u32,
    /// Seed of its random numbers.
    pub seed: u64,
    /// Its features.
    pub features: Features,
    /// Discarded parts.
    pub dropped: Dropped,
}

impl World {
    /// Compiles a scene.
    ///
    /// # Errors
    /// If the scene is inconsistent: a material that is not there, a sphere that is sheared, two environments. If a
    /// value of a material or an emission is not finite, or beyond what a surface can do. If a blob is missing or
    /// damaged.
    pub fn new(scene: &Scene, load: LoadBlob<'_>) -> Result<Self, KindError> {
        Self::with_sharing(scene, load, Sharing::default())
    }

    /// Compiles a scene, in which these meshes are shared by their shapes.
    ///
    /// # Errors
    /// As [`World::new`].
    pub fn with_sharing(scene: &Scene, load: LoadBlob<'_>, sharing: Sharing) -> Result<Self, KindError> {
        if scene.version != 1 {
            return Err(KindError::Input(format!("the scene has format version {}; this reads 1", scene.version)));
        }
        // An image that several textures show is decoded and held once.
        let mut bitmaps: BTreeMap<Digest, Arc<Texels>> = BTreeMap::new();
        let mut load_bitmap = |digest: &Digest| -> Result<Arc<Texels>, KindError> {
            if let Some(image) = bitmaps.get(digest) {
                return Ok(image.clone());
            }
            let image = Arc::new(Texels::from(Image::from_bytes(&load(digest)?)?));
            bitmaps.insert(*digest, image.clone());
            Ok(image)
        };
        let materials = scene
            .materials
            .iter()
            .enumerate()
            .map(|(index, bsdf)| {
                Material::compile(bsdf, &mut load_bitmap).map_err(|error| within("material", index, error))
            })
            .collect::<Result<Vec<_>, _>>()?;
        let mut emissions = Vec::new();
        for (index, shape) in scene.shapes.iter().enumerate() {
            let emission = shape.emission.as_ref().map(|texture| Texture::compile(texture, &mut load_bitmap));
            emissions.push(emission.transpose().map_err(|error| within("shape", index, error))?);
        }
        let environment = crate::lights::compile_environment(&scene.emitters, &mut load_bitmap)?;
        drop(bitmaps);
        let collected = Collected::of(scene, emissions, &materials, load, sharing)?;
        let viewpoint = DVec3::from_array(scene.camera.origin).as_vec3();
        let accel = collected.accel(viewpoint);
        let (lights, collected) = collected.lights(environment, &scene.emitters, accel.bounds())?;
        let Collected { table, mut shapes, dropped, placed_shapes, .. } = collected;
        let mut materials: Vec<UsedMaterial> = materials.into_iter().map(UsedMaterial::new).collect();
        for (index, light) in lights.shapes() {
            let shape = &mut shapes[light.shape as usize];
            shape.light = index;
            let used = &mut materials[shape.material as usize];
            used.emits = true;
            used.reads_colors |= light.texture.reads_colors();
        }
        for shape in &shapes {
            let used = &mut materials[shape.material as usize];
            let is_mesh = matches!(shape.form, Form::Mesh(_));
            (used.meshes, used.bodies) = (used.meshes | is_mesh, used.bodies | !is_mesh);
            used.shared |= shape.placed != IN_WORLD;
            used.tangents |= matches!(&shape.form, Form::Mesh(mesh) if mesh.tangents.is_some());
        }
        let form_of = |shape: &Shape| match &shape.form {
            Form::Mesh(_) if shape.placed != IN_WORLD && shape.flip => TURNED,
            Form::Mesh(_) => TRIANGLE,
            Form::Disk(_) => DISK,
            Form::Sphere(_) => SPHERE,
        };
        let used =
            |wanted: fn(&Material) -> bool| shapes.iter().any(|s| wanted(&materials[s.material as usize].material));
        let emits = shapes.iter().any(|s| s.light != DARK);
        let features = Features {
            environment: lights.environment().is_some(),
            area_lights: emits,
            delta_lights: lights.has_delta(),
            // What camera rays pass is no obstacle to them alone.
            opacity: used(Material::has_opacity) || (scene.hide_emitters && emits),
            normal_maps: used(Material::has_normal_map),
            hidden_emitters: scene.hide_emitters,
            view_dependent_normals: used(|material| material.relief_options().is_some()),
        };
        Ok(Self {
            accel,
            table,
            light_of: shapes.iter().map(|s| s.light).collect(),
            placed_of: shapes.iter().map(|s| s.placed).collect(),
            form_of: shapes.iter().map(form_of).collect(),
            placed_shapes,
            shapes,
            materials,
            lights,
            camera: scene.camera.clone(),
            max_depth: scene.max_depth,
            seed: scene.seed,
            features,
            dropped,
        })
    }

    /// The same, with lobes and lights chosen in this way; without this, it is [`Choices::Fixed`].
    #[must_use]
    pub fn with_choices(mut self, choices: Choices) -> Self {
        self.materials.iter_mut().for_each(|used| used.material.set_choices(choices));
        let learnt = (choices == Choices::Adapted).then(|| Learnt::of(&self)).flatten();
        self.lights.adapt(learnt);
        self
    }

    /// Number of primitives; of a mesh that shapes share, once for each shape.
    pub fn primitive_count(&self) -> usize {
        self.shapes.iter().map(|shape| shape.count as usize).sum()
    }

    /// Shapes that share a mesh.
    pub fn placed_count(&self) -> usize {
        self.placed_shapes.len()
    }

    /// Memory of shapes, their primitives and their hierarchy; without materials, pictures and lights.
    pub fn geometry_bytes(&self) -> usize {
        // Shapes that share a mesh share its attributes.
        let mut meshes: Vec<&Arc<MeshAttributes>> = Vec::new();
        let mut bodies = 0;
        for shape in &self.shapes {
            match &shape.form {
                Form::Mesh(mesh) => meshes.push(mesh),
                Form::Sphere(sphere) => bodies += size_of_val(&**sphere),
                Form::Disk(disk) => bodies += size_of_val(&**disk),
            }
        }
        meshes.sort_unstable_by_key(|mesh| Arc::as_ptr(mesh));
        meshes.dedup_by_key(|mesh| Arc::as_ptr(mesh));
        let rows = [&self.light_of, &self.placed_of, &self.form_of, &self.placed_shapes];
        self.accel.bytes()
            + self.table.bytes()
            + self.shapes.capacity() * size_of::<Shape>()
            + rows.iter().map(|row| row.capacity() * size_of::<u32>()).sum::<usize>()
            + meshes.iter().map(|mesh| mesh.bytes()).sum::<usize>()
            + bodies
    }

    /// The shape and the primitive in the table of a primitive that was hit.
    #[inline]
    pub(crate) fn place(&self, primitive: u32) -> (u32, u32) {
        match self.accel.owner(primitive) {
            None => (self.table.shape(primitive), primitive),
            Some((placed, local)) => {
                let shape = self.placed_shapes[placed as usize];
                (shape, self.shapes[shape as usize].base + local)
            }
        }
    }

    /// Nearest hit, worked out.
    #[inline]
    pub(crate) fn meet(&self, ray: &Ray) -> Option<(Hit, Interaction)> {
        let hit = self.accel.closest(ray)?;
        Some((hit, self.interaction(ray, &hit)))
    }

    /// A hit of a ray, worked out.
    pub(crate) fn interaction(&self, ray: &Ray, hit: &Hit) -> Interaction {
        self.interaction_at(ray, hit, self.place(hit.primitive))
    }

    /// A hit of a ray with a primitive of the table, of a shape.
    pub(crate) fn interaction_at(&self, ray: &Ray, hit: &Hit, (shape, primitive): (u32, u32)) -> Interaction {
        let own = &self.shapes[shape as usize];
        interact((&self.table, self.accel.placements()), (shape, own), primitive, ray, hit)
    }

    /// Vertex colour at a point of a shape's triangle in the table; one on what is none.
    pub(crate) fn color(&self, shape: u32, primitive: u32, u: f32, v: f32) -> Vec4 {
        match &self.shapes[shape as usize].form {
            Form::Mesh(mesh) => mesh.color(&self.table, primitive, [1.0 - u - v, u, v]),
            Form::Sphere(_) | Form::Disk(_) => Vec4::ONE,
        }
    }

    /// Opacity of a shape at a point.
    #[inline]
    pub(crate) fn opacity_of(&self, shape: u32, surface: &crate::bsdf::Surface) -> f32 {
        self.materials[self.shapes[shape as usize].material as usize].material.opacity(surface)
    }

    /// Whether the first segment of a path passes through a shape because emitters are hidden.
    #[inline]
    pub(crate) fn hides(&self, shape: u32, depth: u32) -> bool {
        depth == 0 && self.features.hidden_emitters && self.light_of[shape as usize] != DARK
    }

    /// The material of a hit.
    #[inline]
    pub(crate) fn material(&self, at: &Interaction) -> &Material {
        &self.materials[self.shapes[at.shape as usize].material as usize].material
    }

    /// The shading frame of a hit with a primitive of the table, with the normal or bump map of its material, as it is
    /// seen from the direction `viewer`. Its tangents follow the surface if roughness depends on the direction.
    #[inline]
    pub(crate) fn shading_frame(&self, hit: &Hit, primitive: u32, at: &Interaction, viewer: Vec3) -> Frame {
        let (material, shape) = (self.material(at), &self.shapes[at.shape as usize]);
        let of = (&self.table, self.accel.placements());
        let n = match material.relief() {
            None => at.shading,
            Some(relief) => match relief.options {
                None => {
                    let n = tangent_frame(of, shape, primitive, hit, at).to_world(relief.normal(&at.surface));
                    n.normalize_or(at.shading)
                }
                Some(options) => {
                    let derivatives = derivatives(of, shape, primitive, hit, at);
                    perturbed(relief, options, derivatives, at, viewer)
                }
            },
        };
        if material.is_anisotropic() {
            let [along, _] = derivatives(of, shape, primitive, hit, at);
            return Frame::along(n, along);
        }
        Frame::new(n)
    }
}

/// The shading normal that a normal or bump map makes of a surface's, as Mitsuba 3 does it.
fn perturbed(
    relief: &Relief,
    options: ReliefOptions,
    [along, across]: [Vec3; 2],
    at: &Interaction,
    viewer: Vec3,
) -> Vec3 {
    let n = at.shading;
    let made = if relief.heights {
        let slopes = relief.slopes(&at.surface);
        let (s, t) = (along + n * (slopes.x - n.dot(along)), across + n * (slopes.y - n.dot(across)));
        let made = s.cross(t);
        if made.dot(at.geometric) < 0.0 { -made } else { made }
    } else {
        Frame::along(n, along).to_world(relief.raw_normal(&at.surface))
    };
    let behind = options.mirrored && viewer.dot(n) < 0.0;
    let viewer = if behind { viewer - n * (2.0 * viewer.dot(n)) } else { viewer };
    let turned = options.flip && viewer.dot(n) * viewer.dot(made) <= 0.0;
    let made = if turned { n * (2.0 * made.dot(n)) - made } else { made };
    made.normalize_or(n)
}

/// An error with the part of the scene that it is about.
fn within(part: &str, index: usize, error: KindError) -> KindError {
    match error {
        KindError::Input(what) => KindError::Input(format!("{part} {index}: {what}")),
        other => other,
    }
}
