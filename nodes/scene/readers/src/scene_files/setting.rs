//! What a file that is rendered alone may lack, or gets in place of its own: a view of all of it, an environment. Knows
//! no file format.

use super::build::Builder;
use crate::assets::{ending, radiance};
use std::{collections::BTreeMap, path::Path};
use tauflow_contract::{Digest, KindError, read_regular};
use tauflow_data::{
    Image,
    geom::{Aabb, Vec3, add, apply, cross, length, mul, sub, unit},
    maths,
    mesh::Mesh,
    scene::{Camera, Emitter, Geometry, IDENTITY},
};

/// Where a scene is looked at from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// A camera of the file, from 0.
    Camera(usize),
    /// From where all of it is seen, in the direction of the file's first camera if it has one.
    Fit,
}

/// What a scene gets beside what its file says.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// Where it is looked at from.
    pub view: View,
    /// True frames a file without a camera as [`View::Fit`] does.
    pub frame: bool,
    /// Width of the picture over its height, for a view of all and for cameras of glTF files that state none; none is
    /// that of the file's own film.
    pub aspect: Option<f64>,
    /// An environment in place of the file's own, as longitude and latitude; linear radiance.
    pub environment: Option<Image>,
    /// The environment of a file that gives no light.
    pub fallback: Option<Image>,
}

impl Setting {
    /// A camera of the file, and nothing else.
    pub fn camera(view: usize) -> Self {
        Self { view: View::Camera(view), frame: false, aspect: None, environment: None, fallback: None }
    }
}

/// Largest file of an environment.
const LARGEST: u64 = 1 << 31;

/// Reads an environment map: an .exr or .hdr file by longitude and latitude.
///
/// # Errors
/// If it cannot be read, is no such picture, or has radiance that is negative or not finite.
pub fn environment_map(path: &Path) -> Result<Image, KindError> {
    let name = path.display().to_string();
    if !matches!(ending(&name).as_str(), "exr" | "hdr" | "rgbe" | "pic") {
        return Err(KindError::Input(format!("`{name}` is no environment by its ending; use an .exr or .hdr file")));
    }
    let bytes = read_regular(path, LARGEST)
        .map_err(|e| KindError::Input(format!("cannot read `{name}`: {e}; mend the path")))?;
    let image = radiance(&name, &bytes).map_err(|refusal| KindError::Input(refusal.line(&name)))?;
    let bad = image.data().iter().filter(|v| !(v.is_finite() && **v >= 0.0)).count();
    if bad > 0 {
        return Err(KindError::Input(format!("{name}: {bad} values are negative or not finite; mend the picture")));
    }
    Ok(image)
}

/// Puts an environment into a scene, in place of its own.
pub(super) fn surround(build: &mut Builder<'_>, map: &Image) {
    build.emitters.retain(|e| !matches!(e, Emitter::Constant { .. } | Emitter::Envmap { .. }));
    let image = build.blobs.add(map.to_bytes());
    build.emitters.push(Emitter::Envmap { image, scale: 1.0, to_world: IDENTITY });
}

/// True if something in a scene gives light.
pub(super) fn shines(build: &Builder<'_>) -> bool {
    !build.emitters.is_empty() || build.shapes.iter().any(|shape| shape.emission.is_some())
}

/// The smaller field of view of a camera that sees all, degrees.
const FIELD: f64 = 40.0;

/// From where such a camera looks, if the file has none: from the front (+z), a little from the right and above.
const FROM: Vec3 = [0.5, 0.4, 1.0];

/// Most vertices of a mesh that are looked at to find where a scene is.
const LOOKED_AT: usize = 4096;

/// Share of points at either end of an axis that does not count where leaving it out shrinks the scene tenfold.
const STRAY: f64 = 0.001;

