//! Fresnel terms. Source: Walter et al. 2007 for dielectrics, the usual complex formula for conductors; Schlick's
//! weight as Mitsuba 3's `principled` uses it.

use crate::lanes::{Real, Triple};
use glam::Vec3;

/// Reflectance of a smooth interface, and what goes with it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Dielectric<R> {
    /// Share that is reflected.
    pub(crate) r: R,
    /// Cosine of the transmitted direction, of the other sign than the incident one; 0 in total reflection.
    pub(crate) cos_t: R,
    /// Relative index across the interface, in the direction of travel.
    pub(crate) eta_it: R,
    /// Its inverse.
    pub(crate) eta_ti: R,
}

/// Unpolarised reflectance at an interface of relative index `eta` (inside over outside); `cos_i` is negative inside.
#[inline(always)]
pub(crate) fn dielectric<R: Real>(cos_i: R, eta: f32) -> Dielectric<R> {
    let outside = cos_i.ge(R::zero());
    let eta_it = R::select(outside, R::splat(eta), R::splat(1.0 / eta));
    let eta_ti = R::select(outside, R::splat(1.0 / eta), R::splat(eta));
    let cos_t_squared = R::one() - eta_ti * eta_ti * (R::one() - cos_i * cos_i).max(R::zero());
    let passes = cos_t_squared.positive();
    let cos = cos_i.abs();
    let cos_t = cos_t_squared.max(R::zero()).sqrt();
    let s = (cos - eta_it * cos_t) / (cos + eta_it * cos_t);
    let p = (cos_t - eta_it * cos) / (cos_t + eta_it * cos);
    let r = (s * s + p * p) * 0.5;
    let r = if eta == 1.0 { R::zero() } else { R::select(cos.positive() & passes, r, R::one()) };
    let cos_t = R::select(outside, -cos_t, cos_t).only(passes);
    Dielectric { r, cos_t, eta_it, eta_ti }
}

/// Unpolarised reflectance of a conductor with complex index `eta` + i `k`.
#[inline(always)]
pub(crate) fn conductor<R: Real>(cos_i: R, eta: Vec3, k: Vec3) -> Triple<R> {
    let c2 = cos_i * cos_i;
    let s2 = R::one() - c2;
    macro_rules! channel {
        ($eta:expr, $k:expr) => {{
            let (eta, k): (f32, f32) = ($eta, $k);
            let t0 = R::splat(eta * eta - k * k) - s2;
            let a2b2 = (t0 * t0 + 4.0 * k * k * eta * eta).sqrt();
            let t1 = a2b2 + c2;
            let a = ((a2b2 + t0) * 0.5).max(R::zero()).sqrt();
            let t2 = a * 2.0 * cos_i;
            let s = (t1 - t2) / (t1 + t2);
            let t3 = a2b2 * c2 + s2 * s2;
            let t4 = t2 * s2;
            let p = s * (t3 - t4) / (t3 + t4);
            (p + s) * 0.5
        }};
    }
    Triple::new(channel!(eta.x, k.x), channel!(eta.y, k.y), channel!(eta.z, k.z))
}

/// (1 - cos)^5.
#[inline(always)]
pub(crate) fn schlick_weight<R: Real>(cos: R) -> R {
    let m = (R::one() - cos).clamp(0.0, 1.0);
    let m2 = m * m;
    m2 * m2 * m
}

/// Schlick's approximation from normal reflectance `r0`, with the transmitted cosine on the denser side.
#[inline(always)]
pub(crate) fn schlick<R: Real>(r0: Triple<R>, cos_i: R, eta: f32) -> Triple<R> {
    let outside = cos_i.ge(R::zero());
    // The cosine on the rarer side, as the denser side's; only one of the two needs it.
    let other = if eta > 1.0 { eta } else { 1.0 / eta };
    let transmitted = (R::one() - (R::one() - cos_i * cos_i) * (other * other)).max(R::zero()).sqrt();
    let direct = if eta > 1.0 { outside } else { !outside };
    let w = schlick_weight(R::select(direct, cos_i.abs(), transmitted));
    r0 + (Triple::all(R::one()) - r0) * w
}

/// Share of diffuse light that an interface reflects back, by the fits that Mitsuba 3 uses: Egan and Hilgeman 1973 for
/// `eta` below 1, d'Eon and Irving 2011 above; within 0.6% of the integral up to an index of 2.
pub(crate) fn diffuse_reflectance(eta: f32) -> f32 {
    let inverse = 1.0 / eta;
    if eta < 1.0 {
        return ((-1.4399 * eta + 0.7099) * eta + 0.6681) + 0.0636 * inverse;
    }
    [-1.36881, 4.98554, -7.80989, 6.75335, -3.4793, 0.919_317].into_iter().fold(0.0, |sum, c| sum * inverse + c)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values() {
        // ((1.5 - 1)/(1.5 + 1))^2 = 0.04.
        assert!((dielectric(1.0f32, 1.5).r - 0.04).abs() < 1e-6);
        assert!((dielectric(-1.0f32, 1.5).r - 0.04).abs() < 1e-6);
        // Beyond the critical angle inside glass, cos < sqrt(1 - 1/2.25) = 0.745.
        assert_eq!(dielectric(-0.7f32, 1.5).r, 1.0);
        assert!(dielectric(-0.76f32, 1.5).r < 1.0);
        // A conductor without absorption is a dielectric.
        for cos in [0.05f32, 0.3, 0.9] {
            let metal = conductor::<f32>(cos, Vec3::splat(1.5), Vec3::ZERO).x;
            assert!((metal - dielectric(cos, 1.5).r).abs() < 1e-5);
        }
        // Brewster's angle: tan = 1.5, where the parallel part vanishes.
        let brewster = dielectric(1.0 / (1.0f32 + 2.25).sqrt(), 1.5);
        let s: f32 = brewster.r * 2.0;
        assert!((s.sqrt() - 5.0 / 13.0).abs() < 1e-5);
    }

    #[test]
    fn diffuse_reflectance_is_the_mean_of_the_reflectance() {
        const STEPS: u32 = 4096;
        for eta in [1.1f32, 1.33, 1.5, 1.9, 1.0 / 1.1, 1.0 / 1.33, 1.0 / 1.5, 1.0 / 1.9] {
            let sum: f64 = (0..STEPS)
                .map(|i| {
                    // Uniform in sin^2: the cosine-weighted mean.
                    let cos = (1.0 - (f64::from(i) + 0.5) / f64::from(STEPS)).sqrt();
                    f64::from(dielectric(cos as f32, eta).r)
                })
                .sum();
            let mean = (sum / f64::from(STEPS)) as f32;
            let fit = diffuse_reflectance(eta);
            assert!((fit / mean - 1.0).abs() < 6e-3, "{eta}: {fit} {mean}");
        }
    }

    #[test]
    fn refraction_obeys_snell() {
        for cos in [-0.9f32, -0.8, 0.2, 0.7, 1.0] {
            let f = dielectric::<f32>(cos, 1.5);
            let (sin_i, sin_t) = ((1.0 - cos * cos).sqrt(), (1.0 - f.cos_t * f.cos_t).max(0.0).sqrt());
            assert!((sin_i - f.eta_it * sin_t).abs() < 1e-5);
            assert!(f.cos_t * cos < 0.0);
        }
    }
}
