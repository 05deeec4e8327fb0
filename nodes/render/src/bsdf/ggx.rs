//! The GGX microfacet distribution, isotropic, with Smith's separable shadowing and draws of visible normals.
//!
//! Source: Walter et al. 2007, Heitz 2018; as Mitsuba 3's `MicrofacetDistribution` with `sample_visible`.

use super::local::cosine_hemisphere;
use crate::lanes::{Pair, Real, Triple, exp, sin_cos_turn};
use glam::Vec2;
use tauflow_data::maths::logf;

const PI: f32 = std::f32::consts::PI;

/// The distribution of one roughness.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ggx<R> {
    pub(crate) alpha: R,
}

impl<R: Real> Ggx<R> {
    /// Density of normals per projected area of the surface.
    #[inline(always)]
    pub(crate) fn d(self, m: Triple<R>) -> R {
        let a2 = self.alpha * self.alpha;
        let t = (m.x * m.x + m.y * m.y) / a2 + m.z * m.z;
        (R::one() / (a2 * PI * t * t)).only(m.z.positive())
    }

    /// Share of facets of normal `m` that are seen from `v`.
    #[inline(always)]
    pub(crate) fn g1(self, v: Triple<R>, m: Triple<R>) -> R {
        let xy = (v.x * v.x + v.y * v.y) * self.alpha * self.alpha;
        let seen = (v.dot(m) * v.z).positive();
        (R::splat(2.0) / ((xy / (v.z * v.z) + 1.0).sqrt() + 1.0)).only(seen)
    }

    #[inline(always)]
    pub(crate) fn g(self, v: Triple<R>, l: Triple<R>, m: Triple<R>) -> R {
        self.g1(v, m) * self.g1(l, m)
    }

    /// Density of [`Ggx::sample`] over the solid angle of `m`; `v` above the surface.
    #[inline(always)]
    pub(crate) fn pdf(self, v: Triple<R>, m: Triple<R>) -> R {
        (self.d(m) * self.g1(v, m) * v.dot(m).abs() / v.z).only(v.z.positive())
    }

    /// A normal seen from `v`, which lies above the surface.
    #[inline(always)]
    pub(crate) fn sample(self, v: Triple<R>, u: Pair<R>) -> Triple<R> {
        let (sin, cos) = sin_cos_turn(u.y);
        let r = u.x.sqrt();
        self.facet(v, Pair::new(cos * r, sin * r))
    }

    /// The normal seen from `v` at a point of the unit disk.
    #[inline(always)]
    fn facet(self, v: Triple<R>, disk: Pair<R>) -> Triple<R> {
        visible([self.alpha; 2], v, disk)
    }
}

/// The normal that is seen from `v` at a point of the unit disk, where GGX has these roughnesses along both tangents.
#[inline(always)]
fn visible<R: Real>(alpha: [R; 2], v: Triple<R>, disk: Pair<R>) -> Triple<R> {
    let stretched = Triple::new(alpha[0] * v.x, alpha[1] * v.y, v.z).normalize();
    let square = stretched.x * stretched.x + stretched.y * stretched.y;
    let tilted = square.positive();
    let inverse = R::one() / square.sqrt();
    let t1 = Triple::new(
        R::select(tilted, -stretched.y * inverse, R::one()),
        (stretched.x * inverse).only(tilted),
        R::zero(),
    );
    let t2 = stretched.cross(t1);
    let p1 = disk.x;
    let s = (stretched.z + 1.0) * 0.5;
    let p2 = (R::one() - s) * (R::one() - p1 * p1).max(R::zero()).sqrt() + s * disk.y;
    let n = t1 * p1 + t2 * p2 + stretched * (R::one() - p1 * p1 - p2 * p2).max(R::zero()).sqrt();
    Triple::new(alpha[0] * n.x, alpha[1] * n.y, n.z.max(R::splat(1e-7))).normalize()
}

