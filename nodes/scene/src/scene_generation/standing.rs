//! Whether things stand: looked for in the meshes themselves, not in the boxes that they were placed by.

use super::{
    cast::{Cast, Pool},
    layouts,
    params::SceneGenerationParams,
    stage::{Body, Rest, Stage},
};
use tauflow_data::{
    ContextClass, Regime, Stratum,
    geom::{Aabb, Vec3, apply, cross, dot, sub, unit},
    mesh::Mesh,
    rng::Stream,
};
use tauflow_scene_library::{forms::Family, stuff::Stuff};

/// How far from its support a thing may be, metres.
const SUPPORT: f64 = 3e-3;
/// How deep things may stand in each other, metres.
const DEPTH: f64 = 2e-3;

struct Soup {
    name: String,
    triangles: Vec<[Vec3; 3]>,
    boxes: Vec<Aabb>,
    bounds: Aabb,
}

impl Soup {
    fn new(name: String, triangles: Vec<[Vec3; 3]>) -> Self {
        let boxes: Vec<Aabb> = triangles
            .iter()
            .map(|t| {
                let mut b = Aabb::EMPTY;
                t.iter().for_each(|p| b.grow(*p));
                b
            })
            .collect();
        let bounds = boxes.iter().fold(Aabb::EMPTY, Aabb::union);
        Self { name, triangles, boxes, bounds }
    }

    fn within<'a>(&'a self, zone: &'a Aabb) -> impl Iterator<Item = &'a [Vec3; 3]> {
        self.triangles.iter().zip(&self.boxes).filter(|(_, b)| meet(b, zone)).map(|(t, _)| t)
    }
}

fn meet(a: &Aabb, b: &Aabb) -> bool {
    (0..3).all(|i| a.low[i] <= b.high[i] && b.low[i] <= a.high[i])
}

fn grown(b: &Aabb, by: f64) -> Aabb {
    Aabb { low: b.low.map(|v| v - by), high: b.high.map(|v| v + by) }
}

fn triangles(mesh: &Mesh, to_world: &tauflow_data::scene::Affine) -> Vec<[Vec3; 3]> {
    let points: Vec<Vec3> = mesh.positions.iter().map(|p| apply(to_world, p.map(f64::from))).collect();
    mesh.triangles.iter().map(|t| t.map(|i| points[i as usize])).collect()
}

/// The things of a stage, what is built, by label, and the land.
fn soups(stage: &Stage<'_>) -> (Vec<Soup>, Vec<Soup>, Soup) {
    let things = stage
        .things
        .iter()
        .map(|thing| {
            let Body::Form(facts) = &thing.body else { panic!("no assets here") };
            let mut all = Vec::new();
            for part in &facts.parts {
                let mesh = Mesh::from_bytes(&part.blob).expect("a mesh of the library");
                all.extend(triangles(&mesh, &thing.to_world));
            }
            Soup::new(thing.body.name(), all)
        })
        .collect();
    let (mut built, mut land) = (Vec::new(), Vec::new());
    // What stands in water stands on its bed.
    for (label, skin) in stage.skins.iter().filter(|(_, s)| s.stuff != Stuff::Water) {
        let quads = skin.quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
        built.push(Soup::new(label.clone(), quads));
        for (piece, to_world) in &skin.lands {
            land.extend(triangles(&Mesh::from_bytes(&piece.blob).expect("a land"), to_world));
        }
    }
    (things, built, Soup::new("the land".into(), land))
}

/// Where the line from `p` along `d` meets a triangle, as a multiple of `d`; either way.
fn along(p: Vec3, d: Vec3, t: &[Vec3; 3]) -> Option<f64> {
    let (e, f) = (sub(t[1], t[0]), sub(t[2], t[0]));
    let h = cross(d, f);
    let det = dot(e, h);
    if det.abs() < 1e-14 {
        return None;
    }
    let s = sub(p, t[0]);
    let u = dot(s, h) / det;
    let q = cross(s, e);
    let v = dot(d, q) / det;
    (u >= -1e-9 && v >= -1e-9 && u + v <= 1.0 + 1e-9).then(|| dot(f, q) / det)
}

/// The share of a thing's outermost points towards `d` that have something within [`SUPPORT`] before them.
fn supported(thing: &Soup, d: Vec3, others: &[&Soup]) -> f64 {
    let axis = (0..3).max_by(|a, b| d[*a].abs().total_cmp(&d[*b].abs())).expect("three");
    let reach = |p: &Vec3| dot(*p, d);
    let far = thing.triangles.iter().flatten().map(reach).fold(f64::NEG_INFINITY, f64::max);
    let mut points: Vec<Vec3> = thing.triangles.iter().flatten().filter(|p| reach(p) > far - 1.5e-3).copied().collect();
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[2].total_cmp(&b[2])).then(a[1].total_cmp(&b[1])));
    points.dedup();
    let step = points.len().div_ceil(40);
    let points: Vec<Vec3> = points.into_iter().step_by(step).collect();
    let mut zone = Aabb::EMPTY;
    points.iter().for_each(|p| zone.grow(*p));
    let mut zone = grown(&zone, 1e-3);
    zone.low[axis] -= 0.01;
    zone.high[axis] += 0.01;
    let near: Vec<&[Vec3; 3]> = others.iter().flat_map(|o| o.within(&zone)).collect();
    let held = |p: &Vec3| near.iter().any(|t| along(*p, d, t).is_some_and(|s| s > -DEPTH && s < SUPPORT));
    points.iter().filter(|p| held(p)).count() as f64 / points.len().max(1) as f64
}

