//! A batch of paths, traced bounce by bounce: all rays are met, hits are sorted by material, each material shades its
//! own, shadow rays come last.
//!
//! Shading knows one material at a time, so that what it lacks costs nothing, and works on as many paths as there are
//! lanes, in steps: the vertex, what it emits, its textures, a light, where the path goes on. The result of a path does
//! not depend on its batch: all operations use its own numbers, in a fixed order.

mod rays;
mod rows;
mod scattering;
mod shading;

use crate::{
    accel::{Hit, Sweep},
    camera::Camera,
    dispatch::Kernels,
    geometry::Ray,
    integrator::{Path, Plan},
    lanes::{Mask, Pair, Real, Triple},
    rng::{Sampler, draw},
    world::World,
};
use glam::Vec3;
use rays::Passing;
use rows::{DIRECTION, ORIGIN, Paths, Rivals, Rows, SPARE, Shadows, VERTEX};
use std::cell::RefCell;
use tauflow_data::SamplerKind;

/// Paths that are shaded together: few enough for what is known of their vertices to stay in the nearest cache.
const CHUNK: usize = 256;
/// The primitive of a ray that meets nothing.
const MISS: u32 = u32::MAX;

/// The paths to trace: one per pixel and sample index.
pub(crate) struct Batch<'a> {
    pub(crate) world: &'a World,
    pub(crate) camera: &'a Camera,
    pub(crate) path: Path,
    /// Longest path in segments.
    pub(crate) depth: u32,
    /// Light paths, too; none where paths from the camera are alone.
    pub(crate) light_paths: Option<&'a Plan>,
    /// How all of them draw.
    pub(crate) sampler: SamplerKind,
    /// Pixels and the numbers of their samples.
    pub(crate) paths: &'a [((u32, u32), Sampler)],
}

/// The results of a batch.
#[derive(Default)]
pub(crate) struct Found {
    /// Radiance of each path.
    pub(crate) radiance: Vec<Vec3>,
    pub(crate) segments: u64,
    /// Contributions that were not finite.
    pub(crate) rejected: u64,
}

/// A batch on its way.
pub(crate) struct Stream<'a> {
    pub(crate) batch: &'a Batch<'a>,
    scratch: Scratch,
    pub(crate) found: Found,
}

/// The memory of a stream, kept by each thread from batch to batch.
#[derive(Default)]
struct Scratch {
    paths: Paths,
    next: Paths,
    /// What weighs paths against light paths, if there are any: rows beside those of `paths` and `next`.
    rivals: Rivals,
    next_rivals: Rivals,
    shadows: Shadows,
    vertices: Rows<VERTEX>,
    t: Vec<f32>,
    u: Vec<f32>,
    v: Vec<f32>,
    /// Primitives that were hit; once sorted, their places in the table.
    primitive: Vec<u32>,
    /// Shapes that were hit, once sorted.
    shape: Vec<u32>,
    /// Live paths by material, those that meet nothing first.
    order: Vec<u32>,
    starts: Vec<u32>,
    sweep: Sweep,
    through: Passing,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

impl Scratch {
    /// Makes room for so many paths.
    fn reserve(&mut self, count: usize, with_rivals: bool) {
        self.paths.reserve(count);
        if with_rivals {
            self.rivals.reserve(count);
            self.next_rivals.reserve(count);
        }
        self.next.reserve(count);
        self.shadows.reserve(count);
        self.vertices.reserve(CHUNK);
        let room = count + SPARE;
        for row in [&mut self.t, &mut self.u, &mut self.v] {
            row.resize(row.len().max(room), 0.0);
        }
        self.primitive.resize(self.primitive.len().max(room), MISS);
        self.shape.resize(self.shape.len().max(room), 0);
        self.order.resize(self.order.len().max(room), 0);
    }
}

/// Traces a batch with kernels.
pub(crate) fn trace(batch: &Batch<'_>, kernels: &Kernels) -> Found {
    let count = batch.paths.len();
    let mut scratch = SCRATCH.take();
    scratch.reserve(count, batch.light_paths.is_some());
    let found = Found { radiance: vec![Vec3::ZERO; count], ..Found::default() };
    let mut stream = Stream { batch, scratch, found };
    batch.path.run(&mut stream, kernels);
    let Stream { scratch, found, .. } = stream;
    SCRATCH.set(scratch);
    found
}

/// The steps of a bounce, in the order in which [`Path::run`] takes them.
impl Stream<'_> {
    /// Paths that live.
    pub(crate) fn live(&self) -> usize {
        self.scratch.paths.len
    }

    /// The first hits that do not let their rays pass.
    pub(crate) fn meet_solid(&mut self, kernels: &Kernels, depth: u32) {
        if self.batch.world.features.opacity {
            self.meet_through(kernels, depth);
        } else if depth == 0 {
            kernels.meet_packets(self);
        } else {
            self.meet(kernels);
        }
    }

    /// What paths find that meet nothing, once they are sorted.
    pub(crate) fn leave(&mut self, kernels: &Kernels, depth: u32) {
        let world = self.batch.world;
        let hidden = depth == 0 && world.features.hidden_emitters;
        if world.lights.environment().is_some() && !hidden && self.scratch.starts[1] > 0 {
            let group = Group { index: 0, from: 0, end: self.scratch.starts[1] as usize, depth };
            kernels.miss(self, &group);
        }
    }

