//! The vertices of the paths that meet a material: positions, frames, textures and emission.

use super::{Group, Stream, rows::*, scattering::against};
use crate::{
    accel::Hit,
    bsdf::{Points, Sort},
    geometry::{Disk, Frames, gamma},
    integrator::Strategy,
    lanes::{Integer, Mask, Pair, Real, Triple},
    surface::{Form, IN_WORLD},
    table::{DARK, DISK, SPHERE, TURNED},
    texture::Texture,
};

impl Stream<'_> {
    /// Works hits out.
    #[inline(always)]
    pub(crate) fn vertices<R: Real>(&mut self, group: &Group) {
        let world = self.batch.world;
        let used = &world.materials[group.index];
        let (reads_uv, bodies, shared) = (used.reads_uv(), used.bodies, used.shared);
        for at in (group.from..group.end).step_by(R::N) {
            let row = at - group.from;
            let place = R::Integer::load(&self.scratch.order[at..]);
            let primitive = R::gather_integer(&self.scratch.primitive, place);
            let shape = R::gather_integer(&self.scratch.shape, place);
            let (u, v) = (R::gather(&self.scratch.u, place), R::gather(&self.scratch.v, place));
            let mut weights = [R::one() - u - v, u, v];
            let (mut disks, mut spheres) = (R::Mask::from_bits(0), R::Mask::from_bits(0));
            if bodies {
                let form = R::gather_integer(&world.form_of, shape);
                disks = R::same(form, R::Integer::splat(DISK as i32));
                spheres = R::same(form, R::Integer::splat(SPHERE as i32));
                weights[0] = R::select(disks, R::one(), weights[0]);
            }
            let facts = world.table.facts::<R>(primitive);
            let positions = facts.positions;
            let (a, b, c) = (positions[0] * weights[0], positions[1] * weights[1], positions[2] * weights[2]);
            let mut p = a + b + c;
            let mut error = (a.abs() + b.abs() + c.abs()) * R::splat(gamma(7));
            let mut geometric = facts.normal;
            let mut mean = facts.shading(weights);
            if shared {
                let number = R::gather_integer(&world.placed_of, shape);
                let own = !R::same(number, R::Integer::splat(IN_WORLD as i32));
                if own.any() {
                    let placed = world.accel.placements().placed::<R>(number);
                    let form = R::gather_integer(&world.form_of, shape);
                    let round = R::same(form, R::Integer::splat(TURNED as i32));
                    let turned = R::select(round, -R::one(), R::one());
                    let (point, known) = placed.point(p, error);
                    p = Triple::select(own, point, p);
                    error = Triple::select(own, known, error);
                    geometric = Triple::select(own, placed.normal(geometric) * turned, geometric);
                    let [a, b, c] = facts.normals;
                    let (a, b, c) = (placed.normal(a), placed.normal(b), placed.normal(c));
                    let between = (a * weights[0] + b * weights[1] + c * weights[2]) * turned;
                    mean = Triple::select(own, between, mean);
                }
            }
            let mean = mean.normalize();
            let mut shading = Triple::select(mean.some() & !disks, mean, geometric);
            let direction = self.scratch.paths.triple::<R>(DIRECTION, place);
            let throughput = self.scratch.paths.triple::<R>(THROUGHPUT, place);
            if spheres.any() {
                let t = R::gather(&self.scratch.t, place);
                let met = self.scratch.paths.triple::<R>(ORIGIN, place) + direction * t;
                let (center, radius, side) = (positions[0], positions[1].x, positions[1].y);
                let n = (met - center).normalize();
                let arm = n * radius;
                let own = arm.abs() * R::splat(gamma(6)) + (center.abs() + arm.abs()) * R::splat(gamma(2));
                p = Triple::select(spheres, center + arm, p);
                error = Triple::select(spheres, own, error);
                geometric = Triple::select(spheres, n * side, geometric);
                shading = Triple::select(spheres, geometric, shading);
            }
            let rows = &mut self.scratch.vertices;
            rows.put(POINT, row, p);
            rows.put(ERROR, row, error);
            rows.put(GEOMETRIC, row, geometric);
            rows.put(SHADING, row, shading);
            rows.put(ARRIVED_BY, row, direction);
            rows.put(CARRIES, row, throughput);
            if reads_uv {
                let uv = facts.uv(weights);
                uv.x.store(&mut rows.rows[UV][row..]);
                uv.y.store(&mut rows.rows[UV + 1][row..]);
            }
        }
    }

    /// Points of groups with texture coordinates and colours, if the material reads them.
    #[inline(always)]
    pub(super) fn points<R: Real>(&self, row: usize) -> Points<R> {
        let rows = &self.scratch.vertices.rows;
        Points {
            uv: Pair::new(R::load(&rows[UV][row..]), R::load(&rows[UV + 1][row..])),
            color: self.scratch.vertices.row(COLOR, row),
            alpha: R::load(&rows[COLOR + 3][row..]),
        }
    }

    /// Texture coordinates of spheres and disks.
    #[inline(always)]
    pub(crate) fn bodies<R: Real>(&mut self, group: &Group) {
        let world = self.batch.world;
        for at in (group.from..group.end).step_by(R::N) {
            let row = at - group.from;
            let place = R::Integer::load(&self.scratch.order[at..]);
            let shape = R::gather_integer(&self.scratch.shape, place);
            let form = R::gather_integer(&world.form_of, shape);
            let body = R::same(form, R::Integer::splat(DISK as i32)) | R::same(form, R::Integer::splat(SPHERE as i32));
            let mut rest = Self::mask::<R>(at, group.end) & body;
            let mut shapes = [0; SPARE];
            shape.store(&mut shapes);
            while rest.any() {
                let one = shapes[rest.bits().trailing_zeros() as usize % SPARE];
                let own = rest & R::same(shape, R::Integer::splat(one as i32));
                rest = rest & !own;
                let uv = match &world.shapes[one as usize].form {
                    Form::Sphere(sphere) => {
                        let outer = self.scratch.vertices.row::<R>(POINT, row) - Triple::splat(sphere.center);
                        sphere.uv_lanes(outer.normalize())
                    }
                    Form::Disk(_) => {
                        Disk::uv_lanes(R::gather(&self.scratch.u, place), R::gather(&self.scratch.v, place))
                    }
                    Form::Mesh(_) => continue,
                };
                let rows = &mut self.scratch.vertices.rows;
                for (to, value) in [(UV, uv.x), (UV + 1, uv.y)] {
                    R::select(own, value, R::load(&rows[to][row..])).store(&mut rows[to][row..]);
                }
            }
        }
    }

    /// Vertex colours.
    pub(super) fn colors(&mut self, group: &Group) {
        let world = self.batch.world;
        for at in group.from..group.end {
            let row = at - group.from;
            let from = self.scratch.order[at] as usize;
            let color = world.color(
                self.scratch.shape[from],
                self.scratch.primitive[from],
                self.scratch.u[from],
                self.scratch.v[from],
            );
            for (k, value) in color.to_array().into_iter().enumerate() {
                self.scratch.vertices.rows[COLOR + k][row] = value;
            }
        }
    }

    pub(super) fn hit(&self, at: usize) -> Hit {
        Hit {
            t: self.scratch.t[at],
            u: self.scratch.u[at],
            v: self.scratch.v[at],
            primitive: self.scratch.primitive[at],
        }
    }

    /// Shading normals of a normal map on triangles without tangents of their own, as those of
    /// [`World::shading_frame`](crate::world::World::shading_frame). Rows of other shapes mean nothing.
    #[inline(always)]
    pub(crate) fn normal_maps<R: Real>(&mut self, group: &Group) {
        let world = self.batch.world;
        let used = &world.materials[group.index];
        let Some(map) = used.normal_map_by_lane() else { return };
        for at in (group.from..group.end).step_by(R::N) {
            let row = at - group.from;
            let place = R::Integer::load(&self.scratch.order[at..]);
            let facts = world.table.facts::<R>(R::gather_integer(&self.scratch.primitive, place));
            let [p0, p1, p2] = facts.positions;
            let (mut q1, mut q2) = (p1 - p0, p2 - p0);
            if used.shared {
                let number = R::gather_integer(&world.placed_of, R::gather_integer(&self.scratch.shape, place));
                let own = !R::same(number, R::Integer::splat(IN_WORLD as i32));
                if own.any() {
                    let placed = world.accel.placements().placed::<R>(number);
                    q1 = Triple::select(own, placed.vector(q1), q1);
                    q2 = Triple::select(own, placed.vector(q2), q2);
                }
            }
            let (geometric, shading) =
                (self.scratch.vertices.row::<R>(GEOMETRIC, row), self.scratch.vertices.row::<R>(SHADING, row));
            let n = Triple::select(facts.flat, geometric, shading);
            let [a, b, c] = facts.uvs();
            let (d1, d2) = (Pair::new(b.x - a.x, b.y - a.y), Pair::new(c.x - a.x, c.y - a.y));
            let det = d1.x * d2.y - d1.y * d2.x;
            let sign = R::select(det.equals(det), R::one().copysign(det), det);
            let dp_du = (q1 * d2.y - q2 * d1.y) * sign;
            let dp_dv = (q2 * d1.x - q1 * d2.x) * sign;
            // v points down in images, so up is against dp/dv.
            let up = R::select(n.cross(dp_du).dot(dp_dv).gt(R::zero()), -R::one(), R::one());
            let along = dp_du - n * n.dot(dp_du);
            let known = along.dot(along).gt(R::splat(1e-20)) & along.finite() & !facts.bare;
            let s = along.normalize();
            let (any, map_frame) = (Frames::new(n), Frames::of(s, n.cross(s) * up, n));
            let local = map.normals(&self.points::<R>(row));
            let made = Triple::select(known, map_frame.to_world(local), any.to_world(local)).normalize();
            self.scratch.vertices.put(MAPPED, row, Triple::select(made.some(), made, n));
        }
    }

    /// Shading frames of a normal map, a bump map, or a roughness that depends on the direction.
    pub(super) fn own_frames(&mut self, group: &Group) {
        for at in group.from..group.end {
            self.own_frame(at, at - group.from);
        }
    }

    /// The same of spheres and disks alone.
    pub(super) fn frames_of_bodies(&mut self, group: &Group) {
        for at in group.from..group.end {
            let shape = self.scratch.shape[self.scratch.order[at] as usize];
            if !matches!(self.batch.world.shapes[shape as usize].form, Form::Mesh(_)) {
                self.own_frame(at, at - group.from);
            }
        }
    }

    fn own_frame(&mut self, at: usize, row: usize) {
        let world = self.batch.world;
        let from = self.scratch.order[at] as usize;
        let (hit, ray) = (self.hit(from), self.ray(from));
        let found = world.interaction_at(&ray, &hit, (self.scratch.shape[from], hit.primitive));
        let frame = world.shading_frame(&hit, hit.primitive, &found, -ray.direction);
        for k in 0..3 {
            self.scratch.vertices.rows[MAPPED + k][row] = frame.n[k];
            self.scratch.vertices.rows[ALONG + k][row] = frame.s[k];
        }
    }

    /// Emission of what is hit.
    #[inline(always)]
    pub(crate) fn emit<R: Real>(&mut self, group: &Group) {
        let world = self.batch.world;
        for at in (group.from..group.end).step_by(R::N) {
            let row = at - group.from;
            let (mask, ids) = (Self::mask::<R>(at, group.end), self.ids::<R>(at));
            let place = R::Integer::load(&self.scratch.order[at..]);
            let lights = R::gather_integer(&world.light_of, R::gather_integer(&self.scratch.shape, place));
            let mut numbers = [DARK; SPARE];
            lights.store(&mut numbers);
            let mut rest = mask & !R::same(lights, R::Integer::splat(DARK as i32));
            while rest.any() {
                let light = numbers[rest.bits().trailing_zeros() as usize % SPARE];
                let own = rest & R::same(lights, R::Integer::splat(light as i32));
                rest = rest & !own;
                let Some(shape) = world.lights.shape(light) else { continue };
                let normal = self.scratch.vertices.row::<R>(GEOMETRIC, row);
                let direction = self.scratch.vertices.row::<R>(ARRIVED_BY, row);
                let radiance = shape.radiance(&self.points(row), normal, -direction);
                if !(own & radiance.some()).any() {
                    continue;
                }
                let origin = self.scratch.paths.triple::<R>(ORIGIN, place);
                let pdf = R::gather(&self.scratch.paths.rows[PDF], place);
                let from = (origin, R::gather(&self.scratch.paths.rows[CELL], place));
                let other = world.lights.shape_pdf(light, from, self.scratch.vertices.row(POINT, row), normal);
                let mut weight =
                    R::select(pdf.positive(), self.batch.path.strategy.weight(false, pdf, other), R::one());
                if let Some(plan) = self.batch.light_paths
                    && group.depth > 1
                {
                    let point = self.scratch.vertices.row(POINT, row);
                    let theirs = plan.aims.of_shape(&world.lights, light, point, normal, -direction);
                    weight = self.against_light_paths(place, weight, theirs * plan.count as f32);
                }
                let own = own & self.counts(pdf);
                self.add(own & radiance.some(), self.scratch.vertices.row::<R>(CARRIES, row) * radiance * weight, &ids);
            }
        }
    }

    /// Lanes whose light counts, by the density of the last scattering.
    #[inline(always)]
    pub(super) fn counts<R: Real>(&self, pdf: R) -> R::Mask {
        if self.batch.path.strategy == Strategy::Caustics { pdf.lt(R::zero()) } else { !R::Mask::from_bits(0) }
    }

    /// Weights of paths that met a light, now also against light paths, with these densities times their number.
    #[inline(always)]
    pub(super) fn against_light_paths<R: Real>(&self, place: R::Integer, weight: R, theirs: R) -> R {
        let own = R::gather(&self.scratch.rivals.rows[0], place);
        against(weight, theirs / own, own.positive())
    }

    /// Values of a material's textures.
    #[inline(always)]
    pub(crate) fn textures<R: Real>(&mut self, group: &Group) {
        let material = &self.batch.world.materials[group.index].material;
        if material.kernel() == Sort::Blend {
            return;
        }
        for (slot, texture) in material.slots().into_iter().enumerate() {
            let Some(texture) = texture else { continue };
            if matches!(texture, Texture::Constant(_)) {
                continue;
            }
            for at in (group.from..group.end).step_by(R::N) {
                let row = at - group.from;
                let value = texture.lanes::<R>(&self.points(row));
                self.scratch.vertices.put(TEXTURES + 3 * slot, row, value);
            }
        }
    }
}
