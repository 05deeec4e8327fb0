//! Shapes and their primitives as they are collected: first what stands in the world, then the meshes that several
//! shapes share.

use super::{LoadBlob, within};
use crate::{
    accel::{self, Accel, Forms, PlacedMesh, SharedMesh},
    bounds,
    bsdf::Material,
    environment::Environment,
    geometry::{Disk, Map, Sphere, area_normal, cube, rectangle},
    lights::{Emission, Lights},
    placement::{Placement, Sharing},
    surface::{Form, IN_WORLD, MeshAttributes, Shape},
    table::{DARK, Lacks, Table},
    texture::Texture,
    world::Dropped,
};
use glam::{DVec3, Vec2, Vec3, Vec4};
use std::{collections::BTreeMap, sync::Arc};
use tauflow_contract::{Digest, KindError};
use tauflow_data::{
    mesh::Mesh,
    scene::{Emitter, Geometry, Scene, Shape as SceneShape},
};

/// Primitives in memory at most: rows are found by numbers of 31 bits, and trees are not too deep.
const MOST_PRIMITIVES: usize = 1 << 24;
/// Primitives at most, those of a shared mesh counted for each shape.
const MOST_NUMBERS: usize = i32::MAX as usize;
/// Coordinates of a shared mesh: its largest is within this and its reciprocal.
const EXTENT: f32 = (1u32 << 20) as f32;

/// The collected shapes of a scene.
#[derive(Default)]
pub(super) struct Collected {
    pub(super) table: Table,
    pub(super) shapes: Vec<Shape>,
    emissions: Vec<Emission>,
    /// Primitives of the world.
    own: u32,
    shared: Vec<SharedMesh>,
    placed: Vec<PlacedMesh>,
    pub(super) placed_shapes: Vec<u32>,
    pub(super) dropped: Dropped,
}

/// A mesh that shapes share, and these with their placements.
struct SharedShapes {
    mesh: Mesh,
    shapes: Vec<(usize, Placement)>,
}

fn wide(v: &[f32; 3]) -> DVec3 {
    Vec3::from_array(*v).as_dvec3()
}

/// Meshes that are shared, by the first shape of each.
fn common(scene: &Scene, load: LoadBlob<'_>, sharing: Sharing) -> Result<Vec<SharedShapes>, KindError> {
    let mut benign: BTreeMap<Digest, Vec<(usize, Placement)>> = BTreeMap::new();
    for (index, shape) in scene.shapes.iter().enumerate() {
        if let (Geometry::Mesh { mesh }, true) = (&shape.geometry, sharing != Sharing::Never)
            && let Some(placement) = Placement::new(&Map::new(&shape.to_world))
        {
            benign.entry(*mesh).or_default().push((index, placement));
        }
    }
    let mut found: Vec<SharedShapes> = Vec::new();
    for (digest, shapes) in benign.into_iter().filter(|(_, shapes)| shapes.len() > 1) {
        let mesh = Mesh::from_bytes(&load(&digest)?)?;
        let largest = mesh.positions.iter().flatten().fold(0.0f32, |most, v| most.max(v.abs()));
        let finite = mesh.positions.iter().flatten().all(|v| v.is_finite());
        let fits = finite && (EXTENT.recip()..=EXTENT).contains(&largest);
        if fits && sharing.shares(shapes.len(), mesh.triangles.len()) {
            found.push(SharedShapes { mesh, shapes });
        }
    }
    found.sort_by_key(|common| common.shapes[0].0);
    Ok(found)
}

/// Refuses a scene of more primitives than fit, `own` of which are no copies by one mesh.
fn check_count(own: usize, numbers: usize) -> Result<(), KindError> {
    if own <= MOST_PRIMITIVES && numbers <= MOST_NUMBERS {
        return Ok(());
    }
    Err(KindError::Input(format!(
        "the scene has {numbers} triangles and bodies, {own} of them its own; at most {MOST_NUMBERS} can be rendered, \
         of which {MOST_PRIMITIVES} are no copies by one mesh"
    )))
}

