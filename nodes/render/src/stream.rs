//! A batch of paths, traced bounce by bounce: all rays are met, hits are sorted by material, each material shades its
//! own, shadow rays come last.
//!
//! Shading knows one material at a time, so that what it lacks costs nothing, and works on as many paths as there are
//! lanes, in steps: the vertex, what it emits, its textures, a light, where the path goes on. What a path finds does not depend on the batch it is in: every operation is on its own numbers, in its own
//! order.

use crate::{
    accel::{Hit, Packet, STACK, Stack},
    bsdf::{Material, Points, SLOTS, Scatter, Sort, flip, sound},
    camera::Camera,
    dispatch::Kernels,
    geometry::{Frames, Ray, gamma, offset_origins},
    integrator::{ROULETTE_FROM, Strategy, dimension, first_solid, transmittance},
    lanes::{Mask, Pair, Real, Triple, Whole},
    lights::Vantage,
    rng::{FILM, Sampler},
    table::DARK,
    world::World,
};
use glam::Vec3;
use std::cell::RefCell;

/// Widest lanes: rows have so many numbers to spare.
const SPARE: usize = 16;
/// The primitive of a ray that meets nothing.
const MISS: u32 = u32::MAX;

/// What to trace: a path for each pixel and sample index.
pub(crate) struct Batch<'a> {
    pub(crate) world: &'a World,
    pub(crate) camera: &'a Camera,
    pub(crate) strategy: Strategy,
    /// Pixels and the seeds of their samples.
    pub(crate) paths: &'a [((u32, u32), Sampler)],
}

/// What a batch found.
#[derive(Default)]
pub(crate) struct Found {
    /// Radiance of each path.
    pub(crate) radiance: Vec<Vec3>,
    pub(crate) segments: u64,
    /// Contributions that were not finite.
    pub(crate) rejected: u64,
}

/// Rows of numbers, one for each path that lives.
struct Rows<const N: usize> {
    rows: [Vec<f32>; N],
    ids: Vec<u32>,
    len: usize,
}

impl<const N: usize> Default for Rows<N> {
    fn default() -> Self {
        Self { rows: std::array::from_fn(|_| Vec::new()), ids: Vec::new(), len: 0 }
    }
}

impl<const N: usize> Rows<N> {
    /// Makes room for so many.
    fn reserve(&mut self, room: usize) {
        if self.ids.len() < room + SPARE {
            self.rows.iter_mut().for_each(|row| row.resize(room + SPARE, 0.0));
            self.ids.resize(room + SPARE, 0);
        }
    }

    /// Appends the lanes of a mask.
    #[inline(always)]
    fn push<R: Real>(&mut self, mask: R::Mask, values: [R; N], ids: &[u32; SPARE]) {
        for (row, value) in self.rows.iter_mut().zip(values) {
            value.compress(mask, &mut row[self.len..self.len + SPARE]);
        }
        let mut bits = mask.bits();
        while bits != 0 {
            self.ids[self.len] = ids[bits.trailing_zeros() as usize % SPARE];
            bits &= bits - 1;
            self.len += 1;
        }
    }

    #[inline(always)]
    fn triple<R: Real>(&self, first: usize, at: R::Whole) -> Triple<R> {
        Triple::new(
            R::gather(&self.rows[first], at),
            R::gather(&self.rows[first + 1], at),
            R::gather(&self.rows[first + 2], at),
        )
    }

    #[inline(always)]
    fn put<R: Real>(&mut self, first: usize, at: usize, value: Triple<R>) {
        value.x.store(&mut self.rows[first][at..]);
        value.y.store(&mut self.rows[first + 1][at..]);
        value.z.store(&mut self.rows[first + 2][at..]);
    }

    #[inline(always)]
    fn row<R: Real>(&self, first: usize, at: usize) -> Triple<R> {
        Triple::load([&self.rows[first], &self.rows[first + 1], &self.rows[first + 2]], at)
    }

    #[inline(always)]
    fn vector(&self, first: usize, at: usize) -> Vec3 {
        Vec3::new(self.rows[first][at], self.rows[first + 1][at], self.rows[first + 2][at])
    }
}

