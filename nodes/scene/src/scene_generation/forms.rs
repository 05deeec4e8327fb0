//! The library of procedural objects: each form in a number of fixed variants.
//!
//! Variants come from the library, not from the scene's seed, so that thirty thousand scenes share a few hundred mesh
//! blobs, an object's name says what it is, and objects can be held out. Normalised: the longest side is 1, the foot
//! stands on y = 0, the axis is x = z = 0.

use super::{
    noise::fractal,
    surfaces::{Ends, TAU, boxes, grid, icosphere, lathe, prism, rounded_box, spline},
};
use crate::geom::{Aabb, Vec3, add, cross, mul, unit};
use tauflow_data::{maths, mesh::Mesh, rng::Stream};

/// A form of the library.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Form {
    /// Its name.
    pub name: &'static str,
    /// How many variants there are.
    pub variants: u64,
    /// True if it is one closed body that glass suits.
    pub glass: bool,
    /// True if it has texture coordinates.
    pub uv: bool,
}

const fn form(name: &'static str, variants: u64, glass: bool, uv: bool) -> Form {
    Form { name, variants, glass, uv }
}

/// Every form, in order of name.
pub const FORMS: [Form; 20] = [
    form("block", 16, true, true),
    form("bottle", 16, true, true),
    form("boulder", 24, true, false),
    form("bowl", 16, true, true),
    form("capsule", 12, true, true),
    form("chair", 12, false, true),
    form("column", 24, true, false),
    form("cone", 12, true, true),
    form("crystal", 16, true, false),
    form("cylinder", 12, true, true),
    form("gear", 24, true, false),
    form("goblet", 16, true, true),
    form("knot", 16, true, true),
    form("sphere", 1, true, true),
    form("spring", 12, true, true),
    form("star", 16, true, false),
    form("steps", 12, false, true),
    form("superellipsoid", 24, true, true),
    form("torus", 16, true, true),
    form("vase", 24, true, true),
];

/// A mesh moved and scaled to the library's norm, and its bounds.
pub fn normalised(mut mesh: Mesh) -> (Mesh, Aabb) {
    let mut bounds = Aabb::EMPTY;
    mesh.positions.iter().for_each(|p| bounds.grow(p.map(f64::from)));
    let size = bounds.size();
    let scale = 1.0 / size[0].max(size[1]).max(size[2]).max(1e-9);
    let center = bounds.center();
    for p in &mut mesh.positions {
        let q = p.map(f64::from);
        *p = [(q[0] - center[0]) * scale, (q[1] - bounds.low[1]) * scale, (q[2] - center[2]) * scale].map(|v| v as f32);
    }
    let half = mul(size, 0.5 * scale);
    (mesh, Aabb { low: [-half[0], 0.0, -half[2]], high: [half[0], 2.0 * half[1], half[2]] })
}

