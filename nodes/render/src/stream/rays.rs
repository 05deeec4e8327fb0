//! Rays of a batch: from the camera, to what they meet, to lights, and out of the scene.

use super::{Group, MISS, Stream, rows::*};
use crate::{
    accel::{Hit, Packet, STACK, Set, Stack, Sweep},
    dispatch::Kernels,
    geometry::Ray,
    integrator::{Dimmed, PASSAGES, Passage, met},
    lanes::{Integer, Mask, Real, Triple},
    rng::{FILM, Sampler},
    world::World,
};

impl Stream<'_> {
    /// Camera rays.
    #[inline(always)]
    pub(crate) fn begin<R: Real>(&mut self) {
        let count = self.batch.paths.len();
        for at in (0..count).step_by(R::N) {
            let (mut states, mut x, mut y) = ([0; SPARE], [0.0; SPARE], [0.0; SPARE]);
            for (lane, (pixel, sampler)) in self.batch.paths[at..].iter().take(R::N).enumerate() {
                states[lane] = sampler.state();
                (x[lane], y[lane]) = (pixel.0 as f32, pixel.1 as f32);
            }
            let jitter = self.draw::<R>(&states, FILM);
            let (origin, direction) = self.batch.camera.rays(R::load(&x) + jitter.x, R::load(&y) + jitter.y);
            self.scratch.paths.put(ORIGIN, at, origin);
            self.scratch.paths.put(DIRECTION, at, direction);
            self.scratch.paths.put(THROUGHPUT, at, Triple::all(R::one()));
            R::one().store(&mut self.scratch.paths.rows[ETA][at..]);
            R::zero().store(&mut self.scratch.paths.rows[PDF][at..]);
            R::zero().store(&mut self.scratch.paths.rows[CELL][at..]);
        }
        for (at, id) in self.scratch.paths.ids[..count].iter_mut().enumerate() {
            *id = at as u32;
        }
        self.scratch.paths.len = count;
        if self.batch.light_paths.is_some() {
            // Those of the batch before are still there.
            self.scratch.rivals.rows[0][..count].fill(0.0);
        }
    }

    /// Nearest hits.
    pub(super) fn meet(&mut self, kernels: &Kernels) {
        let count = self.scratch.paths.len;
        self.scratch.t[..count].fill(f32::MAX);
        self.scratch.primitive[..count].fill(MISS);
        let [ox, oy, oz, dx, dy, dz, ..] = &self.scratch.paths.rows;
        let mut set = Set {
            origin: [ox, oy, oz],
            direction: [dx, dy, dz],
            t: &mut self.scratch.t,
            u: &mut self.scratch.u,
            v: &mut self.scratch.v,
            primitive: &mut self.scratch.primitive,
        };
        kernels.nearest(&self.batch.world.accel, &mut set, count, &mut self.scratch.sweep);
    }

    /// Nearest hits of some, ray by ray.
    #[inline(always)]
    fn meet_one_by_one<T: Real>(&mut self, from: usize, to: usize) {
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
        let len = self.scratch.paths.len;
        for at in (0..len).step_by(R::N) {
            let count = R::N.min(len - at);
            let mask = R::Mask::from_bits(u32::MAX >> (32 - count));
            let (origin, direction) =
                (self.scratch.paths.row::<R>(ORIGIN, at), self.scratch.paths.row::<R>(DIRECTION, at));
            let Some(packet) = Packet::new(origin, direction, mask) else {
                self.meet_one_by_one::<T>(at, at + count);
                continue;
            };
            let hits = self.batch.world.accel.closest_packet::<R, T>(&packet, mask, &mut stack);
            hits.t.store(&mut self.scratch.t[at..]);
            hits.u.store(&mut self.scratch.u[at..]);
            hits.v.store(&mut self.scratch.v[at..]);
            hits.primitive.store(&mut self.scratch.primitive[at..]);
        }
    }

    /// The first hits that do not let their rays pass: all rays are met together, and those that pass are met again.
    pub(super) fn meet_through(&mut self, kernels: &Kernels, depth: u32) {
        if depth == 0 {
            kernels.meet_packets(self);
        } else {
            self.meet(kernels);
        }
        let mut through = std::mem::take(&mut self.scratch.through);
        let world = self.batch.world;
        through.begin(self.scratch.paths.len);
        for at in 0..self.scratch.paths.len {
            if self.scratch.primitive[at] == MISS {
                continue;
            }
            let ray = self.ray(at);
            match met(world, self.sampler(at), depth, 0, (&ray, &ray), self.hit(at)) {
                Passage::Solid(hit) => self.note(at, Some(hit)),
                Passage::Through(origin) => through.push(&Ray { origin, ..ray }, 1.0, at as u32),
            }
        }
        for passage in 1..PASSAGES {
            if through.rays.len == 0 {
                break;
            }
            through.meet(world, kernels, &mut self.scratch.sweep);
            for at in through.take() {
                let path = through.rays.ids[at] as usize;
                let Some(hit) = through.hit(at) else {
                    self.note(path, None);
                    continue;
                };
                let rest = through.ray(at);
                match met(world, self.sampler(path), depth, passage, (&self.ray(path), &rest), hit) {
                    Passage::Solid(hit) => self.note(path, Some(hit)),
                    Passage::Through(origin) => through.push(&Ray { origin, ..rest }, 1.0, path as u32),
                }
            }
        }
        for at in through.take() {
            self.note(through.rays.ids[at] as usize, None);
        }
        self.scratch.through = through;
    }

    fn sampler(&self, at: usize) -> &Sampler {
        &self.batch.paths[self.scratch.paths.ids[at] as usize].1
    }

    /// Light from infinity.
    #[inline(always)]
    pub(crate) fn miss<R: Real>(&mut self, group: &Group) {
        let world = self.batch.world;
        for at in (group.from..group.end).step_by(R::N) {
            let (place, mask, ids) =
                (R::Integer::load(&self.scratch.order[at..]), Self::mask::<R>(at, group.end), self.ids::<R>(at));
            let (origin, direction) =
                (self.scratch.paths.triple(ORIGIN, place), self.scratch.paths.triple(DIRECTION, place));
            let throughput = self.scratch.paths.triple::<R>(THROUGHPUT, place);
            let pdf = R::gather(&self.scratch.paths.rows[PDF], place);
            let cell = R::gather(&self.scratch.paths.rows[CELL], place);
            let (radiance, other) = world.lights.environment_look((origin, cell), direction);
            let mut weight = R::select(pdf.positive(), self.batch.path.strategy.weight(false, pdf, other), R::one());
            if let Some(plan) = self.batch.light_paths
                && group.depth > 1
            {
                let theirs = world.lights.sky_emits(&plan.aims, origin, direction) * plan.count as f32;
                weight = self.against_light_paths(place, weight, theirs);
            }
            self.add(mask & self.counts(pdf), throughput * radiance * weight, &ids);
        }
    }

    /// Adds the light of shadow rays that nothing stops.
    pub(crate) fn shadow(&mut self, kernels: &Kernels) {
        let world = self.batch.world;
        let count = self.scratch.shadows.len;
        if !world.features.opacity {
            let [ox, oy, oz, dx, dy, dz, end, ..] = &mut self.scratch.shadows.rows;
            let mut set = Set {
                origin: [ox, oy, oz],
                direction: [dx, dy, dz],
                t: end,
                u: &mut self.scratch.u,
                v: &mut self.scratch.v,
                primitive: &mut self.scratch.primitive,
            };
            kernels.stopped(&world.accel, &mut set, count, &mut self.scratch.sweep);
        }
        if world.features.opacity {
            self.shadow_through(kernels);
        }
        for at in 0..count {
            if self.scratch.shadows.rows[END][at] < 0.0 {
                continue;
            }
            let light = self.scratch.shadows.vector(ARRIVES, at);
            self.found.radiance[self.scratch.shadows.ids[at] as usize] += light;
        }
    }

    /// Dims the light of shadow rays by what they go through; those that nothing is left of end below 0.
    fn shadow_through(&mut self, kernels: &Kernels) {
        let world = self.batch.world;
        let mut through = std::mem::take(&mut self.scratch.through);
        through.begin(self.scratch.shadows.len);
        for at in 0..self.scratch.shadows.len {
            let (origin, direction) = (self.scratch.shadows.vector(0, at), self.scratch.shadows.vector(3, at));
            through.push(&Ray { origin, direction, t_max: self.scratch.shadows.rows[END][at] }, 1.0, at as u32);
        }
        for passage in 0..=PASSAGES {
            if through.rays.len == 0 {
                break;
            }
            through.meet(world, kernels, &mut self.scratch.sweep);
            for at in through.take() {
                let id = through.rays.ids[at];
                let mut rest = Dimmed { ray: through.ray(at), share: through.rays.rows[SHARE][at] };
                if let Some(hit) = through.hit(at) {
                    let goes_on = rest.pass(world, &hit);
                    if passage == PASSAGES {
                        rest.share = 0.0;
                    } else if goes_on {
                        through.push(&rest.ray, rest.share, id);
                        continue;
                    }
                }
                let id = id as usize;
                if rest.share <= 0.0 {
                    self.scratch.shadows.rows[END][id] = -1.0;
                }
                for row in &mut self.scratch.shadows.rows[ARRIVES..ARRIVES + 3] {
                    row[id] *= rest.share;
                }
            }
        }
        self.scratch.through = through;
    }
}