/// A distribution of microfacets, and how their normals are drawn.
pub(crate) trait Microfacets<R: Real>: Copy {
    /// Density of normals per projected area of the surface.
    fn d(self, m: Triple<R>) -> R;
    /// Share of facets of normal `m` that are seen from `v`.
    fn g1(self, v: Triple<R>, m: Triple<R>) -> R;
    /// Share of them that are seen from both.
    fn g(self, v: Triple<R>, l: Triple<R>, m: Triple<R>) -> R;
    /// Density with which normals are drawn, per projected area and share of them that is seen.
    fn drawn(self, v: Triple<R>, m: Triple<R>) -> R;
    /// Density of [`Microfacets::sample`] over the solid angle of `m`; `v` above the surface.
    fn pdf(self, v: Triple<R>, m: Triple<R>) -> R;
    /// A normal seen from `v`, which lies above the surface.
    fn sample(self, v: Triple<R>, u: Pair<R>) -> Triple<R>;
    /// Facets of normal `m` that are seen from `v`, over the density with which they are drawn.
    fn excess(self, v: Triple<R>, m: Triple<R>) -> R;
}

impl<R: Real> Microfacets<R> for Ggx<R> {
    #[inline(always)]
    fn d(self, m: Triple<R>) -> R {
        self.d(m)
    }

    #[inline(always)]
    fn g1(self, v: Triple<R>, m: Triple<R>) -> R {
        self.g1(v, m)
    }

    #[inline(always)]
    fn g(self, v: Triple<R>, l: Triple<R>, m: Triple<R>) -> R {
        self.g(v, l, m)
    }

    #[inline(always)]
    fn drawn(self, v: Triple<R>, m: Triple<R>) -> R {
        self.d(m) * self.g1(v, m)
    }

    #[inline(always)]
    fn pdf(self, v: Triple<R>, m: Triple<R>) -> R {
        self.pdf(v, m)
    }

    #[inline(always)]
    fn sample(self, v: Triple<R>, u: Pair<R>) -> Triple<R> {
        self.sample(v, u)
    }

    #[inline(always)]
    fn excess(self, _: Triple<R>, _: Triple<R>) -> R {
        R::one()
    }
}

/// Microfacets of either distribution, whose roughness may depend on the direction. Normals are drawn by those that GGX
/// of the same roughness has seen: against it Beckmann's are at most 4 / e times as dense.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facets<R> {
    /// Roughness along both tangents.
    pub(crate) alpha: [R; 2],
    pub(crate) beckmann: bool,
}

impl<R: Real> Facets<R> {
    /// Squared slope of a normal in units of roughness, times its squared cosine.
    #[inline(always)]
    fn slope(self, m: Triple<R>) -> R {
        let (x, y) = (m.x / self.alpha[0], m.y / self.alpha[1]);
        x * x + y * y
    }

    /// Squared length of a direction's tangential part, each component times its roughness.
    #[inline(always)]
    fn stretch(self, v: Triple<R>) -> R {
        let (x, y) = (v.x * self.alpha[0], v.y * self.alpha[1]);
        x * x + y * y
    }

    #[inline(always)]
    fn ggx_d(self, m: Triple<R>) -> R {
        let t = self.slope(m) + m.z * m.z;
        (R::one() / (self.alpha[0] * self.alpha[1] * PI * t * t)).only(m.z.positive())
    }

    #[inline(always)]
    fn ggx_g1(self, v: Triple<R>, m: Triple<R>) -> R {
        let seen = (v.dot(m) * v.z).positive();
        (R::splat(2.0) / ((self.stretch(v) / (v.z * v.z) + 1.0).sqrt() + 1.0)).only(seen)
    }
}

impl<R: Real> Microfacets<R> for Facets<R> {
    #[inline(always)]
    fn d(self, m: Triple<R>) -> R {
        if !self.beckmann {
            return self.ggx_d(m);
        }
        let c2 = m.z * m.z;
        let slope = self.slope(m) / c2;
        let density = exp(-slope) / (self.alpha[0] * self.alpha[1] * PI * c2 * c2);
        density.only(m.z.positive() & slope.lt(R::splat(80.0)))
    }

    /// Beckmann's by the rational function of Walter et al. 2007.
    #[inline(always)]
    fn g1(self, v: Triple<R>, m: Triple<R>) -> R {
        if !self.beckmann {
            return self.ggx_g1(v, m);
        }
        let a = v.z.abs() / self.stretch(v).sqrt().max(R::splat(1e-20));
        let (a, flat) = (a.min(R::splat(1.6)), a.ge(R::splat(1.6)));
        let part = (a * 3.535 + a * a * 2.181) / (a * 2.276 + a * a * 2.577 + 1.0);
        R::select(flat, R::one(), part).only((v.dot(m) * v.z).positive())
    }

