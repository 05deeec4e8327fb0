//! The whole library: sound meshes, true tops and solids, sane sizes, the same bits.

use super::*;
use std::collections::BTreeMap;
use tauflow_data::{
    geom::{add, cross, dot, length, mul, sub},
    mesh_check::{is_closed, signed_volume, welded},
    rng::mix,
};

/// The least and greatest longest side of a family's things, metres.
fn sizes(family: Family) -> [f64; 2] {
    use Family::*;
    match family {
        Chair => [0.4, 1.25],
        Sofa => [0.4, 2.8],
        Table | Desk => [0.4, 2.3],
        Shelf => [0.6, 2.2],
        Cabinet => [0.5, 2.3],
        Bed => [1.9, 2.4],
        Lamp => [0.05, 2.2],
        CeilingLamp => [0.4, 5.2],
        Screen => [0.13, 1.6],
        Book => [0.15, 0.75],
        Paper => [0.05, 0.95],
        Pen => [0.09, 0.25],
        Vessel => [0.06, 0.5],
        Plate => [0.15, 0.6],
        Food => [0.04, 0.4],
        Plant => [0.1, 1.4],
        Tree => [2.0, 9.0],
        Bush => [0.5, 2.2],
        Grass => [0.08, 2.0],
        Leaves => [0.3, 2.2],
        Rock => [0.15, 1.8],
        Terrain => [0.6, 8.5],
        Cloth => [0.25, 1.9],
        Rug => [0.5, 2.7],
        Curtain | Blind => [0.6, 2.7],
        Cushion => [0.3, 0.95],
        Box => [0.1, 1.2],
        Tool => [0.12, 1.6],
        MachinePart => [0.02, 2.8],
        Fence => [1.4, 3.2],
        Rail => [0.6, 3.0],
        Column => [1.0, 3.6],
        Stair => [0.6, 5.5],
        Sculpture => [0.2, 1.9],
        Toy => [0.05, 0.6],
        Sign => [0.15, 3.6],
        Vehicle => [1.2, 4.9],
        Bin => [0.2, 1.3],
        Bench => [1.1, 2.1],
        StreetLamp => [2.3, 6.5],
        Ornament => [0.04, 0.6],
        Instrument => [0.2, 1.6],
        Clock => [0.09, 2.4],
        Frame => [0.13, 1.6],
        Bicycle => [0.7, 1.9],
        Utensil => [0.13, 0.6],
        Solid => [0.03, 0.5],
        Opening => [0.7, 2.3],
        Fixture => [0.12, 1.7],
    }
}

struct Sample {
    form: &'static Form,
    variant: u64,
    made: FormVariant,
}

/// The first and the last variant of each form.
static SAMPLES: LazyLock<Vec<Sample>> = LazyLock::new(|| {
    let variants = |form: &'static Form| [0, form.variants - 1].map(|variant| (form, variant));
    forms()
        .iter()
        .flat_map(variants)
        .map(|(form, variant)| Sample { form, variant, made: form.make(variant) })
        .collect()
});

fn corners(mesh: &Mesh, t: &[u32; 3]) -> [Vec3; 3] {
    t.map(|i| mesh.positions[i as usize].map(f64::from))
}

/// Everything wrong in a sample, by name: one list is read faster than one failure at a time.
fn report(check: impl Fn(&Sample) -> Option<String>) {
    let found: Vec<String> = SAMPLES
        .iter()
        .filter_map(|sample| check(sample).map(|what| format!("{}-{}: {what}", sample.form.name, sample.variant)))
        .collect();
    assert!(found.is_empty(), "{} wrong:\n{}", found.len(), found.join("\n"));
}

/// True if a box, grown by `margin` on all sides, holds a point.
fn contains(solid: &Aabb, p: Vec3, margin: f64) -> bool {
    (0..3).all(|i| p[i] > solid.low[i] - margin && p[i] < solid.high[i] + margin)
}

