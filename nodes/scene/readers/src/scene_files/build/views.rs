//! Cameras, fields of view, and transforms that mirror.

use super::{Builder, holds};
use crate::scene_files::problems::Place;
use tauflow_data::{
    geom::{compose, determinant, dot, length},
    scene::{Affine, Bsdf, Camera, Emitter, IDENTITY, ReliefForm},
};

/// `a` after `b`, to the bit where one of them does nothing: a product would turn -0 into 0.
pub fn chained(a: &Affine, b: &Affine) -> Affine {
    if *a == IDENTITY {
        *b
    } else if *b == IDENTITY {
        *a
    } else {
        compose(a, b)
    }
}

/// A camera looks along `to_world`'s +z with +y up; its picture's right is its -x, as in a right-handed space.
pub fn camera(to_world: &Affine, fov_x: f64, near: f64) -> Camera {
    let column = |c: usize| [0, 1, 2].map(|r: usize| to_world[r][c]);
    let (origin, forward) = (column(3), column(2));
    Camera { origin, target: tauflow_data::geom::add(origin, forward), up: column(1), fov_x, near }
}

/// The remedy against a camera's mirroring transform.
pub const UNMIRROR: &str = "take the mirroring scale out of the camera's transform";

/// Turns left into right in all of a scene but its camera, which was mirrored: its picture is that of a plain camera in
/// the mirrored scene. `at` is where the camera stands, and `remedy` helps where normal maps do not allow it.
pub fn mirror(builder: &mut Builder<'_>, camera: &mut Camera, at: &Place, remedy: &str) {
    const LEFT: Affine = [[-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
    let flip = |v: &mut [f64; 3]| v[0] = -v[0];
    for shape in &mut builder.shapes {
        shape.to_world = compose(&LEFT, &shape.to_world);
    }
    for emitter in &mut builder.emitters {
        match emitter {
            Emitter::Constant { .. } => {}
            Emitter::Envmap { to_world, .. } | Emitter::Spot { to_world, .. } => *to_world = compose(&LEFT, to_world),
            Emitter::Point { position, .. } => flip(position),
            Emitter::Directional { direction, .. } => flip(direction),
        }
    }
    [&mut camera.origin, &mut camera.target, &mut camera.up].into_iter().for_each(flip);
    if builder.materials.iter().any(|bsdf| holds(bsdf, maps_normals)) {
        let what = "a mirrored camera with normal maps, whose green is then upside down";
        builder.problems.error(at, what, remedy);
    }
}

/// True for a camera or a shape whose transform mirrors.
pub fn mirrors(map: &Affine) -> bool {
    determinant(map) < 0.0
}

/// True for a map that scales evenly, which leaves a sphere a sphere.
pub fn even(map: &Affine) -> bool {
    let column = |c: usize| [0, 1, 2].map(|r: usize| map[r][c]);
    let axes = [column(0), column(1), column(2)];
    let scale = length(axes[0]);
    let pairs = [(0, 1), (1, 2), (2, 0)];
    axes.iter().all(|a| (length(*a) - scale).abs() <= 1e-6 * scale)
        && pairs.iter().all(|(a, b): &(usize, usize)| dot(axes[*a], axes[*b]).abs() <= 1e-6 * scale * scale)
}

/// True for a normal map, whose tangent frame has a handedness.
fn maps_normals(bsdf: &Bsdf) -> bool {
    matches!(bsdf, Bsdf::NormalMap { .. } | Bsdf::Relief { form: ReliefForm::Normals, .. })
}

/// Field of view along x of one that is given along another axis of a film.
///
/// `axis` is `x`, `y`, `diagonal`, `smaller` or `larger`; none for another word.
pub fn fov_x(degrees: f64, axis: &str, [width, height]: [u32; 2]) -> Option<f64> {
    use tauflow_data::maths::{atan, tan};
    let aspect = f64::from(width) / f64::from(height);
    let half = tan(degrees.to_radians() * 0.5);
    let along = |slope: f64| 2.0 * atan(slope).to_degrees();
    let y = || along(half * aspect);
    Some(match axis {
        "x" => degrees,
        "y" => y(),
        "diagonal" => along(half / (1.0 + 1.0 / (aspect * aspect)).sqrt()),
        "smaller" if aspect > 1.0 => y(),
        "larger" if aspect < 1.0 => y(),
        "smaller" | "larger" => degrees,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_view_are_those_of_mitsuba() {
        // From Mitsuba 3.9.1: 40 degrees along each axis of a film of 200 x 100.
        for (axis, degrees) in
            [("x", 40.0), ("y", 72.10477), ("diagonal", 36.06479), ("smaller", 72.10477), ("larger", 40.0)]
        {
            let found = fov_x(40.0, axis, [200, 100]).expect("an axis");
            assert!((found - degrees).abs() < 1e-4, "{axis}: {found}");
        }
        assert_eq!(fov_x(40.0, "z", [1, 1]), None);
        // The same of a lens of 35 mm: `focal_length`.
        let diagonal = 2.0 * tauflow_data::maths::atan((36.0f64 * 36.0 + 24.0 * 24.0).sqrt() / 70.0).to_degrees();
        assert!((fov_x(diagonal, "diagonal", [200, 100]).expect("an axis") - 57.871_193).abs() < 1e-4);
    }
}