    #[inline(always)]
    fn g(self, v: Triple<R>, l: Triple<R>, m: Triple<R>) -> R {
        self.g1(v, m) * self.g1(l, m)
    }

    #[inline(always)]
    fn drawn(self, v: Triple<R>, m: Triple<R>) -> R {
        self.ggx_d(m) * self.ggx_g1(v, m)
    }

    #[inline(always)]
    fn pdf(self, v: Triple<R>, m: Triple<R>) -> R {
        (self.drawn(v, m) * v.dot(m).abs() / v.z).only(v.z.positive())
    }

    #[inline(always)]
    fn sample(self, v: Triple<R>, u: Pair<R>) -> Triple<R> {
        let (sin, cos) = sin_cos_turn(u.y);
        let r = u.x.sqrt();
        visible(self.alpha, v, Pair::new(cos * r, sin * r))
    }

    #[inline(always)]
    fn excess(self, v: Triple<R>, m: Triple<R>) -> R {
        if !self.beckmann {
            return R::one();
        }
        let drawn = self.drawn(v, m);
        (self.d(m) * self.g1(v, m) / drawn).only(drawn.positive())
    }
}

/// Points spread evenly over half of the unit disk: all that a mean over the normals seen needs, the other half being
/// its mirror image.
pub(crate) fn half_disk() -> Vec<Vec2> {
    spread(128, 16, |_| 0.5)
}

/// More of them, each angle's radii between those of others. Seen from inside total reflection is a cusp along the
/// radius, at much the same one for all angles: even radii miss its share by up to a quarter of a percent.
pub(crate) fn staggered_half_disk() -> Vec<Vec2> {
    const ANGLES: u32 = 32;
    // Van der Corput's order, half a step in.
    let turned = |j: u32| (j.reverse_bits() >> (u32::BITS - ANGLES.trailing_zeros())) as f32;
    spread(256, ANGLES, |j| (turned(j) + 0.5) / ANGLES as f32)
}

/// `radii` by `angles` points; `within` says where in its ring a point lies.
fn spread(radii: u32, angles: u32, within: impl Fn(u32) -> f32) -> Vec<Vec2> {
    (0..radii)
        .flat_map(|i| (0..angles).map(move |j| (i, j)))
        .map(|(i, j)| {
            let (sin, cos) = sin_cos_turn((j as f32 + 0.5) / (2 * angles) as f32 - 0.25);
            Vec2::new(cos, sin) * ((i as f32 + within(j)) / radii as f32).sqrt()
        })
        .collect()
}

/// Transmission and reflection of a rough interface in one bounce, by the incident cosine. Each is a mean over the
/// normals seen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Interface<'a> {
    pub(crate) alpha: f32,
    pub(crate) beckmann: bool,
    pub(crate) eta: f32,
    /// Points that stand for the normals seen.
    pub(crate) disk: &'a [Vec2],
    /// Selects the transmitted or the reflected share.
    pub(crate) through: bool,
}

impl Interface<'_> {
    /// Writes the share at each cosine, which there are a multiple of sixteen of, by lanes of `R`.
    #[inline(always)]
    pub(crate) fn shares<R: Real>(&self, cosines: &[f32], shares: &mut [f32]) {
        let alpha = R::splat(self.alpha);
        if self.beckmann {
            self.shares_of(Facets { alpha: [alpha; 2], beckmann: true }, cosines, shares);
        } else {
            self.shares_of(Ggx { alpha }, cosines, shares);
        }
    }

    #[inline(always)]
    fn shares_of<R: Real>(&self, facets: impl Microfacets<R>, cosines: &[f32], shares: &mut [f32]) {
        let lanes = R::N;
        for (cos, to) in cosines.chunks_exact(lanes).zip(shares.chunks_exact_mut(lanes)) {
            let cos = R::load(cos);
            let v = Triple::new((R::one() - cos * cos).max(R::zero()).sqrt(), R::zero(), cos);
            let ggx = Ggx { alpha: R::splat(self.alpha) };
            let (mut sums, mut values) = ([0.0f64; 16], [0.0f32; 16]);
            for p in self.disk {
                let m = ggx.facet(v, Pair::new(R::splat(p.x), R::splat(p.y)));
                let f = super::fresnel::dielectric(v.dot(m), self.eta);
                let value = if self.through {
                    let l = super::local::refract(v, m, f.cos_t, f.eta_ti);
                    ((R::one() - f.r) * facets.g1(-l, m)).only(l.z.lt(R::zero()))
                } else {
                    let l = super::local::reflect(v, m);
                    (f.r * facets.g1(l, m)).only(l.z.positive())
                };
                (value * facets.excess(v, m)).store(&mut values[..lanes]);
                for (sum, value) in sums[..lanes].iter_mut().zip(&values) {
                    *sum += f64::from(*value);
                }
            }
            for (to, sum) in to.iter_mut().zip(sums) {
                *to = (sum / self.disk.len() as f64) as f32;
            }
        }
    }
}

