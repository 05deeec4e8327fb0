//! Rays of a batch: from the camera, to what they meet, to lights, and out of the scene.

use super::{MISS, Stream, rows::*};
use crate::{
    accel::{Packet, STACK, Set, Stack},
    dispatch::Kernels,
    geometry::Ray,
    integrator::{first_solid, transmittance},
    lanes::{Integer, Mask, Real, Triple},
    rng::FILM,
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
            self.paths.put(ORIGIN, at, origin);
            self.paths.put(DIRECTION, at, direction);
            self.paths.put(THROUGHPUT, at, Triple::all(R::one()));
            R::one().store(&mut self.paths.rows[ETA][at..]);
            R::zero().store(&mut self.paths.rows[PDF][at..]);
        }
        for (at, id) in self.paths.ids[..count].iter_mut().enumerate() {
            *id = at as u32;
        }
        self.paths.len = count;
    }

    /// Nearest hits.
    pub(super) fn meet(&mut self, kernels: &Kernels) {
        let count = self.paths.len;
        self.t[..count].fill(f32::MAX);
        self.primitive[..count].fill(MISS);
        let [ox, oy, oz, dx, dy, dz, ..] = &self.paths.rows;
        let mut set = Set {
            origin: [ox, oy, oz],
            direction: [dx, dy, dz],
            t: &mut self.t,
            u: &mut self.u,
            v: &mut self.v,
            primitive: &mut self.primitive,
        };
        kernels.nearest(&self.batch.world.accel, &mut set, count, &mut self.sweep);
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
        let len = self.paths.len;
        for at in (0..len).step_by(R::N) {
            let count = R::N.min(len - at);
            let mask = R::Mask::from_bits(u32::MAX >> (32 - count));
            let (origin, direction) = (self.paths.row::<R>(ORIGIN, at), self.paths.row::<R>(DIRECTION, at));
            let Some(packet) = Packet::new(origin, direction, mask) else {
                self.meet_one_by_one::<T>(at, at + count);
                continue;
            };
            let hits = self.batch.world.accel.closest_packet::<R, T>(&packet, mask, &mut stack);
            hits.t.store(&mut self.t[at..]);
            hits.u.store(&mut self.u[at..]);
            hits.v.store(&mut self.v[at..]);
            hits.primitive.store(&mut self.primitive[at..]);
        }
    }

    /// The first hits that do not let their rays pass.
    pub(super) fn meet_through(&mut self, depth: u32) {
        for at in 0..self.paths.len {
            let ray = self.ray(at);
            let sampler = self.batch.paths[self.paths.ids[at] as usize].1;
            let hit = first_solid(self.batch.world, &sampler, depth, ray).map(|(hit, _)| hit);
            self.note(at, hit);
        }
    }

    /// Light from infinity.
    #[inline(always)]
    pub(crate) fn miss<R: Real>(&mut self) {
        let world = self.batch.world;
        let end = self.starts[1] as usize;
        for at in (0..end).step_by(R::N) {
            let (place, mask, ids) = (R::Integer::load(&self.order[at..]), Self::mask::<R>(at, end), self.ids::<R>(at));
            let (origin, direction) = (self.paths.triple(ORIGIN, place), self.paths.triple(DIRECTION, place));
            let throughput = self.paths.triple::<R>(THROUGHPUT, place);
            let pdf = R::gather(&self.paths.rows[PDF], place);
            let (radiance, other) = world.lights.environment_look(origin, direction);
            let weight = R::select(pdf.positive(), self.batch.strategy.weight(false, pdf, other), R::one());
            self.add(mask & self.counts(pdf), throughput * radiance * weight, &ids);
        }
    }

    /// Adds the light of shadow rays that nothing stops.
    pub(super) fn shadow(&mut self, kernels: &Kernels) {
        let world = self.batch.world;
        let count = self.shadows.len;
        if !world.features.opacity {
            let [ox, oy, oz, dx, dy, dz, end, ..] = &mut self.shadows.rows;
            let mut set = Set {
                origin: [ox, oy, oz],
                direction: [dx, dy, dz],
                t: end,
                u: &mut self.u,
                v: &mut self.v,
                primitive: &mut self.primitive,
            };
            kernels.stopped(&world.accel, &mut set, count, &mut self.sweep);
        }
        for at in 0..count {
            let mut light = self.shadows.vector(ARRIVES, at);
            if world.features.opacity {
                let (origin, direction) = (self.shadows.vector(0, at), self.shadows.vector(3, at));
                light *= transmittance(world, Ray { origin, direction, t_max: self.shadows.rows[END][at] });
            } else if self.shadows.rows[END][at] < 0.0 {
                continue;
            }
            self.found.radiance[self.shadows.ids[at] as usize] += light;
        }
    }
}