/// Rows of a path: origin, direction, throughput, squared product of relative indices, density of the last scattering
/// (0 where nothing but it can find the light).
type Paths = Rows<11>;
const ORIGIN: usize = 0;
const DIRECTION: usize = 3;
const THROUGHPUT: usize = 6;
const ETA: usize = 9;
const PDF: usize = 10;
/// Rows of a shadow ray: origin, direction, its end, what arrives if nothing is in between.
type Shadows = Rows<10>;
const END: usize = 6;
const ARRIVES: usize = 7;
/// Rows of a vertex, in the order of materials: point, bound on its error, geometric normal, shading normal, that of
/// the normal map, direction and throughput of the path, texture coordinates, vertex colour and its alpha, values of
/// the textures.
const POINT: usize = 0;
const ERROR: usize = 3;
const GEOMETRIC: usize = 6;
const SHADING: usize = 9;
const MAPPED: usize = 12;
const ARRIVED_BY: usize = 15;
const CARRIES: usize = 18;
const UV: usize = 21;
const COLOR: usize = 23;
const TEXTURES: usize = 27;
/// Rows of light that may arrive: direction, shadow ray (origin, direction, end), radiance over density, density.
/// Without light the radiance is 0.
const TOWARDS: usize = TEXTURES + 3 * SLOTS;
const SHADOW: usize = TOWARDS + 3;
const WEIGHT: usize = SHADOW + 7;
const LIGHT_PDF: usize = WEIGHT + 3;
const VERTEX: usize = LIGHT_PDF + 1;

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
    primitive: Vec<u32>,
    /// Live paths by material, those that meet nothing first.
    order: Vec<u32>,
    starts: Vec<u32>,
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
    order: Vec<u32>,
    starts: Vec<u32>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Traces a batch with kernels.
pub(crate) fn trace(batch: &Batch<'_>, kernels: &Kernels) -> Found {
    let count = batch.paths.len();
    let Scratch { mut paths, mut next, mut shadows, mut vertices, hits, mut primitive, mut order, starts } =
        SCRATCH.take();
    paths.reserve(count);
    next.reserve(count);
    shadows.reserve(count);
    vertices.reserve(count);
    let [t, u, v] = hits.map(|mut row| {
        row.resize(row.len().max(count + SPARE), 0.0);
        row
    });
    primitive.resize(primitive.len().max(count + SPARE), MISS);
    order.resize(order.len().max(count + SPARE), 0);
    let found = Found { radiance: vec![Vec3::ZERO; count], ..Found::default() };
    let mut stream = Stream { batch, paths, next, shadows, vertices, t, u, v, primitive, order, starts, found };
    stream.run(kernels);
    let Stream { paths, next, shadows, vertices, t, u, v, primitive, order, starts, found, .. } = stream;
    SCRATCH.set(Scratch { paths, next, shadows, vertices, hits: [t, u, v], primitive, order, starts });
    found
}

impl Stream<'_> {
    fn run(&mut self, kernels: &Kernels) {
        let stream = self;
        stream.begin();
        let world = stream.batch.world;
        for depth in 0..world.max_depth {
            if stream.paths.len == 0 {
                break;
            }
            stream.found.segments += stream.paths.len as u64;
            if world.features.opacity {
                stream.meet_through(depth);
            } else if depth == 0 {
                kernels.meet_packets(stream);
            } else {
                let len = stream.paths.len;
                kernels.meet(stream, 0, len);
            }
            stream.sort();
            (stream.next.len, stream.shadows.len) = (0, 0);
            if world.lights.environment().is_some() && stream.starts[1] > 0 {
                kernels.miss(stream);
            }
            for (index, material) in world.materials.iter().enumerate() {
                let (from, end) = (stream.starts[index + 1] as usize, stream.starts[index + 2] as usize);
                if from == end {
                    continue;
                }
                let group = Group { index, from, end, depth };
                kernels.vertices(stream, &group);
                stream.bodies(&group);
                if world.emits[index] {
                    kernels.emit(stream, &group);
                }
                if depth + 1 >= world.max_depth {
                    continue;
                }
                if material.has_normal_map() {
                    stream.map_normals(&group);
                }
                kernels.textures(stream, &group);
                let lit = material.has_smooth() && !world.lights.is_empty();
                if lit {
                    kernels.lights(stream, &group);
                }
                if material.sort() == Sort::Blend {
                    stream.scatter::<f32, crate::bsdf::Bsdf<'_>>(&group);
                } else {
                    kernels.scatter(material.sort(), stream, &group);
                }
            }
            kernels.shadow(stream);
            std::mem::swap(&mut stream.paths, &mut stream.next);
        }
    }
}

/// The paths that meet a material: places in [`Stream::order`].
pub(crate) struct Group {
    index: usize,
    from: usize,
    end: usize,
    depth: u32,
}