/// GTR1, the long-tailed distribution of a clear coat. Source: Burley 2012.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gtr1 {
    pub(crate) alpha: f32,
}

impl Gtr1 {
    #[inline(always)]
    pub(crate) fn d<R: Real>(self, m: Triple<R>) -> R {
        let a2 = self.alpha * self.alpha;
        let scale = (a2 - 1.0) / (PI * logf(a2));
        (R::splat(scale) / (m.z * m.z * (a2 - 1.0) + 1.0)).only(m.z.positive())
    }

    #[inline(always)]
    pub(crate) fn pdf<R: Real>(self, m: Triple<R>) -> R {
        self.d(m) * m.z.max(R::zero())
    }

    #[inline(always)]
    pub(crate) fn sample<R: Real>(self, u: Pair<R>) -> Triple<R> {
        let a2 = self.alpha * self.alpha;
        let power = exp((R::one() - u.y) * logf(a2));
        let z2 = ((R::one() - power) / (1.0 - a2)).clamp(0.0, 1.0);
        let r = (R::one() - z2).max(R::zero()).sqrt();
        let (sin, cos) = sin_cos_turn(u.x);
        Triple::new(r * cos, r * sin, z2.sqrt())
    }
}

/// A cosine-weighted direction above the surface, and its density.
#[inline(always)]
pub(crate) fn diffuse<R: Real>(u: Pair<R>) -> (Triple<R>, R) {
    let l = cosine_hemisphere(u);
    (l, l.z / PI)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn normals_cover_the_surface_and_their_density_is_one() {
        for alpha in [0.05f32, 0.3, 1.0] {
            let v: Triple<f32> = Vec3::new(0.6, 0.0, 0.8).into();
            let (mut area, mut density, mut coat) = (0.0f64, 0.0f64, 0.0f64);
            let (rows, columns) = (4000u32, 64u32);
            for i in 0..rows {
                // Dense near the pole, where smooth surfaces have all their normals.
                let t = (f64::from(i) + 0.5) / f64::from(rows);
                let theta = t * t * std::f64::consts::FRAC_PI_2;
                let weight = libm::sin(theta) * 2.0 * t * std::f64::consts::FRAC_PI_2 / f64::from(rows);
                for j in 0..columns {
                    let phi = 2.0 * std::f64::consts::PI * (f64::from(j) + 0.5) / f64::from(columns);
                    let s = libm::sin(theta);
                    let m: Triple<f32> =
                        Vec3::new((s * libm::cos(phi)) as f32, (s * libm::sin(phi)) as f32, libm::cos(theta) as f32)
                            .into();
                    let solid = weight * 2.0 * std::f64::consts::PI / f64::from(columns);
                    area += f64::from(Ggx { alpha }.d(m) * m.z) * solid;
                    density += f64::from(Ggx { alpha }.pdf(v, m)) * solid;
                    coat += f64::from(Gtr1 { alpha: alpha.min(0.9) }.pdf(m)) * solid;
                }
            }
            assert!((area - 1.0).abs() < 5e-3, "{alpha}: {area}");
            assert!((density - 1.0).abs() < 5e-3, "{alpha}: {density}");
            assert!((coat - 1.0).abs() < 5e-3, "{alpha}: {coat}");
        }
    }
}
