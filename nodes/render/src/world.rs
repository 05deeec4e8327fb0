//! A scene made ready to render: shapes in world space under one hierarchy, materials, lights, and what it needs.
//!
//! Reads scenes and blobs, never files. Degenerate and non-finite triangles are dropped and counted; what cannot be
//! rendered at all is refused.

use crate::{
    accel::{self, Accel, Hit},
    bounds,
    bsdf::Material,
    geometry::{Disk, Frame, Map, Ray, Sphere, area_normal, cube, rectangle},
    lights::{Emission, Lights},
    surface::{Form, Interaction, MeshAttributes, Primitive, interact, tangent_frame},
    table::{DISK, Row, SPHERE, TRIANGLE, Table},
    texture::Texture,
};
use glam::{DVec3, Vec2, Vec3, Vec4};
use std::{collections::BTreeMap, sync::Arc};
use tauflow_contract::{Digest, KindError};
use tauflow_data::{
    Image,
    mesh::Mesh,
    scene::{Geometry, Scene, Shape as SceneShape},
};

/// Hands out the bytes of a blob.
pub type LoadBlob<'a> = &'a mut dyn FnMut(&Digest) -> Result<Vec<u8>, KindError>;

/// Primitives of a scene at most: their rows are found by numbers of 31 bits, and their tree is not too deep.
const MOST_PRIMITIVES: usize = 1 << 24;

/// What a scene has: what it lacks is skipped.
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
    /// Normal maps.
    pub normal_maps: bool,
}

/// What was left out of a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dropped {
    /// Triangles without area.
    pub degenerate: u64,
    /// Triangles with a vertex that is not finite, or becomes so in the world.
    pub not_finite: u64,
}

/// A shape in the world.
#[derive(Debug)]
pub(crate) struct Shape {
    pub(crate) form: Form,
    pub(crate) material: u32,
    pub(crate) flip: bool,
    /// Its light, if it emits.
    pub(crate) light: Option<u32>,
}

/// A scene made ready to render.
pub struct World {
    pub(crate) accel: Accel,
    pub(crate) primitives: Vec<Primitive>,
    pub(crate) table: Table,
    /// Which materials are of shapes that emit.
    pub(crate) emits: Vec<bool>,
    /// Which materials, or the emission of their shapes, read vertex colours.
    pub(crate) reads_colors: Vec<bool>,
    /// Which materials are of shapes that are no meshes.
    pub(crate) bodies: Vec<bool>,
    pub(crate) shapes: Vec<Shape>,
    pub(crate) materials: Vec<Material>,
    pub(crate) lights: Lights,
    /// Its camera.
    pub camera: tauflow_data::scene::Camera,
    /// Longest path in segments.
    pub max_depth: u32,
    /// Seed of its random numbers.
    pub seed: u64,
    /// What it has.
    pub features: Features,
    /// What was left out.
    pub dropped: Dropped,
}

/// Shapes and primitives as they are collected.
#[derive(Default)]
struct Collected {
    forms: Vec<accel::Primitive>,
    primitives: Vec<Primitive>,
    table: Table,
    shapes: Vec<Shape>,
    emissions: Vec<Emission>,
    dropped: Dropped,
}