#[test]
fn there_are_enough_and_every_family_has_some() {
    assert!(forms().len() >= 240, "{}", forms().len());
    assert!(forms().is_sorted_by(|a, b| a.name < b.name), "names are sorted and each is there once");
    let mut counts: BTreeMap<Family, usize> = BTreeMap::new();
    forms().iter().for_each(|form| *counts.entry(form.family).or_default() += 1);
    assert_eq!(counts.len(), 51, "a family that is asked for has forms");
    for (family, count) in counts {
        assert!(count >= 2 || family == Family::Pen && count >= 1, "{family:?} has {count}");
        assert_eq!(of_family(family).count(), count);
    }
}

#[test]
fn meshes_are_sound() {
    report(|sample| {
        let mut total = 0;
        for part in &sample.made.parts {
            let mesh = &part.mesh;
            total += mesh.triangles.len();
            let (Some(normals), Some(uvs)) = (&mesh.normals, &mesh.uvs) else { return Some("lacks attributes".into()) };
            if normals.len() != mesh.positions.len() || uvs.len() != mesh.positions.len() || mesh.triangles.is_empty() {
                return Some("attributes of another length, or no triangles".into());
            }
            if !mesh.positions.iter().chain(normals).flatten().chain(uvs.iter().flatten()).all(|v| v.is_finite()) {
                return Some("not finite".into());
            }
            if normals.iter().any(|n| (length(n.map(f64::from)) - 1.0).abs() > 1e-3) {
                return Some("a normal is not of unit length".into());
            }
            let mut against = 0;
            for t in &mesh.triangles {
                let [a, b, c] = corners(mesh, t);
                let face = cross(sub(b, a), sub(c, a));
                if length(face) < 1e-14 {
                    return Some(format!("a triangle of {:?} without area at {a:?} {b:?} {c:?}", part.stuff));
                }
                let shade = t.iter().fold([0.0; 3], |s, i| add(s, normals[*i as usize].map(f64::from)));
                against += usize::from(dot(face, shade) < 0.0);
            }
            if against * 200 > mesh.triangles.len() {
                return Some(format!("{against} normals of {:?} face inwards", part.stuff));
            }
        }
        (total > 25_000).then(|| format!("{total} triangles"))
    });
}

/// Sets of triangles that hang together, with vertices welded.
fn components(mesh: &Mesh) -> Vec<Mesh> {
    let place = welded(mesh);
    let mut root: Vec<u32> = (0..place.len() as u32).collect();
    fn find(root: &mut [u32], mut i: u32) -> u32 {
        while root[i as usize] != i {
            root[i as usize] = root[root[i as usize] as usize];
            i = root[i as usize];
        }
        i
    }
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| place[i as usize]);
        for other in [b, c] {
            let (x, y) = (find(&mut root, a), find(&mut root, other));
            root[x as usize] = y;
        }
    }
    let mut sets: BTreeMap<u32, Vec<[u32; 3]>> = BTreeMap::new();
    for t in &mesh.triangles {
        let key = find(&mut root, place[t[0] as usize]);
        sets.entry(key).or_default().push(*t);
    }
    sets.into_values()
        .map(|triangles| Mesh { positions: mesh.positions.clone(), triangles, ..Mesh::default() })
        .collect()
}

#[test]
fn closed_bodies_face_outwards_and_glass_is_closed() {
    report(|sample| {
        let parts = &sample.made.parts;
        if sample.form.glass && (parts.len() != 1 || !is_closed(&parts[0].mesh)) {
            return Some("would be glass and is not one closed body".into());
        }
        for part in parts {
            if part.stuff == Stuff::Glass && !is_closed(&part.mesh) {
                return Some("glass is open".into());
            }
            // Of a part of very many bodies the whole volume tells.
            let bodies =
                if part.mesh.triangles.len() < 4000 { components(&part.mesh) } else { vec![part.mesh.clone()] };
            for (k, body) in bodies.iter().enumerate().take(60) {
                if is_closed(body) && signed_volume(body) <= 0.0 {
                    let at = body.positions[body.triangles[0][0] as usize];
                    return Some(format!("body {k} of {:?} at {at:?} is inside out", part.stuff));
                }
            }
        }
        None
    });
}

