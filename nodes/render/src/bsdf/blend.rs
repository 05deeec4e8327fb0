//! Blends of several lobes, point by point. A single lobe of any sort is one, too.
//!
//! By lane they would be faster, but all sorts of lobes in one kernel take minutes to compile.

use super::{
    Diffuse, Drawn, Glass, Material, Metal, Plastic, Points, Principled, SLOTS, Scatter, Thin, flip, material::Layer,
    to_front,
};
use crate::lanes::{Pair, Triple};

/// Layers whose values are kept from one use to the next; those of more are read again.
const KEPT: usize = 4;

/// A layer's scattering.
#[derive(Clone, Copy, Debug)]
pub(super) enum Lobe<'a> {
    Diffuse(Diffuse<f32>),
    Metal(Metal<f32>),
    Glass(Glass<f32>),
    Thin(Thin<f32>),
    Plastic(Plastic<'a, f32>),
    Principled(Principled<f32>),
}

/// A material's scattering at a point, with the values of its textures there.
pub(crate) struct Blend<'a> {
    layers: &'a [Layer],
    at: Points<f32>,
    /// Shares and lobes of the first layers.
    kept: [Option<(f32, Lobe<'a>)>; KEPT],
}

impl Lobe<'_> {
    fn eval(&self, wo: Triple<f32>, wi: Triple<f32>) -> (Triple<f32>, f32) {
        match self {
            Self::Diffuse(diffuse) => Scatter::eval(diffuse, wo, wi),
            Self::Metal(metal) => Scatter::eval(metal, wo, wi),
            Self::Glass(glass) => Scatter::eval(glass, wo, wi),
            Self::Thin(thin) => Scatter::eval(thin, wo, wi),
            Self::Plastic(plastic) => Scatter::eval(plastic, wo, wi),
            Self::Principled(principled) => Scatter::eval(principled, wo, wi),
        }
    }

    fn sample(&self, wo: Triple<f32>, lobe: f32, u: Pair<f32>) -> Drawn<f32> {
        match self {
            Self::Diffuse(diffuse) => Scatter::sample(diffuse, wo, lobe, u),
            Self::Metal(metal) => Scatter::sample(metal, wo, lobe, u),
            Self::Glass(glass) => Scatter::sample(glass, wo, lobe, u),
            Self::Thin(thin) => Scatter::sample(thin, wo, lobe, u),
            Self::Plastic(plastic) => Scatter::sample(plastic, wo, lobe, u),
            Self::Principled(principled) => Scatter::sample(principled, wo, lobe, u),
        }
    }

    fn albedo(&self) -> Triple<f32> {
        match self {
            Self::Diffuse(diffuse) => diffuse.0,
            Self::Metal(metal) => metal.albedo(),
            Self::Glass(glass) => glass.albedo(),
            Self::Thin(thin) => thin.albedo(),
            Self::Plastic(plastic) => plastic.albedo(),
            Self::Principled(principled) => principled.albedo(),
        }
    }
}

impl<'a> Blend<'a> {
    /// The blend of a material at a point.
    pub(super) fn at(material: &'a Material, at: &Points<f32>) -> Self {
        let mut kept = [None; KEPT];
        for (own, layer) in kept.iter_mut().zip(&material.layers) {
            *own = Some((layer.weight(at), layer.lobe(at)));
        }
        Self { layers: &material.layers, at: *at, kept }
    }

    /// Share and lobe of a layer.
    fn layer(&self, number: usize) -> (f32, Lobe<'a>) {
        match self.kept.get(number) {
            Some(Some(kept)) => *kept,
            _ => (self.layers[number].weight(&self.at), self.layers[number].lobe(&self.at)),
        }
    }

    /// The mean of the albedos of its lobes.
    pub(super) fn albedo(&self) -> Triple<f32> {
        let mut all = Triple::zero();
        for number in 0..self.layers.len() {
            let (weight, lobe) = self.layer(number);
            all += lobe.albedo() * weight;
        }
        all
    }
}

impl<'a> Scatter<'a, f32> for Blend<'a> {
    fn of(material: &'a Material, _: &[Triple<f32>; SLOTS], at: &Points<f32>) -> Option<Self> {
        Some(Self::at(material, at))
    }

    fn eval(&self, wo: Triple<f32>, wi: Triple<f32>) -> (Triple<f32>, f32) {
        let (mut value, mut pdf) = (Triple::zero(), 0.0);
        for (number, layer) in self.layers.iter().enumerate() {
            let (wo, wi) = if layer.two_sided { to_front(wo, wi) } else { (wo, wi) };
            let (weight, lobe) = self.layer(number);
            let (v, p) = lobe.eval(wo, wi);
            value += v * weight;
            pdf += p * weight;
        }
        (value, pdf)
    }

    fn sample(&self, wo: Triple<f32>, lobe: f32, u: Pair<f32>) -> Drawn<f32> {
        let mut drawn = Drawn::nothing();
        let mut below = 0.0;
        for (number, layer) in self.layers.iter().enumerate() {
            let (weight, own) = self.layer(number);
            if weight > 0.0 && lobe >= below && lobe < below + weight {
                let behind = layer.two_sided && wo.z < 0.0;
                // The rest of the random number, rescaled to [0, 1).
                let rest = ((lobe - below) / weight).min(1.0 - f32::EPSILON);
                drawn = own.sample(flip(wo, behind), rest, u);
                drawn.wi = flip(drawn.wi, behind);
            }
            below += weight;
        }
        if self.layers.len() > 1 && drawn.valid && !drawn.delta {
            let (value, pdf) = self.eval(wo, drawn.wi);
            drawn.pdf = pdf;
            drawn.weight = value * (1.0 / pdf);
        }
        drawn
    }
}