/// Counts the triangles of meshes that are copied, before they are: a small scene may copy a mesh very often.
fn check_copies(scene: &Scene, placed: &[bool], load: LoadBlob<'_>) -> Result<(), KindError> {
    let mut copied: BTreeMap<Digest, usize> = BTreeMap::new();
    for (shape, placed) in scene.shapes.iter().zip(placed) {
        if let (Geometry::Mesh { mesh }, false) = (&shape.geometry, placed) {
            *copied.entry(*mesh).or_default() += 1;
        }
    }
    let mut triangles = 0usize;
    for (mesh, count) in copied.into_iter().filter(|(_, count)| *count > 1) {
        triangles = triangles.saturating_add(Mesh::triangles_in(&load(&mesh)?)?.saturating_mul(count));
    }
    check_count(triangles, triangles)
}

/// The error of an emission.
fn check_emission(texture: &Texture) -> Result<(), KindError> {
    if texture.is_negative() {
        return Err(KindError::Input("negative emission; use radiance from 0".into()));
    }
    if texture.bounds().is_none() {
        return Err(KindError::Input("an emission with values that are not finite; use radiance from 0".into()));
    }
    Ok(())
}

fn check_colors(mesh: &Mesh, material: &Material, emission: Option<&Texture>) -> Result<(), KindError> {
    bounds::vertex_colors(mesh, material.reads_colors(), emission.is_some_and(Texture::reads_colors))
}

impl Collected {
    /// Collects the shapes of a scene, whose emissions are these.
    pub(super) fn of(
        scene: &Scene,
        emissions: Vec<Option<Texture>>,
        materials: &[Material],
        load: LoadBlob<'_>,
        sharing: Sharing,
    ) -> Result<Self, KindError> {
        for (index, shape) in scene.shapes.iter().enumerate() {
            if shape.material >= materials.len() {
                let (named, count) = (shape.material, materials.len());
                let error = KindError::Input(format!("material {named} does not exist; the scene has {count}"));
                return Err(within("shape", index, error));
            }
        }
        let common = common(scene, load, sharing)?;
        let mut placed = vec![false; scene.shapes.len()];
        common.iter().flat_map(|common| &common.shapes).for_each(|(index, _)| placed[*index] = true);
        check_copies(scene, &placed, load)?;
        let mut collected = Self::default();
        for (index, shape) in scene.shapes.iter().enumerate() {
            if placed[index] {
                collected.shape(shape, 0, 0, Form::Mesh(Arc::default()));
                continue;
            }
            collected
                .add(index as u32, shape, emissions[index].as_ref(), &materials[shape.material], load)
                .map_err(|error| within("shape", index, error))?;
        }
        collected.own = collected.table.len() as u32;
        let mut numbers = collected.table.len();
        for SharedShapes { mesh, shapes } in common {
            for (index, _) in &shapes {
                let shape = &scene.shapes[*index];
                check_colors(&mesh, &materials[shape.material], emissions[*index].as_ref())
                    .map_err(|error| within("shape", *index, error))?;
            }
            collected.add_shared(&mesh, shapes, &mut numbers);
        }
        check_count(collected.table.len(), numbers)?;
        collected.table.settle();
        collected.shapes.shrink_to_fit();
        collected.placed_shapes.shrink_to_fit();
        for (index, texture) in emissions.into_iter().enumerate() {
            let Some(texture) = texture else { continue };
            check_emission(&texture).map_err(|error| within("shape", index, error))?;
            let normal = collected.facing(index);
            let (shape, own) = (index as u32, &collected.shapes[index]);
            let even = (own.placed != IN_WORLD)
                .then(|| collected.placed[own.placed as usize].placement.even())
                .flatten()
                .map(|_| own.base);
            let (first, count) = (own.base as usize, own.count as usize);
            collected.emissions.push(Emission { shape, texture, first, count, normal, flip: own.flip, even });
        }
        Ok(collected)
    }

    fn shape(&mut self, shape: &SceneShape, base: usize, count: usize, form: Form) {
        self.shapes.push(Shape {
            form,
            base: base as u32,
            count: count as u32,
            material: shape.material as u32,
            light: DARK,
            placed: IN_WORLD,
            flip: shape.flip_normals,
        });
    }

