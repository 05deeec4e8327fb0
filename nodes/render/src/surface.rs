//! What a ray finds at a hit: point with error bound, normals, texture coordinates, tangents.

use crate::{
    accel::Hit,
    bsdf::Surface,
    geometry::{Disk, Frame, Ray, Sphere, gamma},
    table::Table,
};
use glam::{Vec2, Vec3, Vec4};

/// Attributes of a mesh in the world.
#[derive(Debug, Default)]
pub struct MeshAttributes {
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Unit vertex normals, or none for flat shading.
    pub normals: Option<Vec<Vec3>>,
    /// Texture coordinates.
    pub uvs: Option<Vec<Vec2>>,
    /// Vertex colours.
    pub colors: Option<Vec<Vec4>>,
    /// World tangents and handedness.
    pub tangents: Option<Vec<Vec4>>,
}

/// A shape's form, for what a hit needs beyond its distance.
#[derive(Debug)]
pub enum Form {
    /// Triangles.
    Mesh(MeshAttributes),
    /// One sphere.
    Sphere(Sphere),
    /// One disk.
    Disk(Disk),
}

/// Where a primitive belongs.
#[derive(Clone, Copy, Debug)]
pub struct Primitive {
    /// Its shape.
    pub shape: u32,
    /// Index of its triangle in the shape's mesh.
    pub triangle: u32,
    /// Its unit normal on the outer side; 0 for spheres.
    pub normal: Vec3,
}

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
    /// What textures are read by.
    pub surface: Surface,
    /// The shape that is hit.
    pub shape: u32,
}

impl MeshAttributes {
    #[inline]
    fn corners(&self, primitive: &Primitive) -> [usize; 3] {
        self.triangles[primitive.triangle as usize].map(|i| i as usize)
    }

    #[inline]
    pub(crate) fn surface(&self, primitive: &Primitive, weights: [f32; 3]) -> Surface {
        let [i, j, k] = self.corners(primitive);
        let [a, b, c] = weights;
        let uv = self.uvs.as_ref().map_or(Vec2::new(b, c), |uv| uv[i] * a + uv[j] * b + uv[k] * c);
        Surface { uv, color: self.color(primitive, weights) }
    }

    /// Vertex colour at a point of a triangle; one without any.
    pub(crate) fn color(&self, primitive: &Primitive, [a, b, c]: [f32; 3]) -> Vec4 {
        let [i, j, k] = self.corners(primitive);
        self.colors.as_ref().map_or(Vec4::ONE, |v| v[i] * a + v[j] * b + v[k] * c)
    }
}

/// Works out a hit.
#[inline]
pub(crate) fn interact(
    table: &Table,
    primitive: &Primitive,
    form: &Form,
    flip: bool,
    ray: &Ray,
    hit: &Hit,
) -> Interaction {
    let mut found = match form {
        Form::Mesh(mesh) => {
            let [p0, p1, p2] = table.triangle(hit.primitive);
            let weights = [1.0 - hit.u - hit.v, hit.u, hit.v];
            let (a, b, c) = (p0 * weights[0], p1 * weights[1], p2 * weights[2]);
            let shading = mesh.normals.as_ref().map_or(primitive.normal, |normals| {
                let [i, j, k] = mesh.corners(primitive);
                let n = normals[i] * weights[0] + normals[j] * weights[1] + normals[k] * weights[2];
                n.normalize_or(primitive.normal)
            });
            Interaction {
                p: a + b + c,
                error: (a.abs() + b.abs() + c.abs()) * gamma(7),
                geometric: primitive.normal,
                shading,
                surface: mesh.surface(primitive, weights),
                shape: primitive.shape,
            }
        }
        Form::Sphere(sphere) => {
            let (p, n, error) = sphere.project(ray.at(hit.t));
            let surface = Surface { uv: sphere.uv(n), color: Vec4::ONE };
            Interaction { p, error, geometric: n, shading: n, surface, shape: primitive.shape }
        }
        Form::Disk(disk) => {
            let (p, error) = disk.point(hit.u, hit.v);
            let surface = Surface { uv: Disk::uv(hit.u, hit.v), color: Vec4::ONE };
            let n = disk.normal;
            Interaction { p, error, geometric: n, shading: n, surface, shape: primitive.shape }
        }
    };
    if flip {
        found.geometric = -found.geometric;
        found.shading = -found.shading;
    }
    found
}

/// The frame of a normal map about the shading normal: s along growing u (or the mesh's tangent), t upwards in the
/// image, as glTF has it.
pub(crate) fn tangent_frame(table: &Table, primitive: &Primitive, form: &Form, hit: &Hit, at: &Interaction) -> Frame {
    let n = at.shading;
    let (along, handedness) = match form {
        Form::Sphere(sphere) => (sphere.dp_du(at.geometric), 1.0),
        Form::Disk(disk) => (disk.x * hit.u + disk.y * hit.v, 1.0),
        Form::Mesh(mesh) => {
            let [i, j, k] = mesh.corners(primitive);
            if let Some(tangents) = &mesh.tangents {
                let sum = tangents[i] * (1.0 - hit.u - hit.v) + tangents[j] * hit.u + tangents[k] * hit.v;
                (sum.truncate(), if sum.w < 0.0 { -1.0 } else { 1.0 })
            } else if let Some(uvs) = &mesh.uvs {
                let [p0, p1, p2] = table.triangle(hit.primitive);
                let (q1, q2) = (p1 - p0, p2 - p0);
                let (d1, d2) = (uvs[j] - uvs[i], uvs[k] - uvs[i]);
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
