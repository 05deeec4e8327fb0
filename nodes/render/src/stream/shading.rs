//! Shading of the paths that meet a material.

use super::{Group, Stream, rows::*};
use crate::{
    accel::Hit,
    bsdf::{Material, Points, SLOTS, Scatter, Sort, flip, sound},
    geometry::{Disk, Frames, gamma, offset_origins},
    integrator::{Strategy, dimension},
    lanes::{Integer, Mask, Pair, Real, Triple},
    lights::{Choice, Vantage},
    rng::Sampler,
    surface::{Form, IN_WORLD},
    table::{DARK, DISK, SPHERE, TURNED},
    texture::Texture,
    world::World,
};

/// Candidates where there are several. More, and on later vertices, cost more time than they save.
const CANDIDATES: u64 = 2;

/// The mirror image in a surface, in some lanes.
#[derive(Clone, Copy)]
struct Mirror<R: Real> {
    normal: Triple<R>,
    mask: R::Mask,
}

impl<R: Real> Mirror<R> {
    #[inline(always)]
    fn none(normal: Triple<R>) -> Self {
        Self { normal, mask: R::Mask::from_bits(0) }
    }

    /// That in surfaces of which the viewer sees the back.
    #[inline(always)]
    fn behind(normal: Triple<R>, viewer: Triple<R>) -> Self {
        Self { normal, mask: viewer.dot(normal).lt(R::zero()) }
    }

    #[inline(always)]
    fn of(&self, v: Triple<R>) -> Triple<R> {
        if !self.mask.any() {
            return v;
        }
        Triple::select(self.mask, v - self.normal * (v.dot(self.normal) * 2.0), v)
    }
}

/// The shadowing of light at grazing incidence on a mapped normal.
///
/// Source: Estevez et al. 2019, *A Microfacet-Based Shadowing Function to Solve the Bump Terminator Problem*; it is the
/// `use_shadowing_function` of Mitsuba 3.
#[derive(Clone, Copy)]
struct Shadowing<R> {
    normal: Triple<R>,
    /// Squared roughness of facets as tilted as the mapped normal.
    alpha2: R,
}

impl<R: Real> Shadowing<R> {
    #[inline(always)]
    fn of(mapped: Triple<R>, normal: Triple<R>) -> Self {
        Self { normal, alpha2: (squared_tangent(mapped.dot(normal)) * 0.125).min(R::one()) }
    }

    /// Share of the light from a direction that is left.
    #[inline(always)]
    fn at(&self, wi: Triple<R>) -> R {
        R::splat(2.0) / ((self.alpha2 * squared_tangent(wi.dot(self.normal)) + 1.0).sqrt() + 1.0)
    }
}

/// Squared tangent of an angle by its cosine.
#[inline(always)]
fn squared_tangent<R: Real>(cos: R) -> R {
    let square = cos * cos;
    (R::one() - square).max(R::zero()) / square.max(R::splat(1e-20))
}