/// The mesh of a form's variant, normalised, with its bounds; none for the sphere, which needs no mesh.
pub fn mesh(form: &Form, variant: u64) -> Option<(Mesh, Aabb)> {
    let mut draw = Stream::new(0x666F_726D, &[variant]).part(form.name);
    let d = &mut draw;
    let mesh = match form.name {
        "block" => {
            let half = [1.0, d.range(0.35, 1.0), d.range(0.5, 1.0)];
            rounded_box(half, d.range(0.03, 0.3) * half[1], 10)
        }
        "bottle" => bottle(d),
        "boulder" => {
            let (seed, amount, scale) = (d.bits(), d.range(0.15, 0.45), d.range(1.1, 2.2));
            let squash = d.range(0.7, 1.0);
            let mut mesh = icosphere(4, |p| 1.0 + amount * fractal(seed, mul(p, scale), [0; 3], 4));
            squash_y(&mut mesh, squash);
            mesh
        }
        "bowl" => {
            let (depth, thick, foot) = (d.range(0.4, 0.8), d.range(0.05, 0.09), d.range(0.3, 0.5));
            lathe(
                &[
                    [0.0, 0.0],
                    [foot, 0.0],
                    [0.8, 0.35 * depth],
                    [1.0, depth],
                    [1.0 - thick, depth + 0.3 * thick],
                    [0.78 - thick, 0.4 * depth],
                    [0.5 * foot, thick],
                    [0.0, thick],
                ],
                48,
                56,
            )
        }
        "capsule" => {
            let ratio = d.range(0.6, 2.0);
            grid(40, 40, Ends::Poles, false, |u, v| {
                let angle = core::f64::consts::PI * (v - 0.5);
                let r = maths::cos(angle).max(0.0);
                // Blends the two caps smoothly over the barrel.
                let y = maths::sin(angle) + ratio * (2.0 * smooth(v) - 1.0);
                [r * maths::sin(TAU * u), y, r * maths::cos(TAU * u)]
            })
        }
        "chair" => chair(d),
        "column" => {
            let (lobes, depth) = (3 + d.below(6), d.range(0.1, 0.3));
            let outline = star(lobes * 8, |a| 1.0 + depth * maths::cos(lobes as f64 * a));
            prism(&outline, d.range(2.5, 4.0), 40, d.range(-3.0, 3.0), d.range(0.6, 1.0))
        }
        "cone" => {
            let (height, tip) = (d.range(1.2, 2.4), d.range(0.0, 0.5));
            turned(&sharp(&[[0.0, 0.0], [1.0, 0.0], [tip.max(0.05), height], [0.0, height]]))
        }
        "crystal" => {
            let sides = 5 + d.below(4);
            let wobble = d.range(0.0, 0.25);
            let phase = d.range(0.0, TAU);
            let outline = star(sides, |a| 1.0 + wobble * maths::sin(2.0 * a + phase));
            crystal(&outline, d.range(1.4, 2.6), d.range(0.5, 1.2))
        }
        "cylinder" => {
            let height = d.range(0.4, 2.4);
            turned(&sharp(&[[0.0, 0.0], [1.0, 0.0], [1.0, height], [0.0, height]]))
        }
        "gear" => {
            let (teeth, depth) = (8 + d.below(9), d.range(0.12, 0.25));
            let outline: Vec<[f64; 2]> = (0..teeth * 4)
                .map(|i| {
                    let r = if i % 4 < 2 { 1.0 } else { 1.0 - depth };
                    let a = TAU * (i as f64 + if i % 2 == 0 { 0.15 } else { -0.15 }) / (teeth * 4) as f64;
                    [r * maths::sin(a), r * maths::cos(a)]
                })
                .collect();
            prism(&outline, d.range(0.25, 0.6), 1, 0.0, 1.0)
        }
        "goblet" => {
            let (stem, bowl, thick) = (d.range(0.5, 1.0), d.range(0.55, 0.8), d.range(0.035, 0.06));
            let top = stem + d.range(0.7, 1.1);
            lathe(
                &[
                    [0.0, 0.0],
                    [0.55, 0.0],
                    [0.5, 0.05],
                    [0.1, 0.14],
                    [0.075, 0.5 * stem],
                    [0.1, stem],
                    [bowl * 0.85, stem + 0.35 * (top - stem)],
                    [bowl, top - 0.1],
                    [bowl * 0.93, top],
                    [bowl * 0.93 - thick, top],
                    [bowl - thick - 0.01, top - 0.1],
                    [bowl * 0.85 - thick, stem + 0.4 * (top - stem)],
                    [0.12, stem + thick + 0.1],
                    [0.0, stem + thick + 0.08],
                ],
                48,
                84,
            )
        }
        "knot" => {
            let (p, q) = *d.pick(&[(2.0, 3.0), (3.0, 2.0), (2.0, 5.0), (3.0, 4.0)]);
            tube(240, 16, d.range(0.22, 0.34), move |t| {
                let (a, b) = (p * TAU * t, q * TAU * t);
                let r = 2.0 + 0.85 * maths::cos(b);
                [r * maths::cos(a), 0.85 * maths::sin(b), r * maths::sin(a)]
            })
        }
        "spring" => {
            // A coil bent into a ring, so that the tube closes on itself.
            let (turns, minor) = ((7 + d.below(7)) as f64, d.range(0.5, 0.8));
            tube(320, 10, d.range(0.13, 0.2), move |t| {
                let (a, b) = (TAU * t, TAU * turns * t);
                let r = 2.0 + minor * maths::cos(b);
                [r * maths::cos(a), minor * maths::sin(b), r * maths::sin(a)]
            })
        }
        "star" => {
            let (points, inner) = (4 + d.below(5), d.range(0.4, 0.7));
            let outline: Vec<[f64; 2]> = (0..2 * points)
                .map(|i| {
                    let r = if i % 2 == 0 { 1.0 } else { inner };
                    let a = TAU * i as f64 / (2 * points) as f64;
                    [r * maths::sin(a), r * maths::cos(a)]
                })
                .collect();
            prism(&outline, d.range(0.3, 1.6), 1, 0.0, d.range(0.5, 1.0))
        }
        "steps" => {
            let count = 3 + d.below(4);
            let (depth, rise, wide) = (d.range(0.25, 0.4), d.range(0.15, 0.3), d.range(0.5, 1.0));
            let parts: Vec<(Vec3, Vec3)> = (0..count)
                .map(|i| {
                    let height = rise * (i + 1) as f64;
                    ([0.0, 0.5 * height, -depth * i as f64], [wide, 0.5 * height, 0.5 * depth])
                })
                .collect();
            boxes(&parts)
        }
        "superellipsoid" => {
            let (e1, e2) = (d.range(0.25, 1.9), d.range(0.25, 1.9));
            let (sy, sz) = (d.range(0.6, 1.3), d.range(0.7, 1.0));
            let power = |v: f64, e: f64| if v < 0.0 { -maths::pow(-v, e) } else { maths::pow(v, e) };
            grid(64, 40, Ends::Poles, false, move |u, v| {
                let (a, b) = (TAU * u, core::f64::consts::PI * (v - 0.5));
                let c = power(maths::cos(b).max(0.0), e1);
                [c * power(maths::sin(a), e2), sy * power(maths::sin(b), e1), sz * c * power(maths::cos(a), e2)]
            })
        }
        "torus" => {
            let minor = d.range(0.2, 0.5);
            let mut mesh = tube(64, 28, minor, |t| [maths::cos(TAU * t), 0.0, maths::sin(TAU * t)]);
            if d.chance(0.4) {
                // Standing up.
                let turn = |p: &mut [f32; 3]| *p = [p[0], p[2], -p[1]];
                mesh.positions.iter_mut().for_each(turn);
                mesh.normals.iter_mut().flatten().for_each(turn);
            }
            mesh
        }
        "vase" => vase(d),
        _ => return None,
    };
    Some(normalised(mesh))
}