impl<'a> Stream<'a> {
    /// Camera rays.
    fn begin(&mut self) {
        for (at, (pixel, sampler)) in self.batch.paths.iter().enumerate() {
            let ray = self.batch.camera.ray(pixel.0, pixel.1, sampler.two(FILM));
            let values = [ray.origin, ray.direction, Vec3::ONE].map(|v| v.to_array());
            for (row, value) in self.paths.rows.iter_mut().zip(values.as_flattened()) {
                row[at] = *value;
            }
            self.paths.rows[ETA][at] = 1.0;
            self.paths.rows[PDF][at] = 0.0;
            self.paths.ids[at] = at as u32;
        }
        self.paths.len = self.batch.paths.len();
    }

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

    /// Nearest hits.
    #[inline(always)]
    pub(crate) fn meet<T: Real>(&mut self, from: usize, to: usize) {
        let mut stack: Stack = [(0, 0.0); STACK];
        for at in from..to {
            let hit = self.batch.world.accel.closest_lanes::<T>(&self.ray(at), &mut stack);
            self.note(at, hit);
        }
    }

    /// Nearest hits of camera rays: those of a pixel go nearly the same way.
    #[inline(always)]
    pub(crate) fn meet_packets<R: Real, T: Real>(&mut self) {
        let mut stack: Stack = [(0, 0.0); STACK];
        let len = self.paths.len;
        for at in (0..len).step_by(R::N) {
            let count = R::N.min(len - at);
            let mask = R::Mask::from_bits(u32::MAX >> (32 - count));
            let (origin, direction) = (self.paths.row::<R>(ORIGIN, at), self.paths.row::<R>(DIRECTION, at));
            let Some(packet) = Packet::new(origin, direction, mask) else {
                self.meet::<T>(at, at + count);
                continue;
            };
            let hits = self.batch.world.accel.closest_packet(&packet, mask, &mut stack);
            hits.t.store(&mut self.t[at..]);
            hits.u.store(&mut self.u[at..]);
            hits.v.store(&mut self.v[at..]);
            hits.primitive.store(&mut self.primitive[at..]);
        }
    }

    /// The first hits that do not let their rays pass.
    fn meet_through(&mut self, depth: u32) {
        for at in 0..self.paths.len {
            let ray = self.ray(at);
            let sampler = self.batch.paths[self.paths.ids[at] as usize].1;
            let hit = first_solid(self.batch.world, &sampler, depth, ray).map(|(hit, _)| hit);
            self.note(at, hit);
        }
    }

