//! A batch of paths, traced bounce by bounce: all rays are met, hits are sorted by material, each material shades its
//! own, shadow rays come last.
//!
//! Shading knows one material at a time, so that what it lacks costs nothing, and works on as many paths as there are
//! lanes, in steps: the vertex, what it emits, its textures, a light, where the path goes on. The result of a path does
//! not depend on its batch: all operations use its own numbers, in a fixed order.

mod rays;
mod rows;
mod shading;

use crate::{
    accel::{Hit, Sweep},
    bsdf::Material,
    camera::Camera,
    dispatch::Kernels,
    geometry::Ray,
    integrator::{Roulette, Strategy},
    lanes::{Mask, Pair, Real, Triple},
    rng::{Sampler, draw},
    world::World,
};
use glam::Vec3;
use rays::Passing;
use rows::{DIRECTION, ORIGIN, Paths, Rows, SPARE, Shadows, VERTEX};
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
    pub(crate) strategy: Strategy,
    pub(crate) roulette: Roulette,
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
    batch: &'a Batch<'a>,
    paths: Paths,
    next: Paths,
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
    found: Found,
}

/// The memory of a stream, kept by each thread from batch to batch.
#[derive(Default)]
struct Scratch {
    paths: Paths,
    next: Paths,
    shadows: Shadows,
    vertices: Rows<VERTEX>,
    hits: [Vec<f32>; 3],
    primitive: Vec<u32>,
    shape: Vec<u32>,
    order: Vec<u32>,
    starts: Vec<u32>,
    sweep: Sweep,
    through: Passing,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Traces a batch with kernels.
pub(crate) fn trace(batch: &Batch<'_>, kernels: &Kernels) -> Found {
    let count = batch.paths.len();
    let scratch = SCRATCH.take();
    let Scratch { mut paths, mut next, mut shadows, mut vertices, hits, .. } = scratch;
    let Scratch { mut primitive, mut shape, mut order, starts, sweep, through, .. } = scratch;
    paths.reserve(count);
    next.reserve(count);
    shadows.reserve(count);
    vertices.reserve(CHUNK);
    let [t, u, v] = hits.map(|mut row| {
        row.resize(row.len().max(count + SPARE), 0.0);
        row
    });
    primitive.resize(primitive.len().max(count + SPARE), MISS);
    shape.resize(shape.len().max(count + SPARE), 0);
    order.resize(order.len().max(count + SPARE), 0);
    let found = Found { radiance: vec![Vec3::ZERO; count], ..Found::default() };
    let mut stream = Stream {
        batch,
        paths,
        next,
        shadows,
        vertices,
        t,
        u,
        v,
        primitive,
        shape,
        order,
        starts,
        sweep,
        through,
        found,
    };
    stream.run(kernels);
    let Stream { paths, next, shadows, vertices, t, u, v, primitive, shape, order, starts, .. } = stream;
    let Stream { sweep, through, found, .. } = stream;
    let hits = [t, u, v];
    SCRATCH.set(Scratch { paths, next, shadows, vertices, hits, primitive, shape, order, starts, sweep, through });
    found
}

impl Stream<'_> {
    fn run(&mut self, kernels: &Kernels) {
        let stream = self;
        kernels.begin(stream);
        let world = stream.batch.world;
        for depth in 0..world.max_depth {
            if stream.paths.len == 0 {
                break;
            }
            stream.found.segments += stream.paths.len as u64;
            if world.features.opacity {
                stream.meet_through(kernels, depth);
            } else if depth == 0 {
                kernels.meet_packets(stream);
            } else {
                stream.meet(kernels);
            }
            stream.sort();
            (stream.next.len, stream.shadows.len) = (0, 0);
            if world.lights.environment().is_some() && stream.starts[1] > 0 {
                kernels.miss(stream);
            }
            for (index, material) in world.materials.iter().enumerate() {
                let (from, end) = (stream.starts[index + 1] as usize, stream.starts[index + 2] as usize);
                for from in (from..end).step_by(CHUNK) {
                    let group = Group { index, from, end: (from + CHUNK).min(end), depth };
                    stream.shade(kernels, material, &group);
                }
            }
            stream.shadow(kernels);
            std::mem::swap(&mut stream.paths, &mut stream.next);
        }
    }

    /// The effect of a material on the paths that hit it.
    fn shade(&mut self, kernels: &Kernels, material: &Material, group: &Group) {
        let world = self.batch.world;
        kernels.vertices(self, group);
        let reads_uv = material.reads_uv() || world.emits[group.index];
        if world.bodies[group.index] && reads_uv {
            kernels.bodies(self, group);
        }
        if world.reads_colors[group.index] {
            self.colors(group);
        }
        if world.emits[group.index] {
            kernels.emit(self, group);
        }
        if group.depth + 1 >= world.max_depth {
            return;
        }
        if material.has_normal_map() {
            self.map_normals(group);
        }
        kernels.textures(self, group);
        if self.samples_lights(material) {
            kernels.lights(self, group);
        }
        kernels.scatter(material.kernel(), self, group);
    }
}

/// Paths that meet a material, at most [`CHUNK`]: places in [`Stream::order`].
pub(crate) struct Group {
    index: usize,
    from: usize,
    end: usize,
    depth: u32,
}

impl Stream<'_> {
    #[inline(always)]
    fn ray(&self, at: usize) -> Ray {
        Ray::new(self.paths.vector(ORIGIN, at), self.paths.vector(DIRECTION, at))
    }

    #[inline(always)]
    fn note(&mut self, at: usize, hit: Option<Hit>) {
        self.primitive[at] = MISS;
        if let Some(hit) = hit {
            (self.t[at], self.u[at], self.v[at], self.primitive[at]) = (hit.t, hit.u, hit.v, hit.primitive);
        }
    }

    /// Finds what was hit, and sorts live paths by material (by counting).
    fn sort(&mut self) {
        let world = self.batch.world;
        self.starts.clear();
        self.starts.resize(world.materials.len() + 2, 0);
        for at in 0..self.paths.len {
            let mut bucket = 0;
            if self.primitive[at] != MISS {
                (self.shape[at], self.primitive[at]) = world.place(self.primitive[at]);
                bucket = world.shapes[self.shape[at] as usize].material as usize + 1;
            }
            self.starts[bucket + 1] += 1;
        }
        for k in 1..self.starts.len() {
            self.starts[k] += self.starts[k - 1];
        }
        for at in 0..self.paths.len {
            let mut bucket = 0;
            if self.primitive[at] != MISS {
                bucket = world.shapes[self.shape[at] as usize].material as usize + 1;
            }
            self.order[self.starts[bucket] as usize] = at as u32;
            self.starts[bucket] += 1;
        }
        // Lanes to spare read the first path, and come to nothing.
        let len = self.paths.len;
        self.order[len..len + SPARE].fill(0);
        // Each start has moved to the next one's.
        self.starts.rotate_right(1);
        self.starts[0] = 0;
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
        for (id, place) in ids[..R::N].iter_mut().zip(&self.order[at..]) {
            *id = self.paths.ids[*place as usize];
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