#[test]
fn bounds_are_true_and_sizes_real() {
    report(|sample| {
        let mut bounds = Aabb::EMPTY;
        sample.made.parts.iter().flat_map(|p| &p.mesh.positions).for_each(|p| bounds.grow(p.map(f64::from)));
        let said = sample.made.bounds;
        let off = (0..3).map(|i| (bounds.low[i] - said.low[i]).abs().max((bounds.high[i] - said.high[i]).abs()));
        if off.fold(0.0, f64::max) > 1e-5 || said.low[1] != 0.0 || (said.low[0] + said.high[0]).abs() > 1e-9 {
            return Some(format!("bounds {said:?}, mesh {bounds:?}"));
        }
        let longest = said.size().into_iter().fold(0.0, f64::max);
        let [least, most] = sizes(sample.form.family);
        (longest < least || longest > most).then(|| format!("{longest:.3} m long"))
    });
}

#[test]
fn solids_hold_the_mesh_tightly() {
    report(|sample| {
        let made = &sample.made;
        let inside = |p: Vec3| made.solids.iter().any(|b| contains(b, p, 0.005));
        for part in &made.parts {
            for t in &part.mesh.triangles {
                let [a, b, c] = corners(&part.mesh, t);
                let middle = mul(add(add(a, b), c), 1.0 / 3.0);
                let edge = mul(add(a, b), 0.5);
                if let Some(p) = [a, middle, edge].into_iter().find(|p| !inside(*p)) {
                    return Some(format!("{p:?} of {:?} is in no solid", part.stuff));
                }
            }
        }
        let out = made
            .solids
            .iter()
            .find(|b| (0..3).any(|i| b.low[i] < made.bounds.low[i] - 1e-6 || b.high[i] > made.bounds.high[i] + 1e-6));
        if let Some(solid) = out {
            return Some(format!("a solid goes beyond: {solid:?}"));
        }
        (made.solids.is_empty() || made.solids.len() > 24).then(|| format!("{} solids", made.solids.len()))
    });
}

#[test]
fn a_table_is_legs_and_a_board() {
    for name in ["table_dining", "table_trestle", "desk_frame", "chair_slats", "bench_stone"] {
        let form = forms().iter().find(|f| f.name == name).expect("in the library");
        let made = form.make(0);
        let volume = |b: &Aabb| b.size().iter().product::<f64>();
        let share = made.solids.iter().map(volume).sum::<f64>() / volume(&made.bounds);
        assert!(share < 0.5, "{name}: solids fill {share:.2} of its box");
        let knees = [0.0, 0.5 * made.tops[0].center[1], 0.0];
        assert!(!made.solids.iter().any(|b| contains(b, knees, -0.01)), "{name}: there is room below");
    }
}

/// Heights at which the vertical through (x, z) meets the mesh.
fn heights(made: &FormVariant, x: f64, z: f64) -> Vec<f64> {
    let mut out = Vec::new();
    for mesh in made.parts.iter().map(|p| &p.mesh) {
        for t in &mesh.triangles {
            let [a, b, c] = corners(mesh, t);
            let turn = |p: Vec3, q: Vec3| (q[0] - p[0]) * (z - p[2]) - (q[2] - p[2]) * (x - p[0]);
            let (u, v, w) = (turn(b, c), turn(c, a), turn(a, b));
            let total = u + v + w;
            if total.abs() > 1e-12 && (u / total).min(v / total).min(w / total) >= -1e-9 {
                out.push((u * a[1] + v * b[1] + w * c[1]) / total);
            }
        }
    }
    out
}

