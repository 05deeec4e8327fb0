//! Surface data at a hit: point with error bound, normals, texture coordinates, tangents.

use crate::{
    accel::Hit,
    bsdf::Surface,
    geometry::{Disk, Frame, Ray, Sphere, gamma},
    placement::Placements,
    table::Table,
};
use glam::{Vec2, Vec3, Vec4};
use std::sync::Arc;

/// Optional mesh attributes besides positions, normals and texture coordinates, which are in the [`Table`].
#[derive(Debug, Default)]
pub(crate) struct MeshAttributes {
    /// The number of its first vertex in the table.
    pub(crate) first_vertex: u32,
    /// Vertex colours.
    pub(crate) colors: Option<Vec<Vec4>>,
    /// Tangents and handedness, where the mesh's vertices are: in the world, or in the space of a shared mesh.
    pub(crate) tangents: Option<Vec<Vec4>>,
}

/// A shape's form, for what a hit needs beyond its distance.
#[derive(Clone, Debug)]
pub(crate) enum Form {
    /// Triangles.
    Mesh(Arc<MeshAttributes>),
    /// One sphere.
    Sphere(Box<Sphere>),
    /// One disk.
    Disk(Box<Disk>),
}

/// A shape in the world.
#[derive(Debug)]
pub(crate) struct Shape {
    pub(crate) form: Form,
    /// Its first primitive in the table, and how many there are.
    pub(crate) base: u32,
    pub(crate) count: u32,
    pub(crate) material: u32,
    /// Its light, or [`crate::table::DARK`].
    pub(crate) light: u32,
    /// Its number among placed meshes, if it shares one, or [`IN_WORLD`].
    pub(crate) placed: u32,
    pub(crate) flip: bool,
}

/// The number of shapes that are in the world themselves.
pub(crate) const IN_WORLD: u32 = u32::MAX;

/// A hit, worked out.
#[derive(Clone, Copy, Debug)]
pub struct Interaction {
    /// The point.
    pub p: Vec3,
    /// Bound on the error of each coordinate of it.
    pub error: Vec3,
    /// Unit geometric normal, on the shape's outer side.
    pub geometric: Vec3,
    /// Unit shading normal.
    pub shading: Vec3,
    /// The coordinates for texture look-ups.
    pub surface: Surface,
    /// The shape that is hit.
    pub shape: u32,
}

impl MeshAttributes {
    pub(crate) fn bytes(&self) -> usize {
        let of = |rows: &Option<Vec<Vec4>>| rows.as_ref().map_or(0, |rows| rows.capacity() * size_of::<Vec4>());
        size_of::<Self>() + of(&self.colors) + of(&self.tangents)
    }

    /// Vertex colour at a point of a triangle; one without any.
    pub(crate) fn color(&self, table: &Table, primitive: u32, [a, b, c]: [f32; 3]) -> Vec4 {
        let Some(v) = &self.colors else { return Vec4::ONE };
        let [i, j, k] = table.corners(primitive).map(|corner| (corner - self.first_vertex) as usize);
        v[i] * a + v[j] * b + v[k] * c
    }
}

/// Works out a hit with a primitive of the table, whose shape is number `index`.
#[inline]
pub(crate) fn interact(
    (table, placements): (&Table, &Placements),
    (index, shape): (u32, &Shape),
    primitive: u32,
    ray: &Ray,
    hit: &Hit,
) -> Interaction {
    let mut found = match &shape.form {
        Form::Mesh(mesh) => {
            let facts = table.facts::<f32>(primitive as i32);
            let lacks = table.lacks(primitive);
            let weights = [1.0 - hit.u - hit.v, hit.u, hit.v];
            let [p0, p1, p2] = facts.positions.map(Vec3::from);
            let (a, b, c) = (p0 * weights[0], p1 * weights[1], p2 * weights[2]);
            let mut p = a + b + c;
            let mut error = (a.abs() + b.abs() + c.abs()) * gamma(7);
            let mut geometric: Vec3 = facts.normal.into();
            let mut normals = facts.normals;
            if shape.placed != IN_WORLD {
                let placed = placements.placed::<f32>(shape.placed as i32);
                let (point, known) = placed.point(p.into(), error.into());
                (p, error) = (point.into(), known.into());
                let turned = if shape.flip { -1.0 } else { 1.0 };
                geometric = Vec3::from(placed.normal(facts.normal)) * turned;
                normals = normals.map(|n| placed.normal(n) * turned);
            }
            let shading = if lacks.normals {
                geometric
            } else {
                let [n0, n1, n2] = normals.map(Vec3::from);
                (n0 * weights[0] + n1 * weights[1] + n2 * weights[2]).normalize_or(geometric)
            };
            let uv = if lacks.uvs {
                Vec2::new(weights[1], weights[2])
            } else {
                let uv = facts.uv(weights);
                Vec2::new(uv.x, uv.y)
            };
            let color = mesh.color(table, primitive, weights);
            return Interaction { p, error, geometric, shading, surface: Surface { uv, color }, shape: index };
        }
        Form::Sphere(sphere) => {
            let (p, n, error) = sphere.project(ray.at(hit.t));
            let surface = Surface { uv: sphere.uv(n), color: Vec4::ONE };
            Interaction { p, error, geometric: n, shading: n, surface, shape: index }
        }
        Form::Disk(disk) => {
            let (p, error) = disk.point(hit.u, hit.v);
            let surface = Surface { uv: Disk::uv(hit.u, hit.v), color: Vec4::ONE };
            let n = disk.normal;
            Interaction { p, error, geometric: n, shading: n, surface, shape: index }
        }
    };
    if shape.flip {
        found.geometric = -found.geometric;
        found.shading = -found.shading;
    }
    found
}