    /// What materials do to the paths that meet them: light that is found, shadow rays, and where paths go on.
    pub(crate) fn shade(&mut self, kernels: &Kernels, depth: u32) {
        (self.scratch.next.len, self.scratch.next_rivals.len, self.scratch.shadows.len) = (0, 0, 0);
        for index in 0..self.batch.world.materials.len() {
            let starts = &self.scratch.starts;
            let (from, end) = (starts[index + 1] as usize, starts[index + 2] as usize);
            for from in (from..end).step_by(CHUNK) {
                self.shade_group(kernels, &Group { index, from, end: (from + CHUNK).min(end), depth });
            }
        }
    }

    /// The effect of a material on the paths that hit it.
    fn shade_group(&mut self, kernels: &Kernels, group: &Group) {
        let world = self.batch.world;
        let used = &world.materials[group.index];
        let material = &used.material;
        kernels.vertices(self, group);
        if used.bodies && used.reads_uv() {
            kernels.bodies(self, group);
        }
        if used.reads_colors {
            self.colors(group);
        }
        if used.emits {
            kernels.emit(self, group);
        }
        if group.depth + 1 >= self.batch.depth {
            return;
        }
        if used.normal_map_by_lane().is_some() {
            kernels.normal_maps(self, group);
            if used.bodies {
                self.frames_of_bodies(group);
            }
        } else if material.has_own_frame() {
            self.own_frames(group);
        }
        kernels.textures(self, group);
        if self.samples_lights(material) {
            kernels.lights(self, group);
        }
        kernels.scatter(material.kernel(), self, group);
    }

    /// Paths that go on take the place of those before.
    pub(crate) fn go_on(&mut self) {
        std::mem::swap(&mut self.scratch.paths, &mut self.scratch.next);
        std::mem::swap(&mut self.scratch.rivals, &mut self.scratch.next_rivals);
    }
}

/// Paths that meet a material, at most [`CHUNK`]: places in [`Scratch::order`].
pub(crate) struct Group {
    index: usize,
    from: usize,
    end: usize,
    depth: u32,
}

impl Stream<'_> {
    #[inline(always)]
    fn ray(&self, at: usize) -> Ray {
        Ray::new(self.scratch.paths.vector(ORIGIN, at), self.scratch.paths.vector(DIRECTION, at))
    }

    #[inline(always)]
    fn note(&mut self, at: usize, hit: Option<Hit>) {
        self.scratch.primitive[at] = MISS;
        if let Some(hit) = hit {
            (self.scratch.t[at], self.scratch.u[at], self.scratch.v[at], self.scratch.primitive[at]) =
                (hit.t, hit.u, hit.v, hit.primitive);
        }
    }

    /// Finds what was hit, and sorts live paths by material (by counting).
    pub(crate) fn sort(&mut self) {
        let world = self.batch.world;
        self.scratch.starts.clear();
        self.scratch.starts.resize(world.materials.len() + 2, 0);
        for at in 0..self.scratch.paths.len {
            let mut bucket = 0;
            if self.scratch.primitive[at] != MISS {
                (self.scratch.shape[at], self.scratch.primitive[at]) = world.place(self.scratch.primitive[at]);
                bucket = world.shapes[self.scratch.shape[at] as usize].material as usize + 1;
            }
            self.scratch.starts[bucket + 1] += 1;
        }
        for k in 1..self.scratch.starts.len() {
            self.scratch.starts[k] += self.scratch.starts[k - 1];
        }
        for at in 0..self.scratch.paths.len {
            let mut bucket = 0;
            if self.scratch.primitive[at] != MISS {
                bucket = world.shapes[self.scratch.shape[at] as usize].material as usize + 1;
            }
            self.scratch.order[self.scratch.starts[bucket] as usize] = at as u32;
            self.scratch.starts[bucket] += 1;
        }
        // Lanes to spare read the first path, and come to nothing.
        let len = self.scratch.paths.len;
        self.scratch.order[len..len + SPARE].fill(0);
        // Each start has moved to the next one's.
        self.scratch.starts.rotate_right(1);
        self.scratch.starts[0] = 0;
    }

    /// The lanes there are of a group, from a place on.
    #[inline(always)]
    fn mask<R: Real>(at: usize, end: usize) -> R::Mask {
        R::Mask::from_bits(u32::MAX >> (32 - R::N.min(end - at)))
    }

    /// Numbers of the paths in the lanes.
    #[inline(always)]
    fn ids<R: Real>(&self, at: usize) -> [u32; SPARE] {
        let mut ids = [0; SPARE];
        for (id, place) in ids[..R::N].iter_mut().zip(&self.scratch.order[at..]) {
            *id = self.scratch.paths.ids[*place as usize];
        }
        ids
    }

    /// Points of the paths in the lanes, whose samplers have these states, in a dimension.
    #[inline(always)]
    fn draw<R: Real>(&self, states: &[u64; SPARE], dimension: u64) -> Pair<R> {
        draw(self.batch.sampler, states, dimension)
    }

    /// Adds to the radiance of the paths of a mask; what is not finite is counted and left out.
    #[inline(always)]
    fn add<R: Real>(&mut self, mask: R::Mask, light: Triple<R>, ids: &[u32; SPARE]) {
        let sound = light.finite();
        self.found.rejected += u64::from((mask & !sound).bits().count_ones());
        let mut bits = (mask & sound & light.some()).bits();
        if bits == 0 {
            return;
        }
        let mut rows = [[0.0; SPARE]; 3];
        light.x.store(&mut rows[0]);
        light.y.store(&mut rows[1]);
        light.z.store(&mut rows[2]);
        while bits != 0 {
            let lane = bits.trailing_zeros() as usize % SPARE;
            bits &= bits - 1;
            self.found.radiance[ids[lane] as usize] += Vec3::new(rows[0][lane], rows[1][lane], rows[2][lane]);
        }
    }
}