fn smooth(v: f64) -> f64 {
    v * v * (3.0 - 2.0 * v)
}

fn squash_y(mesh: &mut Mesh, factor: f64) {
    for p in &mut mesh.positions {
        p[1] = (f64::from(p[1]) * factor) as f32;
    }
    for n in mesh.normals.iter_mut().flatten() {
        let v = n.map(f64::from);
        *n = unit([v[0], v[1] / factor, v[2]]).map(|v| v as f32);
    }
}

fn star(n: usize, radius: impl Fn(f64) -> f64) -> Vec<[f64; 2]> {
    (0..n)
        .map(|i| {
            let a = TAU * i as f64 / n as f64;
            [radius(a) * maths::sin(a), radius(a) * maths::cos(a)]
        })
        .collect()
}

/// A profile whose corners are rounded by small arcs and whose long sides are divided, for [`turned`].
fn sharp(profile: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let last = profile.len() - 1;
    let mut rounded = vec![profile[0]];
    for k in 1..last {
        let toward = |from: [f64; 2], to: [f64; 2]| {
            let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
            let l = (dx * dx + dy * dy).sqrt();
            let step = 0.05f64.min(0.3 * l);
            [from[0] + dx / l * step, from[1] + dy / l * step]
        };
        let (a, b, c) = (toward(profile[k], profile[k - 1]), profile[k], toward(profile[k], profile[k + 1]));
        // A quadratic Bezier curve from side to side.
        rounded.extend((0..=5).map(|i| {
            let t = f64::from(i) / 5.0;
            [0, 1].map(|i| (1.0 - t) * (1.0 - t) * a[i] + 2.0 * t * (1.0 - t) * b[i] + t * t * c[i])
        }));
    }
    rounded.push(profile[last]);
    let mut out = vec![rounded[0]];
    for pair in rounded.windows(2) {
        let (dx, dy) = (pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]);
        let n = ((dx * dx + dy * dy).sqrt() / 0.15).ceil().max(1.0) as usize;
        out.extend((1..=n).map(|i| {
            let t = i as f64 / n as f64;
            [pair[0][0] + t * dx, pair[0][1] + t * dy]
        }));
    }
    out
}

