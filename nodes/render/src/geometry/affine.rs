//! Affine maps, applied in f64.

use glam::{DMat3, DVec3, Vec3};
use tauflow_data::scene::Affine;

/// An affine map and the inverse transpose of its linear part.
#[derive(Clone, Copy, Debug)]
pub struct Map {
    linear: DMat3,
    shift: DVec3,
    normals: Option<DMat3>,
}

impl Map {
    /// The map of a scene file.
    pub fn new(affine: &Affine) -> Self {
        let row = |i: usize| DVec3::new(affine[i][0], affine[i][1], affine[i][2]);
        let linear = DMat3::from_cols(row(0), row(1), row(2)).transpose();
        let det = linear.determinant();
        let normals = (det.is_finite() && det != 0.0).then(|| linear.inverse().transpose());
        Self { linear, shift: DVec3::new(affine[0][3], affine[1][3], affine[2][3]), normals }
    }

    /// Images of the unit vectors.
    pub fn columns(&self) -> [DVec3; 3] {
        [self.linear.x_axis, self.linear.y_axis, self.linear.z_axis]
    }

    /// The image of the origin.
    pub fn shift(&self) -> DVec3 {
        self.shift
    }

    /// True if it turns right hands into left hands.
    pub fn mirrors(&self) -> bool {
        self.linear.determinant() < 0.0
    }

    /// A point's image.
    pub fn point(&self, p: DVec3) -> Vec3 {
        (self.linear * p + self.shift).as_vec3()
    }

    /// A direction's image.
    pub fn vector(&self, v: DVec3) -> DVec3 {
        self.linear * v
    }

    /// A normal's image, of unit length; `None` if it has no direction.
    pub fn normal(&self, n: DVec3) -> Option<DVec3> {
        let flattened = || self.linear.x_axis.cross(self.linear.y_axis);
        // A map that flattens z still has an image of the plane z = 0.
        let image = self.normals.map_or_else(flattened, |m| m * n);
        let length = image.length();
        (length.is_finite() && length > 0.0).then(|| image / length)
    }
}