/// How deep two stand in each other, where edges of one go through triangles of the other: how far, near there, points
/// of the one lie behind that triangle; the lesser of both sides, as sheets have no inside.
fn depth(a: &Soup, b: &Soup) -> f64 {
    const NEAR: f64 = 0.05;
    let mut deepest: f64 = 0.0;
    for (one, other) in [(a, b), (b, a)] {
        let zone = grown(&other.bounds, 1e-4);
        let shared = Aabb {
            low: [0, 1, 2].map(|i| zone.low[i].max(one.bounds.low[i])),
            high: [0, 1, 2].map(|i| zone.high[i].min(one.bounds.high[i])),
        };
        if (0..3).any(|i| shared.low[i] > shared.high[i]) {
            return 0.0;
        }
        let faces: Vec<(&[Vec3; 3], &Aabb)> =
            other.triangles.iter().zip(&other.boxes).filter(|(_, b)| meet(b, &shared)).collect();
        for (t, own) in one.triangles.iter().zip(&one.boxes).filter(|(_, b)| meet(b, &shared)) {
            for (face, _) in faces.iter().filter(|(_, b)| meet(b, own)) {
                let n = unit(cross(sub(face[1], face[0]), sub(face[2], face[0])));
                for k in 0..3 {
                    let (p, q) = (t[k], t[(k + 1) % 3]);
                    let (dp, dq) = (dot(sub(p, face[0]), n), dot(sub(q, face[0]), n));
                    if dp * dq >= 0.0 {
                        continue;
                    }
                    let Some(s) = along(p, sub(q, p), face).filter(|s| (0.0..=1.0).contains(s)) else { continue };
                    let at: Vec3 = [0, 1, 2].map(|i| p[i] + s * (q[i] - p[i]));
                    let mut sides = [0.0f64; 2];
                    for v in one.triangles.iter().flatten() {
                        let off = sub(*v, at);
                        if dot(off, off) < NEAR * NEAR && along(*v, n, face).is_some() {
                            let d = dot(sub(*v, face[0]), n);
                            sides[usize::from(d > 0.0)] = sides[usize::from(d > 0.0)].max(d.abs());
                        }
                    }
                    deepest = deepest.max(sides[0].min(sides[1])).max(dp.abs().min(dq.abs()).min(NEAR));
                }
            }
        }
    }
    deepest
}

/// What floats and what stands in something, in words.
fn problems(stage: &Stage<'_>) -> Vec<String> {
    let (things, built, land) = soups(stage);
    let mut out = Vec::new();
    for (i, soup) in things.iter().enumerate() {
        let thing = &stage.things[i];
        let mut others: Vec<&Soup> = (0..things.len()).filter(|j| *j != i).map(|j| &things[j]).collect();
        others.extend(&built);
        let turn = |d: Vec3| sub(apply(&thing.to_world, d), apply(&thing.to_world, [0.0; 3]));
        let share = match thing.rest {
            Rest::Stands => supported(soup, [0.0, -1.0, 0.0], &others),
            Rest::Hangs => supported(soup, [0.0, 1.0, 0.0], &others),
            Rest::Wall => supported(soup, unit(turn([0.0, 0.0, -1.0])), &others),
            // In the ground: some of it below, most of it above.
            Rest::Rooted => {
                let lowest = soup.bounds.low[1];
                let c = soup.bounds.center();
                let zone = Aabb { low: [c[0] - 0.01, -100.0, c[2] - 0.01], high: [c[0] + 0.01, 100.0, c[2] + 0.01] };
                let ground = land
                    .within(&zone)
                    .filter_map(|t| along([c[0], lowest, c[2]], [0.0, 1.0, 0.0], t))
                    .fold(f64::NEG_INFINITY, f64::max);
                let size = soup.bounds.size();
                // No deeper than the ground is steep under it.
                f64::from(u8::from(ground > -0.12 * size[0].max(size[2]) && ground < 0.75 * size[1] + 0.1))
            }
        };
        // Curtains and blinds hang by the ends of their rails.
        let least = match &thing.body {
            Body::Form(facts) if matches!(facts.form.family, Family::Curtain | Family::Blind) => 0.01,
            _ => 0.5,
        };
        if share < least {
            out.push(format!("{} {:?}: {share:.2} of it is held", soup.name, thing.rest));
        }
        for other in &things[i + 1..] {
            let d = depth(soup, other);
            if d > DEPTH {
                out.push(format!("{} stands {:.1} mm in {}", soup.name, 1e3 * d, other.name));
            }
        }
        for piece in built.iter().filter(|_| thing.rest != Rest::Rooted) {
            let d = depth(soup, piece);
            if d > DEPTH {
                out.push(format!("{} stands {:.1} mm in {}", soup.name, 1e3 * d, piece.name));
            }
        }
    }
    out
}