/// A body of revolution of a polyline, one ring of vertices for each of its points.
fn turned(profile: &[[f64; 2]]) -> Mesh {
    let spans = profile.len() - 1;
    grid(48, spans, Ends::Poles, false, |u, v| {
        let x = (v * spans as f64).clamp(0.0, spans as f64);
        let k = (x.floor() as usize).min(spans - 1);
        let t = x - k as f64;
        let [r, y] = [0, 1].map(|i| profile[k][i] + t * (profile[k + 1][i] - profile[k][i]));
        [r * maths::sin(TAU * u), y, r * maths::cos(TAU * u)]
    })
}

/// A round tube along the closed curve `c(t)`, t in [0, 1), in the frame of its tangent and curvature.
fn tube(along: usize, around: usize, radius: f64, c: impl Fn(f64) -> Vec3) -> Mesh {
    let wrap = |t: f64| t - t.floor();
    let frame = |t: f64| {
        let h = 1e-3;
        let (a, o, b) = (c(wrap(t - h)), c(t), c(wrap(t + h)));
        let tangent = unit(crate::geom::sub(b, a));
        let bend = crate::geom::sub(add(a, b), mul(o, 2.0));
        let binormal = unit(cross(tangent, bend));
        (o, cross(binormal, tangent), binormal)
    };
    grid(along, around, Ends::Wrap, true, |u, v| {
        let (o, n, b) = frame(wrap(u));
        let (s, k) = (maths::sin(TAU * v), maths::cos(TAU * v));
        add(o, add(mul(n, radius * k), mul(b, radius * s)))
    })
}

fn crystal(outline: &[[f64; 2]], height: f64, tip: f64) -> Mesh {
    let mut mesh = prism(outline, height, 1, 0.0, 0.8);
    // The cap's centre is the last vertex: raising it makes the point.
    if let Some(p) = mesh.positions.last_mut() {
        p[1] = (height + tip) as f32;
    }
    mesh
}

fn vase(d: &mut Stream) -> Mesh {
    let thick = d.range(0.05, 0.1);
    let (foot, belly, neck, lip) = (d.range(0.3, 0.6), d.range(0.7, 1.0), d.range(0.25, 0.6), d.range(0.35, 0.8));
    let (low, high, top) = (d.range(0.5, 0.9), d.range(1.3, 1.7), d.range(1.9, 2.4));
    let outer = [[foot, 0.0], [belly, low], [neck, high], [lip, top]];
    let mut profile = vec![[0.0, 0.0], [foot * 0.6, 0.0]];
    profile.extend((0..=8).map(|k| spline(&outer, false, f64::from(k) / 8.0)));
    profile.push([lip - 0.5 * thick, top + 0.4 * thick]);
    profile.extend((1..=7).rev().map(|k| {
        let [r, y] = spline(&outer, false, f64::from(k) / 8.0);
        [(r - thick).max(0.08), y]
    }));
    profile.extend([[foot * 0.5, 1.5 * thick], [0.0, 1.5 * thick]]);
    lathe(&profile, 48, 96)
}