    /// Adds a shape in the world.
    fn add(
        &mut self,
        index: u32,
        shape: &SceneShape,
        emission: Option<&Texture>,
        material: &Material,
        load: LoadBlob<'_>,
    ) -> Result<(), KindError> {
        let map = Map::new(&shape.to_world);
        let first = self.table.len();
        let turned = if shape.flip_normals { -1.0 } else { 1.0 };
        let mut single = |normal: Vec3, positions: [Vec3; 3]| {
            let vertex = self.table.next_vertex();
            positions.into_iter().for_each(|p| self.table.push_vertex(p, normal * turned, Vec2::ZERO));
            let corners = [vertex, vertex + 1, vertex + 2];
            self.table.push(corners, normal * turned, index, Lacks { normals: true, uvs: false });
        };
        let form = match &shape.geometry {
            Geometry::Sphere { center, radius } => {
                let sphere = Sphere::new(*center, *radius, &map).map_err(KindError::Input)?;
                let radius = Vec3::new(sphere.radius, turned, 0.0);
                single(Vec3::ZERO, [sphere.center, radius, Vec3::ZERO]);
                Form::Sphere(Box::new(sphere))
            }
            Geometry::Disk => {
                let flat = || KindError::Input("a disk whose `to_world` leaves it no area, or is not finite".into());
                let disk = Disk::new(&map).ok_or_else(flat)?;
                single(disk.normal, [disk.center, disk.x, disk.y]);
                Form::Disk(Box::new(disk))
            }
            Geometry::Rectangle => self.add_mesh(index, turned, &rectangle(), &map),
            Geometry::Cube => self.add_mesh(index, turned, &cube(), &map),
            Geometry::Mesh { mesh } => {
                let mesh = Mesh::from_bytes(&load(mesh)?)?;
                check_colors(&mesh, material, emission)?;
                self.add_mesh(index, turned, &mesh, &map)
            }
        };
        let count = self.table.len() - first;
        self.shape(shape, first, count, form);
        Ok(())
    }

    /// Adds a mesh's triangles, mapped; with `turned` of -1, their normals turned round. A map that mirrors keeps
    /// outside outside.
    fn add_mesh(&mut self, index: u32, turned: f32, mesh: &Mesh, map: &Map) -> Form {
        let side = if map.mirrors() { -1.0 } else { 1.0 };
        let direction = |n: &[f32; 3]| map.normal(wide(n)).map_or(Vec3::ZERO, glam::DVec3::as_vec3);
        let first_vertex = self.table.next_vertex();
        self.table.reserve(mesh.positions.len(), mesh.triangles.len());
        for (at, position) in mesh.positions.iter().enumerate() {
            let normal = mesh.normals.as_ref().map_or(Vec3::ZERO, |all| direction(&all[at]) * turned);
            let uv = mesh.uvs.as_ref().map_or(Vec2::ZERO, |uvs| Vec2::from_array(uvs[at]));
            self.table.push_vertex(map.point(wide(position)), normal, uv);
        }
        let lacks = Lacks { normals: mesh.normals.is_none(), uvs: mesh.uvs.is_none() };
        for triangle in &mesh.triangles {
            let vertices = triangle.map(|i| map.point(wide(&mesh.positions[i as usize])));
            if !vertices.iter().all(|v| v.is_finite()) {
                self.dropped.not_finite += 1;
                continue;
            }
            let Some((_, normal)) = area_normal(vertices[0], vertices[1], vertices[2]) else {
                self.dropped.degenerate += 1;
                continue;
            };
            self.table.push(triangle.map(|i| first_vertex + i), normal * side * turned, index, lacks);
        }
        let tangent = |t: &[f32; 4]| {
            let along = map.vector(DVec3::new(t[0].into(), t[1].into(), t[2].into()));
            (along.normalize_or_zero().as_vec3()).extend(t[3] * side)
        };
        Form::Mesh(Arc::new(MeshAttributes {
            first_vertex,
            colors: mesh.colors.as_ref().map(|colors| colors.iter().map(|c| Vec4::from_array(*c)).collect()),
            tangents: mesh.tangents.as_ref().map(|tangents| tangents.iter().map(tangent).collect()),
        }))
    }