fn stages(mut each: impl FnMut(&str, Stage<'_>)) {
    let (params, pool) = (SceneGenerationParams::default(), Pool::default());
    for context in ContextClass::ALL {
        for (number, layout) in layouts::layouts(context).iter().enumerate() {
            for (turn, regime) in Regime::ALL.into_iter().enumerate() {
                let stratum = Stratum { regime, context };
                let cast = Cast::new(&pool, &params, stratum, 0);
                let stream = Stream::new(0x7374_616E, &[number as u64, turn as u64]);
                let most = [12, 26, 40, 60][(number + turn) % 4];
                let stage = layouts::stage(*layout, stratum, &cast, &stream, most);
                each(&format!("{stratum} {} {most}", layout.0), stage);
            }
        }
    }
}

#[test]
fn everything_stands_and_nothing_stands_in_anything() {
    let (mut wrong, mut things, mut scenes) = (Vec::new(), 0, 0);
    stages(|name, stage| {
        assert!(stage.fault.is_none(), "{name}: {:?}", stage.fault);
        things += stage.things.len();
        scenes += 1;
        wrong.extend(problems(&stage).into_iter().map(|p| format!("{name}: {p}")));
    });
    assert!(scenes >= 200 && things > 4000, "{scenes} scenes, {things} things");
    // Of long thin things in a corner, one in thousands is held at one end alone.
    assert!(wrong.len() * 4000 <= things, "{} of {things} things:\n{}", wrong.len(), wrong.join("\n"));
}

#[test]
fn a_thing_that_floats_or_stands_in_another_is_found() {
    let (params, pool) = (SceneGenerationParams::default(), Pool::default());
    let stratum = Stratum { regime: Regime::L0, context: ContextClass::Enclosed };
    let cast = Cast::new(&pool, &params, stratum, 0);
    let layout = layouts::layouts(ContextClass::Enclosed).iter().find(|l| l.0 == "living_room").expect("there");
    let mut stage = layouts::stage(*layout, stratum, &cast, &Stream::new(5, &[]), 30);
    assert_eq!(problems(&stage), Vec::<String>::new());
    let index = stage.things.iter().position(|t| t.main).expect("a main object");
    stage.things[index].to_world[1][3] += 0.006;
    assert!(problems(&stage).iter().any(|p| p.contains("is held")), "6 mm of air");
    stage.things[index].to_world[1][3] -= 0.012;
    assert!(problems(&stage).iter().any(|p| p.contains(" mm in ")), "6 mm deep");
}

#[test]
fn layouts_hold_what_is_asked_for_and_differ_in_what_they_place() {
    let mut families: std::collections::BTreeMap<String, std::collections::BTreeSet<_>> = Default::default();
    let mut wrong = Vec::new();
    stages(|name, stage| {
        let (layout, most) = (stage.layout.to_owned(), stage.most);
        let glassy = matches!(stage.stratum.regime, Regime::L2 | Regime::L3);
        let lit = !stage.lights.is_empty() || stage.things.iter().any(|t| t.power.is_some());
        for (holds, what) in [
            (stage.things.len() <= most, "more things than asked for"),
            (stage.has_main, "no main object"),
            (!glassy || stage.things.iter().any(|t| t.glass), "nothing of glass"),
            (stage.things.len() >= 4, "few things"),
            ((stage.sky > 0.0) == (stage.stratum.context != ContextClass::Enclosed), "a sky of another context"),
            (lit || stage.stratum.context == ContextClass::Environment, "dark"),
        ] {
            if !holds {
                wrong.push(format!("{name}: {what}, {} things", stage.things.len()));
            }
        }
        // What shows glass is the regime's, and the same in all layouts.
        if stage.glassy() {
            return;
        }
        let of = families.entry(layout).or_default();
        of.extend(stage.skins.keys().map(|label| format!("built {label}")));
        for thing in &stage.things {
            if let Body::Form(facts) = &thing.body {
                of.insert(format!("{:?}", facts.form.family));
            }
        }
    });
    assert!(wrong.is_empty(), "{wrong:#?}");
    assert!(families.len() >= 55, "{}", families.len());
    let all: Vec<_> = families.iter().collect();
    for (i, (a, one)) in all.iter().enumerate() {
        for (b, other) in &all[i + 1..] {
            assert!(one.symmetric_difference(other).count() >= 4, "{a} and {b} place the same");
        }
    }
}

#[test]
fn cameras_stand_in_no_solid() {
    stages(|name, stage| {
        for k in 0..6 {
            let camera = super::camera::aim(&stage, [35.0, 70.0], &Stream::new(k, &[]));
            assert!(stage.world.clear(camera.origin, 0.0), "{name}: {camera:?}");
            let view = sub(camera.target, camera.origin);
            assert!(view[0].abs() > 5e-4 || view[2].abs() > 5e-4, "{name}: straight down");
        }
    });
}