fn bottle(d: &mut Stream) -> Mesh {
    let (body, shoulder, neck, thick) = (d.range(1.2, 1.9), d.range(0.3, 0.6), d.range(0.5, 0.9), 0.07);
    let width = d.range(0.2, 0.28);
    let top = body + shoulder + neck;
    lathe(
        &[
            [0.0, 0.05],
            [0.5, 0.0],
            [0.62, 0.08],
            [0.65, 0.3],
            [0.65, 0.6 * body],
            [0.63, body],
            [width + 0.03, body + shoulder],
            [width, body + shoulder + 0.5 * neck],
            [width, top - 0.12],
            [width + 0.05, top - 0.08],
            [width + 0.04, top],
            [width - thick, top],
            [width - thick, body + shoulder + 0.5 * neck],
            [width - thick + 0.02, body + shoulder],
            [0.63 - thick, body - 0.03],
            [0.65 - thick, 0.6 * body],
            [0.65 - thick, 0.3],
            [0.5 - thick, 0.12],
            [0.0, 0.14],
        ],
        48,
        108,
    )
}

fn chair(d: &mut Stream) -> Mesh {
    let (seat, back, leg) = (d.range(0.4, 0.55), d.range(0.4, 0.7), d.range(0.02, 0.05));
    let (w, depth) = (d.range(0.2, 0.27), d.range(0.2, 0.26));
    let mut parts = vec![([0.0, seat, 0.0], [w, 0.025, depth])];
    for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        parts.push(([sx * (w - leg), 0.5 * seat, sz * (depth - leg)], [leg, 0.5 * seat, leg]));
    }
    let slats = 2 + d.below(3);
    for s in [-1.0, 1.0] {
        parts.push(([s * (w - leg), seat + 0.5 * back, leg - depth], [leg, 0.5 * back, leg]));
    }
    for k in 0..slats {
        let y = seat + back * (k as f64 + 1.0) / slats as f64 - 0.04;
        parts.push(([0.0, y, leg - depth], [w - leg, 0.035, 0.6 * leg]));
    }
    boxes(&parts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh_check::{is_closed, signed_volume};

    #[test]
    fn every_variant_is_closed_outward_normalised_and_small() {
        for form in FORMS.iter().filter(|f| f.name != "sphere") {
            for variant in 0..form.variants {
                let (mesh, bounds) = mesh(form, variant).expect("a mesh");
                let name = format!("{}-{variant}", form.name);
                assert!(is_closed(&mesh), "{name} is open");
                assert!(signed_volume(&mesh) > 0.0, "{name} is inside out");
                assert!(mesh.triangles.len() < 17_000, "{name}: {} triangles", mesh.triangles.len());
                assert_eq!(mesh.uvs.is_some(), form.uv, "{name}");
                let size = bounds.size();
                assert!((size[0].max(size[1]).max(size[2]) - 1.0).abs() < 1e-6, "{name}");
                assert!(bounds.low[1] == 0.0 && mesh.positions.iter().flatten().all(|v| v.is_finite()), "{name}");
                assert_eq!(Mesh::from_bytes(&mesh.to_bytes().expect("small")).expect("valid"), mesh);
            }
        }
    }

    #[test]
    fn shading_normals_agree_with_faces() {
        for form in FORMS.iter().filter(|f| f.name != "sphere") {
            let (mesh, _) = mesh(form, 0).expect("a mesh");
            let Some(normals) = &mesh.normals else { continue };
            let mut against = 0;
            for t in &mesh.triangles {
                let [a, b, c] = t.map(|i| mesh.positions[i as usize].map(f64::from));
                let face = cross(crate::geom::sub(b, a), crate::geom::sub(c, a));
                let shade = t.iter().fold([0.0; 3], |s, i| add(s, normals[*i as usize].map(f64::from)));
                against += usize::from(crate::geom::dot(face, shade) < 0.0);
            }
            let share = against as f64 / mesh.triangles.len() as f64;
            assert!(share < 0.01, "{}: {share} of the normals point inwards", form.name);
        }
    }
}