/// Rays that go on through surfaces, and what they meet next. Rays that are taken make room for those pushed meanwhile.
#[derive(Default)]
pub(super) struct Passing {
    rays: Through,
    t: Vec<f32>,
    u: Vec<f32>,
    v: Vec<f32>,
    primitive: Vec<u32>,
}

impl Passing {
    /// No rays, and room for so many.
    fn begin(&mut self, room: usize) {
        self.rays.reserve(room);
        self.rays.len = 0;
        let room = room + SPARE;
        if self.t.len() < room {
            for row in [&mut self.t, &mut self.u, &mut self.v] {
                row.resize(room, 0.0);
            }
            self.primitive.resize(room, MISS);
        }
    }

    /// Adds a ray: no more than were taken before.
    fn push(&mut self, ray: &Ray, share: f32, id: u32) {
        let (o, d) = (ray.origin, ray.direction);
        self.rays.set(self.rays.len, [o.x, o.y, o.z, d.x, d.y, d.z, ray.t_max, share], id);
        self.rays.len += 1;
    }

    /// The places of all rays, each to be read before the next ray is pushed.
    fn take(&mut self) -> std::ops::Range<usize> {
        0..std::mem::take(&mut self.rays.len)
    }

    fn ray(&self, at: usize) -> Ray {
        Ray { origin: self.rays.vector(0, at), direction: self.rays.vector(3, at), t_max: self.rays.rows[END][at] }
    }

    fn hit(&self, at: usize) -> Option<Hit> {
        let primitive = self.primitive[at];
        (primitive != MISS).then(|| Hit { t: self.t[at], u: self.u[at], v: self.v[at], primitive })
    }

    /// Nearest hits.
    fn meet(&mut self, world: &World, kernels: &Kernels, sweep: &mut Sweep) {
        let count = self.rays.len;
        let [ox, oy, oz, dx, dy, dz, end, _] = &self.rays.rows;
        self.t[..count].copy_from_slice(&end[..count]);
        self.primitive[..count].fill(MISS);
        let mut set = Set {
            origin: [ox, oy, oz],
            direction: [dx, dy, dz],
            t: &mut self.t,
            u: &mut self.u,
            v: &mut self.v,
            primitive: &mut self.primitive,
        };
        kernels.nearest(&world.accel, &mut set, count, sweep);
    }
}