impl<'a> Stream<'a> {
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
    fn points<R: Real>(&self, row: usize) -> Points<R> {
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

    /// Shading frames of a normal map, a bump map, or a roughness that depends on the direction.
    pub(super) fn map_normals(&mut self, group: &Group) {
        let world = self.batch.world;
        for at in group.from..group.end {
            let row = at - group.from;
            let from = self.scratch.order[at] as usize;
            let hit = self.hit(from);
            let ray = self.ray(from);
            let found = world.interaction_at(&ray, &hit, (self.scratch.shape[from], hit.primitive));
            let frame = world.shading_frame(&hit, hit.primitive, &found, -ray.direction);
            for k in 0..3 {
                self.scratch.vertices.rows[MAPPED + k][row] = frame.n[k];
                self.scratch.vertices.rows[ALONG + k][row] = frame.s[k];
            }
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
                let other = world.lights.shape_pdf(light, origin, self.scratch.vertices.row(POINT, row), normal);
                let mut weight =
                    R::select(pdf.positive(), self.batch.path.strategy.weight(false, pdf, other), R::one());
                if let Some(count) = self.batch.light_paths {
                    weight *= self.against_light_paths(place, pdf, R::splat(world.lights.emits(light) * count));
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

    /// Weights of paths against light paths that find the same light, with these densities times their number. They do
    /// where a path has left the first surface into a chain of specular ones, and the chain ends at the light.
    #[inline(always)]
    pub(super) fn against_light_paths<R: Real>(&self, place: R::Integer, pdf: R, theirs: R) -> R {
        let own = R::gather(&self.scratch.rivals.rows[0], place);
        let ratio = theirs / own;
        let weight = R::one() / (ratio * ratio + 1.0);
        R::select(own.positive() & !pdf.positive(), weight, R::one())
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

    #[inline(always)]
    fn vantage<R: Real>(&self, row: usize) -> Vantage<R> {
        Vantage {
            p: self.scratch.vertices.row(POINT, row),
            error: self.scratch.vertices.row(ERROR, row),
            normal: self.scratch.vertices.row(GEOMETRIC, row),
        }
    }

    #[inline(always)]
    fn states<R: Real>(&self, ids: &[u32; SPARE]) -> [u64; SPARE] {
        let mut states = [0; SPARE];
        for (state, id) in states[..R::N].iter_mut().zip(ids) {
            *state = self.batch.paths[*id as usize].1.state();
        }
        states
    }

    /// Whether lights are sampled at a material. Their contribution is not a caustic.
    pub(super) fn samples_lights(&self, material: &Material) -> bool {
        material.has_smooth() && !self.batch.world.lights.is_empty() && self.batch.path.strategy != Strategy::Caustics
    }

    /// Among how many samples of lights one is chosen for each vertex: where the camera looks, the choice between the
    /// sky and lamps is worth a second one.
    fn candidates(&self, group: &Group) -> u64 {
        let world = self.batch.world;
        let broad = matches!(world.materials[group.index].material.sort(), Sort::Diffuse | Sort::Plastic);
        if broad && group.depth == 0 && world.lights.mixed() { CANDIDATES } else { 1 }
    }

    /// Samples a light for each vertex.
    #[inline(always)]
    pub(crate) fn lights<R: Real>(&mut self, group: &Group) {
        let world = self.batch.world;
        let normals = if world.materials[group.index].material.has_own_frame() { MAPPED } else { SHADING };
        let mirrored = world.materials[group.index].material.is_mirrored();
        let candidates = self.candidates(group);
        let first = Sampler::vertex(group.depth);
        for at in (group.from..group.end).step_by(R::N) {
            let row = at - group.from;
            let (mask, ids) = (Self::mask::<R>(at, group.end), self.ids::<R>(at));
            let states = self.states::<R>(&ids);
            let vantage = self.vantage(row);
            let mut normal = self.scratch.vertices.row::<R>(normals, row);
            let arrived_by = self.scratch.vertices.row::<R>(ARRIVED_BY, row);
            if mirrored {
                normal = Mirror::behind(self.scratch.vertices.row(SHADING, row), -arrived_by).of(normal);
            }
            let normal = normal * R::one().copysign(-normal.dot(arrived_by));
            let mut choice = Choice::new();
            for candidate in 0..candidates {
                let first = first + dimension::candidate(candidate);
                let numbers = [
                    self.draw::<R>(&states, first + dimension::LIGHT),
                    self.draw::<R>(&states, first + dimension::LIGHT_PART),
                    self.draw::<R>(&states, first + dimension::LIGHT_SPARE),
                    self.draw::<R>(&states, first + dimension::LIGHT_POINT),
                ];
                let arrived = world.lights.sample(world, &vantage, mask, numbers);
                if candidates == 1 {
                    choice.only(arrived);
                } else {
                    choice.consider(arrived, normal, self.draw::<R>(&states, first + dimension::CANDIDATE).x);
                }
            }
            self.found.rejected += choice.rejected();
            let arrived = choice.made(candidates);
            let rows = &mut self.scratch.vertices;
            rows.put(TOWARDS, row, arrived.direction);
            rows.put(SHADOW, row, arrived.origin);
            rows.put(SHADOW + 3, row, arrived.ray);
            arrived.t_max.store(&mut rows.rows[SHADOW + 6][row..]);
            rows.put(WEIGHT, row, arrived.weight.only(arrived.valid));
            arrived.pdf.store(&mut rows.rows[LIGHT_PDF][row..]);
        }
    }

    /// The unoccluded contribution of the light, and the continuation of the paths.
    #[inline(always)]
    pub(crate) fn scatter<R: Real, S: Scatter<'a, R>>(&mut self, group: &Group) {
        let world: &'a World = self.batch.world;
        let material: &'a Material = &world.materials[group.index].material;
        let lit = self.samples_lights(material);
        let mapped = material.has_normal_map();
        let (framed, turned) = (material.has_own_frame(), material.is_anisotropic());
        let options = material.relief_options();
        let first = Sampler::vertex(group.depth);
        let candidates = self.candidates(group) as f32;
        let thin = matches!(material.sort(), Sort::Thin | Sort::Blend);
        let slots = material.slots();
        for at in (group.from..group.end).step_by(R::N) {
            let row = at - group.from;
            let (mask, ids) = (Self::mask::<R>(at, group.end), self.ids::<R>(at));
            let states = self.states::<R>(&ids);
            let shading = self.scratch.vertices.row::<R>(SHADING, row);
            let throughput = self.scratch.vertices.row::<R>(CARRIES, row);
            let normal = if framed { self.scratch.vertices.row::<R>(MAPPED, row) } else { shading };
            let frame =
                if turned { Frames::with(normal, self.scratch.vertices.row(ALONG, row)) } else { Frames::new(normal) };
            let mut viewer = -self.scratch.vertices.row::<R>(ARRIVED_BY, row);
            // What is two-sided around a map with options is seen from behind as its mirror image is from the front.
            let mut mirror = Mirror::none(shading);
            if material.is_mirrored() {
                mirror = Mirror::behind(shading, viewer);
                viewer = mirror.of(viewer);
            }
            let shadowing = options.is_some_and(|options| options.shadowing).then(|| Shadowing::of(normal, shading));
            let wo = frame.to_local(viewer);
            let behind = if material.is_two_sided() { wo.z.lt(R::zero()) } else { R::Mask::from_bits(0) };
            let wo = flip(wo, behind);
            let mut values = [Triple::zero(); SLOTS];
            for (slot, value) in values.iter_mut().enumerate() {
                *value = match slots[slot] {
                    None => Triple::zero(),
                    Some(Texture::Constant(value)) => Triple::splat(*value),
                    Some(_) => self.scratch.vertices.row(TEXTURES + 3 * slot, row),
                };
            }
            let Some(lobe) = S::of(material, &values, &self.points(row)) else { return };
            if lit {
                let towards = mirror.of(self.scratch.vertices.row::<R>(TOWARDS, row));
                let local = frame.to_local(towards);
                let (mut value, other) = lobe.eval(wo, flip(local, behind));
                if let Some(shadowing) = &shadowing {
                    value = value * shadowing.at(towards);
                }
                let pdf = R::load(&self.scratch.vertices.rows[LIGHT_PDF][row..]);
                let own = self.batch.path.strategy.weight(true, pdf, other);
                let weight = R::select(pdf.positive(), own, R::one());
                let arrives = self.scratch.vertices.row::<R>(WEIGHT, row);
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
                    let (o, d) =
                        (self.scratch.vertices.row::<R>(SHADOW, row), self.scratch.vertices.row::<R>(SHADOW + 3, row));
                    let end = R::load(&self.scratch.vertices.rows[SHADOW + 6][row..]);
                    let values = [o.x, o.y, o.z, d.x, d.y, d.z, end, light.x, light.y, light.z];
                    self.scratch.shadows.push(reached, values, &ids);
                }
            }
            let choice = self.draw::<R>(&states, first + dimension::LOBE_AND_ROULETTE);
            let drawn = sound(lobe.sample(wo, choice.x, self.draw(&states, first + dimension::SCATTER)));
            let local = flip(drawn.wi, behind);
            let mut wi = frame.to_world(local).normalize();
            let mut throughput = throughput * drawn.weight;
            if let Some(shadowing) = &shadowing {
                throughput = throughput * shadowing.at(wi);
            }
            let mut alive = mask & drawn.valid;
            let finite = throughput.finite();
            self.found.rejected += u64::from((alive & !finite).bits().count_ones());
            alive = alive & finite & throughput.some();
            if mapped {
                alive = alive & (wi.dot(shading) * local.z).positive();
            }
            wi = mirror.of(wi);
            let place = R::Integer::load(&self.scratch.order[at..]);
            let eta = R::gather(&self.scratch.paths.rows[ETA], place) * drawn.eta;
            // Light that scattering finds could have been any of the candidates.
            let mut pdf = R::select(drawn.delta, R::zero(), drawn.pdf) * (1.0 / candidates);
            let mut eta = eta;
            if self.batch.path.strategy == Strategy::Caustics {
                // A path that has been scattered carries the sign on its index; what bends it then has a density of -1.
                let last = R::gather(&self.scratch.paths.rows[PDF], place);
                let scattered = eta.lt(R::zero());
                let passed = wi.dot(self.scratch.vertices.row(ARRIVED_BY, row)).gt(R::splat(0.9999));
                let straight = if thin { passed } else { R::Mask::from_bits(0) };
                let bent = drawn.delta & ((scattered & !straight) | (straight & last.lt(R::zero())));
                pdf = R::select(bent, R::splat(-1.0), pdf);
                eta = R::select(drawn.delta, eta, -eta.abs());
            }
            if group.depth + 1 >= self.batch.path.roulette.from {
                let likely = throughput.largest() * eta * eta * self.batch.path.roulette.gain;
                // Numbers have 24 bits: less cannot be told from nothing.
                let survival = likely.min(R::splat(0.95)).max(R::splat(1.0 / (1u32 << 24) as f32));
                alive = alive & choice.y.lt(survival);
                throughput = throughput * (R::one() / survival);
            }
            if alive.any() {
                let from = self.vantage::<R>(row);
                let o = offset_origins(from.p, from.error, from.normal, wi);
                let t = throughput;
                self.scratch.next.push(alive, [o.x, o.y, o.z, wi.x, wi.y, wi.z, t.x, t.y, t.z, eta, pdf], &ids);
                if self.batch.light_paths.is_some() {
                    let rival = if group.depth == 0 {
                        let back = -self.scratch.vertices.row::<R>(ARRIVED_BY, row);
                        let density = self.batch.camera.density(from.p, back, from.normal, wi) * drawn.pdf;
                        R::select(drawn.delta, R::zero(), density)
                    } else {
                        R::gather(&self.scratch.rivals.rows[0], place).only(drawn.delta)
                    };
                    self.scratch.next_rivals.push(alive, [rival], &ids);
                }
            }
        }
    }
}