/// A camera that sees all of a scene; none of a scene without a size. `like` says from where it looks.
pub(super) fn fit(build: &Builder<'_>, like: Option<&Camera>, aspect: f64) -> Option<Camera> {
    let bounds = bounds(build)?;
    let (center, radius) = (bounds.center(), 0.5 * length(bounds.size()));
    let (from, up) = match like {
        Some(camera) => (unit(sub(camera.origin, camera.target)), camera.up),
        None => (unit(FROM), [0.0, 1.0, 0.0]),
    };
    let half = 0.5 * FIELD.to_radians();
    let wide = if aspect > 1.0 { 2.0 * maths::atan(maths::tan(half) * aspect) } else { 2.0 * half };
    let origin = add(center, mul(from, radius / maths::sin(half)));
    let sound = radius > 0.0 && origin.iter().all(|v| v.is_finite()) && length(cross(from, up)) > 0.0;
    sound.then_some(Camera { origin, target: center, up, fov_x: wide.to_degrees(), near: 0.0 })
}

/// Points that lie on a shape, in its own space.
fn points(geometry: &Geometry, build: &Builder<'_>) -> Vec<Vec3> {
    let corners = |z: &[f64]| -> Vec<Vec3> {
        let flat = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        z.iter().flat_map(|z| flat.map(|[x, y]| [x, y, *z])).collect()
    };
    match geometry {
        Geometry::Rectangle | Geometry::Disk => corners(&[0.0]),
        Geometry::Cube => corners(&[-1.0, 1.0]),
        Geometry::Sphere { center, radius } => {
            let axis = |c: usize| [-1.0, 1.0].map(|side| [0, 1, 2].map(|i: usize| if i == c { side } else { 0.0 }));
            (0..3).flat_map(axis).map(|p| add(*center, mul(p, *radius))).collect()
        }
        Geometry::Mesh { mesh } => {
            let mesh = build.blobs.get(mesh).and_then(|bytes| Mesh::from_bytes(bytes).ok()).unwrap_or_default();
            let step = mesh.positions.len().div_ceil(LOOKED_AT).max(1);
            mesh.positions.iter().step_by(step).map(|p| p.map(f64::from)).collect()
        }
    }
}

/// Most shapes whose points are sorted to find strays: of more, every second, third, ... one.
const MOST_SORTED: usize = 1 << 14;

/// The box of a scene. Far-off strays do not count.
fn bounds(build: &Builder<'_>) -> Option<Aabb> {
    let mut known: BTreeMap<Digest, Vec<Vec3>> = BTreeMap::new();
    let (mut all, mut full): (Vec<Vec3>, Aabb) = (Vec::new(), Aabb::EMPTY);
    let every = build.shapes.len().div_ceil(MOST_SORTED).max(1);
    for (number, shape) in build.shapes.iter().enumerate() {
        let own;
        let points = match &shape.geometry {
            Geometry::Mesh { mesh } => known.entry(*mesh).or_insert_with(|| points(&shape.geometry, build)),
            other => {
                own = points(other, build);
                &own
            }
        };
        // Of a mesh that is shown very often a few points say enough.
        let step = if build.shapes.len() > 1000 { points.len().div_ceil(64).max(1) } else { 1 };
        let placed = points.iter().step_by(step).map(|p| apply(&shape.to_world, *p));
        for point in placed.filter(|p| p.iter().all(|v| v.is_finite())) {
            full.grow(point);
            if number.is_multiple_of(every) {
                all.push(point);
            }
        }
    }
    let skip = (all.len() as f64 * STRAY) as usize;
    let mut core = full;
    for axis in 0..3 {
        let mut along: Vec<f64> = all.iter().map(|p| p[axis]).collect();
        along.sort_unstable_by(f64::total_cmp);
        if let (Some(low), Some(high)) = (along.get(skip), along.len().checked_sub(skip + 1).and_then(|i| along.get(i)))
        {
            (core.low[axis], core.high[axis]) = (*low, *high);
        }
    }
    let largest = |b: &Aabb| b.size().into_iter().fold(0.0, f64::max);
    let strays = largest(&core) > 0.0 && largest(&full) > 10.0 * largest(&core);
    (!all.is_empty()).then_some(if strays { core } else { full })
}