impl World {
    /// Compiles a scene.
    ///
    /// # Errors
    /// If the scene is inconsistent: a material that is not there, a sphere that is sheared, two environments. If a
    /// value of a material or an emission is not finite, or beyond what a surface can do. If a blob is missing or
    /// damaged.
    pub fn new(scene: &Scene, load: LoadBlob<'_>) -> Result<Self, KindError> {
        if scene.version != 1 {
            return Err(KindError::Input(format!("the scene has format version {}; this reads 1", scene.version)));
        }
        // An image that several textures show is decoded and held once.
        let mut bitmaps: BTreeMap<Digest, Arc<Image>> = BTreeMap::new();
        let mut load_bitmap = |digest: &Digest| -> Result<Arc<Image>, KindError> {
            if let Some(image) = bitmaps.get(digest) {
                return Ok(image.clone());
            }
            let image = Arc::new(Image::from_bytes(&load(digest)?)?);
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
        let mut collected = Collected::default();
        for (index, (shape, emission)) in scene.shapes.iter().zip(emissions).enumerate() {
            collected.add(shape, emission, &materials, load).map_err(|error| within("shape", index, error))?;
        }
        if collected.primitives.len() > MOST_PRIMITIVES {
            return Err(KindError::Input(format!(
                "the scene has {} triangles and bodies; at most {MOST_PRIMITIVES} can be rendered",
                collected.primitives.len()
            )));
        }
        let viewpoint = DVec3::from_array(scene.camera.origin).as_vec3();
        let accel = Accel::new(&collected.forms, viewpoint);
        let Collected { forms, primitives, mut table, mut shapes, emissions, dropped } = collected;
        let lights = Lights::new(emissions, environment, &scene.emitters, &forms, accel.bounds())?;
        let mut emits = vec![false; materials.len()];
        let mut reads_colors: Vec<bool> = materials.iter().map(Material::reads_colors).collect();
        for (index, light) in lights.shapes() {
            let shape = &mut shapes[light.shape as usize];
            reads_colors[shape.material as usize] |= light.texture.reads_colors();
            shape.light = Some(index);
            emits[shape.material as usize] = true;
            table.light[light.primitives()].fill(index);
        }
        let mut bodies = vec![false; materials.len()];
        for shape in shapes.iter().filter(|shape| !matches!(shape.form, Form::Mesh(_))) {
            bodies[shape.material as usize] = true;
        }
        let used = |wanted: fn(&Material) -> bool| shapes.iter().any(|s| wanted(&materials[s.material as usize]));
        let features = Features {
            environment: lights.environment().is_some(),
            area_lights: shapes.iter().any(|s| s.light.is_some()),
            delta_lights: lights.has_delta(),
            opacity: used(Material::has_opacity),
            normal_maps: used(Material::has_normal_map),
        };
        Ok(Self {
            accel,
            primitives,
            table,
            emits,
            reads_colors,
            bodies,
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

    /// Number of primitives.
    pub fn primitive_count(&self) -> usize {
        self.primitives.len()
    }

    /// Nearest hit, worked out.
    #[inline]
    pub(crate) fn meet(&self, ray: &Ray) -> Option<(Hit, Interaction)> {
        let hit = self.accel.closest(ray)?;
        Some((hit, self.interaction(ray, &hit)))
    }

    /// A hit of a ray, worked out.
    pub(crate) fn interaction(&self, ray: &Ray, hit: &Hit) -> Interaction {
        let primitive = &self.primitives[hit.primitive as usize];
        let shape = &self.shapes[primitive.shape as usize];
        interact(&self.table, primitive, &shape.form, shape.flip, ray, hit)
    }

    /// Vertex colour at a point of a triangle; one on what is none.
    pub(crate) fn color(&self, primitive: u32, u: f32, v: f32) -> Vec4 {
        let primitive = &self.primitives[primitive as usize];
        match &self.shapes[primitive.shape as usize].form {
            Form::Mesh(mesh) => mesh.color(primitive, [1.0 - u - v, u, v]),
            Form::Sphere(_) | Form::Disk(_) => Vec4::ONE,
        }
    }

    /// Opacity of a shape at a point.
    #[inline]
    pub(crate) fn opacity_of(&self, shape: u32, surface: &crate::bsdf::Surface) -> f32 {
        self.materials[self.shapes[shape as usize].material as usize].opacity(surface)
    }

    /// The material of a hit.
    #[inline]
    pub(crate) fn material(&self, at: &Interaction) -> &Material {
        &self.materials[self.shapes[at.shape as usize].material as usize]
    }

    /// The shading frame of a hit, with its normal map if the material has one.
    #[inline]
    pub(crate) fn shading_frame(&self, hit: &Hit, at: &Interaction) -> Frame {
        if let Some(mapped) = self.material(at).shading_normal(&at.surface) {
            let primitive = &self.primitives[hit.primitive as usize];
            let form = &self.shapes[primitive.shape as usize].form;
            let n = tangent_frame(&self.table, primitive, form, hit, at).to_world(mapped);
            return Frame::new(n.normalize_or(at.shading));
        }
        Frame::new(at.shading)
    }
}

/// An error with the part of the scene that it is about.
fn within(part: &str, index: usize, error: KindError) -> KindError {
    match error {
        KindError::Input(what) => KindError::Input(format!("{part} {index}: {what}")),
        other => other,
    }
}

impl Collected {
    fn add(
        &mut self,
        shape: &SceneShape,
        emission: Option<Texture>,
        materials: &[Material],
        load: LoadBlob<'_>,
    ) -> Result<(), KindError> {
        let Some(surface) = materials.get(shape.material) else {
            return Err(KindError::Input(format!(
                "material {} of {}; name one that is there",
                shape.material,
                materials.len()
            )));
        };
        let map = Map::new(&shape.to_world);
        let index = self.shapes.len() as u32;
        let first = self.primitives.len();
        let material = shape.material as u32;
        let turned = if shape.flip_normals { -1.0 } else { 1.0 };
        let mut single = |form: accel::Primitive, normal: Vec3, positions: [Vec3; 3], sort: u32| {
            self.forms.push(form);
            self.primitives.push(Primitive { shape: index, triangle: 0, normal });
            let normal = normal * turned;
            let row = Row { positions, normal, normals: [normal; 3], uvs: [Vec2::ZERO; 3] };
            self.table.push(&row, material, sort);
        };
        let form = match &shape.geometry {
            Geometry::Sphere { center, radius } => {
                let sphere = Sphere::new(*center, *radius, &map).map_err(KindError::Input)?;
                let radius = Vec3::new(sphere.radius, turned, 0.0);
                single(accel::Primitive::Sphere(sphere), Vec3::ZERO, [sphere.center, radius, Vec3::ZERO], SPHERE);
                Form::Sphere(sphere)
            }
            Geometry::Disk => {
                let flat = || KindError::Input("a disk whose `to_world` leaves it no area, or is not finite".into());
                let disk = Disk::new(&map).ok_or_else(flat)?;
                single(accel::Primitive::Disk(disk), disk.normal, [disk.center, disk.x, disk.y], DISK);
                Form::Disk(disk)
            }
            Geometry::Rectangle => self.add_mesh(index, shape, &rectangle(), &map),
            Geometry::Cube => self.add_mesh(index, shape, &cube(), &map),
            Geometry::Mesh { mesh } => {
                let mesh = Mesh::from_bytes(&load(mesh)?)?;
                let shines = emission.as_ref().is_some_and(Texture::reads_colors);
                bounds::vertex_colors(&mesh, surface.reads_colors(), shines)?;
                self.add_mesh(index, shape, &mesh, &map)
            }
        };
        if let Some(texture) = emission {
            if texture.is_negative() {
                return Err(KindError::Input("an emission below 0; use radiance from 0".into()));
            }
            if texture.bounds().is_none() {
                return Err(KindError::Input(
                    "an emission with values that are not finite; use radiance from 0".into(),
                ));
            }
            let count = self.primitives.len() - first;
            let normal = match &form {
                Form::Sphere(_) => None,
                Form::Disk(disk) => Some(if shape.flip_normals { -disk.normal } else { disk.normal }),
                Form::Mesh(_) => self.table.flat(first, count),
            };
            self.emissions.push(Emission { shape: index, texture, first, count, normal, flip: shape.flip_normals });
        }
        self.shapes.push(Shape { form, material: shape.material as u32, flip: shape.flip_normals, light: None });
        Ok(())
    }

    /// Adds a mesh's triangles in the world. A map that mirrors keeps outside outside.
    fn add_mesh(&mut self, index: u32, shape: &SceneShape, mesh: &Mesh, map: &Map) -> Form {
        let double = |v: &[f32; 3]| Vec3::from_array(*v).as_dvec3();
        let positions: Vec<Vec3> = mesh.positions.iter().map(|p| map.point(double(p))).collect();
        let side = if map.mirrors() { -1.0 } else { 1.0 };
        let direction = |n: &[f32; 3]| map.normal(double(n)).map_or(Vec3::ZERO, glam::DVec3::as_vec3);
        let normals: Option<Vec<Vec3>> = mesh.normals.as_ref().map(|all| all.iter().map(direction).collect());
        let turned = if shape.flip_normals { -1.0 } else { 1.0 };
        let mut triangles = Vec::with_capacity(mesh.triangles.len());
        for triangle in &mesh.triangles {
            let vertices = triangle.map(|i| positions[i as usize]);
            if !vertices.iter().all(|v| v.is_finite()) {
                self.dropped.not_finite += 1;
                continue;
            }
            let Some((_, normal)) = area_normal(vertices[0], vertices[1], vertices[2]) else {
                self.dropped.degenerate += 1;
                continue;
            };
            let normal = normal * side;
            let row = Row {
                positions: vertices,
                normal: normal * turned,
                normals: triangle.map(|at| normals.as_ref().map_or(normal, |all| all[at as usize]) * turned),
                // Without coordinates of its own a triangle has its weights.
                uvs: mesh.uvs.as_ref().map_or([Vec2::ZERO, Vec2::X, Vec2::Y], |uvs| {
                    triangle.map(|at| Vec2::from_array(uvs[at as usize]))
                }),
            };
            self.table.push(&row, shape.material as u32, TRIANGLE);
            self.forms.push(accel::Primitive::Triangle(vertices));
            self.primitives.push(Primitive { shape: index, triangle: triangles.len() as u32, normal });
            triangles.push(*triangle);
        }
        let tangent = |t: &[f32; 4]| {
            let along = map.vector(DVec3::new(t[0].into(), t[1].into(), t[2].into()));
            (along.normalize_or_zero().as_vec3()).extend(t[3] * side)
        };
        Form::Mesh(MeshAttributes {
            triangles,
            normals,
            uvs: mesh.uvs.as_ref().map(|uvs| uvs.iter().map(|uv| Vec2::from_array(*uv)).collect()),
            colors: mesh.colors.as_ref().map(|colors| colors.iter().map(|c| Vec4::from_array(*c)).collect()),
            tangents: mesh.tangents.as_ref().map(|tangents| tangents.iter().map(tangent).collect()),
        })
    }
}