    /// Adds a mesh that shapes share, in its own space.
    fn add_shared(&mut self, mesh: &Mesh, shapes: Vec<(usize, Placement)>, numbers: &mut usize) {
        let (base, dropped) = (self.table.len(), self.dropped);
        let first = shapes.first().map_or(0, |(index, _)| *index as u32);
        let form = self.add_mesh(first, 1.0, mesh, &Map::new(&tauflow_data::scene::IDENTITY));
        let count = self.table.len() - base;
        // Dropped triangles are missing from every shape.
        let more = shapes.len() as u64 - 1;
        self.dropped.degenerate += more * (self.dropped.degenerate - dropped.degenerate);
        self.dropped.not_finite += more * (self.dropped.not_finite - dropped.not_finite);
        for (index, placement) in shapes {
            let shape = &mut self.shapes[index];
            (shape.base, shape.count, shape.form) = (base as u32, count as u32, form.clone());
            if count == 0 {
                continue;
            }
            shape.placed = self.placed.len() as u32;
            let points = mesh.positions.iter().map(|p| placement.point(Vec3::from_array(*p)).as_vec3());
            let bounds = points.fold((Vec3::MAX, Vec3::MIN), |all, p| (all.0.min(p), all.1.max(p)));
            self.placed.push(PlacedMesh { mesh: self.shared.len(), placement, bounds, first: *numbers as u32 });
            self.placed_shapes.push(index as u32);
            *numbers = numbers.saturating_add(count);
        }
        if count > 0 {
            self.shared.push(SharedMesh { first: base as u32, count: count as u32 });
        }
    }

    /// The outer normal of a shape, if it is flat.
    fn facing(&self, index: usize) -> Option<Vec3> {
        let shape = &self.shapes[index];
        match &shape.form {
            Form::Sphere(_) => None,
            Form::Disk(disk) => Some(if shape.flip { -disk.normal } else { disk.normal }),
            Form::Mesh(_) => {
                // A map keeps flat what is flat.
                let normal = |at: u32| self.table.normal(at);
                let own = shape.base..shape.base + shape.count;
                let same = |at: u32| normal(at).dot(normal(shape.base)) > 0.999;
                let flat = (shape.count > 0 && own.clone().all(same)).then(|| normal(shape.base))?;
                if shape.placed == IN_WORLD {
                    return Some(flat);
                }
                let [a, b, c] = self.table.triangle(shape.base).map(|p| self.world_point(shape, p));
                let (_, normal) = area_normal(a, b, c)?;
                let mirrored = self.placed[shape.placed as usize].placement.mirrors();
                Some(if mirrored == shape.flip { normal } else { -normal })
            }
        }
    }

    fn world_point(&self, shape: &Shape, p: Vec3) -> Vec3 {
        if shape.placed == IN_WORLD { p } else { self.placed[shape.placed as usize].placement.point(p).as_vec3() }
    }

    /// A primitive of the table, where the table has it.
    fn form(&self, primitive: u32) -> accel::Primitive {
        match &self.shapes[self.table.shape(primitive) as usize].form {
            Form::Mesh(_) => accel::Primitive::Triangle(self.table.triangle(primitive)),
            Form::Sphere(sphere) => accel::Primitive::Sphere(**sphere),
            Form::Disk(disk) => accel::Primitive::Disk(**disk),
        }
    }

    /// The hierarchy.
    pub(super) fn accel(&self, viewpoint: Vec3) -> Accel {
        let forms = Forms { count: self.own, form: &|primitive| self.form(primitive) };
        Accel::over(&forms, &self.shared, &self.placed, viewpoint)
    }

    /// The lights, and what is left.
    pub(super) fn lights(
        mut self,
        environment: Option<Environment>,
        emitters: &[Emitter],
        bounds: (Vec3, Vec3),
    ) -> Result<(Lights, Self), KindError> {
        let emissions = std::mem::take(&mut self.emissions);
        let form = |shape: u32, number: u32| {
            let shape = &self.shapes[shape as usize];
            match self.form(shape.base + number) {
                accel::Primitive::Triangle(vertices) => {
                    accel::Primitive::Triangle(vertices.map(|p| self.world_point(shape, p)))
                }
                other => other,
            }
        };
        let lights = Lights::new(emissions, environment, emitters, &form, bounds)?;
        Ok((lights, self))
    }
}