#[test]
fn tops_are_flat_and_free() {
    report(|sample| {
        for top in &sample.made.tops {
            if top.half.iter().any(|h| *h <= 0.0) || top.clearance <= 0.0 {
                return Some(format!("{top:?} is empty"));
            }
            // Not on the axis itself, where edges of fans meet.
            for (s, t) in [(0.013, 0.007), (0.97, 0.96), (-0.97, 0.95), (0.96, -0.97), (-0.95, -0.96), (0.5, -0.3)] {
                let (x, z) = (top.center[0] + s * top.half[0], top.center[2] + t * top.half[1]);
                let found = heights(&sample.made, x, z);
                let near = found.iter().copied().fold(f64::INFINITY, |best, y| {
                    if (y - top.center[1]).abs() < (best - top.center[1]).abs() { y } else { best }
                });
                // Slatted and woven tops have gaps; the plane through them counts.
                let gaps = ["shelf_wire", "chair_folding", "bench_park", "workbench", "hand_cart"];
                if (near - top.center[1]).abs() > 0.003 && !gaps.contains(&sample.form.name) {
                    return Some(format!("no surface at {x:.3} {:.3} {z:.3}: {near:.4}", top.center[1]));
                }
                let above = found.into_iter().filter(|y| *y > top.center[1] + 0.006).fold(f64::INFINITY, f64::min);
                if above < top.center[1] + top.clearance - 0.006 {
                    return Some(format!(
                        "{:.3} m free above {:?}, said {:.3}",
                        above - top.center[1],
                        top.center,
                        top.clearance
                    ));
                }
            }
        }
        None
    });
    let with_tops = SAMPLES.iter().filter(|s| !s.made.tops.is_empty()).count();
    assert!(with_tops > 100, "{with_tops}");
}

/// What one sees of proportions: the sides of the box, and the square root of the surface.
fn proportions(made: &FormVariant) -> [f64; 4] {
    let [x, y, z] = made.bounds.size();
    let faces = made.parts.iter().flat_map(|p| p.mesh.triangles.iter().map(|t| corners(&p.mesh, t)));
    let area: f64 = faces.map(|[a, b, c]| 0.5 * length(cross(sub(b, a), sub(c, a)))).sum();
    [x, y, z, area.sqrt()]
}

#[test]
fn variants_differ() {
    let mut alike = Vec::new();
    for form in forms() {
        let all: Vec<[f64; 4]> = (0..3.min(form.variants)).map(|v| proportions(&form.make(v))).collect();
        for (i, a) in all.iter().enumerate() {
            for b in &all[..i] {
                let most = (0..4).map(|k| (a[k] - b[k]).abs() / a[k].max(b[k])).fold(0.0, f64::max);
                if most < 0.01 {
                    alike.push(format!("{}: {a:?} and {b:?}", form.name));
                }
            }
        }
    }
    assert!(alike.is_empty(), "variants are alike:\n{}", alike.join("\n"));
}

fn digest(made: &FormVariant) -> u64 {
    let mut state = 7;
    for part in &made.parts {
        state = mix(state, part.stuff as u64);
        let mesh = &part.mesh;
        let values = mesh.positions.iter().flatten().chain(mesh.normals.iter().flatten().flatten());
        let values = values.chain(mesh.uvs.iter().flatten().flatten());
        state = values.fold(state, |state, v| mix(state, u64::from(v.to_bits())));
        state = mesh.triangles.iter().flatten().fold(state, |state, i| mix(state, u64::from(*i)));
    }
    let boxes = made.solids.iter().chain([&made.bounds]).flat_map(|b| b.low.into_iter().chain(b.high));
    boxes.fold(state, |state, v| mix(state, v.to_bits()))
}

#[test]
fn the_library_is_the_same_everywhere() {
    let all = SAMPLES.iter().fold(0, |state, s| mix(state, digest(&s.made)));
    for name in ["statue_figure", "tree_broadleaf", "tablecloth", "gear_train"] {
        let form = forms().iter().find(|f| f.name == name).expect("in the library");
        assert_eq!(digest(&form.make(2)), digest(&form.make(2)), "{name}");
    }
    assert_eq!(format!("{all:016x}"), "773cd8a0ed9bf807", "the library changed: scenes and their pins change with it");
}