/// Changes of the point along u and v, as Mitsuba has them: they tell what is along and across on a surface. On
/// triangles without texture coordinates they are any tangents.
pub(crate) fn derivatives(
    (table, placements): (&Table, &Placements),
    shape: &Shape,
    primitive: u32,
    hit: &Hit,
    at: &Interaction,
) -> [Vec3; 2] {
    match &shape.form {
        // The sphere's own normal points outwards, whichever side its shape has for the outer one.
        Form::Sphere(sphere) => sphere.derivatives(if shape.flip { -at.geometric } else { at.geometric }),
        Form::Disk(disk) => disk.derivatives(hit.u, hit.v),
        Form::Mesh(_) => {
            let facts = table.facts::<f32>(primitive as i32);
            let [p0, p1, p2] = facts.positions.map(Vec3::from);
            let (mut q1, mut q2) = (p1 - p0, p2 - p0);
            if shape.placed != IN_WORLD {
                let placed = placements.placed::<f32>(shape.placed as i32);
                q1 = placed.vector(q1.into()).into();
                q2 = placed.vector(q2.into()).into();
            }
            let [ua, ub, uc] = facts.uvs().map(|uv| Vec2::new(uv.x, uv.y));
            let (d1, d2) = (ub - ua, uc - ua);
            let det = d1.perp_dot(d2);
            if table.lacks(primitive).uvs || det == 0.0 {
                let frame = Frame::new(at.geometric);
                return [frame.s, frame.t];
            }
            [(q1 * d2.y - q2 * d1.y) / det, (q2 * d1.x - q1 * d2.x) / det]
        }
    }
}

/// The frame of a normal map about the shading normal: s along growing u (or the mesh's tangent). On meshes t is
/// upwards in the image, as glTF has it; on other shapes it is n x s, as Mitsuba has it.
pub(crate) fn tangent_frame(
    (table, placements): (&Table, &Placements),
    shape: &Shape,
    primitive: u32,
    hit: &Hit,
    at: &Interaction,
) -> Frame {
    let n = at.shading;
    let placed = (shape.placed != IN_WORLD).then(|| placements.placed::<f32>(shape.placed as i32));
    let (along, handedness) = match &shape.form {
        Form::Sphere(sphere) => (sphere.dp_du(at.geometric), 1.0),
        Form::Disk(disk) => (disk.x * hit.u + disk.y * hit.v, 1.0),
        Form::Mesh(mesh) => {
            if let Some(tangents) = &mesh.tangents {
                let mut own = table.corners(primitive).map(|c| tangents[(c - mesh.first_vertex) as usize]);
                if let Some(placed) = &placed {
                    let side = if placed.mirrors() { -1.0 } else { 1.0 };
                    for tangent in &mut own {
                        let along = Vec3::from(placed.vector(tangent.truncate().into()));
                        *tangent = along.normalize_or_zero().extend(tangent.w * side);
                    }
                }
                let sum = own[0] * (1.0 - hit.u - hit.v) + own[1] * hit.u + own[2] * hit.v;
                (sum.truncate(), if sum.w < 0.0 { -1.0 } else { 1.0 })
            } else if !table.lacks(primitive).uvs {
                let facts = table.facts::<f32>(primitive as i32);
                let [p0, p1, p2] = facts.positions.map(Vec3::from);
                let (mut q1, mut q2) = (p1 - p0, p2 - p0);
                if let Some(placed) = &placed {
                    q1 = placed.vector(q1.into()).into();
                    q2 = placed.vector(q2.into()).into();
                }
                let [ua, ub, uc] = facts.uvs().map(|uv| Vec2::new(uv.x, uv.y));
                let (d1, d2) = (ub - ua, uc - ua);
                let det = d1.perp_dot(d2);
                let dp_du = (q1 * d2.y - q2 * d1.y) * det.signum();
                let dp_dv = (q2 * d1.x - q1 * d2.x) * det.signum();
                // v points down in images, so up is against dp/dv.
                (dp_du, if n.cross(dp_du).dot(dp_dv) > 0.0 { -1.0 } else { 1.0 })
            } else {
                (Vec3::ZERO, 1.0)
            }
        }
    };
    let s = along - n * n.dot(along);
    if !(s.length_squared() > 1e-20 && s.is_finite()) {
        return Frame::new(n);
    }
    let s = s.normalize();
    Frame { s, t: n.cross(s) * handedness, n }
}