    /// Counting sort of live paths by material.
    fn sort(&mut self) {
        let world = self.batch.world;
        self.starts.clear();
        self.starts.resize(world.materials.len() + 2, 0);
        let bucket = |primitive: u32| {
            if primitive == MISS { 0 } else { world.table.material[primitive as usize] as usize + 1 }
        };
        for primitive in &self.primitive[..self.paths.len] {
            self.starts[bucket(*primitive) + 1] += 1;
        }
        for k in 1..self.starts.len() {
            self.starts[k] += self.starts[k - 1];
        }
        for at in 0..self.paths.len {
            let k = bucket(self.primitive[at]);
            self.order[self.starts[k] as usize] = at as u32;
            self.starts[k] += 1;
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
        for lane in 0..R::N {
            ids[lane] = self.paths.ids[self.order[at + lane] as usize];
        }
        ids
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

    /// Light from infinity.
    #[inline(always)]
    pub(crate) fn miss<R: Real>(&mut self) {
        let world = self.batch.world;
        let end = self.starts[1] as usize;
        for at in (0..end).step_by(R::N) {
            let (place, mask, ids) = (R::Whole::load(&self.order[at..]), Self::mask::<R>(at, end), self.ids::<R>(at));
            let (origin, direction) = (self.paths.triple(ORIGIN, place), self.paths.triple(DIRECTION, place));
            let throughput = self.paths.triple::<R>(THROUGHPUT, place);
            let pdf = R::gather(&self.paths.rows[PDF], place);
            let (radiance, other) = world.lights.environment_look(origin, direction);
            let weight = R::select(pdf.positive(), self.batch.strategy.weight(false, pdf, other), R::one());
            self.add(mask, throughput * radiance * weight, &ids);
        }
    }

    /// Works hits out.
    #[inline(always)]
    pub(crate) fn vertices<R: Real>(&mut self, group: &Group) {
        let world = self.batch.world;
        let material = &world.materials[group.index];
        let reads_uv = material.reads_uv() || world.emits[group.index];
        for at in (group.from..group.end).step_by(R::N) {
            let place = R::Whole::load(&self.order[at..]);
            let primitive = R::gather_whole(&self.primitive, place);
            let (u, v) = (R::gather(&self.u, place), R::gather(&self.v, place));
            let weights = [R::one() - u - v, u, v];
            let positions = world.table.positions::<R>(primitive);
            let (a, b, c) = (positions[0] * weights[0], positions[1] * weights[1], positions[2] * weights[2]);
            let error = (a.abs() + b.abs() + c.abs()) * R::splat(gamma(7));
            let geometric = world.table.normal::<R>(primitive);
            let mean = world.table.shading(primitive, weights).normalize();
            let shading = Triple::select(mean.some(), mean, geometric);
            let direction = self.paths.triple::<R>(DIRECTION, place);
            let throughput = self.paths.triple::<R>(THROUGHPUT, place);
            let rows = &mut self.vertices;
            rows.put(POINT, at, a + b + c);
            rows.put(ERROR, at, error);
            rows.put(GEOMETRIC, at, geometric);
            rows.put(SHADING, at, shading);
            rows.put(ARRIVED_BY, at, direction);
            rows.put(CARRIES, at, throughput);
            if reads_uv {
                let uv = world.table.uv(primitive, weights);
                uv.x.store(&mut rows.rows[UV][at..]);
                uv.y.store(&mut rows.rows[UV + 1][at..]);
            }
        }
    }

    /// Points of groups with texture coordinates and colours, if the material reads them.
    #[inline(always)]
    fn points<R: Real>(&self, at: usize) -> Points<R> {
        let row = |k: usize| self.vertices.rows[k].as_slice();
        Points {
            uv: Pair::new(R::load(&row(UV)[at..]), R::load(&row(UV + 1)[at..])),
            color: Triple::load([row(COLOR), row(COLOR + 1), row(COLOR + 2)], at),
            alpha: R::load(&row(COLOR + 3)[at..]),
        }
    }

    /// What has no row in the table: spheres and disks, and vertex colours.
    fn bodies(&mut self, group: &Group) {
        let world = self.batch.world;
        let material = &world.materials[group.index];
        let reads_uv = material.reads_uv() || world.emits[group.index];
        let reads_colors = material.reads_colors();
        for at in group.from..group.end {
            let from = self.order[at] as usize;
            let primitive = self.primitive[from] as usize;
            if reads_colors {
                let color = world.color(self.primitive[from], self.u[from], self.v[from]);
                for (k, value) in color.to_array().into_iter().enumerate() {
                    self.vertices.rows[COLOR + k][at] = value;
                }
            }
            if world.table.curved[primitive] == 0 {
                continue;
            }
            let found = world.interaction(&self.ray(from), &self.hit(from), reads_uv);
            for (first, value) in [
                (POINT, found.p),
                (ERROR, found.error),
                (GEOMETRIC, found.geometric),
                (SHADING, found.shading),
                (UV, found.surface.uv.extend(0.0)),
            ] {
                let parts = if first == UV { 2 } else { 3 };
                for k in 0..parts {
                    self.vertices.rows[first + k][at] = value[k];
                }
            }
        }
    }

    fn hit(&self, at: usize) -> Hit {
        Hit { t: self.t[at], u: self.u[at], v: self.v[at], primitive: self.primitive[at] }
    }

    /// Shading normals of a normal map.
    fn map_normals(&mut self, group: &Group) {
        let world = self.batch.world;
        for at in group.from..group.end {
            let from = self.order[at] as usize;
            let hit = self.hit(from);
            let found = world.interaction(&self.ray(from), &hit, true);
            let n = world.shading_frame(&hit, &found).n;
            for k in 0..3 {
                self.vertices.rows[MAPPED + k][at] = n[k];
            }
        }
    }

    /// Emission of what is hit.
    #[inline(always)]
    pub(crate) fn emit<R: Real>(&mut self, group: &Group) {
        let world = self.batch.world;
        for at in (group.from..group.end).step_by(R::N) {
            let (mask, ids) = (Self::mask::<R>(at, group.end), self.ids::<R>(at));
            let place = R::Whole::load(&self.order[at..]);
            let primitive = R::gather_whole(&self.primitive, place);
            let lights = R::gather_whole(&world.table.light, primitive);
            let mut numbers = [DARK; SPARE];
            lights.store(&mut numbers);
            let mut rest = mask & !R::same(lights, R::Whole::splat(DARK as i32));
            while rest.any() {
                let light = numbers[rest.bits().trailing_zeros() as usize % SPARE];
                let own = rest & R::same(lights, R::Whole::splat(light as i32));
                rest = rest & !own;
                let Some(shape) = world.lights.shape(light) else { continue };
                let normal = self.vertices.row::<R>(GEOMETRIC, at);
                let direction = self.vertices.row::<R>(ARRIVED_BY, at);
                let radiance = shape.radiance(&self.points(at), normal, -direction);
                if !(own & radiance.some()).any() {
                    continue;
                }
                let origin = self.paths.triple::<R>(ORIGIN, place);
                let pdf = R::gather(&self.paths.rows[PDF], place);
                let other = world.lights.shape_pdf(light, origin, self.vertices.row(POINT, at), normal);
                let weight = R::select(pdf.positive(), self.batch.strategy.weight(false, pdf, other), R::one());
                self.add(own, self.vertices.row::<R>(CARRIES, at) * radiance * weight, &ids);
            }
        }
    }

    /// Values of a material's textures.
    #[inline(always)]
    pub(crate) fn textures<R: Real>(&mut self, group: &Group) {
        let material = &self.batch.world.materials[group.index];
        if material.sort() == Sort::Blend {
            return;
        }
        for (slot, texture) in material.slots().into_iter().enumerate() {
            let Some(texture) = texture else { continue };
            if matches!(texture, crate::texture::Texture::Constant(_)) {
                continue;
            }
            for at in (group.from..group.end).step_by(R::N) {
                let value = texture.lanes::<R>(&self.points(at));
                self.vertices.put(TEXTURES + 3 * slot, at, value);
            }
        }
    }

    #[inline(always)]
    fn vantage<R: Real>(&self, at: usize) -> Vantage<R> {
        Vantage {
            p: self.vertices.row(POINT, at),
            error: self.vertices.row(ERROR, at),
            normal: self.vertices.row(GEOMETRIC, at),
        }
    }

    #[inline(always)]
    fn states<R: Real>(&self, ids: &[u32; SPARE]) -> [u64; SPARE] {
        let mut states = [0; SPARE];
        for lane in 0..R::N {
            states[lane] = self.batch.paths[ids[lane] as usize].1.state();
        }
        states
    }

    /// Samples a light for each vertex.
    #[inline(always)]
    pub(crate) fn lights<R: Real>(&mut self, group: &Group) {
        let world = self.batch.world;
        let first = Sampler::vertex(group.depth);
        for at in (group.from..group.end).step_by(R::N) {
            let (mask, ids) = (Self::mask::<R>(at, group.end), self.ids::<R>(at));
            let states = self.states::<R>(&ids);
            let numbers = [
                draw::<R>(&states, first + dimension::LIGHT),
                draw::<R>(&states, first + dimension::LIGHT_PART),
                draw::<R>(&states, first + dimension::LIGHT_SPARE),
                draw::<R>(&states, first + dimension::LIGHT_POINT),
            ];
            let arrived = world.lights.sample(world, &self.vantage(at), mask, numbers);
            let rows = &mut self.vertices;
            rows.put(TOWARDS, at, arrived.direction);
            rows.put(SHADOW, at, arrived.origin);
            rows.put(SHADOW + 3, at, arrived.ray);
            arrived.t_max.store(&mut rows.rows[SHADOW + 6][at..]);
            rows.put(WEIGHT, at, arrived.weight.only(arrived.valid));
            arrived.pdf.store(&mut rows.rows[LIGHT_PDF][at..]);
        }
    }

    /// What the light brings, if nothing is in between, and where the paths go on.
    #[inline(always)]
    pub(crate) fn scatter<R: Real, S: Scatter<'a, R>>(&mut self, group: &Group) {
        let world: &'a World = self.batch.world;
        let material: &'a Material = &world.materials[group.index];
        let lit = material.has_smooth() && !world.lights.is_empty();
        let mapped = material.has_normal_map();
        let first = Sampler::vertex(group.depth);
        let slots = material.slots();
        for at in (group.from..group.end).step_by(R::N) {
            let (mask, ids) = (Self::mask::<R>(at, group.end), self.ids::<R>(at));
            let states = self.states::<R>(&ids);
            let shading = self.vertices.row::<R>(SHADING, at);
            let throughput = self.vertices.row::<R>(CARRIES, at);
            let frame = Frames::new(if mapped { self.vertices.row::<R>(MAPPED, at) } else { shading });
            let wo = frame.to_local(-self.vertices.row::<R>(ARRIVED_BY, at));
            let behind = if material.is_two_sided() { wo.z.lt(R::zero()) } else { R::Mask::from_bits(0) };
            let wo = flip(wo, behind);
            let mut values = [Triple::zero(); SLOTS];
            for (slot, value) in values.iter_mut().enumerate() {
                *value = match slots[slot] {
                    None => Triple::zero(),
                    Some(crate::texture::Texture::Constant(value)) => Triple::splat(*value),
                    Some(_) => self.vertices.row(TEXTURES + 3 * slot, at),
                };
            }
            let Some(lobe) = S::of(material, &values, &self.points(at)) else { return };
            if lit {
                let towards = self.vertices.row::<R>(TOWARDS, at);
                let local = frame.to_local(towards);
                let (value, other) = lobe.eval(wo, flip(local, behind));
                let pdf = R::load(&self.vertices.rows[LIGHT_PDF][at..]);
                let own = self.batch.strategy.weight(true, pdf, other);
                let weight = R::select(pdf.positive(), own, R::one());
                let arrives = self.vertices.row::<R>(WEIGHT, at);
                let light = throughput * value * arrives * weight;
                let mut reached = mask & arrives.some() & value.some() & weight.positive();
                if mapped {
                    // A normal map must not carry light through the surface.
                    reached = reached & (towards.dot(shading) * local.z).positive();
                }
                let sound = light.finite();
                self.found.rejected += u64::from((reached & !sound).bits().count_ones());
                let reached = reached & sound;
                if reached.any() {
                    let (o, d) = (self.vertices.row::<R>(SHADOW, at), self.vertices.row::<R>(SHADOW + 3, at));
                    let end = R::load(&self.vertices.rows[SHADOW + 6][at..]);
                    let values = [o.x, o.y, o.z, d.x, d.y, d.z, end, light.x, light.y, light.z];
                    self.shadows.push(reached, values, &ids);
                }
            }
            let choice = draw::<R>(&states, first + dimension::LOBE_AND_ROULETTE);
            let drawn = sound(lobe.sample(wo, choice.x, draw(&states, first + dimension::SCATTER)));
            let mut throughput = throughput * drawn.weight;
            let mut alive = mask & drawn.valid;
            let finite = throughput.finite();
            self.found.rejected += u64::from((alive & !finite).bits().count_ones());
            let local = flip(drawn.wi, behind);
            let wi = frame.to_world(local).normalize();
            alive = alive & finite & throughput.some();
            if mapped {
                alive = alive & (wi.dot(shading) * local.z).positive();
            }
            let place = R::Whole::load(&self.order[at..]);
            let eta = R::gather(&self.paths.rows[ETA], place) * drawn.eta;
            let pdf = R::select(drawn.delta, R::zero(), drawn.pdf);
            if group.depth + 1 >= ROULETTE_FROM {
                let survival = (throughput.largest() * eta * eta).min(R::splat(0.95));
                alive = alive & choice.y.lt(survival);
                throughput = throughput * (R::one() / survival);
            }
            if alive.any() {
                let from = self.vantage::<R>(at);
                let o = offset_origins(from.p, from.error, from.normal, wi);
                let t = throughput;
                self.next.push(alive, [o.x, o.y, o.z, wi.x, wi.y, wi.z, t.x, t.y, t.z, eta, pdf], &ids);
            }
        }
    }

    /// Adds the light of shadow rays that nothing stops.
    #[inline(always)]
    pub(crate) fn shadow<T: Real>(&mut self) {
        let world = self.batch.world;
        let mut stack: Stack = [(0, 0.0); STACK];
        for at in 0..self.shadows.len {
            let (origin, direction) = (self.shadows.vector(0, at), self.shadows.vector(3, at));
            let ray = Ray { origin, direction, t_max: self.shadows.rows[END][at] };
            let mut light = self.shadows.vector(ARRIVES, at);
            if world.features.opacity {
                light *= transmittance(world, ray);
            } else if world.accel.occluded_lanes::<T>(&ray, &mut stack) {
                continue;
            }
            self.found.radiance[self.shadows.ids[at] as usize] += light;
        }
    }
}

#[inline(always)]
fn draw<R: Real>(states: &[u64; SPARE], dimension: u64) -> Pair<R> {
    let (x, y) = R::draw(states, dimension);
    Pair::new(x, y)
}
