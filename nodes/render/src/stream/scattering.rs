//! Where light comes from at a vertex, and where the path goes on: the samples of lights, and those of materials.

use super::{Group, Stream, rows::*};
use crate::{
    bsdf::{Material, SLOTS, Scatter, Sort, flip, sound},
    geometry::{Frames, offset_origins},
    integrator::{Strategy, dimension},
    lanes::{Integer, Mask, Real, Triple},
    lights::{Choice, Vantage},
    rng::Sampler,
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

/// Weights against ways of finding light by the path tracer alone, and now also against light paths, in the lanes where
/// they find this light, whose density is so many times as high.
#[inline(always)]
pub(super) fn against<R: Real>(weight: R, ratio: R, found: R::Mask) -> R {
    R::select(found, R::one() / (R::one() / weight + ratio * ratio), weight)
}

/// Squared tangent of an angle by its cosine.
#[inline(always)]
fn squared_tangent<R: Real>(cos: R) -> R {
    let square = cos * cos;
    (R::one() - square).max(R::zero()) / square.max(R::splat(1e-20))
}

impl<'a> Stream<'a> {
    #[inline(always)]
    fn vantage<R: Real>(&self, row: usize) -> Vantage<R> {
        let p = self.scratch.vertices.row(POINT, row);
        Vantage {
            p,
            cell: self.batch.world.lights.cell(p),
            error: self.scratch.vertices.row(ERROR, row),
            normal: self.scratch.vertices.row(GEOMETRIC, row),
        }
    }

    /// Density of paths over that of light paths that come the other way along `out`, without the density of scattering
    /// into `out`. Light paths scatter back with density `back`. 0 where no light path does.
    #[inline(always)]
    fn rival<R: Real>(&self, at: usize, row: usize, out: Triple<R>, back: R) -> R {
        let normal = self.scratch.vertices.row::<R>(GEOMETRIC, row);
        let arrived = self.scratch.vertices.row::<R>(ARRIVED_BY, row);
        let turned = normal.dot(arrived).abs() / (back * normal.dot(out).abs());
        R::gather(&self.scratch.rivals.rows[0], R::Integer::load(&self.scratch.order[at..]))
            * turned.only(back.positive())
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
        // Light paths leave what a lamp lights, as the camera sees it, to sampling.
        let aims = self.batch.light_paths.filter(|_| group.depth > 0).map(|plan| &plan.aims);
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
                let arrived = world.lights.sample(world, &vantage, aims, mask, numbers);
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
            if aims.is_some() {
                arrived.emits.store(&mut rows.rows[EMITS][row..]);
            }
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
                let mut weight = R::select(pdf.positive(), own, R::one());
                if let Some(plan) = self.batch.light_paths
                    && group.depth > 0
                {
                    let (_, back) = lobe.eval(flip(local, behind), wo);
                    let own = self.rival(at, row, towards, back) * pdf;
                    let theirs = R::load(&self.scratch.vertices.rows[EMITS][row..]) * plan.count as f32;
                    weight = against(weight, theirs / own, own.positive());
                }
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
                self.scratch.next.push(
                    alive,
                    [o.x, o.y, o.z, wi.x, wi.y, wi.z, t.x, t.y, t.z, eta, pdf, from.cell],
                    &ids,
                );
                if self.batch.light_paths.is_some() {
                    let rival = if group.depth == 0 {
                        let back = -self.scratch.vertices.row::<R>(ARRIVED_BY, row);
                        let density = self.batch.camera.density(from.p, back, from.normal, wi) * drawn.pdf;
                        R::select(drawn.delta, R::zero(), density)
                    } else {
                        let (_, back) = lobe.eval(drawn.wi, wo);
                        let scattered = self.rival(at, row, wi, back) * drawn.pdf;
                        R::select(drawn.delta, R::gather(&self.scratch.rivals.rows[0], place), scattered)
                    };
                    self.scratch.next_rivals.push(alive, [rival], &ids);
                }
            }
        }
    }
}
