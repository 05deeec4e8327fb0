//! Directives of pbrt-v3, which pbrt-v4 no longer reads.

use super::tokens::{Directive, Values};

/// Materials, integrators and others that pbrt-v4 gave up or renamed. Without a list, the directive itself is one.
const OF_V3: [(&str, &[&str]); 10] = [
    (
        "Material",
        &[
            "matte",
            "plastic",
            "glass",
            "metal",
            "mirror",
            "uber",
            "substrate",
            "translucent",
            "fourier",
            "disney",
            "kdsubsurface",
        ],
    ),
    ("Integrator", &["directlighting", "whitted"]),
    ("Film", &["image"]),
    ("Sampler", &["02sequence", "lowdiscrepancy", "maxmindist", "random"]),
    ("Camera", &["environment"]),
    ("Shape", &["cone", "heightfield", "hyperboloid", "nurbs", "paraboloid"]),
    ("SurfaceIntegrator", &[]),
    ("Renderer", &[]),
    ("VolumeIntegrator", &[]),
    ("WorldEnd", &[]),
];

/// Parameters that pbrt-v4 renamed, by their directives.
const PARAMETERS: [(&str, &str); 2] = [("LightSource", "mapname"), ("AreaLightSource", "nsamples")];

/// Whether a directive is one of pbrt-v3 and not of pbrt-v4.
pub(super) fn is_of_v3(directive: &Directive) -> bool {
    let has = |name: &str| directive.params.iter().any(|param| param.name == name);
    if PARAMETERS.iter().any(|(of, name)| directive.name == *of && has(name)) {
        return true;
    }
    let named = directive.name == "MakeNamedMaterial";
    let name = if named { "Material" } else { directive.name.as_str() };
    let Some((_, sorts)) = OF_V3.iter().find(|(old, _)| *old == name) else { return false };
    let of_type = directive.params.iter().find(|p| named && p.name == "type").and_then(|p| match &p.values {
        Values::Texts(texts) => texts.first(),
        _ => None,
    });
    let sort = if named { of_type } else { directive.texts.first() };
    sorts.is_empty() || sort.is_some_and(|sort| sorts.contains(&sort.as_str()))
}
